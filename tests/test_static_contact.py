"""Equilibria with contact: weights, beams on stops, patch tests, rods over cylinders, joint limits; what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError, InputError
from fmbd_fenicsx.linear.complementarity import delassus
from fmbd_fenicsx.materials import plane_stress

BLOCK = Path(__file__).resolve().parents[1] / "meshes/block.py"
GRAVITY = (0.0, 0.0, -9.81)


# -- rigid bodies --------------------------------------------------------------------------------------------------
def fallen(normal: tuple[float, float, float], height: float = 0.5, **more: Any) -> fmbd.Scene:
    """A ball of 2 kg above a floor."""
    scene = fmbd.Scene("fallen", gravity=GRAVITY)
    ball = fmbd.RigidBody("ball", 2.0, (0.1, 0.1, 0.1), position=(0.0, 0.0, height))
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0, 0), normal=normal))
    scene.add(ball, fmbd.contact("land", fmbd.contacts.ball(ball, 0.1), floor, **more))
    scene.sensor("force", fmbd.contact_force("land"))
    scene.sensor("place", fmbd.position(ball))
    return scene


@pytest.mark.mpi
def test_a_ball_on_the_floor_carries_its_weight() -> None:
    found = fmbd.equilibrium(fallen((0, 0, 1)))
    assert found["force"] == pytest.approx((0.0, 0.0, 2.0 * 9.81), rel=1e-12)
    assert found["place"] == pytest.approx((0.0, 0.0, 0.1), abs=1e-12)


def test_what_slides_is_refused_by_name() -> None:
    """A ball on a slope is held by contact alone."""
    with pytest.raises(ConvergenceError, match='body "ball" can move freely'):
        fmbd.equilibrium(fallen((0.1, 0, 1)))


@pytest.mark.parametrize("k", [20.0, 0.2])
@pytest.mark.parametrize("x", [0.0, 0.4])
def test_a_soft_spring_pulls_along_a_floor(x: float, k: float) -> None:
    """It hangs over the place where the ball comes to rest and takes a part of its weight; inertia is stiffer than it is."""
    ball = fmbd.RigidBody("ball", 1.0, 0.004, (x, 0.11))
    scene = fmbd.Scene("pulled", gravity=(0.0, -9.81))
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0), (0, 1)))
    scene.add(ball, fmbd.contact("land", fmbd.contacts.ball(ball, 0.1), floor))
    scene.add(fmbd.Spring("soft", fmbd.ground, ball, (0.5, 0.5), stiffness=k, length=0.3))
    scene.sensor("place", fmbd.position(ball))
    scene.sensor("force", fmbd.contact_force("land"))
    found = fmbd.equilibrium(scene)
    assert found["place"] == pytest.approx((0.5, 0.1), abs=1e-9)
    assert found["force"] == pytest.approx((0.0, 9.81 - 0.1 * k), abs=1e-7)


def test_what_rests_on_a_floor_is_not_free() -> None:
    """Of a ball that only its floor holds up and a body that slides down along a rail, the latter is named."""
    scene = fallen((0, 0, 1), height=0.1)
    scene.add(fmbd.prismatic("guide", fmbd.ground, scene.bodies["ball"], axis=(0, 0, 1)))
    sledge = fmbd.RigidBody("sledge", 2.0, (0.1, 0.1, 0.1), position=(2.0, 0.0, 0.0))
    scene.add(sledge, fmbd.prismatic("rail", fmbd.ground, sledge, axis=(1, 0, -0.1)))
    with pytest.raises(ConvergenceError, match='body "sledge" can move freely'):
        fmbd.equilibrium(scene)


def test_friction_is_refused_with_the_reason() -> None:
    with pytest.raises(InputError, match='"land" has friction: its equilibrium depends on the history'):
        fmbd.equilibrium(fallen((0, 0, 1), friction=0.3))


def test_a_ball_in_a_groove() -> None:
    """Two slopes of 45 and 30 degrees: N_1 sin a = N_2 sin b, the sum of the upright parts is the weight."""
    scene = fallen((1, 0, 1))
    slope = np.radians(30.0)
    other = fmbd.Obstacle("other", fmbd.HalfSpace((0, 0, 0), normal=(-np.sin(slope), 0, np.cos(slope))))
    scene.add(fmbd.contact("second", fmbd.contacts.ball(scene.bodies["ball"], 0.1), other))
    scene.sensor("other", fmbd.contact_force("second"))
    found = fmbd.equilibrium(scene)

    second = 2.0 * 9.81 * np.sin(np.pi / 4) / np.sin(np.pi / 4 + slope)
    assert np.linalg.norm(found["other"]) == pytest.approx(second, rel=1e-10)
    assert found["force"] + found["other"] == pytest.approx((0.0, 0.0, 2.0 * 9.81), rel=1e-10, abs=1e-9)


def test_four_corners_share_a_weight() -> None:
    """A box on a floor: four rows for three motions, of all forces that carry it the smallest; another box stands on it."""
    scene = fmbd.Scene("boxes", gravity=GRAVITY)
    low = fmbd.RigidBody("low", 3.0, (0.1, 0.1, 0.1), position=(0.0, 0.0, 0.25))
    high = fmbd.RigidBody("high", 1.0, (0.1, 0.1, 0.1), position=(0.05, 0.0, 0.6))
    feet = [(x, y, -0.1) for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    small = [(x, y, -0.1) for x in (-0.1, 0.1) for y in (-0.1, 0.1)]
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0, 0), normal=(0, 0, 1)))
    lid = fmbd.Obstacle("lid", fmbd.HalfSpace((0, 0, 0.1), normal=(0, 0, 1)), on=low)
    scene.add(low, high, fmbd.contact("floor", fmbd.contacts.corners(low, feet), floor))
    scene.add(fmbd.contact("pile", fmbd.contacts.corners(high, small), lid))
    for name in ("floor", "pile"):
        scene.sensor(name, fmbd.contact_force(name))
    scene.sensor("feet", fmbd.contact_pressure("floor"))
    found = fmbd.equilibrium(scene)

    assert found["floor"] == pytest.approx((0, 0, 4.0 * 9.81), rel=1e-9, abs=1e-9)
    assert found["pile"] == pytest.approx((0, 0, 9.81), rel=1e-9, abs=1e-9)
    right, left = found["feet"][2:].sum(), found["feet"][:2].sum()
    assert (right - left) * 0.2 == pytest.approx(9.81 * 0.05, rel=1e-6)  # moment of the upper box


def test_a_pendulum_on_its_stop() -> None:
    """Effort of the stop: the moment of the weight there."""
    scene = fmbd.Scene("stopped", gravity=(0.0, -9.81))
    bob = fmbd.RigidBody("bob", 1.5, 0.1, position=(0.7, 0.0))
    scene.add(bob, hinge := fmbd.revolute("hinge", fmbd.ground, bob, center=(0.0, 0.0)))
    scene.add(stop := fmbd.joint_limit("stop", fmbd.angle(hinge), lower=-0.4))
    scene.sensor("effort", fmbd.sensors.limit_effort(stop))
    scene.sensor("angle", fmbd.angle(hinge))
    found = fmbd.equilibrium(scene)
    assert found["angle"][0] == pytest.approx(-0.4, abs=1e-12)
    assert found["effort"][0] == pytest.approx(1.5 * 9.81 * 0.7 * np.cos(0.4), rel=1e-10)


def test_a_pendulum_leans_on_a_wall() -> None:
    """In space, from a start beside it: the lowest place on the wall, with the force m g tan(angle)."""
    scene = fmbd.Scene("leaning", gravity=GRAVITY)
    bob = fmbd.RigidBody("bob", 1.0, (0.1, 0.1, 0.1), position=(0.5, 0.4, -np.sqrt(0.59)))
    wall = fmbd.Obstacle("wall", fmbd.HalfSpace((0.3, 0, 0), normal=(1, 0, 0)))
    scene.add(bob, fmbd.spherical("pin", fmbd.ground, bob, center=(0.0, 0.0, 0.0)))
    scene.add(fmbd.contact("wall", fmbd.contacts.corners(bob, [(0.0, 0.0, 0.0)]), wall))
    scene.sensor("place", fmbd.position(bob))
    scene.sensor("force", fmbd.contact_force("wall"))
    found = fmbd.equilibrium(scene)
    assert found["place"] == pytest.approx((0.3, 0.0, -np.sqrt(0.91)), abs=1e-8)
    assert found["force"] == pytest.approx((9.81 * 0.3 / np.sqrt(0.91), 0.0, 0.0), rel=1e-8, abs=1e-8)


# -- elastic bodies ------------------------------------------------------------------------------------------------
LONG, HIGH, GAP, YOUNG, LOAD = 1.0, 0.04, 1e-3, 1e9, 100.0


def propped(kind: str) -> fmbd.Scene:
    """A cantilever pulled down at its end, a round stop under its middle."""
    mesh = fmbd.read_gmsh(BLOCK, size=(LONG, HIGH), counts=(20, 1), quads=True)
    data: Any = {"degree": 2, "density": 1000.0, "elastic": plane_stress(YOUNG, 0.0)}
    body: Any = (
        fmbd.AbsoluteBody("beam", mesh, **data) if kind == "absolute" else fmbd.FloatingBody("beam", mesh, **data)
    )
    body = body.reduced(modes=40) if kind == "reduced" else body
    scene = fmbd.Scene("propped")
    stop = fmbd.Obstacle("stop", fmbd.contacts.Sphere(0.05, (LONG / 2, -0.05 - GAP)))
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("left")))
    scene.add(fmbd.contact("stop", body.surface("bottom"), stop))
    scene.add(fmbd.force("pull", body.surface("right"), lambda t: (0.0, -LOAD * t)))
    scene.sensor("force", fmbd.contact_force("stop"))
    scene.sensor("gap", fmbd.contact_gap("stop"))
    return scene


@pytest.mark.mpi
@pytest.mark.parametrize(("kind", "share"), [("absolute", 0.01), ("floating", 0.01), ("reduced", 0.07)])
def test_a_cantilever_on_a_stop(kind: str, share: float) -> None:
    """Beam theory: P a^2 (3 l - a) / 6 EI - R a^3 / 3 EI = gap; the stop does nothing as long as the beam is above it.

    Modes of the free beam bend a clamp and a stop slowly: forty leave the way 6 % too small, twelve 19 %.
    """
    stiffness, a = YOUNG * HIGH**3 / 12, LONG / 2
    bent = LOAD * a**2 * (3 * LONG - a) / (6 * stiffness)
    reaction = (bent - GAP) * 3 * stiffness / a**3
    shear = 6 / 5 * LOAD * a / (YOUNG / 2 * HIGH)  # Timoshenko's share: below 1 % of the bending

    path = fmbd.LoadSteps((0.5 * GAP / bent, 1.0))
    made = fmbd.equilibrium(propped(kind), path=path).path
    assert made is not None
    force, gap = made.series["force"][:, 1], made.series["gap"][:, 0]
    assert force[1] == 0.0
    assert gap[1] == pytest.approx(GAP - 0.5 * GAP, rel=2 * share)
    assert gap[2] == pytest.approx(0.0, abs=1e-12)
    assert force[2] == pytest.approx(reaction, rel=share + shear / bent)


def pressed(body: str, push: tuple[float, float]) -> fmbd.Scene:
    """A block on a wall, held by contact alone."""
    mesh = fmbd.read_gmsh(BLOCK, size=(1.0, 0.5), cells=5)
    block = getattr(fmbd, body)("block", mesh, degree=1, density=1.0, elastic=fmbd.materials.linear_elastic(1e3, 0.3))
    scene = fmbd.Scene("pressed")
    wall = fmbd.Obstacle("wall", fmbd.HalfSpace((0, -0.01), normal=(0, 1)))
    scene.add(block, fmbd.contact("wall", block.surface("bottom"), wall, redistribute_mass=False))
    scene.add(fmbd.force("press", block.surface("top"), lambda t: push))
    scene.sensor("pressure", fmbd.contact_pressure("wall"))
    return scene


@pytest.mark.mpi
@pytest.mark.parametrize("stored", [True, False])
@pytest.mark.parametrize("body", ["AbsoluteBody", "FloatingBody"])
def test_a_pressed_block_has_uniform_pressure(body: str, stored: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also with the compliance of many candidates, which is applied and not ``stored``."""
    if not stored:
        monkeypatch.setattr(delassus, "MANY", 1)
    assert fmbd.equilibrium(pressed(body, (0.0, -10.0)))["pressure"] == pytest.approx(10.0, rel=1e-9)


