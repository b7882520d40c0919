"""Searches for a tolerance make nothing that they have, or that tells them nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from tolerance_more import copper_arm, springs_in_millimetres

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError, PartsError
from fmbd_fenicsx.run.accuracy.search import next_attempt, shared_runs, shared_spaces, tolerance
from fmbd_fenicsx.run.schedule import StepSchedule
from fmbd_fenicsx.schemes.onestep.alpha.alpha_stepper import AlphaStepper
from fmbd_fenicsx.system.evaluation import Evaluation


def test_steps_that_only_tell_an_error_are_not_tried_again_by_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twelve steps are too few for this arm: a look ends where compiled code finds none, which a run goes on behind."""
    asked: list[float] = []
    advance = AlphaStepper.advance

    def counted(self: Any, h: float) -> Any:
        asked.append(h)
        return advance(self, h)

    monkeypatch.setattr(AlphaStepper, "advance", counted)
    scene, scheme, schedule = copper_arm(), fmbd.GeneralizedAlpha(), StepSchedule(0.3, 12)
    shared, output = shared_runs.SharedRuns(None, None, 12), fmbd.Output(energy=False, progress=False)
    with pytest.raises(PartsError, match="of 12: .* at once"):
        shared.look(scene, scheme, schedule, output)
    assert not asked
    with pytest.raises(ConvergenceError):
        fmbd.solve(copper_arm(), t_end=0.3, dt=0.025, output=output)
    assert asked


def test_loads_are_asked_by_compiled_code_before_the_first_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hundred instants are evaluated in a few calls, as in the runs that follow."""
    made: list[float] = []
    balance = Evaluation.balance

    def counted(self: Any, *given: Any) -> Any:
        made.append(self.t)
        return balance(self, *given)

    monkeypatch.setattr(Evaluation, "balance", counted)
    scene = springs_in_millimetres()
    plan = tolerance._first(scene, None, 2.0, None)
    assert next_attempt.jumps_before(plan, shared_spaces.SharedSpaces(None, None, 25)) == () and not made
    plan = replace(plan, scheme=fmbd.GeneralizedAlpha(compiled=False))
    assert next_attempt.jumps_before(plan, shared_spaces.SharedSpaces(None, None, 25)) == () and len(made) > 100
