/* Contacts in a step of elastic bodies: which candidates take part, as schemes/impacts/contact_detection.py, and Newton's increment with
   them, as schemes/impacts/contact_newton.py. What contact leaves behind is kept with a state, see elastic_books.c. */

enum { ROUNDS_OF_STEP = 4 };        /* how often points join in */
static const double OVERLAP = 1e-9; /* of the model's length: what a point passes into an obstacle before it joins in */

#include "contact/elastic_rows.c"
#include "contact/products.c"

/* ---- which contacts take part ---- */

/* List the nodes that those near act on, trace by trace; whether C is known at all of them, and whether contacts of two laws share one. */
static void list_nodes(ElasticContact *o, int *known, int *shared)
{
    int count = 0;
    *known = 1, *shared = 0;
    for (Nodes *k = o->nodes; k < o->nodes + o->traces; k++)
        for (int n = 0; n < k->size; n++) o->place[k->first + n] = -1;

    for (int j = 0; j < 2 * o->count; j++) {
        const Side k = side_of(o, o->near[j / 2], j % 2);
        for (int e = 0; e < k.count; e++) {
            int *at = o->place + k.nodes->first + number_of(&k, e), law = o->contacts->of[o->near[j / 2]];
            *shared |= *at >= 0 && *at != law;
            *at = law;
        }
    }

    for (Nodes *k = o->nodes; k < o->nodes + o->traces; k++) {
        k->begin = count;
        for (int n = k->first; n < k->first + k->size; n++) {
            if (o->place[n] < 0) continue;
            *known &= o->answered[n];
            o->place[n] = count, o->touched[count++] = n - k->first;
        }
        k->end = count;
    }
}

/* Ask Python for what is not known of the compliance of those near, and for room for another number of them. */
static int gather_near(ElasticContact *o)
{
    Contacts *c = o->contacts;
    int count = 0, same = 1, known, shared;
    const Problem *P = &o->problem->all;
    for (int i = 0; i < c->points; i++)
        if (o->listed[i]) {
            same = same && count < o->count && o->near[count] == i;
            o->near[count++] = i;
        }

    same = same && count == o->count;
    if (!same) o->known_scale = 0.0;
    o->count = count;
    if (!count) return DONE;
    list_nodes(o, &known, &shared);
    o->applied = count > (shared ? o->utmost : o->most); /* products do not tell forces on a node that is held twice */
    if (o->ready && P->m == count && !P->lumped == !o->applied && (o->applied ? same : known)) return DONE;
    o->ready = o->known_scale = 0;
    if (c->python(NEARBY, count, 0.0)) return FAILED;
    o->ready = 1;
    return DONE;
}

/* The points of a pair that are near at one of two looks; LOOK where one could pass through: distances change by no more than it moves. */
static int take_near(ElasticContact *o, int number, const Touch *from, const Touch *to)
{
    const Pair *k = o->contacts->pair + number;
    double approach = 0.0;
    for (int i = k->first; i < k->first + k->count; i++) approach = fmax(approach, fabs(to->gap[i] - from->gap[i]));
    const double reach = isnan(o->search[number]) ? fmax(2.0 * approach, o->least) : o->search[number];
    for (int i = k->first; i < k->first + k->count; i++) {
        double way[D];
        o->listed[i] = from->gap[i] < reach || to->gap[i] < reach;
        if (!isfinite(k->thickness)) continue;

        memcpy(way, to->relative + D * i, D * sizeof(double));
        add(way, -1.0, from->relative + D * i, D);
        const double size = length_of(way), both = fmax(from->gap[i], 0.0) + fmax(to->gap[i], 0.0);
        if (size > 0.5 * k->thickness && from->gap[i] > -0.1 * k->thickness && size >= both) return LOOK;
    }
    return DONE;
}

