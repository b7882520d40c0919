"""The slider crank demo, and the derivatives that its model gives by hand."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.mechanics.bodies.own_derivatives import derivative
from fmbd_fenicsx.mechanics.bodies.port_constraint import PortConstraint

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "demos"))
import crank_model as model  # noqa: E402


def test_derivatives_of_the_constraints() -> None:
    y, v = np.array([1.0, -0.4, 0.3, 1e-3, 2e-3, 1e-4, 2e-4]), np.arange(1.0, 8.0)
    assert model.jacobian(y, 0.1) == pytest.approx(derivative(lambda z: model.constraints(z, 0.1), y), abs=1e-14)
    differences = PortConstraint("crank", 0, model.constraints).gamma(y, v, 0.1)
    assert model.gamma(y, v, 0.1) == pytest.approx(differences, rel=1e-8, abs=1e-8)


def free_motion(rod: model.Rod, start: np.ndarray, t_end: float) -> np.ndarray:
    """The elastic coordinates at the end from an ODE in them alone (order 8, 1e-12), without any multiplier.

    phi1 is prescribed, phi2 and x3 follow from phi1 and q4: y = y(q, t) with y' = Z q' + b, so Z^T (M y'' - f) = 0.
    """

    def rates(t: float, z: np.ndarray) -> np.ndarray:
        y = np.zeros(7)
        y[0], y[3:] = model.OMEGA * t, z[:4]
        y[1] = -np.arcsin(model.L1 * np.sin(y[0]) / (model.L2 + y[6]))
        y[2] = model.L1 * np.cos(y[0]) + (model.L2 + y[6]) * np.cos(y[1])
        G = model.jacobian(y, t)
        Z = np.concatenate((-np.linalg.solve(G[:, :3], G[:, 3:]), np.eye(4)))
        v = Z @ z[4:]
        v[:3] -= np.linalg.solve(G[:, :3], model.rate(y, t))
        bias = np.append(-np.linalg.solve(G[:, :3], model.gamma(y, v, t)), np.zeros(4))
        M = model.mass_matrix(rod, y)
        return np.append(z[4:], np.linalg.solve(Z.T @ M @ Z, Z.T @ (model.forces(rod, y, v) - M @ bias)))

    begin = np.append(start[3:7], start[10:14])
    return np.asarray(solve_ivp(rates, (0, t_end), begin, method="DOP853", rtol=1e-12, atol=1e-18).y[:4, -1])


@pytest.mark.parametrize("start", ["smooth", "rigid"])
@pytest.mark.parametrize(
    "rod",
    [model.Rod(), model.Rod(nonlinear=True, damped=True), model.Rod(consistent_mass=True, damped=True)],
    ids=["linear", "nonlinear damped", "consistent damped"],
)
def test_variants_against_the_motion_without_constraints(rod: model.Rod, start: str) -> None:
    given = model.STARTS[start].copy()
    given[8] = -model.L1 * given[7] / (model.L2 + given[6])  # rates of phi2 and x3 from the others, as over there
    given[9] = given[13]
    run = fmbd.solve(model.scene(rod, given), t_end=0.001, scheme=fmbd.Radau(7, rtol=1e-8))
    found, exact = run["coordinates"][-1, 3:], free_motion(rod, given, 0.001)
    assert np.abs(found / exact - 1).max() < 1e-8, found / exact - 1


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.parametrize("flag", ["--forms", "--consistent", "--nonlinear"])
def test_demo(flag: str, tmp_path: Path) -> None:
    out = tmp_path / "out.json"
    command = [sys.executable, "demos/slider_crank.py", "--json", str(out), flag]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=590)
    assert done.returncode == 0, done.stdout + done.stderr
    assert all(c["ok"] for c in json.loads(out.read_text())["check"])
