/* A state as one block of numbers, and its energies: t, q (nq), v (nv), a (nv), A (nv), lambda (rows). */

/* A counted angle: that of the attitude of both frames nearest to an estimate. */
static double counted(const Angle *o, const double *frame_a, const double *frame_b, double near)
{
#if DIM == 3
    double fa[3], ga[3], fb[3], gb[3];
    times(frame_a + TURN, o->fa, fa);
    times(frame_a + TURN, o->ga, ga);
    times(frame_b + TURN, o->fb, fb);
    times(frame_b + TURN, o->gb, gb);
    return nearest_turn(atan2(dot(ga, fb, 3) - dot(fa, gb, 3), dot(fa, fb, 3) + dot(ga, gb, 3)), near);
#else
    return nearest_turn(frame_b[FRAME - 1] - frame_a[FRAME - 1] - o->zero, near);
#endif
}

/* Counted angles: on with the increments of both frames, by any number of turns, then to the nearest angle of the attitude; those of
   surfaces without a frame wait for these to be placed. */
static void count_angles(const System *s, const double *q0, const double *xi, double *q)
{
    for (int i = 0; i < s->angles; i++) {
        const Angle *o = s->angle + i;
        double ahead = q0[POSE * s->bodies + i], *theta = q + POSE * s->bodies + i;
        int frame[2] = {o->a, o->b};
        double at[2][FRAME] = {{0.0}};
        for (int side = 0; side < 2; side++) {
            int b = frame[side];
            double sign = side ? 1.0 : -1.0;
            for (int k = 0; k < D; k++) at[side][TURN + (D + 1) * k] = 1.0; /* the ground */
            if (b >= s->bodies) continue;

#if DIM == 3
            ahead += sign * dot(side ? o->eb : o->ea, xi + TWIST * b + D, 3);
#else
            ahead += sign * xi[TWIST * b + D];
#endif
            if (!o->free) rotation(q + POSE * b, at[side] + TURN);
        }
        *theta = o->free ? ahead : counted(o, at[0], at[1], ahead);
    }
}

int turns_freely(const System *s)
{
    for (int i = 0; i < s->angles; i++)
        if (s->angle[i].free) return 1;
    return 0;
}

/* Those of surfaces without a frame; frames are placed. */
void settle_angles(const System *s, double *q)
{
    for (int i = 0; i < s->angles; i++) {
        const Angle *o = s->angle + i;
        double *theta = q + POSE * s->bodies + i;
        if (o->free) *theta = counted(o, s->frames + FRAME * o->a, s->frames + FRAME * o->b, *theta);
    }
}

/* q = q0 o exp(xi), as system/configurations.py. */
void configuration(const System *s, const double *q0, const double *xi, double *q)
{
    int poses = POSE * s->bodies + s->angles;
    for (int b = 0; b < s->bodies; b++) compose(q0 + POSE * b, xi + TWIST * b, q + POSE * b);
    count_angles(s, q0, xi, q);
    for (int i = TWIST * s->bodies, j = poses; i < s->nv; i++, j++) q[j] = q0[j] + xi[i];
}

/* Kinetic, elastic, of the weight, of springs, stops, bushings and dry friction (J); frames are placed. */
void energies(System *s, double t, const double *q, const double *v, const double *gravity, double *out)
{
    out[0] = out[1] = out[2] = out[3] = 0.0;
    for (int b = 0; b < s->bodies; b++) {
        const Body *o = s->body + b;
        if (o->field) field_energies(s, b, t, q, v, gravity, out);
        else body_energies(o, s->frames + FRAME * b + TURN, q, v, q + POSE * b, v + TWIST * b, gravity, out);
        if (o->told) told_energies(s, b, t, q, v, gravity, out);
    }

    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role == MOUNT) out[3] += mount_energy(s, k);
        if (k->role != LINEAR && k->role != FORMULA) continue;
        values(s, k);
        if (k->role == FORMULA) efforts(s, k, t);
        for (long i = 0; k->role == FORMULA && i < k->n; i++) out[3] += stored(k, i, t);

        for (long i = 0; k->role == LINEAR && i < k->n; i++) {
            double stretch = k->out[i * k->outputs] - k->free[i];
            out[3] += 0.5 * k->stiffness[i] * stretch * stretch;
        }
    }
    for (Rod *k = s->rod; k < s->rod + s->rods; k++) out[1] += rod_energy(s, k, t);
}

/* Whether a step of h to a state at t whose frames are placed is too long for dry friction that turned within; ``share``: of its places
   that it may miss. */
