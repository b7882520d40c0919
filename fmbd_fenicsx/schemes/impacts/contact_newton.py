"""The unilateral part of a Newton step, the same for all schemes with contact.

For the residual r of the balance without contact forces, scaled by s, and u the gaps (velocities, for impacts) of the
present iterate, with tangential slips where there is friction,

    z = step without change of force,   W = s L A^-1 L^T,   u + L z + W (f_new - f)  complementary to  f_new   (1)

L holds the rows of the candidates; f_new comes from one small problem, and a second back-solve gives the
step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ...linear.blocks.field_blocks import Weights
from ...linear.complementarity.coulomb import ContactCounts
from ...linear.complementarity.coulomb_matrix_free import contact_forces
from ...linear.complementarity.delassus import Compliance
from ...mechanics.contact.contact_set import ContactSet
from ...mechanics.contact.rows import Rows
from ...rotations import Array
from ...system.evaluation import Evaluation
from ..newton import ADVICE, not_converged
from .restitution import Impact

if TYPE_CHECKING:
    from .compiled.problem import CompiledProblem
    from .contact_stepper import ContactStepper


class UnilateralForces:
    """Forces ``force`` (m, 1 or d) on the candidates of one step, improved by each call of
    :meth:`increment`. ``problem``: who finds them in compiled code; ``impact``: what bounds rebounds, for impacts.
    """

    impact: Impact | None = None

    def __init__(
        self, compliance: Compliance, counts: ContactCounts, force: Array, problem: CompiledProblem | None = None
    ) -> None:
        self.problem = problem
        self.compliance, self.counts, self.force = compliance, counts, force
        self.solver, self.contacts = compliance.solver, compliance.contacts
        self.rows: Rows | None = None
        self._W: Any = None

    def increment(self, rows: Rows, u: Array, residuals: tuple[Array, Array], scale: float) -> tuple[Array, Array]:
        """Steps of the unknowns and of the joints' multipliers (scaled) by (1); residuals of balance and
        joints. Collective.
        """
        contacts: ContactSet = self.contacts
        system = self.solver.system
        solver = self.solver
        self.rows = rows

        # the increment without a change of the contact forces
        L = rows.L
        r = residuals[0] - contacts.transposed(system, L, self.force.ravel())
        z, dl = solver.solve(-scale * r, -residuals[1])

        if self._W is None:
            self._W = self.compliance.of(L, rows.trace, scale)
        W = self._W
        gap = u.ravel() + contacts.times(system, L, z)

        def solve(gap: Array) -> Array:
            return small_problem(self.problem, W, (gap, rows.friction), self.force, self.counts)

        force = solve(gap) if self.impact is None else self.impact.forces(W, gap, self.force, solve)

        # what the change of the forces adds
        change, self.force = force - self.force, force
        if not change.any():
            return z, dl
        return solver.solve(-scale * (r - contacts.transposed(system, L, change.ravel())), -residuals[1])

    def opened(self, u: Array) -> Array:
        """What opens (m, 1 or d) under the forces of the law, for openings u under the present ones; they are none of the step.

        By the compliance of the last increment.
        """
        assert self.rows is not None
        force = small_problem(self.problem, self._W, (u.ravel(), self.rows.friction), self.force, ContactCounts())
        return u + np.asarray(self._W @ (force - self.force).ravel()).reshape(u.shape)

    def sizes_of_groups(self) -> Array:
        """How many contacts each of them (m,) moves, at once or by others, with itself."""
        m, d = self.force.shape
        if not isinstance(self._W, np.ndarray):
            return np.full(m, m)
        from scipy.sparse.csgraph import connected_components

        labels = connected_components(np.abs(self._W).reshape(m, d, m, d).any(axis=(1, 3)))[1]
        return np.bincount(labels)[labels]

    def renew(self) -> None:
        """The matrix is a new one."""
        self._W = None


class ContactStep:
    """One step of length h (s) from the state of a stepper, with the multipliers ``lam`` of joints: what Newton's iterations of
    all schemes with contact share. ``force`` (m, 1 or d): of the contacts that take part, to begin with.
    """

    p: ContactStepper

    def __init__(self, stepper: ContactStepper, h: float, force: Array) -> None:
        self.p, self.h = stepper, h
        self.lam = stepper.state.lam.copy()
        self.contact = UnilateralForces(stepper.compliance, stepper.ledger.counts, force, stepper.problem)
        self.ev: Evaluation = None  # type: ignore[assignment]
        self._prepared = False

    def solve(self) -> int:
        """Iterate; how many increments that took. Raises ConvergenceError; collective."""
        return len(self.iterate())

    def iterate(self, foretold: Callable[[float], float] = lambda size: math.inf) -> list[float]:
        """The increments of the iteration, over the tolerance; ``foretold``: see :meth:`.Newton.solve`."""
        converged, history = self.p.newton.solve(self.increment, self.renew, foretold=foretold)
        if not converged:
            raise not_converged(self.p.state.t + self.h, self.h, history, self.advice)
        return history

    @property
    def advice(self) -> str:
        """What is said of an iteration that does not converge."""
        return ADVICE

    @property
    def _apart(self) -> bool:
        """Whether no contact takes part."""
        return not len(self.contact.force)

    def increment(self) -> float:
        """One Newton step; returns its size over the tolerance."""
        raise NotImplementedError

    def renew(self) -> bool:
        """A new tangent where the last increment began, without fields where the next one does; whether there is one."""
        renewed = self.p.solver.refresh(self.ev, apart=self._apart)
        if not self.p.system.fields:
            self._prepared, renewed = False, True
        if renewed:
            self.contact.renew()
        return renewed

    def balance(self, at: tuple[float, Array, Array], a: Array, weights: Weights) -> Array:
        """Forces out of balance at (t, q, v) under accelerations a; with the first of a step its matrix is prepared there."""
        ev = self.ev = self.p.system.at(*at)
        ev.forces = a, self.lam
        self.p.solver.prepare(ev, weights, keep=self._prepared, apart=self._apart)
        self._prepared = True
        return ev.balance(a, self.lam)

    def changes(
        self, touching: tuple[Rows, Array] | None, residuals: tuple[Array, Array], scale: float
    ) -> tuple[Array, Array]:
        """Of the unknowns, and of the multipliers (scaled); ``touching``: rows and openings of the contacts that take part."""
        if touching is None:
            return self.p.solver.solve(-scale * residuals[0], -residuals[1])
        return self.contact.increment(*touching, residuals, scale)


def small_problem(
    problem: CompiledProblem | None, W: Any, given: tuple[Array, Array], force: Array, counts: ContactCounts
) -> Array:
    """Forces (m, 1 or d) of the law of contact, ``given`` what is open, (m d,), under ``force``, and the friction (m,): those of
    compiled code where it finds them. Collective.
    """
    gap, mu = given
    if problem is not None and isinstance(W, np.ndarray):
        found = problem.forces(W, gap.reshape(force.shape), mu, force, counts)
        if found is not None:
            return found
    return contact_forces(W, gap, mu, force, counts)


def openings(contacts: ContactSet, system: Any, rows: Rows, gap: Array, xi: Array) -> Array:
    """Gaps, and slips over a step with the increment xi where there is friction: (m, 1 or d); collective."""
    if rows.components == 1:
        return gap[:, None]
    slips = contacts.times(system, rows.L, xi).reshape(-1, rows.components)[:, 1:] - rows.drift
    return np.concatenate((gap[:, None], slips), axis=1)
