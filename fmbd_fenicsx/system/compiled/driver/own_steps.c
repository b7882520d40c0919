/* Steps of Radau whose sizes error control chooses, schemes/onestep/radau.py, as long as each passes at once: the size of a step, its
   error in the norm of schemes/control.py, and the size of the next. All else is Python's, which makes a step that fails. */

/* What stands here has the same order in ``OwnSteps`` of system/compiled/implicit.py. */
typedef struct OwnSteps {
    int index, places, deforming, turning; /* of the form; whether it holds places; bodies that deform; 1, or more where steps are to */
                                       /* turn so much less */
    Deflection *deflection;
    const double *error;               /* of the tableau */
    double *sizes, *speeds, *scale;    /* largest so far, of coordinates and velocities; work; each like v */
    double rtol, atol, length, turn;
    double order, safety, shrink, grow, least, most; /* of the controller; least error that it remembers; increments, twice */
    double until, last, worst;         /* a time that is hit; until when steps may begin; the largest error of a march */
} OwnSteps;

/* The largest step in which no frame in space turns too far, as it moves now. */
static double farthest_turn(const System *s, const OwnSteps *c, const Block *now)
{
    double fastest = 0.0;
#if DIM == 3
    for (int b = 0; b < s->bodies; b++) {
        const double *w = now->v + TWIST * b + D, *e = now->a + TWIST * b + D;
        double square = dot(w, w, 3);
        fastest = fmax(fastest, sqrt(square) + sqrt(square + 2.0 * sqrt(dot(e, e, 3)) * c->turn / c->turning));
    }
#else
    (void)s, (void)now;
#endif
    return fastest > 0.0 ? 2.0 * c->turn / (c->turning * fastest) : INFINITY;
}

/* Whether increments of the points come close to a full turn of a frame in space. */
static int turn_too_far(const System *s, const OwnSteps *c, const Stages *g)
{
#if DIM == 3
    for (int j = 0; j < g->points; j++)
        for (int b = 0; b < s->bodies; b++) {
            const double *turn = g->xi + (long)j * g->n + TWIST * b + D;
            if (!(dot(turn, turn, 3) <= 4.0 * c->turn * c->turn)) return 1;
        }
#else
    (void)s, (void)c, (void)g;
#endif
    return 0;
}

/* Sizes so far, with those of a state before a step of h, and what errors are multiplied by in the norm. */
static void take_sizes(const System *s, const OwnSteps *c, const Stages *g, const Block *now, double h)
{
    const int n = g->n;
    double *scale = c->scale, fastest[2] = {0.0, 0.0};
    position_sizes(s, c->length, now->q, scale);
    for (int i = 0; i < n; i++) {
        double speed = fmax(fabs(now->v[i]), h * fabs(now->a[i]));
        scale[i] = c->sizes[i] = fmax(c->sizes[i], scale[i]);
        if (i < TWIST * s->bodies) fastest[i % TWIST >= D] = fmax(fastest[i % TWIST >= D], speed);
        else c->speeds[i] = fmax(c->speeds[i], speed);
    }
    for (int i = 0; i < TWIST * s->bodies; i++) c->speeds[i] = fmax(c->speeds[i], fastest[i % TWIST >= D]);

    for (int i = 0; i < n; i++) {
        double place = c->rtol * scale[i] + c->atol, rate = c->rtol * c->speeds[i] + 1e-4 * place / h;
        g->weigh[i] = 1.0 / place;
        g->weigh[n + i] = c->index == 3 ? h / place : 1.0 / rate;
        g->weigh[2 * n + i] = c->index == 3 ? h * h / place : h / rate;
    }
    for (Deflection *x = c->deflection; x < c->deflection + c->deforming; x++) {
        x->size = fmax(x->size, 1e-2 * c->length);
        for (int i = 0; i < x->n; i++) x->size = fmax(x->size, fabs(now->q[x->at_q + i] * x->rms[i]));
        for (int i = 0; i < x->n; i++) {
            double place = c->rtol * x->size / x->rms[i] + c->atol, *w = g->weigh + x->at_v + i;
            w[0] = 1.0 / place;
            w[n] = h / place;
            w[2 * n] = h * h / place;
        }
    }
}