/* Solutions with contacts correct no moments, as compliances do not. */
static void let_sway(System *s, const ElasticContact *o, int back)
{
    for (int b = 0; b < s->bodies; b++) {
        if (!s->body[b].field) continue;
        if (back) s->body[b].field->sways = o->sways[b];
        else s->body[b].field->sways = 0;
    }
}

int begin_contact(System *s, ElasticContact *o, double h, const Block *now, const double *beside)
{
    Contacts *c = o->contacts;
    int verdict;
    if (!c->known && look_at_points(o, now->q, *now->t, &c->now)) return FAILED;
    c->known = 1, o->turned = o->rounds = 0;
    if (c->meetings) {
        const double reach = 4.0 * h * fastest_node(c, now->v);
        double *q = o->room + s->nv;
        if (beside && (verdict = driver_compose(s, 1, now->q, s->nq, beside, s->nv, q))) return verdict;
        if (beside ? pair_beside(c, q, *now->t, reach, &c->now) : pair_surfaces(c, reach, &c->now)) return FAILED;
        o->known_scale = 0.0;
        if (o->problem->all.lumped) o->ready = 0;
    }
    for (int i = 0; i < s->nv; i++) o->room[i] = h * now->v[i];
    if ((verdict = driver_compose(s, 1, now->q, s->nq, o->room, s->nv, o->room + s->nv))) return verdict;
    if (look_at_points(o, o->room + s->nv, *now->t + h, &c->aside)) return FAILED;
    for (int k = 0; k < c->laws; k++)
        if ((verdict = take_near(o, k, &c->now, &c->aside))) return verdict;
    return gather_near(o);
}

int start_forces(System *s, ElasticContact *o, const Block *now)
{
    const int d = o->contacts->components;
    o->matrix = o->increments = 0;
    let_sway(s, o, !o->count);
    for (int k = 0; k < o->count; k++)
        memcpy(o->problem->all.f + d * k, now->own + o->at_held + d * o->near[k], d * sizeof(double));
    return o->count;
}

int met_others(ElasticContact *o, const Block *out, int *verdict)
{
    Contacts *c = o->contacts;
    int more = 0;
    if ((*verdict = look_at_points(o, out->q, *out->t, &c->end))) return 0;
    for (int i = 0; i < c->points; i++)
        if (!o->listed[i] && c->end.gap[i] < -OVERLAP * o->length) o->listed[i] = more = 1;
    if (!more) return 0;
    *verdict = gather_near(o);
    return !*verdict && ++o->rounds < ROUNDS_OF_STEP;
}

/* ---- increments ---- */

/* Gaps at the end of a step, and slips in it, under the forces so far and after an increment x. */
static int find_openings(ElasticContact *o, const Contacting *k, const Touch *at, const Touch *end, const double *x)
{
    Contacts *c = o->contacts;
    const int d = c->components;
    Problem *P = &o->problem->all;
    for (int j = 0; j < o->count; j++) {
        const int i = o->near[j];
        double drift[D];
        if (drifts(c, i, k->q, k->t, way_over(k->from, k->span), at, drift)) return FAILED;

        for (int a = 0; a < d; a++) {
            const double *row = o->rows + WIDE * (d * j + a);
            P->u[d * j + a] = row_times(o, i, o->slopes + WIDE * (d * j + a), x) + (a ? row_times(o, i, row, k->xi) - drift[a] : end->gap[i]);
        }
        P->mu[j] = c->pair[c->of[i]].friction;
    }
    moved_by(P, d, P->f, P->q);
    for (int r = 0; r < d * o->count; r++) P->q[r] = P->u[r] - P->q[r];
    return DONE;
}

/* The solution with the forces on the rows so far. */
static int solve_so_far(System *s, const ElasticContact *o, const Contacting *k, double *x, double *y)
{
    const double *f = o->problem->all.f;
    if (k->b) {
        add_pushes(s, o, k->scale, f, k->b);
        return driver_solve(s, 1, o->factored, k->b, k->open, x, y);
    }
    add_pushes(s, o, -1.0, f, NULL);
    return increment(s, k->scale, x, y, k->t);
}

