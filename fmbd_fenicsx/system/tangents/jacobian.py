"""The constraint Jacobian of a configuration, and the tangent of applied forces: assembly into fixed patterns."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ...matrices import summed
from ...rotations import Array
from ..layout import Layout

if TYPE_CHECKING:
    from ..evaluation import Evaluation

DENSE_LIMIT = 80_000  # entries of the core's saddle point up to which it is kept dense
CORE_LIMIT = 150  # velocities of the core up to which a system with rods is kept dense
PORT_LIMIT = 4_000_000  # the same for its part on the ports of elastic fields: ties of many multipliers make it sparse


def dense_core(system: Layout) -> bool:
    """Whether masses and G of a system are kept dense on the core."""
    few = not system.elements or bool(system.fields) or system.n_core <= CORE_LIMIT
    return few and (system.n_core + system.n_lam) ** 2 <= DENSE_LIMIT


class CorePattern:
    """Where the entries of G's core part go: found at the first assembly, the same ever after."""

    def __init__(self, system: Layout, rows: np.ndarray, markers: np.ndarray) -> None:
        m, n = system.markers, system.motions.n_twist
        self.rows, self.markers = rows, markers
        self.shape = (system.n_lam, system.n_core)
        self.dense = dense_core(system)

        # entries on moving frames, and their places in G
        frame = m.frame[markers]
        self.keep = np.flatnonzero(frame < system.n_frames)
        columns = (frame[self.keep, None] * n + np.arange(n)).ravel()
        place = np.repeat(rows[self.keep], n) * self.shape[1] + columns
        if self.dense:
            self.slot = place
        else:
            self._compress(place)

        # sides on surfaces of elastic bodies
        surface = np.full(len(m.frame), -1)
        surface[m.surface] = np.arange(len(m.surface))
        self.on = np.flatnonzero(surface[markers] >= 0)
        self.surface = surface[markers[self.on]]

    def _compress(self, place: np.ndarray) -> None:
        """The pattern of a sparse matrix from the places of all entries."""
        unique, self.slot = np.unique(place, return_inverse=True)
        self.indices = (unique % self.shape[1]).astype(np.int32)
        counts = np.bincount(unique // self.shape[1], minlength=self.shape[0])
        self.indptr = np.concatenate(([0], np.cumsum(counts))).astype(np.int32)

    def core(self, entries: Array) -> Any:
        """G's core part from the entries of all sides, (count, n_twist)."""
        data = entries[self.keep].ravel()
        if self.dense:
            return (
                np.bincount(self.slot, data, self.shape[0] * self.shape[1])
                .astype(float, copy=False)
                .reshape(self.shape)
            )
        values = np.bincount(self.slot, data, len(self.indices)).astype(float, copy=False)
        return sp.csr_matrix((values, self.indices, self.indptr), shape=self.shape)


class Jacobian:
    """G in two pieces: ``core`` (n_lam, n_core) and ``port`` (n_lam, n_port) on the ports of the parts, dense or sparse each.

    Ports of replicated parts are folded into ``core``; products take both pieces into account.
    """

    def __init__(self, ev: Evaluation) -> None:
        s = self.system = ev.system
        self.t, self.bent = ev.t, ev.bent
        pattern, side = self._sides(ev)
        self._on_frames = pattern, (side[:, None, :] @ ev.kin.jac_frame[pattern.markers])[:, 0]
        self._tied: list[tuple[Any, int, int]] = []  # blocks on frames of ties

        large, shape = s.n_lam * s.n_port > PORT_LIMIT, (s.n_lam, s.n_port)
        self.port: Any = sp.csr_matrix(shape) if large else np.zeros(shape)
        if not s.parts:
            return

        if pattern.on.size:
            self._add_surfaces(ev, pattern, side)
        self.port = summed(self.port, self._own_ports(ev))
        for tie, span in s.traces:
            self._add_tie(tie, span, ev)

    @cached_property
    def core(self) -> Any:
        """The first piece, which is made for those who look at it."""
        pattern, entries = self._on_frames
        return self._folded(summed(pattern.core(entries), self._tied))

    def _own_ports(self, ev: Evaluation) -> Iterator[tuple[Any, int, int]]:
        """Blocks of laws on ports, and of conditions of frames, which are ports by themselves: with their first row and port."""
        s = self.system
        for laws, span in s.port_constraints:
            ports = s.port_slice(laws.part)
            yield laws.jacobian(ev.port[ports], ev.t), span.start, ports.start
        for k, rows in enumerate(s.frame_rows):
            yield np.eye(s.parts[k].n_frame_rows), rows.start, s.port_slice(k).start

    @staticmethod
    def _sides(ev: Evaluation) -> tuple[CorePattern, Array]:
        """The rows of all batches by marker, (count, d + n_rot), and where they go."""
        s = ev.system
        numbers, markers = [np.zeros(0, int)], [np.zeros(0, int)]
        sides: list[Array] = [np.zeros((0, ev.kin.jac_frame.shape[1]))]
        for (_, rows), of_batch in zip(s.batches, ev.sides, strict=True):
            for number, marker, side in of_batch:
                numbers.append(rows[number])
                markers.append(marker)
                sides.append(side)
        # where entries go is the same in all configurations
        if "pattern" not in s.cache:
            s.cache["pattern"] = CorePattern(s, np.concatenate(numbers), np.concatenate(markers))
        return s.cache["pattern"], np.concatenate(sides)

    def _add_surfaces(self, ev: Evaluation, pattern: CorePattern, side: Array) -> None:
        """Rows of markers on surfaces, on the ports of these."""
        at = pattern.rows[pattern.on]
        k = pattern.surface
        ports = self.system.markers.port[k]
        entries = (side[pattern.on, None, :] @ ev.kin.jac_port[k])[:, 0]
        if isinstance(self.port, np.ndarray):
            np.add.at(self.port, (at[:, None], ports), entries)
        else:
            index = (np.repeat(at, entries.shape[1]), ports.ravel())
            self.port = self.port + sp.csr_matrix((entries.ravel(), index), shape=self.port.shape)

    def active(self, span: slice) -> np.ndarray:
        """Which of some ports a row acts on, (ports,)."""
        return np.asarray(abs(self.port[:, span]).sum(axis=0)).ravel() > 0

    def _add_tie(self, tie: Any, rows: slice, ev: Evaluation) -> None:
        """Blocks of a tie by field multipliers."""
        s = self.system
        n = s.motions.n_twist
        for kind, number, block in tie.jacobian(ev):
            if kind == "port":
                # an elastic side: columns of its ports
                side = tie.sides[number]
                self.port = summed(self.port, [(block, rows.start, s.port_slice(side.part).start + side.ports.start)])
            else:
                # a rigid side: columns of its frame
                self._tied.append((block, rows.start, number * n))

    def _folded(self, core: Any) -> Any:
        """The core with ports of replicated parts."""
        s = self.system
        parts = [
            (
                p.port_matrix + self.bent[k].matrix if k in self.bent else p.port_matrix,
                s.port_slice(k),
                s.slices[1][k].start,
            )
            for k, p in s.core_parts
            if p.n_port
        ]
        if isinstance(core, np.ndarray):
            return summed(core, ((self.port[:, ports] @ matrix, 0, at) for matrix, ports, at in parts))
        if not parts:
            return core
        # of many bodies one product, as each row has few ports
        blocks = ((matrix, ports.start, at) for matrix, ports, at in parts)
        return core + sp.csr_matrix(self.port) @ summed(sp.csr_matrix((s.n_port, s.n_core)), blocks)

    @cached_property
    def columns(self) -> Any:
        """``core`` as it gives columns fast."""
        return sp.csc_matrix(self.core) if sp.issparse(self.core) else self.core

    def times(self, v: Array) -> Array:
        """G v, (n_lam,); collective."""
        s = self.system
        out = np.asarray(self.core @ v[: s.n_core])
        return sum(self.openings(v), out)

    def openings(self, v: Array) -> list[Array]:
        """What each field, which meets the constraints through its ports, gives to G v, (n_lam,); collective."""
        s = self.system
        local = [s.local_v(v, k) for k, _ in s.fields]
        found = []
        for (k, _), w, ports in zip(s.fields, local, s.field_ports(local, self.t), strict=True):
            rates = ports + self.bent[k].along(w) if k in self.bent else ports
            found.append(np.asarray(self.port[:, s.port_slice(k)] @ rates))
        return found

    def transposed(self, lam: Array) -> Array:
        """G^T lambda, like v."""
        s = self.system
        core = np.asarray(self.core.T @ lam)
        if not s.fields:
            return core
        # nodal forces of each field; foreshortening adds its own
        forces = [p.port_force(self.port[:, s.port_slice(k)].T @ lam, self.t) for k, p in s.fields]
        for i, (k, _) in enumerate(s.fields):
            if k in self.bent:
                forces[i] = forces[i] + self.bent[k].force(self.port[:, s.port_slice(k)].T @ lam)
        return np.concatenate((core, *forces))
