"""Whether the derivatives that a user gives with equations of motion are those of the functions that they belong to.

A wrong dg/dq pushes where no constraint does, a wrong part of g'' lets it drift: both run, and give another motion. They are
compared with what the functions themselves tell, at the start and a little aside, where terms that vanish at first show.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...errors import FmbdError, InputError
from ...log import log
from ...rotations import Array
from .own_derivatives import SAME, Slopes, line_rates
from .port_constraint import PortConstraint

ASIDE = 1e-2  # of the largest coordinate: a second place to compare at
ROUNDOFF = 1e-9  # of what may cancel in a derivative


def check_constraint(law: PortConstraint, body: Any) -> None:
    """Refuse jacobian, gamma and rate of a constraint that are not its derivatives.

    Raises:
        InputError: which, and where they differ most.
    """
    if law.jacobian_ is None and law.gamma_ is None and law.rate_ is None:
        return
    for q, v in (places := _places(body)):
        z = np.append(q, 0.0)
        slope = _known(law.slope, z)
        if slope is None:
            continue
        # what is roundoff of a derivative by place, by time, and of a second rate
        aside, fast = np.abs(places[-1][0]).max(), np.abs(v).max()
        none = ROUNDOFF * max(float(np.abs(slope[:, :-1]).max(initial=0.0)), np.abs(law.values(q, 0.0)).max() / aside)
        if law.jacobian_ is not None:
            _compare(law, "jacobian", law.jacobian(q, 0.0), slope[:, :-1], none)
        if law.rate_ is not None:
            _compare(law, "rate", law.rate(q, 0.0), slope[:, -1], none * fast)
        if law.gamma_ is not None:
            second = _known(_second, law, z, v)
            _compare(law, "gamma", law.gamma(q, v, 0.0), second, none * fast**2 / aside)


def check_force(body: Any, slopes: Slopes, tangent: Callable[..., Any]) -> None:
    """Warn of a force_jacobian that is not that of the force: steps are slow by it, modes and linear models are others."""
    n = len(body.start)
    for q, v in (places := _places(body)):
        z = np.concatenate((q, v, [0.0]))
        found = _known(slopes, z)
        if found is None:
            continue

        none = ROUNDOFF * float(np.abs(slopes.function(z)).max(initial=0.0))
        sizes = np.abs(places[-1][0]).max(), np.abs(v).max()
        for k, (given, by) in enumerate(zip(tangent(q, v, 0.0), ("q", "q'"), strict=True)):
            said = np.reshape(np.asarray(given, dtype=float), (n, n))
            if differs := _difference(said, found[:, n * k : n * (k + 1)], none / sizes[k]):
                log.warning(
                    'body "%s": force_jacobian by %s is not that of the force: %s. '
                    "Newton's iteration is slow by it, and modes and linear models are those of other forces",
                    body.name, by, differs,
                )  # fmt: skip
                return


def _places(body: Any) -> tuple[tuple[Array, Array], ...]:
    """Coordinates and rates to compare at: the start, and a place aside."""
    q, v = (np.asarray(x, dtype=float) for x in (body.start, body.start_rate))
    along = 1.0 + 0.1 * np.arange(len(q))
    size = float(np.abs(q).max(initial=0.0)) or 1.0
    fast = along * (float(np.abs(v).max(initial=0.0)) or size)
    return (q, v if v.any() else fast), (q + ASIDE * size * along, fast)


def _second(law: PortConstraint, z: Array, v: Array) -> Array:
    """The second rate of a constraint along a line of its coordinates and time."""
    return line_rates(lambda x: law.function(x[:-1], x[-1]), z, np.append(v, 1.0))[1]


def _known(derivative: Callable[..., Array], *at: Any) -> Array | None:
    """What is told of a derivative; None where it has no value there."""
    try:
        told = np.asarray(derivative(*at), dtype=float)
    except (FmbdError, ArithmeticError, ValueError):
        return None
    return told if np.isfinite(told).all() else None


def _difference(said: Array, told: Array, none: float) -> str:
    """Where two derivatives differ most, against the largest of their row, but for what is ``none``; empty where they agree."""
    size = np.maximum(np.abs(said), np.abs(told))
    row = size.max(axis=-1, keepdims=True) if size.ndim > 1 else size
    apart = np.abs(said - told)
    beyond = np.where(apart > SAME * row + none, apart, 0.0)
    if not beyond.any():
        return ""
    place = tuple(int(i) for i in np.unravel_index(int(beyond.argmax()), beyond.shape))
    return f"entry {place} is {said[place]:g}, the function itself tells {told[place]:g}"


def _compare(law: PortConstraint, what: str, said: Array, told: Array | None, none: float) -> None:
    """Refuse one of the derivatives of a constraint."""
    if told is None:
        return
    if said.shape != told.shape:
        raise InputError(f'Body "{law.name}": {what} has shape {said.shape}, expected {told.shape}.')
    if differs := _difference(said, told, none):
        raise InputError(
            f'Body "{law.name}": {what} is not that of its constraint: {differs}. '
            "Leave it out, and it is found from the constraint."
        )
