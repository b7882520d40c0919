"""States of systems with elastic fields by the driver: what NumPy says of them, for balance and constraints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from profiled import calls_of

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.fem.factors import factor
from fmbd_fenicsx.linear import condensation
from fmbd_fenicsx.linear.blocks.field_blocks import Weights
from fmbd_fenicsx.linear.complementarity.delassus import Compliance
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.linear.prepared import Condensed
from fmbd_fenicsx.materials import (
    kelvin_voigt,
    linear_elastic,
    nearly_incompressible,
    neo_hookean_incompressible,
    neo_hookean_mixed,
    saint_venant_kirchhoff,
)
from fmbd_fenicsx.mechanics.contact.contact_set import ContactSet
from fmbd_fenicsx.schemes.consistent_states import all_corrected
from fmbd_fenicsx.system.compiled.choice import driver_states, use_driver
from fmbd_fenicsx.system.compiled.tables.bodies.field_forces import FieldForces
from fmbd_fenicsx.system.compiled.tables.bodies.fields import FieldTable
from fmbd_fenicsx.system.evaluator import NumPyEvaluator
from fmbd_fenicsx.system.layout import States

SMALL = {"elastic": linear_elastic(5e6, 0.3)}
LARGE = {"energy": saint_venant_kirchhoff(5e6, 0.3)}
PRESSED = {"elastic": nearly_incompressible(5e6, 0.5)}
BODIES = {  # in the world; a second one has another number
    "small strains": SMALL | {"stiffness_damping": 1e-3},
    "mass damping": SMALL | {"mass_damping": 0.2},
    "large strains": LARGE | {"stiffness_damping": 1e-3},
    "viscous": LARGE | {"viscous": kelvin_voigt(100.0)},
    "pressure": PRESSED | {"stiffness_damping": 1e-3},
    "pressure, large strains": {"energy": neo_hookean_mixed(5e6, 0.49), "stiffness_damping": 1e-3},
    "no change of volume": {"energy": neo_hookean_incompressible(5e6), "stiffness_damping": 1e-3},
}
FLOATING = {  # frames and laws
    "mean axes": (fmbd.MeanAxis(), SMALL),
    "attached": (fmbd.Attached("pin"), SMALL),
    "chord": (fmbd.Chord("pin", "tip"), SMALL),
    "mean axes, large strains": (fmbd.MeanAxis(), LARGE),
    "attached, large strains": (fmbd.Attached("pin"), LARGE),
    "mean axes, stiffened": (fmbd.MeanAxis(), SMALL | {"stiffening": "pin"}),
    "attached, stiffened": (fmbd.Attached("pin"), SMALL | {"stiffening": "pin"}),
    "attached, pressure": (fmbd.Attached("pin"), PRESSED),
    "mean axes, pressure, stiffened": (fmbd.MeanAxis(), PRESSED | {"stiffening": "pin"}),
    "chord, stiffened": (fmbd.Chord("pin", "tip"), SMALL | {"stiffening": "pin"}),
}


def swinging(mesh: Any, body: str, load: bool = False) -> fmbd.Scene:
    """A damped rod on a driven pin, a bob and a spring at its other end, gravity that is switched on."""
    if body in BODIES:
        rod: Any = fmbd.AbsoluteBody("rod", mesh, density=1000.0, **BODIES[body])
    else:
        frame, law = FLOATING[body]
        rod = fmbd.FloatingBody("rod", mesh, density=1000.0, frame=frame, stiffness_damping=1e-3, **law)
    d = rod.dim
    if load:
        rod = rod.with_(loads=(fmbd.loads.traction("tip", (10.0, 1.0, 0.0)[:d], time=lambda t: t),))
    bob = fmbd.RigidBody("bob", 2.0, 0.1 if d == 2 else (0.1, 0.2, 0.3), (1.0, 0.1, 0.0)[:d])
    scene = fmbd.Scene("swinging", gravity=(0.0, -9.81, 0.0)[:d], gravity_ramp=1.0)
    axis = {} if d == 2 else {"axis": (0, 0, 1)}
    pin = fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0, 0)[:d], **axis)
    scene.add(rod, bob, pin, fmbd.drive("drive", fmbd.angle(pin), lambda t: (t**3, 3 * t**2, 6 * t)))
    scene.add(fmbd.spherical("knee", rod.surface("tip"), bob, center=(1.0, 0.05, 0.0)[:d]))
    scene.add(fmbd.Spring("spring", fmbd.ground, rod.surface("tip"), (1, 1, 0)[:d], (1, 0, 0)[:d], stiffness=50.0))
    return scene


@pytest.mark.compiled
@pytest.mark.parametrize("body", [*FLOATING, *BODIES])
@pytest.mark.parametrize("dim", [2, 3])
def test_equal_to_numpy(rod_mesh: Callable[..., Any], dim: int, body: str) -> None:
    assert_equal_to_numpy(swinging(rod_mesh(dim=dim, h=0.5, height=0.2), body))


@pytest.mark.compiled
@pytest.mark.parametrize("body", ["attached, stiffened", "attached, large strains", "chord"])
def test_loads_on_bodies_in_frames(rod_mesh: Callable[..., Any], body: str) -> None:
    """They push the frame too; their stress in stiffened bodies, and their work on displacements of second order, is Python's."""
    assert_equal_to_numpy(swinging(rod_mesh(dim=3, h=0.5, height=0.2), body, load=True))


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
def test_several_bodies_in_the_world(rod_mesh: Callable[..., Any], dim: int) -> None:
    """Two of them with a load that follows one, joined to each other; and alone, where no frame moves."""
    mesh = rod_mesh(dim=dim, h=0.5, height=0.2)
    axis = {} if dim == 2 else {"axis": (0, 0, 1)}
    scene = fmbd.Scene("two", gravity=(0.0, -9.81, 0.0)[:dim])
    first = fmbd.AbsoluteBody("first", mesh, density=1000.0, **SMALL)
    second = fmbd.AbsoluteBody("second", mesh, density=500.0, loads=[fmbd.loads.pressure("side", 10.0)], **LARGE)
    scene.add(first, second, fmbd.revolute("pin", fmbd.ground, first.surface("pin"), center=(0, 0, 0)[:dim], **axis))
    scene.add(fmbd.revolute("hinge", first.surface("pin"), second.surface("pin"), center=(0, 0, 0)[:dim], **axis))
    assert_equal_to_numpy(scene)

    at = {"point_a": (1, 1, 0)[:dim], "point_b": (1, 0, 0)[:dim]}
    rope = fmbd.Spring("rope", fmbd.ground, second.surface("tip"), stiffness=50.0, **at)
    link = fmbd.RigidBody("link", 1.0, 1.0 if dim == 2 else (1, 1, 1))
    scene.add(rope, link, fmbd.spherical("knee", link, second.surface("tip"), center=(1, 0, 0)[:dim]))
    assert_equal_to_numpy(scene)


