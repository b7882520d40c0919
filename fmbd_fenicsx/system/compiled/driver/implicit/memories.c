/* Memories of laws at the points of an implicit step, found together: system/control/memory_points.py. */

/* The memories of elements at the points, whose motion is at hand; ``known``: whether what depends on time only has been sampled. */
static int remember_points(System *s, const Stages *o, int known)
{
    Remembered *r = s->remembered;
    double *q = o->local;
    int verdict;
    r->points = o->points;
    r->ends = o->behind;
    memcpy(r->t, o->t, o->points * sizeof(double));
    memcpy(r->couple, o->couple, o->points * o->points * sizeof(double));
    memcpy(r->past, o->past, o->points * o->behind * sizeof(double));
    memcpy(r->end, o->ends, o->behind * sizeof(double));

    for (int j = 0; j < o->points; j++) {
        if ((verdict = sample_point(s, o, j, known))) return verdict;
        configuration(s, o->q0, o->xi + (long)j * o->n, q);
        if ((verdict = place(s, q, o->v + (long)j * o->n))) return verdict;
        note_readings(s, j);
    }
    return find_memories(s);
}

/* Where tangents of a step are taken memories answer to rates by so much (s). */
static int lead_memories(System *s, double share)
{
    Remembered *r = s->remembered;
    if (!r || !r->asked) return DONE;
    r->lead = share;
    return s->python(LEAD_MEMORIES, 0, 0.0) ? FAILED : DONE;
}

/* The error of the memories of a step that was found, over the tolerance, where it is larger: ``points``, ``ends`` and ``rate``: weights of
   memories at the points, at ends of steps, and of the rate where the step began. */
static int remembered_error(System *s, const Stages *o, const double *tolerance, const double *points, const double *ends, int behind,
                            double rate, double frequency, double *error)
{
    Remembered *r = s->remembered;
    if (!r) return DONE;
    memcpy(r->of_points, points, o->points * sizeof(double));
    memcpy(r->of_ends, ends, behind * sizeof(double));
    r->ends = behind;
    r->of_rate = rate;
    r->frequency = frequency;
    r->rtol = tolerance[0];
    r->atol = tolerance[1];
    return memory_error(s, error);
}
