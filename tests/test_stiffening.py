"""Geometric stiffening of solids: frequencies of a spinning cantilever, full and reduced alike, refusal without it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg as sl

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError, InputError
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.fem.loads import pressure, traction
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.materials import plane_stress
from fmbd_fenicsx.mechanics.elastic.floating import FloatingField
from fmbd_fenicsx.mechanics.placements import Approach, Attached, FrameMotion
from fmbd_fenicsx.mechanics.reduction.reduced import ReducedPart
from fmbd_fenicsx.schemes.consistent import accelerations, consistent

MESHES = Path(__file__).parents[1] / "meshes"
MODULUS, DENSITY, HEIGHT = 1e9, 1000.0, 0.02
UNIT = np.sqrt(MODULUS * HEIGHT**2 / 12 / DENSITY)  # rad/s, length 1 m
WILD = 3e-3  # m, of nodes to and fro
QUIET = fmbd.Output(estimate_error=False)
LAG = {0: 3.5160, 3: 3.7435, 5: 4.0739, 10: 5.0490}  # of the rotating cantilever in its plane, by a Ritz solution


def blade(mesh: Any, stiffening: bool = True) -> fmbd.FloatingBody:
    return fmbd.FloatingBody(
        "blade", mesh, density=DENSITY, elastic=plane_stress(MODULUS, 0.3), frame=Attached("pin"), stiffening=stiffening
    )


def steady(rate: float) -> FrameMotion:
    """Rotation about the root; the frame's origin is the middle."""
    return FrameMotion(
        0.0, np.eye(2), np.array([0.0, 0.5 * rate, rate]), np.array([-0.5 * rate**2, 0.0, 0.0]), np.zeros(2)
    )


@pytest.mark.mpi
@pytest.mark.parametrize("rate", list(LAG))
def test_rotating_cantilever(rod_mesh: Callable[..., Any], rate: int) -> None:
    """The lag frequency to 3e-3: at 1 : 50 shear, rotary inertia and stretch cost that; test_rotating_arm.py has 1 : 200."""
    c = blade(rod_mesh(dim=2, h=0.04, height=HEIGHT)).reduced(modes=6).constants
    part, zero = ReducedPart("blade", c, 0, []), np.zeros(c.n_modes)
    motion = steady(rate * UNIT)
    columns = [part.force(motion, (s * 1e-6 * e, zero, zero))[1] for e in np.eye(c.n_modes) for s in (1.0, -1.0)]
    K = np.array([(a - b) / 2e-6 for a, b in zip(columns[::2], columns[1::2], strict=True)]).T
    mass = np.trace(c.T[1:, 1:], axis1=2, axis2=3)
    found = np.sqrt(sl.eigh(0.5 * (K + K.T), mass, eigvals_only=True)[0]) / UNIT
    np.testing.assert_allclose(found, LAG[rate], rtol=3e-3)


@pytest.mark.mpi
def test_reduced_stiffening_is_the_field_projected(rod_mesh: Callable[..., Any]) -> None:
    """At a random motion the reduced rows are the full rows on the modes, with loads that turn with the blade too."""
    loads = pressure("tip", 2e4), traction("side", (3e3, -5e3), follower=True), traction("tip", (0.0, 1e4))
    body = blade(rod_mesh(dim=2, h=0.1, height=0.1)).with_(loads=loads)
    made = body.reduced(modes=4)
    field = Field("blade", body.mesh, body.forms())
    full, part = FloatingField(field, 0, [], body.frame, "pin"), ReducedPart("blade", made.constants, 0, [])
    rng = np.random.default_rng(3)
    motion = FrameMotion(0.0, np.eye(2), rng.standard_normal(3), 1e3 * rng.standard_normal(3), rng.standard_normal(2))
    phi, n = made.reduction.phi, made.constants.n_modes
    eta, rate, second = 1e-2 * rng.standard_normal((3, n))
    full_local, local = (phi @ eta, phi @ rate, phi @ second), (eta, rate, second)
    on_frame, rows = full.force(motion, full_local)
    power = full.given(motion, full_local[:2])
    expected = field.total(phi.T @ rows)
    frame, modes = part.force(motion, local)
    np.testing.assert_allclose(modes, expected, atol=1e-8 * np.abs(expected).max())
    np.testing.assert_allclose(frame, on_frame, atol=1e-8 * np.abs(on_frame).max())
    assert part.given(motion, local[:2]) == pytest.approx(power, rel=1e-9)
    field.destroy()


