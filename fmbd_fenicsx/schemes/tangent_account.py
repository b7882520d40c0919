"""What tangents of elastic fields have cost in steps, and when new ones are worth their price.

A new tangent costs as much as 40 increments of :class:`.GeneralizedAlpha` (its matrix and factor, on meshes of 8 to 900
hexahedra), or 8 of :class:`.EnergyMomentum`, whose increments are dearer. So one is kept as long as steps end with it, until
increments beyond the fewest of a step since it was taken have paid for another (as in ski rental: at most twice the least cost;
Karlin et al., doi:10.1007/BF01762111). Where new ones never help, as beside vibrations that steps do not resolve, the fewest
stay many, and nothing is paid in. Tangents that take no factor cost a few back-solves, and absolute bodies with a stored energy
are thrown far by old ones (a soft frame takes 162 increments in 20 steps, and 128 by new ones): these come as soon as a step
asks for them.
"""

from __future__ import annotations

from typing import ClassVar

from ..system.compiled.declarations import enumeration
from ..system.serialisation import Remembering, plain

SELDOM = enumeration("SELDOM", "onestep/alpha.c")["SELDOM"]  # steps in a row that begin with new ones at most
# increments that a step takes at least, where nothing is known yet
FEW = enumeration("QUICK", "onestep/alpha.c")["QUICK"]


class TangentAccount(Remembering):
    """Of one run; C keeps it in steps of its own (``settle`` of ``onestep/alpha.c``).

    ``numbers``, as the parameters of C: increments of the shortest step since new tangents were taken, 0: there was none; those
    beyond, that are wasted; steps that are made otherwise, as tangents of other steps did not serve: those of generalized-alpha
    begin with their own, those of energy-momentum do without; how many of these come before one is tried as usual: 1, 3, 7 ..
    """

    keeps: ClassVar = {"numbers": plain()}

    def __init__(self) -> None:
        self.numbers = [float(FEW), 0.0, 0.0, 0.0]

    @property
    def otherwise(self) -> bool:
        """Whether the next step is one of these."""
        return self.numbers[2] > 0.0

    def wasted_by(self, made: float) -> float:
        """Increments that are wasted with those of a step that would take so many."""
        fewest, wasted, *_ = self.numbers
        return wasted + (max(made - fewest, 0.0) if fewest else 0.0)

    def failed(self) -> None:
        """Tangents of other steps do not serve this one: it, and some more, are made otherwise."""
        fewest, wasted, _, wait = self.numbers
        wait = min(2.0 * wait + 1.0, SELDOM)
        self.numbers = [fewest, wasted, wait + 1.0, wait]

    def pass_by(self) -> None:
        """A step was made otherwise."""
        self.numbers[2] = max(self.numbers[2] - 1.0, 0.0)

    def take(self, made: int, *, renewed: bool) -> None:
        """A step was made by so many increments; ``renewed``: by new tangents."""
        fewest, wasted, otherwise, wait = self.numbers
        if renewed:
            self.numbers = [0.0, 0.0, otherwise, wait]
            return
        fewest = min(fewest or made, float(made))
        self.numbers = [fewest, wasted + made - fewest, otherwise, 0.0]

    def settle(self, made: int, renewed: int) -> None:
        """A step of generalized-alpha took so many increments and new tangents."""
        if renewed and not self.otherwise and (not self.numbers[0] or renewed > 1):
            self.failed()
        if renewed < 2 and made <= FEW:
            self.pass_by()
        self.take(made, renewed=renewed > 0)
