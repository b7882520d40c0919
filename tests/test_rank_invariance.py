"""The same figures on 1 and 2 ranks for every kind of tie and joint; ``docs/traces.md`` has the table for 1, 2, 3 and 6."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from programs import ROOT, launch
from rank_scenes import LAW, SCENES, largest_difference

import fmbd_fenicsx as fmbd


@pytest.mark.serial
def test_two_ranks_give_the_figures_of_one() -> None:
    """Positions, multipliers and energies, over the whole run."""
    code = (ROOT / "tests/rank_scenes.py").read_text().replace("__file__", repr(str(ROOT / "tests/rank_scenes.py")))
    one, two = (json.loads(launch(code, n, timeout=300).stdout.splitlines()[-1]) for n in (1, 2))
    for name in SCENES:
        assert largest_difference(one[name], two[name]) < 1e-9, name
        assert max(one[name]["energy"]) > 0, name


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("made", "scheme"),
    [
        (lambda body: body, fmbd.GeneralizedAlpha(0.8)),
        (lambda body: body.with_(frame=fmbd.Attached("left"), stiffening=True), fmbd.GeneralizedAlpha(0.8)),
        (
            lambda body: body.with_(stiffening="left", loads=[fmbd.pressure("right", 0.1)]),
            fmbd.GeneralizedAlpha(0.8),
        ),
        (lambda body: body.reduced(modes=3), fmbd.GeneralizedAlpha(0.8)),
        (lambda body: fmbd.AbsoluteBody("one", body.mesh, density=1.0, elastic=LAW), fmbd.Radau(rtol=None)),
    ],
    ids=["floating", "stiffened", "pressed", "modes", "absolute, Radau"],
)
def test_ranks_that_hold_nothing_of_a_body_go_along(made: Callable[..., Any], scheme: Any) -> None:
    """A body of one cell."""
    from mpi4py import MPI

    tips = []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.5), counts=(1, 1), quads=True, comm=comm)
        body = made(fmbd.FloatingBody("one", mesh, degree=1, density=1.0, elastic=LAW))
        scene = fmbd.Scene("swing", gravity=(0.0, -9.81))
        scene.add(body, fmbd.revolute("pin", body.surface("left"), fmbd.ground, center=(0.0, 0.25)))
        scene.sensor("tip", fmbd.position(body.surface("right")))
        scene.sensor("strain", fmbd.sensors.strain(body, point=(0.6, 0.2)))
        run = fmbd.solve(scene, t_end=0.02, dt=0.005, scheme=scheme, newton=fmbd.Newton(1e-10))
        tips.append({name: run[name] for name in run.series})
    assert largest_difference(*tips) < 1e-8
    assert np.ptp(tips[0]["strain"]) > 0
