"""The same scene in twelve systems of units: the same steps, the same digits, with every kind of body and every scheme."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from unit_scenes import Units

import fmbd_fenicsx as fmbd

SYSTEMS = tuple(product((1.0, 1e3, 1e-3), (1.0, 1e6), (1.0, 1e-3)))  # of a metre, a kilogram, a second
DIGITS = 1e-10
OF_FORCES = 2e-9  # accelerations: the roundoff of positions over h^2
MESHES = Path(__file__).parents[1] / "meshes"

SCHEMES = {
    "alpha": fmbd.GeneralizedAlpha(0.8),
    "alpha in NumPy": fmbd.GeneralizedAlpha(0.8, compiled=False),
    "alpha, GGL": fmbd.GeneralizedAlpha(0.9, form=fmbd.GGL()),
    "Rattle": fmbd.Rattle(),
    "energy-momentum": fmbd.EnergyMomentum(),
    "Radau": fmbd.Radau(3, rtol=1e-5),
    "BDF": fmbd.BDF(rtol=1e-4),
    "half-explicit": fmbd.HalfExplicit(1e-5),
    "explicit": fmbd.ExplicitRungeKutta(1e-7),
}


def chain(u: Units) -> fmbd.Scene:
    """In space: two links on a hinge, a spring, a damper in a joint, a second hinge that says the same as the first."""
    scene = fmbd.Scene("chain", gravity=u.of((0.0, 0.0, -9.81), 1, 0, -2))
    moments = u.of((0.02, 0.03, 0.04), 2, 1, 0)
    one = fmbd.RigidBody("one", u.of(1.5, 0, 1, 0), moments, position=u.of((0.5, 0.0, 0.0), 1, 0, 0))
    two = fmbd.RigidBody("two", u.of(0.5, 0, 1, 0), moments, position=u.of((1.0, 0.4, 0.0), 1, 0, 0))
    centre = u.of((1.0, 0.0, 0.0), 1, 0, 0)
    first = fmbd.revolute("first", fmbd.ground, one, center=(0.0, 0.0, 0.0), axis=(0, 1, 0.3))
    again = fmbd.revolute("again", fmbd.ground, one, center=u.of((0.0, 0.2, 0.06), 1, 0, 0), axis=(0, 1, 0.3))
    second = fmbd.revolute("second", one, two, center=centre, axis=(1, 0, 0))
    scene.add(one, two, first, again, second)
    scene.add(fmbd.joint_spring("hold", fmbd.angle(second), stiffness=u.of(3.0, 2, 1, -2), damping=u.of(0.1, 2, 1, -1)))
    ends = {"point_a": u.of((0.0, 0.0, 1.0), 1, 0, 0), "point_b": centre}
    scene.add(
        fmbd.Spring("spring", fmbd.ground, one, stiffness=u.of(20.0, 0, 1, -2), length=u.of(1.2, 1, 0, 0), **ends)
    )
    scene.sensor("place", fmbd.position(two))
    scene.sensor("force", fmbd.reaction("second"))
    return scene


@cache
def rod(size: float) -> Any:
    """A rod of so many units of length, one tenth as high."""
    return fmbd.read_gmsh(MESHES / "rod.py", dim=2, length=size, height=0.1 * size, h=0.2 * size)


def flexible(kind: str, u: Units) -> fmbd.Scene:
    """In the plane: an elastic rod on a pin, of one kind of body."""
    scene = fmbd.Scene("rod", gravity=u.of((0.0, -9.81), 1, 0, -2))
    elastic = fmbd.materials.plane_stress(u.of(1e8, 0, 1, -2), 0.3)  # times a thickness, as the density
    made = fmbd.AbsoluteBody if kind == "absolute" else fmbd.FloatingBody
    body: Any = made("rod", rod(u.of(1.0, 1, 0, 0)), density=u.of(1000.0, -2, 1, 0), elastic=elastic)
    body = body.reduced(modes=3) if kind == "reduced" else body
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0.0, 0.0)))
    scene.sensor("place", fmbd.position(body.surface("tip")))
    scene.sensor("force", fmbd.reaction("pin"))
    return scene


def numbers(scene: fmbd.Scene, u: Units, scheme: Any, dt: float, steps: int) -> tuple[Any, ...]:
    """Steps, and the values of the sensors in metres, kilograms, seconds."""
    adaptive = getattr(scheme, "rtol", None) is not None
    run = fmbd.solve(scene, t_end=u.of(steps * dt, 0, 0, 1), dt=None if adaptive else u.of(dt, 0, 0, 1), scheme=scheme)
    place, force = run["place"] / u.of(1.0, 1, 0, 0), run["force"][:, : scene.dim] / u.of(1.0, 1, 1, -2)
    return run.counters["steps"], place, force


def agree(build: Callable[[Units], fmbd.Scene], scheme: Any, dt: float, steps: int) -> None:
    """All twelve against the first."""
    expected = numbers(build(Units(1, 1, 1)), Units(1, 1, 1), scheme, dt, steps)
    for sizes in SYSTEMS[1:]:
        u = Units(*sizes)
        found = numbers(build(u), u, scheme, dt, steps)
        assert found[0] == expected[0], sizes
        for x, y, digits in zip(found[1:], expected[1:], (DIGITS, OF_FORCES), strict=True):
            assert np.abs(x - y).max() <= digits * np.abs(y).max(), sizes


@pytest.mark.parametrize("name", SCHEMES)
def test_every_scheme(name: str) -> None:
    agree(chain, SCHEMES[name], 5e-3, 8)


@pytest.mark.parametrize("kind", ["floating", "reduced", "absolute"])
def test_every_kind_of_body(kind: str) -> None:
    agree(lambda u: flexible(kind, u), fmbd.GeneralizedAlpha(0.8), 5e-3, 3)
