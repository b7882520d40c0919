"""The inf-sup constant of displacements and pressure on a body's own mesh.

    beta = min_p max_u  int p div u / (|u|_1 |p|_0),     |u|_1^2 = int |grad u|^2 + |u|^2 / l^2                (1)

beta^2 is the smallest eigenvalue of B A^-1 B^T p = beta^2 M p with A of |u|_1, M of |p|_0 and B of int p div u, over
what is not a zero mode (with all of the boundary held, the constant pressure is one). A stable pair keeps it away from
zero as the mesh is refined. Source: Boffi, Brezzi and Fortin, doi:10.1007/978-3-642-36519-5, chapter 8.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import dolfinx_compat as compat
from ..rotations import Array
from .factors.factor import by_mumps
from .traces.stability import BodyNorm


class _SchurComplement:
    """x -> B A^-1 B^T x for a PETSc shell matrix."""

    def __init__(self, B: Any, ksp: Any) -> None:
        self.B, self.ksp = B, ksp
        self.u, _ = B.createVecs()
        self.w = self.u.duplicate()

    def mult(self, mat: Any, x: Any, y: Any) -> None:
        """The product."""
        self.B.multTranspose(x, self.u)
        self.ksp.solve(self.u, self.w)
        self.B.mult(self.w, y)


def infsup_pressure(mesh: Any, degree: int, pressure: int | None = None, *, clamped: tuple[str, ...] = ()) -> Array:
    """The three smallest beta of (1), ascending, zero modes included; collective. Needs SLEPc.

    Args:
        mesh: a :class:`~fmbd_fenicsx.fem.mesh.mesh.Mesh`.
        degree: of the displacements.
        pressure: degree of the continuous pressure; by default one less (Taylor-Hood).
        clamped: surfaces where displacements are held.
    """
    from petsc4py import PETSc
    from slepc4py import SLEPc

    norm = BodyNorm(mesh, degree, clamped=clamped, length=mesh.extent, vector=True)
    M, B = _of_pressure(norm, degree - 1 if pressure is None else pressure)
    shell = PETSc.Mat().createPython(M.getSizes(), _SchurComplement(B, norm.ksp), comm=M.comm)
    shell.setUp()

    eps = SLEPc.EPS().create(M.comm)
    by_mumps(eps.getST().getKSP(), "lu")
    eps.setOperators(shell, M)
    eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.SMALLEST_REAL)
    eps.setDimensions(3, 40)
    eps.setTolerances(1e-6, 500)
    eps.solve()

    found = np.sqrt(np.maximum([eps.getEigenvalue(i).real for i in range(min(3, eps.getConverged()))], 0.0))
    for thing in (eps, shell, norm, B, M):
        thing.destroy()
    return np.asarray(found)


def _of_pressure(norm: BodyNorm, degree: int) -> tuple[Any, Any]:
    """M and B of (1)."""
    import dolfinx.fem.petsc as fp
    import ufl
    from dolfinx import fem

    Q = fem.functionspace(norm.space.mesh, ("Lagrange", degree))
    u, p, q = ufl.TrialFunction(norm.space), ufl.TrialFunction(Q), ufl.TestFunction(Q)
    M = fp.assemble_matrix(compat.form(p * q * ufl.dx))
    B = fp.assemble_matrix(compat.form(q * ufl.div(u) * ufl.dx), norm.held)
    for matrix in (M, B):
        matrix.assemble()
    return M, B
