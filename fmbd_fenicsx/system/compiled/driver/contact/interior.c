/* Coulomb friction by interior points: forces x and openings u of every contact stay within their cones, and are led to where they are
   perpendicular to each other. What is to be decided on much smaller speeds than the impact's, which contacts of a heap at rest carry
   its weight, is found in some twenty iterations; Newton's iteration of friction.c then has the contacts' states right.

       u = q + W x + mu |u_t| e_n,    K contains x,    K* contains u,    x . u = 0                                       (1)

   With x_t / mu and mu u_t both cones are that of a sphere, and the last term (de Saxce and Feng,
   doi:10.1016/S0895-7177(98)00119-8) is |u_t| then. Steps in the scaling of Nesterov and Todd (doi:10.1137/S1052623495290209), with
   Mehrotra's corrector. */

enum { INNER = 60, STALLED = 5 };      /* iterations at most; those without half of what is left */
static const double BEHIND = 0.1;      /* x . u is not led below this share of what (1) lacks: else steps get short */
static const double SHARP = 1e-12;      /* of the forces: what (1) lacks is not known to less */
static const double NEARLY = 0.9;      /* share of the way to the boundary: nearer to it more problems end at kinks of |u_t| */
static const double SUFFICES = 1e-10;  /* of both that (1) lacks: the friction's states are right then, and Newton's iteration goes on */

/* An iterate of m contacts in d components: all of them m x d, N of Nesterov and Todd m x d x d. */
typedef struct {
    int m, d;
    double *T, *q, *x, *u, *r, *dx, *du, *near, *N, *inverse; /* T: scale of forces; near: N u = N^-1 x */
    double *scale, *own;                                      /* T as blocks; (1 - e_n t^T) N^-2; both m x d x d */
    Blocks *blocks;
} Interior;

/* sqrt(x_0^2 - |x_1|^2) */
static double inside(const double *x, int d)
{
    double across = sqrt(dot(x + 1, x + 1, d - 1));
    return sqrt(fmax((x[0] - across) * (x[0] + across), 1e-300));
}

/* The longest step a <= 1 / (what is returned) for which x + a dx is within the cone. */
static double shortness(const double *x, const double *dx, int d)
{
    const double size = inside(x, d), along = (x[0] * dx[0] - dot(x + 1, dx + 1, d - 1)) / size;
    double across = 0.0;
    for (int i = 1; i < d; i++) {
        double part = dx[i] - (along + dx[0]) / (x[0] / size + 1.0) * x[i] / size;
        across += part * part;
    }
    return (sqrt(across) - along) / size;
}

/* N with N u = N^-1 x, symmetric, and its inverse. */
static void scaling(const double *x, const double *u, int d, double *N, double *inverse)
{
    const double sx = inside(x, d), su = inside(u, d), eta = sqrt(sx / su), both = sqrt(0.5 * (1.0 + dot(x, u, d) / (sx * su)));
    double v[D];
    for (int i = 0; i < d; i++) v[i] = (x[i] / sx + (i ? -1.0 : 1.0) * u[i] / su) / (2.0 * both);
    const double size = sqrt(2.0 * (v[0] + 1.0));
    v[0] += 1.0;
    for (int i = 0; i < d; i++) v[i] /= size;

    for (int i = 0; i < d; i++)
        for (int j = 0; j < d; j++) {
            const double mirror = i != j ? 0.0 : i ? -1.0 : 1.0, sign = (i ? -1.0 : 1.0) * (j ? -1.0 : 1.0);
            N[i * d + j] = eta * (2.0 * v[i] * v[j] - mirror);
            inverse[i * d + j] = (2.0 * sign * v[i] * v[j] - mirror) / eta;
        }
}

static void product_of_cone(const double *a, const double *b, int d, double *out)
{
    double head = dot(a, b, d);
    for (int i = 1; i < d; i++) out[i] = a[0] * b[i] + b[0] * a[i];
    out[0] = head;
}

