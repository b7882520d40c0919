"""Radau and BDF on stiff springs: equations, errors and work of rigid links, whatever the stiffness."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from profiled import calls_of
from test_checkpoint import at_every_step
from test_foretold_efforts import ANGLE, DIRECTION, END, G, chain, error

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.linear.residual import Judge
from fmbd_fenicsx.schemes.implicit.step_equations import StepEquations
from fmbd_fenicsx.schemes.newton import Newton
from fmbd_fenicsx.system.compiled.choice import use_driver
from fmbd_fenicsx.system.tangents.stiff_ties import stiff_ties

sys.path[:0] = [str(Path(__file__).parents[1] / "demos"), str(Path(__file__).parent / "benchmarks")]
from andrews_model import REFERENCE  # noqa: E402
from mechanisms_of_bodies import andrews, andrews_coordinates  # noqa: E402

CHAINS = [(1.0, 1e-3), (1e-3, 1.0), (1e-3, 1.0, 1e-3, 1.0)]
SCHEMES = [fmbd.Radau(rtol=1e-4), fmbd.BDF(rtol=1e-4)]
ERRORS = {"Radau": 1e-3, "BDF": 3e-3}  # those of rigid links: 7e-5 and 1e-3


def name_of(scheme: Any) -> str:
    return type(scheme).__name__


def links(masses: Sequence[float]) -> fmbd.Scene:
    """The chain on rigid links."""
    scene = fmbd.Scene("links", gravity=(0.0, -G))
    above = fmbd.ground
    for i, mass in enumerate(masses):
        body = fmbd.RigidBody(f"mass {i}", mass, 0.1 * mass, position=(i + 1) * DIRECTION)
        ends = {"point_a": i * DIRECTION, "point_b": (i + 1) * DIRECTION}
        scene.add(body, fmbd.distance(f"link {i}", above, body, **ends))
        scene.sensor(f"place {i}", fmbd.position(body))
        above = body
    return scene


@pytest.mark.parametrize("scheme", SCHEMES, ids=name_of)
@pytest.mark.parametrize("masses", CHAINS, ids=str)
def test_as_rigid_links(masses: tuple[float, ...], scheme: Any) -> None:
    """Errors and work do not grow with the stiffness, and nothing is warned of."""
    rigid = fmbd.solve(links(masses), t_end=END, scheme=scheme).counters
    for k in (1e8, 1e14):
        run = fmbd.solve(chain(masses, k), t_end=END, scheme=scheme)
        assert error(run, masses) <= ERRORS[name_of(scheme)]
        assert run.counters["newton_iterations"] <= 1.6 * rigid["newton_iterations"]
        assert not run.warnings


@pytest.mark.parametrize("k", [1e9, 1e13])
def test_damped(k: float) -> None:
    run = fmbd.solve(chain((1e-3, 1.0), k, 1e-6 * k), t_end=END, scheme=fmbd.Radau(rtol=1e-5))
    assert error(run, (1e-3, 1.0)) <= 1e-5 and not run.warnings


@pytest.mark.parametrize("scheme", [fmbd.Radau(rtol=1e-6), fmbd.BDF(rtol=1e-6)], ids=name_of)
def test_tighter(scheme: Any) -> None:
    run = fmbd.solve(chain((1.0, 1e-3), 1e14), t_end=END, scheme=scheme)
    assert error(run, (1.0, 1e-3)) <= 2e-5 and not run.warnings


@pytest.mark.parametrize("scheme", [fmbd.Radau(rtol=None), fmbd.BDF(order=2, rtol=None)], ids=name_of)
@pytest.mark.parametrize("k", [1e12])
def test_a_tonne_on_a_gram(scheme: Any, k: float) -> None:
    """Constant steps end where increments are roundoff: on a link and a spring, with a multiplier of 1e4 N on a gram."""
    masses = (1e-3, 1e3)
    scene = fmbd.Scene("tonne", gravity=(0.0, -G))
    light, heavy = (fmbd.RigidBody(f"mass {i}", m, 0.1 * m, position=(i + 1) * DIRECTION) for i, m in enumerate(masses))
    scene.add(light, heavy, fmbd.distance("link", fmbd.ground, light, point_a=(0.0, 0.0), point_b=DIRECTION))
    length = 1.0 - 1e3 * G * np.cos(ANGLE) / k
    ends = {"point_a": DIRECTION, "point_b": 2 * DIRECTION}
    scene.add(fmbd.Spring("tie", light, heavy, **ends, stiffness=k, length=length))
    for i, body in enumerate((light, heavy)):
        scene.sensor(f"place {i}", fmbd.position(body))

    run = fmbd.solve(scene, t_end=END, dt=5e-3, scheme=scheme)
    assert error(run, masses) <= 4e-4 and not run.warnings


@pytest.mark.parametrize("scheme", [fmbd.Radau(rtol=1e-4), fmbd.BDF(rtol=1e-4)], ids=name_of)
@pytest.mark.parametrize("masses", [(1e-3, 1e3), (1e-2, 10.0)], ids=str)
def test_beside_a_joint(masses: tuple[float, float], scheme: Any) -> None:
    """A light body between a rigid rod and a spring: their pushes on it cancel, and steps are not those of either alone."""
    down, steps = np.array([np.sin(0.5), -np.cos(0.5)]), []
    for rigid in (True, False):
        scene = fmbd.Scene("rod and spring", gravity=(0.0, -G))
        light, heavy = (fmbd.RigidBody(f"mass {i}", m, 0.1 * m, position=(i + 1) * down) for i, m in enumerate(masses))
        scene.add(light, heavy, fmbd.distance("rod", fmbd.ground, light, point_a=(0.0, 0.0), point_b=down))
        ends, length = {"point_a": down, "point_b": 2 * down}, 1.0 - masses[1] * G * np.cos(0.5) / 1e8
        tie = fmbd.Spring("tie", light, heavy, **ends, stiffness=1e8, length=length)
        scene.add(fmbd.distance("tie", light, heavy, **ends) if rigid else tie)
        steps.append(fmbd.solve(scene, t_end=1.0, scheme=scheme).counters["steps"])
    assert steps[1] <= 3.0 * steps[0]


@pytest.mark.compiled
@pytest.mark.parametrize("rtol", [None, 1e-5])
@pytest.mark.parametrize("scheme", [fmbd.Radau, fmbd.BDF])
def test_python_makes_no_steps(scheme: Any, rtol: float | None) -> None:
    """Calls of Python a step, by the difference of runs of one and of two lengths."""

    def run(t_end: float) -> Any:
        size = {} if rtol else {"dt": 2e-3}
        output = fmbd.Output(times=(0.0, t_end), energy=False, progress=False)
        made.append(fmbd.solve(chain((1e-3, 1.0), 1e12), t_end=t_end, scheme=scheme(rtol=rtol), output=output, **size))

    made: list[Any] = []
    run(0.1)
    calls = [calls_of(lambda end=end: run(end)) for end in (0.2, 0.4)]
    assert calls[1] - calls[0] < 60 * (made[2].counters["steps"] - made[1].counters["steps"])


def bifilar(k: float | None) -> fmbd.Scene:
    """A plate in space on two long springs beside its centre, or on rigid links, with a push."""
    scene = fmbd.Scene("bifilar", gravity=(0.0, 0.0, -G))
    plate = fmbd.RigidBody("plate", 0.01, (1e-4, 2e-4, 3e-4), velocity=(0.0, 0.2, 0.0))
    scene.add(plate)
    for i, y in enumerate((-0.2, 0.3)):
        ends = {"point_a": (0.0, y, 1.0), "point_b": (0.1, y, 0.0)}
        if k is None:
            scene.add(fmbd.distance(f"tie {i}", fmbd.ground, plate, **ends))
        else:
            length = float(np.hypot(1.0, 0.1))
            scene.add(fmbd.Spring(f"tie {i}", fmbd.ground, plate, **ends, stiffness=k, damping=1e-4 * k, length=length))
    scene.sensor("place", fmbd.position(plate))
    return scene


@pytest.mark.parametrize("k", [1e9, 1e12])
def test_in_space(k: float) -> None:
    exact = fmbd.solve(bifilar(None), t_end=0.5, scheme=fmbd.Radau(rtol=1e-9))
    run = fmbd.solve(bifilar(k), t_end=0.5, scheme=fmbd.Radau(rtol=1e-6))
    assert run["place"][-1] == pytest.approx(exact["place"][-1], abs=2e-6) and not run.warnings


@pytest.mark.parametrize("scheme", SCHEMES, ids=name_of)
def test_efforts_read_from_places(scheme: Any) -> None:
    """What Newton's iteration leaves of places, times the stiffness, does not reach the efforts that sensors read."""
    scene = chain((1.0, 1.0), 1e10)
    scene.sensor("pull", fmbd.tension("tie 0"))
    stiff = fmbd.solve(scene, t_end=0.2, scheme=scheme)
    scene = links((1.0, 1.0))
    scene.sensor("pull", fmbd.sensors.reaction("link 0"))
    rigid = fmbd.solve(scene, t_end=0.2, scheme=scheme)
    assert np.linalg.norm(stiff["pull"][-1]) == pytest.approx(np.linalg.norm(rigid["pull"][-1]), rel=2e-2)


