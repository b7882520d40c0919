/* Records of accepted steps: the state, frames that sensors look at, coordinates and efforts, reactions of joints, energies, and
   how far the constraints are open. Python reads them many at a time (recording.py). */

/* Open constraints into gap, with rows as they stand or ``anew``; frames are placed. */
void openings(System *s, int anew)
{
    for (int i = 0; i < s->rows; i++) s->gap[i] = -s->motion[i];
    for (const Body *o = s->body; s->fields && o < s->body + s->bodies; o++)
        for (int i = 0; o->field && i < o->field->frames; i++) s->gap[o->field->row + i] = o->field->p[o->field->frame_slot[i]];
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role != ROW) continue;
        if (anew) k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
        for (long i = 0; !k->flow && i < k->n; i++) s->gap[k->row[i]] += k->factor[i] * k->out[i * k->outputs];
    }
}

/* The same, and their rates into slip. */
void drift(System *s)
{
    slips(s, 1);
    openings(s, 0);
}

/* s, s' and the effort of the items that are read. */
static int readings(System *s, double t, double *found)
{
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (!k->slot && !k->told) continue;
        values(s, k);
        int verdict = efforts(s, k, t);
        if (verdict) return verdict;

        for (long i = 0; k->slot && i < k->n; i++) {
            if (k->slot[i] < 0) continue;
            double *one = found + 3 * k->slot[i];
            one[0] = k->s[i] - k->free[i];
            one[1] = k->rate[i];
            one[2] = k->effort[i];
        }
    }
    return DONE;
}

/* Frames of the markers that sensors look at, and their angles and accelerations where one asks for them. */
static void sights(System *s, const Block *now, double *out)
{
    double arm[D], way[D];
    double *one = out;
    const double *p = s->seen_place;

    for (int i = 0; i < s->seen; i++, one += SIGHT, p += D + D * D) {
        const double *frame = s->frames + FRAME * s->seen_frame[i];
        memcpy(one, frame, FRAME * sizeof(double));
        times(frame + TURN, p, arm);
        spin(frame + SPIN, arm, way);
        add(one, 1.0, arm, D);
        add(one + SPEED, 1.0, way, D);
        product(frame + TURN, p + D, one + TURN);
        if (D == 2 && s->seen_angle[i]) one[ANGLE] = nearest_turn(atan2(one[TURN + D], one[TURN]), one[FRAME - 1]);
    }
    if (!s->accelerated) return;

    for (int i = 0; i < s->surfaces; i++) surface_bias(s, i);
    turn_velocity(s, now->a);
    one = out, p = s->seen_place;
    for (int i = 0; i < s->seen; i++, one += SIGHT, p += D + D * D) {
        int body = s->seen_frame[i], on = body - s->bodies - 1;
        double *accel = one + FRAME, turning[D];
        memset(accel, 0, D * sizeof(double));
        if (body == s->bodies) continue; /* the ground */

        const double *frame = s->frames + FRAME * body, *second = s->velocity + (on < 0 ? s->body[body].at_u : s->nu + TWIST * on);
        times(frame + TURN, p, arm);
        spin(second + D, arm, accel);
        spin(frame + SPIN, arm, way);
        spin(frame + SPIN, way, turning);
        add(accel, 1.0, turning, D);
        add(accel, 1.0, second, D);
        if (on >= 0) add(accel, 1.0, s->surface[on].bias, D);
    }
    turn_velocity(s, now->v);
}

/* Force and torque of a joint or of a force element on one of its bodies about its point there, world axes; rows as drift() left
   them, efforts as readings(). */
