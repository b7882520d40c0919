"""Single states by the driver, from which compiled runs start: the numbers of NumPy's evaluation and of its linear solver."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from chains import chain
from test_driver import driven, joint_springs, loaded, redundant, suspended, tyre
from test_kernel import flexible

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.blocks.field_blocks import Weights
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.linear.core_matrix import core_matrix
from fmbd_fenicsx.linear.driver_solver import DriverSolver
from fmbd_fenicsx.rotations import Array
from fmbd_fenicsx.schemes.consistent import accelerations, consistent
from fmbd_fenicsx.schemes.newton import Newton
from fmbd_fenicsx.system.compiled.choice import driver_states, use_driver
from fmbd_fenicsx.system.evaluator import NumPyEvaluator
from fmbd_fenicsx.system.layout import State
from fmbd_fenicsx.system.tangents.reaction_tangent import EVERY_PUSH, HARD_PUSH, NO_PUSH

MASSES = Weights(1.0, 0.0, 0.0)


def rolling(dim: int) -> fmbd.Scene:
    """A ball that rolls: rows on velocities."""
    inertia = 0.02 if dim == 2 else (0.01, 0.01, 0.02)
    ball = fmbd.RigidBody("ball", 2.0, inertia, (0, 0.1, 0)[:dim])
    scene = fmbd.Scene("rolling", gravity=(0.1, -9.81, 0)[:dim])
    scene.add(ball, fmbd.rolling("road", fmbd.ground, ball, shape=fmbd.Ball(0.1), normal=(0, 1, 0)[:dim]))
    return scene


SCENES = [joint_springs, suspended, loaded, driven, redundant, tyre, flexible]


def both(scene: fmbd.Scene) -> tuple[Any, Any, Any]:
    """The driver's states, and one state evaluated by NumPy and by the driver."""
    system, given, _ = scene.build()
    rng, states = np.random.default_rng(7), driver_states(system)
    assert states is not None
    q = system.compose(given.q, 0.002 * rng.standard_normal(system.n_v))
    v = rng.standard_normal(system.n_v)
    return states, system.at(0.3, q, v), states.at(0.3, q, v)


def close(x: Any, y: Any, digits: float = 1e-12) -> None:
    """The same numbers."""
    x, y = (z.toarray() if hasattr(z, "toarray") else np.asarray(z) for z in (x, y))
    np.testing.assert_allclose(y, x, rtol=0.0, atol=digits * float(np.abs(x).max(initial=1e-300)))


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("make", SCENES, ids=lambda f: f.__name__)
def test_same_evaluation(make: Any, dim: int) -> None:
    """Constraints, their rates and second rates, their Jacobian, and the balance."""
    states, numpy, driver = both(make(dim))
    rng, system = np.random.default_rng(8), states.system
    a, lam = rng.standard_normal(system.n_v), rng.standard_normal(system.n_lam)

    close(numpy.constraint(), driver.constraint())
    close(numpy.constraint_rate(), driver.constraint_rate())
    close(numpy.gamma(), driver.gamma())
    close(numpy.jacobian.core, driver.jacobian.core)
    close(numpy.jacobian.times(a), driver.jacobian.times(a))
    close(numpy.jacobian.transposed(lam), driver.jacobian.transposed(lam))
    close(numpy.balance(a, lam), driver.balance(a, lam))
    close(numpy.balance(a), driver.balance(a))


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("make", [joint_springs, driven, loaded, flexible], ids=lambda f: f.__name__)
def test_same_solution(make: Any, dim: int) -> None:
    """x and y of [M G^T; G 0], also after other states were evaluated."""
    states, numpy, driver = both(make(dim))
    system, rng = states.system, np.random.default_rng(9)
    b, c = rng.standard_normal(system.n_v), rng.standard_normal(system.n_lam)

    def solved(solver: StepSolver, ev: Any, elsewhere: Array) -> Array:
        solver.prepare(ev, MASSES)
        system.at(0.0, elsewhere, ev.v).constraint()
        return np.concatenate(solver.solve(b, c))

    elsewhere = system.compose(numpy.q, 0.1 * rng.standard_normal(system.n_v))
    wanted = solved(StepSolver(system), numpy, elsewhere)
    system.evaluate_by(states)
    with_driver = StepSolver(system)
    close(wanted, solved(with_driver, driver, elsewhere), 1e-10)
    assert with_driver.driver is not None and with_driver.driver.ready


