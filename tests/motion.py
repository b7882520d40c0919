"""Smooth motions of a system for finite-difference tests, and small scenes to move.

Along q(s) = q o exp(s v + s^2/2 a) the velocity at s = 0 is v and its rate is a, so that derivatives with respect to
s at 0 are the time derivatives of any motion with these.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.ranks import world_rank
from fmbd_fenicsx.rotations import Array, tangent
from fmbd_fenicsx.system.evaluation import Evaluation
from fmbd_fenicsx.system.system import System


def first(function: Callable[[float], Any], h: float = 1e-3) -> Array:
    """d/ds at 0, fourth-order central difference."""
    f = [np.asarray(function(k * h), dtype=float) for k in (-2, -1, 1, 2)]
    return np.asarray((f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * h))


def second(function: Callable[[float], Any], h: float = 4e-3) -> Array:
    """d^2/ds^2 at 0, sixth-order central difference."""
    f = [np.asarray(function(k * h), dtype=float) for k in range(-3, 4)]
    w = [2, -27, 270, -490, 270, -27, 2]
    return np.asarray(sum(c * x for c, x in zip(w, f, strict=True)) / (180 * h * h))


class Motion:
    """The motion above through a random configuration of a scene's system (fixed seed)."""

    def __init__(self, scene: fmbd.Scene, seed: int = 1, size: float = 0.3, deform: float = 0.05) -> None:
        self.system, state, _ = scene.build()
        self.t = 0.7
        self.core = np.random.default_rng(seed)
        self.field = np.random.default_rng([seed, world_rank()])
        self.q = self.system.compose(state.q, self.random(size, deform))
        self.v = self.random(1.0, deform)
        self.a = self.random(1.0, deform)

    def random(self, core: float, field: float) -> Array:
        """A random array like v, equal on all ranks in the core."""
        n = self.system.n_core
        return np.concatenate(
            (core * self.core.standard_normal(n), field * self.field.standard_normal(self.system.n_v - n))
        )

    def increment(self, s: float) -> tuple[Array, Array]:
        """Local coordinates and their rate."""
        return s * self.v + 0.5 * s * s * self.a, self.v + s * self.a

    def at(self, s: float) -> Evaluation:
        """The system at the instant s of the motion."""
        xi, rate = self.increment(s)
        return self.system.at(self.t + s, self.system.compose(self.q, xi), quasi_velocity(self.system, xi, rate))

    def direction(self) -> Array:
        """A random virtual displacement."""
        return self.random(1.0, 1.0)


def quasi_velocity(system: System, xi: Array, rate: Array) -> Array:
    """Velocity (angular ones in body axes) of local coordinates xi with rate xi': the inverse of
    System.rate.
    """
    if system.motions.dim == 2:
        return rate
    k = system.n_frames * 6
    x, w = xi[:k].reshape(-1, 6), rate[:k].reshape(-1, 6).copy()
    w[:, 3:] = (tangent(x[:, 3:]) @ w[:, 3:, None])[..., 0]
    return np.concatenate((w.ravel(), rate[k:]))


def plane_scene(gravity: Any = (0.5, -9.81)) -> tuple[fmbd.Scene, fmbd.RigidBody, fmbd.RigidBody]:
    """Two rigid bodies of the plane."""
    one = fmbd.RigidBody("one", 2.0, 0.3, position=(0.4, 0.1), rotation=0.3)
    two = fmbd.RigidBody("two", 0.7, 0.2, position=(1.1, -0.2), rotation=-0.4)
    scene = fmbd.Scene("plane", gravity=gravity)
    scene.add(one, two)
    return scene, one, two


def space_scene(gravity: Any = (0.5, 2.0, -9.81)) -> tuple[fmbd.Scene, fmbd.RigidBody, fmbd.RigidBody]:
    """Two rigid bodies of space, turned."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec([[0.2, -0.5, 0.4], [-0.3, 0.1, 0.7]]).as_quat()
    one = fmbd.RigidBody("one", 2.0, (0.3, 0.4, 0.5), position=(0.4, 0.1, -0.2), rotation=turn[0])
    J = np.array([[0.3, 0.02, -0.01], [0.02, 0.25, 0.03], [-0.01, 0.03, 0.2]])
    two = fmbd.RigidBody("two", 0.7, J, position=(1.1, -0.2, 0.3), rotation=turn[1])
    scene = fmbd.Scene("space", gravity=gravity)
    scene.add(one, two)
    return scene, one, two


def elastic_rod(mesh: Any, **options: Any) -> fmbd.FloatingBody:
    """A soft rod (E = 5 MPa, nu = 0.3, 1000 kg/m^3)."""
    options.setdefault("elastic", fmbd.materials.linear_elastic(5e6, 0.3))
    options.setdefault("density", 1000.0)
    return fmbd.FloatingBody("rod", mesh, **options)


def elastic_scene(
    mesh: Any, gravity: bool = True, **options: Any
) -> tuple[fmbd.Scene, fmbd.FloatingBody, fmbd.RigidBody]:
    """An elastic rod and a rigid body beside it."""
    return beside(elastic_rod(mesh, **options), gravity, mesh.dim)


def beside(rod: Any, gravity: bool, d: int) -> tuple[fmbd.Scene, Any, fmbd.RigidBody]:
    """A rod and a rigid body beside it."""
    block = fmbd.RigidBody("block", 0.9, 0.2 if d == 2 else (0.2, 0.3, 0.25), position=(1.2, 0.1, 0.3)[:d])
    scene = fmbd.Scene("elastic", gravity=(0.5, -9.81, 2.0)[:d] if gravity else None)
    scene.add(rod, block)
    return scene, rod, block
