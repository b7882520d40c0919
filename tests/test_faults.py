"""Nothing is lost by what may happen to a run: see faults.py, which does it."""

from __future__ import annotations

import shutil

import pytest
from faults import FINE, all_of

pytestmark = pytest.mark.serial


def nothing_lost(count: int, ranks: int = 0) -> None:
    """Every fault ends with its exit code, and the run goes on to the record of one that nothing disturbed."""
    for name, counted in all_of(count, ranks).items():
        assert set(counted) <= set(FINE), (name, counted)
        assert sum(counted.values()) > 0


def test_few_faults() -> None:
    nothing_lost(3)


@pytest.mark.slow
@pytest.mark.timeout(0)
@pytest.mark.skipif(shutil.which("mpirun") is None, reason="no mpirun")
def test_a_hundred_faults_of_each_kind() -> None:
    nothing_lost(100, ranks=3)
