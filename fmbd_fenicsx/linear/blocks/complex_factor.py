"""Factors of cm M + cd D + ck K of a field for complex coefficients: a symmetric matrix that is not Hermitian.

By SuperLU, with pivots from the diagonal: the real part of the matrix times a number of unit size is definite, so that none is
small against its column. With a pressure that is so of any of its rows once the others of the pressure are eliminated: there are
pivots in every order (Vanderbei, doi:10.1137/0805005), and every solve is judged. On one rank.
"""

from __future__ import annotations

import ctypes
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from ...errors import LinearSolveError
from ...fem.factors.factor import InC
from ...fem.fields import Field
from ...kernel_cache import address_of
from ...rotations import Array
from ...system.compiled.declarations import TABLES, structure_of
from ..residual import Judge
from .spd import FieldFactor

Symmetric = structure_of(TABLES, "Symmetric")


class ComplexFactor(FieldFactor):
    """The matrix factored, and every solve judged by its true residual."""

    how = "SuperLU, complex symmetric"

    def __init__(self, field: Field, cm: complex, ck: complex, cd: complex = 0.0) -> None:
        self.judge = Judge(f'the elastic block of body "{field.name}" for motions of complex frequency')
        self.refines = field.carried  # such pressures answer to what is left of volumes with the bulk modulus
        # mass, stiffness, own damping
        self.weights = complex(cm), complex(ck), complex(cd)
        real, imaginary = (_matrix(field, cm.real, ck.real, cd.real), _matrix(field, cm.imag, ck.imag, cd.imag))
        self.matrix = sp.csr_matrix(real + 1j * imaginary)
        self.norm = float(abs(self.matrix).sum(axis=1).max())
        try:
            self.factor = spl.splu(
                self.matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
        except RuntimeError as error:
            raise LinearSolveError(f"{self.judge.what} could not be factored: {error}.") from error

    def solve(self, b: Array) -> Array:
        """The solution (n,), or (n, k) of columns; a pressure stays inside."""
        whole = np.zeros((self.matrix.shape[0], *b.shape[1:]), complex)
        whole[: len(b)] = b
        x = self.factor.solve(whole)
        if self.refines:
            x -= self.factor.solve(self.matrix @ x - whole)
        r = self.matrix @ x - whole
        rr, bb, xx = map(_sizes, (r, b, x))
        for left, given, found in zip(np.atleast_1d(rr), np.atleast_1d(bb), np.atleast_1d(xx), strict=True):
            self.judge.check(float(left), float(given), grown=self.norm * float(found))
        return np.asarray(x[: len(b)])

    def in_c(self) -> InC | None:
        """As :meth:`FieldFactor.in_c`, where no pivot was looked for beside the diagonal; it judges by the first criterion."""
        cm, ck, cd = self.weights
        if not np.array_equal(self.factor.perm_r, self.factor.perm_c):
            return None
        return InC(self._lent[0], cm, ck, cd)

    @cached_property
    def _lent(self) -> tuple[np.ndarray, Any]:
        """The structure for C by its address, (1,), and what keeps its arrays alive."""
        n, order = len(self.factor.perm_r), np.argsort(self.factor.perm_r).astype(np.int32)
        L = sp.tril(self.factor.L, k=-1, format="csc")
        arrays = [L.indptr.astype(np.int32), L.indices.astype(np.int32), order, L.data, 1.0 / self.factor.U.diagonal()]
        arrays.append(np.zeros(2 * n))
        made = Symmetric(n, *map(address_of, arrays))
        return np.array([ctypes.addressof(made)], dtype=np.uint64), (made, arrays)

    def solve_columns(self, B: Array) -> Array:
        """The solutions of columns (n, k)."""
        return self.solve(B) if B.shape[1] else B.astype(complex)


def _sizes(y: Array) -> Array:
    """Euclidean norms of columns; iterates that fly apart have squares beyond the largest number, and norms below it."""
    size = abs(y)
    largest = size.max(axis=0, initial=0.0)
    unit = np.where(np.isfinite(largest) & (largest > 0.0), largest, 1.0)
    return np.asarray(unit * np.sqrt(((size / unit) ** 2).sum(axis=0)))


def _matrix(field: Field, cm: float, ck: float, cd: float) -> sp.csr_matrix:
    """cm M + cd D + ck K as an array."""
    E: Any = field.combination(cm, ck, cd)
    start, columns, values = E.getValuesCSR()
    A = sp.csr_matrix((values.copy(), columns.copy(), start.copy()), shape=(len(start) - 1,) * 2)
    E.destroy()
    return A
