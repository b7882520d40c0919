"""Checkpoints: the complete state of a run in a folder, and how it is taken up again.

A checkpoint holds the state, the scheme's memory (:mod:`fmbd_fenicsx.system.serialisation`), the series recorded so
far, and what tells
whether a scene is the same (:mod:`.fingerprint`). In serial runs with direct solvers the run goes on bit by bit as if nothing
had happened. Fields are kept in the order of the mesh as it was read, so the number of ranks may change; the figures
then agree to roundoff. Files are complete or not there, and checked by their hashes before they are used (:mod:`.archive`).
"""

from __future__ import annotations

import re
import signal
import time as clock
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

from ...checks import check_fields, number, whole
from ...errors import CheckpointError, InputError
from ...log import log
from ...ranks import together, world_rank, world_size
from ...system.serialisation import Memory
from ...system.system import System
from ..stop_requests import StopRequests
from . import archive
from .fingerprint import compare
from .folder_lock import FolderLock
from .progress import RunProgress

STOP = "STOP"  # a file of this name in the folder asks the run to stop
LOOK = 0.5  # s between looks for it
PATIENCE = 2.0  # s that other ranks give the first one to write what they are to read
INTERRUPTED, STOPPED = 130, 75  # exit codes after Ctrl-C, and of a run that was asked to stop and can be taken up again
GO_ON, WRITE, WRITE_AND_STOP = 0, 1, 2

Loaded = tuple[dict[str, Any], dict[str, str], Path]


@dataclass(frozen=True)
class Checkpoint:
    """Where and how often checkpoints are written, and how many are kept.

    Args:
        folder: of this run alone; made when it does not exist.
        every: steps from one to the next; None: by the clock only.
        seconds: of wall-clock time after which one is written in any case.
        keep: how many of the newest are kept.

    One is written at the start and at the end of the run too, but none behind an event that ended it: a restart meets the
    event again. SIGUSR1, SIGTERM, or a file named STOP in the folder let the run
    finish its step, write a checkpoint and end (exit code 75); so does Ctrl-C in a serial run (exit code 130).
    """

    folder: str | Path
    every: int | None = None
    seconds: float = 600.0
    keep: int = 2

    def __post_init__(self) -> None:
        check_fields(self)
        if self.every is not None:
            whole("Checkpoint: every =", self.every, least=1)
        number("Checkpoint: seconds =", self.seconds, above=0.0)
        whole("Checkpoint: keep =", self.keep, least=1)

    @property
    def newest(self) -> Path | None:
        """The newest checkpoint in the folder, None where there is none: for ``solve(..., restart=checkpoint.newest)``."""
        found = _numbered(Path(self.folder))
        return found[-1][1] if found else None


def _numbered(folder: Path) -> list[tuple[int, Path]]:
    """Complete checkpoints of a folder with their numbers, oldest first."""
    made = [(re.fullmatch(r"(\d{6,})_step\d+", p.name), p) for p in (folder.iterdir() if folder.is_dir() else ())]
    return sorted((int(match[1]), p) for match, p in made if match)


