"""Radau IIA: orders in every form, stiffness, error control, the step-size logic."""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle
from typing import Any

import numpy as np
import pytest
from chains import chain
from combinations import scene_of
from dae_problems import march, observed, pendulum, pendulum_at, pendulum_errors, spinning_top, state_errors

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError, InputError
from fmbd_fenicsx.linear.implicit.pencil import _equilibration
from fmbd_fenicsx.run import solve as solving
from fmbd_fenicsx.run.schedule import step_schedule
from fmbd_fenicsx.schemes.marching import MarchingStepper
from fmbd_fenicsx.schemes.onestep.collocation import tableau
from fmbd_fenicsx.schemes.onestep.radau import RadauStepper
from fmbd_fenicsx.schemes.onestep.stage_newton import StageNewton
from fmbd_fenicsx.schemes.rigid_motions import RigidMotions
from fmbd_fenicsx.system.compiled import choice

ORDERS = [
    (2, fmbd.Index3(), (3, 2, 1)),
    (2, fmbd.Index2(), (3, 3, 2)),
    (2, fmbd.Index1(), (3, 3, 3)),
    (2, fmbd.GGL(), (3, 3, 2)),
    (3, fmbd.Index3(), (5, 3, 2)),
    (3, fmbd.Index2(), (5, 5, 3)),
    (3, fmbd.GGL(), (5, 5, 3)),
    (2, fmbd.StateSpace(), (3, 3, 3)),
    (2, fmbd.Overdetermined(), (3, 3, 3)),
    (2, fmbd.Baumgarte(5, 5), (3, 3, 3)),
    (2, fmbd.Projected(fmbd.Index1()), (3, 3, 3)),
    (2, fmbd.Projected(fmbd.Index2()), (3, 3, 2)),
]


def test_tableau_is_radau_iia() -> None:
    three = tableau(3)
    root = np.sqrt(6)
    A = np.array([
        [(88 - 7 * root) / 360, (296 - 169 * root) / 1800, (-2 + 3 * root) / 225],
        [(296 + 169 * root) / 1800, (88 + 7 * root) / 360, (-2 - 3 * root) / 225],
        [(16 - root) / 36, (16 + root) / 36, 1 / 9],
    ])  # fmt: skip
    assert np.abs(three.W @ A - np.eye(3)).max() < 1e-13
    assert three.gamma == pytest.approx(3.6378342527444957, rel=1e-14)  # Hairer and Wanner, IV (8.18)
    assert three.error == pytest.approx(np.array([-13 - 7 * root, -13 + 7 * root, -1]) / 3, rel=1e-12)  # (8.20)
    two = tableau(2)
    assert np.abs(two.W @ np.array([[5 / 12, -1 / 12], [3 / 4, 1 / 4]]) - np.eye(2)).max() < 1e-13


@pytest.mark.parametrize(("stages", "form", "expected"), ORDERS, ids=lambda x: getattr(x, "name", None) or str(x))
def test_orders_on_the_pendulum(stages: int, form: fmbd.GGL, expected: tuple[int, int, int]) -> None:
    fine = stages == 2 or form.index == 3
    found = observed(fmbd.Radau(stages, form, None), (40, 80, 160) if fine else (20, 40, 80))
    assert (found > np.array(expected) - 0.15).all(), found


@pytest.mark.slow
def test_orders_of_three_stages_at_index_one() -> None:
    """The error of the multiplier changes its sign at h = 1/9: its order between neighbours is 1.3, 4.2, 4.6, 4.8, 4.9, 4.9 for
    8, 12, 16, 20, 24, 32, 40 steps. Newton is asked for all digits: errors are 1e-9.
    """
    found = observed(fmbd.Radau(3, fmbd.Index1(), None), (24, 32, 40, 48), tolerance=1e-13)
    assert (found > 4.85).all() and (found < 5.15).all(), found


@pytest.mark.slow
@pytest.mark.parametrize(("stages", "steps"), [(5, (3, 4, 5)), (7, (2, 3))])
def test_orders_of_many_stages_in_ggl_form(stages: int, steps: tuple[int, ...]) -> None:
    """2 s - 1 for position and velocity, s for the multiplier; coarse steps, before roundoff."""
    found = observed(fmbd.Radau(stages, fmbd.GGL(), None), steps, tolerance=1e-13)
    assert (found[:2] > 2 * stages - 1.5).all() and found[2] > stages - 0.5, found


