"""Factors of cm M + cd D + ck K of a field for complex coefficients: a symmetric matrix that is not Hermitian.

On one rank by SuperLU, with pivots from the diagonal: the real part of the matrix times a number of unit size is definite, so
that none is small against its column. With a pressure that is so of any of its rows once the others of the pressure are
eliminated: there are pivots in every order (Vanderbei, doi:10.1137/0805005), and every solve is judged.

On several ranks by MUMPS, which has real numbers here: A x = b with A = R + i J, two rows for each of A,

    [ R  -J ] [ Re x ]   [  Re b ]
    [-J  -R ] [ Im x ] = [ -Im b ]      symmetric, with the condition of A (Day and Heroux, doi:10.1137/S1064827500372262)    (1)
"""

from __future__ import annotations

import ctypes
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from ...errors import LinearSolveError
from ...fem.assembly import petsc_of, product
from ...fem.factors.factor import InC, PetscFactor
from ...fem.factors.partial_factor import IndefiniteError
from ...fem.fields import Field
from ...kernel_cache import address_of
from ...ranks import rank_max, rank_sum
from ...rotations import Array
from ...system.compiled.declarations import TABLES, structure_of
from ..residual import Judge
from .spd import FieldFactor

Symmetric = structure_of(TABLES, "Symmetric")


class ComplexFactor(FieldFactor):
    """The matrix factored, and every solve judged by its true residual; collective to build, to solve and to destroy."""

    def __init__(
        self, field: Field, cm: complex, ck: complex, cd: complex = 0.0, slack: np.ndarray | None = None
    ) -> None:
        self.judge = Judge(f'the elastic block of body "{field.name}" for motions of complex frequency')
        self.refines = field.carried  # such pressures answer to what is left of volumes with the bulk modulus
        # mass, stiffness, own damping
        self.weights = complex(cm), complex(ck), complex(cd)
        self.comm = field.comm
        real, imaginary = (_matrix(field, cm.real, ck.real, cd.real), _matrix(field, cm.imag, ck.imag, cd.imag))
        self.matrix = sp.csr_matrix(real + 1j * imaginary)
        if slack is not None:
            self.slack = slack
            self.matrix -= ck * left_out(field, slack)
        self.norm = float(rank_max(self.comm, np.asarray(abs(self.matrix).sum(axis=1)).max(initial=0.0)))
        try:
            self.by: SuperLU | RealForm = (
                SuperLU(self.matrix) if self.comm.size == 1 else RealForm(self.matrix, self.comm)
            )
        except (RuntimeError, IndefiniteError) as error:
            raise LinearSolveError(f"{self.judge.what} could not be factored: {error}.") from error
        self.how = self.by.how

    def solve(self, b: Array) -> Array:
        """The solution (n,), or (n, k) of columns, on this rank's entries; a pressure stays inside."""
        whole = np.zeros((self.matrix.shape[0], *b.shape[1:]), complex)
        whole[: len(b)] = b
        x = self.by.solve(whole)
        if self.refines:
            x -= self.by.solve(self.by.times(x) - whole)
        r = self.by.times(x) - whole
        rr, bb, xx = (_sizes(self.comm, y) for y in (r, b, x))
        for left, given, found in zip(np.atleast_1d(rr), np.atleast_1d(bb), np.atleast_1d(xx), strict=True):
            self.judge.check(float(left), float(given), grown=self.norm * float(found))
        return np.asarray(x[: len(b)])

    def in_c(self) -> InC | None:
        """As :meth:`FieldFactor.in_c`, where no pivot was looked for beside the diagonal; it judges by the first criterion."""
        cm, ck, cd = self.weights
        lent = self.by.in_c
        return None if lent is None else InC(lent[0], cm, ck, cd)

    def solve_columns(self, B: Array) -> Array:
        """The solutions of columns (n, k)."""
        return self.solve(B) if B.shape[1] else B.astype(complex)

    def destroy(self) -> None:
        """Free what belongs to PETSc."""
        self.by.destroy()


