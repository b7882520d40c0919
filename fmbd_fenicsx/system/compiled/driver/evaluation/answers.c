/* The parts of an evaluation that Python asks for, of one configuration or of many: a row of numbers for each. Vectors are like v:
   rotations in body axes. */


/* Numbers that a sample writes. */
long sample_size(const System *s)
{
    long n = 0;
    for (int i = 0; i < s->timed; i++) n += s->timed_size[i];
    return n;
}

/* What was sampled last into ``kept``, or back to where it belongs. */
void keep_sample(const System *s, double *kept, int back)
{
    for (int i = 0; i < s->timed; kept += s->timed_size[i++])
        if (back) memcpy(s->timed_at[i], kept, s->timed_size[i] * sizeof(double));
        else memcpy(kept, s->timed_at[i], s->timed_size[i] * sizeof(double));
}

/* What was sampled at t back to where it belongs, and ports that move to where they are then. */
int recall_sample(System *s, double *kept, double t)
{
    int verdict = s->fields ? move_ports(s, t) : DONE;
    if (!verdict && s->samples) keep_sample(s, kept, 1);
    return verdict;
}

/* What depends on time only, at t; ``last``: whose sample stands where it belongs. */
int sample(System *s, double t, double *last)
{
    int verdict = s->fields ? move_ports(s, t) : DONE;
    if (verdict || !s->samples || t == *last) return verdict;
    const long size = sample_size(s);
    for (int i = 0; s->recalls == ANEW && i < RECENT; i++) s->recent_at[i] = NAN;
    if (s->recalls) s->recalls = RECALLS;
    for (int i = 0; s->recalls && i < RECENT; i++)
        if (s->recent_at[i] == t) {
            keep_sample(s, s->recent + i * size, 1);
            *last = t;
            return DONE;
        }

    s->calls++;
    if (s->python(SAMPLE, WHOLE_SAMPLE, t)) return FAILED;
    *last = t;
    if (s->recalls) {
        s->newest = (s->newest + 1) % RECENT;
        s->recent_at[s->newest] = t;
        keep_sample(s, s->recent + s->newest * size, 0);
    }
    return DONE;
}

/* The residual evaluated last, in the order of the unknowns and in world axes, as an array like v. */
void like_v(const System *s, const double *u, double *x)
{
    for (int k = 0; k < s->bodies; k++) {
        const Body *o = s->body + k;
        memcpy(x + TWIST * k, u + o->at_u, D * sizeof(double));
        to_body(s->frames + FRAME * k + TURN, u + o->at_u + D, x + TWIST * k + D);
        if (o->field) { /* the forces on its nodes, and what acts on its columns */
            memcpy(x + o->at_v, o->field->force, o->field->n * sizeof(double));
            add_columns(o, u + o->at_u + TWIST, x + o->at_v);
        } else memcpy(x + o->at_v, u + o->at_u + TWIST, o->modes * sizeof(double));
    }
}

/* Kinetic, elastic, of the full weight and of springs. */
EXPORT int driver_energies(System *s, long count, const double *t, const double *q, const double *v, double *out)
{
    double last = NAN;
    int verdict;
    for (long i = 0; i < count; i++, q += s->nq, v += s->nv, out += 4) {
        if ((verdict = sample(s, t[i], &last)) || (verdict = place(s, q, v))) return verdict;
        energies(s, t[i], q, v, s->rest_gravity, out);
    }
    return DONE;
}

/* What the ports of a surface that move along its body add to one number of its twist. */
static double carried(const System *s, const Surface *o, int i)
{
    const Body *body = s->body + o->body;
    const Field *e = body->field;
    return e && e->drift ? dot(o->map + i * (TWIST + body->modes) + TWIST, e->moved, body->modes) : 0.0;
}

/* What surfaces that move in their bodies add to what of the rates of rows depends on time only, and to the second derivatives, at
   constant twists of the bodies. */
static void biases(const System *s, const Batch *k, double *partial, double *second)
{
    const double *out = k->out;
    const int *at = k->at;
    k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
    for (long i = 0; i < k->n; i++, out += k->outputs, at += k->live)
        for (int e = 0; e < k->live; e++) {
            int on = at[e] - s->nu, surface = on / TWIST;
            if (on < 0 || surface >= s->surfaces) continue; /* the ground is behind all */
            const double share = k->factor[i] * out[k->entry[e]];
            partial[k->row[i]] += share * carried(s, s->surface + surface, on % TWIST);
            second[k->row[i]] += share * s->surface[surface].bias[on % TWIST];
        }
}