def test_a_block_pushed_along_the_wall_is_refused() -> None:
    with pytest.raises(ConvergenceError, match='body "block" can move freely'):
        fmbd.equilibrium(pressed("AbsoluteBody", (0.1, -10.0)))


@pytest.mark.mpi
def test_two_blocks_with_meshes_that_do_not_match() -> None:
    """Uniform pressure between two surfaces (mortar rows)."""
    data: Any = {"degree": 1, "density": 1.0, "elastic": fmbd.materials.linear_elastic(1e3, 0.3)}
    low, high = (
        fmbd.AbsoluteBody(name, fmbd.read_gmsh(BLOCK, size=(1.0, 0.5), cells=n, origin=(0.0, y)), **data)
        for name, n, y in (("low", 4, 0.0), ("high", 7, 0.5))
    )
    scene = fmbd.Scene("pair")
    scene.add(low, high, fmbd.contact("pair", high.surface("bottom"), low.surface("top")))
    scene.add(fmbd.fixed("base", fmbd.ground, low.surface("bottom")))
    scene.add(fmbd.prismatic("guide", fmbd.ground, high.surface("top"), axis=(0.0, 1.0)))
    scene.add(fmbd.force("press", high.surface("top"), lambda t: (0.0, -10.0)))
    scene.sensor("pressure", fmbd.contact_pressure("pair"))
    assert fmbd.equilibrium(scene)["pressure"] == pytest.approx(10.0, rel=1e-9)


