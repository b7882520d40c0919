/* Contacts in a step of elastic bodies: which points take part, as schemes/impacts/contact_detection.py, and Newton's increment with
   them, as schemes/impacts/contact_newton.py. Points are nodes of fields; obstacles are at rest, move as prescribed, or are carried by
   a body. What contact leaves behind is kept with a state, see free_flight.c. */

enum { WIDE = D + 2 * TWIST, ROUNDS_OF_STEP = 4 }; /* numbers of a row; how often points join in */
static const double OVERLAP = 1e-9;                /* of the model's length: what a point passes into an obstacle before it joins in */

/* Where the node of point i begins in arrays like v. */
static long node_at(const Contacts *c, int i)
{
    const Pair *o = c->pair + c->of[i];
    const Body *body = c->system->body + c->on[2 * i];
    return o->node[i - o->first] - body->at_q + body->at_v;
}

/* ---- which contacts take part ---- */

/* Ask Python for the compliance of those near, and for room. */
static int gather_near(FreeFlight *o)
{
    Contacts *c = o->contacts;
    int count = 0, same = o->ready;
    for (int i = 0; i < c->points; i++)
        if (o->listed[i]) {
            same = same && count < o->count && o->near[count] == i;
            o->near[count++] = i;
        }
    same = same && count == o->count;
    o->count = count;
    if (same || !count) return DONE;
    o->ready = o->known_scale = 0;
    if (count > o->most) return LOOK;
    if (c->python(NEARBY, count, 0.0)) return FAILED;
    o->ready = 1;
    return DONE;
}

/* The points of a pair that are near at one of two looks; LOOK where one could pass through: distances change by no more than it moves. */
static int take_near(FreeFlight *o, int number, const Touch *from, const Touch *to)
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
static void let_sway(System *s, const FreeFlight *o, int back)
{
    for (int b = 0; b < s->bodies; b++) {
        if (!s->body[b].field) continue;
        if (back) s->body[b].field->sways = o->sways[b];
        else s->body[b].field->sways = 0;
    }
}

int begin_contact(System *s, FreeFlight *o, double h, const Block *now)
{
    Contacts *c = o->contacts;
    int verdict;
    if (!o->problem) return DONE;
    if (!c->known && look_at_points(c, now->q, *now->t, &c->now)) return FAILED;
    c->known = 1, o->turned = o->rounds = 0;
    for (int i = 0; i < s->nv; i++) o->room[i] = h * now->v[i];
    if ((verdict = driver_compose(s, 1, now->q, s->nq, o->room, s->nv, o->room + s->nv))) return verdict;
    if (look_at_points(c, o->room + s->nv, *now->t + h, &c->aside)) return FAILED;
    for (int k = 0; k < c->pairs; k++)
        if ((verdict = take_near(o, k, &c->now, &c->aside))) return verdict;
    return gather_near(o);
}

int start_forces(System *s, FreeFlight *o, const Block *now)
{
    const int d = o->contacts->components;
    if (!o->problem) return 0;
    o->matrix = o->increments = 0;
    let_sway(s, o, !o->count);
    for (int k = 0; k < o->count; k++)
        memcpy(o->problem->all.f + d * k, now->own + o->at_held + d * o->near[k], d * sizeof(double));
    return o->count;
}

int met_others(FreeFlight *o, const Block *out, int *verdict)
{
    Contacts *c = o->contacts;
    int more = 0;
    if (!o->problem || (*verdict = look_at_points(c, out->q, *out->t, &c->end))) return 0;
    for (int i = 0; i < c->points; i++)
        if (!o->listed[i] && c->end.gap[i] < -OVERLAP * o->length) o->listed[i] = more = 1;
    if (!more) return 0;
    *verdict = gather_near(o);
    return !*verdict && ++o->rounds < ROUNDS_OF_STEP;
}

/* ---- rows ---- */

/* Rows of the points near, at a configuration where they touch like this: directions at nodes, in the axes of their body, and rows on the
   frames of body and obstacle. */
static void elastic_rows(FreeFlight *o, const double *q, const Touch *at)
{
    const Contacts *c = o->contacts;
    const int d = c->components;
    for (int k = 0; k < o->count; k++) {
        const int i = o->near[k], b = c->on[2 * i], carrier = c->on[2 * i + 1];
        double e[D * D], R[D * D], *row = o->rows + WIDE * d * k;
        memcpy(e, at->normal + D * i, D * sizeof(double));
        if (d > 1) across(e, e + D);
        o->turned |= o->increments && memcmp(o->direction + D * d * k, e, D * sizeof(double));
        memcpy(o->direction + D * d * k, e, D * d * sizeof(double));
        rotation(q + POSE * b, R);
        for (int a = 0; a < d; a++, row += WIDE) {
            memset(row, 0, WIDE * sizeof(double));
            transposed(R, e + D * a, row);
            if (!rests(c->system->body + b)) frame_row(q + POSE * b, at->x + D * i, e + D * a, 1.0, row + D);
            if (carrier >= 0) frame_row(q + POSE * carrier, at->x + D * i, e + D * a, -1.0, row + D + TWIST);
        }
    }
}

