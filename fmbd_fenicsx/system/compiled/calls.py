"""What the driver asks of Python: values that depend on time, once a step, and laws of the user's own, at every evaluation.

An exception is kept, the driver stops with the verdict FAILED, and the caller raises it.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np

from ...mechanics.forces.formulas import TARGET
from ...mechanics.frames import Kinematics
from ...mechanics.joints.couplings import SmoothMotion
from ...rotations import Array
from .items import GIVEN, Items
from .structures import PYTHON
from .tables import Tables

SAMPLE, EFFORT, SLOPES, WRENCHES, SECTIONS, SECTION_SLOPES = range(6)


class Calls:
    """The one function that C calls, for the tables of one system."""

    def __init__(self, tables: Tables) -> None:
        self.tables, self.system = tables, tables.system
        self.error: Exception | None = None
        self.moving = _motions(self.system)
        self.drives = [x for x in tables.sources if x.drive]
        self.loaded = [x for x in tables.sources if x.load is not None]
        self.given = [x for x in tables.sources if x.role == GIVEN and x.given is not None]
        ramp = not np.array_equal(self.system.gravity(0.0), self.system.gravity(np.inf))
        self.ramp = ramp
        formulas = ((x.arrays, x.formula) for x in tables.sources if x.formula is not None)
        self.targets = [
            (arrays["constants"], [_moving(x) for x in formula.targets])
            for arrays, formula in formulas
            if formula.moves
        ]

        self.loaded_rods = [rod for rod in tables.rods if rod.of_time]
        timed = (self.moving, self.drives, self.loaded, self.given, self.loaded_rods, self.targets)
        tables.c.samples = int(ramp or any(timed))
        tables.c.laws = int(bool(tables.loads))
        self.whole = WholeLoads(tables) if tables.loads else None
        self.function = PYTHON(self.answer)
        tables.c.python = self.function

    def answer(self, what: int, number: int, t: float) -> int:
        """0, or 1 after an exception."""
        try:
            if what == SAMPLE:
                self.sample(t)
            elif what == EFFORT:
                self._effort(self.tables.sources[number], t)
            elif what == WRENCHES:
                assert self.whole is not None
                self.whole.wrenches(t)
            elif what == SECTIONS:
                self.tables.rods[number].sections()
            elif what == SECTION_SLOPES:
                self.tables.rods[number].section_slopes()
            elif number >= 0:
                self._slopes(self.tables.sources[number], t)
            else:
                assert self.whole is not None
                self.whole.tangents(t)
        except Exception as error:
            self.error = error
            return 1
        return 0

    def raise_error(self) -> None:
        """Raise what a call left behind."""
        error, self.error = self.error, None
        if error is not None:
            raise error

    def sample(self, t: float) -> None:
        """Everything that depends on time only."""
        tables = self.tables
        for rows, motions in self.moving:
            prescribed = [motion(t) for motion in motions]
            tables.arrays["motion"][rows] = [x[0] for x in prescribed]
            tables.arrays["motion_rate"][rows] = [x[1] for x in prescribed]
        for items in self.drives:
            place = items.kind.place("drive").start
            items.table[:, place : place + 3] = [motion(t) for motion in items.drive]
        for items in self.loaded:
            kind = items.kind
            assert items.load is not None
            for name, values in items.load(t).items():
                items.table[:, kind.place(name)] = tables.turned(items, name, values)
        for items in self.given:
            assert items.given is not None
            items.arrays["effort"][:] = items.given(t)
        for constants, targets in self.targets:
            constants[:, TARGET : TARGET + 2] = [target(t) for target in targets]
        for rod in self.loaded_rods:
            rod.sample(t)
        if self.ramp:
            tables.arrays["gravity"][:] = self.system.gravity(t)

    def _effort(self, items: Items, t: float) -> None:
        x = items.arrays
        assert items.law is not None
        x["effort"][:] = items.law(x["s"] - x["free"], x["rate"], t)

    def _slopes(self, items: Items, t: float) -> None:
        """Derivatives of laws by the coordinate and by its rate."""
        x = items.arrays
        assert items.slopes is not None
        x["stiffness"][:], x["damping"][:] = items.slopes(x["s"] - x["free"], x["rate"], t)


def _moving(target: Any) -> Callable[[float], tuple[float, float]]:
    """A target as t -> (s, s')."""
    if isinstance(target, SmoothMotion):
        return target.moving
    return lambda t: target(t)[:2]


def _motions(system: Any) -> list[tuple[np.ndarray, list[Any]]]:
    """Rows with a prescribed motion on their right-hand side, and these motions."""
    from ...mechanics.joints.constraints import InTime

    out = []
    for batch, rows in system.batches:
        if batch.driven and not isinstance(batch, InTime):
            out.append((rows[[i for i, _ in batch.driven]], [motion for _, motion in batch.driven]))
    return out


class WholeLoads:
    """Forces that Python evaluates as a whole: tyres and laws of the motion of two markers."""

    def __init__(self, tables: Tables) -> None:
        self.tables, self.loads = tables, tables.loads
        system = tables.system
        self.markers = np.unique(np.concatenate([x for f in self.loads for x in (f.a, f.b)])).astype(int)
        self.frame = tables.frame[self.markers]
        on_surface = self.frame > tables.nb
        self.place = np.where(on_surface[:, None], 0.0, system.markers.position[self.markers])
        self.turn = system.markers.rotation[self.markers]
        self.to = tables.twist_places(self.frame)

    def _kinematics(self) -> tuple[Kinematics, Array]:
        """All markers of the system as far as these forces see them; the levers from their frames' origins, world axes."""
        tables = self.tables
        m, d = tables.system.motions, tables.dim
        frames = tables.arrays["frames"][self.frame]
        R = frames[:, d : d + d * d].reshape(-1, d, d)
        lever = (R @ self.place[..., None])[..., 0]
        v = frames[:, d + d * d : d + d * d + d]
        w = frames[:, d + d * d + d : d + d * d + d + m.n_rot]

        n = len(tables.system.markers.frame)
        x, turn, twist = np.zeros((n, d)), np.tile(np.eye(d), (n, 1, 1)), np.zeros((n, d + m.n_rot))
        x[self.markers], turn[self.markers] = frames[:, :d] + lever, R @ self.turn
        twist[self.markers] = np.concatenate((v + m.spin(w, lever), w), axis=1)
        kin = Kinematics(x, turn, np.zeros((n, 0, 0)), np.zeros((0, 0, 0)))
        kin.twist = twist
        counted = tables.system.counted
        if counted is not None:
            q = np.ctypeslib.as_array((ctypes.c_double * tables.system.n_q).from_address(tables.c.q))
            angles = q[tables.system.counted_angles]
            kin.turned = counted.turned(tables.system.poses(q), np.zeros(tables.system.n_port), angles)
        return kin, lever

    def wrenches(self, t: float) -> None:
        """Wrenches on frames into the driver's array."""
        tables = self.tables
        d, m = tables.dim, tables.system.motions
        kin, lever = self._kinematics()
        total = np.zeros_like(kin.twist)
        for f in self.loads:
            for marker, wrench in zip((f.a, f.b), f.wrenches(kin, t), strict=True):
                np.add.at(total, marker, wrench)
        mine = total[self.markers]
        mine[:, d:] += m.moment(lever, mine[:, :d])
        out = tables.arrays["wrench"]
        out[:] = 0.0
        np.add.at(out, self.to, mine)

    def tangents(self, t: float) -> None:
        """Stiffness and damping of these forces into the fronts."""
        tables = self.tables
        for place, K, D in self._blocks(t):
            np.add.at(tables.arrays["L"], place, tables.c.ck * K + tables.c.cd * D)

    def _blocks(self, t: float) -> list[tuple[np.ndarray, Array, Array]]:
        """Places and the lower halves of K and D of each force, on the rates of its bodies."""
        tables, out = self.tables, []
        kin, lever = self._kinematics()
        at = {int(marker): i for i, marker in enumerate(self.markers)}
        for f in self.loads:
            tangent = f.tangent(kin, t)
            if tangent is None:
                continue
            for k in range(len(f.forces)):
                pair = int(f.a[k]), int(f.b[k])
                frames: list[int] = [int(tables.frame[i]) for i in pair]
                if pair[0] == pair[1]:
                    frames[1] = tables.nb
                maps = [self._map(frame, lever[at[i]]) for frame, i in zip(frames, pair, strict=True)]
                wide = np.zeros((tangent.K.shape[1], sum(x.shape[1] for x in maps)))
                n, first = maps[0].shape
                wide[:n, :first], wide[n:, first:] = maps
                rates = np.concatenate([tables.rates(frame) for frame in frames])
                i, j = np.tril_indices(len(rates))
                both = [wide.T @ x[k] @ wide for x in (tangent.K, tangent.D)]
                out.append((tables.fronts.place(rates[i], rates[j]), *(0.5 * (x + x.T)[i, j] for x in both)))
        return out

    def _map(self, frame: int, lever: Array) -> Array:
        """The twist of a marker from the rates of its body, world axes."""
        tables = self.tables
        m, d = tables.system.motions, tables.dim
        n = d + m.n_rot
        if frame == tables.nb:
            return np.zeros((n, 0))
        out = np.eye(n)
        out[:d, d:] = m.lever(lever)
        if frame < tables.nb:
            return out
        surface = frame - tables.nb - 1
        return np.asarray(out @ tables.maps[surface])
