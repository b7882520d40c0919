"""Mortar coupling of two surfaces whose meshes do not match.

    D_ji = int mu_j phi_i,     M_jl = int mu_j (phi_l o pi),     pi: slave -> master along the slave's normal     (1)

Both integrals run over the intersections of facets (segments in the plane; convex polygons, cut into triangles, in space), on
which all integrands are polynomials: exact for flat surfaces, so constant stress passes to roundoff (the patch test).
Quadrature on the slave's facets alone misses it by up to 1e-2. Where the surfaces overlap in part, only the overlap is tied.

Sources: Bernardi, Maday and Patera (doi:10.1007/978-94-011-1810-4_22); Puso (doi:10.1002/nme.865); the clipping is that of
Sutherland and Hodgman (doi:10.1145/360767.360802), done here for all pairs at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ...errors import InputError
from ...log import log
from ...rotations import Array
from .multipliers import Multipliers, MultiplierSpace
from .traces import Trace, quadrature, scatter, shape_functions

TINY = 1e-12  # relative size of an intersection that is left out


@dataclass(frozen=True, eq=False)
class Mortar:
    """Matrices (1) of a tie: ``slave`` D (n, slave nodes), ``master`` M (n, master nodes); ``multipliers`` with a support in
    the overlap; ``gap`` largest distance of the surfaces in the overlap, m.
    """

    multipliers: Multipliers
    master_trace: Trace
    slave: sp.csr_matrix
    master: sp.csr_matrix
    gap: float


def mortar(
    slave: Trace, master: Trace, space: MultiplierSpace, *, tolerance: float = 0.1, facing: bool = True
) -> Mortar:
    """Couple two surfaces; collective (the pairs are shared among the ranks).

    Args:
        slave: surface that carries the multipliers; should be the finer one (else a warning).
        master: the other surface.
        space: multiplier space on the slave.
        tolerance: largest distance of facets that see each other, in facet diameters.
        facing: True couples facets whose outward normals oppose each other, False those whose normals agree.

    Raises:
        InputError: the surfaces do not overlap (with their distance).
    """
    if slave.h > 1.5 * master.h:
        log.warning(
            "%s carries the multipliers but is coarser (h = %.3g) than %s (h = %.3g): choose the finer side as slave "
            "(fmbd.finer_first(a, b) gives the two in that order).",
            slave.label, slave.h, master.label, master.h,
        )  # fmt: skip

    multipliers = space.on(slave)
    sight = tolerance * diameters(slave), -1.0 if facing else 1.0
    pair, own, other, overlap, gap = _shared(slave, master, multipliers.degree, sight)
    if overlap.sum() <= 1e-9 * slave.sizes.sum():
        raise InputError(
            f"{slave.label} and {master.label} do not overlap: their distance is {_distance(slave, master):.3g} m. "
            "Check the placement of the bodies, or the names of the surfaces."
        )

    # D and M of (1): facet-wise functions, gathered to those of the space
    f = len(slave.nodes)
    k = own.shape[1]
    rows = pair[:, :1] * k + np.arange(k)
    D = multipliers.basis @ scatter(own, rows, slave.nodes[pair[:, 0]], (f * k, slave.n))
    M = multipliers.basis @ scatter(other, rows, master.nodes[pair[:, 1]], (f * k, master.n))

    # multipliers outside the overlap would see nothing: their rows were zero
    full = np.abs(multipliers.coupling()).sum(axis=1)
    empty = np.flatnonzero(np.asarray(np.abs(D).sum(axis=1) <= 1e-9 * full).ravel())
    keep = np.setdiff1d(np.arange(multipliers.n), empty)

    return Mortar(
        multipliers.without(empty) if len(empty) else multipliers,
        master,
        D.tocsr()[keep],
        M.tocsr()[keep],
        float(gap.max(initial=0.0)),
    )


def diameters(t: Trace) -> Array:
    """Sizes of facets as lengths, m, (n,)."""
    return np.sqrt(t.sizes) if t.dim == 3 else t.sizes


def overlap(
    slave: Trace, master: Trace, degree: int, sight: Array, *, facing: bool = True
) -> tuple[np.ndarray, Array, Array]:
    """Pairs of facets that overlap (n, 2), and their blocks int psi_a phi_b of the slave and of the master (n, k_p, k).

    psi are the Lagrange functions of ``degree`` on the slave's facets; ``sight`` (m, for each of these) is the largest
    distance of facets that see each other, whose normals oppose each other (``facing``) or agree. Collective; sorted.
    """
    pair, own, other, _, _ = _shared(slave, master, degree, (sight, -1.0 if facing else 1.0))
    return pair, own, other


def _shared(
    slave: Trace, master: Trace, degree: int, sight: tuple[Array, float]
) -> tuple[np.ndarray, Array, Array, Array, Array]:
    """All that :func:`_integrate` finds, the pairs shared among the ranks; sorted, so that no sum depends on their number."""
    comm = slave.comm
    pairs = neighbours(slave, master, sight[0])
    parts = comm.allgather(_integrate(slave, master, pairs[comm.rank :: comm.size], degree, sight))

    pair, own, other, overlap, gap = (np.concatenate([part[i] for part in parts]) for i in range(5))
    order = np.lexsort(pair.T[::-1])
    return pair[order], own[order], other[order], overlap[order], gap[order]


def neighbours(slave: Trace, master: Trace, sight: Array) -> np.ndarray:
    """Pairs of facets (n, 2) with points that may be ``sight`` apart: their circumscribed balls are no farther."""
    from scipy.spatial import cKDTree

    def balls(t: Trace) -> tuple[Array, Array]:
        c = t.corners.mean(1)
        return c, np.linalg.norm(t.corners - c[:, None], axis=2).max(axis=1)

    wider = 1 + 1e-9  # than roundoff
    centres, radii = balls(slave)
    others, their_radii = balls(master)
    reach = radii + sight

    # as if all balls of the master were as large as the largest, then with their own sizes
    hits = cKDTree(others).query_ball_point(centres, reach * wider + their_radii.max(), return_sorted=True)
    counts = [len(found) for found in hits]
    f = np.repeat(np.arange(len(centres)), counts)
    g = np.concatenate([*hits, []]).astype(np.int64)
    apart = np.linalg.norm(centres[f] - others[g], axis=1)
    near = apart <= (reach[f] + their_radii[g]) * wider
    return np.stack((f, g), axis=1)[near]


def _distance(a: Trace, b: Trace) -> float:
    """Distance of the nearest nodes of two surfaces, m."""
    from scipy.spatial import cKDTree

    return float(cKDTree(b.points).query(a.points)[0].min())


def _integrate(
    slave: Trace, master: Trace, pairs: np.ndarray, degree: int, sight: tuple[Array, float]
) -> tuple[np.ndarray, Array, Array, Array, Array]:
    """Pairs that overlap, their blocks of D (n, k_p, k_s) and M (n, k_p, k_m), the overlaps, the gaps.

    ``sight``: largest distance for each slave facet, m, and the sign of the normals' product.
    """
    m = slave.dim - 1
    cells, pair = _segments(slave, master, pairs) if m == 1 else _polygons(slave, master, pairs)

    # points on the overlaps, in the slave facet's reference coordinates, and the overlaps' sizes there
    q, w = quadrature(m, degree + max(slave.order, master.order))
    x = np.einsum("qa,nak->nqk", shape_functions(m, 1, q), cells)
    size = np.abs(cells[:, 1, 0] - cells[:, 0, 0]) if m == 1 else _doubled_area(cells)

    # the same points on the master, along the slave's normal; facets see each other that are near and face each other
    f, g = pair[:, 0], pair[:, 1]
    X = np.einsum("nqa,nad->nqd", shape_functions(m, 1, x), slave.corners[f])
    y, distance = _onto(X, slave.normals[f], master.corners[g])
    near = (np.abs(distance).max(axis=1, initial=0.0) <= sight[0][f]) & (size > TINY)
    facing = (slave.normals[f] * master.normals[g]).sum(1) * sight[1]
    near &= facing > 0.5
    weight = (size * slave.sizes[f])[near]
    f, g, x, y = f[near], g[near], x[near], y[near]

    # the blocks of (1), facet by facet
    test = np.swapaxes(weight[:, None, None] * w[:, None] * shape_functions(m, degree, x), 1, 2)
    own, other = test @ slave.shape(x, f), test @ master.shape(y, g)
    return np.stack((f, g), axis=1), own, other, weight, np.abs(distance[near]).max(axis=1, initial=0.0)


def _onto(X: Array, normal: Array, corners: Array) -> tuple[Array, Array]:
    """Reference coordinates (n, q, m) on the master's facets of points moved along the slave's normal, and the moves."""
    # corner + edges y - normal s = X
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    A = np.concatenate((edges, -normal[:, :, None]), axis=2)
    right = X - corners[:, None, 0]

    # a normal in the plane of a facet never meets it
    size = np.abs(A).max(axis=(1, 2), initial=1e-300)
    flat = np.abs(np.linalg.det(A)) < 1e-14 * size**2
    A = np.where(flat[:, None, None], np.eye(A.shape[1]), A)
    z = np.linalg.solve(A[:, None], right[..., None])[..., 0]
    z[flat] = np.inf
    return np.asarray(z[..., :-1]), np.asarray(z[..., -1])


def _segments(slave: Trace, master: Trace, pairs: np.ndarray) -> tuple[Array, np.ndarray]:
    """Overlaps (n, 2, 1) in the slave facet's coordinate, and their pairs."""
    f, g = pairs[:, 0], pairs[:, 1]
    a = slave.corners[f, 0]
    b = slave.corners[f, 1]
    along = (b - a) / (slave.sizes[f, None] ** 2)
    s = np.einsum("nd,nkd->nk", along, master.corners[g] - a[:, None])
    low = np.maximum(s.min(axis=1), 0.0)
    high = np.minimum(s.max(axis=1), 1.0)
    found = high - low > TINY
    return np.stack((low, high), axis=1)[found][..., None], pairs[found]


