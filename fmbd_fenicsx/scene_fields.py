"""Initial displacement fields as a scene gives them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .errors import CallbackError
from .rotations import Array


def initial_field(body: Any, function: Callable[[Array], Array] | None, field_: Any, what: str) -> Array:
    """Nodal values of an initial field given as a function of world coordinates (d, n) -> (d, n)."""
    if function is None:
        return np.zeros(field_.n * field_.dim)
    found = np.asarray(function(field_.X_world.T), dtype=float)
    if found.shape != (field_.dim, field_.n):
        raise CallbackError(
            f'Body "{body.name}": {what} returned shape {found.shape}, expected ({field_.dim}, {field_.n}).'
        )
    if not np.isfinite(found).all():
        raise CallbackError(f'Body "{body.name}": {what} returned values that are not finite.')
    return found.T.ravel().copy()
