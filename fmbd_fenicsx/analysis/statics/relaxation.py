"""Dynamic relaxation: a motion that is stopped wherever forces begin to brake it comes to rest near a stable equilibrium.

    M (v_n+1 - v_n) / tau + f(q_n+1) + G^T lambda = 0,    q_n+1 = q_n + tau v_n+1,    g(q_n+1) = 0                      (1)

Every implicit step is solved whole: a stiff bar that turns far is as long after it as before, which one increment of Newton
would stretch. Steps are shorter where Newton's iteration fails, and where an elastic block is singular to roundoff.

Source: Barnes, Form finding and analysis of tension structures by dynamic relaxation, doi:10.1260/0266351991494722, on damping by
stops at peaks of the kinetic energy.
"""

from __future__ import annotations

import numpy as np

from ...errors import ConvergenceError, LinearSolveError
from ...linear.blocks.field_blocks import Weights
from ...rotations import Array
from .static_newton import LONG, SHORTEST, WHOLE, StaticNewton, StaticPoint

MOST = 600  # steps
RESTS = 1e-4  # the last swing, over the model's length
CLOSE = 0.03  # the last increment of a step, over its way
LEFT = 10.0  # the way from the start that leads to no rest, over the model's length


def relax(newton: StaticNewton, start: StaticPoint, t: float, slow: float) -> StaticPoint:
    """A point near a stable equilibrium, by (1) from a start; ``slow`` (s): the longest step. Collective.

    Raises ConvergenceError where no rest is found.
    """
    system = newton.residual.system
    still: Array = np.zeros(system.n_v)
    tau = longest = slow
    turn = point = StaticPoint(start.q, np.zeros(system.n_lam))
    v = still

    for _ in range(MOST):
        pressures = newton.solver.pressures
        try:
            there = _drawn(newton, point, t, tau, v)
        except (ConvergenceError, LinearSolveError) as error:
            newton.solver.pressures = pressures
            tau *= 0.5
            if isinstance(error, LinearSolveError):  # so it would be in longer steps
                longest = tau
            if tau < SHORTEST * slow:
                break
            continue

        way = system.difference(point.q, there.q)
        point, v = there, way / tau
        braking = newton.residual.values(newton.residual.at(point.q, t), point.lam)[0]
        if system.dot(way, braking) >= 0.0:
            if system.max_abs(system.difference(turn.q, point.q)) <= RESTS * system.length:
                return point
            turn, v = point, still

        tau = min(2.0 * tau, longest)
        if system.max_abs(system.difference(start.q, point.q)) > LEFT * system.length:
            break
    raise ConvergenceError("a motion that is stopped at its fastest comes to no rest")


def _drawn(newton: StaticNewton, start: StaticPoint, t: float, tau: float, v: Array) -> StaticPoint:
    """Where a step of :func:`relax` ends; ConvergenceError where it is not found."""
    system, point = newton.residual.system, start
    weights = Weights(1.0 / tau**2, 0.0, 1.0)
    for _ in range(WHOLE):
        ev = newton.residual.at(point.q, t)
        way = system.difference(start.q, point.q)
        r = newton.residual.values(ev, point.lam, (way / tau - v) / tau)
        ev.take_tangents()
        newton.solver.prepare(ev, weights)
        newton.iterations += 1

        d, dlam = newton.solver.step(ev, -r[0], -r[1])
        size = system.max_abs(d)
        if not size <= LONG * system.length:
            break

        point = StaticPoint(system.compose(point.q, d), point.lam + dlam)
        if size <= CLOSE * max(system.max_abs(way), RESTS * system.length):
            return point
    raise ConvergenceError(f"increments of {size:.1e} m in a step of a descent")
