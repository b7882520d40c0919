/* Generalized-alpha, index 3 or stabilised: the algorithm of schemes/onestep/alpha/generalized_alpha.py, many steps in one call.

   A block of a state holds t, q (nq), v (nv), a (nv), A (nv), lambda (rows). */

static const double SLOW_TURN = 0.01; /* rate of Newton, and share that pulls mislead it, above which efforts get a new tangent */
static const double LEAP = 1e-3;      /* of the model's length: leaps of accelerations that lead farther are no prediction */
static const double WORTH = 1e3;      /* first increments, over the tolerance, that are worth a new tangent of fields at once */
static const double BEST_RATE = 0.02; /* that a step without a second increment counts on */
static const double AS_NEW = 0.1;     /* of the tolerance: what a matrix of an earlier step may leave; its own leaves less than is told */
enum { RENEWALS = 10 };               /* of tangents of fields in a step at most */
enum { IN_RESERVE = 3 };              /* increments of a step that are left for those behind new tangents of fields */
enum { QUICK = 3 };                   /* increments that a step takes at least, where nothing is known yet */
enum { SELDOM = 15 };                 /* steps in a row that begin with new ones at most, before one is tried without */
static const double TANGENT_COST = 8.0; /* of new ones, over that of as many increments as a step has patience for */
enum { TELLING = 4 };                 /* increments whose rate tells the error, whatever pulls may have misled them */

/* Weights of the parabola through the last steps (less at the start) at the time t. */
void predictor(const Block *past, int known, double t, double *w)
{
    for (int i = 0; i <= known; i++) {
        w[i] = 1.0;
        for (int j = 0; j <= known; j++)
            if (j != i) w[i] *= (t - *past[j].t) / (*past[i].t - *past[j].t);
    }
}

/* Size (m) of an increment that counts as none in a step from q that accelerations move by so much (m); as ``small`` of
   schemes/newton.py. */
double small(const System *s, const double *p, const double *q, double accelerated)
{
    double floor = fmax(p[FLOOR], LEFT_OF_PLACES * far_from_origin(s, q, p[LENGTH]));
    return fmax(fmin(p[TOL] * accelerated, p[CEILING]), floor);
}

