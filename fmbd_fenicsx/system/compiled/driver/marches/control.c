/* Error control of generalized-alpha: the norm of schemes/error_norm.py (NormOfWays) for errors of positions, and the size of the next
   step, as schemes/onestep/alpha/variable_alpha.py decides it. Where loads want a look, and where elastic fields or samples are, every
   change of size is Python's. */

#if DIM == 3
/* Largest component of the smallest rotation vector between two attitudes. */
static double turned(const double *q0, const double *q)
{
    double relative[3], cross[3], c = dot(q0 + 3, q + 3, 4), sine, angle, worst = 0.0;
    moment(q0 + 3, q + 3, cross);
    for (int i = 0; i < 3; i++) {
        relative[i] = q0[6] * q[3 + i] - q[6] * q0[3 + i] - cross[i];
        worst = fmax(worst, fabs(relative[i]));
    }
    sine = sqrt(dot(relative, relative, 3));
    angle = 2.0 * atan2(sine, fabs(c));
    return sine > 0.0 ? worst * angle / sine : 0.0;
}
#else
static double turned(const double *q0, const double *q) { return fabs(q[2] - q0[2]); }
#endif

/* Sizes with those of a state after a step of h, which may still be refused. */
static void reach(const System *s, Control *c, double h, const Block *now)
{
    const double *q = now->q;
    const OwnSteps *o = c->own;
    memcpy(c->faster, c->fastest, 2 * sizeof(double));
    for (int i = 0; c->laws && i < TWIST * c->frames; i++) {
        double *known = c->faster + (i % TWIST >= D);
        *known = fmax(*known, fmax(fabs(now->v[i]), h * fabs(now->a[i])));
    }

    c->reached = c->way;
    for (int b = 0; c->way < 1.0 && b < c->frames; b++) { /* longer ways count as one */
        const double *from = c->origin + POSE * b, *to = q + POSE * b;
        for (int i = 0; i < D; i++) c->reached = fmax(c->reached, fabs(to[i] - from[i]) / o->length);
        c->reached = fmax(c->reached, turned(from, to));
    }

    if (c->coordinates) position_sizes(s, o->length, q, c->reaching);
    for (long k = 0; k < c->coordinates; k++) {
        const int i = c->coordinate[k];
        c->reaching[i] = fmax(o->sizes[i], c->reaching[i]);
        c->racing[i] = fmax(o->speeds[i], fmax(fabs(now->v[i]), h * fabs(now->a[i])));
    }

    for (Deflection *x = o->deflection; x < o->deflection + o->deforming; x++) x->reached = deflected(o, x, q);
}

/* Sum of squares of errors over one tolerance. */
static double squares(const double *e, int n, double tolerance)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++) sum += (e[i] / tolerance) * (e[i] / tolerance);
    return sum;
}

/* What an entry of an error of places, or of velocities after a step of h (0: of places), may be, where places are known to so much: see
   NormOfWays.update. */
static double allowed_error(const OwnSteps *o, double size, double unknown, double fastest, double h)
{
    const double places = o->rtol * size + o->atol;
    return h > 0.0 ? o->rtol * fastest + (o->brief * places + unknown) / h : places;
}

/* Root mean square of the core, or that of the worst field; of frames without what they do beside the mass of their body. ``h``: as above. */
static double error_norm(const System *s, const Control *c, const double *q, const double *e, double h)
{
    const OwnSteps *o = c->own;
    const double share = fmax(fmin(fmax(c->reached, c->foretold), 1.0), c->least), per = h > 0.0 ? h : 1.0;
    double core = 0.0, worst = 0.0;
    for (int b = 0; b < c->frames; b++) {
        double own[TWIST], R[D * D], bent[TWIST] = {0.0};
        if (hangs(s->body + b)) {
            rotation(q + POSE * b, R);
            bend_frame(s->body + b, R, e, e + TWIST * b, bent);
        }

        for (int i = 0; i < TWIST; i++) own[i] = e[TWIST * b + i] - bent[i];
        core += squares(own, D, allowed_error(o, share * o->length, c->unknown, c->faster[0], h));
        core += squares(own + D, ROT, allowed_error(o, share, c->unknown / o->length, c->faster[1], h));
    }

    for (long k = 0; k < c->coordinates; k++) {
        const int i = c->coordinate[k];
        core += squares(e + i, 1, allowed_error(o, c->reaching[i], 0.0, c->racing[i], h));
    }

    for (const Deflection *x = o->deflection; x < o->deflection + o->deforming; x++) {
        for (int i = 0; x->rms && i < x->n; i++)
            core += squares(e + x->at_v + i, 1, (o->rtol * x->reached / x->rms[i] + o->atol) / per);
        double mean = x->rms ? 0.0 : squares(e + x->at_v, x->n, (o->rtol * x->reached + o->atol) / per) / x->n;
        worst = worse(worst, mean);
    }
    return sqrt(c->core ? worse(worst, core / c->core) : worst);
}

