/* Velocities of closed contacts at the end of a step of elastic bodies: (2) and (3) of schemes/impacts/contact_alpha.py. */

/* Rates of gaps that come from prescribed motion, into o->rates, by central differences over the step. */
static int take_rates(ElasticContact *o, double h, const Block *out)
{
    Contacts *c = o->contacts;
    const double e = 1e-3 * h;
    memset(o->rates, 0, o->count * sizeof(double));
    for (int side = 1; c->moving && side > -2; side -= 2) {
        if (look_at_points(o, out->q, *out->t + side * e, &c->aside)) return FAILED;
        for (int k = 0; k < o->count; k++) o->rates[k] += side * c->aside.gap[o->near[k]] / (2 * e);
    }
    return DONE;
}

/* At which gaps open, and slips grow, of point k near, by the motion of its obstacle alone, (components). */
static int carried(ElasticContact *o, int k, double h, const Block *now, const Block *out, double *rate)
{
    Contacts *c = o->contacts;
    if (drifts(c, o->near[k], out->q, *out->t, way_over(*now->t, h), &c->end, rate)) return FAILED;
    for (int a = 1; a < c->components; a++) rate[a] *= -1.0 / h;
    *rate = o->rates[k];
    return DONE;
}

/* Impulses (2) on closed contacts, the only ones with forces, into P->f, over ``scale``; whether there are any. Open ones are not moved. */
static int stop_closed(System *s, ElasticContact *o, const Persisting *at, const double *force, const Block *now, const Block *out, int *any)
{
    const int d = o->contacts->components, m = o->count;
    Problem *P = &o->problem->all;
    double most = 0.0, carry[D];
    int verdict;
    *any = 0;
    for (int k = 0; k < m; k++) {
        if (carried(o, k, at->h, now, out, carry)) return FAILED;
        for (int a = 0; a < d; a++)
            P->u[d * k + a] = row_times(o, o->near[k], o->rows + WIDE * (d * k + a), out->v) + carry[a];
        if (force[d * k] > 0.0) most = fmax(most, fabs(P->u[d * k])), *any |= P->u[d * k] < 0.0;
    }

    memset(P->f, 0, d * m * sizeof(double));
    if (!*any) return DONE;
    memcpy(o->slopes, o->rows, d * m * WIDE * sizeof(double)); /* of velocities */
    if ((verdict = take_compliance(s, o, at->scale))) return verdict;

    for (int k = 0; k < m; k++) {
        if (force[d * k] > 0.0) continue;
        memset(P->u + d * k, 0, d * sizeof(double));
        P->u[d * k] = most;
        o->known_scale = 0.0;
        if (P->lumped) P->lumped->still[k] = 1;
        if (P->lumped) continue;

        for (int j = 0; j < m; j++) {
            if (j == k) continue;
            memset(P->W + ((long)k * (m - 1) + j - (j > k)) * d * d, 0, d * d * sizeof(double));
            memset(P->W + ((long)j * (m - 1) + k - (k > j)) * d * d, 0, d * d * sizeof(double));
        }
    }
    memcpy(P->q, P->u, d * m * sizeof(double));
    verdict = find_forces(o);
    if (P->lumped) memset(P->lumped->still, 0, m * sizeof(int));
    return verdict;
}

static int kinetic(System *s, const Block *out, const double *v, double *found)
{
    double e[4];
    const int verdict = driver_energies(s, 1, out->t, out->q, v, e);
    *found = *e;
    return verdict;
}

/* The share (3) of a change dv of velocities, whose work on obstacles is given. */
static int share_of(System *s, ElasticContact *o, const double *dv, double work, const Block *out, double *share)
{
    double *sum = o->room, both, alone, fresh;
    int verdict;
    memcpy(sum, out->v, s->nv * sizeof(double));
    add(sum, 1.0, dv, s->nv);
    if ((verdict = kinetic(s, out, dv, &fresh)) || (verdict = kinetic(s, out, sum, &both))) return verdict;
    if ((verdict = kinetic(s, out, out->v, &alone))) return verdict;
    const double slope = both - alone - fresh + work;
    *share = fresh > 0.0 ? fmin(fmax(-slope / (2 * fresh), 0.0), 1.0) : 0.0;
    return DONE;
}

int persist(System *s, ElasticContact *o, const Persisting *k, const Block *now, const Block *out)
{
    Contacts *c = o->contacts;
    const int d = c->components, n = d * o->count;
    double *force = o->change, *stopped = o->stopped, *f = o->problem->all.f, *dv = o->room + s->nv, work = 0.0, share, carry[D];
    int verdict, any = 0, fresh = 0;
    for (int r = 0; r < n; r += d) {
        any |= f[r] > 0.0;
        fresh |= f[r] > 0.0 && now->own[o->at_held + d * o->near[r / d]] <= 0.0;
    }

    if (!any) return DONE;
    memcpy(force, f, n * sizeof(double));
    memcpy(stopped, f, n * sizeof(double));
    if (take_rates(o, k->h, out)) return FAILED;
    if ((verdict = stop_closed(s, o, k, force, now, out, &any))) return verdict;

    if (any) {
        for (int r = 0; r < n; r++) f[r] *= k->scale, stopped[r] += f[r] / k->h;
        if ((verdict = pushed(s, o, 1.0, f, dv, NULL))) return verdict;
        add(out->v, 1.0, dv, s->nv);
    }

    /* where contacts have closed in this step */
    if (fresh) {
        for (int r = 0; r < n; r++) f[r] = -k->gain * force[r];
        for (int j = 0; j < o->count; j++) {
            if (carried(o, j, k->h, now, out, carry)) return FAILED;
            work += dot(f + d * j, carry, d);
        }

        if ((verdict = pushed(s, o, 1.0, f, dv, NULL)) || (verdict = share_of(s, o, dv, work, out, &share))) return verdict;
        add(out->v, share, dv, s->nv);
        add(out->A, share * k->to_A, dv, s->nv);
        add(out->a, share * k->to_a, dv, s->nv);
        add(stopped, -share, force, n);
    }
    memcpy(f, stopped, n * sizeof(double));
    return DONE;
}
