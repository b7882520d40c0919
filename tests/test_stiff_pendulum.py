"""A pendulum on a spring of stiffness 1 / eps^2: errors at h >> eps like those of a rod; back to the slow motion."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "demos"))
import stiff_pendulum as demo  # noqa: E402

STIFFNESS = (1e-1, 1e-2, 1e-4, 1e-6)
# scheme, largest position error over that at eps = 0.1, orders of position and velocity in the stiff limit. Three stages: the
# error at eps = 0.1 is that of order 5, at eps = 0.01 (h omega = 5, neither resolved nor stiff) it is 2.4 to 2.9 times as large.
SCHEMES: dict[str, tuple[Any, float, tuple[float, float]]] = {
    "generalized-alpha(0.8)": (fmbd.GeneralizedAlpha(0.8), 2.0, (2.0, 2.0)),
    "generalized-alpha(0)": (fmbd.GeneralizedAlpha(0.0), 2.0, (2.0, 2.0)),
    "BDF2": (fmbd.BDF(2, fmbd.Index3(), rtol=None), 2.0, (2.0, 2.0)),
    "Radau IIA(2)": (fmbd.Radau(2, rtol=None), 2.0, (3.0, 2.0)),
    "Radau IIA(3)": (fmbd.Radau(3, rtol=None), 3.0, (5.0, 3.0)),
}


@pytest.fixture(scope="module")
def exact() -> dict[float, tuple[np.ndarray, np.ndarray]]:
    return {eps: demo.reference(eps) for eps in (*STIFFNESS, 1e-3)}


@pytest.mark.parametrize("name", list(SCHEMES))
def test_position_errors_do_not_depend_on_the_stiffness(name: str, exact: dict[float, Any]) -> None:
    scheme, bar, _ = SCHEMES[name]
    errors = [demo.errors(scheme, eps, demo.H, exact[eps])[0] for eps in STIFFNESS]
    assert max(errors) <= bar * errors[0], errors


def test_three_stages_err_across_the_motion_only(exact: dict[float, Any]) -> None:
    """Along the motion the errors do not depend on eps. What is larger at eps = 0.01 is the stretch of the spring: the error of
    its force, of lower order, times the compliance eps^2.
    """
    found = {}
    for eps in STIFFNESS:
        run = fmbd.solve(
            demo.scene(eps), t_end=demo.T_END, dt=demo.H, scheme=fmbd.Radau(3, rtol=None), newton=demo.TIGHT
        )
        out = exact[eps][0] / np.linalg.norm(exact[eps][0])
        error = run["x"][-1] - exact[eps][0]
        found[eps] = abs(error @ [-out[1], out[0]]), abs(error @ out)
    assert max(along for along, _ in found.values()) <= 2.0 * found[0.1][0], found
    assert found[1e-2][1] / 1e-4 < 2e-4, found  # of the weight


@pytest.mark.parametrize("name", list(SCHEMES))
def test_order_in_the_stiff_limit(name: str, exact: dict[float, Any]) -> None:
    """h / eps = 50 and 25; the three-stage errors of 1e-9 and below are those of the stiff force's roundoff: velocities only."""
    scheme, _, (position, velocity) = SCHEMES[name]
    e = np.array([demo.errors(scheme, 1e-3, h, exact[1e-3]) for h in (demo.H, demo.H / 2)])
    order = np.log2(e[0] / e[1])
    assert order[1] > velocity - 0.2, e
    if position < 5.0:
        assert order[0] > position - 0.2, e
    else:
        assert e[1, 0] < 1e-9


@pytest.mark.parametrize("eps", [1e-2, 1e-4])
@pytest.mark.parametrize("name", list(SCHEMES))
def test_damped_schemes_return_to_the_slow_motion(name: str, eps: float) -> None:
    """Started with the spring stretched by 10 eps^2, ten times its static stretch; the vibration is gone at the end.

    rho_inf = 0.8 takes 200 steps at h omega = 5, where it damps less than at infinity.
    """
    x, v = demo.slow_start(eps)
    r = np.linalg.norm(x)
    scene = demo.scene(eps, (x * (r + 10 * eps**2) / r, v))
    scheme, t_end = SCHEMES[name][0], 10.0 if "0.8" in name else demo.T_END
    run = fmbd.solve(scene, t_end=t_end, dt=demo.H, scheme=scheme, newton=demo.TIGHT)
    stretch = (np.linalg.norm(run["x"], axis=1) - 1) / eps**2  # the tension, in units of the weight
    calm = fmbd.solve(demo.scene(eps), t_end=t_end, dt=demo.H, scheme=scheme, newton=demo.TIGHT)
    expected = (np.linalg.norm(calm["x"], axis=1) - 1) / eps**2
    assert stretch[0] > 10
    assert np.abs(stretch - expected)[-10:].max() < 0.1


@pytest.mark.parametrize("stiffness", [1e8, 1e10, 1e12])
def test_light_masses_on_a_stiff_spring_keep_turning(stiffness: float) -> None:
    """Grams on a spring of 0.1 m turn on at 5 rad/s from the first step: at the start their accelerations change at rates that
    differences along a parabola, on which the spring is longer, do not know."""
    scene = fmbd.Scene("thrown")
    bodies = [
        fmbd.RigidBody(name, mass=1e-3, inertia=1e-7, position=(x, 0.0), velocity=(0.0, 5.0 * x))
        for name, x in (("left", -0.05), ("right", 0.05))
    ]
    scene.add(*bodies, fmbd.Spring("spring", *bodies, stiffness=stiffness, length=0.1))
    scene.sensor("left", fmbd.velocity(bodies[0]))
    run = fmbd.solve(scene, t_end=2e-3, dt=1e-3)
    assert np.abs(np.linalg.norm(run["left"], axis=1) / 0.25 - 1.0).max() < 1e-4


@pytest.mark.parametrize("scheme", [fmbd.Radau(3, rtol=1e-7), fmbd.Radau(7, rtol=1e-9), fmbd.BDF(rtol=1e-7)], ids=str)
def test_a_spring_beside_which_masses_are_roundoff(scheme: Any) -> None:
    """Two masses swing as one on a spring of 1e-3 N/m, 1e15 between them: the end of the run was refused for want of mass."""
    scene, x = fmbd.Scene("row", gravity=(0.0, 0.0)), (1.0, 2.0)
    one, two = (fmbd.RigidBody(f"mass {i}", 1.0, 1.0, (x[i], 0.0)) for i in range(2))
    scene.add(
        one,
        two,
        *(fmbd.prismatic(f"way of {b.name}", fmbd.ground, b, axis=(1.0, 0.0), center=b.position) for b in (one, two)),
    )
    ends = {"point_a": (0.0, 0.0), "point_b": (1.0, 0.0)}
    scene.add(fmbd.Spring("soft", fmbd.ground, one, stiffness=1e-3, length=0.99, **ends))
    scene.add(fmbd.Spring("stiff", one, two, point_a=(1.0, 0.0), point_b=(2.0, 0.0), stiffness=1e15, length=1.0))
    scene.sensor("place", fmbd.position(two))
    scene.sensor("acceleration", fmbd.acceleration(two))
    omega = np.sqrt(1e-3 / 2.0)
    run = fmbd.solve(scene, t_end=4.0 * np.pi / omega, scheme=scheme, output=fmbd.Output(estimate_error=False))

    away = 0.01 * np.cos(omega * run.times)
    assert np.abs(run["place"][:, 0] - 1.99 - away).max() < 5e-6
    assert np.abs(run["acceleration"][-1, 0] + omega**2 * away[-1]) < 1e-2 * omega**2 * 0.01
