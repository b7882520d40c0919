/* Generalized-alpha, index 3 or stabilised: the algorithm of schemes/onestep/alpha/generalized_alpha.py, many steps in one call.

   A block of a state holds t, q (nq), v (nv), a (nv), A (nv), lambda (rows). */

static const double SLOW_TURN = 0.01; /* rate of Newton above which efforts get a new tangent */
static const double WORTH = 1e3;      /* first increments, over the tolerance, that are worth a new tangent of fields at once */
enum { RENEWALS = 10 };               /* of tangents of fields in a step at most */

/* Weights of the parabola through the last steps (less at the start) at the time t. */
static void predictor(const Block *past, int known, double t, double *w)
{
    for (int i = 0; i <= known; i++) {
        w[i] = 1.0;
        for (int j = 0; j <= known; j++)
            if (j != i) w[i] *= (t - *past[j].t) / (*past[i].t - *past[j].t);
    }
}

/* Newton's judgement of an increment of this size (over the tolerance): 1 converged, -1 given up, 0 go on; as schemes/newton.py. */
int judge(double *p, const double *sizes, int done, double *error)
{
    double size = sizes[done - 1], left;
    if (!(size < INFINITY)) return -1;
    if (done == 1) {
        double guess = p[THETA] > 0.02 ? p[THETA] : 0.02;
        left = guess / (1 - (guess < 0.9 ? guess : 0.9)) * size;
    } else {
        double last = sizes[done - 2], theta = last > 0 ? size / last : 0.0;
        theta = theta > 0.999 ? 0.999 : theta < 1e-4 ? 1e-4 : theta;
        p[THETA] = theta;
        left = theta / (1 - theta) * size;
        if (size > 1.0 && done > 3 && fmin(size, last) > p[SLOW] * sizes[done - 3]) return -1; /* one bad increment is none */
    }
    *error = left;
    return left <= 1.0 || size <= 1e-3;
}

/* Whether an iteration that converges would still take more increments than its tangent is worth. */
int lingers(const double *p, int done, double left)
{
    return done > 1 && left > 1.0 && -log(left) / log(p[THETA]) > p[NEW_TANGENT];
}

/* Whether a step, whose energies go to e, gained energy from nothing, as run/judges/energy_check.py; frames are placed. */
static int gained(System *s, double *p, const Block *now, double *e)
{
    double energy, motion;
    energies(s, *now->t, now->q, now->v, s->gravity, e);
    energy = e[0] + e[1] + e[2] + e[3];
    motion = e[0] + e[1] + fabs(e[3]);
    if (motion < p[TURNOVER]) motion = p[TURNOVER];
    if (p[SETTLING] == 0.0 && energy - p[HIGHEST] > p[SHARE] * (motion + p[WEIGHT])) return 1;
    if (p[SETTLING] > 0.0) p[SETTLING] -= 1.0;
    p[TURNOVER] = motion;
    if (energy > p[HIGHEST]) p[HIGHEST] = energy;
    return 0;
}

/* Whether an iteration ended far from the increments as predicted: on another solution; as schemes/newton.py. */
static int strayed(const System *s, const double *p, const double *xi, double *begun)
{
    double near = fmax(2.0 * largest_of(s->units, begun, s->nv), 0.01 * p[LENGTH]);
    for (int i = 0; i < s->nv; i++) begun[i] = xi[i] - begun[i];
    return largest_of(s->units, begun, s->nv) > near;
}

/* Whether fields should have new tangents, as schemes/newton.py. */
static int worth_tangents(const System *s, const double *p, double first, int done, double left)
{
    int at_once = done == 1 && s->foretells && s->renewals > 1 && first > WORTH;
    return s->renewable && (at_once || lingers(p, done, left));
}

/* q and v at the end of a step, where the increment xi leads. */
static void end_of(const System *s, const double *p, const Block *now, const double *xi, Block *out)
{
    configuration(s, now->q, xi, out->q);
    for (int i = 0; i < s->nv; i++) out->v[i] = now->v[i] + p[H] * ((1 - p[GAMMA]) * now->A[i] + p[GAMMA] * out->A[i]);
}

