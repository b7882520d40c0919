"""Compiled steps with contact against the same run in NumPy: every shape, carriers, friction, joints and forces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from profiled import calls_of
from test_contact import BLOCK

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear import condensation
from fmbd_fenicsx.schemes.impacts.compiled import driver

pytestmark = pytest.mark.compiled


def in_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have all later steps made by NumPy, whole and by their parts."""
    monkeypatch.setattr(driver, "contact_driver", lambda *_, **__: None)
    monkeypatch.setattr(condensation, "driver_solver", lambda *_: None)


def floor(body: Any, friction: float = 0.0, restitution: float = 0.5) -> Any:
    """A ball of 0.1 m over a plane."""
    up = np.eye(body.dim)[-1]
    obstacle = fmbd.Obstacle("floor", fmbd.HalfSpace(0 * up, up))
    return fmbd.contact("pair", fmbd.ball(body, 0.1), obstacle, friction=friction, restitution=restitution)


def bouncing(dim: int) -> Any:
    """A ball with spin on a plane."""
    up, along = np.eye(dim)[-1], np.eye(dim)[0]
    spin = 5.0 if dim == 2 else (1.0, 5.0, 2.0)
    inertia = 0.004 if dim == 2 else (0.004, 0.005, 0.006)
    ball = fmbd.RigidBody("ball", 1.0, inertia, 0.3 * up, velocity=along, angular_velocity=spin)
    return [ball, floor(ball, 0.3, 0.6)]


def sliding() -> Any:
    """A ball that falls dead with a spin about all axes, slides and rolls: friction turns it within each step."""
    inertia = (0.004, 0.005, 0.006)
    ball = fmbd.RigidBody(
        "ball", 1.0, inertia, (0, 0, 0.11), velocity=(2.0, 0, 0), angular_velocity=(10.0, -20.0, 15.0)
    )
    return [ball, floor(ball, 0.4, 0.0)]


def rolling() -> Any:
    """A disk that slides, then rolls, on a spring and a damper."""
    disk = fmbd.RigidBody("disk", 1.0, 0.005, (0, 0.1), velocity=(1.0, 0))
    spring = fmbd.Spring("spring", fmbd.ground, disk, (-1.0, 0.4), stiffness=5.0, damping=0.4, length=1.0)
    return [disk, floor(disk, 0.3), spring]


def in_a_hollow() -> Any:
    """A ball in a hollow sphere."""
    ball = fmbd.RigidBody("ball", 1.0, (0.004,) * 3, (0.2, 0, -0.25))
    hollow = fmbd.Obstacle("hollow", fmbd.Sphere(0.6, inside=True))
    return [ball, fmbd.contact("pair", fmbd.ball(ball, 0.1), hollow, friction=0.2)]


def over_a_cylinder(length: float) -> Any:
    """A ball that rolls down a tilted cylinder, over its rim."""
    ball = fmbd.RigidBody("ball", 1.0, (0.004,) * 3, (0.1, 0.05, 0.4), velocity=(0.6, 0, 0))
    log = fmbd.Obstacle("log", fmbd.Cylinder(0.3, (1.0, 0.0, -0.1), (0, 0, 0), length))
    return [ball, fmbd.contact("pair", fmbd.ball(ball, 0.1), log, friction=0.3)]


def on_a_box(carried: bool, turned: float | None = None) -> Any:
    """A ball that rolls over the edge of a box, at rest or on a body on a guide."""
    ball = fmbd.RigidBody("ball", 1.0, 0.004, (0.15, 0.3), velocity=(0.6, 0.0))
    base = fmbd.RigidBody("base", 5.0, 0.1, (0.0, 0.0))
    box = fmbd.Obstacle("box", fmbd.Box((0.4, 0.4), rotation=turned), on=base if carried else None)
    made = [ball, fmbd.contact("pair", fmbd.ball(ball, 0.1), box, friction=0.4)]
    guide = fmbd.prismatic("guide", fmbd.ground, base, axis=(1.0, 0.0), center=(0, 0))
    return [*made, base, guide] if carried else made


