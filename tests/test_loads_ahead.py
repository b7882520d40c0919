"""Loads that come while nothing happens: steps of own choice end there, none passes over them, and what is stated is true."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import erf

import fmbd_fenicsx as fmbd

MESHES = Path(__file__).resolve().parents[1] / "meshes"
T_END, COMES, WIDTH, PUSH = 1.2, 0.5, 0.02, 3.0
TIMES = tuple(float(t) for t in np.linspace(0.0, T_END, 13))
OWN_STEPS = [fmbd.Radau(3, rtol=1e-5), fmbd.BDF(rtol=1e-5), fmbd.HalfExplicit(1e-5), fmbd.ExplicitRungeKutta(1e-5)]


def knocked(width: float = WIDTH) -> fmbd.Scene:
    """A body at rest on a guide is knocked for some hundredths of a second: m x'' = p / w exp(-((t - t_0) / w)^2)."""
    scene = fmbd.Scene("knocked")
    body = fmbd.RigidBody("body", 2.0, 0.1, (0.0, 0.0))
    scene.add(body, fmbd.prismatic("guide", fmbd.ground, body, axis=(1, 0), center=(0, 0)))
    scene.add(fmbd.force("knock", body, lambda t: (PUSH / width * np.exp(-(((t - COMES) / width) ** 2)), 0.0)))
    scene.sensor("place", fmbd.position(body))
    return scene


def gone(times: Any, width: float = WIDTH) -> Any:
    """How far the body is: the force integrated twice, from t = -infinity."""
    x = (np.asarray(times) - COMES) / width
    return 0.5 * PUSH / 2.0 * width * (np.sqrt(np.pi) * x * (1.0 + erf(x)) + np.exp(-x * x))


@pytest.mark.parametrize("scheme", OWN_STEPS, ids=lambda x: x.name)
def test_no_step_passes_over_a_knock(scheme: Any) -> None:
    """The whole run was one step, or five of BDF, with any tolerance: off by all that the body does, and BDF stated nothing."""
    run = fmbd.solve(knocked(), t_end=T_END, scheme=scheme, output=fmbd.Output(times=TIMES, estimate_error=True))
    exact = gone(run.times)
    off = float(np.abs(run["place"][:, 0] - exact).max())
    assert off < 1e-3 * np.ptp(exact)
    assert 0.5 < run.certificate["place"].total / off < 3.0


@pytest.mark.parametrize("scheme", OWN_STEPS[:2], ids=lambda x: x.name)
def test_a_tolerance_is_kept_where_a_knock_comes(scheme: Any) -> None:
    """A share of the range of a sensor that has not moved allows all: the first run was taken."""
    run = fmbd.solve(
        knocked(), t_end=T_END, scheme=scheme, output=fmbd.Output(times=TIMES), tol={"place": fmbd.relative(1e-4)}
    )
    exact = gone(run.times)
    assert run.history[-1].then == "done"
    assert np.abs(run["place"][:, 0] - exact).max() < 1e-4 * np.ptp(exact)


def test_a_knock_on_finite_elements_is_seen() -> None:
    """One step was made of it, too."""
    pytest.importorskip("dolfinx")
    from fmbd_fenicsx.materials import linear_elastic

    mesh = fmbd.read_gmsh(MESHES / "rod.py", dim=2, h=0.5, height=0.1)
    rod = fmbd.FloatingBody(
        "rod", mesh, degree=1, density=1000.0, elastic=linear_elastic(1e8, 0.3), stiffness_damping=1e-3
    )
    scene = fmbd.Scene("knocked rod")
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
    scene.add(fmbd.force("knock", rod.surface("tip"), lambda t: (0.0, 30.0 * np.exp(-(((t - 0.5) / 0.02) ** 2)))))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))

    ends = [
        fmbd.solve(scene, t_end=1.0, scheme=scheme, output=fmbd.Output(times=TIMES[:10]))["tip"][-1, 1]
        for scheme in (fmbd.Radau(2, rtol=1e-4), fmbd.GeneralizedAlpha(rtol=1e-5))
    ]
    assert ends[1] > 1e-3 and ends[0] == pytest.approx(ends[1], rel=2e-2)


def test_what_changes_all_the_time_has_no_marks() -> None:
    """Steps follow loads that never rest by their error alone: they are those of a run that does not look ahead."""
    from fmbd_fenicsx.run.loads_ahead import seeing_loads
    from fmbd_fenicsx.run.schedule import step_schedule

    def marks(law: Any) -> tuple[float, ...]:
        scene = fmbd.Scene("pushed")
        body = fmbd.RigidBody("body", 2.0, 0.1, (0.0, 0.0))
        scene.add(body, fmbd.force("push", body, lambda t: (law(t), 0.0)))
        system, state, _ = scene.build()
        scheme = OWN_STEPS[0]
        schedule = step_schedule(scene, scheme, T_END, None)
        return seeing_loads(schedule, scheme, scene, system, state).marks

    assert marks(lambda t: np.sin(9.0 * t)) == ()
    rises = marks(lambda t: max(t - 0.3, 0.0))
    assert len(rises) == 1 and 0.3 < rises[0] < 0.32


def test_loads_may_begin_below_the_smallest_number() -> None:
    """exp(-x^2) begins with numbers that have lost their digits: no balance, and no linear solve, is as near to them as others.

    "The initial deformation is too large" was said of it, and that a body is not held.
    """
    run = fmbd.solve(knocked(0.01), t_end=T_END, scheme=fmbd.Radau(5, rtol=1e-9), output=fmbd.Output(times=TIMES))
    assert run["place"][-1, 0] == pytest.approx(gone(T_END, 0.01), rel=1e-6)
