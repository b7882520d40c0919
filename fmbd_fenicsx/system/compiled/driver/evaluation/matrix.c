/* The step's matrix at the state evaluated last; links.c adds what efforts answer to beside their own coordinates:

       [ M + cd C + ck K   G^T ]      K, C: of elastic bodies and of efforts, N r on a row r = ds/dV:
       [ G                  0  ]      (ck dN/ds + cd dN/ds') r r^T + ck N dr/dq                                        (1)

   The last term of (1) is the geometric stiffness of an effort; that of a reaction has lambda for N. Newton's iteration moves a
   stiff spring along itself at once, so that N is what the last increment leads to: of the elongation nearly found, which is off
   by its square, N would be anything. These are the iterations of a form whose efforts are unknowns of their own. */

static const double SAME_PULL = 0.1; /* efforts that differ by a smaller share are the same across */
static const double HARD = 0.01;     /* of a body's radius of gyration: how far reactions that push hard move it within a step */

/* ---- frames of bodies: entries go straight to their places ---- */

static void plain_rows(System *s, const Batch *k)
{
    const double *out = k->out;
    const int *dest = k->dest, *at = k->at;
    for (long i = 0; i < k->n; i++, out += k->outputs, dest += k->live, at += k->live) {
        double square = 0.0;
        for (int e = 0; e < k->live; e++) {
            double entry = k->factor[i] * out[k->entry[e]];
            s->L[dest[e]] += entry;
            square += entry * entry / s->diagonal[at[e]];
        }
        s->weight[k->row[i]] += square;
    }
}

static void plain_squares(System *s, const Batch *k, const double *slope)
{
    const double *out = k->out;
    const int *to = k->product_to;
    for (long i = 0; i < k->n; i++, out += k->outputs)
        for (int e = 0; e < k->products; e++, to++) s->L[*to] += slope[i] * out[k->first[e]] * out[k->second[e]];
}

static void plain_curves(System *s, const Batch *k)
{
    const double *hessian = k->hessian;
    const int *to = k->curve_to;
    for (long i = 0; k->curved && i < k->n; i++, hessian += k->hessians)
        for (int e = 0; e < k->curved; e++, to++) s->L[*to] += hessian[k->curve[e]];
}

/* ---- sums ---- */

/* The geometric stiffness of the terms, by the weights of the sums. */
static void curves_of_terms(System *s, const Batch *k)
{
    for (int j = 0; j < k->terms; j++) {
        const Batch *term = k - k->terms + j;
        if (!term->curved) continue;
        for (long i = 0; i < k->n; i++) term->weight[i] = k->factor[i * k->terms + j] * k->weight[i];
        term->tangent(term->n, term->pair, s->frames, term->P, term->weight, term->hessian);
        if (term->mapped) mapped_tangents(s, term, 0);
        else plain_curves(s, term);
    }
}

/* ---- all of it ---- */

/* The effort or reaction of item i in (1). */
static double pull_of(const System *s, const Batch *k, long i, const double *lam)
{
    if (k->role == ROW) return k->factor[i] * lam[k->row[i]];
    return k->role == LINEAR && s->led ? k->foretold[i] : k->effort[i];
}

