"""Relative coordinates of two markers, many of one kind at a time: what springs, drives, gears and sensors act on.

With markers a, b, d = x_b - x_a, unit vectors n (fixed in space) and e, e_1, e_2 (right-handed, fixed in a), f_1, f_2 (fixed
in b):

=================  ==========================================================================
kind               s
=================  ==========================================================================
``Separation``     the distance, sqrt(d . d)
``Slide``          e . d
``RelativeAngle``  atan2(e_2 . f_1 - e_1 . f_2, e_1 . f_1 + e_2 . f_2), the angle about e
``ExpressedCoordinate``      an expression of the user's own
=================  ==========================================================================

Each is defined once, in :mod:`~..kinds.definitions`; s, its rows, s' and s'' are evaluated by
:mod:`~..kinds.evaluation`. ``RelativeAngle`` goes beyond a turn: of
the values of atan2 it takes the one nearest to the counted angle of the configuration (:mod:`.counted`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from ...rotations import Array, Motions, tangents_of
from ..frames import Kinematics
from ..kinds.derivation import Kind, kinds
from ..kinds.evaluation import KindItems
from ..kinds.own import OwnTerm

# coordinates of second order in x and R, whose rows at the mean are exact; distances: that of the mean points over the mean one;
# others: by their difference (POINT, of efforts: taken at the mean)
POINT, SQUARE, DISTANCE, QUOTIENT = range(4)
# of the change that a motion by the model's length makes: rows of smaller ones are as exact as a quotient
UNMOVED = 1e-6
# of the coordinate itself, which is known to its roundoff: quotients of smaller changes would be noise to the iteration
UNKNOWN = 1e-5


def nearest(angle: Array, wanted: Array) -> Array:
    """The angles (rad) that differ from the given ones by whole turns and are nearest to those wanted."""
    turns = np.round((wanted - angle) / (2 * np.pi))
    return np.asarray(angle + 2 * np.pi * turns)


def dot(a: Array, b: Array) -> Array:
    """Scalar products over the last axis."""
    return np.asarray((a * b).sum(-1))


class RelativeCoordinates:
    """Coordinates of one kind between markers a and b; ``e`` (m, d): a direction each, for kinds that have one."""

    kind: ClassVar[str]
    angular: ClassVar[bool] = False  # rad, not m
    quotient: ClassVar[int] = SQUARE  # how its rows at the mean of two configurations become s_1 - s_0

    def __init__(self, motions: Motions, a: np.ndarray, b: np.ndarray, e: Array, kind: Kind | None = None) -> None:
        self.motions = motions
        self.a = np.asarray(a)
        self.b = np.asarray(b)
        self.e: Array = np.asarray(e, dtype=float).reshape(len(self.a), motions.dim)
        self.items = KindItems(motions, kind or kinds(motions.dim)[self.kind], self.a, self.b, self.constants())

    @property
    def markers(self) -> tuple[np.ndarray, ...]:
        """The markers (m,) that s depends on, in the order of :meth:`rows`."""
        return self.a, self.b

    @property
    def summands(self) -> tuple[RelativeCoordinates, ...]:
        """What it is the sum of: itself."""
        return (self,)

    @property
    def turns_only(self) -> bool:
        """Whether s depends on rotations alone."""
        return self.items.turns_only

    def size(self, length: float) -> float:
        """What s may be in a model of this length, m: that, or a radian."""
        return 1.0 if self.angular else length

    def constants(self) -> dict[str, Array]:
        """Constants of the kind, in the axes of the markers."""
        return {"e": self.e}

    def values(self, kin: Kinematics) -> Array:
        """s, (m,): m or rad."""
        return self.items.values(kin)

    def rows(self, kin: Kinematics) -> tuple[Array, ...]:
        """s' = sum of rows . twist over :attr:`markers`; each (m, d + n_rot)."""
        return self.items.rows(kin)

    def gamma(self, kin: Kinematics) -> Array:
        """s'' at zero marker accelerations (the markers' twist bias not included), (m,)."""
        return self.items.rates(kin)[1]

    def geometric(self, kin: Kinematics, effort: Array) -> Array:
        """Stiffness of constant efforts along the turning rows, (m, k n, k n), of k markers, n = d + n_rot."""
        return self.items.geometric(kin, effort)

    def rates(self, kin: Kinematics) -> Array:
        """s', (m,)."""
        assert kin.twist is not None
        return self.along(kin, kin.twist)

    def along(self, kin: Kinematics, twists: Array) -> Array:
        """The rates s' for twists of all markers, (m,)."""
        first, *rest = (row * twists[m] for m, row in zip(self.markers, self.rows(kin), strict=True))
        return np.asarray(sum(rest, first).sum(1))

    def swept(self, kin: Kinematics) -> Array:
        """The rates s' that the motions of the markers would add up to, none against another, (m,)."""
        assert kin.twist is not None
        return np.asarray(
            sum(np.abs(row * kin.twist[m]).sum(1) for m, row in zip(self.markers, self.rows(kin), strict=True))
        )

    def quotients(
        self, mean: Kinematics, ends: tuple[Kinematics, Kinematics], h: float, length: float
    ) -> tuple[Array, ...]:
        """Rows at the mean of two configurations, a step of h (s) apart, with h rows . twist = s_1 - s_0."""
        s0, s1 = (self.values(kin) for kin in ends)
        share = self.share(mean, (s0, s1), h * self.rates(mean), length)
        return tuple(share[:, None] * row for row in self.rows(mean))

    def share(self, mean: Kinematics, ends: tuple[Array, Array], linear: Array, length: float) -> Array:
        """Factor of the rows at the mean of two configurations with which s_1 - s_0 is their product with the motion between,
        ``linear`` without it; ``length``: of the model, m.
        """
        if self.quotient == SQUARE:
            return np.ones(len(linear))
        if self.quotient == DISTANCE:
            return np.asarray(2 * self.values(mean) / (ends[0] + ends[1]))
        # a quotient of two roundoffs says nothing; s may have any unit
        lengths = np.where(np.arange(self.motions.n_twist) < self.motions.dim, length, 1.0)
        whole = np.max([np.abs(rows * lengths).max(axis=1) for rows in self.rows(mean)], axis=0)
        far = np.abs(linear) > np.maximum(UNMOVED * whole, UNKNOWN * np.abs(ends[1]))
        return np.where(far, np.clip((ends[1] - ends[0]) / np.where(far, linear, 1.0), -10.0, 10.0), 1.0)


