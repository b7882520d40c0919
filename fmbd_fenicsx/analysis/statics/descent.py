"""Descent to a stable equilibrium from far away, for scenes of few replicated coordinates.

With z increments of the configuration as lengths, V an orthonormal basis of those that the constraints leave, and the
multipliers that leave least of the balance f,

    g = V^T (f + G^T lambda),     H = V^T d(f + G^T lambda)/dz V = Q diag(h) Q^T,     d = -V Q |h|^-1 Q^T g          (1)

is Newton's increment where H is definite, and goes down where it is not, away from saddles. H holds the stress of reactions, and
masses do not enter: a string whose masses differ by 1e9, of which a gradient in the metric of inertia sees the light ones only,
takes the iterations of one with equal masses. An increment is taken when it does no work against the forces, by the trapezoidal
rule, and is at most as long as the last ones that did not, and as a share of the model or of the way so far: soft springs give
way by many of its lengths.

Source: Dauphin et al., Identifying and attacking the saddle point problem, doi:10.48550/arXiv.1406.2572, on |h|.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...errors import ConvergenceError
from ...matrices import RANK, left_free
from ...rotations import Array
from ...system.compiled.choice import use_driver
from ...system.evaluation import Evaluation
from ...system.layout import State
from ...system.speed_rows import speed_rows
from ...system.system import System
from ..small_motions.perturbation import Perturbation
from ..small_motions.steady import BodySpin, Spin, steady_rates
from .static_newton import StaticNewton, StaticPoint

MOST = 300  # coordinates up to which matrices are dense
TRIES, CLOSING = 200, 12  # increments, and iterations that close the constraints after each
PATIENCE = 40  # increments behind the least forces: by then they go to and fro over kinks
FIRST, SHORTEST = 0.2, 1e-6  # length of increments, over that of the model and of the way from the start
CLOSED = 1e-12  # over that length, by which constraints may stay open
FLAT = 1e-13  # stiffness of a motion, over the largest, that is roundoff


def descends(newton: StaticNewton) -> bool:
    """Whether (1) is for this scene: no fields, no contact, nothing that rolls."""
    system, spin = newton.residual.system, newton.residual.spin
    plain = not system.fields and system.contacts is None and not speed_rows(system).size
    return plain and system.n_core <= MOST and not isinstance(spin, BodySpin)


def descend(newton: StaticNewton, start: StaticPoint, t: float) -> StaticPoint:
    """A stable equilibrium at time t, downhill from a start.

    Raises ConvergenceError where there is none within reach.
    """
    system, spin = newton.residual.system, newton.residual.spin
    assert not isinstance(spin, BodySpin)
    place = _Place(system, t, _closed(system, t, start.q, np.ones(system.n_v), system.length), spin, start.q)
    radius, last = FIRST * system.length, np.inf
    least, behind = np.inf, 0
    use_driver(system)

    for _ in range(TRIES):
        newton.iterations += 1
        d, whole = place.increment(radius)
        size, length = system.max_abs(d), place.length
        if whole and (size <= newton.tolerance * length or (size > 0.5 * last and size <= 1e-9 * length)):
            return StaticPoint(place.q, place.lam)

        behind = 0 if place.force < least else behind + 1
        least = min(least, place.force)
        share, there = _below(place, d)
        if there is None or behind > PATIENCE:
            break
        # after a shorter one the next is no longer than that
        radius = min(2.0 * radius if share == 1.0 else share * size, FIRST * place.length)
        place, last = there, share * size
    raise ConvergenceError(f"increments of {last:.1e} m, the last of a descent")


def _below(place: _Place, d: Array) -> tuple[float, _Place | None]:
    """The share of an increment that leads down and after which the constraints can be closed, and where it leads."""
    system, share = place.system, 1.0
    while share * system.max_abs(d) > SHORTEST * place.length or share == 1.0:
        try:
            q = system.compose(place.q, share * d)
            there = replace(place, q=_closed(system, place.t, q, place.yielding, place.length))
            small = share * system.max_abs(d) <= SHORTEST * place.length
            if small or place.work(d) + there.work(d) <= 0.0:
                return share, there
        except ConvergenceError:
            pass
        share *= 0.25
    return share, None


@dataclass(frozen=True, eq=False)
class _Place:
    """A configuration on the constraints, and (1) there; ``start``: of the descent."""

    system: System
    t: float
    q: Array
    spin: Spin | None
    start: Array

    @cached_property
    def length(self) -> float:
        """The model's length (m), or the way from the start where a soft spring lets it become longer."""
        return max(self.system.length, self.system.max_abs(self.system.difference(self.start, self.q)))

    @cached_property
    def lam(self) -> Array:
        """The multipliers that leave least."""
        system, ev = self.system, self._here
        units = system.multiplier_units
        if not system.n_lam:
            return np.zeros(0)
        G = _rows(ev) * units[:, None]
        forces = ev.balance(self._rates[1]) / system.units
        return np.asarray(units * np.linalg.lstsq(G.T, -forces, rcond=RANK)[0])

    @property
    def force(self) -> float:
        """The largest that is left, N."""
        return float(np.abs(self._balance / self.system.units).max(initial=0.0))

    def work(self, d: Array) -> float:
        """Minus the power of all forces along an increment."""
        return float(d @ self._balance)

    def increment(self, radius: float) -> tuple[Array, bool]:
        """d of (1), like v, no displacement above ``radius`` (m), and whether that cuts nothing off."""
        system, V = self.system, self._free
        if not len(V):
            return np.zeros(system.n_v), True
        H = V @ self._stiffness @ V.T
        h, Q = np.linalg.eigh(0.5 * (H + H.T))
        g = Q.T @ (V @ (self._balance / system.units))

        flat = FLAT * float(np.abs(h).max())
        along = -np.clip(g / np.maximum(np.abs(h), max(flat, 1e-300)), -radius, radius)
        # on a saddle no force leads away from it
        along[(h < -1e-9 * np.abs(h).max()) & (np.abs(along) < SHORTEST * radius)] = radius
        d: Array = (Q @ along) @ V / system.units
        share = min(1.0, radius / max(system.max_abs(d), 1e-300))
        return share * d, share == 1.0 and bool(np.abs(along).max() < radius)

    @cached_property
    def yielding(self) -> Array:
        """How easily coordinates move, the root of 1 over their stiffness, like v."""
        stiff = np.abs(np.diag(self._stiffness))
        return np.asarray(1.0 / np.sqrt(np.maximum(stiff, FLAT * stiff.max(initial=0.0) or 1.0)))

    @cached_property
    def _stiffness(self) -> Array:
        """By increments as lengths, (n_v, n_v)."""
        about = Perturbation(self.system, State(self.t, self.q, *self._rates, self.lam), self.spin)
        units = self.system.units
        if self.spin is None:  # at rest: all places at once
            return about.stiffness_matrix(np.diag(1.0 / units)) / units[:, None]
        return np.array([about.stiffness(e) / units for e in np.diag(1.0 / units)]).T

    @cached_property
    def _rates(self) -> tuple[Array, Array]:
        return steady_rates(self.system, self.q, self.spin)

    @cached_property
    def _here(self) -> Evaluation:
        return self.system.at(self.t, self.q, self._rates[0])

    @cached_property
    def _balance(self) -> Array:
        balance: Array = self._here.balance(self._rates[1], self.lam)
        return balance

    @cached_property
    def _free(self) -> Array:
        """V, (k, n_v)."""
        system = self.system
        return left_free(_rows(self._here)) if system.n_lam else np.eye(system.n_v)


