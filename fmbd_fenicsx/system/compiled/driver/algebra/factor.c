/* L D L^T of the step's matrix by fronts (Duff and Reid, doi:10.1145/356044.356047): each front is a dense lower half by columns;
   the columns of its own unknowns are eliminated, what is left is added to the next front.

   The matrix is symmetric and indefinite; the order, found by order.py, puts a row of constraints behind a body that it can
   move, so that pivots of bodies are positive and those of rows negative while the rows do not depend on each other. */

typedef double lanes __attribute__((vector_size(32), aligned(8), may_alias));
enum { LANES = 4 };

static void clear(System *s)
{
    memset(s->L, 0, (size_t)s->storage * sizeof(double));
    memset(s->weight, 0, (size_t)s->rows * sizeof(double));
    memset(s->locked, 0, (size_t)s->rows * sizeof(double));
}

static const double DEAR = 8.0; /* solutions that take as long as a factor which is dear */

enum { PANEL = 4 }; /* pivots whose products are taken off later columns together: each is read and written once for them */

/* One pivot column: the columns behind it, up to ``end``, less its products. Columns begin at whole lanes; what stands above the
   diagonal is not used. */
static inline void eliminate(double *F, int ld, int end, int k, double inverse)
{
    const double *column = F + (long)ld * k;
    for (int j = k + 1; j < end; j++) {
        double c = column[j] * inverse;
        if (c == 0.0) continue;
        lanes *to = (lanes *)(F + (long)ld * j);
        const lanes *from = (const lanes *)column;
        for (int i = j / LANES; i < ld / LANES; i++) to[i] -= from[i] * c;
    }
}

/* The columns behind n pivots from k on less the products of all of these, one after another; two columns together, as what is read of
   the pivots serves both. The last of an odd number goes with itself. */
static inline __attribute__((always_inline)) void eliminate_together(double *F, int ld, int rows, int k, const int n, const double *inverse)
{
    const double *column = F + (long)ld * k;
    for (int j = k + n; j < rows; j += 2) {
        const int second = j + 1 < rows ? j + 1 : j;
        double x[PANEL], y[PANEL];
        for (int p = 0; p < n; p++) {
            x[p] = column[(long)ld * p + j] * inverse[p];
            y[p] = column[(long)ld * p + second] * inverse[p];
        }
        lanes *one = (lanes *)(F + (long)ld * j), *two = (lanes *)(F + (long)ld * second);
        for (int i = j / LANES; i < ld / LANES; i++) {
            lanes X = one[i], Y = two[i];
            for (int p = 0; p < n; p++) {
                const lanes A = ((const lanes *)(column + (long)ld * p))[i];
                X -= A * x[p];
                Y -= A * y[p];
            }
            one[i] = X;
            two[i] = Y;
        }
    }
}

/* The same for the last pivot k of so many that go together. */
static void eliminate_panel(double *F, int ld, int rows, int k, int together, const double *inverse)
{
    if (together == 1) eliminate(F, ld, rows, k, *inverse);
    else if (together == 2) eliminate_together(F, ld, rows, k - 1, 2, inverse);
    else if (together == 3) eliminate_together(F, ld, rows, k - 2, 3, inverse);
    else eliminate_together(F, ld, rows, k - 3, PANEL, inverse);
}

/* What is left of a front behind its pivots, added to the next one. Rows that lie side by side there go as whole lanes. */
static void hand_on(const System *s, const Front *f)
{
    const Front *g = s->front + f->next;
    const int left = f->rows - f->pivots, *at = f->to;
    for (int j = 0; j < left; j++) {
        double *to = s->L + g->start + (long)g->ld * at[j];
        const double *from = s->L + f->start + (long)f->ld * (j + f->pivots) + f->pivots;
        int i = j;
        for (; i + LANES <= left; i += LANES) {
            if (at[i + LANES - 1] == at[i] + LANES - 1) *(lanes *)(to + at[i]) += *(const lanes *)(from + i);
            else
                for (int l = i; l < i + LANES; l++) to[at[l]] += from[l];
        }
        for (; i < left; i++) to[at[i]] += from[i];
    }
}

