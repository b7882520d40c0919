/* Bushings, equation (1) of mechanics/forces/bushing.py: s and s' of two markers, an effort K s + C s' on all components at once. */

enum { MOUNT_ROWS = D + ROT };
enum { MOUNT_P = 0, MOUNT_TA = D, MOUNT_Q = D + D * D, MOUNT_TB = 2 * D + D * D, MOUNT_K = 2 * (D + D * D),
       MOUNT_C = MOUNT_K + MOUNT_ROWS * MOUNT_ROWS };      /* where places, turns, K and C begin among the constants */

typedef struct {
    double s[MOUNT_ROWS], rate[MOUNT_ROWS], effort[MOUNT_ROWS];
    double row[MOUNT_ROWS][2 * TWIST];                     /* s' from the twists of both frames, world axes */
    double axes[D * D], arm[D], lever[D];                  /* of marker a; from the origins of both frames to marker b */
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
    double *Ra = m->axes, *la = m->arm, *lb = m->lever, Rb[D * D], R[D * D], arm[D], rate[ROT * ROT], out[ROT], back[D];
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

/* Efforts into the residuals; what was evaluated is kept for the tangent. */
static void mount_forces(System *s, const Batch *k)
{
    for (long i = 0; i < k->n; i++) {
        Mount m, *kept = (Mount *)k->known + i;
        mount_at(s, k, i, &m);
        *kept = m;
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

#if DIM == 3
/* c of the matrix in rotation_vector as a function of the square of the angle, and its derivative. */
static double curl(double square, double *slope)
{
    if (square < 1e-2) {
        *slope = 1.0 / 720 + square * (1.0 / 15120 + square * (1.0 / 403200 + square / 11975040));
        return 1.0 / 12 + square * (1.0 / 720 + square * (1.0 / 30240 + square * (1.0 / 1209600 + square / 47900160)));
    }
    double angle = sqrt(square), half = 0.5 * angle, sine = sin(half), cotangent = cos(half) / sine, open = 1 - half * cotangent;
    *slope = -(cotangent - half / (sine * sine)) / (4 * angle * square) - open / (square * square);
    return open / square;
}

/* What turning by dtheta of the rotation vector does to the torque of the rows, world axes; torque: efforts about the axes. */
static void torque_turns(const Mount *m, const double *dtheta, double *out)
{
    const double *theta = m->s + D, *torque = m->effort + D;
    double slope, c = curl(dot(theta, theta, 3), &slope), local[3], across[3];
    double along = dot(theta, torque, 3), forward = dot(theta, dtheta, 3), pulled = dot(dtheta, torque, 3);
    spin(dtheta, torque, across);
    for (int i = 0; i < 3; i++) {
        double bent = theta[i] * along - dot(theta, theta, 3) * torque[i];
        local[i] = 0.5 * across[i] + c * (dtheta[i] * along + theta[i] * pulled - 2 * forward * torque[i]) + 2 * slope * forward * bent;
    }
    times(m->axes, local, out);
}
#endif

/* The change of effort . rows, at constant efforts, with a small displacement of both frames. With the force F and the torque T on
   b, the levers r from a and l from b, and rotations p of the frames:

       dF = p_a x F,   d(l x F) = (p_b x l) x F + l x dF,   d(r x F) = (dx_b + p_b x l - dx_a) x F + r x dF,
       dT = p_a x T + R_a (dH / dtheta)^T tau                                                                  (2) */
static void mount_change(const Mount *m, const double *force, const double *torque, const double *moved, double *out)
{
    const double *xa = moved, *pa = moved + D, *xb = moved + TWIST, *pb = moved + TWIST + D;
    double dF[D], swing[D], apart[D], on_a[ROT], on_b[ROT], part[ROT], dT[ROT] = {0.0};
    spin(pa, force, dF);
    spin(pb, m->lever, swing);
    for (int i = 0; i < D; i++) apart[i] = xb[i] + swing[i] - xa[i];

#if DIM == 3
    double apart_turn[3], dtheta[3];
    for (int i = 0; i < 3; i++) apart_turn[i] = pb[i] - pa[i];
    for (int i = 0; i < 3; i++) dtheta[i] = dot(m->row[D + i] + TWIST + D, apart_turn, 3);
    torque_turns(m, dtheta, dT);
    spin(pa, torque, part);
    for (int i = 0; i < 3; i++) dT[i] += part[i];
#else
    (void)torque;
#endif

    moment(apart, force, on_a);
    moment(m->arm, dF, part);
    for (int i = 0; i < ROT; i++) on_a[i] += part[i] + dT[i];
    moment(swing, force, on_b);
    moment(m->lever, dF, part);
    for (int i = 0; i < ROT; i++) on_b[i] += part[i] + dT[i];

    for (int i = 0; i < D; i++) out[i] = -dF[i], out[TWIST + i] = dF[i];
    for (int i = 0; i < ROT; i++) out[D + i] = -on_a[i], out[TWIST + D + i] = on_b[i];
}

/* The geometric stiffness, weight times the symmetric part of (2), by the twist components from ``first`` up to ``end``. */
static void mount_curve(const Mount *m, int first, int end, double weight, double *C)
{
    double force[D] = {0.0}, torque[ROT] = {0.0};
    for (int r = 0; r < D; r++) add(force, m->effort[r], m->row[r] + TWIST, D);
    for (int r = D; r < MOUNT_ROWS; r++) add(torque, m->effort[r], m->row[r] + TWIST + D, ROT);

    for (int c = first; c < end; c++) {
        double moved[2 * TWIST] = {0.0}, change[2 * TWIST];
        moved[c] = 1.0;
        mount_change(m, force, torque, moved, change);
        for (int j = first; j < end; j++) {
            C[2 * TWIST * j + c] += 0.5 * weight * change[j];
            C[2 * TWIST * c + j] += 0.5 * weight * change[j];
        }
    }
}

/* The symmetric part of the tangent of all bushings, as they were evaluated last, into the fronts. */
static void mount_tangents(System *s, const Batch *k, double cd, double ck, double geometric)
{
    for (long i = 0; i < k->n; i++) {
        const double *K = k->P + k->width * i + MOUNT_K, *B = k->P + k->width * i + MOUNT_C;
        double C[4 * TWIST * TWIST] = {0.0}, weight[MOUNT_ROWS][MOUNT_ROWS], pulled[MOUNT_ROWS][2 * TWIST] = {{0.0}};
        const int *pair = k->pair + 2 * i, first = pair[0] == s->bodies ? TWIST : 0; /* the ground does not move */
        const int end = pair[1] == s->bodies ? TWIST : 2 * TWIST, wide = end - first;
        const Mount m = ((const Mount *)k->known)[i];
        for (int r = 0; r < MOUNT_ROWS; r++)
            for (int c = 0; c < MOUNT_ROWS; c++) {
                int one = MOUNT_ROWS * r + c, other = MOUNT_ROWS * c + r;
                weight[r][c] = 0.5 * (ck * (K[one] + K[other]) + cd * (B[one] + B[other]));
                if (weight[r][c] != 0.0) add(pulled[r] + first, weight[r][c], m.row[c] + first, wide);
            }
        for (int j = first; j < end; j++)
            for (int r = 0; r < MOUNT_ROWS; r++) add(C + 2 * TWIST * j + first, m.row[r][j], pulled[r] + first, wide);
        if (geometric != 0.0) mount_curve(&m, first, end, geometric, C);
        mapped_square(s, k, i, C);
    }
}
