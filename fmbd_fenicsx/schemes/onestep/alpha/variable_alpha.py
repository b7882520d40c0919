"""Generalized-alpha with steps of its own choice: nested parts of the stretch to the next point that must be hit.

A stretch of length R is divided into 1, 2, 6, 12, 36, ... parts, and every step is one of these, begun at a multiple of its own
size. So the end of the stretch is hit without a step of another size, and there are fewer than three sizes, and with them elastic
factors, in a decade; factors stay for the sizes in use.

Two quantities of the scheme belong to a step size. With r = h_new / h_old

    A  <-  a + r (A - a),                     as  A_n = a(t_n + (alpha_m - alpha_f) h) + O(h^2)                        (1)
    v  <-  v + dv,   (M + S K) dv + G^T mu = 0,   G dv = (r^2 - 1) (G v + g_t)                                         (2)

at a change of size: velocities of the index-3 form miss their constraints by a multiple of h^2. Without (1) and (2) the order
falls to one. S is that of a step over the whole stretch, so that (2) moves elastic bodies as if they were rigid: with M alone it
bends them, and they vibrate from then on, by ten times the error of equal steps.

The error of a step is that of the positions, filtered by the matrix of the step, so that vibrations which the step damps do not
count:

    (M + s K) e + G^T mu = M h^2 (beta - 1/6) (A_n+1 - A_n),     G e = h/2 (G v + g_t)                                 (3)

Positions meet their constraints; what velocities miss them by, of order h^2, tells how far the motion within a step is from the
one that they prescribe. Without it a mechanism without freedom, all of whose places its drives give, took one step for three
turns. Rows on velocities hold no places, and velocities of the stabilised form miss nothing: across these e is as it were without
constraints, G e = h^2 (beta - 1/6) G (A_n+1 - A_n). The slopes of places miss the constraints by a higher order: with these for v
driven mechanisms took half the steps and had four times the error.

Sources: Bruels and Arnold, doi:10.1115/1.2960475 (variable steps); Zienkiewicz and Xie, doi:10.1002/eqe.4290200907 (the
error); Shampine and Baca, doi:10.1145/357456.357462 (filters).
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ....errors import ConvergenceError, LinearSolveError
from ....linear.condensation import StepSolver
from ....rotations import Array
from ....system.element_memory import whole_steps
from ....system.evaluation import Evaluation
from ....system.serialisation import Memory, plain, worker
from ....system.system import State, System
from ...consistent import consistent
from ...control import FADING, NormOfWays, Statistics, StepControl, first_step, moves, turn_limit
from ...dae import GGL
from ...newton import Newton
from ...stepping import TimeStepper
from .look_ahead import LookAhead

if TYPE_CHECKING:
    from ....run.judges.energy_check import Watch
    from ....system.compiled.recording import Openness, Tape
    from .compiled_control import CompiledControl, Stay
    from .generalized_alpha import GeneralizedAlpha

KEPT = 9  # sets of elastic factors: those of eight sizes, and that of the whole stretch
DEEPEST = 48  # levels of parts; the finest are below roundoff
CALM = 0.01  # errors of late over what is allowed, below which nothing happens
# share of the present size that a proposal must have for this size to stay: an error of 0.9 is expected then
KEEPS = 0.93
FARTHEST = 10.0  # times the least motion that closes constraints: one that bends bodies less may be as large
SAME = 1e-9  # lengths of a stretch that differ by this share are equal
HELD = 10.0  # times its length that a step is held for too long in which M is lost beside s K


def parts(level: int) -> int:
    """Number of parts of a stretch: 1, 2, 6, 12, 36, ..."""
    return int(6 ** (level // 2) * (2 if level % 2 else 1))


def _keep_share(m: Memory, name: str, share: Fraction) -> Fraction:
    """An exact share."""
    above, below = m(name, (share.numerator, share.denominator))
    return Fraction(int(above), int(below))


class VariableAlpha(TimeStepper):
    """Drives a stepper of constant steps: chooses its steps, and moves its memory from one size to another."""

    keeps: ClassVar = {
        "inner": worker,
        "norm": worker,
        "control": plain(StepControl),
        "stats": plain(Statistics),
        **dict.fromkeys(
            ("proposed", "size", "largest", "lost", "local_error", "error", "peak", "stretch", "end"), plain()
        ),
        "place": _keep_share,
    }

    def __init__(
        self, scheme: GeneralizedAlpha, system: System, solver: StepSolver, newton: Newton, state: State
    ) -> None:
        assert scheme.rtol is not None
        self.scheme, self.system, self.solver, self.newton = scheme, system, solver, newton
        self.constant = replace(scheme, rtol=None, atol=None)
        self.inner: Any = self._steps(state)

        self.norm = NormOfWays(system, scheme.rtol, scheme.atol, 3)
        self.look = LookAhead(system, solver, self.norm, lambda h: scheme.rule(h).weights)
        self.control = StepControl(3.0)
        self.stats = Statistics()
        self.local_error = self.error = 0.0  # the largest since :meth:`advance`, and that of the newest step
        self.peak = 0.0  # the largest error of late
        self._compiled: CompiledControl | None = None

        self.proposed: float | None = None
        self.size: float | None = None  # of the last step, s
        self._seen: tuple[State, Evaluation] | None = None
        self.largest = 0.0  # step in which loads were looked at, s
        self.lost: tuple[float, float] | None = None  # size of a step in which M is lost beside s K, and until when, s

        self.stretch, self.place, self.end = 0.0, Fraction(0), 0.0  # length, share of it that is done, its end
        # sizes come back: factors of the last few are kept
        solver.elastic.kept = max(solver.elastic.kept, KEPT)

    def _steps(self, start: State) -> Any:
        """The stepper of one size from a consistent state; errors are solved for between its steps."""
        return self.constant.steps((self.constant, self.system, self.solver, self.newton, start), alone=False)

    @property
    def state(self) -> State:
        """The newest state."""
        return self.inner.state  # type: ignore[no-any-return]

    @state.setter
    def state(self, state: State) -> None:
        self.inner.state = state

    @property
    def evaluation(self) -> Evaluation | None:
        """The system in the newest state; None where elements have a memory, which moves on later."""
        s = self.state
        if self.system.keepers:
            return None
        if self._seen is None or self._seen[0] is not s:
            self._seen = s, self.system.at(s.t, s.q, s.v)
        return self._seen[1]

    @property
    def counters(self) -> dict[str, float]:
        """Work so far, rejections by their cause."""
        counted = {"steps", "rejections"} | {f"rejected: {cause}" for cause in self.stats.rejected}
        own = {k: x for k, x in self.stats.as_dict().items() if k in counted}
        return {**self.inner.counters, **own}

    def restart(self, t: float) -> None:
        """Go on behind a jump of forces: consistent accelerations and multipliers, a new stretch, small steps at first."""
        start, _ = consistent(self.system, replace(self.state, t=t), self.solver, h=self.size or 0.0)
        self.inner = self._steps(start)
        self.size = self.proposed = None
        self.stretch, self.place = 0.0, Fraction(0)
        self.control.h_old = self.peak = 0.0

    def between(self, t: float) -> State | None:
        """The state at a time t (s) within the last step."""
        return self.inner.between(t)  # type: ignore[no-any-return]

    # -- one accepted step --------------------------------------------------------------------------------------------
    def advance(self, h: float) -> State:
        """One accepted step of at most h (s), which is hit exactly at the end of the stretch; collective.

        Raises ConvergenceError when steps would have to be too small.
        """
        s = self.state
        self._follow(s.t, h)
        self.control.span = max(self.control.span, h)
        if self.proposed is None:
            self.norm.look_ahead(s, h)
            self.norm.update(s, h)
            self.proposed = first_step(self.norm, s, 3.0, h)

        farthest = turn_limit(self.system, s)
        while True:
            level = self._level(min(self.proposed, farthest))
            h = self.stretch / parts(level)
            moves(s.t, h)
            if not self._is_looked_at(h):
                farthest = min(farthest, self.look.farthest(s, h))
                if farthest < h:
                    continue
            self.solver.near_singular.begin_trial()
            try:
                error, cause = self._ahead(h), "a load within the step"
            except LinearSolveError as failure:
                error, cause = np.inf, self._losing(h, failure)
            if error <= 1.0:
                error, cause = self._attempt(h, level)
            if error <= 1.0:
                self.solver.near_singular.accept_trial()
                break
            self.stats.rejected[cause] += 1
            self.proposed = min(self.control.rejected(s.t, h, error, cause), 0.9 * h)

        self.local_error, self.peak = error, max(error, FADING * self.peak)
        self._count(h, error, Fraction(1, parts(level)))
        return self.state

    def _count(self, h: float, error: float, way: Fraction, steps: int = 1) -> None:
        """So many accepted steps of size h (s), which are a share of the stretch; the error of the newest."""
        self.stats.steps += steps
        self.error, self.proposed = error, self.control.accepted(h, error)
        # errors of vibrations pass through zero: no sign that larger steps will do
        if self.proposed > h:
            self.proposed = max(h, min(self.proposed, self.control.largest(h, self.peak)))
        if KEEPS * h <= self.proposed < h:  # the next smaller size is a half or a third
            self.proposed = h
        self.place += way

    def _follow(self, t: float, left: float) -> None:
        """Begin a new stretch where the last one has ended, or where an earlier end is asked for. So steps with a limit, for
        which what is left is always the same, are parts of one stretch after another.
        """
        if self.place < 1 and self.stretch > 0 and self.end - t <= left + SAME * self.stretch:
            return
        if abs(self.stretch - left) > SAME * left:  # else its factors serve again
            self.stretch = left
        self.place, self.end = Fraction(0), t + left

    def _level(self, wanted: float) -> int:
        """The coarsest parts that are no larger than a step wanted, and of which one begins here."""
        for level in range(DEEPEST):
            size = self.stretch / parts(level)
            if size <= wanted and not self._loses(size) and (self.place * parts(level)).denominator == 1:
                return level
        return DEEPEST

    def _loses(self, h: float) -> bool:
        """Whether M is known to be lost beside s K in a step of size h (s); its factor need not be tried."""
        return self.lost is not None and h >= self.lost[0] * (1 - SAME) and self.state.t < self.lost[1]

    def _losing(self, h: float, failure: LinearSolveError) -> str:
        """A step of size h (s) in which M is lost beside s K, and with it the motion of a free body: how that is counted."""
        self.control.fault, self.lost = str(failure), (h, self.state.t + HELD * h)
        return "linear solve failed"

    def _arrive(self, place: Fraction) -> None:
        """Give the state at the end of a step the time that the parts tell."""
        t = self.end if place == 1 else self.end - self.stretch * float(1 - place)
        if self.state.t != t:
            self._move(replace(self.state, t=t))

    def _move(self, state: State, A: Array | None = None) -> None:
        """Give the stepper a state and an algorithmic acceleration in the place of its own."""
        kept = self.inner.A if A is None else A
        past = self.inner._past
        self.inner.state, self.inner.A, self.inner._past = state, kept, past

    def _ahead(self, h: float) -> float:
        """What a load within a step moves, in the norm of errors; 0 without a look, where much happens and no step was as large
        before.
        """
        if self._is_looked_at(h):
            return 0.0
        error = self.look.loads(self.state, h)
        if error <= 1.0:
            self.largest = max(self.largest, h)
        return error

    def _is_looked_at(self, h: float) -> bool:
        """Whether loads within a step of size h (s) need no look."""
        return h <= self.largest and self.peak > CALM

    # -- many steps in compiled code ------------------------------------------------------------------------------------
    def stride(self, h: float) -> float:
        """Size (s) of the steps that :meth:`march` makes next, where h is the most; 0 where :meth:`advance` has to."""
        level = self._next_level(h)
        return 0.0 if level is None else self.stretch / parts(level)

    def _next_level(self, h: float) -> int | None:
        """The parts of the stretch that these steps are; None where there are none."""
        s = self.state
        self._follow(s.t, h)
        if self.proposed is None or self.size is None or not self._marches:
            return None
        level = self._level(min(self.proposed, turn_limit(self.system, s)))
        size = self.stretch / parts(level)
        return level if size == self.size and self._is_looked_at(size) else None

    @property
    def _marches(self) -> bool:
        """Whether compiled code knows memories and all local coordinates: they are deformations."""
        remembered = self.inner.keeps_memories or not self.system.keepers
        return remembered and len(self.norm.deforming) == len(self.system.parts)

    def march(
        self, h: float, steps: int, watch: Watch | None = None, tape: Tape | None = None, closed: Any = None
    ) -> int:
        """Up to so many accepted steps of one size, at most h (s), in one call of compiled code, as :meth:`advance` makes one;
        fewer where the size may change or a step is refused.
        """
        level = self._next_level(h)
        if level is None:
            return 0
        count = parts(level)
        size, place = self.stretch / count, int(self.place * count)
        steps = int(min(steps, count - place, whole_steps(self.system, self.state.t, size)))
        if steps <= 0:
            return 0

        control = self._control()
        control.lend(self._stay(level, place))
        made: int = self.inner.controlled(size, steps, control, watch, tape)
        if made:
            control.take()
            self.peak = control.c.peak
            self.local_error = max(self.local_error, control.c.largest)
            self._count(size, control.c.error, Fraction(made, count), made)
            self._arrive(self.place)
        return made

    def _control(self) -> CompiledControl:
        """What lends the controller to compiled code."""
        if self._compiled is None:
            from .compiled_control import CompiledControl

            self._compiled = CompiledControl(self.norm, self.control)
        return self._compiled

    def _stay(self, level: int, place: int) -> Stay:
        """Up to when steps keep the present size, that of the parts of a level, of which ``place`` are behind."""
        from .compiled_control import Stay

        count = parts(level)
        ratio = count // parts(level - 1) if level else 0
        lost = bool(ratio) and self._loses(ratio * self.stretch / count)
        assert not lost or self.lost is not None
        until = self.lost[1] if lost and self.lost is not None else np.inf
        return Stay(place, count, self.stretch, self.end, 0 if lost else ratio, KEEPS, CALM, until, self.peak)

    @property
    def path(self) -> str:  # type: ignore[override]
        """How the stepper of constant steps computes."""
        return str(self.inner.path)

    def tape(self, judged: Openness) -> Tape | None:
        """Room for records of :meth:`march`."""
        return self.inner.tape(judged)  # type: ignore[no-any-return]

    def step_back(self) -> None:
        """Go back to the beginning of the newest step, from where smaller ones begin anew."""
        before = self.inner.begun[0]
        self.state = before
        self.restart(before.t)

    # -- attempts -----------------------------------------------------------------------------------------------------
    def _attempt(self, h: float, level: int | None = None) -> tuple[float, str]:
        """A step of size h, one of the parts of a level, and its error; where this is above one, the stepper is as before."""
        inner, size, largest = self.inner, self.size, self.norm.largest
        kept = inner.state, inner.A.copy(), list(inner._past), inner.fresh, self.solver.pressures

        try:
            self.step(h)
            error, cause = self._error(h), "error estimate"
            if level is not None:
                self._arrive(self.place + Fraction(1, parts(level)))
        except LinearSolveError as failure:
            error, cause = np.inf, self._losing(h, failure)
        except ConvergenceError as failure:
            error, cause = np.inf, "Newton's iteration"
            self.control.fault = str(failure)
        except np.linalg.LinAlgError:
            error, cause = np.inf, "an iteration that diverged"

        # also where the error is no number
        if not error <= 1.0:
            inner.state, inner.A, inner._past, inner.fresh, self.solver.pressures = kept
            self.size, self.newton.theta = size, 0.5
            self.norm.take_back(largest, error)
        return error, cause

    def step(self, h: float) -> State:
        """One step of size h (s) without a look at its error; collective."""
        self._resize(h)
        self.inner.advance(h)
        self.size = h
        return self.state

    def _resize(self, h: float) -> None:
        """Equations (1) and (2), where the size changes."""
        inner, s = self.inner, self.state
        if inner.fresh or self.size is None or self.size == h:
            return
        r = h / self.size
        v = s.v
        if self.system.n_lam and not isinstance(self.scheme.form, GGL):
            v = v + self._opened(h, r * r - 1.0)
        self._move(replace(s, v=v), s.a + r * (inner.A - s.a))

    def _opened(self, h: float, share: float) -> Array:
        """dv of (2), (n_v,), and the matrix for steps of size h (s); ``share``: r^2 - 1."""
        s = self.state
        ev = self.system.at(s.t, s.q, s.v)
        ev.forces = s.a, s.lam
        opening, still = share * ev.opening(), np.zeros_like(s.v)

        stiff = self._opened_stiffly(ev, opening, h) if self.norm.deforming or self.system.elements else None
        self.solver.prepare(ev, self.scheme.rule(h).weights)
        soft, _ = self.solver.solve(still, opening)

        # forces may have a negative stiffness, and S K then no least motion
        if stiff is not None and self.system.max_abs(stiff) <= FARTHEST * self.system.max_abs(soft):
            return stiff
        return soft

    def _opened_stiffly(self, ev: Evaluation, opening: Array, h: float) -> Array | None:
        """dv of (2) with S of the whole stretch, or of the largest part of it in which M is not lost; None where that is h."""
        for level in range(DEEPEST):
            span = self.stretch / parts(level)
            if self._loses(span):
                continue
            if span <= h:
                break
            try:
                self.solver.prepare(ev, self.scheme.rule(span).weights)
                return self.solver.solve(np.zeros_like(ev.v), opening)[0]
            except LinearSolveError:
                self.lost = span, ev.t + HELD * span
        return None

    def _error(self, h: float) -> float:
        """The norm of (3)."""
        e = self.inner.error(h)
        self.norm.update(self.state, h)  # the way of this step counts
        return self.norm(h, e, np.zeros_like(e))
