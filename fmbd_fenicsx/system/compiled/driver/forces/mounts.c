/* Bushings, equation (1) of mechanics/forces/bushing.py: s and s' of two markers, an effort K s + C s' on all components at once. */

#include "tables.h"
#include "algebra/rotations.c"
#include "parts.h"

enum { MOUNT_ROWS = D + ROT, MOUNT_BOTH = 2 * TWIST };
enum { MOUNT_P = 0, MOUNT_TA = D, MOUNT_Q = D + D * D, MOUNT_TB = 2 * D + D * D, MOUNT_K = 2 * (D + D * D),
       MOUNT_C = MOUNT_K + MOUNT_ROWS * MOUNT_ROWS };      /* where places, turns, K and C begin among the constants */
enum { XA = 0, PA = D, XB = TWIST, PB = TWIST + D };       /* where displacements and turns of both frames begin */

typedef struct {
    double s[MOUNT_ROWS], effort[MOUNT_ROWS];
    double row[2][MOUNT_ROWS * TWIST];                     /* ds/dt on the twists of frames a and b, world axes */
    double axes[D * D], turning[ROT * ROT];                /* E: axes of marker a; T: theta' = T (w_b - w_a); world axes */
    double arm[D], lever[D];                               /* r, l: from the origins of both frames to marker b */
} Mount;

/* C = A B and C = A^T B for n x k or k x n, and k x m matrices by rows; sizes are known where these are used. */
static inline void multiply(const double *A, const double *B, double *C, int n, int k, int m)
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j < m; j++) {
            double sum = 0.0;
            for (int l = 0; l < k; l++) sum += A[k * i + l] * B[m * l + j];
            C[m * i + j] = sum;
        }
}

static inline void multiply_turned(const double *A, const double *B, double *C, int n, int k, int m)
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j < m; j++) {
            double sum = 0.0;
            for (int l = 0; l < k; l++) sum += A[n * l + i] * B[m * l + j];
            C[m * i + j] = sum;
        }
}

#if DIM == 3
/* The rotation vector of R. */
static void rotation_vector(const double *R, double *theta)
{
    double axis[3] = {0.5 * (R[7] - R[5]), 0.5 * (R[2] - R[6]), 0.5 * (R[3] - R[1])};
    double sine2 = dot(axis, axis, 3), cosine = 0.5 * (R[0] + R[4] + R[8] - 1.0), sine = sqrt(sine2), ratio;
    if (sine2 < 1e-4 && cosine > 0)
        ratio = 1 + sine2 * (1.0 / 6 + sine2 * (3.0 / 40 + sine2 * (15.0 / 336 + sine2 * 105.0 / 3456)));
    else ratio = 2 * atan2(sine, 1 + cosine) / sine;
    for (int i = 0; i < 3; i++) theta[i] = ratio * axis[i];
}

/* The matrix from angular velocities in the axes of marker a to the rate of the rotation vector theta. */
static void rotation_rate(const double *theta, double *rate)
{
    double H[9], HH[9], c = half_cotangent(dot(theta, theta, 3));
    hat(theta, H);
    product(H, H, HH);
    for (int i = 0; i < 9; i++) rate[i] = (i % 4 == 0) - 0.5 * H[i] + c * HH[i];
}
#else
static void rotation_vector(const double *R, double *theta) { theta[0] = 2 * atan2(R[2], 1 + R[0]); }
static void rotation_rate(const double *theta, double *rate) { (void)theta, rate[0] = 1.0; }
#endif

/* s of two frames, with axes and levers. */
static void mount_deflection(const System *s, const Batch *k, long i, Mount *m)
{
    const double *P = k->P + k->width * i, *a = s->frames + FRAME * k->pair[2 * i], *b = s->frames + FRAME * k->pair[2 * i + 1];
    double Rb[D * D], R[D * D], apart[D];
    product(a + TURN, P + MOUNT_TA, m->axes);
    product(b + TURN, P + MOUNT_TB, Rb);
    times(a + TURN, P + MOUNT_P, m->arm);
    times(b + TURN, P + MOUNT_Q, m->lever);
    for (int j = 0; j < D; j++) apart[j] = b[j] + m->lever[j] - a[j] - m->arm[j];
    for (int j = 0; j < D; j++) m->arm[j] += apart[j];

    transposed(m->axes, apart, m->s);
    multiply_turned(m->axes, Rb, R, D, D, D);
    rotation_vector(R, m->s + D);
}

