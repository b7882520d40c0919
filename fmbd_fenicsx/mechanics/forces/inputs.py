"""Inputs of a scene: numbers that someone outside sets while it runs, held between two settings."""

from __future__ import annotations

import numpy as np

from ...errors import InputError, require


class Input:
    """A named number that can stand where a law of time is asked for; see :meth:`~fmbd_fenicsx.Scene.input`."""

    def __init__(self, name: str, start: float = 0.0, *, lower: float = -np.inf, upper: float = np.inf) -> None:
        require(lower <= upper, f'Input "{name}": lower = {lower} is above upper = {upper}.')
        self.name = name
        self.lower = float(lower)
        self.upper = float(upper)
        self.set(start)
        self.start = self.value

    def __call__(self, t: float) -> float:
        """The present value, whatever the time."""
        return self.value

    def set(self, value: float) -> None:
        """Set the value; refuses what is no number or outside the range."""
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError):
            raise InputError(f'Input "{self.name}" takes a number, found {value!r}.') from None
        if not self.lower <= number <= self.upper or not np.isfinite(number):
            raise InputError(f'Input "{self.name}" = {number:g} is outside its range [{self.lower:g}, {self.upper:g}].')
        self.value = number
