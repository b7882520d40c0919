"""Traces of surfaces: integrals, nodes, places, the same numbers on any number of ranks; against DOLFINx's
own assembly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import MeshError
from fmbd_fenicsx.fem.traces.traces import refined, trace_of

ROOT = Path(__file__).resolve().parents[1]


def block(dim: int, cells: int = 3):
    return fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 1.0, 1.0)[:dim], cells=cells)


def make(dim: int, degree: int, surface: str = "top"):
    from dolfinx import fem

    mesh = block(dim)
    space = fem.functionspace(mesh.dolfinx, ("Lagrange", degree))
    return mesh, space, trace_of(space, mesh, surface)


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("dim", [2, 3])
def test_integrals_of_polynomials(dim: int, degree: int) -> None:
    _, _, t = make(dim, degree)
    x = t.points[:, 0]
    one = np.ones(t.n)
    assert one @ t.mass() @ one == pytest.approx(1.0, abs=1e-13)
    assert (x**degree) @ t.mass() @ x == pytest.approx(1 / (degree + 2), abs=1e-13)
    assert x @ t.stiffness() @ x == pytest.approx(1.0, abs=1e-12)
    assert np.abs(t.stiffness() @ one).max() < 1e-12
    assert np.allclose(t.normals[:, 1], 1.0)
    assert np.allclose(t.normals[:, 1], 1.0)  # outward
    assert len(t.border) == {2: 2, 3: 12 * degree}[dim]


@pytest.mark.smoke
@pytest.mark.mpi
@pytest.mark.parametrize("dim, degree", [(2, 1), (2, 2), (3, 1), (3, 2)])
def test_mass_equals_the_form_assembled_by_dolfinx(dim: int, degree: int) -> None:
    import ufl
    from dolfinx import fem, la

    mesh, space, t = make(dim, degree, "right")
    f = fem.Function(space)
    f.interpolate(lambda x: np.sin(x[0]) + x[1] ** 2 - x[0] * x[1])
    ds = ufl.Measure("ds", domain=mesh.dolfinx, subdomain_data=mesh.facet_tags)(mesh.surface_tag("right"))
    b = fem.assemble_vector(fem.form(f * ufl.TestFunction(space) * ds))
    b.scatter_reverse(la.InsertMode.add)
    n = space.dofmap.index_map.size_local
    mine = t.columns(t.mass()).T @ t.values(f.x.array[:n])
    assert np.abs(mine - b.array[:n]).max(initial=0.0) < 1e-14


@pytest.mark.mpi
def test_numbering_does_not_depend_on_ranks() -> None:
    _, _, t = make(3, 2)
    key = np.round(t.points, 9)
    assert (np.lexsort(key.T[::-1]) == np.arange(t.n)).all()
    owners = np.sum(t.comm.allgather((t.owned >= 0).astype(int)), axis=0)
    assert (owners == 1).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_refined_surface_keeps_its_area(dim: int) -> None:
    _, _, t = make(dim, 1)
    fine = refined(t, 2, 2)
    assert fine.sizes.sum() == pytest.approx(1.0, abs=1e-13)
    assert fine.n == {2: 25, 3: 625}[dim]


@pytest.mark.mpi
def test_surface_without_facets_is_refused() -> None:
    from dataclasses import replace

    from dolfinx import fem

    mesh = block(2)
    mesh = replace(mesh, surfaces={**mesh.surfaces, "ghost": 99})
    space = fem.functionspace(mesh.dolfinx, ("Lagrange", 1))
    with pytest.raises(MeshError, match="ghost.*no facets"):
        trace_of(space, mesh, "ghost")
