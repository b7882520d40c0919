/* The stages of an implicit step in local coordinates: Newton's iteration is one call, and so are the factors of all frequencies. With K = K0 + s K1 + s^2 K2 for a frequency s, real or one of a complex pair (linear/implicit/pencil.py, whose symbols
   these are), the work is proportional to the entries of the factors: to the length of chains and trees. */

static const double OWN = 0.1;      /* share of the largest entry of a column from which its own row is its pivot */
static const double REFINE = 1e-12; /* relative residuals above this are refined once */

/* By rows. */
typedef struct {
    int rows, *start, *on;
    double *data;
} Sparse;

/* L, U and pivots of one frequency; place: which column a row is the pivot of. */
typedef struct {
    long *L_start, *U_start;
    int *L_row, *U_row, *place;
    double *L, *U, *pivot;
} Lower;

typedef struct {
    int n, m, size, all, levels, frequencies, points, first, corrections; /* size: unknowns; all: with those that only factors have;
                                                                             first: of the levels of rows */
    int frames;                     /* of n, those of twists of bodies */
    double pulls[2];                /* of the form, see Form */
    int *start, *row, *order;       /* K by columns; order of elimination */
    long entries, room;             /* room: for entries of L, and of U */
    double *K0, *K1, *K2, *s, *A, *scales, *sizes, *blocks; /* A: frequencies x entries, scaled; sizes: entries; */
                                    /* blocks: of K, side by side */
    double *units, *softness, *soft; /* units of multipliers, NULL: rows do not depend; m; frequencies x size, complex */
    double *faint;                  /* 2 (CLOSING + 1) x (size - n), see correct_softened() */
    Lower *lower;
    double *x, *right, *mixed;      /* work: size; 4 size; 3 n + 2 size, all complex */
    int *stack, *mark, *found;
    long *next;
    Sparse by_v, by_a, J, U, W;
    Sparse R;                       /* of ties, NULL: */
    Ties *ties;
    double *slopes;                 /* of the tangent, laws x 2, see note_slopes() */
    double *frozen;                 /* data of U where a step keeps that of its start, else NULL */
    /* the points */
    double *t, *q0, *xi, *rate, *v, *vd, *mult, *couple, *inverse, *vectors;  /* couple: points x points, d rate / d xi */
    double *past, *ends;            /* points x behind: d rate / d values at ends of steps; when these were, the newest first */
    int behind;
    double *kin, *low, *dxi, *dv, *dmult, *push;
    double *sampled;                /* points x what a SAMPLE writes */
    double *weigh, *moved, *judged; /* weigh: 3 x n, of dxi, dv and U dlambda; moved: 6; judged: 2, of an iteration */
    double *local, relax;           /* local: nq + 2 n */
    double *given;                  /* points x (n + size) + n + nq: work beside laws that bend, see bends.c, and ties */
    int iterate, swings, hesitations; /* what points are: ON_ITS_OWN ..; whether efforts of these laws changed much in an increment, */
                                    /* and how often they have been waited for */
    int crosses;                    /* whether an iteration crosses bends of laws */
    int kinds, *kind_end, *counted; /* entries like v whose means count by themselves, of the core and of each field: their ends, and */
                                    /* how many move */
    double *bases, *bent, span;     /* of rods and frames whose deformations are weighed apart, NULL: see bend(); n; s, of the step */
    struct FieldStages *fields;     /* of elastic fields, whose systems have no such K; NULL for others */
} Stages;

static Form form_of(const Stages *o) { return (Form){o->n, o->m, o->levels, o->first, o->pulls}; }

/* The nearest power of two. */
static double power(double x) { return x > 0.0 ? exp2(rint(log2(x))) : 1.0; }

/* Scales of rows and columns that bring all largest entries near one, two sweeps, as powers of two: no rounding; ``sizes`` is lost. */
static void balance(const Stages *o, double *rows, double *columns)
{
    double *most = o->x; /* of rows */
    for (int i = 0; i < o->all; i++) rows[i] = columns[i] = 1.0;
    for (int sweep = 0; sweep < 3; sweep++) {
        for (int i = 0; i < o->all; i++) most[i] = 0.0;
        for (int j = 0; j < o->all; j++)
            for (int p = o->start[j]; p < o->start[j + 1]; p++) most[o->row[p]] = fmax(most[o->row[p]], o->sizes[p]);
        for (int i = 0; i < o->all; i++) rows[i] /= most[i] = power(sweep < 2 ? sqrt(most[i]) : most[i]);

        for (int j = 0; sweep < 2 && j < o->all; j++) {
            double largest = 0.0;
            for (int p = o->start[j]; p < o->start[j + 1]; p++) largest = fmax(largest, o->sizes[p] /= most[o->row[p]]);
            largest = power(sqrt(largest));
            for (int p = o->start[j]; p < o->start[j + 1]; p++) o->sizes[p] /= largest;
            columns[j] /= largest;
        }
    }
}

