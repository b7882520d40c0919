/* Flights of the Moreau scheme: a solved part of a step, where on its parabola the next contact closes, and the state it leads to. */

static const double TOUCHING = 1e-9, STILL = 1e-13, INSTANT = 1e-9; /* as in moreau.py */
enum { LOCATING = 6, SHARES = 13 };

/* Impulses of the m contacts of a part of a length, as forces over the whole step h, and for the books. What contacts carry in a flight
   stays known behind an impact, whose impulses tell nothing of it. */
static void take_forces(Contacts *c, int m, double length, double h)
{
    const int d = c->components, impact = length <= INSTANT * h;
    for (int k = 0; k < c->candidates; k++) {
        if (!impact) memset(c->held + d * c->candidate[k], 0, d * sizeof(double));
        c->carrying[c->candidate[k]] = 0;
    }

    for (int k = 0; k < m; k++) {
        int i = c->closed[k];
        const double *f = c->all.f + d * k, *n = c->end.normal + D * i;
        double e[D * D];
        for (int a = 0; a < d && !impact; a++) c->held[d * i + a] = f[a] / length;
        c->carrying[i] = f[0] > 0 && !c->bouncing[i];
        c->normal[i] += f[0] / h;
        const int slides = c->pair[c->of[i]].shape != LIMIT;
        if (slides) across(n, e);

        for (int j = 0; j < D; j++) {
            double world = f[0] * n[j];
            for (int a = 1; slides && a < d; a++) world += f[a] * e[D * (a - 1) + j];
            c->force[D * i + j] += world / h;
            c->impulse[D * c->of[i] + j] += world;
        }
    }
}

/* The step of a length with the m contacts in c->closed: rows of the middle that the velocities at the start lead to. */
static int solved(System *s, Contacts *c, double *p, Block now, Block out, int m, double length, double span)
{
    const double t = *now.t;
    const int d = c->components, flight = m && span == length;
    if (m > c->room) return LOOK;
    arrange(c, m);
    if (flight && start_rates(c, now, m, length)) return LOOK;
    if (m) {
        for (int i = 0; i < s->nv; i++) c->xi[i] = 0.5 * length * now.v[i];
        configuration(s, now.q, c->xi, c->ahead);
        if (touch(c, c->ahead, t + 0.5 * length, &c->end)) return LOOK;
        if (gap_rates(c, c->ahead, t + 0.5 * length, span, c->rate)) return LOOK;
    }

    for (int k = 0; k < m; k++) {
        int i = c->closed[k];
        const Pair *o = c->pair + c->of[i];
        double *rows = c->rows + 2 * c->wide * d * k;
        contact_rows(c, i, c->ahead, &c->end, rows);
        if (drifts(c, i, c->ahead, t + 0.5 * length, way_over(t, span), &c->end, c->drift + d * k)) return LOOK;

        if (flight && !c->bouncing[i]) turn_slips(c, i, length, rows, now, c->before + d * k, c->drift + d * k, c->slip + d * k);
        for (int a = 0; a < d; a++) c->all.f[d * k + a] = length * c->held[d * i + a];
        c->all.mu[k] = o->friction;
        for (int a = 0; a < d; a++)
            c->before[d * k + a] = along(c, i, rows + 2 * c->wide * a, now.v) + (a ? -c->drift[d * k + a] / span : c->rate[i]);
        double back = c->before[d * k] < 0.0 ? o->restitution : 1.0;
        c->rebound[k] = c->bouncing[i] ? back * c->before[d * k] : !flight ? 0.0 : c->before[d * k] - (c->rebound[k] > STILL * p[LENGTH] / length ? 0.0 : c->rebound[k]);
        c->rate[i] += c->rebound[k];
    }

    if (s->samples && s->python(SAMPLE, 0, t + 0.5 * length)) return FAILED;
    return velocities(s, c, p, now, out, m, length, span);
}

