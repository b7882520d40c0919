/* Slips that turn about in a flight, as schemes/impacts/slip_turns.py has them. */

static const double STOPPED = 1e-6, RESTS = 1e-4, ON = 1e4; /* as in slip_turns.py */
enum { COUPLED = 8 };

/* Whether the slip of the closed contact k has stopped at the end of a flight of a length with the velocities v. */
static int stops(const Contacts *c, int k, const double *v, double length)
{
    const int d = c->components, i = c->closed[k];
    const double *start = c->slip + d * k, *row = c->rows + 2 * c->wide * d * k, *drift = c->drift + d * k;
    double left = 0.0;
    if (c->bouncing[i] || c->pair[c->of[i]].friction == 0.0 || c->pair[c->of[i]].shape == LIMIT) return 0;
    for (int a = 1; a < d; a++) left += start[a] * (along(c, i, row + 2 * c->wide * a, v) - drift[a] / length);
    const double size = dot(start + 1, start + 1, d - 1);
    return size > 0.0 && left <= STOPPED * size;
}

/* Slips at the end of the flight, in o->u, of those in group g that ``stop`` with ``more`` of their slip at its start; 1 where they are
   not found. */
static int slips_with(Contacts *c, Problem *o, int g, const int *stop, double more)
{
    const int d = c->components, from = c->graph.group[g];
    for (int k = 0; k < d * o->m; k++) {
        if (k % d == 0 || !stop[from + k / d]) continue;
        o->q[k] += more * c->slip[d * from + k];
        o->u[k] += more * c->slip[d * from + k];
    }
    return contact_forces(c, o, g) && frictional_forces(c, o);
}

/* Of the contacts of group g those that ``stop`` in a flight of a length and would slide through it from rest end it with what they win
   behind their stop, (2), which goes into their drift: whether there are such. Impulses are left as they are. */
static int turn_about(Contacts *c, int g, const int *stop, double length, double slow)
{
    const int d = c->components, from = c->graph.group[g];
    Problem o = problem_of(c, g);
    const size_t bytes = d * o.m * sizeof(double);
    double *held = c->old + d * from, *won = c->open + d * from, *drift = c->drift + d * from;
    const Tally tally = c->tally;
    memcpy(held, o.f, bytes);
    int found = !slips_with(c, &o, g, stop, -1.0), any = 0;
    memcpy(won, o.u, bytes);
    found = found && !slips_with(c, &o, g, stop, ON);
    memcpy(o.f, held, bytes);
    c->tally = tally; /* these are no forces of the step */

    for (int k = 0; k < d * o.m && found; k += d) {
        const double *slip = c->slip + d * from + k + 1, *u = won + k + 1;
        const double size = dot(slip, slip, d - 1), most = dot(u, u, d - 1), braked = ON * size - dot(slip, o.u + k + 1, d - 1);
        if (!stop[from + k / d] || most <= slow * slow || size <= RESTS * RESTS * most || braked <= size) continue;
        for (int a = 1; a < d; a++) drift[k + a] += length * (1.0 - size / braked) * won[k + a];
        any = 1;
    }
    return any;
}

/* The solved flight of a length once more, where slips of its m closed contacts turn about. */
static int turned(System *s, Contacts *c, double *p, Block now, Block out, int m, double length, double slow)
{
    int *stop = c->hits + c->points, any = 0;
    if (c->components == 1 || !m) return DONE;
    for (int k = 0; k < m; k++) stop[k] = stops(c, k, out.v, length);
    for (int g = 0; g < c->graph.groups; g++) {
        int some = 0;
        for (int k = c->graph.group[g]; k < c->graph.group[g + 1]; k++) some |= stop[k];
        if (some && c->graph.group[g + 1] - c->graph.group[g] <= COUPLED) any |= turn_about(c, g, stop, length, slow);
    }
    if (!any) return DONE;

    const double noted = p[LEFT], middle = *now.t + 0.5 * length;
    const int done = c->done;
    if (s->samples && s->python(SAMPLE, 0, middle)) return FAILED;
    if (velocities(s, c, p, now, out, m, length, length)) return solved(s, c, p, now, out, m, length, length); /* as it was */
    p[LEFT] = noted; /* that of the first iteration stands for both */
    c->done += done;
    return DONE;
}
