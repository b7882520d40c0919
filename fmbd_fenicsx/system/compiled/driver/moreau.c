/* Steps of the Moreau-Jean scheme without impacts: the algorithm of schemes/impacts/moreau.py for free flight and for contacts that
   stay closed, many steps in one call. A step in which something else happens is given back with the verdict LOOK. */

enum { BOUNDED = AM }; /* of the parameters: whether obstacles are thin, so that points could pass through */
static const double TOUCHING = 1e-9, DRIFTING = 1e-5, APPROACH = 1e-8; /* as in moreau.py */
/* Rows and compliance of the closed contacts at the frames evaluated last, whose matrix is factored. */
static void compliance(System *s, Contacts *c, const int *closed, int m)
{
    const int d = c->components, n = m * d, size = s->nv + s->rows;
    for (int r = 0; r < n; r++) {
        int i = closed[r / d];
        const Pair *o = c->pair + c->of[i];
        const double *row = c->rows + 2 * TWIST * r;
        memset(s->b, 0, (s->nu + s->rows) * sizeof(double));
        for (int side = 0; side < 2; side++, row += TWIST) {
            int body = side ? o->carrier : c->frame[i];
            if (body < 0) continue;
            double turning[ROT], *to = s->b + s->body[body].at_u;
            to_world(s->frames + FRAME * body + TURN, row + D, turning);
            add(to, 1.0, row, D);
            add(to + D, 1.0, turning, ROT);
        }
        solution(s, c->Y + (long)size * r, c->Y + (long)size * r + s->nv);
    }
    for (int r = 0; r < n; r++)
        for (int k = 0; k < n; k++) c->W[r * n + k] = along(c, closed[r / d], c->rows + 2 * TWIST * r, c->Y + (long)size * k);
    for (int r = 0; r < n; r++)
        for (int k = 0; k < r; k++) c->W[r * n + k] = c->W[k * n + r] = 0.5 * (c->W[r * n + k] + c->W[k * n + r]);
}

/* Velocities as an array like v into s->velocity, world axes; frames are placed. */
static void turn_velocity(System *s, const double *v)
{
    for (int b = 0; b < s->bodies; b++) {
        const Body *o = s->body + b;
        double *to = s->velocity + o->at_u;
        memcpy(to, v + TWIST * b, D * sizeof(double));
        to_world(s->frames + FRAME * b + TURN, v + TWIST * b + D, to + D);
        memcpy(to + TWIST, v + o->at_v, o->modes * sizeof(double));
    }
    for (int i = 0; i < s->surfaces; i++) {
        const Surface *k = s->surface + i;
        const Body *o = s->body + k->body;
        for (int j = 0; j < TWIST; j++)
            s->velocity[s->nu + TWIST * i + j] = dot(k->map + j * (TWIST + o->modes), s->velocity + o->at_u, TWIST + o->modes);
    }
}

