"""Gravity over time: in every scheme, for every body, switched at once, and in the books."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd

MESHES = Path(__file__).resolve().parents[1] / "meshes"
G, RATE, COMES = 9.81, 2.0, 0.31234
MASS, ARM, INERTIA = 1.3, 0.4, 0.02
SCHEMES = {
    fmbd.GeneralizedAlpha(): 1e-3,
    fmbd.GeneralizedAlpha(form=fmbd.GGL()): 1e-3,
    fmbd.Radau(3, rtol=None): 1e-8,
    fmbd.BDF(2, fmbd.GGL(), rtol=None): 3e-3,
    fmbd.Rattle(): 5e-4,
    fmbd.HalfExplicit(): 1e-6,
    fmbd.ExplicitRungeKutta(): 1e-9,
    fmbd.EnergyMomentum(): 5e-4,
}


def turning(t: float) -> tuple[float, float]:
    """Of a laboratory that is tilted more and more."""
    return G * np.sin(RATE * t), -G * np.cos(RATE * t)


def switched(t: float) -> tuple[float, float]:
    """It comes at once."""
    return (0.0, -G) if t > COMES else (0.0, 0.0)


def pendulum(gravity: Any) -> fmbd.Scene:
    """It swings from the side."""
    scene = fmbd.Scene("pendulum", gravity=gravity)
    body = fmbd.RigidBody("body", MASS, INERTIA, position=(ARM, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, body, center=(0, 0))
    scene.add(body, pin)
    scene.sensor("angle", fmbd.angle(pin))
    scene.sensor("force", fmbd.reaction_force(pin))
    return scene


def swing(t_end: float, gravity: Any) -> tuple[np.ndarray, np.ndarray]:
    """Angle and force on the ground at the end, by an independent integration."""

    def second(t: float, angle: float) -> float:
        gx, gy = gravity(t)
        return MASS * ARM * (gy * np.cos(angle) - gx * np.sin(angle)) / (INERTIA + MASS * ARM**2)

    done = solve_ivp(lambda t, y: (y[1], second(t, y[0])), (0.0, t_end), (0.0, 0.0), rtol=1e-11, atol=1e-12)
    angle, rate = done.y[:, -1]
    across, along = np.array([-np.sin(angle), np.cos(angle)]), np.array([np.cos(angle), np.sin(angle)])
    return angle, MASS * (np.array(gravity(t_end)) - ARM * (second(t_end, angle) * across - rate**2 * along))


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda x: x.name)
def test_gravity_that_turns_in_every_scheme(scheme: Any) -> None:
    """Angle and reaction are those of an independent integration."""
    run = fmbd.solve(pendulum(turning), t_end=1.0, dt=5e-3, scheme=scheme)
    angle, force = swing(1.0, turning)
    assert abs(run["angle"][-1, 0] - angle) < SCHEMES[scheme]
    assert np.abs(run["force"][-1] - force).max() < 50.0 * SCHEMES[scheme] + 1e-3


def test_gravity_that_comes_at_once() -> None:
    """Steps end where it comes, with a tolerance and with steps of a scheme's own choice."""
    angle, _ = swing(1.0 - COMES, lambda t: (0.0, -G))
    run = fmbd.solve(pendulum(switched), t_end=1.0, tol={"angle": 1e-5})
    assert abs(run["angle"][-1, 0] - angle) < 1e-5
    own = fmbd.solve(pendulum(switched), t_end=1.0, scheme=fmbd.Radau(3))
    assert abs(own["angle"][-1, 0] - angle) < 1e-5


def bodies() -> dict[str, Any]:
    """A soft strip in every placement; of two densities what a load would not weigh."""
    mesh = fmbd.read_gmsh(MESHES / "rod.py", h=0.1)
    data: dict[str, Any] = {"density": 1000.0}
    linear = data | {"elastic": fmbd.materials.plane_stress(1e8, 0.3)}
    large = data | {"energy": fmbd.materials.sheet_saint_venant_kirchhoff(1e8, 0.3)}
    floating = fmbd.FloatingBody("strip", mesh, **linear)
    return {"floating": floating, "absolute": fmbd.AbsoluteBody("strip", mesh, **large), "reduced": floating}


@pytest.mark.parametrize("placed", ["floating", "absolute", "reduced"])
def test_gravity_in_time_is_a_load_per_volume(placed: str) -> None:
    """Of elastic bodies it does what a body force does."""
    body, ends = bodies()[placed], []
    pulls = [
        fmbd.body_force((1e3, 0.0), time=lambda t: turning(t)[0]),
        fmbd.body_force((0.0, 1e3), time=lambda t: turning(t)[1]),
    ]
    for gravity, loads in ((turning, ()), (None, pulls)):
        strip = body.with_(loads=loads)
        strip = strip.reduced(modes=6) if placed == "reduced" else strip
        scene = fmbd.Scene("strip", gravity=gravity)
        scene.add(strip, fmbd.revolute("pin", fmbd.ground, strip.surface("pin"), center=(0, 0)))
        scene.sensor("tip", fmbd.position(strip.surface("tip")))
        scene.sensor("force", fmbd.reaction_force("pin"))
        run = fmbd.solve(scene, t_end=0.2, dt=5e-3)
        ends.append(np.concatenate((run["tip"][-1], 1e-3 * run["force"][-1])))
    assert np.abs(ends[0] - ends[1]).max() < 1e-7


def test_its_work_is_in_the_books_and_no_energy_of_the_weight() -> None:
    """What it gives is what the body has."""
    run = fmbd.solve(pendulum(turning), t_end=1.0, dt=1e-3, output=fmbd.Output(ledger=True))
    assert not np.any(run.energy["weight"])
    assert run.ledger.work["gravity"][-1] == pytest.approx(run.energy["kinetic"][-1], rel=1e-4)
    assert "gravity that changes" in run.report()


def test_equilibrium_under_the_gravity_of_a_time() -> None:
    """It hangs along it."""
    scene = pendulum(turning)
    assert fmbd.equilibrium(scene, t=0.3)["angle"][0] == pytest.approx(0.6 - 0.5 * np.pi, abs=1e-9)


@pytest.mark.parametrize(
    ("gravity", "words"),
    [
        (lambda: (0, -G), "must be a function of 1 argument"),
        (lambda t: -G, r"gravity\(0\) -9.81 must be 2 finite numbers"),
        (lambda t: (0.0, np.nan if t > 0.1 else -G), r"gravity\(0.1"),
        (lambda t: 1 / 0, 'gravity of scene "pendulum" failed at t = 0 s'),
        ("down", "must be a vector of finite numbers, or a function of time"),
    ],
)
def test_functions_that_are_none(gravity: Any, words: str) -> None:
    """One error that says what."""
    with pytest.raises(fmbd.errors.InputError, match=words):
        fmbd.solve(pendulum(gravity), t_end=0.2, dt=0.01)


@pytest.mark.parametrize("given", [(0.0, 0.0, 0.0, -9.81), (-9.81,)])
def test_gravity_of_no_dimension_is_refused_where_it_is_given(given: Any) -> None:
    with pytest.raises(fmbd.errors.InputError, match="must be 2 or 3 finite numbers"):
        fmbd.Scene("scene", gravity=given)
