"""Equilibria against closed forms: hanging, stretched by rotation, along a path with limit points; what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError, InputError

HEIGHT, HALF, STIFFNESS = 0.3, 1.0, 1000.0
LENGTH = float(np.hypot(HALF, HEIGHT))


def truss(load: float) -> fmbd.Scene:
    """Two springs to an apex that slides upright, pushed down by ``load`` N for each second of the load parameter."""
    scene = fmbd.Scene("truss")
    apex = fmbd.RigidBody("apex", 1.0, 1.0, position=(0.0, HEIGHT))
    scene.add(apex, fmbd.prismatic("guide", fmbd.ground, apex, axis=(0.0, 1.0)))
    for name, x in (("left", -HALF), ("right", HALF)):
        ends = {"point_a": (x, 0.0), "point_b": (0.0, HEIGHT)}
        scene.add(fmbd.Spring(name, fmbd.ground, apex, stiffness=STIFFNESS, length=LENGTH, **ends))
    scene.add(fmbd.force("push", apex, lambda t: (0.0, -load * t)))
    scene.sensor("apex", fmbd.position(apex))
    scene.sensor("guide", fmbd.reaction(scene.joints["guide"]))
    return scene


@pytest.mark.parametrize("thickness", [0.01, 0.15])
def test_a_truss_of_elastic_bars_snaps(thickness: float) -> None:
    """Thin bars, whose blocks are singular to roundoff, and steps so long that the other branch lies in the reach of one:
    2 E A (l^2 - c^2) / (2 l^2) y / l, c the length that is left.
    """
    rise, most = 0.1, 1e6 * thickness
    length, angle = np.hypot(1.0, rise), np.arctan2(rise, 1.0)
    sheet = fmbd.read_gmsh("meshes/block.py", size=(length, thickness), origin=(0.0, -thickness / 2), counts=(4, 1))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    energy = fmbd.materials.sheet_saint_venant_kirchhoff(1e9, 0.0)
    left = fmbd.AbsoluteBody("left", sheet.placed((-1.0, 0.0), turn), density=1e3, energy=energy)
    right = fmbd.AbsoluteBody("right", sheet.placed((0.0, rise), turn.T), density=1e3, energy=energy)
    apex = left.surface("right")
    scene = fmbd.Scene("truss")
    scene.add(left, right, fmbd.revolute("a", fmbd.ground, left.surface("left"), center=(-1.0, 0.0)))
    scene.add(fmbd.revolute("b", apex, right.surface("left"), center=(0.0, rise)))
    scene.add(fmbd.revolute("c", right.surface("right"), fmbd.ground, center=(1.0, 0.0)))
    scene.add(fmbd.force("load", apex, lambda t: (0.0, -most * t)))
    scene.sensor("apex", fmbd.position(apex))

    path = fmbd.equilibrium(scene, path=fmbd.ArcLength(0.5, step=0.1, most=25)).path
    assert path is not None
    y = path.series["apex"][:, 1]
    push = 1e9 * thickness * (rise**2 - y**2) / length**3 * y
    assert most * np.array(path.parameter) == pytest.approx(push, abs=1e-9 * most)
    assert 0.0 < y[-1] < rise / np.sqrt(3.0)
    highest = 1e9 * thickness * 2.0 * rise**3 / 3.0**1.5 / length**3
    assert most * np.array(path.limit_parameters) == pytest.approx(highest, rel=1e-7)


def push_of(y: Any) -> Any:
    """Load that keeps the apex at the height y: 2 k (l_0 / l - 1) y."""
    return 2.0 * STIFFNESS * (LENGTH / np.hypot(HALF, y) - 1.0) * y


@pytest.mark.parametrize("step", [0.005, 0.05])
def test_path_passes_both_limit_points(step: float) -> None:
    """Every point of the path is on the exact curve; the turns are at the exact limit loads, whatever the step."""
    scene = truss(100.0)
    found = fmbd.equilibrium(scene, path=fmbd.ArcLength(0.5, step=step, most=2000))
    assert found.path is not None
    load, y = 100.0 * np.array(found.path.parameter), found.path.series["apex"][:, 1]
    assert np.abs(load - push_of(y)).max() < 1e-7
    assert len(found.path.limits) == 2

    heights = np.linspace(-HEIGHT, HEIGHT, 200_001)
    limit = push_of(heights).max()
    assert 100.0 * np.array(found.path.limit_parameters) == pytest.approx((limit, -limit), rel=1e-7)
    assert found["apex"][1] < -HEIGHT
    assert load[-1] == pytest.approx(50.0, abs=1e-9)


def test_load_below_the_limit_and_above() -> None:
    """Below the limit load the near equilibrium is found; where nothing near holds, the error says so."""
    assert push_of(fmbd.equilibrium(truss(10.0), t=1.0)["apex"][1]) == pytest.approx(10.0, abs=1e-8)
    with pytest.raises(
        ConvergenceError, match=r"beyond t = .* loads have their limit, path=fmbd.ArcLength\(1\) goes on"
    ):
        fmbd.equilibrium(truss(100.0), path=fmbd.LoadSteps((0.2, 1.0)))


@pytest.mark.mpi
def test_hanging_from_a_horizontal_start() -> None:
    """A chain that starts level under gravity is found hanging."""
    scene = fmbd.Scene("chain", gravity=(0.0, -9.81))
    before: Any = fmbd.ground
    for i in range(3):
        body = fmbd.RigidBody(f"link {i}", 1.0, 0.1, position=(i + 0.5, 0.0))
        scene.add(body, fmbd.revolute(f"pin {i}", before, body, center=(float(i), 0.0)))
        before = body
    scene.sensor("end", fmbd.position(before, point=(3.0, 0.0)))
    assert np.abs(fmbd.equilibrium(scene)["end"] - (0.0, -3.0)).max() < 1e-9


def test_free_motion_is_refused_by_name() -> None:
    """A body that nothing holds has no equilibrium under gravity."""
    scene = fmbd.Scene("fall", gravity=(0.0, -9.81))
    scene.add(fmbd.RigidBody("box", 1.0, 0.1))
    with pytest.raises(ConvergenceError, match='body "box" can move freely'):
        fmbd.equilibrium(scene)


def test_what_moves_freely_is_named_beside_what_swings() -> None:
    """A level pendulum has no stiffness where it is; the body that nothing holds has none anywhere."""
    arm, other = (
        fmbd.RigidBody("arm", 1.0, 0.1, position=(0.5, 0.0)),
        fmbd.RigidBody("other", 1.0, 0.1, position=(3.0, 0.0)),
    )
    scene = fmbd.Scene("two", gravity=(0.0, -9.81))
    scene.add(arm, fmbd.revolute("pin", fmbd.ground, arm, center=(0.0, 0.0)), other)
    with pytest.raises(ConvergenceError, match='body "other" can move freely'):
        fmbd.equilibrium(scene)


def test_a_joint_that_cannot_close_is_named() -> None:
    """A level that the arm does not reach: not a load above its limit."""
    arm = fmbd.RigidBody("arm", 1.0, 0.1, position=(0.5, 0.0))
    scene = fmbd.Scene("far", gravity=(0.0, -9.81))
    scene.add(arm, fmbd.revolute("pin", fmbd.ground, arm, center=(0.0, 0.0)))
    scene.add(fmbd.constraint("level", fmbd.ground, arm, lambda a, b, t: b.x[1] - 3.0, point_b=(1.0, 0.0)))
    with pytest.raises(ConvergenceError, match=r'"level" \(own\) is open by 3 m.*points of the joint'):
        fmbd.equilibrium(scene)


@pytest.mark.mpi
def test_rotation_stretches_a_spring() -> None:
    """r = k l_0 / (k - m W^2) for a mass on a spring in steady rotation."""
    scene = fmbd.Scene("sling")
    mass = fmbd.RigidBody("mass", 2.0, 1.0, position=(1.0, 0.0))
    scene.add(mass, fmbd.prismatic("arm", fmbd.ground, mass, axis=(1.0, 0.0)))
    scene.add(fmbd.Spring("spring", fmbd.ground, mass, (0.0, 0.0), (1.0, 0.0), stiffness=100.0, length=1.0))
    scene.sensor("mass", fmbd.position(mass))
    found = fmbd.equilibrium(scene, spin=fmbd.Spin(4.0))
    assert found["mass"][0] == pytest.approx(100.0 / (100.0 - 2.0 * 16.0), rel=1e-10)


@pytest.mark.mpi
def test_large_deflection_of_an_absolute_rod(rod_mesh: Any) -> None:
    """A dead load in one call or after half of it: the same place, far beyond linear theory."""
    ends = []
    for start in (0.0, 0.5):
        energy = fmbd.materials.saint_venant_kirchhoff(1e6, 0.3)
        rod = fmbd.AbsoluteBody("rod", rod_mesh(), density=1.0, energy=energy)
        scene = fmbd.Scene("rod")
        scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))
        scene.add(fmbd.force("push", rod.surface("tip"), lambda t: (0.0, -100.0 * t)))
        scene.sensor("tip", fmbd.position(rod.surface("tip")))
        scene.sensor("force", fmbd.reaction_force(scene.joints["clamp"]))
        path = fmbd.ArcLength(1.0, step=0.3) if start else None
        found = fmbd.equilibrium(scene, t=start or 1.0, path=path)
        ends.append(found["tip"])
        assert np.abs(found["force"][:2]) == pytest.approx((0.0, 100.0), abs=1e-5)
    assert ends[0][1] < -0.3
    assert np.abs(ends[0] - ends[1]).max() < 1e-9


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["absolute", "floating"])
def test_a_stiff_bar_falls_from_a_hinge(kind: str) -> None:
    """From level to hanging, a quarter of a turn of what hardly deforms: a linear increment would stretch it by its length."""
    steel: Any = {"degree": 2, "density": 7800.0}
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, 0.01), origin=(0.0, -0.005), counts=(20, 1), quads=True)
    bar: Any = (
        fmbd.AbsoluteBody("bar", mesh, energy=fmbd.materials.sheet_saint_venant_kirchhoff(2e11, 0.3), **steel)
        if kind == "absolute"
        else fmbd.FloatingBody("bar", mesh, elastic=fmbd.materials.plane_stress(2e11, 0.3), **steel)
    )
    scene = fmbd.Scene("bar", gravity=(0.0, -9.81))
    scene.add(bar, fmbd.revolute("hinge", fmbd.ground, bar.surface("left")))
    scene.sensor("tip", fmbd.position(bar.surface("right")))
    stretch = 7800.0 * 9.81 / (2.0 * 2e11)
    assert fmbd.equilibrium(scene)["tip"] == pytest.approx((0.0, -1.0 - stretch), abs=2e-9)


@pytest.mark.parametrize("strain", [0.0002, 0.02, 0.2])
def test_a_body_whose_initial_strain_would_buckle_it_takes_its_length(rod_mesh: Any, strain: float) -> None:
    """Where it starts the strip is compressed so much that it buckles: the stiffness there is not positive, nor a time unit."""

    def energy(u: Any, dx: Any) -> Any:
        one = ufl.Identity(2)
        F = one + ufl.grad(u)
        green = 0.5 * (F.T * F - one) - strain * one
        return 0.5e6 * ufl.inner(green, green) * dx

    body = fmbd.AbsoluteBody("strip", rod_mesh(dim=2, h=0.1), density=1e3, energy=energy)
    scene = fmbd.Scene("swollen")
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("pin")))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    assert fmbd.equilibrium(scene)["tip"][0] == pytest.approx(np.sqrt(1 + 2 * strain), rel=1e-9)


def test_bad_input() -> None:
    """Unknown sensors, spins and paths of another kind."""
    scene = truss(10.0)
    with pytest.raises(InputError, match="apex"):
        fmbd.equilibrium(scene)["apx"]
    with pytest.raises(InputError, match="Spin"):
        fmbd.equilibrium(scene, spin=3.0)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="unit vector"):
        fmbd.Spin(1.0, axis=(0.0, 0.0, 2.0))


def test_load_steps_refuse_what_cannot_be_followed():
    """Parameters that descend, none at all, a first step of no length, and a stop at the start."""
    for bad in ({"stops": (1.0, 0.5)}, {"stops": ()}, {"stops": (1.0,), "first": 0.0}):
        with pytest.raises(InputError, match="LoadSteps"):
            fmbd.LoadSteps(**bad)
    rod = fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], fmbd.RodSection((1e3,) * 6, 1.0, (1, 1, 1)), elements=1)
    scene = fmbd.Scene("cantilever")
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("start")))
    with pytest.raises(InputError, match="must be above t = 1"):
        fmbd.equilibrium(scene, t=1.0, path=fmbd.LoadSteps((1.0,)))


@pytest.mark.mpi
def test_the_force_of_a_tie_is_not_read_as_zero(rod_mesh: Any) -> None:
    """It is spread over a surface: refused, where zeros would look like an answer."""
    rod = fmbd.AbsoluteBody("rod", rod_mesh(), density=1.0, elastic=fmbd.materials.plane_stress(1e6, 0.3))
    scene = fmbd.Scene("rod")
    tie = fmbd.tie_surface("clamp", rod.surface("pin"), fmbd.ground)
    scene.add(rod, tie, fmbd.force("push", rod.surface("tip"), lambda t: (0.0, 1.0)))
    scene.sensor("force", fmbd.reaction_force(tie))
    with pytest.raises(InputError, match='"clamp" cannot be read as those of a joint'):
        fmbd.equilibrium(scene)["force"]


def lever(dim: int = 2) -> tuple[fmbd.Scene, fmbd.RigidBody, fmbd.Joint]:
    """A body that turns about the origin, its centre half a metre to the right."""
    scene = fmbd.Scene("lever")
    inertia: Any = 0.1 if dim == 2 else (0.1, 0.1, 0.1)
    body = fmbd.RigidBody("arm", 1.0, inertia, position=(0.5, 0.0, 0.0)[:dim])
    pin = fmbd.revolute("pin", fmbd.ground, body, center=(0.0, 0.0, 0.0)[:dim])
    scene.add(body, pin)
    scene.sensor("angle", fmbd.angle(pin))
    return scene, body, pin


def test_follower_loads_and_drives() -> None:
    """A force that turns with the arm bends its spring by F L / k; a drive stands where it is at that time."""
    scene, body, pin = lever()
    push = fmbd.force("push", body, lambda t: (0.0, 50.0), point=(1.0, 0.0), follower=True)
    scene.add(fmbd.joint_spring("spring", fmbd.angle(pin), stiffness=100.0), push)
    assert fmbd.equilibrium(scene)["angle"][0] == pytest.approx(0.5, abs=1e-10)

    driven, _, pin = lever()
    driven.add(fmbd.drive("motor", fmbd.angle(pin), lambda t: 0.3 + 2.0 * t))
    assert fmbd.equilibrium(driven, t=0.1)["angle"][0] == pytest.approx(0.5, abs=1e-10)


def test_redundant_hinges() -> None:
    """Two hinges on one axis: five rows too many; the pendulum hangs and swings as on one."""
    scene = fmbd.Scene("door", gravity=(0.0, 0.0, -9.81))
    body = fmbd.RigidBody("door", 1.0, (0.1, 0.1, 0.1), position=(0.0, 0.3, -0.4))
    for i, x in enumerate((0.0, 1.0)):
        scene.add(fmbd.revolute(f"hinge {i}", fmbd.ground, body, center=(x, 0.0, 0.0), axis=(1.0, 0.0, 0.0)))
    scene.add(body)
    scene.sensor("door", fmbd.position(body))
    found = fmbd.equilibrium(scene)
    assert found["door"] == pytest.approx((0.0, 0.0, -0.5), abs=1e-9)
    assert fmbd.modes(scene, 1, at=found).omega[0] == pytest.approx(np.sqrt(9.81 * 0.5 / 0.35), rel=1e-7)


def test_load_above_the_limit_says_how_far_it_came() -> None:
    """A spring that gives way at 10 N, under 11 N: the last load factor is in the error."""
    scene = fmbd.Scene("limit")
    mass = fmbd.RigidBody("mass", 1.0, 1.0)
    guide = fmbd.prismatic("guide", fmbd.ground, mass, axis=(1.0, 0.0))
    scene.add(mass, guide, fmbd.force("pull", mass, lambda t: (11.0, 0.0)))
    scene.add(fmbd.joint_spring("spring", fmbd.displacement(guide), law=lambda s, v, t: 10.0 * np.tanh(s)))
    with pytest.raises(ConvergenceError, match=r"load steps ended at 0\.90\d+ of the load.*above its limit") as error:
        fmbd.equilibrium(scene)
    assert "fmbd.ArcLength" in str(error.value)


def test_a_lever_without_stiffness_at_the_start_is_no_free_body() -> None:
    """A torque above the weight of a level lever: the load is too large, no joint is missing."""
    body = fmbd.RigidBody("body", 1.0, 0.1, position=(0.5, 0.0))
    scene = fmbd.Scene("lever", gravity=(0.0, -9.81))
    scene.add(body, fmbd.revolute("hinge", fmbd.ground, body, center=(0.0, 0.0)), fmbd.torque("torque", body, 10.0))
    with pytest.raises(ConvergenceError, match="load may be above its limit"):
        fmbd.equilibrium(scene)


def folding(second: float) -> fmbd.Scene:
    """Four links of 1 m on torsional springs under a force that folds them, without weight; ``second``: unit of time, s."""
    scene, before, k = fmbd.Scene("folding"), fmbd.ground, 1.0 / second**2
    for i in range(4):
        link = fmbd.RigidBody(f"link {i}", 1.0, 1.0 / 12, (i + 0.5, 0.0))
        hinge = fmbd.revolute(f"hinge {i}", before, link, center=(i, 0.0))
        spring = fmbd.joint_spring(f"spring {i}", fmbd.angle(hinge), stiffness=(1 + 10 * i) * k)
        scene.add(link, hinge, spring)
        before = link
    scene.add(fmbd.force("push", before, (-0.3 * k, 0.4 * k), point=(4.0, 0.0)))
    scene.sensor("tip", fmbd.position(before, point=(4.0, 0.0)))
    scene.sensor("pin", fmbd.reaction_force("hinge 0"))
    return scene


@pytest.mark.parametrize("second", [1e-9, 1e-6, 1e6, 1e9])
def test_equilibria_without_weight_in_any_unit_of_time(second: float) -> None:
    """The preconditioner's step was 10 s: slow scenes stayed where they were in silence, and masses of fast ones were roundoff of
    their springs.
    """
    usual, other = (fmbd.equilibrium(folding(t)) for t in (1.0, second))
    np.testing.assert_allclose(other["tip"], usual["tip"], rtol=1e-9)
    np.testing.assert_allclose(other["pin"] * second**2, (-0.3, 0.4), rtol=1e-9)
    assert other.counters["tangent_iterations"] < 1.5 * usual.counters["tangent_iterations"]

    rates = [fmbd.modes(folding(t), 4, at=at).frequencies * t for t, at in ((1.0, usual), (second, other))]
    np.testing.assert_allclose(rates[1], rates[0], rtol=1e-6)


@pytest.mark.parametrize("place", [(0.3, 0.4), (0.4, 0.3)])
@pytest.mark.parametrize("stiffness", [1e7, 1e9])
def test_a_stiff_mount_does_not_hide_a_soft_balance(stiffness: float, place: tuple[float, float]) -> None:
    """A lever on a stiff mount turns until a small force along x holds it; the step of the mount's period would take it for
    balanced where it stands. The place where the force pushes is a balance, too, and 5e-4 N m/rad tell that it is unstable.
    """
    mount = fmbd.RigidBody("mount", 1.0, 1.0)
    lever = fmbd.RigidBody("lever", 1.0, 0.1, place)
    scene = fmbd.Scene("lever")
    slide = fmbd.prismatic("slide", fmbd.ground, mount, center=(0.0, 0.0), axis=(1.0, 0.0))
    scene.add(mount, lever, slide, fmbd.revolute("pin", mount, lever, center=(0.0, 0.0)))
    scene.add(
        fmbd.joint_spring("stiff", fmbd.displacement(slide), stiffness=stiffness),
        fmbd.force("pull", lever, (1e-3, 0.0)),
    )
    scene.sensor("lever", fmbd.position(lever))
    np.testing.assert_allclose(fmbd.equilibrium(scene)["lever"], (0.5, 0.0), atol=1e-8)


@pytest.mark.parametrize("load", [0.9, 1.1])
def test_a_column_beyond_its_load_is_told_of(load: float, rod_mesh: Any, caplog: pytest.LogCaptureFixture) -> None:
    """Pressed along its axis it stays straight: from Euler's load (pi / 2)^2 E I / L^2 on it would not."""
    modulus, height = 1e8, 0.05
    energy = fmbd.materials.sheet_saint_venant_kirchhoff(modulus, 0.0)
    column = fmbd.AbsoluteBody("column", rod_mesh(height=height), density=1000.0, energy=energy, degree=2)
    euler = (0.5 * np.pi) ** 2 * modulus * height**3 / 12.0
    scene = fmbd.Scene("column")
    scene.add(column, fmbd.fixed("clamp", fmbd.ground, column.surface("pin")))
    scene.add(fmbd.force("press", column.surface("tip"), (-load * euler, 0.0)))
    scene.sensor("tip", fmbd.position(column.surface("tip")))
    assert abs(fmbd.equilibrium(scene)["tip"][1]) < 1e-6
    assert ('unstable: body "column"' in caplog.text) == (load > 1.0)


