"""Geometrically exact rods: strains, tangents, objectivity, exact solutions, orders, refusals."""

from __future__ import annotations

import itertools
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from profiled import calls_of

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.mechanics.rods.elements import spins
from fmbd_fenicsx.mechanics.rods.strains import shape_of, strain_hessian, strain_jacobian, strains
from fmbd_fenicsx.rotations import hat, quaternion_exp, quaternion_matrix, quaternion_product
from fmbd_fenicsx.system.tangents.force_tangent import force_tangent

UNIT = fmbd.RodSection((1e4, 1e4, 1e4, 100.0, 100.0, 100.0), 1.0, (0.2, 0.1, 0.1))

# Wang et al., doi:10.1002/we.2101: composite beam, N and N m^2; tip displacements recomputed by shooting to 5e-13
COMPOSITE = np.diag([1368170.0, 88560.0, 38780.0, 16960.0, 59120.0, 141470.0])
COMPOSITE[[3, 4], [4, 3]], COMPOSITE[[3, 5], [5, 3]], COMPOSITE[[4, 5], [5, 4]] = 17610.0, -351.0, -370.0
COMPOSITE_TIP = (-0.0902726627566296, -0.0647488486259039, 1.22973648292371)


def random_poses(n, seed=0):
    """Poses along a bent line."""
    rng = np.random.default_rng(seed)
    x = np.linspace(0, 1, n)[:, None] * [1.0, 0.3, 0.0] + 0.02 * rng.normal(size=(n, 3))
    return np.concatenate((x, quaternion_exp(0.3 * rng.normal(size=(n, 3)))), axis=1)


def cantilever(rod, *loads):
    """A rod clamped at its start."""
    scene = fmbd.Scene("cantilever")
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("start")), *loads)
    scene.sensor("tip", fmbd.sensors.position(rod.surface("end")))
    return scene


def test_setting_up_many_elements_takes_no_more_calls_than_few() -> None:
    """A constant section is checked once, and poses are made together: it was 400 calls an element."""

    def built(elements: int) -> Any:
        return lambda: cantilever(fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], UNIT, elements=elements, degree=2)).build()

    built(2)()
    few, many = (calls_of(built(n)) for n in (4, 64))
    assert many - few < 3 * 60

    section = fmbd.RodSection((1e4, 1e4, 1e4, 100.0, 100.0, 100.0), 1.0, lambda s: (0.2, 0.1, 0.1 if s < 0.4 else 0.4))
    with pytest.raises(InputError, match=r"at s = 0.5 m violate"):
        cantilever(fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], section, elements=2)).build()


# -- strains --------------------------------------------------------------------------------------------------------
def test_strains_are_those_of_the_definition():
    """R^T x' and the axial vector of R^T R' of the rotation that belongs to P."""
    rng = np.random.default_rng(1)
    y, P, dP = rng.normal(size=(4, 3)), rng.normal(size=(4, 4)), rng.normal(size=(4, 4))

    def rotation(h):
        Q = P + h * dP
        return quaternion_matrix(Q / np.linalg.norm(Q, axis=-1, keepdims=True))

    R, Rs = rotation(0.0), (rotation(1e-6) - rotation(-1e-6)) / 2e-6
    e = strains(y, P, dP)
    np.testing.assert_allclose(e[:, :3], np.einsum("nji,nj->ni", R, y), atol=1e-13)
    np.testing.assert_allclose(hat(e[:, 3:]), np.swapaxes(R, 1, 2) @ Rs, atol=1e-8)


def test_derivatives_of_strains_against_differences():
    """First and second derivatives by the eleven numbers."""
    rng = np.random.default_rng(2)
    z, S, h = rng.normal(size=(5, 11)), rng.normal(size=(5, 6)), 1e-6

    def parts(z):
        return z[:, :3], z[:, 3:7], z[:, 7:]

    _, E = strain_jacobian(*parts(z))
    H = strain_hessian(parts(z), S)
    for k, d in enumerate(h * np.eye(11)):
        first = (strains(*parts(z + d)) - strains(*parts(z - d))) / (2 * h)
        np.testing.assert_allclose(E[:, :, k], first, atol=1e-8 * np.abs(E).max())
        slope = strain_jacobian(*parts(z + d))[1] - strain_jacobian(*parts(z - d))[1]
        second = (S[:, None] @ slope)[:, 0] / (2 * h)
        np.testing.assert_allclose(H[:, k], second, atol=1e-8 * np.abs(H).max())


