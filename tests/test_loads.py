"""Loads as UFL forms: resultants, every placement alike, thermal stretch, pressure on the deformed surface."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import dolfinx_compat
from fmbd_fenicsx.errors import CallbackError, InputError, LawError
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.fem.given_numbers import GivenNumbers
from fmbd_fenicsx.fem.loads import Load, body_force, pressure, thermal_stress, traction
from fmbd_fenicsx.materials import linear_elastic, saint_venant_kirchhoff
from fmbd_fenicsx.mechanics.elastic.floating import FloatingField
from fmbd_fenicsx.mechanics.placements import Attached, FrameMotion, MeanAxis
from fmbd_fenicsx.mechanics.reduction.craig_bampton import CraigBampton, RefinedBasis
from fmbd_fenicsx.mechanics.reduction.reduced import ReducedPart
from fmbd_fenicsx.rotations import motions

MESHES = Path(__file__).parents[1] / "meshes"
MODULUS, DENSITY = 5e6, 1000.0


def fmbd_identity(dim: int) -> Any:
    import ufl

    return ufl.Identity(dim)


def rod(mesh: Any, *loads: Load, **changes: Any) -> fmbd.FloatingBody:
    return fmbd.FloatingBody("rod", mesh, density=DENSITY, elastic=linear_elastic(MODULUS, 0.3), loads=loads).with_(
        **changes
    )


@pytest.mark.smoke
@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
def test_resultants_and_reduction(rod_mesh: Callable[..., Any], dim: int) -> None:
    """Traction times area on the frame, its moment about the moving centre; the reduced body projects the same rows."""
    mesh = rod_mesh(dim=dim, h=0.25)
    t = np.array([3.0, -2.0, 1.0])[:dim]
    loads = (
        traction("tip", t, time=lambda s: 2.0 * s),
        body_force(5.0 * t, follower=True),
        pressure("side", 7.0),
        thermal_stress(lambda x: 11.0 * x[0] * fmbd_identity(dim)),
    )
    body = rod(mesh, *loads)
    field = Field("rod", mesh, body.forms())
    bare = Field("rod", mesh, rod(mesh).forms())
    m = motions(dim)
    rng = np.random.default_rng(4)
    R = m.matrix(m.compose(m.identity[None], rng.standard_normal((1, m.n_twist))))[0]
    motion = FrameMotion(0.5, R, rng.standard_normal(m.n_twist), rng.standard_normal(m.n_twist), np.zeros(dim))
    small = body.reduced(modes=4)
    eta, zero = 0.1 * rng.standard_normal(4), np.zeros(4)
    phi = small.reduction.phi
    local = (phi @ eta, phi @ zero, phi @ zero)
    with_loads = FloatingField(field, 0, [], MeanAxis()).force(motion, local)
    without = FloatingField(bare, 0, [], MeanAxis()).force(motion, local)
    area, volume = 0.1 ** (dim - 1), 0.1 ** (dim - 1)
    expected = area * t + R @ (volume * 5.0 * t)  # the pressure on all sides has no resultant
    np.testing.assert_allclose((without[0] - with_loads[0])[:dim], expected, rtol=1e-9)
    frame, rows = ReducedPart("rod", small.constants, 0, []).force(motion, (eta, zero, zero))
    np.testing.assert_allclose(frame, with_loads[0], rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(rows, field.total(phi.T @ with_loads[1]), rtol=1e-7, atol=1e-7)
    field.destroy()
    bare.destroy()


def clamped_tip(body: Any, t_end: float = 0.4) -> Any:
    scene = fmbd.Scene("clamped")
    scene.add(body, fmbd.fixed("wall", fmbd.ground, body.surface("pin")))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return fmbd.solve(scene, t_end=t_end, dt=4e-3, scheme=fmbd.GeneralizedAlpha(0.5))["tip"]


@pytest.mark.mpi
def test_same_load_on_every_placement(rod_mesh: Callable[..., Any]) -> None:
    """A tip load in space axes bends floating, reduced, absolute linear and absolute nonlinear rods alike."""
    mesh = rod_mesh(dim=2, h=0.1)
    load = traction("tip", (0.0, -30.0), time=lambda t: min(t / 0.2, 1.0))
    full = rod(mesh, load, frame=Attached("pin"))
    linear = fmbd.AbsoluteBody("rod", mesh, density=DENSITY, elastic=linear_elastic(MODULUS, 0.3), loads=(load,))
    large = fmbd.AbsoluteBody("rod", mesh, density=DENSITY, energy=saint_venant_kirchhoff(MODULUS, 0.3), loads=(load,))
    tips = [clamped_tip(b)[:, 1] for b in (full, full.reduced(modes=8), linear, large)]
    size = np.abs(tips[0]).max()
    assert size > 1e-3
    for other in tips[1:]:
        assert np.abs(other - tips[0]).max() < 0.01 * size


def test_loads_of_other_values_are_the_same_form(rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """A sweep over a load compiles nothing anew, and may begin at zero."""
    asked = set()
    form = dolfinx_compat.form

    def watched(ufl_form: Any) -> Any:
        asked.add(ufl_form.signature())
        return form(ufl_form)

    def sums(value: float) -> np.ndarray:
        loads = traction("tip", (value, 0.0)), body_force((0.0, value)), pressure("pin", value)
        field = Field("rod", mesh, rod(mesh, *loads).forms())
        return np.array([b.sum(axis=0) for _, b in field.loads.fixed])

    mesh = rod_mesh(dim=2, h=0.25)
    one = sums(1.0)
    monkeypatch.setattr(dolfinx_compat, "form", watched)
    np.testing.assert_allclose(sums(0.0), 0.0, atol=1e-15)
    known = set(asked)
    np.testing.assert_allclose(sums(2.5), 2.5 * one, rtol=1e-12, atol=1e-15)
    assert asked == known and len(known) > 3


@pytest.mark.mpi
def test_thermal_stretch(rod_mesh: Callable[..., Any]) -> None:
    """A uniform rise lengthens a free rod by alpha dT L, without stress in its ends' mean distance."""
    strain = 1e-3
    stress = MODULUS * strain / ((1 + 0.3) * (1 - 2 * 0.3)) * (1 - 0.3 + 0.3)  # plane strain: sigma_xx = sigma_yy
    body = rod(rod_mesh(dim=2, h=0.25), thermal_stress(lambda x: stress * fmbd_identity(2), time=lambda t: min(t / 0.3, 1.0)),
               mass_damping=20.0)  # fmt: skip
    scene = fmbd.Scene("warm")
    scene.add(body)
    for end in ("pin", "tip"):
        scene.sensor(end, fmbd.position(body.surface(end)))
    run = fmbd.solve(scene, t_end=1.0, dt=5e-3)
    np.testing.assert_allclose(run["tip"][-1, 0] - run["pin"][-1, 0] - 1.0, strain, rtol=1e-3)


