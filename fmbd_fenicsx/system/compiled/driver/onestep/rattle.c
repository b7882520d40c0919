/* RATTLE: the algorithm of schemes/onestep/rattle.py, many steps in one call (march.c). */

enum { PATIENT_WITH_MASSES = 4 }; /* iterations with the masses alone, before the matrix knows of damping */

/* What it keeps with a state: multipliers of the last second half step (rows); by how much a (nv) and lambda (rows) of the last first
   half step differed from those at its beginning, a second of step; whether forces depend on velocities so much that the matrix has to
   know them; whether it is factored there, with the masses alone. */
typedef struct {
    double *half, *a, *lam, *damped, *factored;
} Ahead;

static Ahead ahead_at(const System *s, double *own)
{
    Ahead o = {own, own + s->rows, own + s->rows + s->nv, own + 2 * s->rows + s->nv, own + 2 * s->rows + s->nv + 1};
    return o;
}

/* (1): a and lambda of the first half step. */
static int first_half(System *s, double *p, const Block *now, double *push, double *force, long *solves, double *room)
{
    const Ahead o = ahead_at(s, now->own);
    const double h = p[H], t[2] = {*now->t, *now->t + h}, share = 0.5 * h * h;
    double *way = room, damp = 0.5 * h * *o.damped, typical_a = fmax(largest_of(s->units, now->a, s->nv), 1e-300);
    for (int i = 0; i < s->nv; i++) push[i] = now->a[i] + h * o.a[i];
    /* the smallest multipliers of dependent rows have none that grow from step to step */
    for (int i = 0; i < s->rows; i++) force[i] = s->redundant ? now->lam[i] : now->lam[i] + h * o.lam[i];
    for (int i = 0; i < s->nv; i++) way[i] = h * now->v[i];

    double tolerance = small(s, p, now->q, share * typical_a) / share;
    int factored = *o.factored != 0.0 && damp == 0.0;
    Stage half = {t, now->q, now->v, now->q, way, 0.5 * h, share, damp, 0.0, tolerance, 1, factored};
    return solve_stage(s, &half, p, push, force, solves, way + s->nv);
}

/* One step, as a Maker of march.c; ``room``: 3 nv + rows, and that of a stage or of accelerations. */
static int rattle_step(System *s, double *p, double *room, const Block *past, int known, Block out)
{
    const int n = s->nv, m = s->rows;
    const Block now = past[0];
    const double h = p[H], t = *now.t + h, end[2] = {t, t};
    double *push = room, *force = push + n, *way = force + m, *rest = way + n, last = NAN;
    long solves = 0, more = 0;
    int verdict;
    (void)known;

    /* v at the middle, q at the end */
    if ((verdict = first_half(s, p, &now, push, force, &solves, way))) return verdict;
    memcpy(out.v, now.v, n * sizeof(double));
    add(out.v, 0.5 * h, push, n);
    for (int i = 0; i < n; i++) way[i] = h * out.v[i];
    configuration(s, now.q, way, out.q);

    const Ahead before = ahead_at(s, now.own), next = ahead_at(s, out.own);
    for (int i = 0; i < n; i++) next.a[i] = (push[i] - now.a[i]) / h;
    for (int i = 0; i < m; i++) next.lam[i] = (force[i] - now.lam[i]) / h;
    *next.damped = *before.damped != 0.0 || solves > PATIENT_WITH_MASSES;

    /* v at the end */
    memcpy(push, now.a, n * sizeof(double));
    memcpy(next.half, before.half, m * sizeof(double));
    double nothing = MOVES_NOTHING * p[LENGTH] / (h * h);
    Stage other = {end, out.q, out.v, out.q, out.v, 0.0, 0.5 * h, 0.0, nothing, 0.0, 0, 0};
    if ((verdict = solve_stage(s, &other, NULL, push, next.half, &more, rest))) return verdict;
    add(out.v, 0.5 * h, push, n);
    if ((verdict = sample(s, t, &last))) return verdict;

    if ((verdict = accelerate(s, t, p[LENGTH], out.q, out.v, out.a, out.lam, rest, 1))) return verdict;
    *out.t = t;
    *next.factored = 1.0;
    p[ITERATIONS] += solves;
    return DONE;
}