def test_increments_of_quaternions():
    """Columns of p exp(theta)."""
    p = random_poses(3)[:, 3:]
    for k, theta in enumerate(1e-6 * np.eye(3)):
        moved = quaternion_product(p, quaternion_exp(np.broadcast_to(theta, (3, 3))))
        np.testing.assert_allclose(spins(p)[:, :, k], (moved - p) / 1e-6, atol=1e-6)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_lobatto_nodes_lump_the_mass_exactly_enough(degree):
    """Their rule is exact to degree 2 p - 1; the polynomials are one at their nodes and add up to one."""
    shape = shape_of(degree)
    for k in range(2 * degree):
        exact = 2 / (k + 1) if k % 2 == 0 else 0.0
        assert shape.node_weights @ shape.nodes**k == pytest.approx(exact, abs=1e-14)
    np.testing.assert_allclose(shape.N.sum(1), 1.0, atol=1e-14)
    np.testing.assert_allclose(shape.dN @ shape.nodes, 1.0, atol=1e-13)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_superposed_rotations_give_no_strain(degree):
    """100 rotations of up to 20 revolutions about random axes, one after the other, of a bent rod."""
    rod = fmbd.Rod("rod", [(0, 0, 0), (1, 0.3, 0)], UNIT, elements=4, degree=degree)
    elements = rod.elements_on(0)
    poses = random_poses(len(rod.nodes))
    before, rng = elements.strains(poses), np.random.default_rng(3)
    for _ in range(100):
        axis = rng.normal(size=3)
        turn = quaternion_exp(rng.uniform(0, 40 * np.pi) * axis / np.linalg.norm(axis))
        x = poses[:, :3] @ quaternion_matrix(turn).T
        poses = np.concatenate((x, quaternion_product(turn, poses[:, 3:])), axis=1)
    after = elements.strains(poses)
    assert np.abs(before).max() > 0.1
    assert np.abs(after - before).max() < 1e-12


def test_the_sign_of_a_quaternion_does_not_matter():
    rod = fmbd.Rod("rod", [(0, 0, 0), (1, 0.3, 0)], UNIT, elements=4)
    poses = random_poses(len(rod.nodes))
    flipped = poses.copy()
    flipped[::3, 3:] *= -1.0
    elements = rod.elements_on(0)
    np.testing.assert_array_equal(elements.strains(poses), elements.strains(flipped))
    zero = np.zeros((len(poses), 6))
    for (_, a), (_, b) in zip(elements.forces(0.0, poses, zero), elements.forces(0.0, flipped, zero), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12 * np.abs(a).max())


# -- tangents -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_stiffness_is_the_derivative_of_the_balance(degree):
    """Elements, loads along the rod, dead and following, and torques at its end, of a rod bent at random."""
    loads = [
        fmbd.RodLoad(law, follower=follower, turns=turns)
        for law in (lambda s, t: (1.0 + s, 2.0, -3.0),)
        for follower in (False, True)
        for turns in (False, True)
    ]
    rod = fmbd.Rod("rod", [(0, 0, 0), (1, 0.1, 0.2), (2, 0, 0.3)], UNIT, elements=3, degree=degree, loads=loads)
    end = rod.surface("end")
    scene = cantilever(
        rod,
        fmbd.torque("M", end, lambda t: (1.0, 2.0, 3.0)),
        fmbd.force("F", end, lambda t: (5.0, -4.0, 3.0), point=(2.0, 0.2, 0.3)),
    )
    system, state, _ = scene.build()
    rng, rest = np.random.default_rng(4), np.zeros(system.n_v)
    q = system.compose(state.q, 0.1 * rng.normal(size=system.n_v))
    K = force_tangent(system.at(0.0, q, rest), 0.0, 1.0).core
    for _ in range(3):
        d, h = rng.normal(size=system.n_v), 1e-6
        sides = [system.at(0.0, system.compose(q, x * d), rest).balance(rest) for x in (h, -h)]
        difference = (sides[0] - sides[1]) / (2 * h)
        np.testing.assert_allclose(K @ d, difference, atol=1e-8 * np.abs(difference).max())


def test_damping_is_the_derivative_by_velocities():
    """Kelvin-Voigt damping: exact in the velocities."""
    rod = fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], UNIT, elements=3, damping=0.02)
    system, state, _ = cantilever(rod).build()
    rng, rest = np.random.default_rng(5), np.zeros(system.n_v)
    q, v = system.compose(state.q, 0.1 * rng.normal(size=system.n_v)), rng.normal(size=system.n_v)
    D = force_tangent(system.at(0.0, q, v), 1.0, 0.0).core

    def forces(v):
        return np.concatenate(
            [rows.ravel() for _, rows in system.elements[0].forces(0.0, system.poses(q), system.twists(v))]
        )

    d = rng.normal(size=system.n_v)
    difference = np.zeros((system.n_frames, 6))
    rows = (forces(v + d) - forces(v - d)).reshape(*system.elements[0].frames.shape, 6) / 2
    np.add.at(difference, system.elements[0].frames, rows)
    np.testing.assert_allclose(D @ d, difference.ravel(), rtol=1e-10, atol=1e-9)
    assert v @ (system.at(0.0, q, v).balance(rest) - system.at(0.0, q, rest).balance(rest)) > 0  # takes energy


# -- exact solutions ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("degree", "elements"), [(1, 4), (2, 4), (3, 2)])
def test_composite_beam_to_order_two_p(degree, elements):
    """All six section forces coupled."""
    error = []
    for n in (elements, 2 * elements):
        rod = fmbd.Rod(
            "rod", [(0, 0, 0), (10, 0, 0)], fmbd.RodSection(COMPOSITE, 1.0, (1, 1, 1)), elements=n, degree=degree
        )
        scene = cantilever(rod, fmbd.force("F", rod.surface("end"), lambda t: (0, 0, 150.0 * t)))
        found = fmbd.equilibrium(scene, t=1.0)
        error.append(np.abs(found["tip"] - (10, 0, 0) - COMPOSITE_TIP).max())
    assert np.log2(error[0] / error[1]) == pytest.approx(2 * degree, abs=0.15)
    assert error[1] < {1: 2e-2, 2: 2e-6, 3: 1e-7}[degree]


