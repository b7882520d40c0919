"""The stretch of time up to the next point that must be hit, in nested parts: 1, 2, 6, 12, 36, ... of them.

Every step is one of these parts, begun at a multiple of its own size. So the end of the stretch is hit without a step of another
size, and there are fewer than three sizes, and with them elastic factors, in a decade.
"""

from __future__ import annotations

from fractions import Fraction
from typing import ClassVar

from ....system.compiled.declarations import constants, enumeration
from ....system.serialisation import Memory, Remembering, plain

# levels of parts, the finest are below roundoff; by what share lengths of a stretch that are equal may differ; how many times its
# length a step is held for too long in which M is lost beside s K
DEEPEST = enumeration("DEEPEST", "marches/control.c")["DEEPEST"]
SAME, HELD = constants("marches/control.c", "SAME_SIZE", "LOST_FOR")


def parts(level: int) -> int:
    """Number of parts of a stretch: 1, 2, 6, 12, 36, ..."""
    return int(6 ** (level // 2) * (2 if level % 2 else 1))


def _keep_share(m: Memory, name: str, share: Fraction) -> Fraction:
    """An exact share."""
    above, below = m(name, (share.numerator, share.denominator))
    return Fraction(int(above), int(below))


class Stretch(Remembering):
    """Length and end (s), and the share of it that is done."""

    keeps: ClassVar = {**dict.fromkeys(("length", "end", "lost"), plain()), "done": _keep_share}

    def __init__(self) -> None:
        self.length, self.done, self.end = 0.0, Fraction(0), 0.0
        self.lost: tuple[float, float] | None = None  # size of a step in which M is lost beside s K, and until when, s

    def forget(self) -> None:
        """The next step begins a new one."""
        self.length, self.done = 0.0, Fraction(0)

    def follow(self, t: float, left: float) -> None:
        """Begin a new stretch where the last one has ended, or where an earlier end is asked for. So steps with a limit, for
        which what is left is always the same, are parts of one stretch after another.
        """
        if self.done < 1 and self.length > 0 and self.end - t <= left + SAME * self.length:
            return
        if abs(self.length - left) > SAME * left:  # else its factors serve again
            self.length = left
        self.done, self.end = Fraction(0), t + left

    def go_on(self, level: int) -> None:
        """A part of a level is done."""
        self.done += Fraction(1, parts(level))

    def more(self, until: float) -> int:
        """How many such stretches may follow up to a time, s."""
        return max(int((until - self.end) / self.length * (1 + SAME) + SAME), 0)

    def size(self, level: int) -> float:
        """Of the parts of a level, s."""
        return self.length / parts(level)

    def coarsest(self, wanted: float, t: float) -> int:
        """The level of the coarsest parts that are no larger than a step wanted, and of which one begins at the time t (s)."""
        for level in range(DEEPEST):
            size = self.size(level)
            if size <= wanted and not self.loses(size, t) and (self.done * parts(level)).denominator == 1:
                return level
        return DEEPEST

    def time(self, done: Fraction) -> float:
        """When so large a share is done, s."""
        return self.end if done == 1 else self.end - self.length * float(1 - done)

    def loses(self, h: float, t: float) -> bool:
        """Whether M is known to be lost beside s K in a step of size h (s) at the time t (s); its factor need not be tried."""
        return self.lost is not None and h >= self.lost[0] * (1 - SAME) and t < self.lost[1]

    def lose(self, h: float, t: float) -> None:
        """M is lost beside s K in a step of size h (s) at the time t (s), and with it the motion of a free body."""
        self.lost = h, t + HELD * h
