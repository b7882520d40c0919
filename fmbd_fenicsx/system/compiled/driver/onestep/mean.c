/* A step of the energy-momentum scheme, (1) to (4) of schemes/onestep/conserving/energy_momentum.py. With frames and maps of surfaces at the mean
   of both ends kernels of kinds give the rows of difference quotients. Bodies in absolute coordinates are at their mean displacements,
   where linear forces are difference quotients; Python tells those of energies. */

static const double GAUSS[3] = {0.5 - 0.3872983346207417, 0.5, 0.5 + 0.3872983346207417}, SHARES[3] = {5.0 / 18, 4.0 / 9, 5.0 / 18};
enum { MATRICES = 2 };                  /* of a step at most */
enum { PATIENT = 8 };                   /* increments that are cheaper than new tangents */
static const double ASTRAY = 10.0, FAR_AWAY = 0.2; /* accelerations, of their size, and ways, of the length, that lead to other solutions */
static const double UNMOVED = 1e-6, UNKNOWN = 1e-5; /* as in mechanics/joints/relative.py */
static const double KEPT = 1e-13;   /* of the length, that rows may leave of g_1 - g_0 */

/* One step of size h from q0, v0 at t: what is there at both ends, and where the newest accelerations lead. */
typedef struct {
    double t, h, length;
    const double *q0, *v0;
    double *frames[2], *maps[2], *s[2], *gap0; /* frames, maps of surfaces, coordinates of efforts; g_0 */
    double *q, *v, *middle, *w, *xi;           /* the end; between: configuration, velocity, increment */
    double *core, *inertia, *along, *missing, *share, *effort, *means; /* means: room */
    double *sampled[2];                        /* what depends on time only, at the end and in the middle */
} Step;

#include "onestep/mean_places.c"

/* When an iteration ends, see Ends of system/compiled/states/means.py. */
enum { LARGEST, NONE, LOST, SLOW_RATE, FASTEST, ENOUGH, ZERO, CLOSE, IDLE, NOISE };

static long mean_coordinates(const System *s)
{
    long n = 0;
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++) n += k->quotient != POINT ? k->n : 0;
    return n;
}

static long mean_maps(const System *s)
{
    long n = 0;
    for (const Surface *k = s->surface; k < s->surface + s->surfaces; k++) n += TWIST * (TWIST + s->body[k->body].modes);
    return n;
}

/* Numbers of room that a step takes. */
EXPORT long driver_mean_room(const System *s)
{
    long frames = FRAME * (s->bodies + 1 + s->surfaces);
    long pairs = (2 * PAIRS + 3) * (2 * s->nv + s->rows);
    return 2 * (frames + mean_maps(s) + sample_size(s)) + 8 * mean_coordinates(s) + 3 * s->nq + 7 * s->nv + 4 * s->rows + pairs;
}

static double *part_of(double **room, long n)
{
    double *at = *room;
    *room += n;
    return at;
}

/* What of the configuration placed last serves as one end. */
static void keep_end(System *s, Step *o, int end)
{
    double *map = o->maps[end], *value = o->s[end];
    memcpy(o->frames[end], s->frames, FRAME * (s->bodies + 1 + s->surfaces) * sizeof(double));
    for (const Surface *k = s->surface; k < s->surface + s->surfaces; k++) {
        long size = TWIST * (TWIST + s->body[k->body].modes);
        memcpy(map, k->map, size * sizeof(double));
        map += size;
    }

    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->quotient == POINT) continue;
        values(s, k);
        for (long i = 0; i < k->n; i++) *value++ = k->out[i * k->outputs];
    }
}

/* The beginning, and what depends on time only, sampled once; ``room`` is cut, what is left of it comes back. */
static int mean_begin(System *s, Step *o, double **room)
{
    double asked = NAN;
    long frames = FRAME * (s->bodies + 1 + s->surfaces), maps = mean_maps(s), n = mean_coordinates(s);
    int verdict;
    for (int end = 0; end < 2; end++) {
        o->frames[end] = part_of(room, frames);
        o->maps[end] = part_of(room, maps);
        o->s[end] = part_of(room, n);
        o->sampled[end] = part_of(room, sample_size(s));
    }

    o->share = part_of(room, n), o->effort = part_of(room, n), o->means = part_of(room, 4 * n);
    o->q = part_of(room, s->nq), o->middle = part_of(room, s->nq);
    o->v = part_of(room, s->nv), o->w = part_of(room, s->nv), o->xi = part_of(room, s->nv);
    o->core = part_of(room, s->nv), o->inertia = part_of(room, s->nv), o->along = part_of(room, s->nv);
    o->gap0 = part_of(room, s->rows), o->missing = part_of(room, s->rows);

    if ((verdict = sample(s, o->t, &asked)) || (verdict = place(s, o->q0, o->v0))) return verdict;
    openings(s, 1);
    memcpy(o->gap0, s->gap, s->rows * sizeof(double));
    keep_end(s, o, 0);

    for (int i = 0; i < 2; i++) {
        if ((verdict = sample(s, o->t + (i ? 0.5 : 1.0) * o->h, &asked))) return verdict;
        keep_sample(s, o->sampled[i], 0);
    }
    return DONE;
}

