"""Laws of the motion of two markers: what a step asks of Python, slopes that are kept, and slopes by differences."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from combinations import BODIES
from test_checkpoint import at_every_step
from test_compiled import pair, stepper_of
from test_driver import bushings, joint_springs, links

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.mechanics.forces.own_loads import OwnLoads
from fmbd_fenicsx.rotations import Array
from fmbd_fenicsx.schemes.stepping import UNOBSERVED
from fmbd_fenicsx.system.compiled.choice import driver_states

STEPS = 100


class Counted:
    """A law that counts its calls."""

    def __init__(self, law: Callable[..., Any]) -> None:
        self.law, self.calls = law, 0

    def __call__(self, *args: Any) -> Any:
        self.calls += 1
        return self.law(*args)


def dragging(t: float, a: Any, b: Any) -> Any:
    """A soft spring and damper between two points, and a damper of the turn."""
    return -20.0 * (b.x - a.x) - 0.1 * (b.v - a.v), -1e-5 * (b.w - a.w)


def between_links(dim: int, law: Callable[..., Any]) -> fmbd.Scene:
    """Five links with a law between each two neighbours."""
    scene = links(5, dim)
    bodies = list(scene.bodies.values())
    for i, (a, b) in enumerate(zip(bodies, bodies[1:], strict=False)):
        points = ((0.1 * i + 0.02, 0.01, 0.0)[:dim], (0.1 * i + 0.13, 0.0, 0.02)[:dim])
        scene.add(fmbd.own_force(f"own {i}", a, b, law, points=points))
    return scene


def landing(stiffness: float) -> tuple[fmbd.Scene, Counted]:
    """A ball that falls on a floor given as a law, and leaves it again."""
    ball = fmbd.RigidBody("ball", 1.0, 0.01, (0.0, 0.012), velocity=(0.2, -0.3))
    law = Counted(lambda t, a: ((-0.3 * a.v[0], stiffness * max(-a.x[1], 0.0)), 0.0))
    scene = fmbd.Scene("landing", gravity=(0, -9.81))
    scene.add(ball, fmbd.own_force("floor", ball, None, law))
    return scene, law


def marched(scene: fmbd.Scene) -> tuple[Any, Any]:
    """The driver after some steps, its counters set to zero, and its stepper."""
    stepper: Any = stepper_of(scene)
    for _ in range(3):
        stepper.advance(1e-3)
    c = stepper.driver.tables.c
    c.evaluations = c.factors = c.calls = 0
    return c, stepper


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
def test_laws_are_called_once_an_evaluation_and_slopes_are_kept(dim: int) -> None:
    law = Counted(dragging)
    c, stepper = marched(between_links(dim, law))
    law.calls = 0
    assert stepper.march(1e-3, STEPS) == STEPS

    assert c.evaluations <= 2.1 * STEPS
    assert c.evaluations <= c.calls <= 1.1 * c.evaluations
    assert 4 * c.evaluations <= law.calls <= 2.5 * 4 * c.evaluations


@pytest.mark.compiled
def test_slopes_are_new_where_a_law_sets_in() -> None:
    """Free, in contact, free again: as many iterations as a law of one slope needs, and the motion of the NumPy path."""
    for stiffness in (1e4, 1e7):
        fast, slow = pair(lambda k=stiffness: landing(k)[0], t_end=0.08, dt=1e-3)
        assert fast.counters["compiled_steps"] == 80
        assert fast.counters["newton_iterations"] <= slow.counters["newton_iterations"] + 5
        assert np.abs(fast.state.q - slow.state.q).max() < 1e-9
        assert slow.state.q[1] > 5e-3  # it has left the floor

    scene, law = landing(1e4)
    run = fmbd.solve(scene, t_end=0.08, dt=1e-3)
    assert law.calls <= 1.4 * run.counters["newton_iterations"]


def on_tip(body: str, stiffness: float, skew: float) -> fmbd.Scene:
    """An elastic rod in a hinge, its tip on a spring, a damper and a force across its displacement."""
    rod = BODIES[body]()
    scene = fmbd.Scene("tip", gravity=rod.at(0, -9.81))
    scene.add(rod.body, fmbd.revolute("hinge", fmbd.ground, rod.left, center=rod.at(0, 0)))

    def law(t: float, a: Any) -> Any:
        x, y = a.x - rod.at(1, 0)
        return (skew * y - stiffness * x, -skew * x - stiffness * y) - 0.01 * stiffness * a.v, 0.0

    scene.add(fmbd.own_force("law", rod.tip, None, law))
    return scene


@pytest.mark.compiled
@pytest.mark.parametrize("body", ["floating", "absolute"])
@pytest.mark.parametrize("stiffness, skew", [(1e3, 0.0), (1e6, 0.0), (1e4, 1e4), (0.0, 1e6)])
def test_laws_on_surfaces_of_fields_are_compiled(body: str, stiffness: float, skew: float) -> None:
    """Through the compliance of the surface, with what their slopes lack of symmetry: steps and motion of the NumPy path."""
    fast, slow = pair(lambda: on_tip(body, stiffness, skew), t_end=0.03, dt=1e-3)
    assert fast.counters["compiled_steps"] == 30
    assert fast.counters["newton_iterations"] <= slow.counters["newton_iterations"]
    assert np.abs(fast.state.q - slow.state.q).max() < 1e-9


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
def test_a_run_that_is_taken_up_goes_on_with_the_same_slopes(dim: int, tmp_path: Path) -> None:
    """Between records, after a checkpoint and step by step: the same bits."""
    make = lambda: between_links(dim, dragging)  # noqa: E731
    whole = at_every_step(make, tmp_path, (1, 7, 15), t_end=0.02, dt=1e-3)
    rare = fmbd.solve(make(), t_end=0.02, dt=1e-3, output=fmbd.Output(every=20))
    assert np.array_equal(whole.state.q, rare.state.q) and np.array_equal(whole.state.a, rare.state.a)


@pytest.mark.compiled
@pytest.mark.parametrize("make", [joint_springs, bushings, links], ids=["springs", "bushings", "links"])
def test_steps_without_laws_ask_python_nothing_and_allocate_nothing(make: Any) -> None:
    scene = make(4, 2) if make is links else make(2)
    c, stepper = marched(scene)
    march(stepper, 1)
    c.evaluations = c.factors = c.calls = 0

    tracemalloc.start()
    try:
        march(stepper, 10)
        tracemalloc.reset_peak()
        before, _ = tracemalloc.get_traced_memory()
        few = _peak(stepper, 10)
        many = _peak(stepper, 10 * STEPS)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert c.calls == 0
    assert many <= few
    assert after - before < 512  # the numbers that tell what was read

    steps = 10 + 10 + 10 * STEPS
    assert c.factors <= 1.5 * steps
    assert c.evaluations <= 2.5 * steps


def march(stepper: Any, steps: int) -> None:
    """So many steps in one call."""
    assert stepper.driver.march(1e-3, steps, stepper.newton, UNOBSERVED, None) == (steps, 0)


def _peak(stepper: Any, steps: int) -> int:
    """Bytes that a call of so many steps has at most."""
    tracemalloc.reset_peak()
    before, _ = tracemalloc.get_traced_memory()
    march(stepper, steps)
    return tracemalloc.get_traced_memory()[1] - before


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("held", [True, False], ids=["to the ground", "between two bodies"])
def test_tangent_of_bushings_is_the_derivative_of_their_forces(dim: int, *, held: bool) -> None:
    """The driver's matrix, read from its solutions, against differences of the balance in NumPy: far from rest, with levers."""
    rng, n = np.random.default_rng(7), 3 * (dim - 1)
    A = rng.standard_normal((n, n))
    inertia: Any = 14.0 if dim == 2 else (14.0, 15.0, 16.0)
    one, two = (
        fmbd.RigidBody(name, 20.0, inertia, x[:dim]) for name, x in (("one", (0, 0, 0)), ("two", (0.3, -0.2, 0.1)))
    )
    center = (0.1, 0.2, -0.1)[:dim]
    scene = fmbd.Scene("mount")
    scene.add(
        one,
        two,
        fmbd.bushing(
            "mount", fmbd.ground if held else one, two, stiffness=A @ A.T, damping=A + 5 * np.eye(n), center=center
        ),
    )
    system, state, _ = scene.build()
    q = system.compose(state.q, 0.4 * rng.standard_normal(2 * n))
    v, zero = np.zeros(2 * n), np.zeros(0)
    cd, ck, h = 0.3, 0.7, 1e-5

    def forces(dq: Array, dv: Array) -> Array:
        return system.at(0.0, system.compose(q, dq), v + dv).balance(np.zeros(2 * n))

    found = np.array(
        [ck * (forces(e, v) - forces(-e, v)) + cd * (forces(v, e) - forces(v, -e)) for e in h * np.eye(2 * n)]
    ) / (2 * h)
    M = np.array([system.at(0.0, q, v).balance(e) for e in np.eye(2 * n)]) - forces(v, v)
    states = driver_states(system)
    assert states is not None and states.factor.prepare(states.at(0.0, q, v), cd, ck)
    matrix = np.linalg.inv([states.factor.solve(b, zero)[0] for b in np.eye(2 * n)])
    assert np.abs(matrix - M - 0.5 * (found + found.T)).max() < 1e-8 * np.abs(found).max()