def test_a_cantilever_rolls_up_to_a_circle():
    """End moment 2 pi EI / L, without a direction to begin with: 64 elements of degree 3 close it to 2e-12."""
    rod = fmbd.Rod("rod", [(0, 0, 0), (10, 0, 0)], UNIT, elements=32)
    scene = cantilever(rod, fmbd.torque("M", rod.surface("end"), lambda t: (0, 0, 20 * np.pi * t)))
    found = fmbd.equilibrium(scene, path=fmbd.LoadSteps((0.5, 1.0), first=0.1))
    np.testing.assert_allclose(found.path.series["tip"], [(10, 0, 0), (0, 20 / np.pi, 0), (0, 0, 0)], atol=1e-9)
    bend = found.system.elements[0].strains(found.system.poses(found.state.q))
    np.testing.assert_allclose(bend[..., 5], 0.2 * np.pi, rtol=1e-4)
    assert np.abs(bend[..., :3]).max() < 1e-5


def test_no_locking_of_thin_rods():
    """Shear and stretch 1e7 times stiffer than bending change the tip by no more than they should: the same deflection."""
    tips = []
    for stiff in (1e6, 1e9):
        section = fmbd.RodSection((stiff, stiff, stiff, 100.0, 100.0, 100.0), 1.0, (1, 1, 1))
        for degree in (1, 2, 3):
            arc = [(np.sin(a), 1 - np.cos(a), 0.0) for a in np.linspace(0, 1.5, 9)]
            rod = fmbd.Rod("rod", arc, section, elements=8, degree=degree)
            scene = cantilever(rod, fmbd.force("F", rod.surface("end"), lambda t: (0, 0, 60.0 * t)))
            tips.append(fmbd.equilibrium(scene, t=1.0)["tip"])
    for degree in range(3):
        np.testing.assert_allclose(tips[degree], tips[degree + 3], atol=3e-4)
    np.testing.assert_allclose(tips[0], tips[2], atol=6e-3)
    np.testing.assert_allclose(tips[1], tips[2], atol=2e-5)


def test_prestrain_bends_a_straight_rod():
    """A rod that is free of stress at a curvature takes it without load."""
    rod = fmbd.Rod("rod", [(0, 0, 0), (10, 0, 0)], UNIT, elements=32, prestrain=(0, 0, 0, 0, 0, 0.005 * np.pi))
    tip, angle = fmbd.equilibrium(cantilever(rod))["tip"], 0.05 * np.pi
    np.testing.assert_allclose(tip, (10 * np.sin(angle) / angle, 10 * (1 - np.cos(angle)) / angle, 0), atol=1e-8)


# -- sections and curves --------------------------------------------------------------------------------------------
def test_section_of_a_shape():
    """A tube as in a table: EA 313.4e6 N, EI 354.5e3 N m^2, GJ 272.7e3 N m^2; a square's torsion constant 0.140577 a^4."""
    tube = fmbd.RodSection.circle(youngs_modulus=210e9, poisson_ratio=0.3, density=7800.0, radius=0.05, inner=0.045)
    np.testing.assert_allclose(np.asarray(tube.stiffness)[[0, 3, 4]], (313.4e6, 272.7e3, 354.5e3), rtol=1e-3)
    square = fmbd.RodSection.rectangle(youngs_modulus=2.6, poisson_ratio=0.3, density=1.0, width=1.0, height=1.0)
    assert np.asarray(square.stiffness)[3] == pytest.approx(0.140577, rel=1e-4)
    flat = fmbd.RodSection.rectangle(youngs_modulus=1.0, poisson_ratio=0.0, density=3.0, width=2.0, height=1.0)
    with pytest.raises(InputError, match="RodSection.rectangle: width -2.0 must be a positive number"):
        fmbd.RodSection.rectangle(youngs_modulus=1.0, poisson_ratio=0.0, density=3.0, width=-2.0, height=1.0)
    np.testing.assert_allclose(np.asarray(flat.stiffness)[[0, 1, 4, 5]], (2.0, 5 / 6, 2 / 12, 8 / 12))
    np.testing.assert_allclose(flat.inertias(np.zeros(1))[0], np.diag([2.5, 0.5, 2.0]))


def test_curves_by_arc_length():
    """A helix given by a parameter that does not move evenly: length, places, axes orthonormal, first axis the tangent."""
    rod = fmbd.Rod(
        "spring", lambda u: (np.cos(6 * u * u + u), np.sin(6 * u * u + u), 0.5 * (6 * u * u + u)), UNIT, elements=12
    )
    assert rod.length == pytest.approx(7 * np.sqrt(1.25), rel=1e-12)
    angle = rod.nodes / np.sqrt(1.25)
    np.testing.assert_allclose(
        rod.poses[:, :3], np.stack((np.cos(angle), np.sin(angle), 0.5 * angle), axis=1), atol=1e-10
    )
    R = rod.poses_matrix
    np.testing.assert_allclose(np.swapaxes(R, 1, 2) @ R, np.broadcast_to(np.eye(3), R.shape), atol=1e-13)
    tangent = np.stack((-np.sin(angle), np.cos(angle), 0.5 + 0 * angle), axis=1) / np.sqrt(1.25)
    np.testing.assert_allclose(R[:, :, 0], tangent, atol=1e-9)
    assert np.abs(rod.elements_on(0).strains(rod.poses)).max() == 0.0


