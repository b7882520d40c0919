/* The parts of an evaluation that Python asks for one by one, where it makes a start consistent. Vectors are like v: rotations in
   body axes. The motions of time are those sampled last. */

/* An array in the order of the unknowns, world axes, as one like v. */
static void like_v(const System *s, const double *u, double *x)
{
    for (int k = 0; k < s->bodies; k++) {
        const Body *o = s->body + k;
        memcpy(x + TWIST * k, u + o->at_u, D * sizeof(double));
        to_body(s->frames + FRAME * k + TURN, u + o->at_u + D, x + TWIST * k + D);
        memcpy(x + o->at_v, u + o->at_u + TWIST, o->modes * sizeof(double));
    }
}

/* The sum of M a + h + G^T lambda, like v. */
EXPORT int driver_balance(System *s, const double *q, const double *v, const double *a, const double *lam, double t, double *out)
{
    int verdict = evaluate(s, q, v, a, lam, t);
    like_v(s, s->residual, out);
    return verdict;
}

/* Of every constraint: g, what of dg/dt does not come from v, and g'' less G a. */
EXPORT int driver_constraints(System *s, const double *q, const double *v, double *gap, double *rate, double *gamma)
{
    int verdict = place(s, q, v);
    for (int i = 0; i < s->rows; i++) {
        gap[i] = -s->motion[i];
        rate[i] = -s->motion_rate[i];
        gamma[i] = 0.0;
    }
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role != ROW) continue;
        k->rates(k->n, k->pair, s->frames, k->P, 0, k->out);
        for (long i = 0; i < k->n; i++) {
            rate[k->row[i]] += k->factor[i] * k->out[2 * i];
            gamma[k->row[i]] += k->factor[i] * k->out[2 * i + 1];
        }
        k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
        for (long i = 0; i < k->n; i++) gap[k->row[i]] += k->factor[i] * k->out[i * k->outputs];
    }
    return verdict;
}

/* G x at a configuration. */
EXPORT int driver_speeds(System *s, const double *q, const double *x, double *out)
{
    int verdict = place(s, q, x);
    memset(out, 0, s->rows * sizeof(double));
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role != ROW) continue;
        k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
        const double *row = k->out;
        const int *at = k->at;
        for (long i = 0; i < k->n; i++, row += k->outputs, at += k->live)
            for (int e = 0; e < k->live; e++) out[k->row[i]] += k->factor[i] * row[k->entry[e]] * s->velocity[at[e]];
    }
    return verdict;
}

/* G itself, rows x nv, into zeros. */
EXPORT int driver_rows(System *s, const double *q, const double *v, double *G)
{
    int verdict = place(s, q, v), size = s->nu + TWIST * s->surfaces;
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role != ROW) continue;
        k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
        const double *row = k->out;
        const int *at = k->at;
        for (long i = 0; i < k->n; i++, row += k->outputs, at += k->live) {
            memset(s->residual, 0, size * sizeof(double));
            for (int e = 0; e < k->live; e++) s->residual[at[e]] += row[k->entry[e]];
            for (int j = 0; j < s->surfaces; j++) {
                const Surface *o = s->surface + j;
                const Body *b = s->body + o->body;
                for (int c = 0; c < TWIST; c++)
                    add(s->residual + b->at_u, s->residual[s->nu + TWIST * j + c], o->map + c * (TWIST + b->modes), TWIST + b->modes);
            }
            like_v(s, s->residual, s->work);
            add(G + (long)s->nv * k->row[i], k->factor[i], s->work, s->nv);
        }
    }
    return verdict;
}

/* x and y for right-hand sides b and c, with the factor of this configuration. */
EXPORT int driver_solve(System *s, const double *q, const double *b, const double *c, double *x, double *y)
{
    int verdict = place(s, q, b);
    memcpy(s->b, s->velocity, s->nu * sizeof(double));
    memcpy(s->b + s->nu, c, s->rows * sizeof(double));
    solution(s, x, y);
    return verdict;
}
