/* Steps of BDF, schemes/multistep/corrector.py and bdf.py: constant ones, and those whose size and order error control chooses. */

enum { ORDERS = 5, STABLE = 2 }; /* the highest order, and the highest that damps all vibrations */

static const double SUDDEN = 0.4; /* share of the longest step that foretells it, below which a step is behind a bend of forces, not of smooth motion */

/* Which orders and sizes follow, see bdf.py. */
typedef struct Orders {
    int highest, first[ORDERS + 2];    /* where the spans of each order begin */
    const double *spans;               /* from, to, of sizes (s) with which an order amplifies vibrations */
    long uses, most;                   /* of these, and after how many Python looks for them anew */
    double taken;                      /* the orders of all steps that passed, summed */
    double safety, least, shrink, grow; /* of a growth; least error */
    double keep, calm, lower, higher;  /* growths between which nothing changes; what an order less, or more, has to have more */
    double nearest, farthest;          /* frequencies over that of the factors with which these serve on */
    double anchor, places_of_decade;   /* where factors are those of a grid: a frequency of it, 0: of any; how many of a decade */
} Orders;

/* What it keeps with a state beside its work: the order, for how many steps it was held with one size, the size of the next step; its own
   multipliers; how many values before it are known, at most as many as the largest order, and these, the newest first: t, q (nq),
   v (nv), multipliers. */
typedef struct {
    double *order, *held, *next, *mult, *count, *values;
} Memories;

static Memories memories_at(const Stages *g, double *own)
{
    double *x = own + WORK, *mult = x + 3, *count = mult + g->size - g->n;
    Memories o = {x, x + 1, x + 2, mult, count, count + 1};
    return o;
}

/* Numbers of a value. */
static long length_of_value(const System *s, const Stages *g) { return 1 + s->nq + g->size; }

/* So many values, the newest first, in coordinates about that: xi, count x n; their v and multipliers where they stand. */
typedef struct {
    int count;
    double t[ORDERS + 1], *xi;
    const double *v[ORDERS + 1], *mult[ORDERS + 1];
} Values;

/* All that a state knows, with xi at the beginning of ``mixed``; ``rest``: what is left of that. */
static Values local_values(const System *s, const Implicit *o, const Block *now, const Memories *m, double **rest)
{
    const Stages *g = o->stages;
    const long size = length_of_value(s, g);
    const int n = g->n;
    Values e = {(int)fmin(o->order, *m->count) + 1, {*now->t}, o->mixed, {now->v}, {m->mult}};
    double *guess = *rest = e.xi + (long)e.count * n;
    memset(guess, 0, n * sizeof(double));
    memset(e.xi, 0, n * sizeof(double));

    for (int j = 1; j < e.count; j++) {
        const double *value = m->values + (j - 1) * size, *q = value + 1;
        e.t[j] = value[0];
        e.v[j] = q + s->nq;
        e.mult[j] = e.v[j] + n;
        /* the way back by the trapezoid rule tells how many turns lie between */
        for (int i = 0; i < n; i++) guess[i] += 0.5 * (e.t[j] - e.t[j - 1]) * (e.v[j][i] + e.v[j - 1][i]);
        driver_difference(s, 1, now->q, 0, q, 0, guess, 0, e.xi + (long)j * n);
    }
    return e;
}

/* Lagrange polynomials of the newest values at t. */
static void lagrange(int count, Values *e, double t, double *w)
{
    Block at[ORDERS + 1];
    for (int i = 0; i < count; i++) at[i].t = e->t + i;
    predictor(at, count - 1, t, w);
}

/* What the polynomial through the newest values foretells of xi and v, times ``sign``, added to these. */
static void add_foretold(const Stages *g, int count, Values *e, double t, double sign, double *xi, double *v)
{
    double w[ORDERS + 1];
    lagrange(count, e, t, w);
    for (int j = 0; j < count; j++) {
        add(xi, sign * w[j], e->xi + (long)j * g->n, g->n);
        add(v, sign * w[j], e->v[j], g->n);
    }
}

