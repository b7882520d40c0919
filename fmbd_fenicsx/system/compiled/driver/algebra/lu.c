/* L U of a sparse matrix, column by column in a given order, rows exchanged: each column of U is found by those columns of L that it
   reaches (Gilbert and Peierls, doi:10.1137/0909058). Included for real and for complex numbers, see stages.c.

   Of rows that may stand on the diagonal the column's own is taken unless another entry is much larger, so that little fills. */

/* The rows that a new row reaches through columns of L that are known, before those of the row in ``found``, from ``top`` on. */
static int NAME(reach)(const Stages *o, const Lower *f, int row, int mark, int top)
{
    int depth = 0;
    o->stack[0] = row;
    o->mark[row] = mark;
    o->next[0] = f->place[row] < 0 ? 0 : f->L_start[f->place[row]];

    while (depth >= 0) {
        int at = o->stack[depth], column = f->place[at];
        long end = column < 0 ? 0 : f->L_start[column + 1], p = o->next[depth];
        while (p < end && o->mark[f->L_row[p]] == mark) p++;

        if (p < end) {
            int below = f->L_row[p];
            o->next[depth] = p + 1;
            o->mark[below] = mark;
            o->stack[++depth] = below;
            o->next[depth] = f->place[below] < 0 ? 0 : f->L_start[f->place[below]];
        } else {
            o->found[--top] = at;
            depth--;
        }
    }
    return top;
}

/* SIZE: there was no room for the entries; SINGULAR: a column is zero. */
static int NAME(decompose)(const Stages *o, const NUMBER *A, Lower *f)
{
    NUMBER *L = (NUMBER *)f->L, *U = (NUMBER *)f->U, *pivots = (NUMBER *)f->pivot, *x = (NUMBER *)o->x;
    const int n = o->all;
    long lower = 0, upper = 0;
    for (int i = 0; i < n; i++) {
        f->place[i] = o->mark[i] = -1;
        x[i] = 0.0;
    }

    for (int k = 0; k < n; k++) {
        int column = o->order[k], top = n, best = -1;
        f->L_start[k] = lower;
        f->U_start[k] = upper;
        if (lower + n > o->room || upper + n > o->room) return SIZE;
        for (int p = o->start[column]; p < o->start[column + 1]; p++) {
            if (o->mark[o->row[p]] != k) top = NAME(reach)(o, f, o->row[p], k, top);
            x[o->row[p]] += A[p];
        }

        double largest = 0.0;
        for (int i = top; i < n; i++) {
            int row = o->found[i], known = f->place[row];
            NUMBER u = x[row];
            if (known < 0) {
                double size = MAGNITUDE(u);
                if (size > largest) largest = size, best = row;
                continue;
            }

            f->U_row[upper] = known;
            U[upper++] = u;
            for (long p = f->L_start[known]; p < f->L_start[known + 1]; p++) x[f->L_row[p]] -= L[p] * u;
        }
        if (best < 0) return SINGULAR;
        if (f->place[column] < 0 && o->mark[column] == k && MAGNITUDE(x[column]) >= OWN * largest) best = column;

        NUMBER pivot = x[best];
        f->place[best] = k;
        pivots[k] = pivot;
        for (int i = top; i < n; i++) {
            int row = o->found[i];
            if (f->place[row] < 0 && x[row] != 0.0) {
                f->L_row[lower] = row;
                L[lower++] = x[row] / pivot;
            }
            x[row] = 0.0;
        }

        f->L_start[k + 1] = lower;
    }
    f->U_start[n] = upper;
    for (long p = 0; p < lower; p++) f->L_row[p] = f->place[f->L_row[p]];
    return DONE;
}

/* y, like the unknowns, for the right-hand side b. */
static void NAME(substitute)(const Stages *o, const Lower *f, const NUMBER *b, NUMBER *y)
{
    const NUMBER *L = (NUMBER *)f->L, *U = (NUMBER *)f->U, *pivots = (NUMBER *)f->pivot;
    NUMBER *x = (NUMBER *)o->x;
    for (int i = 0; i < o->all; i++) x[f->place[i]] = b[i];
    for (int k = 0; k < o->all; k++) {
        NUMBER c = x[k];
        for (long p = f->L_start[k]; p < f->L_start[k + 1]; p++) x[f->L_row[p]] -= L[p] * c;
    }

    for (int k = o->all - 1; k >= 0; k--) {
        NUMBER c = x[k] / pivots[k];
        y[o->order[k]] = c;
        for (long p = f->U_start[k]; p < f->U_start[k + 1]; p++) x[f->U_row[p]] -= U[p] * c;
    }
}

