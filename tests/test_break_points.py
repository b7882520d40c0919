"""Break points that a scene names: equal steps end there too, and every scheme keeps its order where a force jumps."""

from __future__ import annotations

import time as clock
from pathlib import Path
from typing import Any

import checkpoint_scenes
import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.materials import linear_elastic
from fmbd_fenicsx.ranks import world_size
from fmbd_fenicsx.run.schedule import StepSchedule, far_side, near_side, step_schedule

STOPS = (0.37, 0.613)
TIMES = tuple(float(t) for t in np.linspace(0.05, 1.0, 20))
FINE = fmbd.schemes.HalfExplicit(rtol=None)  # of order 4: errors of 1e-10 m in a thousand steps
QUIET = fmbd.Output(times=TIMES, energy=False, progress=False)


def kicked_pendulum(stops: tuple[float, ...] = STOPS, *, closed: bool = False) -> fmbd.Scene:
    """Two hinged bodies on a spring under a force that jumps twice; ``closed``: it has the earlier value at the jump itself."""
    scene = fmbd.Scene("kicked pendulum", gravity=(0, -9.81), breakpoints=stops)
    upper, lower = fmbd.RigidBody("upper", 1.3, 0.2, (1.0, 0.0)), fmbd.RigidBody("lower", 0.7, 0.05, (2.0, 0.3))
    scene.add(upper, lower, fmbd.revolute("pin", fmbd.ground, upper, center=(0, 0)))
    scene.add(fmbd.revolute("hinge", upper, lower, center=(1.6, 0)))
    scene.add(fmbd.Spring("spring", fmbd.ground, lower, stiffness=20.0, length=1.5, point_a=(0.5, -1.0)))

    def force(t: float) -> tuple[float, float]:
        passed = sum(t > x if closed else t >= x for x in STOPS)
        return (8.0, -12.0, 3.0)[passed], 0.0

    scene.add(fmbd.force("kick", lower, force))
    scene.sensor("x", fmbd.position(lower))
    scene.sensor("v", fmbd.velocity(lower))
    return scene


def kicked_block(stops: tuple[float, ...]) -> fmbd.Scene:
    """A soft block that flies high above a floor under a force that jumps, all ten times as fast."""
    mesh = checkpoint_scenes.mesh("block", size=(1.0, 0.5), cells=4)
    body = fmbd.AbsoluteBody(
        "block", mesh, degree=1, density=2.0, elastic=linear_elastic(50.0, 0.2), velocity=(0.3, 0.1)
    )
    scene = fmbd.Scene("kicked block", gravity=(0, -1.0), breakpoints=stops)
    scene.add(
        body, fmbd.contact("floor", body.surface("bottom"), fmbd.Obstacle("floor", fmbd.HalfSpace((0, -5), (0, 1))))
    )
    values = (2.0, -3.0, 1.0)
    scene.add(fmbd.force("push", body.surface("top"), lambda t: (values[sum(t >= 0.1 * x for x in STOPS)], 0.5)))
    scene.sensor("x", fmbd.position(body.surface("top")))
    scene.sensor("v", fmbd.velocity(body.surface("top")))
    return scene


@pytest.fixture(scope="module")
def pendulum_reference() -> fmbd.Run:
    return fmbd.solve(kicked_pendulum(), t_end=1.0, dt=1e-3, scheme=FINE, output=QUIET)


def orders(make: Any, exact: Any, scheme: Any, steps: tuple[int, ...], t_end: float = 1.0) -> np.ndarray:
    """Observed orders of places and velocities, (runs - 1, 2)."""
    output = fmbd.Output(times=tuple(exact.times), energy=False, progress=False)
    runs = [fmbd.solve(make(), t_end=t_end, dt=t_end / n, scheme=scheme, output=output) for n in steps]
    errors = np.array([[np.abs(run[k] - exact[k]).max() for k in "xv"] for run in runs])
    return np.asarray(np.log2(errors[:-1] / errors[1:]))


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize(
    ("scheme", "order"),
    [
        (fmbd.GeneralizedAlpha(), 2),
        (fmbd.GeneralizedAlpha(compiled=False), 2),
        (fmbd.GeneralizedAlpha(0.9, form=fmbd.GGL()), 2),
        (fmbd.Radau(2, rtol=None), 3),
        (fmbd.BDF(1, rtol=None), 1),
        (fmbd.BDF(2, rtol=None), 2),
        (fmbd.BDF(3, rtol=None), 3),
        (fmbd.schemes.Rattle(), 2),
        (fmbd.schemes.HalfExplicit(rtol=None), 4),
    ],
    ids=lambda x: getattr(x, "name", str(x)),
)
def test_order_across_named_jumps(pendulum_reference: fmbd.Run, scheme: Any, order: int, closed: bool) -> None:
    seen = orders(lambda: kicked_pendulum(closed=closed), pendulum_reference, scheme, (160, 320))
    assert (seen > order - 0.1).all(), seen