def test_newton_with_constant_steps_does_not_trust_its_first_rate() -> None:
    """40 steps: one of them once stopped 400 tolerances early, and the multiplier was off by a third of its error."""
    errors = [pendulum_errors(fmbd.Radau(3, fmbd.Index1(), None), 1.0, n, 1e-13)[2] for n in (36, 40, 44)]
    assert np.log(errors[0] / errors[1]) / np.log(40 / 36) == pytest.approx(4.9, abs=0.2)
    assert np.log(errors[1] / errors[2]) / np.log(44 / 40) == pytest.approx(4.9, abs=0.2)


def test_frequencies_are_those_of_compiled_code_to_the_last_bit() -> None:
    """Factors made again from a checkpoint serve on as those of the run that was stopped."""
    for stages in (2, 3, 4):
        for h in (0.00016517608453569957, 0.3, 1.7e-5):
            values, found = tableau(stages).values, tableau(stages).frequencies(h)
            assert [(s.real, s.imag) for s in found] == [(x.real / h, x.imag / h) for x in values]


@pytest.mark.parametrize("stages", [5, 7])
def test_collocation_of_many_stages(stages: int) -> None:
    """Row sums and the quadrature order 2 s - 1 of the last row."""
    tab = tableau(stages)
    A = np.linalg.inv(tab.W)
    assert A.sum(axis=1) == pytest.approx(tab.c, abs=1e-13)
    k = np.arange(1, 2 * stages)
    assert (A[-1] * tab.c ** (k[:, None] - 1)).sum(axis=1) == pytest.approx(1 / k, abs=1e-13)
    assert (tab.vectors * tab.values @ tab.inverse).real == pytest.approx(tab.W, abs=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize(("stages", "form", "expected"), ORDERS[:7], ids=lambda x: getattr(x, "name", None) or str(x))
def test_orders_in_space(stages: int, form: fmbd.GGL, expected: tuple[int, int, int]) -> None:
    """The same on SO(3): local coordinates keep the orders."""
    scene = spinning_top()
    reference = march(scene, fmbd.Radau(3, fmbd.StateSpace(), None), 0.5, 240)[-1]
    steps = (20, 40, 80) if stages == 2 else (10, 20, 40)
    errors = np.array(
        [state_errors(scene, march(scene, fmbd.Radau(stages, form, None), 0.5, n)[-1], reference) for n in steps]
    )
    found = np.log2(errors[-2] / errors[-1])
    assert (found > np.array(expected) - 0.15).all(), found


@pytest.mark.parametrize("form", [fmbd.GGL(), fmbd.Index3(), fmbd.StateSpace()], ids=lambda f: f.name)
def test_constraints_that_a_form_holds(form: fmbd.GGL) -> None:
    run = fmbd.solve(pendulum(), t_end=2.0, scheme=fmbd.Radau(form=form, rtol=1e-5))
    assert run.drift[0] < 1e-6  # what Newton leaves of rtol
    assert (run.drift[1] < 1e-5) == (form.name != "Index3")


def test_drift_of_lower_index_and_its_cures() -> None:
    drift = {}
    for form in (fmbd.Index2(), fmbd.Index1(), fmbd.Baumgarte(20, 20), fmbd.Projected(fmbd.Index1())):
        drift[form.name] = fmbd.solve(pendulum(), t_end=5.0, scheme=fmbd.Radau(form=form, rtol=1e-4)).drift
    assert 1e-6 < drift["Index2"][0] and drift["Index2"][1] < 1e-3
    assert drift["Index1"][0] > 1e-6
    assert drift["Baumgarte(20, 20)"][0] < 0.1 * drift["Index1"][0]
    assert max(drift["Projected(Index1)"]) < 1e-12


@pytest.mark.parametrize("stages", [2, 3])
@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-9])
def test_error_follows_the_tolerance(stages: int, rtol: float) -> None:
    if stages == 2 and rtol < 1e-6:
        pytest.skip("order 3 takes 1500 steps")
    run = fmbd.solve(pendulum(), t_end=1.0, scheme=fmbd.Radau(stages, rtol=rtol))
    x, v, _ = pendulum_at(1.0)
    assert np.abs(run["x"][-1] - x).max() < 2 * rtol
    assert np.abs(run["v"][-1] - v).max() < 10 * rtol


