"""Contact-implicit midpoint rule with massless contact nodes: the default for scenes with contact.

    q_1 = q_0 o exp(xi),   v_m = xi / h,   v_1 = 2 v_m - v_0                                                    (1)
    M (v_1 - v_0) / h + h(q_m, v_m) + G_m^T lambda - N_m^T Lambda = 0    at  q_m = q_0 o exp(xi / 2)             (2)
    g(q_1) = 0,     0 <= Lambda _|_ gap(q_1) >= 0                                                              (3)

The forces act in the middle of the step, the gap closes at its end. On a linear elastic body and a plane obstacle the
contact's work in a step is Lambda (gap_1 - gap_0) = -Lambda gap_0 <= 0, nothing while it stays closed: energy never grows.
Without inertia on the contact nodes (:mod:`fmbd_fenicsx.contact_mass`) Lambda does not oscillate. Each Newton step solves the
linearised (2) and (3) as one small complementarity problem on the candidates; the active set of the last step starts it. After
the step the velocity is projected on the joints' velocity constraints, which takes energy, never gives it.

Source: Khenous, Laborde, Renard, doi:10.1016/j.euromechsol.2008.01.001; Deuflhard, Krause, Ertel, doi:10.1002/nme.2119.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..contact_rows import ContactSet, Linear, Rows
from ..errors import ConvergenceError, InputError
from ..linear.complementarity import ContactCounts, solve_friction, solve_normal
from ..linear.delassus import Compliance
from ..linear.schur import StepSolver, Weights
from ..log import log
from ..newton import Newton
from ..rotations import Array
from ..sensors_contact import WORKS, ContactForces, ContactState
from ..system import Evaluation, State, System
from .contact_steps import candidates, components, in_world, refuse_penetration, refuse_tunnelling
from .start import Correction, consistent, worst_block


@dataclass(frozen=True)
class ContactMidpoint:
    """Scheme data: none. Equations (1) to (3)."""

    order = 2
    name = "contact-implicit midpoint"

    def start(self, system: System, state: State, solver: StepSolver, h: float) -> tuple[State, Correction]:
        """Consistent positions and velocities in the metric M + h^2/4 K (M alone is singular on massless nodes)."""
        contacts = system.contacts
        if contacts is None:
            raise InputError("ContactMidpoint is a scheme for scenes with contact; this scene has none. Use another scheme.")
        rigid = [p.name for p in contacts.pairs if getattr(p, "rigid", False)]
        if rigid:
            raise InputError(
                f'Contact "{rigid[0]}" is between rigid bodies: ContactMidpoint has no impact law for inertia on the contact '
                "point, its rebound would depend on dt. Use fmbd.Moreau(), which takes the contact's restitution."
            )
        heavy = [p.name for p in contacts.pairs if not p.massless]
        if heavy:
            log.warning(
                'contact "%s": inertia on contact nodes (redistribute_mass=False) lets the contact force oscillate; '
                "see docs/contact.md",
                heavy[0],
            )
        start, correction = consistent(system, state, solver, metric=Weights(1.0, 0.0, h * h / 4), accelerated=False)
        refuse_penetration(system, contacts, start)
        return start, correction

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> Stepper:
        """A run's worker, from a consistent state."""
        return Stepper(system, solver, newton, state)


