"""Vibrations that the steps of a run do not resolve, and that its scheme takes out within the first few of them.

Stiffly accurate schemes (Radau, BDF) and generalized-alpha with a small rho_inf leave nothing of a vibration of w h >> 1: runs
with h, 2 h and 4 h all miss it, agree, and tell no error. A rule that conserves energy keeps its amplitude, whatever it
makes of its frequency. Over the first steps of a size h both differ by

    e_h = max |x_damped - x_undamped|  =  O(h^2) or less of smooth motion,   the amplitude of what was taken out else       (1)

so that of vibrations e_2h is about e_h, of smooth motion it is four to eight times as large. The undamped rule takes eight steps
in one of the scheme: places tremble little, and its own errors would hide that. What loads excite later is not seen.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...log import log
from ...rotations import Array
from ...schemes.declared import Declared
from ...system.scene.contents import contents_of
from ..problem import Problem
from ..recording.output import Output
from ..schedule import StepSchedule
from .companion_runs import UNFIT, companion

FEW = 8  # steps that are looked at
FINER = 8  # steps of the rule that damps nothing in one of the scheme
FALLING = 2.0  # e_2h over e_h, from which on the difference is that of smooth motion


def damped_vibrations(problem: Problem, schedule: StepSchedule) -> dict[str, float]:
    """Sensor -> amplitude of what the scheme has taken out of it in the first steps, by (1); collective.

    Empty for schemes that damp little, for runs of a few steps, and where one does not end.
    """
    if not problem.said.forgets or schedule.left(0) < 2 * FEW:
        return {}
    free = _undamped(problem)
    try:
        near, far = (_apart(problem, free, parts * schedule.next(0.0)) for parts in (1, 2))
    except UNFIT as error:
        log.info("vibrations that the scheme damps are not looked for: a run of a few steps did not end: %s", error)
        return {}
    return {n: size for n, size in near.items() if far[n] < FALLING * size}


def _undamped(problem: Problem) -> Any:
    """A scheme that conserves energy; where it refuses the scene, as with floating frames, one that damps little."""
    from ...schemes.onestep.alpha.generalized_alpha import GeneralizedAlpha
    from ...schemes.onestep.conserving.energy_momentum import EnergyMomentum

    conserving = EnergyMomentum()
    refused = Declared.by(conserving).refuse(conserving.name, contents_of(problem.scene))
    return GeneralizedAlpha(0.9) if refused else conserving


def _apart(problem: Problem, free: Any, h: float) -> dict[str, float]:
    """e_h of every sensor, with the scheme that damps nothing."""
    damped, kept = (_begun(problem, scheme, h, parts) for scheme, parts in ((problem.scheme, 1), (free, FINER)))
    return {n: float(np.abs(x - kept[n]).max(initial=0.0)) for n, x in damped.items()}


def _begun(problem: Problem, scheme: Any, h: float, parts: int) -> dict[str, Array]:
    """The sensors over the first steps of size h, each of so many parts by a scheme."""
    wanted, schedule = Output(energy=False, progress=False, every=parts), StepSchedule(FEW * h, FEW * parts)
    return companion(replace(problem, scheme=scheme, most_parts=0.0), schedule, wanted).recorder.series
