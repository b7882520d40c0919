"""Which rows of constraints depend on each other, whatever bodies weigh and however far gears reduce.

The constraint Jacobian is scaled,

    G_s = E G D,        E: inverse row norms of G D                                                                     (1)

so that its singular values do not depend on units: D counts turns at the model's length, as if all frames had one mass m and the
inertia m L^2. What depends is a matter of places alone: by their own masses rows on both sides of a body of hardly any mass look
the same. Nodal displacements enter through the ports p = P w with a factor of P P^T. Rows depend where singular values are below
sigma_1 DEPENDENT: wherever bodies turn, such rows open by a few times that share of the model's length, less than a step may
leave open (``SHUT`` of :mod:`.lengths`), so that nobody can tell them from rows that are the same.

That is so of motions of the model's size. A wheel behind many gears turns by less than others, and its row is as exact as theirs.
So rows are independent that are so with the columns of each frame over a size e^(-x_f) of its motions, by which all parts of a
row are of one size,

    sum over rows i, frames f of (log |G_if| + x_f - r_i)^2 = min,        G_if: part of row i at frame f                (2)

Whatever these sizes are, what cancels at each frame of what its rows bear there cancels still: rows that are the same stay so.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.linalg.lapack import dgeqrf, dorgqr, dpotrf, dpotrs
from scipy.sparse.linalg import eigsh, splu

from ..matrices import dense, singular_values
from ..mechanics.bodies.coordinates import CoordinatePart
from ..rotations import Array
from .evaluation import Evaluation
from .lengths import SHUT

EPS = float(np.finfo(float).eps)
DEPENDENT = 0.1 * SHUT  # singular values below this share of the largest belong to rows that depend on each other
NEAR_SINGULAR = 1e-6
CERTAIN = 1e-5  # smallest over largest singular value above which a Gram matrix shows that rows are independent
INVERSE_ITERATIONS = 4
SYMMETRIC: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.0,
    "options": {"SymmetricMode": True},
}
WIDTH = 64  # columns that are made orthogonal together
FEW_ROWS = 300  # up to which singular values are all looked at
ROUNDOFF = 16.0 * EPS  # of G G^T, over its largest eigenvalue
EXACT = 1e-4  # share by which that may be off
LEAST_PART = math.sqrt(EPS)  # of a row at a frame, in (2): roundoff over it is below DEPENDENT
UNEVEN = 1e3  # range of sizes of motions from which on rows are looked at again
FREE = 1e-10  # of the equations of (2), against their weights
WIDEST = 300.0  # x of (2): squares of e^x are numbers


def _masses(ev: Evaluation) -> Array:
    """1 / D^2 of G_s over the core, (n_core,): frames of one mass, the largest; 1 for the modes of reduced bodies."""
    s = ev.system
    n, d = s.motions.n_twist, s.motions.dim
    frames, mass = np.zeros((s.n_frames, n)), np.ones(s.n_core)
    if s.rigid is not None:
        frames[s.rigid.frame] = np.diagonal(s.rigid.matrices(), axis1=1, axis2=2)
    # elastic bodies: the inertia of their frames at rest
    for _, p in s.fields:
        if p.frame < s.n_frames:
            frames[p.frame] = np.diag(p.mass_blocks(_at_rest(ev, p.frame), np.zeros(p.n))[0])

    for k, part in s.core_parts:
        local: Any = part
        if isinstance(local, CoordinatePart):
            mass[s.slices[1][k]] = np.diag(local.mass(s.local_q(ev.q, k)))

    # those of reduced bodies and rods alone count as the mass of all
    frames[:] = frames[:, :d].max(initial=0.0) or s.mass or 1.0
    frames[:, d:] *= s.length**2
    mass[: frames.size] = frames.ravel()
    return np.where(mass > 0, mass, mass.max(initial=1e-300))


def scaled_jacobian(ev: Evaluation) -> Array:
    """G_s of (1), dense (n_lam, n_core + ports of fields)."""
    return dense(_scaled(ev))


def _scaled(ev: Evaluation) -> Any:
    """The same, sparse where the Jacobian is."""
    core, scale = ev.jacobian.core, 1.0 / np.sqrt(_masses(ev))
    sparse = sp.issparse(core)
    G = core.tocsr() @ sp.diags_array(scale) if sparse else core * scale

    # ports of fields beside the core, of its size
    typical = max(float(abs(G).max()), 1.0) if 0 not in G.shape else 1.0
    port, columns = sp.csc_array(ev.jacobian.port) if sparse else ev.jacobian.port, [G]
    for k, part in ev.system.fields:
        ports = port[:, ev.system.port_slice(k)] @ _port_factor(ev, k, part)
        size = max(float(np.abs(ports).max(initial=0.0)), 1.0)
        columns.append(typical * ports / size)

    return _normed(sp.hstack(columns, format="csr") if sparse else np.concatenate(columns, axis=1))


@dataclass(frozen=True)
class Dependence:
    """The smallest singular values of G_s (rows x columns), of which some count as zero, ascending.

    ``vectors``: left ones, (rows, k); ``sizes``: values over the largest, (k,), with zeros for rows beyond the columns.
    """

    rows: int
    columns: int
    vectors: Array
    sizes: Array

    @property
    def loose(self) -> int:
        """Values that count as zero."""
        return int((self.sizes <= DEPENDENT).sum())

    @property
    def rank(self) -> int:
        """Independent rows."""
        return self.rows - self.loose

    @property
    def clear(self) -> int:
        """Values far from zero."""
        return self.rows - int((self.sizes <= NEAR_SINGULAR).sum())

    def of(self, rank: int) -> tuple[float, Array]:
        """The smallest of so many values, and its vector."""
        k = self.rows - min(rank, self.columns)
        return float(self.sizes[k]), self.vectors[:, k]


def scaled_rows(ev: Evaluation, *, evens: bool = True) -> Dependence:
    """What rows of G_s depend on each other, with (2) where they depend less then, if ``evens``."""
    G = _scaled(ev)
    found = _smallest(G)
    unclear = found.rows - found.clear
    if evens and unclear and (even := _evened(G, _frames(ev))) is not None and _below(even, NEAR_SINGULAR) < unclear:
        evened = _smallest(even)
        found = evened if evened.clear > found.clear else found
    return found


def _smallest(G: Any) -> Dependence:
    """The smallest singular values of G, some of them far from zero. Few rows take all; of many those on vectors that inverse
    iterations with G G^T leave, which the roundoff of squares does not reach.
    """
    m, count = G.shape[0], FEW_ROWS // 8
    if m <= FEW_ROWS:
        return _found_on(G, np.eye(m))
    G = sp.csr_array(G)
    solve, largest = _gram(G, ROUNDOFF)
    assert solve is not None
    count += _below(G, NEAR_SINGULAR * math.sqrt(largest))
    while 2 * count < m:
        found = _found_on(G, inverse_iterated(solve, np.random.default_rng(0).normal(size=(m, count)))[0])
        if found.clear > m - count:
            return found
        count *= 2
    return _found_on(G, np.eye(m))


def _below(G: Any, size: float) -> int:
    """Singular values of G below a size by Sylvester's law of inertia: negative pivots of G G^T - size^2; 0 if one is 0."""
    gram = sp.csr_array(G @ G.T) - size**2 * sp.eye_array(G.shape[0])
    try:
        factor = splu(gram.tocsc(), **SYMMETRIC)
    except RuntimeError:  # a pivot is zero
        return 0
    return int((factor.U.diagonal() < 0).sum()) if np.array_equal(factor.perm_r, factor.perm_c) else 0


