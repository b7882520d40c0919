/* Reduced bodies: equations (2) of mechanics/reduction/reduced.py. Moments are returned in world axes; angular velocities and
   accelerations come in body axes. */

#include "tables.h"
#include "algebra/rotations.c"
#include "parts.h"
#include "bodies/surfaces.c"
#include "bodies/second_order.c"

/* The moments T(e_a, p) = T_a0 + sum_b eta_b T_ab of a reduced body, into U. */
static void modal_moments(const Body *o, const double *eta)
{
    int size = (o->modes + 1) * D * D;
    memcpy(o->U, o->T, size * sizeof(double));
    for (int c = 0; c < o->modes; c++) add(o->U, eta[c], o->T + size * (c + 1), size);
}

/* The undeformed body. */
static Rest rest_of(const Body *o)
{
    Rest rest = {o->mass, {0.0}, o->mean};
    for (int i = 0; i < D; i++) rest.S[i] = o->S[(o->modes + 1) * i];
    return rest;
}

/* y = K x for the matrix whose columns are the rows of K: by columns, of which the processor adds several entries at once. */
static void by_columns(const double *K, const double *x, int m, double *y)
{
    memset(y, 0, m * sizeof(double));
    for (int j = 0; j < m; j++) add(y, x[j], K + m * j, m);
}

/* K_c eta and K_ij eta of the configuration into bent. */
static void bend_modes(const Body *o, const double *eta)
{
    int m = o->modes;
    for (int c = 0; c < D + D * D; c++) by_columns(o->stress + m * m * c, eta, m, o->bent + m * c);
}

/* (1) of mechanics/elastic/second_order.py for count of eta, eta', eta''; bent is there. */
static void moments_of(const Body *o, const double **local, int count, Moments *z)
{
    int m = o->modes, k = m + 1, DD = D * D, size = k * DD;
    double *turned = o->bent + m * (D + DD);
    memset(z, 0, sizeof *z);
    memcpy(z->T[0], o->T, DD * sizeof(double));
    for (int i = 0; i < D; i++) z->s[0][i] = o->S[k * i];
    for (int r = 0; r < count; r++) {
        for (int i = 0; i < D; i++) z->s[r][i] += dot(o->S + k * i + 1, local[r], m);
        for (int b = 0; b < m; b++) add(z->T[r], local[r][b], o->T + size * (b + 1), DD);
    }

    for (int c = 0; c < D + DD; c++) {
        const double *bent = o->bent + m * c;
        for (int r = 0; r < count; r++) *moment_at(z, r, c) = (r ? 1.0 : 0.5) * dot(bent, local[r], m);
        if (count < 3) continue;
        by_columns(o->stress + m * m * c, local[1], m, turned);
        *moment_at(z, 2, c) += dot(turned, local[1], m);
    }
}

/* (4) of second_order.py, added to force and N (body axes) and to the rows of the modes. */
static void stiffened(const Body *o, const double **local, const double *W, const double *alpha, const double *acc, double *force,
                      double *N, double *rows)
{
    int m = o->modes, DD = D * D;
    double a[D], L[D * D], stress[D + D * D];
    Rest rest = rest_of(o);
    Moments z;
    bend_modes(o, local[0]);
    moments_of(o, local, 3, &z);
    second_order(&rest, &z, W, alpha, acc, force, N, a, L, stress);

    memset(o->now, 0, m * m * sizeof(double));
    for (int i = 0; i < m; i++) {
        rows[i] += dot(o->T + DD * (i + 1), L, DD);
        for (int j = 0; j < D; j++) rows[i] += a[j] * o->S[(m + 1) * j + i + 1];
    }
    for (int c = 0; c < D + DD; c++) {
        add(rows, stress[c], o->bent + m * c, m);
        add(o->now, stress[c], o->stress + m * m * c, m * m);
    }
}

/* A momentum and the axial part of its moment as column j of TWIST rows of n numbers. */
static void put_column(double *A, int n, int j, const double *momentum, const double *moment)
{
    double turn[ROT];
    axial(moment, turn);
    for (int i = 0; i < D; i++) A[n * i + j] = momentum[i];
    for (int i = 0; i < ROT; i++) A[n * (D + i) + j] = turn[i];
}

