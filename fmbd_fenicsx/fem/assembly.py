"""Vectors of compiled forms, assembled into room that is kept: making it costs more than the forms of small bodies; matrices on
components, and on many columns at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .. import dolfinx_compat as compat
from ..rotations import Array


class NodalVector:
    """The vector of a compiled linear form."""

    def __init__(self, form: Any) -> None:
        """Collective."""
        from dolfinx import la

        self.form = form
        space = form.function_spaces[0].dofmap
        self._assemble, self._room = compat.assembly_of(form), la.vector(space.index_map, space.index_map_bs)
        self._values, self._shares = self._room.array, space.index_map.comm.size > 1
        self._owned = space.index_map.size_local * space.index_map_bs

    def assembled(self) -> Array:
        """Its entries at the nodes that this rank owns, (n d,), apart from later ones; collective."""
        self._values[:] = 0.0
        self._assemble(self._values)
        if self._shares:
            from dolfinx import la

            self._room.scatter_reverse(la.InsertMode.add)
        return np.array(self._values[: self._owned])


def on_components(M: Any, d: int) -> Any:
    """A scalar matrix on each of d components of vectors (PETSc, aij); collective. The caller destroys it."""
    from petsc4py import PETSc

    sizes = tuple(tuple(d * n for n in size) for size in M.getSizes())
    start, columns, values = M.getValuesCSR()
    counts = np.repeat(np.diff(start), d)
    first = np.concatenate(([0], np.cumsum(counts)))

    # of every entry of the rows (node, component): where it stands in the scalar matrix
    at = np.arange(first[-1]) + np.repeat(np.repeat(start[:-1], d) - first[:-1], counts)
    component = np.repeat(np.tile(np.arange(d), len(start) - 1), counts)
    csr = first.astype(PETSc.IntType), (d * columns[at] + component).astype(PETSc.IntType), values[at]
    return PETSc.Mat().createAIJ(sizes, bsize=d, csr=csr, comm=M.getComm())


def petsc_of(A: Any, sizes: Any, comm: Any) -> Any:
    """A SciPy matrix as PETSc's (aij): this rank's rows of one of these ``sizes``; collective. The caller destroys it."""
    from petsc4py import PETSc

    A = A.tocsr()
    A.sort_indices()
    csr = A.indptr.astype(PETSc.IntType), A.indices.astype(PETSc.IntType), A.data
    return PETSc.Mat().createAIJ(sizes, csr=csr, comm=comm)


def on_columns(act: Callable[[Any, Any], None], comm: Any, B: Array) -> Array:
    """What ``act(B, out)`` writes into a dense PETSc matrix like B, for columns (n, k) of this rank's rows; collective."""
    from petsc4py import PETSc

    n, k = B.shape
    given, out = (PETSc.Mat().createDense(((n, None), (None, k)), comm=comm) for _ in range(2))
    for matrix in (given, out):
        matrix.setUp()
    given.getDenseArray()[:] = B
    for matrix in (given, out):
        matrix.assemble()
    act(given, out)
    found = np.array(out.getDenseArray())
    for matrix in (given, out):
        matrix.destroy()
    return found


def times_columns(A: Any, B: Array) -> Array:
    """A B for columns (n, k) of this rank's rows; collective."""
    return on_columns(lambda given, out: A.matMult(given, out), A.getComm(), B)


def product(A: Any, U: Array, work: Sequence[Any]) -> Array:
    """A U of a vector (n,) of this rank's rows, or of columns (n, k); ``work``: a right and a left vector of A; collective."""
    if U.ndim == 2:
        return times_columns(A, U)
    x, y = work
    x.array[:] = U
    A.mult(x, y)
    return np.array(y.array)