def column(frame: str, side: tuple[str, ...], load: float, *, reduced: bool) -> fmbd.Body:
    """Of length 1, pressed by this force along itself over the pressure on these sides."""
    mesh = fmbd.read_gmsh(MESHES / "block.py", size=(1.0, 0.05), counts=(12, 1), origin=(0.0, -0.025))
    held: dict[str, Any] = (
        {"stiffening": "left"} if frame == "mean" else {"frame": Attached("left"), "stiffening": True}
    )
    loads = [pressure(s, load / 0.05) for s in side]
    body = fmbd.FloatingBody("column", mesh, density=DENSITY, elastic=plane_stress(1e7, 0.3), loads=loads, **held)
    return body.reduced(basis=fmbd.CraigBampton(("left", "right"), 8)) if reduced else body


@pytest.mark.parametrize(("frame", "reduced"), [("mean", True), ("attached", True), ("attached", False)])
def test_pressures_turn_with_the_surfaces_of_a_column(frame: str, reduced: bool) -> None:
    """Pressed from all sides beyond Euler's load it vibrates on pins as without; by its end it flutters from Beck's load on."""
    stiffness = 1e7 * 0.05**3 / 12

    def eigenvalues(load: float, side: tuple[str, ...], *, pinned: bool) -> Any:
        body = column(frame, side, load * stiffness, reduced=reduced)
        scene = fmbd.Scene("column")
        hold = fmbd.revolute if pinned else fmbd.fixed
        scene.add(body, hold("foot", fmbd.ground, body.surface("left"), center=(0, 0)))
        if pinned:
            scene.add(fmbd.point_on_line("guide", fmbd.ground, body.surface("right"), center=(1, 0), axis=(1, 0)))
        return fmbd.modes(scene, 2, at=fmbd.equilibrium(scene)).eigenvalues

    all_sides = ("left", "right", "bottom", "top")
    free, pressed = (eigenvalues(load, all_sides, pinned=True) for load in (0.0, 1.2 * np.pi**2))
    np.testing.assert_allclose(pressed, free, rtol=5e-3, atol=1e-6)
    stable, flutter = (eigenvalues(load, ("right",), pinned=False).real for load in (19.4, 20.4))  # Beck: 20.05
    assert np.abs(stable).max() < 1e-6
    assert flutter.max() > 1.0


def test_loads_cost_the_directions_in_which_they_act(rod_mesh: Callable[..., Any]) -> None:
    """A load along one axis, along the other by roundoff: beside d + d^2 of inertia, stress of that one."""
    scene, along = fmbd.Scene("pulled"), (2e4 * np.cos(0.5 * np.pi), 2e4)
    scene.add(blade(rod_mesh(dim=2, h=0.1, height=0.1)).with_(loads=(traction("tip", along),)))
    system, _, _ = scene.build()
    stiffening = system.part("blade")[1].stiffening
    bent = stiffening.bent(np.random.default_rng(1).standard_normal(len(stiffening.columns)))

    acts = np.abs(bent).max(axis=0) > 0
    assert acts.tolist() == [True] * 6 + [False, False, True, True]


@pytest.mark.parametrize("kind", ["floating", "reduced", "beam"])
def test_refused_without(rod_mesh: Callable[..., Any], caplog: Any, kind: str) -> None:
    """Above the first frequency the softened blade diverges: a warning, then an error that says what to do."""
    rate = 5.0 * UNIT
    solid = blade(rod_mesh(dim=2, h=0.1, height=HEIGHT), stiffening=False)
    solid = solid.with_(velocity=(0.0, 0.5 * rate), angular_velocity=rate)
    section = fmbd.Section.rectangle(
        youngs_modulus=MODULUS, poisson_ratio=0.3, density=DENSITY, width=1.0, height=HEIGHT
    )
    bodies: dict[str, tuple[Any, str]] = {
        "floating": (solid, "pin"),
        "reduced": (solid.reduced(modes=4), "pin"),
        "beam": (
            fmbd.Beam("blade", (0, 0), (1, 0), section, velocity=(0.0, 0.5 * rate), angular_velocity=rate),
            "start",
        ),
    }
    body, root = bodies[kind]
    scene = fmbd.Scene("spin", gravity=(0.0, -1.0))
    hub = fmbd.RigidBody("hub", mass=1.0, inertia=1.0, position=(0.0, 0.0), angular_velocity=rate)
    scene.add(body, hub, fmbd.revolute("axle", fmbd.ground, hub, center=(0, 0)))
    scene.add(fmbd.fixed("weld", hub, body.surface(root)))
    scene.add(fmbd.drive_rotation("motor", fmbd.ground, hub, lambda t: (rate * t, rate, 0.0)))
    with caplog.at_level("WARNING", logger="fmbd_fenicsx"), pytest.raises(ConvergenceError, match="stiffening=True"):
        fmbd.solve(scene, t_end=40.0 / UNIT, dt=0.1 / rate)
    assert "first bending frequency" in caplog.text


