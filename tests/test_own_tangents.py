"""Tangents of each iteration, which stiff springs that turn ask for: no more of them than the rate of convergence wants."""

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
        run = fmbd.solve(scene, t_end=0.014, dt=1e-3, scheme=fmbd.Radau(rtol=None))
        counts.append(taken)
        ends.append(run["tip"][-1])
    assert 0 < counts[0] < 0.65 * counts[1]
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-7)
