/* Steps of Radau, schemes/onestep/stage_newton.py and radau.py: constant ones, and those that error control chooses. */

/* What it keeps with a state beside its work: what the last increment of Newton's iteration left, over its size, and the size of the step
   in which that was seen; what error control keeps; the step that led there: whether it strayed from what the one before foretold, its
   size (0: none), q (nq) and v (nv) at its start, its stages. The multipliers of the last of these are those of the state. */
typedef struct {
    double *share, *seen;
    Controlled *control;
    double *strays, *h, *q, *v, *xi, *vs, *mult;
} Collocation;

static Collocation collocation_at(const System *s, const Stages *g, double *own)
{
    const long k = g->points, n = g->n;
    double *x = own + WORK, *q = x + 4 + CONTROLLED, *v = q + s->nq, *xi = v + n, *vs = xi + k * n;
    Collocation o = {x, x + 1, (Controlled *)(x + 2), x + 2 + CONTROLLED, x + 3 + CONTROLLED, q, v, xi, vs, vs + k * n};
    return o;
}

/* What one increment leaves of the error, by the rate that was seen last. */
static double first_share(const Implicit *o, const Collocation *known, double h)
{
    return h <= o->longer * *known->seen ? pow(fmax(*known->share, o->least_share), 0.8) : 1.0;
}

/* Places of stages, n each, on a parabola of these velocities and accelerations, NULL: straight on. */
static void places_on_parabola(const Implicit *o, double h, const double *v, const double *a, double *xi)
{
    const int n = o->stages->n;
    for (int j = 0; j < o->stages->points; j++, xi += n) {
        const double x = o->c[j] * h;
        for (int i = 0; i < n; i++) xi[i] = x * v[i] + (a ? 0.5 * x * x * a[i] : 0.0);
    }
}

/* Powers of the time of stage j over the size of the last step, and its Lagrange polynomials there. */
static void basis_ahead(const Implicit *o, int j, double h, const Collocation *last, double *term, double *basis)
{
    const int k = o->stages->points;
    const double x = 1.0 + o->c[j] * h / *last->h;
    term[0] = 1.0;
    for (int i = 0; i < k; i++) term[i + 1] = x * term[i];
    combine(1, k + 1, term, k + 1, o->basis, basis);
}

/* Places of stages, n each, on the polynomial of the last step. */
static void places_ahead(const System *s, const Implicit *o, double h, const Block *now, const Collocation *last, double *xi)
{
    const Stages *g = o->stages;
    const int n = g->n, k = g->points;
    double *ahead = o->mixed, *there = ahead + n, term[8], basis[8];
    for (int j = 0; j < k; j++) {
        basis_ahead(o, j, h, last, term, basis);
        combine(1, k, basis + 1, n, last->xi, ahead);
        configuration(s, last->q, ahead, there);
        add(ahead, -1.0, last->xi + (k - 1) * n, n);
        driver_difference(s, 1, now->q, 0, there, 0, ahead, 0, xi + j * n);
    }
}

/* Stages on the polynomial of the last step, on a straight way where that one strayed, or on the parabola at a new start. */
static void foretell_stages(const System *s, Implicit *o, double h, const Block *now, const Collocation *last)
{
    Stages *g = o->stages;
    const int n = g->n, k = g->points, width = g->size - n, begins = *last->h == 0.0;
    if (begins || *last->strays) {
        places_on_parabola(o, h, now->v, begins ? now->a : NULL, g->xi);
        for (int j = 0; j < k; j++) {
            memcpy(g->v + j * n, now->v, n * sizeof(double));
            if (begins) add(g->v + j * n, o->c[j] * h, now->a, n);
            memcpy(g->mult + j * width, last->mult + (k - 1) * width, width * sizeof(double));
        }
        return;
    }

    places_ahead(s, o, h, now, last, g->xi);
    for (int j = 0; j < k; j++) {
        double term[8], basis[8], levels[8], *v = g->v + j * n;
        basis_ahead(o, j, h, last, term, basis);
        combine(1, k, term, k, o->stage_basis, levels);
        memcpy(v, last->v, n * sizeof(double));
        for (int l = 0; l < k; l++)
            for (int i = 0; i < n; i++) v[i] += basis[l + 1] * (last->vs[l * n + i] - last->v[i]);
        combine(1, k, levels, width, last->mult, g->mult + j * width);
    }
}

