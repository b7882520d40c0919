"""Balls that fall into a hopper and lie there with friction: forces found in compiled code, energy, overlap, weight."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.complementarity.coulomb import PIVOTED
from fmbd_fenicsx.schemes.impacts.compiled import driver
from fmbd_fenicsx.schemes.impacts.moreau_stepper import MoreauStepper

pytestmark = pytest.mark.compiled
G, R = 9.81, 0.05


def hopper(n: int) -> Any:
    """Balls of 1 kg, in layers, not quite above each other, over a floor between four walls that lean outwards."""
    rng = np.random.default_rng(1)
    side = max(2, int(np.ceil((n / 3) ** (1 / 3))))
    half = 0.065 * side + 0.02
    scene = fmbd.Scene("hopper", gravity=(0, 0, -G))
    balls = []
    for i in range(n):
        cell = np.array([i % side - 0.5 * (side - 1), i // side % side - 0.5 * (side - 1), i // side**2])
        place = 0.13 * cell + rng.uniform(-0.01, 0.01, 3) + np.array([0, 0, 0.15 + half])
        balls.append(fmbd.RigidBody(f"{i}", 1.0, (0.4 * R * R,) * 3, tuple(place)))
    scene.add(*balls)

    walls = [fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0, 0), (0, 0, 1)))]
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        up = np.array((-x, -y, 0.8)) / np.hypot(1.0, 0.8)
        walls.append(fmbd.Obstacle(f"wall {x} {y}", fmbd.HalfSpace((half * x, half * y, 0.8 * half), tuple(up))))
    law = {"friction": 0.3, "restitution": 0.2}
    for i, ball in enumerate(balls):
        for wall in walls:
            pair = fmbd.contact(f"{wall.name} under {i}", fmbd.ball(ball, R), wall, **law)
            scene.add(pair)
            scene.sensor(pair.name, fmbd.contact_impulse(pair))
        for j, other in enumerate(balls[:i]):
            carried = fmbd.Obstacle(f"{j} for {i}", fmbd.Sphere(R), on=other)
            scene.add(fmbd.contact(f"{i} on {j}", fmbd.ball(ball, R), carried, **law))
    return scene


def test_forces_of_a_heap_are_found_in_compiled_code() -> None:
    """Which contacts carry is a matter of slips of 1e-8 of an impact: Newton's iteration alone does not find them."""
    output = fmbd.Output(every=20, progress=False)
    run = fmbd.solve(hopper(12), t_end=0.4, dt=1e-3, scheme=fmbd.Moreau(), output=output)
    assert run.counters["compiled_steps"] == run.counters["steps"]
    assert run.counters["cycles_broken"] > 0  # Newton's plain iteration was not enough
    assert 0.0 < run.counters["complementarity_residual"] <= 1e-12

    total = sum(run.energy.values())
    assert np.diff(total).max() <= 1e-9 * abs(total[0])
    assert run.state.contact.gap.min() > -1e-3 * R

    # momentum: weight less impulses of the floor and the walls
    given = sum(run[name][-1] for name in run.series)
    momentum = run.state.v.reshape(12, 6)[:, :3].sum(axis=0)
    assert given + np.array((0.0, 0.0, -12 * G * 0.4)) == pytest.approx(momentum, abs=1e-9)


def test_slow_touches_of_a_heap_need_no_time_of_their_own() -> None:
    """Contacts of a heap open by far less than closed ones drift, and close again: steps are not cut there (20 iterations a step
    with contact where each had its own time), and no energy is won.
    """
    run = fmbd.solve(hopper(25), t_end=0.4, dt=1e-3, scheme=fmbd.Moreau(), output=fmbd.Output(every=20, progress=False))
    counts = run.counters
    assert counts["compiled_steps"] == counts["steps"]
    assert counts["impacts"] <= 4.0 * counts["contact_steps"]
    assert counts["contact_newton_iterations"] <= 16.0 * counts["contact_steps"]
    assert counts["complementarity_residual"] <= 1e-12

    total = sum(run.energy.values())
    assert np.diff(total).max() <= 1e-9 * abs(total[0])
    assert run.state.contact.gap.min() > -1e-3 * R


def test_a_heap_settles_in_compiled_code() -> None:
    """Just before balls rest, which of their contacts carry is a matter of slips that no velocity is known to: forces are found
    to what is accepted, or to rates that Newton's iteration leaves, and none by Python's pivoting, which takes minutes.
    """
    run = fmbd.solve(hopper(25), t_end=0.9, dt=1e-3, scheme=fmbd.Moreau(), output=fmbd.Output(every=50, progress=False))
    assert run.counters["compiled_steps"] == run.counters["steps"]
    assert run.counters["cycles_broken"] <= 120  # forces sought a second time (289 where all began at the last forces)
    assert np.diff(sum(run.energy.values())).max() <= 1e-9 * abs(sum(run.energy.values())[0])
    assert run.state.contact.gap.min() > -1e-3 * R


def test_a_step_whose_forces_are_not_found_is_made_in_parts_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """NumPy would look for those of many contacts for seconds, and fail."""
    march, dt = driver.ContactDriver.march, 1e-3

    def refused(self: Any, h: float, *more: Any) -> int:
        if h < dt:
            return march(self, h, *more)
        self.c.unsolved = PIVOTED + 1
        return 0

    def never(*_: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(driver.ContactDriver, "march", refused)
    monkeypatch.setattr(MoreauStepper, "advance", never)
    run = fmbd.solve(hopper(2), t_end=4 * dt, dt=dt, scheme=fmbd.Moreau(), output=fmbd.Output(progress=False))
    assert run.counters["compiled_steps"] == 2 * run.counters["steps"] == 8
