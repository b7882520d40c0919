/* Reduced bodies: equations (2) of mechanics/reduction/reduced.py. Moments are returned in world axes; angular velocities and
   accelerations come in body axes. */

#include "tables.h"
#include "rotations.c"
#include "parts.h"
#include "surfaces.c"

/* The moments T(e_a, p) = T_a0 + sum_b eta_b T_ab of a reduced body, into U. */
static void modal_moments(const Body *o, const double *eta)
{
    int size = (o->modes + 1) * D * D;
    memcpy(o->U, o->T, size * sizeof(double));
    for (int c = 0; c < o->modes; c++) add(o->U, eta[c], o->T + size * (c + 1), size);
}

/* Verdict LOOK outside of the range of the reduction. */
int reduced_force(const Body *o, const double *R, const double *q, const double *v, const double *a, const double *w,
                         const double *gravity, const double *accel, double *f, double *rows)
{
    int m = o->modes, k = m + 1, DD = D * D, size = k * DD;
    const double *eta = q + o->at_q, *rate = v + o->at_v, *second = a + o->at_v, *alpha = accel + D;
    double *U = o->U, *Vp = U + size, *Me = Vp + ROT * k;
    double free_[D], acc[D], W[D * D], L[D * D], Sp[3][D], T0[D * D], T1[D * D], T2[D * D], N[D * D];

    for (int i = 0; i < D; i++) free_[i] = accel[i] - gravity[i];
    transposed(R, free_, acc);
    hat(w, W);
    product(W, W, L);
    hat(alpha, N);
    add(L, 1.0, N, DD);

    modal_moments(o, eta);
    memset(Vp, 0, (ROT * k + 2 * m) * sizeof(double));
    for (int c = 0; c < m; c++) add(Vp, rate[c], o->V + ROT * k * (c + 1), ROT * k);
    for (int i = 0; i < D; i++) {
        const double *S = o->S + k * i;
        Sp[0][i] = S[0] + dot(S + 1, eta, m);
        Sp[1][i] = dot(S + 1, rate, m);
        Sp[2][i] = dot(S + 1, second, m);
    }

    /* T(p, p), T(p, p')^T, T(p, p'')^T */
    memcpy(T0, U, sizeof T0);
    memset(T1, 0, sizeof T1);
    memset(T2, 0, sizeof T2);
    for (int c = 0; c < m; c++) {
        const double *Uc = U + DD * (c + 1);
        add(T0, eta[c], Uc, DD);
        add(T1, rate[c], Uc, DD);
        add(T2, second[c], Uc, DD);
    }

    double part[D * D], L1[D], W1[D], sum[D], local[ROT];
    product_transposed(T0, L, N);
    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++) {
            double twice = 0.0;
            for (int c = 0; c < D; c++) twice += T1[D * c + i] * W[D * j + c];
            part[D * i + j] = N[D * i + j] + 2.0 * twice + T2[D * j + i] + Sp[0][i] * acc[j];
        }
    axial(part, local);
    to_world(R, local, f + D);
    times(L, Sp[0], L1);
    times(W, Sp[1], W1);
    for (int i = 0; i < D; i++) sum[i] = o->mass * acc[i] + L1[i] + 2.0 * W1[i] + Sp[2][i];
    times(R, sum, f);

    double *elastic = Me + m;
    for (int c = 0; c < m; c++) {
        add(Me, eta[c], o->modal + m * c, m);
        add(elastic, second[c], o->modal + m * c, m);
        add(elastic, eta[c], o->K + m * c, m);
        add(elastic, rate[c], o->C + m * c, m);
    }
    if (o->stress) {
        memset(o->now, 0, m * m * sizeof(double));
        for (int c = 0; c < D + DD; c++) add(o->now, c < D ? acc[c] : L[c - D], o->stress + m * m * c, m * m);
        for (int i = 0; i < m; i++) add(elastic, eta[i], o->now + m * i, m);
    }
    for (int i = 0; i < m; i++) {
        double force = dot(U + DD * (i + 1), L, DD) + 2.0 * dot(Vp + ROT * (i + 1), w, ROT) + elastic[i];
        for (int j = 0; j < D; j++) force += acc[j] * o->S[k * j + i + 1];
        rows[i] = force;
    }
    return dot(eta, Me, m) <= o->large && dot(w, w, ROT) <= o->spin ? DONE : LOOK;
}

/* The lower half of the block of M + cd C + ck K into the fronts, world axes, at the configuration evaluated last. */
void reduced_block(System *s, const Body *o, const double *R, const double *eta, double cd, double ck)
{
    int m = o->modes, k = m + 1, n = TWIST + m, DD = D * D;
    const double *U = o->U;
    double *A = o->block, T0[D * D], arm[D], trace = 0.0;

    memcpy(T0, U, sizeof T0);
    for (int c = 0; c < m; c++) add(T0, eta[c], U + DD * (c + 1), DD);
    for (int i = 0; i < D; i++) {
        arm[i] = o->S[k * i] + dot(o->S + k * i + 1, eta, m);
        trace += T0[(D + 1) * i];
    }
    memset(A, 0, (size_t)n * n * sizeof(double));
    for (int i = 0; i < D; i++) A[(n + 1) * i] = o->mass;
#if DIM == 3
    double X[9], world[3], J[9], T[9];
    times(R, arm, world);
    hat(world, X);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) J[3 * i + j] = (i == j ? trace : 0.0) - 0.5 * (T0[3 * i + j] + T0[3 * j + i]);
    product_transposed(J, R, T);
    product(R, T, J);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            A[n * (3 + i) + 3 + j] = J[3 * i + j];
            A[n * (3 + i) + j] = X[3 * i + j];
        }
    static const int pair[3] = {7, 2, 3}, other[3] = {5, 6, 1};
#else
    double one = 1.0, across[2];
    spin(&one, arm, across);
    A[n * 2 + 2] = trace;
    times(R, across, A + n * 2);
    static const int pair[1] = {2}, other[1] = {1};
#endif
    for (int i = 0; i < m; i++) {
        double *row = A + n * (TWIST + i), turning[ROT];
        for (int j = 0; j < D; j++)
            for (int c = 0; c < D; c++) row[j] += R[D * j + c] * o->S[k * c + i + 1];
        const double *T_ = U + DD * (i + 1);
        for (int j = 0; j < ROT; j++) turning[j] = T_[pair[j]] - T_[other[j]];
        to_world(R, turning, row + D);
        for (int j = 0; j <= i; j++) row[TWIST + j] = o->modal[m * i + j] + cd * o->C[m * i + j] + ck * o->K[m * i + j];
        for (int j = 0; o->now && j <= i; j++) row[TWIST + j] += ck * o->now[m * i + j];
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
    for (int i = 0; i < m; i++) {
        kinetic += 0.5 * rate[i] * dot(o->modal + m * i, rate, m);
        elastic += 0.5 * eta[i] * dot(o->K + m * i, eta, m);
    }
    times(R, arm, world);
    out[0] += kinetic;
    out[1] += elastic;
    out[2] -= o->mass * dot(pose, gravity, D) + dot(world, gravity, D);
}
