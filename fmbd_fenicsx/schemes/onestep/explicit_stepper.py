"""What explicit Runge-Kutta methods share: settings, control of the step by an embedded formula, the end of a step.

A method makes a step up to positions and velocities that miss the constraints by the error of the step. Here they are closed by a
projection in the mass metric, accelerations and multipliers are those of the new state, and a step whose error is above the
tolerance is made again, smaller. The way of the projection is an error, too: where stages follow accelerations alone it is all
that tells of a kink of a drive. Source of the control: :mod:`..control`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ...checks import check_fields
from ...errors import BalanceError, CallbackError, ConvergenceError, LawError, LinearSolveError
from ...linear.condensation import StepSolver
from ...log import log
from ...rotations import Array
from ...system.compiled.explicit import CONTROLLED, ExplicitRoom
from ...system.compiled.march import March
from ...system.compiled.states.evaluation import DriverStates
from ...system.compiled.states.explicit import Tableau
from ...system.element_memory import collocated
from ...system.layout import State, States
from ...system.serialisation import Memory, plain, worker
from ...system.system import System
from ..consistent import arrived
from ..control import ESTIMATE, Statistics, StepControl, first_step, turn_limit, turns_too_far
from ..error_norm import STRICT, check_tolerance, worst
from ..newton import Newton
from ..own_marching import OwnMarch
from .explicit_limit import StepLimit

if TYPE_CHECKING:
    from ...system.compiled.kept import KeptSteps


@dataclass(frozen=True)
class ExplicitScheme:
    """Scheme data. ``rtol``: relative tolerance of the local error, None for constant steps; ``atol`` as in Radau.

    Constant steps that do not resolve the fastest vibration are refused.
    """

    rtol: float | None = None
    atol: float | None = None
    order: ClassVar[int]
    holds = (0, 1)
    ends_ahead = True
    takes_given = True

    def __post_init__(self) -> None:
        check_fields(self)
        check_tolerance(self.rtol, self.atol, type(self).__name__)


class ExplicitStepper(OwnMarch):
    """Advances a consistent state. A method says how a step is made (:meth:`_step`), and by which tableau."""

    what = "The scheme"  # in messages
    forces_within = True
    failures = ("constraints not closed",)
    embedded: ClassVar[Array]  # weights of slopes in formulas of the error, (formulas, stages)
    _slopes: Array = np.zeros(0)  # what the last step has left for its polynomial

    keeps: ClassVar = {
        "state": Memory.state,
        "control": plain(StepControl),
        "stats": plain(Statistics),
        "proposed": plain(),
        "local_error": plain(),
        "norm": worker,
        "limit": worker,
    }

    def __init__(self, scheme: Any, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        super().__init__(scheme, system, solver, newton, state, index=1)
        self.control = StepControl(float(scheme.order))
        self.norm.let_pass(STRICT)  # nothing looks at forces within a step beside its estimate
        self.local_error = 0.0
        self.before: State | None = None  # at the start of the last step
        self.limit: StepLimit = StepLimit(self.what, system, solver, partial(amplified, self._tableau()[0][1]))
        self._lent: ExplicitRoom | None = None
        if self.adaptive and (left := collocated(system)):
            log.warning(
                'error control of %s does not see the memory of controller "%s", which goes by the trapezoidal rule: rtol may '
                "not be met. Take fmbd.Radau() or fmbd.BDF()", scheme.name, left[0].forces[0].name,
            )  # fmt: skip

    @property
    def counters(self) -> dict[str, float]:
        """Work so far, for the counters of a run."""
        return self.stats.as_dict()

    def _begin_from(self, state: State) -> None:
        """A consistent state, without a past."""
        super()._begin_from(state)
        self.control.h_old, self.before = 0.0, None

    def between(self, t: float) -> State | None:
        """The state at a time t (s) within the last step, by the polynomial of the method; None after a new start; collective."""
        if self.before is None:
            return None
        ends = States.of([self.before]), States.of([self.state])
        return self._polynomial(*ends, np.array([[t]]), self._slopes[None]).state(0)

    def within(self, steps: KeptSteps) -> States:
        """As :meth:`TimeStepper.within`."""
        return self._polynomial(steps.before, steps.after, steps.t, self._told(steps.own))

    def advance(self, h: float) -> State:
        """One accepted step: of size h, or with error control of at most h (s); collective."""
        if self.adaptive and self.proposed is None:
            self.control.span = max(self.control.span, h)
            self.norm.update(self.state, self.to_come(h))
            self.proposed = first_step(self.norm, self.state, self.control.order, h)
        self._free(h)
        self.limit.count(1)
        if self._step_in_one_call(h):
            return self.state
        self.before, self.state = self.state, self._controlled(h) if self.adaptive else self._constant(h)
        self.stats.steps += 1
        return self.state

    def _free(self, h: float) -> tuple[float, float]:
        if not self.adaptive:
            return self.limit.free(self.state, h)
        if self.proposed is None:
            return np.inf, np.inf
        return self.limit.hold(self.state, min(self.proposed, h), max(self.control.span, h)), np.inf

    @property
    def longest_stable(self) -> float:  # type: ignore[override]
        """As :attr:`OwnMarch.longest_stable`."""
        return self.limit.held

    # -- many steps in one call -----------------------------------------------------------------------------------------
    def _in_one_call(self, h: float) -> bool:
        return self._chooses_alike if self.adaptive else True

    def _room(self, states: DriverStates) -> int:
        tableau, nothing = self._tableau()
        own = self._own_room(error=self.embedded) if self.adaptive else None
        self._lent = ExplicitRoom(states, tableau, nothing, own)
        return 1

    def _prepare_room(self, room: Array, *, alone: bool) -> None:
        assert self._lent is not None
        room.view(np.uintp)[0] = self._lent.address
        if self._lent.own is not None:
            self._lend_own(self._lent.own)

    def _own(self, *, factored: bool) -> Array:
        control = self.control
        return np.array([[self.proposed or 0.0, control.h_old, control.error_old]])

    def _take_march(self, march: March, made: int) -> None:
        self.before = march.state(1)
        self.stats.steps += made
        own, attempts = None if self._lent is None else self._lent.own, made
        if own is not None:
            attempts += int(own.c.refused + sum(own.c.failed))
            self._take_own(own, made)
            self.control.fault = ""
            self._take_control(march.ring.own())
        self._count(attempts)

    def _take_kept(self, own: Array) -> None:
        self.before = None
        self._take_control(own)

    def _take_control(self, own: Array) -> None:
        """What error control keeps with a state."""
        self.proposed, self.control.h_old, self.control.error_old = map(float, own[:CONTROLLED])

    def _constant(self, h: float) -> State:
        """The state after a step of size h (s), on the constraints."""
        try:
            return arrived(self.system, self._step(h)[0], self.solver)
        except (CallbackError, LawError) as fault:
            if not isinstance(fault, BalanceError) and not self._has_forces(h):
                raise
            raise self.limit.blame(self.state, h, fault) from fault

    def _has_forces(self, h: float) -> bool:
        """Whether all laws have values, up to the end of a step of size h, where it begins: a step without has run away."""
        s = self.state
        try:
            for t in (s.t, s.t + h):
                self.system.at(t, s.q, s.v).balance(s.a, s.lam)
        except (CallbackError, LawError):
            return False
        return True

    def _controlled(self, limit: float) -> State:
        """The same after a step of at most ``limit`` (s) that passes the error test."""
        assert self.proposed is not None
        self.control.span = max(self.control.span, limit)
        farthest = turn_limit(self.system, self.state)
        self.proposed = self.control.proposal(self.proposed, limit)
        while True:
            h = self._landing(min(self.proposed, farthest, self.longest_stable), limit)
            self.solver.near_singular.begin_trial()
            made, error, cause = self._attempt(h)
            if made is not None and self.control.passes(error):
                self.solver.near_singular.accept_trial()
                break
            self.stats.rejected[cause] += 1
            self.proposed = self.control.rejected(self.state.t, h, error, cause)

        # a step cut short by the end tells nothing of the next one
        new = self.control.accepted(h, error)
        self.proposed = new if h >= self.proposed or new < h else self.proposed
        self.local_error = error
        return made

    def _attempt(self, h: float) -> tuple[State | None, float, str]:
        """A step of size h: the state, on the constraints where it passes the error test, if there is one, the error over the
        tolerance, and the cause of a rejection.
        """
        self.norm.update(self.state, h)
        try:
            made, errors = self._step(h)
            error = self._size(h, errors)
            moved = self.system.difference(self.state.q, made.q, near=h * made.v)
            if turns_too_far(self.system, moved):
                return None, np.inf, "turns too far"
            if not self.control.passes(error):
                return made, error, ESTIMATE

            closed = arrived(self.system, made, self.solver)
            way = self.system.difference(made.q, closed.q)
            return closed, worst(error, self.norm(h, way, np.zeros_like(way))), ESTIMATE
        except (ConvergenceError, LinearSolveError):
            return None, np.inf, "constraints not closed"
        except CallbackError as fault:
            self.control.fault = str(fault)
            return None, np.inf, "forces not finite"

    # -- what a method says -------------------------------------------------------------------------------------------
    def _tableau(self) -> tuple[Tableau, float]:
        """Nodes c and rows A (stages + 1, stages), and the way (m) that counts as none."""
        raise NotImplementedError

    def _count(self, attempts: int) -> None:
        """So many attempts at a step more."""
        raise NotImplementedError

    def _told(self, own: Array) -> Array:
        """What steps have left for their polynomials, of what compiled code keeps with their ends, (.., numbers)."""
        return own

    def _polynomial(self, before: States, after: States, t: Array, slopes: Array) -> States:
        """The states at times t (k, 1) s within steps between two states; ``slopes`` (k, ..): what these have left."""
        raise NotImplementedError

    def _step(self, h: float) -> tuple[State, tuple[Array, Array]]:
        """The state after a step of size h (s) before projection, and what :meth:`_size` takes of the errors of xi and v."""
        raise NotImplementedError

    def _size(self, h: float, errors: tuple[Array, Array]) -> float:
        """What :meth:`_step` told of the errors of xi and v, over the tolerance."""
        return self.norm(h, *errors)


def amplified(A: Array, z: float, damping: float) -> Array:
    """The matrix of one step of a method with the rows A, (stages + 1, stages), for x'' + c x' + w^2 x = 0, z = h w and
    damping = h c, over (x, h x'), (2, 2).
    """
    x, v = np.eye(2)
    places, speeds, pushes = [x], [v], []
    for row in A[1:]:
        # x'' at the newest stage
        pushes.append(-(z * z * places[-1] + damping * speeds[-1]))
        known = row[: len(pushes)]
        places.append(x + known @ np.array(speeds))
        speeds.append(v + known @ np.array(pushes))
    return np.array([places[-1], speeds[-1]])
