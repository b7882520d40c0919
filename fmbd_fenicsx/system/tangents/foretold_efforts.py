"""Efforts of linear springs where an increment of Newton's iteration leads.

The tangent of an effort N along a row r holds its geometric stiffness N dr/dq. A stiff spring has no N to speak of in a
configuration that is only nearly right: an increment that turns it by an angle leaves its elongation wrong by the
square, times k. What an increment leads to is

    N' = N + k r . dq + c r . dv                                                                                       (1)

at N and r of where it began. With N' in the next tangent the iterations are those of a form whose efforts are unknowns of their
own, for any k; and an increment whose tangent had another N is judged by how much that may have bent it,

    ck |(N' - N) dr/dq| / m                                                                                            (2)

with m the smallest mass. The driver does the same, ``compiled/driver/evaluation/matrix.c``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...mechanics.forces.force_elements import ScalarLoads
from ...rotations import Array
from ..evaluation import Evaluation
from ..lengths import farthest
from ..system import System

SAME = 0.1  # efforts that differ by a smaller share are the same across


def foretold_efforts(system: System) -> ForetoldEfforts:
    """Those of a system, made once."""
    if "foretold efforts" not in system.cache:
        system.cache["foretold efforts"] = ForetoldEfforts(system)
    made: ForetoldEfforts = system.cache["foretold efforts"]
    return made


class ForetoldEfforts:
    """(1) and (2) of all linear springs of a system whose rows turn."""

    def __init__(self, system: System) -> None:
        self.system = system
        turning = [f for f in system.forces if isinstance(f, ScalarLoads) and not f.relative.turns_only]
        masses = [system.mass] if system.rigid is None else [*system.rigid.mass, system.mass]
        self.lightest = float(np.min(masses))
        self.linear = {f: np.array([force.law is None for force in f.forces]) for f in turning}

    @property
    def none(self) -> dict[ScalarLoads, Array]:
        """No effort of any of them."""
        return {f: np.zeros(len(f.forces)) for f in self.linear}

    def lost(self, q: Array) -> tuple[str, float]:
        """The spring whose effort is known worst, and by how much (N): k times the roundoff of places."""
        place = float(np.finfo(float).eps) * (self.system.length + farthest(self.system, q))
        known = [(place * abs(force.stiffness), force.name) for f in self.linear for force in f.forces]
        effort, name = max(known, default=(0.0, ""))
        return name, effort

    def after(self, ev: Evaluation, dq: Array, dv: Array) -> dict[ScalarLoads, Array]:
        """N' of (1) for increments like v of a configuration, (m,) of each kind of springs; N of laws of a user's own."""
        if not self.linear:
            return {}
        moved, faster = self.twists(ev, dq), self.twists(ev, dv)
        return {
            f: f.scalar(ev.kin, ev.t)[2] + linear * self._change(ev, f, moved, faster)
            for f, linear in self.linear.items()
        }

    def _change(self, ev: Evaluation, f: ScalarLoads, moved: Array, faster: Array) -> Array:
        """k r . dq + c r . dv of (1), (m,), for displacements and changes of the twists of all markers."""
        return np.asarray(f.k * f.relative.along(ev.kin, moved) + f.c * f.relative.along(ev.kin, faster))

    def misfit(self, ev: Evaluation, after: dict[ScalarLoads, Array], ck: float) -> float:
        """(2), the share of an increment that may be wrong; ``ev``: where it began, with the N of its tangent."""
        worst = 0.0
        for f, pull in after.items():
            had = ev.foretold.get(f, f.scalar(ev.kin, ev.t)[2])
            change = np.where(self.linear[f], pull - had, 0.0)
            change[np.abs(change) <= SAME * np.maximum(np.abs(pull), np.abs(had))] = 0.0
            if change.any():
                worst = max(worst, ck / self.lightest * float(np.abs(f.relative.geometric(ev.kin, change)).max()))
        return worst

    def twists(self, ev: Evaluation, v: Array) -> Array:
        """Twists of all markers for velocities v, (n_markers, d + n_rot)."""
        s = self.system
        assert ev.kin.moving is not None
        rate = s.ports(v, ev.t, rates=True)
        moving = replace(ev.kin.moving, frame_twist=s.twists(v)[s.markers.frame], rate=rate[s.markers.port])
        return moving.twist(ev.kin)
