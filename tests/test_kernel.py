"""The compiled step of spatial and of reduced elastic bodies against the NumPy step."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from test_compiled import pair, stepper_of

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError
from fmbd_fenicsx.schemes.onestep.alpha.alpha_stepper import AlphaStepper
from fmbd_fenicsx.schemes.onestep.alpha.compiled_stepper import CompiledAlphaStepper
from fmbd_fenicsx.schemes.onestep.alpha.generalized_alpha import GeneralizedAlpha

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.compiled
PLANE = fmbd.Section(EA=1e5, EI=40.0, rhoA=0.5, rhoI=1e-4)
SPACE = fmbd.Section(EA=1e5, EI=40.0, rhoA=0.5, rhoI=1e-4, GA=1e5, EI_y=50.0, GJ=20.0, rhoI_y=2e-4)


def rigid() -> fmbd.Scene:
    """Spatial rigid bodies, every elementary constraint, both drives, a locked body."""
    scene = fmbd.Scene("rigid", gravity=(0.3, 0.2, -9.81), gravity_ramp=0.05)
    J = np.array([[0.02, 0.003, 0.001], [0.003, 0.03, 0.002], [0.001, 0.002, 0.025]])
    at = [(0.2, 0.0, 0.0), (0.5, 0.1, 0.0), (0.8, 0.0, 0.2), (2.0, 0.0, 0.0), (3.0, 0.5, 0.0), (4.0, 0.0, 0.0)]
    turned = (0.1, 0.2, 0.3, np.sqrt(0.86))
    b = [fmbd.RigidBody(f"{i}", 1.0 + i, J, x, turned if i % 2 else None) for i, x in enumerate(at)]
    base = fmbd.RigidBody("base", 1.0, J, position=(0.0, 0.0, 1.0), rotation=turned, locked=True)
    scene.add(base, *b, fmbd.revolute("r", fmbd.ground, b[0], center=(0, 0, 0), axis=(0.1, 1, 0)))
    scene.add(fmbd.universal("u", b[0], b[1], center=(0.35, 0, 0), axis_a=(0, 1, 0), axis_b=(0, 0, 1)))
    scene.add(fmbd.spherical("s", b[1], b[2], center=(0.6, 0.1, 0.1)))
    scene.add(fmbd.distance("d", base, b[2], point_b=(0.8, 0.1, 0.2), length=np.sqrt(1.29)))
    scene.add(fmbd.prismatic("p", fmbd.ground, b[3], axis=(1, 0.2, 0.3), center=(2, 0, 0)))
    move = fmbd.drive_translation("push", fmbd.ground, b[3], lambda t: 0.2 * np.sin(9 * t), axis=(1, 0.2, 0.3))
    scene.add(move, fmbd.cylindrical("c", fmbd.ground, b[4], axis=(0, 0, 1), center=(3, 0, 0)))
    scene.add(fmbd.drive_rotation("motor", fmbd.ground, b[4], lambda t: 3 * t + t**2, axis=(0, 0, 1)))
    scene.add(fmbd.point_on_line("wire", b[3], b[5], axis=(0, 0, 1), center=(4, 0, 0)))
    return scene


def flexible(dim: int) -> fmbd.Scene:
    """Reduced bodies (one stiffened, one damped), joints off the centroids of their surfaces, a rigid bob."""
    section = PLANE if dim == 2 else SPACE
    points = [np.array(x[:dim]) for x in ((0.0, 0.0, 0.0), (0.6, 0.3, 0.2), (1.1, 0.1, 0.0), (1.1, 0.0, 0.0))]
    one = fmbd.Beam("one", points[0], points[1], section, elements=4, modes=7, stiffening=True)
    two = fmbd.Beam("two", points[1], points[2], section, elements=3, attached=False, stiffness_damping=1e-3)
    bob = fmbd.RigidBody("bob", 0.3, 0.01 if dim == 2 else (0.01, 0.02, 0.015), points[3])
    scene = fmbd.Scene("flexible", gravity=(0.0, -9.81, 0.0)[:dim])
    start, knee = one.surface("start"), two.surface("start")
    scene.add(one, two, bob, fmbd.revolute("hinge", fmbd.ground, start, center=points[0] + 0.05))
    scene.add(fmbd.spherical("knee", one.surface("end"), knee, center=points[1]))
    scene.add(fmbd.fixed("hand", two.surface("end"), bob, center=points[3]))
    scene.sensor("end", fmbd.position(bob))
    return scene


def soft_pendulum(mesh: Any, modes: int, **changes: Any) -> fmbd.Scene:
    """A rod of rubber on a spherical joint, reduced."""
    rod = fmbd.FloatingBody("rod", mesh, density=1000.0, elastic=fmbd.materials.linear_elastic(1e7, 0.3))
    body = rod.with_(**changes).reduced(modes=modes)
    scene = fmbd.Scene("pendulum", gravity=(0, -9.81, 0)[: mesh.dim])
    scene.add(body, fmbd.spherical("pin", fmbd.ground, body.surface("pin")))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return scene


def agree(fast: fmbd.Run, slow: fmbd.Run, *, rates: float = 1e-9) -> None:
    """Equal to roundoff: in q a few units, in a and lambda those over h^2; ``rates``: share that v may differ by."""
    assert fast.counters["newton_iterations"] == slow.counters["newton_iterations"]
    for name, bar in (("q", 1e-12), ("v", rates), ("a", 1e-6), ("lam", 1e-6)):
        x, y = getattr(fast.state, name), getattr(slow.state, name)
        assert np.abs(x - y).max() < bar * np.abs(y).max(), name
    assert fast.local_error == pytest.approx(slow.local_error, rel=1e-5)


@pytest.mark.parametrize("make", [rigid, lambda: flexible(2), lambda: flexible(3)], ids=["rigid", "2", "3"])
def test_same_digits_as_numpy(make: Any) -> None:
    assert isinstance(stepper_of(make()), CompiledAlphaStepper)
    agree(*pair(make, t_end=0.1, dt=1e-3))


@pytest.mark.parametrize("dim, modes", [(2, 5), (3, 16), (3, 0)])
def test_same_digits_for_a_meshed_body(rod_mesh: Callable[..., Any], dim: int, modes: int) -> None:
    agree(*pair(lambda: soft_pendulum(rod_mesh(dim=dim, h=0.25), modes), t_end=0.1, dt=1e-3))


def floating(mesh: Any, frame: Any, **changes: Any) -> fmbd.Scene:
    """Two floating rods, the second from the middle of the first's tip on, and a rigid bob at its end."""
    d = mesh.dim
    elastic = fmbd.materials.linear_elastic(3e7, 0.3) if d == 3 else fmbd.materials.plane_stress(3e7, 0.3)
    one = fmbd.FloatingBody("one", mesh, **({"density": 1000.0, "elastic": elastic, "frame": frame} | changes))
    two = fmbd.FloatingBody("two", mesh, density=1000.0, elastic=elastic)
    bob = fmbd.RigidBody("bob", 2.0, 0.01 if d == 2 else (0.01, 0.02, 0.015), position=(1.0, 0.4, 0.0)[:d])
    scene = fmbd.Scene("floating", gravity=(0.3, -9.81, 0.2)[:d])
    scene.add(one, two, bob, fmbd.revolute("hinge", fmbd.ground, one.surface("pin"), center=(0.0, 0.02, 0.0)[:d]))
    scene.add(fmbd.spherical("bob on one", one.surface("tip"), bob, center=(1.0, 0.0, 0.0)[:d]))
    scene.add(fmbd.fixed("two on one", one.surface("tip"), two.surface("tip")))
    return scene


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("frame", ["mean axis", "attached", "chord"])
def test_same_digits_for_floating_bodies(rod_mesh: Callable[..., Any], dim: int, frame: str) -> None:
    """Every frame; ports that the factor's columns do not hold, two bodies with one factor each, stiffness damping."""
    kind = {"mean axis": fmbd.MeanAxis(), "attached": fmbd.Attached("pin"), "chord": fmbd.Chord("pin", "tip")}[frame]
    fast, slow = pair(lambda: floating(rod_mesh(dim=dim, h=0.25), kind, stiffness_damping=1e-4), t_end=0.02, dt=5e-4)
    assert fast.counters["compiled_steps"] >= 38  # but for the start, and the first new tangent of a mean frame
    assert fast.counters["back_solves"] <= 1.02 * slow.counters["back_solves"]  # which begins its step anew
    agree(fast, slow)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("frame", [fmbd.MeanAxis(), fmbd.Attached("pin"), fmbd.Chord("pin", "tip")], ids=str)
