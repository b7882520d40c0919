"""Reduced bodies: the constants give the field's inertia, modes agree with beams, few modes approach the full body."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.fem.factors.factor import Factor
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.materials import linear_elastic, plane_stress
from fmbd_fenicsx.mechanics.elastic import modes
from fmbd_fenicsx.mechanics.elastic.floating import FloatingField
from fmbd_fenicsx.mechanics.elastic.modes import orthonormal_modes
from fmbd_fenicsx.mechanics.placements import Attached, Chord, FrameMotion, MeanAxis
from fmbd_fenicsx.mechanics.reduction import craig_bampton
from fmbd_fenicsx.mechanics.reduction.craig_bampton import FrameModes
from fmbd_fenicsx.mechanics.reduction.reduced import ReducedPart
from fmbd_fenicsx.rotations import motions

ROOT = Path(__file__).resolve().parents[1]
MODULUS, DENSITY = 5e6, 1000.0
FREE_FREE = (22.3733, 61.6728, 120.9034)  # (beta L)^2 of the free-free Euler-Bernoulli beam
CLAMPED = (3.51602, 22.0345, 61.6972)
PINNED = tuple((n * np.pi) ** 2 for n in (1, 2, 3))  # at both ends, one of which slides


def rod(mesh: Any, **changes: Any) -> fmbd.FloatingBody:
    return fmbd.FloatingBody("rod", mesh, density=DENSITY, elastic=linear_elastic(MODULUS, 0.3)).with_(**changes)


def pendulum(body: Any, dim: int = 2) -> fmbd.Scene:
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81, 0.0)[:dim])
    scene.add(body, fmbd.revolute("pin", body.surface("pin"), fmbd.ground))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return scene


@pytest.mark.smoke
@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("frame", [MeanAxis(), Attached("pin")])
def test_same_forces_as_the_field(rod_mesh: Callable[..., Any], dim: int, frame: Any) -> None:
    """At random motions the reduced rows are the field's rows, projected on the modes."""
    body = rod(rod_mesh(dim=dim, h=0.25), frame=frame, mass_damping=0.3, stiffness_damping=1e-3)
    small = body.reduced(modes=5)
    field = Field("rod", body.mesh, body.forms())
    full = FloatingField(field, 0, ["tip"], frame)
    part = ReducedPart("rod", small.constants, 0, ["tip"])
    phi = small.reduction.phi
    m = motions(dim)
    rng = np.random.default_rng(1)
    for _ in range(3):
        eta, rate, second = 0.1 * rng.standard_normal((3, 5))
        pose = m.compose(m.identity[None], rng.standard_normal((1, m.n_twist)))[0]
        gravity = rng.standard_normal(dim)
        motion = FrameMotion(
            0.0,
            m.matrix(pose[None])[0],
            rng.standard_normal(m.n_twist),
            rng.standard_normal(m.n_twist),
            gravity,
        )
        sums, rows = full.force(motion, (phi @ eta, phi @ rate, phi @ second))
        sums_, rows_ = part.force(motion, (eta, rate, second))
        np.testing.assert_allclose(sums_, sums, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(rows_, field.total(phi.T @ rows), rtol=1e-8, atol=1e-8)
        local, local_ = (phi @ eta, phi @ rate), (eta, rate)
        np.testing.assert_allclose(part.energies(motion, pose, local_), full.energies(motion, pose, local), rtol=1e-9)
        for a, b in zip(part.momenta(motion, pose, local_), full.momenta(motion, pose, local), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(part.ports_of(eta, 0.0), full.ports_of(phi @ eta, 0.0)[m.n_twist :], atol=1e-12)
    field.destroy()


@pytest.mark.parametrize("dim", [2, 3])
def test_mass_blocks_are_the_derivative_of_the_force(rod_mesh: Callable[..., Any], dim: int) -> None:
    """The force is affine in the accelerations, with the mass blocks as its matrix."""
    part = ReducedPart(
        "rod", rod(rod_mesh(dim=dim, h=0.25), frame=Attached("pin")).reduced(modes=4).constants, 0, ["tip"]
    )
    m = motions(dim)
    rng = np.random.default_rng(2)
    eta, rate = 0.3 * rng.standard_normal((2, 4))
    R = m.matrix(m.compose(m.identity[None], rng.standard_normal((1, m.n_twist))))[0]
    twist, zero = rng.standard_normal(m.n_twist), np.zeros(m.n_twist)

    def rows(accel: Any, second: Any) -> Any:
        return np.concatenate(part.force(FrameMotion(0.0, R, twist, accel, np.zeros(dim)), (eta, rate, second)))

    base = rows(zero, np.zeros(4))
    columns = [rows(e[: m.n_twist], e[m.n_twist :]) - base for e in np.eye(m.n_twist + 4)]
    ff, lf, ll = part.mass_blocks(FrameMotion(0.0, R, twist, None, np.zeros(dim)), eta)
    expected = np.block([[ff, lf.T], [lf, ll]])
    np.testing.assert_allclose(np.array(columns).T, expected, atol=1e-10 * np.abs(expected).max())


@pytest.mark.smoke
@pytest.mark.mpi
def test_free_clamped_and_pinned_modes_of_a_beam(rod_mesh: Callable[..., Any]) -> None:
    """Slender rod, plane stress: Euler-Bernoulli frequencies, free-free, clamped and pinned on average."""
    length, height = 1.0, 0.01
    mesh = rod_mesh(dim=2, h=0.02, length=length, height=height)
    body = fmbd.FloatingBody("rod", mesh, density=DENSITY, elastic=plane_stress(MODULUS, 0.3))
    unit = np.sqrt(MODULUS * height**2 / 12 / DENSITY) / length**2
    free = body.reduced(modes=3).reduction.omega / unit
    np.testing.assert_allclose(free, FREE_FREE, rtol=3e-3)
    clamped = body.with_(frame=Attached("pin")).reduced(modes=3).reduction.omega / unit
    np.testing.assert_allclose(clamped, CLAMPED, rtol=3e-3)
    pinned = body.with_(frame=Chord("pin", "tip")).reduced(modes=3).reduction.omega / unit
    np.testing.assert_allclose(pinned, PINNED, rtol=3e-3)


@pytest.mark.mpi
def test_modes_are_orthonormal_and_free_of_rigid_motion(rod_mesh: Callable[..., Any]) -> None:
    """phi^T M phi = 1, phi^T K phi = diag(omega^2), S = 0 and no angular momentum of the modes in mean axes."""
    body = rod(rod_mesh(dim=3, h=0.25))
    made = body.reduced(basis=fmbd.CraigBampton(("pin", "tip"), 4)).reduction
    field = Field("rod", body.mesh, body.forms())
    mass = np.stack([field.mass(p.reshape(-1, 3)).ravel() for p in made.phi.T], axis=1)
    np.testing.assert_allclose(field.total(made.phi.T @ mass), np.eye(len(made.omega)), atol=1e-9)
    stiff = field.total(made.phi.T @ np.stack([field.stiffness(p) for p in made.phi.T], axis=1))
    np.testing.assert_allclose(stiff, np.diag(made.omega**2), atol=1e-7 * made.omega.max() ** 2)
    assert np.abs(field.total(field.Q.T @ made.phi)).max() < 1e-9 * field.mass_total
    assert made.omega.min() > 1.0
    field.destroy()


@pytest.mark.mpi
def test_modes_do_not_depend_on_the_solver_that_found_them() -> None:
    """A bar of square section, which bends alike in all directions: with other starting columns its modes are the same."""
    body = rod(fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.2, 0.2), counts=(4, 1, 1), quads=True))
    field = Field("rod", body.mesh, body.forms())
    K, phi = orthonormal_modes(field, FrameModes(6).columns(field, field.Q), field.Q)
    squares = np.diag(K)
    assert squares[1] - squares[0] < 1e-9 * squares[0]
    mixed, _ = np.linalg.qr(np.random.default_rng(3).standard_normal((6, 6)))
    for turn in (mixed, -np.eye(6)):
        K_, phi_ = orthonormal_modes(field, phi @ turn, field.Q)
        np.testing.assert_allclose(K_, K, atol=1e-8 * squares.max())
        np.testing.assert_allclose(phi_, phi, atol=1e-6 * np.abs(phi).max())
    field.destroy()


