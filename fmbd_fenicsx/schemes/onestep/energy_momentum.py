"""Energy-momentum scheme: difference quotients for bodies, springs and constraints; for stiff motion without losses.

    q_n+1 = q_n o cay(h w),   w = (v_n + v_n+1) / 2,     M (v_n+1 - v_n) / h + f_dg + G_dg^T lambda = 0,   g(q_n+1) = 0     (1)

cay is the Cayley map, so that R_n+1 - R_n = h (R_n + R_n+1) / 2 w~; displacements u of absolute bodies move by h w. All
markers are taken at the mean of their old and new positions and rotations with exact Jacobians (:mod:`.discrete_gradient`); then

    spring      N_dg = mean of N(s) from s_n to s_n+1, along rows whose product with h w is s_n+1 - s_n                     (2)
    constraint  h G_dg w = g_n+1 - g_n: mean rows, plus a correction along M w where g is not of second order               (3)
    body        torques in body axes R_mean^-1 (x x f),   R_mean = (R_n + R_n+1) / 2                                       (4)
    field       forces of :mod:`.elastic_momentum`

do as much work as energies change, and the constraint forces none. Weight and dead loads are linear. Energy is conserved
for any step, also h omega >> 1, and so are linear and angular momentum: all joints are of second order, their correction
in (3) is zero. Dampers and viscous laws take exactly their work at the mean point; other forces act at the mean point. Second
order in q, v and lambda: accelerations and multipliers of a state are solved for at its end, those in (1) are means over the
step. No damping at high frequencies, so the multipliers of stiff systems oscillate.

One iteration solves for the core, the ports p = H^T u of the fields and lambda together. With the tangent J_f of a field, its
residual r_f, z = J_f^-1 r_f and W = H^T J_f^-1 H, and forces P(a, p, lambda) of joints and springs on the ports,

    [ dR_c  ]          [ R_c   ]
    [ 1 p + W dP ]  = -[ H^T z ],          du = -z - J_f^-1 H dP                                                           (5)
    [ dg    ]          [ g     ]

The small tangent is taken by differences.

Sources: Gonzalez, doi:10.1007/s003329900016 (discrete gradient), doi:10.1016/S0045-7825(98)00204-8 (constraints); Simo and Wong,
doi:10.1002/nme.1620310103 (rotations); Betsch, doi:10.1007/s11044-005-0103-8.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ...energies import MixedEnergy, StoredEnergy
from ...errors import ConvergenceError, LinearSolveError
from ...linear.condensation import StepSolver, Weights
from ...linear.redundancy import least, scaled_solution
from ...log import log
from ...mechanics.bodies.bodies import AbsoluteBody
from ...rotations import Array
from ...system.compiled.means import Ends, MeanStates
from ...system.configurations import count
from ...system.scene.contents import Contents
from ...system.serialisation import Memory, plain, worker
from ...system.speed_rows import speed_rows
from ...system.system import State, System
from ..consistent import accelerations, consistent
from ..newton import Newton
from ..stepping import TimeStepper
from .discrete_gradient import GradientEnd, Mean
from .past_means import PastMeans

SLOW = 0.1  # rate of Newton's iteration above which a new tangent is taken
DIFFERENCE = 1e-7
NEAR = 12  # further iterations where the tangent is not exact
ZERO = 1e-13  # an increment of this size is roundoff
NOTHING = float(np.finfo(float).eps)  # of accelerations, or of positions: an increment of this size is none at all
FASTEST = 1e-5  # rate that is counted on at most, where the next increment is told from those made
ENOUGH = 1e-9  # last increment of accelerations, over their size
ROUNDOFF = 1e-12  # an increment that moves positions by this share of the model's length is none that further ones could improve
LARGE = 0.5  # rad that a body turns in a step: the Cayley map lags by 2 %
WITH_FIELDS = 40  # iterations at most of scenes with fields: their large steps turn bodies far


@dataclass(frozen=True)
class EnergyMomentum:
    """Second order; keeps energy, momentum and angular momentum for any step, also where the step does not resolve vibrations:

        q_n+1 = q_n o cay(h w),   w = (v_n + v_n+1) / 2,   M (v_n+1 - v_n) / h + f_dg + G_dg^T lambda = 0,   g(q_n+1) = 0

    with difference quotients f_dg of the energies and G_dg of the constraints, which do as much work as energies change. It damps
    nothing, so that multipliers of stiff systems oscillate. There is nothing to choose. Gonzalez, doi:10.1007/s003329900016.
    """

    order = 2
    name = "energy-momentum"
    free_steps = True  # any size may follow any other

    holds = (0,)

    def refusal(self, held: Contents) -> str:
        """Why it does not take what a scene holds."""
        return next((reason for body in held.nodal if (reason := _refused(body))), "")

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> EnergyMomentumStepper:
        """A run's worker, from a consistent state."""
        return EnergyMomentumStepper(system, solver, newton, state)


