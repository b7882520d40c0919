/* A Cholesky factor whose last unknowns stay last, and its two halves, by CHOLMOD (Chen, Davis, Hager and Rajamanickam,
   doi:10.1145/1391989.1391995):

       [ A_II  A_IG ]   [ L_I      ] [ L_I^T  L_GI^T ]          L_G L_G^T = A_GG - A_GI A_II^-1 A_IG
       [ A_GI  A_GG ] = [ L_GI L_G ] [        L_G^T  ]

   Matrices are columns of a lower triangle: first[j] .. first[j + 1] are the places of column j in rows and values, in any
   order. CHOLMOD's functions are those of the library that PETSc was linked with; their addresses are handed over. */

#include <stdint.h>
#include <stdlib.h>
#if __has_include(<suitesparse/cholmod.h>)
#include <suitesparse/cholmod.h>
#else
#include <cholmod.h>
#endif

#define EXPORT __attribute__((visibility("default")))

/* CHOLMOD's functions, in the order in which they are handed over */
#define FUNCTIONS(F) F(start) F(finish) F(metis) F(camd) F(analyze_p) F(factorize) F(solve2) F(free_factor) F(free_dense)
#define MEMBER(name) __typeof__(cholmod_l_##name) *name;
#define NAME(name) "cholmod_l_" #name " "
static struct { FUNCTIONS(MEMBER) } call;

EXPORT const char *function_names(void) { return FUNCTIONS(NAME); }

EXPORT int header_version(void) { return 1000 * CHOLMOD_MAIN_VERSION + CHOLMOD_SUB_VERSION; }

EXPORT void set_functions(void **given) {
    for (size_t i = 0; i < sizeof call / sizeof(void *); i++) ((void **)&call)[i] = given[i];
}

typedef struct {
    cholmod_common common;
    cholmod_factor *L;
    double *work; /* (2 n) of solves */
} Partial;

static void silent_start(cholmod_common *common) {
    call.start(common);
    common->print = 0;
    common->quick_return_if_not_posdef = 1;
    common->nmethods = 1;
    common->method[0].ordering = CHOLMOD_GIVEN;
}

static cholmod_sparse lower_triangle(int64_t n, int64_t *first, int64_t *rows, double *values) {
    cholmod_sparse A = {.nrow = n, .ncol = n, .nzmax = first[n], .p = first, .i = rows, .x = values};
    A.stype = -1;
    A.itype = CHOLMOD_LONG;
    A.xtype = values ? CHOLMOD_REAL : CHOLMOD_PATTERN;
    A.dtype = CHOLMOD_DOUBLE;
    A.packed = 1;
    return A;
}

/* An order of little fill, to order (n): nested dissection, or minimum degree where unknowns with a smaller set come first. */
EXPORT int fill_reducing_order(int64_t n, int64_t *first, int64_t *rows, int64_t *sets, int64_t *order) {
    cholmod_common common;
    silent_start(&common);
    cholmod_sparse A = lower_triangle(n, first, rows, NULL);
    int made = sets ? call.camd(&A, NULL, 0, sets, order, &common) : call.metis(&A, NULL, 0, 1, order, &common);
    call.finish(&common);
    return made;
}

/* Entries of L in an order; negative where CHOLMOD fails. */
EXPORT double entries(int64_t n, int64_t *first, int64_t *rows, int64_t *order) {
    cholmod_common common;
    silent_start(&common);
    common.supernodal = CHOLMOD_SIMPLICIAL;
    cholmod_sparse A = lower_triangle(n, first, rows, NULL);
    cholmod_factor *L = call.analyze_p(&A, order, NULL, 0, &common);
    double found = L ? common.lnz : -1.0;
    call.free_factor(&L, &common);
    call.finish(&common);
    return found;
}

EXPORT void release(Partial *p) {
    if (!p) return;
    free(p->work);
    call.free_factor(&p->L, &p->common);
    call.finish(&p->common);
    free(p);
}

/* The factor in an order; NULL where there is none, for the reason in status: 1 not positive definite, else CHOLMOD's. */
EXPORT Partial *factorize(int64_t n, int64_t *first, int64_t *rows, double *values, int64_t *order, int *status) {
    Partial *p = calloc(1, sizeof *p);
    *status = CHOLMOD_OUT_OF_MEMORY;
    if (!p) return NULL;
    p->work = malloc((2 * n + 1) * sizeof *p->work);
    silent_start(&p->common);
    p->common.supernodal = CHOLMOD_SUPERNODAL;
    p->common.final_ll = 1;

    cholmod_sparse A = lower_triangle(n, first, rows, values);
    p->L = call.analyze_p(&A, order, NULL, 0, &p->common);
    if (p->L) call.factorize(&A, p->L, &p->common);
    *status = p->common.status;
    if (p->L && p->work && *status == CHOLMOD_OK) return p;
    release(p);
    return NULL;
}

/* One vector: columns by fours, so that each sweep over the rows below reads four columns of L and writes once. A pure stream,
   where BLAS is called for many small triangles. w: rows of the supernode. */
static void forward(const double *restrict L, int64_t columns, int64_t height, double *restrict w) {
    int64_t c = 0;
    for (; c + 4 <= columns; c += 4) {
        const double *restrict a = L + c * height, *restrict b = a + height, *restrict d = b + height, *restrict e = d + height;
        double p = w[c] / a[c];
        double q = (w[c + 1] - a[c + 1] * p) / b[c + 1];
        double r = (w[c + 2] - a[c + 2] * p - b[c + 2] * q) / d[c + 2];
        double s = (w[c + 3] - a[c + 3] * p - b[c + 3] * q - d[c + 3] * r) / e[c + 3];
        w[c] = p, w[c + 1] = q, w[c + 2] = r, w[c + 3] = s;
        for (int64_t i = c + 4; i < height; i++) w[i] -= a[i] * p + b[i] * q + d[i] * r + e[i] * s;
    }

    for (; c < columns; c++) {
        const double *restrict a = L + c * height, p = w[c] /= a[c];
        for (int64_t i = c + 1; i < height; i++) w[i] -= a[i] * p;
    }
}