def known_slopes(scale: float, dim: int) -> tuple[Any, Any]:
    """A nonlinear law with differenced slopes and with its own, in a model that is ``scale`` times as large."""
    stiffness, damping, n = 20.0 / scale, 0.1 / scale, 3 * (dim - 1)

    def law(t: float, a: Any, b: Any) -> Any:
        d = b.x - a.x
        return -stiffness * d * (1 + d @ d / scale**2) - damping * b.v, -1e-2 * scale * b.w

    def jacobian(t: float, a: Any, b: Any) -> Any:
        d = b.x - a.x
        slope = stiffness * ((1 + d @ d / scale**2) * np.eye(dim) + 2 * np.outer(d, d) / scale**2)
        K, D = np.zeros((2, 2 * n, 2 * n))
        force = -stiffness * d * (1 + d @ d / scale**2) - damping * b.v
        K[n : n + dim, n : n + dim], K[n : n + dim, :dim] = slope, -slope
        D[n : n + dim, n : n + dim] = damping * np.eye(dim)
        D[n + dim :, n + dim :] = 1e-2 * scale * np.eye(n - dim)
        K[:dim], D[:dim] = -K[n : n + dim], -D[n : n + dim]
        for X in (K, D):
            X[dim:n] = -X[n + dim :] - _crossed(d, X[n : n + dim])
        lever = _crossed_by(force, dim)
        K[dim:n, n : n + dim] += lever
        K[dim:n, :dim] -= lever
        return K, D

    made = []
    for own in (None, jacobian):
        scene = fmbd.Scene("scaled")
        one, two = (
            fmbd.RigidBody(name, 1.0, scale**2 if dim == 2 else scale**2 * np.eye(3), np.array(x)[:dim] * scale)
            for name, x in (("one", (0.0, 0.1, 0.2)), ("two", (1.0, 0.3, -0.4)))
        )
        scene.add(one, two, fmbd.own_force("own", one, two, law, jacobian=own))
        system, state, _ = scene.build()
        v = np.linspace(-1.0, 1.0, 2 * n).reshape(2, n)
        v[:, :dim] *= scale
        loads = system.forces[0]
        assert isinstance(loads, OwnLoads)
        made.append(loads.tangent(system.at(0.0, state.q, v.ravel()).kin, 0.0))
    return made[0], made[1]