def test_craig_bampton_converges_from_above(rod_mesh: Callable[..., Any]) -> None:
    """Frequencies fall monotonically to those of the full body as fixed-interface modes are added."""
    body = rod(rod_mesh(dim=2, h=0.1))
    exact = body.reduced(modes=4).reduction.omega
    found = [body.reduced(basis=fmbd.CraigBampton(("pin", "tip"), n)).reduction.omega[:4] for n in (1, 4, 12, 40)]
    for coarse, fine in zip(found, found[1:], strict=False):
        assert (fine <= coarse * (1 + 1e-9)).all()
    assert (found[-1] >= exact * (1 - 1e-9)).all()
    np.testing.assert_allclose(found[-1], exact, rtol=1e-3)


def test_plan_names_the_modes(rod_mesh: Callable[..., Any]) -> None:
    body = rod(rod_mesh(h=0.25))
    few, full = (fmbd.solve(pendulum(b), t_end=0.02, dt=0.01).plan for b in (body.reduced(modes=3), body))
    assert dict(few.unknowns) == {"frames": 3, "rod: modes": 3, "pin": 2}
    assert "modal reduction" not in few.left_out and "modal reduction" in full.left_out


@pytest.mark.mpi
def test_inertia_modes_hold_the_static_sag(rod_mesh: Callable[..., Any]) -> None:
    """A rod that hangs from both ends: with no vibration mode at all it sags as the field does under its weight."""

    def sag(body: Any) -> float:
        scene = fmbd.Scene("hung", gravity=(1.0, -9.81), settle=True)
        scene.add(body, fmbd.revolute("left", body.surface("pin"), fmbd.ground))
        scene.add(fmbd.point_on_line("right", fmbd.ground, body.surface("tip"), axis=(1, 0)))
        scene.sensor("side", fmbd.position(body.surface("side")))
        run = fmbd.solve(scene, t_end=0.02, dt=0.01)
        assert np.ptp(run["side"], axis=0).max() < 1e-9  # an equilibrium
        return float(run["side"][0, 1])

    full = rod(rod_mesh(h=0.1))
    exact = sag(full)
    with_inertia, without = (
        sag(full.reduced(basis=fmbd.CraigBampton(("pin", "tip"), 0, inertia=wanted))) for wanted in (True, False)
    )
    assert with_inertia == pytest.approx(exact, rel=1e-6)
    assert abs(without / exact - 1) > 1e-2


