/* L U of a sparse matrix of d x d blocks whose pattern is that of a group of contacts (graph.c), where what fills is known beforehand.
   Blocks on the diagonal are regular in every order. */

/* y = W x at contact i for forces x of a group. */
static void moved_at(const Problem *o, int d, int i, const double *x, double *y)
{
    for (int a = 0; a < d; a++) y[a] = dot(o->own + (i * d + a) * d, x + i * d, d);
    for (int e = o->first[i]; e < o->first[i + 1]; e++)
        for (int a = 0; a < d; a++) y[a] += dot(o->W + ((long)e * d + a) * d, x + o->near[e] * d, d);
}

/* y = W x */
static void moved_by(const Problem *o, int d, const double *x, double *y)
{
    if (o->lumped) {
        o->lumped->times(o->lumped->by, x, y);
        return;
    }
    for (int i = 0; i < o->m; i++) moved_at(o, d, i, x, y + i * d);
}

/* Openings under forces x, which may be in the place of u. */
static void open_under(const Problem *o, int d, const double *x, double *u)
{
    for (int i = 0; i < o->m * d; i++) o->change[i] = x[i] - o->held[i];
    moved_by(o, d, o->change, u);
    add(u, 1.0, o->opened, o->m * d);
}

/* C = P W Q + B for blocks P, W, B and a diagonal Q. */
static void scaled_block(int d, const double *P, const double *W, const double *Q, const double *B, double *C)
{
    for (int i = 0; i < d; i++)
        for (int j = 0; j < d; j++) {
            double sum = 0.0;
            for (int k = 0; k < d; k++) sum += P[i * d + k] * W[k * d + j];
            C[i * d + j] = (Q ? Q[j] * sum : sum) + (B ? B[i * d + j] : 0.0);
        }
}

/* P W Q + B into the blocks: P and B m x d x d on the diagonal, Q m d, NULL for 1. */
static void load_blocks(const Problem *o, int d, Blocks *b, const double *P, const double *Q, const double *B)
{
    const long square = d * d, base = o->start[0], filled = o->start[o->m] - base;
    memset(b->upper, 0, filled * square * sizeof(double));
    memset(b->lower, 0, filled * square * sizeof(double));

    for (int i = 0; i < o->m; i++) {
        const double *left = P + i * square;
        double *own = b->own + i * square;
        scaled_block(d, left, o->own + i * square, Q ? Q + i * d : NULL, B + i * square, own);
        b->size[i] = largest(own, square);
        for (int e = o->first[i]; e < o->first[i + 1]; e++) {
            const int k = o->near[e];
            double *to = (k > i ? b->upper : b->lower) + (o->slot[e] - base) * square;
            scaled_block(d, left, o->W + e * square, Q ? Q + k * d : NULL, NULL, to);
        }
    }
}

/* C += A B */
static inline __attribute__((always_inline)) void add_block(double *C, const double *A, const double *B, const int d)
{
    for (int i = 0; i < d; i++)
        for (int k = 0; k < d; k++)
            for (int j = 0; j < d; j++) C[i * d + j] += A[i * d + k] * B[k * d + j];
}

/* Whether a block holds a number that is not zero. */
static inline __attribute__((always_inline)) int stands(const double *A, const int d)
{
    for (int i = 0; i < d * d; i++)
        if (A[i] != 0.0) return 1;
    return 0;
}

/* Blocks behind the diagonal of row i in the order of their columns: row k, of which i is a column, is taken off, with column k. Rows of
   contacts that are open hold nothing beside the diagonal, and stay as they are. */
static inline __attribute__((always_inline)) void take_off(const Problem *o, Blocks *b, int k, int at, const int d)
{
    const long square = d * d, base = o->start[0];
    const int i = o->behind[at], changes = stands(b->lower + (at - base) * square, d);
    double *upper = b->upper - base * square, *lower = b->lower - base * square;
    if (changes) add_block(b->own + i * square, lower + at * square, upper + at * square, d);
    for (int e = at + 1, to = o->start[i]; e < o->start[k + 1]; e++, to++) {
        while (o->behind[to] != o->behind[e]) to++;
        if (changes) add_block(upper + to * square, lower + at * square, upper + e * square, d);
        if (stands(lower + e * square, d)) add_block(lower + to * square, lower + e * square, upper + at * square, d);
    }
}

