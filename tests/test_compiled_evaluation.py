"""The compiled evaluation: what NumPy says of every kind of joint, drive, force and body, for one configuration and for many."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from own_bodies import carrier, line_and_bob
from profiled import calls_of
from test_driver import SCENES as OF_THE_DRIVER
from test_driver import joint_springs, suspended
from test_evaluation_batch import plane
from test_kernel import PLANE, SPACE
from test_rods import UNIT

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.schemes.dae import Points
from fmbd_fenicsx.schemes.implicit.step_equations import StepEquations
from fmbd_fenicsx.system.compiled.choice import solves, use_driver
from fmbd_fenicsx.system.layout import State
from fmbd_fenicsx.system.system import System


def reduced(dim: int) -> fmbd.Scene:
    """A reduced beam between a rigid body and the ground, a spring on its end."""
    section = PLANE if dim == 2 else SPACE
    points = [np.array(x[:dim]) for x in ((0.0, 0.0, 0.0), (0.6, 0.3, 0.2), (0.9, 0.3, 0.2))]
    beam = fmbd.Beam("beam", points[0], points[1], section, elements=4, modes=7, stiffness_damping=1e-3)
    bob = fmbd.RigidBody("bob", 0.3, 0.01 if dim == 2 else (0.01, 0.02, 0.015), points[2])
    scene = fmbd.Scene("reduced", gravity=(0.0, -9.81, 0.0)[:dim])
    scene.add(beam, bob, fmbd.revolute("hinge", fmbd.ground, beam.surface("start"), center=points[0] + 0.05))
    scene.add(fmbd.spherical("knee", beam.surface("end"), bob, center=points[1] + 0.02))
    scene.add(fmbd.Spring("spring", fmbd.ground, beam.surface("end"), 2 * points[1], points[1], stiffness=50.0))
    return scene


def rolling() -> fmbd.Scene:
    """A ball that rolls, a skate behind it, and a bevel gear of the user's own."""
    scene = fmbd.Scene("rolling", gravity=(0, 0, -9.81))
    ball = fmbd.RigidBody("ball", 2.0, (0.02, 0.04, 0.02), (0, 0, 0.2))
    bob = fmbd.RigidBody("bob", 0.5, (1e-3,) * 3, (0, 0.1, 0.0))
    scene.add(ball, bob, fmbd.rolling("road", fmbd.ground, ball, shape=fmbd.Ball(0.2), normal=(0, 0, 1)))
    scene.add(fmbd.spherical("hang", ball, bob, center=(0, 0.1, 0.2)))
    return scene


def rod() -> fmbd.Scene:
    """A bent rod that a rigid body hangs on."""
    scene = fmbd.Scene("rod", gravity=(0, 0, -9.81))
    cable = fmbd.Rod("cable", [(0, 0, 0), (1, 0.1, 0.2), (2, 0, 0.3)], UNIT, elements=3)
    bob = fmbd.RigidBody("bob", 0.5, (1e-3,) * 3, (2, 0, 0.3))
    scene.add(cable, bob, fmbd.fixed("start", fmbd.ground, cable.surface("start"), center=(0, 0, 0)))
    scene.add(fmbd.universal("end", cable.surface("end"), bob, center=(2, 0, 0.3), axis_a=(0, 1, 0), axis_b=(0, 0, 1)))
    return scene


MAKERS: dict[str, Any] = {f"{f.__name__} {dim}D": partial(f, dim) for f in OF_THE_DRIVER for dim in (2, 3)}
MAKERS |= {
    "plane": plane,
    "rolling": rolling,
    "rod": rod,
    "reduced 2D": partial(reduced, 2),
    "reduced 3D": partial(reduced, 3),
    "line": line_and_bob,
    "own part 2D": partial(carrier, 2),
    "own part 3D": partial(carrier, 3),
}


def pair_of(make: Any) -> tuple[System, System, tuple[Any, ...]]:
    """A system evaluated in NumPy, the same one by the driver, and some configurations about its start: t, q, v, a, lambda."""
    plain, start, _ = make().build()
    driven, _, _ = make().build()
    use_driver(driven)
    assert solves(driven.evaluator)

    k, rng = 3, np.random.default_rng(2)
    q = plain.compose(start.q, 0.03 * plain.length * rng.normal(size=(k, plain.n_v)))
    v, a = rng.normal(size=(2, k, plain.n_v))
    return plain, driven, (np.linspace(0.1, 0.7, k), q, v, a, rng.normal(size=(k, plain.n_lam)))


