"""Modes as runs, and figures of linear models."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_modes import two_masses

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.analysis.vibration import linear_model
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.post.plot import _of

MESHES = Path(__file__).resolve().parents[1] / "meshes"


def test_one_period_of_a_mode() -> None:
    """The mass that moves most has the amplitude asked for; the other one its share; both swing as a cosine."""
    scene = two_masses(0.0)
    scene.sensor("a", fmbd.position(scene.bodies["a"]))
    found = fmbd.modes(scene, 2)
    squares, shapes = np.linalg.eig(np.array([[8.0, -5.0], [-2.5, 2.5]]))
    exact = shapes[:, np.argmin(squares)]

    shown = fmbd.vibration(found, 0, 0.01, frames=16)
    assert shown.times[-1] == pytest.approx(2.0 * np.pi / np.sqrt(squares.min()), rel=1e-9)
    moved = np.stack([shown[name][:, 0] - rest for name, rest in (("a", 1.0), ("b", 2.0))], axis=1)
    wave = np.cos(2.0 * np.pi * np.arange(17) / 16)
    swing = np.outer(wave, moved[0])
    assert np.abs(moved - swing).max() < 1e-12
    assert np.abs(moved[0]).max() == pytest.approx(0.01, rel=1e-9)
    assert moved[0, 0] / moved[0, 1] == pytest.approx(exact[0] / exact[1], rel=1e-7)
    assert _of(shown) == f"two: mode 0, {found.frequencies[0]:.4g} Hz"
    assert shown.report().startswith("two: mode 0") and "mode 0" in repr(shown)
    with pytest.raises(InputError, match="Mode 2 does not exist"):
        fmbd.vibration(found, 2)
    with pytest.raises(InputError, match="frames = 3"):
        fmbd.vibration(found, 0, frames=3)


@pytest.mark.serial
def test_figures_of_responses(tmp_path: Path) -> None:
    """Files are written; an undamped resonance and frequencies that are none are refused."""
    model = fmbd.linearise(two_masses(0.1), ["push x"], ["b x", "speed x"])
    omega = np.geomspace(0.1, 20.0, 50)
    for draw, name in ((fmbd.bode, "bode.png"), (fmbd.nyquist, "nyquist.png")):
        draw(model, tmp_path / name, omega)
        assert (tmp_path / name).stat().st_size > 10_000
        with pytest.raises(InputError, match="positive frequencies"):
            draw(model, tmp_path / name, [0.0, 1.0])


@pytest.mark.parametrize("rate", [1e2, 1e8])
def test_linear_model_of_a_fast_oscillator(rate: float) -> None:
    """1 / (m (w^2 - omega^2) + i c omega), also where accelerations are 1e16 times the places they belong to."""
    scene = fmbd.Scene("mass on spring")
    mass = fmbd.RigidBody("mass", 2.0, 1.0, position=(0.3, 0.1))
    guide = fmbd.prismatic("guide", fmbd.ground, mass, axis=(1.0, 0.0))
    spring = fmbd.joint_spring("spring", fmbd.displacement(guide), stiffness=2.0 * rate**2, damping=0.2 * rate)
    scene.add(mass, guide, spring, fmbd.force("push", mass, lambda t: (0.0, 0.0)))
    scene.sensor("place", fmbd.position(mass))
    scene.sensor("accel", fmbd.acceleration(mass))
    model = fmbd.linearise(scene, inputs=["push x"], outputs=["place x", "accel x"])
    place, accel = model.frequency_response([0.5 * rate])[0, :, 0]
    exact = 1.0 / (2.0 * rate**2 * (0.75 + 0.05j))
    assert [place / exact, -accel / (0.5 * rate) ** 2 / exact] == pytest.approx([1.0, 1.0], rel=1e-10)


@pytest.mark.parametrize("kind", [pytest.param(fmbd.FloatingBody, marks=pytest.mark.mpi), fmbd.AbsoluteBody])
def test_linear_model_of_reactions_beside_elastic_fields(kind: Any) -> None:
    """What a clamp carries of a force on the tip of a slender bar: Euler's beam, k^4 = rho A omega^2 / E I."""
    height, modulus = 0.02, 1e9
    mesh = fmbd.read_gmsh(MESHES / "block.py", size=(1.0, height), counts=(8, 1), origin=(0.0, -0.5 * height))
    bar = kind("bar", mesh, density=1000.0, elastic=fmbd.materials.plane_stress(modulus, 0.0), degree=2)
    scene = fmbd.Scene("clamped bar")
    clamp = fmbd.fixed("clamp", fmbd.ground, bar.surface("left"))
    scene.add(bar, clamp, fmbd.force("push", bar.surface("right"), (0.0, 0.0)))
    scene.sensor("clamp", fmbd.reaction(clamp))
    scene.sensor("tip", fmbd.position(bar.surface("right")))
    model = fmbd.linearise(scene, inputs=["push y"], outputs=["clamp", "tip y"], modes=6)

    bending = modulus * height**3 / 12.0
    for omega, close in ((0.0, 1e-3), (30.0, 2e-2)):  # of eight cells
        k = max((1000.0 * height * omega**2 / bending) ** 0.25, 1e-2)
        below = 1.0 + np.cos(k) * np.cosh(k)
        force, moment = (np.cos(k) + np.cosh(k)) / below, (np.sin(k) + np.sinh(k)) / below / k
        tip = (np.sin(k) * np.cosh(k) - np.cos(k) * np.sinh(k)) / below / (bending * k**3)
        found = model.frequency_response([omega])[0, :, 0].real
        assert np.sort(np.abs(found[:3])) == pytest.approx(np.sort(np.abs([0.0, force, moment])), rel=close, abs=1e-5)
        assert found[3] / tip == pytest.approx(1.0, rel=max(close, 5e-3))


def test_linear_model_of_few_modes_knows_reactions(monkeypatch: pytest.MonkeyPatch) -> None:
    """What modes leave out is carried to the clamp at once: four of a rod held 0.7 of the push on its end. Where nobody reads
    reactions, none are solved for.
    """
    section = fmbd.RodSection.circle(youngs_modulus=1e9, poisson_ratio=0.3, density=1000.0, radius=0.01)
    rod = fmbd.Rod("rod", [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], section, elements=6)
    scene = fmbd.Scene("clamped rod")
    clamp = fmbd.fixed("clamp", fmbd.ground, rod.surface("start"))
    scene.add(rod, clamp, fmbd.force("push", rod.surface("end"), (0.0, 0.0, 0.0)))
    scene.sensor("clamp", fmbd.reaction_force(clamp))
    model = fmbd.linearise(scene, inputs=["push y"], outputs=["clamp"], modes=4)
    assert np.abs(model.frequency_response([0.0])[0, :, 0]) == pytest.approx([0.0, 1.0, 0.0], abs=1e-6)

    scene.sensor("end", fmbd.velocity(rod.surface("end")))
    monkeypatch.setattr(linear_model, "reactions", None)
    speed = fmbd.linearise(scene, inputs=["push y"], outputs=["end y"]).frequency_response([1.0])[0, 0, 0]
    assert speed / (1j / (3 * section.stiffness[5])) == pytest.approx(1.0, rel=1e-2)
