"""Energy-momentum scheme: a discrete gradient for rigid bodies, springs and constraints; for stiff motion without losses.

    q_n+1 = q_n o cay(h w),   w = (v_n + v_n+1) / 2,     M (v_n+1 - v_n) / h + f_dg + G_dg^T lambda = 0,   g(q_n+1) = 0     (1)

cay is the Cayley map, so that R_n+1 - R_n = h (R_n + R_n+1) / 2 w~. All markers are taken at the mean of their old and new
positions, rotations and Jacobians; then a point moves by exactly h times its mean velocity, and

    spring      N_dg = k (s_n + s_n+1) / 2   along   (d_n + d_n+1) / (l_n + l_n+1)                                          (2)
    constraint  h G_dg w = g_n+1 - g_n: mean rows, plus a correction along M w where g is not quadratic                     (3)
    rotation    omega = R_mean^-T w,   torque in body axes R_mean^-1 (x x f),   R_mean = (R_n + R_n+1) / 2                  (4)

do as much work as the spring energies change, and the constraint forces none. Weight is linear. Energy is conserved
for any step, also h omega >> 1, and so are linear and angular momentum: all joints of rigid bodies are quadratic,
their correction in (3) is zero. Dampers and own laws act at the mean point. Second order in q and v; lambda is a mean
over the step and of first order as a value at its end. No damping at high frequencies, so multipliers of stiff
systems oscillate. Absolute elastic bodies: see :mod:`.elastic_momentum`. Small systems: the tangent is taken by
differences.

Sources: Gonzalez, doi:10.1007/s003329900016 (discrete gradient), doi:10.1016/S0045-7825(98)00204-8 (constraints); Simo and Wong,
doi:10.1002/nme.1620310103 (rotations); Betsch, doi:10.1007/s11044-005-0103-8.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..errors import ConvergenceError
from ..linear.schur import StepSolver
from ..mechanics.frames import Kinematics
from ..mechanics.laws import ScalarLoads
from ..mechanics.relative import Separation
from ..rotations import Array
from ..system.memory import Memory
from ..system.system import Evaluation, State, System
from .newton import Newton

SLOW = 0.1  # rate of Newton's iteration above which a new tangent is taken


@dataclass(frozen=True)
class EnergyMomentum:
    """Scheme data; nothing to choose."""

    order = 2
    name = "energy-momentum"

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> Any:
        """A run's worker, from a consistent state."""
        if system.fields:
            from .elastic_momentum import FieldStepper

            return FieldStepper(system, newton, state)
        return Stepper(system, solver, newton, state)


class Mean(Evaluation):
    """The system with all markers at the mean of two configurations; springs by (2)."""

    def __init__(self, old: Evaluation, new: Evaluation, middle: tuple[float, Array, Array]) -> None:
        super().__init__(old.system, *middle)
        self.ends = (old, new)

    @cached_property
    def kin(self) -> Kinematics:
        """Means of the markers at both ends, velocities from the mean Jacobians."""
        kin, (old, new) = Evaluation.kin.func(self), (ev.kin for ev in self.ends)  # type: ignore[attr-defined]
        for name in ("x", "R", "jac_frame", "jac_port"):
            setattr(kin, name, 0.5 * (getattr(old, name) + getattr(new, name)))
        if self.system.motions.dim == 3:
            self._turn(kin)
        kin.twist = (kin.jac_frame @ self.twist[self.system.markers.frame][..., None])[..., 0]
        return kin

    def _turn(self, kin: Kinematics) -> None:
        """Rotational columns (4) of the markers on bodies."""
        m, markers = self.system.motions, self.system.markers
        rotation = 0.5 * (self.ends[0].rotation + self.ends[1].rotation)[markers.frame]
        spatial = np.linalg.inv(rotation).swapaxes(1, 2)
        origin = 0.5 * (self.ends[0].pose + self.ends[1].pose)[markers.frame, :3]
        kin.jac_frame[:, :3, 3:] = m.lever(kin.x - origin) @ spatial
        kin.jac_frame[:, 3:, 3:] = spatial

    def wrenches(self) -> Array:
        """Applied wrenches; linear springs as discrete gradients."""
        out = np.zeros(self.kin.jac_frame.shape[:2])
        for loads in self.system.forces:
            linear = isinstance(loads, ScalarLoads) and not loads.own
            pair = self._springs(loads) if linear else loads.wrenches(self.kin, self.t)  # type: ignore[arg-type]
            for marker, wrench in zip((loads.a, loads.b), pair, strict=True):
                np.add.at(out, marker, wrench)
        return out

    def _springs(self, loads: ScalarLoads) -> tuple[Array, Array]:
        assert self.kin.twist is not None
        s0, s1 = (loads.relative.values(ev.kin) for ev in self.ends)
        ra, rb = loads.relative.rows(self.kin)
        if isinstance(loads.relative, Separation):
            share = (loads.relative.values(self.kin) / (0.5 * (s0 + s1)))[:, None]
            ra, rb = share * ra, share * rb
        rate = (ra * self.kin.twist[loads.a] + rb * self.kin.twist[loads.b]).sum(1)
        N = (loads.k * (0.5 * (s0 + s1) - loads.free) + loads.c * rate)[:, None]
        return -N * ra, -N * rb


