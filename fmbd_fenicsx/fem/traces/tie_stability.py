"""Inf-sup constants of the ties of a scene: under refinement, and of all ties at once.

A constant above 0.1 on the user's mesh says nothing about a finer one: P1 / P0 starts at 0.4 and halves with h. So each body
is refined once (every edge halved) and the constant compared,

    beta(h / 2) < 0.6 beta(h)  and  beta(h / 2) < 0.5:      the space falls like h.                              (1)

(Unstable spaces of the table in ``docs/traces.md`` fall by 0.50 to 0.59 per halving; of the stable ones only P1 with merged ends
on two cells a side falls as fast, to 0.58.)

Ties that are stable one by one may depend on each other where their surfaces meet (cross-points). For all ties of a scene

    beta^2 = min_mu  mu^T (sum_k B_k A_k^-1 B_k^T) mu / sum_j |mu_j|^2_(-1/2)                                    (2)

over the bodies k; a zero mode is a combination of multipliers that no displacement sees. Bodies are taken as elastic, rigid
partners and the ground as fixed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from ...errors import MeshError
from ...rotations import Array
from .mortar import mortar
from .multipliers import default_space
from .stability import BodyNorm, DualNorm, InfSup, Stability, infsup, smallest
from .traces import Trace, surface_trace, trace_of

FALL, LOW = 0.6, 0.5  # (1)
LIMIT = 200_000  # nodes of a refined body beyond which refinement is left out


@dataclass(frozen=True)
class Refined:
    """The constant of one tie on the body's mesh, and on the halved mesh (None where that is too large, or cannot be made)."""

    coarse: InfSup
    fine: InfSup | None

    @property
    def falls(self) -> bool:
        """Criterion (1)."""
        return self.fine is not None and self.fine.constant < min(FALL * self.coarse.constant, LOW)

    @property
    def stable(self) -> bool:
        """Above the level that is reported, and not falling like h."""
        return self.coarse.stable and not self.falls

    def __str__(self) -> str:
        if self.falls and self.fine is not None and self.coarse.stable:
            c, f = self.coarse, self.fine
            return (
                f"{c.name}: inf-sup constant {c.constant:.3f} at h = {c.h:.3g} m, {f.constant:.3f} at h = {f.h:.3g} m: falls "
                "like h, UNSTABLE: choose another multiplier space"
            )
        return str(self.coarse) + (
            "" if self.fine else " (not compared with a finer mesh: too large, or not known how to refine it)"
        )


@dataclass(frozen=True)
class Together(Stability):
    """Constant (2) of several ties, the zero modes among their multipliers (per component), and each tie's share in them."""

    beta: float
    zero_modes: int
    multipliers: int
    shares: dict[str, float]

    def __str__(self) -> str:
        names = ", ".join(f'"{n}"' for n, share in self.shares.items() if share > 1e-3)
        modes = f"{self.zero_modes} zero modes of {self.multipliers} multipliers"
        verdict = "stable" if self.stable else f"UNSTABLE where {names} meet: take merged ends, say Continuous(1)"
        return f"all ties together: inf-sup constant {self.constant:.3f}, {modes}: {verdict}"


def infsup_refined(tie: Any) -> Refined:
    """The inf-sup constant of a tie on its body's mesh and on the halved mesh; collective."""
    coarse = infsup(tie)
    mesh = tie.a.body.mesh
    name = tie.a.name
    cells = mesh.dolfinx.topology.index_map(mesh.dim).size_global
    if cells * 2**mesh.dim > LIMIT:
        return Refined(coarse, None)
    try:
        finer = mesh.refined()
    except MeshError:  # nobody knows how it was made
        return Refined(coarse, None)
    return Refined(coarse, infsup((finer, name), tie.space, degree=tie.a.body.degree))


def infsup_together(ties: Sequence[Any]) -> Together:
    """Constant (2) of several ties; collective."""
    from dolfinx import fem

    bodies = {side.body.name: side.body for t in ties for side in t.surfaces}
    length = max(b.mesh.extent for b in bodies.values())
    norms = {name: BodyNorm(b.mesh, b.degree, length=length) for name, b in bodies.items()}
    spaces = {name: fem.functionspace(b.mesh.dolfinx, ("Lagrange", b.degree)) for name, b in bodies.items()}

    # rows of all ties on each body, and the norms of their multipliers
    rows: dict[str, list[Any]] = {name: [] for name in bodies}
    duals, counts = [], []
    for t in ties:
        mu, sides = _couplings(t, spaces)
        duals.append(DualNorm(mu, length=length).matrix)
        counts.append(mu.n)
        for name, body in bodies.items():
            found = [trace.columns(B) for side, trace, B in sides if side == body.name]
            rows[name].append(sum(found) if found else sp.csr_matrix((mu.n, norms[name].fixed.size)))

    S = np.sum([norms[name].product(sp.vstack(rows[name], format="csr")) for name in bodies], axis=0)
    for norm in norms.values():
        norm.destroy()

    # beta^2 are the eigenvalues of S beside the norms, of which sliding ties have one component
    P, owner = _components(ties, counts)
    d = P.shape[0] // len(S)
    values, vectors = sl.eigh(P.T @ np.kron(S, np.eye(d)) @ P, P.T @ np.kron(sl.block_diag(*duals), np.eye(d)) @ P)
    beta, zero = smallest(values)

    # whose multipliers the weakest are
    weak = (vectors[:, : max(zero, 1)] ** 2).sum(1)
    shares = {t.name: float(weak[owner == i].sum() / weak.sum()) for i, t in enumerate(ties)}
    return Together(beta, zero, P.shape[1], shares)


def _couplings(tie: Any, spaces: dict[str, Any]) -> tuple[Any, list[tuple[str, Trace, Any]]]:
    """Multipliers of a tie and its sides (body, trace, coupling), scalar."""
    a, b = tie.a, tie.b
    trace = trace_of(spaces[a.body.name], a.body.mesh, a.name)
    space = tie.space or default_space(trace.degree)
    if b not in tie.surfaces:
        mu = space.on(trace)
        return mu, [(a.body.name, trace, mu.coupling())]
    c = mortar(trace, trace_of(spaces[b.body.name], b.body.mesh, b.name), space)
    return c.multipliers, [(a.body.name, trace, c.slave), (b.body.name, c.master_trace, -c.master)]


def _components(ties: Sequence[Any], counts: list[int]) -> tuple[Array, np.ndarray]:
    """P (n d, rows): the rows of full ties and the normal rows of sliding ones; the tie of each row. Scalar if all are full."""
    if not any(t.sliding for t in ties):
        return np.eye(sum(counts)), np.repeat(np.arange(len(ties)), counts)
    blocks, owner = [], []
    for i, (t, n) in enumerate(zip(ties, counts, strict=True)):
        d = t.a.dim
        normal: Array = np.eye(d)
        if t.sliding:
            trace = surface_trace(t.a.body.mesh, t.a.name)
            normal = trace.mean_normal[:, None]
        blocks.append(np.kron(np.eye(n), normal))
        owner += [i] * blocks[-1].shape[1]
    return sl.block_diag(*blocks), np.array(owner)
