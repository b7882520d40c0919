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
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from .log import log, note

FLAGS = ("-O3", "-ffp-contract=off", "-shared", "-fPIC", "-std=c99")
PATIENCE = 120.0  # s that a compiler may take
PRIVATE = 0o700
OTHERS = stat.S_IWGRP | stat.S_IWOTH
_ONE_BUILDS = threading.Lock()  # threads of a process wait for each other; processes may build the same side by side
_BYTE: Any = ctypes.c_char.from_buffer
_NO_BYTES: Any = (ctypes.c_char * 0).from_buffer


def address_of(x: Any) -> int:
    """Where the numbers of an array are, for C."""
    try:
        return ctypes.addressof(_BYTE(x))  # costs half of x.ctypes, of which a scene would make hundreds
    except (TypeError, ValueError):  # nothing in it, or only to be read
        return int(x.__array_interface__["data"][0])


def addresses_of(given: Sequence[Any]) -> list[int]:
    """The same of several, of which C makes the list where it can."""
    try:
        return list(map(ctypes.addressof, map(_NO_BYTES, given)))
    except TypeError:  # one that is only to be read
        return [address_of(x) for x in given]


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


@dataclass(frozen=True)
class SourceUnit:
    """One C file of a library.

    Attributes:
        name: for people.
        source: its text; a function that generates it is called only when the unit has to be compiled.
        flags: of the compiler.
        made_from: what a generated source follows from; stands for the text in the unit's key.
        shared: whether it is kept by itself, since other libraries have it too.
    """

    name: str
    source: str | bytes | Callable[[], str]
    flags: tuple[str, ...] = FLAGS
    made_from: bytes = b""
    shared: bool = False

    def key(self, command: list[str]) -> str:
        """A name that is the same for the same code and the same compiler."""
        known = self.made_from if callable(self.source) else _bytes(self.source)
        return hashlib.sha256(known + repr((command, self.flags)).encode()).hexdigest()[:20]


@dataclass(frozen=True)
class Library:
    """A shared library of some units, linked with the mathematical library."""

    name: str
    units: Sequence[SourceUnit]

    def file(self, folder: Path, command: list[str]) -> Path:
        """Where it is kept."""
        keys = [unit.key(command) for unit in self.units]
        key = keys[0] if len(keys) == 1 else hashlib.sha256(repr(keys).encode()).hexdigest()[:20]
        return folder / f"{self.name}_{key}.so"


def load(
    name: str, source: str | bytes | Callable[[], str], *, flags: tuple[str, ...] = FLAGS, made_from: bytes = b""
) -> ctypes.CDLL | None:
    """The library of one unit, see :class:`SourceUnit` and :func:`load_library`; ``name``: the first part of the file's name."""
    return load_library(Library(name, [SourceUnit(name, source, flags, made_from)]))


def load_library(library: Library, *, beside: Sequence[Library] = ()) -> ctypes.CDLL | None:
    """A library, built when it is not kept yet; None, with a line on standard error, where it cannot be had.

    Not collective: each process asks for itself, and several may build the same one at a time.

    Args:
        library: what is loaded.
        beside: what will be needed next: built at the same time, on other cores, where this one has to be built.
    """
    command = compiler()
    if command is None:
        note("no C compiler (the variable CC, or cc): all runs in NumPy, which may take a hundred times as long")
        return None

    try:
        folder, notes = _folders()
        file = library.file(folder, command)
        with _ONE_BUILDS:
            if not _as_noted(file, notes):
                _Building(folder, notes, command).make([library, *beside])
        return ctypes.CDLL(str(file))
    except (OSError, subprocess.SubprocessError) as error:
        note(
            f"{library.name} is not compiled ({_reason(error)}): it runs in NumPy, which may take a hundred times as long"
        )
        return None


def _reason(error: Exception) -> str:
    """Why a library cannot be had, in one line: the compiler's first error, where it is that."""
    said = getattr(error, "stderr", None)
    lines = said.decode(errors="replace").strip().splitlines() if said else []
    return next((line for line in lines if "error:" in line), lines[0] if lines else str(error))


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
        # also the folders above: who may rename them can put another in its place
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
    noted = _hash_of(file, notes)
    if not (trusted(file) and trusted(noted)):
        return False
    return noted.read_text() == hashlib.sha256(file.read_bytes()).hexdigest()


@dataclass
class _Building:
    """Libraries that are made: units are compiled side by side, one for each core, and linked."""

    folder: Path
    notes: Path
    command: list[str]
    objects: dict[str, Path] = field(default_factory=dict)  # by keys of units

    def make(self, wanted: Sequence[Library]) -> None:
        """All libraries that are not kept, in a folder of their own at first."""
        from concurrent.futures import ThreadPoolExecutor

        libraries = [x for x in wanted if not _as_noted(x.file(self.folder, self.command), self.notes)]
        with tempfile.TemporaryDirectory(dir=self.folder) as work:
            missing = self._missing(libraries, Path(work))

            if missing:
                names = ", ".join(unit.name for unit in missing)
                note(f"compiling {names}, once (some seconds); it is kept in {self.folder}")
            # the compiler is a process of its own: threads suffice
            with ThreadPoolExecutor(max(cores(), 1)) as pool:
                list(pool.map(self._compile, missing))
            for library in libraries:
                self._link(library, Path(work))

    def _missing(self, libraries: Sequence[Library], work: Path) -> list[SourceUnit]:
        """Units to be compiled."""
        missing = []
        for unit in (unit for library in libraries for unit in library.units):
            key = unit.key(self.command)
            file = (self.folder if unit.shared else work) / f"{unit.name}_{key}.o"
            self.objects[key] = file
            if not (unit.shared and _as_noted(file, self.notes)):
                missing.append(unit)
        return missing

    def _compile(self, unit: SourceUnit) -> None:
        """One unit into its object."""
        file = self.objects[unit.key(self.command)]
        text = unit.source() if callable(unit.source) else unit.source
        with tempfile.TemporaryDirectory(dir=self.folder) as work:
            source, built = Path(work) / "kernel.c", Path(work) / file.name
            source.write_bytes(_bytes(text))
            flags = [flag for flag in unit.flags if flag != "-shared"]
            self._run([*self.command, *flags, "-c", "-o", str(built), str(source)])
            # moved to its place at once, so that nobody reads half a file
            self._keep(built, file, noted=unit.shared)

    def _link(self, library: Library, work: Path) -> None:
        """A library from the objects of its units."""
        file = library.file(self.folder, self.command)
        objects = [str(self.objects[unit.key(self.command)]) for unit in library.units]
        built = work / file.name
        self._run([*self.command, "-shared", "-o", str(built), *objects, "-lm"])
        self._keep(built, file, noted=True)

    def _run(self, command: list[str]) -> None:
        subprocess.run(command, check=True, capture_output=True, timeout=PATIENCE)

    def _keep(self, built: Path, file: Path, *, noted: bool) -> None:
        """Note the hash, move into place: a reader finds all of it, or builds for itself."""
        built.chmod(PRIVATE)
        if not noted:
            os.replace(built, file)
            return
        name = self.notes / f".{file.name}.{os.getpid()}"
        name.write_text(hashlib.sha256(built.read_bytes()).hexdigest())
        name.chmod(0o600)
        os.replace(built, file)
        os.replace(name, _hash_of(file, self.notes))


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _hash_of(file: Path, notes: Path) -> Path:
    """Where the hash of a library or an object is noted."""
    return notes / f"{file.name}.sha256"
