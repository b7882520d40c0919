/* Steps of Radau, and constant ones of BDF, schemes/onestep/stage_newton.py and schemes/multistep/corrector.py, many in one call (march.c):
   in local coordinates about the start of a step, for systems whose stage systems have patterns. */

/* What stands here has the same order in ``Implicit`` of system/compiled/implicit.py. Coefficients are those of the scheme. */
typedef struct {
    Stages *stages;
    const Patterns *patterns;
    Convergence *convergence;        /* what it says of the scheme's iterations stays, the rest is of a step */
    double *data, *masses, *room, *mixed; /* of the tangent; of M; work of a tangent and of a step */
    const double *c, *W, *values, *middle, *basis, *stage_basis; /* of Radau */
    int order;                       /* of BDF */
    double factored;                 /* size of step (Radau) or frequency (BDF) that the tangent is factored for, 0: none */
    double failed;                   /* increments of steps that failed */
    struct OwnSteps *own;            /* where error control chooses the steps of Radau, NULL: they are constant; see own_steps.c */
    double rtol, floor, slow, longer; /* of Newton's increments; m; rate above which the next step takes a tangent; see first_share() */
} Implicit;

/* What a state keeps first: rate of Newton's iteration; whether the tangent serves the next step; and since the march began: tangents,
   factors, increments, the largest linear residual and its scale. */
enum { RATE, KNOWN, TANGENTS, FACTORED, INCREMENTS_MADE, RESIDUAL, RESIDUAL_SCALE, WORK };

static Implicit *implicit_in(double *room)
{
    Implicit *o;
    memcpy(&o, room, sizeof o);
    return o;
}

/* A tangent at a state with these multipliers, where the one at hand does not serve. */
static int take_tangent(System *s, Implicit *o, double t, const double *q, const double *v, const double *a, const double *lam,
                        double length, double *work)
{
    o->factored = 0.0;
    int verdict = driver_stage_tangent(s, o->patterns, length, t, q, v, a, lam, o->masses, o->stages->W.data, o->room, o->data);
    work[TANGENTS] += 1.0;
    return verdict;
}

/* Factors of the frequencies of the stages, which ``key`` stands for. */
static int take_factors(Implicit *o, double key, double *work)
{
    if (o->factored == key) return DONE;
    o->factored = 0.0;
    int verdict = driver_stage_factors(o->stages, o->patterns, o->data);
    if (!verdict) o->factored = key;
    work[FACTORED] += o->stages->frequencies;
    return verdict;
}

/* Newton's iteration of a step from a state on, with the rate so far; ``first``: what one increment leaves. */
static int iterate_step(System *s, Implicit *o, double *p, const Block *now, double first, double *work)
{
    Convergence *c = o->convergence;
    const double h = p[H], typical = fmax(largest_of(s->units, now->a, s->nv), 1e-3 * largest_of(s->units, now->v, s->nv) / h);
    c->h = h;
    c->allowed = fmax(o->rtol * h * h * typical, o->floor);
    c->theta = work[RATE];
    c->first = first;
    c->size = 0.0;
    c->done = 0;
    c->outcome = GOES_ON;

    int verdict = driver_stage_iterate(s, o->stages, c, c->most);
    const double *judged = o->stages->judged;
    if (!verdict && (c->outcome != CONVERGED || !(judged[0] <= c->accurate * judged[1]))) verdict = NEWTON;
    if (verdict) {
        o->failed += c->done;
        return verdict;
    }
    farthest_apart(judged, work + RESIDUAL);
    work[INCREMENTS_MADE] += c->done;
    work[RATE] = c->theta;
    work[KNOWN] = c->theta <= o->slow;
    p[ITERATIONS] += c->done;
    p[LEFT] += c->share * c->size;
    return DONE;
}

/* Of the multipliers of all levels the smallest with their forces in a configuration, where rows depend. ``room``: 2 nv + rows. */
static int least_of_levels(System *s, const Stages *g, double t, const double *q, double *mult, double *room)
{
    return s->redundant && g->levels ? driver_least(s, 0, t, g->levels, q, mult, room) : DONE;
}

/* y = A x of k rows of n numbers, for a matrix of k columns. */
static void combine(int rows, int k, const double *A, int n, const double *x, double *y)
{
    memset(y, 0, (size_t)rows * n * sizeof(double));
    for (int j = 0; j < rows; j++)
        for (int i = 0; i < k; i++) add(y + (long)j * n, A[j * k + i], x + (long)i * n, n);
}

