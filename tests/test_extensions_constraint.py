"""A constraint of a user's own by one formula: every scheme and body, time, velocities, contact, statics, checkpoints."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import combinations as co
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from test_compiled import stepper_of
from test_kinds import defects

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.mechanics.kinds.own import own_term, traced
from fmbd_fenicsx.schemes.onestep.alpha.compiled_stepper import CompiledAlphaStepper

LENGTH = 1.25


def bowl(a: Any, b: Any, t: Any) -> Any:
    """A bead on a paraboloid."""
    x, y, z = b.x - a.x
    return z - 0.5 * (x * x + y * y)


def rod(a: Any, b: Any, t: Any) -> Any:
    """Two points at a distance."""
    d = b.x - a.x
    return np.sqrt(d @ d) - LENGTH


def pendulum(dim: int, make: Callable[..., Any], scheme: Any = None, dt: float | None = 5e-3) -> Any:
    """A spinning body on a rod, hung at a point off its centre of mass."""
    inertia, spin = (0.2, 0.7) if dim == 2 else ((0.1, 0.2, 0.25), (1.0, 2.0, 0.5))
    start = {"position": (0.75, 0.9, 0.0)[:dim], "velocity": (0.4, -0.3, 0.2)[:dim], "angular_velocity": spin}
    bob = fmbd.RigidBody("bob", 1.3, inertia, **start)
    scene = fmbd.Scene("pendulum", gravity=(0, -9.81, 0)[:dim])
    ends = {"point_a": np.zeros(dim), "point_b": (0.75, 1.0, 0.0)[:dim]}
    scene.add(bob, make("rod", fmbd.ground, bob, **ends))
    scene.sensor("place", fmbd.position(bob))
    scene.sensor("force", fmbd.reaction_force("rod"))
    settings = {"scheme": scheme} if scheme else {}
    return fmbd.solve(scene, t_end=0.1, dt=dt, **settings)


def by_formula(name: str, a: Any, b: Any, **ends: Any) -> Any:
    return fmbd.constraint(name, a, b, rod, **ends)


def by_joint(name: str, a: Any, b: Any, **ends: Any) -> Any:
    return fmbd.distance(name, a, b, length=LENGTH, **ends)


# -- against the package's own, and independent integrations ---------------------------------------------------------
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("scheme", [name for name in co.SCHEMES if not name.startswith(co.CONTACT)])
def test_own_distance_rod_is_the_distance_joint(scheme: str, dim: int) -> None:
    own, joint = (pendulum(dim, make, co.SCHEMES[scheme]()) for make in (by_formula, by_joint))
    moved = np.abs(joint["place"][-1] - joint["place"][0]).max()
    assert own.counters.get("compiled_steps", 0.0) == joint.counters.get("compiled_steps", 0.0)
    assert np.abs(own["place"] - joint["place"]).max() < 1e-7 * moved
    assert np.abs(own["force"] - joint["force"]).max() < 1e-4 * np.abs(joint["force"]).max()


@pytest.mark.parametrize("dim", [2, 3])
def test_error_control_takes_it(dim: int) -> None:
    tight = fmbd.Radau(rtol=1e-9, atol=1e-9)
    exact = pendulum(dim, by_joint, tight, None)["place"][-1]
    for scheme in (tight, fmbd.BDF(rtol=1e-8, atol=1e-8)):
        assert np.abs(pendulum(dim, by_formula, scheme, None)["place"][-1] - exact).max() < 1e-5


def bead_on_a_bowl(scheme: Any, dt: float | None) -> Any:
    bead = fmbd.RigidBody("bead", 0.7, (0.1, 0.1, 0.1), position=(0.6, 0.0, 0.18), velocity=(0.0, 1.1, 0.0))
    scene = fmbd.Scene("bowl", gravity=(0, 0, -9.81))
    scene.add(bead, fmbd.constraint("bowl", fmbd.ground, bead, bowl))
    scene.sensor("place", fmbd.position(bead))
    return fmbd.solve(scene, t_end=1.0, dt=dt, scheme=scheme)


def test_bead_on_a_paraboloid_follows_lagranges_equations() -> None:
    def lagrange(t: float, y: np.ndarray) -> np.ndarray:
        """z = p . p / 2:  (1 + p p^T) p'' = -(v . v + g) p, with p the place in the plane and v its rate."""
        p, v = y[:2], y[2:]
        return np.concatenate((v, np.linalg.solve(np.eye(2) + np.outer(p, p), -(v @ v + 9.81) * p)))

    exact = solve_ivp(lagrange, (0, 1), [0.6, 0, 0, 1.1], method="DOP853", rtol=1e-11, atol=1e-12).y[:2, -1]
    radau = bead_on_a_bowl(fmbd.Radau(rtol=1e-9, atol=1e-9), None)["place"]
    assert np.abs(radau[-1, :2] - exact).max() < 1e-6
    assert np.abs(radau[:, 2] - 0.5 * (radau[:, :2] ** 2).sum(1)).max() < 1e-9

    errors = [
        np.abs(bead_on_a_bowl(fmbd.GeneralizedAlpha(0.8), h)["place"][-1, :2] - exact).max() for h in (4e-3, 2e-3)
    ]
    assert np.log2(errors[0] / errors[1]) > 1.9


def held(feature: str) -> Callable[[fmbd.Scene, co.Hung], None]:
    """A rod hung at its left end, by a hinge or by two formulas."""

    def hold(scene: fmbd.Scene, rod: co.Hung) -> None:
        if feature == "hinge":
            scene.add(fmbd.revolute("pin", fmbd.ground, rod.left, center=(0, 0)))
            return
        ends = {"point_a": (0, 0), "point_b": (0, 0)}
        scene.add(fmbd.constraint("pin", fmbd.ground, rod.left, lambda a, b, t: b.x - a.x, **ends))

    return hold


def tip(body: str, feature: str, scheme: Any) -> np.ndarray:
    hung = co.BODIES[body]()
    scene = fmbd.Scene(body, gravity=(0, -9.81))
    scene.add(hung.body)
    held(feature)(scene, hung)
    at = {"point": (1.0, 0.0)} if body == "rigid" else {}
    scene.sensor("tip", fmbd.position(hung.tip, **at))
    return np.asarray(fmbd.solve(scene, t_end=0.02, dt=1e-3, scheme=scheme)["tip"])


@pytest.mark.mpi
@pytest.mark.parametrize("body", [name for name in co.BODIES if name != "rod"])  # rods are in space, see below
def test_every_kind_of_body_is_held_by_a_formula(body: str) -> None:
    schemes = [fmbd.GeneralizedAlpha(0.8)] + [fmbd.Radau(stages=2, rtol=None)] * (body == "reduced")
    for scheme in schemes:
        joint = tip(body, "hinge", scheme)
        own = tip(body, "formula", scheme)
        assert np.abs(joint[-1] - joint[0]).max() > 1e-3
        assert np.abs(own - joint).max() < 1e-7 * np.abs(joint[-1] - joint[0]).max()


def test_rods_of_sections_are_held_by_formulas() -> None:
    section = fmbd.RodSection.circle(radius=0.01, youngs_modulus=1e7, poisson_ratio=0.3, density=1000.0)

    def run(own: bool) -> np.ndarray:
        wire = fmbd.Rod("wire", [(0, 0, 0), (1, 0, 0)], section, elements=3)
        scene = fmbd.Scene("wire", gravity=(0, -9.81, 0))
        start, end = wire.surface("start"), wire.surface("end")
        hinge = fmbd.constraint("pin", fmbd.ground, start, lambda a, b, t: b.x - a.x)
        scene.add(wire, hinge if own else fmbd.spherical("pin", fmbd.ground, start, center=(0, 0, 0)))
        scene.sensor("tip", fmbd.position(end))
        return np.asarray(fmbd.solve(scene, t_end=0.05, dt=1e-3)["tip"])

    assert np.abs(run(True) - run(False)).max() < 1e-9


# -- time, velocities, rotations ----------------------------------------------------------------------------------------
def slider(dim: int, own: bool, scheme: Any) -> Any:
    """A body moved along x of a turning body: the first formula holds time and the axes that a body carries."""
    turned = 0.4 if dim == 2 else (0.8, 0.0, 0.6, 0.0)  # the axes of the bodies are not those of the world
    arm = fmbd.RigidBody("arm", 1.0, 0.1 if dim == 2 else (0.1, 0.2, 0.3), position=np.zeros(dim), rotation=turned)
    load = fmbd.RigidBody("load", 2.0, 0.2 if dim == 2 else (0.2, 0.3, 0.4), (0.5, 0, 0)[:dim], rotation=turned)
    scene = fmbd.Scene("slider", gravity=(0, -9.81, 0)[:dim])
    hinge = fmbd.revolute("hinge", fmbd.ground, arm, center=np.zeros(dim), axis=(0, 0, 1))
    scene.add(arm, load, hinge, fmbd.prismatic("rail", arm, load, axis=(1, 0, 0)[:dim]))

    def motion(t: Any) -> Any:
        return 0.3 * np.sin(4 * t) ** 2

    if own:
        scene.add(fmbd.constraint("drive", arm, load, lambda a, b, t: a.R[:, 0] @ (b.x - a.x) - 0.5 - motion(t)))
    else:
        scene.add(fmbd.drive_translation("drive", arm, load, motion, axis=(1, 0, 0)[:dim]))
    scene.sensor("load", fmbd.position(load))
    scene.sensor("force", fmbd.reaction("drive"))
    return fmbd.solve(scene, t_end=0.4, dt=5e-3, scheme=scheme)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("scheme", [fmbd.GeneralizedAlpha(0.8), fmbd.Radau(rtol=None), fmbd.Rattle()])
def test_time_in_the_formula_drives(scheme: Any, dim: int) -> None:
    own, joint = (slider(dim, which, scheme) for which in (True, False))
    compiled = "compiled_steps"  # a step that C refuses is made in NumPy
    assert own.counters.get(compiled, 0.0) == joint.counters.get(compiled, 0.0)
    assert np.abs(own["load"] - joint["load"]).max() < 1e-8
    assert np.abs(own["force"] - joint["force"]).max() < 1e-5 * np.abs(joint["force"]).max()


@pytest.mark.parametrize("scheme", [fmbd.GeneralizedAlpha(0.8), fmbd.HalfExplicit(rtol=None)])
def test_a_formula_of_velocities_is_a_skate(scheme: Any) -> None:
    def run(own: bool) -> np.ndarray:
        blade = fmbd.RigidBody("blade", 1.0, 0.2, position=(0.0, 0.0), velocity=(1.0, 0.0), angular_velocity=1.5)
        scene = fmbd.Scene("ice", gravity=(0.5, -1.0))
        keeps = fmbd.skate("ice", fmbd.ground, blade, along=(1, 0))
        scene.add(blade, fmbd.constraint("ice", fmbd.ground, blade, lambda a, b, t: b.R[:, 1] @ b.v) if own else keeps)
        scene.sensor("place", fmbd.position(blade))
        return np.asarray(fmbd.solve(scene, t_end=0.4, dt=5e-3, scheme=scheme)["place"])

    assert np.abs(run(True) - run(False)).max() < 1e-9


FORMULAS: dict[str, Callable[[Any, Any, Any], Any]] = {
    "bowl": lambda a, b, t: (b.x - a.x)[-1] - 0.37 * ((b.x - a.x) @ (b.x - a.x)),
    "rod": rod,
    "turned": lambda a, b, t: a.R[:, 0] @ b.R[:, 1] + np.tanh(0.3 * a.R[0, 0]),
    "in time": lambda a, b, t: a.R[:, 0] @ (b.x - a.x) * np.cos(t) + np.exp(-1.3 * t) * b.R[1, 0],
    "powers": lambda a, b, t: (
        (1.7 + b.x[0] ** 2) ** 0.4 - np.arctan2(a.x[1], 2.3 + b.x[1] ** 2) - np.log(2.2 + a.x[0] ** 2)
    ),
    "speed": lambda a, b, t: b.R[:, 1] @ (b.v - a.v) + 0.3 * a.x[0] * b.w[-1],
    "speed in time": lambda a, b, t: np.sin(t) * b.v[0] + 0.7 * b.R[0, 1] * a.v[1],
}


GIVEN = [
    (None, 0.005, 1e-5),
    (fmbd.GeneralizedAlpha(compiled=False), 0.005, 1e-5),
    (fmbd.GeneralizedAlpha(form=fmbd.GGL()), 0.005, 1e-5),
    (fmbd.GeneralizedAlpha(rtol=1e-6), None, 1e-4),
    (fmbd.EnergyMomentum(), 0.005, 1e-5),
    (fmbd.HalfExplicit(), None, 1e-5),
    (fmbd.ExplicitRungeKutta(), None, 1e-6),
    (fmbd.BDF(form=fmbd.Index2()), None, 1e-4),
    (fmbd.Radau(form=fmbd.Index2()), None, 1e-6),
    (fmbd.Radau(form=fmbd.Projected()), None, 1e-6),
]


@pytest.mark.parametrize(("scheme", "dt", "tolerance"), GIVEN, ids=lambda x: getattr(x, "name", str(x)))
def test_speeds_that_are_given_by_time_and_place(scheme: Any, dt: float | None, tolerance: float) -> None:
    """A knife edge that drives ahead with a given speed; a bead that floats with a whirl that grows: x' = w(t) x across."""
    blade = fmbd.RigidBody("blade", 2.0, 0.3, position=(0.0, 0.0), velocity=(0.5, 0.0), angular_velocity=0.8)
    ahead = fmbd.constraint(
        "edge", fmbd.ground, blade, lambda a, b, t: [b.R[:, 0] @ b.v - (0.5 + 0.3 * t), b.R[:, 1] @ b.v]
    )
    bead = fmbd.RigidBody("bead", 2.0, 0.3, position=(1.0, 0.0), velocity=(0.0, 1.0))
    whirl = fmbd.constraint(
        "whirl", fmbd.ground, bead, lambda a, b, t: [b.v[0] + (1 + t) * b.x[1], b.v[1] - (1 + t) * b.x[0]]
    )
    scene = fmbd.Scene("given speeds")
    scene.add(blade, ahead, bead, whirl, fmbd.torque("turn", blade, lambda t: 0.2 * np.cos(3 * t)))
    for body in (blade, bead):
        scene.sensor(body.name, fmbd.position(body))
    run = fmbd.solve(scene, t_end=2.0, dt=dt, scheme=scheme)

    def rates(t: float, y: Any) -> list[float]:
        speed = 0.5 + 0.3 * t
        return [speed * np.cos(y[2]), speed * np.sin(y[2]), y[3], 0.2 * np.cos(3 * t) / 0.3]

    exact = solve_ivp(rates, (0.0, 2.0), (0.0, 0.0, 0.0, 0.8), rtol=1e-11, atol=1e-12).y[:2, -1]
    assert np.abs(run["blade"][-1] - exact).max() < tolerance
    assert np.abs(run["bead"][-1] - (np.cos(4.0), np.sin(4.0))).max() < 20 * tolerance
    assert run.drift[0] == 0.0
    assert run.warnings == []


