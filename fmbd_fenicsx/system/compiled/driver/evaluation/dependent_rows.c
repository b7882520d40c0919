/* Solutions where rows depend on each other, with the softened factor of soften(), see factor.c, or those of stages, see lu.c. */

static const double OPEN = 1e-3;         /* share that corrections find open, above which directions are followed; */
static const double LEAST_CLOSED = 1e-3; /* share that a solution has to close of one whose rows count as independent; */
static const double LEFT_FAINT = 1e-10;  /* share of the multipliers below which a further one is the last */

/* Of multipliers y and z, as forces. */
static double force_product(const Softened *o, const double *y, const double *z)
{
    double sum = 0.0;
    for (int i = 0; i < o->n; i++) sum += o->weight[i] * y[i] * z[i];
    return sum;
}

/* A y, y less what one solution leaves open of it: of a combination of rows the share k of soften(). */
static void closed_share(const Softened *o, const double *y, double *closed)
{
    o->solve(o->of, 1.0, y, closed, 0);
    add(closed, 1.0, y, o->n);
}

/* Combinations of rows that one solution closes badly, as those that all of a tall tower hangs on: y with A y = z, z the multipliers
   of the first solution, from A^k z, which has nothing of contradictions, by conjugate directions p with q = A p (Orthodir, the least
   error of A y; Young and Jea, doi:10.1016/0024-3795(80)90247-2). A has no symmetry where multipliers of two levels meet: each
   direction is conjugate to many. ``first``: A^k z; y: of the corrections, that asked for the softness times ``asked``. */
static void close_faint(const Softened *o, const double *z, const double *first, const double *asked, double *y)
{
    const int m = o->n;
    double *open = o->room, *found = open + m, *left = found + m, *directions = o->room + 6 * m, *images = directions + CONJUGATE * m;
    double *p = directions, *q = images, sizes[CONJUGATE];
    const double enough = LEFT_FAINT * LEFT_FAINT * force_product(o, first, first);

    memcpy(p, first, m * sizeof(double));
    closed_share(o, p, q);
    memset(found, 0, m * sizeof(double));
    memcpy(left, z, m * sizeof(double));

    for (int k = 0; k < m; k++) {
        const double size = sizes[k % CONJUGATE] = force_product(o, q, q);
        if (!(size > LEAST_CLOSED * LEAST_CLOSED * force_product(o, p, p))) break;

        const double step = force_product(o, left, q) / size;
        add(found, step, p, m);
        add(left, -step, q, m);
        if (!(step * step * size > enough)) break;

        /* the next direction A p = q, freed of those before, with its image */
        const double *image = q;
        p = directions + (k + 1) % CONJUGATE * m, q = images + (k + 1) % CONJUGATE * m;
        memcpy(p, image, m * sizeof(double));
        closed_share(o, p, q);
        for (int j = k; j >= 0 && j + CONJUGATE > k + 1; j--) {
            const double *other = images + j % CONJUGATE * m, along = force_product(o, q, other) / sizes[j % CONJUGATE];
            add(p, -along, directions + j % CONJUGATE * m, m);
            add(q, -along, other, m);
        }
    }

    /* x is that of the corrections: of ``found`` instead, whose softness is taken back, while what is ``left`` of z stays open */
    for (int i = 0; i < m; i++) open[i] = left[i] - found[i] - asked[i];
    double *made = left;
    o->solve(o->of, 1.0, open, made, 1);
    memcpy(y, found, m * sizeof(double));
}

/* The multipliers y of a first solution, with the corrections of soften(). */
void close_softened(const Softened *o, double *y)
{
    const int m = o->n;
    double *left = o->room, *z = o->room + 3 * m, *last = z + m, *asked = last + m, open = 0.0;
    memcpy(z, y, m * sizeof(double));
    memset(asked, 0, m * sizeof(double));
    for (int k = 0; k < o->corrections; k++) {
        const double times = correction(k, o->corrections);
        memcpy(last, y, m * sizeof(double));
        add(asked, times, last, m);
        o->solve(o->of, times, last, left, 1);
        add(y, 1.0, left, m);
        open = force_product(o, left, left) / (times * times);
    }
    /* of the first solution: where that is of contradictions, what is left of it is roundoff */
    if (open > OPEN * OPEN * force_product(o, z, z)) close_faint(o, z, last, asked, y);
}

/* A solution of the core, whose motion is x. */
typedef struct {
    System *s;
    double *x;
} CoreSolution;

/* For rows that are ``times`` epsilon y / u^2 open. */
static void of_softness(void *of, double times, const double *y, double *made, int keep)
{
    const CoreSolution *core = of;
    System *s = core->s;
    double *more = s->work + s->again;
    for (int part = 0; part < s->parts; part++) {
        double *b = s->b + part * (s->nu + s->rows), *open = b + s->nu;
        memset(b, 0, s->nu * sizeof(double));
        for (int i = 0; i < s->rows; i++) open[i] = times * softness(s, i) * y[part * s->rows + i];
        for (const Body *o = s->body; s->fields && o < s->body + s->bodies; o++) /* conditions of frames are not softened */
            if (o->field) memset(open + o->field->row, 0, o->field->frames * sizeof(double));
    }

    for (const Body *o = s->body; s->fields && o < s->body + s->bodies; o++)
        if (o->field) field_without_load(o);
    solution(s, more, made);
    if (keep) add(core->x, 1.0, more, s->parts * s->nv);
}

/* x and y as with_fields() where rows depend, with the corrections of soften(); b holds nothing of use then. */
int with_all_rows(System *s, double scale, double *x, double *y, double t)
{
    int verdict = with_fields(s, scale, x, y, t);
    if (verdict || !s->redundant) return verdict;

    CoreSolution core = {s, x};
    const int m = s->parts * s->rows;
    double *weight = s->directions + (CLOSING + 1) * m;
    for (int i = 0; i < m; i++) weight[i] = 1.0 / (s->multiplier_units[i % s->rows] * s->multiplier_units[i % s->rows]);
    const Softened softened = {m, s->redundant, weight, s->directions, of_softness, &core};
    close_softened(&softened, y);
    return DONE;
}
