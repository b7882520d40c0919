"""Elastic bodies in absolute coordinates: x = X + u, large displacements by the elastic energy itself.

    M (u'' - g) + f_int(u) + D u' + B^T lambda = 0,        f_int = K u  or  dPi/du                              (1)

There is no frame: the mass matrix is constant and inertia has no further terms. With a linear elastic form the matrix is
constant and factored once. With an energy Pi(u) (total Lagrangian) the tangent is taken at one configuration and turned with
the body: its mean rotation T is the polar rotation of sum_n (M x)_n X_n^T, and K(u) = T K_0 T^T up to the strain. Loads on the
deformed surface and a viscous law F S_v(E') : grad v are in the tangent by their derivatives.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from ...errors import require
from ...fem.fields import Field
from ...fem.initial import initial_fields
from ...fem.mean_forces import MeanForces
from ...fem.motion_tangent import MotionTangent
from ...fem.rigid_turns import damping_sees_turns, energy_sees_turns
from ...rotations import Array, axial, rotate_nodal
from ..body import Placed, Site
from ..frames import polar_rotation
from ..placements import Approach, FrameMotion
from .field_part import FieldPart, TangentPoint

# forms for small rotations: what a turn does to them, and what to take
LINEAR = (
    "its linear form is for small rotations, and stretches it by some {strain:.1g} of its size. Take a FloatingBody, or an "
    "energy in place of elastic="
)
SMALL_STRAIN = (
    "its energy is one of small rotations, and takes the turn for a strain of some {strain:.1g}. Write it in C = F.T * F with "
    "F = Identity(d) + grad(u)"
)
BRAKING = (
    "its viscous form is for small rotations, and brakes the turn. Take viscous=fmbd.materials.kelvin_voigt(eta), or a "
    "ViscousForm in sym(F.T * grad(rate)) with F = Identity(d) + grad(u)"
)


def placed_field(body: Any, site: Site) -> Placed:
    """The field of a body in absolute coordinates, with the displacements and velocities of its start; collective."""
    field = site.field(body)
    U, rate = initial_fields(body, field)
    d, twist = field.dim, body.start_twist()
    arm = field.X + U.reshape(-1, d)
    carried = twist[:d] + field.motions.spin(twist[None, d:], arm)
    return Placed(AbsoluteField(field, site.ground, site.surfaces), U, rate + carried.ravel())


def _refuse_frames(field: Field) -> None:
    """Refuse loads that turn with the frame of a body, where there is none."""
    for number, load in enumerate(field.loads.loads):
        require(
            load.deformed is not None or not load.follower,
            f'Load {number} on body "{field.name}" turns with the body\'s frame, and a body in absolute coordinates has none. '
            "Give the Load a form of the deformed body, deformed=lambda u, v, dx, ds: ..., with F = Identity(d) + grad(u); "
            "traction, body_force, pressure and thermal_stress have one.",
        )


class AbsoluteField(FieldPart):
    """A displacement field against the ground; equation (1). ``ground`` is the index of the ground's frame."""

    def __init__(self, field: Field, ground: int, surfaces: list[str]) -> None:
        if field.nonlinear:
            _refuse_frames(field)
        super().__init__(field, ground, surfaces, np.zeros((field.n * field.dim, 0)))
        self.tangent = MotionTangent(field)
        self.origin = np.zeros(field.dim)
        per = field.dim * (1 + field.dim)
        for k in range(len(self.surfaces)):
            self.reference[k * per : k * per + field.dim] += field.center
        self._moment_columns = field.mass(field.X)
        self.turn_at_tangent: Array = np.eye(field.dim)
        if field.loads.moving or field.viscous.law is not None:
            self._first_tangent()

    # -- tangent ------------------------------------------------------------------------------------------------
    def corotation(self, u: Array) -> Array | None:
        """Mean rotation of the body since its tangent was taken, (d, d); None for linear bodies."""
        if not self.field.nonlinear:
            return None
        return self.mean_rotation(u) @ self.turn_at_tangent.T

    @cached_property
    def turns_little(self) -> str:
        """Which of its forms is for small rotations, and what to take; collective."""
        if not self.field.nonlinear:
            return LINEAR
        return SMALL_STRAIN if energy_sees_turns(self.field) else BRAKING if damping_sees_turns(self.field) else ""

    def mean_rotation(self, u: Array) -> Array:
        """Mean rotation of the body at displacements u (n d,), (d, d); collective."""
        d = self.field.dim
        # mean deformation gradient over the mass; the rotation in it
        F = self.field.total((self.field.X + u.reshape(-1, d)).T @ self._moment_columns)
        return polar_rotation(F[None])[0]

    def own_moment(self, u: Array) -> float:
        """The moment of elastic forces on the body as a whole at displacements u (n d,), which strains do not have, over what its
        joints, ties and other forces turn it by: net on surfaces in use, by their size elsewhere. Collective.
        """
        f, d = self.field, self.field.dim
        U, F = u.reshape(-1, d), f.internal(u).reshape(-1, d)
        mean = f.total(f.mass(U).sum(axis=0)) / f.mass_total
        held = self.held
        others = np.ones(len(F), bool)
        others[np.concatenate([np.zeros(0, int), *held])] = False

        nets = [np.ravel(axial((f.X + U - mean).T @ F)), *(np.ravel(axial(f.X[on].T @ F[on])) for on in held)]
        size = np.linalg.norm(f.X[others], axis=1) @ np.linalg.norm(F[others], axis=1)
        *moments, scale = np.split(f.total(np.concatenate((*nets, [size]))), np.cumsum([len(x) for x in nets]))
        own, *acting = (float(np.linalg.norm(x)) for x in (*moments, scale))
        return own / sum(acting) if own else 0.0

    @property
    def renewable(self) -> bool:
        """Whether it takes new tangents."""
        return self.field.nonlinear

    @property
    def keeps_tangents(self) -> bool:
        """Where it takes new ones; those of a stored energy do not wait, as increments by old ones throw such bodies far."""
        return self.renewable and not self.foretells

    @property
    def begins_anew(self) -> bool:
        """Bodies whose pressure follows their volume: its stiffness holds motions that turn with them."""
        return self.field.mixed and self.foretells and not self.field.carried

    @property
    def foretells(self) -> bool:
        """Bodies with a stored energy: see :mod:`fmbd_fenicsx.fem.motion_tangent`."""
        return self.tangent.foretells

    def relinearise(
        self, motion: FrameMotion, local: tuple[Array, Array, Array], increment: Approach | None = None
    ) -> bool:
        """Take the tangent at displacements and rates; collective."""
        if not self.field.nonlinear:
            return False
        U, Ud = (x.copy() for x in local[:2])
        foretold = increment if self.foretells else None
        pressure, moved = self._pressure_of_tangent(U, foretold), None if foretold is None else foretold.moved
        self._take_tangent(TangentPoint(motion.t, U, Ud, None, pressure, moved))
        return True

    def _pressure_of_tangent(self, U: Array, increment: Approach | None) -> Array | None:
        """The pressure that a tangent is taken with, where it is not that of the displacements; collective."""
        field: Any = self.field
        if field.carried:
            return field.pressure_values  # type: ignore[no-any-return]
        if increment is None or not field.mixed:
            return None
        before = U - increment.moved
        turned = None if increment.predicted else rotate_nodal(increment.moved, self.corotation(before), back=True)
        return field.foretold_pressure(before, turned)  # type: ignore[no-any-return]

    def _take_tangent(self, at: TangentPoint) -> None:
        self.turn_at_tangent = self.mean_rotation(at.U)
        if self.field.rest_damping is not None:
            self.field.rest_damping.turn(self.turn_at_tangent)
        with self.field.holding(at.pressure):
            self.tangent.take(at.t, at.U, at.Ud, at.increment)
        self._tangent_at = at

    def _first_tangent(self) -> None:
        self.turn_at_tangent = np.eye(self.field.dim)
        if self.field.rest_damping is not None:
            self.field.rest_damping.turn(self.turn_at_tangent)
        self.tangent.take(0.0, np.zeros(self.n), np.zeros(self.n))

    # -- mechanics ----------------------------------------------------------------------------------------------
    def force(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """Rows of (1); those of the ground are zero. Collective."""
        U, Ud, Udd = local
        inertia = self.field.mass(Udd.reshape(-1, self.field.dim) - motion.gravity).ravel()
        return np.zeros(self.motions.n_twist), inertia + self.held_force(motion.t, U, Ud)

    def held_force(self, t: float, U: Array, Ud: Array) -> Array:
        """Rows of (1) without inertia and weight at a time (s), (n d,); collective."""
        d, forms = self.field.dim, self.field.forms
        rows = self.field.internal(U)

        # damping, then loads
        if forms.mass_damping:
            rows += forms.mass_damping * self.field.mass(Ud.reshape(-1, d)).ravel()
        if forms.stiffness_damping:
            rows += forms.stiffness_damping * self._turned_stiffness(U, Ud)
        if self.field.D is not None:
            rows += self.field.viscous.force(U, Ud)
        if self.field.loads.loads:
            outer, inner = self.field.loads.nodal(t, np.eye(d), U)
            rows -= (outer + inner).ravel()
        return rows

    def moved_rigidly(self, U0: Array, V0: Array, h: float) -> Array:
        """Displacements (n d,) of the body moved on rigidly for h (s): with its mean velocity, and turned by its mean angular
        velocity; collective.
        """
        f = self.field
        d, m = f.dim, f.motions
        x = f.points(U0)
        mass_x = f.mass(x)
        V = V0.reshape(-1, d)

        # mass centre, momentum and angular momentum about the origin
        center = f.total(mass_x.sum(0)) / f.mass_total
        speed = f.total(f.mass(V).sum(0))
        spin = f.total(m.moment(x, f.mass(V)).sum(0))
        mean = speed / f.mass_total

        # inertia of the deformed body about its mass centre, and the angular velocity of its angular momentum
        arm = x - center
        inertia = np.empty((m.n_rot, m.n_rot))
        for k in range(m.n_rot):
            unit = np.eye(m.n_rot)[k : k + 1]
            inertia[:, k] = m.moment(arm, f.mass(m.spin(unit, arm))).sum(0)
        w = np.linalg.solve(f.total(inertia), spin - m.moment(center, speed))

        turn = m.matrix(m.compose(m.identity[None], np.concatenate((np.zeros(d), h * w))[None]))[0]
        return np.asarray(U0 + (arm @ turn.T - arm + h * mean).ravel())

    @cached_property
    def mean_forces(self) -> MeanForces:
        """Forces over a step as difference quotients, compiled at first use; collective."""
        return MeanForces(self.field)

    def mean_force(self, motion: FrameMotion, local: tuple[Array, Array, Array], h: float) -> Array:
        """Rows of (1) over a step of size h (s) about the time of ``motion``: ``local`` are displacements where it begins, mean
        rates and mean accelerations, and forces difference quotients. Collective.
        """
        (U, rate, accel), f = local, self.field
        self.mean_forces.place(motion.t - 0.5 * h, (U, U + h * rate), h)
        rows = f.mass(accel.reshape(-1, f.dim) - motion.gravity).ravel() + self.mean_forces.force()
        if f.loads.loads:
            outer, inner = f.loads.constant(motion.t, np.eye(f.dim))
            rows -= (outer + inner).ravel()
        return rows

    def _turned_stiffness(self, U: Array, Ud: Array) -> Array:
        """R K_0 R^T u', R the mean rotation of the body: damping by the stiffness without stress leaves rigid motion alone and
        never gives energy. It depends on the state only; Newton's matrix has the R of its tangent.
        """
        if not self.field.nonlinear:
            return self.field.stiffness(Ud)
        d = self.field.dim
        # into the axes of the body, and back
        R = self.mean_rotation(U)
        return (self.field.stiffness_at_rest((Ud.reshape(-1, d) @ R).ravel()).reshape(-1, d) @ R.T).ravel()

    def given(self, motion: FrameMotion, local: tuple[Array, Array]) -> dict[str, float] | None:
        """Power (W) of loads and of material damping; collective."""
        f, (U, Ud) = self.field, local
        found = {}
        if f.loads.loads:
            outer, inner = f.loads.nodal(motion.t, np.eye(f.dim), U)
            found["loads"] = float((outer + inner).ravel() @ Ud)

        if self.damped:
            damping = f.forms.mass_damping * f.mass(Ud.reshape(-1, f.dim)).ravel()
            if f.forms.stiffness_damping:
                damping += f.forms.stiffness_damping * self._turned_stiffness(U, Ud)
            if f.D is not None:
                damping += f.viscous.force(U, Ud)
            found["damping"] = -float(Ud @ damping)
        return self.summed(found)

    def energies(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[float, float, float]:
        """Kinetic, elastic and weight energy, J; collective."""
        f, (U, Ud) = self.field, local
        W = Ud.reshape(-1, f.dim)
        x = f.X_world + U.reshape(-1, f.dim)

        # this rank's share of the kinetic energy, and of the mass times its centre
        kinetic = 0.5 * float((W * f.mass(W)).sum())
        center = f.mass(x).sum(0)
        sums = f.total(np.concatenate(([kinetic], center)))
        return float(sums[0]), f.energy(U), -float(motion.gravity @ sums[1:])

    def momenta(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[Array, Array]:
        """Linear and angular momentum about the world origin, world axes; collective."""
        m, d = self.motions, self.field.dim
        x = self.field.X_world + local[0].reshape(-1, d)
        MW = self.field.mass(local[1].reshape(-1, d))
        sums = self.field.total(np.concatenate((MW.sum(0), m.moment(x, MW).sum(0))))
        return sums[:d], sums[d:]