/* d(p x x)/dp, D x ROT */
static inline void turned_by(const double *x, double *L)
{
#if DIM == 3
    L[0] = L[4] = L[8] = 0.0;
    L[1] = x[2]; L[2] = -x[1]; L[3] = -x[2]; L[5] = x[0]; L[6] = x[1]; L[7] = -x[0];
#else
    L[0] = -x[1];
    L[1] = x[0];
#endif
}

/* The share of one frame in s' = [E^T (v_b + w_b x l - v_a - w_a x r), T (w_b - w_a)] by rows: a sign, and the arm to marker b. */
static void mount_row(const Mount *m, double sign, const double *arm, double *row)
{
    double across[D * ROT], by_turn[D * ROT];
    turned_by(arm, across);
    multiply_turned(m->axes, across, by_turn, D, D, ROT);

    for (int i = 0; i < D; i++, row += TWIST) {
        for (int j = 0; j < D; j++) row[j] = sign * m->axes[D * j + i];
        for (int j = 0; j < ROT; j++) row[D + j] = sign * by_turn[ROT * i + j];
    }
    for (int i = 0; i < ROT; i++, row += TWIST) {
        for (int j = 0; j < D; j++) row[j] = 0.0;
        for (int j = 0; j < ROT; j++) row[D + j] = sign * m->turning[ROT * i + j];
    }
}

/* Everything of one bushing at the frames as they are. */
static void mount_at(const System *s, const Batch *k, long i, Mount *m)
{
    const double *P = k->P + k->width * i, *va = s->frames + FRAME * k->pair[2 * i] + SPEED;
    const double *vb = s->frames + FRAME * k->pair[2 * i + 1] + SPEED;
    double speed[MOUNT_ROWS], rate[ROT * ROT];
    mount_deflection(s, k, i, m);
    rotation_rate(m->s + D, rate);
#if DIM == 3
    product_transposed(rate, m->axes, m->turning);
#else
    m->turning[0] = rate[0];
#endif
    mount_row(m, -1.0, m->arm, m->row[0]);
    mount_row(m, 1.0, m->lever, m->row[1]);

    for (int r = 0; r < MOUNT_ROWS; r++) speed[r] = dot(m->row[0] + TWIST * r, va, TWIST) + dot(m->row[1] + TWIST * r, vb, TWIST);
    for (int r = 0; r < MOUNT_ROWS; r++)
        m->effort[r] = dot(P + MOUNT_K + MOUNT_ROWS * r, m->s, MOUNT_ROWS) + dot(P + MOUNT_C + MOUNT_ROWS * r, speed, MOUNT_ROWS);
}

/* Efforts into the residuals; what was evaluated is kept for the tangent. */
void mount_forces(System *s, const Batch *k)
{
    const int *at = k->at;
    for (long i = 0; i < k->n; i++) {
        Mount *m = (Mount *)k->known + i;
        mount_at(s, k, i, m);
        for (int side = 0; side < 2; side++, at += TWIST) {
            double push[TWIST];
            multiply_turned(m->row[side], m->effort, push, TWIST, MOUNT_ROWS, 1);
            for (int j = 0; j < TWIST; j++) s->residual[at[j]] += push[j];
        }
    }
}

double mount_energy(const System *s, const Batch *k)
{
    double sum = 0.0;
    for (long i = 0; i < k->n; i++) {
        Mount m;
        mount_deflection(s, k, i, &m);
        for (int r = 0; r < MOUNT_ROWS; r++)
            sum += 0.5 * m.s[r] * dot(k->P + k->width * i + MOUNT_K + MOUNT_ROWS * r, m.s, MOUNT_ROWS);
    }
    return sum;
}

#if DIM == 3
/* half_cotangent and its derivative by the square of the angle, which needs a longer series. */
static double curl(double square, double *slope)
{
    if (square < 1e-2) {
        *slope = 1.0 / 720 + square * (1.0 / 15120 + square * (1.0 / 403200 + square / 11975040));
        return 1.0 / 12 + square * (1.0 / 720 + square * (1.0 / 30240 + square * (1.0 / 1209600 + square / 47900160)));
    }
    double angle = sqrt(square), half = 0.5 * angle, sine = sin(half), cotangent = cos(half) / sine, open = 1 - half * cotangent;
    *slope = -(cotangent - half / (sine * sine)) / (4 * angle * square) - open / (square * square);
    return open / square;
}

/* The symmetric part of M = E (dH^T tau / dtheta) T, H the matrix of rotation_rate, tau the efforts about the axes: the change of
   the torque with turns of b against a. */
