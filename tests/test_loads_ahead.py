"""Loads that come while nothing happens: steps of own choice end there, none passes over them, and what is stated is true."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dae_problems import torqued_links
from profiled import calls_of
from scipy.special import erf

import fmbd_fenicsx as fmbd

MESHES = Path(__file__).resolve().parents[1] / "meshes"
T_END, COMES, WIDTH, PUSH = 1.2, 0.5, 0.02, 3.0
TIMES = tuple(float(t) for t in np.linspace(0.0, T_END, 13))
OWN_STEPS = [fmbd.Radau(3, rtol=1e-5), fmbd.BDF(rtol=1e-5), fmbd.HalfExplicit(1e-5), fmbd.ExplicitRungeKutta(1e-5)]


def knocked(width: float = WIDTH) -> fmbd.Scene:
    """A body at rest on a guide is knocked for some hundredths of a second: m x'' = p / w exp(-((t - t_0) / w)^2)."""
    scene = fmbd.Scene("knocked")
    body = fmbd.RigidBody("body", 2.0, 0.1, (0.0, 0.0))
    scene.add(body, fmbd.prismatic("guide", fmbd.ground, body, axis=(1, 0), center=(0, 0)))
    scene.add(fmbd.force("knock", body, lambda t: (PUSH / width * np.exp(-(((t - COMES) / width) ** 2)), 0.0)))
    scene.sensor("place", fmbd.position(body))
    return scene


def gone(times: Any, width: float = WIDTH) -> Any:
    """How far the body is: the force integrated twice, from t = -infinity."""
    x = (np.asarray(times) - COMES) / width
    return 0.5 * PUSH / 2.0 * width * (np.sqrt(np.pi) * x * (1.0 + erf(x)) + np.exp(-x * x))


@pytest.mark.parametrize("scheme", OWN_STEPS, ids=lambda x: x.name)
def test_no_step_passes_over_a_knock(scheme: Any) -> None:
    """The whole run was one step, or five of BDF, with any tolerance: off by all that the body does, and BDF stated nothing."""
    run = fmbd.solve(knocked(), t_end=T_END, scheme=scheme, output=fmbd.Output(times=TIMES, estimate_error=True))
    exact = gone(run.times)
    off = float(np.abs(run["place"][:, 0] - exact).max())
    assert off < 1e-3 * np.ptp(exact)
    assert 0.5 < run.certificate["place"].total / off < 3.0


@pytest.mark.parametrize("scheme", OWN_STEPS[:2], ids=lambda x: x.name)
def test_a_tolerance_is_kept_where_a_knock_comes(scheme: Any) -> None:
    """A share of the range of a sensor that has not moved allows all: the first run was taken."""
    run = fmbd.solve(
        knocked(), t_end=T_END, scheme=scheme, output=fmbd.Output(times=TIMES), tol={"place": fmbd.relative(1e-4)}
    )
    exact = gone(run.times)
    assert run.history[-1].then == "done"
    assert np.abs(run["place"][:, 0] - exact).max() < 1e-4 * np.ptp(exact)


def test_a_knock_on_finite_elements_is_seen() -> None:
    """One step was made of it, too."""
    pytest.importorskip("dolfinx")
    from fmbd_fenicsx.materials import linear_elastic

    mesh = fmbd.read_gmsh(MESHES / "rod.py", dim=2, h=0.5, height=0.1)
    rod = fmbd.FloatingBody(
        "rod", mesh, degree=1, density=1000.0, elastic=linear_elastic(1e8, 0.3), stiffness_damping=1e-3
    )
    scene = fmbd.Scene("knocked rod")
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
    scene.add(fmbd.force("knock", rod.surface("tip"), lambda t: (0.0, 30.0 * np.exp(-(((t - 0.5) / 0.02) ** 2)))))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))

    ends = [
        fmbd.solve(scene, t_end=1.0, scheme=scheme, output=fmbd.Output(times=TIMES[:10]))["tip"][-1, 1]
        for scheme in (fmbd.Radau(2, rtol=1e-4), fmbd.GeneralizedAlpha(rtol=1e-5))
    ]
    assert ends[1] > 1e-3 and ends[0] == pytest.approx(ends[1], rel=2e-2)


def test_what_changes_all_the_time_has_no_marks() -> None:
    """Steps follow loads that never rest by their error alone: they are those of a run that does not look ahead."""
    from fmbd_fenicsx.run.loads_ahead import seeing_loads
    from fmbd_fenicsx.run.schedule import step_schedule

    def marks(law: Any) -> tuple[float, ...]:
        scene = fmbd.Scene("pushed")
        body = fmbd.RigidBody("body", 2.0, 0.1, (0.0, 0.0))
        scene.add(body, fmbd.force("push", body, lambda t: (law(t), 0.0)))
        system, state, _ = scene.build()
        scheme = OWN_STEPS[0]
        schedule = step_schedule(scene, scheme, T_END, None)
        return seeing_loads(schedule, scheme, scene, system, state).marks

    assert marks(lambda t: np.sin(9.0 * t)) == ()
    rises = marks(lambda t: max(t - 0.3, 0.0))
    assert len(rises) == 1 and 0.3 < rises[0] < 0.32


@pytest.mark.parametrize("scheme", [fmbd.Radau(3), fmbd.HalfExplicit()], ids=lambda x: x.name)
def test_steps_end_at_corners_of_loads_that_no_number_names(scheme: Any) -> None:
    """A torque that saturates: what its corners left within steps was chance, an eighth of the error was stated."""
    middle = 0.327

    def saturates(t: float) -> tuple[float, ...]:
        return (0, min(max(20.0 * (t - middle), -1.0), 1.5), 0)

    quiet, corners = fmbd.Output(progress=False, energy=False), (middle - 0.05, middle + 0.075)
    run = fmbd.solve(torqued_links(saturates), t_end=1.0, tol={"end": 1e-6}, scheme=scheme, output=quiet)
    for t in corners:
        assert np.abs(run.times - t).min() < 1e-12
    at = replace(quiet, times=tuple(run.times))
    exact = fmbd.solve(torqued_links(saturates, *corners), t_end=1.0, scheme=fmbd.Radau(5, rtol=1e-11), output=at)
    true = np.abs(run["end"] - exact["end"]).max()
    assert true < 1e-6 and 0.5 < run.certificate["end"].total / true < 3.0


def test_attempts_of_a_search_look_for_loads_once() -> None:
    """Runs with another tolerance begin in the same state: they know what comes. From another state it is looked for again."""
    from fmbd_fenicsx.run.loads_ahead import seeing_loads
    from fmbd_fenicsx.run.schedule import step_schedule

    asked: list[float] = []

    def knock(t: float) -> tuple[float, float]:
        asked.append(t)
        return float(np.exp(-(((t - COMES) / WIDTH) ** 2))), 0.0

    scene, body = fmbd.Scene("knocked"), fmbd.RigidBody("body", 2.0, 0.1, (0.0, 0.0))
    scene.add(body, fmbd.force("knock", body, knock))
    system, state, _ = scene.build()
    marks, counts = [], []
    for rtol, begun in ((1e-4, state), (1e-6, state), (1e-6, replace(state))):
        scheme, before = fmbd.HalfExplicit(rtol), len(asked)
        marks.append(seeing_loads(step_schedule(scene, scheme, T_END, None), scheme, scene, system, begun).marks)
        counts.append(len(asked) - before)
    assert marks[0] and marks[0] == marks[1] == marks[2]
    assert counts[0] > 100 and counts[1] == 0 and counts[2] > 100


def test_loads_may_begin_below_the_smallest_number() -> None:
    """exp(-x^2) begins with numbers that have lost their digits: no balance, and no linear solve, is as near to them as others.

    "The initial deformation is too large" was said of it, and that a body is not held.
    """
    run = fmbd.solve(knocked(0.01), t_end=T_END, scheme=fmbd.Radau(5, rtol=1e-9), output=fmbd.Output(times=TIMES))
    assert run["place"][-1, 0] == pytest.approx(gone(T_END, 0.01), rel=1e-6)


# -- loads that come and go between any instants at which they are looked at ----------------------------------------------
BEGINS, LASTS, SPRING = 1.8317, 1e-3, 80.0  # s, s, N/m: a three-thousandth of the run


def bump(begins: float, lasts: float) -> Any:
    """A force of 3 N s within so many seconds."""

    def push(t: float) -> tuple[float, float]:
        x = (t - begins) / lasts
        return (3.0 / lasts * 30.0 * (x * (1.0 - x)) ** 2 if 0.0 < x < 1.0 else 0.0), 0.0

    return push


def kicked(law: Any) -> fmbd.Scene:
    """A mass of 2 kg at rest on a spring."""
    scene = fmbd.Scene("kicked")
    body = fmbd.RigidBody("body", 2.0, 0.1, (0.0, 0.0))
    guide = fmbd.prismatic("guide", fmbd.ground, body, axis=(1, 0), center=(0, 0))
    scene.add(body, guide, fmbd.joint_spring("spring", fmbd.displacement(guide), stiffness=SPRING))
    scene.add(fmbd.force("knock", body, law))
    scene.sensor("place", fmbd.position(body))
    return scene


def vibrating(times: Any) -> Any:
    """After a knock in the middle of the given one, which it differs from by (w lasts)^2 / 56 of itself, 1e-6."""
    rate, t = np.sqrt(SPRING / 2.0), np.asarray(times) - BEGINS - 0.5 * LASTS
    return np.where(t > 0.5 * LASTS, 3.0 / 2.0 / rate * np.sin(rate * t), 0.0)


AFTER = tuple(float(t) for t in np.linspace(0.0, 3.0, 82) if abs(t - BEGINS) > 0.01)
SCHEMES = [None, fmbd.Rattle(), fmbd.HalfExplicit(), fmbd.GeneralizedAlpha(rtol=1e-4)]


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda x: getattr(x, "name", "default"))
def test_a_knock_is_seen_when_its_law_names_its_time(scheme: Any) -> None:
    """A hundred equal steps, and one of own choice, passed over it: 500 times the tolerance, and no error was stated."""
    run = fmbd.solve(
        kicked(bump(BEGINS, LASTS)), t_end=3.0, scheme=scheme, output=fmbd.Output(times=AFTER), tol={"place": 1e-3}
    )
    off = np.abs(run["place"][:, 0] - vibrating(run.times)).max()
    assert run.history[-1].then == "done" and off < 1e-3
    assert 0.5 < run.certificate["place"].total / off < 3.0 or off < 1e-5


@pytest.mark.parametrize("steps", [50, 213, 1000])
def test_equal_steps_that_pass_over_a_knock_state_it(steps: int) -> None:
    """Those with 2 h and 4 h do so, too, and stated nothing."""
    output = fmbd.Output(estimate_error=True, energy=False)
    run = fmbd.solve(kicked(bump(BEGINS, LASTS)), t_end=3.0, dt=3.0 / steps, output=output)
    off = np.abs(run["place"][:, 0] - vibrating(run.times)).max()
    assert off > 0.1 and 0.5 < run.certificate["place"].total / off < 3.0
    assert any("come and go" in x for x in run.warnings)


@pytest.mark.parametrize("scheme", [fmbd.Radau(5), fmbd.BDF(), fmbd.HalfExplicit()], ids=lambda x: x.name)
def test_knocks_that_come_again_are_seen(scheme: Any) -> None:
    """All but the first of 3 ms each 0.7 s were passed over: 2e5 tolerances, of which BDF stated nothing."""
    times = np.array([1.0, 1.5, 2.0])
    scene = kicked(lambda t: (300.0 if 0.51 < t % 0.7 < 0.513 else 0.0, 0.0))
    place = fmbd.solve(scene, t_end=2.0, scheme=scheme, output=fmbd.Output(times=times))["place"][:, 0]
    rate, begins = np.sqrt(SPRING / 2.0), 0.51 + 0.7 * np.arange(3)[:, None]
    rest, push = (np.cos(rate * np.maximum(times - begins - late, 0.0)) for late in (0.0, 0.003))
    exact = 300.0 / SPRING * (push - rest).sum(axis=0)
    assert np.abs(place - exact).max() < 1e-2 * np.abs(exact).max()


def test_what_functions_of_time_name() -> None:
    """Numbers in the text, in what is around it, as attributes, defaults, columns; their sums and the middles between them."""
    from functools import partial

    from scipy.interpolate import CubicSpline

    from fmbd_fenicsx.run.named_times import named_times

    class Pulse:
        def __init__(self) -> None:
            self.when = {"begin": 1.2, "width": 0.04}

        def __call__(self, t: float) -> tuple[float, float]:
            return float(abs(t - self.when["begin"]) < self.when["width"]), 0.0

    column = np.array([0.0, 0.71, 0.72, 0.73, 3.0])
    spline = CubicSpline(column, np.zeros((5, 2)))
    assert {1.8317, 1.8317 + 1e-3} <= set(named_times(kicked(bump(BEGINS, LASTS)), 0.0, 3.0))
    assert {1.2, 1.24, 1.16} <= set(named_times(kicked(Pulse()), 0.0, 3.0).round(12))
    comes_again = kicked(lambda t: (30.0 if 0.51 < t % 0.7 < 0.513 else 0.0, 0.0))
    assert {0.51, 0.513, 1.21, 1.213, 1.91, 1.913, 2.61, 2.613} <= set(named_times(comes_again, 0.0, 3.0).round(12))
    for law in (
        lambda t: (np.interp(t, column, column), 0.0),
        spline,
        partial(lambda column, t: (column[0], 0.0), column),
        lambda t, at=column: (at[0], 0.0),
    ):
        assert {0.71, 0.72, 0.73} <= set(named_times(kicked(law), 0.0, 3.0))
    assert len(named_times(kicked(lambda t: (5.0 * np.sin(7.0 * t), 0.0)), 0.0, 3.0)) == 0

    # names are read, instructions are not: some hundred calls, not thousands
    scene = kicked(bump(BEGINS, LASTS))
    assert calls_of(lambda: named_times(scene, 0.0, 3.0)) < 300


def test_a_column_that_never_rests_has_no_marks() -> None:
    """A record of an earthquake names thousands of instants: steps are small everywhere by their error."""
    from fmbd_fenicsx.run.loads_ahead import loads_ahead, seeing_loads
    from fmbd_fenicsx.run.schedule import step_schedule

    when, shaken = np.linspace(0.0, 3.0, 801), np.random.default_rng(1).normal(size=801)
    scene = kicked(lambda t: (np.interp(t, when, shaken), 0.0))
    system, state, _ = scene.build()
    own = step_schedule(scene, SCHEMES[2], 3.0, None)
    assert len(seeing_loads(own, SCHEMES[2], scene, system, state).marks) == 0
    assert len(loads_ahead(scene, fmbd.Rattle(), system, state, step_schedule(scene, fmbd.Rattle(), 3.0, 0.03))) == 0


def test_a_share_of_what_does_not_move_is_no_tolerance() -> None:
    """It allows any error: the call says so."""
    run = fmbd.solve(kicked(lambda t: (0.0, 0.0)), t_end=1.0, tol={"place": fmbd.relative(1e-3)})
    assert any("does not move" in x for x in run.warnings)


def test_searches_see_knocks_on_finite_elements() -> None:
    """They were passed over by all attempts: the tip moved by 7e-18 m."""
    pytest.importorskip("dolfinx")
    from fmbd_fenicsx.materials import linear_elastic

    mesh = fmbd.read_gmsh(MESHES / "rod.py", dim=2, h=0.5, height=0.1)
    rod = fmbd.FloatingBody(
        "rod", mesh, degree=1, density=1000.0, elastic=linear_elastic(1e8, 0.3), stiffness_damping=1e-3
    )
    scene, push = fmbd.Scene("knocked rod"), bump(0.5037, LASTS)
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
    scene.add(fmbd.force("knock", rod.surface("tip"), lambda t: push(t)[::-1]))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    run = fmbd.solve(scene, t_end=1.0, tol={"tip": fmbd.relative(3e-2)}, output=fmbd.Output(times=TIMES[:10]))
    # 3 N s at the tip of a rod of 100 kg that turns about its pin
    assert run.history[-1].then == "done" and run["tip"][-1, 1] == pytest.approx(0.09 * (0.9 - 0.5042), rel=0.05)


@pytest.mark.parametrize(("name", "k", "surface"), [("rod", 0, "end"), ("elastic pendulum", 1, "tip")])
def test_knocks_are_looked_for_behind_looks_at_spaces(name: str, k: int, surface: str) -> None:
    """Loads are asked at the first whole run, which a look at meshes that are too coarse comes before."""
    pytest.importorskip("dolfinx")
    from tolerance_scenes import CASES

    case = CASES[name]
    scene, knock = case.scene(), bump(0.3037, LASTS)
    (body,) = scene.bodies.values()
    up = np.eye(body.dim)[-1]
    scene.add(fmbd.force("knock", body.surface(surface), lambda t: tuple(knock(t)[0] * up)))
    run = fmbd.solve(scene, t_end=case.t_end, tol={case.sensor: case.tolerances[k]}, output=fmbd.Output(progress=False))
    assert run.history[0].then == "finer meshes"
    assert any("where loads jump: 0.30" in x.then for x in run.history)
