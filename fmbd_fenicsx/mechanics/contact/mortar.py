"""Contact of two elastic bodies with meshes that do not match: mortar rows.

    D_ji = int psi_j phi_i,   M_jl = int psi_j (phi_l o pi),   w_j = sum_l M_jl                             (1)
    g_j = n_j . (sum_i D_ji x_i - sum_l M_jl x_l) / w_j                                                     (2)

psi_j is the dual basis on the slave (on quadratic triangles, where none exists, and on faces of hexahedra the hat functions of
the vertices, a stable pair). pi goes to the master along the slave's normal, and both integrals run over the true intersections
of facets (``fem.traces.mortar``), so constant pressure passes to roundoff. n_j points from the master to the slave: minus the
mean outward normal at the slave's node. Pairing, D, M and n are taken in the deformed configuration at the start of each step
and kept during it (finite sliding), so the rows are linear in a step. A new pairing of curved surfaces finds closed points
slightly overlapped (second order in the sliding of a step); pushing them out would do work from nothing, so the conserving rule
asks for g >= min(g at its start, 0) instead and its energy argument holds; it pairs beside the start, see
``contact_midpoint``, (5). Dissipative rules push out. Bodies whose bounding boxes stay apart cost the test of the boxes.

Source: Puso and Laursen, doi:10.1016/j.cma.2003.10.010; Huber and Wohlmuth, doi:10.1007/s00791-008-0082-4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...fem.traces.mortar import diameters, overlap
from ...fem.traces.multipliers import Continuous, Dual, Ends
from ...fem.traces.traces import Trace as Facets
from ...fem.traces.traces import across
from ...rotations import Array, Motions
from .contact_set import Here
from .obstacles import Way
from .pair import Side, SomeRows, bodies_overlap
from .rows import LinearRows, Rows, Touch, directions_of, in_turn
from .trace import ContactTrace

COVERED = 0.05  # a multiplier with less than this share of its weight in the overlap is left out


@dataclass(frozen=True, eq=False)
class Means:
    """Weighted sums over nodes of a trace: entries (k,) of their matrix by rows, ascending."""

    row: np.ndarray
    node: np.ndarray
    weight: Array

    @classmethod
    def summed(cls, row: np.ndarray, node: np.ndarray, weight: Array) -> Means:
        """Of entries in any order, those of one place together."""
        n = int(node.max(initial=0)) + 1
        places, which = np.unique(row * n + node, return_inverse=True)
        total = np.bincount(which, weight, len(places))
        kept = total != 0.0
        return cls((places // n)[kept], (places % n)[kept], total[kept])

    def scaled(self, factor: Array) -> Means:
        """Row by row, (m,); those times zero are empty."""
        kept = factor[self.row] != 0.0
        row = self.row[kept]
        return Means(row, self.node[kept], self.weight[kept] * factor[row])

    def sums(self, m: int) -> Array:
        """Of the weights of each of m rows."""
        return np.bincount(self.row, self.weight, m).astype(float)

    def times(self, x: Array, m: int) -> Array:
        """Of x (n, d) at the nodes, (m, d)."""
        out = np.zeros((m, x.shape[1]))
        if len(self.row):
            out[self._rows] = np.add.reduceat(self.weight[:, None] * x[self.node], self._first)
        return out

    @cached_property
    def _first(self) -> np.ndarray:
        """Where the entries of a row begin."""
        return np.flatnonzero(np.diff(self.row, prepend=-1))

    @cached_property
    def _rows(self) -> np.ndarray:
        """Rows that have some."""
        return self.row[self._first]


@dataclass
class Pairing:
    """(1), (2) of one step: means S and Q of both sides, divided by w; n (m, d); ``on`` (m,) bool.

    ``offset`` (m,) m: overlap at the start of the step that came from the new pairing, not pushed out again. Candidates are in
    the order of the trace.
    """

    slave: Means
    master: Means
    normal: Array
    on: np.ndarray
    offset: Array

    def between(self, xs: Array, xm: Array) -> Array:
        """From the master to the slave, (m, d)."""
        m = len(self.on)
        return self.slave.times(xs, m) - self.master.times(xm, m)


NOTHING = Means(np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros(0))


class MortarPair:
    """One contact between two elastic surfaces; ``sides`` = numbers of the traces and surfaces, slave
    first.
    """

    carrier = None
    shape = None
    searches = True
    restitution = 0.0
    moving = False  # no side moves as prescribed

    def __init__(
        self, name: str, sides: tuple[Side, Side], facets: tuple[Facets, Facets], traces: list[ContactTrace], law: Any
    ) -> None:
        self.name, self.slave, self.master = name, sides[0], sides[1]
        self.friction, self.search, self.exchanged = law.friction, law.search, law.exchanged
        self.bounces, self.massless = law.bounces, law.massless
        self.facets = facets
        self.order = [_match(f, s, traces[s.trace]) for f, s in zip(facets, sides, strict=True)]

        # a multiplier at each node, at corners only where there is no dual basis
        hats = facets[0].dim == 3 and facets[0].order > 1
        self.basis = (Continuous(1, Ends.KEPT) if hats else Dual(Ends.KEPT)).on(facets[0])
        carriers = np.unique(facets[0].nodes[:, :3]) if hats else np.arange(facets[0].n)

        # candidates
        row = np.argsort(
            self.order[0][carriers]
        )  # candidates are in the order of the trace, functions in that of the facets
        self.multipliers, self.shares = _by_facets(self.basis.basis[row].tocoo(), len(facets[0].nodes))
        self.candidates = carriers[row]  # the facets' numbers of the nodes with a multiplier
        self.weight = np.asarray(self.basis.coupling().sum(axis=1)).ravel()[row]  # int psi_j at rest

        self.count = len(carriers)
        self.thickness = traces[sides[1].trace].thickness
        self.pairing: Pairing | None = None

    @classmethod
    def together(cls, pairs: list[MortarPair], motions: Motions, traces: Any) -> list[MortarPair]:
        """Each evaluates itself, see :meth:`.Pair.together`."""
        return pairs

    def overlap(self, system: Any, depth: float, x: Array, normal: Array) -> str:
        """The sentence that refuses a start with an overlap, as :meth:`.Pair.overlap`."""
        return bodies_overlap(self.name, depth, x, normal)

    def pressures(self, force: Array) -> Array:
        """Pressures (N/m^(d-1)) of normal forces on the candidates, (m,) N."""
        return force / self.weight

    @cached_property
    def trace_nodes(self) -> np.ndarray:
        """Numbers in the slave's trace of the candidates' nodes."""
        return np.asarray(self.order[0][self.candidates])

    # -- pairing ---------------------------------------------------------------------------------------------
    def update(self, here: Here, reach: float, *, begun: Here | None = None) -> None:
        """Pair the surfaces anew as they lie here; overlaps stay where a step has ``begun``. Collective."""
        at = [here.nodes(s.trace)[0] for s in (self.slave, self.master)]
        xs, xm = (x[o] for x, o in zip(at, self.order, strict=True))
        apart = float(np.linalg.norm(np.maximum(0.0, np.maximum(xs.min(0) - xm.max(0), xm.min(0) - xs.max(0)))))

        # the deformed facets, and how far they look
        slave = _moved(self.facets[0], xs)
        master = _moved(self.facets[1], xm)
        size = diameters(slave)
        sight = np.maximum(reach, 0.5 * size) if self.search is None else np.full(len(size), self.search)

        m = self.count
        on: np.ndarray = np.zeros(m, dtype=bool)
        normal = _nodal_normals(slave)[self.candidates]
        S = Q = NOTHING
        if apart <= sight.max():
            # overlaps of the facets as they lie now, gathered to the multipliers' functions
            pair, own, other = overlap(slave, master, self.basis.degree, sight)
            if len(pair):
                f, g = pair.T
                D = self._gathered(own, f, self.order[0][slave.nodes[f]])
                M = self._gathered(other, f, self.order[1][master.nodes[g]])

                w = M.sums(m)
                on = w > COVERED * self.weight
                inverse = np.where(on, 1.0 / np.where(on, w, 1.0), 0.0)
                S, Q = D.scaled(inverse), M.scaled(inverse)

        self.pairing = Pairing(S, Q, -normal, on, np.zeros(m))
        if begun is not None:
            places = (begun.nodes(s.trace)[0] for s in (self.slave, self.master))
            overlap_now = (-normal * self.pairing.between(*places)).sum(1)
            self.pairing.offset = np.where(on, np.minimum(overlap_now, 0.0), 0.0)

    def _gathered(self, blocks: Array, facets: np.ndarray, nodes: np.ndarray) -> Means:
        """Integrals of the multipliers from those of facet-wise functions (k, k_p, c), on ``nodes`` (k, c) of a trace."""
        found = self.shares[facets] @ blocks
        row = np.broadcast_to(self.multipliers[facets][:, :, None], found.shape)
        return Means.summed(row.ravel(), np.broadcast_to(nodes[:, None], found.shape).ravel(), found.ravel())

    def _ready(self, here: Here) -> Pairing:
        if self.pairing is None:
            self.update(here, 0.0)
        assert self.pairing is not None
        return self.pairing

    # -- rows ------------------------------------------------------------------------------------------------
    def touch(self, here: Here) -> Touch:
        """Gaps of this pair; collective."""
        pairing = self._ready(here)
        xs = here.nodes(self.slave.trace)[0]
        between = pairing.between(xs, here.nodes(self.master.trace)[0])
        along = (pairing.normal[:, None, :] @ between[:, :, None])[:, 0, 0]
        gap = np.where(pairing.on, along, np.inf)  # inf: nothing opposite
        return Touch(gap - pairing.offset, xs[self.trace_nodes], pairing.normal, between, gap)

    def some(self, near: np.ndarray) -> SomeRows:
        """Those of its candidates that are ``near``, (m,) bool."""
        return SomeRows(self, near)

    def rows(self, here: Here, way: Way | None) -> Rows:
        """Candidates of this pair; collective."""
        contacts, touch, pairing = here.contacts, self.touch(here), self._ready(here)
        S, Q = pairing.slave, pairing.master

        # each candidate's directions in turn
        e = directions_of(touch.normal, frictional=contacts.frictional)
        c = e.shape[1]
        core, field = contacts.blank(self.count * c)
        for side, means, sign in ((self.slave, S, 1.0), (self.master, Q, -1.0)):
            entries = in_turn(means.row, c), means.node.repeat(c), (sign * means.weight).repeat(c)
            contacts.add_nodes((core, field), side.trace, (entries, e.reshape(-1, e.shape[2])), here.nodes(side.trace))

        one = np.ones(self.count)
        return Rows(
            gap=touch.gap,
            L=LinearRows(core, tuple(field)),
            friction=self.friction * one,
            restitution=0.0 * one,
            normal=touch.normal,
            drift=np.zeros((self.count, c - 1)),
            trace=np.full(self.count, self.slave.trace if self.slave.trace in contacts.on_fields else -1),
        )


def _match(facets: Facets, side: Side, trace: ContactTrace) -> np.ndarray:
    """Number in the trace of each node of the facets, by position at rest."""
    from scipy.spatial import cKDTree

    assert side.surface is not None
    X = trace.at_rest[side.surface.nodes]
    return np.asarray(side.surface.nodes[cKDTree(X).query(facets.points)[1]])


def _moved(facets: Facets, x: Array) -> Facets:
    """The facets with nodes at x."""
    moved = replace(facets, points=x)
    n, before = across(moved.corners), across(facets.corners)
    n = n / np.sqrt((n * n).sum(1))[:, None]
    n *= np.sign((before * facets.normals).sum(1))[:, None]  # the side that was outward at rest
    return replace(facets, points=x, normals=n)


def _nodal_normals(facets: Facets) -> Array:
    """Mean outward normals at the nodes, (n, d)."""
    out = np.zeros_like(facets.points)
    weighted = np.repeat((facets.sizes[:, None] * facets.normals)[:, None], facets.nodes.shape[1], axis=1)
    np.add.at(out, facets.nodes, weighted)
    return np.asarray(out / np.linalg.norm(out, axis=1)[:, None])


def _by_facets(basis: Any, facets: int) -> tuple[np.ndarray, Array]:
    """Multipliers on each facet (facets, r), and their coefficients there (facets, r, k) by facet-wise functions.

    ``basis``: all of these, sparse. Facets with fewer multipliers have some with coefficients of zero.
    """
    k = basis.shape[1] // facets
    facet, function = np.divmod(basis.col, k)
    places, which = np.unique(facet * basis.shape[0] + basis.row, return_inverse=True)
    of, multiplier = np.divmod(places, basis.shape[0])
    number = np.arange(len(of)) - np.searchsorted(of, of)

    multipliers = np.zeros((facets, int(number.max()) + 1), dtype=int)
    multipliers[of, number] = multiplier
    shares = np.zeros((*multipliers.shape, k))
    shares[of[which], number[which], function] = basis.data
    return multipliers, shares