static inline __attribute__((always_inline)) int factor_sized(const Problem *o, Blocks *b, double share, const int d)
{
    const long square = d * d, base = o->start[0];
    for (int k = 0; k < o->m; k++) {
        double pivot[D * D], *inverse = b->own + k * square, size = largest(inverse, square);
        if (!(size < INFINITY && size > share * b->size[k])) return 1;
        memcpy(pivot, inverse, square * sizeof(double));
        for (int i = 0; i < square; i++) inverse[i] = i % (d + 1) ? 0.0 : -1.0;
        if (solve_dense(pivot, d, inverse, d, d, share * b->size[k] / size)) return 1;

        for (int e = o->start[k]; e < o->start[k + 1]; e++) {
            double below[D * D], *lower = b->lower + (e - base) * square;
            memcpy(below, lower, square * sizeof(double));
            memset(lower, 0, square * sizeof(double));
            add_block(lower, below, inverse, d);
        }
        int acts = 0;
        for (int e = o->start[k]; !acts && e < o->start[k + 1]; e++) acts = stands(b->upper + (e - base) * square, d);
        for (int e = o->start[k]; acts && e < o->start[k + 1]; e++) take_off(o, b, k, e, d);
    }
    return 0;
}

/* Factors in place of the matrix: of blocks on the diagonal their inverses, and those below it times these, all with the sign changed.
   1 where a pivot is not above this share of what its block began with. */
static int factor_blocks(const Problem *o, int d, Blocks *b, double share)
{
    return d == 1 ? factor_sized(o, b, share, 1) : factor_sized(o, b, share, D);
}

/* The solution in place of the right-hand side x. */
static void solve_blocks(const Problem *o, int d, const Blocks *b, double *x)
{
    const long square = d * d, base = o->start[0];
    for (int k = 0; k < o->m; k++)
        for (int e = o->start[k]; e < o->start[k + 1]; e++)
            for (int i = 0; i < d; i++) x[o->behind[e] * d + i] += dot(b->lower + (e - base) * square + i * d, x + k * d, d);
    for (int k = o->m - 1; k >= 0; k--) {
        double left[D];
        for (int i = 0; i < d; i++) left[i] = -x[k * d + i];
        for (int e = o->start[k]; e < o->start[k + 1]; e++)
            for (int i = 0; i < d; i++) left[i] += dot(b->upper + (e - base) * square + i * d, x + o->behind[e] * d, d);
        for (int i = 0; i < d; i++) x[k * d + i] = dot(b->own + k * square + i * d, left, d);
    }
}

/* ---- P W + B: as it stands, or nearly, by what is nearly the inverse of W ---- */

/* Vectors, or blocks, of m contacts in the order of an elimination; or back, added with a factor. */
static void put_in_order(const Lumped *o, int size, const double *x, double *y)
{
    for (int i = 0; i < o->inverse.m; i++) memcpy(y + (long)o->place[i] * size, x + (long)i * size, size * sizeof(double));
}

/* P W + B, P and B m x d x d on the diagonal, ready to be solved; 1 as factor_blocks. With H nearly W^-1 that is P + B H on what W
   moves. */
static int factor_slope(const Problem *o, int d, Blocks *b, const double *P, const double *B, double share)
{
    Lumped *l = o->lumped;
    const long size = (long)o->m * d * d;
    if (!l) {
        load_blocks(o, d, b, P, NULL, B);
        return factor_blocks(o, d, b, share);
    }
    put_in_order(l, d * d, B, l->work);
    put_in_order(l, d * d, P, l->work + size);
    load_blocks(&l->inverse, d, &l->blocks, l->work, NULL, l->work + size);
    return factor_blocks(&l->inverse, d, &l->blocks, share);
}

/* The solution in place of the right-hand side x, the exact one where W is stored. */
static void solve_slope(const Problem *o, int d, const Blocks *b, double *x)
{
    const Lumped *l = o->lumped;
    if (!l) {
        solve_blocks(o, d, b, x);
        return;
    }
    double *y = l->work, *z = y + o->m * d;
    put_in_order(l, d, x, y);
    solve_blocks(&l->inverse, d, &l->blocks, y);
    moved_by(&l->inverse, d, y, z);
    for (int i = 0; i < o->m; i++) memcpy(x + i * d, z + l->place[i] * d, d * sizeof(double));
}