def into_a_box() -> Any:
    """Corners of a tile that slides on a box: pressed in by roundoff, they are pushed out of its nearest face."""
    tile = fmbd.RigidBody("tile", 1.0, 0.004, (0.05, 0.251), velocity=(0.3, -0.1))
    box = fmbd.Obstacle("box", fmbd.Box((0.4, 0.4)))
    return [tile, fmbd.contact("pair", fmbd.contacts.corners(tile, [(-0.05, -0.05), (0.05, -0.05)]), box, friction=0.2)]


def cam() -> Any:
    """A follower on a guide over a turning disk."""
    follower = fmbd.RigidBody("follower", 0.5, 0.01, (0.0, 0.04))
    turning = lambda t: ((0.02 * np.sin(19 * t), -0.02 * np.cos(19 * t)), 19 * t)  # noqa: E731
    disk = fmbd.Obstacle("cam", fmbd.Sphere(0.05), motion=turning)
    pair = fmbd.contact("pair", fmbd.ball(follower, 0.01), disk, friction=0.2)
    return [follower, pair, fmbd.prismatic("guide", fmbd.ground, follower, axis=(0, 1), center=(0, 0.04))]


def with_memory(controlled: bool) -> Any:
    """A cam whose follower is held back by dry friction in its guide, or by a PID controller."""
    follower, pair, guide = cam()
    lift = fmbd.displacement(guide)
    if controlled:
        return [follower, pair, guide, fmbd.forces.pid("pid", lift, target=-0.005, gains=(40.0, 30.0, 2.0), limit=8.0)]
    return [follower, pair, guide, fmbd.dry_friction("dry", lift, limit=1.0, stick=2e3, damping=3.0)]


def links(dim: int, friction: bool) -> Any:
    """A slider that falls on its stop and carries an arm between two more; maybe over a floor with friction."""
    inertia: Any = 0.1 if dim == 2 else (0.1, 0.12, 0.15)
    zero, along, up = np.zeros(dim), np.eye(dim)[0], np.eye(dim)[-1]
    slider = fmbd.RigidBody("slider", 2.0, inertia, 0 * zero)
    arm = fmbd.RigidBody("arm", 1.0, inertia, 0.3 * along, angular_velocity=np.pi if dim == 2 else (0, -np.pi, 0))
    rail = fmbd.prismatic("rail", fmbd.ground, slider, axis=tuple(up))
    hinge = fmbd.revolute("hinge", slider, arm, center=tuple(zero), **({} if dim == 2 else {"axis": (0, -1, 0)}))
    stops = [
        fmbd.joint_limit("bottom", fmbd.displacement(rail), lower=-0.1, restitution=0.3),
        fmbd.joint_limit("turn", fmbd.angle(hinge), lower=-0.4, upper=0.5, restitution=0.7),
    ]
    drop = fmbd.RigidBody("drop", 0.5, inertia, 2 * along + 0.3 * up, velocity=along)
    return [slider, arm, rail, hinge, *stops, *([drop, floor(drop, 0.3, 0.6)] if friction else [])]


def plate(friction: float, stop: bool) -> Any:
    """A reduced plate on a hinge: its edge falls on a floor, or the hinge on its stop."""
    mesh = fmbd.read_gmsh("meshes/rod.py", dim=2, h=0.25, height=0.2)
    elastic = fmbd.materials.plane_stress(1e7, 0.3)
    body = fmbd.FloatingBody("plate", mesh, density=1000.0, elastic=elastic).reduced(modes=3)
    hinge = fmbd.revolute("hinge", fmbd.ground, body.surface("pin"), center=(0, 0))
    if stop:
        return [body, hinge, fmbd.joint_limit("stop", fmbd.angle(hinge), lower=-0.1, restitution=0.4)]
    ground = fmbd.Obstacle("floor", fmbd.HalfSpace((0, -0.15), (0.1, 1)))
    return [body, hinge, fmbd.contact("pair", body.surface("tip"), ground, friction=friction, restitution=0.3)]


