"""Steps of the energy-momentum scheme in compiled code: the same residuals and steps as NumPy's, for every kind of part."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from test_compiled_evaluation import MAKERS, pair_of
from test_rods import UNIT, follower, stiffening

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.schemes.onestep.conserving.energy_momentum import EnergyMomentumStepper
from fmbd_fenicsx.system.compiled.choice import use_driver
from fmbd_fenicsx.system.compiled.states.means import MeanStates
from fmbd_fenicsx.system.layout import State
from fmbd_fenicsx.system.system import System


def bent(**more: Any) -> fmbd.Scene:
    """A bent rod on a pin."""
    scene = fmbd.Scene("bent", gravity=(0, 0, -9.81))
    rod = fmbd.Rod("rod", [(0, 0, 0), (1, 0.1, 0.2), (2, 0, 0.3)], **({"section": UNIT, "elements": 2} | more))
    scene.add(rod, fmbd.spherical("pin", fmbd.ground, rod.surface("start"), center=(0, 0, 0)))
    return scene


LOADS = fmbd.RodLoad(follower, follower=True), fmbd.RodLoad(lambda s, t: (0, t, s), turns=True)
OWN = fmbd.RodSection(energy=stiffening, mass=1.0, inertia=(0.2, 0.1, 0.1))
SCENES = MAKERS | {
    "rod, damped": partial(bent, degree=3, damping=1e-2),
    "rod, loaded": partial(bent, degree=1, loads=LOADS),
    "rod, own energy": partial(bent, degree=2, section=OWN, damping=1e-2),
}


def stepper_of(system: System, state: State) -> EnergyMomentumStepper:
    """A worker of the scheme."""
    return fmbd.EnergyMomentum().stepper(system, StepSolver(system), fmbd.Newton(), state)


@pytest.mark.compiled
@pytest.mark.parametrize("name", SCENES)
def test_residuals_are_those_of_numpy(name: str) -> None:
    """Of accelerations and multipliers that nothing balances, over a step that turns bodies by some hundredths of a radian."""
    plain, driven, (t, q, v, a, lam) = pair_of(SCENES[name])
    h = 0.05 * plain.length / plain.max_abs(v[0])
    found = []
    for system in (plain, driven):
        stepper = stepper_of(system, State(float(t[0]), q[0], v[0], a[0], lam[0]))
        if system is driven:
            stepper._means = MeanStates(driven.evaluator)  # type: ignore[arg-type]
        y = np.concatenate((a[0] * plain.max_abs(v[0]) / (h * plain.max_abs(a[0])), lam[0]))
        found.append(np.concatenate(stepper._residual(h, y)))
        assert (stepper._old is None) == (system is driven)
    assert found[1] == pytest.approx(found[0], rel=1e-9, abs=1e-10 * np.abs(found[0]).max())


def loaded() -> fmbd.Scene:
    """What a step may hold: a drive, a rolling ball, a spring that is a distance, one by a law in Python, a motor with limits."""
    scene = fmbd.Scene("loaded", gravity=(0, 0, -9.81))
    arm = fmbd.RigidBody("arm", 1.0, (0.05, 0.1, 0.12), position=(0.5, 0, 0))
    hand = fmbd.RigidBody("hand", 1.0, (0.05, 0.1, 0.12), position=(1.5, 0, 0))
    ball = fmbd.RigidBody(
        "ball", 2.0, (0.02, 0.04, 0.02), (3, 0, 0.2), velocity=(0.4, 0, 0), angular_velocity=(0, 2, 0)
    )
    shoulder = fmbd.revolute("shoulder", fmbd.ground, arm, center=(0, 0, 0), axis=(0, 0, 1))
    elbow = fmbd.revolute("elbow", arm, hand, center=(1, 0, 0), axis=(0.2, 1, 0))
    scene.add(arm, hand, ball, shoulder, elbow, fmbd.drive("turn", fmbd.angle(shoulder), lambda t: 0.5 * t * t))
    scene.add(fmbd.joint_spring("law", fmbd.angle(elbow), law=lambda s, rate, t: 30.0 * np.sin(s) + 0.2 * rate))
    scene.add(fmbd.rolling("road", fmbd.ground, ball, shape=fmbd.Ball(0.2), normal=(0, 0, 1)))
    scene.add(fmbd.Spring("pull", hand, ball, point_a=(2, 0, 0), point_b=(3, 0, 0.3), stiffness=200.0, damping=1.0))
    return scene


@pytest.mark.compiled
@pytest.mark.parametrize("h", [2e-3, 0.1])
def test_steps_are_those_of_numpy(h: float) -> None:
    """Small ones by the matrix of the middle, large ones by differences."""
    found: list[Any] = []
    for driven in (False, True):
        system, state, _ = loaded().build()
        if driven:
            use_driver(system)
        stepper = stepper_of(system, state)
        found.append([stepper.advance(h) for _ in range(6)][-1])
        assert (stepper._used is not None) == driven
    for name in ("q", "v", "a", "lam"):
        one, other = (getattr(s, name) for s in found)
        assert other == pytest.approx(one, rel=1e-7, abs=1e-8 * np.abs(one).max()), name


@pytest.mark.compiled
def test_laws_are_asked_once_for_a_step_and_once_for_all_points() -> None:
    """What depends on time only does not change in a step; laws take the points of a mean as arrays (3, n)."""
    times: list[float] = []
    shapes: list[tuple[int, ...]] = []

    def push(t: float) -> Any:
        times.append(t)
        return np.array([np.sin(t), 0.0])

    def law(s: Any, rate: Any, t: float) -> Any:
        shapes.append(np.shape(s))
        return 40.0 * s + 300.0 * s**3

    scene, place = fmbd.Scene("swing", gravity=(0.0, -9.81)), 0.0
    for i in range(4):
        body = fmbd.RigidBody(f"{i}", 1.0, 0.1, position=(place, 0.0))
        hinge = fmbd.revolute(f"hinge {i}", fmbd.ground, body, center=(place - 0.5, 0.0))
        scene.add(body, hinge, fmbd.joint_spring(f"spring {i}", fmbd.angle(hinge), law=law))
        place += 2.0
    scene.add(fmbd.force("push", body, push))
    system, state, _ = scene.build()
    use_driver(system)
    stepper = stepper_of(system, state)
    stepper.advance(0.01)
    times.clear()
    shapes.clear()
    stepper.newton.iterations = 0
    stepper.advance(0.01)
    assert stepper.newton.iterations > 1
    assert sum(abs(t - 0.015) < 1e-12 for t in times) == 1 and len(times) <= 4
    assert (3, 4) in shapes


@pytest.mark.compiled
def test_steps_that_turn_bodies_far_stay_in_compiled_code() -> None:
    """Increments tell what the matrix of the middle leaves out of a turn of half a radian: a free top under a torque."""
    asked: list[float] = []

    def twist(t: float) -> tuple[float, float, float]:
        asked.append(t)
        return 0.0, 0.3 * np.cos(t), 0.1

    scene = fmbd.Scene("top")
    top = fmbd.RigidBody("top", 1.0, (0.1, 0.2, 0.25), angular_velocity=(2.0, 5.0, 1.0))
    scene.add(top, fmbd.torque("twist", top, twist))
    system, state, _ = scene.build()
    use_driver(system)
    stepper = stepper_of(system, state)
    stepper.advance(0.1)
    asked.clear()
    stepper.newton.iterations = 0
    for _ in range(20):
        stepper.advance(0.1)
    assert stepper._used is not None and not stepper.account.otherwise
    assert stepper.newton.iterations < 9 * 20
    assert len(asked) < 5 * 20
