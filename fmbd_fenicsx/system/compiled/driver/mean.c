/* A step of the energy-momentum scheme, (1) to (4) of schemes/onestep/energy_momentum.py: frames and maps of surfaces at the mean of
   both ends, A = (R_0 + R_1) / 2, with angular velocities A^-T w_b. Kernels of kinds then give the rows of difference quotients. */

static const double GAUSS[3] = {0.5 - 0.3872983346207417, 0.5, 0.5 + 0.3872983346207417}, SHARES[3] = {5.0 / 18, 4.0 / 9, 5.0 / 18};
static const double SLOW_RATE = 0.1, FASTEST = 1e-5, ENOUGH = 1e-9, ZERO = 1e-13;   /* as in energy_momentum.py */
static const double UNMOVED = 1e-6, KEPT = 1e-13; /* of coordinates over a step; of the length, that rows may leave of g_1 - g_0 */

/* One step of size h from q0, v0 at t: what is there at both ends, and where the newest accelerations lead. */
typedef struct {
    double t, h, length;
    const double *q0, *v0;
    double *frames[2], *maps[2], *s[2], *gap0; /* frames, maps of surfaces, coordinates of efforts; g_0 */
    double *q, *v, *middle, *w, *xi;           /* the end; between: configuration, velocity, increment */
    double *core, *inertia, *along, *missing, *share, *effort;
} Step;

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
    return 2 * (frames + mean_maps(s)) + 4 * mean_coordinates(s) + 3 * s->nq + 7 * s->nv + 4 * s->rows;
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
        k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
        for (long i = 0; i < k->n; i++) *value++ = k->out[i * k->outputs];
    }
}

