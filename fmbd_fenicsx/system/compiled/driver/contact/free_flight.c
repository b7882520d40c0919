/* Steps of elastic bodies in which nothing is near what it may touch: whether a step is one, as candidates() of
   schemes/impacts/contact_detection.py, and the books of contact in it, as schemes/impacts/contact_ledger.py has them. */

enum { SIGHT_OF_STEPS = 4 }; /* surfaces look for each other as far as nodes move in so many steps */

/* Two surfaces that may touch: numbers of the pairs with their nodes; how far their facets look for each other, m. */
typedef struct {
    int slave, master;
    double sight;
} Facing;

typedef struct FreeFlight {
    Contacts *contacts;
    int facings, loaded;               /* pairs of surfaces; whether there are force elements */
    Facing *facing;
    double share, least;               /* of a step at which its forces act; gaps below this are near, m */
    const double *search;              /* pairs: gaps below this, where it was chosen, else nan */
    double *room;                      /* 3 nv + nq + 4 rows */
} FreeFlight;

/* What is kept with a state: works since the start as in sensors/contact.py, the total energy, that of springs. */
enum { LOADS = 2, JOINTS, REST, ENERGY, SPRINGS };

/* The largest way of the points of a pair between two looks. */
static double largest_way(const Pair *o, const Touch *from, const Touch *to)
{
    double most = 0.0;
    for (int i = D * o->first; i < D * (o->first + o->count); i += D) {
        double way[D];
        memcpy(way, to->x + i, D * sizeof(double));
        add(way, -1.0, from->x + i, D);
        most = fmax(most, length_of(way));
    }
    return most;
}

/* The distance of the boxes around the points of two pairs. */
static double apart(const Pair *a, const Pair *b, const Touch *at)
{
    double gap[D];
    for (int k = 0; k < D; k++) {
        double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
        const Pair *side[] = {a, b};
        for (int j = 0; j < 2; j++)
            for (int i = side[j]->first; i < side[j]->first + side[j]->count; i++) {
                low[j] = fmin(low[j], at->x[D * i + k]);
                high[j] = fmax(high[j], at->x[D * i + k]);
            }
        gap[k] = fmax(0.0, fmax(low[0] - high[1], low[1] - high[0]));
    }
    return length_of(gap);
}

/* Whether no point of a pair is near its obstacle at two looks, or touches it between them: distances change by no more than a point
   moves. */
static int passes_by(const Pair *o, double search, double least, const Touch *from, const Touch *to)
{
    double approach = 0.0;
    for (int i = o->first; i < o->first + o->count; i++) approach = fmax(approach, fabs(to->gap[i] - from->gap[i]));
    const double near = isnan(search) ? fmax(2.0 * approach, least) : search;

    for (int i = o->first; i < o->first + o->count; i++) {
        if (!(fmin(from->gap[i], to->gap[i]) >= near && to->gap[i] > 0.0)) return 0;
        if (!isfinite(o->thickness)) continue;
        double way[D];
        memcpy(way, to->relative + D * i, D * sizeof(double));
        add(way, -1.0, from->relative + D * i, D);
        if (!(length_of(way) < from->gap[i] + to->gap[i])) return 0;
    }
    return 1;
}

/* Whether nothing is near in a step. */
static int is_free(const FreeFlight *o)
{
    const Contacts *c = o->contacts;
    for (int i = 0; i < c->pairs; i++)
        if (c->pair[i].shape != SURFACE && !passes_by(c->pair + i, o->search[i], o->least, &c->now, &c->end)) return 0;
    for (const Facing *k = o->facing; k < o->facing + o->facings; k++) {
        const Pair *a = c->pair + k->slave, *b = c->pair + k->master;
        double way = fmax(largest_way(a, &c->now, &c->end), largest_way(b, &c->now, &c->end));
        if (apart(a, b, &c->end) <= fmax(k->sight, SIGHT_OF_STEPS * way)) return 0;
    }
    return 1;
}

/* Works of a step, which nothing of contact has done, and energies at its end. */
static int write_books(System *s, const FreeFlight *o, double h, const Block *now, const Block *out)
{
    double *xi = o->room, *part = xi + s->nv, *v = part + s->nv, *q = v + s->nv, *rows = q + s->nq, *books = out->own, e[4];
    const double t = *now->t + o->share * h, before = now->own[ENERGY];
    int verdict;
    memcpy(books, now->own, (SPRINGS + 1) * sizeof(double));

    for (int i = 0; i < s->nv; i++) part[i] = h * now->v[i];
    driver_difference(s, 1, now->q, s->nq, out->q, s->nq, part, s->nv, xi);
    for (int i = 0; i < s->nv; i++) {
        part[i] = o->share * xi[i];
        v[i] = o->share < 1.0 ? xi[i] / h : out->v[i];
    }
    configuration(s, now->q, part, q);
    if (o->loaded) {
        if ((verdict = driver_work(s, t, q, v, xi, e))) return verdict;
        books[LOADS] += *e;
    }
    if (s->rows) {
        double *slip = rows + s->rows, *partial = slip + s->rows;
        if ((verdict = driver_constraints(s, 1, &t, q, xi, rows, slip, partial, partial + s->rows))) return verdict;
        for (int i = 0; i < s->rows; i++) books[JOINTS] -= out->lam[i] * (slip[i] - partial[i]);
    }

    if ((verdict = driver_energies(s, 1, out->t, out->q, out->v, e))) return verdict;
    books[ENERGY] = e[0] + e[1] + e[2] + e[3];
    if (o->loaded) books[LOADS] += e[3] - now->own[SPRINGS];
    books[SPRINGS] = e[3];
    books[REST] += books[ENERGY] - before - (books[LOADS] - now->own[LOADS]) - (books[JOINTS] - now->own[JOINTS]);
    return DONE;
}

/* All points at a configuration. */
static int look_at_points(Contacts *c, const double *q, double t, Touch *out)
{
    for (Pair *k = c->pair; k < c->pair + c->pairs; k++)
        if (touch_pair(c, k, q, t, out)) return FAILED;
    return DONE;
}

int fly(System *s, FreeFlight *o, double h, const Block *now, const Block *out)
{
    Contacts *c = o->contacts;
    if (!c->known && look_at_points(c, now->q, *now->t, &c->now)) return FAILED;
    c->known = 0;
    if (look_at_points(c, out->q, *out->t, &c->end)) return FAILED;
    return is_free(o) ? write_books(s, o, h, now, out) : LOOK;
}

void land(FreeFlight *o)
{
    Contacts *c = o->contacts;
    const Touch newest = c->end;
    c->end = c->now, c->now = newest;
    c->known = 1;
}