@pytest.mark.mpi
def test_bases_without_the_strains_of_heat_say_so(
    rod_mesh: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    """Modes of the ends give the length of a warm rod, none of its width; with its static displacement in them all is there."""
    heat = thermal_stress(lambda x: MODULUS * fmbd_identity(2))
    body = rod(rod_mesh(dim=2, h=0.25), heat)
    ends = CraigBampton(("pin", "tip"), 2)
    work, told = {}, {}
    for name, basis in (("ends", ends), ("heat", RefinedBasis(ends, ("pin", "tip")))):
        caplog.clear()
        made = body.reduced(basis=basis).constants
        ((_, tensor),) = made.loads
        pushes = np.trace(tensor, axis1=1, axis2=2)[1:]
        work[name] = float(pushes**2 @ (1.0 / np.diag(made.K)))
        told[name] = "of the strain energy of an internal load" in caplog.text
    # plane strain: both strains alike, as both stresses are
    exact = 2 * (1 + 0.3) * (1 - 2 * 0.3) * MODULUS * 0.1
    assert work["heat"] == pytest.approx(exact, rel=1e-6) and work["ends"] < 0.8 * exact
    assert told == {"ends": True, "heat": False}


@pytest.mark.mpi
@pytest.mark.parametrize("load", [
    thermal_stress(lambda x: 0.02 * MODULUS * fmbd_identity(2)),
    traction("tip", (0.02 * MODULUS, 0.0), follower=True),
    body_force((0.04 * MODULUS, 0.0), follower=True),
], ids=["heat", "traction", "body force"])  # fmt: skip
def test_followers_and_heat_turn_with_bodies_without_a_frame(rod_mesh: Callable[..., Any], load: Load) -> None:
    """A bar turned by 2 rad is as long as one at rest, by the same exact strain: S = E e, P = F S, nu = 0."""
    mesh = rod_mesh(dim=2, h=0.5, height=0.4)
    body = fmbd.AbsoluteBody("rod", mesh, density=1.0, energy=saint_venant_kirchhoff(MODULUS, 0.0), loads=(load,))
    pin = fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0, 0))
    scene = fmbd.Scene("turned")
    scene.add(body, pin, fmbd.drive("turn", fmbd.angle(pin), lambda t: 2.0 * t))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    tip = fmbd.equilibrium(scene, path=fmbd.LoadSteps((0.25, 0.5, 0.75, 1.0)))["tip"]

    # the pull is that of the end all along, or grows from there to the pin
    pulls = [0.02] if load.surface else 0.04 * (np.arange(20) + 0.5) / 20
    stretches = [brentq(lambda e, p=p: e * (e**2 - 1) / 2 - p, 1.0, 2.0) for p in pulls]
    expected = np.sqrt(1.04) if load.internal else np.mean(stretches)
    assert np.arctan2(tip[1], tip[0]) == pytest.approx(2.0, abs=1e-6)
    assert np.hypot(*tip) == pytest.approx(expected, rel=1e-9 if load.surface or load.internal else 2e-5)


