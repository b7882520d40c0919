/* Rows of contacts of fields, and how they answer to forces. A row acts on means of nodes of one field or two; before an obstacle that is one
   node, and the obstacle is at rest, moves as prescribed, or is carried by a body. */

enum { SUPERPOSED = 96 };                /* columns that are sooner added than a solution is found, of thousands of unknowns in the plane */
enum { WIDE = 2 * (D + TWIST) }; /* numbers of a row: directions at the nodes of both sides, on both frames */

/* The nodes that candidate i acts on with one of its sides: entries of a mean over the points of a pair. */
typedef struct {
    const Pair *points;
    const Body *body;
    Nodes *nodes;
    int count;
    const int *node, *number;          /* among the points; of these, in their trace */
    const double *weight;
} Side;

static Side side_of(const ElasticContact *o, int i, int side)
{
    const Contacts *c = o->contacts;
    const Mean k = mean_of(c, i, side);
    if (!k.points) return (Side){.count = 0};
    return (Side){k.points, c->system->body + c->on[2 * k.points->first], o->nodes + o->nodes_of[k.points - c->pair], k.count, k.node,
                  o->node + k.points->first, k.weight};
}

/* Where node e of a side begins in arrays like v. */
static long node_at(const Side *k, int e) { return k->points->node[k->node[e]] - k->body->at_q + k->body->at_v; }

/* Its number in its trace. */
static int number_of(const Side *k, int e) { return k->number[k->node[e]]; }

/* What one side of candidate i gives its rows, which hold zeros, along the directions e: on the frame of an obstacle; or on nodes, in the
   axes of their body, and on its frame. */
static void rows_of_side(const ElasticContact *o, int i, int side, const double *q, const Touch *at, const double *e, double *row)
{
    const Contacts *c = o->contacts;
    const double sign = side ? -1.0 : 1.0, *pose = q + POSE * c->on[2 * i + side];
    const Mean k = mean_of(c, i, side);
    double *local = row + D * side, *twist = row + 2 * D + TWIST * side, mean[D], R[D * D];
    if (!k.points) {
        for (int a = 0; a < c->components; a++) frame_row(pose, at->x + D * i, e + D * a, sign, twist + WIDE * a);
        return;
    }

    const double weight = mean_place(&k, at->x, mean);
    rotation(pose, R);
    for (int a = 0; a < c->components; a++) {
        transposed(R, e + D * a, local + WIDE * a);
        for (int j = 0; j < D; j++) local[WIDE * a + j] *= sign;
        if (!rests(c->system->body + c->on[2 * i + side])) mean_row(pose, weight, mean, e + D * a, sign, twist + WIDE * a);
    }
}

/* What one side of candidate i adds to the slopes of its slips: a body that has turned by d and whose nodes have moved by u, in its axes,
   moves them in a step of the increment xi by d x w + W x u more, with its turn W and the way w of the mean beside that of its frame. */
static void slopes_of_side(const ElasticContact *o, int i, int side, const Contacting *by, const Touch *at, const double *row, double *slope)
{
    const int b = o->contacts->on[2 * i + side];
    const double *pose = by->q + POSE * b, *turn = by->xi + TWIST * b + D;
    const Side k = side_of(o, i, side);
    double R[D * D], way[D], arm[D], w[D], turning[ROT], mean[D];
    if (!k.points || rests(k.body)) return;
    const Mean of = mean_of(o->contacts, i, side);
    const double weight = mean_place(&of, at->x, mean);

    rotation(pose, R);
    for (int j = 0; j < D; j++) way[j] = mean[j] - weight * pose[j];
    transposed(R, way, arm);
    spin(turn, arm, w);
    for (int n = 0; n < k.count; n++) add(w, k.weight[n], by->xi + node_at(&k, n), D);

    for (int a = 1; a < o->contacts->components; a++) {
        const double *e = row + WIDE * a + D * side;
        spin(turn, e, way);
        add(slope + WIDE * a + D * side, -o->share, way, D);
        moment(w, e, turning);
        add(slope + WIDE * a + 2 * D + TWIST * side + D, o->share, turning, ROT);
    }
}

/* Rows of those near, at the configuration of an iterate where they touch like this, and how their openings change with it. */
static void elastic_rows(ElasticContact *o, const Contacting *by, const Touch *at)
{
    const int d = o->contacts->components;
    const double *q = by->q;
    for (int k = 0; k < o->count; k++) {
        const int i = o->near[k];
        double e[D * D], *row = o->rows + WIDE * d * k, *before = o->direction + D * d * k;
        memcpy(e, at->normal + D * i, D * sizeof(double));
        if (d > 1) across(e, e + D);
        o->turned |= o->increments && memcmp(before, e, D * sizeof(double));
        memcpy(before, e, D * d * sizeof(double));

        memset(row, 0, d * WIDE * sizeof(double));
        for (int side = 0; side < 2; side++)
            if (o->contacts->on[2 * i + side] >= 0) rows_of_side(o, i, side, q, at, e, row);

        double *slope = o->slopes + WIDE * d * k;
        memcpy(slope, row, d * WIDE * sizeof(double));
        for (int side = 0; side < 2; side++) slopes_of_side(o, i, side, by, at, row, slope);
    }
}