def jointed(dim: int) -> fmbd.Scene:
    """Rods on a turned hinge, a rope, a slide and a drive; no forces."""
    scene = driven(dim)
    first, last = scene.bodies["1"], scene.bodies["2"]
    hung = fmbd.RigidBody("hung", 1e-3, 2e-6 if dim == 2 else (1e-6, 2e-6, 3e-6), (0.15, -0.2, 0.1)[:dim])
    slider = fmbd.RigidBody("slider", 0.03, 1e-5 if dim == 2 else (2e-5, 1e-5, 3e-5), (0.3, 0.1, 0.0)[:dim])
    ends = (0.12, 0.0, 0.0)[:dim], (0.16, -0.15, 0.1)[:dim]
    scene.add(hung, fmbd.distance("rope", first, hung, point_a=ends[0], point_b=ends[1]))
    scene.add(slider, fmbd.prismatic("slide", last, slider, axis=(0.6, 0.8, 0.0)[:dim], center=(0.28, 0.05, 0.0)[:dim]))
    return scene


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
def test_same_matrix_where_reactions_push_across(dim: int) -> None:
    """All of them, or none, as they push hard or not."""
    states, numpy, driver = both(jointed(dim))
    system, rng, weights = states.system, np.random.default_rng(9), Weights(1.0, 1e-3, 1e-6)
    b, c, lam = rng.standard_normal(system.n_v), rng.standard_normal(system.n_lam), rng.standard_normal(system.n_lam)

    def solved(ev: Any, reactions: int, size: float) -> Array:
        system.evaluate_by(states if ev is driver else NumPyEvaluator(system))
        ev.forces, ev.reactions, solver = (np.zeros(system.n_v), size * lam), reactions, StepSolver(system)
        solver.prepare(ev, weights)
        assert (solver.driver is not None) == (ev is driver)
        return np.concatenate(solver.solve(b, c))

    none = solved(numpy, NO_PUSH, 1.0)
    for reactions, size, pushes in ((EVERY_PUSH, 1.0, True), (HARD_PUSH, 1.0, True), (HARD_PUSH, 1e-3, False)):
        wanted, found = solved(numpy, reactions, size), solved(driver, reactions, size)
        assert (wanted != none).any() == pushes
        close(none, found + none - wanted, 1e-12)
        if pushes:
            close(wanted - none, found - none, 1e-6)


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
def test_dependent_rows_are_found_by_numpy_and_solved_by_the_driver(dim: int) -> None:
    states, _, driver = both(redundant(dim))
    states.system.evaluate_by(states)
    solver = StepSolver(states.system)
    solver.prepare(driver, MASSES)
    assert solver.driver is not None and solver.driver.ready and solver.core.redundant


def scissors(crosses: int) -> fmbd.Scene:
    """A lift of crossed bars on a spring: the higher, the nearer its rows are to dependent."""
    scene, below = fmbd.Scene("lift", gravity=(0, -9.81)), (fmbd.ground, None)
    for i in range(crosses):
        y = 0.2 * i
        rising, falling = (fmbd.RigidBody(f"{k} {i}", 1.0, 0.01, (0.15, y + 0.1)) for k in ("rising", "falling"))
        scene.add(rising, falling, fmbd.revolute(f"pin {i}", rising, falling, center=(0.15, y + 0.1)))
        for k, (end, bar, x) in enumerate(zip(below, (rising, falling), (0.0, 0.3), strict=True)):
            if end is not None:
                scene.add(fmbd.revolute(f"hinge {i} {k}", end, bar, center=(x, y)))
        below = (falling, rising)
    scene.add(fmbd.Spring("spring", fmbd.ground, scene.bodies["falling 0"], (0.0, 0.0), (0.3, 0.0), stiffness=3e3))
    return scene


