"""Newton's iteration for an equilibrium: the consistent tangent, a line search, and load steps where a whole one fails.

    f(q) + G(q)^T lambda = (1 - s) r_0,    g(q) = (1 - s) g_0,       s = 0 ... 1                                (1)

with r_0, g_0 the residuals of the start: for dead loads on unstressed bodies s is the load factor. The matrix P of a very long
time step, M / tau^2 + K, preconditions GMRES on the exact tangent J, the derivative of the left-hand sides: reactions that turn
with the bodies, weights about moved frames and all springs are in J, whatever P leaves out. With d = -J^-1 r an increment l d
is taken when

    |P^-1 r(q + l d)| <= (1 - l / 4) |P^-1 r(q)|,     l = 1, 1/2, 1/4 ...                                       (2)

Whole increments, l = 1, are tried first: a slender body that bends by them is stretched for one iteration, which (2) in the
metric of the start would take for an ascent, and answer with a thousand short increments.

Source: Deuflhard, Newton Methods for Nonlinear Problems, doi:10.1007/978-3-642-23899-4, on affine invariant tests of descent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from ...errors import ConvergenceError, LinearSolveError
from ...linear.blocks.field_blocks import Weights
from ...linear.blocks.incompressibility import move_pressures, volume_gaps, volume_push, volume_rates
from ...linear.condensation import StepSolver
from ...rotations import Array
from ...schemes.exact_tangent import exact_increment
from ...schemes.newton import ExactTangent
from ...system.impossible_shapes import inside_out
from ...system.speed_rows import speed_rows
from ..small_motions.steady import Residual

SHORTEST = 1 / 256  # load step, and share of an increment in the line search
EXACT = ExactTangent(rtol=1e-6, max_iterations=60)

WHOLE, DAMPED = 12, 40  # increments at most, without and with a line search
TINY = 1e-6  # increments, over the model's length, that ought to become smaller
ROUGH = 1e-4  # of what an iteration has moved, roundoff with which it may end
LONG = 0.5  # increment that is not taken whole, over the model's length
FALLEN = 1e-2  # of the first one, increments with inertia beside the tangent that have found an equilibrium
GOLDEN = 0.6180339887498949
NOTHING = 1e-14  # such increments, over the model's length, that are roundoff of places
ASIDE = 1e-13  # of the model's length, by which residuals are compared
UNSEEN = 1e-9  # of a displacement, by which P^-1 may answer to roundoff
SHORTEST_STEP = 1e-7  # of the preconditioner, over the first one: roundoff of stiff parts may hide soft ones

Pair = tuple[Array, Array]
Found = TypeVar("Found")
Increment = Callable[["StaticPoint", float, Pair, Pair], Pair | None]  # point, time, residuals, what they are to be


@dataclass(frozen=True, eq=False)
class StaticPoint:
    """A configuration and its multipliers; ``force`` (m,) N on the candidates of contacts, None without any."""

    q: Array
    lam: Array
    force: Array | None = None


@dataclass(eq=False)
class StaticNewton:
    """Newton's method on a :class:`Residual`; counts its work. Collective.

    ``tau`` (s): the time step of the preconditioner, long against all periods.
    """

    residual: Residual
    solver: StepSolver
    tau: float
    tolerance: float = 1e-12  # of increments, over the model's length
    iterations: int = 0
    tangent_iterations: int = 0
    moved: Array = field(
        default_factory=lambda: np.zeros(0), init=False
    )  # sum of the newest iteration's increments, like v
    slow: bool = field(default=False, init=False)  # whether the newest one was found with inertia beside the tangent
    weights: Weights = field(init=False)
    least: float = field(init=False)

    def __post_init__(self) -> None:
        self.least = SHORTEST_STEP * self.tau
        self.weights = Weights(1.0 / self.tau**2, 0.0, 1.0)

    def last_at_most(self, tau: float) -> None:
        """Make the preconditioner's step no longer than ``tau``, s."""
        self.tau = min(self.tau, tau)
        self.weights = Weights(1.0 / self.tau**2, 0.0, 1.0)

    def solvable(self, make: Callable[[], Found]) -> Found:
        """What ``make`` finds, with a shorter preconditioning step where elastic blocks are singular to roundoff; collective.

        A thin body by itself is held by its inertia alone: more of it holds what no joint holds.
        """
        pressures = self.solver.pressures
        while True:
            try:
                return make()
            except LinearSolveError:
                self.solver.pressures = pressures  # of a failed iteration they may make blocks singular by themselves
                if not self.tau >= self.least:  # what is no number is not above it either
                    raise
                self.last_at_most(self.tau / 3.0)

    # -- one tangent ----------------------------------------------------------------------------------------------
    def take(self, point: StaticPoint, t: float) -> Pair:
        """Take the tangent at a point; the residuals there."""
        ev = self.residual.at(point.q, t)
        r = self.residual.values(ev, point.lam)
        ev.take_tangents()
        self.solver.prepare(ev, self.weights)
        return r

    def inverse(
        self, point: StaticPoint, t: float, r: Pair, goal: Pair, share: float = 0.0, push: Array | float = 0.0
    ) -> Pair:
        """(J + s M / tau^2)^-1 (goal - r + push) at a point with residuals r, J exact, s = ``share``; increments of q and lambda.

        Pressures that bodies carry are in J as what follows volumes, (2) of :mod:`~fmbd_fenicsx.fem.mixed`.
        """
        system = self.residual.system
        inertia = share * self.weights.cm
        carrying = bool(self.solver.pressures)

        rolling = speed_rows(system)
        G = self.residual.at(point.q, t).jacobian if rolling.size else None

        def moved(d: Array) -> Pair:
            q = system.compose(point.q, d)
            found = self.residual.values(self.residual.at(q, t), point.lam, inertia * d)
            if G is not None:  # rows without g: the increment itself rolls
                found[1][rolling] += G.times(d)[rolling]
            followed = volume_push(self.solver, volume_rates(self.solver, d)) if carrying else 0.0
            return found[0] - goal[0] + followed, found[1] - goal[1]

        b = goal[0] - r[0], goal[1] - r[1]
        dq, dlam, count = exact_increment(EXACT, system, self.solver.solve, moved, b, push)
        self.tangent_iterations += count
        return dq, dlam

    def closing(self, point: StaticPoint, t: float, r: Pair, rest: Pair, share: float = 0.0) -> Pair:
        """The same towards ``rest``, and volumes close: pressures that bodies carry move along."""
        gaps = volume_gaps(self.residual.at(point.q, t)) if self.solver.pressures else {}
        step = self.inverse(point, t, r, rest, share, -volume_push(self.solver, gaps) if gaps else 0.0)
        move_pressures(self.solver, step[0], gaps)
        return step

    # -- a whole iteration ----------------------------------------------------------------------------------------
    def solve(self, start: StaticPoint, t: float, rest: Pair) -> StaticPoint:
        """The point where both residuals equal ``rest``; ConvergenceError where the iteration ends elsewhere."""
        self.slow = False
        # increments of the exact tangent, with inertia beside it, those that may end with roundoff: each where those before fail
        whole, damped = (WHOLE, self._whole_increment), (DAMPED, self._damped_increment)
        ways = [(whole, False, False), (damped, False, False), (whole, True, False), (whole, False, True)]
        pressures = self.solver.pressures
        if pressures:  # the solver's matrix alone bends and turns such bodies in the fewest
            ways.insert(0, ((DAMPED, self._free_increment), False, False))
        failed: list[ConvergenceError] = []
        for way, slow, rough in ways:
            self.slow, self.solver.pressures = slow, pressures
            try:
                return self._iterate(start, t, rest, *way, rough=rough)
            except ConvergenceError as error:
                failed.append(error)
        raise failed[-2]  # inertia tells most of what is missing

    def _iterate(
        self, start: StaticPoint, t: float, rest: Pair, most: int, increment: Increment, *, rough: bool = False
    ) -> StaticPoint:
        """Newton's iteration of at most ``most`` increments from ``increment``, which gives None where there is none to take.

        ``rough``: where those of a thin body stay at its roundoff, they end it when they are small beside what it has moved.
        """
        system = self.residual.system
        point = start
        sizes = [np.inf]
        self.moved = np.zeros(system.n_v)
        for _ in range(most):
            r = self.take(point, t)
            self.iterations += 1
            step = increment(point, t, r, rest)
            if step is None:
                break
            point = StaticPoint(system.compose(point.q, step[0]), point.lam + step[1])
            self.moved += step[0]

            size = system.max_abs(step[0])
            sizes.append(size)
            stalled = size > 0.5 * sizes[-2] and size <= 1e-9 * system.length
            stalled |= rough and sizes[-2] <= size <= ROUGH * system.max_abs(self.moved)
            if size <= self.tolerance * system.length or stalled:
                if self.slow and not self._fallen(sizes):
                    if stalled:
                        raise LostStiffnessError(size)
                    continue
                if not self._balanced(point, t, rest):
                    break
                if body := inside_out(system, point.q):
                    raise ConvergenceError(f'cells of body "{body}" are turned inside out')
                self.stalled = size if stalled else 0.0
                return point

            if sizes[-2] <= size <= TINY * system.length:  # roundoff, enlarged by a motion without stiffness
                break
        raise ConvergenceError(f"increments of {', '.join(f'{x:.1e}' for x in sizes[-4:])} m")

    def _free_increment(self, point: StaticPoint, t: float, r: Pair, rest: Pair) -> Pair | None:
        """Increment of the solver's own matrix, however long, the pressures of bodies with it."""
        step = self.solver.step(self.residual.at(point.q, t), rest[0] - r[0], rest[1] - r[1])
        return step if np.isfinite(self.residual.system.max_abs(step[0])) else None

    def _whole_increment(self, point: StaticPoint, t: float, r: Pair, rest: Pair) -> Pair | None:
        """Increment of the exact tangent, M / tau^2 beside it or not, unless it is long against the model.

        What may turn or slide freely has no stiffness, and roundoff would move it far; the rest hardly feels M, as tau is long.
        """
        system = self.residual.system
        dq, dlam = self.closing(point, t, r, rest, float(self.slow))
        return (dq, dlam) if system.max_abs(dq) <= LONG * system.length else None

    def _damped_increment(self, point: StaticPoint, t: float, r: Pair, rest: Pair) -> Pair | None:
        """Share (2) of the increment of the exact tangent."""
        system, before = self.residual.system, self.solver.pressures
        dq, dlam = self.closing(point, t, r, rest)
        after = self.solver.pressures
        size = system.max_abs(dq)
        if not np.isfinite(size):
            return None
        if size < TINY * system.length:
            return dq, dlam

        def take(share: float) -> StaticPoint:
            self.solver.pressures = [p + share * (q - p) for p, q in zip(before, after, strict=True)]
            return StaticPoint(system.compose(point.q, share * dq), point.lam + share * dlam)

        share = self._share(take, t, rest)
        return (share * dq, share * dlam) if share else None

    def _fallen(self, sizes: list[float]) -> bool:
        """Whether increments with inertia beside the tangent show an equilibrium: they are what is out of balance in the
        measure of M / tau^2 + K. Where tau is short against a vibration all of them are small, and the load is not carried.
        """
        return sizes[-1] <= max(FALLEN * sizes[1], NOTHING * self.residual.system.length)

    def roundoff(self, point: StaticPoint, t: float, displaced: float) -> float:
        """By how much (m) roundoff of the forces moves the newest equilibrium, which displaces bodies by so much (m); collective.

        What residuals on both sides of it miss of the way there, and increments that became no smaller; 0 where motions are free.
        """
        system, here = self.residual.system, self.take(point, t)
        if self.slow:
            return 0.0
        pattern, lost = np.arange(system.n_v) * GOLDEN % 1.0 - 0.5, self.stalled
        for way in (ASIDE, -ASIDE):
            aside = way * system.length / system.units * pattern
            there = self.residual.values(self.residual.at(system.compose(point.q, aside), t), point.lam)
            seen = self.solver.solve(there[0] - here[0], there[1] - here[1])[0]
            if system.max_abs(seen - aside) > UNSEEN * displaced:
                seen = self.inverse(point, t, here, there)[0]
            lost = max(lost, system.max_abs(seen - aside))
        return lost

    def respond(self, start: StaticPoint, t: float) -> tuple[Array, Callable[[Array], Array]]:
        """A configuration, and P^-1 there: what forces move where there is no equilibrium."""
        self.take(start, t)
        zero = np.zeros(self.residual.system.n_lam)
        return start.q, lambda b: self.solver.solve(b, zero)[0]

    def _left(self, point: StaticPoint, t: float, rest: Pair) -> float:
        """How far (m) the residuals, open volumes with them, move bodies in the measure of the preconditioner."""
        ev = self.residual.at(point.q, t)
        r, gaps = self.residual.values(ev, point.lam), volume_gaps(ev)
        push = volume_push(self.solver, gaps) if gaps else 0.0
        return self.residual.system.max_abs(self.solver.solve(rest[0] - r[0] - push, rest[1] - r[1])[0])

    def _balanced(self, point: StaticPoint, t: float, rest: Pair) -> bool:
        """Whether the residuals are small in the measure of the preconditioner: no increment is no proof where J is singular."""
        return self._left(point, t, rest) <= 1e-6 * self.residual.system.length

    def _share(self, take: Callable[[float], StaticPoint], t: float, rest: Pair) -> float:
        """The share l of (2) of an increment that ``take`` takes, 0.0 where there is none."""
        before = self._left(take(0.0), t, rest)
        share = 1.0
        while share >= SHORTEST:
            try:
                left = self._left(take(share), t, rest)
            except (ConvergenceError, LinearSolveError, ArithmeticError):
                left = np.inf
            if left <= (1.0 - 0.25 * share) * before:
                return share
            share *= 0.5
        return 0.0


