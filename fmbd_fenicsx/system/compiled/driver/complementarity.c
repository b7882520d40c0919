/* The small problem of contacts without or with Coulomb friction: Newton's iteration on Alart and Curnier's function
   (doi:10.1016/0045-7825(91)90022-X). Problems that it does not solve at once, and dependent contacts, are those
   of friction.c, or Python's, see linear/complementarity. */

enum { ROUNDS = 12 }; /* iterations at most */

/* Alart and Curnier's function of one point, and its derivatives by force and by opening; its status. */
static int coulomb(const double *x, const double *u, double cn, double ct, double mu, int d, double *F, double *dx, double *du)
{
    int on = x[0] - cn * u[0] > 0;
    double y[2] = {0.0, 0.0}, size = 0.0, radius = mu * fmax(x[0], 0.0);
    memset(dx, 0, d * d * sizeof(double));
    memset(du, 0, d * d * sizeof(double));
    F[0] = on ? cn * u[0] : x[0];
    if (on) du[0] = cn;
    else dx[0] = 1.0;
    for (int i = 1; i < d; i++) {
        y[i - 1] = x[i] - ct * u[i];
        size += y[i - 1] * y[i - 1];
    }
    size = sqrt(size);

    int stick = on && size <= radius;
    for (int i = 1; i < d; i++) {
        F[i] = stick ? ct * u[i] : x[i];
        if (stick) du[i * d + i] = ct;
        else dx[i * d + i] = 1.0;
    }
    if (!on || stick) return on;
    for (int i = 1; i < d; i++) {
        double e = y[i - 1] / size;
        F[i] = x[i] - radius * e;
        if (x[0] > 0) dx[i * d] = -mu * e;
        for (int j = 1; j < d && d == 3; j++) {
            double P = radius / size * ((i == j) - e * y[j - 1] / size);
            dx[i * d + j] -= P;
            du[i * d + j] += ct * P;
        }
    }
    return 2;
}

/* Newton's iteration from the forces of a problem, as linear/complementarity/coulomb.py does at first; without friction it is
   that of active sets. 1 where it does not find the forces. Of many contacts it only sees whether they have them already. */
static int contact_forces(Contacts *c, const Problem *o)
{
    const int m = o->m, d = c->components, n = m * d;
    double *x = c->work, *u = x + n, *F = u + n, *A = F + n, dx[9], du[9], free = 0.0;
    int before[CLOSED];
    const int many = m > CLOSED;
    memcpy(x, o->f, n * sizeof(double));

    for (int round = 0; round < ROUNDS; round++) {
        double residual, force;
        if (!many) memset(A, 0, n * n * sizeof(double));
        for (int i = 0; i < n; i++) u[i] = o->q[i] + dot(o->W + i * n, x, n);
        for (int i = 0; i < m; i++) {
            double cn = 1.0 / fmax(o->W[i * d * (n + 1)], 1e-300), ct = INFINITY;
            for (int k = 1; k < d; k++) ct = fmin(ct, 1.0 / fmax(o->W[(i * d + k) * (n + 1)], 1e-300));
            int status = coulomb(x + i * d, u + i * d, cn, ct, o->mu[i], d, F + i * d, dx, du);
            free = fmax(free, fabs(cn * o->q[i * d]));
            if (many) continue;
            c->tally.changes += round && status != before[i];
            before[i] = status;
            for (int a = 0; a < d; a++) {
                double *row = A + (i * d + a) * n;
                for (int b = 0; b < d; b++) {
                    row[i * d + b] += dx[a * d + b];
                    if (du[a * d + b] != 0.0) add(row, du[a * d + b], o->W + (i * d + b) * n, n);
                }
            }
        }
        residual = largest(F, n);
        force = largest(x, n);
        residual /= fmax(free + fmin(force, 1e3 * free), 1e-300);
        if (residual <= (many ? 1e-12 : 1e-13)) { /* sums of many terms are known to less */
            memcpy(o->f, x, n * sizeof(double));
            c->tally.residual = fmax(c->tally.residual, residual);
            c->tally.solves++;
            return 0;
        }
        if (many || !isfinite(residual) || solve_dense(A, n, F, 1, 1, 1e-10)) return 1;
        for (int i = 0; i < n; i++) x[i] -= F[i];
        c->tally.iterations++;
    }
    return 1;
}

/* Whether the forces of one closed contact move another: they share a body, or bodies that are joined. */
static int coupled(const Contacts *c, const Problem *o, int i, int k)
{
    const int d = c->components, n = o->m * d;
    for (int a = 0; a < d; a++)
        for (int b = 0; b < d; b++)
            if (o->W[(long)(i * d + a) * n + k * d + b] != 0.0) return 1;
    return 0;
}
