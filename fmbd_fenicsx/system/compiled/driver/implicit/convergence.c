/* When Newton's iteration of an implicit step has ended: schemes/implicit/convergence.py says it in Python, and what the numbers are. */

typedef struct {
    int most, adaptive, averaged, foresees, done, outcome;
    double h, allowed, still, tolerance, accurate;
    double limit, largest, before, least, calm, stagnation, fallen, first;
    double size, greatest, theta, share;
} Convergence;

static const double PASSED = -1.0; /* in the place of a size */

/* What is left of the error, over the size of increment k. */
static double share_left(const Convergence *o, int k)
{
    return k ? fmax(o->theta / (1.0 - fmin(o->theta, o->limit)), o->least) : o->first;
}

/* Whether increments that no longer fall are roundoff. */
static int is_roundoff(const Convergence *o, int k, double ratio, double size, double last, int still)
{
    int small = size <= fmax(o->stagnation, o->fallen * o->greatest);
    int stagnates = k > 2 && ratio > 0.3 && (small || still);
    if (!o->adaptive) return stagnates;
    return (ratio > 0.5 && size <= o->calm && last <= o->before * o->calm) || (stagnates && still);
}

/* Take notice of an increment that tells nothing of the iteration, nor by how much the next one is smaller. */
static void pass_increment(Convergence *o, double size)
{
    o->done++;
    o->size = PASSED;
    if (!(size < INFINITY)) o->outcome = DIVERGED;
    else if (o->done == o->most) o->outcome = TOO_SLOW;
}

/* Take notice of one more increment; ``still``: it moved nothing beyond roundoff. */
EXPORT void judge_increment(Convergence *o, double size, int still)
{
    const int k = o->done++, told = k && o->size != PASSED;
    const double last = o->size;
    o->size = size;
    o->greatest = fmax(size, o->greatest);
    if (!(size < INFINITY)) {
        o->outcome = DIVERGED;
        return;
    }

    if (told) {
        double ratio = last > 0.0 ? fmin(size / last, o->largest) : 0.0;
        o->theta = k > 1 && o->averaged ? sqrt(ratio * fmax(o->theta, 1e-10)) : ratio;
        if (is_roundoff(o, k, ratio, size, last, still)) o->size = size = 0.0;
        else if (o->theta >= o->limit && size > o->tolerance && (o->adaptive || k > 3)) o->outcome = DIVERGED;
    }
    o->share = k && !told ? 1.0 : share_left(o, k);
    if (o->outcome == DIVERGED) return;

    double left = o->share * size;
    if (left <= o->tolerance || size <= 1e-2 * o->tolerance) o->outcome = CONVERGED;
    else if (o->done == o->most) o->outcome = TOO_SLOW;
    else if (o->foresees && k > 1 && left * pow(o->theta, o->most - o->done) > o->tolerance) o->outcome = TOO_SLOW;
}