/* Columns of g (A) and h (B) of (2) in second_order.py for a unit of each speed of the frame, along world axes. */
static void frame_columns(const Body *o, const Moments *z, const double *R, int n, double *A, double *B)
{
    Rest rest = rest_of(o);
    for (int j = 0; j < TWIST; j++) {
        double unit[TWIST] = {0.0}, c[TWIST], W[D * D];
        double g[D] = {0.0}, G[D * D] = {0.0}, h[D] = {0.0}, H[D * D] = {0.0};

        unit[j] = 1.0;
        transposed(R, unit, c);
        to_body(R, unit + D, c + D);
        hat(c + D, W);
        const double *turns[] = {W};
        collect(z->s, z->T, turns, 1, g, G);
        carry(&rest, c, g, G);
        put_column(A, n, j, g, G);
        collect(z->m, z->P, turns, 1, h, H);
        put_column(B, n, j, h, H);
    }
}

/* The same for a unit of the rate of each mode. */
static void mode_columns(const Body *o, int n, double *A, double *B)
{
    const int m = o->modes, k = m + 1;
#if DIM == 3
    static const int pair[3] = {7, 2, 3}, other[3] = {5, 6, 1};
#else
    static const int pair[1] = {2}, other[1] = {1};
#endif

    for (int c = 0; c < m; c++) {
        for (int i = 0; i < D; i++) A[n * i + TWIST + c] = o->S[k * i + c + 1], B[n * i + TWIST + c] = o->bent[m * i + c];
        for (int i = 0; i < ROT; i++) {
            A[n * (D + i) + TWIST + c] = o->V[ROT * (c + 1) + i];
            B[n * (D + i) + TWIST + c] = o->bent[m * (D + pair[i]) + c] - o->bent[m * (D + other[i]) + c];
        }
    }
}

/* What (3) of second_order.py adds to the lower half of the block, world axes: (A + B)^T J^-1 (A + B) - A^T J^-1 A. */
static void second_block(const Body *o, const double *R, const double *eta)
{
    const int n = TWIST + o->modes;
    double *A = o->heavy, *B = A + TWIST * n, *JA = B + TWIST * n, *JB = JA + TWIST * n;
    const double *local[] = {eta};
    Moments z;
    bend_modes(o, eta);
    moments_of(o, local, 1, &z);
    memset(A, 0, (size_t)4 * TWIST * n * sizeof(double));
    frame_columns(o, &z, R, n, A, B);
    mode_columns(o, n, A, B);

    for (int i = 0; i < TWIST; i++)
        for (int j = 0; j < TWIST; j++) {
            add(JA + n * i, o->mean[TWIST * i + j], A + n * j, n);
            add(JB + n * i, o->mean[TWIST * i + j], B + n * j, n);
        }
    for (int r = 0; r < TWIST; r++)
        for (int i = 0; i < n; i++) {
            add(o->block + n * i, A[n * r + i] + B[n * r + i], JB + n * r, i + 1);
            add(o->block + n * i, B[n * r + i], JA + n * r, i + 1);
        }
}

/* Moments at the coordinates and along their two rates, local[0..2]: S(p), S'(p'), S'(p'') and, transposed, T(p, p), T(p, p'),
   T(p, p''). */
static void moments_along(const Body *o, const double **local, double S[3][D], double T[3][D * D])
{
    int m = o->modes, k = m + 1, DD = D * D;
    for (int r = 0; r < 3; r++) {
        for (int i = 0; i < D; i++) {
            const double *at_rest = o->S + k * i;
            S[r][i] = (r ? 0.0 : at_rest[0]) + dot(at_rest + 1, local[r], m);
        }
        if (r) memset(T[r], 0, DD * sizeof(double));
        else memcpy(T[r], o->U, DD * sizeof(double));
        for (int c = 0; c < m; c++) add(T[r], local[r][c], o->U + DD * (c + 1), DD);
    }
}

/* Rows of the coordinates: inertia, of the frame's acceleration acc and its turn L = alpha^ + w^ w^ too, stiffness and damping;
   ``elastic`` begins with what stiffens. Returns the square of deformations by which the range of the reduction is told. */
