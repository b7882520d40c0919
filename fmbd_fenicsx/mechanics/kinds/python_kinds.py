"""Kinds whose kernels Python tells, by functions with the arguments of compiled ones: compiled steps call them as any other."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ...rotations import Array
from .derivation import KERNELS, Kind
from .frames import FRAME

NEWEST = 16  # times of which answers are kept, and answers of each

KERNEL = ctypes.CFUNCTYPE(None, ctypes.c_long, *[ctypes.c_void_p] * 5)
At = tuple[Any, ...]  # the frames and the constants; last what of these values depend on, some bytes


class Answers:
    """What a function of a user's own said at the newest times."""

    def __init__(self) -> None:
        self.error: Exception | None = None  # of a call by compiled code
        self.known: dict[float, dict[tuple[bytes, ...], Array]] = {}

    def clock(self, t: float) -> tuple[float, float, float]:
        """The time as a motion: who asks for it takes what depends on it anew."""
        self.known.pop(t, None)
        return t, 1.0, 0.0

    def once(self, t: float, key: tuple[bytes, ...], find: Callable[[], Array]) -> Array:
        """What it finds, once as long as what depends on time t holds: stages of a step come back to each other's configurations,
        and records ask again.
        """
        kept = self.known.get(t)
        if kept is None:
            kept = _keep_newest(self.known, t, {})
        return kept[key] if key in kept else _keep_newest(kept, key, find())


@dataclass(frozen=True, eq=False)
class PythonKind(Kind):
    """The kind ``between`` so many frames of one function g (m,); items are its numbers, told apart by their ``component``."""

    function: Answers = None  # type: ignore[assignment]
    between: int = 2
    asked: ClassVar[bool] = True

    def _rows(self, at: At, t: float) -> Array:
        """g and its rows, (m, 1 + entries)."""
        raise NotImplementedError

    def _in_time(self, at: At, t: float) -> Array:
        """Whether the function depends on time, and g_t, (1 + m,)."""
        raise NotImplementedError

    def _second(self, at: At, t: float, moves: bool) -> Array:
        """g'' at constant twists of the frames, (m,)."""
        raise NotImplementedError

    def address(self, which: str) -> int:
        """Where compiled code finds the kernel."""
        return int(ctypes.cast(self._callbacks[which], ctypes.c_void_p).value or 0)

    @cached_property
    def _callbacks(self) -> dict[str, Any]:
        return {which: KERNEL(self._told(which)) for which in KERNELS}

    def _told(self, which: str) -> Callable[..., None]:
        """The kernel as compiled code calls it; errors are kept for whoever called C, which goes on without numbers."""
        views: dict[tuple[Any, ...], tuple[list[Array], list[Array], Array, list[Any]]] = {}
        known, drive = self.function.known, self.place("drive").start
        size = FRAME[self.dim]
        moves = self.dim + self.dim**2 if which == "value" else size  # what of a frame is seen

        def told(n: int, on: int, frames: int, P: int, W: int, out: int) -> None:
            found = views.get((n, on, frames, P, out))
            if found is None:
                sides = (ctypes.c_int * self.between).from_address(on)
                items = [*[_view(frames + 8 * size * side, 1, size) for side in sides], _view(P, n, self.width)]
                seen = [*[x[0, :moves] for x in items[:-1]], items[-1]]
                found = items, seen, _view(out, n, len(self.outputs[which])), [None]
                if len(views) > 16:
                    views.clear()
                views[n, on, frames, P, out] = found
            if which == "tangent":
                return
            items, seen, answer, newest = found
            # the same is asked several times in a row
            key, t = [not W, *[x.tobytes() for x in seen]], float(items[-1][0, drive])
            if key == newest[0] and known.get(t) is newest[1]:
                answer[:] = newest[2]
                return
            try:
                answer[:] = self._found(which, items, whole=not W)
                newest[:] = key, known.get(t), answer.copy()  # none, where nothing was asked
            except Exception as error:
                self.function.error = self.function.error or error
                answer[:] = np.nan

        return told

    @cached_property
    def _component_and_drive(self) -> tuple[int, int]:
        """Where the constants have these."""
        return self.place("component").start, self.place("drive").start

    def _found(self, which: str, items: Sequence[Array], *, whole: bool = True) -> Array:
        """Values or rates of items, by their frames and constants; of the rates the first alone where not ``whole``."""
        component, drive = self._component_and_drive
        still = self.dim + self.dim**2  # where velocities begin in a frame
        *frames, p = [x[0] for x in items]
        at, t = (*frames, p, (*[f[:still].tobytes() for f in frames], p.tobytes())), float(p[drive])
        return (self._value(at, t) if which == "value" else self._rates(at, t, whole))[
            items[-1][:, component].astype(int)
        ]

    def _value(self, at: At, t: float) -> Array:
        """:meth:`_rows`, found once."""
        return self.function.once(t, (b"value", *at[-1]), lambda: self._rows(at, t))

    def _rates(self, at: At, t: float, whole: bool) -> Array:
        """g_t, and g'' at constant twists of the frames, 0 where not ``whole``, (m, 2)."""
        ask, *frames = self.function.once, *at[:-2]
        moves, *in_time = ask(t, (b"time", *at[-1]), lambda: self._in_time(at, t))
        found = np.zeros((len(in_time), 2))
        found[:, 0] = in_time
        if whole:
            motion = (*[f.tobytes() for f in frames], *at[-1])
            found[:, 1] = ask(t, motion, lambda: self._second(at, t, bool(moves)))
        return found


def _keep_newest(kept: dict[Any, Any], key: Any, value: Any) -> Any:
    """Keep a value with so many others."""
    kept[key] = value
    if len(kept) > NEWEST:
        del kept[next(iter(kept))]
    return value


def _view(address: int, n: int, width: int) -> Array:
    """Numbers in memory as an array."""
    return np.ctypeslib.as_array((ctypes.c_double * (n * width)).from_address(address)).reshape(n, width)
