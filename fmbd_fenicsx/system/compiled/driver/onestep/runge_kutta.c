/* Steps of the explicit and of the half-explicit Runge-Kutta method, schemes/onestep/explicit_stepper.py: constant ones, and those that
   error control chooses, many in one call (march.c). */

/* What Python lends of a method. */
typedef struct {
    int stages;
    double nothing;                    /* a way (m) that counts as none */
    const double *c, *A;               /* nodes, and rows with the weights last */
    struct OwnSteps *own;              /* where error control chooses the steps, NULL: they are constant; the formulas of the error */
                                       /* are rows of its weights */
    Norm norm;
    double *work;
} Explicit;

/* The slopes of a step, stages x nv each; xi, where they lead; room to work in. */
typedef struct {
    double *rates, *pushes, *xi, *rest;
} Slopes;

/* A method: the stages of a step from a state on, xi and v at their end; their error over the tolerance, before the end is closed. */
typedef struct {
    int (*stages)(System *s, double *p, const Explicit *o, const Block *now, const Slopes *e, Block out);
    int (*error)(System *s, const Explicit *o, double h, const Slopes *e, Block out, double *error);
} Method;

static const double THIRD = 0.01; /* weight of the square of the error of order three beside those of higher orders */

/* The errors of xi and v by one of the formulas. */
static void missed_by(const System *s, const Explicit *o, int formula, double h, const Slopes *e, double *places, double *speeds)
{
    const double *weights = o->own->error + formula * o->stages;
    memset(places, 0, s->nv * sizeof(double));
    memset(speeds, 0, s->nv * sizeof(double));
    for (int i = 0; i < o->stages; i++) {
        add(places, h * weights[i], e->rates + (long)i * s->nv, s->nv);
        add(speeds, h * weights[i], e->pushes + (long)i * s->nv, s->nv);
    }
}

static int runge_kutta_stages(System *s, double *p, const Explicit *o, const Block *now, const Slopes *e, Block out)
{
    memcpy(e->rates, now->v, s->nv * sizeof(double));
    memcpy(e->pushes, now->a, s->nv * sizeof(double));
    return all_stages(s, o->stages, *now->t, p[H], p[LENGTH], o->c, o->A, now->q, now->v, e->rates, e->pushes, e->xi, out.v, e->rest);
}

/* By the formulas of orders five, six and three. */
static int runge_kutta_error(System *s, const Explicit *o, double h, const Slopes *e, Block out, double *error)
{
    double *places = e->rest, *speeds = places + s->nv, found[3];
    const double *parts[2] = {places, speeds};
    (void)out;
    for (int i = 0; i < 3; i++) {
        missed_by(s, o, i, h, e, places, speeds);
        found[i] = own_norm(s, &o->norm, parts, 2);
    }
    const double high = worse(found[0], found[1]), third = found[2];
    *error = high == 0.0 ? 0.0 : high * high / sqrt(high * high + THIRD * third * third);
    return DONE;
}

static int half_explicit_stages(System *s, double *p, const Explicit *o, const Block *now, const Slopes *e, Block out)
{
    const double h = p[H], nothing = o->nothing / (h * h);
    long solves = 0;
    memcpy(out.a, now->a, s->nv * sizeof(double));
    memcpy(out.lam, now->lam, s->rows * sizeof(double));
    int verdict = all_half_stages(s, o->stages, *now->t, h, nothing, o->c, o->A, now->q, now->v, out.a, out.lam, e->rates, e->pushes,
                                  e->xi, out.v, &solves, e->rest);
    p[ITERATIONS] += solves;
    return verdict;
}

/* Rows of the constraints on a motion x, like v, where frames are placed, into slip. */
static void rows_on(System *s, const double *x)
{
    turn_velocity(s, x);
    slips(s, 1); /* rows as they are now */
    slips(s, 0);
}

/* Stage multipliers are of low order: their share of the difference lies across the constraints and is projected out, but for what
   places miss these by, an error of the step's own. */
static int half_explicit_error(System *s, const Explicit *o, double h, const Slopes *e, Block out, double *error)
{
    double *places = e->rest, *speeds = places + s->nv, *x = speeds + s->nv, *open = x + s->nv, *rest = open + s->rows, asked = NAN;
    const double *parts[2] = {places, speeds};
    int verdict;
    missed_by(s, o, 0, h, e, places, speeds);

    if (s->rows) {
        if ((verdict = sample(s, *out.t, &asked)) || (verdict = look_at(s, 0, 1, 0.0, 0.0, *out.t, out.q, out.v, rest))) return verdict;
        memcpy(open, s->gap, s->rows * sizeof(double));
        rows_on(s, places);
        add(open, 1.0, s->slip, s->rows);
        for (const Batch *k = s->batch; k < s->batch + s->batches; k++) /* rows on velocities hold no places: errors of these stay */
            for (long i = 0; k->role == ROW && k->flow && i < k->n; i++) open[k->row[i]] = 0.0;
        closing_change(s, open, x, rest);
        add(places, 1.0, x, s->nv);

        rows_on(s, speeds);
        memcpy(open, s->slip, s->rows * sizeof(double));
        closing_change(s, open, x, rest);
        add(speeds, 1.0, x, s->nv);
    }
    *error = own_norm(s, &o->norm, parts, 2);
    return DONE;
}

