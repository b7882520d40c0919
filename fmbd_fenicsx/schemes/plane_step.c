/* One step of generalized-alpha for rigid bodies of the plane; the same algorithm as generalized_alpha.py, which is the reference.

   M a - f + G^T lambda = 0,  g = 0.  With M diagonal the step's saddle point is solved on the range of G:
   (G M^-1 G^T) y = G M^-1 b - c,  x = M^-1 (b - G^T y),  by a Cholesky factor in profile storage (rows ordered beforehand).

   A block of a state holds t, q (n), v (n), a (n), A (n), lambda (m), n = 3 bodies. Kinds of rows: 0 coincident, 1 along,
   2 perpendicular, 3 distance (constraints.py). Body number nb is the ground. */

#include <math.h>
#include <string.h>

typedef struct {
    int nb, m, nc, unused;
    double *mass;                          /* 3 nb: diagonal of M */
    int *kind, *fa, *fb;                   /* m */
    double *pa, *pb, *e, *f, *length;      /* 2 m each, length m: points and directions in body axes */
    int *order, *first;                    /* m: place of a row in the factor, first column of a place */
    long *start;                           /* m: where the places begin in the profile */
    int *ci, *cj, *cbody;                  /* nc: pairs of Jacobian blocks (2 row + side) on one body */
    long *cdest;                           /* nc: their entry of the profile */
    double *profile, *jac, *g, *y, *work;  /* size of the profile, 6 m, m, m, 3 n + m */
    double *cs, *tangent, *units;          /* 2 (nb + 1): cosine and sine of the bodies; 6 m: G of the factor; 3 nb: see norms */
} System;

enum { H, AM, AF, GAMMA, BETA, GX, GY, TOL, FLOOR, LENGTH, THETA, SLOW, MAXIT, HISTORY,  /* in */
       ITERATIONS, LOCAL, PIVOT, RESIDUAL, SIZE };                                          /* out */

static void evaluate(const System *s, const double *q, const double *offset)
{
    int nb = s->nb, m = s->m;
    double *cs = s->cs;
    for (int i = 0; i < nb; i++) {
        cs[2 * i] = cos(q[3 * i + 2]);
        cs[2 * i + 1] = sin(q[3 * i + 2]);
    }
    cs[2 * nb] = 1.0;
    cs[2 * nb + 1] = 0.0;
    for (int k = 0; k < m; k++) {
        int a = s->fa[k], b = s->fb[k];
        const double *ca = cs + 2 * a, *cb = cs + 2 * b, *pa = s->pa + 2 * k, *pb = s->pb + 2 * k, *e = s->e + 2 * k;
        double *J = s->jac + 6 * k;
        double ax = ca[0] * pa[0] - ca[1] * pa[1], ay = ca[1] * pa[0] + ca[0] * pa[1];
        double bx = cb[0] * pb[0] - cb[1] * pb[1], by = cb[1] * pb[0] + cb[0] * pb[1];
        double dx = bx - ax, dy = by - ay;
        if (b < nb) { dx += q[3 * b]; dy += q[3 * b + 1]; }
        if (a < nb) { dx -= q[3 * a]; dy -= q[3 * a + 1]; }
        double nx, ny, turn = 0.0;
        switch (s->kind[k]) {
        case 0:
            nx = e[0]; ny = e[1];
            s->g[k] = nx * dx + ny * dy - offset[k];
            break;
        case 1:
            nx = ca[0] * e[0] - ca[1] * e[1]; ny = ca[1] * e[0] + ca[0] * e[1];
            s->g[k] = nx * dx + ny * dy - offset[k];
            turn = nx * dy - ny * dx;
            break;
        case 2: {
            const double *f = s->f + 2 * k;
            double c = cos(offset[k]), w = sin(offset[k]);
            double ex = c * e[0] - w * e[1], ey = c * e[1] + w * e[0];
            double ux = ca[0] * ex - ca[1] * ey, uy = ca[1] * ex + ca[0] * ey;
            double vx = cb[0] * f[0] - cb[1] * f[1], vy = cb[1] * f[0] + cb[0] * f[1];
            s->g[k] = ux * vx + uy * vy;
            double cross = ux * vy - uy * vx;
            J[0] = J[1] = J[3] = J[4] = 0.0;
            J[2] = cross; J[5] = -cross;
            continue;
        }
        default: {
            double L = s->length[k];
            nx = dx / L; ny = dy / L;
            s->g[k] = 0.5 * ((dx * dx + dy * dy) / L - L);
        }
        }
        J[0] = -nx; J[1] = -ny; J[2] = turn + nx * ay - ny * ax;
        J[3] = nx;  J[4] = ny;  J[5] = ny * bx - nx * by;
    }
}