def test_stabilised_form_of_floating_bodies(rod_mesh: Callable[..., Any], dim: int, frame: Any) -> None:
    """Both levels closed, frame conditions among them, with the factors of the fields: the digits of NumPy."""
    mesh = rod_mesh(dim=dim, h=0.25)
    scene = lambda: floating(mesh, frame, stiffness_damping=1e-4)
    fast, slow = pair(scene, fmbd.GGL(), t_end=0.02, dt=5e-4)
    assert fast.counters["compiled_steps"] >= 30
    agree(fast, slow)

    ev = fast.system.at(fast.state.t, fast.state.q, fast.state.v)
    slip = ev.jacobian.times(fast.state.v) + ev.constraint_rate()
    assert np.abs(slip).max() < 1e-9 * np.abs(fast.state.v).max()


@pytest.mark.parametrize("frame", ["mean axis", "attached"])
@pytest.mark.parametrize("what", ["mass damping", "load", "large strain", "viscous"])
def test_same_digits_where_python_tells_the_forces_of_a_field(
    rod_mesh: Callable[..., Any], frame: str, what: str
) -> None:
    """Fields with more than linear elasticity are asked for their forces and energies; all else is compiled."""
    kind = fmbd.MeanAxis() if frame == "mean axis" else fmbd.Attached("pin")
    changes: dict[str, Any] = {
        "mass damping": {"mass_damping": 0.1},
        "load": {"loads": (fmbd.body_force((0.0, 50.0, 5.0), time=lambda t: np.sin(40 * t)),)},
        "large strain": {"elastic": None, "energy": fmbd.materials.saint_venant_kirchhoff(3e7, 0.3)},
        "viscous": {"viscous": lambda u, v, dx: 3e3 * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * dx},
    }[what]
    fast, slow = pair(lambda: floating(rod_mesh(dim=3, h=0.25), kind, **changes), t_end=0.01, dt=5e-4)
    assert fast.counters["compiled_steps"] >= 14
    agree(fast, slow, rates=1e-8)  # Newton's last increments
    for name, series in fast.energy.items():
        assert np.allclose(series, slow.energy[name], rtol=1e-7, atol=1e-9), name


