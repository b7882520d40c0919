/* Steps of elastic bodies before what they may touch: whether nothing is near in one, where Python makes the others, and the books of
   contact, as schemes/impacts/contact_ledger.py has them. */

enum { SIGHT_OF_STEPS = 4 }; /* surfaces look for each other as far as nodes move in so many steps */

/* Two surfaces that may touch: numbers of the pairs with their nodes; how far their facets look for each other, m. */
typedef struct {
    int slave, master;
    double sight;
} Facing;

/* The nodes of a field that may touch: numbers of the trace, columns of H, and where those of the field begin among all; E^-1 and its
   columns Y there, see linear/complementarity/delassus.py. */
typedef struct {
    int size, columns, at;
    const double *C, *Y;               /* size x size; size x columns */
} Nodes;

typedef struct FreeFlight {
    Contacts *contacts;
    int facings, loaded;               /* pairs of surfaces; whether there are force elements */
    Facing *facing;
    double share, least;               /* of a step at which its forces act; gaps below this are near, m */
    const double *search;              /* pairs: gaps below this, where it was chosen, else nan */
    double *room;                      /* 3 nv + nq + 4 rows */
    Contacts *problem;                 /* of forces on those near; NULL where Python makes steps in contact */
    int smooth, linear, most, coupled, columns; /* see elastic_step.py; fields with one tangent; most near at once; whether the core moves them; columns of all fields */
    double margin, relies, brief, length; /* of elastic_step.py; steps of a short impact; of the model, m */
    int at_since, at_impulse, at_held, at_near; /* in what is kept with a state */
    Nodes *nodes;
    int *nodes_of, *node, *sways;      /* pairs; points: number in these; bodies */
    int *listed, *near;                /* points: whether near; numbers of these, ascending */
    int count, ready, rounds, turned;  /* of them; whether Python has made room for them; how often points joined in; whether normals */
    int matrix, increments, iterations; /* have turned in the step; whether its W is known; increments of an iteration */
    double known_scale;                /* of the W known, 0 for none */
    double *factored;                  /* nq: the configuration of the matrix */
    double *rows, *direction, *axes, *start, *change, *stopped, *rates; /* of those near, components each: WIDE; D; D; 1 .. */
    double *push, *seen, *answer, *acting; /* core; columns; core; columns */
} FreeFlight;

/* What is kept with a state: works since the start as in sensors/contact.py, the total energy, that of springs, counts, what a step has
   confirmed (its size, two increments, steps that have relied on it), when forces act; of pairs, steps since they closed and impulses; of
   points, components of forces, forces in world axes, whether they were near. */
enum { LOADS = 2, JOINTS, REST, ENERGY, SPRINGS, IMPACTS, BRIEF, IN_CONTACT, INCREMENTS, CONFIRMED, TIME = CONFIRMED + 4, KEPT };
enum { FIRST_ONE = 1, SECOND, RELIES };

/* All points at a configuration. */
static int look_at_points(Contacts *c, const double *q, double t, Touch *out)
{
    for (Pair *k = c->pair; k < c->pair + c->pairs; k++)
        if (touch_pair(c, k, q, t, out)) return FAILED;
    return DONE;
}

#include "contact/elastic_contact.c"
#include "contact/persistency.c"

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

/* Forces of a step and what they have done, with the state that it leads to; ``time``: when they act. */
static void write_contacts(const FreeFlight *o, double h, double time, const double *xi, const Block *now, const Block *out)
{
    const Contacts *c = o->contacts;
    const int d = c->components, m = c->points;
    double *own = out->own, *held = own + o->at_held, *force = held + m * d, *impulse = own + o->at_impulse;
    double *since = own + o->at_since;
    int acts = 0;
    memcpy(own + IMPACTS, now->own + IMPACTS, (CONFIRMED - IMPACTS) * sizeof(double));
    memcpy(own + o->at_since, now->own + o->at_since, (o->at_held - o->at_since) * sizeof(double));
    memset(held, 0, m * (d + D + 1) * sizeof(double));
    own[TIME] = time;
    for (int i = 0; i < m; i++) own[o->at_near + i] = o->listed[i];

    for (int k = 0; k < o->count; k++)
        for (int a = 0; a < d; a++) {
            const int i = o->near[k], r = d * k + a;
            const double f = o->problem->all.f[r];
            held[d * i + a] = f;
            add(force + D * i, f, o->direction + D * r, D);
            own[a > 0] += f * row_times(c, i, o->rows + WIDE * r, xi);
            add(impulse + D * c->of[i], h * f, o->direction + D * r, D);
        }

    for (int p = 0; p < c->pairs; p++) {
        const Pair *k = c->pair + p;
        if (largest(held + d * k->first, d * k->count) > 0.0) {
            since[p] += 1.0, acts = 1;
            continue;
        }
        own[IMPACTS] += since[p] > 0.0;
        own[BRIEF] += since[p] > 0.0 && since[p] <= o->brief;
        since[p] = 0.0;
    }
    own[IN_CONTACT] += acts;
    own[INCREMENTS] += acts * o->iterations;
}

/* Works of a step, and energies at its end. */
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
    if (o->problem) write_contacts(o, h, t, xi, now, out);
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
    books[REST] += books[ENERGY] - before;
    for (int k = 0; k < REST; k++) books[REST] -= books[k] - now->own[k];
    return DONE;
}

int fly(System *s, FreeFlight *o, double h, const Block *now, const Block *out)
{
    Contacts *c = o->contacts;
    if (o->problem) return write_books(s, o, h, now, out);
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

/* What a record tells of contacts, one array behind the other: gaps, places, normals, normal forces, forces, impulses, works, time. */
static void record_touch(const FreeFlight *o, const Block *out, double *to)
{
    const Contacts *c = o->contacts;
    const int m = c->points, d = c->components;
    const double *own = out->own, *held = own + o->at_held, *from[] = {c->end.gap, c->end.x, c->end.normal};
    const double *kept[] = {held + m * d, own + o->at_impulse, own, own + TIME};
    const int looked[] = {m, m * D, m * D}, sizes[] = {m * D, c->pairs * D, WORKS, 1};
    for (int k = 0; k < 3; to += looked[k++]) memcpy(to, from[k], looked[k] * sizeof(double));
    for (int i = 0; i < m; i++) *to++ = held[d * i];
    for (int k = 0; k < 4; to += sizes[k++]) memcpy(to, kept[k], sizes[k] * sizeof(double));
}

void record_contact(const FreeFlight *o, const Block *out, double *to, long place)
{
    const Contacts *c = o->contacts;
    if (o->problem) record_touch(o, out, to + place * (c->points * (2 + 3 * D) + c->pairs * D + WORKS + 1));
    else memcpy(to + place * WORKS, out->own, WORKS * sizeof(double));
}
