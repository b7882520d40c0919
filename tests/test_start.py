"""Consistent start: what it reaches, what it changes, what it refuses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from motion import elastic_scene, first, plane_scene, space_scene

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConstraintError, InputError
from fmbd_fenicsx.linear.blocks.field_blocks import Weights
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.schemes.consistent import consistent
from fmbd_fenicsx.schemes.onestep.alpha.jerk import jerk
from fmbd_fenicsx.system.layout import State
from fmbd_fenicsx.system.system import System


def started(scene: fmbd.Scene) -> tuple[System, State, Any]:
    """The consistent state of a scene."""
    system, state, _ = scene.build()
    solver = StepSolver(system)
    made, correction = consistent(system, state, solver)
    solver.destroy()
    return system, made, correction


@pytest.mark.parametrize(("gap", "factors"), [(0.0, 1), (1e-5, 2)])
def test_a_start_factors_its_matrix_once_where_no_body_moves(
    gap: float, factors: int, rod_mesh: Callable[..., Any]
) -> None:
    """Accelerations beside fields take the matrix of velocities; a joint that is open has one of its own."""
    scene, rod, _ = elastic_scene(rod_mesh(dim=2, h=0.5, height=0.4))
    scene.add(fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
    system, state, _ = scene.build()
    solver, q = StepSolver(system), state.q.copy()
    q[0] += gap
    consistent(system, replace(state, q=q), solver)
    assert solver.counters["core_factorisations"] == factors
    solver.destroy()


def jointed(dim: int, gap: float = 0.0, kick: bool = True) -> fmbd.Scene:
    """Ground, hinge, body, hinge, body; the second body displaced by ``gap``, velocities that break the
    joints.
    """
    scene = fmbd.Scene("chain", gravity=(0, -9.81, 0)[:dim])
    J: Any = 0.1 if dim == 2 else (0.1, 0.2, 0.15)
    velocity = (1.0, 2.0, -1.0)[:dim] if kick else None
    one = fmbd.RigidBody("one", 1.0, J, (0.5, 0, 0)[:dim])
    two = fmbd.RigidBody("two", 2.0, J, (1.5, gap, 0)[:dim], velocity=velocity)
    joint = fmbd.distance("rod", one, two, point_a=(0.8, 0.1, 0)[:dim], point_b=(1.2, 0.1, 0)[:dim], length=0.4)
    scene.add(one, two, fmbd.revolute("pin", fmbd.ground, one, center=(0, 0, 0)[:dim]), joint)
    return scene


@pytest.mark.parametrize("gap", [0.0, 1e-4])
@pytest.mark.parametrize("dim", [2, 3])
def test_all_levels_hold_after_the_start(dim: int, gap: float) -> None:
    system, s, correction = started(jointed(dim, gap))
    ev = system.at(0.0, s.q, s.v)
    assert np.abs(ev.constraint()).max() < 1e-14
    assert np.abs(ev.jacobian.times(s.v) + ev.constraint_rate()).max() < 1e-13
    assert np.abs(ev.jacobian.times(s.a) + ev.gamma()).max() < 1e-11
    assert np.abs(ev.balance(s.a, s.lam)).max() < 1e-11
    assert correction.velocity > 0.1  # the given velocities broke the joints


def test_velocity_correction_is_the_smallest_in_energy() -> None:
    """dv = -M^-1 G^T mu: no smaller kinetic energy of the change is possible."""
    system, given, _ = jointed(3).build()
    _, s, _ = started(jointed(3))
    ev = system.at(0.0, given.q, given.v)
    G = ev.jacobian.core
    M = np.zeros((system.n_v, system.n_v))
    for k in range(system.n_frames):
        M[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = system.rigid.matrices()[k]
    S = G @ np.linalg.solve(M, G.T)
    expected = given.v - np.linalg.solve(M, G.T @ np.linalg.solve(S, G @ given.v))
    assert np.abs(s.v - expected).max() < 1e-12


@pytest.mark.mpi
@pytest.mark.parametrize("frame", [fmbd.MeanAxis(), fmbd.Attached("tip")], ids=["mean axis", "attached"])
@pytest.mark.parametrize("dim", [2, 3])
def test_elastic_start(dim: int, frame: Any, rod_mesh: Callable[..., Any]) -> None:
    """Initial displacements and rates that break the frame's conditions and the joint are corrected."""

    def bend(x: np.ndarray) -> np.ndarray:
        u = np.zeros_like(x)
        u[1] = 2e-4 * x[0] ** 2
        return u

    scene, rod, block = elastic_scene(
        rod_mesh(dim=dim, h=0.5, height=0.4), frame=frame, displacement=bend, displacement_rate=bend
    )
    scene.add(fmbd.fixed("weld", rod.surface("pin"), fmbd.ground))
    system, s, _ = started(scene)
    ev = system.at(0.0, s.q, s.v)
    assert np.abs(ev.constraint()).max() < 1e-12
    assert np.abs(ev.jacobian.times(s.v)).max() < 1e-12
    assert np.abs(ev.jacobian.times(s.a) + ev.gamma()).max() < 1e-8 * system.max_abs(s.a)
    assert system.max_abs(ev.balance(s.a, s.lam)) < 1e-8 * np.abs(s.lam).max()


