"""Initial displacement fields as a scene gives them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import CallbackError
from ..rotations import Array
from ..traces.field_checks import check_start


def initial_fields(body: Any, field_: Any) -> tuple[Array, Array]:
    """Nodal displacements and their rates at the start, (n d,) each; collective.

    Raises:
        CallbackError: a function returned the wrong shape or values that are not finite.
        InputError: the elastic energy has no value there.
    """
    U = initial_field(body, body.displacement, field_, "displacement")
    Ud = initial_field(body, body.displacement_rate, field_, "displacement_rate")
    if field_.nonlinear:
        check_start(field_, U)
    return U, Ud


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
