"""Multiplier spaces on a surface: what a tie is tested with, int_Gamma mu . (u - ubar) dS = 0 for all mu.

Every space is written in one form: facet-wise polynomials of degree p with a sparse matrix C,

    mu_j = sum_(F, a) C_j,(F a) psi_Fa,      psi_Fa Lagrange functions of facet F, discontinuous across facets     (1)

so that trace matrices, mortar integrals and norms need one code for all of them. Which space is stable beside which V_h is a
matter of the inf-sup condition; ``docs/traces.md`` has the measured table. Sources: Bernardi, Maday and Patera (mortar spaces
with ends of lower degree, doi:10.1007/978-94-011-1810-4_22); Wohlmuth (dual spaces, doi:10.1137/S0036142999350929); Kim,
Lazarov, Pasciak and Vassilevski (space, doi:10.1137/S0036142900367065).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol, runtime_checkable

import numpy as np
import scipy.sparse as sp

from ...checks import check_fields, whole
from ...errors import InputError
from ...rotations import Array
from .traces import Trace, quadrature, reference_mass, refined, scatter, shape_functions


@dataclass(frozen=True, eq=False)
class Multipliers:
    """A multiplier space (1) on a trace; one number per function, used for each component of a vector.

    Attributes: ``degree`` p, ``basis`` C (n, n_f k_p), ``name``.
    """

    trace: Trace
    degree: int
    basis: sp.csr_matrix
    name: str

    @property
    def n(self) -> int:
        """Functions."""
        return int(self.basis.shape[0])

    def broken(self, blocks: Array, columns: np.ndarray, n: int) -> sp.csr_matrix:
        """C times facet matrices (n_f, k_p, c) with column numbers (n_f, c)."""
        f, k, _ = blocks.shape
        rows = np.arange(f * k).reshape(f, k)
        return (self.basis @ scatter(blocks, rows, columns, (f * k, n))).tocsr()

    def coupling(self) -> sp.csr_matrix:
        """int mu_j phi_i with the trace of V_h, (n, n_nodes)."""
        t = self.trace
        q, w = quadrature(t.dim - 1, self.degree + t.order)
        blocks = t.sizes[:, None, None] * ((shape_functions(t.dim - 1, self.degree, q).T * w) @ t.shape(q))
        return self.broken(blocks, t.nodes, t.n)

    def integrals(self, function: Callable[[Array], Array]) -> Array:
        """int mu_j f of a function of points (n, d) -> (n, c) or (n,); (n, c)."""
        blocks = self.trace.integrals(function, self.degree, self.degree + 6)
        f, _, c = blocks.shape
        return np.asarray(self.broken(blocks, np.broadcast_to(np.arange(c), (f, c)), c).toarray())

    def coefficients(self, values: Array) -> Array:
        """Facet-wise nodal values of mu, (n, ...) -> (n_f, k_p, ...)."""
        flat = self.basis.T @ values.reshape(self.n, -1)
        return np.asarray(flat).reshape(len(self.trace.nodes), -1, *values.shape[1:])

    def error(self, values: Array, exact: Callable[[Array], Array], degree: int = 8) -> float:
        """L2 norm of the multiplier with values (n, c) minus a function of points (n, d) -> (n, c)."""
        t = self.trace
        q, w = quadrature(t.dim - 1, degree)
        found = np.einsum("qa,fac->fqc", shape_functions(t.dim - 1, self.degree, q), self.coefficients(values))
        off = found - np.asarray(exact(t.place(q).reshape(-1, t.dim))).reshape(found.shape)
        return float(np.sqrt(np.einsum("f,q,fqc->", t.sizes, w, off**2)))

    def without(self, rows: np.ndarray) -> Multipliers:
        """The space without some of its functions."""
        keep = np.setdiff1d(np.arange(self.n), rows)
        return Multipliers(self.trace, self.degree, self.basis[keep].tocsr(), self.name)


@runtime_checkable
class MultiplierSpace(Protocol):
    """What a user names; ``on`` makes its functions on a surface."""

    def on(self, trace: Trace) -> Multipliers:
        """The space on a surface."""


class Ends(Enum):
    """What happens to multipliers on the border of the surface, where it meets other constraints (cross-points).

    KEPT: nothing. MERGED: a border value follows from the inner ones (degree lower by one at the border); constants remain.
    DROPPED: border values are zero; constants are lost at the border.
    """

    KEPT = "kept"
    MERGED = "merged"
    DROPPED = "dropped"


@dataclass(frozen=True)
class Continuous:
    """Continuous multipliers of the given degree (None: that of V_h)."""

    degree: int | None = None
    ends: Ends = Ends.MERGED

    def __post_init__(self) -> None:
        check_fields(self)
        if self.degree is not None:
            whole("Continuous: degree", self.degree, least=1)

    def on(self, trace: Trace) -> Multipliers:
        """The space on a surface."""
        degree = trace.degree if self.degree is None else self.degree
        nodes, n, border, points = _nodes(trace, degree)
        f, k = nodes.shape
        # nodal functions by facet-wise ones, then those that the border keeps
        N = scatter(np.broadcast_to(np.eye(k), (f, k, k)), nodes, np.arange(f * k).reshape(f, k), (n, f * k))
        N.eliminate_zeros()
        C = _border_rule(self.ends, nodes, border, points, degree) @ N
        return Multipliers(trace, degree, C.tocsr(), f"P{degree}, ends {self.ends.value}")


@dataclass(frozen=True)
class Dual:
    """Multipliers biorthogonal to the nodal functions of V_h: int psi_i phi_j = delta_ij int phi_j; local elimination."""

    ends: Ends = Ends.MERGED

    def __post_init__(self) -> None:
        check_fields(self)

    def on(self, trace: Trace) -> Multipliers:
        """The space on a surface."""
        p, m = trace.degree, trace.dim - 1
        if trace.halved:
            raise InputError(f"{trace.label}: dual multipliers are not made on faces of hexahedra. Use Continuous(1).")
        M = reference_mass(m, p, p)
        integrals = M.sum(axis=1)
        if integrals.min() < 1e-12:
            raise InputError(
                f"{trace.label}: dual multipliers of degree {p} do not exist on triangles (functions of the "
                "corners have integral 0). "
                "Use Continuous(1) under P2."
            )

        # psi_i = sum_a local_ia phi_a with int psi_i phi_j = 0 for i != j
        local = np.diag(integrals) @ np.linalg.inv(M)  # psi_i = sum_a local_ia phi_a
        f, k = trace.nodes.shape
        own = np.arange(f * k).reshape(f, k)
        N = scatter(np.broadcast_to(local, (f, k, k)), trace.nodes, own, (trace.n, f * k))
        C = _border_rule(self.ends, trace.nodes, trace.border, trace.points, p) @ N

        return Multipliers(trace, p, C.tocsr(), f"dual P{p}, ends {self.ends.value}")


@dataclass(frozen=True)
class Discontinuous:
    """Facet-wise polynomials of the given degree; degree 0 is stable beside P2 in the plane only."""

    degree: int = 0

    def __post_init__(self) -> None:
        whole("Discontinuous: degree", self.degree, least=0)

    def on(self, trace: Trace) -> Multipliers:
        """The space on a surface."""
        k = reference_mass(trace.dim - 1, self.degree, self.degree).shape[0]
        return Multipliers(
            trace, self.degree, sp.identity(len(trace.nodes) * k, format="csr"), f"discontinuous P{self.degree}"
        )


@dataclass(frozen=True)
class Aggregated:
    """Constants on patches of facets: pairs in the plane, stars of a vertex in space (about twice coarser cells)."""

    def on(self, trace: Trace) -> Multipliers:
        """The space on a surface."""
        patch = _pairs(trace) if trace.dim == 2 else _stars(trace)
        f = len(trace.nodes)
        C = sp.csr_matrix((np.ones(f), (patch, np.arange(f))), shape=(int(patch.max()) + 1, f))
        return Multipliers(trace, 0, C, "P0 on coarser cells")


@dataclass(frozen=True)
class Linear:
    """Polynomials 1 and (X_k - c_k) / l over the whole surface: the moments that joints on average see; six of their vector
    combinations are the resultants.
    """

    def on(self, trace: Trace) -> Multipliers:
        """The space on a surface."""
        return Multipliers(trace, 1, sp.csr_matrix(_linear_functions(trace)), "linear over the surface")


def _linear_functions(trace: Trace) -> Array:
    """1 and (X - c) . e_k / l at the corners of the facets, (1 + p, n_f d), for the p directions in which the surface extends."""
    x = trace.corners
    share = trace.sizes / trace.sizes.sum()
    center = (share[:, None] * x.mean(1)).sum(0)
    apart = x - center

    spread = np.einsum("f,fac,fad->cd", share, apart, apart, optimize=True)
    size, axes = np.linalg.eigh(spread)
    # a flat surface extends in two directions, a straight edge in one
    extended = settled(axes[:, size > 1e-12 * size.max()].T).T
    rows = [
        np.ones(x.shape[0] * x.shape[1]),
        *(apart @ extended / np.sqrt(size.max())).reshape(-1, extended.shape[1]).T,
    ]
    return np.array(rows)


@dataclass(frozen=True)
class Completed:
    """A space of degree 1, and of the linear functions over the surface those that it does not see.

    On one or two facets merged ends leave a constant, which holds a mean position but no rotation: a pin. With the linear
    functions that are missing, a tie holds every rigid motion of its surface, whatever its facets.
    """

    space: MultiplierSpace

    def on(self, trace: Trace) -> Multipliers:
        """The space on a surface."""
        found = self.space.on(trace)
        linear = Multipliers(trace, 1, sp.csr_matrix(_linear_functions(trace)), "linear")
        # linear functions that do no work against any of the space
        unseen = null_vectors(seen(found, linear))
        if found.degree != 1 or not unseen.size:
            return found

        more = sp.csr_matrix(unseen @ linear.basis.toarray())
        basis = sp.vstack([found.basis, more], format="csr")
        return Multipliers(trace, 1, basis, f"{found.name}, and {len(unseen)} linear")


def seen(functions: Multipliers, fields: Multipliers) -> Array:
    """int mu_j f_k of functions and of fields on one trace, (n, k)."""
    sizes, dim = functions.trace.sizes, functions.trace.dim - 1
    points, weights = quadrature(dim, functions.degree + fields.degree)
    one, other = (shape_functions(dim, space.degree, points) for space in (functions, fields))
    blocks = np.einsum("f,q,qa,qb->fab", sizes, weights, one, other, optimize=True)

    rows = np.arange(len(sizes) * one.shape[1]).reshape(len(sizes), -1)
    columns = np.arange(len(sizes) * other.shape[1]).reshape(len(sizes), -1)
    mass = scatter(blocks, rows, columns, (rows.size, columns.size))
    return np.asarray((functions.basis @ mass @ fields.basis.T).toarray())


def null_vectors(matrix: Array) -> Array:
    """Unit vectors z with matrix z = 0, as rows; its rows are measured by the largest of them."""
    _, stretch, V = np.linalg.svd(matrix)
    rank = int((stretch > 1e-9 * stretch.max(initial=0.0)).sum())
    return settled(np.asarray(V[rank:]))


def settled(vectors: Array) -> Array:
    """Orthonormal rows of the same span that depend on the span alone.

    Eigenvectors and singular vectors come with any sign, and turned as one likes among equal values: roundoff decides, so that
    two ranks found other multipliers than one. The projector onto the span is unique: its largest columns are taken in turn,
    the first of those that are equally large.
    """
    projector = vectors.T @ vectors
    rows = []
    for _ in vectors:
        # the first of the columns that are nearly the longest: roundoff does not choose
        length = np.sqrt(np.abs(np.diag(projector)))
        first = int(np.argmax(length > 0.999 * length.max()))
        rows.append(projector[first] / length[first])
        projector = projector - np.outer(rows[-1], rows[-1])
    return np.array(rows).reshape(vectors.shape)


def default_space(degree: int) -> MultiplierSpace:
    """Same degree with merged ends beside P1, completed on few facets; P1 beside P2, P2 beside P3 (``docs/traces.md``)."""
    return Completed(Continuous()) if degree == 1 else Continuous(degree=degree - 1, ends=Ends.KEPT)


def _nodes(trace: Trace, degree: int) -> tuple[np.ndarray, int, np.ndarray, Array]:
    """Node numbers of the continuous space of a degree on the trace's facets, their count, border nodes, points."""
    if degree == trace.degree and not trace.halved:
        return trace.nodes, trace.n, trace.border, trace.points
    other = refined(trace, 0, degree)
    return other.nodes, other.n, other.border, other.points


