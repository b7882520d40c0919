"""Reactions of joints that depend on each other: the smallest with the same forces, at any time, in every scheme; named."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp
from combinations import BODIES
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear import redundancy
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.linear.configuration_warnings import LOOK_LIMIT
from fmbd_fenicsx.linear.core import CoreSolver
from fmbd_fenicsx.linear.driver_solver import FieldDriverSolver
from fmbd_fenicsx.linear.implicit.pencil import Pencil
from fmbd_fenicsx.linear.redundancy import least
from fmbd_fenicsx.matrices import dense
from fmbd_fenicsx.schemes.implicit.implicit_stepper import ImplicitStepper
from fmbd_fenicsx.schemes.implicit.step_equations import StepEquations
from fmbd_fenicsx.schemes.implicit.step_tangents import DenseTangents
from fmbd_fenicsx.system.compiled.choice import use_driver

MASS, WIDTH, HEIGHT, LEVELS = 20.0, 0.8, 2.0, (0.2, 1.8)

SCHEMES = [
    (fmbd.GeneralizedAlpha(0.9), 0.02),
    (fmbd.GeneralizedAlpha(0.9, form=fmbd.GGL()), 0.02),
    (fmbd.Radau(3), None),
    (fmbd.Radau(2, fmbd.Overdetermined(), None), 0.02),
    (fmbd.BDF(rtol=1e-5), None),
    (fmbd.Rattle(), 0.02),
    (fmbd.HalfExplicit(), None),
    (fmbd.ExplicitRungeKutta(), None),
    (fmbd.EnergyMomentum(), 0.02),
]


def door(rate: float) -> fmbd.Scene:
    """A door on two hinges that turns at a steady rate under its weight."""
    moments = MASS / 12 * np.array([HEIGHT**2, WIDTH**2 + HEIGHT**2, WIDTH**2])
    place = {"position": (WIDTH / 2, 0.0, HEIGHT / 2), "velocity": (0.0, rate * WIDTH / 2, 0.0)}
    body = fmbd.RigidBody("door", MASS, moments, angular_velocity=(0.0, 0.0, rate), **place)
    scene = fmbd.Scene("door", gravity=(0.0, 0.0, -9.81))
    scene.add(body)
    for name, z in zip(("low", "high"), LEVELS, strict=True):
        scene.add(fmbd.revolute(name, fmbd.ground, body, center=(0.0, 0.0, z), axis=(0.0, 0.0, 1.0)))
        scene.sensor(name, fmbd.reaction(name))
    return scene


def smallest(rate: float, length: float) -> float:
    """Norm of the smallest ten reactions that carry weight and centripetal force, moments over a length, by hand."""
    columns = []
    for z in LEVELS:
        columns += [np.r_[e, np.cross((0.0, 0.0, z), e)] for e in np.eye(3)]
        columns += [np.r_[0.0, 0.0, 0.0, length * e] for e in np.eye(3)[:2]]
    force = np.array([-MASS * rate**2 * WIDTH / 2, 0.0, MASS * 9.81])
    load = np.r_[force, np.cross((WIDTH / 2, 0.0, HEIGHT / 2), force)]
    found = np.linalg.lstsq(np.array(columns).T, load, rcond=None)[0]
    return float(np.linalg.norm(found * np.tile([1.0, 1.0, 1.0, length, length], 2)))


@pytest.mark.parametrize(("scheme", "dt"), SCHEMES, ids=lambda x: getattr(x, "name", None))
def test_a_door_on_two_hinges(scheme: Any, dt: float | None) -> None:
    """The same smallest reactions at any angle of the door."""
    rate = 2.0
    run = fmbd.solve(door(rate), t_end=3.0, dt=dt, scheme=scheme)
    found = np.linalg.norm(np.hstack([run["low"], run["high"]]), axis=1)
    # a moment counts as a pair of forces at the model's length
    assert found == pytest.approx(smallest(rate, run.system.length / np.sqrt(2.0)), rel=1e-4)
    assert run.not_unique == ["low", "high"]
    assert "reactions of low, high" in run.report().replace("\n", " ")


def gate(tilt: float) -> fmbd.Scene:
    """A gate that falls on two hinges; the axis of one is off by ``tilt`` rad."""
    body = fmbd.RigidBody("gate", 1.0, (0.1,) * 3, position=(1.0, 0.0, 0.0))
    scene = fmbd.Scene("gate", gravity=(0.0, -9.81, 0.0))
    scene.add(body, fmbd.revolute("low", fmbd.ground, body, center=(0.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0)))
    scene.add(fmbd.revolute("high", fmbd.ground, body, center=(0.0, tilt, 1.0), axis=(tilt, 0.0, 1.0)))
    scene.sensor("place", fmbd.position(body))
    for name in ("low", "high"):
        scene.sensor(name + " force", fmbd.reaction_force(name))
        scene.sensor(name + " moment", fmbd.reaction_torque(name))
    return scene


@pytest.mark.compiled
@pytest.mark.parametrize("increments", ["NumPy", "compiled"])
@pytest.mark.parametrize("scheme", [fmbd.Radau(2), fmbd.BDF()], ids=lambda x: x.name)
def test_hinges_that_are_not_quite_in_line_take_no_more_steps(scheme: Any, increments: str, monkeypatch: Any) -> None:
    """Stresses that such hinges put on each other grow with each increment, and move nothing: they are no error of the motion."""
    if increments == "NumPy":
        monkeypatch.setattr(ImplicitStepper, "_made", lambda *_: 0)

    straight, tilted = (fmbd.solve(gate(tilt), t_end=0.4, scheme=scheme) for tilt in (0.0, 1e-8))
    assert tilted.counters["steps"] <= 1.1 * straight.counters["steps"]
    assert tilted["place"][-1] == pytest.approx(straight["place"][-1], abs=1e-6)


@pytest.mark.parametrize(
    ("scheme", "dt"),
    [*SCHEMES, (fmbd.GeneralizedAlpha(0.9, compiled=False), 0.02), (fmbd.Radau(2, fmbd.Index3(), None), 0.02)],
    ids=lambda x: getattr(x, "name", None),
)
def test_hinges_a_hair_out_of_line_bear_what_those_in_line_do(scheme: Any, dt: float | None) -> None:
    """Rows that no step could tell from rows that are the same: no stress of 1e5 N, and as many steps."""
    dt = dt and 3e-3  # s: stress goes with 1 / dt^2
    straight, tilted = (fmbd.solve(gate(tilt), t_end=0.3, dt=dt, scheme=scheme) for tilt in (0.0, 1e-7))
    assert tilted.counters["steps"] <= 1.1 * straight.counters["steps"]
    assert tilted["place"][-1] == pytest.approx(straight["place"][-1], abs=1e-5)
    for name in ("low", "high"):
        np.testing.assert_allclose(tilted[name + " force"][-1], straight[name + " force"][-1], rtol=0, atol=1e-3)
        np.testing.assert_allclose(tilted[name + " moment"][-1], straight[name + " moment"][-1], rtol=0, atol=1e-3)


def test_hinges_that_hold_nearly_the_same_are_told_of(caplog: pytest.LogCaptureFixture) -> None:
    """Once, with what to do, where the run begins; whether such a scene goes on or stops, its forces are no surprise."""
    fmbd.solve(gate(1e-5), t_end=0.003, dt=0.003)
    assert caplog.text.count("hold nearly the same") == 1
    (note,) = [x for x in gate(1e-5).check().notes if "hold nearly the same" in x]
    assert '"low", "high"' in note and "bushing" in note and "4e-06" in note.replace("3.7e-06", "4e-06")


def test_smallest_forces_of_a_compliance_leave_out_what_rows_contradict_each_other_in() -> None:
    """S y = b with rows that are there twice, whose right-hand sides differ by 1e-6: y is as large as without."""
    rng = np.random.default_rng(0)
    G = rng.normal(size=(8, 20))
    G = np.vstack((G, G[:4]))
    S = sp.csc_matrix(G @ G.T)
    b = S @ rng.normal(size=12)
    fit = redundancy.least_forces(S, b)
    assert np.abs(S @ fit - b).max() < 1e-13 * np.abs(b).max()
    b[0] += 1e-6 * np.abs(b).max()
    assert redundancy.least_forces(S, b) == pytest.approx(fit, abs=1e-3 * np.abs(fit).max())


@pytest.mark.compiled
@pytest.mark.parametrize(
    "scheme",
    [fmbd.Radau(3), fmbd.Radau(2, fmbd.Index2()), fmbd.BDF(rtol=1e-5), fmbd.BDF(form=fmbd.Index3())],
    ids=lambda x: f"{x.name}",
)
def test_stages_beside_dependent_rows_are_compiled(scheme: Any, monkeypatch: Any) -> None:
    """No matrix is dense; steps, iterations and the smallest reactions are those of NumPy."""

    def run() -> Any:
        return fmbd.solve(door(2.0), t_end=0.5, scheme=scheme)

    with monkeypatch.context() as here:
        here.setattr(StepEquations, "_structure", lambda eq: None)
        slow = run()
    with monkeypatch.context() as here:
        here.setattr(DenseTangents, "take", None)
        here.setattr(Pencil, "_factor", None)
        fast = run()
    for name in ("steps", "newton_iterations", "jacobians"):
        assert fast.counters[name] == slow.counters[name]
    for name in ("low", "high"):
        np.testing.assert_allclose(fast[name], slow[name], rtol=0, atol=1e-7 * np.abs(slow[name]).max())


def null_space(ev: Any) -> np.ndarray:
    """Multipliers over their units, orthonormal, that are no force on any body."""
    system = ev.system
    rows = [dense(ev.jacobian.core) / system.units[: system.n_core]]
    rows += [dense(ev.jacobian.port[:, system.port_slice(k)]) for k, _ in system.fields]
    return sl.null_space((system.multiplier_units[:, None] * np.concatenate(rows, axis=1)).T, rcond=1e-9)


@pytest.mark.parametrize("driven", [False, pytest.param(True, marks=pytest.mark.compiled)], ids=["NumPy", "driver"])
def test_a_stress_between_the_hinges_is_taken_away_and_nothing_else(driven: bool, monkeypatch: Any) -> None:
    """The forces on the bodies stay; what is left is orthogonal to every state of stress."""
    system, state, _ = door(1.0).build()
    if driven:
        use_driver(system)
    solver = StepSolver(system)
    ev = system.at(state.t, state.q, state.v)
    from fmbd_fenicsx.linear.blocks.field_blocks import Weights

    solver.prepare(ev, Weights(1.0, 0.0, 0.0))
    N = null_space(ev)
    assert N.shape == (10, 5)
    lam = np.random.default_rng(0).normal(size=10)
    if driven:
        monkeypatch.setattr(redundancy, "smallest", None)
    small = least(solver, ev.t, ev.q, lam + system.multiplier_units * (N @ np.full(5, 1e6)))
    assert least(solver, ev.t, ev.q, np.stack((small, lam))) == pytest.approx(np.stack((small, small)), abs=1e-8)
    assert np.abs(N.T @ (small / system.multiplier_units)).max() < 1e-8
    assert np.abs(ev.jacobian.transposed(small - lam)).max() < 1e-8
    solver.destroy()


def unbalanced(length: float) -> fmbd.Scene:
    """A rotor with its centre on the axis that pulls at its two hinges by a moment only, in a unit of length."""
    inertia = length**2 * np.array([[0.2, 0.0, 0.05], [0.0, 0.2, 0.0], [0.05, 0.0, 0.3]])
    rotor = fmbd.RigidBody("rotor", 1.0, inertia, angular_velocity=(0.0, 0.0, 3.0))
    scene = fmbd.Scene("rotor")
    scene.add(rotor)
    for name, z in (("low", -0.5), ("high", 0.5)):
        scene.add(fmbd.revolute(name, fmbd.ground, rotor, center=(0.0, 0.0, z * length)))
        scene.sensor(f"{name} force", fmbd.reaction_force(name))
        scene.sensor(f"{name} moment", fmbd.reaction_torque(name))
    return scene


@pytest.mark.compiled
@pytest.mark.parametrize("length", [1.0, 1e-6, 1e-9])
def test_moments_without_forces_are_borne_in_any_unit(length: float, monkeypatch: Any) -> None:
    """w x J w of the rotor is what both hinges give together; forces that are roundoff beside it do not send steps to NumPy."""
    asked = []
    by_numpy = redundancy.smallest
    monkeypatch.setattr(redundancy, "smallest", lambda ev, lam: (asked.append(ev.t), by_numpy(ev, lam))[1])
    run = fmbd.solve(unbalanced(length), t_end=0.5, dt=0.01, scheme=fmbd.EnergyMomentum())

    arm = np.array([0.0, 0.0, 0.5 * length])
    force, moment = ({name: run[f"{name} {of}"][-1] for name in ("low", "high")} for of in ("force", "moment"))
    together = moment["low"] + moment["high"] + np.cross(arm, force["high"] - force["low"])
    assert np.linalg.norm(together) == pytest.approx(9.0 * 0.05 * length**2, rel=1e-3)
    assert len(asked) <= 2  # at the start, and for the report


def test_unique_reactions_are_left_alone() -> None:
    body = fmbd.RigidBody("b", 1.0, 0.1, position=(0.5, 0.0))
    scene = fmbd.Scene("one pin", gravity=(0.0, -9.81))
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body, center=(0.0, 0.0)))
    run = fmbd.solve(scene, t_end=0.1, dt=0.01)
    assert run.not_unique == [] and "not unique" not in run.report()


@pytest.mark.parametrize(
    "scheme", [fmbd.Radau(3, form=fmbd.Index1()), fmbd.BDF(form=fmbd.Index2())], ids=["Radau", "BDF"]
)
def test_runs_that_tell_the_error_know_of_dependent_rows(scheme: Any) -> None:
    """They begin at the start that was found for the first run, and look for dependent rows themselves."""
    scene = fmbd.Scene("twice held", gravity=(0.0, -9.81))
    body = fmbd.RigidBody("body", 1.0, 0.1, position=(0.5, 0.0))
    pins = [fmbd.revolute(name, fmbd.ground, body, center=(0.0, 0.0)) for name in ("pin", "again")]
    scene.add(body, *pins)
    scene.sensor("place", fmbd.position(body))
    run = fmbd.solve(scene, t_end=0.3, scheme=scheme, tol={"place": 1e-5})
    assert run.certificate is not None
    stated = run.certificate["place"]
    assert 0.0 < stated.total < 1e-5


@pytest.mark.serial
@pytest.mark.parametrize(("modes", "locked"), [(0, False), (2, True), (12, False)])
def test_modes_that_joints_lock_are_told(modes: int, locked: bool) -> None:
    """Four bars in space with equal axes hold three rows more than rigid bars need; two bending modes give way to none."""
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, 0.05, 0.05), counts=(12, 1, 1), origin=(0.0, 0.5, 0.0))
    law = fmbd.materials.linear_elastic(2e9, 0.3)
    rod = fmbd.FloatingBody("rod", mesh, degree=2, density=1000.0, elastic=law).reduced(modes=modes)
    cranks = [fmbd.RigidBody(f"crank {x}", 0.5, (0.01, 0.01, 0.01), (x, 0.2625, 0.025)) for x in (0, 1)]
    scene = fmbd.Scene("four bars", gravity=(0.0, -9.81, 0.0))
    scene.add(rod, *cranks)
    for x, crank, end in zip((0, 1), cranks, ("left", "right"), strict=True):
        scene.add(fmbd.revolute(f"foot {x}", fmbd.ground, crank, center=(x, 0.0, 0.025), axis=(0, 0, 1)))
        scene.add(fmbd.revolute(f"pin {x}", crank, rod.surface(end), center=(x, 0.525, 0.025), axis=(0, 0, 1)))

    run = fmbd.solve(scene, t_end=2e-3, dt=1e-3)
    assert ('modes of body "rod" are locked' in " ".join(run.warnings)) == locked
    assert ('modes of body "rod" are locked' in " ".join(scene.check().notes)) == locked


@pytest.mark.parametrize("make", [fmbd.FloatingBody, fmbd.AbsoluteBody])
@pytest.mark.parametrize("form", [fmbd.Index3(), fmbd.GGL()], ids=str)
def test_elastic_fields_beside_dependent_rows_are_compiled(make: Any, form: Any, rod_mesh: Any) -> None:
    """An elastic rod on an arm with two equal hinges: the increments and reactions that NumPy finds."""

    def scene() -> fmbd.Scene:
        law = fmbd.materials.linear_elastic(5e6, 0.3)
        rod = make("rod", rod_mesh(h=0.2), degree=2, density=1000.0, elastic=law)
        arm = fmbd.RigidBody("arm", 5.0, 0.5, (-0.5, 0.0))
        made = fmbd.Scene("twice", gravity=(0.0, -9.81))
        made.add(arm, rod, fmbd.revolute("pin", arm, rod.surface("pin"), center=(0.0, 0.0)))
        for name in ("hinge", "again"):
            made.add(fmbd.revolute(name, fmbd.ground, arm, center=(-1.0, 0.0)))
        return made

    fast, slow = (
        fmbd.solve(scene(), t_end=0.05, dt=1e-3, scheme=fmbd.GeneralizedAlpha(0.8, form, compiled=compiled))
        for compiled in (True, False)
    )
    assert fast.counters["compiled_steps"] >= 49  # the start is NumPy's
    assert abs(fast.counters["newton_iterations"] - slow.counters["newton_iterations"]) <= 1
    np.testing.assert_allclose(fast.state.lam, slow.state.lam, rtol=0, atol=1e-7 * np.abs(slow.state.lam).max())


def twice_hinged(body: str) -> fmbd.Scene:
    """An elastic rod on two hinges in one place."""
    rod = BODIES[body]()
    scene = fmbd.Scene("twice", gravity=rod.at(0, -9.81))
    hinges = [fmbd.revolute(name, fmbd.ground, rod.left, center=rod.at(0, 0)) for name in ("one", "two")]
    scene.add(rod.body, *hinges)
    return scene


def riveted(body: str) -> fmbd.Scene:
    """An elastic rod on a falling arm, by two rivets whose stress turns with both."""
    rod = BODIES[body]()
    arm = fmbd.RigidBody("arm", 5.0, 0.5, rod.at(-0.5, 0))
    scene = fmbd.Scene("riveted", gravity=rod.at(0, -9.81))
    scene.add(arm, rod.body, fmbd.revolute("pin", fmbd.ground, arm, center=rod.at(-1, 0)))
    for name, y in (("one", 0.0), ("two", 0.03)):
        scene.add(fmbd.revolute(name, arm, rod.left, center=rod.at(0, y)))
    return scene


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("scheme", "dt", "make", "body"),
    [
        (fmbd.Rattle(), 2e-5, twice_hinged, "floating"),
        (fmbd.Rattle(), 2e-5, twice_hinged, "absolute"),
        (fmbd.HalfExplicit(rtol=None), 2e-5, twice_hinged, "floating"),
        (fmbd.HalfExplicit(rtol=None), 2e-5, twice_hinged, "absolute"),
        (fmbd.EnergyMomentum(), 1e-3, twice_hinged, "absolute"),
        (fmbd.Radau(3, rtol=None), 2e-3, riveted, "floating"),
        (fmbd.Radau(3, fmbd.Index3(), None), 2e-3, riveted, "absolute"),
        (fmbd.BDF(2, rtol=None), 1e-3, riveted, "floating"),
        (fmbd.BDF(1, fmbd.Index3(), None), 1e-3, riveted, "floating"),
    ],
    ids=lambda x: getattr(x, "name", None),
)
def test_dependent_rows_on_fields_are_solved_in_compiled_code(
    scheme: Any, dt: float, make: Any, body: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """States and smallest multipliers of NumPy, which makes some matrices at the start."""
    made: list[int] = []
    prepared = StepSolver._prepared
    monkeypatch.setattr(StepSolver, "_prepared", lambda *given: (made.append(1), prepared(*given))[1])
    run = lambda: fmbd.solve(make(body), t_end=30 * dt, dt=dt, scheme=scheme).state  # noqa: E731

    fast = run()
    assert len(made) <= 10
    monkeypatch.setattr(FieldDriverSolver, "_solves", lambda _: False)
    monkeypatch.setattr(FieldDriverSolver, "means", lambda *given: None)
    slow = run()
    assert len(made) > 30
    for name, bar in (("q", 1e-11), ("v", 1e-10), ("a", 1e-8), ("lam", 1e-8)):
        x, y = getattr(fast, name), getattr(slow, name)
        assert np.abs(x - y).max() <= bar * np.abs(y).max(), name
    system = make(body).build()[0]
    forces = fast.lam / system.multiplier_units
    assert np.abs(forces @ null_space(system.at(fast.t, fast.q))).max() <= 1e-8 * np.abs(forces).max()


def tower(loops: int) -> fmbd.Scene:
    """Four-bar loops in space, one hung upon another by hinges that are parallel: each has three rows too many."""
    scene = fmbd.Scene("tower", gravity=(0.0, 0.0, -9.81))
    above: tuple[Any, Any] = (fmbd.ground, fmbd.ground)
    for i in range(loops):
        places = {"left": (0.0, 0.0, -0.5 - i), "right": (1.0, 0.0, -0.5 - i), "bar": (0.5, 0.0, -1.0 - i)}
        left, right, bar = (fmbd.RigidBody(f"{x}{i}", 1.0, (1e-3, 2e-3, 2e-3), place) for x, place in places.items())
        scene.add(left, right, bar)
        joined = {
            "a": (above[0], left, 0, 0),
            "b": (above[1], right, 1, 0),
            "c": (left, bar, 0, 1),
            "d": (right, bar, 1, 1),
        }
        for name, (one, other, x, down) in joined.items():
            scene.add(fmbd.revolute(f"{name}{i}", one, other, center=(x, 0.0, -i - down), axis=(0.0, 1.0, 0.0)))
        above = bar, bar
    scene.sensor("a", fmbd.reaction("a0"))
    scene.sensor("b", fmbd.reaction("b0"))
    return scene


@pytest.mark.compiled
def test_a_tower_of_loops_hangs_on_compiled_steps() -> None:
    """What all of it hangs on is closed by hardly more than rows that depend are: two increments, and one that finds no more."""
    loops = 27
    run = fmbd.solve(tower(loops), t_end=0.01, dt=1e-3, output=fmbd.Output(estimate_error=False))
    assert run.counters["compiled_steps"] == run.counters["steps"]
    assert run.counters["newton_iterations"] <= 3 * run.counters["steps"]
    weight = 3 * loops * 9.81
    np.testing.assert_allclose(abs(run["a"] + run["b"])[:, 2], weight, rtol=1e-6)


def pushed_tower(loops: int, force: float, t: float) -> float:
    """Where the lowest bar of a tower stands (m) after a small motion from rest: M x'' + K x = (0, .., F), with one coordinate x
    of each bar, by its vibrations.
    """
    turn = np.eye(loops) - np.eye(loops, k=-1)
    middle = np.abs(turn) / 2
    below = np.arange(loops)[::-1]
    M = np.eye(loops) + 2 * (middle.T @ middle + 2e-3 * turn.T @ turn)
    K = turn.T @ np.diag(9.81 * (3 * below + 2.0)) @ turn
    squares, modes = sl.eigh(K, M)
    return float(modes[-1] ** 2 @ ((1 - np.cos(np.sqrt(squares) * t)) / squares)) * force


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [fmbd.Radau(3, rtol=None), fmbd.BDF(2, rtol=None)], ids=lambda x: x.name)
def test_stages_of_a_tower_are_closed_whatever_its_height(scheme: Any) -> None:
    """Multipliers of places and of velocities close what all hangs on together: in as many increments as two loops take."""
    increments = []
    for loops in (2, 30):
        scene = tower(loops)
        bar = scene.bodies[f"bar{loops - 1}"]
        scene.add(fmbd.force("push", bar, (0.5, 0.0, 0.0)))
        scene.sensor("end", fmbd.position(bar))
        run = fmbd.solve(scene, t_end=0.016, dt=1e-3, scheme=scheme, output=fmbd.Output(estimate_error=False))
        assert run["end"][-1, 0] - 0.5 == pytest.approx(pushed_tower(loops, 0.5, 0.016), rel=1e-3)
        assert run.counters["jacobians"] == 1 + isinstance(scheme, fmbd.BDF)  # one is Radau's, of the first step
        increments.append(run.counters["newton_iterations"])
    assert increments[1] == increments[0]


@pytest.mark.compiled
def test_runs_of_tall_towers_begin_and_end_without_dense_matrices(monkeypatch: Any) -> None:
    """Rows that depend are known by a sparse factor, and whose reactions are not unique by the smallest multipliers of some."""
    for where, name in ((np.linalg, "svd"), (CoreSolver, "factor"), (redundancy, "smallest")):
        monkeypatch.setattr(where, name, None)
    scene = tower(31)
    run = fmbd.solve(scene, t_end=0.002, dt=1e-3, output=fmbd.Output(estimate_error=False))
    assert run.system.n_lam > LOOK_LIMIT and run.counters["compiled_steps"] == 2
    assert run.not_unique == list(scene.joints) and not any("degrees of freedom" in x for x in run.warnings)


@pytest.mark.parametrize("loops", [1, 20])
def test_smallest_multipliers_are_those_of_dense_matrices(loops: int) -> None:
    """By one sparse factor: dense decompositions of 200 loops took ten seconds at a start."""
    system, state, _ = tower(loops).build()
    ev, u = system.at(state.t, state.q, state.v), system.multiplier_units
    lam = np.random.default_rng(0).normal(size=(2, system.n_lam)) * u
    N = null_space(ev)
    assert N.shape == (system.n_lam, 3 * loops)
    found = redundancy.smallest(ev, lam)
    assert np.abs(found / u @ N).max() < 1e-11
    assert np.abs(dense(ev.jacobian.core).T @ (found - lam).T).max() < 1e-11


@pytest.mark.compiled
@pytest.mark.parametrize("loops", [5, 60])
def test_smallest_multipliers_of_a_tower_are_found_by_the_driver(loops: int) -> None:
    """Forces on the bodies stay, to more digits than are asked for, by what further solutions close of few loops."""
    system, state, _ = tower(loops).build()
    use_driver(system)
    lam = np.random.default_rng(0).normal(size=system.n_lam) * system.multiplier_units
    solver = StepSolver(system)
    driver = solver.driver
    assert driver is not None
    solver.look_for_dependent_rows(system.at(state.t, state.q))
    found = driver.least(state.t, state.q, lam[None])
    assert found is not None
    G = dense(system.at(state.t, state.q).jacobian.core)
    np.testing.assert_allclose(G.T @ found[0], G.T @ lam, rtol=0, atol=1e-9 * np.abs(G.T @ lam).max())


@pytest.mark.compiled
def test_rows_that_hold_a_light_body_together_move_heavy_ones() -> None:
    """Three cranks of 1 kg and a coupler of 1e-9: its pins move by 1e9 of what combinations of them move, the cranks alone."""
    scene, angle = fmbd.Scene("cranks", gravity=(0.0, 0.0)), 0.3
    at = np.array([np.cos(angle), np.sin(angle)])
    coupler = fmbd.RigidBody("coupler", 1e-9, 1e-10, tuple(at + (1.0, 0.0)))
    scene.add(coupler)
    for i in range(3):
        crank = fmbd.RigidBody(f"crank {i}", 1.0, 1.0 / 12.0, tuple(at / 2 + (i, 0.0)))
        pin: Any = fmbd.revolute(f"low {i}", fmbd.ground, crank, center=(i, 0.0))
        scene.add(crank, pin, fmbd.revolute(f"high {i}", crank, coupler, center=tuple(at + (i, 0.0))))
        if i == 0:
            scene.add(fmbd.drive("motor", fmbd.angle(pin), lambda t: t * t))
    scene.sensor("torque", fmbd.reaction("motor"))
    run = fmbd.solve(
        scene, t_end=0.1, dt=5e-3, scheme=fmbd.Radau(3, rtol=None), output=fmbd.Output(estimate_error=False)
    )
    assert abs(run["torque"][-1, 0]) == pytest.approx(2.0 * 3.0 / 3.0, rel=1e-6)
    assert not run.counters["halved_steps"] and run.counters["newton_iterations"] < 100  # no end, or 240 at 1e-8 kg


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [fmbd.Radau(), fmbd.BDF()], ids=["Radau", "BDF"])
def test_a_light_door_on_a_heavy_frame_whose_hinges_are_nearly_in_line(scheme: Any) -> None:
    """Out of line by 3e-8 rad, which counts as none: reactions were 35 % off, or steps had no end."""
    reactions = []
    for off in (0.0, 3e-8):
        scene = fmbd.Scene("door", gravity=(0.0, 0.0, -9.81))
        frame, leaf = (
            fmbd.RigidBody("frame", 1.0, np.eye(3)),
            fmbd.RigidBody("leaf", 1e-8, 1e-9 * np.eye(3), (0.5, 0.0, 0.5)),
        )
        scene.add(frame, leaf, fmbd.revolute("base", fmbd.ground, frame, center=(0, 0, 0), axis=(0, 1, 0)))
        for i in range(3):
            axis = (0.0 if i else off, 0.0, 1.0)
            scene.add(fmbd.revolute(f"hinge {i}", frame, leaf, center=(0, 0, 0.5 * i), axis=axis))
        scene.add(fmbd.torque("push", leaf, lambda t: (0.0, 0.0, 3e-9)))
        scene.sensor("force", fmbd.reaction_force("hinge 1"))
        run = fmbd.solve(scene, t_end=0.3, scheme=scheme, output=fmbd.Output(estimate_error=False))
        reactions.append(np.abs(run["force"]).max())
    assert reactions[1] == pytest.approx(reactions[0], rel=1e-5)


@pytest.mark.compiled
@pytest.mark.parametrize("stages", [2, 3])
def test_a_heavy_leaf_hangs_on_two_hinges_of_a_light_post(stages: int) -> None:
    """All rows hold the post of 1e-8 kg, and by 1e8 less the leaf of 1 kg: steps had no end, or 2 421 increments."""
    scene = fmbd.Scene("door", gravity=(0.0, -9.81, 0.0))
    post = fmbd.RigidBody("post", 1e-8, 1e-8 * np.eye(3), (0.0, 0.0, 1.0))
    leaf = fmbd.RigidBody("leaf", 1.0, 0.1 * np.eye(3), (1.0, 0.0, 1.0))
    scene.add(post, leaf)
    for i in range(2):
        center = (0.0, 0.0, 2.0 * i)
        scene.add(fmbd.revolute(f"base {i}", fmbd.ground, post, center=center))
        scene.add(fmbd.revolute(f"hinge {i}", post, leaf, center=center))
    scene.sensor("place", fmbd.position(leaf))
    run = fmbd.solve(scene, t_end=0.5, scheme=fmbd.Radau(stages, rtol=1e-6), output=fmbd.Output(estimate_error=False))

    falls = lambda t, y: (y[1], -9.81 * np.cos(y[0]) / 1.1)  # J = 0.1 + 1 kg m^2 about the axis
    turned = solve_ivp(falls, (0.0, 0.5), (0.0, 0.0), rtol=1e-10, atol=1e-12).y[0, -1]
    np.testing.assert_allclose(run["place"][-1, :2], (np.cos(turned), np.sin(turned)), rtol=0, atol=2e-6)
    assert run.counters["newton_iterations"] < 400