def _rows(ev: Evaluation) -> Array:
    """G by increments as lengths, (n_lam, n_v)."""
    core = ev.jacobian.core
    return np.asarray((core if isinstance(core, np.ndarray) else core.toarray()) / ev.system.units)


def _of_unit_size(G: Array) -> tuple[Array, Array]:
    """Rows divided by their sizes, and these (m, 1)."""
    sizes = np.linalg.norm(G, axis=1, keepdims=True)
    sizes[sizes == 0.0] = 1.0
    return G / sizes, sizes


def _closed(system: System, t: float, q: Array, yielding: Array, length: float) -> Array:
    """The configuration with its constraints closed where that costs least: heavy things would take more than light ones."""
    at_rest = np.zeros(system.n_v)
    for _ in range(CLOSING):
        ev = system.at(t, q, at_rest)
        gap = ev.constraint()
        if float(np.abs(system.row_units * gap).max(initial=0.0)) <= CLOSED * length:
            return q
        G, sizes = _of_unit_size(_rows(ev) * yielding)
        dq = yielding * np.linalg.lstsq(G, -gap / sizes[:, 0], rcond=RANK)[0] / system.units
        if not system.max_abs(dq) <= length:
            break
        q = system.compose(q, dq)
    raise ConvergenceError("constraints do not close")
