/* Laws that Newton's iteration goes back and forth over: steep between two parts that are nearly level, as friction about rest and
   motors between their limits.

   From an iterate on one side the slope there leads far beyond the other, whose slope leads back, and so on: for an odd law for ever
   where the slopes at both ends tell of half of the change of N between them, or less (Newton's method on tanh from 1.09 on). There, and
   a little before, the law
   counts as the line that touches it in the middle of the change, on the way from the last iterate to the newest, for one increment.
   What sticks in between is found at once, what slides goes on. N is none of the state then: no step ends with it.

   Each law is asked by a function that tells N of a whole batch at its s and s', and the slopes of a formula. */

enum { BISECTIONS = 60 };
static const double TOLD = 0.75;       /* share of a change that slopes tell of at least */
static const double MIDDLE = 0.125;    /* of the change: what is in the middle of it */

/* The share that a line's slopes tell of a change from the last iterate to (s, s'). */
static double told_by(const double *last, double slope, double drag, double x, double rate, double change)
{
    return (slope * (x - last[0]) + drag * (rate - last[1])) / change;
}

/* Whether item i changed between the last iterate and this one by what the slopes at neither tell; ``here``: whether they are known here. */
static int is_hidden(const System *s, const Batch *k, long i, int here)
{
    const double *last = line_of(k, s->point, i), change = k->effort[i] - last[2], x = k->s[i], rate = k->rate[i];
    if (!(fabs(change) > OF_THE_LAW * fmax(largest(k->effort, (int)k->n), fabs(last[2])))) return 0;
    if (told_by(last, last[3], last[4], x, rate, change) >= TOLD) return 0;
    return !here || !(told_by(last, k->stiffness[i], k->damping[i], x, rate, change) >= TOLD);
}

static int any_hidden(const System *s, const Batch *k, int here)
{
    for (long i = 0; i < k->n; i++)
        if (is_hidden(s, k, i, here)) return 1;
    return 0;
}

/* Slopes of laws in Python. */
int ask_slopes(System *s, Batch *k, double t)
{
    if (k->role != LAW) return DONE;
    k->sloped = s->evaluations;
    if (k->act) return control_slopes(s, k, t);
    s->calls++;
    return s->python(SLOPES, k->number, t) ? FAILED : DONE;
}

/* The line that touches the law of item i in the middle of its change, with N at this iterate on it; the item is left in the middle. */
static int touch(System *s, Batch *k, long i, Law *law, const void *how, double t)
{
    double *line = line_of(k, s->point, i), x = k->s[i], rate = k->rate[i], level = 0.5 * (k->effort[i] + line[2]);
    const double change = k->effort[i] - line[2], began[2] = {line[0], line[1]};
    double from = 0.0, to = 1.0, missed = INFINITY;
    int verdict;
    k->aside = 1;

    for (int tries = 0; tries < BISECTIONS && fabs(missed) > MIDDLE; tries++) {
        const double share = 0.5 * (from + to);
        k->s[i] = began[0] + share * (x - began[0]);
        k->rate[i] = began[1] + share * (rate - began[1]);
        if ((verdict = law(s, k, how, t))) return verdict;
        missed = (k->effort[i] - level) / change;
        if (missed < 0.0) from = share;
        else to = share;
    }

    if (!(fabs(missed) <= MIDDLE)) return DONE; /* it jumps, there is no line */
    if ((verdict = ask_slopes(s, k, t))) return verdict;
    line[3] = k->stiffness[i];
    line[4] = k->damping[i];
    line[2] = k->effort[i] + line[3] * (x - k->s[i]) + line[4] * (rate - k->rate[i]);
    line[0] = x;
    line[1] = rate;
    k->bridges[i] = 1;
    s->bridged = 1;
    return DONE;
}

/* N of a batch as it was at the last iterate, the same as this one; laws in Python that count for themselves tell their slopes. */
static int ask_again(System *s, Batch *k, Law *law, const void *how, double t)
{
    int verdict = DONE, asks = s->bent && k->role == LAW;
    if (asks && ((verdict = law(s, k, how, t)) || (verdict = ask_slopes(s, k, t)))) return verdict;

    for (long i = 0; i < k->n; i++) {
        double *line = line_of(k, s->point, i);
        if (asks && line[2] == k->effort[i]) {
            line[3] = k->stiffness[i];
            line[4] = k->damping[i];
        }
        k->effort[i] = line[2];
    }
    s->bridged = 1;
    return DONE;
}

