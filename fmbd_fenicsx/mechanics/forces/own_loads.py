"""Forces by a law of the user's own of the motions of one or two markers, its slopes given, written or differences.

The law is asked once with symbols for x, R, v and w of its markers. What it returns is differentiated along their displacements
and velocities, a small turn theta being dR = theta x R. A law with cases, tables or other libraries writes no formulas; one
whose numbers are changed from outside writes others later, which its values show.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

import numpy as np

from ...errors import CallbackError, LawError, excused, named
from ...rotations import Array, Motions
from ..frames import Kinematics
from ..kinds.expressions import Expression, Program, as_expression, gradient, passing, symbol
from ..kinds.frames import Vector, cross
from .force_elements import Loads, MarkerMotion, MarkerTangent
from .user_laws import Repeatable, checked

SEEN = ("x", "R", "v", "w")
TIME = symbol("t")


@dataclass(frozen=True)
class WrenchFormula:
    """Force and torque of a law of ``sides`` markers, (n,), and their slopes, one row after the other."""

    program: Program
    names: Sequence[str]
    sides: int

    def __call__(self, t: float, motions: Sequence[MarkerMotion]) -> tuple[Array, Array] | None:
        """Force and torque (n,), derivatives by displacements and by velocities (2, n, sides n); None without finite ones."""
        seen = [np.ravel(getattr(x, name)) for x in motions for name in SEEN]
        given = dict(zip(self.names, np.concatenate(seen).tolist(), strict=True))
        try:
            found = self.program({**given, "t": t})
        except (ArithmeticError, ValueError):
            return None
        if not isfinite(sum(found)):
            return None
        n = len(motions[0].v) + len(motions[0].w)
        table = np.reshape(found, (n, 1 + 2 * self.sides * n))
        return table[:, 0], table[:, 1:].reshape(n, 2, -1).swapaxes(0, 1)


Answers = dict[tuple[int | Expression, ...], WrenchFormula]  # by the number of markers, and what a law answers


def wrench_formulas(laws: Sequence[tuple[Callable[..., Any], int]], dim: int) -> list[WrenchFormula | None]:
    """The formulas of laws law(t, *markers), each with how many markers it takes; None for a law that does not take symbols.

    Laws that write the same have one, and are differentiated once.
    """
    with passing():
        markers = [_marker(side, dim) for side in range(max((sides for _, sides in laws), default=0))]
        known: Answers = {}
        return [_formula(law, markers[:sides], known) for law, sides in laws]


def _formula(law: Callable[..., Any], markers: Sequence[MarkerMotion], known: Answers) -> WrenchFormula | None:
    """That of one law, which is ``known`` by what others of as many markers have answered."""
    try:
        answer = [as_expression(y) for part in law(TIME, *markers) for y in np.ravel(part)]
    except Exception:
        return None
    if len(answer) != len(markers[0].v) + len(markers[0].w):
        return None

    key: tuple[int | Expression, ...] = (len(markers), *answer)
    if key not in known:
        rows = [row for y in answer for row in (y, *_along(y, markers))]
        names = [s.arguments[0] for x in markers for name in SEEN for s in np.ravel(getattr(x, name))]
        known[key] = WrenchFormula(Program(rows, numbers=True), names, len(markers))
    return known[key]


def _marker(side: int, dim: int) -> MarkerMotion:
    """A motion of symbols."""
    turns = 2 * dim - 3
    shapes = {"x": (dim,), "R": (dim, dim), "v": (dim,), "w": (turns,)}
    made = {
        name: np.array([symbol(f"{name}{side}_{i}") for i in range(int(np.prod(shape)))], dtype=object).reshape(shape)
        for name, shape in shapes.items()
    }
    return MarkerMotion(**made)


def _along(y: Expression, markers: Sequence[MarkerMotion]) -> list[Expression]:
    """Derivatives of y by the displacements of all markers, then by their velocities."""
    seen = [z for x in markers for name in SEEN for z in np.ravel(getattr(x, name))]
    by = dict(zip(seen, gradient(y, seen), strict=True))
    displaced: list[Expression] = []
    for marker in markers:
        turns = Vector([0.0] * len(marker.w))
        for axis in marker.R.T:
            turns = turns + cross(axis, [by[z] for z in axis])
        displaced += [by[z] for z in marker.x] + list(turns)
    return displaced + [by[z] for x in markers for z in (*x.v, *x.w)]


SMALL = 1e-7  # steps of differences as shares of a length, a turn, a speed: about the root of roundoff
SLOWEST = 1e-2  # 1/s: lengths of the model a second; speeds below are differenced as this one
SAME = 1e-9  # of all that roundoff may change, by which a formula may differ from its law


class _Watched(MarkerMotion):
    """A motion that notes what of it is read: a law can depend on nothing else."""

    def __getattribute__(self, name: str) -> Any:
        """The attribute; ``__dict__`` is all of them."""
        if name in SEEN or name == "__dict__":
            object.__getattribute__(self, "__dict__").setdefault("read", set()).update(
                SEEN if name == "__dict__" else (name,)
            )
        return object.__getattribute__(self, name)


def _what_was_read(motion: MarkerMotion) -> set[str]:
    found: set[str] = object.__getattribute__(motion, "__dict__").get("read", set())
    return found


class OwnLoads(Loads):
    """Forces law(t, a, b) of the user's own; K and D of the tangent by formulas or differences where no Jacobian is given."""

    def __init__(self, motions: Motions, forces: list[Any], markers: list[tuple[int, int]]) -> None:
        super().__init__(motions, forces, markers)
        # (m, 1): those without a second marker
        self.single: np.ndarray = np.array([f.b is None for f in forces])[:, None]
        self.alone = int(self.single.sum())
        self.written: dict[int, WrenchFormula | None] = {}  # of laws without a Jacobian, once slopes were asked of one

    @staticmethod
    def law_of(f: Any) -> Any:
        """The law, and the Jacobian or None."""
        jacobian = None if f.jacobian is None else named("The Jacobian of force", f.name, f.jacobian, time=0)
        return Repeatable("The law of force", f.name, f.law, time=0), jacobian

    def _motions(self, k: int, kin: Kinematics, kind: Callable[..., MarkerMotion] = MarkerMotion) -> list[MarkerMotion]:
        """What the law of force k sees: one marker, or two."""
        d, twist = self.motions.dim, kin.twist
        assert twist is not None
        markers = (self.a[k],) if self.forces[k].b is None else (self.a[k], self.b[k])
        return [kind(kin.x[i], kin.R[i], twist[i, :d], twist[i, d:]) for i in markers]

    def _answer(self, k: int, t: float, motions: list[MarkerMotion]) -> Array:
        """Force and torque that the law of force k returns, (n,)."""
        d, law = self.motions.dim, self.laws[k][0]
        n = d + self.motions.n_rot
        usual: Array | None = law.wrench(n, d, t, *motions)  # this is called at every iterate
        if usual is not None:
            return usual
        try:
            return self._checked(k, t, law(t, *motions))
        except (CallbackError, LawError) as error:
            raise excused(error, *(y for x in motions for y in (x.x, x.R, x.v, x.w))) from error.__cause__

    def _checked(self, k: int, t: float, value: Any) -> Array:
        """What the law of force k returned, (n,)."""
        name, d = self.forces[k].name, self.motions.dim
        n = d + self.motions.n_rot
        try:
            found = np.concatenate([np.atleast_1d(x) for x in value])
        except (TypeError, ValueError, OverflowError):
            raise CallbackError(
                f'Force "{name}": the law returned {value!r:.80} at t = {t:g} s, expected (force ({d},), torque).'
            ) from None
        if len(value) != 2:
            return checked(name, found, n, t)
        return np.concatenate((checked(name, value[0], d, t), checked(name, value[1], n - d, t)))

    def _answers(self, kin: Kinematics, t: float) -> Array:
        """What all laws return, (m, n)."""
        found = [self._answer(k, t, self._motions(k, kin)) for k in range(len(self.forces))]
        return np.array(found)

    def _both(self, arms: Array, found: Array) -> tuple[Array, Array]:
        """Wrenches on a and on b, (.., m, n), from what the laws return: on a alone, or on b with the reaction on a; ``arms``:
        from a to b, (.., m, d).
        """
        d, single, alone = self.motions.dim, self.single, self.alone
        if alone == len(self.forces):
            return found, np.zeros(found.shape)
        # force and moment on a, about its own place
        reaction = -found
        reaction[..., d:] -= self.motions.moment(arms, found[..., :d])
        return (np.where(single, found, reaction), np.where(single, 0.0, found)) if alone else (reaction, found)

    def wrenches(self, kin: Kinematics, t: float) -> tuple[Array, Array]:
        """Wrenches of the user's laws on both markers."""
        return self._both(kin.x[self.b] - kin.x[self.a], self._answers(kin, t))

    def wrenches_at(self, kins: Sequence[Kinematics], times: Sequence[float]) -> tuple[Array, Array]:
        """As of :class:`Loads`."""
        found = [self._answers(kin, t) for kin, t in zip(kins, times, strict=True)]
        return self._both(np.array([kin.x[self.b] - kin.x[self.a] for kin in kins]), np.array(found))

    def tangent(self, kin: Kinematics, t: float) -> MarkerTangent:
        """By the Jacobians of the user, by formulas of the law, or by its forward differences by what it reads of its markers."""
        n = self.motions.dim + self.motions.n_rot
        K, D = np.zeros((2, len(self.forces), 2 * n, 2 * n))
        for k in range(len(self.forces)):
            K[k], D[k] = self._given(k, kin, t) if self.laws[k][1] is not None else self._own(k, kin, t)
        return MarkerTangent(self.markers, K, D)

    def _given(self, k: int, kin: Kinematics, t: float) -> tuple[Array, Array]:
        """K and D of a Jacobian of the user's own."""
        d = self.motions.dim
        n = self.motions.dim + self.motions.n_rot
        twist = kin.twist
        assert twist is not None

        motions = (MarkerMotion(kin.x[j], kin.R[j], twist[j, :d], twist[j, d:]) for j in (self.a[k], self.b[k]))
        found = self.laws[k][1](t, *motions)
        made = np.zeros((2, 2 * n, 2 * n))

        try:
            made[0], made[1] = found
        except (TypeError, ValueError, OverflowError):
            raise CallbackError(
                f'Force "{self.forces[k].name}": its Jacobian returned {found!r:.60} at t = {t:g} s, '
                f"expected (K, D), each {made[0].shape}."
            ) from None
        return made[0], made[1]

    def _own(self, k: int, kin: Kinematics, t: float) -> tuple[Array, Array]:
        """K and D of one force, from the slopes of its law.

        The reaction on a, -f and -tau - (x_b - x_a) x f, is differentiated by the rule of products.
        """
        m = self.motions
        d = m.dim
        n = m.dim + m.n_rot
        base, slopes = self._by_formula(k, kin, t) or self._differenced(k, kin, t)
        plain = self._motions(k, kin)

        out = np.zeros((2, 2 * n, 2 * n))
        if len(plain) == 1:
            out[:, :n, :n] = -slopes
            return out[0], out[1]
        out[:, n:], out[:, :n] = -slopes, slopes
        arm = plain[1].x - plain[0].x
        for which in range(2):
            out[which, d:n] += m.moment(arm, slopes[which, :d].T).T

        lever = m.moment(np.eye(d), base[:d]).T  # of unit displacements of b
        out[0, d:n, n : n + d] += lever
        out[0, d:n, :d] -= lever
        return out[0], out[1]

    def _by_formula(self, k: int, kin: Kinematics, t: float) -> tuple[Array, Array] | None:
        """Force and torque of a law that is a formula, (n,), and their slopes; None for others, and where it answers else."""
        if not self.written:
            own = {i: force for i, force in enumerate(self.forces) if force.jacobian is None}
            laws = [(force.law, 1 if force.b is None else 2) for force in own.values()]
            self.written = dict(zip(own, wrench_formulas(laws, self.motions.dim), strict=True))
        formula, motions = self.written[k], self._motions(k, kin)
        found = None if formula is None else formula(t, motions)
        if found is None:
            return None
        base, (values, slopes) = self._answer(k, t, motions), found

        # what roundoff of all that is seen may do to it
        sizes = {name: step / SMALL for name, step in self._steps(motions).items()}
        sizes["x"] = max(sizes["x"], *(float(np.abs(x.x).max()) for x in motions))
        d, turns = self.motions.dim, self.motions.n_rot
        seen = np.tile([[sizes[x]] * d + [sizes[y]] * turns for x, y in (("x", "R"), ("v", "w"))], len(motions))
        rough = np.abs(base) + np.einsum("kij,kj->i", np.abs(slopes), seen)
        if (np.abs(values - base) > SAME * rough).any():
            self.written[k] = None
            return None
        return base, slopes

    def _differenced(self, k: int, kin: Kinematics, t: float) -> tuple[Array, Array]:
        """The same by the law once, and once more for each component of x, R, v, w that this call has read."""
        d = self.motions.dim
        n = self.motions.dim + self.motions.n_rot
        watched = self._motions(k, kin, _Watched)
        base = self._answer(k, t, watched)
        read = [_what_was_read(x) for x in watched]
        # only what the law has read can change its answer
        plain = self._motions(k, kin)
        steps = self._steps(plain)

        slopes = np.zeros((2, n, len(plain) * n))  # of force and torque, by displacements and by velocities
        for side, motion in enumerate(plain):
            for name in SEEN:
                if name not in read[side]:
                    continue
                for c, near in enumerate(self._near(motion, name, steps[name])):
                    others = [near if i == side else x for i, x in enumerate(plain)]
                    column = side * n + c + (d if name in "Rw" else 0)
                    slopes[SEEN.index(name) // 2, :, column] = (self._answer(k, t, others) - base) / steps[name]
        return base, slopes

    def _steps(self, motions: list[MarkerMotion]) -> dict[str, float]:
        """Steps of differences, from the model's length and the speeds of the markers."""
        length = self.length
        speeds = [max(np.abs(x.v).max(), length * np.abs(x.w).max()) for x in motions]
        # at rest too velocities have a scale
        speed = max(*speeds, SLOWEST * length)
        return {"x": SMALL * length, "R": SMALL, "v": SMALL * speed, "w": SMALL * speed / length}

    def _near(self, motion: MarkerMotion, name: str, step: float) -> list[MarkerMotion]:
        """The motion moved, turned, or made faster by a step along each axis."""
        plain = MarkerMotion(motion.x, motion.R, motion.v, motion.w)
        if name == "R":
            turned = [motion.R + self.motions.spin(e, motion.R.T).T for e in step * np.eye(self.motions.n_rot)]
            return [replace(plain, R=R) for R in turned]
        value = {"x": motion.x, "v": motion.v, "w": motion.w}[name]
        return [replace(plain, **{name: value + e}) for e in step * np.eye(len(value))]
