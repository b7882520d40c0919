/* Coulomb friction where contacts depend on each other, or Newton's plain iteration does not converge: proximal points, by Newton with a
   line search, as linear/complementarity/coulomb.py, equations (1) to (3); from the last forces, then from those of interior.c. Forces
   are taken where they miss the law by rates that the step's own iteration does not know; where none is it is Python's: pivoting. */

static const double FOUND = 1e-12, ENOUGH = 1e-13, SHORTEST = 1e-2; /* as in coulomb.py */
static const double ACCEPTED = 1e-10, SETTLED = 1e-9; /* where the attempt before finds no better; in groups that are not SMALL */
enum { DIRECTIONS = 12 }; /* of a solution at most */
enum { SHORT = 5, LONG = 8 }; /* iterations of an attempt before each has to halve the residual */
enum { PLAIN = 40, FEW = 8, MANY = 40, STAYS = 8 }; /* iterations at most; proximal points at most, and without half of what is left */
enum { SMALL = 40 }; /* contacts of a group which begins at its last forces, and whose accepted ones are made sharper; see ATTEMPTS */

/* Proximal points: from which forces, the first rho, iterations of a problem before each has to halve the residual, points at most,
   and whole steps before one is made shorter. */
typedef struct {
    int from;
    double rho;
    int patience, points, ahead;
} Attempt;

/* Those of sweeps from the last ones, of interior points, none. Which contacts carry a heap interior points tell in the most problems, and
   large groups begin there; small ones begin at the last forces, which tell how dependent contacts share a load.
   Where one attempt fails another does not: they fail in few problems, and in others each. Many points that begin with a large rho, whose
   problems are easy, come next: they solve 47 of 60 problems that the first two left, in a quarter of the time of the last but one. */
enum { LAST, WITHIN, NONE };
static const Attempt ATTEMPTS[] = {{LAST, 1e-6, SHORT, FEW, 3},
                                   {WITHIN, 1e-7, LONG, FEW, 5},
                                   {WITHIN, 1e-3, LONG, MANY, 5},
                                   {NONE, 1e-3, LONG, MANY, 5},
                                   {LAST, 1e-10, LONG, MANY, 8},
                                   {WITHIN, 1e-9, LONG, MANY, 12},
                                   {NONE, 1e-6, LONG, MANY, 12}};
enum { TRIES = sizeof ATTEMPTS / sizeof *ATTEMPTS, SHARPENING = 2 }; /* behind so many what is accepted ends the search */

/* Where W is known by its products a solution is some of them: the plain problem first, and no step behind a whole one. */
static const Attempt APPLIED[] = {{LAST, 0.0, PLAIN, 1, 1}, {LAST, 1e-4, LONG, MANY, 1}};
enum { TRIES_APPLIED = sizeof APPLIED / sizeof *APPLIED };
static const double EXACT = 1e-8, ROUGHLY = 1e-3; /* of what is left: solutions by blocks of W, and by products */

static double accepted_in(int m) { return m > SMALL ? SETTLED : ACCEPTED; }

/* A problem (3) with the compliance and the friction of ``of``, and the iterate that was evaluated last. */
typedef struct {
    const Problem *of;
    int m, n;
    const Attempt *with;
    double *q, *shift, *x, *u, *F, *dx, *du; /* n; dx, du: blocks d x d by point */
    int *state, *before;                      /* of points */
} Friction;

/* Gaps and slips under forces x. */
static void gaps_under(const Friction *o, int d, const double *x, double *u)
{
    open_under(o->of, d, x, u);
    for (int i = 0; i < o->n; i++) u[i] += o->q[i] - o->of->q[i] + o->shift[i] * x[i];
}

/* The function at x, u, and the status of its points. */
static void evaluated(const Contacts *c, Friction *o)
{
    const int d = c->components;
    for (int i = 0; i < o->m; i++) {
        double cn, ct;
        scales(o->of, i, d, &cn, &ct);
        double *dx = o->dx + i * d * d, *du = o->du + i * d * d;
        o->state[i] = coulomb(o->x + i * d, o->u + i * d, cn, ct, o->of->mu[i], d, o->F + i * d, dx, du);
    }
}

