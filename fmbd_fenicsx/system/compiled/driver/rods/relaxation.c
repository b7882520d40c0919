/* Viscoelastic arms of rods, formulas (1) and (2) of mechanics/rods/relaxation.py. A memory is a time, the strains (6 a point) and those of
   the dashpots (6 a point and arm); ``kept`` holds that of the last step, and that of the step before. */

/* An arm within a step: E and f of (2), what was kept at its start. */
typedef struct {
    double E, f;
    const double *strain, *inner, *C;
} Arm;

static long memory_size(const Rod *k) { return 1 + STRAINS * k->n * k->points * (1 + k->arms); }

/* What a time is counted from: times between two steps belong to the earlier one, where it is known. */
static const double *memory_at(const Rod *k, double t)
{
    const double *before = k->kept + memory_size(k);
    return t < k->kept[0] && !isnan(before[0]) ? before : k->kept;
}

static Arm arm_at(const Rod *k, int arm, double t)
{
    const double *memory = memory_at(k, t);
    const long all = STRAINS * k->n * k->points;
    double x = (t - memory[0]) / k->tau[arm];
    Arm o = {exp(-x), x > 0.0 ? 1.0 + expm1(-x) / x : 0.0, memory + 1, memory + 1 + all * (1 + arm), k->arm + STRAINS * all * arm};
    return o;
}

/* The strain of a dashpot whose point is under the strain e. */
static double dashpot(const Arm *o, long at, double e)
{
    return o->E * o->inner[at] + (1.0 - o->E) * o->strain[at] + o->f * (e - o->strain[at]);
}

/* Strain and force of the spring of an arm at a point. */
static void arm_spring(const Rod *k, const Arm *o, long at, double *stretch, double *force)
{
    for (int j = 0; j < STRAINS; j++) {
        double e = k->strain[STRAINS * at + j];
        stretch[j] = e - dashpot(o, STRAINS * at + j, e);
    }
    for (int j = 0; j < STRAINS; j++) force[j] = dot(o->C + STRAINS * (STRAINS * at + j), stretch, STRAINS);
}

/* Forces of all arms at all points, beside those of the section. */
static void relaxing_stress(Rod *k, double t)
{
    double stretch[STRAINS], force[STRAINS];
    for (int i = 0; i < k->arms; i++) {
        Arm o = arm_at(k, i, t);
        for (long at = 0; at < k->n * k->points; at++) {
            arm_spring(k, &o, at, stretch, force);
            add(k->S + STRAINS * at, 1.0, force, STRAINS);
        }
    }
}

/* Energy in the springs, J. */
static double relaxing_energy(const Rod *k, double t)
{
    double sum = 0.0, stretch[STRAINS], force[STRAINS];
    for (int i = 0; i < k->arms; i++) {
        Arm o = arm_at(k, i, t);
        for (long at = 0; at < k->n * k->points; at++) {
            arm_spring(k, &o, at, stretch, force);
            sum += 0.5 * k->weight[at] * dot(stretch, force, STRAINS);
        }
    }
    return sum;
}

/* Adds the stiffness of all arms at a point, by the shares 1 - f of their springs that follow, to C. */
static void relaxing_stiffness(const Rod *k, long at, double scale, double *C)
{
    const long each = STRAINS * STRAINS;
    for (int i = 0; i < k->arms; i++) add(C, scale * k->follows[i], k->arm + each * (k->n * k->points * i + at), each);
}

/* The memory after a step that ended at t with the strains at hand. */
static void relaxed(Rod *k, double t)
{
    const long all = STRAINS * k->n * k->points;
    memcpy(k->kept + memory_size(k), k->kept, memory_size(k) * sizeof(double));
    for (int i = 0; i < k->arms; i++) {
        Arm o = arm_at(k, i, t);
        for (long j = 0; j < all; j++) k->kept[1 + all * (1 + i) + j] = dashpot(&o, j, k->strain[j]);
    }
    memcpy(k->kept + 1, k->strain, all * sizeof(double));
    k->kept[0] = t;
}
