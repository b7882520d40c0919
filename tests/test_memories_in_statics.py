"""Equilibria and modes of scenes whose elements remember: controllers, dry friction; slack wires, ties, drives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_controllers import GOAL, arm
from test_controllers import G as GRAVITY

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError, InputError

BLOCK = Path(__file__).resolve().parents[1] / "meshes/block.py"


def test_an_integral_holds_the_target() -> None:
    """Two PID controllers: both angles are at their targets, the efforts are the moments of the weights."""
    found = fmbd.equilibrium(arm())
    assert [found["shoulder"][0], found["elbow"][0]] == pytest.approx(GOAL, abs=1e-9)
    outer = 0.5 * GRAVITY * np.cos(sum(GOAL))
    assert found["elbow torque"][0] == pytest.approx(outer, rel=1e-8)
    assert found["shoulder torque"][0] == pytest.approx(outer + 1.5 * GRAVITY * np.cos(GOAL[0]), rel=1e-8)
    with pytest.raises(InputError, match="no path of equilibria follows"):
        fmbd.equilibrium(arm(), path=fmbd.LoadSteps((1.0,)))
    with pytest.raises(InputError, match='"shoulder motor" is sampled'):
        fmbd.equilibrium(arm(every=1e-2))


def lever(*elements: Any, torque: float = 0.0) -> fmbd.Scene:
    """A body on a hinge with elements made from the angle of the hinge."""
    scene = fmbd.Scene("lever")
    body = fmbd.RigidBody("body", 1.0, 0.25, position=(0.0, 0.0))
    hinge = fmbd.revolute("hinge", fmbd.ground, body, center=(0.0, 0.0))
    scene.add(body, hinge, fmbd.torque("torque", body, lambda t: torque))
    scene.add(*(make(fmbd.angle(hinge)) for make in elements))
    scene.sensor("angle", fmbd.angle(hinge))
    return scene


@pytest.mark.parametrize("gains", [(50.0, 20.0, 1.0), (1e6, 1e9, 1.0), (1e-6, 1e-6, 0.0), (0.0, 20.0, 1.0)])
@pytest.mark.parametrize("goal", [0.0, 0.1])
def test_a_target_that_needs_no_effort(goal: float, gains: tuple[float, float, float]) -> None:
    """Without load efforts come to zero: what is left of them is roundoff of the angles, by which none is refused."""
    scene = fmbd.Scene("arm")
    last: Any = fmbd.ground
    for name, place in (("upper", (0.3, 0.4)), ("lower", (0.7, 0.1))):
        body = fmbd.RigidBody(name, 1.0, 0.25, position=place)
        hinge = fmbd.revolute(f"{name} hinge", last, body, center=place)
        scene.add(body, hinge, fmbd.pid(f"{name} motor", fmbd.angle(hinge), target=goal, gains=gains))
        scene.sensor(name, fmbd.angle(hinge))
        last = body
    found = fmbd.equilibrium(scene)
    assert [found["upper"][0], found["lower"][0]] == pytest.approx([goal, goal], abs=1e-12)


def test_a_limit_below_the_load() -> None:
    """An integral that cannot reach its target: with its effort limited there is no equilibrium."""
    scene = lever(lambda s: fmbd.pid("motor", s, target=0.0, gains=(50.0, 20.0, 1.0), limit=3.0), torque=5.0)
    with pytest.raises(ConvergenceError):
        fmbd.equilibrium(scene)


def test_proportional_control_is_a_spring() -> None:
    """Without an integral the memory moves nothing: modes are those of a spring and a damper."""
    scene = lever(lambda s: fmbd.pid("motor", s, target=0.3, gains=(50.0, 0.0, 1.0)), torque=5.0)
    found = fmbd.equilibrium(scene)
    assert found["angle"][0] == pytest.approx(0.4, abs=1e-10)
    exact = np.roots([0.25, 1.0, 50.0])[0]
    value = fmbd.modes(scene, 1, at=found).eigenvalues[0]
    assert [value.real, abs(value.imag)] == pytest.approx([exact.real, abs(exact.imag)], rel=1e-7)


@pytest.mark.parametrize(("torque", "angle"), [(5.0, 5.0 / 1e5), (20.0, 0.2)])
def test_dry_friction(torque: float, angle: float) -> None:
    """Below its limit it holds on its stiffness; above, the spring carries the rest: reached from the start, not the only one."""
    friction, spring = (
        lambda s: fmbd.dry_friction("friction", s, limit=10.0, stick=1e5),
        lambda s: fmbd.joint_spring("spring", s, stiffness=50.0),
    )
    scene = lever(friction, spring, torque=torque)
    found = fmbd.equilibrium(scene)
    assert found["angle"][0] == pytest.approx(angle, rel=1e-3)
    if torque < 10.0:
        assert fmbd.modes(scene, 1, at=found).omega[0] == pytest.approx(np.sqrt((1e5 + 50.0) / 0.25), rel=1e-7)
        return
    with pytest.raises(InputError, match='"friction" is at its limit'):
        fmbd.modes(scene, 1, at=found)


REMEMBERING = {
    "dry friction": lambda: lever(lambda s: fmbd.dry_friction("friction", s, limit=9.0, stick=1e3), torque=5.0),
    "integral": lambda: lever(lambda s: fmbd.pid("motor", s, target=0.1, gains=(50.0, 20.0, 1.0)), torque=5.0),
}


@pytest.mark.parametrize("made", REMEMBERING.values(), ids=REMEMBERING)
def test_a_settled_start_stays_where_it_is(made: Any) -> None:
    """What elements remember in the equilibrium is what the run begins with."""
    scene, place = made(), fmbd.equilibrium(made())["angle"]
    scene.settle = True
    run = fmbd.solve(scene, t_end=0.2, dt=0.01)
    assert np.abs(place).max() > 1e-3
    assert np.abs(run["angle"] - place).max() < 1e-9


def test_a_settled_start_takes_no_velocity() -> None:
    scene = fmbd.Scene("hung", settle=True, gravity=(0.0, -GRAVITY))
    body = fmbd.RigidBody("body", 1.0, 0.25, position=(0.0, -1.0), velocity=(1.0, 0.0), angular_velocity=1.0)
    scene.add(body, fmbd.revolute("hinge", fmbd.ground, body, center=(0.0, 0.0)))
    with pytest.raises(InputError, match='"body" is given a velocity, which a scene with settle=True does not take'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


def test_slack_wires() -> None:
    """A weight on three wires, of which one is too long: the forces of the two others carry it."""
    scene, start = fmbd.Scene("wires", gravity=(0.0, -GRAVITY)), np.array([0.3, -1.0])
    body = fmbd.RigidBody("body", 1.0, 0.1, position=tuple(start))
    scene.add(body)
    ends = {"left": (-1.0, 0.0), "right": (1.0, 0.0), "slack": (0.3, 0.0)}
    lengths = {n: float(np.linalg.norm(start - x)) + (0.5 if n == "slack" else 0.0) for n, x in ends.items()}
    for n, x in ends.items():
        pull = lambda e, v, t: 500.0 * np.maximum(e, 0.0)  # noqa: E731
        scene.add(fmbd.Spring(n, fmbd.ground, body, x, tuple(start), law=pull, length=lengths[n]))
    scene.sensor("at", fmbd.position(body))
    place = fmbd.equilibrium(scene)["at"]
    total = np.array([0.0, -GRAVITY])
    for n, x in ends.items():
        way = np.asarray(x) - place
        total += 500.0 * max(np.linalg.norm(way) - lengths[n], 0.0) * way / np.linalg.norm(way)
    assert np.abs(total).max() < 1e-9


def hub(rate: float) -> fmbd.Scene:
    """A mass on a spring along an arm of a hub that a drive turns."""
    scene = fmbd.Scene("hub")
    wheel = fmbd.RigidBody("hub", 1.0, 0.3)
    mass = fmbd.RigidBody("mass", 2.0, 1.0, position=(1.0, 0.0))
    axle, arm_ = (
        fmbd.revolute("axle", fmbd.ground, wheel, center=(0, 0)),
        fmbd.prismatic("arm", wheel, mass, axis=(1, 0)),
    )
    scene.add(wheel, mass, axle, arm_, fmbd.drive("motor", fmbd.angle(axle), lambda t: rate * t))
    scene.add(fmbd.Spring("spring", wheel, mass, (0, 0), (1, 0), stiffness=100.0, length=1.0))
    scene.sensor("place", fmbd.position(mass))
    return scene


@pytest.mark.parametrize("rate", [4.0, 0.0])
def test_steady_rotation_of_a_drive(rate: float) -> None:
    """r = k l / (k - m W^2), w^2 = k / m - W^2; the drive turns with the rotation, or stands as the ground turns."""
    found = fmbd.equilibrium(hub(rate), t=0.3, spin=fmbd.Spin(4.0))
    assert np.linalg.norm(found["place"]) == pytest.approx(100.0 / 68.0, rel=1e-10)
    assert fmbd.modes(found.scene, 1, at=found).omega[0] == pytest.approx(np.sqrt(50.0 - 16.0), rel=1e-7)


def test_a_drive_of_another_rate_is_refused() -> None:
    with pytest.raises(InputError, match=r'"motor" moves with 4 .* it would with 3'):
        fmbd.equilibrium(hub(4.0), spin=fmbd.Spin(3.0))


@pytest.mark.mpi
def test_two_tied_halves_bend_as_one() -> None:
    """Tips and frequencies of a cantilever in one piece, and of two halves that a tie holds together."""
    tips, omega = [], []
    for parts in (1, 2):
        scene, bodies = fmbd.Scene("halves"), []
        for i in range(parts):
            size, start = 1.0 / parts, (i / parts, 0.0)
            mesh = fmbd.read_gmsh(BLOCK, size=(size, 0.1), origin=start, counts=(20 // parts, 2))
            law = fmbd.materials.plane_stress(1e6, 0.3)
            bodies.append(fmbd.AbsoluteBody(f"part {i}", mesh, density=1e3, degree=2, elastic=law))
        scene.add(*bodies, fmbd.fixed("clamp", fmbd.ground, bodies[0].surface("left")))
        if parts == 2:
            scene.add(fmbd.tie_surface("tie", bodies[0].surface("right"), bodies[1].surface("left")))
        scene.add(fmbd.force("push", bodies[-1].surface("right"), lambda t: (0.0, -1.0)))
        scene.sensor("tip", fmbd.position(bodies[-1].surface("right")))
        found = fmbd.equilibrium(scene)
        tips.append(found["tip"])
        omega.append(fmbd.modes(scene, 2, at=found).omega)
    assert np.abs(tips[0] - tips[1]).max() < 1e-6
    assert omega[1] == pytest.approx(omega[0], rel=1e-5)


def test_smooth_friction_holds_nothing(caplog: pytest.LogCaptureFixture) -> None:
    """It creeps: the spring carries the whole torque, and a warning says so."""
    scene = lever(
        lambda s: fmbd.joint_friction("friction", s, coulomb=10.0, speed=0.1),
        lambda s: fmbd.joint_spring("spring", s, stiffness=50.0),
        torque=5.0,
    )
    with caplog.at_level("WARNING"):
        assert fmbd.equilibrium(scene)["angle"][0] == pytest.approx(0.1, rel=1e-9)
    assert "holds nothing" in caplog.text
