"""When tangents of fields are worth being taken anew: as soon as the increments that old ones cost have paid for new ones."""

from __future__ import annotations

from typing import ClassVar

from ....system.serialisation import Remembering, plain

WORTH = 8  # increments of a step that cost what new tangents do: their matrices, factors and columns
SELDOM = 15  # steps between two trials at most
FEW = 3  # increments that a step takes at least


class TangentAge(Remembering):
    """What tangents have cost so far: increments of steps beyond the fewest that were enough since they were taken.

    Where they do not serve steps at all, as for those that turn bodies far, they are tried more and more seldom: after 1, 2, 4 ..
    further ``steps``.
    """

    keeps: ClassVar = dict.fromkeys(("fewest", "lost", "steps", "wait"), plain())

    def __init__(self) -> None:
        self.fewest, self.lost = FEW, 0
        self.steps = self.wait = 0

    @property
    def due(self) -> bool:
        """Whether new ones are worth it."""
        return self.lost >= WORTH

    @property
    def apart(self) -> bool:
        """Whether the next step does without them."""
        return self.steps > 0

    def failed(self) -> None:
        """They did not serve a step."""
        self.wait = min(2 * self.wait + 1, SELDOM)
        self.steps = self.wait + 1

    def pass_by(self) -> None:
        """A step was made without them."""
        self.steps = max(self.steps - 1, 0)

    def take(self, increments: int, *, renewed: bool) -> None:
        """A step with so many increments; ``renewed``: by tangents taken in it, which are as good as they can be."""
        self.wait = 0
        if renewed:
            self.fewest, self.lost = increments, 0
        self.lost += max(increments - self.fewest, 0)
