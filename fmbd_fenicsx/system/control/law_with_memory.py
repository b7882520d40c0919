"""The law of a controller with its memory: what it answers to readings, asked once for each, and by what slopes.

Equations are those of :mod:`.controllers`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import CallbackError, LawError, excused, named
from ...rotations import Array
from .control_laws import PidLaw, differences, numbers_of, solved, unfelt
from .control_memory import ControllerMemory, StepMemory
from .memory_points import PointMemories, PointRule
from .readings import Readings

if TYPE_CHECKING:
    from .controllers import Controller

RECENT = 32  # answers of a law in one step that are kept


class LawWithMemory:
    """The law of a controller; ``kept`` as in :class:`.ControllerMemory`.

    What a continuous law reads is one array y, (size,), ``parts`` of which are the readings; a sampled one has none.
    """

    def __init__(self, controller: Controller, parts: Mapping[str, slice]) -> None:
        self.controller, self.name, self.acts, self.parts = controller, controller.name, len(controller.acts), parts
        self.law = named("The law of controller", self.name, controller.law, time=0)
        self.kept = self.begun(0.0)
        self._answers: dict[tuple[float, bytes], tuple[Array, Array, Array]] = {}  # u, z and g of (3) at t and y
        self._within = StepMemory(self.name, self.kept)  # of the step that they are of
        self.points = PointMemories(self.name)  # of copies too
        self.stated = isinstance(controller.law, PidLaw)  # whether its rate is known without asking
        self._slopes: tuple[Any, Array] | None = None

    def begun(self, t: float) -> ControllerMemory:
        """The memory that it begins with, at a time (s)."""
        z = np.asarray(self.controller.memory, dtype=float)
        return ControllerMemory(t, z, np.zeros_like(z), np.zeros(self.acts), 0)

    def ask(self, t: float, y: Mapping[str, Array], z: Array) -> tuple[Array, Array]:
        """Efforts (acts,) and rate (or next value) of the memory, checked; the law may write on the arrays of y."""
        try:
            found = self.law(t, Readings(y), z.copy())
        except LawError as error:
            if not isinstance(error.__cause__, IndexError):
                raise
            sizes = ", ".join(f'"{name}" {len(x)}' for name, x in y.items())
            raise LawError(
                f"{error}. What it reads holds so many numbers: {sizes}; a memory, {len(z)}. The rate of a joint coordinate is a "
                'reading of its own: reads={"rate": fmbd.joint_rate(...)}.'
            ) from error.__cause__
        if not len(z) and isinstance(found, tuple) and len(found) == 2 and isinstance(found[1], tuple) and not found[1]:
            found = found[0]  # an empty memory, returned as it was given
        # with a memory a law returns two things
        u, more = found if len(z) and isinstance(found, tuple) and len(found) == 2 else (found, None)
        if (more is None) != (not len(z)):
            wanted = "(efforts, rate of the memory)" if self.controller.every is None else "(efforts, memory)"
            raise CallbackError(f'Controller "{self.name}" keeps {len(z)} numbers: its law must return {wanted}.')

        efforts = numbers_of(self.name, "efforts", u, (self.acts, t))
        return efforts, z if more is None else numbers_of(self.name, "numbers of the memory", more, (len(z), t))

    def asked(self, t: float, y: Array, z: Array) -> tuple[Array, Array]:
        """What a continuous law answers at readings y, (size,)."""
        own = y.copy()
        try:
            return self.ask(t, {name: own[part] for name, part in self.parts.items()}, z)
        except (CallbackError, LawError) as error:
            raise excused(error, y, z) from error.__cause__

    def with_memory(self, t: float, y: Array) -> tuple[Array, Array, Array]:
        """u of a continuous law at time t, with z and g: as points of a step have it, else of (3); what was found is not asked
        for again.
        """
        points, known, keeps = self.points, y.tobytes(), bool(self.controller.memory)
        number = points.number(self.kept, t) if keeps else None
        if number is not None and points.y[number] == known:
            return points.u[number], points.z[number], points.rate[number]
        if self._within.kept is not self.kept or len(self._answers) > RECENT:
            self._answers, self._within = {}, StepMemory(self.name, self.kept)
        key = t, known
        found = self._answers.get(key)
        if found is None and (z := self.kept.within(t) if keeps else self.kept.z) is not None:
            u, rate = self.asked(t, y, z)
            found = self._answers[key] = u, z, rate

        if found is None:
            last = next(reversed(self._answers), None)  # of the same instant its memory is near
            start = self._answers[last][1] if last is not None and last[0] == t else None
            rule = points.rule_at(self.kept, t)
            found = self._answers[key] = self._within.at(t, partial(self.asked, t, y), start, rule)
        return found

    def collocate(self, rule: PointRule, readings: Array, places: Array) -> None:
        """The memory at the points of a step, of readings (k, size) there; ``places``: as of :func:`.unfelt`."""
        if self.points.least is None:
            self._weigh(float(rule.t[0]), readings[0], places)
        if self.controller.memory:
            self.points.find(self.kept, rule, readings, self.asked)
            self._answers = {}  # of points that were somewhere else

    def _weigh(self, t: float, y: Array, places: Array) -> None:
        """Find what sizes are at least, by the first readings of a run."""
        points, law = self.points, self.controller.law
        if self.kept.past:
            return
        if isinstance(law, PidLaw):
            points.least = law.unfelt(places)
        else:
            points.least = unfelt(partial(self.asked, t), y, self.kept.z, places)

    def trapezoid_error(self, t: float, y: Array, places: Array, rtol: float, atol: float) -> float:
        """The error of z by (3) in a step that ends at t with these readings, over the tolerance,

        (1 - h/2 dg/dz)^-1 h^3 / 6 g[t_n-1, t_n, t],     divided differences; rates before the first step as where it begins.
        """
        if self.points.least is None:
            self._weigh(t, y, places)
        (_, z, rate), kept, h = self.with_memory(t, y), self.kept, t - self.kept.t
        before, last = (kept.t - kept.past[0][0], kept.before) if kept.past else (h, kept.rate)
        off = h**3 / 6 * ((rate - kept.rate) / h - (kept.rate - last) / before) / (h + before)
        if self._within.slopes is not None:
            off = solved(np.eye(len(z)) - 0.5 * h * self._within.slopes, off)
        return self.points.measured(off, kept, (t, z), rtol, atol)

    def slopes(self, t: float, y: Array, spans: Array, *, quick: bool = False) -> Array:
        """du/dy, (acts, size), the memory going along: du/dy + du/dz (1 - w dg/dz)^-1 w dg/dy, w = h/2 in (3); what was found is
        not asked for again.

        ``spans``: what each number of y is at least for differences; ``quick``: these go to one side, enough for a step's
        matrix, with half the calls of the law.
        """
        key = self.kept, t, y.tobytes(), quick
        if self._slopes is None or self._slopes[0] != key:
            self._slopes = key, self._differences(t, y, spans, quick=quick)
        return self._slopes[1]

    def _differences(self, t: float, y: Array, spans: Array, *, quick: bool) -> Array:
        if not len(y):
            return np.zeros((self.acts, 0))
        (u, z, rate), rule = self.with_memory(t, y), self.points.rule_at(self.kept, t)
        half = 0.5 * (t - self.kept.t) if rule is None else rule[1]
        known = (u, rate) if quick else None
        by_memory: Array = np.zeros((self.acts, len(z)))
        if len(z) and half:
            effort, rate = differences(z, np.abs(half * rate), partial(self.asked, t, y), known)
            by_memory = half * solved((np.eye(len(z)) - half * rate).T, effort.T).T

        effort, rate = differences(y, spans, lambda y: self.asked(t, y, z), known)
        if len(z) and not self.stated:
            reach = np.abs(rate) @ spans
            self.points.reach = reach if self.points.reach is None else np.maximum(self.points.reach, reach)
        return effort + by_memory @ rate

    def after(self, t: float, y: Array) -> ControllerMemory:
        """What a continuous law keeps of a step that ended at t with these readings."""
        (u, z, rate), kept = self.with_memory(t, y), self.kept
        past, before = (kept.followed_by(), kept.rate) if t > kept.t else (kept.past, kept.before)
        points = self.points
        return ControllerMemory(t, z, rate, u, 0, past, before, points.sizes(kept, t, z), points.widest(kept))

    def keep(self, t: float, y: Array) -> None:
        """Keep it: where the step ends the law has answered already."""
        self.kept = self.after(t, y)
        self._within = StepMemory(self.name, self.kept)
        self._answers = {(t, y.tobytes()): (self.kept.u, self.kept.z, self.kept.rate)}
