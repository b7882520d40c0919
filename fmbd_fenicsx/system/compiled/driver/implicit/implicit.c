/* What steps of Radau (radau.c) and BDF (bdf.c) have in common, many in one call (march.c): in local coordinates about the start of a
   step, for systems whose stage systems have patterns, or whose elastic fields have factors (field_steps.c). */

/* Coefficients are those of the scheme. */
typedef struct {
    Stages *stages;
    const Patterns *patterns;        /* NULL where there are fields, and data, masses and room of a tangent too */
    Convergence *convergence;        /* what it says of the scheme's iterations stays, the rest is of a step */
    double *data, *masses, *room, *mixed; /* of the tangent; of M; work of a tangent and of a step */
    double *directions;              /* work: data of G where a step keeps its normal directions */
    const double *c, *W, *values, *middle, *basis, *stage_basis; /* of Radau */
    int order, fresh;                /* of BDF, the largest; whether the tangent was taken in this step */
    double factored;                 /* size of step (Radau) or frequency (BDF) that the tangent is factored for, 0: none */
    double failed;                   /* increments of steps that failed */
    int projects, corrects;          /* whether ends are moved onto the constraints; and their accelerations and multipliers */
    struct OwnSteps *own;            /* where error control chooses the steps, NULL: they are constant; see own_steps.c */
    double rtol, floor, slow;        /* of Newton's increments; m; rate above which the next step takes a tangent */
    double longer, least_share;      /* of Radau, see first_share() */
} Implicit;

/* What a state keeps first: rate of Newton's iteration; whether the tangent serves the next step; and since the march began: tangents,
   factors, increments, the largest linear residual and its scale. */
enum { RATE, KNOWN, TANGENTS, FACTORED, INCREMENTS_MADE, RESIDUAL, RESIDUAL_SCALE, WORK };

static Implicit *implicit_in(double *room)
{
    Implicit *o;
    memcpy(&o, room, sizeof o);
    return o;
}

/* A tangent at a state with these multipliers, where the one at hand does not serve. */
static int take_tangent(System *s, Implicit *o, double t, const double *q, const double *v, const double *a, const double *lam,
                        double length, double *work)
{
    o->factored = 0.0;
    o->fresh = 1;
    work[TANGENTS] += 1.0;
    if (o->stages->fields) return field_tangent(s, o->stages, t, q, v, a, lam);
    return driver_stage_tangent(s, o->patterns, length, t, q, v, a, lam, o->masses, o->stages->W.data, o->room, o->data);
}

/* Whether what has failed is tried once more, with a tangent of its own: the tangent was that of an older step, or new ones of fields
   are asked for. */
static int tried_anew(const Implicit *o, int verdict, double *work)
{
    const int renewed = tried_renewed(o->stages, verdict);
    if (!renewed && (o->fresh || (verdict != NEWTON && verdict != SINGULAR))) return 0;
    work[KNOWN] = 0.0;
    return 1;
}

/* Factors of the frequencies of the stages, which ``key`` stands for. */
static int take_factors(System *s, Implicit *o, double key, double *work)
{
    if (o->factored == key) return DONE;
    o->factored = 0.0;
    int verdict = o->stages->fields ? field_matrices(s, o->stages, key) : driver_stage_factors(o->stages, o->patterns, o->data);
    if (!verdict) o->factored = key;
    work[FACTORED] += o->stages->frequencies;
    return verdict;
}

/* What ties hold of velocities v in a step of the first frequency s, in ``held`` behind what it moves:

     M dv + G^T mu + R^T nu = 0,        G dv = 0,        R dv - nu / (c / s + k / s^2) = R v

   all of R v where steps do not resolve the periods of ties. ``room``: 2 sizes of a point and n. */
static int held_by_ties(const System *s, const Implicit *o, const double *v, double *held, double *room)
{
    const Stages *g = o->stages;
    const Sparse *R = &g->R;
    double *low = room, *kin = low + g->size, *mult = kin + g->n, judged[2];
    memset(room, 0, (g->size + g->n) * sizeof(double));
    EACH_TIE(s, g->ties, k, j) {
        const int i = g->ties->item[j], number = g->ties->number[j];
        double rate = 0.0;
        for (int p = R->start[number]; p < R->start[number + 1]; p++) rate += R->data[p] * v[R->on[p]];
        low[g->n + g->levels * g->m + number] = -(k->stiffness[i] / *g->s + k->damping[i]) * rate;
    }

    resolve_real(g, 0, kin, low, held, mult, judged);
    return judged[0] <= o->convergence->accurate * judged[1];
}

