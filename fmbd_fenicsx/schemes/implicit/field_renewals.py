"""When implicit steps take new tangents of elastic fields: where these save increments.

A tangent serves as long as steps need hardly more increments than one with a new tangent did. What a tangent of one motion
leaves out (gyroscopic terms, the turning of parts against each other within a step) a new one leaves out, too: such increments
ask for none. Nor do those that the factors of another frequency leave: steps are compared with others of the same correction
(``relax``). Compiled code does the same (``driver/implicit/field_stages.c``), in whole steps.
"""

from __future__ import annotations

from typing import ClassVar

from ...linear.frequency_solvers import SAME
from ...mechanics.placements import Approach
from ...rotations import Array
from ...system.compiled.declarations import enumeration
from ...system.compiled.states.field_stages import FieldStageRoom
from ...system.evaluation import Evaluation
from ...system.serialisation import Remembering, plain
from ...system.system import System

COUNTS = enumeration("MANY", "implicit/field_stages.c")
MANY, MORE = COUNTS["MANY"], COUNTS["MORE"]


class FieldRenewals(Remembering):
    """Of one run. ``due``: whether the step begins with new tangents."""

    keeps: ClassVar = dict.fromkeys(
        ("due", "_increments", "_fewest", "_new", "_relax", "_relaxed", "_vain", "_failed"), plain()
    )

    def __init__(self, system: System) -> None:
        self.system = system
        self.fields = [k for k, part in system.fields if part.renewable]
        self.due = False
        self._increments = 0  # of the step
        self._fewest = 0  # of a step since the newest tangents, or since another correction
        self._relax = self._relaxed = 1.0  # corrections of the step, and of the one before
        self._new = False  # whether the step has taken new ones
        self._vain = False  # whether a step failed with the newest ones, too
        self._failed = False  # whether the step has failed with older ones

    def begin(self) -> None:
        """Begin a step from another state than the last one."""
        if made := self._increments:
            other = abs(self._relax - self._relaxed) > SAME
            self._fewest = made if self._new or other else min(self._fewest, made)
            self._relaxed = self._relax
            self.due = made > max(MANY, self._fewest + MORE)
        self._increments, self._new, self._failed = 0, False, False

    def begin_again(self) -> None:
        """Begin one from the same state."""
        self._increments = 0

    def count(self, increments: int, relax: float) -> None:
        """Take note of so many increments, corrected by ``relax``."""
        self._increments += increments
        self._relax = relax

    def ask(self, *, again: bool = False) -> bool:
        """Whether a step that has failed may be tried with new tangents, which it takes then; ``again``: several times.

        Where the newest ones came in vain, steps are too long for any: a smaller one that fails, too, asks for the next ones.
        """
        self._vain |= self._new
        too_long = self._vain and not self._failed
        self._failed |= not self._new
        self.due = bool(self.fields) and (again or not (self._new or too_long))
        return self.due

    def take(self, ev: Evaluation, origin: Array) -> None:
        """New tangents where derivatives are taken in a step that begins at q = ``origin``, if they are due; collective."""
        if self.due and self.fields:
            self.take_predicted(ev, origin)
            self.due, self._new, self._vain = False, True, False

    def take_predicted(self, ev: Evaluation, origin: Array) -> None:
        """The same, due or not."""
        s = self.system
        led = [k for k, part in s.fields if part.begins_anew or part.stiffens]
        ev.take_tangents(
            self.fields, {k: Approach(s.local_q(ev.q, k) - s.local_q(origin, k), predicted=True) for k in led}
        )

    def lend(self, room: FieldStageRoom) -> None:
        """Let compiled code go on."""
        c = room.fields
        c.renewable, c.outworn, c.fewest, c.renewed = bool(self.fields), self.due, self._fewest, 0
        c.relaxed, c.vain, c.failed = self._relaxed, self._vain, 0

    def follow(self, room: FieldStageRoom) -> None:
        """Go on behind steps of compiled code."""
        c = room.fields
        self.due, self._vain = bool(c.outworn), bool(c.vain)
        self._fewest, self._relaxed = int(c.fewest), float(c.relaxed)

    def tried(self, room: FieldStageRoom) -> None:
        """Take notice of what compiled code has tried in a step that is to be made in parts."""
        c = room.fields
        self.due, self._new, self._vain, self._failed = False, bool(c.renewed), bool(c.vain), bool(c.failed)
