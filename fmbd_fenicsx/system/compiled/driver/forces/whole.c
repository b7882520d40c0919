/* Forces that Python gives as a whole from the motion of two markers: own laws and tyres. C places the markers, takes the wrenches on
   them, and keeps the slopes K and B (minus the derivatives by displacements and velocities of both markers) of an earlier state for as
   long as they foretell what the wrenches do. */

#include "tables.h"
#include "algebra/rotations.c"
#include "parts.h"

enum { PAIR = 2 * TWIST, PLACED = D + D * D + TWIST, SIDE = D + D * D }; /* of both markers; of one: x, R, twist; constants of a side */
enum { KNOWN = 2 * PLACED + PAIR };
static const double SKEW = 1e-3; /* share of a tangent without symmetry that costs no increment */
static const double WRONG = 0.01, FAINT = 0.1; /* share of a motion by which slopes may mislead, of Newton's tolerance that is nothing */

/* Whether side 1 of a force is no marker of its own. */
static int alone(const Batch *k, long i, int side) { return side && k->marker[2 * i] == k->marker[2 * i + 1]; }

static void sight_of(const double *frame, const double *constants, double *sight)
{
    double lever[D], swing[D];
    times(frame + TURN, constants, lever);
    product(frame + TURN, constants + D, sight + D);
    spin(frame + SPIN, lever, swing);
    for (int j = 0; j < D; j++) {
        sight[j] = frame[j] + lever[j];
        sight[D + D * D + j] = frame[SPEED + j] + swing[j];
    }
    memcpy(sight + D + D * D + D, frame + SPIN, ROT * sizeof(double));
}

/* A force at a marker as one at the origin of its frame. */
static void at_origin(const double *lever, const double *wrench, double *out)
{
    double turning[ROT];
    moment(lever, wrench, turning);
    memcpy(out, wrench, TWIST * sizeof(double));
    for (int j = 0; j < ROT; j++) out[D + j] += turning[j];
}

/* The small displacement from one sight of a marker to another. */
static void moved_between(const double *from, const double *to, double *out)
{
    double turned[D * D];
    product_transposed(to + D, from + D, turned);
    for (int j = 0; j < D; j++) out[j] = to[j] - from[j];
#if DIM == 3
    for (int j = 0; j < 3; j++) out[3 + j] = 0.5 * (turned[3 * ((j + 2) % 3) + (j + 1) % 3] - turned[3 * ((j + 1) % 3) + (j + 2) % 3]);
#else
    out[2] = 0.5 * (turned[2] - turned[1]);
#endif
}

/* Whether a wrench that is not foretold by ``miss`` misleads the increment of a body by more than a share of the motion. */
static int misleads(const System *s, int body, const double *miss, const double *moved)
{
    const double *units = s->units + TWIST * body, *inertia = s->diagonal + s->body[body].at_u;
    double most = 0.0;
    for (int j = 0; j < TWIST; j++) most = fmax(most, units[j] * fabs(moved[j]));
    for (int j = 0; j < TWIST; j++) {
        double allowed = WRONG * (units[j] * fabs(moved[j]) + 0.1 * most) + FAINT * s->settled;
        if (!(units[j] * s->ck * fabs(miss[j]) <= allowed * inertia[j])) return 1;
    }
    return 0;
}

/* From the origin of its frame to the marker of side i of a batch. */
static void arm(const System *s, const Batch *k, long i, double *lever)
{
    for (int j = 0; j < D; j++) lever[j] = k->sight[PLACED * k->marker[i] + j] - s->frames[FRAME * k->pair[i] + j];
}

