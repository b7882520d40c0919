"""The gravity of a scene as a function of time, its ramp included."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ...checks import vector
from ...rotations import Array

if TYPE_CHECKING:
    from .scene import Scene


def gravity_of(scene: Scene, dim: int) -> Callable[[float], Array]:
    """g(t), (dim,), m/s^2."""
    ramp = scene.gravity_ramp
    g = np.zeros(dim) if scene.gravity is None else vector(f'Scene "{scene.name}": gravity', scene.gravity, size=dim)
    if ramp == 0:
        return lambda t: g
    return lambda t: g * smooth_step(t, ramp)


def smooth_step(t: float, duration: float) -> float:
    """1 after ``duration``, 0 before 0, and 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7 between: three continuous derivatives."""
    if t >= duration:
        return 1.0
    s = max(t / duration, 0.0)
    return s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)
