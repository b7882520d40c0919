"""Steps whose forces are not in balance are made again, or end the run with the body's name; stiffness is no unbalance."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_acceptance import double_pendulum

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError
from fmbd_fenicsx.linear.blocks.field_blocks import Weights
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.run import compiled_calls
from fmbd_fenicsx.run.judges.force_balance import Balanced, next_look
from fmbd_fenicsx.schemes.declared import Declared
from fmbd_fenicsx.schemes.multistep import bdf
from fmbd_fenicsx.schemes.onestep import radau
from fmbd_fenicsx.schemes.onestep.alpha import alpha_stepper

SCHEMES = {
    "alpha": (alpha_stepper.AlphaStepper, fmbd.GeneralizedAlpha(0.8, compiled=False), 2e-3),
    "Radau": (radau.RadauStepper, fmbd.Radau(rtol=1e-6), None),
    "BDF": (bdf.BDFStepper, fmbd.BDF(rtol=1e-6), None),
    "BDF, constant": (bdf.BDFStepper, fmbd.BDF(order=2, rtol=None), 2e-3),
}


@pytest.fixture
def spoilt(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Let one step of a stepper, or all from the first on, end with reactions that are off by a share."""

    def spoil(stepper: type, share: float, one: int | None = None) -> None:
        right, count = stepper.advance, [0]  # type: ignore[attr-defined]

        def wrong(self: Any, h: float) -> Any:
            made = right(self, h)
            count[0] += 1
            if one is None or count[0] == one:
                self.state = made = replace(made, lam=(1 + share) * made.lam)
            return made

        monkeypatch.setattr(stepper, "advance", wrong)
        monkeypatch.setattr(stepper, "stride", lambda self, h: 0.0)  # each by itself

    yield spoil


@pytest.mark.parametrize("name", SCHEMES)
def test_a_step_without_balance_is_made_again(name: str, spoilt: Any) -> None:
    """The record is that of the undisturbed run."""
    stepper, scheme, dt = SCHEMES[name]
    given = {"t_end": 0.3, "dt": dt, "scheme": scheme, "output": fmbd.Output(energy=False)}
    right = fmbd.solve(double_pendulum(1.0, 2.0), **given)
    spoilt(stepper, 0.3, 5)
    run = fmbd.solve(double_pendulum(1.0, 2.0), **given)
    again = run.counters.get("unbalanced_steps", 0) + run.counters.get("halved_steps", 0)
    assert again >= 1
    np.testing.assert_allclose(run["tip"][-1], right["tip"][-1], atol=1e-5)


@pytest.mark.compiled
def test_a_march_whose_end_has_no_balance_takes_its_last_step_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """The record is that of the undisturbed run, made by one more call."""
    stepper, scheme, _ = SCHEMES["Radau"]
    given = {"t_end": 0.3, "scheme": scheme, "output": fmbd.Output(energy=False)}
    right = fmbd.solve(double_pendulum(1.0, 2.0), **given)
    march, made = stepper.march, []

    def wrong(self: Any, h: float, steps: int, *more: Any, **named: Any) -> int:
        made.append(march(self, h, min(steps, 10), *more, **named))
        if made[-1] == 10 and sum(made) < 25:
            self.state = replace(self.state, lam=1.3 * self.state.lam)
        return made[-1]

    monkeypatch.setattr(stepper, "march", wrong)
    run = fmbd.solve(double_pendulum(1.0, 2.0), **given)
    assert run.counters["unbalanced_steps"] >= 1
    assert len(run.times) == len(right.times)
    np.testing.assert_allclose(run.times, right.times, rtol=1e-9)
    np.testing.assert_allclose(run["tip"], right["tip"], atol=1e-9)


@pytest.mark.parametrize("size, mass", [(1.0, 1.0), (1e-3, 1e8), (1e4, 1e-8)])
@pytest.mark.parametrize("name", ["alpha", "BDF, constant"])
def test_the_body_is_named(name: str, size: float, mass: float, spoilt: Any) -> None:
    """Where no part of the step has balance either."""
    stepper, scheme, dt = SCHEMES[name]
    spoilt(stepper, 0.3)
    with pytest.raises(ConvergenceError, match='the forces on body "[ab]" are not in balance'):
        fmbd.solve(double_pendulum(mass, 2 * mass, size), t_end=0.1, dt=dt, scheme=scheme)