/* Dependent rows get -epsilon / u^2 on the diagonal, of a complex matrix on that of its real part: G x - epsilon y / u^2 = c instead of G x = c, with y / u in forces where y is
   a moment. Solving again for what is left open, with the multipliers found so far in the residual, closes the rows; started
   from no multipliers it leads to those with the smallest forces y / u (method of multipliers, a proximal point method;
   Rockafellar, doi:10.1287/moor.1.2.97).

   Of a combination of rows with the singular value sigma one solution closes the share k = sigma^2 / (sigma^2 + epsilon), and what
   rows contradict each other in (k = 0) goes to y over epsilon. To ask for what it closed, n - 1 times, leaves k^(n - 1) of that in
   y, to ask then n times for what is open closes k^n (1 + n (1 - k)): further right-hand sides are the softness times y so often.
   Two corrections serve rows that are the same but for roundoff, more those that nearly are (linear/redundancy.py). */
double correction(int k, int count) { return k + 1 < count ? 1.0 : -count; }

static double softness(const System *s, int row)
{
    return s->epsilon / (s->multiplier_units[row] * s->multiplier_units[row]);
}

static void soften(System *s)
{
    double largest = 0.0;
    for (int i = 0; i < s->rows; i++) largest = fmax(largest, s->weight[i] * s->multiplier_units[i] * s->multiplier_units[i]);
    s->epsilon = s->redundant ? SOFT * largest : 0.0;
    for (int i = 0; i < s->rows; i++) s->L[s->row_dest[i]] -= softness(s, i);
}

static const double OWN = 1e-11; /* share of what a row's pivot is made of, below which it is roundoff */

/* The size below which a pivot is roundoff, of bodies as they are. */
static double least_pivot(const System *s, int u)
{
    const int row = u - s->nu;
    if (row < 0) return 1e-14 * s->diagonal[u];
    return s->redundant ? 0.1 * softness(s, row) : OWN * s->weight[row];
}

/* What the pivot of row u is made of, by size, in the fronts up to ``last``: bodies that bear others behind gears move by far less than
   alone. */
static double made_of(const System *s, int u, const Front *last)
{
    double sum = 0.0;
    for (const Front *f = s->front; f <= last; f++)
        for (int i = 0; i < f->rows && !f->apart; i++) {
            if (f->unknown[i] != u) continue;
            for (int k = 0; k < f->pivots && k < i; k++) {
                const double part = s->L[f->start + (long)f->ld * k + i];
                sum += part * part * fabs(s->inverse[f->unknown[k]]);
            }
        }
    return sum;
}

/* Whether a pivot of the right sign is not roundoff. */
static int stands_out(const System *s, double pivot, int u, const Front *f)
{
    if (pivot > least_pivot(s, u)) return 1;
    return u >= s->nu && !s->redundant && pivot > OWN * made_of(s, u, f);
}

/* Whether gears or springs have added so much to unknown k of a front that the body's own inertia is roundoff beside it. */
static int is_swamped(const System *s, const Front *f, int k)
{
    const int u = f->unknown[k];
    return u < s->nu && DBL_EPSILON * s->L[f->start + (long)(f->ld + 1) * k] > OWN * s->diagonal[u];
}

/* The largest w with which w g^T g of row r makes no diagonal entry more than twice as large; 0 where the row acts on others than the
   front's bodies, or on one that is not swamped. */
static double firmness(const System *s, const Front *f, int r)
{
    const double *F = s->L + f->start;
    double w = INFINITY;
    for (int k = 0; k < f->rows; k++) {
        const double g = k < r ? F[(long)f->ld * k + r] : F[(long)f->ld * r + k];
        if (g == 0.0) continue;
        if (k >= r || !is_swamped(s, f, k)) return 0.0;
        w = fmin(w, F[(long)(f->ld + 1) * k] / (g * g));
    }
    return w < INFINITY ? w : 0.0;
}

