"""Compiled steps with contact against the same run in NumPy: every shape, carriers, friction, joints and forces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.schemes.impacts import contact_driver
from fmbd_fenicsx.system.compiled.library import driver_library

pytestmark = pytest.mark.skipif(driver_library(2) is None, reason="no C compiler")


def floor(body: Any, friction: float = 0.0, restitution: float = 0.5) -> Any:
    """A ball of 0.1 m over a plane."""
    up = np.eye(body.dim)[-1]
    obstacle = fmbd.Obstacle("floor", fmbd.HalfSpace(0 * up, up))
    return fmbd.contact("pair", fmbd.ball(body, 0.1), obstacle, friction=friction, restitution=restitution)


def bouncing(dim: int) -> Any:
    """A ball with spin on a plane."""
    up, along = np.eye(dim)[-1], np.eye(dim)[0]
    spin = 5.0 if dim == 2 else (1.0, 5.0, 2.0)
    inertia = 0.004 if dim == 2 else (0.004, 0.005, 0.006)
    ball = fmbd.RigidBody("ball", 1.0, inertia, 0.3 * up, velocity=along, angular_velocity=spin)
    return [ball, floor(ball, 0.3, 0.6)]


def rolling() -> Any:
    """A disk that slides, then rolls, on a spring and a damper."""
    disk = fmbd.RigidBody("disk", 1.0, 0.005, (0, 0.1), velocity=(1.0, 0))
    spring = fmbd.Spring("spring", fmbd.ground, disk, (-1.0, 0.4), stiffness=5.0, damping=0.4, length=1.0)
    return [disk, floor(disk, 0.3), spring]


def in_a_hollow() -> Any:
    """A ball in a hollow sphere."""
    ball = fmbd.RigidBody("ball", 1.0, (0.004,) * 3, (0.2, 0, -0.25))
    hollow = fmbd.Obstacle("hollow", fmbd.Sphere(0.6, inside=True))
    return [ball, fmbd.contact("pair", fmbd.ball(ball, 0.1), hollow, friction=0.2)]


def over_a_cylinder(length: float) -> Any:
    """A ball that rolls down a tilted cylinder, over its rim."""
    ball = fmbd.RigidBody("ball", 1.0, (0.004,) * 3, (0.1, 0.05, 0.4), velocity=(0.6, 0, 0))
    log = fmbd.Obstacle("log", fmbd.Cylinder(0.3, (1.0, 0.0, -0.1), (0, 0, 0), length))
    return [ball, fmbd.contact("pair", fmbd.ball(ball, 0.1), log, friction=0.3)]


def on_a_box(carried: bool) -> Any:
    """A ball that rolls over the edge of a box, at rest or on a body on a guide."""
    ball = fmbd.RigidBody("ball", 1.0, 0.004, (0.15, 0.3), velocity=(0.6, 0.0))
    base = fmbd.RigidBody("base", 5.0, 0.1, (0.0, 0.0))
    box = fmbd.Obstacle("box", fmbd.Box((0.4, 0.4)), on=base if carried else None)
    made = [ball, fmbd.contact("pair", fmbd.ball(ball, 0.1), box, friction=0.4)]
    guide = fmbd.prismatic("guide", fmbd.ground, base, axis=(1.0, 0.0), center=(0, 0))
    return [*made, base, guide] if carried else made


def cam() -> Any:
    """A follower on a guide over a turning disk."""
    follower = fmbd.RigidBody("follower", 0.5, 0.01, (0.0, 0.04))
    turning = lambda t: ((0.02 * np.sin(19 * t), -0.02 * np.cos(19 * t)), 19 * t)  # noqa: E731
    disk = fmbd.Obstacle("cam", fmbd.Sphere(0.05), motion=turning)
    pair = fmbd.contact("pair", fmbd.ball(follower, 0.01), disk, friction=0.2)
    return [follower, pair, fmbd.prismatic("guide", fmbd.ground, follower, axis=(0, 1), center=(0, 0.04))]


def with_memory(controlled: bool) -> Any:
    """A cam whose follower is held back by dry friction in its guide, or by a PID controller."""
    follower, pair, guide = cam()
    lift = fmbd.displacement(guide)
    if controlled:
        return [follower, pair, guide, fmbd.forces.pid("pid", lift, target=-0.005, gains=(40.0, 30.0, 2.0), limit=8.0)]
    return [follower, pair, guide, fmbd.dry_friction("dry", lift, limit=1.0, stick=2e3, damping=3.0)]


SCENES = {
    "bouncing 2": lambda: bouncing(2), "bouncing 3": lambda: bouncing(3), "rolling": rolling, "hollow": in_a_hollow,
    "cylinder": lambda: over_a_cylinder(np.inf), "rim": lambda: over_a_cylinder(0.5), "box": lambda: on_a_box(False),
    "carried box": lambda: on_a_box(True), "cam": cam, "dry friction": lambda: with_memory(False),
    "pid": lambda: with_memory(True),
}  # fmt: skip


def run(name: str) -> Any:
    """One run, with all that sensors read of contact."""
    items = SCENES[name]()
    pair = next(x for x in items if type(x).__name__ == "Contact")
    scene = fmbd.Scene("contact", gravity=tuple(-9.81 * np.eye(items[0].dim)[-1]))
    scene.add(*items)
    scene.sensor("place", fmbd.position(items[0]))
    for made in (fmbd.contact_force, fmbd.contact_impulse, fmbd.contact_gap):
        scene.sensor(made.__name__, made(pair))
    scene.sensor("work", fmbd.contact_work())
    output = fmbd.Output(every=8, progress=False)
    return fmbd.solve(scene, t_end=0.4, dt=2e-3, scheme=fmbd.Moreau(), output=output)


@pytest.mark.parametrize("name", SCENES)
def test_compiled_steps_are_those_of_numpy(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = run(name)
    assert compiled.counters["compiled_steps"] == 200
    monkeypatch.setattr(contact_driver, "contact_driver", lambda *_, **__: None)
    numpy = run(name)
    assert "compiled_steps" not in numpy.counters

    for sensor, values in numpy.series.items():
        size = np.abs(values).max() + 1e-3
        assert compiled[sensor] == pytest.approx(values, abs=1e-7 * size), sensor
    for kind, energy in numpy.energy.items():
        assert compiled.energy[kind] == pytest.approx(energy, abs=1e-9 * (np.abs(energy).max() + 1.0)), kind
    for count in ("contact_steps", "impacts", "newton_iterations", "contact_newton_iterations"):
        assert compiled.counters[count] == numpy.counters[count], count


def test_a_motion_that_raises_is_named() -> None:
    """The compiled step gives it back, and NumPy's says which obstacle it is."""

    def moving(t: float) -> Any:
        if t > 0.05:
            raise ValueError("lost")
        return (0.0, 0.0), 0.0

    ball = fmbd.RigidBody("ball", 1.0, 0.1, (0.0, 1.1))
    plate = fmbd.Obstacle("plate", fmbd.HalfSpace((0, 0), (0, 1)), motion=moving)
    scene = fmbd.Scene("moving", gravity=(0, -9.81))
    scene.add(ball, fmbd.contact("pair", fmbd.ball(ball, 0.1), plate))
    with pytest.raises(fmbd.errors.FmbdError, match="plate"):
        fmbd.solve(scene, t_end=0.1, dt=1e-2, scheme=fmbd.Moreau())
