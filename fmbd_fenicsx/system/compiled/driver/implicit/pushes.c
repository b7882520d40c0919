/* What increments of multipliers push; a part of stages.c. */

/* U multipliers of the levels that accelerate, all points of one behind those of the other, into ``push``. Where rows depend, by the
   directions of each point: forces between joints that cancel there do not by those of the tangent, and nothing else bounds them. */
static int pushes(System *s, Stages *o, const double *mult)
{
    const Sparse directions = directions_of(o);
    const Normal own = {&o->W, o->units && !o->frozen ? NULL : &directions, NULL, NULL};
    const int n = o->n, k = o->points, acts = o->fields || !o->levels ? 0 : o->levels > 2 ? 2 : 1;
    double *q = o->local, *room = q + s->nq;
    int verdict = DONE;
    memset(o->push, 0, (size_t)2 * k * n * sizeof(double));
    for (int j = 0; acts && j < k; j++, mult += o->size - n) {
        if (!own.frozen) {
            configuration(s, o->q0, o->xi + (long)j * n, q);
            if ((verdict = place(s, q, o->v + (long)j * n))) return verdict;
        }
        for (int i = 0; i < acts; i++) add_normal(s, &own, 1.0, mult + 2 * i * o->m, room, o->push + (long)(i * k + j) * n);
    }
    return verdict;
}
