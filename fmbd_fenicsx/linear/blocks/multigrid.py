"""Multigrid for an elastic block E = cm M + ck K: the displacements of degree 1 are the coarse space, aggregates below them.

Smoothed aggregation alone needs twice the iterations on quadratic elements: its strength of connection was made for linear
ones. With P the interpolation of linear displacements into those of the body,

    E_1 = P^T E P,        cycle = Chebyshev steps on E, smoothed aggregation (rigid-body modes) on E_1, Chebyshev steps       (1)

The cycle is symmetric, so that it can precondition conjugate gradients and MINRES. Sources: Vanek, Mandel and Brezina,
doi:10.1007/BF02238511; Adams, Brezina, Hu and Tuminaro, doi:10.1016/S0021-9991(03)00194-3 for the polynomial smoother.
"""

from __future__ import annotations

from typing import Any

from ...fem.fields import Field
from ...rotations import Array
from ..rigid_modes import attach_modes, modes_at

AGGREGATION = (("pc_gamg_threshold", 0.02), ("pc_gamg_coarse_eq_limit", 300))


def set_multigrid(pc: Any, body: Field, smoothing: int) -> None:
    """One cycle (1) as the preconditioner ``pc`` of the body's block, whose operators are set; collective.

    Under the options prefix of ``pc`` the levels answer to ``mg_levels_1_...`` (Chebyshev) and ``mg_coarse_...``.
    """
    E = pc.getOperators()[1]
    if body.forms.degree == 1:
        _aggregation(pc, smoothing)
        return
    from petsc4py import PETSc

    # quadratic elements: linear ones on the same mesh are the coarse level, by Galerkin's product
    P, modes = _linear(body)
    E1 = E.ptap(P)
    E1.setBlockSize(body.dim)
    E1.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    attach_modes(E1, modes)

    pc.setType("mg")
    pc.setMGLevels(2)
    pc.setMGInterpolation(1, P)

    # Chebyshev with Jacobi needs no factor; the coarse level is aggregated on
    fine = pc.getMGSmoother(1)
    fine.setOperators(E, E)
    fine.setType("chebyshev")
    fine.setTolerances(max_it=smoothing)
    fine.getPC().setType("jacobi")

    coarse = pc.getMGCoarseSolve()
    coarse.setOperators(E1, E1)
    coarse.setType("preonly")
    _aggregation(coarse.getPC(), smoothing)
    coarse.setFromOptions()

    P.destroy(), E1.destroy()


def _aggregation(pc: Any, smoothing: int) -> None:
    """Smoothed aggregation; options that the user set stay."""
    from petsc4py import PETSc

    pc.setType("gamg")
    pc.setGAMGSmooths(1)
    # options that the user has set stay
    options = PETSc.Options()
    prefix = pc.getOptionsPrefix() or ""
    for name, value in (*AGGREGATION, ("mg_levels_ksp_max_it", smoothing)):
        if not options.hasName(prefix + name):
            options[prefix + name] = value


def _linear(body: Field) -> tuple[Any, Array]:
    """Interpolation P of linear displacements, and their rigid modes; collective."""
    import dolfinx.fem.petsc as fp
    from dolfinx import fem

    d = body.dim
    space = fem.functionspace(body.mesh.dolfinx, ("Lagrange", 1, (d,)))
    P = fp.interpolation_matrix(space, body.space)
    P.assemble()
    n = space.dofmap.index_map.size_local
    X = space.tabulate_dof_coordinates()[:n, :d] - body.center
    return P, modes_at(body, X)
