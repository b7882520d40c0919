"""Whether a run begins with the velocities that bodies were given: where joints contradict them, it begins with the nearest ones.

    |v_i - v_given,i|  >  0.01 max |v_given|        of a frame i that was given a velocity, entries as lengths over time      (1)

The nearest velocities are those after an impact without rebound: they cost energy, and set elastic bodies into vibration.
"""

from __future__ import annotations

import numpy as np

from ...errors import InputError
from ...log import log
from ...schemes.consistent import Correction
from ...system.layout import State
from ...system.system import System

CHANGED = 0.01


def look_at_given_velocities(
    system: System, given: State, start: State, correction: Correction, *, settled: bool
) -> None:
    """Warn by (1) of the body whose velocity was changed most; looks at frames, which are the same on all ranks.

    Raises:
        InputError: a ``settled`` start, which is at rest, has changed one.
    """
    n = system.motions.n_twist
    frames = slice(0, system.n_frames * n)
    told = (system.units[frames] * given.v[frames]).reshape(-1, n)
    fastest = float(np.abs(told).max(initial=0.0))
    if not (settled or correction.velocity > CHANGED * fastest) or fastest == 0.0:
        return

    taken = (system.units[frames] * start.v[frames]).reshape(-1, n)
    change = np.abs(taken - told).max(axis=1) * told.any(axis=1)
    if not change.max() > CHANGED * fastest:
        return
    if settled:
        raise InputError(
            f'Body "{system.frame_names[int(np.argmax(change))]}" is given a velocity, which a scene with settle=True does not '
            "take: it starts at rest in equilibrium, moved by drives alone. Leave out the velocity, or settle=True."
        )

    log.warning(
        'the velocities that bodies were given contradict the joints: that of body "%s" is changed by %.3g m/s (or rad/s times a '
        "length), the largest given is %.3g m/s. The run begins with the nearest velocities that joints allow, as after an "
        "impact. velocity= is that of the centre of mass; angular_velocity= of rigid bodies has body axes",
        system.frame_names[int(np.argmax(change))], float(change.max()), fastest,
    )  # fmt: skip
