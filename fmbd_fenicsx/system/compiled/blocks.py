"""Blocks of states as the driver keeps them: t, q, v, a, the algorithmic acceleration A, lambda, and what a scheme keeps of its
own beside; and rings of a few of them.

A march writes each new state over the oldest of a ring and notes the order by addresses, so that nothing is copied.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...kernel_cache import address_of
from ...rotations import Array
from ..layout import State
from ..system import System

Block = tuple[float, Array, Array, Array, Array, Array]  # t, q, v, a, A, lambda


def block_size(system: System) -> int:
    """Numbers in a block."""
    return 1 + system.n_q + 3 * system.n_v + system.n_lam


def split_block(system: System, block: Array) -> Block:
    """The parts of a block, views."""
    n, at = system.n_v, 1 + system.n_q
    v, a, A = [block[at + i * n : at + (i + 1) * n] for i in range(3)]
    end = at + 3 * n
    return float(block[0]), block[1:at], v, a, A, block[end : end + system.n_lam]


def state_of(system: System, block: Array) -> State:
    """The state in a block, its own arrays."""
    t, q, v, a, _, lam = split_block(system, block.copy())
    return State(t, q, v, a, lam)


class Ring:
    """So many blocks in turn, the newest first, each with so many numbers of a scheme's ``own``."""

    def __init__(self, system: System, count: int, own: int = 0) -> None:
        self.system, self._size, self.width = system, block_size(system), own
        self.blocks = np.zeros((count, self._size + own))
        self._places = np.array([address_of(x) for x in self.blocks], dtype=np.uintp)
        self._order = self._places.copy()
        self.address = address_of(self._order)  # for C

    def load(self, states: Sequence[Block]) -> None:
        """Take the last states, the newest first, in the first blocks."""
        for block, (t, *arrays) in zip(self.blocks, states, strict=False):
            np.concatenate(([t], *arrays), out=block[: self._size])
        self._order[:] = self._places

    def block(self, i: int) -> Block:
        """The i-th newest, a copy."""
        return split_block(self.system, self._newest(i).copy())

    def state(self, i: int = 0) -> State:
        """The i-th newest."""
        return state_of(self.system, self._newest(i))

    def own(self, i: int = 0) -> Array:
        """What the scheme keeps with the i-th newest, as it stands there."""
        return self._newest(i)[self._size :]

    def _newest(self, i: int) -> Array:
        """The i-th newest as it stands in the ring."""
        offset = int(self._order[i]) - int(self._places[0])
        found: Array = self.blocks[offset // self.blocks.strides[0]]
        return found