static const double LEAST_SOFT = 1e-12; /* as SOFT: above what roundoff leaves of pivots */
static const double FIRM = 1e-6;        /* most that a solution may leave open of the row that moves least */

/* How soft dependent rows are at a frequency of one, by the masses. Rows that hold light bodies may together move heavy ones alone: that
   is closed as well, so what moves least is that of each row on one body of its own. */
static void soften_rows(const Stages *o)
{
    double *mass = o->x, most = 0.0, least = INFINITY;
    for (int j = 0; j < o->n; j++)
        for (int p = o->start[j]; p < o->start[j + 1]; p++)
            if (o->row[p] == j) mass[j] = o->K2[p];
    for (int i = 0; i < o->m; i++) {
        double weight = 0.0, own = 0.0;
        for (int p = o->start[o->n + i], body = -1; p < o->start[o->n + i + 1]; p++) {
            const int row = o->row[p];
            if (row >= o->n || !(mass[row] > 0.0)) continue;

            const double moved = o->units[i] * o->units[i] * o->K0[p] * o->K0[p] / mass[row];
            weight += moved;
            if (row >= o->frames) continue;
            if (own > 0.0 && row / TWIST != body) least = fmin(least, own), own = 0.0;
            own += moved;
            body = row / TWIST;
        }
        most = fmax(most, weight);
        if (weight > 0.0) least = fmin(least, own > 0.0 ? own : weight);
    }
    const double soft = fmax(fmin(SOFT * most, FIRM * least), LEAST_SOFT * most);
    for (int i = 0; i < o->m; i++) o->softness[i] = soft / (o->units[i] * o->units[i]);
}

#define NUMBER double
#define NAME(x) x##_real
#define MAGNITUDE(x) fabs(x)
#define ABSOLUTE(x) fabs(x)
#define REAL(x) (x)
#define FREQUENCY(x) (*(x))
#include "algebra/lu.c"
#undef NUMBER
#undef NAME
#undef MAGNITUDE
#undef ABSOLUTE
#undef REAL
#undef FREQUENCY

#define NUMBER double complex
#define NAME(x) x##_complex
#define MAGNITUDE(x) (fabs(creal(x)) + fabs(cimag(x)))
#define ABSOLUTE(x) cabs(x)
#define REAL(x) creal(x)
#define FREQUENCY(x) (*(const double complex *)(x))
#include "algebra/lu.c"

/* Whether points have a share in a frequency: not in one that filters errors only. */
static int shared(const Stages *o, int f)
{
    const double *inverse = o->inverse + 2 * (long)o->points * f;
    for (int j = 0; j < 2 * o->points; j++)
        if (inverse[j] != 0.0) return 1;
    return 0;
}

/* Factors of all frequencies, of a tangent with these data. */
EXPORT int driver_stage_factors(Stages *o, const Patterns *patterns, const double *data)
{
    double *const K[3] = {o->K0, o->K1, o->K2};
    powers(patterns, data, o->blocks, K);
    if (o->units) soften_rows(o);
    for (int f = 0; f < o->frequencies; f++) {
        double *A = o->A + f * 2 * o->entries, *rows = o->scales + (long)f * 2 * o->all, *s = o->s + 2 * f;
        int verdict = s[1] == 0.0 ? factorise_real(o, f, *s, A, rows, rows + o->all)
                                  : factorise_complex(o, f, *(double complex *)s, (double complex *)A, rows, rows + o->all);
        if (verdict) return verdict;
    }
    return DONE;
}

