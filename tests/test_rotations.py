"""Rotations against SciPy and against their own definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from motion import first
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from fmbd_fenicsx import rotations as rot
from fmbd_fenicsx.rotations import PLANE, SPACE

vectors = arrays(float, 3, elements=st.floats(-1.5, 1.5, allow_subnormal=False))
small = arrays(float, 3, elements=st.floats(-1e-3, 1e-3, allow_subnormal=False))


@given(vectors)
def test_exponential_is_that_of_the_skew_matrix(theta: np.ndarray) -> None:
    R = rot.quaternion_matrix(rot.quaternion_exp(theta))
    assert np.abs(R - expm(rot.hat(theta))).max() < 1e-14
    assert np.abs(R - Rotation.from_rotvec(theta).as_matrix()).max() < 1e-14


@given(vectors, vectors)
def test_product_is_composition(a: np.ndarray, b: np.ndarray) -> None:
    p, q = rot.quaternion_exp(a), rot.quaternion_exp(b)
    expected = (Rotation.from_quat(p) * Rotation.from_quat(q)).as_matrix()
    assert np.abs(rot.quaternion_matrix(rot.quaternion_product(p, q)) - expected).max() < 1e-14


@given(vectors)
def test_logarithm_inverts_the_exponential(theta: np.ndarray) -> None:
    assert np.abs(rot.quaternion_log(rot.quaternion_exp(theta)) - theta).max() < 1e-14


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-16, 1e-9, 1e-8, 1.0001e-8, 1e-5, 1e-2, 3.0, np.pi - 1e-9])
def test_logarithm_at_any_size(size: float) -> None:
    theta = size * np.array([2.0, -1.0, 2.0]) / 3.0
    assert np.abs(rot.quaternion_log(rot.quaternion_exp(theta)) - theta).max() <= 1e-15 + 2e-16 * size
    both = rot.quaternion_log(-rot.quaternion_exp(theta))  # p and -p are the same rotation
    assert np.abs(both - theta).max() <= 1e-15 + 2e-16 * size


@given(vectors)
def test_tangent_is_the_derivative_of_the_exponential(theta: np.ndarray) -> None:
    rate = np.array([0.3, -0.7, 0.5])
    R = rot.quaternion_matrix(rot.quaternion_exp(theta))
    Rd = first(lambda s: rot.quaternion_matrix(rot.quaternion_exp(theta + s * rate)))
    assert np.abs(Rd - R @ rot.hat(rot.tangent(theta) @ rate)).max() < 1e-10


@given(st.one_of(vectors, small))
def test_tangent_inverse(theta: np.ndarray) -> None:
    assert np.abs(rot.tangent(theta) @ rot.tangent_inverse(theta) - np.eye(3)).max() < 1e-13


@pytest.mark.parametrize("function", [rot.tangent, rot.tangent_inverse])
def test_series_meets_the_closed_form(function: object) -> None:
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    below, above = function(9.999e-3 * axis), function(1.0001e-2 * axis)  # type: ignore[operator]
    slope = (function(1.1e-2 * axis) - function(0.9e-2 * axis)) / 2e-3  # type: ignore[operator]
    assert np.abs(above - below - 2e-6 * slope).max() < 1e-11


def test_series_have_all_digits() -> None:
    """Just below the angle where they end, where what they leave out is largest; 1 - cos t = 2 sin^2(t / 2) has all digits."""
    t = 9.99e-3
    H = rot.hat(t * np.array([1.0, 2.0, -2.0]) / 3.0)
    theta = np.array([H[2, 1], H[0, 2], H[1, 0]])

    closed = np.eye(3) - 2 * (np.sin(t / 2) / t) ** 2 * H + (t - np.sin(t)) / t**3 * (H @ H)
    assert np.abs(rot.tangent(theta) - closed).max() < 1e-15
    assert np.abs(rot.tangent_inverse(theta) @ closed - np.eye(3)).max() < 1e-15


def test_ten_thousand_steps_do_not_drift() -> None:
    q = SPACE.identity[None]
    xi = np.array([[0.0, 0.0, 0.0, 0.02, -0.013, 0.007]])
    for _ in range(10_000):
        q = SPACE.compose(q, xi)
    assert abs(np.linalg.norm(q[0, 3:]) - 1) < 1e-15
    expected = Rotation.from_rotvec(
        np.remainder(10_000 * np.linalg.norm(xi), 2 * np.pi) * xi[0, 3:] / np.linalg.norm(xi)
    )
    assert np.abs(SPACE.matrix(q)[0] - expected.as_matrix()).max() < 1e-11


@given(vectors, vectors, vectors)
def test_difference_inverts_compose(r: np.ndarray, theta: np.ndarray, delta: np.ndarray) -> None:
    q = SPACE.pose(r, Rotation.from_rotvec(theta).as_quat())
    xi = np.concatenate((r - theta, delta))
    assert np.abs(SPACE.difference(q, SPACE.compose(q, xi)) - xi).max() < 1e-13
    p = np.array([0.3, -0.1, 5.0])
    assert np.abs(PLANE.difference(p, PLANE.compose(p, delta)) - delta).max() < 1e-14


@given(vectors, vectors)
def test_rate_inverts_the_tangent(theta: np.ndarray, w: np.ndarray) -> None:
    xi, v = np.concatenate((w, theta)), np.concatenate((theta, w))
    rate = SPACE.rate(xi[None], v[None])[0]
    assert np.abs(rot.tangent(theta) @ rate[3:] - w).max() < 1e-13
    assert (rate[:3] == theta).all()


@pytest.mark.parametrize("motions", [PLANE, SPACE])
def test_spin_moment_and_lever_agree(motions: rot.Motions) -> None:
    rng = np.random.default_rng(3)
    d, n = motions.dim, motions.n_rot
    w, x, f = rng.standard_normal((7, n)), rng.standard_normal((7, d)), rng.standard_normal((7, d))
    turned = motions.spin(w, x)
    assert np.abs(turned - (motions.lever(x) @ w[..., None])[..., 0]).max() < 1e-15
    power = (turned * f).sum(1) - (w * motions.moment(x, f)).sum(1)  # (w x x) . f = w . (x x f)
    assert np.abs(power).max() < 1e-14
    if d == 3:
        assert np.abs(turned - np.cross(w, x)).max() < 1e-15


def test_pose_accepts_angle_matrix_and_quaternion() -> None:
    R = Rotation.from_rotvec([0.4, -1.0, 0.3])
    by_matrix, by_quaternion = SPACE.pose((1, 2, 3), R.as_matrix()), SPACE.pose((1, 2, 3), 3 * R.as_quat())
    assert np.abs(SPACE.matrix(by_matrix) - R.as_matrix()).max() < 1e-15
    assert np.abs(SPACE.matrix(by_quaternion) - R.as_matrix()).max() < 1e-15
    assert (SPACE.pose((1, 2, 3), R) == SPACE.pose((1, 2, 3), R.as_quat())).all()
    c, s = np.cos(2.0), np.sin(2.0)
    assert np.abs(PLANE.matrix(PLANE.pose((0, 0), 2.0)) - [[c, -s], [s, c]]).max() < 1e-15
    assert np.abs(PLANE.pose((0, 0), np.array([[c, -s], [s, c]]))[2] - 2.0) < 1e-15
