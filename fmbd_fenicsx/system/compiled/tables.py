"""The tables of a system, as ``driver/tables.h`` describes them."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from ...mechanics.forces.formulas import MEMORY
from ...mechanics.kinds.frames import FRAME
from ...mechanics.reduction.reduced import ReducedPart
from ...mechanics.rods.elements import RodElements
from ...rotations import Array
from ..system import System
from .bodies import reduced_body, rigid_bodies, surface
from .fields import Block, FieldTable, known_field
from .items import LAW, READ, ROW, Items, items_of, other_loads
from .mounts import mount_batch
from .order import Fronts, RowGroup
from .places import Shape, Structure, batch_of, fronts_of, pivots_of, structure_of
from .recording import Looks
from .rods import RodTable, rod_pairs
from .structures import Store, structure
from .whole import WholeLoads

PLACES = {"p": 0, "q": 1}  # constants that are places of markers in their frames
TURNS = {"turn_a": 0, "turn_b": 1}  # those that turn from the axes of a marker into those of its frame
DIRECTIONS = {  # constants that are directions in the axes of a marker: of which side
    "along": {"e": 0},
    "perpendicular": {"e": 0, "f": 1},
    "turned": {"e": 0, "g": 0, "f": 1},
    "angle": {"fa": 0, "ga": 0, "fb": 1, "gb": 1},
    "follower": {"load": 1},
    "wheel_height": {"e": 0, "f": 1},
    "wheel_slip": {"e": 0, "t": 0, "f": 1},
    "ball_slip": {"e": 0, "t": 0},
    "skate": {"e": 1},
    "follower_couple": {"load": 1},
}
OF_ITEMS = ("s", "rate", "effort", "weight", "slope", "stiffness", "damping", "free")  # a number for each item
ONE_SIDED = ("dead", "couple", "follower", "follower_couple")


class Tables:
    """All tables of one system; ``c`` is the driver's System, ``batches`` the items behind its batches."""

    width: np.ndarray  # of the bodies' blocks
    at_u: np.ndarray  # where they begin among the unknowns
    nu: int
    rows: int
    structure: Structure
    fronts: Fronts

    def __init__(self, system: System, *, redundant: bool, blocks: Sequence[Block] = ()) -> None:
        """``blocks``: factors and columns of the floating fields for the size of a step."""
        self.system, self.store, self.dim = system, Store(), system.motions.dim
        self.nb, self.twist = system.n_frames, system.motions.n_twist
        reduced: tuple[Any, ...] = system.parts
        self.parts: dict[int, tuple[int, Any]] = {p.frame: (k, p) for k, p in enumerate(reduced)}
        numbered = enumerate(zip(system.fields, blocks, strict=True))
        self.fields: list[FieldTable] = [FieldTable(self, number, k, block) for number, ((k, _), block) in numbered]
        self.floating = {field.part.frame: field for field in self.fields}
        self.looks = Looks(system)
        self.items = items_of(system, self.looks)
        self.loads, self.mounts = other_loads(system), [f for f in system.forces if f.mounts() is not None]
        self.maps: list[Array] = []  # of surfaces: twist from the rates of the body
        self._lay_out()
        self._place_surfaces()
        self._order()

        self.sources = [one for items in self.items for one in self._split(items)]
        self.batches = [self._batch(items, number) for number, items in enumerate(self.sources)]
        self.batches += [mount_batch(self, loads) for loads in self.mounts]
        self.whole = [WholeLoads(self, loads, number) for number, loads in enumerate(self.loads)]
        self.batches += [loads.batch for loads in self.whole]
        rods: tuple[Any, ...] = system.elements
        self.rods = [RodTable(self, rod, number) for number, rod in enumerate(rods)]
        self._system(redundant)

    # -- unknowns ----------------------------------------------------------------------------------------------------------
    def _lay_out(self) -> None:
        """Widths of the bodies' blocks and where they begin; the rows come behind."""
        modes = [self.parts[b][1].n if b in self.parts else 0 for b in range(self.nb)]
        for frame, field in self.floating.items():
            modes[frame] = field.count
        self.modes = np.array(modes, dtype=int)
        self.width = self.twist + self.modes
        self.at_u = np.cumsum(self.width) - self.width
        self.nu, self.rows = int(self.width.sum()), self.system.n_lam

    def _place_surfaces(self) -> None:
        """The markers on surfaces that something acts on, each a frame behind the ground."""
        mk = self.system.markers
        used: list[np.ndarray] = [items.markers.ravel() for items in self.items]
        used += [x for f in (*self.loads, *self.mounts) for x in (f.a, f.b)]
        used.append(np.array(self.looks.markers, dtype=int))
        numbers = np.unique(np.concatenate(used)).astype(int) if used else np.zeros(0, int)
        self.surfaces = np.array([i for i in numbers if i in set(mk.surface.tolist())], dtype=int)
        self.frame = mk.frame.copy()
        self.frame[self.surfaces] = self.nb + 1 + np.arange(len(self.surfaces))
        self.nothing = self.nu + self.twist * len(self.surfaces)  # place of what the ground would have

    def body_of(self, frame: np.ndarray) -> np.ndarray:
        """The body of frames, -1 for the ground."""
        on = np.append(np.arange(self.nb), -1)
        on = np.append(on, self.system.markers.frame[self.surfaces])
        return np.asarray(on[frame])

    def port_matrix(self, body: int) -> Array:
        """Rates of the ports of a body from those of its modes, (ports, modes)."""
        matrix: Array = (self.floating[body] if body in self.floating else self.parts[body][1]).port_matrix
        return matrix

    def twist_places(self, frame: np.ndarray) -> np.ndarray:
        """Places of the twists of frames in arrays of velocities, (..., n_twist)."""
        first = np.concatenate((self.at_u, [self.nothing], self.nu + self.twist * np.arange(len(self.surfaces))))
        places = first[frame][..., None] + np.arange(self.twist)
        return np.where((frame == self.nb)[..., None], self.nothing, places)

    def rates(self, frame: int) -> np.ndarray:
        """The unknowns that move a frame."""
        body = int(self.body_of(np.array(frame)))
        if body < 0:
            return np.zeros(0, int)
        width = self.twist if frame < self.nb else self.width[body]
        return np.asarray(self.at_u[body] + np.arange(width))

    def frames_of(self, items: Items) -> np.ndarray:
        """Frames of both sides, (n, 2); loads have the ground for their first."""
        frames = self.frame[items.markers]
        if items.kind.name in ONE_SIDED:
            frames[:, 0] = self.nb
        return frames

    # -- order ---------------------------------------------------------------------------------------------------------------
    def _order(self) -> None:
        """Groups of rows, the order of elimination, and the fronts."""
        touched: list[set[int]] = [set() for _ in range(self.rows)]
        terms = np.zeros(self.rows, int)
        pairs = rod_pairs(self.system.elements)
        for items in (x for x in self.items if x.role != READ):
            bodies: Any = self.body_of(self.frames_of(items))
            if items.role == ROW:
                assert items.row is not None
                for number, pair in zip(items.row, bodies.tolist(), strict=True):
                    touched[int(number)] |= {x for x in pair if x >= 0}
                    terms[int(number)] += 1
            pairs |= {(min(x), max(x)) for x in bodies.tolist() if x[0] != x[1] and min(x) >= 0}
        for f in (*self.loads, *self.mounts):
            both: Any = self.body_of(self.frame[np.stack((f.a, f.b), axis=1)])
            pairs |= {(min(x), max(x)) for x in both.tolist() if x[0] != x[1] and min(x) >= 0}

        found: dict[tuple[tuple[int, ...], bool], list[int]] = {}
        for row in range(self.rows):
            found.setdefault((tuple(sorted(touched[row])), bool(terms[row] > 1)), []).append(row)
        groups = [RowGroup(near, tuple(rows), coupling) for (near, coupling), rows in found.items()]
        surfaces = tuple(int(b) for b in self.system.markers.frame[self.surfaces])
        shape = Shape(self.dim, tuple(int(n) for n in self.width), surfaces, tuple(groups), frozenset(pairs))
        self.structure = structure_of(shape)
        self.fronts = self.structure.fronts

    # -- batches -------------------------------------------------------------------------------------------------------------
    def _split(self, items: Items) -> list[Items]:
        """Items whose frames are of one sort: bodies, the ground on one side, or some on surfaces."""
        frames = self.frames_of(items)
        sort = np.where((frames > self.nb).any(axis=1), 9, (frames == self.nb) @ np.array([1, 2]))
        sorts = {int(k) for k in sort}
        return [items] if len(sorts) == 1 else [items.part(np.flatnonzero(sort == k)) for k in sorted(sorts)]

    def constants(self, items: Items) -> Array:
        """The table of constants, (n, width), in the axes of the frames."""
        mk, n, kind = self.system.markers, len(items), items.kind
        P = np.zeros((n, kind.width))
        on_surface = self.frame[items.markers] > self.nb
        for name, side in PLACES.items():
            if name in kind.constants:
                place = mk.position[items.markers[:, side]].copy()
                place[on_surface[:, side]] = 0.0
                P[:, kind.place(name)] = place
        for name, side in TURNS.items():
            if name in kind.constants:
                P[:, kind.place(name)] = mk.rotation[items.markers[:, side]].reshape(n, -1)
        if kind.name == "angle" and self.dim == 2:
            assert self.system.counted is not None
            start = self.system.counted.start[items.markers]
            P[:, kind.place("zero").start] = start[:, 1] - start[:, 0]
        for name, values in items.constants.items():
            if name in kind.constants:
                P[:, kind.place(name)] = self.turned(items, name, values)
        return P

    def theta_places(self, items: Items) -> np.ndarray:
        """Places in q of the counted angles of items, in space."""
        counted = self.system.counted
        assert counted is not None
        a, b = np.asarray(counted.turn.a), np.asarray(counted.turn.b)
        number = {(int(i), int(j)): k for k, (i, j) in enumerate(zip(a, b, strict=True))}
        first = self.system.counted_angles.start
        return np.array([first + number[int(i), int(j)] for i, j in items.markers])

    def _angles(self) -> list[Any]:
        """Structures Angle of all counted angles, in the order of q."""
        s, mk = self.system, self.system.markers
        if s.counted is None or not s.counted.count:
            return []
        turn, vector = s.counted.turn, ctypes.c_double * self.dim
        sides = {"a": turn.a, "b": turn.b}
        axes = {"e": turn.e, "f": turn.e1, "g": turn.e2}
        out = []
        for i in range(s.counted.count):
            local = {n + m: vector(*(mk.rotation[x[i]] @ e[i])) for n, e in axes.items() for m, x in sides.items()}
            out.append(structure("Angle", self.dim)(a=int(mk.frame[turn.a[i]]), b=int(mk.frame[turn.b[i]]), **local))
        return out

    def turned(self, items: Items, name: str, values: Array) -> Array:
        """Constants of items, directions turned from the axes of their markers into those of the frames; (n, size)."""
        side = DIRECTIONS.get(items.kind.name, {}).get(name)
        values = np.asarray(values, dtype=float).reshape(len(items), -1)
        if side is None or values.shape[1] != self.dim:
            return values
        R = self.system.markers.rotation[items.markers[:, side]]
        return np.asarray((R @ values[..., None])[..., 0])

    def _batch(self, items: Items, number: int) -> Any:
        """One structure Batch."""
        kind, n, store = items.kind, len(items), self.store
        one = batch_of(self, items, self.frames_of(items))
        one.number = number
        items.table, one.P = store.array(self.constants(items))
        one.out = store.address(np.zeros((n, one.outputs)))

        data, first = store.array(np.zeros((len(OF_ITEMS), n)))
        given = {"effort": items.effort, "stiffness": items.stiffness, "damping": items.damping, "free": items.free}
        for k, name in enumerate(OF_ITEMS):
            values = given.get(name)
            items.arrays[name] = data[k]
            if values is not None:
                data[k] = values
            setattr(one, name, first + 8 * n * k)
        if items.role == LAW:
            one.known = store.address(np.zeros((n, 3)))
        if items.formula is not None:
            self._formula(one, items)
        if items.slot is not None:
            one.slot = store.integers(items.slot)
        if items.role == ROW:
            one.factor = store.address(items.factor)
        if items.role != READ:
            one.hessian = store.address(np.zeros((n, max(one.hessians, 1))))
        if kind.name == "angle" and self.dim == 3:
            one.near, one.theta = kind.place("near").start, store.integers(self.theta_places(items))
        return one

    def _formula(self, one: Any, items: Items) -> None:
        """The numbers of a formula, and the memory of its elements."""
        formula, store = items.formula, self.store
        assert formula is not None
        one.formula = formula.kind
        items.arrays["constants"], one.constants = store.array(formula.constants)
        memory = np.zeros((len(items), MEMORY)) if formula.kept is None else formula.kept()
        items.arrays["kept"], one.kept = store.array(memory)

    # -- all of it -------------------------------------------------------------------------------------------------------------
    def _system(self, redundant: bool) -> None:
        """The structure System."""
        s, store = self.system, self.store
        others = rigid_bodies(self) | {frame: field.body() for frame, field in self.floating.items()}
        bodies = [others[b] if b in others else reduced_body(self, b) for b in range(self.nb)]
        surfaces = [surface(self, int(i)) for i in self.surfaces]
        angles = self._angles()
        fronts, (row_dest, sign) = fronts_of(self), pivots_of(self)

        size = self.nu + self.rows
        frames = np.zeros((self.nb + 1 + len(surfaces), FRAME[self.dim]))
        frames[self.nb, self.dim : self.dim + self.dim**2] = np.eye(self.dim).ravel()
        widest = int(self.width.max(initial=0))
        once = 4 * s.n_v + 3 * self.rows  # work of a step, and of a second solution where there are fields
        sizes = {
            "velocity": self.nothing + 1, "residual": self.nothing + 1,
            "gap": self.rows, "motion": self.rows, "weight": self.rows, "diagonal": size,
            "L": self.fronts.storage + 8, "inverse": size, "b": size, "local": size,
            "work": once + s.n_v + self.rows, "big": (2 * self.twist + 1) * 2 * widest + size,
        }  # fmt: skip
        arrays = {name: store.array(np.zeros(max(count, 1))) for name, count in sizes.items()}
        arrays |= {name: store.array(np.zeros(max(self.rows, 1))) for name in ("motion_rate", "slip")}
        arrays |= {"rest_gravity": store.array(s.gravity(np.inf)), "row_units": store.array(s.row_units)}
        arrays |= {"frames": store.array(frames), "gravity": store.array(s.gravity(0.0)), "units": store.array(s.units)}
        self.arrays = {name: x for name, (x, _) in arrays.items()}
        lists = {
            "body": ("Body", bodies),
            "surface": ("Surface", surfaces),
            "angle": ("Angle", angles),
            "rod": ("Rod", [rod.c for rod in self.rods]),
            "batch": ("Batch", self.batches),
            "reaction": ("Reaction", [self._reaction(name) for name in self.looks.joints]),
        }
        pointers = {"front": ctypes.addressof(fronts)}
        for name, (kind, made) in lists.items():
            array = (structure(kind, self.dim) * max(len(made), 1))(*made)
            store.kept.append(array)
            pointers[name] = ctypes.addressof(array)
            if name == "body":
                self.body_array = array

        self.c = structure("System", self.dim)(
            bodies=self.nb, surfaces=len(surfaces), batches=len(self.batches), fronts=len(self.fronts.fronts), angles=len(angles),
            rods=len(self.rods), rows=self.rows, nu=self.nu, nv=s.n_v, nq=s.n_q, redundant=int(redundant),
            fields=len(self.fields), core=s.n_core, again=once,
            stiff=int(bool(self.rods) or any(f.stiff for f in s.forces)),
            remembers=int(any(items.remembers for items in self.items)), storage=self.fronts.storage,
            seen=len(self.looks.markers), readings=self.looks.count, reactions=len(self.looks.joints),
            seen_frame=store.integers(self.frame[self.looks.markers]),
            row_dest=row_dest, sign=sign,
            **pointers, **{name: address for name, (_, address) in arrays.items()},
        )  # fmt: skip
        self.look()

    @property
    def seen_place(self) -> dict[int, Array]:
        """Places of the markers that sensors look at in their frames, by number."""
        mk = self.system.markers
        on_surface = self.frame > self.nb
        return {i: np.zeros(self.dim) if on_surface[i] else mk.position[i] for i in self.looks.markers}

    def _reaction(self, joint: str) -> Any:
        """One structure Reaction: the items of a joint's rows on the side of its first body."""
        block = self.system.block(joint)
        found = []
        for number, items in enumerate(self.sources):
            if items.row is None:
                continue
            inside = (items.row >= block.rows.start) & (items.row < block.rows.stop)
            mine = np.argwhere(inside[:, None] & (items.markers == block.a))
            found += [(number, int(i), int(side)) for i, side in mine]
        batch, item, side = np.array(found, dtype=int).reshape(-1, 3).T
        frame = int(self.frame[block.a])
        place = np.zeros(self.dim) if frame > self.nb else self.system.markers.position[block.a]
        integers = self.store.integers
        return structure("Reaction", self.dim)(
            items=len(found), frame=frame, p=(ctypes.c_double * self.dim)(*place),
            batch=integers(batch), item=integers(item), side=integers(side),
        )  # fmt: skip

    @cached_property
    def remembering(self) -> list[Any]:
        """Items with a memory."""
        return [items for items in self.sources if items.remembers]

    def recall(self) -> None:
        """Take the memory of elements that have one."""
        for items in self.remembering:
            items.arrays["kept"][:] = items.formula.kept()

    def remember(self) -> None:
        """Give back the memory of elements after accepted steps."""
        for items in self.remembering:
            items.formula.keep(items.arrays["kept"])

    def look(self) -> None:
        """Take the angular velocities above which a body is to be warned of; those warned of have none."""
        for b, (_, part) in self.parts.items():
            if isinstance(part, ReducedPart):
                known = part.warned or part.constants.stiffening is not None
                self.body_array[b].spin = np.inf if known else part.first_frequency**2
        for frame, field in self.floating.items():
            self.body_array[frame].spin = np.inf if field.part.warned else field.part.spin_to_check**2


def covers_bodies(system: System) -> bool:
    """Whether all bodies are rigid, reduced, floating or rods, without loads that the driver does not know."""
    parts: tuple[Any, ...] = system.parts
    known = all(known_field(p) if p.distributed else type(p) is ReducedPart and not p.constants.loads for p in parts)
    plain = system.markers.section is None and system.contacts is None
    rods = all(isinstance(e, RodElements) for e in system.elements)
    return known and plain and rods and not system.port_constraints and not system.traces and system.n_frames > 0
