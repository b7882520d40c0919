"""Markers on rigid bodies and on elastic surfaces: positions, Jacobians and biases against finite
differences.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from motion import Motion, elastic_scene, first, plane_scene, space_scene
from scipy.linalg import polar

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.mechanics.frames import polar_rotation


def rigid(dim: int) -> fmbd.Scene:
    """Two rigid bodies with sensors off their centres."""
    scene, one, two = plane_scene() if dim == 2 else space_scene()
    scene.sensor("p", fmbd.position(one, point=(0.9, -0.4, 0.2)[:dim]))
    scene.sensor("q", fmbd.position(two, point=(0.1, 0.7, -0.3)[:dim]))
    return scene


def elastic(mesh: Any, frame: Any) -> fmbd.Scene:
    """Markers on both ends of an elastic rod, one of them off the centroid."""
    scene, rod, block = elastic_scene(mesh, degree=1, frame=frame)
    scene.sensor("pin", fmbd.position(rod.surface("pin")))
    scene.sensor("tip", fmbd.position(rod.surface("tip"), point=(1.3, 0.2, -0.1)[: mesh.dim]))
    scene.sensor("block", fmbd.position(block))
    return scene


CASES = ["rigid-2", "rigid-3", "mean-2", "mean-3", "attached-2", "attached-3"]


@pytest.fixture(params=CASES)
def motion(request: pytest.FixtureRequest, rod_mesh: Callable[..., Any]) -> Motion:
    kind, dim = request.param.split("-")
    if kind == "rigid":
        return Motion(rigid(int(dim)))
    mesh = rod_mesh(dim=int(dim), h=0.5, height=0.4)
    return Motion(elastic(mesh, fmbd.MeanAxis() if kind == "mean" else fmbd.Attached("tip")))


def test_velocities_are_derivatives_of_positions(motion: Motion) -> None:
    d = motion.system.motions.dim
    kin = motion.at(0.0).kin
    assert kin.twist is not None
    xd, Rd = first(lambda s: motion.at(s).kin.x), first(lambda s: motion.at(s).kin.R)
    assert np.abs(xd - kin.twist[:, :d]).max() < 1e-8 * np.abs(xd).max()
    W = Rd @ kin.R.swapaxes(1, 2)  # world angular velocity as a skew matrix
    w = W[:, 1, 0][:, None] if d == 2 else np.stack((W[:, 2, 1], W[:, 0, 2], W[:, 1, 0]), -1)
    assert np.abs(w - kin.twist[:, d:]).max() < 1e-8 * np.abs(w).max()


def test_jacobian_times_velocity_is_the_twist(motion: Motion) -> None:
    ev, m = motion.at(0.0), motion.system.markers
    twist = (ev.kin.jac_frame @ ev.twist[m.frame][..., None])[..., 0]
    if m.surface.size:
        twist[m.surface] += (ev.kin.jac_port @ ev.port_rate[m.port][..., None])[..., 0]
    assert np.abs(twist - ev.kin.twist).max() < 1e-12


def test_bias_is_the_acceleration_without_acceleration(motion: Motion) -> None:
    s, ev = motion.system, motion.at(0.0)
    m = s.markers
    measured = first(lambda x: motion.at(x).kin.twist)
    accel = (ev.kin.jac_frame @ s.twists(motion.a)[m.frame][..., None])[..., 0]
    if m.surface.size:
        port = s.ports(motion.a, 0.0, rates=True)
        accel[m.surface] += (ev.kin.jac_port @ port[m.port][..., None])[..., 0]
    assert ev.kin.bias is not None
    assert np.abs(measured - accel - ev.kin.bias).max() < 1e-7 * np.abs(measured).max()


@pytest.mark.parametrize("dim", [2, 3])
def test_polar_rotation_against_scipy(dim: int) -> None:
    rng = np.random.default_rng(5)
    F = np.eye(dim) + 0.3 * rng.standard_normal((20, dim, dim))
    F = F[np.linalg.det(F) > 0.05]
    expected = np.array([polar(f)[0] for f in F])
    assert np.abs(polar_rotation(F) - expected).max() < 1e-12


@pytest.mark.parametrize("dim", [2, 3])
def test_polar_rotation_of_a_flat_surface_is_proper(dim: int) -> None:
    rng = np.random.default_rng(6)
    R = polar_rotation(rng.standard_normal((10, dim, dim)))
    flat = R.copy()
    flat[:, :, 0] = 0.0  # a face normal to x has no extension along x
    found = polar_rotation(flat)
    assert np.abs(np.linalg.det(found) - 1).max() < 1e-14
    assert np.abs(found - R).max() < 1e-13


@pytest.mark.parametrize("dim", [2, 3])
def test_surface_marker_follows_a_rigid_motion_exactly(dim: int, rod_mesh: Callable[..., Any]) -> None:
    scene = elastic(rod_mesh(dim=dim, h=0.5, height=0.4), fmbd.MeanAxis())
    system, state, _ = scene.build()
    m = system.motions
    start = system.at(0.0, state.q).kin
    xi = np.zeros(system.n_v)
    xi[: m.n_twist] = [0.3, -0.2, 0.5, 0.4, -0.7, 0.2][: m.n_twist]
    q = system.compose(state.q, xi)
    kin, R, pose = system.at(0.0, q).kin, m.matrix(system.poses(q))[0], system.poses(q)[0]
    r0 = system.poses(state.q)[0, :dim]
    for i in np.flatnonzero(system.markers.frame == 0):
        assert np.abs(kin.x[i] - (pose[:dim] + R @ (start.x[i] - r0))).max() < 1e-14
        assert np.abs(kin.R[i] - R @ start.R[i]).max() < 1e-14


@pytest.mark.parametrize("dim", [2, 3])
def test_surface_rotation_fulfils_the_resultant_condition(dim: int, rod_mesh: Callable[..., Any]) -> None:
    """sum_k (R_s e_k) x b_k = 0: the marker turns with the surface's mean."""
    motion = Motion(elastic(rod_mesh(dim=dim, h=0.5, height=0.4), fmbd.MeanAxis()))
    s, ev = motion.system, motion.at(0.0)
    m = s.motions
    for k, marker in enumerate(s.markers.surface):
        b = ev.port[s.markers.port[k]].reshape(1 + dim, dim)[1:]
        Rs = m.matrix(ev.pose)[s.markers.frame[marker]].T @ ev.kin.R[marker]
        assert np.abs(m.moment(Rs.T, b).sum(0)).max() < 1e-14
