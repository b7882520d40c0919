"""Steps of elastic bodies that touch obstacles and each other: compiled, many in a call, and as those of Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from profiled import calls_of
from test_checkpoint import at_every_step
from test_contact import BLOCK, ROOT

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.schemes.impacts.elastic_contact_stepper import ElasticContactStepper

SCHEMES = [fmbd.ContactMidpoint(), fmbd.ContactMidpoint(theta=0.6), fmbd.ContactAlpha(0.8)]


def block(kind: str, name: str, y: float, **more: Any) -> Any:
    mesh = fmbd.read_gmsh(BLOCK, size=(1.0, 0.4), counts=(5, 2), quads=True, origin=(-0.5, y))
    return getattr(fmbd, kind)(
        name, mesh, degree=1, density=1.0, elastic=fmbd.materials.linear_elastic(50.0, 0.2), **more
    )


def falling(kind: str, *, all_sorts: bool) -> Any:
    """A block that falls on a floor, beside obstacles of every sort far below; a joint, a spring and a push act on bodies."""
    body = block(kind, "block", 0.1)
    floor = fmbd.contact("floor", body.surface("bottom"), fmbd.HalfSpace((0, 0), (0, 1)), friction=0.2)
    scene = fmbd.Scene("fall", gravity=(0, -9.81))
    scene.add(body, floor)
    if all_sorts:
        ball, other = fmbd.RigidBody("ball", 1.0, 0.1, position=(0.1, -2.0)), block("AbsoluteBody", "other", -3.0)
        scene.add(ball, other, fmbd.fixed("held", fmbd.ground, other.surface("bottom")))
        scene.add(fmbd.revolute("pin", fmbd.ground, ball, center=(0.0, -2.5)))
        scene.add(fmbd.Spring("spring", fmbd.ground, ball, stiffness=20.0, point_a=(1.0, -2.0)))
        scene.add(fmbd.force("push", body.surface("top"), lambda t: (0.2, -0.1)))
        obstacles = {
            "ball": fmbd.Obstacle("ball", fmbd.Sphere(0.2), on=ball),
            "plane": fmbd.SignedDistance(lambda x: x[1] + 1.0),
            "ram": fmbd.Obstacle("ram", fmbd.Box((1.0, 0.2)), motion=lambda t: ((t, -1.5), 0.3 * t)),
            "other": other.surface("top"),
        }
        scene.add(*(fmbd.contact(name, body.surface("bottom"), x) for name, x in obstacles.items()))
        scene.sensor("ram", fmbd.contact_gap("ram"))
    scene.sensor("gap", fmbd.contact_gap(floor))
    scene.sensor("impulse", fmbd.contact_impulse(floor))
    scene.sensor("work", fmbd.contact_work())
    return scene


def solved(scene: Any, scheme: Any, **more: Any) -> Any:
    return fmbd.solve(scene, t_end=0.2, dt=2e-3, scheme=scheme, **more)


KINDS = ["AbsoluteBody", "FloatingBody", "FloatingBody"]


@pytest.mark.parametrize(("kind", "scheme"), zip(KINDS, SCHEMES, strict=True), ids=lambda x: getattr(x, "name", x))
def test_flights_are_the_steps_of_python(kind: str, scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the same records, however many of them are asked for."""
    found, some = (solved(falling(kind, all_sorts=True), scheme, output=fmbd.Output(every=n)) for n in (1, 10))
    monkeypatch.setattr(ElasticContactStepper, "marches", False)
    alone = solved(falling(kind, all_sorts=True), scheme)
    assert found.counters["compiled_steps"] == 100 and alone.counters["contact_steps"] > 5

    rounding = 1e-10 if isinstance(scheme, fmbd.ContactMidpoint) else 1e-8
    assert (found.state.q == some.state.q).all()
    np.testing.assert_allclose(found.state.q, alone.state.q, rtol=rounding, atol=rounding)
    for name in ("ram", "gap", "impulse", "work"):
        assert (found[name][::10] == some[name]).all()
        np.testing.assert_allclose(found[name], alone[name], rtol=rounding, atol=rounding)
    np.testing.assert_allclose(found.total_energy, alone.total_energy, rtol=rounding)