static void backward(const double *restrict L, int64_t columns, int64_t height, double *restrict w) {
    int64_t c = columns;
    for (; c >= 4;) {
        c -= 4;

        const double *restrict a = L + c * height, *restrict b = a + height, *restrict d = b + height, *restrict e = d + height;
        double p = 0, q = 0, r = 0, s = 0;
#pragma omp simd reduction(+ : p, q, r, s)
        for (int64_t i = c + 4; i < height; i++) p += a[i] * w[i], q += b[i] * w[i], r += d[i] * w[i], s += e[i] * w[i];
        w[c + 3] = (w[c + 3] - s) / e[c + 3];
        w[c + 2] = (w[c + 2] - r - d[c + 3] * w[c + 3]) / d[c + 2];
        w[c + 1] = (w[c + 1] - q - b[c + 2] * w[c + 2] - b[c + 3] * w[c + 3]) / b[c + 1];
        w[c] = (w[c] - p - a[c + 1] * w[c + 1] - a[c + 2] * w[c + 2] - a[c + 3] * w[c + 3]) / a[c];
    }

    while (c > 0) {
        c--;
        const double *restrict a = L + c * height;
        double p = 0;
#pragma omp simd reduction(+ : p)
        for (int64_t i = c + 1; i < height; i++) p += a[i] * w[i];
        w[c] = (w[c] - p) / a[c];
    }
}

static void half_of_one(const cholmod_factor *F, int transposed, double *x, double *w) {
    const int64_t *super = F->super, *pi = F->pi, *px = F->px, *rows = F->s;
    int64_t count = F->nsuper;
    for (int64_t k = 0; k < count; k++) {
        int64_t j = transposed ? count - 1 - k : k, columns = super[j + 1] - super[j], height = pi[j + 1] - pi[j];
        const int64_t *at = rows + pi[j];
        for (int64_t i = 0; i < height; i++) w[i] = x[at[i]];

        if (transposed) {
            backward((double *)F->x + px[j], columns, height, w);
            for (int64_t i = 0; i < columns; i++) x[at[i]] = w[i];
        } else {
            forward((double *)F->x + px[j], columns, height, w);
            for (int64_t i = 0; i < height; i++) x[at[i]] = w[i];
        }
    }
}

/* x (columns, n) becomes L^-1 x, or L^-T x where transposed; 0 where CHOLMOD fails. */
EXPORT int solve_half(Partial *p, int transposed, double *x, int64_t columns) {
    int64_t n = p->L->n, *order = p->L->Perm;
    if (columns == 1) {
        double *b = p->work;
        for (int64_t i = 0; i < n; i++) b[i] = x[order[i]];
        half_of_one(p->L, transposed, b, b + n);
        for (int64_t i = 0; i < n; i++) x[order[i]] = b[i];
        return 1;
    }

    double *b = malloc((n * columns + 1) * sizeof *b);
    if (!b) return 0;
    for (int64_t k = 0; k < columns; k++)
        for (int64_t i = 0; i < n; i++) b[k * n + i] = x[k * n + order[i]];

    cholmod_dense B = {.nrow = n, .ncol = columns, .nzmax = n * columns, .d = n, .x = b}, *X = NULL, *Y = NULL, *E = NULL;
    B.xtype = CHOLMOD_REAL;
    B.dtype = CHOLMOD_DOUBLE;
    int which = transposed ? CHOLMOD_Lt : CHOLMOD_L;
    int solved = call.solve2(which, p->L, &B, NULL, &X, NULL, &Y, &E, &p->common);
    for (int64_t k = 0; k < columns && solved; k++)
        for (int64_t i = 0; i < n; i++) x[k * n + order[i]] = ((double *)X->x)[k * n + i];

    free(b);
    call.free_dense(&X, &p->common);
    call.free_dense(&Y, &p->common);
    call.free_dense(&E, &p->common);
    return solved;
}

/* L_G, rows (k, k) with k = n - interior, and the unknowns of its rows, counted from 0 for the first that is not interior. Where
   CHOLMOD joins columns to supernodes, those that stay last have rows of the interior too, all of them zero. */
EXPORT void trailing(Partial *p, int64_t interior, double *LG, int64_t *unknowns) {
    cholmod_factor *L = p->L;
    int64_t n = L->n, k = n - interior, *order = L->Perm, *super = L->super, *pi = L->pi, *px = L->px, *s = L->s;
    int64_t *place = malloc((n + 1) * sizeof *place), count = 0;
    const double *x = L->x;

    for (int64_t i = 0; i < n; i++) {
        place[i] = -1;
        if (order[i] < interior) continue;
        unknowns[count] = order[i] - interior;
        place[i] = count++;
    }

    for (int64_t i = 0; i < k * k; i++) LG[i] = 0.0;
    for (size_t j = 0; j < L->nsuper; j++) {
        int64_t height = pi[j + 1] - pi[j];
        for (int64_t c = super[j]; c < super[j + 1]; c++) {
            if (place[c] < 0) continue;

            const double *column = x + px[j] + (c - super[j]) * height;
            for (int64_t r = c - super[j]; r < height; r++) {
                int64_t row = place[s[pi[j] + r]];
                if (row >= 0) LG[row * k + place[c]] = column[r];
            }
        }
    }
    free(place);
}

EXPORT double size(Partial *p) { return (double)p->L->xsize; }
