"""Derivatives that users give with equations of their own are compared with the functions that they belong to."""

from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd


def pendulum(*, turned: float = 0.0, unit: float = 1.0, **given: Any) -> fmbd.Scene:
    """A point on a circle about the origin, damped, with derivatives of the user's own; lengths in any ``unit``."""
    body = fmbd.CoordinateBody(
        "point",
        np.eye(2),
        lambda q, v, t: np.array([0 * q[0], -9.81 * unit + 0 * q[0]]) - 0.1 * v,
        start=(unit * np.cos(turned), unit * np.sin(turned)),
        constraint=lambda q, t: np.array([q[0] ** 2 + q[1] ** 2 - unit**2 + 0 * t]),
        **given,
    )
    scene = fmbd.Scene("own")
    scene.add(body)
    return scene


@pytest.mark.parametrize("unit", [1.0, 1e-6])
@pytest.mark.parametrize("turned", [0.0, 0.3, np.pi / 2])
def test_right_ones_pass(unit: float, turned: float) -> None:
    scene = pendulum(
        turned=turned,
        unit=unit,
        jacobian=lambda q, t: np.array([[2 * q[0], 2 * q[1]]]),
        gamma=lambda q, v, t: np.array([2 * v @ v]),
        rate=lambda q, t: np.zeros(1),
        force_jacobian=lambda q, v, t: (np.zeros((2, 2)), -0.1 * np.eye(2)),
    )
    assert not fmbd.solve(scene, t_end=1e-3, dt=1e-3).warnings


@pytest.mark.parametrize(
    ("what", "given", "told"),
    [
        ("jacobian", lambda q, t: np.array([[2 * q[0], 3 * q[1]]]), r"entry \(0, 1\) is 0.033, .* tells 0.022"),
        ("jacobian", lambda q, t: 2 * q, r"has shape \(2,\), expected \(1, 2\)"),
        ("gamma", lambda q, v, t: np.array([v @ v]), "is 2.21, .* tells 4.42"),
        ("rate", lambda q, t: np.array([0.1]), "is 0.1, .* tells 0"),
    ],
)
def test_wrong_ones_of_a_constraint_are_refused(what: str, given: Any, told: str) -> None:
    """The second part of the jacobian vanishes at the start, and shows aside."""
    with pytest.raises(fmbd.errors.InputError, match=f'Body "point": {what} .*{told}'):
        pendulum(**{what: given}).build()


def test_a_wrong_tangent_of_the_force_is_told() -> None:
    scene = pendulum(force_jacobian=lambda q, v, t: (np.zeros((2, 2)), 0.1 * np.eye(2)))
    assert "entry (0, 0) is 0.1" in " ".join(fmbd.solve(scene, t_end=1e-3, dt=1e-3).warnings)
