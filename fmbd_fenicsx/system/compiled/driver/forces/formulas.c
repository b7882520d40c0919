/* Efforts on coordinates by formulas with a name: motors, PID controllers, dry friction, smooth friction, stops,
   and the unit effort of a coordinate that is an energy. The formulas are
   those of mechanics/forces/effort_laws.py, mechanics/forces/dry_friction.py and system/control/controllers.py; x: elongation. */

enum { SERVO, PID, DRY, SMOOTH, STOP, POTENTIAL };
enum { FORMULA_WIDTH = 6 };

static PidMemory *integral_of(const Batch *k, long i) { return (PidMemory *)(k->kept + MEMORY * i); }

/* k x + c x' within +- limit, with its slopes. */
static double cut(double effort, double limit, double *k, double *c)
{
    if (fabs(effort) < limit) return effort;
    *k = *c = 0.0;
    return effort > 0 ? limit : -limit;
}

/* What dry friction keeps, as dry_friction.py: the point p where it sticks, the time since which, and both before the last step, or the
   last part of it; on which side it slid last, steps since it came there, and how often it went back at once; where its spring
   ended and x' then, and the largest sizes of x and x' so far; and here the same as it was when a step began. */
enum { STUCK, SINCE, STUCK_BEFORE, BEGAN, SIDE, AGO, CHATTERED, END, PACE, REACH, FASTEST, DRAGGED };
static const double AT_ONCE = 2.0; /* steps */

static const double WITHIN = 1e-9; /* share of the last step by which its end is not within it */

/* p at a time t: within the last step that of its beginning. */
static double stuck(const double *kept, double t)
{
    return kept[t < kept[SINCE] - WITHIN * (kept[SINCE] - kept[BEGAN]) ? STUCK_BEFORE : STUCK];
}

/* Dry friction, sticking below its limit; a point that was dragged lies on it, and roundoff does not decide: it slides. */
static double friction(double effort, double limit, double roundoff, double *k, double *c)
{
    if (fabs(effort) > (1.0 - 1e-9) * limit - roundoff) *k = *c = 0.0;
    return fmax(-limit, fmin(limit, effort));
}

/* The integral where it is known whatever the motion: at points of the step under way, and in the last step, on the cubic through its
   ends. */
static int known_integral(const PidMemory *m, double t, double *z)
{
    for (int j = 0; j < (int)m->points; j++)
        if (m->when[j] == t) {
            *z = m->then[j];
            return 1;
        }
    if (!(m->count > 0.0 && m->times[0] <= t && t < m->t)) return 0;
    const double h = m->t - m->times[0], x = (t - m->times[0]) / h, rise = m->z - m->values[0];
    *z = m->values[0] + x * rise + x * (1.0 - x) * ((1.0 - x) * (h * m->before - rise) - x * (h * m->rate - rise));
    return 1;
}

/* A motor with integral part: its memory z is found at the points of a step, or grows by the trapezoidal rule from what was kept, so the
   effort is linear until cut. */
static double pid_effort(const double *p, const PidMemory *m, double x, double rate, double t, double *k, double *c)
{
    double half = 0.5 * (t - m->t), z;
    *k = p[0] + p[3] * half;
    *c = p[1];
    if (known_integral(m, t, &z)) return cut(p[0] * (x - p[4]) + p[1] * (rate - p[5]) - p[3] * z, p[2], k, c);
    return cut(*k * (x - p[4]) + p[1] * (rate - p[5]) - p[3] * (m->z + half * m->rate), p[2], k, c);
}

/* z' with its slope by z, for an error and its rate; where the effort is cut, what is cut off is fed back. */
static double integral_rate(const double *p, double z, double error, double speed, double *slope)
{
    double free = p[0] * error + p[1] * speed + p[3] * z, u = fmax(-p[2], fmin(p[2], free));
    *slope = u == free ? 0.0 : -p[3] / p[0];
    return u == free ? error : error + (u - free) / p[0];
}

/* Where a step has ended, or on the line back from the last one where none has. */
static double integral_behind(const PidMemory *m, double t)
{
    for (int i = 0; i < (int)m->count; i++)
        if (m->times[i] == t) return m->values[i];
    return m->z + (t - m->t) * m->rate;
}

