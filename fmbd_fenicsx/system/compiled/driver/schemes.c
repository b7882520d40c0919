/* Steps of generalized-alpha, of energy-momentum and explicit schemes, of RATTLE; marches of all schemes. */

#include "tables.h"
#include "rotations.c"
#include "parts.h"
#include "explicit.c"
#include "secants.c"
#include "mean.c"
#include "alpha.c"
#include "rattle.c"
#include "runge_kutta.c"
#include "mean_steps.c"
#include "control.c"
#include "march.c"
