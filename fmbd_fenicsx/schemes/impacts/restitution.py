"""How far contacts rebound: by their restitution, as long as the impact adds no energy.

Newton's law U_1 = -e U_0 beside Coulomb friction may create energy, where impulses along the normal turn the slip about (Kane and
Levinson's paradox). In an impact U_1 = U_0 + W P with the rates U of all closed contacts, and the energy changes by

    P . (U_0 + U_1) / 2 = P . U_1 - P . W P / 2,                                                             (1)

which is never positive without a rebound: P . U_1 <= 0 then. So there is a largest share s in [0, 1] of the rebounds by which no
energy is won, U_1 = -s e U_0. It is 1 wherever Newton's law wins none, and else found by secants.

Where other forces act in the time of a step too, a contact may leave already, U_0 > 0, and be pressed back within the step.
Stopped there, U_1 = 0, it would gain P U_0 / 2; so it may come back at the speed it leaves with, U_1 = -U_0. By the mean of both
its gap does not shrink, and P does no work. That share is never less than one.

Source: Glocker, "Energetic consistency conditions for standard impacts", doi:10.1007/s11044-012-9316-9.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...rotations import Array
from ...system.compiled.declarations import constants, enumeration

# work in an impact, of its terms, that is more than roundoff, and than what a Newton iteration changes; the same where a share is
# found; shares of the rebound that are one
ADDED, CLOSE, NARROW = constants("impacts/impulses.c", "ADDED", "CLOSE", "NARROW")
TRIED = enumeration("TRIED", "impacts/impulses.c")["TRIED"]  # shares of the rebound at most


@dataclass
class Impact:
    """Rates ``before`` (m, 1 or d) of the closed contacts, m/s, and the ``rebound`` (m,) of those that bounce: e U_0 of those
    that approach, which is made smaller where it would add energy, and U_0 of those that leave.
    """

    before: Array
    rebound: Array

    def forces(self, W: Any, gap: Array, start: Array, solve: Callable[[Array], Array]) -> Array:
        """Impulses (m, 1 or d) with the largest share of the rebound that (1) allows.

        ``solve``: impulses for openings like ``gap``, which are those under ``start`` with all of the rebound.
        """
        if not (self.rebound < 0.0).any():
            return solve(gap)
        shape = start.shape

        def at(share: float) -> tuple[Array, float, float]:
            """Impulses with a share of the rebound, their work, and the size of its terms."""
            less = gap.reshape(shape).copy()
            rebound = self._shared(share)
            less[:, 0] -= self.rebound - rebound
            force = solve(less.ravel())
            after = less + (W @ (force - start).ravel()).reshape(shape)
            after[:, 0] -= rebound
            work = 0.5 * force * (self.before + after)
            return force, float(work.sum()), float((0.5 * np.abs(force) * (np.abs(self.before) + np.abs(after))).sum())

        force, most, size = at(1.0)
        if not most > ADDED * size:
            return force

        # without a rebound energy is lost; then secants that halve the work of an end which stays
        lower, upper, side = 0.0, 1.0, 0
        force, least, size = at(lower)

        for _ in range(TRIED):
            if least > -CLOSE * size or upper - lower <= NARROW:
                break
            share = upper - most * (upper - lower) / (most - least)
            if not lower < share < upper:
                share = 0.5 * (lower + upper)
            found, work, size = at(share)
            if work > 0.0:
                upper, most = share, work
                least, side = (0.5 * least if side > 0 else least), 1
            else:
                force, lower, least = found, share, work
                most, side = (0.5 * most if side < 0 else most), -1

        self.rebound = self._shared(lower)
        return force

    def _shared(self, share: float) -> Array:
        """Rebounds (m,) with a share of those of contacts that approach, m/s."""
        return np.where(self.rebound < 0.0, share * self.rebound, self.rebound)
