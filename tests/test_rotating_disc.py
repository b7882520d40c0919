"""In-plane vibration of a free solid disc that spins about its axis, against Bessel's functions."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "demos"))

import campbell_model as model  # noqa: E402


@pytest.mark.parametrize(
    ("kind", "spin", "share"),
    [(fmbd.AbsoluteBody, 0.2, 1.5e-3), (fmbd.AbsoluteBody, 0.3, 1.5e-3), (fmbd.FloatingBody, 0.2, 1.5e-3)],
)
def test_breathing_and_twisting(kind: Any, spin: float, share: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both are 0.5 to 2.7 % from those at rest by Coriolis and centrifugal forces; found to the 0.13 % of a rim of 50 edges."""
    monkeypatch.chdir(ROOT)
    scene = model.disc(0.125, kind)
    omega = np.sort(fmbd.modes(scene, 16, at=fmbd.equilibrium(scene, spin=fmbd.Spin(spin))).omega)

    reference = model.symmetric(spin)
    assert len(reference) == 2
    for w in reference:
        assert np.abs(omega / w - 1.0).min() < share
    # a disc that flies straight on turns back in turning axes: a double root, which roundoff splits by its square root
    near = omega[np.argsort(np.abs(omega - spin))[:2]]
    assert near == pytest.approx(spin, rel=1e-5) and near.mean() == pytest.approx(spin, rel=1e-10)
    if kind is fmbd.FloatingBody:  # its frame turns with it: nothing holds its angle
        assert omega[0] < 1e-6


def test_rates_of_a_steady_rotation_about_any_point(rod_mesh: Any) -> None:
    """Every node and frame: x' = w x (x - c), and x'' the same of x'."""
    field = fmbd.AbsoluteBody(
        "field", rod_mesh(h=0.5, height=0.4), degree=1, density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.3)
    )
    scene = fmbd.Scene("turning")
    scene.add(field, fmbd.RigidBody("body", 1.0, 0.1, position=(3.0, 0.5)))
    system, state, _ = scene.build()
    v, a = fmbd.Spin(2.0, center=(0.7, -0.4, 0.0)).rates(system, state.q)

    W, c = np.array([[0.0, -2.0], [2.0, 0.0]]), np.array([0.7, -0.4])
    nodes = system.slices[1][0]
    ((_, part),) = system.fields
    x = np.asarray(part.field.X_world) - c
    assert v[nodes].reshape(-1, 2) == pytest.approx(x @ W.T, abs=1e-12)
    assert a[nodes].reshape(-1, 2) == pytest.approx(-4.0 * x, abs=1e-12)
    assert v[:3] == pytest.approx([*(W @ (np.array([3.0, 0.5]) - c)), 2.0], abs=1e-12)
    assert a[:2] == pytest.approx(-4.0 * (np.array([3.0, 0.5]) - c), abs=1e-12)
