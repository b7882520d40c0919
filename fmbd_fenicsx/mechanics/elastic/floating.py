"""Elastic bodies in a floating frame.

A flexible body in a moving frame has x = r + R P, P = X + U. Its nodal accelerations and inertia forces in body axes are

    a = R^T (r'' - g) + w' x P + w x (w x P) + 2 w x U' + U'',     F = M a                                   (1)

    translation:  R sum_n F_n        rotation:  sum_n P_n x F_n      field:  F + K U + D U'                  (2)

and, with stiffening, what the second-order displacements add (:mod:`.second_order`). Nothing else: no inertia
shape integrals, no gyroscopic terms by hand, because constants and linear functions lie in V_h and M commutes with
node-wise rotations (Galerkin mass, unlumped).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...errors import ConvergenceError, InputError
from ...fem.field_checks import check_free
from ...fem.fields import Field
from ...rotations import Array, axial, motions, spin_matrix
from ..placements import Approach, Attached, Chord, FrameMotion, MeanAxis
from ..validity import TOO_LARGE, too_large
from .field_part import FieldPart, TangentPoint
from .foreshortening import Bent, Shortening
from .modes import rigid_fields
from .second_order import Acting, DisplacementMoments, turning
from .stiffening import Stiffening


class FloatingField(FieldPart):
    """A displacement field in a floating frame; equations (1), (2). One per body.

    ``frame`` is the index of its frame, ``kind`` says how it follows the body; ``held_at``: the surface that holds the inertia
    forces whose stress stiffens the body, None for no stiffening.
    """

    leaves_out = True

    def __init__(
        self,
        field: Field,
        frame: int,
        surfaces: list[str],
        kind: MeanAxis | Attached | Chord,
        held_at: str | None = None,
    ) -> None:
        super().__init__(field, frame, surfaces, frame_conditions(field, kind))
        self._rigid = np.abs(field.total(self.conditions.T @ rigid_fields(field)))

        self.stiffening: Stiffening | None = None
        self.shortening: Shortening | None = None
        if held_at is not None:
            moved = [s for s in surfaces if s != held_at]
            self.stiffening = Stiffening(field, attachment(field, held_at), moved)
            self.shortening = self.stiffening.shortening(surfaces, self.n_frame_rows, self.n_port)

        self.kind = kind
        self._columns_taken = 0  # a number for each set of columns, never used twice
        self._undeformed_columns()
        if not self.shared_columns:
            d = field.dim
            inertia = np.atleast_2d(field.inertia)
            self.mean_rates = np.vstack(
                (field.Q[:, :d].T / field.mass_total, np.linalg.solve(inertia, field.Q[:, d:].T))
            )

    def add_trace(self, B: Any, surface: str) -> slice:
        """As of any field; forces of the tie stiffen the body as others on its surface do."""
        ports = super().add_trace(B, surface)
        if self.shortening is not None and self.stiffening is not None:
            more = self.stiffening.of_trace(B, surface, self.shortening.N.shape[1])
            self.shortening = replace(self.shortening, N=np.concatenate((self.shortening.N, more)))
        return ports

    def _undeformed_columns(self) -> None:
        """Inertia of the frame about the body as it was meshed."""
        self.shared_columns = isinstance(self.kind, MeanAxis)
        self.inertia_columns = self.field.Q
        self.moment, self.inertia = np.zeros(self.field.dim), self.field.inertia
        self.shown: Bent | None = None
        self.heavier = None
        self.second_inertia: Array = np.zeros((self.motions.n_twist,) * 2)  # (3) of second_order, body axes

    def frame_lengths(self, length: float) -> Array:
        """What turns the values of the frame conditions into lengths (m): their values where the body is displaced by 1 m, or its
        far points are by a turn; they go with its mass, or with its inertia over the model's length.
        """
        d = self.field.dim
        turned = self._rigid[:, d:] / length

        size = np.maximum(self._rigid[:, :d].max(axis=1), turned.max(axis=1))
        return 1.0 / np.where(size > 0, size, 1.0)

    # -- mechanics ----------------------------------------------------------------------------------------------
    def force(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """Rows of (2): the frame's (n_twist,), world translation and body rotation, and the field's (n d,); collective."""
        d = self.field.dim
        R = motion.R
        accel = motion.accel
        assert accel is not None
        U, Ud, Udd = (x.reshape(-1, d) for x in local)
        P = self.field.X + U
        w = motion.twist[d:]
        a = R.T @ (accel[:d] - motion.gravity)
        spin = spin_matrix(w)

        # (1), nodal accelerations in body axes
        A = P @ (spin_matrix(accel[d:]) + spin @ spin).T
        A += Ud @ (2.0 * spin.T)
        A += Udd
        A += a
        F = self.field.mass(A)

        # (2), rows of the frame; the square of U is summed along
        sums = self.field.total(np.concatenate((F.sum(0), axial(P.T @ F), [float(local[0] @ local[0])])))
        self._watch(sums[-1])
        held, rows = self.held_force(motion, local)
        sums = sums[:-1] + held
        rows += F.ravel()

        # stress of the inertia forces and of loads
        if self.stiffening is not None:
            more, stress = self._stiffened(self.stiffening, motion, local)
            sums += more
            rows += stress
        sums[:d] = R @ sums[:d]
        return sums, rows

    def held_force(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """Rows of (2) without inertia, weight and what stiffens, in body axes: loads, elasticity, damping; collective."""
        field, (U, Ud, _), sums = self.field, local, np.zeros(self.motions.n_twist)
        rows = self.internal(U, Ud)
        if field.loads.loads:
            outer, inner = field.loads.nodal(motion.t, motion.R, U)
            moment = axial(field.points(U).T @ outer) - self._shifted(motion.t, U)
            sums -= field.total(np.concatenate((outer.sum(0), moment)))
            rows -= (outer + inner).ravel()
        if field.D is not None:
            rows += field.damping(Ud)
        if field.forms.mass_damping:
            rows += field.forms.mass_damping * field.mass(Ud.reshape(-1, field.dim)).ravel()
        return sums, rows

    def _shifted(self, t: float, U: Array) -> Array:
        """Moment (n_rot,) of carried loads by displacements, which :mod:`...fem.loads` leaves out; this rank's share."""
        return axial(U.reshape(-1, self.field.dim).T @ self.field.loads.carried(t))

    def _stiffened(
        self, stiffening: Stiffening, motion: FrameMotion, local: tuple[Array, Array, Array]
    ) -> tuple[Array, Array]:
        """Rows of the frame (body axes) and of the field by (4) of :mod:`.second_order` and the stress of loads."""
        bent, x, load = self._straining(stiffening, motion, local)
        d = self.field.dim
        x.frame[d:] -= stiffening.load_moment(load, bent, local[0])
        frame, turned = stiffening.turned.rows(motion.t, local[0])
        return x.frame - frame, bent @ load + stiffening.first @ np.concatenate((x.a, x.L.T.ravel())) - turned

    def _straining(
        self, stiffening: Stiffening, motion: FrameMotion, local: tuple[Array, ...]
    ) -> tuple[Array, Acting, Array]:
        """:meth:`.Stiffening.bent`, the second-order inertia, and :meth:`.Stiffening.coefficients` of the mean accelerations
        and of the loads, whose stress stiffens the body.
        """
        assert motion.accel is not None
        d, R = self.field.dim, motion.R
        bent = stiffening.bent(local[0])
        twist, accel = (np.concatenate((R.T @ x[:d], x[d:])) for x in (motion.twist, motion.accel))
        x = stiffening.second.acting(stiffening.moments(bent, local), twist, accel, R.T @ motion.gravity)
        return bent, x, stiffening.coefficients(x.stress, motion.t, R)

    def _watch(self, square: float) -> None:
        """Refuse displacements of the size of the body. Linear bodies only."""
        f = self.field
        if f.nonlinear:
            return
        # root mean square of the displacements
        mean = np.sqrt(square * f.dim / f.n_global)
        if not mean <= TOO_LARGE * f.size:
            raise ConvergenceError(too_large(self.name, mean, f.size, self.stiffening is not None))

    def internal(self, U: Array, Ud: Array) -> Array:
        """f_int(U) + beta K_0 U', (n d,)."""
        beta = self.field.forms.stiffness_damping
        if not self.field.nonlinear:
            return self.field.stiffness(U + beta * Ud if beta else U)
        f = self.field.internal(U)
        return f + beta * self.field.stiffness_at_rest(Ud) if beta else f

    def port_columns(self, used: np.ndarray, t: float) -> Array:
        """Columns (n d, count) of port forces, of the body as it was bent where its tangent was taken."""
        columns = super().port_columns(used, t)
        return columns if self.shown is None else columns - self.shown.slopes @ self.shown.N[used].T

    def column_version(self, t: float) -> int:
        """Number of times that the columns of inertia were taken anew."""
        return self._columns_taken

    @property
    def stiffens(self) -> bool:
        """Whether it has geometric stiffening."""
        return self.stiffening is not None

    @property
    def renewable(self) -> bool:
        """Always: columns of inertia are taken anew."""
        return True

    @property
    def keeps_tangents(self) -> bool:
        """Where new ones take a factor: of a constant stiffness columns of inertia alone are taken anew."""
        return self.field.nonlinear or self.stiffening is not None

    def relinearise(
        self, motion: FrameMotion, local: tuple[Array, Array, Array], increment: Approach | None = None
    ) -> bool:
        """Take tangent and inertia at displacements; collective.

        The columns of the frame's inertia M (e x P), frozen at P = X before, follow the deformed body: an attached frame
        with large displacements needs them. They cost a few back-solves, no factor.
        """
        if increment is not None and increment.predicted:  # node by node, without what holds them together
            local = (local[0] - increment.moved, *local[1:])
        load = np.zeros(0) if self.stiffening is None else self._straining(self.stiffening, motion, local)[2]
        self._take_tangent(TangentPoint(motion.t, local[0].copy(), np.zeros(self.n), (load, motion.pull), None))
        return True

    def _take_tangent(self, at: TangentPoint) -> None:
        f = self.field
        m = self.motions
        d = f.dim
        if self.stiffening is not None:
            f.linearise(None, *self.stiffening.tangent_forms(at.t, *at.load))
        elif f.nonlinear:
            f.linearise(at.U)

        # inertia of the frame about the deformed body: columns M (e x P), their sums and moments
        P = f.points(at.U)
        Q = f.Q.reshape(f.n, d, m.n_twist).copy()
        J = np.empty((m.n_rot, m.n_rot))
        for k in range(m.n_rot):
            Q[:, :, d + k] = f.mass(m.spin(np.eye(m.n_rot)[k : k + 1], P))
            J[:, k] = m.moment(P, Q[:, :, d + k]).sum(0)

        self.inertia = f.total(J)
        self.moment = f.total(f.mass(P).sum(0))
        if self.stiffening is not None:
            bent = self.stiffening.bent(at.U)
            k = d + d * d
            A_u, B_u = f.Q.T, turning(bent[:, :k], d)
            second, moments = self.stiffening.second, self.stiffening.moments(bent, (at.U,))
            self.second_inertia, more = second.mass_blocks(moments, A_u, B_u)
            Q += more.reshape(Q.shape)
            self.heavier = second.own_mass(A_u, B_u)
        self.inertia_columns = Q.reshape(self.n, m.n_twist)

        # what the frame conditions and the ports take from it
        self.shared_columns = False
        self.shown = None if self.shortening is None else self.shortening.at(at.U)
        self._columns_taken += 1
        self._tangent_at = at

    def _first_tangent(self) -> None:
        if self.field.nonlinear or self.stiffening is not None:
            self.field.linearise(None)
        self._undeformed_columns()
        self._columns_taken += 1

    def mass_blocks(self, motion: FrameMotion, u: Array) -> tuple[Array, Array, Array]:
        """Mass block of the frame with the columns in use; the field's own blocks stay with its factor."""
        d, n = self.field.dim, self.motions.n_twist
        M = np.zeros((n, n))
        M[range(d), range(d)] = self.field.mass_total
        M[d:, d:] = self.inertia
        if self._tangent_at is not None:
            # the static moment of the body as it is bent now
            c = self.moment[None]
            turn = np.eye(n - d)
            for k in range(n - d):
                M[:d, d + k] = motion.R @ self.motions.spin(turn[k : k + 1], c)[0]
            M[d:, :d] = M[:d, d:].T
            if self.stiffening is not None:
                turn = np.eye(n)
                turn[:d, :d] = motion.R
                M += turn @ self.second_inertia @ turn.T
        return M, np.zeros((0, n)), np.zeros((0, 0))

    def missing_momentum(self, u: Array) -> Array | None:
        """Rows (n_rot, n d) of sum M U x where the columns of inertia are those of P = X; collective."""
        if not self.shared_columns:
            return None
        m = self.motions
        return m.lever(self.field.mass(u.reshape(-1, m.dim))).reshape(-1, m.n_rot).T

    def _velocity(self, motion: FrameMotion, local: tuple[Array, Array]) -> tuple[Array, Array, Array]:
        """Points P, nodal velocities W in body axes and M W."""
        d = self.field.dim
        P = self.field.points(local[0])
        carried = motion.R.T @ motion.twist[:d] + self.motions.spin(motion.twist[None, d:], P)
        W = carried + local[1].reshape(-1, d)
        return P, W, self.field.mass(W)

    def energies(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[float, float, float]:
        """Kinetic, elastic and weight energy, J; collective."""
        d, U = self.field.dim, local[0]
        P, W, MW = self._velocity(motion, local)
        kinetic = 0.5 * float((W * MW).sum())
        sums = self.field.total(np.concatenate(([kinetic], self.field.mass(P).sum(0))))

        # mass times the place of the mass centre
        if self.stiffening is not None:
            moments = self.stiffening.moments(self.stiffening.bent(U), local)
            sums[0] += self._second_momentum(self.stiffening, moments, motion)[1]
            sums[1:] += moments.m[0]
        center = self.field.mass_total * pose[:d] + motion.R @ sums[1:]
        weight = -float(motion.gravity @ center)
        return float(sums[0]), self.field.energy(U), weight

    def _second_momentum(
        self, stiffening: Stiffening, moments: DisplacementMoments, motion: FrameMotion
    ) -> tuple[Array, float]:
        """Momentum (n_twist,) in body axes and energy of the second-order displacements."""
        d = self.field.dim
        twist = np.concatenate((motion.R.T @ motion.twist[:d], motion.twist[d:]))
        return stiffening.second.momentum(moments, twist)

    def given(self, motion: FrameMotion, local: tuple[Array, Array]) -> dict[str, float] | None:
        """Power (W) of loads and of material damping; collective."""
        f, (U, Ud) = self.field, local
        found = {}
        if f.loads.loads:
            outer, inner = f.loads.nodal(motion.t, motion.R, U)
            W = self._velocity(motion, local)[1]
            shifted = self._shifted(motion.t, U) @ motion.twist[f.dim :]
            found["loads"] = float((outer * W).sum() + inner.ravel() @ Ud - shifted)
        if self.damped:
            found["damping"] = -float(Ud @ self._damping(Ud))

        out = self.summed(found)
        if f.loads.loads and self.stiffening is not None:
            # loads work on the second-order displacements, too
            d = f.dim
            load, bent = self.stiffening.coefficients(np.zeros(d + d * d), motion.t, motion.R), self.stiffening.bent(U)
            out["loads"] += float(self.stiffening.load_moment(load, bent, U) @ motion.twist[d:])
            frame, turned = self.stiffening.turned.rows(motion.t, U)
            out["loads"] += float(frame[:d] @ (motion.R.T @ motion.twist[:d]) + frame[d:] @ motion.twist[d:])
            out["loads"] += float(f.total(np.array(Ud @ (turned - bent @ load))))
        return out

    def _damping(self, Ud: Array) -> Array:
        """Nodal forces of Rayleigh and Kelvin-Voigt damping, (n d,); collective."""
        f = self.field
        out = f.forms.mass_damping * f.mass(Ud.reshape(-1, f.dim)).ravel()
        if f.forms.stiffness_damping:
            out += f.forms.stiffness_damping * f.stiffness_at_rest(Ud)
        return out if f.D is None else out + f.damping(Ud)

    def momenta(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[Array, Array]:
        """Linear and angular momentum about the world origin, world axes; collective."""
        m, d = self.motions, self.field.dim
        P, _, MW = self._velocity(motion, local)
        sums = self.field.total(np.concatenate((MW.sum(0), m.moment(P, MW).sum(0))))
        if self.stiffening is not None:
            moments = self.stiffening.moments(self.stiffening.bent(local[0]), local)
            sums += self._second_momentum(self.stiffening, moments, motion)[0]
        p = motion.R @ sums[:d]
        return p, m.moment(pose[:d], p) + m.turn(motion.R, sums[d:])


def moment_columns(field: Field, surface: str) -> Array:
    """Columns (n d, (1 + d) d) of the moments b_0, b_k of a surface as functions of the nodal displacements."""
    moments, d = field.moments(surface), field.dim

    C = np.zeros((field.n, d, 1 + d, d))
    C[moments.nodes[:, None], range(d), :, range(d)] = moments.weights[:, None, :]
    return C.reshape(-1, (1 + d) * d)


def frame_conditions(field: Field, frame: MeanAxis | Attached | Chord) -> Array:
    """Columns C (n d, n_twist) of the conditions C^T U = 0 that tie a frame to its body; collective.

    Raises:
        InputError: the body is not free, see :func:`.check_free`.
    """
    check_free(field)
    if isinstance(frame, MeanAxis):
        return field.Q
    if isinstance(frame, Chord):
        return _chord(field, frame)
    return attachment(field, frame.surface)


def attachment(field: Field, surface: str) -> Array:
    """Columns of the linear conditions "the surface does not move in the frame, on average"."""
    m = motions(field.dim)
    d = field.dim
    moments = field.moments(surface)
    C = np.zeros((field.n, d, m.n_twist))
    C[moments.nodes[:, None], range(d), range(d)] = moments.weights[:, :1]

    # rotation as joints see it, int (X - c) x u = 0: the sum of e_k x u_k over the moments of the surface
    for c in range(d):
        turn = m.moment(np.eye(d), np.eye(d)[c])  # (k, n_rot): e_k x e_c
        C[moments.nodes, c, d:] = moments.weights[:, 1:] @ turn
    return C.reshape(-1, m.n_twist) * field.mass_total


def _chord(field: Field, frame: Chord) -> Array:
    """Columns of the conditions of a chord frame: the mean of one surface, the mean of another across the chord, the twist."""
    m, d = motions(field.dim), field.dim
    a, b = field.moments(frame.start), field.moments(frame.end)
    chord = b.center - a.center
    length = float(np.linalg.norm(chord))
    if not length > 1e-6 * field.size:
        raise InputError(
            f'Body "{field.name}": the surfaces of its chord frame, "{frame.start}" and "{frame.end}", coincide.'
        )

    across = np.linalg.svd(chord[None] / length)[2][1:]  # (d - 1, d), perpendicular to the chord
    C = np.zeros((field.n, d, m.n_twist))

    # the first surface stays, the second stays on the line
    C[a.nodes[:, None], range(d), range(d)] = a.weights[:, :1]
    for k, n in enumerate(across):
        C[b.nodes, :, d + k] = b.weights[:, :1] * n
    C = C.reshape(-1, m.n_twist) * field.mass_total

    # no turn about the chord
    if d == 3:
        C[:, 5] = attachment(field, frame.start)[:, 3:] @ (chord / length)
    return C
