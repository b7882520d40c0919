"""Derivatives of what users give as functions of their own coordinates: whatever numbers pass, and in any units."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.mechanics.bodies.coordinates import own_constraint
from fmbd_fenicsx.mechanics.bodies.own_derivatives import differences, slopes_of
from fmbd_fenicsx.mechanics.bodies.port_constraint import PortConstraint

CIRCLES: dict[str, Callable[[Any], Any]] = {
    "norm": np.linalg.norm,  # takes complex numbers and drops what they carry
    "abs": lambda q: abs(q[0] + 1j * q[1]),
    "math": lambda q: math.sqrt(q[0] ** 2 + q[1] ** 2),
    "hypot": lambda q: np.hypot(q[0], q[1]),
    "sqrt": lambda q: np.sqrt(q @ q),
}


def pendulum(length: Callable[[Any], Any], unit: float) -> fmbd.Scene:
    """A mass on a circle that shrinks and grows, lengths and times in ``unit`` (m and s): x^2 + y^2 = (1 + 0.2 sin 3 t)^2."""

    def closed(q: np.ndarray, t: float) -> list[Any]:
        return [length(q) - unit * (1 + 0.2 * (math if length is CIRCLES["math"] else np).sin(3 * t / unit))]

    def weight(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        return np.array([0.0, -9.81 / unit])

    start = {"start": (unit, 0.0), "start_rate": (0.6, 0.0)}
    scene = fmbd.Scene("pendulum")
    body = scene.add(fmbd.CoordinateBody("mass", np.eye(2), weight, constraint=closed, **start))
    scene.sensor("q", fmbd.coordinates(body))
    return scene


@pytest.mark.parametrize("way", CIRCLES)
def test_a_circle_is_a_circle_however_it_is_written(way: str) -> None:
    """Position and velocity as of the formula that takes complex numbers; a norm used to be passed over in silence."""
    scheme = fmbd.GeneralizedAlpha(0.9)
    wanted = fmbd.solve(pendulum(CIRCLES["sqrt"], 1.0), t_end=1.0, dt=0.02, scheme=scheme)["q"]
    found = fmbd.solve(pendulum(CIRCLES[way], 1.0), t_end=1.0, dt=0.02, scheme=scheme)["q"]
    np.testing.assert_allclose(found, wanted, atol=1e-8)
    assert wanted[-1, 1] < -0.1


@pytest.mark.parametrize("way", ["sqrt", "math"])
@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_motions_do_not_depend_on_units(way: str, unit: float) -> None:
    """Second rates of the constraint were differenced by 1e-4 s: a scene of nanoseconds did not end."""
    runs = [
        fmbd.solve(pendulum(CIRCLES[way], u), t_end=0.3 * u, scheme=fmbd.HalfExplicit(rtol=1e-8, atol=1e-9 * u))["q"][
            -1
        ]
        / u
        for u in (1.0, unit)
    ]
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-7)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("vectorized", [False, True])
def test_second_rates_are_exact_in_any_units(unit: float, vectorized: bool) -> None:
    """g = sin(x / L) y / L - cos(t / T): g'' at constant rates by hand."""
    law = PortConstraint("g", 0, lambda p, t: np.array([np.sin(p[0] / unit) * p[1] / unit - np.cos(t / unit)]))
    x, y, vx, vy, t = 0.4, 1.2, -2.0, 3.0, 0.7
    wanted = -np.sin(x) * y * vx**2 + 2 * np.cos(x) * vx * vy + np.cos(t)
    p, v = np.array([[x, y]]) * unit, np.array([[vx, vy]])
    found = PortConstraint("g", 0, law.function, vectorized=vectorized).many("gamma", np.array([t]) * unit, p, v)
    assert found[0, 0] * unit**2 == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e6])
def test_differences_suit_any_units(unit: float) -> None:
    """Of a function that takes plain numbers only, about many places and from a start where it has no slope."""

    def circle(q: np.ndarray) -> list[float]:
        return [math.sqrt(float(q[0]) ** 2 + float(q[1]) ** 2) - unit]

    slopes = slopes_of(circle, np.array([unit, 0.0]))
    assert not slopes.by_complex
    for angle in (0.1, 1.0, 3.0):
        q = unit * np.array([np.cos(angle), np.sin(angle)])
        np.testing.assert_allclose(differences(circle, q), q[None] / unit, atol=1e-11)
        np.testing.assert_allclose(slopes(q), q[None] / unit, atol=1e-9)


def test_steps_kept_from_the_start_are_few() -> None:
    """A function of plain numbers is asked some ten times for each coordinate, not a hundred."""
    asked = []

    def height(q: np.ndarray) -> list[float]:
        asked.append(q)
        return [math.sin(q[0]) * math.exp(q[1])]

    slopes = slopes_of(height, np.array([0.2, 0.1]))
    asked.clear()
    found = slopes(np.array([0.5, 0.3]))
    np.testing.assert_allclose(found, [[math.cos(0.5) * math.exp(0.3), math.sin(0.5) * math.exp(0.3)]], rtol=1e-9)
    assert len(asked) <= 2 * 14


def test_a_constraint_of_a_body_knows_what_suits_it() -> None:
    """Complex steps where they are right, which is cheapest; else jets."""
    for way, by_complex in (("sqrt", True), ("norm", False)):
        body = pendulum(CIRCLES[way], 1.0).bodies["mass"]
        assert own_constraint(body, 0).slope.by_complex is by_complex


def test_values_that_do_not_move_at_the_start_keep_complex_steps() -> None:
    """A slope of zero was told as 1e-60, and taken for another one: derivatives came by jets, in seven times the time."""

    def spring(q: np.ndarray) -> np.ndarray:
        length = np.sqrt(q[0] ** 2 + q[1] ** 2)
        return np.array([(0.5 - length) / length * q[0], (0.5 - length) / length * q[1]])

    assert slopes_of(spring, np.array([0.0, 0.5])).by_complex


def test_forces_that_take_many_places_are_asked_for_slopes_in_one_call() -> None:
    """All complex steps are places of one call; the run is that of functions of one place."""
    asked: list[int] = []

    def pull(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        asked.append(q.size // 2)
        return np.array([-4.0 * q[0] * (q[0] ** 2 + q[1] ** 2), np.sin(q[0]) - 0.3 * v[1]])

    def run(*, vectorized: bool) -> fmbd.Run:
        asked.clear()
        scene = fmbd.Scene("pulled")
        body = scene.add(fmbd.CoordinateBody("mass", np.eye(2), pull, (0.0, 1.0), (1.0, 0.0), vectorized=vectorized))
        scene.sensor("q", fmbd.coordinates(body))
        return fmbd.solve(scene, t_end=1.0, dt=0.05)

    one, single = run(vectorized=False), len(asked)
    many = run(vectorized=True)
    np.testing.assert_allclose(many["q"], one["q"], rtol=1e-13, atol=1e-15)
    assert max(asked) == 4 and len(asked) < 0.5 * single


def test_a_row_that_holds_nothing_is_passed_over() -> None:
    """0 = 0 used to end in an error of NumPy's about an empty array."""
    scene = fmbd.Scene("free")
    weight = {"constraint": lambda q, t: [0 * q[0]]}
    body = scene.add(fmbd.CoordinateBody("mass", np.eye(2), lambda q, v, t: [0.0, -1.0], (0.0, 0.0), **weight))
    scene.sensor("q", fmbd.coordinates(body))
    assert fmbd.solve(scene, t_end=1.0, dt=0.1)["q"][-1, 1] == pytest.approx(-0.5)
