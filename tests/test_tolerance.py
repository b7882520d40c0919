"""Runs with a tolerance keep it, against references that are exact or come from other discretisations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dae_problems import pendulum
from tolerance_scenes import CASES, TIMES, check

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.run import estimates, single_run

QUICK = ("pendulum", "mass on spring", "clamped beam", "spin-up")
CALLS = [
    pytest.param(name, k, id=f"{name}, {tol:g}", marks=[] if name in QUICK else pytest.mark.slow)
    for name, case in CASES.items()
    for k, tol in enumerate(case.tolerances)
]


@pytest.mark.parametrize(("name", "k"), CALLS)
def test_a_tolerance_is_kept(name: str, k: int) -> None:
    """Stated below, and truly below; what is stated is no more than a few times the truth would be if errors added up."""
    case = CASES[name]
    found = check(name, case.tolerances[k], case.reference(case, np.linspace(0.0, case.t_end, TIMES)))
    print(found)
    assert found.ok, found
    assert found.stated <= found.tol
    assert found.attempts <= 3


def test_meshes_are_looked_at_with_few_steps() -> None:
    """A block with singular corners: errors fall more slowly than expected, which is seen before a whole run is spent."""
    case = CASES["near-incompressible block"]
    run = fmbd.solve(case.scene(), t_end=case.t_end, tol={case.sensor: case.tolerances[1]})
    first, look, last = run.history
    assert look.step >= 3.9 * first.step and look.then == "finer meshes" and look.worst > 0.6
    assert (first.meshes, look.meshes, last.meshes) == (0, 1, 2) and last.then == "done"


@pytest.mark.parametrize("tol", [1e-4, 1e-5])
def test_all_attempts_together_take_few_steps(monkeypatch: pytest.MonkeyPatch, tol: float) -> None:
    """An earlier attempt tells the error of the last one: all runs together take at most 1.7 times the steps of the last."""
    taken = []
    march = single_run.march

    def counted(problem: Any, solver: Any, pace: Any, *rest: Any, **more: Any) -> Any:
        taken.append(pace.steps)
        return march(problem, solver, pace, *rest, **more)

    for module in (estimates, single_run):
        monkeypatch.setattr(module, "march", counted)
    run = fmbd.solve(pendulum(), t_end=2.0, tol={"x": tol}, output=fmbd.Output(every=7))
    steps = run.counters["steps"]
    assert sum(taken) <= 1.7 * steps, taken
    assert run.observed_order["x"] == pytest.approx(2.0, abs=0.1)

    # recorded as asked for
    wanted = np.append(np.arange(0, steps, 7), steps) * 2.0 / steps
    np.testing.assert_allclose(run.times, np.unique(wanted.round(12)), atol=1e-9)
    assert len(run["x"]) == len(run.times) == len(run.total_energy)