static double modal_rows(const Body *o, const double **local, const double *acc, const double *L, const double *w, double *elastic,
                         double *rows)
{
    int m = o->modes, k = m + 1, DD = D * D;
    double *Vp = o->U + k * DD, *inertia = Vp + ROT * k;

    memset(Vp, 0, ROT * k * sizeof(double));
    memset(inertia, 0, m * sizeof(double));
    for (int c = 0; c < m; c++) {
        add(Vp, local[1][c], o->V + ROT * k * (c + 1), ROT * k);
        add(inertia, local[0][c], o->modal + m * c, m);
        add(elastic, local[2][c], o->modal + m * c, m);
        add(elastic, local[0][c], o->K + m * c, m);
        add(elastic, local[1][c], o->C + m * c, m);
    }

    for (int i = 0; i < m; i++) {
        double force = dot(o->U + DD * (i + 1), L, DD) + 2.0 * dot(Vp + ROT * (i + 1), w, ROT) + elastic[i];
        for (int j = 0; j < D; j++) force += acc[j] * o->S[k * j + i + 1];
        rows[i] = force;
    }
    return dot(local[0], inertia, m);
}

/* M a + h of the frame (f, world axes) and of the coordinates (rows), of a body that turns with w (body axes). Verdict LOOK outside
   of the range of the reduction. */
int reduced_force(const Body *o, const double *R, const double *q, const double *v, const double *a, const double *w,
                         const double *gravity, const double *accel, double *f, double *rows)
{
    const double *local[] = {q + o->at_q, v + o->at_v, a + o->at_v}, *alpha = accel + D;
    double apart[D], acc[D], W[D * D], L[D * D], S[3][D], T[3][D * D], N[D * D];

    /* the motion of the frame in body axes: x'' - g, w^ and L = alpha^ + w^ w^ */
    for (int i = 0; i < D; i++) apart[i] = accel[i] - gravity[i];
    transposed(R, apart, acc);
    hat(w, W);
    product(W, W, L);
    hat(alpha, N);
    add(L, 1.0, N, D * D);

    modal_moments(o, local[0]);
    moments_along(o, local, S, T);

    /* moments of inertia forces about the frame, as a matrix whose axial vector they are */
    double turning[D * D], of_frame[D], of_rates[D], more[D] = {0.0}, moment[ROT], sum[D];
    product_transposed(T[0], L, N);
    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++) {
            double twice = 0.0;
            for (int c = 0; c < D; c++) twice += T[1][D * c + i] * W[D * j + c];
            turning[D * i + j] = N[D * i + j] + 2.0 * twice + T[2][D * j + i] + S[0][i] * acc[j];
        }

    double *elastic = o->U + (o->modes + 1) * (D * D + ROT) + o->modes;
    memset(elastic, 0, o->modes * sizeof(double));
    if (o->stress) stiffened(o, local, W, alpha, acc, more, turning, elastic);
    axial(turning, moment);
    to_world(R, moment, f + D);

    /* and their sum */
    times(L, S[0], of_frame);
    times(W, S[1], of_rates);
    for (int i = 0; i < D; i++) sum[i] = more[i] + o->mass * acc[i] + of_frame[i] + 2.0 * of_rates[i] + S[2][i];
    times(R, sum, f);

    return modal_rows(o, local, acc, L, w, elastic, rows) <= o->large ? DONE : LOOK;
}

/* The lower half of M in the block, world axes: at these coordinates, which need not be those evaluated last. */
static void reduced_masses(const Body *o, const double *R, const double *eta)
{
    int m = o->modes, k = m + 1, n = TWIST + m, DD = D * D;
    const double *U = o->U;
    double *A = o->block, T0[D * D], J[ROT * ROT], arm[D], trace = 0.0;

    modal_moments(o, eta);
    memcpy(T0, U, sizeof T0);
    for (int c = 0; c < m; c++) add(T0, eta[c], U + DD * (c + 1), DD);
    for (int i = 0; i < D; i++) {
        arm[i] = o->S[k * i] + dot(o->S + k * i + 1, eta, m);
    }

    for (int i = 0; i < D; i++) trace += T0[(D + 1) * i];
    for (int i = 0; i < D; i++) A[(n + 1) * i] = o->mass;
#if DIM == 3
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) J[3 * i + j] = (i == j ? trace : 0.0) - 0.5 * (T0[3 * i + j] + T0[3 * j + i]);
    static const int pair[3] = {7, 2, 3}, other[3] = {5, 6, 1};
