"""A torque-free asymmetric body tumbling about its middle axis; invariants, attitude, period by elliptic integrals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.special import ellipk

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.schemes.consistent import consistent

J = np.array([1.0, 2.0, 2.5])
SPIN = np.array([0.4, 3.0, 0.2])


def scene() -> fmbd.Scene:
    body = fmbd.RigidBody("body", 1.0, J, rotation=(0.1, -0.2, 0.3, 0.927), angular_velocity=SPIN)
    made = fmbd.Scene("free body")
    made.add(body)
    made.sensor("R", fmbd.rotation(body))
    return made


def period() -> float:
    """Of the angular velocity in body axes (Landau and Lifshitz, Mechanics, section 37)."""
    M2, E2 = float(((J * SPIN) ** 2).sum()), float((J * SPIN**2).sum())
    a, b, c = J
    if M2 < E2 * b:
        a, c = c, a
    k2 = (b - a) * (E2 * c - M2) / ((c - b) * (M2 - E2 * a))
    return 4 * ellipk(k2) * np.sqrt(a * b * c / ((c - b) * (M2 - E2 * a)))


def momenta(run: fmbd.Run) -> np.ndarray:
    return np.array([run.system.at(s.t, s.q, s.v).momenta()[1] for s in run.snapshots])


def test_invariants_and_period_by_error_control() -> None:
    """Radau at 1e-11 over one tumble: momentum, energy and the spin after the period."""
    run = fmbd.solve(scene(), t_end=period(), scheme=fmbd.Radau(rtol=1e-11))
    E = run.energy["kinetic"]
    assert np.abs(E / E[0] - 1).max() < 1e-10
    start = scene().build()[1]
    L = [run.system.at(s.t, s.q, s.v).momenta()[1] for s in (start, run.state)]
    assert np.abs(L[1] - L[0]).max() < 1e-10 * np.linalg.norm(L[0])
    assert np.abs(run.state.v[3:6] - SPIN).max() < 1e-6 * np.linalg.norm(SPIN)  # an error of 1e-7 T would show
    R = run["R"].reshape(-1, 3, 3)
    assert np.abs(R.swapaxes(1, 2) @ R - np.eye(3)).max() < 1e-13
    w = R[:, 1] @ R[0, 1]
    assert w.min() < -0.8 and w.max() > 0.9  # it does turn over


@pytest.mark.parametrize("steps", [4000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_orthogonality_over_many_steps(steps: int) -> None:
    """Steps of generalized-alpha, R stays a rotation to 1e-13 and passes 2 pi k without notice."""
    system, given, _ = scene().build()
    solver = StepSolver(system)
    state, _ = consistent(system, given, solver)
    stepper = fmbd.GeneralizedAlpha(0.9).stepper(system, solver, fmbd.Newton(), state)
    worst, turned = 0.0, 0.0
    for _ in range(steps):
        old = stepper.state.q[3:7]
        stepper.advance(5e-3)
        new = stepper.state.q[3:7]
        worst = max(worst, abs(float(new @ new) - 1.0))
        turned += 2 * np.arccos(min(1.0, abs(float(old @ new))))
    assert worst < 1e-13
    assert turned > steps * 5e-3 * 2.5


@pytest.mark.parametrize("steps", [1000, pytest.param(100_000, marks=[pytest.mark.slow, pytest.mark.timeout(3600)])])
def test_energy_momentum_keeps_the_invariants(steps: int) -> None:
    """Angular momentum in space to 1e-12, energy to 1e-10, in every step."""
    system, given, _ = scene().build()
    solver = StepSolver(system)
    state, _ = consistent(system, given, solver)
    stepper = fmbd.EnergyMomentum().stepper(system, solver, fmbd.Newton(1e-12, 30), state)
    ev = system.at(state.t, state.q, state.v)
    L0, E0 = ev.momenta()[1], ev.energies()["kinetic"]
    worst = np.zeros(2)
    for _ in range(steps):
        s = stepper.advance(5e-3)
        ev = system.at(s.t, s.q, s.v)
        change = (np.abs(ev.momenta()[1] - L0).max() / np.linalg.norm(L0), abs(ev.energies()["kinetic"] / E0 - 1))
        worst = np.maximum(worst, change)
    assert worst[0] < 1e-12 and worst[1] < 1e-10, worst


@pytest.mark.parametrize("h", [8e-3])
def test_order_of_the_momentum(h: float) -> None:
    """Generalized-alpha keeps the momentum to second order only: what the energy-momentum form is for."""
    errors = []
    for step in (h, h / 2):
        run = fmbd.solve(scene(), t_end=1.6, dt=step, output=fmbd.Output(snapshots=20))
        L = momenta(run)
        errors.append(np.abs(L - L[0]).max())
    assert 1.8 < np.log2(errors[0] / errors[1]) < 2.2


@pytest.mark.parametrize("dim", [2, 3])
def test_a_step_begins_at_the_surfaces_as_they_stand(dim: int, rod_mesh: Callable[..., Any]) -> None:
    """Energy-momentum steps look at surfaces of floating bodies at the old state: those of its evaluation."""
    mesh = rod_mesh(dim=dim, h=0.5, height=0.4)
    elastic = fmbd.materials.linear_elastic(1e4, 0.3)
    rod = fmbd.FloatingBody("rod", mesh, degree=1, density=1.0, elastic=elastic, displacement=lambda x: 0.01 * x * x)
    scene = fmbd.Scene("rod")
    scene.add(rod, fmbd.RigidBody("other", 1.0, 0.1 if dim == 2 else (0.1, 0.1, 0.1)))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    system, state, _ = scene.build()
    stepper = fmbd.EnergyMomentum().stepper(system, StepSolver(system), fmbd.Newton(), state)
    seen = system.at(state.t, state.q).port
    assert stepper._begun()[0].port == pytest.approx(seen, abs=1e-14)  # type: ignore[attr-defined]
    assert np.abs(seen).max() > 0.0
