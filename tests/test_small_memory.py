"""Modes and linear models with what elements remember: integrals of controllers, dashpots of viscoelastic rods."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_controllers import GAINS, GOAL, arm
from test_controllers import G as GRAVITY

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.rotations import Array

BLOCK = Path(__file__).resolve().parents[1] / "meshes/block.py"


def companion() -> Array:
    """The arm of the controller tests about its targets: x = (angles, rates, integrals)."""
    c, J = np.cos(GOAL[1]), 1 / 12
    M = np.array([[2 * J + 1.5 + c, J + 0.25 + 0.5 * c], [J + 0.25 + 0.5 * c, J + 0.25]])
    outer = -0.5 * GRAVITY * np.sin(sum(GOAL))
    weight = np.array([[outer - 1.5 * GRAVITY * np.sin(GOAL[0]), outer], [outer, outer]])
    P, I, D = (np.diag(x) for x in np.array(GAINS).T)
    none, one, inverse = np.zeros((2, 2)), np.eye(2), np.linalg.inv(M)
    return np.block([[none, one, none], [-inverse @ (weight + P), -inverse @ D, inverse @ I], [-one, none, none]])


def once(values: Array) -> Array:
    """One of each conjugate pair, the slowest first."""
    upper = values[values.imag >= 0]
    return np.asarray(upper[np.argsort(np.abs(upper))])


def test_integrals_of_controllers() -> None:
    """About the equilibrium and about the end of a run; before the targets are reached there is no steady state."""
    exact = once(np.linalg.eigvals(companion()))
    found = fmbd.equilibrium(arm())
    assert np.abs(fmbd.modes(found.scene, 4, at=found).eigenvalues - exact).max() < 1e-9
    run = fmbd.solve(arm(), t_end=30.0, dt=1e-2)
    assert np.abs(fmbd.modes(arm(), 4, at=run).eigenvalues - exact).max() < 1e-8
    with pytest.raises(InputError, match='memory of "shoulder motor" changes with 0.7'):
        fmbd.modes(arm(), 2)


def test_closed_loop_of_a_controller() -> None:
    """From a torque on a lever to its angle and to the motor's effort: J s^2 + Kd s + Kp + Ki / s."""
    J, (kp, ki, kd) = 0.25, (50.0, 30.0, 1.0)
    body = fmbd.RigidBody("body", 1.0, J)
    hinge = fmbd.revolute("hinge", fmbd.ground, body, center=(0.0, 0.0))
    motor = fmbd.pid("motor", fmbd.angle(hinge), target=0.3, gains=(kp, ki, kd))
    scene = fmbd.Scene("lever")
    scene.add(body, hinge, motor, fmbd.torque("load", body, 5.0))
    scene.sensor("angle", fmbd.angle(hinge)), scene.sensor("effort", fmbd.element_effort(motor))

    model = fmbd.linearise(scene, ["load"], ["angle", "effort"], at=fmbd.equilibrium(scene))
    assert len(model.A) == 3
    omega = np.array([0.1, 1.0, 14.0, 80.0])
    s = 1j * omega
    law = kp + ki / s + kd * s
    angle = 1.0 / (J * s**2 + law)
    found = model.frequency_response(omega)[:, :, 0]
    assert np.abs(found[:, 0] / angle - 1.0).max() < 1e-7
    assert np.abs(np.abs(found[:, 1]) / np.abs(law * angle) - 1.0).max() < 1e-7


def rod(**more: Any) -> fmbd.Scene:
    """A cantilever, bent by its weight."""
    section = fmbd.RodSection((4e4, 1.5e4, 1.5e4, 30.0, 20.0, 35.0), 1.2, (1e-3, 5e-4, 5e-4), **more)
    body = fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], section, elements=2, degree=2)
    scene = fmbd.Scene("cantilever", gravity=(0.0, 0.0, -9.81))
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("start")))
    return scene


@pytest.mark.parametrize("share", [0.05, 0.8])
def test_a_viscoelastic_rod(share: float) -> None:
    """Without load every vibration has s^2 + w^2 (1 + share s tau / (1 + s tau)) = 0, w of the relaxed rod."""
    tau = 0.02
    elastic, relaxing = rod(), rod(relaxation=[(share, tau)])
    for scene in (elastic, relaxing):
        scene.gravity = (0.0, 0.0, 0.0)
    w = fmbd.modes(elastic, 4).omega
    found = fmbd.modes(relaxing, 4).eigenvalues
    for frequency, value in zip(w, found, strict=True):
        exact = np.roots([tau, 1.0, frequency**2 * tau * (1.0 + share), frequency**2])
        assert np.abs(exact - value).min() < 1e-7 * abs(value)
        assert value.real < 0.0 < value.imag


def test_about_the_loaded_place_a_rod_is_relaxed() -> None:
    """About its equilibrium; slow dashpots leave the fast modes of the stiff rod, quick ones those of the relaxed one."""
    slow, quick, elastic = (rod(relaxation=x) for x in ([(0.5, 1e4)], [(0.5, 1e-6)], ()))
    stiff, soft, relaxed = (fmbd.modes(x, 1, at=fmbd.equilibrium(x)).omega[0] for x in (slow, quick, elastic))
    assert soft == pytest.approx(relaxed, rel=1e-4)
    assert 1.1 < stiff / soft < np.sqrt(1.5)
