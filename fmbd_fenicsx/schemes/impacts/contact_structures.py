"""The structures of ``driver/contact.c`` and the files around it, field by field in the order of C."""

from __future__ import annotations

import ctypes
from typing import Any

from ...rotations import Motions
from ...system.compiled.tables.structures import PYTHON

TOLD = 8  # poses of a moving obstacle that are kept, as in driver/contact.c
POINTER = ctypes.c_void_p
INT = ctypes.c_int
REAL = ctypes.c_double
LONG = ctypes.c_long


def _fields(text: str, kind: Any) -> list[tuple[str, Any]]:
    return [(name, kind) for name in text.split()]


class TouchStructure(ctypes.Structure):
    """The structure Touch of ``driver/contact.c``."""

    _fields_ = _fields("gap x normal relative", POINTER)


class Tally(ctypes.Structure):
    """The structure Tally."""

    _fields_ = [*_fields("solves iterations changes cycles steps newton impacts", LONG), ("residual", REAL)]


class Problem(ctypes.Structure):
    """The structure Problem."""

    _fields_ = [*_fields("m", INT), *_fields("first near slot start behind own W q u f mu", POINTER)]


class Graph(ctypes.Structure):
    """The structure Graph."""

    _fields_ = [
        *_fields("m groups", INT),
        *_fields("gathered arranged group first near slot start behind", POINTER),
        *_fields("head next seen taken member found place order bits", POINTER),
    ]


class Blocks(ctypes.Structure):
    """The structure Blocks."""

    _fields_ = _fields("own size upper lower", POINTER)


class Tree(ctypes.Structure):
    """The structure Tree of ``driver/parts.h``."""

    _fields_ = [*_fields("fronts bodies", INT), *_fields("front body", POINTER)]


def mover_structure(dim: int) -> type[ctypes.Structure]:
    """The structure Mover, in the plane or in space."""
    fields = [("body", INT), ("place", REAL * dim), *_fields("extent reach", REAL)]
    return type("Mover", (ctypes.Structure,), {"_fields_": fields})


class BlockStructure(ctypes.Structure):
    """The structure Block of ``driver/parts.h``."""

    _fields_ = _fields("t q v a A lam own", POINTER)


class Contacts(ctypes.Structure):
    """The structure Contacts."""

    _fields_ = [
        *_fields("pairs points components known room moving", INT),
        ("pair", POINTER),
        *_fields("stops wide", INT),
        *_fields("on of place still", POINTER),
        *_fields("now end aside", TouchStructure),
        *_fields("movers singles", INT),
        *_fields("mover single start partner order lower stood", POINTER),
        ("skin", REAL),
        *_fields("nears candidates", INT),
        *_fields("near listed candidate", POINTER),
        ("here", BlockStructure),
        *_fields("carrying closed bouncing hits held force normal impulse works", POINTER),
        *_fields("energy springs time last", REAL),
        ("loaded", INT),
        *_fields("rows drift rate before rebound", POINTER),
        *_fields("all asked", Problem),
        ("graph", Graph),
        ("blocks", Blocks),
        ("trees", INT),
        *_fields("tree tree_of known_of Y push open turns old least states", POINTER),
        *_fields("ahead xi kept saved was rested path own", POINTER),
        *_fields("size most done total parts", INT),
        ("system", POINTER),
        ("tally", Tally),
        ("python", PYTHON),
    ]


def pair_structure(motions: Motions) -> type[ctypes.Structure]:
    """The structure Pair, in the plane or in space."""
    poses, dim = motions.n_pose, motions.dim

    # in the order of C
    fields = [
        *_fields("shape first count carrier moving", INT),
        *_fields("radius friction restitution thickness", REAL),
        ("data", REAL * 16),
        ("pose", REAL * poses),
        ("told", REAL * (TOLD * poses)),
        ("asked", REAL * TOLD),
        ("oldest", LONG),
        *_fields("modes batch", POINTER),
        ("item", LONG),
        *_fields("mover pushes marked", INT),
        ("mark", REAL * dim),
        ("lever", REAL),
        *_fields("bound side", REAL * 2),
    ]

    return type("Pair", (ctypes.Structure,), {"_fields_": fields})