/* Forces that the law asks for; Python finds those of hard problems, and makes the step where W is known by its products. */
static int find_forces(const ElasticContact *o)
{
    const Problem *P = &o->problem->all;
    const int d = o->contacts->components, n = d * o->count;
    memcpy(o->start, P->f, n * sizeof(double));
    if (contact_forces(o->problem, P, 0) && (!P->lumped || frictional_forces(o->problem, P))) {
        if (P->lumped) return LOOK;
        memcpy(P->f, o->start, n * sizeof(double));
        if (o->contacts->python(COMPLEMENTARITY, o->count, 0.0)) return FAILED;
    }
    for (int r = 0; r < n; r += d) P->f[r] = fmax(P->f[r], 0.0);
    return DONE;
}

int goes_on_slowly(const ElasticContact *o) { return o->linear; }

void contact_factored(const System *s, ElasticContact *o, const double *q)
{
    o->matrix = 0;
    memcpy(o->factored, q, s->nq * sizeof(double));
}

int contact_increment(System *s, ElasticContact *o, const Contacting *k, double *x, double *y)
{
    Contacts *c = o->contacts;
    const int n = c->components * o->count;
    Problem *P = &o->problem->all;
    Touch *end = &c->aside;
    int verdict, changed = 0;
    if (look_at_points(o, k->q, k->t, &c->aside)) return FAILED;
    if (k->end != k->q && look_at_points(o, k->end, k->end_t, end = &c->end)) return FAILED;
    elastic_rows(o, k, &c->aside);

    /* the increment without a change of the contact forces */
    if ((verdict = solve_so_far(s, o, k, x, y))) return verdict;
    if (!o->matrix && (verdict = take_compliance(s, o, k->scale))) return verdict;
    if (find_openings(o, k, &c->aside, end, x)) return FAILED;

    /* what the change of the forces adds */
    if ((verdict = find_forces(o))) return verdict;
    for (int r = 0; r < n; r++) {
        o->change[r] = P->f[r] - o->start[r];
        changed |= o->change[r] != 0.0;
    }
    o->increments++;
    if (!changed) return DONE;

    double *more = o->room + s->nv, *also = more + 2 * s->nv + s->nq + s->rows;
    if ((verdict = pushed(s, o, k->scale, o->change, more, also))) return verdict;
    add(x, 1.0, more, s->nv);
    add(y, 1.0, also, s->rows);
    return DONE;
}

/* ---- what steps tell of later ones: schemes/impacts/elastic_step.py ---- */

/* Whether the points near are those of the step that led to a state. */
static int as_before(const ElasticContact *o, const Block *now)
{
    for (int i = 0; i < o->contacts->points; i++)
        if (now->own[o->at_near + i] != o->listed[i]) return 0;
    return 1;
}

double left_as_told(const ElasticContact *o, const Block *now, double h, double size, double tolerance)
{
    const double *known = now->own + CONFIRMED;
    if (!o->smooth || *known != h || known[RELIES] >= o->relies || !as_before(o, now)) return INFINITY;

    const double ratio = size * tolerance / known[FIRST_ONE];
    return o->margin * known[SECOND] * fmax(1.0, ratio * ratio) / tolerance;
}

void iterated(ElasticContact *o, const Block *now, const Block *out, double h, const double *sizes, double tolerance, int done)
{
    double *told = out->own + CONFIRMED;
    o->iterations = done;
    if (o->smooth && *(now->own + CONFIRMED) == h && as_before(o, now) && done == 1) {
        memcpy(told, now->own + CONFIRMED, (RELIES + 1) * sizeof(double));
        told[RELIES] += 1.0;
        return;
    }
    memset(told, 0, (RELIES + 1) * sizeof(double));
    if (!o->smooth || done != 2 || o->turned) return;
    told[0] = h, told[FIRST_ONE] = sizes[0] * tolerance, told[SECOND] = sizes[1] * tolerance;
}
