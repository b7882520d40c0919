"""Which order and size the next step of BDF has, under error control (driver/implicit/bdf.c has the same rules).

Growths of a step are bounded, and those that pay little are not taken: factors, and the memory of equal steps, are worth more.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from ...linear.condensation import StepSolver
from ...system.layout import State
from ...system.serialisation import Remembering, plain, worker
from ..control import growth_factor
from .amplification import STABLE, Amplification

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


class OrderChoice(Remembering):
    """The order ``k``, of at most ``highest``, and for how many steps it was ``held`` with one size; ``taken``: the sum of those
    of all steps.
    """

    keeps: ClassVar = {**dict.fromkeys(("k", "held", "taken"), plain()), "amplification": worker}

    def __init__(self, solver: StepSolver, highest: int) -> None:
        self.amplification = Amplification(solver)
        self.highest = highest
        self.k, self.held, self.taken = 1, 0, 0

    def begin(self, k: int) -> None:
        """Without a past."""
        self.k, self.held = k, 0
        self.amplification.forget()

    def look(self, state: State) -> None:
        """Take notice of vibrations about the state, which the next order must not amplify, if that is due; collective."""
        if self.highest > STABLE:
            self.amplification.look(min(self.k + 1, self.highest), state)

    def refused(self, rejections: int) -> None:
        """A step is refused, for that many times: after several a lower order is taken, whose past is shorter."""
        self.held = 0
        if rejections > 5:
            self.k = 1
        elif rejections > 2:
            self.k = max(1, self.k - 1)

    def next_size(self, h: float, error: float, errors: Callable[[int], float], values: int) -> float:
        """The size (s) of the step after one of size h with this error; sets its order. Changes only after k + 1 steps of one
        size and order. ``errors``: of that step if it had another order; ``values``: how many are known before it.
        """
        self.held += 1
        stay = growth_of(error, self.k)
        calm, pays = CALM
        if self.held <= self.k and stay > calm:
            return h

        order, best = self._best(h, stay, errors, values)
        if order == self.k and calm <= best <= pays:
            return h
        self.k, self.held = order, 0
        return h * within(best)

    def size_after_refusals(self, h: float, error: float) -> float:
        """The same of a step that was made at last, after larger ones had failed: not longer, with an order that is stable with
        it.
        """
        h *= min(growth_of(error, self.k), 1.0)
        self.held = 0
        if not self.amplification.permits(self.k, h):
            self.k = STABLE
        return h

    def _best(self, h: float, stay: float, errors: Callable[[int], float], values: int) -> tuple[int, float]:
        """The order with the longest stable step, one more or less at most, and its growth; ``stay``: that of the same order."""
        k = self.k
        order, best = k, stay
        if k > 1:
            lower = growth_of(errors(k - 1), k - 1)
            if lower > LOWER * best:
                order, best = k - 1, lower
        if k < self.highest and values >= k + 2:
            higher = growth_of(errors(k + 1), k + 1)
            if higher > HIGHER * best:
                order, best = k + 1, higher

        # orders above two amplify vibrations that the step does not resolve
        while not self.amplification.permits(order, h * within(best)):
            order -= 1
            best = growth_of(errors(order), order)
        return order, best
