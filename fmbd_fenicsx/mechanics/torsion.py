"""Prismatic cross-sections, for beams and rods alike."""

from __future__ import annotations

import numpy as np

from ..errors import require


def torsion_of_rectangle(width: float, height: float) -> float:
    """Torsion constant (m^4) of a solid rectangle by the series of Saint-Venant, to 1e-4."""
    long, short = max(width, height), min(width, height)
    n = np.arange(1, 40, 2)
    series = float((np.tanh(n * np.pi * long / (2 * short)) / n**5).sum())
    return long * short**3 / 3 * (1 - 192 * short / (np.pi**5 * long) * series)


def ring(radius: float, inner: float, nu: float) -> tuple[float, float, float]:
    """Area (m^2), second moment (m^4) and shear factor of a disc, or of a ring with the radius ``inner`` (m).

    Shear factor of Cowper, doi:10.1115/1.3625046: 6 (1 + nu) (1 + m^2)^2 / ((7 + 6 nu) (1 + m^2)^2 + (20 + 12 nu) m^2) with
    m = inner / radius.
    """
    require(0 <= inner < radius, f"A ring needs 0 <= inner < radius, found inner {inner} m, radius {radius} m.")
    m = inner / radius
    full = (1 + m * m) ** 2
    factor = 6 * (1 + nu) * full / ((7 + 6 * nu) * full + (20 + 12 * nu) * m * m)
    return np.pi * (radius**2 - inner**2), np.pi * (radius**4 - inner**4) / 4, factor