def on_a_block(dim: int, friction: float) -> Any:
    """A reduced rod on a hinge whose end falls on a reduced block on a spring, over whose edges it reaches."""
    low, high = ("bottom", "top") if dim == 2 else ("back", "front")
    elastic = fmbd.materials.linear_elastic(1e7, 0.3)

    def made(name: str, size: Any, counts: Any, origin: Any, modes: int) -> Any:
        flat = slice(0, 3) if dim == 3 else slice(0, 3, 2)
        mesh = fmbd.read_gmsh(BLOCK, size=size[flat], counts=counts[flat], quads=True, origin=origin[flat])
        return fmbd.FloatingBody(name, mesh, density=1000.0, elastic=elastic).reduced(modes=modes)

    body = made("rod", (1.0, 0.2, 0.2), (5, 1, 1), (0.0, 0.0, 0.0), 3 if dim == 2 else 8)
    base = made("base", (0.8, 0.3, 0.3), (3, 2, 1), (0.37, -0.07, -0.31), 2)
    axis = {} if dim == 2 else {"axis": (0, -1, 0)}
    hinge = fmbd.revolute("hinge", fmbd.ground, body.surface("left"), center=(0.0, 0.1, 0.1)[:dim], **axis)
    rail = fmbd.prismatic("rail", fmbd.ground, base.surface(low), axis=tuple(np.eye(dim)[-1]))
    spring = fmbd.joint_spring("spring", fmbd.displacement(rail), stiffness=5e5, damping=1e3)
    pair = fmbd.contact("pair", body.surface(low), base.surface(high), friction=friction)
    return [body, base, hinge, rail, spring, pair]


def board() -> Any:
    """A board with a hundred points along its edge, which falls on a corner of the floor and tilts."""
    body = fmbd.RigidBody("board", 2.0, 0.2, (0.0, 0.31), angular_velocity=0.4)
    edge = [(x, -0.05) for x in np.linspace(-0.5, 0.5, 100)]
    ground = fmbd.Obstacle("floor", fmbd.Sphere(0.2, center=(0.1, 0.0)))
    return [body, fmbd.contact("pair", fmbd.contacts.corners(body, edge), ground, friction=0.3, restitution=0.4)]


def tumbling() -> Any:
    """A rod that falls on a tip so that Newton's law and friction, which turns the slip about, would create energy."""
    rod = fmbd.RigidBody("rod", 1.0, 1 / 12, (0.0, 0.6), np.pi / 4, velocity=(1.0, -3.0))
    ends = fmbd.contacts.corners(rod, [(-0.5, 0.0), (0.5, 0.0)])
    ground = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0), (0, 1)))
    return [rod, fmbd.contact("pair", ends, ground, friction=0.8, restitution=0.9)]


def loop() -> Any:
    """A planar four-bar in space, three rows of which depend on the others, with stops of its crank."""
    places = [np.array(p) for p in ((0.0, 0.0, 0.0), (0.0, 0.0, 0.3), (0.8, 0.0, 0.5), (0.7, 0.0, 0.0))]
    bars = [
        fmbd.RigidBody(f"bar {i}", 1.0 + i, (0.05, 0.1, 0.06), (a + b) / 2)
        for i, (a, b) in enumerate(zip(places, places[1:], strict=False))
    ]
    sides = [fmbd.ground, *bars, fmbd.ground]
    hinges = [
        fmbd.revolute(f"hinge {i}", a, b, center=tuple(place), axis=(0, -1, 0))
        for i, (a, b, place) in enumerate(zip(sides, sides[1:], places, strict=False))
    ]
    return [*bars, *hinges, fmbd.joint_limit("stop", fmbd.angle(hinges[0]), lower=-0.5, upper=0.2, restitution=0.5)]


