"""Where the steps of a run end: equal ones, or as the error control of the scheme likes, hitting break points and the end
exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..checks import number
from ..errors import InputError, require
from ..log import log
from ..schemes.declared import Declared
from ..system.scene.scene import Scene


@dataclass(frozen=True)
class StepSchedule:
    """Where the steps of a march end: ``steps`` equal ones, or (0) as the scheme likes, hitting each of ``stops``, at which the
    solution may have a kink, each of ``marks``, at which it goes on, and the end.
    """

    t_end: float
    steps: int
    stops: tuple[float, ...] = ()
    largest: float = np.inf
    marks: tuple[float, ...] = ()

    def next(self, t: float) -> float:
        """Size of the next step, or the most it may be (s). Steps end a few roundings before a break point: on its near side."""
        if self.steps:
            return self.t_end / self.steps
        # steps that the scheme chooses: up to the next break point, on its near side
        left = self.t_end - t
        for places in (self.stops, self.marks):
            ahead = next((x for x in places if x - 64 * np.spacing(x) > t), self.t_end)
            if ahead < self.t_end:
                left = min(left, ahead - 16 * np.spacing(ahead) - t)
        return min(left, self.largest)

    def broken(self, t: float) -> float | None:
        """The break point at t, where the solution may have a kink."""
        return next((x for x in self.stops if abs(t - x) <= 64 * np.spacing(x)), None)

    def ended(self, t: float, done: int) -> bool:
        """Whether the march is over."""
        return done >= self.steps if self.steps else t >= self.t_end * (1 - 1e-12)


def step_schedule(scene: Scene, scheme: Any, t_end: float, dt: float | None, *, multiple: int = 1) -> StepSchedule:
    """Steps of equal size, none above dt (but for roundoff), a ``multiple`` of them; or none for error control."""
    t_end = number("End time t_end =", t_end, above=0.0, unit="s")
    if dt is not None:
        dt = number("Step dt =", dt, above=0.0, unit="s")
        require(dt <= t_end * (1 + 1e-12), f"Step dt = {dt} s is larger than the whole run, t_end = {t_end} s.")
        require(t_end + dt > t_end, f"Step dt = {dt} s is below the roundoff of t_end = {t_end} s: t + h == t.")

    if Declared.by(scheme).adaptive:
        require(
            multiple == 1,
            "estimate_error needs constant steps; with error control compare two values of rtol (study.py).",
        )
        return StepSchedule(t_end, 0, _stops(scene, t_end), np.inf if dt is None else dt)
    if dt is None:
        raise InputError(f"{scheme.name} takes constant steps: give dt (s). Schemes with rtol choose their own.")

    # t_end / dt is a whole number but for roundoff, or the next one above
    steps = max(1, round(t_end / dt))
    if abs(steps * dt - t_end) > 1e-9 * t_end:
        steps = int(np.ceil(t_end / dt))
    groups = -(-steps // multiple)
    return StepSchedule(t_end, groups * multiple)


def _stops(scene: Scene, t_end: float) -> tuple[float, ...]:
    """Times inside a run at which the solution may have a kink: break points, and samples of controllers."""
    periods = {force.period for force in scene.forces.values() if force.period is not None}
    samples = [k * period for period in periods for k in range(1, int(np.ceil(t_end / period)))]
    return tuple(sorted({float(t) for t in (*scene.breakpoints, *samples) if 0 < t < t_end}))


def warn_of_late_samples(scene: Scene, schedule: StepSchedule) -> None:
    """Equal steps that do not divide a sampling period: samples come at the end of the step in which they are due."""
    if not schedule.steps:
        return
    h = schedule.next(0.0)
    for force in scene.forces.values():
        steps = 1.0 if force.period is None else force.period / h
        if abs(steps - max(1, round(steps))) > 1e-6 * steps:
            log.warning(
                'controller "%s" samples every %g s, which is no multiple of the step of %g s: samples are taken late, at the '
                "end of the step in which they are due. Let dt divide the period, and t_end too",
                force.name, force.period, h,
            )  # fmt: skip
