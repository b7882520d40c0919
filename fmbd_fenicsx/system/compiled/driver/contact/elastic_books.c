/* What bodies may touch in the steps of a march, and the books of contact, as schemes/impacts/contact_ledger.py has them. */

/* The nodes of a field that may touch: numbers of the trace, and where they begin among those of all; columns of H, and where those of
   the field begin; E^-1 and its columns Y there, see linear/complementarity/delassus.py; nodes that rows near act on. */
typedef struct {
    int size, first, columns, at;
    const double *C, *Y;               /* size x size; size x columns */
    int body;                          /* that of the field, which answers to unit forces on the nodes by */
    const double *Z;                   /* size x its unknowns, where C is known; NULL: nowhere. And where the numbers of each node begin */
    const int *numbers;                /* among these */
    int begin, end;                    /* among those touched */
    const int *start, *column;         /* of E there, by blocks D x D: where each row begins, and nodes of its blocks */
    const double *E;
} Nodes;

typedef struct ElasticContact {
    Contacts *contacts;                /* candidates first, then nodes of surfaces that meet others */
    int loaded;                        /* whether there are force elements */
    double share, least;               /* of a step at which its forces act; gaps below this are near, m */
    const double *search;              /* laws: gaps below this, where it was chosen, else nan */
    double *room;                      /* 3 nv + nq + 4 rows */
    Contacts *problem;                 /* of forces on those near */
    int smooth, linear, coupled, columns; /* see elastic_step.py; fields with one tangent; whether the core moves them; of all fields */
    int most, utmost, applied;         /* near of which W is stored, and where laws share nodes; whether it is known by its products */
    double margin, relies, brief, length; /* of elastic_step.py; steps of a short impact; of the model, m */
    int at_since, at_impulse, at_held, at_near; /* in what is kept with a state */
    int traces;
    Nodes *nodes;
    int *nodes_of, *node, *sways;      /* pairs; points: number in these; bodies */
    int *listed, *near;                /* candidates: whether near; numbers of these, ascending */
    int *touched, *place, *answered;   /* nodes of all traces: those that rows near act on; number among them, else -1; whether C is known */
    int count, ready, rounds, turned;  /* of those near; whether Python has made room for them; how often points joined in; whether normals */
    int matrix, increments, iterations; /* have turned in the step; whether its W is known; increments of an iteration */
    double known_scale;                /* of the W known, 0 for none */
    double *factored;                  /* nq: the configuration of the matrix */
    double *slopes, *sensed;           /* how openings change: as rows, and these at nodes in the axes of factors, like ``axes`` */
    double *rows, *direction, *axes, *start, *change, *stopped, *rates; /* of those near, components each: WIDE; D; 2 D; 1 .. */
    double *push, *seen, *answer, *acting; /* core; columns; core; columns */
    double *reply;                     /* D of each node touched */
} ElasticContact;

/* What is kept with a state: works since the start as in sensors/contact.py, the total energy, that of springs, counts, what a step has
   confirmed (its size, two increments, steps that have relied on it), when forces act; of pairs, steps since they closed and impulses; of
   points, components of forces, forces in world axes, whether they were near. */
enum { LOADS = 2, JOINTS, REST, ENERGY, SPRINGS, IMPACTS, BRIEF, IN_CONTACT, INCREMENTS, CONFIRMED, TIME = CONFIRMED + 4, KEPT };
enum { FIRST_ONE = 1, SECOND, RELIES };

/* All points at a configuration. */
static int look_at_points(const ElasticContact *o, const double *q, double t, Touch *out)
{
    Contacts *c = o->contacts;
    for (Pair *k = c->pair; k < c->pair + c->laws; k++)
        if (touch_pair(c, k, q, t, out)) return FAILED;
    return DONE;
}

#include "contact/elastic_contact.c"
#include "contact/persistency.c"

/* Forces of a step and what they have done, with the state that it leads to; ``time``: when they act. */
static void write_contacts(const ElasticContact *o, double h, double time, const double *xi, const Block *now, const Block *out)
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
            own[a > 0] += f * row_times(o, i, o->rows + WIDE * r, xi);
            add(impulse + D * c->of[i], h * f, o->direction + D * r, D);
        }

    for (int p = 0; p < c->laws; p++) {
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
int book_contact(System *s, ElasticContact *o, double h, const Block *now, const Block *out)
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

    write_contacts(o, h, t, xi, now, out);
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

void pass_contact(ElasticContact *o)
{
    Contacts *c = o->contacts;
    const Touch newest = c->end;
    c->end = c->now, c->now = newest;
    c->known = 1;
}

/* One array behind the other: gaps, places, normals, normal forces, forces, impulses, works, time. */
void record_contact(const ElasticContact *o, const Block *out, double *to, long place)
{
    const Contacts *c = o->contacts;
    const int m = c->points, d = c->components, pushed = c->laws * D;
    const double *own = out->own, *held = own + o->at_held, *from[] = {c->end.x, c->end.normal};
    const double *kept[] = {held + m * d, own + o->at_impulse, own, own + TIME};
    const int sizes[] = {m * D, pushed, WORKS, 1};
    to += place * (m * (2 + 3 * D) + pushed + WORKS + 1);
    for (int i = 0; i < m; i++) *to++ = c->end.gap[i] + c->offset[i];
    for (int k = 0; k < 2; k++, to += m * D) memcpy(to, from[k], m * D * sizeof(double));
    for (int i = 0; i < m; i++) *to++ = held[d * i];
    for (int k = 0; k < 4; to += sizes[k++]) memcpy(to, kept[k], sizes[k] * sizeof(double));
}
