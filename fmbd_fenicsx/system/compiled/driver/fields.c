/* Elastic bodies, equations (1) and (2) of mechanics/bodies/floating.py, and how their fields leave the step's matrix.

   With H = [columns of inertia, ports] and the frame conditions C^T U = 0, C among the columns of H, the rows of a field are

       E dU + H f + C y = b,   C^T dU = -C^T U                                                                            (1)

   What acts on it is f = T t + J^T lambda + ..: the frame's increment t (T turns it into body axes), reactions and efforts on
   its surfaces. The frame conditions go with the field; for what the other rows see of it, p = H^T dU, this leaves

       p = pz - W f,   W = H^T E^-1 (H - C A^-1 C^T E^-1 H),   A = C^T E^-1 C,   so   S p + f = S pz,   S = W^-1          (2)

   and the body looks like a reduced one whose modes are the numbers H^T U and whose stiffness is S. Combinations of columns that
   do not move (the conditions themselves, moments along the normal of a flat surface) are given a small compliance in S: no dU
   follows from it, and what other rows see of it is closed by the next increment. Columns for which nothing was solved have no
   place in (2): sensors read them, and forces without a tangent act on them, see field_load().

   Bodies in absolute coordinates have a frame that rests: no columns of inertia, no conditions, and nothing moves the frame. With
   large strains E turns with the body, by T since its tangent was taken: E = T E_0 T^T node by node, and p, f, S turn likewise. */

#include "tables.h"
#include "rotations.c"
#include "parts.h"

static const double HELD = 1e100; /* stiffness of such a column, so that the others see none of it */

/* Four sums, so that the processor adds them at once. */
static double long_dot(const double *x, const double *y, long n)
{
    double sum[4] = {0.0};
    long i = 0;
    for (; i + 3 < n; i += 4)
        for (int j = 0; j < 4; j++) sum[j] += x[i + j] * y[i + j];
    for (; i < n; i++) sum[0] += x[i] * y[i];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* One number of H^T U */
static double column(const Field *e, int k, const double *U)
{
    double sum = 0.0;
    if (k < e->inertial) return long_dot(e->Q + e->n * k, U, e->n);
    for (int i = e->port_start[k - e->inertial]; i < e->port_start[k - e->inertial + 1]; i++) sum += e->port[i] * U[e->port_on[i]];
    return sum;
}

/* U += c H e_k */
static void add_column(const Field *e, int k, double c, double *U)
{
    if (k < e->inertial)
        for (long i = 0; i < e->n; i++) U[i] += c * e->Q[e->n * k + i];
    else
        for (int i = e->port_start[k - e->inertial]; i < e->port_start[k - e->inertial + 1]; i++) U[e->port_on[i]] += c * e->port[i];
}

#include "stiffened.c"

/* F = M A by nodes */
static void mass_times(const Field *e, const double *A, double *F)
{
    for (long i = 0; i < e->nodes; i++) {
        double sum[D] = {0.0};
        for (int k = e->M_start[i]; k < e->M_start[i + 1]; k++)
            for (int j = 0; j < D; j++) sum[j] += e->M[k] * A[D * e->M_column[k] + j];
        memcpy(F + D * i, sum, sizeof sum);
    }
}

/* F += K (U + beta U') by nodes */
static void stiffness_times(const Field *e, const double *U, const double *Ud, double *F)
{
    for (long i = 0; i < e->nodes; i++)
        for (int k = e->K_start[i]; k < e->K_start[i + 1]; k++) {
            const double *K = e->K + D * D * k, *u = U + D * e->K_column[k], *ud = Ud + D * e->K_column[k];
            for (int c = 0; c < D; c++) {
                double x = u[c] + e->beta * ud[c];
                for (int j = 0; j < D; j++) F[D * i + j] += K[D * j + c] * x;
            }
        }
}

/* Forces of linear elasticity on the nodes, and their resultant (world axes) into f. Verdict LOOK outside of the range of small
   displacements. */
static int linear_field(const Body *o, const double *R, const Motion *m, const double *gravity, double *f)
{
    const Field *e = o->field;
    const double *U = m->U, *Ud = m->Ud, *Udd = m->Udd, *w = m->twist + D, *accel = m->accel;
    double W[D * D], L[D * D], alpha[D * D], free_[D], base[D], sum[D] = {0.0}, N[D * D] = {0.0}, local[ROT], square = 0.0;
    const double *rates[] = {U, Ud, Udd};

    for (int i = 0; i < D; i++) free_[i] = accel[i] - gravity[i];
    transposed(R, free_, base);
    hat(w, W);
    product(W, W, L);
    hat(accel + D, alpha);
    add(L, 1.0, alpha, D * D);

    /* R^T (r'' - g) + (w' x) P + w x (w x P) + 2 w x U' + U'' */
    for (long i = 0; i < e->nodes; i++)
        for (int j = 0; j < D; j++) {
            double x = base[j] + Udd[D * i + j], u = U[D * i + j];
            for (int c = 0; c < D; c++) x += L[D * j + c] * (e->X[D * i + c] + U[D * i + c]) + 2.0 * W[D * j + c] * Ud[D * i + c];
            e->accel[D * i + j] = x;
            square += u * u;
        }
    mass_times(e, e->accel, e->force);

    for (long i = 0; i < e->nodes; i++)
        for (int j = 0; j < D; j++) {
            sum[j] += e->force[D * i + j];
            for (int c = 0; c < D; c++) N[D * j + c] += (e->X[D * i + j] + U[D * i + j]) * e->force[D * i + c];
        }
    if (e->stresses) stiffened(o, rates, W, accel + D, base, sum, N);
    times(R, sum, f);
    axial(N, local);
    to_world(R, local, f + D);

    stiffness_times(e, U, Ud, e->force);
    return square <= o->large ? DONE : LOOK;
}

/* Forces on the nodes, and their resultant (world axes) into f. */
int field_force(System *s, int b, const double *q, const double *v, const double *a, double *f, double t)
{
    const Body *o = s->body + b;
    const Field *e = o->field;
    const double *R = s->frames + FRAME * b + TURN;
    Motion m = motion_of(o, b, q, v, a);
    int verdict;
    if (e->own && s->from) m.U = s->from + o->at_q; /* those of the middle follow for linear fields alone */
    if (e->own) verdict = tell(s, s->from ? FIELD_MEANS : FIELD_FORCES, e->number, e->n, e->state, R, &m, s->gravity, t);
    else verdict = linear_field(o, R, &m, s->gravity, f);
    if (rests(o)) {
        memset(f, 0, TWIST * sizeof(double));
    } else if (e->own && !verdict) {
        memcpy(f, e->sums, D * sizeof(double));
        to_world(R, e->sums + D, f + D);
    }
    return verdict;
}

/* The open frame conditions, and their reactions C lambda on the nodes. */
void frame_conditions(System *s, const Body *o, const double *lam)
{
    const Field *e = o->field;
    for (int i = 0; i < e->frames; i++) {
        s->gap[e->row + i] = e->p[e->frame_slot[i]];
        add_column(e, e->frame_slot[i], lam[e->row + i], e->force); /* linear in every frame */
    }
}

/* The rows of a moving frame in the block A (n columns) of (2), and T. */
static void frame_block(const Body *o, const double *R, double *A, int n)
{
    const Field *e = o->field;
    turning_rows(R, e->moment, e->inertia, A, n);
    for (int i = 0; i < D; i++) A[(n + 1) * i] = o->mass;
    if (e->second) stiffened_block(e, R, A, n);
    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++) A[n * (TWIST + i) + j] = R[D * j + i];
    for (int i = 0; i < ROT; i++)
        for (int j = 0; j < ROT; j++) A[n * (TWIST + D + i) + D + j] = DIM == 3 ? R[D * j + i] : 1.0;
}

