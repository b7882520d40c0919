/* What whole steps of Radau and BDF ask for where there are elastic fields (field_stages.c): derivatives and matrices at a motion within
   the step, and stages whose velocities go with their places. Factors of fields are those of a size of step, and stay. */

/* Ask Python for the matrices of what ``key`` stands for, with new tangents of fields where these are due; LOOK where it has none. */
static int ask_matrices(System *s, const Stages *o, double key)
{
    FieldStages *e = o->fields;
    if (e->lent == key && !e->outworn) return DONE;
    e->lent = 0.0;
    s->calls++;
    int told = s->python(FREQUENCIES, 0, key);
    if (told) return told == OUTSIDE ? LOOK : FAILED;
    e->lent = key;
    return DONE;
}

/* The matrices of all frequencies at the motion where derivatives are taken, and N by the real one of them. */
static int field_matrices(System *s, const Stages *o, double key)
{
    FieldStages *e = o->fields;
    int verdict = ask_matrices(s, o, key);
    if (verdict) return verdict;
    memset(e->before, 0, o->frequencies * sizeof(double));

    for (int f = 0; f < o->frequencies; f++) {
        System *by = e->by[f];
        const double *frequency = o->s + 2 * f, square = dot(frequency, frequency, 2);
        const double damped[2] = {frequency[0] / square, -frequency[1] / square};
        const double bent[2] = {damped[0] * damped[0] - damped[1] * damped[1], 2.0 * damped[0] * damped[1]};
        share_memory(s, by);
        if ((verdict = sample_middle(s, o, by))) return verdict;

        verdict = evaluate(by, e->q, e->v, e->a, e->lam, e->t);
        if (verdict && verdict != LOOK) return verdict;
        verdict = parts_of(o, f) > 1 ? prepare_complex(by, e->q, damped, bent, e->lam, e->t)
                                     : prepare(by, e->q, damped[0], bent[0], e->lam, 0, e->t);
        if (verdict) return verdict;

        if (o->levels < 2 || parts_of(o, f) > 1) continue;
        verdict = driver_solve(by, o->m, e->q, e->units, e->units + (long)o->m * o->n, e->N, e->reactions);
        if (verdict && verdict != LOOK) return verdict;
    }
    return DONE;
}

/* Derivatives at a motion from now on, with these multipliers. */
static int field_tangent(System *s, const Stages *o, double t, const double *q, const double *v, const double *a, const double *lam)
{
    FieldStages *e = o->fields;
    int verdict;
    e->t = t;
    e->sampled_at = NAN;
    memcpy(e->q, q, s->nq * sizeof(double));
    memcpy(e->v, v, o->n * sizeof(double));
    memcpy(e->a, a, o->n * sizeof(double));
    memcpy(e->lam, lam, o->m * sizeof(double));
    memset(e->room, 0, o->n * sizeof(double));

    if ((verdict = sample_middle(s, o, s))) return verdict;
    verdict = evaluate(s, q, v, a, lam, t);
    if (verdict && verdict != LOOK) return verdict;
    const Form form = form_of(o);
    like_v(s, s->residual, e->balance);
    level_rows(s, &form, a, e->balance);
    return DIM == 3 ? turning(s, e->room, v, e->turnings, NULL) : DONE;
}

/* Velocities and multipliers of foretold stages that go with their places, and rows of velocities that places do not close. */
static int align_stages(System *s, const Stages *o)
{
    const int n = o->n, m = o->m, k = o->points;
    int verdict;
    for (int j = 0; j < k; j++) {
        double *kin = o->kin + (long)j * n;
        memcpy(kin, o->v + (long)j * n, n * sizeof(double));
        for (int b = 0; b < s->bodies; b++) rate_of(o->xi + (long)j * n + TWIST * b, kin + TWIST * b);
        for (int i = 0; i < n; i++) kin[i] = o->rate[(long)j * n + i] - kin[i];
    }
    lacking(s, o);
    memcpy(o->dv, o->kin, (size_t)k * n * sizeof(double));
    add(o->v, 1.0, o->kin, k * n);

    for (int j = 0; o->levels > 1 && j < k; j++) {
        double *low = o->low + (long)j * o->size + n, *q = o->local;
        if ((verdict = sample_point(s, o, j, 0))) return verdict;
        configuration(s, o->q0, o->xi + (long)j * n, q);
        const Form both = {0, m, 2, 0, o->pulls};
        if ((verdict = place(s, q, o->v + (long)j * n))) return verdict;
        level_rows(s, &both, NULL, low);
    }

    o->fields->aligned = o->levels > 1;
    for (int j = 0; o->levels > 1 && j < k; j++) {
        double *slip = o->mult + (long)j * (o->size - n) + m, *low = o->low + (long)j * o->size + n, *moved = o->dv + (long)j * n;
        double *opened = o->fields->given;
        for (int i = 0; i < m; i++) opened[i] = -low[m + i];
        for (int i = 0; i < k; i++) add(opened, o->couple[j * k + i], o->low + (long)i * o->size + n, m);
        add(slip, 1.0, opened, m);
        add_closing(o, opened, moved);
        add_closing(o, opened, o->v + (long)j * n);
    }

    for (int j = 0; j < k; j++)
        for (int i = 0; i < k; i++) add(o->vd + (long)j * n, o->couple[j * k + i], o->dv + (long)i * n, n);
    return DONE;
}

