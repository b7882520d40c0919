"""A system between two configurations: markers, springs and constraints as exact difference quotients.

With x^ for the mean of the old and the new x, d for their difference, A = (R_0 + R_1) / 2 for rotations, a marker moves by

    dx = h x',   dR = h w~ A:           x', w linear in the mean twist of its body or in the change of its surface's ports    (1)

rigid body   q_1 = q_0 o cay(h w_b):    w = A^-T w_b,   x' = r' + w x (x^ - r^)                                          (2)
surface      F = sum_k b_k e_k^T = R V, V symmetric:
             w = A (tr W 1 - W)^-1 sum_k e_k x A^T b_k' / det A,    W = A^-1 F^,    x' = b_0' + w x A X                    (3)

and where the ports turn by w x b^, so do the markers. (3) follows from both: dF = w~ F^ + A^-T dV with V = R^T F symmetric.
So what depends on x and R up to second order, all joints, is differenced exactly by its rows at the mean, and the forces
keep energy, momentum and angular momentum. A relative coordinate s that is not of second order (distances, angles) has its
rows scaled to s_1 - s_0.

Sources: Gonzalez, doi:10.1007/s003329900016; Simo and Wong, doi:10.1002/nme.1620310103; Betsch, doi:10.1007/s11044-005-0103-8.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ....mechanics.forces.force_elements import ScalarLoads
from ....mechanics.forces.laws_together import mean_effort
from ....mechanics.frames import Kinematics, Markers
from ....mechanics.placements import FrameMotion
from ....rotations import Array
from ....system.evaluation import Evaluation
from ....system.system import System
from ....system.tangents.foreshortened_ports import port_forces


class GradientEnd(Evaluation):
    """One configuration of the core and the ports of fields: nothing here touches a field, so nothing is collective."""

    def __init__(self, system: System, t: float, q: Array, port: Array) -> None:
        self.system, self.t, self.q, self.v = system, t, q, None
        self.pose = system.poses(q)
        self.port = port.copy()
        for k, part in system.core_parts:
            self.port[system.port_slice(k)] = part.ports_of(system.local_q(q, k), t) + part.reference
        for k, bent in self.bent.items():
            self.port[system.port_slice(k)] += bent.values(system.local_q(q, k))


class Mean(Evaluation):
    """Between two configurations; ``middle``: time, configuration of the core, its mean velocity; ``h`` (s)."""

    def __init__(self, old: Evaluation, new: Evaluation, middle: tuple[float, Array, Array], h: float) -> None:
        self.system, (self.t, self.q, self.v) = old.system, middle
        self.ends, self.h = (old, new), h
        self.pose = self.system.poses(self.q)
        self.port = 0.5 * (old.port + new.port)
        self.port_rate = (new.port - old.port) / h
        self.twist = self.system.twists(self.v)

    @cached_property
    def kin(self) -> Kinematics:
        """Means of the markers at both ends with the Jacobians of (1), and their mean velocities."""
        old, new = (ev.kin for ev in self.ends)
        kin = Kinematics(
            0.5 * (old.x + new.x),
            0.5 * (old.R + new.R),
            0.5 * (old.jac_frame + new.jac_frame),
            0.5 * (old.jac_port + new.jac_port),
        )
        if old.turned is not None and new.turned is not None:
            kin.turned = 0.5 * (old.turned + new.turned)
        if known := [x for x in (old.counts, new.counts) if x is not None]:
            kin.counts = lambda: np.mean([count() for count in known], axis=0)

        # exact Jacobians of the means
        markers = self.system.markers
        if self.system.motions.dim == 3:
            self._turn(kin)
        if markers.surface.size:
            still = markers.frame[markers.surface] == self.system.n_frames
            if markers.section is not None:
                still &= ~markers.section
            kin.jac_port[still] = surface_quotients(markers, kin, self.port, still)

        twist = (kin.jac_frame @ self.twist[markers.frame][..., None])[..., 0]
        if markers.surface.size:
            twist[markers.surface] += (kin.jac_port @ self.port_rate[markers.port][..., None])[..., 0]
        kin.twist = twist
        return kin

    def _turn(self, kin: Kinematics) -> None:
        """Rotational columns (2) of the markers on bodies."""
        motions, frame = self.system.motions, self.system.markers.frame
        old, new = self.ends
        rotation = 0.5 * (old.rotation + new.rotation)[frame]
        origin = 0.5 * (old.pose + new.pose)[frame, :3]

        spatial = np.linalg.inv(rotation).swapaxes(1, 2)
        kin.jac_frame[:, :3, 3:] = motions.lever(kin.x - origin) @ spatial
        kin.jac_frame[:, 3:, 3:] = spatial

    # -- forces -------------------------------------------------------------------------------------------------
    def wrenches(self) -> Array:
        """Applied wrenches; those of laws on relative coordinates as difference quotients of their potentials."""
        out = np.zeros(self.kin.jac_frame.shape[:2])
        for loads in self.system.forces:
            pushed = self._springs(loads) if isinstance(loads, ScalarLoads) else loads.wrenches(self.kin, self.t)
            for marker, wrench in zip(loads.markers, pushed, strict=True):
                np.add.at(out, marker, wrench)
        return out

    def _springs(self, loads: ScalarLoads) -> tuple[Array, ...]:
        """N along rows with h rows . twist = s_1 - s_0; N the mean of the law from s_0 to s_1 at the mean rate."""
        old, new = (ev.kin for ev in self.ends)
        s0, s1 = (loads.relative.values(kin) for kin in (old, new))
        mean = mean_effort(lambda s, rate: loads.effort(s, rate, self.t), s0 - loads.free, (s1 - s0) / self.h, self.h)
        rows = loads.relative.quotients(self.kin, (old, new), self.h, self.system.length)
        return tuple(-mean[:, None] * row for row in rows)

    # -- balance ------------------------------------------------------------------------------------------------
    def small(self, a: Array, lam: Array) -> tuple[Array, Array]:
        """Rows (n_core,) of the core in the balance of forces, and the forces (n_port,) that joints and springs take from ports,
        as they stand in the balance of the fields: M a + f + H ports = 0.
        """
        s = self.system
        accel = s.twists(a)
        g = s.gravity(self.t)
        core = np.zeros((s.n_frames + 1, s.motions.n_twist))

        if s.rigid is not None:
            core[s.rigid.frame] += s.rigid.force(self.twist, accel, g)

        rows = []
        for k, p in s.core_parts:
            motion = FrameMotion(self.t, self.rotation[p.frame], self.twist[p.frame], accel[p.frame], g)
            sums, own = p.force(motion, (s.local_q(self.q, k), s.local_v(self.v, k), s.local_v(a, k)))  # type: ignore[arg-type]
            core[p.frame] += sums
            rows.append(own)

        applied, port = self._applied
        out = np.concatenate((core[:-1].ravel(), *rows)) + applied
        if s.n_lam:
            out += np.asarray(self.jacobian.core.T @ lam)
            port = port + np.asarray(self.jacobian.port.T @ lam)
        return out, port

    @cached_property
    def _applied(self) -> tuple[Array, Array]:
        """What of :meth:`small` depends on neither accelerations nor multipliers: forces of rods, springs and loads."""
        s = self.system
        core, out = np.zeros((s.n_frames + 1, s.motions.n_twist)), np.zeros(s.n_core)
        poses = (self.ends[0].pose, self.ends[1].pose)
        for elements in s.elements:
            for frames, values in elements.mean_forces(self.t, poses, self.twist, self.h):
                np.add.at(core, frames, values)
        out[: core[:-1].size] = core[:-1].ravel()

        port = np.zeros(s.n_port)
        if s.forces:
            push, pull = self.on_ports(self.wrenches())
            port -= pull
            forces = port_forces(self, pull)
            out -= np.concatenate((push, *(forces[k] for k, _ in s.core_parts)))
        return out, port

    def moved(self) -> Array:
        """What the rows at the mean make of the motion, over the step, (n_lam,)."""
        s, G = self.system, self.jacobian
        moved = np.asarray(G.core @ self.v) + self.constraint_rate()
        for k, _ in s.fields:
            at = s.port_slice(k)
            moved = moved + np.asarray(G.port[:, at] @ self.port_rate[at])
        return self.h * moved


def surface_quotients(markers: Markers, kin: Kinematics, port: Array, which: Array) -> Array:
    """Rows (3) on the ports of the surfaces ``which`` that sit on the ground's frame, (count, d + n_rot, n_port)."""
    m, d = markers.motions, markers.motions.dim
    s = markers.surface[which]
    b = port[markers.port[which]].reshape(-1, 1 + d, d)

    # A and F^ of (3)
    A = kin.R[s] @ markers.rotation[s].swapaxes(1, 2)
    F = b[:, 1:].swapaxes(1, 2)

    lever = (A @ markers.position[s][..., None])[..., 0]
    jac: Array = np.zeros((len(s), d + m.n_rot, 1 + d, d))

    # w of (3), for unit rates of the ports
    if d == 2:
        arms = A.swapaxes(1, 2)
        jac[:, 2, 1:] = m.lever(arms)[..., 0] / (arms * b[:, 1:]).sum((1, 2))[:, None, None]
    else:
        W = np.linalg.solve(A, F)
        Z = A @ np.linalg.inv(np.trace(W, axis1=1, axis2=2)[:, None, None] * np.eye(3) - W)
        Z /= np.linalg.det(A)[:, None, None]
        cross = -m.lever(np.eye(3))  # e_k x
        jac[:, 3:, 1:] = (Z[:, None] @ cross[None] @ A.swapaxes(1, 2)[:, None]).swapaxes(1, 2)

    # translations: of the centre, and what the lever makes of the rotation
    jac[:, range(d), 0, range(d)] = 1.0
    jac = jac.reshape(len(s), d + m.n_rot, d * (1 + d))
    jac[:, :d] += m.lever(lever) @ jac[:, d:]
    return jac
