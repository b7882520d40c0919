/* Where in a flight slips turn about, as schemes/impacts/slip_turns.py finds it. */

static const double STOPPED = 1e-6, RESTS = 1e-4; /* as in slip_turns.py */
enum { TRIALS = 12 };

/* What is left of the slip of the closed contact k at the end of a flight of a length with the velocities v, along that at its start and
   as a share of it. */
static double slip_left(const Contacts *c, int k, const double *v, double length)
{
    const int d = c->components;
    const double *start = c->slip + d * k, *row = c->rows + 2 * c->wide * d * k, size = dot(start + 1, start + 1, d - 1);
    double left = 0.0;
    for (int a = 1; a < d; a++) left += start[a] * (along(c, c->closed[k], row + 2 * c->wide * a, v) - c->drift[d * k + a] / length);
    return size > 0.0 ? left / size : 1.0;
}

/* Of the contacts of group g that have stopped those stay in ``turns`` that would slide through the flight from rest. A share of it at
   which the first of them has stopped for sure, at most 1/2; 1: none turns. Impulses are left as they are. */
static double turning_of(Contacts *c, int g, double slow, int *turns)
{
    const int d = c->components, from = c->graph.group[g];
    Problem o = problem_of(c, g);
    double share = 1.0;
    memcpy(c->old, o.f, o.m * d * sizeof(double));
    for (int k = 0; k < o.m; k++) {
        for (int a = 1; a < d && turns[c->closed[from + k]]; a++) {
            o.q[k * d + a] -= c->slip[(from + k) * d + a];
            o.u[k * d + a] -= c->slip[(from + k) * d + a];
        }
    }

    const int found = !contact_forces(c, &o, g) || !frictional_forces(c, &o);
    for (int k = 0; k < o.m; k++) {
        int *turning = turns + c->closed[from + k];
        const double *start = c->slip + d * (from + k) + 1, *end = o.u + k * d + 1;
        const double slip = sqrt(dot(start, start, d - 1)), won = sqrt(dot(end, end, d - 1));
        *turning = *turning && found && won > slow && slip > RESTS * won;
        if (*turning) share = fmin(share, fmin(0.5, slip / won));
    }
    memcpy(o.f, c->old, o.m * d * sizeof(double));
    return share;
}

/* The same for all groups of a solved flight with m closed contacts. */
static double turning(Contacts *c, int m, const double *v, double length, double slow, int *turns)
{
    double share = 1.0;
    for (int k = 0; k < m; k++) {
        const int i = c->closed[k];
        const Pair *o = c->pair + c->of[i];
        turns[i] = !c->bouncing[i] && o->friction > 0.0 && o->shape != LIMIT && slip_left(c, k, v, length) <= STOPPED;
    }
    for (int g = 0; g < c->graph.groups; g++) {
        int stops = 0;
        for (int k = c->graph.group[g]; k < c->graph.group[g + 1]; k++) stops |= turns[c->closed[k]];
        if (stops) share = fmin(share, turning_of(c, g, slow, turns));
    }
    return share;
}

/* The solved flight once more, so that it ends where the first of its slips turns about; its length. */
static int turned(System *s, Contacts *c, double *p, Block now, Block out, int m, double *length, double slow)
{
    const double whole = *length;
    int *turns = c->hits + c->points, foretold = 0, verdict;
    if (c->components == 1 || !m) return DONE;

    double stopped = 1.0, share = turning(c, m, out.v, whole, slow, turns);
    for (int trial = 0; share < 1.0; trial++) {
        double left = 1.0;
        *length = share * whole;
        if ((verdict = solved(s, c, p, now, out, m, *length, *length))) return verdict;
        for (int k = 0; k < m; k++)
            if (turns[c->closed[k]]) left = fmin(left, slip_left(c, k, out.v, *length));
        if (trial == TRIALS || (foretold && left <= STOPPED)) break;

        /* slips end along straight lines */
        if ((foretold = left > STOPPED)) share = left < 1.0 ? fmin(stopped, (1.0 + RESTS) * share / (1.0 - left)) : stopped;
        else stopped = share, share *= 0.5;
    }
    return DONE;
}
