"""Counted angles are coordinates of a configuration: functions of it alone, by any number of turns a step, in plane and space."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import saint_venant_kirchhoff
from fmbd_fenicsx.rotations import SPACE, nearest_rotation
from fmbd_fenicsx.system.system import System

SCHEMES = {
    "radau": fmbd.Radau(),
    "half-explicit": fmbd.HalfExplicit(),
    "bdf": fmbd.BDF(),
    "explicit": fmbd.ExplicitRungeKutta(),
}


def wheels(dim: int, rate: float, ratio: float, inertia: float = 0.1) -> tuple[fmbd.Scene, Any]:
    """Two wheels in a gear pair that turn without a load, and the first one."""
    scene, made = fmbd.Scene("gear"), []
    for name, x, w in (("a", 0.0, rate), ("b", 1.0, ratio * rate)):
        place = (x, 0.0) if dim == 2 else (x, 0.0, 0.0)
        spin: Any = w if dim == 2 else (0.0, 0.0, w)
        moment: Any = inertia if dim == 2 else (inertia,) * 3
        wheel = fmbd.RigidBody(name, 1.0, moment, position=place, angular_velocity=spin)
        made.append((wheel, fmbd.revolute(name, fmbd.ground, wheel, center=place)))
        scene.add(*made[-1])
    angles = [fmbd.angle(joint) for _, joint in made]
    scene.add(fmbd.gear("gear", *angles, ratio=ratio))
    scene.sensor("angle", angles[0])
    scene.sensor("driven", angles[1])
    return scene, made[0][0]


def chain(dim: int, turns: list[float]) -> tuple[System, Any]:
    """Wheels in a row, each in a bearing of the one before, and its state; all angles are counted by springs."""
    scene = fmbd.Scene("chain")
    before: Any = fmbd.ground
    for i, _ in enumerate(turns):
        place = (0.3 * i, 0.0) if dim == 2 else (0.3 * i, 0.0, 0.0)
        body = fmbd.RigidBody(f"b{i}", 1.0, 0.1 if dim == 2 else (0.1, 0.2, 0.25), position=place)
        joint = fmbd.revolute(f"j{i}", before, body, center=place, axis=(0, 0, 1) if dim == 2 else (0.0, 0.6, 0.8))
        scene.add(body, joint, fmbd.joint_spring(f"s{i}", fmbd.angle(joint), stiffness=1.0))
        before = body
    system, state, _ = scene.build()
    return system, state


def angles_of(system: System, q: Any) -> Any:
    """The angles that the springs see."""
    return system.forces[0].relative.values(system.at(0.0, q).kin)  # type: ignore[attr-defined]


def increment(system: System, turns: list[float], axis: Any) -> Any:
    """Every body turns about the same axis, by the sums of the joint angles."""
    n = system.motions.n_twist
    xi = np.zeros(system.n_v)
    for i, total in enumerate(np.cumsum(turns)):
        xi[i * n + system.motions.dim : (i + 1) * n] = total * axis
    return xi


@pytest.mark.parametrize("dim", [2, 3])
@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.lists(st.floats(-40.0, 40.0), min_size=1, max_size=4))
def test_an_increment_of_many_turns_is_counted(dim: int, turns: list[float]) -> None:
    """Any number of turns at once; one value for one configuration, whatever was evaluated before."""
    system, state = chain(dim, turns)
    axis = np.array([1.0]) if dim == 2 else np.array([0.0, 0.6, 0.8])
    q = system.compose(state.q, increment(system, turns, axis))
    first = angles_of(system, q)
    assert np.abs(first - turns).max() < 1e-9

    half = system.compose(state.q, increment(system, [0.5 * x for x in turns], axis))
    assert np.abs(angles_of(system, half) - 0.5 * np.array(turns)).max() < 1e-9
    assert np.array_equal(angles_of(system, q), first)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 3, st.floats(-1.5, 1.5)), min_size=20, max_size=40))
def test_bodies_that_tumble_count_the_angle_of_their_joint(steps: list[tuple[float, ...]]) -> None:
    """The first body turns anyhow, the second about its bearing on it: the count is the sum of the angles."""
    system, state = chain(3, [0.0, 0.0])
    q, axis = state.q, np.array([0.0, 0.6, 0.8])
    for k, (*tumble, _) in enumerate(steps):
        total = sum(angle for *_, angle in steps[: k + 1])
        xi = np.zeros(system.n_v)
        xi[3:6] = tumble
        there = system.compose(q, xi)
        there[7:14] = SPACE.compose(there[:7], np.concatenate((np.zeros(3), total * axis)))
        xi[9:12] = SPACE.difference(q[7:14], there[7:14])[3:]
        q = system.compose(q, xi)
    assert angles_of(system, q)[1] == pytest.approx(total, abs=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_gear_under_a_torque(scheme: str, dim: int) -> None:
    """J phi'' = T: the angle T t^2 / 2 (J1 + ratio^2 J2), through many turns, with steps of more than one in the plane."""
    scene, wheel = wheels(dim, 0.0, 2.0)
    axis: Any = 1.0 if dim == 2 else np.array([0.0, 0.0, 1.0])
    scene.add(fmbd.torque("torque", wheel, lambda t: axis))
    run = fmbd.solve(scene, t_end=8.0, scheme=SCHEMES[scheme])
    exact = 0.5 * 64.0 / (0.1 * 5.0)
    assert run["angle"][-1, 0] == pytest.approx(exact, rel=1e-5)
    assert run["driven"][-1, 0] == pytest.approx(2.0 * exact, rel=1e-5)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_spring_at_three_radians_a_step(dim: int) -> None:
    """J phi'' = -k phi at constant steps, compiled or not: phi = rate / w sin w t."""
    rate, w = 300.0, 1.0
    zero = (0.0,) * dim
    spin: Any = rate if dim == 2 else (0.0, 0.0, rate)
    body = fmbd.RigidBody("shaft", 1.0, 0.1 if dim == 2 else (0.1,) * 3, position=zero, angular_velocity=spin)
    bearing = fmbd.revolute("bearing", fmbd.ground, body, center=zero)
    scene = fmbd.Scene("shaft")
    scene.add(body, bearing, fmbd.joint_spring("spring", fmbd.angle(bearing), stiffness=0.1 * w * w))
    scene.sensor("angle", fmbd.angle(bearing))
    run = fmbd.solve(scene, t_end=1.0, dt=0.01)
    assert run["angle"][-1, 0] == pytest.approx(rate / w * np.sin(w), rel=1e-4)


@pytest.mark.parametrize("compiled", [True, False])
def test_a_sensor_counts_on_the_compiled_path_too(compiled: bool) -> None:
    """Nothing but a sensor asks for the angle of a shaft that turns by 4 rad a step in space."""
    body = fmbd.RigidBody("shaft", 1.0, (0.1, 0.1, 0.1), position=(0, 0, 0), angular_velocity=(0, 0, 400.0))
    bearing = fmbd.revolute("bearing", fmbd.ground, body, center=(0, 0, 0))
    scene = fmbd.Scene("shaft")
    scene.add(body, bearing)
    scene.sensor("angle", fmbd.angle(bearing))
    run = fmbd.solve(scene, t_end=0.5, dt=0.01, scheme=fmbd.GeneralizedAlpha(0.8, compiled=compiled))
    assert run["angle"][-1, 0] == pytest.approx(200.0, rel=1e-9)
    assert (run.counters.get("compiled_steps", 0) > 0) == compiled


@pytest.mark.parametrize("compiled", [True, False])
def test_rotations_in_the_plane_count_their_turns(compiled: bool) -> None:
    """Of a body that no joint holds, and of an end of a beam: 20 rad each. A jump by a turn was an error to a search."""
    scene = fmbd.Scene("free")
    section = fmbd.Section.rectangle(youngs_modulus=7e10, poisson_ratio=0.3, density=2700.0, width=0.04, height=0.04)
    disk = fmbd.RigidBody("disk", 1.0, 0.1, (0.0, 5.0), angular_velocity=10.0)
    beam = fmbd.Beam("beam", (-0.5, 0.0), (0.5, 0.0), section, elements=2, angular_velocity=10.0)
    scene.add(disk, beam)
    scene.sensor("disk", fmbd.rotation(disk))
    scene.sensor("end", fmbd.rotation(beam.surface("end")))
    run = fmbd.solve(scene, t_end=2.0, dt=0.01, scheme=fmbd.GeneralizedAlpha(0.8, compiled=compiled))
    assert run["disk"][:, 0] == pytest.approx(10.0 * run.times, abs=1e-9)
    assert run["end"][:, 0] == pytest.approx(10.0 * run.times, abs=1e-2)


@pytest.mark.parametrize("scheme", [fmbd.GeneralizedAlpha(0.8), fmbd.EnergyMomentum()])
def test_a_surface_without_a_frame_turns_beyond_a_turn(scheme: Any, rod_mesh: Callable[..., Any]) -> None:
    """A rod of an absolute body, turning steadily about its end: 10 rad of the angle of its surface."""
    mesh = rod_mesh(dim=2, h=0.5, height=0.2)
    law = saint_venant_kirchhoff(5e6, 0.3)
    body = fmbd.AbsoluteBody(
        "rod", mesh, density=1000.0, energy=law, quadrature=4, velocity=(0.0, 2.5), angular_velocity=5.0
    )
    joint = fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0.0, 0.0))
    scene = fmbd.Scene("turning rod")
    scene.add(body, joint)
    scene.sensor("angle", fmbd.angle(joint))
    run = fmbd.solve(scene, t_end=1.6, dt=0.01, scheme=scheme)
    assert run["angle"][-1, 0] == pytest.approx(8.0, abs=0.1)
    assert np.abs(np.diff(run["angle"][:, 0])).max() < 0.5


@pytest.mark.parametrize("start", [0.0, 2.5, 10.0])
def test_angles_start_at_zero(start: float) -> None:
    """Whatever the attitude at the start, also beyond a turn."""
    body = fmbd.RigidBody("b", 1.0, 0.1, position=(0, 0), rotation=start)
    joint = fmbd.revolute("j", fmbd.ground, body, center=(0, 0))
    scene = fmbd.Scene("s")
    scene.add(body, joint, fmbd.joint_spring("k", fmbd.angle(joint), stiffness=1.0))
    system, state, _ = scene.build()
    assert abs(angles_of(system, state.q)[0]) < 1e-12


def test_rotation_vectors_nearest_to_a_guess() -> None:
    theta = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [0.3, 0.0, 0.4]])
    near = np.array([[0.0, 0.1, 7.0], [6.0, 0.0, 0.0], [-3.0, 0.0, -4.0]])
    wanted = np.array([[0.0, 0.0, 1.0 + 2 * np.pi], [2 * np.pi, 0.0, 0.0], [0.3, 0.0, 0.4]])
    wanted[2] *= 1.0 - 2 * np.pi / 0.5
    assert np.abs(nearest_rotation(theta, near) - wanted).max() < 1e-12