/* Where a = (v_1 - v_0) / h leads, by the Cayley map of h w. */
static void mean_motion(const System *s, Step *o, const double *a)
{
    for (int i = 0; i < s->nv; i++) {
        o->v[i] = o->v0[i] + o->h * a[i];
        o->w[i] = o->v0[i] + 0.5 * o->h * a[i];
        o->xi[i] = o->h * o->w[i];
    }

    for (int b = 0; b < s->bodies; b++) {
        double *turn = o->xi + TWIST * b + D, square = dot(turn, turn, ROT), angle = sqrt(square);
        double ratio = angle > 1e-8 ? 2.0 * atan(0.5 * angle) / angle : 1.0 - square / 12.0;
        for (int j = 0; j < ROT; j++) turn[j] *= ratio;
    }
    configuration(s, o->q0, o->xi, o->q);
    for (int i = 0; i < s->nv; i++) o->xi[i] *= 0.5;
    configuration(s, o->q0, o->xi, o->middle);
}

#include "onestep/mean_efforts.c"

/* All forces at the mean but those of inertia, weight and within bodies, added to the balance. */
static int mean_forces(System *s, const Step *o, const double *lam, double t)
{
    long first = 0;
    int verdict;
    memset(s->residual, 0, (s->nu + TWIST * s->surfaces) * sizeof(double));
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if ((verdict = mean_items(s, k, o, first, lam, t))) return verdict;
        first += k->quotient != POINT ? k->n : 0;
    }

    for (Rod *k = s->rod; k < s->rod + s->rods; k++)
        if (rod_mean_forces(s, k, o->q0, o->q, o->h, t)) return FAILED;
    for (int i = 0; i < s->surfaces; i++) {
        const Surface *k = s->surface + i;
        const Body *body = s->body + k->body;
        const double *wrench = s->residual + s->nu + TWIST * i;
        for (int j = 0; j < TWIST; j++)
            add(s->residual + body->at_u, wrench[j], k->map + j * (TWIST + body->modes), TWIST + body->modes);
    }

    for (int b = 0; b < s->bodies; b++) {
        const Body *body = s->body + b;
        double turning[ROT];
        material(s->frames + FRAME * b + TURN, s->residual + body->at_u + D, turning);
        add(o->core + TWIST * b, 1.0, s->residual + body->at_u, D);
        add(o->core + TWIST * b + D, 1.0, turning, ROT);
        if (body->field) add_columns(body, s->residual + body->at_u + TWIST, o->core + body->at_v);
        else add(o->core + body->at_v, 1.0, s->residual + body->at_u + TWIST, body->modes);
    }
    return DONE;
}

/* Forces within bodies and of inertia at the middle of the step, in order of its unknowns into ``out``. */
static int mean_bodies(System *s, const Step *o, const double *a, double t, double *out)
{
    int verdict = place(s, o->middle, o->w);
    if (verdict) return verdict;
    s->from = o->q0;
    verdict = body_forces(s, o->middle, o->w, a, t);
    s->from = 0;
    if (!verdict) like_v(s, s->residual, out);
    return verdict;
}

/* What constraints that are not of second order leave of the energy is given back by a force along the motion, (3). */
static int give_back(System *s, const Step *o, const double *a, const double *lam, double t)
{
    double work = 0.0;
    int verdict;
    if (largest(o->missing, s->rows) <= KEPT * o->length) return DONE;
    memcpy(o->xi, a, s->nv * sizeof(double));
    add(o->xi, 1.0, o->w, s->nv);
    if ((verdict = mean_bodies(s, o, o->xi, t, o->along))) return verdict;
    add(o->along, -1.0, o->inertia, s->nv);
    for (int i = 0; i < s->nv; i++) work += o->h * o->w[i] * o->along[i];
    add(o->core, dot(lam, o->missing, s->rows) / fmax(work, 1e-300), o->along, s->nv);
    return DONE;
}