def in_a_bowl(carried: bool) -> Any:
    """A rod in a bowl that the user gives by a function, at rest or on a sprung body."""
    bowl = fmbd.contacts.SignedDistance(lambda x: x[1] - 0.5 * x[0] ** 2, scale=0.1)
    rod = fmbd.RigidBody("rod", 1.0, 0.02, (0.1, 0.35), angular_velocity=2.0)
    ends = fmbd.contacts.corners(rod, [(-0.2, 0.0), (0.2, 0.0)])
    if not carried:
        return [rod, fmbd.contact("pair", ends, fmbd.Obstacle("bowl", bowl), friction=0.3, restitution=0.4)]
    base = fmbd.RigidBody("base", 5.0, 1.0, (0.0, 0.0))
    rail = fmbd.prismatic("rail", fmbd.ground, base, axis=(0, 1), center=(0, 0))
    spring = fmbd.Spring("spring", fmbd.ground, base, (0.0, -1.0), stiffness=1e3, damping=5.0, length=1.05)
    return [rod, base, rail, spring, fmbd.contact("pair", ends, fmbd.Obstacle("bowl", bowl, on=base), friction=0.3)]


def rope(friction: float) -> Any:
    """A bob at the end of a damped rod that hangs in a hinge and swings against a cylinder, a spring at the bob."""
    law = {"youngs_modulus": 2e7, "poisson_ratio": 0.3, "density": 1000.0}
    section = fmbd.RodSection.rectangle(**law, width=0.02, height=0.02)
    line = [(0.0, 0.0, 0.0), (0.6, 0.0, 0.0)]
    body = fmbd.Rod("rope", line, section, elements=3, degree=2, normal=(0, 0, 1), damping=1e-3)
    bob = fmbd.RigidBody("bob", 0.2, (1e-3, 1e-3, 1e-3), (0.6, 0.0, 0.0))
    hinge = fmbd.revolute("hinge", fmbd.ground, body.surface("start"), center=(0, 0, 0), axis=(0, 1, 0))
    spring = fmbd.Spring("spring", fmbd.ground, bob, (0.6, 0.0, 0.5), stiffness=5.0, damping=0.1, length=0.4)
    bar = fmbd.Obstacle("bar", fmbd.Cylinder(0.05, axis=(0, 1, 0), center=(0.3, 0.0, -0.12)))
    held = fmbd.fixed("knot", body.surface("end"), bob, center=(0.6, 0, 0))
    pair = fmbd.contact("pair", fmbd.contacts.along(body, radius=0.01), bar, friction=friction)
    return [bob, body, hinge, held, spring, pair]


SCENES = {
    "bouncing 2": lambda: bouncing(2), "bouncing 3": lambda: bouncing(3), "sliding": sliding, "rolling": rolling,
    "hollow": in_a_hollow,
    "cylinder": lambda: over_a_cylinder(np.inf), "rim": lambda: over_a_cylinder(0.5), "box": lambda: on_a_box(False),
    "inside of a box": into_a_box, "carried box": lambda: on_a_box(True), "turned box": lambda: on_a_box(True, -0.3), "cam": cam,
    "dry friction": lambda: with_memory(False),
    "pid": lambda: with_memory(True), "stops 2": lambda: links(2, False), "stops 3": lambda: links(3, False),
    "stops and friction": lambda: links(3, True), "reduced": lambda: plate(0.0, False),
    "dependent rows": loop, "many points": board,
    "reduced, friction": lambda: plate(0.4, False), "stop of reduced": lambda: plate(0.0, True),
    "surfaces 2": lambda: on_a_block(2, 0.3), "surfaces 3": lambda: on_a_block(3, 0.3),
    "energy of an impact": tumbling, "own shape": lambda: in_a_bowl(False), "own shape carried": lambda: in_a_bowl(True),
    "rod": lambda: rope(0.0), "rod, friction": lambda: rope(0.3),
}  # fmt: skip