/* A row of point i times an array like v. */
static double row_times(const Contacts *c, int i, const double *row, const double *v)
{
    const int carrier = c->on[2 * i + 1];
    double sum = dot(row, v + node_at(c, i), D) + dot(row + D, v + TWIST * c->on[2 * i], TWIST);
    return carrier < 0 ? sum : sum + dot(row + D + TWIST, v + TWIST * carrier, TWIST);
}

/* b += factor L^T f, like v. */
static void add_pushes(const FreeFlight *o, double factor, const double *f, double *b)
{
    const Contacts *c = o->contacts;
    const double *row = o->rows;
    for (int k = 0; k < o->count; k++)
        for (int a = 0; a < c->components; a++, row += WIDE, f++) {
            const int i = o->near[k], carrier = c->on[2 * i + 1];
            add(b + node_at(c, i), factor * *f, row, D);
            add(b + TWIST * c->on[2 * i], factor * *f, row + D, TWIST);
            if (carrier >= 0) add(b + TWIST * carrier, factor * *f, row + D + TWIST, TWIST);
        }
}

/* ---- how contacts answer: (1) and (2) of linear/complementarity/delassus.py ---- */

/* Rows at nodes in the axes of the factors of their fields, into ``axes``; whether they are what they were. */
static int turn_rows(FreeFlight *o)
{
    const Contacts *c = o->contacts;
    const int d = c->components;
    int same = 1;
    for (int r = 0; r < d * o->count; r++) {
        const Field *e = c->system->body[c->on[2 * o->near[r / d]]].field;
        double y[D];
        memcpy(y, o->rows + WIDE * r, sizeof y);
        if (e->turns) transposed(e->T, o->rows + WIDE * r, y);
        same = same && !memcmp(y, o->axes + D * r, sizeof y);
        memcpy(o->axes + D * r, y, sizeof y);
    }
    return same;
}

/* What the core does under forces on all rows. */
static int ask_core(System *s, FreeFlight *o)
{
    const Contacts *c = o->contacts;
    const int d = c->components, n = d * o->count;
    memset(o->push, 0, (long)n * s->core * sizeof(double));
    memset(o->seen, 0, (long)n * o->columns * sizeof(double));
    for (int r = 0; r < n; r++) {
        const int i = o->near[r / d], carrier = c->on[2 * i + 1];
        const Nodes *k = o->nodes + o->nodes_of[c->of[i]];
        add(o->push + (long)s->core * r + TWIST * c->on[2 * i], 1.0, o->rows + WIDE * r + D, TWIST);
        if (carrier >= 0) add(o->push + (long)s->core * r + TWIST * carrier, 1.0, o->rows + WIDE * r + D + TWIST, TWIST);
        for (int j = 0; j < D && k->columns; j++)
            add(o->seen + (long)o->columns * r + k->at, o->axes[D * r + j], k->Y + (long)k->columns * (D * o->node[i] + j), k->columns);
    }
    memset(o->room, 0, s->nv * sizeof(double));
    return driver_columns(s, n, o->factored, o->room, o->push, o->seen, o->answer, o->acting);
}

/* How row r moves under a force on row l. */
static double answer_on(const System *s, const FreeFlight *o, int r, int l, int coupled)
{
    const Contacts *c = o->contacts;
    const int i = o->near[r / c->components], j = o->near[l / c->components];
    const Nodes *k = o->nodes + o->nodes_of[c->of[i]];
    double sum = 0.0;
    if (k == o->nodes + o->nodes_of[c->of[j]])
        for (int a = 0; a < D; a++)
            sum += o->axes[D * r + a] * dot(k->C + k->size * (D * o->node[i] + a) + D * o->node[j], o->axes + D * l, D);
    if (!coupled) return sum;
    sum -= dot(o->seen + (long)o->columns * r, o->acting + (long)o->columns * l, o->columns);
    return sum + dot(o->push + (long)s->core * r, o->answer + (long)s->core * l, s->core);
}

/* W, for forces that a solution weights by ``scale``. */
static int take_compliance(System *s, FreeFlight *o, double scale)
{
    const Contacts *c = o->contacts;
    const int d = c->components, m = o->count, coupled = o->coupled;
    Problem *P = &o->problem->all;
    int verdict, same = turn_rows(o) && !coupled && o->known_scale == scale;
    o->matrix = 1;
    if (same) return DONE;
    o->known_scale = 0.0;
    if (coupled && (verdict = ask_core(s, o))) return verdict;
    for (int i = 0; i < m; i++)
        for (int j = 0; j <= i; j++)
            for (int a = 0; a < d; a++)
                for (int b = 0; b < d; b++) {
                    const int r = d * i + a, l = d * j + b;
                    const double w = 0.5 * scale * (answer_on(s, o, r, l, coupled) + answer_on(s, o, l, r, coupled));
                    if (i == j) P->own[(i * d + a) * d + b] = w;
                    else {
                        P->W[(((long)i * (m - 1) + j) * d + a) * d + b] = w;
                        P->W[(((long)j * (m - 1) + i - 1) * d + b) * d + a] = w;
                    }
                }
    o->known_scale = scale;
    return DONE;
}