def test_bishop_frame_has_no_twist():
    """Axis 2 carried along turns about the tangent nowhere: kappa_1 is zero, with a twist it is the twist's slope."""
    arc = lambda u: (np.sin(3 * u), u * u, np.cos(3 * u))  # noqa: E731
    plain, twisted = (fmbd.Rod("rod", arc, UNIT, elements=40, twist=twist) for twist in (None, lambda s: 0.25 * s))
    for rod, slope in ((plain, 0.0), (twisted, 0.25)):
        made = rod.elements_on(0)
        np.testing.assert_allclose(made.natural[..., 3], slope, atol=1e-6)
        np.testing.assert_allclose(made.natural[..., 0], 1.0, atol=1e-7)


def test_carried_axes_are_the_product_of_all_steps():
    """Taken together two by two, or one after the other."""
    from fmbd_fenicsx.mechanics.rods import curves

    rng = np.random.default_rng(3)
    for n in (0, 1, 5, 64):
        steps, found = rng.standard_normal((n, 3, 3)), [np.eye(3)]
        for step in steps:
            found.append(step @ found[-1])
        np.testing.assert_allclose(curves._products(steps), found, rtol=1e-9, atol=1e-9 * np.abs(found).max())


def test_stations_are_nodes_and_surfaces():
    rod = fmbd.Rod("rod", [(0, 0, 0), (2, 0, 0)], UNIT, elements=5, stations={"third": 2 / 3})
    node = rod.node_of("third")
    np.testing.assert_allclose(rod.poses[node, :3], (2 / 3, 0, 0), atol=1e-14)
    assert rod.inertia[0].sum() == pytest.approx(2.0)
    with pytest.raises(InputError, match='no section "thrid".*third'):
        rod.surface("thrid")


def test_mass_and_start_of_a_moving_rod():
    """Momentum and energy of a rigid motion."""
    rod = fmbd.Rod("rod", [(0, 0, 0), (2, 0, 0)], UNIT, elements=3, velocity=(1, 2, 3), angular_velocity=(0.5, 0, 4.0))
    scene = fmbd.Scene("free")
    scene.add(rod)
    system, state, _ = scene.build()
    ev = system.at(0.0, state.q, state.v)
    p, L = ev.momenta()
    np.testing.assert_allclose(p, (2, 4, 6), atol=1e-14)
    J = np.array([0.2 * 2, 0.0, 0.1 * 2 + 2 * 4 / 12])
    np.testing.assert_allclose(L, J * (0.5, 0, 4.0) + np.cross((1, 0, 0), p), atol=1e-13)
    energy = 0.5 * 2 * 14 + 0.5 * (J * (0.25, 0, 16)).sum()
    assert ev.energies()["kinetic"] == pytest.approx(energy, rel=1e-13)
    assert ev.energies()["elastic"] < 1e-20


# -- own energies ---------------------------------------------------------------------------------------------------
def test_own_energy_in_ufl_is_the_matrix_law():
    """The same quadratic energy, with a stiffness that varies along the rod, in UFL and as a function of s."""
    import ufl

    def energy(gamma, kappa, s):
        e = ufl.as_vector([*gamma, *kappa])
        return 0.5 * (1 + s) * ufl.dot(e, ufl.as_matrix(COMPOSITE.tolist()) * e)

    own = fmbd.RodSection(energy=energy, mass=1.0, inertia=(1, 1, 1))
    given = fmbd.RodSection(lambda s: (1 + s) * COMPOSITE, 1.0, (1, 1, 1))
    laws = [section.law(np.linspace(0, 1, 6).reshape(2, 3)) for section in (own, given)]
    e = np.random.default_rng(6).normal(size=(2, 3, 6))
    for name in ("energy", "stress", "tangent"):
        a, b = (getattr(law, name)(e) for law in laws)
        np.testing.assert_allclose(a, b, atol=1e-12 * np.abs(b).max())


def test_own_energy_that_stiffens():
    """W = EA/2 gamma^2 + c/4 gamma^4: N = EA gamma + c gamma^3 under a pull."""

    def energy(gamma, kappa, s):
        return (
            50 * gamma[0] ** 2
            + 100 * gamma[0] ** 4
            + 50 * (gamma[1] ** 2 + gamma[2] ** 2)
            + 0.5 * (kappa[0] ** 2 + kappa[1] ** 2 + kappa[2] ** 2)
        )

    rod = fmbd.Rod(
        "band", [(0, 0, 0), (1, 0, 0)], fmbd.RodSection(energy=energy, mass=1.0, inertia=(1, 1, 1)), elements=2
    )
    scene = cantilever(rod, fmbd.force("F", rod.surface("end"), lambda t: (300.0 * t, 0, 0)))
    stretch = fmbd.equilibrium(scene, t=1.0)["tip"][0] - 1.0
    assert 100 * stretch + 400 * stretch**3 == pytest.approx(300.0, rel=1e-10)


