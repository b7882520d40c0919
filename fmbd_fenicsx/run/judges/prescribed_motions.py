"""Are prescribed motions smooth, and their rates the derivatives of what they prescribe? Looked at along a run.

Of a smooth motion the parabola through three places foretells the fourth,

    B = |s_3 - P(t_3)|  =  O(h^3 s''')                                                                            (1)

Where B is large beside the motion in these steps, they are looked at closely: the interval is narrowed twenty times to the half
in which the motion bends most. What is left there of a change of s is a jump, of a change of its slope a kink: seen again over
wider places, for over the narrowest the roundoff of a law bends as sharply. And rates that are given have to agree with the
motion,

    D = |s_b - s_a - h/2 (s'_a + s'_b) + h^2/12 (s''_b - s''_a)| + h |s'_b - s'_a - h/2 (s''_a + s''_b)|  =  O(h^3)   (2)

Where D is large, and at some steps in any case, they are compared with slopes by differences of fourth order, at three places
of a step and two widths; where all of them differ the rates contradict the motion.

Jumps that no body can follow and contradictions end the run. Small jumps and kinks are warned of: they are impacts, and forces
beside them depend on the step. Equal steps pass over them, with errors of first order, where no break point is. Steps of a
scheme's own choice end at those of a whole run, as at break points: error control would only creep up to them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from ...errors import InputError, LawError
from ...log import log
from ...mechanics.joints.constraints import Perpendicular
from ...mechanics.joints.couplings import CouplingBatch, SmoothMotion
from ...mechanics.joints.drives import Coupling
from ...rotations import Array
from ...system.scene.scene import Scene
from ...system.system import System
from ..schedule import StepSchedule

DOUBTFUL = 2e-3  # (1), (2) over the motion in the steps, from which on they are looked at closely
SHARP = 0.01  # change of slope over the slopes that is a kink
WIDER = (16, 64)  # times the width at which a kink is seen again
JUMP = 1e-3  # of the model's length, or rad: a jump that is refused
SEEN = 1e-12  # of the same: what moves less in three steps is looked at later; it may be a motion that begins slowly
WRONG = 1e-3  # relative difference of a rate from the slope
HALVINGS = 20
SMOOTH = 8  # halvings from which on an interval is given up, in which slopes change by less than any kink
LOOKS = 40  # close looks at one motion that found nothing; afterwards only worse steps are looked at
KINKS = 100  # of one motion, after which no more are looked for
MOST = 5000  # places in a run with constant steps
STATED = 1e-6  # of a time: a kink that is so near to one that was stated is that one
AHEAD = 1000  # places at the start of a run whose steps are not known
PLACES = (0.29, 0.53, 0.83)  # of a step, where rates are compared with slopes
APART = 5e-7  # of the model's length, or rad: drives of one coordinate that differ by more contradict each other
EPS = float(np.finfo(float).eps)


@dataclass
class Follower:
    """One motion and what was seen of it; ``length``: what a jump is measured by (m, or 1 rad)."""

    motion: SmoothMotion
    length: float
    stated: tuple[float, ...] = ()  # times (s) of which the user has said that motions are not smooth there
    equal: bool = False  # whether steps are of one size, which pass over what is sharp
    times: Array = field(default_factory=lambda: np.zeros(0))  # of the last three places
    places: Array = field(default_factory=lambda: np.zeros(0))
    rates: Array = field(default_factory=lambda: np.zeros((0, 3)))  # s, s', s'' at the last place, where they are given
    fastest: float = 0.0
    looks: int = 0
    sharp: list[float] = field(default_factory=list)  # times (s) of kinks and jumps
    worst: float = 0.0
    steps: int = 0
    compared: int = 0

    @property
    def name(self) -> str:
        """Whose motion, for messages."""
        return f'{self.motion.of} "{self.motion.name}"'

    def look(self, times: Array) -> None:
        """Look at the steps that end at these times (n,) s, up to one at which the motion cannot be told."""
        motion, told = self.motion, []
        try:
            for t in map(float, times):
                told.append(motion(t) if motion.complete else motion.place(t))
        finally:
            self._look_at(times[: len(told)], np.array(told))

    def _look_at(self, times: Array, told: Array) -> None:
        """The same of what the motion is there, (n,), or (n, 3) with its rates."""
        if not len(times):
            return
        known = len(self.times)
        t = np.concatenate((self.times, times))
        s = np.concatenate((self.places, told.reshape(len(times), -1)[:, 0]))
        h = np.diff(t)
        slopes = np.concatenate(([self.fastest], abs(np.diff(s) / h)))
        slopes[1:known] = 0.0
        fastest = np.maximum.accumulate(slopes)

        # of the step that ends at each place; the first three have no parabola
        bends, defects = np.zeros(len(t)), np.zeros(len(t))
        bends[3:] = _bends(t, s, fastest, self.length)
        steps = self.steps + 1 + np.arange(len(t)) - max(known, 1)
        doubtful = bends > DOUBTFUL
        if told.ndim == 2:
            rates = np.concatenate((self.rates, told))
            behind = len(t) - len(rates) + 1
            defects[behind:] = _defects(rates, h[behind - 1 :], fastest[behind:])
            doubtful |= (defects > DOUBTFUL) | (steps & (steps - 1) == 0)
            self.rates, self.steps = rates[-1:], int(steps[-1])

        smooth = 0  # place from which on nothing sharp is known
        for i in np.flatnonzero(doubtful[max(known, 1) :]) + max(known, 1):
            self.fastest = float(fastest[i])
            if (
                bends[i] > DOUBTFUL
                and i - 3 >= smooth
                and len(self.sharp) < KINKS
                and self._is_sharp(t[i - 3], t[i], bends[i])
            ):
                smooth = int(i)  # the same one is not found again
            if told.ndim == 2:
                self._look_at_rates(int(steps[i]), (float(t[i - 1]), float(h[i - 1])), float(defects[i]))
        first = max(smooth, len(t) - 3)
        self.times, self.places, self.fastest = t[first:], s[first:], float(fastest[-1])

    # -- kinks and jumps --------------------------------------------------------------------------------------------
    def _is_sharp(self, a: float, b: float, bend: float) -> bool:
        """Whether there is a kink or a jump in three steps between two times (s), for which (1) is so large."""
        if self.looks >= LOOKS and bend <= 2 * self.worst:
            return False
        if self.find_sharp(float(a), float(b)):
            return True
        self.looks += 1
        self.worst = max(self.worst, float(bend))
        return False

    def find_sharp(self, a: float, b: float) -> bool:
        """Whether there is a kink or a jump between two times (s): warns of it, or refuses it."""
        try:
            found = self._sharpest(a, b)
            if found is None:
                return False
            a, b, steepest = found
            place, width = self.motion.place, b - a
            places = [place(a - width), place(a), place(b), place(b + width)]
            wider = [place(b + w * width) - place(b) - (place(a) - place(a - w * width)) for w in WIDER]
        except LawError:  # beyond the times at which it can be called
            return False

        before, step, after = (y - x for x, y in pairwise(places))
        turn, around = after - before, max(abs(before), abs(after))
        noise = 100 * EPS * max(*map(abs, places), abs(a) * self.fastest)

        if abs(step - 0.5 * (before + after)) > max(10 * abs(turn) + around + noise, SEEN * self.length):
            self._jump(0.5 * (a + b), step)
            return True
        # over wider places a kink turns in proportion, roundoff does not
        grows = all(abs(x - w * turn) <= 0.5 * w * abs(turn) for w, x in zip(WIDER, wider, strict=True))
        slopes = max(around, 0.1 * width * max(self.fastest, steepest))
        if grows and abs(turn) > SHARP * slopes + noise:
            # where lines through the places of either side meet
            meet = a + (places[2] - places[1] - after * (b - a) / width) / (before - after) * width
            self._kink(min(max(meet, a), b), before / width, after / width)
            return True
        return False

    def _sharpest(self, a: float, b: float) -> tuple[float, float, float] | None:
        """The part of an interval, 2^-20 of it or some thousand roundings of time, in which the motion bends most; and the
        steepest slope on the way there. None where a part bends by less than half of the least kink: of smooth motions slopes
        change in proportion to the width, at a kink they do not.
        """
        place, steepest = self.motion.place, 0.0
        known: list[float] = []  # the last part's places at its ends and in its middle
        for halving in range(HALVINGS):
            quarter = 0.25 * (b - a)
            if quarter < 1e3 * EPS * max(abs(a), abs(b)):
                break

            begin, middle, end = known or [place(a), place(a + 2 * quarter), place(b)]
            v = [begin, place(a + quarter), middle, place(a + 3 * quarter), end]
            steepest = max(steepest, *(abs(x - y) / quarter for x, y in pairwise(v)))
            bends = [abs(x - 2 * y + z) for x, y, z in zip(v, v[1:], v[2:], strict=False)]
            if halving >= SMOOTH and sum(bends) <= 0.05 * SHARP * quarter * max(self.fastest, steepest):
                return None

            k = bends.index(max(bends))
            a, b, known = a + k * quarter, a + (k + 2) * quarter, v[k : k + 3]
        return a, b, steepest

    def _jump(self, t: float, size: float) -> None:
        if abs(size) > JUMP * self.length:
            raise InputError(
                f"The motion of {self.name} jumps by {size:.3g} at t = {t:.6g} s: no body can follow. Let it change over a "
                "time, say by a smooth step."
            )
        self.sharp.append(t)
        log.warning(
            "the motion of %s jumps by %.3g at t = %.6g s: %s", self.name, size, t, self._impact(t),
        )  # fmt: skip

    def _kink(self, t: float, before: float, after: float) -> None:
        self.sharp.append(t)
        if any(abs(t - stated) <= STATED * abs(stated) for stated in self.stated):
            return
        log.warning(
            "the motion of %s has a kink at t = %.6g s, its rate changes from %.4g to %.4g 1/s: %s",
            self.name, t, before, after, self._impact(t),
        )  # fmt: skip

    def _impact(self, t: float) -> str:
        """What something sharp at t (s) does, and what helps."""
        told = "it is an impact, and forces beside it depend on the step"
        if not self.equal:
            return told
        return (
            f"{told}. Equal steps pass over it, which leaves an error of first order in all motion behind it: name it, "
            f"Scene(breakpoints=[{t:.9g}]), so that steps end there, or take a scheme that chooses its steps (rtol)"
        )

    # -- rates ----------------------------------------------------------------------------------------------------
    def _look_at_rates(self, number: int, step: tuple[float, float], defect: float) -> None:
        """Compare at steps 1, 2, 4, 8 ...: rates that are wrong are mostly wrong everywhere. And where (2) is large.

        ``number``: of the step, which begins at a time (s) and has a size (s).
        """
        if number >= 2**self.compared or (defect > DOUBTFUL and self.compared < LOOKS):
            self.compared += 1
            self._compare(1, "rate", "motion", step)
            self._compare(2, "second rate", "rate", step)

    def _compare(self, level: int, what: str, of: str, step: tuple[float, float]) -> None:
        """Refuse a rate that is not the slope of what it belongs to, at any of three places of a step."""
        a, h = step
        found = []
        for k in PLACES:
            apart = self._apart(level, a + k * h, h)
            if apart is None:
                return
            found.append(apart)
        t, given, slope = found[0]
        raise InputError(
            f"The {what} of {self.name} contradicts its {of}: at t = {t:.6g} s it is given as {given:.6g} and is {slope:.6g} by "
            "differences. Return s alone, and its rates are computed; or return its derivatives."
        )

    def _apart(self, level: int, t: float, h: float) -> tuple[float, float, float] | None:
        """Time, rate as given and slope, where these two differ whatever the width of the difference."""
        given = self.motion(t)[level]
        slope = 0.0
        for width in (h / 16, h / 256):
            v = [self.motion(t + k * width)[level - 1] for k in (-2, -1, 1, 2)]
            # differences of fourth order, and what they may miss by roundoff
            slope = (v[0] - 8 * v[1] + 8 * v[2] - v[3]) / (12 * width)
            noise = 20 * EPS * (max(map(abs, v)) + abs(t) * self.fastest) / width
            least = 1e-6 * self.fastest * (1.0 if level == 1 else 1.0 / h)
            if abs(slope - given) <= WRONG * max(abs(slope), abs(given), least) + noise:
                return None
        return t, given, slope


def _bends(t: Array, s: Array, fastest: Array, length: float) -> Array:
    """B of (1) over the motion in three steps, at each place (n,) behind the first three."""
    (t0, t1, t2, t3), (s0, s1, s2, s3) = ([x[i : len(x) - 3 + i] for i in range(4)] for x in (t, s))
    if not len(t3):
        return t3

    # Newton's form of the parabola through the first three places
    first = (s1 - s0) / (t1 - t0)
    second = (s2 - s1) / (t2 - t1)
    bend = (second - first) / (t2 - t0)
    parabola = s1 + (t3 - t1) * (second + (t3 - t2) * bend)

    # against what has moved, where that is more than roundoff
    four = np.array((s0, s1, s2, s3))
    size = np.ptp(four, axis=0) + 1e-3 * (t3 - t0) * fastest[3:]
    roundoff = 1e3 * EPS * abs(four).max(axis=0)
    moves = size > np.maximum(roundoff, SEEN * length)
    return np.where(moves, np.maximum(abs(s3 - parabola) - roundoff, 0.0) / np.where(moves, size, 1.0), 0.0)


def _defects(rates: Array, h: Array, fastest: Array) -> Array:
    """D of (2) over the motion in the steps of sizes h (n,) between places (n + 1, 3)."""
    (s0, r0, a0), (s1, r1, a1) = rates[:-1].T, rates[1:].T
    # Hermite's rule for s, the trapezoid rule for s'
    place = abs(s1 - s0 - 0.5 * h * (r0 + r1) + h * h / 12 * (a1 - a0))
    rate = h * abs(r1 - r0 - 0.5 * h * (a0 + a1))

    size = abs(s1 - s0) + h * (abs(r0) + abs(r1) + 1e-3 * fastest)
    roundoff = 1e3 * EPS * (abs(s0) + abs(s1))
    moves = size > roundoff
    return np.where(moves, (place + rate - roundoff) / np.where(moves, size, 1.0), 0.0)


class PrescribedMotions:
    """All prescribed motions of a scene, looked at from t (s) on; ``planned`` steps of the run, 0 where they are not known."""

    def __init__(self, scene: Scene, system: System, t: float, *, planned: int = 0) -> None:
        self.time, self._begun, self.every = t, t, max(1, planned // MOST)
        stated = tuple(scene.breakpoints)
        found: dict[int, Follower] = {}
        for motion, length in prescribed(system):
            if isinstance(motion, SmoothMotion):
                found.setdefault(id(motion), Follower(motion, length, stated, bool(planned)))

        self.followers = list(found.values())
        self.rivals = [(found[i], found[j], name) for i, j, name in _rivals(scene) if i in found and j in found]

        for follower in self.followers:
            follower.look(np.array([t]))

    def ahead(self, t_end: float) -> tuple[float, ...]:
        """Look at all of a run whose steps are not known, see :meth:`look`; times (s) of kinks and jumps in it, on either side of
        which rates are from now on those of that side.
        """
        self.look(t_end, AHEAD)
        for follower in self.followers:
            follower.motion.smooth.break_at(follower.sharp)
        return tuple(sorted({t for follower in self.followers for t in follower.sharp if self._begun < t < t_end}))

    def look(self, t: float, steps: int = 1) -> None:
        """Look at the motions from where they were looked at last up to t (s), the end of so many steps.

        Raises InputError where a motion jumps, its rates contradict it, or two drives of one coordinate contradict each other.
        """
        if not self.followers or not t > self.time:
            return
        count = max(1, steps // self.every)
        # a last step may pass the end by a rounding, which holds few numbers
        times = np.unique(np.linspace(self.time, t, count + 1))[1:] if count > 1 else np.array([t])
        for some in np.array_split(times, len(times) if self.rivals else 1):
            for follower in self.followers:
                follower.look(some)
            for one, other, joint in self.rivals:
                _compare_drives(one, other, joint)
        self.time = t


def ending_at_kinks(schedule: StepSchedule, scene: Scene, system: System) -> StepSchedule:
    """A schedule whose steps, of a scheme's own choice, end where prescribed motions have kinks; warns of these."""
    if schedule.steps:
        return schedule
    found = PrescribedMotions(scene, system, schedule.begin).ahead(schedule.t_end)
    apart = [t for t in found if not any(abs(t - stop) <= STATED * stop for stop in schedule.stops)]
    return replace(schedule, stops=tuple(sorted((*schedule.stops, *apart))))


