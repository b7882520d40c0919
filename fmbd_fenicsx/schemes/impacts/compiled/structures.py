"""The structures of ``driver/contact/contact.c`` and the files around it."""

from __future__ import annotations

import ctypes

from ....system.compiled.declarations import structure_of

SOURCE, PARTS = "contact/contact.c", "parts.h"

Touch, Tally, Problem, Graph, Blocks = (
    structure_of(SOURCE, name) for name in ("Touch", "Tally", "Problem", "Graph", "Blocks")
)
# arrays of a Problem with a number for each component of each contact
BY_COMPONENT = "q", "u", "f", "held", "opened", "change"
Lumped = structure_of(SOURCE, "Lumped", Problem=Problem, Blocks=Blocks)
Tree, Block = (structure_of(PARTS, name) for name in ("Tree", "Block"))
Contacts = structure_of(
    SOURCE, "Contacts", Touch=Touch, Block=Block, Problem=Problem, Graph=Graph, Blocks=Blocks, Tally=Tally
)
BOOKS = "contact/elastic_books.c"
NODES, ELASTIC_CONTACT = (structure_of(BOOKS, name) for name in ("Nodes", "ElasticContact"))
MEANS, _SHAPES = (structure_of("contact/facets.c", name) for name in ("Means", "Shapes"))
_FACETS = structure_of("contact/facets.c", "Facets", Shapes=_SHAPES)
MEETING = structure_of("contact/facets.c", "Meeting", Shapes=_SHAPES, Facets=_FACETS)


def structure(name: str, dim: int) -> type[ctypes.Structure]:
    """The structures ``Mover`` and ``Pair``, in the plane or in space."""
    return structure_of(SOURCE, name, dim)