# -- motion ---------------------------------------------------------------------------------------------------------
FREE = fmbd.RodSection((1e4, 1e4, 1e4, 500.0, 500.0, 500.0), 1.0, (20, 10, 10))


def test_energy_momentum_keeps_energy_and_momenta():
    """A free rod that starts with a violent bend and spin: all invariants to roundoff, for a step far above its periods."""
    rod = fmbd.Rod("rod", [(6, 0, 0), (3, 4, 0), (0, 7, 1)], FREE, elements=2, degree=2, velocity=(1, 2, 3),
                   angular_velocity=(1.0, -2.0, 3.0), prestrain=(0, 0, 0, 0.1, 0.1, 0.2))  # fmt: skip
    scene = fmbd.Scene("free")
    scene.add(rod)
    run = fmbd.solve(scene, t_end=1.0, dt=0.05, scheme=fmbd.EnergyMomentum(), newton=fmbd.Newton(tolerance=1e-12))
    total = run.total_energy
    assert np.ptp(run.energy["elastic"]) > 0.02 * total[0]
    assert np.ptp(total) < 1e-11 * total[0]
    system, state, _ = scene.build()
    for before, after in zip(run.momenta(state), run.momenta(), strict=True):
        assert np.abs(after - before).max() < 1e-10 * np.abs(before).max()


def swing(scheme, dt):
    """Tip of a cantilever that swings under its weight for 0.1 s."""
    section = fmbd.RodSection((1e4, 1e4, 1e4, 100.0, 100.0, 100.0), 1.0, (0.2, 0.1, 0.1))
    rod = fmbd.Rod("rod", [(0, 0, 0), (2, 0, 0)], section, elements=2, degree=2)
    scene = fmbd.Scene("swing", gravity=(0, -20, 5))
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("start")))
    scene.sensor("tip", fmbd.sensors.position(rod.surface("end")))
    return fmbd.solve(scene, t_end=0.1, dt=dt, scheme=scheme)["tip"][-1]


@pytest.fixture(scope="module")
def swung():
    """The same by half of the step, to 1e-5."""
    return swing(fmbd.GeneralizedAlpha(0.9), 5e-4)


@pytest.mark.parametrize("make", [fmbd.GeneralizedAlpha, fmbd.Radau, fmbd.BDF, fmbd.EnergyMomentum, fmbd.Rattle])
def test_every_scheme_takes_rods(make, swung):
    assert swung[1] < -0.1
    np.testing.assert_allclose(swing(make(), 1e-3), swung, atol=1e-4)


def test_a_first_step_that_hardly_moves_is_known_to_roundoff():
    """Six hinged rods along the edges of a cube, at rest while weight sets in: increments stood at the roundoff of their forces,
    1e-8 of the first one and 200 times what may move, and the step was made in parts, with 24 dense factors of all stages.
    """
    corners = [
        np.array(x, dtype=float) for x in ((0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1), (0, 1, 1), (0, 0, 1), (0, 0, 0))
    ]
    section = fmbd.RodSection.circle(youngs_modulus=2e8, poisson_ratio=0.3, density=1000, radius=0.0178)
    scene = fmbd.Scene("cube", gravity=(0, 0, -9.81), gravity_ramp=0.2)
    last, before = None, None
    for i, (a, b) in enumerate(itertools.pairwise(corners)):
        rod = scene.add(fmbd.Rod(f"rod {i}", [a, b], section, elements=2))
        if last is None:
            scene.add(fmbd.fixed("clamp", fmbd.ground, rod.surface("start"), center=a))
        else:
            axis = np.cross(a - before, b - a)
            scene.add(fmbd.revolute(f"hinge {i}", last, rod.surface("start"), center=a, axis=axis))
        last, before = rod.surface("end"), a
    run = fmbd.solve(scene, t_end=0.02, dt=0.01, scheme=fmbd.BDF(2, rtol=None))
    assert not run.counters["halved_steps"] and run.counters["core_factorisations"] <= 4


def test_runs_with_rods_are_taken_up_to_the_last_bit(tmp_path):
    """A damped rod on a pin: state and series from a checkpoint in the middle are those of the whole run."""
    rod = fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], UNIT, elements=2, degree=2, damping=1e-3)
    scene = fmbd.Scene("swing", gravity=(0, 0, -9.81))
    scene.add(rod, fmbd.spherical("pin", fmbd.ground, rod.surface("start")))
    scene.sensor("tip", fmbd.sensors.position(rod.surface("end")))
    scene.sensor("forces", fmbd.sensors.section_forces(rod.surface("start")))
    settings = {"t_end": 0.05, "dt": 0.005, "scheme": fmbd.GeneralizedAlpha(0.8)}
    whole = fmbd.solve(scene, **settings, checkpoint=fmbd.Checkpoint(tmp_path, every=1, keep=100))
    found = next(tmp_path.glob("*_step5"))
    again = fmbd.solve(scene, **settings, restart=found)
    for name in ("tip", "forces"):
        np.testing.assert_array_equal(whole[name], again[name])
    np.testing.assert_array_equal(whole.state.q, again.state.q)


