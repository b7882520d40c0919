/* Constant steps of the explicit and of the half-explicit Runge-Kutta method, schemes/onestep/explicit_stepper.py: many in one call
   (march.c). Their room begins with the number of stages, the way (m) that counts as none, nodes c and rows A. */

typedef struct {
    int stages;
    double nothing;
    const double *c, *A;
    double *rest;
} Tableau;

/* The tableau in a room, with so many nodes more than stages. */
static Tableau tableau_in(double *room, int more)
{
    const int stages = (int)room[0], nodes = stages + more;
    Tableau o = {stages, room[1], room + 2, room + 2 + nodes, room + 2 + nodes + (stages + 1) * stages};
    return o;
}

/* The end of a step, q and v moved onto the constraints, with a and lambda there. */
static int end_step(System *s, const double *p, Block out, double *room)
{
    double last = NAN;
    if (s->rows) return driver_arrive(s, 1, *out.t, p[LENGTH], out.q, out.v, out.a, out.lam, room);
    int verdict = sample(s, *out.t, &last);
    return verdict ? verdict : accelerate(s, *out.t, p[LENGTH], out.q, out.v, out.a, out.lam, room, 0);
}

/* One step of the explicit method, as a Maker of march.c; a state keeps the rates and accelerations of the stages that led to it.
   Room beside the tableau: nv, and that of driver_stages(). */
static int runge_kutta_step(System *s, double *p, double *room, const Block *past, int known, Block out)
{
    const Tableau o = tableau_in(room, 0);
    const Block now = past[0];
    double *rates = out.own, *pushes = rates + (long)o.stages * s->nv, *xi = o.rest, *rest = xi + s->nv;
    (void)known;

    memcpy(rates, now.v, s->nv * sizeof(double));
    memcpy(pushes, now.a, s->nv * sizeof(double));
    int verdict = driver_stages(s, o.stages, *now.t, p[H], p[LENGTH], o.c, o.A, now.q, now.v, rates, pushes, xi, out.v, rest);
    if (verdict) return verdict;
    configuration(s, now.q, xi, out.q);
    *out.t = *now.t + p[H];
    return end_step(s, p, out, rest);
}

/* One step of the half-explicit method, likewise; room: (2 stages + 1) nv, and that of driver_half_stages() or of driver_arrive(). */
static int half_explicit_step(System *s, double *p, double *room, const Block *past, int known, Block out)
{
    const Tableau o = tableau_in(room, 1);
    const Block now = past[0];
    const double h = p[H], nothing = o.nothing / (h * h);
    double *rates = o.rest, *pushes = rates + (long)o.stages * s->nv, *xi = pushes + (long)o.stages * s->nv, *rest = xi + s->nv;
    long solves = 0;
    (void)known;

    memcpy(out.a, now.a, s->nv * sizeof(double));
    memcpy(out.lam, now.lam, s->rows * sizeof(double));
    int verdict = driver_half_stages(s, o.stages, *now.t, h, nothing, o.c, o.A, now.q, now.v, out.a, out.lam, rates, pushes, xi, out.v,
                                     &solves, rest);
    if (verdict) return verdict;
    configuration(s, now.q, xi, out.q);
    *out.t = *now.t + h;
    p[ITERATIONS] += solves;
    return end_step(s, p, out, rest);
}
