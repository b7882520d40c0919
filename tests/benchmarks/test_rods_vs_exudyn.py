"""Rods take at most half of Exudyn's time at equal error, where this interpreter has it."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.skipif(importlib.util.find_spec("exudyn") is None, reason="no exudyn in this interpreter")
@pytest.mark.parametrize("scene", ["right-angle frame", "hanging cable"])
def test_ratio_of_cpu_times(scene: str) -> None:
    from rods_vs_exudyn import SCENES, compare

    assert scene in SCENES
    assert compare(scene, 3)["ratio"] <= 0.5
