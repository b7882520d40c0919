"""IDA of SUNDIALS (scikit-sundae) on four mechanisms in their fewest coordinates: equations of its own, as lean as they can be.

    M(q) q'' = f(q, q', t) - G^T lambda,     g(q, t) = 0                                                               (1)

in the two forms that general solvers take well, y = (q, v, ...):

    index 1:      q' = v,  M v' + G^T lambda = f,  G v' + gamma = 0,                        lambda algebraic
    stabilised:   q' = v - G^T mu',  M v' + G^T lambda' = f,  G v + g_t = 0,  g = 0         (Gear, Gupta, Leimkuhler)

Functions are vectorised: the Jacobian dF/dy + c dF/dy' is one call for all of its columns. What is spent in these functions is
told apart from what IDA spends itself.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import andrews_model as andrews
import car_axis as car
import crank_model as crank
import numpy as np
from observatory_oscillators import ARM, CRANK_TURN, SPEED, J, M, R

from fmbd_fenicsx.mechanics.bodies.port_constraint import PortConstraint

Array = Any
FORMS = ("index 1", "stabilised")
UNTESTED = 1e6  # the size of what the error test should not see


class NotThereError(Exception):
    """scikit-sundae is not installed."""


@dataclass(frozen=True)
class Equations:
    """(1), functions of arrays with one more, last axis, and a start: q and v as they are given.

    ``rows``: (q, t) -> g, G, g_t. ``gamma``: (q, v, t) -> g'' - G q''. ``sizes``: of q.
    """

    mass: Callable[[Array], Array]
    force: Callable[[Array, Array, Array], Array]
    rows: Callable[[Array, Array], tuple[Array, Array, Array]]
    gamma: Callable[[Array, Array, Array], Array]
    start: tuple[Array, Array]
    t_end: float
    sizes: Array
    rates: Array


# -- the four ---------------------------------------------------------------------------------------------------------------
def rigid_crank() -> Equations:
    """Angles of crank and rod, place of the block."""

    def mass(q: Array) -> Array:
        out = np.zeros((3, 3, q.shape[-1]))
        out[0, 0] = J[0] + M[0] * R**2 / 4 + M[1] * R**2
        out[0, 1] = out[1, 0] = 0.5 * M[1] * R * ARM * np.cos(q[0] - q[1])
        out[1, 1], out[2, 2] = J[1] + M[1] * ARM**2 / 4, M[2]
        return out

    def force(q: Array, v: Array, t: Array) -> Array:
        pull = 0.5 * M[1] * R * ARM * np.sin(q[0] - q[1])
        return np.array([-pull * v[1] ** 2, pull * v[0] ** 2, 0.0 * pull])

    def rows(q: Array, t: Array) -> tuple[Array, Array, Array]:
        (s1, s2), (c1, c2), zero = np.sin(q[:2]), np.cos(q[:2]), np.zeros(q.shape[-1])
        g = np.array([R * s1 + ARM * s2, q[2] - R * c1 - ARM * c2])
        return g, np.array([[R * c1, ARM * c2, zero], [R * s1, ARM * s2, zero + 1.0]]), np.array([zero, zero])

    def gamma(q: Array, v: Array, t: Array) -> Array:
        (s1, s2), (c1, c2), (w1, w2) = np.sin(q[:2]), np.cos(q[:2]), v[:2] ** 2
        return np.array([-R * s1 * w1 - ARM * s2 * w2, R * c1 * w1 + ARM * c2 * w2])

    start = np.array([0.0, 0.0, R + ARM]), np.array([SPEED, -R / ARM * SPEED, 0.0])
    return Equations(mass, force, rows, gamma, start, CRANK_TURN, np.ones(3), np.full(3, SPEED))


def andrews_rows(q: Array, t: Array) -> tuple[Array, Array, Array]:
    """g, G and g_t of Andrews' mechanism."""
    a, (be, th, ga, ph, de, om, ep) = andrews, q
    G = np.zeros((6, 7, q.shape[-1]))
    G[0::2, 0] = -a.RR * np.sin(be) + a.D * np.sin(be + th)
    G[1::2, 0] = a.RR * np.cos(be) - a.D * np.cos(be + th)
    G[0::2, 1], G[1::2, 1] = a.D * np.sin(be + th), -a.D * np.cos(be + th)
    G[0, 2], G[1, 2] = -a.SS * np.cos(ga), -a.SS * np.sin(ga)
    G[2, 3], G[3, 3] = -a.E * np.cos(ph + de), -a.E * np.sin(ph + de)
    G[2, 4], G[3, 4] = G[2, 3] + a.ZT * np.sin(de), G[3, 3] - a.ZT * np.cos(de)
    G[4, 5], G[5, 5] = a.ZF * np.sin(om + ep), -a.ZF * np.cos(om + ep)
    G[4, 6], G[5, 6] = G[4, 5] - a.U * np.cos(ep), G[5, 5] - a.U * np.sin(ep)
    return andrews.constraint(q, t), G, np.zeros((6, q.shape[-1]))