def test_index_three_rejects_no_steps_for_inherited_errors() -> None:
    """The estimate starts from consistent rates: the last step's normal velocity error is not taken for this step's."""
    run = fmbd.solve(pendulum(), t_end=1.0, scheme=fmbd.Radau(form=fmbd.Index3(), rtol=1e-7))
    assert run.counters["rejections"] <= 2
    assert run.counters["steps"] < 130


@pytest.mark.parametrize("stages", [5, 7])
@pytest.mark.parametrize("rate", [20.0, 60.0, 90.0])
def test_rates_of_shorter_steps_are_not_believed(stages: int, rate: float) -> None:
    """A wheel on a torsion spring, 2.5 rad a step: the first step, short and nearly linear, said nothing of the next ones."""
    axis, inertia, stiffness, end = np.array((1.0, 2.0, -2.0)) / 3, 0.3, 0.7, 0.5
    wheel = fmbd.RigidBody("wheel", 2.0, (inertia,) * 3, angular_velocity=rate * axis)
    hinge = fmbd.revolute("hinge", fmbd.ground, wheel, center=(0, 0, 0), axis=axis)
    scene = fmbd.Scene("wheel")
    scene.add(wheel, hinge, fmbd.joint_spring("spring", fmbd.angle(hinge), stiffness=stiffness))
    scene.sensor("angle", fmbd.angle(hinge))
    run = fmbd.solve(scene, t_end=end, scheme=fmbd.Radau(stages))
    w = np.sqrt(stiffness / inertia)
    assert run["angle"][-1, 0] == pytest.approx(rate / w * np.sin(w * end), rel=1e-6)
    assert run.drift[0] < 1e-7


def test_tangent_space_of_a_start_lasts_for_a_quarter_turn() -> None:
    axis, rate, ratio = np.array((0.3, -0.7, 0.2)) / np.sqrt(0.62), 17.0, -3.3
    scene, coordinates = fmbd.Scene("gear"), []
    for k, speed in enumerate((rate, ratio * rate)):
        wheel = fmbd.RigidBody(f"wheel {k}", 1.0, (0.2,) * 3, position=(k, 0, 0), angular_velocity=speed * axis)
        hinge = fmbd.revolute(f"hinge {k}", fmbd.ground, wheel, center=(k, 0, 0), axis=axis)
        scene.add(wheel, hinge)
        coordinates.append(fmbd.angle(hinge))
    scene.add(fmbd.gear("gear", *coordinates, ratio=ratio))
    scene.sensor("angle", coordinates[0])
    run = fmbd.solve(scene, t_end=1.0, scheme=fmbd.Radau(form=fmbd.StateSpace()))
    assert run["angle"][-1, 0] == pytest.approx(rate, rel=1e-7)
    assert "rejected: Newton diverged" not in run.counters
    assert run.counters["jacobians"] < 200


def test_no_roundoff_is_feared_at_rest() -> None:
    """A guard compares with forces that could be there: no load, no speed, no warning."""
    body = fmbd.RigidBody("body", 7.3, 0.21, position=(0.37, -0.81))
    scene = fmbd.Scene("rest")
    scene.add(body, fmbd.Spring("spring", fmbd.ground, body, (0, 0), stiffness=1e5, length=float(np.hypot(0.37, 0.81))))
    assert fmbd.solve(scene, t_end=0.1, scheme=fmbd.Radau()).warnings == []


def test_units_do_not_change_the_steps() -> None:
    """The same motion in metres and in millimetres takes the same steps."""

    def scene(unit: float) -> fmbd.Scene:
        made = fmbd.Scene("crank", gravity=(0, -9.81 * unit))
        body = fmbd.RigidBody("rod", 1.0, 0.1 * unit**2, position=(0.5 * unit, 0))
        made.add(body, fmbd.revolute("pin", body, fmbd.ground, center=(0, 0)))
        return made

    runs = [fmbd.solve(scene(u), t_end=1.0, scheme=fmbd.Radau(rtol=1e-6)) for u in (1.0, 1e3)]
    assert abs(runs[0].counters["steps"] - runs[1].counters["steps"]) <= 1
    assert runs[0].state.q[2] == pytest.approx(runs[1].state.q[2], abs=1e-7)