/* By how much the slopes of a force miss ``push``, from where its sights and wrench were kept on; ``moved``: its markers since. */
static void missed_by(const Batch *k, long i, const double *push, double *moved, double *miss)
{
    const double *known = k->known + KNOWN * i;
    double faster[PAIR] = {0.0};
    memset(moved, 0, PAIR * sizeof(double));
    for (int side = 0; side < 2; side++) {
        const double *now = k->sight + PLACED * k->marker[2 * i + side], *then = known + PLACED * side;
        if (alone(k, i, side)) continue;
        moved_between(then, now, moved + TWIST * side);
        for (int j = 0; j < TWIST; j++) faster[TWIST * side + j] = now[SIDE + j] - then[SIDE + j];
    }

    for (int j = 0; j < PAIR; j++) {
        const long row = (long)PAIR * (PAIR * i + j);
        miss[j] = push[j] - known[2 * PLACED + j] + dot(k->K + row, moved, PAIR) + dot(k->B + row, faster, PAIR);
    }
}

/* Wrenches by the slopes, from where these were taken on. */
static void along_slopes(const Batch *k)
{
    double moved[PAIR], miss[PAIR];
    for (long i = 0; i < k->n; i++) {
        missed_by(k, i, k->push + PAIR * i, moved, miss);
        add(k->push + PAIR * i, -1.0, miss, PAIR);
    }
}

/* Whether the slopes foretell the wrenches from the last evaluation to this one. On surfaces, where a small part of a body moves, they
   have to be right to 2 %. */
static int surprised(const System *s, const Batch *k, long i)
{
    const double *known = k->known + KNOWN * i, *push = k->push + PAIR * i;
    double moved[PAIR], miss[PAIR], missed = 0.0, change = 0.0, whole = 0.0;
    missed_by(k, i, push, moved, miss);
    for (int j = 0; j < PAIR; j++) {
        const double went = push[j] - known[2 * PLACED + j];
        missed += miss[j] * miss[j], change += went * went, whole += push[j] * push[j];
    }
    if (!(missed > 1e-22 * whole)) return !(missed <= 1e-22 * whole);

    for (int side = 0; side < 2; side++) {
        int frame = k->pair[2 * i + side];
        double on_body[TWIST], lever[D];
        if (frame == s->bodies) continue;

        if (frame > s->bodies) {
            if (missed > 4e-4 * change) return 1;
            continue;
        }
        arm(s, k, 2 * i + side, lever);
        at_origin(lever, miss + TWIST * side, on_body);
        if (misleads(s, frame, on_body, moved + TWIST * side)) return 1;
    }
    return 0;
}

static void keep_sights(Batch *k)
{
    for (long i = 0; i < k->n; i++) {
        double *known = k->known + KNOWN * i;
        for (int side = 0; side < 2; side++)
            memcpy(known + PLACED * side, k->sight + PLACED * k->marker[2 * i + side], PLACED * sizeof(double));
        memcpy(known + 2 * PLACED, k->push + PAIR * i, PAIR * sizeof(double));
    }
}

/* The motions of all markers, where frames are placed. */
void whole_sights(const System *s, const Batch *k)
{
    for (long i = 0; i < 2 * k->n; i++)
        if (!alone(k, i / 2, i % 2)) sight_of(s->frames + FRAME * k->pair[i], k->P + SIDE * i, k->sight + PLACED * k->marker[i]);
}

/* Wrenches on the markers into the residuals of their frames; one call into Python for all forces of a batch, or their slopes. */
int whole_forces(System *s, Batch *k, double t)
{
    whole_sights(s, k);
    const double *ahead = s->straight ? NULL : known_ahead(s, k, k->sight, t);
    if (s->straight) along_slopes(k);
    else if (ahead) memcpy(k->push, ahead, k->answers * sizeof(double));
    else {
        s->calls++;
        if (s->python(WRENCHES, k->number, t)) return FAILED;
    }

    for (long i = 0; i < 2 * k->n; i++) {
        double lever[D], on_frame[TWIST];
        arm(s, k, i, lever);
        at_origin(lever, k->push + TWIST * i, on_frame);
        for (int j = 0; j < TWIST; j++) s->residual[k->at[TWIST * i + j]] -= on_frame[j];
    }

    if (s->straight) return DONE;
    for (long i = 0; i < k->n && !*k->astray; i++) *k->astray = surprised(s, k, i);
    keep_sights(k);
    return DONE;
}

