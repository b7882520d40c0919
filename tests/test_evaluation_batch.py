"""Many configurations at once: the same numbers as one at a time, for every kind of part, joint and force."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from dae_problems import pendulum, spinning_top

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import CallbackError
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.schemes.dae import Baumgarte, Overdetermined
from fmbd_fenicsx.schemes.implicit.step_equations import StepEquations
from fmbd_fenicsx.system.layout import State


def plane() -> fmbd.Scene:
    """A drive, a spring with a law of its own, an angle that counts revolutions, and a force of the user's own."""
    scene = fmbd.Scene("plane", gravity=(0, -9.81), gravity_ramp=0.5)
    arm = fmbd.RigidBody("arm", 1.0, 0.1, position=(0.5, 0))
    rod = fmbd.RigidBody("rod", 2.0, 0.2, position=(1.5, 0.2), rotation=0.3)
    wheel = fmbd.RigidBody("wheel", 1.0, 0.1, position=(3.0, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
    hub = fmbd.revolute("hub", fmbd.ground, wheel, center=(3.0, 0.0))
    scene.add(arm, rod, wheel, pin, hub)
    scene.add(fmbd.distance("bar", arm, rod, point_a=(1.0, 0.0), point_b=(1.4, 0.1), length=0.4))
    scene.add(fmbd.drive_rotation("motor", fmbd.ground, arm, lambda t: np.sin(3 * t)))
    scene.add(fmbd.gear("gear", fmbd.angle(pin), fmbd.angle(hub), ratio=0.5))
    scene.add(fmbd.Spring("spring", rod, fmbd.ground, (1.6, 0.3), (2.0, 2.0), stiffness=40.0, damping=0.5))
    scene.add(fmbd.Spring("own", arm, rod, (0.5, 0.0), (1.5, 0.2), law=lambda s, rate, t: s**3 + t * rate))
    scene.add(fmbd.joint_spring("turn", fmbd.angle(hub), stiffness=3.0, damping=0.1))
    scene.add(fmbd.force("push", rod, lambda t: (np.sin(t), 2.0 * t)))
    return scene


def space() -> fmbd.Scene:
    """A top beside a body with equations of its own, not vectorized."""
    scene = spinning_top()
    scene.add(
        fmbd.CoordinateBody(
            "mass",
            lambda q: np.diag([1.0, 2.0 + q[0] ** 2]),
            lambda q, v, t: np.array([-q[0] * v[1], np.sin(t) - q[1]]),
            [1.0, 0.2],
            constraint=lambda q, t: np.array([q[0] ** 2 + q[1] - np.cos(t) - 0.2]),
        )
    )
    return scene


def bare() -> fmbd.Scene:
    """A vectorized body that gives no derivatives."""
    scene = fmbd.Scene("bare")
    scene.add(
        fmbd.CoordinateBody(
            "mass",
            np.eye(2),
            lambda q, v, t: np.array([-q[0] * v[1], np.sin(t) - q[1]]),
            [1.0, 0.2],
            constraint=lambda q, t: np.array(
                [q[0] ** 2 + q[1] - np.cos(t) - 0.2, q[0] * np.sin(q[1] + t) - np.sin(0.2)]
            ),
            vectorized=True,
        )
    )
    return scene


SCENES: list[Callable[[], fmbd.Scene]] = [plane, space, pendulum, bare]


def states(
    scene: fmbd.Scene, k: int = 4
) -> tuple[fmbd.Scene, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A system and k configurations about its start: times, q, v, a, lambda."""
    system, given, _ = scene.build()
    rng = np.random.default_rng(1)
    q = system.compose(given.q, 0.1 * rng.normal(size=(k, system.n_v)))
    v, a = given.v + rng.normal(size=(k, system.n_v)), rng.normal(size=(k, system.n_v))
    return system, np.linspace(0.1, 0.7, k), q, v, a, rng.normal(size=(k, system.n_lam))


@pytest.mark.parametrize("scene", SCENES, ids=lambda s: s.__name__)
def test_copies_are_what_single_evaluations_are(scene: Callable[[], fmbd.Scene]) -> None:
    system, t, q, v, a, lam = states(scene())
    many = system.batch(t, q, v)
    ones = [system.at(float(t[i]), q[i], v[i]) for i in range(len(t))]
    pairs = [
        (many.constraint(), [e.constraint() for e in ones]),
        (many.opening(), [e.opening() for e in ones]),
        (many.gamma(), [e.gamma() for e in ones]),
        (many.jacobian.core, [e.jacobian.core for e in ones]),
        (many.jacobian.times(v), [e.jacobian.times(x) for e, x in zip(ones, v, strict=True)]),
        (many.balance(a, lam), [e.balance(a[i], lam[i]) for i, e in enumerate(ones)]),
        (many.balance(a), [e.balance(a[i]) for i, e in enumerate(ones)]),
    ]
    for together, single in pairs:
        assert together == pytest.approx(np.array(single), rel=1e-12, abs=1e-12)


def test_a_vectorized_body_is_called_once() -> None:
    calls = []

    def force(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        calls.append(q.shape)
        return -q * np.array([1.0, 2.0]).reshape(2, *(1,) * (q.ndim - 1)) + 0.0 * t

    def body(vectorized: bool) -> fmbd.Scene:
        scene = fmbd.Scene("own")
        scene.add(
            fmbd.CoordinateBody(
                "own",
                np.diag([1.0, 3.0]),
                force,
                [1.0, 0.5],
                constraint=lambda q, t: np.array([q[0] * q[1] - 0.5 + 0.1 * t]),
                jacobian=lambda q, t: np.array([[q[1], q[0]]]),
                gamma=lambda q, v, t: np.array([2 * v[0] * v[1]]),
                rate=lambda q, t: np.array([0.1 + 0.0 * q[0]]),
                vectorized=vectorized,
            )
        )
        return scene

    found = []
    for vectorized in (True, False):
        system, t, q, v, a, lam = states(body(vectorized), 3)
        calls.clear()
        many = system.batch(t, q, v)
        found.append([many.balance(a, lam), many.constraint(), many.opening(), many.gamma(), many.jacobian.core])
        assert calls == ([(2, 3)] if vectorized else [(2,)] * 3)
    for together, single in zip(*found, strict=True):
        assert together == pytest.approx(single, rel=1e-13)


def test_a_force_that_is_not_finite_is_reported_with_its_time() -> None:
    scene = fmbd.Scene("bad")
    scene.add(fmbd.CoordinateBody("mass", np.eye(1), lambda q, v, t: np.array([np.nan if t > 0.5 else 1.0]), [0.0]))
    system, _, _ = scene.build()
    with pytest.raises(CallbackError, match='"mass".*t = 0.6'):
        system.batch(np.array([0.4, 0.6]), np.zeros((2, 1)), np.zeros((2, 1))).balance(np.zeros((2, 1)))


@pytest.mark.parametrize("form", [fmbd.GGL(), Overdetermined(), Baumgarte(3.0, 4.0)], ids=lambda f: f.name)
@pytest.mark.parametrize("scene", [plane, space], ids=lambda s: s.__name__)
def test_the_tangent_is_the_derivative_of_the_residual(scene: Callable[[], fmbd.Scene], form: fmbd.GGL) -> None:
    """By differences of fourth order of the rows themselves, one configuration at a time."""
    system, t, q, v, a, lam = states(scene(), 1)
    equations = StepEquations(system, form, StepSolver(system))
    state = State(float(t[0]), q[0], v[0], a[0], lam[0])
    mult = equations.multipliers(state)
    made = equations.refresh(state, mult)

    def rows(xi: np.ndarray, dv: np.ndarray) -> np.ndarray:
        at = equations.stiff.system.batch(t, system.compose(q, xi[None]), v + dv)
        return equations.lower(at, a, mult[None])[0]

    zero, eye, h = np.zeros(system.n_v), np.eye(system.n_v), 1e-3
    for found, f in ((made.by_q, lambda e: rows(e, zero)), (made.by_v, lambda e: rows(zero, e))):
        exact = np.array([(8 * (f(h * e) - f(-h * e)) - f(2 * h * e) + f(-2 * h * e)) / (12 * h) for e in eye]).T
        assert found == pytest.approx(exact, rel=1e-4, abs=1e-5 * np.abs(exact).max())  # gamma by differences has noise
