"""Obstacles of a user's own, bodies that are too fast, grazing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import CallbackError, ConvergenceError, InputError, LawError
from fmbd_fenicsx.ranks import world_rank

BLOCK = Path(__file__).resolve().parents[1] / "meshes/block.py"
LINEAR = fmbd.materials.linear_elastic(1.0, 0.3)


def block(name: str, speed: float, *, dim: int = 2, cells: int = 6, height: float = 0.02) -> Any:
    """A block that moves down to the origin's height."""
    size, origin = (0.6,) * (dim - 1) + (0.3,), (-0.3,) * (dim - 1) + (height,)
    mesh = fmbd.read_gmsh(BLOCK, size=size, cells=cells, origin=origin)
    down = (0.0,) * (dim - 1) + (-speed,)
    return fmbd.AbsoluteBody(name, mesh, degree=1, density=1.0, elastic=LINEAR, velocity=down)


def ufl_disk(dim: int, radius: float) -> Any:
    """The distance from a ball below the origin as a UFL expression of the coordinate."""
    import ufl
    from basix.ufl import element

    cell = "triangle" if dim == 2 else "tetrahedron"
    x = ufl.SpatialCoordinate(ufl.Mesh(element("Lagrange", cell, 1, shape=(dim,))))
    return ufl.sqrt(sum(x[k] ** 2 for k in range(dim - 1)) + (x[dim - 1] + radius) ** 2) - radius


def numpy_disk(dim: int, radius: float) -> Any:
    def distance(x: np.ndarray) -> np.ndarray:
        return np.asarray(np.sqrt((x[:-1] ** 2).sum(0) + (x[-1] + radius) ** 2) - radius)

    return distance


@pytest.mark.parametrize("dim", [pytest.param(2, marks=pytest.mark.mpi), 3])
@pytest.mark.parametrize("make", [ufl_disk, numpy_disk])
def test_own_distance_carried_by_a_rigid_body(make: Any, dim: int) -> None:
    """The same motion as with the shape of the library, and the reaction acts on the body that carries it."""
    R, states = 0.5, []
    inertia = 0.1 if dim == 2 else (0.1, 0.1, 0.1)
    for shape in (
        fmbd.Sphere(R, (0.0,) * (dim - 1) + (-R,)),
        fmbd.SignedDistance(make(dim, R)),
    ):
        body = block("block", 0.3, dim=dim, cells=6 if dim == 2 else 4)
        carrier = fmbd.RigidBody("carrier", 0.2, inertia)
        hit = fmbd.contact(
            "hit", body.surface("bottom" if dim == 2 else "back"), fmbd.Obstacle("own", shape, on=carrier)
        )
        scene = fmbd.Scene("own obstacle")
        scene.add(body, carrier, hit)
        scene.sensor("impulse", fmbd.contact_impulse(hit))
        run = fmbd.solve(scene, t_end=0.16, dt=0.02)
        p, _ = run.system.at(run.state.t, run.state.q, run.state.v).momenta()
        before = -0.3 * (run.system.mass - 0.2)
        assert p[-1] == pytest.approx(before, rel=1e-9) and abs(p[0]) < 1e-9
        assert run["impulse"][-1, -1] > 1e-4
        assert run.state.v[dim - 1] == pytest.approx(-run["impulse"][-1, -1] / 0.2, rel=1e-9)
        states.append(run)
    assert states[1].state.q == pytest.approx(states[0].state.q, abs=1e-9)


def test_own_distance_that_fails_is_named() -> None:
    with pytest.raises(CallbackError, match=r"returned shape \(2,\), expected \(3,\)"):
        fmbd.SignedDistance(lambda x: np.zeros(2)).evaluate(np.zeros((3, 2)))
    with pytest.raises(CallbackError, match="gradient vanishes"):
        fmbd.SignedDistance(lambda x: 0.0 * x[0]).evaluate(np.zeros((3, 2)))


