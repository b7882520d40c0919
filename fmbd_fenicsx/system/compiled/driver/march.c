/* Many steps of generalized-alpha in one call: of one size, guarded, recorded and judged on the way. */

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
        double theta = p[THETA];
        for (int i = 0; i <= known; i++) past[i] = block_at(s, ring[i]);
        if ((*verdict = step(s, p, past, known, out))) {
            p[THETA] = theta;
            break;
        }
        if (control && (*verdict = judged(s, p, control, past, &out))) break;
        int recorded = tape && tape->left == 1;
        int placed = (p[GUARDED] != 0.0 || recorded || s->remembers) && !place(s, out.q, out.v);
        if (p[GUARDED] != 0.0 && placed && gained(s, p, &out)) {
            *verdict = GAIN;
            break;
        }
        if (s->remembers && !placed) {
            *verdict = LOOK;
            break;
        }
        if (recorded && (*verdict = placed ? record(s, tape, &out) : LOOK)) break;
        if (s->remembers) keep(s, *out.t);
        if (tape) tape->left = recorded ? tape->every : tape->left - 1;
        double *newest = ring[3];
        for (int i = 3; i > 0; i--) ring[i] = ring[i - 1];
        ring[0] = newest;
        if (known < 2) p[HISTORY] = known + 1;
        made++;
        if (control && !stays(s, p, control, &out)) {
            *verdict = SIZE;
            break;
        }
    }
    return made;
}