static void reaction(const System *s, const Reaction *o, const double *lam, double *wrench)
{
    const double *frame = s->frames + FRAME * o->frame;
    double lever[D], turning[ROT];
    memset(wrench, 0, TWIST * sizeof(double));

    for (int i = 0; i < o->items; i++) {
        const Batch *k = s->batch + o->batch[i];
        const double *out = k->out + k->outputs * o->item[i] + 1;
        int item = o->item[i];
        double pull = k->role == ROW ? lam[k->row[item]] * k->factor[item] : k->effort[item];
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
double far_from_origin(const System *s, const double *q, double length)
{
    double place = 0.0, angle = D == 2 ? 0.0 : 1.0, counted = 0.0;
    for (int b = 0; b < s->bodies; b++) {
        for (int i = 0; i < D; i++) place = fmax(place, fabs(q[POSE * b + i]));
        if (D == 2) angle = fmax(angle, fabs(q[POSE * b + 2]));
    }
    for (int i = 0; i < s->angles; i++) counted = fmax(counted, fabs(q[POSE * s->bodies + i]));
    return place + length * (angle + counted);
}

/* The larger of two errors; nan where one is, which fmax() and comparisons lose. */
double worse(double a, double b) { return a > b || a != a ? a : b; }

double largest(const double *x, int n)
{
    double found = 0.0;
    for (int i = 0; i < n; i++)
        if (found == found && !(fabs(x[i]) <= found)) found = fabs(x[i]); /* nan stays */
    return found;
}

double largest_of(const double *units, const double *x, int n)
{
    double found = 0.0;
    for (int i = 0; i < n; i++)
        if (found == found && !(fabs(units[i] * x[i]) <= found)) found = fabs(units[i] * x[i]); /* nan stays */
    return found;
}

/* The largest angular velocity of a frame, rad/s. */
static double fastest_turn(const System *s, const double *v)
{
    double found = 0.0;
    for (int b = 0; b < s->bodies; b++) {
        const double *w = v + TWIST * b + D;
        found = fmax(found, dot(w, w, TWIST - D));
    }
    return sqrt(found);
}

/* How far the constraints are open, at which rate, this as a speed, the largest speed and rate of turning, of all records; the first
   state that is open by more than is allowed is kept. */
void judge_drift(System *s, Tape *tape, const Block *now)
{
    double widest = 0.0, *open = tape->worst, speed = largest_of(s->units, now->v, s->nv);
    drift(s);
    memcpy(tape->before, open, sizeof(tape->before));
    tape->judged = *now->t;
    if (!(speed <= open[3])) open[3] = speed;
    open[4] = fmax(open[4], fastest_turn(s, now->v));

    for (int i = 0; i < s->rows; i++) {
        double gap = fabs(s->gap[i]), slip = fabs(s->slip[i]), length = gap * tape->units[i];
        if (!(gap * s->row_units[i] <= open[0])) open[0] = gap * s->row_units[i]; /* nan is kept */
        if (!(slip * s->row_units[i] <= open[1])) open[1] = slip * s->row_units[i];
        if (!(slip * tape->units[i] <= open[2])) open[2] = slip * tape->units[i];
        if (!(length <= widest)) widest = length;
    }

    if (tape->doubtful >= 0 || widest <= tape->allowed) return;
    if (widest <= tape->allowed + tape->roundoff * far_from_origin(s, now->q, tape->length)) return;
    tape->doubtful = tape->count;
    memcpy(tape->doubt, now->t, (1 + s->nq + 3 * (long)s->nv + s->rows) * sizeof(double));
}

/* Whether an event is met in the newest step, record k: then values are kept as they were before. */
static int crossed(Tape *tape, long k)
{
    if (tape->meets && !--tape->meets) return 1;
    for (const Crossing *c = tape->crossing; c < tape->crossing + tape->crossings; c++) {
        double before = c->before, after = c->scale * c->at[c->stride * k] - c->level;
        if (before < 0.0 && after >= 0.0 && c->direction >= 0) return 1;
        if (before > 0.0 && after <= 0.0 && c->direction <= 0) return 1;
    }
    for (Crossing *c = tape->crossing; c < tape->crossing + tape->crossings; c++) c->before = c->scale * c->at[c->stride * k] - c->level;
    return 0;
}

/* Where in the arrays the next record is. */
long place_on(const Tape *tape)
{
    return tape->single ? 0 : tape->count;
}

/* Numbers of record k to the ends of the series that grow with it. */
static void prolong(const Tape *tape, long k)
{
    for (const Series *o = tape->series; o < tape->series + tape->straight; o++) {
        const double *at = o->at + o->stride * k;
        double *to = o->to + o->width * tape->count;
        for (long i = 0; i < o->width; i++) to[i] = o->scale * at[o->apart * i];
    }
}

/* One record of a state whose frames are placed; ``known``: its energies at the present weight, NULL where nobody asked; ``judged``:
   whether its joints are. It counts where it is due, and where no event is met: Python looks at that step first. */
int record(System *s, Tape *tape, const Block *now, const double *known, int judged)
{
    long k = place_on(tape), size = 1 + s->nq + 3 * (long)s->nv + s->rows;
    int due = tape->left == 1, verdict = readings(s, *now->t, tape->reading + 3 * (long)s->readings * k);
    if (verdict) return verdict;

    if (tape->whole) memcpy(tape->block + size * k, now->t, size * sizeof(double));
    else tape->block[k] = *now->t;
    if (tape->rows) memcpy(tape->lam + s->rows * k, now->lam, s->rows * sizeof(double));
    if (known && !memcmp(s->gravity, s->rest_gravity, D * sizeof(double))) memcpy(tape->energy + 4 * k, known, 4 * sizeof(double));
    else energies(s, *now->t, now->q, now->v, s->rest_gravity, tape->energy + 4 * k);
    sights(s, now, tape->sight + SIGHT * s->seen * k);

    if (judged) judge_drift(s, tape, now);
    else if (s->reactions) drift(s);
    for (int i = 0; i < s->reactions; i++)
        reaction(s, s->reaction + i, now->lam, tape->reaction + TWIST * (s->reactions * k + i));
    tape->crossed = crossed(tape, k);
    if (due && !tape->crossed) {
        prolong(tape, k);
        tape->count++;
    }
    return DONE;
}

/* Whether somebody waits for an instant up to t. */
int awaited(const Tape *tape, double t)
{
    const Kept *o = tape->kept;
    return o && o->passed < o->instants && o->instant[o->passed] <= t + o->roundoff;
}

/* Whether there is no room for what one more step may take. */
int is_full(const Kept *o) { return o->count + o->most > o->capacity; }

/* Keep two states for the instants between them, up to the time ``until``; where what the scheme keeps with the second has its place. */
double *keep_between(const System *s, Kept *o, const double *begin, const double *end, double until)
{
    const long size = 1 + s->nq + 3 * (long)s->nv + s->rows, k = o->count++;
    double *newest = o->newest + (size + o->own) * k;
    o->number[k] = o->steps;
    memcpy(newest, end, size * sizeof(double));
    memcpy(o->begin + size * k, begin, size * sizeof(double));
    memcpy(o->earlier + size * k, o->last, size * sizeof(double));
    while (o->passed < o->instants && o->instant[o->passed] <= until) o->passed++;
    return newest + size;
}

/* Records of so many states, one block behind the other; ``judged``: as ends of steps are, where joints of states between are as open
   as polynomials leave them. */
EXPORT int driver_record(System *s, Tape *tape, int judged, long count, double *block)
{
    double last = NAN;
    const long size = 1 + s->nq + 3 * (long)s->nv + s->rows;
    int verdict;
    for (long i = 0; i < count; i++, block += size) {
        const Block now = block_at(s, block);
        if ((verdict = sample(s, *now.t, &last)) || (verdict = place(s, now.q, now.v))) return verdict;
        if ((verdict = record(s, tape, &now, NULL, judged))) return verdict;
    }
    return DONE;
}