/* z of l o z = r */
static void quotient_of_cone(const double *l, const double *r, int d, double *z)
{
    const double square = inside(l, d) * inside(l, d), along = dot(l + 1, r + 1, d - 1);
    z[0] = (l[0] * r[0] - along) / square;
    for (int i = 1; i < d; i++) z[i] = (square / l[0] * r[i] + (along / l[0] - r[0]) * l[i]) / square;
}

static void small_product(const double *A, const double *x, int d, double *y)
{
    for (int i = 0; i < d; i++) y[i] = dot(A + i * d, x, d);
}

/* r of (1), into o->r; the largest, and x . u over the number of contacts. */
static double lacking(const Problem *of, Interior *o, double *gap)
{
    const int d = o->d, n = o->m * d;
    double *forces = o->dx, *moved = o->du, most;
    for (int i = 0; i < n; i++) forces[i] = o->T[i] * o->x[i];
    moved_by(of, d, forces, moved);
    for (int i = 0; i < n; i++) o->r[i] = o->u[i] - o->q[i] - o->T[i] * moved[i];
    for (int i = 0; i < n; i += d) o->r[i] -= sqrt(dot(o->u + i + 1, o->u + i + 1, d - 1));
    most = largest(o->r, n);
    *gap = dot(o->x, o->u, n) / o->m;
    return most;
}

/* (1 - e_n t^T) y for the direction t of the slip. */
static void without_slip(const double *u, int d, double *y)
{
    const double size = sqrt(dot(u + 1, u + 1, d - 1));
    if (size > 0.0) y[0] -= dot(u + 1, y + 1, d - 1) / size;
}

/* Scalings at the iterate, and the factored matrix of its steps: W + (1 - e_n t^T) N^-2. 1 where it has none. */
static int begin_steps(const Problem *of, Interior *o)
{
    const int d = o->d;
    for (int i = 0; i < o->m; i++) {
        double *inverse = o->inverse + i * d * d, column[D];
        scaling(o->x + i * d, o->u + i * d, d, o->N + i * d * d, inverse);
        small_product(o->N + i * d * d, o->u + i * d, d, o->near + i * d);
        for (int j = 0; j < d; j++) {
            small_product(inverse, inverse + j * d, d, column);
            without_slip(o->u + i * d, d, column);
            for (int k = 0; k < d; k++) o->own[(i * d + k) * d + j] = column[k];
        }
    }

    load_blocks(of, d, o->blocks, o->scale, o->T, o->own);
    return factor_blocks(of, d, o->blocks, 0.0);
}

/* The step for x o u = ``right`` (scaled, m x d, lost), into dx, du. */
static void take_step(const Problem *of, Interior *o, double *right)
{
    const int d = o->d;
    for (int i = 0; i < o->m; i++) {
        double z[D], *b = o->dx + i * d;
        quotient_of_cone(o->near + i * d, right + i * d, d, z);
        small_product(o->inverse + i * d * d, z, d, right + i * d);
        memcpy(b, right + i * d, d * sizeof(double));
        without_slip(o->u + i * d, d, b);
        add(b, 1.0, o->r + i * d, d);
    }

    solve_blocks(of, d, o->blocks, o->dx);
    for (int i = 0; i < o->m; i++) {
        double once[D], twice[D];
        small_product(o->inverse + i * d * d, o->dx + i * d, d, once);
        small_product(o->inverse + i * d * d, once, d, twice);
        for (int k = 0; k < d; k++) o->du[i * d + k] = right[i * d + k] - twice[k];
    }
}

/* The longest step, at most 1, within a share of the way to the boundary. */
static double step_length(const Interior *o, double share)
{
    double shortest = 0.0;
    for (int i = 0; i < o->m * o->d; i += o->d)
        shortest = fmax(shortest, fmax(shortness(o->x + i, o->dx + i, o->d), shortness(o->u + i, o->du + i, o->d)));
    return fmin(1.0, share / fmax(shortest, 1e-300));
}

