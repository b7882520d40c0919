"""Derivatives of functions of time: exact through NumPy's functions, and of any time scale through all others."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from profiled import calls_of
from scipy.interpolate import CubicSpline, interp1d

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import FmbdError
from fmbd_fenicsx.mechanics.joints.couplings import smooth_motion
from fmbd_fenicsx.mechanics.kinds import time_derivatives
from fmbd_fenicsx.mechanics.kinds.time_derivatives import SmoothIntervals, TimeFormula, rates

SIZES, SPEEDS = np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0])


def leg(t: float) -> float:
    """Of the law "length"."""
    return math.hypot(3 * t, 4 * t - 5)


def root(t: float) -> float:
    """Of the inverse functions of 0.3 t."""
    return math.sqrt(1 - 0.09 * t * t)


LAWS: dict[str, tuple[Callable[[Any], Any], Callable[[float], tuple[float, float]]]] = {
    "powers": (lambda t: 3 * t**3 - t**2 / 4 + 1, lambda t: (9 * t**2 - t / 2, 18 * t - 0.5)),
    "quotient": (lambda t: 1 / (1 + t**2), lambda t: (-2 * t / (1 + t**2) ** 2, (6 * t**2 - 2) / (1 + t**2) ** 3)),
    "wave": (lambda t: 0.3 * np.sin(40 * t + 1), lambda t: (12 * np.cos(40 * t + 1), -480 * np.sin(40 * t + 1))),
    "nested": (
        lambda t: np.exp(-np.sqrt(1 + t) * np.tanh(t)) - 2.0**t,
        lambda t: derivatives_of_nested(t),
    ),
    "pieces": (lambda t: t**3 if t > 0.1 else 0.0 * t, lambda t: (3 * t**2, 6 * t) if t > 0.1 else (0.0, 0.0)),
    "where": (lambda t: np.where(t < 0.1, 0.0, (t - 0.1) ** 3), lambda t: (3 * max(t - 0.1, 0) ** 2, 6 * max(t - 0.1, 0))),
    "clipped": (lambda t: np.clip(t, 0.0, 0.2) ** 2 + abs(-t), lambda t: (2 * t + 1, 2.0) if t < 0.2 else (1.0, 0.0)),
    "series": (
        lambda t: SIZES @ np.sin(SPEEDS * t) + np.sum(t * SPEEDS) + np.where(t > SPEEDS, 1.0, t)[2],
        lambda t: (
            float(SIZES * SPEEDS @ np.cos(SPEEDS * t)) + 6.0 + (t <= 3.0),
            -float(SIZES * SPEEDS**2 @ np.sin(SPEEDS * t)),
        ),
    ),
    "length": (
        lambda t: np.linalg.norm(np.stack([3 * t, 4 * t]) @ np.eye(2) - np.array([0.0, 5.0])),
        lambda t: ((25 * t - 20) / leg(t), 25 / leg(t) - (25 * t - 20) ** 2 / leg(t) ** 3),
    ),
    "cross product": (lambda t: np.cross([t, 0, t**2], [1.0, t, 0.0])[2], lambda t: (2 * t, 2.0)),
    "direction": (lambda t: np.arctan2(np.sin(2 * t), np.cos(2 * t)) + np.arccos(0.0 * t), lambda t: (2.0, 0.0)),
    "inverse functions": (
        lambda t: np.arcsin(0.3 * t) - 2 * np.arccos(0.3 * t) + np.log10(t),
        lambda t: (0.9 / root(t) + 1 / (t * math.log(10)), 0.081 * t / root(t) ** 3 - 1 / (t * t * math.log(10))),
    ),
    "polynomial": (lambda t: np.polyval([1, 2, 3], t), lambda t: (2 * t + 2, 2.0)),
    "table": (
        lambda t: np.interp(t**2, [0.0, 0.05, 1.0], [1.0, 2.0, 0.0]),
        lambda t: (40 * t, 40.0) if t < 0.2 else (-80 * t / 19, -80 / 19) if t < 1.0 else (0.0, 0.0),
    ),
    "constant": (lambda t: 2.0, lambda t: (0.0, 0.0)),
}  # fmt: skip


def derivatives_of_nested(t: float) -> tuple[float, float]:
    """With g = sqrt(1 + t) tanh t."""
    r, y = math.sqrt(1 + t), math.tanh(t)
    s = 1 - y * y
    g1, g2 = y / (2 * r) + r * s, -y / (4 * r**3) + s / r - 2 * r * y * s
    e, k = math.exp(-r * y), math.log(2.0)
    return -g1 * e - k * 2**t, (g1**2 - g2) * e - k * k * 2**t


@pytest.mark.parametrize("name", LAWS)
def test_exact_through_functions_of_numpy(name: str) -> None:
    law, exact = LAWS[name]
    for t in (0.05, 0.17, 0.31, 3.0):
        np.testing.assert_allclose(rates(law, t), exact(t), rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize(
    "t, forth, back", [(-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.5, 1.0, 1.0), (1.0, -2.0, 1.0), (2.0, 0.0, -2.0)]
)
def test_a_table_has_the_slope_of_the_side_ahead(t: float, forth: float, back: float) -> None:
    """In one call of it: differences were 60 about each of its places."""
    asked = []
    table = lambda x: (asked.append(x), np.interp(x, (0.0, 1.0, 2.0), [0.0, 1.0, -1.0]))[1]
    assert rates(table, t) == (forth, 0.0)
    assert rates(lambda s: table(t - (s - 3.0)), 3.0) == (-back, 0.0)
    assert len(asked) == 2


@pytest.mark.parametrize("name", LAWS)
def test_what_a_formula_says_is_exact(name: str) -> None:
    """Cases write none: only what holds at all times does."""
    law, exact = LAWS[name]
    formula = TimeFormula.of(law)
    none = "nested", "pieces", "where", "clipped", "series", "table"
    assert (formula is None) == (name in none)
    for t in (0.05, 0.17, 0.31, 3.0) if formula is not None else ():
        np.testing.assert_allclose(formula.rates(t, float(law(t))), exact(t), rtol=1e-13, atol=1e-13)


def test_a_formula_is_asked_where_the_function_says_the_same() -> None:
    """A number in it that changes later is seen; a time takes a dozen calls of Python, by numbers with derivatives 60."""
    size = [1.0]
    motion = smooth_motion("m", lambda t: size[0] * np.sin(3.0 * t) + np.sqrt(1.0 + t * t) ** 3)
    for k in (1.0, 2.0):
        size[0] = k
        root = np.sqrt(1.49)
        exact = (
            k * np.sin(2.1) + root**3,
            3 * k * np.cos(2.1) + 2.1 * root,
            -9 * k * np.sin(2.1) + 3 * root + 1.47 / root,
        )
        assert motion(0.7) == pytest.approx(exact, rel=1e-13)
        assert (calls_of(lambda: motion(0.7)) < 16) == (k == 1.0)


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1.0, 1e3])
def test_other_functions_in_any_time_scale(scale: float) -> None:
    """Of the module math, at the start and later; whole periods between the places looked at are no rest."""
    for omega in (1.0, 2 * np.pi, 0.1):
        w = omega / scale
        for t in (0.0, 0.3 * scale, 5.0 * scale):
            first, second = rates(lambda x, w=w: math.sin(w * x), t)
            assert first == pytest.approx(w * np.cos(w * t), rel=2e-9, abs=2e-9 * w)
            assert second == pytest.approx(-w * w * np.sin(w * t), rel=2e-7, abs=2e-7 * w * w)


def test_a_table_between_its_knots() -> None:
    """A spline has the derivatives of its piece; differences do not look across knots that change them."""
    knots = np.linspace(0.0, 1.0, 11)
    spline = CubicSpline(knots, np.sin(3 * knots))
    for t in (0.05, 0.52, 0.97):
        first, second = rates(spline, t)
        assert first == pytest.approx(float(spline(t, 1)), rel=1e-6)
        assert second == pytest.approx(float(spline(t, 2)), rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("outside", [math.nan, "raises"])
def test_a_function_of_a_part_of_the_time(outside: Any) -> None:
    """At the ends of a table differences look to the inner side."""

    def table(t: float) -> float:
        if 0.0 <= t <= 1.0:
            return math.sin(3 * t)
        if outside == "raises":
            raise IndexError("not in the table")
        return float(outside)

    for t in (0.0, 1e-9, 0.3, 1.0 - 1e-6, 1.0):
        first, second = rates(fmbd.errors.named("The", "table", table), t)
        assert first == pytest.approx(3 * math.cos(3 * t), rel=1e-7)
        assert second == pytest.approx(-9 * math.sin(3 * t), rel=1e-4, abs=1e-4)


def test_differences_stop_where_they_disagree() -> None:
    """Steps that are longer than those which count are not tried."""
    asked: list[float] = []
    rates(lambda t: asked.append(float(t)) or math.sin(float(t)), 0.3)
    assert max(asked) < 100.0


@pytest.mark.parametrize("places", [(0.0, 0.6, -0.2, 1.0), (1.0, 1.0, 2.0, 2.0)])
def test_rates_of_a_table_of_straight_lines(places: tuple[float, ...]) -> None:
    """At its first time they are those behind it. Across a kink formulas of s'' agree by chance: 11 1/s^2 were found beside 0."""
    times = (0.0, 0.3, 0.7, 1.0)
    slopes = np.diff(places) / np.diff(times)
    inside = np.concatenate([[0.0], np.linspace(0.001, 0.299, 150), np.linspace(0.302, 0.698, 99)])
    kept = SmoothIntervals()
    law = lambda t: float(np.interp(t, times, places))
    found = np.array([kept.rates(law, t, law(t)) for t in inside])
    assert np.allclose(found[:, 0], slopes[np.searchsorted(times, inside, "right") - 1], rtol=0, atol=1e-9)
    assert np.abs(found[:, 1]).max() < 1e-7


@pytest.mark.parametrize(
    ("law", "exact"),
    [
        (lambda u: 2.0 * abs(u), lambda u: (math.copysign(2.0, u), 0.0)),
        (lambda u: abs(math.sin(u)), lambda u: (math.copysign(math.cos(u), u), -abs(math.sin(u)))),
    ],
)
def test_beside_a_kink_no_longer_steps_are_tried_than_the_rate_bears(law: Any, exact: Any) -> None:
    """A run of its own steps creeps up to a kink that nobody named: all steps of differences were 120 values at each time."""
    asked, kink = 0, 0.2

    def counted(t: Any) -> float:
        nonlocal asked
        asked += 1
        return float(law(float(t) - kink))

    for apart in np.geomspace(1e-5, 1e-2, 10):
        for t in (kink - apart, kink + apart):
            asked = 0
            assert rates(counted, t) == pytest.approx(exact(t - kink), abs=1e-15 / apart**2 + 1e-6)
            assert asked < 90


def test_a_side_that_is_another_function_is_not_asked() -> None:
    """Steps that are too long for the smooth side ahead of t = 0 went to the constant one behind."""
    for times, places in (([0.0, 0.3, 1.0], [0.0, 0.6, 0.0]), ([0.0, 0.4, 0.8, 1.2], [1.0, 0.8, 0.9, 0.9])):
        kept = SmoothIntervals()
        kept.break_at(times[1:-1])
        for t in (0.0, 1e-7, 1e-3, times[1] * (1.0 - 1e-15)):
            law = partial(np.interp, xp=times, fp=places)
            first, second = kept.rates(law, t, law(t))
            assert first == pytest.approx((places[1] - places[0]) / times[1], abs=1e-9) and abs(second) < 1e-5


def test_differences_make_no_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    """Six numbers are summed at each of some fifteen steps: arrays of them took five times as long as the function itself."""
    monkeypatch.setattr(time_derivatives, "np", None)
    first, second = rates(lambda t: math.sin(float(t)), 0.3)
    assert first == pytest.approx(math.cos(0.3), rel=1e-11) and second == pytest.approx(-math.sin(0.3), rel=1e-8)


@pytest.mark.parametrize("element", [fmbd.drive, partial(fmbd.motor, kp=1e5, kd=1e3)])
def test_a_table_as_long_as_the_run(element: Any) -> None:
    """A drive and a motor follow a table of the times of the run, at which it begins and ends."""
    times = np.linspace(0.0, 1.0, 101)
    table = interp1d(times, 0.3 * (1 - np.cos(3 * times)), kind="cubic")  # refuses times before 0 and after 1
    body = fmbd.RigidBody("arm", 1.0, 0.1)
    pin = fmbd.revolute("pin", fmbd.ground, body, center=(0, 0))
    scene = fmbd.Scene("arm")
    key = "motion" if element is fmbd.drive else "target"
    scene.add(body, pin, element("m", fmbd.angle(pin), **{key: table}))
    scene.sensor("angle", fmbd.angle(pin))
    run = fmbd.solve(scene, t_end=1.0, dt=1e-2)
    # the last step ends behind the table by roundoff, the run does not
    assert np.cumsum(np.full(100, 1e-2))[-1] > 1.0 == run.times[-1]
    np.testing.assert_allclose(run["angle"][:, 0], 0.3 * (1 - np.cos(3 * run.times)), atol=2e-4)


@pytest.mark.parametrize("sine", [np.sin, math.sin])
def test_a_drive_of_a_microsecond(sine: Any) -> None:
    """A resonator of 100 kHz: the drive's torque is that of its own acceleration."""
    omega, size = 2 * np.pi * 1e5, 1e-3
    body = fmbd.RigidBody("arm", 1e-9, 1e-18)
    pin = fmbd.revolute("pin", fmbd.ground, body, center=(0, 0))
    scene = fmbd.Scene("resonator")
    scene.add(body, pin, fmbd.drive("drive", fmbd.angle(pin), lambda t: size * (omega * t - sine(omega * t)) ** 1))
    scene.sensor("torque", fmbd.reaction("drive"))
    run = fmbd.solve(scene, t_end=1e-5, dt=1e-7)
    exact = -1e-18 * size * omega**2 * np.sin(omega * run.times)
    assert np.abs(run["torque"][:, 0] - exact).max() < 1e-3 * np.abs(exact).max()


