"""Contact forces of a step: a state that carries them, and the sensors that read them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...checks import typed
from ...errors import InputError, near
from ...mechanics.joints.limits import JointLimit
from ...rotations import Array
from ..compiled.recording import Look, Recorded
from ..evaluation import Evaluation
from ..layout import Layout, State
from .named import or_name
from .sensor import Sensor, named_part

WORKS = ("contact", "friction", "loads", "joints", "numerical")


@dataclass(frozen=True)
class ContactForces:
    """Forces on the slaves' candidates during the last step, all ranks alike; of many steps with these as the first axis.

    Attributes: ``names`` of the pairs; ``pair`` (m,) their numbers; ``x``, ``normal`` (m, d); ``gap`` (m,) m
    at the end of the step; ``normal_force`` (m,) N; ``force`` (m, d) N in world axes; ``pressure`` (m,) N/m^(d-1) (N
    on rigid points); ``impulse`` (pairs, d) N s and ``work`` (J, in the order of WORKS) since the start; ``time`` s,
    when the forces act.
    """

    names: tuple[str, ...]
    time: float
    pair: np.ndarray
    x: Array
    normal: Array
    gap: Array
    normal_force: Array
    force: Array
    pressure: Array
    impulse: Array
    work: Array

    def record(self, i: int, time: float) -> ContactForces:
        """Those of one of many steps, which act at a time (s); arrays of its own."""
        return ContactForces(
            self.names,
            time,
            self.pair,
            x=self.x[i].copy(),
            normal=self.normal[i].copy(),
            gap=self.gap[i].copy(),
            normal_force=self.normal_force[i].copy(),
            force=self.force[i].copy(),
            pressure=self.pressure[i].copy(),
            impulse=self.impulse[i].copy(),
            work=self.work[i].copy(),
        )

    def of(self, name: str) -> np.ndarray:
        """Which candidates belong to a pair, (m,) bool."""
        if name not in self.names:
            raise InputError(f'No contact "{name}" in this run. {near(name, self.names)}')
        return self.pair == self.names.index(name)


@dataclass(frozen=True)
class ContactState(State):
    """A state with the contact forces of the step that led to it."""

    contact: ContactForces | None = field(default=None)


def forces_of(state: Any) -> ContactForces:
    """Contact forces of a state, or an error that says why there are none."""
    found = state.contact if isinstance(state, ContactState) else None
    if found is None:
        raise InputError("This run has no contact forces: add a contact to the scene, or use a scheme that treats it.")
    return found


class _OfSteps(Sensor):
    """What is told of contacts with a step."""

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """The quantity of the last step."""
        return self._told(forces_of(state), ev.system)

    def series(self, seen: Recorded, marker: int) -> Array:
        """The quantity of all records."""
        return self._told(seen.contact, seen.system)

    def _told(self, c: ContactForces, system: Layout) -> Array:
        """The quantity of a step, (size,), or of many, (k, size)."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class ContactSensor(_OfSteps):
    """A quantity of one pair: "force", "impulse", "pressure", "gap" or "work"; made by the functions
    below.
    """

    contact: str = ""
    quantity: str = "force"

    @property
    def reads(self) -> dict[str, str]:
        """A contact, but for the work of all."""
        return {"contact": self.contact} if self.contact else {}

    def looks_at(self, system: Layout, marker: int) -> Look:
        """Nothing beside what is told of contacts; gaps of elastic surfaces, where nothing touches, are found from states."""
        return Look(states=self.quantity == "gap" and bool(system.fields))

    def _told(self, c: ContactForces, system: Layout) -> Array:
        if self.quantity == "work":
            return c.work.copy()
        # arrays may hold many records in front
        on, pair = c.of(self.contact), c.names.index(self.contact)
        given = -1.0 if system.contacts.pairs[pair].exchanged else 1.0
        if self.quantity == "force":
            return np.asarray(given * c.force[..., on, :].sum(-2))
        if self.quantity == "impulse":
            return np.asarray(given * c.impulse[..., pair, :])
        if self.quantity == "pressure":
            return c.pressure[..., on].copy()
        return np.asarray(c.gap[..., on].min(-1, initial=np.inf, keepdims=True))

    def remember(self, m: Any, name: str, x: Array) -> Array:
        """Pressures are in the order of the candidates."""
        if self.quantity != "pressure":
            return super().remember(m, name, x)
        # candidates are numbered by rank: kept in an order that does not depend on it
        return np.asarray(m.candidates(name, x.T, m.system.contacts.names.index(self.contact)).T)

    @property
    def labels(self) -> str:
        """Forces and impulses have components along the world axes."""
        return "xyz" if self.quantity in ("force", "impulse") else ""


def _name(contact: Any) -> str:
    return named_part("contact", contact)


def reads_gaps(system: Layout) -> bool:
    """Whether a sensor reads gaps."""
    return any(isinstance(sensor, ContactSensor) and sensor.quantity == "gap" for sensor, _ in system.sensed)


def contact_force(contact: Any) -> Sensor:
    """Resultant force of a pair on the slave that was given, world axes, N, (d,); it acts in the middle of the last step, so
    there is none at the start.
    """
    return ContactSensor(None, "N", None, _name(contact), "force")


def contact_impulse(contact: Any) -> Sensor:
    """Impulse of a pair on the slave that was given since the start, world axes, N s, (d,)."""
    return ContactSensor(None, "N s", None, _name(contact), "impulse")


def contact_pressure(contact: Any) -> Sensor:
    """Pressure at the candidates of a pair, N/m^2 (plane: N/m; rigid points: N), in the order of
    ``state.contact.x``.
    """
    return ContactSensor(None, "N/m^2", None, _name(contact), "pressure")


def contact_gap(contact: Any) -> Sensor:
    """Smallest gap of a pair, m, (1,)."""
    return ContactSensor(None, "m", None, _name(contact), "gap")


def contact_work() -> Sensor:
    """Work since the start, J, (5,): of contact forces, friction, applied loads, driven joints, and the
    numerical rest.
    """
    return ContactSensor(None, "J", None, "", "work")


@dataclass(frozen=True, eq=False)
class LimitEffort(_OfSteps):
    """Mean effort of the stops of a joint coordinate over the last step; made by :func:`limit_effort`."""

    limit: str = ""

    @property
    def reads(self) -> dict[str, str]:
        """A joint limit."""
        return {"joint limit": self.limit}

    def looks_at(self, system: Layout, marker: int) -> Look:
        """Nothing beside what is told of contacts."""
        return Look()

    def _told(self, c: ContactForces, system: Layout) -> Array:
        # forces on the stops times their levers
        pair = system.contacts.pairs[c.names.index(self.limit)]
        efforts = pair.lever(system) * pair.signs * c.normal_force[..., c.of(self.limit)]
        return np.asarray(efforts.sum(-1, keepdims=True))


@or_name("limits")
@typed
def limit_effort(limit: JointLimit) -> Sensor:
    """Effort of a :func:`~fmbd_fenicsx.joint_limit` on its coordinate, N m or N, (1,); positive at the lower stop.

    It is the mean over the last step: times the step it is the impulse, impacts included.
    """
    unit = "N m" if limit.coordinate.unit == "rad" else "N"
    return LimitEffort(None, unit, limit=named_part("limit_effort: limit", limit))
