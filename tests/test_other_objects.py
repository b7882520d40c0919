"""What belongs to another scene, or to none, is told apart from what has its name here."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.system.scene.refinement import with_bodies


def pendulum() -> tuple[fmbd.Scene, fmbd.RigidBody, fmbd.Joint]:
    """A scene with one body on one hinge."""
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81))
    bob = fmbd.RigidBody("bob", mass=1.0, inertia=0.1, position=(1.0, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, bob, center=(0.0, 0.0))
    scene.add(bob, pin)
    return scene, bob, pin


READ = {
    "a joint": lambda bob, pin: fmbd.angle(pin),
    "a body": lambda bob, pin: fmbd.angular_velocity(bob),
    "a place": lambda bob, pin: fmbd.position(bob),
    "a force of a joint": lambda bob, pin: fmbd.reaction_force(pin),
    "multipliers": lambda bob, pin: fmbd.reaction(pin),
}


@pytest.mark.parametrize("read", READ.values(), ids=READ)
def test_a_sensor_reads_the_object_and_not_its_name(read: Callable[..., object]) -> None:
    scene, *own = pendulum()
    scene.sensor("seen", read(*own))
    assert fmbd.solve(scene, t_end=0.01, dt=0.005)["seen"].shape[0] == 3

    scene, *_ = pendulum()
    scene.sensor("seen", read(*pendulum()[1:]))
    with pytest.raises(InputError, match="is another object: pass that one"):
        fmbd.solve(scene, t_end=0.01, dt=0.005)


def test_a_joint_to_the_body_of_another_scene_says_so() -> None:
    scene, _, _ = pendulum()
    _, other, _ = pendulum()
    scene.add(fmbd.revolute("second", fmbd.ground, other, center=(1.0, 0.0)))
    with pytest.raises(InputError, match='The "bob" that is there is another object'):
        fmbd.solve(scene, t_end=0.01, dt=0.005)


def test_a_stepper_restores_what_save_gave_and_nothing_else() -> None:
    scene, *_ = pendulum()
    with fmbd.stepper(scene, dt=0.01) as s:
        with pytest.raises(InputError, match="must be a Saved"):
            s.restore(3)  # type: ignore[arg-type]
        kept = s.save()
        s.step()
        s.restore(kept)
        assert s.t == 0.0


def test_an_instant_shows_itself_in_a_line() -> None:
    scene, *_ = pendulum()
    with fmbd.stepper(scene, dt=0.01) as s:
        assert repr(s._moment) == '<Moment of scene "pendulum": t = 0 s, step 0>'


def test_one_word_for_bools_of_python_and_numpy() -> None:
    with pytest.raises(InputError, match=r"settle 3 must be a bool\.$"):
        fmbd.Scene("a", settle=3)  # type: ignore[arg-type]


def test_arguments_of_a_method_are_told_without_self() -> None:
    scene, *_ = pendulum()
    with pytest.raises(TypeError, match="It takes ") as told:
        fmbd.solve(scene, t_end=0.01, dt=0.005).picture()  # type: ignore[call-arg]
    assert "self" not in str(told.value)


def test_copies_of_scenes_read_their_own_joints() -> None:
    scene, _, pin = pendulum()
    scene.sensor("force", fmbd.reaction_force(pin))
    for made in (copy.deepcopy(scene), pickle.loads(pickle.dumps(scene))):
        assert fmbd.solve(made, t_end=0.01, dt=0.005)["force"].shape == (3, 2)


@pytest.mark.parametrize("read", READ.values(), ids=READ)
def test_scenes_with_other_bodies_read_their_own_joints(read: Callable[..., object]) -> None:
    """Those of finer meshes, which a tolerance asks for."""
    scene, bob, pin = pendulum()
    scene.sensor("seen", read(bob, pin))
    heavier = with_bodies(scene, {"bob": replace(bob, mass=2.0)})
    assert fmbd.solve(heavier, t_end=0.01, dt=0.005)["seen"].shape[0] == 3


@pytest.mark.parametrize("copied", [copy.deepcopy, pickle.dumps])
def test_runs_and_steppers_say_what_to_keep_of_them(copied: Callable[[object], object]) -> None:
    """So do equilibria and modes, whose states are data."""
    scene, *_ = pendulum()
    rest = fmbd.equilibrium(scene)
    with pytest.raises(InputError, match=r"Equilibrium: .* equilibrium\.state"):
        copied(rest)
    copied(rest.state)
    with pytest.raises(InputError, match=r"Modes: .* modes\.shapes"):
        copied(fmbd.modes(scene, 1, at=rest))
    with pytest.raises(InputError, match=r"Run: .* run\.series"):
        copied(fmbd.solve(scene, t_end=0.01, dt=0.005))
    with fmbd.stepper(scene, dt=0.01) as s, pytest.raises(InputError, match=r"SceneStepper: .* save\(\)"):
        copied(s)


def test_a_state_of_another_scene_of_the_same_sizes_is_told_by_its_joints() -> None:
    """Two bodies and two joints each: momenta and modes of the other one's state would be numbers without a meaning."""

    def pair(name: str, joint: Any) -> fmbd.Scene:
        scene = fmbd.Scene(name, gravity=(0.0, -9.81))
        for k in (1, 2):
            body = fmbd.RigidBody(f"body {k}", 1.0, 0.1, position=(float(k), -0.5))
            scene.add(body, joint(f"joint {k}", fmbd.ground, body, k))
        return scene

    hung = pair("hung", lambda name, a, b, k: fmbd.revolute(name, a, b, center=(float(k), 0.0)))
    rails = pair("rails", lambda name, a, b, k: fmbd.prismatic(name, a, b, axis=(0.0, 1.0), center=(float(k), 0.0)))
    run, other = (fmbd.solve(scene, t_end=0.2, dt=0.01) for scene in (hung, rails))
    assert len(run.state.q) == len(other.state.q) and len(run.state.lam) == len(other.state.lam)
    assert np.allclose(run.momenta(run.state)[1], run.momenta()[1])
    with pytest.raises(InputError, match='belongs to another scene: in "hung" it leaves "joint 1" open by'):
        run.momenta(other.state)
    with pytest.raises(InputError, match="belongs to another scene"):
        fmbd.modes(hung, 2, at=other.state)
