"""Point masses: strings against SciPy in every scheme, other units, statics and modes by formulas, contact, refusals."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError, InputError
from fmbd_fenicsx.schemes.impacts.compiled.driver import trees_of
from fmbd_fenicsx.system.compiled.tables.tables import Tables
from fmbd_fenicsx.system.scene import placed_bodies

G = 9.81
PLACES = np.array([(1.0, 0.0, 0.0), (2.0, 0.3, 0.0), (2.5, 1.0, 0.2)])  # m
MASSES = np.array([1.0, 0.02, 10.0])  # kg
SCHEMES = [
    pytest.param(fmbd.GeneralizedAlpha(), marks=pytest.mark.mpi),
    fmbd.GeneralizedAlpha(form=fmbd.GGL()),
    fmbd.GeneralizedAlpha(rtol=1e-7),
    pytest.param(fmbd.Radau(3, rtol=1e-7), marks=pytest.mark.mpi),
    fmbd.Radau(2, fmbd.Index2(), rtol=1e-6),
    fmbd.Radau(3, fmbd.StateSpace(), rtol=1e-7),
    fmbd.BDF(rtol=1e-8),
    fmbd.Rattle(),
    fmbd.HalfExplicit(),
    fmbd.ExplicitRungeKutta(),
    fmbd.EnergyMomentum(),
]


def string(dim: int, length: float = 1.0, mass: float = 1.0, time: float = 1.0) -> fmbd.Scene:
    """Three masses on a string from the origin, in units of length, mass and time of one's own."""
    gravity = (0.0, -G * length / time**2, 0.0)[:dim]
    scene = fmbd.Scene("string", gravity=gravity)
    last: Any = fmbd.ground
    for i, (place, m) in enumerate(zip(PLACES, MASSES, strict=True)):
        bead = fmbd.PointMass(f"bead {i}", mass * m, length * place[:dim])
        scene.add(bead, fmbd.distance(f"string {i}", last, bead))
        scene.sensor(f"x{i}", fmbd.position(bead))
        scene.sensor(f"pull {i}", fmbd.reaction(f"string {i}"))
        last = bead
    return scene


