"""Joint limits with restitution against the analytic bounce, and at rest at the stop."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.materials import linear_elastic
from fmbd_fenicsx.schemes.impacts.compiled import driver
from fmbd_fenicsx.schemes.impacts.compiled.stepper import CompiledMoreauStepper

G = 9.81
BLOCK = Path(__file__).resolve().parents[1] / "meshes/block.py"


def bouncing(t: np.ndarray, depth: float, e: float) -> np.ndarray:
    """Position of a mass that falls from 0 onto a stop at -depth, again and again."""
    out, fall = -0.5 * G * t**2, np.sqrt(2 * depth / G)
    start, speed = fall, e * G * fall
    while speed > 1e-3:
        after = t >= start
        out[after] = -depth + speed * (t[after] - start) - 0.5 * G * (t[after] - start) ** 2
        start, speed = start + 2 * speed / G, e * speed
    return np.where(t >= start, -depth, out)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("e", [0.0, 0.7])
def test_slider_falls_onto_its_stop(dim: int, e: float) -> None:
    mass = fmbd.RigidBody("mass", 2.0, 0.1 if dim == 2 else (0.1, 0.1, 0.1), position=(0.0,) * dim)
    down = (0.0, 1.0, 0.0)[:dim]
    rail = fmbd.prismatic("rail", fmbd.ground, mass, axis=down)
    stop = fmbd.joint_limit("stop", fmbd.displacement(rail), lower=-0.2, restitution=e)
    scene = fmbd.Scene("drop", gravity=tuple(-G * x for x in down))
    scene.add(mass, rail, stop)
    scene.sensor("s", fmbd.displacement(rail))
    scene.sensor("force", fmbd.sensors.limit_effort(stop))
    run = fmbd.solve(scene, t_end=0.7, dt=1e-2)
    assert np.allclose(run["s"][:, 0], bouncing(run.times, 0.2, e), atol=1e-9)

    # the impulse of the stop: of the weight, and of the change of momentum
    speed = (run["s"][-1, 0] - run["s"][-2, 0]) / 1e-2 - 0.5 * G * 1e-2 * (e > 0)
    impulse = 1e-2 * run["force"][1:].sum()
    assert impulse == pytest.approx(2.0 * (speed + G * 0.7), rel=1e-6)
    if e == 0.0:
        assert run["force"][-1, 0] == pytest.approx(2.0 * G, rel=1e-9)  # it carries the weight


@pytest.mark.parametrize("dim", [2, 3])
def test_hinge_between_two_stops(dim: int) -> None:
    """A free wheel goes to and fro, and each time it is slower; its upper stop is beyond a turn."""
    wheel = fmbd.RigidBody(
        "wheel", 1.0, 0.3 if dim == 2 else (0.2, 0.2, 0.3), position=(0.0,) * dim,
        angular_velocity=10.0 if dim == 2 else (0.0, 0.0, 10.0),
    )  # fmt: skip
    hinge = fmbd.revolute("hinge", fmbd.ground, wheel, center=(0.0,) * dim, axis=(0, 0, 1))
    scene = fmbd.Scene("to and fro")
    scene.add(wheel, hinge, fmbd.joint_limit("stops", fmbd.angle(hinge), lower=-1.0, upper=7.0, restitution=0.8))
    scene.sensor("phi", fmbd.angle(hinge))
    scene.sensor("rate", fmbd.sensors.joint_rate(fmbd.angle(hinge)))
    run = fmbd.solve(scene, t_end=3.0, dt=0.02)

    # 7 rad at 10 rad/s, back 8 rad at 8 rad/s, 8 rad at 6.4 rad/s
    t = run.times
    exact = np.where(t < 0.7, 10 * t, np.where(t < 1.7, 7 - 8 * (t - 0.7), -1 + 6.4 * (t - 1.7)))
    exact = np.where(t > 2.95, 7 - 5.12 * (t - 2.95), exact)
    assert np.allclose(run["phi"][:, 0], exact, atol=1e-9)
    assert run["rate"][-1, 0] == pytest.approx(-5.12, rel=1e-9)


@pytest.mark.parametrize("calls", ["many", "one", "none"])
def test_dry_friction_turns_with_the_impact(calls: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A slide between two stops: friction pushed along from each impact to the end of its step, 3.5e-2 m off at rest."""
    if calls == "none":
        monkeypatch.setattr(driver, "contact_driver", lambda *_, **__: None)
    if calls == "one":
        monkeypatch.setattr(CompiledMoreauStepper, "march", lambda *_, **__: 0)
    slide = fmbd.RigidBody("slide", 2.0, 1.0, (0.0, 0.0), velocity=(5.0, 0.0))
    rail = fmbd.prismatic("rail", fmbd.ground, slide, axis=(1, 0))
    x, scene = fmbd.displacement(rail), fmbd.Scene("to and fro", gravity=(0.0, 0.0))
    scene.add(slide, rail, fmbd.joint_limit("stops", x, lower=-0.5, upper=0.5, restitution=0.8))
    scene.add(fmbd.dry_friction("rub", x, limit=4.0, stick=1e7))
    scene.sensor("x", x)
    scene.sensor("v", fmbd.sensors.joint_rate(x))
    scene.sensor("rub", fmbd.element_effort("rub"))
    run = fmbd.solve(scene, t_end=2.0, dt=0.02, output=fmbd.Output(times=np.linspace(0.0, 2.0, 401)))

    # half the square of the speed falls by 2 m/s^2 times the way; an impact leaves 0.64 of it
    stop, left = 0.5, 0.64 * (12.5 - 2.0 * 0.5)
    while left > 2.0:
        stop, left = -stop, 0.64 * (left - 2.0)
    assert run["x"][-1, 0] == pytest.approx(stop - np.sign(stop) * left / 2.0, abs=1e-4)
    slides = np.abs(run["v"][:, 0]) > 0.05
    assert (run["v"] * run["rub"])[slides].max() < 0.0