/* The frequency that is real, which the others' matrices need too. */
static int real_frequency(const Stages *o)
{
    int f = 0;
    while (f < o->frequencies - 1 && parts_of(o, f) > 1) f++;
    return f;
}

/* The least motion by the matrix of a frequency, at q, that opens its rows by ``opened``, which is lost; added to x. */
static int close_rows(System *by, const double *q, double *opened, double *none, double *y, double *x)
{
    double *moved = none + by->nv;
    for (int i = 0; i < by->rows; i++) opened[i] = -opened[i];
    memset(none, 0, by->nv * sizeof(double));
    int verdict = driver_solve(by, 1, q, none, opened, moved, y);
    add(x, 1.0, moved, by->nv);
    return verdict == LOOK ? DONE : verdict;
}

/* What depends on time only between steps, which the last point of the one before knows, in the tables of a matrix. */
static int sample_start(System *s, const Stages *o, double t, System *by)
{
    const int end = o->points - 1;
    double last = NAN;
    int verdict;
    if (by->samples && o->t[end] != t) {
        if ((verdict = sample(s, t, &last))) return verdict;
        keep_sample(s, o->sampled + end * sample_size(s), 0);
    }
    return recall_sample(by, o->sampled + end * sample_size(s), t);
}

/* The start of a step on the constraints, by the matrix of the step before: what moves it (where rows hold ``places``), v and a. */
static int close_start(System *s, const Stages *o, int places, const Block *now)
{
    FieldStages *e = o->fields;
    const int n = o->n, real = real_frequency(o);
    System *by = e->by[real]; /* of the step before */
    double *dq = e->closed, *v = dq + n, *a = v + n, *none = e->b, *opened = e->given, *q = o->local, w = o->s[2 * real];
    int verdict;
    if (e->begun) return DONE;
    if (e->lent == 0.0) return LOOK;
    memset(dq, 0, n * sizeof(double));
    memcpy(v, now->v, n * sizeof(double));
    memcpy(a, now->a, n * sizeof(double));

    memset(e->c, 0, (n + o->m) * sizeof(double)); /* neither accelerations nor reactions */
    share_memory(s, by);
    if ((verdict = sample_start(s, o, *now->t, by))) return verdict;
    verdict = evaluate(by, now->q, v, e->c, e->c + n, *now->t);
    if (verdict && verdict != LOOK) return verdict;
    if ((verdict = prepare(by, now->q, 1.0 / w, 1.0 / (w * w), e->c + n, 0, *now->t))) return verdict;

    if ((verdict = place(by, now->q, v))) return verdict;
    openings(by, 1);
    memcpy(opened, by->gap, o->m * sizeof(double));
    if (places && (verdict = close_rows(by, now->q, opened, none, e->found, dq))) return verdict;

    configuration(by, now->q, dq, q);
    if ((verdict = place(by, q, v))) return verdict;
    slips(by, 1);
    memcpy(opened, by->slip, o->m * sizeof(double));
    if ((verdict = close_rows(by, now->q, opened, none, e->found, v))) return verdict;

    if ((verdict = place(by, q, v))) return verdict;
    derivatives_in_time(by, e->found, e->found + o->m);
    memcpy(opened, e->found + o->m, o->m * sizeof(double));
    turn_velocity(by, a);
    slips(by, 0);
    add(opened, 1.0, by->slip, o->m);
    if ((verdict = close_rows(by, now->q, opened, none, e->found, a))) return verdict;
    e->begun = 1;
    return DONE;
}

/* a and lambda at the end of a step, as correct() has them, by the matrix of the step; as they are where none is real. ``room``: 3 nv + 3 rows. */
static int correct_end(System *s, const Stages *o, Block out, double *room)
{
    const int real = real_frequency(o);
    const double w = o->s[2 * real];
    System *by = o->fields->by[real];
    int verdict;
    if (parts_of(o, real) > 1) return DONE;
    share_memory(s, by);
    if ((verdict = sample_start(s, o, *out.t, by))) return verdict;
    return correct(by, *out.t, 1.0 / w, 1.0 / (w * w), out.q, out.v, out.a, out.lam, room);
}

/* ---- rows that depend ---- */

static const double DEPENDENT = 1e-8; /* share of a column that is roundoff */

