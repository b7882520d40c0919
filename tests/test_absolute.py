"""Absolute bodies: invariance under rigid motion, linear limit, agreement with the floating frame, tangents, energy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import ufl
from hypothesis import given, settings
from hypothesis import strategies as st
from ufl import as_matrix

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import Newton
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.materials import linear_elastic, neo_hookean, saint_venant_kirchhoff
from fmbd_fenicsx.rotations import motions
from fmbd_fenicsx.system.layout import State
from fmbd_fenicsx.system.powers import powers

MODULUS, DENSITY = 5e6, 1000.0
ENERGIES = [saint_venant_kirchhoff(MODULUS, 0.3), neo_hookean(MODULUS, 0.3)]


def body(mesh: Any, **changes: Any) -> fmbd.AbsoluteBody:
    return fmbd.AbsoluteBody("rod", mesh, density=DENSITY, energy=ENERGIES[0], quadrature=4).with_(**changes)


def pendulum(rod: Any) -> fmbd.Scene:
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81, 0.0)[: rod.dim])
    scene.add(rod, fmbd.revolute("pin", rod.surface("pin"), fmbd.ground))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    scene.sensor("force", fmbd.reaction("pin"))
    return scene


def test_stiffness_that_changes_from_place_to_place_is_integrated(rod_mesh: Any) -> None:
    """On first-order cells, too, whose strains are constant: quadratic moduli are exact."""
    mesh, stored = rod_mesh(2), []
    for share in (0.0, 1.0):
        law = neo_hookean(MODULUS, 0.3)

        def energy(u: Any, dx: Any, share: float = share, law: Any = law) -> Any:
            x = ufl.SpatialCoordinate(dx.ufl_domain())
            return sum((1 + share * x[0] ** 2) * part.integrand() * dx for part in law(u, dx).integrals())

        field = Field("rod", mesh, body(mesh, energy=energy, degree=1, quadrature=None).forms())
        stored.append(field.energy((0.1 * field.X).ravel()))
        field.destroy()
    assert stored[1] == pytest.approx(4 / 3 * stored[0], rel=1e-12)  # x from 0 to 1


@settings(max_examples=10)
@given(seed=st.integers(0, 10_000), kind=st.integers(0, 1), dim=st.integers(2, 3))
def test_rigid_displacements_cost_nothing(rod_mesh: Callable[..., Any], seed: int, kind: int, dim: int) -> None:
    """Internal force of a random rigid displacement at most 1e-12 E A, energy 1e-12 E V."""
    mesh = rod_mesh(dim=dim, h=0.5, height=0.2)
    field = Field("rod", mesh, body(mesh, energy=ENERGIES[kind]).forms())
    rng = np.random.default_rng(seed)
    m = motions(dim)
    R = m.matrix(m.compose(m.identity[None], rng.standard_normal((1, m.n_twist))))[0]
    U = field.X @ (R - np.eye(dim)).T + rng.standard_normal(dim)
    assert np.abs(field.internal(U.ravel())).max() < 1e-12 * MODULUS
    assert abs(field.energy(U.ravel())) < 1e-12 * MODULUS
    field.destroy()


@pytest.mark.smoke
@pytest.mark.mpi
@pytest.mark.parametrize("kind", [0, 1])
@pytest.mark.parametrize("dim", [2, 3])
def test_force_is_the_gradient_of_energy(rod_mesh: Callable[..., Any], kind: int, dim: int) -> None:
    """f_int . w = d energy in the direction w, K w = d f_int, and K at zero is Hooke's law."""
    mesh = rod_mesh(dim=dim, h=0.5, height=0.2)
    field = Field("rod", mesh, body(mesh, energy=ENERGIES[kind]).forms())
    linear = Field(
        "rod", mesh, fmbd.FloatingBody("rod", mesh, density=1.0, elastic=linear_elastic(MODULUS, 0.3)).forms()
    )
    rng = np.random.default_rng(field.comm.rank)
    U, w = 0.01 * rng.standard_normal((2, field.n * dim))
    np.testing.assert_allclose(field.stiffness(w), linear.stiffness(w), rtol=1e-9, atol=1e-9 * MODULUS)
    e = 1e-5
    slope = (field.energy(U + e * w) - field.energy(U - e * w)) / (2 * e)
    np.testing.assert_allclose(field.total(np.array(field.internal(U) @ w)), slope, rtol=1e-6)
    field.linearise(U)
    change = (field.internal(U + e * w) - field.internal(U - e * w)) / (2 * e)
    np.testing.assert_allclose(field.stiffness(w), change, atol=1e-6 * np.abs(change).max())
    field.destroy()
    linear.destroy()