@pytest.mark.parametrize("restitution", [0.8, 0.0])
@pytest.mark.parametrize("compiled", [True, False])
def test_short_steps_have_their_impacts_when_they_come(
    compiled: bool, restitution: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A slide on a spring meets its stops: in steps of 10 us a fast impact begins as near to them as a slow one."""
    if not compiled:
        monkeypatch.setattr(driver, "contact_driver", lambda *_, **__: None)

    def end(h: float) -> tuple[float, float]:
        """Where it is (m) at last, and impacts."""
        slide = fmbd.RigidBody("slide", 2.0, 1.0, (0.0, 0.0), velocity=(-0.3, 0.0))
        rail = fmbd.prismatic("rail", fmbd.ground, slide, axis=(1, 0))
        x, scene = fmbd.displacement(rail), fmbd.Scene("stops", gravity=(-1.0, 0.0))
        stops = fmbd.joint_limit("stops", x, lower=-1.004e-3, upper=0.5, restitution=restitution)
        scene.add(slide, rail, stops, fmbd.joint_spring("spring", x, stiffness=30.0, damping=1.0))
        scene.sensor("x", x)
        run = fmbd.solve(scene, t_end=0.006, dt=h, scheme=fmbd.schemes.Moreau())
        return float(run["x"][-1, 0]), run.counters["impacts"]

    (fine, few), (coarse, many) = end(1e-5), end(2e-4)
    assert few == many == 1.0
    assert fine == pytest.approx(coarse, abs=1e-7)


@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_arm_rests_on_its_stop_and_leaves_it(unit: float) -> None:
    """Without restitution the arm stays, held by the torque of its weight; a motor lifts it off again."""
    arm = fmbd.RigidBody("arm", 2.0, 0.1 * unit**2, position=(0.5 * unit, 0.0))
    hinge = fmbd.revolute("hinge", fmbd.ground, arm, center=(0, 0))
    stop = fmbd.joint_limit("stop", fmbd.angle(hinge), lower=-0.4)
    scene = fmbd.Scene("arm", gravity=(0.0, -G * unit))
    torque = 2.0 * G * 0.5 * unit**2
    lift = fmbd.effort("lift", fmbd.angle(hinge), lambda t: 0.0 if t < 1.0 else 1.5 * torque)
    scene.add(arm, hinge, stop, lift)
    scene.sensor("phi", fmbd.angle(hinge))
    scene.sensor("torque", fmbd.sensors.limit_effort(stop))
    run = fmbd.solve(scene, t_end=1.3, dt=0.01)
    resting = (run.times > 0.7) & (run.times < 0.99)
    assert np.allclose(run["phi"][resting, 0], -0.4, atol=1e-7)
    assert np.allclose(run["torque"][resting, 0], torque * np.cos(0.4), rtol=1e-4)
    assert run["phi"][-1, 0] > -0.35 and run["torque"][-1, 0] == 0.0


@pytest.mark.mpi
def test_elastic_arm_hits_its_stop(rod_mesh: Callable[..., Any]) -> None:
    """The surface in the joint bounces and comes to rest, the rod bends on: the same with all nodes and with few modes."""
    rod = fmbd.FloatingBody(
        "rod", rod_mesh(dim=2, h=0.25), density=1e3, elastic=linear_elastic(5e7, 0.3), stiffness_damping=2e-4
    )
    tips = []
    for body in (rod, rod.reduced(basis=fmbd.CraigBampton(("pin", "tip"), 4))):
        hinge = fmbd.revolute("hinge", fmbd.ground, body.surface("pin"), center=(0, 0))
        stop = fmbd.joint_limit("stop", fmbd.angle(hinge), lower=-0.1, restitution=0.5)
        scene = fmbd.Scene("elastic arm", gravity=(0, -G))
        scene.add(body, hinge, stop)
        scene.sensor("phi", fmbd.angle(hinge))
        scene.sensor("tip", fmbd.position(body.surface("tip")))
        run = fmbd.solve(scene, t_end=0.18, dt=1e-3)
        tips.append(run["tip"])

        assert run["phi"].min() > -0.1 - 1e-5
        assert np.diff(run.total_energy).max() < 1e-6 * np.ptp(run.energy["weight"])
        assert run["tip"][-1, 1] < -0.19  # it bends: straight it would be at -0.1
    assert np.abs(tips[0] - tips[1]).max() < 2e-4


def test_beam_hits_its_stop() -> None:
    """A body without a mesh, whose modes are in the core."""
    section = fmbd.Section.rectangle(youngs_modulus=7e10, poisson_ratio=0.3, density=2700.0, width=0.02, height=0.05)
    beam = fmbd.Beam("beam", (0.0, 0.0), (1.0, 0.0), section, modes=4, stiffness_damping=1e-4)
    hinge = fmbd.revolute("hinge", fmbd.ground, beam.surface("start"), center=(0, 0))
    scene = fmbd.Scene("beam", gravity=(0, -G))
    scene.add(beam, hinge, fmbd.joint_limit("stop", fmbd.angle(hinge), lower=-0.1))
    scene.sensor("phi", fmbd.angle(hinge))
    run = fmbd.solve(scene, t_end=0.18, dt=1e-3)
    assert -0.1 - 1e-5 < run["phi"].min() < -0.0999


def test_hammer_on_a_hinge_gives_back_its_restitution() -> None:
    """The end of the flight is found on the motion that the joint allows: no impact is taken for a resting contact."""
    hammer = fmbd.RigidBody("hammer", 2.0, 0.1, position=(0.5, 0.0))
    hinge = fmbd.revolute("hinge", fmbd.ground, hammer, center=(0, 0))
    anvil = fmbd.contacts.Obstacle("anvil", fmbd.contacts.HalfSpace((0.0, -0.3), (0, 1)))
    scene = fmbd.Scene("hammer", gravity=(0.0, -G))
    scene.add(hammer, hinge, fmbd.contact("blow", fmbd.contacts.ball(hammer, 0.1), anvil, restitution=0.6))
    scene.sensor("phi", fmbd.angle(hinge))
    scene.sensor("rate", fmbd.sensors.joint_rate(fmbd.angle(hinge)))
    run = fmbd.solve(scene, t_end=0.3, dt=2.5e-3, scheme=fmbd.Moreau())

    # (m l^2 + J) w^2 / 2 = m g l sin, the ball touches at sin = 0.2 / 0.5
    falling = np.sqrt(2 * 2.0 * G * 0.2 / 0.6)
    up = run["rate"][:, 0].argmax()
    energy = 0.3 * run["rate"][up, 0] ** 2 + 2.0 * G * 0.5 * np.sin(run["phi"][up, 0])
    assert energy == pytest.approx(0.3 * (0.6 * falling) ** 2 - 2.0 * G * 0.2, rel=2e-3)


@pytest.mark.parametrize("dim", [2, 3])
def test_beside_frictional_contact(dim: int) -> None:
    """A limited slider next to a ball that rolls on the floor: neither disturbs the other."""
    inertia: Any = 0.1 if dim == 2 else (0.1, 0.1, 0.1)
    up = (0.0, 1.0, 0.0)[:dim]
    mass = fmbd.RigidBody("mass", 2.0, inertia, position=(0.0,) * dim)
    ball = fmbd.RigidBody("ball", 1.0, inertia, position=(2.0, 0.1, 0.0)[:dim], velocity=(1.0, 0.0, 0.0)[:dim])
    rail = fmbd.prismatic("rail", fmbd.ground, mass, axis=up)
    floor = fmbd.contacts.Obstacle("floor", fmbd.contacts.HalfSpace((0.0,) * dim, up))
    scene = fmbd.Scene("both", gravity=tuple(-G * x for x in up))
    scene.add(mass, ball, rail, fmbd.joint_limit("stop", fmbd.displacement(rail), lower=-0.2, restitution=0.7))
    scene.add(fmbd.contact("floor", fmbd.contacts.ball(ball, 0.1), floor, friction=0.3))
    scene.sensor("s", fmbd.displacement(rail))
    scene.sensor("ball", fmbd.velocity(ball))
    run = fmbd.solve(scene, t_end=0.3, dt=1e-2)
    assert np.allclose(run["s"][:, 0], bouncing(run.times, 0.2, 0.7), atol=1e-9)
    assert np.allclose(run["ball"][:, 0], 1.0 - 0.3 * G * run.times, atol=1e-9)  # it slides for 0.309 s


def test_beside_contact_of_many_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A limited slider next to a soft bar on the floor, whose rows are applied, not stored: each moves as alone."""
    monkeypatch.setattr("fmbd_fenicsx.linear.complementarity.delassus.MANY", 1)
    mesh = fmbd.read_gmsh(BLOCK, size=(1.0, 0.1), counts=(8, 1), quads=True)

    def fallen(*wanted: str) -> Any:
        scene = fmbd.Scene("both", gravity=(0.0, -G))
        if "slider" in wanted:
            mass = fmbd.RigidBody("mass", 2.0, 0.1, position=(0.0, 0.0))
            rail = fmbd.prismatic("rail", fmbd.ground, mass, axis=(0, 1))
            scene.add(mass, rail, fmbd.joint_limit("stop", fmbd.displacement(rail), lower=-0.2, restitution=0.7))
            scene.sensor("s", fmbd.displacement(rail))
        if "bar" in wanted:
            bar = fmbd.AbsoluteBody("bar", mesh, degree=1, density=1e3, elastic=linear_elastic(1e6, 0.3))
            floor = fmbd.Obstacle("floor", fmbd.contacts.HalfSpace((0.0, -0.001), (0.0, 1.0)))
            scene.add(bar, fmbd.contact("floor", bar.surface("bottom"), floor, redistribute_mass=False))
            scene.sensor("impulse", fmbd.contact_impulse("floor"))
        return fmbd.solve(scene, t_end=0.3, dt=2e-3, scheme=fmbd.Moreau())

    both = fallen("slider", "bar")
    assert np.allclose(both["s"][:, 0], bouncing(both.times, 0.2, 0.7), atol=1e-9)
    alone = fallen("bar")["impulse"]
    assert alone.max() > 10.0
    # the stop's impacts are met within steps of their own
    assert np.allclose(both["impulse"], alone, atol=5e-3 * alone.max())


def test_bad_input_is_named() -> None:
    arm = fmbd.RigidBody("arm", 1.0, 0.1, position=(0.5, 0.0))
    hinge = fmbd.revolute("hinge", fmbd.ground, arm, center=(0, 0))
    with pytest.raises(InputError, match='Joint limit "stop": lower = 1.0 must be less than upper = 0.5'):
        fmbd.joint_limit("stop", fmbd.angle(hinge), lower=1.0, upper=0.5)
    with pytest.raises(InputError, match="give lower, upper, or both"):
        fmbd.joint_limit("stop", fmbd.angle(hinge))
    with pytest.raises(InputError, match=r"restitution 1.2 must lie in \[0, 1\]"):
        fmbd.joint_limit("stop", fmbd.angle(hinge), lower=0.0, restitution=1.2)
    with pytest.raises(InputError, match="lower"):
        fmbd.joint_limit("stop", fmbd.angle(hinge), lower=float("nan"))
    with pytest.raises(InputError, match="stops one joint coordinate"):
        fmbd.joint_limit("stop", 2.0 * fmbd.angle(hinge), lower=-1.0)

    scene = fmbd.Scene("arm")
    scene.add(arm, fmbd.joint_limit("stop", fmbd.angle(hinge), lower=-1.0))
    with pytest.raises(InputError, match='joint limit "stop" of "hinge": joint "hinge" is not in the scene'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)
    scene.add(hinge)
    with pytest.raises(
        InputError, match=r'alpha.* has no impacts, and the scene has the joint limit "stop". Use fmbd.Moreau\(\)'
    ):
        fmbd.solve(scene, t_end=0.1, dt=0.01, scheme=fmbd.GeneralizedAlpha())
    with pytest.raises(InputError, match="joint limit.*no impact law"):
        fmbd.solve(scene, t_end=0.1, dt=0.01, scheme=fmbd.ContactMidpoint())
    low = fmbd.Scene("starts below")
    low.add(arm, hinge, fmbd.joint_limit("stop", fmbd.angle(hinge), lower=0.2))
    with pytest.raises(InputError, match='Joint limit "stop": the joint begins 0.2 rad beyond its stop'):
        fmbd.solve(low, t_end=0.1, dt=0.01)