@pytest.mark.parametrize("scheme", SCHEMES, ids=name_of)
def test_a_run_is_taken_up(scheme: Any, tmp_path: Path) -> None:
    at_every_step(lambda: chain((1e-3, 1.0), 1e12), tmp_path, (3, 10), t_end=0.2, scheme=scheme)


@pytest.mark.parametrize("stages", [2, 3])
@pytest.mark.parametrize(("mass", "length", "k"), [(1.0, 1.0, 1e18), (1e-15, 1e9, 1e18)], ids=str)
def test_own_steps_see_no_roundoff_of_efforts(mass: float, length: float, k: float, stages: int) -> None:
    """Places tell the effort of such a spring, and its energy, to far more than the weight of the pendulum."""

    def pendulum(bob: fmbd.PointMass, tie: Any) -> Any:
        scene = fmbd.Scene("pendulum", gravity=(0.0, -G * length))
        scene.add(bob, tie)
        scene.sensor("place", fmbd.position(bob))
        return fmbd.solve(scene, t_end=1.0, scheme=fmbd.Radau(stages, rtol=1e-6))

    ends = {"point_a": (0.0, 0.0), "point_b": (length, 0.0)}
    rigid, stiff = (fmbd.PointMass("bob", mass, (length, 0.0)) for _ in range(2))
    exact = pendulum(rigid, fmbd.distance("tie", fmbd.ground, rigid, **ends))
    run = pendulum(stiff, fmbd.Spring("tie", fmbd.ground, stiff, **ends, stiffness=k, length=length))
    assert run["place"][-1] == pytest.approx(exact["place"][-1], abs=1e-5 * length) and not run.warnings
    assert run.counters["steps"] <= 1.5 * exact.counters["steps"]


