"""A run to look at: in a notebook, or in the web browser of this machine."""

from __future__ import annotations

import html
import os
import sys
import tempfile
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..ranks import on_root
from ..run.result import Run
from .animation import make_story
from .drawing.view import Paint, View


@dataclass(frozen=True, repr=False)
class Shown:
    """A page that a notebook shows as the last expression of a cell."""

    page: str

    def _repr_html_(self) -> str:
        style = "width: 100%; height: 520px; border: 0"
        return f'<iframe srcdoc="{html.escape(self.page)}" style="{style}"></iframe>'

    def __repr__(self) -> str:
        return f"<animation, {len(self.page) // 1000} kB>"


def show(run: Run, *, sensors: Sequence[str] | str = (), view: View | None = None, paint: Paint | None = None) -> Any:
    """See :meth:`fmbd_fenicsx.Run.show`; collective."""
    story = make_story(run, sensors, view or View(), paint, None)
    if "ipykernel" in sys.modules:
        from .webpage import page

        return Shown(page(story))

    # what says that there is a screen; macOS has always one
    if not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")) and sys.platform != "darwin":
        raise InputError('There is no screen here. run.animate("run.html") writes a page that any browser shows.')

    def open_page() -> None:
        from .webpage import page

        file = Path(tempfile.mkdtemp(prefix="fmbd_")) / "run.html"
        file.write_text(page(story), encoding="utf-8")
        webbrowser.open(file.as_uri())

    on_root(run.system.comm, open_page)
    return None
