/* Forces of fields without inertia and weight, as held_force() of the parts tells them: elasticity, damping, loads. What is not linear
   are vectors of forms that FFCx has compiled, assembled cell by cell. */

typedef void Kernel(double *, const double *, const double *, const double *, const int *, const unsigned char *, void *);

/* F += the vector of a form by nodes; ``moving``: values of what moves. */
static void add_integral(const Integral *o, const double *const *moving, double *F)
{
    const int each = o->components;
    double *w = o->room, *A = w + o->width, *x = A + each * o->nodes;
    for (long i = 0; i < o->count; i++) {
        memcpy(w, o->coefficients + i * o->width, o->width * sizeof(double));
        for (int k = 0; k < FROM; k++)
            for (int j = 0; j < o->moving[k]; j++) w[o->place[k][j]] = moving[k][o->from_[k][i * o->moving[k] + j]];
        for (int j = 0; j < o->corners; j++) memcpy(x + 3 * j, o->points + 3 * (long)o->corner[i * o->corners + j], 3 * sizeof(double));
        memset(A, 0, each * o->nodes * sizeof(double));
        ((Kernel *)o->kernel)(A, w, o->constants, x, o->facet ? o->facet + i : NULL, NULL, NULL);
        for (int j = 0; j < o->nodes; j++) add(F + each * (long)o->node[i * o->nodes + j], *o->factor, A + each * j, each);
    }
}

/* F += K (U + beta U') of a linear field, with its pressure */
static void stiffness_times(const Field *e, const double *U, const double *Ud, double beta, double *F)
{
    const NodeMatrix K = {e->K_start, e->K_column, e->K};
    blocks_times(e->nodes, &K, U, Ud, beta, F);
    if (e->pressure) pressure_force(e, e->pressure->B, U, Ud, beta, F);
}

/* R^T of the mean rotation R of a body, by sum (M X) x^T, x = X + U. 1 where there is none. */
static int mean_turn(const Field *e, const double *U, double *turn)
{
    double F[D * D] = {0.0}, Z[ROT * ROT];
    for (long i = 0; i < e->nodes; i++)
        for (int k = 0; k < D; k++) add(F + D * k, e->MX[D * i + k], U + D * i, D);
    add(F, 1.0, e->began + D * D, D * D);
    return polar(F, turn, Z);
}

/* F += beta R K R^T U' by the stiffness K without stress, R the mean rotation of the body. NEWTON where it has none. */
static int add_rest_damping(const Field *e, const double *U, const double *Ud, double *F)
{
    const NodeMatrix K = {e->K_start, e->K_column, e->K};
    double turn[D * D] = {0.0}, world[D], *rates = e->accel, *force = e->force;
    for (int i = 0; i < D; i++) turn[(D + 1) * i] = 1.0;
    if (e->turns && mean_turn(e, U, turn)) return NEWTON;
    for (long i = 0; i < e->n; i += D) times(turn, Ud + i, rates + i);
    memset(force, 0, e->n * sizeof(double));
    blocks_times(e->nodes, &K, rates, rates, 0.0, force);

    for (long i = 0; i < e->n; i += D) {
        transposed(turn, force + i, world);
        add(F + i, e->beta, world, D);
    }
    return DONE;
}

/* dPi/dp at U and p */
static void pressure_balance(const Pressure *o, const double *U, double *balance)
{
    const double *moving[FROM] = {U, NULL, o->p};
    memset(balance, 0, o->n * sizeof(double));
    for (int i = 0; i < o->integrals; i++) add_integral(o->integral + i, moving, balance);
}

/* The pressure that the law gives for U; no numbers where it is not found. */
static void take_pressure(const Field *e, const double *U)
{
    const Pressure *o = e->pressure;
    memset(o->p, 0, o->n * sizeof(double));
    pressure_balance(o, U, o->b);
    solve_pressure(e);
}

/* How far volumes are open at U, where the pressure is an unknown. */
static void open_volume(const Pressure *o, const double *U)
{
    pressure_balance(o, U, o->gap);
    for (long i = 0; o->keeps_volume && i < o->n; i++)
        for (int k = o->C_start[i]; k < o->C_start[i + 1]; k++) o->gap[i] += o->C[k] * o->p[o->C_column[k]];
}