/* What a train of gears adds to a wheel, c a a^T along its axis a, swamps the inertia across where a is tilted: rows g x = b that hold the
   wheel there lose their pivots. With w g^T g beside it the matrix is sound: x stays, the multiplier is less by w b. */
static void firm_up(System *s, Front *f)
{
    double *F = s->L + f->start;
    f->firm = 0;
    for (int k = 0; k < f->pivots; k++) f->firm |= is_swamped(s, f, k);
    for (int r = 0; r < f->pivots && f->firm; r++) {
        if (f->unknown[r] < s->nu) continue;
        const double w = s->firm[f->unknown[r] - s->nu] = firmness(s, f, r);
        for (int j = 0; j < r && w > 0.0; j++)
            for (int i = j; i < r; i++) F[(long)f->ld * j + i] += w * F[(long)f->ld * j + r] * F[(long)f->ld * i + r];
    }
}

/* SINGULAR when a pivot has the wrong sign, where bodies are stable, or is small against what it is made of. Rows without a pivot
   are left out then, so that all of them are known: they depend on others, or what comes later locks them, see order.py. */
static int factor(System *s)
{
    int verdict = DONE;
    s->factors++;
    soften(s);

    for (Front *f = s->front; f < s->front + s->fronts; f++) {
        if (f->apart) continue;

        double *F = s->L + f->start, inverse[PANEL];
        const int ld = f->ld;
        firm_up(s, f);
        for (int k = 0; k < f->pivots; k++) {
            const int u = f->unknown[k], at = k % PANEL, end = k - at + PANEL < f->pivots ? k - at + PANEL : f->pivots;
            double sign = s->sign[u], pivot = F[(long)(ld + 1) * k] * sign;
            if (s->indefinite && pivot < 0.0) sign = -sign, pivot = -pivot;
            if (!stands_out(s, pivot, u, f)) {
                if (u < s->nu) return SINGULAR;
                verdict = SINGULAR;
                s->locked[u - s->nu] = 1.0;
                sign = 0.0, pivot = 1.0;
            }
            s->inverse[u] = inverse[at] = sign / pivot;
            if (k + 1 < end) eliminate(F, ld, end, k, s->inverse[u]);
            else eliminate_panel(F, ld, f->rows, k, at + 1, inverse);
        }
        if (f->next >= 0) hand_on(s, f);
    }
    return verdict;
}

/* Whether a factor takes the work of many solutions, by products: of nets and lattices; those of chains and trees take less than two. */
int is_dear(const System *s)
{
    double all = 0.0, solution = 0.0;
    for (const Front *f = s->front; f < s->front + s->fronts; f++)
        for (int k = 0; k < f->pivots && !f->apart; k++) {
            const double rows = f->rows - k;
            all += 0.5 * rows * rows;
            solution += 2.0 * rows;
        }
    return all > DEAR * solution;
}

static void swap(double *a, double *b, int n)
{
    for (int i = 0; i < n; i++) {
        double kept = a[i];
        a[i] = b[i];
        b[i] = kept;
    }
}

/* A^-1 B in place of B, n rows of ``columns`` numbers, ``ld`` apart: elimination with row exchanges of a small full matrix, which is
   lost. 1 where a pivot is not above this share of the largest entry. */
int solve_dense(double *A, int n, double *B, long ld, int columns, double share)
{
    double largest = 0.0;
    for (int i = 0; i < n * n; i++) largest = fmax(largest, fabs(A[i]));

    for (int k = 0; k < n; k++) {
        double *row = A + k * n, *right = B + k * ld;
        int p = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(A[i * n + k]) > fabs(A[p * n + k])) p = i;
        if (!(fabs(A[p * n + k]) > share * largest)) return 1;
        if (p != k) {
            swap(row, A + p * n, n);
            swap(right, B + p * ld, columns);
        }

        for (int i = k + 1; i < n; i++) {
            double factor = A[i * n + k] / row[k];
            if (factor == 0.0) continue;
            add(A + i * n + k, -factor, row + k, n - k);
            add(B + i * ld, -factor, right, columns);
        }
    }

    for (int k = n - 1; k >= 0; k--) {
        double *right = B + k * ld;
        for (int j = k + 1; j < n; j++) add(right, -A[k * n + j], B + j * ld, columns);
        for (int i = 0; i < columns; i++) right[i] /= A[k * n + k];
    }
    return 0;
}