/* The new values of order k as the past foretells them, into the point; returns c_0 of (1) in corrector.py. */
static double foretell_point(Stages *g, int k, Values *e, double t)
{
    const int n = g->n, width = g->size - n, few = k < 3 ? k : 3;
    double w[ORDERS + 1], c[ORDERS + 1], c0 = 0.0;
    lagrange(few, e, t, w);
    memset(g->mult, 0, width * sizeof(double));
    for (int j = 0; j < few; j++) add(g->mult, w[j], e->mult[j], width);
    memset(g->xi, 0, n * sizeof(double));
    memset(g->v, 0, n * sizeof(double));
    add_foretold(g, k < e->count ? k + 1 : e->count, e, t, 1.0, g->xi, g->v);

    lagrange(k, e, t, c);
    for (int j = 0; j < k; j++) {
        c0 -= c[j] /= e->t[j] - t;
        g->past[j] = c[j];
        g->ends[j] = e->t[j];
    }
    g->behind = k;
    for (int i = 0; i < n; i++) {
        g->rate[i] = c0 * g->xi[i];
        g->vd[i] = c0 * g->v[i];
    }

    for (int j = 0; j < k; j++) {
        add(g->rate, c[j], e->xi + (long)j * n, n);
        add(g->vd, c[j], e->v[j], n);
    }
    return c0;
}

/* The newest values of the next step. */
static void remember_value(const System *s, const Implicit *o, const Block *now, const Memories *m, const Memories *made)
{
    const Stages *g = o->stages;
    const long size = length_of_value(s, g);
    const int kept = (int)fmin(o->order - 1, *m->count);
    double *to = made->values;
    to[0] = *now->t;
    memcpy(to + 1, now->q, s->nq * sizeof(double));
    memcpy(to + 1 + s->nq, now->v, g->n * sizeof(double));
    memcpy(to + 1 + s->nq + g->n, m->mult, (g->size - g->n) * sizeof(double));
    memcpy(to + size, m->values, (size_t)(kept * size) * sizeof(double));
    *made->count = kept + 1;
}

/* The frequency whose factors serve one: of constant steps its own, else that of the grid, or of those at hand, which is near. */
static double serving(const Implicit *o, double frequency)
{
    if (!o->own) return frequency;
    const Orders *r = o->own->orders;
    const double places = r->places_of_decade, ratio = o->factored > 0.0 ? frequency / o->factored : 0.0;
    if (r->anchor > 0.0) return r->anchor * pow(10.0, round(places * log10(frequency / r->anchor)) / places);
    return ratio >= r->nearest && ratio <= r->farthest ? o->factored : frequency;
}

/* Factors for the frequency c_0 of a step; those of another one serve by a correction. */
static int point_factors(System *s, Implicit *o, double c0, double *work)
{
    Stages *g = o->stages;
    g->s[0] = serving(o, c0);
    g->relax = 2.0 / (1.0 + c0 / g->s[0]);
    return take_factors(s, o, g->s[0], work);
}

/* The point of a step of order k, by Newton's iteration. */
static int point_of_step(System *s, double *p, Implicit *o, const Block *now, int k, Values *e, double *work, double *q)
{
    Stages *g = o->stages;
    const double t = *now->t + p[H];
    int verdict;
    g->t[0] = t;
    g->couple[0] = foretell_point(g, k, e, t);
    if (work[KNOWN] == 0.0) {
        if (s->remembered && (verdict = remember_points(s, g, 0))) return verdict; /* a tangent knows how these follow */
        configuration(s, now->q, g->xi, q);
        if ((verdict = take_tangent(s, o, t, q, g->v, g->vd, g->mult, p[LENGTH], work))) return verdict;
    }

    if ((verdict = point_factors(s, o, g->couple[0], work))) return verdict;
    if ((verdict = iterate_step(s, o, p, now, 1.0, work))) return verdict;
    return s->remembered ? remember_points(s, g, 1) : DONE;
}

