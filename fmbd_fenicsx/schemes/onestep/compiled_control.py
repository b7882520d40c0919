"""Error control of compiled steps of one size: what :mod:`.variable_alpha` lends to ``driver/control.c`` for a march.

C judges each step by the norm of :class:`~..control.NormOfWays` and goes on while the next step has the same size. It stops behind
a step after which the size may change, and before one that is refused: all decisions are Python's.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...rotations import Array
from ...system.compiled.structures import Store, array_of, enumeration, structure
from ..control import LEAST_ERROR, TURN, NormOfWays, StepControl

OWN_COORDINATES, SHAPE_AMPLITUDES, NODAL_VALUES = enumeration("OWN_COORDINATES").values()


@dataclass(frozen=True)
class Stay:
    """Up to when steps keep their size h (s).

    ``place``: the present one, in steps of h; ``ratio``: of the next larger size, which begins at its multiples, 0 without one;
    ``keeps``: share of h that a proposal must have; ``calm``: error below which loads are looked at; ``until``: a time, s.
    """

    place: int
    ratio: int
    keeps: float
    calm: float
    until: float


class CompiledControl:
    """``Control`` of tables.h for one norm and one controller."""

    def __init__(self, norm: NormOfWays, control: StepControl) -> None:
        self.norm, self.control, self.store = norm, control, Store()
        system = norm.system
        self.q_sizes: list[tuple[slice, Array]] = []  # of coordinates of a user's own: where they are in v
        self.deflections: list[Array] = []

        extents = self._extents()
        made = self.store.zeros({"e": system.n_v, "y": system.n_lam, "a": system.n_v, "missed": system.n_v})
        self.c = structure("Control", system.motions.dim)(
            rtol=norm.rtol, atol=norm.atol or 0.0, length=system.length, least=norm.least, extents=len(extents),
            extent=self.store.structure(array_of(structure("Extent", system.motions.dim), len(extents))(*extents)),
            floor=LEAST_ERROR, turn=TURN, **{name: address for name, (_, address) in made.items()},
        )  # fmt: skip
        self._origin: Array | None = None

    def _extents(self) -> list[Any]:
        """Local coordinates of all bodies that have some."""
        norm, s = self.norm, self.norm.system
        deforming = {k for k, _ in norm.deforming}
        own = [(OWN_COORDINATES, k, p, s.units[s.slices[1][k]]) for k, p in s.core_parts if k not in deforming]
        elastic = [(NODAL_VALUES if p.rms is None else SHAPE_AMPLITUDES, k, p, p.rms) for k, p in norm.deforming]

        found = []
        for sort, k, part, unit in (*own, *elastic):
            size, size_at = self.store.array(np.zeros(part.n if sort == OWN_COORDINATES else 1))
            if sort == OWN_COORDINATES:
                self.q_sizes.append((s.slices[1][k], size))
            else:
                self.deflections.append(size)
            found.append(
                structure("Extent", s.motions.dim)(
                    sort=sort, at_q=s.slices[0][k].start, at_v=s.slices[1][k].start, n=part.n, size=size_at,
                    unit=None if unit is None else self.store.address(unit), reached=self.store.address(size),
                )  # fmt: skip
            )
        return found

    @property
    def address(self) -> int:
        """For C."""
        return ctypes.addressof(self.c)

    def lend(self, stay: Stay) -> None:
        """Sizes and errors so far, and up to when steps keep their size."""
        norm, control, c = self.norm, self.control, self.c
        if self._origin is not norm.origin:
            self._origin = norm.origin
            c.origin = self.store.address(norm.origin)
        for place, size in self.q_sizes:
            size[:] = norm.q_size[place]
        for size, largest in zip(self.deflections, norm.deflections, strict=True):
            size[0] = largest
        c.way, c.error, c.largest = norm.way, control.error_old, 0.0

        c.place, c.ratio, c.calm, c.until = stay.place, stay.ratio, stay.calm, stay.until
        c.high = min(control.pressure(stay.keeps), 1.0)
        c.low = control.pressure(stay.ratio) if stay.ratio else 0.0

    def take(self) -> None:
        """The same back."""
        norm, c = self.norm, self.c
        for place, size in self.q_sizes:
            norm.q_size[place] = size
        for i, size in enumerate(self.deflections):
            norm.deflections[i] = size[0]
        norm.way, self.control.error_old = c.way, c.before
