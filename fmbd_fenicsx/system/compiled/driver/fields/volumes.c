/* Pressures that are unknowns, in Newton's iteration: (2) of fem/mixed.py, with r the balance of the pressure. */

/* Forces on the nodes take what closes volumes, B^T C^-1 r in the axes of the factor, for the increment that comes. */
void close_volume(const Body *o, double *force)
{
    const Field *e = o->field;
    const Pressure *k = e->pressure;
    if (!k || !k->gap) return;
    memcpy(k->b, k->gap, k->n * sizeof(double));
    solve_pressure(e);
    memset(e->accel, 0, e->n * sizeof(double));
    push_by_pressure(k, k->B, k->x, e->accel);
    turn_nodes(e, e->accel, e->n, 0);
    add(force, 1.0, e->accel, e->n);
}

/* The pressure after that increment x, like v: p + C^-1 (B dU + r). */
void move_pressure(const Body *o, const double *x)
{
    const Field *e = o->field;
    const Pressure *k = e->pressure;
    if (!k || !k->gap) return;
    memcpy(e->accel, x + o->at_v, e->n * sizeof(double));
    turn_nodes(e, e->accel, e->n, 1);
    for (long i = 0; i < k->n; i++) k->b[i] = k->gap[i] + volume_rate(k, k->B, i, e->accel);
    solve_pressure(e);
    add(k->p, 1.0, k->x, k->n);
}

/* Keep the pressure where a step begins, or take it ``back`` where that failed. */
void keep_pressure(const Body *o, int back)
{
    const Pressure *k = o->field->pressure;
    if (k && k->gap) memcpy(back ? k->p : k->began, back ? k->began : k->p, k->n * sizeof(double));
}