def run(name: str, t_end: float = 0.4, **output: Any) -> Any:
    """One run, with all that sensors read of contact."""
    items = SCENES[name]()
    pairs = [x for x in items if type(x).__name__ == "Contact"]
    scene = fmbd.Scene("contact", gravity=tuple(-9.81 * np.eye(items[0].dim)[-1]))
    scene.add(*items)
    tip = None if isinstance(items[0], fmbd.RigidBody) else np.eye(items[0].dim)[0]
    scene.sensor("place", fmbd.position(items[0], point=tip))
    if isinstance(items[0], fmbd.RigidBody):
        scene.sensor("velocity", fmbd.velocity(items[0]))
        scene.sensor("acceleration", fmbd.acceleration(items[0]))
        scene.sensor("spin", fmbd.angular_velocity(items[0]))
    for name in scene.joints:
        scene.sensor(f"reaction {name}", fmbd.reaction_force(name))
    for pair in pairs:
        for made in (fmbd.contact_force, fmbd.contact_impulse, fmbd.contact_gap):
            scene.sensor(made.__name__, made(pair))
    for stop in scene.limits.values():
        scene.sensor(f"effort {stop.name}", fmbd.sensors.limit_effort(stop))
        scene.sensor(f"coordinate {stop.name}", stop.coordinate)
    scene.sensor("work", fmbd.contact_work())
    about = fmbd.Output(**output or {"every": 8}, progress=False)
    return fmbd.solve(scene, t_end=t_end, dt=2e-3, scheme=fmbd.Moreau(), output=about)


@pytest.mark.parametrize("name", SCENES)
def test_compiled_steps_are_those_of_numpy(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = run(name)
    assert compiled.counters["compiled_steps"] == compiled.counters["steps"]
    in_numpy(monkeypatch)
    numpy = run(name)
    assert "compiled_steps" not in numpy.counters

    # reactions are the smallest at the middle of a step, found anew: in NumPy at its end
    dependent = name == "dependent rows"
    for sensor, values in numpy.series.items():
        size = np.abs(values).max() + 1e-3
        close = 1e-4 if dependent and sensor.startswith("reaction") else 1e-7
        assert compiled[sensor] == pytest.approx(values, abs=close * size), sensor
    for kind, energy in numpy.energy.items():
        assert compiled.energy[kind] == pytest.approx(energy, abs=1e-9 * (np.abs(energy).max() + 1.0)), kind
    assert compiled.state.contact.time == pytest.approx(numpy.state.contact.time)
    if numpy.newton_accuracy > 2e-8 and not dependent:  # of the same size; near roundoff it is not
        assert compiled.newton_accuracy == pytest.approx(numpy.newton_accuracy, rel=0.5)
    for count in (
        "contact_steps",
        "impacts",
        *(() if dependent else ("newton_iterations", "contact_newton_iterations")),
    ):
        assert compiled.counters[count] == numpy.counters[count], count


def test_surfaces_that_meet_ask_python_for_little(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which facets may see each other, once for many steps; gaps at given times too are those of C."""
    times = (0.0105, 0.1503, 0.2507, 0.3101, 0.35055)
    run("surfaces 2")
    calls = [calls_of(lambda n=n: run("surfaces 2", every=200, t_end=n * 2e-3), "fmbd_fenicsx") for n in (100, 200)]
    assert calls[1] - calls[0] < 100 * 5
    found = run("surfaces 2", times=times)
    assert found.counters["compiled_steps"] == found.counters["steps"] == 200
    in_numpy(monkeypatch)
    alone = run("surfaces 2", times=times)
    np.testing.assert_allclose(found["contact_gap"], alone["contact_gap"], rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("compiled", [True, False])
def test_floors_that_do_not_move_are_at_rest(compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rates of gaps on a floor with a motion differ by no roundoff: dependent contacts took 5 times as many iterations."""

    def landed(**motion: Any) -> Any:
        elastic = fmbd.materials.linear_elastic(1e7, 0.3)
        mesh = fmbd.read_gmsh(BLOCK, size=(1.0, 0.2, 0.4), counts=(5, 2, 2), quads=True, origin=(0.0, 0.01, 0.0))
        body = fmbd.FloatingBody("block", mesh, density=1000.0, elastic=elastic).reduced(modes=3)
        floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0, 0), (0, 1, 0)), **motion)
        scene = fmbd.Scene("landed", gravity=(0, -9.81, 0))
        scene.add(body, fmbd.contact("floor", body.surface("bottom"), floor, friction=0.3))
        return fmbd.solve(scene, t_end=0.07, dt=1e-3, scheme=fmbd.Moreau()).counters

    if not compiled:
        in_numpy(monkeypatch)
    counts = [
        landed()["active_set_iterations"],
        landed(motion=lambda t: ((0, 0, 0), np.eye(3)))["active_set_iterations"],
    ]
    assert 0 < counts[1] <= counts[0] + 5


