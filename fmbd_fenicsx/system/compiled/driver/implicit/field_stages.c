/* Increments of the stages of elastic fields, by the matrices of their frequencies: schemes/implicit/stage_krylov.py, whose symbols these
   are, where no solution is iterated on. Complex vectors have two parts, all real numbers first. */

static const double SEEN = 0.005;    /* share of an increment above which known parts of rates are seen, SMALL there */
static const double SHIFTED = 0x1p-26; /* of a difference quotient, over the model's length */
static const double ROUNDED = 1e-14; /* roundoff of rates, over their largest */

typedef struct FieldStages {
    System **by;                       /* who has the matrix of each frequency */
    double t, length, *q, *v, *a, *lam, *balance; /* the motion where derivatives are taken; balance and rows there */
    double *sampled, sampled_at;       /* what depends on time only there, and its time; other: it was not asked for */
    int aligned;                       /* whether that of the points was asked for, too */
    double lent;                       /* what the matrices are for, as Implicit has it: 0: none is there */
    int begun;                         /* whether the next step's start is closed */
    double *closed;                    /* that: dq, v, a */
    double *N, *turnings;              /* m x n, motions that open single rows; bodies x TWIST x TWIST, d rate / d xi at xi = 0, and n */
    double *columns;                   /* nu x m, work: of rows that depend */
    double *units, *reactions;         /* right-hand sides of N, m x n zeros and m x m of the identity; m x m, work */
    double *square, *before, *sizes;   /* n: of the entries of lengths; of the last increments; of these */
    double *kin, *low, *rate, *push;   /* frequencies x 2 n, x 2 size, x 2 n, x 2 n */
    double *x, *y;                     /* frequencies x 4 n, x 2 (size - n): solutions */
    double *b, *c, *given, *found, *room; /* 2 n, 2 n + 2 m; 2 m each; 3 n + size */
    int renewable, renewed, outworn, fewest; /* whether fields have new tangents, this step has taken some, and the next one asks for some;
                                          increments of a step since, at the least: schemes/implicit/field_renewals.py */
    int vain, failed;                  /* whether a step failed with the newest ones, too; whether this one has with older ones */
    int pressures;                     /* unknown ones of all fields, side by side: */
    double *pressure, *opened, *began; /* points x pressures: of the points, and their balances; where the step began */
    double relaxed;                    /* how increments of the last step were corrected for factors of another frequency */
} FieldStages;

static int parts_of(const Stages *o, int f) { return o->s[2 * f + 1] != 0.0 ? 2 : 1; }

/* y = s x of n numbers. */
static void scaled(const double *s, int parts, int n, const double *x, double *y)
{
    for (int i = 0; i < n; i++) y[i] = s[0] * x[i];
    if (parts == 1) return;
    for (int i = 0; i < n; i++) {
        y[i] -= s[1] * x[n + i];
        y[n + i] = s[0] * x[n + i] + s[1] * x[i];
    }
}

/* y += N c */
static void add_closing(const Stages *o, const double *c, double *y)
{
    for (int r = 0; r < o->m; r++)
        if (c[r] != 0.0) add(y, c[r], o->fields->N + (long)r * o->n, o->n);
}

/* ---- pressures that are unknowns: schemes/implicit/stage_pressures.py ---- */

enum { MANY = 4, MORE = 2 };           /* increments of a step, and more than one behind new tangents, from which on the next one takes some */
static const double CORRECTED_ALIKE = 1e-8; /* difference of corrections by roundoff of the step's size */

/* Those of the fields in the tables of ``s``, or their balances, as they stand side by side in x: into x, or out of it. */
enum { INTO, OUT_OF };
static void exchange_pressures(const System *s, int way, int balances, double *x)
{
    for (const Body *o = s->body; o < s->body + s->bodies; o++) {
        const Pressure *k = o->field ? o->field->pressure : NULL;
        if (!k || !k->gap) continue;
        double *own = balances ? k->gap : k->p;
        memcpy(way == INTO ? x : own, way == INTO ? own : x, k->n * sizeof(double));
        x += k->n;
    }
}

/* The balance of point j takes what closes volumes that are open there; fields have the pressures of the step's start again. The matrix of
   any frequency tells how the axes are turned. */
static void close_point(const System *s, const Stages *o, int j, double *low)
{
    const FieldStages *e = o->fields;
    double *opened = e->opened + (long)j * e->pressures;
    exchange_pressures(s, INTO, 1, opened);
    exchange_pressures(s, OUT_OF, 0, e->began);
    exchange_pressures(e->by[0], OUT_OF, 1, opened);
    for (const Body *b = e->by[0]->body; b < e->by[0]->body + s->bodies; b++)
        if (b->field) close_volume(b, low + b->at_v);
}

