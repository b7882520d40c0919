"""Ports of second order: how the ends of a bent body approach each other, and how their forces stiffen or soften it.

A linear field moves a surface by its ports p = B u. A body that bends also gets shorter. Let u_r be the static displacements
under a unit force or moment r on the surface, with the body held at another, and G_r = K_g(u_r) the geometric stiffness of
that stress (``mechanics.elastic.stiffening``). Without work of the membrane stress the surface moves by

    y_r(u) = -1/2 u^T G_r u          along the force r, or turns about the moment r                             (1)

to second order. Ports are then p = B u + N y(u), N the ports of a rigid motion of the surface, and their forces act with the
transpose of the derivative: joint forces, springs and forces f on the surface add -sum_r (N^T f)_r G_r u to the balance of the
body, tension stiffens and pressure softens it down to buckling. Nothing is put in by hand: positions, velocities, constraints
and forces are those of (1), so joints still do no work.

Source: Wallrapp and Schwertassek, doi:10.1002/nme.1620320818 (second-order displacements and the stress of the loads).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...rotations import Array, Motions


@dataclass(frozen=True, eq=False)
class Bent:
    """The derivative of (1) at one u: ``slopes`` (n, r) columns G_r u, this rank's share; ``N`` (n_port, r)."""

    slopes: Array
    N: Array
    total: Callable[[Array], Array]

    def along(self, w: Array) -> Array:
        """Rates of the ports for rates w of u, -N (G u)^T w, (n_port,); collective."""
        return np.asarray(self.N @ self.total(-(self.slopes.T @ w)))

    def force(self, f: Array) -> Array:
        """Forces on u of port forces f, the transpose of :meth:`along`."""
        return np.asarray(-(self.slopes @ (self.N.T @ f)))

    @property
    def matrix(self) -> Array:
        """Change of the port matrix, (n_port, n); replicated parts."""
        return -self.N @ self.slopes.T

    def values(self, u: Array) -> Array:
        """N y(u) at this same u, (n_port,): y_r = -1/2 u^T G_r u is half its derivative along u. Collective."""
        return 0.5 * self.along(u)


@dataclass(frozen=True, eq=False)
class Shortening:
    """(1) of one part: ``products`` gives the columns G_r u (n, r) of a u (n,), ``N`` (n_port, r) what (1) does to the ports,
    ``total`` the sum over ranks.

    ``G`` (r, n, n): the matrices themselves, replicated parts only.
    """

    products: Callable[[Array], Array]
    N: Array
    total: Callable[[Array], Array]
    G: Array | None = None

    def at(self, u: Array) -> Bent:
        """The derivative at u; collective."""
        return Bent(self.products(u), self.N, self.total)

    def bias(self, v: Array) -> Array:
        """Accelerations of the ports by the rates v of u alone, (n_port,); collective."""
        return self.at(v).along(v)


def rigid_ports(motions: Motions, reference: Array) -> Array:
    """Ports ((1 + d) d, d + n_rot) of a surface that moves by one unit of each rigid motion about its centroid;
    ``reference`` (1 + d, d).
    """
    d, n = motions.dim, motions.n_rot
    N = np.zeros((1 + d, d, d + n))
    # moments of a surface: the first is its place, the others turn with it
    N[0, range(d), range(d)] = 1.0
    for k in range(n):
        N[1:, :, d + k] = motions.spin(np.eye(n)[k : k + 1], reference[1:])
    return N.reshape((1 + d) * d, d + n)


def of_constants(motions: Motions, surfaces: list[Any], n_port: int) -> Shortening | None:
    """(1) of a reduced body from the data of its surfaces in use; None where no surface has any."""
    if all(s.bend is None for s in surfaces):
        return None
    G, blocks = [], []
    for i, s in enumerate(surfaces):
        if s.bend is None:
            continue
        # ports of this surface among those of all in use
        own = rigid_ports(motions, s.reference)[:, : len(s.bend)]
        block = np.zeros((n_port, len(s.bend)))
        block[i * len(own) : (i + 1) * len(own)] = own
        G.append(s.bend)
        blocks.append(block)

    stacked = np.concatenate(G)
    return Shortening(lambda u: np.asarray((stacked @ u).T), np.concatenate(blocks, axis=1), np.asarray, stacked)