@pytest.mark.mpi
@pytest.mark.smoke
def test_stiff_rod_agrees_with_floating_frame(rod_mesh: Callable[..., Any]) -> None:
    """The stiffer the rod the closer both placements: the difference falls like 1 / E."""
    mesh = rod_mesh(dim=2, h=0.25)
    gaps = []
    for modulus in (1e7, 1e8):
        floating = fmbd.FloatingBody("rod", mesh, density=DENSITY, elastic=linear_elastic(modulus, 0.3))
        absolute = body(mesh, energy=saint_venant_kirchhoff(modulus, 0.3))
        tips = [
            fmbd.solve(pendulum(b), t_end=0.1, dt=2e-3, scheme=fmbd.GeneralizedAlpha(0.5))["tip"]
            for b in (floating, absolute)
        ]
        gaps.append(np.abs(tips[0] - tips[1]).max())
    assert gaps[0] < 5e-4
    assert gaps[1] < 0.3 * gaps[0]


def test_same_answer_with_fresh_tangents(rod_mesh: Callable[..., Any]) -> None:
    """The frozen, turned tangent changes the cost, not the answer; Newton with a new tangent each time agrees."""
    scene = pendulum(body(rod_mesh(dim=2, h=0.25)))
    frozen = fmbd.solve(scene, t_end=0.2, dt=4e-3, newton=Newton(tolerance=1e-9))
    fresh = fmbd.solve(scene, t_end=0.2, dt=4e-3, newton=Newton(tolerance=1e-9, patience=0.0))
    np.testing.assert_allclose(frozen["tip"], fresh["tip"], atol=1e-9)
    assert frozen.counters["factorisations"] < 0.2 * fresh.counters["factorisations"]


def test_large_rotation_keeps_the_factor(rod_mesh: Callable[..., Any]) -> None:
    """A free rod that spins through several turns needs one factor: the tangent turns with the body."""
    rod = body(rod_mesh(dim=2, h=0.25), angular_velocity=20.0, energy=saint_venant_kirchhoff(1e8, 0.3))
    scene = fmbd.Scene("spin")
    scene.add(rod)
    run = fmbd.solve(scene, t_end=1.0, dt=2e-3)
    assert run.counters["factorisations"] == 1
    assert run.counters["newton_iterations"] < 5 * run.counters["steps"]


def test_linear_absolute_body_factors_once(rod_mesh: Callable[..., Any]) -> None:
    """Small displacements of a clamped rod: the first bending frequency, one factor."""
    mesh = rod_mesh(dim=2, h=0.1)
    rod = body(mesh, energy=None, elastic=linear_elastic(MODULUS, 0.0), quadrature=None)
    scene = fmbd.Scene("clamped", gravity=(0.0, -0.01))
    scene.add(rod, fmbd.fixed("wall", rod.surface("pin"), fmbd.ground))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    run = fmbd.solve(scene, t_end=2.0, dt=5e-3, scheme=fmbd.GeneralizedAlpha(0.9))
    assert run.counters["factorisations"] == 1
    y = run["tip"][:, 1]
    static = -DENSITY * 0.01 * 0.1 * 1.0**4 / (8 * MODULUS * 0.1**3 / 12)
    np.testing.assert_allclose(y.mean(), static, rtol=0.1)


def test_weight_and_momentum(rod_mesh: Callable[..., Any]) -> None:
    """In free fall momentum grows by m g t, angular momentum about the centre stays, energy is kept to the step's order."""
    rod = body(rod_mesh(dim=3, h=0.5, height=0.2), velocity=(1.0, 0.0, 0.0), angular_velocity=(0.0, 1.0, 2.0))
    scene = fmbd.Scene("fall", gravity=(0.0, -9.81, 0.0))
    scene.add(rod)
    run = fmbd.solve(scene, t_end=0.1, dt=2e-3)
    p, _ = run.system.at(run.state.t, run.state.q, run.state.v).momenta()
    mass = run.system.mass
    np.testing.assert_allclose(p, [mass * 1.0, -mass * 0.981, 0.0], rtol=1e-7, atol=1e-7 * mass)
    total = sum(run.energy.values())
    assert np.ptp(total) < 1e-3 * np.ptp(run.energy["weight"])