def assert_equal_to_numpy(scene: fmbd.Scene) -> None:
    """What the driver says of a state somewhere near the start."""
    system, start, _ = scene.build()
    states = driver_states(system)
    assert states is not None and not states.solves

    rng = np.random.default_rng(3)
    q = system.compose(start.q, 1e-3 * rng.normal(size=system.n_v))
    v, a = rng.normal(size=(2, system.n_v))
    lam = rng.normal(size=system.n_lam)
    expected, told = system.at(0.3, q, v), states.at(0.3, q, v)
    for name in ("constraint", "opening", "constraint_rate", "gamma"):
        assert getattr(told, name)() == pytest.approx(getattr(expected, name)(), rel=1e-11, abs=1e-12), name
    for given in ((a, lam), (a, None)):
        wanted = expected.balance(*given)
        assert told.balance(*given) == pytest.approx(wanted, rel=1e-11, abs=1e-12 * np.abs(wanted).max())
        for _, part in system.fields:  # forces are those of the newest pressure, also in one state
            if part.field.carried:
                part.field.pressure_values = part.field.pressure_values + 1e4
    assert told.energies() == pytest.approx(expected.energies(), rel=1e-11)
    assert told.jacobian.times(v) == pytest.approx(expected.jacobian.times(v), rel=1e-12)

    both = [np.stack((x, y)) for x, y in ((q, start.q), (v, start.v), (a, start.a), (lam, start.lam))]
    many = states.batch(np.array([0.3, 0.0]), both[0], both[1])
    balances = many.balance(both[2], both[3])
    assert balances[0] == pytest.approx(wanted := expected.balance(a, lam), rel=1e-11, abs=1e-12 * np.abs(wanted).max())
    for name in ("constraint", "opening", "gamma"):
        assert getattr(many, name)()[0] == pytest.approx(getattr(expected, name)(), rel=1e-11, abs=1e-12), name
    assert many.jacobian.times(both[1])[0] == pytest.approx(expected.jacobian.times(v), rel=1e-12)

    # increments of one configuration, and of several: counted angles of bodies without a frame are those of their surfaces
    numpy, xi = NumPyEvaluator(system), 0.3 * rng.normal(size=(2, system.n_v))
    xi[:, system.n_core :] *= 1e-2
    for way in (xi[0], xi):
        assert states.compose(q, way) == pytest.approx(moved := numpy.compose(q, way), rel=1e-13, abs=1e-13)
        assert states.difference(q, moved, None) == pytest.approx(
            numpy.difference(q, moved, None), rel=1e-12, abs=1e-12
        )
        assert states.rate(way, way) == pytest.approx(numpy.rate(way, way), rel=1e-12, abs=1e-12)
    assert calls_of(lambda: states.compose(q, xi)) <= 16