int friction_overran(System *s, double t, double h, double share)
{
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->told || k->role != FORMULA || k->formula != DRY) continue;
        values(s, k);
        efforts(s, k, t);
        for (long i = 0; i < k->n; i++)
            if (overruns(k, i, h, share)) return 1;
    }
    return 0;
}

/* Formulas, rods and controllers with a memory take up an accepted step, whose frames are placed. */
int keep(System *s, double t)
{
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (!k->told && (k->role != FORMULA || (k->formula != DRY && k->formula != PID))) continue;
        values(s, k);
        efforts(s, k, t);
        for (long i = 0; !k->told && i < k->n; i++) {
            if (k->formula == DRY) friction_keep(k, i, t);
            else pid_keep(k->constants + FORMULA_WIDTH * i, integral_of(k, i), k->s[i] - k->free[i], k->rate[i], t);
        }
    }

    for (Rod *k = s->rod; k < s->rod + s->rods; k++) rod_keep(s, k, t);
    if (s->remembers < 2) return DONE;
    read_all(s);
    return s->python(KEEP, 0, t) ? FAILED : DONE;
}

/* What controllers with a memory read at point j of a step, whose frames are placed and whose targets are at hand. */
void note_readings(System *s, int j)
{
    const Remembered *r = s->remembered;
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (!k->told && (k->role != FORMULA || k->formula != PID)) continue;
        values(s, k);
        efforts(s, k, r->t[j]);
        for (long i = 0; !k->told && i < k->n; i++) {
            const double *p = k->constants + FORMULA_WIDTH * i;
            integral_of(k, i)->error[j] = p[4] - (k->s[i] - k->free[i]);
            integral_of(k, i)->speed[j] = p[5] - k->rate[i];
        }
    }

    if (!r->asked) return;
    read_all(s);
    memcpy(r->y + (long)j * r->asked, s->controllers->y, r->asked * sizeof(double));
}

/* Memories at the points of a step, of what has been read there: those of formulas, then those of laws in Python. */
int find_memories(System *s)
{
    const Remembered *r = s->remembered;
    int verdict = DONE;
    for (Batch *k = s->batch; k < s->batch + s->batches; k++)
        for (long i = 0; k->role == FORMULA && k->formula == PID && i < k->n && !verdict; i++)
            verdict = find_integral(k->constants + FORMULA_WIDTH * i, integral_of(k, i), r);
    if (verdict || !r->asked) return verdict;
    s->calls++;
    return s->python(COLLOCATE, 0, 0.0) ? FAILED : DONE;
}

/* The largest error of a memory in the step under way, over the tolerance. */
int memory_error(System *s, double *error)
{
    Remembered *r = s->remembered;
    r->error = 0.0;
    if (r->asked && s->python(MEMORY_ERROR, 0, 0.0)) return FAILED;
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++)
        for (long i = 0; k->role == FORMULA && k->formula == PID && i < k->n; i++)
            r->error = worse(r->error, integral_error(k->constants + FORMULA_WIDTH * i, integral_of(k, i), r));
    *error = worse(*error, r->error);
    return DONE;
}

/* The largest error of memories that went to t by the trapezoidal rule, over the tolerance, where it is larger. */
int trapezoid_error(System *s, double t, const double *q, const double *v, double rtol, double atol, double *error)
{
    Remembered *r = s->remembered;
    int verdict;
    if (!r) return DONE;
    if ((verdict = place(s, q, v))) return verdict;
    r->error = 0.0;
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (!k->told && (k->role != FORMULA || k->formula != PID)) continue;
        values(s, k);
        efforts(s, k, t);
        for (long i = 0; !k->told && i < k->n; i++) {
            const double *p = k->constants + FORMULA_WIDTH * i;
            *error = worse(*error, integral_missed(p, integral_of(k, i), k->s[i] - k->free[i], k->rate[i], t, rtol, atol));
        }
    }

    if (!r->asked) return DONE;
    read_all(s);
    r->rtol = rtol;
    r->atol = atol;
    if (s->python(TRAPEZOID_ERROR, 0, t)) return FAILED;
    *error = worse(*error, r->error);
    return DONE;
}

/* Memories, and efforts between two samples, as other tables of the same system have them. */
void share_memory(const System *s, System *with)
{
    for (int i = 0; i < s->batches; i++) {
        const Batch *k = s->batch + i;
        if (k->kept) memcpy(with->batch[i].kept, k->kept, k->n * MEMORY * sizeof(double));
        if (k->role == GIVEN) memcpy(with->batch[i].effort, k->effort, k->n * sizeof(double));
    }
    for (int i = 0; i < s->rods; i++) rod_share(s->rod + i, with->rod + i);
}
