"""The density of a body: one number, or one for each of its named volumes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import number
from ..errors import InputError, near

if TYPE_CHECKING:
    from .mesh.mesh import Mesh

Density = float | Mapping[str, float]


def check_density(what: str, density: Density, mesh: Mesh) -> None:
    """Refuse numbers that are not positive, names of no volume, and volumes without a density."""
    unit = "kg/m^3" if mesh.dim == 3 else "kg/m^2"
    if not isinstance(density, Mapping):
        number(what, density, above=0.0, unit=unit)
        return

    for name, value in density.items():
        if name not in mesh.volumes:
            raise InputError(f"{what}: no volume {name!r} in {mesh.label}. {near(str(name), sorted(mesh.volumes))}")
        number(f'{what} of volume "{name}"', value, above=0.0, unit=unit)
    left = [name for name in mesh.volumes if name not in density]
    if left or not density:
        raise InputError(f"{what}: none is given for the volumes {left} of {mesh.label}. Give one for each.")


def density_on(mesh: Mesh, density: Density) -> Any:
    """The density as a coefficient of forms: a constant, or a function that is constant in each cell."""
    from dolfinx import fem

    if not isinstance(density, Mapping):
        return fem.Constant(mesh.dolfinx, float(density))

    rho = fem.Function(fem.functionspace(mesh.dolfinx, ("DG", 0)))
    for name, value in density.items():
        rho.x.array[rho.function_space.dofmap.list[mesh.cell_tags.find(mesh.volume_tag(name)), 0]] = value
    rho.x.scatter_forward()
    return rho


def mean_density(field: Any) -> float:
    """Mass over volume of a field; collective."""
    import ufl
    from dolfinx import fem

    given = field.forms.density
    if not isinstance(given, Mapping):
        return float(given)

    one = fem.form(fem.Constant(field.mesh.dolfinx, 1.0) * ufl.Measure("dx", domain=field.mesh.dolfinx))
    return float(field.mass_total / field.total(np.array(fem.assemble_scalar(one))))