@pytest.mark.parametrize("make", ["floating", "reduced", "absolute"])
def test_units(rod_mesh: Callable[..., Any], make: str) -> None:
    """SI and mm-t-s: the same motion after scaling to 1e-9, the same Newton counts."""
    runs = []
    for scale, mass in ((1.0, 1.0), (1e3, 1e-3)):  # mm, t
        mesh = rod_mesh(dim=2, h=0.25 * scale, length=scale, height=0.1 * scale)
        modulus, density = MODULUS * mass / scale, DENSITY * mass / scale**3
        rod: Any = fmbd.FloatingBody("rod", mesh, density=density * scale, elastic=linear_elastic(modulus * scale, 0.3))
        if make == "reduced":
            rod = rod.reduced(modes=6)
        if make == "absolute":
            rod = body(mesh, density=density * scale, energy=saint_venant_kirchhoff(modulus * scale, 0.3))
        scene = pendulum(rod)
        scene.gravity = (0.0, -9.81 * scale)
        runs.append((scale, fmbd.solve(scene, t_end=0.1, dt=2e-3)))
    (_, si), (scale, mm) = runs
    np.testing.assert_allclose(mm["tip"] / scale, si["tip"], atol=1e-9)
    assert mm.counters["newton_iterations"] == si.counters["newton_iterations"]


def test_bad_input(rod_mesh: Callable[..., Any]) -> None:
    """Both or neither description of elasticity, and an energy that is no energy."""
    mesh = rod_mesh(dim=2, h=0.5, height=0.2)
    with pytest.raises(InputError, match="either elastic"):
        fmbd.AbsoluteBody("rod", mesh, density=1.0)
    with pytest.raises(InputError, match="either elastic"):
        body(mesh, elastic=linear_elastic(1.0, 0.3))
    with pytest.raises(InputError, match="energy"):
        Field("rod", mesh, body(mesh, energy=lambda u, dx: 1.0).forms())
    with pytest.raises(InputError, match="density"):
        body(mesh, density=-1.0)


@pytest.mark.parametrize(
    "load",
    [
        fmbd.loads.pressure("tip", 30.0),
        fmbd.loads.traction("tip", (3.0, -7.0)),
        fmbd.loads.thermal_stress(lambda x: x[0] * as_matrix([[3.0, 1.0], [1.0, 2.0]])),
    ],
    ids=["pressure", "traction", "heat"],
)
def test_power_of_loads_is_that_of_their_forces(load: Any, rod_mesh: Any) -> None:
    """A body with a load, less the same one without: minus their forces times the velocities."""
    made = []
    for loads in ((load,), ()):
        body = fmbd.AbsoluteBody(
            "body", rod_mesh(h=0.5, height=0.4), degree=1, density=1.0,
            elastic=fmbd.materials.linear_elastic(10.0, 0.3), loads=loads,
        )  # fmt: skip
        scene = fmbd.Scene("loaded")
        scene.add(body)
        system, _, _ = scene.build()
        made.append(system)
    rng = np.random.default_rng(4)
    u, v = (scale * rng.standard_normal(made[0].n_v) for scale in (1e-2, 1.0))
    balances = [s.at(0.0, u, v).balance(np.zeros(s.n_v)) for s in made]

    state = State(0.0, u, v, np.zeros(made[0].n_v), np.zeros(0))
    power = powers(made[0].at(0.0, u, v), state)["body, loads"]
    assert power == pytest.approx(-(balances[0] - balances[1]) @ v, rel=1e-9) and abs(power) > 0.1


@pytest.mark.mpi
@pytest.mark.parametrize("compiled", [True, False])
def test_a_linear_body_that_turns_is_told_of(rod_mesh: Callable[..., Any], compiled: bool) -> None:
    """Once; a turn of 0.1 rad stretches it by half a per cent. One that flies far or vibrates is not, nor one with an energy."""
    mesh = rod_mesh(dim=2, h=0.5, height=0.2)
    stiff = linear_elastic(1e9, 0.3)

    def told(*, spin: float = 0.0, speed: float = 0.0, gravity: float = 0.0, **material: Any) -> int:
        rod = fmbd.AbsoluteBody("rod", mesh, density=DENSITY, **material, angular_velocity=spin, velocity=(0.0, speed))
        scene = fmbd.Scene("turning", gravity=(0.0, gravity))
        scene.add(rod)
        if gravity:
            scene.add(fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))
        run = fmbd.solve(scene, t_end=0.1, dt=1e-2, scheme=fmbd.GeneralizedAlpha(0.8, compiled=compiled))
        return sum("has turned by" in line for line in run.warnings)

    assert told(spin=1.0, speed=5.0, elastic=stiff) == 1
    assert told(speed=50.0, elastic=stiff) == 0
    assert told(gravity=-9.81, elastic=stiff) == 0
    assert told(spin=1.0, energy=saint_venant_kirchhoff(1e9, 0.3)) == 0