@pytest.mark.parametrize(("follower", "dead"), [(4.8, 0.0), (0.5, 0.7), (0.5, 1.4), (0.0, 0.9)])
def test_a_column_under_a_force_that_follows_is_unstable_where_it_diverges(
    follower: float, dead: float, caplog: pytest.LogCaptureFixture
) -> None:
    """A pressure on its end has no potential: beyond Euler's load, by which forces are given, the column stands until it flutters
    (Beck, 8.1 of them). It was called unstable; its modes did not settle. With a dead force it diverges as modes tell.
    """
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, 0.1), counts=(12, 1), quads=True)
    euler = (0.5 * np.pi) ** 2 * 1e7 * 0.1**3 / 12.0
    energy = fmbd.materials.sheet_saint_venant_kirchhoff(1e7, 0.0)
    pressed = [fmbd.pressure("right", follower * euler / 0.1)] if follower else []
    column = fmbd.AbsoluteBody("column", mesh, density=1e3, energy=energy, loads=pressed)
    scene = fmbd.Scene("column")
    scene.add(column, fmbd.fixed("clamp", fmbd.ground, column.surface("left")))
    scene.add(fmbd.force("press", column.surface("right"), (-dead * euler, 0.0)))
    found = fmbd.equilibrium(scene)
    grow = fmbd.modes(scene, 2, at=found).eigenvalues.real.max()
    assert (grow > 1.0) == (dead > 1.0)
    assert ('unstable: body "column"' in caplog.text) == (dead > 1.0)
    assert "did not settle" not in caplog.text


