"""Equilibria at given load parameters, each reached from the last one along the secant of the two before it.

Between two parameters t_0 < t_1 the start of Newton's method is, with sigma = (t - t_1) / (t_1 - t_0),

    q = q_1 o+ sigma (q_1 o- q_0),       lambda = lambda_1 + sigma (lambda_1 - lambda_0)                        (1)

Steps are shortened where the method fails, and lengthened where it is fast: many load steps where a structure is soft and
slender, few where it is nearly linear. Those in which a body in space turns so far that (1) would take it the other way round are
shortened too. Limit points are not passed: take :class:`.ArcLength` there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from ...checks import check_fields
from ...errors import ConvergenceError, LinearSolveError, require
from ...rotations import Array
from ...schemes.control import TURN
from .arc_length import Path
from .static_newton import StaticNewton, StaticPoint

SHORTEST = 1e-5  # load step, as a share of the first one
FAST = 5  # iterations after which the next step may be longer


@dataclass(frozen=True)
class LoadSteps:
    """Follow equilibria through the load parameters ``stops``, ascending times of the scene (s), of which the path is made.

    ``first``: length of the first step, s; the distance to the first stop without it.
    """

    stops: tuple[float, ...]
    first: float | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        require(len(self.stops) > 0, "LoadSteps: at least one load parameter is needed, found none.")
        ascending = all(a < b for a, b in zip(self.stops, self.stops[1:], strict=False))
        require(ascending, f"LoadSteps: the load parameters must ascend, found {self.stops}.")
        require(self.first is None or self.first > 0.0, f"LoadSteps: first = {self.first} must be positive.")

    def trace(self, newton: StaticNewton, start: StaticPoint, t: float) -> Path:
        """The equilibria at the stops, from the one at t on; collective. Raises ConvergenceError with the last one reached."""
        require(t < self.stops[0], f"LoadSteps: the first parameter {self.stops[0]} must be above t = {t}.")
        made = [(t, start)]
        path = Path([t], [start])
        step = self.first or self.stops[0] - t
        system = newton.residual.system
        zero = np.zeros(system.n_v), np.zeros(system.n_lam)

        for stop in self.stops:
            while made[-1][0] < stop:
                target = min(made[-1][0] + step, stop)
                before = newton.iterations
                try:
                    first, moved = _predicted(newton, made[-2:], target)
                    point = newton.solvable(partial(newton.solve, first, target, zero))
                    if system.motions.dim == 3 and system.turning(moved + newton.moved).max() > TURN:
                        raise ConvergenceError(f"a body turns by more than {TURN:g} rad in a step")
                except (ConvergenceError, LinearSolveError) as error:
                    step = 0.5 * (target - made[-1][0])
                    if step < SHORTEST * (self.first or stop):
                        raise ConvergenceError(
                            f"No equilibrium was found beyond t = {made[-1][0]:g} s: {error}. Where the loads have their "
                            f"limit, path=fmbd.ArcLength({self.stops[-1]:g}) goes on."
                        ) from error
                    continue

                made.append((target, point))
                if newton.iterations - before <= FAST:
                    step *= 1.5
            path.add(stop, made[-1][1])
        return path


def _predicted(newton: StaticNewton, made: list[tuple[float, StaticPoint]], target: float) -> tuple[StaticPoint, Array]:
    """The point of (1), and the increments to it, like v."""
    system, (t, last) = newton.residual.system, made[-1]
    if len(made) < 2:
        return last, np.zeros(system.n_v)
    before, past = made[0]
    share = (target - t) / (t - before)
    moved = share * system.difference(past.q, last.q)
    return StaticPoint(system.compose(last.q, moved), last.lam + share * (last.lam - past.lam)), moved