def test_which_springs_are_ties() -> None:
    """Those that hang on their weight by less than a millionth; soft ones, laws of a user's own and angles stay forces."""
    scene = chain((1.0, 1.0), 1e10)
    above, below = (fmbd.RigidBody(f"more {i}", 1.0, 0.1, position=(2.0 + i, 0.0)) for i in range(2))
    ends = {"point_a": (2.0, 0.0), "point_b": (3.0, 0.0)}
    scene.add(above, below, fmbd.Spring("soft", above, below, **ends, stiffness=1e3))
    system, _, _ = scene.build()
    found = stiff_ties(system, 0.0)
    assert len(found) == 2 and found.system.n_lam == system.n_lam + 2
    assert sum(len(loads.forces) for loads in found.system.forces) == 1


def thrown(speed: float, k: float) -> fmbd.Scene:
    """Two bodies on a spring without gravity."""
    scene = fmbd.Scene("thrown")
    one = fmbd.RigidBody("one", 1.0, 0.1, position=(0.0, 0.0), velocity=(0.0, speed))
    other = fmbd.RigidBody("other", 1.0, 0.1, position=(1.0, 0.0))
    ends = {"point_a": (0.0, 0.0), "point_b": (1.0, 0.0)}
    scene.add(one, other, fmbd.Spring("spring", one, other, **ends, stiffness=k, length=1.0))
    return scene


RUNS_OFF = [(0.0, 1e3, 0), (1e-3, 1e3, 0), (0.0, 1e12, 1), (1.0, 1e12, 1), (1e4, 1e12, 0)]