/* Whether the stages are nearer to a straight way than to the polynomial of the last step, as where vibrations are not resolved. */
static int stages_stray(const System *s, const Implicit *o, double h, const Block *now, const Collocation *last)
{
    const Stages *g = o->stages;
    const int count = g->n * g->points;
    double *way = g->rate, far[2];
    if (*last->h == 0.0) return 0;

    for (int straight = 0; straight < 2; straight++) {
        if (straight) places_on_parabola(o, h, now->v, NULL, way);
        else places_ahead(s, o, h, now, last, way);
        add(way, -1.0, g->xi, count);
        far[straight] = largest_length(s, g, g->points, way);
    }
    return far[1] < far[0];
}

/* v - v_n of the stages, in ``change``, and rates of both. */
static void rates_of_stages(const Implicit *o, const Block *now, double *change)
{
    Stages *g = o->stages;
    const int n = g->n, k = g->points;
    for (int j = 0; j < k; j++)
        for (int i = 0; i < n; i++) change[j * n + i] = g->v[j * n + i] - now->v[i];
    combine(k, k, g->couple, n, g->xi, g->rate);
    combine(k, k, g->couple, n, change, g->vd);
}

/* Tangent in the middle of the step as foretold, where it serves all stages best. ``change``: v - v_n. */
static int middle_tangent(System *s, Implicit *o, const double *p, const Block *now, const double *change, double *work)
{
    const Stages *g = o->stages;
    const int n = g->n, k = g->points, width = g->size - n;
    double *v = o->mixed + k * n, *a = v + n, *xi = a + n, *mult = xi + n, *q = mult + width;
    memcpy(v, now->v, n * sizeof(double));
    memset(a, 0, n * sizeof(double));
    memset(mult, 0, width * sizeof(double));
    combine(1, k, o->middle, n, g->xi, xi);

    for (int j = 0; j < k; j++) {
        add(v, o->middle[j], change + j * n, n);
        add(a, 1.0 / k, g->vd + j * n, n);
        add(mult, 1.0 / k, g->mult + j * width, width);
    }
    configuration(s, now->q, xi, q);
    return take_tangent(s, o, *now->t + 0.5 * p[H], q, v, a, mult, p[LENGTH], work);
}

/* How rates of memories follow from where the step begins, at t: polynomials that are constant have none. */
static void couple_start(Stages *g, double t)
{
    const int k = g->points;
    g->behind = 1;
    *g->ends = t;
    for (int j = 0; j < k; j++) {
        g->past[j] = 0.0;
        for (int i = 0; i < k; i++) g->past[j] -= g->couple[j * k + i];
    }
}

/* The stages of a step, by Newton's iteration. */
static int stages_of_step(System *s, double *p, Implicit *o, const Block *now, Block out)
{
    Stages *g = o->stages;
    const int k = g->points;
    const Collocation last = collocation_at(s, g, now->own), made = collocation_at(s, g, out.own);
    const double h = p[H];
    double *change = o->mixed, *work = out.own;
    int verdict;

    for (int j = 0; j < k; j++) g->t[j] = *now->t + h * o->c[j];
    for (int i = 0; i < k * k; i++) g->couple[i] = o->W[i] / h;
    couple_start(g, *now->t);
    for (int i = 0; i < 2 * g->frequencies; i++) g->s[i] = o->values[i] / h;
    foretell_stages(s, o, h, now, &last);
    rates_of_stages(o, now, change);
    if ((verdict = lead_memories(s, 1.0 / hypot(g->s[0], g->s[1])))) return verdict;

    if (work[KNOWN] == 0.0 && (verdict = middle_tangent(s, o, p, now, change, work))) return verdict;
    if ((verdict = take_factors(s, o, h, work))) return verdict;
    if (g->fields && (verdict = align_stages(s, g))) return verdict;
    if ((verdict = iterate_step(s, o, p, now, first_share(o, &made, h), work))) return verdict;
    *made.share = o->convergence->share;
    *made.seen = o->convergence->done > 1 ? h : fmax(h, *made.seen);
    return s->remembered ? remember_points(s, g, 1) : DONE;
}

/* A step from a state on, with what this one knows of Newton's iteration. */
static int begin_radau(System *s, Implicit *o, const Block *now, Block out)
{
    const Collocation last = collocation_at(s, o->stages, now->own), made = collocation_at(s, o->stages, out.own);
    const int verdict = begin_implicit(s, o, now, out);
    *made.share = *last.share;
    *made.seen = *last.seen;
    return verdict;
}

