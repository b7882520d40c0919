"""Rows that hold between velocities only and have no g: rolling, skates."""

from __future__ import annotations

import numpy as np

from ..rotations import Array
from .evaluation import Evaluation
from .layout import Layout


def speed_rows(system: Layout) -> np.ndarray:
    """Numbers of these rows."""
    if "speed rows" not in system.cache:
        found = [rows for batch, rows in system.batches if batch.on_speeds]
        system.cache["speed rows"] = np.concatenate([np.zeros(0, dtype=int), *found])
    return np.asarray(system.cache["speed rows"])


def gaps(ev: Evaluation, share: float) -> Array:
    """What an iteration on increments of q has to close, (n_lam,): g, and for rows on velocities their speed times ``share`` (s),
    the change of q over that of v.
    """
    if not ev.system.n_lam:
        return np.zeros(0)
    g = ev.constraint()
    rows = speed_rows(ev.system)
    if rows.size:
        assert ev.v is not None
        g[rows] = share * ev.opening()[rows]
    return g