/* What constraints leave open at the end, where a leads. */
static int mean_end(System *s, Step *o, const double *a, double *gap)
{
    int verdict;
    mean_motion(s, o, a);
    if ((verdict = place(s, o->q, o->v))) return verdict;
    if (turns_freely(s)) settle_angles(s, o->q);
    openings(s, 1);
    memcpy(gap, s->gap, s->rows * sizeof(double));
    keep_end(s, o, 1);
    return DONE;
}

/* The balance (core, like v) for a and lambda, and what constraints leave open at the end. */
static int mean_residual(System *s, Step *o, const double *a, const double *lam, double *gap)
{
    double t = o->t + 0.5 * o->h;
    int verdict;
    keep_sample(s, o->sampled[0], 1);
    verdict = mean_end(s, o, a, gap);
    keep_sample(s, o->sampled[1], 1);
    if (verdict || (verdict = mean_bodies(s, o, a, t, o->inertia))) return verdict;

    s->evaluations++;
    for (const Rod *k = s->rod; k < s->rod + s->rods; k++)
        if (k->load) rod_loads(s, k);
    like_v(s, s->residual, o->core);
    place_mean(s, o);
    slips(s, 1);
    for (int i = 0; i < s->rows; i++) o->missing[i] = gap[i] - o->gap0[i] - o->h * s->slip[i];

    for (const Batch *k = s->batch; k < s->batch + s->batches; k++) /* rows on velocities: the mean motion does not slip */
        for (long i = 0; k->role == ROW && k->flow && i < k->n; i++) {
            gap[k->row[i]] = o->h * s->slip[k->row[i]];
            o->missing[k->row[i]] = 0.0;
        }

    if ((verdict = mean_forces(s, o, lam, t))) return verdict;
    return give_back(s, o, a, lam, t);
}

/* The residual of a step from (t, q0, v0): core, like v, and the open constraints. */
EXPORT int driver_mean(System *s, double t, double h, double length, const double *q0, const double *v0, const double *a,
                       const double *lam, double *core, double *gap, double *room)
{
    Step o = {.t = t, .h = h, .length = length, .q0 = q0, .v0 = v0};
    s->span = h;
    int verdict = mean_begin(s, &o, &room);
    if (verdict || (verdict = mean_residual(s, &o, a, lam, gap))) return verdict;
    memcpy(core, o.core, s->nv * sizeof(double));
    return DONE;
}

/* The factor of the middle of the step, where the forces within bodies were evaluated last. */
static int mean_prepare(System *s, const Step *o, const double *lam, double *factored)
{
    double t = o->t + 0.5 * o->h;
    int verdict = place(s, o->middle, o->w);
    if (verdict) return verdict;
    for (Rod *k = s->rod; k < s->rod + s->rods; k++)
        if (rod_forces(s, k, t)) return FAILED;
    if ((verdict = acting(s, lam, t))) return verdict;

    for (Batch *k = s->batch; k < s->batch + s->batches; k++) /* of the means that the residual has */
        for (long i = 0; k->line && i < k->n; i++) {
            if (k->role == LAW && k->sloped != s->evaluations) continue;
            k->stiffness[i] = line_of(k, 0, i)[3];
            k->damping[i] = line_of(k, 0, i)[4];
        }
    memcpy(factored, o->middle, s->nq * sizeof(double));
    return prepare(s, o->middle, 0.5 * o->h, 0.25 * o->h * o->h, lam, 0, t);
}

/* An increment x and y of a and lambda by the factor of the configuration ``factored``. */
static int mean_increment(System *s, const Step *o, const double *factored, const double *gap, double *x, double *y)
{
    int verdict = place(s, factored, o->core);
    if (verdict) return verdict;
    for (int i = 0; i < s->nu; i++) s->b[i] = -s->velocity[i];
    for (int i = 0; i < s->rows; i++) s->b[s->nu + i] = -2.0 / (o->h * o->h) * gap[i];
    for (const Body *k = s->body; s->fields && k < s->body + s->bodies; k++) {
        if (!k->field) continue;
        memset(s->b + k->at_u + TWIST, 0, k->modes * sizeof(double)); /* all acts on the nodes */
        memcpy(k->field->force, o->core + k->at_v, k->field->n * sizeof(double));
    }
    return with_all_rows(s, 1.0, x, y, o->t + 0.5 * o->h);
}

/* The size of an increment; infinite where it has none. */
static double mean_size(const System *s, const double *x)
{
    return dot(x, x, s->nv) < INFINITY ? typical(s, x) : INFINITY;
}