/* F += forces that are linear in rates, but for those of the stiffness. */
static void drag_force(const Field *e, const double *Ud, double *F)
{
    if (e->drag) blocks_times(e->nodes, e->drag, Ud, Ud, 0.0, F);
    if (e->alpha > 0.0) {
        mass_times(e, Ud, e->accel);
        add(F, e->alpha, e->accel, e->n);
    }
}

/* F += those below over a step of h from U at the mean rate U', as fem/mean_forces.py has them. */
static void mean_material_force(const Field *e, const double *U, const double *Ud, double h, double *F)
{
    const double *moving[FROM] = {U, Ud, NULL, e->accel};
    drag_force(e, Ud, F);
    for (long i = 0; i < e->n; i++) e->accel[i] = U[i] + h * Ud[i];
    for (int i = 0; i < e->means; i++) add_integral(e->mean + i, moving, F);
}

/* e = B U of a dropper */
static double stretch(const Droppers *o, int i, const double *U)
{
    double sum = 0.0;
    for (int k = o->start[i]; k < o->start[i + 1]; k++) sum += o->row[k] * U[o->on[k]];
    return sum;
}

/* Its tension at that. */
static double tension(const Droppers *o, int i, double e)
{
    const double N = o->stiffness[i] * (e + o->offset[i]);
    return o->one_sided[i] && N < 0.0 ? 0.0 : N;
}

/* F += B^T N of that tension. */
static void pull_nodes(const Droppers *o, int i, double N, double *F)
{
    for (int k = o->start[i]; k < o->start[i + 1]; k++) F[o->on[k]] += N * o->row[k];
}

/* F += tensions of droppers, less those of taut ones without offset, which K has, damped by beta. */
static void dropper_forces(Droppers *o, const double *U, const double *Ud, double beta, double *F)
{
    o->switched = 0;
    for (int i = 0; i < o->count; i++) {
        const double e = stretch(o, i, U), N = tension(o, i, e);
        o->switched |= (N != o->stiffness[i] * (e + o->offset[i])) != o->slack[i];
        pull_nodes(o, i, N - o->stiffness[i] * (e + beta * stretch(o, i, Ud)), F);
    }
}

/* F += forces of elasticity and damping on the nodes, and of loads on the deformed body. */
static int material_force(const Field *e, const double *U, const double *Ud, double *F)
{
    const double *moving[FROM] = {U, Ud, e->pressure ? e->pressure->p : NULL};
    if (e->pressure && e->pressure->gap) open_volume(e->pressure, U);
    else if (e->integrals && e->pressure) take_pressure(e, U);
    drag_force(e, Ud, F);
    for (int i = 0; i < e->integrals; i++) add_integral(e->integral + i, moving, F);
    if (!e->integrals) stiffness_times(e, U, Ud, e->beta, F);
    if (e->droppers) dropper_forces(e->droppers, U, Ud, e->beta, F);
    return e->integrals && e->beta > 0.0 ? add_rest_damping(e, U, Ud, F) : DONE;
}

/* Loads at a time, asked for once. */
static int ask_loads(System *s, Field *e, double t)
{
    if (!e->dead || e->loaded_at == t) return DONE;
    e->loaded_at = NAN;
    s->calls++;
    if (s->python(FIELD_LOADS, e->number, t)) return FAILED;
    e->loaded_at = t;
    return DONE;
}

/* Loads on the nodes, and their resultant in body axes. */
static void add_loads(const Field *e, const double *R, const double *U, double *sum, double *local)
{
    double N[D * D] = {0.0}, moment[ROT], outer[D];
    for (long i = 0; i < e->n; i += D) {
        transposed(R, e->dead + i, outer);
        add(outer, 1.0, e->following + i, D);
        for (int j = 0; j < D; j++) {
            e->force[i + j] -= outer[j] + e->internal[i + j];
            sum[j] -= outer[j];
            for (int c = 0; c < D; c++) N[D * j + c] += (e->X[i + j] + U[i + j]) * outer[c] - U[i + j] * e->carried[i + c];
        }
    }

    axial(N, moment);
    add(local, -1.0, moment, ROT);
}