/* The step of length h with the closed contacts: velocities in out.v, multipliers in out.lam, impulses in c->f. */
static int velocities(System *s, Contacts *c, double *p, Block now, Block out, const int *closed, int m, double *kept)
{
    const int n = m * c->components, size = s->nv + s->rows, d = c->components;
    const double h = p[H], middle = *now.t + 0.5 * h;
    double *vm = s->work, *xi = vm + s->nv, *x = xi + s->nv, *y = x + s->nv, sizes[MOST], left = 0.0;
    int done = 0, verdict, converged = 0;

    memcpy(out.v, now.v, s->nv * sizeof(double));
    memcpy(out.lam, now.lam, s->rows * sizeof(double));
    while (done < (int)p[MAXIT] && done < MOST && !converged) {
        for (int i = 0; i < s->nv; i++) {
            vm[i] = 0.5 * (now.v[i] + out.v[i]);
            xi[i] = 0.5 * h * vm[i];
            out.a[i] = (out.v[i] - now.v[i]) / h;
        }
        configuration(s, now.q, xi, out.q);
        if ((verdict = evaluate(s, out.q, vm, out.a, out.lam, middle))) return verdict;
        if (!done && (verdict = prepare(s, out.q, 0.5 * h, 0.25 * h * h, out.lam, 0, middle))) return verdict;
        if (!done && m) compliance(s, c, closed, m);
        memcpy(kept, out.lam, s->rows * sizeof(double));

        /* the step without a change of the impulses, and what that leaves of the contacts */
        turn_velocity(s, out.v);
        if (s->rows) slips(s, 1);
        for (int i = 0; i < s->nu; i++) s->b[i] = -h * s->residual[i];
        for (int i = 0; i < s->rows; i++) s->b[s->nu + i] = -s->slip[i];
        solution(s, x, y);
        for (int k = 0; k < n; k++)
            for (int i = 0; i < s->nv; i++) x[i] += c->f[k] * c->Y[(long)size * k + i];
        for (int k = 0; k < n; k++)
            for (int i = 0; i < s->rows; i++) y[i] += c->f[k] * c->Y[(long)size * k + s->nv + i];
        for (int k = 0; k < n; k++) {
            int i = closed[k / d];
            const double *row = c->rows + 2 * TWIST * k;
            c->q[k] = along(c, i, row, out.v) + along(c, i, row, x) - c->drift[k] / h + (k % d ? 0.0 : c->rate[i]);
        }
        for (int k = 0; k < n; k++) c->q[k] -= dot(c->W + k * n, c->f, n);

        double *old = c->work + 4 * n + n * n;
        memcpy(old, c->f, n * sizeof(double));
        if (m && contact_forces(c, m)) {
            memcpy(c->f, old, n * sizeof(double));
            if (c->python(COMPLEMENTARITY, m, middle)) return LOOK;
        }
        for (int k = 0; k < n; k++) {
            add(x, c->f[k] - old[k], c->Y + (long)size * k, s->nv);
            add(y, c->f[k] - old[k], c->Y + (long)size * k + s->nv, s->rows);
        }

        add(out.v, 1.0, x, s->nv);
        add(out.lam, 1.0 / h, y, s->rows);
        double size_v = fmax(fmax(largest_of(s->units, out.v, s->nv), largest_of(s->units, now.v, s->nv)), 1e-6 * p[LENGTH] / h);
        sizes[done++] = largest_of(s->units, x, s->nv) / (1e-4 * p[TOL] * size_v);
        converged = judge(p, sizes, done, &left);
        if (converged < 0) return NEWTON;
    }
    p[ITERATIONS] += done;
    p[LEFT] += left;
    return converged ? DONE : NEWTON;
}

/* Positions closed to roundoff by the matrix of the step. */
static int closed_rows(System *s, Contacts *c, double *p, double *q, const double *v, double t)
{
    double *x = s->work, *y = x + s->nv, *moved = c->ahead;
    if (!s->rows) return DONE;
    if (s->samples && s->python(SAMPLE, 0, t)) return FAILED;
    for (int round = 0; round < 3; round++) {
        double widest = 0.0;
        int verdict = place(s, q, v);
        if (verdict) return verdict;
        for (int i = 0; i < s->rows; i++) s->gap[i] = -s->motion[i];
        for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
            if (k->role != ROW) continue;
            k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
            for (long i = 0; i < k->n; i++) s->gap[k->row[i]] += k->factor[i] * k->out[i * k->outputs];
        }
        for (int i = 0; i < s->rows; i++) widest = fmax(widest, fabs(s->gap[i]));
        if (widest <= 1e-13 * p[LENGTH]) break;
        memset(s->b, 0, s->nu * sizeof(double));
        for (int i = 0; i < s->rows; i++) s->b[s->nu + i] = -s->gap[i];
        solution(s, x, y);
        configuration(s, q, x, moved);
        memcpy(q, moved, s->nq * sizeof(double));
    }
    return DONE;
}