@pytest.mark.parametrize("scheme", [fmbd.Radau(3, rtol=None), fmbd.EnergyMomentum()], ids=lambda x: x.name)
def test_order_over_two_halvings(pendulum_reference: fmbd.Run, scheme: Any) -> None:
    """Velocities of the one scheme scatter between 1 and 2.8 from pair to pair; the other comes to the reference's error soon."""
    steps = (20, 40, 80) if scheme.order > 2 else (80, 160, 320)
    seen = orders(kicked_pendulum, pendulum_reference, scheme, steps).mean(axis=0)
    assert (seen > min(scheme.order, 4) - 0.6).all(), seen


@pytest.mark.parametrize("scheme", [fmbd.ContactAlpha(0.8), fmbd.ContactMidpoint()], ids=lambda x: x.name)
def test_order_of_schemes_for_contact(scheme: Any) -> None:
    stops, times = tuple(0.1 * x for x in STOPS), tuple(0.1 * t for t in TIMES)
    output = fmbd.Output(times=times, energy=False, progress=False)
    exact = fmbd.solve(kicked_block(stops), t_end=0.1, dt=0.1 / 640, scheme=fmbd.ContactMidpoint(), output=output)
    seen = orders(lambda: kicked_block(stops), exact, scheme, (20, 40), 0.1)
    assert (seen > 1.9).all(), seen


@pytest.mark.parametrize(
    "scheme",
    [
        fmbd.GeneralizedAlpha(),
        fmbd.Radau(2, rtol=None),
        fmbd.BDF(2, rtol=None),  # begins with order one
        fmbd.schemes.Rattle(),
        fmbd.EnergyMomentum(),
    ],
    ids=lambda x: x.name,
)
def test_accelerations_within_the_first_step_behind_a_jump(scheme: Any) -> None:
    """They lie between those behind it and those of the end of the step; with Rattle the ones before the jump were taken."""

    def run(**settings: Any) -> fmbd.Run:
        scene = kicked_pendulum()
        scene.sensor("a", fmbd.acceleration(scene.bodies["lower"]))
        times = (STOPS[0] - 1e-6, STOPS[0] + 1e-4, STOPS[0] + 3e-3)
        return fmbd.solve(scene, t_end=0.5, output=fmbd.Output(times=times, energy=False, progress=False), **settings)

    exact, found = run(dt=1e-3, scheme=FINE), run(dt=0.01, scheme=scheme)
    jump = np.abs(exact["a"][1] - exact["a"][0]).max()
    assert jump > 4.0 and np.abs(found["a"] - exact["a"]).max() < 0.1 * jump


def turned_bar(scheme: Any) -> fmbd.Run:
    """A bar on a pin, at rest up to 0.505 s and turned at 1 rad/s behind, as told by its angle alone."""
    bar = fmbd.RigidBody("bar", 1.0, 1 / 12, position=(0.5, 0.0))
    scene = fmbd.Scene("turned bar", gravity=(0.0, -9.81), breakpoints=(0.505,))
    pin = fmbd.revolute("pin", fmbd.ground, bar, center=(0.0, 0.0))
    scene.add(bar, pin, fmbd.drive("motor", fmbd.angle(pin), lambda t: max(float(t) - 0.505, 0.0)))
    scene.sensor("angle", fmbd.angle(pin))
    scene.sensor("rate", fmbd.angular_velocity(bar))
    return fmbd.solve(scene, t_end=1.0, dt=0.01, scheme=scheme)


