"""A run as text."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .solve import Run


def run_report(run: Run) -> str:
    """The report."""
    return f"{run.scene.name}: {run.status} at t = {run.state.t:.6g} s"