/* The beginning; ``room`` is cut, what is left of it comes back. */
static int mean_begin(System *s, Step *o, double *asked, double **room)
{
    long frames = FRAME * (s->bodies + 1 + s->surfaces), maps = mean_maps(s), n = mean_coordinates(s);
    int verdict;
    for (int end = 0; end < 2; end++) {
        o->frames[end] = part_of(room, frames);
        o->maps[end] = part_of(room, maps);
        o->s[end] = part_of(room, n);
    }
    o->share = part_of(room, n), o->effort = part_of(room, n);
    o->q = part_of(room, s->nq), o->middle = part_of(room, s->nq);
    o->v = part_of(room, s->nv), o->w = part_of(room, s->nv), o->xi = part_of(room, s->nv);
    o->core = part_of(room, s->nv), o->inertia = part_of(room, s->nv), o->along = part_of(room, s->nv);
    o->gap0 = part_of(room, s->rows), o->missing = part_of(room, s->rows);

    if ((verdict = sample(s, o->t, asked)) || (verdict = place(s, o->q0, o->v0))) return verdict;
    drift(s);
    memcpy(o->gap0, s->gap, s->rows * sizeof(double));
    keep_end(s, o, 0);
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

#if DIM == 3
/* det A A^-T; det A */
static double cofactors(const double *A, double *C)
{
    for (int i = 0; i < 3; i++) moment(A + 3 * ((i + 1) % 3), A + 3 * ((i + 2) % 3), C + 3 * i);
    return dot(A, C, 3);
}

/* A^-T w */
static void spatial(const double *A, const double *w, double *out)
{
    double C[9], size = cofactors(A, C);
    times(C, w, out);
    for (int j = 0; j < 3; j++) out[j] /= size;
}

/* A^-1 m */
static void material(const double *A, const double *m, double *out)
{
    double C[9], size = cofactors(A, C);
    transposed(C, m, out);
    for (int j = 0; j < 3; j++) out[j] /= size;
}
#else
static void spatial(const double *A, const double *w, double *out) { (void)A, out[0] = w[0]; }
static void material(const double *A, const double *m, double *out) { (void)A, out[0] = m[0]; }
#endif

/* Frames, velocities and maps of surfaces at the mean of both ends. */
static void place_mean(System *s, const Step *o)
{
    const double *map[2] = {o->maps[0], o->maps[1]};
    for (int i = 0; i < FRAME * (s->bodies + 1 + s->surfaces); i++) s->frames[i] = 0.5 * (o->frames[0][i] + o->frames[1][i]);
    for (int b = 0; b < s->bodies; b++) {
        const Body *k = s->body + b;
        double *x = s->frames + FRAME * b, *velocity = s->velocity + k->at_u;
        memcpy(x + SPEED, o->w + TWIST * b, D * sizeof(double));
        spatial(x + TURN, o->w + TWIST * b + D, x + SPIN);
        memcpy(velocity, x + SPEED, TWIST * sizeof(double));
        memcpy(velocity + TWIST, o->w + k->at_v, k->modes * sizeof(double));
    }
    for (int i = 0; i < s->surfaces; i++) {
        Surface *k = s->surface + i;
        const Body *body = s->body + k->body;
        const int width = TWIST + body->modes;
        double *velocity = s->velocity + s->nu + TWIST * i;
        for (int j = 0; j < TWIST * width; j++) k->map[j] = 0.5 * (*map[0]++ + *map[1]++);
        for (int j = 0; j < TWIST; j++) velocity[j] = dot(k->map + j * width, s->velocity + body->at_u, width);
        memcpy(s->frames + FRAME * (s->bodies + 1 + i) + SPEED, velocity, TWIST * sizeof(double));
    }
}

/* Efforts N as means of the law from s_0 to s_1 at the mean rate, and the share of rows with h rows . twist = s_1 - s_0; the kernel's
   answers at the mean are there. */
static int mean_efforts(System *s, Batch *k, const Step *o, long first, double t)
{
    const double *from = o->s[0] + first, *to = o->s[1] + first, *out = k->out;
    const int *at = k->at;
    double *share = o->share + first, *sum = o->effort + first;
    for (long i = 0; i < k->n; i++, out += k->outputs, at += k->live) {
        double linear = 0.0;
        for (int e = 0; e < k->live; e++) linear += o->h * out[k->entry[e]] * s->velocity[at[e]];
        share[i] = 1.0;
        if (k->quotient == DISTANCE) share[i] = 2.0 * out[0] / (from[i] + to[i]);
        if (k->quotient == QUOTIENT && fabs(linear) > UNMOVED) share[i] = fmax(-10.0, fmin((to[i] - from[i]) / linear, 10.0));
        k->rate[i] = (to[i] - from[i]) / o->h;
        sum[i] = 0.0;
    }
    for (int g = 0; g < 3 && k->role != GIVEN; g++) {
        for (long i = 0; i < k->n; i++) {
            k->s[i] = from[i] + GAUSS[g] * (to[i] - from[i]);
            if (k->role == FORMULA) formula(k, i, t);
            if (k->role == LINEAR) k->effort[i] = k->stiffness[i] * (k->s[i] - k->free[i]) + k->damping[i] * k->rate[i];
        }
        s->calls += k->role == LAW;
        if (k->role == LAW && s->python(EFFORT, k->number, t)) return FAILED;
        add(sum, SHARES[g], k->effort, k->n);
    }
    if (k->role == GIVEN) memcpy(sum, k->effort, k->n * sizeof(double));
    for (long i = 0; i < k->n; i++) sum[i] *= share[i];
    return DONE;
}

/* Forces of one batch into the residuals, at the mean; rows are the kernel's last answers. */
static int mean_items(System *s, Batch *k, const Step *o, long first, const double *lam, double t)
{
    int verdict;
    if (k->role == MOUNT || k->role == WHOLE || k->role == READ) return items(s, k, lam, t);
    if (k->role != ROW) {
        k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
        verdict = k->quotient != POINT ? mean_efforts(s, k, o, first, t) : k->role != GIVEN ? efforts(s, k, t) : DONE;
        if (verdict) return verdict;
    }
    const double *out = k->out, *effort = k->quotient != POINT ? o->effort + first : k->effort;
    const int *at = k->at;
    for (long i = 0; i < k->n; i++, out += k->outputs, at += k->live) {
        double force = k->role == ROW ? k->factor[i] * lam[k->row[i]] : effort[i];
        for (int e = 0; e < k->live; e++) s->residual[at[e]] += force * out[k->entry[e]];
    }
    return DONE;
}

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
        add(o->core + body->at_v, 1.0, s->residual + body->at_u + TWIST, body->modes);
    }
    return DONE;
}

/* What constraints that are not of second order leave of the energy is given back by a force along the motion, (3). */
static int give_back(System *s, const Step *o, const double *a, const double *lam, double t)
{
    double work = 0.0;
    int verdict;
    if (greatest(o->missing, s->rows) <= KEPT * o->length) return DONE;
    memcpy(o->xi, a, s->nv * sizeof(double));
    add(o->xi, 1.0, o->w, s->nv);
    if ((verdict = place(s, o->middle, o->w)) || (verdict = body_forces(s, o->middle, o->w, o->xi, t))) return verdict;
    like_v(s, s->residual, o->along);
    add(o->along, -1.0, o->inertia, s->nv);
    for (int i = 0; i < s->nv; i++) work += o->h * o->w[i] * o->along[i];
    add(o->core, dot(lam, o->missing, s->rows) / fmax(work, 1e-300), o->along, s->nv);
    return DONE;
}

