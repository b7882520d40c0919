"""Applied forces in batches of one kind: wrenches on markers in world axes, potential energies, tangents.

A law on a relative coordinate s (see ``mechanics.joints.relative``) with restoring effort N(s, s', t) has the wrenches

    w_a = -N r_a,   w_b = -N r_b,        K = dN/ds r r^T + N ds-rows,   D = dN/ds' r r^T,    r = (r_a, r_b)        (1)

and on as many markers more as s depends on, where it is a sum. K and D are minus the derivatives of the wrenches with respect to
displacements and velocities of the markers; they serve as Newton tangents only. User functions are checked on every call; an
error names the force.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError
from ...rotations import Array, Motions
from ..frames import Kinematics
from ..joints.relative import RelativeCoordinates, Separation
from .effort_laws import EffortLaw
from .formulas import Formula, SampledEffort, formulas_of
from .laws_together import LawsTogether
from .passed_over import PassedOver
from .roads import Roads
from .user_laws import Repeatable


@dataclass(frozen=True)
class MarkerTangent:
    """Stiffness and damping (m, k n, k n) over the displacements of k ``markers`` (m,), n = d + n_rot."""

    markers: tuple[np.ndarray, ...]
    K: Array
    D: Array


@dataclass(frozen=True)
class MarkerMotion:
    """What a force law of the user's own sees of a marker: position (m), rotation since the start, velocity, angular velocity."""

    x: Array
    R: Array
    v: Array
    w: Array


class Loads:
    """Forces of one kind with their markers, a and b for most. ``stiff``: whether they depend on the motion of their markers in a
    way that :meth:`tangent` gives.
    """

    stiff = True
    length = 1.0  # m, of the model: the scale of steps of differences

    def __init__(self, motions: Motions, forces: list[Any], markers: list[tuple[int, int]]) -> None:
        self.motions, self.forces = motions, forces
        self.laws = [self.law_of(f) for f in forces]
        self.a: np.ndarray = np.array([a for a, _ in markers])
        self.b: np.ndarray = np.array([b for _, b in markers])

    @staticmethod
    def law_of(f: Any) -> Any:
        """The user's function of a force, its exceptions named; None without one."""
        return None if f.law is None else Repeatable(f"The law of {f.kind}", f.name, f.law)

    @property
    def follows_laws(self) -> bool:
        """Whether laws tell some of them: those of the motion, whose stiffness may not last, or of time, which may be a pulse."""
        known = ((law, getattr(f, "law", None)) for law, f in zip(self.laws, self.forces, strict=True))
        return any(law is not None and not getattr(given, "stays", False) for law, given in known)

    @property
    def markers(self) -> tuple[np.ndarray, ...]:
        """All markers that they act on, (m,) each."""
        return self.a, self.b

    def wrenches(self, kin: Kinematics, t: float) -> tuple[Array, ...]:
        """Wrenches (force, torque) in world axes on the :attr:`markers`, each (m, d + n_rot)."""
        raise NotImplementedError

    def wrenches_at(self, kins: Sequence[Kinematics], times: Sequence[float]) -> tuple[Array, Array]:
        """Those on two markers in many configurations at their times (s), each (k, m, d + n_rot)."""
        a, b = zip(*[self.wrenches(kin, t) for kin, t in zip(kins, times, strict=True)], strict=True)
        return np.array(a), np.array(b)

    def energy(self, kin: Kinematics, t: float) -> float:
        """Potential energy, J."""
        return 0.0

    def tangent(self, kin: Kinematics, t: float) -> MarkerTangent | None:
        """Minus the derivatives of the wrenches, or None where they are neglected."""
        return None

    def scalar(self, kin: Kinematics, t: float) -> tuple[Array, Array, Array] | None:
        """Of elements on one coordinate: elongations s, rates s' and restoring efforts N, each (m,); None for others."""
        return None

    def formulas(self) -> list[Formula]:
        """Formulas of those elements on one coordinate that compiled steps know; none where Python has to be asked."""
        return []

    def sampled(self) -> list[SampledEffort]:
        """Efforts that stay the same between samples."""
        return []

    @property
    def called(self) -> bool:
        """Whether a law that reads more than its own coordinate is called at every evaluation."""
        return False

    @property
    def told(self) -> bool:
        """Whether compiled steps have efforts of its own that may have a memory."""
        return self.called or bool(self.formulas() or self.sampled())

    def mounts(self) -> tuple[Array, Array] | None:
        """Of bushings: K and C (m, n, n) in the axes of markers a; None for others."""
        return None

    kept: Any = None  # memory of elements that have one: arrays, changed by accepted steps only, see ``accepted``
    by_ends: bool = False  # whether it is moved by the ends of steps, whatever was between

    def first(self, ev: Any, state: Any) -> Any:
        """The memory at the start of a run from a state, evaluated as ``ev``."""
        return None

    def accepted(self, ev: Any, state: Any) -> Any:
        """The memory after a step that ended in a state, evaluated as ``ev``."""
        return self.kept

    def overran(self, ev: Any, h: float, rtol: float) -> bool:
        """Whether a step of h (s) to a state, evaluated as ``ev``, was too long for the memory to follow within ``rtol``."""
        return False

    def passed_over(self, t: float) -> list[PassedOver]:
        """What laws do at a time (s) between the coordinates at which steps have asked them so far."""
        return []

    @property
    def chattering(self) -> list[str]:
        """Names of elements whose memory tells that steps did not follow them."""
        return []

    @property
    def due(self) -> float:
        """When the memory jumps next, s."""
        return np.inf

    def jumps(self, kept: Any) -> bool:
        """Whether forces jump when the memory becomes ``kept``."""
        return False

    @property
    def collocates(self) -> bool:
        """Whether its memory is found at the points of a step together; its errors are told."""
        return False

    def collocate(self, rule: Any, kins: Sequence[Kinematics]) -> None:
        """Find the memory at the points of a step, whose markers are ``kins``, by the rule of the scheme."""

    def divide(self, times: Array) -> None:
        """Take the last step for several, which began at these times (s), the newest first."""

    def lead(self, share: float) -> None:
        """Where a tangent of the step is taken the memory answers to its rates by so much (s)."""

    def memory_error(self, of: Any) -> float:
        """The error of the memory in the step whose points were found last, over the tolerance."""
        return 0.0

    def trapezoid_error(self, kin: Kinematics, t: float, rtol: float, atol: float) -> float:
        """The error of the memory that went to t, where markers are ``kin``, by the trapezoidal rule, over the tolerance."""
        return 0.0

    def memory_values(self) -> Array:
        """The memory as numbers (m,) that small motions change; (0,) where it stays as it is."""
        return np.zeros(0)

    def set_memory(self, values: Array, t: float) -> None:
        """Take these numbers as the memory at time t, s."""

    def memory_rates(self, ev: Any, t: float) -> Array:
        """Rates (m,) of these numbers in a configuration evaluated as ``ev``, 1/s."""
        return np.zeros(0)

    def _zero(self) -> Array:
        return np.zeros((len(self.forces), self.motions.dim + self.motions.n_rot))


