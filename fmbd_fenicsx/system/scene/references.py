"""What joints, ties, forces and sensors of a scene refer to: bodies, surfaces and others that have to be in it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ...errors import InputError, near
from ...mechanics.bodies.bodies import FloatingBody, Surface
from ...mechanics.joints.joints import ground

if TYPE_CHECKING:
    from .scene import Scene


def check_references(scene: Scene) -> None:
    """Refuse joints, ties and forces on bodies that are not in the scene, and floating bodies without a frame."""
    if scene.unilateral:
        from .contact import check_contacts

        check_contacts(scene)
    for joint in scene.joints.values():
        for side in (joint.a, joint.b):
            check_side(scene, side, f'Joint "{joint.name}"')
    for tie in scene.ties.values():
        for side in (tie.a, tie.b):
            check_side(scene, side, f'Tie "{tie.name}"')

    for force in scene.forces.values():
        for side in force.sides:
            if side is not None:
                check_side(scene, side, f'Force "{force.name}"')
    for body in scene.bodies.values():
        if isinstance(body, FloatingBody) and body.frame is None:
            raise InputError(
                f'Body "{body.name}" has no frame: its rigid motion is not determined. Use frame=MeanAxis() or Attached(...).'
            )


def check_side(scene: Scene, side: Any, what: str) -> None:
    """Refuse what acts on a body that is not in the scene, or on an elastic one elsewhere than on a surface."""
    if side is ground:
        return
    body = side.body
    if scene.bodies.get(body.name) is not body:
        known = near(body.name, scene.bodies)
        raise InputError(f'{what} refers to body "{body.name}", which is not in the scene. {known}')

    if side is body and body.by_surface:
        raise InputError(
            f'{what}: attach to a surface of the elastic body "{body.name}", say {body.name}.surface("...").'
        )


def check_sensors(scene: Scene, rows: set[str]) -> None:
    """Refuse a sensor of a joint, body or contact that is not in the scene; one of the same name is another one.

    ``rows``: names of all that has rows.
    """
    joints = {**dict.fromkeys(rows), **scene.joints}
    there: dict[str, Mapping[str, Any]] = {
        "joint": joints, "body": scene.bodies, "force": scene.forces, "contact": scene.contacts, "joint limit": scene.limits,
    }  # fmt: skip

    for name, sensor in scene.sensors.items():
        for what, wanted in sensor.wanted:
            known = there[what]
            here = known.get(wanted)
            another = here is not None and getattr(wanted, "part", here) is not here  # ties have rows alone
            if wanted not in known or another:
                raise InputError(
                    f'Sensor "{name}": there is no {what} "{wanted}" in the scene. {near(wanted, known)} '
                    f'Add it, or take the sensor out: del scene.sensors["{name}"].'
                )


def surfaces_in_use(scene: Scene) -> dict[str, list[str]]:
    """Names of the surfaces of each body that joints, forces and sensors are on, and ties of bodies that stiffen."""
    used: dict[str, list[str]] = {body: [] for body in scene.bodies}
    sides = [side for joint in scene.joints.values() for side in (joint.a, joint.b)]
    sides += [side for force in scene.forces.values() for side in force.sides]
    sides += [sensor.on for sensor in scene.sensors.values()]
    # forces of a tie stiffen as those of a joint on the same surface
    tied = [side for tie in scene.ties.values() for side in (tie.a, tie.b)]
    sides += [side for side in tied if isinstance(side, Surface) and getattr(side.body, "held_at", None)]
    for side in sides:
        if isinstance(side, Surface) and side.name not in used[side.body.name]:
            used[side.body.name].append(side.name)
    return used