def test_work_of_given_speeds_is_in_the_ledger() -> None:
    bead = fmbd.RigidBody("bead", 2.0, 0.3, position=(1.0, 0.0), velocity=(0.0, 1.0))
    scene = fmbd.Scene("given speeds")
    whirl = fmbd.constraint(
        "whirl", fmbd.ground, bead, lambda a, b, t: [b.v[0] + (1 + t) * b.x[1], b.v[1] - (1 + t) * b.x[0]]
    )
    scene.add(bead, whirl)
    run = fmbd.solve(scene, t_end=2.0, dt=0.005, output=fmbd.Output(ledger=True))
    assert run.ledger.work["whirl"][-1] == pytest.approx(0.5 * 2.0 * (3.0**2 - 1.0**2), rel=1e-3)


def test_a_given_speed_has_no_equilibrium() -> None:
    bead = fmbd.RigidBody("bead", 2.0, 0.3)
    scene = fmbd.Scene("belt")
    scene.add(bead, fmbd.constraint("belt", fmbd.ground, bead, lambda a, b, t: b.v[0] - 1.0))
    with pytest.raises(InputError, match='"belt" gives a speed of 1 m/s to bodies at rest'):
        fmbd.equilibrium(scene)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", list(FORMULAS))
def test_rows_rates_and_tangents_are_those_of_differences(name: str, dim: int) -> None:
    (y,) = traced(name, FORMULAS[name], dim)
    for what, missed in defects(own_term(name, y, dim).kind).items():
        if not (name.startswith("speed") and what == "row"):
            assert missed < 1e-6, (what, missed)


