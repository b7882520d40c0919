"""The splits (2) of :mod:`.solver`: a diagonal block for the core, for each field and for each block of rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ...fem.assembly import petsc_of
from ...matrices import dense
from ...rotations import Array
from ..blocks.elastic_blocks import Elastic
from ..blocks.field_blocks import Weights
from ..blocks.spd import FieldFactor
from ..field_couplings import FieldCoupling
from ..iterated_multipliers import SceneTies
from ..residual import Judge
from ..rigid_modes import elastic_matrix
from ..tie_preconditioner import rigid_term
from .layout import SplitLayout, share, split_name
from .matrix import StepMatrix


class SplitBlock(FieldFactor):
    """E~^-1 of one body for (2) of :mod:`.solver`: the PC of its split, also used for the constant columns of ports.

    Collective throughout.
    """

    def __init__(self, block: Elastic, elastic: Any, prefix: str, cd: float) -> None:
        from petsc4py import PETSc

        self.field = block.body
        # counts; the whole solve is what is judged
        self.judge = Judge(f'the elastic block of body "{block.body.name}"')
        self.E = elastic_matrix(block.body, block.cm, block.ck, cd)

        self.ksp = PETSc.KSP().create(block.body.comm)
        self.ksp.setOptionsPrefix(prefix)
        self.ksp.setOperators(self.E)
        elastic.set_up(self.ksp, block)
        self.ksp.setFromOptions()
        self.ksp.setUp()

    def product(self, u: Array) -> Array:
        """E u, in the axes of the factor."""
        x, y = self.E.createVecs()
        x.array[:] = u
        self.E.mult(x, y)
        found = y.array.copy()
        x.destroy(), y.destroy()
        return found

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


def split_prefix(prefix: str, body: str) -> str:
    """Prefix of a body's split from that of its block, ``<scene>_<body>.u_``."""
    return f"{prefix.removesuffix(f'{body}.u_')}fieldsplit_{split_name(body)}_"


LEAST = 1e-10  # eigenvalues of preconditioning blocks, scaled to a unit diagonal, are at least this


class Preconditioner:
    """diag(|A|, E_k~, S~_j) as a nested matrix ``P`` of PETSc with the index ``sets`` of its blocks; ``bounds``: (tr S~_j)^1/2.

    Collective throughout. It gives the layout the units of its blocks.
    """

    def __init__(self, matrix: StepMatrix, couplings: list[FieldCoupling], weights: Weights, multiplier: Any) -> None:
        layout = matrix.layout
        first = layout.first
        frame = positive(matrix.A)
        force = _complements(frame, matrix, couplings, _Ties(matrix, weights, multiplier))
        self.bounds = np.sqrt([S.diagonal().sum() for S in force])

        small = [*[sp.csr_matrix(frame)][:first], *force]
        scale = _units(matrix, small)
        layout.scale = np.array([*scale[:first], *np.ones(len(matrix.blocks)), *scale[first:]])

        own = [_to_petsc(S * x**2, layout.comm) for S, x in zip(small, scale, strict=True)]
        diagonal = [*own[:first], *(b.factor.sparse.E for b in matrix.blocks), *own[first:]]
        self.sets = _index_sets(layout)
        self.P = _nested(diagonal, self.sets, layout.comm)
        self._own = [self.P, *own, *self.sets]

    def destroy(self) -> None:
        """Free what PETSc holds; collective."""
        for each in self._own:
            each.destroy()


class _Ties:
    """Preconditioners of the rows of surface ties."""

    def __init__(self, matrix: StepMatrix, weights: Weights, multiplier: Any) -> None:
        system = matrix.layout.system
        self.multiplier = multiplier
        self.numbers = {span.start: i for i, (_, span) in enumerate(system.traces)}
        self.seen = SceneTies(system, weights) if self.numbers else None

    def add(self, S: Array, rows: slice) -> None:
        """Add to S, where the rows are those of a tie: its own surfaces, and the rigid motion of their bodies."""
        i = self.numbers.get(rows.start)
        if i is None or self.seen is None:
            return
        S += self.multiplier.block(self.seen, i).toarray()

        for k, e in enumerate(self.seen.elastic):
            gram, BR = rigid_term(e, k, [self.seen.ties[i]])
            S += BR @ np.linalg.solve(gram, BR.T)


def _complements(frame: Array, matrix: StepMatrix, couplings: list[FieldCoupling], ties: _Ties) -> list[sp.csr_matrix]:
    """S~_j of (2), one for each block of rows, replicated; collective."""
    n = matrix.layout.system.n_core
    core = dense(matrix.G.core)

    out = []
    for rows in matrix.layout.rows.values():
        count = rows.stop - rows.start
        S = core[rows] @ np.linalg.solve(frame, core[rows].T) if n else np.zeros((count, count))
        # fields answer by the constant columns of their ports
        for block, coupling in zip(matrix.blocks, couplings, strict=True):
            part = coupling.part(n + rows.start, n + rows.stop)
            S += part.T @ block.W @ part
        ties.add(S, rows)
        out.append(sp.csr_matrix(positive(S)))
    return out


def _units(matrix: StepMatrix, small: list[sp.csr_matrix]) -> list[float]:
    """Units of replicated blocks in which their diagonal is like those of E_k: FGMRES minimises over all blocks at once."""
    total, count = 0.0, 0
    for block in matrix.blocks:
        diagonal = block.factor.sparse.E.getDiagonal()
        total += diagonal.sum()
        count += diagonal.getSize()
        diagonal.destroy()
    mean = total / count
    return [float(np.sqrt(mean / S.diagonal().mean())) for S in small]


def _index_sets(layout: SplitLayout) -> list[Any]:
    """Where each block stands in the vectors of PETSc, which hold the blocks of a rank one after the other."""
    from petsc4py import PETSc

    begin = layout.comm.exscan(sum(layout.sizes)) or 0
    starts = begin + np.cumsum([0, *layout.sizes])
    pairs = zip(layout.sizes, starts, strict=False)
    return [PETSc.IS().createStride(size, int(start), 1, comm=layout.comm) for size, start in pairs]


def _to_petsc(S: sp.csr_matrix, comm: Any) -> Any:
    """This rank's share of the rows of a replicated matrix."""
    from petsc4py import PETSc

    own = S[share(S.shape[0], comm)]
    A = petsc_of(own, (own.shape, own.shape), comm)
    A.setOption(PETSc.Mat.Option.SPD, True)
    return A


def _nested(diagonal: list[Any], sets: list[Any], comm: Any) -> Any:
    """The matrix with these blocks on its diagonal."""
    from petsc4py import PETSc

    count = range(len(diagonal))
    table = [[diagonal[i] if i == j else None for j in count] for i in count]
    P = PETSc.Mat().createNest(table, isrows=sets, iscols=sets, comm=comm)
    P.assemble()
    return P


def positive(A: Array) -> Array:
    """|A| of a symmetric matrix scaled to a unit diagonal, its eigenvalues at least :data:`LEAST`; scaled back."""
    size = np.sqrt(np.abs(np.diag(A)))
    size = np.where(size > 0, size, size.max(initial=0.0) or 1.0)
    scale = np.outer(size, size)

    # MINRES needs a definite preconditioner: absolute values, none near zero
    values, vectors = np.linalg.eigh(0.5 * (A + A.T) / scale)
    values = np.maximum(np.abs(values), LEAST)
    return np.asarray((vectors * values) @ vectors.T * scale)