def test_rods_are_not_left_out_by_compiled_steps():
    """A scene without loads, moved by a drive only: the strain that a turned end makes."""
    rod = fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], UNIT, elements=2, degree=2)
    scene = fmbd.Scene("bent")
    pin = fmbd.revolute("pin", fmbd.ground, rod.surface("end"))
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("start")), pin)
    scene.add(fmbd.drive("turn", fmbd.angle(pin), lambda t: 0.5 * np.sin(t) ** 4))
    run = fmbd.solve(scene, t_end=1.0, dt=0.02, scheme=fmbd.GeneralizedAlpha(0.8))
    assert run.energy["elastic"][-1] > 1.0
    work = 100.0 * 4.0 * (0.5 * np.sin(1.0) ** 4) ** 2 / 2  # 4 EI / L against a turn, quasi-static
    assert run.energy["elastic"][-1] == pytest.approx(work, rel=0.3)


def test_section_forces_are_those_of_statics():
    """A cantilever with a dead load at its end and a station: forces and moments by hand."""
    rod = fmbd.Rod("rod", [(0, 0, 0), (2, 0, 0)], fmbd.RodSection((1e9, 1e9, 1e9, 1e8, 1e8, 1e8), 1.0, (1, 1, 1)), elements=4,
                   stations={"middle": 1.0})  # fmt: skip
    end = rod.surface("end")
    scene = cantilever(
        rod, fmbd.forces.force("F", end, lambda t: (3, 4, 5)), fmbd.forces.torque("M", end, lambda t: (6, 7, 8))
    )
    found = fmbd.equilibrium(scene, t=1.0)
    ev = found.system.at(1.0, found.state.q, found.state.v)
    for name, arm in (("start", 2.0), ("middle", 1.0), ("end", 0.0)):
        forces = fmbd.sensors.section_forces(rod.surface(name)).read(ev, None, -1)
        np.testing.assert_allclose(forces, (3, 4, 5, 6, 7 - 5 * arm, 8 + 4 * arm), atol=1e-4)
        e = fmbd.sensors.section_strains(rod.surface(name)).read(ev, None, -1)
        np.testing.assert_allclose(e * (1e9, 1e9, 1e9, 1e8, 1e8, 1e8), forces, atol=1e-6)


def test_skin_follows_the_sections():
    """Rings around the curve, at the corners of the outline."""
    from fmbd_fenicsx.post.drawing.rods import skin

    section = fmbd.RodSection.rectangle(youngs_modulus=1.0, poisson_ratio=0.0, density=1.0, width=0.2, height=0.1)
    rod = fmbd.Rod("rod", [(0, 0, 0), (2, 0, 0)], section, elements=2, twist=lambda s: 0.25 * np.pi * s)
    rings = skin(rod, rod.poses)
    np.testing.assert_allclose(rings[0], [(0, y, z) for y, z in section.outline], atol=1e-14)
    np.testing.assert_allclose(rings[-1], [(2, -z, y) for y, z in section.outline], atol=1e-14)


# -- bad input ------------------------------------------------------------------------------------------------------
SKEW = COMPOSITE + 100.0 * np.eye(6, k=1)
STRAIGHT = [(0, 0, 0), (1, 0, 0)]
OWN = partial(fmbd.RodSection, None, 1.0, (1, 1, 1))  # of an energy


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: fmbd.RodSection(SKEW, 1.0, (1, 1, 1)), r"not symmetric: entry \(\d, \d\)"),
        (lambda: fmbd.RodSection((1, 1, 1, -1, 1, 1), 1.0, (1, 1, 1)), "not positive"),
        (lambda: fmbd.RodSection((1, 1, 1, 1, 1, 1), 0.0, (1, 1, 1)), "at s = 0 m: mass 0.0 kg/m must be a positive number"),
        (lambda: fmbd.RodSection((1, 1, 1, 1, 1, 1), 1.0, (1, 0, 1)), "inertia at s = 0 m is not positive"),
        (lambda: fmbd.RodSection((1, 1, 1, 1, 1, 1), 1.0, (1, 1, 3)), r"\[1. 1. 3.\] at s = 0 m violate J1 \+ J2 >= J3"),
        (lambda: fmbd.RodSection(), "either its stiffness"),
        (lambda: fmbd.Rod("rod", STRAIGHT, OWN(lambda g, k, s: g)), r"must return a scalar .* found the shape \(3,\)"),
        (lambda: fmbd.Rod("rod", STRAIGHT, OWN(lambda g, k, s: None)), "must return a scalar .* None"),
        (lambda: fmbd.Rod("rod", [(0, 0, 0), (0, 0, 0)], UNIT), "no tangent"),
        (lambda: fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0), (1, 1, 0)], UNIT), "90 degrees at point 2.*kink"),
        (lambda: fmbd.Rod("rod", lambda u: (abs(u - 0.3), u, 0), UNIT), "not smooth near u = 0.3.*kink"),
        (lambda: fmbd.Rod("rod", lambda u: ((u - 0.5) ** 3, 0, 0), UNIT), "tangent of its curve is zero near u = 0.5"),
        (lambda: fmbd.Rod("rod", STRAIGHT, UNIT, normal=(2, 0, 0)), r"twist is undefined at s = 0 m, point \[0.0, 0.0, 0.0\]"),
        (lambda: fmbd.Rod("rod", STRAIGHT, UNIT, stations={"tip": 1.2}), 'station "tip" at s = 1.2 m is off the curve'),
        (lambda: fmbd.Rod("rod", STRAIGHT, UNIT, stations={"end": 0.5}), 'cannot be called "end"'),
        (lambda: fmbd.Rod("rod", STRAIGHT, UNIT, degree=4), "degree 4 must be 1, 2 or 3"),
        (lambda: fmbd.Rod("rod", STRAIGHT, UNIT, elements=2, twist=lambda s: 30 * s), "turn by .* Take at least"),
        (lambda: fmbd.Rod("rod", STRAIGHT, UNIT, prestrain=(1, 2)), None),
        (lambda: fmbd.Rod("rod", "line", UNIT), "two or more points"),
    ],
)  # fmt: skip
def test_bad_input_is_one_clear_error(make, message):
    with pytest.raises(InputError, match=message):
        made = make()
        made.elements_on(0)


