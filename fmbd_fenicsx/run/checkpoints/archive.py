"""Folders of data that are either complete or not there: written under another name, hashed, moved into place.

A tree of dictionaries, lists, tuples, numbers, strings and arrays becomes ``content.json`` (everything but the arrays) and
``arrays.npz``; ``SHA256SUMS`` holds their hashes in the format of ``sha256sum -c``. NumPy and the standard library only, no
pickle. Not collective: one process writes.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import zipfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np

from ...errors import CheckpointError
from ...rotations import Array

FORMAT = 1
SUMS, CONTENT, ARRAYS = "SHA256SUMS", "content.json", "arrays.npz"


def write(folder: Path, tree: Any, header: dict[str, Any]) -> None:
    """Write a tree with a readable ``header`` as ``folder``, at once or not at all.

    Raises:
        CheckpointError: the disk is full, or the folder cannot be written; what was there before is still there.
    """
    temporary = folder.with_name(f".{folder.name}.writing")
    arrays: dict[str, Array] = {}
    content = json.dumps({"format": FORMAT, **header, "tree": pack(tree, arrays)}, indent=1)

    try:
        discard(temporary)
        temporary.mkdir(parents=True)
        with _flushed(temporary / ARRAYS) as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]
        with _flushed(temporary / CONTENT) as file:
            file.write(content.encode())

        sums = "".join(f"{sha256(temporary / name)}  {name}\n" for name in (ARRAYS, CONTENT))
        with _flushed(temporary / SUMS) as file:
            file.write(sums.encode())

        # one rename: there is a whole checkpoint under this name, or none
        _sync(temporary)
        os.rename(temporary, folder)
        _sync(folder.parent)

    except OSError as error:
        discard(temporary)
        raise CheckpointError(
            f"The checkpoint {folder} could not be written: {error.strerror or error}. Make room, or choose another folder; "
            "earlier checkpoints are untouched."
        ) from error


def read(folder: Path) -> tuple[Any, dict[str, Any]]:
    """Tree and header of a folder, after its hashes were checked.

    Raises:
        CheckpointError: a file is missing or is not what was written, or comes from another version of the format.
    """
    try:
        listed = dict(line.split("  ", 1)[::-1] for line in (folder / SUMS).read_text().splitlines())
        if sorted(listed) != [ARRAYS, CONTENT]:
            raise _damaged(folder / SUMS, f"hashes of {ARRAYS} and {CONTENT}", f"{sorted(listed)}")

        for name, expected in listed.items():
            if not (folder / name).is_file():
                raise _damaged(folder / name, "a file", "none")
            if (actual := sha256(folder / name)) != expected:
                raise _damaged(folder / name, f"SHA-256 {expected}", actual)

        header = json.loads((folder / CONTENT).read_bytes())
        if header["format"] != FORMAT:
            raise _damaged(folder / CONTENT, f"format {FORMAT}", f"{header['format']}")

        # opened here: what np.load opens stays open where it is no archive
        with open(folder / ARRAYS, "rb") as file, np.load(file, allow_pickle=False) as arrays:
            if any(entry.compress_type != zipfile.ZIP_STORED for entry in arrays.zip.infolist()):
                # small files that fill the memory
                raise _damaged(folder / ARRAYS, "arrays as they are", "compressed ones")
            return unpack(header.pop("tree"), arrays), header
    except CheckpointError:
        raise
    except Exception as error:
        # whatever a file that was not written here can cause, MemoryError and RecursionError too
        raise _damaged(Path(getattr(error, "filename", None) or folder), "a complete checkpoint", f"{error}") from error


def remove(folder: Path) -> None:
    """Remove a folder, out of sight first: no half of it is ever seen under its name."""
    hidden = folder.with_name(f".{folder.name}.removed")
    discard(hidden)
    try:
        os.rename(folder, hidden)
    except FileNotFoundError:  # somebody else removed it
        return
    except OSError as error:
        raise CheckpointError(f"The old checkpoint {folder} cannot be removed: {error.strerror}.") from error
    discard(hidden)


def discard(folder: Path) -> None:
    """Remove what was never complete."""
    shutil.rmtree(folder, ignore_errors=True)


def sha256(file: Path) -> str:
    """Hash of a file."""
    with open(file, "rb") as f:
        found = hashlib.sha256()
        while part := f.read(1 << 20):
            found.update(part)
        return found.hexdigest()


def _damaged(file: Path, expected: str, actual: str) -> CheckpointError:
    return CheckpointError(
        f"The checkpoint is damaged: {file}: expected {expected}, found {actual}. Nothing was read from it; give "
        "restart=... the folder of an earlier checkpoint."
    )


@contextmanager
def _flushed(path: Path) -> Iterator[IO[bytes]]:
    """A new file that is on the disk when it is closed."""
    with open(path, "xb") as file:
        yield file
        file.flush()
        os.fsync(file.fileno())


def _sync(folder: Path) -> None:
    """Put a folder's list of names on the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def pack(x: Any, arrays: dict[str, Array]) -> Any:
    """JSON for a tree; arrays go to ``arrays`` under numbers. Floats are exact: JSON holds their shortest digits."""
    if x is None or isinstance(x, bool | str) or type(x) in (int, float):
        return x

    if isinstance(x, np.ndarray | np.generic):
        if x.dtype.hasobject:
            raise TypeError(f"an array of objects cannot be kept: {x!r:.80}")
        name = f"a{len(arrays)}"
        arrays[name] = np.asarray(x)
        return {"array" if isinstance(x, np.ndarray) else "number": name}

    if type(x) is complex:
        return {"complex": [x.real, x.imag]}

    # containers say what they were: JSON knows lists and names only
    if isinstance(x, Counter):
        return {"counter": [[k, n] for k, n in x.items()]}
    if isinstance(x, list | tuple):
        return {type(x).__name__: [pack(y, arrays) for y in x]}
    if isinstance(x, dict):
        return {"dict": [[k, pack(y, arrays)] for k, y in x.items()]}

    raise TypeError(f"cannot be kept in a checkpoint: {x!r:.80}")


def unpack(x: Any, arrays: Any) -> Any:
    """The tree of :func:`pack`."""
    if not isinstance(x, dict):
        return x
    ((kind, value),) = x.items()
    if kind in ("array", "number"):
        return arrays[value] if kind == "array" else arrays[value][()]
    if kind == "complex":
        return complex(*value)
    if kind == "counter":
        return Counter(dict(value))
    if kind == "dict":
        return {k: unpack(y, arrays) for k, y in value}
    items = [unpack(y, arrays) for y in value]
    return items if kind == "list" else tuple(items)
