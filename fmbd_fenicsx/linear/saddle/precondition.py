"""Preconditioners of the multipliers' Schur complement S = sum_k B_k E_k^-1 B_k^T.

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
:func:`lumped` takes B diag(E)^-1 B^T: cheap, but its iterations grow like h^-1/2 outside dt ~ h.

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

from ...fem.assembly import petsc_of
from ...fem.traces.stability import pencil
from ...fem.traces.traces import Trace
from ...rotations import Array
from ..rigid_modes import rigid_mass, rigid_modes
from .elastic import Elastic
from .saddle import SaddlePoint, share_of
from .ties import TraceTie

Group = tuple[str, list[int], sp.csr_matrix]


@runtime_checkable
class MultiplierPreconditioner(Protocol):
    """Makes S~, one matrix for each group of ties."""

    def groups(self, saddle: SaddlePoint) -> list[Group]:
        """Groups: name of the split, numbers of the ties, S~ (replicated); collective."""


@dataclass(frozen=True)
class Fractional:
    """Equations (2) and (3) for all ties together.

    Above ``limit`` multipliers in all, each tie is a group of its own without (3); above ``limit`` functions on one
    surface (the eigenproblem is dense) its block is :func:`lumped`. ``layer`` is c, ``grid`` is g (a mesh is stiffer
    than the continuum for its shortest waves), ``stiffness`` is s (a half space under normal and tangential forces);
    all three were fitted once to the spectrum of S~^-1 S on a square.
    """

    limit: int = 2500
    layer: float = 0.35
    grid: float = 0.5
    stiffness: float = 1.7

    def groups(self, saddle: SaddlePoint) -> list[Group]:
        """One group "multipliers" (the tie's name when there is one only), or one for each tie;
        collective.
        """
        if saddle.n_multipliers > self.limit:
            return [(t.name, [i], self.block(saddle, i)) for i, t in enumerate(saddle.ties)]
        # bodies without supports add their rigid motions to all ties at once, (3)
        S = sp.block_diag([self.block(saddle, i) for i in range(len(saddle.ties))]).toarray()
        S += self.rigid(saddle)
        name = saddle.ties[0].name if len(saddle.ties) == 1 else "multipliers"
        return [(name, list(range(len(saddle.ties))), sp.csr_matrix(S))]

    def block(self, saddle: Any, i: int) -> sp.csr_matrix:
        """S~ of tie i, replicated."""
        t = saddle.ties[i]
        if not t.sides or max(side.n for _, side, _ in t.sides) > self.limit:
            return lumped(saddle, i)
        along: Any = 0
        across: Any = 0
        for k, surface, B in t.sides:
            a, b = self._answers(saddle.elastic[k], surface, B)
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

    def rigid(self, saddle: SaddlePoint) -> Array:
        """Equation (3), (n, n)."""
        S = np.zeros((saddle.n_multipliers,) * 2)
        for k, e in enumerate(saddle.elastic):
            gram, BR = rigid_term(e, k, saddle.ties)
            S += BR @ np.linalg.solve(gram, BR.T)
        return S


def rigid_term(e: Elastic, k: int, ties: Sequence[TraceTie]) -> tuple[Array, Array]:
    """cm R^T M R and B R of body k, the latter with the rows of all ties; collective over the body's ranks."""
    R = rigid_modes(e.body)
    first = np.cumsum([0, *(t.rows for t in ties)])
    BR = np.zeros((first[-1], R.shape[1]))
    for i, t in enumerate(ties):
        for body, B in t.columns:
            if body == k:
                BR[first[i] : first[i + 1]] += B @ R

    return e.inertia * rigid_mass(e.body, R), e.body.total(BR)


def lumped(saddle: Any, i: int) -> sp.csr_matrix:
    """B diag(E)^-1 B^T, replicated."""
    out: Any = 0
    for k, B in saddle.ties[i].columns:
        # each rank knows its own displacements; the sum is the same on all
        part = (B @ sp.diags(1.0 / saddle.diagonal(k)) @ B.T).tocsr()
        out = out + sum(saddle.comm.allgather(part))
    return out.tocsr()


def inverse_of(S: sp.csr_matrix) -> Callable[[Array], Array]:
    """r -> S~^-1 r; blocks that are nearly full are factored as such."""
    full = S.nnz > 0.2 * S.shape[0] ** 2
    return partial(sl.cho_solve, sl.cho_factor(S.toarray())) if full else spl.splu(S.tocsc()).solve


def to_petsc(S: sp.csr_matrix, saddle: Any, parts: list[int] | None = None) -> Any:
    """Own rows of a replicated matrix; its rows are those of ties with ``parts`` rows each, every one split
    evenly.
    """
    from petsc4py import PETSc

    comm = saddle.comm
    order, mine = rank_order([S.shape[0]] if parts is None else parts, comm)

    S = S[order][:, order].tocsr()[mine]
    A = petsc_of(S, (S.shape, S.shape), comm)
    A.setOption(PETSc.Mat.Option.SPD, True)
    return A


def rank_order(parts: list[int], comm: Any) -> tuple[np.ndarray, slice]:
    """Replicated rows of consecutive parts in the order of ranks that hold them, and this rank's slice of
    it.
    """
    starts = np.cumsum([0, *parts])
    chunks, before = [], 0
    for rank in range(comm.size):
        # each part is split evenly among the ranks
        for first, n in zip(starts, parts, strict=False):
            low = sum(share_of(n, comm, r) for r in range(rank))
            chunks.append(np.arange(first + low, first + low + share_of(n, comm, rank)))
            if rank < comm.rank:
                before += len(chunks[-1])
    own = sum(share_of(n, comm) for n in parts)
    return np.concatenate(chunks), slice(before, before + own)
