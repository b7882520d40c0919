"""The whole matrix of a scene's step as named PETSc blocks, solved by a Krylov method with one split for each block.

    [ A    C     G_c^T ] [ x ]   frame: twists of all frames and small parts            A, C, E: cm M + cd D + ck K
    [ C^T  E     G_u^T ] [ u ]   <body>.u: nodal values, one block for each body                                    (1)
    [ G_c  G_u   0     ] [ l ]   <joint>.force, <body>.frame.force: multipliers

The matrix is applied, never assembled: C has constant columns, G is known by its ports. The preconditioner is block-diagonal,

    diag(|A|, E_k~, S~_j),    S~_j = G_c,j |A|^-1 G_c,j^T + sum_k G_k,j E_k~^-1 G_k,j^T                             (2)

with E_k~ a factor or a multigrid cycle, S~_j as it stands for joints and by :mod:`~..tie_preconditioner` for ties of field
multipliers. C has rank n_twist for each floating body, so it adds a number of iterations that does not depend on the mesh.
Options of PETSc: ``-<scene>_ksp_...`` for the Krylov method, ``-<scene>_fieldsplit_<block>_...`` for the splits. The theory is
that of block-diagonal preconditioners, Benzi, Golub and Liesen, doi:10.1017/S0962492904000212.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import InputError, LinearSolveError
from ...ranks import together
from ...rotations import Array
from ...system.system import System
from ..blocks.elastic_blocks import Cholesky
from ..blocks.field_blocks import Weights
from ..field_couplings import FieldCoupling, FieldCouplings
from ..iterated_multipliers import CHANGED
from ..options import check_options, set_from_options
from ..residual import Judge, KrylovTest
from .layout import SplitLayout
from .matrix import StepMatrix
from .preconditioner import Preconditioner

FAR_FROM_ONE = 1e6  # first residuals beyond this, or below its inverse: a failed solve is repeated in other units


class _Product:
    """What PETSc calls for a product with (1)."""

    def __init__(self, solver: SplitSolver) -> None:
        self.solver = solver

    def mult(self, _: Any, x: Any, y: Any) -> None:
        """y = matrix times x."""
        y.array[:] = self.solver.matrix.product(x.array_r.copy())


class SplitSolver:
    """Solves (1) for one configuration after another; ``iterations`` counts those of all solves. Collective throughout."""

    matrix: StepMatrix  # of the configuration given last

    def __init__(self, system: System, preset: Any, prefix: str) -> None:
        if not system.fields:
            raise InputError(
                "FieldSplit() splits elastic bodies; this scene has none with nodal unknowns. Use linear=fmbd.Direct()."
            )
        together(system.comm, _refusal(system, prefix))
        self.system, self.preset, self.prefix = system, preset, prefix
        self.layout = SplitLayout(system)
        self.judge = Judge("the whole matrix of a step", 100 * preset.rtol)
        self.test = KrylovTest(self.judge, lambda x: self._residual(x.array_r.copy(), self.given))
        self.iterations = 0
        self._made: tuple[Any, ...] | None = None
        self._own: list[Any] = []

    # -- set-up -------------------------------------------------------------------------------------------------
    def prepare(self, fields: FieldCouplings, A: Array) -> None:
        """Take a configuration: A of (1), and its fields."""
        self._refuse_unsymmetric(A)
        n = self.system.n_core
        pairs = zip(fields.couplings, self.system.fields, strict=True)
        twists = [S.part(0, n)[: f.inertia_columns.shape[1]] for S, (_, f) in pairs]
        self.matrix = StepMatrix(self.layout, A, fields.jacobian, twists, fields.blocks, fields.corotations)

        made = tuple(b.factor for b in fields.blocks), A, fields.jacobian.core, fields.jacobian.port
        if self._made is None or self._far(made):
            self._release()
            self._made = made
            self._build(fields.weights, fields.couplings)

    def _refuse_unsymmetric(self, A: Array) -> None:
        """MINRES is for symmetric matrices."""
        apart = np.abs(A - A.T).max(initial=0.0)
        if self.preset.method == "minres" and apart > 1e-9 * np.abs(A).max(initial=1e-300):
            raise InputError(
                "FieldSplit(method='minres') needs a symmetric matrix; forces of this scene (say, follower loads or rotating "
                "dampers) make it unsymmetric. Use FieldSplit(method='fgmres')."
            )

    def _far(self, now: tuple[Any, ...]) -> bool:
        """Whether a preconditioner made earlier should be made anew."""
        assert self._made is not None
        if any(x is not y for x, y in zip(now[0], self._made[0], strict=True)):
            return True
        pairs = zip(now[1:], self._made[1:], strict=True)
        return any(min(x.shape) and abs(x - y).max() > CHANGED * abs(y).max() for x, y in pairs)

    def _build(self, weights: Weights, couplings: list[FieldCoupling]) -> None:
        """The splits of (2), and the Krylov method."""
        from petsc4py import PETSc

        splits = Preconditioner(self.matrix, couplings, weights, self.preset.multiplier)
        self.bounds = splits.bounds
        matrix = PETSc.Mat().createPython(splits.P.getSizes(), _Product(self), comm=self.system.comm)
        matrix.setUp()
        self.x, self.b = splits.P.createVecs()
        self.ksp = self._krylov(matrix, splits.P, splits.sets)
        self._own = [self.ksp, matrix, splits, self.x, self.b]
        self._checked = False

    def _krylov(self, matrix: Any, P: Any, sets: list[Any]) -> Any:
        """KSP with a split for each block; options of the user override it."""
        from petsc4py import PETSc

        preset = self.preset
        ksp = PETSc.KSP().create(self.system.comm)
        ksp.setOptionsPrefix(self.prefix)
        ksp.setOperators(matrix, P)
        ksp.setType(preset.method)
        ksp.setTolerances(rtol=preset.rtol, atol=0.0, max_it=preset.max_iterations)
        # without restarts: each would lose what the others have found
        if preset.method != "minres":
            ksp.setGMRESRestart(preset.max_iterations)

        factors = dict(enumerate((b.factor for b in self.matrix.blocks), self.layout.first))
        for k, sub in enumerate(self._splits(ksp, sets)):
            if k in factors:
                made = factors[k].sparse.ksp
                sub.setType(made.getType())
                sub.setTolerances(*made.getTolerances())
                sub.setNormType(made.getNormType())
                sub.setPC(made.getPC())  # one factor serves the split and the columns
            else:
                Cholesky().set_up(sub)
                sub.setFromOptions()
        ksp.setConvergenceTest(self.test)
        return ksp

    def _splits(self, ksp: Any, sets: list[Any]) -> list[Any]:
        """The KSP of each block; a single block (a free body) is all of the preconditioner, for PETSc splits are two at least."""
        from petsc4py import PETSc

        pc = ksp.getPC()
        if len(self.layout.names) == 1:
            pc.setType("ksp")
            set_from_options(ksp)
            return [pc.getKSP()]

        pc.setType("fieldsplit")
        pc.setFieldSplitType(PETSc.PC.CompositeType.ADDITIVE)
        pc.setFieldSplitIS(*zip(self.layout.names, sets, strict=True))
        set_from_options(ksp)
        pc.setUp()
        return list(pc.getFieldSplitSubKSP())

    # -- solution -----------------------------------------------------------------------------------------------
    def _residual(self, x: Array, b: Array) -> float:
        """See :meth:`.StepMatrix.relative_residual`."""
        return self.matrix.relative_residual(x, b, bounds=self.bounds, tolerance=self.judge.tolerance)

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """Increment like v and multipliers for right-hand sides b (like v) and c (n_lam,)."""
        given = self.matrix.pack(b, c)
        x, count, reason = self._iterated(given)
        if not self._checked:
            check_options(self.prefix, self.system.comm)
            self._checked = True
        residual = self._residual(x, given)

        # PETSc's MINRES compares norms with numbers such as 1e-18, whatever they are norms of
        first = self.test.first
        ordinary = 1.0 / FAR_FROM_ONE < first < FAR_FROM_ONE
        if not residual <= self.judge.tolerance and not ordinary and 0.0 < first < np.inf:
            x, count, reason = self._iterated(given / first, 1.0 / first)
            residual = self._residual(x, given)
        if not residual <= self.judge.tolerance:
            raise LinearSolveError(
                f"Linear solve of {self.judge.what}: relative residual {residual:.1e} after {count} iterations (PETSc reason "
                f"{reason}), allowed {self.judge.tolerance:.0e}. Raise FieldSplit(max_iterations=...), or use Direct()."
            )

        self.judge.check(residual, 1.0)
        return self.matrix.unpack(x)

    def _iterated(self, given: Array, scale: float = 1.0) -> tuple[Array, int, int]:
        """Packed unknowns for a right-hand side that is ``scale`` times the one meant, iterations, and PETSc's reason to end."""
        self.given, self.test.first = given, 0.0
        self.b.array[:] = given
        self.x.set(0.0)
        self.ksp.solve(self.b, self.x)

        count, reason = self.ksp.getIterationNumber(), self.ksp.getConvergedReason()
        self.iterations += count
        return self.x.array / scale, count, reason

    def _release(self) -> None:
        for obj in self._own:
            obj.destroy()
        self._own, self._made = [], None

    def destroy(self) -> None:
        """Free all PETSc objects; collective."""
        self._release()


def _refusal(system: System, prefix: str) -> Exception | None:
    """What has no splits: slack wires, pressure fields, and options that need an assembled matrix."""
    from petsc4py import PETSc

    for _, f in system.fields:
        if f.slack is not None or f.field.mixed:
            kind = "a pressure" if f.field.mixed else "wires that go slack"
            return InputError(f'FieldSplit() does not take body "{f.name}" with {kind}. Use linear=fmbd.Direct().')
    if PETSc.Options().getString(f"{prefix}pc_fieldsplit_type", "additive") != "additive":
        return InputError(f"-{prefix}pc_fieldsplit_type: splits of a scene are additive, its matrix is not assembled.")
    if PETSc.Options().getString(f"{prefix}pc_type", "fieldsplit") != "fieldsplit":
        return InputError(
            f"-{prefix}pc_type: a scene under FieldSplit() has splits: -{prefix}fieldsplit_<block>_pc_type."
        )
    return None