def test_break_points_and_the_end_are_hit_exactly() -> None:
    def scene(breaks: tuple[float, ...]) -> fmbd.Scene:
        made = fmbd.Scene("kick", breakpoints=breaks)
        made.add(
            fmbd.CoordinateBody("mass", np.eye(1), lambda q, v, t: np.array([1.0 if t >= 0.3 else 0.0]), [0.0], [1.0])
        )
        made.sensor("x", fmbd.coordinates("mass"))
        return made

    run = fmbd.solve(scene((0.3,)), t_end=1.0, scheme=fmbd.Radau(rtol=1e-8))
    assert np.abs(run.times - 0.3).min() < 1e-14 and run.times[-1] == pytest.approx(1.0, abs=1e-15)
    assert run["x"][-1, 0] == pytest.approx(1.0 + 0.5 * 0.7**2, abs=1e-9)
    blind = fmbd.solve(scene(()), t_end=1.0, scheme=fmbd.Radau(rtol=1e-8))
    assert blind.counters["rejections"] > run.counters["rejections"]


@pytest.mark.parametrize(
    "scheme",
    [fmbd.Radau(2, rtol=1e-6), fmbd.BDF(rtol=1e-5), fmbd.HalfExplicit(rtol=1e-6)],
    ids=lambda s: s.name,
)
def test_neither_ends_on_the_way_nor_a_largest_step_change_what_errors_are_measured_by(
    scheme: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From rest velocities count by those that are reached before something may break: a mark at 0.05 s made 312 steps of 236."""

    def steps(dt: float | None = None, marks: tuple[float, ...] = ()) -> float:
        marked = lambda *given: replace(step_schedule(*given), marks=marks)  # noqa: E731
        monkeypatch.setattr(solving, "step_schedule", lambda *given, multiple: marked(*given))
        return fmbd.solve(chain(2, "chain")[0], t_end=1.0, dt=dt, scheme=scheme).counters["steps"]

    alone = steps()
    assert abs(steps(dt=0.05) - alone) <= 2 and abs(steps(marks=(0.05,)) - alone) <= 2


def test_a_jump_that_cannot_be_passed_is_reported_with_its_history() -> None:
    scene = fmbd.Scene("wall")

    def force(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        return np.array([np.nan if t > 0.5 else -1.0 + 0.0 * q[0]])

    scene.add(fmbd.CoordinateBody("mass", np.eye(1), force, [0.0], [1.0]))
    with pytest.raises(
        ConvergenceError, match=r"t = 0\.[45]\d* s cannot be made smaller: \d+ rejections.*forces not finite"
    ):
        fmbd.solve(scene, t_end=1.0, scheme=fmbd.Radau(rtol=1e-6))


def test_a_second_sum_that_is_no_number_passes_no_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """The step is refused as by a first one, which max() took instead."""

    sizes = cycle((0.5, np.nan))
    monkeypatch.setattr(choice, "driver_of", lambda *system: None)
    monkeypatch.setattr(RadauStepper, "_filtered_size", lambda *given: next(sizes))
    with pytest.raises(ConvergenceError, match="cannot be made smaller"):
        fmbd.solve(pendulum(), t_end=0.1, scheme=fmbd.Radau(rtol=1e-6))


def test_arguments_that_make_no_sense() -> None:
    with pytest.raises(InputError, match="stages = 4"):
        fmbd.Radau(stages=4)
    with pytest.raises(InputError, match="rtol = 1e-16"):
        fmbd.Radau(rtol=1e-16)
    with pytest.raises(InputError, match="give dt"):
        fmbd.solve(pendulum(), t_end=1.0, scheme=fmbd.Radau(rtol=None))
    with pytest.raises(InputError, match="project Index1 or Index2"):
        fmbd.Projected(fmbd.GGL())
    with pytest.raises(InputError, match="must be positive"):
        fmbd.Baumgarte(-1.0, 1.0)


def test_rows_and_columns_of_a_pencil_are_equilibrated() -> None:
    """Largest entries of all rows and columns come near one, whatever units the unknowns and equations have; exactly, by powers
    of two.
    """
    rng = np.random.default_rng(5)
    K = rng.uniform(0.5, 1.0, (2, 6, 6)) * rng.choice([-1.0, 1.0], (2, 6, 6))
    K *= 10.0 ** rng.uniform(-3, 3, (2, 6, 1)) * 10.0 ** rng.uniform(-3, 3, (2, 1, 6))
    K[:, 0, 1] = 0.0
    rows, columns = _equilibration(K)
    scaled = np.abs(rows[:, :, None] * K * columns[:, None, :])
    assert (scaled.max(axis=1) > 0.05).all() and (scaled.max(axis=1) < 4.0).all()
    assert (scaled.max(axis=2) > 0.5).all() and (scaled.max(axis=2) < 2.0).all()
    assert (np.frexp(np.stack([rows, columns]))[0] == 0.5).all()


def beyond_reach() -> fmbd.Scene:
    """A crank and a rod whose end is pushed along a line further than both are long."""
    scene = fmbd.Scene("reach")
    crank, rod = (fmbd.RigidBody(name, 1.0, 0.1, position=(x, 0.3)) for name, x in (("crank", 0.4), ("rod", 1.2)))
    slot = fmbd.point_on_line("slot", fmbd.ground, rod, center=(1.6, 0.0), axis=(1, 0))
    scene.add(crank, rod, fmbd.revolute("pin", fmbd.ground, crank, center=(0, 0)))
    scene.add(fmbd.revolute("knee", crank, rod, center=(0.8, 0.6)), slot)
    scene.add(fmbd.drive("push", fmbd.displacement(slot), lambda t: t * t))
    return scene


@pytest.mark.parametrize(
    "scheme", [fmbd.Radau(rtol=None), fmbd.BDF(order=2, rtol=None)], ids=lambda x: type(x).__name__
)
def test_joints_that_stay_open_are_named(scheme: Any) -> None:
    """What no iteration can close is told with its joint, its gap and its cause, beside that Newton failed."""
    with pytest.raises(
        ConvergenceError, match=r'left joint "knee" .* open by .* m after t = 0\.62 s: drives and joints may'
    ):
        fmbd.solve(beyond_reach(), t_end=1.0, dt=0.02, scheme=scheme)


def test_what_an_earlier_step_left_open_is_forgotten() -> None:
    with pytest.raises(ConvergenceError, match="singular configuration") as error:
        fmbd.solve(beyond_reach(), t_end=1.0, scheme=fmbd.Radau(rtol=1e-4))
    assert "t = 0.0" not in str(error.value)


def shaken_rod() -> fmbd.Scene:
    """A stiff rod with a bob at its end, let go: its sections shear to and fro at 1e5 rad/s."""
    section = fmbd.RodSection.circle(youngs_modulus=2e9, poisson_ratio=0.3, density=7800, radius=0.01)
    rod = fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], section, elements=2)
    bob = fmbd.RigidBody("bob", 1.0, (0.01, 0.01, 0.01), position=(1.0, 0, 0))
    scene = fmbd.Scene("shaken", gravity=(0, 0, -9.81))
    pin = fmbd.revolute("pin", fmbd.ground, rod.surface("start"), center=(0, 0, 0), axis=(0, 1, 0))
    scene.add(rod, bob, pin, fmbd.fixed("weld", rod.surface("end"), bob, center=(1, 0, 0)))
    scene.sensor("bob", fmbd.position(bob))
    return scene


def test_vibrations_of_rods_do_not_hold_steps_down() -> None:
    """Rates of deformations count by the places that they lead to, those of nodes of rods like those of fields."""
    run = fmbd.solve(shaken_rod(), t_end=0.01, scheme=fmbd.Radau(3, rtol=1e-6))
    assert run.counters["steps"] < 60  # 439 with rates that count like velocities
    fine = fmbd.solve(shaken_rod(), t_end=0.01, dt=1e-5, output=fmbd.Output(every=1000))
    assert np.abs(run["bob"][-1] - fine["bob"][-1]).max() < 1e-7


def test_rigid_motions_of_rods_are_no_deformations() -> None:
    """Translations and turns of a bent rod in world axes; turns of its sections alone are deformations."""
    system, state, _ = shaken_rod().build()
    rng = np.random.default_rng(1)
    state = replace(state, q=system.compose(state.q, 0.1 * rng.standard_normal(system.n_v)))
    motions, ev = RigidMotions.at(system, state), system.at(state.t, state.q)
    rod = np.unique(system.elements[0].frames)
    v, w, twists = rng.standard_normal(3), rng.standard_normal(3), np.zeros((system.n_frames, 6))
    twists[rod, :3] = v + np.cross(w, ev.pose[rod, :3])
    twists[rod, 3:] = np.swapaxes(ev.rotation[rod], 1, 2) @ w
    assert np.abs(motions.rest(twists.ravel())).max() < 1e-12

    twists[rod, :3] = 0.0
    assert np.abs(motions.rest(twists.ravel()) - twists.ravel()).max() < 0.02


def linked(mass: float, dim: int) -> fmbd.Scene:
    """Two heavy bodies that hang on each other by a link of this mass (kg)."""

    def inertia(m: float) -> Any:
        return 0.1 * m if dim == 2 else (0.1 * m,) * 3

    def body(name: str, m: float, x: float) -> fmbd.RigidBody:
        return fmbd.RigidBody(name, m, inertia(m), (x, 0.0, 0.0)[:dim])

    def hinge(name: str, a: Any, b: Any, x: float, axis: tuple[int, int, int]) -> Any:
        return fmbd.revolute(name, a, b, center=(x, 0.0, 0.0)[:dim], **({"axis": axis} if dim == 3 else {}))

    first, link, last = body("first", 1.0, 0.5), body("link", mass, 1.5), body("last", 1.0, 2.5)
    scene = fmbd.Scene("linked", gravity=(0.0, -9.81, 0.0)[:dim])
    scene.add(
        first, link, last, hinge("pin", fmbd.ground, first, 0.0, (0, 0, 1)), hinge("knee", first, link, 1.0, (0, 0, 1))
    )
    scene.add(hinge("wrist", link, last, 2.0, (0, 1, 0)))
    scene.sensor("angle", fmbd.angle("pin"))
    scene.sensor("force", fmbd.reaction_force("knee"))
    return scene


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("form", [fmbd.GGL(), fmbd.Index3()], ids=lambda x: x.name)
@pytest.mark.parametrize("compiled", [True, False], ids=["C", "steps in turn"])
def test_a_light_link_takes_no_small_steps(
    compiled: bool, form: Any, dim: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reactions turn with a link and push nothing by that; steps were a fifteenth, by what they do where they stay."""
    if not compiled:
        monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)

    def run(mass: float, rtol: float, stages: int = 3) -> fmbd.Run:
        times = tuple(np.linspace(0.0, 0.6, 7))
        scheme = fmbd.Radau(stages, form=form, rtol=rtol)
        return fmbd.solve(linked(mass, dim), t_end=0.6, scheme=scheme, output=fmbd.Output(times=times, progress=False))

    heavy, light = (run(mass, 1e-5) for mass in (1.0, 1e-8))
    assert light.counters["steps"] < 2.5 * heavy.counters["steps"]
    for name in ("angle", "force"):  # errors are those of heavy links
        other, error = (np.abs(x[name] - run(m, 1e-8, 5)[name]).max() for m, x in ((1.0, heavy), (1e-8, light)))
        assert error < 2.0 * other, name


