"""Results for other tools, and how runs, scenes and versions present themselves."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError


def swing() -> fmbd.Run:
    bob = fmbd.RigidBody("bob", 1.0, 0.1, position=(1.0, 0.0))
    scene = fmbd.Scene("pendulum", gravity=(0, -9.81))
    pin = fmbd.revolute("pin", fmbd.ground, bob, center=(0, 0))
    scene.add(bob, pin)
    scene.sensor("bob", fmbd.sensors.position(bob))
    scene.sensor("angle", fmbd.angle(pin))
    return fmbd.solve(scene, t_end=0.1, dt=0.01, output=fmbd.Output(snapshots=3))


def test_data_set_has_values_units_and_components(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    run = swing()
    data = run.to_xarray()
    assert np.array_equal(data["bob"].sel({"bob component": "y"}), run["bob"][:, 1])
    assert data["bob"].attrs["units"] == "m" and data["angle"].attrs["units"] == "rad" and data["angle"].ndim == 1
    assert data["time"].attrs["units"] == "s" and data["kinetic energy"].attrs["units"] == "J"
    assert data.attrs["scene"] == "pendulum"
    data.to_netcdf(tmp_path / "run.nc")
    assert np.array_equal(xarray.load_dataset(tmp_path / "run.nc")["bob"], run["bob"])


def test_table_has_a_column_for_each_component() -> None:
    pytest.importorskip("pandas")
    run = swing()
    table = run.to_pandas()
    assert list(table.columns[:3]) == ["bob x (m)", "bob y (m)", "angle (rad)"]
    assert np.array_equal(table["bob y (m)"], run["bob"][:, 1]) and np.array_equal(table.index, run.times)


@pytest.mark.parametrize("name", ["xarray", "pandas"])
def test_a_missing_library_is_named(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    run = swing()
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=f"with-dolfinx pip install {name}"):
        getattr(run, f"to_{name}")()


def test_runs_and_scenes_are_short() -> None:
    run = swing()
    assert repr(run) == (
        '<Run of "pendulum": generalized-alpha(rho_inf=0.8), 10 steps to t = 0.1 s, finished; sensors bob, angle; 3 snapshots>'
    )
    assert repr(run.scene) == '<Scene "pendulum": bodies bob; joints pin; sensors bob, angle>'
    assert repr(fmbd.Scene("bare")) == '<Scene "bare": empty>'
    assert "<pre>" in run._repr_html_() and "joints pin" in run.scene._repr_html_()


def test_studies_are_tables_in_notebooks() -> None:
    table = fmbd.study.OrderTable("h", np.array([0.2, 0.1]), {"<x>": np.array([4e-2, 1e-2])})
    assert repr(table) == "<OrderTable over h: <x>>"
    assert "<th>&lt;x&gt;</th>" in table._repr_html_() and "2.00" in table._repr_html_()


def test_versions_are_told_without_loading_libraries() -> None:
    text = fmbd.about()
    assert f"fmbd_fenicsx  {fmbd.__version__}" in text and f"numpy         {np.__version__}" in text
    if importlib.util.find_spec("dolfinx"):
        assert "not found" not in next(line for line in text.splitlines() if line.startswith("dolfinx"))


def test_showing_needs_a_screen_or_a_notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    run = swing()
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    if sys.platform != "darwin":
        with pytest.raises(InputError, match=r'animate\("run.html"\)'):
            run.show()
    monkeypatch.setitem(sys.modules, "ipykernel", object())
    shown = run.show(sensors="bob")
    assert "<iframe" in shown._repr_html_() and len(repr(shown)) < 60
