"""Counted angles (:mod:`fmbd_fenicsx.mechanics.joints.counted`) in the driver's tables."""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, Any

import numpy as np

from ....system import System
from ..structures import structure

if TYPE_CHECKING:
    from ..layout import TableLayout
    from .items import Items


def theta_places(system: System, items: Items) -> np.ndarray:
    """Places in q of the counted angles of items, in space."""
    counted = system.counted
    assert counted is not None
    a = np.asarray(counted.turn.a)
    b = np.asarray(counted.turn.b)
    number = {(int(i), int(j)): k for k, (i, j) in enumerate(zip(a, b, strict=True))}
    first = system.counted_angles.start
    return np.array([first + number[int(i), int(j)] for i, j in items.markers])


def angles(tables: TableLayout) -> list[Any]:
    """Structures Angle of all counted angles, in the order of q; those of surfaces that turn as a whole have these for frames."""
    s, d = tables.system, tables.dim
    mk, counted = s.markers, s.counted
    if counted is None or not counted.count:
        return []
    turn, start = counted.turn, counted.start
    vector = ctypes.c_double * d
    sides = {"a": turn.a, "b": turn.b}
    axes = {"e": turn.e, "f": turn.e1, "g": turn.e2} if d == 3 else {}

    out = []
    for i, free in enumerate(counted.free):
        frame = tables.frame if free else mk.frame
        local = {n + m: vector(*(mk.rotation[x[i]] @ e[i])) for n, e in axes.items() for m, x in sides.items()}
        a, b = (int(x[i]) for x in sides.values())
        one = structure("Angle", d)(a=int(frame[a]), b=int(frame[b]), zero=start[b] - start[a], free=int(free), **local)
        out.append(one)
    return out


def free_markers(system: System) -> list[np.ndarray]:
    """Markers of counted angles that are those of surfaces without a frame."""
    counted = system.counted
    return [] if counted is None else [np.asarray(x)[counted.free] for x in (counted.turn.a, counted.turn.b)]
