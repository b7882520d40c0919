"""The compliance of many contact points, known by its products: one back-solve with the factors of the step each.

    W f = s N A^-1 N^T f                                                                                  (1)

For n candidates the matrix W of :mod:`.delassus` asks for up to d n columns of E^-1 before the first step is done, and for n^2
numbers. Here Newton's iteration (:mod:`.coulomb_matrix_free`) asks for products only. With the block E_s of the slave's contact
nodes,

    P = (N N^T)^-1 N E_s N^T (N N^T)^-1 / s                                                               (2)

is a sparse approximation of W^-1, the lumped preconditioner of FETI (Farhat, Mandel and Roux, doi:10.1016/0045-7825(94)90068-X);
N N^T is nearly diagonal with dual multipliers. Forces are kept on all ranks alike.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ...mechanics.contact.contact_set import ContactSet
from ...mechanics.contact.rows import LinearRows
from ...rotations import Array
from ...system.serialisation import Remembering, plain
from ..condensation import StepSolver

MANY = 300  # candidates above which W is applied instead of stored


class SlaveBlocks(Remembering):
    """E_s of (2) for the traces of a contact set, and a count of products; one object for a whole run. Collective."""

    keeps: ClassVar = {"products": plain()}

    def __init__(self, solver: StepSolver, contacts: ContactSet) -> None:
        self.solver, self.contacts = solver, contacts
        self.products = 0
        self._kept: dict[int, tuple[tuple[Any, ...], Any]] = {}

    def of(self, i: int) -> Any:
        """cm M + ck K on the nodes of trace i, (n d, n d) sparse, the same on all ranks."""
        tr = self.contacts.on_fields[i]
        w = self.solver.weights
        field = tr.field
        key = (w, field.tangents)
        if i not in self._kept or self._kept[i][0] != key:
            low = field.space.dofmap.index_map.local_range[0]
            nodes = tr.own + low
            M = _principal(field.M, nodes, tr.n)
            K = _principal(field.K, (nodes[:, None] * tr.dim + np.arange(tr.dim)).ravel(), tr.n * tr.dim)
            self._kept[i] = key, (w.cm * sp.kron(M, sp.identity(tr.dim)) + w.ck * K).tocsr()
        return self._kept[i][1]


def _principal(A: Any, mine: np.ndarray, n: int) -> Any:
    """The principal submatrix of a PETSc matrix for the owned rows ``mine`` of each rank, gathered on all; collective."""
    from petsc4py import PETSc

    comm = A.getComm().tompi4py()
    rows = PETSc.IS().createGeneral(mine.astype(PETSc.IntType), comm=comm)
    part = A.createSubMatrix(rows, rows)
    found = [comm.allgather(x) for x in part.getValuesCSR()]
    rows.destroy()
    part.destroy()
    blocks = [sp.csr_matrix((v, j, p), shape=(len(p) - 1, n)) for p, j, v in zip(*found, strict=True)]
    return sp.vstack(blocks, format="csr")


class Applied:
    """W for rows of elastic surfaces in the configuration the solver was last prepared for; methods are collective."""

    def __init__(self, blocks: SlaveBlocks, rows: LinearRows, slave: np.ndarray, scale: float) -> None:
        """``slave`` (m,): number of the trace that carries each row's multiplier."""
        self.blocks, self.rows, self.scale = blocks, rows, scale
        self.inverse = self._lumped(slave)

    def __matmul__(self, force: Array) -> Array:
        """W f, (m,)."""
        solver, contacts = self.blocks.solver, self.blocks.contacts
        system = solver.system
        self.blocks.products += 1
        x, _ = solver.solve(contacts.transposed(system, self.rows, force), np.zeros(system.n_lam))
        return self.scale * contacts.times(system, self.rows, x)

    def _lumped(self, slave: np.ndarray) -> Any:
        """P of (2), (m, m) sparse: the sum over the traces that carry multipliers."""
        P: Any = sp.csr_matrix((len(slave), len(slave)))
        for trace in map(int, np.unique(slave)):
            N = sp.diags((slave == trace).astype(float)) @ self._in_axes_of_factor(trace)
            size = np.asarray(N.multiply(N).sum(1)).ravel()
            shares = np.divide(1.0, size, out=np.zeros(len(size)), where=size > 0)
            N = sp.diags(shares) @ N
            P = P + N @ self.blocks.of(trace) @ N.T / self.scale
        return P.tocsr()

    def _in_axes_of_factor(self, trace: int) -> Any:
        """Rows on the nodes of a trace, sparse, in the axes in which the factor knows its body."""
        solver, nodes = self.blocks.solver, self.blocks.contacts.on_fields[trace]
        rows = self.rows.field[trace].matrix(nodes.n)
        turn = solver.corotations[solver.system.field_number(nodes.part)]
        return rows if turn is None else rows @ sp.kron(sp.identity(nodes.n), turn)
