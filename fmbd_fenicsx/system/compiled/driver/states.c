/* A state as one block of numbers, and its energies: t, q (nq), v (nv), a (nv), A (nv), lambda (rows). */

typedef struct {
    double *t, *q, *v, *a, *A, *lam;
} Block;

static Block block_at(const System *s, double *x)
{
    Block b;
    b.t = x;
    b.q = x + 1;
    b.v = b.q + s->nq;
    b.a = b.v + s->nv;
    b.A = b.a + s->nv;
    b.lam = b.A + s->nv;
    return b;
}

/* Kinetic, elastic, of the weight, of springs, stops, bushings and dry friction (J); frames are placed. */
static void energies(System *s, double t, const double *q, const double *v, const double *gravity, double *out)
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
static void keep(System *s, double t)
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
