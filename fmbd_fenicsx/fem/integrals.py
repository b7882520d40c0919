"""Vectors of compiled forms as tables for those who assemble them without DOLFINx, on one rank.

FFCx's function of an integral makes the vector of one cell from coefficients that lie packed cell by cell. Most of these stay;
where values of functions at nodes move, their places among the packed ones are found by marks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import dolfinx_compat as compat
from ..rotations import Array


@dataclass(frozen=True)
class Integral:
    """One integral over ``count`` cells or facets of cells.

    ``kernel``: the address of FFCx's function. ``node`` (count, nodes) and ``corner`` (count, corners): of the cells; test
    functions have so many ``components``. ``points`` (n, 3): where corners are. ``facet`` (count,): of the cells, None over
    these. ``constants``; ``coefficients`` (count, width): packed. ``moving``: of each function that moves its places (k,) among
    the coefficients, and its entries there (count, k).
    """

    kernel: int
    node: np.ndarray
    components: int
    corner: np.ndarray
    points: Array
    facet: np.ndarray | None
    constants: Array
    coefficients: Array
    moving: tuple[tuple[np.ndarray, np.ndarray], ...]


def tabulated(form: Any, functions: Sequence[Any]) -> list[Integral] | None:
    """The integrals of a compiled linear form in which these functions move, None for those that it has not; None where others
    than C have to assemble it.
    """
    space = form.function_spaces[0]
    found = None if space.element.needs_dof_transformations else compat.integrals_of(form)
    if found is None:
        return None

    marks = [_marked(form, function) for function in functions]
    msh, constants = functions[0].function_space.mesh, compat.constants_of(form)
    corners, points = compat.geometry_dofmap(msh), np.asarray(msh.geometry.x)
    nodes = np.asarray(space.dofmap.map())

    made = []
    for i, (kernel, cells, facet, coefficients) in enumerate(found):
        moving = tuple((places, entries[:, places]) for places, entries in (of[i] for of in marks))
        made.append(
            Integral(
                kernel, nodes[cells], space.dofmap.bs, corners[cells], points, facet, constants, coefficients, moving
            )
        )
    return made


def _marked(form: Any, function: Any) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of each integral the places (k,) among its coefficients that a function moves, and the entries (count, width) there."""
    if function is None:
        none = np.zeros(0, dtype=np.int64)
        return [(none, np.zeros(packed.shape, np.int32)) for *_, packed in compat.integrals_of(form) or ()]
    values = function.x.array.copy()
    told = []
    for mark in (np.zeros(len(values)), 1.0 + np.arange(len(values))):
        function.x.array[:] = mark
        told.append([packed for *_, packed in compat.integrals_of(form) or ()])
    function.x.array[:] = values
    return [
        (np.flatnonzero((after != before).any(axis=0)), (after - 1.0).astype(np.int32))
        for before, after in zip(*told, strict=True)
    ]
