/* State in, everything out: frames -> kernels of every kind -> residual, open constraints, entries of the matrix. */

/* Frames of bodies and surfaces, and all velocities in world axes. */
int place(System *s, const double *q, const double *v)
{
    s->q = q;
    if (s->controllers) s->controllers->fresh = 0;
    for (int b = 0; b < s->bodies; b++) {
        const double *pose = q + POSE * b, *twist = v + TWIST * b;
        const Body *o = s->body + b;
        double *x = s->frames + FRAME * b, *velocity = s->velocity + o->at_u;
        memcpy(x, pose, D * sizeof(double));
        rotation(pose, x + TURN);
        memcpy(x + SPEED, twist, D * sizeof(double));
        to_world(x + TURN, twist + D, x + SPIN);

#if DIM == 2
        x[FRAME - 1] = pose[2];
#endif
        memcpy(velocity, x + SPEED, TWIST * sizeof(double));
        if (o->field) field_columns(o, q, v);
        memcpy(velocity + TWIST, o->field ? o->field->rates : v + o->at_v, o->modes * sizeof(double));
    }
    for (Batch *k = s->batch; k < s->batch + s->batches; k++)
        for (long i = 0; k->theta && i < k->n; i++) k->P[i * k->width + k->near] = q[k->theta[i]];

    for (int k = 0; k < s->surfaces; k++) {
        int verdict = place_surface(s, k, q);
        if (verdict) return verdict;
    }

#if DIM == 2
    for (int i = 0; i < s->angles; i++) { /* surfaces that turn as a whole are known up to whole turns */
        const Angle *o = s->angle + i;
        double *a = s->frames + FRAME * (o->a + 1) - 1, *b = s->frames + FRAME * (o->b + 1) - 1, near = q[POSE * s->bodies + i];
        double turns = nearest_turn(*b - *a - o->zero, near) - (*b - *a - o->zero);
        if (o->b > s->bodies) *b += turns;
        else *a -= turns;
    }
#endif
    return DONE;
}

/* An array like v into s->velocity, in world axes, that of surfaces behind the bodies'; frames are placed. */
void turn_velocity(System *s, const double *v)
{
    for (int b = 0; b < s->bodies; b++) {
        const Body *o = s->body + b;
        double *to = s->velocity + o->at_u;
        memcpy(to, v + TWIST * b, D * sizeof(double));
        to_world(s->frames + FRAME * b + TURN, v + TWIST * b + D, to + D);
        if (o->field) field_rates(o, v);
        memcpy(to + TWIST, o->field ? o->field->rates : v + o->at_v, o->modes * sizeof(double));
    }

    for (int i = 0; i < s->surfaces; i++) {
        const Surface *k = s->surface + i;
        const Body *o = s->body + k->body;
        for (int j = 0; j < TWIST; j++)
            s->velocity[s->nu + TWIST * i + j] = dot(k->map + j * (TWIST + o->modes), s->velocity + o->at_u, TWIST + o->modes);
    }
}

/* Coordinates s, rates s' and efforts that are linear in them. */
static void coordinates(const System *s, const Batch *k)
{
    const double *out = k->out;
    const int *at = k->at;
    for (long i = 0; i < k->n; i++, out += k->outputs, at += k->live) {
        double rate = 0.0;
        for (int e = 0; e < k->live; e++) rate += out[k->entry[e]] * s->velocity[at[e]];
        k->s[i] = out[0];
        k->rate[i] = rate;
        if (k->role == LINEAR || k->role == READ) k->effort[i] = k->stiffness[i] * (out[0] - k->free[i]) + k->damping[i] * rate;
    }
}

/* Whether a law in Python is asked where points of a step are evaluated. */
static int asks_ahead(const System *s, const Batch *k) { return k->ahead && (s->bent || !is_held(s, k)); }

/* What laws in Python see at point j. */
static void note_point(System *s, long j, double t)
{
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->told) values(s, k), coordinates(s, k);
        if (!asks_ahead(s, k)) continue;
        double *x = k->ahead + j * (1 + k->sees + k->answers);
        x[0] = t;
        if (k->role == WHOLE) {
            whole_sights(s, k);
            memcpy(x + 1, k->sight, k->sees * sizeof(double));
            continue;
        }
        if (!k->act) values(s, k), coordinates(s, k);
        memcpy(x + 1, k->act ? read_all(s) : k->s, k->sees * sizeof(double));
    }
}

