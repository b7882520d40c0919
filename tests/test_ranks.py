"""Counts of work, repeatability, and the same numbers on 1, 2 and 3 ranks."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from motion import elastic_rod
from programs import launch

import fmbd_fenicsx as fmbd

SCRIPT = """
import json, sys
import numpy as np
import fmbd_fenicsx as fmbd
from mpi4py import MPI

dim, frame = int(sys.argv[1]), sys.argv[2]
mesh = fmbd.read_gmsh("meshes/rod.py", dim=dim, h=0.15, height=0.3)
elastic = fmbd.materials.linear_elastic(5e6, 0.3)
kind = fmbd.MeanAxis() if frame == "mean" else fmbd.Attached("pin")
rod = fmbd.FloatingBody("rod", mesh, density=1000.0, elastic=elastic, frame=kind)
bob = fmbd.RigidBody("bob", 20.0, 0.5 if dim == 2 else (0.5, 0.4, 0.3), position=(1.2, 0.0, 0.0)[:dim])
scene = fmbd.Scene("ranks", gravity=(0, -9.81, 1.0)[:dim], gravity_ramp=0.1)
o, e = (0, 0, 0)[:dim], (1, 0, 0)[:dim]
pin = fmbd.revolute("pin", rod.surface("pin"), fmbd.ground, center=o)
scene.add(rod, bob, pin, fmbd.fixed("weld", rod.surface("tip"), bob, center=e))
scene.sensor("tip", fmbd.position(rod.surface("tip")))
scene.sensor("pin", fmbd.reaction("pin"))
run = fmbd.solve(scene, t_end=0.2, dt=4e-3, newton=fmbd.Newton(1e-8))
ranks = MPI.COMM_WORLD.allgather([run["tip"][-1].tolist(), run["pin"][-1].tolist(), run.state.lam.tolist()])
if MPI.COMM_WORLD.rank == 0:
    out = {"tip": run["tip"].tolist(), "pin": run["pin"].tolist(), "size": MPI.COMM_WORLD.size,
           "energy": {k: v.tolist() for k, v in run.energy.items()}, "counters": run.counters,
           "equal": all(r == ranks[0] for r in ranks)}
    print(json.dumps(out))
"""


def result(ranks: int, dim: int, frame: str) -> dict[str, Any]:
    """The figures of SCRIPT."""
    done = launch(SCRIPT, ranks, str(dim), frame)
    assert done.returncode == 0, done.stderr[-2000:]
    lines = [x for x in done.stdout.splitlines() if x.startswith("{")]
    assert len(lines) == 1
    return json.loads(lines[0])


@pytest.mark.serial
@pytest.mark.parametrize("dim, frame", [(2, "mean"), (3, "mean"), (2, "attached")])
def test_one_two_and_three_ranks_agree(dim: int, frame: str) -> None:
    one, two, three = (result(n, dim, frame) for n in (1, 2, 3))
    assert (one["size"], two["size"], three["size"]) == (1, 2, 3)
    for other in (two, three):
        assert other["equal"]  # replicated numbers: the same bits on all ranks
        for name in ("tip", "pin"):
            a, b = np.array(one[name]), np.array(other[name])
            assert np.abs(a - b).max() < 1e-9 * np.abs(a).max(), name
        for name, series in one["energy"].items():
            scale = max(np.abs(e).max() for e in one["energy"].values())
            assert np.abs(np.array(series) - other["energy"][name]).max() < 1e-9 * scale, name
        assert other["counters"]["newton_iterations"] == one["counters"]["newton_iterations"]
        assert other["counters"]["factorisations"] == one["counters"]["factorisations"]


@pytest.mark.serial
def test_a_second_serial_run_gives_the_same_bits() -> None:
    one, two = result(1, 3, "mean"), result(1, 3, "mean")
    one.pop("counters"), two.pop("counters")
    assert one == two


def pendulum(mesh: Any) -> fmbd.Scene:
    """A rod on a pin."""
    rod = elastic_rod(mesh)
    scene = fmbd.Scene("pendulum", gravity=(0, -9.81, 0)[: mesh.dim], gravity_ramp=0.1)
    scene.add(rod, fmbd.revolute("pin", rod.surface("pin"), fmbd.ground, center=(0, 0, 0)[: mesh.dim]))
    return scene


@pytest.mark.mpi
@pytest.mark.smoke
@pytest.mark.parametrize("dim", [2, 3])
def test_one_factorisation_and_few_back_solves(dim: int, rod_mesh: Callable[..., Any]) -> None:
    """One factor for the whole run; at most six back-solves a step with the default tolerance."""
    scene = pendulum(rod_mesh(dim=dim, h=0.15, height=0.3))
    run = fmbd.solve(scene, t_end=0.2, dt=2e-3)
    assert run.counters["factorisations"] == 1
    assert run.counters["back_solves_per_step"] <= 6
    short = fmbd.solve(scene, t_end=0.1, dt=2e-3)
    steps = run.counters["steps"] - short.counters["steps"]
    assert (run.counters["back_solves"] - short.counters["back_solves"]) / steps <= 6  # columns and start taken out
    assert run.counters["worst_linear_residual"] < 1e-10


@pytest.mark.smoke
@pytest.mark.mpi
def test_run_on_these_ranks_is_finite_and_closed(rod_mesh: Callable[..., Any]) -> None:
    run = fmbd.solve(pendulum(rod_mesh(dim=3, h=0.15, height=0.3)), t_end=0.05, dt=2e-3)
    assert run.drift[0] < 1e-10
    assert all(np.isfinite(e).all() for e in run.energy.values())


@pytest.mark.mpi
def test_more_ranks_than_cells(rod_mesh: Callable[..., Any]) -> None:
    """A mesh of a few cells leaves ranks with little or nothing."""
    run = fmbd.solve(pendulum(rod_mesh(dim=2, h=1.0, height=0.9)), t_end=0.02, dt=2e-3)
    assert run.drift[0] < 1e-10
