"""Error control of compiled steps of one size: what :mod:`.variable_alpha` lends to ``driver/marches/control.c`` for a march.

C judges each step by the norm of :class:`~...error_norm.NormOfWays` and goes on while the next step has the same size. It stops
behind a step after which the size may change, and before one that is refused: all decisions are Python's.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np

from ....rotations import Array
from ....system.compiled.own_steps import deflections_of
from ....system.compiled.tables.resting import twin_of
from ....system.compiled.tables.structures import Store, structure
from ...control import FADING, LEAST_ERROR, TURN, StepControl
from ...error_norm import NormOfWays


@dataclass(frozen=True)
class Stay:
    """Up to when steps keep their size h (s).

    ``place``: the present one, in steps of h; ``count`` of them are a ``stretch`` (s), up to ``end`` (s);
    ``ratio``: of the next larger size, which begins at its multiples, 0 without one;
    ``keeps``: share of h that a proposal must have; ``calm``: error below which loads are looked at behind the time ``quiet``;
    ``until``: a time, s;
    ``peak``: the largest error of late.
    """

    place: int
    count: int
    stretch: float
    end: float
    ratio: int
    keeps: float
    calm: float
    quiet: float
    until: float
    peak: float


class CompiledControl:
    """``Control`` of tables.h for one norm, of a system whose local coordinates are all deformations."""

    def __init__(self, norm: NormOfWays, *, laws: bool) -> None:
        """``laws``: whether forces follow laws."""
        self.norm, self.store = norm, Store()
        self.twin = twin_of(norm.system)
        s, dim = self.twin.system, norm.system.motions.dim

        self.deflections = deflections_of(s, norm.deforming, self.store)

        # tolerances and arrays that C works in
        sizes = {"e": s.n_v, "y": s.n_lam, "a": s.n_v, "missed": s.n_v, "fastest": 2, "faster": 2}
        work = self.store.zeros(sizes)
        self._fastest = work["fastest"][0]
        self.c = structure("Control", dim)(
            rtol=norm.rtol, atol=norm.atol or 0.0, length=s.length, least=norm.least, floor=LEAST_ERROR, turn=TURN, fading=FADING,
            frames=norm.system.n_frames, core=norm.system.n_core, laws=laws,
            deforming=len(norm.deforming), deflection=self.store.structure(self.deflections),
            **{name: address for name, (_, address) in work.items()},
        )  # fmt: skip
        self._origin: Array | None = None

    @property
    def address(self) -> int:
        """For C."""
        return ctypes.addressof(self.c)

    def lend(self, control: StepControl, stay: Stay) -> None:
        """Sizes and errors so far, and up to when steps keep their size."""
        norm, c = self.norm, self.c
        if self._origin is not norm.origin:
            assert norm.origin is not None
            self._origin = norm.origin
            c.origin = self.store.address(self.twin.configurations(norm.origin[None])[0])
        for one, largest in zip(self.deflections, norm.deflections, strict=True):
            one.size = largest
        self._fastest[:] = [norm.v_size[block].max(initial=0.0) for block in norm.sizes.blocks]
        c.way, c.error, c.largest, c.peak = norm.way, control.error_old, 0.0, stay.peak

        c.place, c.count, c.stretch, c.end = stay.place, stay.count, stay.stretch, stay.end
        c.ratio, c.calm, c.quiet, c.until = stay.ratio, stay.calm, stay.quiet, stay.until
        c.high = min(control.pressure(stay.keeps), 1.0)
        c.low = control.pressure(stay.ratio) if stay.ratio else 0.0

    def take(self, control: StepControl) -> None:
        """Take back what :meth:`lend` gave."""
        norm, c = self.norm, self.c
        norm.deflections = np.array([one.size for one in self.deflections])
        for block, speed in zip(norm.sizes.blocks, self._fastest, strict=True):
            norm.v_size[block] = speed
        norm.way, control.error_old = c.way, c.before
