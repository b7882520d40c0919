/* The theta rule, schemes/impacts/contact_midpoint.py, many steps in one call (march.c); with contacts of contact/elastic_contact.c.

   Its room begins with theta, the size (m) of increments that are roundoff, whether velocities are projected on joints, and nv
   numbers: 1 for nodes without inertia. */

enum { SHARE_OF_STEP, ROUNDOFF, PROJECTS, MASSLESS };
static const double FINER = 1e-4; /* of Newton's tolerance: increments count by the way of a step */

/* What a step works with. */
typedef struct {
    const double *massless;
    double *xi, *x, *part, *v, *a, *q; /* increment, the newest of its own; those of the point where forces act, and that; */
    double *factored;                  /* where it was as the matrix was made */
    double *sums, *y, *gap, *held, *slip, *partial, *second;
} ThetaRoom;

static ThetaRoom theta_room(const System *s, double *room)
{
    const long n = s->nv, m = s->rows;
    ThetaRoom o = {.massless = room + MASSLESS, .xi = room + MASSLESS + n};
    o.x = o.xi + n, o.part = o.x + n, o.v = o.part + n, o.a = o.v + n, o.sums = o.a + n, o.q = o.sums + n;
    o.factored = o.q + s->nq, o.y = o.factored + s->nq;
    o.gap = o.y + m, o.held = o.gap + m, o.slip = o.held + m, o.partial = o.slip + m, o.second = o.partial + m;
    return o;
}

/* Forces out of balance (2) where these act, with the first of a step its matrix; then (3) at the end, rows on velocities where forces
   act. */
static int theta_residuals(System *s, const ThetaRoom *o, double h, double theta, Block now, Block out, int anew)
{
    const double t = *now.t + theta * h;
    int verdict;
    for (int i = 0; i < s->nv; i++) {
        o->part[i] = theta * o->xi[i];
        o->v[i] = o->xi[i] / h;
        o->a[i] = (o->v[i] - now.v[i]) / (theta * h);
    }

    if ((verdict = driver_compose(s, 1, now.q, s->nq, o->part, s->nv, o->q))) return verdict;
    s->share = h;
    if ((verdict = driver_balances(s, 1, &t, o->q, o->v, o->a, out.lam, o->sums))) return verdict;
    if (anew && (verdict = prepare(s, o->q, theta * h, theta * theta * h * h, out.lam, 0, t))) return verdict;
    if (anew) memcpy(o->factored, o->q, s->nq * sizeof(double));
    memcpy(o->held, s->gap, s->rows * sizeof(double));

    if ((verdict = driver_compose(s, 1, now.q, s->nq, o->xi, s->nv, out.q))) return verdict;
    memset(o->x, 0, s->nv * sizeof(double));
    if ((verdict = driver_constraints(s, 1, out.t, out.q, o->x, o->gap, o->slip, o->partial, o->second))) return verdict;
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++)
        for (long i = 0; k->role == ROW && k->flow && i < k->n; i++) o->gap[k->row[i]] = o->held[k->row[i]];
    return DONE;
}

/* Newton's iteration for the increment of a step. */
static int theta_iterate(System *s, double *p, const double *room, const ThetaRoom *o, Block now, Block out)
{
    const double h = p[H], theta = room[SHARE_OF_STEP], scale = theta * h * h;
    const Contacting at = {*now.t + theta * h, *out.t, *now.t, h, scale, o->q, out.q, o->xi, o->gap, o->sums};
    const int touching = start_forces(s, s->contact, &now);
    const int most = (int)fmin(p[MAXIT], MOST);
    double sizes[MOST], left;
    int verdict, converged = 0, done;

    for (done = 0; !converged;) {
        if (done == most) return NEWTON;
        if ((verdict = theta_residuals(s, o, h, theta, now, out, !done))) return verdict;
        if (touching && !done) contact_factored(s, s->contact, o->factored);
        for (int i = 0; i < s->nv; i++) o->sums[i] *= -scale;
        for (int i = 0; i < s->rows; i++) o->gap[i] = -o->gap[i];
        verdict = touching ? contact_increment(s, s->contact, &at, o->x, o->y)
                           : driver_solve(s, 1, o->factored, o->sums, o->gap, o->x, o->y);
        if (verdict) return verdict;

        const double size = largest_of(s->units, o->x, s->nv);
        for (int i = 0; i < s->rows; i++) out.lam[i] += o->y[i] / scale;
        driver_rate(s, 1, o->xi, s->nv, o->x, s->nv, o->part);
        add(o->xi, 1.0, o->part, s->nv);
        const double way = fmax(largest_of(s->units, o->xi, s->nv), h * largest_of(s->units, now.v, s->nv));
        const double tolerance = fmax(FINER * p[TOL] * way, room[ROUNDOFF]);
        sizes[done++] = size / tolerance;

        converged = judge_step(s, p, &now, sizes, tolerance, done, &left);
        if (converged > 0) iterated(s->contact, &now, &out, h, sizes, tolerance, done);
        if (converged < 0 || (lingers(p, done, left) && !goes_on_slowly(s->contact))) return NEWTON;
        p[ITERATIONS] += 1;
    }
    p[LEFT] += left;
    return driver_compose(s, 1, now.q, s->nq, o->xi, s->nv, out.q);
}

/* One step, as a Maker of march.c. */
static int theta_step(System *s, double *p, double *room, const Block *past, int known, Block out)
{
    const ThetaRoom o = theta_room(s, room);
    const Block now = past[0];
    const double h = p[H], theta = room[SHARE_OF_STEP], left = 1.0 - theta;
    int verdict;
    (void)known; /* it begins with the velocity, as steps in contact do */

    *out.t = *now.t + h;
    for (int i = 0; i < s->nv; i++) o.part[i] = o.massless[i] ? -0.25 * h * h * now.a[i] : 0.0; /* (5) */
    if ((verdict = begin_contact(s, s->contact, h, &now, theta == 0.5 ? o.part : NULL))) return verdict;
    do {
        memcpy(out.lam, now.lam, s->rows * sizeof(double));
        for (int i = 0; i < s->nv; i++) o.xi[i] = h * now.v[i], out.A[i] = 0.0;
        if ((verdict = theta_iterate(s, p, room, &o, now, out))) return verdict;
    } while (met_others(s->contact, &out, &verdict));
    if (verdict) return verdict;

    /* (1), and (4) where there is no inertia */
    for (int i = 0; i < s->nv; i++) {
        const double mean = o.xi[i] / h, slope = (mean - now.v[i]) / h + left * now.a[i];
        out.v[i] = o.massless[i] ? mean + left * h * slope : now.v[i] + (mean - now.v[i]) / theta;
        o.a[i] = slope;
    }

    if (room[PROJECTS] != 0.0) {
        if ((verdict = driver_constraints(s, 1, out.t, out.q, out.v, o.gap, o.slip, o.partial, o.second))) return verdict;
        memset(o.sums, 0, s->nv * sizeof(double));
        for (int i = 0; i < s->rows; i++) o.slip[i] = -o.slip[i];
        if ((verdict = driver_solve(s, 1, o.factored, o.sums, o.slip, o.x, o.y))) return verdict;
        add(out.v, 1.0, o.x, s->nv);
    }

    for (int i = 0; i < s->nv; i++) {
        out.a[i] = o.massless[i] ? o.a[i] : (out.v[i] - now.v[i]) / h;
        o.x[i] = out.a[i] - now.a[i];
    }
    p[LOCAL] = fmax(p[LOCAL], h * h / 12 * largest_of(s->units, o.x, s->nv));
    return DONE;
}