/* The state at the end of the stages, and what is kept of them. */
static int end_radau(System *s, Implicit *o, const double *p, const Block *now, Block out)
{
    const Stages *g = o->stages;
    const int n = g->n, k = g->points, width = g->size - n;
    const Collocation last = collocation_at(s, g, now->own), made = collocation_at(s, g, out.own);
    int verdict;
    *made.strays = stages_stray(s, o, p[H], now, &last);
    *made.h = p[H];
    rates_of_stages(o, now, o->mixed);
    if ((verdict = end_motion(s, o, p, now, out))) return verdict;

    for (int j = 0; s->redundant && j < k; j++) {
        double *q = o->mixed, *rest = q + s->nq;
        configuration(s, now->q, g->xi + j * n, q);
        if ((verdict = least_of_levels(s, g, j, q, rest))) return verdict;
    }
    memcpy(made.q, now->q, s->nq * sizeof(double));
    memcpy(made.v, now->v, n * sizeof(double));
    memcpy(made.xi, g->xi, (size_t)k * n * sizeof(double));
    memcpy(made.vs, g->v, (size_t)k * n * sizeof(double));
    memcpy(made.mult, g->mult, (size_t)k * width * sizeof(double));
    return end_implicit(s, o, p, g->mult + (k - 1) * width, out);
}

/* The start of a step with these multipliers on its constraints: v, a, and what moves the places, dq, each like v. ``room``: nq and that of driver_arrive(). */
static int start_on_rows(System *s, const Implicit *o, const Block *now, const double *mult, double *v, double *a, double *dq, double *room)
{
    const OwnSteps *c = o->own;
    const Stages *g = o->stages;
    const int n = g->n;
    double *q = room, *lam = q + s->nq;
    memcpy(v, now->v, n * sizeof(double));
    memcpy(a, now->a, n * sizeof(double));
    memset(dq, 0, n * sizeof(double));
    if (c->index == 1 || !g->levels) return DONE;

    if (g->fields) {
        memcpy(dq, g->fields->closed, n * sizeof(double));
        memcpy(v, g->fields->closed + n, n * sizeof(double));
        memcpy(a, g->fields->closed + 2 * n, n * sizeof(double));
        return DONE;
    }

    memcpy(q, now->q, s->nq * sizeof(double));
    give(s, g->ties, mult + g->levels * g->m); /* places tell them to roundoff times k only */
    int verdict = driver_arrive(s, c->places, *now->t, c->length, q, v, a, lam, lam + s->rows);
    give(s, NULL, NULL);
    if (!verdict && c->places) driver_difference(s, 1, now->q, 0, q, 0, NULL, 0, dq);
    return verdict;
}

/* Errors of places and of velocities, in ``change``, and what forces are off by, in ``push``, from the defects of a step: ``kin``, and
   ``push`` of the accelerations. Filtered: components that the step does not resolve would be overestimated. ``room``: 2 sizes of a point. */
static int filtered(System *s, const Implicit *o, const double *kin, double *push, double *change, double *work, double *room)
{
    const Stages *g = o->stages;
    const int n = g->n;
    const Sparse masses = {n, g->W.start, g->W.on, o->masses};
    double *low = room, *y = low + g->size, judged[2];
    if (g->fields) return field_errors(s, g, kin, push, change);

    memset(low, 0, g->size * sizeof(double));
    apply_real(&masses, -1.0, push, low);
    resolve_real(g, 0, kin, low, change, y, judged);
    if (!(judged[0] <= o->convergence->accurate * judged[1])) return NEWTON;
    farthest_apart(judged, work + RESIDUAL);
    /* what forces are off by pushes; multipliers turn with their joints, whose errors light bodies would tell as huge ones */
    add(push, -*g->s, change + n, n);
    return DONE;
}

/* That of the memories at the stages, where it is larger. */
static int error_of_memories(System *s, const Implicit *o, double h, double *error)
{
    const OwnSteps *c = o->own;
    const Stages *g = o->stages;
    double points[MOST_STAGES], begun = 0.0;
    for (int j = 0; j < g->points; j++) {
        points[j] = c->error[j] / h;
        begun -= points[j];
    }
    return remembered_error(s, g, &c->rtol, points, &begun, 1, 1.0, *g->s, error);
}

