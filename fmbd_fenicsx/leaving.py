"""How a program ends: with the exit code of its error, and under MPI on all ranks, with one message."""

from __future__ import annotations

import atexit
import sys
import time
from types import TracebackType
from typing import Any, NoReturn

from .errors import FmbdError, Stopped
from .log import say
from .ranks import world_size

PATIENCE = 3.0  # s that a rank which leaves with an error waits for the others to do the same


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
    looked at there, see :mod:`.agreement`.
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