/* The balance (core, like v) for a and lambda, and what constraints leave open at the end. */
static int mean_residual(System *s, Step *o, double *asked, const double *a, const double *lam, double *gap)
{
    double t = o->t + 0.5 * o->h;
    int verdict;
    mean_motion(s, o, a);
    if ((verdict = sample(s, o->t + o->h, asked)) || (verdict = place(s, o->q, o->v))) return verdict;
    if (turns_freely(s)) settle_angles(s, o->q);
    drift(s);
    memcpy(gap, s->gap, s->rows * sizeof(double));
    keep_end(s, o, 1);

    if ((verdict = sample(s, t, asked)) || (verdict = place(s, o->middle, o->w))) return verdict;
    s->evaluations++;
    if ((verdict = body_forces(s, o->middle, o->w, a, t))) return verdict;
    like_v(s, s->residual, o->inertia);
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
    Step o = {t, h, length, q0, v0};
    double asked = NAN;
    int verdict = mean_begin(s, &o, &asked, &room);
    if (verdict || (verdict = mean_residual(s, &o, &asked, a, lam, gap))) return verdict;
    memcpy(core, o.core, s->nv * sizeof(double));
    return DONE;
}

/* The factor of the middle of the step. */
static int mean_prepare(System *s, const Step *o, const double *a, const double *lam, double *factored)
{
    double t = o->t + 0.5 * o->h;
    int verdict = evaluate(s, o->middle, o->w, a, lam, t);
    memcpy(factored, o->middle, s->nq * sizeof(double));
    return verdict ? verdict : prepare(s, o->middle, 0.5 * o->h, 0.25 * o->h * o->h, lam, 0, t);
}

/* Whether increments are at roundoff, fall no more close to it, or the next one would be ``nothing``. */
static int mean_over(const double *sizes, int done, double rate, double nothing)
{
    double last = sizes[done - 1];
    int stalled = done > 2 && last <= 1e-10 && last > 0.2 * sizes[done - 2];
    return last <= ZERO || stalled || (done > 1 && last <= ENOUGH && rate <= SLOW_RATE && fmax(rate, FASTEST) * last <= nothing);
}

/* a and lambda of a step, which begin as a guess, by Newton's iteration with the matrix of its middle; ``sizes`` of the increments
   over ``size``, at most so many (``done`` counts), to ``nothing``, or to ``roundoff`` where they stall. q, v: the end. NEWTON where
   this matrix does not serve: a and lambda are as far as they came. */
EXPORT int driver_mean_step(System *s, int most, double t, double h, double length, double size, double nothing, double roundoff,
                            const double *q0, const double *v0, double *a, double *lam, double *sizes, long *done, double *q,
                            double *v, double *room)
{
    Step o = {t, h, length, q0, v0};
    double asked = NAN, rate = 0.0;
    int verdict = mean_begin(s, &o, &asked, &room), anew = 1, taken = 0;
    double *x = part_of(&room, s->nv), *y = part_of(&room, s->rows), *gap = part_of(&room, s->rows), *factored = part_of(&room, s->nq);
    if (verdict) return verdict;

    for (int k = 0; k < most; k++) {
        if ((verdict = mean_residual(s, &o, &asked, a, lam, gap))) return verdict;
        if (anew && (taken++ == 2 || mean_prepare(s, &o, a, lam, factored))) return NEWTON;
        anew = 0;
        if ((verdict = place(s, factored, o.core))) return verdict;
        for (int i = 0; i < s->nu; i++) s->b[i] = -s->velocity[i];
        for (int i = 0; i < s->rows; i++) s->b[s->nu + i] = -2.0 / (h * h) * gap[i];
        solution(s, x, y);
        if (s->redundant) close_dependent(s, x, y);

        sizes[k] = largest_of(s->units, x, s->nv) / size;
        if (!(sizes[k] < INFINITY)) return NEWTON;
        add(a, 1.0, x, s->nv);
        add(lam, 1.0, y, s->rows);
        *done = k + 1;
        rate = k ? sizes[k] / fmax(sizes[k - 1], 1e-300) : 0.0;
        if ((rate > SLOW_RATE && sizes[k] <= roundoff) || mean_over(sizes, k + 1, rate, nothing)) {
            if (!(sizes[k] <= fmax(ENOUGH, roundoff))) return NEWTON;
            mean_motion(s, &o, a);
            if (turns_freely(s)) {
                if ((verdict = place(s, o.q, o.v))) return verdict;
                settle_angles(s, o.q);
            }
            memcpy(q, o.q, s->nq * sizeof(double));
            memcpy(v, o.v, s->nv * sizeof(double));
            return DONE;
        }
        anew = rate > SLOW_RATE && sizes[k] > 1e-11;
    }
    return NEWTON;
}
