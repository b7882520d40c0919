/* Small vectors, and rigid motions as in rotations.py: quaternions with the scalar last, angular velocities in body axes. */

/* angle plus the whole turns that bring it next to near */
static inline double nearest_turn(double angle, double near)
{
    const double turn = 6.283185307179586476925;
    return angle + turn * rint((near - angle) / turn);
}

static inline double dot(const double *a, const double *b, int n)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++) sum += a[i] * b[i];
    return sum;
}

static inline void add(double *y, double c, const double *x, int n)
{
    for (int i = 0; i < n; i++) y[i] += c * x[i];
}

/* y = A x and y = A^T x for D x D matrices by rows */
static inline void times(const double *A, const double *x, double *y)
{
    for (int i = 0; i < D; i++) y[i] = dot(A + D * i, x, D);
}

static inline void transposed(const double *A, const double *x, double *y)
{
    for (int i = 0; i < D; i++) {
        y[i] = 0.0;
        for (int j = 0; j < D; j++) y[i] += A[D * j + i] * x[j];
    }
}

/* A B, and A B^T for D x D matrices */
static void product(const double *A, const double *B, double *C)
{
    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++) {
            double sum = 0.0;
            for (int k = 0; k < D; k++) sum += A[D * i + k] * B[D * k + j];
            C[D * i + j] = sum;
        }
}

static void product_transposed(const double *A, const double *B, double *C)
{
    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++) C[D * i + j] = dot(A + D * i, B + D * j, D);
}

#if DIM == 3
/* x x f, and w x x */
static inline void moment(const double *x, const double *f, double *out)
{
    out[0] = x[1] * f[2] - x[2] * f[1];
    out[1] = x[2] * f[0] - x[0] * f[2];
    out[2] = x[0] * f[1] - x[1] * f[0];
}

static inline void spin(const double *w, const double *x, double *out) { moment(w, x, out); }

static inline void hat(const double *w, double *A)
{
    A[0] = A[4] = A[8] = 0.0;
    A[1] = -w[2]; A[2] = w[1]; A[3] = w[2]; A[5] = -w[0]; A[6] = -w[1]; A[7] = w[0];
}

/* sum P x F from N = sum P F^T */
static inline void axial(const double *N, double *out)
{
    out[0] = N[5] - N[7];
    out[1] = N[6] - N[2];
    out[2] = N[1] - N[3];
}

/* angular quantities from body to world axes, and back */
static inline void to_world(const double *R, const double *w, double *out) { times(R, w, out); }
static inline void to_body(const double *R, const double *w, double *out) { transposed(R, w, out); }

/* The rows of turning in the block A (n columns) of a frame, in the world, of a body with this static moment and inertia in its axes. */
static inline void turning_rows(const double *R, const double *moment, const double *inertia, double *A, int n)
{
    double world[3], X[9], T[9], J[9];
    times(R, moment, world);
    hat(world, X);
    product_transposed(inertia, R, T);
    product(R, T, J);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            A[n * (3 + i) + 3 + j] = J[3 * i + j];
            A[n * (3 + i) + j] = X[3 * i + j];
        }
}

static inline void rotation(const double *q, double *R)
{
    double x = q[3], y = q[4], z = q[5], w = q[6];
    R[0] = 1 - 2 * (y * y + z * z); R[4] = 1 - 2 * (x * x + z * z); R[8] = 1 - 2 * (x * x + y * y);
    R[1] = 2 * (x * y - w * z); R[3] = 2 * (x * y + w * z);
    R[2] = 2 * (x * z + w * y); R[6] = 2 * (x * z - w * y);
    R[5] = 2 * (y * z - w * x); R[7] = 2 * (y * z + w * x);
}

/* q = q0 o exp(xi) for one pose */
static void compose(const double *q0, const double *xi, double *q)
{
    double half = 0.5 * sqrt(dot(xi + 3, xi + 3, 3)), f = half > 0 ? 0.5 * sin(half) / half : 0.5, c = cos(half);
    double b[3] = {f * xi[3], f * xi[4], f * xi[5]}, u[3], norm;
    const double *p = q0 + 3;

    moment(p, b, u);
    for (int i = 0; i < 3; i++) {
        q[i] = q0[i] + xi[i];
        q[3 + i] = p[3] * b[i] + c * p[i] + u[i];
    }
    q[6] = p[3] * c - dot(p, b, 3);
    norm = sqrt(dot(q + 3, q + 3, 4));
    for (int i = 3; i < 7; i++) q[i] /= norm;
}

