"""The goals of scenes of users against Exudyn, where this interpreter has it."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
NAMES = [
    *(f"{kind} {n}" for kind in ("links", "hinge springs") for n in (10, 100, 1000)),
    *(f"{kind} {n}" for kind in ("space links", "space hinge springs") for n in (10, 40, 200)),
    "body on springs", "body on bushings", "Python force", "PD arm, Python laws", "driven slider crank", "wheel suspension",
    "truck over a road, Python tyres", "flyball governor", "Bricard", "16 modes, spring and damper", "elastic four-bar",
    "sphere bouncing on a plane",
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.skipif(importlib.util.find_spec("exudyn") is None, reason="no exudyn in this interpreter")
@pytest.mark.parametrize("scene", NAMES)
def test_ratio_of_cpu_times(scene: str) -> None:
    from user_scenes import SCENES, compare

    assert list(SCENES) == NAMES
    row = compare(scene, 3)
    assert row["ratio"] <= row["goal"], row
    assert row["difference, m"] < row["agree to, m"], row
