"""Energies of displacement and pressure, as data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class MixedEnergy:
    """An energy Pi(u, p, dx) in J of displacement and pressure, quadratic in p; ``linear``: quadratic in u too."""

    density: Callable[[Any, Any, Any], Any]
    linear: bool = False

    def __call__(self, u: Any, p: Any, dx: Any) -> Any:
        return self.density(u, p, dx)