@pytest.mark.compiled
@pytest.mark.parametrize("body", ["mean axes", "small strains", "large strains"])
@pytest.mark.parametrize("dim", [2, 3])
def test_equal_to_numpy_with_contact(rod_mesh: Callable[..., Any], dim: int, body: str) -> None:
    """Contact nodes have no inertia of their own."""
    scene = swinging(rod_mesh(dim=dim, h=0.25, height=0.2), body)
    rod = scene.bodies["rod"]
    up = (0.0, 1.0, 0.0)[:dim]
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0.0, -0.2, 0.0)[:dim], up))
    scene.add(fmbd.contact("touch", rod.surface("side"), floor))
    assert_equal_to_numpy(scene)


def compliance(system: Any, ev: Any, weights: Weights) -> tuple[np.ndarray, bool]:
    """W of normal and tangential rows of every fourth candidate in a state, and whether the driver has found it."""
    solver = StepSolver(system)
    ev.balance(np.zeros(system.n_v), np.zeros(system.n_lam))
    solver.prepare(ev, weights)
    rows = system.contacts.rows(system, ev.t, ev.q)
    rows = rows.take(np.arange(0, len(rows.gap), 4)).L
    driver = solver.driver
    return Compliance(solver, system.contacts).matrix(rows), driver is not None and driver.ready


@pytest.mark.compiled
@pytest.mark.parametrize("obstacle", ["at rest", "on a body"])
@pytest.mark.parametrize("body", ["mean axes", "small strains", "large strains", "alone"])
@pytest.mark.parametrize("dim", [2, 3])
def test_compliances_of_contact_are_those_of_numpy(
    rod_mesh: Callable[..., Any], dim: int, body: str, obstacle: str
) -> None:
    """Through joints, a spring and the body that carries the obstacle, and of a body with nothing but its frame's conditions."""
    scene = swinging(rod_mesh(dim=dim, h=0.25, height=0.2), "mean axes" if body == "alone" else body)
    rod = next(iter(scene.bodies.values()))
    if body == "alone":
        scene = fmbd.Scene("alone")
        scene.add(rod)
    carried: dict[str, Any] = {}
    if obstacle == "on a body":
        inertia: Any = 2.0 if dim == 2 else (1.0, 2.0, 3.0)
        carried["on"] = fmbd.RigidBody("table", 3.0, inertia, position=(0.1, -0.3, 0.0)[:dim])
        scene.add(carried["on"])
    shape = fmbd.HalfSpace((0.0, 0.05, 0.0)[:dim], (0.2, 1.0, 0.1)[:dim])
    scene.add(fmbd.contact("touch", rod.surface("side"), fmbd.Obstacle("floor", shape, **carried), friction=0.3))

    system, state, _ = scene.build()
    rng = np.random.default_rng(4)
    q = system.compose(state.q, 0.02 * rng.standard_normal(system.n_v))
    v = 0.1 * rng.standard_normal(system.n_v)
    weights = Weights(1.0, 1e-3, 1e-6)
    expected, compiled_there = compliance(system, system.at(0.0, q, v), weights)
    assert not compiled_there
    use_driver(system)
    found, compiled_here = compliance(system, system.at(0.0, q, v), weights)
    assert compiled_here
    assert found == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


