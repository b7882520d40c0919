/* Bushings, equation (1) of mechanics/forces/bushing.py: s and s' of two markers, an effort K s + C s' on all components at once. */

enum { MOUNT_ROWS = D + ROT };
enum { MOUNT_P = 0, MOUNT_TA = D, MOUNT_Q = D + D * D, MOUNT_TB = 2 * D + D * D, MOUNT_K = 2 * (D + D * D),
       MOUNT_C = MOUNT_K + MOUNT_ROWS * MOUNT_ROWS };      /* where places, turns, K and C begin among the constants */

typedef struct {
    double s[MOUNT_ROWS], rate[MOUNT_ROWS], effort[MOUNT_ROWS];
    double row[MOUNT_ROWS][2 * TWIST];                     /* s' from the twists of both frames, world axes */
} Mount;

#if DIM == 3
/* The rotation vector of R, and the matrix from angular velocities in its axes to its rate. */
static void rotation_vector(const double *R, double *theta, double *rate)
{
    double axis[3] = {0.5 * (R[7] - R[5]), 0.5 * (R[2] - R[6]), 0.5 * (R[3] - R[1])}, H[9], HH[9];
    double sine2 = dot(axis, axis, 3), cosine = 0.5 * (R[0] + R[4] + R[8] - 1.0), sine = sqrt(sine2), ratio, t2, c;
    if (sine2 < 1e-4 && cosine > 0)
        ratio = 1 + sine2 * (1.0 / 6 + sine2 * (3.0 / 40 + sine2 * (15.0 / 336 + sine2 * 105.0 / 3456)));
    else ratio = 2 * atan2(sine, 1 + cosine) / sine;
    for (int i = 0; i < 3; i++) theta[i] = ratio * axis[i];

    t2 = dot(theta, theta, 3);
    c = t2 < 1e-4 ? 1.0 / 12 + t2 * (1.0 / 720 + t2 / 30240) : (1 - 0.5 * sqrt(t2) / tan(0.5 * sqrt(t2))) / t2;
    hat(theta, H);
    product(H, H, HH);
    for (int i = 0; i < 9; i++) rate[i] = (i % 4 == 0) - 0.5 * H[i] + c * HH[i];
}
#else
static void rotation_vector(const double *R, double *theta, double *rate)
{
    theta[0] = 2 * atan2(R[2], 1 + R[0]);
    rate[0] = 1.0;
}
#endif

/* s and its rows for two frames (place and rotation of each). */
static void mount_rows(const double *a, const double *b, const double *P, Mount *m)
{
    double Ra[D * D], Rb[D * D], R[D * D], la[D], lb[D], arm[D], rate[ROT * ROT], out[ROT], back[D];
    product(a + TURN, P + MOUNT_TA, Ra);
    product(b + TURN, P + MOUNT_TB, Rb);
    times(a + TURN, P + MOUNT_P, la);
    times(b + TURN, P + MOUNT_Q, lb);
    for (int i = 0; i < D; i++) arm[i] = b[i] + lb[i] - a[i] - la[i];
    transposed(Ra, arm, m->s);

    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++) {
            R[D * i + j] = 0.0;
            for (int k = 0; k < D; k++) R[D * i + j] += Ra[D * k + i] * Rb[D * k + j];
        }
    rotation_vector(R, m->s + D, rate);

    /* displacements: -e on a, e on b with e an axis of a; e x (arm + lever) about the origin of a, lever x e about that of b */
    for (int j = 0; j < D; j++) la[j] += arm[j];
    for (int i = 0; i < D; i++) {
        double *row = m->row[i];
        for (int j = 0; j < D; j++) back[j] = Ra[D * j + i];
        for (int j = 0; j < D; j++) row[j] = -back[j], row[TWIST + j] = back[j];
        moment(la, back, out);
        for (int j = 0; j < ROT; j++) row[D + j] = -out[j];
        moment(lb, back, out);
        for (int j = 0; j < ROT; j++) row[TWIST + D + j] = out[j];
    }
    for (int i = 0; i < ROT; i++) {
        double *row = m->row[D + i];
        memset(row, 0, 2 * TWIST * sizeof(double));
        for (int j = 0; j < ROT; j++) {
            double turn = rate[0];
#if DIM == 3
            turn = 0.0;
            for (int k = 0; k < 3; k++) turn += rate[3 * i + k] * Ra[3 * j + k];
#endif
            row[D + j] = -turn;
            row[TWIST + D + j] = turn;
        }
    }
}