def _border_rule(ends: Ends, nodes: np.ndarray, border: np.ndarray, points: Array, degree: int) -> sp.csr_matrix:
    """R (n_kept, n): functions of the kept nodes as sums of all nodal functions."""
    n = len(points)
    if ends is Ends.KEPT or len(border) == 0:
        return sp.identity(n, format="csr")

    inner = np.setdiff1d(np.arange(n), border)
    if len(inner) == 0:  # one facet, or a strip without inner nodes: one constant remains
        return sp.csr_matrix(np.ones((1, n)))

    # functions of inner nodes stay as they are
    number = np.full(n, -1)
    number[inner] = np.arange(len(inner))
    R = sp.csr_matrix((np.ones(len(inner)), (number[inner], inner)), shape=(len(inner), n)).tolil()

    if ends is Ends.DROPPED:
        return R.tocsr()

    if points.shape[1] == 2 and degree >= 2:
        _extrapolate(R, nodes, border, number, points)
        return R.tocsr()

    # degree 1: a border value is the mean of its neighbours', ring by ring from the inside
    k = nodes.shape[1]
    graph = scatter(np.ones((len(nodes), k, k)), nodes, nodes, (n, n))
    known = np.isin(np.arange(n), inner)
    values = {int(i): {int(number[i]): 1.0} for i in inner}

    while not known.all():
        ring = [b for b in np.flatnonzero(~known) if known[graph.indices[graph.indptr[b] : graph.indptr[b + 1]]].any()]
        for b in ring:
            around = graph.indices[graph.indptr[b] : graph.indptr[b + 1]]
            around = around[known[around]]
            values[int(b)] = _mean([values[int(a)] for a in around])

        if not ring:
            raise InputError(
                "A surface falls into separate parts, one of them without inner nodes; use coarser multipliers."
            )
        known[ring] = True

    for b in border:
        for j, w in values[int(b)].items():
            R[j, b] = w
    return R.tocsr()