@pytest.mark.parametrize(
    ("scheme", "end", "steps"),
    [(fmbd.GeneralizedAlpha(), 2.1, 30), (fmbd.GeneralizedAlpha(), 10.0, 20_000), (fmbd.Radau(rtol=None), 2.1, 30)],
)
@pytest.mark.parametrize("refuses", [True, False])
def test_loads_from_tables_as_long_as_the_run(scheme: Any, end: float, steps: int, refuses: bool) -> None:
    """Sums of steps lie roundings behind the end: the load is that of the end there. Behind it, a table ends the run."""
    times = np.linspace(0.0, end, 50)
    values = np.stack((np.sin(times), np.cos(times)), axis=-1)
    table: Any = interp1d(times, values, axis=0) if refuses else CubicSpline(times, values, extrapolate=False)

    def run(t_end: float) -> fmbd.Run:
        scene = fmbd.Scene("push")
        body = fmbd.RigidBody("body", 1.0, 0.1)
        scene.add(body, fmbd.force("push", body, table))
        return fmbd.solve(scene, t_end=t_end, dt=t_end / steps, scheme=scheme, output=fmbd.Output(every=steps))

    assert np.cumsum(np.full(steps, end / steps))[-1] > end == run(end).times[-1]
    with pytest.raises(FmbdError, match='"push"'):
        run(end * 1.001)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_polynomials_serve_an_interval(scale: float) -> None:
    """A smooth function, a smooth start and a kink: two values a time or so, in place of ninety by all steps of differences."""
    for law, exact in (
        (lambda x: math.sin(3.0 * x), lambda x: (3.0 * math.cos(3.0 * x), -9.0 * math.sin(3.0 * x))),
        (
            lambda x: 0.0 if x < 0.5 else (x - 0.5) ** 3,
            lambda x: (3.0 * max(x - 0.5, 0.0) ** 2, 6.0 * max(x - 0.5, 0.0)),
        ),
        (lambda x: x**4 if x < 1.0 else 4.0 * x - 3.0, lambda x: (4.0 * x**3, 12.0 * x * x) if x < 1.0 else (4.0, 0.0)),
    ):
        calls = 0

        def asked(t: Any, law: Any = law) -> float:
            nonlocal calls
            calls += 1
            return float(law(float(t) / scale))

        kept, times = SmoothIntervals(), np.arange(1, 2000, 2) * 1e-3
        found = np.array([kept.rates(asked, t, law(t / scale)) for t in times * scale])
        assert calls < 3 * len(times)
        expected = np.array([exact(x) for x in times])
        errors = np.abs(found * (scale, scale**2) - expected).max(axis=0)
        assert (errors <= np.abs(expected).max(axis=0) * (1e-11, 1e-8)).all()