def sprung(mesh: Any) -> fmbd.Scene:
    """Floating rods with springs, a bushing, a motor, a stop, a law of the user's own and a force on their surfaces."""
    scene = floating(mesh, fmbd.Attached("pin"))
    one, two, bob = (scene.bodies[name] for name in ("one", "two", "bob"))
    tip, free = one.surface("tip"), two.surface("pin")
    scene.add(fmbd.Spring("stay", fmbd.ground, tip, stiffness=3e3, damping=5.0, length=0.86, point_a=(0.7, 0.8, 0.1)))
    scene.add(fmbd.force("push", free, lambda t: (20.0 * np.sin(30 * t), 5.0, 0.0)))
    scene.add(fmbd.Spring("own", free, bob, law=lambda s, rate, t: 200.0 * s**3 + 2.0 * rate))
    scene.add(fmbd.bushing("pad", fmbd.ground, free, stiffness=np.full(6, 40.0), damping=np.full(6, 0.5)))
    return scene


def test_springs_on_floating_bodies_are_compiled(rod_mesh: Callable[..., Any]) -> None:
    fast, slow = pair(lambda: sprung(rod_mesh(dim=3, h=0.25)), t_end=0.02, dt=5e-4)
    assert fast.counters["compiled_steps"] >= 30
    for name, bar in (("q", 1e-9), ("v", 1e-7), ("a", 1e-4), ("lam", 1e-4)):
        x, y = getattr(fast.state, name), getattr(slow.state, name)
        assert np.abs(x - y).max() < bar * np.abs(y).max(), name


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("follower", [False, True], ids=["dead", "follower"])
def test_forces_act_where_the_factor_has_solved_nothing(rod_mesh: Callable[..., Any], dim: int, follower: bool) -> None:
    """A force and a torque on a surface that no joint holds, away from its centroid."""

    def make() -> fmbd.Scene:
        scene = floating(rod_mesh(dim=dim, h=0.25), fmbd.MeanAxis())
        free = scene.bodies["two"].surface("pin")
        push, point = (20.0, 5.0, 3.0)[:dim], (0.1, 0.02, 0.01)[:dim]
        scene.add(fmbd.force("push", free, push, point=point, follower=follower))
        turn = 1.0 if dim == 2 else (0.5, 0.2, 1.0)
        scene.add(fmbd.torque("turn", free, lambda t: np.multiply(np.sin(30 * t), turn), follower=follower))
        return scene

    fast, slow = pair(make, t_end=0.02, dt=5e-4)
    assert fast.counters["compiled_steps"] >= 30
    agree(fast, slow, rates=1e-8)