static void torque_turns(const Mount *m, double *M)
{
    const double *theta = m->s + D, *tau = m->effort + D;
    double square = dot(theta, theta, 3), along = dot(theta, tau, 3), slope, c = curl(square, &slope), G[9], GT[9], full[9];
    hat(tau, G);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double bent = theta[i] * along - square * tau[i];
            G[3 * i + j] = c * (theta[i] * tau[j] - 2 * tau[i] * theta[j]) + 2 * slope * bent * theta[j] - 0.5 * G[3 * i + j];
            if (i == j) G[3 * i + j] += c * along;
        }

    product(G, m->turning, GT);
    product(m->axes, GT, full);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) M[3 * i + j] = 0.5 * (full[3 * i + j] + full[3 * j + i]);
}
#endif

static inline void add_both(double *C, int r, int c, double x)
{
    C[MOUNT_BOTH * r + c] += x;
    C[MOUNT_BOTH * c + r] += x;
}

/* The symmetric part of what efforts change as both frames move, times ``weight``. With u = x_b + p_b x l - x_a - p_a x r, and the
   force F and the torque T on b, of which small displacements make

       dF = p_a x F,   d(l x F) = (p_b x l) x F + l x dF,   d(r x F) = (dx_b + p_b x l - dx_a) x F + r x dF,
       dT = p_a x T + M (p_b - p_a)                                                                            (2) */
static void mount_curves(const Mount *m, double weight, double *C)
{
    double force[D], F[D * ROT], l[D * ROT], r[D * ROT], by_l[ROT * ROT], by_r[ROT * ROT], M[ROT * ROT] = {0.0}, T[ROT * ROT] = {0.0};
    times(m->axes, m->effort, force);
    turned_by(force, F);
    turned_by(m->lever, l);
    turned_by(m->arm, r);
    multiply_turned(l, F, by_l, ROT, D, ROT);
    multiply_turned(r, F, by_r, ROT, D, ROT);
#if DIM == 3
    double torque[3];
    transposed(m->turning, m->effort + D, torque);
    hat(torque, T);
    torque_turns(m, M);
#endif

    for (int i = 0; i < D; i++)
        for (int j = 0; j < ROT; j++) {
            add_both(C, XB + i, PA + j, weight * F[ROT * i + j]);
            add_both(C, XA + i, PA + j, -weight * F[ROT * i + j]);
        }
    for (int i = 0; i < ROT; i++)
        for (int j = 0; j < ROT; j++) {
            const int one = ROT * i + j, other = ROT * j + i;
            C[MOUNT_BOTH * (PA + i) + PA + j] += weight * (M[one] - 0.5 * (by_r[one] + by_r[other]));
            C[MOUNT_BOTH * (PB + i) + PB + j] += weight * (M[one] - 0.5 * (by_l[one] + by_l[other]));
            add_both(C, PB + i, PA + j, weight * (by_l[one] - M[one] - 0.5 * T[one]));
        }
}

/* The symmetric part of the tangent of all bushings, as they were evaluated last, into the fronts. */
void mount_tangents(System *s, const Batch *k, double cd, double ck, double geometric)
{
    for (long i = 0; i < k->n; i++) {
        const Mount *m = (const Mount *)k->known + i;
        const double *K = k->P + k->width * i + MOUNT_K, *B = k->P + k->width * i + MOUNT_C;
        double W[MOUNT_ROWS * MOUNT_ROWS], half[MOUNT_ROWS * TWIST], part[TWIST * TWIST], C[MOUNT_BOTH * MOUNT_BOTH] = {0.0};
        for (int r = 0; r < MOUNT_ROWS; r++)
            for (int c = 0; c < MOUNT_ROWS; c++) {
                const int one = MOUNT_ROWS * r + c, other = MOUNT_ROWS * c + r;
                W[one] = 0.5 * (ck * (K[one] + K[other]) + cd * (B[one] + B[other]));
            }

        for (int b = 0; b < 2; b++) {
            if (k->pair[2 * i + b] == s->bodies) continue; /* the ground does not move */
            multiply(W, m->row[b], half, MOUNT_ROWS, MOUNT_ROWS, TWIST);
            for (int a = 0; a < 2; a++) {
                if (k->pair[2 * i + a] == s->bodies) continue;
                multiply_turned(m->row[a], half, part, TWIST, MOUNT_ROWS, TWIST);
                for (int j = 0; j < TWIST; j++) memcpy(C + MOUNT_BOTH * (TWIST * a + j) + TWIST * b, part + TWIST * j, sizeof(double) * TWIST);
            }
        }
        if (geometric != 0.0) mount_curves(m, geometric, C);
        mapped_square(s, k, i, C);
    }
}