/* The largest of forces x that openings q ask for; large ones that cancel each other do not count. */
static double size_of(const Problem *o, int d, const double *q, const double *x)
{
    double free = 0.0, cn, ct;
    for (int i = 0; i < o->m * d; i++) {
        scales(o, i / d, d, &cn, &ct);
        free = fmax(free, fabs(cn * q[i]));
    }
    return fmax(free + fmin(largest(x, o->m * d), 1e3 * free), 1e-300);
}

/* Largest residual over the largest force, or that of the worst contact. */
static double residual_of(const Friction *o, int d)
{
    return worst_contact(o->of, d, o->q, o->x, o->F, largest(o->F, o->n) / size_of(o->of, d, o->q, o->x));
}

/* The matrix of Newton's step, du W + own, times s. */
static void slope_times(const Friction *o, int d, const double *own, const double *s, double *moved, double *y)
{
    moved_by(o->of, d, s, moved);
    for (int i = 0; i < o->n; i++) {
        const int from = i / d * d;
        y[i] = dot(own + i * d, s + from, d) + dot(o->du + i * d, moved + from, d);
    }
}

/* Blocks are eliminated in an order that is not chosen by their sizes: few directions of a solution may be wrong, and least residuals
   (Saad and Schultz, doi:10.1137/0907058) find these. H, by columns, is turned into a triangle; ``left``: of the residual. */
typedef struct {
    double H[(DIRECTIONS + 1) * DIRECTIONS], cosine[DIRECTIONS], sine[DIRECTIONS], left[DIRECTIONS + 1];
} Krylov;

/* The column k of H as the turns before leave it, and the one of its own. */
static void turn_column(Krylov *o, int k)
{
    double *h = o->H + k * (DIRECTIONS + 1);
    for (int i = 0; i < k; i++) {
        const double above = h[i], below = h[i + 1];
        h[i] = o->cosine[i] * above + o->sine[i] * below;
        h[i + 1] = o->cosine[i] * below - o->sine[i] * above;
    }

    const double size = fmax(hypot(h[k], h[k + 1]), 1e-300);
    o->cosine[k] = h[k] / size;
    o->sine[k] = h[k + 1] / size;
    h[k] = size;
    o->left[k + 1] = -o->sine[k] * o->left[k];
    o->left[k] *= o->cosine[k];
}

/* The sum of directions Z (n each) with the least residual, into s. */
static void least_of(const Krylov *o, int count, const double *Z, int n, double *s)
{
    double y[DIRECTIONS];
    memset(s, 0, n * sizeof(double));
    for (int k = count - 1; k >= 0; k--) {
        y[k] = o->left[k];
        for (int i = k + 1; i < count; i++) y[k] -= o->H[i * (DIRECTIONS + 1) + k] * y[i];
        y[k] /= o->H[k * (DIRECTIONS + 2)];
        add(s, y[k], Z + k * n, n);
    }
}

/* Newton's step s of the forces; 1 where none is found. ``work``: room for 2 + 2 DIRECTIONS vectors and an array of blocks. */
static int force_step(const Contacts *c, const Friction *o, double *s, double *work)
{
    const int d = c->components, n = o->n;
    const double enough = o->of->lumped ? ROUGHLY : EXACT;
    double *own = work, *moved = own + n * d, *Z = moved + n, *V = Z + DIRECTIONS * n, size = sqrt(dot(o->F, o->F, n));
    Blocks blocks = c->blocks;
    Krylov least = {.left = {size}};
    for (int i = 0; i < n * d; i++) own[i] = o->dx[i] + o->du[i] * o->shift[i / (d * d) * d + i % d];
    if (factor_slope(o->of, d, &blocks, o->du, own, 0.0)) return 1;
    for (int i = 0; i < n; i++) V[i] = -o->F[i] / fmax(size, 1e-300);

    for (int k = 0; k < DIRECTIONS; k++, Z += n, V += n) {
        double *h = least.H + k * (DIRECTIONS + 1), *next = V + n;
        memcpy(Z, V, n * sizeof(double));
        solve_slope(o->of, d, &blocks, Z);
        slope_times(o, d, own, Z, moved, next);
        for (int i = 0; i <= k; i++) {
            h[i] = dot(V + (i - k) * n, next, n);
            add(next, -h[i], V + (i - k) * n, n);
        }

        h[k + 1] = sqrt(dot(next, next, n));
        for (int i = 0; i < n; i++) next[i] /= fmax(h[k + 1], 1e-300);
        turn_column(&least, k);
        least_of(&least, k + 1, Z - k * n, n, s);
        if (!isfinite(least.left[k + 1])) return 1;
        if (fabs(least.left[k + 1]) <= fmax(enough * size, 1e-12 * largest(s, n))) return 0;
    }
    return !o->of->lumped; /* the search of a line takes what there is */
}

