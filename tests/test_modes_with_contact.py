"""Modes and linear models about equilibria with contact: closed points hold, open ones are free."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.materials import plane_stress

BLOCK = Path(__file__).resolve().parents[1] / "meshes/block.py"
G = 9.81


def cup(radius: float = 0.1, hollow: float = 0.5) -> fmbd.Scene:
    """A disc without friction in a round hollow: it swings as a pendulum of the length hollow - radius."""
    scene = fmbd.Scene("cup", gravity=(0.0, 0.0, -G))
    ball = fmbd.RigidBody("ball", 2.0, (0.1, 0.1, 0.1), position=(0.01, 0.0, -hollow + radius))
    bowl = fmbd.Obstacle("bowl", fmbd.contacts.Sphere(hollow, (0.0, 0.0, 0.0), inside=True))
    scene.add(ball, fmbd.contact("rest", fmbd.contacts.ball(ball, radius), bowl))
    scene.sensor("place", fmbd.position(ball))
    scene.sensor("force", fmbd.contact_force("rest"))
    return scene


@pytest.mark.mpi
def test_a_ball_in_a_hollow_swings() -> None:
    """w^2 = g / (hollow - radius) in both directions; turning costs nothing; the force of the contact turns with the place."""
    scene = cup()
    found = fmbd.modes(scene, 5, at=fmbd.equilibrium(scene))
    assert found.omega[:3] == pytest.approx(0.0, abs=1e-4)
    assert found.omega[3:] == pytest.approx(np.sqrt(G / 0.4), rel=1e-6)
    with pytest.raises(InputError, match="has 5 modes"):
        fmbd.modes(scene, 6, at=fmbd.equilibrium(scene))

    shown = fmbd.vibration(found, 4, 1e-3, frames=8)
    assert "force" not in shown.series
    assert np.ptp(shown["place"][:, :2], axis=0).max() == pytest.approx(2e-3, rel=1e-3)


def test_a_block_on_a_floor_and_a_spring() -> None:
    """It slides with k / m; upright it does not move, nor does it turn. A force along the floor moves it by F / k."""
    scene = fmbd.Scene("block", gravity=(0.0, -G))
    block = fmbd.RigidBody("block", 2.0, 0.1, position=(0.0, 0.1))
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0, 0), normal=(0, 1, 0)))
    feet = [(-0.2, -0.1), (0.0, -0.1), (0.2, -0.1)]
    scene.add(block, fmbd.contact("floor", fmbd.contacts.corners(block, feet), floor))
    ends: Any = {"point_a": (-1.0, 0.1), "point_b": (0.0, 0.1)}
    scene.add(fmbd.Spring("spring", fmbd.ground, block, stiffness=50.0, length=1.0, **ends))
    scene.add(fmbd.force("push", block, lambda t: (0.0, 0.0)))
    scene.sensor("at", fmbd.position(block))
    scene.sensor("force", fmbd.contact_force("floor"))
    found = fmbd.equilibrium(scene)
    assert fmbd.modes(scene, 1, at=found).omega[0] == pytest.approx(5.0, rel=1e-6)
    with pytest.raises(InputError, match="has 1 modes"):
        fmbd.modes(scene, 2, at=found)

    H = fmbd.frequency_response(scene, ["push"], ["at"], [0.0], at=found)[0]
    assert H == pytest.approx(np.array([[0.02, 0.0], [0.0, 0.0]]), abs=1e-9)
    with pytest.raises(InputError, match='Unknown output "force"'):
        fmbd.linearise(scene, ["push"], ["force"], at=found)
    with pytest.raises(InputError, match="at=fmbd.equilibrium"):
        fmbd.modes(scene, 1)


def propped_beam(length: float, prop: float, bending: float, mass: float) -> float:
    """First angular frequency of a cantilever held up at ``prop``: 40 beam elements of Hermite's cubics."""
    n, h = 40, length / 40
    k = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h]])
    k = np.vstack((k, -k[0], [6 * h, 2 * h * h, -6 * h, 4 * h * h])) * bending / h**3
    m = np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h]])
    m = np.vstack((m, [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h])) * mass * h / 420
    K, M = np.zeros((2 * n + 2, 2 * n + 2)), np.zeros((2 * n + 2, 2 * n + 2))
    for e in range(n):
        K[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += k
        M[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += m
    free = np.setdiff1d(np.arange(2 * n + 2), [0, 1, 2 * round(prop / h)])
    return float(np.sqrt(np.linalg.eigvals(np.linalg.solve(M[np.ix_(free, free)], K[np.ix_(free, free)])).real.min()))


@pytest.mark.mpi
@pytest.mark.parametrize("kind", [fmbd.FloatingBody, fmbd.AbsoluteBody])
def test_a_cantilever_on_a_stop(kind: Any) -> None:
    """Pressed on the stop it vibrates as a propped beam, lifted from it as a free one."""
    mesh = fmbd.read_gmsh(BLOCK, size=(1.0, 0.04), counts=(20, 1), quads=True)
    body = kind("beam", mesh, degree=2, density=1000.0, elastic=plane_stress(1e9, 0.0))
    scene = fmbd.Scene("propped")
    stop = fmbd.Obstacle("stop", fmbd.contacts.Sphere(0.05, (0.5, -0.0501)))
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("left")))
    scene.add(fmbd.contact("stop", body.surface("bottom"), stop))
    scene.add(fmbd.force("pull", body.surface("right"), lambda t: (0.0, -20.0 * t)))
    scene.sensor("force", fmbd.contact_force("stop"))

    pressed = fmbd.equilibrium(scene, t=1.0)
    assert pressed["force"][1] > 10.0
    exact = propped_beam(1.0, 0.5, 1e9 * 0.04**3 / 12, 40.0)
    assert fmbd.modes(scene, 2, at=pressed).omega[0] == pytest.approx(exact, rel=0.01)
    lifted = fmbd.equilibrium(scene, t=-1.0)
    free = 3.5160 * np.sqrt(1e9 * 0.04**3 / 12 / 40.0)
    assert fmbd.modes(scene, 1, at=lifted).omega[0] == pytest.approx(free, rel=0.01)


def test_a_stop_of_a_joint() -> None:
    """A pendulum pressed on its stop has no motion left; a second link on it swings as if that stood still."""
    scene = fmbd.Scene("stopped", gravity=(0.0, -G))
    bob = fmbd.RigidBody("bob", 1.5, 0.1, position=(0.7, 0.0))
    scene.add(bob, hinge := fmbd.revolute("hinge", fmbd.ground, bob, center=(0.0, 0.0)))
    scene.add(fmbd.joint_limit("stop", fmbd.angle(hinge), lower=-0.4))
    hung = fmbd.RigidBody("hung", 1.0, 0.02, position=(0.7, -0.3))
    scene.add(hung, fmbd.revolute("second", bob, hung, center=(0.7, 0.0)))
    found = fmbd.equilibrium(scene)
    swing = np.sqrt(G * 0.3 / (0.02 + 0.09))
    assert fmbd.modes(scene, 1, at=found).omega[0] == pytest.approx(swing, rel=1e-6)
