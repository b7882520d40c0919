"""The whole matrix of a scene's step as named PETSc blocks, solved by a Krylov method with one split for each block.

    [ A    C     G_c^T ] [ x ]   frame: twists of all frames and small parts            A, C, E: cm M + cd D + ck K
    [ C^T  E     G_u^T ] [ u ]   <body>.u: nodal values, one block for each body                                    (1)
    [ G_c  G_u   0     ] [ l ]   <joint>.force, <body>.frame.force: multipliers

The matrix is applied, never assembled: C has constant columns, G is known by its ports. The preconditioner is block-diagonal,

    diag(|A|, E_k~, S~_j),    S~_j = G_c,j |A|^-1 G_c,j^T + sum_k G_k,j E_k~^-1 G_k,j^T                             (2)

with E_k~ a factor or a multigrid cycle, S~_j as it stands for joints and by :mod:`.precondition` for ties of field
multipliers. C has rank n_twist for each floating body, so it adds a number of iterations that does not depend on the mesh.
Options of PETSc: ``-<scene>_ksp_...`` for the Krylov method, ``-<scene>_fieldsplit_<block>_...`` for the splits. The theory is
that of block-diagonal preconditioners, Benzi, Golub and Liesen, doi:10.1017/S0962492904000212.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ..errors import InputError, LinearSolveError
from ..log import together
from ..rotations import Array, rotate_nodal
from ..system.system import System
from .blocks.elastic_blocks import Bddc, Cholesky
from .blocks.spd import FieldFactor
from .iterated_multipliers import CHANGED, SceneTies
from .options import check_options, set_from_options
from .residual import Judge, krylov_reason
from .saddle.precondition import Fractional, lumped, rigid_term, to_petsc
from .saddle.saddle import Elastic, elastic_matrix, share_of

ROUNDOFF = 1e-13  # relative error that a product with the matrix may have
FAR_FROM_ONE = (
    1e6  # norms of a first residual beyond which, or below its inverse, a failed solve is repeated in other units
)
LEAST = 1e-10  # eigenvalues of preconditioning blocks, scaled to a unit diagonal, are at least this


class SplitBlock(FieldFactor):
    """E~^-1 of one body for (2): the PC of its split, also used for the constant columns of ports. Collective throughout."""

    def __init__(self, block: Elastic, elastic: Any, prefix: str, cd: float) -> None:
        from petsc4py import PETSc

        self.field = block.body
        self.judge = Judge(
            f'the elastic block of body "{block.body.name}"'
        )  # counts; the whole solve is what is judged
        self.E = elastic_matrix(block.body, block.cm, block.ck, cd)
        self.ksp = PETSc.KSP().create(block.body.comm)
        self.ksp.setOptionsPrefix(prefix)
        self.ksp.setOperators(self.E)
        elastic.set_up(self.ksp, block)
        self.ksp.setFromOptions()
        self.ksp.setUp()

    def solve_columns(self, B: Array) -> Array:
        """E~^-1 B for dense columns (n, k)."""
        X = np.empty_like(B)
        x, b = self.E.createVecs()
        for j in range(B.shape[1]):
            b.array[:] = B[:, j]
            self.ksp.solve(b, x)
            X[:, j] = x.array
            self.judge.solves += 1
        x.destroy(), b.destroy()
        return X

    def destroy(self) -> None:
        """Free the solver; collective."""
        self.ksp.destroy(), self.E.destroy()


class _Product:
    """What PETSc calls for a product with (1)."""

    def __init__(self, solver: SplitSolver) -> None:
        self.solver = solver

    def mult(self, _: Any, x: Any, y: Any) -> None:
        """y = matrix times x."""
        y.array[:] = self.solver.product(x.array_r.copy())


class SplitSolver:
    """Solves (1) for one configuration after another; ``iterations`` counts those of all solves. Collective throughout."""

    def __init__(self, system: System, preset: Any, prefix: str) -> None:
        if not system.fields:
            raise InputError(
                "FieldSplit() splits elastic bodies; this scene has none with nodal unknowns. Use linear=fmbd.Direct()."
            )
        together(system.comm, _refusal(system, preset, prefix))
        self.system, self.preset, self.prefix = system, preset, prefix
        self.judge = Judge("the whole matrix of a step", 100 * preset.rtol)
        self.iterations = 0
        self._made: tuple[Any, ...] | None = None
        self._own: list[Any] = []
        self.rows: dict[str, slice] = {}
        for block in system.blocks:
            name = f"{block.name.removeprefix('frame of ')}.frame" if block.kind == "frame" else block.name
            if not any(block.rows == r for r in self.rows.values()) and block.rows.stop > block.rows.start:
                self.rows[f"{name}.force".replace(" ", "_")] = block.rows
        self.names = [*(["frame"] if system.n_core else []), *(_split(f.name) for _, f in system.fields), *self.rows]

        comm = system.comm
        core = [share_of(system.n_core, comm)] if system.n_core else []
        multipliers = [share_of(r.stop - r.start, comm) for r in self.rows.values()]
        self.sizes = [*core, *(f.n for _, f in system.fields), *multipliers]  # of the blocks on this rank
        self.scale = np.ones(len(self.names))

    # -- arrays -------------------------------------------------------------------------------------------------
    def pack(self, v: Array, lam: Array) -> Array:
        """This rank's entries of a PETSc vector of forces; nodal values turned back to where the factor is."""
        s, comm = self.system, self.system.comm
        core = [_share(v[: s.n_core], comm)] if s.n_core else []
        local = [
            rotate_nodal(s.local_v(v, k), R, back=True) for (k, _), R in zip(s.fields, self.corotations, strict=True)
        ]
        parts = (*core, *local, *(_share(lam[r], comm) for r in self.rows.values()))
        return np.concatenate([d * x for d, x in zip(self.scale, parts, strict=True)])

    def unpack(self, x: Array) -> tuple[Array, Array]:
        """An array like v and all multipliers from a PETSc vector of unknowns; collective."""
        s = self.system
        first = int(s.n_core > 0)
        n = len(s.fields)
        parts = [d * y for d, y in zip(self.scale, np.split(x, np.cumsum(self.sizes)[:-1]), strict=True)]
        mine = [*parts[:first], *parts[first + n :]]
        ranks = s.comm.allgather(mine)
        whole = [np.concatenate([r[j] for r in ranks]) for j in range(len(mine))]
        lam = np.zeros(s.n_lam)
        for r, y in zip(self.rows.values(), whole[first:], strict=True):
            lam[r] = y
        local = [rotate_nodal(u, R) for u, R in zip(parts[first : first + n], self.corotations, strict=True)]
        return np.concatenate((*whole[:first], *local)), lam

    # -- matrix -------------------------------------------------------------------------------------------------
    def terms(self, v: Array, lam: Array) -> tuple[list[Array], list[Array]]:
        """Terms of (1) times (v, lam): those of the balance, like v, and those of the constraints; their sums are the product."""
        s, n = self.system, self.system.n_core
        own, mixed = np.zeros(s.n_v), np.zeros(s.n_v)
        own[:n] = self.A @ v[:n]

        # E u and C of each field, in the axes of its factor
        for i, (k, f) in enumerate(s.fields):
            at = s.slices[1][k]
            R = self.corotations[i]
            C = self._C[i]
            u = rotate_nodal(v[at], R, back=True)
            E = self._blocks[i].factor.E
            x, y = E.createVecs()
            x.array[:] = u
            E.mult(x, y)
            own[at] = rotate_nodal(y.array.copy(), R)
            x.destroy(), y.destroy()
            if len(C):
                mixed[at] = rotate_nodal(f.inertia_columns @ (C @ v[:n]), R)
                mixed[:n] += C.T @ f.field.total(f.inertia_columns.T @ u)

        # G, which fields meet through their ports
        rows = [np.asarray(self.G.core @ v[:n])]
        s.move(self.G.t)
        for k, p in s.fields:
            ports = self.G.ports_of(k, p, s.local_v(v, k))
            rows.append(np.asarray(self.G.port[:, s.port_slice(k)] @ ports))
        return [own, mixed, self.G.transposed(lam)], rows

    def product(self, x: Array) -> Array:
        """The matrix times x, PETSc's arrays; collective."""
        balance, rows = self.terms(*self.unpack(x))
        return self.pack(np.sum(balance, axis=0), np.sum(rows, axis=0))

    def relative_residual(self, x: Array, b: Array) -> float:
        """Largest |b - A x| of a block over the size of its own terms, PETSc's arrays; collective.

        Rows that x leaves at zero have terms of roundoff only: constraints are measured at least against 1e-6 of
        (tr S~_j x . diag(A, E) x)^1/2, which |G_j x| cannot exceed; more where the tolerance would else be below roundoff.
        """
        share = max(1e-6, ROUNDOFF / self.judge.tolerance)
        v, lam = self.unpack(x)
        balance, rows = self.terms(v, lam)
        zero_v = np.zeros(self.system.n_v)
        zero = np.zeros(self.system.n_lam)
        parts = [b, *(-self.pack(y, zero) for y in balance), *(-self.pack(zero_v, y) for y in rows)]

        norms = self._norms([np.sum(parts, axis=0), *parts])
        if not np.isfinite(norms).all():
            return np.inf
        error = norms[0]
        sizes = norms[1:].sum(0)
        m = len(self.names) - len(self.rows)
        sizes[m:] = np.maximum(sizes[m:], share * self._bounds * np.sqrt(abs(self.system.dot(v, balance[0]))))

        worst = 0.0
        for kind in (slice(0, m), slice(m, None)):  # forces, constraints
            least = max(share * sizes[kind].max(initial=0.0), 1e-300)
            worst = max(worst, float((error[kind] / np.maximum(sizes[kind], least)).max(initial=0.0)))
        return worst

    def _norms(self, arrays: list[Array]) -> Array:
        """Norms of the blocks of PETSc arrays of forces, in their own units, (arrays, blocks); collective."""
        ends = np.cumsum(self.sizes)[:-1]
        squares = np.array([[float(p @ p) for p in np.split(x, ends)] for x in arrays])
        return np.asarray(np.sqrt(self.system.fields[0][1].field.total(squares)) / self.scale)

    # -- set-up -------------------------------------------------------------------------------------------------
    def prepare(self, solver: Any, A: Array, couplings: list[Array]) -> None:
        """Take a configuration of a :class:`.condensation.StepSolver`: A of (1), and its S for each field."""
        n = self.system.n_core
        self.A, self.G, self.corotations, self._blocks = A, solver.jacobian, solver.corotations, solver.blocks
        self._C = [S[: f.inertia_columns.shape[1], :n] for S, (_, f) in zip(couplings, self.system.fields, strict=True)]
        if self.preset.method == "minres" and np.abs(A - A.T).max(initial=0.0) > 1e-9 * np.abs(A).max(initial=1e-300):
            raise InputError(
                "FieldSplit(method='minres') needs a symmetric matrix; forces of this scene (say, follower loads or rotating "
                "dampers) make it unsymmetric. Use FieldSplit(method='fgmres')."
            )
        made = tuple(b.factor for b in self._blocks), A, self.G.core, self.G.port
        if self._made is None or self._far(made):
            self._release()
            self._made = made
            self._build(solver, couplings)

    def _far(self, now: tuple[Any, ...]) -> bool:
        """Whether a preconditioner made earlier should be made anew."""
        assert self._made is not None
        if any(x is not y for x, y in zip(now[0], self._made[0], strict=True)):
            return True
        pairs = zip(now[1:], self._made[1:], strict=True)
        return any(min(x.shape) and abs(x - y).max() > CHANGED * abs(y).max() for x, y in pairs)

    def _build(self, solver: Any, couplings: list[Array]) -> None:
        """The splits of (2), and the Krylov method."""
        from petsc4py import PETSc

        s = self.system
        comm = s.comm
        first = int(s.n_core > 0)
        frame = positive(self.A)
        force = self._complements(frame, solver, couplings)
        self._bounds = np.sqrt([S.diagonal().sum() for S in force])
        small = self._scaled([*([sp.csr_matrix(frame)] if first else []), *force])
        own = [to_petsc(S, s) for S in small]
        diagonal = [*own[:first], *(b.factor.E for b in self._blocks), *own[first:]]

        start = (comm.exscan(sum(self.sizes)) or 0) + np.cumsum([0, *self.sizes])
        sets = [PETSc.IS().createStride(k, int(i), 1, comm=comm) for k, i in zip(self.sizes, start, strict=False)]

        table = [[M if i == j else None for j in range(len(diagonal))] for i, M in enumerate(diagonal)]
        P = PETSc.Mat().createNest(table, isrows=sets, iscols=sets, comm=comm)
        P.assemble()
        matrix = PETSc.Mat().createPython(P.getSizes(), _Product(self), comm=comm)
        matrix.setUp()
        self.x, self.b = P.createVecs()
        self.ksp = self._krylov(matrix, P, sets)
        self._own = [self.ksp, matrix, P, *own, *sets, self.x, self.b]
        self._checked = False

    def _scaled(self, small: list[sp.csr_matrix]) -> list[sp.csr_matrix]:
        """Replicated blocks in units where their diagonal is like those of E_k: FGMRES minimises over all blocks at once."""
        total, count = np.zeros(2)
        for block in self._blocks:
            v = block.factor.E.getDiagonal()
            total, count = total + v.sum(), count + v.getSize()
            v.destroy()
        first = int(self.system.n_core > 0)
        n = len(self.system.fields)
        d = [np.sqrt(total / count / S.diagonal().mean()) for S in small]
        self.scale = np.array([*d[:first], *np.ones(n), *d[first:]])
        return [S * x**2 for S, x in zip(small, d, strict=True)]

    def _krylov(self, matrix: Any, P: Any, sets: list[Any]) -> Any:
        """KSP with a split for each block; options of the user override it."""
        from petsc4py import PETSc

        preset = self.preset
        first = int(self.system.n_core > 0)
        ksp = PETSc.KSP().create(self.system.comm)
        ksp.setOptionsPrefix(self.prefix)
        ksp.setOperators(matrix, P)
        ksp.setType(preset.method)
        ksp.setTolerances(rtol=preset.rtol, atol=0.0, max_it=preset.max_iterations)
        # without restarts: each would lose what the others have found
        if preset.method != "minres":
            ksp.setGMRESRestart(preset.max_iterations)

        factors = dict(enumerate((b.factor for b in self._blocks), first))
        for k, sub in enumerate(self._splits(ksp, sets)):
            if k in factors:
                made = factors[k].ksp
                sub.setType(made.getType())
                sub.setTolerances(*made.getTolerances())
                sub.setNormType(made.getNormType())
                sub.setPC(made.getPC())  # one factor serves the split and the columns
            else:
                Cholesky().set_up(sub)
                sub.setFromOptions()
        ksp.setConvergenceTest(self._converged)
        return ksp

    def _splits(self, ksp: Any, sets: list[Any]) -> list[Any]:
        """The KSP of each block; a single block (a free body) is all of the preconditioner, for PETSc splits are two at least."""
        from petsc4py import PETSc

        pc = ksp.getPC()
        if len(self.names) == 1:
            pc.setType("ksp")
            set_from_options(ksp)
            return [pc.getKSP()]

        pc.setType("fieldsplit")
        pc.setFieldSplitType(PETSc.PC.CompositeType.ADDITIVE)
        pc.setFieldSplitIS(*zip(self.names, sets, strict=True))
        set_from_options(ksp)
        pc.setUp()
        return list(pc.getFieldSplitSubKSP())

    def _complements(self, frame: Array, solver: Any, couplings: list[Array]) -> list[sp.csr_matrix]:
        """S~_j of (2), one for each block of rows, replicated; collective."""
        s, n = self.system, self.system.n_core
        ties = {span.start: i for i, (_, span) in enumerate(s.traces)}
        seen = SceneTies(s, solver.weights) if ties else None
        core = self.G.core.toarray() if sp.issparse(self.G.core) else np.asarray(self.G.core)
        out = []
        for r in self.rows.values():
            S = core[r] @ np.linalg.solve(frame, core[r].T) if n else np.zeros((r.stop - r.start,) * 2)
            # fields answer by the constant columns of their ports
            for block, coupling in zip(self._blocks, couplings, strict=True):
                part = coupling[:, n + r.start : n + r.stop]
                S += part.T @ block.W @ part
            if r.start in ties and seen is not None:
                self._add_tie(S, seen, ties[r.start])
            out.append(sp.csr_matrix(positive(S)))
        return out

    def _add_tie(self, S: Array, seen: SceneTies, i: int) -> None:
        """Add the preconditioner of tie i to S: its own surfaces, and the rigid motion of their bodies."""
        multiplier = self.preset.multiplier
        own = multiplier.block(seen, i) if isinstance(multiplier, Fractional) else lumped(seen, i)
        S += own.toarray()
        for k, e in enumerate(seen.elastic):
            gram, BR = rigid_term(e, k, [seen.ties[i]])
            S += BR @ np.linalg.solve(gram, BR.T)

    # -- solution -----------------------------------------------------------------------------------------------
    def _converged(self, ksp: Any, iteration: int, norm: float) -> Any:
        """PETSc's reason to stop; collective."""
        if iteration == 0:
            self._first = norm

        def accurate() -> bool:
            true = self.relative_residual(ksp.buildSolution().array_r.copy(), self.given)
            return bool(true <= 0.5 * self.judge.tolerance)

        return krylov_reason(ksp, iteration, norm, self._first, accurate)

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """Increment like v and multipliers for right-hand sides b (like v) and c (n_lam,)."""
        given = self.pack(b, c)
        x, count, reason = self._iterated(given)
        if not self._checked:
            check_options(self.prefix, self.system.comm)
            self._checked = True
        residual = self.relative_residual(x, given)

        # PETSc's MINRES compares norms with numbers such as 1e-18, whatever they are norms of
        ordinary = 1.0 / FAR_FROM_ONE < self._first < FAR_FROM_ONE
        if not residual <= self.judge.tolerance and not ordinary and 0.0 < self._first < np.inf:
            x, count, reason = self._iterated(given / self._first, 1.0 / self._first)
            residual = self.relative_residual(x, given)
        if not residual <= self.judge.tolerance:
            raise LinearSolveError(
                f"Linear solve of {self.judge.what}: relative residual {residual:.1e} after {count} iterations (PETSc reason "
                f"{reason}), allowed {self.judge.tolerance:.0e}. Raise FieldSplit(max_iterations=...), or use Direct()."
            )

        self.judge.check(residual, 1.0)
        return self.unpack(x)

    def _iterated(self, given: Array, scale: float = 1.0) -> tuple[Array, int, int]:
        """Packed unknowns for a right-hand side that is ``scale`` times the one meant, iterations, and PETSc's reason to end."""
        self.given, self._first = given, 0.0
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