def _found_on(G: Any, V: Array) -> Dependence:
    """Singular values of G on the span of V (rows, k)."""
    (m, n), k = G.shape, V.shape[1]
    _, s, W = singular_values(dense(G.T @ V), full=k > n)
    largest = s[0] if k == m else math.sqrt(eigsh(G @ G.T, 1, v0=np.ones(m), tol=EXACT)[0][0])
    sizes = np.concatenate((s, np.zeros(k - len(s)))) / (largest or 1.0)
    return Dependence(m, n, (V @ W.T)[:, ::-1], sizes[::-1])


def _frames(ev: Evaluation) -> Any:
    """Which frame a column of G_s is of, (columns, frames): 1 there; what a body has beside its frame goes with it."""
    s = ev.system
    counts = [s.motions.n_twist] * s.n_frames
    frames = list(range(s.n_frames))
    for span, parts in ((s.slices[1], s.core_parts), (s.slices[2], s.fields)):
        counts += [span[k].stop - span[k].start for k, _ in parts]
        frames += [min(getattr(part, "frame", s.n_frames), s.n_frames + k) for k, part in parts]
    of = np.repeat(frames, counts)
    return sp.csr_array((np.ones(len(of)), (np.arange(len(of)), of)))


def _evened(G: Any, frames: Any) -> Any:
    """G with (2), its rows of norm 1; None where the motions of all frames are of about one size."""
    parts = (sp.csr_array(G) ** 2 @ frames).tocoo()
    rows, of = parts.coords
    met = sp.csr_array((np.ones(len(rows)), (rows, of)), shape=parts.shape)
    count = np.maximum(met.sum(axis=1), 1.0)
    size = np.log(np.maximum(np.sqrt(parts.data), LEAST_PART * np.sqrt(parts.max(axis=1).toarray().ravel())[rows]))
    apart = size - (np.bincount(rows, size, len(count)) / count)[rows]

    # one size for all frames that rows connect would be as good
    equations = sp.diags_array(met.sum(axis=0) + FREE) - met.T @ sp.diags_array(1.0 / count) @ met
    x = np.clip(splu(equations.tocsc()).solve(-np.bincount(of, apart, met.shape[1])), -WIDEST, WIDEST)
    return _normed(G @ sp.diags_array(frames @ np.exp(x))) if np.ptp(x) > math.log(UNEVEN) else None