def test_compiled_steps_that_fail_time_and_again_take_a_tangent_for_each_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    """As those of Python do; with one tangent for all stages twice as many had no end."""

    def rejections() -> float:
        scheme = fmbd.Radau(form=fmbd.Index3(), rtol=1e-5)
        return float(fmbd.solve(linked(1e-8, 3), t_end=0.6, scheme=scheme).counters["rejections"])

    compiled = rejections()
    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)
    assert compiled <= 1.3 * rejections()


@pytest.mark.parametrize("stages", [3, 5])
def test_stiff_springs_that_turn_take_few_tangents_of_each_stage(stages: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nearly each step took them, in tens of times the time of a shorter step with one tangent for all."""
    hub, rim = (
        fmbd.RigidBody("hub", 1.0, 0.1, (0.5, 0.0)),
        fmbd.RigidBody("rim", 1.0, 0.1, (1.5, 0.0), velocity=(0.0, 3.0)),
    )
    scene = fmbd.Scene("turning spring", gravity=(0.0, -9.81))
    scene.add(hub, rim, fmbd.revolute("hinge", fmbd.ground, hub, center=(0.0, 0.0)))
    scene.add(fmbd.Spring("spring", hub, rim, (1.0, 0.0), (1.5, 0.0), stiffness=1e5, damping=5e3, length=0.5))
    scene.sensor("rim", fmbd.position(rim))
    full: list[float] = []
    iterate = StageNewton.iterate_full
    monkeypatch.setattr(StageNewton, "iterate_full", lambda self, h, start: full.append(h) or iterate(self, h, start))
    run = fmbd.solve(scene, t_end=2.0, scheme=fmbd.Radau(stages, rtol=1e-5))
    assert 0 < len(full) < 0.15 * run.counters["steps"]
    fine = fmbd.solve(scene, t_end=2.0, scheme=fmbd.Radau(stages, rtol=1e-9))
    assert run["rim"][-1] == pytest.approx(fine["rim"][-1], abs=1e-4)


def spatial_four_bar() -> fmbd.Scene:
    """A crank and a rocker about skew axes with a rod between them; the crank starts by a moment of sin(t)."""
    crank = fmbd.RigidBody("crank", 1.0, (1e-3, 4e-3, 4.5e-3), (0.1, 0.0, 0.0))
    rocker = fmbd.RigidBody("rocker", 2.0, (4e-2, 4e-2, 1e-3), (0.3, 0.6, 0.35))
    hinge = fmbd.revolute("crank hinge", fmbd.ground, crank, center=(0.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0))
    other = fmbd.revolute("rocker hinge", fmbd.ground, rocker, center=(0.3, 0.6, 0.1), axis=(1.0, 0.3, 0.0))
    rod = fmbd.distance("rod", crank, rocker, point_a=(0.2, 0.0, 0.0), point_b=(0.3, 0.6, 0.6))
    scene = fmbd.Scene("spatial four-bar", gravity=(0.0, 0.0, -9.81))
    scene.add(crank, rocker, hinge, other, rod)
    scene.add(fmbd.effort("torque", fmbd.angle(hinge), lambda t: 3.0 * np.sin(t)))
    scene.sensor("crank", fmbd.angle(hinge))
    return scene


def test_stages_that_ran_away_leave_no_directions() -> None:
    """A first step that is far too long fails with a tangent for each stage; the ones after it were refused down to 1e-14 s, by
    directions of constraints at stages of 1e22 m.
    """
    soon = fmbd.Output(times=(0.2,), events=[fmbd.Event("crank", 0.01)], progress=False)
    far, near = (
        fmbd.solve(spatial_four_bar(), t_end=end, scheme=fmbd.Radau(2, rtol=1e-8), output=soon) for end in (3.0, 0.5)
    )
    assert abs(far.times[-1] - near.times[-1]) < 1e-6


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("rtol", [1e-4, 1e-6])
def test_a_drive_that_sets_in_steeply_leaves_no_open_joint(
    rtol: float, compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At rest an increment leaves roundoff; the first one behind it leaves more, and was trusted to leave as little."""
    if not compiled:
        monkeypatch.setattr(MarchingStepper, "march", lambda *given: 0)
    arm = fmbd.RigidBody("arm", 1.0, 0.1, position=(0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
    scene = fmbd.Scene("ramp")
    scene.add(arm, pin, fmbd.drive("turn", fmbd.angle(pin), lambda t: 0.5 * (1.0 + np.tanh((t - 0.1) / 1e-2))))
    scene.sensor("centre", fmbd.position(arm))
    run = fmbd.solve(scene, t_end=0.2, scheme=fmbd.Radau(3, rtol=rtol))
    assert np.abs(np.hypot(*run["centre"].T) - 0.5).max() < 1e-3 * rtol


@pytest.mark.parametrize("compiled", [True, False])
def test_vibrations_that_are_not_resolved_are_not_foretold(compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A polynomial of the last step through them ran away, and Newton with it: 15 increments a step, 2 steps halved."""
    if not compiled:
        monkeypatch.setattr(MarchingStepper, "march", lambda *given: 0)
    ends = fmbd.Output(times=(0.0, 0.02), energy=False, progress=False)
    run = fmbd.solve(scene_of("beam", "spring", ""), t_end=0.02, dt=1e-3, scheme=fmbd.Radau(5, rtol=None), output=ends)
    assert not run.counters.get("halved_steps")
    assert run.counters["newton_iterations"] < 9 * run.counters["steps"]
