"""What runs state of their errors is between half and three times the truth: of each kind alone, and of all together."""

from __future__ import annotations

import numpy as np
import pytest
from honesty_scenes import HONEST, judge
from tolerance_scenes import spun_up

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.run.deviation import Deviation, together

QUICK = ("clamped beam", "rotating cantilever")


@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n in QUICK else pytest.mark.slow) for n in HONEST])
def test_statements_are_honest(name: str) -> None:
    found = judge(name)
    print(found.row())
    assert found.ok, (found.ratios, found)
    assert {"space", "together"} & set(found.ratios)


def test_errors_add_up_with_their_signs() -> None:
    """At every instant; what cancels counts as two thirds at most; other times are found on straight lines."""
    t, half = np.linspace(0.0, 1.0, 5), np.linspace(0.0, 1.0, 3)
    up, down = Deviation(t, t[:, None]), Deviation(half, -0.75 * half[:, None])
    early = Deviation(half, (1.0 - half)[:, None])
    assert together([up, up]) == pytest.approx(2.0)
    assert together([up, early]) == pytest.approx(1.0)  # never at once
    assert together([up, down]) == pytest.approx(1.75 / 3)
    assert together([up, Deviation(half, -0.25 * half[:, None])]) == pytest.approx(0.75)
    assert together([]) == 0.0


def test_the_error_of_algebra_is_measured() -> None:
    """Newton's iterations mostly end well below their tolerance; a looser one is seen."""
    tight, loose = (
        fmbd.solve(spun_up(), t_end=1.0, dt=0.01, newton=fmbd.Newton(tolerance=tol)) for tol in (1e-6, 1e-3)
    )
    assert 0.0 < tight.newton_accuracy < 1e-6
    assert tight.newton_accuracy < loose.newton_accuracy < 1e-3
    off = np.abs(
        loose["tip"] - fmbd.solve(spun_up(), t_end=1.0, dt=0.01, newton=fmbd.Newton(tolerance=1e-11))["tip"]
    ).max()
    assert off <= 3.0 * loose.certificate["tip"].algebra


def test_records_between_large_steps_are_no_open_joints() -> None:
    """A polynomial between the ends of steps leaves joints open by its own error; the ends of the steps are what is judged."""
    times = tuple(np.linspace(0.0, 8.0, 41))
    run = fmbd.solve(spun_up(), t_end=8.0, dt=0.08, output=fmbd.Output(times=times))
    every = fmbd.solve(spun_up(), t_end=8.0, dt=0.08)
    assert run.drift[0] <= every.drift[0] and run.drift[0] < 1e-9
    assert np.abs(run["tip"][-1] - every["tip"][-1]).max() == 0.0
