/* The core of the driver: the evaluation, its records, the solver. Beside it, compiled at the same time, stand schemes.c and
   implicit_schemes.c; what a scene may lack are units of their own, compiled and linked where it is there (library.py), and so
   are the kernels of kinds. For the plane (-DDIM=2) and for space (-DDIM=3). */

#include "tables.h"
#include "rotations.c"
#include "parts.h"
#include "factor.c"
#include "complex_factor.c"
#include "bodies.c"
#include "formulas.c"
#include "mapped.c"
#include "evaluate.c"
#include "links.c"
#include "matrix.c"
#include "states.c"
#include "record.c"
#include "answers.c"

/* The evaluation, the factor and a solution for Python: what other schemes and tests call. */
EXPORT int driver_evaluate(System *s, const double *q, const double *v, const double *a, const double *lam, double t)
{
    return evaluate(s, q, v, a, lam, t);
}

EXPORT int driver_prepare(System *s, const double *q, double cd, double ck, const double *lam, int reactions, double t)
{
    return prepare(s, q, cd, ck, lam, reactions, t);
}

EXPORT int driver_prepare_complex(System *s, const double *q, const double *cd, const double *ck, const double *lam, double t)
{
    return prepare_complex(s, q, cd, ck, lam, t);
}

EXPORT int driver_increment(System *s, double scale, double *x, double *y, double t) { return increment(s, scale, x, y, t); }
