"""Ctrl-C, and signals of a queue, as requests to end a run behind the step under way."""

from __future__ import annotations

import signal
import threading
from typing import Any

from ..ranks import world_size


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
