/* Error control of steps of one size: the norm of schemes/error_norm.py (NormOfWays) for errors of positions, and whether the next step
   has this size too, as schemes/onestep/alpha/variable_alpha.py decides it. Every other decision is Python's. */

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
static void reach(Control *c, double h, const Block *now)
{
    const double *q = now->q;
    memcpy(c->faster, c->fastest, 2 * sizeof(double));
    for (int i = 0; c->laws && i < TWIST * c->frames; i++) {
        double *known = c->faster + (i % TWIST >= D);
        *known = fmax(*known, fmax(fabs(now->v[i]), h * fabs(now->a[i])));
    }

    c->reached = c->way;
    for (int b = 0; c->way < 1.0 && b < c->frames; b++) { /* longer ways count as one */
        const double *from = c->origin + POSE * b, *to = q + POSE * b;
        for (int i = 0; i < D; i++) c->reached = fmax(c->reached, fabs(to[i] - from[i]) / c->length);
        c->reached = fmax(c->reached, turned(from, to));
    }

    for (Deflection *x = c->deflection; x < c->deflection + c->deforming; x++) {
        x->reached = fmax(x->size, 1e-2 * c->length);
        for (int i = 0; i < x->n; i++) x->reached = fmax(x->reached, fabs((x->rms ? x->rms[i] : 1.0) * q[x->at_q + i]));
    }
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
static double allowed_error(const Control *c, double size, double unknown, double fastest, double h)
{
    const double places = c->rtol * size + c->atol;
    return h > 0.0 ? c->rtol * fastest + (1e-4 * places + unknown) / h : places;
}

/* Root mean square of the core, or that of the worst field; of frames without what they do beside the mass of their body. ``h``: as above. */
static double error_norm(const System *s, const Control *c, const double *q, const double *e, double h)
{
    const double share = fmax(fmin(c->reached, 1.0), c->least), per = h > 0.0 ? h : 1.0;
    double core = 0.0, worst = 0.0;
    for (int b = 0; b < c->frames; b++) {
        double own[TWIST], R[D * D], bent[TWIST] = {0.0};
        if (hangs(s->body + b)) {
            rotation(q + POSE * b, R);
            bend_frame(s->body + b, R, e, e + TWIST * b, bent);
        }

        for (int i = 0; i < TWIST; i++) own[i] = e[TWIST * b + i] - bent[i];
        core += squares(own, D, allowed_error(c, share * c->length, c->unknown, c->faster[0], h));
        core += squares(own + D, ROT, allowed_error(c, share, c->unknown / c->length, c->faster[1], h));
    }

    for (const Deflection *x = c->deflection; x < c->deflection + c->deforming; x++) {
        for (int i = 0; x->rms && i < x->n; i++)
            core += squares(e + x->at_v + i, 1, (c->rtol * x->reached / x->rms[i] + c->atol) / per);
        double mean = x->rms ? 0.0 : squares(e + x->at_v, x->n, (c->rtol * x->reached + c->atol) / per) / x->n;
        if (!(mean <= worst)) worst = mean; /* nan stays */
    }
    if (c->core && !(core / c->core <= worst)) worst = core / c->core;
    return sqrt(worst);
}

static const double FAR_JUMP = 1e6; /* times accelerations of a state */

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
        c->missed[i] = scale * (out->a[i] - led);
    }
    /* the balance is linear in accelerations: a jump that is large beside what Newton's iteration leaves of them */
    const double jump = FAR_JUMP * fmax(typical(s, past->a), typical(s, out->a)), part = largest_of(s->units, c->missed, s->nv) / jump;
    double found = *error;
    if (!(error_norm(s, c, out->q, c->missed, h) > fmax(found, c->calm))) return DONE; /* less is what Newton's iteration leaves */

    for (int k = 0; k < 2; k++) {
        const Block *at = ends[k];
        for (int i = 0; i < s->nv; i++) c->a[i] = at->a[i] + c->missed[i] / part;
        if ((verdict = sample(s, *at->t, &asked))) return verdict;
        if ((verdict = filtered(s, part, 0.0, weights, at->q, at->v, c->a, at->lam, *at->t, c->missed, c->e, c->y))) return verdict;
        found = fmax(found, error_norm(s, c, out->q, c->e, h));
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
        c->missed[i] = scale * jump;
    }
    const double span = p[STABILISED] != 0.0 ? 0.0 : 0.5 * p[H];
    int verdict = filtered(s, scale, span, NULL, out->q, out->v, c->a, out->lam, *out->t, c->missed, c->e, c->y);
    if (verdict) return verdict;

    reach(c, p[H], out);
    c->unknown = small(s, p, out->q, 0.0);
    double error = error_norm(s, c, out->q, c->e, 0.0);
    if (error <= 1.0 && c->laws && p[HISTORY] >= 1.0 && (verdict = with_speeds(s, p, c, past, out, &error))) return verdict;
    if (!(error <= 1.0)) return SIZE;

    c->before = fmax(c->error, c->floor);
    c->error = error;
    c->largest = fmax(c->largest, error);
    c->peak = fmax(error, c->fading * c->peak);
    c->way = c->reached;
    memcpy(c->fastest, c->faster, 2 * sizeof(double));
    for (Deflection *x = c->deflection; x < c->deflection + c->deforming; x++) x->size = x->reached;
    return DONE;
}

/* Give an accepted state the time that the parts of the stretch tell. */
static void arrive(Control *c, Block *out)
{
    if (c->place == c->count) { /* the next one is as long */
        c->place = 0;
        c->end += c->stretch;
    }
    *out->t = c->end - c->stretch * ((double)(c->count - c->place - 1) / (double)c->count);
}

/* Whether the step after an accepted one has this size too and needs no look at loads. */
static int stays(const double *p, Control *c, const Block *now)
{
    double pressure = fmax(c->error, c->error * c->error / c->before), far = farthest_turn((int)c->frames, c->turn, 1.0, now);
    c->place++;
    int unseen = c->peak <= c->calm && *now->t + p[H] > c->quiet;
    if (pressure > c->high || unseen || p[H] > far || *now->t >= c->until) return 0;
    return !(c->ratio && c->place % c->ratio == 0 && fmax(pressure, c->peak) <= c->low && c->ratio * p[H] <= far);
}
