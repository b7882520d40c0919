"""Equilibria with contact and joint limits: Newton's iteration whose increments keep the unilateral conditions.

    f(q) + G(q)^T lambda - N(q)^T Lambda = 0,    g(q) = 0,    0 <= Lambda  _|_  gap(q) >= 0                       (1)

without friction. The rows N and gaps are those of a run, forces come from the same complementarity problem, without penalty.
An increment is made twice. With the matrix P of a very long time step, as of :mod:`.static_newton`, it is

    z = -P^-1 f,    W = N P^-1 N^T,    0 <= Lambda  _|_  gap + N z + W Lambda >= 0,    d = z + P^-1 N^T Lambda      (2)

the implicit step of a motion without velocity: it descends, and says which points touch. With these held closed, Newton's
increment has the exact tangent J of (1), the turning of N included, and M / tau^2 as well: what a body without friction may do
unhindered (slide along a floor, roll on it) has no stiffness, and roundoff would move it far. Points that would pull are let go,
points that would pass through are held. It is taken where (2) becomes shorter by it, otherwise (2) itself is. Both are zero at
the same places.

Source of the active sets: Hintermueller, Ito and Kunisch, doi:10.1137/S1052623401383558.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...errors import ConvergenceError, LinearSolveError, require
from ...linear.blocks.field_blocks import Weights
from ...linear.complementarity.coulomb import ContactCounts
from ...linear.complementarity.coulomb_matrix_free import contact_forces
from ...linear.complementarity.delassus import Compliance
from ...mechanics.contact.contact_set import ContactSet
from ...mechanics.contact.rows import Rows
from ...rotations import Array
from ...schemes.exact_tangent import exact_increment
from ...system.layout import State
from ...system.sensors.contact import WORKS, ContactForces, ContactState
from ...system.speed_rows import speed_rows
from ...system.system import System
from .static_newton import EXACT, LONG, Pair, StaticNewton, StaticPoint

MOST = 40  # increments
LONGEST = 0.2  # increment (2) that is taken whole, over the model's length
FLOOR = 1e-9  # increments, over the model's length, below which roundoff may make them grow
BALANCED = 1e-8  # forces left over, over the largest contact force, below which they may be roundoff
CLOSE = 1e-2  # gap, over the model's length, up to which a point is a candidate anyhow
FAR = 3.0  # gap, over the length of an increment, beyond which a point cannot be met by it
SHORTER = 12  # times that the time step of (2) is shortened
SLOW = 0.5  # share of an increment (2) that is left behind it, from which on its time step becomes longer
LONGER = 3.0  # by which factor
CHANGES = 6  # of the set of closed points in one increment


@dataclass(frozen=True, eq=False)
class Touching:
    """A point with its increment (2): ``near`` (m,) bool, the candidates' ``rows`` and matrix W, forces Lambda on them."""

    point: StaticPoint
    residual: Pair
    near: np.ndarray
    rows: Rows
    W: Any
    step: Pair
    force: Array
    size: float