static double factor(const System *s, long size)
{
    int m = s->m;
    double *L = s->profile, worst = 1.0;
    memset(L, 0, size * sizeof(double));
    for (int c = 0; c < s->nc; c++) {
        const double *x = s->jac + 3 * s->ci[c], *y = s->jac + 3 * s->cj[c], *M = s->mass + 3 * s->cbody[c];
        L[s->cdest[c]] += x[0] * y[0] / M[0] + x[1] * y[1] / M[1] + x[2] * y[2] / M[2];
    }
    for (int i = 0; i < m; i++) {
        double *Li = L + s->start[i];
        int fi = s->first[i];
        for (int j = fi; j < i; j++) {
            const double *Lj = L + s->start[j];
            int fj = s->first[j], k0 = fi > fj ? fi : fj;
            double sum = Li[j - fi];
            for (int k = k0; k < j; k++) sum -= Li[k - fi] * Lj[k - fj];
            Li[j - fi] = sum * Lj[j - fj];
        }
        double whole = Li[i - fi], sum = whole;
        for (int k = fi; k < i; k++) sum -= Li[k - fi] * Li[k - fi];
        if (!(sum > 1e-10 * whole)) return 0.0;
        if (sum < worst * whole) worst = sum / whole;
        Li[i - fi] = 1.0 / sqrt(sum); /* the inverse of the diagonal */
    }
    return worst;
}

static void back(const System *s, double *y)
{
    int m = s->m;
    const double *L = s->profile;
    for (int i = 0; i < m; i++) {
        const double *Li = L + s->start[i];
        int fi = s->first[i];
        double sum = y[i];
        for (int k = fi; k < i; k++) sum -= Li[k - fi] * y[k];
        y[i] = sum * Li[i - fi];
    }
    for (int i = m - 1; i >= 0; i--) {
        const double *Li = L + s->start[i];
        int fi = s->first[i];
        y[i] *= Li[i - fi];
        for (int k = fi; k < i; k++) y[k] -= Li[k - fi] * y[i];
    }
}

static void add_transposed(const System *s, const double *jac, const double *lam, double sign, double *r)
{
    for (int k = 0; k < s->m; k++) {
        const double *J = jac + 6 * k;
        double l = sign * lam[k];
        int a = s->fa[k], b = s->fb[k];
        if (a < s->nb) { r[3 * a] += J[0] * l; r[3 * a + 1] += J[1] * l; r[3 * a + 2] += J[2] * l; }
        if (b < s->nb) { r[3 * b] += J[3] * l; r[3 * b + 1] += J[4] * l; r[3 * b + 2] += J[5] * l; }
    }
}

static double row_times(const System *s, int k, const double *x)
{
    const double *J = s->tangent + 6 * k;
    int a = s->fa[k], b = s->fb[k];
    double sum = 0.0;
    if (a < s->nb) sum += J[0] * x[3 * a] + J[1] * x[3 * a + 1] + J[2] * x[3 * a + 2];
    if (b < s->nb) sum += J[3] * x[3 * b] + J[4] * x[3 * b + 1] + J[5] * x[3 * b + 2];
    return sum;
}

/* largest entry of M^-1 G^T y without cancellation: what the residual of a solve is judged against */
static double largest(const System *s, const double *y)
{
    double found = 0.0;
    for (int k = 0; k < s->m; k++)
        for (int j = 0; j < 6; j++) {
            int body = j < 3 ? s->fa[k] : s->fb[k];
            if (body == s->nb) continue;
            double x = fabs(s->tangent[6 * k + j] * y[k]) / s->mass[3 * body + j % 3];
            if (x > found) found = x;
        }
    return found;
}