/* The iterate at forces o->x, whose squared residual is returned. */
static double arrived(const Contacts *c, Friction *o)
{
    gaps_under(o, c->components, o->x, o->u);
    evaluated(c, o);
    return dot(o->F, o->F, o->n);
}

/* Newton's iteration with a line search until the residual is small, 1, or does not fall, 0. ``work``: room for seven vectors and an
   array of blocks. */
static int searched(Contacts *c, Friction *o, double *work)
{
    const int n = o->n, d = c->components;
    double *s = work, *x = s + n, *u = x + n, *full = u + n, *rest = full + n, best = INFINITY, size;
    arrived(c, o);
    for (int k = 0; k < PLAIN; k++) {
        size = residual_of(o, d);
        if (size <= ENOUGH || !isfinite(size) || (k > o->with->patience && size > 0.5 * best)) break;
        best = fmin(best, size);

        double norm = dot(o->F, o->F, n), share = 1.0, falls = (1.0 - 1e-4) * (1.0 - 1e-4);
        int changes = 0;
        memcpy(o->before, o->state, o->m * sizeof(int));
        memcpy(x, o->x, n * sizeof(double));
        memcpy(u, o->u, n * sizeof(double));
        if (force_step(c, o, s, rest)) return 0;
        for (int i = 0; i < n; i++) o->x[i] = x[i] + s[i];

        /* whole steps, one behind the other, before one is made shorter: see _searched of coulomb.py */
        double reached = arrived(c, o);
        memcpy(full, o->u, n * sizeof(double));
        for (int left = o->with->ahead; !(reached <= falls * norm) && isfinite(reached) && --left;) {
            if (force_step(c, o, rest, rest + n)) break;
            add(o->x, 1.0, rest, n);
            reached = arrived(c, o);
        }

        for (; !(reached <= falls * norm); share *= 0.5) {
            for (int i = 0; i < n; i++) {
                o->x[i] = x[i] + share * s[i];
                o->u[i] = u[i] + share * (full[i] - u[i]);
            }
            evaluated(c, o);
            if (sqrt(dot(o->F, o->F, n)) <= (1.0 - 1e-4 * share) * sqrt(norm) || share < SHORTEST) break;
        }

        for (int i = 0; i < o->m; i++) changes += o->state[i] != o->before[i];
        c->tally.iterations++;
        c->tally.changes += changes;
    }
    return residual_of(o, d) <= FOUND;
}

/* Proximal points from the forces of a problem: the smallest residual, with its forces in ``best`` where it is smaller than ``least``. */
static double attempt(Contacts *c, const Problem *problem, const Attempt *with, double *best, double least)
{
    const int m = problem->m, d = c->components, n = m * d;
    double rho = with->rho;
    double *none = best + n, *work = none + n;
    Friction o = {.of = problem, .m = m, .n = n, .with = with, .state = c->states, .before = c->states + m}, whole;
    double **places[] = {&o.q, &o.shift, &o.x, &o.u, &o.F};

    for (int k = 0; k < 5; k++, work += n) *places[k] = work;
    o.dx = work;
    o.du = o.dx + n * d;
    work = o.du + n * d;
    memcpy(o.x, problem->f, n * sizeof(double));
    memset(none, 0, n * sizeof(double));
    whole = o;
    whole.q = problem->q;
    whole.shift = none;

    for (int k = 0, idle = 0; k < with->points; k++) {
        for (int i = 0; i < n; i++) {
            double cn, ct;
            scales(problem, i / d, d, &cn, &ct);
            o.shift[i] = rho / (i % d ? ct : cn);
            o.q[i] = problem->q[i] - o.shift[i] * o.x[i];
        }

        const int found = searched(c, &o, work);
        gaps_under(&whole, d, o.x, o.u);
        evaluated(c, &whole);
        const double size = residual_of(&whole, d), before = least;
        if (size < least) {
            least = size;
            memcpy(best, o.x, n * sizeof(double));
        }
        /* what has been found gets as sharp as it does at once, what is accepted as it does soon */
        idle = size > 0.5 * before ? idle + 1 : 0;
        if (size <= ENOUGH || !isfinite(size) || (idle && least <= FOUND) || (problem->lumped && idle > STAYS) || (idle > (m <= SMALL ? STAYS : 1) && least <= accepted_in(m))) break;
        rho = found ? 0.1 * rho : 10.0 * rho;
        rho = rho > 1.0 ? with->rho : rho;
    }
    return least;
}