/* Everything of one bushing at the frames as they are. */
static void mount_at(const System *s, const Batch *k, long i, Mount *m)
{
    const double *P = k->P + k->width * i, *a = s->frames + FRAME * k->pair[2 * i], *b = s->frames + FRAME * k->pair[2 * i + 1];
    mount_rows(a, b, P, m);
    for (int r = 0; r < MOUNT_ROWS; r++) m->rate[r] = dot(m->row[r], a + SPEED, TWIST) + dot(m->row[r] + TWIST, b + SPEED, TWIST);
    for (int r = 0; r < MOUNT_ROWS; r++)
        m->effort[r] = dot(P + MOUNT_K + MOUNT_ROWS * r, m->s, MOUNT_ROWS) + dot(P + MOUNT_C + MOUNT_ROWS * r, m->rate, MOUNT_ROWS);
}

static void mount_forces(System *s, const Batch *k)
{
    for (long i = 0; i < k->n; i++) {
        Mount m;
        mount_at(s, k, i, &m);
        const int *at = k->at + 2 * TWIST * i;
        for (int r = 0; r < MOUNT_ROWS; r++)
            for (int j = 0; j < 2 * TWIST; j++) s->residual[at[j]] += m.effort[r] * m.row[r][j];
    }
}

static double mount_energy(const System *s, const Batch *k)
{
    double sum = 0.0;
    for (long i = 0; i < k->n; i++) {
        Mount m;
        mount_at(s, k, i, &m);
        for (int r = 0; r < MOUNT_ROWS; r++)
            sum += 0.5 * m.s[r] * dot(k->P + k->width * i + MOUNT_K + MOUNT_ROWS * r, m.s, MOUNT_ROWS);
    }
    return sum;
}

/* The geometric stiffness, weight times the derivative of effort . rows by displacements of the frames, by differences. */
static void mount_curve(const System *s, const Batch *k, long i, const Mount *m, double weight, double *C)
{
    const double step = 1e-7;
    for (int c = 0; c < 2 * TWIST; c++) {
        double frames[2][FRAME], w[ROT] = {0.0};
        for (int side = 0; side < 2; side++)
            memcpy(frames[side], s->frames + FRAME * k->pair[2 * i + side], FRAME * sizeof(double));
        double *x = frames[c / TWIST];
        if (c % TWIST < D) x[c % TWIST] += step;
        else {
            w[c % TWIST - D] = step;
            for (int j = 0; j < D; j++) { /* the columns of R turn with the frame */
                double column[D], turned[D];
                for (int r = 0; r < D; r++) column[r] = x[TURN + D * r + j];
                spin(w, column, turned);
                for (int r = 0; r < D; r++) x[TURN + D * r + j] += turned[r];
            }
        }
        Mount moved;
        mount_rows(frames[0], frames[1], k->P + k->width * i, &moved);
        for (int j = 0; j < 2 * TWIST; j++) {
            double change = 0.0;
            for (int r = 0; r < MOUNT_ROWS; r++) change += m->effort[r] * (moved.row[r][j] - m->row[r][j]);
            C[2 * TWIST * j + c] += 0.5 * weight / step * change;
            C[2 * TWIST * c + j] += 0.5 * weight / step * change;
        }
    }
}

/* The symmetric part of the tangent of all bushings into the fronts. */
static void mount_tangents(System *s, const Batch *k, double cd, double ck, double geometric)
{
    for (long i = 0; i < k->n; i++) {
        const double *K = k->P + k->width * i + MOUNT_K, *B = k->P + k->width * i + MOUNT_C;
        double C[4 * TWIST * TWIST] = {0.0}, weight[MOUNT_ROWS][MOUNT_ROWS], pulled[MOUNT_ROWS][2 * TWIST] = {{0.0}};
        Mount m;
        mount_at(s, k, i, &m);
        for (int r = 0; r < MOUNT_ROWS; r++)
            for (int c = 0; c < MOUNT_ROWS; c++) {
                int one = MOUNT_ROWS * r + c, other = MOUNT_ROWS * c + r;
                weight[r][c] = 0.5 * (ck * (K[one] + K[other]) + cd * (B[one] + B[other]));
                add(pulled[r], weight[r][c], m.row[c], 2 * TWIST);
            }
        for (int j = 0; j < 2 * TWIST; j++)
            for (int r = 0; r < MOUNT_ROWS; r++) add(C + 2 * TWIST * j, m.row[r][j], pulled[r], 2 * TWIST);
        if (geometric != 0.0) mount_curve(s, k, i, &m, geometric, C);
        mapped_square(s, k, i, C);
    }
}
