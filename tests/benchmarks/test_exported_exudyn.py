"""A reduced body exported to Exudyn moves there as it does here, where exudyn is installed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
pytestmark = [pytest.mark.slow, pytest.mark.serial]


@pytest.mark.parametrize("damping", [{}, {"mass_damping": 0.7, "stiffness_damping": 2e-3}], ids=["free", "damped"])
def test_same_motion(damping: dict[str, float]) -> None:
    """1e-9 m over half a second; without extrapolation the difference falls as the square of Exudyn's step."""
    pytest.importorskip("exudyn")
    import exported_exudyn as bench

    rows, rest, own = bench.compare((5e-4, 2.5e-4, 1.25e-4, 6.25e-5), **damping)
    assert own < 1e-10
    assert rest < 1e-9
    for (_, coarse), (_, fine) in zip(rows, rows[1:], strict=False):
        assert 3.5 < coarse / fine < 4.5, rows