/* The answers of laws in Python to what they see now, where these have been asked for ahead, else NULL. */
const double *known_ahead(const System *s, const Batch *k, const double *seen, double t)
{
    const double *x = k->ahead;
    for (int j = 0; s->evaluations <= k->known_to && j < k->points; j++, x += 1 + k->sees + k->answers)
        if (x[0] == t && !memcmp(x + 1, seen, k->sees * sizeof(double))) return x + 1 + k->sees;
    return NULL;
}

/* Ask once each for what parts and laws in Python do at many points, q o exp(xi), one q for all or ``each`` its own (xi NULL): the
   evaluations of these follow. Parts that act by accelerations are left out where these are not known (a NULL). ``room``: nq, NULL
   without xi. */
int foretell_points(System *s, long count, const double *t, int each, const double *q, const double *xi, const double *v, const double *a,
                    double *room)
{
    int verdict = DONE, laws = 0;
    if (count < 2 || count > MOST_STAGES) return DONE;
    for (const Body *o = s->body; a && o < s->body + s->bodies && !verdict; o++)
        if (o->told && o->told->ahead) verdict = foretell_part(s, o, count, t, each, q, xi, v, a);
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++) laws += asks_ahead(s, k);

    for (long j = 0; laws && j < count && !verdict; j++) {
        const double *there = q + each * j * s->nq;
        if (xi) configuration(s, q, xi + j * s->nv, room), there = room;
        if (place(s, there, v + j * s->nv)) return DONE; /* whoever evaluates the point says why */
        note_point(s, j, t[j]);
    }

    for (Batch *k = s->batch; k < s->batch + s->batches && !verdict; k++) {
        if (!asks_ahead(s, k)) continue;
        s->calls++;
        if (s->python(k->role == WHOLE ? WRENCHES_AHEAD : EFFORTS_AHEAD, k->number, count)) return FAILED;
        k->known_to = s->evaluations + count;
        k->points = (int)count;
    }
    return verdict;
}

/* Forces of inertia and weight, and those within bodies. */
int body_forces(System *s, const double *q, const double *v, const double *a, double t)
{
    int verdict = DONE;
    for (int b = 0; b < s->bodies; b++) {
        const Body *o = s->body + b;
        const double *R = s->frames + FRAME * b + TURN, *w = v + TWIST * b + D, *accel = a + TWIST * b;
        double *f = s->residual + o->at_u;
        int found = DONE;

        if (o->field) {
            memset(f + TWIST, 0, o->modes * sizeof(double));
            found = field_force(s, b, q, v, a, f, t);
        } else if (o->T) found = reduced_force(o, R, q, v, a, w, s->gravity, accel, f, f + TWIST);
        else if (o->inertia) rigid_force(o, R, w, accel, s->gravity, f);
        else memset(f, 0, TWIST * sizeof(double));

        if (o->told) found = told_force(s, b, q, v, a, f, t);
        if (found == FAILED) return FAILED;
        if (found) verdict = found;
    }
    return verdict;
}

/* These, and those within rods. */
int inertia(System *s, const double *q, const double *v, const double *a, double t)
{
    int verdict = body_forces(s, q, v, a, t);
    if (verdict == FAILED) return FAILED;
    for (Rod *k = s->rod; k < s->rod + s->rods; k++)
        if (rod_forces(s, k, t)) return FAILED;
    return verdict;
}

/* N of a batch at its s and s'. */
static int law_of_state(System *s, Batch *k, const void *none, double t)
{
    (void)none;
    for (long i = 0; k->role == FORMULA && i < k->n; i++) formula(k, i, t);
    if (k->role != LAW) return DONE;
    if (k->act) return control_effort(s, k, t);
    const double *ahead = known_ahead(s, k, k->s, t); /* s' stands behind s */
    if (ahead) {
        memcpy(k->effort, ahead, k->n * sizeof(double));
        return DONE;
    }
    s->calls++;
    return s->python(EFFORT, k->number, t) ? FAILED : DONE;
}

/* N of laws by their slopes where these were taken. */
static int along_tangents(System *s, Batch *k, double t)
{
    if (k->act) return control_effort(s, k, t);
    for (long i = 0; i < k->n; i++) {
        const double *known = k->known + 3 * i;
        k->effort[i] = known[2] + k->stiffness[i] * (k->s[i] - known[0]) + k->damping[i] * (k->rate[i] - known[1]);
    }
    return DONE;
}

/* Slopes of laws at the state evaluated last, those in Python by a call, and where they were taken. */
int take_slopes(System *s, Batch *k, double t)
{
    if (k->role == WHOLE) return take_whole_slopes(s, k, t);
    if ((k->role != LAW && k->role != FORMULA) || is_held(s, k)) return DONE;
    if (k->role == LAW && k->sloped != s->evaluations && ask_slopes(s, k, t)) return FAILED;
    if (k->act) keep_readings(s, k);
    for (long i = 0; i < k->n; i++) {
        double *known = k->known + 3 * i;
        known[0] = k->s[i], known[1] = k->rate[i], known[2] = k->effort[i];
    }
    return DONE;
}