def _normed(G: Any) -> Any:
    """Rows of norm 1, those of zeros as they are."""
    square = G.multiply(G) if sp.issparse(G) else G * G
    size = np.sqrt(np.asarray(square.sum(axis=1)).ravel())
    return sp.diags_array(1.0 / np.where(size > 0, size, 1.0)) @ G


def rows_are_independent(ev: Evaluation, above: float = CERTAIN, *, evens: bool = True) -> bool:
    """Whether the constraint rows certainly do not depend on each other; False where a closer look is needed,
    :func:`scaled_rows`. ``above``: sigma_min / sigma_max that they have; up to CERTAIN also with (2), if ``evens``.

    A factor of G_s G_s^T and a few inverse iterations tell its smallest eigenvalue, sigma_min^2: for chains and trees the work is
    proportional to their length. Squares hide what is below 1e-8, so only sigma_min > 1e-5 sigma_max is certain.
    """
    G = _scaled(ev)
    if _certainly(G, above):
        return True
    even = _evened(G, _frames(ev)) if evens and above <= CERTAIN else None
    return even is not None and _certainly(even, above)


def _certainly(G: Any, above: float) -> bool:
    """Whether a factor tells that sigma_min / sigma_max of G is at least that."""
    solve, largest = _gram(G)
    return solve is not None and inverse_bound(solve, G.shape[0]) * largest < 1.0 / above**2


def _gram(G: Any, shift: float = 0.0) -> tuple[Callable[[Array], Array] | None, float]:
    """What solves with G G^T, None where it has no factor, and a bound of its largest eigenvalue; ``shift``: share of that bound
    that is added.
    """
    gram = G @ G.T
    largest = float(abs(gram).sum(axis=0).max())
    if sp.issparse(gram):
        gram = gram + shift * largest * sp.eye_array(G.shape[0])
        try:
            return splu(gram.tocsc(), **SYMMETRIC).solve, largest
        except RuntimeError:  # a pivot is zero
            return None, largest
    factor, fault = dpotrf(gram, lower=1)
    return (None if fault else lambda x: np.asarray(dpotrs(factor, x, lower=1)[0])), largest


def rows_differ(ev: Evaluation) -> bool:
    """Whether rows that are too many for singular values are further from dependence than roundoff of G_s G_s^T tells."""
    return rows_are_independent(ev, math.sqrt(ev.system.n_lam * np.finfo(float).eps))


def inverse_bound(solve: Callable[[Array], Array], count: int) -> float:
    """A lower bound of the largest eigenvalue of the inverse of a Gram matrix of ``count`` rows, by its factor ``solve``, or
    infinity.
    """
    return inverse_iterated(solve, 1.0 + 0.5 * np.cos(np.arange(count))[:, None])[1]  # no special direction


def inverse_iterated(solve: Callable[[Array], Array], V: Array) -> tuple[Array, float]:
    """Columns (n, k) behind inverse iterations, orthonormal: each brings out the smallest eigenvalues more. And how far the last
    one made the first column grow, infinite where a number is not finite.
    """
    room, grown = WIDTH * V.shape[1], 0.0
    for _ in range(INVERSE_ITERATIONS):
        reflections, scales, _, _ = dgeqrf(solve(V), lwork=room)
        V, grown = dorgqr(reflections, scales, lwork=room)[0], abs(float(reflections[0, 0]))
        if not math.isfinite(grown):
            return V, math.inf
    return V, grown


def _port_factor(ev: Evaluation, k: int, part: Any) -> Array:
    """F with F F^T = P P^T for the ports p = P w of field k: two ties that share nodes may depend on each other.

    It stays while the ports are where they are.
    """
    cache, version = ev.system.cache, part.column_version(ev.t)
    known = cache.get(("port factor", k))
    if known is None or known[0] != version:
        known = cache["port factor", k] = version, _gram_factor(part.port_gram(ev.t))
    return np.asarray(known[1])


def _gram_factor(gram: Array) -> Array:
    """F with F F^T = ``gram``, that of ports of different size."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    # eigenvalues of roundoff stand for ports that depend on others
    values[values < 1e-13 * len(size)] = 0.0
    return np.asarray(size[:, None] * vectors * np.sqrt(values))


def _at_rest(ev: Evaluation, frame: int) -> Any:
    from ..mechanics.placements import FrameMotion

    n, d = ev.system.motions.n_twist, ev.system.motions.dim
    return FrameMotion(ev.t, ev.rotation[frame], np.zeros(n), None, np.zeros(d))