/* Increments and multipliers for residuals kin and low of the first so many frequencies, complex numbers: count x n, x size. */
EXPORT int driver_stage_solve(Stages *o, int count, const double *kin, const double *low, double *change, double *mult, double *judged)
{
    const int n = o->n, size = o->size;
    for (int f = 0; f < count; f++, kin += 2 * n, low += 2 * size, change += 4 * n, mult += 2 * (size - n), judged += 2) {
        if (o->s[2 * f + 1] != 0.0) {
            resolve_complex(o, f, (const double complex *)kin, (const double complex *)low, (double complex *)change,
                            (double complex *)mult, judged);
            continue;
        }

        double *k = o->mixed, *l = k + n, *x = l + size, *y = x + 2 * n, least[2] = {0.0, 0.0};
        for (int part = 0; part < 2; part++) {
            for (int i = 0; i < n; i++) k[i] = kin[2 * i + part];
            for (int i = 0; i < size; i++) l[i] = low[2 * i + part];
            resolve_real(o, f, k, l, x, y, judged);
            for (int i = 0; i < 2 * n; i++) change[2 * i + part] = x[i];
            for (int i = 0; i < size - n; i++) mult[2 * i + part] = y[i];
            for (int i = 0; i < 2; i++) judged[i] = least[i] = fmax(judged[i], least[i]);
        }
    }
    return DONE;
}

/* Multipliers that correct velocities and accelerations along the normal directions U = W G^T, or along those that a step keeps; each
   may be NULL. */
typedef struct {
    const Sparse *W, *frozen;
    const double *mu, *tau;
} Normal;

/* to += factor U mult, where frames are placed. ``push``: room, nv. */
static void add_normal(System *s, const Normal *o, double factor, const double *mult, double *push, double *to)
{
    if (o->frozen) {
        apply_real(o->frozen, factor, mult, to);
        return;
    }
    all_rows(s, mult, push);
    apply_real(o->W, factor, push, to);
}

/* A point q0 o exp(xi): the rate of xi for the velocities v - U mu, and the balance for the accelerations a + U tau, which stand in
   ``room`` behind nq numbers; what rows leave open stands in the system. ``room``: nq + 2 nv. */
static int local_point(System *s, const Normal *along, double t, const double *q0, const double *xi, const double *v, const double *a,
                       const double *lam, double *rates, double *sums, double *room)
{
    double *q = room, *pushed = q + s->nq, *push = pushed + s->nv;
    int verdict = DONE;
    configuration(s, q0, xi, q);
    memcpy(pushed, a, s->nv * sizeof(double));
    if (along->tau) {
        if (!along->frozen && (verdict = place(s, q, v))) return verdict;
        add_normal(s, along, 1.0, along->tau, push, pushed);
    }

    if ((verdict = evaluate(s, q, v, pushed, lam, t))) return verdict;
    like_v(s, s->residual, sums);
    memcpy(rates, v, s->nv * sizeof(double));
    if (along->mu) add_normal(s, along, -1.0, along->mu, push, rates);
    for (int b = 0; b < s->bodies; b++) rate_of(xi + TWIST * b, rates + TWIST * b);
    return DONE;
}

/* Points of an implicit step: the rates of xi, the sums of the balance, g and G v + g_t. W: by rows. ``room``: nq + 2 nv. */
EXPORT int driver_points(System *s, long count, const double *t, const double *q0, const double *xi, const double *v, const double *a,
                         const double *lam, const double *mu, int *W_start, int *W_on, double *W, double *rates, double *sums,
                         double *gap, double *slip, double *room)
{
    const Sparse metric = {s->nv, W_start, W_on, W};
    double last = NAN;
    int verdict = foretell_points(s, count, t, 0, q0, xi, v, a, room);
    if (verdict) return verdict;
    for (long i = 0; i < count; i++, xi += s->nv, v += s->nv, a += s->nv, rates += s->nv, sums += s->nv) {
        long at = i * s->rows;
        if ((verdict = sample(s, t[i], &last))) return verdict;

        const Normal along = {&metric, NULL, mu ? mu + at : NULL, NULL};
        if ((verdict = local_point(s, &along, t[i], q0, xi, v, a, lam + at, rates, sums, room))) return verdict;
        drift(s);
        memcpy(gap + at, s->gap, s->rows * sizeof(double));
        memcpy(slip + at, s->slip, s->rows * sizeof(double));
    }
    return DONE;
}

#include "implicit/field_stages.c"

/* What depends on time only at point j: asked for where Newton's iteration begins, the same for all ``increments`` after. */
static int sample_point(System *s, const Stages *o, int j, int increments)
{
    double *kept = o->sampled + j * sample_size(s), last = NAN;
    if (increments) return recall_sample(s, kept, o->t[j]);
    int verdict = sample(s, o->t[j], &last);
    if (!verdict && s->samples) keep_sample(s, kept, 0);
    return verdict;
}

/* The normal directions that multipliers act along: those of the tangent, or those that the step keeps. */
static Sparse directions_of(const Stages *o)
{
    Sparse U = o->U;
    if (o->frozen) U.data = o->frozen;
    return U;
}