def by_scipy(dim: int, t_end: float) -> tuple[np.ndarray, np.ndarray]:
    """Places (3, dim) of the beads and pulls (3,) of the string at a time, by multipliers on accelerations."""
    inverse = np.repeat(1.0 / MASSES, dim)
    weight = np.tile(-G * np.eye(dim)[1], 3)

    def pulls(x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        d, rates = (np.diff(np.vstack((np.zeros(dim), y)), axis=0) for y in (x, v))
        rows = np.zeros((3, 3, dim))
        for i in range(3):
            rows[i, i] = d[i]
            if i:
                rows[i, i - 1] = -d[i]
        flat = rows.reshape(3, -1)
        return np.linalg.solve(flat * inverse @ flat.T, flat @ weight + (rates**2).sum(1)), flat

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        x, v = y.reshape(2, 3, dim)
        force, rows = pulls(x, v)
        return np.concatenate((v.ravel(), weight - inverse * (rows.T @ force)))

    start = np.concatenate((PLACES[:, :dim].ravel(), np.zeros(3 * dim)))
    x, v = solve_ivp(rate, (0.0, t_end), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1].reshape(2, 3, dim)
    lengths = np.linalg.norm(np.diff(np.vstack((np.zeros(dim), PLACES[:, :dim])), axis=0), axis=1)
    return x, pulls(x, v)[0] * lengths


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
@pytest.mark.parametrize("dim", [2, 3])
def test_string_in_every_scheme(dim: int, scheme: Any) -> None:
    chosen = getattr(scheme, "rtol", None) is not None
    run = fmbd.solve(string(dim), t_end=0.3, dt=None if chosen else 1e-3, scheme=scheme)
    places, pulls = by_scipy(dim, 0.3)
    assert np.allclose([run[f"x{i}"][-1] for i in range(3)], places, atol=2e-5)
    assert np.allclose([run[f"pull {i}"][-1, 0] for i in range(3)], pulls, rtol=2e-2)


def test_string_is_of_second_order() -> None:
    places, _ = by_scipy(3, 0.3)
    errors = []
    for h in (4e-3, 2e-3, 1e-3):
        run = fmbd.solve(string(3), t_end=0.3, dt=h)
        assert run.counters["compiled_steps"] == run.counters["steps"]
        errors.append(np.abs(run["x2"][-1] - places[2]).max())
    assert np.log2(errors[0] / errors[1]) > 1.9
    assert np.log2(errors[1] / errors[2]) > 1.9


@pytest.mark.parametrize("units", [(1e3, 1e-3, 1.0), (1e-6, 1e-15, 1e-3), (1e8, 1e20, 1e5)])
def test_units_do_not_matter(units: tuple[float, float, float]) -> None:
    plain, other = string(2), string(2, *units)
    a = fmbd.solve(plain, t_end=0.3, dt=1e-3)
    b = fmbd.solve(other, t_end=0.3 * units[2], dt=1e-3 * units[2])
    assert np.allclose(b["x2"] / units[0], a["x2"], atol=1e-11)
    force = units[0] * units[1] / units[2] ** 2
    assert np.allclose(b["pull 2"][1:] / force, a["pull 2"][1:], rtol=1e-6)


@pytest.mark.mpi
def test_freedom_equilibrium_and_modes_of_a_hanging_string() -> None:
    length, n = 0.7, 4
    scene = fmbd.Scene("hanging", gravity=(0, 0, -G))
    last: Any = fmbd.ground
    for i in range(n):
        bead = fmbd.PointMass(f"bead {i}", 0.2, (0.1 * (i + 1), 0.0, -length * (i + 1)))
        scene.add(bead, fmbd.distance(f"string {i}", last, bead, length=length))
        last = bead
    scene.sensor("end", fmbd.position(last))
    scene.add(fmbd.force("push", last, (0.0, 0.0, 0.0)))
    assert scene.check().freedom == 2 * n

    rest = fmbd.equilibrium(scene)
    assert np.allclose(rest["end"], (0, 0, -n * length), atol=1e-9)

    # equal beads at equal distances: the roots of Laguerre's polynomial are omega^2 l / g
    found = fmbd.modes(scene, 2 * n, at=rest)
    roots = np.sqrt(np.polynomial.laguerre.lagroots([0] * n + [1]) * G / length) / (2 * np.pi)
    assert np.allclose(found.frequencies, np.repeat(roots, 2), rtol=1e-8)
    with pytest.raises(InputError):
        fmbd.modes(scene, 2 * n + 1, at=rest)
    assert fmbd.linearise(scene, ["push x"], ["end x"], at=rest).A.shape == (4 * n, 4 * n)


def test_lumps_of_a_bar_vibrate_as_its_formula_says() -> None:
    n, k, m = 12, 4e4, 0.3
    scene = fmbd.Scene("lumps")
    last: Any = fmbd.ground
    for i in range(n):
        lump = fmbd.PointMass(f"lump {i}", m, (0.1 * (i + 1), 0.0))
        rail = fmbd.point_on_line(f"rail {i}", fmbd.ground, lump, axis=(1, 0))
        scene.add(lump, rail, fmbd.Spring(f"spring {i}", last, lump, stiffness=k, length=0.1))
        last = lump
    found = fmbd.modes(scene, n)
    exact = 2 * np.sqrt(k / m) * np.sin((2 * np.arange(1, n + 1) - 1) * np.pi / (4 * n + 2)) / (2 * np.pi)
    assert np.allclose(found.frequencies, exact, rtol=1e-9)


@pytest.mark.parametrize("body", ["rod", "floating"])
@pytest.mark.mpi
def test_mass_at_the_tip_of_an_elastic_body(body: str) -> None:
    """As a rigid body with a tiny inertia, which does not show."""
    ends = []
    for point in (True, False):
        flexible: Any
        if body == "rod":
            section = fmbd.RodSection((1e5, 4e4, 4e4, 20.0, 30.0, 30.0), mass=0.5, inertia=(2e-5, 1e-5, 1e-5))
            flexible = fmbd.Rod("arm", [(0, 0, 0), (1, 0, 0)], section, elements=4, degree=2)
            root, tip, place = flexible.surface("start"), flexible.surface("end"), (1.0, 0.0, 0.0)
        else:
            mesh = fmbd.read_gmsh(str(Path(__file__).parents[1] / "meshes/rod.py"), dim=2, h=0.25)
            elastic = fmbd.materials.linear_elastic(5e6, 0.3)
            flexible = fmbd.FloatingBody("arm", mesh, density=1e3, elastic=elastic)
            root, tip, place = flexible.surface("pin"), flexible.surface("tip"), (1.0, 0.0)
        weight = fmbd.PointMass("weight", 0.4, place) if point else fmbd.RigidBody(
            "weight", 0.4, 1e-9 if len(place) == 2 else (1e-9,) * 3, position=place
        )  # fmt: skip
        scene = fmbd.Scene("arm", gravity=(0, -G, 0)[: len(place)])
        scene.add(flexible, weight, fmbd.fixed("root", fmbd.ground, root), fmbd.spherical("tip", tip, weight))
        scene.sensor("weight", fmbd.position(weight))
        ends.append(fmbd.solve(scene, t_end=0.1, dt=2e-3)["weight"])
    assert np.abs(ends[0][-1] - ends[0][0]).max() > 1e-3
    assert np.allclose(*ends, atol=1e-9)


def test_bounce_and_slide() -> None:
    """Restitution by Newton's law; on the floor friction decelerates by mu g, of a ball too, which slides and does not roll."""
    for radius in (0.0, 0.1):
        mass = fmbd.PointMass("mass", 3.0, (0.0, 0.2 + radius), velocity=(0.5, 0.0))
        touching = fmbd.contacts.ball(mass, radius) if radius else fmbd.contacts.corners(mass, [(0.0, 0.0)])
        scene = fmbd.Scene("bounce", gravity=(0, -G))
        scene.add(mass, fmbd.contact("floor", touching, fmbd.HalfSpace((0, 0), (0, 1)), restitution=0.5))
        scene.sensor("x", fmbd.position(mass))
        run = fmbd.solve(scene, t_end=0.35, dt=1e-3)
        hit = np.sqrt(2 * 0.2 / G)
        late = run.times[-1] - hit
        assert run["x"][-1] == pytest.approx((0.175, radius + 0.5 * G * hit * late - G * late**2 / 2), abs=1e-9)

        mass = fmbd.PointMass("mass", 3.0, (0.0, radius), velocity=(0.5, 0.0))
        touching = fmbd.contacts.ball(mass, radius) if radius else fmbd.contacts.corners(mass, [(0.0, 0.0)])
        slide = fmbd.Scene("slide", gravity=(0, -G))
        slide.add(mass, fmbd.contact("floor", touching, fmbd.HalfSpace((0, 0), (0, 1)), friction=0.2))
        slide.sensor("x", fmbd.position(mass))
        run = fmbd.solve(slide, t_end=0.4, dt=1e-3)
        assert run["x"][-1] == pytest.approx((0.5**2 / (2 * 0.2 * G), radius), abs=1e-5)


def test_a_ball_that_lands_on_a_rough_floor_stays_there() -> None:
    """It does not roll on."""
    mass = fmbd.PointMass("mass", 3.0, (0.0, 0.0, 0.3), velocity=(0.3, 0.1, 0.0))
    scene = fmbd.Scene("landing", gravity=(0, 0, -G))
    floor = fmbd.HalfSpace((0, 0, 0), (0, 0, 1))
    scene.add(mass, fmbd.contact("floor", fmbd.contacts.ball(mass, 0.1), floor, friction=0.9))
    scene.sensor("v", fmbd.velocity(mass))
    assert np.abs(fmbd.solve(scene, t_end=0.3, dt=1e-3)["v"][-1]).max() < 1e-9


def test_beads_hit_each_other() -> None:
    """Two balls of masses 1 and 3 in line, e = 1: the velocities of a central impact."""
    a, b = (
        fmbd.PointMass(n, m, (x, 0.0, 0.0), velocity=(v, 0, 0))
        for n, m, x, v in (("a", 1.0, 0, 2.0), ("b", 3.0, 1, 0.0))
    )
    scene = fmbd.Scene("hit")
    obstacle = fmbd.Obstacle("b", fmbd.contacts.Sphere(0.1, (0, 0, 0)), on=b)
    scene.add(a, b, fmbd.contact("hit", fmbd.contacts.ball(a, 0.1), obstacle, restitution=1.0))
    for body in (a, b):
        scene.sensor(body.name, fmbd.velocity(body))
    run = fmbd.solve(scene, t_end=1.0, dt=1e-2)
    assert run["a"][-1] == pytest.approx((-1.0, 0, 0), abs=1e-9)
    assert run["b"][-1] == pytest.approx((1.0, 0, 0), abs=1e-9)


def test_restart_goes_on_to_the_last_bit(tmp_path: Path) -> None:
    whole = fmbd.solve(string(3), t_end=0.2, dt=1e-3)
    plan = fmbd.Checkpoint(tmp_path / "kept", every=50)
    fmbd.solve(string(3), t_end=0.1, dt=1e-3, checkpoint=plan)
    rest = fmbd.solve(string(3), t_end=0.2, dt=1e-3, checkpoint=plan, restart=plan.newest)
    assert np.array_equal(rest["x2"], whole["x2"])


def test_laws_at_the_place() -> None:
    """Tyre, bushing without turning, own force and formula take hold of a point mass; Newton sees them."""
    mass = fmbd.PointMass("mass", 2.0, (0.0, 0.3))
    scene = fmbd.Scene("laws", gravity=(0, -G))
    scene.add(
        mass,
        fmbd.Tyre("tyre", mass, radius=0.3, stiffness=2e3, damping=20.0, road=lambda x, t: 0.0),
        fmbd.bushing("mount", fmbd.ground, mass, stiffness=(500.0, 0.0, 0.0), damping=(5.0, 0.0, 0.0)),
        fmbd.own_force("drag", mass, None, lambda t, a: (-0.5 * a.v, 0.0)),
        fmbd.force_element("well", fmbd.ground, mass, lambda a, b, t: 30.0 * b.x[0] ** 2),
        fmbd.force("wind", mass, (3.0, 0.0)),
    )
    scene.sensor("x", fmbd.position(mass))
    rest = fmbd.equilibrium(scene)
    assert rest["x"] == pytest.approx((3.0 / 560.0, 0.3 - 2 * G / 2e3), abs=1e-9)
    run = fmbd.solve(scene, t_end=0.1, dt=1e-3)
    assert run.counters["newton_iterations"] <= 3 * run.counters["steps"]


def net(n: int, *, other: bool = False) -> fmbd.Scene:
    """n x n masses on springs that hang from the ground; ``other``: beside a body with arms and a law of a user's own."""
    scene = fmbd.Scene("net", gravity=(0.0, 0.0, -G))
    at: dict[tuple[int, int], Any] = {(i, -1): fmbd.ground for i in range(n)}
    for i, j in np.ndindex(n, n):
        at[i, j] = fmbd.PointMass(f"{i} {j}", 0.1 + 0.01 * i, (0.1 * i, 0.1 * j, 0.0))
        scene.add(at[i, j])
        for a, b in ((i, j - 1), (i - 1, j)):
            if (a, b) in at:
                ends = (0.1 * a, 0.1 * b, 0.0), (0.1 * i, 0.1 * j, 0.0)
                scene.add(
                    fmbd.Spring(f"{a} {b} {i} {j}", at[a, b], at[i, j], *ends, stiffness=300.0, damping=0.2, length=0.1)
                )
    scene.sensor("corner", fmbd.position(at[n - 1, n - 1]))
    if other:
        body = fmbd.RigidBody("body", 0.5, (1e-3, 2e-3, 2e-3), (0.1 * n, 0.1, 0.0))
        ends = (0.1 * (n - 1), 0.1 * (n - 1), 0.0), (0.1 * n, 0.15, 0.02)
        scene.add(body, fmbd.Spring("arm", at[n - 1, n - 1], body, *ends, stiffness=200.0, damping=0.1, length=0.05))
        scene.add(fmbd.own_force("drag", at[0, n - 1], None, lambda t, a: (-0.1 * a.v, np.zeros(3))))
        scene.add(fmbd.distance("rod", at[n - 1, 0], body, point_b=(0.1 * n, 0.05, 0.01)))
    return scene


def test_a_net_has_three_unknowns_for_each_mass() -> None:
    """What holds attitudes meets nothing else in the matrix of a step: the last front has the unknowns of a row of masses."""
    n = 6
    tables = Tables(net(n).build()[0], redundant=False)
    fronts = tables.fronts.fronts
    lots = [f for f in fronts if f.pivots == len(f.unknowns) == 6]
    assert len(lots) >= n * n
    assert max(len(f.unknowns) for f in fronts) <= 3 * (2 * n)
    # forces on a mass move the whole net, its attitude with it
    assert [len(x) for x in trees_of(tables).fronts] == [len(fronts)]


def test_starts_ask_once_how_far_a_model_spreads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever takes hold of masses: each asked all bodies (900 masses on a cloth took 0.9 s)."""
    asked = []
    spread = placed_bodies.model_length
    monkeypatch.setattr(placed_bodies, "model_length", lambda *given: asked.append(1) or spread(*given))
    net(3).build()
    assert len(asked) == 1


def test_masses_beside_bodies_move_in_compiled_code_as_in_python() -> None:
    schemes = [fmbd.GeneralizedAlpha(compiled=compiled) for compiled in (True, False)]
    ends = [fmbd.solve(net(3, other=True), t_end=0.1, dt=2e-3, scheme=scheme)["corner"] for scheme in schemes]
    assert np.abs(ends[0][-1] - ends[0][0]).max() > 1e-3
    assert np.allclose(*ends, atol=1e-9)


def refused() -> dict[str, Callable[[fmbd.Scene, Any, Any], Any]]:
    """What would turn a mass: (scene, the mass at (1, 0), a rod through it)."""
    return {
        "weld": lambda s, m, rod: s.add(fmbd.fixed("w", m, rod)),
        "slider": lambda s, m, rod: s.add(fmbd.prismatic("w", fmbd.ground, m, axis=(1, 0))),
        "line of the mass": lambda s, m, rod: s.add(fmbd.point_on_line("w", m, rod, axis=(1, 0), center=(1, 0))),
        "angle": lambda s, m, rod: s.add(
            j := fmbd.revolute("w", rod, m), fmbd.joint_spring("k", fmbd.angle(j), stiffness=1.0)
        ),
        "drive": lambda s, m, rod: s.add(j := fmbd.revolute("w", rod, m), fmbd.drive("k", fmbd.angle(j), lambda t: t)),
        "stop": lambda s, m, rod: s.add(j := fmbd.revolute("w", rod, m), fmbd.joint_limit("k", fmbd.angle(j), upper=1)),
        "torque": lambda s, m, rod: s.add(fmbd.torque("w", m, 1.0)),
        "follower": lambda s, m, rod: s.add(fmbd.force("w", m, (1.0, 0.0), follower=True)),
        "elsewhere": lambda s, m, rod: s.add(fmbd.force("w", m, (1.0, 0.0), point=(1.0, 0.1))),
        "sensor elsewhere": lambda s, m, rod: s.sensor("w", fmbd.position(m, point=(1.0, 0.1))),
        "formula": lambda s, m, rod: s.add(fmbd.constraint("w", fmbd.ground, m, lambda a, b, t: b.R[0, 1])),
        "bushing": lambda s, m, rod: s.add(fmbd.bushing("w", fmbd.ground, m, stiffness=(1, 1, 1))),
        "element": lambda s, m, rod: s.add(fmbd.force_element("w", rod, m, lambda a, b, t: b.R[0, 1] * a.x[0])),
        "rolling": lambda s, m, rod: s.add(
            fmbd.rolling("w", fmbd.ground, m, shape=fmbd.Ball(0.1), normal=(0, 1), center=(1, 0))
        ),
        "corner": lambda s, m, rod: fmbd.contacts.corners(m, [(0.0, 0.1)]),
    }


@pytest.mark.parametrize("what", refused())
def test_what_would_turn_it_is_refused(what: str) -> None:
    mass = fmbd.PointMass("mass", 1.0, (1.0, 0.0))
    rod = fmbd.RigidBody("rod", 1.0, 0.1, position=(0.5, 0.0))
    scene = fmbd.Scene("refused", gravity=(0, -G))
    scene.add(mass, rod)
    with pytest.raises(InputError, match='"mass".*RigidBody'):
        refused()[what](scene, mass, rod)
        scene.build()


def test_what_holds_its_place_is_taken() -> None:
    mass = fmbd.PointMass("mass", 1.0, (0.1 * 3, 0.0))
    rod = fmbd.RigidBody("rod", 1.0, 0.1, position=(0.5, 0.0))
    scene = fmbd.Scene("taken", gravity=(0, -G))
    pin = fmbd.revolute("pin", fmbd.ground, rod, center=(0, 0))
    scene.add(mass, rod, pin, fmbd.drive("turn", fmbd.angle(pin), lambda t: 0.2 * t**2))
    scene.add(fmbd.point_on_line("rail", rod, mass, axis=(1, 0), center=(0.3, 0.0)))  # 0.3 is not 0.1 * 3
    assert scene.check().freedom == 1


@pytest.mark.parametrize("mass_first", [True, False])
def test_joints_without_a_center_sit_at_the_mass(mass_first: bool) -> None:
    """Whichever of the two bodies it is: nothing takes hold of it elsewhere."""
    arm, mass = fmbd.RigidBody("arm", 1.0, 0.1, (0.5, 0.0)), fmbd.PointMass("mass", 2.0, (1.0, 0.2))
    scene = fmbd.Scene("held")
    scene.add(arm, mass, fmbd.spherical("grip", *((mass, arm) if mass_first else (arm, mass))))
    system, state, _ = scene.build()
    places = system.at(0.0, state.q, state.v).kin.x
    assert len(places) >= 2 and np.abs(places[:2] - (1.0, 0.2)).max() < 1e-15


def test_messages_of_bodies_name_it() -> None:
    for inertia, place in ((0.0, (0, 0)), ((0.0, 0.0, 0.0), (0, 0, 0))):
        with pytest.raises(InputError, match=r"fmbd\.PointMass"):
            fmbd.RigidBody("bead", 1.0, inertia, position=place)
    with pytest.raises(InputError, match="two numbers"):
        fmbd.PointMass("bead", 1.0, (0.0,))
    with pytest.raises(InputError, match="positive"):
        fmbd.PointMass("bead", 0.0, (0.0, 0.0))


def test_a_failed_step_names_no_constraint_that_is_closed() -> None:
    """A law that jumps fails; the rows of the attitude, open by nothing, are no place to look."""
    mass = fmbd.PointMass("mass", 1.0, (0.57, 0.0))
    scene = fmbd.Scene("jump")
    scene.add(mass, fmbd.Spring("jump", fmbd.ground, mass, law=lambda s, rate, t: 1e6 * np.sign(s - 0.3 - t)))
    with pytest.raises(ConvergenceError) as caught:
        fmbd.solve(scene, t_end=1.0, dt=0.1)
    assert "attitude" not in str(caught.value)
