"""The density of a body: one number, one for each of its named volumes, or a function of the place."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import dolfinx_compat as compat
from ..checks import function, number
from ..energies import of_place
from ..errors import InputError, near

if TYPE_CHECKING:
    from .mesh.mesh import Mesh

Density = float | Mapping[str, float] | Callable[[Any], Any]


def check_density(what: str, density: Density, mesh: Mesh) -> None:
    """Refuse numbers that are not positive, names of no volume, and volumes without a density; functions that take no place."""
    unit = "kg/m^3" if mesh.dim == 3 else "kg/m^2"
    if callable(density):
        function(what, density, "x", named="the place x, m")
        return
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


def density_on(name: str, mesh: Mesh, density: Density) -> Any:
    """The density of the body ``name`` as a coefficient of forms: a constant, a function that is constant in each cell, or an
    expression of the place; collective.
    """
    from dolfinx import fem

    if callable(density):
        return _of_place(f'Body "{name}": density', mesh, density)
    if not isinstance(density, Mapping):
        return fem.Constant(mesh.dolfinx, float(density))

    rho = fem.Function(fem.functionspace(mesh.dolfinx, ("DG", 0)))
    for volume, value in density.items():
        rho.x.array[rho.function_space.dofmap.list[mesh.cell_tags.find(mesh.volume_tag(volume)), 0]] = value
    rho.x.scatter_forward()
    return rho


def _of_place(what: str, mesh: Mesh, density: Callable[[Any], Any]) -> Any:
    """The UFL expression that a function of the place gives; no cell has a mass that is not positive. Collective."""
    import ufl
    from dolfinx import fem
    from mpi4py import MPI

    rho = of_place(what, density, mesh.dolfinx)
    cells = fem.functionspace(mesh.dolfinx, ("DG", 0))
    masses = fem.assemble_vector(compat.form(rho * ufl.TestFunction(cells) * mesh.dx)).array
    owned = cells.dofmap.index_map.size_local
    least = mesh.dolfinx.comm.allreduce(float(masses[:owned].min(initial=np.inf)), op=MPI.MIN)
    if not 0.0 < least < np.inf:
        raise InputError(
            f"{what}(x) gives a cell of {mesh.label} the mass {least:.3g} kg. It must be positive everywhere."
        )
    return rho


def mean_density(field: Any) -> float:
    """Mass over volume of a field; collective."""
    import ufl
    from dolfinx import fem

    given = field.forms.density
    if isinstance(given, float | int):
        return float(given)

    one = fem.form(fem.Constant(field.mesh.dolfinx, 1.0) * ufl.Measure("dx", domain=field.mesh.dolfinx))
    return float(field.mass_total / field.total(np.array(fem.assemble_scalar(one))))
