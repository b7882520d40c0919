"""Kinds by a function of numbers of a user's own, g(x_a, R_a, x_b, R_b, t) -> (m,), that Python is asked for at every evaluation.

Rows are derivatives by displacements x + e_k and turns R + e_k~ R of both markers:

    complex steps    Im g(z + i h e_k) / h, exact to roundoff                                                       (1)
    differences      central, with steps of 1e-5 of the model's length and of 1e-5 rad: right to some 1e-10            (2)

(1) where the function takes complex numbers, which (2) along one skew direction looks at whenever it is used: ``abs`` and others
drop imaginary parts without a word. All columns are one call where the function takes arrays with a last axis for them, as those
that write x[0], R[1, 0] and NumPy's functions of these do.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from dis import get_instructions
from functools import cached_property, partial
from itertools import product
from math import isfinite
from types import FunctionType
from typing import Any

import numpy as np

from ...errors import AGREEMENTS, CallbackError, LawError, excused, named, require
from ...log import log
from ...rotations import Array, Motions, quaternion_exp, quaternion_matrix, spin_matrix
from .expressions import ZERO
from .jets import COMPLEX_STEP
from .python_kinds import Answers, At, PythonKind
from .time_derivatives import rates

STEP = 1e-5  # of differences: a share of the length, rad
DROPPED = 1e-5  # relative: derivatives that differ by more are not those of the function
LOOKERS = frozenset(("locals", "vars", "dir", "eval", "exec", "_getframe"))  # functions that read arguments unseen
SHORT = 3e-3  # of motions along which second derivatives are taken: a share of the length, rad

Poses = tuple[Array, Array]  # x (2, d, ..), R (2, d, d, ..) of both markers


class AskedFunction(Answers):
    """The function of one joint, with its derivatives. ``live``: the sides that move; ``length``: of the model, m."""

    def __init__(
        self, name: str, function: Callable[..., Any], motions: Motions, live: Sequence[int], length: float
    ) -> None:
        super().__init__()
        self.name, self.raw, self.motions, self.live, self.length = name, function, motions, tuple(live), length
        self.function = named("The constraint of joint", name, function)
        self.timed = reads(function, 4)
        self.way: tuple[bool, bool] | None = None  # complex, all columns in one call: decided at the first derivative
        d, n = motions.dim, motions.n_rot
        self.width = (d + n) * len(self.live)
        # displacements and angular velocities of the columns, steps in m and rad
        self.shift, self.spin = np.zeros((2, d, self.width)), np.zeros((2, d, d, self.width))
        self.steps = np.tile([STEP * length] * d + [STEP] * n, len(self.live))
        for k, (side, c) in enumerate(product(self.live, range(d + n))):
            if c < d:
                self.shift[side, c, k] = 1.0
            else:
                self.spin[side, :, :, k] = spin_matrix(np.eye(n)[c - d])
        self.spins = np.ascontiguousarray(self.spin.transpose(3, 0, 1, 2))
        self.skew = np.cos(1.0 + np.arange(self.width))

    @cached_property
    def count(self) -> int:
        """How many numbers it returns: one call, both markers at the origin."""
        d = self.motions.dim
        return len(self.at((np.zeros((2, d)), np.stack([np.eye(d)] * 2)), 0.0))

    def checked(self, value: Any, t: float) -> Array:
        """What it returned, (m,)."""
        found: Array = np.asarray(value)
        if not found.ndim:
            found = found.reshape(1)
        if found.ndim != 1 or not found.size or found.dtype.kind not in "iufc" or not np.isfinite(found).all():
            raise CallbackError(
                f'Joint "{self.name}": its function returned {value!r} at t = {np.real(t):g} s, expected finite numbers.'
            )
        count = self.__dict__.get("count", len(found))
        if len(found) != count:
            raise CallbackError(
                f'Joint "{self.name}": its function returned {len(found)} numbers at t = {np.real(t):g} s and {count} before; '
                "a joint has the same rows at all times."
            )
        return found

    def at(self, poses: Poses, t: Any) -> Array:
        """g, (m,). What is not seen at a glance to be usable, or fails, is asked again with all that belongs to it."""
        x, R = poses
        if "count" in self.__dict__ and not AGREEMENTS:
            try:
                found = np.asarray(self.raw(x[0], R[0], x[1], R[1], t))
                if found.shape == (self.count,) and found.dtype.kind in "fc" and isfinite(abs(found.dot(found))):
                    return found
            except Exception:
                pass  # with a name below
        try:
            return self.checked(self.function(x[0], R[0], x[1], R[1], t), t)
        except (CallbackError, LawError) as error:
            raise excused(error, x, R) from error.__cause__

    # -- rows -----------------------------------------------------------------------------------------------------------
    def derivative(self, poses: Poses, t: float) -> Array:
        """dg by displacements and turns of the markers that move, (m, width)."""
        if self.way is None:
            self._decide(poses, t)
        assert self.way is not None
        found = self._by(self.way, poses, t)
        if self.way[0] and found is not None and self._dropped(found, poses, t):
            log.warning('joint "%s": complex steps fail in its function (abs, float?); using differences', self.name)
            self.way, found = (False, self.way[1]), None
            found = self._by(self.way, poses, t)
        return self._differences(poses, t, False) if found is None else found

    def _decide(self, poses: Poses, t: float) -> None:
        """Find the cheapest way that gives what differences give, one number after another."""
        plain = self._differences(poses, t, False)
        self._refuse_still_rows(plain)
        largest = np.abs(plain).max()
        for way in ((True, True), (True, False), (False, True), (False, False)):
            found = self._by(way, poses, t)
            if found is not None and np.abs(found - plain).max() <= DROPPED * largest:
                self.way = way
                return
        self.way = False, False

    def _refuse_still_rows(self, rows: Array) -> None:
        """Refuse numbers that no motion of the markers changes where they start."""
        still = np.flatnonzero(~(np.abs(rows) > 1e-12 * np.abs(rows).max(initial=0.0)).any(axis=1))
        which = ", ".join(str(k) for k in still)
        require(
            not still.size,
            f'Joint "{self.name}": number {which} of those that its function returns does not change with the places and '
            "rotations of the two markers where they start, so it holds nothing. Return what is zero where the joint is closed "
            "and only there; point_a and point_b say where the markers sit.",
        )

    def _by(self, way: tuple[bool, bool], poses: Poses, t: float) -> Array | None:
        """The derivative in one of the ways; None where the function does not go it."""
        by_complex, together = way
        if together and AGREEMENTS:
            together = False
        try:
            if not by_complex:
                return self._differences(poses, t, together)
            with warnings.catch_warnings():
                warnings.simplefilter("error", np.exceptions.ComplexWarning)  # an imaginary part dropped on the way
                x, R = (x[..., None] + d for x, d in self._stepped(poses, 1j * COMPLEX_STEP))
                return self._columns((x, R), t, together).imag / COMPLEX_STEP
        except Exception:
            if not (by_complex or together):
                raise
            return None

    def _stepped(self, poses: Poses, step: Any) -> list[tuple[Array, Array]]:
        """Places and rotations, each with what its columns move it by, steps in m and rad."""
        x, R = poses
        return [(x, self.shift * step), (R, (self.spins @ R).transpose(1, 2, 3, 0) * step)]

    def _differences(self, poses: Poses, t: float, together: bool) -> Array:
        """(2)."""
        (x, shift), (R, turn) = self._stepped(poses, self.steps)
        x, R = x[..., None], R[..., None]
        both = np.concatenate((x + shift, x - shift), axis=-1), np.concatenate((R + turn, R - turn), axis=-1)
        found = self._columns(both, t, together)
        ahead, behind = found[:, : self.width], found[:, self.width :]
        return np.asarray((ahead - behind) / (2.0 * self.steps), dtype=float)

    def _columns(self, poses: Poses, t: float, together: bool) -> Array:
        """g at as many poses as their last axis has, (m, columns)."""
        (x, R), columns = poses, poses[0].shape[-1]
        if together:
            found = np.asarray(self.raw(x[0], R[0], x[1], R[1], t))
            usable = found.shape == (self.count, columns) and found.dtype.kind in "fc"
            if not (usable and isfinite(abs(np.add.reduce(found, axis=None)))):
                raise TypeError("no columns")
            return found
        return np.array([self.at((x[..., k], R[..., k]), t) for k in range(columns)]).T.copy()

    def _dropped(self, rows: Array, poses: Poses, t: float) -> bool:
        """Whether complex steps give something else than differences along one direction that moves everything."""
        x, R = poses
        along = 10.0 * self.steps * self.skew
        shift, turn = self.shift @ along, np.einsum("sijk,sjl,k->sil", self.spin, R, along)
        ahead, behind = (self.at((x + k * shift, R + k * turn), t) for k in (1.0, -1.0))
        scale = np.abs(rows) @ np.abs(along)
        return bool((np.abs(rows @ along - 0.5 * (ahead - behind)) > DROPPED * scale + 1e-14 * self.length).any())

    # -- along motions ----------------------------------------------------------------------------------------------------
    def moves(self, poses: Poses, t: float, here: Array) -> bool:
        """Whether it depends on time, by what it says now and at two other times."""
        try:
            soon, late = [self.at(poses, t + later) for later in (1e-3, 0.37)]
            return not soon.tolist() == late.tolist() == here.tolist()
        except Exception:
            return True  # a table of some length

    def partial(self, poses: Poses, t: float) -> Array:
        """g_t, (m,)."""

        def component(i: int, s: Any) -> Any:
            function = self.function if isinstance(s, float) else self.raw
            return np.ravel(np.asarray(function(*_both(poses), s), dtype=object))[i]

        scale = max(self.length, float(np.abs(poses[0]).max()))
        return np.array([rates(partial(component, i), t, scale)[0] for i in range(self.count)])

    def second(self, path: Callable[[float], Poses], t: float, fast: float, here: Array) -> Array:
        """g'' along a path that begins at t, by differences of sixth order from what it says there; ``fast``: its speed, lengths
        or rad in a second.
        """
        h = SHORT / fast
        weights = (-490.0, 270.0, -27.0, 2.0)
        found = weights[0] * here
        for k in (1, 2, 3):
            for s in (k * h, -k * h):
                found = found + weights[k] * self.at(path(s), t + s)
        return np.asarray(found / (180.0 * h * h), dtype=float)


def _both(poses: Poses) -> tuple[Array, Array, Array, Array]:
    (xa, xb), (Ra, Rb) = poses
    return xa, Ra, xb, Rb


@dataclass(frozen=True, eq=False)
class AskedKind(PythonKind):
    """The kind of one joint; its items are the numbers that the function returns, told apart by their ``component``."""

    function: AskedFunction = None  # type: ignore[assignment]

    def run(self, which: str, A: Array, B: Array, P: Array, W: Any = 1.0) -> Array:
        """One kernel for items between the same two frames, a row of each array: results likewise."""
        return np.zeros((len(P), 0)) if which == "tangent" else self._found(which, (A, B, P))

    @cached_property
    def _markers(self) -> tuple[list[slice], list[slice]]:
        """Where the constants have the arms of both markers, and their rotations."""
        return [self.place(name) for name in ("p", "q")], [self.place(name) for name in ("turn_a", "turn_b")]

    def _poses(self, at: At, frames: Sequence[tuple[Array, Array]]) -> Poses:
        """Markers on frames with places and rotations (x, R)."""
        d = self.dim
        arms, turns = self._markers
        x = [o + R @ at[2][arm] for (o, R), arm in zip(frames, arms, strict=True)]
        R = [R @ at[2][turn].reshape(d, d) for (_, R), turn in zip(frames, turns, strict=True)]
        return np.array(x), np.array(R)

    def _frames(self, at: At) -> list[tuple[Array, Array]]:
        d = self.dim
        return [(f[:d], f[d : d + d * d].reshape(d, d)) for f in at[:2]]

    def _rows(self, at: At, t: float) -> Array:
        d, f = self.dim, self.function
        frames = self._frames(at)
        poses = self._poses(at, frames)
        rows = f.derivative(poses, t)

        # turns of a frame move its marker, too
        size = d + f.motions.n_rot
        for k, side in enumerate(f.live):
            lever = poses[0][side] - frames[side][0]
            part = rows[:, k * size : (k + 1) * size]
            part[:, d:] += f.motions.moment(lever + np.zeros((len(rows), d)), part[:, :d])
        found = np.empty((len(rows), 1 + f.width))
        found[:, 0], found[:, 1:] = f.at(poses, t).real, rows
        return found

    def _rates(self, at: At, t: float, whole: bool) -> Array:
        f = self.function
        return super()._rates(at, t, whole) if whole or f.timed else np.zeros((f.count, 2))

    def _in_time(self, at: At, t: float) -> Array:
        """Whether the function depends on time, and g_t, (1 + m,)."""
        f = self.function
        if not f.timed:
            return np.zeros(1 + f.count)
        poses = self._poses(at, self._frames(at))
        here = self._value(at, t)[:, 0]
        moves = f.moves(poses, t, here)
        return np.array([moves, *(f.partial(poses, t) if moves else np.zeros(f.count))])

    def _second(self, at: At, t: float, moves: bool) -> Array:
        """g'' at constant twists of the frames, (m,)."""
        d, f, m = self.dim, self.function, self.function.motions
        frames = self._frames(at)
        speeds = [(x[d + d * d : 2 * d + d * d], x[2 * d + d * d : 2 * d + d * d + m.n_rot]) for x in at[:2]]
        speeds = [speeds[s] if s in f.live else (np.zeros(d), np.zeros(m.n_rot)) for s in (0, 1)]

        def path(s: float) -> Poses:
            moved = [(x + s * v, _turned(R, s * w)) for (x, R), (v, w) in zip(frames, speeds, strict=True)]
            return self._poses(at, moved)

        fast = max(max(float(np.abs(v).max()) / f.length, float(np.abs(w).max())) for v, w in speeds)
        if moves:
            fast = max(fast, 1.0)
        return f.second(path, t, fast, self._value(at, t)[:, 0]) if fast else np.zeros(f.count)


def reads(function: Any, number: int) -> bool:
    """Whether a function may read that argument: all but plain ones whose code never loads it."""
    if not isinstance(function, FunctionType) or number >= function.__code__.co_argcount:
        return True
    code = function.__code__
    name = code.co_varnames[number]
    if name in code.co_cellvars or not LOOKERS.isdisjoint(code.co_names):
        return True
    loaded = [x.argval for x in get_instructions(code) if x.opname.startswith("LOAD_")]
    return any(name in x if isinstance(x, tuple) else name == x for x in loaded)


def _turned(R: Array, turn: Array) -> Array:
    """R after the rotation vector, world axes."""
    if len(turn) == 1:
        c, s = np.cos(turn[0]), np.sin(turn[0])
        return np.asarray(np.array([[c, -s], [s, c]]) @ R)
    return np.asarray(quaternion_matrix(quaternion_exp(turn)) @ R)


def asked_kind(function: AskedFunction) -> AskedKind:
    """The kind of a joint by a function of numbers."""
    d, n = function.motions.dim, function.motions.n_rot
    entries = tuple(side * (d + n) + c for side in function.live for c in range(d + n))
    constants = {"p": d, "turn_a": d * d, "q": d, "turn_b": d * d, "component": 1, "drive": 1, "drive1": 1, "drive2": 1}
    outputs = {"value": [ZERO] * (1 + len(entries)), "rates": [ZERO] * 2, "tangent": []}
    return AskedKind("asked", d, constants, entries, (), outputs, [], (None, None), function=function)  # type: ignore[arg-type]