/* (1 - t / 2 cot(t / 2)) / t^2 as a function of the square of the angle, by its series near zero. */
static double half_cotangent(double t2)
{
    double half = 0.5 * sqrt(t2);
    return t2 < 1e-4 ? 1.0 / 12 + t2 / 720 + t2 * t2 / 30240 : (1 - half / tan(half)) / t2;
}

/* increment of xi for the twist increment x of one frame: (x_r, T(xi)^-1 x_w) */
static void rate_of(const double *xi, double *x)
{
    const double *w = xi + 3;
    double u[3], uu[3], c = half_cotangent(dot(w, w, 3));

    moment(w, x + 3, u);
    moment(w, u, uu);
    for (int i = 0; i < 3; i++) x[3 + i] += 0.5 * u[i] + c * uu[i];
}

/* xi with q0 o exp(xi) = q1 for one pose: of all rotations the smallest, or the one nearest to that of ``near`` (NULL: none). */
static void pose_difference(const double *q0, const double *q1, const double *near, double *xi)
{
    const double *p = q0 + 3, *r = q1 + 3;
    double u[3], c = dot(p, r, 4), *theta = xi + 3, sine, angle;

    moment(p, r, u);
    for (int i = 0; i < 3; i++) {
        xi[i] = q1[i] - q0[i];
        theta[i] = p[3] * r[i] - r[3] * p[i] - u[i];
        if (c < 0) theta[i] = -theta[i]; /* q and -q are one rotation: the smaller angle */
    }
    sine = sqrt(dot(theta, theta, 3));
    angle = 2.0 * atan2(sine, fabs(c));
    for (int i = 0; i < 3; i++) theta[i] *= sine > 1e-8 ? angle / sine : 2.0 + sine * sine / 3.0;
    if (!near) return;

    /* by whole turns more or less; where nothing turns the axis is that of ``near`` */
    const double *guess = near + 3, *axis = theta;
    double size = sqrt(dot(theta, theta, 3)), turns;
    if (size <= 1e-8) axis = guess, angle = sqrt(dot(guess, guess, 3)); else angle = size;
    if (!(angle > 0)) return;
    turns = rint((dot(guess, axis, 3) / angle - size) / 6.283185307179586476925);
    for (int i = 0; i < 3; i++) u[i] = axis[i] / angle;
    add(theta, 6.283185307179586476925 * turns, u, 3);
}

/* inverse of a symmetric positive definite 3 x 3 matrix; 1 where it is not one */
static int inverse(const double *A, double *B)
{
    B[0] = A[4] * A[8] - A[5] * A[7];
    B[1] = A[2] * A[7] - A[1] * A[8];
    B[2] = A[1] * A[5] - A[2] * A[4];
    B[4] = A[0] * A[8] - A[2] * A[6];
    B[5] = A[2] * A[3] - A[0] * A[5];
    B[8] = A[0] * A[4] - A[1] * A[3];
    double det = A[0] * B[0] + A[1] * B[1] + A[2] * B[2];
    if (!(A[0] > 0 && B[8] > 0 && det > 0)) return 1;
    B[3] = B[1]; B[6] = B[2]; B[7] = B[5];
    for (int i = 0; i < 9; i++) B[i] /= det;
    return 0;
}

/* A rotation near the polar rotation of F, however far it turns: its quaternion is the eigenvector of a symmetric matrix for the
   largest eigenvalue (Horn, doi:10.1364/JOSAA.4.000629), by Jacobi's rotations. b, turn: as below. */
static void nearest_rotation(const double *b, double *turn)
{
    double N[4][4], V[4][4] = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}};
    double diagonal[4] = {b[0] + b[4] + b[8], b[0] - b[4] - b[8], b[4] - b[0] - b[8], b[8] - b[0] - b[4]};
    double above[6] = {b[5] - b[7], b[6] - b[2], b[1] - b[3], b[1] + b[3], b[2] + b[6], b[5] + b[7]};
    for (int i = 0, k = 0; i < 4; i++) {
        N[i][i] = diagonal[i];
        for (int j = i + 1; j < 4; j++) N[i][j] = N[j][i] = above[k++];
    }

    for (int sweep = 0; sweep < 4; sweep++) /* each squares what is left beside the diagonal */
        for (int i = 0; i < 3; i++)
            for (int j = i + 1; j < 4; j++) {
                if (N[i][j] == 0.0) continue;
                double half = 0.5 * (N[j][j] - N[i][i]) / N[i][j];
                double t = (half < 0 ? -1.0 : 1.0) / (fabs(half) + sqrt(half * half + 1.0)), c = 1.0 / sqrt(t * t + 1.0), z = t * c;
                for (int k = 0; k < 4; k++) {
                    double x = N[k][i], y = N[k][j], u = V[k][i], v = V[k][j];
                    N[k][i] = c * x - z * y, N[k][j] = z * x + c * y;
                    V[k][i] = c * u - z * v, V[k][j] = z * u + c * v;
                }
                for (int k = 0; k < 4; k++) {
                    double x = N[i][k], y = N[j][k];
                    N[i][k] = c * x - z * y, N[j][k] = z * x + c * y;
                }
            }

    int best = 0;
    for (int i = 1; i < 4; i++)
        if (N[i][i] > N[best][best]) best = i;
    double w = V[0][best], x = V[1][best], y = V[2][best], z = V[3][best];
    double R[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
                   2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                   2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)};
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) turn[3 * k + i] = R[3 * i + k];
}

