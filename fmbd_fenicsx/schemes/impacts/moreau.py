"""Moreau-Jean time stepping with impacts at their own times; restitution as an impulse.

    M (v_1 - v_0) / h + h(q_m, v_m) + G^T lambda = N^T P / h,     v_m = (v_0 + v_1) / 2,   q_m = q_0 o exp(h v_m / 2)   (1)
    q_1 = q_0 o exp(h v_m),     G v_m + g_t = 0                                                                         (2)
    closed contacts:  0 <= P _|_ U_1 + e U_0 >= 0,     U = N v + g_t  the gap's rate                                    (3)

The rows N are those of the middle predicted from the start of the step, so (3) is one complementarity problem. A step
is cut where a gap closes (a root of the gap along the step's parabola), and the impact is a step of (almost) no length:
between impacts the rule is of second order. Contacts that touch without approach are closed: they carry a force. In a
flight from the rates r_0 at its start to U_1 their rates are extrapolated from the start and the middle, like those of joints,

    0 <= P _|_ U_0 + U_1 - min(r_0, 0) >= 0                                                                             (4)

so that curved paths cost no energy at first order; slips likewise, by U_0 + U_1 - r_0, and those that turn about within it
by :mod:`.slip_turns`. One that leaves, r_0 > 0, and is
pressed back within the flight comes back at its speed, without work. Where all later impacts of a contact are over within a
step (Zeno), by its speed u, its restitution e and the acceleration a that the last flight presses with, 2 e u <= (1 - e) a h,
it comes to rest there. A touch that begins and ends a flight nearer than closed contacts drift needs no time of its own: it
takes part in all of the flight, with its impact. When a step has more than ``impacts`` impacts, the rest of it is taken as
classical time stepping: contacts whose gap, extrapolated to the middle, is not positive are closed, with those that would else
end below zero, and P is the impulse of all that happens.
Energy: P (U_0 + U_1) / 2 = -(1 - e) / 2 P |U_0| <= 0; with friction see :mod:`.restitution`.
Joints are kept by (2) in the mean, and projected on positions and velocities after the step.

Source: Moreau (1988), doi:10.1007/978-3-7091-2624-0_1; Jean, doi:10.1016/S0045-7825(98)00383-1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ...checks import whole
from ...linear.blocks.field_blocks import Weights
from ...linear.condensation import StepSolver
from ...system.layout import State
from ...system.scene.contents import Contents
from ...system.system import System
from ..consistent import Correction, consistent
from ..newton import Newton
from .contact_detection import refuse_penetration

if TYPE_CHECKING:
    from .moreau_stepper import MoreauStepper


@dataclass(frozen=True)
class Moreau:
    """Scheme data; restitution and friction belong to the contacts. Equations (1) to (3).

    ``impacts``: how many impacts of a step happen at their own times; 0 is classical time stepping. ``early``: contacts rest as
    soon as their later impacts are over within one step; else when they are over at the end of the step they are in, so that no
    end of a step is off by flights that are left out, at 20 to 45 % more in heaps.
    """

    impacts: int = 20
    early: bool = True
    of_friction = 1
    name = "Moreau-Jean"

    def __post_init__(self) -> None:
        whole("Moreau: impacts", self.impacts)

    @property
    def order(self) -> int:
        """Without friction; classical time stepping, with impacts at ends of steps, has order 1."""
        return 2 if self.impacts else 1

    @property
    def orders(self) -> tuple[int, int, int]:
        """Forces are means of their steps, and are read at the ends."""
        return self.order, self.order, 1

    def refusal(self, held: Contents) -> str:
        """Why it does not take what a scene holds."""
        if not held.contacts:
            return "Moreau is a scheme for scenes with contact; this scene has none. Use another scheme."
        if not held.massless:
            return ""
        return (
            f'Contact "{held.massless[0]}" is of an elastic surface whose nodes carry no inertia: they take no impulse. '
            "Use fmbd.schemes.ContactMidpoint(), a reduced body, or contact(..., redistribute_mass=False)."
        )

    def start(self, system: System, state: State, solver: StepSolver, h: float) -> tuple[State, Correction]:
        """Consistent positions and velocities; refuses overlap."""
        start, correction = consistent(system, state, solver, metric=Weights(1.0, 0.0, h * h / 4), accelerated=False)
        refuse_penetration(system, system.contacts, start)
        return start, correction

    holds = (0,)

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> MoreauStepper:
        """Time stepper from a consistent state: compiled where the driver knows bodies, forces and contacts."""
        from .compiled.driver import contact_driver

        driver = contact_driver(system, self, redundant=solver.core.redundant)
        if driver is None:
            from .moreau_stepper import MoreauStepper

            return MoreauStepper(system, solver, newton, state, self)

        from .compiled.stepper import CompiledMoreauStepper

        return CompiledMoreauStepper((system, solver, newton, state), self, driver)