@dataclass(eq=False)
class ContactNewton(StaticNewton):
    """Newton's method on (1); methods are collective."""

    counts: ContactCounts = field(default_factory=ContactCounts)
    last: Touching | None = None  # where the iteration was when it ended

    def __post_init__(self) -> None:
        super().__post_init__()
        self.contacts: ContactSet = self.residual.system.contacts
        self.compliance = Compliance(self.solver, self.contacts)

    # -- the increment of a long step -------------------------------------------------------------------------------
    def look(self, point: StaticPoint, t: float, rest: Pair) -> Touching:
        """The increment (2) at a point; with a shorter time step where it would go too far for rows of this place."""
        system = self.residual.system
        weights = self.weights
        longest = LONGEST * system.length

        r = self.take(point, t)
        r = r[0] - rest[0], r[1] - rest[1]
        ev = self.residual.at(point.q, t)

        for _ in range(SHORTER):
            found = self._increment(point, t, r)
            if found.size <= longest:
                break
            # more inertia: increments fall with the square of the time step
            self.weights = Weights(self.weights.cm * max(1.5 * found.size / longest, 2.0), 0.0, 1.0)
            ev.balance(np.zeros(system.n_v), point.lam)
            self.solver.prepare(ev, self.weights)

        self.weights = weights
        return found

    def _increment(self, point: StaticPoint, t: float, r: Pair) -> Touching:
        """The increment (2) with the matrix that the solver has; candidates are points that are near or come near by it."""
        system = self.residual.system
        contacts = self.contacts
        length = system.length

        # where the points would go without contact
        free = self.solver.solve(-r[0], -r[1])
        contacts.update(system, point.q, min(2.0 * system.max_abs(free[0]), LONG * length))

        everything = contacts.rows(system, t, point.q)
        near = np.isfinite(everything.gap) & (everything.gap < CLOSE * length)

        while True:
            rows = everything.take(near)
            W, force, step = self._complementary(rows, r, free)
            size = system.max_abs(step[0])

            # points that this increment brings through a surface join in
            after = everything.gap + contacts.times(system, everything.N, step[0])
            reach = np.isfinite(after) & (everything.gap < FAR * size)
            # gaps below the roundoff of the model's length are none
            missed = reach & (after < -FLOOR * length) & ~near
            if not missed.any() or size > LONGEST * length:
                return Touching(point, r, near, rows, W, step, force, size)

            near = near | missed

    def _complementary(self, rows: Rows, r: Pair, free: Pair) -> tuple[Any, Array, Pair]:
        """W, Lambda and d of (2) on candidates; ``free``: the increment without their forces."""
        system, contacts = self.residual.system, self.contacts
        if not len(rows.gap):
            return np.zeros((0, 0)), np.zeros(0), free
        W = self.compliance.of(rows.N, rows.trace, 1.0)
        reached = rows.gap + contacts.times(system, rows.N, free[0])
        none = np.zeros_like(reached)
        force = contact_forces(W, reached, none, none[:, None], self.counts)[:, 0]
        if not force.any():
            return W, force, free
        return W, force, self.solver.solve(contacts.transposed(system, rows.N, force) - r[0], -r[1])

    # -- the increment of the exact tangent -------------------------------------------------------------------------
    def exact(self, here: Touching, t: float) -> tuple[Pair, Array] | None:
        """Newton's increment and the forces on the candidates after it; None where no set of closed points fits."""
        system = self.residual.system
        closed = here.force > 0.0
        tiny = FLOOR * max(float(here.force.max(initial=0.0)), 1e-300)
        for _ in range(CHANGES):
            step, force = self._held_increment(here, closed, t)
            if not np.isfinite(system.max_abs(step[0])):
                return None
            after = here.rows.gap + self.contacts.times(system, here.rows.N, step[0])
            pulls = closed & (force < -tiny)
            passes = ~closed & (after < -1e-12 * system.length)
            if not (pulls | passes).any():
                return step, force
            closed = (closed & ~pulls) | passes
        return None

    def _held_increment(self, here: Touching, closed: np.ndarray, t: float) -> tuple[Pair, Array]:
        """(J + M / tau^2)^-1 of the residual of (1) with some candidates held closed; forces on all candidates."""
        system = self.residual.system
        contacts = self.contacts
        point = here.point
        force = np.where(closed, here.force, 0.0)[closed]
        which = np.flatnonzero(here.near)[closed]
        rows = here.rows.take(closed)

        rolling = speed_rows(system)
        G = self.residual.at(point.q, t).jacobian if rolling.size else None
        unmoved = self.residual.values(self.residual.at(point.q, t), point.lam)
        rest = unmoved[0] - here.residual[0], unmoved[1] - here.residual[1]

        def moved(d: Array) -> Pair:
            q = system.compose(point.q, d)
            r, g = self.residual.values(self.residual.at(q, t), point.lam, self.solver.weights.cm * d)
            if G is not None:  # rows without g: the increment itself rolls
                g[rolling] += G.times(d)[rolling]
            there = contacts.rows(system, t, q).take(which)
            return r - rest[0] - contacts.transposed(system, there.N, force), np.append(g - rest[1], there.gap)

        b = contacts.transposed(system, rows.N, force) - here.residual[0], -np.append(here.residual[1], rows.gap)
        solve = self.holding(here, closed)
        dq, reactions, count = exact_increment(EXACT, system, solve, moved, b)
        self.tangent_iterations += count
        found: Array = np.zeros(len(closed))
        found[closed] = force + reactions[system.n_lam :]
        return (dq, reactions[: system.n_lam]), found

    def holding(self, here: Touching, closed: np.ndarray) -> Any:
        """P^-1 with the candidates ``closed`` held beside the joints: b, (g, gaps) -> increment, (lambda, forces)."""
        system = self.residual.system
        contacts = self.contacts
        n = system.n_lam
        N = here.rows.N.take(closed)
        count = int(closed.sum())
        if not count:
            return self.solver.solve
        W = here.W if isinstance(here.W, np.ndarray) else None
        chosen = self._matrix(here.W, np.flatnonzero(closed)) if W is None else W[np.ix_(closed, closed)]
        inverse = np.linalg.pinv(
            chosen, rcond=1e-12, hermitian=True
        )  # of points that depend on each other: least forces

        def solve(b: Array, c: Array) -> Pair:
            z, _ = self.solver.solve(b, c[:n])
            force = inverse @ (c[n:] - contacts.times(system, N, z))
            dq, dlam = self.solver.solve(b + contacts.transposed(system, N, force), c[:n])
            return dq, np.append(dlam, force)

        return solve

    def _matrix(self, W: Any, closed: np.ndarray) -> Array:
        """The stored matrix of some candidates from products with W."""
        columns = np.zeros((len(closed), len(closed)))
        for k, i in enumerate(closed):
            unit: Array = np.zeros(W.inverse.shape[0])
            unit[i] = 1.0
            columns[:, k] = (W @ unit)[closed]
        return 0.5 * (columns + columns.T)

    # -- the iteration ----------------------------------------------------------------------------------------------
    def solve(self, start: StaticPoint, t: float, rest: Pair) -> StaticPoint:
        """The point where the residuals of (1) equal ``rest``; ConvergenceError where the iteration ends elsewhere."""
        usual = self.weights
        try:
            return self._iterated(start, t, rest)
        finally:
            self.weights = usual

    def _iterated(self, start: StaticPoint, t: float, rest: Pair) -> StaticPoint:
        """The same; the time step of (2) may be left longer."""
        system = self.residual.system
        here = self.look(start, t, rest)
        before = np.inf
        left = np.inf
        for _ in range(MOST):
            self.last = here
            self.iterations += 1

            last, left = left, self._left_over(here)
            roundoff = left <= BALANCED and left > 0.5 * last  # slender bodies roll far by it
            if here.size <= self.tolerance * system.length or roundoff:
                return self._with_forces(here)

            # by the forces' own tangent first, where that is at hand
            there, size = self._by_exact(here, t, rest)
            if there is not None:
                # increments that no longer shrink are roundoff
                stalled = size > 0.5 * before and size <= FLOOR * system.length
                ended = size <= self.tolerance * system.length or stalled
                if ended and there.size <= 1e-6 * system.length:
                    return self._with_forces(there)
                here, before = self._less_held(here, there, t, rest), size
                continue

            # else an increment that is not too long for the contacts found
            share = min(1.0, LONGEST * system.length / max(here.size, 1e-300))
            there = self.look(self._moved(here.point, here.step, share), t, rest)
            here, before = self._less_held(here, there, t, rest) if share == 1.0 else there, np.inf
        raise ConvergenceError(f"increments of {here.size:.1e} m with contact")

    def _less_held(self, here: Touching, there: Touching, t: float, rest: Pair) -> Touching:
        """The place after an increment (2), looked at with a longer time step where inertia held the increment up, not springs.

        Springs of stiffness k leave the share s = 1 / (1 + k tau^2 / m) of it, and a way of s / (1 - s) of it. What is free to
        move leaves all: of a way beyond the model's length nothing is known, nor of roundoff.
        """
        left, size = there.size / here.size, there.size / self.residual.system.length
        touching = here.force.any() and there.force.any()
        if not touching or not SLOW < left < 1.0 or not FLOOR < size <= 1.0 - left:
            return there

        usual = self.weights
        self.weights = Weights(usual.cm / LONGER**2, 0.0, 1.0)
        try:
            longer = self.look(there.point, t, rest)
            # springs in compression may push further without inertia
            if longer.size <= LONGER**2 * there.size and self.solver.weights == self.weights:
                return longer
        except LinearSolveError:  # singular to roundoff
            pass
        self.weights = usual
        return self.look(there.point, t, rest)

    def _left_over(self, here: Touching) -> float:
        """Forces that nothing balances, over the largest contact force; infinite where gaps or joints are not closed."""
        system = self.residual.system
        balance, joints = here.residual
        gap = here.rows.gap

        # joints, bodies in each other, and gaps under forces
        closed = gap[here.force > 0.0]
        open_by = max(np.abs(joints).max(initial=0.0), -gap.min(initial=0.0), closed.max(initial=0.0))
        if open_by > FLOOR * system.length:
            return float("inf")

        pushed: Array = np.zeros(system.n_v)
        if len(here.force):
            pushed = self.contacts.transposed(system, here.rows.N, here.force)
        moments = 1.0 / system.units**2  # are divided by the length, as rotations are multiplied by it
        scale = system.max_abs(moments * pushed)
        return system.max_abs(moments * (balance - pushed)) / scale if scale else float("inf")

    def _by_exact(self, here: Touching, t: float, rest: Pair) -> tuple[Touching | None, float]:
        """The point after the increment of the exact tangent and its length; None where it is no way forward."""
        system = self.residual.system
        found = self.exact(here, t)
        if found is None or not (size := system.max_abs(found[0][0])) <= LONG * system.length:
            return None, np.inf
        try:
            there = self.look(self._moved(here.point, found[0], 1.0), t, rest)
        except (ConvergenceError, LinearSolveError, ArithmeticError):
            return None, np.inf
        good = there.size <= max(0.7 * here.size, FLOOR * system.length)
        return (there, size) if good else (None, np.inf)

    def _moved(self, point: StaticPoint, step: Pair, share: float) -> StaticPoint:
        system = self.residual.system
        return StaticPoint(system.compose(point.q, share * step[0]), point.lam + share * step[1])

    def _with_forces(self, here: Touching) -> StaticPoint:
        force: Array = np.zeros(len(here.near))
        force[here.near] = here.force
        return replace(here.point, force=force)

    # -- what moves where there is no equilibrium ---------------------------------------------------------------------
    def respond(self, start: StaticPoint, t: float) -> tuple[Array, Any]:
        """Configuration where the iteration ended, and P^-1 there with the points that touch held closed."""
        none = np.zeros(self.residual.system.n_v), np.zeros(self.residual.system.n_lam)
        here = self.look(start if self.last is None else self.last.point, t, none)
        closed = here.force > 0.0
        solve = self.holding(here, closed)
        more = np.zeros(int(closed.sum()))
        return here.point.q, lambda b: solve(b, np.append(none[1], more))[0]


