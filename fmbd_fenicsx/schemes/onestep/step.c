/* One step of generalized-alpha for rigid, reduced and floating elastic bodies; the algorithm of generalized_alpha.py, which is
   the reference. Compiled once for the plane (-DDIM=2) and once for space (-DDIM=3).

   M a + h + G^T lambda = 0,  g = 0.  The step's matrix A = cm M + cd C + ck K is one block a body, A_b = L_b L_b^T. With
   W = L^-1 G^T the saddle point is solved on the range of G:
   (W^T W) y = W^T L^-1 b - c,  x = L^-T (L^-1 b - W y),  by a Cholesky factor of W^T W in profile storage (rows ordered
   beforehand).

   Inertia of reduced bodies: equations (2) of reduced.py. Markers on surfaces: equations (1), (2) of frames.py. Kinds of rows:
   0 coincident, 1 along, 2 perpendicular, 3 distance (constraints.py). Body number nb is the ground.
   A floating body's field U is eliminated as in schur.py: its rows of G act on H^T U, H = [inertia columns, ports in use], with
   z = E^-1 b by a call back, Y = E^-1 H and H^T Y constant. What stands for modes in its Jacobian blocks is H^T U. Its rigid motion
   is both the frame's and the field's, so L_b exists only with the frame conditions C^T dU + g = 0 added to the field's rows as
   C B^-1 (C^T dU + g), B = diag(C^T E^-1 C), which leaves the solution as it is; Y and H^T Y are those of E + C B^-1 C^T.
   A block of a state holds t, q (nq), v (n), a (n), A (n), lambda (m). */

#include <math.h>
#include <string.h>

#if DIM == 3
enum { D = 3, ROT = 3, POSE = 7, TWIST = 6, PORT = 12 };
#else
enum { D = 2, ROT = 1, POSE = 3, TWIST = 3, PORT = 6 };
#endif

typedef struct {
    long n, nodes;
    int solved, frames, row, sways;                /* h: columns of H in the factor; frame conditions and their first row;
                                                      whether a mean-axis frame has the moments of M U */
    int *frame_slot;                               /* their columns of H */
    double *X, *Q, *port, *Y, *HY;                 /* n; TWIST x n; entries of the ports' columns; h x n; h x h */
    double *inertia, *moment;                      /* of the columns Q: ROT x ROT; D: sum of M P */
    int *port_start, *port_col;                    /* by columns */
    int *M_start, *M_col, *K_start, *K_col;        /* by rows of nodes: scalars, D x D blocks */
    double *M, *K;
    double beta;                                   /* damping by the stiffness */
    double *B;                                     /* see above */
    double *A, *b, *z, *h, *zh;                    /* n each, m each: work */
    double *MU;                                    /* n: M U of the factor's configuration */
    double R[D * D], L[TWIST * TWIST];             /* of the factor */
    int (*solve)(int);                             /* z = E^-1 b of the body with this number */
} Field;

typedef struct {
    int m, at_v, at_q, at_x;                       /* modes, their places in v and q, place of the body's block in x */
    double mass, large, spin;                      /* bounds: eta . modal mass . eta and |omega|^2 */
    double *inertia;                               /* rigid: ROT x ROT */
    double *S, *T, *V, *modal, *K, *C, *stress;    /* reduced: see Python; stress NULL without stiffening */
    double *chol, *U, *now;                        /* L (inverse diagonal); work: T(e_a, p), stiffness of the present stress */
    Field *field;                                  /* of a floating body: m counts the columns of H */
} Body;

typedef struct {
    int frame, surface;
    double *reference, *ports;                     /* of the surface: PORT, PORT x modes */
    int bends;                                     /* number of its G of second order, 0 without */
    double *N, *G, *now;                           /* PORT x bends, bends x m x m; work: PORT x modes, the ports' rates */
    double row[D + ROT], pull[D + ROT];            /* forces and moments on the surface: of one row, of all reactions */
    int *slot;                                     /* of a field's surface: PORT, column of H less TWIST */
    double p[D];                                   /* place, for surfaces the lever from the centroid */
    double x[D], arm[D], R[D * D];                 /* in one configuration; world axes */
    double lever[D], turn[D * D], Z[ROT * ROT];    /* surfaces, body axes: rows of turn are R_s e_k */
} Marker;

typedef struct {
    int nb, markers, m, nc, n, nq, n_core, n_x;
    long profile_size, jac_size;
    Body *body;                                    /* nb */
    Marker *marker;
    int *kind, *ma, *mb;                           /* m: kinds of the rows, their markers */
    double *e, *e1, *f, *length;                   /* D m each, length m: directions in the axes of markers */
    int *order, *first;                            /* m: place of a row in the factor, first column of a place */
    long *start;                                   /* m: where the places begin in the profile */
    int *ci, *cj;                                  /* nc: pairs of Jacobian blocks (2 row + side) on one body */
    long *cdest;                                   /* nc: their entry of the profile */
    int *on;                                       /* 2 m: body of a Jacobian block */
    long *js;                                      /* 2 m: where a Jacobian block begins, -1 on the ground */
    double *profile, *jac, *tangent, *W, *g, *y;
    double *R, *work, *units;                      /* D D (nb + 1); see step; n */
} System;

enum { H, AM, AF, GAMMA, BETA, GX, GY, GZ, TOL, FLOOR, LENGTH, THETA, SLOW, MAXIT, HISTORY, PATIENCE, NEW_TANGENT, FAR, /* in */
       ITERATIONS, LOCAL, RESIDUAL, LEFT };                                                                /* out */
enum { DONE, NEWTON, DEPENDENT, LOOK }; /* verdicts; LOOK: something to be warned of or refused by the NumPy path */

static double dot(const double *x, const double *y, int n)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++) sum += x[i] * y[i];
    return sum;
}

static void add(double *y, double c, const double *x, int n)
{
    for (int i = 0; i < n; i++) y[i] += c * x[i];
}

