"""Errors that runs state where their steps resolve no vibration and the scheme takes it out, which other runs do not tell."""

from __future__ import annotations

from typing import Any

import checkpoint_scenes
import numpy as np
import pytest
from dae_problems import pendulum as point_pendulum
from test_honesty import driven_crank

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import linear_elastic

OUTPUT = fmbd.Output(estimate_error=True, energy=False, progress=False)
DAMPING = [fmbd.Radau(2, rtol=None), fmbd.Radau(3, rtol=None), fmbd.BDF(2, rtol=None), fmbd.GeneralizedAlpha(0.0)]
SOFT, FREE, LONGER = 20.0, 0.7, 0.01  # N/m, m: of the soft spring; m by which the stiff one is too short at the start


def pair(stiffness: float) -> fmbd.Scene:
    """1 kg on a soft spring, 0.1 kg on it by a stiff one that is let go with a strain."""
    scene = fmbd.Scene("pair")
    a, b = fmbd.RigidBody("a", 1.0, 0.1, (1.0, 0.0)), fmbd.RigidBody("b", 0.1, 0.1, (2.0, 0.0))
    scene.add(a, b, *(fmbd.prismatic(f"{m.name} slides", fmbd.ground, m, axis=(1, 0), center=(0, 0)) for m in (a, b)))
    scene.add(fmbd.Spring("soft", fmbd.ground, a, stiffness=SOFT, length=FREE))
    scene.add(fmbd.Spring("stiff", a, b, stiffness=stiffness, length=1.0 + LONGER))
    for name, read in (("x", fmbd.position), ("v", fmbd.velocity), ("a", fmbd.acceleration)):
        scene.sensor(name, read(b))
    return scene


def exact(stiffness: float, times: np.ndarray) -> dict[str, np.ndarray]:
    """Place, speed and acceleration of the light mass, by the two modes of the pair."""
    roots = np.sqrt([1.0, 0.1])
    matrix = np.array([[SOFT + stiffness, -stiffness], [-stiffness, stiffness]])
    squares, modes = np.linalg.eigh(matrix / np.outer(roots, roots))
    rest = np.array([FREE, FREE + 1.0 + LONGER])
    begin, shape, w = modes.T @ (roots * (np.array([1.0, 2.0]) - rest)), modes[1] / roots[1], np.sqrt(squares)
    angle = np.outer(times, w)
    return {
        "x": rest[1] + np.cos(angle) @ (shape * begin),
        "v": -np.sin(angle) @ (shape * begin * w),
        "a": -np.cos(angle) @ (shape * begin * squares),
    }


@pytest.mark.parametrize("stiffness, dt", [(1e4, 0.05), (3e4, 0.05), (1e6, 0.02)])
@pytest.mark.parametrize("scheme", DAMPING, ids=lambda s: s.name)
def test_a_vibration_that_is_taken_out_is_told(scheme: Any, stiffness: float, dt: float) -> None:
    """A place was stated at 0.07 of its error in silence: all runs that were compared missed the vibration."""
    run = fmbd.solve(pair(stiffness), t_end=1.0, dt=dt, scheme=scheme, output=OUTPUT)
    truth = exact(stiffness, run.times)
    for name in "xva":
        stated, true = run.certificate[name].total, np.abs(run[name][:, 0] - truth[name]).max()
        assert stated > 0.5 * true or name in run.certificate.uncertain
    # the sum of amplitudes of the place, and that of the force that is let go
    for name in "xa":
        true = np.abs(run[name][:, 0] - truth[name]).max()
        assert 0.5 < run.certificate[name].total / true < 3.0, (name, run.certificate[name].total / true)


@pytest.mark.parametrize(
    "scheme, E, missed",
    [(DAMPING[0], 2e8, "x"), (DAMPING[0], 2e9, "v"), (DAMPING[1], 2e7, "r")],
    ids=["x", "v", "r"],
)
def test_small_vibrations_are_told_beside_smooth_errors(scheme: Any, E: float, missed: str) -> None:
    """A floating rod on a pin, released: 0.41 of the error of its place, 0.02 and 0.3 of that of a speed and 0.14 of that of a
    reaction were stated in silence, as steps as large of the rule that keeps vibrations had larger errors of their own.
    """
    rod = fmbd.FloatingBody("rod", checkpoint_scenes.rod(), density=1000.0, elastic=linear_elastic(E, 0.3))
    scene = fmbd.Scene("released", gravity=(0.0, -9.81))
    pin, tip = fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)), rod.surface("tip")
    scene.add(rod, pin)
    for name, sensor in (("x", fmbd.position(tip)), ("v", fmbd.velocity(tip)), ("r", fmbd.reaction(pin))):
        scene.sensor(name, sensor)
    run = fmbd.solve(scene, t_end=0.6, dt=0.02, scheme=scheme, output=OUTPUT)
    every = 100
    wanted = fmbd.Output(every=every, energy=False, progress=False)
    fine = fmbd.solve(scene, t_end=0.6, dt=run.dt / every, scheme=fmbd.GeneralizedAlpha(0.95), output=wanted)
    for name in "xvr":
        stated, true = run.certificate[name].total, np.abs(run[name] - fine[name]).max()
        assert 0.5 < stated / true < 3.0, (name, stated / true)
    assert set(missed) <= set(run.certificate.uncertain)


@pytest.mark.parametrize("scheme", DAMPING[:3], ids=lambda s: s.name)
@pytest.mark.parametrize("scene", [point_pendulum, driven_crank])
def test_smooth_motion_is_left_alone(scene: Any, scheme: Any) -> None:
    run = fmbd.solve(scene(), t_end=0.8, dt=0.02, scheme=scheme, output=OUTPUT)
    assert not run.damped and not run.certificate.uncertain


@pytest.mark.mpi
def test_the_certificate_says_why() -> None:
    run = fmbd.solve(pair(1e6), t_end=1.0, dt=0.02, scheme=fmbd.Radau(3, rtol=None), output=OUTPUT)
    assert (
        "takes vibrations of some" in run.certificate.uncertain["x"] and "settle=True" in run.certificate.uncertain["x"]
    )
    assert run.damped["x"] == pytest.approx(run.certificate["x"].time)
