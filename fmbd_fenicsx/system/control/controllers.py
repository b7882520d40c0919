"""Controllers: read sensors, set the efforts of joint coordinates, keep a memory of their own.

    continuous     u = u(t, y, z),   z' = g(t, y, z)                                                              (1)
    sampled        u, z = law(t_k, y_k, z)  at t_k = k T, held between                                            (2)

y are the readings, u the efforts, z the memory. Radau and BDF find z of (1) at the points of a step as they find the motion
(:mod:`.memory_points`), and errors of z count among those of the step. With other schemes it follows the trapezoidal rule,

    z(t) = z_n + (t - t_n) / 2 (g_n + g(t, y, z(t))),                                                             (3)

of second order. Both are functions of the motion and of what was kept at t_n: a rejected step has nothing to undo, and Newton
sees how u answers to the joint coordinates, positions and velocities that are read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import zip_longest
from typing import Any, ClassVar

import numpy as np

from ...checks import function, instance, typed, vector
from ...errors import InputError, require
from ...mechanics.forces.force_elements import Loads, MarkerTangent
from ...mechanics.forces.forces import Force
from ...mechanics.forces.formulas import Formula, SampledEffort, table
from ...mechanics.forces.joint_elements import motion_of
from ...mechanics.forces.laws_together import LEAST
from ...mechanics.frames import Kinematics
from ...mechanics.joints.drives import JointCoordinate
from ...mechanics.joints.relative import RelativeCoordinates
from ...mechanics.joints.sums import Coordinate
from ...rotations import Array, Motions
from ..sensors.sensor import Sensor
from ..sensors.sensors import JointReading, joint_reading
from .control_laws import PidLaw
from .control_memory import ControllerMemory
from .law_with_memory import LawWithMemory
from .memory_points import PointRule, StepError, integral_of, memory_of
from .readings import KINEMATIC, Reading

FELT = 0.1  # of sizes in the model: what errors of memories may be to the motion, beside its own
_AT = 1e-9  # share of the sampling period by which a step may end before its sample


class ControlLoads(Loads):
    """One controller: the efforts of its ``law`` on the coordinates ``acts``, and what it reads as one array y, (size,)."""

    def __init__(
        self, motions: Motions, controller: Controller, acts: Sequence[RelativeCoordinates], readings: Sequence[Reading]
    ) -> None:
        markers = [(int(coordinate.a[0]), int(coordinate.b[0])) for coordinate in acts]
        super().__init__(motions, [controller] * len(acts), markers)
        self.controller, self.acts, self.readings = controller, tuple(acts), tuple(readings)

        self.size, self.parts = 0, dict[str, slice]()
        for reading in self.readings if controller.every is None else ():
            self.parts[reading.name] = slice(self.size, self.size + reading.size)
            self.size += reading.size
        self.law = LawWithMemory(controller, self.parts)
        self._held: Array = -self.law.kept.u  # between samples, as the driver reads them

    @property
    def kept(self) -> ControllerMemory:
        """What the law keeps."""
        return self.law.kept

    @kept.setter
    def kept(self, memory: ControllerMemory) -> None:
        self.law.kept = memory
        self._held[:] = -memory.u

    @cached_property
    def levels(self) -> np.ndarray:
        """Of each number of y: 1 of a rate of a joint coordinate, else 0; (size,)."""
        return np.repeat([r.level for r in self.readings], [r.size for r in self.readings])

    @cached_property
    def owned(self) -> np.ndarray:
        """Which numbers of y are of the coordinate that each effort acts on, (acts, size)."""
        sizes = [r.size for r in self.readings]
        return np.array([np.repeat([r.coordinate == on for r in self.readings], sizes) for on in self.controller.acts])

    @cached_property
    def spans(self) -> Array:
        """What each number of y is at least for differences, as of laws on coordinates, (size,)."""
        return LEAST * np.repeat([r.span(self.length) for r in self.readings], [r.size for r in self.readings])

    @cached_property
    def places(self) -> Array:
        """By what each number of y may change that is a place or a turn, 0 of rates, before memories count, (size,)."""
        each = [0.0 if r.fast else FELT * r.span(self.length) for r in self.readings]
        return np.repeat(each, [r.size for r in self.readings])

    @property
    def called(self) -> bool:
        """Whether the law is called at every evaluation: a continuous one that has no formula."""
        return self.controller.every is None and not self.formulas()

    @staticmethod
    def law_of(f: Any) -> Any:
        """None: the law of a controller is called with its readings."""
        return None

    # -- the law ----------------------------------------------------------------------------------------------------
    def read(self, kin: Kinematics) -> Array:
        """y of a continuous law in a configuration, (size,)."""
        return np.concatenate([np.zeros(0), *(r.at(kin) for r in self.readings)])

    def efforts(self, kin: Kinematics, t: float) -> Array:
        """u, (acts,): N or N m, positive where the coordinate grows."""
        return self.kept.u if self.controller.every is not None else self.law.with_memory(t, self.read(kin))[0]

    # -- forces -----------------------------------------------------------------------------------------------------
    @property
    def markers(self) -> tuple[np.ndarray, ...]:
        """Those of each coordinate, as many as the longest sum has: the first one stands for what others have not."""
        count = max(len(r.markers) for r in self.acts)
        each = [[int(m[0]) for m in r.markers] for r in self.acts]
        return tuple(np.array([on[k] if k < len(on) else on[0] for on in each]) for k in range(count))

    def _rows(self, kin: Kinematics) -> tuple[Array, ...]:
        """Rows of the coordinates on these, (acts, n) each; zero where one has no such marker."""
        none = np.zeros((1, self.motions.n_twist))
        each = zip_longest(*(r.rows(kin) for r in self.acts), fillvalue=none)
        return tuple(np.concatenate(rows) for rows in each)

    def wrenches(self, kin: Kinematics, t: float) -> tuple[Array, ...]:
        """u along each coordinate."""
        u = self.efforts(kin, t)[:, None]
        return tuple(u * row for row in self._rows(kin))

    def scalar(self, kin: Kinematics, t: float) -> tuple[Array, Array, Array]:
        """Coordinates, rates, and minus the efforts."""
        s = np.concatenate([r.values(kin) for r in self.acts])
        rate = np.concatenate([r.rates(kin) for r in self.acts])
        return s, rate, -self.efforts(kin, t)

    def tangent(self, kin: Kinematics, t: float) -> MarkerTangent | None:
        """How u answers to what is read, for each pair of an acting and a read marker; None when sampled."""
        if self.controller.every is not None:
            return None
        slopes = self.law.slopes(t, self.read(kin), self.spans)
        # du/d(displacement) and du/d(velocity) of each marker that is read, (acts, n) each
        n, answers = self.motions.n_twist, dict[int, Array]()
        for reading in self.readings:
            for marker, row, fast in reading.rows(kin):
                answer = answers.setdefault(marker, np.zeros((2, len(self.acts), n)))
                answer[int(fast)] += slopes[:, self.parts[reading.name]] @ row
        if not answers:
            return None

        blocks = -np.einsum("kai,rfaj->fkarij", self._rows(kin), list(answers.values()))
        K, D = np.zeros((2, blocks[0, ..., 0, 0].size, 2 * n, 2 * n))
        K[:, :n, n:], D[:, :n, n:] = blocks.reshape(2, -1, n, n)
        pushed = np.ravel(self.markers)
        return MarkerTangent((np.repeat(pushed, len(answers)), np.tile(list(answers), len(pushed))), K, D)

    def formulas(self) -> list[Formula]:
        """That of a continuous PID controller; none of other laws."""
        law = self.controller.law
        if not isinstance(law, PidLaw) or self.controller.every is not None:
            return []

        def kept() -> Array:
            return integral_of(self.kept, self.law.points, float(self.spans[0]), float(law.unfelt(self.places)[0]))

        def keep(memory: Array) -> None:
            self.kept = memory_of(memory, self.kept.u)

        kp, ki, kd = law.gains
        numbers = table([(kp, kd, law.limit, ki, *law.target(0.0)[:2])])
        return [Formula(self.acts[0], "PID", np.zeros(1, dtype=int), numbers, [law.target], kept, keep)]

    # -- memory -----------------------------------------------------------------------------------------------------
    def first(self, ev: Any, state: Any) -> ControllerMemory:
        """Memory at the start, with the first sample taken."""
        points = self.law.points
        self.kept, points.lead, points.least = self.law.begun(state.t), None, None
        return self.accepted(ev, state)

    @property
    def due(self) -> float:
        """When the next sample is taken, s."""
        every = self.controller.every
        return np.inf if every is None else every * (self.kept.next - _AT)

    def sampled(self) -> list[SampledEffort]:
        """The efforts between samples; none of continuous laws."""
        acting = self.acts if self.controller.every is not None else ()
        return [SampledEffort(relative, self._held[i : i + 1]) for i, relative in enumerate(acting)]

    def jumps(self, kept: ControllerMemory) -> bool:
        """A new sample has been taken."""
        return kept.next != self.kept.next

    def memory_values(self) -> Array:
        """z of a continuous law, (m,); sampled ones keep theirs from sample to sample."""
        return self.kept.z if self.controller.every is None else np.zeros(0)

    def set_memory(self, values: Array, t: float) -> None:
        """Take z at time t, s."""
        self.kept = replace(self.kept, t=t, z=values.copy(), past=())

    @property
    def collocates(self) -> bool:
        """As of :class:`Loads`: continuous laws."""
        return bool(self.controller.memory) and self.controller.every is None

    def collocate(self, rule: PointRule, kins: Sequence[Kinematics]) -> None:
        """Find z at the points of a step."""
        if self.law.stated:
            self.law.points.reach = self.spans[:1]  # z' = target - s
        self.law.collocate(rule, np.array([self.read(kin) for kin in kins]), self.places)

    def divide(self, times: Array) -> None:
        """Take the last step for several, which began at these times (s)."""
        self.kept = self.kept.divided(times)

    def lead(self, share: float) -> None:
        """Where a tangent of the step is taken z answers to g by so much (s)."""
        self.law.points.lead = share

    def memory_error(self, of: StepError) -> float:
        """The error of z in the step whose points were found last, over the tolerance."""
        return self.law.points.error(self.kept, of) if self._felt else 0.0

    def trapezoid_error(self, kin: Kinematics, t: float, rtol: float, atol: float) -> float:
        """That of z by (3) in a step that ends at t."""
        if self.law.stated:
            self.law.points.reach = self.spans[:1]
        return self.law.trapezoid_error(t, self.read(kin), self.places, rtol, atol) if self._felt else 0.0

    @property
    def _felt(self) -> bool:
        """Whether efforts answer to the memory."""
        law = self.controller.law
        return not isinstance(law, PidLaw) or law.gains[1] > 0

    def memory_rates(self, ev: Any, t: float) -> Array:
        """g of (1), (m,)."""
        z = self.memory_values()
        return self.law.asked(t, self.read(ev.kin), z)[1] if len(z) else z

    def accepted(self, ev: Any, state: Any) -> ControllerMemory:
        """Memory after a step: of (3), or of the sample that is due."""
        every, kept = self.controller.every, self.kept
        if every is None:
            return self.law.after(state.t, self.read(ev.kin))
        if state.t < self.due:
            return kept

        y = {}
        for reading in self.readings:
            value = reading.at(ev.kin) if reading.relative else reading.sensor.read(ev, state, reading.marker)
            y[reading.name] = value.copy()
        u, z = self.law.ask(state.t, y, kept.z)
        next_sample = int(np.floor(state.t / every + _AT)) + 1
        return ControllerMemory(state.t, z, kept.rate, u, next_sample)


@dataclass(frozen=True, eq=False)
class Controller(Force):
    """See :func:`controller`."""

    acts: tuple[Coordinate, ...] = ()
    reads: dict[str, Sensor] = field(default_factory=dict)
    law: Callable[..., Any] = None  # type: ignore[assignment]
    memory: tuple[float, ...] = ()
    every: float | None = None

    kind: ClassVar[str] = "controller"
    batch: ClassVar[type[Loads]] = ControlLoads

    @property
    def coordinate(self) -> Coordinate:
        """The first coordinate that it acts on."""
        return self.acts[0]

    @property
    def coordinates(self) -> tuple[JointCoordinate, ...]:
        """Those that it acts on or reads."""
        return (
            *(c for s in self.acts for c in s.coordinates),
            *(c for s in self.reads.values() for c in s.coordinates),
        )

    @property
    def period(self) -> float | None:
        """Period of sampling, s."""
        return self.every

    @property
    def sides(self) -> tuple[Any, ...]:
        """All that it acts on or reads from."""
        acted = (c for s in self.acts for c in s.coordinates)
        return (*(x for s in acted for x in (s.joint.a, s.joint.b)), *(s.on for s in self.reads.values()))

    def own_loads(self, place: Any) -> ControlLoads:
        """The controller in a system; ``place`` gives the coordinate and the marker of a sensor."""
        readings, dim = [], place.motions.dim
        for name, sensor in self.reads.items():
            if isinstance(sensor, JointReading):
                readings.append(Reading(name, sensor, -1, place.relative(sensor.coordinate), sensor.derivative, dim))
            else:
                readings.append(Reading(name, sensor, place.marker(sensor), None, 0, dim))
        return ControlLoads(place.motions, self, [place.relative(s) for s in self.acts], readings)


@typed
def controller(
    name: str,
    *,
    reads: Mapping[str, Sensor | Coordinate],
    acts: Coordinate | Sequence[Coordinate],
    law: Callable[..., Any],
    memory: Sequence[float] = (),
    every: float | None = None,
) -> Controller:
    """A controller: reads sensors, sets the efforts of joint coordinates, with a memory of its own.

    Args:
        reads: name -> sensor or joint coordinate, say ``{"phi": fmbd.angle(hinge), "tip": fmbd.position(tip)}``.
        acts: joint coordinates, or sums of such, whose efforts it sets (N m of an angle, N of a displacement).
        law: law(t, y, z) -> efforts, one for each of ``acts``; with a memory -> (efforts, rate of z), and sampled ->
            (efforts, new z). ``y["phi"]`` are the readings as arrays, z the memory (m,).
        memory: z at the start.
        every: period of sampling, s: the law is called at the ends of the steps where a sample is due, and its efforts are held.
            Constant steps should divide it; steps with error control end at samples.
            None: continuous, the law is part of the equations of motion and is called at every iterate.

    A continuous law reads joint coordinates, their rates, positions, velocities, angular velocities and rotations; a sampled
    one any sensor. The memory is kept in checkpoints and changed by accepted steps only.

    Raises:
        CallbackError: during a run, where the law returns something of another shape.
    """
    acts = (acts,) if isinstance(acts, Coordinate) else tuple(acts)
    require(len(acts) > 0, f'Controller "{name}": acts must hold a joint coordinate at least.')
    for coordinate in acts:
        instance(f'Controller "{name}": on', coordinate, Coordinate)

    # continuous laws are asked inside Newton's iteration, where only the motion is known
    function(f'Controller "{name}": law', law, "tyz", named="t, y, z")
    require(every is None or (np.isfinite(every) and every > 0), f'Controller "{name}": every = {every} s must be > 0.')

    sensors: dict[str, Sensor] = {}
    for label, given in reads.items():
        sensor = joint_reading(given) if isinstance(given, Coordinate) else given
        require(isinstance(sensor, Sensor), f'Controller "{name}" reads "{label}": expected a sensor, found {given!r}.')
        if every is None and not isinstance(sensor, (*KINEMATIC, JointReading)):
            raise InputError(
                f'Controller "{name}" reads "{label}", {type(sensor).__name__}, which no continuous law can: it depends on '
                "more than the motion. Sample it: every=..."
            )
        sensors[label] = sensor

    z = tuple(float(x) for x in memory)
    joint = acts[0].joint
    return Controller(name, joint.a, joint.b, None, None, acts, sensors, law, z, every)


@typed
def pid(
    name: str,
    on: Coordinate,
    *,
    target: Callable[[float], Any] | float,
    gains: tuple[float, float, float],
    limit: float = np.inf,
    every: float | None = None,
) -> Controller:
    """PID controller of a joint coordinate s: effort k_p e + k_i int e dt + k_d e' with e = target(t) - s.

    Args:
        target: a number or a smooth function of time (rad or m); it may return (s, s', s'').
        gains: (k_p, k_i, k_d): N m/rad, N m/(rad s), N m s/rad, or N/m, N/(m s), N s/m.
        limit: largest effort; while it binds, what is cut off is fed back into the integral with time k_p / k_i, so that it
            does not wind up. Needs k_p > 0.
        every: period of sampling, s; None for a continuous controller.
    """
    vector(f'PID "{name}": gains (k_p, k_i, k_d)', gains, size=3)
    require(min(gains) >= 0, f'PID "{name}": gains {gains} must not be negative.')
    require(limit > 0, f'PID "{name}": limit = {limit} must be positive.')
    require(gains[0] > 0 or not np.isfinite(limit), f'PID "{name}": a limit needs a proportional gain above 0.')

    law = PidLaw(gains, motion_of(name, target), limit, every)
    reads: dict[str, Sensor | Coordinate] = {"s": on, "rate": joint_reading(on, 1)}
    return controller(name, reads=reads, acts=on, law=law, memory=(0.0,), every=every)