/* The tangent of an effort or a reaction; ``geometric``: weight of its geometric stiffness. */
static int tangents(System *s, Batch *k, double cd, double ck, double geometric, const double *lam, double t)
{
    double *slope = 0;
    if (k->role == MOUNT) {
        mount_tangents(s, k, cd, ck, geometric);
        return DONE;
    }
    if (k->role == WHOLE) return whole_tangents(s, k, t);
    if (take_slopes(s, k, t)) return FAILED;
    if (k->role == LINEAR || k->role == LAW || k->role == FORMULA) {
        slope = k->slope;
        for (long i = 0; i < k->n; i++) slope[i] = ck * k->stiffness[i] + cd * k->damping[i];
    }

    int curved = k->curved && geometric != 0.0;
    for (long i = 0; i < k->n; i++) {
        k->weight[i] = geometric * pull_of(s, k, i, lam);
        k->across[i] = -1.0;
    }
    if (k->terms) {
        if (k->turning && geometric != 0.0) curves_of_terms(s, k);
        if (slope && k->mapped) mapped_squares(s, k, slope);
        else if (slope) plain_squares(s, k, slope);
        return DONE;
    }
    if (curved) k->tangent(k->n, k->pair, s->frames, k->P, k->weight, k->hessian);
    else if (k->curved) memset(k->hessian, 0, k->n * k->hessians * sizeof(double));
    if (!slope && !curved) return DONE;

    if (k->mapped) mapped_tangents(s, k, slope);
    else {
        if (slope) plain_squares(s, k, slope);
        plain_curves(s, k);
    }
    return DONE;
}

/* Whether some reaction of rigid bodies alone would move one so far that across it is a stiffness beside its inertia: of what is heavy on
   what is light. */
static int push_hard(const System *s, double ck, const double *lam)
{
    double *push = s->b;
    memset(push, 0, s->nu * sizeof(double));
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++)
        for (long i = 0; k->role == ROW && i < k->n; i++)
            for (int e = 0; e < k->live; e++) {
                const int at = k->at[i * k->live + e];
                if (at < s->nu) push[at] += fabs(k->factor[i] * lam[k->row[i]] * k->out[i * k->outputs + k->entry[e]]);
            }

    for (const Body *o = s->body; o < s->body + s->bodies; o++) {
        if (o->field || !o->inertia) continue;
        const double *pushed = push + o->at_u, *inertia = s->diagonal + o->at_u;
        double force = 0.0, least = inertia[D];
        for (int i = 0; i < D; i++) force = fmax(force, pushed[i]);
        for (int i = D; i < TWIST; i++) least = fmin(least, inertia[i]);
        if (ck * force > HARD * sqrt(least * o->mass)) return 1;
    }
    return 0;
}

/* The entries of the matrix; ``reactions``: which of these have a geometric stiffness. Of an imaginary part those of stiffness and
   damping alone. */
static int entries(System *s, const double *q, double cd, double ck, double geometric, const double *lam, int reactions, double t)
{
    int verdict, masses = cd == 0.0 && ck == 0.0; /* of a start: no stiffness */
    clear(s);
    s->links = 0;
    s->cd = cd;
    s->ck = ck;

    for (int b = 0; b < s->bodies; b++) {
        const Body *o = s->body + b;
        const double *R = s->frames + FRAME * b + TURN;
        if (o->field && field_block(s, o, R, q)) return NEWTON;
        if (o->field) continue;
        if (o->T) reduced_block(s, o, R, q + o->at_q, cd, ck);
        else if (o->inertia && !s->imaginary) rigid_block(s, o, R);
        if (o->told && (verdict = told_block(s, o, t))) return verdict;
    }
    if (reactions == HARD_PUSH) reactions = push_hard(s, ck, lam) ? EVERY_PUSH : NO_PUSH;

    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role == READ || k->role == TERM) continue;
        if (k->role == ROW && k->mapped && !s->imaginary) mapped_rows(s, k);
        else if (k->role == ROW && !s->imaginary) plain_rows(s, k);
        if ((k->role == ROW && reactions == NO_PUSH) || masses) continue;
        if ((verdict = tangents(s, k, cd, ck, geometric, lam, t))) return verdict;
    }
    for (Rod *k = s->rod; k < s->rod + s->rods && !masses; k++)
        if (rod_tangents(s, k, t, geometric)) return FAILED;
    return DONE;
}

/* The matrix and its factor; verdict of the factorisation. */
static int assemble(System *s, const double *q, double cd, double ck, double geometric, const double *lam, int reactions, double t)
{
    int verdict = entries(s, q, cd, ck, geometric, lam, reactions, t), masses = cd == 0.0 && ck == 0.0;
    if (verdict || (verdict = factor(s)) || masses || !s->linkable) return verdict;
    return link_efforts(s, &cd, &ck);
}