def test_followers_of_a_frame_are_refused_where_there_is_none(rod_mesh: Callable[..., Any]) -> None:
    def form(v: Any, dx: Any, ds: Any) -> Any:
        return v[0] * ds("tip")

    mesh = rod_mesh(dim=2, h=0.25)
    for kind in ({"follower": True}, {"internal": True}):
        law = saint_venant_kirchhoff(MODULUS, 0.3)
        body = fmbd.AbsoluteBody("rod", mesh, density=1.0, energy=law, loads=(Load(form, **kind),))
        scene = fmbd.Scene("frameless")
        scene.add(body)
        with pytest.raises(InputError, match='Load 0 on body "rod" turns with.*deformed'):
            scene.build()


@pytest.mark.parametrize("kind", ["floating", "absolute"])
def test_pressure_all_around_moves_nothing(rod_mesh: Callable[..., Any], kind: str) -> None:
    """On a closed surface pressure has no resultant, for the deformed surface too."""
    mesh = rod_mesh(dim=2, h=0.25)
    loads = tuple(pressure(s, 1e4, time=lambda t: min(t / 0.05, 1.0)) for s in ("pin", "tip", "side"))
    body: Any = rod(mesh, *loads, angular_velocity=3.0)
    if kind == "absolute":
        body = fmbd.AbsoluteBody(
            "rod", mesh, density=DENSITY, energy=saint_venant_kirchhoff(MODULUS, 0.3), loads=loads, angular_velocity=3.0
        )
    scene = fmbd.Scene("deep")
    scene.add(body)
    run = fmbd.solve(scene, t_end=0.1, dt=2e-3)
    momentum, _ = run.system.at(run.state.t, run.state.q, run.state.v).momenta()
    assert np.abs(momentum).max() < 1e-6 * run.system.mass


def test_bad_loads(rod_mesh: Callable[..., Any]) -> None:
    """A surface that does not exist, a form of the wrong rank, a function of time that fails."""
    mesh = rod_mesh(dim=2, h=0.25)
    with pytest.raises(InputError, match="nose"):
        Field("rod", mesh, rod(mesh, traction("nose", (1.0, 0.0))).forms())
    with pytest.raises(InputError, match="linear UFL form"):
        Field("rod", mesh, rod(mesh, Load(lambda v, dx, ds: 1.0)).forms())
    for form in (lambda v, dx, ds: v[0] * ds, lambda v, dx, ds: 2 * v[0] * dx + v[1] * ds):
        with pytest.raises(InputError, match=r'name of a surface: ds\("pin"\). This mesh has pin, side, tip'):
            Field("rod", mesh, rod(mesh, Load(form)).forms())
    with pytest.raises(InputError, match="must be 2 finite numbers"):
        Field("rod", mesh, rod(mesh, body_force((1.0,))).forms())
    with pytest.raises(CallbackError, match="function of time"):
        clamped_tip(rod(mesh, traction("tip", (1.0, 0.0), time=lambda t: float("nan"))))


@pytest.mark.mpi
def test_exception_in_a_function_of_time_names_body_and_time(rod_mesh: Callable[..., Any]) -> None:
    late = lambda t: 0.0 if t < 0.045 else {}["gone"]  # noqa: E731
    scene = fmbd.Scene("late")
    scene.add(rod(rod_mesh(dim=2, h=0.25), traction("tip", (1.0, 0.0), time=late)))
    words = r"""The function of time of a load on body "rod" failed at t = 0\.0\d+ s: KeyError: 'gone'"""
    with pytest.raises(LawError, match=words) as found:
        fmbd.solve(scene, t_end=0.1, dt=0.01)
    assert isinstance(found.value.__cause__, KeyError)


