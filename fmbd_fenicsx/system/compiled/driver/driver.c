/* One translation unit: the evaluation, the solver and the time stepping. Kernels of kinds come from libraries of their own.
   Compiled for the plane (-DDIM=2) and for space (-DDIM=3). */

#include "tables.h"

#if defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif

#include "rotations.c"
#include "factor.c"
#include "bodies.c"
#include "fields.c"
#if DIM == 3
#include "strains.c"
#include "rods.c"
#else
static int rod_forces(System *s, Rod *k, double t) { return (void)s, (void)k, (void)t, DONE; }
static int rod_tangents(System *s, Rod *k, double t, double geometric) { return (void)s, (void)k, (void)t, (void)geometric, DONE; }
static double rod_energy(System *s, Rod *k) { return (void)s, (void)k, 0.0; }
#endif
#include "formulas.c"
#include "mapped.c"
#include "mounts.c"
#include "whole.c"
#include "evaluate.c"
#include "matrix.c"
#include "states.c"
#include "record.c"
#include "answers.c"
#include "alpha.c"
#include "contact.c"
#include "complementarity.c"
#include "impulses.c"
#include "moreau.c"

/* The evaluation, the factor and a solution for Python: what other schemes and tests call. */
EXPORT int driver_evaluate(System *s, const double *q, const double *v, const double *a, const double *lam, double t)
{
    return evaluate(s, q, v, a, lam, t);
}

EXPORT int driver_prepare(System *s, const double *q, double cd, double ck, const double *lam, int reactions, double t)
{
    return prepare(s, q, cd, ck, lam, reactions, t);
}

EXPORT int driver_increment(System *s, double scale, double *x, double *y, double t) { return increment(s, scale, x, y, t); }

EXPORT int driver_energies(System *s, double t, const double *q, const double *v, const double *gravity, double *out)
{
    int verdict = place(s, q, v);
    energies(s, t, q, v, gravity, out);
    return verdict;
}
