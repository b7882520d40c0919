/* Fields with geometric stiffening: their second-order displacements, and ports of second order, as mechanics/elastic/stiffening.py,
   foreshortening.py and second_order.py.

   Every stress acts by one scalar matrix on each component of U alike: those of unit a_c and L_ij, K_c, those of unit forces on
   the surfaces in use, G_r, and D x D of each load, of its component i along axis j of the body. They share a pattern and lie entry by entry, so that one pass gives all K_c U and G_r U (``bent``), and
   the numbers U K U, U' K U, U' K U' (``form``). The ports are p = B U + N y with y_r = -U G_r U / 2: columns of H that follow U. */

#include "bodies/second_order.c"

static int stresses(const Field *e) { return e->stresses + e->bends + D * D * e->stressing; }

/* ``bent`` and ``form`` of a configuration. */
static void bend_field(const Field *e, const double *U, const double *Ud)
{
    int k = stresses(e);
    double *stretch = e->form, *rate = stretch + k, *second = rate + k;
    memset(e->form, 0, 3 * k * sizeof(double));
    memset(e->bent, 0, e->n * k * sizeof(double));
    for (long i = 0; i < e->nodes; i++) {
        double *bent = e->bent + D * i * k;
        for (int p = e->stress_start[i]; p < e->stress_start[i + 1]; p++) {
            const double *G = e->stress + (long)k * p, *u = U + D * e->stress_column[p];
            for (int j = 0; j < D; j++) add(bent + k * j, u[j], G, k);
            add(second, dot(Ud + D * i, Ud + D * e->stress_column[p], D), G, k);
        }

        for (int j = 0; j < D; j++) {
            add(stretch, U[D * i + j], bent + k * j, k);
            add(rate, Ud[D * i + j], bent + k * j, k);
        }
    }
}

/* p += c N y of the numbers y of all ports of second order. */
static void shorten(const Body *o, double c, const double *y, double *p)
{
    const Field *e = o->field;
    for (int k = 0; e->bends && k < o->modes; k++) p[k] += c * dot(e->N + e->bends * k, y, e->bends);
}

/* x += H f for the numbers f of all columns, at the configuration placed last. */
void add_columns(const Body *o, const double *f, double *x)
{
    const Field *e = o->field;
    double *pull = e->pull;
    int k = stresses(e), pulled = 0;
    memset(pull, 0, e->bends * sizeof(double));
    for (int i = 0; i < o->modes; i++) {
        if (f[i] == 0.0) continue;
        add_column(e, i, f[i], x);
        add(pull, f[i], e->N + e->bends * i, e->bends);
    }
    for (int r = 0; r < e->bends; r++) pulled |= pull[r] != 0.0;
    for (long i = 0; pulled && i < e->n; i++) x[i] -= dot(e->bent + k * i + e->stresses, pull, e->bends);
}

/* Rates H^T V of the ports for rates V of the nodes, at the configuration placed last. */
void field_rates(const Body *o, const double *v)
{
    const Field *e = o->field;
    const double *V = v + o->at_v;
    for (int k = 0; k < o->modes; k++) e->rates[k] = column(e, k, V);
    if (!e->bends) return;

    memset(e->pull, 0, e->bends * sizeof(double));
    for (long i = 0; i < e->n; i++) add(e->pull, V[i], e->bent + stresses(e) * i + e->stresses, e->bends);
    shorten(o, -1.0, e->pull, e->rates);
}

/* What ports that move along the body add to the rates of their numbers, and to the second derivatives. */
static void carry_ports(const Body *o, const double *U, const double *Ud)
{
    const Field *e = o->field;
    for (int k = e->inertial; k < o->modes; k++) {
        e->moved[k] = e->bias[k] = 0.0;
        for (int i = e->port_start[k - e->inertial]; i < e->port_start[k - e->inertial + 1]; i++) {
            const int at = e->port_on[i];
            e->moved[k] += e->drift[i] * U[at];
            e->bias[k] += 2.0 * e->drift[i] * Ud[at] + e->curve[i] * U[at];
        }
        e->rates[k] += e->moved[k];
    }
}

/* The numbers of the ports, their rates, and what U' alone adds to their second derivatives. */
void field_columns(const Body *o, const double *q, const double *v)
{
    const Field *e = o->field;
    for (int k = 0; k < o->modes; k++) {
        e->p[k] = column(e, k, q + o->at_q);
        e->rates[k] = column(e, k, v + o->at_v);
    }
    if (e->drift) carry_ports(o, q + o->at_q, v + o->at_v);
    if (!stresses(e)) return;

    const double *form = e->form + e->stresses;
    bend_field(e, q + o->at_q, v + o->at_v);
    memset(e->bias, 0, o->modes * sizeof(double));
    shorten(o, -0.5, form, e->p);
    shorten(o, -1.0, form + stresses(e), e->rates);
    shorten(o, -1.0, form + 2 * stresses(e), e->bias);
}

