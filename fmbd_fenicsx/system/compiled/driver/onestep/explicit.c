/* What explicit schemes need of a system, whose matrix is that of the masses: accelerations, states on the constraints, the
   stages of a Runge-Kutta method, and those of a half-explicit one. */

enum { REFINED = 12, CLOSED = 12, HALF = 50 }; /* iterations */
static const double SAME_FORCES = 1e-8; /* share that the smallest multipliers may lack of the forces of others */
static const double AT_REST = 1e-13; /* of the forces, that the balance may lack */
static const double CONTRADICTS = 1e-8; /* of the accelerations, that rows may ask for otherwise than those they depend on */
static const double BESIDE = 10.0; /* times as much as a state beside the constraints lets them ask for otherwise */

/* The largest of forces like v, moments as forces at the model's length. */
static double largest_force(const System *s, const double *f)
{
    double found = 0.0;
    for (int i = 0; i < s->nv; i++)
        if (found == found && !(fabs(f[i]) <= found * s->units[i])) found = fabs(f[i]) / s->units[i]; /* nan stays */
    return found;
}

/* The largest force that the balance evaluated last lacks; on the nodes of fields too. ``x``: room, like v. */
static double missing(const System *s, double *x)
{
    like_v(s, s->residual, x);
    return largest_force(s, x);
}

/* The largest acceleration that the forces on the nodes of a field would give to one of them by itself. */
static double nodes_alone(const Field *e)
{
    double largest = 0.0;
    for (long i = 0; i < e->nodes; i++)
        for (int k = e->M_start[i]; k < e->M_start[i + 1]; k++)
            for (int j = 0; e->M_column[k] == i && e->M[k] > 0.0 && j < D; j++)
                largest = fmax(largest, fabs(e->force[D * i + j]) / e->M[k]);
    return largest;
}

/* The largest acceleration that the forces evaluated last would give to an unknown by itself; the matrix is assembled. */
static double alone(const System *s)
{
    double largest = 0.0;
    for (int b = 0; b < s->bodies; b++) {
        const Body *o = s->body + b;
        for (int j = 0; j < TWIST + o->modes; j++) {
            double unit = s->units[j < TWIST ? TWIST * b + j : o->at_v + j - TWIST], mass = s->diagonal[o->at_u + j];
            if (mass > 0.0) largest = fmax(largest, unit * fabs(s->residual[o->at_u + j]) / mass);
        }
        if (o->field) largest = fmax(largest, nodes_alone(o->field));
    }
    return largest;
}

/* a and lambda at (t, q, v), the third of (1) in schemes/consistent.py, by iterations down to roundoff. ``room``: 2 nv + 3 rows + nu.
   ``factored``: whether the matrix of the masses is, at this q. NEWTON where dependent rows contradict each other. */
static int accelerate(System *s, double t, double length, const double *q, const double *v, double *a, double *lam, double *room,
                      int factored)
{
    double *x = room, *y = x + s->nv, *second = y + s->rows, *partial = second + s->rows, *world = partial + s->rows;
    double fastest = largest_of(s->units, v, s->nv), forces = 0.0, gap = 0.0, slip = 0.0, allowed = 0.0, last = INFINITY;
    int verdict = place(s, q, v);
    if (verdict) return verdict;

    if (s->redundant) {
        drift(s);
        gap = largest_of(s->row_units, s->gap, s->rows), slip = largest_of(s->row_units, s->slip, s->rows);
    }
    derivatives_in_time(s, partial, second);
    memset(a, 0, s->nv * sizeof(double));
    memset(lam, 0, s->rows * sizeof(double));
    memset(world, 0, s->nu * sizeof(double));

    for (int k = 0; k < REFINED; k++) {
        if ((verdict = evaluate(s, q, v, a, lam, t))) return verdict;
        double left = missing(s, x);
        if (k == 0) forces = left;
        int settled = k > 0 && left <= AT_REST * forces;
        if (settled && !s->redundant) return DONE;
        if (k == 0 && !factored && (verdict = prepare(s, q, 0.0, 0.0, lam, 0, t))) return verdict;

        /* what is open: the balance, and G a + g'' - G a of the accelerations found so far */
        if (s->surfaces || s->redundant) turn_velocity(s, a);
        else memcpy(s->velocity, world, s->nu * sizeof(double));
        slips(s, 0);
        for (int i = 0; i < s->nu; i++) s->b[i] = -s->residual[i];
        for (int i = 0; i < s->rows; i++) s->b[s->nu + i] = -(s->slip[i] + second[i]);
        if (k == 0 && s->redundant) {
            double typical = fmax(alone(s), fastest * fastest / length);
            allowed = CONTRADICTS * typical + BESIDE * (gap * typical + slip * fastest) / length;
        }

        if (k > 0 && s->redundant && !(largest_of(s->row_units, s->b + s->nu, s->rows) <= allowed)) return NEWTON;
        if (settled) return DONE;
        if ((verdict = with_all_rows(s, 1.0, x, y, t))) return verdict;

        add(world, 1.0, s->b, s->nu);
        add(a, 1.0, x, s->nv);
        add(lam, 1.0, y, s->rows);
        double size = largest_of(s->units, x, s->nv), largest = largest_of(s->units, a, s->nv);
        if (!(size < INFINITY)) return NEWTON;
        int stalled = size > 0.5 * last && last <= 1e-8 * fmax(largest, fastest * fastest / length);
        if ((stalled || size <= 1e-11 * largest) && (!s->redundant || k > 0)) return DONE;
        last = size;
    }
    return NEWTON;
}

