"""Bushings: against their matrix, their potential, exact tangents, and one elastic mount of a surface."""

from __future__ import annotations

import numpy as np
import pytest
from motion import Motion, first, plane_scene, space_scene
from scipy.spatial.transform import Rotation

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.mechanics.frames import Kinematics
from fmbd_fenicsx.rotations import Array

RNG = np.random.default_rng(4)


def matrix(n: int) -> Array:
    """A full positive matrix."""
    A = RNG.standard_normal((n, n))
    return A @ A.T


def mounted(dim: int, *, damped: bool) -> Motion:
    """Two bodies with a bushing whose axes are turned, moved at random."""
    scene, one, two = plane_scene(None) if dim == 2 else space_scene(None)
    axes = Rotation.from_rotvec([0.3, -0.7, 0.4]).as_matrix() if dim == 3 else np.array([[0.6, 0.8], [-0.8, 0.6]])
    n = 6 if dim == 3 else 3
    damping = matrix(n) if damped else None
    center = (0.8, 0.1, 0.2)[:dim]
    scene.add(fmbd.bushing("mount", one, two, stiffness=matrix(n), damping=damping, center=center, axes=axes))
    return Motion(scene, size=0.3)


@pytest.mark.parametrize("dim", [2, 3])
def test_wrench_of_small_motion_is_the_matrix(dim: int) -> None:
    """A body on the ground by a bushing, displaced and turned by little: the wrench is -K s - C s'."""
    n, h = (6, 1e-7) if dim == 3 else (3, 1e-7)
    K, C = matrix(n), matrix(n)
    body = fmbd.RigidBody("body", 1.0, 1.0 if dim == 2 else (1.0, 1.0, 1.0))
    scene = fmbd.Scene("mount")
    scene.add(body, fmbd.bushing("mount", fmbd.ground, body, stiffness=K, damping=C, center=np.zeros(dim)))
    system, state, _ = scene.build()
    s, rate = RNG.standard_normal((2, n))
    ev = system.at(0.0, system.compose(state.q, h * s), rate)
    assert np.abs(ev.spread(ev.wrenches()) + C @ rate + h * K @ s).max() < 10 * h


@pytest.mark.parametrize("dim", [2, 3])
def test_power_is_minus_the_rate_of_energy(dim: int) -> None:
    motion = mounted(dim, damped=False)
    ev = motion.at(0.0)
    power = float(ev.spread(ev.wrenches()) @ motion.v)
    rate = first(lambda s: motion.at(s).energies()["springs"])
    assert abs(power) > 1e-2
    assert abs(power + rate) < 1e-9 * max(1.0, abs(power))


@pytest.mark.parametrize("dim", [2, 3])
def test_tangent_is_exact(dim: int) -> None:
    """All displacements and rotations of both markers, rotations of 0.5 rad, with damping."""
    motion = mounted(dim, damped=True)
    ev, loads = motion.at(0.0), motion.system.forces[0]
    kin, n = ev.kin, loads.motions.n_twist
    tangent = loads.tangent(kin, 0.0)

    def moved(column: int, h: float) -> Array:
        x, R = kin.x.copy(), kin.R.copy()
        at, k = (loads.a if column < n else loads.b)[0], column % n
        if k < dim:
            x[at, k] += h
        else:
            turn = h * np.eye(3)[k - dim] if dim == 3 else np.array([0.0, 0.0, h])
            R[at] = Rotation.from_rotvec(turn).as_matrix()[:dim, :dim] @ R[at]
        near = Kinematics(x, R, kin.jac_frame, kin.jac_port)
        near.__dict__["twist"] = kin.twist
        return np.concatenate([w[0] for w in loads.wrenches(near, 0.0)])

    K = np.stack([-first(lambda h, c=c: moved(c, h)) for c in range(2 * n)], axis=1)
    assert np.abs(K - tangent.K[0]).max() < 1e-9 * np.abs(K).max()
    twist = np.concatenate((kin.twist[loads.a], kin.twist[loads.b]), axis=1)[0]
    at_rest = loads._forces(loads._pose(kin), 0 * twist[None])[0]
    both = np.concatenate([w[0] for w in loads.wrenches(kin, 0.0)])
    assert np.abs(tangent.D[0] @ twist + both - at_rest).max() < 1e-12 * np.abs(both).max()


@pytest.mark.parametrize("share", [1.0, 1.5])
def test_turned_by_a_large_angle(share: float, caplog: pytest.LogCaptureFixture) -> None:
    """A free body on a torsional bushing alone, in space: energy stays through turns of 2.5 rad, also where cos < 0; beyond
    half a turn, where moments change their sign, it is told of.
    """
    body = fmbd.RigidBody("body", 1.0, (0.1, 0.1, 0.1), angular_velocity=(3.0 * share, 4.0 * share, 0.0))
    scene = fmbd.Scene("torsion")
    K = (50.0, 50.0, 50.0, 0.4, 0.4, 0.4)
    scene.add(body, fmbd.bushing("mount", fmbd.ground, body, stiffness=K, center=(0, 0, 0)))
    scene.sensor("turn", fmbd.rotation(body))
    run = fmbd.solve(scene, t_end=1.0, dt=2e-3)
    assert ("half a turn" in caplog.text) == (share > 1.0)
    if share > 1.0:
        return
    w = 2.0  # sqrt(k / J): the axis stays, so it is a torsional oscillator of amplitude 5 / w = 2.5 rad
    angle = np.arccos((run["turn"][:, [0, 4, 8]].sum(1) - 1) / 2)
    assert angle.max() > 2.2
    assert np.abs(angle - np.abs(2.5 * np.sin(w * run.times))).max() < 2e-4


def test_default_center_is_common_to_both_sides() -> None:
    scene, one, two = plane_scene(None)
    scene.add(fmbd.bushing("mount", one, two, stiffness=(1.0, 1.0, 1.0)))
    system, state, _ = scene.build()
    assert np.abs(system.at(0.0, state.q, state.v).wrenches()).max() < 1e-15


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"stiffness": (1.0, 2.0)}, "must be 6 numbers or"),
        ({"stiffness": (1.0,) * 6, "damping": (-1.0,) * 6}, "gives energy"),
        ({"stiffness": (1.0,) * 6, "axes": np.ones((3, 3))}, "orthonormal"),
        ({"stiffness": (np.nan,) * 6}, "finite"),
    ],
)
def test_bad_input_is_named(options: dict, what: str) -> None:
    _, one, two = space_scene(None)
    with pytest.raises(InputError, match=what) as error:
        fmbd.bushing("mount", one, two, **options)
    assert '"mount"' in str(error.value)
