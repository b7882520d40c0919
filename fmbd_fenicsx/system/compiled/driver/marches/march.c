/* Many steps of a scheme in one call: of one size, guarded, recorded and judged on the way. */

/* A configuration within a step, its joints closed by the least motion for the matrix M + cd C + ck K there, at most so many times; rows
   on velocities hold no places. ``room``: nv + rows + nq. */
EXPORT int driver_shut(System *s, double cd, double ck, double t, double allowed, long most, double *q, const double *v, double *room)
{
    double *x = room, *y = x + s->nv, *moved = y + s->rows, asked = NAN;
    int verdict = sample(s, t, &asked);

    for (long i = 0; i < most && !verdict; i++) {
        if ((verdict = look_at(s, 1, i == 0, cd, ck, t, q, v, room))) break;
        for (const Batch *k = s->batch; k < s->batch + s->batches; k++)
            for (long j = 0; k->role == ROW && k->flow && j < k->n; j++) s->gap[k->row[j]] = 0.0;
        if (largest_of(s->row_units, s->gap, s->rows) <= allowed) break;
        if (!(closing_change(s, s->gap, x, y) < INFINITY)) return NEWTON;
        configuration(s, q, x, moved);
        memcpy(q, moved, s->nq * sizeof(double));
    }
    return verdict;
}

/* A step from past[0] to out, the newest of ``known`` + 1 blocks first; ``room``: what the scheme asks for. A step that fails leaves all
   of past as it was; behind one that does not, what depends on time only is sampled at its end. In order of the schemes: */
typedef int Maker(System *s, double *p, double *room, const Block *past, int known, Block out);
static Maker *const MAKERS[] = {alpha_step, rattle_step, runge_kutta_step, half_explicit_step, mean_march_step, radau_step,
                               bdf_step,   theta_step};

/* Whether the joints of a new state after a step of size h are closed, and all its numbers finite; frames are placed. */
static int passes(System *s, Closed *o, const Block *now, double h)
{
    double speed = largest_of(s->units, now->v, s->nv), known, fastest = fmax(o->fastest, speed);
    if (!(speed < INFINITY && largest_of(s->units, now->a, s->nv) < INFINITY)) return 0;
    if (!(largest_of(s->multiplier_units, now->lam, s->rows) < INFINITY)) return 0;
    drift(s);
    known = o->roundoff * far_from_origin(s, now->q, o->length);
    if (!(largest_of(o->units, s->gap, s->rows) <= o->allowed + known)) return 0;
    if (!(largest_of(o->units, s->slip, s->rows) <= o->share * fastest + o->opening + known / h)) return 0;
    o->fastest = fastest;
    o->speed = speed;
    return 1;
}

/* Who looks at the steps of a march, each may be NULL: takes records, judges errors, judges every state, keeps the books of contact. */
typedef struct {
    Tape *tape;
    Control *control;
    Closed *closed;
    ElasticContact *contact;
} Watch;

/* Keep the newest step of a ring where an instant lies in it, or all are asked for; whether there is room for no more. */
static int keep_step(const System *s, Tape *tape, double **ring)
{
    Kept *o = tape->kept;
    const long size = 1 + s->nq + 3 * (long)s->nv + s->rows;
    o->steps++;
    if ((o->each || awaited(tape, *ring[0])) && !tape->crossed)
        memcpy(keep_between(s, o, ring[1], ring[0], *ring[0] + o->roundoff), ring[0] + size, o->own * sizeof(double));
    if (!tape->crossed) memcpy(o->last, ring[1], size * sizeof(double));
    return is_full(o);
}

/* What a new state is worth, DONE where it counts; it is taken down where ``recorded``. */
static int judge_state(System *s, const Watch *w, double *p, const Block *past, Block *out, int recorded)
{
    int verdict = DONE, guarded = p[GUARDED] != 0.0, waits = w->tape && awaited(w->tape, *out->t);
    double e[4];
    if (w->control && (verdict = judged(s, p, w->control, past, out))) return verdict;
    if (w->control) arrive(w->control, out);

    if (!(guarded || recorded || waits || w->closed || s->remembers)) return DONE;
    int placed = !place(s, out->q, out->v);
    if (w->closed && !(placed && passes(s, w->closed, out, p[H]))) return DOUBT;
    if (guarded && placed && gained(s, p, out, e)) return GAIN;
    if ((s->remembers || recorded || waits) && !placed) return LOOK;
    const double share = w->control ? w->control->own->rtol : p[CHOSEN];
    if (share > 0.0 && s->remembers && friction_overran(s, *out->t, *out->t - *past->t, share)) return LOOK;
    if (recorded && w->contact) record_contact(w->contact, out, w->tape->contact, place_on(w->tape));
    if (recorded) verdict = record(s, w->tape, out, guarded ? e : 0, w->tape->left == 1 || waits);
    else if (waits) judge_drift(s, w->tape, out);
    if (!verdict && s->remembers) verdict = keep(s, *out->t);
    return verdict;
}

