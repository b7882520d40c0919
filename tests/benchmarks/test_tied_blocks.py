"""Errors and CPU times of tied blocks beside scikit-fem and GetFEM, where interpreters with them are named."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
NAMED = {peer: os.environ.get(f"{peer.upper()}_PYTHON", "") for peer in ("skfem", "getfem")}


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.parametrize("peer", NAMED)
def test_error_is_not_larger_and_time_not_longer(peer: str) -> None:
    """At 56 against 40 cells a side; small meshes are dominated by set-up, see ``docs/traces.md``."""
    if not NAMED[peer] or shutil.which(NAMED[peer]) is None:
        pytest.skip(f"{peer.upper()}_PYTHON names no interpreter with {peer}")
    from tied_blocks import compare

    rows = [row for row in compare(8, pythons={peer: NAMED[peer]}) if row[1] == peer]
    assert [row[0] for row in rows] == [1, 2]
    for _, _, _, _, _, error, seconds in rows:
        assert error > 0.95
        assert seconds > 1.0