def andrews_force(q: Array, v: Array, t: Array) -> Array:
    """f, a row for each coordinate."""
    return np.stack([x + 0.0 * q[0] for x in andrews.force(q, v, t)]) if q.shape[-1] > 1 else andrews.force(q, v, t)


def _second_rate(constraint: Any) -> Any:
    """gamma of a vectorised constraint."""
    return lambda q, v, t: PortConstraint("", 0, constraint, vectorized=True).many("gamma", t, q.T, v.T).T


def four() -> dict[str, Callable[[], Equations]]:
    """By the names of the problems of the observatory."""

    def andrews_equations() -> Equations:
        start = np.array(andrews.START), np.zeros(7)
        gamma = _second_rate(andrews.constraint)
        sizes, rates = np.ones(7), np.full(7, 500.0)
        return Equations(andrews.mass, andrews_force, andrews_rows, gamma, start, 0.03, sizes, rates)

    def axle() -> Equations:
        def rows(q: Array, t: Array) -> tuple[Array, Array, Array]:
            (xl, yl, xr, yr), (xb, yb), zero = q, car.road(t), np.zeros(q.shape[-1])
            y_rate = car.R * car.OMEGA * np.cos(car.OMEGA * t)
            x, y = 2 * (xl - xr), 2 * (yl - yr)
            G = np.array([[xb + zero, yb + zero, zero, zero], [x, y, -x, -y]])
            return car.constraint(q, t), G, np.array([yl * y_rate - xl * yb / xb * y_rate, zero])

        start = np.array([0.0, 0.5, 1.0, 0.5]), np.array([-0.5, 0.0, -0.5, 0.0])
        mass = car.K * np.eye(4)[:, :, None]
        return Equations(
            lambda q: mass, car.force, rows, _second_rate(car.constraint), start, 3.0, np.ones(4), np.full(4, 10.0)
        )

    def elastic() -> Equations:
        rod = crank.Rod()

        def rows(q: Array, t: Array) -> tuple[Array, Array, Array]:
            return crank.constraints(q, t, TURNS), crank.jacobian(q, t), crank.rate(q, t, TURNS)

        gamma = lambda q, v, t: crank.gamma(q, v, t, TURNS)
        mass, force = lambda q: crank.mass_matrix(rod, q), lambda q, v, t: crank.forces(rod, q, v)
        sizes, rates = np.array([0.45] * 3 + [4.5e-4] * 4), np.array([150.0] * 3 + [0.5] * 4)
        return Equations(mass, force, rows, gamma, (crank.SMOOTH[:7], crank.SMOOTH[7:]), 0.1, sizes, rates)

    names = ("slider crank", "Andrews' mechanism", "car axis", "flexible slider crank")
    return dict(zip(names, (rigid_crank, andrews_equations, axle, elastic), strict=True))


TURNS = crank.steady


