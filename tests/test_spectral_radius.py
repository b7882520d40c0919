"""Decay per step of an undamped vibration, as the spectral radius of the amplification matrix that a scheme carries out.

The matrix is built column by column from steps of independent starts, so that double eigenvalues (rho_inf = 0) and complex
pairs cost no accuracy, as they do where a radius is read off the decay of one run.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import StabilityError
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.schemes.newton import Newton
from fmbd_fenicsx.schemes.onestep.rattle import amplification
from fmbd_fenicsx.system.layout import State


def one_step(scheme: Any, z: float, start: tuple[float, ...]) -> np.ndarray:
    """The state (q, v / z, A / z^2) after a step h = 1 of q'' = -z^2 q; A only where the scheme carries it."""
    q, v = start[0], z * start[1]
    scene = fmbd.Scene("oscillator")
    scene.add(fmbd.CoordinateBody("mass", np.eye(1), lambda q, v, t: -(z**2) * q, (q,), (v,)))
    system, given, _ = scene.build()
    state = State(0.0, given.q, given.v, np.array([-(z**2) * q]), np.zeros(0))
    stepper = scheme.stepper(system, StepSolver(system), Newton(1e-12, 40), state)
    if len(start) > 2:
        stepper.A, stepper.fresh = np.array([z**2 * start[2]]), False
    end = stepper.advance(1.0)
    out = [end.q[0], end.v[0] / z]
    return np.array([*out, stepper.A[0] / z**2] if len(start) > 2 else out)


def radius(scheme: Any, z: float) -> float:
    """Largest absolute eigenvalue of the amplification matrix at h omega = z."""
    size = 3 if isinstance(scheme, fmbd.GeneralizedAlpha) else 2
    matrix = np.stack([one_step(scheme, z, tuple(e)) for e in np.eye(size)], axis=1)
    return float(np.abs(np.linalg.eigvals(matrix)).max())


@pytest.mark.parametrize(
    ("rho", "at_1e3"), [(0.9, 0.9066), (0.8, 0.8077), (0.5, 0.5078), (0.0, 0.0101)], ids=lambda x: f"{x:g}"
)
def test_generalized_alpha(rho: float, at_1e3: float) -> None:
    scheme = fmbd.GeneralizedAlpha(rho)
    assert radius(scheme, 1e3) == pytest.approx(at_1e3, abs=1e-3)
    triple = 1e-4 if rho == 0.0 else 0.0  # z^(-2/3): three eigenvalues meet at zero as z goes to infinity
    assert radius(scheme, 1e6) == pytest.approx(rho + triple, abs=1e-4)
    assert 0.99995 <= radius(scheme, 0.1) <= 1.0 + 1e-12


def test_generalized_alpha_without_damping() -> None:
    """rho_inf = 1 is permitted in the stabilised form, which without constraints is the trapezoidal rule."""
    for z in (0.1, 1e3, 1e6):
        assert radius(fmbd.GeneralizedAlpha(1.0, form=fmbd.GGL()), z) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(("stages", "at_1e3", "at_1e6"), [(3, 3e-3, 3e-6), (2, 2e-3, 2e-6)])
def test_radau(stages: int, at_1e3: float, at_1e6: float) -> None:
    """R(i z) falls like s / z for s stages: stiff vibrations are gone after one step."""
    scheme = fmbd.Radau(stages, rtol=None)
    assert radius(scheme, 1e3) == pytest.approx(at_1e3, rel=1e-2)
    assert radius(scheme, 1e6) == pytest.approx(at_1e6, rel=1e-2)
    assert 0.99995 <= radius(scheme, 0.1) <= 1.0 + 1e-12


@pytest.mark.parametrize("scheme", [fmbd.Rattle(), fmbd.EnergyMomentum()], ids=lambda s: s.name)
def test_conserving_schemes(scheme: Any) -> None:
    assert radius(scheme, 0.1) == pytest.approx(1.0, abs=1e-9)
    if isinstance(scheme, fmbd.EnergyMomentum):
        return  # own coordinates are taken at the mean point: springs are tested in test_energy_momentum
    assert radius(scheme, 1.9) == pytest.approx(1.0, abs=1e-9)
    with pytest.raises(StabilityError):  # steps must resolve every vibration
        radius(scheme, 2.1)
    assert np.abs(np.linalg.eigvals(amplification(2.1, 0.0))).max() > 1.2
    assert np.abs(np.linalg.eigvals(amplification(1.9, 0.0))).max() == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("z", [0.1, 1e3, 1e6])
def test_bdf_two(z: float) -> None:
    """Constant steps: q_n+1 of two past values solves (3/2 - i z) r^2 - 2 r + 1/2 = 0 for each r = e^(i omega h) carried."""
    scheme = fmbd.BDF(2, fmbd.Index3(), rtol=None)
    columns = []
    for e in np.eye(4):
        (q0, v0), (q1, v1) = e[:2] * [1, z], e[2:] * [1, z]
        scene = fmbd.Scene("oscillator")
        scene.add(fmbd.CoordinateBody("mass", np.eye(1), lambda q, v, t: -(z**2) * q, (q0,), (v0,)))
        system, given, _ = scene.build()
        state = State(0.0, given.q, given.v, np.array([-(z**2) * q0]), np.zeros(0))
        stepper = scheme.stepper(system, StepSolver(system), Newton(1e-12, 40), state)
        second = State(1.0, np.array([q1]), np.array([v1]), np.array([-(z**2) * q1]), np.zeros(0))
        stepper.state = second
        stepper._remember(second, np.zeros(0))
        end = stepper.advance(1.0)
        columns.append([q1, v1 / z, end.q[0], end.v[0] / z])
    found = np.abs(np.linalg.eigvals(np.array(columns).T)).max()
    expected = np.abs(np.roots([1.5 - 1j * z, -2.0, 0.5])).max()
    assert found == pytest.approx(expected, abs=1e-3)
    if z < 1:
        assert expected > 0.999
    else:
        assert found < 0.03
