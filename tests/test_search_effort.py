"""Searches for a tolerance make nothing that they have, or that tells them nothing."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from chains import chain
from dae_problems import pendulum
from profiled import calls_of
from tolerance_more import MORE, copper_arm, springs_in_millimetres
from tolerance_scenes import CASES, MESHES, rise

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError, PartsError
from fmbd_fenicsx.linear import configuration_warnings
from fmbd_fenicsx.materials import linear_elastic
from fmbd_fenicsx.run import single_run, time_loop
from fmbd_fenicsx.run.accuracy import beside_steps, companion_runs, equal_steps, jumps_in_time
from fmbd_fenicsx.run.accuracy.deviation import Deviation
from fmbd_fenicsx.run.accuracy.search import (
    attempts,
    next_attempt,
    shared_runs,
    shared_spaces,
    tolerance,
)
from fmbd_fenicsx.run.accuracy.search.attempts import Failures
from fmbd_fenicsx.run.schedule import StepSchedule
from fmbd_fenicsx.schemes.onestep.alpha.alpha_stepper import AlphaStepper
from fmbd_fenicsx.system.evaluation import Evaluation


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of steps of the runs that were made beside attempts, to tell their errors."""
    found: list[int] = []
    again = shared_runs.again

    def noted(problem: Any, schedule: Any, steps: int, *rest: Any) -> Any:
        found.append(steps)
        return again(problem, schedule, steps, *rest)

    with_half = shared_runs.SharedRuns._with_half

    def whole(self: Any, solved: Any) -> Any:
        made = with_half(self, solved)
        found.extend(steps for _, steps in self._whole)
        return made

    monkeypatch.setattr(shared_runs, "again", noted)
    monkeypatch.setattr(shared_runs.SharedRuns, "_with_half", whole)
    return found


def test_steps_that_only_tell_an_error_are_not_tried_again_by_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twelve steps are too few for this arm: a look ends where compiled code finds none, which a run goes on behind."""
    asked: list[float] = []
    advance = AlphaStepper.advance

    def counted(self: Any, h: float) -> Any:
        asked.append(h)
        return advance(self, h)

    monkeypatch.setattr(AlphaStepper, "advance", counted)
    scene, scheme, schedule = copper_arm(), fmbd.GeneralizedAlpha(), StepSchedule(0.3, 12)
    shared, output = shared_runs.SharedRuns(None, None, 12), fmbd.Output(energy=False, progress=False)
    with pytest.raises(PartsError, match="of 12: .* at once"):
        shared.look(scene, scheme, schedule, output)
    assert not asked
    with pytest.raises(ConvergenceError):
        fmbd.solve(copper_arm(), t_end=0.3, dt=0.025, output=output)
    assert asked


def test_damped_vibrations_are_looked_for_where_an_attempt_may_be_the_last(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once: each attempt made four runs of eight steps, two of them with twice the step, which took as long as the others."""
    looked: list[float] = []
    apart = beside_steps._apart
    monkeypatch.setattr(beside_steps, "_apart", lambda *given: (looked.append(given[-1]), apart(*given))[1])
    scene, last = chain(2, length=0.4, inertia=0.02)
    scene.sensor("end", fmbd.position(last))
    quiet = fmbd.Output(energy=False, progress=False)
    run = fmbd.solve(scene, t_end=1.2, scheme=fmbd.BDF(2, rtol=None), tol={"end": 2e-4}, output=quiet)
    first, then = run.history  # steps for all of the room, by an order that nobody saw, stated 0.92 of the tolerance
    assert first.worst > 3.0 and then.then == "done" and looked == [pytest.approx(then.step)]


