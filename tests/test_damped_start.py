"""Starts of generalized-alpha that damping ends within a step: against a speed, under loads at once on stiff bodies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from honesty_scenes import swinging_beam

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import linear_elastic
from fmbd_fenicsx.schemes.onestep.alpha.alpha_stepper import AlphaStepper

FORMS = (fmbd.Index3(), fmbd.GGL())
MESHES = Path(__file__).parents[1] / "meshes"
INERTIA = 1.1  # of the pendulum about its pin, kg m^2


def pendulum(damping: float, stiffness: float = 0.0, angle: float = 0.0, rate: float = 0.0) -> fmbd.Scene:
    """A bob of 1 kg on an arm of 1 m, a rotational damper and a spring in its pin."""
    c, s = np.cos(angle), np.sin(angle)
    bob = fmbd.RigidBody("bob", 1.0, 0.1, (c, s), angle, velocity=(-rate * s, rate * c), angular_velocity=rate)
    pin = fmbd.revolute("pin", fmbd.ground, bob, center=(0, 0))
    scene = fmbd.Scene("damped")
    turn = fmbd.joint_spring("damper", fmbd.angle(pin), stiffness=stiffness, damping=damping, free=-angle)
    scene.add(bob, pin, turn)
    scene.sensor("x", fmbd.position(bob))
    scene.sensor("v", fmbd.velocity(bob))
    scene.sensor("lambda", fmbd.reaction("pin"))
    return scene


def solved(scene: fmbd.Scene, t_end: float, dt: float, **more: Any) -> fmbd.Run:
    """A run with tight Newton; ``more``: of the scheme."""
    scheme = fmbd.GeneralizedAlpha(**{"rho_inf": 0.8, **more})
    return fmbd.solve(scene, t_end=t_end, dt=dt, scheme=scheme, newton=fmbd.Newton(tolerance=1e-9))


@pytest.mark.parametrize("form", FORMS, ids=lambda f: f.name)
def test_damper_takes_a_speed_within_a_step(form: Any) -> None:
    """The speed w is gone after I / c = 1e-5 s: the pendulum has turned by w I / c = 5.5e-5, where it stays."""
    run = solved(pendulum(INERTIA / 1e-5, rate=5.0), 0.2, 1e-2, form=form)
    assert np.abs(run["x"][1:, 1] - 5e-5).max() < 1e-6
    assert run.counters["damped_steps"] >= 1


def creeping(c: float, rate: float = 0.0) -> fmbd.Scene:
    """A body of 1 kg that its weight pulls along a guide, against a damper alone (N s/m)."""
    body = fmbd.RigidBody("body", 1.0, 1.0, (0.0, 0.0), velocity=(rate, 0.0))
    guide = fmbd.prismatic("guide", fmbd.ground, body, axis=(1, 0), center=(0, 0))
    damper = fmbd.joint_spring("damper", fmbd.displacement(guide), stiffness=0.0, damping=c)
    scene = fmbd.Scene("creeping", gravity=(-9.81, 0.0))
    scene.add(body, guide, damper)
    scene.sensor("x", fmbd.position(body))
    return scene


@pytest.mark.parametrize("form", FORMS, ids=lambda f: f.name)
def test_load_at_once_against_a_strong_damper_alone(form: Any) -> None:
    """Of a_0 a step leaves g m / (c h), 1e-6 m/s^2, but nothing takes h^2 a_0 back: x = v t, v = -m g / c."""
    speed = 9.81 / 1e9
    run = solved(creeping(1e9), 0.2, 1e-2, form=form)
    assert np.abs(run["x"][1:, 0] + speed * run.times[1:]).max() < 1e-3 * speed
    assert run.counters["damped_steps"] == 4


@pytest.mark.parametrize("rate", [0.0, 1.0])
@pytest.mark.parametrize("more", [{"form": form} for form in FORMS] + [{"compiled": False}], ids=str)
def test_own_steps_count_what_a_damper_alone_does_not_give_back(rate: float, more: dict[str, Any]) -> None:
    """The body stands within 1e-12 s. Filters with the damping hid accelerations that swing on: 3 mm off, 7 cm with the speed."""
    run = fmbd.solve(creeping(1e12, rate), t_end=2.0, scheme=fmbd.GeneralizedAlpha(rtol=1e-4, **more))
    assert np.abs(run["x"]).max() < 1e-10
    assert run.counters["steps"] < 400


@pytest.mark.parametrize("form", FORMS, ids=lambda f: f.name)
def test_order_two_behind_a_layer(form: Any) -> None:
    """A spring of rate k / c = 5 / s begins at once against the damper: places, velocities and reactions of the slow motion."""
    slow, fast = sorted(np.roots([INERTIA, 1e6, 5e6]), key=abs)
    size, errors = fast / (fast - slow), []
    for n in (20, 40, 80):
        run = solved(pendulum(1e6, 5e6, angle=1.0), 0.4, 0.4 / n, form=form)
        assert run.counters["damped_steps"] >= 1
        turn = size * np.exp(slow * run.times)
        exact = np.column_stack((np.cos(turn), np.sin(turn)))
        speed = slow * turn[:, None] * np.column_stack((-exact[:, 1], exact[:, 0]))
        late = run.times > 0.11  # the last of the layer
        push = np.linalg.norm(run["lambda"], axis=1) - slow**2 * turn * np.hypot(turn, 1.0)
        misses = run["x"][1:] - exact[1:], (run["v"] - speed)[late], push[late]
        errors.append([np.abs(x).max() for x in misses])
    e = np.array(errors)
    assert (np.log2(e[:-1] / e[1:]) > 1.7).all(), e


def rod(mesh: Any, kind: Any, E: float, **more: Any) -> fmbd.Scene:
    """A damped rod whose pin is driven with a speed from the first instant on, while all of it is at rest."""
    body = kind("rod", mesh, density=1e3, elastic=linear_elastic(E, 0.3), stiffness_damping=0.1, **more)
    scene = fmbd.Scene("driven")
    pin = fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0, 0))
    scene.add(body, pin, fmbd.drive("turn", fmbd.angle(pin), lambda t: 2.0 * t))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return scene


@pytest.mark.parametrize("E", [1e9, 2e11])
@pytest.mark.parametrize(
    ("kind", "more"),
    [(fmbd.FloatingBody, {}), (fmbd.FloatingBody, {"frame": fmbd.Attached("pin")}), (fmbd.AbsoluteBody, {})],
    ids=["mean axes", "attached", "absolute"],
)
def test_drive_that_starts_with_a_speed(rod_mesh: Callable[..., Any], kind: Any, more: Any, E: float) -> None:
    """a_0 is that of a layer beside the pin, up to 6e9 m/s^2; the rod follows within its bending of 0.002 rad and less."""
    run = solved(rod(rod_mesh(dim=2, h=0.2), kind, E, **more), 0.02, 1e-3)
    turned = np.arctan2(run["tip"][:, 1], run["tip"][:, 0]) - 2.0 * run.times
    assert np.abs(turned).max() < 2.5e-3
    assert abs(turned[-1]) < 2e-3
    assert not run.counters.get("halved_steps")


@pytest.mark.parametrize("compiled", [True, False])
def test_load_at_once_on_a_body_that_keeps_its_volume(rod_mesh: Callable[..., Any], compiled: bool) -> None:
    """A light strip creeps as sigma L / (4 mu) (1 - exp(-t / beta)), in plane strain, and its clamp holds the load at once."""
    E, beta, sigma = 1e6, 0.05, 2e4
    body = fmbd.AbsoluteBody(
        "strip",
        rod_mesh(dim=2, h=0.2, height=0.1),
        density=1.0,
        energy=fmbd.materials.neo_hookean_incompressible(E),
        stiffness_damping=beta,
        loads=[fmbd.loads.traction("tip", (sigma, 0.0))],
    )
    scene = fmbd.Scene("creep")
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("pin")))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    scene.sensor("clamp", fmbd.reaction_force("clamp"))
    run = solved(scene, 0.08, 8e-3, compiled=compiled)
    assert run.counters["damped_steps"] >= 1
    assert not run.counters.get("halved_steps")
    assert run["tip"][:, 1] == pytest.approx(0.0, abs=1e-6)
    stretch = run["tip"][:, 0] - 1.0
    assert stretch == pytest.approx(sigma / (4 / 3 * E) * (1.0 - np.exp(-run.times / beta)), abs=3e-4)
    assert np.abs(run["clamp"][2:, 0]) == pytest.approx(sigma * 0.1, rel=2e-3)


@pytest.mark.parametrize("t_load", [0.0, 0.1])
def test_load_at_once_on_a_stiff_panel(rod_mesh: Callable[..., Any], t_load: float) -> None:
    """A step of a hundred periods: the panel goes to its equilibrium, within a fifth of the deflection, and stays."""
    body = fmbd.FloatingBody(
        "panel",
        rod_mesh(dim=2, h=0.1, height=0.1),
        density=7800.0,
        elastic=linear_elastic(2e11, 0.3),
        stiffness_damping=1e-3,
    )
    scene = fmbd.Scene("load", breakpoints=[t_load] if t_load else [])
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("pin"), center=(0, 0)))
    scene.add(
        fmbd.force("load", body.surface("tip"), lambda t: np.array([0.0, -1e4 if t > t_load or not t_load else 0.0]))
    )
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    run = solved(scene, t_load + 1.0, 0.1)
    down = -run["tip"][run.times > t_load + 1e-9, 1]
    assert down[-1] > 1e-6
    assert np.abs(down / down[-1] - 1.0).max() < 0.2


def test_starts_that_no_damping_ends_stay_as_they_are(rod_mesh: Callable[..., Any], monkeypatch: Any) -> None:
    """Not one bit: a pendulum with a damper that acts over twenty steps, a soft rod that falls, a stiff beam that vibrates."""
    body = fmbd.FloatingBody("rod", rod_mesh(dim=2, h=0.2), density=1e3, elastic=linear_elastic(1e7, 0.3))
    falling = fmbd.Scene("falling", gravity=(0, -9.81))
    falling.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0, 0)))
    falling.sensor("x", fmbd.position(body.surface("tip")))
    beam = swinging_beam(fmbd.velocity, ramp=0.0, EI=2e3)
    found: list[list[Any]] = []
    for damps in (True, False):
        monkeypatch.setattr(AlphaStepper, "damps", damps)
        runs = [solved(pendulum(5.0, rate=5.0), 0.2, 1e-2), solved(falling, 0.02, 1e-3), solved(beam, 0.08, 8e-3)]
        assert not any(run.counters.get("damped_steps") for run in runs)
        found.append([runs[0]["x"], runs[1]["x"], runs[2]["seen"]])
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("frame", [fmbd.Attached("left"), fmbd.MeanAxis()], ids=["attached", "mean axes"])
def test_sudden_axial_force_on_a_stiffened_column(frame: Any, compiled: bool) -> None:
    """h^2 a_0 is 9 mm at the end of a hinged column under 0.3 of its buckling load at once, pushed aside for half a period T of
    its bending. By modes along and across, DOP853: 1.22e-5 m, at T/2 -5.82e-6.
    """
    E, rho, H = 1e9, 1000.0, 0.02
    load, w = np.pi**2 * E * H**3 / 12, np.pi**2 * np.sqrt(E * H**2 / 12 / rho)
    mesh = fmbd.read_gmsh(MESHES / "block.py", size=(1.0, H), counts=(16, 1), origin=(0, -H / 2))
    elastic = fmbd.materials.plane_stress(E, 0.0)
    body = fmbd.FloatingBody("b", mesh, density=rho, elastic=elastic, frame=frame, stiffening="left")
    scene = fmbd.Scene("column", gravity=lambda t: (0.0, -0.01 * np.sin(w * t) if w * t < np.pi else 0.0))
    scene.add(body, fmbd.revolute("a", fmbd.ground, body.surface("left"), center=(0, 0)))
    scene.add(fmbd.point_on_line("r", fmbd.ground, body.surface("right"), center=(1.0, 0), axis=(1, 0)))
    scene.add(fmbd.force("push", body.surface("right"), lambda t: (-0.3 * load * np.cos(2 * w * t), 0.0)))
    scene.sensor("mid", fmbd.position(body, point=(0.5, 0)))

    T = 2 * np.pi / w
    run = fmbd.solve(
        scene, t_end=(3.0 if compiled else 0.5) * T, dt=T / 80, scheme=fmbd.GeneralizedAlpha(compiled=compiled)
    )
    y = run["mid"][:, 1]
    assert y[40] == pytest.approx(-5.82e-6, rel=0.01)
    if compiled:
        assert np.abs(y).max() == pytest.approx(1.22e-5, rel=0.04)
    assert not run.counters.get("halved_steps")


def test_damped_starts_go_on_from_a_checkpoint_and_in_compiled_code(
    rod_mesh: Callable[..., Any], tmp_path: Path
) -> None:
    """From between two damped steps to the same bits; steps of NumPy alone are the same to roundoff."""
    scene = rod(rod_mesh(dim=2, h=0.2), fmbd.FloatingBody, 2e11)
    whole = solved(scene, 0.02, 1e-3)
    assert whole.counters["damped_steps"] > 2
    arguments: dict[str, Any] = {
        "dt": 1e-3,
        "scheme": fmbd.GeneralizedAlpha(0.8),
        "newton": fmbd.Newton(tolerance=1e-9),
    }
    fmbd.solve(scene, t_end=0.02, checkpoint=fmbd.Checkpoint(tmp_path, every=2, keep=100), **arguments)
    again = fmbd.solve(scene, t_end=0.02, restart=min(tmp_path.glob("*_step2*")), **arguments)
    np.testing.assert_array_equal(again["tip"][-1], whole["tip"][-1])
    np.testing.assert_allclose(solved(scene, 0.02, 1e-3, compiled=False)["tip"], whole["tip"], atol=1e-9)


def test_own_steps_resolve_the_layer(rod_mesh: Callable[..., Any]) -> None:
    """They begin as small as the layer asks for, and damp nothing."""
    run = fmbd.solve(
        rod(rod_mesh(dim=2, h=0.2), fmbd.FloatingBody, 1e9),
        t_end=0.02,
        dt=1e-3,
        scheme=fmbd.GeneralizedAlpha(0.8, rtol=1e-4),
    )
    turned = np.arctan2(run["tip"][:, 1], run["tip"][:, 0]) - 2.0 * run.times
    assert np.abs(turned).max() < 2.5e-3
    assert not run.counters.get("damped_steps")
