/* Stage systems of implicit schemes, and steps of Radau and BDF: compiled beside the core, at the same time. */

#include "tables.h"
#include "rotations.c"
#include "parts.h"
#include "convergence.c"
#include "error_norm.c"
#include "tangent.c"
#include "stages.c"
#include "field_steps.c"
#include "own_steps.c"
#include "implicit.c"
#include "radau.c"
#include "bdf.c"