/* Pressures of all points move along with their increments. */
static void move_points(const Stages *o)
{
    const FieldStages *e = o->fields;
    const System *by = e->by[0];

    for (int j = 0; j < o->points && e->pressures; j++) {
        double *opened = e->opened + (long)j * e->pressures, *pressure = e->pressure + (long)j * e->pressures;
        for (int i = 0; i < e->pressures; i++) opened[i] *= o->relax;
        exchange_pressures(by, OUT_OF, 0, pressure);
        exchange_pressures(by, OUT_OF, 1, opened);
        for (const Body *b = by->body; b < by->body + by->bodies; b++)
            if (b->field) move_pressure(b, o->dxi + (long)j * o->n);
        exchange_pressures(by, INTO, 0, pressure);
    }
    if (e->pressures) exchange_pressures(by, OUT_OF, 0, e->began);
}

/* Points begin with the pressures of the step. */
static void begin_points(const System *s, const Stages *o)
{
    const FieldStages *e = o->fields;
    exchange_pressures(s, INTO, 0, e->began);
    for (int j = 0; j < o->points; j++) memcpy(e->pressure + (long)j * e->pressures, e->began, e->pressures * sizeof(double));
}

/* Steps of more increments than new tangents would ask for have these in the next one. Increments that are corrected for factors
   of another frequency fall off as these do: they are compared with those of such steps. */
static void wear_tangents(const Stages *o, int increments)
{
    FieldStages *e = o->fields;
    const int other = fabs(o->relax - e->relaxed) > CORRECTED_ALIKE;
    if (e->renewed || other || increments < e->fewest) e->fewest = increments;
    e->relaxed = o->relax;
    e->renewed = e->failed = 0;
    if (e->renewable && increments > MANY && increments > e->fewest + MORE) e->outworn = 1;
}

/* Whether a step that has failed is tried once more, with new tangents of the fields: ask() of field_renewals.py. */
static int tried_renewed(const Stages *o, int verdict)
{
    FieldStages *e = o->fields;
    if (!e || verdict != NEWTON || !e->renewable) return 0;
    e->vain |= e->renewed;
    const int too_long = e->vain && !e->failed;
    e->failed |= !e->renewed;
    if (e->renewed || too_long) return 0;
    e->outworn = 1;
    return 1;
}

/* The size of a motion. */
static double size_of(const Stages *o, int parts, const double *x)
{
    const int n = o->n;
    double sum = 0.0;
    for (int part = 0; part < parts; part++, x += n)
        for (int i = 0; i < n; i++) sum += o->fields->square[i] * x[i] * x[i];
    return sqrt(sum);
}

/* What rates lack of those of the points, whose velocities N c correct; without roundoff. */
static void lacking(System *s, const Stages *o)
{
    const int n = o->n, k = o->points;
    double least = 0.0, *closed = o->fields->room;
    for (long i = 0; i < (long)k * n; i++) least = fmax(least, ROUNDED * fabs(o->rate[i]));
    for (int j = 0; j < k; j++) {
        double *kin = o->kin + j * n;
        const double *c = o->mult + j * (o->size - n) + o->m;

        if (o->levels > 1) {
            memset(closed, 0, n * sizeof(double));
            add_closing(o, c, closed);
            for (int b = 0; b < s->bodies; b++) rate_of(o->xi + j * n + TWIST * b, closed + TWIST * b);
            add(kin, 1.0, closed, n);
        }

        for (int i = 0; i < n; i++)
            if (!(fabs(kin[i]) > least)) kin[i] = 0.0;
    }
}

/* What depends on time only where derivatives are taken, in the tables of the balance or of a matrix. */
static int sample_middle(System *s, const Stages *o, System *by)
{
    FieldStages *e = o->fields;
    double last = NAN;
    int verdict;
    if (s->samples && e->sampled_at != e->t) {
        if ((verdict = sample(s, e->t, &last))) return verdict;
        keep_sample(s, e->sampled, 0);
        e->sampled_at = e->t;
    }
    return recall_sample(by, e->sampled, e->t);
}

