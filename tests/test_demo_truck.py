"""The truck demo's checks, its rigid trajectory against nine coordinates, and what a settled start means."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import fmbd_fenicsx as fmbd

ROOT = Path(__file__).resolve().parents[1]
for folder in (ROOT / "demos", ROOT / "tests"):
    sys.path.insert(0, str(folder))
import truck_model as model  # noqa: E402
import truck_reference as nine  # noqa: E402


@pytest.fixture(autouse=True)
def _at_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


@pytest.mark.parametrize("pinned", [True, False])
def test_rigid_truck_follows_the_nine_coordinates(pinned: bool) -> None:
    scene = model.truck(model.rigid_load(), pinned=pinned)
    scene.sensor("load", fmbd.position(scene.bodies["load"]))
    run = fmbd.solve(scene, t_end=2.0, scheme=fmbd.Radau(rtol=1e-9), output=fmbd.Output(energy=False))
    p = nine.solve(2.0, [2.0], pinned, tolerance=1e-10)[0]
    assert run["cab"][-1, 1] == pytest.approx(p[4], abs=1e-9)
    assert run["chassis pitch"][-1, 0] == pytest.approx(p[2], abs=1e-9)
    assert run["load"][-1] == pytest.approx(p[6:8], abs=1e-9)


def test_pin_force_of_the_source() -> None:
    run = fmbd.solve(model.truck(model.rigid_load()), t_end=0.01, dt=0.01)
    assert run["pin"][0] == pytest.approx([0.0, -68056.2088888888], abs=1e-4)


@pytest.mark.mpi
def test_settled_start_of_the_elastic_loading_area_is_at_rest() -> None:
    """Before the hump nothing moves; without settling the loading area starts to swing at once."""
    load = model.elastic_load(h=0.75)
    still = fmbd.solve(model.truck(load), t_end=0.1, dt=0.01)
    assert np.abs(still["cab acceleration"]).max() < 1e-6
    assert np.ptp(still["stress"]) < 1e-6 * still["stress"].max()
    scene = model.truck(load)
    scene.settle = False
    assert np.abs(fmbd.solve(scene, t_end=0.1, dt=0.01)["cab acceleration"]).max() > 1e-3


def test_free_body_has_no_equilibrium() -> None:
    scene = fmbd.Scene("falls", gravity=(0, -9.81), settle=True)
    scene.add(fmbd.RigidBody("stone", 1.0, 1.0))
    with pytest.raises(fmbd.errors.ConvergenceError, match="No static equilibrium"):
        fmbd.solve(scene, t_end=1.0, dt=0.1)


def test_acceleration_sensor_is_the_second_derivative() -> None:
    """Of a point away from the centre, in a turning body, and of an elastic surface."""
    rod = fmbd.RigidBody("rod", 1.0, 0.1, (0.5, 0.0))
    scene = fmbd.Scene("pendulum", gravity=(0, -9.81))
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod, center=(0, 0)))
    scene.sensor("x", fmbd.position(rod, point=(1.0, 0.2)))
    scene.sensor("a", fmbd.acceleration(rod, point=(1.0, 0.2)))
    h = 1e-3
    run = fmbd.solve(scene, t_end=0.5, dt=h)
    x, a = run["x"], run["a"]
    assert (x[2:] - 2 * x[1:-1] + x[:-2])[20:] / h**2 == pytest.approx(a[21:-1], rel=1e-3, abs=1e-3)


@pytest.mark.slow
@pytest.mark.serial
def test_demo_fast(tmp_path: Path) -> None:
    import json
    import subprocess

    out = tmp_path / "out.json"
    command = [sys.executable, "demos/truck.py", "--fast", "--json", str(out)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr
    assert all(c["ok"] for c in json.loads(out.read_text())["check"])