# -- what the package does with it --------------------------------------------------------------------------------------
@pytest.mark.compiled
def test_steps_are_compiled_and_kinds_shared() -> None:
    scene = fmbd.Scene("chain", gravity=(0, -9.81, 0))
    before: Any = fmbd.ground
    for i in range(4):
        ball = fmbd.RigidBody(f"{i}", 1.0, (0.1, 0.1, 0.1), position=(1.1 * (i + 1), 0.1 * i * i, 0.0))
        other = np.zeros(3) if before is fmbd.ground else np.array(before.position)
        length = float(np.linalg.norm(np.array(ball.position) - other))

        def chord(a: Any, b: Any, t: Any, length: float = length) -> Any:
            d = b.x - a.x
            return (d @ d - length * length) / length

        scene.add(ball, fmbd.constraint(f"rod {i}", before, ball, chord))
        before = ball
    assert isinstance(stepper_of(scene), CompiledAlphaStepper)
    assert len({row.own for joint in scene.joints.values() for row in joint.rows}) == 1


def test_beside_contact() -> None:
    def run(own: bool) -> Any:
        ball = fmbd.RigidBody("ball", 1.0, 0.01, position=(1.0, 0.6))
        scene = fmbd.Scene("drop", gravity=(0, -9.81))
        length = float(np.hypot(1.0, 0.6))
        chord = fmbd.constraint("rod", fmbd.ground, ball, lambda a, b, t: np.sqrt((b.x - a.x) @ (b.x - a.x)) - length)
        joint = fmbd.distance("rod", fmbd.ground, ball, length=length, point_a=(0, 0))
        floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0.1), (0, 1)))
        touch = fmbd.contact("floor", fmbd.ball(ball, 0.1), floor, restitution=0.5)
        scene.add(ball, chord if own else joint, touch)
        scene.sensor("ball", fmbd.position(ball))
        return fmbd.solve(scene, t_end=0.6, dt=5e-3, scheme=fmbd.Moreau())

    own, joint = run(True), run(False)
    assert joint.counters["impacts"] >= 1
    assert np.abs(own["ball"] - joint["ball"]).max() < 1e-6