/* low += the derivative of balance and rows along (0, rate, push). */
static int add_along(System *s, const Stages *o, int parts, const double *rate, const double *push, double *low)
{
    const FieldStages *f = o->fields;
    const int n = o->n, size = o->size;
    double *v = f->room, *a = v + n, *found = a + n;

    for (int part = 0; part < parts; part++, rate += n, push += n, low += size) {
        double speed = largest_of(s->units, rate, n), pushed = largest_of(s->units, push, n), still = largest_of(s->units, f->a, n), e;
        if (speed == 0.0) e = (still > 0.0 ? still : 1.0) / (pushed > 0.0 ? pushed : 1.0);
        else e = SHIFTED * f->length / (speed * speed / fmax(pushed, 1e-300));
        memcpy(v, f->v, n * sizeof(double));
        memcpy(a, f->a, n * sizeof(double));
        add(v, e, rate, n);
        add(a, e, push, n);
        int verdict = evaluate(s, f->q, v, a, f->lam, f->t);
        if (verdict) return verdict;

        const Form form = form_of(o);
        like_v(s, s->residual, found);
        level_rows(s, &form, a, found);
        for (int i = 0; i < size; i++) low[i] += (found[i] - f->balance[i]) / e;
    }
    return DONE;
}

/* Known parts of rates and of accelerations of frequency f, slips among the multipliers: what they have of the increment, at most. */
static int known_parts(System *s, const Stages *o, int f, double *acts)
{
    const FieldStages *e = o->fields;
    const int n = o->n, m = o->m, size = o->size, parts = parts_of(o, f);
    const double *frequency = o->s + 2 * f, *kin = e->kin + (long)f * 2 * n, *low = e->low + (long)f * 2 * size;
    double *rate = e->rate + (long)f * 2 * n, *opened = e->y + (long)f * 2 * (size - n) + parts * m;
    int verdict, moves = 0;

    memcpy(rate, kin, parts * n * sizeof(double));
    for (int i = 0; i < parts * n && !moves; i++) moves = kin[i] != 0.0;
    if (o->levels > 1 && moves && (verdict = sample_middle(s, o, s))) return verdict;
    for (int part = 0; part < parts && o->levels > 1; part++) {
        const double *at = low + part * size + n, *other = low + (1 - part) * size + n;
        double *slip = opened + part * m;
        for (int i = 0; i < m; i++) {
            slip[i] = frequency[0] * at[i] - at[m + i];
            if (parts > 1) slip[i] += (part ? 1.0 : -1.0) * frequency[1] * other[i];
        }

        if (moves) {
            if ((verdict = place(s, e->q, e->v))) return verdict;
            turn_velocity(s, kin + part * n);
            slips(s, 1); /* rows where derivatives are taken */
            slips(s, 0);
            add(slip, -1.0, s->slip, m);
        }
        add_closing(o, slip, rate + part * n);
    }
    scaled(frequency, parts, n, rate, e->push + (long)f * 2 * n);
    *acts = 2.0 * size_of(o, parts, rate) / sqrt(dot(frequency, frequency, 2));
    return DONE;
}

/* x and y of frequency f for its residuals; ``known``: with what known parts add to these. */
static int field_solution(System *s, const Stages *o, int f, int known)
{
    FieldStages *e = o->fields;
    const int n = o->n, m = o->m, size = o->size, parts = parts_of(o, f);
    const double *frequency = o->s + 2 * f, square = dot(frequency, frequency, 2);
    const double inverse[2] = {frequency[0] / square, -frequency[1] / square};
    const double minus[2] = {inverse[1] * inverse[1] - inverse[0] * inverse[0], -2.0 * inverse[0] * inverse[1]}; /* -1 / s^2 */
    const double scale[2] = {o->first ? -inverse[0] : -1.0, o->first ? -inverse[1] : 0.0};
    const double twice[2] = {frequency[0] * frequency[0] - frequency[1] * frequency[1], 2.0 * frequency[0] * frequency[1]};
    double *low = e->low + (long)f * 2 * size, *x = e->x + (long)f * 4 * n, *y = e->y + (long)f * 2 * (size - n);
    int verdict;

    if (known) {
        if ((verdict = sample_middle(s, o, s))) return verdict;
        if ((verdict = add_along(s, o, parts, e->rate + (long)f * 2 * n, e->push + (long)f * 2 * n, low))) return verdict;
    }

    for (int part = 0; part < parts; part++) {
        memcpy(e->c + part * n, low + part * size, n * sizeof(double));
        if (o->levels) memcpy(e->given + part * m, low + part * size + n, m * sizeof(double));
    }

    scaled(minus, parts, n, e->c, e->b);
    memset(e->c, 0, parts * m * sizeof(double));
    if (o->levels) scaled(scale, parts, m, e->given, e->c);
    verdict = driver_solve(e->by[f], 1, e->q, e->b, e->c, x, e->found);
    if (verdict && verdict != LOOK) return verdict;
    if (o->levels) scaled(twice, parts, m, e->found, y);
    return DONE;
}

