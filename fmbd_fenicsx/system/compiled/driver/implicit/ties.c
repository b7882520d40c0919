/* Springs whose efforts N are unknowns of an implicit step (system/tangents/stiff_ties.py): where N is given, and what it misses. */

/* From now on N are these of a point; NULL: there are no such springs. */
static void give(System *s, Ties *o, const double *efforts)
{
    if (o) o->efforts = efforts;
    s->ties = o;
}

/* What each of them does: its item j of batch k, whose effort is number ``on``. */
#define EACH_TIE(s, o, k, j)                                       \
    for (Batch *k = (s)->batch; k < (s)->batch + (s)->batches; k++) \
        for (int j = (o)->start[k - (s)->batch]; j < (o)->start[k - (s)->batch + 1]; j++)

/* k (s - free) + c s' - N where a point was evaluated; or ``placed`` only. */
static void tie_rows(System *s, int placed, double *rows)
{
    const Ties *o = s->ties;
    EACH_TIE(s, o, k, j) {
        const int i = o->item[j], number = o->number[j];
        if (placed && j == o->start[k - s->batch]) {
            values(s, k);
            efforts(s, k, 0.0); /* linear */
        }
        rows[number] = k->stiffness[i] * (k->s[i] - k->free[i]) + k->damping[i] * k->rate[i] - o->efforts[number];
    }
}

/* R by its pattern, where frames are placed, and k R and c R among the entries ``at`` of derivatives. ``row``: nv of zeros, and again. */
static void tie_slopes(System *s, const Ties *o, const int *start, const int *on, const long *at, double *row, double *R, double *by_q,
                       double *by_v)
{
    EACH_TIE(s, o, k, j) {
        const int i = o->item[j], number = o->number[j];
        if (j == o->start[k - s->batch]) values(s, k);
        effort_row(s, k, i, row);

        for (int p = start[number]; p < start[number + 1]; p++) {
            R[p] = row[on[p]];
            row[on[p]] = 0.0;
            by_q[at[p]] = k->stiffness[i] * R[p];
            by_v[at[p]] = k->damping[i] * R[p];
        }
    }
}
