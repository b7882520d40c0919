"""Bodies without an attitude: what holds it, and what is refused because it would turn them. Part of building a system."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...mechanics.forces.force_elements import Loads, ScalarLoads
from ...mechanics.forces.forces import InTime
from ...mechanics.joints import constraints as ct
from ...mechanics.joints.couplings import CouplingBatch
from ...mechanics.joints.joints import Joint, ground
from ...mechanics.kinds.evaluation import KindItems
from ...rotations import Array
from ..layout import ATTITUDE, RowBlock

if TYPE_CHECKING:
    from .scene import Scene

REMEDY = (
    "has no attitude: hold it by fmbd.spherical, distance or point_on_line (as the second body), push it by forces at its place; "
    "or take a RigidBody with its inertia."
)
NEAR = 1e-9  # of the model's length: a place that was computed


def attitude_of(body: Any) -> Joint:
    """What holds the attitude of a body that does not turn, against the ground: rows beside which nothing acts on it."""
    e, place = np.eye(body.dim), body.start_pose()[: body.dim]
    rows = tuple(ct.Row(ct.Perpendicular, e[i], e[j]) for i, j in combinations(range(body.dim), 2))
    return Joint(f"attitude of {body.name}", ground, body, rows, place, place, kind=ATTITUDE)


def at_its_place(body: Any, point: Array, length: float) -> Array:
    """The place of a body that does not turn, where a ``point`` (d,) is that, up to roundoff in a model of a ``length`` (m)."""
    place: Array = body.start_pose()[: len(point)]
    off = float(np.linalg.norm(point - place))
    if off > NEAR * length:
        raise InputError(
            f'Body "{body.name}" is a mass at {tuple(map(float, place))}; nothing can take hold of it {off:.3g} m away, '
            f"at {tuple(map(float, point))}. Leave the point out, or take a RigidBody with its inertia."
        )
    return place


def refuse_angles(scene: Scene) -> None:
    """Refuse angles against bodies that have none, and fields tied to them."""
    users: list[Any] = [*scene.joints.values(), *scene.forces.values()]
    used = [(user.name, s) for user in users for s in user.coordinates]
    used += [(limit.name, limit.coordinate) for limit in scene.limits.values()]
    for name, s in used:
        for side in (s.joint.a, s.joint.b):
            if s.kind.angular and side is not ground and not side.body.turns:
                raise InputError(
                    f'"{name}" acts on the angle of joint "{s.joint.name}", and body "{side.name}" {REMEDY}'
                )

    for tie in scene.ties.values():
        for side in (tie.a, tie.b):
            if side is not ground and not side.body.turns:
                raise InputError(
                    f'Tie "{tie.name}" holds the attitude of what it ties, and body "{side.name}" {REMEDY}'
                )


def refuse_turning(
    bodies: Sequence[Any],
    batches: Sequence[tuple[ct.Batch, np.ndarray]],
    blocks: Sequence[RowBlock],
    forces: Sequence[Loads],
) -> None:
    """Refuse joints and forces that would turn bodies without an attitude; ``bodies``: the rigid one of each marker, or None."""
    still = [None if body is None or body.turns else body.name for body in bodies]
    names = {row: b.name for b in blocks for row in range(b.rows.start, b.rows.stop) if b.kind != ATTITUDE}
    for items, rows in _rows_of(batches):
        for i, side in zip(*np.nonzero(items.turning), strict=True):
            body, name = still[items.pair[i, side]], names.get(int(rows[i]))
            if body and name:
                raise InputError(f'Joint "{name}" holds or reads the attitude of body "{body}", which {REMEDY}')

    for loads in forces:
        for force, turned in zip(loads.forces, _turned(loads), strict=True):
            markers = (m for m, turns in zip(turned[0], turned[1], strict=True) if turns)
            body = next((still[m] for m in markers if still[m]), None)
            if body:
                raise InputError(f'{force.kind.capitalize()} "{force.name}" would turn body "{body}", which {REMEDY}')


def _rows_of(batches: Sequence[tuple[ct.Batch, np.ndarray]]) -> Iterator[tuple[KindItems, np.ndarray]]:
    """Items with the numbers of their rows."""
    for batch, rows in batches:
        if isinstance(batch, CouplingBatch):
            yield from ((relative.items, rows[number]) for relative, number, _ in batch.terms)
        else:
            yield batch.items, rows


def _turned(loads: Loads) -> Iterator[tuple[Sequence[int], Sequence[bool]]]:
    """Of each force its markers, and which of them it turns; laws of the motions of points may do anything, and are let be."""
    pairs = list(zip(map(int, loads.a), map(int, loads.b), strict=True))
    mounts = loads.mounts()
    if isinstance(loads, ScalarLoads):
        turning = np.concatenate([term.items.turning for term in loads.relative.summands], axis=1)
        yield from zip(np.array(loads.markers).T.tolist(), turning.tolist(), strict=True)
    elif mounts is not None:
        # axes go with the first side; the second feels moments where there is a stiffness against turning
        d = loads.motions.dim
        K = np.abs(mounts[0]) + np.abs(mounts[1])
        turning = K[:, d:].any(axis=(1, 2)) | K[:, :, d:].any(axis=(1, 2))
        yield from ((pair, (True, bool(t))) for pair, t in zip(pairs, turning, strict=True))
    else:
        alone = (f.turns or f.follower if isinstance(f, InTime) else False for f in loads.forces)
        yield from ((pair, (t, t)) for pair, t in zip(pairs, alone, strict=True))
