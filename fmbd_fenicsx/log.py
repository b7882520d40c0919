"""Logger of the package, and behaviour under MPI: one message, and one failing rank ends all.

The library writes to the logger ``fmbd_fenicsx``. Its warnings reach standard error, each once, unless the program sets up
logging of its own (:mod:`fmbd_fenicsx.notices`).
"""

from __future__ import annotations

import atexit
import logging
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, NoReturn

from .errors import FmbdError, Stopped
from .notices import OnStandardError, write_note

__all__ = ["log", "note", "say", "world_rank", "world_size"]


def __dir__() -> list[str]:
    """What is public here."""
    return __all__


log = logging.getLogger("fmbd_fenicsx")


PATIENCE = 3.0  # s that a rank which leaves with an error waits for the others to do the same


def world_size() -> int:
    """Number of ranks this process was started with; does not import mpi4py where mpirun was not used."""
    if "mpi4py.MPI" in sys.modules:
        return int(sys.modules["mpi4py.MPI"].COMM_WORLD.size)
    for name in ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE"):
        if name in os.environ:
            return int(os.environ[name])
    return 1


def world_rank() -> int:
    """Rank of this process in COMM_WORLD (0 without mpirun)."""
    if world_size() == 1:
        return 0
    from mpi4py import MPI

    return int(MPI.COMM_WORLD.rank)


log.addHandler(OnStandardError(world_rank))


def say(*values: Any) -> None:
    """Print on rank 0 only, as ``print`` does."""
    if world_rank() == 0:
        print(*values, flush=True)


def note(text: str) -> None:
    """Tell a user what takes time or could take less: on standard error once, from rank 0, and to logging as information."""
    log.info("%s", text)
    if world_rank() == 0:
        write_note(text)


def install_hooks() -> None:
    """Decide what happens when an exception reaches the top of the program (once; a hook set by others is
    left alone).

    The exit code is the error's own: 2 for bad input, 71 where a step fails, 74 for files; 130 or 75 after a request to
    stop, with the report so far. Under mpirun one failing rank ends all ranks, and the message of the lowest one is
    printed; a rank that leaves by ``sys.exit`` with a code other than 0 while others go on ends them too.
    """
    if sys.excepthook is sys.__excepthook__:
        sys.excepthook = _top if world_size() == 1 else _top_of_many
        if world_size() > 1:
            _watch_exits()


def _watch_exits() -> None:
    """Remember the code given to ``sys.exit``; at the end of a process with another code than 0, wait for all ranks to end
    alike, and end them where they do not: a rank that has left would be waited for without end. Ranks that leave a run are
    looked at there, see :mod:`.ranks`.
    """
    codes: list[Any] = []
    leave = sys.exit

    def noting(code: Any = None, /) -> NoReturn:
        codes.append(code)
        leave(code)

    def end() -> None:
        code = codes[-1] if codes else None
        if code not in (None, 0) and "mpi4py.MPI" in sys.modules and not all_leave():
            end_all(code)

    sys.exit = noting
    atexit.register(end)


def all_leave() -> bool:
    """Whether all ranks come here within seconds; nothing else may be asked of a rank that does not."""
    from mpi4py import MPI

    if MPI.Is_finalized() or not MPI.Is_initialized():
        return True
    arrived = MPI.COMM_WORLD.Ibarrier()
    until = time.monotonic() + PATIENCE
    while not arrived.Test():
        if time.monotonic() > until:
            return False
        time.sleep(0.02)
    return True


def end_all(code: Any) -> NoReturn:
    """End the processes of all ranks with an exit code, 1 for one that means success."""
    from mpi4py import MPI

    MPI.COMM_WORLD.Abort(code if isinstance(code, int) and code != 0 else 1)
    raise SystemExit(code)


def _top(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    if isinstance(error, Stopped):
        print(error.run.report(), flush=True)
    else:
        sys.__excepthook__(kind, error, trace)
    if isinstance(error, FmbdError | Stopped):
        sys.stderr.flush()
        raise SystemExit(error.exit_code)


def _top_of_many(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    import time

    if isinstance(error, Stopped):
        say(error.run.report())
        if not all_leave():  # ranks of a run without fields do not wait for each other
            end_all(error.exit_code)
        raise SystemExit(error.exit_code)

    from mpi4py import MPI

    rank = MPI.COMM_WORLD.rank
    if getattr(error, "common", False) and rank > 0:
        time.sleep(30.0)  # rank 0 has the same error: it prints, and ends this rank
    else:
        time.sleep(0.25 * min(rank, 20))  # the lowest failing rank prints first, and ends the others
        sys.stdout.flush()
        sys.__excepthook__(kind, error, trace)
        sys.stderr.flush()
    MPI.COMM_WORLD.Abort(int(getattr(error, "exit_code", 1)))


class StopRequests:
    """Context in which the first Ctrl-C only sets ``asked``, so that the step under way is completed; the
    second interrupts. ``more``: signals that do the same; ``by``: the signal that came.

    Only in the main thread; Ctrl-C only in serial runs, and where Python's own handler is in place or that of the operating
    system, which ``gmsh.initialize()`` puts back.
    """

    def __init__(self, more: tuple[signal.Signals, ...] = ()) -> None:
        self.asked, self.by = False, 0
        self._more = more
        self._before: dict[int, Any] = {}

    def __enter__(self) -> StopRequests:
        if threading.current_thread() is threading.main_thread():
            usual = signal.getsignal(signal.SIGINT) in (signal.default_int_handler, signal.SIG_DFL)
            plain = world_size() == 1 and usual
            for number in (*((signal.SIGINT,) if plain else ()), *self._more):
                self._before[number] = signal.signal(number, self._ask)
        return self

    def _ask(self, number: int, frame: Any) -> None:
        self.asked, self.by = True, number
        if number == signal.SIGINT:
            signal.signal(number, self._before[number])

    def __exit__(self, *exc: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)


def peak_memory(comm: Any) -> float:
    """Peak resident memory of the largest rank, bytes; collective over ``comm`` (None: this process)."""
    own = float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) * (1.0 if sys.platform == "darwin" else 1024.0)
    return own if comm is None else max(comm.allgather(own))


def together(comm: Any, error: BaseException | None) -> None:
    """Raise on all ranks when one rank has an error; collective over ``comm`` (None: this process alone).

    The error of the lowest failing rank is raised everywhere, so that messages are printed once.
    """
    if comm is None or comm.size == 1:
        if error is not None:
            raise error
        return
    errors = comm.allgather(None if error is None else (type(error), str(error)))
    for found in errors:
        if found is not None:
            kind, text = found
            try:
                common = kind(text)
            except TypeError:
                common = RuntimeError(text)
            common.common = True
            raise common


def on_root(comm: Any, action: Callable[[], Any]) -> None:
    """Do something on rank 0 alone, its error raised on all ranks; collective over ``comm`` (None: this process alone)."""
    error: Exception | None = None
    if comm is None or comm.rank == 0:
        try:
            action()
        except Exception as found:  # told to all ranks
            error = found
    together(comm, error)