/* All points at a share of a solved step, along its parabola, into ``aside``. */
static int along_parabola(System *s, Contacts *c, Block now, Block out, double length, double share)
{
    for (int i = 0; i < s->nv; i++) c->xi[i] = length * share * (now.v[i] + 0.5 * share * (out.v[i] - now.v[i]));
    configuration(s, now.q, c->xi, c->ahead);
    return touch(c, c->ahead, *now.t + share * length, &c->aside);
}

/* The share at which contact i closes, which is open at ``lower`` and not at ``upper``: by secants that halve the gap of an end
   which stays (Dowell and Jarratt, doi:10.1007/BF01934364). */
static int closing_share(System *s, Contacts *c, Block now, Block out, int i, double length, double lower, double upper, double *share)
{
    double open, shut;
    if (along_parabola(s, c, now, out, length, lower)) return LOOK;
    open = c->aside.gap[i];
    if (along_parabola(s, c, now, out, length, upper)) return LOOK;
    shut = c->aside.gap[i];

    for (int k = 0, side = 0; k < 64 && upper - lower > 1e-14; k++) {
        *share = lower + (upper - lower) * open / (open - shut);
        if (!(*share > lower && *share < upper)) *share = 0.5 * (lower + upper);
        if (along_parabola(s, c, now, out, length, *share)) return LOOK;

        double gap = c->aside.gap[i];
        if (gap == 0.0) break;
        if (gap > 0.0) {
            lower = *share, open = gap;
            if (side > 0) shut *= 0.5;
        } else {
            upper = *share, shut = gap;
            if (side < 0) open *= 0.5;
        }

        side = gap > 0.0 ? 1 : -1;
    }
    return DONE;
}

/* Share of a solved step at which the first free contact closes, into ``share`` (1: none), and which one that is. ``held``: how many
   would leave for a moment only; these have 0 behind the counts of impacts. */
static int next_touch(
    System *s, Contacts *c, double *p, Block now, Block out, int m, double length, double *share, int *which, int *held)
{
    int any = 0, left = 0, *open = c->hits + c->points; /* -1: not closing; 0: not yet seen open; else which share it is open at */
    if (along_parabola(s, c, now, out, length, 1.0)) return LOOK;
    for (int k = 0; k < c->candidates; k++) open[c->candidate[k]] = c->aside.gap[c->candidate[k]] < 0.0 ? 0 : -1;
    for (int k = 0; k < m; k++) open[c->closed[k]] = -1;
    for (int k = 0; k < c->candidates; k++) any |= open[c->candidate[k]] == 0;
    *share = 1.0;
    *held = 0;
    if (!any) return DONE;

    for (int k = 1; k < SHARES; k++) {
        if (along_parabola(s, c, now, out, length, ldexp(1.0, -k))) return LOOK;
        left = 0;
        for (int n = 0; n < c->candidates; n++) {
            const int i = c->candidate[n];
            if (open[i] == 0 && c->aside.gap[i] > 0.0) open[i] = k;
            left += open[i] == 0;
        }
        if (!left) break;
    }

    if ((*held = left)) return DONE;
    *which = -1;
    for (int k = 0; k < c->candidates; k++) {
        const int i = c->candidate[k];
        if (open[i] > 0 && (*which < 0 || open[i] > open[*which])) *which = i;
    }

    /* of those that are open at the same share the one that closes first: the others are above where it does */
    const int last = open[*which];
    for (int first = *which; first >= 0;) {
        *which = first;
        if (closing_share(s, c, now, out, first, length, ldexp(1.0, -last), *share < 1.0 ? *share : ldexp(2.0, -last), share)) return LOOK;
        first = -1;
        double deepest = -0.5 * TOUCHING * p[LENGTH];
        for (int k = 0; k < c->candidates; k++) {
            const int i = c->candidate[k];
            if (open[i] != last || !(c->aside.gap[i] < deepest)) continue;
            deepest = c->aside.gap[first = i];
        }
    }
    return DONE;
}