def judged(scene: fmbd.Scene) -> tuple[Balanced, Any, Any]:
    """A judge, and the system of a scene in its consistent start."""
    run = fmbd.solve(scene, t_end=2e-3, dt=1e-3, scheme=fmbd.GeneralizedAlpha(0.8, compiled=False))
    solver = StepSolver(run.system)
    return Balanced(solver), run.system.at(run.state.t, run.state.q, run.state.v), run.state


def test_a_percent_of_the_accelerations_may_be_left() -> None:
    """From there on a state is refused."""
    judge, ev, state = judged(double_pendulum(1.0, 2.0))
    change = np.zeros_like(state.a)
    change[1] = 9.81
    judge.check(ev, replace(state, a=state.a + 2e-3 * change), 1e-3)
    with pytest.raises(ConvergenceError, match='"a"'):
        judge.check(ev, replace(state, a=state.a + 0.1 * change), 1e-3)


@pytest.mark.parametrize("stiffness", [1e3, 1e9, 1e18])
def test_the_roundoff_of_a_stiff_spring_is_balance(stiffness: float) -> None:
    """Forces of K times the last digit of a place are more than the weight."""
    bob = fmbd.RigidBody("bob", 1.0, 0.1, position=(0.7, -0.3))
    scene = fmbd.Scene("bob", gravity=(0.0, -9.81))
    length = float(np.hypot(0.7, 0.3))
    scene.add(bob, fmbd.Spring("rod", fmbd.ground, bob, (0.0, 0.0), (0.7, -0.3), stiffness=stiffness, length=length))
    judge, ev, state = judged(scene)
    judge.check(ev, state, 1e-3)
    shifted = ev.system.at(state.t, state.q * (1 + 4e-16), state.v)
    judge.check(shifted, state, 1e-3)


def test_what_joints_take_up_moves_no_body() -> None:
    """A thin rod has hardly any inertia to roll with, but its hinge lets it not: small errors of reactions move it nowhere."""
    rod = fmbd.RigidBody("rod", 1.0, (0.1, 1e-9, 0.1), (0.0, 0.0, 0.0))
    scene = fmbd.Scene("rod", gravity=(0.0, -5.0, -9.81))
    scene.add(rod, fmbd.revolute("hinge", fmbd.ground, rod, center=(0.1, 0.5, 0.0), axis=(0, 0, 1)))
    judge, ev, state = judged(scene)
    moment = np.abs(state.lam).max() * (np.arange(5) == np.abs(ev.jacobian.core[:, 4]).argmax())
    off = [replace(state, lam=state.lam + share * moment) for share in (1e-5, 1e-3)]
    left = ev.balance(off[0].a, off[0].lam)
    assert 1e-3 * np.abs(left[4]) / 1e-9 > 1.0  # rad/s, if nothing held it

    judge.check(ev, off[0], 1e-3)
    with pytest.raises(ConvergenceError, match='"rod"'):
        judge.check(ev, off[1], 1e-3)

    # swinging about the hinge is free
    free = np.linalg.svd(ev.jacobian.core)[2][-1]
    judge.check(ev, replace(off[0], a=off[0].a + 1e-3 * free), 1e-3)
    with pytest.raises(ConvergenceError, match='"rod"'):
        judge.check(ev, replace(off[0], a=off[0].a + free), 1e-3)


def test_contact_and_unknown_schemes_are_not_judged() -> None:
    """Contact forces are no part of lambda, and a scheme of a user's own may balance its forces elsewhere."""
    system, _, _ = double_pendulum(1.0, 2.0).build()
    solver = StepSolver(system)
    assert Balanced.under(solver, Declared.by(fmbd.Moreau()), 1e-6) is None
    assert Balanced.under(solver, Declared.by(object()), 1e-6) is None
    assert Balanced.under(solver, Declared.by(fmbd.Radau(rtol=1e-3)), 1e-6) is not None


