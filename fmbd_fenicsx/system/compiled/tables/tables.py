"""The tables of a system, as ``driver/tables.h`` describes them."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from ....errors import ConvergenceError
from ....mechanics.forces.force_elements import Loads
from ....mechanics.joints.relative import RelativeCoordinates
from ....mechanics.kinds.frames import FRAME
from ....mechanics.placements import Approach
from ...layout import ATTITUDE
from ...system import System
from ..declarations import enumeration
from ..order import LOCKED, RowGroup
from .bodies.bodies import reduced_body, rigid_bodies, surface
from .bodies.fields import Block, FieldTable
from .bodies.rods import RodTable, rod_pairs
from .bodies.told import ToldPart, is_told
from .items.angles import angles, free_markers
from .items.item_batches import item_batch, mount_batch, of_one_sort
from .items.items import READ, ROW, Items, items_of, other_loads
from .items.listening import Listening
from .items.whole import WholeLoads
from .layout import TableLayout
from .matrix_structure import MatrixShape, structure_of
from .places import fronts_of, pivots_of
from .sights import reaction_of, seen_places
from .structures import SECANTS, array_of, structure


def attitudes_apart(tables: Tables) -> dict[int, np.ndarray]:
    """Bodies whose attitude is held by rows of its own while nothing else turns them: these rows, by the number of the body.

    They and angular velocities do not meet the rest of the step's matrix, and a point mass has three unknowns there (two in the
    plane). What may turn a body acts beside its origin, or is known to Python alone.
    """
    blocks = [block for block in tables.system.blocks if block.kind == ATTITUDE]
    held = {int(tables.frame[block.b]): np.arange(block.rows.start, block.rows.stop) for block in blocks}
    if not held:
        return {}

    place = tables.system.markers.position
    turned = np.zeros(tables.nb + 1 + len(tables.surfaces), dtype=bool)
    for items in (x for x in tables.items if x.role != READ):
        asked = any(term.kind.asked for term in items.terms or [items])
        turned[items.frames[place[items.markers].any(axis=2) | asked]] = True
    for loads in tables.mounts:
        turned[tables.frame[loads.a]] = True
        turned[tables.frame[loads.b[place[loads.b].any(axis=1)]]] = True
    for loads in tables.loads:
        turned[tables.frame[loads.a]] = turned[tables.frame[loads.b]] = True
    return {body: rows for body, rows in held.items() if not (turned[body] or tables.modes[body])}


MOTIONS = "motion", "motion_rate", "motion_second"  # of rows: s, s' and s'' of what is prescribed
CLOSING = enumeration("CONJUGATE")["CLOSING"]
LINKS_LIMIT = 1_000_000  # entries of the rows of efforts that answer to more than their own coordinate


def _bytes(x: np.ndarray | None) -> bytes:
    """Numbers as a part of a key."""
    return b"" if x is None else x.tobytes()


class Tables(TableLayout):
    """All tables of one system; ``batches`` are those of the driver."""

    # fields with new tangents: at t, increments that led there
    renewed: Callable[[float, dict[int, Approach]], Sequence[Block]]
    # lends the matrices of what a number stands for; LinearSolveError where there are none
    frequencies: Callable[[float], None]

    def __init__(
        self,
        system: System,
        *,
        redundant: int,
        blocks: Sequence[Block] = (),
        coordinates: Sequence[RelativeCoordinates] = (),
    ) -> None:
        """``blocks``: factors and columns of the floating fields for the size of a step; ``coordinates``: one item each that
        nothing acts on, for :meth:`coordinate`.
        """
        self._locked: frozenset[int] = system.cache.get(LOCKED, frozenset())
        super().__init__(system)
        system = self.system
        self.blocks = blocks
        self.user: Any = None  # the stepper whose steps were made last
        self.look_at_end: Callable[[], None] = lambda: None  # raises ConvergenceError where a step does not count
        self.fields: list[FieldTable] = []
        for (k, _), block in zip(system.fields, blocks, strict=True):
            self.fields.append(FieldTable(self, self.fields, k, block))

        self.floating = {field.part.frame: field for field in self.fields}
        self.listening = Listening(self)
        self.items: list[Items] = self.tied.items + items_of(system, self.looks, self.listening.items, coordinates)
        self.loads: list[Loads] = other_loads(system)
        self.mounts: list[Loads] = [f for f in system.forces if f.mounts() is not None]
        self._lay_out()
        self._place_surfaces(self._acted_on())
        for items in self.items:
            items.frames = self._frames_of(items)
        if self.listening.links * self.nu > LINKS_LIMIT:
            self.listening.unlink()
        self.held = attitudes_apart(self)
        self.structure = structure_of(self._connections(), self._shape)
        self.fronts = self.structure.fronts

        self.sources = [one for items in self.items for one in of_one_sort(self, items)]
        self.batches: list[Any] = [item_batch(self, items, number) for number, items in enumerate(self.sources)]
        self._first_coordinate = len(self.sources) - len(coordinates)
        self.batches += [mount_batch(self, loads) for loads in self.mounts]
        self.whole = [WholeLoads(self, loads, number) for number, loads in enumerate(self.loads)]
        self.batches += [loads.batch for loads in self.whole]
        told = [k for k, part in enumerate(system.parts) if is_told(part)]
        self.told = [ToldPart(self, number, k) for number, k in enumerate(told)]
        rods: tuple[Any, ...] = system.elements
        self.rods = [RodTable(self, rod, number) for number, rod in enumerate(rods)]
        self._system(redundant)

    def _acted_on(self) -> np.ndarray:
        """The markers that something acts on or looks at."""
        used: list[np.ndarray] = [items.markers.ravel() for items in self.items]
        used += [x for f in (*self.loads, *self.mounts) for x in (f.a, f.b)]
        used.append(np.array(self.looks.markers, dtype=int))
        used += free_markers(self.system)
        used.append(self.listening.markers)
        return np.concatenate(used)

    # -- order ---------------------------------------------------------------------------------------------------------------
    def _connections(self) -> tuple[Any, ...]:
        """What acts between which frames, and on which rows: all that the structure depends on."""
        acting = (
            (
                x.role == ROW,
                x.frames.shape[1],
                _bytes(x.frames),
                _bytes(x.row),
                _bytes(x.markers) if x.role == ROW else b"",
            )
            for x in self.items
            if x.role != READ
        )

        whole = ((_bytes(self.frame[f.a]), _bytes(self.frame[f.b])) for f in (*self.loads, *self.mounts))
        rods = frozenset(rod_pairs(self.system.elements)) if self.system.elements else frozenset()
        on = _bytes(self.system.markers.frame[self.surfaces])
        return (
            self.dim,
            self.rows,
            _bytes(self.width),
            on,
            tuple(acting),
            tuple(whole),
            rods,
            tuple(self.held),
            self._locked,
        )

    def _shape(self) -> MatrixShape:
        """Groups of rows, and the bodies that are coupled."""
        touched: list[set[int]] = [set() for _ in range(self.rows)]
        ends: list[set[tuple[int, ...]]] = [set() for _ in range(self.rows)]
        terms = np.zeros(self.rows, int)
        pairs = rod_pairs(self.system.elements)
        for items in (x for x in self.items if x.role != READ):
            bodies: Any = self.body_of(items.frames)
            if items.role == ROW:
                assert items.row is not None
                for number, pair, end in zip(items.row, bodies.tolist(), items.markers, strict=True):
                    touched[int(number)] |= {x for x in pair if x >= 0}
                    ends[int(number)].add(tuple(map(int, end)))
                    terms[int(number)] += 1
            pairs |= {(a, b) for x in bodies.tolist() for a, b in combinations(sorted({*x} - {-1}), 2)}

        for f in (*self.loads, *self.mounts):
            both: Any = self.body_of(self.frame[np.stack((f.a, f.b), axis=1)])
            pairs |= {(min(x), max(x)) for x in both.tolist() if x[0] != x[1] and min(x) >= 0}

        found: dict[tuple[tuple[int, ...], bool], list[int]] = {}
        for row in range(self.rows):
            found.setdefault((tuple(sorted(touched[row])), bool(terms[row] > 1)), []).append(row)
        groups = []
        for (near, coupling), rows in found.items():
            met = frozenset(end for row in rows for end in ends[row])
            groups.append(RowGroup(near, tuple(rows), coupling, met, locked=not self._locked.isdisjoint(rows)))
        firsts = {int(rows[0]): body for body, rows in self.held.items()}
        apart = {firsts[group.rows[0]]: group for group in groups if group.rows[0] in firsts}
        return MatrixShape(tuple(int(n) for n in self.width), tuple(groups), frozenset(pairs), apart)

    def renew_fields(self, t: float, *, predicted: bool) -> None:
        """New tangents of the fields at the state that C evaluated last, where an increment led or a step is ``predicted``;
        ConvergenceError where NumPy has to take them.
        """
        if any(field.part.shared_columns for field in self.fields):
            raise ConvergenceError(
                "The columns of a frame with mean axes change their number with the first new tangent."
            )
        moved = {f.k: Approach(f.b[: f.part.n].copy(), predicted) for f in self.fields}
        self._take(self.renewed(t, moved))

    def take(self, blocks: Sequence[Block]) -> bool:
        """Go on with other factors of the fields, for another size of step; False where their columns are others."""
        if not all(field.alike(block) for field, block in zip(self.fields, blocks, strict=True)):
            return False
        self._take(blocks)
        return True

    def _take(self, blocks: Sequence[Block]) -> None:
        """Write what depends on the factors of the fields."""
        for field, block in zip(self.fields, blocks, strict=True):
            field.take(block)
        self.blocks = blocks
        # ports that give way where they are pulled: of bodies that buckle
        self.c.indefinite = int(any(field.indefinite for field in self.fields))

    # -- all of it -------------------------------------------------------------------------------------------------------------
    def _system(self, redundant: int) -> None:
        """The structure System."""
        s, looks = self.system, self.looks
        once = 4 * s.n_v + 3 * self.rows  # work of a step, and of a second solution where there are fields
        row_dest, sign = pivots_of(self)
        controllers = self.listening.structure()  # before batches are copied
        integrals = any(x.formula is not None and x.formula.kind == "PID" for x in self.sources)
        counts, lists = self._lists()

        parts = [field.part for field in self.fields]
        known: list[Any] = [*self.items, *self.rods, *self.listening.listeners, *self.fields]

        self.c = structure("System", self.dim)(
            **counts, **lists, **self._numbers(once), fronts=len(self.fronts.fronts), front=ctypes.addressof(fronts_of(self)),
            rows=self.rows, nu=self.nu, nv=s.n_v, nq=s.n_q, redundant=redundant, fields=len(self.fields), core=s.n_core,
            again=once, stiff=int(bool(self.rods or self.told) or any(f.stiff for f in s.forces)),
            remembers=max((x.remembers for x in known), default=0),
            storage=self.fronts.storage, seen=len(looks.markers), seen_frame=self.store.integers(self.frame[looks.markers]),
            seen_place=seen_places(self), accelerated=int(looks.accelerated),
            seen_angle=self.store.integers(np.isin(looks.markers, list(looks.angled))),
            readings=looks.count, row_dest=row_dest, sign=sign, renewable=int(any([part.renewable for part in parts])),
            foretells=int(any([part.foretells for part in parts])), begins=int(any([part.begins_anew for part in parts])),
            keeps_tangents=int(any([part.keeps_tangents for part in parts])),
            indefinite=int(any([field.indefinite for field in self.fields])),
            leaves_out=int(s.leaves_out), parts=self.parts_of_numbers, controllers=controllers,
            remembered=self.listening.remembered(integrals=integrals), **self._links(),
        )  # fmt: skip

    def _lists(self) -> tuple[dict[str, int], dict[str, int]]:
        """How many bodies, surfaces .. there are, and the addresses of their structures."""
        others = rigid_bodies(self) | {frame: field.body() for frame, field in self.floating.items()}
        others |= {one.part.frame: one.body(others.get(one.part.frame)) for one in self.told}
        lists = {
            "body": ("bodies", [others[b] if b in others else reduced_body(self, b) for b in range(self.nb)]),
            "surface": ("surfaces", [surface(self, int(i)) for i in self.surfaces]),
            "angle": ("angles", angles(self)),
            "rod": ("rods", [rod.c for rod in self.rods]),
            "batch": ("batches", self.batches),
            "reaction": ("reactions", [reaction_of(self, *which) for which in self.looks.wrenches]),
        }

        counts, addresses = {}, {}
        for name, (plural, made) in lists.items():
            array = array_of(structure(name.capitalize(), self.dim), max(len(made), 1))(*made)
            self.store.kept.append(array)
            counts[plural], addresses[name] = len(made), ctypes.addressof(array)
        return counts, addresses

    @property
    def parts_of_numbers(self) -> int:
        """2 where the factors of fields, and so the matrix, are complex."""
        return max((field.parts for field in self.fields), default=1)

    def _numbers(self, once: int) -> dict[str, int]:
        """The arrays of numbers, kept by their names, and their addresses; ``once``: size of the work of a step."""
        s = self.system
        store = self.store
        size, parts = self.nu + self.rows, self.parts_of_numbers
        widest = int(self.width.max(initial=0))
        sides = max([2, *(x.frames.shape[1] for x in self.sources)])
        given = {
            "gravity": s.gravity(0.0),
            "rest_gravity": s.gravity.lasting,
            "units": s.units,
            "row_units": s.row_units,
            "multiplier_units": s.multiplier_units,
        }

        arrays = store.zeros({
            "velocity": self.nothing + 1, "residual": self.nothing + 1,
            "L": self.fronts.storage + 8, "lossy": (parts - 1) * self.fronts.storage + 8, "diagonal": size,
            "inverse": parts * size, "b": parts * size, "local": parts * size + 8,
            "work": once + s.n_v + self.rows + SECANTS * (2 * s.n_v + self.rows),
            "firm": 2 * self.rows, "directions": (CLOSING + 2) * parts * self.rows,
            "big": (2 * self.twist + 1) * sides * widest + size,
            **dict.fromkeys(("gap", "slip", "weight", "locked", *MOTIONS), self.rows),
            "frames": (self.nb + 1 + len(self.surfaces), FRAME[self.dim]), **{name: len(x) for name, x in given.items()},
        })  # fmt: skip
        self.arrays = {name: x for name, (x, _) in arrays.items()}
        for name, values in given.items():
            self.arrays[name][:] = values
        # the ground does not turn
        self.arrays["frames"][self.nb, self.dim : self.dim + self.dim**2 : self.dim + 1] = 1.0
        return {name: address for name, (_, address) in arrays.items()}

    def _links(self) -> dict[str, int]:
        """Room for efforts that answer to more than their own coordinate, see links.c."""
        told = self.listening.links
        # what tangents lack of symmetry costs increments: dear ones of fields alone
        skew = sum(loads.push.size for loads in self.whole) if self.fields else 0
        count = told + skew if (told + skew) * self.nu <= LINKS_LIMIT else told
        if not count:
            return {}
        wide, parts = self.nothing + 1, self.parts_of_numbers
        rows = parts * count
        sizes = {
            "push": (count, wide), "pull": (rows, parts * wide),
            "answer": (rows, parts * (self.nu + self.rows)), "mutual": (rows, rows),
        }  # fmt: skip
        made = self.store.zeros(sizes)
        self.arrays |= {name: x for name, (x, _) in made.items()}
        return {"linkable": count, **{name: address for name, (_, address) in made.items()}}

    def coordinate(self, number: int) -> int:
        """The address of the batch of one of the ``coordinates``."""
        size = ctypes.sizeof(structure("Batch", self.dim))
        return int(self.c.batch) + size * (self._first_coordinate + number)

    @cached_property
    def remembering(self) -> list[Any]:
        """Who has a memory, or may have: items, rods, controllers."""
        known: list[Any] = [*self.sources, *self.rods]
        return [one for one in known if one.remembers] + self.listening.listeners

    def recall(self) -> None:
        """Take the memory of elements that have one."""
        for items in self.sampled:
            items.arrays["effort"][:] = items.sampled
        for one in self.remembering:
            one.recall()

    def memories(self) -> list[Any]:
        """What the newest steps have made of the memory of elements."""
        return [one.memory() for one in self.remembering]

    def remember(self, memories: list[Any] | None = None) -> None:
        """Give the memory of elements back after accepted steps, which are the newest ones unless others are given."""
        for one, memory in zip(self.remembering, self.memories() if memories is None else memories, strict=True):
            one.remember(memory)

    def remember_within(self, memories: list[Any], kind: str) -> None:
        """The same of what compiled steps have found within a step, whose end Python takes up, of formulas of one kind."""
        for one, memory in zip(self.remembering, memories, strict=True):
            if isinstance(one, Items) and one.formula is not None and one.formula.kind == kind:
                one.remember(memory)
