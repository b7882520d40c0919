/* Which contacts may touch soon. Only these are looked at: each body is inside spheres of its points and of the shapes that it carries,
   and as long as none of these has moved by half of what is between two of them, they do not touch.

   A list lasts some steps at the speed of the moment. Within a step it only grows, so that nothing of the step is lost. */

static const double DRIFTING = 1e-5; /* as in moreau.py */
enum { LASTS = 8, LEAVES = 4 }; /* steps that a list is made for; drifts of closed contacts that are near at any rate */

/* Place and rotation of the sphere m at a configuration. */
static void mover_at(const Mover *m, const double *q, double *x, double *R)
{
    const double *pose = q + POSE * m->body;
    rotation(pose, R);
    times(R, m->place, x);
    add(x, 1.0, pose, D);
}

/* How far a point within one of the spheres has moved since the list was made, at most. */
static double wandered(const Contacts *c, const double *q)
{
    double most = 0.0;
    const double *before = c->stood;
    for (const Mover *m = c->mover; m < c->mover + c->movers; m++, before += D + D * D) {
        double now[D + D * D];
        mover_at(m, q, now, now + D);
        for (int i = 0; i < D + D * D; i++) now[i] -= before[i];
        double way = length_of(now) + (m->extent > 0.0 ? m->extent * sqrt(dot(now + D, now + D, D * D)) : 0.0);
        if (most == most && !(way <= most)) most = way; /* nan stays */
    }
    return most;
}

/* The largest speed of a point within the spheres. */
static double fastest(const Contacts *c, const double *v)
{
    double most = 0.0;
    for (const Mover *m = c->mover; m < c->mover + c->movers; m++) {
        const double *twist = v + TWIST * m->body;
        most = fmax(most, length_of(twist) + sqrt(dot(twist + D, twist + D, ROT)) * (length_of(m->place) + m->extent));
    }
    return most;
}

static void list_pair(Contacts *c, int pair)
{
    if (c->listed[pair]) return;
    c->listed[pair] = 1;
    c->near[c->nears++] = pair;
}

/* Pairs that are always near, and those with an obstacle at rest that are near now; 1 where Python failed. */
static int list_single(Contacts *c, const double *q, double t)
{
    for (const int *k = c->single; k < c->single + c->singles; k++) {
        Pair *o = c->pair + *k;
        if (c->listed[*k]) continue;
        double least = -INFINITY;
        if (o->mover >= 0) {
            if (touch_pair(c, o, q, t, &c->aside)) return 1;
            least = INFINITY;
            for (int i = o->first; i < o->first + o->count; i++) least = fmin(least, c->aside.gap[i]);
        }

        if (!(least > c->skin)) list_pair(c, *k);
    }
    return 0;
}

/* Pairs of two spheres, the lower number first. */
static void list_of_two(Contacts *c, int a, int b)
{
    const int low = a < b ? a : b, high = a < b ? b : a;
    int from = c->start[low], to = c->start[low + 1];
    while (from < to) {
        const int middle = (from + to) / 2;
        if (c->partner[2 * middle] < high) from = middle + 1;
        else to = middle;
    }
    for (; from < c->start[low + 1] && c->partner[2 * from] == high; from++) list_pair(c, c->partner[2 * from + 1]);
}

/* Pairs whose spheres are near each other: swept along the direction in which they are spread most, in the order of their lower ends
   (Cohen, Lin, Manocha and Ponamgi, doi:10.1145/199404.199437). */
static void sweep(Contacts *c)
{
    const double *x = c->stood, half = 0.5 * c->skin;
    const int wide = D + D * D;
    double low[D], high[D];
    int axis = 0;
    for (int j = 0; j < D; j++) low[j] = INFINITY, high[j] = -INFINITY;
    for (int i = 0; i < c->movers; i++)
        for (int j = 0; j < D; j++) low[j] = fmin(low[j], x[wide * i + j]), high[j] = fmax(high[j], x[wide * i + j]);
    for (int j = 1; j < D; j++)
        if (high[j] - low[j] > high[axis] - low[axis]) axis = j;

    /* nearly in the order of the last time */
    int *order = c->order;
    for (int i = 0; i < c->movers; i++) c->lower[i] = x[wide * i + axis] - c->mover[i].reach - half;
    for (int i = 1; i < c->movers; i++) {
        const int one = order[i];
        int k = i;
        for (; k && c->lower[order[k - 1]] > c->lower[one]; k--) order[k] = order[k - 1];
        order[k] = one;
    }

    for (int i = 0; i < c->movers; i++) {
        const int a = order[i];
        const double end = x[wide * a + axis] + c->mover[a].reach + half;
        for (int k = i + 1; k < c->movers && c->lower[order[k]] <= end; k++) {
            const int b = order[k];
            const double reach = c->mover[a].reach + c->mover[b].reach + c->skin;
            double way[D];
            for (int j = 0; j < D; j++) way[j] = x[wide * a + j] - x[wide * b + j];
            if (dot(way, way, D) <= reach * reach) list_of_two(c, a, b);
        }
    }
}

