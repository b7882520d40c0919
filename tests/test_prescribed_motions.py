"""Prescribed motions along a run: jumps, kinks, rates that contradict the motion, drives that contradict each other."""

from __future__ import annotations

import logging
import math
from typing import Any

import numpy as np
import pytest
from chains import chain
from profiled import calls_of
from scipy.interpolate import CubicSpline, PchipInterpolator, make_interp_spline

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError, InputError
from fmbd_fenicsx.mechanics.joints.couplings import smooth_motion
from fmbd_fenicsx.run.judges.prescribed_motions import Follower


def followed(motion: Any, times: Any, length: float = 1.0) -> Follower:
    """A motion looked at at given times."""
    follower = Follower(smooth_motion("motor", motion), length)
    follower.look(np.asarray(times, float))
    return follower


def bar(*motions: Any, mass: float = 1.0, stops: Any = ()) -> fmbd.Scene:
    """A bar on a pin with drives on its angle."""
    body = fmbd.RigidBody("bar", mass, mass / 12, position=(0.5, 0.0))
    scene = fmbd.Scene("drives", gravity=(0.0, -9.81), breakpoints=stops)
    pin = fmbd.revolute("pin", fmbd.ground, body, center=(0.0, 0.0))
    scene.add(body, pin)
    for k, motion in enumerate(motions):
        scene.add(fmbd.drive(f"motor {k}", fmbd.angle(pin), motion))
    return scene


def driven(*motions: Any, scheme: Any = None, t_end: float = 1.0, stops: Any = ()) -> fmbd.Run:
    """A run of that bar."""
    return fmbd.solve(bar(*motions, stops=stops), t_end=t_end, dt=0.01 if scheme is None else None, scheme=scheme)


SMOOTH = {
    "sine": lambda t: np.sin(3 * t),
    "fast sine": lambda t: 1e-3 * np.sin(200 * t),
    "from rest": lambda t: t**4,
    "smooth step": lambda t: np.tanh((t - 0.4) / 0.02),
    "far and slow": lambda t: 1e4 + 1e-3 * t,
    "many turns": lambda t: 300 * t + 0.1 * np.sin(40 * t),
    "only real": lambda t: math.sin(5 * t),
    "with rates": lambda t: (math.sin(3 * t), 3 * math.cos(3 * t), -9 * math.sin(3 * t)),
    "parts of constant acceleration": lambda t: np.where(np.real(t) < 0.5, t**2, 0.25 + (t - 0.5)),
    "run-up with roundoff": lambda t: 30 * (t**2 / 2 + (np.cos(2 * np.pi * t) - 1) / (2 * np.pi) ** 2),
    "at rest": lambda t: 0.0 * t,
}
GRIDS = {
    "h = 0.01": np.linspace(0, 1, 101),
    "h = 3e-5": 1 + 3e-5 * np.arange(300),
    "growing": 1 - 0.8 ** np.arange(60),
    "h = 1e-4": 1e-4 * np.arange(60),
}


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_motions_are_left_alone(name: str, grid: str, caplog: Any) -> None:
    assert len(followed(SMOOTH[name], GRIDS[grid]).sharp) == 0
    assert not caplog.records


@pytest.mark.parametrize("at", [0.5, 0.5037, 0.507])
@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e5])
@pytest.mark.parametrize("h", [0.01, 0.07, 1e-4])
def test_a_kink_is_named_with_its_time(at: float, scale: float, h: float, caplog: Any) -> None:
    def kink(t: Any) -> float:
        return scale * (0.3 * t + max(t - at, 0.0))

    times = np.arange(0.5 - 8 * h, 0.5 + 8 * h, h) if h < 1e-3 else np.arange(0, 1, h)
    if not times[0] < at < times[-1]:
        times = times + at - 0.5
    found = followed(kink, times, scale)

    assert len(found.sharp) == 1
    assert 'drive "motor" has a kink at t = ' in caplog.text
    said = float(caplog.text.split("at t = ")[1].split(" s")[0])
    assert abs(said - at) < 1e-5 * at


