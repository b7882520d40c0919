/* Surfaces of facets that may touch: means over their nodes by mortar integrals, as mechanics/contact/mortar.py and fem/traces/mortar.py
   define them. Which facets may see each other Python tells, with a margin: the list lasts until nodes have moved by a share of it. */

enum { FUNCTIONS = 64, CLIPPED = 8, UNSKEWING = 8 }; /* most functions of a facet; corners of an overlap; steps of Newton's method */
enum { ACROSS = D - 1 };                              /* dimension of facets */
static const double COVERED = 0.05, EMPTY = 1e-12, FACING_EACH_OTHER = 0.5; /* shares of a weight, of a facet; of normals */

/* Functions on a reference facet: sums of products of powers of its coordinates. */
typedef struct {
    int count, terms;
    int *power;                        /* terms x ACROSS */
    double *share;                     /* count x terms */
} Shapes;

/* The facets of a surface, whose nodes are the points of a pair. */
typedef struct {
    int pair, facets, nodes;           /* nodes of each facet */
    int *node;                         /* facets x nodes: numbers in the pair, corners first */
    double *outward, *skew;            /* facets: sign of what is across them in their order; x 2: of halves of quadrilaterals, else NULL */
    double *normal, *size, *stood;     /* facets x D; facets: lengths or areas; points x D: where they were when the list was made */
    Shapes shapes;
} Facets;

/* Weighted sums over the points of a pair: entries of each row, one after the other. */
typedef struct Means {
    int *first, *node;
    double *weight;
} Means;

/* Two surfaces, slave first: multipliers of a facet, what they are by functions psi of it, the facets that hold each; pairs of facets. */
typedef struct Meeting {
    int pair, multipliers, points;     /* of candidates, which are its multipliers; of a facet; of a quadrature */
    double search, skin;               /* how far facets look for each other, nan: by their size; the margin of the list, m */
    Facets side[2];
    Shapes psi;
    int *held, *holder, *at;           /* candidates + 1; facet * multipliers + number; node of each */
    double *coefficient, *weight;      /* facets x multipliers x psi; candidates: int psi at rest */
    double *place, *part;              /* points x ACROSS; points */
    double *sight, *saw;               /* facets: how far they look, and did when the list was made */
    int listed, *begin, *other, *used; /* whether there is a list; facets + 1; facets of the master; whether they overlap */
    double *block, *sum;               /* of each pair: multipliers x nodes of both; room for the points of a side */
    int *touched, *mark;               /* of these; for whom they are taken */
    Means *means;                      /* of both sides */
    double *normal, *offset;           /* candidates x D; overlap at the start of the step that is not pushed out, m */
} Meeting;

static void take_functions(const Shapes *k, const double *x, double *values)
{
    double term[FUNCTIONS];
    for (int t = 0; t < k->terms; t++) {
        term[t] = 1.0;
        for (int a = 0; a < ACROSS; a++)
            for (int n = 0; n < k->power[ACROSS * t + a]; n++) term[t] *= x[a];
    }
    for (int i = 0; i < k->count; i++) values[i] = dot(k->share + k->terms * i, term, k->terms);
}

/* The functions of a facet at a place on it; halves of quadrilaterals have those of the whole, (1) of fem/traces/quadrilaterals.py. */
static void functions_at(const Facets *k, int f, const double *at, double *values)
{
    double x[2] = {at[0], at[ACROSS - 1]};
    for (int n = 0; k->skew && n < UNSKEWING; n++) {
        const double *s = k->skew + 2 * f, off[] = {x[0] + s[0] * x[0] * x[1] - at[0], x[1] + s[1] * x[0] * x[1] - at[1]};
        const double a = 1.0 + s[0] * x[1], b = s[0] * x[0], c = s[1] * x[1], d = 1.0 + s[1] * x[0], det = a * d - b * c;
        x[0] -= (d * off[0] - b * off[1]) / det;
        x[1] -= (a * off[1] - c * off[0]) / det;
    }
    take_functions(&k->shapes, x, values);
}

/* Node n of facet f. */
static const double *node_of(const Contacts *c, const Facets *k, const double *x, int f, int n)
{
    return x + D * (c->pair[k->pair].first + k->node[k->nodes * f + n]);
}

