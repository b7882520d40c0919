/* Stage systems of implicit schemes, and steps of Radau and BDF: compiled beside the core, at the same time. */

#include "tables.h"
#include "algebra/rotations.c"
#include "parts.h"
#include "implicit/convergence.c"
#include "marches/error_norm.c"
#include "implicit/tangent.c"
#include "implicit/stages.c"
#include "implicit/field_steps.c"
#include "marches/own_steps.c"
#include "implicit/implicit.c"
#include "implicit/radau.c"
#include "implicit/bdf.c"
