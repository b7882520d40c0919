"""Records about the samples of controllers: every scheme shows the same side of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from chains import chain

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.system.compiled.states.stage_patterns import StageStructure
from fmbd_fenicsx.system.compiled.states.stages import StageRoom

NEAR = 1e-5  # s
SCHEMES = [
    fmbd.GeneralizedAlpha(),
    fmbd.GeneralizedAlpha(rtol=1e-5),
    fmbd.EnergyMomentum(),
    fmbd.Rattle(),
    fmbd.HalfExplicit(rtol=None),
    fmbd.HalfExplicit(),
    fmbd.ExplicitRungeKutta(),
    fmbd.Radau(2, rtol=None),
    fmbd.Radau(3),
    fmbd.BDF(2, rtol=None),
    fmbd.BDF(),
]


def held_arm(breakpoints: tuple[float, ...] = ()) -> fmbd.Scene:
    """Two links swing from the horizontal, the first one held by a slow controller."""
    scene, last = chain(2, "held arm", breakpoints=breakpoints)
    turn = fmbd.angle(scene.joints["pin 0"])
    reads = {"phi": turn, "rate": fmbd.joint_rate(turn)}
    law = fmbd.controller(
        "hold", reads=reads, acts=turn, law=lambda t, y, z: 6 * (0.3 - y["phi"][0]) - y["rate"][0], every=0.1
    )
    scene.add(law)
    scene.sensor("effort", fmbd.element_effort(law))
    scene.sensor("acceleration", fmbd.acceleration(last))
    scene.sensor("pin", fmbd.reaction("pin 0"))
    return scene


def solved(scheme: Any, *, breakpoints: tuple[float, ...] = (), **output: Any) -> fmbd.Run:
    """Half a second of it."""
    own = getattr(scheme, "rtol", None) is not None
    given: dict[str, Any] = {"scheme": scheme, "output": fmbd.Output(energy=False, progress=False, **output)}
    return fmbd.solve(held_arm(breakpoints), t_end=0.5, dt=None if own else 0.01, **given)


@pytest.fixture(scope="module")
def exact() -> fmbd.Run:
    """Values just behind a sample, and at the end of the run behind the one there."""
    return solved(fmbd.Radau(5, rtol=1e-9), times=(0.2 - NEAR, 0.2 + NEAR, 0.5))


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: f"{s.name} {getattr(s, 'rtol', None)}")
@pytest.mark.parametrize("breakpoints", [(), (0.2,)], ids=["", "named"])
def test_records_at_a_sample_show_what_is_behind_it(
    scheme: Any, breakpoints: tuple[float, ...], exact: fmbd.Run
) -> None:
    """Efforts, accelerations and reactions jump there together, and values just before are those of the old effort."""
    within = solved(scheme, breakpoints=breakpoints, times=(0.2 - NEAR, 0.2, 0.2 + NEAR, 0.5))
    ends = solved(scheme, breakpoints=breakpoints)
    row = int(np.argmin(np.abs(ends.times - 0.2)))
    for name, jump in (("effort", 1.4), ("acceleration", 0.5), ("pin", 1.7)):
        before, behind, last = exact[name]
        assert np.abs(behind - before).max() > jump  # so that sides can be told
        shown = {"before": within[name][0] - before, "at": within[name][1] - behind, "behind": within[name][2] - behind}
        shown |= {"end of a step": ends[name][row] - behind, "last": ends[name][-1] - last}
        assert all(np.abs(x).max() < 0.25 * jump for x in shown.values()), (name, shown)


@pytest.mark.compiled
@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("scheme", [x for x in SCHEMES if getattr(x, "rtol", None) is None], ids=lambda s: s.name)
def test_samples_behind_steps_of_one_call_are_those_behind_steps_made_alone(scheme: Any, every: int) -> None:
    """Of three controllers with other periods, one of which no step divides: who looks at every step sees each made alone."""
    runs = []
    for look in (None, lambda moment: None):
        scene = held_arm()
        turn, knee = (fmbd.angle(scene.joints[f"pin {k}"]) for k in (0, 1))
        scene.add(
            fmbd.pid("between", knee, target=0.2, gains=(5.0, 1.0, 0.5), every=0.027),
            fmbd.pid("each", turn, target=0.1, gains=(2.0, 0.5, 0.2), every=0.02),
            fmbd.forces.joint_friction("friction", knee, coulomb=0.5, speed=0.5),
        )
        scene.sensor("knee", knee)
        scene.sensors.pop("effort")  # efforts of controllers are no numbers of records that compiled code makes
        output = fmbd.Output(on_step=look, every=every, progress=False)
        runs.append(fmbd.solve(scene, t_end=0.5, dt=0.01, scheme=scheme, output=output))
    many, alone = runs
    assert many.times == pytest.approx(alone.times, abs=1e-12)
    for name in many.series:
        assert many[name] == pytest.approx(alone[name], rel=1e-9, abs=1e-10)
    for name, values in many.energy.items():
        assert values == pytest.approx(alone.energy[name], rel=1e-9, abs=1e-10)


@pytest.mark.parametrize("scheme", [fmbd.EnergyMomentum(), fmbd.Rattle()], ids=lambda s: s.name)
def test_errors_of_reactions_between_samples_are_told(scheme: Any) -> None:
    """Values within the step behind a sample lay between those of the old effort and of the next end."""
    times = tuple(np.linspace(0.0, 0.5, 84))
    run = solved(scheme, times=times, estimate_error=True)
    exact = solved(fmbd.Radau(5, rtol=1e-9), times=times)
    for name in ("effort", "acceleration", "pin"):
        true = np.abs(run[name] - exact[name]).max()
        assert true < 0.02 * np.ptp(exact[name], axis=0).max()
        assert 0.5 < run.certificate[name].total / true < 3, name


@pytest.mark.parametrize("name", ["acceleration", "pin"])
def test_looser_tolerances_tell_what_is_of_a_lower_order_than_steps_are_chosen_by(name: str) -> None:
    """Accelerations within steps fall with the square of these, places with the fifth power: 0.22 of the error was stated."""
    given: dict[str, Any] = {
        "t_end": 1.0,
        "output": fmbd.Output(times=tuple(np.linspace(0.0, 1.0, 91)), energy=False, progress=False),
    }
    run = fmbd.solve(held_arm(), scheme=fmbd.Radau(3), tol={name: fmbd.relative(2e-2)}, **given)
    exact = fmbd.solve(held_arm(), scheme=fmbd.Radau(5, rtol=1e-9), **given)
    true = np.abs(run[name] - exact[name]).max()
    print(run.certificate[name].total / true)
    assert 0.5 < run.certificate[name].total / true < 3


def test_ends_of_steps_are_not_recorded_where_samples_jump() -> None:
    """Kinks are looked for in records of every step but where forces are sampled: these were made one by one for nothing."""
    run = solved(fmbd.GeneralizedAlpha(), times=(0.0, 0.25, 0.5), estimate_error=True)
    assert run.at_steps is None and run.error_estimate


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [fmbd.Radau(3, rtol=None), fmbd.BDF(2, rtol=None)], ids=lambda s: s.name)
def test_steps_behind_a_sample_begin_with_the_room_that_is_there(scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Patterns of their equations and room for their stages are made as often for five samples as for two."""
    made: list[Any] = []
    for kind in (StageStructure, StageRoom):
        begin = kind.__init__
        noted = lambda self, *given, begin=begin, **more: (made.append(self), begin(self, *given, **more))[1]  # noqa: E731
        monkeypatch.setattr(kind, "__init__", noted)
    counts = []
    for t_end in (0.25, 0.55):
        made.clear()
        fmbd.solve(held_arm(), t_end=t_end, dt=0.01, scheme=scheme)
        counts.append(len(made))
    assert counts[0] == counts[1] > 0