/* Efforts that are unknowns, in place of those of the state. */
static void give_efforts(const System *s, Batch *k)
{
    const Ties *o = s->ties;
    const long b = k - s->batch;
    for (int j = o->start[b]; j < o->start[b + 1]; j++) k->effort[o->item[j]] = o->efforts[o->number[j]];
}

/* Coordinates s, rates s' and efforts of a batch; what a law in Python gives comes with one call for all items. */
int efforts(System *s, Batch *k, double t)
{
    coordinates(s, k);
    if (s->ties) give_efforts(s, k);
    const int law = k->role == FORMULA || k->role == LAW;
    if (s->straight && law && !is_held(s, k)) return along_tangents(s, k, t);
    return law ? ask_iterate(s, k, law_of_state, NULL, t) : DONE;
}

int items(System *s, Batch *k, const double *lam, double t)
{
    if ((k->role == READ && !k->told) || k->role == TERM) return DONE;
    if (k->role == MOUNT) {
        mount_forces(s, k);
        return DONE;
    }
    if (k->role == WHOLE) return whole_forces(s, k, t);
    values(s, k);
    if (k->role == READ || k->role == LINEAR || k->role == LAW || k->role == FORMULA) {
        int verdict = efforts(s, k, t);
        if (verdict || k->role == READ) return verdict;
    }

    const double *out = k->out;
    const int *at = k->at;
    for (long i = 0; i < k->n; i++, out += k->outputs, at += k->live) {
        double force;
        if (k->role == ROW) {
            double open = k->flow ? s->share * out[0] : out[0];
            for (int e = 0; k->flow && e < k->live; e++) open += s->share * out[k->entry[e]] * s->velocity[at[e]];
            s->gap[k->row[i]] += k->factor[i] * open;
            force = k->factor[i] * lam[k->row[i]];
        } else force = k->effort[i];

        for (int e = 0; e < k->live; e++) s->residual[at[e]] += force * out[k->entry[e]];
    }
    return DONE;
}

/* What constraints and efforts do, added to the forces of inertia and to those within bodies; open constraints. */
int acting(System *s, const double *lam, double t)
{
    int verdict;
    memset(s->residual + s->nu, 0, TWIST * s->surfaces * sizeof(double));
    for (int i = 0; i < s->rows; i++) s->gap[i] = -s->motion[i];

    for (Batch *k = s->batch; k < s->batch + s->batches; k++)
        if ((verdict = items(s, k, lam, t))) return verdict;

    for (int b = 0; s->fields && b < s->bodies; b++)
        if (s->body[b].field) frame_conditions(s, s->body + b, lam);

    for (int i = 0; i < s->surfaces; i++) {
        const Surface *k = s->surface + i;
        const Body *o = s->body + k->body;
        const double *wrench = s->residual + s->nu + TWIST * i;
        for (int j = 0; j < TWIST; j++) add(s->residual + o->at_u, wrench[j], k->map + j * (TWIST + o->modes), TWIST + o->modes);

        /* the stress of forces on surfaces whose ports are of second order is part of the tangent */
        for (int r = 0; r < k->bends; r++) {
            double pull = 0.0;
            for (int j = 0; j < TWIST; j++) pull -= wrench[j] * k->bend_map[k->bends * j + r];
            add(o->now, pull, k->G + r * o->modes * o->modes, o->modes * o->modes);
        }
    }
    return DONE;
}

/* Residuals of the balance (bodies' blocks, world axes) and open constraints at a state. */
int evaluate(System *s, const double *q, const double *v, const double *a, const double *lam, double t)
{
    int verdict = s->fields ? move_ports(s, t) : DONE, looked;
    if (verdict) return verdict;
    verdict = place(s, q, v);
    s->evaluations++;
    if (verdict) return verdict;
    looked = inertia(s, q, v, a, t);
    if (looked == FAILED) return FAILED;
    return (verdict = acting(s, lam, t)) ? verdict : looked;
}

/* The same at an iterate of a step after ``done`` increments, with what the iterate before tells of elements. */
int evaluate_iterate(System *s, int done, const double *q, const double *v, const double *a, const double *lam, double t)
{
    s->iterate = done ? FOLLOWING : FIRST;
    s->bridged = 0;
    int verdict = evaluate(s, q, v, a, lam, t);
    s->iterate = ON_ITS_OWN;
    return verdict;
}