static int ascending(const void *a, const void *b) { return *(const int *)a - *(const int *)b; }

/* The books of a pair that was not near so far: nothing acts on it in this step, and it is open. */
static void begin_pair(Contacts *c, int pair)
{
    const Pair *o = c->pair + pair;
    const int d = c->components, first = o->first;
    memcpy(c->saved + first * d, c->held + first * d, o->count * d * sizeof(double));
    memcpy(c->saved + c->points * d + pair * D, c->impulse + pair * D, D * sizeof(double));
    memcpy(c->was + first, c->carrying + first, o->count * sizeof(int));
    for (int i = first; i < first + o->count; i++) {
        c->hits[i] = 0;
        c->hits[c->points + i] = -1;
    }
}

/* Pairs near at q, beside those listed; c->now is known of all. 1 where Python failed. */
static int list_near(Contacts *c, const double *q, double t, double skin)
{
    double *x = c->stood;
    c->skin = skin;
    for (int i = 0; i < c->movers; i++, x += D + D * D) mover_at(c->mover + i, q, x, x + D);
    if (list_single(c, q, t)) return 1;
    sweep(c);
    qsort(c->near, c->nears, sizeof(int), ascending);

    int failed = 0;
    c->candidates = 0;
    for (int k = 0; k < c->nears; k++) {
        Pair *o = c->pair + c->near[k];
        for (int i = o->first; i < o->first + o->count; i++) c->candidate[c->candidates++] = i;
        if (c->listed[c->near[k]] > 1) continue;
        c->listed[c->near[k]] = 2;
        begin_pair(c, c->near[k]);
        failed |= c->known && touch_pair(c, o, c->here.q, *c->here.t, &c->now);
    }
    return failed;
}

/* All that may touch at a configuration. */
static int touch(Contacts *c, const double *q, double t, Touch *out)
{
    if (placed(c, q)) return 1;
    if (c->movers) {
        double way = wandered(c, q);
        if (2.0 * way > c->skin && list_near(c, q, t, fmax(c->skin, 2.0 * way))) return 1;
    }
    for (int k = 0; k < c->nears; k++)
        if (touch_pair(c, c->pair + c->near[k], q, t, out)) return 1;
    return 0;
}

/* All others, into c->now. */
static int touch_others(Contacts *c, const double *q, double t)
{
    if (c->nears == c->laws) return 0;
    for (int k = 0; k < c->laws; k++)
        if (!c->listed[k] && touch_pair(c, c->pair + k, q, t, &c->now)) return 1;
    return 0;
}

/* Whether some point of a pair has an impulse of the last part. */
static int pressed(const Contacts *c, const Pair *o)
{
    const int d = c->components;
    for (int i = o->first * d; i < (o->first + o->count) * d; i++)
        if (c->held[i] != 0.0) return 1;
    return 0;
}

/* The list for a step of size h from c->here: made anew where it will not last, and all of the last step's forces cleared. A state
   that was loaded may press anywhere. 1 where Python failed. */
static int begin_list(Contacts *c, double h, double length)
{
    const double way = h * fastest(c, c->here.v), least = LEAVES * DRIFTING * length;
    const int lasts = c->known && 2.0 * (wandered(c, c->here.q) + 2.0 * way) <= c->skin;
    const int before = c->known ? c->nears : c->laws;
    int kept = 0;

    for (int k = 0; k < before; k++) {
        const int pair = c->known ? c->near[k] : k;
        const Pair *o = c->pair + pair;
        memset(c->force + D * o->first, 0, D * o->count * sizeof(double));
        memset(c->normal + o->first, 0, o->count * sizeof(double));
        if (lasts) begin_pair(c, pair);
        else if ((c->listed[pair] = pressed(c, o))) c->near[kept++] = pair;
    }

    if (lasts) return 0;
    c->nears = kept;
    return list_near(c, c->here.q, *c->here.t, fmax(2.0 * LASTS * way, least));
}