/* diag(u) G by its columns A, nu x m, each of unit size, where frames are placed; zero where it is roundoff of those of its body. */
static void columns_of_rows(System *s, double *A)
{
    const int m = s->rows;
    const double *units = s->multiplier_units;
    memset(A, 0, (size_t)s->nu * m * sizeof(double));

    for (const Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role != ROW) continue;
        k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
        for (long i = 0; i < k->n; i++)
            for (int side = 0; side < k->sides; side++) {
                int body, width = side_row(s, k, i, side, &body), row = k->row[i];
                const Body *o = s->body + body;
                for (int j = width && rests(o) ? TWIST : 0; j < width; j++) /* a frame that rests bears nothing */
                    A[(long)(o->at_u + j) * m + row] += units[row] * k->factor[i] * s->big[j];
            }
    }

    for (const Body *o = s->body; o < s->body + s->bodies; o++) {
        double *own = A + (long)o->at_u * m, largest = 0.0;
        for (int i = 0; o->field && i < o->field->frames; i++) {
            const int row = o->field->row + i;
            own[(long)(TWIST + o->field->frame_slot[i]) * m + row] = units[row];
        }

        for (int j = 0; j < TWIST + o->modes; j++) largest = fmax(largest, dot(own + j * m, own + j * m, m));
        for (int j = 0; j < TWIST + o->modes; j++) {
            const double square = dot(own + j * m, own + j * m, m);
            const double scale = square > DEPENDENT * DEPENDENT * largest ? 1.0 / sqrt(square) : 0.0;
            for (int i = 0; i < m; i++) own[j * m + i] *= scale;
        }
    }
}

/* An orthonormal basis of n columns of m numbers, in their first places, by the largest that is left each time; how many. */
static int basis_of(int n, int m, double *A)
{
    int rank = 0;
    for (; rank < (n < m ? n : m); rank++) {
        double *next = A + (long)rank * m, *found = next, most = 0.0;
        for (double *x = next; x < A + (long)n * m; x += m) {
            const double square = dot(x, x, m);
            if (square > most) most = square, found = x;
        }

        if (!(most > DEPENDENT * DEPENDENT)) break;
        for (int i = 0; i < m; i++) {
            const double kept = next[i];
            next[i] = found[i];
            found[i] = kept;
        }

        for (const double *x = A; x < next; x += m) add(next, -dot(x, next, m), x, m); /* once more: what is left is small */
        const double size = sqrt(dot(next, next, m));
        for (int i = 0; i < m; i++) next[i] /= size;
        for (double *x = next + m; x < A + (long)n * m; x += m) add(x, -dot(next, x, m), next, m);
    }
    return rank;
}

/* Of the multipliers of all levels at point j the smallest with their forces: (1) of linear/redundancy.py, where what is taken out of
   lambda / u is all but its part along the columns of diag(u) G. */
static int least_on_fields(System *s, const Stages *o, int j, const double *q, double *mult)
{
    const FieldStages *e = o->fields;
    const double *u = s->multiplier_units;
    double *given = e->given, *found = e->found;
    const int m = o->m;
    int verdict = sample_point(s, o, j, 1);
    memset(e->room, 0, o->n * sizeof(double));
    if (verdict || (verdict = place(s, q, e->room))) return verdict;

    columns_of_rows(s, e->columns);
    const int rank = basis_of(s->nu, m, e->columns);
    for (int level = 0; level < o->levels; level++, mult += m) {
        for (int i = 0; i < m; i++) given[i] = mult[i] / u[i];
        memset(found, 0, m * sizeof(double));
        for (int k = 0; k < rank; k++) add(found, dot(e->columns + (long)k * m, given, m), e->columns + (long)k * m, m);
        for (int i = 0; i < m; i++) mult[i] = u[i] * found[i];
    }
    return DONE;
}

/* Errors of places and velocities, 2 n of ``change``, from the defects of a step: ``kin``, and ``push`` of the accelerations. */
static int field_errors(System *s, const Stages *o, const double *kin, const double *push, double *change)
{
    const FieldStages *e = o->fields;
    const int n = o->n, f = real_frequency(o);
    double *low = e->low + (long)f * 2 * o->size;
    int verdict;
    memcpy(e->kin + (long)f * 2 * n, kin, n * sizeof(double));
    memset(low, 0, o->size * sizeof(double));
    if ((verdict = sample_middle(s, o, s))) return verdict;

    memset(e->c, 0, n * sizeof(double));
    memset(e->b, 0, n * sizeof(double));
    add(e->b, -1.0, push, n);
    if ((verdict = add_along(s, o, 1, e->c, e->b, low))) return verdict;
    memset(low + n, 0, (o->size - n) * sizeof(double)); /* rows of places and velocities */

    if ((verdict = trusted_solution(s, o, f, 0.0))) return verdict;
    memcpy(change, e->x + (long)f * 4 * n, n * sizeof(double));
    field_velocities(s, o, f, change, change + n);
    return DONE;
}
