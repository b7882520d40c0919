"""Elementary constraints between two markers; every joint is a list of them, evaluated in batches of one kind.

With markers a, b, positions x, world axes R, difference d = x_b - x_a, unit vectors n (fixed in space), e (fixed in a), f (fixed
in b) and a smooth offset s(t):

=================  ======================================
kind               g
=================  ======================================
``Coincident``     n . d - s
``Along``          e . d - s
``Perpendicular``  e . f
``Turned``         e . f, e turned in a by the angle s
``Distance``       (d . d / L - L) / 2
``Apart``          |d| - L(t)
``ExpressedConstraint``      a formula of the user's own
=================  ======================================

Each is defined once, in :mod:`~..kinds.definitions`; g, its rows, g_t and g'' are evaluated by :mod:`~..kinds.evaluation`. The
second derivative g'' = G a + gamma uses the twist biases of the markers. A row's multiplier is the generalised force on the first
marker: a row of ``Coincident`` has force +lambda n on a, -lambda n on b.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ...rotations import Array, Motions
from ..frames import Kinematics
from ..kinds.derivation import Kind, kinds
from ..kinds.evaluation import KindItems

Motion = Callable[[float], tuple[float, float, float]]
"""A prescribed motion: t -> (s, s', s'')."""


Sides = Sequence[tuple[np.ndarray, np.ndarray, Array]]
Curves = Sequence[tuple[tuple[np.ndarray, ...], Array]]


def standstill(t: float) -> tuple[float, float, float]:
    """The offset s = 0 of a constraint that nothing drives."""
    return 0.0, 0.0, 0.0


@dataclass(frozen=True, eq=False)
class Row:
    """One elementary constraint of a joint; directions in world axes of the initial configuration."""

    kind: type[Batch]
    direction: Array  # in marker a, or in space
    other: Array | None = None  # in marker b
    motion: Motion = standstill
    axis: Array | None = None  # in marker a: what a driven ``Perpendicular`` turns about
    own: Kind | None = None  # of ``ExpressedConstraint``
    constants: Mapping[str, Any] = field(default_factory=dict)  # of a kind that has names for them


class PlacedRow(NamedTuple):
    """A row between two markers, of a joint with a length (m)."""

    row: Row
    a: int
    b: int
    length: float


class Batch:
    """All constraints of one kind: g, the rows of dg/d(twist of a), dg/d(twist of b), and gamma.

    ``on_speeds``: the rows hold between velocities and are no rates of a g, which is then 0 everywhere (nonholonomic).
    ``of_time``: rows of a state that is held depend on time, and with them what multipliers push.
    """

    kind: ClassVar[str]
    on_speeds: ClassVar[bool] = False
    of_time: ClassVar[bool] = False

    def __init__(self, motions: Motions, pairs: list[PlacedRow]) -> None:
        self.motions = motions
        self.a = np.array([p.a for p in pairs])
        self.b = np.array([p.b for p in pairs])
        self.driven = [(i, p.row.motion) for i, p in enumerate(pairs) if p.row.motion is not standstill]
        kind = pairs[0].row.own or kinds(motions.dim)[self.kind]
        self.items = KindItems(motions, kind, self.a, self.b, self.constants(pairs))

    def constants(self, pairs: list[PlacedRow]) -> dict[str, Array]:
        """Constants of the kind by name, in the axes of the markers."""
        return {"e": np.array([p.row.direction for p in pairs], dtype=float)}

    def lengths(self, length: float) -> Array:
        """What turns the values of the rows into lengths (m), for a model of a size (m): it, for rows that are angles."""
        return np.ones(len(self.a))

    def offsets(self, t: float) -> Array:
        """(3, m) array of s, s', s''."""
        s = np.zeros((3, len(self.a)))
        for i, motion in self.driven:
            s[:, i] = motion(t)
        return s

    def values(self, kin: Kinematics, t: float) -> Array:
        """g, shape (m,)."""
        s = self.items.values(kin)
        return s - self.offsets(t)[0] if self.driven else s

    def rows(self, kin: Kinematics, t: float) -> tuple[Array, Array]:
        """dg/dt = rows_a . twist_a + rows_b . twist_b + rate; each (m, d + n_rot)."""
        return self.items.rows(kin)

    def rate(self, kin: Kinematics, t: float) -> Array:
        """The part of dg/dt that depends on time only, (m,)."""
        return -self.offsets(t)[1]

    def gamma(self, kin: Kinematics, t: float) -> Array:
        """g'' at zero marker accelerations (the markers' twist bias not included), (m,)."""
        second = self.items.rates(kin)[1]
        return second - self.offsets(t)[2] if self.driven else second

    def curves(self, kin: Kinematics, t: float, lam: Array) -> Curves:
        """What constant multipliers (m,) push across: symmetric part of d(rows^T lam)/d(displacements of k markers),
        (m, k n, k n); none of kinds whose rows stand still.
        """
        return [((self.a, self.b), self.items.geometric(kin, lam))] if self.items.kind.pattern else []

    def sides(self, kin: Kinematics, t: float) -> Sides:
        """The rows by marker: (numbers of the constraints, markers, rows (k, d + n_rot))."""
        ra, rb = self.rows(kin, t)
        every = np.arange(len(self.a))
        return ((every, self.a, ra), (every, self.b, rb))


class Coincident(Batch):
    """n . (x_b - x_a) = s, n fixed in space."""

    kind = "coincident"


class Along(Batch):
    """e . (x_b - x_a) = s, e fixed in marker a."""

    kind = "along"


class Distance(Batch):
    """|x_b - x_a| = L, as (d . d / L - L) / 2 = 0; the multiplier is the force in the rod (positive: tension)."""

    kind = "distance"

    def constants(self, pairs: list[PlacedRow]) -> dict[str, Array]:
        """The lengths."""
        return {"length": np.array([p.length for p in pairs])}


class Apart(Batch):
    """|x_b - x_a| = s, a length given in time; the multiplier is the force in the rope (positive: tension)."""

    kind = "separation"


class NamedConstants(Batch):
    """Constraints of a kind whose joints give its constants by name."""

    def constants(self, pairs: list[PlacedRow]) -> dict[str, Array]:
        """As the rows of the joints name them."""
        return {name: np.array([p.row.constants[name] for p in pairs], dtype=float) for name in pairs[0].row.constants}


class Perpendicular(Batch):
    """e . f = 0, e fixed in marker a, f fixed in marker b."""

    kind = "perpendicular"

    def constants(self, pairs: list[PlacedRow]) -> dict[str, Array]:
        """Both directions."""
        other = [p.row.direction if p.row.other is None else p.row.other for p in pairs]
        return super().constants(pairs) | {"f": np.array(other, dtype=float)}

    def lengths(self, length: float) -> Array:
        """Cosines: all of them by the length."""
        return np.full(len(self.a), length)


class DrivenKinds(Batch):
    """Constraints whose kind itself depends on a motion of time, as one of its constants."""

    of_time = True

    def _drive(self, t: float) -> None:
        """The motions and their rates at time t into the constants of the items."""
        for name, s in zip(("drive", "drive1", "drive2"), self.offsets(t), strict=True):
            self.items.constant(name)[:, 0] = s

    def values(self, kin: Kinematics, t: float) -> Array:
        """g at the motions of time t."""
        self._drive(t)
        return self.items.values(kin)

    def rows(self, kin: Kinematics, t: float) -> tuple[Array, Array]:
        """Its rows."""
        self._drive(t)
        return self.items.rows(kin)

    def curves(self, kin: Kinematics, t: float, lam: Array) -> Curves:
        """Of its rows."""
        self._drive(t)
        return super().curves(kin, t, lam)

    def rate(self, kin: Kinematics, t: float) -> Array:
        """g_t."""
        self._drive(t)
        return self.items.rates(kin)[0]

    def gamma(self, kin: Kinematics, t: float) -> Array:
        """Terms quadratic in the velocities, and those of the motions."""
        self._drive(t)
        return self.items.rates(kin)[1]


class Turned(DrivenKinds, Perpendicular):
    """The same, e turned in marker a about ``axis`` by the motion: the angle between the markers follows it."""

    kind = "turned"

    def constants(self, pairs: list[PlacedRow]) -> dict[str, Array]:
        """Both directions, and where e turns to."""
        found = super().constants(pairs)
        e = found["e"]
        if self.motions.dim == 2:
            return found | {"g": np.stack((-e[:, 1], e[:, 0]), -1)}
        axis = np.array([p.row.direction if p.row.axis is None else p.row.axis for p in pairs], dtype=float)
        return found | {"g": np.cross(axis, e)}


class ExpressedConstraint(NamedConstants):
    """A formula of a user's own is zero; one kind a batch."""

    kind = "own"

    def lengths(self, length: float) -> Array:
        """Formulas of rotations alone are angles; others are lengths."""
        return np.full(len(self.a), length if self.items.turns_only else 1.0)


class ExpressedInTime(DrivenKinds, ExpressedConstraint):
    """The same, with time in the formula: its motion is the time itself."""


class ExpressedSpeed(ExpressedConstraint):
    """A formula of a user's own, linear in velocities but for a given speed, is zero."""

    on_speeds = True

    def rate(self, kin: Kinematics, t: float) -> Array:
        """The given speed."""
        return self.items.rates(kin)[0]


class ExpressedSpeedInTime(DrivenKinds, ExpressedSpeed):
    """The same, with time in the formula."""
