"""Two surfaces of facets as compiled code reads them (``driver/contact/facets.c``), and which facets may see each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from ....fem.traces.mortar import diameters, neighbours
from ....fem.traces.traces import Trace, across, lagrange, quadrature
from ....mechanics.contact.mortar import MortarPair
from ....system.compiled.declarations import enumeration
from .structures import MEETING

Keep = Callable[..., int]  # the address of an array that is kept under a name
MOST = enumeration("FUNCTIONS", "contact/facets.c")["FUNCTIONS"]


def monomials(dim: int, degree: int, halved: bool) -> np.ndarray:
    """Powers (k, dim) of the polynomials on a facet: of a degree as a whole, or in each coordinate on quadrilaterals."""
    powers = np.array(list(product(range(degree + 1), repeat=dim)), dtype=np.int32)
    return powers if halved else powers[powers.sum(1) <= degree]


def _shapes(one: Any, keep: Keep, name: str, of: tuple[int, int, bool]) -> None:
    """Lagrange functions on facets of a dimension and a degree, those of quadrilaterals on halves of these."""
    powers, nodes = monomials(*of), np.asarray(lagrange(*of).points)
    values = (nodes[None] ** powers[:, None]).prod(2)
    one.count = one.terms = len(powers)
    one.power, one.share = keep(f"{name} power", powers, np.int32), keep(f"{name} share", np.linalg.inv(values))


class FacingSurfaces:
    """One pair of surfaces: ``c``, the structure, made with ``keep``; ``number``: of the pair among others of its kind.

    ``at``: numbers of the pairs of candidates, of the slave's and of the master's points.
    """

    def __init__(self, pair: MortarPair, number: int, at: tuple[int, int, int], keep: Keep) -> None:
        self.pair, self.number, self.keep = pair, number, keep
        basis, facets, m = pair.basis, pair.facets, pair.facets[0].dim - 1
        q, w = quadrature(m, basis.degree + max(f.order for f in facets))
        held = np.abs(pair.shares).max(axis=2).ravel() > 0.0
        holder = np.flatnonzero(held)
        order = np.argsort(pair.multipliers.ravel()[holder], kind="stable")
        counts = np.bincount(pair.multipliers.ravel()[holder], minlength=pair.count)
        self.surfaces = [side.surface for side in (pair.slave, pair.master)]

        o = self.c = MEETING(pair=at[0], multipliers=pair.multipliers.shape[1], points=len(q))
        o.search = np.nan if pair.search is None else pair.search
        o.skin = float(diameters(facets[0]).mean())
        for side in range(2):
            self._facets(o.side[side], side, at[1 + side])
        _shapes(o.psi, keep, self._named("psi"), (m, basis.degree, False))

        for name, values, kind in (
            ("held", np.cumsum([0, *counts]), np.int32), ("holder", holder[order], np.int32),
            ("at", self._local(0, pair.trace_nodes), np.int32),
            ("coefficient", pair.shares, float), ("weight", pair.weight, float), ("place", q, float), ("part", w, float),
            ("sight", np.zeros(len(facets[0].nodes)), float), ("saw", np.zeros(len(facets[0].nodes)), float),
            ("begin", np.zeros(len(facets[0].nodes) + 1), np.int32), ("normal", np.zeros((pair.count, m + 1)), float),
            ("sum", np.zeros((m + 1) * max(f.n for f in facets)), float),
            ("touched", np.zeros(max(f.n for f in facets)), np.int32),
            ("mark", np.full(max(f.n for f in facets), -1), np.int32),
        ):  # fmt: skip
            setattr(o, name, keep(self._named(name), values, kind))

    def _named(self, name: str) -> str:
        return f"meeting {self.number} {name}"

    def _local(self, side: int, nodes: np.ndarray) -> np.ndarray:
        """Numbers of nodes of a trace among the points of a side."""
        surface = self.surfaces[side]
        assert surface is not None
        return np.searchsorted(surface.nodes, nodes)

    def _facets(self, one: Any, side: int, pair: int) -> None:
        """The facets of a side, as they lie at rest."""
        f: Trace = self.pair.facets[side]
        d, (n, k) = f.dim, f.nodes.shape
        one.pair, one.facets, one.nodes = pair, n, k
        outward = np.sign((across(f.corners) * f.normals).sum(1))
        for name, values, kind in (
            ("node", self._local(side, self.pair.order[side])[f.nodes], np.int32), ("outward", outward, float),
            ("normal", np.zeros((n, d)), float), ("size", np.zeros(n), float), ("stood", np.zeros((f.n, d)), float),
        ):  # fmt: skip
            setattr(one, name, self.keep(self._named(f"{name} {side}"), values, kind))
        if f.skew is not None and f.skew.any():
            one.skew = self.keep(self._named(f"skew {side}"), f.skew)
        _shapes(one.shapes, self.keep, self._named(f"shapes {side}"), (d - 1, f.degree, f.halved))

    def list_facets(self, arrays: dict[str, np.ndarray], means: tuple[Any, Any]) -> None:
        """Which may see each other until nodes have moved, where ``arrays`` tell that they stand; room for their integrals and
        for both ``means``.
        """
        o, told = self.c, lambda name: arrays[self._named(name)]
        there = []
        for side, f in enumerate(self.pair.facets):
            points = told(f"stood {side}")[self._local(side, self.pair.order[side])]
            there.append(replace(f, points=points))
        found = neighbours(there[0], there[1], told("saw") + o.skin)
        found = found[np.lexsort(found.T[::-1])]

        told("begin")[:] = np.searchsorted(found[:, 0], np.arange(len(there[0].nodes) + 1))
        many, both = len(found) * o.multipliers, [f.nodes.shape[1] for f in there]
        o.other = self.keep(self._named("other"), found[:, 1], np.int32)
        o.used = self.keep(self._named("used"), np.zeros(len(found)), np.int32)
        o.block = self.keep(self._named("block"), np.zeros(many * sum(both)))
        for side, (one, size) in enumerate(zip(means, both, strict=True)):
            one.node = self.keep(self._named(f"entries {side}"), np.zeros(many * size), np.int32)
            one.weight = self.keep(self._named(f"weights {side}"), np.zeros(many * size))


def is_known(pair: MortarPair) -> bool:
    """Whether compiled code has room for the functions on its facets."""
    return all(f.nodes.shape[1] <= MOST for f in pair.facets)