/* Newton's judgement of an increment of this size (over the tolerance): 1 converged, -1 given up, 0 go on; as schemes/newton.py. */
int judge(double *p, const double *sizes, int done, double *error)
{
    double size = sizes[done - 1], left;
    if (!(size < INFINITY)) return -1;

    if (done == 1) {
        double guess = p[THETA] > BEST_RATE ? p[THETA] : BEST_RATE;
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

/* The same by a matrix of an earlier step, whose rate grows with the motion since it was told, and where contacts may take part, and
   earlier steps tell what a first increment leaves; over a tolerance, m. */
static int judge_step(const System *s, double *p, const Block *now, const double *sizes, double tolerance, int done, double *error)
{
    int converged = judge(p, sizes, done, error);
    if (s->held && converged > 0) {
        if (done == 1) *error *= 1 + s->untold;
        converged = *error <= AS_NEW;
    }
    if (converged || done > 1 || !s->contact) return converged;
    *error = fmin(*error, left_as_told(s->contact, now, p[H], *sizes, tolerance));
    return *error <= 1.0;
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

/* Whether fields should have new tangents, as schemes/newton.py: the step would not end without, or increments have paid for them. */
static int worth_tangents(const System *s, const double *p, double first, int done, int ahead, double left)
{
    const int at_once = done == 1 && s->foretells && s->renewals > 1 + ahead && first > WORTH, slow = lingers(p, done, left);
    if (!s->renewable || !slow || ahead || !s->keeps_tangents) return s->renewable && (at_once || slow);

    const double made = done - log(left) / log(p[THETA]), more = p[FEWEST] > 0.0 ? fmax(made - p[FEWEST], 0.0) : 0.0;
    return made > p[MAXIT] - IN_RESERVE || p[WASTED] + more >= TANGENT_COST * p[NEW_TANGENT];
}

/* A step took so many increments and new tangents of fields, as schemes/tangent_account.py. */
static void settle(double *p, int made, int renewed)
{
    if (!renewed) p[WAIT] = 0.0;
    else if (p[BEGIN_ANEW] == 0.0 && (p[FEWEST] == 0.0 || renewed > 1)) {
        p[WAIT] = fmin(2.0 * p[WAIT] + 1.0, SELDOM);
        p[BEGIN_ANEW] = p[WAIT] + 1.0;
    }
    if (renewed < 2 && made <= QUICK) p[BEGIN_ANEW] = fmax(p[BEGIN_ANEW] - 1.0, 0.0);
    p[FEWEST] = renewed ? 0.0 : p[FEWEST] > 0.0 ? fmin(p[FEWEST], made) : made;
    p[WASTED] = renewed ? 0.0 : p[WASTED] + made - p[FEWEST];
}

/* Whether a step leaves out the rates of motions: it holds places alone, and these cost less. */
static int rates_wait(const System *s, const double *p) { return s->samples > 1 && p[STABILISED] == 0.0; }

/* A step as it is made: from ``now`` to ``out``, by increments of Newton's iteration. */
typedef struct {
    Block now, out;
    int stable;                        /* whether the form is stabilised */
    double t, hb, scale, damp;         /* of the end; h^2 beta; weights of the matrix */
    double tolerance;                  /* of increments, m */
    double *xi, *begun;                /* the increment of the step, and as predicted */
    double *x, *closing, *y;           /* the newest of the iteration; closing: of joints, in the stabilised form */
    double *lam, *none;                /* multipliers of the matrix; those of the closing, which nobody asks for */
    double sizes[MOST], left;          /* of increments, and the error after the newest, over the tolerance */
    double misfit;                     /* of the springs' pulls across in the matrix */
    int done, hesitations;             /* increments; those that were made as laws were undecided */
    int served, far;                   /* whether it began with a matrix of an earlier step; whether its matrix is far from the state */
    int renewed;                       /* whether a later increment than the first had a new matrix */
    int touching;                      /* contacts that take part */
    int grown;                         /* increments of bodies with an energy that were larger than the one before */
    int evaluated, renewals, ahead;    /* whether the end was evaluated already; new tangents of fields; whether it began with some */
    Secants told;
} AlphaStep;

static void begin(System *s, const double *p, Block now, Block out, AlphaStep *k)
{
    const int n = s->nv, m = s->rows, width = 2 * n + m;
    const double h = p[H], am = p[AM], af = p[AF];
    double *xi = s->work, *x = xi + n, *y = x + n, *lam = y + m, *begun = lam + m, *closing = begun + n;
    double *room = s->work + s->again + n + m;

    *k = (AlphaStep){.now = now, .out = out, .stable = p[STABILISED] != 0.0, .t = *now.t + h};
    k->hb = h * h * p[BETA];
    k->scale = k->hb * (1 - af) / (1 - am);
    k->damp = h * p[GAMMA] * (1 - af) / (1 - am);
    k->served = s->held && s->cd == k->damp && s->ck == k->scale;
    k->far = !k->served;
    k->xi = xi, k->begun = begun;
    k->x = x, k->closing = closing, k->y = y;
    k->lam = lam, k->none = closing + n;
    k->told = (Secants){.last = room, .made = room + width, .pair = room + 2 * width};
    s->share = h * p[BETA] / p[GAMMA];
}

/* Whether the newest of these accelerations is farther from where the others lead (by their weights w) than they are large, by more than
   ``much``: steps do not resolve such motion, and where all lead is far off. */
static int leaps(const Block *past, int known, const double *w, int i, double much)
{
    double miss = past[0].a[i], size = fabs(past[0].a[i]);
    for (int j = 1; j <= known; j++) {
        miss -= w[j - 1] * past[j].a[i];
        size = fmax(size, fabs(past[j].a[i]));
    }
    return fabs(miss) > fmax(size, much);
}

/* Accelerations and multipliers as those of the last steps go on; where those of bodies with an energy leap, places go on with velocities. */
static void predict(System *s, const double *p, const Block *past, int known, AlphaStep *k)
{
    const int n = s->nv, m = s->rows;
    const double h = p[H], am = p[AM], af = p[AF], even = (0.5 - p[BETA]) / p[BETA];
    const Block now = k->now, out = k->out;
    const int judged = known > 0 && p[EVENS] != 0.0 && s->foretells, frames = TWIST * s->bodies;
    double w[3], before[3];

    predictor(past, known, k->t, w);
    if (judged) predictor(past + 1, known - 1, *now.t, before);
    for (int i = 0; i < n; i++) {
        out.a[i] = 0.0;
        for (int j = 0; j <= known; j++) out.a[i] += w[j] * past[j].a[i];
        if (judged && i >= frames && leaps(past, known, before, i, LEAP * p[LENGTH] / (k->scale * s->units[i]))) out.a[i] = ((am - (1 - am) * even) * now.A[i] - af * now.a[i]) / (1 - af);
        out.A[i] = ((1 - af) * out.a[i] + af * now.a[i] - am * now.A[i]) / (1 - am);
        k->begun[i] = k->xi[i] = h * now.v[i] + h * h * (0.5 - p[BETA]) * now.A[i] + k->hb * out.A[i];
    }

    for (int i = 0; i < m; i++) {
        out.lam[i] = 0.0;
        for (int j = 0; j <= known; j++) out.lam[i] += w[j] * past[j].lam[i];
    }

    k->tolerance = small(s, p, now.q, k->scale * typical(s, out.a));
    s->settled = k->tolerance;
}

/* q and v at the end of a step, where its increment leads. */
static void follow(const System *s, const double *p, const AlphaStep *k)
{
    const Block now = k->now, out = k->out;
    configuration(s, now.q, k->xi, out.q);
    for (int i = 0; i < s->nv; i++) out.v[i] = now.v[i] + p[H] * ((1 - p[GAMMA]) * now.A[i] + p[GAMMA] * out.A[i]);
}

/* The system where the increment leads. */
static int evaluate_end(System *s, const double *p, AlphaStep *k)
{
    const Block out = k->out;
    follow(s, p, k);

    /* dependent rows: the first solution gives the multipliers themselves, of minimum norm, and not their increments */
    memcpy(k->lam, out.lam, s->rows * sizeof(double));
    if (s->redundant && !k->done) memset(out.lam, 0, s->rows * sizeof(double));
    int known = k->evaluated;
    k->evaluated = 0;
    return known ? DONE : evaluate_iterate(s, k->done, out.q, out.v, out.a, out.lam, k->t);
}

/* A new matrix, where the one at hand is not that of the state evaluated. */
static int linearise(System *s, const double *p, AlphaStep *k)
{
    if (k->touching && k->done) return DONE; /* velocities of closed contacts follow from the matrix of a step's beginning */
    int later = k->done > 0, slow = later && p[THETA] > SLOW_TURN;
    int impatient = k->done > (int)p[PATIENCE] && !s->fields && !k->told.poor; /* fields go on with one tangent while they converge */

    /* a stiff spring has its true tension, and with it its stiffness across, only after the first increment; a law may
       have other slopes there */
    s->renewed = slow && !k->told.poor;
    int cheap = k->done == 1 && s->fields; /* beside a solution with the factor of a field */
    int turning = s->stiff && later
                  && (s->renewed || s->bridged || cheap || k->misfit > SLOW_TURN || misled(s) || other_slopes(s, k->damp, k->scale));
    if (!(k->far || turning || impatient)) return DONE;

    /* what reactions push across counts where they push hard, or the iteration is slow without it; as predicted it may be far off */
    const int reactions = (k->done > 1 && slow) || impatient ? EVERY_PUSH : HARD_PUSH;
    if (!k->far) forget(&k->told);
    s->led = later;
    int verdict = prepare(s, k->out.q, k->damp, k->scale, k->lam, reactions, k->t);
    s->led = 0;
    k->renewed |= later;
    if (k->touching) contact_factored(s, s->contact, k->out.q);
    return verdict;
}

/* The newest increment of the iteration; pressures that are unknowns move along. */
static int solve(System *s, AlphaStep *k)
{
    const Body *const end = s->body + (s->fields ? s->bodies : 0);
    for (const Body *o = s->body; o < end; o++)
        if (o->field) close_volume(o, o->field->force);
    const Contacting at = {k->t, k->t, *k->now.t, k->t - *k->now.t, k->scale, k->out.q, k->out.q, k->xi, NULL, NULL};
    int verdict = k->touching ? contact_increment(s, s->contact, &at, k->x, k->y)
                  : k->stable ? stabilised(s, k->scale, k->damp, k->x, k->closing, k->y, k->none, k->t)
                              : increment(s, k->scale, k->x, k->y, k->t);
    if (verdict) return verdict;
    for (const Body *o = s->body; o < end; o++)
        if (o->field) move_pressure(o, k->x);

    /* the best tangent that there is comes first; multipliers found anew are no increments */
    if (k->touching) return DONE;
    if (s->redundant && k->done == 0) forget(&k->told);
    else if (s->leaves_out && (!s->foretells || k->renewals)) improve(s, &k->told, k->x, k->stable ? k->closing : NULL, k->y);
    return DONE;
}

/* The increment xi goes on by a change x, like v. */
static void go_on(const System *s, double *xi, double *x)
{
    for (int b = 0; b < s->bodies; b++) rate_of(xi + TWIST * b, x + TWIST * b);
    for (int i = 0; i < s->nv; i++) xi[i] += x[i];
}

/* Take the newest increment. */
static void take(System *s, const double *p, AlphaStep *k)
{
    const int n = s->nv;
    const Block out = k->out;
    double closed = 0.0;

    if (k->stable) {
        closed = largest_of(s->units, k->closing, n);
        add(k->x, 1.0, k->closing, n);
        k->misfit = s->stiff ? other_pulls(s, k->x) : 0.0;
        add(k->x, -1.0, k->closing, n);
        go_on(s, k->xi, k->closing);
    } else k->misfit = s->stiff ? other_pulls(s, k->x) : 0.0;

    const double size = worse(largest_of(s->units, k->x, n), closed);
    k->far = size > p[FAR];
    k->sizes[k->done++] = size / k->tolerance;

    for (int i = 0; i < s->rows; i++) out.lam[i] += k->y[i] / k->scale;
    go_on(s, k->xi, k->x);
    for (int i = 0; i < n; i++) {
        out.A[i] += k->x[i] / k->hb;
        out.a[i] += k->x[i] / k->scale;
    }
}

/* Whether the tangents of fields should be taken anew: earlier increments may tell what they leave out. */
static int outworn(const System *s, const double *p, const AlphaStep *k)
{
    int soon = learning(&k->told) && !s->foretells;
    return k->sizes[k->done - 1] < INFINITY && k->renewals < RENEWALS && !soon
           && worth_tangents(s, p, k->sizes[0], k->done, k->ahead, k->left);
}

/* New tangents of fields, where the newest increment led. */
static int renew_tangents(System *s, double *p, AlphaStep *k)
{
    const Block out = k->out;
    int verdict;

    k->renewals++;
    forget(&k->told);
    if (s->foretells) {
        follow(s, p, k);
        if ((verdict = evaluate(s, out.q, out.v, out.a, out.lam, k->t))) return verdict;
        k->evaluated = 1;
    }
    if ((verdict = take_tangents(s, k->x, 0, k->t))) return verdict;
    p[THETA] = 0.1;
    return prepare(s, s->q, k->damp, k->scale, out.lam, 0, k->t);
}

/* New tangents of fields where the step is predicted, while those of a step do not serve the next one. */
static int begin_anew(System *s, double *p, AlphaStep *k)
{
    const Block out = k->out;
    int verdict;
    if (!s->begins || p[BEGIN_ANEW] == 0.0 || k->touching) return DONE;
    k->renewals = k->ahead = 1;
    k->evaluated = 1;
    follow(s, p, k);
    if ((verdict = evaluate(s, out.q, out.v, out.a, out.lam, k->t))) return verdict;
    if ((verdict = take_tangents(s, k->xi, 1, k->t))) return verdict;
    return prepare(s, s->q, k->damp, k->scale, out.lam, 0, k->t);
}

/* New tangents of fields whose one-sided springs are others where the iterate was evaluated: Newton's own matrix there. */
static int take_switched(System *s, AlphaStep *k)
{
    int switched = 0;
    for (int b = 0; s->fields && b < s->bodies; b++) {
        const Field *e = s->body[b].field;
        switched |= e && e->droppers && e->droppers->switched;
    }
    if (!switched || k->touching) return DONE;
    k->far = 1;
    return take_tangents(s, k->xi, 0, k->t);
}

/* Whether an increment of bodies with an energy has grown, as ``grew`` of schemes/newton.py. */
static int grew(const System *s, const AlphaStep *k)
{
    return s->foretells && k->done > 1 && k->sizes[k->done - 1] > fmax(WORTH, k->sizes[k->done - 2]);
}

/* Newton's iteration for the end of the step. */
static int iterate(System *s, double *p, AlphaStep *k)
{
    const int most = (int)fmin(p[MAXIT], MOST);
    int verdict = begin_anew(s, p, k), converged = 0;
    if (verdict) return verdict;

    while (!converged) {
        if (k->done == most) return NEWTON;
        if ((verdict = evaluate_end(s, p, k)) || (verdict = take_switched(s, k))) return verdict;
        if ((verdict = linearise(s, p, k))) return verdict;
        if ((verdict = solve(s, k))) return verdict;
        take(s, p, k);
        k->grown += grew(s, k);

        converged = judge_step(s, p, &k->now, k->sizes, k->tolerance, k->done, &k->left);
        if (k->done == 1 && k->sizes[0] <= WORTH) k->renewals = 0; /* it was not worth one */
        const int old = outworn(s, p, k);
        if (old && k->touching && !goes_on_slowly(s->contact)) return NEWTON;

        if (old && !k->touching) {
            if ((verdict = renew_tangents(s, p, k))) return verdict;
            converged = 0;
        } else if (converged < 0 && !(s->bridged && k->sizes[k->done - 1] < INFINITY)) return NEWTON;
        else if (converged > 0 && s->stiff && k->hesitations < HESITATIONS && undecided(s, k->scale, k->x)) {
            k->hesitations++;
            converged = 0;
        } else if (s->bridged || (k->done < TELLING && k->misfit * k->sizes[k->done - 1] > 1.0)) converged = 0;
    }
    return k->done > (int)p[PATIENCE] + 1 && !s->fields && strayed(s, p, k->xi, k->begun) ? NEWTON : DONE;
}

/* Newton's iteration from where the last steps lead, and its end. */
static int find_end(System *s, double *p, const Block *past, int known, AlphaStep *k)
{
    const Block out = k->out;
    int verdict;
    predict(s, p, past, known, k);
    k->touching = s->contact && start_forces(s, s->contact, past);
    if ((verdict = iterate(s, p, k))) return verdict;

    p[ITERATIONS] += k->done;
    follow(s, p, k);
    if (turns_freely(s)) {
        if ((verdict = place(s, out.q, out.v))) return verdict;
        settle_angles(s, out.q);
    }
    *out.t = k->t;
    if (k->grown) {
        s->calls++;
        const int told = s->python(LOOK_AT_END, 0, k->t);
        if (told) return told == OUTSIDE ? NEWTON : FAILED;
    }
    if (s->contact) iterated(s->contact, past, &out, p[H], k->sizes, k->tolerance, k->done);
    return DONE;
}

/* Whether the matrix of a step that was found serves the next one. A dear one does (see is_dear()), while it takes no more increments
   than when it was new, or converges as fast as a step counts on. Each one in a row that fails a step lets twice as many go without. */
static void hold(System *s, const double *p, const AlphaStep *k)
{
    const int is_new = !s->held, told = k->done > 1, failed = k->served && k->renewed;
    if (failed) s->pause = s->without = 2 * s->pause + 1;
    else if (k->served) s->pause = 0;
    else if (s->without) s->without--;

    if (is_new) s->first_took = k->done;
    s->untold = is_new || told ? 1 : s->untold + 1;
    s->held = s->dear && !s->without && !k->renewed && !s->redundant && (is_new || k->done <= s->first_took || p[THETA] <= BEST_RATE);
}

/* One step, as a Maker of march.c. */
static int alpha_step(System *s, double *p, double *free_room, const Block *past, int known, Block out)
{
    AlphaStep k;
    double asked = NAN;
    int verdict;
    (void)free_room; /* it works in the tables' */

    begin(s, p, past[0], out, &k);
    if (s->contact && (verdict = begin_contact(s, s->contact, p[H], past, NULL))) return verdict;
    if (!rates_wait(s, p) && (verdict = sample(s, k.t, &asked))) return verdict;
    if (rates_wait(s, p)) {
        s->calls++;
        if (s->python(SAMPLE, PLACES, k.t)) return FAILED;
    }
    const double theta = p[THETA];
    verdict = find_end(s, p, past, known, &k);
    if (verdict == NEWTON && s->held) {
        s->held = 0;
        p[THETA] = theta;
        begin(s, p, past[0], out, &k);
        verdict = find_end(s, p, past, known, &k);
    }
    if (verdict) return verdict;

    while (s->contact && met_others(s->contact, &out, &verdict)) {
        begin(s, p, past[0], out, &k);
        if ((verdict = find_end(s, p, past, known, &k))) return verdict;
    }
    if (verdict) return verdict;

    p[LEFT] += k.left;
    s->renewals = k.renewals;
    settle(p, k.done, k.renewals);
    hold(s, p, &k);
    const double h = p[H], to_A = 1.0 / (p[GAMMA] * h);
    const Persisting end = {h, k.scale, k.scale / (p[BETA] * h) * p[GAMMA], to_A, (1 - p[AM]) / (1 - p[AF]) * to_A};
    if (k.touching && (verdict = persist(s, s->contact, &end, past, &out))) return verdict;
    for (int i = 0; i < s->nv; i++) k.x[i] = out.A[i] - k.now.A[i];
    p[LOCAL] = fmax(p[LOCAL], h * h * fabs(p[BETA] - 1.0 / 6.0) * largest_of(s->units, k.x, s->nv));
    return DONE;
}

/* The error (2) of schemes/onestep/alpha/variable_alpha.py, e like v, with the factor at hand, that of the step which led to a state, or with
   one of the matrix there where ``weights`` of C and K are given: ``a`` has the jump of accelerations, which ``scale`` weights and which
   ``missed`` is, so weighted; velocities open constraints for ``span`` (s), 0 where they hold them. y: its multipliers. */
static int filtered(System *s, double scale, double span, const double *weights, const double *q, const double *v, const double *a,
                    const double *lam, double t, const double *missed, double *e, double *y)
{
    int verdict;
    if ((verdict = evaluate(s, q, v, a, lam, t))) return verdict;
    if (weights && (verdict = prepare(s, q, weights[0], weights[1], lam, 0, t))) return verdict;

    slips(s, 1);
    for (int i = 0; i < s->rows; i++) s->gap[i] = -span * s->slip[i];
    turn_velocity(s, missed);
    slips(s, 0);
    for (int i = 0; span == 0.0 && i < s->rows; i++) s->gap[i] = -s->slip[i];
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++) /* rows on velocities hold no places */
        for (long i = 0; k->role == ROW && k->flow && i < k->n; i++) s->gap[k->row[i]] = -s->slip[k->row[i]];
    return increment(s, -scale, e, y, t);
}

/* The same for Python. */
EXPORT int driver_error(System *s, double scale, double span, const double *weights, const double *q, const double *v, const double *a,
                        const double *lam, double t, const double *missed, double *e, double *y)
{
    return filtered(s, scale, span, weights, q, v, a, lam, t, missed, e, y);
}
