"""The slider crank with a rod of finite elements: its parts, on any number of ranks. The demo's checks: tests/test_demos.py."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("dolfinx")
import fmbd_fenicsx as fmbd

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "demos"))
import crank_fe_model as fe  # noqa: E402


def test_run_up_has_these_rates_and_ends_after_one_turn() -> None:
    h = 1e-6
    for t in (0.3 * fe.RAMP, 0.9 * fe.RAMP, 1.1 * fe.RAMP):
        (a, *_), (_, v, w), (b, *_) = (fe.run_up(t + k * h) for k in (-1, 0, 1))
        assert (b - a) / (2 * h) == pytest.approx(v, rel=1e-6)
        assert (fe.run_up(t + h)[1] - fe.run_up(t - h)[1]) / (2 * h) == pytest.approx(w, rel=1e-6, abs=1e-3)
    assert fe.run_up(fe.RAMP)[0] == pytest.approx(2 * np.pi)
    assert fe.run_up(0.999999 * fe.RAMP)[0] == pytest.approx(2 * np.pi, rel=1e-5)


@pytest.mark.parametrize("dim", [pytest.param(2, marks=pytest.mark.mpi), 3])
def test_reduced_rod_follows_the_floating_one(dim: int) -> None:
    """Same motion of the edges and nearly the same force of the knee; the same bits on all ranks."""
    rod = fe.rod(0.032, 0.032, dim)
    full, few = (
        fmbd.solve(fe.scene(body), t_end=0.02, dt=4e-4, output=fmbd.Output(energy=False))
        for body in (rod, fe.reduced(rod, 4))
    )
    assert few["side"] == pytest.approx(full["side"], abs=2e-8)
    assert few["knee force"] == pytest.approx(full["knee force"], rel=1e-3, abs=1e-2)
    assert np.abs(full["side"][:, 1]).max() > 1e-3
    if full.system.comm is not None:
        everywhere = full.system.comm.allgather(full["side"].tolist())
        assert all(x == everywhere[0] for x in everywhere)


@pytest.mark.mpi
def test_bores_are_named_where_they_are() -> None:
    import ufl
    from dolfinx import fem

    mesh = fmbd.read_gmsh(fe.ROD, height=0.02, h=0.005)
    ds = ufl.Measure("ds", domain=mesh.dolfinx, subdomain_data=mesh.facet_tags)
    x = ufl.SpatialCoordinate(mesh.dolfinx)
    one = fem.Constant(mesh.dolfinx, 1.0)

    def integral(f: object, name: str) -> float:
        value = fem.assemble_scalar(fem.form(f * ds(mesh.surface_tag(name))))
        return float(sum(mesh.dolfinx.comm.allgather(value)))

    for name, at in (("bore a", 0.15), ("bore b", 0.45)):
        assert integral(one, name) == pytest.approx(np.pi * 0.01, rel=1e-2)
        assert integral(x[0], name) / integral(one, name) == pytest.approx(at, abs=1e-6)
    assert integral(one, "side") == pytest.approx(0.6)


@pytest.mark.parametrize("scheme", [fmbd.Radau(3, rtol=None), fmbd.BDF(2, rtol=None)], ids=["Radau", "BDF"])
@pytest.mark.parametrize("modes", [pytest.param(0, marks=pytest.mark.mpi), 4], ids=["floating", "reduced"])
def test_places_within_steps_are_as_good_as_at_their_ends(modes: int, scheme: Any) -> None:
    """The crank is turned to its angle by what bends the rod least; by the masses alone it dented the rod at its bore, and the
    edges were off by ten to three hundred times the errors at the ends.
    """
    rod = fe.rod(0.032, 0.032)
    body = fe.reduced(rod, modes) if modes else rod
    steps, end = (12, 1) if isinstance(scheme, fmbd.Radau) else (60, 3)
    times = np.linspace(0.0, fe.RAMP, 4 * steps + 1)

    def side(n: int, scheme: Any) -> np.ndarray:
        output = fmbd.Output(times=tuple(times), energy=False, progress=False)
        return np.asarray(
            fmbd.solve(fe.scene(body), t_end=fe.RAMP, dt=fe.RAMP / n, scheme=scheme, output=output)["side"]
        )

    error = np.abs(side(steps, scheme) - side(8 * steps // end, fmbd.Radau(3, rtol=None))).max(axis=1)
    assert error.max() < 3.0 * error[::4].max(), (error.max(), error[::4].max())