/* The same for complex weights, each by its two parts. */
int prepare_complex(System *s, const double *q, const double *cd, const double *ck, const double *lam, double t)
{
    s->imaginary = 1;
    int verdict = entries(s, q, cd[1], ck[1], ck[1], lam, NO_PUSH, t);
    s->imaginary = 0;
    memcpy(s->lossy, s->L, s->storage * sizeof(double));
    if (verdict || (verdict = entries(s, q, cd[0], ck[0], ck[0], lam, NO_PUSH, t))) return verdict;
    if ((verdict = factor_complex(s)) || !s->linkable) return verdict;
    return link_efforts(s, cd, ck);
}

/* The factor at the state evaluated last; without geometric stiffness, first that of reactions, where that makes the bodies' part
   indefinite (a large pull on a small inertia). That of parts which Python tells is theirs: lines that are pressed in large steps. */
int prepare(System *s, const double *q, double cd, double ck, const double *lam, int reactions, double t)
{
    s->held = 0;
    int verdict = assemble(s, q, cd, ck, ck, lam, reactions, t), told = 0;
    if (verdict == SINGULAR && reactions != NO_PUSH) verdict = assemble(s, q, cd, ck, ck, lam, NO_PUSH, t);
    if (verdict == SINGULAR) verdict = assemble(s, q, cd, ck, 0.0, lam, NO_PUSH, t);
    for (int b = 0; b < s->bodies; b++) told |= s->body[b].told != NULL;
    if (verdict != SINGULAR || !told || s->indefinite) return verdict;

    s->indefinite = 1;
    verdict = assemble(s, q, cd, ck, 0.0, lam, NO_PUSH, t);
    s->indefinite = 0;
    return verdict;
}

/* The twist of body k in a part of the solution in b, into x (like v, body axes). */
static void take_twist(const System *s, int k, int part, double *x)
{
    const double *u = s->b + part * (s->nu + s->rows) + s->body[k].at_u;
    memcpy(x + TWIST * k, u, D * sizeof(double));
    to_body(s->frames + FRAME * k + TURN, u + D, x + TWIST * k + D);
}

/* What a solution in b is of body k, into x (like v, body axes). */
static void take_body(System *s, int k, double *x)
{
    const Body *o = s->body + k;
    for (int part = 0; part < s->parts; part++) {
        const double *u = s->b + part * (s->nu + s->rows) + o->at_u;
        take_twist(s, k, part, x + part * s->nv);
        if (!o->field) memcpy(x + part * s->nv + o->at_v, u + TWIST, o->modes * sizeof(double));
    }
    if (o->field) field_increment(s, o, x);
}

/* The solution for the right-hand side in b, in its place, world axes. */
static void solve_core(System *s)
{
    solve_fronts(s, s->b);
    if (s->links) add_links(s, s->b);
}

/* The same as x (like v, body axes) and y. */
void solution(System *s, double *x, double *y)
{
    solve_core(s);
    for (int k = 0; k < s->bodies; k++) take_body(s, k, x);
    for (int part = 0; part < s->parts; part++)
        memcpy(y + part * s->rows, s->b + part * (s->nu + s->rows) + s->nu, s->rows * sizeof(double));
}

/* The same on one tree of fronts, which nothing couples with others; b is zero there then. */
void tree_solution(System *s, const Tree *t, double *x)
{
    for (int k = 0; k < t->fronts; k++) forward(s, s->front + t->front[k], s->b);
    for (int k = t->fronts - 1; k >= 0; k--) backward(s, s->front + t->front[k], s->b);
    if (s->links) add_links(s, s->b);
    for (int k = 0; k < t->bodies; k++) take_body(s, t->body[k], x);
    for (int k = 0; k < t->fronts; k++) {
        const Front *f = s->front + t->front[k];
        for (int i = 0; i < f->pivots; i++) s->b[f->unknown[i]] = 0.0;
    }
}