def column(impacts: int, *, early: bool = True) -> Any:
    """Three balls on each other over a floor, not quite above each other, in a groove: impacts go up and down, and accumulate."""
    scene = fmbd.Scene("column", gravity=(0, -9.81))
    balls = [fmbd.RigidBody(f"{i}", 1.0, 0.004, (0.01 * (i % 2), 0.13 + 0.23 * i)) for i in range(3)]
    scene.add(*balls)
    sides = (((0, 0), (0, 1)), ((-0.12, 0), (1, 0.1)), ((0.12, 0), (-1, 0.1)))
    for ball, below in zip(balls, [None, *balls], strict=False):
        for k, (at, up) in enumerate(sides):
            wall = fmbd.Obstacle(f"wall {k}", fmbd.HalfSpace(at, up))
            scene.add(fmbd.contact(f"{ball.name} at {k}", fmbd.ball(ball, 0.1), wall, friction=0.2, restitution=0.3))
        if below:
            under = fmbd.Obstacle(f"ball {below.name}", fmbd.Sphere(0.1), on=below)
            scene.add(fmbd.contact(f"{ball.name} on", fmbd.ball(ball, 0.1), under, friction=0.2, restitution=0.3))
        scene.sensor(f"place {ball.name}", fmbd.position(ball))
    scene.sensor("work", fmbd.contact_work())
    output = fmbd.Output(every=4, progress=False)
    return fmbd.solve(scene, t_end=0.15, dt=2e-3, scheme=fmbd.Moreau(impacts=impacts, early=early), output=output)


@pytest.mark.parametrize(("impacts", "early"), [(0, True), (1, True), (20, True), (20, False)])
def test_impacts_that_accumulate_and_classical_steps_are_compiled(
    impacts: int, early: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A contact whose later impacts are all over within a step, or what is left of it, comes to rest; the rest of a step with too
    many is classical, with those closed that would pass through.
    """
    compiled = column(impacts, early=early)
    in_numpy(monkeypatch)
    numpy = column(impacts, early=early)
    assert compiled.counters["compiled_steps"] == compiled.counters["steps"]
    for count in ("impacts", "accumulations", "contact_steps", "newton_iterations"):
        assert compiled.counters[count] == numpy.counters[count], count
    assert (numpy.counters["accumulations"] > 0) == (impacts > 0)
    for sensor, values in numpy.series.items():
        assert compiled[sensor] == pytest.approx(values, abs=1e-9), sensor


@pytest.mark.parametrize(
    ("turning", "friction", "restitution"), [((0, 0, 0), 0.4, 0.0), ((0, 0.2, 1), 0.4, 0.0), ((0, 0.05, 0), 0.8, 0.3)]
)
def test_forces_of_dependent_contacts_are_found_in_compiled_code(
    turning: Any, friction: float, restitution: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A plate drops on its four corners and slides with friction.

    With a spin the distribution of the forces, which is not unique, changes the motion: only without it both paths move alike.
    Where it rocks its corners differ by little from a plane, and tell which three of them carry it: impacts amplify roundoff, by
    which NumPy itself moves by 9.4e-9 m between two kernels of its BLAS, that for Haswell and that for AVX-512.
    """

    def plate() -> Any:
        body = fmbd.RigidBody(
            "plate",
            1.0,
            (0.08, 0.08, 0.16),
            (0, 0, 0.06),
            velocity=(0.5, 0.2, 0),
            angular_velocity=turning,
        )
        points = [(x, y, -0.05) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
        up = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0, 0), (0, 0, 1)))
        scene = fmbd.Scene("plate", gravity=(0, 0, -9.81))
        scene.add(
            body, fmbd.contact("floor", fmbd.corners(body, points), up, friction=friction, restitution=restitution)
        )
        scene.sensor("place", fmbd.position(body))
        return fmbd.solve(scene, t_end=0.2, dt=4e-3, scheme=fmbd.Moreau(), output=fmbd.Output(progress=False))

    compiled = plate()
    assert compiled.counters["compiled_steps"] == compiled.counters["steps"]
    assert 0.0 < compiled.counters["complementarity_residual"] <= 1e-12
    in_numpy(monkeypatch)
    numpy = plate()
    # roundoff decides which of these few need more than Newton's plain iteration
    assert all(run.counters["cycles_broken"] <= 0.1 * run.counters["newton_iterations"] for run in (compiled, numpy))
    if not turning[2]:
        amplified = 1e-7 if restitution else 1e-9
        assert compiled["place"] == pytest.approx(numpy["place"], abs=amplified)