def test_a_slender_rod_a_little_beyond_its_load(caplog: pytest.LogCaptureFixture) -> None:
    """Pushed with 1.015 of its buckling load and 1e-3 of that across, one long step leads to the wrong side, which is told.
    Deflections of a thousandth stretch it more than its bending gives way.
    """
    section = fmbd.RodSection((1e8, 1e8, 1e8, 1e3, 1e3, 1e3), 1.0, (2e-3, 1e-3, 1e-3))
    rod = fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], section, elements=8)
    push = 1.015e3 * np.pi**2 / 4.0
    scene = fmbd.Scene("column")
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("start")))
    scene.add(fmbd.force("push", rod.surface("end"), lambda t: (-push * t, 1e-3 * push * t, 0.0)))
    scene.sensor("tip", fmbd.position(rod.surface("end")))
    assert fmbd.equilibrium(scene, path=fmbd.LoadSteps((1.0,)))["tip"][1] < 0.0
    assert 'unstable: body "rod' in caplog.text


@pytest.mark.parametrize("path", [fmbd.ArcLength(1.0), fmbd.LoadSteps(tuple(np.linspace(0.05, 1.0, 20)))])
def test_a_path_stays_on_its_branch(path: Any, caplog: pytest.LogCaptureFixture) -> None:
    """A column pushed with 1.5 of its buckling load and 1e-4 of that across it: the elastica, or it is said that it stands on."""
    rod = fmbd.Rod(
        "rod", [(0, 0, 0), (1, 0, 0)], fmbd.RodSection((1e6, 1e6, 1e6, 1, 1, 1), 1.0, (1e-4,) * 3), elements=4
    )
    push = 1.5 * np.pi**2 / 4.0
    scene = fmbd.Scene("column")
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("start")))
    scene.add(fmbd.force("push", rod.surface("end"), lambda t: (-push * t, 1e-4 * push * t, 0.0)))
    scene.sensor("tip", fmbd.position(rod.surface("end")))
    found = fmbd.equilibrium(scene, path=path)

    # 2 k / a and 2 E(k) / a - L with K(k) = a L, a^2 = P / EI
    bent = np.abs(found["tip"][:2] - (0.36358, 0.78858)).max() < 1e-3
    assert bent or 'unstable: body "rod' in caplog.text
    assert bent or isinstance(path, fmbd.LoadSteps)


