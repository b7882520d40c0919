"""Vectors of compiled forms, assembled into room that is kept: making it costs more than the forms of small bodies."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..rotations import Array


class NodalVector:
    """The vector of a compiled linear form."""

    def __init__(self, form: Any) -> None:
        """Collective."""
        from dolfinx import la

        space = form.function_spaces[0].dofmap
        self.form, self._room = form, la.vector(space.index_map, space.index_map_bs)
        self._owned = space.index_map.size_local * space.index_map_bs

    def assembled(self) -> Array:
        """Its entries at the nodes that this rank owns, (n d,), apart from later ones; collective."""
        from dolfinx import fem, la

        room = self._room
        room.array[:] = 0.0
        fem.assemble_vector(room.array, self.form)
        room.scatter_reverse(la.InsertMode.add)
        return np.array(room.array[: self._owned])
