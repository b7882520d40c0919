"""The saddle point of :mod:`..saddle.saddle` solved as a whole, by one solver of PETSc.

* :class:`Direct`: one factorisation of the whole (MUMPS, L D L^T).
* :class:`FieldSplit`: MINRES or FGMRES with the block preconditioner diag(E_k, S~).

Each gives a solver with ``solve(f, g) -> Solution``. Every solve is judged by its own true residual, block by block.
Options of PETSc under the solver's prefix override the presets; an option there that nothing consumed is an error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...checks import check_fields, instance
from ...errors import LinearSolveError, near, require
from ...fem.factors.factor import by_mumps
from ...fem.fields import Field
from ...rotations import Array
from ...system.system import System
from ..blocks.elastic_blocks import Bddc, Cholesky, Multigrid, block_solver
from ..fieldsplit.block import SplitBlock, split_prefix
from ..fieldsplit.solver import SplitSolver
from ..options import check_options, set_from_options
from ..residual import Judge, KrylovTest
from ..rigid_modes import elastic_matrix
from ..saddle.diagnosis import diagnose
from ..saddle.elastic import Elastic
from ..saddle.precondition import Fractional, MultiplierPreconditioner, to_petsc
from ..saddle.saddle import SaddlePoint, Solution
from .multiplier_schur import check_krylov
from .preset import Preset

METHODS = ("minres", "fgmres", "gmres", "cg")  # PETSc's names


@dataclass(frozen=True)
class Direct(Preset):
    """One factorisation of the assembled saddle point (MUMPS L D L^T with pivoting); in scenes a Cholesky factor for each
    elastic body and the exact Schur complement of all else.
    """

    def block(self, field: Field, weights: tuple[float, float, float], prefix: str) -> Any:
        """A Cholesky factor; collective."""
        return block_solver(Cholesky(), field, weights, 1.0, prefix)

    def solver(self, saddle: SaddlePoint, prefix: str = "fmbd_") -> _Krylov:
        """Factor; collective. A singular system is diagnosed at the first solve."""
        from petsc4py import PETSc

        A = saddle.matrix.copy()
        A.convert("aij")
        A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        ksp = PETSc.KSP().create(saddle.comm)
        ksp.setOptionsPrefix(prefix)
        ksp.setOperators(A)
        by_mumps(ksp)
        ksp.getPC().setFactorSetUpSolverType()
        ksp.getPC().getFactorMatrix().setMumpsIcntl(14, 150)  # % of memory beyond the estimate: pivoting needs it
        return _Krylov(saddle, ksp, prefix, [A], Judge("the saddle point", 1e-9))


@dataclass(frozen=True)
class FieldSplit(Preset):
    """MINRES (or FGMRES) with diag(E_k, S~); ``rtol`` on the preconditioned residual.

    ``elastic``: :class:`Cholesky` or :class:`Multigrid`. ``multiplier``: how S~ is made, see
    :mod:`..saddle.precondition`. In scenes: the whole matrix of a step, see
    :mod:`..fieldsplit.solver`.
    """

    elastic: Cholesky | Multigrid | Bddc = Cholesky()
    multiplier: MultiplierPreconditioner = Fractional()
    method: str = "minres"
    rtol: float = 1e-8
    max_iterations: int = 400

    def __post_init__(self) -> None:
        check_fields(self)
        instance("FieldSplit: multiplier", self.multiplier, MultiplierPreconditioner)
        check_krylov("FieldSplit", self.rtol, self.max_iterations)
        require(
            self.method in METHODS,
            f'FieldSplit: method "{self.method}" is none of {", ".join(METHODS)}. {near(self.method, METHODS)}',
        )

    def split(self, system: System, prefix: str) -> SplitSolver:
        """The solver of a scene's steps; collective."""
        return SplitSolver(system, self, prefix)

    def block(self, field: Field, weights: tuple[float, float, float], prefix: str) -> SplitBlock:
        """The split of one body, its options under ``<scene>_fieldsplit_<body>.u_``; collective."""
        cm, cd, ck = weights
        return SplitBlock(Elastic(field, cm, ck), self.elastic, split_prefix(prefix, field.name), cd)

    def solver(self, saddle: SaddlePoint, prefix: str = "fmbd_") -> _Krylov:
        """Set up all blocks; collective."""
        from petsc4py import PETSc

        groups = [
            (name, ties, to_petsc(S, saddle, [saddle.ties[i].rows for i in ties]))
            for name, ties, S in self.multiplier.groups(saddle)
        ]

        n = len(saddle.elastic)
        own = [S for _, _, S in groups]
        # statics: free bodies get a little inertia, else their blocks are singular
        diagonal = []
        for E, e in zip(saddle.E, saddle.elastic, strict=True):
            diagonal.append(E if e.cm > 0 else elastic_matrix(e.body, e.inertia, e.ck))
            if e.cm == 0:
                own.append(diagonal[-1])
        diagonal += [S for _, _, S in groups]

        sets = [*saddle.sets[:n], *(_union(saddle, ties) for _, ties, _ in groups)]
        names = [*saddle.names[:n], *(name for name, _, _ in groups)]
        P = block_diagonal(diagonal, sets, saddle)

        ksp = PETSc.KSP().create(saddle.comm)
        ksp.setOptionsPrefix(prefix)
        ksp.setOperators(saddle.matrix, P)
        ksp.setType(self.method)
        ksp.setTolerances(rtol=self.rtol, atol=0.0, max_it=self.max_iterations)

        pc = ksp.getPC()
        pc.setType("fieldsplit")
        pc.setFieldSplitType(PETSc.PC.CompositeType.ADDITIVE)
        pc.setFieldSplitIS(*zip(names, sets, strict=True))
        pc.setUp()

        for k, sub in enumerate(pc.getFieldSplitSubKSP()):
            if k < n:
                self.elastic.set_up(sub, saddle.elastic[k])
            else:
                Cholesky().set_up(sub)
            sub.setFromOptions()
        return _Krylov(saddle, ksp, prefix, [P, *own], Judge("the saddle point", 100 * self.rtol))