/* Polar rotation of F (turn: the rows R_s e_k) by Newton's iteration for the symmetry of S = F R^T, from a rotation near to it,
   and Z = (tr S 1 - S)^-1. b: the moments b_1, b_2, b_3, columns of F. 1 where it does not converge. */
static int polar_from(const double *b, double *turn, double *Z)
{
    for (int it = 0; it < 20; it++) {
        double S[9] = {0.0}, A[9], c[3], w[3], X[9], trace;
        for (int k = 0; k < 3; k++)
            for (int i = 0; i < 3; i++) add(S + 3 * i, b[3 * k + i], turn + 3 * k, 3);
        trace = S[0] + S[4] + S[8];
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) A[3 * i + j] = (i == j ? trace : 0.0) - 0.5 * (S[3 * i + j] + S[3 * j + i]);
        if (inverse(A, Z)) return 1;
        axial(S, c);
        times(Z, c, w);

        double t2 = dot(w, w, 3), t = sqrt(t2);
        if (!(t < 1.0)) return 1;
        double sine = t > 1e-8 ? sin(t) / t : 1.0, rest = t > 1e-4 ? (1 - cos(t)) / t2 : 0.5;
        for (int k = 0; k < 3; k++) { /* turned by -w */
            double u[3], uu[3];
            moment(w, turn + 3 * k, u);
            moment(w, u, uu);
            for (int i = 0; i < 3; i++) X[3 * k + i] = turn[3 * k + i] - sine * u[i] + rest * uu[i];
        }

        memcpy(turn, X, sizeof X);
        if (t < 1e-13) return 0;
    }
    return 1;
}

/* The same from 1, or from further away where that is too far. */
static int polar(const double *b, double *turn, double *Z)
{
    memset(turn, 0, 9 * sizeof(double));
    turn[0] = turn[4] = turn[8] = 1.0;
    if (!polar_from(b, turn, Z)) return 0;
    nearest_rotation(b, turn);
    return polar_from(b, turn, Z);
}
#else
static inline void moment(const double *x, const double *f, double *out) { out[0] = x[0] * f[1] - x[1] * f[0]; }

static inline void spin(const double *w, const double *x, double *out)
{
    double x0 = x[0];
    out[0] = -w[0] * x[1];
    out[1] = w[0] * x0;
}

static inline void hat(const double *w, double *A)
{
    A[0] = A[3] = 0.0;
    A[1] = -w[0]; A[2] = w[0];
}

static inline void axial(const double *N, double *out) { out[0] = N[1] - N[2]; }

static inline void to_world(const double *R, const double *w, double *out) { (void)R; out[0] = w[0]; }
static inline void to_body(const double *R, const double *w, double *out) { (void)R; out[0] = w[0]; }

static inline void turning_rows(const double *R, const double *moment, const double *inertia, double *A, int n)
{
    double world[2], one = 1.0;
    times(R, moment, world);
    spin(&one, world, A + n * 2);
    A[n * 2 + 2] = inertia[0];
}

static inline void rotation(const double *q, double *R)
{
    R[0] = R[3] = cos(q[2]);
    R[2] = sin(q[2]);
    R[1] = -R[2];
}

static inline void compose(const double *q0, const double *xi, double *q)
{
    for (int i = 0; i < 3; i++) q[i] = q0[i] + xi[i];
}

static inline void rate_of(const double *xi, double *x) { (void)xi; (void)x; }

static inline void pose_difference(const double *q0, const double *q1, const double *near, double *xi)
{
    (void)near;
    for (int i = 0; i < 3; i++) xi[i] = q1[i] - q0[i];
}

static int polar(const double *b, double *turn, double *Z)
{
    double c = b[0] + b[3], s = b[1] - b[2], norm = sqrt(c * c + s * s);
    if (!(norm > 0)) return 1;
    turn[0] = turn[3] = c / norm;
    turn[1] = s / norm;
    turn[2] = -s / norm;
    Z[0] = 1.0 / norm;
    return 0;
}
#endif
