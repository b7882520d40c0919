"""What steps of BDF by calls of compiled code begin with and leave (driver/implicit/bdf.c); sizes and orders.

Growths of a step are bounded, and those that pay little are not taken: factors, and the memory of equal steps, are worth more.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...rotations import Array
from ...system.compiled.implicit import WORK, ImplicitRoom, OrdersOfBDF
from ...system.compiled.own_steps import OwnRoom
from ...system.compiled.states.convergence import Convergence
from ...system.compiled.states.stages import StageRule
from ...system.layout import States
from ..control import growth_factor
from ..implicit.convergence import Rates
from ..implicit.implicit_stepper import ImplicitStepper
from .amplification import Amplification
from .past import Past, all_weights, increments, slopes, slopes_at_first

if TYPE_CHECKING:
    from ...system.compiled.kept import KeptSteps

ALONE = np.eye(1)  # one point is coupled with none
RATES = Rates(limit=0.95, largest=2.0)
SLOW = 0.2  # rate above which the next step takes a tangent, with error control
NEAR = 0.8, 1.25  # frequencies over that of a factor with which it serves on, with error control

SAFETY, LEAST = 0.85, 1e-8  # of the growth of a step; least error
WITHIN = 0.3, 2.0  # of growths
CALM = 0.9, 1.2  # growths that are not taken
LOWER, HIGHER = 1.05, 1.1  # by how much more an order has to grow, one less or more than the present


def growth_of(error: float, order: int) -> float:
    """By how much a step with this error over the tolerance may grow."""
    return growth_factor(max(error, LEAST), order + 1, SAFETY)


def within(growth: float) -> float:
    """The growth within bounds."""
    least, most = WITHIN
    return min(max(growth, least), most)


class MultistepMarch(ImplicitStepper):
    """What a march of :class:`.BDF` begins with and leaves."""

    maker = "BDF"
    slow = 0.05
    past: list[Past]  # newest first
    amplification: Amplification
    highest: int  # order
    k: int  # the order, and for how many steps it was
    held: int  # held with one size
    _starter: Any

    # -- steps ------------------------------------------------------------------------------------------------------
    @property
    def _starting(self) -> bool:
        """Whether a Radau method makes the next constant step."""
        return self._starter is not None and len(self.past) < self.scheme.order

    @property
    def _next_order(self) -> int:
        """The highest order that the next step may be followed by."""
        return min(self.k + 1, self.highest)

    def stride(self, h: float) -> float:
        """As :meth:`TimeStepper.stride`."""
        return float(self._starter.stride(h)) if self._starting else super().stride(h)

    def _in_one_call(self, h: float) -> bool:
        return not self._starting and len(self.past) > 1 and super()._in_one_call(h)

    # -- what a march begins with -----------------------------------------------------------------------------------
    def _lend(self) -> ImplicitRoom:
        stages, order = self.eq.room(1, 1), self.scheme.order
        if not self.adaptive:
            return ImplicitRoom(stages, {}, order)
        (shrink, grow), (keep, calm), (nearest, farthest) = WITHIN, CALM, NEAR
        orders = OrdersOfBDF(
            highest=self.highest, safety=SAFETY, least=LEAST, shrink=shrink, grow=grow, keep=keep, calm=calm,
            lower=LOWER, higher=HIGHER, nearest=nearest, farthest=farthest, **self.eq.frequency_grid,
        )  # fmt: skip
        return ImplicitRoom(stages, {}, order, own=self._own_room(orders=orders))

    def _settings(self) -> tuple[Convergence, StageRule]:
        return self._convergence(0.0, RATES, 1.0), StageRule(ALONE, ALONE, ALONE)

    def _memory(self) -> Array:
        (newest, *older), twin = self.past[: self.scheme.order + 1], self._twin
        values = np.zeros((self.scheme.order, 1 + twin.system.n_q + twin.system.n_v + len(newest.mult)))
        for row, x in zip(values, older, strict=False):
            np.concatenate(([x.t], twin.configurations(x.q), twin.velocities(x.v), x.mult), out=row)
        head = self.k, self.held, self.proposed or 0.0
        return np.concatenate((head, newest.mult, [len(older)], values.ravel()))

    def _factored_for(self) -> float:
        return float(self._pencil.s[0])

    def _frequencies(self, h: float) -> Array:
        times = self.state.t + h, *(x.t for x in self.past[: self.scheme.order])
        return slopes_at_first(np.array(times))[:1]

    def _lend_matrices(self, frequency: float) -> None:
        assert self._lent is not None
        if not self.adaptive:
            self.eq.expect(np.array([frequency]))
        self.eq.lend_matrices(self._lent.stages, self.state, np.array([frequency]))

    def _lend_own(self, own: OwnRoom) -> None:
        super()._lend_own(own)
        assert own.orders is not None
        known = self.amplification
        known.look(self._next_order, self.state)
        own.orders.lend(known.spans, known.uses, known.most)

    # -- what it leaves ---------------------------------------------------------------------------------------------
    def _take_own(self, own: OwnRoom, made: int) -> None:
        super()._take_own(own, made)
        assert own.orders is not None
        self.amplification.uses = int(own.orders.uses)

    def _recall(self, kept: Array, factored: float) -> None:
        s = self.state
        (k, held, proposed), mult, count, (t, q, v, mults) = self._told(kept)
        if self.adaptive:
            self.k, self.held, self.proposed = int(k), int(held), float(proposed)
        older = [Past(float(t[i]), q[i], v[i], mults[i]) for i in range(int(count[0]))]
        self.past = [Past(s.t, s.q, s.v, mult), *older]

    def _told(self, kept: Array) -> tuple[Array, Array, Array, tuple[Array, Array, Array, Array]]:
        """Numbers, multipliers, how many older values there are, and their t, q, v and multipliers, of what a state keeps; of
        many with these as first axis.
        """
        width, twin, lead = self.eq.n_mult, self._twin, kept.shape[:-1]
        head, mult, count, values = np.split(kept, np.cumsum([3, width, 1]), axis=-1)
        ends = np.cumsum([1, twin.system.n_q, twin.system.n_v])
        t, q, v, mults = np.split(values.reshape(*lead, self.scheme.order, -1), ends, axis=-1)
        return head, mult, count, (t[..., 0], twin.places(q), twin.forces(v), mults)

    # -- states within steps ----------------------------------------------------------------------------------------
    def within(self, steps: KeptSteps) -> States:
        """As :meth:`TimeStepper.within`: those of one order together."""
        h, (head, _, count, _) = steps.h[:, 0], self._told(steps.own[:, WORK:])  # whose ends are written over
        order = head[:, 0].astype(int) if self.adaptive else np.full(len(head), self.k)
        through, found = np.minimum(order, count[:, 0].astype(int)), steps.after
        for k in np.unique(through):
            which = through == k
            found.put(which, self._through(steps.chosen(which), int(k)))
        return self._all_held(h, found)

    def _through(self, steps: KeptSteps, k: int) -> States:
        """The same on the polynomials through the newest of k + 1 values."""
        end, (_, mult, _, older) = steps.after, self._told(steps.own[:, WORK:])
        newest = end.t[:, 0], end.q, end.v, mult
        t, q, v, mult = (np.concatenate((x[:, None], y[:, :k]), axis=1) for x, y in zip(newest, older, strict=True))
        xi = increments(self.system, np.broadcast_to(end.q[:, None], q.shape), (t, q, v))

        at = steps.t[:, 0]
        w, rates = all_weights(t, at)[:, None], slopes(t, at)[:, None]
        place = self.system.compose(end.q, (w @ xi)[:, 0])
        lam = (w @ mult)[:, 0, : self.system.n_lam]
        return States(steps.t, place, (w @ v)[:, 0], (rates @ v)[:, 0], lam)