/* Whether a step leaves out the rates of motions: it holds places alone, and these cost less. */
static int rates_wait(const System *s, const double *p) { return s->samples > 1 && p[STABILISED] == 0.0; }

/* One step from past[0] to out; past: the newest first. */
static int step(System *s, double *p, const Block *past, int known, Block out)
{
    const int n = s->nv, m = s->rows;
    const double h = p[H], am = p[AM], af = p[AF], gamma = p[GAMMA], hb = h * h * p[BETA], t = *past[0].t + h;
    const double scale = hb * (1 - af) / (1 - am), damp = h * gamma * (1 - af) / (1 - am);
    const Block now = past[0];
    double *xi = s->work, *x = xi + n, *y = x + n, *lam = y + m, *begun = lam + m, *closing = begun + n, *none = closing + n;
    double w[3], sizes[MOST], left = 0.0;
    double misfit = 0.0; /* of the springs' pulls across in the matrix */
    int verdict, far = 1, converged = 0, done = 0, afresh = s->redundant, begun_at = 0; /* of the multipliers */
    int evaluated = 0, renewals = 0;       /* whether the end was evaluated already; new tangents of fields */
    const int stable = p[STABILISED] != 0.0, width = 2 * n + m;
    double *room = s->work + s->again + n + m;
    Secants told = {.last = room, .made = room + width, .pair = room + 2 * width};
    s->share = h * p[BETA] / gamma;

    if (s->samples) {
        s->calls++;
        if (s->python(SAMPLE, rates_wait(s, p) ? PLACES : WHOLE_SAMPLE, t)) return FAILED;
    }

    predictor(past, known, t, w);
    for (int i = 0; i < n; i++) {
        out.a[i] = 0.0;
        for (int j = 0; j <= known; j++) out.a[i] += w[j] * past[j].a[i];
        out.A[i] = ((1 - af) * out.a[i] + af * now.a[i] - am * now.A[i]) / (1 - am);
        begun[i] = xi[i] = h * now.v[i] + h * h * (0.5 - p[BETA]) * now.A[i] + hb * out.A[i];
    }
    for (int i = 0; i < m; i++) {
        out.lam[i] = 0.0;
        for (int j = 0; j <= known; j++) out.lam[i] += w[j] * past[j].lam[i];
    }

    double tolerance = fmax(p[TOL] * scale * typical(s, out.a), p[FLOOR]);
    s->settled = tolerance;

    while (done < (int)p[MAXIT] && done < MOST && !converged) {
        end_of(s, p, &now, xi, &out);

        /* dependent rows: the first solution gives the multipliers themselves, of minimum norm, and not their increments */
        memcpy(lam, out.lam, m * sizeof(double));
        if (afresh) {
            memset(out.lam, 0, m * sizeof(double));
            begun_at = done;
            afresh = 0;
        }
        if (!evaluated && (verdict = evaluate(s, out.q, out.v, out.a, out.lam, t))) return verdict;
        evaluated = 0;
        /* a stiff spring has its true tension, and with it its stiffness across, only after the first increment; a law may
           have other slopes there */
        int slow = done > 0 && p[THETA] > SLOW_TURN;
        s->renewed = slow && !told.poor;
        int cheap = done == 1 && s->fields; /* beside a solution with the factor of a field */
        int turning = s->stiff && done > 0 && (s->renewed || cheap || misfit > 0.0 || misled(s) || other_slopes(s, damp, scale));
        /* what reactions push across counts where the iteration is slow without it; as predicted it may be far off */
        int impatient = done > (int)p[PATIENCE] && !s->fields && !told.poor; /* fields go on with one tangent while they converge */
        int reactions = (done > 1 && slow) || impatient;
        if (far || turning || impatient) {
            if (!far) forget(&told);
            s->led = done > 0;
            verdict = prepare(s, out.q, damp, scale, lam, reactions, t);
            s->led = 0;
            if (verdict) return verdict;
        }

        double closed = 0.0, size;
        if ((verdict = stable ? stabilised(s, scale, damp, x, closing, y, none, t) : increment(s, scale, x, y, t))) return verdict;
        /* the best tangent that there is comes first; multipliers found anew are no increments */
        if (s->redundant && done == begun_at) forget(&told);
        else if (s->leaves_out && (!s->foretells || renewals)) improve(s, &told, x, stable ? closing : NULL, y);
        if (stable) {
            closed = largest_of(s->units, closing, n);
            add(x, 1.0, closing, n);
            misfit = s->stiff ? other_pulls(s, x) : 0.0;
            add(x, -1.0, closing, n);
            for (int b = 0; b < s->bodies; b++) rate_of(xi + TWIST * b, closing + TWIST * b);
            for (int i = 0; i < n; i++) xi[i] += closing[i];
        } else misfit = s->stiff ? other_pulls(s, x) : 0.0;
        size = largest_of(s->units, x, n);
        if (!(closed <= size)) size = closed; /* nan stays */
        far = size > p[FAR];
        sizes[done++] = size / tolerance;
        for (int i = 0; i < m; i++) out.lam[i] += y[i] / scale;
        for (int b = 0; b < s->bodies; b++) rate_of(xi + TWIST * b, x + TWIST * b);
        for (int i = 0; i < n; i++) {
            xi[i] += x[i];
            out.A[i] += x[i] / hb;
            out.a[i] += x[i] / scale;
        }
        converged = judge(p, sizes, done, &left);
        if (converged > 0 && misfit * sizes[done - 1] > 1.0) converged = 0;
        int soon = learning(&told) && !s->foretells; /* earlier increments may tell what the tangent leaves out */
        if (size < INFINITY && renewals < RENEWALS && !soon && worth_tangents(s, p, sizes[0], done, left)) {
            renewals++;
            forget(&told);
            if (s->foretells) {
                end_of(s, p, &now, xi, &out);
                if ((verdict = evaluate(s, out.q, out.v, out.a, out.lam, t))) return verdict;
                evaluated = 1;
            }
            if ((verdict = take_tangents(s, x, t)) || (verdict = prepare(s, s->q, damp, scale, out.lam, 0, t))) return verdict;
            p[THETA] = 0.1;
            converged = 0;
            continue;
        }
        if (s->redundant && done == begun_at + 1 && converged > 0) converged = 0; /* the first solution leaves epsilon y open */
        if (s->redundant && converged > 0 && p[STABILISED] != 0.0 && !begun_at) { /* speeds of open rows contradict each other */
            afresh = 1;
            converged = 0;
        }
        if (converged < 0) return NEWTON;
    }
    if (!converged || (done > (int)p[PATIENCE] + 1 && !s->fields && strayed(s, p, xi, begun))) return NEWTON;

    p[ITERATIONS] += done;
    p[LEFT] += left;
    s->renewals = renewals;
    end_of(s, p, &now, xi, &out);
    if (turns_freely(s)) {
        if ((verdict = place(s, out.q, out.v))) return verdict;
        settle_angles(s, out.q);
    }
    for (int i = 0; i < n; i++) x[i] = out.A[i] - now.A[i];
    *out.t = t;
    p[LOCAL] = fmax(p[LOCAL], h * h * fabs(p[BETA] - 1.0 / 6.0) * largest_of(s->units, x, n));
    return DONE;
}

/* The error (3) of schemes/onestep/alpha/variable_alpha.py with the factor of the step that led to a state, e like v: ``a`` has the jump of
   accelerations, which ``scale`` weights and which ``missed`` is, so weighted; velocities open constraints for ``span`` (s), 0 where they hold them.
   y: its multipliers. */
EXPORT int driver_error(System *s, double scale, double span, const double *q, const double *v, const double *a, const double *lam,
                        double t, const double *missed, double *e, double *y)
{
    int verdict;
    if ((verdict = evaluate(s, q, v, a, lam, t))) return verdict;
    slips(s, 1);
    for (int i = 0; i < s->rows; i++) s->gap[i] = -span * s->slip[i];
    turn_velocity(s, missed);
    slips(s, 0);
    for (int i = 0; span == 0.0 && i < s->rows; i++) s->gap[i] = -s->slip[i];
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++) /* rows on velocities hold no places */
        for (long i = 0; k->role == ROW && k->flow && i < k->n; i++) s->gap[k->row[i]] = -s->slip[k->row[i]];
    return increment(s, -scale, e, y, t);
}
