"""What the increments of a step tell of the terms that its tangent leaves out: gyroscopic and centrifugal ones, turned reactions.

With P the matrix of the :class:`.StepSolver` and J the derivative of the residual r, f = -P^-1 r is the increment of the tangent.
One that was made, s, changed it from f_old to f: P^-1 J s = f_old - f, without an evaluation of its own. Of earlier increments
combinations p_i have images d_i = P^-1 J p_i that are orthonormal as lengths; the next increment is

    s = f + sum_i (d_i . f) (p_i - d_i)                                                                      (1)

exact in their span, the tangent's beyond it: GMRES on the exact tangent, an iteration for each increment of Newton's.

Sources: Anderson, doi:10.1145/321296.321305; Walker and Ni, doi:10.1137/10078356X.
"""

from __future__ import annotations

import numpy as np

from ....rotations import Array
from ....system.compiled.declarations import constants, enumeration
from ....system.system import System

# an increment of the tangent, over the one made before, above which (1) is taken; share of an image that the earlier ones do not
# have, below which it tells nothing
POOR, ALIKE = constants("onestep/secants.c", "POOR", "ALIKE")
# pairs at most; those without which the rate tells nothing
DEPTH, LEARNT = enumeration("PAIRS", "onestep/secants.c").values()


class Secants:
    """The pairs (p_i, d_i) of one step; methods are collective.

    An increment is one array: blocks like v, to be compared as lengths, then multipliers.
    """

    def __init__(self, system: System) -> None:
        self.system = system
        self.forget()

    def forget(self) -> None:
        """Begin anew: the tangent is another one."""
        self.poor = False
        self.pairs: list[tuple[Array, Array]] = []  # p_i, d_i
        self._last: tuple[Array, Array] | None = None  # the tangent's newest increment, and the one that was made
        self._made = 0.0  # its length

    @property
    def learning(self) -> bool:
        """Whether (1) is in use, but has seen little yet."""
        return self.poor and len(self.pairs) < LEARNT

    def improved(self, f: Array, blocks: int) -> Array:
        """(1) for the tangent's increment with so many blocks like v."""
        size = self._size(f, blocks)
        self.poor = self.poor or (self._last is not None and size > POOR * self._made)
        s = f
        if self.poor and self._last is not None:
            before, made = self._last
            self._learn(made, before - f, blocks)
            for p, d in self.pairs:
                s = s + self._dot(d, f, blocks) * (p - d)
            size = self._size(s, blocks)
        self._last, self._made = (f, s), size
        return s

    def _learn(self, p: Array, d: Array, blocks: int) -> None:
        """One more pair, its image made orthonormal to those of the others."""
        if len(self.pairs) == DEPTH:
            self.pairs = []
        whole = np.sqrt(self._dot(d, d, blocks))
        for p_i, d_i in self.pairs:
            share = self._dot(d_i, d, blocks)
            p, d = p - share * p_i, d - share * d_i
        size = np.sqrt(self._dot(d, d, blocks))
        if ALIKE * whole < size < np.inf:
            self.pairs.append((p / size, d / size))

    def _blocks(self, x: Array, blocks: int) -> Array:
        """The blocks like v as lengths, (blocks, n_v)."""
        return self.system.units * x[: blocks * self.system.n_v].reshape(blocks, -1)

    def _dot(self, x: Array, y: Array, blocks: int) -> float:
        a, b = self._blocks(x, blocks), self._blocks(y, blocks)
        return float(sum([self.system.dot(a[i], b[i]) for i in range(blocks)]))

    def _size(self, x: Array, blocks: int) -> float:
        parts = x[: blocks * self.system.n_v].reshape(blocks, -1)
        return max([self.system.max_abs(parts[i]) for i in range(blocks)])