/* ---- increments ---- */

/* Gaps at the end of a step, and slips in it, under the forces so far and after an increment x. */
static int find_openings(FreeFlight *o, const Contacting *k, const Touch *at, const Touch *end, const double *x)
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
            P->u[d * j + a] = row_times(c, i, row, x) + (a ? row_times(c, i, row, k->xi) - drift[a] : end->gap[i]);
        }
        P->mu[j] = c->pair[c->of[i]].friction;
    }
    moved_by(P, d, P->f, P->q);
    for (int r = 0; r < d * o->count; r++) P->q[r] = P->u[r] - P->q[r];
    return DONE;
}

/* Forces on the rows, out of the residuals evaluated last. */
static void push_residuals(System *s, const FreeFlight *o, const double *f)
{
    const Contacts *c = o->contacts;
    const double *row = o->rows;
    for (int k = 0; k < o->count; k++)
        for (int a = 0; a < c->components; a++, row += WIDE, f++) {
            const int *on = c->on + 2 * o->near[k];
            const Body *body = s->body + on[0];
            add(body->field->force + node_at(c, o->near[k]) - body->at_v, -*f, row, D);
            for (int side = 0; side < 2; side++) {
                const double *twist = row + D + side * TWIST;
                double turning[ROT];
                if (on[side] < 0) continue;
                to_world(s->frames + FRAME * on[side] + TURN, twist + D, turning);
                add(s->residual + s->body[on[side]].at_u, -*f, twist, D);
                add(s->residual + s->body[on[side]].at_u + D, -*f, turning, ROT);
            }
        }
}

/* The solution with more forces on the rows. */
static int solve_pushed(System *s, const FreeFlight *o, const Contacting *k, const double *f, double *x, double *y)
{
    if (k->b) {
        add_pushes(o, k->scale, f, k->b);
        return driver_solve(s, 1, o->factored, k->b, k->open, x, y);
    }
    push_residuals(s, o, f);
    return increment(s, k->scale, x, y, k->t);
}

/* Forces that the law asks for; Python finds those of hard problems. */
static int find_forces(const FreeFlight *o)
{
    const Problem *P = &o->problem->all;
    const int d = o->contacts->components, n = d * o->count;
    memcpy(o->start, P->f, n * sizeof(double));
    if (contact_forces(o->problem, P, 0)) {
        memcpy(P->f, o->start, n * sizeof(double));
        if (o->contacts->python(COMPLEMENTARITY, o->count, 0.0)) return FAILED;
    }
    for (int r = 0; r < n; r += d) P->f[r] = fmax(P->f[r], 0.0);
    return DONE;
}

int goes_on_slowly(const FreeFlight *o) { return o->linear; }

void contact_factored(const System *s, FreeFlight *o, const double *q)
{
    o->matrix = 0;
    memcpy(o->factored, q, s->nq * sizeof(double));
}

int contact_increment(System *s, FreeFlight *o, const Contacting *k, double *x, double *y)
{
    Contacts *c = o->contacts;
    const int n = c->components * o->count;
    Problem *P = &o->problem->all;
    Touch *end = &c->aside;
    int verdict, changed = 0;
    if (look_at_points(c, k->q, k->t, &c->aside)) return FAILED;
    if (k->end != k->q && look_at_points(c, k->end, k->end_t, end = &c->end)) return FAILED;
    elastic_rows(o, k->q, &c->aside);

    /* the increment without a change of the contact forces */
    if ((verdict = solve_pushed(s, o, k, P->f, x, y))) return verdict;
    if (!o->matrix && (verdict = take_compliance(s, o, k->scale))) return verdict;
    if (find_openings(o, k, &c->aside, end, x)) return FAILED;

    /* what the change of the forces adds */
    if ((verdict = find_forces(o))) return verdict;
    for (int r = 0; r < n; r++) {
        o->change[r] = P->f[r] - o->start[r];
        changed |= o->change[r] != 0.0;
    }
    o->increments++;
    return changed ? solve_pushed(s, o, k, o->change, x, y) : DONE;
}

/* ---- what steps tell of later ones: schemes/impacts/elastic_step.py ---- */

/* Whether the points near are those of the step that led to a state. */
static int as_before(const FreeFlight *o, const Block *now)
{
    for (int i = 0; o->problem && i < o->contacts->points; i++)
        if (now->own[o->at_near + i] != o->listed[i]) return 0;
    return 1;
}

double left_as_told(const FreeFlight *o, const Block *now, double h, double size, double tolerance)
{
    const double *known = now->own + CONFIRMED;
    if (!o->smooth || *known != h || known[RELIES] >= o->relies || !as_before(o, now)) return INFINITY;

    const double ratio = size * tolerance / known[FIRST_ONE];
    return o->margin * known[SECOND] * fmax(1.0, ratio * ratio) / tolerance;
}

void iterated(FreeFlight *o, const Block *now, const Block *out, double h, const double *sizes, double tolerance, int done)
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