def test_all_modes_give_the_full_body(rod_mesh: Callable[..., Any]) -> None:
    """With every mode of a coarse field the run is the full run; with fewer the error falls."""
    body = rod(rod_mesh(dim=2, h=0.5, height=0.2), degree=1)
    full = fmbd.solve(pendulum(body), t_end=0.2, dt=2e-3)["tip"]
    count = body.reduced(modes=1).reduction.space.dofmap.index_map.size_global * 2 - 3
    errors = [
        np.abs(fmbd.solve(pendulum(body.reduced(modes=n)), t_end=0.2, dt=2e-3)["tip"] - full).max()
        for n in (0, 2, count)
    ]
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 1e-8


def test_selection_by_frequency(rod_mesh: Callable[..., Any]) -> None:
    """All modes up to the limit, and no other."""
    body = rod(rod_mesh(dim=2, h=0.1))
    omega = body.reduced(modes=12).reduction.omega
    limit = (omega[4] + omega[5]) / 4 / np.pi
    found = body.reduced(basis=FrameModes(frequency=limit)).reduction.omega
    np.testing.assert_allclose(found, omega[:5], rtol=1e-8)


def test_bad_input(rod_mesh: Callable[..., Any]) -> None:
    """More modes than unknowns, no selection, an energy, an interface that does not exist."""
    body = rod(rod_mesh(dim=2, h=0.5, height=0.2), degree=1)
    with pytest.raises(InputError, match="has only"):
        _ = body.reduced(modes=500).constants
    with pytest.raises(InputError, match="Give either"):
        body.reduced()
    with pytest.raises(InputError, match=r'Body "rod": a basis is given by its name, reduced\(basis=CraigBampton'):
        body.reduced(modes=fmbd.CraigBampton(("pin",), 2))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="not an energy"):
        _ = body.with_(elastic=None, energy=lambda u, dx: 0.5 * u[0] ** 2 * dx).reduced(modes=2).constants
    with pytest.raises(InputError, match="nose"):
        _ = body.reduced(basis=fmbd.CraigBampton(("nose",), 2)).constants


@pytest.mark.mpi
@pytest.mark.parametrize("frame", [MeanAxis(), Attached("pin")])
def test_initial_displacement_and_rate(rod_mesh: Callable[..., Any], frame: Any) -> None:
    """A bent and moving start: the reduced body begins where the full one does, and stays with it."""
    body = rod(rod_mesh(dim=2, h=0.2, height=0.2), frame=frame).with_(
        displacement=lambda x: 0.01 * np.array([-2 * x[0] * x[1], x[0] ** 2]),
        displacement_rate=lambda x: 0.3 * np.array([-2 * x[0] * x[1], x[0] ** 2]),
    )
    runs = []
    for made in (body, body.reduced(basis=fmbd.CraigBampton(("pin",), 8))):
        scene = pendulum(made)
        scene.sensor("rate", fmbd.velocity(made.surface("tip")))
        runs.append(fmbd.solve(scene, t_end=0.05, dt=1e-3))
    np.testing.assert_allclose(runs[0]["tip"][0], [1.0, 0.01], atol=1e-12)
    np.testing.assert_allclose(runs[0]["rate"][0], [0.0, 0.3], atol=1e-12)
    assert np.ptp(runs[0]["tip"][:, 1]) > 0.003
    np.testing.assert_allclose(runs[1]["tip"], runs[0]["tip"], atol=1e-4)
    np.testing.assert_allclose(runs[1]["rate"][0], runs[0]["rate"][0], atol=6e-3)


