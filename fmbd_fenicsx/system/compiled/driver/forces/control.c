/* Controllers with a continuous law: efforts u(t, y) along joint coordinates, of readings y that are coordinates, their rates and the
   motion of markers.

   C tells all y and Python all u in one call, where the first effort of an evaluation is asked for; the slopes du/dy likewise. An effort
   N = -u(t, y) answers to the coordinate that it acts on, which goes into the fronts, and to all else that is read: rows of links.c. */

/* The place of a reading in its frame, world axes. */
static void lever_of(const System *s, const Reading *r, double *lever)
{
    times(s->frames + FRAME * r->frame + TURN, r->arm, lever);
}

/* y, where frames are placed and the coordinates that are read have been told. */
const double *read_all(const System *s)
{
    const Controllers *c = s->controllers;
    for (const Reading *r = c->reading; r < c->reading + c->readings; r++) {
        const double *frame = s->frames + FRAME * r->frame;
        double *y = c->y + r->first, lever[D], R[D * D];
        if (r->what == COORDINATE || r->what == ITS_RATE) {
            const Batch *k = s->batch + r->batch;
            *y = r->what == ITS_RATE ? *k->rate : *k->s;
            continue;
        }

        if (r->what == ANGULAR) {
            memcpy(y, frame + SPIN, ROT * sizeof(double));
            continue;
        }

        if (r->what == TURNED_BY) {
            product(frame + TURN, r->turn, R);
            if (D == 2) *y = nearest_turn(atan2(R[2], R[0]), frame[FRAME - 1]);
            else memcpy(y, R, sizeof R);
            continue;
        }

        lever_of(s, r, lever);
        if (r->what == PLACE_OF) memcpy(y, frame, D * sizeof(double));
        else {
            spin(frame + SPIN, lever, y);
            memcpy(lever, frame + SPEED, D * sizeof(double));
        }
        add(y, 1.0, lever, D);
    }
    return c->y;
}

static int ask_control(System *s, int what, double t)
{
    s->calls++;
    return s->python(what, 0, t) ? FAILED : DONE;
}

/* The effort that slopes foretell from where they were taken. */
static double foretold_effort(const System *s, const Batch *k)
{
    const Controllers *c = s->controllers;
    const Act *o = k->act;
    double u = c->known_u[o->number];
    for (int i = 0; i < o->count; i++) u += o->slopes[i] * (c->y[o->first + i] - c->known_y[o->first + i]);
    return -u;
}

/* N of a batch that a controller acts on; ``aside``: at the s and s' of the batch in place of those that are told. */
int control_effort(System *s, Batch *k, double t)
{
    Controllers *c = s->controllers;
    const Act *o = k->act;
    if (!c->fresh || k->aside) {
        read_all(s);
        for (int i = 0; k->aside && i < o->count; i++)
            if (o->own[i]) c->y[o->first + i] = o->own[i] == OWN_RATE ? *k->rate : *k->s;
        const Batch *first = c->ahead < 0 || s->straight || k->aside ? NULL : s->batch + c->ahead;
        const double *ahead = first ? known_ahead(s, first, c->y, t) : NULL;
        if (ahead) memcpy(c->u, ahead, first->answers * sizeof(double));
        else if (!s->straight && ask_control(s, EFFORTS, t)) return FAILED;
        c->fresh = !k->aside;
        if (k->aside) c->sloped = 0;
    }

    *k->effort = s->straight ? foretold_effort(s, k) : -c->u[o->number];
    return DONE;
}

/* dN/ds and dN/ds' of what a controller acts on. */
static int control_slopes(System *s, Batch *k, double t)
{
    Controllers *c = s->controllers;
    const Act *o = k->act;
    if (c->sloped != s->evaluations && ask_control(s, EFFORT_SLOPES, t)) return FAILED;
    c->sloped = s->evaluations;
    *k->stiffness = *k->damping = 0.0;
    for (int i = 0; i < o->count; i++)
        if (o->own[i]) *(o->own[i] == OWN_RATE ? k->damping : k->stiffness) -= o->slopes[i];
    return DONE;
}

/* Where slopes were taken. */
static void keep_readings(const System *s, const Batch *k)
{
    const Controllers *c = s->controllers;
    const Act *o = k->act;
    memcpy(c->known_y + o->first, c->y + o->first, o->count * sizeof(double));
    c->known_u[o->number] = -*k->effort;
}

/* ``factor`` times the row by which number i of a reading answers to velocities, added to one as in links.c. */
static void add_answer(const System *s, const Reading *r, int i, double factor, double *row)
{
    double axis[D] = {0.0}, R[D * D], column[D], turning[ROT] = {0.0};
    if (r->what == COORDINATE || r->what == ITS_RATE) {
        const Batch *k = s->batch + r->batch;
        for (int e = 0; e < k->live; e++) row[k->at[e]] += factor * k->out[k->entry[e]];
        return;
    }

    if (r->frame == s->bodies) return; /* the ground */
    double *on = row + (r->frame < s->bodies ? s->body[r->frame].at_u : s->nu + TWIST * (r->frame - s->bodies - 1));
    if (r->what == ANGULAR || (r->what == TURNED_BY && D == 2)) {
        on[D + i] += factor;
        return;
    }

    if (r->what == TURNED_BY) { /* of the columns r of R: w x r */
        product(s->frames + FRAME * r->frame + TURN, r->turn, R);
        for (int j = 0; j < D; j++) column[j] = R[D * j + i % D];
        axis[i / D] = 1.0;
        moment(column, axis, turning);
    } else {
        lever_of(s, r, column);
        axis[i] = 1.0;
        moment(column, axis, turning);
        on[i] += factor;
    }
    add(on + D, factor, turning, ROT);
}

/* Rows of what an effort pushes on and of all else that it answers to, into links.c; whether it answers to anything. */
static int control_link(const System *s, const Batch *k, double *push, double *pull)
{
    const long wide = s->nu + TWIST * s->surfaces + 1;
    const Act *o = k->act;
    int answers = 0;
    memset(push, 0, wide * sizeof(double));
    memset(pull, 0, wide * sizeof(double));
    for (int e = 0; e < k->live; e++) push[k->at[e]] += k->out[k->entry[e]];

    for (const Reading *r = s->controllers->reading; r < s->controllers->reading + s->controllers->readings; r++) {
        const int from = r->first - o->first, fast = r->what == ITS_RATE || r->what == VELOCITY_OF || r->what == ANGULAR;
        for (int i = 0; from >= 0 && from < o->count && i < r->count; i++) {
            const double slope = -(fast ? s->cd : s->ck) * o->slopes[from + i];
            if (o->own[from + i] || slope == 0.0) continue;
            add_answer(s, r, i, slope, pull);
            answers = 1;
        }
    }
    return answers;
}