/* What of the rates of the constraints depends on time only, and their second derivatives at constant twists. */
void derivatives_in_time(System *s, double *partial, double *second)
{
    for (int i = 0; i < s->rows; i++) partial[i] = -s->motion_rate[i];
    for (int i = 0; i < s->rows; i++) second[i] = -s->motion_second[i];
    for (int i = 0; i < s->surfaces; i++) surface_bias(s, i);
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role != ROW) continue;
        k->rates(k->n, k->pair, s->frames, k->P, 0, k->out);

        for (long i = 0; i < k->n; i++) {
            partial[k->row[i]] += k->factor[i] * k->out[2 * i];
            second[k->row[i]] += k->factor[i] * k->out[2 * i + 1];
        }
        if (k->mapped) biases(s, k, partial, second);
    }
}

/* Of every configuration the ``sums`` of M a + h + G^T lambda, and of every constraint g, its rate G v + g_t, g_t, and g'' less G a;
   sums or gap may be NULL, where nobody asks for them, and lam. */
EXPORT int driver_batch(System *s, long count, const double *t, const double *q, const double *v, const double *a, const double *lam,
                        double *sums, double *gap, double *slip, double *partial, double *second)
{
    double *none = s->work, last = NAN;
    int verdict = sums ? foretell_points(s, count, t, 1, q, NULL, v, a, NULL) : DONE;
    if (verdict) return verdict;
    if (sums && !lam) memset(none, 0, s->rows * sizeof(double));

    for (long i = 0; i < count; i++, q += s->nq, v += s->nv) {
        const long at = i * s->rows, on = i * s->nv;
        if ((verdict = sample(s, t[i], &last))) return verdict;
        verdict = sums ? evaluate(s, q, v, a + on, lam ? lam + at : none, t[i]) : place(s, q, v);
        if (verdict) return verdict;

        if (sums) like_v(s, s->residual, sums + on);
        if (!gap) continue;
        derivatives_in_time(s, partial + at, second + at);
        drift(s);
        memcpy(gap + at, s->gap, s->rows * sizeof(double));
        memcpy(slip + at, s->slip, s->rows * sizeof(double));
    }
    return DONE;
}

EXPORT int driver_balances(System *s, long count, const double *t, const double *q, const double *v, const double *a,
                           const double *lam, double *sums)
{
    return driver_batch(s, count, t, q, v, a, lam, sums, NULL, NULL, NULL, NULL);
}

EXPORT int driver_constraints(System *s, long count, const double *t, const double *q, const double *v, double *gap, double *slip,
                              double *partial, double *second)
{
    return driver_batch(s, count, t, q, v, NULL, NULL, NULL, gap, slip, partial, second);
}

/* The work of force elements in a state along an increment xi, like v. */
EXPORT int driver_work(System *s, double t, const double *q, const double *v, const double *xi, double *work)
{
    double last = NAN, *none = s->work;
    int verdict = sample(s, t, &last);
    if (verdict || (verdict = place(s, q, v))) return verdict;
    memset(none, 0, s->rows * sizeof(double));
    memset(s->residual, 0, s->nu * sizeof(double));
    if ((verdict = acting(s, none, t))) return verdict;
    turn_velocity(s, xi);
    *work = -dot(s->residual, s->velocity, s->nu);
    return DONE;
}

/* What judges ask of a state: ``found`` has the largest open constraint, the largest rate at which one opens, the largest of what of
   these depends on time only, as lengths by ``units``; how far places are from the origin; the largest velocity, acceleration and
   multiplier. ``energy``: 4, and ``sums`` of the balance, where asked for, else NULL; ``room``: 2 rows. */
EXPORT int driver_look(System *s, double t, double length, const double *units, const double *q, const double *v, const double *a,
                       const double *lam, double *found, double *energy, double *sums, double *room)
{
    double last = NAN;
    int verdict = sample(s, t, &last);
    if (verdict || (verdict = sums ? evaluate(s, q, v, a, lam, t) : place(s, q, v))) return verdict;

    if (sums) like_v(s, s->residual, sums);
    derivatives_in_time(s, room, room + s->rows);
    drift(s);
    found[0] = largest_of(units, s->gap, s->rows);
    found[1] = largest_of(units, s->slip, s->rows);
    found[2] = largest_of(units, room, s->rows);
    found[3] = far_from_origin(s, q, length);
    found[4] = largest_of(s->units, v, s->nv);
    found[5] = largest_of(s->units, a, s->nv);
    found[6] = largest_of(s->multiplier_units, lam, s->rows);
    if (energy) energies(s, t, q, v, s->rest_gravity, energy);
    return DONE;
}

