"""Whether bodies that spin among others at rest are round: only then have their small motions constant coefficients."""

from __future__ import annotations

import numpy as np

from ...errors import InputError
from ...rotations import Array
from ...system.layout import State
from ..small_motions.basis import random_motion
from ..small_motions.perturbation import Perturbation
from ..small_motions.steady import MOUNTS, BodySpin

ANGLE = 1.0  # by which bodies are turned, rad
ROUND = 1e-5  # relative difference of forces that is none


def check_round(about: Perturbation, spin: BodySpin) -> None:
    """Refuse bodies whose inertia or stiffness changes as they turn: small motions would have periodic coefficients.

    Elastic bodies in moving frames are taken as round.
    """
    system, s = about.system, about.state
    if any(p.frame in spin.frames for _, p in system.fields):
        return

    none = np.zeros(system.n_lam)
    before = Perturbation(system, State(s.t, s.q, s.v, s.a, none))
    after = Perturbation(system, State(s.t, spin.turned(system, s.q, ANGLE), s.v, s.a, none))
    y = random_motion(about, 0)
    turned = spin.carried(system, y, ANGLE)

    for name in ("mass", "damping", "stiffness"):
        force = spin.carried(system, _product(before, name, y), ANGLE)
        change = system.max_abs(_product(after, name, turned) - force)
        if change > ROUND * system.max_abs(force):
            raise InputError(
                f"The {name} of {spin.listed} changes as they turn: bodies that spin among others at rest must be round about "
                "their axes. Take the rotation of the whole scene (Spin without bodies) for rotors that are not. "
                + MOUNTS
            )


def _product(about: Perturbation, name: str, y: Array) -> Array:
    """M y, C y or K y."""
    return {"mass": about.mass, "damping": about.damping, "stiffness": about.stiffness}[name](y)
