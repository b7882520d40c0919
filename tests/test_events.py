"""Events: crossings of a value end a run or call back; dense output of the schemes at their order."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from chains import chain
from dae_problems import pendulum as point_pendulum
from dae_problems import pendulum_at
from scipy.optimize import brentq

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.mechanics.frames import Markers
from fmbd_fenicsx.run.recording.events import EventWatch
from fmbd_fenicsx.schemes.onestep.alpha.alpha_stepper import AlphaStepper
from fmbd_fenicsx.schemes.onestep.alpha.compiled_stepper import CompiledAlphaStepper

FALL = 0.5 * np.sqrt(2.0)  # m


def ball() -> fmbd.Scene:
    """A body thrown upward at 5 m/s: z = 5 t - 9.81 t^2 / 2."""
    scene = fmbd.Scene("ball", gravity=(0.0, 0.0, -9.81))
    body = fmbd.RigidBody("ball", 1.0, (1.0, 1.0, 1.0), velocity=(1.0, 0.0, 5.0))
    scene.add(body)
    scene.sensor("ball", fmbd.position(body))
    return scene


def crossing(low: float, high: float) -> float:
    """When the point pendulum passes x = 0, s."""
    return float(brentq(lambda t: pendulum_at(t)[0][0], low, high, xtol=1e-12))


@pytest.mark.mpi
@pytest.mark.parametrize(
    "settings", [{"dt": 0.01}, {"scheme": fmbd.Radau(3)}, {"scheme": fmbd.BDF()}], ids=["alpha", "Radau", "BDF"]
)
def test_a_run_ends_where_a_sensor_crosses_a_value(settings: dict[str, Any]) -> None:
    """Exact on parabolas; the last record is the event, and nothing lies behind it."""
    landing = fmbd.Event("ball z", 0.0, direction=-1)
    run = fmbd.solve(ball(), t_end=5.0, output=fmbd.Output(events=[landing]), **settings)
    assert run.status == "ended by an event"
    assert run.times[-1] == pytest.approx(10.0 / 9.81, rel=1e-6)
    assert run["ball"][-1] == pytest.approx([10.0 / 9.81, 0.0, 0.0], abs=1e-5)
    assert run.state.t == run.times[-1] and (np.diff(run.times) > 0).all()


@pytest.mark.parametrize("settings", [{"dt": 0.01}, {"scheme": fmbd.Radau(3)}], ids=["alpha", "Radau"])
def test_an_event_that_ends_no_run_is_told(settings: dict[str, Any]) -> None:
    events = [fmbd.Event("ball z", 2.0), fmbd.Event("ball z", 1.0, direction=-1), fmbd.Event("ball x", 9.0, then=print)]
    run = fmbd.solve(ball(), t_end=0.5, output=fmbd.Output(events=events), **settings)
    assert run.status == "finished"
    told = [x for x in run.warnings if x.startswith("event")]
    assert [x[: x.index(" and")] for x in told] == [
        'event "ball z": 2 was not crossed',
        'event "ball z": 1 was not crossed downwards',
    ]
    assert all("records are from 0 to 1.27" in x for x in told)

    ended = fmbd.solve(ball(), t_end=5.0, output=fmbd.Output(events=events), **settings)
    assert ended.status == "ended by an event" and not ended.warnings


def test_given_times_end_at_the_event() -> None:
    times = np.linspace(0.0, 3.0, 31)
    output = fmbd.Output(times=times, events=[fmbd.Event("ball z", 0.0, direction=-1)])
    run = fmbd.solve(ball(), t_end=3.0, dt=0.03, output=output)
    assert run.times[:-1] == pytest.approx(times[: len(run.times) - 1])
    assert run.times[-1] == pytest.approx(10.0 / 9.81, rel=1e-6)


@pytest.mark.parametrize("direction", [1, -1, 0])
def test_calls_at_crossings_by_direction(direction: int) -> None:
    """Every passage of the pendulum, in its direction, also where steps are large."""
    seen: list[tuple[float, float]] = []
    event = fmbd.Event("x 1", 0.0, direction, then=lambda now: seen.append((now.t, float(now["v"][0]))))
    run = fmbd.solve(point_pendulum(), t_end=6.0, scheme=fmbd.Radau(5, rtol=1e-9), output=fmbd.Output(events=[event]))
    fine = np.linspace(0.0, 6.0, 601)
    x = np.array([pendulum_at(float(t))[0][0] for t in fine[::4]])
    spans = [(a, b, s) for a, b, s in zip(fine[:-4:4], fine[4::4], np.sign(np.diff(np.sign(x))), strict=True) if s]
    expected = [crossing(a, b) for a, b, s in spans if direction in (0, s)]
    assert run.status == "finished"
    assert [t for t, _ in seen] == pytest.approx(expected, abs=1e-6)
    assert all(np.sign(v) == direction for _, v in seen) or direction == 0


def test_order_of_the_instant() -> None:
    """The instant has the order of the scheme."""
    exact = crossing(0.5, 1.5)
    errors = []
    for dt in (0.04, 0.02, 0.01):
        run = fmbd.solve(point_pendulum(), t_end=2.0, dt=dt, output=fmbd.Output(events=[fmbd.Event("x 1")]))
        errors.append(abs(run.times[-1] - exact))
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize(("order", "steps"), [(2, (40, 80)), (3, (40, 80)), (4, (40, 80))])
def test_dense_output_of_bdf_has_its_order(order: int, steps: tuple[int, int]) -> None:
    """Positions and velocities between the ends of steps."""
    times = tuple(np.sort(np.random.default_rng(1).uniform(0.5, 1.0, 40)))
    exact = [pendulum_at(t) for t in times]
    found = []
    for n in steps:
        scheme = fmbd.BDF(order, rtol=None)
        run = fmbd.solve(
            point_pendulum(), t_end=1.0, dt=1.0 / n, scheme=scheme, newton=fmbd.Newton(1e-11, 25), output=fmbd.Output(times=times)
        )  # fmt: skip
        found.append([np.abs(run[name] - [e[k] for e in exact]).max() for k, name in enumerate(("x", "v"))])
    assert (np.log2(np.array(found[0]) / found[1]) > order - 0.35).all(), found


@pytest.mark.parametrize("scheme", [fmbd.GeneralizedAlpha(), fmbd.GeneralizedAlpha(compiled=False)], ids=["C", "NumPy"])
def test_places_between_steps_are_as_good_as_at_their_ends(scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A link that a drive turns is in its place at the end of each step; between them the cubic's errors fall like h^4, and
    joints are closed then.
    """
    link = fmbd.RigidBody("link", 1.0, 0.1, position=(0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, link, center=(0.0, 0.0))
    scene = fmbd.Scene("driven")
    scene.add(link, pin, fmbd.drive("drive", fmbd.angle(pin), lambda t: 2.0 * np.sin(3.0 * t) + t))
    scene.sensor("angle", fmbd.angle(pin))

    times = np.sort(np.random.default_rng(1).uniform(0.3, 1.0, 60))

    def error(n: int) -> float:
        run = fmbd.solve(scene, t_end=1.0, dt=1.0 / n, scheme=scheme, output=fmbd.Output(times=tuple(times)))
        return float(np.abs(run["angle"].ravel() - 2.0 * np.sin(3.0 * times) - times).max())

    assert error(20) < 1e-13
    for stepper in (AlphaStepper, CompiledAlphaStepper):
        monkeypatch.setattr(stepper, "_all_shut", lambda self, states, weights: states.q)
    errors = error(20), error(40)
    assert np.log2(errors[0] / errors[1]) > 3.6 and errors[1] < 1e-5, errors


def falling_ball() -> fmbd.Scene:
    """A ball of 0.1 m that falls by 1 m on a floor and keeps 0.8 of its speed."""
    scene, body = fmbd.Scene("falling ball", gravity=(0.0, 0.0, -9.81)), fmbd.RigidBody("ball", 1.0, (4e-3,) * 3)
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0.0, 0.0, -1.1), (0.0, 0.0, 1.0)))
    scene.add(body, fmbd.contact("pair", fmbd.contacts.ball(body, 0.1), floor, restitution=0.8))
    scene.sensor("ball", fmbd.position(body))
    scene.sensor("gap", fmbd.contact_gap("pair"))
    return scene