EXPORT int driver_accelerate(System *s, int factored, double t, double length, const double *q, const double *v, double *a,
                             double *lam, double *room)
{
    double last = NAN;
    int verdict = sample(s, t, &last);
    return verdict ? verdict : accelerate(s, t, length, q, v, a, lam, room, factored);
}

/* Of multipliers with the same forces in a configuration the smallest, in place, count x rows: those by which the masses bear these
   forces at rest. NEWTON where the forces are not the same, since rows nearly depend. ``room``: 2 nv + rows. */
EXPORT int driver_least(System *s, int factored, double t, long count, const double *q, double *lam, double *room)
{
    double *push = room, *x = push + s->nv, *y = x + s->nv, *least = s->directions + CLOSING * s->parts * s->rows, last = NAN;
    int verdict = sample(s, t, &last);
    memset(x, 0, s->nv * sizeof(double));
    if (verdict || (verdict = place(s, q, x))) return verdict;
    openings(s, 1);
    if (!factored && (verdict = prepare(s, q, 0.0, 0.0, lam, 0, t))) return verdict;

    for (long i = 0; i < count; i++, lam += s->rows) {
        all_rows(s, lam, push);
        const double forces = largest_force(s, push);
        double missed = forces;
        memset(least, 0, s->rows * sizeof(double));
        do { /* again with what a solution lacks, while that becomes less */
            const double before = missed;
            turn_velocity(s, push);
            memcpy(s->b, s->velocity, s->nu * sizeof(double));
            memset(s->b + s->nu, 0, s->rows * sizeof(double));
            if ((verdict = with_all_rows(s, 0.0, x, y, t))) return verdict;

            add(least, 1.0, y, s->rows);
            add(lam, -1.0, y, s->rows);
            all_rows(s, lam, push);
            missed = largest_force(s, push);
            if (!(missed <= SAME_FORCES * forces || missed < 0.5 * before)) return NEWTON;
        } while (missed > SAME_FORCES * forces);
        memcpy(lam, least, s->rows * sizeof(double));
    }
    return DONE;
}

/* The smallest change of twists, in the metric of the factor at hand, that closes the rows by ``open``. */
static double closing_change(System *s, const double *open, double *x, double *y)
{
    memset(s->b, 0, s->nu * sizeof(double));
    for (int i = 0; i < s->rows; i++) s->b[s->nu + i] = -open[i];
    with_all_rows(s, 0.0, x, y, 0.0);
    return largest_of(s->units, x, s->nv);
}

/* What rows leave open at a state, the gaps alone where ``places``, and, ``anew``, the factor of M + cd C + ck K there, without
   reactions. ``room``: nv + rows. */
static int look_at(System *s, int places, int anew, double cd, double ck, double t, const double *q, const double *v, double *room)
{
    const int strained = cd != 0.0 || ck != 0.0;
    int verdict;
    memset(room, 0, (s->nv + s->rows) * sizeof(double));
    if (anew && strained && (verdict = evaluate(s, q, v, room, room + s->nv, t))) return verdict;
    if ((verdict = place(s, q, v))) return verdict;
    if (places) openings(s, 1);
    else drift(s);
    return anew ? prepare(s, q, cd, ck, room + s->nv, 0, t) : DONE;
}

/* q (``places``), then v, moved onto the constraints in the metric of M + cd C + ck K, as project() of schemes/consistent.py. The factor
   of the first configuration serves as long as each correction is a hundred times smaller than the one before. Far from the origin, and
   after many turns, places are known to less than a share of the length: corrections that fall no more are roundoff. ``way``: by how much
   q was moved, like v, NULL: nobody asks. ``room``: nv + rows + nq. */
