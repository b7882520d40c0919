/* The small problem of contacts without or with Coulomb friction: Newton's iteration on Alart and Curnier's function
   (doi:10.1016/0045-7825(91)90022-X). Problems that it does not solve at once, and dependent contacts, are those
   of friction.c, or Python's, see linear/complementarity. */

enum { SWEEPS = 20, SOON = 5, ROUNDS = 18 }; /* of Newton's iterations from the last forces, and of all with those behind the sweeps */
static const double KNOWN = 4e-15; /* of the forces, for each contact: what the function is known to */
static const double HARDLY = 1e-15, STANDS = 1e-12; /* of large forces, and at most: no reason to change what the step has found */
static const double MISSED = 1e-4; /* what a share of the rates that contacts miss counts beside one of their forces */

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

/* What makes gaps, and slips, of point i comparable with forces. */
static void scales(const Problem *o, int i, int d, double *cn, double *ct)
{
    const double *own = o->own + i * d * d;
    *cn = 1.0 / fmax(own[0], 1e-300);
    *ct = INFINITY;
    for (int k = 1; k < d; k++) *ct = fmin(*ct, 1.0 / fmax(own[k * (d + 1)], 1e-300));
}

/* The worse of a residual and of that of each contact beside its own force, or beside the rates without forces, as coulomb.py: the
   largest force knows nothing of contacts of light bodies, which open and close at any rate under forces far below it, and large
   forces on light bodies count up to where their roundoff, in rates, is all that others move by. */
static double worst_contact(const Problem *o, int d, const double *q, const double *x, const double *F, double residual)
{
    const double free = largest(q, o->m * d) / MISSED;
    for (int i = 0; i < o->m; i++, x += d, F += d) {
        const double force = largest(x, d);
        double cn, ct;
        scales(o, i, d, &cn, &ct);
        for (int k = 0; k < d; k++) {
            const double light = (k ? ct : cn) * free, own = light + fmin(force, light / MISSED);
            residual = worse(residual, fabs(F[k]) / fmax(own, 1e-300));
        }
    }
    return residual;
}

/* Sweeps over the contacts of a group, each of which follows its law while the others stay (Gauss and Seidel's way, as Jourdan, Alart and
   Jean's, doi:10.1016/S0045-7825(97)00137-0): a sweep costs little beside a matrix, and leaves few contacts in a wrong state. */
static void sweep_forces(const Problem *o, int d, double *x)
{
    for (int k = 0; k < SWEEPS * o->m; k++) {
        const int i = k % o->m;
        double *f = x + i * d, u[D], cn, ct, size = 0.0;
        moved_at(o, d, i, x, u);
        add(u, 1.0, o->q + i * d, d);
        scales(o, i, d, &cn, &ct);
        f[0] = fmax(0.0, f[0] - cn * u[0]);
        for (int a = 1; a < d; a++) f[a] -= ct * u[a], size += f[a] * f[a];
        size = sqrt(size);
        for (int a = 1; a < d && size > o->mu[i] * f[0]; a++) f[a] *= o->mu[i] * f[0] / size;
    }
}

/* Newton's iteration from the forces of group g, as linear/complementarity/coulomb.py does at first; without friction it is that of
   active sets. Of several answers that which is near the last forces is found soon; where none is, sweeps begin anew. 1 where it does not
   find the forces; those in the problem may be those of the sweeps then. Where the forces have not changed W is not needed. */
static int contact_forces(Contacts *c, const Problem *o, int g)
{
    const int m = o->m, d = c->components, n = m * d;
    double *x = c->least, *u = x + n, *F = u + n, *dx = F + n, *du = dx + n * d, free = 0.0;
    const double least = fmin(fmax(1e-13, KNOWN * m), 1e-12); /* sums of many terms are known to less */
    int *before = c->states;
    memcpy(x, o->f, n * sizeof(double));
    memcpy(u, o->u, n * sizeof(double));
    memcpy(o->held, x, n * sizeof(double));
    memcpy(o->opened, u, n * sizeof(double));

    for (int round = 0; round < ROUNDS; round++) {
        for (int i = 0; i < m; i++) {
            double cn, ct;
            scales(o, i, d, &cn, &ct);
            int status = coulomb(x + i * d, u + i * d, cn, ct, o->mu[i], d, F + i * d, dx + i * d * d, du + i * d * d);
            free = fmax(free, fabs(cn * o->q[i * d]));
            c->tally.changes += round && status != before[i];
            before[i] = status;
        }

        const double scale = free + fmin(largest(x, n), 1e3 * free);
        const double residual = worst_contact(o, d, o->q, x, F, largest(F, n) / fmax(scale, 1e-300));
        const double stands = round || !c->done ? 0.0 : fmin(STANDS, HARDLY * largest(x, n) / fmax(scale, 1e-300));
        if (residual <= fmax(least, stands)) {
            memcpy(o->f, x, n * sizeof(double));
            memcpy(o->u, u, n * sizeof(double));
            c->tally.residual = fmax(c->tally.residual, residual);
            c->tally.solves++;
            return 0;
        }

        if (!isfinite(residual)) return 1;
        if (o->lumped) return 1; /* see friction.c */
        if (!round) know_group(c, g);

        if (round == SOON) {
            sweep_forces(o, d, o->f);
            memcpy(x, o->f, n * sizeof(double));
        } else {
            load_blocks(o, d, &c->blocks, du, NULL, dx);
            if (factor_blocks(o, d, &c->blocks, 1e-10)) return 1;
            solve_blocks(o, d, &c->blocks, F);
            add(x, -1.0, F, n);
            c->tally.iterations++;
        }

        open_under(o, d, x, u);
    }
    return 1;
}

/* The same for a problem of its own, all of whose compliance is known. */
EXPORT int contact_problem(Contacts *c) { return contact_forces(c, &c->all, 0); }
