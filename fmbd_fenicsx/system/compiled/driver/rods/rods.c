/* Finite elements of rods, formulas as in mechanics/rods/elements.py: forces (1) and tangents (2) there, in world axes.

   The six section forces at a Gauss point act on z = (x', P, P'), and through the interpolation on places and quaternions of the
   nodes; a node that turns by theta in world axes moves its quaternion by (theta, 0) p / 2. */

#include "tables.h"
#include "algebra/rotations.c"
#include "parts.h"
#include "strains.c"

enum { NODES = 4, STRAINS = 6, Z = 11, NODAL = 7, LOADED = 12 };

#include "rods/relaxation.c"

/* Places and quaternions of an element's nodes, these of one sign. */
static void rod_nodes(const System *s, const Rod *k, const int *node, double nodal[][NODAL])
{
    for (int i = 0; i < k->k; i++) {
        memcpy(nodal[i], s->q + POSE * node[i], POSE * sizeof(double));
        if (i > 0 && dot(nodal[i] + D, nodal[i - 1] + D, 4) < 0.0)
            for (int j = D; j < POSE; j++) nodal[i][j] = -nodal[i][j];
    }
}

/* z at a Gauss point, or its change by changes of the nodes */
static void rod_point(const Rod *k, const double *N, const double *slope, double nodal[][NODAL], double *z)
{
    memset(z, 0, Z * sizeof(double));
    for (int i = 0; i < k->k; i++) {
        add(z, slope[i], nodal[i], D);
        add(z + D, N[i], nodal[i] + D, 4);
        add(z + D + 4, slope[i], nodal[i] + D, 4);
    }
}

/* (theta, 0) p / 2 */
static void turned_quaternion(const double *theta, const double *p, double *out)
{
    for (int j = 0; j < 3; j++) {
        int a = (j + 1) % 3, b = (j + 2) % 3;
        out[j] = 0.5 * (p[3] * theta[j] + theta[a] * p[b] - theta[b] * p[a]);
    }
    out[3] = -0.5 * dot(theta, p, 3);
}

/* The moment, world axes, of a slope of the energy along p: the transpose of the above. */
static void quaternion_moment(const double *p, const double *slope, double *out)
{
    for (int j = 0; j < 3; j++) {
        int a = (j + 1) % 3, b = (j + 2) % 3;
        out[j] = 0.5 * (p[3] * slope[j] + p[a] * slope[b] - p[b] * slope[a] - p[j] * slope[3]);
    }
}

/* Strains less those free of stress at all points, their slopes by z, and their rates where these are needed. */
static void rod_kinematics(System *s, Rod *k)
{
    for (long e = 0; e < k->n; e++) {
        const int *node = k->node + e * k->k;
        double nodal[NODES][NODAL], moving[NODES][NODAL], z[Z], found[STRAINS + STRAINS * Z];
        rod_nodes(s, k, node, nodal);
        for (int i = 0; i < k->k && k->beta > 0.0; i++) {
            const double *velocity = s->velocity + s->body[node[i]].at_u;
            memcpy(moving[i], velocity, D * sizeof(double));
            turned_quaternion(velocity + D, nodal[i] + D, moving[i] + D);
        }

        for (int g = 0; g < k->points; g++) {
            long at = e * k->points + g;
            const double *N = k->N + g * k->k, *slope = k->slope + at * k->k;
            rod_point(k, N, slope, nodal, z);
            rod_strains(z, 0, found);
            for (int j = 0; j < STRAINS; j++) k->strain[STRAINS * at + j] = found[j] - k->natural[STRAINS * at + j];
            memcpy(k->E + STRAINS * Z * at, found + STRAINS, STRAINS * Z * sizeof(double));
            memcpy(k->z + Z * at, z, Z * sizeof(double));

            if (k->beta > 0.0) {
                rod_point(k, N, slope, moving, z);
                for (int j = 0; j < STRAINS; j++) k->rate[STRAINS * at + j] = dot(found + STRAINS + Z * j, z, Z);
            }
        }
    }
}

