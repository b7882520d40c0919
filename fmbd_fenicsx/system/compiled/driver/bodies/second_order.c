/* Inertia of the second-order displacements, mechanics/elastic/second_order.py: what reduced bodies and fields have in common. */

/* Of displacements p = X + u and their rates, in body axes: int rho p and int rho X p^T; of the second-order ones m2 and P2^T. */
typedef struct {
    double s[3][D], T[3][D * D], m[3][D], P[3][D * D];
} Moments;

/* The undeformed body: mass, int rho X, J^-1 (TWIST x TWIST). */
typedef struct {
    double mass, S[D];
    const double *mean;
} Rest;

/* One of the numbers of (1), c of unit a_c and unit L_ij, of the r-th rate. */
static inline double *moment_at(Moments *z, int r, int c)
{
    return c < D ? &z->m[r][c] : &z->P[r][(c - D) % D * D + (c - D) / D];
}

/* int rho V and int rho X V^T of V = sum turns_r p^(r) added to total and matrix. */
static void collect(const double (*s)[D], const double (*T)[D * D], const double **turns, int count, double *total, double *matrix)
{
    for (int r = 0; r < count; r++) {
        double one[D], all[D * D];
        times(turns[r], s[r], one);
        add(total, 1.0, one, D);
        product_transposed(T[r], turns[r], all);
        add(matrix, 1.0, all, D * D);
    }
}

/* A constant translation v adds to these. */
static void carry(const Rest *o, const double *v, double *total, double *matrix)
{
    for (int i = 0; i < D; i++) {
        total[i] += o->mass * v[i];
        for (int j = 0; j < D; j++) matrix[D * i + j] += o->S[i] * v[j];
    }
}

/* J^-1 of a moment. */
static void mean_of(const Rest *o, const double *total, const double *matrix, double *c)
{
    double x[TWIST];
    memcpy(x, total, D * sizeof(double));
    axial(matrix, x + D);
    for (int i = 0; i < TWIST; i++) c[i] = dot(o->mean + TWIST * i, x, TWIST);
}

/* N += x y^T and N += A^T B^T */
static void outer(const double *x, const double *y, double *N)
{
    for (int i = 0; i < D; i++) add(N + D * i, x[i], y, D);
}

static void both_transposed(const double *A, const double *B, double *N)
{
    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++)
            for (int c = 0; c < D; c++) N[D * i + j] += A[D * c + i] * B[D * j + c];
}

/* a(c) and L(c) of a mean motion c with the rate c'. */
static void acceleration(const double *c, const double *rate, const double *W, double *a, double *L)
{
    double C[D * D], E[D * D], turned[D];
    hat(c + D, C);
    hat(rate + D, E);
    product(W, C, L);
    add(L, 1.0, E, D * D);
    times(W, c, turned);
    for (int i = 0; i < D; i++) a[i] = rate[i] + turned[i];
}

/* (4): rows of the frame added to force and N (body axes); a(e) and L(e) that act on displacements, and a(b) - R^T g_0 and L(b), the
   coefficients (D + D D) of the stress. acc: R^T (r'' - g_0); a frame that moves evenly sees the same, so its velocity is left out. */
static void second_order(const Rest *o, const Moments *z, const double *W, const double *alpha, const double *acc, double *force,
                         double *N, double *a, double *L, double *stress)
{
    double one[D * D] = {0.0}, A[D * D];
    for (int i = 0; i < D; i++) one[(D + 1) * i] = 1.0;
    hat(alpha, A);
    const double *speeds[] = {W, one}, *rates[] = {A, W, one};

    double g[D] = {0.0}, G[D * D] = {0.0}, h[D] = {0.0}, H[D * D] = {0.0};
    double gd[D] = {0.0}, Gd[D * D] = {0.0}, hd[D] = {0.0}, Hd[D * D] = {0.0};
    collect(z->s, z->T, speeds, 2, g, G);
    collect(z->m, z->P, speeds, 2, h, H);
    collect(z->s, z->T, rates, 3, gd, Gd);
    carry(o, acc, gd, Gd);
    collect(z->m, z->P, rates, 3, hd, Hd);

    double e[TWIST], ed[TWIST], b[TWIST], bd[TWIST], *ab = stress, *Lb = stress + D, C[D * D];
    mean_of(o, h, H, e);
    mean_of(o, hd, Hd, ed);
    mean_of(o, g, G, b);
    mean_of(o, gd, Gd, bd);
    add(b, 1.0, e, TWIST);
    add(bd, 1.0, ed, TWIST);
    acceleration(e, ed, W, a, L);
    acceleration(b, bd, W, ab, Lb);

    for (int i = 0; i < D; i++) force[i] += o->mass * a[i] + dot(L + D * i, o->S, D);
    outer(z->s[0], a, N);
    both_transposed(z->T[0], L, N);
    outer(z->m[0], ab, N);
    both_transposed(z->P[0], Lb, N);
    outer(g, e, N);
    hat(e + D, C);
    both_transposed(G, C, N);
    outer(h, b, N);
    hat(b + D, C);
    both_transposed(H, C, N);
}

/* (3) itself, to be added to the kinetic energy; v, W: twist of the frame in body axes. */
static double second_energy(const Rest *o, const Moments *z, const double *v, const double *W)
{
    double one[D * D] = {0.0}, g[D] = {0.0}, G[D * D] = {0.0}, h[D] = {0.0}, H[D * D] = {0.0}, e[TWIST], x[TWIST], y[TWIST];
    for (int i = 0; i < D; i++) one[(D + 1) * i] = 1.0;

    const double *speeds[] = {W, one};
    collect(z->s, z->T, speeds, 2, g, G);
    carry(o, v, g, G);
    collect(z->m, z->P, speeds, 2, h, H);
    mean_of(o, h, H, e);
    memcpy(x, g, sizeof g);
    axial(G, x + D);
    memcpy(y, h, sizeof h);
    axial(H, y + D);
    return dot(x, e, TWIST) + 0.5 * dot(y, e, TWIST);
}
