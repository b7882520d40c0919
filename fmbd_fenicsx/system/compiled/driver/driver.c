/* The core of the driver: the evaluation, its records, the solver. Beside it, compiled at the same time, stands schemes.c; what a scene
   or its scheme may lack are units of their own, compiled and linked where it is there (library.py), and so are the kernels of kinds.
   For the plane (-DDIM=2) and for space (-DDIM=3). */

#include "tables.h"
#include "algebra/rotations.c"
#include "parts.h"
#include "algebra/factor.c"
#include "algebra/complex_factor.c"
#include "bodies/bodies.c"
#include "forces/control.c"
#include "forces/formulas.c"
#include "bodies/mapped.c"
#include "forces/sums.c"
#include "forces/bridges.c"
#include "evaluation/evaluate.c"
#include "forces/links.c"
#include "evaluation/matrix.c"
#include "evaluation/dependent_rows.c"
#include "evaluation/states.c"
#include "evaluation/record.c"
#include "evaluation/answers.c"

/* Factors for Python at a state that has been evaluated. */
EXPORT int driver_prepare(System *s, const double *q, double cd, double ck, const double *lam, int reactions, double t)
{
    return prepare(s, q, cd, ck, lam, reactions, t);
}

EXPORT int driver_prepare_complex(System *s, const double *q, const double *cd, const double *ck, const double *lam, double t)
{
    return prepare_complex(s, q, cd, ck, lam, t);
}