/* Normals and sizes of the facets as they lie. */
static void lay_facets(const Contacts *c, const Facets *k, const double *x)
{
    for (int f = 0; f < k->facets; f++) {
        double e[ACROSS][D], *n = k->normal + D * f;
        for (int a = 0; a < ACROSS; a++)
            for (int j = 0; j < D; j++) e[a][j] = node_of(c, k, x, f, a + 1)[j] - node_of(c, k, x, f, 0)[j];

#if DIM == 2
        n[0] = e[0][1], n[1] = -e[0][0];
#else
        moment(e[0], e[1], n);
#endif
        const double size = length_of(n);
        for (int j = 0; j < D; j++) n[j] *= k->outward[f] / size;
        k->size[f] = size / ACROSS;
    }
}

/* The place on a facet under a point, along its normal. */
static void place_under(const Contacts *c, const Facets *k, const double *x, int f, const double *point, double *place)
{
    const double *origin = node_of(c, k, x, f, 0);
    double e[ACROSS][D], way[D], G[ACROSS][ACROSS], b[ACROSS];
    for (int j = 0; j < D; j++) way[j] = point[j] - origin[j];
    for (int a = 0; a < ACROSS; a++) {
        for (int j = 0; j < D; j++) e[a][j] = node_of(c, k, x, f, a + 1)[j] - origin[j];
        b[a] = dot(e[a], way, D);
        for (int i = 0; i <= a; i++) G[a][i] = G[i][a] = dot(e[a], e[i], D);
    }

#if DIM == 2
    place[0] = b[0] / G[0][0];
#else
    const double det = G[0][0] * G[1][1] - G[0][1] * G[0][1];
    place[0] = (G[1][1] * b[0] - G[0][1] * b[1]) / det;
    place[1] = (G[0][0] * b[1] - G[0][1] * b[0]) / det;
#endif
}

/* Where a place of slave facet f meets master facet g along the normal of f; how far that is. */
static double opposite(const Contacts *c, const Meeting *o, const double *x, int f, int g, const double *at, double *there)
{
    const Facets *a = o->side, *b = o->side + 1;
    const double *n = a->normal + D * f, *m = b->normal + D * g, *origin = node_of(c, a, x, f, 0), *far = node_of(c, b, x, g, 0);
    double point[D], gap = 0.0;
    for (int j = 0; j < D; j++) {
        point[j] = origin[j];
        for (int k = 0; k < ACROSS; k++) point[j] += at[k] * (node_of(c, a, x, f, k + 1)[j] - origin[j]);
        gap += m[j] * (far[j] - point[j]);
    }

    gap /= dot(n, m, D);
    add(point, gap, n, D);
    place_under(c, b, x, g, point, there);
    return gap;
}

/* Integrals over a part of facet f, a segment or triangle with these corners, of psi with the functions of both; whether g is seen. */
static int integrate(const Contacts *c, const Meeting *o, const double *x, int f, int g, const double *corner, double *own, double *other)
{
    const Facets *a = o->side, *b = o->side + 1;
    double at[ACROSS], there[ACROSS], psi[FUNCTIONS], phi[FUNCTIONS], share = corner[ACROSS] - corner[0];
#if DIM == 3
    share = share * (corner[5] - corner[1]) - (corner[3] - corner[1]) * (corner[4] - corner[0]);
#endif
    share = fabs(share);
    if (!(share > EMPTY)) return 0;

    for (int sum = 0; sum < 2; sum++)
        for (int q = 0; q < o->points; q++) {
            for (int k = 0; k < ACROSS; k++) {
                at[k] = corner[k];
                for (int i = 0; i < ACROSS; i++)
                    at[k] += o->place[ACROSS * q + i] * (corner[ACROSS * (i + 1) + k] - corner[k]);
            }

            const double gap = opposite(c, o, x, f, g, at, there), part = share * a->size[f] * o->part[q];
            if (!sum && !(fabs(gap) <= o->sight[f])) return 0;
            if (!sum) continue;
            take_functions(&o->psi, at, psi);
            functions_at(a, f, at, phi);
            for (int i = 0; i < o->psi.count; i++) add(own + a->nodes * i, part * psi[i], phi, a->nodes);
            functions_at(b, g, there, phi);
            for (int i = 0; i < o->psi.count; i++) add(other + b->nodes * i, part * psi[i], phi, b->nodes);
        }
    return 1;
}

