"""The gravity of a scene over time: constant, switched on by a ramp, or by a function of the user's own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..checks import function, refuse, vector
from ..errors import named, require
from ..rotations import Array

GivenGravity = Sequence[float] | Callable[[float], Sequence[float]] | None


@dataclass(frozen=True, eq=False)
class Gravity:
    """g(t), (d,), m/s^2, world axes: what is ``given`` times a smooth switch-on within ``ramp`` s.

    ``lasting``: g in the end, under which the weight has its energy; zero of a function, whose pull is all work.
    ``usual``: g to compare with: the lasting one, that of a function when the scene begins.
    """

    given: Callable[[float], Array]
    ramp: float
    lasting: Array
    usual: Array
    steady: bool  # whether it is the same at all times

    def __call__(self, t: float) -> Array:
        """g at a time, s."""
        g = self.given(t)
        return g if self.ramp == 0 else g * smooth_step(t, self.ramp)

    @property
    def size(self) -> float:
        """|g| to compare with, m/s^2."""
        return float(np.linalg.norm(self.usual))


def check_gravity(what: str, given: GivenGravity) -> None:
    """Refuse what is neither a vector nor a function of time."""
    if callable(given):
        function(what, given, "t", named="t")
    elif given is not None and len(vector(what, given, other=", or a function of time t (s)")) not in (2, 3):
        refuse(what, "2 or 3 finite numbers, or a function of time t (s)", given)


def gravity_of(name: str, given: GivenGravity, ramp: float, dim: int, begins: float) -> Gravity:
    """That of the scene ``name``, which begins at ``begins`` (s)."""
    what = f'Scene "{name}": gravity'
    require(given is not None or ramp == 0, f"{what}_ramp = {ramp:g} s switches on gravity, and there is none.")
    if not callable(given):
        g = np.zeros(dim) if given is None else vector(what, given, size=dim)
        return Gravity(lambda t: g, ramp, g, g, ramp == 0)

    asked = named("The gravity of scene", name, given, to_end=True)
    law = lambda t: vector(f"{what}({t:g})", asked(t), size=dim)
    return Gravity(law, ramp, np.zeros(dim), law(begins), False)


def smooth_step(t: float, duration: float) -> float:
    """1 after ``duration``, 0 before 0, and 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7 between: three continuous derivatives."""
    if t >= duration:
        return 1.0
    s = max(t / duration, 0.0)
    return s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)