def test_statics_and_modes_see_the_reactions_stiffness() -> None:
    def scene(own: bool) -> fmbd.Scene:
        bob = fmbd.RigidBody("bob", 1.3, (0.1, 0.2, 0.25), position=(0.0, -1.0, 0.0))
        made = fmbd.Scene("pendulum", gravity=(0, -9.81, 0))
        length = 0.9
        chord = fmbd.constraint(
            "rod", fmbd.ground, bob, lambda a, b, t: np.sqrt((b.x - a.x) @ (b.x - a.x)) - length, point_b=(0, -0.9, 0)
        )
        ends = {"point_a": (0, 0, 0), "point_b": (0, -0.9, 0)}
        made.add(bob, chord if own else fmbd.distance("rod", fmbd.ground, bob, length=length, **ends))
        return made

    found, exact = (fmbd.modes(scene(own), 3).frequencies for own in (True, False))
    assert np.allclose(found, exact, rtol=1e-6)
    assert np.asarray(exact).max() > 0.3


@pytest.mark.mpi
def test_taken_up_from_a_checkpoint(shared_tmp: Path) -> None:
    def scene() -> fmbd.Scene:
        bead = fmbd.RigidBody("bead", 0.7, (0.1, 0.1, 0.1), position=(0.6, 0.0, 0.18), velocity=(0.0, 1.1, 0.0))
        made = fmbd.Scene("bowl", gravity=(0, 0, -9.81))
        made.add(
            bead, fmbd.constraint("bowl", fmbd.ground, bead, lambda a, b, t: bowl(a, b, t) * (1 + 0.1 * np.sin(t)))
        )
        made.sensor("place", fmbd.position(bead))
        return made

    whole = fmbd.solve(scene(), t_end=0.2, dt=5e-3)
    keep = fmbd.Checkpoint(shared_tmp / "half", every=10)
    fmbd.solve(scene(), t_end=0.1, dt=5e-3, checkpoint=keep)
    taken = fmbd.solve(scene(), t_end=0.2, dt=5e-3, restart=shared_tmp / "half")
    assert np.array_equal(taken.state.q, whole.state.q)


