"""Reduced elastic bodies: a floating frame and a few modes, x = r + R (X + Phi eta), with constants instead of a field.

With the nodal fields Z_0 = X, Z_k = Phi_k and p = (1, eta) the points are P = sum_a p_a Z_a. All inertia follows from

    S_a = sum_n (M Z_a)_n,    T_ab = sum_nm Z_a,n M_nm Z_b,m^T,    T(p, q) = sum_ab p_a q_b T_ab               (1)

computed once. With a = R^T (r'' - g), w~ the matrix of the angular velocity and L = w'~ + w~ w~ the nodal accelerations in
body axes are a + L P + 2 w~ P' + P'', hence

    translation  R (m a + L S p + 2 w~ S p' + S p'')
    rotation     axial vector of  N = (S p) a^T + T(p, p) L^T + 2 T(p, p') w~^T + T(p, p'')                    (2)
    mode k       S_k . a + tr(T(e_k, p) L^T) + 2 tr(T(e_k, p') w~^T) + tr(T(e_k, p'')) + (K eta + D eta')_k

No term is left out: with all modes of a field (2) is the field's inertia. Nothing here knows of a mesh. With no modes at all the
body is rigid. Stiffening by the stress of the inertia forces and the inertia of second-order displacements are in
:mod:`..elastic.second_order`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ...errors import ConvergenceError
from ...fem.given_numbers import GivenNumbers, refuse_changed
from ...fem.loads import turned_virial
from ...rotations import Array, axial, hat, motions, spin_matrix
from ..body import MODES, Body, Placed, Site
from ..elastic.foreshortening import of_constants
from ..elastic.second_order import Acting, DisplacementMoments, SecondOrder, load_moment, turning
from ..placements import FrameMotion, Part
from ..validity import TOO_LARGE, too_large
from .derived import Derived, derive, derived


@dataclass(frozen=True)
class SurfaceData:
    """Moments of a surface as linear functions of the modes: reference (1 + d, d), modes ((1 + d) d, m), centroid (d,).

    ``bend`` (r, m, m): G_r of :mod:`..elastic.foreshortening` for unit forces (and moments) on the surface; None without
    stiffening.
    """

    reference: Array
    modes: Array
    center: Array
    bend: Array | None = None


@dataclass(frozen=True, eq=False)
class ReducedConstants:
    """All that a reduced body is made of.

    Attributes: ``mass`` kg; ``S`` (d, m + 1) and ``T`` (m + 1, m + 1, d, d) of (1); ``K``, ``D`` (m, m) stiffness and
    damping; ``surfaces`` by name; ``center`` (d,) origin of the frame at the start, world axes; ``size`` m;
    ``stiffening`` (d + d^2, m, m): G of (2) for unit a and L, or None; ``loads``: pairs of a load of ``fem.loads`` and its
    (m + 1, d, d): sum_n b_n Z_a,n^T; ``load_stress``: G of their stress, (d, d, m, m): the nodal component i along axis j;
    ``load_turned``: rows of the frame and of the modes, body axes, by what amplitudes add to carried ones, (n_twist + m, m);
    ``numbers``: of the user's in its forms, None without forms.
    """

    mass: float
    S: Array
    T: Array
    K: Array
    D: Array
    surfaces: dict[str, SurfaceData]
    center: Array
    size: float
    stiffening: Array | None = None
    loads: tuple[tuple[Any, Array], ...] = ()
    load_sums: dict[Any, Array] = field(default_factory=dict)
    load_stress: dict[Any, Array] = field(default_factory=dict)
    load_turned: dict[Any, Array] = field(default_factory=dict)
    numbers: GivenNumbers | None = None

    @property
    def n_modes(self) -> int:
        """Number of modes."""
        return len(self.K)

    @cached_property
    def derived(self) -> Derived:
        """What follows from them."""
        return derived([self])[0]


def constants_of(Z: Array, MZ: Array) -> tuple[Array, Array]:
    """S and T of (1) from nodal fields Z (n, d, m + 1) and M Z; sums over this rank only."""
    n, d, m = Z.shape
    S = MZ.sum(0)
    T = (Z.reshape(n, d * m).T @ MZ.reshape(n, d * m)).reshape(d, m, d, m).transpose(1, 3, 0, 2)
    return S, T


def reduced_part(body: Any, frame: int, surfaces: Sequence[str]) -> ReducedPart:
    """A reduced body or beam as a part of a system, with the ports of the named surfaces."""
    part = ReducedPart(body.name, body.constants, frame, surfaces)
    part.body = body
    if part.numbers is not None:
        refuse_changed({body.name: part.numbers}, "the body was reduced", "Reduce it anew.")
    return part


class ModalBody(Body):
    """A body by amplitudes of modes and ``constants`` of these; undeformed at the start, its frame at the centre of mass."""

    stage = MODES
    constants: ReducedConstants

    @classmethod
    def prepare(cls, bodies: Sequence[Any]) -> None:
        """What follows from the constants of all of them."""
        derive([body.constants for body in bodies])

    def surface(self, name: str) -> Any:
        """The named surface of the body."""
        raise NotImplementedError

    def frequencies(self, n: int, *, held: str | Sequence[str] = ()) -> Array:
        """The first n natural frequencies (Hz) of this body alone, by its modes, ascending; collective.

        Without ``held`` the body is free and its rigid motions are left out; a held surface keeps its mean position and rotation.
        """
        from .modal_frequencies import modal_frequencies

        surfaces = [held] if isinstance(held, str) else held
        for name in surfaces:
            self.surface(name)
        return modal_frequencies(reduced_part(self, 0, surfaces), n)

    def placed(self, site: Site) -> Placed:
        """Its modes as a part on its frame."""
        part = reduced_part(self, site.frame, site.surfaces)
        return Placed(part, *self.start_local(), *self.start_frame())

    def start_local(self) -> tuple[Array, Array]:
        """Modal amplitudes and rates at the start, (modes,)."""
        return np.zeros(self.constants.n_modes), np.zeros(self.constants.n_modes)

    def start_frame(self) -> tuple[Array, Array | None]:
        """Pose and twist of the frame at the start; no twist where it is that of the body."""
        return motions(len(self.constants.S)).pose(self.constants.center), None


class ReducedPart(Part):
    """A reduced body as a replicated part of a system: local coordinates are the modal amplitudes eta, (m,)."""

    leaves_out = True

    def __init__(self, name: str, constants: ReducedConstants, frame: int, surfaces: Sequence[str]) -> None:
        self.name, self.constants, self.frame, self.surfaces = name, constants, frame, tuple(surfaces)
        self.numbers = constants.numbers

        self.dim = d = constants.S.shape[0]
        self.motions = motions(d)
        self.n = constants.n_modes
        self.mass_total, self.size = constants.mass, constants.size
        self.of_time = bool(constants.loads)

        # ports of the surfaces in use, one after the other
        used = [constants.surfaces[s] for s in surfaces]
        self.n_port = d * (1 + d) * len(used)
        self.reference = np.concatenate([np.zeros(0), *(s.reference.ravel() for s in used)])
        self.port_matrix = np.concatenate([np.zeros((0, self.n)), *(s.modes for s in used)])

        self.shortening = of_constants(self.motions, used, self.n_port)

        # T with its second index last: T(e_a, p) of all a is one product
        k = self.n + 1
        self._T = np.ascontiguousarray(constants.T.transpose(0, 2, 3, 1)).reshape(k * d * d, k)
        # first moments int rho p, int rho X p^T, and what the mean motion takes from them
        self._first = np.concatenate((constants.S, constants.T[0].transpose(1, 2, 0).reshape(d * d, k)))
        self._swapped = np.concatenate((constants.S, constants.T[:, 0].transpose(1, 2, 0).reshape(d * d, k)))[:, 1:].T

        known = constants.derived
        self._modal_mass, self.rms, self.mean_rates = known.mass, known.rms, known.rates
        self.first_frequency = known.first_frequency

    @cached_property
    def second(self) -> SecondOrder:
        """Inertia of its second-order displacements."""
        c = self.constants
        return SecondOrder(c.mass, c.S[:, 0], c.T[0, 0])

    def surface_center(self, surface: str) -> Array:
        """Centroid of a surface at the start, world axes."""
        return self.constants.surfaces[surface].center

    # -- mechanics ----------------------------------------------------------------------------------------------
    def _with_shape(self, *amplitudes: Array) -> Array:
        """p, p', ... as columns (m + 1, count): the first amplitude is completed by 1, the others by 0."""
        out = np.zeros((self.n + 1, len(amplitudes)))
        out[0, 0] = 1.0
        for k, x in enumerate(amplitudes):
            out[1:, k] = x
        return out

    def _motion(self, motion: FrameMotion) -> tuple[Array, Array, Array]:
        """a, w~ and L of (2)."""
        d = self.dim
        assert motion.accel is not None
        w = spin_matrix(motion.twist[d:])
        return motion.R.T @ (motion.accel[:d] - motion.gravity), w, spin_matrix(motion.accel[d:]) + w @ w

    def _watch(self, eta: Array) -> None:
        """Refuse displacements of the size of the body."""
        c = self.constants
        # root mean square of the displacements over the mass
        mean = float(np.sqrt(max(float(eta @ self._modal_mass @ eta), 0.0) / c.mass))
        if not mean <= TOO_LARGE * c.size:
            raise ConvergenceError(too_large(self.name, mean, c.size, c.stiffening is not None))

    def force(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """Rows of (2): the frame's (n_twist,), world translation and body rotation, and the modes' (m,)."""
        c, d = self.constants, self.dim
        eta, rate, second = local
        a, w, L = self._motion(motion)
        self._watch(eta)

        # S and T(e_a, .) of p, p', p''
        p = self._with_shape(eta, rate, second)
        Sp = c.S @ p
        Tp = (self._T @ p).reshape(-1, d, d, 3)

        # (2), row by row
        B = Tp[..., 0] @ L.T + 2.0 * (Tp[..., 1] @ w.T) + Tp[..., 2]
        N = np.tensordot(p[:, 0], B, 1) + np.outer(Sp[:, 0], a)
        force = c.mass * a + L @ Sp[:, 0] + 2.0 * (w @ Sp[:, 1]) + Sp[:, 2]
        frame = np.concatenate((motion.R @ force, axial(N)))
        rows: Array = a @ c.S[:, 1:] + np.trace(B[1:], axis1=1, axis2=2) + c.K @ eta + c.D @ rate

        if c.stiffening is not None:
            bent, R, x = self._bent(eta), motion.R, self._acting(motion, local)
            frame[:d] += R @ x.frame[:d]
            frame[d:] += x.frame[d:]
            rows = rows + self._first[:, 1:].T @ np.concatenate((x.a, x.L.T.ravel())) + bent @ x.stress
        for load, b in c.loads:
            self._apply(load, b, motion, p[:, 0], (frame, rows))
        return frame, rows

    def _bent(self, eta: Array) -> Array:
        """Columns G_c eta, G_ij eta, (m, d + d^2)."""
        G = self.constants.stiffening
        assert G is not None
        return np.asarray((G @ eta).T)

    def _moments(self, bent: Array, local: Sequence[Array]) -> DisplacementMoments:
        """Of :mod:`..elastic.second_order` and their rates, from the columns :meth:`_bent` of the first of local."""
        z = bent.T @ np.stack(local, axis=1)
        z[:, 0] *= 0.5
        if len(local) > 2:
            z[:, 2] += self._bent(local[1]).T @ local[1]
        return DisplacementMoments.of(self._first @ self._with_shape(*local), z, self.dim)

    def _acting(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> Acting:
        """(4) of :mod:`..elastic.second_order`, for local coordinates with two rates."""
        assert motion.accel is not None
        R = motion.R
        twist, accel = self._in_body(R, motion.twist), self._in_body(R, motion.accel)
        return self.second.acting(self._moments(self._bent(local[0]), local), twist, accel, R.T @ motion.gravity)

    def _in_body(self, R: Array, twist: Array) -> Array:
        """Twist or its rate with its translation in body axes."""
        d = self.dim
        return np.concatenate((R.T @ twist[:d], twist[d:]))

    def _apply(self, load: Any, B: Array, motion: FrameMotion, p: Array, out: tuple[Array, Array]) -> None:
        """Subtract a load from the rows of the frame and of the modes."""
        d, stress = self.dim, self.constants.load_stress.get(load)
        turned = self.constants.load_turned.get(load)
        factor = load.factor(motion.t, self.name)
        if not load.follower:
            B = motion.R.T @ B  # nodal forces in body axes

        out[1][:] -= factor * np.trace(B[1:], axis1=1, axis2=2)
        if stress is not None:
            axes = factor * (np.eye(d) if load.follower else motion.R)
            bent = stress @ p[1:]
            out[1][:] += np.tensordot(axes, bent, 2)
            if turned is None:
                out[0][d:] -= load_moment(axes, bent @ p[1:])

        # what turns with the material
        if turned is not None:
            more = factor * (turned @ p[1:])
            out[0][:d] -= motion.R @ more[:d]
            out[0][d:] -= more[d : len(out[0])]
            out[1][:] -= more[len(out[0]) :]

        if not load.internal:
            out[0][:d] -= factor * (motion.R @ self._load_sum(load, motion.R))
            out[0][d:] -= factor * axial((B[0] if load.carried else np.tensordot(p, B, 1)).T)

    def given(self, motion: FrameMotion, local: tuple[Array, Array]) -> dict[str, float] | None:
        """Power (W) of loads and of damping."""
        c, d, (eta, rate) = self.constants, self.dim, local
        found = {}
        if c.loads:
            rows = np.zeros(d + self.motions.n_rot), np.zeros(self.n)
            p = self._with_shape(eta)[:, 0]
            for load, b in c.loads:
                self._apply(load, b, motion, p, rows)
            found["loads"] = -float(rows[0] @ motion.twist + rows[1] @ rate)

        if c.D.any():
            found["damping"] = -float(rate @ c.D @ rate)
        return found

    def _stress_of(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> Array:
        """Geometric stiffness (m, m) of the stress by the inertia forces and by loads."""
        c = self.constants
        assert c.stiffening is not None
        stress: Array = np.tensordot(self._acting(motion, local).stress, c.stiffening, 1)
        for load in c.load_stress:
            axes = np.eye(self.dim) if load.follower else motion.R
            stress = stress + load.factor(motion.t, self.name) * np.tensordot(axes, c.load_stress[load], 2)
        for load, turned in c.load_turned.items():
            on_modes = turned[-self.n :]
            stress = stress - load.factor(motion.t, self.name) * 0.5 * (on_modes + on_modes.T)
        return stress

    def virial(self, port: Array, t: float, R: Array) -> Array:
        """sum f X^T of forces f on the ports and of loads, body axes, (d, d): the sum of the stress that slopes work on, N m."""
        d = self.dim
        out: Array = port.reshape(-1, d).T @ self.reference.reshape(-1, d)
        for load, b in self.constants.loads:
            if not load.internal:
                axes = np.eye(d) if load.follower else R.T
                own = load.factor(t, self.name) * (axes @ b[0])
                out += own + turned_virial(own) if load.carried else own
        return out

    def _load_sum(self, load: Any, R: Array) -> Array:
        total = self.constants.load_sums[load]
        return total if load.follower else R.T @ total

    def mass_blocks(self, motion: FrameMotion, u: Array) -> tuple[Array, Array, Array]:
        """Mass blocks (frame, frame), (modes, frame), (modes, modes) at the amplitudes u."""
        c, d, m = self.constants, self.dim, self.motions
        p = self._with_shape(u)[:, 0]
        n = m.n_twist
        Tp = (self._T @ p).reshape(-1, d, d)  # T(e_a, p)
        Tpp = np.tensordot(p, Tp, 1)
        arm = c.S @ p

        # the frame: total mass, moment of inertia, static moment
        M = np.zeros((n, n))
        M[:d, :d] = c.mass * np.eye(d)
        if d == 3:
            M[3:, 3:] = np.trace(Tpp) * np.eye(3) - 0.5 * (Tpp + Tpp.T)
            M[3:, :3] = hat(arm) @ motion.R.T
        else:
            M[2, 2] = np.trace(Tpp)
            M[2, :2] = motion.R @ np.array([-arm[1], arm[0]])
        M[:d, d:] = M[d:, :d].T

        # modes against the frame
        low = np.empty((self.n, n))
        low[:, :d] = c.S[:, 1:].T @ motion.R.T
        T = Tp[1:]
        pairs = ((2, 1), (0, 2), (1, 0)) if d == 3 else ((1, 0),)
        for k, (i, j) in enumerate(pairs):
            low[:, d + k] = T[:, i, j] - T[:, j, i]
        if c.stiffening is None:
            return M, low, self._modal_mass
        # second order, with the translation in world axes
        bent = self._bent(u)
        A_u, B_u = turning(self._swapped, d), turning(bent, d)
        frame, more = self.second.mass_blocks(self._moments(bent, (u,)), A_u, B_u)
        turn = np.eye(n)
        turn[:d, :d] = motion.R
        V, C = self.second.own_mass(A_u, B_u)
        return M + turn @ frame @ turn.T, low + more @ turn.T, self._modal_mass + V @ C @ V.T

    def stiffness_blocks(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """K and D of the modes; K with the stress of inertia forces, loads and forces on the surfaces."""
        K = self.constants.K
        if self.constants.stiffening is not None:
            K = K + self._stress_of(motion, local)
        if motion.pull is not None and self.shortening is not None and self.shortening.G is not None:
            K = K + np.tensordot(motion.pull, self.shortening.G, 1)
        return K, self.constants.D

    def _momentum(self, motion: FrameMotion, local: tuple[Array, Array]) -> tuple[Array, Array, float]:
        """sum M W and sum P x M W in body axes, and the kinetic energy."""
        c, d = self.constants, self.dim
        w = spin_matrix(motion.twist[d:])
        v = motion.R.T @ motion.twist[:d]

        # first and second moments of mass of the places P and their rates P' in the body
        places = self._with_shape(*local)
        S, S_rate = (c.S @ places).T
        T = (self._T @ places).reshape(-1, d, d, 2)
        PP, PR, RR = (np.tensordot(places[:, i], T[..., j], 1) for i, j in ((0, 0), (0, 1), (1, 1)))

        flow = w @ S + S_rate
        momentum, spin = c.mass * v + flow, axial(np.outer(S, v) + PP @ w.T + PR)
        turning = np.trace(w @ PP @ w.T) + 2 * np.trace(w @ PR) + np.trace(RR)
        energy = 0.5 * float(c.mass * v @ v + 2 * v @ flow + turning)
        if c.stiffening is None:
            return momentum, spin, energy

        moments = self._moments(self._bent(local[0]), local)
        more, more_energy = self.second.momentum(moments, self._in_body(motion.R, motion.twist))
        return momentum + more[:d], spin + more[d:], energy + more_energy

    def energies(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[float, float, float]:
        """Kinetic, elastic and weight energy, J."""
        c, d, eta = self.constants, self.dim, local[0]
        arm = c.S @ self._with_shape(eta)[:, 0]
        if c.stiffening is not None:
            arm = arm + self._moments(self._bent(eta), (eta,)).m[0]
        center = c.mass * pose[:d] + motion.R @ arm
        elastic = 0.5 * float(eta @ c.K @ eta)
        return self._momentum(motion, local)[2], elastic, -float(motion.gravity @ center)

    def momenta(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[Array, Array]:
        """Linear and angular momentum about the world origin, world axes."""
        m, d = self.motions, self.dim
        p, spin, _ = self._momentum(motion, local)
        p = motion.R @ p
        return p, m.moment(pose[:d], p) + m.turn(motion.R, spin)
