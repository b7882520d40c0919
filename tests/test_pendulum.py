"""The elastic pendulum against beam theory, the rigid pendulum, and symmetries of mechanics."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from motion import elastic_rod
from scipy.special import ellipk

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.rotations import Array
from fmbd_fenicsx.schemes.consistent import consistent
from fmbd_fenicsx.system.layout import State
from fmbd_fenicsx.system.system import System

LENGTH, DENSITY = 1.0, 1000.0


# -- frequency of bending ------------------------------------------------------------------------------------
def matrix(M: Any) -> sp.csr_matrix:
    """A PETSc matrix of one rank for SciPy."""
    indptr, indices, values = M.getValuesCSR()
    return sp.csr_matrix((values, indices, indptr), shape=M.size)


def bending_frequency(mesh: Any, degree: int, E: float, guess: float, pinned: bool = True) -> float:
    """First circular frequency (rad/s) of bending of a rod whose surface "pin" does not move on average, or
    of a free one.

    The eigenvalue of [K T^T; T 0] nearest to 0.5 guess^2, with the rigid motions at 0 below it.
    """
    f = Field("rod", mesh, elastic_rod(mesh, degree=degree, elastic=fmbd.materials.linear_elastic(E, 0.0)).forms())
    n, d = f.n * f.dim, f.dim
    pin, rows = f.moments("pin"), d if pinned else 0
    T = sp.lil_matrix((rows, n))
    for k in range(rows):
        T[k, pin.nodes * d + k] = pin.weights[:, 0]
    K, M1 = matrix(f.combination(0.0, 1.0)), matrix(f.M)
    M = sp.kron(M1, sp.eye(d))
    scale = abs(K).max()
    A = sp.bmat([[K, scale * T.T], [scale * T, None]], format="csc")
    B = sp.bmat([[M, None], [None, sp.csr_matrix((rows, rows))]], format="csc")
    values = spl.eigsh(A, k=4, M=B, sigma=0.5 * guess**2, return_eigenvectors=False)
    values = np.sort(values[values > 1e-3 * guess**2])
    f.destroy()
    return float(np.sqrt(values[0]))


def beam(E: float, height: float) -> float:
    """Euler and Bernoulli: tan(bL) = tanh(bL), bL = 3.92660231; rad/s."""
    return 3.92660231204792**2 / LENGTH**2 * float(np.sqrt(E * height**2 / 12 / DENSITY))


@pytest.mark.serial
def test_bending_frequency_tends_to_the_beam(rod_mesh: Callable[..., Any]) -> None:
    """Shear and rotary inertia lower it by c (H/L)^2: the difference falls by four when the height is
    halved.
    """
    defects = []
    for height in (0.1, 0.05):
        omega = bending_frequency(rod_mesh(dim=2, h=height / 2, height=height), 2, 1e7, beam(1e7, height))
        defects.append(1 - omega / beam(1e7, height))
    assert 0 < defects[1] < 0.01
    assert 3.5 < defects[0] / defects[1] < 4.3, defects


@pytest.mark.serial
@pytest.mark.parametrize("degree, pinned, rate", [(1, True, 2.0), (1, False, 2.0), (2, True, 3.0), (2, False, 4.0)])
def test_bending_frequency_converges_in_space(
    degree: int, pinned: bool, rate: float, rod_mesh: Callable[..., Any]
) -> None:
    """Against a fine mesh. Eigenvalues converge with twice the order of the energy norm: 2 for P1, 4 for P2.

    On the pin the mean constraint spreads its reaction evenly, and the shear that ends at the free sides leaves a
    weak singularity in the corners: there P2 has 3 at these sizes.
    """
    guess = beam(1e7, 0.2) * (1.0 if pinned else (4.73004 / 3.92660) ** 2)
    fine = bending_frequency(rod_mesh(dim=2, h=0.0125, height=0.2), 2, 1e7, guess, pinned)
    sizes = [0.2, 0.1, 0.05]
    meshes = [rod_mesh(dim=2, h=h, height=0.2) for h in sizes]
    errors = [bending_frequency(m, degree, 1e7, guess, pinned) / fine - 1 for m in meshes]
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    print(degree, pinned, errors, order)
    assert min(errors) > 0  # Galerkin frequencies come from above
    assert order[-1] > rate - 0.2, (errors, order)


# -- against the rigid pendulum ------------------------------------------------------------------------------
def hanging(mesh: Any, E: float, frame: Any = fmbd.MeanAxis(), gravity: float = 9.81) -> fmbd.Scene:  # noqa: B008
    """A horizontal rod on a pin, released."""
    rod = elastic_rod(mesh, elastic=fmbd.materials.linear_elastic(E, 0.3), frame=frame)
    scene = fmbd.Scene("pendulum", gravity=(0, -gravity, 0)[: mesh.dim])
    scene.add(rod, fmbd.revolute("pin", rod.surface("pin"), fmbd.ground, center=(0, 0, 0)[: mesh.dim]))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    scene.sensor("speed", fmbd.velocity(rod.surface("tip")))
    return scene


def stiff_rod(height: float, gravity: float = 9.81) -> fmbd.Scene:
    """The same as a rigid body."""
    m = DENSITY * LENGTH * height
    body = fmbd.RigidBody("rod", m, m / 12 * (LENGTH**2 + height**2), (LENGTH / 2, 0.0))
    scene = fmbd.Scene("rigid pendulum", gravity=(0, -gravity))
    scene.add(body, fmbd.revolute("pin", body, fmbd.ground, center=(0, 0)))
    scene.sensor("tip", fmbd.position(body, point=(LENGTH, 0)))
    scene.sensor("speed", fmbd.velocity(body, point=(LENGTH, 0)))
    return scene


def lowest_point(run: fmbd.Run) -> float:
    """The instant (s) of the first passage below the pin, by the cubic through positions and velocities."""
    x, v, t = run["tip"][:, 0], run["speed"][:, 0], run.times
    k = int(np.flatnonzero((x[:-1] > 0) & (x[1:] <= 0))[0])
    h = t[k + 1] - t[k]
    cubic = [
        2 * (x[k] - x[k + 1]) + h * (v[k] + v[k + 1]),
        -3 * (x[k] - x[k + 1]) - h * (2 * v[k] + v[k + 1]),
        h * v[k],
        x[k],
    ]
    roots = np.roots(cubic)
    s = float(next(r.real for r in roots if abs(r.imag) < 1e-9 and -1e-9 <= r.real <= 1 + 1e-9))
    return float(t[k] + s * h)


def quarter_period(scene: fmbd.Scene) -> float:
    """Extrapolated from two step sizes (second order)."""
    coarse, fine = (lowest_point(fmbd.solve(scene, t_end=0.5, dt=h, newton=fmbd.Newton(1e-9))) for h in (4e-3, 2e-3))
    return (4 * fine - coarse) / 3


def test_period_tends_to_the_rigid_pendulum(rod_mesh: Callable[..., Any]) -> None:
    """Quarter period from 90 degrees against K(sin^2 45 deg) sqrt(J / (m g c)): the difference falls like
    1/E, below 1e-6.
    """
    H = 0.1
    J = (LENGTH**2 + H**2) / 12 + LENGTH**2 / 4
    exact = float(ellipk(0.5) * np.sqrt(J / (9.81 * LENGTH / 2)))
    assert abs(quarter_period(stiff_rod(H)) / exact - 1) < 1e-8  # what the scheme alone leaves
    mesh = rod_mesh(dim=2, h=0.1, height=H)
    defects = [abs(quarter_period(hanging(mesh, E)) / exact - 1) for E in (1e8, 1e9, 1e10, 1e11)]
    print(defects)
    assert defects[-1] < 1e-6
    for coarse, fine in zip(defects[:-2], defects[1:-1], strict=True):
        assert 7 < coarse / fine < 14, defects


def test_frames_agree_to_second_order_in_the_deformation(rod_mesh: Callable[..., Any]) -> None:
    """Mean-axis and attached frame differ by terms u^2: the tip's difference falls like 1/E^2."""
    mesh = rod_mesh(dim=2, h=0.1, height=0.1)
    differences = []
    for E in (1e7, 1e8):
        ends = [
            fmbd.solve(hanging(mesh, E, frame, 1.0), t_end=0.2, dt=2e-3, newton=fmbd.Newton(1e-9))["tip"][-1]
            for frame in (fmbd.MeanAxis(), fmbd.Attached("pin"))
        ]
        differences.append(float(np.abs(ends[0] - ends[1]).max()))
    print(differences)
    assert differences[0] < 1e-5
    assert differences[0] / differences[1] > 30, differences