/* The error of the stages of a step from a state with these multipliers, over the tolerance. */
static int own_error(System *s, Implicit *o, double h, const Block *now, const double *mult, double *work, double *error)
{
    const OwnSteps *c = o->own;
    const Stages *g = o->stages;
    const int n = g->n, k = g->points, m = g->m, free = c->index == 1 || !g->levels;
    double *q = o->mixed, *v = q + s->nq, *a = v + n, *lam = a + n, *dq = lam + m, *kin = dq + n, *push = kin + n, *low = push + n;
    double *change = low + g->size, *y = change + 2 * n, *rest = y + g->size, judged[2];
    int verdict;

    /* what the start of the step leaves of the constraints is no error of the step */
    memcpy(q, now->q, s->nq * sizeof(double));
    memcpy(v, now->v, n * sizeof(double));
    memcpy(a, now->a, n * sizeof(double));
    memset(dq, 0, n * sizeof(double));
    if (!free && (verdict = driver_arrive(s, c->places, *now->t, c->length, q, v, a, lam, rest))) return verdict;
    if (!free && c->places) driver_difference(s, 1, now->q, 0, q, 0, NULL, 0, dq);

    memcpy(kin, v, n * sizeof(double));
    memcpy(push, a, n * sizeof(double));
    for (int j = 0; j < k; j++) {
        double share = c->error[j] / h, slope = 0.0;
        for (int i = 0; c->index == 3 && i < k; i++) slope += g->couple[j * k + i];
        for (int i = 0; i < n; i++) {
            kin[i] += share * (g->xi[j * n + i] - dq[i]);
            push[i] += share * (g->v[j * n + i] - v[i] - slope * dq[i]);
        }
    }
    if (g->levels > 1) apply_real(&g->U, -1.0, mult + m, kin);

    /* filtered: components that the step does not resolve would be overestimated */
    const Sparse masses = {n, g->W.start, g->W.on, o->masses};
    memset(low, 0, g->size * sizeof(double));
    apply_real(&masses, -1.0, push, low);
    for (int i = 0; i < n; i++) kin[i] = -kin[i];
    resolve_real(g, 0, kin, low, change, y, judged);
    if (!(judged[0] <= o->convergence->accurate * judged[1])) return NEWTON;
    farthest_apart(judged, work + RESIDUAL);

    memset(push, 0, n * sizeof(double));
    if (g->levels) apply_real(&g->U, 1.0, y, push);
    const double *parts[3] = {change, change + n, push};
    double worst = 0.0;
    for (int i = 0; i < (c->index == 1 ? 2 : 3); i++) {
        double sum = 0.0;
        for (int j = 0; j < n; j++) sum += g->weigh[i * n + j] * parts[i][j] * g->weigh[i * n + j] * parts[i][j];
        if (!(sum / n <= worst)) worst = sum / n; /* nan stays */
    }
    *error = sqrt(worst);
    return DONE;
}

/* The size that follows an accepted step of h with ``left`` to go before it: accepted() of the controller, and _next_size() of radau.py. */
static void next_size(const Implicit *o, const Collocation *last, const Collocation *made, double h, double left, double error)
{
    const OwnSteps *c = o->own;
    const double power = 1.0 / c->order, effort = (c->most + 1.0) / (c->most + o->convergence->done), known = fmax(error, 1e-10);
    double factor = c->safety * effort * pow(known, -power);
    if (*last->before > 0.0) factor = fmin(factor, c->safety * (h / *last->before) * pow(*last->missed / (known * known), power));
    *made->before = h;
    *made->missed = fmax(known, c->least);

    double next = h * fmin(fmax(factor, c->shrink), c->grow);
    if (o->convergence->theta < 1e-2 && next / h >= 1.0 && next / h <= 1.2) next = h; /* keep the factors */
    *made->next = h >= left && next >= left ? fmax(next, *last->next) : next;
}

/* One step, as a Maker of march.c. */
static int own_radau_step(System *s, double *p, Implicit *o, const Block *now, Block out)
{
    OwnSteps *c = o->own;
    const Collocation last = collocation_at(s, o->stages, now->own), made = collocation_at(s, o->stages, out.own);
    const double left = c->until - *now->t;
    double h = fmin(*last.next, farthest_turn(s, c, now)), error, asked = NAN;
    int verdict;

    if (!(left > 0.0) || *now->t > c->last) return SIZE;
    if (h >= left * (1.0 - 1e-10)) h = left;
    else if (h > 0.5 * left) h = 0.5 * left;
    if (*now->t + h == *now->t) return NEWTON;

    p[H] = h;
    take_sizes(s, c, o->stages, now, h);
    if ((verdict = stages_of_step(s, p, o, now, out))) return verdict;
    if (turn_too_far(s, c, o->stages)) return NEWTON;
    const int width = o->stages->size - o->stages->n;
    verdict = own_error(s, o, h, now, last.mult + (o->stages->points - 1) * width, out.own, &error);
    if (verdict || !(error <= 1.0)) return verdict ? verdict : NEWTON;
    /* the error went back to the start of the step, in time too */
    if ((verdict = sample(s, *now->t + h, &asked))) return verdict;
    next_size(o, &last, &made, h, left, error);
    c->worst = fmax(c->worst, error);
    return end_radau(s, o, p, now, out);
}
