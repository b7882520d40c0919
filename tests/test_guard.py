"""The energy guard: unexplained gains are taken back, everything else is left alone."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_energy_momentum import spinner

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError
from fmbd_fenicsx.run.judges.energy_check import Guarded, Watch, closed
from fmbd_fenicsx.run.step_bisection import ConstantSteps
from fmbd_fenicsx.schemes import TimeStepper
from fmbd_fenicsx.system.layout import State


def rod() -> fmbd.Scene:
    scene = fmbd.Scene("rod", gravity=(0, -9.81))
    body = fmbd.RigidBody("rod", 1.0, 1 / 12, position=(0.5, 0.0))
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body, center=(0, 0)))
    return scene


@pytest.mark.parametrize(("rho", "eps", "h"), [(0.9, 1e-2, 0.5), (0.8, 1e-3, 0.5)])
def test_a_stiff_spring_that_turns_gains_nothing(rho: float, eps: float, h: float) -> None:
    """Without the guard these runs end with 1788 and 13 J instead of 0.5."""
    run = fmbd.solve(spinner(eps), t_end=20.0, dt=h, scheme=fmbd.GeneralizedAlpha(rho))
    energy = sum(run.energy.values())
    assert energy.max() < 1.02 * energy[0]
    assert 1 <= run.counters["energy_rejections"] <= 4
    assert len(run.times) == round(20 / h) + 1 and run.times[-1] == pytest.approx(20.0)


def test_without_the_guard_it_gains() -> None:
    """The same with the energies not recorded: what the guard is for."""
    scene = spinner(1e-2)
    run = fmbd.solve(scene, t_end=20.0, dt=0.5, scheme=fmbd.GeneralizedAlpha(0.9), output=fmbd.Output(energy=False))
    end = run.system.at(run.state.t, run.state.q, run.state.v)
    start = scene.build()[1]
    before = run.system.at(0.0, start.q, start.v)
    assert sum(end.energies().values()) > 100 * sum(before.energies().values())
    assert "energy_rejections" not in run.counters


@pytest.mark.parametrize(
    "scheme", [fmbd.GeneralizedAlpha(0.8), fmbd.Rattle(), fmbd.EnergyMomentum()], ids=lambda s: s.name
)
def test_smooth_motion_is_left_alone(scheme: Any) -> None:
    """Steps of 0.1 / omega: no step is taken back, what is gained falls like h^2."""
    gains = []
    for h in (0.04, 0.02):
        run = fmbd.solve(rod(), t_end=1.2, dt=h, scheme=scheme)
        energy = sum(run.energy.values())
        gains.append(float((energy - energy[0]).max()) / run.energy["kinetic"].max())
        assert run.counters["energy_rejections"] == 0
    assert gains[1] < max(0.3 * gains[0], 1e-10), gains


def closes(scene: fmbd.Scene) -> bool:
    return closed(scene, scene.build()[0])


def test_what_may_do_work_is_not_guarded() -> None:
    assert closes(rod()) and closes(spinner(0.1))
    for part in (
        lambda b, j: fmbd.force("wind", b, lambda t: (1.0, 0.0)),
        lambda b, j: fmbd.effort("motor", fmbd.angle(j), lambda t: 1.0),
        lambda b, j: fmbd.drive("motor", fmbd.angle(j), lambda t: t),
        lambda b, j: fmbd.drive_rotation("motor", fmbd.ground, b, lambda t: t),
        lambda b, j: fmbd.Spring("own", fmbd.ground, b, point_a=(2, 0), law=lambda s, v, t: -s),
        lambda b, j: fmbd.Tyre("tyre", b, stiffness=1e4, road=lambda x, t: 0.0, up=(0, 1)),
        lambda b, j: fmbd.own_joint("own", fmbd.ground, b, lambda xa, Ra, xb, Rb, t: xb[:1] - xa[:1] - t),
    ):
        scene = rod()
        scene.add(part(scene.bodies["rod"], scene.joints["pin"]))
        assert not closes(scene)
    assert not closes(replace(rod(), gravity_ramp=0.1))


def orbit() -> fmbd.Scene:
    """A body on a circle about an attracting point, 1 rad/s: the potential is negative, twice the kinetic energy in size."""
    body = fmbd.RigidBody("moon", 1.0, 1.0, position=(1.0, 0.0), velocity=(0.0, 1.0))
    scene = fmbd.Scene("orbit")
    pull = fmbd.force_element("pull", fmbd.ground, body, lambda a, b, t: -1.0 / ((b.x - a.x) @ (b.x - a.x)) ** 0.5)
    scene.add(body, pull)
    return scene


@pytest.mark.parametrize("scheme", [fmbd.GeneralizedAlpha(0.8), fmbd.Rattle()], ids=lambda s: s.name)
def test_a_potential_of_ones_own_is_guarded(scheme: Any) -> None:
    """A law along a coordinate may do anything, a potential may not: a scene with it is watched, in compiled steps too."""
    assert closes(orbit())
    run = fmbd.solve(orbit(), t_end=3.0, dt=0.02, scheme=scheme)
    total = sum(run.energy.values())
    assert run.counters["energy_rejections"] == 0 and not run.warnings
    assert np.abs(total + 0.5).max() < 1e-3
    assert run.energy["springs"] == pytest.approx(-1.0, abs=1e-2)
    pushed = rod()
    body = pushed.bodies["rod"]
    pushed.add(fmbd.force_element("own", fmbd.ground, body, lambda a, b, t: b.x[0] - a.x[0], law=lambda s, v, t: -s))
    assert not closes(pushed)


def test_a_stiff_potential_that_turns_gains_nothing() -> None:
    """The stiff spring of above as a potential: the guard takes the same steps back."""
    scene = spinner(1e-2)
    spring = next(iter(scene.forces.values()))
    del scene.forces[spring.name]
    k, free = spring.stiffness, spring.length

    def stretched(a: Any, b: Any, t: Any) -> Any:
        return 0.5 * k * (((b.x - a.x) @ (b.x - a.x)) ** 0.5 - free) ** 2

    scene.add(fmbd.force_element("own", spring.a, spring.b, stretched, points=(spring.point_a, spring.point_b)))
    run = fmbd.solve(scene, t_end=10.0, dt=0.5, scheme=fmbd.GeneralizedAlpha(0.9))
    energy = sum(run.energy.values())
    assert energy.max() < 1.02 * energy[0] and run.counters["energy_rejections"] >= 1


class Heater(TimeStepper):
    """Steps that gain energy when they are longer than ``longest``."""

    def __init__(self, state: State, longest: float) -> None:
        self.state, self.longest = state, longest

    def advance(self, h: float) -> State:
        factor = 1.1 if h > self.longest else 1.0
        self.state = replace(self.state, t=self.state.t + h, v=factor * self.state.v)
        return self.state


class ControlledHeater(Heater):
    def restart(self, t: float) -> None:
        pass


def guard(kind: type[Heater], state: State, longest: float, system: Any) -> Any:
    """A stepper under guard, with error control or with constant steps."""
    stepper, watch = kind(state, longest), Watch(system, state)
    if kind is ControlledHeater:
        return Guarded(stepper, watch)
    return ConstantSteps(stepper, system, lambda s: kind(s, longest), watch)


@pytest.mark.parametrize("kind", [Heater, ControlledHeater])
def test_halving_and_stop(kind: type[Heater]) -> None:
    scene = fmbd.Scene("free")
    scene.add(fmbd.RigidBody("body", 2.0, 1.0, velocity=(1.0, 0.0)))
    system, state, _ = scene.build()
    guarded = guard(kind, state, 0.3, system)
    found = guarded.advance(1.0)
    assert guarded.watch.rejections == 2 and found.v[0] == 1.0
    assert found.t == pytest.approx(1.0 if kind is Heater else 0.25)
    assert guarded.evaluation.t == found.t
    again = guarded.advance(0.25)
    assert again.t == pytest.approx(found.t + 0.25) and guarded.watch.rejections == 2
    hot = guard(kind, state, 0.0, system)
    with pytest.raises(
        ConvergenceError,
        match=r"gains 0\.2.* J from nothing.*turns, or one so stiff.*roundoff of its places.*EnergyMomentum",
    ):
        hot.advance(1.0)
    assert np.isfinite(hot.state.v).all()


@pytest.mark.parametrize("slows", [False, True])
def test_whole_steps_come_back_where_motion_is_slower(slows: bool) -> None:
    """Behind a step that gained energy later ones are made in parts, as long as the motion is as fast as there."""

    class Braked(Heater):
        def advance(self, h: float) -> State:
            after = super().advance(h)
            self.state = replace(after, v=(0.9 if slows and h < self.longest else 1.0) * after.v)
            self.longest = np.inf if abs(after.v[0]) < 0.5 else self.longest
            return self.state

    scene = fmbd.Scene("free")
    scene.add(fmbd.RigidBody("body", 2.0, 1.0, velocity=(1.0, 0.0)))
    system, state, _ = scene.build()
    stepper = ConstantSteps(Braked(state, 0.3), system, lambda s: Braked(s, 0.3), Watch(system, state))
    parts = []
    for _ in range(6):
        stepper.advance(1.0)
        parts.append(stepper.whole)
    assert parts == ([2, 1, 0, 0, 0, 0] if slows else [2] * 6)
    assert stepper.watch is not None and stepper.watch.rejections == 2


def test_elastic_bodies_may_settle() -> None:
    """The overshoot of vibrations that the first steps do not resolve is no reason for shorter ones."""
    scene = fmbd.Scene("free")
    scene.add(fmbd.RigidBody("body", 2.0, 1.0, velocity=(1.0, 0.0)))
    system, state, _ = scene.build()
    elastic = SimpleNamespace(
        at=system.at,
        mass=2.0,
        gravity=system.gravity,
        length=1.0,
        parts=("rod",),
        finite=system.finite,
        fields=(),
        forces=(),
        keepers=(),
        max_abs=system.max_abs,
        poses=system.poses,
        motions=system.motions,
        cache={"turning": ()},
    )
    guarded = guard(Heater, state, 0.3, elastic)
    for _ in range(10):
        guarded.advance(1.0)
    assert guarded.watch.rejections == 0 and guarded.state.v[0] > 2.0
    guarded.advance(1.0)
    assert guarded.watch.rejections == 2


def bouncing(k: float, damping: float = 0.0) -> fmbd.Scene:
    """A ball that falls by 1 m onto an elastic stop."""
    scene = fmbd.Scene("bounce", gravity=(0.0, -9.81))
    ball = fmbd.RigidBody("ball", 1.0, 0.1, position=(0.0, 0.0))
    rail = fmbd.prismatic("rail", fmbd.ground, ball, center=(0, 0), axis=(0, 1))
    stop = fmbd.elastic_stop("stop", fmbd.displacement(rail), lower=-1.0, stiffness=k, damping=damping)
    scene.add(ball, rail, stop)
    return scene


@pytest.mark.parametrize(
    ("scheme", "dt", "k", "words"),
    [
        (fmbd.GeneralizedAlpha(rtol=0.3), None, 1e6, ["the energy grows by", "of the energy is lost in a step"]),
        (fmbd.GeneralizedAlpha(rtol=1e-2), None, 1e6, []),
        (fmbd.GeneralizedAlpha(), 0.013, 1e6, ["the energy grows by", "of the energy is lost in a step"]),
        (fmbd.Radau(rtol=1e-6), None, 1e6, []),
        (fmbd.GeneralizedAlpha(), 1e-4, 1e6, []),
    ],
)
def test_a_stop_that_is_struck_within_a_step(scheme: Any, dt: float | None, k: float, words: list[str]) -> None:
    """A stop stores and gives back: energy that a step makes or loses there is told, where nothing gives or takes any."""
    run = fmbd.solve(bouncing(k), t_end=1.82, dt=dt, scheme=scheme)
    assert len(run.warnings) == len(words)
    for word, told in zip(words, run.warnings, strict=True):
        assert word in told
    damped = fmbd.solve(bouncing(k, damping=50.0), t_end=0.6, dt=1e-4)
    assert not damped.warnings
