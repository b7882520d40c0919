"""Files of results: whole, or what was there before."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from ...errors import InputError


def write_whole(what: str, file: str | Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` make a file in a folder beside, and move it to its place: a disk that is full costs nothing that was there.

    What is no regular file, say a pipe, is written to directly. ``what``: what it holds, in messages.

    Raises:
        InputError: no such folder, no right to write there, no room.
    """
    place = Path(os.path.realpath(file))
    try:
        if place.exists() and not place.is_file():
            write(place)
            return
        with TemporaryDirectory(dir=place.parent, prefix=".writing_") as beside:
            write(Path(beside) / place.name)
            for made in Path(beside).iterdir():  # one, with the ending that its writer may have added
                os.replace(made, place.with_name(made.name))
    except OSError as error:
        raise InputError(f'{what} cannot be written to "{file}": {error.strerror or error}.') from error
