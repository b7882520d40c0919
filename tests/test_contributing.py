"""The examples of docs/contributing.md work as printed."""

import re
from pathlib import Path

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import study

TEXT = (Path(__file__).resolve().parents[1] / "docs/contributing.md").read_text()


def example(word):
    """The names that the Python block with a word defines."""
    block = next(b for b in re.findall(r"```python\n(.*?)```", TEXT, re.S) if word in b)
    assert len([line for line in block.splitlines() if line.strip()]) <= 28
    found = {"__name__": "example"}
    exec(compile(block, "contributing.md", "exec"), found)
    return found


def pendulum():
    bob = fmbd.RigidBody("bob", 1.0, 0.1, position=(1.0, 0.0))
    scene = fmbd.Scene("swing", gravity=(0, -9.81))
    scene.add(bob, fmbd.revolute("pin", fmbd.ground, bob, center=(0, 0)))
    scene.sensor("bob", fmbd.position(bob))
    return scene


def test_joint_leaves_one_translation_and_two_rotations():
    joint = example("slotted_pin")["slotted_pin"]
    body = fmbd.RigidBody(
        "b", 2.0, (0.2, 0.3, 0.4), position=(0.1, 0.4, 0), velocity=(1, 0, 0), angular_velocity=(0, 0.5, 0.5)
    )
    scene = fmbd.Scene("slot", gravity=(3.0, -9.81, 2.0))
    scene.add(body, joint("slot", fmbd.ground, body, center=np.zeros(3), axis=(1, 0, 0)))
    scene.sensor("pin", fmbd.position(body, point=(0, 0, 0)))
    scene.sensor("rotation", fmbd.rotation(body))
    run = fmbd.solve(scene, t_end=0.2, dt=0.01)
    assert abs(run["pin"][-1, 0]) > 0.1 and np.abs(run["pin"][:, 1:]).max() < 1e-10
    R = run["rotation"][-1].reshape(3, 3)
    assert run.system.n_lam == 3 and np.abs(R - np.eye(3)).max() > 0.01


@pytest.mark.mpi
def test_weak_form_stiffens_the_rod(rod_mesh):
    def tip(form):
        rod = fmbd.FloatingBody("rod", rod_mesh(), degree=1, density=1e3, elastic=form)
        scene = fmbd.Scene("swing", gravity=(0, -9.81))
        scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
        run = fmbd.solve(scene, t_end=0.1, dt=0.01)
        return run.energy["elastic"].max()

    assert tip(example("fibres")["fibres"](5e6, 0.3, 5e7)) < 0.5 * tip(fmbd.materials.linear_elastic(5e6, 0.3))


def test_scheme_has_its_order():
    scheme = example("ProjectedEuler")["ProjectedEuler"]()
    reference = fmbd.solve(pendulum(), t_end=0.48, dt=5e-4)
    table = study.orders(
        lambda h: fmbd.solve(pendulum(), t_end=0.48, dt=h, scheme=scheme),
        [8e-3, 4e-3, 2e-3],
        reference=reference,
    )
    for name in ("q", "v", "lam"):
        table.assert_order(name, 1.0, 0.15)