static const double FAR_JUMP = 1e6; /* times accelerations of a state */
static const double KNOWN_FADES = 0.95; /* from step to step, of a way that was foretold */

/* The error with that of (3) of variable_alpha.py, filtered with what is stiff at both ends of a step, where it may be the larger. */
static int with_speeds(System *s, const double *p, Control *c, const Block *past, const Block *out, double *error)
{
    const double h = p[H], before = *past[0].t - *past[1].t, scale = h * h / (6.0 * (h + before));
    const double share = h * (1.0 - p[AF]) / (1.0 - p[AM]), weights[] = {share * p[GAMMA], share * h * p[BETA]};
    const Block *ends[] = {past, out}; /* memories go on from the evaluation at the end */
    double asked = NAN;
    int verdict;
    for (int i = 0; i < s->nv; i++) {
        double led = past[0].a[i] + h / before * (past[0].a[i] - past[1].a[i]);
        c->missed_speed[i] = scale * (out->a[i] - led);
    }
    /* the balance is linear in accelerations: a jump that is large beside what Newton's iteration leaves of them, or any beside none */
    const double jump = FAR_JUMP * fmax(typical(s, past->a), typical(s, out->a)), missed = largest_of(s->units, c->missed_speed, s->nv);
    const double part = jump > 0.0 ? missed / jump : 1.0;
    double found = *error;
    if (error_norm(s, c, out->q, c->missed_speed, h) <= fmax(found, c->calm)) return DONE; /* less is what Newton's iteration leaves */

    for (int k = 0; k < 2; k++) {
        const Block *at = ends[k];
        for (int i = 0; i < s->nv; i++) c->a[i] = at->a[i] + c->missed_speed[i] / part;
        if ((verdict = sample(s, *at->t, &asked))) return verdict;
        if ((verdict = filtered(s, part, 0.0, weights, at->q, at->v, c->a, at->lam, *at->t, c->missed_speed, c->e, c->y))) return verdict;
        found = worse(found, error_norm(s, c, out->q, c->e, h));
    }
    *error = found;
    return DONE;
}

/* The error of a step from the newest of ``past`` to ``out``; SIZE where it is refused, and sizes are as before. */
static int judged(System *s, const double *p, Control *c, const Block *past, const Block *out)
{
    const Block *now = past;
    const double scale = p[H] * p[H] * (p[BETA] - 1.0 / 6.0);
    for (int i = 0; i < s->nv; i++) {
        double jump = out->A[i] - now->A[i];
        c->a[i] = out->a[i] + jump;
        c->missed_speed[i] = scale * jump;
    }
    const double span = p[STABILISED] != 0.0 ? 0.0 : 0.5 * p[H];
    int verdict = filtered(s, scale, span, NULL, out->q, out->v, c->a, out->lam, *out->t, c->missed_speed, c->e, c->y);
    double forgotten = 0.0;
    if (verdict || (verdict = trapezoid_error(s, *out->t, out->q, out->v, c->own->rtol, c->own->atol, &forgotten))) return verdict;

    reach(s, c, p[H], out);
    c->unknown = small(s, p, out->q, 0.0);
    double error = error_norm(s, c, out->q, c->e, 0.0);
    if (c->drags && error <= 1.0 && error_norm(s, c, out->q, c->missed_speed, 0.0) > 1.0) {
        const double share = (1.0 - p[AF]) / (1.0 - p[AM]), undamped[] = {0.0, p[H] * p[H] * share * p[BETA]};
        verdict = filtered(s, scale, span, undamped, out->q, out->v, c->a, out->lam, *out->t, c->missed_speed, c->e, c->y);
        if (verdict) return verdict;
        error = error_norm(s, c, out->q, c->e, 0.0);
    }
    if (error <= 1.0 && c->laws && p[HISTORY] >= 1.0 && (verdict = with_speeds(s, p, c, past, out, &error))) return verdict;
    error = worse(error, forgotten);
    const Passing found = {.error = error};
    c->trial = error;
    if (!lets_pass(c->own, &found)) return SIZE;

    c->error = error;
    c->largest = fmax(c->largest, error);
    c->peak = fmax(error, c->fading * c->peak);
    c->way = c->reached;
    c->foretold *= KNOWN_FADES;
    memcpy(c->fastest, c->faster, 2 * sizeof(double));
    for (long k = 0; k < c->coordinates; k++) {
        const int i = c->coordinate[k];
        c->own->sizes[i] = c->reaching[i];
        c->own->speeds[i] = c->racing[i];
    }
    for (int k = 0; k < c->own->deforming; k++) c->own->deflection[k].size = c->own->deflection[k].reached;
    return DONE;
}