/* Slopes of laws in Python at the last iterate, where they were asked for since the step began. */
static void recall_slopes(const System *s, const Batch *k)
{
    const int asked = s->iterate == FOLLOWING && k->sloped >= s->begun;
    for (long i = 0; k->role == LAW && !s->bent && i < k->n; i++) {
        double *line = line_of(k, s->point, i);
        line[3] = asked ? k->stiffness[i] : 0.0;
        line[4] = asked ? k->damping[i] : 0.0;
    }
}

/* Lines in place of the laws of a batch that changed by what slopes do not tell. */
static int cross_hidden(System *s, Batch *k, Law *law, const void *how, double t)
{
    int verdict = ask_slopes(s, k, t);
    for (long i = 0; !verdict && i < k->n; i++) {
        if (!is_hidden(s, k, i, 1)) continue;

        const double x = k->s[i], rate = k->rate[i];
        verdict = touch(s, k, i, law, how, t);
        k->aside = 0;
        k->s[i] = x;
        k->rate[i] = rate;
        if (verdict || (verdict = law(s, k, how, t))) return verdict;
        verdict = ask_slopes(s, k, t);
    }
    return verdict;
}

/* Slopes that the tangent of an implicit step has of the formulas of a batch, n x 2, in the order of note_slopes(). */
static const double *noted_of(const System *s, const Batch *k)
{
    const double *noted = s->noted;
    for (const Batch *b = s->batch; b < k; b++) noted += b->role == FORMULA ? 2 * b->n : 0;
    return noted;
}

/* What the next iterate is compared with; laws that count as lines become these. */
static void keep_lines(System *s, Batch *k)
{
    const double *noted = k->role == FORMULA && s->noted ? noted_of(s, k) : NULL;
    const double known = OF_THE_LAW * largest(k->effort, (int)k->n);
    const int sloped = k->role == FORMULA || k->sloped >= s->begun;
    for (long i = 0; i < k->n; i++) {
        double *line = line_of(k, s->point, i);
        const double here[LINE] = {k->s[i], k->rate[i], k->effort[i], k->stiffness[i], k->damping[i]};
        const double along = here[3] * (here[0] - line[0]) + here[4] * (here[1] - line[1]);
        const int told = k->role == LAW || (noted && !steeper(noted[2 * i], here[3]) && !steeper(noted[2 * i + 1], here[4]));
        const double foretold = line[2] + (told ? along : 0.0); /* by slopes that the tangent has */

        if (s->iterate == FOLLOWING && fabs(foretold - k->effort[i]) > known) s->swung = 1;
        if (!k->bridges[i]) {
            memcpy(line, here, (sloped ? 5 : 3) * sizeof(double));
            continue;
        }

        k->effort[i] = line[2];
        k->stiffness[i] = line[3];
        k->damping[i] = line[4];
    }
}

/* Whether a batch keeps the N of the last iterate: no tangent has its slopes then. */
static int is_held(const System *s, const Batch *k) { return s->iterate == AGAIN && k->line && !k->linked; }

/* N of a batch whose s and s' are told, where Newton's iteration has come to: lines in place of laws that it would not find across. */
int ask_iterate(System *s, Batch *k, Law *law, const void *how, double t)
{
    const int followed = s->iterate != ON_ITS_OWN && k->line && !k->linked;
    if (is_held(s, k)) return ask_again(s, k, law, how, t);
    int verdict = law(s, k, how, t);
    if (verdict || !followed) return verdict;

    memset(k->bridges, 0, k->n * sizeof(int));
    if (s->iterate == FIRST) s->begun = s->evaluations;
    recall_slopes(s, k);
    const int hidden = s->iterate == FOLLOWING && any_hidden(s, k, k->role == FORMULA);
    if (hidden && (verdict = cross_hidden(s, k, law, how, t))) return verdict;
    if (s->bent && k->sloped != s->evaluations && (verdict = ask_slopes(s, k, t))) return verdict;
    keep_lines(s, k);
    return DONE;
}

/* Whether an increment x, like v and over the weight ``unit`` of stiffness in the matrix, changes N of a law by more than a bent law is
   known along a line: increments that move hardly anything may lead through all of a law that is steep enough. */
int undecided(System *s, double unit, const double *x)
{
    int turned = 0;
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (!k->line || k->linked) continue;
        if (!turned) turn_velocity(s, x);
        turned = 1;
        const double *out = k->out, known = OF_THE_LAW * largest(k->effort, (int)k->n);
        const int *at = k->at;

        for (long i = 0; i < k->n; i++, out += k->outputs, at += k->live) {
            double change = 0.0;
            for (int e = 0; e < k->live; e++) change += out[k->entry[e]] * s->velocity[at[e]];
            if (fabs(k->slope[i] / unit * change) > known) return 1;
        }
    }
    return 0;
}
