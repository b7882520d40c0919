"""The slider crank demo, and the derivatives that its model gives by hand."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fmbd_fenicsx.mechanics.coordinates import PortConstraint, derivative

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "demos"))
import crank_model as model  # noqa: E402


def test_derivatives_of_the_constraints() -> None:
    y, v = np.array([1.0, -0.4, 0.3, 1e-3, 2e-3, 1e-4, 2e-4]), np.arange(1.0, 8.0)
    assert model.jacobian(y, 0.1) == pytest.approx(derivative(lambda z: model.constraints(z, 0.1), y), abs=1e-14)
    differences = PortConstraint("crank", 0, model.constraints).gamma(y, v, 0.1)
    assert model.gamma(y, v, 0.1) == pytest.approx(differences, rel=1e-8, abs=1e-8)


@pytest.mark.serial
@pytest.mark.parametrize("flags", [["--fast"], pytest.param([], marks=pytest.mark.slow)])
def test_demo(flags: list[str], tmp_path: Path) -> None:
    out = tmp_path / "out.json"
    command = [sys.executable, "demos/slider_crank.py", "--json", str(out), *flags]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=590)
    assert done.returncode == 0, done.stdout + done.stderr
    assert all(c["ok"] for c in json.loads(out.read_text())["check"])
