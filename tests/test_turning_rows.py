"""Rows of joints that turn far in a step of generalized-alpha: where its memory grows, and that GGL's does not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.run.judges.turning_rows import _certainly_below, turned
from fmbd_fenicsx.run.problem import make_solver

H = 4e-3


def rotor(angle: float) -> fmbd.Scene:
    """A wheel that turns by ``angle`` (rad) a step on an axle in a free frame, a little out of line."""
    scene = fmbd.Scene("rotor")
    frame = fmbd.RigidBody("frame", 1.0, (0.1, 0.2, 0.15), angular_velocity=(1e-2, 0, 0))
    spin = (1e-2, angle / H, 0)
    wheel = fmbd.RigidBody("wheel", 2.0, (0.06, 0.12, 0.06), position=(0.5, 0, 0), angular_velocity=spin)
    scene.add(frame, wheel, fmbd.revolute("axle", frame, wheel, center=(0.5, 0, 0), axis=(0, 1, 0)))
    scene.sensor("force", fmbd.reaction("axle"))
    return scene


def link(angle: float) -> fmbd.Scene:
    """A link in the plane that turns on its pin, pushed a little."""
    scene, rate = fmbd.Scene("link"), angle / H
    body = fmbd.RigidBody("link", 1.0, 0.001, (0.5, 0.0), velocity=(0.0, 0.5 * rate), angular_velocity=rate)
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body, center=(0.0, 0.0)))
    scene.add(fmbd.torque("push", body, lambda t: 1e-3 * np.exp(-(((t - 0.1) / 0.02) ** 2))))
    scene.sensor("force", fmbd.reaction("pin"))
    return scene


def alternation(run: Any) -> float:
    """How far the size of the reaction jumps to and fro, over its size at the start, by its fourth differences."""
    size = np.linalg.norm(run["force"], axis=1)
    return float(np.abs(np.diff(size, 4)).max() / 16.0 / size[1:10].mean())


@pytest.mark.parametrize(("make", "angle", "rho"), [(rotor, 0.6, 0.8), (link, 0.25, 0.8), (link, 0.1, 0.95)])
def test_the_warning_is_right(make: Any, angle: float, rho: float) -> None:
    """Reactions alternate where the run is warned of; with a quarter of the step, and with GGL, they do not."""
    said = "joints turn by"
    for h, scheme, warned in (
        (H, fmbd.GeneralizedAlpha(rho_inf=rho), True),
        (H, fmbd.GeneralizedAlpha(rho_inf=rho, form=fmbd.GGL()), False),
        (H / 4, fmbd.GeneralizedAlpha(rho_inf=rho), False),
    ):
        run = fmbd.solve(make(angle), t_end=2.4, dt=h, scheme=scheme)
        assert any(said in text for text in run.warnings) == warned
        assert (alternation(run) > 0.05) == warned


def test_angles() -> None:
    """A round wheel on an axle that stands still turns no rows; those of an arm with a point mass turn as it does."""
    scene = fmbd.Scene("axle")
    wheel = fmbd.RigidBody("wheel", 1.0, (0.01, 0.01, 0.02), angular_velocity=(0, 0, 100.0))
    scene.add(wheel, fmbd.revolute("axle", fmbd.ground, wheel, center=(0, 0, 0), axis=(0, 0, 1)))
    system, state, _ = scene.build()
    assert turned(make_solver(scene, system, None), [state], H)[0] < 1e-9

    pinned = link(0.1)
    system, state, _ = pinned.build()
    share = 0.5**2 / (0.5**2 + 0.001)  # of the rows' weight that is on the turning arm
    assert turned(make_solver(pinned, system, None), [state], H)[0] == pytest.approx(0.1 * share, rel=0.05)


def test_a_quick_look_does_not_judge_columns_that_nearly_depend_on_each_other() -> None:
    good, poor = np.eye(4)[:, :2], np.array([[1.0, 1.0], [0.0, 1e-7], [0.0, 0.0], [0.0, 0.0]])
    assert _certainly_below(0.1, good, good)
    assert not _certainly_below(0.1, good, poor) and not _certainly_below(0.1, poor, good)
