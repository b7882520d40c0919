"""Logger of the package: what it tells a user, once and from one rank.

The library writes to the logger ``fmbd_fenicsx``. Its warnings reach standard error, each once in a run, unless the program sets
up logging of its own (:mod:`fmbd_fenicsx.notices`).
"""

from __future__ import annotations

import logging
from typing import Any

from .notices import OnStandardError, write_note
from .ranks import world_rank, world_size

__all__ = ["log", "note", "say", "world_rank", "world_size"]


def __dir__() -> list[str]:
    """What is public here."""
    return __all__


log = logging.getLogger("fmbd_fenicsx")
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
