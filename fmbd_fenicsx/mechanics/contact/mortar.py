"""Contact of two elastic bodies with meshes that do not match: mortar rows.

    D_ji = int psi_j phi_i,   M_jl = int psi_j (phi_l o pi),   w_j = sum_l M_jl                             (1)
    g_j = n_j . (sum_i D_ji x_i - sum_l M_jl x_l) / w_j                                                     (2)

psi_j is the dual basis on the slave (on quadratic triangles, where none exists, and on faces of hexahedra the hat functions of
the vertices, a stable pair). pi goes to the master along the slave's normal, and both integrals run over the true intersections
of facets (``fem.traces.mortar``), so constant pressure passes to roundoff. n_j points from the master to the slave: minus the
mean outward normal at the slave's node. Pairing, D, M and n are taken in the deformed configuration at the start of each step
and kept during it (finite sliding), so the rows are linear in a step. A new pairing of curved surfaces finds closed points
slightly overlapped (second order in the sliding of a step); pushing them out would do work from nothing, so the conserving rule
asks for g >= min(g at its start, 0) instead and its energy argument holds; dissipative rules push out. Bodies whose bounding
boxes stay apart cost the test of the boxes.

Source: Puso and Laursen, doi:10.1016/j.cma.2003.10.010; Huber and Wohlmuth, doi:10.1007/s00791-008-0082-4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...fem.traces.mortar import diameters, overlap
from ...fem.traces.multipliers import Continuous, Dual, Ends
from ...fem.traces.traces import Trace as Facets
from ...fem.traces.traces import scatter
from ...rotations import Array, Motions
from .contact_set import ContactSet, Entries, Here
from .pair import Side, bodies_overlap
from .rows import LinearRows, Rows, Touch, tangents_of
from .trace import ContactTrace

COVERED = 0.05  # a multiplier with less than this share of its weight in the overlap is left out


@dataclass
class Pairing:
    """(1), (2) of one step: rows S (m, slave nodes) and Q (m, master nodes), both divided by w; n (m, d); ``on`` (m,) bool.

    ``offset`` (m,) m: overlap at the start of the step that came from the new pairing, not pushed out again. Candidates are in
    the order of the trace. ``entries`` of S and -Q, by nodes of the traces.
    """

    slave: Any
    master: Any
    normal: Array
    on: np.ndarray
    offset: Array
    entries: tuple[Entries, Entries]


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
        self,
        name: str,
        sides: tuple[Side, Side],
        facets: tuple[Facets, Facets],
        traces: list[ContactTrace],
        law: Any,
    ) -> None:
        self.name, self.slave, self.master = name, sides[0], sides[1]
        self.friction, self.search = law.friction, law.search
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
        self.functions = self.basis.basis[row]
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

    @property
    def trace_nodes(self) -> np.ndarray:
        """Numbers in the slave's trace of the candidates' nodes."""
        return np.asarray(self.order[0][self.candidates])

    # -- pairing ---------------------------------------------------------------------------------------------
    def update(self, contacts: ContactSet, system: Any, q: Array, reach: float, *, keep: bool = False) -> None:
        """Pair the surfaces anew for a step that starts at q; ``keep``: overlaps found stay. Collective."""
        xs, xm = (
            contacts.nodes(system, q, s.trace)[0][o] for s, o in zip((self.slave, self.master), self.order, strict=True)
        )
        apart = float(np.linalg.norm(np.maximum(0.0, np.maximum(xs.min(0) - xm.max(0), xm.min(0) - xs.max(0)))))

        # the deformed facets, and how far they look
        slave = _moved(self.facets[0], xs)
        master = _moved(self.facets[1], xm)
        size = diameters(slave)
        sight = np.maximum(reach, 0.5 * size) if self.search is None else np.full(len(size), self.search)

        m = self.count
        on: np.ndarray = np.zeros(m, dtype=bool)
        normal = _nodal_normals(slave)[self.candidates]
        S, Q = sp.csr_matrix((m, len(xs))), sp.csr_matrix((m, len(xm)))
        if apart <= sight.max():
            # overlaps of the facets as they lie now, gathered to the multipliers' functions
            pair, own, other = overlap(slave, master, self.basis.degree, sight)
            k = own.shape[1]
            if len(pair):
                rows = pair[:, :1] * k + np.arange(k)
                basis = self.functions  # facet-wise coefficients do not depend on the shape
                D = basis @ scatter(own, rows, slave.nodes[pair[:, 0]], (len(slave.nodes) * k, len(xs)))
                M = basis @ scatter(other, rows, master.nodes[pair[:, 1]], (len(slave.nodes) * k, len(xm)))

                w = np.asarray(M.sum(axis=1)).ravel()
                on = w > COVERED * self.weight
                inverse = sp.diags(np.where(on, 1.0 / np.where(on, w, 1.0), 0.0))
                S, Q = (inverse @ D).tocsr(), (inverse @ M).tocsr()

        overlap_now = (-normal * (S @ xs - Q @ xm)).sum(1)
        offset = np.where(on & keep, np.minimum(overlap_now, 0.0), 0.0)
        entries = _entries(S, self.order[0]), _entries(-Q, self.order[1])
        self.pairing = Pairing(S, Q, -normal, on, offset, entries)

    def _ready(self, contacts: ContactSet, system: Any, q: Array) -> Pairing:
        if self.pairing is None:
            self.update(contacts, system, q, 0.0)
        assert self.pairing is not None
        return self.pairing

    # -- rows ------------------------------------------------------------------------------------------------
    def touch(self, contacts: ContactSet, system: Any, at: tuple[float, Array], here: Here) -> Touch:
        """Gaps of this pair; collective."""
        pairing = self._ready(contacts, system, at[1])
        on_slave, on_master = self.order
        xs = here.nodes(self.slave.trace)[0][on_slave]
        xm = here.nodes(self.master.trace)[0][on_master]

        between = pairing.slave @ xs - pairing.master @ xm
        along = (pairing.normal * between).sum(1)
        gap = np.where(pairing.on, along, np.inf)  # inf: nothing opposite
        return Touch(gap - pairing.offset, xs[self.candidates], pairing.normal, between, gap)

    def rows(self, contacts: ContactSet, system: Any, at: tuple[float, Array, Any], here: Here) -> Rows:
        """Candidates of this pair; collective."""
        p = self._ready(contacts, system, at[1])
        touch = self.touch(contacts, system, at[:2], here)
        S, Q = p.entries

        def linear(direction: Array) -> LinearRows:
            made = contacts.blank(self.count)
            for side, W in ((self.slave, S), (self.master, Q)):
                contacts.add_nodes(made, side.trace, (W, direction), here.nodes(side.trace)[1:])
            return LinearRows(made[0], tuple(made[1]))

        directions = tangents_of(touch.normal) if contacts.frictional else []
        one = np.ones(self.count)
        return Rows(
            gap=touch.gap,
            N=linear(touch.normal),
            tangents=tuple(linear(e) for e in directions),
            friction=self.friction * one,
            restitution=0.0 * one,
            normal=touch.normal,
            drift=np.zeros((self.count, len(directions))),
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
    e = moved.corners[:, 1:] - moved.corners[:, :1]
    n = np.stack((e[:, 0, 1], -e[:, 0, 0]), axis=1) if x.shape[1] == 2 else np.cross(e[:, 0], e[:, 1])
    n = n / np.linalg.norm(n, axis=1)[:, None]

    before = facets.corners[:, 1:] - facets.corners[:, :1]
    m = (
        np.stack((before[:, 0, 1], -before[:, 0, 0]), axis=1)
        if x.shape[1] == 2
        else np.cross(before[:, 0], before[:, 1])
    )
    n *= np.sign((m * facets.normals).sum(1))[:, None]  # the side that was outward at rest
    return replace(facets, points=x, normals=n)


def _nodal_normals(facets: Facets) -> Array:
    """Mean outward normals at the nodes, (n, d)."""
    out = np.zeros_like(facets.points)
    weighted = np.repeat((facets.sizes[:, None] * facets.normals)[:, None], facets.nodes.shape[1], axis=1)
    np.add.at(out, facets.nodes, weighted)
    return np.asarray(out / np.linalg.norm(out, axis=1)[:, None])


def _entries(W: Any, columns: np.ndarray) -> Entries:
    """Of a sparse matrix by rows, its columns at other places."""
    return np.repeat(np.arange(W.shape[0]), np.diff(W.indptr)), columns[W.indices], W.data
