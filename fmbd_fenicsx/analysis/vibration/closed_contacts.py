"""Small motions of a scene whose contacts carry forces: points that touch hold, the others are free.

    (M, C, K) y  with  K including  -d(N^T) Lambda / dq,       G y = 0,     N_c y = 0                         (1)

for the rows N_c of points with forces Lambda > 0 at an equilibrium: motions so small that no point opens or closes. A point that
touches without force could do both, its motion has no linear model; it is taken as open, with a warning.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError, require
from ...linear.condensation import StepSolver
from ...log import log
from ...mechanics.contact.rows import ContactSet, Rows
from ...rotations import Array
from ...system.sensors.contact import ContactSensor, LimitEffort
from ...system.system import State, System
from ..statics.equilibrium import Equilibrium, static_newton
from ..statics.static_contact import FLOOR, ContactNewton
from ..statics.static_newton import StaticPoint

STILL = 1e-6  # increment of the equilibrium, over the model's length, that counts as none
NO_FORCE = 1e-9  # share of the largest force below which a point carries none


@dataclass(frozen=True, eq=False)
class ClosedContacts:
    """Points that hold: ``which`` of the candidates, their ``rows`` and forces (k,) N at the equilibrium."""

    system: System
    t: float
    which: np.ndarray
    rows: Rows
    force: Array

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.force)

    @property
    def contacts(self) -> ContactSet:
        """All contacts of the scene."""
        return self.system.contacts  # type: ignore[no-any-return]

    def times(self, y: Array) -> Array:
        """N_c y, (k,); collective."""
        return self.contacts.times(self.system, self.rows.N, y)

    def pushed(self, q: Array) -> Array:
        """N_c^T Lambda in a configuration nearby, like v; collective."""
        there = self.contacts.rows(self.system, self.t, q).take(self.which)
        return self.contacts.transposed(self.system, there.N, self.force)

    def held(self, solver: StepSolver) -> Callable[[Array, Array], tuple[Array, Array]]:
        """The prepared solver's inverse with the points held: (b, (g, gaps)) -> increment, (lambda, forces); collective."""
        system, n = self.system, self.system.n_lam
        none = np.zeros(n)
        units = np.eye(self.count)
        push = [self.contacts.transposed(system, self.rows.N, e) for e in units]
        answers = np.array([solver.solve(p, none)[0] for p in push]).reshape(self.count, system.n_v)
        W = np.array([self.times(x) for x in answers]).reshape(self.count, self.count)
        inverse = np.linalg.pinv(0.5 * (W + W.T), rcond=1e-12, hermitian=True)

        def solve(b: Array, c: Array) -> tuple[Array, Array]:
            z, lam = solver.solve(b, c[:n])
            force = inverse @ (c[n:] - self.times(z))
            if not force.any():
                return z, np.append(lam, force)
            dq, lam = solver.solve(b + self.contacts.transposed(system, self.rows.N, force), c[:n])
            return dq, np.append(lam, -force)

        return solve


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
    newton: Any = static_newton(system, solver, at.state.t, at.spin)
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
