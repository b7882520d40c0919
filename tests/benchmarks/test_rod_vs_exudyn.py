"""Elastic bodies against Exudyn, where an interpreter with exudyn is named by EXUDYN_PYTHON."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
PYTHON = os.environ.get("EXUDYN_PYTHON", "")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.serial,
    pytest.mark.skipif(not PYTHON or shutil.which(PYTHON) is None, reason="EXUDYN_PYTHON names no python with exudyn"),
]


def test_reduced_body(tmp_path: Path) -> None:
    """A third of the time per step at most, the same motion, and a smaller error in the same time for every step."""
    import rod_vs_exudyn as bench

    body = bench.bar("3075")
    reduced, file = body.reduced(modes=16), tmp_path / "bar.npz"
    bench.export(body, reduced, file)
    row = bench.compare_reduced(PYTHON, file, reduced, 3)
    assert row["ratio"] <= 1 / 3, row
    assert row["difference"] < 5e-6, row
    rows = bench.work_precision(PYTHON, file, reduced)
    for h, _, _, ms, error in rows:
        assert not ms > 0 or bench.error_at(rows, ms) < error, (h, rows)


@pytest.mark.parametrize("size", ["3075", "7203"])
def test_floating_body(size: str) -> None:
    import rod_vs_exudyn as bench

    row = bench.compare_full(PYTHON, size)
    assert row["ratio"] <= row["goal"], row
    assert row["difference"] < 1e-6, row
