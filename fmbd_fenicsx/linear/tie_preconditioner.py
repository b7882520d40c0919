"""Preconditioners of ties: of the multipliers' Schur complement S = sum_k B_k E_k^-1 B_k^T.

E_k = cm M + ck K of an elastic body answers to a surface force with the symbol (wave number k, shear modulus G)

    1 / (ck G (sqrt(k^2 + 1/l^2) + c h / l^2)),       l^2 = ck G / (cm rho),                                   (1)

quasi-static for waves longer than l, added mass of the first cell layer (c h) where the mesh cannot see l. With the pencil
(K + M / l^2) X = M X L of the surface that is a fractional power of L: :class:`Fractional` builds

    S~ = sum_k  C X (s ck G)^-1 ((L + g (h L)^2)^1/2 + c h / l^2)^-1 X^T C^T                                   (2)

with each body's own surface mesh and coupling C. Normal forces also move mass that shear alone does not reach: their symbol has
l^-2 (K + 1/l_p^2)^-1/2 more, l_p^2 = l^2 (lambda + 2 G) / G (potential flow when incompressible). Waves longer than the body
move it as a whole: its rigid modes R add

    sum_k  B_k R (cm R^T M R)^-1 R^T B_k^T                                                                     (3)

and connect the ties of a body, so that counts do not grow with the number of bodies. Of very many multipliers on one surface
:class:`Lumped` takes B diag(E)^-1 B^T: cheap, but its iterations grow like h^-1/2 outside dt ~ h.

Sources: Toselli and Widlund, Domain Decomposition Methods (doi:10.1007/b137868), for the Steklov-Poincare operator; Kuchta,
Nordaas, Verschaeve, Mortensen and Mardal (doi:10.1137/15M1052822) for fractional powers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from ..fem.traces.stability import pencil
from ..fem.traces.traces import Trace
from ..rotations import Array
from .blocks.elastic_blocks import Elastic
from .rigid_modes import rigid_mass, rigid_modes


@dataclass(frozen=True, eq=False)
class TraceTie:
    """Rows sum_k B_k u_k = g of a tie.

    ``columns``: (number of the body, B_k (rows, n_owned d) on this rank); ``components``: rows for each function of the
    multipliers, d of a full tie, 1 of a normal one; ``sides``: (number of the body, its surface, scalar coupling with all nodes
    of the surface).
    """

    name: str
    columns: tuple[tuple[int, sp.csr_matrix], ...]
    components: int
    sides: tuple[tuple[int, Trace, sp.csr_matrix], ...]

    @property
    def rows(self) -> int:
        """Rows, the same on all ranks."""
        return int(self.columns[0][1].shape[0])


@runtime_checkable
class MultiplierPreconditioner(Protocol):
    """Makes S~ of one tie."""

    def block(self, seen: Any, i: int) -> sp.csr_matrix:
        """S~ of tie i of ``seen``, replicated; collective. See :class:`.iterated_multipliers.SceneTies`."""


@dataclass(frozen=True)
class Lumped:
    """B diag(E)^-1 B^T."""

    def block(self, seen: Any, i: int) -> sp.csr_matrix:
        """S~ of tie i, replicated; collective."""
        out: Any = 0
        for k, B in seen.ties[i].columns:
            # each rank knows its own displacements; the sum is the same on all
            part = (B @ sp.diags(1.0 / seen.diagonal(k)) @ B.T).tocsr()
            out = out + sum(seen.comm.allgather(part))
        return out.tocsr()


@dataclass(frozen=True)
class Fractional:
    """Equation (2); above ``limit`` functions on one surface (the eigenproblem is dense) :class:`Lumped`.

    ``layer`` is c, ``grid`` is g (a mesh is stiffer than the continuum for its shortest waves), ``stiffness`` is s (a half space
    under normal and tangential forces); all three are fitted to the spectrum of S~^-1 S on a square.
    """

    limit: int = 2500
    layer: float = 0.35
    grid: float = 0.5
    stiffness: float = 1.7

    def block(self, seen: Any, i: int) -> sp.csr_matrix:
        """S~ of tie i, replicated; collective."""
        t = seen.ties[i]
        if max(side.n for _, side, _ in t.sides) > self.limit:
            return Lumped().block(seen, i)
        along: Any = 0
        across: Any = 0
        for k, surface, B in t.sides:
            a, b = self._answers(seen.elastic[k], surface, B)
            along, across = along + a, across + b
        if t.components == 1:
            return sp.csr_matrix(across)
        # tangential and normal answers, in the mean normal of the first side
        n = t.sides[0][1].mean_normal
        N = np.outer(n, n)
        return (sp.kron(sp.csr_matrix(along), np.eye(len(n)) - N) + sp.kron(sp.csr_matrix(across), N)).tocsr()

    def _answers(self, e: Any, surface: Trace, B: sp.csr_matrix) -> tuple[Array, Array]:
        """Terms of (2) for tangential and normal forces on one body, (n, n) each."""
        shear, axial = e.moduli
        h = surface.h / surface.degree
        depth = e.depth
        _, K, X = pencil(surface, np.inf)
        C = B @ X

        # waves of the surface reach no farther into the body than its size, or than a step lets them
        L = K + 1.0 / min(depth, e.size) ** 2
        waves = np.sqrt(L + self.grid * (h * L) ** 2)
        sheared = self.stiffness * (waves + self.layer * h / depth**2)

        # under pressure a layer as thick as the body's reach is compressed too
        reach = min(depth**2 * axial / shear, e.size**2)
        pressed = sheared + 1.0 / (depth**2 * np.sqrt(K + 1.0 / reach))

        def answer(symbol: Array) -> Array:
            found = (C / (e.ck * shear * symbol)) @ C.T
            return 0.5 * (found + found.T)

        return answer(sheared), answer(pressed)


def rigid_term(e: Elastic, k: int, ties: Sequence[TraceTie]) -> tuple[Array, Array]:
    """cm R^T M R and B R of body k, the latter with the rows of all ties; collective over the body's ranks."""
    R = rigid_modes(e.body)
    first = np.cumsum([0, *(t.rows for t in ties)])
    BR = np.zeros((first[-1], R.shape[1]))
    for i, t in enumerate(ties):
        for body, B in t.columns:
            if body == k:
                BR[first[i] : first[i + 1]] += B @ R

    return e.cm * rigid_mass(e.body, R), e.body.total(BR)


def inverse_of(S: sp.csr_matrix) -> Callable[[Array], Array]:
    """r -> S~^-1 r; blocks that are nearly full are factored as such."""
    full = S.nnz > 0.2 * S.shape[0] ** 2
    return partial(sl.cho_solve, sl.cho_factor(S.toarray())) if full else spl.splu(S.tocsc()).solve