/* The end of a step at the last of the points. */
static void end_implicit(System *s, const Implicit *o, const double *p, const Block *now, const double *mult, Block out)
{
    const Stages *g = o->stages;
    const int n = g->n, last = g->points - 1;
    *out.t = *now->t + p[H];
    configuration(s, now->q, g->xi + (long)last * n, out.q);
    memcpy(out.v, g->v + (long)last * n, n * sizeof(double));
    memcpy(out.a, g->vd + (long)last * n, n * sizeof(double));
    memcpy(out.lam, mult, s->rows * sizeof(double));
    memset(out.A, 0, n * sizeof(double));
}

/* ---- Radau ---- */

/* What it keeps with a state beside its work: what the last increment of Newton's iteration left, over its size, and the size of the step
   in which that was seen; of error control the size of the next step, of the one ``before`` and what it ``missed``; the step that led
   there: its size (0: none), q (nq) and v (nv) at its start, its stages. The multipliers of the last of these are those of the state. */
typedef struct {
    double *share, *seen, *next, *before, *missed, *h, *q, *v, *xi, *vs, *mult;
} Collocation;

static Collocation collocation_at(const System *s, const Stages *g, double *own)
{
    const long k = g->points, n = g->n;
    double *x = own + WORK, *q = x + 6, *v = q + s->nq, *xi = v + n, *vs = xi + k * n;
    Collocation o = {x, x + 1, x + 2, x + 3, x + 4, x + 5, q, v, xi, vs, vs + k * n};
    return o;
}

/* What one increment leaves of the error, by the rate of the step before. */
static double first_share(const Implicit *o, const Collocation *last, double h)
{
    return h <= o->longer * *last->seen ? pow(fmax(*last->share, 1e-16), 0.8) : 1.0;
}

/* Stages on the polynomial of the last step, or on the parabola at the start. */
static void foretell_stages(const System *s, Implicit *o, double h, const Block *now, const Collocation *last)
{
    Stages *g = o->stages;
    const int n = g->n, k = g->points, width = g->size - n;
    if (*last->h == 0.0) {
        for (int j = 0; j < k; j++) {
            double x = o->c[j] * h, *xi = g->xi + j * n, *v = g->v + j * n;
            for (int i = 0; i < n; i++) {
                xi[i] = x * now->v[i] + 0.5 * x * x * now->a[i];
                v[i] = now->v[i] + x * now->a[i];
            }
            memcpy(g->mult + j * width, last->mult + (k - 1) * width, width * sizeof(double));
        }
        return;
    }
    double *ahead = o->mixed, *there = ahead + n;
    for (int j = 0; j < k; j++) {
        double term[8], basis[8], levels[8], x = 1.0 + o->c[j] * h / *last->h, *xi = g->xi + j * n, *v = g->v + j * n;
        term[0] = 1.0;
        for (int i = 0; i < k; i++) term[i + 1] = x * term[i];
        combine(1, k + 1, term, k + 1, o->basis, basis);
        combine(1, k, term, k, o->stage_basis, levels);

        combine(1, k, basis + 1, n, last->xi, ahead);
        configuration(s, last->q, ahead, there);
        add(ahead, -1.0, last->xi + (k - 1) * n, n);
        driver_difference(s, 1, now->q, 0, there, 0, ahead, 0, xi);
        memcpy(v, last->v, n * sizeof(double));
        for (int l = 0; l < k; l++)
            for (int i = 0; i < n; i++) v[i] += basis[l + 1] * (last->vs[l * n + i] - last->v[i]);
        combine(1, k, levels, width, last->mult, g->mult + j * width);
    }
}

/* v - v_n of the stages, in ``change``, and rates of both. */
static void rates_of_stages(const Implicit *o, const Block *now, double *change)
{
    Stages *g = o->stages;
    const int n = g->n, k = g->points;
    for (int j = 0; j < k; j++)
        for (int i = 0; i < n; i++) change[j * n + i] = g->v[j * n + i] - now->v[i];
    combine(k, k, g->couple, n, g->xi, g->rate);
    combine(k, k, g->couple, n, change, g->vd);
}

/* Tangent in the middle of the step as foretold, where it serves all stages best. ``change``: v - v_n. */
static int middle_tangent(System *s, Implicit *o, const double *p, const Block *now, const double *change, double *work)
{
    const Stages *g = o->stages;
    const int n = g->n, k = g->points, width = g->size - n;
    double *v = o->mixed + k * n, *a = v + n, *xi = a + n, *mult = xi + n, *q = mult + width;
    memcpy(v, now->v, n * sizeof(double));
    memset(a, 0, n * sizeof(double));
    memset(mult, 0, width * sizeof(double));
    combine(1, k, o->middle, n, g->xi, xi);
    for (int j = 0; j < k; j++) {
        add(v, o->middle[j], change + j * n, n);
        add(a, 1.0 / k, g->vd + j * n, n);
        add(mult, 1.0 / k, g->mult + j * width, width);
    }
    configuration(s, now->q, xi, q);
    return take_tangent(s, o, *now->t + 0.5 * p[H], q, v, a, mult, p[LENGTH], work);
}

