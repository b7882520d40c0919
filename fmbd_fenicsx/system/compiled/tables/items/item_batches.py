"""Batches of items of one kind: constants in the axes of frames, and arrays for what the driver finds of each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .....mechanics.forces.force_elements import Loads
from .....mechanics.forces.formulas import MEMORY
from .....mechanics.kinds.frames import PLACES
from .....mechanics.kinds.sums import sum_kind
from .....rotations import Array
from ...declarations import enumeration
from ..places import batch_of, rates_of, square_places
from ..structures import Store, structure
from .angles import theta_places
from .items import FORMULA, LAW, READ, Items

if TYPE_CHECKING:
    from ..layout import TableLayout

MOST_STAGES = enumeration("MOST_STAGES")["MOST_STAGES"]  # points of a step
FORMULAS = enumeration("SERVO", "forces/formulas.c")
LINE, MOST_POINTS = enumeration("LINE").values()  # numbers that stand for a law, at each of so many points
TURNS = {"turn_a": 0, "turn_b": 1}  # those that turn from the axes of a marker into those of its frame
OF_ITEMS = "s rate effort foretold across weight slope stiffness damping free".split()  # a number for each item
MOUNT = enumeration("ROW")["MOUNT"]  # the role


def of_one_sort(tables: TableLayout, items: Items) -> list[Items]:
    """Items whose frames are of one sort: bodies, the ground on one side, or some on surfaces. Terms stand before their sums.

    Laws in Python are asked together, on bodies and against the ground.
    """
    together = items.role == LAW and not items.terms
    key = "sorts", together, items.frames.shape[1], items.frames.tobytes()
    sorts = tables.structure.once(key, lambda: _sorts(tables, items.frames, together))
    parts = [items] if len(sorts) == 1 else [items.part(which) for which in sorts]
    for part in parts:
        if part.terms:
            _share_frames(part)
        elif tables.held and np.isin(part.frames, list(tables.held)).all():
            part.kind = part.kind.between_origins
    return [one for part in parts for one in (*part.terms, part)]


def _sorts(tables: TableLayout, frames: np.ndarray, together: bool) -> list[np.ndarray]:
    """Numbers of the items of each sort, which have the same frames in common; ``together``: one sort but for surfaces."""
    sides = (frames == tables.nb) & (not together)
    if tables.held and not together:
        sides = np.where(np.isin(frames, list(tables.held)), 2, sides)
    sort = np.where((frames > tables.nb).any(axis=1), -1, sides @ (3 ** np.arange(frames.shape[1])))
    _, number = np.unique(np.column_stack((sort, _first_alike(frames))), axis=0, return_inverse=True)
    return [np.flatnonzero(number.ravel() == k) for k in range(number.max(initial=-1) + 1)]


def _first_alike(frames: np.ndarray) -> np.ndarray:
    """Of each frame of an item the first that is the same, (n, sides)."""
    return np.asarray((frames[:, :, None] == frames[:, None, :]).argmax(axis=2))


def _share_frames(items: Items) -> None:
    """The frames of sums of one sort, each of them once."""
    for k, term in enumerate(items.terms):
        term.frames = items.frames[:, 2 * k : 2 * k + 2]
    columns, number = np.unique(_first_alike(items.frames[:1])[0], return_inverse=True)
    items.kind = sum_kind(tuple(term.kind for term in items.terms), tuple(number.tolist()))
    items.frames = items.frames[:, columns]


def _constants(tables: TableLayout, items: Items, P: Array) -> None:
    """Fill the table of constants, (n, width), in the axes of the frames."""
    mk = tables.system.markers
    n = len(items)
    kind = items.kind

    for name, side in PLACES.items():
        if name in kind.constants:
            place = mk.position[items.markers[:, side]]
            if tables.surfaces.size:  # a marker on a surface lies where the surface is
                place[tables.frame[items.markers[:, side]] > tables.nb] = 0.0
            P[:, kind.place(name)] = place

    for name, side in TURNS.items():
        if name in kind.constants:
            P[:, kind.place(name)] = mk.rotation[items.markers[:, side]].reshape(n, -1)
    # in the plane angles count from those at the start
    if kind.name == "angle" and tables.dim == 2:
        assert tables.system.counted is not None
        start = tables.system.counted.start[items.markers]
        P[:, kind.place("zero").start] = start[:, 1] - start[:, 0]

    for name, values in items.constants.items():
        if name in kind.constants:
            P[:, kind.place(name)] = turned(tables, items, name, values)


def turned(tables: TableLayout, items: Items, name: str, values: Array) -> Array:
    """Constants of items, directions turned from the axes of their markers into those of the frames; (n, size)."""
    values = np.asarray(values, dtype=float).reshape(len(items), -1)
    R = turning(tables, items, name)
    return values if R is None else np.asarray((R @ values[..., None])[..., 0])


def turning(tables: TableLayout, items: Items, name: str) -> Array | None:
    """Rotations (n, dim, dim) from the axes of the markers in which a constant is a direction; None for other constants."""
    side = items.kind.sides.get(name)
    return None if side is None else np.asarray(tables.system.markers.rotation[items.markers[:, side]])


def item_batch(tables: TableLayout, items: Items, number: int) -> Any:
    """One structure Batch."""
    kind, n, store = items.kind, len(items), tables.store
    one = items.batch = batch_of(tables, items)
    one.number = number
    room = store.zeros({
        "P": (n, kind.width), "out": (n, one.outputs), "hessian": (n, 0 if items.role == READ else one.hessians),
        "known": (n, 3 if items.role in (LAW, FORMULA) else 0), "numbers": (len(OF_ITEMS), n),
    })  # fmt: skip
    if items.role in (LAW, FORMULA):
        one.line = store.zeros({"line": (MOST_POINTS, n, LINE)})["line"][1]
        one.bridges = store.integers(np.zeros(n))
    if items.law is not None:
        one.sees, one.answers = 2 * n, n
        items.ahead, one.ahead = store.array(np.zeros((MOST_STAGES, 1 + 3 * n)))
    items.table, one.P = room["P"]
    items.arrays["out"] = room["out"][0]
    _constants(tables, items, items.table)
    one.out, one.hessian, one.known = room["out"][1], room["hessian"][1], room["known"][1]

    numbers, first = room["numbers"]
    given = {"effort": items.effort, "stiffness": items.stiffness, "damping": items.damping, "free": items.free}
    for k, name in enumerate(OF_ITEMS):
        values = given.get(name)
        items.arrays[name] = numbers[k]
        if values is not None:
            numbers[k] = values
        setattr(one, name, first + 8 * n * k)

    if items.formula is not None:
        _formula(store, one, items)
    if items.slot is not None:
        one.slot = store.integers(items.slot)
    if items.factor is not None:
        one.factor = store.address(items.factor)
    if items.terms:
        one.shift = store.address(items.shift)
    if kind.name == "angle" and tables.dim == 3:
        one.near, one.theta = kind.place("near").start, store.integers(theta_places(tables.system, items))
    return one


def _formula(store: Store, one: Any, items: Items) -> None:
    """The numbers of a formula, and the memory of its elements."""
    formula = items.formula
    assert formula is not None
    one.formula = FORMULAS[formula.kind]
    items.arrays["constants"], one.constants = store.array(formula.constants)
    memory = np.zeros((len(items), MEMORY)) if formula.kept is None else formula.kept()
    items.arrays["kept"], one.kept = store.array(memory)


def mount_batch(tables: TableLayout, loads: Loads) -> Any:
    """One structure Batch of role MOUNT for bushings; its constants are places, turns, K and C, as mounts.c reads them."""
    mk = tables.system.markers
    store = tables.store
    matrices = loads.mounts()
    assert matrices is not None
    markers = np.stack((loads.a, loads.b), axis=1)
    frames = tables.frame[markers]
    n = len(markers)
    size = tables.twist
    d, rot = tables.dim, size - tables.dim
    places = np.where((frames > tables.nb)[..., None], 0.0, mk.position[markers])
    turns = mk.rotation[markers].reshape(n, 2, -1)
    sides = [x[:, side] for side in (0, 1) for x in (places, turns)]
    constants = np.concatenate([*sides, *(x.reshape(n, -1) for x in matrices)], axis=1)

    return structure("Batch", tables.dim)(
        role=MOUNT, n=n, width=constants.shape[1], mapped=1, P=store.address(constants), pair=store.integers(frames),
        at=store.integers(tables.twist_places(frames).reshape(n, -1)),
        known=store.address(np.zeros(n * (2 * size * (1 + size) + d * d + rot * rot + 2 * d))),
        **square_places(tables, store, rates_of(tables, frames)),
    )  # fmt: skip