def test_the_step_that_is_refused_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last of many compiled steps that were made in one call, not the first of them."""

    def refuse(*_: Any) -> None:
        raise ConvergenceError("not in balance")

    monkeypatch.setattr(Balanced, "check", refuse)
    with pytest.raises(ConvergenceError, match="step 20 of 20: not in balance"):
        fmbd.solve(double_pendulum(1.0, 2.0), t_end=0.02, dt=1e-3)


def test_looks_are_by_number() -> None:
    """Four times as many steps each time, up to a limit."""
    looks = [0]
    while looks[-1] < 50_000:
        looks.append(next_look(looks[-1]))
    assert looks[1:] == [64, 256, 1024, 4096, 16384, 32768, 49152, 65536]
    assert [next_look(n) for n in (63, 65, 255, 16383, 40000)] == [64, 256, 256, 16384, 49152]


ROOMS = {
    "one call": {"every": 1000},
    "a record each step": {"every": 1},
    "records every three": {"every": 3},
    "at given times": {"times": [0.01, 0.07, 0.0705]},
    "all shown": {"every": 1000, "on_step": lambda moment: None},
}


LOOKS = {
    fmbd.GeneralizedAlpha(0.8): [64, 256, 600],
    fmbd.BDF(2, rtol=None): [1, 64, 256, 600],  # whose first step is made in Python
}


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", LOOKS, ids=lambda scheme: scheme.name)
@pytest.mark.parametrize("cut", [*ROOMS, "by the clock", "checkpoints"])
def test_which_states_are_looked_at_is_a_matter_of_their_number(
    cut: str, scheme: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And not of how the run is cut into calls by records, the clock, who looks on, or checkpoints. Steps that Python makes one
    by one are all looked at.
    """
    if cut in ("checkpoints", "at given times") and isinstance(scheme, fmbd.BDF):
        pytest.skip("some of its steps are Python's")
    if cut == "by the clock":  # which goes on at each look by more than half of what a call may last
        ticks = count(step=0.6 * compiled_calls.CHUNK)
        monkeypatch.setattr(compiled_calls, "clock", SimpleNamespace(perf_counter=lambda: next(ticks)))
        monkeypatch.setattr(compiled_calls, "FIRST", 5)
    seen: list[int] = []
    monkeypatch.setattr(Balanced, "check", lambda self, ev, state, h: seen.append(round(state.t / h)))
    given: dict[str, Any] = {"energy": False, "progress": False} | ROOMS.get(cut, {"every": 1000})
    kept = fmbd.Checkpoint(tmp_path, every=100) if cut == "checkpoints" else None
    fmbd.solve(
        double_pendulum(1.0, 2.0), t_end=0.3, dt=5e-4, scheme=scheme, output=fmbd.Output(**given), checkpoint=kept
    )
    assert seen == LOOKS[scheme]


def test_a_link_of_hardly_any_mass_along_its_force() -> None:
    """Pendulum of a ball on a link of 1e-10 kg, which lies along an axis: its pins exert no moments then, and 3e-13 N m is no
    error of one. The same chain turned by 45 degrees has none either.
    """

    def fallen(turn: float) -> fmbd.Run:
        scene = fmbd.Scene("chain", gravity=(9.81 * np.sin(turn), -9.81 * np.cos(turn)))
        x, before = np.zeros(2), fmbd.ground
        for k in range(2):
            along = np.array([np.cos(turn), np.sin(turn)])
            link = fmbd.RigidBody(f"link {k}", 1e-10, 1e-10 / 12, position=x + 0.5 * along)
            ball = fmbd.PointMass(f"ball {k}", 1.0 + k, x + along)
            scene.add(link, ball, fmbd.revolute(f"pin {k}", before, link, center=x))
            x, before = x + along, link
            scene.add(fmbd.revolute(f"hold {k}", link, ball, center=x))
        scene.sensor("x", fmbd.position(ball))
        return fmbd.solve(scene, t_end=0.5, dt=1e-3, output=fmbd.Output(energy=False, progress=False))

    level, turned = fallen(0.0), fallen(np.pi / 4)
    R = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2.0)
    assert np.abs(level["x"] @ R.T - turned["x"]).max() < 1e-9
    assert level.counters["halved_steps"] == 0


def test_a_frame_is_held_by_its_elastic_field(rod_mesh: Any) -> None:
    """A rod in mean axes, clamped at an end, at rest under a load of 6 000 times its weight: small errors of reactions move its
    frame nowhere.
    """
    load = fmbd.traction("tip", (-5e8, -1e7))
    law = fmbd.materials.plane_strain(2.1e11, 0.3)
    rod = fmbd.FloatingBody("rod", rod_mesh(h=0.1), degree=1, density=7800.0, elastic=law, loads=[load])
    scene = fmbd.Scene("clamped", gravity=(0.0, -9.81), settle=True)
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))
    judge, ev, state = judged(scene)
    judge.solver.prepare(ev, Weights(1.0, 1e-2, 1e-4))

    judge.check(ev, replace(state, lam=(1 + 1e-5) * state.lam), 1e-2)
    with pytest.raises(ConvergenceError, match='"rod"'):
        judge.check(ev, replace(state, lam=(1 + 1e-3) * state.lam), 1e-2)
