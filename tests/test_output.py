"""What a run records, and its estimate of the time-discretisation error."""

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError, InputError
from fmbd_fenicsx.run.accuracy import equal_steps
from fmbd_fenicsx.run.recording.progress_bar import Progress


def pendulum():
    """A rigid pendulum released from the horizontal."""
    bob = fmbd.RigidBody("bob", 1.0, 0.1, position=(1.0, 0.0))
    scene = fmbd.Scene("swing", gravity=(0, -9.81))
    scene.add(bob, fmbd.revolute("pin", fmbd.ground, bob, center=(0, 0)))
    scene.sensor("bob", fmbd.position(bob))
    scene.sensor("force", fmbd.reaction("pin"))
    return scene


def solve(dt, **output):
    return fmbd.solve(pendulum(), t_end=1.0, dt=dt, output=fmbd.Output(**output))


def test_every_and_snapshots_keep_first_and_last():
    run = solve(0.01, every=30, snapshots=3)
    assert np.allclose(run.times, [0, 0.3, 0.6, 0.9, 1.0])
    assert [round(s.t, 9) for s in run.snapshots] == [0.0, 0.5, 1.0]
    assert run["bob"].shape == (5, 2) and run.energy["kinetic"].shape == (5,)


def test_without_energy_no_energy_is_recorded():
    assert solve(0.1, energy=False).energy == {}


def test_steps_between_given_times_are_made_in_one_call(monkeypatch):
    """Those that pass an instant too; values are those of single steps to the last bit."""
    from fmbd_fenicsx.schemes.onestep.alpha.compiled_stepper import CompiledAlphaStepper

    calls, march = [], CompiledAlphaStepper._steps
    monkeypatch.setattr(CompiledAlphaStepper, "_steps", lambda self, h, n, *x: calls.append(n) or march(self, h, n, *x))
    times = (0.0, 0.1237, 0.5, 0.7501)
    run = solve(1e-3, times=times)
    assert sum(calls) == 1000 and len(calls) < 8

    one_by_one = solve(1e-3, times=times, on_step=lambda now: None)
    assert np.allclose(run.times, times, rtol=1e-12) and np.array_equal(run.times, one_by_one.times)
    for name in ("bob", "force"):
        assert np.array_equal(run[name], one_by_one[name])


@pytest.mark.parametrize("scheme", [fmbd.EnergyMomentum(), fmbd.Rattle()], ids=lambda s: s.name)
def test_values_between_steps_are_as_good_as_those_at_their_ends(scheme):
    """Straight lines left up to twice what the steps do, by where in them an instant fell: other steps did not tell it."""
    times = tuple(np.linspace(0, 1, 41))
    exact = fmbd.solve(pendulum(), t_end=1.0, scheme=fmbd.Radau(5, rtol=1e-10), output=fmbd.Output(times=times))

    def error(steps):
        run = fmbd.solve(pendulum(), t_end=1.0, dt=1 / steps, scheme=scheme, output=fmbd.Output(times=times))
        return steps**2 * np.abs(run["force"] - exact["force"]).max()

    # 84, 94 and 106 of their ends meet few of the instants, 80 and 120 all of them
    assert max(error(n) for n in (84, 94, 106)) < 1.1 * max(error(n) for n in (80, 120))


@pytest.mark.parametrize("bad", [{"every": 0}, {"snapshots": -1}])
def test_impossible_output_is_refused(bad):
    with pytest.raises(fmbd.errors.InputError):
        fmbd.Output(**bad)


@pytest.fixture(scope="module")
def fine():
    return solve(2e-4, energy=False)


def test_times_after_the_end_are_refused():
    output = fmbd.Output(times=(0.05, 0.1, 0.2, 0.3))
    with pytest.raises(InputError, match=r"up to 0\.3 s, and the run ends at t_end = 0\.1 s: 2 of 4"):
        fmbd.solve(pendulum(), t_end=0.1, dt=0.01, output=output)


@pytest.mark.parametrize("every", [1, 7])
def test_estimate_is_the_error_to_30_percent(every, fine):
    run = solve(0.01, every=every, estimate_error=True)
    rows = np.rint(run.times / 2e-4).astype(int)
    for name in ("bob", "force"):
        error = np.abs(run[name] - fine[name][rows]).max()
        assert 0.7 < run.error_estimate[name] / error < 1.3, name


def test_estimate_falls_with_the_square_of_the_step_and_costs_apart():
    coarse, fine = (solve(dt, estimate_error=True) for dt in (0.01, 0.005))
    assert coarse.observed_order["bob"] == pytest.approx(2.0, abs=0.1)
    assert coarse.error_estimate["bob"] / fine.error_estimate["bob"] == pytest.approx(4.0, rel=0.1)
    assert fine.counters == solve(0.005).counters
    assert "error estimate" in fine.seconds


def test_the_number_of_steps_becomes_a_multiple_of_four_for_the_estimate():
    run = fmbd.solve(pendulum(), t_end=0.9, dt=0.1, output=fmbd.Output(estimate_error=True))
    assert run.counters["steps"] == 12 and run.dt == pytest.approx(0.075)


def soft_rod(rod_mesh, ramp):
    rod = fmbd.FloatingBody(
        "rod", rod_mesh(h=0.2), degree=2, density=1e3, elastic=fmbd.materials.linear_elastic(5e6, 0.3)
    )
    scene = fmbd.Scene("soft", gravity=(0, -9.81), gravity_ramp=ramp)
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
    scene.sensor("tip", fmbd.velocity(rod.surface("tip")))
    scene.sensor("force", fmbd.reaction("pin"))
    return scene


