"""Initial displacement fields as a scene gives them: functions of the world coordinates of the nodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import CallbackError
from ..ranks import together
from ..rotations import Array
from .field_checks import check_start


def initial_fields(body: Any, field: Any) -> tuple[Array, Array]:
    """Nodal displacements and their rates at the start, (n d,) each; collective.

    Raises:
        CallbackError: a function failed, returned the wrong shape or values that are not finite; on all ranks alike.
        InputError: the elastic energy has no value there.
    """
    U = initial_field(body, body.displacement, field, "displacement")
    Ud = initial_field(body, body.displacement_rate, field, "displacement_rate")
    if field.nonlinear:
        check_start(field, U)
    return U, Ud


def initial_field(body: Any, function: Callable[[Array], Array] | None, field: Any, what: str) -> Array:
    """Nodal values of an initial field given as a function of world coordinates (d, n) -> (d, n); collective."""
    if function is None:
        return np.zeros(field.n * field.dim)
    error: CallbackError | None = None
    values: Array = np.zeros(0)
    try:
        values = _values(body, function, field, what)
    except CallbackError as found:
        error = found
    together(field.comm, error)
    return values


def _values(body: Any, function: Callable[[Array], Array], field: Any, what: str) -> Array:
    """This rank's values."""
    try:
        found = np.asarray(function(field.X_world.T), dtype=float)
    except Exception as error:
        raise CallbackError(f'Body "{body.name}": {what} failed: {type(error).__name__}: {error}') from error
    if found.shape != (field.dim, field.n):
        raise CallbackError(
            f'Body "{body.name}": {what} returned shape {found.shape}, expected ({field.dim}, {field.n}).'
        )
    if not np.isfinite(found).all():
        raise CallbackError(f'Body "{body.name}": {what} returned values that are not finite.')
    return found.T.ravel().copy()
