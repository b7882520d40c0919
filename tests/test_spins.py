"""Linear bodies that spin: their first frequency between their joints, who is warned of and who is not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.mechanics.elastic.modes import first_eigenvalue_bound
from fmbd_fenicsx.system import spins
from fmbd_fenicsx.system.spins import held_mode

HEIGHT, MODULUS, DENSITY = 0.02, 70e9, 2700.0
UNIT = np.sqrt(MODULUS * HEIGHT**2 / 12 / DENSITY)  # rad/s, sqrt(EI / m L^4) of a beam of one metre


def blade(kind: str) -> tuple[Any, str, str]:
    """A strip along x with the names of its ends."""
    if kind == "beam":
        section = fmbd.Section.rectangle(
            youngs_modulus=MODULUS, poisson_ratio=0.3, density=DENSITY, width=1.0, height=HEIGHT
        )
        return fmbd.Beam("blade", (0, 0), (1, 0), section, elements=12), "start", "end"
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, HEIGHT), counts=(24, 1), origin=(0.0, -HEIGHT / 2))
    solid = fmbd.FloatingBody("blade", mesh, density=DENSITY, elastic=fmbd.materials.plane_stress(MODULUS, 0.3))
    if kind == "reduced":
        return solid.reduced(basis=fmbd.CraigBampton(("left", "right"), 4)), "left", "right"
    return solid, "left", "right"


def turning(kind: str, rate: float, *, stiffening: bool = False, rise: float = 0.1) -> fmbd.Scene:
    """The blade on a hub that a drive spins up to rate (rad/s), by some ``rise`` (s)."""
    body, root, tip = blade(kind)
    body = body.with_(stiffening=root) if stiffening else body
    hub = fmbd.RigidBody("hub", 1.0, 1.0, (0.0, 0.0))
    scene = fmbd.Scene("turning")
    axle = fmbd.revolute("axle", fmbd.ground, hub, center=(0, 0))
    scene.add(hub, body, axle, fmbd.fixed("weld", hub, body.surface(root)))
    scene.add(fmbd.drive("motor", fmbd.angle(axle), lambda t: rate * t**3 / (t**2 + rise**2)))
    scene.sensor("tip", fmbd.position(body.surface(tip)))
    return scene


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["floating", "reduced", "beam"])
@pytest.mark.parametrize(
    ("held", "factor"), [("clamped", 3.516), ("pinned", np.pi**2), ("on a pin", 15.418), ("free", 22.373)]
)
def test_frequencies_between_joints_are_those_of_beams(kind: str, held: str, factor: float) -> None:
    """Clamped at one end, pinned at both, pinned at one, free: in mean axes all of them."""
    body, root, tip = blade(kind)
    scene = fmbd.Scene("held")
    scene.add(body)
    if held == "clamped":
        scene.add(fmbd.fixed("root", fmbd.ground, body.surface(root)))
    if held in ("pinned", "on a pin"):
        scene.add(fmbd.revolute("root", fmbd.ground, body.surface(root), center=(0, 0)))
    if held == "pinned":
        scene.add(fmbd.point_on_line("tip", fmbd.ground, body.surface(tip), center=(1, 0), axis=(1, 0)))

    system, state, _ = scene.build()
    k, part = system.part("blade")
    # three of hundred: the percent of inverse iteration, shear, and the ends of the strip, whose mean rotation is held
    assert held_mode(system.at(0.0, state.q, state.v), k, part)[0] == pytest.approx(factor * UNIT, rel=0.03)


@pytest.mark.parametrize(("slides", "times"), [(False, 1), (True, 3)])
def test_a_field_is_asked_again_where_it_is_held_otherwise(slides: bool, times: int, monkeypatch: Any) -> None:
    """A pin turns with the blade; a support that slides along x holds it otherwise once the blade has turned to y, and back."""
    asked: list[Any] = []
    find = spins.first_mode
    monkeypatch.setattr(spins, "first_mode", lambda *of: asked.append(of) or find(*of))
    body, root, tip = blade("floating")
    scene = fmbd.Scene("held")
    scene.add(body, fmbd.revolute("root", fmbd.ground, body.surface(root), center=(0, 0)))
    if slides:
        scene.add(fmbd.point_on_line("tip", fmbd.ground, body.surface(tip), center=(1, 0), axis=(1, 0)))

    system, state, _ = scene.build()
    turned = state.q.copy()
    turned[2] += 0.5 * np.pi
    level = np.pi**2 if slides else 15.418
    for q, factor in ((state.q, level), (turned, 15.418), (state.q, level)):
        found = held_mode(system.at(0.0, q, state.v), *system.part("blade"))[0]
        assert found == pytest.approx(factor * UNIT, rel=0.03)
    assert len(asked) == times


@pytest.mark.parametrize("kind", ["floating", "reduced"])
def test_a_blade_that_spins_up_is_told_by_its_clamped_frequency(kind: str, caplog: Any) -> None:
    """Half of it is not said to be too fast, seven tenths are: by runs and by equilibria."""
    run = fmbd.solve(turning(kind, 0.45 * 3.516 * UNIT), t_end=0.1, dt=1e-3)
    assert "bending frequency" not in str(run.warnings)

    scene = turning(kind, 0.7 * 3.516 * UNIT)
    assert "bending frequency" in str(fmbd.solve(scene, t_end=0.4, dt=1e-3).warnings)

    body, root, _ = blade(kind)
    alone = fmbd.Scene("alone")
    alone.add(body, fmbd.fixed("weld", fmbd.ground, body.surface(root)))
    caplog.clear()
    fmbd.equilibrium(alone, spin=fmbd.Spin(0.7 * 3.516 * UNIT))
    assert "49 % of its stiffness" in caplog.text


def test_a_body_that_spins_is_not_told_of_its_pull_as_well() -> None:
    """Which is that of the spin."""
    told = fmbd.solve(turning("beam", 0.8 * 3.516 * UNIT, rise=1.0), t_end=3.0, dt=1e-3).warnings
    assert [text for text in told if "bending frequency" in text]
    assert not [text for text in told if "pulled along itself" in text]


def test_the_attitude_of_a_mesh_does_not_matter() -> None:
    """Below a twentieth of the bound nothing is looked at: aslant it was twenty times the first frequency."""
    body, _, _ = blade("floating")
    bounds = []
    for angle in (0.0, 0.4, 2.0):
        scene = fmbd.Scene("free")
        scene.add(body.with_(mesh=body.mesh.placed((0.3, 0.2), angle)))
        bounds.append(np.sqrt(first_eigenvalue_bound(scene.build()[0].part("blade")[1].field)))
    assert 22.373 * UNIT < bounds[0] < 1.3 * 22.373 * UNIT
    assert bounds == pytest.approx([bounds[0]] * 3, rel=1e-6)


def test_a_bound_of_frequencies_is_two_products() -> None:
    """Once: quadratic displacements one by one, for each judge that asks, took a tenth of the start of a small body."""
    scene = fmbd.Scene("free")
    scene.add(blade("floating")[0])
    field, asked = scene.build()[0].part("blade")[1].field, []
    of_stiffness, of_mass = field.stiffness, field.mass_columns
    field.stiffness = lambda U: asked.append(U.shape) or of_stiffness(U)
    field.mass_columns = lambda U: asked.append(U.shape) or of_mass(U)
    bounds = [first_eigenvalue_bound(field), first_eigenvalue_bound(field)]
    assert len(asked) == 2
    field.replace_mass(4.0 * field.M)
    assert bounds == [bounds[0], pytest.approx(4.0 * first_eigenvalue_bound(field))]


def test_steps_that_are_tried_only_tell_nothing() -> None:
    """A clamped blade shaken from side to side never turns; half-explicit steps that are rejected turn it by chance."""
    body, root, tip = blade("reduced")
    cart = fmbd.RigidBody("cart", 1.0, 1.0, (0.0, 0.0))
    rail = fmbd.prismatic("rail", fmbd.ground, cart, center=(0, 0), axis=(0, 1))
    scene = fmbd.Scene("shaken")
    scene.add(cart, rail, body, fmbd.fixed("weld", cart, body.surface(root)))
    scene.add(fmbd.drive("shaker", fmbd.displacement(rail), lambda t: 1e-3 * np.sin(2e4 * t) ** 3))
    scene.sensor("tip", fmbd.position(body.surface(tip)))
    run = fmbd.solve(scene, t_end=1e-3, scheme=fmbd.HalfExplicit(1e-8))
    assert run.counters["rejections"] > 0 and not run.warnings


def test_a_stiffened_blade_is_not_warned_of() -> None:
    run = fmbd.solve(turning("floating", 0.7 * 3.516 * UNIT, stiffening=True), t_end=0.4, dt=1e-3)
    assert "bending frequency" not in str(run.warnings)
