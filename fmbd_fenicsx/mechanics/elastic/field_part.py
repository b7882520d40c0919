"""What all displacement fields have in common as parts of a system: ports, and how they act on the nodes.

The ports of a field are its frame conditions (n_frame_rows numbers C^T U, zero by constraint; none for absolute bodies)
followed by the moments b_0, b_k of each surface in use. They are linear in the nodal displacements.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...fem.fields import Field
from ...rotations import Array, motions
from ..frames import polar_rotation
from ..placements import DistributedPart, FrameMotion

LEAST = 1e-6  # rad: surfaces that turn by less turn by roundoff


@dataclass(frozen=True)
class TangentPoint:
    """Where the tangent of a part was taken: time (s), nodal displacements and rates (n d,), loads, the pressure where it was not
    that of the displacements, the increment of Newton that led there.
    """

    t: float
    U: Array
    Ud: Array
    load: Any
    pressure: Array | None
    increment: Array | None = None


class FieldPart(DistributedPart):
    """A displacement field as a part of a system; local coordinates are the owned nodal displacements, (n d,).

    ``inertia_columns`` (n d, k): constant columns that couple the field's inertia to the twist of its frame (k = n_twist, or 0
    where there is no moving frame). ``shared_columns``: the frame conditions have these same columns.
    """

    distributed = True
    port_matrix = np.zeros((0, 0))
    _tangent_at: TangentPoint | None = None  # where the last own tangent was taken

    def __init__(self, field: Field, frame: int, surfaces: list[str], conditions: Array) -> None:
        self.field, self.frame, self.name, self.comm = field, frame, field.name, field.comm
        self.motions, self.numbers = motions(field.dim), field.numbers
        self.n = field.n * field.dim
        self.surfaces = [field.moments(s) for s in surfaces]
        self.conditions = conditions
        self.mass_total, self.size = field.mass_total, field.size
        self.of_time = bool(field.loads.loads)
        self.n_frame_rows = conditions.shape[1]
        self.inertia_columns: Array = np.zeros((self.n, 0))
        self.n_port = self.n_frame_rows + field.dim * (1 + field.dim) * len(self.surfaces)
        self.reference = np.concatenate([np.zeros(self.n_frame_rows), *(s.reference.ravel() for s in self.surfaces)])
        self.origin = field.center  # of the frame, world axes at the start
        self.traces: list[Any] = []

    def add_trace(self, B: Any, surface: str) -> slice:
        """Further ports B u of a tie of a surface by field multipliers, B (rows, n d) sparse; returns their place there.
        Collective.
        """
        first = self.n_port
        self.traces.append(B)
        self.__dict__.pop("_port_rows", None)  # one more than those that were asked for
        self.n_port += B.shape[0]
        self.reference = np.concatenate((self.reference, np.zeros(B.shape[0])))
        return slice(first, self.n_port)

    def surface_center(self, surface: str) -> Array:
        """Centroid of a surface at the start, world axes."""
        return self.field.moments(surface).center

    @property
    def held(self) -> list[Array]:
        """Nodes of the surfaces in use, and of those with traces."""
        return [s.nodes for s in self.surfaces] + [np.unique(B.indices // self.field.dim) for B in self.traces]

    def work_of_turns(self, u: Array) -> float:
        """What elastic forces on the surfaces in use do where these move by (R + R^T) / 2 - 1, the part of their mean rotations R
        that a linear form takes for a strain, over the elastic energy, at displacements u (n d,); collective.
        """
        f, d, work = self.field, self.field.dim, 0.0
        U = u.reshape(-1, d)
        forces = f.stiffness_at_rest(u).reshape(-1, d)
        energy = 0.5 * float(f.total(np.array([u @ forces.ravel()]))[0])
        for on in self.held:
            count, *center = f.total(np.array([len(on), *f.X[on].sum(axis=0)]))
            X = f.X[on] - np.array(center) / count
            led, pushed = f.total(np.stack([(X + U[on]).T @ X, forces[on].T @ X]))
            if led.any():
                R = polar_rotation(led[None])[0]
                stretch = 0.5 * (R + R.T) - np.eye(d)
                work += abs(float((stretch * pushed).sum())) if np.linalg.norm(R - R.T) > LEAST else 0.0
        return work / energy if work else 0.0

    # -- ports --------------------------------------------------------------------------------------------------
    def ports_of(self, w: Array, t: float) -> Array:
        """Port values of a nodal vector without its reference part, (n d,) -> (n_port,); collective."""
        return self.field.total(self.port_shares(w, t))

    def port_shares(self, w: Array, t: float) -> Array:
        """What this rank's nodes have in :meth:`ports_of`."""
        d = self.field.dim
        W = w.reshape(-1, d)
        parts = [self.conditions.T @ w] + [(s.weights.T @ W[s.nodes]).ravel() for s in self.surfaces]
        parts += [B @ w for B in self.traces]
        return np.concatenate(parts)

    def port_force(self, f: Array, t: float) -> Array:
        """Nodal forces of port forces, the transpose of :meth:`ports_of`; (n_port,) -> (n d,)."""
        d, k = self.field.dim, self.n_frame_rows
        out = (self.conditions @ f[:k]).reshape(-1, d)
        for s in self.surfaces:
            block = f[k : k + d * (1 + d)].reshape(1 + d, d)
            out[s.nodes] += s.weights @ block
            k += d * (1 + d)
        flat = out.ravel()
        for B in self.traces:
            flat += B.T @ f[k : k + B.shape[0]]
            k += B.shape[0]
        return flat

    def port_columns(self, used: np.ndarray, t: float) -> Array:
        """Dense columns (n d, count) of :meth:`port_force` for the port numbers ``used``."""
        return np.asarray(self._port_rows[used].toarray().T)

    def port_gram(self, t: float) -> Array:
        """P P^T of the ports p = P w, (n_port, n_port): ports of neighbouring surfaces share nodes; collective."""
        P = self._port_rows
        return self.field.total((P @ P.T).toarray())

    @cached_property
    def _port_rows(self) -> Any:
        """P of the ports p = P w on this rank's displacements, sparse (n_port, n)."""
        import scipy.sparse as sp

        # rows by rows: written out, as products of sparse matrices take longer than all else that needs them
        d, (n, k) = self.field.dim, self.conditions.shape
        columns, values = [np.tile(np.arange(n), k)], [self.conditions.T.ravel()]
        counts = [np.full(k, n)]
        for s in self.surfaces:
            on_nodes, components = len(s.nodes), s.nodes * d + np.arange(d)[:, None]
            columns.append(np.tile(components.ravel(), 1 + d))
            values.append(np.repeat(s.weights.T, d, axis=0).ravel())
            counts.append(np.full((1 + d) * d, on_nodes))

        ends = np.concatenate(([0], np.cumsum(np.concatenate(counts))))
        shape = len(ends) - 1, self.n
        P = sp.csr_matrix((np.concatenate(values), np.concatenate(columns), ends), shape=shape)
        return sp.vstack([P, *self.traces], format="csr") if self.traces else P

    # -- tangent ------------------------------------------------------------------------------------------------
    def remember(self, m: Any) -> None:
        """Take the tangent again where it was taken last, or that of the start where none was taken since
        (see :mod:`fmbd_fenicsx.system.serialisation`); collective.
        """
        at = self._tangent_at
        if not m("own tangent", at is not None):
            if m.reading and at is not None:
                self._tangent_at = None
                self._first_tangent()
            return

        t, load = m("time", at and at.t), m("load", at and at.load)
        order = self.field.numbering
        U = m.nodal("displacement", at and at.U, order)
        Ud = m.nodal("rate", at and at.Ud, order)
        pressure = None
        if m("with a pressure", at is not None and at.pressure is not None):
            numbering = self.field.pressure_numbering  # type: ignore[attr-defined]
            pressure = m.nodal("pressure", at and at.pressure, numbering)
        increment = None
        if m("foretold", at is not None and at.increment is not None):
            increment = m.nodal("increment", at and at.increment, order)
        if m.reading:
            self._take_tangent(TangentPoint(t, U, Ud, load, pressure, increment))

    def _take_tangent(self, at: TangentPoint) -> None:
        """The tangent of a configuration, with what else it depends on, which is kept for checkpoints; collective."""
        raise NotImplementedError

    def _first_tangent(self) -> None:
        """The tangent that the part had when it was made; collective."""
        raise NotImplementedError

    @property
    def tangent_version(self) -> int:
        """Number of tangents taken so far."""
        return self.field.tangents

    @property
    def damped(self) -> bool:
        """Whether the body has material damping."""
        forms = self.field.forms

        return bool(forms.mass_damping or forms.stiffness_damping or self.field.D is not None)

    def summed(self, found: dict[str, float]) -> dict[str, float]:
        """Powers of this rank's nodes, summed over ranks; collective."""
        if not found:
            return {}
        total = self.field.total(np.array(list(found.values())))

        return dict(zip(found, (float(x) for x in total), strict=True))

    # -- the core's share ---------------------------------------------------------------------------------------
    def mass_blocks(self, motion: FrameMotion, u: Array) -> tuple[Array, Array, Array]:
        """Mass block of the frame (zero without one); the field's own blocks stay with its factor."""
        n = self.motions.n_twist
        return np.zeros((n, n)), np.zeros((0, n)), np.zeros((0, 0))

    def stiffness_blocks(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """None in the core."""
        return np.zeros((0, 0)), np.zeros((0, 0))
