"""A soft sheet by DOLFINx alone, without this package: what ``static_cantilever`` is compared with."""

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix, assemble_vector
from petsc4py import PETSc


def plain_newton(mesh, energy, traction, load_steps=10):
    """Mean displacement (m) of the side "right" under a dead traction (Pa) upwards: P2, "left" held; collective."""
    V, comm = fem.functionspace(mesh.dolfinx, ("Lagrange", 2, (2,))), mesh.dolfinx.comm
    u, v, load = fem.Function(V), ufl.TestFunction(V), fem.Constant(mesh.dolfinx, 0.0)
    ds = ufl.Measure("ds", domain=mesh.dolfinx, subdomain_data=mesh.facet_tags)(mesh.surface_tag("right"))
    balance = ufl.derivative(energy(u, ufl.Measure("dx", domain=mesh.dolfinx)), u, v) - load * v[1] * ds
    vector, matrix = fem.form(balance), fem.form(ufl.derivative(balance, u))
    held = fem.locate_dofs_geometrical(V, lambda x: np.abs(x[0]) < 1e-9)
    clamp = fem.dirichletbc(np.zeros(2), held, V)
    own = held[held < V.dofmap.index_map.size_local]

    for share in np.linspace(0.0, 1.0, load_steps + 1)[1:]:
        load.value = share * traction
        for _ in range(50):
            b = assemble_vector(vector)
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            b.array.reshape(-1, 2)[own] = 0.0
            step = solve(assemble_matrix(matrix, bcs=[clamp]), b)
            u.x.array[: len(step)] -= step
            u.x.scatter_forward()
            if max(comm.allgather(np.abs(step).max(initial=0.0))) < 1e-11:
                break

    parts = [u[0] * ds, u[1] * ds, fem.Constant(mesh.dolfinx, 1.0) * ds]
    x, y, height = (sum(comm.allgather(fem.assemble_scalar(fem.form(p)))) for p in parts)
    return np.array([x, y]) / height


def solve(A, b):
    """A^-1 b by a sparse factor; this rank's part."""
    A.assemble()
    solver = PETSc.KSP().create(A.getComm())
    solver.setOperators(A)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("mumps")
    x = A.createVecRight()
    solver.solve(b, x)
    return x.array
