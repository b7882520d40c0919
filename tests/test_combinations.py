"""Every scheme takes every body, joint, force, tie and contact, or says before anything is computed why not."""

from __future__ import annotations

import pytest
from combinations import BODIES, FEATURES, SCHEMES, cell

ALL = [(scheme, body, feature) for scheme in SCHEMES for body in BODIES for feature in FEATURES]
SOME = ALL[::13]  # each scheme with each kind of body or feature once at least


def holds(scheme: str, body: str, feature: str) -> None:
    """The run is right, or is refused with a reason that names what is refused."""
    verdict, text = cell(scheme, body, feature)
    assert verdict in ("ok", "refused"), text
    if verdict == "refused":
        assert any(word in text for word in ("rod", "tie", "floor", "contact", "smaller dt")), text


@pytest.mark.parametrize(("scheme", "body", "feature"), SOME)
def test_some_combinations(scheme: str, body: str, feature: str) -> None:
    holds(scheme, body, feature)


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "body", "feature"), [c for c in ALL if c not in SOME])
def test_all_combinations(scheme: str, body: str, feature: str) -> None:
    holds(scheme, body, feature)
