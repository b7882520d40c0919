"""A bar that shows how far a run is."""

from __future__ import annotations

import sys
from typing import Any

from ...ranks import world_rank


class Progress:
    """A bar with the time left, on rank 0 of a terminal (needs tqdm; nothing without it)."""

    def __init__(self, name: str, steps: int | None, wanted: bool | None) -> None:
        self.bar: Any = None
        show = sys.stderr.isatty() or "ipykernel" in sys.modules if wanted is None else wanted
        if not show or world_rank() != 0:
            return
        try:
            from tqdm.auto import tqdm  # a bar of text in a terminal, a widget in a notebook
        except ImportError:
            return
        self.bar = tqdm(total=steps, desc=name, unit="step", file=sys.stderr, mininterval=0.2)

    def update(self, steps: int = 1) -> None:
        """So many steps done."""
        if self.bar is not None:
            self.bar.update(steps)

    def close(self) -> None:
        """Leave the bar as it stands."""
        if self.bar is not None:
            self.bar.close()
