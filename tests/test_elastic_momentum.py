"""Energy-momentum scheme of elastic bodies: energy and momenta for any step, order, refusals."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.materials import linear_elastic, neo_hookean, saint_venant_kirchhoff
from fmbd_fenicsx.system.compiled import choice

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def ring() -> Any:
    return fmbd.read_gmsh(ROOT / "meshes/ring.py", h=0.35, width=0.3)


def spinning(mesh: Any, energy: Any, **changes: Any) -> fmbd.Scene:
    body = fmbd.AbsoluteBody(
        "ring",
        mesh,
        density=1.0,
        energy=energy,
        quadrature=4,
        velocity=(0.2, 0.1),
        angular_velocity=1.0,
        displacement_rate=lambda X: 0.1 * np.array([X[0], -X[1]]),
    ).with_(**changes)
    scene = fmbd.Scene("ring")
    scene.add(body)
    return scene


def invariants(run: fmbd.Run) -> tuple[Any, Any, Any]:
    p, spin = run.system.at(run.state.t, run.state.q, run.state.v).momenta()
    return sum(run.energy.values()), p, spin


@pytest.mark.mpi
@pytest.mark.parametrize("material", [saint_venant_kirchhoff, neo_hookean])
@pytest.mark.parametrize("modulus, h", [(1e4, 0.05), (1e4, 0.2), (1e4, 0.5), (1e6, 0.1), (1e6, 0.5)])
def test_energy_and_momenta(ring: Any, material: Any, modulus: float, h: float) -> None:
    """Kept to 1e-9 at steps up to 500 times the first period's fraction, where the trapezoid rule blows up."""
    scene = spinning(ring, material(modulus, 0.3))
    run = fmbd.solve(scene, t_end=20 * h, dt=h, scheme=fmbd.EnergyMomentum())
    short = fmbd.solve(scene, t_end=h, dt=h, scheme=fmbd.EnergyMomentum())
    energy, p, spin = invariants(run)
    _, p0, spin0 = invariants(short)
    assert np.abs(energy / energy[0] - 1).max() < 1e-9
    assert run.energy["elastic"].max() > 1e-5
    np.testing.assert_allclose(p, p0, rtol=1e-9)
    np.testing.assert_allclose(spin, spin0, rtol=1e-9)


def test_second_order(rod_mesh: Callable[..., Any]) -> None:
    """Against a fine run the error of position and velocity falls like h^2."""
    body = fmbd.AbsoluteBody(
        "rod",
        rod_mesh(dim=2, h=0.5, height=0.2),
        degree=1,
        density=1.0,
        energy=saint_venant_kirchhoff(2.0, 0.3),
        angular_velocity=1.0,
        displacement_rate=lambda X: 0.3 * np.array([0 * X[0], (X[0] - 0.5) ** 2]),
    )
    scene = fmbd.Scene("rod", gravity=(0.0, -1.0))
    scene.add(body)

    def end(h: float) -> Any:
        run = fmbd.solve(scene, t_end=0.1, dt=h, scheme=fmbd.EnergyMomentum())
        return np.concatenate((run.state.q, run.state.v))

    exact = end(2.5e-4)
    errors = [np.abs(end(h) - exact).max() for h in (4e-3, 2e-3, 1e-3)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders.min() > 1.9


def test_three_dimensions(rod_mesh: Callable[..., Any]) -> None:
    """A tumbling bar in space keeps all invariants."""
    body = fmbd.AbsoluteBody(
        "bar",
        rod_mesh(dim=3, h=0.5, height=0.2),
        degree=1,
        density=1.0,
        energy=neo_hookean(1e4, 0.3),
        angular_velocity=(0.1, 2.0, 1.0),
    )
    scene = fmbd.Scene("bar")
    scene.add(body)
    runs = [fmbd.solve(scene, t_end=t, dt=0.1, scheme=fmbd.EnergyMomentum()) for t in (0.1, 1.0)]
    (_, p0, spin0), (energy, p, spin) = (invariants(r) for r in runs)
    assert np.abs(energy / energy[0] - 1).max() < 1e-9
    np.testing.assert_allclose(spin, spin0, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(p, p0, atol=1e-12)


def bar(mesh: Any, name: str = "bar", modulus: float = 1e5, **changes: Any) -> fmbd.AbsoluteBody:
    energy = saint_venant_kirchhoff(modulus, 0.3)
    return fmbd.AbsoluteBody(name, mesh, degree=1, density=1.0, energy=energy, quadrature=4, **changes)


@pytest.mark.parametrize("joint", ["pin", "pin with a lever", "fixed to a second bar"])
@pytest.mark.parametrize("h", [pytest.param(0.02, marks=pytest.mark.mpi), 0.2])
def test_joints_do_no_work(rod_mesh: Callable[..., Any], joint: str, h: float) -> None:
    """A bar about a pin, about a point away from its surface, or two bars as one: energy to 1e-9, the joint closed."""
    rod = bar(rod_mesh(dim=2, h=0.5, height=0.2), angular_velocity=2.0, velocity=(0.0, 1.0))
    scene = fmbd.Scene("pinned", gravity=(0.0, -1.0))
    center = (-0.3, 0.0) if joint == "pin with a lever" else (0.0, 0.0)
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=center))
    if joint == "fixed to a second bar":
        from fmbd_fenicsx import read_gmsh

        mesh = read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.2), origin=(1.0, -0.1), cells=3)
        second = bar(mesh, "second", angular_velocity=2.0, velocity=(0.0, 3.0))
        scene.add(second, fmbd.fixed("weld", rod.surface("tip"), second.surface("left")))
    scene.sensor("pin", fmbd.position(rod.surface("pin")))
    run = fmbd.solve(scene, t_end=15 * h, dt=h, scheme=fmbd.EnergyMomentum())
    energy = sum(run.energy.values())
    assert np.abs(energy - energy[0]).max() < 1e-9 * run.energy["kinetic"].max()
    assert run.energy["elastic"].max() > 1e-6 and run.drift[0] < 1e-10
    if joint == "pin":
        assert np.abs(run["pin"]).max() < 1e-10