def test_velocities_of_closed_contacts_have_one_metric(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether a step takes new tangents on its way: a damper whose pull turns is predicted badly where nodes have no inertia."""

    def found() -> Any:
        body, weight = (
            block("AbsoluteBody", "block", 0.002, velocity=(0.2, -0.2)),
            fmbd.RigidBody("weight", 0.3, 0.02, (1.0, 0.2)),
        )
        scene = fmbd.Scene("pulled", gravity=(0, -9.81))
        scene.add(body, weight, fmbd.Spring("spring", body.surface("right"), weight, stiffness=20.0, damping=0.5))
        scene.add(fmbd.contact("floor", body.surface("bottom"), fmbd.HalfSpace((0, 0), (0, 1))))
        return fmbd.solve(scene, t_end=9e-3, dt=1e-3, scheme=fmbd.ContactAlpha(0.8), newton=fmbd.Newton(tolerance=1e-8))

    compiled = found()
    monkeypatch.setattr(ElasticContactStepper, "marches", False)
    alone = found()
    assert compiled.counters["compiled_steps"] > 2
    np.testing.assert_allclose(compiled.state.v, alone.state.v, atol=1e-7)  # 0.18 of 3.0 m/s
    np.testing.assert_allclose(compiled.state.a, alone.state.a, atol=1e-3)


TOLD = {
    "force": fmbd.contact_force,
    "impulse": fmbd.contact_impulse,
    "pressure": fmbd.contact_pressure,
    "gap": fmbd.contact_gap,
}


def squeezed(kind: str) -> Any:
    """A block lands on a floor beside a ram, under a ball: a plane, a motion, a carried shape, with friction; corners on two."""
    body = block(kind, "block", 0.002, velocity=(0.2, -0.2))
    ball = fmbd.RigidBody("ball", 0.2, 1e-3, position=(0.1, 0.553), velocity=(0.0, -0.3), angular_velocity=2.0)
    obstacles = {
        "bottom": fmbd.HalfSpace((0, 0), (0, 1)),
        "right": fmbd.Obstacle(
            "ram", fmbd.Box((0.4, 2.0), center=(0.705, 0.0)), motion=lambda t: ((-0.2 * t, 0.3 * t), 0.1 * t)
        ),
        "top": fmbd.Obstacle("ball", fmbd.Sphere(0.15), on=ball),
    }
    scene = fmbd.Scene("squeezed", gravity=(0, -9.81))
    scene.add(body, ball, fmbd.Spring("spring", body.surface("left"), ball, stiffness=5.0))
    for side, what in obstacles.items():
        scene.add(fmbd.contact(side, body.surface(side), what, friction=0.3))
        for name, sensor in TOLD.items():
            scene.sensor(f"{side} {name}", sensor(side))
    scene.sensor("work", fmbd.contact_work())
    return scene


@pytest.mark.parametrize(("kind", "scheme"), zip(KINDS, SCHEMES, strict=True), ids=lambda x: getattr(x, "name", x))
def test_steps_in_contact_are_those_of_python(kind: str, scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Forces, books and counts, however many are asked for at once."""
    steps: dict[str, Any] = {"t_end": 0.03, "dt": 1e-3, "scheme": scheme}
    found, some = (fmbd.solve(squeezed(kind), output=fmbd.Output(every=n), **steps) for n in (1, 10))
    monkeypatch.setattr(ElasticContactStepper, "marches", False)
    alone = fmbd.solve(squeezed(kind), **steps)
    assert found.counters["compiled_steps"] == 30 and not alone.counters["compiled_steps"]
    for name in ("contact_steps", "impacts", "short_impacts"):
        assert found.counters[name] == alone.counters[name], name
    assert (found.state.q == some.state.q).all()

    rounding = 1e-9 if kind == "AbsoluteBody" else 1e-6
    np.testing.assert_allclose(found.state.q, alone.state.q, rtol=rounding, atol=rounding)
    for name in [f"{side} {what}" for side in ("bottom", "right", "top") for what in TOLD] + ["work"]:
        bar = 10 * rounding * np.abs(alone[name]).max()
        assert bar > 0.0
        np.testing.assert_allclose(found[name], alone[name], rtol=0.0, atol=bar, err_msg=name)
        assert (found[name][::10] == some[name]).all()


def leaned(dim: int, kind: str, degree: int = 1, *, hexahedra: bool = False, push: float = 0.2) -> Any:
    """A block lands on another one, slides, and is pushed at its side; the planes of hexahedra fan out along x."""

    def made(kind: str, name: str, size: Any, counts: Any, origin: Any, velocity: Any) -> Any:
        mesh = fmbd.read_gmsh(
            BLOCK, size=size[-dim:], counts=counts[-dim:], quads=dim == 2 or hexahedra, origin=origin[-dim:]
        )
        if hexahedra:
            x = mesh.dolfinx.geometry.x
            x[:, 1] *= 1.0 + 0.3 * x[:, 0]
        elastic = fmbd.materials.linear_elastic(50.0, 0.2)
        return getattr(fmbd, kind)(name, mesh, degree=degree, density=1.0, elastic=elastic, velocity=velocity[-dim:])

    low, high = ("bottom", "top") if dim == 2 else ("back", "front")
    lower = made("AbsoluteBody", "lower", (1.0, 1.0, 0.8), (3, 4, 1), (-0.5, -0.5, -0.8), (0.0, 0.0, 0.0))
    upper = made(kind, "upper", (0.6, 0.6, 0.4), (2, 3, 1), (-0.3, -0.2, 5e-4), (0.1, 0.3, -0.3))
    scene = fmbd.Scene("leaned", gravity=9.81 * -np.eye(dim)[-1])
    scene.add(lower, upper, fmbd.fixed("held", fmbd.ground, lower.surface(low)))
    scene.add(fmbd.contact("rub", upper.surface(low), lower.surface(high), friction=0.3))
    if push:
        scene.add(fmbd.force("push", upper.surface("right"), lambda t: tuple(-push * np.eye(dim)[0])))
    for name, sensor in TOLD.items():
        scene.sensor(name, sensor("rub"))
    scene.sensor("work", fmbd.contact_work())
    return scene


LEANED = [
    ((2, "AbsoluteBody"), SCHEMES[0]),
    ((2, "FloatingBody", 2), SCHEMES[2]),
    ((3, "AbsoluteBody", 2), SCHEMES[2]),
    ((3, "AbsoluteBody", 1, True), SCHEMES[0]),
]


@pytest.mark.parametrize(("what", "scheme"), LEANED, ids=str)
def test_surfaces_that_meet_are_those_of_python(what: Any, scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pairings, forces and books of two elastic surfaces; where nothing is opposite, too."""
    scene = leaned(*what[:3], hexahedra=len(what) > 3)
    found, some = (fmbd.solve(scene, t_end=0.03, dt=1e-3, scheme=scheme, output=fmbd.Output(every=n)) for n in (1, 10))
    monkeypatch.setattr(ElasticContactStepper, "marches", False)
    alone = fmbd.solve(scene, t_end=0.03, dt=1e-3, scheme=scheme)
    assert found.counters["compiled_steps"] == 30 and not alone.counters["compiled_steps"]
    for name in ("contact_steps", "impacts", "short_impacts"):
        assert found.counters[name] == alone.counters[name], name
    assert (found.state.q == some.state.q).all()

    rounding = 1e-9 if "AbsoluteBody" in what else 1e-6
    np.testing.assert_allclose(found.state.q, alone.state.q, rtol=rounding, atol=rounding)
    for name in (*TOLD, "work"):
        seen = np.isfinite(alone[name])
        assert (np.isfinite(found[name]) == seen).all() and (found[name][::10] == some[name]).all()
        bar = 10 * rounding * np.abs(alone[name][seen]).max()
        np.testing.assert_allclose(found[name][seen], alone[name][seen], rtol=0.0, atol=bar, err_msg=name)


def test_surfaces_that_meet_cost_few_calls() -> None:
    """Python is asked which facets may see each other, and for compliances of those that come near."""
    scene = leaned(2, "AbsoluteBody", push=0.0)

    def calls(steps: int) -> int:
        output = fmbd.Output(every=steps, progress=False)
        run = lambda: fmbd.solve(scene, t_end=1e-3 * steps, dt=1e-3, scheme=SCHEMES[0], output=output)  # noqa: E731
        return calls_of(run, "fmbd_fenicsx")

    calls(20)
    assert calls(80) - calls(40) < 40 * 60


@pytest.mark.parametrize(
    ("cells", "friction", "scheme"), [(320, 0.0, SCHEMES[0]), (120, 0.3, SCHEMES[0]), (120, 0.3, SCHEMES[2])], ids=str
)
def test_many_candidates_stay_compiled(
    cells: int, friction: float, scheme: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A slab that lands on many nodes, and slides: by products of the compliance, with few calls and the motion of Python."""
    mesh = fmbd.read_gmsh(BLOCK, size=(1.0, 0.2), counts=(cells, 2), quads=True, origin=(-0.5, 5e-4))
    elastic = fmbd.materials.linear_elastic(50.0, 0.2)
    slab = fmbd.AbsoluteBody("slab", mesh, degree=1, density=1.0, elastic=elastic, velocity=(0.2, -0.2))
    scene = fmbd.Scene("slab", gravity=(0, -9.81))
    scene.add(slab, fmbd.contact("floor", slab.surface("bottom"), fmbd.HalfSpace((0, 0), (0, 1)), friction=friction))

    def run(steps: int) -> Any:
        output = fmbd.Output(every=steps, energy=False, progress=False)
        return fmbd.solve(scene, t_end=1e-3 * steps, dt=1e-3, scheme=scheme, output=output)

    found = run(10)
    assert found.counters["compiled_steps"] == 10 and found.counters["compliance_products"] > 8
    calls = [calls_of(lambda steps=steps: run(steps), "fmbd_fenicsx") for steps in (10, 20)]
    assert calls[1] - calls[0] < 10 * 60
    monkeypatch.setattr(ElasticContactStepper, "marches", False)
    alone = run(10)
    np.testing.assert_allclose(found.state.q, alone.state.q, rtol=0, atol=1e-10)
    impulse = alone.state.contact.impulse
    np.testing.assert_allclose(found.state.contact.impulse, impulse, rtol=0, atol=1e-9 * np.abs(impulse).max())


@pytest.mark.parametrize(("scheme", "most"), [(fmbd.ContactMidpoint(theta=1.0), 2.1), (SCHEMES[2], 3.1)], ids=str)
def test_wheels_roll_in_few_iterations(scheme: Any, most: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Slips change with the place of their points, by what turns in a step: without that one increment more is needed in each."""
    v, load, width = 0.01, 4e-4, 0.02
    mesh = fmbd.read_gmsh(ROOT / "meshes/wheel.py", h=width / 4, depth=2 * width, coarse=0.3, start=-1.61, end=-1.45)
    elastic, rolls = fmbd.materials.linear_elastic(1.0, 0.45), {"velocity": (v, 0.0), "angular_velocity": -v}
    wheel = fmbd.FloatingBody("wheel", mesh, degree=1, density=0.01, elastic=elastic, **rolls)
    scene = fmbd.Scene("rolling")
    scene.add(wheel, fmbd.contact("road", wheel.surface("tread"), fmbd.HalfSpace((0, -1), (0, 1)), friction=0.3))
    scene.add(fmbd.force("load", wheel.surface("hub"), lambda t: (0.0, -load * np.sin(np.pi * t / 8) ** 2)))
    scene.sensor("force", fmbd.contact_force("road"))
    scene.sensor("speed", fmbd.velocity(wheel.surface("tread")))
    steps: dict[str, Any] = {"t_end": 5.0, "dt": 0.25, "scheme": scheme}
    found = fmbd.solve(scene, **steps)
    monkeypatch.setattr(ElasticContactStepper, "marches", False)
    alone = fmbd.solve(scene, **steps)
    assert found.counters["compiled_steps"] == 20
    c = found.counters
    assert c["contact_newton_iterations"] < most * c["contact_steps"]
    # one solution of the field an increment: how it answers to what contact forces change is held
    assert c["back_solves"] <= c["newton_iterations"] + c["compliance_columns"] + 10
    for name in ("force", "speed"):
        np.testing.assert_allclose(found[name], alone[name], rtol=0.0, atol=1e-7 * np.abs(alone[name]).max())


@pytest.mark.parametrize("scheme", SCHEMES[::2], ids=lambda s: s.name)
def test_two_bars_exchange_their_velocities(scheme: Any) -> None:
    """Bars of length L and wave speed c = 1 hit each other: for 2 L / c they press each other by rho c v / 2."""

    def bar(name: str, x: float, speed: float, n: int) -> Any:
        mesh = fmbd.read_gmsh(BLOCK, size=(1.0, 0.1), counts=(n, 1), quads=True, origin=(x, 0.0))
        elastic = fmbd.materials.linear_elastic(1.0, 0.0)
        return fmbd.AbsoluteBody(name, mesh, degree=1, density=1.0, elastic=elastic, velocity=(speed, 0.0))

    left, right = bar("left", -1.0, 0.1, 50), bar("right", 0.0, 0.0, 60)
    scene = fmbd.Scene("bars")
    scene.add(left, right, fmbd.contact("hit", right.surface("left"), left.surface("right")))
    scene.sensor("force", fmbd.contact_force("hit"))
    run = fmbd.solve(scene, t_end=2.3, dt=0.01, scheme=scheme)
    assert run.counters["compiled_steps"] == 230
    t, force, energy = run.times[1:], run["force"][1:, 0], run.total_energy
    on = (t > 0.1) & (t < 1.9)
    assert force[on].mean() == pytest.approx(0.005, rel=1e-2)
    assert t[force > 1e-9].max() == pytest.approx(2.0, abs=3 * run.dt)
    assert energy.max() <= energy[0] * (1 + 1e-8) and energy[-1] > 0.99 * energy[0]
    total = run.system.at(run.state.t, run.state.q, run.state.v).momenta()[0]
    assert total[0] == pytest.approx(0.01, rel=1e-12)


@pytest.mark.parametrize("scheme", SCHEMES[::2], ids=lambda s: s.name)
def test_flights_cost_no_calls(scheme: Any) -> None:
    """A call of Python a step at most, where those of steps in contact are hundreds."""
    scene = falling("FloatingBody", all_sorts=False)

    def calls(steps: int) -> int:
        output = fmbd.Output(every=steps, progress=False)
        run = lambda: fmbd.solve(scene, t_end=1e-4 * steps, dt=1e-4, scheme=scheme, output=output)  # noqa: E731
        return calls_of(run, "fmbd_fenicsx")

    calls(128)
    assert calls(1024) - calls(512) < 512


def test_flights_go_on_from_checkpoints(tmp_path: Path) -> None:
    """Before and behind the first step in contact, to the last bit, with what was counted."""
    steps: dict[str, Any] = {"t_end": 0.16, "dt": 2e-3, "scheme": fmbd.ContactMidpoint()}
    whole = at_every_step(lambda: falling("FloatingBody", all_sorts=False), tmp_path, (20, 72), **steps)
    assert whole.counters["compiled_steps"] > 60


def remembering(kind: str) -> Any:
    """A block in two hinges at one place, on a floor, with friction and controllers, a sampled one too, that have memories."""
    body = block(kind, "block", 0.01)
    pin = fmbd.revolute("pin", fmbd.ground, body.surface("left"), center=(-0.5, 0.21))
    s = fmbd.angle(pin)
    lagging = lambda t, y, z: (-5.0 * z[0], (10.0 * (y["s"][0] - z[0]),))  # noqa: E731
    scene = fmbd.Scene("remembering", gravity=(0, -9.81))
    scene.add(body, pin, fmbd.contact("floor", body.surface("bottom"), fmbd.HalfSpace((0, 0), (0, 1)), friction=0.2))
    scene.sensor("force", fmbd.reaction_force(pin))
    scene.add(
        fmbd.revolute("again", fmbd.ground, body.surface("left"), center=(-0.5, 0.21)),
        fmbd.pid("pid", s, target=-0.1, gains=(5.0, 20.0, 0.2)),
        fmbd.dry_friction("dry", s, limit=0.2, stick=50.0, damping=0.1),
        fmbd.controller("lag", reads={"s": s}, acts=s, law=lagging, memory=(0.0,)),
        fmbd.pid("sampled", s, target=-0.05, gains=(1.0, 1.0, 0.0), every=0.05),
    )
    return scene


@pytest.mark.parametrize(("kind", "scheme"), zip(KINDS, SCHEMES, strict=True), ids=lambda x: getattr(x, "name", x))
def test_steps_with_memories_and_redundant_rows_are_those_of_python(
    kind: str, scheme: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the smallest reactions; steps that end with a sample are Python's, and runs go on from checkpoints to the last bit."""
    steps: dict[str, Any] = {"t_end": 0.12, "dt": 2e-3, "scheme": scheme}
    found = at_every_step(lambda: remembering(kind), tmp_path, (30,), **steps)
    assert found.counters["compiled_steps"] > 50 and found.counters["contact_steps"] > 5
    monkeypatch.setattr(ElasticContactStepper, "marches", False)
    alone = fmbd.solve(remembering(kind), **steps)
    np.testing.assert_allclose(found.state.q, alone.state.q, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(found["force"], alone["force"], atol=1e-6 * np.abs(alone["force"]).max())
    for loads, others in zip(found.system.keepers, alone.system.keepers, strict=True):
        memory, other = (getattr(x.kept, "z", x.kept) for x in (loads, others))  # of controllers, of friction
        np.testing.assert_allclose(memory, other, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("every", [1, 1000])
@pytest.mark.parametrize("scheme", SCHEMES[::2], ids=lambda s: s.name)
def test_events_are_met_in_flights(scheme: Any, every: int) -> None:
    """A block in free fall passes a height within a step, and so does its gap."""
    scene = falling("FloatingBody", all_sorts=False)
    scene.sensor("low", fmbd.position(scene.bodies["block"].surface("bottom")))
    for sensor in ("low y", "gap"):
        passed = fmbd.Event(sensor, 0.03, direction=-1)
        run = solved(scene, scheme, output=fmbd.Output(every=every, events=[passed]))
        assert run.counters["compiled_steps"] > 40
        assert run.times[-1] == pytest.approx(np.sqrt(2 * 0.07 / 9.81), abs=1e-8)


def test_flights_end_before_what_is_thin(caplog: pytest.LogCaptureFixture) -> None:
    """A block that would pass through a plate, from as far before it as it is behind it then."""
    body = block("FloatingBody", "block", 0.98, velocity=(0.0, -20.0))
    scene = fmbd.Scene("plate")
    scene.add(body, fmbd.contact("plate", body.surface("bottom"), fmbd.Box((2.0, 0.01), center=(0.0, -0.1))))
    with caplog.at_level("WARNING", logger="fmbd_fenicsx"):
        run = fmbd.solve(scene, t_end=0.06, dt=4e-3, scheme=fmbd.ContactMidpoint())
    assert "could pass through" in caplog.text and run.counters["compiled_steps"] > 8
