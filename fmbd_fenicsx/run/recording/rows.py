"""Records of one quantity, one after another."""

from __future__ import annotations

import numpy as np

from ...rotations import Array

MOST = 1_000_000  # records that room is made for before they are there: a run may be meant to stop at an event


class Rows(list[Array]):
    """The newest records as pieces (k, ..) that are appended; :meth:`joined` moves them into one array.

    That has room for all records of a run, up to a million, from the start, where their number is known: fresh memory
    costs more than what is written to it, and is taken once.
    """

    room: Array = np.zeros(0)
    filled = 0

    def joined(self, expected: int = 0) -> Array:
        """All records, (n, ..), of ``expected`` in the end; later ones are written behind them."""
        if self:
            first, self.filled = self.filled, self.filled + sum(map(len, self))
            if self.filled > len(self.room):
                old = self.room
                self.room = np.empty((max(min(expected, MOST), self.filled, 2 * len(old)), *self[0].shape[1:]))
                self.room[:first] = old[:first] if first else 0.0
            np.concatenate(self, out=self.room[first : self.filled])
            self.clear()
        return self.room[: self.filled]
