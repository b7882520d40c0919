"""Combinations of joint coordinates: differentials, ropes over pulleys, hoists, springs on a combination."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from profiled import calls_of
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import kernel_cache
from fmbd_fenicsx.errors import CallbackError, ConstraintError, InputError

G = 9.81
J = {"left": 0.5, "right": 0.8, "cage": 0.1}
PATHS = [fmbd.GeneralizedAlpha(compiled=True), fmbd.GeneralizedAlpha(compiled=False)]


def wheels() -> tuple[fmbd.Scene, dict[str, Any]]:
    """Two wheels and the cage of a differential, each on a hinge of its own; their angles."""
    scene, angles = fmbd.Scene("differential"), {}
    for i, (name, inertia) in enumerate(J.items()):
        wheel = fmbd.RigidBody(name, 1.0, inertia, position=(0.0, float(i)))
        hinge = fmbd.revolute(f"axle {name}", fmbd.ground, wheel, center=(0.0, float(i)))
        scene.add(wheel, hinge)
        angles[name] = fmbd.angle(hinge)
        scene.sensor(name, angles[name])
    return scene, angles


@pytest.mark.parametrize("scheme", PATHS, ids=["compiled", "NumPy"])
def test_a_differential_shares_its_torque(scheme: Any) -> None:
    scene, s = wheels()
    scene.add(fmbd.couple("gears", {s["left"]: 1.0, s["right"]: 1.0, s["cage"]: -2.0}))
    scene.add(fmbd.effort("engine", s["cage"], 10.0))
    scene.sensor("half torque", fmbd.reaction("gears"))
    run = fmbd.solve(scene, t_end=0.2, dt=2e-3, scheme=scheme)

    # with the cage's angle as half of the sum: M s'' = T / 2 (1, 1)
    quarter = J["cage"] / 4
    M = np.array([[J["left"] + quarter, quarter], [quarter, J["right"] + quarter]])
    rates = np.linalg.solve(M, [5.0, 5.0])
    for name, rate in zip(("left", "right"), rates, strict=True):
        assert run[name][-1] == pytest.approx(rate * 0.02, rel=1e-10)
    assert run["half torque"][-1] == pytest.approx(-J["left"] * rates[0], rel=1e-9)
    if scheme.compiled and kernel_cache.compiler() is not None:
        assert run.counters["compiled_steps"] == 100


def test_a_combination_may_be_driven_beside_one_of_its_coordinates() -> None:
    scene, s = wheels()
    scene.add(fmbd.couple("sum", {s["left"]: 1.0, s["right"]: 1.0}, motion=lambda t: t**2))
    scene.add(fmbd.drive("left alone", s["left"], lambda t: 3 * t**2))
    run = fmbd.solve(scene, t_end=0.2, dt=1e-2)
    assert run["left"][-1] == pytest.approx(0.12, abs=1e-12)
    assert run["right"][-1] == pytest.approx(-0.08, abs=1e-12)


def test_a_spring_acts_on_a_combination_through_a_light_wheel() -> None:
    """A bar that resists the difference of two angles, as an anti-roll bar does: the wheels swing against each other."""
    scene, s = wheels()
    bar = fmbd.RigidBody("bar", 1.0, 1e-9, position=(1.0, 0.0))
    twist = fmbd.revolute("twist", fmbd.ground, bar, center=(1.0, 0.0))
    scene.add(bar, twist, fmbd.couple("ends", {s["left"]: 1.0, s["right"]: -1.0, fmbd.angle(twist): -1.0}))
    scene.add(fmbd.joint_spring("bar", fmbd.angle(twist), stiffness=300.0))
    scene.add(fmbd.effort("push", s["left"], 4.0))
    run = fmbd.solve(scene, t_end=0.4, dt=2e-3)

    together, t = J["left"] + J["right"], 0.4
    w = np.sqrt(300.0 * together / (J["left"] * J["right"]))
    difference = 4.0 / J["left"] / w**2 * (1 - np.cos(w * t))
    left = 0.5 * 4.0 / together * t**2 + J["right"] / together * difference
    assert run["left"][-1] == pytest.approx(left, rel=2e-3)
    assert run["right"][-1] == pytest.approx(left - difference, rel=2e-3)


def tackle(motion: Callable[[float], Any] | None = None) -> fmbd.Scene:
    """A weight a on one strand and a weight b on a loose pulley in two strands of one rope."""
    scene, strands = fmbd.Scene("block and tackle", gravity=(0, -G)), []
    a = fmbd.RigidBody("a", 2.0, 0.1, position=(0.0, -1.0))
    b = fmbd.RigidBody("b", 3.0, 0.1, position=(1.0, -2.0))
    scene.add(a, b)
    for body, x in ((a, 0.0), (b, 0.9), (b, 1.1)):
        ends = {"point_a": (x, 0.0), "point_b": (x, body.position[1])}
        strands.append(fmbd.segment(f"strand at {x}", fmbd.ground, body, **ends))
    scene.add(*(fmbd.prismatic(f"guide {body.name}", fmbd.ground, body, axis=(0, 1)) for body in (a, b)))
    scene.add(*strands, fmbd.couple("rope", {fmbd.displacement(s): 1.0 for s in strands}, motion=motion))
    scene.sensor("b", fmbd.position(b))
    scene.sensor("strand", fmbd.displacement(strands[0]))
    scene.sensor("tension", fmbd.reaction("rope"))
    return scene


@pytest.mark.parametrize("scheme", [*PATHS, fmbd.Rattle()], ids=lambda s: f"{s.name} {getattr(s, 'compiled', '')}")
def test_segments_are_a_rope_over_pulleys(scheme: Any) -> None:
    """3 x'' = 2 T - 3 g and -4 x'' = T - 2 g: x'' = g / 11."""
    run = fmbd.solve(tackle(), t_end=0.2, dt=2e-3, scheme=scheme)
    way = 0.5 * G / 11 * 0.2**2
    assert run["b"][-1] == pytest.approx([1.0, -2.0 + way], abs=1e-12)
    assert run["strand"][-1] == pytest.approx(1.0 + 2 * way, abs=1e-12)
    assert run["tension"][-1] == pytest.approx(2 * G - 4 * G / 11, rel=1e-9)


def test_a_rope_that_stands_asks_no_python() -> None:
    """Its length was asked for at every step, as that of a winch is: fourteen calls, ten times the time of a step in C."""

    def run(steps: int) -> Callable[[], Any]:
        output = fmbd.Output(every=10**6, energy=False, progress=False)
        return lambda: fmbd.solve(tackle(), t_end=1e-4 * steps, dt=1e-4, output=output)

    run(10)()
    few, many = calls_of(run(200), "couplings.py"), calls_of(run(400), "couplings.py")
    assert few == many


def test_a_winch_takes_rope_in() -> None:
    """With a rope of length L(t) weight a rises by -L'' - 2 x'': 11 x'' = g - 4 L''."""
    run = fmbd.solve(tackle(lambda t: 5.0 - 0.5 * t**2), t_end=0.2, dt=2e-3)
    assert run["b"][-1][1] == pytest.approx(-2.0 + 0.5 * (G + 4.0) / 11 * 0.2**2, abs=1e-9)


def wire(t: float) -> Any:
    """Length of a rope that is hauled in, and its rates."""
    rate, second = -0.4 + 0.15 * np.sin(3 * t), 0.45 * np.cos(3 * t)
    return np.sqrt(10.0) - 0.4 * t + 0.05 * (1 - np.cos(3 * t)), rate, second


@pytest.mark.parametrize("scheme", PATHS, ids=["compiled", "NumPy"])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_distance_given_in_time_hoists(dim: int, scheme: Any) -> None:
    """A load that swings on a rope of length L(t): L p'' = -2 L' p' - g sin p, T = m (g cos p + L p'^2 - L'')."""
    place = np.array([1.0, -3.0] if dim == 2 else [1.0, 0.0, -3.0])
    load = fmbd.RigidBody("load", 3.0, 0.2 if dim == 2 else (0.2, 0.2, 0.2), position=place)
    scene = fmbd.Scene("crane", gravity=(0, -G) if dim == 2 else (0, 0, -G))
    scene.add(load, fmbd.distance("rope", fmbd.ground, load, length=lambda t: wire(t)[0]))
    scene.sensor("load", fmbd.position(load))
    scene.sensor("tension", fmbd.reaction("rope"))
    run = fmbd.solve(scene, t_end=0.5, dt=5e-3, scheme=scheme)

    def swing(t: float, y: Any) -> Any:
        length, rate, _ = wire(t)
        return [y[1], -(2 * rate * y[1] + G * np.sin(y[0])) / length]

    p, w = solve_ivp(swing, (0, 0.5), [np.arctan2(1, 3), 0.0], rtol=1e-10, atol=1e-12).y[:, -1]
    length, _, second = wire(0.5)
    found = run["load"][-1]
    assert found[[0, -1]] == pytest.approx([length * np.sin(p), -length * np.cos(p)], abs=1e-5)
    assert run["tension"][-1] == pytest.approx(3.0 * (G * np.cos(p) + length * w**2 - second), rel=1e-3)
    assert np.linalg.norm(found) == pytest.approx(length, abs=1e-12)


def test_what_cannot_be_coupled_is_refused() -> None:
    _, s = wheels()
    ball = fmbd.RigidBody("ball", 1.0, 1.0, position=(1.0, 0.0))
    rod = fmbd.distance("rod", fmbd.ground, ball)
    with pytest.raises(InputError, match='"c" couples nothing'):
        fmbd.couple("c", {})
    with pytest.raises(InputError, match='"c".*factor is 0'):
        fmbd.couple("c", {s["left"]: 0.0})
    with pytest.raises(InputError, match='"c": coordinate.*must be'):
        fmbd.couple("c", {"left": 1.0})  # type: ignore[dict-item]
    with pytest.raises(InputError, match='"c": coordinate Joint "rod" must be'):
        fmbd.couple("c", {rod: 1.0})  # type: ignore[dict-item]
    with pytest.raises(InputError, match=r'"d": the length of joint "rod".*held by that joint.*segment'):
        fmbd.drive("d", fmbd.displacement(rod), lambda t: 1.0 + t)
    with pytest.raises(InputError, match="its length is -1 m at t = 0 s, and must stay above 0"):
        fmbd.distance("rope", fmbd.ground, ball, length=lambda t: t - 1.0)
    with pytest.raises(CallbackError, match='"rope".*returned None'):
        fmbd.distance("rope", fmbd.ground, ball, length=lambda t: None)
    with pytest.raises(ConstraintError, match='"rope".*coupling.*begins 2 m.*segment its length'):
        fmbd.solve(tackle(lambda t: 3.0 - t), t_end=0.1, dt=0.01)


@pytest.mark.parametrize("scheme", PATHS, ids=["compiled", "NumPy"])
def test_a_rope_that_is_hauled_in_whole_is_named(scheme: Any) -> None:
    load = fmbd.RigidBody("load", 3.0, 0.2, position=(0.0, -0.3))
    scene = fmbd.Scene("crane", gravity=(0, -G))
    scene.add(load, fmbd.distance("rope", fmbd.ground, load, length=lambda t: 0.3 - 2.9 * t))
    with pytest.raises(CallbackError, match=r'"rope": its length is -.* at t = 0.11 s, and must stay above 0'):
        fmbd.solve(scene, t_end=0.2, dt=0.01, scheme=scheme)