/* The block that was free is the newest state. */
static void turn_ring(double **ring, double *p)
{
    double *newest = ring[3];
    for (int i = 3; i > 0; i--) ring[i] = ring[i - 1];
    ring[0] = newest;
    if (p[HISTORY] < 2.0) p[HISTORY] += 1.0;
}

/* One step of a march from the newest state; where it does not count all is as it was but what steps have in common with Python. */
static int one_step(System *s, int scheme, double *p, double *room, double **ring, const Watch *w, int recorded)
{
    Block past[3], out = block_at(s, ring[3]);
    const int known = w->contact ? 0 : (int)p[HISTORY]; /* others make some of its steps, from the state alone */
    double before[PARAMETERS], fastest = w->closed ? w->closed->fastest : 0.0;
    memcpy(before, p, sizeof(before));
    for (int i = 0; i <= known; i++) past[i] = block_at(s, ring[i]);

    int verdict = MAKERS[scheme](s, p, room, past, known, out), made = !verdict;
    if (made && w->contact) made = !(verdict = book_contact(s, w->contact, p[H], past, &out));
    int rates = scheme == ALPHA && (w->control || recorded || (w->tape && awaited(w->tape, *out.t))) && rates_wait(s, p);
    if (made && rates && s->python(SAMPLE, RATES, *out.t)) return FAILED;
    if (made) verdict = judge_state(s, w, p, past, &out, recorded);

    /* who judges every state tells why, from the same beginning; a step that its error refuses is made, and counts as work */
    if (verdict && (!made || (w->closed && verdict != SIZE))) memcpy(p, before, sizeof(before));
    if (verdict && made && w->closed) w->closed->fastest = fastest;
    return verdict;
}

/* Keep pressures that are unknowns where a step begins, or take them ``back``. */
static void keep_pressures(const System *s, int back)
{
    for (const Body *o = s->body; s->fields && o < s->body + s->bodies; o++)
        if (o->field) keep_pressure(o, back);
}

/* Up to ``steps`` steps, as march() makes them. */
static long march_on(System *s, int scheme, double *p, double *room, long steps, double **ring, int *verdict, Tape *tape,
                     Control *control, Closed *closed, ElasticContact *contact)
{
    const Watch watch = {tape, control, closed, contact};
    *verdict = DONE;
    if (control && (*verdict = begin_size(s, p, control, ring[0]))) return 0;
    for (long made = 0; made < steps;) {
        int due = tape && tape->left == 1, recorded = due || (tape && tape->crossings);
        keep_pressures(s, 0);
        if ((*verdict = one_step(s, scheme, p, room, ring, &watch, recorded))) {
            keep_pressures(s, 1);
            const Block now = block_at(s, ring[0]);
            if (control && smaller_size(s, p, control, &now, verdict)) continue;
            return made;
        }

        if (tape) tape->left = due ? tape->every : tape->left - 1;
        turn_ring(ring, p);
        if (contact) pass_contact(contact);
        made++;

        const Block now = block_at(s, ring[0]);
        const int full = tape && tape->kept && keep_step(s, tape, ring);
        if (control) pass_step(p, control);
        if (full || (recorded && tape->crossed) || (closed && closed->speed > closed->most)) return made;
        if (control && made < steps && (*verdict = next_size(s, p, control, &now))) return made;
    }
    return steps;
}

/* Up to ``steps`` steps in a ring of four blocks: ring[0] is the newest, ring[3] free. Returns how many were made; the reason to
   stop earlier is in ``verdict``, the state is then that of the last good step. ``tape``, ``control``, ``closed``, ``contact``: see
   Watch. */
EXPORT long march(System *s, int scheme, double *p, double *room, long steps, double **ring, int *verdict, Tape *tape,
                  Control *control, Closed *closed, ElasticContact *contact)
{
    s->recalls = ANEW;
    s->contact = contact;
    s->held = s->pause = s->without = 0;
    s->dear = !contact && !s->fields && is_dear(s);
    const long made = march_on(s, scheme, p, room, steps, ring, verdict, tape, control, closed, contact);
    s->recalls = FORGETS;
    s->contact = NULL;
    return made;
}
