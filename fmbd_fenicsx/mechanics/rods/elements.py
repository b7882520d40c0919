"""The finite elements of a rod: forces between the frames of its nodes, energy, tangents; all elements at once.

Nodes are moving frames of the system, with places x_i, quaternions p_i and twists (x_i', omega_i in the section's axes). With
z = (x', P, P') at a Gauss point, Z = dz/d(twists of the nodes) and E = de/dz,

    f = sum_q w (E Z)^T S,     S = dW/de (e - e_0) + beta C e' + (arms),     e' = E Z (twists)                          (1)
    K = sum_q w Z^T (E^T dS/de E + d^2(S . e)/dz^2) Z + (second derivative of p exp(theta))                           (2)

with C = d^2 W / de^2, beta the time of Kelvin-Voigt damping, and the viscoelastic arms of :mod:`.relaxation`. (2) is the exact
derivative of f by increments of the twists, but for the geometric part of the damping. Inertia and weight are those of rigid
bodies at the nodes: the mass of the rod, lumped by Gauss-Lobatto weights, which keep the order 2 p of the element of degree p.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ...errors import values_of
from ...rotations import Array, hat, quaternion_matrix
from .relaxation import ArmMemory, Arms
from .strains import LobattoShape, strain_hessian, strain_jacobian, strains

Forces = tuple[np.ndarray, Array]  # numbers of frames (m, k), and what belongs to them


@dataclass(frozen=True)
class LineLoad:
    """Forces and moments on the nodes of rod ``name``: ``law``(s, t) -> (3,) N/m or N m/m, times ``lengths`` (nodes,) m of each.

    ``follower``: in axes of the sections; ``turns``: a moment.
    """

    name: str
    law: Any
    lengths: Array
    stations: Array
    follower: bool
    turns: bool

    def on_nodes(self, t: float) -> Array:
        """Forces or moments on the nodes at a time (s), (nodes, 3)."""
        places = [(float(s), t) for s in self.stations]
        per_length = values_of(f'Rod "{self.name}": law of a load', self.law, places, 3, "s = {:g} m, t = {:g} s")
        return np.asarray(self.lengths[:, None] * per_length)


class Stressed(NamedTuple):
    """Sections at the Gauss points, (m, q, ..): z, the quaternions p of the nodes, e less the strains free of stress, E = de/dz,
    Z, and the forces and moments S.
    """

    z: tuple[Array, Array, Array]
    p: Array
    e: Array
    E: Array
    Z: Array
    S: Array


class RodElements:
    """All elements of one rod.

    ``frames`` (m, k): numbers of the nodes' frames; ``half`` (m,): half lengths, m; ``natural`` (m, q, 6): strains free of
    stress; ``law``: the section's law at all Gauss points; ``beta``: s; ``arms``: of a viscoelastic section, with their memory
    ``kept``.
    """

    def __init__(self, name: str, frames: np.ndarray, shape: LobattoShape, half: Array, natural: Array) -> None:
        self.name, self.frames, self.shape = name, frames, shape
        self.weights = half[:, None] * shape.weights
        self.slopes = shape.dN[None] / half[:, None, None]  # dN/ds, (m, q, k)
        self.natural = natural

        self.law: Any = None
        self.beta = 0.0
        self.arms: Arms | None = None
        self.kept: Any = None  # ArmMemory where there are arms
        self.loads: tuple[LineLoad, ...] = ()

        self.nodes = np.unique(frames)[:, None]
        self.points: Array = np.zeros((0, 0))  # arc lengths of the Gauss points, (m, q)
        self.breaks: Array = np.zeros(0)  # and of the ends of the elements

    # -- kinematics ---------------------------------------------------------------------------------------------
    def interpolated(self, pose: Array) -> tuple[tuple[Array, Array, Array], Array]:
        """z at the Gauss points, (.., m, q, ..), and the quaternions of the nodes (.., m, k, 4), of one sign within each element,
        for poses of all frames, (.., n_frames, 7).
        """
        nodal = pose[..., self.frames, :]
        x = nodal[..., :3]
        p = nodal[..., 3:].copy()
        # q and -q are one rotation: neighbours on one side, or their mean would be none
        for i in range(1, p.shape[-2]):
            p[..., i, :] *= np.where((p[..., i, :] * p[..., i - 1, :]).sum(-1, keepdims=True) < 0, -1.0, 1.0)
        N = self.shape.N
        return (self.slopes @ x, N @ p, self.slopes @ p), p

    def strains(self, pose: Array) -> Array:
        """Strains less those that are free of stress, (.., m, q, 6), for poses of all frames, (.., n_frames, 7)."""
        return strains(*self.interpolated(pose)[0]) - self.natural

    def directions(self, columns: Array) -> Array:
        """Z, (m, q, 11, 6 k), with dp/d(turn) of the nodes, (m, k, 4, 3)."""
        m, k = columns.shape[:2]
        q = len(self.shape.points)

        turn = columns[:, None]
        Z = np.zeros((m, q, 11, k, 6))
        # dx/ds by places, then p and dp/ds by rotations
        Z[:, :, range(3), :, range(3)] = self.slopes
        Z[:, :, 3:7, :, 3:] = np.moveaxis(self.shape.N[None, :, :, None, None] * turn, 2, 3)
        Z[:, :, 7:11, :, 3:] = np.moveaxis(self.slopes[..., None, None] * turn, 2, 3)

        return Z.reshape(m, q, 11, 6 * k)

    def _stressed(self, t: float, pose: Array, twist: Array | None) -> Stressed:
        """The state (1) of the sections; without twists that of a rod at rest."""
        z, p = self.interpolated(pose)
        e, E = strain_jacobian(*z)
        e = e - self.natural
        Z = self.directions(spins(p))

        S: Array = self.law.stress(e)
        if self.arms is not None:
            S = S + self.arms.stress(self.kept, t, e)
        if self.beta and twist is not None:
            nodal = twist[self.frames].reshape(len(self.frames), 1, -1, 1)
            S = S + self.beta * (self.law.tangent(e) @ (E @ (Z @ nodal)))[..., 0]
        return Stressed(z, p, e, E, Z, S)

    @property
    def elastic(self) -> bool:
        """Whether section forces follow from strains alone."""
        return self.arms is None and not self.beta

    def section_forces(self, t: float, pose: Array, twist: Array | None) -> Array:
        """Forces and moments (m, q, 6) of the sections at the Gauss points, in their axes."""
        if self.elastic:
            return np.asarray(self.law.stress(self.strains(pose)))
        return self._stressed(t, pose, twist).S

    # -- mechanics ----------------------------------------------------------------------------------------------
    def forces(self, t: float, pose: Array, twist: Array | None) -> list[Forces]:
        """What the rod adds to the balance M a + h of its nodes: forces (1), less the loads along it."""
        _, _, _, E, Z, S = self._stressed(t, pose, twist)
        on_z = self.weights[..., None, None] * (S[..., None, :] @ E)
        rows: Array = (on_z @ Z).sum(1).reshape(*self.frames.shape, 6)
        return [(self.frames, rows), *((self.nodes, -self._load(x, t, pose)[0]) for x in self.loads)]

    def tangents(self, t: float, pose: Array, twist: Array | None, weights: tuple[float, float]) -> list[Forces]:
        """cd D + ck K of them, ``weights`` = (cd, ck), as (m, 6 k, 6 k); (2)."""
        cd, ck = weights
        z, p, e, E, Z, S = self._stressed(t, pose, twist)

        C = (ck + self.beta * cd) * self.law.tangent(e)
        if self.arms is not None:
            C = C + ck * self.arms.tangent(self.kept, t)

        inner = np.swapaxes(E, -1, -2) @ C @ E
        inner += ck * strain_hessian(z, S)
        K: Array = (np.swapaxes(Z, -1, -2) @ (self.weights[..., None, None] * inner) @ Z).sum(1)

        on_z = (self.weights[..., None, None] * (S[..., None, :] @ E))[..., 0, :]
        self._add_turns(K, on_z, p, ck)
        return [(self.frames, K), *((self.nodes, -ck * self._load(x, t, pose)[1]) for x in self.loads)]

    def _add_turns(self, K: Array, on_z: Array, p: Array, ck: float) -> None:
        """The part of (2) from the second derivative of p exp(theta): moment~ / 2 - (slope along p) / 4 for each node."""
        # derivatives of the energy by the quaternions of the nodes
        slope = np.einsum("qi,mqc->mic", self.shape.N, on_z[..., 3:7])
        slope += np.einsum("mqi,mqc->mic", self.slopes, on_z[..., 7:11])

        moment = (slope[:, :, None, :] @ spins(p))[:, :, 0]
        extra = 0.5 * hat(moment) - 0.25 * (slope * p).sum(-1)[..., None, None] * np.eye(3)
        for i in range(p.shape[1]):
            at = slice(6 * i + 3, 6 * i + 6)
            K[:, at, at] += ck * extra[:, i]

    def _load(self, load: LineLoad, t: float, pose: Array) -> tuple[Array, Array]:
        """Forces and moments of a load on the nodes, (nodes, 1, 6), and their derivatives by increments, (nodes, 6, 6)."""
        value = load.on_nodes(t)
        R = quaternion_matrix(pose[self.nodes[:, 0], 3:])
        out = np.zeros((len(value), 1, 6))
        slope = np.zeros((len(value), 6, 6))
        # moments stand in body axes, forces in world axes
        if load.turns:
            own = value if load.follower else (np.swapaxes(R, 1, 2) @ value[..., None])[..., 0]
            out[:, 0, 3:] = own
            slope[:, 3:, 3:] = 0.0 if load.follower else hat(own)
        else:
            out[:, 0, :3] = (R @ value[..., None])[..., 0] if load.follower else value
            slope[:, :3, 3:] = -R @ hat(value) if load.follower else 0.0
        return out, slope

    def mean_forces(self, t: float, poses: tuple[Array, Array], twist: Array, h: float) -> list[Forces]:
        """Forces over a step of a scheme that conserves energy, see :mod:`.discrete_gradient`; loads at the mean."""
        from .discrete_gradient import mean_forces

        middle = poses[0].copy()
        # the mean rotation: of two quaternions on one side
        p1 = poses[1][:, 3:] * np.where((poses[0][:, 3:] * poses[1][:, 3:]).sum(-1, keepdims=True) < 0, -1.0, 1.0)
        middle[:, 3:] += p1
        middle[:, 3:] /= np.linalg.norm(middle[:, 3:], axis=-1, keepdims=True)

        loads = [(self.nodes, -self._load(x, t, middle)[0]) for x in self.loads]
        return [(self.frames, mean_forces(self, poses, twist, h)), *loads]

    def given(self, t: float, pose: Array, twist: Array) -> dict[str, float]:
        """Power (W) of the loads along the rod and of its damping."""

        def power(part: Forces) -> float:
            frames, rows = part
            return -float((rows * twist[frames]).sum())

        with_rates, *loads = self.forces(t, pose, twist)
        found = {"loads": sum(power(x) for x in loads)} if loads else {}
        # what the rates add to the forces is the damping
        if self.beta:
            found["damping"] = power(with_rates) - power(self.forces(t, pose, None)[0])
        if self.arms is not None:
            lost = self.arms.loss(self.kept, t, self.strains(pose))
            found["relaxation"] = -float((self.weights * lost).sum())
        return found

    def energy(self, t: float, pose: Array) -> float:
        """Elastic energy, J."""
        e = self.strains(pose)
        density = self.law.energy(e)
        if self.arms is not None:
            density = density + self.arms.energy(self.kept, t, e)
        return float((self.weights * density).sum())

    # -- memory of the arms -------------------------------------------------------------------------------------
    def first(self, ev: Any, state: Any) -> ArmMemory | None:
        """The memory at the start of a run: no force in the arms."""
        if self.arms is None:
            return None
        e = self.strains(ev.pose)
        return ArmMemory(state.t, e, np.broadcast_to(e, self.arms.C.shape[:-1]).copy())

    def accepted(self, ev: Any, state: Any) -> ArmMemory | None:
        """The memory after a step that ended in a state, evaluated as ``ev``."""
        if self.arms is None:
            return None
        e = self.strains(ev.pose)
        found: ArmMemory = self.kept.followed_by(state.t, e, self.arms.inner(self.kept, state.t, e))
        return found

    def jumps(self, kept: Any) -> bool:
        """Never: forces are continuous."""
        return False

    def memory_values(self) -> Array:
        """Strains of the dashpots, (m,)."""
        return np.zeros(0) if self.arms is None else self.kept.inner.ravel()

    def set_memory(self, values: Array, t: float) -> None:
        """Take these strains at time t, s."""
        if self.arms is not None:
            self.kept = replace(self.kept, t=t, inner=values.reshape(self.kept.inner.shape), before=None)

    def memory_rates(self, ev: Any, t: float) -> Array:
        """a' = (e - a) / tau of all arms, (m,), 1/s."""
        if self.arms is None:
            return np.zeros(0)
        rates: Array = (self.strains(ev.pose) - self.kept.inner) / self.arms.tau[:, None, None, None]
        return rates.ravel()


def spins(p: Array) -> Array:
    """d(p exp(theta))/d theta at theta = 0, (..., 4) -> (..., 4, 3)."""
    out = np.empty((*p.shape, 3))
    out[..., :3, :] = 0.5 * (p[..., 3, None, None] * np.eye(3) + hat(p[..., :3]))
    out[..., 3, :] = -0.5 * p[..., :3]
    return out