/* Ask a law of the user's own, in Python: SECTIONS: for S, C and the density of the energy; SECTION_SLOPES: for C of mean forces. */
static int ask_law(System *s, const Rod *k, int what, double t)
{
    if (k->number < 0) return DONE;
    s->calls++;
    return s->python(what, k->number, t) ? FAILED : DONE;
}

/* Section forces S at all points. */
static int rod_stress(System *s, Rod *k, double t)
{
    if (ask_law(s, k, SECTIONS, t)) return FAILED;
    for (long at = 0; at < k->n * k->points; at++) {
        const double *C = k->C + STRAINS * STRAINS * at, *e = k->strain + STRAINS * at, *rate = k->rate + STRAINS * at;
        double *S = k->S + STRAINS * at;
        for (int j = 0; j < STRAINS; j++) {
            if (k->number < 0) S[j] = dot(C + STRAINS * j, e, STRAINS);
            if (k->beta > 0.0) S[j] += k->beta * dot(C + STRAINS * j, rate, STRAINS);
        }
    }
    relaxing_stress(k, t);
    return DONE;
}

/* What the section forces at a point do to z, times the weight of the point */
static void rod_pull(const Rod *k, long at, double *on_z)
{
    memset(on_z, 0, Z * sizeof(double));
    for (int j = 0; j < STRAINS; j++) add(on_z, k->weight[at] * k->S[STRAINS * at + j], k->E + STRAINS * Z * at + Z * j, Z);
}

/* Loads on the nodes: force and moment in world axes, then in axes of the sections. */
void rod_loads(System *s, const Rod *k)
{
    for (int i = 0; i < k->nodes; i++) {
        const double *load = k->load + LOADED * i, *R = s->frames + FRAME * k->loaded[i] + TURN;
        double *f = s->residual + s->body[k->loaded[i]].at_u, world[3];
        for (int part = 0; part < 2; part++) {
            to_world(R, load + TWIST + 3 * part, world);
            add(world, 1.0, load + 3 * part, 3);
            add(f + 3 * part, -1.0, world, 3);
        }
    }
}

/* Forces (1) of element e, whose nodes are given, into the residual. */
static void rod_push(System *s, const Rod *k, long e, double nodal[][NODAL])
{
    const int *node = k->node + e * k->k;
    double pull[NODES][NODAL] = {{0.0}};
    for (int g = 0; g < k->points; g++) {
        long at = e * k->points + g;
        const double *N = k->N + g * k->k, *slope = k->slope + at * k->k;
        double on_z[Z];
        rod_pull(k, at, on_z);

        for (int i = 0; i < k->k; i++) {
            add(pull[i], slope[i], on_z, D);
            add(pull[i] + D, N[i], on_z + D, 4);
            add(pull[i] + D, slope[i], on_z + D + 4, 4);
        }
    }

    for (int i = 0; i < k->k; i++) {
        double moment[3], *f = s->residual + s->body[node[i]].at_u;
        quaternion_moment(nodal[i] + D, pull[i] + D, moment);
        add(f, 1.0, pull[i], D);
        add(f + D, 1.0, moment, 3);
    }
}

/* Forces (1) of all elements of a rod, and loads on its nodes, into the residual. */
int rod_forces(System *s, Rod *k, double t)
{
    rod_kinematics(s, k);
    if (k->load) rod_loads(s, k);
    if (rod_stress(s, k, t)) return FAILED;
    for (long e = 0; e < k->n; e++) {
        double nodal[NODES][NODAL];
        rod_nodes(s, k, k->node + e * k->k, nodal);
        rod_push(s, k, e, nodal);
    }
    return DONE;
}