def fallen(t: float) -> tuple[float, float]:
    """Height (m) above the floor and velocity (m/s) of the ball: parabolas."""
    begin, speed, g = np.sqrt(2.0 / 9.81), 0.8 * np.sqrt(2.0 * 9.81), 9.81
    if t < begin:
        return 1.0 - 0.5 * g * t * t, -g * t
    while t - begin > 2.0 * speed / g:
        begin, speed = begin + 2.0 * speed / g, 0.8 * speed
    return speed * (t - begin) - 0.5 * g * (t - begin) ** 2, speed - g * (t - begin)


@pytest.mark.parametrize("compiled", [True, False])
def test_bounces_within_steps(compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps that are cut by impacts have the places, gaps and crossings of their parts."""
    if not compiled:
        monkeypatch.setattr("fmbd_fenicsx.schemes.impacts.compiled.driver.contact_driver", lambda *_, **__: None)
    times = tuple(np.sort(np.random.default_rng(2).uniform(0.0, 1.5, 200)))
    seen: list[float] = []
    near: list[float] = []
    low = fmbd.Event("ball z", -0.99, then=lambda now: seen.append(now.t))
    close = fmbd.Event("gap", 0.01, then=lambda now: near.append(now.t))
    settings = {"t_end": 1.5, "dt": 0.02, "scheme": fmbd.schemes.Moreau()}
    run = fmbd.solve(falling_ball(), output=fmbd.Output(times=times, events=[low, close]), **settings)
    plain = fmbd.solve(falling_ball(), output=fmbd.Output(times=times), **settings)
    for found in (run["ball"][:, 2] + 1.0, run["gap"][:, 0], plain["gap"][:, 0]):
        assert np.abs(found - [fallen(t)[0] for t in times]).max() < 1e-9
    assert near == pytest.approx(seen, rel=1e-12)

    # down and up at each of two bounces, all within one step
    assert len(seen) == 4
    assert [fallen(t)[0] for t in seen] == pytest.approx([0.01] * 4, abs=1e-8)
    assert [np.sign(fallen(t)[1]) for t in seen] == [-1, 1, -1, 1]


def test_states_within_a_step_are_evaluated_once_for_all_events(monkeypatch: pytest.MonkeyPatch) -> None:
    """A further event costs no evaluation of a state."""
    asked = 0

    def markers(*given: Any) -> Any:
        nonlocal asked
        asked += 1
        return evaluate(*given)

    evaluate = Markers.evaluate
    monkeypatch.setattr(Markers, "evaluate", markers)
    counts = []
    for count in (1, 5):
        asked = 0
        events = [fmbd.Event("ball z", -100.0 - k) for k in range(count)]
        alone = lambda now: None  # noqa: E731
        output = fmbd.Output(every=10**9, events=events, on_step=alone, progress=False)
        fmbd.solve(ball(), t_end=0.5, scheme=fmbd.Radau(3), output=output)
        counts.append(asked)
    assert counts[1] == counts[0] > 10


def test_events_that_are_none_are_refused() -> None:
    for make, message in [
        (lambda: fmbd.Event("x", direction=2), "direction = 2 must be"),
        (lambda: fmbd.Event("x", float("nan")), "level"),
        (lambda: fmbd.Output(events=["x"]), "events"),
        (lambda: fmbd.Output(events=[fmbd.Event("x")], estimate_error=True), "states no errors"),
    ]:
        with pytest.raises(InputError, match=message):
            make()
    for name, message in [("tipp", 'no sensor or component "tipp"'), ("x", "has 2 components")]:
        with pytest.raises(InputError, match=message):
            fmbd.solve(point_pendulum(), t_end=0.1, dt=0.01, output=fmbd.Output(events=[fmbd.Event(name)]))


def test_a_value_that_is_passed_twice_within_a_step() -> None:
    """The ball passes a height on its way up and down within one long step: both crossings are seen, at their times."""

    def height(t: Any) -> Any:
        return 5.0 * t - 0.5 * 9.81 * t * t

    times = fmbd.solve(ball(), t_end=0.8, scheme=fmbd.Radau(3)).times
    k = int(np.searchsorted(times, 5.0 / 9.81)) - 1
    ends, inside = times[k : k + 2], times[k] + np.array((0.25, 0.5, 0.75)) * (times[k + 1] - times[k])
    level = float(0.5 * (height(ends).max() + height(inside).max()))
    assert level > height(ends).max(), "the step has its highest point inside"

    check_passages(fmbd.Radau(3), level)


def check_passages(scheme: Any, level: float) -> None:
    """The ball passes a level (m) on its way up and down, each at its time."""
    seen: list[float] = []
    event = fmbd.Event("ball z", level, then=lambda now: seen.append(now.t))
    fmbd.solve(ball(), t_end=0.8, scheme=scheme, output=fmbd.Output(events=[event]))
    assert seen == pytest.approx(np.sort(np.roots((-0.5 * 9.81, 5.0, -level))), rel=1e-6)


@pytest.mark.parametrize("scheme", [fmbd.Radau(3), fmbd.BDF(rtol=1e-11), fmbd.HalfExplicit()], ids=lambda x: x.name)
@pytest.mark.parametrize("below", [1e-4, 1e-7])
def test_a_value_that_is_grazed_within_a_step(scheme: Any, below: float) -> None:
    """The highest point is so little above the level (m) that no quarter of a step is: the quartic through them is."""
    check_passages(scheme, 0.5 * 5.0**2 / 9.81 - below)


OWN = [
    fmbd.Radau(3, rtol=1e-5),
    fmbd.BDF(rtol=1e-5),
    fmbd.HalfExplicit(rtol=1e-5),
    fmbd.ExplicitRungeKutta(rtol=1e-3),
    fmbd.GeneralizedAlpha(rtol=1e-3),
]


@pytest.mark.compiled
@pytest.mark.parametrize("times", [None, np.linspace(0.0, 3.0, 77)], ids=["ends", "times"])
@pytest.mark.parametrize("scheme", OWN, ids=lambda s: s.name)
def test_many_steps_in_a_call_are_looked_into(scheme: Any, times: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Levels next to the highest and the lowest angle are passed twice within a step in the middle of a call: that is made again
    up to there, and the run is that of steps that are looked at one by one, to the last bit.
    """

    def run(levels: Any, end: float | None = None, at: Any = times) -> tuple[fmbd.Run, list[tuple[float, float]]]:
        scene, last = chain(2)
        bend = fmbd.angle(scene.joints["pin 1"])
        scene.add(fmbd.joint_spring("spring", bend, stiffness=40.0, damping=0.05))
        scene.sensor("bend", bend)
        scene.sensor("tip", fmbd.position(last))
        seen: list[tuple[float, float]] = []
        events = [fmbd.Event("bend", x, then=lambda now: seen.append((now.t, float(now["bend"][0])))) for x in levels]
        events += [] if end is None else [fmbd.Event("tip x", end)]
        return fmbd.solve(scene, t_end=3.0, scheme=scheme, output=fmbd.Output(events=events, times=at)), seen

    bend = run((), at=np.linspace(0.0, 3.0, 3001))[0]["bend"][:, 0]
    turns = np.flatnonzero(np.diff(bend[:-1]) * np.diff(bend[1:]) < 0) + 1
    levels = bend[turns][:6] * (1 - 1e-5)

    met: list[int] = []
    inside = EventWatch.met_inside

    def noted(*given: Any) -> int:
        met.append(inside(*given))
        return met[-1]

    monkeypatch.setattr(EventWatch, "met_inside", noted)
    many = [run(levels, end) for end in (None, -0.9)]
    assert any(met)
    monkeypatch.setattr(EventWatch, "rides", lambda *given: False)
    for (once, seen), end in zip(many, (None, -0.9), strict=True):
        turn, told = run(levels, end)
        assert np.array(seen) == pytest.approx(np.array(told), rel=1e-9) and len(seen) > 10
        assert np.array_equal(once.times, turn.times) and once["bend"] == pytest.approx(
            turn["bend"], rel=1e-12, abs=1e-12
        )
        assert np.array_equal(once.state.q, turn.state.q) and once.state.t == turn.state.t
        assert once.counters["steps"] == turn.counters["steps"]


def test_components_without_names_are_counted_from_one() -> None:
    body = fmbd.RigidBody("link", 1.0, 0.1, position=(0.5, 0.0))
    scene = fmbd.Scene("link", gravity=(0.0, -9.81))
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body, center=(0.0, 0.0)))
    scene.sensor("held", fmbd.reaction("pin"))
    with pytest.raises(InputError, match='Take one of them: "held 1", "held 2"'):
        fmbd.solve(scene, t_end=0.1, dt=0.01, output=fmbd.Output(events=[fmbd.Event("held")]))


def test_given_times_before_an_event_in_a_long_step_are_recorded() -> None:
    output = fmbd.Output(times=np.linspace(0.0, 3.0, 31), events=[fmbd.Event("ball z", 0.0, direction=-1)])
    run = fmbd.solve(ball(), t_end=3.0, dt=0.4, output=output)
    assert run.times[:-1] == pytest.approx(np.arange(0.0, 1.01, 0.1)) and run.status == "ended by an event"