/* the same for a body's block: its twist, then its modes */
static inline double block_dot(const double *x, const double *y, int m)
{
    double sum = 0.0;
    for (int i = 0; i < TWIST; i++) sum += x[i] * y[i];
    for (int i = TWIST; i < TWIST + m; i++) sum += x[i] * y[i];
    return sum;
}

static inline void block_add(double *y, double c, const double *x, int m)
{
    for (int i = 0; i < TWIST; i++) y[i] += c * x[i];
    for (int i = TWIST; i < TWIST + m; i++) y[i] += c * x[i];
}

static double long_dot(const double *x, const double *y, long n)
{
    double s0 = 0.0, s1 = 0.0, s2 = 0.0, s3 = 0.0;
    long i = 0;
    for (; i + 3 < n; i += 4) {
        s0 += x[i] * y[i];
        s1 += x[i + 1] * y[i + 1];
        s2 += x[i + 2] * y[i + 2];
        s3 += x[i + 3] * y[i + 3];
    }
    for (; i < n; i++) s0 += x[i] * y[i];
    return (s0 + s1) + (s2 + s3);
}

/* one number of H^T U */
static double column(const Field *f, int h, const double *U)
{
    if (h < TWIST) return long_dot(f->Q + f->n * h, U, f->n);
    double sum = 0.0;
    for (int i = f->port_start[h - TWIST]; i < f->port_start[h - TWIST + 1]; i++) sum += f->port[i] * U[f->port_col[i]];
    return sum;
}

/* y = A x and y = A^T x for D x D matrices by rows */
static void times(const double *A, const double *x, double *y)
{
    for (int i = 0; i < D; i++) y[i] = dot(A + D * i, x, D);
}

static void transposed(const double *A, const double *x, double *y)
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
/* x x f */
static void moment(const double *x, const double *f, double *out)
{
    out[0] = x[1] * f[2] - x[2] * f[1];
    out[1] = x[2] * f[0] - x[0] * f[2];
    out[2] = x[0] * f[1] - x[1] * f[0];
}

/* w x x */
static void spin(const double *w, const double *x, double *out) { moment(w, x, out); }

static void hat(const double *w, double *A)
{
    A[0] = A[4] = A[8] = 0.0;
    A[1] = -w[2]; A[2] = w[1]; A[3] = w[2]; A[5] = -w[0]; A[6] = -w[1]; A[7] = w[0];
}

/* sum P x F from N = sum P F^T */
static void axial(const double *N, double *out)
{
    out[0] = N[5] - N[7];
    out[1] = N[6] - N[2];
    out[2] = N[1] - N[3];
}

/* what the angular velocity is multiplied with, body axes from world axes */
static void to_body(const double *R, const double *w, double *out) { transposed(R, w, out); }

static void rotation(const double *q, double *R)
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