class SuperLU:
    """A factor on one rank."""

    how = "SuperLU, complex symmetric"

    def __init__(self, A: sp.csr_matrix) -> None:
        self.times = A.__matmul__
        self.factor = spl.splu(
            A.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
        self.solve = self.factor.solve

    @cached_property
    def in_c(self) -> tuple[np.ndarray, Any] | None:
        """The structure for C by its address, (1,), and what keeps its arrays alive; None where a pivot was looked for beside
        the diagonal.
        """
        if not np.array_equal(self.factor.perm_r, self.factor.perm_c):
            return None
        n, order = len(self.factor.perm_r), np.argsort(self.factor.perm_r).astype(np.int32)
        L = sp.tril(self.factor.L, k=-1, format="csc")
        arrays = [L.indptr.astype(np.int32), L.indices.astype(np.int32), order, L.data, 1.0 / self.factor.U.diagonal()]
        arrays.append(np.zeros(2 * n))
        made = Symmetric(n, *map(address_of, arrays))
        return np.array([ctypes.addressof(made)], dtype=np.uint64), (made, arrays)

    def destroy(self) -> None:
        """Nothing here belongs to PETSc."""


class RealForm:
    """A factor of (1) on all ranks, for this rank's rows of A; collective."""

    how = "MUMPS, LDL^T of the real form of a complex matrix"
    in_c = None

    def __init__(self, A: sp.csr_matrix, comm: Any) -> None:
        rows = sp.kron(A.real, [[1, 0], [0, -1]]) - sp.kron(A.imag, [[0, 1], [1, 0]])
        self.matrix = petsc_of(rows, [(rows.shape[0], None)] * 2, comm)
        self._work = self.matrix.createVecs()
        self.factor = PetscFactor(self.matrix, False, self.how)

    def solve(self, b: Array) -> Array:
        """A^-1 b, (n,) or (n, k)."""
        return _joined(self.factor.solve(_parted(b)), 1.0)

    def times(self, x: Array) -> Array:
        """A x."""
        return _joined(product(self.matrix, _parted(x, 1.0), self._work), -1.0)

    def destroy(self) -> None:
        """Free all that is PETSc's."""
        for obj in (self.factor, self.matrix, *self._work):
            obj.destroy()


def _parted(x: Array, sign: float = -1.0) -> Array:
    """Re x and ``sign`` Im x of each entry in turn, (2 n,) or (2 n, k)."""
    return np.stack((x.real, sign * x.imag), axis=1).reshape(2 * len(x), *x.shape[1:])


def _joined(x: Array, sign: float) -> Array:
    """The numbers (n,) or (n, k) of such parts."""
    return np.asarray(x[::2] + 1j * sign * x[1::2])


def left_out(field: Any, slack: np.ndarray) -> sp.csr_matrix:
    """B^T k B of the springs of wires that are slack, by their numbers."""
    B = field.B[slack]
    return B.T @ sp.diags(field.stiff[slack]) @ B


def _sizes(comm: Any, y: Array) -> Array:
    """Euclidean norms of columns; iterates that fly apart have squares beyond the largest number, and norms below it."""
    size = abs(y)
    largest = rank_max(comm, size.max(axis=0, initial=0.0))
    unit = np.where(np.isfinite(largest) & (largest > 0.0), largest, 1.0)
    return np.asarray(unit * np.sqrt(rank_sum(comm, ((size / unit) ** 2).sum(axis=0))))


def _matrix(field: Field, cm: float, ck: float, cd: float) -> sp.csr_matrix:
    """This rank's rows of cm M + cd D + ck K as an array."""
    E: Any = field.combination(cm, ck, cd)
    start, columns, values = E.getValuesCSR()
    A = sp.csr_matrix((values.copy(), columns.copy(), start.copy()), shape=(len(start) - 1, E.getSize()[1]))
    E.destroy()
    return A
