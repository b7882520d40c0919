"""Only contacts that are near are looked at: the same motion as with all of them, to the last bit."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.schemes.impacts.compiled import driver, spheres

pytestmark = pytest.mark.compiled


def boxes() -> list[Any]:
    """Boxes that tumble onto a floor and each other: corners, against boxes and a cylinder that bodies carry."""
    rng = np.random.default_rng(1)
    corners = list(itertools.product((-0.1, 0.1), (-0.08, 0.08), (-0.06, 0.06)))
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0, 0), (0, 0, 1)))
    bodies = [
        fmbd.RigidBody(
            f"{i}", 1.0, (0.010, 0.012, 0.014), (0.25 * (i % 3), 0.25 * (i // 3), 0.2 + 0.15 * (i % 2)),
            velocity=tuple(rng.uniform(-2, 2, 3)), angular_velocity=tuple(rng.uniform(-8, 8, 3)),
        )
        for i in range(6)
    ]  # fmt: skip
    shapes = [fmbd.Box((0.2, 0.16, 0.12)), fmbd.Cylinder(0.05, (1, 0, 0), length=0.2)]
    pairs = [
        fmbd.contact(f"floor {b.name}", fmbd.corners(b, corners), floor, friction=0.3, restitution=0.4) for b in bodies
    ]
    for one, other in itertools.permutations(range(6), 2):
        carried = fmbd.Obstacle(f"of {other} for {one}", shapes[other % 2], on=bodies[other])
        pairs.append(fmbd.contact(f"{one} {other}", fmbd.corners(bodies[one], corners), carried, friction=0.3))
    return [*bodies, *pairs]


def shot() -> list[Any]:
    """A fast disk meets a row of light ones at rest, whose speed jumps within a step; walls, a hollow and a moving bat."""
    disks = [fmbd.RigidBody("shot", 5.0, 0.01, (-0.5, 0.01), velocity=(20.0, 0.0))]
    disks += [fmbd.RigidBody(f"{i}", 0.1, 1e-4, (0.13 * i, 0.02 * (i % 2))) for i in range(6)]
    walls = [
        fmbd.Obstacle("wall", fmbd.HalfSpace((1.5, 0.0), (-1.0, 0.1))),
        fmbd.Obstacle("around", fmbd.Sphere(2.0, inside=True)),
        fmbd.Obstacle("bat", fmbd.Box((0.3, 0.6)), motion=lambda t: ((1.2, 0.4 - 3.0 * t), 5.0 * t)),
    ]
    pairs = [
        fmbd.contact(f"{d.name} {w.name}", fmbd.ball(d, 0.05), w, friction=0.2, restitution=0.8)
        for d in disks
        for w in walls
    ]
    for one, other in itertools.combinations(disks, 2):
        carried = fmbd.Obstacle(f"{other.name} for {one.name}", fmbd.Sphere(0.05), on=other)
        pairs.append(
            fmbd.contact(f"{one.name} {other.name}", fmbd.ball(one, 0.05), carried, friction=0.2, restitution=0.9)
        )
    return [*disks, *pairs]


def run(items: list[Any], t_end: float, dt: float) -> Any:
    """One run, with what some sensors read."""
    scene = fmbd.Scene("near", gravity=tuple(-9.81 * np.eye(items[0].dim)[-1]))
    scene.add(*items)
    for pair in list(scene.contacts)[::5]:
        for made in (fmbd.contact_force, fmbd.contact_impulse, fmbd.contact_gap):
            scene.sensor(f"{made.__name__} {pair}", made(pair))
    return fmbd.solve(scene, t_end=t_end, dt=dt, scheme=fmbd.Moreau(), output=fmbd.Output(every=3, progress=False))


@pytest.mark.parametrize(("make", "t_end", "dt"), [(boxes, 0.2, 1e-3), (shot, 0.06, 1e-4)], ids=["boxes", "shot"])
def test_what_is_far_makes_no_difference(make: Any, t_end: float, dt: float, monkeypatch: pytest.MonkeyPatch) -> None:
    near = run(make(), t_end, dt)
    assert near.counters["compiled_steps"] == near.counters["steps"]
    assert near.counters["impacts"] > 10

    # all contacts are looked at always
    monkeypatch.setattr(spheres, "around_points", lambda pair: None)
    whole = run(make(), t_end, dt)
    assert whole.counters["compiled_steps"] == near.counters["steps"]
    for name, values in whole.series.items():
        assert np.array_equal(near[name], values), name
    for kind, energy in whole.energy.items():
        assert np.array_equal(near.energy[kind], energy), kind
    for one, other in ((near.state, whole.state), (near.state.contact, whole.state.contact)):
        for name in ("q", "v", "a") if one is near.state else ("gap", "x", "normal", "force", "impulse", "work"):
            assert np.array_equal(getattr(one, name), getattr(other, name)), name


def test_what_is_looked_at_grows_with_the_bodies_and_not_with_their_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Disks scattered over a square of their own size each, on the way to a floor far below."""
    drivers: list[Any] = []
    made = driver.ContactDriver.__init__
    monkeypatch.setattr(
        driver.ContactDriver, "__init__", lambda self, *a, **k: (made(self, *a, **k), drivers.append(self))[0]
    )

    def looked_at(n: int) -> int:
        disks = [
            fmbd.RigidBody(f"{i}", 1.0, 0.01, (0.205 * (i % 8), 0.205 * (i // 8)), velocity=(0.1 * (i % 3), 0))
            for i in range(n)
        ]
        floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0, -50), (0, 1)))
        items = [*disks, *(fmbd.contact(f"floor {d.name}", fmbd.ball(d, 0.1), floor) for d in disks)]
        for one, other in itertools.combinations(disks, 2):
            carried = fmbd.Obstacle(f"{other.name} for {one.name}", fmbd.Sphere(0.1), on=other)
            items.append(fmbd.contact(f"{one.name} {other.name}", fmbd.ball(one, 0.1), carried, restitution=0.5))
        run(items, 0.05, 1e-3)
        return int(drivers[-1].c.candidates)

    few, many = looked_at(16), looked_at(64)
    assert 0 < few < 4 * 16
    assert many < 4 * 64