/* The rotation T of the factor: that of sum (M X) x^T, x = X + U, since the tangent was taken. 1 where there is none. */
static int turn_factor(const Field *e, const double *U)
{
    double F[D * D] = {0.0}, turn[D * D], Z[ROT * ROT];
    for (long i = 0; i < e->nodes; i++)
        for (int k = 0; k < D; k++) add(F + D * k, e->MX[D * i + k], U + D * i, D);
    add(F, 1.0, e->began + D * D, D * D);
    if (polar(F, turn, Z)) return 1;
    for (int i = 0; i < D; i++) /* turn: R^T */
        for (int j = 0; j < D; j++) {
            e->T[D * i + j] = 0.0;
            for (int k = 0; k < D; k++) e->T[D * i + j] += turn[D * k + i] * e->began[D * j + k];
        }
    return 0;
}

/* x (n vectors) = T y, or T^T y where ``back``; in place. */
static void turn_nodes(const Field *e, double *x, long n, int back)
{
    double y[D];
    for (long i = 0; e->turns && i < n; i += D) {
        memcpy(y, x + i, sizeof y);
        if (back) transposed(e->T, y, x + i);
        else times(e->T, y, x + i);
    }
}

/* The lower half of the block of (2) into the fronts; the frame conditions, solved already, get rows of their own: without a weight,
   as they must not tell how soft the rows of joints are where these depend on each other. 1 where a body has no rotation. */