def test_loads_are_asked_by_compiled_code_before_the_first_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hundred instants are evaluated in a few calls, as in the runs that follow."""
    made: list[float] = []
    balance = Evaluation.balance

    def counted(self: Any, *given: Any) -> Any:
        made.append(self.t)
        return balance(self, *given)

    monkeypatch.setattr(Evaluation, "balance", counted)
    scene = springs_in_millimetres()
    plan = tolerance._first(scene, None, 2.0, None)
    assert next_attempt.jumps_before(plan, shared_spaces.SharedSpaces(None, None, 25)) == () and not made
    plan = replace(plan, scheme=fmbd.GeneralizedAlpha(compiled=False))
    assert next_attempt.jumps_before(plan, shared_spaces.SharedSpaces(None, None, 25)) == () and len(made) > 100


def test_orders_seen_by_chance_do_not_matter_where_half_of_the_schemes_is_enough() -> None:
    """Of a bearing whose force is let off by far no run with half the step is asked; where it is not, what was found stays."""
    case = MORE["four bar"]
    run = fmbd.solve(case.scene(), t_end=case.t_end, tol=case.tol(5e-4), output=fmbd.Output(progress=False))
    assert len(run.history) == 2 and not run.halved
    assert run.certificate["bearing"].total > 1.5  # off by 2.1 N

    times = np.linspace(0.0, 1.0, 5)
    series = [{"x": np.full((5, 1), x), "y": np.full((5, 1), x)} for x in (1.0, 0.0)]
    made = [SimpleNamespace(times=times, series=x, t_end=1.0) for x in series]
    compared: Any = [equal_steps.Compared(x, StepSchedule(1.0, n), None) for x, n in zip(made, (40, 10), strict=True)]  # type: ignore[arg-type]
    small = {n: Deviation(times, np.full((5, 1), 1e-3)) for n in "xy"}
    found = equal_steps.TimeError(small, {"x": 2.0, "y": 2.0}, compared[0], by_chance=frozenset("x"))

    def told(limit: float, sensors: str = "xy") -> equal_steps.TimeError:
        asked = lambda errors: max(x.size for x in errors.values()) <= limit  # noqa: E731
        return equal_steps.falling_slowly(found, {"x": 2, "y": 2}, tuple(compared), sensors, asked)

    assert told(0.33) is found and told(0.34, "y") is found
    slow = told(0.34)
    assert slow.errors["x"].size == pytest.approx(1 / 3) and slow.errors["y"] is small["y"] and not slow.by_chance


@pytest.mark.parametrize(("tol", "steps"), [(1e-3, 375), (3e-3, 300)])
def test_kinks_of_larger_steps_than_those_that_tell_an_error_do_not_matter(
    tol: float, steps: int, made: list[int]
) -> None:
    """The force of a bearing looks like a kink in 100 steps of RATTLE, not in 200: these tell the error of 300, and no 600 are
    made. 50 do not end, so that 175, as many as are enough for the larger tolerance, would take 350 to tell theirs.
    """
    case = MORE["four bar, Rattle"]
    given = {"t_end": case.t_end, "dt": case.t_end / 100, "tol": case.tol(tol), "output": fmbd.Output(every=3)}
    run = fmbd.solve(case.scene(), scheme=fmbd.Rattle(), **given)
    assert run.counters["steps"] == steps and made == [50, 200]
    assert run.observed_order["coupler"] == pytest.approx(2.0, abs=0.1)


def test_an_attempt_whose_error_nobody_told_tells_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """100 steps agree with 50, of which no run with other steps came to its end: one more run shows whether they do by chance."""
    shared, output = shared_runs.SharedRuns(None, None, 25), fmbd.Output(energy=False, progress=False)
    again, with_half = shared_runs.again, shared_runs.SharedRuns._with_half
    lets_all = shared_runs.Allowed(("x",), lambda _: 0.0, 1.0, rough=True)

    def refused(problem: Any, schedule: Any, *rest: Any) -> Any:
        if schedule.steps == 50:
            raise ConvergenceError("it does not end")
        return again(problem, schedule, *rest)

    def refuses(self: Any, solved: Any) -> Any:
        if solved.compared.schedule.steps == 50:
            raise ConvergenceError("it does not end")
        return with_half(self, solved)

    monkeypatch.setattr(shared_runs, "again", refused)
    monkeypatch.setattr(shared_runs.SharedRuns, "_with_half", refuses)
    scene, scheme = pendulum(), fmbd.GeneralizedAlpha()
    untold, told = (
        shared.time_error(shared.solve(scene, scheme, StepSchedule(1.0, n), output), shared_runs.Orders(), lets_all)
        for n in (50, 100)
    )
    assert not untold.errors
    assert told.orders["x"] == pytest.approx(2.0, abs=0.1)  # nan where 50 alone told it


def test_steps_that_failed_are_not_tried_in_finer_spaces(monkeypatch: pytest.MonkeyPatch) -> None:
    """They would fail there as well; with other break points they may pass."""
    tried: list[int] = []

    def fails(problem: Any, schedule: Any, *given: Any, **more: Any) -> Any:
        tried.append(schedule.steps)
        raise ConvergenceError("steps are too large")

    monkeypatch.setattr(shared_runs, "companion", fails)
    shared, output = shared_runs.SharedRuns(None, None, 12), fmbd.Output(energy=False, progress=False)
    scenes = pendulum(), pendulum(), replace(pendulum(), breakpoints=(0.5,))
    for scene in scenes:
        with pytest.raises(ConvergenceError):
            shared.look(scene, fmbd.GeneralizedAlpha(), StepSchedule(1.0, 12), output)
    assert tried == [12, 12]


@pytest.mark.parametrize(("tol", "steps"), [(2e-2, [50]), (5e-3, [50])])
def test_errors_in_space_come_first_where_bodies_touch(tol: float, steps: list[int], made: list[int]) -> None:
    """What a bar on its way to a wall and back misses by its mesh leaves room for what it misses by its steps, or so little that
    meshes are refined: no run with half the step was of use, which took longer than the rest.
    """
    case = CASES["bar on the wall and back"]
    run = fmbd.solve(case.scene(), t_end=case.t_end, tol=case.tol(tol), output=fmbd.Output(progress=False))
    assert run.history[-1].then == "done" and made == steps


def test_spaces_of_slender_bodies_come_first(made: list[int]) -> None:
    """24 steps show that the elements of a rod are too few, and no whole run is made with them; those of a beam are enough, and
    its 24 steps tell the order with 48, not with 12.
    """
    rod, beam = CASES["rod"], CASES["clamped beam"]
    run = fmbd.solve(rod.scene(), t_end=rod.t_end, tol=rod.tol(1e-2), output=fmbd.Output(progress=False))
    assert [round(rod.t_end / x.step) for x in run.history] == [24, 96] and not made
    run = fmbd.solve(beam.scene(), t_end=beam.t_end, tol=beam.tol(1e-3), output=fmbd.Output(progress=False))
    assert len(run.history) == 1 and made == [48] and run.observed_order["tip"] == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("name", ["clamped beam", "line"])
def test_steps_are_foreseen_where_a_look_tells_little(name: str, made: list[int]) -> None:
    """48 steps beside the 24 of the look say that 96 leave too much before these are made, and show the order afterwards."""
    case = CASES[name]
    tol = case.tolerances[1]
    run = fmbd.solve(case.scene(), t_end=case.t_end, tol=case.tol(tol), output=fmbd.Output(progress=False))
    assert {round(case.t_end / x.step) for x in run.history} == {24, 168} and not made
    assert run.observed_order["tip"] == pytest.approx(2.0, abs=0.1)
    assert run.certificate["tip"].sum > 0.2 * tol  # hardly more than it takes


def test_runs_of_rigid_bodies_begin_with_steps_that_cost_no_more_than_set_up() -> None:
    """100 steps of 3 us, and 50 beside, are made in less time than their runs begin: far from enough, they were for nothing."""
    case = MORE["four bar"]
    run = fmbd.solve(case.scene(), t_end=case.t_end, tol=case.tol(1e-2), output=fmbd.Output(progress=False))
    steps = [round(case.t_end / x.step) for x in run.history]
    assert steps[0] == 200 and len(steps) == 2
    scene = case.scene()
    scene.add(fmbd.CoordinateBody("own", np.eye(1), lambda q, v, t: -q, np.ones(1), np.zeros(1)))
    assert tolerance._first(scene, None, case.t_end, None).steps == 100  # steps that ask Python cost


def test_instants_that_two_runs_have_are_found_once_for_all_sensors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where series of two runs tell something of one another is the same for each: for every sensor it took as long again."""
    asked, counts, beyond = [], [], equal_steps.BeyondLarger
    monkeypatch.setattr(equal_steps, "BeyondLarger", lambda *given: (asked.append(given), beyond(*given))[1])
    case = MORE["four bar"]
    for sensors in ((), ("pin 0", "pin 1", "pin 2")):
        scene = case.scene()
        for name in sensors:
            scene.sensor(name, fmbd.reaction(name))
        asked.clear()
        fmbd.solve(scene, t_end=case.t_end, tol=case.tol(5e-4), output=fmbd.Output(progress=False))
        counts.append([len(t) for t, *_ in asked])
    assert counts[0] == counts[1] != []


