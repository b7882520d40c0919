"""What a scene says of parts that are not there, or that are none."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import CallbackError, InputError


def pendulum() -> fmbd.Scene:
    arm = fmbd.RigidBody("arm", 1.0, 0.1, position=(0.5, 0.0))
    scene = fmbd.Scene("pendulum", gravity=(0, -9.81))
    scene.add(arm, fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0)))
    scene.sensor("place", fmbd.position(arm))
    return scene


@pytest.mark.parametrize(
    "through", [lambda scene: scene, copy.deepcopy, lambda scene: pickle.loads(pickle.dumps(scene))]
)
@pytest.mark.parametrize(
    ("place", "known"), [("bodies", "arm"), ("joints", "pin"), ("sensors", "place"), ("forces", None)]
)
def test_parts_that_are_not_there_are_told_with_those_that_are(place: str, known: str | None, through: Any) -> None:
    """``del scene.joints["pn"]`` was a KeyError without any name that is there."""
    parts = getattr(through(pendulum()), place)
    listed = f'Known: "{known}"' if known else "Known: none"
    with pytest.raises(InputError, match=f'no "pn" there.*{listed}'):
        del parts["pn"]
    with pytest.raises(InputError, match=f'no "pn" there.*{listed}'):
        parts["pn"]
    assert parts.get("pn") is None
    if known:
        del parts[known]
        assert known not in parts


def test_what_is_put_among_parts_by_hand_is_looked_at() -> None:
    scene = pendulum()
    scene.joints["q"] = 5  # type: ignore[assignment]
    with pytest.raises(InputError, match='joints: "q" is no joint, found 5'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


@pytest.mark.parametrize("times", [(0.1, np.nan), ("soon",), 0.5])
def test_break_points_are_times_of_runs(times: Any) -> None:
    """Those that were set on a scene that is there passed in silence."""
    with pytest.raises(InputError, match="break ?point"):
        fmbd.Scene("s", breakpoints=times)
    scene = pendulum()
    with pytest.raises(InputError, match="break ?point"):
        scene.breakpoints = times


def test_a_distance_that_is_no_number_is_told() -> None:
    ball = fmbd.RigidBody("ball", 1.0, 0.1, position=(0.0, 1.0))
    scene = fmbd.Scene("s", gravity=(0, -9.81))
    scene.add(ball, fmbd.contact("pair", fmbd.ball(ball, 0.1), fmbd.SignedDistance(lambda x: "near")))
    with pytest.raises(CallbackError, match="returned 'near', expected"):
        fmbd.solve(scene, t_end=0.1, dt=0.01)