/* A matrix on the twists of both markers of a force as one on those of their frames: W^T C W, W = [1, -lever x; 0, 1] of each side. */
static void to_frames(const System *s, const Batch *k, long i, double *C)
{
    for (int side = 0; side < 2; side++) {
        double lever[D];
        arm(s, k, 2 * i + side, lever);
        for (int r = 0; r < ROT; r++) {
            double axis[ROT] = {0.0}, swing[D];
            int to = TWIST * side + D + r;

            axis[r] = 1.0;
            spin(axis, lever, swing);
            for (int j = 0; j < PAIR; j++) C[PAIR * j + to] += dot(C + PAIR * j + TWIST * side, swing, D);
            for (int j = 0; j < D; j++) add(C + PAIR * to, swing[j], C + PAIR * (TWIST * side + j), PAIR);
        }
    }
}

/* ck K + cd B on the twists of the markers of a force, as its symmetric part and what is left of it. */
static void parts_of(const Batch *k, long i, double cd, double ck, double *symmetric, double *rest)
{
    const double *K = k->K + (long)PAIR * PAIR * i, *B = k->B + (long)PAIR * PAIR * i;
    for (int r = 0; r < PAIR; r++)
        for (int c = 0; c < PAIR; c++) {
            const int one = PAIR * r + c, other = PAIR * c + r;
            symmetric[one] = 0.5 * (ck * (K[one] + K[other]) + cd * (B[one] + B[other]));
            rest[one] = 0.5 * (ck * (K[one] - K[other]) + cd * (B[one] - B[other]));
        }
}

/* New slopes from Python, of the state evaluated last. */
int take_whole_slopes(System *s, Batch *k, double t)
{
    s->calls++;
    *k->astray = 0;
    return s->python(WHOLE_SLOPES, k->number, t) ? FAILED : DONE;
}

/* The symmetric part of ck K + cd B into the fronts; Python gives new slopes where the old ones misled, or Newton is slow with them. */
int whole_tangents(System *s, Batch *k, double t)
{
    if ((*k->astray || s->renewed) && take_whole_slopes(s, k, t)) return FAILED;

    for (long i = 0; i < k->n; i++) {
        double C[PAIR * PAIR], rest[PAIR * PAIR];
        parts_of(k, i, s->cd, s->ck, C, rest);
        to_frames(s, k, i, C);
        mapped_square(s, k, i, C);
    }
    return DONE;
}

/* What is left of it for weights by their parts, as rows of links.c behind those that are there, where these have room. */
void whole_links(System *s, const Batch *k, const double *cd, const double *ck)
{
    const int wide = s->nu + TWIST * s->surfaces + 1, parts = s->parts;
    for (long i = 0; i < k->n && s->links + PAIR <= s->linkable; i++) {
        double C[2][PAIR * PAIR], symmetric[PAIR * PAIR];
        const int *at = k->at + PAIR * i;
        int lacks = 0;
        for (int part = 0; part < parts; part++) {
            parts_of(k, i, cd[part], ck[part], symmetric, C[part]);
            lacks |= largest(C[part], PAIR * PAIR) > SKEW * largest(symmetric, PAIR * PAIR);
            to_frames(s, k, i, C[part]);
        }

        for (int r = 0; lacks && r < PAIR; r++) {
            double *push = s->push + (long)wide * s->links, most = 0.0;
            for (int part = 0; part < parts; part++) most = fmax(most, largest(C[part] + PAIR * r, PAIR));
            if (at[r] == wide - 1 || most == 0.0) continue;
            memset(push, 0, wide * sizeof(double));
            push[at[r]] = 1.0;
            for (int part = 0; part < parts; part++) {
                double *pull = s->pull + (long)wide * parts * (s->links * parts + part);
                memset(pull, 0, wide * sizeof(double));
                for (int c = 0; c < PAIR; c++) pull[at[c]] += C[part][PAIR * r + c];
            }

            s->links++;
        }
    }
}
