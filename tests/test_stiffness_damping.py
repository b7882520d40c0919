"""Rayleigh damping by the stiffness: of bodies with an energy that of the body without stress, whatever was solved before."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import neo_hookean, neo_hookean_incompressible, neo_hookean_mixed
from fmbd_fenicsx.mechanics.placements import FrameMotion

BETA = 0.02


def part_of(kind: Any, mesh: Any, law: Any) -> Any:
    scene = fmbd.Scene("one")
    scene.add(kind("rod", mesh, density=1e3, energy=law, stiffness_damping=BETA))
    return scene.build()[0].fields[0][1]


def bent(X: np.ndarray) -> np.ndarray:
    """Displacements that shorten a rod by a third and bend it: far beyond buckling."""
    return np.column_stack((-0.35 * X[:, 0], 0.2 * np.sin(3 * X[:, 0]))).ravel()


def at_rest(part: Any) -> FrameMotion:
    """A frame that does not move."""
    n = part.motions.n_twist
    return FrameMotion(0.0, np.eye(2), np.zeros(n), np.zeros(n), np.zeros(2))


def damping(part: Any, U: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Forces with the rate less those without, (n,)."""
    zero, motion = np.zeros_like(U), at_rest(part)
    return np.asarray(part.force(motion, (U, rate, zero))[1] - part.force(motion, (U, zero, zero))[1])


@pytest.mark.parametrize("kind", [fmbd.AbsoluteBody, fmbd.FloatingBody])
def test_damping_is_a_function_of_the_state(rod_mesh: Callable[..., Any], kind: Any) -> None:
    """The same force before and after a tangent was taken elsewhere; no gain of energy, also where the tangent is indefinite."""
    part = part_of(kind, rod_mesh(dim=2, h=0.25), neo_hookean(1e6, 0.3))
    U = bent(part.field.X)
    rates = np.random.default_rng(3).standard_normal((20, len(U)))
    before = [damping(part, U, rate) for rate in rates]
    free = [float(rate @ part.field.stiffness(rate)) for rate in rates]

    part.relinearise(at_rest(part), (U, rates[-1]))
    after = [damping(part, U, rate) for rate in rates]
    assert any(abs(rate @ part.field.stiffness(rate) - x) > 0.05 * x for rate, x in zip(rates, free, strict=True))
    size = np.abs(before).max()
    assert np.abs(np.subtract(after, before)).max() < 1e-10 * size
    assert min(float(rate @ f) for rate, f in zip(rates, after, strict=True)) > 0


@pytest.mark.parametrize("law", [neo_hookean(1e6, 0.3), neo_hookean_mixed(1e6, 0.45), neo_hookean_incompressible(1e6)])
def test_a_turning_body_is_not_damped(rod_mesh: Callable[..., Any], law: Any) -> None:
    """By any tangent: of the body at rest, turned, or bent."""
    part = part_of(fmbd.AbsoluteBody, rod_mesh(dim=2, h=0.25), law)
    X, turn = part.field.X, 0.7
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    U, rate = (X @ R.T - X).ravel(), (X @ R.T @ np.array([[0.0, 1.0], [-1.0, 0.0]])).ravel()
    size = BETA * np.abs(part.field.stiffness(X.ravel())).max()
    for place in (None, U, bent(X)):
        if place is not None:
            part.relinearise(at_rest(part), (place, rate))
        assert np.abs(part._turned_stiffness(U, rate)).max() * BETA < 1e-9 * size


def test_runs_with_strong_damping_do_not_depend_on_when_the_tangent_is_taken(rod_mesh: Callable[..., Any]) -> None:
    """A heavy rod that sags by half of its length, damped far beyond critical: few tangents or many."""
    rod = fmbd.AbsoluteBody(
        "rod", rod_mesh(dim=2, h=0.25), density=1e3, energy=neo_hookean(1e6, 0.3), stiffness_damping=BETA
    )
    tips = []
    for patience in (0.5, 30.0):
        scene = fmbd.Scene("sag", gravity=(0, -9.81))
        scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))
        scene.sensor("tip", fmbd.position(rod.surface("tip")))
        newton = fmbd.Newton(1e-10, 60, patience=patience)
        tips.append(fmbd.solve(scene, t_end=0.2, dt=0.01, newton=newton, output=fmbd.Output(progress=False))["tip"][-1])
    assert np.abs(tips[0] - tips[1]).max() < 1e-7