def _union(saddle: SaddlePoint, ties: list[int]) -> Any:
    """Rows of several ties on this rank."""
    from petsc4py import PETSc

    n = len(saddle.elastic)
    rows = np.concatenate([saddle.sets[n + i].getIndices() for i in ties])
    return PETSc.IS().createGeneral(rows.astype(PETSc.IntType), comm=saddle.comm)


def block_diagonal(blocks: Sequence[Any], sets: Sequence[Any], saddle: SaddlePoint) -> Any:
    """A nest with the given diagonal blocks on the given row sets; collective."""
    from petsc4py import PETSc

    table = [[B if i == j else None for j in range(len(blocks))] for i, B in enumerate(blocks)]
    P = PETSc.Mat().createNest(table, isrows=list(sets), iscols=list(sets), comm=saddle.comm)
    P.assemble()
    return P


class _Krylov:
    """A KSP on the whole saddle point, judged by its true residual.

    A Krylov method goes on until both its own norm and the true residual, block by block, are small enough; a factor is
    refined.
    """

    def __init__(self, saddle: SaddlePoint, ksp: Any, prefix: str, own: list[Any], judge: Judge) -> None:
        self.saddle, self.ksp, self.prefix, self._own, self.judge = saddle, ksp, prefix, own, judge
        set_from_options(ksp)
        self.direct = ksp.getType() == "preonly"
        self._checked, self._b = False, None
        if not self.direct:
            ksp.setConvergenceTest(KrylovTest(judge, lambda x: saddle.relative_residual(x, self._b)))

    def solve(self, f: Sequence[Array], g: Sequence[Array]) -> Solution:
        s = self.saddle
        b = self._b = s.vector(f, g)
        x = b.duplicate()
        x.set(0.0)
        self.ksp.solve(b, x)
        iterations = self.ksp.getIterationNumber()
        reason = self.ksp.getConvergedReason()

        residual = s.relative_residual(x, b)
        if self.direct:
            residual = self._refine(x, b, residual)

        # options that nobody took are told once
        if not self._checked:
            check_options(self.prefix, s.comm)
            self._checked = True

        if not residual <= self.judge.tolerance:
            found = diagnose(s)
            raise LinearSolveError(
                f"Linear solve of {self.judge.what}: relative residual {residual:.1e} after {iterations} "
                f"iterations (PETSc reason {reason}), allowed {self.judge.tolerance:.0e}. {found}"
            )

        self.judge.check(residual, 1.0)
        u, lam = s.blocks(x)
        x.destroy(), b.destroy()
        return Solution(u, lam, iterations, residual)

    def _refine(self, x: Any, b: Any, residual: float) -> float:
        """Up to three steps of iterative refinement of x with the factor; the residual then. Collective."""
        for _ in range(3):
            if not np.isfinite(residual) or residual <= 1e-13:
                break
            # corrections by the same factor, while roundoff leaves anything to gain
            r, dx = b.duplicate(), b.duplicate()
            self.saddle.matrix.mult(x, r)
            r.aypx(-1.0, b)
            self.ksp.solve(r, dx)
            x.axpy(1.0, dx)
            r.destroy(), dx.destroy()
            residual = self.saddle.relative_residual(x, b)
        return residual

    def destroy(self) -> None:
        for obj in (self.ksp, *self._own):
            obj.destroy()
