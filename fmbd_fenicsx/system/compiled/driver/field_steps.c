/* What whole steps of Radau and BDF ask for where there are elastic fields (field_stages.c): derivatives and matrices at a motion within
   the step, and stages whose velocities go with their places. Factors of fields are those of a size of step, and stay. */

/* The matrices of all frequencies at the motion where derivatives are taken, and N by the real one of them. */
static int field_matrices(const Stages *o)
{
    const FieldStages *e = o->fields;
    int verdict;
    for (int f = 0; f < o->frequencies; f++) {
        System *by = e->by[f]; /* NULL: the matrix is NumPy's */
        const double *s = o->s + 2 * f, square = dot(s, s, 2);
        const double damped[2] = {s[0] / square, -s[1] / square};
        const double bent[2] = {damped[0] * damped[0] - damped[1] * damped[1], 2.0 * damped[0] * damped[1]};
        double last = NAN;
        if (!by) return LOOK;
        if ((verdict = sample(by, e->t, &last))) return verdict;
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
    double last = NAN;
    int verdict;
    e->t = t;
    memcpy(e->q, q, s->nq * sizeof(double));
    memcpy(e->v, v, o->n * sizeof(double));
    memcpy(e->a, a, o->n * sizeof(double));
    memcpy(e->lam, lam, o->m * sizeof(double));
    memset(e->before, 0, o->frequencies * sizeof(double));
    memset(e->room, 0, o->n * sizeof(double));

    if ((verdict = sample(s, t, &last))) return verdict;
    verdict = evaluate(s, q, v, a, lam, t);
    if (verdict && verdict != LOOK) return verdict;
    like_v(s, s->residual, e->balance);
    drift(s);
    level_rows(s, o->n, o->m, o->levels, o->first, e->balance);
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
        if ((verdict = place(s, q, o->v + (long)j * n))) return verdict;
        drift(s);
        level_rows(s, 0, m, 2, 0, low);
    }
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