static int close_rows(System *s, int places, double t, double length, double cd, double ck, double *q, double *v, double *way, double *room)
{
    double *x = room, *y = x + s->nv, *moved = y + s->rows, asked = NAN, last = INFINITY, size;
    int verdict = sample(s, t, &asked), anew = 1;
    if (verdict) return verdict;
    if (way) memset(way, 0, s->nv * sizeof(double));

    for (int k = 0; places && k < CLOSED; k++) {
        if ((verdict = look_at(s, 1, anew, cd, ck, t, q, v, room))) return verdict;
        size = closing_change(s, s->gap, x, y);
        if (!(size < INFINITY)) return NEWTON;
        configuration(s, q, x, moved);
        if (way) add(way, 1.0, x, s->nv);
        memcpy(q, moved, s->nq * sizeof(double));
        if (size <= 1e-13 * length || (size >= 0.5 * last && last <= 1e-8 * length)) break;
        if (k == CLOSED - 1) return NEWTON;
        anew = size > 1e-2 * last;
        last = size;
    }

    last = INFINITY;
    for (int k = 0; k < CLOSED; k++) {
        if ((verdict = look_at(s, 0, anew, cd, ck, t, q, v, room))) return verdict;
        size = closing_change(s, s->slip, x, y);
        if (!(size < INFINITY)) return NEWTON;
        add(v, 1.0, x, s->nv);
        if (size <= 1e-14 * largest_of(s->units, v, s->nv) || size >= 0.5 * last) return DONE;
        anew = size > 1e-2 * last;
        last = size;
    }
    return NEWTON;
}

EXPORT int driver_close(System *s, int places, double t, double length, double cd, double ck, double *q, double *v, double *room)
{
    return close_rows(s, places, t, length, cd, ck, q, v, NULL, room);
}

/* a and lambda nearer to the balance and to G a + g'' = 0 at (t, q, v), as corrected() of schemes/consistent.py: by one increment in the
   metric of M + cd C + ck K; what depends on time only is known. ``room``: 3 nv + 3 rows. */
int correct(System *s, double t, double cd, double ck, const double *q, const double *v, double *a, double *lam, double *room)
{
    double *x = room, *y = x + s->nv, *second = y + s->rows, *partial = second + s->rows, *none = partial + s->rows;
    int verdict = place(s, q, v);
    if (verdict) return verdict;
    derivatives_in_time(s, partial, second);
    memset(none, 0, s->nv * sizeof(double));
    memset(y, 0, s->rows * sizeof(double));
    if ((verdict = evaluate(s, q, v, none, y, t)) || (verdict = prepare(s, q, cd, ck, y, 0, t))) return verdict;
    if ((verdict = evaluate(s, q, v, a, lam, t))) return verdict;

    turn_velocity(s, a);
    slips(s, 0);
    for (int i = 0; i < s->nu; i++) s->b[i] = -s->residual[i];
    for (int i = 0; i < s->rows; i++) s->b[s->nu + i] = -(s->slip[i] + second[i]);
    if ((verdict = with_all_rows(s, 1.0, x, y, t))) return verdict;
    add(a, 1.0, x, s->nv);
    add(lam, 1.0, y, s->rows);
    return DONE;
}

/* The same of so many states, one behind the other; ``weights``: cd and ck of each. */
EXPORT int driver_correct(System *s, long count, const double *t, const double *weights, const double *q, const double *v, double *a,
                          double *lam, double *room)
{
    double last = NAN;
    int verdict = DONE;
    for (long i = 0; i < count && !verdict; i++, q += s->nq, v += s->nv, a += s->nv, lam += s->rows)
        if (!(verdict = sample(s, t[i], &last))) verdict = correct(s, t[i], weights[2 * i], weights[2 * i + 1], q, v, a, lam, room);
    return verdict;
}

/* The end of a step: q and v moved onto the constraints, then a and lambda there; ``way`` and ``room`` as of both. */
static int arrive_at(System *s, int places, double t, double length, double *q, double *v, double *a, double *lam, double *way,
                     double *room)
{
    int verdict = close_rows(s, places, t, length, 0.0, 0.0, q, v, way, room);
    return verdict ? verdict : accelerate(s, t, length, q, v, a, lam, room, 0);
}

EXPORT int driver_arrive(System *s, int places, double t, double length, double *q, double *v, double *a, double *lam, double *room)
{
    return arrive_at(s, places, t, length, q, v, a, lam, NULL, room);
}

