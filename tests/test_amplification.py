"""Orders of backward differentiation that amplify vibrations, against the formula itself and in runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.schemes.multistep import amplification
from fmbd_fenicsx.schemes.multistep.amplification import GROWTH, RESOLVED, Amplification, spans_of, vibrations

FORMULAS = {  # y_n+1, y_n, ..: h y'
    1: (1.0, -1.0),
    2: (3 / 2, -2.0, 1 / 2),
    3: (11 / 6, -3.0, 3 / 2, -1 / 3),
    4: (25 / 12, -4.0, 3.0, -4 / 3, 1 / 4),
    5: (137 / 60, -5.0, 5.0, -10 / 3, 5 / 4, -1 / 5),
}


def growth(order: int, z: Any) -> Any:
    """Largest |zeta| of the formula for values z = h lambda, by eigenvalues."""
    first, *rest = FORMULAS[order]
    companion = np.zeros((len(z), order, order), dtype=complex)
    companion[:, 1:, :-1] = np.eye(order - 1)
    companion[:, 0, :] = -np.array(rest) / (first - z)[:, None]
    return np.abs(np.linalg.eigvals(companion)).max(axis=1)


@pytest.mark.parametrize("order", FORMULAS)
def test_growth_is_that_of_the_recursion(order: int) -> None:
    """Two hundred steps of the formula itself for a vibration, by its growth over the last half."""
    first, *rest = FORMULAS[order]
    z = 1j * np.array([0.4, 1.3, 5.0])
    past = [np.exp(-k * z) + 1e-3 for k in range(order)]
    sizes = []
    for _ in range(200):
        new = -sum(c * y for c, y in zip(rest, past, strict=True)) / (first - z)
        past = [new, *past][:order]
        sizes.append(np.abs(new))
    rate = (sizes[-1] / sizes[99]) ** 0.01
    assert np.abs(growth(order, z) - rate).max() < 0.01
    assert np.all(growth(order, z) <= 1.0 + 1e-12) == (order <= 2)


@pytest.mark.parametrize("order", [3, 4, 5])
def test_spans_are_where_a_vibration_grows(order: int) -> None:
    """For rates in all directions that do not grow, fast ones and slow ones together."""
    rng = np.random.default_rng(order)
    rates = 10.0 ** rng.uniform(-3, 5, 60) * (1j * rng.normal(size=60) - rng.exponential(size=60) * (np.arange(60) % 3))
    grown = 0
    for rate in rates:
        h = 10.0 ** rng.uniform(-2, 2, 50) / abs(rate)
        spans = spans_of(order, np.array([0.0, rate]))
        found = ((spans[:, :1] < h) & (h < spans[:, 1:])).any(axis=0)
        wanted = (np.abs(h * rate) > RESOLVED) & (growth(order, h * rate) > 1.0 + GROWTH)
        assert np.array_equal(found, wanted)
        grown += wanted.sum()
    assert grown > 100


def spring_and_mass(damping: float) -> fmbd.Scene:
    """1 kg on 1e6 N/m along x, held across: 1 000 rad/s; it falls along no direction but that."""
    body = fmbd.RigidBody("mass", 1.0, 1.0, position=(1.0, 0.0))
    scene = fmbd.Scene("vibration", gravity=(0.0, -9.81))
    scene.add(body, fmbd.prismatic("guide", fmbd.ground, body, center=(1.0, 0.0), axis=(1.0, 0.0)))
    scene.add(
        fmbd.Spring("spring", fmbd.ground, body, (0.0, 0.0), (1.0, 0.0), stiffness=1e6, damping=damping, length=1.0)
    )
    return scene


@pytest.mark.parametrize("damping", [0.0, 200.0])
def test_vibrations_are_those_of_the_scene(damping: float) -> None:
    """lambda = -d / 2m +- i sqrt(k/m - (d / 2m)^2); constraints take the other motions."""
    system, state, _ = spring_and_mass(damping).build()
    found = vibrations(StepSolver(system), state)
    decay = 0.5 * damping
    exact = -decay + 1j * np.sqrt(1e6 - decay**2)
    assert len(found) == 2
    assert np.abs(found[np.argmax(found.imag)] - exact) < 1e-6 * abs(exact)

    orders = Amplification(StepSolver(system))
    orders.look(5, state)
    assert orders.permits(2, 1e-3) and orders.permits(5, 1e-5)
    assert orders.permits(5, 1e-3) == (damping > 0 and growth(5, 1e-3 * found).max() < 1.0)


@pytest.mark.parametrize(("stiffness", "masses"), [(1e10, (1e-3, 1e3)), (1e8, (1e-2, 10.0))])
def test_light_and_heavy_body_on_a_stiff_spring(stiffness: float, masses: tuple[float, float], caplog: Any) -> None:
    """A pendulum of 2 m, of two bodies with a spring between them that carries the heavy one: few steps, for a vibration of
    1e-6 m is none of its motion.
    """
    from scipy.integrate import solve_ivp

    angle, g = 0.5, 9.81
    down = np.array([np.sin(angle), -np.cos(angle)])
    light, heavy = masses
    a = fmbd.RigidBody("light", light, 1e-4 * light, position=down)
    b = fmbd.RigidBody("heavy", heavy, 0.1 * heavy, position=2 * down)
    scene = fmbd.Scene("stiff", gravity=(0.0, -g))
    scene.add(a, b, fmbd.distance("rod", fmbd.ground, a, point_a=(0.0, 0.0), point_b=down, length=1.0))
    natural = 1.0 - heavy * g * np.cos(angle) / stiffness
    scene.add(fmbd.Spring("spring", a, b, down, 2 * down, stiffness=stiffness, length=natural))
    scene.sensor("heavy", fmbd.position(b))
    run = fmbd.solve(scene, t_end=1.0, scheme=fmbd.BDF(rtol=1e-4))

    swing = solve_ivp(lambda t, y: (y[1], -0.5 * g * np.sin(y[0])), (0.0, 1.0), (angle, 0.0), rtol=1e-11, atol=1e-12)
    exact = 2 * np.array([np.sin(swing.y[0, -1]), -np.cos(swing.y[0, -1])])
    assert np.abs(run["heavy"][-1] - exact).max() < 5e-3
    assert run.counters["steps"] < 600


def jumping() -> fmbd.Scene:
    """The mass on its stiff spring, and a pendulum that a force takes hold of at once."""
    scene = spring_and_mass(0.0)
    arm = fmbd.RigidBody("arm", 1.0, 0.1, position=(0.5, 0.0))
    hinge = fmbd.revolute("hinge", fmbd.ground, arm, center=(0.0, 0.0))
    scene.add(arm, hinge, fmbd.joint_spring("law", fmbd.angle(hinge), law=lambda s, rate, t: 20.0 * (t > 0.12)))
    return scene


@pytest.mark.parametrize("rtol", [1e-6, 1e-8])
def test_compiled_code_takes_the_same_orders(rtol: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a vibration that no step resolves forbids some, and where a step is refused more than twice."""
    from fmbd_fenicsx.schemes.marching import MarchingStepper

    run = lambda: fmbd.solve(jumping(), t_end=0.25, scheme=fmbd.BDF(rtol=rtol))  # noqa: E731
    once = run()
    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)
    turn = run()
    assert once.counters == turn.counters
    assert once.state.q == pytest.approx(turn.state.q, rel=1e-7, abs=1e-8)


def test_runs_that_begin_alike_look_at_their_first_vibrations_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """All runs of a call with a tolerance looked at them, each in its third step, which ended a march."""
    seen: list[float] = []
    noted = lambda solver, state: (seen.append(state.t), vibrations(solver, state))[1]  # noqa: E731
    monkeypatch.setattr(amplification, "vibrations", noted)
    scene = spring_and_mass(0.0)
    mass = next(iter(scene.bodies.values()))
    scene.add(fmbd.force("push", mass, lambda t: (1e3 * np.sin(100.0 * t), 0.0)))
    scene.sensor("place", fmbd.position(mass))
    fmbd.solve(scene, t_end=0.1, scheme=fmbd.BDF(), tol={"place": fmbd.relative(1e-2)})
    assert seen.count(0.0) == 1 and min(seen[1:], default=1.0) > 1e-3