def test_loads_are_asked_once_at_a_time() -> None:
    """Ends of steps, between which jumps are looked for, are among the instants at which loads that come are."""
    asked: list[float] = []
    scene = springs_in_millimetres()
    scene.add(fmbd.force("noted", scene.bodies["block 0"], lambda t: (asked.append(t), (np.sin(3.0 * t), 0.0))[1]))
    plan = tolerance._first(scene, None, 2.0, 0.02)
    shared = shared_spaces.SharedSpaces(None, None, 25)
    shared.ahead(scene)
    asked.clear()
    next_attempt.jumps_before(plan, shared)
    assert 200 < len(asked) < 260 and len(asked) - len(set(asked)) < 5


def test_rows_of_joints_are_looked_at_by_the_driver_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs that tell an error begin where the first one found them independent."""

    def refuse(*given: Any) -> None:
        raise AssertionError("rows are looked at by NumPy")

    monkeypatch.setattr(configuration_warnings, "rows_are_independent", refuse)
    case = CASES["geared chain, force"]
    run = fmbd.solve(case.scene(), t_end=case.t_end, tol=case.tol(0.3), output=fmbd.Output(progress=False))
    assert len(run.history) == 2


def test_a_ramp_of_gravity_is_not_looked_at_for_jumps(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is smooth; a gravity of the user's own may jump."""
    hanging = CASES["mass on spring"].scene
    looked: list[int] = []
    rows = jumps_in_time.HeldState.rows

    def noted(self: Any, times: Any) -> Any:
        looked.append(len(times))
        return rows(self, times)

    monkeypatch.setattr(jumps_in_time.HeldState, "rows", noted)
    output = fmbd.Output(progress=False)
    fmbd.solve(replace(hanging(), gravity_ramp=0.1), t_end=1.0, tol={"weight": 1e-3}, output=output)
    assert not looked
    pull = lambda t: (0.0, -9.81 if t < 0.503 else 0.0)  # noqa: E731
    run = fmbd.solve(replace(hanging(), gravity=pull), t_end=1.0, tol={"weight": 1e-3}, output=output)
    assert looked and run.scene.breakpoints == pytest.approx((0.503,))


