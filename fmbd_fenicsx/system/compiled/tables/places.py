"""Where the entries of a scene's items, bodies and fronts go: what depends on its structure alone.

Scenes of one structure (the same bodies, joints and forces between them, in the same order) differ in their data only. The places
are found once for a structure and kept beside its fronts; tables of further scenes take copies of the finished structures and
put their own data in. C only reads what is shared.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ....mechanics.kinds.derivation import KERNELS, Kind
from ....mechanics.kinds.library import kernel_address
from ....mechanics.kinds.sums import SumKind
from .items.items import GIVEN, LAW, READ, ROW, TERM, Items
from .layout import TableLayout
from .structures import structure


def batch_of(tables: TableLayout, items: Items) -> Any:
    """A structure Batch of items, its places filled in, its data to follow."""
    rows = b"" if items.row is None else items.row.tobytes()
    key = items.kind, items.role, items.frames.tobytes(), rows
    shared = tables.structure.once(key, lambda: _batch(tables, items, items.frames))
    made = type(shared).from_buffer_copy(shared)
    made.told, made.linked, made.quotient = int(items.told), int(items.linked), items.quotient
    return made


def _batch(tables: TableLayout, items: Items, frames: np.ndarray) -> Any:
    kind = items.kind
    n = len(items)
    store = tables.structure.store
    mapped = bool((frames > tables.nb).any())
    components = np.array(kind.entries, dtype=int)
    # laws have frames of several sorts
    ground = (frames == tables.nb).all(axis=0) if items.role == LAW else frames[0] == tables.nb
    still = np.repeat(ground, tables.twist) & (not mapped)
    if tables.held and not mapped:
        still |= _held(tables, items, frames)
    live = np.flatnonzero(~still[components])
    places = tables.twist_places(frames).reshape(n, -1)

    one = structure("Batch", tables.dim)(
        **{which: kernel_address(kind, which) for which in KERNELS}, role=items.role, flow=int(kind.flow),
        driven=int(kind.driven), n=n, width=kind.width, outputs=1 + len(components), live=len(live), mapped=int(mapped),
        pair=store.integers(frames), entry=store.integers(1 + live), at=store.integers(places[:, components[live]]),
        component=store.integers(components),
    )  # fmt: skip
    one.sides, one.terms = frames.shape[1], len(items.terms)
    if isinstance(kind, SumKind):
        one.into = store.integers(np.array(kind.into, dtype=int))

    where = np.zeros(one.sides * tables.twist, int)
    where[list(kind.entries)] = 1 + np.arange(len(kind.entries))
    one.where = store.integers(np.tile(where, (n, 1)))
    if items.role == READ:  # nothing acts
        return one
    one.hessians = len(kind.pattern)
    one.turning = int(any(term.kind.pattern for term in items.terms))
    if items.role == ROW:
        one.row = store.integers(items.row)

    if mapped:
        _mapped_places(tables, one, (items, frames))
    else:
        _plain_places(tables, one, (items, frames), places, still)
    return one


def _held(tables: TableLayout, items: Items, frames: np.ndarray) -> np.ndarray:
    """Which components of the twists of the frames (n, k) of items their rows and tangents leave out: angular velocities of
    bodies whose attitude is held by rows that meet nothing else; not these rows themselves.
    """
    apart = np.isin(frames, list(tables.held))
    if items.row is not None and any(items.row[0] in tables.held[int(frame)] for frame in frames[0, apart[0]]):
        apart[:] = False
    sides = (apart | (frames == tables.nb)).all(axis=0)
    return np.repeat(sides, tables.twist) & (np.arange(len(sides) * tables.twist) % tables.twist >= tables.dim)


def _pattern(kind: Kind) -> np.ndarray:
    """Pairs of twist components of a kind's tangent, (k, 2)."""
    return np.array(kind.pattern, dtype=int).reshape(-1, 2)


def _plain_places(
    tables: TableLayout, one: Any, batch: tuple[Items, np.ndarray], places: np.ndarray, still: np.ndarray
) -> None:
    """Where the entries of a batch go in the fronts: of rows, of products of rows, of geometric stiffness; ``still``: components
    of twists that leave them out.
    """
    (items, _), store, fronts = batch, tables.structure.store, tables.fronts
    entries = np.array(items.kind.entries, dtype=int)
    live = np.flatnonzero(~still[entries])
    components = entries[live]
    pattern = _pattern(items.kind)
    curve = np.flatnonzero(~still[pattern].any(axis=1))
    one.curved, one.curve = len(curve), store.integers(curve)
    one.curve_to = store.integers(_pairs(tables, items, places, tuple(pattern[curve].T)))

    if items.role == ROW:
        rows = tables.nu + np.asarray(items.row)
        one.dest = store.integers(fronts.place(rows[:, None], places[:, components]))
    elif items.role not in (GIVEN, TERM):
        first, second = np.tril_indices(len(live))
        one.products = len(first)
        one.first, one.second = store.integers(1 + live[first]), store.integers(1 + live[second])
        one.product_to = store.integers(_pairs(tables, items, places, (components[first], components[second])))