def check_closed_contacts(system: System) -> None:
    """Refuse contacts whose equilibrium is not determined, or not offered; each by name."""
    contacts = system.contacts
    rough = [p.name for p in contacts.pairs if p.friction > 0.0]
    require(
        not rough,
        f'Contact "{(rough or [""])[0]}" has friction: its equilibrium depends on the history, as any force within the cone '
        "may be left by it. Run solve(...) with damping to the resting state, or take friction=0.0.",
    )
    carried = [p.name for _, p in system.fields if p.field.carried]
    require(
        not carried,
        f'Body "{(carried or [""])[0]}" carries its pressure as an unknown: its equilibrium with contact is not offered. '
        "Run solve(...) with damping to the resting state.",
    )


def state_with_contact(system: System, state: State, force: Array | None) -> ContactState:
    """A state that contact sensors can read: forces (m,) N on all candidates, no impulses and works; collective."""
    contacts = system.contacts
    at = contacts.touch(system, state.t, state.q)
    normal = np.zeros(len(at.gap)) if force is None else force
    impulse = np.zeros((len(contacts.pairs), system.motions.dim))
    found = ContactForces(
        contacts.names, state.t, contacts.pair, at.x, at.normal, at.geometric, normal, normal[:, None] * at.normal,
        contacts.pressures(normal), impulse, np.zeros(len(WORKS)),
    )  # fmt: skip
    return ContactState(state.t, state.q, state.v, state.a, state.lam, found)