def one_bent(kind: Any, mesh: Any, law: Any, beta: float) -> Any:
    """A part whose tangent was taken where it is bent, and turned by 0.6 rad if it may turn in its coordinates."""
    scene = fmbd.Scene("one")
    scene.add(kind("rod", mesh, density=1e3, energy=law, stiffness_damping=beta))
    part = scene.build()[0].fields[0][1]
    X, turn = part.field.X, 0.6 if kind is fmbd.AbsoluteBody else 0.0
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    U = ((X + 0.3 * bent(X).reshape(-1, 2)) @ R.T - X).ravel()
    part.relinearise(at_rest(part), (U, np.zeros_like(U)))
    return part, U


@pytest.mark.parametrize(
    ("kind", "law"),
    [
        (fmbd.AbsoluteBody, neo_hookean(1e6, 0.3)),
        (fmbd.FloatingBody, neo_hookean(1e6, 0.3)),
        (fmbd.AbsoluteBody, neo_hookean_mixed(1e6, 0.49)),
        (fmbd.AbsoluteBody, neo_hookean_incompressible(1e6)),
    ],
)
def test_newtons_matrix_has_the_damping_of_the_forces(rod_mesh: Callable[..., Any], kind: Any, law: Any) -> None:
    """cd D of the step's matrix, as E x with damping less E x without, is the derivative of the forces by the rate."""
    from fmbd_fenicsx.linear.blocks.field_blocks import FieldMatrix, Weights

    mesh, products = rod_mesh(dim=2, h=0.25), []
    x = None
    for beta in (BETA, 0.0):
        part, U = one_bent(kind, mesh, law, beta)
        x = np.random.default_rng(5).standard_normal(len(U)) if x is None else x
        m = FieldMatrix.of(part, Weights(1.0, 1.0, 1.0))
        E = part.field.combination(m.cm, m.ck, m.cd)
        a, b = E.createVecs()
        a.array[:], a.array[: len(x)] = 0.0, x  # no pressure
        E.mult(a, b)
        products.append(b.array[: len(x)].copy())
    part, U = one_bent(kind, mesh, law, BETA)
    force = damping(part, U, x)
    assert np.abs(products[0] - products[1] - force).max() < 2e-3 * np.abs(force).max()


@pytest.mark.mpi
def test_pressures_that_follow_the_volume_damp_as_those_of_their_own(rod_mesh: Callable[..., Any]) -> None:
    """A rod of rubber that falls and bends far, damped by more than a step: the same motion, in no more increments."""
    tips, counts = [], []
    for law in (neo_hookean_mixed(5e6, 0.4995), neo_hookean_incompressible(5e6, 0.4995)):
        rod = fmbd.AbsoluteBody("rod", rod_mesh(dim=2, h=0.1), density=1e3, energy=law, stiffness_damping=BETA)
        scene = fmbd.Scene("sag", gravity=(0, -9.81))
        scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))
        scene.sensor("tip", fmbd.position(rod.surface("tip")))
        run = fmbd.solve(scene, t_end=0.3, dt=0.01, output=fmbd.Output(progress=False))
        assert run.counters["halved_steps"] == 0
        tips.append(run["tip"])
        counts.append(run.counters["newton_iterations"])
    assert tips[0][-1, 1] < -0.3
    assert np.abs(tips[0] - tips[1]).max() < 1e-5
    assert counts[0] <= counts[1]


def test_a_pressed_and_damped_block_needs_no_more_iterations_than_an_undamped_one() -> None:
    """A rubber block held and pressed by its faces to 85 % of its height, beta as large as the step: no step in parts."""
    mesh, counts = fmbd.read_gmsh("meshes/block.py", size=(0.04, 0.02), cells=10), []
    for beta in (0.0, 1e-3):
        law = neo_hookean(2e6, 0.4)
        block = fmbd.AbsoluteBody("block", mesh, density=1.1e3, energy=law, stiffness_damping=beta)
        plate = fmbd.RigidBody("plate", 0.1, 1e-3, position=(0.02, 0.02))
        slide = fmbd.prismatic("guide", fmbd.ground, plate, center=(0.02, 0.02), axis=(0, 1))
        scene = fmbd.Scene("press")
        scene.add(block, plate, slide, fmbd.tie_surface("bottom", block.surface("bottom"), fmbd.ground))
        scene.add(fmbd.tie_surface("top", block.surface("top"), plate))
        scene.add(fmbd.drive("press", fmbd.displacement(slide), lambda t: -0.003 * np.sin(50 * t) ** 2))
        run = fmbd.solve(scene, t_end=0.03, dt=1e-3, output=fmbd.Output(progress=False))
        assert run.counters["halved_steps"] == 0
        counts.append(run.counters["newton_iterations"])
    assert counts[1] < 1.1 * counts[0]