def test_what_is_found_does_not_depend_on_what_was_asked_before() -> None:
    times = [0.013 * k for k in range(300)]
    law = lambda t: math.sin(3 * float(t)) + math.exp(-(((float(t) - 2) / 0.01) ** 2))
    forth, back = SmoothIntervals(), SmoothIntervals()
    ahead = [forth.rates(law, t, law(t)) for t in times]
    assert ahead == [back.rates(law, t, law(t)) for t in reversed(times)][::-1]


def test_a_motor_with_a_target_of_plain_numbers_asks_it_seldom() -> None:
    calls = 0

    def target(t: float) -> float:
        nonlocal calls
        calls += 1
        return 0.3 * math.sin(2 * t)

    arm = fmbd.RigidBody("arm", 1.0, 0.1, (0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
    scene = fmbd.Scene("arm")
    scene.add(arm, pin, fmbd.motor("motor", fmbd.angle(pin), target=target, kp=100.0, kd=5.0))
    fmbd.solve(scene, t_end=1.0, dt=1e-3)
    assert calls < 25 * 1000  # 85 a step by all steps of differences


def of_terms_that_cancel(t: float) -> float:
    """A way from rest as inverse kinematics give it: the difference of two lengths, whose roundoff its value does not tell."""
    u = min(t / 0.5, 1.0)
    moved = u**3 * (10 - 15 * u + 6 * u * u)
    return float(np.linalg.norm(np.array([1.0, moved, 0.2]))) - float(np.linalg.norm([1.0, 0.2]))


def test_terms_that_cancel() -> None:
    """Both rates, at most forty values a time; differences over long steps are the reference."""
    calls, kept, h = 0, SmoothIntervals(), 2e-3

    def counted(t: float) -> float:
        nonlocal calls
        calls += 1
        return of_terms_that_cancel(float(t))

    times = np.arange(0.03, 0.48, 2e-3)
    found = np.array([kept.rates(counted, t, of_terms_that_cancel(t)) for t in times])
    s = np.array([[of_terms_that_cancel(t + k * h) for k in range(-3, 4)] for t in times])
    first = s @ np.array([-1, 9, -45, 0, 45, -9, 1]) / (60 * h)
    second = s @ np.array([2, -27, 270, -490, 270, -27, 2]) / (180 * h * h)
    assert np.allclose(found[:, 0], first, atol=1e-9)
    assert np.allclose(found[:, 1], second, atol=1e-6)
    assert calls < 40 * len(times)


def test_a_table_is_asked_for_many_times_by_one_call() -> None:
    """Where it takes arrays, and nothing else; rates are those that numbers give, to the last bit."""
    at, s = np.linspace(0.0, 1.0, 11), np.array([0.0, 3.0, 4.0, 3.0, 1.0, 0.0, 0.0, 1.0, 2.0, 2.0, 2.0])
    calls = 0

    def table(t: Any) -> Any:
        nonlocal calls
        calls += 1
        return np.interp(np.asarray(t, dtype=float), at, s)

    times = [0.00123 * k for k in range(1, 800)]
    kept = SmoothIntervals()
    together = [kept.rates(table, t, table(t)) for t in times]
    by_arrays, calls, kept = calls, 0, SmoothIntervals()
    assert together == [kept.rates(lambda t: float(table(t)), t, table(t)) for t in times]
    assert by_arrays < 0.35 * calls


def test_a_function_that_takes_arrays_for_something_else_is_asked_for_numbers() -> None:
    """As one that reads the largest of them."""
    law = lambda t: float(t) ** 2 if np.ndim(t) == 0 else np.full(np.shape(t), np.max(t)) ** 2
    kept = SmoothIntervals()
    found = np.array([kept.rates(law, 0.1 * k, law(0.1 * k)) for k in range(1, 20)])
    assert kept.takes_arrays is False
    assert found == pytest.approx(np.array([(0.2 * k, 2.0) for k in range(1, 20)]), rel=1e-5)


def of_plain_numbers(t: float) -> float:
    """With a kink at every tenth of a second."""
    return abs(math.sin(10 * math.pi * float(t))) + 0.1 * float(t) ** 2


def test_polynomials_serve_many_times() -> None:
    """Both rates are nearly exact at seven values a time, and do not depend on what was asked before."""
    calls, times = 0, [0.0007 + 1e-3 * k for k in range(500)]

    def counted(t: Any) -> float:
        nonlocal calls
        calls += 1
        return of_plain_numbers(t)

    def found(times: list[float]) -> dict[float, Any]:
        kept = SmoothIntervals()
        return {t: kept.by_polynomial(counted, t, of_plain_numbers(t)) for t in times}

    ahead = found(times)
    assert calls < 8 * len(times)
    assert ahead == found(times[::-1])

    known = {t: rate for t, rate in ahead.items() if rate is not None}
    assert len(known) > 0.98 * len(times)
    t, w = np.array(list(known)), 10 * math.pi
    side = np.sign(np.sin(w * t))
    exact = np.stack((side * w * np.cos(w * t) + 0.2 * t, -side * w * w * np.sin(w * t) + 0.2), axis=1)
    assert (np.abs(np.array(list(known.values())) - exact).max(axis=0) < (1e-8, 1e-6)).all()


def test_a_polynomial_does_not_serve_where_it_has_missed_something() -> None:
    """A pulse between the values that it was made of; at a break it is what it is behind it."""
    law = lambda t: 0.3 * float(t) + (1e-3 if 0.505 < float(t) < 0.506 else 0.0)
    kept = SmoothIntervals()
    assert kept.by_polynomial(law, 0.4, law(0.4)) == pytest.approx((0.3, 0.0))
    assert kept.by_polynomial(law, 0.5055, law(0.5055)) is None

    bent, kept = lambda t: max(float(t) - 0.25, 0.0), SmoothIntervals()
    kept.break_at([0.25])
    assert kept.by_polynomial(bent, 0.25, 0.0) == pytest.approx((1.0, 0.0))
    assert kept.by_polynomial(bent, 0.2499, 0.0) == pytest.approx((0.0, 0.0))
