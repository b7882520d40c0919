"""Weights that turn everything into lengths: they make norms and guards independent of the system of units."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..mechanics.bodies.port_constraint import PortConstraint
from ..ranks import rank_max, rank_sum
from ..rotations import Array
from .layout import Layout

FITS = 1e-3  # of the model's length: a correction of places at the start above it is wrong input, not roundoff
SHUT = 5e-7  # of the model's length: a joint that is open by more ends a step


class Measured(Layout):
    """A layout whose arrays are measured as lengths."""

    @cached_property
    def units(self) -> Array:
        """What turns increments like v into lengths, (n_v,): rotations times the model's length, amplitudes of modes times what
        they displace.
        """
        m, n = self.motions, self.n_frames
        out = np.ones(self.n_v)
        out[: n * m.n_twist].reshape(n, m.n_twist)[:, m.dim :] = self.length
        for part, own in zip(self.parts, self.slices[1], strict=True):
            out[own] = part.lengths(self.length)
        return out

    @cached_property
    def row_units(self) -> Array:
        """What turns the values of constraints into lengths, (n_lam,): angles times the model's length.

        Frame conditions are moments of a body's mass: what they are per displacement or turn makes them lengths. Rows of a
        user's own count as they are.
        """
        return self._of_rows(self.length)

    @cached_property
    def in_lengths(self) -> np.ndarray:
        """Whether :attr:`row_units` makes lengths of rows, (n_lam,): equations of a user's own are in units of their own."""
        out = np.ones(self.n_lam, dtype=bool)
        for law, rows in self.port_constraints:
            out[rows] &= not isinstance(law, PortConstraint)
        return out

    @cached_property
    def multiplier_units(self) -> Array:
        """What multipliers are divided by to be compared as forces, (n_lam,).

        A moment M counts as the pair of forces M / L, with the model's length L between them, that could stand for it: of norm
        sqrt(2) M / L.
        """
        return self._of_rows(self.length / np.sqrt(2.0))

    def _of_rows(self, turn: float) -> Array:
        """For rows, (n_lam,): a radian as the length ``turn``."""
        out = np.ones(self.n_lam)
        for batch, rows in self.batches:
            out[rows] = batch.lengths(turn)

        for part, own in zip(self.parts, self.frame_rows, strict=True):
            out[own] = part.frame_lengths(turn)
        return out

    def max_abs(self, x: Array) -> float:
        """Largest entry of an array like v, all entries as lengths (see :attr:`units`); collective."""
        return self.largest(self.units * x)

    def largest(self, x: Array) -> float:
        """Largest entry of an array like v as they are; collective: a rank sees the nodes that it owns."""
        local = float(np.maximum.reduce(np.abs(x), axis=None, initial=0.0))
        return float(rank_max(self.comm, local)) if self.fields else local

    def each_max_abs(self, x: Array) -> Array:
        """:meth:`max_abs` of each of several arrays like v, (..., n_v) -> (...); collective."""
        local = np.abs(self.units * x).max(axis=-1, initial=0.0)
        return np.asarray(rank_max(self.comm, local)) if self.fields else local

    def typical(self, x: Array) -> float:
        """The largest entry of the core, or root mean square of a field that no frame carries, as lengths; collective."""
        return float(self.each_typical(x[None])[0])

    def each_typical(self, x: Array) -> Array:
        """:meth:`typical` of each of several arrays like v, (k, n_v) -> (k,); collective."""
        n = self.n_core
        sizes = np.abs(self.units[:n] * x[:, :n]).max(axis=1, initial=0.0)
        for k, p in self.fields:
            if p.frame == self.n_frames:
                y = x[:, self.slices[1][k]]
                *squares, count = rank_sum(self.comm, np.append((y * y).sum(1), y.shape[1]))
                sizes = np.maximum(sizes, np.sqrt(np.array(squares) / count))
        return sizes


def farthest(system: Layout, q: Array) -> float:
    """Largest coordinate of a frame in q, its angles as lengths, and of what is counted: places are known to eps times it, m."""
    m, at = system.motions, system.counted_angles
    frames = np.abs(q[: at.start].reshape(-1, m.n_pose))
    most = np.maximum.reduce
    place = float(most(frames[:, : m.dim], axis=None, initial=0.0))
    angle = float(most(frames[:, 2], initial=0.0)) if m.dim == 2 else 1.0
    counted = float(most(np.abs(q[at]), initial=0.0))
    return place + system.length * (angle + counted)
