"""Every scheme takes every body, joint, force, tie and contact, or says before anything is computed why not."""

from __future__ import annotations

import itertools

import pytest
from combinations import BODIES, FEATURES, SCHEMES, TABLE, cell, on_page

ALL = list(itertools.product(SCHEMES, BODIES, FEATURES))
PAGE = on_page(TABLE.read_text())
NAMED = ("rod", "tie", "floor", "contact", "FieldSplit", "smaller dt")  # what a refusal has to name


def refusals() -> list[tuple[str, str, str]]:
    """The first cell of each scheme with each reason, as the page has it."""
    first: dict[tuple[str, str], tuple[str, str, str]] = {}
    for name, (verdict, reason) in PAGE.items():
        if verdict == "refused":
            first.setdefault((name[0], reason), name)
    return list(first.values())


def sample() -> list[tuple[str, str, str]]:
    """Three cells of each scheme that run: bodies and features in turn."""
    chosen = []
    for k, scheme in enumerate(SCHEMES):
        runs = [name for name, (verdict, _) in PAGE.items() if verdict == "ok" and name[0] == scheme]
        chosen += runs[k % 7 :: max(len(runs) // 3, 1)][:3]
    return chosen


def holds(scheme: str, body: str, feature: str) -> tuple[str, str]:
    """What is found: a right run, or a reason that names what is refused."""
    verdict, text = cell(scheme, body, feature)
    assert verdict in ("ok", "refused"), text
    if verdict == "refused":
        assert any(word in text for word in NAMED), text
    return verdict, text


def test_page_has_the_cells_of_the_program() -> None:
    """No cell that is gone, none that is wrong."""
    assert set(PAGE) <= set(ALL)
    assert [name for name, (verdict, _) in PAGE.items() if verdict == "wrong"] == []
    assert len(refusals()) > len(SCHEMES)


@pytest.mark.parametrize(("scheme", "body", "feature"), sample())
def test_some_combinations(scheme: str, body: str, feature: str) -> None:
    assert holds(scheme, body, feature)[0] == "ok"


@pytest.mark.parametrize(("scheme", "body", "feature"), refusals())
def test_every_refusal(scheme: str, body: str, feature: str) -> None:
    """Refused before anything is computed, by a reason that names what is refused."""
    assert holds(scheme, body, feature)[0] == "refused"


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "body", "feature"), ALL)
def test_all_combinations(scheme: str, body: str, feature: str) -> None:
    holds(scheme, body, feature)