/* The solved step once more, so that it ends where contact ``which`` closes; its length. */
static int located(System *s, Contacts *c, double *p, Block now, Block out, int m, int which, double *length, double share)
{
    const double whole = *length, deepest = (s->rows ? 0.5 * TOUCHING : DRIFTING) * p[LENGTH];
    double near, slope;
    int verdict;
    if (along_parabola(s, c, now, out, whole, (1 - 1e-3) * share)) return LOOK;
    near = c->aside.gap[which];
    if (along_parabola(s, c, now, out, whole, share)) return LOOK;
    slope = (c->aside.gap[which] - near) / (1e-3 * share);

    for (int k = 0; k < LOCATING; k++) {
        *length = share * whole;
        if ((verdict = solved(s, c, p, now, out, m, *length, *length))) return verdict;
        for (int i = 0; i < s->nv; i++) c->xi[i] = 0.5 * *length * (now.v[i] + out.v[i]);
        configuration(s, now.q, c->xi, out.q);
        if ((verdict = closed_rows(s, c, p, out.q, out.v, *now.t + *length))) return verdict;
        if (touch(c, out.q, *now.t + *length, &c->aside)) return LOOK;

        double gap = c->aside.gap[which];
        if ((gap >= -deepest && gap <= 0.5 * TOUCHING * p[LENGTH]) || !(slope < 0.0)) break;
        share = fmin(fmax(share - gap / slope, 0.5 * share), fmin(2 * share, 1.0));
    }
    return DONE;
}

/* Make a solved part the state in ``out``; m contacts took part. */
static int taken(System *s, Contacts *c, double *p, Block now, Block out, int m, double length, double h)
{
    double e[4], before = c->energy, springs = c->springs, t = *now.t;
    int verdict;

    /* works by what was evaluated in the middle, which finding the touch has left behind */
    for (int i = 0; i < s->nv; i++) {
        c->xi[i] = 0.5 * (now.v[i] + out.v[i]);
        out.a[i] = (out.v[i] - now.v[i]) / length;
    }

    memcpy(c->kept, out.lam, s->rows * sizeof(double));
    for (int i = 0; i < s->nv; i++) s->work[i] = 0.5 * length * c->xi[i];
    configuration(s, now.q, s->work, out.q);
    if (c->loaded && s->samples && s->python(SAMPLE, 0, t + 0.5 * length)) return FAILED;
    if (c->loaded || s->rows) verdict = evaluate(s, out.q, c->xi, out.a, out.lam, t + 0.5 * length);
    else verdict = place(s, out.q, c->xi);
    if (verdict) return verdict;
    for (int i = 0; i < s->nv; i++) c->xi[i] *= length;
    add_works(s, c, now, out, c->xi, c->closed, m, c->kept, length);

    configuration(s, now.q, c->xi, c->ahead);
    memcpy(out.q, c->ahead, s->nq * sizeof(double));
    if ((verdict = closed_rows(s, c, p, out.q, out.v, t + length))) return verdict;
    if (touch(c, out.q, t + length, &c->aside)) return LOOK;
    if ((verdict = place(s, out.q, out.v))) return verdict;
    if (s->rows) {
        closed_rates(s, c, out.v);
        for (int i = 0; i < s->nv; i++) out.a[i] = (out.v[i] - now.v[i]) / length;
        if ((verdict = place(s, out.q, out.v))) return verdict;
    }

    *out.t = t + length;
    energies(s, t + length, out.q, out.v, s->rest_gravity, e);
    c->energy = e[0] + e[1] + e[2] + e[3];
    c->springs = e[3];
    c->works[4] += c->energy - before;
    if (c->loaded) c->works[2] += c->springs - springs, c->works[4] -= c->springs - springs;
    take_forces(c, m, length, h);
    c->time = t + 0.5 * length;
    c->total += c->done;

    for (int i = 0; i < s->nv; i++) s->work[i] = out.a[i] - now.a[i];
    c->last = m ? 0.0 : length * length / 12.0 * largest_of(s->units, s->work, s->nv);
    Touch last = c->now;
    c->now = c->aside;
    c->aside = last;
    return DONE;
}