def test_a_linear_body_is_told_of_by_the_moment_of_its_strains(caplog: pytest.LogCaptureFixture) -> None:
    """A ring that keeps its volume between a hub that is turned and a rim that is held: at 1.5e-3 rad in the mean it takes up a
    third of the torque by itself, and is too stiff by as much. Where it turns by next to nothing it is not told of.
    """
    mesh = fmbd.read_gmsh("meshes/ring.py", radius=1.0, width=0.5, h=0.25)

    def balance(torque: float) -> float:
        ring = fmbd.AbsoluteBody("ring", mesh, density=1100.0, elastic=fmbd.materials.nearly_incompressible(3e4, 0.5))
        hub = fmbd.RigidBody("hub", 1.0, 1.0)
        scene = fmbd.Scene("bushing")
        scene.add(ring, hub, fmbd.tie_surface("in", ring.surface("inner"), hub))
        scene.add(fmbd.tie_surface("out", ring.surface("outer"), fmbd.ground))
        scene.add(fmbd.revolute("pin", fmbd.ground, hub), fmbd.torque("turn", hub, lambda t: torque))
        scene.sensor("angle", fmbd.rotation(hub))
        caplog.clear()
        return float(fmbd.equilibrium(scene)["angle"][0]) / torque

    small = balance(0.1)
    assert "its strains turn it" not in caplog.text
    assert balance(1e3) < 0.7 * small
    assert "its strains turn it by 30 %" in caplog.text


def test_forms_of_small_rotations_are_told_of_when_the_body_turns(rod_mesh: Callable[..., Any]) -> None:
    """An energy of linear strains takes the turn for a strain, a bilinear viscous form brakes it; strains of C and drag do not.

    A foundation holds the body in the world, and that is meant.
    """
    mesh = rod_mesh(dim=2, h=0.5, height=0.2)
    stiff, exact = linear_elastic(1e9, 0.3), saint_venant_kirchhoff(1e9, 0.3)

    def of_small_strains(u: Any, dx: Any) -> Any:
        return 0.5 * stiff(u, u, dx)

    def of_right_cauchy_green(u: Any, dx: Any) -> Any:
        F = ufl.Identity(2) + ufl.grad(u)
        return 1e9 * ufl.inner(F.T * F - ufl.Identity(2), F.T * F - ufl.Identity(2)) * dx

    def told(energy: Any, viscous: Any = None) -> list[str]:
        rod = fmbd.AbsoluteBody("rod", mesh, density=DENSITY, energy=energy, viscous=viscous, angular_velocity=1.0)
        scene = fmbd.Scene("turning")
        scene.add(rod)
        return [w for w in fmbd.solve(scene, t_end=0.1, dt=1e-2).warnings if "has turned by" in w]

    assert ["energy is one of small rotations" in w for w in told(of_small_strains)] == [True]
    assert ["viscous form is for small" in w for w in told(exact, lambda u, v, dx: 1e-6 * stiff(u, v, dx))] == [True]
    assert not told(of_right_cauchy_green, lambda u, v, dx: 10.0 * ufl.inner(u, v) * dx)
    assert not told(exact, fmbd.materials.kelvin_voigt(1e3))
    assert not told(lambda u, dx: of_small_strains(u, dx) + 1e3 * ufl.inner(u, u) * dx)


def test_an_equilibrium_tells_of_a_linear_body_that_has_turned(
    rod_mesh: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    """As a run does: a cantilever bent by a tenth of a radian is longer than it was."""
    rod = fmbd.AbsoluteBody(
        "rod", rod_mesh(dim=2, h=0.5, height=0.2), density=DENSITY, elastic=linear_elastic(1e9, 0.3)
    )
    scene = fmbd.Scene("bent")
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))
    scene.add(fmbd.force("push", rod.surface("tip"), (0.0, -2e5)))
    fmbd.equilibrium(scene)
    assert sum("has turned by" in message for message in caplog.messages) == 1
