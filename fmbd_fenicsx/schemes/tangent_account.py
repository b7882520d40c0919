"""What tangents of elastic fields have cost in steps of :class:`.GeneralizedAlpha`, and when new ones are worth their price.

A new tangent costs as much as 40 increments (its matrix and factor, on meshes of 8 to 900 hexahedra), so one is kept as long as
steps end with it, until increments beyond the fewest of a step since it was taken have paid for another (as in ski rental: at
most twice the least cost; Karlin et al., doi:10.1007/BF01762111). Where new ones never help, as beside vibrations that steps do
not resolve, the fewest stay many, and nothing is paid in.
"""

from __future__ import annotations

from typing import ClassVar

from ..system.compiled.declarations import enumeration
from ..system.serialisation import Remembering, plain

SELDOM = enumeration("SELDOM", "onestep/alpha.c")["SELDOM"]  # steps in a row that begin with new ones at most
FEW = 3.0  # increments that a step takes at least, where nothing is known yet


class TangentAccount(Remembering):
    """Of one run; C keeps it in steps of its own (``settle`` of ``onestep/alpha.c``).

    ``fewest``: increments of a step since new tangents were taken, 0: there was none; ``wasted``: those beyond; ``anew``: steps
    that begin with new ones, as those of a step did not serve the next one: 1, 3, 7 .. (``wait``) before one is tried without.
    """

    keeps: ClassVar = dict.fromkeys(("fewest", "wasted", "anew", "wait"), plain())

    def __init__(self) -> None:
        self.numbers = [FEW, 0.0, 0.0, 0.0]

    @property
    def numbers(self) -> list[float]:
        """All of it, in the order of the parameters of C."""
        return [self.fewest, self.wasted, self.anew, self.wait]

    @numbers.setter
    def numbers(self, values: list[float]) -> None:
        self.fewest, self.wasted, self.anew, self.wait = map(float, values)

    def wasted_by(self, made: float) -> float:
        """Increments that are wasted with those of a step that would take so many."""
        return self.wasted + (max(made - self.fewest, 0.0) if self.fewest else 0.0)

    def begin_anew(self) -> None:
        """Tangents of one step do not serve the next: this one, and some more, begin with their own."""
        self.wait = min(2.0 * self.wait + 1.0, SELDOM)
        self.anew = self.wait + 1.0

    def settle(self, made: int, renewed: int) -> None:
        """A step took so many increments and new tangents."""
        if not renewed:
            self.wait = 0.0
        elif not self.anew and (not self.fewest or renewed > 1):
            self.begin_anew()
        if renewed < 2 and made <= FEW:
            self.anew = max(self.anew - 1.0, 0.0)
        self.fewest = 0.0 if renewed else min(self.fewest or made, float(made))
        self.wasted = 0.0 if renewed else self.wasted + made - self.fewest
