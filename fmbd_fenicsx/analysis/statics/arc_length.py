"""Paths of equilibria by pseudo-arc length: the scene's time is the load parameter, and may turn back at limit points.

With F(x, t) = 0 the equations of an equilibrium, x = (q, lambda), a step of length s from (x_0, t_0) along the tangent (d, e) is

    F(x, t) = 0,     (d, q o- q_0) / L^2 + e (t - t_0) / T^2 = s                                              (1)

solved by Newton's method with two solutions of J a time, J u = -F and J w = -F_t (Keller's bordering). Source: Riks,
doi:10.1016/0020-7683(79)90081-7; Keller, Lectures on Numerical Methods in Bifurcation Problems, 1987.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ...checks import check_fields
from ...errors import ConvergenceError, LinearSolveError, require
from ...rotations import Array
from .static_newton import StaticNewton, StaticPoint

SHARP = 0.5  # way aside of the tangent, over that along it, beyond which another branch was met
JUMP = 0.5  # way beside the mean of the tangents at both ends of a step, over its length, beyond which it has jumped to one
NOTHING = 1e-6  # of a step: motion that is none
LEVEL = 1e-8  # of the span: error of the parameter at a limit point
MOST_LOOKS = 20  # for one
SHORT = 1e-2  # share of the largest step below which it is a corner of the path


Direction = tuple[Array, float]  # of (1): an increment of q and one of the load parameter over the span


@dataclass(eq=False)
class Path:
    """Points of a path. ``parameter`` (n,): the scene's time at each; ``series``: sensor -> (n, size).

    ``limits``: numbers of the points, themselves limit points, after which the load parameter turns back.
    """

    parameter: list[float] = field(default_factory=list)
    points: list[StaticPoint] = field(default_factory=list)
    series: dict[str, Array] = field(default_factory=dict)

    def add(self, parameter: float, point: StaticPoint) -> None:
        """Take one more point."""
        self.points.append(point)
        self.parameter.append(parameter)

    @property
    def limits(self) -> list[int]:
        """Numbers of the limit points."""
        rise = np.sign(np.diff(self.parameter))
        return [int(i) + 1 for i in np.flatnonzero(rise[1:] * rise[:-1] < 0)]

    @property
    def limit_parameters(self) -> list[float]:
        """Load parameters of the limit points."""
        return [self.parameter[i] for i in self.limits]


@dataclass(frozen=True)
class ArcLength:
    """Follow equilibria until the load parameter, the scene's time, reaches ``t_end`` (s) or ``most`` points are made.

    ``step``: first and largest step, as a share of the model's length and of t_end together.
    """

    t_end: float
    step: float = 0.05
    most: int = 400

    def __post_init__(self) -> None:
        check_fields(self)
        require(self.t_end != 0.0, "ArcLength: t_end is the last load parameter; it must not be zero.")
        require(0.0 < self.step <= 1.0, f"ArcLength: step = {self.step} must be in (0, 1].")
        require(self.most >= 1, f"ArcLength: most = {self.most} must be at least 1.")

    def trace(self, newton: StaticNewton, start: StaticPoint, t: float) -> Path:
        """The path from an equilibrium at t on; collective. Raises ConvergenceError where steps become too short."""
        carried = [p.name for _, p in newton.residual.system.fields if p.field.carried]
        require(
            not carried,
            f'Body "{(carried or [""])[0]}" carries its pressure as an unknown: paths by ArcLength are not offered for it. Take '
            "fmbd.LoadSteps(...), or materials.neo_hookean_mixed, whose pressure is eliminated.",
        )
        span = self.t_end - t
        path = Path([t], [start])
        tangent = newton.solvable(partial(_tangent, newton, start, t, span, None))
        length = self.step

        while len(path.points) < self.most and (path.parameter[-1] - self.t_end) * np.sign(span) < 0:
            point, now = path.points[-1], path.parameter[-1]
            # halve the step until its corrector converges
            while True:
                try:
                    made, then, count, way = newton.solvable(
                        partial(_step, newton, (point, now), tangent, span, length)
                    )
                    after = newton.solvable(partial(_tangent, newton, made, then, span, tangent))
                    if length > SHORT * self.step and _astray(newton, way, (tangent, after), length):
                        raise ConvergenceError("a step along the path met another branch")
                    break
                except (ConvergenceError, LinearSolveError) as error:
                    length *= 0.5
                    if length < 1e-5 * self.step:
                        raise ConvergenceError(f"The path of equilibria ends at t = {now:g} s: {error}") from error

            if tangent[1] * after[1] < 0:
                limit = _limit_point(newton, (point, now), tangent, span, (length, after[1]))
                if limit is not None:
                    path.add(*limit)
            path.add(then, made)
            tangent = after
            # few iterations: the path is nearly straight here
            length = min(self.step, length * (1.5 if count <= 4 else 0.7 if count > 7 else 1.0))

        if (path.parameter[-1] - self.t_end) * np.sign(span) > 0:
            _finish(newton, path, self.t_end)
        return path


def _product(newton: StaticNewton, x: Array, y: Array) -> float:
    """Inner product of increments over the model's length, per velocity component."""
    s = newton.residual.system
    # those of all ranks: a share of their own would give every rank a step of its own
    components = s.n_core + sum(p.field.n_global for _, p in s.fields)
    return s.dot(s.units * x, s.units * y) / s.length**2 / max(int(components), 1)