@pytest.mark.compiled
def test_multipliers_of_a_free_bodys_frame_are_not_roundoff(rod_mesh: Callable[..., Any]) -> None:
    """No joint gives its columns a compliance: what is left of it was taken for one, and multipliers were divided by roundoff."""
    scene = fmbd.Scene("free")
    scene.add(next(iter(swinging(rod_mesh(dim=3, h=0.25, height=0.2), "mean axes").bodies.values())))
    system, state, _ = scene.build()
    rng = np.random.default_rng(5)
    b, c = rng.standard_normal(system.n_v), 1e-3 * rng.standard_normal(system.n_lam)
    answers = []
    for _ in range(2):
        solver, ev = StepSolver(system), system.at(0.0, state.q, state.v)
        ev.balance(np.zeros(system.n_v), np.zeros(system.n_lam))
        solver.prepare(ev, Weights(1.0, 1e-3, 1e-6))
        answers.append(solver.solve(b, c))
        use_driver(system)
    assert solver.driver is not None
    assert solver.driver.ready
    for found, expected in zip(answers[1], answers[0], strict=True):
        assert found == pytest.approx(expected, abs=1e-8 * np.abs(expected).max())


@pytest.mark.compiled
@pytest.mark.parametrize("body", ["mean axes", "attached, pressure", "large strains", "pressure, large strains"])
def test_corrections_of_many_states_are_those_of_numpy(rod_mesh: Callable[..., Any], body: str) -> None:
    """a and lambda nearer to balance and rows, of states in two metrics: one call for each."""
    system, start, _ = swinging(rod_mesh(dim=2, h=0.5, height=0.2), body).build()
    rng, few, scale = np.random.default_rng(5), 5, np.zeros(system.n_v)
    scale[: system.n_core] = 1.0  # of a bent body NumPy's masses lack the moments that the driver corrects
    rows = [system.compose(start.q, 1e-3 * scale * rng.normal(size=system.n_v)) for _ in range(few)]
    v, a = 0.1 * scale * rng.normal(size=(few, system.n_v)), rng.normal(size=(few, system.n_v))
    states = States(np.linspace(0.1, 0.3, few)[:, None], np.array(rows), v, a, rng.normal(size=(few, system.n_lam)))
    metrics = [Weights(1.0, h, h * h) for h in (1e-3, 1e-3, 1e-2, 1e-3, 1e-2)]
    expected = all_corrected(system, states, StepSolver(system), metrics)

    use_driver(system)
    solver = StepSolver(system)
    solver.prepare(system.at(0.0, start.q, start.v), metrics[0])
    assert solver.driver is not None
    assert solver.driver.all_corrected(states, metrics[:1] * few) is not None
    found = all_corrected(system, states, solver, metrics)
    for name in ("a", "lam"):
        one = getattr(expected, name)
        assert getattr(found, name) == pytest.approx(one, rel=1e-7, abs=1e-7 * np.abs(one).max()), name


def solved(solver: StepSolver, ev: Any, weights: Weights) -> Any:
    """x and y for random right-hand sides, and motions that close single rows; frame conditions stay closed."""
    rng, system = np.random.default_rng(5), ev.system
    rows = np.setdiff1d(np.arange(system.n_lam), np.concatenate([np.r_[span] for span in system.frame_rows]))
    c = np.zeros(system.n_lam)
    c[rows] = rng.normal(size=len(rows))

    solver.prepare(ev, weights)
    return *solver.solve(rng.normal(size=system.n_v), c), solver.closing(np.eye(system.n_lam)[:, rows])