@pytest.mark.parametrize(
    "scheme",
    [
        fmbd.GeneralizedAlpha(),
        fmbd.GeneralizedAlpha(compiled=False),
        fmbd.Radau(2, rtol=None),
        fmbd.BDF(2, rtol=None),
        fmbd.schemes.Rattle(),
        fmbd.schemes.HalfExplicit(rtol=None),
        fmbd.EnergyMomentum(),
    ],
    ids=lambda x: x.name,
)
def test_a_drive_with_a_kink_at_a_break_point(scheme: Any) -> None:
    """The rate of its motion jumps: differences that reached across would give half of it at the break point."""
    run = turned_bar(scheme)
    assert np.allclose(run["angle"][:, 0], np.clip(run.times - 0.505, 0.0, None), rtol=0, atol=1e-9)
    assert np.allclose(run["rate"][:, 0], run.times > 0.505 + 1e-9, rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    "scheme",
    [fmbd.ExplicitRungeKutta(rtol=1e-7), fmbd.HalfExplicit(rtol=1e-7), fmbd.Radau(3, rtol=1e-7)],
    ids=lambda x: x.name,
)
def test_what_a_drive_with_a_kink_moves(scheme: Any) -> None:
    """A slider on a spring along an arm of given angle: r'' = r w^2 - k / m (r - 1/2), on which w acts from its jump on."""
    arm, slider = fmbd.RigidBody("arm", 1.0, 0.1, (0.5, 0.0)), fmbd.RigidBody("slider", 0.5, 0.01, (0.5, 0.0))
    pin, rail = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0)), fmbd.prismatic("rail", arm, slider, axis=(1, 0))
    scene = fmbd.Scene("slider", breakpoints=(0.3,))
    scene.add(arm, slider, pin, rail, fmbd.joint_spring("spring", fmbd.displacement(rail), stiffness=50.0))
    scene.add(fmbd.drive("motor", fmbd.angle(pin), lambda t: np.interp(t, [0.0, 0.3, 1.0], [0.0, 0.6, -2.2])))
    scene.sensor("s", fmbd.displacement(rail))
    run = fmbd.solve(scene, t_end=0.9, scheme=scheme, output=fmbd.Output(energy=False, progress=False))

    r, v, t0 = 0.5, 0.0, 0.0
    for t1, rate in ((0.3, 2.0), (0.9, -4.0)):
        w, rest = np.sqrt(100.0 - rate**2), 50.0 / (100.0 - rate**2)
        t = t1 - t0
        c, s = np.cos(w * t), np.sin(w * t)
        r, v, t0 = rest + (r - rest) * c + v / w * s, v * c - (r - rest) * w * s, t1
    assert abs(run["s"][-1, 0] + 0.5 - r) < 2e-6 and run.counters["steps"] < 400