def test_a_rod_is_attached_by_its_sections():
    rod = fmbd.Rod("rod", STRAIGHT, UNIT)
    scene = fmbd.Scene("s")
    scene.add(rod)
    with pytest.raises(InputError, match='attach to a surface of the elastic body "rod"'):
        fmbd.fixed("clamp", fmbd.ground, rod)


# -- compiled -------------------------------------------------------------------------------------------------------
def follower(s, t):
    """N/m in axes of the sections."""
    return 0.0, 0.0, 5.0 * t


def stiffening(gamma, kappa, s):
    """J/m: UNIT with a bending about axis 2 that stiffens."""
    square = gamma[0] ** 2 + gamma[1] ** 2 + gamma[2] ** 2
    return 5e3 * square + 50.0 * (kappa[0] ** 2 + kappa[1] ** 2 + kappa[2] ** 2) + 10.0 * kappa[1] ** 4


@pytest.mark.parametrize(
    "more",
    [
        {"degree": 1},
        {"degree": 3, "damping": 1e-2},
        {
            "degree": 2,
            "loads": (fmbd.RodLoad(follower, follower=True), fmbd.RodLoad(lambda s, t: (0, t, s), turns=True)),
        },
        {
            "degree": 2,
            "section": fmbd.RodSection(energy=stiffening, mass=1.0, inertia=(0.2, 0.1, 0.1)),
            "damping": 1e-2,
        },
    ],
    ids=["linear", "damped", "loaded", "own energy"],
)
def test_compiled_rods_move_as_those_in_numpy(more, monkeypatch):
    """A bent rod that swings on a pin: the same motion, reactions and energies by both, and most steps compiled."""
    from fmbd_fenicsx.system.compiled import choice

    def run():
        given = {"section": UNIT, "elements": 3} | more
        rod = fmbd.Rod("rod", [(0, 0, 0), (1, 0.2, 0), (2, 0, 0.3)], given.pop("section"), **given)
        scene = fmbd.Scene("swing", gravity=(0, 0, -9.81))
        scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("start"), axis=(0, 1, 0)))
        scene.add(fmbd.forces.force("F", rod.surface("end"), lambda t: (0, 10 * np.sin(5 * t), 0.0)))
        scene.sensor("tip", fmbd.sensors.position(rod.surface("end")))
        scene.sensor("root", fmbd.sensors.section_forces(rod.surface("start")))
        return fmbd.solve(scene, t_end=0.2, dt=5e-3, scheme=fmbd.GeneralizedAlpha(0.8))

    compiled = run()
    monkeypatch.setattr(choice, "driver_library", lambda *_: None)
    plain = run()
    assert compiled.counters["compiled_steps"] >= 38
    assert "compiled_steps" not in plain.counters
    assert compiled.counters["newton_iterations"] <= plain.counters["newton_iterations"] + 5
    np.testing.assert_allclose(compiled["tip"], plain["tip"], atol=1e-8)
    np.testing.assert_allclose(compiled["root"], plain["root"], atol=1e-5 * np.abs(plain["root"]).max())
    np.testing.assert_allclose(compiled.total_energy, plain.total_energy, atol=1e-6)


# -- steady rotation ------------------------------------------------------------------------------------------------
def test_frequencies_of_a_rotating_cantilever():
    """First flapwise frequency over sqrt(EI / m L^4), slender and inextensible, to 50 times that speed.

    Values of Hamza-cherif and Houmat, ICAS 2004; those in the plane of rotation obey lag^2 = flap^2 - speed^2 there.
    """
    reference = {2.0: 4.1373, 6.0: 7.3603, 10.0: 11.2023, 50.0: 51.0805}
    side = np.sqrt(12) / 700
    bending = side**4 / 12
    section = fmbd.RodSection(
        (1e3 * side**2, side**2, side**2, bending, bending, bending), side**2, (2 * bending, bending, bending)
    )

    def make(speed):
        rod = fmbd.Rod("blade", [(0, 0, 0), (1, 0, 0)], section, elements=6)
        return cantilever(rod)

    unit = np.sqrt(bending) / side
    found = fmbd.campbell(make, [mu * unit for mu in reference], 2)
    frequencies = np.sort(np.abs(found.eigenvalues.imag), axis=1) / unit
    flap = np.array(list(reference.values()))
    np.testing.assert_allclose(frequencies[:, 1], flap, rtol=3e-4)
    np.testing.assert_allclose(frequencies[:3, 0], np.sqrt(flap**2 - np.array(list(reference)) ** 2)[:3], rtol=2e-3)