/* One iteration; ``right``: room for m x d. 1 where the matrix is singular or numbers are lost. */
static int inner_step(const Problem *of, Interior *o, double gap, double most, double *right)
{
    const int d = o->d, n = o->m * d;
    if (begin_steps(of, o)) return 1;
    for (int i = 0; i < n; i += d) {
        product_of_cone(o->near + i, o->near + i, d, right + i);
        for (int k = 0; k < d; k++) right[i + k] = -right[i + k];
    }
    take_step(of, o, right);

    const double far = largest(o->x, n);
    double length = step_length(o, 1.0), ahead = 0.0, share;
    for (int i = 0; i < n; i++) ahead += (o->x[i] + length * o->dx[i]) * (o->u[i] + length * o->du[i]) / o->m;
    share = ahead / gap * (ahead / gap) * (ahead / gap);
    share = fmin(fmax(fmax(share, 1e-6), BEHIND * fmax(most - SHARP * far, 0.0) * far / gap), 1.0);

    for (int i = 0; i < n; i += d) {
        double a[D], b[D], second[D];
        small_product(o->inverse + i * d, o->dx + i, d, a);
        small_product(o->N + i * d, o->du + i, d, b);
        product_of_cone(a, b, d, second);
        product_of_cone(o->near + i, o->near + i, d, a);
        for (int k = 0; k < d; k++) right[i + k] = -a[k] - second[k] + (k ? 0.0 : share * gap);
    }

    take_step(of, o, right);
    length = step_length(o, NEARLY);
    add(o->x, length, o->dx, n);
    add(o->u, length, o->du, n);
    return !(largest(o->x, n) < INFINITY && largest(o->u, n) < INFINITY);
}

/* Forces of a problem by interior points in place of o->f, as near as they come. ``work``: room for 9 vectors and 4 arrays of blocks. */
static void inner_forces(Contacts *c, const Problem *of, double *work)
{
    const int m = of->m, d = c->components, n = m * d;
    Blocks blocks = c->blocks;
    Interior o = {.m = m, .d = d, .blocks = &blocks};
    double **vectors[] = {&o.T, &o.q, &o.x, &o.u, &o.r, &o.dx, &o.du, &o.near}, **arrays[] = {&o.N, &o.inverse, &o.scale, &o.own};
    double *right = work + 8 * n, gap, most, size = 0.0, best = INFINITY;
    for (int k = 0; k < 8; k++) *vectors[k] = work + k * n;
    for (int k = 0; k < 4; k++) *arrays[k] = right + n + k * n * d;

    memset(o.scale, 0, n * d * sizeof(double));
    for (int i = 0; i < m; i++) {
        const double own = 1.0 / sqrt(fmax(of->own[i * d * d], 1e-300));
        for (int k = 0; k < d; k++) {
            o.scale[(i * d + k) * d + k] = o.T[i * d + k] = own * (k ? of->mu[i] : 1.0);
            o.q[i * d + k] = o.T[i * d + k] * of->q[i * d + k];
            o.x[i * d + k] = o.u[i * d + k] = k ? 0.0 : 1.0;
        }
    }
    size = fmax(largest(o.q, n), 1e-300);
    for (int i = 0; i < n; i++) o.q[i] /= size;

    for (int round = 0, stalls = 0; round < INNER && stalls < STALLED; round++) {
        most = lacking(of, &o, &gap);
        stalls = fmax(most, gap) < 0.5 * best ? 0 : stalls + 1;
        if (fmax(most, gap) < best) {
            best = fmax(most, gap);
            for (int i = 0; i < n; i++) of->f[i] = size * o.T[i] * o.x[i];
        }
        if (!(best > SUFFICES) || inner_step(of, &o, gap, most, right)) break;
        c->tally.iterations++;
    }
}