def _crossed(d: Array, X: Array) -> Array:
    """d x each column."""
    if len(d) == 2:
        return (d[0] * X[1] - d[1] * X[0])[None]
    return np.cross(d, X.T).T


def _crossed_by(force: Array, dim: int) -> Array:
    """The matrix of e x force for unit vectors e."""
    if dim == 2:
        return np.array([[force[1], -force[0]]])
    return np.cross(np.eye(3), force).T


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_differences_are_scaled_with_the_model(scale: float, dim: int) -> None:
    found, exact = known_slopes(scale, dim)
    units = np.tile([1.0] * dim + [1 / scale] * (2 * dim - 3), 2)  # of turns as lengths
    for x, y in ((found.K, exact.K), (found.D, exact.D)):
        away, size = (np.abs(units[:, None] * z * units).max() for z in (x - y, y))
        assert away < 1e-6 * size


def test_only_what_a_law_reads_is_differenced() -> None:
    """A law of places that is no formula: one call, and one for each component that is read of both markers."""
    law = Counted(lambda t, a, b: (-(b.x - a.x) if t < 9.0 else 0.0, 0.0))
    one, two = (fmbd.RigidBody(name, 1.0, 1.0, (x, 0.0)) for name, x in (("one", 0.0), ("two", 1.0)))
    scene = fmbd.Scene("two")
    scene.add(one, two, fmbd.own_force("own", one, two, law))
    system, state, _ = scene.build()
    kin = system.at(0.0, state.q, np.ones(6)).kin
    system.forces[0].tangent(kin, 0.0)  # asks it for formulas
    law.calls = 0
    system.forces[0].tangent(kin, 0.0)
    assert law.calls == 1 + 4