/* The stages of a step, by Newton's iteration. */
static int stages_of_step(System *s, double *p, Implicit *o, const Block *now, Block out)
{
    Stages *g = o->stages;
    const int k = g->points;
    const Collocation last = collocation_at(s, g, now->own);
    const double h = p[H];
    double *change = o->mixed, *work = out.own;
    int verdict;

    memcpy(work, now->own, WORK * sizeof(double));
    memcpy(g->q0, now->q, s->nq * sizeof(double));
    for (int j = 0; j < k; j++) g->t[j] = *now->t + h * o->c[j];
    for (int i = 0; i < k * k; i++) g->couple[i] = o->W[i] / h;
    for (int i = 0; i < 2 * g->frequencies; i++) g->s[i] = o->values[i] / h;
    foretell_stages(s, o, h, now, &last);
    rates_of_stages(o, now, change);
    if (work[KNOWN] == 0.0 && (verdict = middle_tangent(s, o, p, now, change, work))) return verdict;
    if ((verdict = take_factors(o, h, work))) return verdict;
    return iterate_step(s, o, p, now, first_share(o, &last, h), work);
}

/* The state at the end of the stages, and what is kept of them. */
static int end_radau(System *s, Implicit *o, const double *p, const Block *now, Block out)
{
    const Stages *g = o->stages;
    const int n = g->n, k = g->points, width = g->size - n;
    const Collocation last = collocation_at(s, g, now->own), made = collocation_at(s, g, out.own);
    const Convergence *c = o->convergence;
    int verdict;
    *made.share = c->share;
    *made.seen = c->done > 1 ? p[H] : fmax(p[H], *last.seen);
    *made.h = p[H];
    rates_of_stages(o, now, o->mixed);
    for (int j = 0; s->redundant && j < k; j++) {
        double *q = o->mixed, *rest = q + s->nq;
        configuration(s, now->q, g->xi + j * n, q);
        if ((verdict = least_of_levels(s, g, g->t[j], q, g->mult + j * width, rest))) return verdict;
    }
    memcpy(made.q, now->q, s->nq * sizeof(double));
    memcpy(made.v, now->v, n * sizeof(double));
    memcpy(made.xi, g->xi, (size_t)k * n * sizeof(double));
    memcpy(made.vs, g->v, (size_t)k * n * sizeof(double));
    memcpy(made.mult, g->mult, (size_t)k * width * sizeof(double));
    end_implicit(s, o, p, now, g->mult + (k - 1) * width, out);
    return DONE;
}

#include "own_steps.c"

/* One step, as a Maker of march.c. */
static int radau_step(System *s, double *p, double *room, const Block *past, int known, Block out)
{
    Implicit *o = implicit_in(room);
    const Block *now = past;
    (void)known;
    if (o->own) return own_radau_step(s, p, o, now, out);
    int verdict = stages_of_step(s, p, o, now, out);
    return verdict ? verdict : end_radau(s, o, p, now, out);
}

/* ---- BDF ---- */

enum { ORDERS = 5 };

/* What it keeps with a state beside its work: its own multipliers; how many values before it are known, at most as many as
   the order, and these, the newest first: t, q (nq), v (nv), multipliers. */
typedef struct {
    double *mult, *count, *values;
} Memories;

static Memories memories_at(const Stages *g, double *own)
{
    double *mult = own + WORK, *count = mult + g->size - g->n;
    Memories o = {mult, count, count + 1};
    return o;
}

/* Numbers of a value. */
static long length_of_value(const System *s, const Stages *g) { return 1 + s->nq + g->size; }

/* The newest values in coordinates about the first: ``xi``, count x n; their v and multipliers where they stand. */
static void local_values(const System *s, const Stages *g, int count, const Block *now, const Memories *m, const double **v,
                         const double **mult, double *t, double *xi, double *guess)
{
    const long size = length_of_value(s, g);
    memset(guess, 0, g->n * sizeof(double));
    memset(xi, 0, g->n * sizeof(double));
    t[0] = *now->t;
    v[0] = now->v;
    mult[0] = m->mult;
    for (int j = 1; j < count; j++) {
        const double *value = m->values + (j - 1) * size, *q = value + 1;
        t[j] = value[0];
        v[j] = q + s->nq;
        mult[j] = v[j] + g->n;
        /* the way back by the trapezoid rule tells how many turns lie between */
        for (int i = 0; i < g->n; i++) guess[i] += 0.5 * (t[j] - t[j - 1]) * (v[j][i] + v[j - 1][i]);
        driver_difference(s, 1, now->q, 0, q, 0, guess, 0, xi + (long)j * g->n);
    }
}