def positive(A: Array) -> Array:
    """|A| of a symmetric matrix scaled to a unit diagonal, its eigenvalues at least :data:`LEAST`; scaled back."""
    size = np.sqrt(np.abs(np.diag(A)))
    size = np.where(size > 0, size, size.max(initial=0.0) or 1.0)
    # MINRES needs a definite preconditioner: absolute values, none near zero
    values, vectors = np.linalg.eigh(0.5 * (A + A.T) / np.outer(size, size))
    return np.asarray((vectors * np.maximum(np.abs(values), LEAST)) @ vectors.T * np.outer(size, size))


def _refusal(system: System, preset: Any, prefix: str) -> Exception | None:
    """What has no splits: slack wires, pressure fields, and options that need an assembled matrix."""
    from petsc4py import PETSc

    for _, f in system.fields:
        if f.slack is not None or f.field.mixed:
            kind = "a pressure" if f.field.mixed else "wires that go slack"
            return InputError(f'FieldSplit() does not take body "{f.name}" with {kind}. Use linear=fmbd.Direct().')
    if isinstance(preset.elastic, Bddc):
        return InputError(
            "FieldSplit(elastic=Bddc()) does not work in scenes. Use Cholesky(), Multigrid(), or Schur(Bddc())."
        )
    if PETSc.Options().getString(f"{prefix}pc_fieldsplit_type", "additive") != "additive":
        return InputError(f"-{prefix}pc_fieldsplit_type: splits of a scene are additive, its matrix is not assembled.")
    if PETSc.Options().getString(f"{prefix}pc_type", "fieldsplit") != "fieldsplit":
        return InputError(
            f"-{prefix}pc_type: a scene under FieldSplit() has splits: -{prefix}fieldsplit_<block>_pc_type."
        )
    if preset.method not in ("minres", "fgmres", "gmres"):
        return InputError(f'FieldSplit(method="{preset.method}") in a scene: "minres", "fgmres" or "gmres".')
    return None


def split_prefix(prefix: str, body: str) -> str:
    """Prefix of a body's split from that of its block, ``<scene>_<body>.u_``."""
    return f"{prefix.removesuffix(f'{body}.u_')}fieldsplit_{_split(body)}_"


def _split(body: str) -> str:
    return f"{body}.u".replace(" ", "_")


def _share(x: Array, comm: Any) -> Array:
    """This rank's entries of a replicated array."""
    low = sum(share_of(len(x), comm, r) for r in range(comm.rank))
    return x[low : low + share_of(len(x), comm)]