# -- IDA --------------------------------------------------------------------------------------------------------------------
class Residual:
    """Residual and Jacobian of a form for IDA; counts calls and the CPU time in them, and stops after ``longest`` s of all."""

    def __init__(self, equations: Equations, form: str, longest: float) -> None:
        self.e, self.form = equations, form
        self.n = len(equations.start[0])
        self.calls, self.spent, self.until = 0, 0.0, time.process_time() + longest

    def __call__(self, t: float, y: Array, rate: Array, out: Array) -> None:
        """F(t, y, y')."""
        begun = time.process_time()
        self.calls += 1
        out[:] = self.many(t, y[:, None], rate[:, None])[:, 0] if begun < self.until else np.nan
        self.spent += time.process_time() - begun

    def jacobian(self, t: float, y: Array, rate: Array, residual: Array, c: float, out: Array) -> None:
        """dF/dy + c dF/dy' by differences, all columns in one call."""
        begun = time.process_time()
        self.calls += 1
        steps = 1.5e-8 * np.maximum(np.maximum(np.abs(y), np.abs(rate) / max(c, 1e-300)), self.floor)
        moved = self.many(t, y[:, None] + np.diag(steps), rate[:, None] + c * np.diag(steps))
        out[:, :] = (moved - self.many(t, y[:, None], rate[:, None])) / steps
        self.spent += time.process_time() - begun

    def many(self, t: float, y: Array, rate: Array) -> Array:
        """The residuals of several y and y', one column each."""
        e, n = self.e, self.n
        now = np.full(y.shape[-1], t)
        q, v, dq, dv = y[:n], y[n : 2 * n], rate[:n], rate[n : 2 * n]
        g, G, g_t = e.rows(q, now)
        m = len(g)
        below = y[2 * n :] if self.form == "index 1" else rate[2 * n :]
        balance = (e.mass(q) * dv).sum(1) - e.force(q, v, now) + (G * below[:m, None]).sum(0)
        if self.form == "index 1":
            return np.concatenate((dq - v, balance, (G * dv).sum(1) + e.gamma(q, v, now)))
        kinematics = dq - v + (G * below[m:, None]).sum(0)
        return np.concatenate((kinematics, balance, (G * v).sum(1) + g_t, g))

    def begin(self) -> tuple[Array, Array]:
        """Consistent y and y'; a start on the constraints to roundoff, by steps in the plain metric."""
        e, n, now = self.e, self.n, np.zeros(1)
        q, v = (x.astype(float) for x in e.start)
        for _ in range(4):
            g, G, _ = (x[..., 0] for x in e.rows(q[:, None], now))
            q = q - np.linalg.lstsq(G, g, rcond=None)[0]
        g, G, g_t = (x[..., 0] for x in e.rows(q[:, None], now))
        v = v - np.linalg.lstsq(G, G @ v + g_t, rcond=None)[0]
        m, mass, zero = len(g), e.mass(q[:, None])[..., 0], np.zeros(len(g))
        saddle = np.block([[mass, G.T], [G, np.zeros((m, m))]])
        pushes = np.concatenate(
            (e.force(q[:, None], v[:, None], now)[:, 0], -e.gamma(q[:, None], v[:, None], now)[:, 0])
        )
        a, lam = np.split(np.linalg.solve(saddle, pushes), [n])

        largest = max(float(np.abs(lam).max()), 1.0)
        ends = (np.full(m, largest),) if self.form == "index 1" else (np.full(2 * m, UNTESTED),)
        self.floor = np.concatenate((e.sizes, e.rates, *ends))
        if self.form == "index 1":
            return np.concatenate((q, v, lam)), np.concatenate((v, a, zero))
        return np.concatenate((q, v, zero, zero)), np.concatenate((v, a, lam, zero))


def ida(name: str, form: str, rtol: float, longest: float) -> tuple[Array, float, Residual]:
    """q at the end, the CPU seconds, and what counted; raises RuntimeError where IDA does not come to the end."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from sksundae.ida import IDA
    except ImportError:
        raise NotThereError from None
    equations = four()[name]()
    begun = time.process_time()
    residual = Residual(equations, form, longest)
    y, rate = residual.begin()
    options: dict[str, Any] = {
        "rtol": rtol,
        "atol": rtol * residual.floor,
        "max_num_steps": 10**6,
        "jacfn": residual.jacobian,
    }
    if form == "index 1":
        options["algebraic_idx"] = list(range(2 * residual.n, len(y)))
    found = IDA(residual, **options).solve(np.array([0.0, equations.t_end]), y, rate)
    if not found.success:
        raise RuntimeError(str(found.message))
    return np.asarray(found.y[-1])[: residual.n], time.process_time() - begun, residual
