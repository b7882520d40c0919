/* Solutions where rows depend on each other, with the softened factor of soften(), see factor.c. */

static const double OPEN = 1e-3;         /* share that corrections find open, above which directions are followed; */
static const double LEAST_CLOSED = 1e-3; /* share that a solution has to close of one whose rows count as independent; */
static const double LEFT_FAINT = 1e-10;  /* share of the multipliers below which a further one is the last */

/* The solution for rows that are ``times`` epsilon y / u^2 open. */
static void of_softness(System *s, double times, const double *y, double *x, double *made)
{
    for (int part = 0; part < s->parts; part++) {
        double *b = s->b + part * (s->nu + s->rows), *open = b + s->nu;
        memset(b, 0, s->nu * sizeof(double));
        for (int i = 0; i < s->rows; i++) open[i] = times * softness(s, i) * y[part * s->rows + i];
        for (const Body *o = s->body; s->fields && o < s->body + s->bodies; o++) /* conditions of frames are not softened */
            if (o->field) memset(open + o->field->row, 0, o->field->frames * sizeof(double));
    }

    for (const Body *o = s->body; s->fields && o < s->body + s->bodies; o++)
        if (o->field) field_without_load(o);
    solution(s, x, made);
}

/* Of multipliers y and z, as forces. */
static double force_product(const System *s, const double *y, const double *z)
{
    double sum = 0.0;
    for (int part = 0; part < s->parts; part++, y += s->rows, z += s->rows)
        for (int i = 0; i < s->rows; i++) sum += y[i] * z[i] / (s->multiplier_units[i] * s->multiplier_units[i]);
    return sum;
}

/* A y, y less what one solution leaves open of it: of a combination of rows the share k of soften(). */
static void closed_share(System *s, const double *y, double *x, double *closed)
{
    of_softness(s, 1.0, y, x, closed);
    add(closed, 1.0, y, s->parts * s->rows);
}

/* Combinations of rows that one solution closes badly, as those that all of a tall tower hangs on: y with A y = z, z the multipliers
   of the first solution, from A^k z, which has nothing of contradictions, by conjugate directions p with q = A p (Orthodir, the least
   error of A y; Young and Jea, doi:10.1016/0024-3795(80)90247-2). ``first``: A^k z; x and y: of the corrections, that asked for the
   softness times ``asked``. */
static void close_faint(System *s, const double *z, const double *first, const double *asked, double *x, double *y)
{
    const int m = s->parts * s->rows;
    double *more = s->work + s->again, *p = s->directions, *q = p + m, *p_before = q + m, *q_before = p_before + m;
    double *image = q_before + m, *found = image + m, *left = found + m, size_before = 1.0;
    const double enough = LEFT_FAINT * LEFT_FAINT * force_product(s, first, first);

    memcpy(p, first, m * sizeof(double));
    closed_share(s, p, more, q);
    memset(p_before, 0, m * sizeof(double));
    memset(q_before, 0, m * sizeof(double));
    memset(found, 0, m * sizeof(double));
    memcpy(left, z, m * sizeof(double));

    for (int k = 0; k < m; k++) {
        const double size = force_product(s, q, q);
        if (!(size > LEAST_CLOSED * LEAST_CLOSED * force_product(s, p, p))) break;

        const double step = force_product(s, left, q) / size;
        add(found, step, p, m);
        add(left, -step, q, m);
        if (!(step * step * size > enough)) break;

        /* the next direction A p = q, freed of the last two, with its image */
        closed_share(s, q, more, image);
        const double along = force_product(s, image, q) / size;
        const double back = force_product(s, image, q_before) / size_before;
        for (int i = 0; i < m; i++) {
            const double next_p = q[i] - along * p[i] - back * p_before[i];
            const double next_q = image[i] - along * q[i] - back * q_before[i];
            p_before[i] = p[i], q_before[i] = q[i];
            p[i] = next_p, q[i] = next_q;
        }
        size_before = size;
    }

    /* x is that of the corrections: of ``found`` instead, whose softness is taken back, while what is ``left`` of z stays open */
    double *open = image, *made = q;
    for (int i = 0; i < m; i++) open[i] = left[i] - found[i] - asked[i];
    of_softness(s, 1.0, open, more, made);
    add(x, 1.0, more, s->parts * s->nv);
    memcpy(y, found, m * sizeof(double));
}

/* x and y as with_fields() where rows depend, with the corrections of soften(); b holds nothing of use then. */
int with_all_rows(System *s, double scale, double *x, double *y, double t)
{
    int verdict = with_fields(s, scale, x, y, t);
    if (verdict || !s->redundant) return verdict;

    const int n = s->parts * s->nv, m = s->parts * s->rows;
    double *more = s->work + s->again, *left = more + n, *z = s->directions + 7 * m, *last = z + m, *asked = last + m, open = 0.0;
    memcpy(z, y, m * sizeof(double));
    memset(asked, 0, m * sizeof(double));
    for (int k = 0; k < s->redundant; k++) {
        const double times = correction(k, s->redundant);
        memcpy(last, y, m * sizeof(double));
        add(asked, times, last, m);
        of_softness(s, times, y, more, left);
        add(x, 1.0, more, n);
        add(y, 1.0, left, m);
        open = force_product(s, left, left) / (times * times);
    }
    if (open > OPEN * OPEN * force_product(s, last, last)) close_faint(s, z, last, asked, x, y);
    return DONE;
}
