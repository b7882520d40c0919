"""Many steps in one call of compiled code, recorded on the way or made up to the next record."""

from __future__ import annotations

import pickle
import time as clock
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..schemes.stepping import Observers, TimeStepper
from ..system.element_memory import next_sample
from ..system.serialisation import Memory
from .judges.acceptance import Closed
from .judges.force_balance import next_look
from .recording.output import MOST
from .recording.recorder import Recorder
from .schedule import StepSchedule

if TYPE_CHECKING:
    from ..system.compiled.tape import Tape
    from ..system.layout import State
    from .checkpoints.progress import RunProgress
    from .recording.events import EventWatch

CHUNK = 0.1  # s: longer calls into compiled code would not hear of a request to stop
FIRST = 64  # steps of the first call: nobody knows how long they take


class CompiledCalls:
    """The calls of one march.

    ``closed``: judges the joints of steps of a scheme's own choice; one that does not pass is made by itself. ``refuses``: looks
    at the newest of steps of so many seconds, which is taken back where it says so. ``events``: who looks for those of the run;
    compiled steps that can tell them end where one is met. ``steps``: all that these are made by.
    """

    def __init__(
        self,
        stepper: TimeStepper,
        schedule: StepSchedule,
        recorder: Recorder,
        *,
        closed: Closed,
        refuses: Callable[[float], bool],
        events: EventWatch | None = None,
        steps: RunProgress,
    ) -> None:
        self.stepper, self.schedule, self.recorder = stepper, schedule, recorder
        self.closed, self.refuses, self.events = closed, refuses, events
        self.equal = bool(schedule.steps)
        self.looks_inside = events is not None and not self.equal  # values may cross and come back
        self.steps = steps
        self.shown = recorder.output.on_step is not None
        # whether controllers may sample where a call ends: who looks into its last step sees the efforts up to there
        looked_into = self.shown or events is not None
        self.samples = self.equal and bool(recorder.system.keepers) and not looked_into and recorder.wanted is None
        self.local_error = 0.0  # the largest that the stepper told after a call of the newest march
        self._began: State | None = None  # where the step before did, where forces are smooth since then
        self._last = np.inf  # s, when the last step may begin before one that somebody waits for

    def make(self, done: int, most: int) -> int:
        """How many steps, at most so many, were made behind those that are done; 0 where they have to be made one by one."""
        watched = self.shown or self.events is not None
        self._last = np.inf
        self._bound()
        if self.shown and not self.equal:
            return 0
        t = self.stepper.state.t
        h = self.stepper.stride(self._limit(t))
        if not h:
            return 0

        tape = self._tape()
        alone = watched and not self._told_of_events(tape)  # each is looked at
        if alone and not self.equal:
            return 0
        unseen = self._unseen(done, h, tape)
        steps = min(unseen, 1 if alone else most)
        if steps == 1 and tape is None and self.equal and not alone:
            return 0

        self._began = self.recorder.earlier
        self.local_error = 0.0
        if unseen != MOST:  # somebody waits, after however many steps of the first size
            self._last = t + (unseen - 1) * h
        begin, made, chunk, more = clock.perf_counter(), 0, FIRST, True

        while more and made < steps and clock.perf_counter() - begin < CHUNK:
            now = min(chunk, steps - made, self.next_look(done + made) - done - made)
            if tape is not None:
                now = self._begin(tape, done + made, now, alone)
            march = self._looked_into if self.looks_inside else self._march
            now, more = march(done + made, h, now, tape)
            if now and tape is not None:
                more = self._take(tape, done + made, alone) and more
                if not alone:
                    self._take_kept(tape, done + made, now)
            made += now
            chunk *= 4
        return made

    def _bound(self) -> None:
        """Tell a stepper that chooses its steps how long these may be, and where they have to end, or to begin at the latest."""
        if not self.equal:
            self.stepper.bound(self.schedule.largest, self._ends(self.stepper.state.t), self._last)

    def _ends(self, t: float) -> tuple[float, ...]:
        """Where steps of the next march from a time on have to end, s."""
        ends = self.schedule.ends(t)
        return ends if self.stepper.passes_marks else ends[:1]

    def _limit(self, t: float) -> float:
        """Size of the steps of a march from a time on, or how far it may go, s."""
        return self.schedule.next(t) if self.equal else min(self._ends(t)[-1] - t, self.schedule.largest)

    def next_look(self, done: int) -> int:
        """After how many steps states are looked at, behind those that are done."""
        look = next_look(done)
        return min(look, self.schedule.steps) if self.equal else look

    def _take_kept(self, tape: Tape, done: int, made: int) -> None:
        """Record the instants in the steps of a call, but for those in the step of an event."""
        recorder, kept = self.recorder, tape.kept
        if recorder.wanted is None or kept is None:
            return
        recorder.take_kept(tape, self.stepper, done)
        self._began = kept.began
        if tape.c.crossed:
            recorder.begin_step(done + made, self.stepper.origin, self._began)

    def _tape(self) -> Tape | None:
        """Room for the records of a march; None where it cannot make them."""
        tape = self.stepper.tape(self.recorder.drift.openness) if self.recorder.on_tape else None
        waits = self.recorder.wanted is not None
        return None if waits and tape is not None and tape.kept is None else tape

    def _told_of_events(self, tape: Tape | None) -> bool:
        """Whether records tell all that is to be looked at in a step."""
        return not self.shown and tape is not None and self.events is not None and self.events.rides(tape)

    def _unseen(self, done: int, h: float, tape: Tape | None) -> int:
        """Steps of size h (s) up to one that ends a call."""
        t = self.stepper.state.t
        if tape is None:
            steps = self.recorder.quiet(done, t, h, through=not self.equal)
        else:
            steps = self.recorder.free(t, h)
        return min(steps, self.schedule.left(done)) if self.equal else steps

    def _begin(self, tape: Tape, done: int, steps: int, alone: bool) -> int:
        """Make room for the records of so many steps behind those that are done; of how many there is."""
        recorder, every = self.recorder, self.recorder.every
        if alone:
            tape.begin(1, 1)
            return steps
        many = steps > tape.capacity * every
        tape.begin(every, every - done % every)
        if many:
            recorder.straight.lead(tape, steps // every + 1)
        if self.looks_inside or recorder.wanted is not None:
            wanted = np.zeros(0) if recorder.wanted is None else recorder.wanted
            forces = recorder.energy_too or self.stepper.forces_within
            tape.wait(wanted, recorder.rounding, self._began, each=self.looks_inside, forces=forces)
        return min(steps, tape.room * every)

    def _march(self, done: int, h: float, steps: int, tape: Tape | None) -> tuple[int, bool]:
        """One call of at most so many steps of size h (s) behind those that are done: how many count, and whether more may
        follow.
        """
        stepper = self.stepper
        self._bound()
        joints = self.closed if self.closed.judging else None
        seen = Observers(joints=joints, tape=tape, samples=self.samples)
        made = stepper.march(self._limit(stepper.state.t), steps, seen)
        self.local_error = max(self.local_error, stepper.local_error)

        # where the scheme ended it, or by number; the clock and records end calls too
        ended = not self.equal and made < steps and not (tape is not None and tape.ended)
        t = stepper.state.t
        if made and (ended or done + made == self.next_look(done)) and self.refuses(h):
            stepper.step_back()
            if tape is not None:
                tape.step_back(t)
            return made - 1, False

        # the end of a step is recorded behind the sample there
        if made and self.samples and next_sample(self.recorder.system) <= t:
            if tape is not None:
                tape.step_back(t)
            return made, False
        return made, bool(made) and (self.equal or not self._over())

    def _looked_into(self, done: int, h: float, steps: int, tape: Tape | None) -> tuple[int, bool]:
        """The same with a look into the steps for events: where one is met inside of one, the call is made anew up to it."""
        events = self.events
        assert events is not None and tape is not None
        kept, begun, error = Memory(self.steps.system), events.crossings["before"].copy(), self.local_error
        self.steps.remember_steps(kept)
        before = pickle.dumps(kept.values)  # steps write over arrays

        made, more = self._march(done, h, steps, tape)
        met = events.met_inside(tape, self.stepper, begun, self.recorder.rounding)
        if not met:
            return made, more
        self.steps.remember_steps(Memory(kept.system, pickle.loads(before)))
        events.crossings["before"], self.local_error = begun, error
        self._begin(tape, done, steps, alone=False)
        tape.c.meets = met
        return self._march(done, h, steps, tape)

    def _over(self) -> bool:
        """Whether a march of steps with error control is over: behind a break point, where the next step would begin later than
        the last one may.
        """
        t, schedule = self.stepper.state.t, self.schedule
        return t > self._last or schedule.broken(t) is not None or schedule.ended(t, 0)

    def _take(self, tape: Tape, done: int, alone: bool) -> bool:
        """Record a call behind the steps that were done; whether more may follow, without an event."""
        if alone:  # recorded only after who looks has seen it
            self.recorder.newest_told = tape.recorded().copied()
            return True
        self.recorder.take_tape(tape.recorded(), done)
        if self.events is None:
            return True
        self.recorder.newest_told = tape.looked_at()
        self.events.passed(self.stepper, self.recorder.newest_told)
        return self.recorder.newest_told is None
