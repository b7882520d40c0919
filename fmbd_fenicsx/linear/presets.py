"""Ways to solve the saddle point of :mod:`.saddle`, as small frozen objects.

* :class:`Direct`: one factorisation of the whole (MUMPS, L D L^T).
* :class:`Schur`: exact Schur complement of the multipliers, S = sum_k B_k E_k^-1 B_k^T, dense; E_k by
Cholesky or multigrid.
* :class:`FieldSplit`: MINRES or FGMRES with the block preconditioner diag(E_k, S~).

Each gives a solver with ``solve(f, g) -> Solution``. Every solve is judged by its own true residual, block
by block. Options of
PETSc under the solver's prefix override the presets; an option there that nothing consumed is an error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.linalg as sl

from ..errors import InputError, LinearSolveError
from ..rotations import Array
from .diagnosis import diagnose
from .options import check_options
from .precondition import Fractional, MultiplierPreconditioner
from .residual import Judge
from .saddle import Elastic, SaddlePoint, Solution, _matrix


class Preset(Protocol):
    """Makes a solver for a saddle point."""

    def solver(self, saddle: SaddlePoint, prefix: str) -> SaddleSolver:
        """Set up; collective."""


class SaddleSolver(Protocol):
    """Solves (1) of :mod:`.saddle`."""

    def solve(self, f: Sequence[Array], g: Sequence[Array]) -> Solution:
        """Displacements and multipliers for loads f (this rank's, one per body) and data g (replicated, one
        per tie).
        """

    def destroy(self) -> None:
        """Free PETSc objects; collective."""


@dataclass(frozen=True)
class Cholesky:
    """Elastic blocks by a Cholesky factor (MUMPS)."""

    def set_up(self, ksp: Any, block: Elastic | None = None) -> None:
        """Options of one block's KSP."""
        ksp.setType("preonly")
        ksp.getPC().setType("cholesky")
        ksp.getPC().setFactorSolverType("mumps")


@dataclass(frozen=True)
class Multigrid:
    """Elastic blocks by smoothed aggregation with rigid-body modes; ``cycles`` > 1 uses that many Richardson
    steps.
    """

    cycles: int = 1

    def set_up(self, ksp: Any, block: Elastic | None = None) -> None:
        """Options of one block's KSP."""
        from petsc4py import PETSc

        ksp.setType("preonly" if self.cycles == 1 else "richardson")
        if self.cycles > 1:
            ksp.setTolerances(rtol=0.0, atol=0.0, max_it=self.cycles)
            ksp.setNormType(PETSc.KSP.NormType.NONE)
        pc = ksp.getPC()
        pc.setType("gamg")
        pc.setGAMGSmooths(1)
        options = PETSc.Options()
        prefix = ksp.getOptionsPrefix()
        for name, value in (
            ("pc_gamg_threshold", 0.02),
            ("mg_levels_ksp_max_it", 3),
            ("pc_gamg_coarse_eq_limit", 300),
        ):
            if not options.hasName(prefix + name):
                options[prefix + name] = value


@dataclass(frozen=True)
class Bddc:
    """Elastic blocks by balancing domain decomposition (PETSc's BDDC), one subdomain per rank; see
    :mod:`.domain_decomposition`.

    ``adaptive``: eigenvalues of interface pencils beyond this enter the coarse space (0: corners and
    averages only, whose
    counts grow towards statics).
    """

    adaptive: float = 2.0

    def set_up(self, ksp: Any, block: Elastic | None = None) -> None:
        """Operators and options of one block's KSP."""
        from .domain_decomposition import unassembled

        assert block is not None
        A = unassembled(block.body, block.inertia, block.ck)
        ksp.setType("preonly")
        ksp.setOperators(A)
        A.destroy()  # the KSP keeps it
        set_bddc(ksp, self.adaptive)


def set_bddc(ksp: Any, adaptive: float = 2.0) -> None:
    """BDDC with deluxe scaling (stiffness-weighted averages) and an adaptive coarse space; options override
    both.
    """
    from petsc4py import PETSc

    ksp.getPC().setType("bddc")
    options, prefix = PETSc.Options(), ksp.getOptionsPrefix() or ""
    for name, value in (("use_deluxe_scaling", True), ("adaptive_threshold", adaptive)):
        if value and not options.hasName(f"{prefix}pc_bddc_{name}"):
            options[f"{prefix}pc_bddc_{name}"] = value


