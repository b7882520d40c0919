"""Our trace matrices against DOLFINx's own mixed-domain assembly on a submesh of facets, where it gives one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from test_traces import block

from fmbd_fenicsx.fem.traces.multipliers import Continuous, Discontinuous, Ends
from fmbd_fenicsx.fem.traces.traces import trace_of


def coupling_by_dolfinx(
    mesh: Any, surface: str, degree: int, multiplier: tuple[str, int]
) -> tuple[np.ndarray, np.ndarray, Any]:
    """int mu_j phi_i with mu on the submesh of the facets: owned rows of mu, all columns; places of mu; the space of phi."""
    import ufl
    from dolfinx import fem
    from dolfinx import mesh as dmesh
    from dolfinx.fem import petsc

    msh, d = mesh.dolfinx, mesh.dim
    facets = mesh.facet_tags.find(mesh.surface_tag(surface))
    sub, to_parent = dmesh.create_submesh(msh, d - 1, facets)[:2]
    V = fem.functionspace(msh, ("Lagrange", degree))
    Q = fem.functionspace(sub, multiplier)
    u, mu = ufl.TrialFunction(V), ufl.TestFunction(Q)
    n = msh.topology.index_map(d - 1)
    back = np.full(n.size_local + n.num_ghosts, -1, dtype=np.int32)
    back[to_parent] = np.arange(len(to_parent))
    ds = ufl.Measure("ds", domain=msh, subdomain_data=mesh.facet_tags, subdomain_id=mesh.surface_tag(surface))
    A = petsc.assemble_matrix(fem.form(mu * u * ds, entity_maps={sub: back}))
    A.assemble()
    low, high = A.getOwnershipRange()
    rows = A[low:high, : A.getSize()[1]] if high > low else np.zeros((0, A.getSize()[1]))
    A.destroy()
    return np.asarray(rows), Q.tabulate_dof_coordinates()[: high - low, :d], V


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(
    "degree, multiplier", [(1, ("Lagrange", 1)), (2, ("Lagrange", 1)), (2, ("Discontinuous Lagrange", 0))]
)
def test_coupling_equals_mixed_domain_assembly(dim: int, degree: int, multiplier: tuple[str, int]) -> None:
    """The same matrix, rows matched by the places of the multipliers, on ranks with and without facets of the surface."""
    import dolfinx

    if tuple(int(p) for p in dolfinx.__version__.split(".")[:2]) > (0, 9):
        pytest.skip("entity maps are objects of their own from 0.10 on")
    mesh = block(dim, cells=2)
    theirs, places, V = coupling_by_dolfinx(mesh, "top", degree, multiplier)
    trace = trace_of(V, mesh, "top")
    space = Discontinuous(0) if multiplier[1] == 0 else Continuous(1, Ends.KEPT)
    ours = trace.columns(space.on(trace).coupling()).toarray()  # all rows, the columns of this rank
    comm = mesh.dolfinx.comm
    low, high = V.dofmap.index_map.local_range
    wide = np.zeros((len(ours), V.dofmap.index_map.size_global))
    wide[:, low:high] = ours
    wide = np.sum(comm.allgather(wide), axis=0)
    vertices = np.unique(trace.nodes[:, :dim])
    centers = trace.corners.mean(1) if multiplier[1] == 0 else trace.points[vertices]
    theirs, places = (np.concatenate(comm.allgather(x)) for x in (theirs, places))
    match = [int(np.linalg.norm(centers - x, axis=1).argmin()) for x in places]
    assert sorted(match) == list(range(len(ours)))
    assert np.abs(theirs - wide[match]).max() < 1e-15