/* The norm of errors of places, of velocities and (of three kinds) of accelerations. Along ties velocities count by the places that they
   lead to, as in index 3. ``room``: 2 sizes of a point and 5 n. */
static double step_error(const System *s, const Implicit *o, const double *const *parts, int kinds, double *room)
{
    const Stages *g = o->stages;
    const Norm norm = norm_of(g);
    const int n = g->n;
    double *held = room, *left = held + 2 * n, *rest = left + 2 * n, along = 0.0;
    const double *others[3] = {parts[0], left, left + n};
    if (!g->ties) return own_norm(s, &norm, parts, kinds);

    for (int kind = 1; kind < kinds; kind++) {
        if (!held_by_ties(s, o, parts[kind], held, rest)) return INFINITY;
        for (int i = 0; i < n; i++) left[(kind - 1) * n + i] = parts[kind][i] - held[n + i];
        for (int i = 0; i < n; i++) held[i] = norm.h * held[n + i];
        if (kind == 1) along = sqrt(mean_square(s, &norm, 0, held));
    }
    return worse(own_norm(s, &norm, others, kinds), along);
}

/* A step from a state on, in coordinates about it, with the tangent and the rate that this one has. */
static int begin_implicit(System *s, Implicit *o, const Block *now, Block out)
{
    Stages *g = o->stages;
    memcpy(out.own, now->own, WORK * sizeof(double));
    memcpy(g->q0, now->q, s->nq * sizeof(double));
    o->fresh = 0;
    if (!g->frozen) return DONE;

    double *row = g->local, *G = o->directions, last = NAN;
    int verdict = sample(s, *now->t, &last);
    if (verdict || (verdict = place(s, now->q, now->v))) return verdict;
    pattern_rows(s, o->patterns, row, G);
    normal_directions(o->patterns, g->W.data, G, g->frozen);
    return DONE;
}

/* The tangent at the last of the points with laws as they are there, none of whose slopes it has. */
static int take_straight(System *s, Implicit *o, double length, double *work)
{
    const Stages *g = o->stages;
    const int n = g->n, j = g->points - 1;
    const double key = o->factored;
    double *q = g->given + (long)g->points * (n + g->size) + n;
    configuration(s, g->q0, g->xi + (long)j * n, q);
    s->iterate = AGAIN;
    s->point = j;
    int verdict = take_tangent(s, o, g->t[j], q, g->v + (long)j * n, g->vd + (long)j * n, g->mult + (long)j * (g->size - n), length, work);
    s->iterate = ON_ITS_OWN;
    s->point = 0;
    return verdict ? verdict : take_factors(s, o, key, work);
}

/* Newton's iteration for all points, across laws that bend. */
static int iterate_points(System *s, Implicit *o, double length, double *work)
{
    Stages *g = o->stages;
    Convergence *c = o->convergence;
    Bend none[MOST_BENT];
    if (g->fields) return increments_by_one_tangent(s, g, c);

    s->bent = 0;
    g->hesitations = 0;
    g->crosses = 1;
    g->iterate = bends_of(s, g, 0, none) < 0 ? ON_ITS_OWN : FIRST;
    int verdict = increments_of(s, g, c);
    if (verdict == BENT && !(verdict = take_straight(s, o, length, work))) {
        s->bent = 1;
        g->iterate = AGAIN;
        verdict = increments_of(s, g, c);
        o->factored = 0.0; /* the next step takes slopes as they are */
    }

    g->iterate = ON_ITS_OWN;
    g->crosses = s->bent = 0;
    return verdict;
}

