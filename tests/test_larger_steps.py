"""Runs whose steps are two or four of another run's own in one tell its error, where no kink makes it chance."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from chains import chain
from dae_problems import pendulum, torqued_links
from scipy.integrate import solve_ivp
from tolerance_scenes import MESHES, elastic_pendulum, geared_chain, rise

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError
from fmbd_fenicsx.linear.frequency_solvers import SETTLED
from fmbd_fenicsx.materials import linear_elastic
from fmbd_fenicsx.run.accuracy import companion_runs, larger_steps
from fmbd_fenicsx.run.accuracy.deviation import Deviation, unresolved
from fmbd_fenicsx.run.accuracy.equal_steps import compare_steps
from fmbd_fenicsx.run.accuracy.larger_steps import in_one, larger_steps_error, two_in_one, with_larger_steps
from fmbd_fenicsx.run.accuracy.search.shares import Allowed
from fmbd_fenicsx.run.built import build
from fmbd_fenicsx.run.recording.output import Output
from fmbd_fenicsx.run.schedule import step_schedule
from fmbd_fenicsx.run.single_run import Solved, Task, run_once
from fmbd_fenicsx.schemes.control import StepControl
from fmbd_fenicsx.schemes.marching import MarchingStepper
from fmbd_fenicsx.schemes.newton import Newton
from fmbd_fenicsx.schemes.onestep.radau import RadauStepper


def made_by(scheme: Any, scene: fmbd.Scene) -> Solved:
    """A run to 1 s with steps of the scheme's own choice, recorded at their ends."""
    schedule = step_schedule(scene, scheme, 1.0, None)
    return run_once(Task(scene, scheme, schedule, Newton(), None, Output(progress=False)), build(scene))


def light_rod() -> fmbd.Scene:
    """A rod that hangs from a ball joint and is pushed sideways."""
    section = fmbd.RodSection((2e5, 8e4, 8e4, 10.0, 14.0, 14.0), 0.9, (1e-3, 5e-4, 5e-4))
    rod = fmbd.Rod("rod", [(0, 0, 0), (1.5, 0, 0)], section, elements=2, degree=1)
    scene = fmbd.Scene("rod", gravity=(0, 0, -9.81), gravity_ramp=0.3)
    ball = fmbd.spherical("ball", fmbd.ground, rod.surface("start"), center=(0, 0, 0))
    scene.add(rod, ball, fmbd.force("push", rod.surface("end"), lambda t: (0, 3.0 * t * t, 0)))
    scene.sensor("end", fmbd.position(rod.surface("end")))
    return scene


@pytest.mark.parametrize("scheme", [fmbd.Radau(3), fmbd.HalfExplicit()])
def test_steps_that_all_end_at_samples_are_not_made_larger(scheme: Any) -> None:
    """A sampled controller holds every step: two in one were the same steps, whose ratio of one divided by zero."""
    body = fmbd.RigidBody("slider", 1.0, 1.0, (0.0, 0.0))
    rail = fmbd.prismatic("rail", fmbd.ground, body, axis=(1, 0), center=(0, 0))
    s = fmbd.displacement(rail)
    law = {"acts": s, "law": lambda t, y, z: (4.0 * np.sin(2.0 * t) - 40.0 * y["s"][0], ()), "every": 0.013}
    scene = fmbd.Scene("sampled")
    scene.add(body, rail, fmbd.controller("hold", reads={"s": s}, **law))
    scene.sensor("s", s)
    run = fmbd.solve(scene, t_end=1.04, tol={"s": 1e-6}, scheme=scheme, output=Output(progress=False))
    exact = fmbd.solve(scene, t_end=1.04, dt=0.013, output=Output(progress=False, times=tuple(run.times)))
    assert np.abs(run["s"] - exact["s"]).max() < 1e-9 and run.certificate["s"].total <= 1e-6