/* Frames whose columns of inertia leave out U: the moments of M U x dU go to them in a second solution, added to the first. */
static void sway(System *s, double *x, double *y)
{
    double *again = s->work + s->again, *more = again + s->parts * s->nv;
    memset(s->b, 0, s->parts * (s->nu + s->rows) * sizeof(double));
    for (int b = 0; b < s->bodies; b++) {
        const Body *o = s->body + b;
        if (o->field) field_sway(s, o, s->frames + FRAME * b + TURN, x);
    }
    solution(s, again, more);
    add(x, 1.0, again, s->parts * s->nv);
    add(y, 1.0, more, s->parts * s->rows);
}

/* x and y for the right-hand side in b, world axes; the nodes of fields have their forces times -scale. */
int with_fields(System *s, double scale, double *x, double *y, double t)
{
    int verdict, sways = 0;
    for (int b = 0; s->fields && b < s->bodies; b++) {
        const Body *o = s->body + b;
        if (!o->field) continue;
        if ((verdict = field_load(s, o, scale, t))) return verdict;
        sways |= o->field->sways;
    }
    solution(s, x, y);
    if (sways) sway(s, x, y);
    return DONE;
}

/* Newton's increment from -scale times the residuals evaluated last and the open constraints. */
int increment(System *s, double scale, double *x, double *y, double t)
{
    for (int i = 0; i < s->nu; i++) s->b[i] = -scale * s->residual[i];
    for (int i = 0; i < s->rows; i++) s->b[s->nu + i] = -s->gap[i];
    return with_all_rows(s, scale, x, y, t);
}

/* Rows of the constraints on the velocities as they stand, and the rates of what is prescribed where ``rates``, into slip. */
void slips(System *s, int rates)
{
    for (int i = 0; i < s->rows; i++) s->slip[i] = rates ? -s->motion_rate[i] : 0.0;
    for (const Body *o = s->body; s->fields && o < s->body + s->bodies; o++)
        for (int i = 0; o->field && i < o->field->frames; i++)
            s->slip[o->field->row + i] = s->velocity[o->at_u + TWIST + o->field->frame_slot[i]];

    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role != ROW) continue;
        if (rates && k->driven && !k->flow) {
            k->rates(k->n, k->pair, s->frames, k->P, s->motion_rate, k->out); /* of two the first alone */
            for (long i = 0; i < k->n; i++) s->slip[k->row[i]] += k->factor[i] * k->out[2 * i];
        }

        if (rates) k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
        const double *out = k->out;
        const int *at = k->at;
        for (long i = 0; i < k->n; i++, out += k->outputs, at += k->live) {
            if (rates && k->flow) s->slip[k->row[i]] += k->factor[i] * out[0]; /* the speed that it gives to bodies at rest */
            for (int e = 0; e < k->live; e++) s->slip[k->row[i]] += k->factor[i] * out[k->entry[e]] * s->velocity[at[e]];
        }
    }
}

/* The increment of the stabilised form: x and y close the constraints on velocities, ``closing`` those on positions. */
int stabilised(System *s, double scale, double damp, double *x, double *closing, double *y, double *none, double t)
{
    int verdict;
    slips(s, 1);
    for (int i = 0; i < s->nu; i++) s->b[i] = -scale * s->residual[i];
    for (int i = 0; i < s->rows; i++) s->b[s->nu + i] = -scale / damp * s->slip[i];
    if ((verdict = with_all_rows(s, scale, x, y, t))) return verdict;

    turn_velocity(s, x);
    slips(s, 0);
    memset(s->b, 0, s->nu * sizeof(double));
    for (int i = 0; i < s->rows; i++) s->b[s->nu + i] = -s->gap[i] - s->slip[i];
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++) /* rows on velocities have no g: the correction rolls */
        for (long i = 0; k->role == ROW && k->flow && i < k->n; i++) s->b[s->nu + k->row[i]] = 0.0;
    return with_all_rows(s, 0.0, closing, none, t);
}