class Keeper:
    """Takes up and writes the checkpoints of one run, and listens to requests to stop.

    Methods are collective over the ranks of the fields; without fields every rank does the same, and rank 0 writes: the others
    hand on requests to stop by the file STOP, since ranks that do not wait for each other cannot agree on a step. ``given``:
    settings and scene as text, see :mod:`.fingerprint`.
    """

    def __init__(
        self, plan: Checkpoint | None, restart: str | Path | None, system: System, given: dict[str, str]
    ) -> None:
        self.plan, self.restart, self.system, self.given = plan, restart, system, given
        self.comm = system.comm
        self.writes = self.comm.rank == 0 if self.comm is not None and self.comm.size > 1 else world_rank() == 0
        self.written, self.last, self.looked = -1, clock.monotonic(), 0.0
        self.exit_code = INTERRUPTED
        self.newest: Path | None = None
        self.lock: FolderLock | None = None
        if plan is not None:
            self.folder = Path(plan.folder)
            self._together(self._begin)

    def _begin(self) -> None:
        """Refuse a folder that cannot be written or belongs to another run."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except (OSError, ValueError) as error:  # the latter: characters that no file has
            why = getattr(error, "strerror", None) or error
            raise CheckpointError(
                f"The folder {str(self.folder)!a} of the checkpoints cannot be written: {why}. Choose another one."
            ) from error

        # two runs must not write into one folder
        self.lock = FolderLock(self.folder)

        found = _numbered(self.folder)
        self.number = found[-1][0] if found else 0

        if self.restart is None and found:
            self.lock.release()
            raise InputError(
                f"The folder {self.folder} holds checkpoints of an earlier run, the newest is {found[-1][1].name}. Take them up "
                "with restart=..., remove them, or choose another folder."
            )

        for rest in self.folder.iterdir():  # what a killed run left, and nothing else that begins with a dot
            if re.fullmatch(r"\.\d{6,}_step\d+\.(writing|removed)", rest.name):
                archive.discard(rest)

    def close(self) -> None:
        """Leave the folder to others."""
        if self.lock is not None:
            if not self.shared and world_size() > 1:
                self._unlink_stop()  # another rank may have asked after the last look
            self.lock.release()

    def _unlink_stop(self) -> None:
        with suppress(OSError):
            (self.folder / STOP).unlink(missing_ok=True)

    @property
    def shared(self) -> bool:
        """Whether several ranks make this run together."""
        return self.comm is not None and self.comm.size > 1

    def _together(self, action: Callable[[], Any]) -> Any:
        """What the writing process does, its error raised on all ranks."""
        error, out = None, None
        if self.writes:
            try:
                out = action()
            except (CheckpointError, InputError) as found:
                error = found
        together(self.comm, error)
        return out

    def resume(self, progress: RunProgress) -> None:
        """Take up the checkpoint that was asked for, or write one of the start: what cannot be kept shows at once.

        Raises:
            CheckpointError: there is none, it is damaged or belongs to another run; or none can be written.
        """
        if self.restart is None:
            self.write(progress)
            return
        try:
            values, known, self.newest = self._load(Path(self.restart))
        except CheckpointError:
            if self.writes or self.shared or self.plan is None:
                raise
            return  # rank 0 goes on meanwhile and has removed it, or has reported the damage: the same run from its start
        compare(known, self.given, self.newest)
        self._take_up(progress, values)
        self.written = progress.done
        log.info("restarted from %s", self.newest)

    def _take_up(self, progress: RunProgress, values: dict[str, Any]) -> None:
        """Put the values of a checkpoint back; what does not fit is one error on all ranks."""
        error: CheckpointError | None = None
        try:
            progress.remember(Memory(self.system, values), self.newest)
        except CheckpointError as found:
            error = found
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as found:
            error = CheckpointError(
                f"The checkpoint {self.newest} does not hold what this run needs ({type(found).__name__}: {found}). It was "
                "written by another version or changed since; take an earlier one."
            )
        together(self.comm, error)

    def _load(self, path: Path) -> Loaded:
        """Read on rank 0, equal on all ranks."""
        error, found = None, None
        if self.comm is None or self.comm.rank == 0:
            try:
                found = _load(path)
            except CheckpointError as exc:
                error = exc
        together(self.comm, error)
        if self.comm is not None and self.comm.size > 1:
            found = self.comm.bcast(found)
        assert found is not None
        return found

    def listen(self) -> StopRequests:
        """Context in which requests to stop are noticed."""
        return StopRequests(() if self.plan is None else (signal.SIGUSR1, signal.SIGTERM))

    def after_step(self, progress: RunProgress, stop: StopRequests) -> bool:
        """Write when it is time; True when the run is to stop."""
        verdict = WRITE_AND_STOP if stop.asked else GO_ON
        if self.plan is None:
            return stop.asked

        # the ranks that write look at clock and folder; others pass a request on by a file
        if self.writes:
            verdict = max(verdict, self._due(progress.done, self.plan))
        elif stop.asked and not self.shared:
            stop.asked = False
            with suppress(OSError):
                (self.folder / STOP).touch()
            return False

        # all ranks write, or none
        if self.shared:
            assert self.comm is not None
            verdict = max(self.comm.allgather(verdict))
        if verdict == GO_ON:
            return False

        self.write(progress)
        if verdict == WRITE_AND_STOP:
            self.exit_code = INTERRUPTED if stop.by == signal.SIGINT else STOPPED
            if self.writes:
                self._unlink_stop()
        return verdict == WRITE_AND_STOP

    def steps_left(self, done: int) -> float:
        """Steps behind so many up to one after which it has to be asked, by :meth:`after_step`; infinite: by the clock."""
        if self.shared:  # the ranks agree after each
            return 1
        every = None if self.plan is None else self.plan.every
        return inf if every is None else every - done % every

    def _due(self, done: int, plan: Checkpoint) -> int:
        now = clock.monotonic()
        if now - self.looked > LOOK:
            self.looked = now
            if (self.folder / STOP).exists():
                return WRITE_AND_STOP
        return WRITE if (plan.every and done % plan.every == 0) or now - self.last > plan.seconds else GO_ON

    def write(self, progress: RunProgress) -> None:
        """Write a checkpoint, unless there is one already, and remove the oldest."""
        done = progress.done
        if self.plan is None or done == self.written:
            return
        m = Memory(self.system)
        progress.remember(m)
        keep = self.plan.keep
        self._together(lambda: self._store(done, m.values, keep))
        self.written, self.last = done, clock.monotonic()

    def _store(self, done: int, values: dict[str, Any], keep: int) -> None:
        self.number += 1
        path = self.folder / f"{self.number:06d}_step{done}"
        archive.write(path, values, {"step": done, "ranks": world_size(), "given": self.given})
        self.newest = path
        for _, old in _numbered(self.folder)[:-keep]:
            archive.remove(old)
        log.info("checkpoint %s written", path)


def _awaited(folder: Path) -> list[tuple[int, Path]]:
    """Checkpoints of a folder, the newest last. Ranks of a run without fields do not wait for each other, so that one may look
    for what the first rank is about to write.
    """
    end = clock.monotonic() + (PATIENCE if world_rank() else 0.0)
    while not (found := _numbered(folder)) and clock.monotonic() < end:
        clock.sleep(0.02)
    return found


def _load(path: Path) -> Loaded:
    """Values, what was given, and place of a checkpoint, or of the newest in a folder."""
    if not (path / archive.SUMS).exists():
        inside = _awaited(path)
        if not inside:
            raise CheckpointError(f"There is no checkpoint in {path} (looked in {Path.cwd()}).")
        path = inside[-1][1]
    values, header = archive.read(path)
    if not isinstance(values, dict) or not isinstance(header.get("given"), dict):
        raise CheckpointError(f"{path} is no checkpoint of a run: its contents are of another kind.")
    return values, header["given"], path