def bead_on_hoop(angle: float) -> fmbd.Scene:
    """1 kg on a ring of 1 m that turns about its upright diameter, as the ground does; ``angle`` from the lowest place."""
    bead = fmbd.PointMass("bead", 1.0, (np.sin(angle), 0.0, -np.cos(angle)))
    scene = fmbd.Scene("hoop", gravity=(0.0, 0.0, -9.81))
    scene.add(bead, fmbd.constraint("ring", fmbd.ground, bead, lambda a, b, t: [b.x[1], b.x @ b.x - 1.0]))
    scene.sensor("bead", fmbd.position(bead))
    return scene


@pytest.mark.parametrize(("rate", "angle"), [(2.0, 0.05), (5.0, 0.05), (5.0, 1.0)])
def test_an_unstable_spin_is_told_of(rate: float, angle: float, caplog: pytest.LogCaptureFixture) -> None:
    """Beyond sqrt(g / R) the bead leaves the lowest place for the one with cos(angle) = g / (rate^2 R)."""
    low = fmbd.equilibrium(bead_on_hoop(angle), spin=fmbd.Spin(rate))["bead"][2]
    stays = angle < 0.5
    assert low == pytest.approx(-1.0 if stays else -9.81 / rate**2, rel=1e-9)
    assert ('unstable: body "bead"' in caplog.text) == (stays and rate**2 > 9.81)


