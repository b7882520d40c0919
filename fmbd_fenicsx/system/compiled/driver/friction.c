/* Coulomb friction where contacts depend on each other, or Newton's plain iteration does not converge: Newton with a line search, and
   proximal points, the first two attempts of linear/complementarity/coulomb.py, equations (1) to (3); between them proximal points from
   the forces of interior.c. What these do not solve is Python's: pivoting. */

static const double FOUND = 1e-12, ENOUGH = 1e-13, SHORTEST = 1e-2; /* as in coulomb.py */
static const double NEAR = 1e-8; /* the first rho from forces of interior points */
enum { SHORT = 5, LONG = 8 }; /* iterations of an attempt before each has to halve the residual */
enum { PLAIN = 40, POINTS = 40, AHEAD = 5 }; /* iterations, proximal points at most; whole steps before one is made shorter */

/* A problem (3) with the compliance and the friction of ``of``, and the iterate that was evaluated last. */
typedef struct {
    const Problem *of;
    int m, n, patience;                       /* patience: iterations before each has to halve the residual */
    double *q, *shift, *x, *u, *F, *dx, *du; /* n; dx, du: blocks d x d by point */
    int state[CLOSED];
} Friction;

/* What makes gaps, and slips, of point i comparable with forces. */
static void scales(const Problem *o, int i, int d, double *cn, double *ct)
{
    const int n = o->m * d;
    *cn = 1.0 / fmax(o->W[i * d * (n + 1)], 1e-300);
    *ct = INFINITY;
    for (int k = 1; k < d; k++) *ct = fmin(*ct, 1.0 / fmax(o->W[(i * d + k) * (n + 1)], 1e-300));
}