def sliding(law: Callable[..., Any]) -> fmbd.Scene:
    """A spinning ball whose lowest point slides on a plane: a force that turns about in each step."""
    ball = fmbd.RigidBody(
        "ball", 0.06, (8e-6, 8e-6, 9.5e-6), (0, 0, 0.02), velocity=(0.1, 0, 0), angular_velocity=(30, 5, 150)
    )
    scene = fmbd.Scene("sliding", gravity=(0, 0, -9.81))
    scene.add(ball, fmbd.own_force("friction", ball, None, law))
    scene.add(fmbd.constraint("floor", fmbd.ground, ball, lambda a, b, t: b.x[2] - 0.02))
    return scene


def rubbing(t: float, a: Any) -> Any:
    """Coulomb's friction, smooth below 1 cm/s, at a point that lies off the axis of the body."""
    arm = 0.005 * a.R[:, 0] - np.array([0.0, 0.0, 0.02])
    slip = a.v + np.cross(a.w, arm)
    force = -0.2 * np.array([slip[0], slip[1], 0.0]) / np.sqrt(slip @ slip + 1e-4)
    return force, np.cross(arm, force)


@pytest.mark.compiled
def test_slopes_of_a_law_that_writes_formulas_are_exact() -> None:
    """One call of it for a tangent, as many iterations as by differences; its kind of cases is called for each component."""
    steps = {}
    for name, law in (
        ("formula", Counted(rubbing)),
        ("cases", Counted(lambda t, a: rubbing(t, a) if a.x[0] < 9 else 0)),
    ):
        run = fmbd.solve(sliding(law), t_end=0.1, dt=1e-3)
        steps[name] = law.calls, run.counters["newton_iterations"], run.state.q
    assert steps["formula"][1] == steps["cases"][1]
    assert steps["formula"][0] <= 1.7 * steps["formula"][1] + 5 < 0.4 * steps["cases"][0]
    assert np.abs(steps["formula"][2] - steps["cases"][2]).max() < 1e-9


@pytest.mark.parametrize("dim", [2, 3])
def test_slopes_by_formulas_are_those_of_differences(dim: int) -> None:
    def law(t: float, a: Any, b: Any) -> Any:
        d = b.R @ a.R.T @ (b.x - a.x) + 0.1 * (b.v - a.v)
        return -np.sqrt(1.0 + d @ d) * d, -0.3 * (b.w - a.w) + d[0] * np.exp(a.w[0] - t)

    system, state, _ = between_links(dim, law).build()
    v = np.random.default_rng(1).normal(size=state.v.shape)
    kin = system.at(0.1, system.compose(state.q, 0.2 * v), v).kin
    (loads,) = (f for f in system.forces if isinstance(f, OwnLoads))
    exact = loads.tangent(kin, 0.1)
    assert all(loads.written.values())

    loads.written = dict.fromkeys(loads.written)
    rough = loads.tangent(kin, 0.1)
    for one, other in ((exact.K, rough.K), (exact.D, rough.D)):
        assert np.abs(one - other).max() < 1e-5 * np.abs(other).max()


def test_a_law_whose_numbers_change_from_outside_keeps_its_own_slopes() -> None:
    wind = {"speed": 1.0}
    system, state, _ = sliding(lambda t, a: (wind["speed"] * (np.ones(3) - a.v), np.zeros(3))).build()
    (loads,) = (f for f in system.forces if isinstance(f, OwnLoads))
    kin = system.at(0.0, state.q, state.v).kin
    for speed in (1.0, 3.0):
        wind["speed"] = speed
        assert loads.tangent(kin, 0.0).D[0, :3, :3] == pytest.approx(speed * np.eye(3), abs=1e-6)
