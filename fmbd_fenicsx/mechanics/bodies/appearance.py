"""What a rigid body may be drawn as; loaded by bodies that say it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...errors import InputError, require
from ...fem.mesh.mesh import Mesh
from ..shapes import Shape


def check_shape(name: str, shape: Any) -> None:
    """Refuse what cannot be drawn, where the body is made.

    Raises:
        InputError: neither a shape, a mesh nor an STL file; or a file that is not there.
    """
    for part in shape if isinstance(shape, list | tuple) else [shape]:
        if isinstance(part, Shape | Mesh):
            continue
        require(
            isinstance(part, str | Path),
            f'Body "{name}": shape {part!r} is neither a shape such as fmbd.contacts.Box, a mesh, nor the name of an STL file.',
        )
        file = Path(part)
        if file.suffix.lower() != ".stl":
            raise InputError(
                f'Body "{name}": shape "{part}" is no STL file. Other formats: fmbd.read_gmsh("part.geo"), or convert to STL.'
            )
        require(file.is_file(), f'Body "{name}": shape "{part}": there is no such file.')
