"""Preconditioned conjugate gradients on vectors that all ranks hold."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...errors import ConvergenceError
from ...rotations import Array


def conjugate_gradients(
    operator: Callable[[Array], Array],
    precondition: Callable[[Array], Array],
    d: Array,
    *,
    rtol: float,
    limit: int = 500,
) -> tuple[Array, int]:
    """Preconditioned conjugate gradients on replicated vectors: the same numbers on all ranks; solution and iterations."""
    lam = np.zeros_like(d)
    r = d.copy()
    y = precondition(r)
    p = y.copy()
    size = float(r @ y)
    start = size

    for k in range(limit):
        if size <= rtol**2 * start or start == 0:
            return lam, k

        q = operator(p)
        alpha = size / float(p @ q)
        lam = lam + alpha * p
        r = r - alpha * q
        y = precondition(r)

        size, old = float(r @ y), size
        p = y + (size / old) * p

    raise ConvergenceError(
        f"Conjugate gradients on the multipliers did not converge in {limit} iterations (rtol {rtol:g}). "
        "Try a better preconditioner."
    )
