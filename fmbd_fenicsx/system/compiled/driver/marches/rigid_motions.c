/* What nodes of rods and frames of elastic bodies do beside the rigid motion of their body, schemes/rigid_motions.py: norms of errors weigh it
   apart. */

#if DIM == 3
static const double ARM = 1e-2; /* of a rod's size, by which rotations count */

/* A basis of the weighted rigid motions of a rod as it lies, six columns of 6 numbers a node, behind the weight of rotations. */
static void rigid_motions(const System *s, const Rod *r, double *basis)
{
    const int rows = TWIST * r->nodes;
    double mean[3] = {0.0, 0.0, 0.0}, size = 0.0;
    for (int i = 0; i < r->nodes; i++) add(mean, 1.0 / r->nodes, s->frames + (long)FRAME * r->loaded[i], 3);
    for (int i = 0; i < r->nodes; i++)
        for (int k = 0; k < 3; k++) size = fmax(size, fabs(s->frames[(long)FRAME * r->loaded[i] + k] - mean[k]));
    *basis++ = ARM * size;

    memset(basis, 0, (size_t)6 * rows * sizeof(double));
    for (int i = 0; i < r->nodes; i++) {
        const double *frame = s->frames + (long)FRAME * r->loaded[i];
        double arm[3];
        for (int k = 0; k < 3; k++) arm[k] = frame[k] - mean[k];

        for (int k = 0; k < 3; k++) {
            double axis[3] = {k == 0, k == 1, k == 2}, *shift = basis + k * rows + TWIST * i, *turn = shift + 3L * rows;
            shift[k] = 1.0;
            moment(axis, arm, turn);
            to_body(frame + TURN, axis, turn + 3);
            for (int l = 3; l < 6; l++) turn[l] *= ARM * size;
        }
    }

    /* orthonormal, twice for roundoff */
    for (int k = 0; k < 6; k++) {
        double *column = basis + (long)k * rows;
        for (int l = 0; l < 2 * k; l++) {
            const double *other = basis + (long)(l % k) * rows;
            add(column, -dot(other, column, rows), other, rows);
        }
        double length = sqrt(dot(column, column, rows));
        for (int i = 0; i < rows; i++) column[i] /= length;
    }
}

/* What velocities of the nodes of one rod have beside rigid motions, behind the weight. */
static void bend_rod(const Rod *r, const double *basis, const double *v, double *bent)
{
    const int rows = TWIST * r->nodes;
    const double weight = *basis++;
    double share[6] = {0.0};
    for (int k = 0; k < 6; k++)
        for (int i = 0; i < rows; i++)
            share[k] += basis[(long)k * rows + i] * v[TWIST * r->loaded[i / TWIST] + i % TWIST] * (i % TWIST < 3 ? 1.0 : weight);

    for (int i = 0; i < rows; i++) {
        const long at = TWIST * r->loaded[i / TWIST] + i % TWIST;
        double rigid = 0.0;
        for (int k = 0; k < 6; k++) rigid += basis[(long)k * rows + i] * share[k];
        bent[at] = v[at] - rigid / (i % TWIST < 3 ? 1.0 : weight);
    }
}
#endif

/* Numbers of a basis. */
static long basis_size(const Rod *r) { return 1 + 36L * r->nodes; }

/* Whether a frame moves against the mass of its body: those of mean axes do not. */
static int hangs(const Body *o) { return o->mean_rates != NULL; }

/* What velocities of a frame with this rotation have beside the smaller one of them and of those of the body's mass. */
static void bend_frame(const Body *o, const double *R, const double *v, const double *frame, double *bent)
{
    const long n = o->field ? o->field->n : o->modes;
    double own[TWIST], mean[TWIST];
    for (int i = 0; i < TWIST; i++) mean[i] = own[i] = dot(o->mean_rates + i * n, v + o->at_v, n);
    times(R, own, mean);
    for (int i = 0; i < TWIST; i++) bent[i] = fabs(frame[i] + mean[i]) < fabs(frame[i]) ? -mean[i] : 0.0;
}

/* The bases of all rods in a configuration, and the rotations of such frames behind them. */
static int take_bases(System *s, const Norm *o, const double *q, const double *v)
{
    int verdict = o->bases ? place(s, q, v) : DONE;
    double *basis = o->bases;
#if DIM == 3
    for (const Rod *r = s->rod; basis && !verdict && r < s->rod + s->rods; basis += basis_size(r++)) rigid_motions(s, r, basis);
#endif
    for (int b = 0; basis && !verdict && b < s->bodies; b++) {
        if (!hangs(s->body + b)) continue;
        rotation(q + POSE * b, basis);
        basis += D * D;
    }
    return verdict;
}

/* What velocities of rods and frames have beside rigid motions; zero elsewhere. */
static void bend(const System *s, const Norm *o, const double *v, double *bent)
{
    memset(bent, 0, o->n * sizeof(double));
    const double *basis = o->bases;
#if DIM == 3
    for (const Rod *r = s->rod; r < s->rod + s->rods; basis += basis_size(r++)) bend_rod(r, basis, v, bent);
#endif
    for (int b = 0; b < s->bodies; b++) {
        if (!hangs(s->body + b)) continue;
        bend_frame(s->body + b, basis, v, v + TWIST * b, bent + TWIST * b);
        basis += D * D;
    }
}
