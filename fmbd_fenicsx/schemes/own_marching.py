"""Steps of a size of their own in compiled code (driver/marches/own_steps.c): what all schemes with error control have in common.

A step that fails in another way than by its error is made by Python from the same beginning.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from ..errors import ConvergenceError
from ..linear.condensation import StepSolver
from ..rotations import Array
from ..system.compiled.march import CHOSEN
from ..system.compiled.own_steps import OwnRoom
from ..system.element_memory import next_sample
from ..system.layout import State
from ..system.system import System
from .consistent import arrived
from .control import ESTIMATE, LEAST_ERROR, PATIENCE, REFUSED, TURN, Statistics, StepControl, lands
from .error_norm import ErrorNorm
from .marching import MarchingStepper
from .newton import Newton
from .stepping import Observers


def own_numbers(norm: ErrorNorm, control: StepControl) -> dict[str, float]:
    """What compiled code is told of a norm and a controller, by the names of own_steps.c."""
    harsh, mild = REFUSED
    return {
        "index": norm.index, "rtol": norm.rtol, "atol": norm.atol or 0.0, "length": norm.system.length, "turn": TURN,
        "brief": norm.brief,
        "safety": control.safety, "harsh": harsh, "mild": mild, "patience": PATIENCE,
        "given": control.given, "order": control.order, "shrink": control.shrink, "grow": control.grow, "least": LEAST_ERROR,
    }  # fmt: skip


class OwnMarch(MarchingStepper):
    """A scheme with constant steps, or (``adaptive``) with steps of the sizes that its error control chooses."""

    passes_marks = True
    # why compiled code makes a step smaller, beside its error (FAILING of own_steps.c)
    failures: ClassVar[tuple[str, ...]] = ("Newton diverged", "Newton too slow", "turns too far")
    control: StepControl
    proposed: float | None
    longest_stable: float = np.inf  # s, the most that its steps may be to be stable
    _ahead: float  # s that the steps of a call may take
    _alone_now = False  # whether a step is made by itself, which may end where a controller samples

    def __init__(
        self, scheme: Any, system: System, solver: StepSolver, newton: Newton, state: State, *, index: int
    ) -> None:
        """``index``: as of :class:`.ErrorNorm`."""
        self.scheme, self.system, self.solver, self.newton, self.state = scheme, system, solver, newton, state
        self.norm = ErrorNorm(state, system, scheme.rtol or newton.tolerance, scheme.atol, index)
        self.stats, self.proposed = Statistics(), None
        self.adaptive = scheme.rtol is not None

    def _begin_from(self, state: State) -> None:
        """A consistent state, without a past."""
        self.state, self.proposed = state, None

    def restart(self, t: float) -> None:
        """Forget the past: the solution has a kink at t. What drives have changed in velocities is an impact; accelerations and
        multipliers behind the kink are solved for.
        """
        self._begin_from(arrived(self.system, replace(self.state, t=t), self.solver, places=False))

    def begin_anew(self, start: Callable[[], State]) -> bool:
        """As :meth:`TimeStepper.begin_anew`."""
        self._begin_from(start())
        return True

    def _take_kept(self, own: Array) -> None:
        """What a state of a march keeps."""
        raise NotImplementedError

    def take_given(self, sizes: Array) -> None:
        """Steps have these sizes (s), whatever their errors are."""
        self.control.given = True

    def stride(self, h: float) -> float:
        """As :meth:`TimeStepper.stride`."""
        found = super().stride(h)
        if not self.adaptive or self.proposed is None:
            return found
        size = min(found, self.proposed, self.longest_stable)
        return size if self.state.t + size < next_sample(self.system) else 0.0

    def _landing(self, h: float, limit: float) -> float:
        """The size (s) of a step for which so much is proposed, of at most ``limit``, on the way to where steps have to end.

        Raises ConvergenceError where a given one is larger: the run is to have no others.
        """
        if self.control.given and h < limit * (1.0 - 1e-10):
            raise ConvergenceError(
                f"The step of {limit:g} s at t = {self.state.t:.9g} s is too large: {h:g} s can be made."
            )
        return lands(min(h, limit), max(limit, self.until - self.state.t))

    def _end(self, limit: float) -> float:
        """When steps of at most ``limit`` (s) have to end, s: where that is told it is no sum, which may be off by a rounding."""
        end = self.state.t + limit
        return self.ends[-1] if self.ends[-1] >= end - 4 * np.spacing(end) else end

    def step_back(self) -> None:
        """As :meth:`TimeStepper.step_back`."""
        assert self._used is not None
        self.state = self._used.state(1)
        self._take_kept(self._used.ring.own(1).copy())

    @property
    def _chooses_alike(self) -> bool:
        """Whether compiled code may choose the next step."""
        return self.proposed is not None and not self._failed_here

    @property
    def _failed_here(self) -> bool:
        """Whether it has found none from the newest state on."""
        return self._refused is not None and self._refused[0] is self.state

    def _left(self, h: float, begun: float) -> float:
        """As :meth:`MarchingStepper._left`: steps of its own choice take so much in all."""
        return h - (self.state.t - begun) if self.adaptive else h

    def _step_in_one_call(self, h: float) -> bool:
        self._alone_now = True
        try:
            return super()._step_in_one_call(h)
        finally:
            self._alone_now = False

    def _made(self, h: float, count: int, most: float, observers: Observers) -> int:
        self._ahead = h
        return super()._made(h, count, most, observers)

    def _own_room(
        self,
        *,
        error: Array | None = None,
        between: Array | None = None,
        orders: ctypes.Structure | None = None,
        **numbers: float,
    ) -> OwnRoom:
        """Its error control, with what the scheme has of its own."""
        numbers = {**own_numbers(self.norm, self.control), **numbers}
        return OwnRoom(self._twin, self.norm.deforming, numbers, error=error, between=between, orders=orders)

    def _lend_own(self, own: OwnRoom) -> None:
        """What error control has seen so far, and where the steps of a call end."""
        assert self.proposed is not None and self._used is not None
        control, norm, limit = self.control, self.norm, self._ahead
        control.span = max(control.span, limit)
        own.lend(norm.q_size, norm.v_size, norm.deflections)
        own.c.pause, own.c.since = control.pause, control.since
        own.c.worst = own.c.refused = own.c.filtered = 0.0
        own.c.failed[:] = [0.0] * len(own.c.failed)

        # where its steps end
        own.pass_by(self.ends[:-1])
        own.c.sample = np.inf if self._alone_now else next_sample(self.system)
        own.c.until = self._end(limit)
        own.c.longest, own.c.tiny = min(self.longest, self.longest_stable), control.tiny
        # whoever begins later passes what somebody waits for
        own.c.last = np.inf if self._alone_now else self.last
        self._used.parameters[CHOSEN] = norm.rtol

    def _take_own(self, own: OwnRoom, made: int) -> None:
        """What it has seen in so many steps."""
        norm = self.norm
        norm.q_size, norm.v_size, norm.deflections = own.told()
        self.control.pause, self.control.since = int(own.c.pause), int(own.c.since)
        self.local_error = float(own.c.worst)
        for cause, count in ((ESTIMATE, own.c.refused), *zip(self.failures, own.c.failed, strict=False)):
            if count:
                self.stats.rejected[cause] += int(count)