/* The integral at the points of a step, whose errors and speeds it knows: straight but for cuts. */
static int find_integral(const double *p, PidMemory *m, const Remembered *r)
{
    const int n = r->points;
    double A[MOST_STAGES * MOST_STAGES], b[MOST_STAGES], slope[MOST_STAGES], before[MOST_STAGES] = {NAN};
    m->points = 0.0;
    for (int j = 0; j < n; j++) {
        m->when[j] = r->t[j];
        m->then[j] = m->z + (r->t[j] - m->t) * m->rate;
    }

    for (int tries = 0, same = 0; tries < 8 && !same; tries++) {
        same = tries > 0;
        for (int j = 0; j < n; j++) {
            b[j] = integral_rate(p, m->then[j], m->error[j], m->speed[j], slope + j);
            same &= slope[j] == before[j];
            before[j] = slope[j];

            for (int i = 0; i < n; i++) {
                A[j * n + i] = r->couple[j * n + i] - (i == j ? slope[j] : 0.0);
                b[j] -= r->couple[j * n + i] * m->then[i];
            }
            for (int l = 0; l < r->ends; l++) b[j] -= r->past[j * r->ends + l] * integral_behind(m, r->end[l]);
        }

        if (solve_dense(A, n, b, 1, 1, 0.0)) return SINGULAR;
        for (int j = 0; j < n; j++) m->then[j] += b[j];
    }

    m->points = n;
    m->slope = slope[n - 1];
    return DONE;
}

/* What errors of the integral are measured by, in a step that ends at t with z. */
static double integral_size(const PidMemory *m, double t, double z)
{
    return fmax(fmax(m->size, fabs(m->z)), fmax(fabs(z), (t - m->t) * fmax(fabs(m->rate), m->reach)));
}

/* Its error in the step under way, over the tolerance; none where no effort feels it. */
static double integral_error(const double *p, const PidMemory *m, const Remembered *r)
{
    const int last = (int)m->points - 1;
    double off = r->of_rate * m->rate, allowed;
    if (last < 0 || p[3] == 0.0) return 0.0;
    for (int j = 0; j <= last; j++) off += r->of_points[j] * m->then[j];
    for (int l = 0; l < r->ends; l++) off += r->of_ends[l] * integral_behind(m, r->end[l]);
    if (r->frequency > 0.0) off /= r->frequency - m->slope;
    allowed = r->rtol * integral_size(m, m->when[last], m->then[last]) + r->atol;
    return allowed > 0.0 ? fabs(off) / allowed : 0.0;
}

/* The memory z and its growth g at the end of a step. */
static double integral_end(const double *p, const PidMemory *m, double x, double rate, double t, double *growth)
{
    double half = 0.5 * (t - m->t), k, c, error = p[4] - x, z, slope;
    int point = m->points > 0.0 && m->when[(int)m->points - 1] == t;

    *growth = error;
    if (point) {
        z = m->then[(int)m->points - 1];
        *growth = integral_rate(p, z, error, p[5] - rate, &slope);
    } else {
        double u = -pid_effort(p, m, x, rate, t, &k, &c), push = p[0] * error + p[1] * (p[5] - rate);
        z = m->z + half * (m->rate + error);
        if (fabs(push + p[3] * z) > p[2]) {
            z = (m->z + half * (m->rate + error + (u - push) / p[0])) / (1.0 + half * p[3] / p[0]);
            *growth = error + (u - push - p[3] * z) / p[0];
        }
    }
    return z;
}

/* What the trapezoidal rule misses of the integral, over the tolerance: LawWithMemory.trapezoid_error. */
static double integral_missed(const double *p, const PidMemory *m, double x, double rate, double t, double rtol, double atol)
{
    double growth, slope, h = t - m->t, z = integral_end(p, m, x, rate, t, &growth);
    const int begun = m->count > 0.0;
    const double before = begun ? m->t - m->times[0] : h, bend = (growth - m->rate) / h - (begun ? (m->rate - m->before) / before : 0.0);
    const double allowed = rtol * integral_size(m, t, z) + atol;
    if (p[3] == 0.0 || !(allowed > 0.0)) return 0.0;
    integral_rate(p, z, p[4] - x, p[5] - rate, &slope);
    return fabs(h * h * h / 6.0 * bend / (h + before)) / (1.0 - 0.5 * h * slope) / allowed;
}

/* Take up the end of a step. */
static void pid_keep(const double *p, PidMemory *m, double x, double rate, double t)
{
    double growth, z = integral_end(p, m, x, rate, t, &growth);
    m->size = integral_size(m, t, z);
    if (t > m->t) {
        for (int i = PAST - 1; i > 0; i--) {
            m->times[i] = m->times[i - 1];
            m->values[i] = m->values[i - 1];
        }
        m->times[0] = m->t;
        m->values[0] = m->z;
        m->before = m->rate;
        m->count = fmin(m->count + 1.0, PAST);
    }

    m->z = z;
    m->rate = growth;
    m->t = t;
    m->points = 0.0;
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
    case PID: k->effort[i] = pid_effort(p, integral_of(k, i), x, rate, t, slope, drag); return;
    case SMOOTH: k->effort[i] = smooth_effort(p, rate, drag); return;
    case STOP: k->effort[i] = stop_effort(p, x, rate, slope, drag); return;
    case POTENTIAL: k->effort[i] = 1.0; *slope = *drag = 0.0; return;
    }
    *slope = p[0];
    *drag = p[1];

    if (k->formula == SERVO) k->effort[i] = cut(p[0] * (x - p[4]) + p[1] * (rate - p[5]), p[2], slope, drag);
    else {
        const double sticks = stuck(kept, t), trial = p[0] * (x - sticks) + p[1] * rate;
        const double roundoff = 1.8e-15 * p[0] * (fabs(x) + fabs(sticks));
        const int elsewhere = t < kept[BEGAN] && fabs(trial) > p[2]; /* an earlier part of the step slid to where the next one began */
        k->effort[i] = friction(elsewhere ? copysign(trial, rate) : trial, p[2], roundoff, slope, drag);
    }
}

