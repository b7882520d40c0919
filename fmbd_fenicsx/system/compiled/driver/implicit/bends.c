/* Points of an implicit step beside laws that turn out to be steep between level parts (bridges.c): some points slide, others stick, and
   one tangent serves neither. The tangent has none of their slopes then, and an increment all of them as they are at each point:

       A dx + sum r dN = -R,    dN = k r . dxi + c r . dv        (r: the row of a law at a point; A^-1: the tangent's)      (1)

   a small system for dN by the answers of all points to efforts of one. */

enum { MOST_BENT = 240 };               /* laws times points */
static const double SETTLED = 1e-4;    /* share of N that the last increment may change it by */
enum { BENT = 100 };                   /* a verdict: the tangent at hand has slopes of such laws */

typedef struct {
    Batch *k;
    long i;
    int point;
    double stiffness, damping, effort;
} Bend;

/* All laws at all points that have slopes, or formulas alone whose slopes there and in the tangent ``differ``, with the steeper ones;
   -1: there may be too many. */
static int bends_of(const System *s, const Stages *o, int differ, Bend *bends)
{
    int count = 0, laws = 0;
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) laws += k->line && !k->linked ? k->n : 0;
    if (laws * o->points > MOST_BENT) return -1;

    for (int j = 0; j < o->points; j++) {
        const double *had = o->slopes; /* by the tangent */
        for (Batch *k = s->batch; k < s->batch + s->batches; k++)
            for (long i = 0; k->line && !k->linked && i < k->n; i++) {
                const double *line = line_of(k, j, i);
                if (differ && k->role != FORMULA) continue;
                const double stiffness = differ ? steeper(line[3], *had++) : line[3];
                const double damping = differ ? steeper(line[4], *had++) : line[4];
                if (stiffness != 0.0 || damping != 0.0) bends[count++] = (Bend){k, i, j, stiffness, damping, line[2]};
            }
    }
    return count;
}

/* The row of a law at its point; ``last``: whose row was asked before, with nothing evaluated since, or NULL. */
static int bend_row(System *s, const Stages *o, const Bend *b, const Bend *last, double *row)
{
    const int n = o->n, j = b->point, there = last && last->point == j;
    double *q = o->local;
    if (!there) {
        configuration(s, o->q0, o->xi + (long)j * n, q);
        int verdict = place(s, q, o->v + (long)j * n);
        if (verdict) return verdict;
    }
    if (!there || last->k != b->k) values(s, b->k);
    memset(row, 0, n * sizeof(double));
    effort_row(s, b->k, b->i, row);
    return DONE;
}

/* What an increment changes the efforts of laws by. */
static int changes_of(System *s, const Stages *o, int count, const Bend *bends, double *changes)
{
    double *row = o->given + (long)o->points * (o->n + o->size);
    int verdict;
    for (int i = 0; i < count; i++) {
        const Bend *b = bends + i;
        const long at = (long)b->point * o->n;
        if ((verdict = bend_row(s, o, b, i ? b - 1 : NULL, row))) return verdict;
        changes[i] = b->stiffness * dot(row, o->dxi + at, o->n) + b->damping * dot(row, o->dv + at, o->n);
    }
    return DONE;
}

/* Whether they change by more than such a share. */
static int swings(int count, const Bend *bends, const double *changes, double share)
{
    for (int i = 0; i < count; i++)
        if (fabs(changes[i]) > share * fmax(fabs(bends[i].effort), largest(bends[i].k->effort, (int)bends[i].k->n))) return 1;
    return 0;
}

/* Whether an increment decides what laws do: one that moves hardly anything may lead through all of a steep one. */
static int hesitates(System *s, Stages *o)
{
    Bend bends[MOST_BENT];
    double changes[MOST_BENT];
    if (o->iterate == ON_ITS_OWN || o->hesitations >= HESITATIONS) return 0;
    if (!s->bent) {
        const int count = bends_of(s, o, 0, bends);
        if (count <= 0 || changes_of(s, o, count, bends, changes)) return 0;
        o->swings = swings(count, bends, changes, OF_THE_LAW);
    }
    o->hesitations += o->swings;
    return o->swings;
}

/* Whether an increment still changed efforts of formulas by slopes that the tangent does not have, or by those of the tangent: with those
   of a law that sticks what has come loose creeps, by increments that move hardly anything. */
static int creeps(System *s, const Stages *o)
{
    Bend bends[MOST_BENT];
    double changes[MOST_BENT];
    if (o->iterate == ON_ITS_OWN || s->bent) return 0;
    const int count = bends_of(s, o, 1, bends);
    return count > 0 && !changes_of(s, o, count, bends, changes) && swings(count, bends, changes, SETTLED);
}

/* (1), where the increment of the tangent alone is known. */
static int across_bends(System *s, Stages *o)
{
    Bend bends[MOST_BENT];
    double A[MOST_BENT * MOST_BENT], change[MOST_BENT];
    const long kin = (long)o->points * o->n, low = (long)o->points * o->size;
    const int count = bends_of(s, o, 0, bends);
    double *given = o->given, *row = given + kin + low;
    int verdict;
    o->swings = 0;
    if (count <= 0) return DONE;
    memcpy(given, o->kin, kin * sizeof(double));
    memcpy(given + kin, o->low, low * sizeof(double));
    if ((verdict = changes_of(s, o, count, bends, change))) return verdict;

    for (int j = 0; j < count; j++) {
        double answers[MOST_BENT];
        memset(o->kin, 0, kin * sizeof(double));
        memset(o->low, 0, low * sizeof(double));
        if ((verdict = bend_row(s, o, bends + j, NULL, row))) return verdict;
        memcpy(o->low + (long)bends[j].point * o->size, row, o->n * sizeof(double));
        if ((verdict = solve_points(s, o)) || (verdict = changes_of(s, o, count, bends, answers))) return verdict;
        for (int i = 0; i < count; i++) A[i * count + j] = (i == j) - answers[i];
    }
    if (solve_dense(A, count, change, 1, 1, 0.0)) return NEWTON;

    memcpy(o->kin, given, kin * sizeof(double));
    memcpy(o->low, given + kin, low * sizeof(double));
    for (int j = 0; j < count; j++) {
        if ((verdict = bend_row(s, o, bends + j, j ? bends + j - 1 : NULL, row))) return verdict;
        add(o->low + (long)bends[j].point * o->size, change[j], row, o->n);
    }
    o->swings = swings(count, bends, change, OF_THE_LAW);
    return solve_points(s, o);
}
