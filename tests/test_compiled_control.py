"""Generalized-alpha with steps of its own choice: compiled code makes and judges them and changes their size, as Python does."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import checkpoint_scenes
import numpy as np
import pytest
import unit_scenes
from dae_problems import spinning_top
from test_compiled import chain
from test_variable_alpha import driven_crank, driven_pendulum, loaded_rod

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError
from fmbd_fenicsx.materials import plane_stress
from fmbd_fenicsx.run.judges.force_balance import Balanced
from fmbd_fenicsx.schemes.onestep.alpha.variable_alpha import VariableAlpha

pytestmark = pytest.mark.compiled
SI = unit_scenes.Units(1.0, 1.0, 1.0)
QUIET: dict[str, Any] = {"progress": False}


def twice_pinned() -> fmbd.Scene:
    """A chain with a joint that is there twice."""
    scene = chain(2)
    scene.add(fmbd.revolute("again", fmbd.ground, scene.bodies["0"], center=(0, 0)))
    return scene


def reduced() -> fmbd.Scene:
    """A blade on a pin, by its modes."""
    field = checkpoint_scenes.rod(h=0.1, height=0.04)
    body = fmbd.FloatingBody("blade", field, density=1000.0, elastic=plane_stress(1e8, 0.3)).reduced(modes=3)
    scene = fmbd.Scene("modes", gravity=(0, -9.81))
    scene.add(body, fmbd.revolute("pin", body.surface("pin"), fmbd.ground, center=(0, 0)))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return scene


def floating() -> fmbd.Scene:
    return checkpoint_scenes.floating()[0]


def absolute() -> fmbd.Scene:
    """A sheet in absolute coordinates that hangs on a link."""
    link = fmbd.RigidBody("link", 1.0, 0.1, position=(0.0, 0.5))
    sheet = fmbd.AbsoluteBody(
        "sheet", checkpoint_scenes.rod(h=0.25, height=0.1), density=1000.0, elastic=plane_stress(1e7, 0.3)
    )
    scene = fmbd.Scene("absolute", gravity=(0, -9.81))
    scene.add(link, sheet, fmbd.revolute("top", fmbd.ground, link, center=(0, 1)))
    scene.add(fmbd.revolute("pin", link, sheet.surface("pin"), center=(0, 0)))
    scene.sensor("tip", fmbd.position(sheet.surface("tip")))
    scene.sensor("link", fmbd.position(link))
    return scene


def wheel() -> fmbd.Scene:
    """A wheel that swings by a few degrees about its own centre, which rests: its way is its turn."""
    disk = fmbd.RigidBody("disk", 1.0, (0.1, 0.1, 0.2), angular_velocity=(0, 0, 0.4))
    axle = fmbd.revolute("axle", fmbd.ground, disk, axis=(0, 0, 1), center=(0, 0, 0))
    scene = fmbd.Scene("wheel")
    scene.add(disk, axle, fmbd.joint_spring("coil", fmbd.angle(axle), stiffness=10.0, damping=0.01))
    scene.sensor("turn", fmbd.angle(axle))
    return scene


def rolling() -> fmbd.Scene:
    return unit_scenes.rolling(SI).scene


def controlled() -> fmbd.Scene:
    return unit_scenes.controlled(SI).scene


def sampled() -> fmbd.Scene:
    return unit_scenes.sampled(SI).scene


def carriage() -> fmbd.Scene:
    return unit_scenes.carriage(SI).scene


def tank() -> fmbd.Scene:
    """Water that sloshes, with coordinates of its own sizes, beside a chain."""
    scene = chain(2)
    water = lambda q, v, t: -np.array([90.0 * q[0] + 0.1 * v[0] ** 3, 4e3 * q[1] + 30.0 * q[0] * q[1]])
    scene.add(fmbd.CoordinateBody("water", np.diag([2.0, 0.5]), water, (0.1, 2e-4), (0.0, 0.3)))
    scene.sensor("level", fmbd.sensors.coordinates("water"))
    return scene


SCENES: dict[Callable[[], fmbd.Scene], float] = {  # and how long they run, s
    lambda: chain(4): 1.0,
    spinning_top: 1.0,
    twice_pinned: 1.0,
    driven_crank: 0.8,
    lambda: driven_pendulum(1.0): 1.0,
    lambda: loaded_rod(0.3): 0.2,
    controlled: 1.0,
    sampled: 0.5,
    carriage: 0.5,
    wheel: 2.0,
    rolling: 1.0,
    reduced: 0.3,
    floating: 0.2,
    absolute: 0.05,
    tank: 1.0,
}
NAMES = "chain top redundant crank pendulum rod controlled sampled carriage wheel rolling reduced floating absolute water".split()
WAYS: dict[str, dict[str, Any]] = {
    "all": {},
    "stabilised": {"form": fmbd.GGL()},
    "some": {"every": 3, "snapshots": 4},
    "instants": {"times": tuple(np.linspace(0.0, 0.2, 12))},
    "limited": {"dt": 0.01, "atol": 1e-6},
}


def solve(scene: fmbd.Scene, t_end: float, *, rtol: float = 1e-4, **given: Any) -> fmbd.Run:
    """A run with steps of its own choice."""
    newton = given.pop("newton", None)
    law = {name: given.pop(name) for name in ("form", "atol") if name in given}
    dt = {"dt": given.pop("dt")} if "dt" in given else {}
    if "times" in given:
        given["times"] = tuple(t for t in given["times"] if t <= t_end)
    scheme = fmbd.GeneralizedAlpha(rtol=rtol, **law)
    return fmbd.solve(scene, t_end=t_end, scheme=scheme, newton=newton, output=fmbd.Output(**QUIET, **given), **dt)


class Entries:
    """Counts what Python does for the steps; ``seen``: error, way and deflections after the step that ended at a time."""

    def __init__(self, patch: pytest.MonkeyPatch, *, compiled: bool = True) -> None:
        self.counts = counts = Counter[str]()
        self.seen = seen = dict[float, list[float]]()
        advance, march = VariableAlpha.advance, VariableAlpha.march

        def noted(self: VariableAlpha) -> None:
            seen[round(self.state.t, 10)] = [self.error, min(self.norm.way, 1.0), *self.norm.deflections]

        def counted_advance(self: VariableAlpha, h: float) -> Any:
            counts["single"] += 1
            state = advance(self, h)
            noted(self)
            return state

        def counted_march(self: VariableAlpha, h: float, steps: int, *more: Any, **named: Any) -> int:
            made = march(self, h, steps, *more, **named) if compiled else 0
            counts["calls"] += 1
            counts["marched"] += made
            if made:
                noted(self)
            return made

        patch.setattr(VariableAlpha, "advance", counted_advance)
        patch.setattr(VariableAlpha, "march", counted_march)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("make", SCENES, ids=NAMES)
def test_same_steps_in_one_call_and_one_by_one(make: Any, way: str) -> None:
    """The same sizes and refusals; values to roundoff, which stiff forces and short steps amplify. Errors of velocities are
    second differences of accelerations: Newton's iteration leaves little, and of the one that is allowed they are known to 1e-4.
    """
    settings = {**WAYS[way], "newton": fmbd.Newton(tolerance=1e-8)}
    with pytest.MonkeyPatch.context() as patch:
        entries = Entries(patch)
        fast = solve(make(), SCENES[make], **settings)
    with pytest.MonkeyPatch.context() as patch:
        single = Entries(patch, compiled=False)
        slow = solve(make(), SCENES[make], **settings)

    if not (make is driven_crank and way == "stabilised"):  # has no freedom: takes one step
        assert entries.counts["marched"] > 0
    for name in ("steps", "rejections", "factorisations"):
        assert fast.counters[name] == slow.counters[name], name
    assert fast.counters["newton_iterations"] == pytest.approx(slow.counters["newton_iterations"], rel=0.02)
    assert np.allclose(fast.times, slow.times, rtol=1e-12, atol=1e-14)
    for t, seen in entries.seen.items():
        error, *sizes = single.seen[t]
        assert seen[0] == pytest.approx(error, rel=1e-5, abs=1e-4), t
        assert seen[1:] == pytest.approx(sizes, rel=1e-5, abs=1e-9), t
    assert fast.local_error == pytest.approx(slow.local_error, rel=1e-5, abs=1e-4)
    for name in fast.scene.sensors:
        assert np.abs(fast[name] - slow[name]).max() < 1e-7 * np.abs(slow[name]).max(), name
    for kind, energy in fast.energy.items():
        assert np.allclose(energy, slow.energy[kind], rtol=1e-7, atol=1e-9), kind
    assert [s.t for s in fast.snapshots] == pytest.approx([s.t for s in slow.snapshots])


@pytest.mark.parametrize("make", [lambda: chain(6), reduced, carriage], ids="chain reduced loads".split())
def test_sizes_change_in_compiled_code(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Calls are as many as records and looks ask for, some four times as many steps each, and as loads by functions of time: of a
    hundred steps at most two enter Python, where each tenth changed its size in one.
    """
    entries = Entries(monkeypatch)
    run = solve(make(), 2.0, rtol=1e-5)
    sizes = np.diff(run.times)
    changes = np.count_nonzero(np.abs(np.diff(sizes)) > 1e-6 * sizes[1:]) + run.counters["rejections"]
    assert changes > 10 and run.counters["steps"] > 900
    assert entries.counts["single"] <= 2  # the first, and one whose size a look refused in the midst
    assert entries.counts["single"] + entries.counts["calls"] < 0.02 * run.counters["steps"]


