"""Rigid and reduced bodies and their surfaces as structures of ``driver/tables.h``."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from .....mechanics.bodies.port_constraint import PortConstraint
from .....mechanics.catenary.sliding import HeadSide, WireSide
from .....mechanics.elastic.second_order import SecondOrder
from .....mechanics.rods.elements import RodElements
from .....mechanics.validity import TOO_LARGE
from .....rotations import Array
from ....system import System
from ...declarations import enumeration
from ..items.tied import SeenByTie, covers_ties
from ..places import rigid_places
from ..structures import structure
from .fields import known_field
from .told import can_be_told, is_told

if TYPE_CHECKING:
    from ..layout import TableLayout


SORTS = enumeration("MEAN")  # of surfaces


def rigid_bodies(tables: TableLayout) -> dict[int, Any]:
    """The structures Body of all rigid bodies, by their frames."""
    block, d = tables.system.rigid, tables.dim
    if block is None:
        return {}

    first = tables.at_u[block.frame]
    dest, ahead = rigid_places(tables, first)
    # all inertias stand in one array; a body's own is found by its address
    inertia, address = tables.store.array(block.inertia)
    size = inertia[0].nbytes if len(inertia) else 0

    kind = structure("Body", d)
    out = {}
    for i, frame in enumerate(block.frame):
        out[int(frame)] = kind(
            at_u=int(first[i]), mass=float(block.mass[i]), large=np.inf,
            inertia=address + size * i, dest=dest + ahead * i,
        )  # fmt: skip
    return out


def reduced_body(tables: TableLayout, b: int) -> Any:
    """The structure Body of the frame b, a reduced body."""
    system, store, d = tables.system, tables.store, tables.dim
    k, part = tables.parts[b]
    c = part.constants
    m = part.n
    width = int(tables.width[b])

    arrays = modal_arrays(c, m, d) | {"block": np.zeros((width, width))}
    i, j = tables.at_u[b] + lower_half(width)
    return structure("Body", d)(
        modes=m, at_v=system.slices[1][k].start, at_q=system.slices[0][k].start, at_u=int(tables.at_u[b]), mass=c.mass,
        large=(TOO_LARGE * c.size) ** 2 * c.mass, dest=store.integers(tables.fronts.place(i, j)),
        mean_rates=None if part.mean_rates is None else store.address(part.mean_rates),
        **store.copies(arrays),
    )  # fmt: skip


@cache
def lower_half(width: int) -> np.ndarray:
    """Rows and columns of the lower half of a matrix."""
    return np.array(np.tril_indices(width))


def modal_arrays(constants: Any, m: int, d: int) -> dict[str, Array]:
    """Inertia and stiffness of a reduced body with m modes in d dimensions, by their names in C, and its work space."""
    c = constants
    T = c.T.transpose(1, 0, 2, 3)  # [b, a] = T_ab
    pairs = ((2, 1), (0, 2), (1, 0)) if d == 3 else ((1, 0),)

    arrays = {
        "S": c.S,
        "T": T,
        "V": np.stack([T[..., i, j] - T[..., j, i] for i, j in pairs], axis=-1),
        "modal": c.derived.mass,
        "K": c.K,
        "C": c.D,
        "U": np.zeros((m + 1) * (d * d + 2 * d - 3) + 2 * m),
    }

    if c.stiffening is not None:
        arrays |= {
            "stress": c.stiffening.transpose(0, 2, 1),
            "now": np.zeros((m, m)),
            "bent": np.zeros((d + d * d + 1, m)),
        }
        second = SecondOrder(c.mass, c.S[:, 0], c.T[0, 0])
        arrays |= {"mean": second.inverse, "heavy": np.zeros((4 * len(second.inverse), len(second.inverse) + m))}
    return arrays


def surface(tables: TableLayout, marker: int) -> Any:
    """The structure Surface of a marker on a reduced or floating body; its map is kept in ``tables.maps``."""
    system, store, d = tables.system, tables.store, tables.dim
    markers = system.markers
    body = int(markers.frame[marker])
    seen = tables.tied.sees.get(marker)
    if seen is not None:
        return _integral(tables, marker, seen)

    k, part = tables.parts[body]
    number = np.searchsorted(markers.surface, marker)
    ports = markers.port[number] - system.port_slice(k).start
    section = markers.section is not None and markers.section[number]
    one = structure("Surface", d)(
        body=body, sort=SORTS["SECTION" if section else "MEAN"], measure=1.0, p=(ctypes.c_double * d)(*markers.position[marker]),
        reference=store.address(part.reference[ports]), ports=store.address(tables.port_matrix(body)[ports]),
    )  # fmt: skip
    _add_map(tables, one, body)

    if part.shortening is not None and part.shortening.G is not None:
        N = part.shortening.N[ports]
        mine = np.flatnonzero(np.abs(N).max(axis=0) > 0)
        one.bends = len(mine)
        one.N, one.G = store.address(N[:, mine]), store.address(part.shortening.G[mine].transpose(0, 2, 1))
        one.now = store.address(np.zeros((len(ports) + 1, part.n)))
        one.bend_map = store.address(np.zeros((tables.twist, max(len(mine), 1))))
    return one


def _integral(tables: TableLayout, marker: int, seen: SeenByTie) -> Any:
    """The structure Surface of what a tie sees of a body by one function."""
    system, store, d = tables.system, tables.store, tables.dim
    body = int(system.markers.frame[marker])
    ports: Array = np.zeros((d, 0))
    if body in tables.parts:
        number = np.searchsorted(system.markers.surface, marker)
        first = system.port_slice(tables.parts[body][0]).start
        ports = tables.port_matrix(body)[system.markers.port[number, :d] - first]

    one = structure("Surface", d)(
        body=body, sort=SORTS["INTEGRAL"], measure=seen.measure, turn=(ctypes.c_double * d**2)(*np.eye(d).ravel()),
        reference=store.address(seen.reference), ports=store.address(ports),
    )  # fmt: skip
    _add_map(tables, one, body)
    return one


def _add_map(tables: TableLayout, one: Any, body: int) -> None:
    """Room for the map of a surface from the rates of its body."""
    surface_map, one.map = tables.store.array(np.zeros((tables.twist, tables.width[body])))
    tables.maps.append(surface_map)


def covers_bodies(system: System) -> bool:
    """Whether all bodies are known to the driver, with all that loads them."""
    known = all(_known_part(p) for p in system.parts)
    rods = all(isinstance(e, RodElements) for e in system.elements)
    own = {type(law) for law, _ in system.port_constraints} <= {PortConstraint, WireSide, HeadSide}
    return known and rods and own and covers_ties(system) and system.n_frames > 0


def _known_part(part: Any) -> bool:
    """Whether the driver takes a part."""
    if part.distributed:
        return known_field(part)
    return not is_told(part) or can_be_told(part)