/* Section forces S without damping, and the energy, of the strains at one end of a step. */
static int rod_end(System *s, Rod *k, const double *q, double t, double *energy)
{
    s->q = q;
    for (long e = 0; e < k->n; e++) {
        double nodal[NODES][NODAL], z[Z], found[STRAINS + STRAINS * Z];
        rod_nodes(s, k, k->node + e * k->k, nodal);
        for (int g = 0; g < k->points; g++) {
            long at = e * k->points + g;
            rod_point(k, k->N + g * k->k, k->slope + at * k->k, nodal, z);
            rod_strains(z, 0, found);
            for (int j = 0; j < STRAINS; j++) k->strain[STRAINS * at + j] = found[j] - k->natural[STRAINS * at + j];
        }
    }

    if (ask_law(s, k, SECTIONS, t)) return FAILED;
    *energy = 0.0;
    for (long at = 0; at < k->n * k->points; at++) {
        double *e = k->strain + STRAINS * at, *S = k->S + STRAINS * at;
        for (int j = 0; k->number < 0 && j < STRAINS; j++) S[j] = dot(k->C + STRAINS * (STRAINS * at + j), e, STRAINS);
        *energy += k->weight[at] * (k->number < 0 ? 0.5 * dot(S, e, STRAINS) : k->density[at]);
    }
    return DONE;
}

/* Nodes of an element at the mean of two configurations, quaternions on one side; and their motion. */
static void rod_mean_nodes(System *s, const Rod *k, long e, const double *q0, const double *q1, double nodal[][NODAL],
                           double moving[][NODAL])
{
    const int *node = k->node + e * k->k;
    double then[NODES][NODAL];
    s->q = q0;
    rod_nodes(s, k, node, nodal);
    s->q = q1;
    rod_nodes(s, k, node, then);

    double side = dot(nodal[0] + D, then[0] + D, 4) < 0.0 ? -1.0 : 1.0;
    for (int i = 0; i < k->k; i++) {
        const double *velocity = s->velocity + s->body[node[i]].at_u;
        for (int j = 0; j < NODAL; j++) nodal[i][j] = 0.5 * (nodal[i][j] + (j < D ? 1.0 : side) * then[i][j]);
        memcpy(moving[i], velocity, D * sizeof(double));
        turned_quaternion(velocity + D, nodal[i] + D, moving[i] + D);
    }
}

/* Means of strains and section forces over both ends of a step, and the energy gained in it. */
static int rod_means(System *s, Rod *k, const double *q0, const double *q1, double t, double *gained)
{
    const long points = k->n * k->points;
    double before, after;
    if (rod_end(s, k, q0, t, &before)) return FAILED;
    for (long at = 0; at < points; at++) { /* of the beginning: strains in z, forces in the rates */
        memcpy(k->z + Z * at, k->strain + STRAINS * at, STRAINS * sizeof(double));
        memcpy(k->rate + STRAINS * at, k->S + STRAINS * at, STRAINS * sizeof(double));
    }

    if (rod_end(s, k, q1, t, &after)) return FAILED;
    for (long at = 0; at < points; at++)
        for (int j = 0; j < STRAINS; j++) {
            k->strain[STRAINS * at + j] = 0.5 * (k->z[Z * at + j] + k->strain[STRAINS * at + j]);
            k->S[STRAINS * at + j] = 0.5 * (k->rate[STRAINS * at + j] + k->S[STRAINS * at + j]);
        }
    *gained = after - before;

    return ask_law(s, k, SECTION_SLOPES, t);
}