def answers(ev: Any, a: np.ndarray, lam: np.ndarray) -> dict[str, np.ndarray]:
    """All that schemes ask for."""
    core = ev.jacobian.core
    return {
        "g": ev.constraint(),
        "opening": ev.opening(),
        "G": core if isinstance(core, np.ndarray) else core.toarray(),
        "G^T lambda": ev.jacobian.transposed(lam),
        "gamma": ev.gamma(),
        "balance": ev.balance(a, lam),
        "balance without lambda": ev.balance(a),
    }


@pytest.mark.compiled
@pytest.mark.parametrize("name", MAKERS)
def test_equal_to_numpy(name: str) -> None:
    plain, driven, (t, q, v, a, lam) = pair_of(MAKERS[name])
    expected = [answers(plain.at(float(t[i]), q[i], v[i]), a[i], lam[i]) for i in range(len(t))]
    single = [answers(driven.at(float(t[i]), q[i], v[i]), a[i], lam[i]) for i in range(len(t))]
    together = answers(driven.batch(t, q, v), a, lam)
    for key in expected[0]:
        wanted = np.array([x[key] for x in expected])
        scale = max(1.0, float(np.abs(wanted).max(initial=0.0)))
        assert np.array([x[key] for x in single]) == pytest.approx(wanted, rel=1e-11, abs=1e-12 * scale), key
        assert together[key] == pytest.approx(wanted, rel=1e-11, abs=1e-12 * scale), key

    rate = [plain.at(float(t[0]), q[0], v[0]).constraint_rate(), driven.at(float(t[0]), q[0], v[0]).constraint_rate()]
    assert rate[1] == pytest.approx(rate[0], rel=1e-11, abs=1e-12)

    moved = [system.compose(q, 0.1 * v) for system in (plain, driven)]
    assert moved[1] == pytest.approx(moved[0], rel=1e-14, abs=1e-14)
    assert np.array_equal(driven.compose(q[0], 0.1 * v), driven.compose(np.broadcast_to(q[0], q.shape), 0.1 * v))

    # increments back, the smallest ones and those nearest to others, and their rates
    for turns in (0.1, 2.5, 9.0):
        there = plain.compose(q, turns * v)
        for near in (None, 0.9 * turns * v, 0.0 * v):
            back = [system.difference(q, there, near=near) for system in (plain, driven)]
            assert back[1] == pytest.approx(back[0], rel=1e-12, abs=1e-12)
        rates = [system.rate(turns * v, a) for system in (plain, driven)]
        assert rates[1] == pytest.approx(rates[0], rel=1e-11, abs=1e-11)
    back = [system.difference(q[0], q[0], near=9.0 * v[0]) for system in (plain, driven)]
    assert back[1] == pytest.approx(back[0], rel=1e-12, abs=1e-12)


@pytest.mark.compiled
@pytest.mark.parametrize("form", [fmbd.Index3(), fmbd.Index2(), fmbd.GGL()], ids=lambda form: form.name)
@pytest.mark.parametrize("name", ["plane", "reduced 2D", "reduced 3D"])
def test_points_of_implicit_steps(name: str, form: Any) -> None:
    """What BDF and Radau ask of their stages, in one call; numbers like those that NumPy finds in parts."""
    plain, driven, (t, q, v, a, lam) = pair_of(MAKERS[name])
    mult = np.concatenate((lam, 1e-2 * lam[::-1]), axis=1)[:, : len(form.levels) * plain.n_lam]
    points = Points(0.01 * v, v - a, v, a, mult)
    found = []
    for system in (plain, driven):
        eq = StepEquations(system, form, StepSolver(system))
        start = State(0.1, q[0], v[0], a[0], lam[0])
        eq.weigh(start), eq.begin(start)
        found.append((*eq.residual(t, points), eq.left))
    assert eq._told(t, points) is not None
    for wanted, x in zip(*found, strict=True):
        assert x == pytest.approx(wanted, rel=1e-11, abs=1e-12 * max(1.0, np.abs(wanted).max()))
    if name != "plane":  # whose laws of time are Python's
        assert calls_of(lambda: eq.residual(t, points)) <= 20