/* increment of xi for the twist increment x of one frame: (x_r, T(xi)^-1 x_w) */
static void rate(const double *xi, double *x)
{
    const double *w = xi + 3;
    double t2 = dot(w, w, 3), t = sqrt(t2), u[3], uu[3], c;
    c = t < 1e-2 ? 1.0 / 12 + t2 / 720 + t2 * t2 / 30240 : (1 - 0.5 * t / tan(0.5 * t)) / t2;
    moment(w, x + 3, u);
    moment(w, u, uu);
    for (int i = 0; i < 3; i++) x[3 + i] += 0.5 * u[i] + c * uu[i];
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

/* Polar rotation of F (turn: the rows R_s e_k) by Newton's iteration for the symmetry of S = F R^T, and Z = (tr S 1 - S)^-1.
   b: the moments b_1, b_2, b_3, columns of F. 1 when the rotation is too far from 1. */
static int polar(const double *b, double *turn, double *Z)
{
    memset(turn, 0, 9 * sizeof(double));
    turn[0] = turn[4] = turn[8] = 1.0;
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
#else
static void moment(const double *x, const double *f, double *out) { out[0] = x[0] * f[1] - x[1] * f[0]; }

static void spin(const double *w, const double *x, double *out)
{
    double x0 = x[0];
    out[0] = -w[0] * x[1];
    out[1] = w[0] * x0;
}

static void hat(const double *w, double *A)
{
    A[0] = A[3] = 0.0;
    A[1] = -w[0]; A[2] = w[0];
}

static void axial(const double *N, double *out) { out[0] = N[1] - N[2]; }

static void to_body(const double *R, const double *w, double *out) { (void)R; out[0] = w[0]; }

static void rotation(const double *q, double *R)
{
    R[0] = R[3] = cos(q[2]);
    R[2] = sin(q[2]);
    R[1] = -R[2];
}

static void compose(const double *q0, const double *xi, double *q)
{
    for (int i = 0; i < 3; i++) q[i] = q0[i] + xi[i];
}

static void rate(const double *xi, double *x) { (void)xi; (void)x; }

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

/* The rates of the ports of a surface at the modes eta: ports - N (G eta), see mechanics/reduction/foreshortening.py. */
static void bend(Marker *k, const double *eta, int m)
{
    memcpy(k->now, k->ports, PORT * m * sizeof(double));
    for (int r = 0; r < k->bends; r++)
        for (int i = 0; i < m; i++) {
            double slope = dot(k->G + (r * m + i) * m, eta, m);
            for (int j = 0; j < PORT; j++) k->now[j * m + i] -= k->N[j * k->bends + r] * slope;
        }
}

/* Frames' rotations and all markers for a configuration. */
static int place(const System *s, const double *q)
{
    int nb = s->nb;
    for (int b = 0; b < nb; b++) rotation(q + POSE * b, s->R + D * D * b);
    for (int i = 0; i < s->markers; i++) {
        Marker *k = s->marker + i;
        const double *R = s->R + D * D * k->frame, *local = k->p;
        double centre[D];
        memset(k->pull, 0, sizeof k->pull);
        if (k->surface) {
            const Body *body = s->body + k->frame;
            double b[PORT];
            if (k->bends) bend(k, q + body->at_q, body->m);
            for (int j = 0; j < PORT; j++)
                b[j] = k->reference[j] + (body->field ? column(body->field, TWIST + k->slot[j], q + body->at_q)
                                                      : dot(k->ports + body->m * j, q + body->at_q, body->m));
            for (int j = 0; k->bends && j < PORT; j++) /* the mean of both rates times the modes */
                b[j] = 0.5 * (b[j] + k->reference[j] + dot(k->now + body->m * j, q + body->at_q, body->m));
            if (polar(b + D, k->turn, k->Z)) return LOOK;
            double Rs[D * D];
            for (int j = 0; j < D; j++)
                for (int c = 0; c < D; c++) Rs[D * c + j] = k->turn[D * j + c];
            times(Rs, k->p, k->lever);
            for (int j = 0; j < D; j++) centre[j] = b[j] + k->lever[j];
            product(R, Rs, k->R);
            local = centre;
        } else {
            memcpy(k->R, R, sizeof k->R);
        }
        times(R, local, k->arm);
        for (int j = 0; j < D; j++) k->x[j] = k->arm[j] + (k->frame < nb ? q[POSE * k->frame + j] : 0.0);
    }
    return DONE;
}

/* The row l . x' + w . omega of a marker (world axes) as a row on its body. */
static void on_body(const System *s, Marker *k, const double *l, const double *w, double *J)
{
    const double *R = s->R + D * D * k->frame;
    double turning[ROT];
    moment(k->arm, l, turning);
    for (int i = 0; i < ROT; i++) turning[i] += w[i];
    for (int i = 0; i < D; i++) J[i] = l[i];
    to_body(R, turning, J + D);
    int m = s->body[k->frame].m;
    if (!m) return;
    memset(J + TWIST, 0, m * sizeof(double));
    if (!k->surface) return;
    double lb[D], wb[ROT], t[ROT], z[ROT], grad[D];
    transposed(R, l, lb);
    to_body(R, w, wb);
    moment(k->lever, lb, t);
    for (int i = 0; i < ROT; i++) t[i] += wb[i];
    for (int i = 0; i < ROT; i++) z[i] = dot(k->Z + ROT * i, t, ROT);
    for (int r = 0; r < k->bends; r++) {
        k->row[r] = 0.0;
        for (int i = 0; i < D; i++) k->row[r] += lb[i] * k->N[k->bends * i + r];
    }
    if (k->slot)
        for (int i = 0; i < D; i++) J[2 * TWIST + k->slot[i]] = lb[i];
    else
        for (int i = 0; i < D; i++) add(J + TWIST, lb[i], (k->bends ? k->now : k->ports) + m * i, m);
    for (int j = 0; j < D; j++) {
        spin(z, k->turn + D * j, grad);
        if (k->slot) {
            for (int i = 0; i < D; i++) J[2 * TWIST + k->slot[D * (1 + j) + i]] = grad[i];
            continue;
        }
        for (int i = 0; i < D; i++) {
            add(J + TWIST, grad[i], (k->bends ? k->now : k->ports) + m * (D * (1 + j) + i), m);
            for (int r = 0; r < k->bends; r++) k->row[r] += grad[i] * k->N[k->bends * (D * (1 + j) + i) + r];
        }
    }
}

/* g and G for the markers as they stand, and the forces of the multipliers on bent surfaces. */
static void constraints(const System *s, const double *q, const double *offset, const double *lam)
{
    for (int k = 0; k < s->m; k++) {
        if (s->kind[k] == 4) { /* a frame condition: column ma of H */
            const Body *o = s->body + s->on[2 * k];
            s->g[k] = column(o->field, s->ma[k], q + o->at_q);
            memset(s->jac + s->js[2 * k], 0, (TWIST + o->m) * sizeof(double));
            s->jac[s->js[2 * k] + TWIST + s->ma[k]] = 1.0;
            continue;
        }
        Marker *a = s->marker + s->ma[k], *b = s->marker + s->mb[k];
        const double *e = s->e + D * k;
        double d[D], l[D], minus[D], wa[ROT] = {0.0}, wb[ROT] = {0.0};
        for (int i = 0; i < D; i++) { d[i] = b->x[i] - a->x[i]; l[i] = 0.0; }
        switch (s->kind[k]) {
        case 0:
            memcpy(l, e, sizeof l);
            s->g[k] = dot(l, d, D) - offset[k];
            break;
        case 1:
            times(a->R, e, l);
            s->g[k] = dot(l, d, D) - offset[k];
            moment(l, d, wa);
            break;
        case 2: {
            const double *e1 = s->e1 + D * k;
            double c = cos(offset[k]), si = sin(offset[k]), turned[D], u[D], v[D];
            for (int i = 0; i < D; i++) turned[i] = c * e[i] + si * e1[i];
            times(a->R, turned, u);
            times(b->R, s->f + D * k, v);
            s->g[k] = dot(u, v, D);
            moment(u, v, wa);
            for (int i = 0; i < ROT; i++) wb[i] = -wa[i];
            break;
        }
        default: {
            double L = s->length[k];
            for (int i = 0; i < D; i++) l[i] = d[i] / L;
            s->g[k] = 0.5 * (dot(d, d, D) / L - L);
        }
        }
        for (int i = 0; i < D; i++) minus[i] = -l[i];
        long ja = s->js[2 * k], jb = s->js[2 * k + 1];
        if (ja >= 0) on_body(s, a, minus, wa, s->jac + ja);
        if (ja >= 0) add(a->pull, -lam[k], a->row, a->bends);
        if (jb >= 0) on_body(s, b, l, wb, s->jac + jb);
        if (jb >= 0) add(b->pull, -lam[k], b->row, b->bends);
    }
}

/* The same of a floating body: equations (1), (2) of floating.py. */
static int field_inertia(const System *s, const Body *o, int b, const double *q, const double *v, const double *a, const double *acc,
                         double *r)
{
    const Field *e = o->field;
    const double *R = s->R + D * D * b, *w = v + TWIST * b + D, *U = q + o->at_q, *Ud = v + o->at_v, *Udd = a + o->at_v;
    double W[D * D], L[D * D], alpha[D * D], sum[D] = {0.0}, N[D * D] = {0.0}, square = 0.0, *f = r + TWIST * b, *rows = r + o->at_v;
    hat(w, W);
    product(W, W, L);
    hat(a + TWIST * b + D, alpha);
    add(L, 1.0, alpha, D * D);
    for (long i = 0; i < e->nodes; i++) {
        const double *u = U + D * i, *ud = Ud + D * i, *X = e->X + D * i;
        double P[D];
        for (int j = 0; j < D; j++) {
            P[j] = X[j] + u[j];
            square += u[j] * u[j];
        }
        for (int j = 0; j < D; j++) {
            double x = acc[j] + Udd[D * i + j];
            for (int c = 0; c < D; c++) x += L[D * j + c] * P[c] + 2.0 * W[D * j + c] * ud[c];
            e->A[D * i + j] = x;
        }
    }
    for (long i = 0; i < e->nodes; i++) {
        double F[D] = {0.0}, P[D], G[D] = {0.0};
        for (int k = e->M_start[i]; k < e->M_start[i + 1]; k++)
            for (int j = 0; j < D; j++) F[j] += e->M[k] * e->A[D * e->M_col[k] + j];
        for (int k = e->K_start[i]; k < e->K_start[i + 1]; k++) {
            const double *K = e->K + D * D * k, *u = U + D * e->K_col[k], *ud = Ud + D * e->K_col[k];
            double x[D];
            for (int j = 0; j < D; j++) x[j] = u[j] + e->beta * ud[j];
            for (int j = 0; j < D; j++)
                for (int c = 0; c < D; c++) G[j] += K[D * j + c] * x[c];
        }
        for (int j = 0; j < D; j++) {
            P[j] = e->X[D * i + j] + U[D * i + j];
            rows[D * i + j] = F[j] + G[j];
            sum[j] += F[j];
        }
        for (int j = 0; j < D; j++)
            for (int c = 0; c < D; c++) N[D * j + c] += P[j] * F[c];
    }
    times(R, sum, f);
    axial(N, f + D);
    return square <= o->large && dot(w, w, ROT) <= o->spin ? DONE : LOOK;
}

/* Inertia, elastic forces and weight of one body, rows of v's order; U is left for the mass matrix. */
static int inertia(const System *s, const Body *o, int b, const double *q, const double *v, const double *a, const double *grav,
                   double *r)
{
    const double *R = s->R + D * D * b, *w = v + TWIST * b + D, *alpha = a + TWIST * b + D;
    double free_[D], *f = r + TWIST * b;
    for (int i = 0; i < D; i++) free_[i] = a[TWIST * b + i] - grav[i];
    if (o->field) {
        double body[D];
        transposed(R, free_, body);
        return field_inertia(s, o, b, q, v, a, body, r);
    }
    if (!o->T) {
        for (int i = 0; i < D; i++) f[i] = o->mass * free_[i];
        for (int i = 0; i < ROT; i++) f[D + i] = dot(o->inertia + ROT * i, alpha, ROT);
#if DIM == 3
        double Jw[3], gyro[3];
        for (int i = 0; i < 3; i++) Jw[i] = dot(o->inertia + 3 * i, w, 3);
        moment(w, Jw, gyro);
        for (int i = 0; i < 3; i++) f[3 + i] += gyro[i];
#endif
        return DONE;
    }
    int m = o->m, k = m + 1, DD = D * D, size = k * DD;
    const double *eta = q + o->at_q, *rate = v + o->at_v, *second = a + o->at_v;
    double *rows = r + o->at_v, *U = o->U, *Vp = U + size, *Me = Vp + ROT * k;
    double acc[D], W[D * D], L[D * D], Sp[3][D], T0[D * D], T1[D * D], T2[D * D], N[D * D];
    transposed(R, free_, acc);
    hat(w, W);
    product(W, W, L);
    hat(alpha, N);
    add(L, 1.0, N, DD);
    memcpy(U, o->T, size * sizeof(double)); /* T(e_a, p) = T_a0 + sum_b eta_b T_ab */
    for (int c = 0; c < m; c++) add(U, eta[c], o->T + size * (c + 1), size);
    memset(Vp, 0, (ROT * k + 2 * m) * sizeof(double));
    for (int c = 0; c < m; c++) add(Vp, rate[c], o->V + ROT * k * (c + 1), ROT * k);
    for (int i = 0; i < D; i++) {
        const double *S = o->S + k * i;
        Sp[0][i] = S[0] + dot(S + 1, eta, m);
        Sp[1][i] = dot(S + 1, rate, m);
        Sp[2][i] = dot(S + 1, second, m);
    }
    memcpy(T0, U, sizeof T0); /* T(p, p), T(p, p')^T, T(p, p'')^T */
    memset(T1, 0, sizeof T1);
    memset(T2, 0, sizeof T2);
    for (int c = 0; c < m; c++) {
        const double *Uc = U + DD * (c + 1);
        add(T0, eta[c], Uc, DD);
        add(T1, rate[c], Uc, DD);
        add(T2, second[c], Uc, DD);
    }
    double part[D * D], L1[D], W1[D], sum[D];
    product_transposed(T0, L, N);
    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++) {
            double twice = 0.0;
            for (int c = 0; c < D; c++) twice += T1[D * c + i] * W[D * j + c];
            part[D * i + j] = N[D * i + j] + 2.0 * twice + T2[D * j + i] + Sp[0][i] * acc[j];
        }
    axial(part, f + D);
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

/* The stress of the reactions on bent surfaces added to that of inertia. */
static void reactions_stress(const System *s)
{
    for (const Marker *k = s->marker; k < s->marker + s->markers; k++) {
        const Body *o = s->body + k->frame;
        for (int r = 0; r < k->bends; r++) add(o->now, k->pull[r], k->G + r * o->m * o->m, o->m * o->m);
    }
}

/* L_b of a reduced body at the configuration evaluated last. */
static int factor_body(const System *s, const Body *o, int b, const double *q, double cd, double ck)
{
    int m = o->m, k = m + 1, n = TWIST + m, DD = D * D;
    const double *R = s->R + DD * b, *U = o->U, *eta = q + o->at_q;
    double *A = o->chol, T0[D * D], arm[D], trace = 0.0;
    memcpy(T0, U, sizeof T0);
    for (int c = 0; c < m; c++) add(T0, eta[c], U + DD * (c + 1), DD);
    for (int i = 0; i < D; i++) {
        arm[i] = o->S[k * i] + dot(o->S + k * i + 1, eta, m);
        trace += T0[(D + 1) * i];
    }
    memset(A, 0, (size_t)n * n * sizeof(double));
    for (int i = 0; i < D; i++) A[(n + 1) * i] = o->mass;
#if DIM == 3
    double X[9];
    hat(arm, X);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            A[n * (3 + i) + 3 + j] = (i == j ? trace : 0.0) - 0.5 * (T0[3 * i + j] + T0[3 * j + i]);
            A[n * (3 + i) + j] = dot(X + 3 * i, R + 3 * j, 3);
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
        double *row = A + n * (TWIST + i);
        for (int j = 0; j < D; j++)
            for (int c = 0; c < D; c++) row[j] += R[D * j + c] * o->S[k * c + i + 1];
        const double *T = U + DD * (i + 1);
        for (int j = 0; j < ROT; j++) row[D + j] = T[pair[j]] - T[other[j]];
        for (int j = 0; j <= i; j++)
            row[TWIST + j] = o->modal[m * i + j] + cd * o->C[m * i + j] + ck * o->K[m * i + j];
        for (int j = 0; o->now && j <= i; j++) row[TWIST + j] += ck * o->now[m * i + j];
    }
    for (int i = 0; i < n; i++) {
        double *Li = A + n * i;
        for (int j = 0; j < i; j++) Li[j] = (Li[j] - dot(Li, A + n * j, j)) * A[(n + 1) * j];
        double pivot = Li[i] - dot(Li, Li, i);
        if (!(pivot > 1e-14 * Li[i])) return DEPENDENT;
        Li[i] = 1.0 / sqrt(pivot);
    }
    return DONE;
}

/* S t of a field, S = (R^T, 1), and S^T x, of the factor's configuration */
static void to_columns(const Field *e, const double *t, double *x)
{
    transposed(e->R, t, x);
    for (int i = D; i < TWIST; i++) x[i] = t[i];
}

static void from_columns(const Field *e, const double *x, double *t)
{
    times(e->R, x, t);
    for (int i = D; i < TWIST; i++) t[i] = x[i];
}

/* Cholesky factor of the frame's block with the field eliminated, M - S^T Q^T E^-1 Q S. */
static int factor_field(const System *s, const Body *o, int b, const double *q)
{
    Field *e = o->field;
    double C[TWIST * TWIST], *L = e->L, x[TWIST];
    const double *U = q + o->at_q;
    for (long i = 0; e->sways && i < e->nodes; i++) {
        double F[D] = {0.0};
        for (int k = e->M_start[i]; k < e->M_start[i + 1]; k++)
            for (int j = 0; j < D; j++) F[j] += e->M[k] * U[D * e->M_col[k] + j];
        memcpy(e->MU + D * i, F, sizeof F);
    }
    memcpy(e->R, s->R + D * D * b, sizeof e->R);
    for (int j = 0; j < TWIST; j++) {
        double unit[TWIST] = {0.0}, column_[TWIST];
        unit[j] = 1.0;
        to_columns(e, unit, x);
        for (int i = 0; i < TWIST; i++) column_[i] = dot(e->HY + e->solved * i, x, TWIST);
        from_columns(e, column_, x);
        for (int i = 0; i < TWIST; i++) C[TWIST * i + j] = -x[i];
    }
    for (int i = 0; i < D; i++) C[(TWIST + 1) * i] += o->mass;
    for (int i = 0; i < ROT; i++)
        for (int j = 0; j < ROT; j++) C[TWIST * (D + i) + D + j] += e->inertia[ROT * i + j];
    for (int i = 0; i < ROT; i++) {
        double unit[ROT] = {0.0}, across[D];
        unit[i] = 1.0;
        spin(unit, e->moment, across);
        times(e->R, across, x);
        for (int j = 0; j < D; j++) C[TWIST * (D + i) + j] += x[j];
    }
    for (int i = 0; i < TWIST; i++) {
        for (int j = 0; j < i; j++)
            L[TWIST * i + j] = (C[TWIST * i + j] - dot(L + TWIST * i, L + TWIST * j, j)) * L[(TWIST + 1) * j];
        double pivot = C[(TWIST + 1) * i] - dot(L + TWIST * i, L + TWIST * i, i);
        if (!(pivot > 1e-14 * C[(TWIST + 1) * i])) return DEPENDENT;
        L[(TWIST + 1) * i] = 1.0 / sqrt(pivot);
    }
    return DONE;
}

static void field_lower(const Field *e, double *x)
{
    for (int i = 0; i < TWIST; i++) x[i] = (x[i] - dot(e->L + TWIST * i, x, i)) * e->L[(TWIST + 1) * i];
}

/* W of a Jacobian block J of a field: L^-1 (J_t - S^T (H^T Y J_h)_Q), H^T Y J_h */
static void field_row(const Body *o, const double *J, double *W)
{
    const Field *e = o->field;
    double t[TWIST];
    for (int i = 0; i < o->m; i++) W[TWIST + i] = i < e->solved ? dot(e->HY + e->solved * i, J + TWIST, e->solved) : 0.0;
    from_columns(e, W + TWIST, t);
    for (int i = 0; i < TWIST; i++) W[i] = J[i] - t[i];
    field_lower(e, W);
}

/* b of a field, already in e->b, and of its frame, in x: z = E^-1 b, x = L^-1 (b_t - S^T Q^T z), then H^T z, z with the frame
   conditions added */
static int field_forward(const Body *o, int b, const double *g, double *x)
{
    Field *e = o->field;
    double t[TWIST];
    if (e->solve(b)) return NEWTON;
    memset(e->h, 0, o->m * sizeof(double));
    for (int i = 0; i < e->solved; i++) e->zh[i] = column(e, i, e->z);
    for (int i = 0; i < e->frames; i++) e->h[e->frame_slot[i]] = (e->zh[e->frame_slot[i]] + g[e->row + i]) / e->B[i];
    for (int i = 0; i < o->m; i++) x[TWIST + i] = i < e->solved ? e->zh[i] - dot(e->HY + e->solved * i, e->h, e->solved) : 0.0;
    from_columns(e, x + TWIST, t);
    for (int i = 0; i < TWIST; i++) x[i] -= t[i];
    field_lower(e, x);
    return DONE;
}

/* The frame's increment from L^-1 .., and the field's: z - Y (S t + sum of J_h y + ..), with H^T of it in x */
static void field_backward(const Body *o, double *x, double *out)
{
    Field *e = o->field;
    double t[TWIST];
    for (int i = TWIST - 1; i >= 0; i--) {
        x[i] *= e->L[(TWIST + 1) * i];
        add(x, -x[i], e->L + TWIST * i, i);
    }
    to_columns(e, x, t);
    for (int i = 0; i < TWIST; i++) e->h[i] += t[i];
    for (int i = 0; i < e->solved; i++) x[TWIST + i] = e->zh[i] - dot(e->HY + e->solved * i, e->h, e->solved);
    memcpy(out, e->z, e->n * sizeof(double));
    for (int i = 0; i < e->solved; i++) {
        const double *Y = e->Y + e->n * i;
        double c = e->h[i];
        if (c != 0.0)
            for (long j = 0; j < e->n; j++) out[j] -= c * Y[j];
    }
}

/* x <- L_b^-1 x and x <- L_b^-T x; rigid bodies have nothing between translation and rotation */
static void forward(const Body *o, double *x)
{
    const double *L = o->chol;
    if (!o->T) {
        for (int i = 0; i < D; i++) x[i] *= L[(TWIST + 1) * i];
        for (int i = D; i < TWIST; i++) {
            for (int j = D; j < i; j++) x[i] -= L[TWIST * i + j] * x[j];
            x[i] *= L[(TWIST + 1) * i];
        }
        return;
    }
    int n = TWIST + o->m;
    for (int i = 0; i < n; i++) x[i] = (x[i] - dot(L + n * i, x, i)) * L[(n + 1) * i];
}

static void backward(const Body *o, double *x)
{
    const double *L = o->chol;
    if (!o->T) {
        for (int i = TWIST - 1; i >= D; i--) {
            x[i] *= L[(TWIST + 1) * i];
            for (int j = D; j < i; j++) x[j] -= L[TWIST * i + j] * x[i];
        }
        for (int i = 0; i < D; i++) x[i] *= L[(TWIST + 1) * i];
        return;
    }
    int n = TWIST + o->m;
    for (int i = n - 1; i >= 0; i--) {
        x[i] *= L[(n + 1) * i];
        add(x, -x[i], L + n * i, i);
    }
}

static const Body *owner(const System *s, int block) { return s->body + s->on[block]; }

/* W = L^-1 G^T and the Cholesky factor of W^T W. */
static int factor(const System *s)
{
    int m = s->m;
    double *L = s->profile;
    memcpy(s->tangent, s->jac, s->jac_size * sizeof(double));
    memcpy(s->W, s->jac, s->jac_size * sizeof(double));
    for (int c = 0; c < 2 * m; c++) {
        if (s->js[c] < 0) continue;
        if (owner(s, c)->field) field_row(owner(s, c), s->jac + s->js[c], s->W + s->js[c]);
        else forward(owner(s, c), s->W + s->js[c]);
    }
    memset(L, 0, s->profile_size * sizeof(double));
    for (int c = 0; c < s->nc; c++)
        if (owner(s, s->ci[c])->field) {
            long i = s->js[s->ci[c]], j = s->js[s->cj[c]];
            L[s->cdest[c]] += dot(s->W + i, s->W + j, TWIST);
            L[s->cdest[c]] += dot(s->jac + i + TWIST, s->W + j + TWIST, owner(s, s->ci[c])->m);
        } else L[s->cdest[c]] += block_dot(s->W + s->js[s->ci[c]], s->W + s->js[s->cj[c]], owner(s, s->ci[c])->m);
    for (int i = 0; i < m; i++) {
        double *Li = L + s->start[i];
        int fi = s->first[i];
        for (int j = fi; j < i; j++) {
            const double *Lj = L + s->start[j];
            int fj = s->first[j], k = fi > fj ? fi : fj;
            Li[j - fi] = (Li[j - fi] - dot(Li + k - fi, Lj + k - fj, j - k)) * Lj[j - fj];
        }
        double pivot = Li[i - fi] - dot(Li, Li, i - fi);
        if (!(pivot > 1e-10 * Li[i - fi])) return DEPENDENT;
        Li[i - fi] = 1.0 / sqrt(pivot); /* the inverse of the diagonal */
    }
    return DONE;
}

static void back(const System *s, double *y)
{
    int m = s->m;
    const double *L = s->profile;
    for (int i = 0; i < m; i++) {
        const double *Li = L + s->start[i];
        int fi = s->first[i];
        y[i] = (y[i] - dot(Li, y + fi, i - fi)) * Li[i - fi];
    }
    for (int i = m - 1; i >= 0; i--) {
        const double *Li = L + s->start[i];
        int fi = s->first[i];
        y[i] *= Li[i - fi];
        add(y + fi, -y[i], Li, i - fi);
    }
}

/* v's order from the bodies' blocks one after the other (out = 0), or the other way round */
static void reorder(const System *s, double *v, double *x, int out)
{
    for (int b = 0; b < s->nb; b++) {
        const Body *o = s->body + b;
        double *from = out ? v + TWIST * b : x + o->at_x, *to = out ? x + o->at_x : v + TWIST * b;
        for (int i = 0; i < TWIST; i++) to[i] = from[i];
        if (o->field && out) memcpy(o->field->b, v + o->at_v, o->field->n * sizeof(double));
        if (!o->m || o->field) continue;
        from = out ? v + o->at_v : x + o->at_x + TWIST;
        to = out ? x + o->at_x + TWIST : v + o->at_v;
        memcpy(to, from, o->m * sizeof(double));
    }
}

/* G^T lambda added to r, v's order */
static void add_reactions(const System *s, const double *lam, double *r)
{
    for (int b = 0; b < s->nb; b++)
        if (s->body[b].field) memset(s->body[b].field->h, 0, s->body[b].m * sizeof(double));
    for (int c = 0; c < 2 * s->m; c++) {
        if (s->js[c] < 0) continue;
        const Body *o = owner(s, c);
        const double *J = s->jac + s->js[c];
        add(r + TWIST * (o - s->body), lam[c / 2], J, TWIST);
        if (o->field) add(o->field->h, lam[c / 2], J + TWIST, o->m);
        else if (o->m) add(r + o->at_v, lam[c / 2], J + TWIST, o->m);
    }
    for (int b = 0; b < s->nb; b++) {
        const Field *e = s->body[b].field;
        double *rows = r + s->body[b].at_v;
        if (!e) continue;
        for (int h = 0; h < TWIST; h++)
            if (e->h[h] != 0.0)
                for (long i = 0; i < e->n; i++) rows[i] += e->h[h] * e->Q[e->n * h + i];
        for (int h = TWIST; h < s->body[b].m; h++)
            for (int i = e->port_start[h - TWIST]; i < e->port_start[h - TWIST + 1]; i++)
                rows[e->port_col[i]] += e->h[h] * e->port[i];
    }
}

/* Multipliers (into y) and increments (fields into x, the others into xb) from the bodies' eliminated blocks in xb and the open
   constraints g (NULL: closed); the size of the terms of the multipliers' equations. */
static double multipliers(const System *s, const double *g, double *x, double *xb, double *y)
{
    int m = s->m;
    double largest = 1e-300;
    for (int k = 0; k < m; k++) {
        double sum = g ? g[k] : 0.0, all = fabs(sum);
        for (int c = 2 * k; c < 2 * k + 2; c++) {
            if (s->js[c] < 0) continue;
            const Body *o = owner(s, c);
            const double *W = s->W + s->js[c], *z = xb + o->at_x;
            for (int i = 0; i < TWIST + o->m; i++) {
                if (o->field && i == TWIST) W = s->tangent + s->js[c];
                double one = W[i] * z[i];
                sum += one;
                all += fabs(one);
            }
        }
        s->y[s->order[k]] = sum;
        if (all > largest) largest = all;
    }
    back(s, s->y);
    for (int k = 0; k < m; k++) y[k] = s->y[s->order[k]];
    for (int c = 0; c < 2 * m; c++)
        if (s->js[c] >= 0 && owner(s, c)->field) {
            add(xb + owner(s, c)->at_x, -y[c / 2], s->W + s->js[c], TWIST);
            add(owner(s, c)->field->h, y[c / 2], s->tangent + s->js[c] + TWIST, owner(s, c)->m);
        } else if (s->js[c] >= 0) block_add(xb + owner(s, c)->at_x, -y[c / 2], s->W + s->js[c], owner(s, c)->m);
    for (int b = 0; b < s->nb; b++) {
        if (s->body[b].field) field_backward(s->body + b, xb + s->body[b].at_x, x + s->body[b].at_v);
        else backward(s->body + b, xb + s->body[b].at_x);
    }
    return largest;
}

/* Second pass for frames whose columns leave out U: the moments of the increments dU, -sum (M U) x dU, go to the frames; what
   follows is added to x, xb, y. x2, xb2, y2: work. */
static void sway(const System *s, double *x, double *xb, double *y, double *x2, double *xb2, double *y2)
{
    int any = 0;
    memset(xb2, 0, s->n_x * sizeof(double));
    for (int b = 0; b < s->nb; b++) {
        const Body *o = s->body + b;
        Field *e = o->field;
        double *t = xb2 + o->at_x, f[ROT];
        if (!e) continue;
        memset(e->z, 0, e->n * sizeof(double));
        memset(e->h, 0, o->m * sizeof(double));
        memset(e->zh, 0, o->m * sizeof(double));
        if (!e->sways) continue;
        any = 1;
        for (long i = 0; i < e->nodes; i++) {
            moment(e->MU + D * i, x + o->at_v + D * i, f);
            add(t + D, -1.0, f, ROT);
        }
        field_lower(e, t);
    }
    if (!any) return;
    multipliers(s, NULL, x2, xb2, y2);
    for (int b = 0; b < s->nb; b++)
        if (s->body[b].field) add(x + s->body[b].at_v, 1.0, x2 + s->body[b].at_v, (int)s->body[b].field->n);
    add(xb, 1.0, xb2, s->n_x);
    add(y, 1.0, y2, s->m);
}

/* Newton's increments dq (into x, v's order) and s lambda (into y) for the residuals r, g; how well G dq = -g was met. */
static double solve(const System *s, double scale, double *r, double *x, double *xb, double *y)
{
    int m = s->m, n = s->n;
    double largest, open = 0.0, *x2 = y + m, *xb2 = x2 + n, *y2 = xb2 + s->n_x;
    for (int i = 0; i < n; i++) r[i] *= -scale;
    reorder(s, r, xb, 1);
    for (int b = 0; b < s->nb; b++) {
        if (!s->body[b].field) forward(s->body + b, xb + s->body[b].at_x);
        else if (field_forward(s->body + b, b, s->g, xb + s->body[b].at_x)) return -1.0;
    }
    largest = multipliers(s, s->g, x, xb, y);
    if (n > s->n_core) sway(s, x, xb, y, x2, xb2, y2);
    for (int k = 0; k < m; k++) {
        double left = s->g[k];
        for (int c = 2 * k; c < 2 * k + 2; c++)
            if (s->js[c] >= 0) left += block_dot(s->tangent + s->js[c], xb + owner(s, c)->at_x, owner(s, c)->m);
        if (open == open && !(fabs(left) <= open)) open = fabs(left);
    }
    reorder(s, x, xb, 0);
    return open / largest;
}

static double largest_of(const double *units, const double *x, int n)
{
    double found = 0.0;
    for (int i = 0; i < n; i++)
        if (found == found && !(fabs(units[i] * x[i]) <= found)) found = fabs(units[i] * x[i]); /* nan stays */
    return found;
}

static void configuration(const System *s, const double *q0, const double *xi, double *q)
{
    int nb = s->nb;
    for (int b = 0; b < nb; b++) compose(q0 + POSE * b, xi + TWIST * b, q + POSE * b);
    for (int i = TWIST * nb, j = POSE * nb; i < s->n; i++, j++) q[j] = q0[j] + xi[i];
}

int step(const System *s, double *p, const double *now, const double *before, const double *earlier, const double *offset, double *out)
{
    int n = s->n, nq = s->nq, m = s->m, past = (int)p[HISTORY];
    double h = p[H], am = p[AM], af = p[AF], gamma = p[GAMMA], beta = p[BETA];
    double t = now[0] + h, scale = beta * h * h * (1 - af) / (1 - am), hb = h * h * beta, damp = h * gamma * (1 - af) / (1 - am);
    const double *q0 = now + 1, *v0 = q0 + nq, *a0 = v0 + n, *A0 = a0 + n, *l0 = A0 + n;
    const double *a1 = before + 1 + nq + n, *l1 = a1 + 2 * n, *a2 = earlier + 1 + nq + n, *l2 = a2 + 2 * n;
    double t0 = now[0], t1 = before[0], t2 = earlier[0], w0 = 1.0, w1 = 0.0, w2 = 0.0;
    if (past == 1) {
        w0 = (t - t1) / (t0 - t1);
        w1 = (t - t0) / (t1 - t0);
    } else if (past == 2) {
        w0 = (t - t1) / (t0 - t1) * ((t - t2) / (t0 - t2));
        w1 = (t - t0) / (t1 - t0) * ((t - t2) / (t1 - t2));
        w2 = (t - t0) / (t2 - t0) * ((t - t1) / (t2 - t1));
    }
    double *q = out + 1, *v = q + nq, *a = v + n, *A = a + n, *lam = A + n;
    double *xi = s->work, *r = xi + n, *x = r + n, *xb = x + n, *y = xb + s->n_x;
    for (int i = 0; i < n; i++) {
        a[i] = w0 * a0[i] + w1 * a1[i] + w2 * a2[i];
        A[i] = ((1 - af) * a[i] + af * a0[i] - am * A0[i]) / (1 - am);
        xi[i] = h * v0[i] + h * h * (0.5 - beta) * A0[i] + hb * A[i];
    }
    for (int k = 0; k < m; k++) lam[k] = w0 * l0[k] + w1 * l1[k] + w2 * l2[k];
    double typical = largest_of(s->units, a, s->n_core);
    double tolerance = p[TOL] * scale * typical, theta = p[THETA], last = 0.0, older[64];
    if (tolerance < p[FLOOR]) tolerance = p[FLOOR];
    int iterations = 0, converged = 0, far = 1, verdict;
    p[RESIDUAL] = 0.0;
    while (iterations < (int)p[MAXIT] && iterations < 64) {
        configuration(s, q0, xi, q);
        for (int i = 0; i < n; i++) v[i] = v0[i] + h * (1 - gamma) * A0[i] + h * gamma * A[i];
        if ((verdict = place(s, q))) return verdict;
        constraints(s, q, offset, lam);
        for (int b = 0; b < s->nb; b++)
            if ((verdict = inertia(s, s->body + b, b, q, v, a, p + GX, r))) return verdict;
        if (far || (iterations > (int)p[PATIENCE] && s->n == s->n_core)) {
            reactions_stress(s);
            for (int b = 0; b < s->nb; b++)
                if (s->body[b].T && (verdict = factor_body(s, s->body + b, b, q, damp, scale))) return verdict;
            for (int b = 0; b < s->nb; b++)
                if (s->body[b].field && (verdict = factor_field(s, s->body + b, b, q))) return verdict;
            if ((verdict = factor(s))) return verdict;
        }
        add_reactions(s, lam, r);
        double open = solve(s, scale, r, x, xb, y), size = largest_of(s->units, x, n), left;
        if (open == -1.0) return NEWTON;
        far = size > p[FAR];
        size /= tolerance;
        if (!(open <= p[RESIDUAL])) p[RESIDUAL] = open;
        for (int k = 0; k < m; k++) lam[k] += y[k] / scale;
        for (int b = 0; b < s->nb; b++) rate(xi + TWIST * b, x + TWIST * b);
        for (int i = 0; i < n; i++) {
            xi[i] += x[i];
            A[i] += x[i] / hb;
            a[i] += x[i] / scale;
        }
        older[iterations++] = size;
        if (!(size < INFINITY)) return NEWTON;
        if (iterations > 1) {
            theta = last > 0 ? size / last : 0.0;
            theta = theta > 0.999 ? 0.999 : theta < 1e-4 ? 1e-4 : theta;
            left = theta / (1 - theta) * size;
            if (s->n > s->n_core && left > 1.0 && -log(left) / log(theta) > p[NEW_TANGENT]) return NEWTON;
            if (size > 1.0 && iterations > 3 && size > p[SLOW] * older[iterations - 3]) break;
        } else {
            double guess = theta > 0.02 ? theta : 0.02;
            left = guess / (1 - (guess < 0.9 ? guess : 0.9)) * size;
        }
        last = size;
        p[LEFT] = left;
        if (left <= 1.0 || size <= 1e-3) { converged = 1; break; }
    }
    p[ITERATIONS] = iterations;
    if (!converged) return NEWTON;
    p[THETA] = theta;
    configuration(s, q0, xi, q);
    for (int i = 0; i < n; i++) {
        v[i] = v0[i] + h * (1 - gamma) * A0[i] + h * gamma * A[i];
        x[i] = A[i] - A0[i];
    }
    out[0] = t;
    p[LOCAL] = h * h * fabs(beta - 1.0 / 6.0) * largest_of(s->units, x, n);
    return DONE;
}