/* ``factor`` times a row on the rates of a body, its twist in world axes first, into one like v; the rates are lost. */
static void add_row(const System *s, int body, double *rates, int modes, double factor, double *row)
{
    const Body *o = s->body + body;
    double turning[ROT];
    to_body(s->frames + FRAME * body + TURN, rates + D, turning);
    add(row + TWIST * body, factor, rates, D);
    add(row + TWIST * body + D, factor, turning, ROT);
    if (!o->field) add(row + o->at_v, factor, rates + TWIST, modes);
    else if (modes) { /* what acts on its columns */
        for (int i = 0; i < modes; i++) rates[TWIST + i] *= factor;
        add_columns(o, rates + TWIST, row + o->at_v);
    }
}

/* The row of one item, as its kernel left it, on the rates of the body of one of its frames, into s->big; how many, 0: the ground. */
int side_row(System *s, const Batch *k, long i, int side, int *body)
{
    const double *map;
    const int frame = k->pair[k->sides * i + side], width = side_map(s, frame, &map);
    double y[TWIST];
    row_of_side(k, i, side, y);
    if (width) through(map, width, y, s->big);
    *body = map ? s->surface[frame - s->bodies - 1].body : frame;
    return width;
}

/* ``factor`` times the row of one item, as its kernel left it, added to one like v. */
void item_row(System *s, const Batch *k, long i, double factor, double *row)
{
    for (int side = 0; side < k->sides; side++) {
        int body, width = side_row(s, k, i, side, &body);
        if (width) add_row(s, body, s->big, width - TWIST, factor * k->factor[i], row);
    }
}

/* The row of an effort, added likewise. */
void effort_row(System *s, const Batch *k, long i, double *row)
{
    for (int side = 0; side < k->sides; side++) {
        int body, width = side_row(s, k, i, side, &body);
        if (width) add_row(s, body, s->big, width - TWIST, 1.0, row);
    }
}

/* Rows of the constraints of one batch into G, rows x nv; with multipliers their sum G^T mu instead, nv. */
static void add_rows(System *s, const Batch *k, const double *mu, double *G)
{
    for (long i = 0; i < k->n; i++) {
        int number = k->row[i];
        item_row(s, k, i, mu ? mu[number] : 1.0, mu ? G : G + (long)number * s->nv);
    }
}

/* G, or G^T mu, where frames are placed. */
void all_rows(System *s, const double *mu, double *G)
{
    memset(G, 0, (size_t)(mu ? 1 : s->rows) * s->nv * sizeof(double));
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role != ROW) continue;
        k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
        add_rows(s, k, mu, G);
    }
}

/* G of every configuration, rows x nv. */
EXPORT int driver_rows(System *s, long count, const double *t, const double *q, const double *v, double *G)
{
    double last = NAN;
    long size = (long)s->rows * s->nv;
    int verdict;
    for (long i = 0; i < count; i++, q += s->nq, v += s->nv, G += size) {
        if ((verdict = sample(s, t[i], &last)) || (verdict = place(s, q, v))) return verdict;
        all_rows(s, NULL, G);
    }
    return DONE;
}

/* A part of a right-hand side on the nodes of fields, which stand behind the frames in b: whether there is any. */
static int load_nodes(System *s, const double *b, int part)
{
    int loaded = 0;
    for (int k = 0; s->fields && k < s->bodies; k++) {
        const Body *o = s->body + k;
        if (!o->field) continue;

        double *force = o->field->force + part * o->field->n;
        memset(s->b + part * (s->nu + s->rows) + o->at_u + TWIST, 0, o->modes * sizeof(double));
        for (long i = 0; i < o->field->n; i++) {
            force[i] = -b[o->at_v + i];
            loaded |= force[i] != 0.0;
        }
    }
    return loaded;
}

/* x and y for right-hand sides b and c, each so many rows, with the factor of this configuration; of complex ones the real parts
   stand in a row before the imaginary ones. */
