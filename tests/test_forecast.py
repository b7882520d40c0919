"""A run that will need very many steps says so as soon as their pace is known, with the fastest period and its body."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import pytest
from dae_problems import double_four_bar

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.run.judges.forecast import Forecast, fastest, reason


def light_and_heavy(stiffness: float) -> fmbd.Scene:
    a = fmbd.RigidBody("light", 1e-3, 1e-7, position=(0.0, -1.0))
    b = fmbd.RigidBody("heavy", 1e3, 1e2, position=(0.0, -2.0))
    scene = fmbd.Scene("stiff", gravity=(0.0, -9.81))
    scene.add(a, b, fmbd.distance("rod", fmbd.ground, a, point_a=(0.0, 0.0), point_b=(0.0, -1.0), length=1.0))
    scene.add(fmbd.Spring("spring", a, b, (0.0, -1.0), (0.0, -2.0), stiffness=stiffness, length=1.0))
    return scene


def test_the_fastest_period_and_its_body() -> None:
    system, state, _ = light_and_heavy(1e10).build()
    solver = StepSolver(system)
    assert f'{2 * np.pi * np.sqrt(1e-3 / 1e10):.2g} s, of body "light"' in fastest(solver, state)
    solver.destroy()


@pytest.mark.parametrize("planned", [0, 100])
def test_said_once_where_it_is_many(planned: int, caplog: Any) -> None:
    """At 1e-7 s a step a second needs 1e7; at 1e-3 s nothing is said."""
    from dataclasses import replace

    system, state, _ = light_and_heavy(1e10).build()
    solver = StepSolver(system)
    with caplog.at_level(logging.WARNING, logger="fmbd_fenicsx"):
        calm = Forecast(solver, 0.0, 1.0, planned)
        for k in range(1, 301):
            calm.note(replace(state, t=1e-3 * k))
        assert not caplog.records
        slow = Forecast(solver, 0.0, 1.0, planned)
        for k in range(1, 301 if planned else 3001):
            slow.note(replace(state, t=1e-7 * k))
    assert len(caplog.records) == 1 and "about 1.0e+07" in caplog.text and "light" in caplog.text
    solver.destroy()


@pytest.mark.parametrize(
    ("sizes", "told"),
    [
        ([7e-6] * 1000 + [1.3e-4] * 500 + [1e-3] * 900, False),  # behind a start that stayed at its first size for long
        (1e-6 * 1.0001 ** np.arange(5000), False),  # 46 000 steps where 1e6 would be needed without their growth
        (1e-6 * 1.00001 ** np.arange(5000), True),  # 240 000
    ],
)
def test_steps_that_grow_are_carried_on_as_they_grow(sizes: Any, told: bool, caplog: Any) -> None:
    from dataclasses import replace

    system, state, _ = light_and_heavy(1e4).build()
    solver = StepSolver(system)
    grown = Forecast(solver, 0.0, 1.0, 0)
    for t in np.cumsum(sizes):
        grown.note(replace(state, t=float(t)))
    assert ("at this pace" in caplog.text) == told
    solver.destroy()


@pytest.mark.parametrize(("planned", "largest"), [(1_000_000, np.inf), (0, 1e-6)])
def test_small_steps_that_were_asked_for_are_no_news(planned: int, largest: float, caplog: Any) -> None:
    """Equal ones, and a largest one that steps of own choice keep to."""
    from dataclasses import replace

    system, state, _ = light_and_heavy(1e4).build()
    solver = StepSolver(system)
    with caplog.at_level(logging.WARNING, logger="fmbd_fenicsx"):
        asked = Forecast(solver, 0.0, 1.0, planned, largest=largest)
        for k in range(1, 301):
            asked.note(replace(state, t=1e-6 * k))
    assert not caplog.records
    solver.destroy()


def far_away(far: float) -> fmbd.Scene:
    """1 kg on a spring of 1e12 N/m, so far (m) from the origin."""
    mass = fmbd.PointMass("bob", 1.0, (far + 1.0, far))
    scene = fmbd.Scene("far", gravity=(0.0, -9.81))
    ends = {"point_a": (far, far), "point_b": (far + 1.0, far)}
    scene.add(mass, fmbd.Spring("spring", fmbd.ground, mass, **ends, stiffness=1e12, length=1.0))
    return scene


def ends_after(
    scene: fmbd.Scene, h: float, says: str, *, longer: float = 1.0, most: int = 5000, planned: int = 0
) -> int:
    """How many steps of h (s), each so many times as long as the one before, a run of 1 s makes before it is refused."""
    from dataclasses import replace

    system, state, _ = scene.build()
    solver = StepSolver(system)
    watched, t, k = Forecast(solver, 0.0, 1.0, planned), 0.0, 0
    try:
        for k in range(1, most + 1):
            t += h * longer**k
            watched.note(replace(state, t=t))
    except fmbd.errors.ConvergenceError as error:
        assert "Steps do not come away from t = " in str(error) and says in str(error)
    finally:
        solver.destroy()
    return k


def test_forces_that_are_roundoff_end_the_run() -> None:
    assert ends_after(far_away(1e9), 1e-6, "Places are known to 3.6e-06 m here") == 300
    assert ends_after(far_away(0.0), 1e-6, "") == 5000


def test_steps_without_end_that_do_not_grow_end_the_run() -> None:
    """1e12 of them; the beginning of a vibration that damping ends takes as short ones, which grow."""
    assert ends_after(far_away(0.0), 1e-12, 'The fastest period is 6.3e-06 s, of body "bob"') == 2000
    assert ends_after(far_away(0.0), 1e-12, "", longer=1.0001) == 5000
    assert ends_after(far_away(0.0), 1e-13, "No spring is there to blame") == 2000  # for so many steps in its period


def test_parts_without_end_of_equal_steps_end_the_run() -> None:
    """A hundred steps in 2e5 parts each, where the run would make 2e7; not so many steps that were asked for."""
    assert ends_after(far_away(0.0), 5e-8, 'The fastest period is 6.3e-06 s, of body "bob"', planned=100) == 2000
    assert ends_after(far_away(0.0), 5e-8, "", planned=20_000_000) == 5000
    assert ends_after(far_away(0.0), 2e-7, "", planned=100) == 5000


@pytest.mark.parametrize("scheme", [fmbd.Radau(3), fmbd.BDF(), fmbd.GeneralizedAlpha(rtol=1e-4)], ids=lambda x: x.name)
def test_a_body_whose_turning_bounds_steps_is_named(scheme: Any, caplog: pytest.LogCaptureFixture) -> None:
    """A screw at 5 000 rad/s; no spring and no law is there to look for."""
    shaft = fmbd.RigidBody("shaft", 1.0, (1e-3, 1e-3, 1e-3), angular_velocity=(5000.0, 0, 0))
    bore = fmbd.cylindrical("bore", fmbd.ground, shaft, axis=(1, 0, 0))
    scene = fmbd.Scene("screw")
    scene.add(shaft, bore, fmbd.screw("thread", bore, lead=1e-3))
    looks = [fmbd.Event("x", x, then=lambda now: None) for x in (0.5, 1.0)]
    met = [*looks, fmbd.Event("x", 1.1)]
    scene.sensor("x", fmbd.displacement(bore))
    fmbd.solve(scene, t_end=1e4, scheme=scheme, output=fmbd.Output(events=met, times=[1e4], progress=False))
    assert 'Body "shaft" turns at 5e+03 rad/s' in caplog.text and "0.0005 s here" in caplog.text
    assert "No spring" not in caplog.text


@pytest.mark.parametrize("sprung", [False, True])
def test_a_steep_law_is_named(sprung: bool) -> None:
    """Friction of 200 N that is smooth over 1e-5 m/s, at rest, also beside a spring that is slower."""
    block = fmbd.RigidBody("block", 100.0, 1.0)
    slide = fmbd.prismatic("slide", fmbd.ground, block, axis=(1, 0), center=(0.0, 0.0))
    scene = fmbd.Scene("slide")
    scene.add(block, slide, fmbd.joint_friction("rub", fmbd.displacement(slide), coulomb=200.0, speed=1e-5))
    if sprung:
        scene.add(fmbd.Spring("spring", fmbd.ground, block, (-1.0, 0.0), (0.0, 0.0), stiffness=1e4))
    system, state, _ = scene.build()
    solver = StepSolver(system)
    assert 'the law of "rub" changes by 2.0e+07 N s/m' in reason(solver, state)
    solver.destroy()


def parallelogram(lift: float) -> fmbd.Scene:
    """Two legs and a bar of one length, the legs turned by ``lift`` (rad) out of the position in which all lie on one line."""
    turn = np.cos(lift), np.sin(lift)
    legs = [fmbd.RigidBody(f"leg {i}", 1.0, 1 / 12, (i + 0.5 * turn[0], 0.5 * turn[1]), lift) for i in range(2)]
    bar = fmbd.RigidBody("bar", 1.0, 1 / 12, (turn[0] + 0.5, turn[1]))
    scene = fmbd.Scene("four-bar", gravity=(0.0, -9.81))
    scene.add(*legs, bar)
    for i, leg in enumerate(legs):
        scene.add(fmbd.revolute(f"A{i}", fmbd.ground, leg, center=(i, 0.0)))
        scene.add(fmbd.revolute(f"B{i}", leg, bar, center=(i + turn[0], turn[1])))
    return scene


@pytest.mark.parametrize("sprung", [False, True])
@pytest.mark.parametrize(("lift", "near"), [(1.0, False), (1e-5, True)])
def test_a_singular_position_is_named(lift: float, near: bool, sprung: bool) -> None:
    """A parallelogram with its legs up, and with all bars on one line but for 1e-5 rad: no spring is to blame there."""
    scene = parallelogram(lift)
    if sprung:
        bar = scene.bodies["bar"]
        scene.add(fmbd.Spring("spring", fmbd.ground, bar, (0.0, -1.0), bar.position, stiffness=1e4))

    system, state, _ = scene.build()
    solver = StepSolver(system)
    said = reason(solver, state)
    assert ("singular position: constraints almost depend" in said) == near
    assert not near or "sigma_min/sigma_max" in said and "pring" not in said
    solver.destroy()


def test_what_a_run_at_a_singular_position_is_told_to_take_passes() -> None:
    """The double four-bar goes through its flat positions by the form that is named, where the default does not."""
    solve = lambda **how: fmbd.solve(double_four_bar(), t_end=1.4, **how)
    with pytest.raises(fmbd.errors.ConvergenceError, match=r"Take fmbd.Radau\(form=fmbd.Projected"):
        solve(scheme=fmbd.Radau(rtol=1e-9))
    form = fmbd.Projected(fmbd.Index1())
    for scheme in (
        fmbd.Radau(form=form, rtol=1e-9),
        fmbd.BDF(form=form, rtol=1e-10),
        fmbd.Radau(5, form=form, rtol=1e-10),
    ):
        run = solve(scheme=scheme)
        assert run.counters["rejections"] < 20
        assert np.ptp(run.total_energy) < 1e-6 * np.ptp(run.energy["kinetic"])
        assert np.ptp(run["top"][:, 0]) > 1.9


def test_steps_that_do_not_come_away_from_a_singular_position_end_the_run() -> None:
    """A thousandth of the pace before, ten millions of steps to go, three looks at such a place: not sooner, not elsewhere."""
    from dataclasses import replace

    def noted(lift: float, small: float) -> int:
        system, state, _ = parallelogram(lift).build()
        solver = StepSolver(system)
        slow = Forecast(solver, 0.0, 1.0, 0)
        for k in range(1, 101):
            slow.note(replace(state, t=1e-3 * k))
        try:
            for k in range(1, 1001):
                slow.note(replace(state, t=0.1 + small * k))
            return k
        except fmbd.errors.ConvergenceError as error:
            assert "Steps do not come away from t = 0.1" in str(error) and "singular position" in str(error)
            return k
        finally:
            solver.destroy()

    assert noted(1e-5, 1e-10) == 300  # by the steps of error control
    assert noted(1.0, 1e-10) == noted(1e-5, 1e-6) == 1000
