"""The exact tangent of a step (item by item against the frozen one), and the moments of a bent body that the frozen one has."""

from __future__ import annotations

import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from programs import launch

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.mechanics.elastic.floating import FloatingField
from fmbd_fenicsx.schemes.exact_tangent import exact_increment
from fmbd_fenicsx.schemes.newton import ExactTangent, Newton


def pendulum(mesh: Any, modulus: float = 1e8, **changes: Any) -> fmbd.Scene:
    """A soft rod on a spherical joint, with spin about its own axis free, and a rigid bob on a pin at its end."""
    elastic = fmbd.materials.linear_elastic(modulus, 0.3)
    rod = fmbd.FloatingBody("rod", mesh, density=1000.0, elastic=elastic, **changes)
    bob = fmbd.RigidBody("bob", 2.0, (0.01, 0.02, 0.015), position=(1.0, 0.1, 0.0))
    scene = fmbd.Scene("soft rod", gravity=(0.0, 1.0, -9.81))
    scene.add(rod, bob, fmbd.spherical("pin", rod.surface("pin"), fmbd.ground))
    scene.add(fmbd.spherical("bob on rod", rod.surface("tip"), bob, center=(1.0, 0.0, 0.0)))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    return scene


def recorded(monkeypatch: pytest.MonkeyPatch) -> list[list[float]]:
    """Newton's histories of all steps to come."""
    histories: list[list[float]] = []
    plain = Newton.solve

    def solve(self: Newton, *given: Any, **more: Any) -> tuple[bool, list[float]]:
        converged, history = plain(self, *given, **more)
        histories.append(history)
        return converged, history

    monkeypatch.setattr(Newton, "solve", solve)
    return histories


@pytest.mark.parametrize("frame, most, before", [("mean axis", 4, 4.0), ("attached", 5, 7.0)])
def test_exact_tangent_is_quadratic_and_gives_the_same_motion(
    rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, frame: str, most: int, before: float
) -> None:
    """Steps of 0.02 s on a rod that bends by a tenth of its length."""
    kind = fmbd.MeanAxis() if frame == "mean axis" else fmbd.Attached("pin")
    histories, runs = recorded(monkeypatch), []
    for tangent in (None, fmbd.ExactTangent()):
        histories.clear()
        scene = pendulum(rod_mesh(dim=3, h=0.25), frame=kind)
        newton = fmbd.Newton(1e-9, max_iterations=40, tangent=tangent)
        runs.append(fmbd.solve(scene, t_end=0.4, dt=0.02, newton=newton))
        counts = [len(x) for x in histories]
    # most steps of the frozen tangent are compiled, without histories
    frozen = runs[0].counters["newton_iterations"] / runs[0].counters["steps"]
    assert frozen > before and max(counts) <= most
    rates = np.array([(x[-1] / x[-2], x[-2] / x[-3]) for x in histories if len(x) > 2])
    assert np.median(rates[:, 0]) < 1e-3 and np.median(rates[:, 0] / rates[:, 1]) < 0.05  # rates fall: no fixed one
    assert runs[1].counters["tangent_iterations"] > 0 and "tangent_iterations" not in runs[0].counters
    assert runs[1].counters["factorisations"] == 1
    assert np.abs(runs[1]["tip"] - runs[0]["tip"]).max() < 1e-8


def test_rigid_bodies_take_it_too() -> None:
    """A top that spins fast: gyroscopic terms are most of what the frozen tangent lacks."""
    ends, means = [], []
    for tangent in (None, fmbd.ExactTangent()):
        top = fmbd.RigidBody(
            "top", 1.0, (0.01, 0.01, 0.02), position=(0.0, 0.2, 0.3), angular_velocity=(0.0, 1.0, 60.0)
        )
        scene = fmbd.Scene("top", gravity=(0, 0, -9.81))
        scene.add(top, fmbd.spherical("tip", top, fmbd.ground, center=(0, 0, 0)))
        scene.sensor("top", fmbd.position(top))
        newton = fmbd.Newton(1e-9, max_iterations=40, tangent=tangent)
        run = fmbd.solve(scene, t_end=0.2, dt=4e-3, newton=newton)
        ends.append(run["top"])
        means.append(run.counters["newton_iterations"] / run.counters["steps"])
    assert means[1] <= 3.0 < means[0]
    assert np.abs(ends[1] - ends[0]).max() < 1e-9