# -- too fast ------------------------------------------------------------------------------------------------
@pytest.mark.mpi
@pytest.mark.parametrize("moving", ["slave", "master"])
def test_elastic_bodies_that_would_pass_through(moving: str) -> None:
    """A block and an elastic plate of 0.05 m, one of them with 10 m/s: the error names the step that is safe."""
    mesh = fmbd.read_gmsh(BLOCK, size=(2.0, 0.05), counts=(8, 1), origin=(-1.0, -0.05))
    up = (0.0, 10.0) if moving == "master" else (0.0, 0.0)
    plate = fmbd.AbsoluteBody("plate", mesh, degree=1, density=1.0, elastic=LINEAR, velocity=up)
    body = block("block", 10.0 if moving == "slave" else 0.0)
    scene = fmbd.Scene("plate")
    scene.add(body, plate, fmbd.contact("hit", body.surface("bottom"), plate.surface("top")))
    with pytest.raises(ConvergenceError, match=r'"hit".*0\.05 m it would hit.*Use dt <= 0\.0025 s'):
        fmbd.solve(scene, t_end=0.5, dt=0.5)


def test_prescribed_obstacle_that_would_pass_through() -> None:
    body = block("block", 0.0)
    fist = fmbd.Obstacle("fist", fmbd.Box((4.0, 0.1)), motion=lambda t: ((0.0, -0.05 + 20.0 * t), 0.0))
    scene = fmbd.Scene("fist")
    scene.add(body, fmbd.contact("hit", body.surface("bottom"), fist))
    with pytest.raises(ConvergenceError, match=r"moves 10 m in one step.*0\.1 m it would hit.*Use dt <= 0\.0025 s"):
        fmbd.solve(scene, t_end=0.5, dt=0.5)