/* A row of candidate i times an array like v. */
static double row_times(const ElasticContact *o, int i, const double *row, const double *v)
{
    double sum = 0.0;
    for (int side = 0; side < 2; side++) {
        const int b = o->contacts->on[2 * i + side];
        const Side k = side_of(o, i, side);
        for (int e = 0; e < k.count; e++) sum += k.weight[e] * dot(row + D * side, v + node_at(&k, e), D);
        if (b >= 0) sum += dot(row + 2 * D + TWIST * side, v + TWIST * b, TWIST);
    }
    return sum;
}

/* b += factor L^T f, like v; NULL: the residuals evaluated last. */
static void add_pushes(System *s, const ElasticContact *o, double factor, const double *f, double *b)
{
    const Contacts *c = o->contacts;
    const double *row = o->rows;

    for (int r = 0; r < c->components * o->count; r++, row += WIDE)
        for (int side = 0; side < 2; side++) {
            const int i = o->near[r / c->components], on = c->on[2 * i + side];
            const Side k = side_of(o, i, side);
            const double push = factor * f[r], *twist = row + 2 * D + TWIST * side;
            double *nodes = b || !k.count ? b : k.body->field->force - k.body->at_v;

            for (int e = 0; e < k.count; e++) add(nodes + node_at(&k, e), push * k.weight[e], row + D * side, D);
            if (on < 0) continue;
            if (b) {
                add(b + TWIST * on, push, twist, TWIST);
                continue;
            }
            double turning[ROT];
            to_world(s->frames + FRAME * on + TURN, twist + D, turning);
            add(s->residual + s->body[on].at_u, push, twist, D);
            add(s->residual + s->body[on].at_u + D, push, turning, ROT);
        }
}

/* How fields answer to forces b, like v, on the nodes touched, into their z, by columns that are held; whether they are, of SUPERPOSED numbers. */
static int take_held(System *s, const ElasticContact *o, const double *b)
{
    const double *held[SUPERPOSED];
    double force[SUPERPOSED];
    const Body *on[SUPERPOSED];
    int count = 0;
    for (const Nodes *k = o->nodes; k < o->nodes + o->traces; k++) {
        const Body *body = s->body + k->body;
        for (int t = k->begin; t < k->end; t++) {
            const double *at = b + body->at_v + k->numbers[o->touched[t]];
            double f[D];
            memcpy(f, at, sizeof f);
            if (body->field->turns) transposed(body->field->T, at, f);
            for (int j = 0; j < D; j++) {
                if (f[j] == 0.0) continue;
                if (o->applied || !k->Z || count == SUPERPOSED) return 0;
                force[count] = f[j], on[count] = body;
                held[count++] = k->Z + body->field->n * (D * o->touched[t] + j);
            }
        }
    }

    for (int k = 0; k < s->bodies; k++)
        if (s->body[k].field) memset(s->body[k].field->z, 0, s->body[k].field->wide * sizeof(double));
    for (int i = 0; i < count; i++) answer_node(on[i]->field, force[i], held[i]);
    return 1;
}

/* The answers x, like v, and y of multipliers to forces on the rows times a scale; NULL: not wanted. Residuals are lost. */
static int pushed(System *s, const ElasticContact *o, double scale, const double *f, double *x, double *y)
{
    double *b = o->room, *none = b + 3 * s->nv + s->nq;
    memset(b, 0, s->nv * sizeof(double));
    memset(none, 0, s->rows * sizeof(double));
    add_pushes(s, o, scale, f, b);
    s->answered = take_held(s, o, b);
    const int verdict = driver_solve(s, 1, o->factored, b, none, x, y ? y : none + s->rows);
    s->answered = 0;
    return verdict;
}

/* ---- how contacts answer: (1) and (2) of linear/complementarity/delassus.py ---- */

/* Rows at nodes in the axes of the factors of their fields, into ``axes``; whether they are what they were. */
static int turn_rows(const ElasticContact *o, const double *rows, double *axes)
{
    const Contacts *c = o->contacts;
    const int d = c->components;
    int same = 1;
    for (int r = 0; r < 2 * d * o->count; r++) {
        const Side k = side_of(o, o->near[r / 2 / d], r % 2);
        double y[D];

        memcpy(y, rows + WIDE * (r / 2) + D * (r % 2), sizeof y);
        if (k.count && k.body->field->turns) transposed(k.body->field->T, rows + WIDE * (r / 2) + D * (r % 2), y);
        same = same && !memcmp(y, axes + D * r, sizeof y);
        memcpy(axes + D * r, y, sizeof y);
    }
    return same;
}