/* Give an accepted state the time that the parts of the stretch tell. */
static void arrive(const Control *c, Block *out) { *out->t = c->end - c->stretch * ((double)(c->count - c->place - 1) / (double)c->count); }

static const double SAME_SIZE = 1e-9;       /* share by which sizes that are equal may differ */
static const double LOST_FOR = 10.0;        /* times its length that a step is held for too long in which masses are lost */
static const double FARTHEST_MOTION = 10.0; /* times the least motion that closes rows: one that bends bodies less may be as large */
static const double KEEPS = 0.93;           /* share of a size that a proposal must have to keep it: an error of 0.9 is expected then */
enum { DEEPEST = 48 };                      /* levels of parts of the stretch; the finest are below roundoff */

/* Whether masses are known to be lost in a step of h. */
static int loses(const Control *c, const Block *now, double h) { return h >= c->lost * (1.0 - SAME_SIZE) && *now->t < c->until; }

/* How many parts of the stretch steps of at most the size wanted are: the fewest of which one begins now, see Stretch.coarsest. */
static long coarsest(const Control *c, const Block *now, double wanted)
{
    long count = 1;
    for (int level = 0; level < DEEPEST; level++, count *= level % 2 ? 2 : 3) {
        const double h = c->stretch / (double)count;
        const int begins = count >= c->count || c->place % (c->count / count) == 0;
        if (begins && h <= wanted && !loses(c, now, h)) break;
    }
    return count;
}

/* Least motion that opens the rows as they are told, against a matrix for steps of h; its size (m) is infinite without one. */
static double opening_motion(System *s, const double *p, const Block *now, double h, const double *open, double *x, double *y)
{
    const double share = h * (1.0 - p[AF]) / (1.0 - p[AM]);
    if (prepare(s, now->q, share * p[GAMMA], share * h * p[BETA], now->lam, 0, *now->t)) return INFINITY;
    return closing_change(s, open, x, y);
}

/* The same as if bodies were rigid: for steps of the whole stretch, or of the largest parts in which masses are not lost, longer than h. */
static double stiff_motion(System *s, const double *p, Control *c, const Block *now, double h, double *x, double *y)
{
    long count = 1;
    for (int level = 0; level < DEEPEST; level++, count *= level % 2 ? 2 : 3) {
        const double span = c->stretch / (double)count;
        if (span <= h) break;
        if (loses(c, now, span)) continue;
        const double size = opening_motion(s, p, now, span, c->open, x, y);
        if (size < INFINITY) return size;
        c->lost = span;
        c->until = *now->t + LOST_FOR * span;
    }
    return INFINITY;
}

/* What rows (in lengths) miss beyond the roundoff of places: known_gaps() of schemes/newton.py. */
static double known_gap(const System *s, int row, double gap, double near) { return s->row_units[row] * fabs(gap) > near ? gap : 0.0; }

/* What velocities miss their constraints by, and A - a, as steps of h have it: see size_change.py. */
static int change_openings(System *s, const double *p, Control *c, const Block *now, double h, double *jump)
{
    const double before = c->size, r = h / before, length = c->own->length;
    const double near = LEFT_OF_PLACES * (length + far_from_origin(s, now->q, length));
    double asked = NAN, noisy = 0.0;
    int verdict;
    if ((verdict = sample(s, *now->t, &asked)) || (verdict = evaluate(s, now->q, now->v, now->a, now->lam, *now->t))) return verdict;

    slips(s, 1);
    for (int i = 0; i < s->rows; i++) c->open[i] = s->slip[i] - r * r * known_gap(s, i, before * s->slip[i], near) / before;
    turn_velocity(s, jump);
    slips(s, 0);
    for (int i = 0; i < s->rows; i++) {
        c->noise[i] = s->slip[i] - known_gap(s, i, before * before * s->slip[i], near) / (before * before);
        noisy = fmax(noisy, fabs(c->noise[i]));
    }

    const double stiff = c->bends ? stiff_motion(s, p, c, now, h, c->e, c->y) : INFINITY;
    const double soft = opening_motion(s, p, now, h, c->open, c->missed_speed, c->y);
    if (!(soft < INFINITY)) return SINGULAR;
    add(now->v, 1.0, stiff <= FARTHEST_MOTION * soft ? c->e : c->missed_speed, s->nv); /* S K may have no least motion */
    if (noisy > 0.0) {
        closing_change(s, c->noise, c->e, c->y);
        add(jump, 1.0, c->e, s->nv);
    }
    return DONE;
}

