"""Records of one quantity, one after another."""

from __future__ import annotations

import numpy as np

from ...kernel_cache import address_of
from ...rotations import Array

MOST = 1_000_000  # records that room is made for before they are there: a run may be meant to stop at an event


class StepNumbers(list[np.ndarray]):
    """Numbers of recorded steps, pieces that are appended behind those ``known``; :meth:`joined` makes them one array."""

    def __init__(self, known: np.ndarray) -> None:
        super().__init__()
        self.known = known

    def joined(self) -> np.ndarray:
        """All numbers, (n,)."""
        if self:
            self.known = np.concatenate((self.known, *self))
            self.clear()
        return self.known


class Records(list[Array]):
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
                self._grow(first, max(min(expected, MOST), self.filled), self[0].shape[1:])
            np.concatenate(self, out=self.room[first : self.filled])
            self.clear()
        return self.room[: self.filled]

    def end(self, more: int, expected: int, shape: tuple[int, ...]) -> int:
        """The address behind the last record, with room for so many of this shape; who writes them adds to ``filled``."""
        self.joined(expected)
        if self.filled + more > len(self.room):
            self._grow(self.filled, max(min(expected, MOST), self.filled + more), shape)
        return address_of(self.room) + self.filled * self.room.strides[0]

    def _grow(self, kept: int, least: int, shape: tuple[int, ...]) -> None:
        """Room for so many records at least, of which some are kept."""
        old = self.room
        self.room = np.empty((max(least, 2 * len(old)), *shape))
        if kept:
            self.room[:kept] = old[:kept]