static const Method RUNGE_KUTTA_METHOD = {runge_kutta_stages, runge_kutta_error};
static const Method HALF_EXPLICIT_METHOD = {half_explicit_stages, half_explicit_error};

/* The end of a step, q and v moved onto the constraints, q by ``way``, with a and lambda there. */
static int end_step(System *s, const double *p, Block out, double *way, double *room)
{
    double last = NAN;
    if (s->rows) return arrive_at(s, 1, *out.t, p[LENGTH], out.q, out.v, out.a, out.lam, way, room);
    memset(way, 0, s->nv * sizeof(double));
    int verdict = sample(s, *out.t, &last);
    return verdict ? verdict : accelerate(s, *out.t, p[LENGTH], out.q, out.v, out.a, out.lam, room, 0);
}

/* Where the stages of a step of p[H] lead. */
static int where_stages_lead(System *s, double *p, const Explicit *o, const Method *method, const Block *now, const Slopes *e, Block out)
{
    int verdict = method->stages(s, p, o, now, e, out);
    if (verdict) return verdict;
    configuration(s, now->q, e->xi, out.q);
    *out.t = *now->t + p[H];
    return DONE;
}

/* A step of a size that passes, up to its end. Stages follow accelerations alone: what places miss the constraints by is an error too, all
   that tells of a kink of a drive. */
static int passing_step(System *s, double *p, Explicit *o, const Method *method, const Block *now, const Slopes *e, Block out,
                          Passing *found)
{
    const OwnSteps *c = o->own;
    const double most = farthest_turn(s->bodies, c->turn, 1.0, now);
    int verdict = take_bases(s, &o->norm, now->q, now->v);
    if (verdict) return verdict;

    for (;;) {
        if ((verdict = own_size(c, now, found->proposed, most, p + H))) return verdict;
        o->norm.h = p[H];
        take_sizes(s, c, &o->norm, now);
        if ((verdict = where_stages_lead(s, p, o, method, now, e, out)) == NEWTON && failed_size(c, p[H], DIVERGES, found)) continue;
        if (verdict) return verdict;
        if (turn_too_far(s, c, 1, e->xi)) return NEWTON;
        if ((verdict = method->error(s, o, p[H], e, out, &found->error))) return verdict;
        if (lets_pass(c, found)) {
            const double *const closed[1] = {e->xi};
            if ((verdict = end_step(s, p, out, e->xi, e->rest))) return verdict;
            found->error = worse(found->error, own_norm(s, &o->norm, closed, 1));
            if (lets_pass(c, found)) return DONE;
        }
        if (!refused_size(c, now, p[H], c->order, found)) return NEWTON;
    }
}

/* One step of the size that error control chooses. */
static int own_explicit_step(System *s, double *p, Explicit *o, const Method *method, const Block *now, const Slopes *e, Block out)
{
    OwnSteps *c = o->own;
    const Controlled *last = (const Controlled *)now->own;
    Controlled *made = (Controlled *)out.own;
    Passing found = {.proposed = proposal(c, last->next)};
    if (!(left_for(c, now) > 0.0) || *now->t > c->last) return SIZE;
    int verdict = passing_step(s, p, o, method, now, e, out, &found);
    if (verdict) return verdict;

    /* a step cut short by the end tells nothing of the next one */
    const double h = p[H], next = accepted_size(c, last, made, h, &found, 1.0);
    made->next = h >= found.proposed || next < h ? next : found.proposed;
    note_passing(c, &found);
    return DONE;
}

/* One step by a method. */
static int explicit_step(System *s, double *p, Explicit *o, const Method *method, const Block *now, const Slopes *e, Block out)
{
    if (o->own) return own_explicit_step(s, p, o, method, now, e, out);
    memset(out.own, 0, CONTROLLED * sizeof(double));
    int verdict = where_stages_lead(s, p, o, method, now, e, out);
    return verdict ? verdict : end_step(s, p, out, e->xi, e->rest);
}

static Explicit *explicit_in(double *room)
{
    Explicit *o;
    memcpy(&o, room, sizeof o);
    return o;
}

/* As Makers of march.c. What a state keeps: of error control; of the explicit method the slopes that led to it. */
static int runge_kutta_step(System *s, double *p, double *room, const Block *past, int known, Block out)
{
    Explicit *o = explicit_in(room);
    double *rates = out.own + CONTROLLED;
    const Slopes slopes = {rates, rates + (long)o->stages * s->nv, o->work, o->work + s->nv};
    (void)known;
    return explicit_step(s, p, o, &RUNGE_KUTTA_METHOD, past, &slopes, out);
}

static int half_explicit_step(System *s, double *p, double *room, const Block *past, int known, Block out)
{
    Explicit *o = explicit_in(room);
    const long slopes_size = (long)o->stages * s->nv;
    double *xi = o->work + 2 * slopes_size;
    const Slopes slopes = {o->work, o->work + slopes_size, xi, xi + s->nv};
    (void)known;
    return explicit_step(s, p, o, &HALF_EXPLICIT_METHOD, past, &slopes, out);
}
