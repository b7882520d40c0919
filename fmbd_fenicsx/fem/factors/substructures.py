"""A factor on several ranks by substructures: each rank eliminates what is its own, the interface is solved as a dense matrix.

Without the nodes of the interface G no unknown of a rank is coupled to one of another. Rank i factors its interior I with the
part of the interface that it touches, which stays last (:mod:`.partial_factor`):

    [ A_II  A_IG ]                                                  S = A_GG - sum_i A_GI A_II^-1 A_IG
    [ A_GI  A_GG ] = L L^T,   L_G L_G^T = A_GG - A_GI A_II^-1 A_IG    = A_GG - sum_i (A_GG - L_G L_G^T)_i         (1)

S is dense and the same on all ranks. A solve is one half of the factor on each rank, a sum of vectors of the interface, S, and
the other half. The matrix is positive definite when all L exist and S is positive definite, and only then.
Source: Smith, Bjorstad and Gropp, Domain Decomposition, Cambridge University Press 1996, section 4.1.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.csgraph as graph

from ...rotations import Array
from .partial_factor import IndefiniteError, PartialFactor, library

DENSE = 10.0  # |G|^3 / n^2: 2 for a cube of any size on two ranks, 18 on four


class Substructures:
    """The factor (1) of a distributed PETSc matrix of blocks of ``dim``; collective to build, to solve and to destroy.

    ``interface``: sorted numbers of its nodes, the same on all ranks, see :func:`separator`.

    Raises:
        IndefiniteError: the matrix is not positive definite; on all ranks.
    """

    def __init__(self, A: Any, dim: int, interface: np.ndarray) -> None:
        self.comm = A.getComm().tompi4py()
        G = (dim * interface[:, None] + np.arange(dim)).ravel()
        self.how = f"CHOLMOD on each of {self.comm.size} ranks, a dense matrix of {len(G)} unknowns on their interface"

        # unknowns of this rank: within, and on the interface; those of the interface by their place in it
        low, high = A.getOwnershipRange()
        own = np.arange(low, high)
        on = np.isin(own, G, assume_unique=True)
        self.within, self.held = np.flatnonzero(~on), np.flatnonzero(on)
        self.places = np.searchsorted(G, own[on])
        csr = A.getValuesCSR()
        AGG = self._interface_matrix(G, *_rows(csr, self.held))

        # columns of the lower triangle of (1): rows of the interior, and what of the interface it touches
        m = len(self.within)
        counts, columns, values = _rows(csr, self.within)
        local = np.where(on, -1, np.cumsum(~on) - 1)[np.clip(columns - low, 0, len(own) - 1)] if m else columns
        outside = (local < 0) | (columns < low) | (columns >= high)
        there = np.searchsorted(G, columns[outside])
        touched = (dim * np.unique(there // dim)[:, None] + np.arange(dim)).ravel()
        local[outside] = m + np.searchsorted(touched, there)
        corner = AGG[touched][:, touched]

        first = np.concatenate(([0], np.cumsum(np.concatenate((counts, np.diff(corner.indptr))))))
        rows = np.concatenate((local, m + corner.indices))
        n = m + len(touched)
        lower = sp.csc_matrix((np.concatenate((values, corner.data)), rows, first), (n, n))

        self._made, error = None, None
        try:
            self._made = PartialFactor(lower, m, dim) if m else None
        except IndefiniteError as found:
            error = found
        self._together(error)

        S = np.zeros(AGG.shape)
        self.touched, self.last, self.LG = touched[:0], touched[:0], np.zeros((0, 0))
        if self._made is not None:
            self.last, self.LG = m + self._made.last, self._made.LG
            self.touched = touched[self._made.last]
            corner = corner[self._made.last][:, self._made.last]
            S[np.ix_(self.touched, self.touched)] = _square(self.LG) - corner.toarray()
        S = AGG.toarray() + self._sum(S)
        try:
            self.S = sl.cho_factor(S, lower=True, overwrite_a=True, check_finite=False)
        except np.linalg.LinAlgError:
            error = IndefiniteError("its interface is not positive definite")
        self._together(error)

    def _interface_matrix(self, G: np.ndarray, counts: np.ndarray, columns: np.ndarray, values: Array) -> sp.csr_matrix:
        """A_GG on all ranks, from the rows that each holds of it; collective."""
        place = np.minimum(np.searchsorted(G, columns), max(len(G) - 1, 0))
        of_it = G[place] == columns if len(G) else np.zeros(0, dtype=bool)
        parts = self.comm.allgather((self.places.repeat(counts)[of_it], place[of_it], values[of_it]))
        i, j, x = (np.concatenate(some) for some in zip(*parts, strict=True))
        return sp.csr_matrix((x, (i, j)), (len(G), len(G)))

    def _sum(self, x: Array) -> Array:
        """Sum over the ranks, of large arrays."""
        from mpi4py import MPI

        self.comm.Allreduce(MPI.IN_PLACE, x)
        return x

    def _together(self, error: Exception | None) -> None:
        """Raise on all ranks what one has found."""
        errors = [e for e in self.comm.allgather(error) if e is not None]
        if errors:
            self.destroy()
            raise errors[0]

    def solve(self, B: Array) -> Array:
        """A^-1 B on this rank's rows, (n,) or (n, k); collective."""
        columns = np.array(np.atleast_2d(B.T), order="C")
        k, m = len(columns), len(self.within)
        x = np.zeros((k, m + len(self.last)))
        x[:, :m] = columns[:, self.within]
        if self._made is not None:
            self._made.solve_half(x)

        # the interface: its own loads, and what the interiors hand on
        r = np.zeros((k, len(self.S[0])))
        r[:, self.places] = columns[:, self.held]
        r[:, self.touched] += x[:, self.last] @ self.LG.T
        y = sl.cho_solve(self.S, self._sum(r).T, check_finite=False).T

        x[:, self.last] = y[:, self.touched] @ self.LG
        if self._made is not None:
            self._made.solve_half(x, transposed=True)
        columns[:, self.within] = x[:, :m]
        columns[:, self.held] = y[:, self.places]
        return columns.T.reshape(B.shape)

    def destroy(self) -> None:
        """Free the factor."""
        if self._made is not None:
            self._made.destroy()
        self._made = None