/* Gaps and slips under forces x. */
static void gaps_under(const Friction *o, const double *x, double *u)
{
    for (int i = 0; i < o->n; i++) u[i] = o->q[i] + dot(o->of->W + i * o->n, x, o->n) + o->shift[i] * x[i];
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

/* Largest residual over the largest force; large forces that cancel each other do not count. */
static double residual_of(const Friction *o, int d)
{
    double free = 0.0, cn, ct;
    for (int i = 0; i < o->n; i++) {
        scales(o->of, i / d, d, &cn, &ct);
        free = fmax(free, fabs(cn * o->q[i]));
    }
    return largest(o->F, o->n) / fmax(free + fmin(largest(o->x, o->n), 1e3 * free), 1e-300);
}

/* The least solution of A s = b in s, by a complete orthogonal decomposition: A P = Q R of the rank found, and R = L Z. A is lost.
   Golub and Van Loan, Matrix Computations, 5.5.2. */
static void least_solution(double *A, double *b, double *s, double *work, int n)
{
    int order[3 * CLOSED], rank = 0;
    double first = 0.0;
    for (int j = 0; j < n; j++) order[j] = j;

    /* rows of R, by reflections from the left, the longest column first */
    for (; rank < n; rank++) {
        int far = rank;
        double most = -1.0;
        for (int j = rank; j < n; j++) {
            double size = 0.0;
            for (int i = rank; i < n; i++) size += A[i * n + j] * A[i * n + j];
            if (size > most) most = size, far = j;
        }
        most = sqrt(most);
        if (!rank) first = most;
        if (!(most > 1e-12 * first)) break;
        int other = order[far];
        order[far] = order[rank];
        order[rank] = other;
        for (int i = 0; i < n; i++) {
            double swap = A[i * n + far];
            A[i * n + far] = A[i * n + rank];
            A[i * n + rank] = swap;
        }
        double head = A[rank * n + rank], sign = head < 0 ? -1.0 : 1.0, square = most * (most + fabs(head));
        for (int i = rank; i < n; i++) work[i] = A[i * n + rank];
        work[rank] += sign * most;
        for (int j = rank; j <= n; j++) {
            double sum = 0.0;
            for (int i = rank; i < n; i++) sum += work[i] * (j < n ? A[i * n + j] : b[i]);
            sum /= square;
            for (int i = rank; i < n; i++) *(j < n ? A + i * n + j : b + i) -= sum * work[i];
        }
    }

    /* the part beyond the rank by reflections from the right, the last row first; they are kept in its place */
    double *head = work;
    for (int k = rank - 1; k >= 0 && rank < n; k--) {
        double *row = A + k * n, size = row[k] * row[k];
        for (int j = rank; j < n; j++) size += row[j] * row[j];
        size = sqrt(size);
        double sign = row[k] < 0 ? -1.0 : 1.0, square = size * (size + fabs(row[k]));
        head[k] = row[k] + sign * size;
        for (int i = 0; i < k; i++) {
            double *above = A + i * n, sum = head[k] * above[k];
            for (int j = rank; j < n; j++) sum += row[j] * above[j];
            sum /= square;
            above[k] -= sum * head[k];
            for (int j = rank; j < n; j++) above[j] -= sum * row[j];
        }
        row[k] = -sign * size;
    }

    /* back: the triangle, then the reflections in turn */
    for (int k = rank - 1; k >= 0; k--) {
        for (int j = k + 1; j < rank; j++) b[k] -= A[k * n + j] * b[j];
        b[k] /= A[k * n + k];
    }
    for (int k = rank; k < n; k++) b[k] = 0.0;
    for (int k = 0; k < rank && rank < n; k++) {
        double *row = A + k * n, square = head[k] * head[k], sum = head[k] * b[k];
        for (int j = rank; j < n; j++) square += row[j] * row[j], sum += row[j] * b[j];
        sum *= 2.0 / square;
        b[k] -= sum * head[k];
        for (int j = rank; j < n; j++) b[j] -= sum * row[j];
    }
    for (int k = 0; k < n; k++) s[order[k]] = b[k];
}

/* Newton's step s of the forces: least where contacts depend on each other. ``A``: two matrices. */
static void force_step(const Contacts *c, const Friction *o, double *A, double *s, double *work)
{
    const int d = c->components, n = o->n;
    double *copy = A + n * n, *b = work + n, off = 0.0, size = 0.0;
    memset(A, 0, n * n * sizeof(double));
    for (int r = 0; r < n; r++) {
        const int i = r / d, a = r % d;
        for (int k = 0; k < d; k++) {
            double slope = o->du[(i * d + a) * d + k];
            A[r * n + i * d + k] += o->dx[(i * d + a) * d + k] + slope * o->shift[i * d + k];
            if (slope != 0.0) add(A + r * n, slope, o->of->W + (i * d + k) * n, n);
        }
        s[r] = -o->F[r];
    }
    memcpy(copy, A, n * n * sizeof(double));
    if (!solve_dense(copy, n, s, 1, 1, 0.0)) {
        for (int r = 0; r < n; r++) {
            double left = dot(A + r * n, s, n) + o->F[r];
            off = left == left ? fmax(off, fabs(left)) : INFINITY;
            size = fmax(size, fabs(o->F[r]));
        }
        if (off <= 1e-8 * fmax(size, 1e-300)) return;
    }
    for (int r = 0; r < n; r++) b[r] = -o->F[r];
    least_solution(A, b, s, work, n);
}

/* The iterate at forces o->x, whose squared residual is returned. */
static double arrived(const Contacts *c, Friction *o)
{
    gaps_under(o, o->x, o->u);
    evaluated(c, o);
    return dot(o->F, o->F, o->n);
}

/* Newton's iteration with a line search until the residual is small, 1, or does not fall, 0. ``work``: room for seven vectors and two
   matrices. */
static int searched(Contacts *c, Friction *o, double *work)
{
    const int n = o->n, d = c->components;
    double *s = work, *x = s + n, *u = x + n, *full = u + n, *rest = full + n, *A = rest + 3 * n, best = INFINITY, size;
    arrived(c, o);
    for (int k = 0; k < PLAIN; k++) {
        size = residual_of(o, d);
        if (size <= ENOUGH || !isfinite(size) || (k > o->patience && size > 0.5 * best)) break;
        best = fmin(best, size);

        double norm = dot(o->F, o->F, n), share = 1.0, falls = (1.0 - 1e-4) * (1.0 - 1e-4);
        int before[CLOSED], changes = 0;
        memcpy(before, o->state, o->m * sizeof(int));
        memcpy(x, o->x, n * sizeof(double));
        memcpy(u, o->u, n * sizeof(double));
        force_step(c, o, A, s, rest);
        for (int i = 0; i < n; i++) o->x[i] = x[i] + s[i];

        /* whole steps, one behind the other, before one is made shorter: see _searched of coulomb.py */
        double reached = arrived(c, o);
        memcpy(full, o->u, n * sizeof(double));
        for (int left = AHEAD; !(reached <= falls * norm) && isfinite(reached) && --left;) {
            force_step(c, o, A, rest, rest + n);
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
        for (int i = 0; i < o->m; i++) changes += o->state[i] != before[i];
        c->tally.iterations++;
        c->tally.changes += changes;
    }
    return residual_of(o, d) <= FOUND;
}

/* Proximal points from the forces of a problem: the smallest residual, with its forces in ``best`` where it is smaller than ``least``.
   ``rho``: the first, 0 for none. */
static double attempt(Contacts *c, const Problem *problem, double rho, int patience, double *best, double least)
{
    const int m = problem->m, d = c->components, n = m * d;
    const double restart = rho;
    double *none = best + n, *work = none + n;
    Friction o = {.of = problem, .m = m, .n = n, .patience = patience}, whole;
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

    for (int k = 0; k < (rho > 0.0 ? POINTS : 1); k++) {
        for (int i = 0; i < n; i++) {
            double cn, ct;
            scales(problem, i / d, d, &cn, &ct);
            o.shift[i] = rho / (i % d ? ct : cn);
            o.q[i] = problem->q[i] - o.shift[i] * o.x[i];
        }
        int found = searched(c, &o, work);
        gaps_under(&whole, o.x, o.u);
        evaluated(c, &whole);
        double size = residual_of(&whole, d);
        if (size < least) {
            least = size;
            memcpy(best, o.x, n * sizeof(double));
        }
        if (size <= FOUND || !isfinite(size)) break;
        rho = found ? 0.1 * rho : 10.0 * rho;
        rho = rho > 1.0 ? restart : rho;
    }
    return least;
}

/* Forces of a problem with friction; 1 where two attempts do not find them, with nothing counted. */
static int frictional_forces(Contacts *c, const Problem *o)
{
    if (o->m > CLOSED) return 1;
    const int n = o->m * c->components;
    Tally before = c->tally;
    double *start = c->least, *best = start + n, size = attempt(c, o, 0.0, SHORT, best, INFINITY);
    if (!(size <= FOUND)) {
        c->tally.cycles++;
        memcpy(start, o->f, n * sizeof(double));
        inner_forces(c, o, start + n);
        size = attempt(c, o, NEAR, LONG, best, size);
        memcpy(o->f, start, n * sizeof(double));
    }
    if (!(size <= FOUND)) {
        c->tally.cycles++;
        size = attempt(c, o, 1e-4, LONG, best, size);
    }
    if (!(size <= FOUND)) {
        c->tally = before;
        return 1;
    }
    memcpy(o->f, best, o->m * c->components * sizeof(double));
    c->tally.residual = fmax(c->tally.residual, size);
    c->tally.solves++;
    return 0;
}