SCRIPT = """
import json, sys
sys.path.insert(0, "tests")
import fmbd_fenicsx as fmbd
from mpi4py import MPI
from test_exact_tangent import pendulum
mesh = fmbd.read_gmsh("meshes/rod.py", dim=3, h=0.25)
newton = fmbd.Newton(1e-9, tangent=fmbd.ExactTangent())
run = fmbd.solve(pendulum(mesh), t_end=0.1, dt=0.02, newton=newton)
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps({"tip": run["tip"].tolist(), "steps": run.counters["newton_iterations"]}))
"""


@pytest.mark.serial
def test_one_and_two_ranks_agree() -> None:
    found = []
    for ranks in (1, 2):
        done = launch(SCRIPT, ranks)
        assert done.returncode == 0, done.stderr[-2000:]
        found.append(json.loads(done.stdout.splitlines()[-1]))
    assert found[0]["steps"] == found[1]["steps"]
    assert np.abs(np.subtract(found[0]["tip"], found[1]["tip"])).max() < 1e-9


def test_other_schemes_refuse_it() -> None:
    newton = fmbd.Newton(tangent=fmbd.ExactTangent())
    scene = fmbd.Scene("ball")
    scene.add(fmbd.RigidBody("ball", 1.0, (1.0, 1.0, 1.0)))
    for scheme in (fmbd.BDF(), fmbd.GeneralizedAlpha(form=fmbd.GGL())):
        with pytest.raises(InputError, match="exact tangent"):
            fmbd.solve(scene, t_end=0.1, dt=0.01, scheme=scheme, newton=newton)
    with pytest.raises(InputError, match="rtol"):
        fmbd.ExactTangent(rtol=1e-9)


@pytest.mark.parametrize("compiled", [True, False])
def test_a_bent_rod_takes_two_iterations(
    rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, compiled: bool
) -> None:
    """Field increments turn a bent rod about its light axis: left out, a third iteration is spent on most steps."""

    def iterations() -> float:
        scene = pendulum(rod_mesh(dim=3, h=0.25, height=0.05))
        scheme = fmbd.GeneralizedAlpha(0.8, compiled=compiled)
        run = fmbd.solve(scene, t_end=0.2, dt=2e-3, scheme=scheme)
        return run.counters["newton_iterations"] / run.counters["steps"]

    assert iterations() <= 2.2
    if not compiled:
        monkeypatch.setattr(FloatingField, "missing_momentum", lambda self, u: None)
        assert iterations() > 2.4


def test_the_increment_of_a_linear_system_solves_it() -> None:
    """From a preconditioner with another stiffness: increments and multipliers of [K, G^T; G, 0]."""
    rng = np.random.default_rng(2)
    n, m = 6, 2
    K = rng.standard_normal((n, n)) + 8.0 * np.eye(n)
    G, b, c = rng.standard_normal((m, n)), rng.standard_normal(n), rng.standard_normal(m)
    rough = np.block([[np.diag(np.diag(K)), G.T], [G, np.zeros((m, m))]])

    def solve(r: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = np.linalg.solve(rough, np.concatenate((r, g)))
        return found[:n], found[n:]

    system: Any = SimpleNamespace(units=np.ones(n), length=1.0, dot=np.dot, max_abs=lambda x: float(np.abs(x).max()))
    tangent = ExactTangent(rtol=1e-7, max_iterations=12)
    dq, dlam, count = exact_increment(tangent, system, solve, lambda d: (K @ d - b, G @ d - c), (b, c))
    assert K @ dq + G.T @ dlam == pytest.approx(b, abs=1e-6) and G @ dq == pytest.approx(c, abs=1e-6)
    assert 1 < count <= n
