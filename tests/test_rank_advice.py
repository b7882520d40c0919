"""What is said of the number of ranks."""

from __future__ import annotations

import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.run.judges import rank_advice
from fmbd_fenicsx.run.judges.rank_advice import WORTH, faster_ranks


def test_ranks_that_are_worth_while() -> None:
    assert [faster_ranks(n, 4) for n in (0, WORTH - 1, 2 * WORTH, 100 * WORTH)] == [1, 1, 2, 4]


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
    assert "no elastic body with the unknowns of its mesh" in said[0] and "reduced bodies are not" in said[0]