@pytest.mark.compiled
def test_rows_of_tall_lifts_are_near_to_dependent_and_solved_by_the_driver() -> None:
    """Neither factor tells it with certainty; a closer look does, once."""
    states, _, driver = both(scissors(300))
    states.system.evaluate_by(states)
    solver = StepSolver(states.system)
    solver.prepare(driver, MASSES)
    assert solver.driver is not None and solver.driver.ready and not solver.core.redundant
    assert not states.factor.independent()

    b, c = np.random.default_rng(9).standard_normal((2, states.system.n_v))
    c, J = c[: states.system.n_lam], driver.jacobian.core
    x, y = solver.solve(b, c)
    left = core_matrix(driver, MASSES) @ x + J.T @ y - b
    assert np.abs(left).max() < 1e-12 * np.abs(y).max() and np.abs(J @ x - c).max() < 1e-10 * np.abs(x).max()


def at_once(scene: fmbd.Scene, beside: float = 0.0) -> tuple[Any, State]:
    """a and lambda of the start in one call of the driver, once NumPy has seen that rows depend; and by NumPy.

    ``beside``: how far the state is moved from the constraints, m, and by how much its velocities are, m/s.
    """
    system, start, _ = scene.build()
    rng = np.random.default_rng(4)
    moved, changed = beside * rng.standard_normal((2, system.n_v))
    start = replace(start, q=system.compose(start.q, moved), v=start.v + changed)
    states, plain, solver = driver_states(system), StepSolver(system), StepSolver(system)
    wanted = accelerations(system, start, plain)

    solver.look_for_dependent_rows(system.at(start.t, start.q, start.v))
    assert states is not None and solver.core.redundant
    return DriverSolver(states, solver.core).accelerations(start.t, start.q, start.v), wanted


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
def test_accelerations_where_rows_depend(dim: int) -> None:
    """The driver's are NumPy's, its multipliers the smallest too."""
    found, wanted = at_once(redundant(dim))
    close(wanted.a, found[0], 1e-11)
    close(wanted.lam, found[1], 1e-6)


def bennett(turn: float = 1.0, twists: tuple[float, float] = (0.5, 0.9)) -> fmbd.Scene:
    """Four links that can turn, by their lengths 2 sin(twist), though hinges ask for more: 20 rows of rank 17."""
    ratio = np.sin(sum(twists) / 2) / np.sin((twists[1] - twists[0]) / 2)
    other = 2 * np.arctan(ratio / np.tan(turn / 2))
    scene, last, R, x = fmbd.Scene("Bennett", gravity=(0, 0, -9.81)), fmbd.ground, np.eye(3), np.zeros(3)
    for i, angle in enumerate((turn, other, -turn, -other)):
        (c, s), (cos, sin) = ((np.cos(z), np.sin(z)) for z in (angle, twists[i % 2]))
        to, axis = x + R @ (c * 2 * sin, s * 2 * sin, 0), R[:, 2]
        link = fmbd.ground if i == 3 else fmbd.RigidBody(f"link {i}", 1.0, (0.05, 0.1, 0.12), (x + to) / 2)
        scene.add(*[link][: i < 3], fmbd.revolute(f"hinge {i}", last, link, center=x, axis=axis))
        last, R, x = link, R @ [[c, -s * cos, s * sin], [s, c * cos, -c * sin], [0, sin, cos]], to
    return scene


@pytest.mark.compiled
def test_accelerations_beside_constraints_that_depend_where_they_hold() -> None:
    """Rows differ by as much as stages and means are beside them: accelerations and multipliers are those on them."""
    (a, lam), _ = at_once(bennett())
    found, _ = at_once(bennett(), beside=1e-6)
    close(a, found[0], 1e-4)
    close(lam, found[1], 1e-4)