int field_block(System *s, const Body *o, const double *R, const double *q)
{
    const Field *e = o->field;
    int n = TWIST + o->modes;
    double *A = o->block, *S = A + n * TWIST + TWIST;
    memset(A, 0, (size_t)n * n * sizeof(double));
    if (e->sways) mass_times(e, q + o->at_q, e->MU);
    if (rests(o))
        for (int i = 0; i < TWIST; i++) A[(n + 1) * i] = o->mass;
    else frame_block(o, R, A, n);

    if (e->turns && turn_factor(e, q + o->at_q)) return 1;
    for (int i = 0; i < e->solved; i++) memcpy(S + n * i, e->S + e->solved * i, e->solved * sizeof(double));
    for (int i = e->solved; i < o->modes; i++) S[(n + 1) * i] = HELD;
    for (int i = 0; e->turns && i < e->solved; i++) turn_nodes(e, S + n * i, e->solved, 0); /* S T^T, then T S T^T */
    for (int i = 0; e->turns && i < e->solved; i += D)
        for (int j = 0; j < e->solved; j++) {
            double y[D], x[D];
            for (int k = 0; k < D; k++) y[k] = S[n * (i + k) + j];
            times(e->T, y, x);
            for (int k = 0; k < D; k++) S[n * (i + k) + j] = x[k];
        }

    const int *dest = o->dest;
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) s->L[*dest++] += A[n * i + j];
        s->diagonal[o->at_u + i] = fabs(A[(n + 1) * i]);
    }
    for (int i = 0; i < e->frames; i++) s->L[s->row_dest[e->row + i]] -= 1.0;
    return 0;
}

/* z = E^-1 b by the factor itself, judged as linear/residual.py does; 0 where Python has to solve, and to judge. */
static int solved_here(const Field *e)
{
    double residual = 0.0, scale = 0.0;
    if (!e->direct || !*e->factor || e->direct(*e->factor, e->rhs, e->solution)) return 0;
    for (long i = 0; i < e->nodes; i++) {
        double r[D];
        for (int j = 0; j < D; j++) r[j] = -e->b[D * i + j];
        for (int k = e->M_start[i]; k < e->M_start[i + 1]; k++) add(r, e->of_mass * e->M[k], e->z + D * e->M_column[k], D);
        for (int k = e->K_start[i]; k < e->K_start[i + 1]; k++)
            for (int c = 0; c < D; c++) {
                double x = e->of_stiffness * e->z[D * e->K_column[k] + c];
                for (int j = 0; j < D; j++) r[j] += e->K[D * D * k + D * j + c] * x;
            }
        residual += dot(r, r, D);
        scale += dot(e->b + D * i, e->b + D * i, D);
    }
    residual = sqrt(scale > 0.0 ? residual / scale : residual);
    if (!(residual <= e->tolerance)) return 0;
    e->told[0] += 1.0;
    e->told[1] = fmax(e->told[1], residual);
    return 1;
}

/* z of the field's own forces times -scale, through its factor. */
static int field_alone(System *s, const Body *o, double scale, double t)
{
    const Field *e = o->field;
    double *b = s->b + o->at_u + TWIST;
    for (long i = 0; i < e->n; i++) e->b[i] = -scale * e->force[i];

    /* what acts on the columns goes to the nodes: it is in balance with the rest, and what differs is small. Left to (2), whose S is
       stiff where columns do not move, each of both would leave its roundoff */
    add_columns(o, b, e->b);
    memset(b, 0, o->modes * sizeof(double));
    turn_nodes(e, e->b, e->n, 1);
    if (solved_here(e)) return DONE;
    s->calls++;
    int told = s->python(FIELD, e->number, t);
    return told == OUTSIDE ? NEWTON : told ? FAILED : DONE;
}

/* The right-hand side of (2) into s->b, whose rows of the frame conditions hold what C^T dU has to be; ``scale`` = 0: no forces. */
int field_load(System *s, const Body *o, double scale, double t)
{
    const Field *e = o->field;
    double *b = s->b + o->at_u + TWIST, *wanted = s->b + s->nu + e->row, open[TWIST];
    int verdict = DONE;
    if (scale == 0.0) memset(e->z, 0, e->n * sizeof(double));
    else if ((verdict = field_alone(s, o, scale, t))) return verdict;

    /* h closes the frame conditions */
    for (int i = 0; i < e->solved; i++) e->pz[i] = column(e, i, e->z);
    for (int r = 0; r < e->bends; r++) e->pull[r] = long_dot(e->held + e->n * r, e->z, e->n); /* as the factor's columns are bent */
    for (int i = 0; i < e->solved; i++) e->pz[i] -= dot(e->N + e->bends * i, e->pull, e->bends);
    for (int i = 0; i < e->frames; i++) open[i] = e->pz[e->frame_slot[i]] - wanted[i];
    for (int i = 0; i < e->frames; i++) e->h[i] = dot(e->A + e->frames * i, open, e->frames);
    for (int i = 0; i < e->solved; i++) e->pz[i] -= dot(e->W + e->frames * i, e->h, e->frames);

    for (int i = 0; i < e->solved; i++) e->rest[i] = dot(e->S + e->solved * i, e->pz, e->solved);
    turn_nodes(e, e->rest, e->solved, 0);
    add(b, 1.0, e->rest, e->solved);
    for (int i = 0; i < e->frames; i++) wanted[i] = 0.0;
    return DONE;
}