# -- bad input ------------------------------------------------------------------------------------------------------------
BAD: dict[str, tuple[Callable[..., Any], str]] = {
    "nothing": (lambda a, b, t: None, "returned None"),
    "a number": (lambda a, b, t: 1.0, "does not depend on the markers"),
    "time alone": (lambda a, b, t: np.sin(t), "does not depend on the motion of the markers"),
    "a matrix": (lambda a, b, t: a.R, "returned shape"),
    "empty": (lambda a, b, t: [], "returned shape"),
    "a kink": (lambda a, b, t: abs(b.x[0]) - 1, "no derivative at 0"),
    "cases": (lambda a, b, t: b.x[0] if b.x[1] > 0 else b.x[1], "cannot be compared"),
    "math": (lambda a, b, t: __import__("math").sin(b.x[0]), "NumPy's sqrt"),
    "wrong shape": (lambda a, b, t: b.x - np.ones(5), "failed: ValueError"),
    "no such quantity": (lambda a, b, t: b.position[0], "has no attribute 'position'"),
    "two arguments": (lambda a, b: b.x, "takes 2 positional arguments"),
    "not finite": (lambda a, b, t: b.x[0] - np.inf, "no finite numbers"),
    "no derivative": (lambda a, b, t: np.sqrt((b.x - a.x) @ (b.x - a.x)) - 1.0, "no finite derivative at the start"),
    "squares of velocities": (lambda a, b, t: b.v @ b.v - 1.0, "not linear"),
}