@pytest.mark.compiled
def test_accelerations_where_rows_contradict_each_other() -> None:
    """Two drives of one hinge whose second derivatives differ are left to NumPy, which knows what to say of them."""
    for turn in (0.0, 1e-6):
        scene = fmbd.Scene("arm", gravity=(0.0, -9.81))
        arm = fmbd.RigidBody("arm", 1.0, 0.1, (0.5, 0.0))
        hinge = fmbd.revolute("hinge", fmbd.ground, arm, center=(0, 0))
        first = fmbd.drive("first", fmbd.angle(hinge), lambda t: (t**2, 2 * t, 2.0))
        second = fmbd.drive("second", fmbd.angle(hinge), lambda t, c=1 + turn: (c * t**2, c * 2 * t, c * 2.0))
        scene.add(arm, hinge, first, second)
        assert (at_once(scene)[0] is None) == (turn > 0)


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
def test_rows_on_velocities(dim: int) -> None:
    """They have no g."""
    _, numpy, driver = both(rolling(dim))
    close(numpy.constraint(), driver.constraint())
    close(numpy.gamma(), driver.gamma())
    close(numpy.jacobian.times(numpy.v), driver.jacobian.times(numpy.v))


@pytest.mark.compiled
def test_what_a_law_raises_comes_through() -> None:
    """From the start too, with the law's name."""
    scene = joint_springs(2)
    joint = scene.joints["hinge 0"]

    def law(s: Any, rate: Any, t: float) -> Any:
        raise ZeroDivisionError("nothing left")

    scene.add(fmbd.joint_spring("broken", fmbd.angle(joint), law=law))
    with pytest.raises(fmbd.errors.FmbdError, match="broken"):
        fmbd.solve(scene, t_end=0.01, dt=1e-3)


@pytest.mark.compiled
def test_compiled_steps_write_over_the_factor() -> None:
    """A matrix that was factored before a step, in the tables that the step uses, is factored again after it."""
    system, given, _ = joint_springs(2).build()
    use_driver(system)
    solver = StepSolver(system)
    start, _ = consistent(system, given, solver)
    stepper = fmbd.GeneralizedAlpha().stepper(system, solver, Newton(), start)
    b, c = np.ones(system.n_v), np.ones(system.n_lam)

    def solved() -> Array:
        solver.prepare(system.at(start.t, start.q, start.v), Weights(1.0, 0.1, 0.01))
        return np.concatenate(solver.solve(b, c))

    stepper.advance(1e-3)  # the first one solves by itself for what it begins with
    first = solved()
    stepper.advance(1e-3)
    assert stepper.path != "NumPy" and solver.driver is not None and solver.driver.ready
    close(first, solved(), 1e-12)


@pytest.mark.compiled
def test_rows_of_long_chains_are_no_nearer_to_dependent() -> None:
    """Eigenvalues of rows with the true inertia have a bound that does not grow with their number: starts of long chains would
    be left to an LU, which fills.
    """
    bounds = []
    for links in (6, 12, 24):
        system, given, _ = chain(links)[0].build()
        states = driver_states(system)
        assert states is not None
        bounds.append(states.tables.structure.shape.largest)

        ev = system.at(0.0, given.q, given.v)
        gram = ev.jacobian.core @ np.linalg.solve(core_matrix(ev, MASSES), ev.jacobian.core.T)
        size = np.sqrt(gram.diagonal())
        assert np.linalg.eigvalsh(gram / np.outer(size, size)).max() < bounds[-1]
    assert bounds[0] == bounds[1] == bounds[2]


@pytest.mark.compiled
def test_masses_of_many_bodies_are_sparse() -> None:
    """Also where nothing holds them, so that there are no rows: memory grows with their number."""
    scene = fmbd.Scene("free")
    for i in range(100):
        scene.add(fmbd.RigidBody(f"{i}", 1.0, (0.1, 0.2, 0.3), (float(i), 0.0, 0.0)))
    system, given, _ = scene.build()
    masses = core_matrix(system.at(0.0, given.q, given.v), MASSES)
    assert masses.nnz < 10 * system.n_v
