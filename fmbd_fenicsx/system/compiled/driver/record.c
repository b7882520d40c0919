/* Records of accepted steps: the state, frames that sensors look at, coordinates and efforts, reactions of joints, energies, and
   how far the constraints are open. Python reads them many at a time (recording.py). */

/* Open constraints into gap, their rates into slip; frames are placed. */
static void drift(System *s)
{
    slips(s, 1);
    for (int i = 0; i < s->rows; i++) s->gap[i] = -s->motion[i];
    for (const Body *o = s->body; s->fields && o < s->body + s->bodies; o++)
        for (int i = 0; o->field && i < o->field->frames; i++) s->gap[o->field->row + i] = o->field->p[o->field->frame_slot[i]];
    for (Batch *k = s->batch; k < s->batch + s->batches; k++)
        for (long i = 0; k->role == ROW && !k->flow && i < k->n; i++) s->gap[k->row[i]] += k->factor[i] * k->out[i * k->outputs];
}

/* s, s' and the effort of the items that are read. */
static int readings(System *s, double t, double *found)
{
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (!k->slot) continue;
        k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
        int verdict = efforts(s, k, t);
        if (verdict) return verdict;
        for (long i = 0; i < k->n; i++) {
            if (k->slot[i] < 0) continue;
            double *one = found + 3 * k->slot[i];
            one[0] = k->s[i] - k->free[i];
            one[1] = k->rate[i];
            one[2] = k->effort[i];
        }
    }
    return DONE;
}

/* Force and torque of a joint on its first body about the joint's point there, world axes; rows as drift() left them. */
static void reaction(const System *s, const Reaction *o, const double *lam, double *wrench)
{
    const double *frame = s->frames + FRAME * o->frame;
    double lever[D], turning[ROT];
    memset(wrench, 0, TWIST * sizeof(double));
    for (int i = 0; i < o->items; i++) {
        const Batch *k = s->batch + o->batch[i];
        const double *out = k->out + k->outputs * o->item[i] + 1;
        double pull = lam[k->row[o->item[i]]] * k->factor[o->item[i]];
        for (int e = 0; e < k->outputs - 1; e++) {
            int component = k->component[e] - TWIST * o->side[i];
            if (component >= 0 && component < TWIST) wrench[component] -= pull * out[e];
        }
    }
    times(frame + TURN, o->p, lever);
    moment(lever, wrench, turning);
    for (int i = 0; i < ROT; i++) wrench[D + i] -= turning[i];
}

/* Largest coordinate of a frame, its angle as a length, and of what is counted: see run/judges/acceptance.py. */
static double far_from_origin(const System *s, const double *q, double length)
{
    double place = 0.0, angle = D == 2 ? 0.0 : 1.0, counted = 0.0;
    for (int b = 0; b < s->bodies; b++) {
        for (int i = 0; i < D; i++) place = fmax(place, fabs(q[POSE * b + i]));
        if (D == 2) angle = fmax(angle, fabs(q[POSE * b + 2]));
    }
    for (int i = 0; i < s->angles; i++) counted = fmax(counted, fabs(q[POSE * s->bodies + i]));
    return place + length * (angle + counted);
}

double largest_of(const double *units, const double *x, int n)
{
    double found = 0.0;
    for (int i = 0; i < n; i++)
        if (found == found && !(fabs(units[i] * x[i]) <= found)) found = fabs(units[i] * x[i]); /* nan stays */
    return found;
}

/* How far the constraints are open, at which rate, this as a speed, and the largest speed; the first state that is open by more
   than is allowed is kept. */
static void judge_drift(System *s, Tape *tape, const Block *now, double *open)
{
    double widest = 0.0;
    drift(s);
    open[0] = open[1] = open[2] = 0.0;
    open[3] = largest_of(s->units, now->v, s->nv);
    for (int i = 0; i < s->rows; i++) {
        double gap = fabs(s->gap[i]), slip = fabs(s->slip[i]), length = gap * tape->units[i];
        if (!(gap * s->row_units[i] <= open[0])) open[0] = gap * s->row_units[i]; /* nan is kept */
        if (!(slip * s->row_units[i] <= open[1])) open[1] = slip * s->row_units[i];
        if (!(slip * tape->units[i] <= open[2])) open[2] = slip * tape->units[i];
        if (!(length <= widest)) widest = length;
    }
    if (tape->doubtful >= 0 || widest <= tape->allowed + tape->roundoff * far_from_origin(s, now->q, tape->length)) return;
    tape->doubtful = tape->count;
    memcpy(tape->doubt, now->t, (1 + s->nq + 3 * (long)s->nv + s->rows) * sizeof(double));
}

/* One record of an accepted step whose frames are placed. */
int record(System *s, Tape *tape, const Block *now)
{
    long k = tape->count, size = 1 + s->nq + 3 * (long)s->nv + s->rows;
    int verdict = readings(s, *now->t, tape->reading + 3 * (long)s->readings * k);
    if (verdict) return verdict;

    if (tape->whole) memcpy(tape->block + size * k, now->t, size * sizeof(double));
    else tape->block[k] = *now->t;
    if (tape->rows) memcpy(tape->lam + s->rows * k, now->lam, s->rows * sizeof(double));
    energies(s, *now->t, now->q, now->v, s->rest_gravity, tape->energy + 4 * k);
    for (int i = 0; i < s->seen; i++)
        memcpy(tape->frames + FRAME * (s->seen * k + i), s->frames + FRAME * s->seen_frame[i], FRAME * sizeof(double));

    judge_drift(s, tape, now, tape->drift + 4 * k);
    for (int i = 0; i < s->reactions; i++)
        reaction(s, s->reaction + i, now->lam, tape->reaction + TWIST * (s->reactions * k + i));
    tape->count++;
    return DONE;
}
