"""Which contacts hold in small motions of a scene whose contacts carry forces: see :mod:`..small_motions.closed_contacts`.

A point that touches without force could open or close, its motion has no linear model; it is taken as open, with a warning.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import InputError, require
from ...linear.condensation import StepSolver
from ...log import log
from ...system.layout import State
from ...system.sensors.contact import ContactSensor, LimitEffort
from ...system.system import System
from ..small_motions.closed_contacts import ClosedContacts
from ..statics.equilibrium import Equilibrium
from ..statics.search import static_newton
from ..statics.static_contact import FLOOR, ContactNewton
from ..statics.static_newton import StaticPoint

STILL = 1e-6  # increment of the equilibrium, over the model's length, that counts as none
NO_FORCE = 1e-9  # share of the largest force below which a point carries none


def closed_contacts(at: Any, system: System, solver: StepSolver) -> ClosedContacts:
    """The points that carry forces at an equilibrium; collective.

    Raises InputError where ``at`` is no equilibrium: only there it is known which points touch.
    """
    require(
        isinstance(at, Equilibrium),
        "Modes and linear models of a scene with contact or joint limits are those about an equilibrium, where it is known which "
        "points touch: at=fmbd.equilibrium(scene).",
    )
    require(
        len(at.state.q) == system.n_q and len(at.state.lam) == system.n_lam,
        f"The equilibrium belongs to another scene or number of ranks: {len(at.state.q)} coordinates, not {system.n_q}.",
    )

    newton: Any = static_newton(system, solver, at.state, at.spin, balanced=True)
    assert isinstance(newton, ContactNewton)
    none = np.zeros(system.n_v), np.zeros(system.n_lam)
    here = newton.look(StaticPoint(at.state.q, at.state.lam), at.state.t, none)
    if here.size > STILL * system.length:
        raise InputError(
            f"The scene is not in equilibrium at this state: with its contacts it moves by {here.size:.3g} m."
        )

    least = NO_FORCE * float(here.force.max(initial=0.0))
    carries = here.force > least
    idle = int(((here.rows.gap < FLOOR * system.length) & ~carries).sum())
    if idle:
        log.warning(
            "%d points touch without force: they are taken as open, they would hold in one direction only", idle
        )
    which = np.flatnonzero(here.near)[carries]
    return ClosedContacts(system, at.state.t, which, here.rows.take(carries), here.force[carries])


def without_forces(state: State) -> State:
    """The state without what its contacts carried, which no small motion keeps."""
    return State(state.t, state.q, state.v, state.a, state.lam)


def without_contact(sensors: dict[str, Any]) -> dict[str, Any]:
    """The sensors that do not read forces or gaps of contacts or joint limits: these are unknown in small motions."""
    return {name: s for name, s in sensors.items() if not isinstance(s, ContactSensor | LimitEffort)}