/* dU and the multipliers of the frame conditions from the numbers p. */
void field_increment(const Body *o, const double *p, double *dU, double *lam)
{
    const Field *e = o->field;
    double *y = lam + e->row;
    memcpy(e->rest, p, e->solved * sizeof(double));
    turn_nodes(e, e->rest, e->solved, 1);
    for (int i = 0; i < e->solved; i++) e->rest[i] = e->pz[i] - e->rest[i];
    for (int i = 0; i < e->solved; i++) e->f[i] = dot(e->S + e->solved * i, e->rest, e->solved);
    for (int i = 0; i < e->frames; i++) y[i] = e->h[i] - dot(e->G + e->solved * i, e->f, e->solved);
    for (int i = 0; i < e->frames; i++) e->f[e->frame_slot[i]] += y[i];

    memcpy(dU, e->z, e->n * sizeof(double));
    for (int i = 0; i < e->solved; i++)
        if (e->f[i] != 0.0) add(dU, -e->f[i], e->Y + e->n * i, e->n);
    turn_nodes(e, dU, e->n, 0);
}

/* A solution with no right-hand side on the nodes comes next. */
void field_without_load(const Body *o)
{
    const Field *e = o->field;
    memset(e->z, 0, e->n * sizeof(double));
    memset(e->h, 0, e->frames * sizeof(double));
    memset(e->pz, 0, e->solved * sizeof(double));
}

/* The moments -sum M U x dU on the frame into f (world axes), for a solution with no other right-hand side. */
void field_sway(const Body *o, const double *R, const double *dU, double *f)
{
    const Field *e = o->field;
    double local[ROT] = {0.0}, one[ROT], turned[ROT];
    field_without_load(o);
    if (!e->sways) return;

    for (long i = 0; i < e->nodes; i++) {
        moment(e->MU + D * i, dU + D * i, one);
        add(local, -1.0, one, ROT);
    }
    to_world(R, local, turned);
    add(f, 1.0, turned, ROT);
}

/* Kinetic, elastic and potential energy of weight, added to out. */
static void linear_energies(const Body *o, const double *R, const Motion *m, const double *gravity, double *out)
{
    const Field *e = o->field;
    const double *U = m->U, *Ud = m->Ud, *twist = m->twist;
    const double *rates[] = {U, Ud};
    double base[D], W[D * D], arm[D] = {0.0}, world[D], kinetic = 0.0, elastic = 0.0;
    transposed(R, twist, base);
    hat(twist + D, W);

    for (long i = 0; i < e->nodes; i++)
        for (int j = 0; j < D; j++) {
            double x = base[j] + Ud[D * i + j];
            for (int c = 0; c < D; c++) x += W[D * j + c] * (e->X[D * i + c] + U[D * i + c]);
            e->accel[D * i + j] = x;
        }
    mass_times(e, e->accel, e->force);
    kinetic = long_dot(e->accel, e->force, e->n);

    for (long i = 0; i < e->n; i++) e->accel[i] = e->X[i] + U[i];
    mass_times(e, e->accel, e->force);
    for (long i = 0; i < e->n; i++) arm[i % D] += e->force[i];
    if (e->stresses) out[0] += stiffened_energy(o, rates, base, W, arm);
    times(R, arm, world);

    memset(e->force, 0, e->n * sizeof(double));
    memset(e->accel, 0, e->n * sizeof(double));
    stiffness_times(e, U, e->accel, e->force);
    elastic = long_dot(U, e->force, e->n);

    out[0] += 0.5 * kinetic;
    out[1] += 0.5 * elastic;
    out[2] -= o->mass * dot(m->pose, gravity, D) + dot(world, gravity, D);
}

/* The same for every field; frames are placed. */
void field_energies(System *s, int b, double t, const double *q, const double *v, const double *gravity, double *out)
{
    const Body *o = s->body + b;
    const Field *e = o->field;
    const double *R = s->frames + FRAME * b + TURN;
    Motion m = motion_of(o, b, q, v, v);
    if (!e->own) linear_energies(o, R, &m, gravity, out);
    else if (!tell(s, FIELD_ENERGIES, e->number, e->n, e->state, R, &m, gravity, t))
        for (int i = 0; i < 3; i++) out[i] += e->sums[i];
}