class TimeLoads(Loads):
    """Forces and torques that depend on time (and, as followers, on the rotation of their marker)."""

    stiff = False

    def value(self, i: int, t: float) -> Array:
        """The force (N) or torque (N m) of load i at time t, in its own axes."""
        f = self.forces[i]
        return np.asarray(self.laws[i].numbers(self.motions.n_rot if f.turns else self.motions.dim, t))

    def wrenches(self, kin: Kinematics, t: float) -> tuple[Array, Array]:
        """Forces and torques prescribed in time."""
        d = self.motions.dim
        out = self._zero()
        for i, f in enumerate(self.forces):
            part = slice(d, None) if f.turns else slice(0, d)
            value = self.value(i, t)
            # followers turn with their marker; a torque in the plane is one number
            follow = f.follower and len(value) == d
            out[i, part] = kin.R[self.a[i]] @ value if follow else value
        return out, self._zero()


class ScalarLoads(Loads):
    """Efforts N on relative coordinates, (1): linear springs and dampers, and laws of the user's own."""

    def __init__(
        self, motions: Motions, forces: list[Any], markers: list[tuple[int, int]], relative: RelativeCoordinates
    ) -> None:
        super().__init__(motions, forces, markers)
        self.relative = relative
        self.k = np.array([f.stiffness for f in forces], dtype=float)
        self.c = np.array([f.damping for f in forces], dtype=float)
        self.free = np.array([f.length for f in forces], dtype=float)
        self.own = np.flatnonzero([f.law is not None for f in forces])
        self._together: dict[bytes, LawsTogether] = {}  # by their numbers
        self.line: Callable[[Array, Array], Array] | None = None  # N of s and s' in place of laws, see :meth:`straight`

    @property
    def markers(self) -> tuple[np.ndarray, ...]:
        """Those of the coordinates."""
        return self.relative.markers

    def _state(self, kin: Kinematics) -> tuple[Array, Array]:
        """s - free and s'."""
        s = self.relative.values(kin)
        if isinstance(self.relative, Separation) and not s.all():
            raise InputError(
                f'Spring "{self.forces[int(np.argmin(s))].name}": its two points coincide, so it has no direction. One that '
                "has no length at rest is fmbd.force_element(name, a, b, lambda a, b, t: 0.5 * k * (b.x - a.x) @ (b.x - a.x))."
            )

        return s - self.free, self.relative.rates(kin)

    def laws_of(self, which: np.ndarray) -> LawsTogether:
        """The laws of the user's own of some forces, (m,): N at their elongations and rates (.., m)."""
        key = which.tobytes()
        if key not in self._together:
            self._together[key] = LawsTogether([self.laws[i] for i in which], self.relative.size(self.length))
        return self._together[key]

    def slopes(self, which: np.ndarray, s: Array, rate: Array, t: float) -> tuple[Array, Array]:
        """dN/ds and dN/ds' of the same: by the law's own formula where it is one of the package's, else by differences."""
        k, c = np.empty(len(which)), np.empty(len(which))
        stated = np.array([isinstance(self.forces[i].law, EffortLaw) for i in which], dtype=bool)
        for n in np.flatnonzero(stated):
            k[n], c[n] = self.forces[which[n]].law.slopes(s[n], rate[n], t)
        rest = ~stated
        if rest.any():
            k[rest], c[rest] = self.laws_of(which[rest]).slopes(s[rest], rate[rest], t)
        return k, c

    def passed_over(self, t: float) -> list[PassedOver]:
        """As :meth:`Loads.passed_over`."""
        return [x for laws in self._together.values() for x in laws.asked.passed_over(laws.laws, t)]

    def given(self, which: np.ndarray, t: float) -> Array:
        """N of drives whose effort depends on time only."""
        return np.array([self.laws[i].number(0.0, 0.0, t) for i in which])

    def formulas(self) -> list[Formula]:
        """Those of the laws of the package."""
        return formulas_of([f.law for f in self.forces], self.relative)

    def effort(self, s: Array, rate: Array, t: float) -> Array:
        """N of elongations s and rates, (.., m)."""
        N = self.k * s + self.c * rate
        if len(self.own):
            N[..., self.own] = self.laws_of(self.own)(s[..., self.own], rate[..., self.own], t)
        return N

    def wrenches(self, kin: Kinematics, t: float) -> tuple[Array, ...]:
        """-N along the rows of the coordinate."""
        s, rate = self._state(kin)
        N = (self.effort(s, rate, t) if self.line is None else self.line(s, rate))[:, None]
        return tuple(-N * row for row in self.relative.rows(kin))

    @contextmanager
    def straight(self, kin: Kinematics, t: float) -> Iterator[None]:
        """Meanwhile efforts change from those of a configuration by its slopes alone."""
        s0, rate0, N = self.scalar(kin, t)
        k, c = self._all_slopes(s0, rate0, t)
        self.line = lambda s, rate: N + k * (s - s0) + c * (rate - rate0)
        try:
            yield
        finally:
            self.line = None

    def scalar(self, kin: Kinematics, t: float) -> tuple[Array, Array, Array]:
        """s, s' and N."""
        s, rate = self._state(kin)
        return s, rate, self.effort(s, rate, t)

    def energy(self, kin: Kinematics, t: float) -> float:
        """k s^2 / 2 of the linear springs, and what laws of the package store, J."""
        s = self.relative.values(kin) - self.free
        linear = np.array([f.law is None for f in self.forces])
        # laws of a user's own have no potential that anybody knows
        stored = sum(f.law.stored(x) for f, x in zip(self.forces, s, strict=True) if isinstance(f.law, EffortLaw))
        return 0.5 * float((self.k * s**2)[linear].sum()) + float(stored)

    def _all_slopes(self, s: Array, rate: Array, t: float) -> tuple[Array, Array]:
        """dN/ds and dN/ds' of all, linear ones too."""
        k, c = self.k.copy(), self.c.copy()
        if len(self.own):
            k[self.own], c[self.own] = self.slopes(self.own, s[self.own], rate[self.own], t)
        return k, c

    def tangent(self, kin: Kinematics, t: float) -> MarkerTangent:
        """Material stiffness k and damping c, and the geometric stiffness of N."""
        s, rate = self._state(kin)
        N, (k, c) = self.effort(s, rate, t), self._all_slopes(s, rate, t)
        r = np.concatenate(self.relative.rows(kin), axis=1)
        rr = r[:, :, None] * r[:, None, :]
        K, D = k[:, None, None] * rr, c[:, None, None] * rr
        # the direction turns: an effort along it is stiff across
        K += self.relative.geometric(kin, N)
        return MarkerTangent(self.markers, K, D)


