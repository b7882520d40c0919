"""Generalized-alpha with contact: gaps at position level, persistency at velocity level.

    M a + h + G^T lambda - N^T Lambda = 0,   g = 0,   0 <= Lambda _|_ gap >= 0     at t_n+1                 (1)
    v_n+1 <- v_n+1 + A^-1 L^T P,   0 <= P _|_ N v_n+1 >= 0   for the contacts that are closed               (2)
    v_n+1 <- v_n+1 - s dv,   A <- A - s dv / (gamma h)       where contacts have closed                     (3)

(1) is the step of :mod:`..onestep.alpha.generalized_alpha` with unilateral rows beside the joints; (2) removes the approach
velocity of closed contacts (lambda g' = 0, persistency), in the metric A of the step where it is predicted, with the friction
that goes with P: L has the rows of normals and tangents. Contact nodes carry no inertia, so Lambda is bounded and the recursion
of accelerations stays smooth; rigid impacts belong to :mod:`.moreau`. Energy is damped at high frequencies and at impacts; see
:mod:`.contact_midpoint` for the rule that conserves it.

A body that is stiff for the step stops in no time, and a gap that is closed at the end of a step says nothing of the velocity
there. The forces of (1) turn a velocity v, a share x of the step before the impact, into

    ((1 - x) (1 - alpha_m) / ((1 - alpha_f) beta) - 1) v

most of it in later steps by way of A; that is 2.9 v at rho_inf = 0.8. So (3) takes back a share of what the contacts of the step
add to the velocity, dv, and of their accelerations: s in [0, 1] leaves the least energy of motion, seen from the obstacles. A
stiff body is at rest then, and leaves with ((1 - alpha_m) / ((1 - alpha_f) gamma) - 1) v, less than v. Where steps resolve what
contacts do s = 0.

Source: Bruels, Acary and Cardona, doi:10.1016/j.cma.2014.07.025.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ...errors import ConvergenceError, LinearSolveError
from ...linear.blocks.field_blocks import Weights
from ...linear.blocks.incompressibility import move_pressures, volume_gaps, volume_push
from ...linear.condensation import StepSolver
from ...linear.redundancy import least
from ...mechanics.contact.obstacles import way_over
from ...mechanics.contact.rows import LinearRows, Rows
from ...rotations import Array
from ...system.compiled import march as slots
from ...system.layout import State
from ...system.scene.contents import Contents
from ...system.serialisation import Memory, plain
from ...system.speed_rows import gaps
from ...system.system import System
from ..consistent import Correction
from ..newton import Newton
from ..onestep.alpha.alpha_step import FAR, PATIENCE
from ..onestep.alpha.generalized_alpha import GeneralizedAlpha
from .contact_detection import candidates
from .contact_ledger import StepForces
from .contact_midpoint import elastic_refusal, elastic_start, roundoff
from .contact_newton import openings, small_problem
from .elastic_contact_stepper import ElasticContactStepper
from .elastic_step import ElasticStep

if TYPE_CHECKING:
    from ...system.evaluation import Evaluation
    from .compiled.elastic_contact import ContactMarch

FINER = 1e-2  # of Newton's tolerance, where increments count by accelerations


@dataclass(frozen=True)
class ContactAlpha(GeneralizedAlpha):
    """Generalized-alpha with contact: gaps at position level, closed contacts at velocity level (persistency),

        M a + h + G^T lambda - N^T Lambda = 0,   g = 0,   0 <= Lambda _|_ gap >= 0     at t_n+1.

    High frequencies and impacts are damped; contact forces of elastic bodies do not oscillate. Rigid impacts with a coefficient
    of restitution belong to :class:`Moreau`.

    Args:
        rho_inf: share of an amplitude of infinite frequency that is left after a step, in [0, 1).
        compiled, form, rtol, atol: as of :class:`GeneralizedAlpha`.

    Bruels, Acary and Cardona, doi:10.1016/j.cma.2014.07.025.
    """

    @property
    def name(self) -> str:
        """Name in reports."""
        return f"contact generalized-alpha(rho_inf={self.rho_inf:g})"

    def refusal(self, held: Contents) -> str:
        """Why it does not take what a scene holds."""
        return elastic_refusal(self.name, held)

    def start(self, system: System, state: State, solver: StepSolver, h: float) -> tuple[State, Correction]:
        """As for the midpoint rule, with accelerations.

        M is singular on massless nodes; (M + h^2 K / 4) a = -h - G^T lambda gives them the acceleration of their neighbours,
        and differs from a by what the step leaves out as well. A start with a = 0 would delay all forces by half a step.
        """
        start, correction = elastic_start(system, state, solver, 0.5 * h)
        ev = system.at(start.t, start.q, start.v)
        forces = ev.balance(np.zeros(system.n_v))
        solver.prepare(ev, Weights(1.0, 0.0, 0.25 * h * h))
        a, lam = solver.solve(-forces, -ev.gamma())
        return replace(start, a=a, lam=lam), correction

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> ContactAlphaStepper:  # type: ignore[override]
        """The time stepper of a run, from a consistent state."""
        return ContactAlphaStepper(self, system, solver, newton, state)


class ContactAlphaStepper(ElasticContactStepper):
    """Advances a state; holds the algorithmic acceleration A."""

    maker = "ALPHA"
    share = 1.0
    keeps: ClassVar = {**ElasticContactStepper.keeps, "A": Memory.like_v, "size": plain()}

    def __init__(self, scheme: ContactAlpha, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        super().__init__(system, solver, newton, state)
        self.scheme = scheme
        self.A = state.a.copy()
        self.size = 0.0  # of the last step, s

    def _weights(self, h: float) -> Weights:
        return self.scheme.rule(h).weights

    def _lend(self, march: ContactMarch, h: float) -> None:
        march.parameters[slots.AM : slots.BETA + 1] = self.scheme.parameters
        march.parameters[slots.FAR], march.parameters[slots.PATIENCE] = FAR * self.system.length, PATIENCE
        march.parameters[slots.TOL] *= FINER

    def _algorithmic(self) -> Array:
        return self.A

    def _take_own(self, march: ContactMarch, made: int, h: float) -> None:
        self.A, self.size = march.block(0)[4], h

    def begin_anew(self, start: Callable[[], State]) -> bool:
        """Go on in the same place behind a jump of forces F: a and A jump by da, (M + h^2 K / 4) da + G^T dlambda = dF."""
        before, s = self.state, start()
        still = np.zeros(self.system.n_v)
        ahead, behind = self.system.at(s.t, s.q, s.v), self.system.at(before.t, s.q, s.v)
        jump = ahead.balance(still) - behind.balance(still)

        self.solver.prepare(ahead, Weights(1.0, 0.0, 0.25 * self.size**2))
        da, dlam = self.solver.solve(-jump, np.zeros(self.system.n_lam))
        self.A = self.A + da
        self.state = replace(self.state, t=s.t, a=s.a + da, lam=s.lam + dlam)
        return True

    def advance(self, h: float) -> State:
        """One step of size h (s); collective. Raises ConvergenceError when Newton fails; the state is then
        unchanged.
        """
        pressures = self.solver.pressures
        try:
            return self._advance(h)
        except (ConvergenceError, LinearSolveError):
            self.solver.pressures = pressures
            raise

    def _advance(self, h: float) -> State:
        """The same; pressures that bodies carry are left as they are when Newton fails."""
        system, s = self.system, self.state
        near, _ = candidates(system, self.contacts, s, h)

        step, iterations = self._solved(h, near, lambda some: _Step(self, h, some))
        q = step.q

        v, force = self._persist(step)
        beta, self.size = self.scheme.parameters[3], h
        self.local_error = h * h * abs(beta - 1 / 6) * system.max_abs(step.A - self.A)
        self.A = step.A

        forces = StepForces(step.near, step.contact.rows, force, s.t + h)
        lam = least(self.solver, s.t + h, q, step.lam)
        self.state = self.ledger.write(State(s.t + h, q, v, step.a, lam), forces, (step.end, step.xi, step.lam), h)
        self.ledger.count(iterations)
        return self.state

    def _persist(self, step: _Step) -> tuple[Array, Array]:
        """Velocities by (2) and (3), the latter with their accelerations, and the forces of the whole step, (m, 1 or d)."""
        v, rows, force = step.v, step.contact.rows, step.contact.force
        closed = force[:, 0] > 0
        if rows is None or not closed.any():
            return v, force

        # the metric of the step's beginning, whichever tangents its iteration has taken since
        assert step.begun is not None
        self.solver.prepare_once(step.begun, self._weights(step.h))
        rate = self.contacts.gap_rate(self.system, self.state.t + step.h, step.end.q, step.h)[step.near]
        stopped = force.copy()
        on = rows if closed.all() else rows.take(closed)
        P = self._stopping(on, v, rate[closed], step.h)
        if P.any():
            v = v + self._pushed(on.L, P.ravel())
            stopped[closed] += P / step.h

        # where contacts have closed in this step
        if (closed & (self.ledger.force[step.near][:, 0] <= 0)).any():
            dv = self._pushed(rows.L, -step.gain * force.ravel())
            obstacles = np.concatenate((rate[:, None], -rows.drift / step.h), axis=1)[:, : force.shape[1]]
            share = self._share(step, v, dv, -step.gain * float((force * obstacles).sum()))
            v = v + share * dv
            stopped -= share * force
            step.accelerate(share * dv)
        return v, stopped

    def _stopping(self, rows: Rows, v: Array, rate: Array, h: float) -> Array:
        """Impulses (m, 1 or d) of (2) on closed contacts, with friction on their slips at the end of a step of size h (s);
        the motion of obstacles changes gaps at a ``rate`` (m,), m/s.
        """
        u = self.contacts.times(self.system, rows.L, v).reshape(len(rate), rows.components)
        u = u + np.concatenate((rate[:, None], -rows.drift / h), axis=1)
        none = np.zeros_like(u)
        if not (u[:, 0] < 0).any():
            return none
        W = self.compliance.of(rows.L, rows.trace, 1.0)
        return small_problem(self.problem, W, (u.ravel(), rows.friction), none, self.ledger.counts)

    def _pushed(self, rows: LinearRows, P: Array) -> Array:
        """Change of velocities by impulses P on rows."""
        return self.solver.solve(self.contacts.transposed(self.system, rows, P), np.zeros(self.system.n_lam))[0]

    def _share(self, step: _Step, v: Array, dv: Array, work: float) -> float:
        """The share in [0, 1] of a change dv of the velocities v that leaves the least energy of motion; ``work`` (J): what all
        of it gives to the obstacles.
        """

        def kinetic(v: Array) -> float:
            return float(self.system.at(step.end.t, step.end.q, v).energies()["kinetic"])

        new = kinetic(dv)
        slope = kinetic(v + dv) - kinetic(v) - new + work
        return min(max(-slope / (2 * new), 0.0), 1.0) if new > 0 else 0.0


class _Step(ElasticStep):
    """The Newton iteration of one step."""

    p: ContactAlphaStepper

    def __init__(self, stepper: ContactAlphaStepper, h: float, near: np.ndarray) -> None:
        super().__init__(stepper, h, near)
        s = stepper.state
        self.am, self.af, self.gamma, self.beta = stepper.scheme.parameters
        self.a = s.a.copy()
        self.A = self._algorithmic()
        self.fixed = h * s.v + h * h * (0.5 - self.beta) * stepper.A
        self.xi = self.fixed + h * h * self.beta * self.A
        self.scale = self.beta * h * h * (1 - self.af) / (1 - self.am)
        self.begun: Evaluation | None = None  # where the first increment began

    def _algorithmic(self) -> Array:
        s = self.p.state
        return ((1 - self.af) * self.a + self.af * s.a - self.am * self.p.A) / (1 - self.am)

    @property
    def q(self) -> Array:  # type: ignore[override]
        """Configuration at the end."""
        return self.p.system.compose(self.p.state.q, self.xi)

    @property
    def v(self) -> Array:
        """Velocity at the end."""
        return self.p.state.v + self.h * ((1 - self.gamma) * self.p.A + self.gamma * self.A)

    @property
    def gain(self) -> float:
        """Velocity at the end by a force, over A^-1 times the force, s."""
        return self.scale * self.gamma / (self.beta * self.h)

    def where(self) -> tuple[float, Array, Array]:
        """As :meth:`ElasticStep.where`."""
        s = self.p.state
        return s.t + self.h, self.q, self.v

    def accelerate(self, dv: Array) -> None:
        """Accelerations that change the velocity at the end by dv."""
        change = dv / (self.gamma * self.h)
        self.A = self.A + change
        self.a = self.a + (1 - self.am) / (1 - self.af) * change

    def increment(self) -> float:
        """One Newton step; returns its size over the tolerance."""
        p = self.p
        h = self.h
        s = p.state
        system, solver = p.system, p.solver
        q = self.q
        weights = p._weights(h)
        balance = self.balance((s.t + h, q, self.v), self.a, weights)
        self.begun = self.begun or self.ev
        volumes = volume_gaps(self.ev)
        if volumes:
            balance = balance + volume_push(solver, volumes) / self.scale
        residuals = balance, gaps(self.ev, h * self.beta / self.gamma)

        touching = None
        if self.near.any():
            rows = p.contacts.rows(system, s.t + h, q, way=way_over(s.t, h), near=self.near)
            touching = rows, openings(p.contacts, system, rows, rows.gap, self.xi)
        dq, dlam = self.changes(touching, residuals, self.scale)
        move_pressures(solver, dq, volumes)

        d_xi = system.rate(self.xi, dq)
        self.lam = self.lam + dlam / self.scale
        self.xi = self.xi + d_xi
        self.A = self.A + d_xi / (h * h * self.beta)
        self.a = self.a + d_xi / self.scale
        size = max(system.max_abs(self.xi), h * system.max_abs(s.v), 1e-9 * system.length)
        self.tolerance = max(1e-4 * p.newton.tolerance * size, roundoff(system))
        return system.max_abs(dq) / self.tolerance