/* The solution of frequency f behind one of size ``before``, 0: it is the first; LOOK where it is no number. */
static int trusted_solution(System *s, const Stages *o, int f, double before)
{
    const FieldStages *e = o->fields;
    const double *x = e->x + (long)f * 4 * o->n;
    double acts;
    int verdict;
    if ((verdict = known_parts(s, o, f, &acts))) return verdict;
    if ((verdict = field_solution(s, o, f, before > 0.0 && acts > SEEN * before))) return verdict;

    double size = size_of(o, parts_of(o, f), x);
    if (before == 0.0 && acts > SEEN * size) {
        if ((verdict = field_solution(s, o, f, 1))) return verdict;
        size = size_of(o, parts_of(o, f), x);
    }
    if (!(size < INFINITY)) return LOOK;
    e->sizes[f] = size;
    return DONE;
}

/* Solutions of all frequencies, likewise. */
static int field_solutions(System *s, const Stages *o)
{
    const FieldStages *e = o->fields;
    int verdict;
    for (int f = 0; f < o->frequencies; f++)
        if (shared(o, f) && (verdict = trusted_solution(s, o, f, e->before[f]))) return verdict;
    memcpy(e->before, e->sizes, o->frequencies * sizeof(double));
    return DONE;
}

/* dv = s dxi - d rate / d xi dxi + the known part. */
static void field_velocities(const System *s, const Stages *o, int f, const double *dxi, double *dv)
{
    const FieldStages *e = o->fields;
    const int n = o->n, parts = parts_of(o, f);
    scaled(o->s + 2 * f, parts, n, dxi, dv);
    add(dv, 1.0, e->rate + (long)f * 2 * n, parts * n);
    for (int part = 0; part < parts && DIM == 3; part++)
        for (int b = 0; b < s->bodies; b++)
            for (int i = 0; i < TWIST; i++)
                dv[part * n + TWIST * b + i] -= dot(e->turnings + TWIST * (TWIST * b + i), dxi + part * n + TWIST * b, TWIST);
}

/* What the frequencies have of the residuals of the points: by their parts, into ``to``, frequencies x 2 count. */
static void decoupled(const Stages *o, int count, const double *x, double *to)
{
    memset(to, 0, (size_t)o->frequencies * 2 * count * sizeof(double));
    for (int f = 0; f < o->frequencies; f++)
        for (int part = 0; part < parts_of(o, f); part++)
            for (int j = 0; j < o->points; j++)
                add(to + ((long)f * 2 + part) * count, o->inverse[2 * (o->points * f + j) + part], x + (long)j * count, count);
}

/* The real parts of vectors z, a frequency's share of all points: ``z`` has parts of so many numbers. */
static void coupled(const Stages *o, int f, int count, const double *z, double *to)
{
    for (int j = 0; j < o->points; j++) {
        const double *share = o->vectors + 2 * (j * o->frequencies + f);
        add(to + (long)j * count, share[0], z, count);
        if (parts_of(o, f) > 1) add(to + (long)j * count, -share[1], z + count, count);
    }
}

/* Increments of all points from their residuals. */
static int field_increments(System *s, const Stages *o)
{
    const FieldStages *e = o->fields;
    const int n = o->n, m = o->m, width = o->size - n;
    decoupled(o, n, o->kin, e->kin);
    decoupled(o, o->size, o->low, e->low);
    int verdict = field_solutions(s, o);
    if (verdict) return verdict;

    for (int f = 0; f < o->frequencies; f++) {
        if (!shared(o, f)) continue;
        const int parts = parts_of(o, f);
        double *dxi = e->x + (long)f * 4 * n, *dv = dxi + parts * n, *y = e->y + (long)f * 2 * width;
        field_velocities(s, o, f, dxi, dv);
        coupled(o, f, n, dxi, o->dxi);
        coupled(o, f, n, dv, o->dv);

        for (int level = 0; level < o->levels; level++)
            for (int j = 0; j < o->points; j++) {
                const double *share = o->vectors + 2 * (j * o->frequencies + f), *z = y + level * parts * m;
                double *to = o->dmult + (long)j * width + level * m;
                add(to, share[0], z, m);
                if (parts > 1) add(to, -share[1], z + m, m);
            }
    }
    return DONE;
}