class TyreLoads(Loads):
    """Radial springs between a wheel centre and a road: N = k c + d c' while c = radius - height over the road > 0, N >= 0."""

    def __init__(self, motions: Motions, forces: list[Any], markers: list[tuple[int, int]]) -> None:
        super().__init__(motions, forces, markers)
        self.up: Array = np.array([f.up[: motions.dim] for f in forces], dtype=float)
        self.stiffness: Array = np.array([f.stiffness for f in forces])
        self.damping: Array = np.array([f.damping for f in forces])
        self.roads = Roads(forces)

    @staticmethod
    def law_of(f: Any) -> Any:
        """The road."""
        return f.road

    def passed_over(self, t: float) -> list[PassedOver]:
        """As :meth:`Loads.passed_over`, of roads."""
        return self.roads.passed_over(t, self.up)

    def _compression(self, kin: Kinematics, t: float, *, rates: bool = True) -> tuple[Array, Array]:
        """c and c', where dampers ask for ``rates``; else c' is zero."""
        places, along = kin.x[self.a], np.add.reduce
        if rates and np.logical_or.reduce(self.damping):
            assert kin.twist is not None
            speeds = kin.twist[self.a, : self.motions.dim]
            heights, rate = self.roads.moving(places, speeds, t).T
            rate = rate - along(self.up * speeds, axis=1)
        else:
            heights, rate = self.roads.heights(places, t), np.zeros(len(places))
        return heights + self.roads.radius - along(self.up * places, axis=1), rate

    def wrenches(self, kin: Kinematics, t: float) -> tuple[Array, Array]:
        """Force of the compressed tyres; none while lifted."""
        c, rate = self._compression(kin, t)
        out, none = np.zeros((2, len(c), self.motions.n_twist))
        # a tyre pushes only, also where its damper would pull
        push = np.maximum(self.stiffness * c + self.damping * rate, 0.0) * (c > 0)
        out[:, : self.motions.dim] = push[:, None] * self.up
        return out, none

    def energy(self, kin: Kinematics, t: float) -> float:
        """k c^2 / 2 of the compressed ones, J."""
        c = np.maximum(self._compression(kin, t, rates=False)[0], 0.0)
        return 0.5 * float((self.stiffness * c**2).sum())

    def tangent(self, kin: Kinematics, t: float) -> MarkerTangent:
        """k and c along the direction of compression, of those in contact."""
        c, rate = self._compression(kin, t)
        # those that push
        on = (c > 0) & (self.stiffness * c + self.damping * rate > 0)
        up, d = self.up, self.motions.dim
        speeds = np.zeros_like(kin.x) if kin.twist is None else kin.twist[:, :d]
        row, bend = up.copy(), np.zeros_like(up)  # -dc/dx, and by how much a place changes the road's rate
        for i in np.flatnonzero(on):
            slope, bend[i] = self.roads.slopes(i, kin.x[self.a[i]], speeds[self.a[i]], t)
            row[i] -= slope
        n = d + self.motions.n_rot
        K, D = np.zeros((2, len(c), 2 * n, 2 * n))
        K[:, :d, :d] = up[:, :, None] * (self.stiffness[:, None] * row - self.damping[:, None] * bend)[:, None, :]
        D[:, :d, :d] = up[:, :, None] * (self.damping[:, None] * row)[:, None, :]
        active = on[:, None, None]
        return MarkerTangent(self.markers, active * K, active * D)