#else
    J[0] = trace;
    static const int pair[1] = {2}, other[1] = {1};
#endif
    turning_rows(R, arm, J, A, n);

    for (int i = 0; i < m; i++) {
        double *row = A + n * (TWIST + i), turning[ROT];
        for (int j = 0; j < D; j++)
            for (int c = 0; c < D; c++) row[j] += R[D * j + c] * o->S[k * c + i + 1];
        const double *T_ = U + DD * (i + 1);
        for (int j = 0; j < ROT; j++) turning[j] = T_[pair[j]] - T_[other[j]];
        to_world(R, turning, row + D);
        for (int j = 0; j <= i; j++) row[TWIST + j] = o->modal[m * i + j];
    }
    if (o->stress) second_block(o, R, eta);
}

/* The lower half of the block of M + cd C + ck K into the fronts, world axes, at the configuration evaluated last; without M where it
   is an imaginary part. */
void reduced_block(System *s, const Body *o, const double *R, const double *eta, double cd, double ck)
{
    int m = o->modes, n = TWIST + m;
    double *A = o->block;
    memset(A, 0, (size_t)n * n * sizeof(double));
    if (!s->imaginary) reduced_masses(o, R, eta);
    for (int i = 0; i < m; i++) {
        double *row = A + n * (TWIST + i) + TWIST;
        for (int j = 0; j <= i; j++) row[j] += cd * o->C[m * i + j] + ck * o->K[m * i + j];
        for (int j = 0; o->now && j <= i; j++) row[j] += ck * o->now[m * i + j];
    }

    const int *dest = o->dest;
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) s->L[*dest++] += A[n * i + j];
        s->diagonal[o->at_u + i] = A[(n + 1) * i];
    }
}

/* Kinetic, elastic and potential energy of weight, added to out. */
void reduced_energies(const Body *o, const double *R, const double *q, const double *v, const double *pose, const double *twist,
                      const double *gravity, double *out)
{
    int m = o->modes, k = m + 1, DD = D * D;
    const double *eta = q + o->at_q, *rate = v + o->at_v;
    double arm[D], drift[D], local[D], W[D * D], T0[D * D], T1[D * D], WT[D * D], world[D], kinetic = 0.0, elastic = 0.0;
    modal_moments(o, eta);
    memcpy(T0, o->U, sizeof T0);
    memset(T1, 0, sizeof T1);
    for (int c = 0; c < m; c++) {
        add(T0, eta[c], o->U + DD * (c + 1), DD);
        add(T1, rate[c], o->U + DD * (c + 1), DD);
    }

    for (int i = 0; i < D; i++) {
        arm[i] = o->S[k * i] + dot(o->S + k * i + 1, eta, m);
        drift[i] = dot(o->S + k * i + 1, rate, m);
    }

    /* sum of m |r' + w x p + p'|^2 / 2 in body axes, p = X + Phi eta */
    transposed(R, twist, local);
    hat(twist + D, W);
    product(W, T0, WT);
    double turn_arm[D];
    times(W, arm, turn_arm);
    kinetic = 0.5 * o->mass * dot(local, local, D) + dot(local, turn_arm, D) + dot(local, drift, D);
    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++) {
            kinetic += 0.5 * WT[D * i + j] * W[D * i + j];
            kinetic += W[D * i + j] * T1[D * i + j];
        }

    if (o->stress) {
        const double *both[] = {eta, rate};
        Rest rest = rest_of(o);
        Moments z;
        bend_modes(o, eta);
        moments_of(o, both, 2, &z);
        kinetic += second_energy(&rest, &z, local, W);
        add(arm, 1.0, z.m[0], D);
    }

    for (int i = 0; i < m; i++) {
        kinetic += 0.5 * rate[i] * dot(o->modal + m * i, rate, m);
        elastic += 0.5 * eta[i] * dot(o->K + m * i, eta, m);
    }
    times(R, arm, world);
    out[0] += kinetic;
    out[1] += elastic;
    out[2] -= o->mass * dot(pose, gravity, D) + dot(world, gravity, D);
}
