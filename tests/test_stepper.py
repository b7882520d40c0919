"""A run step by step: equal to solve to the last bit, steps taken back and repeated, inputs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError, LawError

N, DT = 60, 1e-2


def arm() -> fmbd.Scene:
    """Two links, a torque from outside at the first hinge, dry friction in the second."""
    one = fmbd.RigidBody("one", 1.0, 0.1, position=(0.5, 0))
    two = fmbd.RigidBody("two", 1.0, 0.1, position=(1.5, 0))
    scene = fmbd.Scene("arm", gravity=(0, -9.81))
    first = fmbd.revolute("first", fmbd.ground, one, center=(0, 0))
    second = fmbd.revolute("second", one, two, center=(1, 0))
    scene.add(one, two, first, second)
    scene.add(fmbd.dry_friction("friction", fmbd.angle(second), limit=0.5, stick=1e3))
    scene.add(fmbd.effort("motor", fmbd.angle(first), scene.input("torque", 1.0, lower=-5.0, upper=5.0)))
    scene.sensor("tip", fmbd.position(two))
    scene.sensor("phi", fmbd.angle(first))
    return scene


SCHEMES: dict[str, Any] = {
    "default": lambda: None,
    "numpy": lambda: fmbd.GeneralizedAlpha(0.7, compiled=False),
    "GGL": lambda: fmbd.GeneralizedAlpha(0.7, form=fmbd.GGL()),
    "energy-momentum": fmbd.EnergyMomentum,
}


@pytest.mark.parametrize("scheme", SCHEMES)
def test_equal_to_solve_with_steps_taken_back(scheme: str) -> None:
    run = fmbd.solve(arm(), t_end=N * DT, dt=DT, scheme=SCHEMES[scheme]())
    with fmbd.stepper(arm(), dt=N * DT / N, scheme=SCHEMES[scheme]()) as s:
        for k in range(N):
            if k % 20 == 7:  # leave the way and come back, twice from one mark
                kept = s.save()
                for torque in (4.0, -3.0):
                    s.set("torque", torque)
                    for _ in range(5):
                        s.step()
                    assert not np.array_equal(s["tip"], run["tip"][k + 5])
                    s.restore(kept)
            assert np.array_equal(s["tip"], run["tip"][k])
            assert np.abs(s["phi"] - run["phi"][k]).max() < 1e-15  # an angle is read by NumPy here, in C there
            s.step()
        assert np.array_equal(s["tip"], run["tip"][-1])


@pytest.mark.parametrize(
    "scheme",
    [
        fmbd.GeneralizedAlpha(rtol=1e-5),
        fmbd.Radau(2, form=fmbd.Index2(), rtol=1e-5),
        fmbd.BDF(rtol=1e-5),
        fmbd.ExplicitRungeKutta(1e-7),
        fmbd.HalfExplicit(1e-6),
        fmbd.Radau(2, rtol=None),
        fmbd.Rattle(),
        fmbd.EnergyMomentum(),
    ],
    ids=lambda scheme: f"{scheme.name} {getattr(scheme, 'rtol', None)}",
)
@pytest.mark.parametrize("t_end", [0.37081737987472, 0.2, 0.1347])
def test_steps_that_are_shown_are_those_of_a_march(scheme: Any, t_end: float) -> None:
    """To the last bit: memories, the end of a run and factors are those of one call, whoever looks at each step."""
    dt = None if getattr(scheme, "rtol", None) else t_end / 50
    shown = fmbd.Output(on_step=lambda moment: None)
    many, each = (fmbd.solve(arm(), t_end=t_end, dt=dt, scheme=scheme, output=output) for output in (None, shown))
    assert many.counters["steps"] == each.counters["steps"]
    for name in ("q", "v", "a", "lam"):
        assert np.array_equal(getattr(many.state, name), getattr(each.state, name)), name


def test_elastic_body_equal_to_solve() -> None:
    from motion import elastic_rod

    mesh = fmbd.read_gmsh("meshes/rod.py", dim=2, h=0.1)

    def scene() -> fmbd.Scene:
        rod = elastic_rod(mesh)
        made = fmbd.Scene("rod", gravity=(0, -9.81))
        made.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
        made.sensor("tip", fmbd.position(rod.surface("tip")))
        return made

    run = fmbd.solve(scene(), t_end=0.05, dt=5e-3, output=fmbd.Output(snapshots=11))
    with fmbd.stepper(scene(), dt=0.05 / 10) as s:
        for k in range(10):
            kept = s.save()
            s.step()
            s.restore(kept)
            s.step()
            for name in ("q", "v", "a", "lam"):
                assert np.array_equal(getattr(s.state, name), getattr(run.snapshots[k + 1], name)), name
            assert np.abs(s["tip"] - run["tip"][k + 1]).max() < 4e-16  # read by NumPy here, in C there


def test_steps_of_other_sizes_and_error_control() -> None:
    run = fmbd.solve(arm(), t_end=0.3, dt=1e-3)
    for scheme, bound in ((None, 2e-3), (fmbd.Radau(rtol=1e-7), 2e-3)):
        with fmbd.stepper(arm(), dt=1e-2, scheme=scheme) as s:
            for dt in (0.01, 0.005, 0.085, 0.1, 0.1):
                for _ in range(10 if scheme is None else 1):
                    s.step(dt / (10 if scheme is None else 1))
            assert abs(s.t - 0.3) < 1e-12
            assert np.abs(s["tip"] - run["tip"][-1]).max() < bound


def test_on_step_sees_every_step() -> None:
    seen: list[tuple[int, float, Any]] = []
    output = fmbd.Output(every=7, on_step=lambda now: seen.append((now.step, now.t, now["phi"])))
    run = fmbd.solve(arm(), t_end=N * DT, dt=DT, output=output)
    assert [step for step, _, _ in seen] == list(range(1, N + 1))
    assert np.array_equal(np.array([x for _, _, x in seen])[6::7], run["phi"][1 : 1 + N // 7])


def test_bad_input_is_named() -> None:
    with fmbd.stepper(arm(), dt=DT) as s:
        for call, what in (
            (lambda: s.set("torqe", 1.0), 'Did you mean "torque"'),
            (lambda: s.set("torque", 6.0), r"outside its range \[-5, 5\]"),
            (lambda: s.set("torque", np.nan), "outside its range"),
            (lambda: s.set("torque", "much"), "takes a number"),
            (lambda: s["tipp"], 'Did you mean "tip"'),
            (lambda: s.step(-1.0), "must be a positive number"),
            (lambda: s.restore(), r"call save\(\)"),
        ):
            with pytest.raises(InputError, match=what):
                call()
        kept = s.save()
    with pytest.raises(InputError, match="closed"):
        s.step()
    with fmbd.stepper(arm(), dt=DT) as other, pytest.raises(InputError, match="another stepper"):
        other.restore(kept)


def test_a_failed_step_can_be_taken_back() -> None:
    """A law that fails: one error, and the run goes on from the mark with another input."""
    body = fmbd.RigidBody("body", 1.0, 1.0)
    scene = fmbd.Scene("cart")
    rail = fmbd.prismatic("rail", fmbd.ground, body, axis=(1, 0), center=(0, 0))
    wild = scene.input("wild", 0.0)
    law = lambda s, v, t: math.sqrt(-wild(t))  # noqa: E731
    scene.add(body, rail, fmbd.joint_spring("law", fmbd.displacement(rail), law=law))
    scene.add(fmbd.effort("push", fmbd.displacement(rail), lambda t: 1.0))
    scene.sensor("s", fmbd.displacement(rail))
    with fmbd.stepper(scene, dt=0.1) as s:
        s.step()
        kept, before = s.save(), s["s"]
        s.set("wild", 1.0)
        with pytest.raises(LawError, match='"law" failed at t = '):
            s.step()
        s.restore(kept)
        assert np.array_equal(s["s"], before)
        s.step()
        assert abs(s["s"][0] - 0.5 * 0.2**2) < 1e-12
    assert wild.value == 0.0


@pytest.mark.parametrize("scheme", [None, fmbd.BDF(3, rtol=None), fmbd.Radau(rtol=None), fmbd.Rattle()], ids=str)
def test_inputs_that_are_set_on_the_way_of_a_run_jump(scheme: Any) -> None:
    """As in a stepper: schemes begin anew behind the step. Their past had made 8 mm of the jump, of first order in h."""

    def switched(t: float) -> float:
        return 5.0 if t > 0.2 - 1e-9 else 1.0

    scene = arm()
    torque = scene.inputs["torque"]
    output = fmbd.Output(on_step=lambda now: torque.set(switched(now.t)))
    run = fmbd.solve(scene, t_end=0.5, dt=DT, scheme=scheme, output=output)
    with fmbd.stepper(arm(), dt=DT, scheme=scheme) as steps:
        for _ in range(50):
            steps.set("torque", switched(steps.t))
            steps.step()
        assert np.abs(run["tip"][-1] - steps["tip"]).max() < 1e-12