/* What corrects point j; ``directions``: as above. */
static Normal normal_at(const Stages *o, const Sparse *directions, int j)
{
    const double *mult = o->mult + (long)j * (o->size - o->n);
    const int levels = o->fields ? 0 : o->levels;
    return (Normal){&o->W, o->frozen ? directions : NULL, levels > 1 ? mult + o->m : NULL, levels > 2 ? mult + 2 * o->m : NULL};
}

#include "implicit/memories.c"

/* What the points leave of the equations after so many increments: kin, points x n, and low, points x size. */
static int stage_residuals(System *s, const Stages *o, int increments)
{
    const int n = o->n, size = o->size;
    const Form form = form_of(o);
    const Sparse frozen = directions_of(o);
    int verdict, known = increments || (o->fields && o->fields->aligned);
    if (s->remembered) {
        if ((verdict = remember_points(s, o, known))) return verdict;
        known = 1;
    }

    s->bridged = s->swung = 0;
    if (o->fields) o->fields->aligned = 0;
    s->iterate = o->iterate;
    verdict = foretell_points(s, o->points, o->t, 0, o->q0, o->xi, o->v, o->levels < 3 ? o->vd : NULL, o->local);
    s->iterate = ON_ITS_OWN;
    if (verdict) return verdict;
    for (int j = 0; j < o->points; j++) {
        double *kin = o->kin + j * n, *low = o->low + j * size, *mult = o->mult + j * (size - n);
        if ((verdict = sample_point(s, o, j, known))) return verdict;

        const Normal along = normal_at(o, &frozen, j);
        const int carried = o->fields ? o->fields->pressures : 0;
        s->point = j;
        s->iterate = o->iterate;
        if (carried) exchange_pressures(s, OUT_OF, 0, o->fields->pressure + (long)j * carried);
        give(s, o->ties, mult + o->levels * o->m);
        verdict = local_point(s, &along, o->t[j], o->q0, o->xi + j * n, o->v + j * n, o->vd + j * n, mult, kin, low, o->local);
        if (carried) close_point(s, o, j, low);
        s->iterate = ON_ITS_OWN;
        s->point = 0;

        for (int i = 0; i < n && !verdict; i++) {
            kin[i] = o->rate[j * n + i] - kin[i];
            if (!(fabs(low[i]) < INFINITY)) verdict = NEWTON;
        }

        if (!verdict) level_rows(s, &form, o->local + s->nq, low);
        give(s, NULL, NULL);
        if (verdict) return verdict;
    }

    if (o->fields) lacking(s, o);
    return DONE;
}

/* What increments and errors of points are measured by. */
static Norm norm_of(const Stages *o)
{
    return (Norm){o->n, o->kinds, o->kind_end, o->counted, o->weigh, o->bases, o->bent, o->span};
}

/* The largest over so many of them. */
static double largest_square(const System *s, const Stages *o, int count, int kind, const double *x)
{
    const Norm norm = norm_of(o);
    double worst = 0.0;
    for (int j = 0; j < count; j++, x += o->n) worst = worse(worst, mean_square(s, &norm, kind, x));
    return worst;
}

/* The largest length in x, of so many. */
static double largest_length(const System *s, const Stages *o, int count, const double *x)
{
    double worst = 0.0;
    for (int j = 0; j < count; j++) worst = worse(worst, largest_of(s->units, x + j * o->n, o->n));
    return worst;
}

/* The linear residual of a solution, and its scale, into ``most`` where they are farther apart than those. */
static void farthest_apart(const double *judged, double *most)
{
    double share = judged[0] / (judged[1] > 0.0 ? judged[1] : 1.0);
    if (!(share <= most[0] / (most[1] > 0.0 ? most[1] : 1.0))) memcpy(most, judged, 2 * sizeof *most);
}

/* What the tangent answers to the residuals of all points. */
static int solve_points(System *s, Stages *o)
{
    const int n = o->n, k = o->points, multipliers = o->size - n;
    double judged[2];
    int verdict;
    memset(o->dxi, 0, (size_t)k * n * sizeof(double));
    memset(o->dv, 0, (size_t)k * n * sizeof(double));
    memset(o->dmult, 0, (size_t)k * multipliers * sizeof(double));
    if (o->fields && (verdict = field_increments(s, o))) return verdict;

    for (int f = 0; f < o->frequencies && !o->fields; f++) {
        if (!shared(o, f)) continue;
        if (o->s[2 * f + 1] == 0.0) contribute_real(o, f, judged);
        else contribute_complex(o, f, judged);
        farthest_apart(judged, o->judged);
    }
    for (int i = 0; i < k * n; i++) o->dxi[i] *= o->relax, o->dv[i] *= o->relax;
    for (int i = 0; i < k * multipliers; i++) o->dmult[i] *= o->relax;
    return DONE;
}