/* What mean section forces leave of the energy gained is given back along C times the changes of strain; damping is added. */
static void rod_gradient(System *s, Rod *k, const double *q0, const double *q1, double h, double gained)
{
    double square = 0.0, nodal[NODES][NODAL], moving[NODES][NODAL], z[Z], found[STRAINS + STRAINS * Z];
    for (long e = 0; e < k->n; e++) {
        rod_mean_nodes(s, k, e, q0, q1, nodal, moving);
        for (int g = 0; g < k->points; g++) {
            long at = e * k->points + g;
            const double *N = k->N + g * k->k, *slope = k->slope + at * k->k;
            double *along = k->rate + STRAINS * at, *S = k->S + STRAINS * at, change[STRAINS];
            rod_point(k, N, slope, nodal, z);
            rod_strains(z, 0, found);
            memcpy(k->E + STRAINS * Z * at, found + STRAINS, STRAINS * Z * sizeof(double));

            rod_point(k, N, slope, moving, z);
            for (int j = 0; j < STRAINS; j++) change[j] = h * dot(found + STRAINS + Z * j, z, Z);
            for (int j = 0; j < STRAINS; j++) along[j] = dot(k->C + STRAINS * (STRAINS * at + j), change, STRAINS);
            gained -= k->weight[at] * dot(S, change, STRAINS);
            square += k->weight[at] * dot(change, along, STRAINS);
            add(S, k->beta / h, along, STRAINS);
        }
    }
    if (square > 0.0) add(k->S, gained / square, k->rate, STRAINS * k->n * k->points);
    if (k->arms) relaxing_stress(k, k->kept[0] + 0.5 * h);
}

/* Equation (1) of mechanics/rods/discrete_gradient.py without the loads, into the residual, at the mean of the configurations q0 and q1;
   velocities are those of the mean. */
int rod_mean_forces(System *s, Rod *k, const double *q0, const double *q1, double h, double t)
{
    const double *kept = s->q;
    double gained, nodal[NODES][NODAL], moving[NODES][NODAL];
    int verdict = rod_means(s, k, q0, q1, t, &gained);
    if (!verdict) rod_gradient(s, k, q0, q1, h, gained);
    for (long e = 0; e < k->n && !verdict; e++) {
        rod_mean_nodes(s, k, e, q0, q1, nodal, moving);
        rod_push(s, k, e, nodal);
    }
    s->q = kept;
    return verdict;
}

/* The lower half of a symmetric matrix on z: E^T ((ck + beta cd) C + ck (arms)) E + g H, times the weight of the point. */
static void rod_inner(const System *s, const Rod *k, long at, double geometric, double inner[Z][Z])
{
    const double *E = k->E + STRAINS * Z * at;
    double C[STRAINS * STRAINS] = {0.0}, CE[STRAINS][Z] = {{0.0}}, H[Z * (Z + 1) / 2], w = k->weight[at];
    add(C, s->ck + k->beta * s->cd, k->C + STRAINS * STRAINS * at, STRAINS * STRAINS);
    relaxing_stiffness(k, at, s->ck, C);

    for (int a = 0; a < STRAINS; a++)
        for (int b = 0; b < STRAINS; b++)
            if (C[STRAINS * a + b] != 0.0) add(CE[a], C[STRAINS * a + b], E + Z * b, Z);
    if (geometric != 0.0) rod_curvature(k->z + Z * at, k->S + STRAINS * at, H);
    for (int i = 0, at_h = 0; i < Z; i++)
        for (int j = 0; j <= i; j++, at_h++) {
            double sum = 0.0;
            for (int a = 0; a < STRAINS; a++) sum += E[Z * a + i] * CE[a][j];
            inner[i][j] = inner[j][i] = w * (sum + (geometric != 0.0 ? geometric * H[at_h] : 0.0));
        }
}

/* Adds the block of two nodes on their places and quaternions. */
static void rod_block(double inner[Z][Z], double Ni, double si, double Nj, double sj, double block[NODAL][NODAL])
{
    double half[NODAL][Z];
    for (int c = 0; c < Z; c++) {
        for (int a = 0; a < D; a++) half[a][c] = si * inner[a][c];
        for (int a = 0; a < 4; a++) half[D + a][c] = Ni * inner[D + a][c] + si * inner[D + 4 + a][c];
    }
    for (int a = 0; a < NODAL; a++) {
        for (int b = 0; b < D; b++) block[a][b] += sj * half[a][b];
        for (int b = 0; b < 4; b++) block[a][D + b] += Nj * half[a][D + b] + sj * half[a][D + 4 + b];
    }
}

