"""Campbell's diagram: frequencies of a rotating scene over its speed, and its critical speeds.

Frequencies are those seen in axes that turn with the scene; a motion with frequency w in them has w + W or |w - W| at rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..checks import typed
from ..errors import require
from ..rotations import Array
from ..system.scene.scene import Scene
from .equilibrium import equilibrium
from .modes import modes
from .steady import Spin


@dataclass(frozen=True, eq=False)
class Campbell:
    """``speeds`` (m,) rad/s, ``eigenvalues`` (m, n) complex 1/s in turning axes."""

    speeds: Array
    eigenvalues: Array

    @property
    def omega(self) -> Array:
        """Angular frequencies in turning axes, (m, n) rad/s."""
        return np.abs(self.eigenvalues.imag)


@typed
def campbell(make: Callable[[float], Scene], speeds: Sequence[float], n: int, *, spin: Spin | None = None) -> Campbell:
    """The first n modes about the steady rotation of ``make(speed)`` at each speed (rad/s); collective.

    ``spin`` gives axis and centre (its rate is ignored); the z axis through the origin by default. The ground turns as well.
    """
    require(len(speeds) > 0, "campbell: needs at least one speed.")
    found = []
    for speed in speeds:
        scene = make(float(speed))
        turn = Spin(float(speed)) if spin is None else Spin(float(speed), spin.axis, spin.center)
        found.append(modes(scene, n, at=equilibrium(scene, spin=turn)).eigenvalues)
    return Campbell(np.asarray(speeds, dtype=float), np.array(found))
