"""Items of one kind on pairs of markers: coordinates, rows, rates and tangents of all of them in one call.

The numbers come from the kernels that were derived from the kind's definition (:mod:`.derivation`): compiled where there is a
compiler, else by NumPy. Every scheme evaluates joints and forces through here, or gives the same kernels to the compiled
driver.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from ...kernel_cache import address_of
from ...rotations import Array, Motions
from ..frames import Kinematics
from .derivation import Kind
from .library import kernel


class KindItems:
    """Items of a kind between markers a and b, (n,) each; ``constants`` by name, (n, size), in the axes of the markers."""

    def __init__(self, motions: Motions, kind: Kind, a: Any, b: Any, constants: dict[str, Array]) -> None:
        self.motions, self.kind = motions, kind
        self.pair: np.ndarray = np.array((a, b), dtype=np.int32).T.copy().reshape(-1, 2)
        self.constants = constants
        self.width = motions.dim + motions.n_rot

    def __len__(self) -> int:
        return len(self.pair)

    # compiled code has tables of its own: these are made where items are evaluated here
    @cached_property
    def entries(self) -> np.ndarray:
        """Which twist components the row has."""
        return np.array(self.kind.entries, dtype=int)

    @cached_property
    def addresses(self) -> tuple[int, int]:
        """Of the pairs and of the table, for C."""
        return address_of(self.pair), address_of(self.table)

    @cached_property
    def table(self) -> Array:
        """All constants, (n, width); markers are frames, so points are their origins and turns are none."""
        kind, n = self.kind, len(self.pair)
        out = np.zeros((n, kind.width))
        known = dict.fromkeys(("turn_a", "turn_b"), np.eye(kind.dim).ravel()) | self.constants
        for name in kind.constants:
            if name in known:
                out[:, kind.place(name)] = np.reshape(known[name], (-1, kind.constants[name]))
        return out

    @property
    def turns_only(self) -> bool:
        """Whether the kind depends on rotations alone."""
        return all(i % self.width >= self.motions.dim for i in self.kind.entries)

    @property
    def turning(self) -> np.ndarray:
        """Which items act on the rotations of their markers a and b, (n, 2): looked at in two frames of no special place. What
        functions of numbers do is not known.
        """
        n, m = len(self), self.motions
        rows = np.zeros((n, 2, self.width))
        if not self.kind.asked:
            a, b = (np.tile(frame, (n, 1)) for frame in _frames_anywhere(m))
            with np.errstate(all="ignore"):
                rows.reshape(n, -1)[:, self.entries] = self.kind.run("value", a, b, self.table)[:, 1:]
        moments = np.nan_to_num(rows[:, :, m.dim :])
        return np.asarray((moments != 0.0).any(axis=2))

    def constant(self, name: str) -> Array:
        """The columns of a constant, a view."""
        return self.table[:, self.kind.place(name)]

    def _run(self, which: str, frames: Array, weight: Array | None = None) -> Array:
        """One kernel, (n, outputs)."""
        compiled, n = None if self.kind.asked else kernel(self.kind, which), len(self)
        if compiled is None or not n:
            A = frames[self.pair[:, 0]]
            B = frames[self.pair[:, 1]]
            return self.kind.run(which, A, B, self.table, 1.0 if weight is None else weight)

        out = np.empty((n, len(self.kind.outputs[which])))
        at = None if weight is None else address_of(weight)
        pair, table = self.addresses
        compiled(n, pair, address_of(frames), table, at, address_of(out))
        return out

    # -- what follows from the definition -----------------------------------------------------------------------
    def values(self, kin: Kinematics) -> Array:
        """The coordinates s, (n,); a flow has none."""
        return np.zeros(len(self)) if self.kind.flow else self._value(kin)[:, 0]

    def rows(self, kin: Kinematics) -> tuple[Array, Array]:
        """ds/dt = rows_a . twist_a + rows_b . twist_b + rate: each (n, d + n_rot)."""
        out: Array = np.zeros((len(self), 2 * self.width))
        out[:, self.entries] = self._value(kin)[:, 1:]
        return out[:, : self.width], out[:, self.width :]

    def _value(self, kin: Kinematics) -> Array:
        """s and the entries of the row, once for a configuration; those that are driven depend on time beside it."""
        if self.kind.driven:
            return self._run("value", kin.frames)
        found: Array | None = kin.evaluated.get(self)
        if found is None:
            found = kin.evaluated[self] = self._run("value", kin.frames)
        return found

    def rates(self, kin: Kinematics) -> tuple[Array, Array]:
        """What of ds/dt comes from a drive, and d2s/dt2 at constant twists, (n,) each."""
        assert kin.twist is not None
        out = self._run("rates", kin.frames)
        return out[:, 0], out[:, 1]

    def geometric(self, kin: Kinematics, effort: Array) -> Array:
        """Symmetric part of d(effort row)/d(displacements of both markers) at constant efforts, (n, 2 w, 2 w), w = d + n_rot."""
        lower = self._run("tangent", kin.frames, np.ascontiguousarray(effort, dtype=float))
        out: Array = np.zeros((len(self), 2 * self.width, 2 * self.width))
        for column, (i, j) in enumerate(self.kind.pattern):
            out[:, i, j] = out[:, j, i] = lower[:, column]
        return out


def _frames_anywhere(m: Motions) -> list[Array]:
    """Two moving frames without a special place, attitude or direction, numbers in the order of :mod:`.frames`."""
    found = []
    for sign in (1.0, -0.7):
        place = sign * np.array([0.31, -0.47, 0.59])[: m.dim]
        pose = m.pose(place, 0.83 * sign if m.dim == 2 else sign * np.array([0.37, 0.53, 0.61, 0.9 * sign]))
        twist = sign * np.arange(1.3, m.n_twist + 1.0)
        angle = [0.83 * sign] if m.dim == 2 else []
        found.append(np.concatenate([place, m.matrix(pose[None])[0].ravel(), twist, angle]))
    return found