EXPORT int driver_solve(System *s, long count, const double *q, const double *b, const double *c, double *x, double *y)
{
    int verdict = DONE, failed;
    for (long i = 0; i < count; i++, x += s->parts * s->nv, y += s->parts * s->rows) {
        int loaded = 0;
        double *to = s->b;
        for (int part = 0; part < s->parts; part++, to += s->nu + s->rows, b += s->nv, c += s->rows) {
            int placed = place(s, q, b);
            if (placed) verdict = placed;
            memcpy(to, s->velocity, s->nu * sizeof(double));
            memcpy(to + s->nu, c, s->rows * sizeof(double));
            loaded |= load_nodes(s, b, part);
        }

        if ((failed = with_all_rows(s, loaded, x, y, 0.0))) return failed;
    }
    return verdict;
}

/* A right-hand side on the core, like its velocities, with what the factors of fields have found of theirs. */
static void load_core(System *s, const double *b, const double *pz)
{
    memset(s->b, 0, (s->nu + s->rows) * sizeof(double));
    for (int k = 0; k < s->bodies; k++) {
        const Body *o = s->body + k;
        double *to = s->b + o->at_u;
        memcpy(to, b + TWIST * k, D * sizeof(double));
        to_world(s->frames + FRAME * k + TURN, b + TWIST * k + D, to + D);

        if (!o->field) memcpy(to + TWIST, b + o->at_v, o->modes * sizeof(double));
        else {
            memcpy(o->field->pz, pz + o->field->column, o->field->solved * sizeof(double));
            condense(s, o);
        }
    }
}

/* Answers to ``count`` right-hand sides with the factor of this configuration: b on the core, like its velocities, and on nodes, of which
   the factors of the fields, in the order of their numbers, have found H^T z = pz, in their axes, of so many ``columns``; into x what
   the core does, into f what acts on the columns. */
EXPORT int driver_columns(System *s, long count, long columns, const double *q, const double *still, const double *b, const double *pz,
                          double *x, double *f)
{
    int verdict = place(s, q, still);
    for (long i = 0; i < count; i++, b += s->core, x += s->core, pz += columns, f += columns) {
        load_core(s, b, pz);
        solve_core(s);

        for (int k = 0; k < s->bodies; k++) {
            const Body *o = s->body + k;
            take_twist(s, k, 0, x);
            if (!o->field) memcpy(x + o->at_v, s->b + o->at_u + TWIST, o->modes * sizeof(double));
            else {
                field_answers(s, o);
                memcpy(f + o->field->column, o->field->f, o->field->solved * sizeof(double));
            }
        }
    }
    return verdict;
}

/* Geometry of many increments. ``step``: numbers from one row of an array to the next, 0 where one row serves all.

   q0 o exp(xi): */
EXPORT int driver_compose(System *s, long count, const double *q0, long step, const double *xi, long xi_step, double *q)
{
    const int free = turns_freely(s);
    int verdict = DONE;
    for (long i = 0; i < count && !verdict; i++, q += s->nq) {
        configuration(s, q0 + i * step, xi + i * xi_step, q);
        if (free && !(verdict = place(s, q, xi + i * xi_step))) settle_angles(s, q);
    }
    return verdict;
}

/* xi with q0 o exp(xi) = q1, of all rotations those nearest to the ones of ``near``, or (NULL) the smallest. */
EXPORT void driver_difference(const System *s, long count, const double *q0, long step, const double *q1, long end_step,
                              const double *near, long near_step, double *xi)
{
    int frames = TWIST * s->bodies, poses = POSE * s->bodies + s->angles;
    for (long i = 0; i < count; i++, xi += s->nv) {
        const double *from = q0 + i * step, *to = q1 + i * end_step, *guess = near ? near + i * near_step : NULL;
        for (int b = 0; b < s->bodies; b++)
            pose_difference(from + POSE * b, to + POSE * b, guess ? guess + TWIST * b : NULL, xi + TWIST * b);
        for (int k = frames, j = poses; k < s->nv; k++, j++) xi[k] = to[j] - from[j];
    }
}

/* The rates of local coordinates xi for the velocities v. */
EXPORT void driver_rate(const System *s, long count, const double *xi, long step, const double *v, long v_step, double *rates)
{
    for (long i = 0; i < count; i++, rates += s->nv) {
        memcpy(rates, v + i * v_step, s->nv * sizeof(double));
        for (int b = 0; b < s->bodies; b++) rate_of(xi + i * step + TWIST * b, rates + TWIST * b);
    }
}
