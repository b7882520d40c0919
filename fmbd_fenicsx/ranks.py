"""The ranks of a program: sums over them, and one error on all of them.

An error that one rank finds is raised on all, by :func:`together`, before the next collective call; an error that leaves one rank
alone ends the program (:mod:`.leaving`).
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
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
    """Sum of arrays of numbers, of one shape on all ranks, in the order of ranks: the same bits everywhere; collective."""
    return x if comm.size == 1 else _of_each(comm, x).sum(axis=0)


def rank_sums(comm: Any, arrays: Sequence[Any]) -> list[Any]:
    """:func:`rank_sum` of each of several arrays, in one message; collective."""
    if comm is None or comm.size == 1 or not arrays:
        return list(arrays)
    import numpy as np

    sums = rank_sum(comm, np.concatenate([np.ravel(x) for x in arrays]))
    ends = np.cumsum([x.size for x in arrays])
    return [part.reshape(x.shape) for part, x in zip(np.split(sums, ends[:-1]), arrays, strict=True)]


def rank_max(comm: Any, x: Any) -> Any:
    """Largest entries of arrays of numbers, of one shape on all ranks; not a number where one of them is none; collective."""
    return x if comm.size == 1 else _of_each(comm, x).max(axis=0)


def _of_each(comm: Any, x: Any) -> Any:
    """The arrays of all ranks, (ranks, ...), in one message: pickled ones would go in two, their sizes before them."""
    import numpy as np

    own = np.array(x, dtype=np.result_type(x, float), order="C")
    out = np.empty((comm.size, *own.shape), own.dtype)
    comm.Allgather(own, out)
    return out


def together(comm: Any, error: BaseException | None, value: Any = None) -> list[Any]:
    """Raise on all ranks when one rank has an error, or give the values of all; collective over ``comm`` (None: this process
    alone).

    The error of the lowest failing rank is raised everywhere, so that messages are printed once.
    """
    if comm is None or comm.size == 1:
        if error is not None:
            raise error
        return [value]

    found = comm.allgather((None if error is None else (type(error), str(error)), value))
    for failed, _ in found:
        if failed is not None:
            kind, text = failed
            try:
                common = kind(text)
            except TypeError:
                common = RuntimeError(text)
            common.common = True
            raise common
    return [given for _, given in found]


def on_root(comm: Any, action: Callable[[], Any]) -> None:
    """Do something on rank 0 alone, its error raised on all ranks; collective over ``comm`` (None: this process alone)."""
    error: Exception | None = None
    if comm is None or comm.rank == 0:
        try:
            action()
        except Exception as found:  # told to all ranks
            error = found
    together(comm, error)