@dataclass(frozen=True)
class Direct:
    """One factorisation of the assembled saddle point (MUMPS L D L^T with pivoting)."""

    def solver(self, saddle: SaddlePoint, prefix: str = "fmbd_") -> _Krylov:
        """Factor; collective. A singular system is diagnosed at the first solve."""
        from petsc4py import PETSc

        A = saddle.matrix.copy()
        A.convert("aij")
        A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        ksp = PETSc.KSP().create(saddle.comm)
        ksp.setOptionsPrefix(prefix)
        ksp.setOperators(A)
        ksp.setType("preonly")
        ksp.getPC().setType("cholesky")
        ksp.getPC().setFactorSolverType("mumps")
        ksp.getPC().setFactorSetUpSolverType()
        ksp.getPC().getFactorMatrix().setMumpsIcntl(14, 150)  # % of memory beyond the estimate: pivoting needs it
        return _Krylov(saddle, ksp, prefix, [A], Judge("the saddle point", 1e-9))


@dataclass(frozen=True)
class FieldSplit:
    """MINRES (or FGMRES) with diag(E_k, S~); ``rtol`` on the preconditioned residual.

    ``elastic``: :class:`Cholesky` or :class:`Multigrid`. ``multiplier``: how S~ is made, see
    :mod:`.precondition`.
    """

    elastic: Cholesky | Multigrid | Bddc = Cholesky()
    multiplier: MultiplierPreconditioner = Fractional()
    method: str = "minres"
    rtol: float = 1e-8
    max_iterations: int = 400

    def solver(self, saddle: SaddlePoint, prefix: str = "fmbd_") -> _Krylov:
        """Set up all blocks; collective."""
        from petsc4py import PETSc

        groups = self.multiplier.matrices(saddle)
        n = len(saddle.elastic)
        own = [S for _, _, S in groups]
        diagonal = []
        for E, e in zip(saddle.E, saddle.elastic, strict=True):
            diagonal.append(E if e.cm > 0 else _matrix(e.body, e.inertia, e.ck))
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
    """A KSP on the whole saddle point, judged, with refinement when the true residual is not small enough."""

    def __init__(self, saddle: SaddlePoint, ksp: Any, prefix: str, own: list[Any], judge: Judge) -> None:
        self.saddle, self.ksp, self.prefix, self._own, self.judge = saddle, ksp, prefix, own, judge
        ksp.setFromOptions()
        self.enough = 1e-13 if ksp.getType() == "preonly" else judge.tolerance
        self.rtol = ksp.getTolerances()[0]
        self._checked = False

    def solve(self, f: Sequence[Array], g: Sequence[Array]) -> Solution:
        s = self.saddle
        b = s.vector(f, g)
        x = b.duplicate()
        x.set(0.0)
        self.ksp.solve(b, x)
        iterations, reason = self.ksp.getIterationNumber(), self.ksp.getConvergedReason()
        residual = s.relative_residual(x, b)
        for _ in range(3):
            if not np.isfinite(residual) or residual <= self.enough:
                break
            r, dx = b.duplicate(), b.duplicate()
            s.matrix.mult(x, r)
            r.aypx(-1.0, b)
            if self.ksp.getType() != "preonly":
                self.ksp.setTolerances(rtol=max(self.rtol, 0.03 * self.enough / residual))
            self.ksp.solve(r, dx)
            iterations += self.ksp.getIterationNumber()
            x.axpy(1.0, dx)
            r.destroy(), dx.destroy()
            residual = s.relative_residual(x, b)
        self.ksp.setTolerances(rtol=self.rtol)
        if not self._checked:
            check_options(self.prefix, s.comm)
            self._checked = True
        if not residual <= self.judge.tolerance:
            found = diagnose(s)
            raise LinearSolveError(
                f"Linear solve of {self.judge.what}: relative residual {residual:.1e} after {iterations} "
                "iterations (PETSc reason "
                f"{reason}), allowed {self.judge.tolerance:.0e}. {found}"
            )
        self.judge.check(residual, 1.0)
        u, lam = s.blocks(x)
        x.destroy(), b.destroy()
        return Solution(u, lam, iterations, residual)

    def destroy(self) -> None:
        for obj in (self.ksp, *self._own):
            obj.destroy()


