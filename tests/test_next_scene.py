"""Scenes that go on where a run has ended: joints are released, closed on what they find, locked; nothing else changes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import CheckpointError, InputError

G = 9.81
FINE = fmbd.Radau(3, rtol=1e-9)


def meeting(dim: int, hinge: bool) -> fmbd.Scene:
    """Two bodies on a hinge, or side by side, that turn against each other."""
    z = () if dim == 2 else (0.0,)
    spin: Any = (lambda w: w) if dim == 2 else (lambda w: (0.2, 0.1, w))
    inertia: Any = (lambda x: x) if dim == 2 else (lambda x: (0.3 * x, x, 1.2 * x))
    bodies = [
        fmbd.RigidBody(name, mass, inertia(0.1 * mass), (x, 0, *z), angular_velocity=spin(w), velocity=(v, 0.1 * w, *z))
        for name, mass, x, w, v in (("a", 2.0, -0.5, 1.0, 0.2), ("b", 1.0, 0.5, -2.0, -0.1))
    ]
    scene = fmbd.Scene("two bodies")
    scene.add(*bodies)
    if hinge:
        scene.add(fmbd.revolute("hinge", *bodies, center=(0, 0, *z)))
        scene.sensor("phi", fmbd.angle("hinge"))
    for body in bodies:
        scene.sensor(body.name, fmbd.position(body))
        scene.sensor(f"R {body.name}", fmbd.rotation(body))
    return scene


def apart(run: Any, dim: int, i: int) -> tuple[Any, Any]:
    """Place and attitude of b in the axes of a at record i."""
    if dim == 2:
        Ra, Rb = (
            np.array([[np.cos(x), -np.sin(x)], [np.sin(x), np.cos(x)]]) for x in (run["R a"][i, 0], run["R b"][i, 0])
        )
    else:
        Ra, Rb = (run[f"R {name}"][i].reshape(3, 3) for name in "ab")
    return Ra.T @ (run["b"][i] - run["a"][i]), Ra.T @ Rb


@pytest.mark.parametrize("scheme", [fmbd.GeneralizedAlpha(), FINE, fmbd.Rattle()], ids=lambda s: s.name)
def test_a_sling_is_released_at_an_event(scheme: Any) -> None:
    """The stone of a trebuchet flies on a parabola from where the sling let go."""
    beam = fmbd.RigidBody("beam", 10.0, 5.0, position=(0.5, 0.0))
    weight, stone = fmbd.PointMass("weight", 200.0, (-1.0, -1.0)), fmbd.PointMass("stone", 2.0, (2.0, -1.0))
    scene = fmbd.Scene("trebuchet", gravity=(0, -G))
    scene.add(beam, weight, stone, fmbd.revolute("axle", fmbd.ground, beam, center=(0, 0)))
    scene.add(fmbd.distance("hanger", beam, weight, point_a=(-1, 0)))
    scene.add(fmbd.distance("sling", beam, stone, point_a=(2, 0)))
    for name, sensor in (("x", fmbd.position(stone)), ("v", fmbd.velocity(stone)), ("angle", fmbd.angle("axle"))):
        scene.sensor(name, sensor)

    thrown = fmbd.solve(scene, t_end=3.0, dt=1e-3, output=fmbd.Output(events=[fmbd.Event("x y", 1.5, direction=1)]))
    flight = thrown.next_scene()
    del flight.joints["sling"]
    step = {} if scheme is FINE else {"dt": 1e-3}
    run = fmbd.solve(flight, t_end=1.5, scheme=scheme, output=fmbd.Output(snapshots=5), **step)

    t = run.times - thrown.times[-1]
    assert t[0] == 0.0 and run.times[-1] == pytest.approx(1.5, abs=1e-12)
    assert "sling" in scene.joints and not run.warnings and len(run.snapshots) == 5
    assert run["angle"][0] == pytest.approx(thrown["angle"][-1], abs=1e-11)
    flown = thrown["x"][-1] + np.outer(t, thrown["v"][-1]) - 0.5 * np.outer(t**2, (0, G))
    np.testing.assert_allclose(run["x"], flown, rtol=0, atol=1e-10)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("hinge", [True, False])
def test_bodies_are_locked_to_each_other_in_motion(dim: int, hinge: bool) -> None:
    """As in an impact without rebound: both momenta stay, the bodies turn as one from where they were."""
    scene = meeting(dim, hinge)
    before = fmbd.solve(scene, t_end=0.6, dt=1e-3)
    later = before.next_scene()
    later.add(fmbd.fixed("latch", later.bodies["a"], later.bodies["b"]))
    run = fmbd.solve(later, t_end=2.0, dt=1e-3)

    assert run.drift[0] < 1e-11 and not run.warnings
    for was, now in zip(before.momenta(), run.momenta(), strict=True):
        np.testing.assert_allclose(now, was, rtol=0, atol=1e-10)
    assert run.total_energy[0] < 0.9 * before.total_energy[-1]
    assert run.total_energy[-1] == pytest.approx(run.total_energy[0], rel=1e-6)
    for found, wanted in zip(apart(run, dim, -1), apart(before, dim, -1), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-10)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_hinge_catches_a_body(dim: int) -> None:
    """A point of the ground takes hold of the body where it is then; the angle is counted from there."""
    z = () if dim == 2 else (0.0,)
    body = fmbd.RigidBody("body", 1.0, 0.1 if dim == 2 else (0.1, 0.1, 0.1), (0, 0, *z), velocity=(1.0, 0.0, *z))
    scene = fmbd.Scene("thrown", gravity=(0, -G, *z))
    scene.add(body)
    scene.sensor("x", fmbd.position(body))
    scene = fmbd.solve(scene, t_end=0.5, dt=1e-2).next_scene()

    center = np.array((0.5, -0.125 * G + 0.4, *z))
    scene.add(fmbd.revolute("hook", fmbd.ground, body, center=tuple(center)))
    scene.sensor("phi", fmbd.angle("hook"))
    run = fmbd.solve(scene, t_end=1.0, scheme=FINE)
    assert run["phi"][0, 0] == pytest.approx(0.0, abs=1e-12)

    # an arm of 0.4 m below the hook, and the moment of momentum about it
    phi = run["phi"][:, 0]
    np.testing.assert_allclose(run["x"][:, :2] - center[:2], 0.4 * np.stack((np.sin(phi), -np.cos(phi)), 1), atol=1e-9)
    rate = 0.4 / (0.1 + 0.16)
    assert run.energy["kinetic"][0] == pytest.approx(0.5 * (0.1 + 0.16) * rate**2, rel=1e-9)
    assert run.total_energy[-1] == pytest.approx(run.total_energy[0], abs=1e-6)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("new", [True, False])
def test_joints_that_have_closed_stay_as_they_closed(dim: int, new: bool) -> None:
    """Over many scenes, each of which goes on from the one before, also where others close later."""
    scene = fmbd.solve(meeting(dim, False), t_end=0.6, dt=1e-3).next_scene()
    hinge = scene.add(fmbd.revolute("hinge", scene.bodies["a"], scene.bodies["b"]))
    scene.sensor("phi", fmbd.angle(hinge))
    hung = fmbd.solve(scene, t_end=1.2, dt=1e-3)
    whole = hung if new else fmbd.solve(scene, t_end=2.2, dt=1e-3)

    scene = hung.next_scene()
    if new:
        scene.add(fmbd.fixed("latch", scene.bodies["a"], scene.bodies["b"]))
    later = fmbd.solve(fmbd.solve(scene, t_end=1.7, dt=1e-3).next_scene(), t_end=2.2, dt=1e-3)
    assert later.drift[0] < 1e-9 and not later.warnings
    assert later["phi"][-1] == pytest.approx(whole["phi"][-1], abs=1e-5)
    for found, wanted in zip(apart(later, dim, -1), apart(whole, dim, -1), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-5)
    for now, was in zip(later.momenta(), whole.momenta(), strict=True):
        np.testing.assert_allclose(now, was, rtol=0, atol=1e-6)


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["floating", "reduced", "absolute"])
def test_elastic_bodies_go_on_as_they_are(rod_mesh: Callable[..., Any], kind: str) -> None:
    """A bent cantilever is let go, and its end caught again: no jump in places, and the end stays where it was caught."""
    law, mesh = fmbd.materials.linear_elastic(5e6, 0.3), rod_mesh(h=0.2)
    full = fmbd.FloatingBody("rod", mesh, density=1e3, elastic=law)
    rod: Any = {"floating": full, "reduced": full.reduced(basis=fmbd.CraigBampton(("pin",), 4))}.get(kind)
    rod = rod or fmbd.AbsoluteBody(
        "rod", mesh, density=1e3, energy=fmbd.materials.sheet_saint_venant_kirchhoff(5e6, 0.3)
    )
    scene = fmbd.Scene("rod", gravity=(0, -G))
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    bent = fmbd.solve(scene, t_end=0.01, dt=5e-4)

    scene = bent.next_scene()
    del scene.joints["clamp"]
    free = fmbd.solve(scene, t_end=0.02, dt=5e-4)
    np.testing.assert_allclose(free["tip"][0], bent["tip"][-1], rtol=0, atol=1e-12)
    assert free.total_energy[0] == pytest.approx(bent.total_energy[-1], rel=1e-9)
    momentum = np.array(bent.momenta()[0]) - (0, 0.01 * G * 100.0)
    np.testing.assert_allclose(free.momenta()[0], momentum, rtol=0, atol=1e-6 * 100)

    scene = free.next_scene()
    scene.add(fmbd.fixed("catch", fmbd.ground, rod.surface("tip")))
    held = fmbd.solve(scene, t_end=0.03, dt=5e-4)
    np.testing.assert_allclose(held["tip"], np.broadcast_to(free["tip"][-1], held["tip"].shape), rtol=0, atol=1e-8)
    assert held.drift[0] < 1e-8


def test_turns_and_memories_go_on() -> None:
    """In two halves a motor with an integral turns its wheel as in one, beyond a turn; a latch ends it where it is."""
    wheel = fmbd.RigidBody("wheel", 1.0, (0.1, 0.1, 0.1), position=(0, 0, 0))
    hinge = fmbd.revolute("hinge", fmbd.ground, wheel, center=(0, 0, 0), axis=(0, 0, 1))
    scene = fmbd.Scene("motor")
    scene.add(wheel, hinge, fmbd.pid("motor", fmbd.angle(hinge), target=20.0, gains=(1.0, 2.0, 0.6)))
    scene.add(fmbd.dry_friction("bearing", fmbd.angle(hinge), limit=0.2, stick=50.0))
    scene.sensor("phi", fmbd.angle(hinge))

    whole, first = (fmbd.solve(scene, t_end=t, dt=1e-3) for t in (4.0, 2.0))
    second = fmbd.solve(first.next_scene(), t_end=4.0, dt=1e-3)
    assert first["phi"][-1, 0] > 2 * np.pi
    np.testing.assert_allclose(second["phi"], whole["phi"][2000:], rtol=0, atol=2e-5)

    locked = first.next_scene()
    locked.add(fmbd.fixed("latch", fmbd.ground, wheel))
    run = fmbd.solve(locked, t_end=3.0, dt=1e-2, output=fmbd.Output(times=(2.0, 2.5, 3.0)))
    np.testing.assert_allclose(run["phi"][:, 0], first["phi"][-1, 0], rtol=0, atol=1e-9)


def test_sensors_go_with_the_joint_that_is_released() -> None:
    """The run before keeps its own, and what reads another joint or body stays."""
    scene = meeting(2, True)
    a, b = scene.bodies.values()
    scene.add(fmbd.Spring("spring", a, b, stiffness=10.0, length=1.0))
    scene.sensor("pull", fmbd.tension("spring"))
    scene.sensor("force", fmbd.reaction("hinge"))
    run = fmbd.solve(scene, t_end=0.1, dt=1e-2)
    released = run.next_scene()
    del released.joints["hinge"]
    assert set(released.sensors) == {"a", "b", "R a", "R b", "pull"}
    del released.forces["spring"]
    assert set(released.sensors) == {"a", "b", "R a", "R b"}
    later = fmbd.solve(released, t_end=0.2, dt=1e-2)
    assert {"phi", "force", "pull"} <= set(run.series) and set(later.series) == set(released.sensors)
    del released.bodies["b"]
    assert set(released.sensors) == {"a", "R a"}


def test_what_a_scene_that_goes_on_refuses() -> None:
    run = fmbd.solve(meeting(2, True), t_end=0.1, dt=1e-2)
    scene = run.next_scene()
    with pytest.raises(fmbd.errors.InputError, match="goes on from a run"):
        fmbd.solve(scene, t_end=1.0, dt=1e-2, tol={"a": 1e-3})
    with pytest.raises(fmbd.errors.InputError, match="goes on from a run"):
        fmbd.solve(scene, t_end=1.0, dt=1e-2, output=fmbd.Output(estimate_space=True))
    with pytest.raises(fmbd.errors.InputError, match="goes on from 0.1 s"):
        fmbd.solve(scene, t_end=1.0, dt=1e-2, output=fmbd.Output(times=(0.05, 0.5)))
    with pytest.raises(fmbd.errors.InputError, match="t_end"):
        fmbd.solve(scene, t_end=0.05, dt=1e-2)
    told = fmbd.solve(scene, t_end=0.5, dt=1e-2, output=fmbd.Output(estimate_error=True))
    assert 0.0 < told.error_estimate["a"] < 1e-3


@pytest.mark.parametrize("center", [True, False])
def test_a_walker_steps_from_foot_to_foot(center: bool) -> None:
    """Velocities after heel strike: those of three masses on two stiff legs, the foot that lands at rest."""
    s = fmbd.Scene("walker", gravity=(0.088, -9.81))
    hip = fmbd.PointMass("hip", 10.0, (0.2, 0.98), velocity=(0.6, -0.12))
    feet = [fmbd.PointMass("one", 0.1, (0.0, 0.0)), fmbd.PointMass("other", 0.1, (0.6, 0.05), velocity=(0.2, -0.3))]
    s.add(hip, *feet, fmbd.revolute("pin", fmbd.ground, feet[0]))
    s.add(*(fmbd.distance(f"leg {i}", foot, hip) for i, foot in enumerate(feet)))
    for body in (hip, *feet):
        s.sensor(f"x of {body.name}", fmbd.position(body))
        s.sensor(f"v of {body.name}", fmbd.velocity(body))
    names = ["one", "hip", "other"]
    lands = fmbd.Event("x of other y", 0.0, direction=-1)
    run = fmbd.solve(s, t_end=3.0, scheme=fmbd.Radau(3, rtol=1e-8), output=fmbd.Output(events=[lands]))
    assert run.times[-1] < 1.0

    later = run.next_scene()
    del later.joints["pin"]
    there = run["x of other"][-1]
    later.add(fmbd.revolute("other pin", fmbd.ground, feet[1], center=there if center else None))
    after = fmbd.solve(later, t_end=run.times[-1] + 0.01, dt=1e-3)

    x, v = (np.array([run[f"{what} of {name}"][-1] for name in names]) for what in "xv")
    one, two = x[1] - x[0], x[1] - x[2]
    G = np.zeros((4, 6))
    G[0, :4], G[1, 2:], G[2, 4], G[3, 5] = (*-one, *one), (*two, *-two), 1.0, 1.0
    light = np.diag(1.0 / np.repeat([0.1, 10.0, 0.1], 2))
    expected = v.ravel() - light @ G.T @ np.linalg.solve(G @ light @ G.T, G @ v.ravel())
    assert np.ravel([after[f"v of {name}"][0] for name in names]) == pytest.approx(expected, abs=1e-8)
    assert np.abs(after["x of other"] - there).max() < 1e-9


@pytest.mark.parametrize("first", ["link", "stone"])
def test_a_link_catches_a_mass_that_turns_with_it(first: str) -> None:
    """The mass stays where it was met, and has the way of that point of the link; a center elsewhere is refused."""
    link = fmbd.RigidBody("link", 1.0, 0.1, (0.5, 0.0), angular_velocity=1.0, velocity=(0.0, 0.5))
    stone = fmbd.PointMass("stone", 0.5, (1.0, 0.5), velocity=(-0.2, 0.3))
    s = fmbd.Scene("catch")
    pin = fmbd.revolute("pin", fmbd.ground, link, center=(0.0, 0.0))
    s.add(link, stone, pin)
    s.sensor("stone", fmbd.position(stone))
    s.sensor("turn", fmbd.angle(pin))
    run = fmbd.solve(s, t_end=1.0, dt=1e-2)

    later = run.next_scene()
    later.add(fmbd.spherical("grip", *((link, stone) if first == "link" else (stone, link))))
    after = fmbd.solve(later, t_end=3.0, dt=1e-3)
    turn = after["turn"] - run["turn"][-1]
    c, s_ = np.cos(turn).ravel(), np.sin(turn).ravel()
    x, y = run["stone"][-1]
    assert after["stone"] == pytest.approx(np.stack((c * x - s_ * y, s_ * x + c * y), axis=1), abs=1e-6)

    wrong = run.next_scene()
    wrong.add(fmbd.spherical("grip", link, stone, center=(0.9, 0.0)))
    with pytest.raises(InputError, match=r'Joint "grip" catches mass "stone" .* away from where the mass is'):
        fmbd.solve(wrong, t_end=2.0, dt=1e-2)


@pytest.mark.serial
def test_a_checkpoint_is_taken_up_by_the_scene_of_its_own_origin(tmp_path: Path) -> None:
    """Neither by one that goes on from another time, nor by one that begins; the run of the checkpoint goes on as it was."""

    def later(end: float) -> fmbd.Scene:
        return fmbd.solve(meeting(2, True), t_end=end, dt=1e-2).next_scene()

    def run(scene: fmbd.Scene, **options: Any) -> fmbd.Run:
        return fmbd.solve(scene, t_end=0.9, dt=1e-2, **options)

    whole = run(later(0.3), checkpoint=fmbd.Checkpoint(tmp_path, every=20))
    for scene, found in ((later(0.6), "t = 0.6 s here"), (meeting(2, True), "absent here")):
        with pytest.raises(
            CheckpointError, match=f"from: t = 0.3 s in the checkpoint, {found}.*Restart with the scene"
        ):
            run(scene, restart=tmp_path)
    assert np.array_equal(run(later(0.3), restart=tmp_path)["a"], whole["a"])