# -- momentum and superposed rigid motions -------------------------------------------------------------------
def march(system: System, state: State, h: float, steps: int, rho: float = 0.8) -> list[State]:
    """Steps from a state made consistent first, all with the tangent of the body at rest."""
    solver = StepSolver(system)
    state, _ = consistent(system, state, solver)
    newton = fmbd.Newton(1e-10, 30, patience=100.0)
    stepper = fmbd.GeneralizedAlpha(rho).stepper(system, solver, newton, state)
    out = [state] + [stepper.advance(h) for _ in range(steps)]
    solver.destroy()
    return out


def spinning(mesh: Any, E: float = 5e6) -> tuple[System, State]:
    """A free rod with translation and spin about the third axis."""
    d = mesh.dim
    rod = elastic_rod(
        mesh,
        elastic=fmbd.materials.linear_elastic(E, 0.3),
        velocity=(1.0, -2.0, 0.5)[:d],
        angular_velocity=3.0 if d == 2 else (0.0, 0.0, 3.0),
    )
    scene = fmbd.Scene("spinning rod")
    scene.add(rod)
    system, state, _ = scene.build()
    return system, state


def stretched(system: System, state: State) -> State:
    """The displacement at which elastic and centrifugal forces balance: (K - w^2 M) u = w^2 M X in the
    plane of spin.
    """
    part = system.parts[0]
    f, w = part.field, float(state.v[system.motions.n_twist - 1])
    turn = np.array([1.0, 1.0, 0.0])[: f.dim]  # the axis of spin feels nothing
    K, M1 = matrix(f.combination(0.0, 1.0)), matrix(f.M)
    M = sp.kron(M1, sp.diags(turn * w * w))
    A = sp.bmat([[K - M, f.Q], [f.Q.T, None]], format="csc")
    b = np.concatenate(((M @ f.X.ravel()), np.zeros(f.Q.shape[1])))
    u = spl.spsolve(A, b)[: f.n * f.dim]
    q = state.q.copy()
    q[system.slices[0][0]] = u
    return State(0.0, q, state.v, state.a, state.lam)