/* The state at the point, and what is kept of it. ``room``: 2 nv + rows. */
static int end_bdf(System *s, Implicit *o, const double *p, const Block *now, Block out, double *room)
{
    const Stages *g = o->stages;
    const Memories m = memories_at(g, now->own), made = memories_at(g, out.own);
    int verdict = end_motion(s, o, p, now, out);
    if (verdict || (verdict = least_of_levels(s, g, 0, out.q, room))) return verdict;
    memcpy(made.mult, g->mult, (g->size - g->n) * sizeof(double));
    remember_value(s, o, now, &m, &made);
    return end_implicit(s, o, p, g->mult, out);
}

/* ---- sizes and orders ---- */

/* The error of the point if it had been taken with order k, over the tolerance, as _error() of bdf.py. ``room``: 2 nv and that of step_error(). */
static double point_error(System *s, const Implicit *o, int k, Values *e, double *room)
{
    const Stages *g = o->stages;
    const double t = g->t[0];
    const int n = g->n;
    if (e->count < k + 1) return INFINITY;
    memcpy(room, g->xi, n * sizeof(double));
    memcpy(room + n, g->v, n * sizeof(double));
    add_foretold(g, k + 1, e, t, -1.0, room, room + n);
    const double *parts[2] = {room, room + n};
    double share = (t - e->t[0]) / (t - e->t[k]), longest = 0.0, w[ENDINGS];

    for (int j = 0; j < k; j++) longest = fmax(longest, e->t[j] - e->t[j + 1]);
    if (t - e->t[0] < SUDDEN * longest) share = fmax(share, 1.0 / (k + 1));
    double error = share * step_error(s, o, parts, 2, room + 2 * n);
    if (!s->remembered) return error;
    lagrange(k + 1, e, t, w);
    for (int j = 0; j <= k; j++) w[j] *= -share;
    memcpy(s->remembered->end, e->t, (k + 1) * sizeof(double));
    return remembered_error(s, g, &o->own->rtol, &share, w, k + 1, 0.0, 0.0, &error) ? INFINITY : error;
}

/* Of a step with this error of order k. */
static double grown(const Orders *r, double error, int k) { return growth_factor(fmax(error, r->least), k + 1, r->safety); }

static double within(const Orders *r, double growth) { return fmin(fmax(growth, r->shrink), r->grow); }

/* Whether steps of h and order k amplify no vibration. */
static int permits(Orders *r, int k, double h)
{
    if (k <= STABLE) return 1;
    r->uses++;
    for (int i = r->first[k]; i < r->first[k + 1]; i++)
        if (r->spans[2 * i] < h && h < r->spans[2 * i + 1]) return 0;
    return 1;
}

/* The order with the longest stable step, one more or less than k at most, and its ``growth``: at first that of k. */
static int best_order(System *s, const Implicit *o, int k, double h, Values *e, double *growth, double *room)
{
    Orders *r = o->own->orders;
    int order = k;
    if (k > 1) {
        double less = grown(r, point_error(s, o, k - 1, e, room), k - 1);
        if (less > r->lower * *growth) order = k - 1, *growth = less;
    }

    if (k < r->highest && e->count >= k + 2) {
        double more = grown(r, point_error(s, o, k + 1, e, room), k + 1);
        if (more > r->higher * *growth) order = k + 1, *growth = more;
    }
    while (!permits(r, order, h * within(r, *growth))) {
        order--;
        *growth = grown(r, point_error(s, o, order, e, room), order);
    }
    return order;
}

/* The size after an accepted step of h; the next order, and for how many steps it was held: _choose() of bdf.py. */
static double choose(System *s, const Implicit *o, double h, const Passing *found, Values *e, const Memories *made, double *room)
{
    Orders *r = o->own->orders;
    const int k = (int)*made->order;
    double growth = grown(r, found->error, k);
    r->taken += k;
    *made->held += 1.0;
    if (found->refused) {
        h *= fmin(growth, 1.0);
        *made->held = 0.0;
        if (!permits(r, k, h)) *made->order = STABLE;
        return h;
    }
    if (*made->held <= k && growth > r->keep) return h;

    const int order = best_order(s, o, k, h, e, &growth, room);
    if (order == k && r->keep <= growth && growth <= r->calm) return h;
    *made->order = order;
    *made->held = 0.0;
    return h * within(r, growth);
}