/* The newest state as it was before a change of size, and the size. */
static void take_back(const System *s, double *p, const Control *c, const Block *now)
{
    if (p[H] == c->size) return;
    memcpy(now->v, c->v, s->nv * sizeof(double));
    memcpy(now->A, c->A, s->nv * sizeof(double));
    p[H] = c->size;
}

/* Prepare the newest state for steps of another size: r = h_new / h_old, A <- a + r (A - a), and v. */
static int change_size(System *s, double *p, Control *c, const Block *now, double h)
{
    int verdict = DONE;
    memcpy(c->v, now->v, s->nv * sizeof(double));
    memcpy(c->A, now->A, s->nv * sizeof(double));
    p[H] = h;
    for (int i = 0; i < s->nv; i++) c->a[i] = now->A[i] - now->a[i];
    if (s->rows && p[STABILISED] == 0.0) verdict = change_openings(s, p, c, now, h, c->a);
    if (verdict) take_back(s, p, c, now);
    else for (int i = 0; i < s->nv; i++) now->A[i] = now->a[i] + h / c->size * c->a[i];
    return verdict;
}

/* Prepare the next step, as long as is proposed; SIZE where Python has to. */
static int next_size(System *s, double *p, Control *c, const Block *now)
{
    const double wanted = fmin(proposal(c->own, c->proposed), farthest_turn((int)c->frames, c->own->turn, 1.0, now));
    if (*now->t > c->last) return SIZE;
    if (c->place == c->count) { /* the next stretch is as long */
        if (c->more <= 0) return SIZE;
        c->more--;
        c->place = 0;
        c->end += c->stretch;
    }

    const long count = coarsest(c, now, wanted);
    const double h = c->stretch / (double)count;
    const int looked = !c->timed || (h <= c->looked && c->peak > c->calm) || (h == c->quiet_size && *now->t + h <= c->quiet);
    if (!looked || (h != c->size && !c->chooses) || *now->t + h == *now->t) return SIZE;
    c->place = count > c->count ? c->place * (count / c->count) : c->place / (c->count / count);
    c->count = count;
    return h == c->size || !change_size(s, p, c, now, h) ? DONE : SIZE;
}

/* Propose a size after an accepted step. */
static void pass_step(const double *p, Control *c)
{
    const double h = p[H];
    const Controlled last = {0.0, c->size_before, c->missed};
    const Passing found = {.error = c->error, .refused = (int)c->refused};
    Controlled made;
    c->proposed = accepted_size(c->own, &last, &made, h, &found, 1.0);
    c->size = c->size_before = h;
    c->missed = made.missed;
    c->refused = 0;
    c->place++;

    /* errors of vibrations pass through zero: no sign that larger steps will do */
    const double largest = h * growth_factor(fmax(c->peak, NO_ERROR), c->own->order, c->own->safety);
    if (c->proposed > h) c->proposed = fmax(h, fmin(c->proposed, largest));
    if (KEEPS * h <= c->proposed && c->proposed < h) c->proposed = h; /* the next smaller size is a half or a third */
}

/* Prepare a smaller step where its error has refused one; 0 where Python has to. */
static int smaller_size(System *s, double *p, Control *c, const Block *now, int *verdict)
{
    const double h = p[H];
    Passing found = {.error = c->trial, .refused = (int)c->refused};
    c->tried = h;
    take_back(s, p, c, now);
    if (*verdict != SIZE || !c->chooses || s->remembers || !refused_size(c->own, now, h, c->own->order, &found)) return 0;
    if (c->trial * c->own->rtol < 1.0) c->foretold = fmax(c->foretold, c->reached);
    c->proposed = found.proposed;
    c->refused++;
    c->refusals++;
    p[THETA] = 0.5;
    return !(*verdict = next_size(s, p, c, now));
}

/* Prepare the first step of a march, whose size is chosen. */
static int begin_size(System *s, double *p, Control *c, double *newest)
{
    const Block now = block_at(s, newest);
    return p[H] == c->size || !change_size(s, p, c, &now, p[H]) ? DONE : SIZE;
}