/* Of count of U, U', U'', placed last. */
static void moments_of(const Field *e, const double **local, int count, Moments *z)
{
    int k = stresses(e);
    memset(z, 0, sizeof *z);
    memcpy(z->s[0], e->first, D * sizeof(double));
    memcpy(z->T[0], e->first + D, D * D * sizeof(double));

    for (int r = 0; r < count; r++) {
        for (long i = 0; i < e->nodes; i++) {
            const double *u = local[r] + D * i;
            add(z->s[r], e->one[i], u, D);
            outer(e->MX + D * i, u, z->T[r]);
        }
        for (int c = 0; c < e->stresses; c++) *moment_at(z, r, c) = (r ? 1.0 : 0.5) * e->form[k * r + c];
    }
    if (count < 3) return;

    double along[D + D * D] = {0.0};
    for (long i = 0; i < e->n; i++) add(along, local[2][i], e->bent + k * i, e->stresses);
    for (int c = 0; c < e->stresses; c++) *moment_at(z, 2, c) += along[c];
}

static Rest rest_of(const Body *o)
{
    Rest rest = {o->mass, {0.0}, o->mean};
    memcpy(rest.S, o->field->first, sizeof rest.S);
    return rest;
}

/* (4) of second_order.py, added to the resultant and the moments N of the frame (body axes), and to the forces on the nodes. */
static void stiffened(const Body *o, const double **local, const double *W, const double *alpha, const double *acc, double *force,
                      double *N)
{
    const Field *e = o->field;
    double a[D], L[D * D], stress[D + D * D];
    Rest rest = rest_of(o);
    Moments z;
    moments_of(e, local, 3, &z);
    second_order(&rest, &z, W, alpha, acc, force, N, a, L, stress);

    for (long i = 0; i < e->nodes; i++)
        for (int j = 0; j < D; j++) {
            e->force[D * i + j] += e->one[i] * a[j] + dot(L + D * j, e->MX + D * i, D);
            e->force[D * i + j] += dot(e->bent + stresses(e) * (D * i + j), stress, e->stresses);
        }
}

/* Stress and turns of loads, added to the resultant and the moment of the frame (body axes), and to the forces on the nodes. */
static void stress_of_loads(Field *e, const double *R, const double *U, double *sum, double *local)
{
    const int first = e->stresses + e->bends, k = stresses(e);
    double N[D * D] = {0.0}, moment[ROT];
    for (int l = 0; l < e->stressing; l++) {
        const double *twice = e->form + first + D * D * l, factor = e->load_factor[l];
        double axes[D * D];
        for (int i = 0; i < D; i++)
            for (int j = 0; j < D; j++) axes[D * i + j] = factor * (e->load_turns[l] ? i == j : R[D * i + j]);
        for (long i = 0; i < e->n; i++) e->force[i] += dot(e->bent + k * i + first + D * D * l, axes, D * D);
        if (!e->turning[l]) { /* (5) of second_order.py: the work on second-order displacements */
            for (int i = 0; i < D; i++)
                for (int j = 0; j < D; j++) add(N + D * j, 0.5 * twice[D * i + j], axes + D * i, D);
            continue;
        }

        memset(e->accel, 0, e->n * sizeof(double));
        blocks_times(e->nodes, e->turning[l], U, U, 0.0, e->accel);
        for (long i = 0; i < e->n; i += D)
            for (int j = 0; j < D; j++) {
                e->force[i + j] -= factor * e->accel[i + j];
                sum[j] -= factor * e->accel[i + j];
                add(N + D * j, -factor * e->X[i + j], e->accel + i, D);
            }
    }

    for (long i = 0; e->stressing && i < e->n; i += D) /* by the ways of all that are carried along */
        for (int j = 0; j < D; j++) add(N + D * j, -U[i + j], e->carried + i, D);
    axial(N, moment);
    add(local, 1.0, moment, ROT);
}

/* (3) of second_order.py, and m2 added to the arm of the weight. */
static double stiffened_energy(const Body *o, const double **local, const double *v, const double *W, double *arm)
{
    Rest rest = rest_of(o);
    Moments z;
    moments_of(o->field, local, 2, &z);
    add(arm, 1.0, z.m[0], D);
    return second_energy(&rest, &z, v, W);
}

/* What second-order displacements add to the mass of the frame, world axes, into the block A (n columns). */
static void stiffened_block(const Field *e, const double *R, double *A, int n)
{
    double turn[TWIST * TWIST] = {0.0}, turned[TWIST * TWIST] = {0.0};
    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++) {
            turn[TWIST * i + j] = R[D * i + j];
            if (DIM == 3) turn[TWIST * (D + i) + D + j] = R[D * i + j];
        }
    if (DIM == 2) turn[TWIST * TWIST - 1] = 1.0;

    for (int i = 0; i < TWIST; i++)
        for (int k = 0; k < TWIST; k++) add(turned + TWIST * i, turn[TWIST * i + k], e->second + TWIST * k, TWIST);
    for (int i = 0; i < TWIST; i++)
        for (int j = 0; j < TWIST; j++) A[n * i + j] += dot(turned + TWIST * i, turn + TWIST * j, TWIST);
}