def test_pressure_from_all_sides_turns_no_body() -> None:
    """A free block, graded askew, is pressed askew and does not spin: by the moment of U x b it did."""
    import ufl

    def askew(u: Any, v: Any, dx: Any) -> Any:
        x = ufl.SpatialCoordinate(dx.ufl_domain())
        return 1e6 * (1 + 20 * x[0] * x[1]) * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * dx

    mesh = fmbd.read_gmsh(MESHES / "block.py", size=(1.0, 0.2), counts=(6, 2), origin=(0.0, 0.0))
    sides = [pressure(side, 2e4) for side in ("left", "right", "bottom", "top")]
    given: dict[str, Any] = {"density": 1e3, "elastic": askew, "loads": sides, "stiffness_damping": 1e-2}
    floating = fmbd.FloatingBody("block", mesh, **given)

    def turned(body: Any, *, compiled: bool = True) -> Any:
        scene = fmbd.Scene("dive")
        scene.add(body)
        scene.sensor("turn", fmbd.rotation(body.surface("left")))
        scheme = fmbd.GeneralizedAlpha(compiled=compiled)
        run = fmbd.solve(scene, t_end=2.0 if compiled else 0.2, dt=0.02, scheme=scheme)
        return run["turn"].ravel()

    reference = turned(fmbd.AbsoluteBody("block", mesh, **given))
    assert np.ptp(reference[50:]) < 1e-3
    for body in (floating, floating.reduced(modes=30)):
        np.testing.assert_allclose(turned(body), reference, atol=2e-3)
    np.testing.assert_allclose(turned(floating, compiled=False), reference[:11], atol=1e-3)


@pytest.mark.mpi
@pytest.mark.parametrize("where", ["elastic", "field", "energy", "viscous", "load", "density"])
def test_numbers_of_forms_that_change_are_seen_or_refused(rod_mesh: Callable[..., Any], where: str) -> None:
    """A run that is under way, and modes that are made, hold matrices of the old ones; the next scene has the new ones."""
    import ufl
    from dolfinx import fem

    mesh = rod_mesh(dim=2, h=0.5)
    number = (
        fem.Function(fem.functionspace(mesh.dolfinx, ("DG", 0)))
        if where == "field"
        else fem.Constant(mesh.dolfinx, 1.0)
    )

    def change(to: float) -> None:
        (number.x.array if where == "field" else number.value)[...] = to

    def form(u: Any, v: Any, dx: Any) -> Any:
        return number * MODULUS * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * dx

    def push(v: Any, dx: Any, ds: Any) -> Any:
        return number * v[0] * ds("tip")

    def energy(u: Any, dx: Any) -> Any:
        strain = ufl.sym(ufl.grad(u)) + 0.5 * ufl.grad(u).T * ufl.grad(u)
        return number * MODULUS * ufl.inner(strain, strain) * dx

    changed: dict[str, Any] = {
        "elastic": {"elastic": form},
        "field": {"elastic": form},
        "energy": {"elastic": None, "energy": energy},
        "viscous": {"viscous": form},
        "load": {"loads": (Load(push),)},
        "density": {"density": lambda x: DENSITY * number},
    }
    change(1.0)
    body = rod(mesh, traction("tip", (1.0, 0.0))).with_(**changed[where])

    def clamped(body: Any) -> fmbd.Scene:
        scene = fmbd.Scene("clamped")
        scene.add(body, fmbd.fixed("wall", fmbd.ground, body.surface("pin")))
        return scene

    change_it = fmbd.Output(on_step=lambda now: change(2.0))
    with pytest.raises(InputError, match=r'Body "rod".*has changed since the scene was built.*time=.*next_scene'):
        fmbd.solve(clamped(body), t_end=0.02, dt=0.01, output=change_it)
    change(1.0)
    fmbd.solve(clamped(body), t_end=0.01, dt=0.01, output=change_it)  # for the next one, which sees it
    with fmbd.stepper(clamped(body), dt=0.01) as stepper:
        stepper.step()
        change(3.0)
        with pytest.raises(InputError, match="has changed since the scene was built"):
            stepper.step()

    if where == "energy":
        return
    reduced = body.reduced(modes=2)
    fmbd.solve(clamped(reduced), t_end=0.01, dt=0.01)
    change(4.0)
    with pytest.raises(InputError, match=r'Body "rod".*has changed since the body was reduced.*Reduce it anew'):
        fmbd.solve(clamped(reduced), t_end=0.01, dt=0.01)
    fmbd.solve(clamped(body.reduced(modes=2)), t_end=0.01, dt=0.01)


def test_numbers_of_forms_are_compared_once_a_step(
    rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[GivenNumbers] = []
    monkeypatch.setattr(GivenNumbers, "changed", property(lambda numbers: asked.append(numbers) is not None))
    body = rod(rod_mesh(dim=2, h=0.5), traction("tip", (1.0, 0.0)))
    scene = fmbd.Scene("clamped")
    scene.add(body, fmbd.fixed("wall", fmbd.ground, body.surface("pin")))
    fmbd.solve(scene, t_end=0.04, dt=0.01, output=fmbd.Output(on_step=lambda now: None))
    assert len(asked) == 4