/* The point of a step of a size and order that pass. */
static int passing_point(System *s, double *p, Implicit *o, const Block *now, Block out, Values *e, Passing *found, double *room)
{
    OwnSteps *c = o->own;
    Stages *g = o->stages;
    const Memories made = memories_at(g, out.own);
    const double most = farthest_turn(s->bodies, c->turn, *made.order + 1.0, now);
    double *work = out.own;
    int verdict;

    for (;;) {
        const int k = (int)*made.order;
        if ((verdict = own_size(c, now, found->proposed, most, p + H))) return verdict;
        g->span = p[H];
        const Norm norm = norm_of(g);
        take_sizes(s, c, &norm, now);
        do {
            verdict = point_of_step(s, p, o, now, k, e, work, room);
            if (!verdict && turn_too_far(s, c, g->points, g->xi)) verdict = NEWTON;
        } while (tried_anew(o, verdict, work));

        if (verdict) return verdict;
        found->error = point_error(s, o, k, e, room);
        if (lets_pass(c, found)) return DONE;

        /* the tangent goes on serving; after several errors a lower order, whose past is shorter */
        work[KNOWN] = 1.0;
        if (!refused_size(c, now, p[H], k + 1.0, found)) return NEWTON;
        *made.held = 0.0;
        if (found->refused > 5) *made.order = 1.0;
        else if (found->refused > 2) *made.order = fmax(1.0, k - 1.0);
    }
}

/* One step of the size and order that error control chooses, likewise. */
static int own_bdf_step(System *s, double *p, Implicit *o, const Block *now, Block out, Values *e, double *room)
{
    OwnSteps *c = o->own;
    const Memories m = memories_at(o->stages, now->own), made = memories_at(o->stages, out.own);
    const double left = left_for(c, now);
    Passing found = {.proposed = proposal(c, *m.next)};
    int verdict;
    if (!(left > 0.0) || *now->t > c->last) return SIZE;

    if (fmin(*m.order + 1.0, c->orders->highest) > STABLE && c->orders->uses >= c->orders->most) return SIZE;
    *made.order = *m.order;
    *made.held = *m.held;
    const Norm norm = norm_of(o->stages);
    if ((verdict = take_bases(s, &norm, now->q, now->v))) return verdict;
    if ((verdict = passing_point(s, p, o, now, out, e, &found, room))) return verdict;

    /* a step cut short by the end, or by turns, tells nothing of the next one */
    const double h = p[H], next = choose(s, o, h, &found, e, &made, room);
    const int whole = h >= fmin(found.proposed, left) * (1.0 - 1e-9);
    *made.next = whole || next < h ? next : found.proposed;
    note_passing(c, &found);
    return end_bdf(s, o, p, now, out, room);
}

/* One step, as a Maker of march.c. */
int bdf_step(System *s, double *p, double *room, const Block *past, int known, Block out)
{
    Implicit *o = implicit_in(room);
    const Block *now = past;
    const Memories m = memories_at(o->stages, now->own), made = memories_at(o->stages, out.own);
    double *rest;
    Values values = local_values(s, o, now, &m, &rest);
    (void)known;
    int verdict = begin_implicit(s, o, now, out);
    if (verdict) return verdict;
    if (o->own) return own_bdf_step(s, p, o, now, out, &values, rest);

    memcpy(made.order, m.order, 3 * sizeof(double));
    do verdict = point_of_step(s, p, o, now, o->order, &values, out.own, rest);
    while (o->stages->fields && tried_anew(o, verdict, out.own));
    return verdict ? verdict : end_bdf(s, o, p, now, out, rest);
}
