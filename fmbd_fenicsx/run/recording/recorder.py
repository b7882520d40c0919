"""What a run has recorded so far: sensor series, energies, drift of the constraints, snapshots."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...log import log
from ...notices import Gathered
from ...rotations import Array
from ...schemes.stepping import TimeStepper
from ...system.compiled.recording import Recorded
from ...system.compiled.tape import Tape
from ...system.evaluation import Evaluation
from ...system.layout import State
from ...system.scene.scene import Scene
from ...system.serialisation import Memory
from ...system.system import System
from .drift import Drift
from .instants import Instants, states_within
from .ledger import Bookkeeper
from .output import MOST, ROUNDING, Output
from .rows import Records, StepNumbers
from .straight import Straight


@dataclass
class Recorder:
    """Series of sensors and energies, snapshots, and the drift of the constraints, of one run that ends at
    ``t_end`` (s).
    """

    scene: Scene
    system: System
    markers: dict[str, int]
    output: Output
    t_end: float
    expected: int = 0  # records of the whole run, where known
    newest: int = -1  # the step recorded last
    newest_told: Recorded | None = None  # what compiled code told of the newest step, where somebody looks at each
    snapshots: list[State] = field(default_factory=list)
    seconds: float = 0.0
    warned: Gathered | None = None  # the warnings of this run

    def __post_init__(self) -> None:
        self.steps = StepNumbers(np.zeros(0, dtype=int))
        # (k,) of times and energies, (k, size) of sensors
        self.moments = Records()
        self.struck: Array = np.zeros(0)  # instants of impacts in the march, s
        self.energies: dict[str, Records] = {}
        self.values: dict[str, Records] = {n: Records() for n in self.scene.sensors}
        times = self.output.times
        self.instants: Instants | None = None
        if times is not None:
            left = np.array([t for t in times if t <= self.t_end * (1 + ROUNDING)], dtype=float)
            self.instants = Instants(self.system, left, self.rounding)
        self.drift = Drift(self.system)
        self.bookkeeper = Bookkeeper(self.scene)
        self.straight = Straight(self)
        self._due = self.output.due(self.scene.begins, self.t_end)

    @property
    def on_tape(self) -> bool:
        """Whether records may be made inside of a march, or of steps that it keeps."""
        return not self.output.ledger  # powers need a state of their own

    @property
    def every(self) -> int:
        """After how many steps the end of one is recorded."""
        return self.output.every if self.instants is None else MOST

    @property
    def rounding(self) -> float:
        """By how much instants may differ that are the same, s."""
        return 1e-9 * self.t_end

    @property
    def wanted(self) -> Array | None:
        """Instants that are still to be recorded, s; None where ends of steps are."""
        return None if self.instants is None else self.instants.left

    @property
    def energy_too(self) -> bool:
        """Whether energies are recorded at those instants."""
        return self.output.energy

    @property
    def earlier(self) -> State | None:
        """Where the step that led to the newest state began, None where forces jumped since then."""
        return None if self.instants is None else self.instants.earlier

    def told_of(self, state: State) -> Recorded | None:
        """What compiled code told of a state, if it is the newest one and somebody looks at each."""
        told = self.newest_told
        return told if told is not None and told.t[-1] == state.t else None

    def free(self, t: float, h: float) -> int:
        """Steps of size h (s) after time t up to the next snapshot, it included."""
        return max(int(np.ceil((self._due[0] - t) / h - 1e-6)), 1) if self._due else MOST

    def take_tape(self, seen: Recorded, first: int) -> None:
        """Records that a march of compiled steps made after step ``first``."""
        if not len(seen) or self.instants is not None:
            return

        begin = clock.perf_counter()
        every = self.output.every
        start = (first // every + 1) * every
        self.newest = start + every * (len(seen) - 1)
        self.steps.append(np.arange(start, self.newest + 1, every))

        there = self.straight.shapes if seen.straight else {}
        if there:
            self.straight.take(len(seen))
        else:
            self.moments.append(seen.t)
        self.drift.judge_tape(seen, float(self.times[-1]))
        self._take_values(seen, there)

        self.seconds += clock.perf_counter() - begin

    def take_kept(self, tape: Tape, stepper: TimeStepper, first: int) -> None:
        """The instants within the steps after step ``first`` that a march has kept on its ``tape``; collective."""
        if self.instants is None or tape.kept is None:
            return

        for steps in tape.kept.steps(stepper.state.t):
            begin, spent = clock.perf_counter(), self.seconds
            self.drift.judge_tape(tape.recorded(), float(steps.after.t[-1, 0]))
            states = states_within(steps, stepper, self.rounding)
            numbers = first + steps.number
            seen = tape.kept.told_of(states, steps)
            if seen is None:
                for n, state in zip(numbers, tape.kept.each(states, steps), strict=True):
                    self._record(int(n), state, None, between=True)
            else:
                self.newest = int(numbers[-1])
                self.steps.append(numbers)
                self.moments.append(seen.t)
                self._take_values(seen, {})
            self.instants.left = self.instants.left[len(states) :]
            # those that are recorded one by one have noted their seconds
            self.seconds = spent + clock.perf_counter() - begin

    def _take_values(self, seen: Recorded, there: Any) -> None:
        """Sensors and energies of records, but for those that are ``there``."""
        # what compiled code knows is read for all records at once
        alone = self._take_sensors(seen, there)
        if alone:
            self._one_by_one(seen, alone)
        if self.output.energy and not (there and self.straight.single):
            for name, values in seen.energies().items():
                if ("energy", name) not in there:
                    self.energies.setdefault(name, Records()).append(values)
        for rows in (self.moments, *self.energies.values(), *self.values.values()):
            rows.joined(self.expected)  # the tape is written anew

    def _take_sensors(self, seen: Recorded, there: Any) -> list[tuple[str, Any]]:
        """Values of the sensors that compiled code knows but for those that are ``there``; the others."""
        alone = []
        for name, sensor in self.scene.sensors.items():
            if id(sensor) not in seen.looks.of:
                alone.append((name, sensor))
            elif ("sensor", name) not in there:
                self.values[name].append(sensor.series(seen, self.markers[name]))
        return alone

    def _one_by_one(self, seen: Recorded, sensors: list[tuple[str, Any]]) -> None:
        """What only a state of its own can tell, of all records."""
        for i in range(len(seen)):
            s = seen.state(i)
            ev = seen.evaluation(s, i)
            for name, sensor in sensors:
                self.values[name].append(sensor.read(ev, s, self.markers[name])[None])

    def quiet(self, n: int, t: float, h: float, *, through: bool = False) -> int:
        """Steps of size h (s) after step n, at time t, up to the next that is recorded, it included; or all before one that
        passes an instant at which values are asked for: that one is a step by itself, as its polynomials tell them, or
        (``through``) the last of all.
        """
        steps = self.output.every - n % self.output.every
        if self.instants is not None:
            left = self.instants.left
            steps = int((left[0] - t) / h - 1e-6) + through if len(left) else MOST
        if self._due:
            steps = min(steps, int(np.ceil((self._due[0] - t) / h - 1e-6)))
        return max(steps, 1)

    def take(self, n: int, state: State, seen: Evaluation | None = None, stepper: Any = None) -> None:
        """Record step n when it is due; ``seen``: the system in that state, where known, ``stepper``: who made it. Collective."""
        rounding = self.rounding
        if self._due and state.t >= self._due[0] - rounding:
            self.snapshots.append(state if stepper is None else stepper.told(state))
            self._due = [t for t in self._due if t > state.t + rounding]

        if self.instants is not None:
            self._take_between(self.instants, n, state, stepper)
            return

        if n % self.output.every and state.t < self.t_end - rounding:
            return
        if self.newest == n:  # on tape
            return
        due, told = n % self.output.every == 0, self.told_of(state)
        if told is None and due and n and seen is None and stepper is not None:
            told = self._told_at(state, stepper)
        if told is not None and due:
            self.take_tape(told, n - 1)
        else:
            self._record(n, state, seen)

    def _told_at(self, state: State, stepper: TimeStepper) -> Recorded | None:
        """What compiled code tells of the end of a step that was made alone; None where it does not tell it."""
        tape = stepper.tape(self.drift.openness) if self.on_tape else None
        return None if tape is None or tape.kept is None else tape.kept.told_at(state)

    def arrive(self, summed: State, state: State) -> None:
        """The end of the last step, whose time was ``summed``, has the time of the run's end."""
        if self.instants is None and self.times[-1] == summed.t:
            self.times[-1] = state.t
        if self.snapshots and self.snapshots[-1].t == summed.t:
            self.snapshots[-1] = replace(self.snapshots[-1], t=state.t)

    def go_on(self, state: State) -> None:
        """The next step begins in another state than the last one ended in: behind a jump of forces."""
        if self.instants is not None:
            self.instants.go_on(state)

    def begin_step(self, n: int, before: State, earlier: State | None) -> None:
        """Step n, whose instants are recorded by :meth:`take`, began in a state, the step before in an ``earlier`` one."""
        if self.instants is not None:
            self.instants.begin_step(n, before, earlier)

    def take_within(self, n: int, state: State, stepper: Any) -> None:
        """Record the times within step n, which a ``stepper`` made up to a state, before controllers sample in it: their efforts
        are others then; collective.
        """
        if self.instants is not None:
            self._take_passed(self.instants, state.t - self.rounding, n, state, stepper)
            self.instants.sample()

    def take_until(self, n: int, state: State, met: State, stepper: Any) -> None:
        """Record step n up to the state at which an event has ended the run, it included; collective."""
        if self.instants is not None:
            self.instants.left = self.instants.left[self.instants.left <= met.t]
            self._take_between(self.instants, n, state, stepper)
        self._record(n, met, None, between=True)

    def _take_between(self, instants: Instants, n: int, state: State, stepper: Any) -> None:
        """Record the times that the last step has passed."""
        if self._take_passed(instants, state.t + self.rounding, n, state, stepper):
            self.drift.judge(n, state, self.system.at(state.t, state.q, state.v))
        instants.end_step(n, state, stepper)

    def _take_passed(self, instants: Instants, last: float, n: int, state: State, stepper: Any) -> bool:
        """Record the times up to the ``last`` one (s) on the way to the state that step n has ended in; whether there are any."""
        passed = instants.passed(last)
        for t in passed:
            self._record(n, instants.state(t, state, stepper), None, between=True)
        return bool(passed)

    def _record(self, n: int, state: State, seen: Evaluation | None, *, between: bool = False) -> None:
        """Sensors, drift and energies of a state; joints of one ``between`` the ends of a step are as open as the polynomial
        leaves them, which is no failure of the step.
        """
        begin = clock.perf_counter()
        ev = self.system.at(state.t, state.q, state.v) if seen is None else seen
        self.newest = n
        self.steps.append(np.array([n]))
        self.moments.append(np.array([state.t]))
        for name, sensor in self.scene.sensors.items():
            self.values[name].append(np.asarray(sensor.read(ev, state, self.markers[name]))[None])

        if not between:
            self.drift.judge(n, state, ev)
        if self.output.energy:
            for name, value in ev.energies().items():
                self.energies.setdefault(name, Records()).append(np.array([value]))
        if self.output.ledger:
            self.bookkeeper.enter(ev, state)

        self.seconds += clock.perf_counter() - begin

    def remember(self, m: Memory) -> None:
        """All that was recorded so far."""
        steps, times = m("steps", (self.indices, self.times))
        self.newest = int(steps[-1]) if len(steps) else -1
        self.steps, self.moments = StepNumbers(np.asarray(steps, dtype=int)), Records([np.asarray(times, dtype=float)])

        sensors = self.scene.sensors
        self.values = {n: Records([sensors[n].remember(m, f"sensor {n}", x)]) for n, x in self.series.items()}

        kinds = m("kinds", list(self.energies))
        now = self.energy
        self.energies = {k: Records([np.asarray(m(f"energy {k}", now.get(k, np.zeros(0))))]) for k in kinds}

        self.seconds, _ = m("snapshots due", (self.seconds, self._due))
        self.drift.remember(m.inside("drift"))
        if self.output.ledger:
            self.bookkeeper.remember(m.inside("ledger"))
        # a run goes on with the instants that it began with, and with what is asked for beside them
        recorded = float(self.times[-1]) if len(self.times) else -np.inf
        instants, asked = self.instants or Instants(self.system, np.zeros(0), self.rounding), self.instants is not None
        self.instants = instants if (began := m("at instants", asked)) else None
        if asked != began:
            log.warning(
                "restart: the run began with records at %s and goes on so, %s Output(times=) now: begin it anew for others",
                *(("given times", "without") if began else ("ends of steps", "in spite of")),
            )
        if self.instants is not None:
            self.instants.remember(m.inside("instants"), recorded)

        if self.warned is not None:
            self.warned.found = [(a, b) for a, b in m("warned", [list(x) for x in self.warned.found])]
        self.snapshots = [i.state("state", s) for i, (s,) in m.each("snapshots", [(s,) for s in self.snapshots], 1)]
        taken = max((recorded, *(s.t for s in self.snapshots[-1:])))
        self._due = [t for t in self._due if t > taken + self.rounding]

    @property
    def times(self) -> Array:
        """Times of the records (s), (n,)."""
        return self.moments.joined()

    @property
    def indices(self) -> np.ndarray:
        """Numbers of the recorded steps, (n,)."""
        return self.steps.joined()

    @property
    def series(self) -> dict[str, Array]:
        """Sensor name -> values, (n, size)."""
        return {name: rows.joined() for name, rows in self.values.items()}

    @property
    def energy(self) -> dict[str, Array]:
        """Kind -> energies in J, (n,)."""
        return {name: rows.joined() for name, rows in self.energies.items()}