class Stepper:
    """Advances a consistent state."""

    local_error = 0.0

    def __init__(self, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        self.system, self.solver, self.newton, self.state = system, solver, newton, state
        self._kept: tuple[float, Array] | None = None  # step and tangent, where Newton converges well with an old one

    def remember(self, m: Memory) -> None:
        """State and the tangent that is kept."""
        self.state, self._kept = m.state("state", self.state), m("tangent", self._kept)

    def advance(self, h: float) -> State:
        """One step of size h (s). Raises ConvergenceError when Newton's iteration fails."""
        s, n = self.state, self.system.n_v
        old = self.system.at(s.t, s.q, s.v)
        g_old = old.constraint()
        z = np.concatenate((s.a, s.lam))
        size = np.concatenate(
            (
                np.full(n, max(self.system.max_abs(s.a), self.system.max_abs(s.v) / h, 1e-8)),
                np.abs(s.lam) + 1.0,
            )
        )
        history: list[float] = []
        J = self._kept[1] if self._kept is not None and self._kept[0] == h else None
        worst = 0.0
        for _ in range(self.newton.max_iterations):
            r = self._residual(h, z, old, g_old)
            if J is None:
                J = self._tangent(h, z, (r, size), old, g_old)
            dz = -np.linalg.lstsq(J, r, rcond=1e-14)[0] if self.solver.core.redundant else -_solve(J, r)
            z = z + dz
            self.newton.iterations += 1
            history.append(float(np.abs(dz[:n]).max(initial=0.0) / size[0]))
            rate = history[-1] / max(history[-2], 1e-300) if len(history) > 1 else 0.0
            if history[-1] > 1e-11:
                worst = max(worst, rate)
            if rate > SLOW or (len(history) == 1 and self._kept is None):
                J = None
            if history[-1] <= 1e-13 or (len(history) > 2 and history[-1] <= 1e-10 and history[-1] > 0.2 * history[-2]):
                break
            if not np.isfinite(history[-1]):
                break
        if not history[-1] <= 1e-9:
            raise ConvergenceError(
                f"Newton's iteration failed at t = {s.t + h:.6g} s (h = {h:.3g} s): relative increments "
                + " -> ".join(f"{x:.1e}" for x in history)
                + ". Take a smaller dt."
            )
        self._kept = (h, J) if J is not None and worst < 0.5 * SLOW else None
        v, q, _, _ = self._motion(h, z[:n])
        self.state = State(s.t + h, q, v, z[:n], z[n:])
        return self.state

    def _motion(self, h: float, a: Array) -> tuple[Array, Array, Array, Array]:
        """v_n+1, q_n+1, w and the middle configuration for a = (v_n+1 - v_n) / h."""
        s = self.state
        w = s.v + 0.5 * h * a
        turn = self._cayley(h * w)
        return s.v + h * a, self.system.compose(s.q, turn), w, self.system.compose(s.q, 0.5 * turn)

    def _cayley(self, xi: Array) -> Array:
        """Increments whose exponential is the Cayley map of xi: rotation angles 2 atan(|xi| / 2)."""
        m, n = self.system.motions, self.system.n_frames
        out = xi.copy()
        turn = out[: n * m.n_twist].reshape(n, m.n_twist)[:, m.dim :]
        angle = np.sqrt((turn * turn).sum(1, keepdims=True))
        turn *= np.where(angle > 1e-8, 2 * np.arctan(0.5 * angle) / np.maximum(angle, 1e-300), 1 - angle**2 / 12)
        return out

    def _residual(self, h: float, z: Array, old: Evaluation, g_old: Array) -> Array:
        """(1) for z = (a, lambda); the constraints divided by h^2 / 2."""
        system, n = self.system, self.system.n_v
        a, lam = z[:n], z[n:]
        v, q, w, middle = self._motion(h, a)
        t = self.state.t
        new = system.at(t + h, q, v)
        mean = Mean(old, new, (t + 0.5 * h, middle, w))
        r = mean.balance(a)
        if not system.n_lam:
            return r
        g = new.constraint()
        G, core = mean.jacobian, mean.jacobian.transposed(lam)
        left = float(lam @ (g - g_old - h * (G.times(w) + mean.constraint_rate())))
        Mw = mean.balance(a + w) - r
        return np.concatenate((r + core + Mw * (left / max(h * float(w @ Mw), 1e-300)), 2.0 / h**2 * g))

    def _tangent(self, h: float, z: Array, at: tuple[Array, Array], old: Evaluation, g_old: Array) -> Array:
        r, size = at
        J = np.empty((len(r), len(z)))
        for j, d in enumerate(1e-7 * size):
            moved = z.copy()
            moved[j] += d
            J[:, j] = (self._residual(h, moved, old, g_old) - r) / d
        return J


def _solve(J: Array, r: Array) -> Array:
    """J^-1 r with rows and columns scaled."""
    rows = 1.0 / np.maximum(np.abs(J).max(axis=1), 1e-300)
    columns = 1.0 / np.maximum((rows[:, None] * np.abs(J)).max(axis=0), 1e-300)
    return columns * np.linalg.solve(rows[:, None] * J * columns, rows * r)
