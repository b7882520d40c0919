/* Parts that Python tells, as ``Part`` of mechanics/placements.py: lines, loaded reduced bodies, and those of the user's own. Their
   forces and blocks are added to those of a rigid body on the same frame; a part on the ground has a frame that rests. */

#include "tables.h"
#include "algebra/rotations.c"
#include "parts.h"

/* Slopes of a part whose frame rests, at the state evaluated last with these coordinates and rates. */
int take_part_slopes(System *s, const Body *o, const double *q, const double *v, double t)
{
    const Told *e = o->told;
    const int n = o->modes;
    memcpy(e->known, q + o->at_q, n * sizeof(double));
    memcpy(e->known + n, v + o->at_v, n * sizeof(double));
    memcpy(e->known + 2 * n, e->rows + TWIST, n * sizeof(double));
    s->calls++;
    return s->python(PART_SLOPES, e->number, t) ? FAILED : DONE;
}

/* Rows of the coordinates by these slopes, at the accelerations where they were taken. */
static void along_part(const Body *o, const double *q, const double *v, double *rows)
{
    const Told *e = o->told;
    const int n = o->modes;
    const double *u = e->known, *rate = u + n, *at = rate + n, *by_u = e->slopes, *by_rate = by_u + (long)n * n;
    for (int i = 0; i < n; i++) {
        rows[i] = at[i];
        for (int j = 0; j < n; j++)
            rows[i] += by_u[n * i + j] * (q[o->at_q + j] - u[j]) + by_rate[n * i + j] * (v[o->at_v + j] - rate[j]);
    }
}

/* Ask by one call for the forces of a part whose frame rests, see foretell_points(). */
int foretell_part(System *s, const Body *o, int count, const double *t, int each, const double *q, const double *xi, const double *v,
                  const double *a)
{
    Told *e = o->told;
    const int n = o->modes;
    double *x = e->ahead;
    e->foretold = count;
    for (int j = 0; j < count; j++, v += s->nv, a += s->nv, x += 1 + 4 * n) {
        const double *u = q + (long)each * j * s->nq + o->at_q, *more = xi ? xi + (long)j * s->nv + o->at_v : NULL;
        x[0] = t[j];
        for (int i = 0; i < n; i++) x[1 + i] = more ? u[i] + more[i] : u[i];
        memcpy(x + 1 + n, v + o->at_v, n * sizeof(double));
        memcpy(x + 1 + 2 * n, a + o->at_v, n * sizeof(double));
    }

    s->calls++;
    const int told = s->python(PART_POINTS, e->number, *t);
    if (told) e->foretold = 0;
    return told == OUTSIDE ? NEWTON : told ? FAILED : DONE;
}

/* Rows of the coordinates where they have been asked for, else NULL. */
static const double *foretold(const Told *e, int n, const Motion *m, double t)
{
    const double *x = e->ahead;
    for (int j = 0; j < e->foretold; j++, x += 1 + 4 * n) {
        if (x[0] != t || memcmp(x + 1, m->U, n * sizeof(double)) || memcmp(x + 1 + n, m->Ud, n * sizeof(double))) continue;
        if (!memcmp(x + 1 + 2 * n, m->Udd, n * sizeof(double))) return x + 1 + 3 * n;
    }
    return NULL;
}

/* Rows of the frame (world axes) and of the coordinates, behind each other in f. */
int told_force(System *s, int b, const double *q, const double *v, const double *a, double *f, double t)
{
    const Body *o = s->body + b;
    const Told *e = o->told;
    const double *R = s->frames + FRAME * b + TURN;
    double moments[ROT];
    if (s->straight && e->rests) {
        along_part(o, q, v, f + TWIST);
        return DONE;
    }

    Motion m = motion_of(o, b, q, v, a);
    const double *rows = foretold(e, o->modes, &m, t);
    int verdict = DONE;
    if (rows) memcpy(e->rows + TWIST, rows, o->modes * sizeof(double));
    else verdict = tell(s, PART_FORCES, e->number, o->modes, e->state, R, &m, s->gravity, t);
    if (verdict) return verdict;
    memcpy(f + TWIST, e->rows + TWIST, o->modes * sizeof(double));
    if (e->rests) return DONE;

    add(f, 1.0, e->rows, D);
    to_world(R, e->rows + D, moments);
    add(f + D, 1.0, moments, ROT);
    return DONE;
}

/* The lower half of the block of M + cd C + ck K into the fronts, at the state evaluated last. */
int told_block(System *s, const Body *o, double t)
{
    const Told *e = o->told;
    const int n = TWIST + o->modes, *dest = e->dest;
    const int known = e->masses && s->cd == 0.0 && s->ck == 0.0 && !s->imaginary;
    const double *block = known ? e->masses : e->block;
    double *diagonal = s->diagonal + o->at_u;
    if (!known) s->calls++;
    int told = known ? 0 : s->python(PART_TANGENTS, e->number, t);
    if (told) return told == OUTSIDE ? NEWTON : FAILED;

    if (!o->inertia) memset(diagonal, 0, TWIST * sizeof(double));
    memset(diagonal + TWIST, 0, o->modes * sizeof(double));
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) s->L[*dest++] += block[n * i + j];
        diagonal[i] += fabs(block[(n + 1) * i]);
    }
    return DONE;
}

/* Kinetic, elastic and potential energy of weight, added to out. */
void told_energies(System *s, int b, double t, const double *q, const double *v, const double *gravity, double *out)
{
    const Body *o = s->body + b;
    const Told *e = o->told;
    Motion m = motion_of(o, b, q, v, v);
    if (tell(s, PART_ENERGIES, e->number, o->modes, e->state, s->frames + FRAME * b + TURN, &m, gravity, t)) return;
    for (int i = 0; i < 3; i++) out[i] += e->rows[i];
}