def test_equal_steps_pass_over_a_kink_that_is_not_named(caplog: Any) -> None:
    """What they leave is of first order, in motions too, and a break point ends it; own steps end at the kink."""
    kink = lambda t: t + max(t - 0.1234, 0.0)
    advice = "error of first order in all motion behind it: name it, Scene(breakpoints=[0.1234])"
    driven(kink, t_end=0.3)
    assert advice in caplog.text
    caplog.clear()
    driven(kink, t_end=0.3, scheme=fmbd.Radau(2))
    assert "has a kink at t = 0.1234 s" in caplog.text and advice not in caplog.text
    caplog.clear()
    driven(kink, t_end=0.3, stops=(0.1234,))
    assert "kink" not in caplog.text


MOTIONS = {
    "kinks": lambda t: math.sin(3 * t) + 0.5 * max(t - 0.42, 0.0) - 0.5 * max(t - 0.44, 0.0) + 0.2 * max(t - 0.7, 0.0),
    "small jumps": lambda t: t + 1e-6 * (t > 0.3) + 1e-6 * (t > 0.315),
    "from rest, with rates": lambda t: (t**4, 4 * t**3, 12 * t**2),
}


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("calls", [101, 34, 7])
def test_many_places_are_looked_at_as_one_by_one(name: str, calls: int) -> None:
    together, alone = (Follower(smooth_motion("motor", MOTIONS[name]), 1.0) for _ in range(2))
    times = np.linspace(0, 1, 101)
    together.look(times)
    for some in np.array_split(times, calls):
        alone.look(some)
    for what in ("sharp", "looks", "worst", "fastest", "steps", "compared"):
        assert getattr(alone, what) == getattr(together, what), what
    for what in ("times", "places", "rates"):
        np.testing.assert_array_equal(getattr(alone, what), getattr(together, what))


def test_a_look_costs_little_more_than_the_motion() -> None:
    """Places are judged together: six functions tell the motion at one of them, and some two hundred more places are compared."""
    follower, times = Follower(smooth_motion("motor", SMOOTH["with rates"]), 1.0), np.linspace(0, 1, 1001)
    assert calls_of(lambda: follower.look(times)) < 9 * len(times)


def test_what_is_seen_before_a_motion_fails_is_told(caplog: Any) -> None:
    def ends(t: float) -> float:
        if t > 0.8:
            raise ValueError("no table")
        return max(t - 0.5, 0.0) + 0.3 * t

    with pytest.raises(InputError, match="no table"):
        followed(ends, np.linspace(0, 1, 101))
    assert "has a kink at t = 0.5 s" in caplog.text


def test_smooth_motions_are_looked_at_in_few_places() -> None:
    """A close look ends where slopes change by less than a kink: this one took 2 007 places with twenty halvings each."""
    asked: list[float] = []
    followed(lambda t: asked.append(t) or t**4, np.linspace(0, 1, 301))
    assert len(asked) < 1300


@pytest.mark.parametrize("share", [0.02, 0.1])
def test_a_slight_kink_of_a_motion_that_bends_is_found(share: float) -> None:
    found = followed(lambda t: math.sin(3 * t) + 3 * share * max(t - 0.42, 0.0), np.arange(0, 1, 0.003))
    assert len(found.sharp) == 1


@pytest.mark.parametrize("at", [0.5, 0.5037])
@pytest.mark.parametrize("h", [0.01, 0.13])
def test_a_jump_is_refused_and_a_small_one_warned_of(at: float, h: float, caplog: Any) -> None:
    times = np.arange(0, 1, h)
    with pytest.raises(InputError, match=r'drive "motor" jumps by 0.2 at t = 0.50?3?7? s'):
        followed(lambda t: t + 0.2 * (t >= at), times)
    assert len(followed(lambda t: 0.1 * t + 9e-4 * (t >= at), times).sharp) == 1
    assert "jumps by 0.0009" in caplog.text


