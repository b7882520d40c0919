"""What a run has recorded so far: sensor series, energies, drift of the constraints, snapshots."""

from __future__ import annotations

import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...notices import Gathered
from ...rotations import Array
from ...schemes.stepping import TimeStepper
from ...system.compiled.recording import Recorded
from ...system.compiled.tape import Openness, Tape
from ...system.evaluation import Evaluation
from ...system.layout import State
from ...system.scene.scene import Scene
from ...system.serialisation import Memory
from ...system.system import System
from ..judges.acceptance import Closed
from .between import state_between, states_within
from .ledger import Books
from .output import MOST, ROUNDING, Output
from .rows import Rows, StepNumbers
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
    powers: list[dict[str, float]] = field(default_factory=list)
    works: list[dict[str, float]] = field(default_factory=list)
    unlisted: tuple[str, ...] = ()
    gap: float = 0.0
    slip: float = 0.0
    worst_slip: float = 0.0  # m/s, that of angles times the model's length
    fastest: float = 0.0  # m/s, largest velocity
    seconds: float = 0.0
    closed: Closed | None = None  # refuses states with open joints
    warned: Gathered | None = None  # the warnings of this run

    def __post_init__(self) -> None:
        self.steps = StepNumbers(np.zeros(0, dtype=int))
        # (k,) of times and energies, (k, size) of sensors
        self.moments = Rows()
        self.energies: dict[str, Rows] = {}
        self.values: dict[str, Rows] = {n: Rows() for n in self.scene.sensors}
        times = self.output.times
        self._wanted: Array | None = None
        if times is not None:
            self._wanted = np.array([t for t in times if t <= self.t_end * (1 + ROUNDING)], dtype=float)
        # the end of the last step, its number, and the state that this began with where forces are smooth since then
        self._before: State | None = None
        self._earlier: State | None = None
        self._number, self._smooth = -1, True
        self.straight = Straight(self)
        self._due = self.output.due(self.scene.begins, self.t_end)

    @property
    def on_tape(self) -> bool:
        """Whether records may be made inside of a march, or of steps that it keeps."""
        return not self.output.ledger  # powers need a state of their own

    @property
    def every(self) -> int:
        """After how many steps the end of one is recorded."""
        return self.output.every if self._wanted is None else MOST

    @property
    def rounding(self) -> float:
        """By how much instants may differ that are the same, s."""
        return 1e-9 * self.t_end

    @property
    def wanted(self) -> Array | None:
        """Instants that are still to be recorded, s; None where ends of steps are."""
        return self._wanted

    @property
    def earlier(self) -> State | None:
        """Where the step that led to the newest state began, None where forces jumped since then."""
        return self._earlier

    def told_of(self, state: State) -> Recorded | None:
        """What compiled code told of a state, if it is the newest one and somebody looks at each."""
        told = self.newest_told
        return told if told is not None and told.t[-1] == state.t else None

    @property
    def openness(self) -> Openness:
        """By what records of compiled steps are judged."""
        return Openness(np.ones(self.system.n_lam), np.inf, 0.0) if self.closed is None else self.closed.openness

    def free(self, t: float, h: float) -> int:
        """Steps of size h (s) after time t up to the next snapshot, it included."""
        return max(int(np.ceil((self._due[0] - t) / h - 1e-6)), 1) if self._due else MOST

    def take_tape(self, seen: Recorded, first: int) -> None:
        """Records that a march of compiled steps made after step ``first``."""
        if not len(seen) or self._wanted is not None:
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
        self._judge_tape(seen, float(self.times[-1]))
        self._take_values(seen, there)
        self.seconds += clock.perf_counter() - begin

    def take_kept(self, tape: Tape, stepper: TimeStepper, first: int) -> None:
        """The instants within the steps after step ``first`` that a march has kept on its ``tape``; collective."""
        if self._wanted is None or tape.kept is None:
            return
        for steps in tape.kept.steps(stepper.state.t):
            begin, spent = clock.perf_counter(), self.seconds
            self._judge_tape(tape.recorded(), float(steps.after.t[-1, 0]))
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
            self._wanted = self._wanted[len(states) :]
            # those that are recorded one by one have noted their seconds
            self.seconds = spent + clock.perf_counter() - begin

    def _take_values(self, seen: Recorded, there: Any) -> None:
        """Sensors and energies of records, but for those that are ``there``."""
        # what compiled code knows is read for all records at once
        alone = self._take_sensors(seen, there)
        unknown = self.output.energy and not seen.looks.energies_known
        if alone or unknown:
            self._one_by_one(seen, alone, unknown)
        if self.output.energy and not unknown and not (there and self.straight.single):
            for name, values in seen.energies().items():
                if ("energy", name) not in there:
                    self.energies.setdefault(name, Rows()).append(values)
        for rows in (self.moments, *self.energies.values(), *self.values.values()):
            rows.joined(self.expected)  # the tape is written anew

    def _judge_tape(self, seen: Recorded, t: float) -> None:
        """How far joints were open, of all records up to a time t (s)."""
        if self.closed is not None:
            self.closed.check_tape(seen, t)
        gap, slip, worst, fastest = seen.worst
        self.gap, self.slip = max(self.gap, gap), max(self.slip, slip)
        if self.closed is not None:
            self.worst_slip, self.fastest = max(self.worst_slip, worst), max(self.fastest, fastest)

    def _take_sensors(self, seen: Recorded, there: Any) -> list[tuple[str, Any]]:
        """Values of the sensors that compiled code knows but for those that are ``there``; the others."""
        alone = []
        for name, sensor in self.scene.sensors.items():
            if id(sensor) not in seen.looks.of:
                alone.append((name, sensor))
            elif ("sensor", name) not in there:
                self.values[name].append(sensor.series(seen, self.markers[name]))
        return alone

    def _one_by_one(self, seen: Recorded, sensors: list[tuple[str, Any]], energy: bool) -> None:
        """What only a state of its own can tell, of all records."""
        for i in range(len(seen)):
            s = seen.state(i)
            ev = seen.evaluation(s, i)
            for name, sensor in sensors:
                self.values[name].append(sensor.read(ev, s, self.markers[name])[None])
            for name, value in ev.energies().items() if energy else ():
                self.energies.setdefault(name, Rows()).append(np.array([value]))

    def quiet(self, n: int, t: float, h: float, *, through: bool = False) -> int:
        """Steps of size h (s) after step n, at time t, up to the next that is recorded, it included; or all before one that
        passes an instant at which values are asked for: that one is a step by itself, as its polynomials tell them, or
        (``through``) the last of all.
        """
        steps = self.output.every - n % self.output.every
        if self._wanted is not None:
            steps = int((self._wanted[0] - t) / h - 1e-6) + through if len(self._wanted) else MOST
        if self._due:
            steps = min(steps, int(np.ceil((self._due[0] - t) / h - 1e-6)))
        return max(steps, 1)

    def take(self, n: int, state: State, seen: Evaluation | None = None, stepper: Any = None) -> None:
        """Record step n when it is due; ``seen``: the system in that state, where known, ``stepper``: who made it. Collective."""
        rounding = self.rounding
        if self._due and state.t >= self._due[0] - rounding:
            self.snapshots.append(state)
            self._due = [t for t in self._due if t > state.t + rounding]

        if self._wanted is not None:
            self._take_between(n, state, stepper, rounding)
            return

        if n % self.output.every and state.t < self.t_end - rounding:
            return
        if self.newest == n:  # on tape
            return
        told = self.told_of(state)
        if told is not None and n % self.output.every == 0:
            self.take_tape(told, n - 1)
        else:
            self._record(n, state, seen)

    def arrive(self, summed: State, state: State) -> None:
        """The end of the last step, whose time was ``summed``, has the time of the run's end."""
        if self._wanted is None and self.times[-1] == summed.t:
            self.times[-1] = state.t
        if self.snapshots and self.snapshots[-1] is summed:
            self.snapshots[-1] = state

    def go_on(self, state: State) -> None:
        """The next step begins in another state than the last one ended in: behind a jump of forces."""
        if self._wanted is not None:
            self._before, self._earlier = state, None

    def begin_step(self, n: int, before: State, earlier: State | None) -> None:
        """Step n, whose instants are recorded by :meth:`take`, began in a state, the step before in an ``earlier`` one."""
        self._number, self._before, self._earlier = n - 1, before, earlier

    def take_within(self, n: int, state: State, stepper: Any) -> None:
        """Record the times within step n, which a ``stepper`` made up to a state, before controllers sample in it: their efforts
        are others then; collective.
        """
        if self._wanted is not None:
            self._take_up_to(state.t - self.rounding, n, state, stepper)
            self._smooth = False

    def take_until(self, n: int, state: State, met: State, stepper: Any) -> None:
        """Record step n up to the state at which an event has ended the run, it included; collective."""
        if self._wanted is not None:
            self._wanted = self._wanted[self._wanted <= met.t]
            self._take_between(n, state, stepper, self.rounding)
        self._record(n, met, None, between=True)

    def _take_between(self, n: int, state: State, stepper: Any, rounding: float) -> None:
        """Record the times that the last step has passed."""
        if self._take_up_to(state.t + rounding, n, state, stepper):
            self._judge(n, state, self.system.at(state.t, state.q, state.v))
        began = self._before if n == self._number + 1 else stepper.earlier
        self._earlier, self._before, self._number = began if self._smooth else None, state, n
        self._smooth = True

    def _take_up_to(self, last: float, n: int, state: State, stepper: Any) -> bool:
        """Record the times up to the ``last`` one (s) on the way to the state that step n has ended in; whether there are any."""
        assert self._wanted is not None
        count = int(np.searchsorted(self._wanted, last, side="right"))
        passed, self._wanted = [float(t) for t in self._wanted[:count]], self._wanted[count:]
        for t in passed:
            at = state
            if abs(t - state.t) > self.rounding and self._before is not None:
                at = state_between(self.system, (self._before, state), t, stepper, earlier=self._earlier)
            self._record(n, at, None, between=True)
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
            self._judge(n, state, ev)
        if self.output.energy:
            for name, value in ev.energies().items():
                self.energies.setdefault(name, Rows()).append(np.array([value]))
        if self.output.ledger:
            self._book(ev, state)

        self.seconds += clock.perf_counter() - begin

    def _judge(self, n: int, state: State, ev: Evaluation) -> None:
        """How far joints are open at the end of step n; raises ConvergenceError where it is too far; collective."""
        if self.closed is not None and n:
            self.closed.check(ev)
        elif self.closed is not None:
            self.closed.last = state.t
        if not self.system.n_lam:
            return

        units = self.system.row_units
        rate = np.abs(ev.opening())
        self.gap = max(self.gap, float((units * np.abs(ev.constraint())).max()))
        self.slip = max(self.slip, float((units * rate).max()))
        if self.closed is not None:
            self.worst_slip = max(self.worst_slip, float((self.closed.units * rate).max()))
            self.fastest = max(self.fastest, self.system.max_abs(state.v))

    def _book(self, ev: Evaluation, state: State) -> None:
        """Power of every element in a state, and work of contacts up to it; collective."""
        from ...system.powers import contact_works, powers, unlisted

        if not self.powers:
            self.unlisted = tuple(unlisted(ev, state))
        self.powers.append(powers(ev, state))
        self.works.append(contact_works(state) if self.scene.unilateral else {})

    @property
    def books(self) -> Books:
        """What was recorded for the ledger."""
        power, work = (
            {name: np.array([one.get(name, 0.0) for one in entries]) for name in _names(entries)}
            for entries in (self.powers, self.works)
        )
        return Books(power, work, self.unlisted, tuple(self.scene.forces))

    def remember(self, m: Memory) -> None:
        """All that was recorded so far."""
        steps, times = m("steps", (self.indices, self.times))
        self.newest = int(steps[-1]) if len(steps) else -1
        self.steps, self.moments = StepNumbers(np.asarray(steps, dtype=int)), Rows([np.asarray(times, dtype=float)])

        sensors = self.scene.sensors
        self.values = {n: Rows([sensors[n].remember(m, f"sensor {n}", x)]) for n, x in self.series.items()}

        kinds = m("kinds", list(self.energies))
        now = self.energy
        self.energies = {k: Rows([np.asarray(m(f"energy {k}", now.get(k, np.zeros(0))))]) for k in kinds}

        self.gap, self.slip, self.seconds, self._due = m("drift", (self.gap, self.slip, self.seconds, self._due))

        if self.output.ledger:
            power, work, self.unlisted = m("ledger", (self.books.power, self.books.work, self.unlisted))
            self.powers, self.works = _entries(power, len(self.times)), _entries(work, len(self.times))
        self.worst_slip, self.fastest = m("velocities", (self.worst_slip, self.fastest))

        if self.warned is not None:
            self.warned.found = [(a, b) for a, b in m("warned", [list(x) for x in self.warned.found])]

        wanted = m("wanted", None if self._wanted is None else self._wanted.tolist())
        self._wanted = None if wanted is None else np.array(wanted, dtype=float)
        if self._wanted is not None:
            self._before, earlier = m.state("before", self._before), m.state("earlier", self._earlier)
            self._earlier = None if earlier is None or earlier.t is None else earlier
            self._number, self._smooth = m("before number", (self._number, self._smooth))
        self.snapshots = [i.state("state", s) for i, (s,) in m.each("snapshots", [(s,) for s in self.snapshots], 1)]

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


def _names(entries: Sequence[Mapping[str, float]]) -> list[str]:
    """Every name that occurs, once, in the order of its first record."""
    return list(dict.fromkeys(name for entry in entries for name in entry))


def _entries(columns: Mapping[str, Array], count: int) -> list[dict[str, float]]:
    """A dictionary for each record from a column for each name."""
    return [{name: float(x[k]) for name, x in columns.items()} for k in range(count)]