def by_load_steps(newton: StaticNewton, start: StaticPoint, t: float) -> StaticPoint:
    """The equilibrium at time t by load steps (1), as long as they can be; collective.

    Raises ConvergenceError with the last load factor reached.
    """
    first = newton.residual.values(newton.residual.at(start.q, t), start.lam)
    point, reached, step = start, 0.0, 1.0

    while reached < 1.0:
        # what is out of balance at the start is let go share by share
        goal = min(reached + step, 1.0)
        rest = (1.0 - goal) * first[0], (1.0 - goal) * first[1]

        pressures = newton.solver.pressures
        try:
            point = newton.solve(point, t, rest)
        except ConvergenceError as error:
            newton.solver.pressures = pressures
            step *= 0.25
            # a smaller load is lost as well
            if step < SHORTEST or isinstance(error, LostStiffnessError):
                raise NoEquilibriumError(reached, str(error)) from error
            continue

        reached, step = goal, 2.0 * step
    return point


class LostStiffnessError(ConvergenceError):
    """Increments with inertia beside the tangent stay at one ``size`` (m) that does not carry the load."""

    def __init__(self, size: float) -> None:
        super().__init__(
            f"increments stay at {size:.1e} m, too short to carry the load: stiffness may be lost in roundoff, take cells less "
            "slender, moduli less far apart or FloatingBody(...).reduced(...)"
        )


class NoEquilibriumError(ConvergenceError):
    """Load steps ended at the load factor ``reached``."""

    def __init__(self, reached: float, why: str) -> None:
        super().__init__(f"load steps ended at {reached:.4g} of the load ({why})")
        self.reached = reached
