/* Springs with given efforts (ties.c) at the points of an implicit step. */

static const double SLACK = 1e-8; /* share of given efforts by which springs may pull otherwise at the end of a step */
enum { CLOSINGS = 4 };            /* corrections that bring them there */

/* The mean square of what the accelerations that changes of given efforts cause move in a step of h. */
static double pulled(const System *s, const Stages *o, double h)
{
    const Norm norm = norm_of(o);
    const int n = o->n, multipliers = o->size - n;
    double *pull = o->given, *moved = pull + n, worst = 0.0;
    if (!o->ties) return 0.0;

    for (int j = 0; j < o->points; j++) {
        const double *efforts = o->dmult + (long)j * multipliers + o->levels * o->m;
        memset(pull, 0, 2 * n * sizeof(double));
        for (int i = 0; i < o->R.rows; i++)
            for (int p = o->R.start[i]; p < o->R.start[i + 1]; p++) pull[o->R.on[p]] += o->R.data[p] * efforts[i];
        apply_real(&o->W, h * h, pull, moved);
        worst = worse(worst, mean_square(s, &norm, 0, moved));
    }
    return worst;
}

/* What springs pull at all points beyond their given efforts, and nothing else, among the residuals; whether it is worth closing. */
static int is_slack(System *s, const Stages *o, const Convergence *c)
{
    const int n = o->n, first = o->levels * o->m, multipliers = o->size - n;
    double *q = o->local, most = 0.0;
    int slack = 0;
    memset(o->kin, 0, (size_t)o->points * n * sizeof(double));
    memset(o->low, 0, (size_t)o->points * o->size * sizeof(double));
    for (int j = 0; j < o->points; j++) most = fmax(most, largest(o->mult + (long)j * multipliers + first, o->ties->count));

    for (int j = 0; j < o->points; j++) {
        double *rows = o->low + (long)j * o->size + n + first;
        configuration(s, o->q0, o->xi + (long)j * n, q);
        if (place(s, q, o->v + (long)j * n)) return 0;
        give(s, o->ties, o->mult + (long)j * multipliers + first);
        tie_rows(s, 1, rows);
        give(s, NULL, NULL);

        EACH_TIE(s, o->ties, k, i) {
            const double roundoff = (k->stiffness[o->ties->item[i]] + k->damping[o->ties->item[i]] / c->h) * c->still;
            slack |= fabs(rows[o->ties->number[i]]) > fmax(SLACK * most, roundoff);
        }
    }
    return slack;
}

/* Points at which springs pull by their given efforts: what Newton's iteration leaves of places, times the stiffness, is no small
   effort, nor its square a small energy. */
static int close_ties(System *s, Stages *o, const Convergence *c)
{
    int verdict = DONE;
    for (int k = 0; !verdict && k < CLOSINGS && is_slack(s, o, c); k++)
        if (!(verdict = solve_points(s, o))) add_increments(o);
    return verdict;
}
