"""Constraints and forces of a system as items of kinds: one description of both, that the tables are filled from.

role ROW      a term c s of a constraint  sum c s - motion(t) = 0
role LINEAR   an effort N = stiffness (s - free) + damping s'
role GIVEN    an effort that is the same for the whole step: loads and drives, of which Python tells those that depend on time
role LAW      an effort from a law in Python, N(s - free, s', t)
role READ     nothing acts: a coordinate that a sensor reads, in records; where ``told`` a controller, at every evaluation
role FORMULA  an effort by a formula that the driver knows, maybe with a memory
role TERM     nothing acts: a term of a sum of coordinates, whose own items act
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

from .....mechanics.forces.force_elements import Loads, ScalarLoads, TimeLoads
from .....mechanics.forces.forces import Constant
from .....mechanics.forces.formulas import Formula
from .....mechanics.forces.laws_together import LawsTogether
from .....mechanics.joints import constraints as ct
from .....mechanics.joints.couplings import CouplingBatch
from .....mechanics.joints.relative import CoordinateSums, RelativeCoordinates
from .....mechanics.kinds.derivation import Kind, kinds
from .....mechanics.kinds.sums import sum_kind
from .....rotations import Array
from ....system import System
from ...declarations import enumeration
from ...recording import Looks

ROW, LINEAR, GIVEN, LAW, READ, FORMULA, _, _, TERM = enumeration("ROW").values()


@dataclass
class Items:
    """Items of one kind and role: numbers of their markers (n, 2) and constants by name, (n,) or (n, size), in the axes of the
    markers. Items of sums of coordinates have ``terms``, k Items in role TERM, with ``factor`` (n, k) and ``shift`` (n,), and
    the markers of all of these, (n, 2 k).

    ``row``, ``factor``: of constraints. ``law``, ``stiffness``, ``damping``, ``free``: of efforts. ``drive``: per item t -> (s,
    s', s'') of a prescribed angle. ``load``: t -> constants of all items that change in time, by name. ``given``: t -> efforts.
    """

    kind: Kind
    role: int
    markers: np.ndarray
    constants: dict[str, Array]
    row: np.ndarray | None = None
    factor: Array | None = None
    stiffness: Array | None = None
    damping: Array | None = None
    free: Array | None = None
    effort: Array | None = None
    law: LawsTogether | None = None
    drive: list[Any] = field(default_factory=list)
    load: Callable[[float], dict[str, Array]] | None = None
    given: Callable[[float], Array] | None = None
    formula: Formula | None = None
    slot: np.ndarray | None = None  # numbers among the readings of a record, -1 for none
    table: Array = field(default_factory=lambda: np.zeros((0, 0)))  # of constants, as C reads them
    sampled: Array | None = None  # an effort that stays the same between samples, as it is now
    told: bool = False
    quotient: int = 0  # of efforts over a step that keeps energy, as in mechanics/joints/relative.py
    linked: bool = False  # whether a law reads more than its own coordinate
    terms: list[Items] = field(default_factory=list)
    shift: Array | None = None
    frames: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), int))  # of both sides
    ahead: Array = field(default_factory=lambda: np.zeros((0, 1)))  # t, s, s' and N of a law at points of a step
    loads: Loads | None = None  # springs and dampers: whose they are, and their numbers there
    number: np.ndarray | None = None
    batch: Any = None  # the structure
    arrays: dict[str, Array] = field(default_factory=dict)  # coordinates, rates, efforts .. as C reads and writes them

    def __len__(self) -> int:
        return len(self.markers)

    @property
    def remembers(self) -> bool:
        """Whether they have a memory."""
        return self.formula is not None and self.formula.kept is not None

    def recall(self) -> None:
        """Take the memory of the elements."""
        assert self.formula is not None and self.formula.kept is not None
        self.arrays["kept"][:] = self.formula.kept()

    def memory(self) -> Array:
        """What steps have made of it."""
        return self.arrays["kept"].copy()

    def remember(self, memory: Array) -> None:
        """Give it back after accepted steps."""
        assert self.formula is not None and self.formula.keep is not None
        self.formula.keep(memory)

    def take_quotient(self, relative: RelativeCoordinates) -> None:
        """How efforts on a coordinate become difference quotients, of sums term by term."""
        self.quotient = relative.quotient
        for items, term in zip(self.terms, relative.summands, strict=False):
            items.quotient = term.quotient

    def part(self, which: np.ndarray) -> Items:
        """Some of the items."""

        def some(x: Any) -> Any:
            return None if x is None else np.asarray(x)[which]

        made = Items(
            self.kind, self.role, self.markers[which], {name: x[which] for name, x in self.constants.items()},
            some(self.row), some(self.factor), some(self.stiffness), some(self.damping), some(self.free), some(self.effort),
            *self._laws(which),
        )  # fmt: skip
        made.slot, made.told, made.linked, made.quotient = some(self.slot), self.told, self.linked, self.quotient
        made.frames = self.frames[which] if len(self.frames) else self.frames
        made.terms, made.shift = [term.part(which) for term in self.terms], some(self.shift)
        made.formula = None if self.formula is None else self.formula.part(which)
        made.loads, made.number = self.loads, some(self.number)
        return made

    def _laws(self, which: np.ndarray) -> tuple[Any, ...]:
        """What changes in time, of some items."""
        law, load, given = self.law, self.load, self.given
        if len(which) == len(self):
            return law, self.drive, load, given
        return (
            law and law.part(which),
            [self.drive[i] for i in which] if self.drive else [],
            load and (lambda t: {n: x[which] for n, x in load(t).items()}),
            given and (lambda t: given(t)[which]),
        )


def of_source(source: Any, role: int) -> Items:
    """Items of a joint coordinate or of a batch of constraints."""
    if isinstance(source, CoordinateSums):
        terms = [of_source(term, TERM) for term in source.summands]
        kind = sum_kind(tuple(term.kind for term in terms), tuple(range(2 * len(terms))))
        markers = np.concatenate([term.markers for term in terms], axis=1)
        return Items(kind, role, markers, {}, factor=source.factors, terms=terms, shift=source.offsets)
    return Items(source.items.kind, role, source.items.pair, dict(source.items.constants))


def _constraint(batch: ct.Batch, rows: np.ndarray) -> Items:
    """Items of a batch of elementary constraints."""
    out = of_source(batch, ROW)
    out.row, out.factor = rows, np.ones(len(rows))
    if isinstance(batch, ct.DrivenKinds):
        out.drive = [motion for _, motion in batch.driven]
    return out


def _loads(loads: TimeLoads, dim: int) -> list[Items]:
    """Items of forces and torques: an effort -1 along the flow of each load. Those that stay the same are told once."""
    out = []
    for turns, follower, steady in product((False, True), repeat=3):
        fits = [
            (f.turns, bool(f.follower), isinstance(f.law, Constant)) == (turns, follower, steady) for f in loads.forces
        ]
        which = [i for i, fit in enumerate(fits) if fit]
        if not which:
            continue
        kind = (("dead", "follower"), ("couple", "follower_couple"))[turns][follower]
        size = dim if not turns else 2 * dim - 3
        laws = [loads.laws[i].numbers for i in which]

        def load(t: float, asked: list[Any] = laws, size: int = size) -> dict[str, Array]:
            return {"load": np.array([numbers(size, t) for numbers in asked], dtype=float)}

        markers = np.stack((loads.a, loads.a), axis=1)[which]
        constants = load(0.0) if steady else {"load": np.zeros((len(which), size))}
        made = Items(kinds(dim)[kind], GIVEN, markers, constants, load=None if steady else load)
        made.effort = -np.ones(len(which))
        out.append(made)
    return out


def _formulas(loads: Loads, looks: Looks) -> list[Items]:
    """Items of efforts by formulas, on the coordinates of a batch."""
    out = []
    for formula in loads.formulas():
        whole = of_source(formula.on, FORMULA)
        whole.free = np.zeros(len(loads.forces))
        if isinstance(loads, ScalarLoads):
            whole.free = loads.free
            whole.take_quotient(loads.relative)
        whole.slot = looks.slots_of(loads)
        made = whole.part(formula.which)
        made.formula = formula
        out.append(made)
    return out


def _efforts(loads: ScalarLoads, looks: Looks) -> list[Items]:
    """Items of springs, dampers, drives and laws on coordinates."""
    n = len(loads.forces)
    whole = of_source(loads.relative, LINEAR)
    whole.stiffness, whole.damping, whole.free = loads.k, loads.c, loads.free
    whole.slot = looks.slots_of(loads)
    whole.loads, whole.number = loads, np.arange(n)
    whole.take_quotient(loads.relative)
    stated = {int(i) for formula in loads.formulas() for i in formula.which}
    own = np.array([i for i in loads.own if i not in stated], dtype=int)
    of_time = np.array([i for i in own if loads.forces[i].of_time], dtype=int)
    steady = np.array([i for i in of_time if isinstance(loads.forces[i].law.given, Constant)], dtype=int)
    timed, called = np.setdiff1d(of_time, steady), np.setdiff1d(own, of_time)
    linear = np.setdiff1d(np.arange(n), [*own, *stated])
    out = [whole.part(linear)] if len(linear) else []

    if len(steady):
        part = whole.part(steady)
        part.role, part.effort = GIVEN, loads.given(steady, 0.0)
        out.append(part)
    if len(timed):
        part = whole.part(timed)
        part.role = GIVEN
        part.given = lambda t: loads.given(timed, t)
        out.append(part)

    if len(called):
        part = whole.part(called)
        part.role = LAW
        part.law = loads.laws_of(called)
        out.append(part)
    return out


def items_of(
    system: System, looks: Looks, control: Sequence[Items] = (), coordinates: Sequence[RelativeCoordinates] = ()
) -> list[Items]:
    """All items of a system; constraints in the order of its batches, then efforts, those of ``control``, what sensors read, and
    ``coordinates``.
    """
    dim = system.motions.dim
    out: list[Items] = []
    for batch, rows in system.batches:
        if isinstance(batch, CouplingBatch):
            for relative, number, factor in batch.terms:
                term = of_source(relative, ROW)
                term.row, term.factor = rows[number], factor
                out.append(term)
        else:
            out.append(_constraint(batch, rows))

    for loads in system.forces:
        if type(loads) is TimeLoads:
            out += _loads(loads, dim)
        elif type(loads) is ScalarLoads:
            out += _efforts(loads, looks)
        out += _formulas(loads, looks) + _sampled(loads, looks)

    out += control
    for key, relative in looks.relatives:
        made = of_source(relative, READ)
        made.slot = looks.take_slots(key, len(made))
        out.append(made)
    return out + [of_source(relative, READ) for relative in coordinates]


def _sampled(loads: Loads, looks: Looks) -> list[Items]:
    """Items of efforts that stay the same between samples."""
    out = []
    for i, one in enumerate(loads.sampled()):
        made = of_source(one.on, GIVEN)
        made.slot = looks.slots_of(loads, i)
        made.effort, made.sampled = np.zeros(len(made)), one.effort
        out.append(made)
    return out


def other_loads(system: System) -> list[Loads]:
    """Forces that Python evaluates as a whole."""
    known = TimeLoads, ScalarLoads
    rest = [f for f in system.forces if type(f) not in known and not f.told]
    return [f for f in rest if f.mounts() is None]


def covers(system: System) -> bool:
    """Whether all forces with a memory are formulas or controllers, and all others items, or loads that Python can evaluate."""
    return all(loads.told for loads in system.forces if loads.kept is not None)