def _refused(body: Any) -> str:
    """Why the scheme does not take a body with unknowns of a mesh, "" where it does."""
    if not isinstance(body, AbsoluteBody):
        return (
            f'EnergyMomentum takes elastic fields in absolute coordinates only, and "{body.name}" is not one. Use an '
            "AbsoluteBody, a ReducedBody (energy not kept), or GeneralizedAlpha."
        )
    law = body.elastic_law
    if isinstance(law, MixedEnergy) or (body.energy is not None and not isinstance(law, StoredEnergy)):
        return f'Body "{body.name}": EnergyMomentum needs a StoredEnergy W(C), such as saint_venant_kirchhoff(...).'
    if body.stiffness_damping and body.energy is not None:
        return (
            f'Body "{body.name}": stiffness_damping does not go with EnergyMomentum and an energy: it would change the '
            "angular momentum of strained bodies. Use viscous=fmbd.materials.kelvin_voigt(...)."
        )
    return ""


def _rate(history: list[float]) -> float:
    """Rate of convergence of the last two increments, 0 after the first."""
    return history[-1] / max(history[-2], 1e-300) if len(history) > 1 else 0.0


def _over(history: list[float], nothing: float) -> bool:
    """Whether increments are at roundoff, fall no more close to it, have diverged, or the next one would be ``nothing``."""
    last, rate = history[-1], max(_rate(history), FASTEST)
    stalled = len(history) > 2 and last <= 1e-10 and last > 0.2 * history[-2]
    reached = len(history) > 1 and last <= ENOUGH and rate <= SLOW and rate * last <= nothing
    return last <= ZERO or reached or stalled or not np.isfinite(last)


