/* Many steps of a scheme in one call: of one size, guarded, recorded and judged on the way. */

/* A configuration within the newest step, its joints closed by the least motion for the factor of that step, at most so many times;
   rows on velocities hold no places. ``room``: nv + rows + nq. */
EXPORT int driver_shut(System *s, double t, double allowed, long most, double *q, const double *v, double *room)
{
    double *x = room, *y = x + s->nv, *moved = y + s->rows, asked = NAN;
    int verdict = sample(s, t, &asked);
    for (long i = 0; i < most && !verdict; i++) {
        if ((verdict = place(s, q, v))) break;
        drift(s);
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
   of past as it was. In order of the schemes: */
typedef int Maker(System *s, double *p, double *room, const Block *past, int known, Block out);
static Maker *const MAKERS[] = {alpha_step, rattle_step, runge_kutta_step, half_explicit_step, mean_march_step};

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

/* Up to ``steps`` steps in a ring of four blocks: ring[0] is the newest, ring[3] free. Returns how many were made; the reason to
   stop earlier is in ``verdict``, the state is then that of the last good step. ``tape`` (may be NULL) takes records,
   ``control`` (may be NULL) judges errors, ``closed`` (may be NULL) every state. */
EXPORT long march(System *s, int scheme, double *p, double *room, long steps, double **ring, int *verdict, Tape *tape,
                  Control *control, Closed *closed)
{
    long made = 0;
    double before[PARAMETERS];
    *verdict = DONE;
    while (made < steps) {
        Block past[3], out = block_at(s, ring[3]);
        int known = (int)p[HISTORY];
        double e[4], fastest = closed ? closed->fastest : 0.0;
        memcpy(before, p, sizeof(before));
        for (int i = 0; i <= known; i++) past[i] = block_at(s, ring[i]);
        if ((*verdict = MAKERS[scheme](s, p, room, past, known, out))) {
            memcpy(p, before, sizeof(before));
            break;
        }
        int due = tape && tape->left == 1, recorded = due || (tape && tape->crossings);
        if (scheme == ALPHA && (control || recorded) && rates_wait(s, p) && s->python(SAMPLE, RATES, *out.t)) {
            *verdict = FAILED;
            break;
        }
        if (control && (*verdict = judged(s, p, control, past, &out))) break;
        if (control) arrive(control, &out);
        int guarded = p[GUARDED] != 0.0, looked_at = guarded || recorded || closed || s->remembers;
        int placed = looked_at && !place(s, out.q, out.v);
        if (closed && !(placed && passes(s, closed, &out, p[H]))) *verdict = DOUBT;
        else if (guarded && placed && gained(s, p, &out, e)) *verdict = GAIN;
        else if (s->remembers && !placed) *verdict = LOOK;
        else if (recorded) *verdict = placed ? record(s, tape, &out, guarded ? e : 0) : LOOK;
        if (!*verdict && s->remembers) *verdict = keep(s, *out.t);
        if (*verdict) { /* who judges every state tells why, from the same beginning */
            if (closed) memcpy(p, before, sizeof(before)), closed->fastest = fastest;
            break;
        }
        if (tape) tape->left = due ? tape->every : tape->left - 1;
        double *newest = ring[3];
        for (int i = 3; i > 0; i--) ring[i] = ring[i - 1];
        ring[0] = newest;
        if (known < 2) p[HISTORY] = known + 1;
        made++;
        if (control && !stays(p, control, &out)) {
            *verdict = SIZE;
            break;
        }
        if (recorded && tape->crossed) break;
        if (closed && closed->speed > closed->most) break;
    }
    return made;
}