def test_floating_bodies_beside_a_reduced_one(rod_mesh: Callable[..., Any]) -> None:
    """Frame conditions are those of the body that they belong to, wherever parts without any stand among the bodies."""

    def make() -> fmbd.Scene:
        scene = floating(rod_mesh(dim=2, h=0.25), fmbd.MeanAxis())
        modal = scene.bodies["two"].with_(name="modal").reduced(modes=3)
        scene.add(modal, fmbd.revolute("own hinge", fmbd.ground, modal.surface("pin")))
        return scene

    fast, slow = pair(make, t_end=0.01, dt=5e-4)
    assert fast.counters["compiled_steps"] >= 18
    agree(fast, slow)


@pytest.mark.parametrize("unit", [1e-9, 1e9])
@pytest.mark.parametrize("twice", [False, True], ids=["once", "twice"])
def test_floating_bodies_in_any_unit_of_mass(rod_mesh: Callable[..., Any], unit: float, twice: bool) -> None:
    """A rod on one hinge, or held twice by rows that depend on each other: the same steps in grams as in tonnes."""

    def make(unit: float) -> fmbd.Scene:
        elastic = fmbd.materials.plane_stress(3e7 * unit, 0.3)
        mesh, kind = rod_mesh(dim=2, h=0.25), fmbd.Attached("pin")
        rod = fmbd.FloatingBody("rod", mesh, density=1000.0 * unit, elastic=elastic, frame=kind)
        scene = fmbd.Scene("units", gravity=(0.3, -9.81))
        scene.add(rod, fmbd.revolute("hinge", fmbd.ground, rod.surface("pin")))
        if twice:
            scene.add(fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))
        return scene

    known = fmbd.solve(make(1.0), t_end=0.005, dt=5e-4, scheme=GeneralizedAlpha(0.8))
    fast, slow = pair(lambda: make(unit), t_end=0.005, dt=5e-4)
    made = [run.counters.get("compiled_steps", 0) for run in (fast, known)]
    assert made[0] == made[1] and made[0] >= (0 if twice else 8)  # dependent rows are NumPy's
    for run in (fast, slow):
        assert run.counters["newton_iterations"] == known.counters["newton_iterations"]
        assert np.abs(run.state.q - known.state.q).max() < 1e-11


