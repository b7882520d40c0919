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
#include "bridges.c"
#include "evaluate.c"
#include "links.c"
#include "matrix.c"
#include "states.c"
#include "record.c"
#include "answers.c"

/* Factors for Python at a state that has been evaluated, without what reactions push across. */
EXPORT int driver_prepare(System *s, const double *q, double cd, double ck, const double *lam, double t)
{
    return prepare(s, q, cd, ck, lam, 0, t);
}

EXPORT int driver_prepare_complex(System *s, const double *q, const double *cd, const double *ck, const double *lam, double t)
{
    return prepare_complex(s, q, cd, ck, lam, t);
}
