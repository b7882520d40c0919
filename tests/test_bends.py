"""Linear bodies that are bent far in their floating frames are told of, where their places are off by it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd

MODULUS, DENSITY, HEIGHT = 2e6, 1000.0, 0.1


def told_by_a_pendulum(body: Any, pin: str, tip: str) -> tuple[list[str], np.ndarray]:
    """Warnings of its bending, and its tip, 0.4 s after it was let go."""
    scene = fmbd.Scene("soft pendulum", gravity=(0.0, -9.81))
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface(pin), center=(0.0, 0.0)))
    scene.sensor("tip", fmbd.position(body.surface(tip)))
    run = fmbd.solve(scene, t_end=0.4, dt=2e-3, scheme=fmbd.GeneralizedAlpha(0.6))
    return [w for w in run.warnings if "is bent by" in w], run["tip"][-1]


def test_a_soft_pendulum_is_told_of_where_it_is_off(rod_mesh: Callable[..., Any]) -> None:
    """A body with an energy is the reference."""
    mesh = rod_mesh(dim=2, h=0.1, height=HEIGHT)
    exact = fmbd.AbsoluteBody(
        "rod", mesh, density=DENSITY, energy=fmbd.materials.sheet_saint_venant_kirchhoff(MODULUS, 0.3)
    )
    none, tip = told_by_a_pendulum(exact, "pin", "tip")
    assert not none

    section = fmbd.Section(MODULUS * HEIGHT, MODULUS * HEIGHT**3 / 12, DENSITY * HEIGHT, DENSITY * HEIGHT**3 / 12)
    beam = fmbd.Beam("rod", (0.0, 0.0), (1.0, 0.0), section, elements=6)
    found, off = told_by_a_pendulum(beam, "start", "end")
    assert len(found) == 1 and "mean axes" in found[0]
    assert np.linalg.norm(off - tip) > 0.1

    floating = fmbd.FloatingBody("rod", mesh, density=DENSITY, elastic=fmbd.materials.plane_stress(MODULUS, 0.3))
    basis = fmbd.CraigBampton(("pin", "tip"), 4)
    for body in (floating, floating.reduced(basis=basis)):
        found, near = told_by_a_pendulum(body, "pin", "tip")
        assert not found and np.linalg.norm(near - tip) < 0.02
    attached = floating.with_(frame=fmbd.Attached("pin"), stiffening=True).reduced(basis=basis)
    found, near = told_by_a_pendulum(attached, "pin", "tip")
    assert not found and np.linalg.norm(near - tip) < 4e-3


@pytest.mark.mpi
@pytest.mark.parametrize(("angle", "told"), [(0.15, 0), (0.25, 1)])
def test_an_equilibrium_tells_of_a_bent_cantilever(
    rod_mesh: Callable[..., Any], caplog: pytest.LogCaptureFixture, angle: float, told: int
) -> None:
    """Turned at its tip, by a moment there."""
    rod = fmbd.FloatingBody(
        "rod", rod_mesh(dim=2, h=0.1, height=HEIGHT), density=DENSITY, frame=fmbd.Attached("pin"),
        elastic=fmbd.materials.plane_stress(MODULUS, 0.3),
    )  # fmt: skip
    scene = fmbd.Scene("bent")
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))
    scene.add(fmbd.torque("turn", rod.surface("tip"), angle * MODULUS * HEIGHT**3 / 12))
    fmbd.equilibrium(scene)
    assert sum("is bent by" in message for message in caplog.messages) == told


@pytest.mark.mpi
@pytest.mark.parametrize(("poisson", "torque", "told"), [(0.5, 0.1, 0), (0.5, 3e3, 1), (0.3, 1e4, 0)])
def test_surfaces_that_turn_against_each_other_are_told_of_where_the_body_resists(
    caplog: pytest.LogCaptureFixture, poisson: float, torque: float, told: int
) -> None:
    """A tied ring whose hub is turned by 0.02 rad is a sixth too stiff where it keeps its volume; else not by a thousandth."""
    mesh = fmbd.read_gmsh("meshes/ring.py", radius=1.0, width=0.5, h=0.25)
    angles = []
    for load in (1e-3 * torque, torque):
        ring = fmbd.FloatingBody(
            "ring", mesh, density=1100.0, elastic=fmbd.materials.nearly_incompressible(3e4, poisson)
        )
        hub = fmbd.RigidBody("hub", 1.0, 1.0)
        scene = fmbd.Scene("bushing")
        scene.add(ring, hub, fmbd.tie_surface("in", ring.surface("inner"), hub))
        scene.add(fmbd.tie_surface("out", ring.surface("outer"), fmbd.ground))
        scene.add(fmbd.revolute("pin", fmbd.ground, hub), fmbd.torque("turn", hub, lambda t, load=load: load))
        scene.sensor("angle", fmbd.rotation(hub))
        angles.append(float(fmbd.equilibrium(scene)["angle"][0]) / load)
    assert sum("takes turns of its surfaces" in message for message in caplog.messages) == told
    assert (angles[1] < 0.87 * angles[0]) == bool(told)
    assert told or angles[1] == pytest.approx(angles[0], rel=1e-3)
