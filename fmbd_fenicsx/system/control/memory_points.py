"""Memories of continuous laws at the points of an implicit step, which are found together.

With the memories z_i at the points, and those z_(n-l) where the last steps ended, the newest first,

    sum_j couple_ij z_j + sum_l past_il z_(n-l) = g(t_i, y_i, z_i)                                                     (1)

is the rule that the scheme has for its motion: collocation of Radau, differences of BDF. So memories are of the order of the
scheme. The error of a step, in the same form, is weighed by rtol times the largest memory so far. A memory that begins at zero
has no size yet: what the motion feels of it as a tenth of its own tolerance is one, :func:`.unfelt`.

The integral of a PID controller is kept by compiled steps as the structure PidMemory of ``tables.h``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
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
        t, k, y = [float(x) for x in rule.t], len(rule.t), [y.tobytes() for y in readings]
        if self.kept is kept and (self.t, self.y) == (t, y) and self.rule is not None and self.rule.follows(rule):
            return
        laws = [partial(asked, t[i], readings[i]) for i in range(k)]
        z = self.z if self.kept is kept and self.t == t else np.array([kept.foretold(x) for x in t])
        slopes = self.slopes if self.kept is kept and len(self.t) == k else None
        behind = rule.past @ kept.ends(rule.ends)
        left = solved(rule.couple, behind)
        # rates and places of an iterate that is far off would hide what is left
        least = np.maximum(self.sizes(kept, kept.t, kept.z), (t[-1] - kept.t) * self.widest(kept))
        before, own, size = np.inf, False, least
        step, taken = np.zeros_like(z), 1.0  # the newest increment, and the share of it that is taken

        for _ in range(SWEEPS):
            answers = [laws[i](z[i]) for i in range(k)]
            u, rates = (np.array(x) for x in zip(*answers, strict=True))
            earlier, size = size, np.maximum(least, _largest(z + left))
            if slopes is None:
                slopes = [differences(z[-1], size, laws[-1], answers[-1])] * k

            miss = rule.couple @ z + behind - rates
            change = _change(rule.couple, slopes, miss)
            share = _share(change, size)
            if own and not _share(change, earlier) <= (1.0 - FALLEN * taken) * before:
                # half as far: slopes of where it came from led astray
                taken, size = 0.5 * taken, earlier
                z = z + taken * step
                continue

            own = share > FALLS * before
            if own:  # each point has its own
                slopes = [differences(z[i], size, laws[i], answers[i]) for i in range(k)]
                change = _change(rule.couple, slopes, miss)
                share = _share(change, size)

            step, taken = change, 1.0
            if share > LEFT:
                z = z - change
            if share <= NEAR and (share <= LEFT or np.all(_largest(solved(rule.couple, miss)) <= size)):
                break
            before = share
        else:
            raise CallbackError(
                f'Controller "{self.name}": its memory has no value up to t = {t[-1]:g} s. Is the law smooth in it?'
            )

        # along their slopes for the rest of the way
        if share > LEFT:
            u = u - np.array([by_u @ x for (by_u, _), x in zip(slopes, change, strict=True)])
            rates = rates - np.array([by_rate @ x for (_, by_rate), x in zip(slopes, change, strict=True)])
        self.kept, self.rule, self.t, self.y = kept, rule, t, y
        self.slopes, self.z, self.u, self.rate = slopes, z, list(u), list(rates)

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
        return over(off, of.rtol * self.sizes(kept, self.t[-1], self.z[-1]) + of.atol)


def over(off: Array, allowed: Array) -> float:
    """The largest of errors (m,) over what is allowed (m,), where that is no zero."""
    counts = allowed != 0
    return float(np.max(np.abs(off[counts]) / allowed[counts], initial=0.0))


def _change(couple: Array, slopes: list[Answers], miss: Array) -> Array:
    """By how much memories are off where (1) is off by ``miss`` (k, m)."""
    k, m = miss.shape
    matrix = couple[:, None, :, None] * np.eye(m)[:, None, :]
    for i, (_, by_rate) in enumerate(slopes):
        matrix[i, :, i] -= by_rate
    return solved(matrix.reshape(k * m, k * m), miss.ravel()).reshape(k, m)


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