/* Where the spring of dry friction ends at the s and s' of the last evaluation. */
static double friction_end(const Batch *k, long i)
{
    const double *p = k->constants + FORMULA_WIDTH * i;
    return k->s[i] - k->free[i] + p[1] / p[0] * k->rate[i];
}

/* Where it sticks behind a spring that ends there, and has stuck in ``was``. */
static double dragged(const double *p, double was, double end)
{
    return fabs(end - was) > p[2] / p[0] ? end - copysign(p[2] / p[0], end - was) : was;
}

/* Dry friction takes up a step that ends at t, likewise. */
static void friction_keep(const Batch *k, long i, double t)
{
    double *kept = k->kept + MEMORY * i;
    const double *c = k->constants + FORMULA_WIDTH * i, end = friction_end(k, i), p = dragged(c, stuck(kept, t), end);
    /* where it slid p moved by more than its spring gives */
    const int slid = c[0] * fabs(p - kept[STUCK]) > c[2], back = slid && kept[SIDE] * k->effort[i] < 0.0;
    if (back && kept[AGO] <= AT_ONCE) kept[CHATTERED] += 1.0;
    kept[AGO] = back ? 1.0 : kept[AGO] + 1.0;
    if (slid) kept[SIDE] = copysign(1.0, k->effort[i]);

    if (t > kept[SINCE]) {
        kept[STUCK_BEFORE] = kept[STUCK];
        kept[BEGAN] = kept[SINCE];
    }
    kept[STUCK] = p;
    kept[SINCE] = t;
    kept[END] = end;
    kept[PACE] = k->rate[i];
    kept[REACH] = fmax(kept[REACH], fabs(k->s[i] - k->free[i]));
    kept[FASTEST] = fmax(kept[FASTEST], fabs(k->rate[i]));
}

/* What dry friction keeps where a step begins: kept, or put back. */
void hold_friction(System *s, int back)
{
    for (Batch *k = s->batch; k < s->batch + s->batches; k++)
        for (long i = 0; k->role == FORMULA && k->formula == DRY && i < k->n; i++) {
            double *kept = k->kept + MEMORY * i;
            memcpy(kept + (back ? STUCK : DRAGGED), kept + (back ? DRAGGED : STUCK), DRAGGED * sizeof(double));
        }
}

/* Dry friction takes up a part of a step that ends at t, before an impact; frames are placed. */
void drag_friction(System *s, double t)
{
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->told || k->role != FORMULA || k->formula != DRY) continue;
        values(s, k);
        efforts(s, k, t);
        for (long i = 0; i < k->n; i++) friction_keep(k, i, t);
    }
}

/* Whether dry friction has turned within a step of h, farther from its ends than a share of its largest sizes, as dry_friction.py. */
static int overruns(const Batch *k, long i, double h, double share)
{
    const double *p = k->constants + FORMULA_WIDTH * i, *kept = k->kept + MEMORY * i, most = p[2] / p[0], end = friction_end(k, i);
    const double leads = p[1] / p[0] * (k->rate[i] - kept[PACE]) / h, first = kept[PACE] + leads, last = k->rate[i] + leads;
    if (!(first * last < 0.0)) return 0;
    const double slows = 0.5 * h / (first - last), ahead = kept[END] + slows * first * first, behind = end + slows * last * last;
    const double turn = first > 0.0 ? fmax(ahead, behind) : fmin(ahead, behind);
    const double way = fmin(fabs(dragged(p, kept[STUCK], turn) - kept[STUCK]), fabs(turn - end));
    const double gained = fmin(fabs(first), fabs(last)) * fmin(0.5 * way / most, 1.0);
    return way > share * fmax(kept[REACH], most) || gained > share * fmax(kept[FASTEST], fabs(k->rate[i]));
}

/* What item i stores at a time t, at the s, s' and effort of the last evaluation, J. */
static double stored(const Batch *k, long i, double t)
{
    const double *p = k->constants + FORMULA_WIDTH * i;
    double x = k->s[i] - k->free[i], stretch;
    if (k->formula == STOP) return 0.5 * p[2] * depth_of(p, x) * depth_of(p, x);
    if (k->formula == POTENTIAL) return x;
    if (k->formula != DRY) return 0.0;
    stretch = fabs(x - dragged(p, stuck(k->kept + MEMORY * i, t), friction_end(k, i)));
    stretch = fmin(stretch, p[2] / p[0]); /* while it slides p runs ahead: nothing is stored there */
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
