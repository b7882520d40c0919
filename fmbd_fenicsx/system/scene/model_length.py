"""The characteristic length of a model, by which gaps and places of its constraints are judged."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...mechanics.bodies.bodies import RigidBody
from ...mechanics.joints.joints import ground
from ...rotations import Array

if TYPE_CHECKING:
    from .scene import Scene


def model_length(scene: Scene, places: Sequence[Array], sizes: Sequence[float]) -> float:
    """How far a model spreads, m: by the ``places`` (d,) of its bodies and its joints, and the ``sizes`` of parts (m); that of
    bodies in one place otherwise.
    """
    points = list(places)
    for joint in scene.joints.values():
        points += [x for x in (joint.center_a, joint.center_b) if x is not None]
    if not points:
        points = [np.zeros(scene.dim)]

    spread = float(np.linalg.norm(np.ptp(np.array(points), axis=0)))
    return max([spread, *sizes]) or _length_about(scene, points[0])


def _length_about(scene: Scene, place: Array) -> float:
    """That of bodies in one place: how far away forces act or contact points spread, or else a radius of gyration."""
    from ...mechanics.contact.contact import RigidPoints

    d, sizes = len(place), [0.0]
    for force in scene.forces.values():
        given = (force.a, force.point_a), (force.b, force.point_b)
        ends = [np.asarray(x, dtype=float) for _, x in given if x is not None]
        between = not force.joined and force.coordinate is None
        if between and any(side is ground and x is None for side, x in given):
            ends.append(np.zeros(d))  # the ground's own, where no point of it is given
        sizes += [float(np.linalg.norm(x[:d] - place)) for x in ends]

    for c in scene.contacts.values():
        if isinstance(c.slave, RigidPoints):
            spread = np.ptp(c.slave.points, axis=0)
            sizes.append(float(np.linalg.norm(spread)) + 2 * c.slave.radius)

    radii = [0.0]
    for body in scene.bodies.values():
        if isinstance(body, RigidBody) and body.turns and body.mass > 0.0:
            radii.append(float(np.sqrt(np.abs(body.inertia).max() / body.mass)))
    return max(sizes) or max(radii) or 1.0  # 1 m where nothing has a size