/* Rows, whose parts at nodes are in ``axes``, as the core sees them. */
static void on_core(const System *s, const ElasticContact *o, const double *rows, const double *axes)
{
    const Contacts *c = o->contacts;
    const int d = c->components, n = d * o->count;
    memset(o->push, 0, (long)n * s->core * sizeof(double));
    memset(o->seen, 0, (long)n * o->columns * sizeof(double));

    for (int r = 0; r < 2 * n; r++) {
        const int i = o->near[r / 2 / d], side = r % 2, on = c->on[2 * i + side];
        const Side k = side_of(o, i, side);
        if (on >= 0) add(o->push + (long)s->core * (r / 2) + TWIST * on, 1.0, rows + WIDE * (r / 2) + 2 * D + TWIST * side, TWIST);
        for (int e = 0; e < k.count && k.nodes->columns; e++)
            for (int j = 0; j < D; j++)
                add(o->seen + (long)o->columns * (r / 2) + k.nodes->at, k.weight[e] * axes[D * r + j],
                    k.nodes->Y + (long)k.nodes->columns * (D * number_of(&k, e) + j), k.nodes->columns);
    }
}

/* What the core does under forces on all rows, and then how openings see it. */
static int ask_core(System *s, ElasticContact *o)
{
    const int n = o->contacts->components * o->count;
    on_core(s, o, o->rows, o->axes);
    memset(o->room, 0, s->nv * sizeof(double));
    const int verdict = driver_columns(s, n, o->columns, o->factored, o->room, o->push, o->seen, o->answer, o->acting);
    on_core(s, o, o->slopes, o->sensed);
    return verdict;
}

/* How the nodes touched answer to forces on the rows of the i-th candidate near, row by row; C is symmetric. */
static void ask_fields(const ElasticContact *o, int i)
{
    const int d = o->contacts->components, touched = o->nodes[o->traces - 1].end;
    memset(o->reply, 0, (long)d * D * touched * sizeof(double));

    for (int side = 0; side < 2; side++) {
        const Side k = side_of(o, o->near[i], side);
        for (int e = 0; e < k.count; e++)
            for (int b = 0; b < d; b++)
                for (int j = 0; j < D; j++) {
                    const double *C = k.nodes->C + (long)D * k.nodes->size * (D * number_of(&k, e) + j);
                    const double f = k.weight[e] * o->axes[D * (2 * (d * i + b) + side) + j];
                    for (int t = k.nodes->begin; t < k.nodes->end; t++) add(o->reply + D * (b * touched + t), f, C + D * o->touched[t], D);
                }
    }
}

/* How the openings of the i-th change then, (components x components). */
static void answers_on(const ElasticContact *o, int i, double *w)
{
    const int d = o->contacts->components, touched = o->nodes[o->traces - 1].end;
    memset(w, 0, d * d * sizeof(double));
    for (int side = 0; side < 2; side++) {
        const Side k = side_of(o, o->near[i], side);
        for (int e = 0; e < k.count; e++) {
            const double *reply = o->reply + D * o->place[k.nodes->first + number_of(&k, e)];
            for (int a = 0; a < d; a++)
                for (int b = 0; b < d; b++)
                    w[d * a + b] += k.weight[e] * dot(o->sensed + D * (2 * (d * i + a) + side), reply + D * b * touched, D);
        }
    }
}

/* The block of W for candidates i and j of those near. */
static double *block_of(const Problem *P, int d, int i, int j)
{
    return i == j ? P->own + i * d * d : P->W + ((long)i * (P->m - 1) + j - (j > i)) * d * d;
}

static void take_lumped(const ElasticContact *o, double scale);

/* How the openings of the i-th change under forces on the rows of the j-th, of which the nodes touched have answered, into W. */
static void couple_rows(const System *s, const ElasticContact *o, double scale, int i, int j)
{
    const int d = o->contacts->components;
    const Problem *P = &o->problem->all;
    double w[D * D], *block = block_of(P, d, i, j);
    answers_on(o, i, w);

    for (int a = 0; a < d; a++)
        for (int b = 0; b < d; b++) {
            const long r = d * i + a, l = d * j + b;
            double part = w[d * a + b];
            if (o->coupled) { /* by the core */
                part -= dot(o->seen + o->columns * r, o->acting + o->columns * l, o->columns);
                part += dot(o->push + s->core * r, o->answer + s->core * l, s->core);
            }
            block[d * a + b] = scale * part;
        }
}

/* W of bodies whose nodes are coupled. */
static int take_coupled(System *s, ElasticContact *o, double scale)
{
    const int m = o->count;
    int verdict;
    if (o->coupled && (verdict = ask_core(s, o))) return verdict;

    for (int j = 0; j < m; j++) {
        ask_fields(o, j);
        for (int i = 0; i < m; i++) couple_rows(s, o, scale, i, j);
    }
    return DONE;
}

/* W, for forces that a solution weights by ``scale``. */
static int take_compliance(System *s, ElasticContact *o, double scale)
{
    const Problem *P = &o->problem->all;
    const int turned = !turn_rows(o, o->rows, o->axes) | !turn_rows(o, o->slopes, o->sensed);
    int verdict, same = !turned && (P->lumped || !o->coupled) && o->known_scale == scale;
    o->matrix = 1;
    if (same) return DONE;

    o->known_scale = 0.0; /* where that fails */
    if (P->lumped) take_lumped(o, scale);
    else if ((verdict = take_coupled(s, o, scale))) return verdict;
    o->known_scale = scale;
    return DONE;
}