@pytest.mark.parametrize("name", list(BAD))
def test_bad_formulas_are_refused_where_they_are_given(name: str) -> None:
    function, message = BAD[name]
    body = fmbd.RigidBody("b", 1.0, 0.1, position=(0.0, 0.0))
    with pytest.raises(InputError, match=message) as caught:
        fmbd.constraint("mine", fmbd.ground, body, function)
    assert 'Constraint "mine"' in str(caught.value)


def test_bad_markers_are_refused() -> None:
    body = fmbd.RigidBody("b", 1.0, 0.1, position=(0.0, 0.0))
    with pytest.raises(InputError, match="ground with the ground"):
        fmbd.constraint("mine", fmbd.ground, fmbd.ground, rod)
    with pytest.raises(InputError, match="point_b"):
        fmbd.constraint("mine", fmbd.ground, body, rod, point_b=(0, 0, 1))
    with pytest.raises(InputError, match="function"):
        fmbd.constraint("mine", fmbd.ground, body, "b.x")  # type: ignore[arg-type]
    scene = fmbd.Scene("s")
    scene.add(fmbd.RigidBody("c", 1.0, 0.1), fmbd.constraint("mine", fmbd.ground, body, lambda a, b, t: b.x[0]))
    with pytest.raises(InputError, match='"b", which is not in the scene'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)