@dataclass(frozen=True)
class Schur:
    """Exact Schur complement of all multipliers (dense, replicated): for few multipliers and systems with
    inertia.

    ``elastic``: :class:`Cholesky`, or :class:`Multigrid` as preconditioner of conjugate gradients to
    ``rtol``.
    """

    elastic: Cholesky | Multigrid | Bddc = Cholesky()
    rtol: float = 1e-11
    limit: int = 3000

    def solver(self, saddle: SaddlePoint, prefix: str = "fmbd_") -> _SchurSolver:
        """Solve the columns E_k^-1 B_k^T; collective."""
        static = [e.body.name for e in saddle.elastic if e.cm == 0]
        if static:
            raise InputError(
                f"Schur() needs inertia: the elastic block of {static} is singular in statics. Use Direct() or FieldSplit()."
            )
        if saddle.n_multipliers > self.limit:
            raise InputError(
                f"Schur() is for up to {self.limit} multipliers, found {saddle.n_multipliers}. Use FieldSplit()."
            )
        return _SchurSolver(saddle, self, prefix)


class _SchurSolver:
    def __init__(self, saddle: SaddlePoint, preset: Schur, prefix: str) -> None:
        from petsc4py import PETSc

        self.saddle, self.prefix = saddle, prefix
        self.judge = Judge("the saddle point by its Schur complement", max(1e-9, 100 * preset.rtol))
        self.ksps, self.iterations = [], 0
        for e, E in zip(saddle.elastic, saddle.E, strict=True):
            ksp = PETSc.KSP().create(saddle.comm)
            ksp.setOptionsPrefix(f"{prefix}{e.name}_")
            ksp.setOperators(E)
            preset.elastic.set_up(ksp, e)
            if not isinstance(preset.elastic, Cholesky):
                ksp.setType("cg")
                ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
                ksp.setTolerances(rtol=preset.rtol, atol=1e-300, max_it=500)
            ksp.setFromOptions()
            self.ksps.append(ksp)
        n = saddle.n_multipliers
        S: Array = np.zeros((n, n))
        self._B = self._columns()
        for k, B in enumerate(self._B):
            Y = np.stack([self._inverse(k, b) for b in B.toarray()], axis=1) if n else np.zeros((B.shape[1], 0))
            S += saddle.elastic[k].body.total(B @ Y)
        self.complement = S = 0.5 * (S + S.T)
        self._scale = 1.0 / np.sqrt(np.maximum(np.diag(S), 1e-300))
        try:
            self._factor = sl.cho_factor(self._scale[:, None] * S * self._scale)
        except sl.LinAlgError as error:
            raise LinearSolveError(
                f"The Schur complement of the multipliers is singular. {diagnose(saddle)}"
            ) from error
        check_options(prefix, saddle.comm)

    def _columns(self) -> list[Any]:
        """B_k of each body with the rows of all ties."""
        import scipy.sparse as sp

        s = self.saddle
        stacks: list[list[Any]] = [[] for _ in s.elastic]
        for t in s.ties:
            found = dict(t.columns)
            for k, e in enumerate(s.elastic):
                stacks[k].append(found.get(k, sp.csr_matrix((t.rows, e.rows))))
        return [sp.vstack(x, format="csr") for x in stacks]

    def _inverse(self, k: int, b: Array) -> Array:
        x, y = self.saddle.E[k].createVecs()
        y.array[:] = b
        self.ksps[k].solve(y, x)
        self.iterations += self.ksps[k].getIterationNumber()
        out = x.array.copy()
        x.destroy(), y.destroy()
        return out

    def solve(self, f: Sequence[Array], g: Sequence[Array]) -> Solution:
        s = self.saddle
        self.iterations = 0
        z = [self._inverse(k, fk) for k, fk in enumerate(f)]
        r = s.elastic[0].body.total(sum(B @ zk for B, zk in zip(self._B, z, strict=True))) - np.concatenate(
            [*g, np.zeros(0)]
        )
        lam = self._scale * sl.cho_solve(self._factor, self._scale * r)
        u: list[Array] = [zk - self._inverse(k, B.T @ lam) for k, (B, zk) in enumerate(zip(self._B, z, strict=True))]
        parts: list[Array] = np.split(lam, np.cumsum([t.rows for t in s.ties])[:-1])
        x, b = s.vector(u, parts), s.vector(f, g)
        residual = s.relative_residual(x, b)
        x.destroy(), b.destroy()
        self.judge.check(residual, 1.0, diagnose(s) if not residual <= self.judge.tolerance else "")
        return Solution(u, parts, self.iterations, residual)

    def destroy(self) -> None:
        for ksp in self.ksps:
            ksp.destroy()
