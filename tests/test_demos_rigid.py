"""The rigid demos in full end with good checks; the reference of the flyball governor by its three coordinates.

Their fast versions: tests/test_demos.py.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
DEMOS = [
    "rigid_pendulum",
    "heavy_top",
    "four_bar",
    "bricard",
    "flyball",
    "rigid_slider_crank",
    "wheel_suspension",
    "chain",
]


def run(name: str, tmp_path: Path) -> dict:  # type: ignore[type-arg]
    file = tmp_path / "out.json"
    command = [sys.executable, f"demos/{name}.py", "--json", str(file)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(file.read_text())


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.parametrize("name", DEMOS)
def test_demo_in_full(name: str, tmp_path: Path) -> None:
    assert all(c["ok"] for c in run(name, tmp_path)["check"])


def governor(t_end: float) -> float:
    """Height of the slider from the angles and heights alone, the spin eliminated by its momentum; Radau, 1e-12."""
    from scipy.integrate import solve_ivp

    k, damping, l0, g = 8e5, 4e4, 0.5, 9.81
    thin, ball, slider = 0.3, 5.0, 3.0
    m, c = thin + ball, (0.5 * thin + ball) / (thin + ball)
    axial, across = thin * 1e-4 / 6, thin * (1 + 1e-4) / 12 + thin * (c - 0.5) ** 2 + ball * (1 - c) ** 2
    fixed = thin * 1e-4 / 6 + slider * 0.01 / 6

    def inertia(a: float) -> float:
        return fixed + 2 * (m * (0.05 + c * np.cos(a)) ** 2 + across * np.cos(a) ** 2 + axial * np.sin(a) ** 2)

    def slope(a: float) -> float:
        return 2 * (-2 * m * (0.05 + c * np.cos(a)) * c * np.sin(a) + (axial - across) * np.sin(2 * a))

    momentum = inertia(np.pi / 6) * 2 * np.pi
    hinge = across + m * c * c

    def rhs(t: float, y: np.ndarray) -> list[float]:
        a, s, av, sv = y
        d = np.array([0.5 * np.cos(a), 1 - 0.5 * np.sin(a) - s])
        length = np.sqrt(d @ d)
        da, ds = d @ [-0.5 * np.sin(a), -0.5 * np.cos(a)] / length, -d[1] / length
        tension = 2 * (k * (length - l0) + damping * (da * av + ds * sv))
        spin = momentum / inertia(a)
        force = 0.5 * spin**2 * slope(a) + 2 * m * g * c * np.cos(a) - tension * da
        return [av, sv, force / (2 * hinge), -g - tension * ds / slider]

    start = [np.pi / 6, 0.5, 0.0, 0.0]
    found = solve_ivp(rhs, (0, t_end), start, method="Radau", rtol=1e-11, atol=1e-13)
    return float(found.y[1, -1])


@pytest.mark.parametrize("t_end", [1.0])
def test_reference_of_the_governor(t_end: float) -> None:
    text = (ROOT / "demos/flyball.py").read_text()
    line = next(x for x in text.splitlines() if x.startswith("HEIGHT"))
    written = eval(line.split("=")[1].split("#")[0])  # noqa: S307
    assert abs(governor(t_end) - written[t_end]) < 1e-9