@pytest.mark.parametrize("reduced", [True, False])
def test_forces_of_many_points_on_few_freedoms_are_found_in_compiled_code(reduced: bool) -> None:
    """A plate falls flat on its side, without friction, or a rigid one on a hundred points."""
    mesh = fmbd.read_gmsh("meshes/rod.py", dim=2, h=0.25, height=0.2)
    elastic = fmbd.materials.plane_stress(1e7, 0.3)
    body: Any = fmbd.FloatingBody("plate", mesh, density=1000.0, elastic=elastic).reduced(modes=3)
    side = body.surface("side")
    if not reduced:
        body = fmbd.RigidBody("plate", 200.0, 17.0, (0.5, 0.0))
        side = fmbd.contacts.corners(body, [(x, -0.1) for x in np.linspace(-0.5, 0.5, 100)])
    ground = fmbd.Obstacle("floor", fmbd.HalfSpace((0, -0.12), (0, 1)))
    scene = fmbd.Scene("flat", gravity=(0, -9.81))
    scene.add(body, fmbd.contact("pair", side, ground, friction=0.0 if reduced else 0.3))
    run = fmbd.solve(scene, t_end=0.1, dt=1e-3, scheme=fmbd.Moreau(), output=fmbd.Output(progress=False))
    assert run.counters["compiled_steps"] == run.counters["steps"]
    assert run.counters["complementarity_residual"] <= 1e-12
    total = sum(run.energy.values())
    assert total[-1] < -10.0  # the impact took energy
    assert np.diff(total).max() <= 1e-9 * abs(total[-1])


