"""Events: the instants at which a sensor crosses a value, found on the way of a run.

After each step the value at its end is compared with that at its start, in compiled steps by C where the value is a number of
the record; where the sign of (value - level) has changed, the
instant is located on the dense output of the step (:mod:`.instants`) by Brent's method, to the accuracy of that polynomial. Steps
of schemes with error control are large: there values at quarters of the step are looked at too, of all steps of a compiled call
at once, and where the quartic through these crosses between them. Two crossings in a constant step cancel out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.optimize import brentq

from ...checks import check_fields, number
from ...errors import InputError, near, require
from ...log import log
from ...polynomials import lagrange_values
from ...rotations import Array
from ...schemes.stepping import TimeStepper
from ...system.compiled.recording import Recorded
from ...system.compiled.tape import CROSSING, Tape
from ...system.layout import State
from ...system.scene.scene import Scene
from ...system.system import System
from .instants import state_between, states_within
from .moment import Moment

QUARTERS = (0.25, 0.5, 0.75)
PARTS = 8  # of a quarter in which its quartic is looked at
FINE = np.linspace(0.0, 1.0, 4 * PARTS + 1)
QUARTIC = lagrange_values(np.array([0.0, *QUARTERS, 1.0]), FINE)
QUARTER = PARTS * np.arange(4)[:, None] + np.arange(PARTS + 1)
UNMET = {0: "was not crossed", 1: "was not crossed upwards", -1: "was not crossed downwards"}  # by an event's direction
ROUNDOFF = 4 * float(np.finfo(float).eps)


@dataclass(frozen=True)
class Event:
    """A sensor crosses a value: ``Output(events=[fmbd.Event("tip y", -0.5, direction=-1)])``.

    Args:
        sensor: name of a sensor with one component, or of a component: "tip y".
        level: the value, in the sensor's unit.
        direction: 1 for rising, -1 for falling values only, 0 for both.
        then: called with the :class:`~fmbd_fenicsx.run.recording.moment.Moment` of the crossing, on all ranks, and the run
            goes on; None ends the run there.
    """

    sensor: str
    level: float = 0.0
    direction: int = 0
    then: Callable[[Any], Any] | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        number(f'Event "{self.sensor}": level =', self.level)
        require(
            self.direction in (-1, 0, 1),
            f'Event "{self.sensor}": direction = {self.direction} must be 1 (rising), -1 (falling) or 0 (both).',
        )


def component(scene: Scene, now: Moment, name: str) -> tuple[str, int | None]:
    """Sensor and number of the component behind a name; None where the sensor must have only one; collective."""
    if name in scene.sensors:
        return name, None
    # else a component: the sensor's name, a blank, its label
    known: dict[str, tuple[str, int]] = {}
    for sensor, made in scene.sensors.items():
        size = len(now[sensor]) if name.startswith(f"{sensor} ") else 0
        known |= {f"{sensor} {made.labels[k] if k < len(made.labels) else k + 1}": (sensor, k) for k in range(size)}
    if name not in known:
        raise InputError(f'Event: no sensor or component "{name}". {near(name, [*scene.sensors, *known])}')
    return known[name]


class EventWatch:
    """Looks for the events of a run after each step; ``samples``: whether to look inside the steps too."""

    def __init__(
        self, events: tuple[Event, ...], scene: Scene, system: System, markers: dict[str, int], *, samples: bool
    ) -> None:
        self.events, self.scene, self.system, self.markers = events, scene, system, markers
        self.places = QUARTERS if samples else ()
        self.crossings = np.zeros(len(events), CROSSING)  # "before": values less levels where all has been looked at
        self.crossings["level"] = [e.level for e in events]
        self.crossings["direction"] = [e.direction for e in events]

    def start(self, state: State) -> None:
        """The state that the first step begins from; collective."""
        now = self._moment(state)
        self.columns = [component(self.scene, now, e.sensor) for e in self.events]
        self.before = state
        self.crossings["before"] = [self._value(k, now) for k in range(len(self.events))]
        self.read = [(self.scene.sensors[name], self.markers[name], column or 0) for name, column in self.columns]

    def rides(self, tape: Tape) -> bool:
        """Whether compiled steps end where an event is met: what is between has been looked at then."""
        if self.places and (tape.kept is None or not tape.kept.many):
            return False
        return tape.stops_at(self.crossings, self.read)

    def met_inside(self, tape: Tape, stepper: TimeStepper, begun: Array, roundoff: float) -> int:
        """Which of the steps that a march has kept is the first in which an event is met, 0 if in none, looked at inside: a value
        may cross and come back. ``begun``: values less levels where it began. Values behind the last step are kept; collective.
        """
        assert tape.kept is not None
        values, levels, unseen = begun[None], self.crossings["level"], 0
        numbers = np.zeros(0, dtype=int)

        for steps in tape.kept.inside(stepper.state.t, np.array([*self.places, 1.0])):
            seen = tape.kept.told_of(states_within(steps, stepper, roundoff), steps)
            if seen is None:  # NumPy has something to say of it
                unseen = int(steps.number[0])
                break
            told = [(sensor.numbers(seen, marker), column) for sensor, marker, column in self.read]
            after = np.column_stack([scale * x[:, column] for (x, scale), column in told]) - levels
            values, numbers = np.concatenate((values, after)), np.concatenate((numbers, steps.number))

        count = len(self.places) + 1  # points of a step
        whole = len(numbers) // count * count
        found = _crosses(values[:-1], values[1:], self.crossings["direction"]).any(axis=1)
        of_steps = values[np.arange(0, whole, count)[:, None] + np.arange(count + 1)]
        found[:whole] |= np.repeat((_dips(of_steps)[0] < 0.0).any(axis=(1, 2)), count)
        if found.any():
            return int(numbers[np.argmax(found)])
        if not unseen:
            self.crossings["before"] = values[-1]
        return unseen

    def passed(self, stepper: TimeStepper, told: Recorded | None) -> None:
        """Take note that nothing is met in compiled steps, but in the newest one where C has ``told`` of it."""
        self.before = stepper.state if told is None else stepper.origin

    def look(self, n: int, after: State, stepper: Any, told: Recorded | None = None) -> State | None:
        """Call what belongs to the crossings of step n in their order; the state at which the run ends, or None. ``told``: what
        compiled code told of the end of the step. Collective.
        """
        before = self.before
        if before is after:
            return None
        span = after.t - before.t

        def at(t: float) -> State:
            return after if t >= after.t else state_between(self.system, (before, after), t, stepper)

        # with error control steps are long: a value may cross and come back within one
        # and at an impact it turns
        inner = sorted((*(before.t + x * span for x in self.places), *stepper.kinks))
        seen = [*(self._moment(at(t)) for t in inner), self._moment(after, told)]  # each evaluated once for all events
        values = [self.crossings["before"].copy(), *(self._values(x) for x in seen)]
        if self.places and not stepper.kinks:
            least, where = _dips(np.array(values))
            turns = [self._moment(at(before.t + x * span)) for x in np.unique(where[least < 0.0])]
            known = sorted(
                zip([*seen, *turns], [*values[1:], *map(self._values, turns)], strict=True), key=lambda x: x[0].t
            )
            seen, values[1:] = map(list, zip(*known, strict=True))

        found: list[tuple[float, int]] = []
        for k, event in enumerate(self.events):
            points = [(t, float(x[k])) for t, x in zip((before.t, *(x.t for x in seen)), values, strict=True)]
            found += [
                (self._locate(k, at, a, b), k) for a, b in pairwise(points) if _crosses(a[1], b[1], event.direction)
            ]
            self.crossings["before"][k] = points[-1][1]
        self.before = after

        # in the order of time, up to the first that ends the run
        for t, k in sorted(found):
            event, state = self.events[k], at(t)
            if event.then is None:
                return state
            event.then(Moment(self.scene, self.system, self.markers, state, n))
        return None

    def tell_unmet(self, recorded: Mapping[str, Array]) -> None:
        """Say at the end of a run which events were to end it before."""
        for event, (name, column) in zip(self.events, self.columns, strict=True):
            if event.then is None:
                values = recorded[name][:, column or 0]
                log.warning(
                    'event "%s": %g %s and did not end the run; records are from %.6g to %.6g',
                    event.sensor, event.level, UNMET[event.direction], values.min(), values.max(),
                )  # fmt: skip

    def _locate(self, k: int, at: Callable[[float], State], a: tuple[float, float], b: tuple[float, float]) -> float:
        """The instant of a crossing between two points (time, value): the later one of what has one value in a whole step, as
        gaps and forces of contact have.
        """
        if b[1] == 0.0:
            return b[0]

        def value(t: float) -> float:
            return self._value(k, self._moment(at(t)))

        begin = value(a[0])
        if begin * b[1] > 0.0:
            return b[0] if abs(begin - b[1]) < abs(begin - a[1]) else a[0]
        return float(brentq(value, a[0], b[0], xtol=ROUNDOFF * max(b[0], 1e-300), rtol=ROUNDOFF))

    def _moment(self, state: State, told: Recorded | None = None) -> Moment:
        """What sensors read from; ``told``: what compiled code told of the state."""
        return Moment(self.scene, self.system, self.markers, state, 0, told)

    def _values(self, now: Moment) -> Array:
        """Values less levels of all events."""
        return np.array([self._value(k, now) for k in range(len(self.events))])

    def _value(self, k: int, now: Moment) -> float:
        """Value less level of an event's sensor."""
        (name, column), event = self.columns[k], self.events[k]
        read = now[name]
        if column is None and len(read) != 1:
            labels = [*self.scene.sensors[name].labels, *range(1, len(read) + 1)][: len(read)]
            listed = ", ".join(f'"{name} {x}"' for x in labels)
            raise InputError(f'Event: sensor "{name}" has {len(read)} components. Take one of them: {listed}.')
        return float(read[column or 0]) - event.level


