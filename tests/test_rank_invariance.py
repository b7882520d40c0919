"""The same figures on 1 and 2 ranks for every kind of tie and joint; ``docs/traces.md`` has the table for 1, 2, 3 and 6."""

from __future__ import annotations

import json

import pytest
from rank_scenes import SCENES, largest_difference
from test_ranks import ROOT, launch


@pytest.mark.serial
def test_two_ranks_give_the_figures_of_one() -> None:
    """Positions, multipliers and energies, over the whole run."""
    code = (ROOT / "tests/rank_scenes.py").read_text().replace("__file__", repr(str(ROOT / "tests/rank_scenes.py")))
    one, two = (json.loads(launch(code, n, timeout=300).stdout.splitlines()[-1]) for n in (1, 2))
    for name in SCENES:
        assert largest_difference(one[name], two[name]) < 1e-9, name
        assert max(one[name]["energy"]) > 0, name
