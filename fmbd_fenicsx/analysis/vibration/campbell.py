"""Campbell's diagram: frequencies of a rotating scene over its speed, forward and backward whirl, and critical speeds.

Eigenvalues are those seen in axes that turn with the scene. A motion that circles there with the rate s w (s = 1 with the speed,
s = -1 against it) circles with W + s w at rest: :attr:`Campbell.fixed`. A speed W is critical where a forward whirl keeps up with
the scene, W + s w = W: there a motion that stands still in the turning axes, an unbalance, meets no stiffness.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...checks import typed
from ...errors import require
from ...rotations import Array
from ...system.scene.scene import Scene
from ..small_motions.steady import Spin
from ..statics.equilibrium import equilibrium
from .modes import modes_of


@dataclass(frozen=True, eq=False)
class Campbell:
    """``speeds`` (m,) rad/s, ``eigenvalues`` (m, n) complex 1/s in turning axes; ``whirl`` (m, n) in these axes: 1 with the
    speed, -1 against it, 0 for motions in a plane. ``at_rest``: the axes rest, as only some bodies spin.
    """

    speeds: Array
    eigenvalues: Array
    whirl: Array
    at_rest: bool = False

    @property
    def omega(self) -> Array:
        """Angular frequencies in turning axes, (m, n) rad/s."""
        return np.abs(self.eigenvalues.imag)

    @property
    def fixed(self) -> Array:
        """Rates at rest, (m, n) rad/s: positive for forward, negative for backward whirl; plane motions as if forward."""
        rates = np.where(self.whirl < 0, -1.0, 1.0) * self.omega
        return rates if self.at_rest else np.asarray(self.speeds[:, None] + rates)

    @property
    def critical_speeds(self) -> list[float]:
        """Speeds (rad/s) at which a forward whirl keeps up with the scene, each on a straight line between two of the diagram's
        speeds, which increase.
        """
        found = []
        # how far each forward whirl is ahead of the scene, the slowest first
        ahead: list[Array] = []
        for j in range(len(self.speeds)):
            rates: Array = self.fixed[j]
            ahead.append(np.sort(rates[rates > 0.0]) - self.speeds[j])
        for j, step in enumerate(np.diff(self.speeds)):
            for a, b in zip(ahead[j], ahead[j + 1], strict=False):
                if a > 0.0 >= b:
                    found.append(float(self.speeds[j] + step * a / (a - b)))
        return found

    def __str__(self) -> str:
        """A table: speeds and rates at rest, and the critical speeds."""
        fixed = np.atleast_2d(self.fixed)
        head = "  speed (rad/s)" + "".join(f"{f'mode {k}':>12}" for k in range(fixed.shape[1]))
        lines = [f"  {w:13.6g}" + "".join(f"{x:12.6g}" for x in fixed[j]) for j, w in enumerate(self.speeds)]
        critical = ", ".join(f"{w:.6g}" for w in self.critical_speeds) or "none"
        return "\n".join(("rates at rest (rad/s)", head, *lines, f"  critical speeds: {critical}"))


@typed
def campbell(make: Callable[[float], Scene], speeds: Sequence[float], n: int, *, spin: Spin | None = None) -> Campbell:
    """The first n modes about the steady rotation of ``make(speed)`` at each speed (rad/s); collective.

    Motions that nothing holds, such as the turn of a rotor about its axis, have no frequency and do not count among the n.
    ``spin`` gives axis, centre and bodies (its rate is ignored); the z axis through the origin by default. The ground turns as
    well, unless ``spin.bodies`` names those that do.
    """
    require(len(speeds) > 0, "campbell: needs at least one speed.")
    values, senses = [], []
    for speed in speeds:
        scene = make(float(speed))
        turn = Spin(float(speed)) if spin is None else replace(spin, rate=float(speed))
        found = modes_of(scene, n, at=equilibrium(scene, spin=turn), held=True)
        values.append(found.eigenvalues)
        senses.append(found.whirl(turn.axis))
    at_rest = spin is not None and bool(spin.bodies)
    return Campbell(np.asarray(speeds, dtype=float), np.array(values), np.array(senses), at_rest)