/* Whether increments are at roundoff, fall no more close to it, or the next one would be nothing. */
static int mean_over(const double *sizes, int done, double rate, const double *e)
{
    double last = sizes[done - 1];
    if (last <= e[ZERO] || (rate > e[SLOW_RATE] && last <= e[LOST])) return 1;
    if (done > 2 && last <= e[CLOSE] && last > e[IDLE] * sizes[done - 2]) return 1;
    return done > 1 && last <= e[ENOUGH] && rate <= e[SLOW_RATE] && fmax(rate, e[FASTEST]) * last <= e[NONE];
}

/* Whether it would take more increments than new tangents are worth. */
static int mean_lingers(const Secants *told, const double *sizes, int done, const double *e)
{
    if (done < 3) return 0;
    double last = sizes[done - 1], rate = sqrt(last / sizes[done - 3]);
    return told->count >= LEARNT && last > e[NOISE] && (rate >= 0.9 || log(e[NONE] / last) / log(rate) > PATIENT);
}

/* q and v at the end of a step with accelerations a. */
static int mean_arrive(System *s, Step *o, const double *a, double *q, double *v)
{
    int verdict;
    mean_motion(s, o, a);
    if (turns_freely(s)) {
        if ((verdict = place(s, o->q, o->v))) return verdict;
        settle_angles(s, o->q);
    }
    memcpy(q, o->q, s->nq * sizeof(double));
    memcpy(v, o->v, s->nv * sizeof(double));
    return DONE;
}

/* a and lambda of a step, which begin as a guess, by Newton's iteration with the matrix of its middle; ``sizes`` of the increments
   over that of accelerations, at most so many (``done`` counts, and new tangents of fields, of which the first is taken at once where
   they are ``old``); ``e``: when they end. q, v: the end. NEWTON where this matrix does not serve: a and lambda are as far as they
   came. */
EXPORT int driver_mean_step(System *s, int most, int old, double t, double h, double length, const double *e, const double *q0,
                            const double *v0, double *a, double *lam, double *sizes, long *done, double *q, double *v, double *room)
{
    Step o = {.t = t, .h = h, .length = length, .q0 = q0, .v0 = v0};
    double rate = 0.0;
    s->span = h;
    int verdict = mean_begin(s, &o, &room), anew = 1, taken = 0, since = 0, slow = 1, turned, over, hesitations = 0;
    double *x = part_of(&room, s->nv), *y = part_of(&room, s->rows), *gap = part_of(&room, s->rows), *factored = part_of(&room, s->nq);
    const int width = 2 * s->nv + s->rows;
    Secants told = {.last = room, .made = room + width, .pair = room + 2 * width};
    if (verdict) return verdict;

    for (int k = 0; k < most; k++) {
        s->iterate = k ? FOLLOWING : FIRST;
        s->bridged = 0;
        verdict = mean_residual(s, &o, a, lam, gap);
        s->iterate = ON_ITS_OWN;
        if (verdict) return verdict;
        if (slow && taken++ == MATRICES) return NEWTON;
        turned = s->stiff && k && (s->bridged || other_slopes(s, 0.5 * h, 0.25 * h * h));
        if (turned) anew = 1;

        if (anew) {
            forget(&told);
            told.poor = s->fields > 0; /* each of their increments is worth more than what the pairs cost */
            if (slow && (old || taken > 1) && s->renewable) {
                if ((verdict = take_tangents(s, x, 0, t + 0.5 * h))) return verdict;
                done[1]++;
            }
            if (mean_prepare(s, &o, lam, factored)) return NEWTON;
        }

        anew = slow = 0;
        if ((verdict = mean_increment(s, &o, factored, gap, x, y))) return verdict;
        if (!k || sizes[k - 1] > e[NOISE]) improve(s, &told, x, NULL, y);

        sizes[k] = mean_size(s, x) / e[LARGEST];
        if (!(sizes[k] < INFINITY)) return NEWTON;
        if (s->fields && sizes[k] > ASTRAY && sizes[k] * e[LARGEST] * h * h > FAR_AWAY * length) return NEWTON;
        add(a, 1.0, x, s->nv);
        add(lam, 1.0, y, s->rows);
        done[0] = k + 1;
        rate = k ? sizes[k] / fmax(sizes[k - 1], 1e-300) : 0.0;
        over = !s->bridged && mean_over(sizes, k + 1, rate, e);

        if (over && s->stiff && hesitations < HESITATIONS && undecided(s, 1.0, x)) {
            hesitations++;
            over = 0;
        }

        if (over) {
            if (!(sizes[k] <= fmax(e[ENOUGH], e[LOST]))) return NEWTON;
            return mean_arrive(s, &o, a, q, v);
        }

        anew = slow = !turned && mean_lingers(&told, sizes + since, k + 1 - since, e);
        if (anew) since = k + 1;
    }
    return NEWTON;
}