/* Dependent rows get a softness on the diagonal, see soften() of factor.c. That of lambda has the phase of their compliance by the
   masses, G M^-1 G^T s^(level - 2), so that the two never cancel; what mu and tau move rows by, G U, has no frequency. */
static void NAME(soften)(const Stages *o, NUMBER s, NUMBER *A, NUMBER *soft)
{
    NUMBER pulled = o->first > 1 ? -1.0 : o->first ? -1.0 / s : -1.0 / (s * s);
    for (int j = o->n; j < o->n + o->levels * o->m; j++) {
        int lambda = j < o->n + o->m;
        soft[j] = (lambda ? pulled : 1.0) * o->softness[(j - o->n) % o->m];
        int p = o->start[j];
        while (o->row[p] != j) p++;
        A[p] += soft[j];
    }
}

/* A at one frequency s, its rows and columns scaled by powers of two, and its factors. */
static int NAME(factorise)(const Stages *o, int f, NUMBER s, NUMBER *A, double *rows, double *columns)
{
    NUMBER *soft = (NUMBER *)(o->soft + (long)f * 2 * o->size);
    for (long p = 0; p < o->entries; p++) {
        A[p] = o->K0[p] + s * (o->K1[p] + s * o->K2[p]);
        if (!(MAGNITUDE(A[p]) < INFINITY)) return NEWTON;
    }

    if (o->units) NAME(soften)(o, s, A, soft);
    for (long p = 0; p < o->entries; p++) o->sizes[p] = ABSOLUTE(A[p]);
    balance(o, rows, columns);
    for (int j = 0; j < o->all; j++)
        for (int p = o->start[j]; p < o->start[j + 1]; p++) A[p] *= rows[o->row[p]] * columns[j];
    for (int j = o->n; o->units && j < o->size; j++) soft[j] *= rows[j] * columns[j];
    return NAME(decompose)(o, A, o->lower + f);
}

/* y += A x of a matrix by rows. */
static void NAME(apply)(const Sparse *A, double sign, const NUMBER *x, NUMBER *y)
{
    for (int i = 0; i < A->rows; i++) {
        NUMBER sum = 0.0;
        for (int p = A->start[i]; p < A->start[i + 1]; p++) sum += A->data[p] * x[A->on[p]];
        y[i] += sign * sum;
    }
}

/* What y leaves of the scaled equations, into ``left``: the largest entry of the first ``rows``, and its scale. */
static double NAME(remainder)(const Stages *o, const NUMBER *A, const NUMBER *right, const NUMBER *y, NUMBER *left, int rows,
                              double *scale)
{
    double most = 0.0, given = 0.0, found = 0.0;
    for (int i = 0; i < o->all; i++) left[i] = right[i];
    for (int j = 0; j < o->all; j++)
        for (int p = o->start[j]; p < o->start[j + 1]; p++) left[o->row[p]] -= A[p] * y[j];
    for (int i = 0; i < o->all; i++) {
        double size = ABSOLUTE(left[i]);
        if (i < rows && !(size <= most)) most = size; /* nan stays */
        given = fmax(given, ABSOLUTE(right[i]));
        found = fmax(found, ABSOLUTE(y[i]));
    }

    *scale = given + found;
    return most;
}

/* A solution y of one frequency. */
typedef struct {
    const Stages *o;
    int f;
    NUMBER *y;
} NAME(Solution);

/* For rows that are ``times`` their softness times some multipliers open. */
static void NAME(of_softness)(void *of, double times, const double *mult, double *made, int keep)
{
    const NAME(Solution) *found = of;
    const Stages *o = found->o;
    const long N = sizeof(NUMBER) / sizeof(double);
    const NUMBER *soft = (const NUMBER *)(o->soft + (long)found->f * 2 * o->size), *given = (const NUMBER *)mult;
    NUMBER *open = (NUMBER *)(o->right + 2 * N * o->all), *more = open + o->all;
    for (int i = 0; i < o->all; i++) open[i] = i < o->n || i >= o->size ? 0.0 : -times * soft[i] * given[i - o->n];
    NAME(substitute)(o, o->lower + found->f, open, more);
    memcpy(made, more + o->n, (o->size - o->n) * sizeof(NUMBER));
    for (int i = 0; keep && i < o->all; i++)
        if (i < o->n || i >= o->size) found->y[i] += more[i];
}