@pytest.mark.compiled
@pytest.mark.parametrize("body", [*FLOATING, *BODIES])
@pytest.mark.parametrize("dim", [2, 3])
def test_solutions_are_those_of_numpy(rod_mesh: Callable[..., Any], dim: int, body: str) -> None:
    """With masses alone and with the matrix of a step, one after the other; the matrix of a state is made once."""
    system, start, _ = swinging(rod_mesh(dim=dim, h=0.5, height=0.2), body).build()
    states = driver_states(system)
    assert states is not None
    rng = np.random.default_rng(3)
    moved, v = rng.normal(size=(2, system.n_v))
    moved[system.n_core :] = 0.0  # of a bent body NumPy's masses lack the moments that the driver corrects
    q = system.compose(start.q, 1e-3 * moved)

    sizes = Weights(1.0, 0.0, 0.0), Weights(1.0, 1e-3, 1e-6), Weights(1.0, 0.0, 0.0)
    plain = StepSolver(system)
    wanted = [solved(plain, system.at(0.3, q, v), weights) for weights in sizes]
    system.evaluate_by(states)
    driven = StepSolver(system)
    for weights, expected in zip(sizes, wanted, strict=True):
        for found, one in zip(solved(driven, system.at(0.3, q, v), weights), expected, strict=True):
            assert found == pytest.approx(one, rel=1e-6, abs=1e-6 * np.abs(one).max())
        assert driven.driver is not None and driven.driver.ready
        assert driven.holds(system.at(0.3, q, v), weights) and not driven.holds(system.at(0.4, q, v), weights)
    assert driven.core.factorisations <= 2 * len(sizes)


@pytest.mark.compiled
@pytest.mark.parametrize("body", [*FLOATING, *BODIES])
@pytest.mark.parametrize("dim", [2, 3])
def test_complex_solutions_are_those_of_numpy(rod_mesh: Callable[..., Any], dim: int, body: str) -> None:
    """For motions of a complex frequency, as stages of implicit schemes ask for them; bodies with modes beside the field."""
    scene, s = swinging(rod_mesh(dim=dim, h=0.5, height=0.2), body), 300.0 + 400.0j
    modes = fmbd.FloatingBody(
        "reduced", rod_mesh(dim=dim, h=0.5, height=0.2), density=500.0, stiffness_damping=1e-3, **SMALL
    )
    scene.add(reduced := modes.reduced(modes=4))
    scene.add(fmbd.spherical("end", reduced.surface("pin"), scene.bodies["bob"], center=(1.0, 0.2, 0.0)[:dim]))
    system, start, _ = scene.build()
    rng = np.random.default_rng(3)
    moved, v = rng.normal(size=(2, system.n_v))
    moved[system.n_core :] = 0.0  # as above
    q = system.compose(start.q, 1e-3 * moved)
    b = rng.normal(size=(2, system.n_v))
    c = rng.normal(size=(2, system.n_lam))
    for span in system.frame_rows:
        c[:, span] = 0.0

    found = []
    for states in (None, driver_states(system)):
        if states is not None:
            system.evaluate_by(states)
        solver = StepSolver(system)
        solver.prepare(system.at(0.3, q, v), Weights(1.0, 1.0 / s, 1.0 / s**2))
        assert (solver.driver is not None and solver.driver.ready) == (states is not None)
        found.append(solver.solve(b[0] + 1j * b[1], c[0] + 1j * c[1]))
    for one, other in zip(*found, strict=True):
        assert other == pytest.approx(one, rel=1e-6, abs=1e-6 * np.abs(one).max())