def test_a_stiffened_body_bent_too_far_is_not_told_to_stiffen(rod_mesh: Callable[..., Any]) -> None:
    for stiffening, advice in ((True, "smaller dt"), (False, "stiffening=True")):
        c = blade(rod_mesh(dim=2, h=0.1, height=0.1), stiffening).reduced(modes=4).constants
        part, far = ReducedPart("blade", c, 0, []), 1e3 * np.ones(c.n_modes)
        with pytest.raises(ConvergenceError, match=advice):
            part.force(steady(1.0), (far, 0 * far, 0 * far))


def test_the_end_of_a_bent_column_comes_closer_and_energy_is_kept() -> None:
    """A pinned column falls sideways and pulls its slider: by int v'^2 / 2, about 2.5 times the square of the deflection.

    Neither joint forces nor the stress of the column's own inertia do any work: what is left is of second order in the step.
    """
    section = fmbd.Section(EA=1e4, EI=1.0, rhoA=1.0, rhoI=1e-4)
    beam = fmbd.Beam("column", (0, 0), (1, 0), section, elements=4, modes=6, stiffening=True, attached=False)
    slider = fmbd.RigidBody("slider", mass=2.0, inertia=1.0, position=(1.0, 0.0))
    scene = fmbd.Scene("column", gravity=(0.0, -3.0))
    scene.add(beam, slider, fmbd.revolute("pin", fmbd.ground, beam.surface("start"), center=(0, 0)))
    scene.add(fmbd.revolute("head", slider, beam.surface("end"), center=(1, 0)))
    scene.add(fmbd.prismatic("guide", fmbd.ground, slider, center=(1, 0), axis=(1, 0)))
    scene.sensor("head", fmbd.position(slider))
    run = fmbd.solve(scene, t_end=1.0, dt=2e-3, scheme=fmbd.GeneralizedAlpha(0.9), output=QUIET)
    total, elastic = run.total_energy, run.energy["elastic"].max()
    assert np.abs(total - total[0]).max() < 1e-5 * elastic
    # a half sine of amplitude A holds the energy pi^4 EI A^2 / 4 and is shorter by pi^2 A^2 / 4
    np.testing.assert_allclose(np.ptp(run["head"][:, 0]), elastic / np.pi**2, rtol=0.03)


@pytest.mark.parametrize("kind", ["floating", pytest.param("mean axes", marks=pytest.mark.mpi), "reduced", "beam"])
def test_a_blade_that_swings_freely(rod_mesh: Callable[..., Any], kind: str) -> None:
    """From its pin, under gravity: the tip of a solid by an energy, and energy is kept to the second order of the step."""
    solid = blade(rod_mesh(dim=2, h=0.1, height=0.04)).with_(elastic=plane_stress(1e8, 0.3))
    section = fmbd.Section.rectangle(youngs_modulus=1e8, poisson_ratio=0.3, density=DENSITY, width=1.0, height=0.04)
    bodies: dict[str, tuple[Any, str, str]] = {
        "floating": (solid, "pin", "tip"),
        "mean axes": (solid.with_(frame=fmbd.MeanAxis(), stiffening="pin"), "pin", "tip"),
        "reduced": (solid.reduced(modes=3), "pin", "tip"),
        "beam": (fmbd.Beam("blade", (0, 0), (1, 0), section, elements=4, modes=6, stiffening=True), "start", "end"),
    }
    body, root, tip = bodies[kind]
    scene = fmbd.Scene("swing", gravity=(0.0, -9.81))
    scene.add(body, fmbd.revolute("pin", body.surface(root), fmbd.ground, center=(0, 0)))
    scene.sensor("tip", fmbd.position(body.surface(tip)))
    drift = []
    for dt in (4e-3, 1e-3):
        run = fmbd.solve(scene, t_end=0.2, dt=dt, output=QUIET)
        drift.append(np.abs(run.total_energy - run.total_energy[0]).max())
    # the tip of an absolute body with the full nonlinear strain, at steps of 0.5 ms
    np.testing.assert_allclose(run["tip"][-1], [0.957732, -0.287791], atol=1e-4)
    assert drift[1] < 2e-4 and drift[1] < drift[0] / 4


