"""What steps of Radau by calls of compiled code begin with and leave (driver/implicit/radau.c)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...rotations import Array
from ...system.compiled.implicit import WORK, ImplicitRoom
from ...system.compiled.march import March
from ...system.compiled.own_steps import OwnRoom
from ...system.compiled.states.convergence import Convergence
from ...system.compiled.states.stages import StageRule
from ...system.layout import States
from ..dae import Points
from ..implicit.convergence import Rates
from ..implicit.implicit_stepper import ImplicitStepper
from .collocation import Tableau

if TYPE_CHECKING:
    from ...system.compiled.kept import KeptSteps

LONGER = 1.2  # steps so much longer than that of a rate do not rely on it
LEAST_SHARE = 1e-3  # that one increment is trusted to leave of the error
RATES = {
    True: Rates(limit=0.99, before=10.0, averaged=True, foresees=True),
    # with constant steps the first rate flatters: fast components go first
    False: Rates(limit=0.99, before=10.0, averaged=True, least=0.05),
}  # with error control, and with constant steps


class StageMarch(ImplicitStepper):
    """What a march of :class:`.Radau` begins with and leaves."""

    maker = "RADAU"
    slow = 1e-2
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

    # -- what a march begins with -----------------------------------------------------------------------------------
    def _lend(self) -> ImplicitRoom:
        tab = self.tab
        coefficients = {name: getattr(tab, name) for name in ("c", "W", "values", "middle", "basis", "stage_basis")}
        stages = self.eq.room(len(tab.values), len(tab.c))
        own = None
        if self.adaptive:
            own = self._own_room(
                error=tab.error, places=0 in self.scheme.form.levels, turning=self.turning,
                most=2.0 * self.newton.max_iterations, **self.eq.size_grid,
            )  # fmt: skip
        room = ImplicitRoom(stages, coefficients, own=own)
        room.c.longer, room.c.least_share = LONGER, LEAST_SHARE
        return room

    def _settings(self) -> tuple[Convergence, StageRule]:
        tab = self.tab
        return self._convergence(0.0, RATES[self.adaptive], 1.0), StageRule(tab.W, tab.inverse, tab.vectors)

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
        return self.tab.frequencies(h)

    def _solved_for(self, h: float) -> Array:
        return self._frequencies(h)

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
        head, (q, v), points = self._told(kept)
        self._eta, self._h_rate, proposed, h_old, error_old, h = map(float, head)
        if self.adaptive:
            self.proposed, self.control.h_old, self.control.error_old = proposed, h_old, error_old
        self._last, self.mult = (h, q, v, points), points.mult[-1]
        self._h_factor, self._filter = factored, None

    def _told(self, kept: Array) -> tuple[Array, tuple[Array, Array], Points]:
        """Numbers, q and v at the beginning of a step, and its stages, of what its end keeps; of many likewise."""
        assert self._lent is not None
        twin, k = self._twin, len(self.tab.c)
        n, n_q = self._lent.stages.c.n, twin.system.n_q
        head, q, v, *stages = np.split(kept, np.cumsum([6, n_q, n, k * n, k * n]), axis=-1)
        xi, vs, mult = (x.reshape(*kept.shape[:-1], k, -1) for x in stages)
        q, (v, xi, vs) = twin.places(q), map(twin.forces, (v, xi, vs))
        W = self.tab.W / head[..., -1:, None]
        return head, (q, v), Points(xi, W @ xi, vs, W @ (vs - v[..., None, :]), mult)

    # -- states within steps ----------------------------------------------------------------------------------------
    def within(self, steps: KeptSteps) -> States:
        """As :meth:`TimeStepper.within`."""
        head, start, points = self._told(steps.own[:, WORK:])
        h, x = head[:, -1], 1.0 - (steps.after.t - steps.t)[:, 0] / head[:, -1]
        return self._all_held(h, States(steps.t, *self._polynomial(x, h, start, points)))

    def _polynomial(
        self, x: Array, h: Array, start: tuple[Array, Array], points: Points
    ) -> tuple[Array, Array, Array, Array]:
        """q, v, a and lambda at the share x of a step of size h (s) from q and v; of many steps with these as first axis."""
        tab, k, (q, v) = self.tab, len(self.tab.c), start

        # values and slopes of the polynomial through the start and the stages
        powers = x[..., None] ** np.arange(k + 1)
        slopes = np.arange(k + 1) * np.roll(powers, 1, axis=-1) / h[..., None]
        values, rates = ((y @ tab.basis)[..., None, 1:] for y in (powers, slopes))

        change = points.v - v[..., None, :]
        lam = (powers[..., None, :-1] @ tab.stage_basis @ points.mult)[..., 0, : self.system.n_lam]
        q = self.system.compose(q, (values @ points.xi)[..., 0, :])
        return q, v + (values @ change)[..., 0, :], (rates @ change)[..., 0, :], lam