/* A solution y with the corrections of soften(); levels of multipliers count by how soft their rows are. */
static void NAME(correct_softened)(const Stages *o, int f, NUMBER *y)
{
    const int N = sizeof(NUMBER) / sizeof(double), m = N * (o->size - o->n);
    const double *rows = o->scales + (long)f * 2 * o->all, *columns = rows + o->all;
    const NUMBER *soft = (const NUMBER *)(o->soft + (long)f * 2 * o->size);
    double *weight = o->faint + CLOSING * m;
    for (int i = 0; i < m; i++) {
        const int j = o->n + i / N;
        weight[i] = ABSOLUTE(soft[j]) * columns[j] / rows[j];
    }

    NAME(Solution) found = {o, f, y};
    const Softened softened = {m, o->corrections, weight, o->faint, NAME(of_softness), &found};
    close_softened(&softened, (double *)(y + o->n));
}

/* Increments dxi, dv behind each other and multipliers for the residuals of one frequency; ``judged``: as of the remainder. */
static void NAME(resolve)(const Stages *o, int f, const NUMBER *kin, const NUMBER *low, NUMBER *change, NUMBER *mult, double *judged)
{
    const int n = o->n;
    const long N = sizeof(NUMBER) / sizeof(double);
    const NUMBER *A = (NUMBER *)(o->A + f * 2 * o->entries), s = FREQUENCY(o->s + 2 * f);
    const double *rows = o->scales + (long)f * 2 * o->all, *columns = rows + o->all;
    NUMBER *right = (NUMBER *)o->right, *y = (NUMBER *)(o->right + N * o->all), *left = (NUMBER *)(o->right + 2 * N * o->all);
    NUMBER *more = (NUMBER *)(o->right + 3 * N * o->all);

    for (int i = 0; i < o->all; i++) right[i] = 0.0;
    NAME(apply)(&o->by_a, 1.0, kin, right);
    for (int i = 0; i < o->size; i++) right[i] = low[i] + s * right[i];
    NAME(apply)(&o->by_v, 1.0, kin, right);
    for (int i = 0; i < o->size; i++) right[i] *= -rows[i];

    NAME(substitute)(o, o->lower + f, right, y);
    judged[0] = NAME(remainder)(o, A, right, y, left, o->all, judged + 1);
    if (judged[0] > REFINE * judged[1]) {
        NAME(substitute)(o, o->lower + f, left, more);
        for (int i = 0; i < o->all; i++) y[i] += more[i];
        judged[0] = NAME(remainder)(o, A, right, y, left, o->all, judged + 1);
    }
    if (o->units) { /* rows that contradict each other stay open */
        NAME(correct_softened)(o, f, y);
        judged[0] = NAME(remainder)(o, A, right, y, left, o->n, judged + 1);
        if (judged[0] > REFINE * judged[1]) {
            for (int i = o->n; i < o->all; i++) left[i] = 0.0;
            NAME(substitute)(o, o->lower + f, left, more);
            for (int i = 0; i < o->all; i++) y[i] += more[i];
            judged[0] = NAME(remainder)(o, A, right, y, left, o->n, judged + 1);
        }
    }

    for (int i = 0; i < o->size; i++) y[i] *= columns[i];
    for (int i = 0; i < n; i++) {
        change[i] = y[i];
        change[n + i] = s * y[i] + kin[i];
    }
    for (int i = n; i < o->size; i++) mult[i - n] = y[i];
    NAME(apply)(&o->J, -1.0, y, change + n);
    if (o->levels > 1) NAME(apply)(&o->U, 1.0, mult + o->m, change + n);
}

/* Increments of all points that one frequency adds, from the residuals kin (points x n) and low (points x size). */
static void NAME(contribute)(const Stages *o, int f, double *judged)
{
    const int n = o->n, k = o->points, size = o->size;
    const double *inverse = o->inverse + 2 * k * f;
    NUMBER *kin = (NUMBER *)o->mixed, *low = kin + n, *change = low + size, *mult = change + 2 * n;
    for (int i = 0; i < n + size; i++) kin[i] = 0.0;
    for (int j = 0; j < k; j++) {
        NUMBER share = FREQUENCY(inverse + 2 * j);
        for (int i = 0; i < n; i++) kin[i] += share * o->kin[j * n + i];
        for (int i = 0; i < size; i++) low[i] += share * o->low[j * size + i];
    }

    NAME(resolve)(o, f, kin, low, change, mult, judged);
    for (int j = 0; j < k; j++) {
        NUMBER share = FREQUENCY(o->vectors + 2 * (j * o->frequencies + f));
        for (int i = 0; i < n; i++) o->dxi[j * n + i] += REAL(share * change[i]);
        for (int i = 0; i < n; i++) o->dv[j * n + i] += REAL(share * change[n + i]);
        for (int i = 0; i < size - n; i++) o->dmult[j * (size - n) + i] += REAL(share * mult[i]);
    }
}