def substructured(A: Any, dim: int) -> tuple[Substructures | None, str]:
    """The factor (1) where it pays, else None and the reason; collective.

    The dense matrix costs |G|^3 / 3 operations on each rank, the sparse ones of a thick body in space some 20 n^2 on all ranks.

    Raises:
        IndefiniteError: the matrix is not positive definite; on all ranks.
    """
    comm = A.getComm().tompi4py()
    if not all(comm.allgather(library() is not None)):
        return None, "CHOLMOD cannot be called"
    interface = separator(A, dim)
    size = dim * len(interface)
    if size**3 > DENSE * A.getSize()[0] ** 2:
        return None, f"the interface of {comm.size} ranks has {size} of {A.getSize()[0]} unknowns"
    return Substructures(A, dim, interface), ""


def _square(L: Array) -> Array:
    """L L^T of a lower triangle, (n, n), by LAPACK's product for upper ones."""
    if not len(L):
        return L
    upper, _ = sl.lapack.dlauum(L[::-1, ::-1], lower=0)
    half = np.triu(upper)[::-1, ::-1]
    return half + np.tril(half, -1).T


def _rows(csr: tuple[np.ndarray, np.ndarray, Array], which: np.ndarray) -> tuple[np.ndarray, np.ndarray, Array]:
    """Some rows: how many entries each has, their columns and values."""
    first, columns, values = csr
    counts = np.diff(first)[which]
    at = _spans(first[which], counts)
    return counts, columns[at].astype(np.int64), values[at]


def separator(A: Any, dim: int) -> np.ndarray:
    """Sorted numbers of nodes without which no rank's nodes are coupled to another's, the same on all ranks; collective.

    Of each pair of ranks they are the fewest that touch all couplings: a minimum vertex cover, by Koenig's theorem.
    """
    comm = A.getComm().tompi4py()
    low, high = (x // dim for x in A.getOwnershipRange())
    starts = A.getOwnershipRanges() // dim

    # couplings of own nodes to those of later ranks; a node's first row has them all
    counts, columns, _ = _rows(A.getValuesCSR(), np.arange(0, dim * (high - low), dim))
    pairs = np.stack((np.repeat(np.arange(low, high), counts), columns // dim), axis=1)
    pairs = np.unique(pairs[pairs[:, 1] >= high], axis=0)
    pairs = np.concatenate(comm.allgather(pairs))

    ranks = np.searchsorted(starts, pairs, side="right") - 1
    found: np.ndarray = np.zeros(0, dtype=np.int64)
    for pair in np.unique(ranks, axis=0):
        between = pairs[(ranks == pair).all(axis=1)]
        open_ones = between[~np.isin(between, found).any(axis=1)]
        found = np.union1d(found, _cover(open_ones))
    return found


def _spans(first: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """All numbers first[i], .., first[i] + counts[i] - 1."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1] if len(ends) else 0) + np.repeat(first - (ends - counts), counts)


def _cover(pairs: np.ndarray) -> np.ndarray:
    """Fewest numbers of which each pair (left, right) has one."""
    if not len(pairs):
        return pairs.ravel()
    left, i = np.unique(pairs[:, 0], return_inverse=True)
    right, j = np.unique(pairs[:, 1], return_inverse=True)
    edges = sp.csr_matrix((np.ones(len(pairs)), (i, j)), (len(left), len(right)))
    partner = graph.maximum_bipartite_matching(edges, perm_type="row")  # of each right one: the left one, or -1

    # all that alternating paths reach from left ones without partner
    matched = np.zeros(len(left), dtype=bool)
    matched[partner[partner >= 0]] = True
    reached, seen = ~matched, np.zeros(len(right), dtype=bool)
    while True:
        seen = (edges.T @ reached.astype(float)) > 0
        grown = reached.copy()
        grown[partner[seen & (partner >= 0)]] = True
        if (grown == reached).all():
            return np.sort(np.concatenate((left[~reached], right[seen])))
        reached = grown
