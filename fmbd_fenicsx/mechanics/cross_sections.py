"""Prismatic cross-sections, for beams and rods alike.

A shape is its area (m^2), its second moments about both axes (m^4), its torsion constant (m^4) and its shear factor.
"""

from __future__ import annotations

import numpy as np

from ..checks import number
from ..errors import require

Shape = tuple[float, float, float, float, float]


def rectangle(what: str, width: float, height: float) -> Shape:
    """A solid rectangle: shear factor 5/6, torsion constant by the series of Saint-Venant, to 1e-4."""
    for name, value in {"width": width, "height": height}.items():
        number(f"{what}: {name}", value, above=0.0)
    long, short = max(width, height), min(width, height)
    n = np.arange(1, 40, 2)
    series = float((np.tanh(n * np.pi * long / (2 * short)) / n**5).sum())
    torsion = long * short**3 / 3 * (1 - 192 * short / (np.pi**5 * long) * series)
    return width * height, width * height**3 / 12, height * width**3 / 12, torsion, 5 / 6


def ring(radius: float, inner: float, nu: float) -> Shape:
    """A disc, or a ring with the radius ``inner`` (m).

    Shear factor of Cowper, doi:10.1115/1.3625046: 6 (1 + nu) (1 + m^2)^2 / ((7 + 6 nu) (1 + m^2)^2 + (20 + 12 nu) m^2) with
    m = inner / radius.
    """
    require(0 <= inner < radius, f"A ring needs 0 <= inner < radius, found inner {inner} m, radius {radius} m.")
    m = inner / radius
    full = (1 + m * m) ** 2
    factor = 6 * (1 + nu) * full / ((7 + 6 * nu) * full + (20 + 12 * nu) * m * m)
    moment = np.pi * (radius**4 - inner**4) / 4
    return np.pi * (radius**2 - inner**2), moment, moment, 2 * moment, factor


def shear_modulus(what: str, youngs_modulus: float, poisson_ratio: float, density: float) -> float:
    """G (Pa) of a material whose constants are checked."""
    for name, value in {"youngs_modulus": youngs_modulus, "density": density}.items():
        number(f"{what}: {name}", value, above=0.0)
    number(f"{what}: poisson_ratio", poisson_ratio, above=-1.0)
    require(poisson_ratio <= 0.5, f"{what}: poisson_ratio {poisson_ratio} must lie in (-1, 0.5].")
    return youngs_modulus / (2 * (1 + poisson_ratio))