def _mean(rows: list[dict[int, float]]) -> dict[int, float]:
    out: dict[int, float] = {}
    for row in rows:
        for j, w in row.items():
            out[j] = out.get(j, 0.0) + w / len(rows)
    return out


def _extrapolate(R: sp.lil_matrix, nodes: np.ndarray, border: np.ndarray, number: np.ndarray, points: Array) -> None:
    """In the plane: the end value is the extrapolation of degree p - 1 from the other nodes of its facet."""
    for b in border:
        facet = nodes[(nodes == b).any(axis=1)][0]
        # at the end of a strip the other end may be dropped too
        others = facet[(facet != b) & (number[facet] >= 0)]
        s = np.linalg.norm(points[others] - points[b], axis=1)
        for i, a in enumerate(others):
            R[number[a], b] = np.prod([s[j] / (s[j] - s[i]) for j in range(len(s)) if j != i])


def _pairs(trace: Trace) -> np.ndarray:
    """Patches of two consecutive facets along each curve (three at an odd end)."""
    ends = trace.nodes[:, :2]
    # facets at each end
    at: dict[int, list[int]] = {}
    for f, (a, b) in enumerate(ends):
        at.setdefault(int(a), []).append(f)
        at.setdefault(int(b), []).append(f)

    # along open curves from their ends, then around closed ones
    patch = np.full(len(ends), -1)
    count = 0
    starts = [at[int(b)][0] for b in trace.border] + list(range(len(ends)))
    for start in starts:
        chain, f = [], start
        while patch[f] < 0 and f not in chain:
            chain.append(f)
            following = [g for e in ends[f] for g in at[int(e)] if g not in chain and patch[g] < 0]
            f = following[0] if following else f

        if not chain:
            continue

        groups = max(len(chain) // 2, 1)
        for i, g in enumerate(chain):
            patch[g] = count + min(i // 2, groups - 1)
        count += groups
    return patch


def _stars(trace: Trace) -> np.ndarray:
    """Patches of the facets around a vertex, chosen greedily (inner vertices with most free facets first)."""
    corners = trace.nodes[:, :3]
    vertices = np.unique(corners)
    around = {int(v): np.flatnonzero((corners == v).any(axis=1)) for v in vertices}

    border = set(trace.border.tolist())
    inner = [int(v) for v in vertices if v not in border]
    order = sorted(inner or vertices.tolist(), key=lambda v: (-len(around[v]), v))

    patch = np.full(len(corners), -1)
    count = 0
    for v in order:
        if (patch[around[v]] < 0).all():
            patch[around[v]] = count
            count += 1

    if count == 0:
        return np.zeros(len(corners), dtype=int)

    # facets that no star has taken go to the nearest one
    center = np.array([trace.corners[patch == c].mean(axis=(0, 1)) for c in range(count)])
    for f in np.flatnonzero(patch < 0):
        patch[f] = int(np.linalg.norm(center - trace.corners[f].mean(0), axis=1).argmin())
    return patch
