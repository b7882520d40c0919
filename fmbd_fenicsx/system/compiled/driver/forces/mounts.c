/* Bushings, equation (1) of mechanics/forces/bushing.py: s and s' of two markers, an effort K s + C s' on all components at once. */

#include "tables.h"
#include "algebra/rotations.c"
#include "parts.h"

enum { MOUNT_ROWS = D + ROT };
enum { MOUNT_P = 0, MOUNT_TA = D, MOUNT_Q = D + D * D, MOUNT_TB = 2 * D + D * D, MOUNT_K = 2 * (D + D * D),
       MOUNT_C = MOUNT_K + MOUNT_ROWS * MOUNT_ROWS };      /* where places, turns, K and C begin among the constants */

typedef struct {
    double s[MOUNT_ROWS], effort[MOUNT_ROWS];
    double axes[D * D], turning[ROT * ROT];                /* E: axes of marker a; T: theta' = T (w_b - w_a); world axes */
    double arm[D], lever[D];                               /* r, l: from the origins of both frames to marker b */
    double force[D], torque[ROT];                          /* on b, about marker b */
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

/* Everything of one bushing at the frames as they are. */
static void mount_at(const System *s, const Batch *k, long i, Mount *m)
{
    const double *P = k->P + k->width * i, *va = s->frames + FRAME * k->pair[2 * i] + SPEED;
    const double *vb = s->frames + FRAME * k->pair[2 * i + 1] + SPEED, *wa = va + D, *wb = vb + D;
    double about_a[D], about_b[D], apart[D], turns[ROT], speed[MOUNT_ROWS], rate[ROT * ROT];
    mount_deflection(s, k, i, m);
    rotation_rate(m->s + D, rate);
#if DIM == 3
    product_transposed(rate, m->axes, m->turning);
#else
    m->turning[0] = rate[0];
#endif

    spin(wa, m->arm, about_a);
    spin(wb, m->lever, about_b);
    for (int j = 0; j < D; j++) apart[j] = vb[j] + about_b[j] - va[j] - about_a[j];
    for (int j = 0; j < ROT; j++) turns[j] = wb[j] - wa[j];
    transposed(m->axes, apart, speed);
    multiply(m->turning, turns, speed + D, ROT, ROT, 1);

    for (int r = 0; r < MOUNT_ROWS; r++)
        m->effort[r] = dot(P + MOUNT_K + MOUNT_ROWS * r, m->s, MOUNT_ROWS) + dot(P + MOUNT_C + MOUNT_ROWS * r, speed, MOUNT_ROWS);
    times(m->axes, m->effort, m->force);
    multiply_turned(m->turning, m->effort + D, m->torque, ROT, ROT, 1);
}

/* Efforts into the residuals; what was evaluated is kept for the tangent. */
void mount_forces(System *s, const Batch *k)
{
    for (long i = 0; i < k->n; i++) {
        Mount *m = (Mount *)k->known + i;
        const int *at = k->at + 2 * TWIST * i, *bt = at + TWIST;
        double on_a[ROT], on_b[ROT];
        mount_at(s, k, i, m);
        moment(m->arm, m->force, on_a);
        moment(m->lever, m->force, on_b);
        for (int j = 0; j < D; j++) s->residual[at[j]] -= m->force[j], s->residual[bt[j]] += m->force[j];

        for (int j = 0; j < ROT; j++) {
            s->residual[at[D + j]] -= on_a[j] + m->torque[j];
            s->residual[bt[D + j]] += on_b[j] + m->torque[j];
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

/* Stiffness between the displacement u of marker b against a, and the turn p of b against a, world axes:

       U = E W_uu E^T,   X = E W_up T,   Z = T^T W_pp T                                                        (2) */
static void mount_stiffness(const Mount *m, const double *P, double cd, double ck, double *U, double *X, double *Z)
{
    const double *K = P + MOUNT_K, *B = P + MOUNT_C;
    double uu[D * D], up[D * ROT], pp[ROT * ROT], half[D * D];
    for (int r = 0; r < MOUNT_ROWS; r++)
        for (int c = 0; c < MOUNT_ROWS; c++) {
            int one = MOUNT_ROWS * r + c, other = MOUNT_ROWS * c + r;
            double w = 0.5 * (ck * (K[one] + K[other]) + cd * (B[one] + B[other]));
            if (r < D && c < D) uu[D * r + c] = w;
            else if (r < D) up[ROT * r + c - D] = w;
            else if (c >= D) pp[ROT * (r - D) + c - D] = w;
        }

    product(m->axes, uu, half);
    product_transposed(half, m->axes, U);
    multiply(m->axes, up, half, D, D, ROT);
    multiply(half, m->turning, X, D, ROT, ROT);
    multiply_turned(m->turning, pp, half, ROT, ROT, ROT);
    multiply(half, m->turning, Z, ROT, ROT, ROT);
}

/* A block of the lower half and its mirror image, from row r and column c on. */
static inline void put(double *C, int r, int c, const double *part, int rows, int columns, double sign)
{
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < columns; j++) C[2 * TWIST * (r + i) + c + j] = C[2 * TWIST * (c + j) + r + i] = sign * part[columns * i + j];
}

/* The symmetric part of the tangent of one bushing by the twists of both frames. With u = x_b + p_b x l - x_a - p_a x r, and the
   force F and the torque T on b, of which small displacements make

       dF = p_a x F,   d(l x F) = (p_b x l) x F + l x dF,   d(r x F) = (dx_b + p_b x l - dx_a) x F + r x dF,
       dT = p_a x T + M (p_b - p_a)                                                                            (3) */
static void mount_block(const Mount *m, const double *P, double cd, double ck, double geometric, const int *moves, double *C)
{
    enum { XA = 0, PA = D, XB = TWIST, PB = TWIST + D };
    double U[D * D], X[D * ROT], Z[ROT * ROT], M[ROT * ROT] = {0.0}, l[D * ROT], r[D * ROT], F[D * ROT];
    double across[D * ROT], coupled[D * ROT], part[ROT * ROT], more[ROT * ROT], turn[ROT * ROT];
    mount_stiffness(m, P, cd, ck, U, X, Z);
    turned_by(m->lever, l);
    turned_by(m->arm, r);
    turned_by(m->force, F);
#if DIM == 3
    if (geometric != 0.0) torque_turns(m, M);
#endif
    for (int j = 0; j < ROT * ROT; j++) Z[j] += geometric * M[j];

    if (moves[1]) {
        multiply(U, l, across, D, D, ROT);
        for (int j = 0; j < D * ROT; j++) across[j] += X[j];
        multiply_turned(l, across, part, ROT, D, ROT);
        multiply_turned(X, l, more, ROT, D, ROT);
        multiply_turned(F, l, turn, ROT, D, ROT);
        for (int i = 0; i < ROT; i++)
            for (int j = 0; j < ROT; j++)
                part[ROT * i + j] += more[ROT * i + j] + Z[ROT * i + j] - 0.5 * geometric * (turn[ROT * i + j] + turn[ROT * j + i]);

        put(C, XB, XB, U, D, D, 1.0);
        put(C, XB, PB, across, D, ROT, 1.0);
        put(C, PB, PB, part, ROT, ROT, 1.0);
    }
    if (!moves[0]) return;

    multiply(U, r, coupled, D, D, ROT);
    for (int j = 0; j < D * ROT; j++) coupled[j] = geometric * F[j] - coupled[j] - X[j]; /* of x_b and p_a */
    multiply_turned(r, coupled, part, ROT, D, ROT);
    multiply_turned(X, r, more, ROT, D, ROT);
    for (int i = 0; i < ROT; i++)
        for (int j = 0; j < ROT; j++)
            turn[ROT * i + j] = Z[ROT * i + j] - 0.5 * (part[ROT * i + j] + part[ROT * j + i] - more[ROT * i + j] - more[ROT * j + i]);
    put(C, XA, XA, U, D, D, 1.0);
    put(C, XA, PA, coupled, D, ROT, -1.0);
    put(C, PA, PA, turn, ROT, ROT, 1.0);
    if (!moves[1]) return;

    multiply_turned(l, coupled, part, ROT, D, ROT);
    for (int j = 0; j < ROT * ROT; j++) part[j] -= more[j] + Z[j];
#if DIM == 3
    hat(m->torque, turn);
    for (int j = 0; j < 9; j++) part[j] -= 0.5 * geometric * turn[j];
#endif
    put(C, XB, XA, U, D, D, -1.0);
    put(C, XA, PB, across, D, ROT, -1.0);
    put(C, XB, PA, coupled, D, ROT, 1.0);
    put(C, PB, PA, part, ROT, ROT, 1.0);
}

/* The symmetric part of the tangent of all bushings, as they were evaluated last, into the fronts. */
void mount_tangents(System *s, const Batch *k, double cd, double ck, double geometric)
{
    for (long i = 0; i < k->n; i++) {
        const int *pair = k->pair + 2 * i, moves[2] = {pair[0] != s->bodies, pair[1] != s->bodies}; /* the ground does not */
        double C[4 * TWIST * TWIST];
        mount_block((const Mount *)k->known + i, k->P + k->width * i, cd, ck, geometric, moves, C);
        mapped_square(s, k, i, C);
    }
}
