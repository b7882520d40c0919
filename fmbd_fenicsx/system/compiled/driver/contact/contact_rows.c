/* Rows of contacts on the rates of their bodies, and rates and slips that come from obstacles in motion. */

/* D - 1 unit vectors across a normal. */
static void across(const double *n, double *e)
{
#if DIM == 2
    e[0] = -n[1];
    e[1] = n[0];
#else
    double pick[3] = {0.0, 0.0, 0.0};
    int least = 0;

    for (int i = 1; i < 3; i++)
        if (fabs(n[i]) < fabs(n[least])) least = i;
    pick[least] = 1.0;
    moment(n, pick, e);
    double size = length_of(e);
    for (int i = 0; i < 3; i++) e[i] /= size;
    moment(n, e, e + 3);
#endif
}

/* The row of a point's velocity along e on the twist of a frame, in its body axes. */
static void frame_row(const double *pose, const double *x, const double *e, double sign, double *row)
{
    double R[D * D], arm[D], turning[ROT];
    rotation(pose, R);
    for (int j = 0; j < D; j++) arm[j] = x[j] - pose[j], row[j] = sign * e[j];
    moment(arm, e, turning);
    to_body(R, turning, row + D);
    for (int j = 0; j < ROT; j++) row[D + j] *= sign;
}

/* The row of a stop on both bodies, at the frames that its gap was found at. */
static void stop_row(const Contacts *c, int i, const Pair *o, double *row)
{
    System *s = c->system;
    const Batch *k = o->batch;
    double y[2 * TWIST], factor = o->lever * o->side[i - o->first], *rates = s->big;
    twist_row(k, o->item, y);
    memset(row, 0, 2 * c->wide * sizeof(double));

    for (int side = 0; side < 2; side++, row += c->wide) {
        const double *map;
        int body = c->on[2 * i + side], width = side_map(s, k->pair[2 * o->item + side], &map);
        if (!width) continue;
        through(map, width, y + TWIST * side, rates);
        to_body(s->frames + FRAME * body + TURN, rates + D, row + D);
        memcpy(row, rates, D * sizeof(double));
        memcpy(row + TWIST, rates + TWIST, (width - TWIST) * sizeof(double));
        for (int j = 0; j < width; j++) row[j] *= factor;
    }
}

/* The row of a mean of points with this sum of weights along e, on the twist of a frame, in its body axes. */
static void mean_row(const double *pose, double weight, const double *mean, const double *e, double sign, double *row)
{
    double y[D];
    for (int j = 0; j < D; j++) y[j] = mean[j] + (1.0 - weight) * pose[j];
    frame_row(pose, y, e, sign, row);
    for (int j = 0; j < D; j++) row[j] *= weight;
}

/* What one side of contact i gives its rows, which hold zeros, along the directions e: on a frame, and on modes that move its nodes. */
static void rows_on_body(const Contacts *c, int i, int side, const double *q, const Touch *at, const double *e, double *row)
{
    const int b = c->on[2 * i + side], modes = c->system->body[b].modes;
    const double sign = side ? -1.0 : 1.0, *pose = q + POSE * b;
    const Mean k = mean_of(c, i, side);
    double mean[D], R[D * D], local[D];
    if (!k.points) {
        for (int a = 0; a < c->components; a++) frame_row(pose, at->x + D * i, e + D * a, sign, row + 2 * c->wide * a);
        return;
    }

    const double weight = mean_place(&k, at->x, mean);
    rotation(pose, R);
    for (int a = 0; a < c->components; a++, row += 2 * c->wide, e += D) {
        mean_row(pose, weight, mean, e, sign, row);
        transposed(R, e, local);
        for (int n = 0; n < k.count; n++)
            for (int j = 0; j < D; j++)
                add(row + TWIST, sign * k.weight[n] * local[j], k.points->modes + (long)modes * (D * k.node[n] + j), modes);
    }
}

/* Rows of contact i on both bodies: normal, then across where there is friction; those of a stop, which has none, are alike. */
static void contact_rows(const Contacts *c, int i, const double *q, const Touch *at, double *rows)
{
    const Pair *o = c->pair + c->of[i];
    double e[D * D];
    if (o->shape == LIMIT) {
        for (int a = 0; a < c->components; a++) stop_row(c, i, o, rows + 2 * c->wide * a);
        return;
    }

    memcpy(e, at->normal + D * i, D * sizeof(double));
    if (c->components > 1) across(e, e + D);
    memset(rows, 0, 2 * c->wide * c->components * sizeof(double));
    for (int side = 0; side < 2; side++)
        if (c->on[2 * i + side] >= 0) rows_on_body(c, i, side, q, at, e, rows + c->wide * side);
}

/* A row of contact i times an array like v. */
static double along(const Contacts *c, int i, const double *row, const double *v)
{
    double sum = 0.0;
    for (int side = 0; side < 2; side++, row += c->wide) {
        int b = c->on[2 * i + side];
        if (b < 0) continue;
        const Body *body = c->system->body + b;
        sum += dot(row, v + TWIST * b, TWIST);
        if (body->modes) sum += dot(row + TWIST, v + body->at_v, body->modes);
    }
    return sum;
}

/* Places of moving obstacles, summed up by weights: how far they come in a time, or would with their velocities at its start. */
typedef struct {
    int parts;
    double time[3], weight[3];
} Way;