/* What velocities of a stage have of dq: those of index 3 follow all increments of the stages. */
static double slope_of_start(const Implicit *o, int stage)
{
    const Stages *g = o->stages;
    double slope = 0.0;
    for (int i = 0; o->own->index == 3 && i < g->points; i++) slope += g->couple[stage * g->points + i];
    return slope;
}

/* What the motion through the stages leaves of the equations between two of them, from a start at dq and v at time t, in kin and push as
   filtered() takes them. ``room``: 4 n, a size of a point, nq and that of driver_arrive(). */
static int left_between(System *s, const Implicit *o, double h, double t, const double *dq, const double *v, double *kin, double *push,
                        double *room)
{
    const Stages *g = o->stages;
    const int n = g->n, k = g->points, width = g->size - n;
    const double *at = o->own->between, *places = at + 2, *rates = places + k, *levels = rates + k;
    double *xi = room, *fast = xi + n, *a = fast + n, *mult = a + n, *q = mult + g->size, *lam = q + s->nq;
    const Sparse directions = directions_of(g);
    int verdict;
    memset(kin, 0, n * sizeof(double));
    memset(push, 0, n * sizeof(double));
    memset(mult, 0, width * sizeof(double));
    memcpy(xi, dq, n * sizeof(double));
    memcpy(fast, v, n * sizeof(double));

    for (int j = 0; j < k; j++) {
        const double slope = slope_of_start(o, j);
        for (int i = 0; i < n; i++) {
            const double moved = g->xi[j * n + i] - dq[i], faster = g->v[j * n + i] - v[i] - slope * dq[i];
            xi[i] += places[j] * moved;
            fast[i] += places[j] * faster;
            kin[i] += at[1] * rates[j] / h * moved;
            push[i] -= at[1] * rates[j] / h * faster;
        }
        add(mult, levels[j], g->mult + j * width, width);
    }

    configuration(s, g->q0, xi, q);
    if ((verdict = driver_arrive(s, 0, t + at[0] * h, o->own->length, q, fast, a, lam, lam + s->rows))) return verdict;
    if (g->levels > 1) apply_real(&directions, -1.0, mult + g->m, fast);
    for (int b = 0; b < s->bodies; b++) rate_of(xi + TWIST * b, fast + TWIST * b);
    add(kin, -at[1], fast, n);
    add(push, at[1], a, n);
    return DONE;
}

/* Note the error of the stages of a step from a state with these multipliers, over the tolerance. */
static int own_error(System *s, Implicit *o, double h, const Block *now, const double *mult, double *work, Passing *found)
{
    const OwnSteps *c = o->own;
    const Stages *g = o->stages;
    const int n = g->n, k = g->points, kinds = c->index == 1 || !g->levels || g->fields ? 2 : 3;
    double *v = o->mixed, *a = v + n, *dq = a + n, *kin = dq + n, *push = kin + n, *change = push + n, *rest = change + 2 * n;
    int verdict;

    /* what the start of the step leaves of the constraints is no error of the step */
    if ((verdict = start_on_rows(s, o, now, mult, v, a, dq, rest))) return verdict;
    memcpy(kin, v, n * sizeof(double));
    memcpy(push, a, n * sizeof(double));
    for (int j = 0; j < k; j++) {
        const double share = c->error[j] / h, slope = slope_of_start(o, j);
        for (int i = 0; i < n; i++) {
            kin[i] += share * (g->xi[j * n + i] - dq[i]);
            push[i] += share * (g->v[j * n + i] - v[i] - slope * dq[i]);
        }
    }

    for (int i = 0; i < n; i++) kin[i] = -kin[i];
    if (g->levels > 1 && g->fields) add_closing(g, mult + g->m, kin);
    else if (g->levels > 1) {
        const Sparse directions = directions_of(g);
        apply_real(&directions, 1.0, mult + g->m, kin);
    }

    found->filtered++;
    if ((verdict = filtered(s, o, kin, push, change, work, rest))) return verdict;
    const double *parts[3] = {change, change + n, push};
    found->error = step_error(s, o, parts, kinds, rest);
    if ((verdict = error_of_memories(s, o, h, &found->error)) || !c->between || !(found->error < INFINITY)) return verdict;

    /* forces that bend within a step may leave nothing of one such sum by luck, hardly of two */
    verdict = left_between(s, o, h, *now->t, dq, v, kin, push, rest);
    if (verdict) return verdict == NEWTON || verdict == SINGULAR ? DONE : verdict;
    found->filtered++;
    if ((verdict = filtered(s, o, kin, push, change, work, rest))) return verdict;
    found->error = worse(found->error, step_error(s, o, parts, kinds, rest));
    return DONE;
}

