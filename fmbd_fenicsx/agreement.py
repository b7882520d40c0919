"""One answer on all ranks from functions of the user's own, and a clear end where one rank leaves the others.

Every rank keeps its own copy of the frames and joints of a scene, and calls the user's laws, motions and loads in time with equal
arguments. A function that depends on the rank, on random numbers or on the clock would make these copies part without a word.
While a run is under way values are therefore compared: those that differ are refused, roundoff is that of the first rank.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from .errors import AGREEMENTS, InputError
from .leaving import all_leave, end_all
from .ranks import together

SAME = 1e-9  # relative difference between ranks that counts as roundoff of different machines
ABSENT = "absent"


class OneAnswer:
    """Context in which functions of the user's own give the same on all ranks of ``comm`` (None: one); collective."""

    def __init__(self, comm: Any) -> None:
        self.comm: Any = comm if comm is not None and comm.size > 1 else None

    def __enter__(self) -> OneAnswer:
        if self.comm is not None:
            AGREEMENTS.append(self.agree)
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if self.comm is None:
            return
        AGREEMENTS.pop()
        if error is not None:
            self._leave(error)

    @staticmethod
    def _leave(error: BaseException) -> None:
        """End all ranks where this one leaves a run alone: what it would free now, it would have to free with the others."""
        if getattr(error, "common", False) or all_leave():
            return
        if isinstance(error, SystemExit):
            print(
                "fmbd_fenicsx: a rank left a run by sys.exit while others go on: all end.", file=sys.stderr, flush=True
            )
            end_all(error.code)
        sys.excepthook(type(error), error, error.__traceback__)
        end_all(1)

    def agree(self, what: str, evaluate: Callable[[], Any]) -> Any:
        """The value of a function, that of the first rank; collective.

        Raises:
            InputError: the values differ. The error of the lowest rank where one of them fails.
        """
        value, error = None, None
        try:
            value = evaluate()
        except Exception as found:  # told to all ranks
            error = found
        try:
            values = together(self.comm, error, value)
        except Exception as common:
            raise common from (error and error.__cause__)

        for rank, other in enumerate(values):
            if differ(values[0], other):
                raise InputError(
                    f"{what} gives {values[0]!r:.60} on rank 0 and {other!r:.60} on rank {rank} for the same arguments. It may "
                    "not depend on the rank, on random numbers without a fixed seed, or on the clock."
                )
        return values[0]


def refuse_differing(comm: Any, what: str, values: Mapping[str, Any]) -> None:
    """Refuse values by names, numbers, arrays or texts, that are not the same on all ranks; collective.

    Raises:
        InputError: with the first that differs, on the lowest rank where it does.
    """
    first: Mapping[str, Any] = comm.bcast(values)
    apart = [name for name in (*first, *values) if differ(first.get(name, ABSENT), values.get(name, ABSENT))]
    error = None
    if apart:
        here, there = (x.get(apart[0], ABSENT) for x in (values, first))
        error = InputError(
            f"{what}: {apart[0]} is {there} on rank 0 and {here} on rank {comm.rank}. Ranks that work on one scene must be "
            "given the same: nothing may depend on the rank, on random numbers without a fixed seed, or on the clock."
        )
    together(comm, error)


def differ(one: Any, other: Any) -> bool:
    """Whether two values are apart by more than roundoff."""
    if isinstance(one, str) or isinstance(other, str):
        return type(one) is not type(other) or one != other
    if isinstance(one, tuple | list) and isinstance(other, tuple | list):
        return len(one) != len(other) or any(differ(a, b) for a, b in zip(one, other, strict=True))
    try:
        a = np.asarray(one, dtype=complex)
        b = np.asarray(other, dtype=complex)
    except (TypeError, ValueError, OverflowError):
        return type(one) is not type(other)

    # numbers that are not finite must agree as they are
    if a.shape != b.shape:
        return True
    finite = np.isfinite(a) & np.isfinite(b)
    if not np.array_equal(a[~finite], b[~finite], equal_nan=True):
        return True
    a, b = a[finite], b[finite]

    size = max(float(np.abs(a).max(initial=0.0)), float(np.abs(b).max(initial=0.0)))
    return not bool((np.abs(a - b) <= SAME * size).all())