@pytest.mark.parametrize("wrong", [lambda t: (t, 5.0, 0.0), lambda t: (t**2, 2 * t, 0.0), lambda t: (t, 1.01, 0.0)])
def test_rates_that_contradict_are_refused(wrong: Any) -> None:
    with pytest.raises(InputError, match=r"rate of drive \"motor\" contradicts"):
        followed(wrong, np.linspace(0, 1, 11))


def test_rates_that_are_wrong_later_are_refused() -> None:
    def motion(t: float) -> tuple[float, float, float]:
        return (t, 1.0, 0.0) if t < 0.77 else (t, 1.5, 0.0)

    followed(motion, np.linspace(0, 0.7, 71))
    with pytest.raises(InputError, match="rate of drive .* contradicts its motion"):
        followed(motion, np.linspace(0, 1, 101))


@pytest.mark.parametrize("scheme", [None, fmbd.Radau(3, rtol=1e-5)])
def test_two_drives_of_one_angle_that_part_are_named(scheme: Any) -> None:
    with pytest.raises(InputError, match=r'drives "motor 0" and "motor 1" .* joint "pin" and contradict'):
        driven(lambda t: t**2, lambda t: t**2 + t**4, scheme=scheme)


def test_two_drives_that_agree_run() -> None:
    run = driven(lambda t: np.sin(t) ** 3, lambda t: (3.0 * np.sin(t) - np.sin(3.0 * t)) / 4.0)
    assert run.drift[0] < 1e-9
    assert not run.warnings


@pytest.mark.parametrize("scheme", [None, fmbd.Radau(3, rtol=1e-5)])
def test_a_run_names_a_jump(scheme: Any) -> None:
    with pytest.raises(InputError, match='drive "motor 0" jumps by 1 at t = 0.35'):
        driven(lambda t: 0.0 if t < 0.35 else 1.0, scheme=scheme, t_end=0.5)


@pytest.mark.parametrize("power", [2, 3, 4])
def test_a_motion_that_begins_slowly_at_a_step_has_no_kink(power: int, caplog: Any) -> None:
    """A step that ends at 0.1 s but for rounding sees 1e-48 of what comes."""
    times = np.cumsum(np.full(300, 1e-3))
    found = followed(lambda t: 0.1 * max((t - 0.1) / 0.3, 0.0) ** power, times)
    assert len(found.sharp) == 0, caplog.text


def test_a_run_warns_of_a_kink_in_its_report_unless_it_is_stated() -> None:
    def kink(t: Any) -> Any:
        return np.where(np.real(t) < 0.5, 0.0, t - 0.5)

    run = driven(kink)
    assert "kink at t = 0.5 s, its rate changes from 0 to 1" in run.warnings[0]
    assert "look at this      the motion of drive" in run.report()
    assert not any("kink" in text for text in driven(kink, stops=(0.5,)).warnings)


def test_a_program_without_logging_sees_each_warning_once_in_a_run(monkeypatch: Any, capfd: Any) -> None:
    """Later runs are told anew, variants of one study together."""
    monkeypatch.setattr(logging.getLogger(), "handlers", [])

    def kink(t: float) -> float:
        return 0.1 * max(t - 0.4567, 0.0)

    for _ in range(2):
        driven(kink)
        assert capfd.readouterr().err.count("kink at t = 0.4567 s") == 1

    fmbd.study.map(lambda mass: bar(kink, mass=mass), [1.0, 2.0, 3.0], t_end=1.0, dt=0.01)
    assert capfd.readouterr().err.count("kink at t = 0.4567 s") == 1