class EnergyMomentumStepper(TimeStepper):
    """Advances a consistent state. The unknowns of a step: mean accelerations of the core, ports of fields in use, lambda."""

    keeps: ClassVar = {
        "state": Memory.state,
        **dict.fromkeys(("_kept", "counters"), plain()),
        "past": worker,
        "fields": worker,
    }
    counters: dict[str, float] = {}

    def __init__(self, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        self.system, self.solver, self.newton, self.state = system, solver, newton, state
        self.fields: Any = None
        if system.fields:
            from .elastic_momentum import Fields, ports_in_use

            self.fields = Fields(system, ports_in_use(system.at(state.t, state.q, state.v)))
        self.ports = np.zeros(0, int) if self.fields is None else self.fields.used
        self.n = system.n_core
        self.n_q = system.n_q - (system.n_v - system.n_core)
        self.past = PastMeans(state.t, state.a[: self.n], state.lam)
        self.counters = {}
        self._kept: tuple[float, Array] | None = None  # step and tangent, where Newton converges well with an old one
        self._warned = False  # of large turns
        self._old: tuple[GradientEnd, Array] | None = None  # where the step begins, and g there, in NumPy
        self._means: MeanStates | None = None  # who makes the step in compiled code

    def begin_anew(self, start: Callable[[], State]) -> bool:
        """Go on with velocities on the constraints: what drives prescribe may jump, and the rule holds means only."""
        self.state = consistent(self.system, start(), self.solver)[0]
        return True

    def advance(self, h: float) -> State:
        """One step of size h (s); collective. Raises ConvergenceError when Newton's iteration fails."""
        s = self.state
        self._old = None
        driver = self.solver.driver
        self._means = None if driver is None else driver.means(s.t, s.q, s.v)
        if self.fields is not None:
            self.fields.begin(s, h)
        a, lam = self.past.predicted(s.t + 0.5 * h)
        size = self._size(h)
        far = self.system.length / (size * h**2)  # much, of slow motion in small steps
        ends = Ends(
            size,
            # increments of fields are ways already
            NOTHING * (4.0 if self.fields is not None else max(far, 4.0)),
            ROUNDOFF * far,
            self.newton.max_iterations + NEAR if self.fields is None else WITH_FIELDS,
        )
        weights = self.system.units[: self.n] / size

        found = None
        if driver is not None and self._means is not None and (self._kept is None or self._kept[0] != h):
            found = self._means.step((s.t, s.q, s.v), h, (a, lam), ends)
            self.newton.iterations += len(found.sizes)
            self.solver.core.factorisations += driver.new_factors()
        if found is not None and found.end is not None:
            self._note(found.sizes)
            self._kept = None
            return self._take(h, (found.a, found.lam), found.end, weights)

        if found is not None and np.isfinite(found.a).all():
            a, lam = found.a, found.lam
        y = self._iterated(
            h, np.concatenate((a, self._port_values(), lam)), weights, ends, differences=found is not None
        )
        v_core, q_core, _, _ = self._motion(h, y[: self.n])
        q, v = s.q.copy(), s.v.copy()
        q[: self.n_q], v[: self.n] = q_core, v_core
        if self.fields is not None:
            self.fields.end(q, v)
            count(self.system, q)
        return self._take(h, (y[: self.n], y[self.n + len(self.ports) :]), (q, v), weights)

    def _note(self, sizes: list[float]) -> None:
        """What further increments would add to those of these sizes."""
        settled = min(_rate(sizes), 0.9)
        self.newton.note(settled / (1 - settled) * sizes[-1] / self.newton.tolerance)

    def _iterated(self, h: float, y: Array, weights: Array, ends: Ends, *, differences: bool) -> Array:
        """The unknowns of a step from a guess, in parts; ``differences``: the matrix of the middle did not serve."""
        J = self._kept[1] if self._kept is not None and self._kept[0] == h else None
        exact = J is None and (differences or not self._prepare(h, y))  # whether differences have to give the tangent
        history: list[float] = []
        worst = 0.0  # rate of convergence
        age = 0 if J is None else 1  # increments by the tangent of a scene with fields
        again = False  # whether the matrix of the middle was taken anew

        for _ in range(ends.most):
            r = self._residual(h, y)
            if J is None and exact:
                J = self._differences(h, (y, r, self._reach(h, ends.size)))
                age = 0
                if self.fields is not None:
                    self.fields.linearise()
            y = self._near_increment(y, r, weights) if J is None else self._increment(y, r, J, weights)
            history.append(self._change)
            self.newton.iterations += 1
            age += 1

            rate, above_roundoff = _rate(history), history[-1] > 1e-11
            if above_roundoff:
                worst = max(worst, rate)
            # slow by an old tangent of fields is no roundoff
            old_tangent = self.fields is not None and age > 1 and rate > SLOW and history[-1] > ZERO
            if rate > SLOW and history[-1] <= ends.roundoff and not old_tangent:
                break
            # a tangent that does not serve any more is taken anew; a near one that serves at once is kept
            if rate > SLOW and (J is not None or above_roundoff):
                J, exact, again = None, again or not self._prepare(h, y), True
            elif len(history) == 1 and self._kept is None and self.fields is None:
                J = None
            if _over(history, ends.nothing) and not old_tangent:
                break

        if not history[-1] <= max(ENOUGH, ends.roundoff):
            raise self._failure(h, history)
        self._note(history)
        self._kept = (h, J) if J is not None and worst < 0.5 * SLOW else None
        return y

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

    def _size(self, h: float) -> float:
        """What accelerations are judged by, as lengths over s^2: increments of 1e-10 of it move nothing beyond roundoff."""
        s = self.state
        units = self.system.units[: self.n]
        a, v = (float(np.abs(units * x[: self.n]).max(initial=0.0)) for x in (s.a, s.v))
        return max(a, v / h, 1e-6 * self.system.length / h**2)

    def _reach(self, h: float, size: float) -> Array:
        """Sizes of accelerations and ports of which they are moved by a small share for differences: far enough that positions
        change beyond their roundoff.
        """
        system = self.system
        far = max(size, 0.1 * system.length / h**2)

        return np.concatenate((far / system.units[: self.n], np.full(len(self.ports), system.length)))

    def _port_values(self) -> Array:
        return np.zeros(0) if self.fields is None else self.fields.port_values()

    def _increment(self, y: Array, r: tuple[Array, Array, Array], J: Array, weights: Array) -> Array:
        """y after one increment; (5). Sets the size of the increment, by the weights (n,) of accelerations."""
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

    def _take(self, h: float, means: tuple[Array, Array], end: tuple[Array, Array], weights: Array) -> State:
        """The state at the end of the step, its accelerations and multipliers solved for; ``weights``: of accelerations."""
        (a, lam), (q, v), s = means, end, self.state
        self._warn_of_turns(h, s.v[: self.n] + 0.5 * h * a)
        self.state = accelerations(self.system, State(s.t + h, q, v, s.a, lam), self.solver)
        # of multipliers with the same forces the smallest
        if self.solver.core.redundant:
            lam = least(self.solver, self.system.at(s.t + h, q), lam)
        self.past.take((s.t + 0.5 * h, a, lam), weights)
        return self.state

    def _motion(self, h: float, a: Array) -> tuple[Array, Array, Array, Array]:
        """v_n+1, q_n+1, w and the middle configuration of the core for a = (v_n+1 - v_n) / h."""
        q = self.state.q[: self.n_q]
        v = self.state.v[: self.n]
        w = v + 0.5 * h * a
        turn = self._cayley(h * w)
        return v + h * a, self.system.compose(q, turn), w, self.system.compose(q, 0.5 * turn)

    def _warn_of_turns(self, h: float, w: Array) -> None:
        """Say once that a body turns so far in a step that the Cayley map lags: by 2 atan(x / 2) in place of x = h |w|, rad."""
        m, n = self.system.motions, self.system.n_frames
        if self._warned or not n:
            return
        turns = h * np.linalg.norm(w[: n * m.n_twist].reshape(n, m.n_twist)[:, m.dim :], axis=1)
        fastest = int(turns.argmax())
        if (x := float(turns[fastest])) <= LARGE:
            return
        self._warned = True
        log.warning(
            't = %.6g s: "%s" turns by %.2g rad a step, of which energy-momentum leaves out %.1f %%. Take dt = %.2g s or less, '
            "or fmbd.GeneralizedAlpha()",
            self.state.t, self.system.frame_names[fastest], x, 100 * (1 - 2 * np.arctan(0.5 * x) / x), LARGE * h / x,
        )  # fmt: skip

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
        if self._means is not None:
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
