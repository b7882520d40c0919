"""Elastic bodies do not see where, how turned and how fast their scene is: a moved scene goes on alike, to roundoff."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear import condensation
from fmbd_fenicsx.materials import linear_elastic, saint_venant_kirchhoff

ANGLE, BOOST, SHIFT = 0.9, np.array([3.0, -2.0]), np.array([5.0, 1.0])  # rad, m/s, m
Q = np.array([[np.cos(ANGLE), -np.sin(ANGLE)], [np.sin(ANGLE), np.cos(ANGLE)]])
QUIET = fmbd.Output(estimate_error=False)
FRAMES = {"mean": fmbd.MeanAxis(), "attached": fmbd.Attached("pin"), "chord": fmbd.Chord("pin", "tip")}


def run_of(rod_mesh: Callable[..., Any], kind: str, moved: bool) -> fmbd.Run:
    """A vibrating, spinning rod that drags a disk on a hinge under gravity; as it is, or rotated, shifted and flying."""
    R, c, V = (Q, SHIFT, BOOST) if moved else (np.eye(2), np.zeros(2), np.zeros(2))
    mesh = rod_mesh(dim=2, h=0.25, height=0.2)
    mesh = mesh.placed(SHIFT, ANGLE) if moved else mesh

    def bent(X: Any) -> Any:
        y = R.T @ (X - c[:, None])
        return 2.0 * R @ np.array([-2 * (y[0] - 0.5) * y[1], (y[0] - 0.5) ** 2])

    common = {"density": 1000.0, "velocity": R @ [0.0, 0.5] + V, "angular_velocity": 1.0, "displacement_rate": bent}
    if kind == "absolute":
        rod: Any = fmbd.AbsoluteBody("rod", mesh, energy=saint_venant_kirchhoff(5e6, 0.3), **common)
    else:
        name, _, how = kind.partition(", ")
        rod = fmbd.FloatingBody("rod", mesh, elastic=linear_elastic(5e6, 0.3), frame=FRAMES[name], **common)
        rod = rod.reduced(basis=fmbd.CraigBampton(("tip",), 4)) if how else rod
    disk = fmbd.RigidBody("disk", 40.0, 2.0, position=R @ [1.0, -0.3] + c, velocity=R @ [0.0, 1.0] + V)
    scene = fmbd.Scene("flight", gravity=R @ [0.0, -9.81])
    scene.add(rod, disk, fmbd.revolute("hinge", rod.surface("tip"), disk, center=R @ [1.0, 0.0] + c))
    scene.sensor("pin", fmbd.position(rod.surface("pin")))
    scene.sensor("disk", fmbd.position(disk))
    return fmbd.solve(scene, t_end=0.06, dt=2e-3, newton=fmbd.Newton(1e-10, max_iterations=40), output=QUIET)


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["mean", "attached", "chord", "mean, reduced", "attached, reduced", "absolute"])
def test_superposed_rigid_motion(rod_mesh: Callable[..., Any], kind: str) -> None:
    """Every placement and frame; Newton takes as many iterations, but for steps whose last increment lies at its tolerance:
    the largest component of an increment depends on the axes, and here iterations come in pairs.
    """
    here, there = (run_of(rod_mesh, kind, moved) for moved in (False, True))
    assert np.ptp(here["pin"][:, 1]) > 1e-3
    for name in ("pin", "disk"):
        expected = here[name] @ Q.T + SHIFT + np.outer(here.times, BOOST)
        np.testing.assert_allclose(there[name], expected, atol=1e-9)
    assert abs(here.counters["newton_iterations"] / there.counters["newton_iterations"] - 1) < 0.1


@pytest.mark.parametrize("dim", [2, 3])
def test_pure_rigid_motion_in_every_frame(rod_mesh: Callable[..., Any], dim: int) -> None:
    """A flying body under gravity, full and reduced: every frame gives the parabola to roundoff."""
    v, g = np.array([2.0, 3.0, -1.0])[:dim], np.array([0.5, -9.81, 2.0])[:dim]
    for frame in FRAMES.values():
        full = fmbd.FloatingBody(
            "rod",
            rod_mesh(dim=dim, h=0.5, height=0.4),
            density=1000.0,
            elastic=linear_elastic(5e6, 0.3),
            frame=frame,
            velocity=v,
        )
        for rod in (full, full.reduced(modes=4)):
            scene = fmbd.Scene("fall", gravity=g)
            scene.add(rod)
            scene.sensor("tip", fmbd.position(rod.surface("tip")))
            run = fmbd.solve(scene, t_end=0.2, dt=0.01, output=QUIET)
            t = run.times[:, None]
            np.testing.assert_allclose(run["tip"] - run["tip"][0], v * t + 0.5 * g * t**2, atol=1e-13)


def hinged(place: float, speed: float) -> fmbd.Scene:
    """Two bars on a hinge that turn against each other, this far from the origin (m) and at this speed (m/s)."""
    one, two = (
        fmbd.RigidBody(
            name, mass, 0.1 * mass, position=(place + x, -place), velocity=(speed, way), angular_velocity=turn
        )
        for name, mass, x, way, turn in (("one", 1.0, -0.5, -0.5, 1.0), ("two", 2.0, 0.5, -1.0, -2.0))
    )
    hinge = fmbd.revolute("hinge", one, two, center=(place, -place))
    scene = fmbd.Scene("hinged")
    scene.add(one, two, hinge)
    scene.sensor("angle", fmbd.angle(hinge))
    return scene


@pytest.mark.parametrize(
    "scheme",
    [
        fmbd.Rattle(),
        fmbd.EnergyMomentum(),
        fmbd.HalfExplicit(),
        fmbd.GeneralizedAlpha(compiled=False),
        fmbd.Radau(rtol=None),
        fmbd.BDF(rtol=None),
    ],
    ids=lambda s: s.name,
)
@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "in parts"])
def test_far_and_fast(scheme: Any, compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """1e6 m away, or at 1e6 m/s, as at the origin: places are known to their roundoff, and no iteration goes on below it."""
    if not compiled:
        monkeypatch.setattr(condensation, "driver_solver", lambda *_: None)
    here, far, fast = (
        fmbd.solve(hinged(*at), t_end=0.1, dt=2e-3, scheme=scheme, output=QUIET) for at in ((0, 0), (1e6, 0), (0, 1e6))
    )
    for run in (far, fast):
        np.testing.assert_allclose(run["angle"][-1], here["angle"][-1], atol=1e-6)
        assert not run.counters.get("halved_steps") and run.counters["steps"] <= 1.2 * here.counters["steps"]
        assert run.counters["newton_iterations"] <= 1.5 * here.counters["newton_iterations"]
