"""Steps of Radau by calls of compiled code: constant ones, and those that error control chooses as long as each passes at once.

C finds their sizes, errors and ends as :class:`.RadauStepper` does (driver/own_steps.c). A step that fails, in whatever way, is
made by Python from the same beginning, and so is the first of a run, whose size nobody proposes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...rotations import Array
from ...system.compiled.implicit import ImplicitRoom, OwnRoom
from ...system.compiled.march import March
from ...system.compiled.states.convergence import Convergence
from ...system.compiled.states.stages import Rule
from ..control import LEAST_ERROR, TURN
from ..dae import Points
from ..implicit.convergence import Rates
from ..implicit.implicit_stepper import ImplicitStepper
from .collocation import Tableau

LONGER = 1.2  # steps so much longer than that of a rate do not rely on it
RATES = {
    True: Rates(limit=0.99, before=10.0, averaged=True, foresees=True),
    # with constant steps the first rate flatters: fast components go first
    False: Rates(limit=0.99, before=10.0, averaged=True, least=0.05),
}  # with error control, and with constant steps


class StageMarch(ImplicitStepper):
    """What a march of :class:`.Radau` begins with and leaves."""

    maker = "RADAU"
    lands = True
    slow, longer = 1e-2, LONGER
    tab: Tableau
    mult: Array  # at the end of the last step, (levels n_lam,)
    _last: tuple[float, Array, Array, Points] | None  # the last step: its size, q and v at its start, its stages
    _h_factor: float  # size of the step that the factor is for, s
    _eta: float  # what the last increment of the last step left, over its size
    _h_rate: float  # size of the step in which that was seen, s
    _filter: object  # of the error estimate, of the same tangent
    _trouble: int  # two for each failure of Newton's iteration, less one for each step
    _ahead: tuple[float, int]  # s that the steps of a call may take, and how many these are at most

    # -- steps ------------------------------------------------------------------------------------------------------
    @property
    def turning(self) -> int:
        """By how much less than others steps may turn: many stages share one tangent that long."""
        return 2 if self.scheme.form.frozen or self.scheme.stages > 3 else 1

    def stride(self, h: float) -> float:
        """As :meth:`TimeStepper.stride`."""
        found = super().stride(h)
        return min(found, self.proposed) if self.adaptive and self.proposed is not None else found

    def step_back(self) -> None:
        """As :meth:`TimeStepper.step_back`."""
        assert self._used is not None
        self.state = self._used.state(1)
        self._take_kept(self._used.ring.own(1).copy())

    def _in_one_call(self, h: float) -> bool:
        return super()._in_one_call(h) and (self._chooses_alike or not self.adaptive)

    @property
    def _chooses_alike(self) -> bool:
        """Whether compiled code may choose the next step."""
        # an even number of stages has no real factor that filters errors; elements with a memory have their own way
        known = self.scheme.stages % 2 == 1 and not (self.system.elements or self.system.keepers)
        tried = self._refused is not None and self._refused[0] is self.state
        return known and self.proposed is not None and not tried

    def _made(self, h: float, count: int, most: float, judges: Any) -> int:
        self._ahead = h, count
        return super()._made(h, count, most, judges)

    # -- what a march begins with -----------------------------------------------------------------------------------
    def _lend(self) -> ImplicitRoom:
        tab, norm = self.tab, self.norm
        coefficients = {name: getattr(tab, name) for name in ("c", "W", "values", "middle", "basis", "stage_basis")}
        stages = self.eq.tangents.room(len(tab.values), len(tab.c))
        if not self.adaptive:
            return ImplicitRoom(stages, coefficients)
        form, control = self.scheme.form, self.control
        own = OwnRoom(self.system, tab.error, norm.deforming, {
            "index": form.index, "places": 0 in form.levels, "turning": self.turning, "rtol": norm.rtol,
            "atol": norm.atol or 0.0, "length": self.system.length, "turn": TURN, "order": control.order,
            "safety": control.safety, "shrink": control.shrink, "grow": control.grow, "least": LEAST_ERROR,
            "most": 2.0 * self.newton.max_iterations,
        })  # fmt: skip
        return ImplicitRoom(stages, coefficients, own=own)

    def _settings(self) -> tuple[Convergence, Rule]:
        tab = self.tab
        return self._convergence(0.0, RATES[self.adaptive], 1.0), Rule(tab.W, tab.inverse, tab.vectors)

    def _memory(self) -> Array:
        s, k, control = self.state, len(self.tab.c), self.control
        h, q, v, points = self._last or (0.0, s.q, s.v, None)
        none = np.zeros(k * len(v))
        xi, vs, mult = (none, none, np.tile(self.mult, k)) if points is None else (points.xi, points.v, points.mult)
        head = self._eta, self._h_rate, self.proposed or 0.0, control.h_old, control.error_old, h
        return np.concatenate((head, q, v, xi.ravel(), vs.ravel(), mult.ravel()))

    def _prepare_room(self, room: Array, *, alone: bool) -> None:
        super()._prepare_room(room, alone=alone)
        if self._lent is None or self._lent.own is None:
            return
        assert self.proposed is not None
        own, norm, t, (limit, count) = self._lent.own, self.norm, self.state.t, self._ahead
        self.control.span = max(self.control.span, limit)
        own.lend(norm.q_size, norm.v_size, norm.deflections)
        own.c.until, own.c.worst = t + limit, 0.0
        own.c.last = t + (count - 1) * min(limit, self.proposed)  # whoever begins later passes what somebody waits for

    def _factored_for(self) -> float:
        return self._h_factor

    # -- what it leaves ---------------------------------------------------------------------------------------------
    def _take_march(self, march: March, made: int) -> None:
        super()._take_march(march, made)
        self._trouble = max(self._trouble - made, 0)
        if self._lent is not None and self._lent.own is not None:
            own, norm = self._lent.own, self.norm
            norm.q_size, norm.v_size, norm.deflections = own.told()
            self.local_error = float(own.c.worst)
            self.judge.solves += made  # of the estimates

    def _recall(self, kept: Array, factored: float) -> None:
        n, n_q, k = self.system.n_v, self.system.n_q, len(self.tab.c)
        head, q, v, *stages = np.split(kept, np.cumsum([6, n_q, n, k * n, k * n]))
        self._eta, self._h_rate, proposed, h_old, error_old, h = map(float, head)
        if self.adaptive:
            self.proposed, self.control.h_old, self.control.error_old = proposed, h_old, error_old
        xi, vs, mult = (x.reshape(k, -1) for x in stages)
        W = self.tab.W / h
        self._last = h, q, v, Points(xi, W @ xi, vs, W @ (vs - v), mult)
        self.mult, self._h_factor, self._filter = mult[-1], factored, None
