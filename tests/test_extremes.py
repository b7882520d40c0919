"""Ten scenes at the edge end right, with a warning, or with one error; see docs/extremes.md, which extremes.py writes."""

from __future__ import annotations

import pytest
from extremes import EDGES, REFUSED, RIGHT, WRONG

pytestmark = pytest.mark.serial
QUICK = ("impacts", "sudden")
AT_LEAST = {"light": 8, "stiff": 4, "slivers": 5, "nu": 8, "spin": 7, "singular": 4, "redundant": 5, "impacts": 3,
            "snap": 1, "sudden": 6}  # fmt: skip


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in EDGES]
)
def test_nothing_is_silently_wrong(name: str) -> None:
    """And what is right today stays so: a refusal is no way out."""
    rows = list(EDGES[name].rows())
    assert not [row for row in rows if row.verdict == WRONG]
    assert sum(row.error <= row.allowed for row in rows) >= AT_LEAST[name]
    assert all(row.words for row in rows if row.verdict == REFUSED)
    assert any(row.verdict == RIGHT for row in rows)
