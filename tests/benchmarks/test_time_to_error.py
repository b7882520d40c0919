"""The table of CPU times to an error: its scenes are the published problems, and nobody is faster at the rigid crank."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fmbd_fenicsx as fmbd

HERE = Path(__file__).parent
PLACES = [str(HERE), str(HERE.parents[1] / "demos"), str(HERE.parent)]
sys.path[:0] = PLACES

import ida_equations  # noqa: E402
import mechanisms_of_bodies as bodies  # noqa: E402
import time_to_error  # noqa: E402


@pytest.mark.parametrize("name", ["Andrews' mechanism", "car axis"])
def test_rigid_bodies_are_the_published_problem(name: str) -> None:
    make, coordinates = time_to_error.SCENES[name]
    run = fmbd.solve(make(), t_end=time_to_error.PROBLEMS[name].t_end, scheme=fmbd.ExplicitRungeKutta(1e-8))
    assert time_to_error.error_of(name, coordinates(run.state.q)) < 1e-8


@pytest.mark.parametrize("name", ida_equations.four())
@pytest.mark.parametrize("form", ida_equations.FORMS)
def test_equations_of_the_neighbour_have_their_own_jacobian(name: str, form: str) -> None:
    """dF/dy + c dF/dy' against central differences, at the start, and a residual of zero there."""
    residual = ida_equations.Residual(ida_equations.four()[name](), form, 10.0)
    y, rate = residual.begin()
    n, c = len(y), 1e3
    start = residual.many(0.0, y[:, None], rate[:, None])[:, 0]
    found = np.zeros((n, n))
    residual.jacobian(0.0, y, rate, start, c, found)

    steps = 1e-6 * np.maximum(np.abs(y), 1e-3)
    ends = (
        residual.many(0.0, y[:, None] + s * np.diag(steps), rate[:, None] + s * c * np.diag(steps)) for s in (1, -1)
    )
    central = np.subtract(*ends) / (2 * steps)
    assert np.abs(start).max() <= 1e-9 * max(np.abs(rate).max(), 1.0)
    assert np.abs(found - central).max() <= 1e-4 * np.abs(central).max()


def test_places_of_the_bodies_are_those_of_the_coordinates() -> None:
    places, _ = bodies.andrews_places()
    q = np.concatenate([(*place, angle) for place, angle in places])
    assert bodies.andrews_coordinates(q) == pytest.approx(bodies.a.START, abs=1e-14)


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.skipif(importlib.util.find_spec("sksundae") is None, reason="no scikit-sundae in this interpreter")
def test_the_rigid_crank_is_nowhere_slower_than_its_neighbours() -> None:
    """To 1e-6 and 1e-9, there within 0.15 of IDA's time; the exit code tells."""
    command = [sys.executable, time_to_error.__file__, "--only", "slider crank"]
    places = {"PYTHONPATH": os.pathsep.join([*PLACES, *sys.path])}
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False, env=os.environ | places)
    assert done.returncode == 0, done.stdout
    assert "explicit Runge-Kutta" in done.stdout
