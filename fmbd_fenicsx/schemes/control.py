"""Error control: step sizes, and what a step may turn; statistics. What errors are measured by: :mod:`.error_norm`.

Step sizes follow the predictive control of Gustafsson, doi:10.1145/198429.198437, with the limits of Hairer and Wanner,
Solving ODEs II, section IV.8, doi:10.1007/978-3-642-05221-7.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import ConvergenceError
from ..rotations import Array
from ..system.compiled.declarations import constants
from ..system.layout import State
from ..system.system import System
from .error_norm import ErrorNorm

ROUNDOFF = 0.05  # Newton increments that stagnate below this share of the tolerance are accepted
STAGNATION = 100.0  # the same with constant steps, where the tolerance may lie below the roundoff of stiff forces
FALLEN = 1e-7  # or below this share of the greatest increment of the step: of a scene at rest nothing else tells what is small
TURN = 2.5  # rad
LEAST_ERROR = 1e-2  # of errors that are remembered
NO_ERROR = 1e-10  # smaller ones are none
REFUSED = 0.1, 0.9  # least and most that is left of the size of a step that its error has refused
PATIENCE = 40  # refusals of one step
ESTIMATE = "error estimate"  # the cause of those by a step's error; others are failures of its iteration
DEARLY = "found dearly"  # the cause of a step whose cheap iteration failed and whose dear one did not
SHORTER = 0.25  # of its size: that of the next one, which the cheap one finds across stiff springs that turn
LONG_PAUSE = int(constants("marches/own_steps.c", "LONG_PAUSE")[0])  # steps: the least behind a second failure
FADING = 0.8  # of the largest error of late, from step to step


@dataclass
class Statistics:
    """Work of an error-controlled run. ``rejected`` counts by cause."""

    steps: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    newton_iterations: int = 0
    residuals: int = 0
    jacobians: int = 0
    factorisations: int = 0
    solves: int = 0

    def as_dict(self) -> dict[str, float]:
        """For the counters of a run."""
        out: dict[str, Any] = {k: x for k, x in vars(self).items() if k != "rejected"}
        out["rejections"] = sum(self.rejected.values())
        for cause, n in self.rejected.items():
            out[f"rejected: {cause}"] = n
        return out


def growth_factor(error: float, order: float, safety: float) -> float:
    """By how much a step with this error over the tolerance may grow, where errors fall like h^order."""
    return float(safety * error ** (-1.0 / order))


@dataclass
class StepControl:
    """Proposes step sizes from error estimates that fall like h^order; keeps the history of a predictive controller."""

    order: float
    safety: float = 0.9
    shrink: float = 0.2
    grow: float = 8.0
    h_old: float = 0.0
    error_old: float = 0.0
    given: bool = False  # whether steps end where they have to alone, whatever their errors are: none is made smaller
    span: float = 0.0  # s, what a step was at most allowed to be
    dear: bool = False  # whether each size has factors of its own
    pause: int = 0  # steps behind a failure that do not grow: twice as many where one comes soon again
    since: int = 0  # steps since
    # (t, h, cause) since the last accepted step
    rejections: list[tuple[float, float, str]] = field(default_factory=list)
    # since the last accepted step: what a law returned that could not be used, or a joint that stayed open
    fault: str = ""

    def accepted(self, h: float, error: float, effort: float = 1.0) -> float:
        """Step after an accepted one; ``effort`` in (0, 1] lowers the safety when Newton worked hard."""
        error = max(error, NO_ERROR)
        factor = growth_factor(error, self.order, self.safety * effort)
        # Gustafsson's predictive control: errors that grow from step to step go on growing
        if self.h_old > 0:
            predictive = self.safety * (h / self.h_old) * (self.error_old / error**2) ** (1.0 / self.order)
            factor = min(factor, predictive)
        self.h_old, self.error_old = h, max(error, LEAST_ERROR)
        # after a rejection the step does not grow at once
        self.since += 1
        dearly = bool(self.rejections) and self.rejections[-1][2] == DEARLY
        if dearly and self.since < self.pause:
            self.pause = 0  # shorter steps were no cure
        elif dearly or (self.dear and any(cause != ESTIMATE for *_, cause in self.rejections)):
            self.pause = max(2 * self.pause, LONG_PAUSE) if self.since <= 2 * self.pause else 1
            self.since = 0
        most = 1.0 if self.rejections or self.since < self.pause else self.grow
        self.rejections.clear()
        factor = min(max(factor, self.shrink), SHORTER if dearly and self.pause > 1 else most)
        return h * factor

    def proposal(self, proposed: float, limit: float) -> float:
        """The size (s) of a step of at most ``limit`` that is proposed first, where the controller proposes so much."""
        return self.grow * limit if self.given else proposed

    def passes(self, error: float) -> bool:
        """Whether a step with this error over the tolerance passes."""
        return error <= 1.0 or (self.given and error < np.inf)

    def largest(self, h: float, error: float) -> float:
        """Step of which an error is expected that may be, where one of size h (s) has this error."""
        return h * growth_factor(max(error, NO_ERROR), self.order, self.safety)

    @property
    def tiny(self) -> float:
        """A step that is too small to matter, s."""
        return 1e-15 * self.span

    def rejected(self, t: float, h: float, error: float, cause: str) -> float:
        """Step after a rejected one. Raises ConvergenceError when steps have become too small to matter."""
        if self.given:
            raise ConvergenceError(f"The step of {h:g} s at t = {t:.9g} s has no end: {cause}.")
        self.rejections.append((t, h, cause))
        if cause == ESTIMATE and np.isfinite(error):
            least, most = REFUSED
            factor = min(max(growth_factor(error, self.order, self.safety), least), most)
        else:
            factor = 0.5 if len(self.rejections) < 3 else 0.1

        new = h * factor
        if t + 0.01 * new == t or new < self.tiny or len(self.rejections) > PATIENCE:
            tail = "; ".join(f"h = {x:.1e} s: {why}" for _, x, why in self.rejections[-5:])
            raise ConvergenceError(
                f"The step at t = {t:.9g} s cannot be made smaller: {len(self.rejections)} rejections, the last ones: {tail}. "
                + (f"{self.fault} " if self.fault else "")
                + "Where loads jump, or drives have kinks, tell it: Scene(breakpoints=...). Else look for a singular "
                "configuration at this time, or ask for a larger rtol."
            )
        return new


def first_step(norm: ErrorNorm, state: State, order: float, h_max: float) -> float:
    """An initial step from the sizes of velocity and acceleration (Hairer, Norsett, Wanner, Solving ODEs I, II.4, adapted).

    Collective where there are elastic fields. Beside frames the accelerations of deformations do not count: those of stiff
    vibrations fall to the error test.
    """
    sizes, deformations = norm.scale, norm.deformations
    if deformations.all():
        deformations = np.logical_not(deformations)

    def mean(x: Array) -> float:
        return norm.mean(np.where(deformations, 0.0, x / sizes))

    speed, push = mean(state.v), mean(state.a)
    share = norm.rtol ** (1.0 / order)
    h = h_max
    if speed > 0:
        h = min(h, 0.5 * share / speed)
    if push > 0:
        h = min(h, 0.5 * share / np.sqrt(push))
    return max(h, 1e-12 * h_max)


def turn_limit(system: System, state: State, *, steps: int = 1) -> float:
    """Largest step (s) in which, as it moves now, no frame in space turns by more than :data:`TURN` in that many steps.

    Local coordinates of rotations in space are singular a full turn away from their origin. In the plane there is no limit.
    """
    spin, push = (_rotations(system, x) for x in (state.v, state.a))
    if not len(spin):
        return np.inf
    w, e = (np.sqrt((x * x).sum(axis=1)) for x in (spin, push))
    # w h + e h^2 / 2 = TURN / steps
    turning = w + np.sqrt(w * w + 2.0 * e * TURN / steps)
    fastest = float(turning.max())
    return 2.0 * TURN / (steps * fastest) if fastest > 0 else np.inf


def turns_too_far(system: System, xi: Array) -> bool:
    """Whether increments, (..., n_v), come close to a full turn of a frame in space."""
    rotation = _rotations(system, xi)
    return bool((rotation * rotation).sum(axis=-1).max(initial=0.0) > (2.0 * TURN) ** 2)


def _rotations(system: System, x: Array) -> Array:
    """Components of all frames' rotations in space, (..., 3) of arrays like v; none in the plane."""
    m, n = system.motions, system.n_frames
    if m.dim == 2:
        return np.zeros((0, 3))
    return x[..., : n * m.n_twist].reshape(-1, m.n_twist)[:, m.dim :]


def moves(t: float, h: float, fault: str = "") -> None:
    """Refuse a step that does not change the time: accepted steps too can shrink without end. ``fault``: what is known of why."""
    if t + h == t:
        raise ConvergenceError(
            f"The step at t = {t:.9g} s has shrunk to h = {h:.1e} s: t + h == t. "
            + (f"{fault} " if fault else "")
            + "Take another form or scheme, or another rtol."
        )


def lands(h: float, left: float) -> float:
    """The step to take when ``left`` remains to a point that must be hit: no tiny last step, none beyond it but for roundoff."""
    if h >= left * (1 - 1e-10):
        return left
    return 0.5 * left if h > 0.5 * left else h