/* What holds an attitude and meets nothing else is not factored: mostly nothing acts on it. */
static void solve_apart(const System *s, const Front *f, double *b)
{
    double A[4 * ROT * ROT], x[2 * ROT];
    int acts = 0;
    for (int i = 0; i < f->rows; i++) acts |= (x[i] = b[f->unknown[i]]) != 0.0;
    if (!acts) return;

    for (int j = 0; j < f->rows; j++)
        for (int i = j; i < f->rows; i++) A[f->rows * i + j] = A[f->rows * j + i] = s->L[f->start + (long)f->ld * j + i];
    solve_dense(A, f->rows, x, 1, 1, 0.0);
    for (int i = 0; i < f->rows; i++) b[f->unknown[i]] = x[i];
}

/* A solution goes forward through fronts and backward again. Forward, whole lanes of a column are used: those above the diagonal change
   only what has been stored. Backward, what is known last comes last into a sum, by itself, so that sums overlap. */
static inline void forward(System *s, const Front *f, double *b)
{
    if (f->apart) return;
    const double *F = s->L + f->start;
    double *x = s->local;
    for (int i = 0; i < f->rows; i++) x[i] = b[f->unknown[i]];
    for (int i = 0; i < f->pivots && f->firm; i++)
        if (f->unknown[i] >= s->nu) s->firm[s->rows + f->unknown[i] - s->nu] = s->firm[f->unknown[i] - s->nu] * x[i];

    for (int k = 0; k < f->pivots; k++) {
        const lanes *column = (const lanes *)(F + (long)f->ld * k);
        lanes *to = (lanes *)x;
        int u = f->unknown[k];
        double c = x[k] * s->inverse[u];
        b[u] = x[k];
        for (int i = k / LANES; i < f->ld / LANES; i++) to[i] -= column[i] * c;
    }
    for (int i = f->pivots; i < f->rows; i++) b[f->unknown[i]] = x[i];
}

static inline void backward(System *s, const Front *f, double *b)
{
    if (f->apart) {
        solve_apart(s, f, b);
        return;
    }

    const double *F = s->L + f->start;
    double *x = s->local;
    for (int i = f->pivots; i < f->rows; i++) x[i] = b[f->unknown[i]];
    for (int i = f->rows; i < f->ld; i++) x[i] = 0.0;

    for (int k = f->pivots - 1; k >= 0; k--) {
        const double *column = F + (long)f->ld * k;
        const lanes *whole = (const lanes *)column, *known = (const lanes *)x;
        const int near = k / LANES + 2, u = f->unknown[k];
        lanes sums = {0.0};
        for (int i = f->ld / LANES - 1; i >= near; i--) sums += whole[i] * known[i];
        double sum = sums[0] + sums[1] + sums[2] + sums[3];
        for (int i = (near * LANES < f->rows ? near * LANES : f->rows) - 1; i > k; i--) sum += column[i] * x[i];
        b[u] = x[k] = (b[u] - sum) * s->inverse[u];
    }
    for (int i = 0; i < f->pivots && f->firm; i++)
        if (f->unknown[i] >= s->nu) b[f->unknown[i]] += s->firm[s->rows + f->unknown[i] - s->nu];
}

/* b <- solution for the right-hand side b, in the order of the unknowns. */
static void back_solve(System *s, double *b)
{
    for (Front *f = s->front; f < s->front + s->fronts; f++) forward(s, f, b);
    for (Front *f = s->front + s->fronts - 1; f >= s->front; f--) backward(s, f, b);
}
