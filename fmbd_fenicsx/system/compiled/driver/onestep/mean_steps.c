/* Steps of the energy-momentum scheme, schemes/onestep/conserving/energy_momentum.py, many in one call (march.c): without fields. */

/* What it keeps with a state, of the step that led there: time of its middle, and over it the means of accelerations (nv) and of
   multipliers (rows); through how many means the polynomial goes that would have told the newest best. */
typedef struct {
    double *t, *through, *a, *lam;
} Means;

static Means means_at(const System *s, double *own)
{
    Means o = {own, own + 1, own + 2, own + 2 + s->nv};
    return o;
}

/* What its room begins with: increments at most; the angle by which bodies may turn in a step; when iterations end, as mean.c has it,
   but for what depends on the state. */
enum { INCREMENTS, TURNS, ENDS, HEAD = ENDS + 10 };

/* The polynomial through so many of the means, the newest first, at t. */
static void foretold(const System *s, const Block *past, int through, double t, double *a, double *lam)
{
    Block at[3];
    double w[3];
    for (int i = 0; i < through; i++) at[i].t = means_at(s, past[i].own).t;
    predictor(at, through - 1, t, w);
    for (int j = 0; j < s->nv; j++) a[j] = 0.0;
    for (int j = 0; lam && j < s->rows; j++) lam[j] = 0.0;
    for (int i = 0; i < through; i++) {
        const Means o = means_at(s, past[i].own);
        add(a, w[i], o.a, s->nv);
        if (lam) add(lam, w[i], o.lam, s->rows);
    }
}

/* When the iteration of a step ends, as _ends() of steps_in_parts.py. */
static void ends_of(const System *s, const double *p, const double *head, const Block *now, double *e)
{
    const double h = p[H], size = fmax(fmax(typical(s, now->a), typical(s, now->v) / h), 1e-6 * p[LENGTH] / (h * h));
    const double way = size * h * h, most = far_from_origin(s, now->q, p[LENGTH]);
    const double far = fmax(p[LENGTH], most) / way; /* much, of slow motion in small steps */
    memcpy(e, head + ENDS, (HEAD - ENDS) * sizeof(double));
    e[LARGEST] = size;
    e[NONE] *= fmax(far, 4.0);
    e[LOST] = (e[LOST] * p[LENGTH] + LEFT_OF_PLACES * most) / way;
}

/* The largest angle by which a body turns over a step, h |w|. */
static double largest_turn(const System *s, double h, const double *v, const double *a)
{
    double largest = 0.0;
    for (int b = 0; b < s->bodies; b++) {
        double w[ROT];
        for (int i = 0; i < ROT; i++) w[i] = v[TWIST * b + D + i] + 0.5 * h * a[TWIST * b + D + i];
        largest = fmax(largest, h * sqrt(dot(w, w, ROT)));
    }
    return largest;
}

/* Through how many means the polynomial tells those of the newest step best; ``x``: room, like v. */
static int best_through(const System *s, const Block *past, int known, const Means *made, double *x)
{
    double least = INFINITY;
    int best = 1;
    for (int k = 1; k <= known + 1; k++) {
        foretold(s, past, k, *made->t, x, NULL);
        add(x, -1.0, made->a, s->nv);
        double missed = typical(s, x);
        if (missed < least) least = missed, best = k;
    }
    return best;
}

/* One step, as a Maker of march.c. Room behind its head: sizes of increments, nv, that of a step by the matrix of its middle, which
   accelerations share. */
static int mean_march_step(System *s, double *p, double *room, const Block *past, int known, Block out)
{
    const Block now = past[0];
    const Means made = means_at(s, out.own);
    const double h = p[H], t = *now.t + h;
    double e[HEAD - ENDS], *sizes = room + HEAD, *x = sizes + (int)room[INCREMENTS], *rest = x + s->nv, last = NAN;
    long done[2] = {0, 0};
    int verdict;

    *made.t = *now.t + 0.5 * h;
    foretold(s, past, (int)*means_at(s, now.own).through, *made.t, made.a, made.lam);
    ends_of(s, p, room, &now, e);
    verdict = driver_mean_step(s, (int)room[INCREMENTS], 0, *now.t, h, p[LENGTH], e, now.q, now.v, made.a, made.lam, sizes, done, out.q,
                               out.v, rest);
    if (verdict) return verdict;

    if (largest_turn(s, h, now.v, made.a) > room[TURNS]) return DOUBT; /* Python warns of it */
    if ((verdict = sample(s, t, &last))) return verdict;
    if ((verdict = accelerate(s, t, p[LENGTH], out.q, out.v, out.a, out.lam, rest, 0))) return verdict;
    if (s->redundant && (verdict = driver_least(s, 1, t, 1, out.q, made.lam, rest))) return verdict;
    *made.through = best_through(s, past, known, &made, x);
    *out.t = t;

    /* what further increments would add */
    double newest = sizes[done[0] - 1], rate = done[0] > 1 ? fmin(newest / fmax(sizes[done[0] - 2], 1e-300), 0.9) : 0.0;
    p[LEFT] += rate / (1 - rate) * newest / p[TOL];
    p[ITERATIONS] += done[0];
    return DONE;
}
