/* The core of the driver: the evaluation, the solver and generalized-alpha. What a scene may lack are units of their own, compiled
   and linked where it is there (library.py), and so are the kernels of kinds. For the plane (-DDIM=2) and for space (-DDIM=3). */

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
#include "tangent.c"
#include "convergence.c"
#include "stages.c"
#include "field_steps.c"
#include "explicit.c"
#include "secants.c"
#include "mean.c"
#include "alpha.c"
#include "rattle.c"
#include "runge_kutta.c"
#include "mean_steps.c"
#include "implicit.c"
#include "own_steps.c"
#include "radau.c"
#include "bdf.c"
#include "control.c"
#include "march.c"

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