def test_a_load_of_time_is_asked_in_few_calls() -> None:
    """Of Python's functions beside the user's own: it was eleven a step."""

    def run(steps: int) -> Any:
        output = fmbd.Output(every=steps, energy=False, progress=False)
        return lambda: fmbd.solve(springs_in_millimetres(), t_end=0.5, dt=0.5 / steps, output=output)

    run(100)()
    few, many = (calls_of(run(n)) for n in (100, 300))
    assert many - few < 10 * 200


def at_a_stop() -> fmbd.Scene:
    """A body that swings against an elastic stop."""
    scene = fmbd.Scene("stop", gravity=(0.0, -9.81))
    body = fmbd.RigidBody("body", 1.0, 0.05, (0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, body, center=(0, 0))
    stop = fmbd.elastic_stop("stop", fmbd.angle(pin), lower=-0.6, upper=1.0, stiffness=100.0, damping=1.0, width=0.01)
    scene.add(body, pin, stop)
    scene.sensor("x", fmbd.position(body))
    scene.sensor("rate", fmbd.sensors.joint_rate(fmbd.angle(pin)))
    return scene


def test_half_the_step_tells_kinks_at_once(made: list[int]) -> None:
    """A run whose own records have kinks is compared with one of half its step, and with no larger one before."""
    run = fmbd.solve(at_a_stop(), t_end=2.0, dt=0.02, tol={"x": 2e-3}, output=fmbd.Output(progress=False))
    assert run.counters["steps"] == 350 and made == [50, 700]


def test_half_the_step_that_tells_an_error_is_the_next_attempt(
    made: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the error is found to be too large, no further run is made in place of it, which steps of its own would have to tell.
    What is called on the way is called by attempts alone.
    """
    whole: list[int] = []
    run_once = shared_runs.run_once
    monkeypatch.setattr(
        shared_runs, "run_once", lambda task, *rest: (whole.append(task.schedule.steps), run_once(task, *rest))[1]
    )
    beside: list[tuple[int, list[int]]] = []
    by_half = shared_runs.by_half

    def told(expected: Any, given: Any, finer: Any, *, coarser: Any, **more: Any) -> Any:
        beside.append((given.schedule.steps, [x.schedule.steps for x in coarser]))
        return by_half(expected, given, finer, coarser=coarser, **more)

    monkeypatch.setattr(shared_runs, "by_half", told)
    output = fmbd.Output(every=2, progress=False)
    run = fmbd.solve(at_a_stop(), t_end=2.0, dt=0.02, tol={"x": 5e-3}, output=output)
    assert whole == [100, 225, 450, 900] and made == [50, 450, 900]
    assert [round(2.0 / x.step) for x in run.history] == whole[:3]
    assert len(run.times) == 226
    assert beside == [(225, [100]), (450, [225])]  # orders are seen with the next larger steps, not with the first ones

    called: list[float] = []
    noted = fmbd.Output(progress=False, on_step=lambda now: called.append(now.t))
    fmbd.solve(at_a_stop(), t_end=2.0, dt=0.02, tol={"x": 2e-3}, output=noted)
    assert len(called) == 100 + 350  # beside 700


def test_half_the_step_that_shows_the_order_is_the_run_that_is_given(made: list[int]) -> None:
    """A beam in 96 steps, of which 24 follow another motion: the run with 192 that tells their error is there, and better."""
    case = CASES["beam in millimetres"]
    run = fmbd.solve(case.scene(), t_end=case.t_end, tol=case.tol(1e-2), output=fmbd.Output(progress=False))
    assert made == [48, 192] and run.counters["steps"] == 192 and len(run.history) == 1 and not run.halved
    assert run.history[0].step == pytest.approx(case.t_end / 192) and run.observed_order["tip"] > 1.5
    assert run.error_estimate["tip"] < 2e-3  # 6e-3 with 96 steps

    called: list[float] = []
    noted = fmbd.Output(progress=False, on_step=lambda now: called.append(now.t))
    run = fmbd.solve(case.scene(), t_end=case.t_end, tol=case.tol(1e-2), output=noted)
    assert len(called) == run.counters["steps"] == 96 and run.halved


def test_dear_spaces_are_told_by_the_level_below_where_that_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """A block in space whose finer one has three times its unknowns: only its first level, which has none below, was compared
    with that.
    """
    asked: list[int] = []
    finer_scene = shared_spaces.finer_scene
    monkeypatch.setattr(
        shared_spaces, "finer_scene", lambda scene: (asked.append(len(scene.bodies)), finer_scene(scene))[1]
    )
    mesh = fmbd.read_gmsh(MESHES / "block.py", size=(0.2, 0.1, 0.1), counts=(2, 1, 1), origin=(0.0, 0.0, 0.0))
    law = linear_elastic(4e6, 0.35)
    block = fmbd.AbsoluteBody("block", mesh, density=1200.0, elastic=law, stiffness_damping=1e-3)
    scene, up = fmbd.Scene("block"), rise(0.08)
    scene.add(block, fmbd.fixed("wall", fmbd.ground, block.surface("left")))
    scene.add(fmbd.force("push", block.surface("right"), lambda t: (40 * up(t), 0.0, 25 * up(t))))
    scene.sensor("end", fmbd.position(block.surface("right")))
    run = fmbd.solve(scene, t_end=0.2, tol={"end": fmbd.relative(5e-2)}, output=fmbd.Output(progress=False))
    assert run.history[-1].then == "done" and run.history[-1].meshes == 1 and len(asked) == 1


def test_one_run_tells_errors_of_steps_and_what_iterations_leave_at_single_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """At all records at once: a second run as long was made where the errors of the steps were small beside that."""
    made, march = [], companion_runs.march
    monkeypatch.setattr(companion_runs, "march", lambda *given: (made.append(given), march(*given))[1])
    output = fmbd.Output(progress=False)
    run = fmbd.solve(pendulum(), t_end=1.0, tol={"x": 2e-9}, scheme=fmbd.Radau(7), output=output)
    assert run.history[-1].then == "done" and len(made) == len(run.history)


@pytest.mark.parametrize("called", [False, True])
def test_a_tenth_of_a_tolerance_that_tells_too_large_an_error_is_the_next_attempt(
    monkeypatch: pytest.MonkeyPatch, called: bool
) -> None:
    """Its run is there, and small enough; where something is called on the way it belongs to attempts alone."""
    asked: list[float] = []
    march = time_loop.march

    def counted(problem: Any, *given: Any, **how: Any) -> Any:
        asked.append(problem.scheme.rtol)
        return march(problem, *given, **how)

    for module in (single_run, companion_runs):
        monkeypatch.setattr(module, "march", counted)
    monkeypatch.setattr(shared_runs, "two_in_one", lambda solved: None)
    output = fmbd.Output(progress=False, on_step=(lambda now: None) if called else None)
    scheme = fmbd.BDF(rtol=1e-4)
    run = fmbd.solve(pendulum(), t_end=2.0, tol={"x": 6e-4}, scheme=scheme, output=output)
    steps = [a.step for a in run.history]
    assert len(steps) == 2 and run.history[-1].then == "done"
    if called:
        assert 1.2e-5 < steps[1] < 8e-5
        assert asked == pytest.approx([1e-4, 1e-5, steps[1], 0.1 * steps[1]])
    else:
        assert asked == pytest.approx([1e-4, 1e-5, 1e-6])
        assert steps == pytest.approx(asked[:2])


def test_searches_whose_steps_resolve_no_vibration_end_in_the_spaces_that_are_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A reaction that trembles with the highest modes is off by its amplitude with 48 steps and with 12 288 alike: finer meshes
    and more modes, which chance in it asked for, made each attempt dearer by far and the modes faster, and none was the last.
    """
    monkeypatch.setattr(tolerance, "ATTEMPTS", 6)
    mesh = fmbd.read_gmsh(MESHES / "rod.py", length=0.5, height=0.02, h=0.02)
    material = fmbd.materials.plane_stress(1e9, 0.3)
    strip = fmbd.FloatingBody("strip", mesh, density=1000.0, elastic=material)
    strip = strip.reduced(basis=fmbd.CraigBampton(("pin", "tip"), 4))
    disc = fmbd.RigidBody("disc", 0.05, 1e-5, position=(0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, strip.surface("pin"), center=(0, 0))
    scene = fmbd.Scene("strip", gravity=(-2.0, -9.0))
    scene.add(strip, disc, pin, fmbd.fixed("weld", strip.surface("tip"), disc))
    scene.sensor("force", fmbd.reaction_force("pin"))
    run = fmbd.solve(scene, t_end=0.5, tol={"force": 0.05}, output=fmbd.Output(progress=False))
    assert {(a.meshes, a.modes) for a in run.history} == {(0, 0)}
    assert "do not fall with the steps" in run.history[-1].then and run.certificate["force"].time > 10.0


def test_an_attempt_far_dearer_than_all_before_is_foretold(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the seconds of a step, or by how much dearer the last attempt became where the scheme chooses its steps."""
    said: list[str] = []
    monkeypatch.setattr(attempts, "note", said.append)
    own, run = fmbd.Radau(3), SimpleNamespace(seconds={"steps": 0.5})
    before, last = (tolerance.Attempt(1e-2, 0, 0, 30.0, {}, seconds, "") for seconds in (0.5, 1.0))
    plan = tolerance._first(pendulum(), None, 1.0, 0.01)

    def foretell(tried: Any, steps: int, *history: tolerance.Attempt) -> list[str]:
        said.clear()
        made = replace(tried, schedule=tried.schedule.with_steps(steps)) if steps else tried
        attempts.tell_of_dear_attempt(tried, made, run, history)  # type: ignore[arg-type]
        return said

    assert "5000 steps, is expected to take 25 s" in foretell(plan, 5000, before, last)[0]
    assert not foretell(plan, 1000, before, last)  # 5 s
    assert not foretell(plan, 5000, last, replace(last, seconds=10.0))
    chosen = tolerance._first(pendulum(), own, 1.0, None)
    assert "is expected to take 128 s" in foretell(chosen, 0, before, replace(last, seconds=8.0))[0]
    assert not foretell(chosen, 0, before, last) and not foretell(chosen, 0, last)


def test_searches_end_where_no_smaller_step_gets_farther() -> None:
    """x'' = 40 x^3 has a pole at 0.29 s: the third run that ends there was followed by four more, of up to 409600 steps."""
    scene, body = fmbd.Scene("pole"), fmbd.RigidBody("body", 1.0, 1.0, (1.0, 0.0))
    scene.add(body, fmbd.prismatic("rail", fmbd.ground, body, axis=(1.0, 0.0), center=(0.0, 0.0)))
    scene.add(fmbd.own_force("push", body, None, lambda t, a: (np.array([40.0 * a.x[0] ** 3, 0.0]), 0.0)))
    scene.sensor("x", fmbd.position(body))
    with pytest.raises(ConvergenceError, match=r"step \d+ of 1600: .* t = 0\.293"):
        fmbd.solve(scene, t_end=1.0, dt=0.01, tol={"x": 1e-3})


def test_runs_that_get_farther_or_fail_by_too_many_parts_are_no_reason_to_end_a_search() -> None:
    for errors, hopeless in (
        ([(0.2, 0.1), (0.25, 0.03), (0.26, 0.01)], True),
        ([(0.2, 0.1), (0.35, 0.03), (0.36, 0.01)], False),
        ([(0.2, 0.1), (0.25, 0.03), None, (0.25, 0.01)], False),
    ):
        failures = Failures()
        for halted in errors:
            error = PartsError("many parts") if halted is None else ConvergenceError("no end")
            error.halted = halted
            failures.note(error)
        assert failures.hopeless is hopeless
