/* L U of a matrix of d x d blocks, most of which may be zero, as those of contacts are that share no body: blocks that are zero, and
   stay so, cost nothing. The pattern is symmetric, and blocks on the diagonal are regular in every order. */

/* Which blocks a factor holds, and the order of elimination: by least degree (Tinney and Walker, doi:10.1109/PROC.1967.6011). */
typedef struct {
    int m, d;
    int *order, *rest;                        /* m each; rest: of one row */
    char *full;                               /* m x m */
    double *A;                                /* (m d) x (m d), by rows */
} Blocks;

/* Rows behind step k that have a block in the row of that step, into b->rest: how many. */
static int behind(const Blocks *b, int k)
{
    const char *full = b->full + (long)b->order[k] * b->m;
    int count = 0;
    for (int j = k + 1; j < b->m; j++)
        if (full[b->order[j]]) b->rest[count++] = b->order[j];
    return count;
}

/* The order, and what fills; ``full`` is that of the matrix. */
static void order_blocks(Blocks *b)
{
    for (int i = 0; i < b->m; i++) b->order[i] = i;
    for (int k = 0; k < b->m; k++) {
        int least = k, fewest = b->m + 1;
        for (int j = k; j < b->m; j++) {
            int degree = 0;
            const char *full = b->full + (long)b->order[j] * b->m;
            for (int i = k; i < b->m; i++) degree += full[b->order[i]];
            if (degree < fewest) least = j, fewest = degree;
        }
        const int one = b->order[least];
        b->order[least] = b->order[k];
        b->order[k] = one;
        const int count = behind(b, k);
        for (int i = 0; i < count; i++)
            for (int j = 0; j < count; j++) b->full[(long)b->rest[i] * b->m + b->rest[j]] = 1;
    }
}

/* Factors in place of the matrix, the inverses of the blocks on the diagonal with them; 1 where one has none. */
static int factor_blocks(Blocks *b)
{
    const int d = b->d;
    const long n = (long)b->m * d;
    for (int k = 0; k < b->m; k++) {
        const long p = (long)b->order[k] * d;
        const int count = behind(b, k);
        double own[D * D], inverse[D * D] = {0.0};
        for (int i = 0; i < d; i++) {
            memcpy(own + i * d, b->A + (p + i) * n + p, d * sizeof(double));
            inverse[i * d + i] = 1.0;
        }
        if (solve_dense(own, d, inverse, d, d, 0.0)) return 1;
        for (int i = 0; i < d; i++) memcpy(b->A + (p + i) * n + p, inverse + i * d, d * sizeof(double));

        for (int i = 0; i < count * d; i++) {
            double *row = b->A + ((long)b->rest[i / d] * d + i % d) * n, lower[D] = {0.0};
            for (int a = 0; a < d; a++)
                for (int e = 0; e < d; e++) lower[e] += row[p + a] * inverse[a * d + e];
            memcpy(row + p, lower, d * sizeof(double));
            for (int j = 0; j < count; j++)
                for (int e = 0; e < d; e++) add(row + b->rest[j] * d, -lower[e], b->A + (p + e) * n + b->rest[j] * d, d);
        }
    }
    return 0;
}

/* The solution in place of the right-hand side x. */
static void solve_blocks(const Blocks *b, double *x)
{
    const int d = b->d;
    const long n = (long)b->m * d;
    for (int k = 0; k < b->m; k++) {
        const long p = (long)b->order[k] * d;
        const int count = behind(b, k);
        for (int i = 0; i < count * d; i++) {
            const long row = (long)b->rest[i / d] * d + i % d;
            x[row] -= dot(b->A + row * n + p, x + p, d);
        }
    }
    for (int k = b->m - 1; k >= 0; k--) {
        const long p = (long)b->order[k] * d;
        const int count = behind(b, k);
        double right[D];
        memcpy(right, x + p, d * sizeof(double));
        for (int j = 0; j < count; j++)
            for (int i = 0; i < d; i++) right[i] -= dot(b->A + (p + i) * n + b->rest[j] * d, x + b->rest[j] * d, d);
        for (int i = 0; i < d; i++) x[p + i] = dot(b->A + (p + i) * n + p, right, d);
    }
}