static Way way_over(double t, double span) { return (Way){2, {t, t + span}, {-1.0, 1.0}}; }

static Way way_at_start(double t, double h) { return (Way){3, {t, t + 0.5 * h, t + h}, {-3.0, 4.0, -1.0}}; }

/* How far the origin of an obstacle moves, and how its axes turn. Points have their ways from these: by places of their own they would
   differ by roundoff, and ask contacts that depend on each other for what they cannot do. 1 where Python failed. */
static int obstacle_way(const Contacts *c, Pair *o, const double *q, Way way, double *shift, double *turn)
{
    double r[D], R[D * D];
    memset(shift, 0, D * sizeof(double));
    memset(turn, 0, D * D * sizeof(double));
    for (int part = 0; part < way.parts; part++) {
        if (obstacle(c, o, q, way.time[part], r, R)) return 1;
        add(shift, way.weight[part], r, D);
        add(turn, way.weight[part], R, D * D);
    }
    return 0;
}

/* What prescribed motion alone opens gaps by at a configuration, along a way over a time. */
static int gap_ways(Contacts *c, const double *q, double t, Way way, double over, double *rate)
{
    for (int k = 0; k < c->candidates; k++) rate[c->candidate[k]] = 0.0;
    for (int k = 0; c->moving && k < c->nears; k++) {
        Pair *o = c->pair + c->near[k];
        double shift[D], turn[D * D], moved[D];
        if (!o->moving) continue;
        if (obstacle_way(c, o, q, way, shift, turn) || touch_pair(c, o, q, t, &c->aside)) return 1;
        for (int i = o->first; i < o->first + o->count; i++) {
            times(turn, c->aside.relative + D * i, moved);
            add(moved, 1.0, shift, D);
            rate[i] = -dot(c->aside.normal + D * i, moved, D) / over;
        }
    }
    return 0;
}

/* Rates of all gaps that come from prescribed motion, by central differences over the span. */
static int gap_rates(Contacts *c, const double *q, double t, double span, double *rate)
{
    const double e = 1e-3 * span;
    return gap_ways(c, q, t, way_over(t - e, 2 * e), 2 * e, rate);
}

/* How far the obstacle of contact i moves along the directions across its normal; the contact is that of a time. */
static int drifts(const Contacts *c, int i, const double *q, double time, Way way, const Touch *at, double *drift)
{
    Pair *o = c->pair + c->of[i];
    double r[D], R[D * D], arm[D], y[D], e[D * D], shift[D], turn[D * D];
    memset(drift, 0, c->components * sizeof(double));
    if (!o->moving || c->components == 1) return 0;
    if (obstacle(c, o, q, time, r, R) || obstacle_way(c, o, q, way, shift, turn)) return 1;
    for (int j = 0; j < D; j++) arm[j] = at->x[D * i + j] - r[j];
    transposed(R, arm, y);
    times(turn, y, arm);
    add(arm, 1.0, shift, D);
    across(at->normal + D * i, e + D);
    for (int k = 1; k < c->components; k++) drift[k] = dot(e + D * k, arm, D);
    return 0;
}

/* Rates of the gaps of m closed contacts at the start of a flight of a length, into c->rebound, and slips, along the axes there, into
   c->before; of moving obstacles by their places at its start, middle and end, which are asked for anyway. 1 where Python failed. */
static int start_rates(Contacts *c, Block now, int m, double length)
{
    const Way way = way_at_start(*now.t, length);
    if (c->stops && touch(c, now.q, *now.t, &c->now)) return 1;
    for (int k = 0; k < m; k++) {
        contact_rows(c, c->closed[k], now.q, &c->now, c->rows);
        c->rebound[k] = along(c, c->closed[k], c->rows, now.v);
        if (c->components == 1) continue;
        if (drifts(c, c->closed[k], now.q, *now.t, way, &c->now, c->drift)) return 1;
        for (int a = 1; a < c->components; a++)
            c->before[c->components * k + a] = along(c, c->closed[k], c->rows + 2 * c->wide * a, now.v) - c->drift[a] / length;
    }

    if (gap_ways(c, now.q, *now.t, way, length, c->rate)) return 1;
    for (int k = 0; k < m; k++) c->rebound[k] += c->rate[c->closed[k]];
    return 0;
}

/* The slips of contact i at the start of a flight of a length, which start_rates() left in ``before``, along the axes of its middle into
   ``slip``: what they change by, in half of it, goes into its drift. */
static void turn_slips(
    const Contacts *c, int i, double length, const double *rows, Block now, const double *before, double *drift, double *slip)
{
    double e[D * D], to[D * D];
    if (c->components == 1 || c->pair[c->of[i]].shape == LIMIT) return;
    across(c->now.normal + D * i, e);
    across(c->end.normal + D * i, to);
    for (int a = 0; a < D - 1; a++) {
        double start = 0.0;
        for (int b = 0; b < D - 1; b++) start += before[b + 1] * dot(e + D * b, to + D * a, D);
        double rate = along(c, i, rows + 2 * c->wide * (a + 1), now.v) - drift[a + 1] / length;
        drift[a + 1] -= length * (rate - start);
        slip[a + 1] = start;
    }
}