def test_accelerations_behind_a_tangent_far_away(rod_mesh: Callable[..., Any]) -> None:
    """Found with inertia of a body bent wildly they grow at first: what comes out is right, and so is the tangent left behind."""
    law: dict[str, Any] = {"elastic": plane_stress(1e8, 0.3), "stiffening": "pin", "loads": (pressure("side", 1e3),)}
    rod = fmbd.FloatingBody("rod", rod_mesh(h=0.25), density=DENSITY, **law)
    scene = fmbd.Scene("pressed", gravity=(0.0, -9.81))
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
    system, given, _ = scene.build()
    solver = StepSolver(system)
    start, _ = consistent(system, given, solver)
    k, part = system.fields[0]
    q = start.q.copy()
    system.local_q(q, k)[:] = WILD * np.where(np.arange(part.n) % 3, 1.0, -1.0)
    system.at(0.0, q, start.v).take_tangents()

    found = accelerations(system, start, solver)
    np.testing.assert_allclose(found.a, start.a, rtol=1e-9, atol=1e-9 * np.abs(start.a).max())
    left: Any = part
    assert np.abs(left._tangent_at.load[0]).max() < 100.0  # m/s^2 and 1/s^2 beside 9.81

    # where a motion is foretold, node by node, the tangent is that of the body before
    predicted = Approach(system.local_q(q, k), predicted=True)
    system.at(0.0, q, start.v).take_tangents(increments={k: predicted})
    assert not left._tangent_at.U.any()


def test_needs_an_attached_frame(rod_mesh: Callable[..., Any]) -> None:
    """Mean axes have no surface that carries the inertia forces: it must be named, and exist."""
    body = blade(rod_mesh(dim=2, h=0.1, height=HEIGHT))
    with pytest.raises(InputError, match="attached"):
        body.with_(frame=fmbd.MeanAxis())
    with pytest.raises(InputError, match='no surface "nose"'):
        body.with_(frame=fmbd.MeanAxis(), stiffening="nose")
    with pytest.raises(InputError, match="an energy stiffens by itself"):
        body.with_(elastic=None, energy=lambda u, dx: u[0] * dx)


def spun_up(body: Any, root: str, tip: str, gamma: float = 5.0, steps: int = 300) -> Any:
    """Tip of an arm that a hub brings to gamma UNIT, above its first frequency, in rotating axes."""
    rate, T = gamma * UNIT, 24.0 / UNIT

    def turn(t: float) -> tuple[float, float, float]:
        w = 2 * np.pi / T
        return (
            rate / T * (t * t / 2 + (np.cos(w * t) - 1) / w**2),
            rate / T * (t - np.sin(w * t) / w),
            rate / T * (1 - np.cos(w * t)),
        )

    hub = fmbd.RigidBody("hub", mass=1.0, inertia=1.0, position=(0.0, 0.0))
    scene = fmbd.Scene("spin-up")
    scene.add(body, hub, fmbd.revolute("axle", fmbd.ground, hub, center=(0, 0)))
    scene.add(fmbd.fixed("weld", hub, body.surface(root)), fmbd.drive_rotation("motor", fmbd.ground, hub, turn))
    scene.sensor("tip", fmbd.position(body.surface(tip)))
    run = fmbd.solve(scene, t_end=T, dt=T / steps, scheme=fmbd.GeneralizedAlpha(0.8), output=QUIET)
    theta = np.array([turn(t)[0] for t in run.times])
    return np.cos(theta) * run["tip"][:, 1] - np.sin(theta) * run["tip"][:, 0]