@pytest.mark.parametrize(("speed", "k", "ties"), RUNS_OFF)
def test_without_gravity_weight_on_earth_tells_which_springs_are_ties(speed: float, k: float, ties: int) -> None:
    """A start at rest does not; where its accelerations ask for more than weight they do, and for all steppers of the system."""
    system, start, _ = thrown(speed, k).build()
    steps = fmbd.Radau(rtol=None).stepper(system, StepSolver(system), Newton(), start)
    assert len(steps.eq.stiff) == ties and stiff_ties(system, 0.0) is steps.eq.stiff


def pulled(k: float | None, scheme: Any) -> Any:
    """A run of two bodies in a row on springs, or on rigid links, without gravity, under a force that begins at nothing."""
    scene, above = fmbd.Scene("pulled"), fmbd.ground
    for i in range(2):
        body = fmbd.RigidBody(f"body {i}", 1.0, 0.1, position=(i + 1) * DIRECTION)
        ends = {"point_a": i * DIRECTION, "point_b": (i + 1) * DIRECTION}
        tie = fmbd.distance(f"tie {i}", above, body, **ends)
        scene.add(body, tie if k is None else fmbd.Spring(f"tie {i}", above, body, **ends, stiffness=k, length=1.0))
        above = body
    scene.add(fmbd.force("pull", above, lambda t: (20.0 * np.sin(3.0 * t), 0.0)))
    scene.sensor("place", fmbd.position(above))
    return fmbd.solve(scene, t_end=0.5, scheme=scheme)


@pytest.mark.parametrize("scheme", SCHEMES, ids=name_of)
@pytest.mark.parametrize("k", [1e12, 1e18])
def test_from_rest_without_gravity(k: float, scheme: Any) -> None:
    rigid, run = pulled(None, scheme), pulled(k, scheme)
    assert run["place"][-1] == pytest.approx(rigid["place"][-1], abs=ERRORS[name_of(scheme)])
    assert run.counters["newton_iterations"] <= 1.6 * rigid.counters["newton_iterations"] and not run.warnings


def test_andrews_mechanism_at_a_tight_tolerance() -> None:
    """Its spring is no tie: as one, closed to roundoff after every step, it held steps of BDF down to nothing."""
    run = fmbd.solve(andrews(), t_end=0.03, scheme=fmbd.BDF(rtol=1e-8))
    found = andrews_coordinates(np.asarray(run.state.q))
    assert np.abs(found - REFERENCE).max() <= 2e-5


@pytest.mark.parametrize("form", [fmbd.GGL(), fmbd.Index3(), fmbd.Index2(), fmbd.Index1()], ids=lambda form: form.name)
def test_sparse_tangents_are_those_by_differences(form: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A plate in space on springs, with a rigid link beside them."""
    ends = []
    for by_patterns in (True, False):
        if not by_patterns:
            monkeypatch.setattr(StepEquations, "_structure", lambda eq: None)
        scene = bifilar(1e9)
        link = {"point_a": (0.3, 0.0, 1.0), "point_b": (0.2, 0.0, 0.0)}
        scene.add(fmbd.distance("link", fmbd.ground, scene.bodies["plate"], **link))
        run = fmbd.solve(scene, t_end=0.03, dt=1e-3, scheme=fmbd.Radau(form=form, rtol=None))
        ends.append((run["place"][-1], run.counters["newton_iterations"]))
    (sparse, increments), (dense, wanted) = ends
    assert sparse == pytest.approx(dense, abs=1e-12) and increments == wanted


@pytest.mark.parametrize("count", [40, 160])
def test_work_grows_with_the_length_of_a_chain(count: int) -> None:
    """Entries of factors beside springs whose efforts are unknowns."""
    scene = chain((1.0,) * count, 1e10)
    system, state, _ = scene.build()
    use_driver(system)
    eq = StepEquations(system, fmbd.GGL(), StepSolver(system), G)
    eq.weigh(state)
    eq.begin(state)
    tangent = eq.refresh(state, eq.multipliers(state))
    (one,) = eq.pencil(tangent, np.array([1e3]), Judge("a test")).room.lower
    entries = sum(
        (ctypes.c_long * (eq.tangents.structure.size + 1)).from_address(x)[-1] for x in (one.L_start, one.U_start)
    )
    assert len(eq.stiff) == count and entries < 45 * count