/* Works of contacts, friction, loads and joints over the increment of a step; frames are those of its middle. */
static void add_works(System *s, Contacts *c, Block now, Block out, const double *xi, const int *closed, int m, const double *kept, double h)
{
    const int d = c->components;
    double work[4] = {0.0, 0.0, 0.0, 0.0}, total, own;
    for (int k = 0; k < m * d; k++) work[k % d > 0] += c->f[k] / h * along(c, closed[k / d], c->rows + 2 * TWIST * k, xi);

    /* of loads: what is left of the balance without inertia and reactions */
    turn_velocity(s, xi);
    if (s->rows) slips(s, 0);
    for (int i = 0; i < s->rows; i++) work[3] -= out.lam[i] * s->slip[i];
    if (c->loaded) {
        total = dot(s->residual, s->velocity, s->nu) - (s->rows ? dot(kept, s->slip, s->rows) : 0.0);
        double *vm = s->work;
        for (int i = 0; i < s->nv; i++) vm[i] = 0.5 * (now.v[i] + out.v[i]);
        inertia(s, s->q, vm, out.a, *out.t);
        own = dot(s->residual, s->velocity, s->nu);
        work[2] = own - total;
    }
    for (int i = 0; i < 4; i++) c->works[i] += work[i];
    c->works[4] -= work[0] + work[1] + work[2] + work[3];
}

/* Contacts that are closed in a step, into c->closed: how many, or -1 where one of them takes an impact. */
static int closed_contacts(Contacts *c, const double *p, Block now)
{
    int m = 0, fresh = 0;
    const double slow = APPROACH * p[LENGTH] / p[H];
    for (int i = 0; i < c->points; i++)
        fresh |= !c->carrying[i] && c->now.gap[i] <= TOUCHING * p[LENGTH];
    if (fresh && gap_rates(c, now.q, *now.t, p[H], c->rate)) return -1;

    for (int i = 0; i < c->points; i++) {
        if (c->now.gap[i] > (c->carrying[i] ? DRIFTING : TOUCHING) * p[LENGTH]) continue;
        if (!c->carrying[i]) {
            contact_rows(c, i, now.q, &c->now, c->rows);
            double rate = along(c, i, c->rows, now.v) + c->rate[i];
            if (rate < -slow) return -1;
            if (rate > slow) continue;
        }
        c->closed[m++] = i;
    }
    return m;
}

/* Whether a point would pass more than half of an obstacle's thickness. */
static int passes(Contacts *c, const double *p, Block now, double *xi)
{
    for (int i = 0; i < c->size; i++) xi[i] = p[H] * now.v[i];
    configuration(c->system, now.q, xi, c->ahead);
    if (touch(c, c->ahead, *now.t + p[H], &c->end)) return 1;
    for (int i = 0; i < c->points; i++) {
        double way[D], thick = c->pair[c->of[i]].thickness;
        for (int j = 0; j < D; j++) way[j] = c->end.relative[D * i + j] - c->now.relative[D * i + j];
        if (length_of(way) > 0.5 * thick && c->now.gap[i] > -0.1 * thick) return 1;
    }
    return 0;
}

/* Forces of the closed contacts become those of the step, its impulses those of the run. */
static void take_forces(Contacts *c, int m, double h)
{
    const int d = c->components;
    memset(c->held, 0, c->points * d * sizeof(double));
    memset(c->carrying, 0, c->points * sizeof(int));
    memset(c->force, 0, c->points * D * sizeof(double));
    int acts = 0;
    for (int k = 0; k < m; k++) {
        int i = c->closed[k];
        const double *f = c->f + d * k, *n = c->end.normal + D * i;
        double e[D * D], world[D];
        memcpy(c->held + d * i, f, d * sizeof(double));
        c->carrying[i] = f[0] > 0;
        across(n, e);
        for (int j = 0; j < D; j++) {
            world[j] = f[0] * n[j];
            for (int a = 1; a < d; a++) world[j] += f[a] * e[D * (a - 1) + j];
            acts |= world[j] != 0.0;
            c->force[D * i + j] = world[j] / h;
            c->impulse[D * c->of[i] + j] += world[j];
        }
    }
    c->tally.steps += acts;
}

