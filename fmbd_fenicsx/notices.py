"""Warnings where a user sees them: on standard error, each once in a run, and in the report of the run that gave them.

The package speaks through the logger ``fmbd_fenicsx``. A program that sets up logging (a handler on that logger or on the root)
gets the warnings there, and only there. In a program that does not, :class:`OnStandardError` writes them: a warning that nobody
sees is none.
"""

from __future__ import annotations

import logging
import re
import sys
import textwrap
from collections.abc import Callable
from typing import ClassVar

ALIKE = 3  # warnings of one kind that are written in full
WIDTH = 112
EVERYONES, OURS = logging.getLogger(), logging.getLogger("fmbd_fenicsx")


class Runs:
    """The runs and analyses of this process: each is told its warnings anew, those within another one with that."""

    begun: ClassVar[int] = 0
    within: ClassVar[bool] = False  # one that is under way


class OnStandardError(logging.Handler):
    """Writes warnings of a run once each on rank 0, of one kind (other times or names in the same sentence) the first three."""

    def __init__(self, rank: Callable[[], int]) -> None:
        super().__init__(logging.WARNING)
        self._rank = rank
        self._run = Runs.begun
        self._said: set[str] = set()
        self._kinds: dict[str, int] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Write a warning, unless the program has handlers of its own."""
        text, kind = record.getMessage(), _kind(record)
        if self._run != Runs.begun:
            self._run = Runs.begun
            self._said.clear()
            self._kinds.clear()
        if _set_up_by_program() or text in self._said or self._rank() > 0:
            return
        self._said.add(text)
        self._kinds[kind] = self._kinds.get(kind, 0) + 1
        if self._kinds[kind] > ALIKE:
            return

        more = " (More of this kind stand in the report only.)" if self._kinds[kind] == ALIKE else ""
        print(
            textwrap.fill(f"fmbd_fenicsx: {text}{more}", WIDTH, subsequent_indent="    "), file=sys.stderr, flush=True
        )


_noted: set[str] = set()


def write_note(text: str) -> None:
    """A line on standard error that is no warning, once in a process; a program with logging of its own gets none."""
    if _set_up_by_program() or text in _noted:
        return
    _noted.add(text)
    print(textwrap.fill(f"fmbd_fenicsx: {text}", WIDTH, subsequent_indent="    "), file=sys.stderr, flush=True)


def _kind(record: logging.LogRecord) -> str:
    """The sentence of a warning without its names and numbers."""
    told = record.getMessage() if record.msg == "%s" else str(record.msg)
    return re.sub(r'"[^"]*"|[-+]?\d[\w.+-]*', "", told)


def _set_up_by_program() -> bool:
    """Whether someone else listens."""
    ours = (OnStandardError, Gathered, logging.NullHandler)
    handlers = [*EVERYONES.handlers, *OURS.handlers]
    return any(not isinstance(handler, ours) for handler in handlers)


class Gathered(logging.Handler):
    """Context that keeps the warnings given in it: ``found`` is a list of (kind, text)."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.found: list[tuple[str, str]] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a warning."""
        entry = (_kind(record), record.getMessage())
        if entry not in self.found:
            self.found.append(entry)

    def lines(self) -> list[str]:
        """The warnings as sentences: of each kind the first three, and how many more there were."""
        kinds: dict[str, list[str]] = {}
        for kind, text in self.found:
            kinds.setdefault(kind, []).append(text)

        out: list[str] = []
        for texts in kinds.values():
            out += texts[:ALIKE]
            if len(texts) > ALIKE:
                out[-1] += f" (And {len(texts) - ALIKE} more of this kind.)"
        return out

    def __enter__(self) -> Gathered:
        OURS.addHandler(self)
        return self

    def __exit__(self, *error: object) -> None:
        OURS.removeHandler(self)


class Withheld:
    """Context in which those who listened before hear no warnings: of attempts only those of the best one are said, later."""

    def __enter__(self) -> None:
        self._handlers = [*EVERYONES.handlers, *OURS.handlers]
        for handler in self._handlers:
            handler.addFilter(self._passes)

    def __exit__(self, *error: object) -> None:
        for handler in self._handlers:
            handler.removeFilter(self._passes)

    def _passes(self, record: logging.LogRecord) -> bool:
        """Whether it is of another package, or none."""
        return record.levelno != logging.WARNING or record.name != OURS.name