@pytest.mark.parametrize(
    "scheme",
    [fmbd.Radau(3, rtol=1e-5), fmbd.BDF(rtol=1e-5), fmbd.HalfExplicit(rtol=1e-5), fmbd.GeneralizedAlpha(rtol=1e-4)],
    ids=lambda s: s.name,
)
def test_steps_of_a_schemes_own_choice_end_at_kinks(scheme: Any) -> None:
    """As at those that are stated: error control rejects up to fifty steps before one that nobody knows."""
    kinks = tuple(math.pi * k / 9 for k in (1, 2))

    def run(stops: Any) -> fmbd.Run:
        scene, _ = chain(2, breakpoints=stops)
        motion = lambda t: 0.1 * abs(math.sin(9 * float(t)))  # noqa: E731
        scene.add(fmbd.drive("motor", fmbd.angle(scene.joints["pin 0"]), motion))
        return fmbd.solve(scene, t_end=0.8, scheme=scheme)

    found, stated = run(()), run(kinks)
    assert sum("has a kink" in text for text in found.warnings) == len(kinks)
    for t in kinks:
        assert np.abs(found.times - t).min() < 1e-12
    assert found.counters["steps"] == stated.counters["steps"]
    assert found.counters["rejections"] == stated.counters["rejections"]
    assert found.state.q == pytest.approx(stated.state.q, abs=1e-9)


TIMES = np.linspace(0.0, 0.05, 11)
TABLE = CubicSpline(TIMES, TIMES**2)
SHORT = {
    "drive": lambda body, s: fmbd.drive("short", s, TABLE),
    "motor": lambda body, s: fmbd.motor("short", s, target=TABLE, kp=1.0),
    "effort": lambda body, s: fmbd.effort("short", s, make_interp_spline(TIMES, TIMES**2)),
    "force": lambda body, s: fmbd.force("short", body, CubicSpline(TIMES, np.stack((TIMES, TIMES), axis=1))),
}


@pytest.mark.parametrize("made", SHORT.values(), ids=SHORT)
def test_tables_that_end_before_the_run_are_told(made: Any) -> None:
    """An interpolation goes on with its last polynomial."""
    for t_end, told in ((0.05, False), (0.1, True)):
        scene = fmbd.Scene("tables")
        body = fmbd.RigidBody("body", 1.0, 1.0, position=(1.0, 0.0))
        hinge = fmbd.revolute("hinge", fmbd.ground, body, center=(0.0, 0.0))
        scene.add(body, hinge, made(body, fmbd.angle(hinge)))
        run = fmbd.solve(scene, t_end=t_end, dt=0.01)
        assert any('"short" goes from 0 to 0.05 s, the run from 0 to 0.1 s' in line for line in run.warnings) == told
        assert len(run.warnings) == told


RAMP = (0.25, 0.75)  # s


@pytest.mark.parametrize("scheme", [fmbd.GeneralizedAlpha(), fmbd.GeneralizedAlpha(form=fmbd.GGL())])
def test_accelerations_that_jump_are_told(scheme: Any) -> None:
    """A velocity that rises and falls in ramps: at a jump of 8 rad/s^2 the torque is off by that without break points."""

    def ramps(t: Any) -> Any:
        low, high = RAMP
        return 4.0 * (np.minimum(t, low) ** 2 + 2 * low * np.maximum(t - low, 0) - np.maximum(t - high, 0) ** 2)

    def run(motion: Any, stops: tuple[float, ...] = ()) -> tuple[float, list[str]]:
        arm = fmbd.RigidBody("arm", 1.0, 0.1, (0.5, 0.0))
        pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
        scene = fmbd.Scene("arm", breakpoints=stops)
        scene.add(arm, pin, fmbd.drive("ramps", fmbd.angle(pin), motion))
        scene.sensor("torque", fmbd.reaction("ramps"))
        found = fmbd.solve(scene, t_end=1.0, dt=0.01, scheme=scheme)
        due = -0.35 * 8.0 * np.where(found.times < RAMP[0], 1.0, np.where(found.times < RAMP[1], 0.0, -1.0))
        far = np.abs(found.times[:, None] - RAMP).min(axis=1) > 0.005
        return float(np.abs(found["torque"][:, 0] - due)[far].max()) / 2.8, [
            x for x in found.warnings if "acceleration of" in x
        ]

    off, said = run(ramps)
    assert off > 0.8 and len(said) == 1 and 'drive "ramps" jumps at t = 0.25, 0.75 s' in said[0]
    off, said = run(ramps, RAMP)
    assert off < 0.01 and not said

    # a table by cubics, smooth or not
    knots = np.linspace(0.0, 1.0, 11)
    assert not run(CubicSpline(knots, np.sin(5 * knots)))[1]
    assert "and 3 more" in run(PchipInterpolator(knots, np.sin(5 * knots)))[1][0]


