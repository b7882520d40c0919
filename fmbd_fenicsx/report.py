"""A run as text."""

from __future__ import annotations

import resource
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .solve import Run


def run_report(run: Run) -> str:
    return "todo"