/* The stages of an explicit Runge-Kutta method in local coordinates xi about q0, whose rates and accelerations (stages x nv) are
   known for the first; xi and v: the end of the step, by the last row of A, (stages + 1) x stages. ``room``: nq + 2 nv + 4 rows + nu. */
static int all_stages(System *s, int stages, double t, double h, double length, const double *c, const double *A,
                      const double *q0, const double *v0, double *rates, double *pushes, double *xi, double *v, double *room)
{
    double *q = room, *lam = q + s->nq, *rest = lam + s->rows, last = NAN;
    int verdict;

    for (int i = 1; i <= stages; i++) {
        memset(xi, 0, s->nv * sizeof(double));
        memcpy(v, v0, s->nv * sizeof(double));
        for (int j = 0; j < i; j++) {
            double share = h * A[i * stages + j];
            if (share == 0.0) continue;
            add(xi, share, rates + (long)j * s->nv, s->nv);
            add(v, share, pushes + (long)j * s->nv, s->nv);
        }
        if (i == stages) break;

        configuration(s, q0, xi, q);
        if ((verdict = sample(s, t + c[i] * h, &last))) return verdict;
        if ((verdict = accelerate(s, t + c[i] * h, length, q, v, pushes + (long)i * s->nv, lam, rest, 0))) return verdict;
        double *rate = rates + (long)i * s->nv;
        memcpy(rate, v, s->nv * sizeof(double));
        for (int b = 0; b < s->bodies; b++) rate_of(xi + TWIST * b, rate + TWIST * b);
    }
    return DONE;
}

/* Share of the model's length that increments of a step's accelerations would move something by, which are none: bodies that are
   held, or turn evenly, have no accelerations beside roundoff. */
static const double MOVES_NOTHING = 1e-14;
static const double SPEEDS = 4e-15; /* share of velocities that they are known to */

/* A stage: accelerations a and multipliers lambda whose balance holds at one place, and whose rows hold at another:

     M a + f(q, v + b a) + G^T lambda = 0    at times[0]                                                             (1)
     G (known + c a) + g_t = 0  at q = after,    or    g(after o exp(known + c a)) = 0,    at times[1]                (2) */
typedef struct {
    const double *times, *q, *v, *after, *known;
    double b, c;
    double damp, nothing;    /* weight of damping in the matrix; below which an increment counts as none */
    double tolerance;        /* of accelerations, where the iteration is not to end in roundoff */
    int on_places, factored; /* the second of (2); whether the matrix is factored already */
} Stage;

/* 1 where increments have come down to roundoff, -1 where they grow, 0 to go on. */
static int at_roundoff(double size, double last, double scale, double nothing)
{
    int stalled = size >= 0.5 * last && size <= 1e-9 * scale;
    if (stalled || size <= fmax(1e-13 * scale, nothing)) return 1;
    return !(size < INFINITY) || size > 2.0 * last ? -1 : 0;
}

/* The rates of (2) that a stage leaves open, or its places. */
static int open_rows(System *s, const Stage *o, const double *a, double *change, double *moved, double *open)
{
    int verdict;
    memcpy(change, o->known, s->nv * sizeof(double));
    add(change, o->c, a, s->nv);
    if (o->on_places) configuration(s, o->after, change, moved);
    if ((verdict = o->on_places ? place(s, moved, o->v) : place(s, o->after, change))) return verdict;
    if (o->on_places) openings(s, 1);
    else slips(s, 1);
    memcpy(open, o->on_places ? s->gap : s->slip, s->rows * sizeof(double));
    return DONE;
}

/* What depends on time only, at both times of a stage: iterations change between them. */
static int sample_both(System *s, const double *times)
{
    double last = NAN;
    for (int end = 1; end >= 0; end--) { /* the first is left in its place */
        int verdict = sample(s, times[end], &last);
        if (verdict) return verdict;
        keep_sample(s, s->sampled[end], 0);
    }
    return DONE;
}

/* a and lambda, which begin as a guess, by Newton's iteration with the matrix at q: to the tolerance by the parameters p of a
   march, or (NULL) to roundoff. Of a balance that is linear in both an increment leaves nothing: it is evaluated once more at the
   end. ``solves`` counts. ``room``: 2 nv + 2 rows + nq. */