class CoordinateSums(RelativeCoordinates):
    """Sums s = offset + sum_k c_k s_k: ``terms`` s_k (m,) of one kind each, ``factors`` (m, k), ``offsets`` (m,) in m or rad."""

    def __init__(self, terms: Sequence[RelativeCoordinates], factors: Array, offsets: Array, *, angular: bool) -> None:
        self.motions, self._summands = terms[0].motions, tuple(terms)
        self.factors, self.offsets, self.is_angle = factors, offsets, angular
        self.a, self.b = terms[0].a, terms[0].b

    @property
    def markers(self) -> tuple[np.ndarray, ...]:
        """Those of all terms, one term after another."""
        return tuple(m for term in self._summands for m in term.markers)

    @property
    def summands(self) -> tuple[RelativeCoordinates, ...]:
        """s_k."""
        return self._summands

    @property
    def turns_only(self) -> bool:
        """Whether all terms depend on rotations alone."""
        return all(term.turns_only for term in self._summands)

    def size(self, length: float) -> float:
        """What s may be in a model of this length, m: that, or a radian."""
        return 1.0 if self.is_angle else length

    def _each(self) -> Iterator[tuple[RelativeCoordinates, Array]]:
        """s_k with c_k, (m,)."""
        return zip(self._summands, self.factors.T, strict=True)

    def values(self, kin: Kinematics) -> Array:
        """s, (m,): m or rad."""
        return np.asarray(self.offsets + sum(c * term.values(kin) for term, c in self._each()))

    def rows(self, kin: Kinematics) -> tuple[Array, ...]:
        """c_k times those of the terms."""
        return tuple(c[:, None] * row for term, c in self._each() for row in term.rows(kin))

    def gamma(self, kin: Kinematics) -> Array:
        """Sum of c_k times those of the terms."""
        return np.asarray(sum(c * term.gamma(kin) for term, c in self._each()))

    def geometric(self, kin: Kinematics, effort: Array) -> Array:
        """Those of the terms for efforts c_k N, on the diagonal."""
        width = 2 * self.motions.n_twist
        out = np.zeros((len(self.offsets), width * len(self._summands), width * len(self._summands)))
        for k, (term, c) in enumerate(self._each()):
            own = slice(width * k, width * (k + 1))
            out[:, own, own] = term.geometric(kin, c * effort)
        return out

    def quotients(
        self, mean: Kinematics, ends: tuple[Kinematics, Kinematics], h: float, length: float
    ) -> tuple[Array, ...]:
        """c_k times those of the terms."""
        return tuple(c[:, None] * row for term, c in self._each() for row in term.quotients(mean, ends, h, length))


