"""Steps of the energy-momentum scheme in NumPy: the equations (1) to (5) of :mod:`.energy_momentum`, the small system apart
from fields; where compiled code does not make a step, or its matrix does not serve.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ....errors import ConvergenceError, LinearSolveError
from ....linear.blocks.field_blocks import Weights
from ....linear.condensation import StepSolver
from ....linear.redundancy import scaled_solution
from ....rotations import Array
from ....system.compiled.states.means import IterationEnds, MeanStates, rate_of
from ....system.configurations import count
from ....system.layout import State
from ....system.lengths import farthest
from ....system.speed_rows import speed_rows
from ....system.system import System
from ...marching import MarchingStepper
from ...newton import LEFT_OF_PLACES, Newton
from .discrete_gradient import GradientEnd, Mean

DIFFERENCE = 1e-7
NEAR = 12  # further iterations where the tangent is not exact
NOTHING = float(np.finfo(float).eps)  # of accelerations, or of positions: an increment of this size is none at all
ROUNDOFF = 1e-12  # an increment that moves positions by this share of the model's length is none that further ones could improve
WITH_FIELDS = 40  # iterations at most of scenes with fields: their large steps turn bodies far


@dataclass
class Tangent:
    """What increments of a step are made by: ``J``, or the matrix of the middle where there is none."""

    J: Array | None
    exact: bool  # whether differences have to give J
    age: int = 0  # increments by it
    again: bool = False  # whether the matrix of the middle was taken anew


class StepsInParts(MarchingStepper):
    """A stepper that makes one step at a time of mean accelerations of the core, ports of fields in use, and lambda."""

    def __init__(self, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        self.system, self.solver, self.newton, self.state = system, solver, newton, state
        self.fields: Any = None  # made for steps in parts
        self.ports = np.zeros(0, int)
        self.n = system.n_core
        self.n_q = system.n_q - (system.n_v - system.n_core)
        self._kept: tuple[float, Array] | None = None  # step and tangent, where Newton converges well with an old one
        self._old: tuple[GradientEnd, Array] | None = None  # where the step begins, and g there, in NumPy
        self._means: MeanStates | None = None  # who makes the step in compiled code

    def _use_fields(self) -> None:
        """What steps in parts need of elastic fields; collective."""
        if self.fields is None and self.system.fields:
            from .elastic_momentum import Fields, ports_in_use

            s = self.state
            self.fields = Fields(self.system, ports_in_use(self.system.at(s.t, s.q, s.v)), self.solver.elastic)
            self.ports = self.fields.used

    def _ends(self, h: float, *, parts: bool = False) -> IterationEnds:
        """When the iteration of a step of size h (s) ends; with ``parts`` that of the small system, fields apart."""
        system, both = self.system, np.stack((self.state.a, self.state.v))
        if parts:
            both[:, self.n :] = 0.0
        # increments of 1e-10 of this size move nothing beyond roundoff
        a, v = map(float, system.each_typical(both))
        size = max(a, v / h, 1e-6 * system.length / h**2)
        way, most = size * h**2, farthest(system, self.state.q)
        far = max(system.length, most) / way  # much, of slow motion in small steps
        lost = (ROUNDOFF * system.length + LEFT_OF_PLACES * most) / way
        return IterationEnds(size, NOTHING * max(far, 4.0), lost, self.newton.max_iterations + NEAR)

    def _in_parts(
        self, h: float, guess: tuple[Array, Array], ends: IterationEnds, *, differences: bool
    ) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Mean accelerations and multipliers of a step, and q, v at its end, the small system apart from fields; collective.

        ``differences``: the matrix of the middle did not serve.
        """
        s, n, (a, lam) = self.state, self.n, guess
        self._use_fields()
        if self.fields is not None:
            self.fields.begin(s, h)
            # increments of fields are ways already
            ends = replace(self._ends(h, parts=True), nothing=4.0 * NOTHING, most=WITH_FIELDS)
        y = self._iterated(h, np.concatenate((a[:n], self._port_values(), lam)), ends, differences=differences)

        v_core, q_core, _, _ = self._motion(h, y[:n])
        q, v = s.q.copy(), s.v.copy()
        q[: self.n_q], v[:n] = q_core, v_core
        a = y[:n]
        if self.fields is not None:
            self.fields.end(q, v)
            count(self.system, q)
            a = np.concatenate((a, (v[n:] - s.v[n:]) / h))
        return (a, y[n + len(self.ports) :]), (q, v)

    def _note(self, sizes: list[float]) -> None:
        """What further increments would add to those of these sizes."""
        settled = min(rate_of(sizes), 0.9)
        self.newton.note(settled / (1 - settled) * sizes[-1] / self.newton.tolerance)

    def _iterated(self, h: float, y: Array, ends: IterationEnds, *, differences: bool) -> Array:
        """The unknowns of a step from a guess, in parts; ``differences``: the matrix of the middle did not serve."""
        tangent = self._first_tangent(h, y, differences=differences)
        weights = self.system.units[: self.n] / ends.size
        history: list[float] = []
        worst = 0.0  # rate of convergence

        for _ in range(ends.most):
            r = self._residual(h, y)
            if tangent.J is None and tangent.exact:
                self._take_differences(h, (y, r, self._reach(h, ends.size)), tangent)
            y = self._increment(y, r, tangent.J, weights)
            history.append(self._change)
            self.newton.iterations += 1
            tangent.age += 1

            rate, above_roundoff = rate_of(history), history[-1] > ends.noise
            if above_roundoff:
                worst = max(worst, rate)
            # slow by an old tangent of fields is no roundoff
            old = self.fields is not None and tangent.age > 1 and rate > ends.slow and history[-1] > ends.zero
            if ends.drowned(history) and not old:
                break
            if rate > ends.slow and (tangent.J is not None or above_roundoff):
                self._renew(h, y, tangent)
            elif len(history) == 1 and self._kept is None and self.fields is None:
                tangent.J = None  # the matrix of the middle serves at once
            if ends.over(history) and not old:
                break

        if not ends.found(history[-1]):
            raise self._failure(h, history)
        self._note(history)
        self._kept = (h, tangent.J) if tangent.J is not None and worst < 0.5 * ends.slow else None
        return y

    def _first_tangent(self, h: float, y: Array, *, differences: bool) -> Tangent:
        """That of an earlier step of size h (s) where it served well; by differences, or by the matrix of the middle else."""
        if self._kept is not None and self._kept[0] == h:
            return Tangent(self._kept[1], exact=False, age=1)
        return Tangent(None, exact=differences or not self._prepare(h, y))

    def _take_differences(self, h: float, at: Any, tangent: Tangent) -> None:
        """Take the tangent by differences."""
        tangent.J, tangent.age = self._differences(h, at), 0
        if self.fields is not None:
            self.fields.linearise()

    def _renew(self, h: float, y: Array, tangent: Tangent) -> None:
        """In the place of a tangent that serves no more take the matrix of the middle, or differences where that was taken."""
        tangent.exact = tangent.again or not self._prepare(h, y)
        tangent.J, tangent.again = None, True

    def _failure(self, h: float, history: list[float]) -> ConvergenceError:
        """The error of a step whose iteration failed."""
        sizes = " -> ".join(f"{x:.1e}" for x in history[-8:])
        return ConvergenceError(
            f"Newton's iteration failed at t = {self.state.t + h:.6g} s (h = {h:.3g} s): relative increments {sizes}. Take a "
            "smaller dt."
        )

    # -- one step -----------------------------------------------------------------------------------------------
    def _begun(self) -> tuple[GradientEnd, Array]:
        """Where the step begins, and g there."""
        if self._old is None:
            s = self.state
            port = self.system.ports(s.q, s.t) if self.system.parts else np.zeros(0)
            old = GradientEnd(self.system, s.t, s.q[: self.n_q], port)
            self._old = old, old.constraint()
        return self._old

    def _reach(self, h: float, size: float) -> Array:
        """Sizes of accelerations and ports of which they are moved by a small share for differences: far enough that positions
        change beyond their roundoff.
        """
        system = self.system
        far = max(size, 0.1 * system.length / h**2)

        return np.concatenate((far / system.units[: self.n], np.full(len(self.ports), system.length)))

    def _port_values(self) -> Array:
        return np.zeros(0) if self.fields is None else self.fields.port_values()

    def _increment(self, y: Array, r: tuple[Array, Array, Array], J: Array | None, weights: Array) -> Array:
        """y after one increment; (5). Sets the size of the increment, by the weights (n,) of accelerations."""
        if J is None:
            return self._near_increment(y, r, weights)
        n, p, core, port, g = self.n, len(self.ports), *r
        A, back = J, np.zeros(0)
        # ports of fields follow from the forces on them: rows p + W P = z of (5)
        if self.fields is not None:
            back = self.fields.back(port)
            A = J.copy()
            A[n : n + p] = self.fields.W @ J[n : n + p]
            A[n : n + p, n : n + p] += np.eye(p)

        b = np.concatenate((core, back, g))
        try:
            dy = -scaled_solution(A, b, redundant=self.solver.core.redundant)
        except np.linalg.LinAlgError:
            raise ConvergenceError(
                f"Newton's iteration diverged from t = {self.state.t:.6g} s. Take a smaller dt."
            ) from None

        self._change = float(np.abs(weights * dy[:n]).max(initial=0.0))
        y = y + dy
        if self.fields is not None:
            self._change = max(self._change, 10.0 * self.fields.move(J[n : n + p] @ dy))
            y[n : n + p] = self._port_values()
        return y

    def _prepare(self, h: float, y: Array) -> bool:
        """The matrix of a configuration in the middle of the step, right up to the turn of the bodies over a step; False where
        it cannot be had, as with elastic fields.
        """
        if self.fields is not None:
            return False
        a, lam = y[: self.n], y[len(y) - self.system.n_lam :]
        _, _, w, middle = self._motion(h, a)
        ev = self.system.at(self.state.t + 0.5 * h, middle, w)
        ev.forces = a, lam
        try:
            self.solver.prepare(ev, Weights(1.0, 0.5 * h, 0.25 * h * h))
        except LinearSolveError:
            return False
        return True

    def _near_increment(self, y: Array, r: tuple[Array, Array, Array], weights: Array) -> Array:
        """y after one increment with the matrix of the middle; sets its size as :meth:`_increment` does."""
        core, _, g = r
        try:
            da, dlam = self.solver.solve(-core, -g)
        except LinearSolveError:
            da = np.full_like(core, np.inf)
            dlam = np.zeros_like(g)
        self._change = float(np.abs(weights * da).max(initial=0.0))
        return np.concatenate((y[: self.n] + da, y[self.n :] + dlam))

    def _motion(self, h: float, a: Array) -> tuple[Array, Array, Array, Array]:
        """v_n+1, q_n+1, w and the middle configuration of the core for a = (v_n+1 - v_n) / h."""
        q = self.state.q[: self.n_q]
        v = self.state.v[: self.n]
        w = v + 0.5 * h * a
        turn = self._cayley(h * w)
        return v + h * a, self.system.compose(q, turn), w, self.system.compose(q, 0.5 * turn)

    def _cayley(self, xi: Array) -> Array:
        """Increments whose exponential is the Cayley map of xi: rotation angles 2 atan(|xi| / 2)."""
        m, n = self.system.motions, self.system.n_frames
        out = xi.copy()
        turn = out[: n * m.n_twist].reshape(n, m.n_twist)[:, m.dim :]
        angle = np.sqrt((turn * turn).sum(1, keepdims=True))
        # of small angles by the series: 0 / 0 else
        turn *= np.where(angle > 1e-8, 2 * np.arctan(0.5 * angle) / np.maximum(angle, 1e-300), 1 - angle**2 / 12)
        return out

    def _residual(self, h: float, y: Array) -> tuple[Array, Array, Array]:
        """(1) for y: rows of the core, forces on the ports in use, constraints divided by h^2 / 2."""
        system, s = self.system, self.state
        if self._means is not None and not system.fields:
            found = self._means.residual((s.t, s.q, s.v), h, y[: self.n], y[self.n :])
            if found is not None:
                return found[0], np.zeros(0), 2.0 / h**2 * found[1]
        old, g_old = self._begun()
        n = self.n
        p = len(self.ports)
        a = y[:n]
        lam = y[n + p :]
        port = old.port.copy()
        port[self.ports] = y[n : n + p]

        v, q, w, middle = self._motion(h, a)
        t = self.state.t
        new = GradientEnd(system, t + h, q, port)
        mean = Mean(old, new, (t + 0.5 * h, middle, w), h)
        core, push = mean.small(a, lam)
        if not system.n_lam:
            return core, push[self.ports], np.zeros(0)

        g, way = new.constraint(), mean.moved()
        g[speed_rows(system)] = way[speed_rows(system)]  # these have no g: the mean motion does not slip
        # what (1) leaves of the energy: constraints that are not quadratic do work
        missing = g - g_old - way  # zero for constraints of second order in x and R
        if np.abs(missing).max() <= 1e-13 * system.length:
            return core, push[self.ports], 2.0 / h**2 * g

        # that work is given back by a force along the motion
        left = float(lam @ missing)
        Mw = mean.small(a + w, lam)[0] - core
        moved = (port - old.port)[self.ports] * (system.mass / h**2)
        left /= max(h * float(w @ Mw) + float((port - old.port)[self.ports] @ moved), 1e-300)

        return core + left * Mw, push[self.ports] + left * moved, 2.0 / h**2 * g

    def _differences(self, h: float, at: tuple[Array, tuple[Array, Array, Array], Array]) -> Array:
        """Derivatives of the residual by y, its accelerations and ports moved by shares of their sizes."""
        (y, r, size), n = at, self.n
        first = np.concatenate(r)
        J = np.empty((len(first), len(y)))

        def by(j: int, d: float) -> Array:
            moved = y.copy()
            moved[j] += d
            return np.asarray((np.concatenate(self._residual(h, moved)) - first) / d)

        for j, d in enumerate(DIFFERENCE * size):
            J[:, j] = by(j, float(d))

        # multipliers by the forces that these accelerations take
        forces = (np.abs(J[:n, :n]) @ size[:n]) / self.system.units[:n]
        force = float(forces.max(initial=0.0)) or self.system.mass * self.system.length / h**2
        for j, unit in enumerate(self.system.row_units, len(size)):
            J[:, j] = by(j, DIFFERENCE * force * float(unit))
        return J
