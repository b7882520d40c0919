"""Tangents with the stress that an increment foretold: against formulas, and increments of thin bodies in large steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.fem.motion_tangent import MotionTangent

MESHES = Path(__file__).parents[1] / "meshes"


def thin(energy: Any, height: float = 0.02) -> fmbd.AbsoluteBody:
    """A rod of 1 m in the plane."""
    mesh = fmbd.read_gmsh(MESHES / "rod.py", dim=2, h=0.1, height=height)
    return fmbd.AbsoluteBody("rod", mesh, density=1000.0, energy=energy)


def pulsed(body: fmbd.AbsoluteBody, size: float) -> fmbd.Scene:
    """The rod clamped at one end, with a force across its other end that rises and falls."""
    scene = fmbd.Scene("pulse")
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("pin")))
    scene.add(
        fmbd.forces.force("pulse", body.surface("tip"), lambda t: (0.0, size * max(0.0, 1.0 - abs(t - 0.2) / 0.2)))
    )
    scene.sensor("tip", fmbd.sensors.position(body.surface("tip")))
    return scene


def field_of(body: fmbd.AbsoluteBody) -> Any:
    """Its field in a scene."""
    scene = fmbd.Scene("one")
    scene.add(body)
    system, *_ = scene.build()
    return system.fields[0][1].field


@pytest.mark.parametrize("law", [fmbd.materials.saint_venant_kirchhoff, fmbd.materials.neo_hookean])
def test_the_stress_is_that_of_the_strain_without_the_square_of_the_increment(law: Any) -> None:
    """A turn d = w J x of a body at rest: K' - K = -w^2 int S : grad^T grad, S = (mu + lambda) 1 for the strain -w^2 / 2."""
    young, nu, turn = 1e7, 0.3, 1e-3
    field = field_of(thin(law(young, nu)))
    rng = np.random.default_rng(1)
    slope = rng.standard_normal((2, 2))
    rest, v = np.zeros(field.n * 2), (field.X @ slope).ravel()
    tangent = MotionTangent(field)
    tangent.take(0.0, rest, rest)
    plain = field.tangent(v) @ v
    tangent.take(0.0, rest, rest, np.zeros_like(rest))
    assert field.tangent(v) @ v == pytest.approx(plain, rel=1e-12)

    tangent.take(0.0, rest, rest, turn * (field.X @ np.array([[0.0, 1.0], [-1.0, 0.0]])).ravel())
    mu, lmbda = young / (2 * (1 + nu)), young * nu / ((1 + nu) * (1 - 2 * nu))
    area = field.mass_total / 1000.0
    exact = -(turn**2) * (mu + lmbda) * (slope**2).sum() * area
    assert field.tangent(v) @ v - plain == pytest.approx(exact, rel=1e-3)


def test_thin_bodies_take_few_increments_in_large_steps() -> None:
    """A soft rod bends by half its length in steps of a tenth of the pulse: no halvings, the motion of half the steps."""
    made = pulsed(thin(fmbd.materials.saint_venant_kirchhoff(1e7, 0.0)), 60.0)
    coarse, fine = (fmbd.solve(made, t_end=0.4, dt=dt) for dt in (0.02, 0.01))
    assert np.abs(coarse["tip"][:, 1]).max() > 0.4
    assert np.abs(coarse["tip"] - fine["tip"][::2]).max() < 0.02
    for run in (coarse, fine):
        assert run.counters["newton_iterations"] < 8 * run.counters["steps"]
        assert not run.counters["halved_steps"]


def test_a_body_that_keeps_its_volume_takes_few_increments_in_large_steps() -> None:
    """Its pressure is that which an increment foretold, and steps begin with a tangent where they are predicted."""
    made = pulsed(thin(fmbd.materials.neo_hookean_mixed(1e7, 0.4999)), 60.0)
    coarse, fine = (fmbd.solve(made, t_end=0.4, dt=dt) for dt in (0.02, 0.01))
    assert np.abs(coarse["tip"][:, 1]).max() > 0.3
    assert np.abs(coarse["tip"] - fine["tip"][::2]).max() < 0.02
    for run in (coarse, fine):
        assert run.counters["newton_iterations"] < 8 * run.counters["steps"]
        assert not run.counters["halved_steps"]


@pytest.mark.parametrize(("modulus", "dt"), [(4.4e12, 0.01), (2.6e13, 0.005)])
def test_a_stiff_body_keeps_to_the_solution_of_small_increments(modulus: float, dt: float) -> None:
    """A rod of 1 m that falls about its pin for 0.1 s, close to the stiffness that its roundoff permits, moves as a rigid one."""
    length, height = 1.0, 0.1
    mesh = fmbd.read_gmsh(MESHES / "block.py", size=(length, height), cells=8, origin=(0.0, -height / 2))
    body = fmbd.AbsoluteBody("rod", mesh, density=1000.0, energy=fmbd.materials.neo_hookean(modulus, 0.3))
    scene = fmbd.Scene("fall", gravity=(0.0, -9.81))
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("left"), center=(0.0, 0.0)))
    scene.sensor("tip", fmbd.sensors.position(body.surface("right")))
    run = fmbd.solve(scene, t_end=0.1, dt=dt, output=fmbd.Output(estimate_error=False))

    rate = 9.81 * length / 2 / ((length**2 + height**2) / 12 + length**2 / 4)
    rigid = solve_ivp(lambda t, y: (y[1], -rate * np.cos(y[0])), (0.0, 0.1), (0.0, 0.0), rtol=1e-10, atol=1e-12)
    assert run["tip"][-1, 1] == pytest.approx(length * np.sin(rigid.y[0, -1]), abs=2e-4)


def test_increments_too_far_for_a_law_leave_the_plain_tangent() -> None:
    """C - grad(d)^T grad(d) of a body turned inside out has no logarithm."""
    field = field_of(thin(fmbd.materials.neo_hookean(1e7, 0.3)))
    rest, v = np.zeros(field.n * 2), np.random.default_rng(2).standard_normal(field.n * 2)
    tangent = MotionTangent(field)
    tangent.take(0.0, rest, rest)
    plain = field.tangent(v)
    tangent.take(0.0, rest, rest, (5.0 * field.X[:, ::-1] * [1.0, 0.1]).ravel())
    assert np.isfinite(field.tangent(v)).all()
    np.testing.assert_allclose(field.tangent(v), plain, atol=1e-9 * np.abs(plain).max())