def _pairs(tables: TableLayout, items: Items, places: np.ndarray, pair: Sequence[np.ndarray]) -> np.ndarray:
    """Places of the entries of pairs of twist components, whose unknowns are ``places``; of the ground behind all others."""
    i, j = places[:, pair[0]], places[:, pair[1]]
    if items.role != LAW:
        return tables.fronts.place(i, j)
    away = np.repeat(items.frames == tables.nb, tables.twist, axis=1)
    none = away[:, pair[0]] | away[:, pair[1]]
    out = np.full(i.shape, tables.fronts.storage)
    out[~none] = tables.fronts.place(i[~none], j[~none])
    return out


def _mapped_places(tables: TableLayout, one: Any, batch: tuple[Items, np.ndarray]) -> None:
    """The same for items with frames on surfaces, whose rows act on all rates of the bodies."""
    (items, frames), store, fronts = batch, tables.structure.store, tables.fronts
    pattern = _pattern(items.kind)
    one.curved, one.curve, one.lower = len(pattern), store.integers(np.arange(len(pattern))), store.integers(pattern)

    rates = rates_of(tables, frames)
    needed = len(pattern) > 0 or items.role not in (ROW, TERM)
    for name, address in square_places(tables, store, rates, needed).items():
        setattr(one, name, address)
    if items.role == ROW:
        rows = tables.nu + np.asarray(items.row)
        to = [fronts.place(row, x) for row, x in zip(rows, rates, strict=True)]
        one.row_to = store.integers(np.concatenate(to))


def fronts_of(tables: TableLayout) -> Any:
    """All structures Front, one array."""
    return tables.structure.once("fronts", lambda: _fronts(tables))


def _fronts(tables: TableLayout) -> Any:
    fronts, store = tables.fronts, tables.structure.store
    kind, made = structure("Front", tables.dim), []
    for k, f in enumerate(fronts.fronts):
        rest = f.unknowns[f.pivots :]
        to = fronts.row_in(np.full(len(rest), f.following), rest) if len(rest) else rest
        one = kind(
            pivots=f.pivots, rows=len(f.unknowns), ld=int(fronts.ld[k]), next=f.following, start=int(fronts.start[k]),
            apart=int(f.apart), unknown=store.integers(f.unknowns), to=store.integers(to),
        )  # fmt: skip
        made.append(one)
    return (kind * max(len(made), 1))(*made)


def pivots_of(tables: TableLayout) -> tuple[int, int]:
    """Addresses of the places of the rows' pivots, and of the signs of all pivots."""

    def find() -> tuple[int, int]:
        row = tables.nu + np.arange(tables.rows)
        sign = np.where(np.arange(tables.nu + tables.rows) < tables.nu, 1, -1)
        store = tables.structure.store
        return store.integers(tables.fronts.place(row, row)), store.array(sign, np.int8)[1]

    found: tuple[int, int] = tables.structure.once("pivots", find)
    return found


def rigid_places(tables: TableLayout, first: np.ndarray) -> tuple[int, int]:
    """Address of the places of the blocks of rigid bodies whose unknowns begin at ``first`` (n,), and bytes from one to the next.

    Translations and rotations of a rigid body do not meet about its centre of mass.
    """
    d = tables.dim
    met = [(i, i) for i in range(d)]
    met += [(d + i, d + j) for i in range(2 * d - 3) for j in range(i + 1)]

    def find() -> int:
        i, j = np.array(met).T
        return tables.structure.store.integers(tables.fronts.place(first[:, None] + i, first[:, None] + j))

    return tables.structure.once(("rigid", first.tobytes()), find), 4 * len(met)


def rates_of(tables: TableLayout, frames: np.ndarray) -> list[np.ndarray]:
    """The rates that move each item of frames (n, k), frame by frame: those of a body with two of them stand twice."""
    return [np.concatenate([tables.rates(int(f)) for f in each]) for each in frames]


def square_places(tables: TableLayout, store: Any, rates: list[np.ndarray], needed: bool = True) -> dict[str, int]:
    """Fields of a structure Batch: the rates of its items, the places of the lower halves of blocks on them where these are
    ``needed``, and where those of an item begin.
    """
    counts = np.array([len(x) for x in rates])
    starts = [np.concatenate(([0], np.cumsum(x))).astype(np.int64) for x in (counts, counts * (counts + 1) // 2)]
    squares = [np.zeros(0, int)]
    for x in rates if needed else ():
        c, r = np.tril_indices(len(x))
        squares.append(tables.fronts.place(x[c], x[r]))
    return {
        "row_start": store.array(starts[0], np.int64)[1],
        "row_on": store.integers(np.concatenate(rates)),
        "square_start": store.array(starts[1], np.int64)[1],
        "square_to": store.integers(np.concatenate(squares)),
    }