/* 0: done; 1: Newton did not converge; 2: the constraints are close to dependent. */
int step(const System *s, double *p, const double *now, const double *before, const double *earlier, const double *offset, double *out)
{
    int n = 3 * s->nb, m = s->m, past = (int)p[HISTORY];
    double h = p[H], am = p[AM], af = p[AF], gamma = p[GAMMA], beta = p[BETA];
    double t = now[0] + h, scale = beta * h * h * (1 - af) / (1 - am), hb = h * h * beta;
    const double *q0 = now + 1, *v0 = q0 + n, *a0 = v0 + n, *A0 = a0 + n, *l0 = A0 + n;
    const double *a1 = before + 1 + 2 * n, *l1 = before + 1 + 4 * n, *a2 = earlier + 1 + 2 * n, *l2 = earlier + 1 + 4 * n;
    double t0 = now[0], t1 = before[0], t2 = earlier[0], w0 = 1.0, w1 = 0.0, w2 = 0.0;
    if (past == 1) {
        w0 = (t - t1) / (t0 - t1);
        w1 = (t - t0) / (t1 - t0);
    } else if (past == 2) {
        w0 = (t - t1) / (t0 - t1) * ((t - t2) / (t0 - t2));
        w1 = (t - t0) / (t1 - t0) * ((t - t2) / (t1 - t2));
        w2 = (t - t0) / (t2 - t0) * ((t - t1) / (t2 - t1));
    }
    double *q = out + 1, *v = q + n, *a = v + n, *A = a + n, *lam = A + n;
    double *xi = s->work, *r = xi + n, *x = r + n, typical = 0.0;
    const double *u = s->units; /* System.units: all entries as lengths */
    for (int i = 0; i < n; i++) {
        a[i] = w0 * a0[i] + w1 * a1[i] + w2 * a2[i];
        A[i] = ((1 - af) * a[i] + af * a0[i] - am * A0[i]) / (1 - am);
        xi[i] = h * v0[i] + h * h * (0.5 - beta) * A0[i] + hb * A[i];
        if (fabs(u[i] * a[i]) > typical) typical = fabs(u[i] * a[i]);
    }
    for (int k = 0; k < m; k++) lam[k] = w0 * l0[k] + w1 * l1[k] + w2 * l2[k];
    if (typical < 1e-12 * p[LENGTH]) typical = 1e-12 * p[LENGTH];
    double tolerance = p[TOL] * scale * typical, theta = p[THETA], size = 0.0, last = 0.0, older[64];
    if (tolerance < p[FLOOR]) tolerance = p[FLOOR];
    int iterations = 0, converged = 0;
    p[RESIDUAL] = 0.0;
    while (iterations < (int)p[MAXIT] && iterations < 64) {
        for (int i = 0; i < n; i++) q[i] = q0[i] + xi[i];
        evaluate(s, q, offset);
        if (iterations == 0) {
            memcpy(s->tangent, s->jac, 6 * m * sizeof(double));
            p[PIVOT] = factor(s, (long)p[SIZE]);
            if (p[PIVOT] == 0.0) return 2;
        }
        for (int i = 0; i < n; i += 3) {
            r[i] = s->mass[i] * (a[i] - p[GX]);
            r[i + 1] = s->mass[i + 1] * (a[i + 1] - p[GY]);
            r[i + 2] = s->mass[i + 2] * a[i + 2];
        }
        add_transposed(s, s->jac, lam, 1.0, r);
        double large = 1e-300;
        for (int i = 0; i < n; i++) {
            x[i] = -scale * r[i] / s->mass[i];
            if (fabs(x[i]) > large) large = fabs(x[i]);
        }
        for (int k = 0; k < m; k++) s->y[s->order[k]] = row_times(s, k, x) + s->g[k];
        back(s, s->y);
        double *y = x + n;
        for (int k = 0; k < m; k++) y[k] = s->y[s->order[k]];
        double force = largest(s, y);
        if (force > large) large = force;
        for (int i = 0; i < n; i++) x[i] = -scale * r[i];
        add_transposed(s, s->tangent, y, -1.0, x);
        size = 0.0;
        for (int i = 0; i < n; i++) {
            x[i] /= s->mass[i];
            if (!(fabs(u[i] * x[i]) <= size)) size = fabs(u[i] * x[i]);
        }
        double open = 0.0;
        for (int k = 0; k < m; k++) {
            double left = fabs(row_times(s, k, x) + s->g[k]), all = fabs(s->g[k]);
            if (!(left <= open)) open = left;
            if (all > large) large = all;
            lam[k] += y[k] / scale;
        }
        if (!(open / large <= p[RESIDUAL])) p[RESIDUAL] = open / large;
        for (int i = 0; i < n; i++) {
            xi[i] += x[i];
            A[i] += x[i] / hb;
            a[i] += x[i] / scale;
        }
        size /= tolerance;
        older[iterations++] = size;
        if (!(size < INFINITY)) return 1;
        double left;
        if (iterations > 1) {
            theta = last > 0 ? size / last : 0.0;
            theta = theta > 0.999 ? 0.999 : theta < 1e-4 ? 1e-4 : theta;
            left = theta / (1 - theta) * size;
            if (size > 1.0 && iterations > 3 && size > p[SLOW] * older[iterations - 3]) break;
        } else {
            double guess = theta > 0.02 ? theta : 0.02;
            left = guess / (1 - (guess < 0.9 ? guess : 0.9)) * size;
        }
        last = size;
        if (left <= 1.0 || size <= 1e-3) { converged = 1; break; }
    }
    p[ITERATIONS] = iterations;
    if (!converged) return 1;
    p[THETA] = theta;
    double jump = 0.0;
    for (int i = 0; i < n; i++) {
        q[i] = q0[i] + xi[i];
        v[i] = v0[i] + h * (1 - gamma) * A0[i] + h * gamma * A[i];
        double change = fabs(u[i] * (A[i] - A0[i]));
        if (change > jump) jump = change;
    }
    out[0] = t;
    p[LOCAL] = h * h * fabs(beta - 1.0 / 6.0) * jump;
    return 0;
}
