/* Efforts on coordinates by formulas with a name: motors, PID controllers, dry friction, smooth friction, stops,
   and the unit effort of a coordinate that is an energy. The formulas are
   those of mechanics/forces/effort_laws.py, mechanics/forces/dry_friction.py and system/control/controllers.py; x: elongation. */

enum { SERVO, PID, DRY, SMOOTH, STOP, POTENTIAL };
enum { FORMULA_WIDTH = 6, MEMORY = 3 };

/* k x + c x' within +- limit, with its slopes. */
static double cut(double effort, double limit, double *k, double *c)
{
    if (fabs(effort) < limit) return effort;
    *k = *c = 0.0;
    return effort > 0 ? limit : -limit;
}

/* Dry friction, sticking below its limit; a point that was dragged lies on it, and roundoff does not decide: it slides. */
static double friction(double effort, double limit, double *k, double *c)
{
    if (fabs(effort) > (1.0 - 1e-9) * limit) *k = *c = 0.0;
    return fmax(-limit, fmin(limit, effort));
}

/* A motor with integral part: its memory z grows by the trapezoidal rule from what was kept, so the effort is linear until cut. */
static double pid_effort(const double *p, const double *kept, double x, double rate, double t, double *k, double *c)
{
    double half = 0.5 * (t - kept[2]);
    *k = p[0] + p[3] * half;
    *c = p[1];
    return cut(*k * (x - p[4]) + p[1] * (rate - p[5]) - p[3] * (kept[0] + half * kept[1]), p[2], k, c);
}

/* The memory z and its growth g after a step; where the effort u is cut, what is cut off is fed back into g. */
static void pid_keep(const double *p, double *kept, double x, double rate, double t)
{
    double half = 0.5 * (t - kept[2]), k, c, error = p[4] - x;
    double u = -pid_effort(p, kept, x, rate, t, &k, &c), z = kept[0] + half * (kept[1] + error), growth = error;
    double push = p[0] * error + p[1] * (p[5] - rate);

    if (fabs(push + p[3] * z) > p[2]) {
        z = (kept[0] + half * (kept[1] + error + (u - push) / p[0])) / (1.0 + half * p[3] / p[0]);
        growth = error + (u - push - p[3] * z) / p[0];
    }
    kept[0] = z;
    kept[1] = growth;
    kept[2] = t;
}

static double smooth_effort(const double *p, double rate, double *c)
{
    double y = rate / p[3], peak = (p[2] - p[0]) * exp(-y * y), bent = tanh(rate / p[1]);
    *c = (p[0] + peak) * (1.0 - bent * bent) / p[1] - 2.0 * y / p[3] * peak * bent + p[4];
    return (p[0] + peak) * bent + p[4] * rate;
}

static double depth_of(const double *p, double x)
{
    return fmax(x - p[1], 0.0) + fmin(x - p[0], 0.0);
}

static double stop_effort(const double *p, double x, double rate, double *k, double *c)
{
    double depth = depth_of(p, x), damping = p[3] * fmin(fabs(depth) / p[4], 1.0), effort = p[2] * depth + damping * rate;
    *k = *c = 0.0;
    if (!(effort * depth > 0.0)) return 0.0;
    *k = p[2] + (fabs(depth) < p[4] ? copysign(p[3] / p[4], depth) * rate : 0.0);
    *c = damping;
    return effort;
}

/* The effort of item i at its s and s', and its slopes. */
void formula(Batch *k, long i, double t)
{
    const double *p = k->constants + FORMULA_WIDTH * i, *kept = k->kept + MEMORY * i;
    double x = k->s[i] - k->free[i], rate = k->rate[i], *slope = k->stiffness + i, *drag = k->damping + i;
    switch (k->formula) {
    case PID: k->effort[i] = pid_effort(p, kept, x, rate, t, slope, drag); return;
    case SMOOTH: k->effort[i] = smooth_effort(p, rate, drag); return;
    case STOP: k->effort[i] = stop_effort(p, x, rate, slope, drag); return;
    case POTENTIAL: k->effort[i] = 1.0; *slope = *drag = 0.0; return;
    }
    *slope = p[0];
    *drag = p[1];
    if (k->formula == SERVO) k->effort[i] = cut(p[0] * (x - p[4]) + p[1] * (rate - p[5]), p[2], slope, drag);
    else k->effort[i] = friction(p[0] * (x - kept[0]) + p[1] * rate, p[2], slope, drag);
}

/* Where dry friction sticks if a step ends at the s, s' and effort of the last evaluation. */
static double dragged(const Batch *k, long i)
{
    const double *p = k->constants + FORMULA_WIDTH * i, x = k->s[i] - k->free[i], was = k->kept[MEMORY * i];
    if (!(fabs(p[0] * (x - was) + p[1] * k->rate[i]) > p[2])) return was;
    return x - (k->effort[i] - p[1] * k->rate[i]) / p[0];
}

/* Whether dry friction pushes along the motion at the end of a step of h: it turned within, by more than its spring gives. */
static int overruns(const Batch *k, long i, double h)
{
    const double *p = k->constants + FORMULA_WIDTH * i, rate = k->rate[i];
    double effort = p[0] * (k->s[i] - k->free[i] - k->kept[MEMORY * i]) + p[1] * rate;
    return fabs(effort) > p[2] && effort * rate < 0.0 && p[0] * fabs(rate) * h > p[2];
}

/* What item i stores at the s, s' and effort of the last evaluation, J. */
static double stored(const Batch *k, long i)
{
    const double *p = k->constants + FORMULA_WIDTH * i;
    double x = k->s[i] - k->free[i], stretch;
    if (k->formula == STOP) return 0.5 * p[2] * depth_of(p, x) * depth_of(p, x);
    if (k->formula == POTENTIAL) return x;
    if (k->formula != DRY) return 0.0;
    stretch = fmin(fabs(x - dragged(k, i)), p[2] / p[0]); /* while it slides p runs ahead: nothing is stored there */
    return 0.5 * p[0] * stretch * stretch;
}

/* Whether an effort of a law in Python is not what its slopes in the matrix foretell. */
static int surprises(const System *s, const Batch *k, long i)
{
    const double *known = k->known + 3 * i;
    double change = k->effort[i] - known[2], foretold = k->stiffness[i] * (k->s[i] - known[0]) + k->damping[i] * (k->rate[i] - known[1]);
    if (k->linked) foretold = foretold_effort(s, k) - known[2];
    return fabs(change - foretold) > 0.02 * fmax(fabs(change), fabs(foretold)) + 1e-12 * fabs(k->effort[i]);
}

/* Whether the slopes at the last evaluation are others than those in the matrix. */
int other_slopes(const System *s, double cd, double ck)
{
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role == LAW && k->sloped == s->evaluations) return 1;
        for (long i = 0; k->role == LAW && i < k->n; i++)
            if (surprises(s, k, i)) return 1;
    }
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++)
        for (long i = 0; k->role == FORMULA && i < k->n; i++) {
            double slope = ck * k->stiffness[i] + cd * k->damping[i];
            if (fabs(slope - k->slope[i]) > 0.01 * fmax(fabs(slope), fabs(k->slope[i]))) return 1;
        }
    return 0;
}
