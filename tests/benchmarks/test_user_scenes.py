"""The goals of scenes of users against Exudyn, where this interpreter has it."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
NAMES = ["links 10", "links 100", "hinge springs 10", "hinge springs 100", "body on springs", "Python force"]


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.skipif(importlib.util.find_spec("exudyn") is None, reason="no exudyn in this interpreter")
@pytest.mark.parametrize("scene", NAMES)
def test_ratio_of_cpu_times(scene: str) -> None:
    from user_scenes import SCENES, compare

    assert list(SCENES) == NAMES
    row = compare(scene, 3)
    assert row["ratio"] <= row["goal"], row
    assert row["difference, m"] < 1e-4, row