static int solve_stage(System *s, const Stage *o, double *p, double *a, double *lam, long *solves, double *room)
{
    double *x = room, *speeds = x + s->nv, *y = speeds + s->nv, *open = y + s->rows, *moved = open + s->rows;
    double last = INFINITY, left = 0.0, sizes[MOST];
    double nothing = fmax(o->nothing, SPEEDS * largest_of(s->units, o->known, s->nv) / o->c);
    int verdict, most = p ? (int)fmin(p[MAXIT], MOST) : HALF, linear = !p && !s->fields && o->b == 0.0;

    if (s->redundant) memset(lam, 0, s->rows * sizeof(double)); /* the smallest follow from none */
    if ((verdict = sample_both(s, o->times))) return verdict;

    for (int k = 0; k < most; k++) {
        if ((verdict = recall_sample(s, s->sampled[1], o->times[1]))) return verdict;
        if ((verdict = open_rows(s, o, a, speeds, moved, open))) return verdict;
        if ((verdict = recall_sample(s, s->sampled[0], o->times[0]))) return verdict;
        memcpy(speeds, o->v, s->nv * sizeof(double));
        add(speeds, o->b, a, s->nv);
        const int balanced = k && linear;
        verdict = balanced ? place(s, o->q, speeds) : evaluate(s, o->q, speeds, a, lam, o->times[0]);
        if (verdict) return verdict;
        if (k == 0 && !o->factored && (verdict = prepare(s, o->q, o->damp, 0.0, lam, 0, o->times[0]))) return verdict;

        for (int i = 0; i < s->nu; i++) s->b[i] = balanced ? 0.0 : -s->residual[i];
        for (int i = 0; i < s->rows; i++) s->b[s->nu + i] = -open[i] / o->c;
        if ((verdict = with_all_rows(s, 1.0, x, y, o->times[0]))) return verdict;
        add(a, 1.0, x, s->nv);
        add(lam, 1.0, y, s->rows);
        (*solves)++;

        double size = largest_of(s->units, x, s->nv);
        int ended;
        if (p) {
            sizes[k] = size / o->tolerance;
            ended = judge(p, sizes, k + 1, &left);
            if (s->fields && lingers(p, k + 1, left)) return NEWTON; /* new tangents are Python's */
        } else ended = at_roundoff(size, last, fmax(largest_of(s->units, a, s->nv), 1e-300), nothing);
        if (ended < 0) return NEWTON;

        if (ended && !balanced) {
            if (p) p[LEFT] += left;
            return DONE;
        }
        if (ended) linear = 0;
        last = ended ? INFINITY : size;
    }
    return NEWTON;
}

/* All stages of a half-explicit method in local coordinates xi about q0, (1) and (2) of schemes/onestep/half_explicit.py, with the nodes
   c (stages + 1) and A, (stages + 1) x stages. a and lambda begin as a guess and end as those of the last stage; rates and pushes:
   stages x nv; xi and v: the end of the step. ``room``: 2 nq + nv and that of a stage. */
static int all_half_stages(System *s, int stages, double t, double h, double nothing, const double *c, const double *A,
                           const double *q0, const double *v0, double *a, double *lam, double *rates, double *pushes, double *xi,
                           double *v, long *solves, double *room)
{
    double *q = room, *after = q + s->nq, *known = after + s->nq, *rest = known + s->nv;
    int verdict;

    memset(xi, 0, s->nv * sizeof(double));
    memcpy(v, v0, s->nv * sizeof(double));
    for (int i = 0; i < stages; i++) {
        const double *share = A + (i + 1) * stages;
        double *rate = rates + (long)i * s->nv, times[2] = {t + h * c[i], t + h * c[i + 1]};
        memcpy(rate, v, s->nv * sizeof(double));
        for (int b = 0; b < s->bodies; b++) rate_of(xi + TWIST * b, rate + TWIST * b);
        configuration(s, q0, xi, q);

        /* where the next stage is, and its velocity without this one */
        memset(xi, 0, s->nv * sizeof(double));
        memcpy(known, v0, s->nv * sizeof(double));
        for (int j = 0; j <= i; j++) add(xi, h * share[j], rates + (long)j * s->nv, s->nv);
        for (int j = 0; j < i; j++) add(known, h * share[j], pushes + (long)j * s->nv, s->nv);
        configuration(s, q0, xi, after);

        Stage one = {times, q, v, after, known, 0.0, h * share[i], 0.0, nothing, 0.0, 0, 0};
        if ((verdict = solve_stage(s, &one, NULL, a, lam, solves, rest))) return verdict;
        memcpy(pushes + (long)i * s->nv, a, s->nv * sizeof(double));
        memcpy(v, known, s->nv * sizeof(double));
        add(v, h * share[i], a, s->nv);
    }
    return DONE;
}
