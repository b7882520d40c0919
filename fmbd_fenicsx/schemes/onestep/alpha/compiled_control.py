"""Error control of compiled steps: what :mod:`.variable_alpha` lends to ``driver/marches/control.c`` for a march.

C judges each step by the norm of :class:`~...error_norm.NormOfWays` and chooses the next, while no load or drive within that has
to be looked at; what belongs to a size changes with it. It stops where Python has to look, and where a step fails.
"""

from __future__ import annotations

import ctypes
from fractions import Fraction

import numpy as np

from ....rotations import Array
from ....system.compiled.own_steps import OwnRoom
from ....system.compiled.tables.resting import twin_of
from ....system.compiled.tables.structures import Store, structure
from ....system.element_memory import next_sample
from ...control import ESTIMATE, FADING, StepControl
from ...error_norm import NormOfWays
from ...own_marching import own_numbers
from .quiet_times import CALM, QuietTimes
from .stretch import Stretch, parts


class CompiledControl:
    """``Control`` of tables.h for one norm and one controller."""

    def __init__(self, norm: NormOfWays, control: StepControl, *, laws: bool, drags: bool, bends: bool) -> None:
        """``laws``: whether forces follow laws; ``drags``: whether dampers alone may hold some; ``bends``: whether bodies do."""
        self.norm, self.control, self.store = norm, control, Store()
        self.twin, system = twin_of(norm.system), norm.system
        s, dim = self.twin.system, system.motions.dim

        self.own = OwnRoom(self.twin, norm.deforming, own_numbers(norm, control))
        # elastic fields have factors of few sizes, and of rows of a user's own roundoff is unknown
        self.resizes = not system.fields and bool(system.in_lengths.all())

        # coordinates of bodies that are no deformations
        own = np.logical_not(norm.deformations)
        own[system.n_core :] = False
        for block in norm.sizes.blocks:
            own[block] = False
        self._coordinates = np.flatnonzero(own)
        places = np.flatnonzero(self.twin.velocities(own)).astype(np.int32)

        # arrays that C works in
        like_v = "e a missed_speed v A reaching racing".split()
        sizes = dict.fromkeys(like_v, s.n_v) | dict.fromkeys(("y", "open", "noise"), s.n_lam)
        work = self.store.zeros({**sizes, "fastest": 2, "faster": 2})
        self._fastest = work["fastest"][0]
        self.c = structure("Control", dim)(
            own=self.own.address, least=norm.least, fading=FADING,
            frames=system.n_frames, core=system.n_core, laws=laws, drags=drags, bends=bends,
            timed=not control.given and bool(system.prescribes or system.pushes_in_time), calm=CALM,
            coordinates=len(places), coordinate=self.store.array(places, np.int32)[1],
            **{name: address for name, (_, address) in work.items()},
        )  # fmt: skip
        self._origin: Array | None = None

    @property
    def address(self) -> int:
        """For C."""
        return ctypes.addressof(self.c)

    def lend(self, stretch: Stretch, level: int, quiet: QuietTimes, *, until: float, last: float) -> None:
        """Sizes and errors so far; the next step, one of the parts of a level of a stretch, which others as long follow up to a
        time (s); until when (s) steps may begin.
        """
        norm, c, control = self.norm, self.c, self.control
        if self._origin is not norm.origin:
            assert norm.origin is not None
            self._origin = norm.origin
            c.origin = self.store.address(self.twin.configurations(norm.origin[None])[0])
        self.own.lend(norm.q_size, norm.v_size, norm.deflections)
        self._fastest[:] = [norm.v_size[block].max(initial=0.0) for block in norm.sizes.blocks]
        c.way, c.foretold, c.largest = norm.way, norm.foretold, 0.0

        # where in which stretch
        c.count, c.place = parts(level), int(stretch.done * parts(level))
        c.stretch, c.end, c.more, c.last = stretch.length, stretch.end, stretch.more(until), last
        c.lost, c.until = stretch.lost or (np.inf, -np.inf)
        c.chooses = self.resizes and next_sample(norm.system) == np.inf
        c.looked, (c.quiet_size, c.quiet) = quiet.largest, quiet.quiet

        # the controller
        c.size_before, c.missed = control.h_old, control.error_old
        c.refused, c.refusals = len(control.rejections), 0
        self.own.c.tiny = control.tiny

    def take(self, stretch: Stretch, t: float) -> None:
        """Take back what :meth:`lend` gave, at a time t, s."""
        norm, c, control = self.norm, self.c, self.control
        sizes, speeds, norm.deflections = self.own.told()
        norm.q_size[self._coordinates] = sizes[self._coordinates]
        norm.v_size[self._coordinates] = speeds[self._coordinates]
        for block, speed in zip(norm.sizes.blocks, self._fastest, strict=True):
            norm.v_size[block] = speed
        norm.way, norm.foretold = c.way, c.foretold

        # where in which stretch, and the controller
        stretch.done, stretch.end = Fraction(c.place, c.count), c.end
        if c.lost < np.inf:
            stretch.lost = c.lost, c.until
        control.h_old, control.error_old = c.size_before, c.missed
        if c.refusals or not c.refused:
            control.rejections = [(t, c.tried, ESTIMATE)] * c.refused