@pytest.mark.parametrize(
    "scheme",
    [
        fmbd.Radau(2, rtol=1e-6),
        fmbd.Radau(3, rtol=1e-7),
        fmbd.HalfExplicit(rtol=1e-6),
        fmbd.GeneralizedAlpha(rtol=1e-6),
    ],
)
def test_steps_in_one_end_where_they_are_told_and_have_the_order_of_the_scheme(
    scheme: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In compiled code and in Python's, whatever their errors over the tolerance are; the last before a break point are less, and
    those before a step that is suddenly longer.
    """
    solved = made_by(scheme, replace(pendulum(), breakpoints=(0.43,)))
    given, problem = solved.compared, solved.problem
    own = given.recorder.times
    stop, sizes = int(np.searchsorted(own, 0.43 - 1e-9)), np.diff(own)
    longer = np.append(False, sizes[1:] > 3.0 * sizes[:-1])
    assert longer.any() or scheme.order == 2  # whose sizes are nested

    apart = []
    for count in (1, 2, 4):
        made = with_larger_steps(problem, given, count)
        rows = np.searchsorted(own, made.recorder.times - 1e-12)
        np.testing.assert_allclose(made.recorder.times, own[rows], rtol=0, atol=1e-12)
        for first, last in pairwise(rows):
            assert not longer[first + 1 : last].any()
            assert last - first == count or last in (stop, len(own) - 1) or longer[last]
        assert made.steps == len(made.recorder.times) - 1
        apart.append(abs(made.recorder.series["x"][-1] - given.recorder.series["x"][-1]).max())
    assert apart[0] < 1e-3 * apart[1]
    assert np.log2(apart[2] / apart[1]) == pytest.approx(scheme.order, abs=1.0)

    monkeypatch.setattr(MarchingStepper, "stride", lambda self, h: 0.0)
    alone = with_larger_steps(problem, given, 4)
    np.testing.assert_allclose(alone.recorder.series["x"], made.recorder.series["x"], rtol=0, atol=1e-3 * apart[2])


@pytest.mark.parametrize(("rtol", "times"), [(1e-4, None), (1e-5, None), (1e-4, tuple(0.06 * k for k in range(101)))])
def test_halves_of_steps_tell_what_changes_of_size_leave(rtol: float, times: tuple[float, ...] | None) -> None:
    """A pendulum that goes over the top drifts with the pattern of sizes, which no smaller tolerance repeats: 0.42 was stated."""
    body = fmbd.RigidBody("body", 1.0, 0.1, (1.0, 0.0), angular_velocity=8.0, velocity=(0.0, 8.0))
    pin = fmbd.revolute("pin", fmbd.ground, body, center=(0, 0))
    scene = fmbd.Scene("over the top", gravity=(0, -9.81))
    scene.add(body, pin)
    scene.sensor("angle", fmbd.angle(pin))
    output = Output(progress=False, energy=False, estimate_error=True, times=times)
    run = fmbd.solve(scene, t_end=6.0, scheme=fmbd.GeneralizedAlpha(rtol=rtol), output=output)

    def turns(t: float, y: Any) -> list[float]:
        return [y[1], -9.81 / 1.1 * np.cos(y[0])]

    exact = solve_ivp(turns, (0.0, 6.0), (0.0, 8.0), "DOP853", t_eval=run.times, rtol=1e-11, atol=1e-12).y[:1].T
    assert 0.9 < run.certificate["angle"].total / np.abs(run["angle"] - exact).max() < 1.1


def test_given_steps_are_made_or_not_but_no_smaller() -> None:
    """A run that takes others beside a given one would tell errors of neither."""
    assert in_one(made_by(fmbd.Radau(2), pendulum()).compared, 2).given
    with pytest.raises(ConvergenceError, match="no end: Newton diverged"):
        StepControl(3.0, given=True).rejected(0.0, 0.1, np.inf, "Newton diverged")


@pytest.mark.parametrize("begins", [0.307, 0.789, 0.261])
def test_errors_of_kinks_are_not_told_by_larger_steps(begins: float) -> None:
    """They are chance in both: a quarter of what a force left that begins to rise within a step was stated."""

    def rises(t: float) -> tuple[float, ...]:
        return (0, 40.0 * max(t - begins, 0.0), 0)

    quiet = Output(progress=False, energy=False)
    run = fmbd.solve(torqued_links(rises), t_end=1.0, tol={"end": 4e-5}, scheme=fmbd.Radau(3), output=quiet)
    at = Output(progress=False, energy=False, times=tuple(run.times))
    exact = fmbd.solve(torqued_links(rises, begins), t_end=1.0, scheme=fmbd.Radau(5, rtol=1e-10), output=at)
    assert 0.5 < run.certificate["end"].total / np.abs(run["end"] - exact["end"]).max() < 3.0


def test_first_steps_that_grow_are_larger_in_the_run_that_tells_their_error() -> None:
    """The second step is eight times the first, too long for its error, which is most of all: together with the first it is an
    eighth longer, and half of the error was told.
    """
    solved = made_by(fmbd.HalfExplicit(rtol=1e-7), geared_chain())
    given, problem = solved.compared, solved.problem
    two, four = (with_larger_steps(problem, given, count) for count in (2, 4))
    told = compare_steps({"end": 4, "pin force": 4}, given, [two, four]).errors["end"].size

    at = Output(progress=False, energy=False, times=tuple(given.recorder.times[::3]))
    exact = fmbd.solve(geared_chain(), t_end=1.0, scheme=fmbd.Radau(5, rtol=1e-11), output=at)["end"]
    assert 0.8 < told / np.abs(given.recorder.series["end"][::3] - exact).max() < 1.5


def test_larger_steps_tell_errors_beside_refused_ones_where_their_order_is_seen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Those of smooth motion; in a few steps halves of them do, and no tolerance, which takes three times as many steps."""
    asked: list[tuple[bool, int]] = []
    made = companion_runs.march

    def counted(problem: Any, solver: Any, schedule: Any, *given: Any) -> Any:
        asked.append((schedule.given, len(schedule.marks) + 1))
        return made(problem, solver, schedule, *given)

    monkeypatch.setattr(companion_runs, "march", counted)
    quiet = Output(progress=False, energy=False)
    run = fmbd.solve(geared_chain(), t_end=1.0, tol={"end": 1e-5}, scheme=fmbd.HalfExplicit(), output=quiet)
    assert run.counters["rejections"] and run.counters["steps"] >= larger_steps.MANY
    assert all(given and steps < run.counters["steps"] for given, steps in asked[-2:])

    monkeypatch.setattr(larger_steps, "MANY", 1e3)
    run = fmbd.solve(geared_chain(), t_end=1.0, tol={"end": 1e-5}, scheme=fmbd.HalfExplicit(), output=quiet)
    assert asked[-1] == (True, 2 * run.counters["steps"])


def test_what_was_refused_for_another_reason_is_not_tried_with_larger_steps() -> None:
    """Steps that the iteration, not the error, keeps small find no end when they are larger."""
    solved = made_by(fmbd.Radau(2, rtol=1e-5), pendulum())
    assert two_in_one(solved) is not None
    solved.run.counters.update({"rejections": 2.0, "rejected: Newton diverged": 2.0})
    assert two_in_one(solved) is None


@pytest.mark.parametrize(("slow", "quick", "told"), [(0.0, 0.5, True), (0.0, 0.05, False), (1.0, 0.3, False)])
def test_vibrations_are_left_out_where_most_of_an_error_is_most_of_them(slow: float, quick: float, told: bool) -> None:
    """Of a series that turns at each end: half of it missed, a twentieth, and errors that are slow for the most part."""
    t = np.linspace(0.0, 1.0, 41)[:, None]
    turning, arch = np.cos(40 * np.pi * t), np.sin(np.pi * t)
    error = Deviation(t[:, 0], slow * arch + quick * turning)
    assert unresolved(error, Deviation(t[:, 0], arch + turning)) == told


def test_vibrations_that_larger_steps_leave_out_are_stated() -> None:
    """The end of a bar of unit wave speed, pulled by sin^2, beside its series: 3/4 of the order stated 0.35 of the error."""
    mesh = fmbd.read_gmsh(MESHES / "block.py", size=(1.0, 0.1), counts=(6, 1), origin=(0.0, 0.0), quads=True)
    bar = fmbd.AbsoluteBody("bar", mesh, degree=1, density=1.0, elastic=linear_elastic(1.0, 0.0))
    scene = fmbd.Scene("pulled bar")
    scene.add(bar, fmbd.fixed("wall", fmbd.ground, bar.surface("left")))
    scene.add(fmbd.force("pull", bar.surface("right"), lambda t: (0.002 * np.sin(1.5 * t) ** 2, 0.0)))
    scene.sensor("speed", fmbd.velocity(bar.surface("right")))
    run = fmbd.solve(scene, t_end=3.0, scheme=fmbd.Radau(2), tol={"speed": 1e-3})

    rates, t = np.pi * (np.arange(4000) + 0.5), run.times[:, None]
    exact = (
        0.02 * (np.sin(rates * t) / rates + (3.0 * np.sin(3.0 * t) - rates * np.sin(rates * t)) / (rates**2 - 9.0))
    ).sum(1)
    true = float(np.abs(run["speed"][:, 0] - exact).max())
    assert true <= 1e-3 and 0.5 < run.certificate["speed"].total / true < 3.0


@pytest.mark.parametrize("phase", [0.2, 1.0, 2.0])  # by which larger steps lag at the end
@pytest.mark.parametrize("period", [5, 12, 35])  # ends of larger steps in one period of the fast motion
def test_vibrations_whose_phase_larger_steps_lose_are_not_extrapolated(phase: float, period: int) -> None:
    times = np.linspace(0.0, 1.0, 301)
    fast = 2.0 * np.pi * 300.0 / period
    moved = np.sin(fast * times)
    apart = Deviation(times, (moved - np.sin((fast - phase) * times))[:, None])
    series = Deviation(times, (100.0 * np.sin(6.0 * times) + moved)[:, None])
    followed = phase < 1.0 and period > 6
    assert unresolved(apart, series) != followed


@pytest.mark.parametrize(
    ("scheme", "make", "sensor", "orders"),
    [
        (fmbd.BDF(rtol=1e-7), geared_chain, "end", (4.3, 4.9)),
        (fmbd.BDF(3, rtol=1e-6), pendulum, "x", (2.5, 3.0)),
        (fmbd.BDF(rtol=3e-6), light_rod, "end", (1.8, 2.2)),  # higher ones amplify its vibrations
    ],
)
def test_larger_steps_tell_errors_of_a_scheme_that_changes_its_order_by_the_mean_of_those_taken(
    scheme: Any, make: Any, sensor: str, orders: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In compiled code and in Python's: orders of steps that are given are chosen, their sizes not."""
    solved = made_by(scheme, make())
    given, problem = solved.compared, solved.problem
    two = two_in_one(solved)
    assert two is not None and orders[0] < solved.run.counters["mean order"] < orders[1]
    told = larger_steps_error(solved, two, Allowed((sensor,), lambda errors: 0.5, 0.9, rough=False)).errors[sensor].size

    at = Output(progress=False, energy=False, times=tuple(given.recorder.times))
    exact = fmbd.solve(make(), t_end=1.0, scheme=fmbd.Radau(5, rtol=1e-10), output=at)[sensor]
    assert 0.5 < told / np.abs(given.recorder.series[sensor] - exact).max() < 2.0

    monkeypatch.setattr(MarchingStepper, "stride", lambda self, h: 0.0)
    alone = with_larger_steps(problem, given, 2)
    np.testing.assert_allclose(alone.recorder.series[sensor], two.recorder.series[sensor], rtol=0, atol=0.1 * told)


@pytest.mark.parametrize(("sensor", "tol"), [("turn", 1e-4), ("rate", 3.7e-4)])
def test_errors_of_long_motion_fall_by_less_than_the_mean_order(sensor: str, tol: float) -> None:
    """A pendulum turns over the top for 10 s: by the whole mean order of BDF 0.48 and 0.45 of the errors were stated."""
    body = fmbd.RigidBody("bob", 1.0, 0.1, (1.0, 0.0), angular_velocity=8.0, velocity=(0.0, 8.0))
    pin = fmbd.revolute("pin", fmbd.ground, body, center=(0, 0))
    scene = fmbd.Scene("over the top", gravity=(0, -9.81))
    scene.add(body, pin)
    scene.sensor("turn", fmbd.rotation(body))
    scene.sensor("rate", fmbd.joint_rate(fmbd.angle(pin)))
    run = fmbd.solve(scene, t_end=10.0, scheme=fmbd.BDF(), tol={sensor: tol}, output=Output(progress=False))

    def fall(t: float, y: np.ndarray) -> list[float]:
        return [y[1], -9.81 * np.cos(y[0]) / 1.1]

    exact = solve_ivp(fall, (0.0, 10.0), (0.0, 8.0), "DOP853", t_eval=run.times, rtol=1e-12, atol=1e-12).y
    true = float(np.abs(run[sensor].ravel() - exact[0 if sensor == "turn" else 1]).max())
    assert true < tol and 0.6 < run.certificate[sensor].total / true < 2.0


def test_few_steps_of_a_scheme_that_changes_its_order_are_not_made_larger() -> None:
    """They are those of its start, and not of its mean order: a fifth of the error was told, and three times of it."""
    for rtol, told in ((1e-5, False), (1e-7, False), (1e-9, True)):  # 55, 101 and 191 steps
        assert (two_in_one(made_by(fmbd.BDF(rtol=rtol), pendulum())) is not None) == told


@pytest.mark.parametrize(("rtol", "kinks", "told"), [(1e-6, False, True), (1e-4, True, False), (1e-5, True, False)])
def test_steps_of_a_scheme_that_changes_its_order_are_made_larger_beside_refused_ones_but_no_kinks(
    rtol: float, kinks: bool, told: bool
) -> None:
    """Of quick motion a run with a tenth of the tolerance told it, with 1.4 times the steps; of kinks two in one state 0.1."""
    scene, last = chain(2, "double pendulum", length=0.4, inertia=0.4**2 / 12)
    scene.sensor("end", fmbd.position(last))
    if kinks:
        scene.add(fmbd.force("pushes", last, lambda t: (0.0, 30.0 * max(np.sin(9.0 * t), 0.0))))
    solved = made_by(fmbd.BDF(rtol=rtol), scene)
    assert solved.run.counters["rejections"]
    two = two_in_one(solved)
    assert (two is not None) == told
    if two is not None:
        stated = larger_steps_error(solved, two, Allowed(("end",), lambda errors: 0.5, 0.9, rough=False)).errors["end"]
        at = Output(progress=False, energy=False, times=tuple(solved.compared.recorder.times))
        exact = fmbd.solve(scene, t_end=1.0, scheme=fmbd.Radau(5, rtol=1e-10), output=at)["end"]
        assert 0.5 < stated.size / np.abs(solved.compared.recorder.series["end"] - exact).max() < 3.0


def test_kinks_that_are_passed_in_several_steps_are_not_told_by_larger_ones() -> None:
    """Each of them more than a third of the one before: by the order that four in one show 0.16 of the error was stated."""
    scene, last = chain(2, "double pendulum", length=0.6, inertia=0.6**2 / 12)
    scene.add(fmbd.force("pushes", last, lambda t: (0.0, 10.0 * max(np.sin(5.0 * t), 0.0))))
    scene.sensor("end", fmbd.position(last))
    assert two_in_one(made_by(fmbd.Radau(3, rtol=1e-7), scene)) is None


def steered_cart() -> fmbd.Scene:
    """A pole hangs from a cart that is steered to a place, which has been reached after 0.4 s: a kink in the third derivative."""
    cart, pole = fmbd.RigidBody("cart", 2.0, 1.0), fmbd.RigidBody("pole", 0.3, 0.02, (0.0, -0.4))
    scene, rail = fmbd.Scene("cart", gravity=(0.0, -9.81)), fmbd.prismatic("rail", fmbd.ground, cart, axis=(1, 0))
    scene.add(cart, pole, rail, fmbd.revolute("pin", cart, pole, center=(0, 0)))
    target, gains = rise(0.4), (80.0, 30.0, 20.0)
    scene.add(fmbd.pid("pid", fmbd.displacement(rail), target=lambda t: 0.3 * target(t), gains=gains))
    scene.sensor("place", fmbd.position(cart))
    return scene


def quarter_car() -> fmbd.Scene:
    """A wheel on a road that begins to rise and fall, whose hop two steps in one do not follow, and the body on it."""
    wheel, body = fmbd.RigidBody("wheel", 40.0, 1.0, (0.0, 0.3)), fmbd.RigidBody("body", 300.0, 1.0, (0.0, 0.8))
    scene, begins = fmbd.Scene("quarter car", gravity=(0.0, -9.81)), rise(0.2)
    scene.add(wheel, body, *(fmbd.prismatic(b.name, fmbd.ground, b, axis=(0, 1), center=(0, 0)) for b in (wheel, body)))
    scene.add(fmbd.Spring("spring", wheel, body, stiffness=2e4, damping=1200.0, length=0.647))
    road = lambda p, t: 0.04 * np.sin(8.0 * t) ** 2 * begins(t)  # noqa: E731
    scene.add(fmbd.Tyre("tyre", wheel, road=road, radius=0.317, stiffness=2e5, damping=150.0))
    scene.sensor("speed", fmbd.velocity(wheel))
    return scene


@pytest.mark.parametrize(("make", "rtol", "sensor"), [(steered_cart, 1e-6, "place"), (quarter_car, 1e-5, "speed")])
def test_two_in_one_of_high_orders_beside_refused_steps_tell_no_kinks_and_no_vibrations(
    make: Any, rtol: float, sensor: str
) -> None:
    """Steps that fall to a quarter within three stated half of the error, those that leave out a vibration 200 times of it."""
    solved = made_by(fmbd.BDF(rtol=rtol), make())
    assert solved.run.counters["rejections"]
    two, allowed = two_in_one(solved), Allowed((sensor,), lambda errors: 0.5, 0.9, rough=False)
    assert two is None or larger_steps_error(solved, two, allowed) is None


@pytest.mark.parametrize("compiled", [True, False])
def test_given_steps_in_which_frames_turn_too_far_end_their_run(
    compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two in one of a fast top: it was made to its end in parts of steps, with as many as the run itself, and told nothing."""
    if not compiled:
        monkeypatch.setattr(MarchingStepper, "stride", lambda self, h: 0.0)
    body = fmbd.RigidBody("top", 1.0, (0.1, 0.2, 0.3), (0.0, 0.0, 0.0), angular_velocity=(0.5, 0.0, 60.0))
    scene = fmbd.Scene("fast top")
    scene.add(body)
    scene.sensor("spin", fmbd.angular_velocity(body))
    solved = made_by(fmbd.BDF(rtol=1e-5), scene)
    wanted = Output(energy=False, progress=False)
    with pytest.raises(ConvergenceError, match="is too large"):
        companion_runs.companion(solved.problem, in_one(solved.compared, 2), wanted)
    assert two_in_one(solved) is None


def test_given_steps_of_elastic_bodies_have_factors_where_their_size_comes_often(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From the first one on: Python made the first four of each size, which took longer than all others."""
    solved = made_by(fmbd.Radau(2, rtol=1e-4), elastic_pendulum())
    sizes = in_one(solved.compared, 2).given_sizes
    rare = [h for h in sizes if np.isclose(sizes, h, rtol=1e-6, atol=0.0).sum() <= SETTLED]
    in_python: list[float] = []
    in_parts = RadauStepper._controlled
    monkeypatch.setattr(
        RadauStepper, "_controlled", lambda self, limit: (in_python.append(self.state.t), in_parts(self, limit))[1]
    )
    assert with_larger_steps(solved.problem, solved.compared, 2) is not None
    assert len(in_python) <= 1 + len(rare) < 0.2 * len(sizes)  # the first one, whose size nobody proposes


def test_spaces_are_judged_with_the_vibrations_that_larger_steps_leave_out() -> None:
    """A cantilever loaded at once, beside its series: twice the step damped what the mesh is off in, 0.43 of which was stated."""
    beam = fmbd.Beam("beam", (0.0, 0.0), (1.2, 0.0), fmbd.Section(EA=1e8, EI=50.0, rhoA=1.5), elements=2)
    scene, tol = fmbd.Scene("cantilever"), 1e-4
    scene.add(beam, fmbd.fixed("clamp", fmbd.ground, beam.surface("start")))
    scene.add(fmbd.force("load", beam.surface("end"), (0.0, 3.0)))
    scene.sensor("tip", fmbd.position(beam.surface("end")))
    run = fmbd.solve(scene, t_end=0.3, scheme=fmbd.Radau(2), tol={"tip": tol})

    known = np.array([1.8751040687, 4.6940911330, 7.8547574382, 10.9955407349])  # cos x cosh x = -1
    rates = (np.append(known, np.pi * (np.arange(4, 60) + 0.5)) / 1.2) ** 2 * np.sqrt(50.0 / 1.5)
    exact = 3.0 * 4.0 / (1.5 * 1.2) * ((1.0 - np.cos(rates * run.times[:, None])) / rates**2).sum(1)
    true = float(np.abs(run["tip"][:, 1] - exact).max())
    assert true <= tol and 0.5 < run.certificate["tip"].total / true < 3.0
