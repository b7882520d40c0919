"""Memories of continuous laws at the points of an implicit step, which are found together.

With the memories z_i at the points, and those z_(n-l) where the last steps ended, the newest first,

    sum_j couple_ij z_j + sum_l past_il z_(n-l) = g(t_i, y_i, z_i)                                                     (1)

is the rule that the scheme has for its motion: collocation of Radau, differences of BDF. So memories are of the order of the
scheme. The error of a step, in the same form, is weighed by rtol times the largest memory so far. A memory that begins at zero
has no size yet: what the motion feels of it as a tenth of its own tolerance is one, :func:`.unfelt`.

The integral of a PID controller is kept by compiled steps as the structure PidMemory of ``tables.h``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ...errors import CallbackError
from ...mechanics.forces.formulas import MEMORY
from ...rotations import Array
from .control_laws import Answers, differences, solved
from .control_memory import PAST, ControllerMemory

SWEEPS = 100  # of all points
# shares of a memory that Newton's iteration may leave, and along which slopes tell what the law would answer
LEFT, NEAR = 1e-14, 1e-7
FADES = 0.95  # from step to step, of sizes that steps have foretold
TINY = float(np.finfo(float).tiny)
FALLS = 0.3  # share of what was left that slopes of one point may leave of all
FALLEN = 0.25  # share of what an increment along a point's own slopes promises, that it must keep
# of PidMemory: numbers before those of the past, points at most
HEAD, STAGES = 7, 7


@dataclass(frozen=True)
class PointRule:
    """(1) at the times ``t`` (k,), s: ``couple`` (k, k), and ``past`` (k, p) of where steps have ended, ``ends`` (p,); 1/s."""

    t: Array
    couple: Array
    past: Array
    ends: Array

    def follows(self, other: PointRule) -> bool:
        """Whether it is the same rule at the same times."""
        return np.array_equal(self.couple, other.couple) and np.array_equal(self.past, other.past)


@dataclass(frozen=True)
class StepError:
    """The error of a step: (frequency - dg/dz)^-1 (points . z_i + past . z_(n-l) + rate g_n); the sum itself for frequency 0.

    ``ends``: as of (1). ``rtol``, ``atol``: what it is measured by.
    """

    points: Array
    past: Array
    ends: Array
    rate: float
    frequency: float
    rtol: float
    atol: float


@dataclass
class PointMemories:
    """What a law has found for the points of a step from what was ``kept``: times, readings, z, u and g; one for all who ask it.

    ``reach``: by how much readings that change by what they are at least change the rates; None before slopes were asked for.
    ``least``: what sizes are at least; None before the first step.
    ``foretold``: sizes by steps from the newest memory, and what is left of earlier ones.
    ``lead``: by how much z answers to g where a tangent is taken, s; None: as the trapezoidal rule has it.
    """

    name: str
    kept: ControllerMemory | None = None
    rule: PointRule | None = None
    t: list[float] = field(default_factory=list)
    y: list[bytes] = field(default_factory=list)
    z: Array = field(default_factory=lambda: np.zeros((0, 0)))
    u: list[Array] = field(default_factory=list)
    rate: list[Array] = field(default_factory=list)
    slopes: list[Answers] | None = None  # du/dz and dg/dz at each point of this step
    reach: Array | None = None
    least: Array | None = None
    lead: float | None = None
    foretold: tuple[ControllerMemory | None, Array] = (None, np.zeros(1))

    def number(self, kept: ControllerMemory, t: float) -> int | None:
        """Which of the points a time is; None where it is none."""
        return self.t.index(t) if self.kept is kept and t in self.t else None

    def rule_at(self, kept: ControllerMemory, t: float) -> tuple[Array, float] | None:
        """How z = base + share g follows from readings at a time alone, base (m,) and share (s): at a point with others as they
        were found, or where a tangent is taken; None where the trapezoidal rule says it.
        """
        number = self.number(kept, t)
        if number is not None:
            assert self.rule is not None
            share = 1.0 / float(self.rule.couple[number, number])
            return self.z[number] - share * self.rate[number], share
        if self.lead is None or not t > kept.t:
            return None
        return kept.z + (t - kept.t - self.lead) * kept.rate, self.lead

    def find(
        self, kept: ControllerMemory, rule: PointRule, readings: Array, asked: Callable[[float, Array, Array], Answers]
    ) -> None:
        """Solve (1) for readings (k, size); ``asked``: (t, y, z) -> (u, g)."""
        t, y = [float(x) for x in rule.t], [y.tobytes() for y in readings]
        if self.kept is kept and (self.t, self.y) == (t, y) and self.rule is not None and self.rule.follows(rule):
            return
        laws = [partial(asked, t[i], readings[i]) for i in range(len(t))]
        # rates of an iterate that is far off would hide what is left
        least = np.maximum(self.sizes(kept, kept.t, kept.z), (t[-1] - kept.t) * self.widest(kept))
        equations = _Equations(self.name, t[-1], rule.couple, rule.past @ kept.ends(rule.ends), laws, least)

        begin = self.z if self.kept is kept and self.t == t else np.array([kept.foretold(x) for x in t])
        slopes = self.slopes if self.kept is kept and len(self.t) == len(t) else None
        self.z, answers, self.slopes = equations.solve(begin, slopes)
        self.u, self.rate = map(list, zip(*answers, strict=True))
        self.kept, self.rule, self.t, self.y = kept, rule, t, y

    def widest(self, kept: ControllerMemory) -> Array:
        """The largest ``reach`` so far."""
        return kept.reach if self.reach is None else np.maximum(kept.reach, self.reach)

    def sizes(self, kept: ControllerMemory, t: float, z: Array) -> Array:
        """What errors of a step from ``kept`` to t are measured by: the largest memories so far, and what rates add in it."""
        grows = np.maximum(np.abs(kept.rate), self.widest(kept))
        size = kept.size if self.least is None else np.maximum(kept.size, self.least)
        return np.maximum(np.maximum(size, np.abs(kept.z)), np.maximum(np.abs(z), (t - kept.t) * grows))

    def error(self, kept: ControllerMemory, of: StepError) -> float:
        """The largest error of a step that was found last, over the tolerance."""
        if self.kept is not kept:
            return 0.0
        off: Array = of.points @ self.z + of.past @ kept.ends(of.ends) + of.rate * kept.rate
        if of.frequency:
            assert self.slopes is not None
            off = solved(of.frequency * np.eye(len(off)) - self.slopes[-1][1], off)
        return self.measured(off, kept, (self.t[-1], self.z[-1]), of.rtol, of.atol)

    def measured(self, off: Array, kept: ControllerMemory, end: tuple[float, Array], rtol: float, atol: float) -> float:
        """The largest of errors (m,) of a step to an ``end``, t and z, over the tolerance.

        Where steps have led that were refused foretells a size, which fades from step to step: of a memory that leaves zero no
        error is small beside what it becomes within the step. One that has gone astray, by more than its size, leaves nothing.
        """
        size, (begun, foretold) = self.sizes(kept, *end), self.foretold
        if begun is not kept:
            foretold = FADES * np.resize(foretold, len(size))
        self.foretold = kept, np.maximum(foretold, np.where(np.abs(off) < size, size, 0.0))
        allowed = rtol * np.maximum(size, foretold) + atol
        counts = allowed != 0
        return float(np.max(np.abs(off[counts]) / allowed[counts], initial=0.0))


@dataclass(frozen=True)
class _Guess:
    """Memories z at the points (k, m), what laws answer, by how much (1) is missed, and what changes are measured by (m,)."""

    z: Array
    answers: list[Answers]
    miss: Array
    size: Array


@dataclass
class _Equations:
    """(1) of a step to ``t``: couple z + behind = g, with a law z_i -> (u, g) for each point; ``least``: sizes at least (m,)."""

    name: str
    t: float
    couple: Array
    behind: Array
    laws: Sequence[Callable[[Array], Answers]]
    least: Array
    sweeps: int = 0

    def __post_init__(self) -> None:
        self.without = solved(self.couple, self.behind)  # where no law acts

    def solve(self, z: Array, slopes: list[Answers] | None) -> tuple[Array, list[Answers], list[Answers]]:
        """Memories, answers and slopes at the points, from a first guess, by Newton's method.

        Slopes serve as long as they leave little of what was left before, then each point has its own.
        """
        at = self.at(z)
        slopes = slopes or self.slopes(at, -1) * len(z)
        before = np.inf
        while True:
            change, share = self.change(slopes, at)
            own = share > FALLS * before
            if own:
                slopes = self.slopes(at, *range(len(z)))
                change, share = self.change(slopes, at)

            if share <= LEFT:
                return at.z, at.answers, slopes
            if share <= NEAR and np.all(_largest(solved(self.couple, at.miss)) <= at.size):
                # along their slopes for the rest of the way
                return at.z - change, _along(at.answers, slopes, -change), slopes
            at = self.nearer(at, slopes, change, share) if own else self.at(at.z - change)
            before = share

    def at(self, z: Array) -> _Guess:
        """What is there with these memories."""
        self.sweeps += 1
        if self.sweeps > SWEEPS:
            raise CallbackError(
                f'Controller "{self.name}": its memory has no value up to t = {self.t:g} s. Is the law smooth in it?'
            )
        answers = [law(z[i]) for i, law in enumerate(self.laws)]
        miss = self.couple @ z + self.behind - np.array([rate for _, rate in answers])
        return _Guess(z, answers, miss, np.maximum(self.least, _largest(z + self.without)))

    def slopes(self, at: _Guess, *points: int) -> list[Answers]:
        """du/dz and dg/dz at these points."""
        return [differences(at.z[i], at.size, self.laws[i], at.answers[i]) for i in points]

    def change(self, slopes: list[Answers], at: _Guess) -> tuple[Array, float]:
        """By how much memories are off where (1) is, (k, m), and the largest share of their sizes."""
        k, m = at.miss.shape
        matrix = self.couple[:, None, :, None] * np.eye(m)[:, None, :]
        for i, (_, by_rate) in enumerate(slopes):
            matrix[i, :, i] -= by_rate
        change = solved(matrix.reshape(k * m, k * m), at.miss.ravel()).reshape(k, m)
        return change, _share(change, at.size)

    def nearer(self, at: _Guess, slopes: list[Answers], change: Array, share: float) -> _Guess:
        """Where a change leads, or half as far as often as slopes of where it comes from lead astray."""
        taken, guess = 1.0, self.at(at.z - change)
        while not self.change(slopes, replace(guess, size=at.size))[1] <= (1.0 - FALLEN * taken) * share:
            taken *= 0.5
            guess = self.at(guess.z + taken * change)
        return guess


def _along(answers: list[Answers], slopes: list[Answers], way: Array) -> list[Answers]:
    """Answers behind a way (k, m) of memories, by their slopes."""
    told = zip(answers, slopes, way, strict=True)
    return [(u + by_u @ x, rate + by_rate @ x) for (u, rate), (by_u, by_rate), x in told]


def _largest(x: Array) -> Array:
    """max |x| of points (k, m), (m,)."""
    return np.maximum.reduce(np.abs(x), axis=0)


def _share(change: Array, size: Array) -> float:
    """The largest change (k, m) over the sizes (m,)."""
    largest = _largest(change)
    moved = largest != 0
    return max((largest[moved] / np.maximum(size[moved], TINY)).tolist(), default=0.0)


# -- integrals of PID controllers, as compiled steps keep them ----------------------------------------------------
def integral_of(kept: ControllerMemory, points: PointMemories, reach: float, least: float) -> Array:
    """The numbers (1, MEMORY) of a memory, with what is known at points of the step under way; ``reach``: of its rate,
    ``least``: of its size.
    """
    out, count = np.zeros(MEMORY), len(kept.past)
    times, values, stages = out[HEAD:], out[HEAD + PAST :], out[HEAD + 2 * PAST :]
    out[:HEAD] = (*_numbers(kept.z, kept.rate), kept.t, max(kept.size[0], least), reach, count, kept.before[0])
    times[:count] = [t for t, _ in kept.past]
    values[:count] = [z[0] for _, z in kept.past]

    if points.kept is kept:
        known = len(points.t)
        stages[0] = known
        stages[1 : 1 + known] = points.t
        stages[1 + STAGES : 1 + STAGES + known] = points.z[:, 0]
    return out[None]


def memory_of(integral: Array, u: Array) -> ControllerMemory:
    """The memory of these numbers, with the efforts u."""
    z, rate, t, size, reach, count, before = (integral[0, i : i + 1].copy() for i in range(HEAD))
    times, values = np.split(integral[0, HEAD : HEAD + 2 * PAST], 2)
    past = tuple((float(at), values[i : i + 1].copy()) for i, at in enumerate(times[: int(count[0])]))
    return ControllerMemory(float(t[0]), z, rate, u, 0, past, before, size, reach)


def _numbers(*arrays: Array) -> list[float]:
    """Of arrays of one number."""
    return [float(x[0]) for x in arrays]