# -- lines of gmsh --------------------------------------------------------------------------------------------------
HOOK = """
Point(1) = {0, 0, 0}; Point(2) = {2, 0, 0}; Point(3) = {2, 1, 0}; Point(4) = {3, 1, 0};
Line(1) = {1, 2}; Circle(2) = {4, 3, 2};
Physical Curve("hook") = {1, 2}; Physical Point("root") = {1}; Physical Point("bend") = {2}; Physical Point("tip") = {4};
Mesh.MeshSizeMin = 0.05; Mesh.MeshSizeMax = 0.05; Mesh.ElementOrder = 2;
"""


def test_a_line_of_gmsh_is_a_curve(tmp_path):
    """A straight piece and an arc, the second drawn backwards: points in order, named points at their arc lengths."""
    (tmp_path / "hook.geo").write_text(HOOK)
    line = fmbd.read_line(tmp_path / "hook.geo")
    rod = fmbd.Rod("hook", line.points, UNIT, stations=line.stations, elements=8)
    assert rod.length == pytest.approx(2 + np.pi / 2, rel=1e-5)
    assert rod.places["root"] == pytest.approx(0.0, abs=1e-9)
    assert rod.places["bend"] == pytest.approx(2.0, rel=1e-5)
    np.testing.assert_allclose(rod.poses[rod.node_of("tip"), :3], (3, 1, 0), atol=1e-9)
    assert rod.node_of("root") == 0
    assert rod.node_of("tip") == len(rod.nodes) - 1


def test_lines_that_are_no_path_are_refused(tmp_path):
    """A name that is not there, a closed line, and a station beside the curve."""
    (tmp_path / "hook.geo").write_text(HOOK)
    with pytest.raises(InputError, match='Did you mean "hook"'):
        fmbd.read_line(tmp_path / "hook.geo", line="hok")
    closed = HOOK.replace('Physical Curve("hook") = {1, 2}', 'Line(3) = {4, 1}; Physical Curve("hook") = {1, 2, 3}')
    (tmp_path / "loop.geo").write_text(closed)
    with pytest.raises(InputError, match="one open path"):
        fmbd.read_line(tmp_path / "loop.geo")
    with pytest.raises(InputError, match="off the curve by 0.1 m"):
        fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], UNIT, stations={"side": (0.5, 0.1, 0.0)})


@pytest.mark.parametrize("kind", [fmbd.AbsoluteBody, fmbd.FloatingBody])
@pytest.mark.parametrize("join", [fmbd.fixed, fmbd.tie_surface])
def test_a_rod_continues_a_solid(kind, join):
    """Half a cantilever as a solid, half as a rod, welded or tied: the sag of a beam with shear."""
    E, side = 2e9, 0.1
    mesh = fmbd.read_gmsh(Path(__file__).parents[1] / "meshes/rod.py", dim=3, length=0.5, height=side, h=0.07)
    solid = kind("solid", mesh, degree=2, density=1000.0, elastic=fmbd.materials.linear_elastic(E, 0.3))
    section = fmbd.RodSection.rectangle(youngs_modulus=E, poisson_ratio=0.3, density=1000.0, width=side, height=side)
    rod = fmbd.Rod("rod", [(0.5, 0, 0), (1.0, 0, 0)], section, elements=2)
    scene = fmbd.Scene("half and half", gravity=(0, -9.81, 0))
    scene.add(solid, rod, fmbd.fixed("clamp", fmbd.ground, solid.surface("pin")))
    scene.add(join("weld", solid.surface("tip"), rod.surface("start")))
    scene.sensor("end", fmbd.sensors.position(rod.surface("end")))

    weight = 1000.0 * side**2 * 9.81
    sag = weight / (8 * E * side**4 / 12) + weight / 2 / (5 / 6 * E / 2.6 * side**2)
    assert -fmbd.equilibrium(scene)["end"][1] == pytest.approx(sag, rel=1e-2)


def test_a_further_rod_of_a_chain_costs_few_calls_at_the_start():
    """What is constant along all rods of a section is checked once, and places on a curve are found once."""
    section = fmbd.RodSection((1e4, 4e3, 4e3, 30.0, 20.0, 25.0), 1.0, (2e-3, 1e-3, 1e-3))
    calls = []
    for n in (3, 8, 24):
        scene, last = fmbd.Scene("rods", gravity=(0.0, -9.81, 0.0)), fmbd.ground
        for k in range(n):
            curve = np.array([(k, 0, 0), (k + 0.5, 0.1, 0), (k + 1, 0, 0)])
            rod = fmbd.Rod(f"rod {k}", curve, section, elements=3, degree=2)
            scene.add(rod, fmbd.spherical(f"ball {k}", last, rod.surface("start"), center=(k, 0, 0)))
            last = rod.surface("end")
        calls.append(calls_of(lambda scene=scene: fmbd.solve(scene, t_end=1e-3, dt=1e-3)))
    assert (calls[2] - calls[1]) / 16 < 850