def test_steps_with_very_many_closed_contacts_are_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of a board, each of which moves all others."""

    def board() -> Any:
        body = fmbd.RigidBody("board", 2.0, 0.2, (0.0, 0.051), velocity=(0.2, 0.0))
        edge = [(x, -0.05) for x in np.linspace(-0.5, 0.5, 160)]
        ground = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0), (0, 1)))
        scene = fmbd.Scene("board", gravity=(0, -9.81))
        scene.add(body, fmbd.contact("pair", fmbd.contacts.corners(body, edge), ground, friction=0.3))
        scene.sensor("place", fmbd.position(body))
        return fmbd.solve(scene, t_end=0.1, dt=2e-3, scheme=fmbd.Moreau(), output=fmbd.Output(progress=False))

    compiled = board()
    assert compiled.counters["compiled_steps"] == compiled.counters["steps"]
    in_numpy(monkeypatch)
    assert compiled["place"] == pytest.approx(board()["place"], abs=1e-9)


def test_poses_of_moving_obstacles_are_asked_for_once_a_time() -> None:
    """A block that a belt carries: the middle of a step, its end, and two times for the speed of its gaps."""
    times: list[float] = []

    def moving(t: float) -> Any:
        times.append(t)
        return (2.0 * t, 0.0), 0.0

    block = fmbd.RigidBody("block", 1.0, 1 / 600, (0.0, 0.05))
    belt = fmbd.Obstacle("belt", fmbd.HalfSpace((0, 0), (0, 1)), motion=moving)
    feet = fmbd.contacts.corners(block, [(-0.05, -0.05), (0.05, -0.05)])
    scene = fmbd.Scene("belt", gravity=(0, -9.81))
    scene.add(block, fmbd.contact("pair", feet, belt, friction=0.4))
    scene.sensor("v", fmbd.velocity(block))
    run = fmbd.solve(scene, t_end=0.1, dt=1e-3, scheme=fmbd.Moreau(), output=fmbd.Output(every=100, progress=False))
    assert run["v"][-1] == pytest.approx([0.4 * 9.81 * 0.1, 0.0], abs=1e-9)
    assert len(times) <= 4.3 * run.counters["steps"]


def test_a_motion_that_raises_is_named() -> None:
    """The compiled step gives it back, and NumPy's says which obstacle it is."""

    def moving(t: float) -> Any:
        if t > 0.05:
            raise ValueError("lost")
        return (0.0, 0.0), 0.0

    ball = fmbd.RigidBody("ball", 1.0, 0.1, (0.0, 1.1))
    plate = fmbd.Obstacle("plate", fmbd.HalfSpace((0, 0), (0, 1)), motion=moving)
    scene = fmbd.Scene("moving", gravity=(0, -9.81))
    scene.add(ball, fmbd.contact("pair", fmbd.ball(ball, 0.1), plate))
    with pytest.raises(fmbd.errors.FmbdError, match="plate"):
        fmbd.solve(scene, t_end=0.1, dt=1e-2, scheme=fmbd.Moreau())


@pytest.mark.parametrize(
    ("pose", "said"),
    [
        ((0.0, 0.0), r"motion\(0\): position 0.0 must be 2 finite numbers"),
        (((0.0, 0.0, 1.0), 0.0), "z cannot be followed"),
        ((("a", "b"), 0.0), "must be 2 finite numbers"),
        (((0.0, 0.0), "turned"), r"motion\(0\): rotation 'turned' must be numbers"),
        (((0.0, 0.0), np.eye(3)), r"motion\(0\): A rotation is an angle"),
        ([(0.0, 0.0), 0.0], "must return"),
    ],
)
def test_a_motion_that_is_no_pose_is_refused(pose: Any, said: str) -> None:
    ball = fmbd.RigidBody("ball", 1.0, 0.1, (0.0, 0.1))
    plate = fmbd.Obstacle("plate", fmbd.HalfSpace((0, 0), (0, 1)), motion=lambda t: pose)
    scene = fmbd.Scene("moving", gravity=(0, -9.81))
    scene.add(ball, fmbd.contact("pair", fmbd.ball(ball, 0.1), plate))
    with pytest.raises(fmbd.errors.InputError, match=f'Obstacle "plate": .*{said}'):
        fmbd.solve(scene, t_end=0.1, dt=1e-2)


def test_poses_are_put_in_words_where_they_are_wrong_only() -> None:
    """A matrix was printed, for a message that nobody read, at each time that a step asks for: two thirds of a run."""
    ball = fmbd.RigidBody("ball", 1.0, (0.1,) * 3, (0.0, 0.0, 0.1))
    plate = fmbd.Obstacle("plate", fmbd.HalfSpace((0, 0, 0), (0, 0, 1)), motion=lambda t: (np.zeros(3), np.eye(3)))
    scene = fmbd.Scene("moving", gravity=(0, 0, -9.81))
    scene.add(ball, fmbd.contact("pair", fmbd.ball(ball, 0.1), plate, friction=0.3))
    assert calls_of(lambda: fmbd.solve(scene, t_end=0.1, dt=1e-2), "arrayprint") == 0


def test_an_obstacle_on_its_own_slave_is_refused() -> None:
    ball = fmbd.RigidBody("ball", 1.0, 0.1)
    with pytest.raises(fmbd.errors.InputError, match='obstacle "shell" are both of body "ball"'):
        fmbd.contact("pair", fmbd.ball(ball, 0.1), fmbd.Obstacle("shell", fmbd.Sphere(0.2), on=ball))
