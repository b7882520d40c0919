/* Velocities and impulses of a part of a Moreau step, equations (1) to (3) of schemes/impacts/moreau.py, and the works of both. */

static const double ADDED = 1e-9, CLOSE = 1e-10, NARROW = 1e-12; /* as in restitution.py */
static const double SHARPLY = 1e-4; /* of the tolerance: what iterations leave of velocities */
enum { TRIED = 40, NEW_MATRICES = 10 }; /* matrices anew: as many as schemes/newton.py takes tangents in a step */

/* The turns of all bodies in the place of those that compliances were found at, and back. */
static void swap_turns(System *s, Contacts *c)
{
    double *kept = c->turns;
    for (int b = 0; b < s->bodies; b++, kept += D * D) {
        double now[D * D], *turn = s->frames + FRAME * b + TURN;
        memcpy(now, turn, sizeof now);
        memcpy(turn, kept, sizeof now);
        memcpy(kept, now, sizeof now);
    }
}

/* Moments on bodies in b, along the same axes of their bodies where the matrix is from: only so they balance those of contacts,
   whose rows are from there too. */
static void carry_moments(System *s, const Contacts *c)
{
    for (int b = 0; b < s->bodies; b++) {
        double *moment = s->b + s->body[b].at_u + D, own[ROT];
        to_body(s->frames + FRAME * b + TURN, moment, own);
        to_world(c->turns + D * D * b, own, moment);
    }
}

/* What forces of all closed contacts do, added to x and y; on velocities it is in c->push then. Bodies are turned as where the
   matrix is from: forces that do nothing together, since contacts depend on each other, do so at the turns of their rows only. */
static void add_push(System *s, Contacts *c, const double *f, double *x, double *y)
{
    double *more = c->push + s->nv;
    memset(s->b, 0, (s->nu + s->rows) * sizeof(double));
    for (int k = 0; k < c->all.m * c->components; k++) push_row(s, c, k, f[k]);
    solution(s, c->push, more);
    add(x, 1.0, c->push, s->nv);
    add(y, 1.0, more, s->rows);
}

/* The forces of group g as a problem of their own. */
static Problem problem_of(const Contacts *c, int g)
{
    const int d = c->components, from = c->graph.group[g];
    const Problem *all = &c->all;
    return (Problem){
        .m = c->graph.group[g + 1] - from, .near = all->near, .slot = all->slot, .behind = all->behind, .W = all->W,
        .first = all->first + from, .start = all->start + from, .own = all->own + from * d * d,
        .q = all->q + from * d, .u = all->u + from * d, .f = all->f + from * d, .mu = all->mu + from,
        .held = all->held + from * d, .opened = all->opened + from * d, .change = all->change + from * d,
    };
}

/* Impulses of all closed contacts from ``start``, under which they open by c->open; 1 where they are not found. Groups that do not
   move each other are problems of their own: what is hard in one heap is not asked of all. */
static int impulses(Contacts *c, const double *start)
{
    const size_t size = c->all.m * c->components * sizeof(double);
    memcpy(c->all.f, start, size);
    memcpy(c->all.u, c->open, size);
    for (int g = 0; g < c->graph.groups; g++) {
        Problem group = problem_of(c, g);
        if (!contact_forces(c, &group, g) || !frictional_forces(c, &group)) continue;
        c->unsolved = group.m;
        return 1;
    }
    return 0;
}

/* A change of the openings along the normal of the closed contact k, whatever forces act. */
static void open_by(Contacts *c, int k, double change)
{
    c->all.q[k * c->components] += change;
    c->open[k * c->components] += change;
}

/* The rebound of the closed contact k with a share of those that approach. */
static double shared(const Contacts *c, int k, double share)
{
    return c->rebound[k] < 0.0 ? share * c->rebound[k] : c->rebound[k];
}