#if DIM == 3
/* What is left of a polygon where side >= 0: 0 and 1 are coordinates, 2 is 1 - both. */
static int clip(double v[CLIPPED][2], int count, int side)
{
    double kept[CLIPPED][2], height[CLIPPED];
    int made = 0;
    for (int i = 0; i < count; i++) height[i] = side < 2 ? v[i][side] : 1.0 - v[i][0] - v[i][1];
    for (int i = 0; i < count; i++) {
        const int j = (i + 1) % count;
        if (height[i] >= 0.0) memcpy(kept[made++], v[i], sizeof *kept);
        if (height[i] * height[j] >= 0.0) continue;

        const double s = height[i] / (height[i] - height[j]);
        for (int k = 0; k < 2; k++) kept[made][k] = (1 - s) * v[i][k] + s * v[j][k];
        made++;
    }
    memcpy(v, kept, made * sizeof *kept);
    return made;
}
#endif

/* The same over the overlap of both facets. */
static int overlap(const Contacts *c, const Meeting *o, const double *x, int f, int g, double *own, double *other)
{
    double v[CLIPPED][ACROSS];
    for (int k = 0; k < D; k++) place_under(c, o->side, x, f, node_of(c, o->side + 1, x, g, k), v[k]);
#if DIM == 2
    const double ends[] = {fmax(fmin(v[0][0], v[1][0]), 0.0), fmin(fmax(v[0][0], v[1][0]), 1.0)};
    return ends[1] > ends[0] && integrate(c, o, x, f, g, ends, own, other);
#else
    int count = D, seen = 0;
    for (int side = 0; side < D; side++) count = clip(v, count, side);

    for (int k = 1; k + 1 < count; k++) {
        const double corner[] = {v[0][0], v[0][1], v[k][0], v[k][1], v[k + 1][0], v[k + 1][1]};
        seen |= integrate(c, o, x, f, g, corner, own, other);
    }
    return seen;
#endif
}

/* The integrals of a pair of facets with the multipliers on the slave's. */
static void meet(const Contacts *c, Meeting *o, const double *x, int f, int p)
{
    const int a = o->side[0].nodes, b = o->side[1].nodes, r = o->multipliers, psi = o->psi.count, g = o->other[p];
    double own[FUNCTIONS * FUNCTIONS], other[FUNCTIONS * FUNCTIONS], *block = o->block + (long)p * r * (a + b);
    o->used[p] = 0;
    if (!(-dot(o->side[0].normal + D * f, o->side[1].normal + D * g, D) > FACING_EACH_OTHER)) return;
    memset(own, 0, psi * a * sizeof(double));
    memset(other, 0, psi * b * sizeof(double));
    if (!overlap(c, o, x, f, g, own, other)) return;

    o->used[p] = 1;
    memset(block, 0, r * (a + b) * sizeof(double));
    for (int i = 0; i < r; i++)
        for (int k = 0; k < psi; k++) {
            const double share = o->coefficient[(long)(r * f + i) * psi + k];
            add(block + a * i, share, own + a * k, a);
            add(block + r * a + b * i, share, other + b * k, b);
        }
}

/* Row j of the sums over the points of a side, behind those before it; its sum. */
static double sum_row(Meeting *o, int side, int j)
{
    const Facets *k = o->side + side;
    const int r = o->multipliers, n = k->nodes, behind = side * r * o->side[0].nodes, step = r * (o->side[0].nodes + o->side[1].nodes);
    Means *m = o->means + side;
    int count = 0, *last = m->first + j;
    double total = 0.0;

    for (int e = o->held[j]; e < o->held[j + 1]; e++) {
        const int f = o->holder[e] / r, i = o->holder[e] % r;
        for (int p = o->begin[f]; p < o->begin[f + 1]; p++)
            for (int l = 0; o->used[p] && l < n; l++) {
                const int node = k->node[n * (side ? o->other[p] : f) + l];
                if (o->mark[node] != j) o->mark[node] = j, o->sum[node] = 0.0, o->touched[count++] = node;
                o->sum[node] += o->block[(long)p * step + behind + n * i + l];
            }
    }

    last[1] = *last;
    for (int e = 0; e < count; e++) {
        const double weight = o->sum[o->touched[e]];
        if (weight == 0.0) continue;
        m->node[last[1]] = o->touched[e], m->weight[last[1]++] = weight;
        total += weight;
    }
    for (int e = 0; e < count; e++) o->mark[o->touched[e]] = -1;
    return total;
}

