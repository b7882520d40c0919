"""Shared libraries built from C once and kept: only what this user has built is ever loaded.

A library runs with the rights of whoever loads it. So a kept one is taken only from a folder and a file that belong to this
user and that no one else may write, and only when its SHA-256 is the one noted when it was built. The notes lie in another
folder than the libraries (XDG_STATE_HOME): one who can change the first need not be able to change the second. Where the folder
cannot be trusted, libraries are built anew for this process alone. Without a compiler all runs in NumPy.
"""

from __future__ import annotations

import atexit
import ctypes
import hashlib
import os
import shutil
import stat
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

from .log import log, note

FLAGS = ("-O3", "-ffp-contract=off", "-shared", "-fPIC", "-std=c99")
PATIENCE = 120.0  # s that a compiler may take
PRIVATE = 0o700
OTHERS = stat.S_IWGRP | stat.S_IWOTH


def cache_folder() -> Path:
    """Where libraries are kept: XDG_CACHE_HOME/fmbd_fenicsx, by default in ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fmbd_fenicsx"


def notes_folder(libraries: Path) -> Path:
    """Where their hashes are noted: XDG_STATE_HOME/fmbd_fenicsx, by default in ~/.local/state; one folder for each cache."""
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    return state / "fmbd_fenicsx" / hashlib.sha256(os.fsencode(libraries.resolve())).hexdigest()[:16]


def compiler() -> list[str] | None:
    """The command of the C compiler, the variable CC or ``cc``; None where there is none."""
    command = (os.environ.get("CC") or "cc").split() or ["cc"]
    return command if shutil.which(command[0]) else None


def load(
    name: str,
    source: str | bytes | Callable[[], str],
    *,
    flags: tuple[str, ...] = FLAGS,
    made_from: bytes = b"",
) -> ctypes.CDLL | None:
    """The library of a C source, built when it is not kept yet; None, with a line in the log, where it cannot be had.

    Not collective: each process asks for itself, and several may build the same one at a time.

    Args:
        name: the first part of the file's name, for people.
        source: the text of one translation unit; it is linked with the mathematical library. A function that generates it is
            called only when the library has to be built.
        flags: of the compiler.
        made_from: what a generated source follows from; stands for the text in the library's key.
    """
    command = compiler()
    if command is None:
        log.info("no C compiler: kernel %s runs in NumPy", name)
        return None

    known = made_from if callable(source) else _bytes(source)
    key = hashlib.sha256(known + repr((command, flags)).encode()).hexdigest()[:20]

    try:
        folder, notes = _folders()
        file = folder / f"{name}_{key}.so"
        if not _as_noted(file, notes):
            note(f"compiling {name}, once (some seconds); it is kept in {folder}")
            text = source() if callable(source) else source
            _build(file, notes, _bytes(text), [*command, *flags])
        return ctypes.CDLL(str(file))
    except (OSError, subprocess.SubprocessError) as error:
        log.info("the compiled kernel %s is not available (%s): it runs in NumPy", name, error)
        return None


def _bytes(text: str | bytes) -> bytes:
    return text.encode() if isinstance(text, str) else text


def trusted(path: Path) -> bool:
    """Whether a folder or file belongs to this user and can be changed by no one else; links must not lead elsewhere."""
    try:
        found = path.lstat()
    except OSError:
        return False
    return found.st_uid == os.geteuid() and not stat.S_ISLNK(found.st_mode) and not found.st_mode & OTHERS


def _folders() -> tuple[Path, Path]:
    """Folders of the libraries and of their hashes, made and closed to others; private ones where those cannot be trusted."""
    folder = cache_folder()
    notes = notes_folder(folder)

    if all(_made_private(path) for path in (folder, notes)):
        return folder.resolve(), notes
    log.info(
        "the cache %s is not this user's own, or others may change it: kernels are built for this run alone", folder
    )
    own = _of_this_process()
    return own / "kernels", own / "notes"


def _made_private(path: Path) -> bool:
    """Make a folder, or close an own one to others; False where it is not this user's or lies where others can replace it."""
    try:
        path.mkdir(mode=PRIVATE, parents=True, exist_ok=True)
        path = path.resolve()
        if path.stat().st_uid == os.geteuid():
            path.chmod(PRIVATE)
        return trusted(path) and path.is_dir() and not any(_open_to_all(above) for above in path.parents)
    except OSError:
        return False


def _open_to_all(folder: Path) -> bool:
    """Whether anyone may replace what lies in a folder: writable by all, and not sticky as /tmp is."""
    mode = folder.stat().st_mode
    return bool(mode & stat.S_IWOTH) and not mode & stat.S_ISVTX


@cache
def _of_this_process() -> Path:
    """A folder that only this process uses, removed at its end."""
    folder = Path(tempfile.mkdtemp(prefix="fmbd_kernels_"))  # mode 0700
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for name in ("kernels", "notes"):
        (folder / name).mkdir(mode=PRIVATE)
    return folder


def _as_noted(file: Path, notes: Path) -> bool:
    """Whether a kept library is whole and this user's own."""
    note = notes / f"{file.stem}.sha256"
    if not (trusted(file) and trusted(note)):
        return False
    return note.read_text() == hashlib.sha256(file.read_bytes()).hexdigest()


def _build(file: Path, notes: Path, source: bytes, command: list[str]) -> None:
    """Compile into a folder of its own, note the hash, move into place: a reader finds all of it, or builds for itself."""
    with tempfile.TemporaryDirectory(dir=file.parent) as work:
        text, built = Path(work) / "kernel.c", Path(work) / file.name
        text.write_bytes(source)

        compiling = [*command, "-o", str(built), str(text), "-lm"]
        subprocess.run(compiling, check=True, capture_output=True, timeout=PATIENCE)
        built.chmod(PRIVATE)

        note = notes / f".{file.stem}.{os.getpid()}"
        note.write_text(hashlib.sha256(built.read_bytes()).hexdigest())
        note.chmod(0o600)
        os.replace(built, file)
        os.replace(note, notes / f"{file.stem}.sha256")