/* The work that the impulses c->all.f do on the contacts in an impact with a share of the rebound, and in ``size`` that of their sizes. */
static double work_of_impact(const Contacts *c, double share, double *size)
{
    const int d = c->components, n = c->all.m * d;
    double work = 0.0;
    *size = 0.0;
    for (int k = 0; k < n; k++) {
        double after = c->all.u[k] - (k % d ? 0.0 : shared(c, k / d, share));
        work += 0.5 * c->all.f[k] * (c->before[k] + after);
        *size += 0.5 * fabs(c->all.f[k]) * (fabs(c->before[k]) + fabs(after));
    }
    return work;
}

/* Impulses with the largest share of the rebound by which an impact adds no energy, as schemes/impacts/restitution.py finds it; the
   rebound is what is left of it. 1 where they are not found. */
static int lawful_impulses(Contacts *c, const double *start)
{
    const int m = c->all.m;
    double lower = 0.0, upper = 1.0, share = 1.0, least = 0.0, most, size, work;
    int bounces = 0, side = 0;
    if (impulses(c, start)) return 1;
    for (int k = 0; k < m; k++) bounces |= c->bouncing[c->closed[k]] && c->rebound[k] < 0.0;
    if (!bounces) return 0;
    most = work_of_impact(c, 1.0, &size);
    if (!(most > ADDED * size)) return 0;

    /* without a rebound energy is lost; then secants that halve the work of an end which stays */
    for (int round = 0; round <= TRIED && upper - lower > NARROW; round++) {
        double next = round ? upper - most * (upper - lower) / (most - least) : 0.0;
        if (round && !(next > lower && next < upper)) next = 0.5 * (lower + upper);
        for (int k = 0; k < m; k++) open_by(c, k, shared(c, k, next) - shared(c, k, share));
        share = next;
        if (impulses(c, start)) return 1;
        work = work_of_impact(c, share, &size);

        if (!round) {
            least = work;
            if (work > -CLOSE * size) break;
        } else if (work > 0.0) {
            upper = share, most = work;
            if (side > 0) least *= 0.5;
            side = 1;
        } else {
            lower = share, least = work;
            if (work > -CLOSE * size) break;
            if (side < 0) most *= 0.5;
            side = -1;
        }
    }

    if (share != lower) {
        for (int k = 0; k < m; k++) open_by(c, k, shared(c, k, lower) - shared(c, k, share));
        if (impulses(c, start)) return 1;
    }
    for (int k = 0; k < m; k++) {
        c->rate[c->closed[k]] -= c->rebound[k] - shared(c, k, lower);
        c->rebound[k] = shared(c, k, lower);
    }
    return 0;
}

/* A part of a step: its length h, that of the whole step, and the time in its middle, s. */
typedef struct {
    double h, span, middle;
} Part;

/* Velocities halfway through the step, in ``vm``. */
static void take_middle(const System *s, Block now, Block out, double *vm)
{
    for (int i = 0; i < s->nv; i++) vm[i] = 0.5 * (now.v[i] + out.v[i]);
}

/* The residual in the middle of the step, behind so many iterations, and the matrix, where it is to be taken ``anew`` or laws have
   other slopes. */
static int evaluate_middle(System *s, Contacts *c, Part o, Block now, Block out, int done, int anew)
{
    double *vm = s->work, *xi = vm + s->nv;
    int verdict;
    take_middle(s, now, out, vm);
    for (int i = 0; i < s->nv; i++) {
        xi[i] = 0.5 * o.h * vm[i];
        out.a[i] = (out.v[i] - now.v[i]) / o.h;
    }
    configuration(s, now.q, xi, out.q);
    if ((verdict = evaluate_iterate(s, done, out.q, vm, out.a, out.lam, o.middle))) return verdict;
    if (!anew && !(s->stiff && (s->bridged || other_slopes(s, 0.5 * o.h, 0.25 * o.h * o.h)))) return DONE;

    if ((verdict = prepare(s, out.q, 0.5 * o.h, 0.25 * o.h * o.h, now.lam, 0, o.middle))) return verdict;
    for (int b = 0; b < s->bodies; b++) memcpy(c->turns + D * D * b, s->frames + FRAME * b + TURN, D * D * sizeof(double));
    if (c->all.m) own_compliance(s, c, c->all.m);
    return DONE;
}