def test_every_frame_stiffens(rod_mesh: Callable[..., Any]) -> None:
    """Spin-up above the first frequency: mean axes follow the attached frame."""
    body = blade(rod_mesh(dim=2, h=0.1, height=HEIGHT))
    free = body.with_(frame=fmbd.MeanAxis(), stiffening="pin")
    reference = spun_up(body.reduced(modes=4), "pin", "tip")
    size = np.abs(reference).max()
    assert size > 0.02
    found = {
        "attached": spun_up(body, "pin", "tip"),
        "mean axes, reduced": spun_up(free.reduced(basis=fmbd.CraigBampton(("pin",), 4)), "pin", "tip"),
        "mean axes": spun_up(free, "pin", "tip"),
    }
    for name, tip in found.items():  # frames differ by the square of the rotation in them, about size / 1 m
        assert np.abs(tip - reference).max() < 0.5 * size**2, name


def test_mixed_bodies_stiffen(rod_mesh: Callable[..., Any]) -> None:
    """The same with displacement-pressure bodies."""
    strain = blade(rod_mesh(dim=2, h=0.1, height=HEIGHT)).with_(elastic=fmbd.materials.plane_strain(MODULUS, 0.3))
    mixed = strain.with_(elastic=fmbd.materials.nearly_incompressible(MODULUS, 0.3))
    both = [spun_up(b.reduced(modes=4), "pin", "tip") for b in (strain, mixed)]
    size = np.abs(both[0]).max()
    assert size > 0.02
    np.testing.assert_allclose(*both, atol=3e-3 * size)  # pressure and displacements of degree 1 and 2: another element
    np.testing.assert_allclose(spun_up(mixed, "pin", "tip"), both[1], atol=0.01 * size)


@pytest.mark.parametrize("kind", ["floating", "reduced", "beam"])
def test_ports_of_second_order_are_differentiated(rod_mesh: Callable[..., Any], kind: str) -> None:
    """G and gamma of a bent body's joint are the first and second differences of its constraint; G^T is the transpose."""
    solid = blade(rod_mesh(dim=2, h=0.1, height=HEIGHT))
    section = fmbd.Section(EA=1e5, EI=100.0, rhoA=1.0)
    bodies: dict[str, tuple[Any, str]] = {
        "floating": (solid, "tip"),
        "reduced": (solid.reduced(modes=3), "tip"),
        "beam": (fmbd.Beam("blade", (0, 0), (1, 0), section, elements=2, stiffening=True), "end"),
    }
    body, tip = bodies[kind]
    scene = fmbd.Scene("weld")
    scene.add(body, fmbd.fixed("weld", fmbd.ground, body.surface(tip)))
    system, state, _ = scene.build()
    rng = np.random.default_rng(1)
    v = rng.standard_normal(system.n_v)
    for k, p in enumerate(system.parts):  # a smooth motion: the field of linear functions of place, or any modes
        X = getattr(getattr(p, "field", None), "X", None)
        smooth = rng.standard_normal(p.n) if X is None else (X**2 @ rng.standard_normal((2, 2))).ravel()
        v[system.slices[1][k]] = 0.1 * smooth / np.abs(smooth * system.units[system.slices[1][k]]).max()
    q = system.compose(state.q, 0.5 * v)

    def g(s: float) -> Any:
        return system.at(0.0, system.compose(q, s * v)).constraint()

    ev, lam = system.at(0.0, q, v), rng.standard_normal(system.n_lam)
    assert system.curved and np.abs(ev.port - system.ports(q, 0.0)).max() > 1e-4
    rates = ev.jacobian.times(v)
    np.testing.assert_allclose((g(1e-5) - g(-1e-5)) / 2e-5, rates, atol=1e-8 * np.abs(rates).max())
    second = (g(1e-3) - 2 * g(0.0) + g(-1e-3)) / 1e-6
    np.testing.assert_allclose(second, ev.gamma(), atol=1e-5 * np.abs(second).max())
    np.testing.assert_allclose(system.dot(ev.jacobian.transposed(lam), v), lam @ rates, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_floating_and_nonlinear_solid_agree_at_spin(rod_mesh: Callable[..., Any]) -> None:
    """Spin-up to gamma = 5.55: the deflections of a total Lagrangian solid and of the stiffened floating body, to 1 %."""
    body = blade(rod_mesh(dim=2, h=0.1, height=HEIGHT))
    energy = fmbd.materials.sheet_saint_venant_kirchhoff(MODULUS, 0.3)
    large = fmbd.AbsoluteBody("blade", body.mesh, density=DENSITY, energy=energy)
    reference = spun_up(large, "pin", "tip", 5.55, 1200)
    found = spun_up(body, "pin", "tip", 5.55, 1200)
    size = np.abs(reference).max()
    assert size > 0.03
    np.testing.assert_allclose(found, reference, atol=0.01 * size)


def test_energy_momentum_knows_the_shortening_of_its_ports(rod_mesh: Callable[..., Any]) -> None:
    """A spring pulls at the end of a pendulum that pressure bends: as generalized-alpha, with an error of second order."""
    mesh = rod_mesh(dim=2, h=0.25, height=0.1)
    rod = fmbd.FloatingBody(
        "rod", mesh, density=DENSITY, elastic=plane_stress(2e7, 0.3), frame=Attached("pin"), stiffening=True,
        stiffness_damping=2e-4, loads=[fmbd.body_force((0.0, 3e4), time=lambda t: np.sin(20.0 * t))],
    ).reduced(basis=fmbd.CraigBampton(("pin", "tip"), 4))  # fmt: skip
    scene = fmbd.Scene("pulled", gravity=(0.0, -9.81))
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0.0, 0.0)))
    scene.add(
        fmbd.Spring("spring", fmbd.ground, rod.surface("tip"), (1.0, -0.5), (1.0, 0.0), stiffness=2e3, length=0.2)
    )
    scene.sensor("tip", fmbd.position(rod.surface("tip")))

    def off(h: float) -> float:
        schemes = fmbd.EnergyMomentum(), fmbd.GeneralizedAlpha(0.9)
        found, other = (
            fmbd.solve(scene, t_end=0.2, dt=h, scheme=scheme, output=QUIET)["tip"][-1] for scheme in schemes
        )
        return float(np.abs(found - other).max())

    coarse, fine = off(4e-3), off(2e-3)
    assert fine < 0.4 * coarse


