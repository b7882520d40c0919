"""The matrix (1) of :mod:`.solver` in one configuration: its products, and how far they are from a right-hand side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...rotations import Array, rotate_nodal
from ...system.tangents.jacobian import Jacobian
from ..blocks.field_blocks import FactoredField
from .layout import SplitLayout

ROUNDOFF = 1e-13  # relative error that a product with the matrix may have


@dataclass(frozen=True, eq=False)
class StepMatrix:
    """(1), never assembled: C has constant columns, G is known by its ports.

    ``A`` (n_core, n_core); ``twists``: for each field the columns of C by the twist of its frame, (n_twist or 0, n_core);
    ``corotations``: rotations (d, d) of the axes of each field's factor, or None.
    """

    layout: SplitLayout
    A: Array
    G: Jacobian
    twists: list[Array]
    blocks: list[FactoredField]
    corotations: list[Any]

    # -- arrays -------------------------------------------------------------------------------------------------
    def pack(self, v: Array, lam: Array) -> Array:
        """This rank's entries of a PETSc vector of forces; nodal values turned back to where the factor is."""
        s = self.layout.system
        turned = zip(s.fields, self.corotations, strict=True)
        local = [rotate_nodal(s.local_v(v, k), R, back=True) for (k, _), R in turned]
        return self.layout.pack(v[: s.n_core], local, lam)

    def unpack(self, x: Array) -> tuple[Array, Array]:
        """An array like v and all multipliers from a PETSc vector of unknowns; collective."""
        core, local, lam = self.layout.unpack(x)
        turned = [rotate_nodal(u, R) for u, R in zip(local, self.corotations, strict=True)]
        return np.concatenate((core, *turned)), lam

    # -- products -----------------------------------------------------------------------------------------------
    def product(self, x: Array) -> Array:
        """The matrix times x, PETSc's arrays; collective."""
        balance, rows = self.terms(*self.unpack(x))
        return self.pack(np.sum(balance, axis=0), np.sum(rows, axis=0))

    def terms(self, v: Array, lam: Array) -> tuple[list[Array], list[Array]]:
        """Terms of (1) times (v, lam): those of the balance, like v, and those of the constraints; their sums are the product."""
        s, n = self.layout.system, self.layout.system.n_core
        own = np.zeros(s.n_v)
        mixed = np.zeros(s.n_v)
        own[:n] = self.A @ v[:n]

        # E u and C of each field, in the axes of its factor
        for i, (k, f) in enumerate(s.fields):
            at, R, C = s.slices[1][k], self.corotations[i], self.twists[i]
            u = rotate_nodal(v[at], R, back=True)
            own[at] = rotate_nodal(self.blocks[i].factor.product(u), R)
            if len(C):
                mixed[at] = rotate_nodal(f.inertia_columns @ (C @ v[:n]), R)
                mixed[:n] += C.T @ f.field.total(f.inertia_columns.T @ u)

        return [own, mixed, self.G.transposed(lam)], self._openings(v)

    def _openings(self, v: Array) -> list[Array]:
        """Terms of G v: of the core, and of each field, which meets G through its ports."""
        s = self.layout.system
        return [np.asarray(self.G.core @ v[: s.n_core]), *self.G.openings(v)]

    # -- residual -----------------------------------------------------------------------------------------------
    def relative_residual(self, x: Array, b: Array, *, bounds: Array, tolerance: float) -> float:
        """Largest |b - A x| of a block over the size of its own terms, PETSc's arrays; collective.

        Rows that x leaves at zero have terms of roundoff only: constraints are measured at least against 1e-6 of
        (tr S~_j x . diag(A, E) x)^1/2, which |G_j x| cannot exceed; more where the ``tolerance`` would else be below roundoff.
        ``bounds``: (tr S~_j)^1/2.
        """
        system = self.layout.system
        v, lam = self.unpack(x)
        balance, rows = self.terms(v, lam)
        forces = [-self.pack(term, np.zeros(system.n_lam)) for term in balance]
        openings = [-self.pack(np.zeros(system.n_v), term) for term in rows]
        terms = [b, *forces, *openings]

        norms = self.layout.norms([np.sum(terms, axis=0), *terms])
        if not np.isfinite(norms).all():
            return np.inf
        error = norms[0]
        sizes = norms[1:].sum(0)

        # constraints come last
        share = max(1e-6, ROUNDOFF / tolerance)
        m = len(sizes) - len(bounds)
        energy = abs(system.dot(v, balance[0]))
        sizes[m:] = np.maximum(sizes[m:], share * bounds * np.sqrt(energy))
        return max(_worst(error[:m], sizes[:m], share), _worst(error[m:], sizes[m:], share))


def _worst(error: Array, sizes: Array, share: float) -> float:
    """The largest error over its size, sizes at least a share of the largest; 0.0 of none."""
    least = max(share * sizes.max(initial=0.0), 1e-300)
    return float((error / np.maximum(sizes, least)).max(initial=0.0))
