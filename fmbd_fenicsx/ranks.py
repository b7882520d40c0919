"""The ranks of a program: sums over them, and one error on all of them.

An error that one rank finds is raised on all, by :func:`together`, before the next collective call; an error that leaves one rank
alone ends the program (:mod:`.leaving`).
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import cache
from typing import Any


def world_size() -> int:
    """Number of ranks this process was started with; does not import mpi4py where mpirun was not used."""
    if "mpi4py.MPI" in sys.modules:
        return int(sys.modules["mpi4py.MPI"].COMM_WORLD.size)
    return _launched_with()


@cache
def _launched_with() -> int:
    """What the launcher says of it to this process."""
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


def rank_sum(comm: Any, x: Any) -> Any:
    """Sum of arrays over ranks in the order of ranks: the same bits everywhere; collective."""
    if comm.size == 1:
        return x
    import numpy as np

    return np.sum(comm.allgather(x), axis=0)


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