def _tangent(newton: StaticNewton, point: StaticPoint, t: float, span: float, last: Direction | None) -> Direction:
    """(d, e) of (1) with unit length, e over the span, in the sense of the last one."""
    r = newton.take(point, t)
    by_t = newton.residual.by_time(point.q, point.lam, t, 1e-6 * abs(span))
    w, _ = newton.inverse(point, t, r, (r[0] - by_t[0] * span, r[1] - by_t[1] * span))
    size = float(np.sqrt(_product(newton, w, w) + 1.0))
    d, e = w / size, 1.0 / size
    if last is not None and _product(newton, d, last[0]) + e * last[1] < 0:
        d, e = -d, -e
    return d, e


def _step(
    newton: StaticNewton, start: tuple[StaticPoint, float], tangent: Direction, span: float, length: float
) -> tuple[StaticPoint, float, int, Direction]:
    """One step of (1): point, parameter, number of iterations, and the way to it, its second part over the span."""
    system, (first, t0), (d, e) = newton.residual.system, start, tangent

    # predictor: along the tangent
    xi, lam, s = length * d, first.lam, length * e
    for count in range(12):
        point = StaticPoint(system.compose(first.q, xi), lam)
        t = t0 + span * s
        r = newton.take(point, t)
        newton.iterations += 1

        # u: Newton's increment at this t; w: what one span of t more adds; of both, what keeps the length (1)
        by_t = newton.residual.by_time(point.q, lam, t, 1e-6 * abs(span))
        u, du = newton.inverse(point, t, r, (np.zeros_like(r[0]), np.zeros_like(r[1])))
        w, dw = newton.inverse(point, t, r, (r[0] - by_t[0] * span, r[1] - by_t[1] * span))

        gap = length - _product(newton, d, xi) - e * s
        slope = _product(newton, d, w) + e

        ds = (gap - _product(newton, d, u)) / slope
        xi = xi + system.rate(xi, u + ds * w)
        lam = lam + du + ds * dw
        s = s + ds

        size = system.max_abs(u + ds * w)
        # far from the predictor another branch would be met
        if not size < 0.5 * system.length:
            break
        if size <= 1e-9 * system.length and abs(ds) < 1e-9:
            return StaticPoint(system.compose(first.q, xi), lam), t0 + span * s, count + 1, (xi, s)
    raise ConvergenceError("a step along the path did not converge")


def _limit_point(
    newton: StaticNewton, start: tuple[StaticPoint, float], tangent: Direction, span: float, end: tuple[float, float]
) -> tuple[float, StaticPoint] | None:
    """Where along a step the load parameter turns back, e = 0 of (1), by regula falsi: parameter and point; None where
    tangents close to it are singular to roundoff. ``end``: the length of the step, and e there.
    """
    found, low, high = None, (0.0, tangent[1]), end
    for _ in range(MOST_LOOKS):
        length = (low[0] * high[1] - high[0] * low[1]) / (high[1] - low[1])
        try:
            point, t, *_ = newton.solvable(partial(_step, newton, start, tangent, span, length))
            e = newton.solvable(partial(_tangent, newton, point, t, span, tangent))[1]
        except (ConvergenceError, LinearSolveError):
            break
        found = t, point
        # of the parabola on which t lies nearly
        if e * e * end[0] <= 2.0 * LEVEL * abs(end[1] - tangent[1]):
            break
        # of the end that stays a second time half counts (Illinois)
        low, high = (high, (length, e)) if e * high[1] < 0 else ((low[0], 0.5 * low[1]), (length, e))
    return found


def _astray(newton: StaticNewton, way: Direction, tangents: tuple[Direction, Direction], length: float) -> bool:
    """Whether a step led aside of the tangent it began with, or moves the bodies otherwise than both of its tangents say.

    The branches beside a bifurcation that an imperfection parts run alike, across a gap that is small against a step.
    """

    def size(x: Array) -> float:
        return float(np.sqrt(_product(newton, x, x)))

    (xi, s), ((d, e), (d_after, _)) = way, tangents
    bend = np.hypot(size(xi - length * d), s - length * e)
    aside = size(xi - 0.5 * length * (d + d_after))
    return bool(bend > SHARP * length or aside > length * (0.5 * JUMP * (size(d) + size(d_after)) + NOTHING))


def _finish(newton: StaticNewton, path: Path, t_end: float) -> None:
    """Replace the last point, beyond the end, by the one at t_end."""
    zero = np.zeros(newton.residual.system.n_v), np.zeros(newton.residual.system.n_lam)
    path.points[-1] = newton.solve(path.points[-1], t_end, zero)
    path.parameter[-1] = t_end