def test_angular_momentum_about_a_pin(rod_mesh: Callable[..., Any]) -> None:
    """Without gravity the angular momentum about the pin stays; so does the motion of a fine generalized-alpha run."""
    rod = bar(rod_mesh(dim=2, h=0.5, height=0.2), angular_velocity=2.0, velocity=(0.0, 1.0))
    scene = fmbd.Scene("pinned")
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0.0, 0.0)))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    runs = [fmbd.solve(scene, t_end=t, dt=0.2, scheme=fmbd.EnergyMomentum()) for t in (0.2, 4.0)]
    np.testing.assert_allclose(invariants(runs[0])[2], invariants(runs[1])[2], rtol=1e-9)
    fine = fmbd.solve(scene, t_end=0.2, dt=2e-3, scheme=fmbd.EnergyMomentum())
    other = fmbd.solve(scene, t_end=0.2, dt=2e-3, scheme=fmbd.GeneralizedAlpha(0.9))
    np.testing.assert_allclose(fine["tip"][-1], other["tip"][-1], atol=1e-5)


def test_slow_motion_in_small_steps(rod_mesh: Callable[..., Any]) -> None:
    """A stiff bar with a heavy end begins to fall: in lengths, a billionth of its accelerations is below roundoff."""
    energy = neo_hookean(5e7, 0.3)
    body = fmbd.AbsoluteBody("bar", rod_mesh(h=0.15, height=0.1), density=1000.0, energy=energy)
    load = fmbd.RigidBody("load", mass=3.0, inertia=0.01, position=(1.0, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0.0, 0.0))
    scene = fmbd.Scene("begins to fall", gravity=(0.0, -9.81))
    scene.add(body, load, pin, fmbd.fixed("weld", body.surface("tip"), load, center=(1.0, 0.0)))
    run = fmbd.solve(scene, t_end=6e-3, dt=1e-3, scheme=fmbd.EnergyMomentum())
    total = sum(run.energy.values())
    assert run.counters["halved_steps"] == 0 and run.counters["newton_iterations"] <= 12 * 6
    assert np.abs(total - total[0]).max() < 1e-8 * np.ptp(run.energy["weight"])


def test_refusals(ring: Any) -> None:
    """Energies that are not W(C); damping that would change the angular momentum."""
    scene = spinning(ring, lambda u, dx: u[0] ** 2 * dx)
    with pytest.raises(InputError, match="StoredEnergy"):
        fmbd.solve(scene, t_end=0.1, dt=0.1, scheme=fmbd.EnergyMomentum())
    scene = spinning(ring, neo_hookean(1.0, 0.3), stiffness_damping=1e-3)
    with pytest.raises(InputError, match="kelvin_voigt"):
        fmbd.solve(scene, t_end=0.1, dt=0.1, scheme=fmbd.EnergyMomentum())


@pytest.mark.parametrize("large", [False, True], ids=["linear", "large strains"])
def test_tangents_serve_many_steps(
    rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, *, large: bool
) -> None:
    """A bar that falls by 17 degrees in 50 steps in parts: its tangent turns with it, that of a linear form is constant."""
    from fmbd_fenicsx.schemes.onestep.conserving import elastic_momentum, energy_momentum

    monkeypatch.setattr(energy_momentum.TangentAccount, "otherwise", True)

    law = (
        {"energy": saint_venant_kirchhoff(1e5, 0.3)} if large else {"elastic": fmbd.materials.linear_elastic(1e5, 0.3)}
    )
    rod = fmbd.AbsoluteBody("bar", rod_mesh(dim=2, h=0.5, height=0.2), degree=1, density=1.0, **law)
    scene = fmbd.Scene("falling", gravity=(0.0, -9.81))
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))

    taken = {"of bodies": 0, "of joints": 0}

    def counted(owner: Any, name: str, what: str) -> None:
        original = getattr(owner, name)

        def call(*given: Any) -> Any:
            taken[what] += 1
            return original(*given)

        monkeypatch.setattr(owner, name, call)

    counted(elastic_momentum._Body, "_take", "of bodies")
    counted(energy_momentum.EnergyMomentumStepper, "_differences", "of joints")
    run = fmbd.solve(scene, t_end=0.2, dt=0.004, scheme=fmbd.EnergyMomentum())
    energy = sum(run.energy.values())
    assert np.abs(energy - energy[0]).max() < 1e-9 * run.energy["kinetic"].max()
    assert 1 <= taken["of bodies"] <= 3 and 1 <= taken["of joints"] <= 3


def test_steps_in_parts_count_their_factors(rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """As on several ranks, where none were told."""
    monkeypatch.setattr(choice, "driver_states", lambda system: None)
    rod = fmbd.AbsoluteBody("bar", rod_mesh(dim=2, h=0.5), density=1000.0, elastic=linear_elastic(5e6, 0.3))
    scene = fmbd.Scene("pulled")
    scene.add(rod, fmbd.fixed("wall", fmbd.ground, rod.surface("pin")))
    scene.add(fmbd.force("pull", rod.surface("tip"), lambda t: (0.0, 100.0 * np.sin(20.0 * t))))
    counters = fmbd.solve(scene, t_end=0.04, dt=1e-3, scheme=fmbd.EnergyMomentum()).counters
    assert counters["factorisations"] == 1
    assert counters["back_solves"] > 100
