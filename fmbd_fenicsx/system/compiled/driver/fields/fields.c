/* Elastic bodies, equations (1) and (2) of mechanics/elastic/floating.py, and how their fields leave the step's matrix.

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
#include "algebra/rotations.c"
#include "parts.h"

enum { SUMS = 16 }; /* side by side, so that the processor adds them at once */

static double long_dot(const double *x, const double *y, long n)
{
    double sum[SUMS] = {0.0};
    long i = 0;
    for (; i + SUMS <= n; i += SUMS)
        for (int j = 0; j < SUMS; j++) sum[j] += x[i + j] * y[i + j];
    for (; i < n; i++) sum[0] += x[i] * y[i];
    for (int j = SUMS / 2; j; j /= 2) add(sum, 1.0, sum + j, j);
    return *sum;
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

/* F += A (U + beta U') by nodes; each sum stays in registers until its row is done. */
static void blocks_times(long nodes, const NodeMatrix *A, const double *U, const double *Ud, double beta, double *F)
{
    for (long i = 0; i < nodes; i++) {
        double sum[D * D] = {0.0};
        for (int k = A->start[i]; k < A->start[i + 1]; k++) {
            const double *block = A->block + D * D * (long)k, *u = U + D * A->column[k], *ud = Ud + D * A->column[k];
            for (int j = 0; j < D; j++)
                for (int c = 0; c < D; c++) sum[D * j + c] += block[D * j + c] * (u[c] + beta * ud[c]);
        }
        for (int j = 0; j < D; j++)
            for (int c = 0; c < D; c++) F[D * i + j] += sum[D * j + c];
    }
}

#include "fields/stiffened.c"

/* F += M A by nodes */
static void add_mass(const Field *e, const double *A, double *F)
{
    if (e->masses) {
        blocks_times(e->nodes, e->masses, A, A, 0.0, F);
        return;
    }
    for (long i = 0; i < e->nodes; i++) {
        double sum[D] = {0.0};
        for (int k = e->M_start[i]; k < e->M_start[i + 1]; k++)
            for (int j = 0; j < D; j++) sum[j] += e->M[k] * A[D * e->M_column[k] + j];
        add(F + D * i, 1.0, sum, D);
    }
}

/* F = M A by nodes */
static void mass_times(const Field *e, const double *A, double *F)
{
    memset(F, 0, e->n * sizeof(double));
    add_mass(e, A, F);
}

#include "fields/pressure.c"

#include "fields/forms.c"

/* Forces without those of inertia and weight that cost more than products, found once for a state: on the nodes, and where Python tells
   them their rows of the frame. */
static int held_force(System *s, const Body *o, const double *R, const Motion *m, double t)
{
    Field *e = o->field;
    const Pressure *unknown = e->pressure && e->pressure->gap ? e->pressure : NULL;
    const double *known[] = {m->U, m->Ud, R, unknown ? unknown->p : NULL};
    const long sizes[] = {e->n, e->n, D * D, unknown ? unknown->n : 0};
    double *asked = e->asked;
    int same = e->asked_at == t, verdict;
    for (int i = 0; i < 3 + !!unknown; asked += sizes[i++]) {
        same = same && !memcmp(asked, known[i], sizes[i] * sizeof(double));
        if (!same) memcpy(asked, known[i], sizes[i] * sizeof(double));
    }

    if (same) return DONE;
    e->asked_at = NAN;
    if (e->own) {
        if ((verdict = tell(s, FIELD_FORCES, e->number, e->n, e->state, R, m, s->gravity, t))) return verdict;
        memcpy(e->held_force, e->force, e->n * sizeof(double));
        memcpy(e->held_sums, e->sums, TWIST * sizeof(double));
    } else {
        memset(e->held_force, 0, e->n * sizeof(double));
        if ((verdict = material_force(e, m->U, m->Ud, e->held_force))) return verdict;
    }

    e->asked_at = t;
    return DONE;
}

/* Forces of inertia, weight and elasticity on the nodes, and their resultant (world axes) into f. Verdict LOOK outside of the range of
   small displacements. */
static int nodal_force(System *s, const Body *o, const double *R, const Motion *m, const double *gravity, double *f, double t)
{
    const Field *e = o->field;
    const double *U = m->U, *Ud = m->Ud, *Udd = m->Udd, *w = m->twist + D, *accel = m->accel;
    double W[D * D], L[D * D], alpha[D * D], free_[D], base[D], sum[D] = {0.0}, N[D * D] = {0.0}, local[ROT], square = 0.0;
    const double *rates[] = {U, Ud, Udd};
    const int means = s->from && e->means, held = !means && (e->own || e->integrals);
    int verdict = ask_loads(s, o->field, t);
    if (verdict || (held && (verdict = held_force(s, o, R, m, t)))) return verdict;

    for (int i = 0; i < D; i++) free_[i] = e->weight ? 0.0 : accel[i] - gravity[i];
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
    for (int j = 0; e->weight && j < D; j++) add(e->force, -gravity[j], e->weight + e->n * j, e->n);

    for (long i = 0; i < e->nodes; i++)
        for (int j = 0; j < D; j++) {
            sum[j] += e->force[D * i + j];
            for (int c = 0; c < D; c++) N[D * j + c] += (e->X[D * i + j] + U[D * i + j]) * e->force[D * i + c];
        }
    if (e->stresses) stiffened(o, rates, W, accel + D, base, sum, N);
    axial(N, local);
    if (e->own) {
        add(sum, 1.0, e->held_sums, D);
        add(local, 1.0, e->held_sums + D, ROT);
    }

    if (means) mean_material_force(e, U, Ud, s->span, e->force);
    else if (held) add(e->force, 1.0, e->held_force, e->n);
    else if ((verdict = material_force(e, U, Ud, e->force))) return verdict;
    if (e->dead) add_loads(e, R, U, sum, local);
    if (e->stressing) stress_of_loads(o->field, R, U, sum, local);
    times(R, sum, f);
    to_world(R, local, f + D);
    return square <= o->large ? DONE : LOOK;
}

/* Forces on the nodes, and their resultant (world axes) into f. */
int field_force(System *s, int b, const double *q, const double *v, const double *a, double *f, double t)
{
    const Body *o = s->body + b;
    const Field *e = o->field;
    const double *R = s->frames + FRAME * b + TURN;
    Motion m = motion_of(o, b, q, v, a);
    int verdict = DONE;
    const int means = s->from && (e->own || e->integrals); /* those of the middle follow for linear fields alone */
    if (means) m.U = s->from + o->at_q;
    if (e->whole || (means && !e->means))
        verdict = tell(s, s->from ? FIELD_MEANS : FIELD_FORCES, e->number, e->n, e->state, R, &m, s->gravity, t);
    if (verdict) return verdict;

    if (e->whole || (means && !e->means)) { /* else Python has lent them */
        memcpy(f, e->sums, D * sizeof(double));
        to_world(R, e->sums + D, f + D);
    } else verdict = nodal_force(s, o, R, &m, s->gravity, f, t);
    if (rests(o)) memset(f, 0, TWIST * sizeof(double));
    return verdict;
}

/* Ports that move along bodies, where they are at a time, asked for once. */
int move_ports(System *s, double t)
{
    for (const Body *o = s->body; o < s->body + s->bodies; o++) {
        Field *e = o->field;
        if (!e || !e->drift || e->placed_at == t) continue;
        e->placed_at = NAN;
        s->calls++;
        const int told = s->python(FIELD_PORTS, e->number, t);
        if (told) return told == OUTSIDE ? NEWTON : FAILED;
        e->placed_at = t;
    }
    return DONE;
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

#include "fields/condensed.c"

#include "fields/volumes.c"

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
    stiffness_times(e, U, e->accel, 0.0, e->force);
    elastic = long_dot(U, e->force, e->n);
    for (int i = 0; e->droppers && i < e->droppers->count; i++) {
        const double k = e->droppers->stiffness[i], x = stretch(e->droppers, i, U), N = tension(e->droppers, i, x);
        elastic += (k > 0.0 ? N * N / k : 0.0) - k * x * x;
    }

    out[0] += 0.5 * kinetic;
    out[1] += 0.5 * elastic;
    if (e->weight) for (int j = 0; j < D; j++) out[2] -= gravity[j] * long_dot(e->weight + e->n * j, U, e->n);
    else out[2] -= o->mass * dot(m->pose, gravity, D) + dot(world, gravity, D);
}

/* The same for every field; frames are placed. */
void field_energies(System *s, int b, double t, const double *q, const double *v, const double *gravity, double *out)
{
    const Body *o = s->body + b;
    const Field *e = o->field;
    const double *R = s->frames + FRAME * b + TURN;
    Motion m = motion_of(o, b, q, v, v);
    if (!e->own && !e->integrals) linear_energies(o, R, &m, gravity, out);
    else if (!tell(s, FIELD_ENERGIES, e->number, e->n, e->state, R, &m, gravity, t))
        for (int i = 0; i < 3; i++) out[i] += e->sums[i];
}