@pytest.mark.parametrize(("ramp", "low", "high"), [(0.2, 0.8, 1.25), (0.0, 0.6, 4.0)], ids=["smooth", "sudden"])
def test_estimate_of_an_elastic_rod_is_honest_also_where_the_step_does_not_resolve_it(rod_mesh, ramp, low, high):
    scene = soft_rod(rod_mesh, ramp)
    fine = fmbd.solve(scene, t_end=0.4, dt=2e-4, output=fmbd.Output(energy=False))
    run = fmbd.solve(scene, t_end=0.4, dt=4e-3, output=fmbd.Output(energy=False, estimate_error=True))
    for name in ("tip", "force"):
        error = np.abs(run[name] - fine[name][::20]).max()
        assert low < run.error_estimate[name] / error < high, name
    resolved = [p > 1.7 for p in run.observed_order.values()]
    assert all(resolved) if ramp else not any(resolved)
    assert ("does not resolve all motion" in run.report()) == (ramp == 0)


def test_where_runs_with_larger_steps_fail_one_with_half_the_step_tells_the_error():
    run = fmbd.solve(pendulum(), t_end=2.4, dt=0.2, output=fmbd.Output(estimate_error=True))
    fine = fmbd.solve(pendulum(), t_end=2.4, dt=2e-3, output=fmbd.Output(every=100))
    for name, values in run.series.items():
        assert 0.5 < run.error_estimate[name] / np.abs(values - fine[name]).max() < 2.0, name


def test_other_runs_that_fail_leave_the_run_without_estimate(monkeypatch):
    def failing(*args, **kwargs):
        raise ConvergenceError("too large")

    monkeypatch.setattr(equal_steps, "again", failing)
    run = fmbd.solve(pendulum(), t_end=0.4, dt=0.1, output=fmbd.Output(estimate_error=True))
    assert run.status == "finished" and run.error_estimate == {}
    assert "the run with 2 h failed" in run.report()


@pytest.mark.parametrize("every", [1, 7])
def test_the_bar_of_progress_comes_to_its_end(every, monkeypatch):
    """Steps that are taken many at a time count each."""
    shown = []
    monkeypatch.setattr(Progress, "update", lambda self, steps=1: shown.append(steps))
    body = fmbd.RigidBody("body", 1.0, 0.1, position=(1.0, 0.0))
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81))
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body, center=(0.0, 0.0)))
    fmbd.solve(scene, t_end=0.1, dt=1e-3, output=fmbd.Output(every=every))
    assert sum(shown) == 100


@pytest.mark.parametrize("given", [{"dt": 0.02}, {"rtol": 1e-3}], ids=["equal", "own"])
@pytest.mark.parametrize("compiled", [True, False])
def test_joints_are_closed_between_the_ends_of_steps(compiled, given):
    """A crank without freedom is where its drive says at any instant; the cubic through the ends of steps was 1e-5 m off."""
    from test_variable_alpha import driven_crank

    scheme = fmbd.GeneralizedAlpha(compiled=compiled, rtol=given.get("rtol"))
    output = fmbd.Output(times=tuple(np.linspace(0.0, 0.6, 47)), energy=False)
    run = fmbd.solve(driven_crank(), t_end=0.6, dt=given.get("dt"), scheme=scheme, output=output)
    angle = run["angle"].ravel()
    exact = 0.2 * np.cos(angle) + np.sqrt(0.36 - (0.2 * np.sin(angle)) ** 2)
    assert np.ptp(angle) > 1.0
    assert np.abs(run["slider"][:, 0] - exact).max() < 1e-9


def test_rows_on_velocities_move_nothing_between_the_ends_of_steps():
    """A wheel that rolls in space: compiled and NumPy steps give the same places and angles there."""
    import unit_scenes

    found = []
    for compiled in (True, False):
        scene = unit_scenes.rolling(unit_scenes.Units(1.0, 1.0, 1.0)).scene
        output = fmbd.Output(times=tuple(np.linspace(0.0, 0.4, 23)), energy=False)
        found.append(
            fmbd.solve(scene, t_end=0.4, dt=0.02, scheme=fmbd.GeneralizedAlpha(compiled=compiled), output=output)
        )
    fine = fmbd.solve(scene, t_end=0.4, dt=1e-3, output=output)
    for name in ("place", "blade"):
        assert np.abs(found[0][name] - found[1][name]).max() < 1e-9
        assert np.abs(found[0][name] - fine[name]).max() < 2e-3


def test_records_that_no_machine_holds_are_refused_and_long_runs_are_told_of(caplog):
    """Before the first step: a time in a wrong unit, here in nanoseconds."""
    with pytest.raises(fmbd.errors.InputError, match=r"1e\+12 steps of 0\.001 s up to t_end = 1e\+09 s .* GiB"):
        fmbd.solve(pendulum(), t_end=1e9, dt=1e-3)

    # hours: told, and begun
    def stop(now):
        raise KeyboardInterrupt

    with pytest.raises((fmbd.errors.Stopped, KeyboardInterrupt)):
        fmbd.solve(pendulum(), t_end=1e6, dt=1e-3, output=fmbd.Output(every=10**6, on_step=stop))
    assert [x for x in caplog.messages if "1e+09 steps" in x and "2.8 hours" in x]