def test_elastic_bodies_change_their_sizes_in_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """Factors of their fields are Python's: of hundreds of steps one in ten at most is made by itself, and calls hold many."""
    entries = Entries(monkeypatch)
    run = solve(floating(), 0.5, rtol=1e-5)
    assert run.counters["steps"] > 200
    assert entries.counts["single"] + entries.counts["calls"] < 0.2 * run.counters["steps"]


def test_compiled_and_numpy_steps_are_of_the_same_sizes() -> None:
    """Both evaluate, solve and judge by themselves."""
    runs = [
        fmbd.solve(chain(4), t_end=0.5, scheme=fmbd.GeneralizedAlpha(rtol=1e-4, compiled=compiled))
        for compiled in (True, False)
    ]
    assert np.allclose(runs[0].times, runs[1].times, rtol=1e-12)
    assert np.abs(runs[0].state.q - runs[1].state.q).max() < 1e-10
    assert runs[0].counters["compiled_steps"] > 0.9 * runs[0].counters["steps"]
    assert "compiled_steps" not in runs[1].counters
    assert [run.plan.path.split()[0] for run in runs] == ["compiled", "NumPy"]


@pytest.mark.parametrize("every", [1, 3])
def test_a_compiled_step_out_of_balance_is_taken_back(every: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """With its record, and goes on in smaller ones."""
    check, refused = Balanced.check, []

    def refuse_once(self: Balanced, ev: Any, state: Any, h: float) -> None:
        if not refused and state.t > 0.1:
            refused.append(state.t)
            raise ConvergenceError("not in balance")
        check(self, ev, state, h)

    monkeypatch.setattr(Balanced, "check", refuse_once)
    run = solve(chain(4), 1.0, every=every)
    plain, exact = solve(chain(4), 1.0), solve(chain(4), 1.0, rtol=1e-6)
    assert refused and refused[0] not in run.times and run.counters["unbalanced_steps"] == 1
    assert (np.diff(run.times) > 0).all() and len(run.times) == len(run.energy["kinetic"])
    assert np.abs(run.state.q - exact.state.q).max() < 2 * np.abs(plain.state.q - exact.state.q).max()


def test_a_push_within_one_of_many_calm_steps_is_seen() -> None:
    """Of a mass at rest that is pushed for a quarter of a step of a given size."""
    scene, body = fmbd.Scene("pushed"), fmbd.RigidBody("mass", 1.0, 1.0, (0.0, 0.0))
    load = lambda t: (np.sin(np.pi * (t - 5.1) / 0.2) ** 4 if 5.1 < t < 5.3 else 0.0, 0.0)
    scene.add(body, fmbd.force("push", body, load))
    run = solve(scene, 10.0, rtol=1e-4, dt=0.8)
    assert run.state.q[0] == pytest.approx(0.375 * 0.2 * 4.8, rel=1e-2)