def _dips(values: Array) -> tuple[Array, Array]:
    """Of values less levels at quarters of steps, (.., 5, events): the least that the quartic through them foretells within each
    quarter, (.., 4, events), in sizes of the side of zero where both its ends lie, and where in the step that is.
    """
    sides = np.sign(values)
    side = np.where(sides[..., :-1, :] == sides[..., 1:, :], sides[..., 1:, :], 0.0)
    paths = (QUARTIC @ values)[..., QUARTER, :] * side[..., None, :]
    number = np.clip(paths.argmin(axis=-2), 1, PARTS - 1)[..., None, :]
    before, least, after = (np.take_along_axis(paths, number + i, axis=-2)[..., 0, :] for i in (-1, 0, 1))

    # on the parabola through the three
    bend, rise = np.maximum(before - 2.0 * least + after, np.finfo(float).tiny), 0.5 * (after - before)
    off = np.clip(-rise / bend, -1.0, 1.0)
    where = (np.arange(4)[:, None] + (number[..., 0, :] + off) / PARTS) / 4
    return least + off * (rise + 0.5 * off * bend), where


def _crosses(before: Any, after: Any, direction: Any) -> Any:
    """Whether two values of (sensor - level) lie on both sides of zero, in the direction that was asked for; of many likewise."""
    rises = (before < 0.0) & (after >= 0.0)
    falls = (before > 0.0) & (after <= 0.0)
    return rises & (direction >= 0) | falls & (direction <= 0)