def _compare_drives(one: Follower, other: Follower, joint: str) -> None:
    """Refuse two drives of one coordinate that ask for different places."""
    first, second = one.places[-1], other.places[-1]
    if abs(first - second) > APART * one.length + 1e3 * EPS * (abs(first) + abs(second)):
        raise InputError(
            f'The drives "{one.motion.name}" and "{other.motion.name}" move the same coordinate of joint "{joint}" and '
            f"contradict each other: at t = {one.times[-1]:.6g} s one asks for {first:.9g}, the other for {second:.9g}. "
            "Remove one of them."
        )


def _rivals(scene: Scene) -> list[tuple[int, int, str]]:
    """Motions of drives that act on the same coordinate alone, and its joint."""
    acting: dict[tuple[int, Any], list[Any]] = {}
    for joint in scene.joints.values():
        if not isinstance(joint, Coupling) or joint.motion is None:
            continue
        # a combination, or a multiple, of coordinates has a motion of its own
        (coordinate, factor), *more = joint.terms
        if factor == 1.0 and not more:
            acting.setdefault((id(coordinate.joint), coordinate.kind), []).append(joint)
    pairs = [(js[0], other) for js in acting.values() for other in js[1:]]
    return [(id(one.motion), id(other.motion), one.terms[0][0].joint.name) for one, other in pairs]


def prescribed(system: System) -> list[tuple[Any, float]]:
    """Motions and what jumps of them are measured by, m or rad; all ranks alike."""
    out: list[tuple[Any, float]] = []
    for batch, _ in system.batches:
        angles: set[int] = set()
        if isinstance(batch, Perpendicular):
            angles = {i for i, _ in batch.driven}
        elif isinstance(batch, CouplingBatch):
            for relative, numbers, _ in batch.terms:
                angles |= {int(i) for i in numbers} if relative.angular else set()
        out += [(motion, 1.0 if i in angles else system.length) for i, motion in batch.driven]
    return out + [(tie.motion, system.length) for tie, _ in system.traces]
