"""Moreau-Jean time stepping: impacts with restitution as impulses of a step.

    M (v_1 - v_0) / h + h(q_m, v_m) + G^T lambda = N^T P / h,     v_m = (v_0 + v_1) / 2,   q_m = q_0 o exp(h
    v_m / 2)       (1)
    q_1 = q_0 o exp(h v_m),     G v_1 + g_t = 0
    (2)
    closed contacts:  0 <= P _|_ U_1 + e U_0 >= 0,     U = N v + g_t  the gap's rate
    (3)

P is the impulse of all that happens within the step: one impact, many, or steady contact. A contact counts
as closed when
its gap, extrapolated to the middle of the step, is not positive. Infinitely many impacts in finite time
(Zeno) need no event
search: the body comes to rest within a step of the limit. Energy: P (U_0 + U_1) / 2 = -(1 - e) / 2 P |U_0|
<= 0. Penetrations
stay of the order of h U. Joints are kept on velocity level by (2) and projected on position level after the
step.

Source: Moreau (1988), doi:10.1007/978-3-7091-2624-0_1; Jean, doi:10.1016/S0045-7825(98)00383-1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..linear.schur import StepSolver, Weights
from ..mechanics.contact_rows import Rows
from ..rotations import Array
from ..system.system import Evaluation, State, System
from .contact_ledger import StepForces
from .contact_solve import Unilateral, openings
from .contact_stepper import ContactStepper
from .contact_steps import candidates, refuse_penetration
from .newton import Newton, not_converged
from .start import Correction, consistent


@dataclass(frozen=True)
class Moreau:
    """Scheme data: none; restitution and friction belong to the contacts. Equations (1) to (3)."""

    order = 1
    name = "Moreau-Jean"

    def start(self, system: System, state: State, solver: StepSolver, h: float) -> tuple[State, Correction]:
        """Consistent positions and velocities; refuses overlap."""
        if system.contacts is None:
            raise InputError("Moreau is a scheme for scenes with contact; this scene has none. Use another scheme.")
        start, correction = consistent(system, state, solver, metric=Weights(1.0, 0.0, h * h / 4), accelerated=False)
        refuse_penetration(system, system.contacts, start)
        return start, correction

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> Stepper:
        """A run's worker, from a consistent state."""
        return Stepper(system, solver, newton, state)


class Stepper(ContactStepper):
    """Advances a state through impacts."""

    def __init__(self, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        super().__init__(system, solver, newton, state)
        self._joints = any(b.kind != "frame" for b in system.blocks)
        self.impulse = np.zeros_like(self.ledger.force)

    def advance(self, h: float) -> State:
        """One step of size h (s); collective. Raises ConvergenceError when Newton fails; the state is then
        unchanged.
        """
        system, s = self.system, self.state
        near = candidates(system, self.contacts, s, h)
        middle = system.compose(s.q, 0.5 * h * s.v)
        closed = near & (self.contacts.touch(system, s.t + h / 2, middle).gap <= 0.0)
        step = _Step(self, h, middle, closed)
        converged, history = self.newton.solve(step.increment)
        if not converged:
            raise not_converged(s.t + h, h, history)
        xi = 0.5 * h * (s.v + step.v)
        q = self._closed_joints(system.compose(s.q, xi), s.t + h)
        a = (step.v - s.v) / h
        self.local_error = h * h / 12 * system.max_abs(a - s.a) if not closed.any() else 0.0
        self.impulse = np.zeros_like(self.impulse)
        self.impulse[closed] = step.contact.force
        forces = StepForces(closed, step.contact.rows, step.contact.force / h, s.t + h / 2)
        self.state = self.ledger.write(State(s.t + h, q, step.v, a, step.lam), forces, (step.ev, xi, step.lam), h)
        self.ledger.count(len(history))
        return self.state

    def _closed_joints(self, q: Array, t: float) -> Array:
        """Positions projected on the joints."""
        if not self._joints:
            return q
        system = self.system
        for _ in range(3):
            g = system.at(t, q).constraint()
            if np.abs(g).max(initial=0.0) <= 1e-13 * system.length:
                break
            dq, _ = self.solver.solve(np.zeros(system.n_v), -g)
            q = system.compose(q, dq)
        return q


class _Step:
    """The Newton iteration of one step for v_1, lambda and P."""

    def __init__(self, stepper: Stepper, h: float, middle: Array, closed: np.ndarray) -> None:
        self.p, self.h, self.closed = stepper, h, closed
        s = stepper.state
        self.v, self.lam = s.v.copy(), s.lam.copy()
        self.contact = Unilateral(stepper.compliance, stepper.ledger.counts, stepper.impulse[closed])
        self.prepared = False
        self.ev: Evaluation = None  # type: ignore[assignment]
        if closed.any():
            contacts, at = stepper.contacts, (stepper.system, s.t + h / 2, middle)
            self.rows = contacts.rows(*at, since=(s.t, h)).take(closed)
            self.rate = contacts.gap_rate(*at, h)[closed]

    def increment(self) -> float:
        """One Newton step; returns its size over the tolerance."""
        p, h, s = self.p, self.h, self.p.state
        system, solver = p.system, p.solver
        vm = 0.5 * (s.v + self.v)
        middle = system.compose(s.q, 0.5 * h * vm)
        ev = self.ev = system.at(s.t + h / 2, middle, vm)
        if not self.prepared:
            self.prepared = True
            solver.prepare(ev, Weights(1.0, h / 2, h * h / 4))
        r = h * ev.balance((self.v - s.v) / h, self.lam)
        slip = ev.jacobian.times(self.v) + ev.constraint_rate() if system.n_lam else np.zeros(0)
        if self.closed.any():
            rows, rate = self.rows, self.rate
            u = openings(p.contacts, system, rows, p.contacts.times(system, rows.N, self.v) + rate, h * self.v) / _per(
                rows, h
            )
            before = p.contacts.times(system, rows.N, s.v) + rate
            u[:, 0] += rows.restitution * np.minimum(before, 0.0)
            dv, dlam = self.contact.increment(rows, u, (r, slip), 1.0)
        else:
            dv, dlam = solver.solve(-r, -slip)
        self.lam = self.lam + dlam / h
        self.v = self.v + dv
        size = max(system.max_abs(self.v), system.max_abs(s.v), 1e-6 * system.length / h)
        return system.max_abs(dv) / (1e-4 * p.newton.tolerance * size)


def _per(rows: Rows, h: float) -> Array:
    """1 for normal velocities, h for slips over the step: both become velocities."""
    return np.array([1.0, *(h for _ in rows.tangents)])