def _doubled_area(triangles: Array) -> Array:
    """Twice the areas of plane triangles (n, 3, 2)."""
    a = triangles[:, 1] - triangles[:, 0]
    b = triangles[:, 2] - triangles[:, 0]
    return np.asarray(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))


def _polygons(slave: Trace, master: Trace, pairs: np.ndarray) -> tuple[Array, np.ndarray]:
    """Overlaps as triangles (n, 3, 2) in the slave facet's reference coordinates, and their pairs."""
    f, g = pairs[:, 0], pairs[:, 1]

    # the master's triangles in the reference coordinates of the slave's, by its metric
    a = slave.corners[f, 0]
    e = slave.corners[f, 1:] - a[:, None]  # (n, 2, 3)
    gram = np.linalg.inv(e @ np.swapaxes(e, 1, 2))
    d = master.corners[g] - a[:, None]
    polygon = d @ np.swapaxes(e, 1, 2) @ gram  # master triangle in slave coordinates

    # clipped by the three sides x >= 0, y >= 0, x + y <= 1; each may add a corner
    count = np.full(len(pairs), 3)
    vertices: Array = np.zeros((len(pairs), 8, 2))
    vertices[:, :3] = polygon
    for value in (lambda p: p[..., 0], lambda p: p[..., 1], lambda p: 1.0 - p[..., 0] - p[..., 1]):
        vertices, count = _clip(vertices, count, value)

    # fans of triangles from the first corner
    triangles, owner = [], []
    for k in range(1, 7):
        some = (count > k + 1).nonzero()[0]
        triangles.append(vertices[some][:, [0, k, k + 1]])
        owner.append(some)
    cells, who = np.concatenate(triangles), np.concatenate(owner)

    large = _doubled_area(cells) > TINY
    return cells[large], pairs[who[large]]


def _clip(vertices: Array, count: np.ndarray, value: object) -> tuple[Array, np.ndarray]:
    """Cut convex polygons (n, 8, 2) by the half plane value >= 0."""
    assert callable(value)
    rows = np.arange(len(count))
    out = np.zeros_like(vertices)
    made = np.zeros(len(count), dtype=int)
    v = value(vertices)

    def push(which: np.ndarray, points: Array) -> None:
        out[which, made[which]] = points
        made[which] += 1

    for k in range(int(count.max(initial=0))):
        following = np.where(k + 1 < count, k + 1, 0)
        live = k < count
        here, there = v[:, k], v[rows, following]

        # corners inside stay; an edge that crosses the line leaves the point where it does
        inside = (live & (here >= 0)).nonzero()[0]
        push(inside, vertices[inside, k])
        crossing = (live & (here * there < 0)).nonzero()[0]
        s = (here[crossing] / (here[crossing] - there[crossing]))[:, None]
        push(crossing, (1 - s) * vertices[crossing, k] + s * vertices[crossing, following[crossing]])
    return out, made
