"""A system in one configuration (and velocity): all that the balance of forces and the constraints need, each computed once.

See :mod:`.system` for the equations.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from ..errors import BalanceError
from ..mechanics.elastic.foreshortening import Bent
from ..mechanics.forces.force_elements import Loads
from ..mechanics.frames import Kinematics
from ..mechanics.placements import Approach, FrameMotion
from ..rotations import Array
from .lengths import Measured
from .tangents.foreshortened_ports import bend, port_bias, port_forces, pulls
from .tangents.jacobian import Jacobian
from .tangents.reaction_tangent import NO_PUSH


class Evaluation:
    """Everything that (1) and (2) need at (t, q, v), each computed at most once. Methods are collective."""

    def __init__(self, system: Measured, t: float, q: Array, v: Array | None) -> None:
        self.system, self.t, self.q, self.v = system, t, q, v
        self.forces: tuple[Array, Array] = np.zeros(system.n_v), np.zeros(system.n_lam)  # a and lambda, for tangents
        self.foretold: dict[Any, Array] = {}  # efforts of springs for the tangent, see foretold_efforts
        self.reactions = NO_PUSH  # which are in the tangent of a step
        self._asked: dict[tuple[Loads, str], Any] = {}
        self._energies: dict[str, float] | None = None

    # -- frames, ports and markers ------------------------------------------------------------------------------------
    @cached_property
    def pose(self) -> Array:
        """Poses of all frames, the ground last, (n_frames + 1, n_pose)."""
        return self.system.poses(self.q)

    @cached_property
    def twist(self) -> Array:
        """Twists of all frames, the ground last, (n_frames + 1, n_twist)."""
        assert self.v is not None
        return self.system.twists(self.v)

    @cached_property
    def bent(self) -> dict[int, Bent]:
        """Ports of second order by part (:mod:`.tangents.foreshortened_ports`)."""
        return bend(self.system, self.q) if self.system.curved else {}

    @cached_property
    def port(self) -> Array:
        """Ports of all parts, (n_port,)."""
        out = self.system.ports(self.q, self.t)
        for k, bent in self.bent.items():
            out[self.system.port_slice(k)] += bent.values(self.system.local_q(self.q, k))
        return out

    @cached_property
    def port_rate(self) -> Array:
        """Their rates, (n_port,)."""
        assert self.v is not None
        out = self.system.ports(self.v, self.t, rates=True)
        for k, bent in self.bent.items():
            out[self.system.port_slice(k)] += bent.along(self.system.local_v(self.v, k))
        return out

    @cached_property
    def kin(self) -> Kinematics:
        """The markers: positions, rotations, Jacobians, and velocities where v is given."""
        return self.markers()

    def markers(self) -> Kinematics:
        """:attr:`kin`, found anew."""
        s = self.system
        rates = None if self.v is None else (self.twist, self.port_rate)
        kin = s.markers.evaluate(self.pose, self.rotation, self.port, rates)
        if s.counted is not None:
            kin.turned = s.counted.turned(self.pose, self.port, self.q[s.counted_angles])
        return kin

    @cached_property
    def rotation(self) -> Array:
        """Rotation matrices of the frames, (n_frames + 1, d, d)."""
        return self.system.motions.matrix(self.pose)

    # -- constraints ------------------------------------------------------------------------------------------------
    def constraint(self) -> Array:
        """g(q, t), (n_lam,)."""
        s = self.system
        g = np.zeros(s.n_lam)
        for batch, rows in s.batches:
            g[rows] = batch.values(self.kin, self.t)
        # equations of the user's own, on their ports
        for law, span in s.port_constraints:
            g[span] += law.values(self.port[s.port_slice(law.part)], self.t)
        for tie, span in s.traces:
            g[span] = tie.values(self)
        # conditions of frames: the first ports of a part are zero
        for k, span in enumerate(s.frame_rows):
            g[span] = self.port[s.port_slice(k)][: s.parts[k].n_frame_rows]
        return g

    @cached_property
    def jacobian(self) -> Jacobian:
        """G = dg/dv."""
        return Jacobian(self)

    @cached_property
    def sides(self) -> list[Any]:
        """The rows of each batch by marker, as :meth:`.Batch.sides`."""
        return [batch.sides(self.kin, self.t) for batch, _ in self.system.batches]

    def constraint_rate(self) -> Array:
        """g_t, the part of dg/dt that does not come from v, (n_lam,)."""
        g = np.zeros(self.system.n_lam)
        for batch, rows in self.system.batches:
            g[rows] = batch.rate(self.kin, self.t)
        for law, span in self.system.port_constraints:
            g[span] += law.rate(self.port[self.system.port_slice(law.part)], self.t)
        for tie, span in self.system.traces:
            g[span] = tie.rate(self)
        return g

    def opening(self) -> Array:
        """G v + g_t, the rates at which the constraints open, (n_lam,)."""
        assert self.v is not None
        return self.jacobian.times(self.v) + self.constraint_rate()

    def gamma(self) -> Array:
        """g'' - G a, (n_lam,)."""
        assert self.v is not None and self.kin.bias is not None
        g = np.zeros(self.system.n_lam)
        for k, (batch, rows) in enumerate(self.system.batches):
            # what the markers' own second rates at zero acceleration add
            value = batch.gamma(self.kin, self.t)
            for number, marker, side in self.sides[k]:
                value += np.bincount(number, (side * self.kin.bias[marker]).sum(1), len(rows))
            g[rows] = value
        for law, span in self.system.port_constraints:
            ports = self.system.port_slice(law.part)
            g[span] += law.gamma(self.port[ports], self.port_rate[ports], self.t)
        for tie, span in self.system.traces:
            g[span] = tie.gamma(self)
        return g + self.jacobian.port @ port_bias(self) if self.bent else g

    # -- balance ----------------------------------------------------------------------------------------------------
    def wrenches(self) -> Array:
        """Applied wrenches on all markers in world axes, (n_markers, d + n_rot)."""
        s = self.system
        out = np.zeros(self.kin.jac_frame.shape[:2])
        for loads in s.forces:
            for marker, wrench in zip(loads.markers, loads.wrenches(self.kin, self.t), strict=True):
                np.add.at(out, marker, wrench)
        return out

    def asked(self, loads: Loads, what: str) -> Any:
        """What a batch of elements tells of itself to all who record it: its "scalar" or its "wrenches"; asked once."""
        key = loads, what
        if key not in self._asked:
            self._asked[key] = getattr(loads, what)(self.kin, self.t)
        return self._asked[key]

    def spread(self, wrench: Array) -> Array:
        """Generalised forces of wrenches on the markers: the transpose of the marker Jacobians, like v."""
        return self.gather(*self.on_ports(wrench))

    def work(self, xi: Array) -> float:
        """Work of the applied forces along an increment xi, like v."""
        return float(self.system.dot(self.spread(self.wrenches()), xi))

    def on_ports(self, wrench: Array) -> tuple[Array, Array]:
        """Forces of wrenches on the frames, and on the ports (n_port,)."""
        s, markers = self.system, self.system.markers
        core = np.zeros((s.n_frames + 1, s.motions.n_twist))
        np.add.at(core, markers.frame, _transposed(self.kin.jac_frame, wrench))

        port = np.zeros(s.n_port)
        if markers.surface.size:
            np.add.at(port, markers.port, _transposed(self.kin.jac_port, wrench[markers.surface]))
        return core[:-1].ravel(), port

    def gather(self, core: Array, port: Array) -> Array:
        """An array like v from forces on the frames and on the ports."""
        s = self.system
        return np.concatenate((core, *port_forces(self, port))) if s.parts else core

    def balance(self, a: Array, lam: Array | None = None) -> Array:
        """M a + h + G^T lambda (lambda left out when None), like v; :attr:`forces` are these from now on."""
        s = self.system
        self.forces = a, np.zeros(s.n_lam) if lam is None else lam
        out = self._inertia_and_parts(a)
        if s.forces:
            out -= self.spread(self.wrenches())
        if lam is not None and s.n_lam:
            out += self.jacobian.transposed(lam)

        if not np.isfinite(out[: s.n_core]).all():
            raise BalanceError(
                f"The balance of forces is not finite at t = {self.t:g} s; check loads and initial values."
            )
        return out

    def _inertia_and_parts(self, a: Array) -> Array:
        """M a + h without force elements, like v: rigid bodies, rods, and what moves on frames."""
        s = self.system
        accel = s.twists(a)
        g = s.gravity(self.t)
        core = np.zeros_like(accel)  # on frames, the ground last
        if s.rigid is not None:
            core[s.rigid.frame] += s.rigid.force(self.twist, accel, g)
        for elements in s.elements:
            for frames, rows in elements.forces(self.t, self.pose, self.twist):
                np.add.at(core, frames, rows)

        local_rows = []
        for k, p in enumerate(s.parts):
            motion = FrameMotion(self.t, self.rotation[p.frame], self.twist[p.frame], accel[p.frame], g)
            on_frame, rows = p.force(motion, (*self.local(k), s.local_v(a, k)))
            core[p.frame] += on_frame
            local_rows.append(rows)
        return np.concatenate((core[:-1].ravel(), *local_rows)) if s.parts else core[:-1].ravel()

    def local(self, k: int) -> tuple[Array, Array]:
        """Local coordinates of part k and their rates, zero where no velocities are given."""
        s = self.system
        rates = np.zeros(s.parts[k].n) if self.v is None else s.local_v(self.v, k)
        return s.local_q(self.q, k), rates

    def strained(self, k: int) -> tuple[Array, Array, Array]:
        """:meth:`local` with the second rates of :attr:`forces`, for tangents."""
        return (*self.local(k), self.system.local_v(self.forces[0], k))

    def tangent_motions(self, *, strained: bool = True) -> list[FrameMotion]:
        """What tangents of the parts need of their frames: accelerations of :attr:`forces`, and where ``strained`` their pull."""
        s = self.system
        a, lam = self.forces
        twist = np.zeros_like(s.twists(a)) if self.v is None else self.twist
        accel, g, pull = s.twists(a), s.gravity(self.t), pulls(self, lam) if strained else {}
        return [
            FrameMotion(self.t, self.rotation[p.frame], twist[p.frame], accel[p.frame], g, pull.get(k))
            for k, p in enumerate(s.parts)
        ]

    def take_tangents(
        self, parts: Iterable[int] | None = None, increments: Mapping[int, Approach] = MappingProxyType({})
    ) -> bool:
        """New tangents of elastic fields (None: of all) at this state; False when all are constant.

        ``increments``: by part, that led there, where they are known.
        """
        motions = self.tangent_motions()
        fields = self.system.fields if parts is None else [(k, f) for k, f in self.system.fields if k in parts]
        changed = [f.relinearise(motions[k], self.strained(k), increments.get(k)) for k, f in fields]
        return any(changed)

    # -- invariants -------------------------------------------------------------------------------------------------
    def energies(self) -> dict[str, float]:
        """Energies in J: kinetic, elastic, weight, springs."""
        if self._energies is None:
            self._energies = self._found_energies()
        return self._energies

    def _found_energies(self) -> dict[str, float]:
        s = self.system
        assert self.v is not None
        g = s.gravity.lasting
        kinetic, elastic, weight = 0.0, 0.0, 0.0
        if s.rigid is not None:
            kinetic, weight = s.rigid.energies(self.pose, self.twist, g)
        for k, p in enumerate(s.parts):
            motion = FrameMotion(self.t, self.rotation[p.frame], self.twist[p.frame], None, g)
            T, E, W = p.energies(motion, self.pose[p.frame], (s.local_q(self.q, k), s.local_v(self.v, k)))
            kinetic += T
            elastic += E
            weight += W

        elastic += sum(elements.energy(self.t, self.pose) for elements in s.elements)
        springs = sum(f.energy(self.kin, self.t) for f in s.forces)
        return {"kinetic": kinetic, "elastic": elastic, "weight": weight, "springs": springs}

    def momenta(self) -> tuple[Array, Array]:
        """Linear and angular momentum about the origin, world axes."""
        s = self.system
        assert self.v is not None
        p: Array = np.zeros(s.motions.dim)
        L: Array = np.zeros(s.motions.n_rot)
        if s.rigid is not None:
            dp, dL = s.rigid.momenta(self.pose, self.twist)
            p, L = p + dp, L + dL

        for k, part in enumerate(s.parts):
            motion = FrameMotion(
                self.t, self.rotation[part.frame], self.twist[part.frame], None, np.zeros(s.motions.dim)
            )
            dp, dL = part.momenta(motion, self.pose[part.frame], (s.local_q(self.q, k), s.local_v(self.v, k)))
            p, L = p + dp, L + dL
        return p, L


def _transposed(jacobians: Array, wrenches: Array) -> Array:
    """J^T f of each marker, (m, n) for Jacobians (m, d + n_rot, n)."""
    return np.asarray((jacobians.swapaxes(1, 2) @ wrenches[..., None])[..., 0])