@pytest.mark.parametrize("dim", [2, 3])
def test_gap_is_refused_and_the_joint_named(dim: int) -> None:
    scene = jointed(dim)
    far = fmbd.RigidBody("far", 1.0, 0.1 if dim == 2 else (0.1, 0.1, 0.1), (5.0, 0, 0)[:dim])
    scene.add(far)
    from dataclasses import replace

    pin = fmbd.revolute("hinge", scene.bodies["two"], far, center=(2, 0, 0)[:dim])
    apart = replace(pin, center_b=np.array([2.3, 0.1, 0.0])[:dim])  # 0.3 m beside
    scene.add(apart)
    with pytest.raises(ConstraintError, match=r'joint "hinge" \(revolute\) is open by 0.3 m'):
        started(scene)


def test_loop_that_cannot_close_is_refused() -> None:
    scene, one, two = plane_scene()
    scene.add(
        fmbd.revolute("a", fmbd.ground, one, center=(0, 0)),
        fmbd.revolute("b", fmbd.ground, two, center=(9, 0)),
    )
    scene.add(fmbd.distance("strut", one, two, point_a=(0.4, 0.1), point_b=(1.1, -0.2), length=40.0))
    with pytest.raises(ConstraintError, match='"strut"'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


def test_nothing_is_changed_in_a_consistent_scene() -> None:
    _, _, correction = started(jointed(3, kick=False))
    assert correction.position < 1e-14
    assert correction.velocity < 1e-14


@pytest.mark.parametrize("dim", [2, 3])
def test_jerk_is_the_rate_of_accelerations(dim: int) -> None:
    """a' and lambda' against differences of accelerations computed along the exact motion."""
    from fmbd_fenicsx.schemes.consistent import accelerations

    scene = jointed(dim, kick=True)
    system, s, _ = started(scene)
    solver = StepSolver(system)
    a_rate, l_rate, _ = jerk(system.at(s.t, s.q, s.v), s, solver, Weights(1.0, 0.0, 0.0), 1e-2)

    def later(x: float) -> State:
        q = system.compose(s.q, x * s.v + 0.5 * x * x * s.a)
        return accelerations(system, State(x, q, s.v + x * s.a, s.a, s.lam), solver)

    assert np.abs(first(lambda x: later(x).a, 1e-4) - a_rate).max() < 1e-5 * np.abs(a_rate).max()
    assert np.abs(first(lambda x: later(x).lam, 1e-4) - l_rate).max() < 1e-5 * np.abs(l_rate).max()


def test_scene_without_joints_starts() -> None:
    scene, _, _ = space_scene()
    system, s, _ = started(scene)
    assert system.n_lam == 0
    assert np.abs(s.a[:3] - [0.5, 2.0, -9.81]).max() < 1e-14


# -- arguments of solve --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "t_end, dt, words",
    [
        (1.0, 0.0, "dt.*positive"),
        (1.0, -0.1, "dt.*positive"),
        (1.0, np.nan, "dt.*positive"),
        (0.0, 0.1, "t_end.*positive"),
        (-1.0, 0.1, "t_end.*positive"),
        (np.inf, 0.1, "t_end.*positive"),
        (1.0, 2.0, "larger than the whole run"),
        (1.0, 1e-17, "roundoff"),
    ],
)
def test_unusable_times_are_refused(t_end: float, dt: float, words: str) -> None:
    with pytest.raises(InputError, match=words):
        fmbd.solve(plane_scene()[0], t_end=t_end, dt=dt)


def test_elastic_body_without_joint_and_without_frame(rod_mesh: Callable[..., Any]) -> None:
    with pytest.raises(InputError, match='"rod".*frame None must be.*MeanAxis'):
        elastic_scene(rod_mesh(dim=2, h=0.5, height=0.4), frame=None)


def test_scene_without_bodies() -> None:
    with pytest.raises(InputError, match='"empty" has no body'):
        fmbd.solve(fmbd.Scene("empty"), t_end=0.1, dt=0.01)


def test_mixed_dimensions_are_refused() -> None:
    scene = plane_scene()[0]
    scene.add(fmbd.RigidBody("solid", 1.0, (1.0, 1.0, 1.0)))
    with pytest.raises(InputError, match="dimensions"):
        scene.build()


def test_names_are_unique() -> None:
    scene, one, _ = plane_scene()
    with pytest.raises(InputError, match='"one"'):
        scene.add(one)


@pytest.mark.parametrize("kind", [fmbd.FloatingBody, fmbd.AbsoluteBody])
def test_start_from_forces_that_cancel_inside_a_body(kind: Any) -> None:
    """A rod pulled at both ends is at rest with large stress: the roundoff of that is no acceleration to be found."""
    mesh = fmbd.read_gmsh("meshes/rod.py", dim=2, h=0.1, length=1.0, height=0.1)
    loads = [fmbd.traction("tip", (1e6, 0.0)), fmbd.traction("pin", (-1e6, 0.0))]
    law = fmbd.materials.plane_stress(2e11, 0.3)
    rod = kind("rod", mesh, density=7800.0, elastic=law, loads=loads)
    scene = fmbd.Scene("pulled", settle=True)
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    run = fmbd.solve(scene, t_end=2e-4, dt=1e-4)
    assert np.abs(run["tip"] - (1.0 + 5e-6, 0.0)).max() < 5e-10


def test_a_start_factors_its_masses_and_rows_once() -> None:
    """Velocities and accelerations of joints that are closed have one matrix; a position that moves has another."""
    system, state, _ = jointed(2).build()
    once, again = StepSolver(system), StepSolver(system)
    consistent(system, state, once)
    assert once.core.factorisations == 1

    consistent(system, replace(state, q=state.q + 1e-6 * np.arange(system.n_q)), again)
    assert again.core.factorisations > 1