/* Increments of velocities and multipliers (times h), x and y: those for b without impulses, and what these add to it. */
static int add_impulses(System *s, Contacts *c, Part o, Block out, double *x, double *y)
{
    const int m = c->all.m, n = m * c->components, d = c->components, *closed = c->closed;
    double *change = c->old;
    solution(s, x, y);
    if (!m) return DONE;

    /* what that leaves of the contacts, without impulses and with those of the iteration before */
    for (int k = 0; k < n; k++) {
        int i = closed[k / d];
        const double *row = c->rows + 2 * c->wide * k;
        c->all.q[k] = along(c, i, row, out.v) + along(c, i, row, x) - c->drift[k] / o.span + (k % d ? 0.0 : c->rate[i]);
    }
    add_push(s, c, c->all.f, x, y);
    for (int k = 0; k < n; k++) c->open[k] = c->all.q[k] + along(c, closed[k / d], c->rows + 2 * c->wide * k, c->push);

    memcpy(change, c->all.f, n * sizeof(double));
    if (lawful_impulses(c, change)) return LOOK;
    for (int k = 0; k < n; k++) change[k] = c->all.f[k] - change[k];
    add_push(s, c, change, x, y);
    return DONE;
}

/* The same from the residual evaluated last. */
static int increments_with_impulses(System *s, Contacts *c, Part o, Block now, Block out, double *x, double *y)
{
    double *vm = s->work;
    take_middle(s, now, out, vm);
    turn_velocity(s, vm);
    if (s->rows) slips(s, 1);
    for (int i = 0; i < s->nu; i++) s->b[i] = -o.h * s->residual[i];
    for (int i = 0; i < s->rows; i++) s->b[s->nu + i] = -2.0 * s->slip[i];

    carry_moments(s, c);
    swap_turns(s, c);
    const int verdict = add_impulses(s, c, o, out, x, y);
    swap_turns(s, c);
    return verdict;
}

/* The step of length h with the closed contacts: velocities in out.v, multipliers in out.lam, impulses in c->all.f. */
static int velocities(System *s, Contacts *c, double *p, Block now, Block out, int m, double h, double span)
{
    const Part o = {h, span, *now.t + 0.5 * h};
    const double speed = fmax(largest_of(s->units, now.v, s->nv), 1e-6 * p[LENGTH] / span);
    double *x = s->work + 2 * s->nv, *y = x + s->nv, sizes[MOST], left = 0.0;
    int done = 0, verdict, converged = 0, anew = 1, matrices = 0;
    c->all.m = m;
    c->rough = SHARPLY * p[TOL] * speed;

    memcpy(out.v, now.v, s->nv * sizeof(double));
    /* of dependent rows the smallest multipliers are found from none */
    if (s->redundant) memset(out.lam, 0, s->rows * sizeof(double));
    else memcpy(out.lam, now.lam, s->rows * sizeof(double));

    while (done < (int)p[MAXIT] && done < MOST && !converged) {
        if ((verdict = evaluate_middle(s, c, o, now, out, done, anew))) return verdict;
        memcpy(c->kept, out.lam, s->rows * sizeof(double));
        c->done = done;
        if ((verdict = increments_with_impulses(s, c, o, now, out, x, y))) return verdict;

        add(out.v, 1.0, x, s->nv);
        add(out.lam, 1.0 / h, y, s->rows);
        const double size_v = fmax(largest_of(s->units, out.v, s->nv), speed);
        sizes[done++] = largest_of(s->units, x, s->nv) / (SHARPLY * p[TOL] * size_v);
        converged = judge(p, sizes, done, &left);
        if (s->bridged && sizes[done - 1] < INFINITY) converged = 0;
        if (s->redundant && done == 1 && converged > 0) converged = 0; /* the first solution leaves epsilon y open */

        /* stresses of the first iterate, where the matrix is from, may be far from those of the middle */
        anew = sizes[done - 1] < INFINITY && matrices < NEW_MATRICES && lingers(p, done, left);
        if (anew) {
            matrices++;
            converged = 0;
            p[THETA] = 0.1;
        }
        if (converged < 0) return NEWTON;
    }
    p[ITERATIONS] += done;
    p[LEFT] += left;
    c->tally.iterated++;
    c->done = done;
    return converged ? DONE : NEWTON;
}

