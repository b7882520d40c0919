"""The truck demo against nine coordinates, and what a settled start means. Its checks: tests/test_demos.py."""

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
    """The scene of bodies, joints and springs against nine coordinates by another method; rates against differences of these."""
    times, h = [0.0, 0.5, 1.0], 1e-3
    found = model.nine_coordinates(times, pinned=pinned)
    expected = nine.solve(1.0, [0.5 - h, 0.5, 0.5 + h, 1.0], pinned, tolerance=1e-10)
    assert found["times"] == pytest.approx(times)
    assert found["p"][0] == pytest.approx(nine.START, abs=1e-12)
    assert found["p"][1:] == pytest.approx(expected[[1, 3]], abs=2e-12)
    assert found["v"][1] == pytest.approx((expected[2] - expected[0]) / (2 * h), abs=1e-6)
    assert ("pin" in found) == pinned


def test_angular_velocity_is_the_rate_of_the_rotation() -> None:
    rod = fmbd.RigidBody("rod", 1.0, 0.1, (0.5, 0.0))
    scene = fmbd.Scene("pendulum", gravity=(0, -9.81))
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod, center=(0, 0)))
    scene.sensor("angle", fmbd.rotation(rod))
    scene.sensor("rate", fmbd.angular_velocity(rod))
    run = fmbd.solve(scene, t_end=0.2, dt=1e-3)
    middle = (run["angle"][2:] - run["angle"][:-2]) / 2e-3
    assert middle == pytest.approx(run["rate"][1:-1], abs=1e-4)


def test_pin_force_of_the_source() -> None:
    run = fmbd.solve(model.truck(model.rigid_load()), t_end=0.01, dt=0.01)
    assert run["pin"][0] == pytest.approx([0.0, -68056.2088888888], rel=1e-9, abs=1e-6)


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