# -- rods ------------------------------------------------------------------------------------------------------------
def supported(middle: bool) -> fmbd.Scene:
    """A rod over two cylinders, or over three; a spring keeps it from sliding along."""
    section = fmbd.RodSection.circle(youngs_modulus=1e10, poisson_ratio=0.3, density=1000.0, radius=0.02)
    rod = fmbd.Rod("rod", [(-1, 0, 0.13), (1, 0, 0.13)], section, elements=16, degree=2)
    scene = fmbd.Scene("supported", gravity=GRAVITY)
    ends: Any = {"point_a": (-2.0, 0.0, 0.12), "point_b": (-1.0, 0.0, 0.13)}
    scene.add(rod, fmbd.Spring("along", fmbd.ground, rod.surface("start"), stiffness=1e4, length=1.0, **ends))
    for name, x in (("left", -1.0), ("middle", 0.0), ("right", 1.0)):
        if name == "middle" and not middle:
            continue
        roll = fmbd.Obstacle(name, fmbd.contacts.Cylinder(0.1, (0, 1, 0), (x, 0, 0)))
        scene.add(fmbd.contact(name, fmbd.contacts.along(rod, 0.02), roll))
        scene.sensor(name, fmbd.contact_force(name))
    return scene


@pytest.mark.parametrize("middle", [False, True])
def test_a_rod_lies_over_cylinders(middle: bool) -> None:
    """Half the weight on each of two; on three 3/16, 10/16, 3/16 of it, as of a continuous beam."""
    found = fmbd.equilibrium(supported(middle))
    weight = 1000.0 * np.pi * 0.02**2 * 2.0 * 9.81
    share = 3 / 16 if middle else 1 / 2
    for name in ("left", "right"):
        assert found[name][2] == pytest.approx(share * weight, rel=1e-3 if middle else 1e-6)
    total = found["left"] + found["right"] + (found["middle"] if middle else 0.0)
    assert total[1:] == pytest.approx((0.0, weight), rel=1e-8, abs=1e-7)  # along the rod the spring pulls too


def test_a_run_starts_from_the_settled_place() -> None:
    """``settle=True`` puts a body on its floor, where it stays."""
    scene = fallen((0, 0, 1))
    scene.settle = True
    run = fmbd.solve(scene, t_end=0.01, dt=1e-3, scheme=fmbd.Moreau())
    assert run["place"][:, 2] == pytest.approx(0.1, abs=1e-9)
