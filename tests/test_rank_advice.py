"""What is said of the number of ranks."""

from __future__ import annotations

import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.run.judges import rank_advice
from fmbd_fenicsx.run.judges.rank_advice import WORTH, faster_ranks


def test_ranks_that_are_worth_while() -> None:
    assert [faster_ranks([n], 4) for n in (0, WORTH - 1, 2 * WORTH, 100 * WORTH)] == [1, 1, 2, 4]
    assert faster_ranks([], 4) == 1


def test_bodies_count_by_their_size() -> None:
    """Each body has interfaces of its own: many small ones are worth no more ranks than one of them."""
    assert faster_ranks([WORTH] * 20, 4) == 1
    assert faster_ranks([2 * WORTH] * 20, 4) == 2
    # a large one beside small ones is worth fewer ranks than alone, and they no more than it
    assert faster_ranks([4 * WORTH], 4) == 4
    assert 1 < faster_ranks([4 * WORTH, WORTH // 20], 4) < 4


@pytest.mark.parametrize(
    ("bodies", "ratio"),
    [
        # seconds of a step on one rank over those on two, docs/performance_log.md; nearer to 1 than a tenth is not told apart
        ([5_787], 0.75), ([14_214], 1.12), ([22_365], 1.29), ([36_624], 1.38), ([10_066], 0.50), ([71_666], 1.64),
        ([5_820], 0.42), ([12_588], 0.85), ([6_746], 0.46), ([13_833], 1.38),
        ([5_787] * 4, 0.67), ([14_214] * 3, 1.43), ([22_365] * 3, 1.54),
    ],
)  # fmt: skip
def test_what_was_measured(bodies: list[int], ratio: float) -> None:
    assert faster_ranks(bodies, 2) == (2 if ratio > 1 else 1)


def test_rigid_bodies_on_many_ranks(monkeypatch: pytest.MonkeyPatch) -> None:
    bob = fmbd.RigidBody("bob", 1.0, 0.1, position=(1, 0))
    scene = fmbd.Scene("swing", gravity=(0, -9.81))
    scene.add(bob, fmbd.revolute("pin", fmbd.ground, bob, center=(0, 0)))
    said: list[str] = []
    monkeypatch.setattr(rank_advice, "note", said.append)
    system = scene.build()[0]

    monkeypatch.setattr(rank_advice, "world_size", lambda: 1)
    rank_advice.advise_on_ranks(system)
    assert not said
    monkeypatch.setattr(rank_advice, "world_size", lambda: 3)
    rank_advice.advise_on_ranks(system)
    assert len(said) == 1 and "on 3 ranks: 1 would be faster" in said[0]
    assert "no elastic body with the unknowns of its mesh" in said[0] and "reduced bodies, wires are not" in said[0]


def test_wires_are_whole_on_each_rank(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are worth no rank, however fine: they were counted as if shared out."""
    scene = fmbd.Scene("wire")
    scene.add(fmbd.Wires("w", 60.0, 4 * WORTH, (fmbd.Wire(1.35, 20e3, 195.0),)))
    said: list[str] = []
    monkeypatch.setattr(rank_advice, "note", said.append)
    monkeypatch.setattr(rank_advice, "world_size", lambda: 2)
    rank_advice.advise_on_ranks(scene.build()[0])
    assert len(said) == 1 and "no elastic body" in said[0] and "1 would be faster" in said[0]
