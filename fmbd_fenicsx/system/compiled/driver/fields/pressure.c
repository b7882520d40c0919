/* Fields of displacement and pressure, fem/mixed.py: the pressure p = C^-1 B U of their forces, and its rows in the step's matrix

       E = [cm M + ck A, ck B^T; ck B, -ck C].                                                                            (1)

   A pressure that is an unknown stays as it is while forces are evaluated; Newton's increment moves it, (2) of fem/mixed.py. */

/* y += B^T p by nodes */
static void push_by_pressure(const Pressure *o, const double *B, const double *p, double *y)
{
    for (long i = 0; i < o->n; i++)
        for (int k = o->B_start[i]; k < o->B_start[i + 1]; k++) y[o->B_column[k]] += B[k] * p[i];
}

/* The rate of the volume, B U, at one number of the pressure */
static double volume_rate(const Pressure *o, const double *B, long i, const double *U)
{
    double sum = 0.0;
    for (int k = o->B_start[i]; k < o->B_start[i + 1]; k++) sum += B[k] * U[o->B_column[k]];
    return sum;
}

/* x = C^-1 b; no numbers where it is not found. */
static void solve_pressure(const Field *e)
{
    const Pressure *o = e->pressure;
    if (e->direct(*o->factor, o->rhs, o->solution))
        for (long i = 0; i < o->n; i++) o->x[i] = NAN;
}

/* F += B^T C^-1 B (U + beta U'); no numbers where there is no such pressure. */
static void pressure_force(const Field *e, const double *B, const double *U, const double *Ud, double beta, double *F)
{
    const Pressure *o = e->pressure;
    for (long i = 0; i < o->n; i++) o->b[i] = volume_rate(o, B, i, U) + beta * volume_rate(o, B, i, Ud);
    solve_pressure(e);
    push_by_pressure(o, B, o->x, F);
}

/* r += B^T of the pressures in (1) by nodes; their rows into ``rows``, where ``x``: stiffness times z. */
static void pressure_residual(const Pressure *o, const double *x, const double *p, double *r, double *rows)
{
    push_by_pressure(o, o->B, p, r);
    for (long i = 0; i < o->n; i++) {
        rows[i] = volume_rate(o, o->B, i, x);
        for (int k = o->C_start[i]; k < o->C_start[i + 1]; k++) rows[i] -= o->C[k] * p[o->C_column[k]];
    }
}