@pytest.mark.compiled
def test_calls_of_python_for_one_call_of_c() -> None:
    """One start with many increments, as stages ask: NumPy would see some thirty calls in that one row serves all. The balance
    with its rows: one call of C.
    """
    _, driven, (t, q, v, a, lam) = pair_of(rolling)
    asked = {
        "compose": lambda: driven.compose(q[0], 0.1 * v),
        "difference": lambda: driven.difference(q[0], q, near=v),
        "rate": lambda: driven.rate(0.1 * v, a),
    }
    for name, what in asked.items():
        what()
        assert calls_of(what) <= 10, name

    def equations() -> None:
        ev = driven.batch(t, q, v)
        ev.balance(a, lam), ev.constraint(), ev.opening()

    equations()
    assert calls_of(equations) <= 16


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("scheme", "most"),
    [
        (fmbd.Rattle(), 1),
        (fmbd.HalfExplicit(rtol=None), 1),
        (fmbd.ExplicitRungeKutta(rtol=None), 1),
        (fmbd.EnergyMomentum(), 1),
        (fmbd.BDF(order=2, rtol=None), 1),
        (fmbd.Radau(rtol=None), 1),
    ],
    ids=lambda x: str(x)[:4],
)
def test_a_step_enters_few_functions_of_python(scheme: Any, most: int) -> None:
    """Of a whole run: the loop, its judges and records among them. Differences of two lengths, so that the start cancels."""
    output = fmbd.Output(every=1000, progress=False)
    run = lambda steps: fmbd.solve(joint_springs(2), t_end=1e-3 * steps, dt=1e-3, scheme=scheme, output=output)  # noqa: E731
    run(20)  # what steps are stable is found once
    assert calls_of(lambda: run(20)) - calls_of(lambda: run(10)) <= 10 * most


@pytest.mark.compiled
def test_laws_of_time_are_asked_once_a_state() -> None:
    """What an input says is asked again with every state, at the same time too: it can be set in between."""
    asked: list[float] = []
    said = [1.0]

    def torque(t: float) -> float:
        asked.append(t)
        return said[0]

    scene = fmbd.Scene("arm", gravity=(0.0, -9.81))
    arm = fmbd.RigidBody("arm", 1.0, 0.1, (0.5, 0.0))
    hinge = fmbd.revolute("hinge", fmbd.ground, arm, center=(0, 0))
    scene.add(arm, hinge, fmbd.effort("motor", fmbd.angle(hinge), torque))
    system, start, _ = scene.build()
    use_driver(system)

    def balances(ev: Any) -> np.ndarray:
        assert ev.constraint() is not None and ev.jacobian.core is not None
        return np.array([ev.balance(x)[2] for x in (start.a, start.a, start.a)])

    balances(system.at(0.3, start.q, start.v))  # a law's first answer is compared with a second one
    asked.clear()
    given = system.at(0.3, start.q, start.v)
    first = balances(given)
    assert asked == [0.3] and np.ptp(first) == 0.0
    said[0] = 3.0
    assert first - balances(system.at(0.3, start.q, start.v)) == pytest.approx(2.0, rel=1e-12)
    assert asked == [0.3, 0.3] and first - balances(given) == pytest.approx(2.0, rel=1e-12)


@pytest.mark.compiled
def test_answers_are_the_callers_own() -> None:
    """Who changes an answer changes no later one."""
    _, driven, (t, q, v, _, _) = pair_of(plane)
    for ev in (driven.at(float(t[0]), q[0], v[0]), driven.batch(t, q, v)):
        for ask in (ev.constraint, ev.opening, ev.gamma):
            first = ask()
            first[:] = np.nan
            assert np.isfinite(ask()).all()


@pytest.mark.compiled
@pytest.mark.parametrize("make", [joint_springs, suspended])
def test_an_array_that_is_written_into_is_another_state(make: Any) -> None:
    """What was found of a state serves again for the same values only, not for the same array."""
    system, start, _ = make(2).build()
    use_driver(system)
    q = start.q.copy()
    first = system.at(0.0, q, start.v)
    places, gaps = first.kin.x.copy(), first.constraint()

    q += 0.01
    moved = system.at(0.0, q, start.v)
    assert np.abs(moved.kin.x - places).max() > 1e-3
    if system.n_lam:
        assert np.abs(moved.constraint() - gaps).max() > 1e-3