/* (1) and (2) of mechanics/contact/mortar.py: means of both sides, over what the multipliers cover. */
static void take_means(Meeting *o, int candidates)
{
    for (int j = 0; j < candidates; j++) {
        const double weight = sum_row(o, 1, j);
        sum_row(o, 0, j);
        for (int side = 0; side < 2; side++) {
            Means *m = o->means + side;
            if (!(weight > COVERED * o->weight[j])) m->first[j + 1] = m->first[j];
            for (int e = m->first[j]; e < m->first[j + 1]; e++) m->weight[e] /= weight;
        }
    }
}

/* The points that candidate i acts on with one of its sides, a mean of those of a pair; NULL for those of no surface. */
typedef struct {
    const Pair *points;
    int count;
    const int *node;
    const double *weight;
} Mean;

static Mean mean_of(const Contacts *c, int i, int side)
{
    const int law = c->of[i], of = c->surface[2 * law + side];
    if (of < 0) return (Mean){.count = 0};
    const Means *k = c->means + 2 * law + side;
    const int *first = k->first + i - c->pair[law].first;
    return (Mean){c->pair + of, first[1] - *first, k->node + *first, k->weight + *first};
}

/* Where it is, and the sum of its weights. */
static double mean_place(const Mean *k, const double *x, double *mean)
{
    double sum = 0.0;
    memset(mean, 0, D * sizeof(double));
    for (int e = 0; e < k->count; e++) {
        add(mean, k->weight[e], x + D * (k->points->first + k->node[e]), D);
        sum += k->weight[e];
    }
    return sum;
}

/* Gaps of candidates between surfaces whose points stand like this. */
static void touch_facets(const Contacts *c, const Meeting *o, Touch *out)
{
    const Pair *k = c->pair + o->pair;
    for (int j = 0; j < k->count; j++) {
        const int i = k->first + j;
        const Mean own = mean_of(c, i, 0), others = mean_of(c, i, 1);
        double *between = out->relative + D * i, other[D];

        mean_place(&own, out->x, between);
        mean_place(&others, out->x, other);
        add(between, -1.0, other, D);
        memcpy(out->normal + D * i, o->normal + D * j, D * sizeof(double));
        memcpy(out->x + D * i, out->x + D * (own.points->first + o->at[j]), D * sizeof(double));
        out->gap[i] = others.count ? dot(out->normal + D * i, between, D) - o->offset[j] : INFINITY;
    }
}

/* The candidates of a pair at a configuration. 1 where Python failed. */
static int touch_pair(const Contacts *c, Pair *o, const double *q, double t, Touch *out)
{
    const Meeting *k = o->meeting;
    if (!k) return touch_points(c, o, q, t, out);
    for (int side = 0; side < 2; side++) touch_points(c, c->pair + k->side[side].pair, q, t, out);
    touch_facets(c, k, out);
    return 0;
}

/* The distance of the boxes around the points of two pairs. */
static double apart(const Pair *a, const Pair *b, const double *x)
{
    const Pair *side[] = {a, b};
    double gap[D];
    for (int k = 0; k < D; k++) {
        double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
        for (int j = 0; j < 2; j++)
            for (int i = side[j]->first; i < side[j]->first + side[j]->count; i++) {
                low[j] = fmin(low[j], x[D * i + k]);
                high[j] = fmax(high[j], x[D * i + k]);
            }

        gap[k] = fmax(0.0, fmax(low[0] - high[1], low[1] - high[0]));
    }
    return length_of(gap);
}

/* The largest way of the points of a side since the list was made, beside a common one. */
static double moved_since(const Contacts *c, const Facets *k, const double *x, const double *common)
{
    const Pair *points = c->pair + k->pair;
    double most = 0.0;
    for (int i = 0; i < points->count; i++) {
        double way[D];
        for (int j = 0; j < D; j++) way[j] = x[D * (points->first + i) + j] - k->stood[D * i + j] - common[j];
        most = fmax(most, length_of(way));
    }
    return most;
}

