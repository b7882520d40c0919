"""What increments of a step tell of the terms that its tangent leaves out: soft blades that turn fast in frames at an end."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.schemes.onestep.alpha.secants import DEPTH, Secants

SPIN = 25.0  # rad/s


def blade(mesh: Any, *, reduced: bool, held: bool = True) -> fmbd.Scene:
    """A blade of 1 m that spins about an end, in a frame at this end, stiffened by its inertia forces; or that flies."""
    d = mesh.dim
    spin, speed = (SPIN, (0.0, 0.5 * SPIN)) if d == 2 else ((0.0, 0.0, SPIN), (0.0, 0.5 * SPIN, 0.0))
    soft = fmbd.materials.plane_stress(1e8, 0.3) if d == 2 else fmbd.materials.linear_elastic(1e8, 0.3)
    body = fmbd.FloatingBody(
        "blade", mesh, density=1000.0, elastic=soft, frame=fmbd.Attached("pin"), stiffening=True,
        velocity=speed, angular_velocity=spin,
    )  # fmt: skip
    body = body.reduced(modes=6) if reduced else body
    scene = fmbd.Scene("blade", gravity=(0.0, -9.81, 0.0)[:d])
    scene.add(body)
    if held:
        joint = fmbd.revolute if d == 2 else fmbd.spherical
        scene.add(joint("pin", fmbd.ground, body.surface("pin"), center=(0.0,) * d))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return scene


def turned(scene: fmbd.Scene, degrees: float, steps: int, **how: Any) -> tuple[float, Any]:
    """Iterations a step and the run, at so many degrees a step."""
    run = fmbd.solve(scene, t_end=steps * np.radians(degrees) / SPIN, dt=np.radians(degrees) / SPIN, **how)
    return run.counters["newton_iterations"] / run.counters["steps"], run


@pytest.mark.parametrize("form", [fmbd.Index3(), fmbd.GGL()], ids=["index 3", "GGL"])
def test_a_fast_blade_takes_few_iterations_and_no_halves(rod_mesh: Callable[..., Any], form: Any) -> None:
    """Without pairs 79 iterations a step, and 42 halvings. Compiled and NumPy: the same iterations."""
    counts, ends = [], []
    for compiled in (True, False):
        scene = blade(rod_mesh(dim=2, h=0.1, height=0.04), reduced=True)
        each, run = turned(scene, 3.0, 12, scheme=fmbd.GeneralizedAlpha(0.8, compiled=compiled, form=form))
        counts.append(each)
        ends.append(run["tip"][-1])
        assert run.counters.get("halved_steps", 0) == 0
    assert counts[0] == counts[1] <= 8.0
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-9)


def test_in_space_and_as_a_field(rod_mesh: Callable[..., Any]) -> None:
    """27 iterations a step in space, 87 and 55 factors a step as a field of the plane, without pairs."""
    each, run = turned(blade(rod_mesh(dim=3, h=0.25, height=0.04), reduced=True, held=False), 6.0, 6)
    assert each <= 9.0 and run.counters.get("halved_steps", 0) == 0

    each, run = turned(blade(rod_mesh(dim=2, h=0.1, height=0.04), reduced=False), 3.0, 6)
    assert each <= 9.0 and run.counters.get("halved_steps", 0) == 0
    assert run.counters["factorisations"] <= 6


def test_the_motion_is_that_of_the_exact_tangent(rod_mesh: Callable[..., Any]) -> None:
    """The equations are the same: only increments differ."""
    ends = []
    for tangent in (None, fmbd.ExactTangent()):
        scene = blade(rod_mesh(dim=2, h=0.1, height=0.04), reduced=True)
        ends.append(turned(scene, 2.0, 6, newton=fmbd.Newton(1e-9, 40, tangent=tangent))[1]["tip"][-1])
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-7)


@pytest.mark.mpi
def test_two_ranks_take_the_same_iterations(rod_mesh: Callable[..., Any]) -> None:
    """Products are summed over ranks."""
    each, run = turned(blade(rod_mesh(dim=2, h=0.1, height=0.04), reduced=False), 3.0, 2)
    assert each <= 9.0 and run.counters.get("halved_steps", 0) == 0


def test_pairs_solve_a_linear_system_in_as_many_increments_as_it_has_directions() -> None:
    """The tangent misses two directions by far: four increments where the iteration of the tangent diverges."""
    rng = np.random.default_rng(1)
    n = 7
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    J = Q @ np.diag((9.0, -4.0, *np.ones(n - 2))) @ Q.T
    b = rng.standard_normal(n)
    system: Any = SimpleNamespace(
        units=np.full(n, 2.0),
        n_v=n,
        dot=lambda x, y: float(x @ y),
        max_abs=lambda x: float(np.abs(2.0 * x).max()),
    )
    pairs, x = Secants(system), np.zeros(n)
    for _ in range(4):
        x = x + pairs.improved(b - J @ x, 1)
    assert np.abs(J @ x - b).max() < 1e-9
    assert len(pairs.pairs) <= 3 < DEPTH
