"""The scene: what a user builds of bodies, joints, forces and sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any

from ...checks import array, check_fields, instance, number, shown, word
from ...errors import InputError, near, require
from ...log import log
from ...mechanics.body import Body
from ...mechanics.catenary.sliding import SlidingContact
from ...mechanics.forces.forces import Force
from ...mechanics.forces.inputs import Input
from ...mechanics.joints.joints import Joint
from ...mechanics.joints.limits import JointLimit
from ...mechanics.joints.sums import Coordinate, NamedCoordinate
from ...mechanics.parts import ScenePart
from ..gravity import GivenGravity, check_gravity
from ..layout import State
from ..mobility import Mobility, check, loose_bodies
from ..sensors.sensor import Sensor
from ..sensors.sensors import joint_reading
from ..system import System
from .build import Builder
from .going_on import Origin

# where parts stand: what they are, in types and in a word
PLACES: dict[str, tuple[type, str]] = {
    "bodies": (Body, "body"),
    "joints": (Joint, "joint"),
    "forces": (Force, "force"),
    "sensors": (Sensor, "sensor"),
    "contacts": (ScenePart, "contact"),
    "limits": (JointLimit, "joint limit"),
    "sliders": (SlidingContact, "sliding contact"),
    "ties": (ScenePart, "tie"),
    "inputs": (Input, "input"),
}
ADDED = ("bodies", "sliders", "joints", "limits", "forces", "ties", "contacts")  # by Scene.add


def _fits(part: Any, place: str) -> bool:
    """Whether a part belongs there; ties and contacts say themselves what they are."""
    kind, word = PLACES[place]
    return isinstance(part, kind) and (not isinstance(part, ScenePart) or part.what == word)


class Parts(dict[str, Any]):
    """Parts of a scene by their names; who asks for one that is not there, or takes it out, is told those that are.

    With a part that is taken out go the sensors of its ``scene`` that read it; ``what`` it is, see :data:`PLACES`.
    """

    scene: Scene
    what: str

    def __missing__(self, name: Any) -> Any:
        raise InputError(f'The scene has no "{name}" there. {near(str(name), self)}')

    def __delitem__(self, name: str) -> None:
        if name not in self:
            self.__missing__(name)
        part = super().pop(name)
        sensors = self.scene.sensors
        for sensor in [key for key, sensor in sensors.items() if sensor.reads_part(self.what, part)]:
            del sensors[sensor]


@dataclass(repr=False)
class Scene:
    """Bodies, joints, forces and sensors under gravity.

    Args:
        name: what messages call the scene.
        gravity: acceleration in m/s^2, world axes, (d,) or (3,), or a function of time (s) that gives it; None for no gravity.
        gravity_ramp: duration (s) of a smooth switch-on of gravity; 0 for gravity from the start.
        settle: start at rest in the static equilibrium near the given placement (loads of t = 0) instead of in the placement;
            integrals of continuous controllers have come to rest there, velocities of bodies are refused.
        breakpoints: times (s) at which loads or drives are not smooth: steps end there, equal ones too, which are fitted in
            between. Those outside of a run are passed over.
        origin: what the scene goes on from, of a run's ``next_scene()``; else None.
    """

    name: str
    gravity: GivenGravity = None
    gravity_ramp: float = 0.0
    breakpoints: Sequence[float] = ()
    settle: bool = False
    bodies: dict[str, Any] = field(default_factory=dict)
    joints: dict[str, Joint] = field(default_factory=dict)
    forces: dict[str, Force] = field(default_factory=dict)
    sensors: dict[str, Sensor] = field(default_factory=dict)
    contacts: dict[str, Any] = field(default_factory=dict)
    limits: dict[str, JointLimit] = field(default_factory=dict)
    sliders: dict[str, SlidingContact] = field(default_factory=dict)
    ties: dict[str, Any] = field(default_factory=dict)
    inputs: dict[str, Input] = field(default_factory=dict)
    origin: Origin | None = None

    def __repr__(self) -> str:
        parts = {"bodies": self.bodies, "joints": self.joints, "forces": self.forces, "contacts": self.contacts}
        parts |= {"limits": self.limits, "sensors": self.sensors}
        named = [f"{what} {', '.join(names)}" for what, names in parts.items() if names]
        return f'<Scene "{self.name}": {"; ".join(named) or "empty"}>'

    def _repr_html_(self) -> str:
        from html import escape

        return f"<pre>{escape(repr(self)[1:-1].replace('; ', chr(10) + '  '))}</pre>"

    def __post_init__(self) -> None:
        word("A scene's name", self.name)
        check_fields(self, f'Scene "{self.name}"')

    def __setattr__(self, name: str, value: Any) -> None:
        """Only what a scene has: ``scene.gravtiy = ...`` would change nothing, without a word."""
        known = self.__dataclass_fields__
        if name not in known:
            raise InputError(f'A scene has no "{name}" to set. {near(name, known)}')
        if name in PLACES:
            empty = type(value) is dict and not value  # as all are in a new scene
            value = Parts(value if empty else self._fitting(name, value))
            value.scene, value.what = self, PLACES[name][1]

        what = f'Scene "{self.__dict__.get("name", "")}": {name}'
        if name == "gravity":
            check_gravity(what, value)
        if name == "breakpoints" and not (isinstance(value, tuple) and not value):
            times = array(what, value, shape="times (s)")
            require(times.ndim == 1, f"{what} {shown(value)} must be a list of times (s).")
        if name == "gravity_ramp":
            number(what, value, least=0.0, unit="s")

        object.__setattr__(self, name, value)

    def _fitting(self, place: str, given: Any) -> dict[str, Any]:
        """A dict of parts by their names, as :meth:`add` makes it; a copy, so that two scenes never share one."""
        what = f'Scene "{self.__dict__.get("name", "")}": {place}'
        advice = "Make the scene first, and add parts with scene.add(...) and scene.sensor(...)."
        require(isinstance(given, dict), f"{what} {shown(given)} must be a dict of parts by their names. {advice}")
        word = PLACES[place][1]
        for name, part in given.items():
            require(_fits(part, place), f'{what}: "{name}" is no {word}, found {shown(part)}. {advice}')
            own = name if isinstance(part, Sensor) else part.name
            require(
                own == name and name != "ground", f'{what}: {word} "{own}" stands under the name "{name}". {advice}'
            )
        return given

    def add(self, *parts: Any) -> Any:
        """Add bodies, joints, forces and contacts; names must be unique among each. Returns the part, or a tuple of several."""
        for part in parts:
            for place in ADDED:
                if _fits(part, place):
                    break
            else:
                many = (
                    " Give the parts of a list one by one: scene.add(*parts)." if isinstance(part, list | tuple) else ""
                )
                raise InputError(f"A scene takes bodies, joints, forces and contacts; found {shown(part)}.{many}")
            self._put(self.__dict__[place], part, PLACES[place][1])
        return parts[0] if len(parts) == 1 else parts

    def sensor(self, name: str, quantity: Sensor | Coordinate | NamedCoordinate) -> str:
        """Record a quantity in every run, say ``scene.sensor("tip", fmbd.position(rod.surface("tip")))``; returns the name."""
        word("A sensor's name", name)
        if name in self.sensors:
            raise InputError(f'Two sensors are called "{name}".')
        if isinstance(quantity, Coordinate | NamedCoordinate):
            quantity = joint_reading(quantity)
        instance(f'Sensor "{name}": quantity', quantity, Sensor)
        self.sensors[name] = quantity.in_scene(name, self)
        return name

    @property
    def gravity_changes(self) -> bool:
        """Whether gravity depends on time."""
        return callable(self.gravity) or (self.gravity is not None and self.gravity_ramp > 0)

    @property
    def begins(self) -> float:
        """When a run of it begins, s."""
        return 0.0 if self.origin is None else self.origin.state.t

    @property
    def unilateral(self) -> bool:
        """Whether anything may touch: contacts, or joints that reach their limits."""
        return bool(self.contacts or self.limits)

    def input(self, name: str, start: float = 0.0, *, lower: float = -inf, upper: float = inf) -> Input:
        """A number that is set from outside between steps: ``fmbd.effort("motor", phi, scene.input("torque"))``.

        :meth:`set` of a :func:`~fmbd_fenicsx.stepper` changes it, its own ``torque.set(2.0)`` in functions that a run calls
        after steps or at events; ``lower`` and ``upper`` are its range.
        """
        require(name not in self.inputs, f'Two inputs are called "{name}".')
        self.inputs[name] = Input(name, start, lower=lower, upper=upper)
        return self.inputs[name]

    def _put(self, where: dict[str, Any], part: Any, what: str) -> None:
        many = {"body": "bodies"}.get(what, f"{what}s")
        require(part.name != "ground", f'A {what} cannot be called "ground": that is the world.')
        require(part.name not in where, f'Two {many} are called "{part.name}".')
        where[part.name] = part

    def check(self, *, deep: bool = False) -> Mobility:
        """Degrees of freedom, redundant rows by joint, and what looks unusual; print it. Collective.

        ``deep``: compute the inf-sup constants of surface ties too, one by one (also on a halved mesh) and all together, and name
        those below 0.1 or falling like h.
        """
        return check(self, deep)

    def refuse_strangers(self) -> None:
        """Refuse what was put among the parts by hand and is none of their kind."""
        for place, (kind, _) in PLACES.items():
            parts = self.__dict__[place]
            for part in parts.values():  # no function is called for each: starts of small scenes would notice
                if not isinstance(part, kind):
                    self._fitting(place, parts)

    def build(self) -> tuple[System, State, dict[str, int]]:
        """The system, its state as given (not yet consistent), and the marker of each sensor; collective."""
        self.refuse_strangers()
        for name in loose_bodies(self) if self.origin is None else ():  # what was released is meant to fly
            log.warning('scene "%s": body "%s" is attached to nothing', self.name, name)
        return Builder(self).build()

    @property
    def dim(self) -> int:
        """Space dimension of all bodies."""
        require(bool(self.bodies), f'Scene "{self.name}" has no body.')
        dims = {b.dim for b in self.bodies.values() if b.dim is not None} or {2}
        if len(dims) > 1:
            listed = ", ".join(f"{b.name} ({b.dim})" for b in self.bodies.values() if b.dim is not None)
            raise InputError(f'Scene "{self.name}" mixes bodies of dimensions {sorted(dims)}: {listed}.')
        return int(dims.pop())