def test_stretches_of_equal_steps() -> None:
    """Sizes fit between break points, are not above the one asked for, and one where they differ by roundoff only."""
    plain = step_schedule(fmbd.Scene("s"), fmbd.GeneralizedAlpha(), 1.0, 0.01)
    assert plain.steps == 100 and not plain.stops and plain.next(0.5) == 0.01

    even = step_schedule(fmbd.Scene("s", breakpoints=(0.3, 0.6, 0.9)), fmbd.GeneralizedAlpha(), 1.0, 0.01)
    assert even.steps == 100
    assert len({even.next(t) for t in (0.0, 0.29, 0.31, 0.61, 0.95)}) == 1

    odd = step_schedule(fmbd.Scene("s", breakpoints=STOPS), fmbd.GeneralizedAlpha(), 1.0, 0.01, multiple=4)
    sizes = [odd.next(t) for t in (0.0, 0.5, 0.9)]
    assert np.allclose(sizes, [0.37 / 40, 0.243 / 28, 0.387 / 40], rtol=1e-12) and max(sizes) <= 0.01
    assert odd.with_steps(odd.steps // 2).counts == (20, 14, 20)
    assert [odd.left(n) for n in (0, 39, 40, 107)] == [40, 1, 28, 1]


@pytest.mark.parametrize("stops", [(-0.5, 0.0, 1.0, 7.0), (1e-12, 1.0 - 1e-12)])
def test_break_points_that_cut_nothing_change_nothing(stops: tuple[float, ...]) -> None:
    plain, cut = (fmbd.solve(kicked_pendulum(x), t_end=1.0, dt=0.01) for x in ((), stops))
    assert (plain["x"] == cut["x"]).all() and (plain.times == cut.times).all()


def test_break_points_that_are_one(pendulum_reference: fmbd.Run) -> None:
    once, often = (
        fmbd.solve(kicked_pendulum(x), t_end=1.0, dt=0.01, output=QUIET)
        for x in (STOPS, (*STOPS, *STOPS, 0.37 + 1e-13))
    )
    assert (once["x"] == often["x"]).all() and once.counters["steps"] == 101
    assert not once.warnings and any("all of what acts between them is lost" in line for line in often.warnings)


@pytest.mark.parametrize("length", [1e-9, 1e-11])
@pytest.mark.parametrize("scheme", [fmbd.GeneralizedAlpha(), fmbd.EnergyMomentum()], ids=lambda x: x.name)
def test_a_pulse_between_break_points_far_nearer_than_a_step(scheme: Any, length: float) -> None:
    """An impulse of 1 N s on a bar at rest: it acts, but for what the roundoff of time takes of it, which is said."""
    bar = fmbd.RigidBody("bar", 1.0, 0.1, position=(1.0, 0.0))
    begin, end = 0.5, 0.5 + length
    scene = fmbd.Scene("pulse", breakpoints=(begin, end))
    scene.add(bar, fmbd.revolute("pin", fmbd.ground, bar, center=(0, 0)))
    scene.add(fmbd.force("knock", bar, lambda t: (0.0, begin <= t < end and 1.0 / (end - begin))))
    scene.sensor("v", fmbd.velocity(bar))

    run = fmbd.solve(scene, t_end=0.6, dt=0.01, scheme=scheme)
    assert any("roundoff of time" in line for line in run.warnings)
    assert abs(np.linalg.norm(run["v"][-1]) * 1.1 - 1.0) < 33 * np.spacing(1.0) / length


@pytest.mark.parametrize("steps", [0, 400_000])
def test_where_steps_end_is_found_at_once_among_many_stops(steps: int) -> None:
    """A run of so many samples copied the list of those to come at every step."""

    def spent(count: int) -> float:
        stops = tuple(np.arange(1.0, count + 1).tolist())
        each = steps // 400_000
        counts = (each,) * count + (each,) if each else ()
        schedule = StepSchedule(count + 1.0, each * (count + 1), stops, counts=counts)
        assert schedule.next(2.0) > 0.0 and schedule.broken(near_side(2.0), 2) == far_side(
            2.0
        )  # places are listed once
        begin = clock.process_time()
        for k in range(200):
            t = 2.0 + 0.5 * (k % 3 == 0)
            assert schedule.next(t) > 0.0
            assert schedule.broken(t + 0.25, 4 * count) is None
            assert not each or schedule.left(count // 2) == 1
        return clock.process_time() - begin

    assert min(spent(100_000) for _ in range(3)) < 10 * min(spent(10) for _ in range(3))


def test_more_samples_than_a_list_holds_are_refused() -> None:
    scene = kicked_pendulum()
    scene.add(fmbd.pid("pid", fmbd.angle(scene.joints["pin"]), target=0.1, gains=(1.0, 0.0, 0.1), every=1e-9))
    with pytest.raises(
        InputError, match=r'"pid" samples every 1e-09 s, 1e\+09 times up to t_end = 1 s .* dt that divides'
    ):
        fmbd.solve(scene, t_end=1.0, scheme=fmbd.Radau(3))


def test_dense_break_points_are_told() -> None:
    run = fmbd.solve(kicked_pendulum(tuple(np.linspace(0.0, 1.0, 301))), t_end=1.0, dt=0.01)
    assert run.counters["steps"] == 300 and any("300 steps" in line for line in run.warnings), run.warnings


def test_records_are_ends_of_steps_and_the_end() -> None:
    run = fmbd.solve(kicked_pendulum(), t_end=1.0, dt=0.1)
    expected = [*np.linspace(0.0, 0.37, 5), *np.linspace(0.37, 0.613, 4)[1:], *np.linspace(0.613, 1.0, 5)[1:]]
    assert np.allclose(run.times, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("stops", [(), STOPS])
@pytest.mark.parametrize("scheme", [fmbd.GeneralizedAlpha(), fmbd.EnergyMomentum()], ids=lambda x: x.name)
def test_equal_steps_end_when_the_run_does(scheme: Any, stops: tuple[float, ...]) -> None:
    """Sums of 60 steps were 0.6000000000000003; what goes on begins there, and a snapshot is of the same time."""
    for t_end in (0.6, 0.7):
        output = fmbd.Output(snapshots=2, progress=False)
        run = fmbd.solve(kicked_pendulum(stops), t_end=t_end, dt=0.01, scheme=scheme, output=output)
        assert run.times[-1] == run.state.t == run.snapshots[-1].t == run.next_scene().begins == t_end


def test_errors_are_stated_across_a_jump(pendulum_reference: fmbd.Run) -> None:
    """Runs with 2 h and 4 h end their stretches at the same instants, show the order of the scheme, and no kink is suspected."""
    for scheme in (fmbd.GeneralizedAlpha(), fmbd.BDF(2, rtol=None), fmbd.schemes.Rattle()):
        run = fmbd.solve(
            kicked_pendulum(), t_end=1.0, dt=0.005, scheme=scheme,
            output=fmbd.Output(estimate_error=True, energy=False, progress=False),
        )  # fmt: skip
        fine = fmbd.solve(
            kicked_pendulum(),
            t_end=1.0,
            dt=0.005 / 8,
            scheme=FINE,
            output=fmbd.Output(times=tuple(run.times), energy=False),
        )
        for name in "xv":
            true = np.abs(run[name] - fine[name]).max()
            assert 0.5 < run.certificate[name].total / true < 3.0
        assert not run.certificate.uncertain


def test_a_sampled_controller_keeps_its_instants() -> None:
    """Stretches end at samples too: a break point beside them makes none late."""
    found = []
    for stops in ((), (0.055,)):
        scene = fmbd.Scene("held", breakpoints=stops)
        mass = fmbd.RigidBody("mass", 2.0, 0.1, position=(1.0, 0.0))
        rail = fmbd.prismatic("rail", fmbd.ground, mass, axis=(1.0, 0.0), center=(0.0, 0.0))
        scene.add(mass, rail)
        s = fmbd.displacement(rail)
        scene.add(fmbd.controller("c", law=lambda t, y, z: 1.0 - y["s"][0], reads={"s": s}, acts=s, every=0.1))
        scene.sensor("x", fmbd.position(mass))
        run = fmbd.solve(scene, t_end=0.5, dt=0.01)
        assert not run.warnings
        found.append(run["x"][-1, 0])
    assert abs(found[0] - found[1]) < 1e-9


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["rigid", "floating"])
def test_a_run_goes_on_from_a_checkpoint_between_jumps(name: str, shared_tmp: Path) -> None:
    """With one rank and with two: what a run with a checkpoint half-way gives is what it gives without, to the last bit."""

    def make() -> fmbd.Scene:
        return kicked_pendulum() if name == "rigid" else kicked_rod()

    whole = fmbd.solve(make(), t_end=1.0, dt=0.05)
    folder = shared_tmp / name
    fmbd.solve(make(), t_end=1.0, dt=0.05, checkpoint=fmbd.Checkpoint(folder, every=9))
    if world_size() > 1:  # others may be writing yet
        from mpi4py import MPI

        MPI.COMM_WORLD.barrier()
    run = fmbd.solve(make(), t_end=1.0, dt=0.05, restart=min(folder.glob("[0-9]*_step*")))
    assert (run["x"] == whole["x"]).all() and (run.times == whole.times).all()


def kicked_rod() -> fmbd.Scene:
    """A floating rod on a pin, its tip kicked twice."""
    body = fmbd.FloatingBody("rod", checkpoint_scenes.rod(), density=10.0, elastic=linear_elastic(3e3, 0.3))
    scene = fmbd.Scene("kicked rod", gravity=(0, -9.81), breakpoints=STOPS)
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0, 0)))
    values = (0.2, -0.3, 0.1)
    scene.add(fmbd.force("push", body.surface("tip"), lambda t: (values[sum(t >= x for x in STOPS)], 0.0)))
    scene.sensor("x", fmbd.position(body.surface("tip")))
    return scene


