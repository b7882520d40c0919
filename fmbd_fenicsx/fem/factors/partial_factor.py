"""Cholesky factors whose last unknowns stay last, in two halves, by the CHOLMOD that PETSc was linked with.

PETSc solves with a whole factor only; substructures (:mod:`.substructures`) need the halves. So CHOLMOD is called from C here,
which is built at first use (:mod:`fmbd_fenicsx.kernel_cache`), where its header is at hand and belongs to the same version.
"""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.csgraph as graph

from ... import kernel_cache
from ...log import log
from ...rotations import Array

SOURCE = Path(__file__).with_name("partial_factor.c")
FLAGS = ("-O3", "-march=native", "-fopenmp-simd", "-fvisibility=hidden", "-shared", "-fPIC", "-std=gnu11")
LONG, POINTER = ctypes.c_int64, ctypes.c_void_p
SIGNATURES: dict[str, tuple[Any, list[Any]]] = {
    "function_names": (ctypes.c_char_p, []),
    "header_version": (ctypes.c_int, []),
    "set_functions": (None, [POINTER]),
    "fill_reducing_order": (ctypes.c_int, [LONG, *[POINTER] * 4]),
    "entries": (ctypes.c_double, [LONG, *[POINTER] * 3]),
    "factorize": (POINTER, [LONG, *[POINTER] * 5]),
    "solve_half": (ctypes.c_int, [POINTER, ctypes.c_int, POINTER, LONG]),
    "trailing": (None, [POINTER, LONG, POINTER, POINTER]),
    "release": (None, [POINTER]),
}


class IndefiniteError(ArithmeticError):
    """A matrix that was to be positive definite is not, or could not be factored for another reason."""


@cache
def library() -> Any:
    """The compiled functions; None where PETSc has no CHOLMOD of its own, or its header is missing or of another version."""
    from petsc4py import PETSc

    folder = _header_folder()
    if folder is None:
        log.info("CHOLMOD's header is not installed: factors on several ranks by MUMPS")
        return None
    try:
        cholmod = ctypes.CDLL(PETSc.__file__)  # and all that it was linked with
        numbers = (ctypes.c_int * 3)()
        cholmod.cholmod_l_version(numbers)
    except (OSError, AttributeError):
        log.info("PETSc has no CHOLMOD that can be called: factors on several ranks by MUMPS")
        return None

    made = kernel_cache.load("partial_factor", SOURCE.read_bytes(), flags=(*FLAGS, f"-I{folder}"))
    if made is None:
        return None
    for name, (result, arguments) in SIGNATURES.items():
        function = getattr(made, name)
        function.restype, function.argtypes = result, arguments
    if made.header_version() != 1000 * numbers[0] + numbers[1]:
        log.info("CHOLMOD's header is of another version than the library: factors on several ranks by MUMPS")
        return None
    names = made.function_names().decode().split()
    made.set_functions((POINTER * len(names))(*(ctypes.cast(getattr(cholmod, n), POINTER).value for n in names)))
    return made


def _header_folder() -> Path | None:
    """The folder of includes with CHOLMOD's header: that of PETSc, of Python's environment, or of the system."""
    import petsc4py

    config = petsc4py.get_config()
    petsc = Path(config["PETSC_DIR"])
    folders = (
        petsc / config.get("PETSC_ARCH", "") / "include",
        petsc / "include",
        Path(sys.prefix) / "include",
        Path("/usr/include"),
    )
    names = ("suitesparse/cholmod.h", "cholmod.h")
    return next((folder for folder in folders if any((folder / name).is_file() for name in names)), None)


class PartialFactor:
    """A = L L^T of a symmetric positive definite matrix whose unknowns from ``interior`` on stay last.

    Args:
        A: (n, n), its lower triangle is read.
        interior: number of the unknowns that may be ordered freely.
        dim: neighbours that are ordered together, the components of a node.

    Attributes: ``LG`` (k, k) the last rows of L, ``last`` (k,) their unknowns, counted from ``interior`` on.

    Raises:
        IndefiniteError: A is not positive definite, or there is too little memory.
    """

    def __init__(self, A: sp.csc_matrix, interior: int, dim: int) -> None:
        self.n, self._library = A.shape[0], library()
        first, rows, values = _columns(A)
        order = np.ascontiguousarray(
            (dim * best_order(_nodes(A, dim), interior // dim)[:, None] + np.arange(dim)).ravel()
        )

        status = ctypes.c_int(0)
        pointers = [x.ctypes.data for x in (first, rows, values, order)]
        self._made = self._library.factorize(self.n, *pointers, ctypes.addressof(status))
        if not self._made:
            raise IndefiniteError(f"CHOLMOD's status {status.value}")

        k = self.n - interior
        self.LG, self.last = np.empty((k, k)), np.empty(k, dtype=np.int64)
        self._library.trailing(self._made, interior, self.LG.ctypes.data, self.last.ctypes.data)

    def solve_half(self, x: Array, *, transposed: bool = False) -> None:
        """x (columns, n) becomes L^-1 x, or L^-T x."""
        if not self._library.solve_half(self._made, int(transposed), x.ctypes.data, len(x)):
            raise MemoryError("CHOLMOD could not solve")

    def destroy(self) -> None:
        """Free the factor."""
        self._library.release(self._made)
        self._made = None


def best_order(pattern: sp.csc_matrix, interior: int) -> np.ndarray:
    """The order of least fill among some, those from ``interior`` on last, (n,).

    Nested dissection suits thick bodies, minimum degree flat ones; slender bodies are best taken from one end to the other, so
    that what stays last is met late.
    """
    n = pattern.shape[0]
    last = np.arange(interior, n)
    candidates = []

    # without the unknowns that stay last
    inner = pattern[:interior, :interior]
    dissected = np.empty(interior, dtype=np.int64)
    if interior and _order_of(inner, None, dissected):
        candidates.append(np.concatenate((dissected, last)))
    along = graph.reverse_cuthill_mckee(inner.tocsr(), symmetric_mode=True).astype(np.int64)
    candidates += [np.concatenate((x, last)) for x in (along, along[::-1])]

    # with these
    minimum = np.empty(n, dtype=np.int64)
    if _order_of(pattern, (np.arange(n) >= interior).astype(np.int64), minimum):
        candidates.append(minimum)
    return min(candidates, key=lambda order: _fill(pattern, order))


def _order_of(pattern: sp.csc_matrix, sets: np.ndarray | None, order: np.ndarray) -> bool:
    first, rows, _ = _columns(pattern)
    given = 0 if sets is None else sets.ctypes.data
    return bool(
        library().fill_reducing_order(pattern.shape[0], first.ctypes.data, rows.ctypes.data, given, order.ctypes.data)
    )


def _fill(pattern: sp.csc_matrix, order: np.ndarray) -> float:
    """Entries of the factor in an order."""
    first, rows, _ = _columns(pattern)
    order = np.ascontiguousarray(order)
    found = library().entries(pattern.shape[0], first.ctypes.data, rows.ctypes.data, order.ctypes.data)
    return float(found) if found >= 0 else np.inf


def _columns(A: sp.csc_matrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return A.indptr.astype(np.int64), A.indices.astype(np.int64), np.ascontiguousarray(A.data, dtype=float)


def _nodes(A: sp.csc_matrix, dim: int) -> sp.csc_matrix:
    """Which nodes are coupled: by their first components."""
    some = A[::dim, ::dim] if dim > 1 else A
    return sp.csc_matrix((np.ones(some.nnz), some.indices, some.indptr), some.shape)
