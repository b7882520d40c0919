"""Pictures and movies of a mode: one period of it as a run, for which all pictures of runs are there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ..analysis.statics.equilibrium import read
from ..analysis.vibration.modes import Modes, readable
from ..checks import typed
from ..errors import require
from ..run.result import Run
from ..schemes.consistent import Correction
from ..system.scene.plan import make_plan


@dataclass(frozen=True)
class Vibration:
    """Stands where a run has its scheme: which mode is shown."""

    mode: int
    frequency: float  # Hz
    timeless: ClassVar[bool] = True

    @property
    def name(self) -> str:
        """For titles of figures."""
        return f"mode {self.mode}, {self.frequency:.4g} Hz"


@typed
def vibration(modes: Modes, k: int, amplitude: float | None = None, *, frames: int = 32) -> Run:
    """One period of mode k without its growth or decay, as a run with snapshots and sensors; collective.

        fmbd.vibration(modes, 0).animate("first.gif")
        fmbd.vibration(modes, 0).picture("first.png")

    Args:
        amplitude: largest displacement (m); a twentieth of the scene's length where None.
        frames: instants of the period. A mode that does not oscillate is shown in one second.
    """
    require(frames >= 4, f"vibration: frames = {frames} must be at least 4.")
    size = 0.05 * modes.system.length if amplitude is None else amplitude
    phases = np.linspace(0.0, 2.0 * np.pi, frames + 1)
    omega = float(modes.omega[k]) if 0 <= k < len(modes.omega) else 0.0
    period = 2.0 * np.pi / omega if omega > 0.0 else 1.0
    times = period * phases / (2.0 * np.pi)
    states = [replace(modes.displaced(k, size, float(p)), t=float(t)) for p, t in zip(phases, times, strict=True)]

    series = {name: np.array([read(modes, name, state) for state in states]) for name in readable(modes.scene)}
    return Run(
        scene=modes.scene,
        scheme=Vibration(k, omega / (2.0 * np.pi)),
        plan=make_plan(modes.scene, modes.system),
        system=modes.system,
        state=states[-1],
        dt=period / frames,
        times=times,
        series=series,
        energy={},
        snapshots=states,
        counters={},
        seconds={},
        drift=(0.0, 0.0),
        correction=Correction(0.0, 0.0, 0),
        local_error=0.0,
    )
