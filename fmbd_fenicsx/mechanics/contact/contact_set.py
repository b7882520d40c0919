"""All contacts of a system, looked at together: rows and gaps of their candidates, and products with these rows."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np

from ...rotations import Array, Motions
from .nodal_rows import NodalRows
from .obstacles import Way
from .rows import LinearRows, Rows, Touch, stacked
from .trace import ContactTrace, FieldTrace, ModalTrace

Entries = tuple[np.ndarray, np.ndarray, Array | None]
"""Of a sparse matrix: rows, columns and values (None: one)."""

Nodes = tuple[Array, Array, Array | None]
"""World positions (n, d) of nodes, positions in the axes of their body, and its rotation (None: these are the world's)."""


NEAREST = 1e-6  # of the model's length: points with smaller gaps are near at any rate
SIGHT = 1e-2  # the same: how far surfaces look for each other in a state that is no start of a step


class Here:
    """One configuration, looked at once for all pairs."""

    def __init__(self, contacts: ContactSet, system: Any, t: float, q: Array) -> None:
        self.contacts, self.system, self.t, self.q = contacts, system, t, q
        self.poses: Array = system.poses(q)
        self._nodes: dict[int, Nodes] = {}

    def nodes(self, trace: int) -> Nodes:
        """Where the nodes of a trace are; collective."""
        found = self._nodes.get(trace)
        if found is None:
            tr = self.contacts.traces[trace]
            P = tr.X + tr.gather(self.system.local_q(self.q, tr.part))
            found = P, P, None
            if tr.moving:
                pose, m = self.poses[tr.frame], self.contacts.m
                R = m.matrix(pose)
                found = pose[: m.dim] + P @ R.T, P, R
            self._nodes[trace] = found
        return found

    @cached_property
    def evaluation(self) -> Any:
        """The system there; collective."""
        return self.system.at(self.t, self.q)


class ContactSet:
    """All contacts of a system; evaluates :class:`Rows`. Attributes: ``pairs``, ``traces``, ``frictional``,
    ``names``, ``amplitudes``: where the modes of each reduced part stand in the core.
    """

    def __init__(
        self,
        motions: Motions,
        pairs: tuple[Any, ...],
        traces: tuple[ContactTrace, ...],
        amplitudes: dict[int, slice],
        n_core: int,
    ) -> None:
        self.m, self.pairs, self.traces = motions, pairs, traces
        self.amplitudes, self.n_core = amplitudes, n_core
        self.on_fields = {i: tr for i, tr in enumerate(traces) if isinstance(tr, FieldTrace)}
        self.frictional = any(p.friction > 0 for p in pairs)
        self.names = tuple(p.name for p in pairs)
        self.groups = [
            g for join, some in groupby(pairs, lambda p: p.together) for g in join(list(some), motions, traces)
        ]
        self._chosen = np.array([np.nan if p.search is None else p.search for p in pairs])
        self._touched: tuple[float, Array, Touch] | None = None  # where :meth:`touch` looked last

    # -- kinematics ------------------------------------------------------------------------------------------
    def rows(self, system: Any, t: float, q: Array, *, way: Way | None = None, near: np.ndarray | None = None) -> Rows:
        """Candidates at (t, q), all or those that are ``near``, (m,) bool; ``way``: for the tangential drift of obstacles.

        Collective.
        """
        here = Here(self, system, t, q)
        if near is None or np.logical_and.reduce(near):
            return stacked([g.rows(here, way) for g in self.groups])
        chosen = [near[span] for span in self._spans]
        return stacked([g.some(some).rows(here, way) for g, some in zip(self.groups, chosen, strict=True)])

    def touch(self, system: Any, t: float, q: Array) -> Touch:
        """Gaps, points and normals of all candidates at (t, q), without derivatives; collective. The end of a step is where the
        next one begins: who asks again with the same array gets the same answer.
        """
        known = self._touched
        if known is None or known[0] != t or known[1] is not q:
            self._touched = known = t, q, self._looked_at(system, t, q)
        return known[2]

    def _looked_at(self, system: Any, t: float, q: Array) -> Touch:
        """The same, found anew."""
        here = Here(self, system, t, q)
        parts = [g.touch(here) for g in self.groups]
        if len(parts) == 1:
            return parts[0]
        return Touch(
            gap=np.concatenate([p.gap for p in parts]),
            x=np.concatenate([p.x for p in parts]),
            normal=np.concatenate([p.normal for p in parts]),
            relative=np.concatenate([p.relative for p in parts]),
            true_gap=np.concatenate([p.geometric for p in parts]),
        )

    @cached_property
    def _spans(self) -> list[slice]:
        """Candidates of the groups."""
        ends = np.cumsum([g.count for g in self.groups])
        return [slice(end - g.count, end) for g, end in zip(self.groups, ends, strict=True)]

    @cached_property
    def thin(self) -> bool:
        """Whether points could pass through an obstacle."""
        return bool(np.isfinite(self.thickness).any())

    @cached_property
    def thickness(self) -> Array:
        """Shortest way through the master of each candidate, m, (m,)."""
        return np.array([p.thickness for p in self.pairs])[self.pair]

    def pressures(self, force: Array) -> Array:
        """Pressures of normal forces on all candidates, (.., m)."""
        out = force.copy()
        for p, at in self._on_surfaces:
            out[..., at] = p.pressures(force[..., at])
        return out

    @cached_property
    def _on_surfaces(self) -> list[tuple[Any, slice]]:
        """Pairs whose forces are spread over surfaces, and their candidates."""
        ends = np.cumsum([p.count for p in self.pairs])
        pairs = zip(self.pairs, ends, strict=True)
        return [(p, slice(end - p.count, end)) for p, end in pairs if p.slave.surface is not None]

    @cached_property
    def pair(self) -> np.ndarray:
        """Number of the pair of each candidate, (m,)."""
        return np.repeat(np.arange(len(self.pairs)), [p.count for p in self.pairs])

    def search(self, now: Array, then: Array, length: float) -> Array:
        """Search distances (m,) from the gaps now and one step ahead: twice the approach, or the pair's own
        choice.
        """
        # gaps of points with nothing opposite are infinite
        both = np.isfinite(now) & np.isfinite(then)
        approach = np.zeros(len(self.pairs))
        np.maximum.at(approach, self.pair[both], np.abs(then[both] - now[both]))
        return np.where(np.isnan(self._chosen), np.maximum(2.0 * approach, NEAREST * length), self._chosen)[self.pair]

    def fastest(self, system: Any, v: Array) -> float:
        """A bound of the speed of any contact node, m/s; collective."""
        speed = 0.0
        twist = system.twists(v)
        for tr in self.traces:
            # a bound: translation, rotation over the body's size, deformation
            body = np.abs(twist[tr.frame, : self.m.dim]).sum() + np.abs(twist[tr.frame, self.m.dim :]).sum() * tr.size
            speed = max(
                speed, float(np.linalg.norm(tr.gather(system.local_v(v, tr.part)), axis=1).max() + tr.moving * body)
            )
        return 2.0 * speed

    @cached_property
    def searching(self) -> list[Any]:
        """Pairs whose gaps :meth:`update` changes."""
        return [p for p in self.pairs if p.searches]

    def update(self, system: Any, q: Array, reach: float, *, begun: Array | None = None) -> None:
        """Pair two-body contacts anew as they lie at q; overlaps where a step has ``begun`` stay. Collective."""
        if not self.searching:
            return
        self._touched, here = None, Here(self, system, np.nan, q)
        start = None if begun is None else Here(self, system, np.nan, begun)
        for p in self.searching:
            p.update(here, reach, begun=start)

    def gaps_in(self, system: Any, states: Sequence[Any]) -> Array:
        """Gaps (m) of all candidates in states within steps, (k, m), with surfaces paired as they lie there; collective."""
        found = []
        for s in states:
            self.update(system, s.q, SIGHT * system.length)
            found.append(self.touch(system, s.t, s.q).geometric)
        return np.array(found)

    def gap_rate(self, system: Any, t: float, q: Array, h: float) -> Array:
        """Part of the gaps' rates that comes from prescribed motion, m/s, (m,), by central differences;
        collective.
        """
        # of prescribed motions nobody knows the rate: differences within the step
        e = 1e-3 * h
        return self.gap_ways(system, (t, q), ((t - e, -1.0), (t + e, 1.0))) / (2 * e)

    def gap_ways(self, system: Any, at: tuple[float, Array], way: Way) -> Array:
        """What prescribed motion alone opens gaps by at (t, q) along a way, (m,), m; collective."""
        out: Array = np.zeros(len(self.pair))
        if not any(p.moving for p in self.pairs):
            return out
        here = Here(self, system, *at)
        for group, span in zip(self.groups, self._spans, strict=True):
            if getattr(group, "prescribed", ()):
                out[span] = group.gap_ways(here, way)
        return out

    # -- products --------------------------------------------------------------------------------------------
    def times(self, system: Any, rows: LinearRows, v: Array) -> Array:
        """N v, (m,); collective."""
        out = rows.core @ v[: self.n_core]
        for i, tr in self.on_fields.items():
            out = out + rows.field[i].times(tr.gather(system.local_v(v, tr.part)))
        return np.asarray(out)

    def transposed(self, system: Any, rows: LinearRows, force: Array) -> Array:
        """N^T Lambda, like v."""
        out = np.zeros(system.n_v)
        out[: self.n_core] = rows.core.T @ force
        for i, tr in self.on_fields.items():
            tr.spread(rows.field[i].transposed(force, tr.n), system.local_v(out, tr.part))
        return out

    # -- building blocks of rows -----------------------------------------------------------------------------
    def blank(self, m: int) -> tuple[Array, list[NodalRows]]:
        """Empty rows on the core, and on nodes."""
        return np.zeros((m, self.n_core)), [NodalRows.none(m, self.m.dim) for _ in self.traces]

    def add_nodes(
        self, linear: tuple[Array, list[NodalRows]], trace: int, entries: tuple[Entries, Array], at: Nodes
    ) -> None:
        """Add rows sum_k W_jk n_j . x_k' of a trace: entries of W, n (m, d)."""
        (core, field), ((row, node, weight), direction), (_, P, R) = linear, entries, at
        tr = self.traces[trace]
        # of each node: components in world and in body axes
        world = direction[row] if weight is None else direction[row] * weight[:, None]
        local = world if R is None else world @ R
        nodal = NodalRows(len(core), row, node, local)

        if isinstance(tr, ModalTrace):
            core[:, self.amplitudes[tr.part]] += nodal.columns(tr.modes)
        else:
            field[trace] = field[trace] + nodal if len(field[trace].row) else nodal
        # what the frame of the body does to its nodes
        n_twist = self.m.n_twist
        if tr.frame * n_twist < self.n_core and tr.frame >= 0 and tr.moving:
            at_frame = slice(tr.frame * n_twist, (tr.frame + 1) * n_twist)
            block = np.concatenate((world, self.m.moment(P[node], local)), axis=1)
            np.add.at(core[:, at_frame], row, block)

    def add_frames(
        self, core: Array, rows: np.ndarray, frames: np.ndarray, geometry: tuple[Array, Array, Array, Array]
    ) -> None:
        """Add n . x' of points x on moving ``frames`` (k,) to ``rows`` (k,): geometry = (n, x, r (k, d), R (k, d, d))."""
        n, x, r, R = geometry
        arm, direction = ((y[:, None, :] @ R)[:, 0] for y in (x - r, n))
        block = np.concatenate((n, self.m.moment(arm, direction)), axis=1)

        columns = frames[:, None] * self.m.n_twist + np.arange(self.m.n_twist)
        core[rows[:, None], columns] += block