def test_plan_tells_the_path() -> None:
    fast, slow = pair(rigid, t_end=0.005, dt=1e-3)
    assert "steps: compiled" in str(fast.plan)
    assert fast.counters["compiled_steps"] == 5
    assert "steps: NumPy" in str(slow.plan)
    for scheme in (fmbd.Radau(2), fmbd.BDF(2), fmbd.Rattle(), fmbd.HalfExplicit(), fmbd.EnergyMomentum()):
        assert "steps: compiled" in str(fmbd.solve(rigid(), t_end=0.005, dt=1e-3, scheme=scheme).plan)


def test_steps_may_alternate(rod_mesh: Callable[..., Any]) -> None:
    """Steps handed back to NumPy keep the history of the predictor."""
    a, b = stepper_of(flexible(3)), stepper_of(flexible(3), GeneralizedAlpha(0.8, compiled=False))
    for k in range(30):
        if k % 3 == 1:
            AlphaStepper.advance(a, 1e-3)
        else:
            a.advance(1e-3)
        b.advance(1e-3)
    assert np.abs(a.state.q - b.state.q).max() < 1e-12
    assert np.abs(a.A - b.A).max() < 1e-7 * np.abs(b.A).max()


def test_warnings_and_refusals_are_those_of_numpy(
    rod_mesh: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    """A spin above the first frequency is warned of once and the kernel goes on; displacements of the body's size end the run."""

    def spinning(speed: float, modulus: float) -> fmbd.Scene:
        elastic = fmbd.materials.linear_elastic(modulus, 0.3)
        scene = soft_pendulum(rod_mesh(dim=3, h=0.25), 4, elastic=elastic, angular_velocity=(0, 0, speed))
        scene.gravity = None
        return scene

    run = fmbd.solve(spinning(30.0, 1e6), t_end=2e-3, dt=1e-4)
    assert len([r for r in caplog.records if "first" in r.message]) == 1
    assert run.counters["steps"] == 20
    assert run.counters["compiled_steps"] >= 17
    with pytest.raises(ConvergenceError, match='"rod"'):
        fmbd.solve(spinning(300.0, 1e6), t_end=0.05, dt=1e-4)


TIME_LOOP = """
import sys, pickle
import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.schemes.consistent import consistent
sys.path.insert(0, "tests")
from test_kernel import soft_pendulum
from dolfinx import jit

scene = soft_pendulum(fmbd.read_gmsh("meshes/rod.py", dim=3, h=0.25), 16)
scene.bodies["rod"].reduction
for name in [m for m in sys.modules if m.split(".")[0] in ("dolfinx", "ffcx", "ufl", "basix", "gmsh", "petsc4py")]:
    sys.modules[name] = None  # an import from here on fails
run = fmbd.solve(scene, t_end=0.01, dt=1e-3, scheme=fmbd.GeneralizedAlpha(0.8, compiled=%s))
assert run.counters["steps"] == 10
"""


@pytest.mark.serial
@pytest.mark.parametrize("fast", [True, False])
def test_reduced_body_needs_no_mesh_library_in_the_time_loop(fast: bool) -> None:
    """With the modes at hand neither path imports DOLFINx, FFCx, UFL or PETSc, let alone compiles a form."""
    done = subprocess.run(
        [sys.executable, "-c", TIME_LOOP % fast], cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr


def test_plan_lists_the_unknowns_of_every_part() -> None:
    fast, _ = pair(rigid, t_end=0.002, dt=1e-3)
    lines = str(fast.plan).split("\n")
    for name, count in fast.plan.unknowns:
        assert any(line.split()[:-1] == name.split() and line.split()[-1] == str(count) for line in lines)
    assert fast.plan.unknowns