def _asked_at_the_start(motion: Any) -> tuple[int, list[str]]:
    """How often a run of one step asks a drive's function, and what runs say of its acceleration."""
    times: list[Any] = []
    arm = fmbd.RigidBody("arm", 1.0, 0.1, (0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
    scene = fmbd.Scene("arm")
    scene.add(arm, pin, fmbd.drive("way", fmbd.angle(pin), lambda t: times.append(t) or motion(t)))
    times.clear()
    found = fmbd.solve(scene, t_end=1.0, dt=1.0)
    return len(times), [x for x in found.warnings if "acceleration of" in x]


def test_smooth_formulas_are_not_searched_for_jumps() -> None:
    """Sums, products and sines have none; a root that reaches zero has."""
    asked, said = _asked_at_the_start(lambda t: 0.1 * t**2 + np.sin(t) / 2)
    assert asked < 50 and not said
    _, said = _asked_at_the_start(lambda t: 0.1 * ((t - 0.5) * np.sqrt((t - 0.5) ** 2) + 0.25))
    assert "jumps at t = 0.5 s" in said[0]


def test_short_runs_ask_for_rates_in_few_places() -> None:
    """Those of a function that gives them: some of a step, and not all of the places of long runs; what jumps is found."""
    asked, said = _asked_at_the_start(lambda t: (0.3 * np.sin(t), 0.3 * np.cos(t), -0.3 * np.sin(t)))
    assert asked < 40 and not said
    late = 0.37
    asked, said = _asked_at_the_start(lambda t: (0.5 * max(t - late, 0.0) ** 2, max(t - late, 0.0), float(t > late)))
    assert asked < 110 and f"jumps at t = {late} s" in said[0]


@pytest.mark.parametrize(
    "scheme", [fmbd.GeneralizedAlpha(), fmbd.Radau(), fmbd.EnergyMomentum(), fmbd.schemes.Rattle()], ids=repr
)
def test_a_drive_beyond_the_reach_of_its_linkage_is_told(scheme: Any) -> None:
    """Two bars of 1 m are pulled straight after 0.5 s and cannot follow further."""
    one = fmbd.RigidBody("one", 1.0, 0.1, position=(0.25 * np.sqrt(3), 0.25))
    two = fmbd.RigidBody("two", 1.0, 0.1, position=(0.75 * np.sqrt(3), 0.25))
    knee = np.array([0.5 * np.sqrt(3), 0.5])
    scene = fmbd.Scene("reach")
    slide = fmbd.point_on_line("slide", fmbd.ground, two, center=(np.sqrt(3), 0), axis=(1, 0))
    scene.add(one, two, fmbd.revolute("pin", fmbd.ground, one, center=(0, 0)), slide)
    scene.add(fmbd.revolute("knee", one, two, center=knee))
    scene.add(fmbd.drive("pull", fmbd.displacement(slide), lambda t: (4.0 - 2.0 * np.sqrt(3)) * t))
    with pytest.raises(ConvergenceError, match=r"close to a singular one.*joints cannot follow"):
        fmbd.solve(scene, t_end=0.9, dt=6e-3, scheme=scheme)