def test_gyroscopic_forces_hold_what_spins_fast(caplog: pytest.LogCaptureFixture) -> None:
    """A mass on a round mount beyond its critical speed: forces drive it out, and it whirls about its place all the same."""
    mass = fmbd.RigidBody("disc", 1.0, 1.0, position=(0.0, 0.0))
    scene = fmbd.Scene("rotor")
    scene.add(mass, fmbd.bushing("mount", fmbd.ground, mass, stiffness=(100.0, 100.0, 1e3)))
    found = fmbd.equilibrium(scene, spin=fmbd.Spin(25.0))
    assert np.sort(fmbd.modes(scene, 3, at=found).omega)[:2] == pytest.approx([15.0, np.sqrt(1e3)])
    assert "unstable" not in caplog.text


def test_weight_across_the_axis_of_a_rotation_is_refused() -> None:
    """In axes that turn it goes round: an arm under it hung as if it did not."""
    arm = fmbd.RigidBody("arm", 1.0, (0.1, 0.1, 0.1), position=(0.5, 0.0, 0.0))
    hinge = fmbd.revolute("hinge", fmbd.ground, arm, center=(0.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0))
    scene = fmbd.Scene("arm", gravity=(0.0, 0.0, -9.81))
    scene.add(arm, hinge, fmbd.joint_spring("spring", fmbd.angle(hinge), stiffness=10.0))
    fmbd.equilibrium(scene, spin=fmbd.Spin(3.0))
    with pytest.raises(InputError, match="across the axis"):
        fmbd.equilibrium(scene, spin=fmbd.Spin(3.0, axis=(1.0, 0.0, 0.0)))