/* Whether all facets that see each other are listed: their middles move as far as their nodes, their radii change by twice that. */
static int is_listed(const Contacts *c, const Meeting *o, const double *x)
{
    const Pair *points = c->pair + o->side[0].pair;
    double common[D] = {0.0}, wider = 0.0;
    if (!o->listed) return 0;
    for (int i = 0; i < points->count; i++)
        for (int j = 0; j < D; j++) common[j] += (x[D * (points->first + i) + j] - o->side[0].stood[D * i + j]) / points->count;
    for (int f = 0; f < o->side[0].facets; f++) wider = fmax(wider, o->sight[f] - o->saw[f]);
    return 3.0 * (moved_since(c, o->side, x, common) + moved_since(c, o->side + 1, x, common)) + wider <= o->skin;
}

/* Mean outward normals of the slave's nodes, from the master to it. */
static void turn_normals(const Meeting *o, int points, int candidates)
{
    const Facets *k = o->side;
    double *sum = o->sum;
    memset(sum, 0, D * points * sizeof(double));
    for (int f = 0; f < k->facets; f++)
        for (int n = 0; n < k->nodes; n++) add(sum + D * k->node[k->nodes * f + n], k->size[f], k->normal + D * f, D);
    for (int j = 0; j < candidates; j++) {
        const double *n = sum + D * o->at[j], size = length_of(n);
        for (int i = 0; i < D; i++) o->normal[D * j + i] = -n[i] / size;
    }
}

/* Pair both surfaces anew where their points stand like this; ``reach``: what nodes may move by, m. */
static int pair_facets(Contacts *c, Meeting *o, int number, double reach, Touch *at)
{
    const Pair *k = c->pair + o->pair, *a = c->pair + o->side[0].pair, *b = c->pair + o->side[1].pair;
    double far = 0.0;
    for (int side = 0; side < 2; side++) {
        lay_facets(c, o->side + side, at->x);
        memset(o->means[side].first, 0, (k->count + 1) * sizeof(int));
    }

    for (int f = 0; f < o->side[0].facets; f++) {
        const double size = D == 3 ? sqrt(o->side[0].size[f]) : o->side[0].size[f];
        o->sight[f] = isnan(o->search) ? fmax(reach, 0.5 * size) : o->search;
        far = fmax(far, o->sight[f]);
    }
    turn_normals(o, a->count, k->count);
    memset(o->offset, 0, k->count * sizeof(double));

    if (apart(a, b, at->x) <= far) {
        if (!is_listed(c, o, at->x)) {
            const Pair *points[] = {a, b};
            for (int side = 0; side < 2; side++)
                memcpy(o->side[side].stood, at->x + D * points[side]->first, D * points[side]->count * sizeof(double));
            memcpy(o->saw, o->sight, o->side[0].facets * sizeof(double));
            o->listed = 0;
            if (c->python(FACETS, number, 0.0)) return FAILED;
            o->listed = 1;
        }

        for (int f = 0; f < o->side[0].facets; f++)
            for (int p = o->begin[f]; p < o->begin[f + 1]; p++) meet(c, o, at->x, f, p);
        take_means(o, k->count);
    }

    touch_facets(c, o, at);
    return DONE;
}

/* Pair surfaces anew where their points stand like this; ``reach``: what two nodes may come nearer by, m. 1 where Python failed. */
static int pair_surfaces(Contacts *c, double reach, Touch *at)
{
    for (int k = 0; k < c->meetings; k++)
        if (pair_facets(c, c->meeting + k, k, reach, at)) return 1;
    return 0;
}

/* The same as they lie at a configuration near a time, for a step that begins where points stand like this: overlaps there stay. */
static int pair_beside(Contacts *c, const double *q, double t, double reach, Touch *at)
{
    for (const Meeting *o = c->meeting; o < c->meeting + c->meetings; o++)
        for (int side = 0; side < 2; side++) touch_points(c, c->pair + o->side[side].pair, q, t, &c->aside);
    if (pair_surfaces(c, reach, &c->aside)) return 1;

    for (const Meeting *o = c->meeting; o < c->meeting + c->meetings; o++) {
        const Pair *k = c->pair + o->pair;
        touch_facets(c, o, at);
        for (int j = 0; j < k->count; j++) {
            double *gap = at->gap + k->first + j;
            if (!(*gap < 0.0)) continue;
            o->offset[j] = *gap, *gap = 0.0;
        }
    }
    return 0;
}