/* From places and quaternions to places and turns in world axes. */
static void rod_turned(double block[NODAL][NODAL], const double *pi, const double *pj, double out[TWIST][TWIST])
{
    double half[NODAL][TWIST];
    for (int a = 0; a < NODAL; a++) {
        memcpy(half[a], block[a], D * sizeof(double));
        quaternion_moment(pj, block[a] + D, half[a] + D);
    }

    for (int b = 0; b < TWIST; b++) {
        double column[4];
        for (int a = 0; a < D; a++) out[a][b] = half[a][b];
        for (int a = 0; a < 4; a++) column[a] = half[D + a][b];
        double moment[3];
        quaternion_moment(pi, column, moment);
        for (int a = 0; a < 3; a++) out[D + a][b] = moment[a];
    }
}

/* The symmetric part of tangent (2) of all elements into the fronts; ``geometric``: weight of their geometric stiffness. */
int rod_tangents(System *s, Rod *k, double t, double geometric)
{
    double inner[Z][Z], out[TWIST][TWIST];
    const int *to = k->to;
    if (ask_law(s, k, SECTION_SLOPES, t)) return FAILED;
    for (int i = 0; i < k->arms; i++) k->follows[i] = 1.0 - arm_at(k, i, t).f;
    for (long e = 0; e < k->n; e++) {
        double nodal[NODES][NODAL], blocks[NODES][NODES][NODAL][NODAL] = {{{{0.0}}}}, along[NODES] = {0.0};
        rod_nodes(s, k, k->node + e * k->k, nodal);

        for (int g = 0; g < k->points; g++) {
            long at = e * k->points + g;
            const double *N = k->N + g * k->k, *slope = k->slope + at * k->k;
            rod_inner(s, k, at, geometric, inner);
            for (int i = 0; i < k->k; i++)
                for (int j = 0; j <= i; j++) rod_block(inner, N[i], slope[i], N[j], slope[j], blocks[i][j]);

            /* the second derivative of p exp(theta): minus a quarter of the slope along p */
            double on_z[Z];
            rod_pull(k, at, on_z);
            for (int i = 0; i < k->k; i++)
                along[i] += N[i] * dot(on_z + D, nodal[i] + D, 4) + slope[i] * dot(on_z + D + 4, nodal[i] + D, 4);
        }

        for (int i = 0; i < k->k; i++)
            for (int j = 0; j <= i; j++) {
                rod_turned(blocks[i][j], nodal[i] + D, nodal[j] + D, out);
                for (int a = 0; a < 3 && i == j; a++) out[D + a][D + a] -= 0.25 * geometric * along[i];
                for (int a = 0; a < TWIST; a++)
                    for (int b = 0; b < (i == j ? a + 1 : TWIST); b++) s->L[*to++] += out[a][b];
            }
    }
    return DONE;
}

/* A viscoelastic rod takes up an accepted step, whose frames are placed. */
void rod_keep(System *s, Rod *k, double t)
{
    if (!k->arms) return;
    rod_kinematics(s, k);
    relaxed(k, t);
}

/* Its memory in other tables. */
void rod_share(const Rod *k, Rod *with)
{
    if (k->arms) memcpy(with->kept, k->kept, 2 * memory_size(k) * sizeof(double));
}

/* Elastic energy in the configuration that the frames are placed in, J. */
double rod_energy(System *s, Rod *k, double t)
{
    rod_kinematics(s, k);
    double sum = relaxing_energy(k, t);
    if (k->number >= 0 && s->python(SECTIONS, k->number, t)) return NAN;
    for (long at = 0; at < k->n * k->points; at++) {
        const double *e = k->strain + STRAINS * at;
        if (k->number >= 0) sum += k->weight[at] * k->density[at];
        else
            for (int j = 0; j < STRAINS; j++)
                sum += 0.5 * k->weight[at] * e[j] * dot(k->C + STRAINS * STRAINS * at + STRAINS * j, e, STRAINS);
    }
    return sum;
}
