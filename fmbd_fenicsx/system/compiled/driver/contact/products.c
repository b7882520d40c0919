/* The compliance of many contacts of fields by its products, each a solution with the factors of the step, and what is nearly its inverse:
   linear/complementarity/delassus_matrix_free.py. */

static const double SOFTER = 0.1; /* of a point's stiffness with all others held: by such a one its law compares gaps with forces */

/* u = W f, as a Lumped asks for it; not a number where there is no solution. */
static void answered_by(const void *by, const double *f, double *u)
{
    const ElasticContact *o = by;
    const Lumped *l = o->problem->all.lumped;
    const int d = o->contacts->components;
    System *s = o->contacts->system;
    double *x = o->room + s->nv;
    if (largest(f, d * o->count) == 0.0) {
        memset(u, 0, d * o->count * sizeof(double));
        return;
    }

    o->problem->tally.products++;
    const int failed = pushed(s, o, l->scale, f, x, NULL);
    for (int r = 0; r < d * o->count; r++) u[r] = failed ? NAN : l->still[r / d] ? 0.0 : row_times(o, o->near[r / d], o->slopes + WIDE * r, x);
}

/* The block of E between two nodes of a trace; NULL for none. */
static const double *stiffness_between(const Nodes *k, int i, int j)
{
    const int e = found_in(k->column, k->start[i], k->start[i + 1], j);
    return e < k->start[i + 1] && k->column[e] == j ? k->E + (long)D * D * e : NULL;
}

/* Rows of the first side, whose nodes carry the multipliers, over their squared sizes. */
static void take_shares(const ElasticContact *o, int i, double *shares)
{
    const int d = o->contacts->components;
    const Side k = side_of(o, o->near[i], 0);
    for (int a = 0; a < d; a++) {
        const double *row = o->axes + D * 2 * (d * i + a);
        double size = 0.0;
        for (int e = 0; e < k.count; e++) size += k.weight[e] * k.weight[e] * dot(row, row, D);
        for (int j = 0; j < D; j++) shares[D * a + j] = size > 0.0 ? row[j] / size : 0.0;
    }
}

/* (N N^T)^-1 N E N^T (N N^T)^-1 / scale of candidates i and j of those near, into a block. */
static void lumped_block(const ElasticContact *o, int i, int j, double scale, double *block)
{
    const int d = o->contacts->components;
    const Side k = side_of(o, o->near[i], 0), l = side_of(o, o->near[j], 0);
    double left[D * D], right[D * D], moved[D];
    take_shares(o, i, left);
    take_shares(o, j, right);
    memset(block, 0, d * d * sizeof(double));

    for (int e = 0; e < k.count; e++)
        for (int g = 0; g < l.count; g++) {
            const double *E = stiffness_between(k.nodes, number_of(&k, e), number_of(&l, g));
            for (int b = 0; E && b < d; b++) {
                for (int n = 0; n < D; n++) moved[n] = k.weight[e] * l.weight[g] / scale * dot(E + D * n, right + D * b, D);
                for (int a = 0; a < d; a++) block[d * a + b] += dot(left + D * a, moved, D);
            }
        }
}

/* The same for all pairs in the pattern, with the diagonal that makes gaps and slips comparable with forces. */
static void take_lumped(const ElasticContact *o, double scale)
{
    const int d = o->contacts->components, m = o->count;
    Problem *P = &o->problem->all;
    Lumped *l = P->lumped;
    const Problem *H = &l->inverse;
    l->times = answered_by, l->by = o, l->scale = scale;

    for (int i = 0; i < m; i++) {
        double *own = P->own + i * d * d;
        const int p = l->place[i];
        lumped_block(o, i, i, scale, H->own + p * d * d);
        memset(own, 0, d * d * sizeof(double));
        for (int a = 0; a < d * d; a += d + 1) own[a] = 1.0 / fmax(SOFTER * H->own[p * d * d + a], 1e-300);
        for (int e = H->first[p]; e < H->first[p + 1]; e++) lumped_block(o, i, l->of[H->near[e]], scale, H->W + (long)e * d * d);
    }
}