/* The size that follows an accepted step of h with ``left`` to go before it: _next_size() of radau.py. */
static double next_size(const Implicit *o, const Collocation *last, const Collocation *made, double h, const Passing *found, double left)
{
    const OwnSteps *c = o->own;
    const double effort = (c->most + 1.0) / (c->most + o->convergence->done);
    double next = accepted_size(c, last->control, made->control, h, found, effort);
    if (o->convergence->theta < 1e-2 && next / h >= 1.0 && next / h <= 1.2) next = h; /* keep the factors */
    return h >= left && next >= left ? fmax(next, found->proposed) : next;
}

/* The stages of a step of a size that passes. */
static int passing_stages(System *s, double *p, Implicit *o, const Block *now, Block out, Passing *found)
{
    OwnSteps *c = o->own;
    Stages *g = o->stages;
    const double most = farthest_turn(s->bodies, c->turn, c->turning, now);
    const double *mult = collocation_at(s, g, now->own).mult + (g->points - 1) * (g->size - g->n);
    double *work = out.own;
    int verdict, cause;

    for (;;) {
        if ((verdict = own_size(c, now, found->proposed, most, p + H))) return verdict;
        g->span = p[H];
        const Norm norm = norm_of(g);
        take_sizes(s, c, &norm, now);

        do {
            verdict = stages_of_step(s, p, o, now, out);
            cause = o->convergence->outcome == TOO_SLOW ? IS_SLOW : DIVERGES;
            if (!verdict && turn_too_far(s, c, g->points, g->xi)) {
                verdict = NEWTON;
                cause = TURNS_FAR;
            }
        } while (tried_anew(o, verdict, work));

        if ((verdict == NEWTON || verdict == SINGULAR) && failed_size(c, p[H], cause, found)) {
            work[KNOWN] = 0.0; /* the tangent was that in the middle of a longer step */
            continue;
        }
        if (verdict || (verdict = own_error(s, o, p[H], now, mult, work, found))) return verdict;
        if (lets_pass(c, found)) return DONE;

        /* the tangent goes on serving */
        work[RATE] = fmax(work[RATE], 1e-3);
        work[KNOWN] = 1.0;
        if (!refused_size(c, now, p[H], c->order, found)) return NEWTON;
    }
}

/* One step of the size that error control chooses, likewise. */
static int own_radau_step(System *s, double *p, Implicit *o, const Block *now, Block out)
{
    OwnSteps *c = o->own;
    const Collocation last = collocation_at(s, o->stages, now->own), made = collocation_at(s, o->stages, out.own);
    const double left = left_for(c, now);
    Passing found = {.proposed = proposal(c, last.control->next)};
    int verdict;
    if (!(left > 0.0) || *now->t > c->last) return SIZE;
    const Norm norm = norm_of(o->stages);
    if ((verdict = take_bases(s, &norm, now->q, now->v))) return verdict;
    if (o->stages->fields && o->stages->levels && (verdict = close_start(s, o->stages, c->places, now))) return verdict;
    if ((verdict = passing_stages(s, p, o, now, out, &found))) return verdict;

    /* the error went back to the start of the step, in time too */
    sample_point(s, o->stages, o->stages->points - 1, 1);
    note_passing(c, &found);
    made.control->next = next_size(o, &last, &made, p[H], &found, left);
    if (o->stages->fields) o->stages->fields->begun = 0;
    return end_radau(s, o, p, now, out);
}

/* One step, as a Maker of march.c. */
int radau_step(System *s, double *p, double *room, const Block *past, int known, Block out)
{
    Implicit *o = implicit_in(room);
    const Block *now = past;
    (void)known;
    int verdict = begin_radau(s, o, now, out);
    if (verdict) return verdict;
    if (o->own) return own_radau_step(s, p, o, now, out);
    do verdict = stages_of_step(s, p, o, now, out);
    while (o->stages->fields && tried_anew(o, verdict, out.own));
    return verdict ? verdict : end_radau(s, o, p, now, out);
}
