"""A small part of the observatory: errors fall with the tolerance and the step, failures are rows."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[0]), str(HERE.parents[1] / "demos")]

from observatory import CONTROLLED, Point, one, peer  # noqa: E402
from observatory_page import page  # noqa: E402
from observatory_problems import PROBLEMS  # noqa: E402


@pytest.mark.parametrize("name", ["gears", "free body"])
def test_errors_fall_with_the_tolerance(name: str) -> None:
    """By four orders of magnitude in the tolerance two in the error, for every scheme with error control, or to below the
    tolerance: least steps of a scheme of order eight are more than enough for the larger one.
    """
    for scheme in CONTROLLED:
        coarse, fine = one(name, scheme, 1e-2), one(name, scheme, 1e-6)
        assert not coarse.failure and not fine.failure
        assert fine.error < 2e-3 and fine.error <= max(0.02 * coarse.error, 1e-6), (scheme, coarse, fine)


@pytest.mark.parametrize("name", ["double pendulum", "mass on spring", "spring pendulum"])
def test_second_order_with_equal_steps(name: str) -> None:
    """Against references that know nothing of this code."""
    steps = PROBLEMS[name].steps
    errors = [one(name, "generalized-alpha", k * steps).error for k in (1, 4)]
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.15)


# of the mesh alone, or of the modes, where steps are fine
MESHES = {
    "smoothly pulled bar": 1e-5,
    "wave through a tie": 1e-6,
    "stretched rod": 1e-6,
    "bent beam": 1e-2,
    "pulled bar, reduced": 2e-3,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in PROBLEMS if not PROBLEMS[n].scene().contacts])
def test_references(name: str) -> None:
    """Radau comes to the reference of every problem without contact."""
    found = one(name, "Radau(3), GGL", 1e-6)
    assert found.error < MESHES.get(name, 2e-5), found


@pytest.mark.parametrize(
    ("name", "scheme", "most"), [("bouncing ball", "Moreau", 1e-9), ("sliding block", "Moreau", 1e-4)]
)
def test_references_of_impacts(name: str, scheme: str, most: float) -> None:
    assert one(name, scheme, PROBLEMS[name].steps).error < most


def test_thirty_problems_of_known_origin() -> None:
    """Each with a provenance."""
    assert len(PROBLEMS) >= 30 and all(p.provenance for p in PROBLEMS.values())


def test_neighbours_solve_the_same_equations() -> None:
    """SciPy comes to the reference; bodies in space and elastic ones are not for it."""
    found = peer("double pendulum", "SciPy DOP853, index 1", 1e-6)
    assert found is not None and found.error < 1e-5
    assert peer("free body", "SciPy DOP853, index 1", 1e-6) is None


def test_failures_are_rows() -> None:
    """A run that fails is listed with its reason."""
    points = [
        Point("gears", "RATTLE", 100, 1e-3, 0.1, 100),
        Point("gears", "BDF, GGL", 1e-3, np.nan, 0.1, 0, "no step"),
    ]
    text = page(points, "with one value for each scheme", (1.0, 30.0, 0.2))
    assert "- gears, BDF, GGL, 0.001: no step" in text and "failed" in text
    assert "RATTLE: 0.1 s" in text and "not reached" in text
