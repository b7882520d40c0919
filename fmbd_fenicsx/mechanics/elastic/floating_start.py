"""The start of a body in a floating frame: initial displacements and rates, with their rigid part given to the frame.

The material points and velocities of the start, x = X + u and x' = v_0 + w_0 x x + u', are what the user says. The frame (r, R)
is the one in which the displacements satisfy its conditions,

    C^T U = 0,   U = R^T (x - r) - X,        C^T U' = 0,   U' = R^T x' - R^T r' - w x (X + U)                 (1)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import require
from ...fem.initial import initial_fields
from ...rotations import Array
from ..body import Placed, Site
from .modes import rigid_fields


@dataclass(frozen=True)
class FramedStart:
    """Pose (n_pose,) and twist (n_twist,) of the frame, nodal displacements and rates in its axes, (n d,)."""

    pose: Array
    twist: Array
    U: Array
    Ud: Array


def placed_field(body: Any, site: Site) -> Placed:
    """The field of a body in its floating frame, with the start of both; collective."""
    from .floating import FloatingField

    field = site.field(body)
    require(
        not field.carried,
        f'Body "{body.name}": an energy whose pressure is an unknown needs an AbsoluteBody. In a floating frame use '
        "neo_hookean_mixed, or nearly_incompressible as elastic.",
    )
    part = FloatingField(field, site.frame, site.surfaces, body.frame, body.held_at)
    start = framed_start(body, field, part.conditions)
    return Placed(part, start.U, start.Ud, start.pose, start.twist)


def framed_start(body: Any, field: Any, conditions: Array) -> FramedStart:
    """Solve (1) for a floating body; collective. Bodies that start undeformed keep their twist to the last bit."""
    m, d = field.motions, field.dim
    pose = m.pose(field.center)
    twist = body.start_twist()
    U, Ud = initial_fields(body, field)
    if body.displacement is None and body.displacement_rate is None:
        return FramedStart(pose, twist, U, Ud)

    # points and velocities that the user gave
    x = field.X + U.reshape(-1, d)
    V = twist[:d] + m.spin(twist[None, d:], x) + Ud.reshape(-1, d)
    Z = rigid_fields(field)
    CZ = field.total(conditions.T @ Z)
    R: Array = np.eye(d)

    # Newton for the pose of (1)
    for _ in range(20):
        R = m.matrix(pose)
        U = ((x + field.center - pose[:d]) @ R - field.X).ravel()
        step = np.linalg.solve(CZ, field.total(conditions.T @ U))
        if np.abs(step).max() < 1e-15 * field.size:
            break
        step[:d] = R @ step[:d]
        pose = m.compose(pose, step)

    # and its twist
    Z = m.rigid(field.points(U)).reshape(-1, m.n_twist)
    rigid = np.linalg.solve(field.total(conditions.T @ Z), field.total(conditions.T @ (V @ R).ravel()))

    Ud = (V @ R).ravel() - Z @ rigid
    return FramedStart(pose, np.concatenate((R @ rigid[:d], rigid[d:])), U, Ud)