@pytest.mark.serial
@pytest.mark.parametrize("dim", [2, 3])
def test_momenta_of_a_spinning_free_rod(dim: int, rod_mesh: Callable[..., Any]) -> None:
    """In centrifugal equilibrium the rod turns like a rigid body: all momenta to 1e-10 over eight turns."""
    system, state = spinning(rod_mesh(dim=dim, h=0.5, height=0.2), 1e8)
    states = march(system, stretched(system, state), 0.02, 800)
    p0, L0 = system.at(0.0, states[0].q, states[0].v).momenta()
    for s in states[::100]:
        p, L = system.at(s.t, s.q, s.v).momenta()
        assert np.abs(p - p0).max() < 1e-10 * np.abs(p0).max()
        assert np.abs(L - L0).max() < 1e-10 * np.abs(L0).max()
    u = [s.q[system.slices[0][0]] for s in (states[0], states[-1])]
    assert np.abs(u[1] - u[0]).max() < 1e-12  # m; the stretch itself is 4e-6


@pytest.mark.parametrize("dim", [2, 3])
def test_angular_momentum_of_a_vibrating_rod_is_of_second_order(dim: int, rod_mesh: Callable[..., Any]) -> None:
    system, state = spinning(rod_mesh(dim=dim, h=0.5, height=0.2), 5e8)
    drifts = []
    for steps in (50, 100):
        states = march(system, state, 0.5 / steps, steps)
        L = [system.at(s.t, s.q, s.v).momenta()[1] for s in (states[0], states[-1])]
        drifts.append(float(np.abs(L[1] - L[0]).max() / np.abs(L[0]).max()))
    assert drifts[0] < 1e-5
    assert drifts[0] / drifts[1] > 3.5, drifts


def moved(system: System, state: State, turn: Any, shift: Array, drift: Array) -> State:
    """The state after a superposed rotation, displacement and velocity of the whole world."""
    m, n = system.motions, system.n_frames
    pose = system.poses(state.q)[:-1]
    R = m.matrix(m.pose(np.zeros(m.dim), turn))
    poses = [m.pose(R @ x[: m.dim] + shift, R @ m.matrix(x)) for x in pose]
    twist = state.v[: n * m.n_twist].reshape(n, -1).copy()
    twist[:, : m.dim] = twist[:, : m.dim] @ R.T + drift
    q = np.concatenate((*poses, state.q[n * m.n_pose :]))
    v = np.concatenate((twist.ravel(), state.v[n * m.n_twist :]))
    return State(state.t, q, v, state.a, state.lam)


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
def test_superposed_rigid_motion_changes_no_deformation(dim: int, rod_mesh: Callable[..., Any]) -> None:
    from scipy.spatial.transform import Rotation

    system, state = spinning(rod_mesh(dim=dim, h=0.5, height=0.2))
    turn = 2.1 if dim == 2 else Rotation.from_rotvec([0.7, -1.9, 0.4]).as_matrix()
    other = moved(system, state, turn, np.array([3.0, -8.0, 5.0])[:dim], np.array([20.0, 7.0, -4.0])[:dim])
    part = system.slices[0][0]
    one, two = march(system, state, 0.01, 40), march(system, other, 0.01, 40)
    u, w = one[-1].q[part], two[-1].q[part]
    speed = np.abs(one[-1].v[system.n_core :]).max(initial=0.0)
    assert system.parts[0].comm.allreduce(float(speed)) > 1e-5  # it vibrates
    assert system.parts[0].comm.allreduce(float(np.abs(u - w).max(initial=0.0))) < 1e-9 * 1e-3