@pytest.mark.parametrize("clamped", [False, pytest.param(True, marks=pytest.mark.mpi)])
def test_forces_of_ties_stiffen_as_those_of_joints(rod_mesh: Callable[..., Any], clamped: bool) -> None:
    """A column clamped at its foot, with a plate on its top that presses with a share f of Euler's load: its frequency falls by
    some sqrt(1 - f), whatever holds the plate and the foot; swings in runs are the same.
    """
    share, load = 0.8, np.pi**2 / 4 * MODULUS * HEIGHT**3 / 12  # of 1 m in height and 1 m across
    mesh = rod_mesh(dim=2, h=0.04, height=HEIGHT)

    def column(tied: bool, share: float) -> fmbd.Scene:
        rod = fmbd.FloatingBody("rod", mesh, density=DENSITY, elastic=plane_stress(MODULUS, 0.3), stiffening="pin")
        plate = fmbd.RigidBody("plate", 0.1, 1e-5, position=(1.0, 0.0))
        scene = fmbd.Scene("column", gravity=(0.0, 1e-3))
        foot = fmbd.tie_surface if tied and clamped else fmbd.fixed
        top = fmbd.tie_surface if tied else fmbd.fixed
        scene.add(rod, plate, foot("foot", rod.surface("pin"), fmbd.ground), top("top", rod.surface("tip"), plate))
        scene.add(fmbd.force("press", plate, lambda t: (-share * load, 0.0)))
        scene.sensor("plate", fmbd.position(plate))
        return scene

    free, held, tied = (
        fmbd.modes(scene, 1, at=fmbd.equilibrium(scene)).frequencies[0]
        for scene in (column(False, 0.0), column(False, share), column(True, share))
    )
    assert abs(held / free - np.sqrt(1 - share)) < 0.02
    assert abs(tied / held - 1) < 5e-3

    joint, tie = (fmbd.solve(column(tied, share), t_end=0.4, dt=5e-3, output=QUIET)["plate"] for tied in (False, True))
    assert np.ptp(joint[:, 1]) > 2e-6
    np.testing.assert_allclose(tie[:, 1], joint[:, 1], atol=1e-2 * np.ptp(joint[:, 1]))