def test_warning_of_modes_that_miss_the_start(rod_mesh: Callable[..., Any], caplog: Any) -> None:
    """One mode cannot hold a stretch."""
    body = rod(rod_mesh(dim=2, h=0.2, height=0.2), displacement=lambda x: 1e-3 * np.array([x[0] ** 2, 0 * x[0]]))
    with caplog.at_level("WARNING", logger="fmbd_fenicsx"):
        _ = body.reduced(modes=1).constants
    assert "leave out 1" in caplog.text


def test_one_factor_makes_a_basis_and_looks_at_it(
    rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Modes, static ones beside them, and what these leave out of internal loads; of fields too large to be kept, too."""
    made = []
    monkeypatch.setattr(craig_bampton, "SMALL", 0)
    monkeypatch.setattr(modes, "Factor", lambda *args: made.append(args) or Factor(*args))

    def hot(v: Any, dx: Any, ds: Any) -> Any:
        return ufl.div(v) * dx

    body = rod(rod_mesh(dim=2, h=0.2, height=0.2), loads=(fmbd.Load(hot, internal=True),))
    reduction = body.reduced(basis=fmbd.CraigBampton(("pin", "tip"), 4)).reduction
    assert len(made) == 1 and reduction.field is None


NOTCHED = """
def build(gmsh, width):
    gmsh.model.add("plate")
    geo = gmsh.model.geo
    corners = [(0, -0.05), (1, -0.05), (1, 0.05), (0, 0.05), (0, width / 2), (0, -width / 2)]
    points = [geo.addPoint(x, y, 0.0, 0.05 if k < 4 else width) for k, (x, y) in enumerate(corners)]
    lines = [geo.addLine(points[k], points[k - 5]) for k in range(6)]
    plate = geo.addPlaneSurface([geo.addCurveLoop(lines)])
    geo.mesh.setTransfiniteCurve(lines[4], 2)
    geo.synchronize()
    gmsh.model.addPhysicalGroup(2, [plate], name="plate")
    gmsh.model.addPhysicalGroup(1, [lines[4]], name="held")
    gmsh.model.mesh.generate(2)
"""


def test_a_surface_of_one_small_facet_turns_by_itself(shared_tmp: Path) -> None:
    """Its static modes have strain and hardly any mass: a plate fixed there swings as slowly as the full one does."""
    width = 1e-4
    script = shared_tmp / "plate.py"
    script.write_text(NOTCHED)
    full = fmbd.FloatingBody("plate", fmbd.read_gmsh(script, width=width), density=1e3, elastic=plane_stress(1e7, 0.3))

    found = []
    for body in (full, full.reduced(basis=fmbd.CraigBampton(("held",), 4))):
        scene = fmbd.Scene("plate")
        scene.add(body, fmbd.fixed("pin", fmbd.ground, body.surface("held"), center=(0.0, 0.0)))
        found.append(fmbd.modes(scene, 3).frequencies[0])
    assert found[1] == pytest.approx(found[0], rel=1e-4)
    assert found[0] < 100.0 * width  # a clamp of the whole end gives 16 Hz


@pytest.mark.parametrize(("ratio", "told"), [(1e6, False), (1e12, True)])
def test_moduli_whose_roundoff_hides_modes_are_told(ratio: float, told: bool, caplog: pytest.LogCaptureFixture) -> None:
    def elastic(u: Any, v: Any, dx: Any) -> Any:
        stiff = ufl.conditional(ufl.lt(ufl.SpatialCoordinate(dx.ufl_domain())[0], 0.5), 1.0, ratio)
        return 1e7 * stiff * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * dx

    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.05), counts=(20, 2))
    body = fmbd.FloatingBody("beam", mesh, density=1.0, elastic=elastic)
    assert len(body.reduced(basis=fmbd.CraigBampton(("left", "right"), 4)).reduction.omega) >= 4
    assert ("roundoff of its stiffness" in caplog.text) is told


@pytest.mark.parametrize("dim", [2, 3])
def test_inertia_modes_hold_a_steady_spin(rod_mesh: Callable[..., Any], dim: int) -> None:
    """Without one vibration mode the stretch under the centrifugal forces is that of the field."""
    elastic = linear_elastic(MODULUS, 0.3)
    whole = fmbd.FloatingBody("rod", rod_mesh(dim=dim, h=0.2), density=DENSITY, elastic=elastic)
    places = []
    for body in (whole, whole.reduced(basis=fmbd.CraigBampton(("pin",), 0, inertia=True))):
        scene = fmbd.Scene("spin")
        scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin")))
        scene.sensor("tip", fmbd.position(body.surface("tip")))
        places.append(np.linalg.norm(fmbd.equilibrium(scene, spin=fmbd.Spin(0.5))["tip"]) - 1.0)
    assert places[0] > 1e-5
    assert places[1] == pytest.approx(places[0], rel=1e-3)
