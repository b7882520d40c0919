"""The tree of links and joints of a robot's description, without the library that reads the file."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.system.scene.urdf import _placed


def joint(name: str, parent: str, child: str, **given: Any) -> Any:
    """A joint as the reader of files gives it: what the file does not say is None."""
    origin = np.eye(4)
    origin[0, 3] = 0.5
    unsaid = dict.fromkeys(("axis", "limit", "dynamics", "mimic"))
    return SimpleNamespace(
        **(unsaid | {"name": name, "parent": parent, "child": child, "type": "revolute", "origin": origin} | given)
    )


def test_what_a_joint_does_not_say_is_nothing() -> None:
    """No damping, friction, limit or mimic; the axis is x. Frames follow the tree in whatever order it is given."""
    second = joint("second", "upper", "lower")
    first = joint("first", "base", "upper", axis=[0.0, 0.0, 1.0])
    frames, joints = _placed(SimpleNamespace(joints=[second, first]), "base", {"first": 0.5 * np.pi})
    assert frames["lower"][:3, 3] == pytest.approx([0.5, 0.5, 0.0], abs=1e-15)
    assert joints["second"].axis == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)
    for made in joints.values():
        assert (made.damping, made.friction, made.limits, made.mimic) == (0.0, 0.0, (-np.inf, np.inf), None)


def test_what_a_joint_says_is_taken() -> None:
    said = joint(
        "said", "base", "link", type="prismatic", axis=[0.0, 1.0, 0.0],
        dynamics=SimpleNamespace(damping=0.3, friction=0.2), limit=SimpleNamespace(lower=-0.1, upper=0.4),
        mimic=SimpleNamespace(joint="other", multiplier=2.5, offset=None),
    )  # fmt: skip
    frames, joints = _placed(SimpleNamespace(joints=[said]), "base", {"said": 0.25})
    assert frames["link"][:3, 3] == pytest.approx([0.5, 0.25, 0.0])
    made = joints["said"]
    assert (made.damping, made.friction, made.limits, made.mimic) == (0.3, 0.2, (-0.1, 0.4), ("other", 2.5))


def test_a_joint_on_no_link_of_the_tree_is_named() -> None:
    with pytest.raises(InputError, match="lost"):
        _placed(SimpleNamespace(joints=[joint("lost", "nowhere", "link")]), "base", {})