/* Lagrange polynomials of so many times at t. */
static void lagrange(int count, double *times, double t, double *w)
{
    Block at[ORDERS + 1];
    for (int i = 0; i < count; i++) at[i].t = times + i;
    predictor(at, count - 1, t, w);
}

/* The new values as the past foretells them, into the point; returns c_0 of (1) in corrector.py. */
static double foretell_point(const System *s, Implicit *o, const Block *now, const Memories *m, double t)
{
    Stages *g = o->stages;
    const int n = g->n, width = g->size - n, k = o->order;
    const int ahead = (int)fmin(k + 1, *m->count + 1), few = k < 3 ? k : 3;
    const double *v[ORDERS + 1], *mult[ORDERS + 1];
    double times[ORDERS + 1], w[ORDERS + 1], c[ORDERS + 1], c0 = 0.0, *xi = o->mixed, *guess = xi + (ORDERS + 1) * n;
    local_values(s, g, ahead, now, m, v, mult, times, xi, guess);

    lagrange(few, times, t, w);
    memset(g->mult, 0, width * sizeof(double));
    for (int j = 0; j < few; j++) add(g->mult, w[j], mult[j], width);
    lagrange(ahead, times, t, w);
    memset(g->xi, 0, n * sizeof(double));
    memset(g->v, 0, n * sizeof(double));
    for (int j = 0; j < ahead; j++) {
        add(g->xi, w[j], xi + j * n, n);
        add(g->v, w[j], v[j], n);
    }

    lagrange(k, times, t, c);
    for (int j = 0; j < k; j++) c0 -= c[j] /= times[j] - t;
    for (int i = 0; i < n; i++) {
        g->rate[i] = c0 * g->xi[i];
        g->vd[i] = c0 * g->v[i];
    }
    for (int j = 0; j < k; j++) {
        add(g->rate, c[j], xi + j * n, n);
        add(g->vd, c[j], v[j], n);
    }
    return c0;
}

/* The newest values of the next step. */
static void remember_value(const System *s, const Implicit *o, const Block *now, const Memories *m, const Memories *made)
{
    const Stages *g = o->stages;
    const long size = length_of_value(s, g);
    const int kept = (int)fmin(o->order - 1, *m->count);
    double *to = made->values;
    to[0] = *now->t;
    memcpy(to + 1, now->q, s->nq * sizeof(double));
    memcpy(to + 1 + s->nq, now->v, g->n * sizeof(double));
    memcpy(to + 1 + s->nq + g->n, m->mult, (g->size - g->n) * sizeof(double));
    memcpy(to + size, m->values, (size_t)(kept * size) * sizeof(double));
    *made->count = kept + 1;
}

/* One step, likewise. */
static int bdf_step(System *s, double *p, double *room, const Block *past, int known, Block out)
{
    Implicit *o = implicit_in(room);
    Stages *g = o->stages;
    const Block now = past[0];
    const Memories m = memories_at(g, now.own), made = memories_at(g, out.own);
    const double t = *now.t + p[H];
    double *q = o->mixed, *rest = q + s->nq, *work = out.own;
    int verdict;
    (void)known;

    memcpy(work, now.own, WORK * sizeof(double));
    memcpy(g->q0, now.q, s->nq * sizeof(double));
    g->t[0] = t;
    g->relax = 1.0;
    g->couple[0] = g->s[0] = foretell_point(s, o, &now, &m, t);
    if (work[KNOWN] == 0.0) {
        configuration(s, now.q, g->xi, q);
        verdict = take_tangent(s, o, t, q, g->v, g->vd, g->mult, p[LENGTH], work);
        if (verdict) return verdict;
    }
    if ((verdict = take_factors(o, g->s[0], work))) return verdict;
    if ((verdict = iterate_step(s, o, p, &now, 1.0, work))) return verdict;

    configuration(s, now.q, g->xi, q);
    if ((verdict = least_of_levels(s, g, t, q, g->mult, rest))) return verdict;
    memcpy(made.mult, g->mult, (g->size - g->n) * sizeof(double));
    remember_value(s, o, &now, &m, &made);
    end_implicit(s, o, p, &now, g->mult, out);
    return DONE;
}
