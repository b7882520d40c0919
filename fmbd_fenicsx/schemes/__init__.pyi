"""Time integration schemes; loaded at first use."""

from .impacts.contact_alpha import ContactAlpha as ContactAlpha
from .impacts.contact_midpoint import ContactMidpoint as ContactMidpoint
from .impacts.moreau import Moreau as Moreau
from .multistep.bdf import BDF as BDF
from .onestep.conserving.energy_momentum import EnergyMomentum as EnergyMomentum
from .onestep.explicit_runge_kutta import ExplicitRungeKutta as ExplicitRungeKutta
from .onestep.alpha.generalized_alpha import GeneralizedAlpha as GeneralizedAlpha
from .onestep.half_explicit import HalfExplicit as HalfExplicit
from .onestep.radau import Radau as Radau
from .onestep.rattle import Rattle as Rattle
from .stepping import TimeStepper as TimeStepper
