"""The explicit Runge-Kutta method of order eight: order, error control, values between steps, and the compiled stages."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest
from dae_problems import march, pendulum, pendulum_errors, spinning_top, state_errors

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.schemes.marching import MarchingStepper
from fmbd_fenicsx.schemes.onestep.explicit_runge_kutta import coefficients, formulas
from fmbd_fenicsx.system.compiled.states.evaluation import DriverStates
from fmbd_fenicsx.system.compiled.states.explicit import ExplicitStates
from fmbd_fenicsx.system.compiled.states.factor import DriverFactor


def bead() -> fmbd.Scene:
    """A bead slides on an arm that a drive turns unevenly."""
    scene = fmbd.Scene("bead")
    arm = fmbd.RigidBody("arm", 1.0, 1.0, (0.0, 0.0))
    bead = fmbd.RigidBody("bead", 1.0, 0.1, (0.5, 0.0))
    scene.add(arm, bead, fmbd.revolute("axle", fmbd.ground, arm, center=(0, 0)))
    scene.add(fmbd.prismatic("wire", arm, bead, axis=(1, 0), center=(0, 0)))
    turn = lambda t: (1 - np.cos(t), np.sin(t), np.cos(t))
    scene.add(fmbd.drive_rotation("motor", fmbd.ground, arm, turn))
    scene.sensor("x", fmbd.position(bead))
    return scene


def test_order_eight() -> None:
    errors = [pendulum_errors(fmbd.ExplicitRungeKutta(None), 2.0, n) for n in (8, 16)]
    assert (np.log2(errors[0] / errors[1]) > 7.5).all(), errors


@pytest.mark.parametrize(("make", "t_end", "steps"), [(spinning_top, 0.5, 3), (bead, 2.0, 4)])
def test_order_eight_of_frames(make: Any, t_end: float, steps: int) -> None:
    """With rotations in space, and with a joint that is driven."""
    scene, scheme = make(), fmbd.ExplicitRungeKutta(None)
    reference = march(scene, scheme, t_end, 12 * steps)[-1]
    other = march(scene, fmbd.Radau(5, fmbd.StateSpace(), None), t_end, 15 * steps)[-1]
    assert max(state_errors(scene, other, reference)) < 1e-9

    errors = [state_errors(scene, march(scene, scheme, t_end, n)[-1], reference) for n in (steps, 2 * steps)]
    assert (np.log2(errors[0] / errors[1]) > 7.3).all(), errors


def test_formulas_of_the_error_have_their_orders() -> None:
    """By powers of the nodes, and by those whose stages of low order reach the error through two others."""
    c, A = coefficients()
    A = A[:12]
    powers = np.array([formulas() @ c**k for k in range(7)]).T
    for found, order in zip(powers, (5, 6, 3), strict=True):
        assert np.abs(found[:order]).max() < 1e-13 < 1e-4 < abs(found[order:]).max()
    sixth = formulas()[1]
    assert np.abs([sixth @ A @ c**k for k in (3, 4)] + [sixth @ A @ A @ c**k for k in (2, 3)]).max() < 1e-13
    assert np.abs(sixth @ A @ A @ A @ c**2) < 1e-13


def test_work_grows_like_order_eight() -> None:
    steps = [
        fmbd.solve(pendulum(), t_end=1.0, scheme=fmbd.ExplicitRungeKutta(r)).counters["steps"] for r in (1e-6, 1e-12)
    ]
    assert steps[1] / steps[0] < 1.3 * 1e6 ** (1 / 8)


def redundant() -> fmbd.Scene:
    """A door on two hinges, whose rows depend on each other."""
    scene = fmbd.Scene("door", gravity=(0.0, -9.81, 0.0))
    door = fmbd.RigidBody("door", 2.0, (0.2, 0.3, 0.1), (0.5, 0.0, 0.0))
    axis = (0.1, 0.0, 1.0)
    scene.add(door, fmbd.revolute("low", fmbd.ground, door, center=(0, 0, 0), axis=axis))
    scene.add(fmbd.revolute("high", fmbd.ground, door, center=axis, axis=axis))
    scene.sensor("x", fmbd.position(door))
    return scene


def chain() -> fmbd.Scene:
    """Three links in the plane with springs on their hinges and a force of time."""
    scene, before = fmbd.Scene("chain", gravity=(0.0, -9.81)), fmbd.ground
    for i in range(3):
        link = fmbd.RigidBody(f"link {i}", 1.0, 0.1, (0.5 + i, 0.0))
        hinge = fmbd.revolute(f"hinge {i}", before, link, center=(float(i), 0.0))
        scene.add(link, hinge, fmbd.joint_spring(f"spring {i}", fmbd.angle(hinge), stiffness=5.0, damping=0.3))
        before = link
    scene.add(fmbd.force("push", before, lambda t: (3.0 * np.sin(4 * t), 0.0)))
    scene.sensor("x", fmbd.position(before))
    return scene


def bent() -> fmbd.Scene:
    """A beam that hangs on its surface, which moves in it, and is pulled at the other one."""
    section = fmbd.Section.rectangle(youngs_modulus=1e6, poisson_ratio=0.3, density=1000.0, width=0.1, height=0.05)
    beam = fmbd.Beam("beam", (0.0, 0.0), (1.0, 0.0), section, elements=3, modes=5)
    scene = fmbd.Scene("bent", gravity=(0.0, -9.81))
    scene.add(beam, fmbd.revolute("hinge", fmbd.ground, beam.surface("start"), center=(0.0, 0.05)))
    scene.add(fmbd.force("pull", beam.surface("end"), (5.0, 2.0)))
    return scene


@pytest.mark.parametrize("make, end", [(x, 0.3) for x in (chain, bead, spinning_top, redundant)] + [(bent, 0.1)])
def test_compiled_stages_are_those_of_numpy(make: Any, end: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """States agree to roundoff with those of steps whose stages are made one by one."""
    run = fmbd.solve(make(), t_end=end, scheme=fmbd.ExplicitRungeKutta(1e-7))
    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)  # all steps in parts
    nothing = lambda *given: None
    for name in ("accelerations", "closed"):
        monkeypatch.setattr(ExplicitStates, name, nothing)
    slow = fmbd.solve(make(), t_end=end, scheme=fmbd.ExplicitRungeKutta(1e-7))
    assert slow.counters["steps"] == run.counters["steps"]
    for found, expected in zip(
        (run.state.q, run.state.v, run.state.a), (slow.state.q, slow.state.v, slow.state.a), strict=True
    ):
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())


def test_a_step_enters_python_a_few_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """The stages in one call, the end in one, the accelerations there in one."""
    calls: Counter[str] = Counter()

    def count(owner: type, name: str) -> Any:
        function = getattr(owner, name)

        def counted(self: Any, *given: Any) -> Any:
            calls[name] += 1
            return function(self, *given)

        return counted

    for owner, names in ((DriverStates, ("at", "balances", "constraints", "rows")), (DriverFactor, ("prepare",))):
        for name in names:
            monkeypatch.setattr(owner, name, count(owner, name))
    quiet = fmbd.Output(every=10**9, energy=False, progress=False)
    fmbd.solve(chain(), t_end=0.1, scheme=fmbd.ExplicitRungeKutta(1e-8), output=quiet)
    few = sum(calls.values())
    calls.clear()
    run = fmbd.solve(chain(), t_end=2.0, scheme=fmbd.ExplicitRungeKutta(1e-8), output=quiet)
    assert run.counters["steps"] > 20
    assert sum(calls.values()) <= few + 2 * run.counters["steps"]


def test_a_law_that_fails_is_named() -> None:
    scene = chain()
    scene.add(fmbd.force("wind", scene.bodies["link 2"], lambda t: (np.nan if t > 0.05 else 1.0, 0.0)))
    with pytest.raises(fmbd.errors.FmbdError, match="wind"):
        fmbd.solve(scene, t_end=0.3, scheme=fmbd.ExplicitRungeKutta(1e-7))


@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "NumPy"])
@pytest.mark.parametrize("rate", [1.0, 0.0])
def test_own_steps_see_the_kink_of_a_drive(rate: float, compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """An arm changes its rate at once, a forearm hangs on it. Second rates of the drive vanish on both sides, so stages saw
    nothing, and the arm was closed onto the drive behind the kink: the forearm was off by 6e-3 and 1e-2 rad.
    """
    if not compiled:
        monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)

    def folded(*kinks: float) -> float:
        scene = fmbd.Scene("arm", gravity=(0, -9.81), breakpoints=kinks)
        arm, forearm = (fmbd.RigidBody(name, 1.0, 0.1, (x, 0.0)) for name, x in (("arm", 0.5), ("forearm", 1.5)))
        shoulder, elbow = (
            fmbd.revolute(f"pin {x}", a, b, center=(x, 0)) for a, b, x in ((fmbd.ground, arm, 0), (arm, forearm, 1))
        )
        turn = lambda t: rate * t if t < 0.5 else 0.5 * rate + (0.4 - 0.4 * rate) * (t - 0.5)
        scene.add(arm, forearm, shoulder, elbow, fmbd.drive("motor", fmbd.angle(shoulder), turn))
        scene.sensor("fold", fmbd.angle(elbow))
        return float(fmbd.solve(scene, t_end=1.0, scheme=fmbd.ExplicitRungeKutta(1e-6))["fold"][-1, 0])

    assert folded() == pytest.approx(folded(0.5), abs=3e-5)
