"""Tangents of each iteration, which stiff springs that turn and friction that sticks ask for: no more of them than the rate of
convergence wants.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from combinations import scene_of

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.schemes.implicit.step_equations import StepEquations
from fmbd_fenicsx.schemes.onestep import stage_newton


def test_a_beam_on_a_spring_keeps_tangents_while_increments_fall_fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """One matrix in two iterations, three tangents each; the motion is that of a matrix for each iteration."""
    taken = 0
    plain = StepEquations.tangent_at

    def counted(self: StepEquations, *at: Any) -> Any:
        nonlocal taken
        taken += 1
        return plain(self, *at)

    monkeypatch.setattr(StepEquations, "tangent_at", counted)
    counts, ends = [], []
    for kept in (stage_newton.KEPT, -1.0):
        monkeypatch.setattr(stage_newton, "KEPT", kept)
        taken, scene = 0, scene_of("beam", "spring", "Radau")
        run = fmbd.solve(scene, t_end=0.014, dt=1e-3, scheme=fmbd.Radau(7, rtol=None))
        counts.append(taken)
        ends.append(run["tip"][-1])
    assert 0 < counts[0] < 0.65 * counts[1]
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-7)


def blocks(count: int, speed: float, weight: float = 9.81) -> fmbd.Scene:
    """Blocks of 1 kg in a row on springs; friction of 2 N is smooth over a speed (m/s), the last one is pulled to and fro."""
    scene, before = fmbd.Scene("blocks", gravity=(0.0, -weight)), None
    for i in range(count):
        block = fmbd.RigidBody(f"block {i}", 1.0, 0.1, position=(float(i), 0.0))
        slide = fmbd.prismatic(f"slide {i}", fmbd.ground, block, axis=(1, 0), center=(float(i), 0.0))
        rub = fmbd.joint_friction(f"rub {i}", fmbd.displacement(slide), coulomb=2.0, speed=speed)
        scene.add(block, slide, rub)
        if before is not None:
            ends = (i - 1.0, 0.0), (float(i), 0.0)
            scene.add(fmbd.Spring(f"spring {i}", before, block, *ends, stiffness=100.0, length=1.0))
        before = block
    scene.add(fmbd.force("pull", before, lambda t: (4.0 * np.sin(3.0 * t), 0.0)))
    scene.sensor("x", fmbd.position(before))
    return scene


def test_a_step_in_which_friction_sticks_asks_for_tangents_of_its_own_alone() -> None:
    """Those after it are made with one again: 92 tangents; 5 566 where all later steps took their own."""
    run = fmbd.solve(blocks(1, 1e-7), t_end=2.0, dt=1e-3, scheme=fmbd.Radau(rtol=None))
    assert run.counters["jacobians"] < 300
    assert run["x"][-1, 0] == pytest.approx(0.18113, abs=1e-3)  # SciPy's Radau, rtol 1e-7, as below


def test_more_laws_than_a_few_are_crossed_together() -> None:
    """Twenty of them, sixty with the stages."""
    run = fmbd.solve(blocks(20, 1e-5), t_end=2.0, scheme=fmbd.Radau(rtol=1e-5))
    assert run.counters["steps"] < 200 and run["x"][-1, 0] == pytest.approx(18.95312, abs=2e-5)


def test_soft_springs_are_no_ties_without_weight() -> None:
    """Friction is crossed as with it, by 116 tangents and 169 increments: springs of a scene at rest are no ties."""
    run = fmbd.solve(blocks(5, 1e-5, weight=0.0), t_end=0.5, scheme=fmbd.Radau(rtol=1e-5))
    assert run.counters["jacobians"] < 130 and run.counters["newton_iterations"] < 180
    assert run["x"][-1, 0] == pytest.approx(4.027103, abs=4e-6)


@pytest.mark.parametrize(("count", "place"), [(2, 0.98421), (5, 3.95310)])  # SciPy's Radau, rtol 1e-7
def test_what_comes_loose_does_not_creep(count: int, place: float) -> None:
    """With slopes of friction that sticks increments move hardly anything: the last block was off by 0.6 and 16 mm."""
    run = fmbd.solve(blocks(count, 1e-7), t_end=2.0, scheme=fmbd.BDF(rtol=1e-5))
    assert run["x"][-1, 0] == pytest.approx(place, abs=1e-4)


def test_what_comes_loose_does_not_creep_in_constant_steps() -> None:
    """The second block came loose late: forces out of balance by 0.2 N, 0.5 mm off at the end."""
    run = fmbd.solve(blocks(2, 1e-7), t_end=2.0, dt=1e-3, scheme=fmbd.BDF(order=2, rtol=None))
    assert run["x"][-1, 0] == pytest.approx(0.98421, abs=5e-5)
