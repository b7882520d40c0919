"""Logger of the package, and behaviour under MPI: one message, and one failing rank ends all.

The library only writes to the logger ``fmbd_fenicsx``; :func:`fmbd_fenicsx.solve` and the demos configure nothing.
"""

from __future__ import annotations

import logging
import os
import sys
from types import TracebackType
from typing import Any

log = logging.getLogger("fmbd_fenicsx")
log.addHandler(logging.NullHandler())


def world_size() -> int:
    """Number of ranks this process was started with; does not import mpi4py where mpirun was not used."""
    if "mpi4py.MPI" in sys.modules:
        return int(sys.modules["mpi4py.MPI"].COMM_WORLD.size)
    for name in ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_SIZE", "SLURM_NTASKS"):
        if name in os.environ and "OMPI_COMM_WORLD_SIZE" in os.environ or name == "PMI_SIZE" and name in os.environ:
            return int(os.environ[name])
    return 1


def world_rank() -> int:
    """Rank of this process in COMM_WORLD (0 without mpirun)."""
    if world_size() == 1:
        return 0
    from mpi4py import MPI

    return int(MPI.COMM_WORLD.rank)


def install_abort_hook() -> None:
    """End all ranks when an exception reaches the top of one of them (once; only under mpirun).

    An error that all ranks raise together is printed by rank 0 only. An error on one rank is printed by that rank.
    The exit code is the error's own.
    """
    if world_size() == 1 or sys.excepthook is not sys.__excepthook__:
        return

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        import time

        from mpi4py import MPI

        common = getattr(error, "common", None)
        if common is None or MPI.COMM_WORLD.rank == 0:
            sys.__excepthook__(kind, error, trace)
            sys.stderr.flush()
        else:
            time.sleep(1.0)  # rank 0 prints before the abort
        MPI.COMM_WORLD.Abort(int(getattr(error, "exit_code", 1)))

    sys.excepthook = hook


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