def test_exception_in_the_motion_of_an_obstacle_is_named() -> None:
    body = block("block", 0.0)
    fist = fmbd.Obstacle("fist", fmbd.Box((4.0, 0.1)), motion=lambda t: ((0.0, -0.05), 0.0 if t < 0.015 else 1 / 0))
    scene = fmbd.Scene("fist")
    scene.add(body, fmbd.contact("hit", body.surface("bottom"), fist))
    with pytest.raises(LawError, match=r'The motion of obstacle "fist" failed at t = 0\.0\d+ s: ZeroDivisionError'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


def test_fast_sliding_is_no_passing_through() -> None:
    """A point that comes down flat and slides ten plate thicknesses a step along the plate is not refused."""
    mass = fmbd.RigidBody("mass", 1.0, 1.0, position=(-3.0, 1e-6), velocity=(10.0, -0.05))
    plate = fmbd.Obstacle("plate", fmbd.Box((20.0, 0.01), center=(0.0, -0.005)))
    scene = fmbd.Scene("slide", gravity=(0.0, -9.81))
    scene.add(mass, fmbd.contact("plate", fmbd.corners(mass, [(0.0, 0.0)]), plate))
    run = fmbd.solve(scene, t_end=0.2, dt=0.01, scheme=fmbd.Moreau())
    assert run.state.q[0] == pytest.approx(-1.0, abs=1e-6)
    assert abs(run.state.q[1]) < 1e-3


@pytest.mark.parametrize(("inset", "told"), [(0.0, True), (1e-3, False)])
def test_points_on_an_edge_are_told_of(inset: float, told: bool, caplog: pytest.LogCaptureFixture) -> None:
    """Equal blocks on each other: roundoff decides which side corners touch that stand on edges."""
    low, high = (fmbd.RigidBody(name, 1.0, 0.01, position=(0.0, y)) for name, y in (("low", 0.1), ("high", 0.3)))
    feet = fmbd.corners(high, [(inset - 0.1, -0.1), (0.1 - inset, -0.1)])
    scene = fmbd.Scene("stack", gravity=(0.0, -9.81))
    scene.add(low, high, fmbd.fixed("bolt", fmbd.ground, low))
    scene.add(fmbd.contact("on", feet, fmbd.Obstacle("low", fmbd.Box((0.2, 0.2)), on=low)))
    with caplog.at_level("WARNING", logger="fmbd_fenicsx"):
        fmbd.solve(scene, t_end=1e-3, dt=1e-3, scheme=fmbd.Moreau())
    assert ("[-0.1, 0.2] stands on an edge of its obstacle" in caplog.text) is told


# -- grazing -------------------------------------------------------------------------------------------------
def impacts(h: float, distance: float, restitution: float) -> int:
    """Impacts of x'' + x = F sin(3 t) / 2 on its periodic orbit of amplitude 1 with a wall at a distance."""
    w = 3.0
    mass = fmbd.RigidBody("mass", 1.0, 1.0, velocity=(w, 0.0))
    wall = fmbd.Obstacle("wall", fmbd.HalfSpace((distance, 0.0), (-1.0, 0.0)))
    hit = fmbd.contact("wall", fmbd.corners(mass, [(0.0, 0.0)]), wall, restitution=restitution)
    scene = fmbd.Scene("grazing")
    scene.add(mass, hit)
    scene.add(fmbd.Spring("spring", mass, fmbd.ground, point_b=(-10.0, 0.0), stiffness=1.0, length=10.0))
    scene.add(fmbd.force("drive", mass, lambda t: ((1.0 - w * w) * np.sin(w * t), 0.0)))
    scene.sensor("impulse", fmbd.contact_impulse(hit))
    run = fmbd.solve(scene, t_end=2 * np.pi, dt=h, scheme=fmbd.Moreau())
    return int((np.diff(run["impulse"][:, 0]) < 0).sum())


@pytest.mark.parametrize("distance", [1.0 - 1e-4, 1.0, 1.0 + 1e-4])
def test_grazing_does_not_depend_on_the_step(distance: float) -> None:
    """C3: an oscillator that just touches; its answer is a square root of the distance, so one impact may come or go."""
    counts = [impacts(2 * np.pi / n, distance, 0.8) for n in (300, 600)]
    assert abs(counts[0] - counts[1]) <= 1
    assert max(counts) <= 2 and (distance > 1.0 or counts[-1] >= 1)


# -- several pairs -------------------------------------------------------------------------------------------
@pytest.mark.mpi
def test_several_pairs_and_the_note_on_those_far_apart(caplog: pytest.LogCaptureFixture) -> None:
    """A block between two others: both pairs act, momentum stays, and a pair that is far away is noted and finds nothing."""
    middle, scene = block("middle", 0.0), fmbd.Scene("pile")
    scene.add(middle)
    names = (
        ("upper", "top", "bottom", 0.36, 0.2),
        ("lower", "bottom", "top", -0.32, -0.2),
        ("far", "bottom", "top", -9.0, 0.0),
    )
    for name, mine, other, height, speed in names:
        body = block(name, speed, cells=4, height=height)
        scene.add(body, fmbd.contact(name, middle.surface(mine), body.surface(other)))
        scene.sensor(name, fmbd.contact_impulse(name))
    with caplog.at_level("INFO", logger="fmbd_fenicsx"):
        run = fmbd.solve(scene, t_end=0.5, dt=0.02)
    assert '"far": the bodies start outside each other\'s search range' in caplog.text or world_rank() > 0
    p, _ = run.system.at(run.state.t, run.state.q, run.state.v).momenta()
    assert p == pytest.approx(np.zeros(2), abs=1e-12)
    upper, lower, far = (run[name][-1, 1] for name, *_ in names)
    assert far == 0.0 and abs(upper) > 1e-3 and abs(lower) > 1e-3 and upper * lower < 0


def test_own_distance_is_warned_of_where_it_is_none(caplog: pytest.LogCaptureFixture) -> None:
    x = np.array([[0.3, 0.4], [0.0, 2.0]])
    for factor, count in ((1.0, 0), (3.0, 1)):
        shape = fmbd.SignedDistance(lambda x, a=factor: a * (np.hypot(*x) - 1.0))
        caplog.clear()
        for _ in range(2):
            distance, normal = shape.evaluate(x)
        assert distance == pytest.approx([-0.5, 1.0], abs=1e-9)
        assert normal == pytest.approx(np.array([[0.6, 0.8], [0.0, 1.0]]), abs=1e-9)
        assert sum("instead of 1" in r.getMessage() for r in caplog.records) == count


@pytest.mark.parametrize("dim", [2, 3])
def test_a_turned_box_is_an_incline(dim: int) -> None:
    """A ball rolls down a slope of -0.4 rad, the upper side of a box that is turned, as it rolls down a half-space."""
    slope = Rotation.from_rotvec((0, 0, -0.4) if dim == 2 else (0.3, 0, -0.4)).as_matrix()[:dim, :dim]
    center = np.array((0.3, -0.2, 0.1)[:dim])
    box = fmbd.Box((4.0, 0.2, 3.0)[:dim], center=center, rotation=-0.4 if dim == 2 else slope)
    half_space = fmbd.HalfSpace(center + 0.1 * slope[:, 1], slope[:, 1])

    ways = []
    for shape in (box, half_space):
        ball = fmbd.RigidBody("ball", 1.0, 0.004 if dim == 2 else (0.004,) * 3, center + slope[:, 1] * 0.2)
        scene = fmbd.Scene("incline", gravity=(0, -9.81, 0)[:dim])
        scene.add(ball, fmbd.contact("touch", fmbd.ball(ball, 0.1), fmbd.Obstacle("slope", shape), friction=0.4))
        scene.sensor("ball", fmbd.position(ball))
        ways.append(fmbd.solve(scene, t_end=0.4, dt=1e-2)["ball"])
    np.testing.assert_allclose(*ways, atol=1e-12)
    assert np.linalg.norm(ways[0][-1] - ways[0][0]) > 0.1


def test_a_box_refuses_what_is_no_rotation() -> None:
    with pytest.raises(InputError, match="rotation"):
        fmbd.Box((1.0, 1.0, 1.0), rotation=np.ones((3, 3)))


def test_a_shape_alone_rests_in_the_world() -> None:
    """As an obstacle that nothing moves, to the last bit."""

    def fall(master: Any) -> Any:
        disk = fmbd.RigidBody("disk", 1.0, 0.1, (0.0, 0.3), velocity=(0.5, 0.0))
        scene = fmbd.Scene("fall", gravity=(0.0, -9.81))
        scene.add(disk, fmbd.contact("floor", fmbd.ball(disk, 0.1), master, friction=0.3, restitution=0.5))
        scene.sensor("place", fmbd.position(disk))
        return fmbd.solve(scene, t_end=0.5, dt=5e-3, scheme=fmbd.Moreau())["place"]

    plane = fmbd.HalfSpace((0, 0), (0, 1))
    assert np.array_equal(fall(plane), fall(fmbd.Obstacle("ground", plane)))


def test_an_impact_on_a_floor_in_motion_is_that_on_one_at_rest() -> None:
    """Seen from the floor: what steps do not resolve of it is taken back by the energy of motion there."""
    mesh = fmbd.read_gmsh(BLOCK, size=(1.0, 0.5), counts=(8, 4), quads=True, origin=(-0.5, 0.0))
    law = fmbd.materials.linear_elastic(2e11, 0.3)

    def impulse(u: float, w: float) -> np.ndarray:
        body = fmbd.AbsoluteBody("block", mesh, degree=1, density=1e3, elastic=law, velocity=(0.3 + u, w - 1.0))
        plane = fmbd.HalfSpace((0, -2.5e-5), (0, 1))
        moving = fmbd.Obstacle("floor", plane, motion=lambda t: ((u * t, w * t), 0.0))
        floor = fmbd.contact("floor", body.surface("bottom"), moving, friction=0.05)
        scene = fmbd.Scene("impact")
        scene.add(body, floor)
        scene.sensor("impulse", fmbd.contact_impulse(floor))
        return np.asarray(fmbd.solve(scene, t_end=2e-3, dt=2.5e-4, scheme=fmbd.ContactAlpha(0.8))["impulse"][-1])

    np.testing.assert_allclose(impulse(3.0, -2.0), impulse(0.0, 0.0), rtol=1e-8)
