/* Many steps of generalized-alpha in one call: of one size, guarded, recorded and judged on the way. */

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

/* Up to ``steps`` steps in a ring of four blocks: ring[0] is the newest, ring[3] free. Returns how many were made; the reason to
   stop earlier is in ``verdict``, the state is then that of the last good step. ``tape`` (may be NULL) takes records,
   ``control`` (may be NULL) judges errors. */
EXPORT long march(System *s, double *p, long steps, double **ring, int *verdict, Tape *tape, Control *control)
{
    long made = 0;
    *verdict = DONE;
    while (made < steps) {
        Block past[3], out = block_at(s, ring[3]);
        int known = (int)p[HISTORY];
        double theta = p[THETA], e[4];
        for (int i = 0; i <= known; i++) past[i] = block_at(s, ring[i]);
        if ((*verdict = step(s, p, past, known, out))) {
            p[THETA] = theta;
            break;
        }
        int due = tape && tape->left == 1, recorded = due || (tape && tape->crossings);
        if ((control || recorded) && rates_wait(s, p) && s->python(SAMPLE, RATES, *out.t)) {
            *verdict = FAILED;
            break;
        }
        if (control && (*verdict = judged(s, p, control, past, &out))) break;
        if (control) arrive(control, &out);
        int guarded = p[GUARDED] != 0.0, placed = (guarded || recorded || s->remembers) && !place(s, out.q, out.v);
        if (guarded && placed && gained(s, p, &out, e)) {
            *verdict = GAIN;
            break;
        }
        if (s->remembers && !placed) {
            *verdict = LOOK;
            break;
        }
        if (recorded && (*verdict = placed ? record(s, tape, &out, guarded ? e : 0) : LOOK)) break;
        if (s->remembers && (*verdict = keep(s, *out.t))) break;
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
    }
    return made;
}