/* Efforts of springs where an increment x, like v, leads from the state evaluated last. */
static void foretell(System *s, const double *x)
{
    int turned = 0;
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role != LINEAR || !(k->curved || k->turning)) continue;
        if (!turned) turn_velocity(s, x);
        turned = 1;
        const double *out = k->out;
        const int *at = k->at;

        for (long i = 0; i < k->n; i++, out += k->outputs, at += k->live) {
            double change = 0.0;
            for (int e = 0; e < k->live; e++) change += out[k->entry[e]] * s->velocity[at[e]];
            k->foretold[i] = k->effort[i] + k->slope[i] / s->ck * change;
        }
    }
}

/* Inertia along an entry of the velocities; of surfaces that of their bodies; the ground, behind all, does not move. */
static double inertia_of(const System *s, int at)
{
    int on = at - s->nu, surface = on / TWIST;
    if (on < 0) return s->diagonal[at];
    return surface < s->surfaces ? s->diagonal[s->body[s->surface[surface].body].at_u + on % TWIST] : INFINITY;
}

/* The largest entry of the geometric stiffness of item i for an effort. */
static double stiffness_across(const System *s, const Batch *k, long i, double effort)
{
    double found = 0.0;
    for (int j = 0; j < k->terms; j++)
        found = fmax(found, stiffness_across(s, k - k->terms + j, i, k->factor[i * k->terms + j] * effort));
    if (!k->curved) return found;
    k->tangent(1, k->pair + 2 * i, s->frames, k->P + i * k->width, &effort, k->hessian);
    for (int e = 0; e < k->curved; e++) found = fmax(found, fabs(k->hessian[k->curve[e]]));
    return found;
}

/* Share of an increment that a unit pull of item i across may make wrong; asked once of a matrix. */
static double misled_by_one(const System *s, const Batch *k, long i)
{
    if (k->across[i] >= 0.0) return k->across[i];
    double inertia = INFINITY;
    for (int e = 0; e < k->live; e++) inertia = fmin(inertia, inertia_of(s, k->at[i * k->live + e]));
    return k->across[i] = stiffness_across(s, k, i, 1.0) / inertia;
}

/* Share of an increment x that may be wrong since springs pull otherwise across, where it leads, than in the matrix. */
double other_pulls(System *s, const double *x)
{
    double worst = 0.0;
    foretell(s, x);
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role != LINEAR || !(k->curved || k->turning)) continue;

        for (long i = 0; i < k->n; i++) {
            const double pull = s->ck * k->foretold[i], other = fabs(pull - k->weight[i]);
            if (other > SAME_PULL * fabs(pull) && other > SAME_PULL * fabs(k->weight[i]))
                worst = fmax(worst, other * misled_by_one(s, k, i));
        }
    }
    return worst;
}

/* Whether slopes in the matrix misled at the last evaluation. */
int misled(const System *s)
{
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++)
        if (k->role == WHOLE && *k->astray) return 1;
    return 0;
}

/* The size of accelerations, as System.typical: of frames and modes the largest, of fields without a moving frame the root mean
   square. */
double typical(const System *s, const double *a)
{
    double found = largest_of(s->units, a, s->core);
    for (const Body *o = s->body; s->fields && o < s->body + s->bodies; o++)
        if (o->field && rests(o)) found = fmax(found, sqrt(dot(a + o->at_v, a + o->at_v, o->field->n) / o->field->n));
    return found;
}

/* New tangents of fields from the state evaluated last, where an increment x led, or where a step is predicted; see fields.py. */
int take_tangents(System *s, const double *x, int predicted, double t)
{
    for (const Body *o = s->body; o < s->body + s->bodies; o++) {
        if (!o->field) continue;
        memcpy(o->field->b, x + o->at_v, o->field->n * sizeof(double));
    }
    s->calls++;
    int told = s->python(FIELD_TANGENTS, predicted, t);
    return told == OUTSIDE ? NEWTON : told ? FAILED : DONE;
}
