"""What steps of Radau by calls of compiled code begin with and leave (driver/radau.c)."""

from __future__ import annotations

import numpy as np

from ...rotations import Array
from ...system.compiled.implicit import ImplicitRoom
from ...system.compiled.march import March
from ...system.compiled.own_steps import OwnRoom
from ...system.compiled.states.convergence import Convergence
from ...system.compiled.states.stages import Rule
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
    slow, longer = 1e-2, LONGER
    tab: Tableau
    mult: Array  # at the end of the last step, (levels n_lam,)
    _last: tuple[float, Array, Array, Points] | None  # the last step: its size, q and v at its start, its stages
    _h_factor: float  # size of the step that the factor is for, s
    _eta: float  # what the last increment of the last step left, over its size
    _h_rate: float  # size of the step in which that was seen, s
    _filter: object  # of the error estimate, of the same tangent
    _trouble: int  # two for each failure of Newton's iteration, less one for each step

    # -- steps ------------------------------------------------------------------------------------------------------
    @property
    def turning(self) -> int:
        """By how much less than others steps may turn: many stages share one tangent that long."""
        return 2 if self.scheme.form.frozen or self.scheme.stages > 3 else 1

    @property
    def _chooses_alike(self) -> bool:
        # an even number of stages has no real factor that filters errors
        return self.scheme.stages % 2 == 1 and super()._chooses_alike

    # -- what a march begins with -----------------------------------------------------------------------------------
    def _lend(self) -> ImplicitRoom:
        tab = self.tab
        coefficients = {name: getattr(tab, name) for name in ("c", "W", "values", "middle", "basis", "stage_basis")}
        stages = self.eq.room(len(tab.values), len(tab.c))
        if not self.adaptive:
            return ImplicitRoom(stages, coefficients)
        own = self._own_room(
            error=tab.error, places=0 in self.scheme.form.levels, turning=self.turning, most=2.0 * self.newton.max_iterations,
            **self.eq.size_grid,
        )  # fmt: skip
        return ImplicitRoom(stages, coefficients, own=own)

    def _settings(self) -> tuple[Convergence, Rule]:
        tab = self.tab
        return self._convergence(0.0, RATES[self.adaptive], 1.0), Rule(tab.W, tab.inverse, tab.vectors)

    def _memory(self) -> Array:
        s, k, control, twin = self.state, len(self.tab.c), self.control, self._twin
        h, q, v, points = self._last or (0.0, s.q, s.v, None)
        none: Array = np.zeros((k, len(v)))
        xi, vs, mult = (none, none, np.tile(self.mult, k)) if points is None else (points.xi, points.v, points.mult)
        head = self._eta, self._h_rate, self.proposed or 0.0, control.h_old, control.error_old, h
        q, v, xi, vs = twin.configurations(q), *map(twin.velocities, (v, xi, vs))
        return np.concatenate((head, q, v, xi.ravel(), vs.ravel(), mult.ravel()))

    def _factored_for(self) -> float:
        return self._h_factor

    def _frequencies(self, h: float) -> Array:
        return self.tab.values / h

    def _lend_matrices(self, h: float) -> None:
        assert self._lent is not None
        self.eq.lend_matrices(self._lent.stages, self.state, self._frequencies(h))

    # -- what it leaves ---------------------------------------------------------------------------------------------
    def _take_march(self, march: March, made: int) -> None:
        super()._take_march(march, made)
        self._trouble = max(self._trouble - made, 0)

    def _take_own(self, own: OwnRoom, made: int) -> None:
        super()._take_own(own, made)
        self.judge.solves += made + int(own.c.refused)  # of the estimates

    def _recall(self, kept: Array, factored: float) -> None:
        assert self._lent is not None
        twin, k = self._twin, len(self.tab.c)
        n, n_q = self._lent.stages.c.n, twin.system.n_q
        head, q, v, *stages = np.split(kept, np.cumsum([6, n_q, n, k * n, k * n]))
        self._eta, self._h_rate, proposed, h_old, error_old, h = map(float, head)
        if self.adaptive:
            self.proposed, self.control.h_old, self.control.error_old = proposed, h_old, error_old
        each: list[Array] = [x.reshape(k, -1) for x in stages]
        q, mult = twin.places(q), each[2]
        v, xi, vs = map(twin.forces, (v, *each[:2]))
        W = self.tab.W / h
        self._last = h, q, v, Points(xi, W @ xi, vs, W @ (vs - v), mult)
        self.mult, self._h_factor, self._filter = mult[-1], factored, None