class Separation(RelativeCoordinates):
    """Distance of the two points."""

    kind = "separation"
    quotient = DISTANCE


class Slide(RelativeCoordinates):
    """Difference of the two points along directions fixed in a."""

    kind = "along"


class ExpressedCoordinate(RelativeCoordinates):
    """A coordinate by a formula of the user's own; ``terms``: those of all items, of one kind."""

    kind = "own"
    quotient = QUOTIENT

    def __init__(self, motions: Motions, a: np.ndarray, b: np.ndarray, terms: Sequence[OwnTerm]) -> None:
        self.terms = terms
        super().__init__(motions, a, b, np.zeros((len(terms), motions.dim)), terms[0].kind)

    def constants(self) -> dict[str, Array]:
        """The numbers in the formulas."""
        return {name: np.array([term.constants[name] for term in self.terms]) for name in self.terms[0].constants}


class RelativeAngle(RelativeCoordinates):
    """Rotation of b against a about directions fixed in a, beyond a turn; 0 where the marker axes agree."""

    kind = "angle"
    angular = True
    quotient = QUOTIENT  # the angle turned over 2 tan of its half: w is that of the Cayley map

    def constants(self) -> dict[str, Array]:
        """Axes e_1, e_2 across the axis, of both markers."""
        if self.motions.dim == 3:
            self.e1, self.e2 = tangents_of(self.e)
        else:
            self.e1, self.e2 = np.tile([1.0, 0.0], (len(self.a), 1)), np.tile([0.0, 1.0], (len(self.a), 1))
        return {"fa": self.e1, "ga": self.e2, "fb": self.e1, "gb": self.e2}

    def attitude(self, R: Array) -> Array:
        """Angles in (-pi, pi], rad, (..., m), for the rotations (..., markers, d, d) of all markers."""
        e1 = self.e1[: len(self.a), :, None]
        e2 = self.e2[: len(self.a), :, None]
        Ra, Rb = R[..., self.a, :, :], R[..., self.b, :, :]
        # axes of both markers in the world
        a1, a2, b1, b2 = ((turn @ e)[..., 0] for turn in (Ra, Rb) for e in (e1, e2))
        return np.asarray(np.arctan2(dot(a2, b1) - dot(a1, b2), dot(a1, b1) + dot(a2, b2)))

    def values(self, kin: Kinematics) -> Array:
        """Angle from a to b about the axis, rad, followed beyond a full turn."""
        assert kin.turned is not None
        return nearest(super().values(kin), kin.turned[self.b] - kin.turned[self.a])