/* Newton's iteration of a step from a state on, with the rate so far; ``first``: what one increment leaves. */
static int iterate_step(System *s, Implicit *o, double *p, const Block *now, double first, double *work)
{
    Convergence *c = o->convergence;
    const double h = p[H], typical = fmax(largest_of(s->units, now->a, s->nv), 1e-3 * largest_of(s->units, now->v, s->nv) / h);
    const double unknown = LEFT_OF_PLACES * far_from_origin(s, now->q, p[LENGTH]);
    c->h = h;
    c->allowed = fmax(o->rtol * h * h * typical, fmax(o->floor, unknown));
    c->theta = work[RATE];
    c->first = first;
    c->size = c->greatest = 0.0;
    c->done = 0;
    c->outcome = GOES_ON;
    if (o->stages->fields) begin_points(s, o->stages);

    int verdict = iterate_points(s, o, p[LENGTH], work);
    const double *judged = o->stages->judged;
    work[RATE] = c->theta;
    work[INCREMENTS_MADE] += c->done;
    p[ITERATIONS] += c->done;
    if (!verdict && (c->outcome != CONVERGED || !(judged[0] <= c->accurate * judged[1]))) verdict = NEWTON;
    if (verdict) {
        o->failed += c->done;
        return verdict;
    }

    if (o->stages->fields) wear_tangents(o->stages, c->done);
    farthest_apart(judged, work + RESIDUAL);
    work[KNOWN] = c->theta <= o->slow && !o->stages->fields && o->factored != 0.0;
    if (o->stages->fields) sample_point(s, o->stages, o->stages->points - 1, 1); /* derivatives were taken elsewhere */
    p[LEFT] += c->share * c->size;
    return DONE;
}

/* Of the multipliers of all levels at point j the smallest with their forces in its configuration, where rows depend. ``room``:
   2 nv + rows. */
static int least_of_levels(System *s, const Stages *g, int j, const double *q, double *room)
{
    double *mult = g->mult + (long)j * (g->size - g->n);
    if (!s->redundant || !g->levels) return DONE;
    return g->fields ? least_on_fields(s, g, j, q, mult) : driver_least(s, 0, g->t[j], g->levels, q, mult, room);
}

/* y = A x of k rows of n numbers, for a matrix of k columns. */
static void combine(int rows, int k, const double *A, int n, const double *x, double *y)
{
    memset(y, 0, (size_t)rows * n * sizeof(double));
    for (int j = 0; j < rows; j++)
        for (int i = 0; i < k; i++) add(y + (long)j * n, A[j * k + i], x + (long)i * n, n);
}

/* Where a step ends, at the last of the points; multipliers are those that Newton's iteration has found. */
static int end_motion(System *s, const Implicit *o, const double *p, const Block *now, Block out)
{
    const Stages *g = o->stages;
    const int n = g->n, last = g->points - 1;
    const Sparse directions = directions_of(g);
    const Normal along = normal_at(g, &directions, last);
    *out.t = *now->t + p[H];
    configuration(s, now->q, g->xi + (long)last * n, out.q);
    memcpy(out.v, g->v + (long)last * n, n * sizeof(double));
    memcpy(out.a, g->vd + (long)last * n, n * sizeof(double));
    memset(out.A, 0, n * sizeof(double));
    if (!along.tau) return DONE;

    int verdict = place(s, out.q, out.v);
    if (!verdict) add_normal(s, &along, 1.0, along.tau, g->local, out.a);
    return verdict;
}

/* The end of a step with its multipliers. */
static int end_implicit(System *s, const Implicit *o, const double *p, const double *mult, Block out)
{
    const Stages *g = o->stages;
    int verdict;
    memcpy(out.lam, mult, s->rows * sizeof(double));
    if (g->fields) exchange_pressures(s, OUT_OF, 0, g->fields->pressure + (long)(g->points - 1) * g->fields->pressures);
    if (o->projects && (verdict = driver_close(s, 1, *out.t, p[LENGTH], 0.0, 0.0, out.q, out.v, o->mixed))) return verdict;

    if (turns_freely(s)) {
        if ((verdict = place(s, out.q, out.v))) return verdict;
        settle_angles(s, out.q);
    }
    if (!o->corrects) return DONE;
    if (g->fields) return correct_end(s, g, out, o->mixed);
    const double weights[2] = {p[H], p[H] * p[H]};
    return driver_correct(s, 1, out.t, weights, out.q, out.v, out.a, out.lam, o->mixed);
}
