"""Bodies whose equations the package does not know: a mass on a spring inside a rigid body, and a line by its own form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from test_line_body import line

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.mechanics.placements import Part


@dataclass(frozen=True, eq=False)
class Carrier(fmbd.RigidBody):
    """A rigid body with a mass m on a spring k and a damper d, at r + R (c + u e)."""

    slide: tuple[float, ...] = (0.6, 0.8, 0.0)
    m: float = 0.7
    k: float = 40.0
    d: float = 0.3

    def part(self, frame: int) -> Any:
        return SlidingMass(self, frame)

    def start_local(self) -> Any:
        return np.array([0.05]), np.array([-0.2])


class SlidingMass(Part):
    """u, along e in the axes of the body."""

    def __init__(self, body: Carrier, frame: int) -> None:
        self.name, self.frame, self.n, self.n_port = body.name, frame, 1, 0
        self.reference, self.port_matrix = np.zeros(0), np.zeros((0, 1))
        self.dim = len(body.position)
        self.e = np.asarray(body.slide)[: self.dim]
        self.c = np.array([0.1, -0.2, 0.15])[: self.dim]
        self.m, self.k, self.d = body.m, body.k, body.d

    def _arm(self, u: Any) -> Any:
        return self.c + u[0] * self.e

    def _cross(self, w: Any, x: Any) -> Any:
        """w x x in body axes."""
        return np.cross(w, x) if self.dim == 3 else w[0] * np.array([-x[1], x[0]])

    def _moment(self, x: Any, f: Any) -> Any:
        return np.cross(x, f) if self.dim == 3 else np.array([x[0] * f[1] - x[1] * f[0]])

    def force(self, motion: Any, local: Any) -> Any:
        u, rate, second = local
        d, p, w = self.dim, self._arm(u), motion.twist[self.dim :]
        relative = self._cross(motion.accel[d:], p) + self._cross(w, self._cross(w, p))
        relative = relative + 2 * rate[0] * self._cross(w, self.e) + second[0] * self.e
        f = self.m * (motion.R @ relative + motion.accel[:d] - motion.gravity)
        inner = motion.R.T @ f
        along = self.e @ inner + self.k * u[0] + self.d * rate[0]
        return np.concatenate((f, self._moment(p, inner))), np.array([along])

    def mass_blocks(self, motion: Any, u: Any) -> Any:
        d, p = self.dim, self._arm(u)
        turns = np.eye(3) if d == 3 else np.ones((1, 1))
        by_turn = np.stack([self._cross(w, p) for w in turns], axis=1)
        rates = np.concatenate((np.eye(d), motion.R @ by_turn), axis=1)  # x' of the mass by the twist
        along = motion.R @ self.e
        return self.m * rates.T @ rates, self.m * (along @ rates)[None], np.array([[self.m]])

    def stiffness_blocks(self, motion: Any, local: Any) -> Any:
        return np.array([[self.k]]), np.array([[self.d]])

    def energies(self, motion: Any, pose: Any, local: Any) -> Any:
        u, rate = local[0], local[1]
        d, p = self.dim, self._arm(u)
        v = motion.twist[:d] + motion.R @ (self._cross(motion.twist[d:], p) + rate[0] * self.e)
        place = pose[:d] + motion.R @ p
        weight = -self.m * motion.gravity @ place
        return 0.5 * self.m * v @ v, 0.5 * self.k * u[0] ** 2, weight

    def momenta(self, motion: Any, pose: Any, local: Any) -> Any:
        d, p = self.dim, self._arm(local[0])
        v = motion.twist[:d] + motion.R @ (self._cross(motion.twist[d:], p) + local[1][0] * self.e)
        return self.m * v, np.atleast_1d(np.cross(pose[:d] + motion.R @ p, self.m * v))

    def given(self, motion: Any, local: Any) -> Any:
        return {"damping": -self.d * local[1][0] ** 2}


def carrier(dim: int) -> fmbd.Scene:
    """Such a body on a hinge, with a bob on a spring."""
    inertia = (0.02, 0.05, 0.04) if dim == 3 else 0.03
    scene = fmbd.Scene("carrier", gravity=(0.0, -9.81, 0.0)[:dim])
    moving = {"velocity": (0.2, -0.55, -0.6), "angular_velocity": (1.0, 2.0, -1.5)}
    if dim == 2:
        moving = {"velocity": (0.0, 0.6), "angular_velocity": 2.0}
    body = Carrier("carrier", 1.5, inertia, (0.3, 0.0, 0.1)[:dim], **moving)
    bob = fmbd.RigidBody("bob", 0.4, inertia, (0.9, -0.1, 0.1)[:dim])
    scene.add(body, bob, fmbd.spherical("hang", fmbd.ground, body, center=np.zeros(dim)))
    scene.add(
        fmbd.Spring("spring", body, bob, (0.5, 0.0, 0.0)[:dim], (0.9, -0.1, 0.1)[:dim], stiffness=30.0, damping=0.5)
    )
    scene.sensor("place", fmbd.position(bob)), scene.sensor("hang", fmbd.reaction("hang"))
    return scene


def line_and_bob() -> fmbd.Scene:
    """A line on a hinge, a bob at its end that is held off the end's centre, and a spring in that joint."""
    beam = line(cells=3, mass_damping=0.4, start_rate=lambda s: [0 * s, s, 1 + 0 * s])
    bob = fmbd.RigidBody("bob", 0.3, 0.01, (2.1, 0.2))
    scene = fmbd.Scene("line and bob", gravity=(0.0, -9.81))
    scene.add(beam, bob, fmbd.revolute("hinge", fmbd.ground, beam.surface("start"), center=(0.0, 0.0)))
    knee = fmbd.revolute("knee", beam.surface("end"), bob, center=(2.05, 0.1))
    scene.add(knee, fmbd.joint_spring("bend", fmbd.angle(knee), stiffness=3.0, damping=0.1))
    scene.sensor("place", fmbd.position(bob)), scene.sensor("hang", fmbd.reaction("hinge"))
    return scene
