"""The structures of ``driver/contact.c`` and the files around it."""

from __future__ import annotations

import ctypes

from ...system.compiled.declarations import fields_of, structure_of

SOURCE, PARTS = "contact.c", "parts.h"


class TouchStructure(ctypes.Structure):
    """The structure Touch."""

    _fields_ = fields_of(SOURCE, "Touch")


class Tally(ctypes.Structure):
    """The structure Tally."""

    _fields_ = fields_of(SOURCE, "Tally")


class Problem(ctypes.Structure):
    """The structure Problem."""

    _fields_ = fields_of(SOURCE, "Problem")


class Graph(ctypes.Structure):
    """The structure Graph."""

    _fields_ = fields_of(SOURCE, "Graph")


class Blocks(ctypes.Structure):
    """The structure Blocks."""

    _fields_ = fields_of(SOURCE, "Blocks")


class Tree(ctypes.Structure):
    """The structure Tree."""

    _fields_ = fields_of(PARTS, "Tree")


class BlockStructure(ctypes.Structure):
    """The structure Block."""

    _fields_ = fields_of(PARTS, "Block")


class Contacts(ctypes.Structure):
    """The structure Contacts."""

    _fields_ = fields_of(
        SOURCE, "Contacts", Touch=TouchStructure, Block=BlockStructure, Problem=Problem, Graph=Graph, Blocks=Blocks, Tally=Tally
    )  # fmt: skip


def structure(name: str, dim: int) -> type[ctypes.Structure]:
    """The structures ``Mover`` and ``Pair``, in the plane or in space."""
    return structure_of(SOURCE, name, dim)