@pytest.mark.compiled
@pytest.mark.parametrize("body", ["mean axes", "mean axes, large strains", "large strains", "attached, stiffened"])
@pytest.mark.parametrize(
    "scheme", [fmbd.Rattle(), fmbd.HalfExplicit(rtol=None), fmbd.BDF(order=2, rtol=None)], ids=lambda s: s.name
)
def test_steps_are_solved_in_the_driver(
    rod_mesh: Callable[..., Any], scheme: Any, body: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """NumPy condenses no field on the core; the motion is the same."""
    scene = lambda: swinging(rod_mesh(dim=2, h=0.5, height=0.2), body)
    dt = 1e-5 if scheme.name != fmbd.BDF(order=2, rtol=None).name else 1e-4

    def run() -> tuple[fmbd.Run, int]:
        found: list[Any] = []
        condense = Condensed._factor
        with monkeypatch.context() as patch:
            patch.setattr(Condensed, "_factor", lambda *given: (found.append(1), condense(*given))[1])
            made = fmbd.solve(scene(), t_end=20 * dt, dt=dt, scheme=scheme, output=fmbd.Output(progress=False))
        return made, len(found)

    fast, few = run()
    monkeypatch.setattr(condensation, "driver_solver", lambda *given: None)
    slow, many = run()
    assert few < 10 < many
    for name in ("q", "v", "lam"):
        one = getattr(slow.state, name)
        assert getattr(fast.state, name) == pytest.approx(one, rel=1e-6, abs=1e-6 * np.abs(one).max()), name


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [fmbd.ContactAlpha(0.8), fmbd.ContactMidpoint()], ids=lambda s: s.name)
@pytest.mark.parametrize("body", ["mean axes", "small strains"])
def test_steps_with_contact_are_solved_in_the_driver(
    rod_mesh: Callable[..., Any], body: str, scheme: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And those in contact: NumPy condenses fields for the start alone, and places are looked at twice a step out of contact."""
    mesh = rod_mesh(dim=2, h=0.5, height=0.2)

    def scene(below: float) -> fmbd.Scene:
        made = swinging(mesh, body)
        surface = next(iter(made.bodies.values())).surface("side")
        made.add(fmbd.contact("floor", surface, fmbd.Obstacle("floor", fmbd.HalfSpace((0, -below), (0, 1)))))
        made.gravity_ramp = 0.0
        return made

    def run(below: float) -> tuple[fmbd.Run, int, int]:
        condensed: list[Any] = []
        looked: list[Any] = []
        condense, look = Condensed._factor, ContactSet._looked_at
        with monkeypatch.context() as patch:
            patch.setattr(Condensed, "_factor", lambda *given: (condensed.append(1), condense(*given))[1])
            patch.setattr(ContactSet, "_looked_at", lambda *given: (looked.append(1), look(*given))[1])
            made = fmbd.solve(scene(below), t_end=0.04, dt=1e-3, scheme=scheme, output=fmbd.Output(progress=False))
        return made, len(condensed), len(looked)

    _, none, looks = run(5.0)
    assert none <= 3
    assert looks <= 2 * 40 + 4

    fast, few, _ = run(0.102)
    touched = int(fast.counters["contact_steps"])
    assert 2 <= touched <= 30
    assert few <= 3
    monkeypatch.setattr(condensation, "driver_solver", lambda *given: None)
    slow, many, _ = run(0.102)
    assert many >= 40
    for name, bar in (("q", 1e-8), ("v", 1e-5)):
        one = getattr(slow.state, name)
        assert getattr(fast.state, name) == pytest.approx(one, rel=bar, abs=bar * np.abs(one).max()), name


@pytest.mark.compiled
@pytest.mark.parametrize("body", ["mean axes", "mean axes, large strains", "attached, large strains", "large strains"])
def test_new_tangents(rod_mesh: Callable[..., Any], body: str) -> None:
    """The columns of a bent body's inertia, and their number where axes are mean ones, change while states are asked for."""
    system, start, _ = swinging(rod_mesh(dim=2, h=0.5, height=0.2), body).build()
    states, weights = driver_states(system), Weights(1.0, 1e-3, 1e-6)
    assert states is not None
    rng = np.random.default_rng(3)
    v = rng.normal(size=system.n_v)
    q = system.compose(start.q, 1e-2 * rng.normal(size=system.n_v))

    driven, plain = StepSolver(system), StepSolver(system)
    system.evaluate_by(states)
    solved(driven, before := system.at(0.3, q, v), weights)
    before.take_tangents()
    assert not driven.holds(system.at(0.3, q, v), weights)
    found = solved(driven, at := system.at(0.3, q, v), weights)
    told = at.constraint(), at.gamma(), at.balance(v, start.lam + 1.0)

    system.evaluate_by(NumPyEvaluator(system))
    wanted = system.at(0.3, q, v)
    assert driven.driver is None
    expected = wanted.constraint(), wanted.gamma(), wanted.balance(v, start.lam + 1.0)
    for one, other in zip((*found, *told), (*solved(plain, wanted, weights), *expected), strict=True):
        assert one == pytest.approx(other, rel=1e-6, abs=1e-6 * np.abs(other).max())


@pytest.mark.compiled
@pytest.mark.parametrize("body", ["attached", "attached, pressure", "pressure, large strains"])
@pytest.mark.parametrize("dim", [2, 3])
def test_factors_of_fields_are_solved_with_in_c(
    rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, dim: int, body: str
) -> None:
    """No step of generalized-alpha asks Python to solve, solves count as before, and one that its judge refuses is Python's."""
    asked: list[int] = []
    solve = FieldTable.solve
    monkeypatch.setattr(FieldTable, "solve", lambda table: (asked.append(table.number), solve(table)))

    def run() -> tuple[Any, int]:
        asked.clear()
        scene = swinging(rod_mesh(dim=dim), body)
        scene.sensor("bob", fmbd.position(scene.bodies["bob"]))
        return fmbd.solve(scene, t_end=0.1, dt=0.01), len(asked)

    here, none = run()
    monkeypatch.setattr(factor, "address_of_solve", lambda: None)
    there, every = run()
    monkeypatch.undo()
    monkeypatch.setattr(FieldTable, "solve", lambda table: (asked.append(table.number), solve(table)))
    in_c = factor.Factor.in_c
    monkeypatch.setattr(
        factor.Factor, "in_c", lambda self: replace(in_c(self), mass=1.001 * self.cm, stiffness=1.001 * self.ck)
    )
    doubted, refused = run()

    assert none == 0 and refused == every > 10
    for name in ("back_solves", "newton_iterations"):
        assert here.counters[name] == there.counters[name] == doubted.counters[name]
    assert here.counters["worst_linear_residual"] == pytest.approx(there.counters["worst_linear_residual"], rel=10.0)
    for other in (there, doubted):
        assert here["bob"] == pytest.approx(other["bob"], abs=1e-9)


@pytest.mark.compiled
@pytest.mark.parametrize("body", ["large strains", "attached, large strains"])
def test_python_tells_loads_of_large_strains_once_a_time(
    rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, body: str
) -> None:
    """And nothing else: elasticity, damping, inertia and weight are compiled, in frames that move too."""
    asked: list[float] = []
    load = FieldForces.load
    monkeypatch.setattr(FieldForces, "load", lambda *given: (asked.append(given[1]), load(*given))[1])
    monkeypatch.setattr(FieldTable, "forces", None)
    system, start, _ = swinging(rod_mesh(h=0.5, height=0.2), body, load=True).build()
    states = driver_states(system)
    for t, v in ((0.1, 0.0), (0.1, 1.0), (0.2, 1.0)):
        for a in (start.a, start.a + 1.0):
            states.at(t, start.q, start.v + v).balance(a, start.lam)
    assert asked == [0.1, 0.2]

    turned = start.q.copy()  # loads keep their direction in the world
    turned[2] += 0.0 if body in BODIES else 0.1
    found = states.at(0.2, turned, start.v + 1.0).balance(start.a, start.lam)
    wanted = system.at(0.2, turned, start.v + 1.0).balance(start.a, start.lam)
    assert found == pytest.approx(wanted, rel=1e-9, abs=1e-9 * np.abs(wanted).max())


@pytest.mark.compiled
def test_tables_share_the_matrices_of_a_field(rod_mesh: Callable[..., Any]) -> None:
    """Steps and states have tables of their own, with the same M and K."""
    system = swinging(rod_mesh(dim=2), "attached").build()[0]
    use_driver(system)
    one, other = (system.evaluator.tables_of().fields[0].c for _ in range(2))
    assert (one.M, one.K, one.K_column) == (other.M, other.K, other.K_column) and one.z != other.z


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
def test_work_of_forces_is_that_of_numpy(rod_mesh: Callable[..., Any], dim: int) -> None:
    """Of springs on bodies and on their surfaces, and of a force of time."""
    scene = swinging(rod_mesh(dim=dim, h=0.25, height=0.2), "mean axes")
    tip = scene.bodies["rod"].surface("tip")
    scene.add(fmbd.force("push", tip, lambda t: np.array((1.0 + t, -2.0, 0.5))[:dim]))
    system, state, _ = scene.build()
    rng = np.random.default_rng(6)
    q = system.compose(state.q, 0.02 * rng.standard_normal(system.n_v))
    v, xi = rng.standard_normal(system.n_v), rng.standard_normal(system.n_v)
    expected = system.at(0.3, q, v).work(xi)
    use_driver(system)
    ev = system.at(0.3, q, v)
    found = ev.work(xi)
    assert "kin" not in vars(ev)  # no marker was looked at in NumPy
    assert found == pytest.approx(expected, rel=1e-10)