def test_nothing_is_told_of_roundoff_where_nothing_displaces(rod_mesh, caplog):
    """A thin strip of aluminium, clamped, without a load: places are known to roundoff, displacements are none."""
    energy = fmbd.materials.saint_venant_kirchhoff(7e10, 0.3)
    strip = fmbd.AbsoluteBody("strip", rod_mesh(dim=2, h=0.1, height=0.002), density=2700.0, energy=energy)
    scene = fmbd.Scene("idle")
    scene.add(strip, fmbd.fixed("clamp", fmbd.ground, strip.surface("pin")))
    scene.sensor("tip", fmbd.position(strip.surface("tip")))
    assert fmbd.equilibrium(scene)["tip"] == pytest.approx([1.0, 0.0], abs=1e-12)
    assert "roundoff" not in caplog.text


def test_load_steps_begin_without_any_force(caplog: pytest.LogCaptureFixture) -> None:
    """A drive twists a rod whose end slides, from no stress on: torque GJ phi / L, unstable from 8.9868 EI / L on (Greenhill)."""
    # the first of two stops is 0.9 of a turn
    for share, stops in ((0.99, (0.5, 1.0)), (1.01, tuple(np.linspace(0.1, 1.0, 10)))):
        section = fmbd.RodSection((1e6, 1e6, 1e6, 8.0, 10.0, 10.0), mass=1.0, inertia=(2e-4, 1e-4, 1e-4))
        rod = fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], section, elements=10)
        plate = fmbd.RigidBody("plate", 0.01, (1e-4, 1e-4, 1e-4), position=(1, 0, 0))
        end = fmbd.cylindrical("end", fmbd.ground, plate, axis=(1, 0, 0))
        turn = share * 8.9868 * 10.0 / 8.0  # rad
        scene = fmbd.Scene("twist")
        scene.add(rod, plate, end, fmbd.fixed("clamp", fmbd.ground, rod.surface("start")))
        scene.add(fmbd.fixed("weld", rod.surface("end"), plate))
        scene.add(fmbd.drive("motor", fmbd.angle(end), lambda t, turn=turn: turn * t))
        scene.sensor("torque", fmbd.reaction("motor"))
        found = fmbd.equilibrium(scene, path=fmbd.LoadSteps(stops))
        assert abs(found["torque"][0]) == pytest.approx(8.0 * turn, rel=1e-4)
        assert ("unstable" in caplog.text) == (share > 1.0)
