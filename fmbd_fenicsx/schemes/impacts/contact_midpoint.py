"""Contact-implicit midpoint rule with massless contact nodes: the default for scenes with contact.

    q_1 = q_0 o exp(xi),   v_m = xi / h,   v_1 = 2 v_m - v_0                                                (1)
    M (v_1 - v_0) / h + h(q_m, v_m) + G_m^T lambda - N_m^T Lambda = 0    at  q_m = q_0 o exp(xi / 2)        (2)
    g(q_1) = 0,     0 <= Lambda _|_ gap(q_1) >= 0                                                           (3)

The forces act in the middle of the step, the gap closes at its end. On a linear elastic body and a plane obstacle the
contact's work in a step is Lambda (gap_1 - gap_0) = -Lambda gap_0 <= 0, nothing while it stays closed: energy never
grows. Without inertia on the contact nodes (:mod:`fmbd_fenicsx.mechanics.contact.mass`) Lambda does not oscillate.
Each Newton step solves the linearised (2) and (3) as one small complementarity problem on the candidates; the active
set of the last step starts it. After the step the velocity is projected on the joints' velocity constraints, which
takes energy, never gives it.

With theta instead of 1/2 in (1), (2) the rule is q_theta = q_0 o exp(theta xi), v_1 = v_0 + (v_m - v_0) / theta;
theta = 1 is the implicit Euler rule, of first order and strongly damped: for equilibria by large steps.

Nodes without inertia take no part in M (v_1 - v_0): the balance holds their mean velocities v_m alone, and by (1) jumps of
these would add up in v_1, with a changing sign. Their velocity at the end is led on by the difference of two mean ones,

    a_1 = (v_m - (v_0 - (1 - theta) h a_0)) / h,   v_1 = v_m + (1 - theta) h a_1                             (4)

Their places at the ends of steps alternate about those that the balance holds in the middle, with theta = 1/2 without end
behind a release; a larger theta damps that. Surfaces are paired where nodes would be without that: two mean velocities that
differ by h a_1 say that the places alternate by h^2 a_1 / 4,

    x_1 - h^2 a_1 / 4 = (3 x_1 + 2 x_0 - x_-1) / 4                                                      (5)

Paired where they are, surfaces push alternately to one side and not, which makes the alternation grow without friction, by the
step and not by the time, and each of its overlaps stays: bodies sink into each other.

Source: Khenous, Laborde, Renard, doi:10.1016/j.euromechsol.2008.01.001; Deuflhard, Krause, Ertel,
doi:10.1002/nme.2119.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ...checks import check_fields
from ...errors import require
from ...linear.blocks.field_blocks import Weights
from ...linear.condensation import StepSolver
from ...linear.redundancy import least
from ...log import log
from ...mechanics.contact.obstacles import way_over
from ...rotations import Array
from ...system.layout import State
from ...system.scene.contents import Contents
from ...system.speed_rows import gaps, speed_rows
from ...system.system import System
from ..consistent import Correction, consistent, widest
from ..dense_output import state_within
from ..newton import Newton
from .contact_detection import candidates, refuse_penetration
from .contact_ledger import StepForces
from .contact_newton import openings
from .elastic_contact_stepper import ElasticContactStepper
from .elastic_step import ElasticStep

if TYPE_CHECKING:
    from .compiled.elastic_contact import ContactMarch


@dataclass(frozen=True)
class ContactMidpoint:
    """Scheme data: ``theta`` in [1/2, 1]; 1/2 conserves energy, 1 is the implicit Euler rule. Equations (1)
    to (3).
    """

    theta: float = 0.5

    def __post_init__(self) -> None:
        check_fields(self)
        require(0.5 <= self.theta <= 1.0, f"ContactMidpoint: theta = {self.theta} must lie in [1/2, 1].")

    @property
    def order(self) -> int:
        """Order away from impacts."""
        return 2 if self.theta == 0.5 else 1

    @property
    def name(self) -> str:
        """Name in reports."""
        return "contact-implicit midpoint" if self.theta == 0.5 else f"contact-implicit theta rule ({self.theta:g})"

    def refusal(self, held: Contents) -> str:
        """Why it does not take what a scene holds."""
        return elastic_refusal(self.name, held)

    def start(self, system: System, state: State, solver: StepSolver, h: float) -> tuple[State, Correction]:
        """Consistent positions and velocities; refuses overlap."""
        return elastic_start(system, state, solver, self.theta * h)

    holds = (0,)

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> ContactMidpointStepper:
        """The time stepper of a run, from a consistent state."""
        return ContactMidpointStepper(self.theta, system, solver, newton, state)


def elastic_refusal(name: str, held: Contents) -> str:
    """Why a scheme for elastic contact does not take what a scene holds; "" where it does."""
    if not held.contacts:
        return f"{name} is a scheme for scenes with contact; this scene has none. Use another scheme."
    if not held.bouncing:
        return ""
    return (
        f'Contact "{held.bouncing[0]}" is between rigid or reduced bodies, or a joint limit: {name} has no impact law for '
        "inertia on the contact point, its rebound would depend on dt. Use fmbd.schemes.Moreau(), which takes the restitution."
    )


def elastic_start(system: System, state: State, solver: StepSolver, tau: float) -> tuple[State, Correction]:
    """Start of a scheme for elastic contact: consistent in the metric M + tau^2 K (M is singular on massless
    nodes); collective.

    Raises:
        InputError: bodies that overlap.
    """
    contacts = system.contacts
    heavy = [p.name for p in contacts.pairs if not p.massless]
    if heavy:
        log.warning(
            'contact "%s": inertia on contact nodes (redistribute_mass=False) lets the contact force '
            "oscillate; see docs/contact.md",
            heavy[0],
        )
    start, correction = consistent(system, state, solver, metric=Weights(1.0, 0.0, tau * tau), accelerated=False)
    refuse_penetration(system, contacts, start)
    return start, correction


def roundoff(system: System) -> float:
    """Size (m) of increments that are none."""
    return 100 * float(np.finfo(float).eps) * system.length


def weightless(system: System) -> np.ndarray:
    """Entries of v that belong to nodes without inertia, (n_v,) bool."""
    out = np.zeros(system.n_v, dtype=bool)
    for k, part in system.fields:
        system.local_v(out, k)[:] = np.repeat(part.field.M.getDiagonal().array == 0.0, part.field.dim)
    return out


class ContactMidpointStepper(ElasticContactStepper):
    """Advances a state through contact."""

    maker = "THETA_RULE"

    def __init__(self, theta: float, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        super().__init__(system, solver, newton, state)
        self.theta = self.share = theta
        self._projects = any(b.kind != "frame" for b in system.blocks)
        self._weightless = weightless(system)
        self._begun: State | None = None  # what the last step began with
        self._means: list[Array] = []  # velocities of the last two steps

    def _weights(self, h: float) -> Weights:
        return Weights(1.0, self.theta * h, (self.theta * h) ** 2)

    def _room(self) -> Array:
        driver = self.solver.driver
        assert driver is not None
        massless = driver.states.twin.velocities(self._weightless.astype(float))
        return np.concatenate(((self.theta, roundoff(self.system), self._projects), massless))

    def _take_own(self, march: ContactMarch, made: int, h: float) -> None:
        places = [march.state(i) for i in range(1 + min(made, 2))]
        means = [self.system.difference(b.q, a.q, near=h * b.v) / h for a, b in pairwise(places)]
        self._begun, self._means = places[1], [*self._means[-1:], *means[::-1]][-2:]

    def advance(self, h: float) -> State:
        """One step of size h (s); collective. Raises ConvergenceError when Newton fails; the state is then
        unchanged.
        """
        system, s = self.system, self.state
        near, ahead = candidates(system, self.contacts, s, h, paired=self._paired(h))

        step, iterations = self._solved(h, near, lambda some: _Step(self, h, some, ahead))

        mean = step.xi / h
        self._begun, self._means = s, [*self._means[-1:], mean]
        v, slopes = self._velocities(mean, h)
        if self._projects:
            v = self._project(step, v)
        a = (v - s.v) / h
        a[self._weightless] = slopes
        self.local_error = h * h / 12 * system.max_abs(a - s.a)

        forces = StepForces(step.near, step.contact.rows, step.contact.force, s.t + self.theta * h)
        lam = least(self.solver, s.t + h, step.q, step.lam)
        self.state = self.ledger.write(State(s.t + h, step.q, v, a, lam), forces, (step.end, step.xi, step.lam), h)
        self.ledger.count(iterations)
        return self.state

    def between(self, t: float) -> State | None:
        """The state at a time t (s) within the last step: positions on the parabola through the last three, as velocities at the
        ends of steps are led on from mean ones where nodes have no inertia.
        """
        before, after = self._begun, self.state
        if before is None or t < before.t:
            return None
        h = after.t - before.t
        x, earlier, mean = (t - before.t) / h, self._means[0], self._means[-1]
        xi = x * h * mean - 0.5 * x * (1 - x) * h * (mean - earlier)
        return state_within(before, after, t, self.system.compose(before.q, xi))

    def _paired(self, h: float) -> Array | None:
        """The configuration that surfaces are paired in by (5); None: that of the start."""
        s = self.state
        if self.theta > 0.5 or not self.contacts.searching:
            return None
        return self.system.compose(s.q, np.where(self._weightless, -0.25 * h * h * s.a, 0.0))

    def _velocities(self, mean: Array, h: float) -> tuple[Array, Array]:
        """Those at the end of a step by (1), from the mean one, and accelerations of what has no inertia, by (4)."""
        s, massless, left = self.state, self._weightless, 1.0 - self.theta
        slopes = (mean - s.v)[massless] / h + left * s.a[massless]
        v = s.v + (mean - s.v) / self.theta
        v[massless] = mean[massless] + left * h * slopes
        return v, slopes

    def _project(self, step: _Step, v: Array) -> Array:
        """Velocity that satisfies the joints at the end of the step."""
        ev = self.system.at(self.state.t + step.h, step.q, v)
        slip = ev.opening()
        dv, _ = self.solver.solve(np.zeros(self.system.n_v), -slip)
        return v + dv


class _Step(ElasticStep):
    """The Newton iteration of one step."""

    def __init__(self, stepper: ContactMidpointStepper, h: float, near: np.ndarray, ahead: Array) -> None:
        """``ahead``: where the velocity at the start leads, from which the iteration goes on."""
        super().__init__(stepper, h, near)
        system, s = stepper.system, stepper.state
        self.xi = h * s.v
        self.theta = stepper.theta
        self.scale = self.theta * h * h
        self.q = ahead
        self.g: Array = np.zeros(0)
        self.floor = roundoff(system)

    def where(self) -> tuple[float, Array, Array]:
        """As :meth:`ElasticStep.where`."""
        s, h = self.p.state, self.h
        return s.t + self.theta * h, self.p.system.compose(s.q, self.theta * self.xi), self.xi / h

    @property
    def advice(self) -> str:
        """With the joint that is open widest."""
        return f"{widest(self.p.system, self.g)}. Try a smaller dt."

    def increment(self) -> float:
        """One Newton step: predictor, complementarity problem, correction; returns its size over the
        tolerance.
        """
        p = self.p
        h = self.h
        s = p.state
        system = p.system

        # balance in the middle, constraints at the end
        middle = system.compose(s.q, self.theta * self.xi)
        vm = self.xi / h
        weights = p._weights(h)
        r = self.balance((s.t + self.theta * h, middle, vm), (vm - s.v) / (self.theta * h), weights)

        self.g = system.at(s.t + h, self.q).constraint() if system.n_lam else np.zeros(0)
        if system.n_lam and speed_rows(system).size:  # no slip at the middle of the step
            self.g[speed_rows(system)] = gaps(self.ev, h)[speed_rows(system)]

        touching = None
        if self.near.any():
            rows = p.contacts.rows(system, s.t + self.theta * h, middle, way=way_over(s.t, h), near=self.near)
            gap = p.contacts.touch(system, s.t + h, self.q).gap[self.near]
            touching = rows, openings(p.contacts, system, rows, gap, self.xi)
        dxi, dlam = self.changes(touching, (r, self.g), self.scale)

        self.lam = self.lam + dlam / self.scale
        self.xi = self.xi + system.rate(self.xi, dxi)
        self.q = system.compose(s.q, self.xi)
        way = max(system.max_abs(self.xi), h * system.max_abs(s.v))
        self.tolerance = max(1e-4 * p.newton.tolerance * way, self.floor)
        return system.max_abs(dxi) / self.tolerance