class Stepper:
    """Advances a state through contact; keeps forces, active set, works and statistics."""

    def __init__(self, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        assert system.contacts is not None
        self.system, self.solver, self.newton = system, solver, newton
        self.contacts: ContactSet = system.contacts
        self.compliance = Compliance(solver, self.contacts)
        self.counts = ContactCounts()
        self.local_error = 0.0
        self.in_contact = self.newton_in_contact = 0
        rows = self.contacts.rows(system, state.t, state.q)
        d = system.motions.dim
        self.force = np.zeros((len(rows.gap), d if self.contacts.frictional else 1))
        self.impulse = np.zeros((len(self.contacts.pairs), d))
        self.work = np.zeros(len(WORKS))
        self._projects = any(b.kind != "frame" for b in system.blocks)
        self.energy, self.springs = self._energy(state)
        self.state: State = self._state(state, rows, state.t)

    @property
    def counters(self) -> dict[str, float]:
        """Statistics of contact for the run's counters."""
        c = self.counts
        return {
            "contact_steps": self.in_contact,
            "contact_newton_iterations": self.newton_in_contact,
            "active_set_iterations": c.iterations,
            "active_set_changes": c.changes,
            "cycles_broken": c.cycles,
            "complementarity_residual": c.residual,
            "compliance_columns": self.compliance.columns,
        }

    def _energy(self, state: State) -> tuple[float, float]:
        """Total energy, and the share of springs."""
        found = self.system.at(state.t, state.q, state.v).energies()
        return float(sum(found.values())), float(found["springs"])

    # -- one step ---------------------------------------------------------------------------------------------------
    def advance(self, h: float) -> State:
        """One step of size h (s); collective. Raises ConvergenceError when Newton fails; the state is then unchanged."""
        system, s = self.system, self.state
        near = candidates(system, self.contacts, s, h)
        refuse_tunnelling(system, self.contacts, s, h)
        for _ in range(4):
            step = _Step(self, h, near)
            converged, history = self.newton.solve(step.increment)
            if not converged:
                raise ConvergenceError(
                    f"Newton stopped at t = {s.t + h:.6g} s (h = {h:.3g} s): increments over tolerance "
                    + " -> ".join(f"{x:.1e}" for x in history)
                    + (f"; the largest open constraint is {worst_block(system, step.g)}" if step.g.size else "")
                    + ". Try a smaller dt."
                )
            rows = self.contacts.rows(system, s.t + h, step.q)
            missed = (rows.gap < -1e-9 * system.length) & ~near
            if not missed.any():
                break
            near = near | missed
        return self._accept(step, rows, h, len(history))

    def _accept(self, step: _Step, rows: Rows, h: float, iterations: int) -> State:
        """Take the step: velocities, works, impulses, statistics."""
        system, s = self.system, self.state
        v = 2 * step.xi / h - s.v
        if self._projects:
            v = self._project(step, v)
        self.force = np.zeros_like(self.force)
        self.force[step.near] = step.force
        if step.force.any():
            self.in_contact += 1
            self.newton_in_contact += iterations
        a = (v - s.v) / h
        self.local_error = h * h / 12 * system.max_abs(a - s.a)
        new = State(s.t + h, step.q, v, a, step.lam)
        self._count_work(step, new, h)
        self.state = self._state(new, rows, s.t + h / 2, step)
        return self.state

    def _project(self, step: _Step, v: Array) -> Array:
        """Velocity that satisfies the joints at the end of the step."""
        ev = self.system.at(self.state.t + step.h, step.q, v)
        slip = ev.jacobian.times(v) + ev.constraint_rate()
        dv, _ = self.solver.solve(np.zeros(self.system.n_v), -slip)
        return v + dv

    def _count_work(self, step: _Step, new: State, h: float) -> None:
        system, xi = self.system, step.xi
        works = np.zeros(len(WORKS))
        if step.rows is not None:
            works[0] = step.force[:, 0] @ self.contacts.times(system, step.rows.N, xi)
            for k, tangent in enumerate(step.rows.tangents):
                works[1] += step.force[:, 1 + k] @ self.contacts.times(system, tangent, xi)
        energy, springs = self._energy(new)
        if system.forces:
            works[2] = system.dot(step.ev.spread(step.ev.wrenches()), xi) + springs - self.springs
        if system.n_lam:
            works[3] = -float(step.lam @ step.ev.jacobian.times(xi))
        works[4] = energy - self.energy - works[:4].sum()
        self.energy, self.springs = energy, springs
        self.work = self.work + works

    def _state(self, state: State, rows: Rows, time: float, step: _Step | None = None) -> ContactState:
        """The state with its contact forces, world axes."""
        force = in_world(rows, self.force)
        if step is not None and step.rows is not None:
            force[step.near] = in_world(step.rows, step.force)
            for i in range(len(self.impulse)):
                self.impulse[i] += step.h * force[rows.pair == i].sum(0)
        found = ContactForces(
            self.contacts.names, time, rows.pair, rows.x, rows.normal, rows.gap, self.force[:, 0].copy(), force,
            self.force[:, 0] / rows.weight, self.impulse.copy(), self.work.copy(),
        )  # fmt: skip
        return ContactState(state.t, state.q, state.v, state.a, state.lam, found)


class _Step:
    """The Newton iteration of one step."""

    def __init__(self, stepper: Stepper, h: float, near: np.ndarray) -> None:
        self.p, self.h, self.near = stepper, h, near
        system, s = stepper.system, stepper.state
        self.xi = h * s.v
        self.lam = s.lam.copy()
        self.force = stepper.force[near]
        self.rows: Rows | None = None
        self.W: Array | None = None
        self._blocks: Any = None
        self.scale = h * h / 2
        self.q = s.q
        self.g = np.zeros(0)
        self.ev: Evaluation = None  # type: ignore[assignment]
        self.floor = 64 * np.finfo(float).eps * system.length

    def increment(self) -> float:
        """One Newton step: predictor, complementarity problem, correction; returns its size over the tolerance."""
        p, h, s = self.p, self.h, self.p.state
        system, solver = p.system, p.solver
        self.q = system.compose(s.q, self.xi)
        middle = system.compose(s.q, 0.5 * self.xi)
        vm = self.xi / h
        ev = self.ev = system.at(s.t + h / 2, middle, vm)
        if self.W is None:
            solver.prepare(ev, Weights(1.0, h / 2, h * h / 4))
        r = ev.balance(2 * (vm - s.v) / h, self.lam)
        self.g = system.at(s.t + h, self.q).constraint() if system.n_lam else np.zeros(0)
        if self.near.any():
            dxi, dlam = self._with_contact(middle, r)
        else:
            dxi, dlam = solver.solve(-self.scale * r, -self.g)
            self.W = np.zeros((0, 0))
        self.lam = self.lam + dlam / self.scale
        self.xi = self.xi + system.rate(self.xi, dxi)
        self.q = system.compose(s.q, self.xi)
        tolerance = max(1e-4 * p.newton.tolerance * max(system.max_abs(self.xi), h * system.max_abs(s.v)), self.floor)
        return system.max_abs(dxi) / tolerance

    def _with_contact(self, middle: Array, r: Array) -> tuple[Array, Array]:
        p, system, solver = self.p, self.p.system, self.p.solver
        t0, h = p.state.t, self.h
        rows = self.rows = p.contacts.rows(system, t0 + h / 2, middle, since=t0).take(self.near)
        gap = p.contacts.rows(system, t0 + h, self.q).gap[self.near]
        d = self.force.shape[1]
        L = components(rows) if d > 1 else rows.N
        r = r - p.contacts.transposed(system, L, self.force.ravel())
        z, dl = solver.solve(-self.scale * r, -self.g)
        blocks = getattr(solver, "blocks", None)
        if self.W is None or blocks is not self._blocks:  # also after Newton asked for a new tangent
            self.W, self._blocks = self.scale * p.compliance.matrix(L), blocks
        u = p.contacts.times(system, L, z).reshape(-1, d)
        u[:, 0] += gap
        if d > 1:
            u[:, 1:] += p.contacts.times(system, _tangents(L, d), self.xi).reshape(-1, d - 1) - rows.drift
        u = (u.ravel() - self.W @ self.force.ravel()).reshape(-1, d)
        if d > 1:
            force = solve_friction(self.W, u, rows.friction, self.force, p.counts)
        else:
            force = solve_normal(self.W, u[:, 0], self.force[:, 0] > 0, p.counts)[:, None]
        change, self.force = force - self.force, force
        if not change.any():
            return z, dl
        r = r - p.contacts.transposed(system, L, change.ravel())
        return solver.solve(-self.scale * r, -self.g)


def _tangents(L: Linear, d: int) -> Linear:
    """The tangential rows of interleaved components."""
    m = L.core.shape[0]
    return L.take(np.flatnonzero(np.arange(m) % d != 0))