/* Whether forces x miss the law by rates only that are not known; by which share of the largest force then, in ``size``. */
static int within_rates(const Contacts *c, const Problem *o, const double *x, double *size)
{
    const int d = c->components;
    double most = 0.0;
    open_under(o, d, x, o->u);
    for (int i = 0; i < o->m; i++) {
        double cn, ct, F[D], dx[D * D], du[D * D];
        scales(o, i, d, &cn, &ct);
        coulomb(x + i * d, o->u + i * d, cn, ct, o->mu[i], d, F, dx, du);
        for (int k = 0; k < d; k++)
            if (!(fabs(F[k]) <= c->rough * (k ? ct : cn))) return 0;
        most = fmax(most, largest(F, d));
    }

    *size = most / size_of(o, d, o->q, x);
    return 1;
}

/* No force where contacts are open: a rough solution leaves roundoff, which would count as a closed one. */
static void leave_open(const Problem *o, int d)
{
    for (int i = 0; i < o->m; i++) {
        double cn, ct;
        scales(o, i, d, &cn, &ct);
        if (!(o->f[i * d] > cn * o->u[i * d])) memset(o->f + i * d, 0, d * sizeof(double));
    }
}

/* Forces of a group from those in the problem, and what opens under them; 1 where none of the attempts finds them, with nothing counted.
   Where the step's iteration goes on they are made sharper at once, or serve as they are while they miss the law by rates only that it
   does not know. */
static int frictional_forces(Contacts *c, const Problem *o)
{
    const int d = c->components, n = o->m * d;
    const Attempt *all = o->lumped ? APPLIED : ATTEMPTS, *end = all + (o->lumped ? TRIES_APPLIED : TRIES);
    const Attempt *begin = all + (!o->lumped && o->m > SMALL && !c->done), *sharp = all + SHARPENING;
    Tally before = c->tally;
    double *last = c->least, *within = last + n, *best = within + n, *work = best + n, size = INFINITY;
    int known = 0, found = 0;
    memcpy(last, o->f, n * sizeof(double));

    for (const Attempt *k = begin; k < end && !found; k++) {
        c->tally.cycles += k > begin;
        if (k->from == WITHIN && !known) {
            inner_forces(c, o, work);
            sweep_forces(o, d, o->f);
            memcpy(within, o->f, n * sizeof(double));
            known = 1;
        }

        if (k->from == NONE) memset(o->f, 0, n * sizeof(double));
        else memcpy(o->f, k->from == WITHIN ? within : last, n * sizeof(double));
        size = attempt(c, o, k, best, size);
        const int suffices = k + 1 >= sharp;
        found = size <= (suffices ? accepted_in(o->m) : FOUND) || (suffices && within_rates(c, o, best, &size));
        if (!found && k == begin && c->done && (found = within_rates(c, o, last, &size))) memcpy(best, last, n * sizeof(double));
    }

    memcpy(o->f, found ? best : last, n * sizeof(double));
    open_under(o, d, o->f, o->u);
    if (!found) {
        c->tally = before;
        return 1;
    }
    if (o->lumped) leave_open(o, d);
    c->tally.residual = fmax(c->tally.residual, size);
    c->tally.solves++;
    return 0;
}