@pytest.mark.parametrize("scheme", [fmbd.GeneralizedAlpha(), fmbd.Radau(3, rtol=1e-9)], ids=lambda x: x.name)
def test_a_stepper_cuts_its_steps(pendulum_reference: fmbd.Run, scheme: Any) -> None:
    with fmbd.stepper(kicked_pendulum(), dt=0.0125, scheme=scheme) as s:
        for _ in range(80):
            s.step()
        plain = fmbd.solve(kicked_pendulum(()), t_end=1.0, dt=0.0125)["x"][-1] if scheme.rtol is None else 0.0
        error = np.abs(s["x"] - pendulum_reference["x"][-1]).max()
    assert abs(s.t - 1.0) < 1e-12
    assert error < (0.3 * np.abs(plain - pendulum_reference["x"][-1]).max() if scheme.rtol is None else 1e-7)


def test_steps_of_a_stepper_that_end_at_break_points(pendulum_reference: fmbd.Run) -> None:
    """Forces of the far side were those at the end of the step before: thirty times the error of equal steps."""
    run = fmbd.solve(kicked_pendulum(), t_end=1.0, dt=1e-3, output=QUIET)
    with fmbd.stepper(kicked_pendulum(), dt=1e-3) as s:
        for _ in range(1000):
            s.step()
        errors = [np.abs(x - pendulum_reference["x"][-1]).max() for x in (s["x"], run["x"][-1])]
    assert abs(s.t - 1.0) < 1e-12 and errors[0] < 1.1 * errors[1]