/* All points move along with their increments. */
static void add_increments(Stages *o)
{
    const int n = o->n, k = o->points;
    add(o->xi, 1.0, o->dxi, k * n);
    add(o->v, 1.0, o->dv, k * n);
    add(o->mult, 1.0, o->dmult, k * (o->size - n));
    for (int j = 0; j < k; j++)
        for (int i = 0; i < k; i++) {
            add(o->rate + j * n, o->couple[j * k + i], o->dxi + i * n, n);
            add(o->vd + j * n, o->couple[j * k + i], o->dv + i * n, n);
        }
}

#include "implicit/bends.c"
#include "implicit/tied_points.c"
#include "implicit/pushes.c"

/* One increment of all points, behind so many of this call: residuals, solutions, what they move. ``moved``: the largest lengths of dxi, dv and U dlambda, and the
   mean squares of the three by their weights; ``judged``: as of farthest_apart(). */
static int stage_increment(System *s, Stages *o, int increments)
{
    const int k = o->points;
    s->noted = o->slopes;
    int verdict = stage_residuals(s, o, increments);
    s->noted = NULL;
    if (verdict) return verdict;
    if ((s->bridged || s->swung) && !s->bent && o->iterate == FOLLOWING) return BENT;
    if ((verdict = solve_points(s, o)) || (s->bent && (verdict = across_bends(s, o)))) return verdict;

    if ((verdict = pushes(s, o, o->dmult))) return verdict;
    const double *moved[3] = {o->dxi, o->dv, o->push};
    for (int i = 0; i < 3; i++) {
        const int count = i == 2 && o->levels > 2 && !o->fields ? 2 * k : k;
        o->moved[i] = largest_length(s, o, count, moved[i]);
        o->moved[3 + i] = largest_square(s, o, count, i, moved[i]);
    }

    if (o->fields) move_points(o);
    add_increments(o);
    return DONE;
}

/* The size of an increment, over the tolerance. */
static double size_moved(const System *s, const Stages *o, const Convergence *c)
{
    const double *moved = o->moved;
    for (int i = 0; i < 6; i++)
        if (!(moved[i] < INFINITY)) return INFINITY;
    if (c->adaptive) return sqrt(fmax(fmax(moved[3], pulled(s, o, c->h)), fmax(moved[4], moved[5])));
    return fmax(fmax(moved[0], c->h * moved[1]), c->h * c->h * moved[2]) / c->allowed;
}

static const double FALLS = 0.5; /* rate up to which an iteration with the tangent at hand goes on where laws are still to settle */

/* Newton's iteration, as far as solutions are accurate; what depends on time only is sampled at the last of the points then. */
static int increments_of(System *s, Stages *o, Convergence *c)
{
    const int before = c->done;
    o->judged[0] = o->judged[1] = 0.0;
    while (c->outcome == GOES_ON && c->done < c->most && o->judged[0] <= c->accurate * o->judged[1]) {
        int verdict = stage_increment(s, o, c->done - before);
        if (verdict && c->done > before) sample_point(s, o, o->points - 1, 1);
        if (verdict) return verdict;
        if (s->bridged) pass_increment(c, size_moved(s, o, c));
        else judge_increment(c, size_moved(s, o, c), fmax(o->moved[0], c->h * o->moved[1]) <= c->still);
        if (o->crosses && o->iterate != ON_ITS_OWN) o->iterate = FOLLOWING;
        if (c->outcome != CONVERGED || c->done >= c->most) continue;

        const int crept = creeps(s, o);
        if (crept || (o->crosses && hesitates(s, o))) c->outcome = GOES_ON;
        if (crept && (o->crosses || c->theta > FALLS)) return BENT;
    }
    return o->ties && c->outcome == CONVERGED ? close_ties(s, o, c) : DONE;
}

/* The same with a tangent that stays: where what slides creeps on its slopes of what stuck, the iteration has failed. */
static int increments_by_one_tangent(System *s, Stages *o, Convergence *c)
{
    Bend none[MOST_BENT];
    note_slopes(o->fields->by[0], o->slopes);
    o->iterate = bends_of(s, o, 0, none) < 0 ? ON_ITS_OWN : FIRST;
    const int verdict = increments_of(s, o, c);
    o->iterate = ON_ITS_OWN;
    if (verdict != BENT) return verdict;
    c->outcome = TOO_SLOW;
    return DONE;
}
