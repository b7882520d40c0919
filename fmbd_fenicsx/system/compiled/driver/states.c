/* A state as one block of numbers, and its energies: t, q (nq), v (nv), a (nv), A (nv), lambda (rows). */

#if DIM == 3
/* Counted angles: on with the increments of both frames, by any number of turns, then to the nearest angle of the attitude. */
static void count_angles(const System *s, const double *q0, const double *xi, double *q)
{
    for (int i = 0; i < s->angles; i++) {
        const Angle *o = s->angle + i;
        double Ra[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, Rb[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, fa[3], ga[3], fb[3], gb[3];
        double ahead = q0[POSE * s->bodies + i];
        if (o->a < s->bodies) {
            rotation(q + POSE * o->a, Ra);
            ahead -= dot(o->ea, xi + TWIST * o->a + D, 3);
        }
        if (o->b < s->bodies) {
            rotation(q + POSE * o->b, Rb);
            ahead += dot(o->eb, xi + TWIST * o->b + D, 3);
        }
        times(Ra, o->fa, fa);
        times(Ra, o->ga, ga);
        times(Rb, o->fb, fb);
        times(Rb, o->gb, gb);
        double attitude = atan2(dot(ga, fb, 3) - dot(fa, gb, 3), dot(fa, fb, 3) + dot(ga, gb, 3));
        q[POSE * s->bodies + i] = nearest_turn(attitude, ahead);
    }
}
#endif

/* q = q0 o exp(xi), as system/configurations.py. */
void configuration(const System *s, const double *q0, const double *xi, double *q)
{
    int poses = POSE * s->bodies + s->angles;
    for (int b = 0; b < s->bodies; b++) compose(q0 + POSE * b, xi + TWIST * b, q + POSE * b);
#if DIM == 3
    count_angles(s, q0, xi, q);
#endif
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
    }
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role == MOUNT) out[3] += mount_energy(s, k);
        if (k->role != LINEAR && k->role != FORMULA) continue;
        k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
        if (k->role == FORMULA) efforts(s, k, t);
        for (long i = 0; k->role == FORMULA && i < k->n; i++) out[3] += stored(k, i);
        for (long i = 0; k->role == LINEAR && i < k->n; i++) {
            double stretch = k->out[i * k->outputs] - k->free[i];
            out[3] += 0.5 * k->stiffness[i] * stretch * stretch;
        }
    }
    for (Rod *k = s->rod; k < s->rod + s->rods; k++) out[1] += rod_energy(s, k);
}

/* Formulas with a memory take up an accepted step, whose frames are placed. */
void keep(System *s, double t)
{
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role != FORMULA || (k->formula != DRY && k->formula != PID)) continue;
        k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
        efforts(s, k, t);
        for (long i = 0; i < k->n; i++) {
            double *kept = k->kept + MEMORY * i;
            if (k->formula == DRY) kept[0] = dragged(k, i);
            else pid_keep(k->constants + FORMULA_WIDTH * i, kept, k->s[i] - k->free[i], k->rate[i], t);
        }
    }
}
