"""What a run states of its own accuracy: errors of space, time, reduction and algebra of every sensor, and their total."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError, near
from ...rotations import Array
from ...schemes.declared import Declared
from ...system.scene.refinement import meshed_bodies, modal_bodies
from ...system.scene.scene import Scene
from ..schedule import far_side
from .deviation import added_up
from .orders import expected_orders, highest_order, irregular, kink, rough

if TYPE_CHECKING:
    from ..result import Run

KINDS = ("space", "time", "modes", "algebra")
UNRESOLVED = 0.5  # error by spaces or modes over the range of a sensor above which no rate can be taken for granted
HIDDEN = 2.0  # error that a kink may leave over the stated one, above which this says too little
TAKEN_OUT = 1e-6  # amplitude over the range of a sensor below which differences tell of Newton's iteration, too
STILL = 1e-9  # range over the largest value of its unit below which a sensor does not move
FLOOR = 1e-12  # the same that roundoff leaves; and share of the range of a sensor that it does


@dataclass(frozen=True)
class Statement:
    """Errors of one sensor in its ``unit``: largest over the run; None where they were not stated."""

    sensor: str
    unit: str
    space: float | None
    time: float | None
    modes: float | None
    algebra: float | None
    total: float  # of all at once: see deviation.added_up
    span: float  # largest less smallest value of the component that moves most, 0 of one that does not

    @property
    def sum(self) -> float:
        """Sum of the largest errors of each kind: they may cancel, or come at different times."""
        return sum(x for x in (self.space, self.time, self.modes, self.algebra) if x is not None)

    @property
    def share(self) -> float:
        """The total as a share of the range of the sensor; infinite for a sensor that does not move."""
        return self.total / self.span if self.span > 0 else (np.inf if self.total > 0 else 0.0)


@dataclass(frozen=True)
class Certificate:
    """Statements of all sensors, the seconds of the run, why a kind of error was not stated: kind -> reason, and why an error may
    be far from what is stated: sensor -> reason. ``joint``: the kind, of time and space, that holds the other, as one run with
    less of both told them.
    """

    statements: tuple[Statement, ...]
    seconds: float
    unstated: dict[str, str]
    uncertain: dict[str, str] = field(default_factory=dict)
    joint: str = ""

    def __getitem__(self, sensor: str) -> Statement:
        """The statement of a sensor."""
        for s in self.statements:
            if s.sensor == sensor:
                return s
        raise InputError(f'No sensor "{sensor}". {near(sensor, [s.sensor for s in self.statements])}')

    def __str__(self) -> str:
        """A table, one line for each sensor."""
        table = [("sensor", [*KINDS, "total", "of range"], "unit")]
        for statement in self.statements:
            numbers = [*(getattr(statement, kind) for kind in KINDS), statement.total, statement.share]
            table.append((statement.sensor, ["-" if x is None else f"{x:.1e}" for x in numbers], statement.unit))

        width = max(len(sensor) for sensor, _, _ in table)
        lines = [f"{sensor:<{width}} {''.join(f'{x:>10}' for x in cells)}  {unit}" for sensor, cells, unit in table]
        lines += [f"{kind} not stated: {why}" for kind, why in self.unstated.items()]
        if self.joint:
            lines.append(f"{self.joint}: of time and space, told by one run with less of both")
        return "\n".join([*lines, *self.uncertain.values()])

    def as_dict(self) -> dict[str, object]:
        """Plain data, for JSON."""
        rows = {
            s.sensor: {
                **{k: getattr(s, k) for k in KINDS},
                "total": s.total,
                "sum": s.sum,
                "share": s.share if np.isfinite(s.share) else None,
                "unit": s.unit,
            }
            for s in self.statements
        }
        told = {"unstated": self.unstated, "uncertain": self.uncertain, "joint": self.joint}
        return {"sensors": rows, "seconds": self.seconds, **told}


def certificate_of(run: Run) -> Certificate:
    """The certificate of a run from the estimates that it was asked for, with what makes them uncertain."""
    stated = stated_of(run, run.scene.sensors)
    return replace(stated, uncertain=uncertain_of(run, stated))


def stated_of(run: Run, sensors: Iterable[str]) -> Certificate:
    """What a run states of some sensors, but for what makes it uncertain, which takes a look at all of its records.

    The error of algebra is that of Newton's iteration: what it left on average, relative to accelerations and reactions, as a
    share of the range of each sensor, or as it was measured (:mod:`.beside_steps`). The total adds errors of known signs, see
    :func:`.deviation.added_up`.
    """
    reduced, meshed = bool(modal_bodies(run.scene)), bool(meshed_bodies(run.scene))
    controlled = Declared.by(run.scheme).adaptive

    in_space, in_time, of_modes = run.space_error, run.error_estimate, run.reduction_error

    unstated = {}
    if meshed and run.joint != "time" and (run.space_unstated or not in_space):
        unstated["space"] = run.space_unstated or "not asked for: Output(estimate_space=True)"
    if not in_time and run.joint != "space":
        asked = "error estimate" in run.seconds
        unstated["time"] = (
            "the runs to compare with did not end" if asked else "not asked for: Output(estimate_error=True)"
        )
    if reduced and not of_modes:
        unstated["modes"] = "not asked for: Output(estimate_reduction=True)"

    made, spans = [], moving(run.series, run.scene.sensors, FLOOR)
    for name in sensors:
        span = spans.get(name, 0.0)
        space = in_space.get(name) if meshed else 0.0
        modes = of_modes.get(name) if reduced else 0.0
        # with error control Newton's share is a part of the tolerance, and in the error of time
        bound = 0.0 if controlled else run.newton_accuracy * span
        measured = run.deviations.get("algebra", {}).get(name)
        left, more = (bound, bound) if measured is None else (measured.size, 0.0)
        found = [kind[name] for kind in run.deviations.values() if name in kind]
        unit = run.scene.sensors[name].unit
        made.append(Statement(name, unit, space, in_time.get(name), modes, left, added_up(found) + more, span))
    return Certificate(tuple(made), run.seconds["total"], unstated, joint=run.joint)


def uncertain_of(run: Run, stated: Certificate) -> dict[str, str]:
    """Why what is stated may be far from the errors of a sensor: sensor -> reason."""
    spans = moving(run.series, run.scene.sensors)
    in_time = _uncertain_in_time, _uncertain_by_kinks, _uncertain_by_damping, _uncertain_at_impacts
    reasons = {
        s.sensor: [why for tell in in_time for why in tell(run, s)] + _uncertain_in_space(s)
        for s in stated.statements
        if s.sensor in spans
    }
    return {name: ". ".join(why) for name, why in reasons.items() if why}


def moving(series: Mapping[str, Array], sensors: Mapping[str, Any], still: float = STILL) -> dict[str, float]:
    """Ranges of the sensors that move: more than roundoff, a share ``still``, of the largest value of all with their unit, as a
    gap in contact moves by the roundoff of places.
    """
    largest: dict[str, float] = {}
    for name, x in series.items():
        unit = sensors[name].unit
        largest[unit] = max(largest.get(unit, 0.0), float(np.abs(x).max(initial=0.0)))
    spans = {name: float(np.ptp(x, axis=0).max(initial=0.0)) if len(x) else 0.0 for name, x in series.items()}
    return {name: span for name, span in spans.items() if span > still * largest[sensors[name].unit]}


def _uncertain_in_time(run: Run, stated: Statement) -> list[str]:
    """Why the error of time of a sensor may be far from what is stated; empty where it is not."""
    order = expected_orders(run.scheme, run.scene, run.system)[stated.sensor]
    seen = run.observed_order.get(stated.sensor, np.nan)
    if run.alone and (stated.time or 0.0) > TAKEN_OUT * stated.span:
        return [
            f'the error of time of "{stated.sensor}" is uncertain: with twice the step some steps fail, so that one run with '
            "half of it tells the error, and no order is seen. Both may pass by what lasts less than a step. Take a smaller dt, "
            "or a scheme that chooses its steps (rtol)"
        ]

    if not irregular((order, highest_order(run.scheme, run.system)), seen, (stated.time or 0.0) / stated.span):
        return []
    return [
        f'the error of time of "{stated.sensor}" is uncertain: runs with other steps show the order {seen:.1f}, {order} is '
        "expected. They follow another motion, or the sensor jumps, and what is stated may be several times too large or too "
        "small. Take a smaller dt, or a scheme that chooses its steps (rtol); of what jumps, a mean over time"
    ]


def struck_or_sampled(scene: Scene) -> bool:
    """Whether velocities jump, which schemes for impacts look for, or forces at ends of steps."""
    return bool(scene.contacts or scene.limits) or any(f.period is not None for f in scene.forces.values())


def left_by_kinks(run: Run, name: str) -> tuple[float, float]:
    """What a jump of a force within a step may leave in a sensor, and of which order, below that of the scheme, see
    :func:`.orders.kink`.
    """
    if Declared.by(run.scheme).adaptive or struck_or_sampled(run.scene):
        return 0.0, np.inf
    order = expected_orders(run.scheme, run.scene, run.system)[name]
    return max(kink(t, x, order, run.scene.sensors[name].derivative) for t, x in _pieces_of(run, name))


def kinked(run: Run) -> bool:
    """Whether the records of some sensor show that forces jump, or their slopes do, within its equal steps. What is left may be
    of the order of the scheme: it is chance all the same, by where in a step a kink falls.
    """
    return show_kinks(run.scene, run.scheme, *_ends(run))


def show_kinks(scene: Scene, scheme: Any, times: Array, series: Mapping[str, Array]) -> bool:
    """Whether records at the ends of equal steps (s) show kinks, see :func:`kinked`."""
    if Declared.by(scheme).adaptive or struck_or_sampled(scene):
        return False
    pieces = ((x, scene.sensors[n].derivative) for n, y in series.items() for x in _pieces(scene, times, y))
    return any(kink(t, x, np.inf, derivative)[0] > 0.0 for (t, x), derivative in pieces)


def about_kinks(run: Run, name: str) -> list[Array]:
    """The times (s) about the kinks of a sensor that say as much, in stretches; empty where it is smooth."""
    if not left_by_kinks(run, name)[0]:
        return []
    derivative = run.scene.sensors[name].derivative
    return [times for t, x in _pieces_of(run, name) for times in rough(t, x, derivative)]


def _pieces_of(run: Run, name: str) -> list[tuple[Array, Array]]:
    """Times (s) and values of a sensor at ends of steps, apart at the break points of the scene."""
    times, series = _ends(run)
    return _pieces(run.scene, times, series[name])


def _ends(run: Run) -> tuple[Array, Mapping[str, Array]]:
    """Times (s) and series at ends of steps."""
    return (run.times, run.series) if run.at_steps is None else run.at_steps


def _pieces(scene: Scene, times: Array, x: Array) -> list[tuple[Array, Array]]:
    """A series apart at the break points of a scene: what breaks at instants that the scene names breaks between two steps."""
    parts = np.searchsorted(times, [far_side(t) for t in sorted(scene.breakpoints)])
    return list(zip(np.split(times, parts), np.split(x, parts), strict=True))


def _uncertain_by_kinks(run: Run, stated: Statement) -> list[str]:
    """Why a jump of a force within a step may leave more than what is stated; empty where there is none, or the run that tells
    the error has smaller steps.
    """
    name = stated.sensor
    if stated.time is None or run.halved:
        return []
    error, left = left_by_kinks(run, name)
    if error <= HIDDEN * stated.time:
        return []
    order = expected_orders(run.scheme, run.scene, run.system)[name]
    return [
        f'the error of time of "{name}" is uncertain: its records have a kink that leaves an order of about {left:.1f}, '
        f"{order} is expected, and an error of some {error:.1e} {stated.unit}, by where in a step it falls, which runs with "
        "other steps do not tell. Take a scheme that chooses its steps (rtol), and name the instant in Scene(breakpoints=...)"
    ]


def _uncertain_by_damping(run: Run, stated: Statement) -> list[str]:
    """Why vibrations that no run resolves may be more than what is stated; empty where there are none."""
    amplitude = run.damped.get(stated.sensor, 0.0)
    if amplitude <= TAKEN_OUT * stated.span:
        return []
    return [
        f'the error of time of "{stated.sensor}" is uncertain: {run.scheme.name} takes vibrations of some {amplitude:.1e} '
        f"{stated.unit} out of it that steps of {run.dt:.2g} s do not resolve, and that runs with other steps do not tell. "
        "Take a much smaller dt if they matter, or damping or a start in equilibrium (settle=True) if they do not"
    ]


def _uncertain_at_impacts(run: Run, stated: Statement) -> list[str]:
    """Why a record may be that of the other side of an impact; empty where none is so near to one."""
    time, jump = run.struck.get(stated.sensor, (0.0, 0.0))
    if jump <= HIDDEN * (stated.time or 0.0):
        return []
    return [
        f'the record of "{stated.sensor}" at t = {time:.9g} s is nearer to an impact than this is known: it may be from the '
        f"other side, where the sensor differs by {jump:.1e} {stated.unit}. Leave it out, or take another dt"
    ]


def _uncertain_in_space(stated: Statement) -> list[str]:
    """Why errors by spaces and modes may be far from what is stated; empty where they are not.

    They are differences to one finer run, which is thought to be clearly better. Where these are as large as the sensor itself
    it may have no value that finer runs tend to: the acceleration of a surface that is hit at once goes with its shrinking mass.
    """
    kinds = {"space": "a finer mesh", "modes": "more modes"}
    return [
        f'the error by {kind} of "{stated.sensor}" is uncertain: with {what} it differs by {found:.1e} {stated.unit}, and all '
        f"that it does is {stated.span:.1e} {stated.unit}. It may have no value that finer runs tend to, like the acceleration "
        "of a surface under a sudden load. Refine, or smooth the load"
        for kind, what in kinds.items()
        if (found := getattr(stated, kind) or 0.0) > UNRESOLVED * stated.span
    ]
