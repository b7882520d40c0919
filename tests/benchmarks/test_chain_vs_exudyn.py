"""The goals against Exudyn, where an interpreter with exudyn is named by EXUDYN_PYTHON."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
PYTHON = os.environ.get("EXUDYN_PYTHON", "")


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.skipif(not PYTHON or shutil.which(PYTHON) is None, reason="EXUDYN_PYTHON names no interpreter with exudyn")
@pytest.mark.parametrize("case", ["crank", "10", "100", "1000"])
def test_ratio_of_cpu_times(case: str) -> None:
    from chain_vs_exudyn import compare

    (row,) = compare(PYTHON, 3, (case,))
    assert row["ratio"] <= row["goal"], row
    assert row["difference"] < 1e-4, row
