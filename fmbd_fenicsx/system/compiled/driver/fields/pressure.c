/* Fields of displacement and pressure, fem/mixed.py: the pressure p = C^-1 B U of their forces, and its rows in the step's matrix

       E = [cm M + ck A, ck B^T; ck B, -ck C].                                                                            (1)   */

/* y += B^T p by nodes */
static void push_by_pressure(const Pressure *o, const double *p, double *y)
{
    for (long i = 0; i < o->n; i++)
        for (int k = o->B_start[i]; k < o->B_start[i + 1]; k++) y[o->B_column[k]] += o->B[k] * p[i];
}

/* p = C^-1 b; no numbers where it is not found. */
static void solve_pressure(const Field *e)
{
    const Pressure *o = e->pressure;
    if (e->direct(*o->factor, o->rhs, o->solution))
        for (long i = 0; i < o->n; i++) o->p[i] = NAN;
}

/* F += B^T p of the pressure that belongs to U + beta U'; no numbers where it is not found. */
static void pressure_force(const Field *e, const double *U, const double *Ud, double beta, double *F)
{
    const Pressure *o = e->pressure;
    for (long i = 0; i < o->n; i++) {
        double sum = 0.0;
        for (int k = o->B_start[i]; k < o->B_start[i + 1]; k++) sum += o->B[k] * (U[o->B_column[k]] + beta * Ud[o->B_column[k]]);
        o->b[i] = sum;
    }
    solve_pressure(e);
    push_by_pressure(o, o->p, F);
}

/* r += B^T of the pressures in (1) by nodes; the sum of the squares of the rows of the pressure, where ``x``: stiffness times z. */
static double pressure_residual(const Pressure *o, const double *x, const double *p, double *r)
{
    double sum = 0.0;
    push_by_pressure(o, p, r);
    for (long i = 0; i < o->n; i++) {
        double left = 0.0;
        for (int k = o->B_start[i]; k < o->B_start[i + 1]; k++) left += o->B[k] * x[o->B_column[k]];
        for (int k = o->C_start[i]; k < o->C_start[i + 1]; k++) left -= o->C[k] * p[o->C_column[k]];
        sum += left * left;
    }
    return sum;
}