/* What closes joints, for rows in b: along the axes that bodies have where the matrix is from. */
static void closing(System *s, Contacts *c, double *x, double *y)
{
    swap_turns(s, c);
    solution(s, x, y);
    swap_turns(s, c);
}

/* Positions closed to roundoff by the matrix of the step. */
static int closed_rows(System *s, Contacts *c, double *p, double *q, const double *v, double t)
{
    double *x = s->work, *y = x + s->nv, *moved = c->ahead;
    if (!s->rows) return DONE;
    if (s->samples && s->python(SAMPLE, 0, t)) return FAILED;

    for (int round = 0; round < 3; round++) {
        double widest = 0.0;
        int verdict = place(s, q, v);
        if (verdict) return verdict;
        for (int i = 0; i < s->rows; i++) s->gap[i] = -s->motion[i];
        for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
            if (k->role != ROW) continue;
            k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
            for (long i = 0; i < k->n; i++) s->gap[k->row[i]] += k->factor[i] * k->out[i * k->outputs];
        }

        for (int i = 0; i < s->rows; i++) widest = fmax(widest, fabs(s->gap[i]));
        if (widest <= 1e-13 * p[LENGTH]) break;
        memset(s->b, 0, s->nu * sizeof(double));
        for (int i = 0; i < s->rows; i++) s->b[s->nu + i] = -s->gap[i];
        closing(s, c, x, y);
        configuration(s, q, x, moved);
        memcpy(q, moved, s->nq * sizeof(double));
    }
    return DONE;
}

/* Velocities projected on those of the joints, by the matrix of the step; frames are placed at them. */
static void closed_rates(System *s, Contacts *c, double *v)
{
    double *x = s->work, *y = x + s->nv;
    slips(s, 1);
    memset(s->b, 0, s->nu * sizeof(double));
    for (int i = 0; i < s->rows; i++) s->b[s->nu + i] = -s->slip[i];
    closing(s, c, x, y);
    add(v, 1.0, x, s->nv);
}

/* Works of contacts, friction, loads and joints over the increment of a step; frames are those of its middle. */
static void add_works(System *s, Contacts *c, Block now, Block out, const double *xi, const int *closed, int m, const double *kept, double h)
{
    const int d = c->components;
    double work[4] = {0.0, 0.0, 0.0, 0.0}, total, own;
    for (int k = 0; k < m * d; k++) work[k % d > 0] += c->all.f[k] / h * along(c, closed[k / d], c->rows + 2 * c->wide * k, xi);

    /* of loads: what is left of the balance without inertia and reactions, at the mean velocity, which rods with damping see */
    double *vm = s->work;
    for (int i = 0; i < s->nv; i++) vm[i] = 0.5 * (now.v[i] + out.v[i]);
    turn_velocity(s, vm);
    if (s->rows) slips(s, 0);
    for (int i = 0; i < s->rows; i++) work[3] -= h * out.lam[i] * s->slip[i];
    if (c->loaded) {
        total = dot(s->residual, s->velocity, s->nu) - (s->rows ? dot(kept, s->slip, s->rows) : 0.0);
        inertia(s, s->q, vm, out.a, *now.t + h);
        own = dot(s->residual, s->velocity, s->nu);
        work[2] = h * (own - total);
    }

    for (int i = 0; i < 4; i++) c->works[i] += work[i];
    c->works[4] -= work[0] + work[1] + work[2] + work[3];
}