static int plain_step(System *s, Contacts *c, double *p, Block now, Block out)
{
    const double h = p[H], t = *now.t;
    double *xi = c->xi, *kept = c->kept, e[4];
    int m, verdict;
    if (!c->known && touch(c, now.q, t, &c->now)) return LOOK;
    c->known = 1;
    if (p[BOUNDED] != 0.0 && passes(c, p, now, xi)) return LOOK;
    if ((m = closed_contacts(c, p, now)) < 0) return LOOK;

    if (m) { /* rows of the middle that the velocities at the start lead to */
        for (int i = 0; i < s->nv; i++) xi[i] = 0.5 * h * now.v[i];
        configuration(s, now.q, xi, c->ahead);
        if (touch(c, c->ahead, t + 0.5 * h, &c->end) || gap_rates(c, c->ahead, t + 0.5 * h, h, c->rate)) return LOOK;
    }
    for (int k = 0; k < m; k++) {
        int i = c->closed[k], d = c->components;
        contact_rows(c, i, c->ahead, &c->end, c->rows + 2 * TWIST * d * k);
        if (drifts(c, i, c->ahead, t, h, &c->end, c->drift + d * k)) return LOOK;
        memcpy(c->f + d * k, c->held + d * i, d * sizeof(double));
        c->mu[k] = c->pair[c->of[i]].friction;
    }
    if (s->samples && s->python(SAMPLE, 0, t + 0.5 * h)) return FAILED;
    double begun = p[ITERATIONS];
    if ((verdict = velocities(s, c, p, now, out, c->closed, m, kept))) return verdict;

    /* another contact closes on the way: an impact, or one that is held */
    for (int i = 0; i < s->nv; i++) {
        xi[i] = 0.5 * h * (now.v[i] + out.v[i]);
        out.a[i] = (out.v[i] - now.v[i]) / h;
    }
    configuration(s, now.q, xi, c->ahead);
    if (touch(c, c->ahead, t + h, &c->aside)) return LOOK;
    for (int k = 0; k < m; k++) c->aside.gap[c->closed[k]] = 0.0;
    for (int i = 0; i < c->points; i++)
        if (c->aside.gap[i] < 0.0) return LOOK;

    double works[5], before = c->energy, springs = c->springs;
    memcpy(works, c->works, sizeof works);
    add_works(s, c, now, out, xi, c->closed, m, kept, h);
    memcpy(out.q, c->ahead, s->nq * sizeof(double));
    verdict = closed_rows(s, c, p, out.q, out.v, t + h);
    if (!verdict) verdict = place(s, out.q, out.v);
    if (verdict || touch(c, out.q, t + h, &c->aside)) {
        memcpy(c->works, works, sizeof works);
        return verdict ? verdict : LOOK;
    }

    *out.t = t + h;
    energies(s, t + h, out.q, out.v, s->rest_gravity, e);
    c->energy = e[0] + e[1] + e[2] + e[3];
    c->springs = e[3];
    c->works[4] += c->energy - before;
    if (c->loaded) c->works[2] += c->springs - springs, c->works[4] -= c->springs - springs;
    take_forces(c, m, h);
    for (int k = 0, acts = 0; k < m * c->components && !acts; k++)
        if ((acts = c->f[k] != 0.0)) c->tally.newton += (long)(p[ITERATIONS] - begun);

    if (!m) {
        for (int i = 0; i < s->nv; i++) s->work[i] = out.a[i] - now.a[i];
        p[LOCAL] = fmax(p[LOCAL], h * h / 12.0 * largest_of(s->units, s->work, s->nv));
    }
    Touch last = c->now;
    c->now = c->aside;
    c->aside = last;
    return DONE;
}

/* Up to ``steps`` steps from ring[0]; ring[1] is free. Returns how many were made; ring[0] is then the newest. */
EXPORT long moreau_march(System *s, Contacts *c, double *p, long steps, double **ring, int *verdict)
{
    long made = 0;
    *verdict = DONE;
    while (made < steps) {
        double theta = p[THETA], iterations = p[ITERATIONS], left = p[LEFT];
        Tally tally = c->tally;
        if ((*verdict = plain_step(s, c, p, block_at(s, ring[0]), block_at(s, ring[1])))) {
            p[THETA] = theta, p[ITERATIONS] = iterations, p[LEFT] = left;
            c->tally = tally;
            break;
        }
        double *newest = ring[1];
        ring[1] = ring[0];
        ring[0] = newest;
        made++;
    }
    return made;
}
