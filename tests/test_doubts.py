"""What a run says against itself, and input that means something else than it says."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError, InputError
from fmbd_fenicsx.materials import saint_venant_kirchhoff
from fmbd_fenicsx.notices import Gathered
from fmbd_fenicsx.run import doubts


def swing(dt: float, t_end: float = 2.0, *, floor: bool = False) -> fmbd.Run:
    mesh = fmbd.read_gmsh("meshes/rod.py", dim=2, h=0.1)
    rod = fmbd.FloatingBody("rod", mesh, degree=1, density=1e3, elastic=fmbd.materials.plane_stress(5e6, 0.3))
    scene = fmbd.Scene("swing", gravity=(0.0, -9.81))
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0.0, 0.0)))
    if floor:
        scene.add(fmbd.contact("floor", rod.surface("tip"), fmbd.HalfSpace((0.0, -3.0), (0.0, 1.0))))
    return fmbd.solve(scene, t_end=t_end, dt=dt, scheme=fmbd.ContactAlpha(0.8) if floor else None)


def test_energy_that_grows_is_in_the_report() -> None:
    run = swing(0.5)
    assert any("energy grows by" in text for text in run.warnings)
    assert "look at this" in run.report() and '"rod" in plane stress' in run.report()


def test_energy_that_grows_beside_a_floor_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doubts, "GROWTH", 0.005)
    said = [text for text in swing(0.5, 1.0, floor=True).warnings if "energy grows by" in text]
    assert said and "Radau" not in said[0]


def test_large_turns_beside_a_floor_are_told_of_no_scheme_without_contact() -> None:
    disk = fmbd.RigidBody("disk", 1.0, 0.005, (0.0, 0.1), angular_velocity=-120.0, velocity=(12.0, 0.0))
    scene = fmbd.Scene("rolling", gravity=(0.0, -9.81))
    scene.add(disk, fmbd.contact("floor", fmbd.ball(disk, 0.1), fmbd.HalfSpace((0, 0), (0, 1)), friction=0.3))
    said = [text for text in fmbd.solve(scene, t_end=0.1, dt=0.01).warnings if "turn by up to 1.2 rad" in text]
    assert said and "Radau" not in said[0]


def test_an_overshoot_of_the_first_steps_is_told_from_growth() -> None:
    """A slender rod bent without the contraction across that belongs to it: h omega of that vibration is near 100."""
    mesh = fmbd.read_gmsh("meshes/rod.py", dim=2, h=0.1, height=0.02)
    bent = {"displacement": lambda x: (-1e-3 * x[0] * x[1], 5e-4 * x[0] ** 2)}
    rod = fmbd.FloatingBody("rod", mesh, density=1e3, elastic=fmbd.materials.linear_elastic(5e6, 0.3), **bent)
    scene = fmbd.Scene("overshoot")
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))
    run = fmbd.solve(scene, t_end=2.0, dt=0.02)
    total = run.total_energy
    assert total.max() > 2.0 * total[0] > 2.0 * total[-1]
    assert [text for text in run.warnings if "falls again" in text] and not any("grows by" in x for x in run.warnings)


def test_cells_turned_inside_out_are_told(rod_mesh: Callable[..., Any]) -> None:
    """An energy of the Green-Lagrange strain lets a bar be pushed through its own end, or be in a mirror."""
    soft = fmbd.AbsoluteBody("bar", rod_mesh(h=0.5, height=0.4), density=1e3, energy=saint_venant_kirchhoff(1e2, 0.0))

    def through(x: np.ndarray) -> np.ndarray:
        return np.array([-2.0 * x[0], 0.0 * x[1]])

    # at the start, and where a run leads
    scene = fmbd.Scene("mirror")
    scene.add(soft.with_(displacement=through))
    with pytest.raises(InputError, match='"bar": its initial displacement turns cells inside out'):
        scene.build()
    scene = fmbd.Scene("thrown")
    scene.add(soft.with_(displacement_rate=lambda x: 1e3 * through(x)))
    assert [text for text in fmbd.solve(scene, t_end=1e-3, dt=1e-4).warnings if '"bar" has cells' in text]

    # in equilibrium
    scene = fmbd.Scene("pushed")
    scene.add(soft, fmbd.tie_surface("wall", soft.surface("pin"), fmbd.ground))
    push = {"shape": lambda x: np.array([0 * x[0] - 1, 0 * x[1]]), "motion": lambda t: t}
    scene.add(fmbd.tie_surface("push", soft.surface("tip"), fmbd.ground, **push))
    assert fmbd.equilibrium(scene, t=0.2).state is not None
    with pytest.raises(ConvergenceError, match='cells of body "bar" are turned inside out'):
        fmbd.equilibrium(scene, t=1.8)


@pytest.mark.parametrize("scheme", [fmbd.Radau(rtol=None), fmbd.GeneralizedAlpha(form=fmbd.GGL(), compiled=False)])
def test_bodies_that_turn_too_far_in_a_step_are_told(scheme: Any) -> None:
    """A fast link at 2 rad a step ends far from where it does, with joints and balance closed."""
    scene = fmbd.Scene("link", gravity=(0.0, -9.81))
    link = fmbd.RigidBody("link", 1.0, 1 / 12, (0.5, 0.0), velocity=(0.0, 10.0), angular_velocity=20.0)
    scene.add(link, fmbd.revolute("pin", fmbd.ground, link, center=(0.0, 0.0)))
    scene.sensor("end", fmbd.position(link, point=(1.0, 0.0)))

    good, coarse = (
        fmbd.solve(scene, t_end=2.0, scheme=fmbd.Radau()),
        fmbd.solve(scene, t_end=2.0, dt=0.1, scheme=scheme),
    )
    assert np.linalg.norm(good["end"][-1] - coarse["end"][-1]) > 0.1 and not good.warnings
    assert [text for text in coarse.warnings if "bodies turn by up to 2" in text]
    assert not fmbd.solve(scene, t_end=0.5, dt=0.01, scheme=scheme).warnings


def test_doubts_come_by_weight() -> None:
    """A fast precession of a top, whose rows turn too far a step: that comes before the one step that was repeated."""
    mass, length, across, along, spin, tilt = 1.0, 0.3, 0.12, 0.02, 300.0, np.pi / 3
    rate = np.roots([across * np.cos(tilt), -along * spin, mass * 9.81 * length]).real.max()
    R = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    turning, place = np.array([-rate * np.sin(tilt), 0.0, spin]), R @ [0.0, 0.0, length]
    inertia = (across - mass * length**2, across - mass * length**2, along)
    top = fmbd.RigidBody(
        "top", mass, inertia, place, rotation=R, velocity=np.cross(R @ turning, place), angular_velocity=turning
    )
    scene = fmbd.Scene("top", gravity=(0.0, 0.0, -9.81))
    scene.add(top, fmbd.spherical("pivot", fmbd.ground, top, center=(0.0, 0.0, 0.0)))
    told = fmbd.solve(scene, t_end=2.0, dt=1e-3, scheme=fmbd.GeneralizedAlpha(0.9)).warnings
    assert len(told) == 2 and "fmbd.GGL()" in told[0] and "of 2000 steps gained energy" in told[1]


def test_a_good_run_has_no_warnings() -> None:
    run = swing(0.01, 0.2)
    assert run.warnings == [] and "look at this" not in run.report()


def test_arms_that_hold_each_other_at_rest_open_no_joints() -> None:
    """Forty arms around a hub, none of which can fall: all that moves is the roundoff of places within a step."""
    scene = fmbd.Scene("star", gravity=(0.0, -9.81, 0.0))
    hub = fmbd.RigidBody("hub", 10.0, (1.0, 1.0, 1.0))
    scene.add(hub, fmbd.spherical("ball", fmbd.ground, hub, center=(0.0, 0.0, 0.0)))
    for i, angle in enumerate(2 * np.pi * np.arange(40) / 40):
        out, along = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([-np.sin(angle), np.cos(angle), 0.0])
        arm = fmbd.RigidBody(f"arm {i}", 1.0, (0.1, 0.1, 0.1), position=1.5 * out)
        pin = fmbd.revolute(f"pin {i}", hub, arm, center=out, axis=along)
        scene.add(arm, pin, fmbd.joint_spring(f"spring {i}", fmbd.angle(pin), stiffness=5.0, damping=0.1))
    run = fmbd.solve(scene, t_end=0.5, dt=1e-3)
    assert run.warnings == [] and np.ptp(run.energy["kinetic"]) < 1e-18


def test_a_scene_that_cannot_move_says_so() -> None:
    body = fmbd.RigidBody("bar", 1.0, 0.1, position=(0.5, 0.0))
    scene = fmbd.Scene("truss", gravity=(0.0, -9.81))
    scene.add(body, fmbd.fixed("weld", fmbd.ground, body, center=(0.0, 0.0)))
    run = fmbd.solve(scene, t_end=0.1, dt=0.01)
    assert any("0 degrees of freedom" in text for text in run.warnings)


def test_what_moves_on_redundant_rows_moves_in_every_attempt() -> None:
    """A door on two hinges, ten rows of rank five; later attempts find their start where dependent rows are known."""
    door = fmbd.RigidBody("door", 2.0, (0.2, 0.3, 0.1), (0.5, 0.0, 0.0))
    scene = fmbd.Scene("door", gravity=(0.0, -9.81, 0.0))
    for name, height in (("low", 0.0), ("high", 1.0)):
        scene.add(fmbd.revolute(name, fmbd.ground, door, center=(0.0, 0.0, height)))
    scene.add(door)
    scene.sensor("x", fmbd.position(door))
    run = fmbd.solve(scene, t_end=1.0, tol={"x": 1e-4})
    assert len(run.history) > 1 and run.warnings == []


def test_open_velocities_are_warned_of() -> None:
    def jolting(t: Any) -> Any:
        return np.where(np.real(t) < 0.05, 0.0, 3.0 * (t - 0.05))

    body = fmbd.RigidBody("bar", 1.0, 0.1, position=(0.5, 0.0))
    scene = fmbd.Scene("drive")
    pin = fmbd.revolute("pin", fmbd.ground, body, center=(0.0, 0.0))
    scene.add(body, pin, fmbd.drive("motor", fmbd.angle(pin), jolting))
    run = fmbd.solve(scene, t_end=0.1, dt=0.01)
    assert any("joints open at up to" in text for text in run.warnings)
    assert any('"motor" has a kink at t = 0.05 s' in text for text in run.warnings)


def test_reactions_of_a_sliding_head_that_alternate_and_grow_are_told() -> None:
    """Its row turns as it slides by a twelfth of a cell a step: more than index 3 bears with rho_inf = 0.8."""

    def run(scheme: fmbd.GeneralizedAlpha) -> fmbd.Run:
        wires = fmbd.Wires("wire", 30.0, 60, (fmbd.Wire(1.35, 20e3, 195.0),), (), (), 0.01, 1e-4)
        head = fmbd.CoordinateBody("head", 5.0 * np.eye(1), lambda q, v, t: 100.0 - 300.0 * v - 1000.0 * q, np.zeros(1))
        scene = fmbd.Scene("sliding", gravity=(0.0, -9.81), settle=True)
        scene.add(wires, head, fmbd.SlidingContact("contact", wires, head, start=3.0, speed=20.0, ramp=0.2))
        scene.sensor("force", fmbd.reaction("contact"))
        return fmbd.solve(scene, t_end=0.4, dt=2e-3, scheme=scheme)

    index_3 = run(fmbd.GeneralizedAlpha(0.8))
    assert abs(index_3["force"]).max() > 1e3
    assert [text for text in index_3.warnings if "alternate from step to step and grow. Take form=fmbd.GGL()" in text]
    for scheme in (fmbd.GeneralizedAlpha(0.8, fmbd.GGL()), fmbd.GeneralizedAlpha(0.5)):
        good = run(scheme)
        assert abs(good["force"]).max() < 150.0 and good.warnings == []


@pytest.mark.parametrize("form", [fmbd.Index1(), fmbd.Index2()], ids=lambda form: form.name)
def test_joints_that_drift_apart_are_warned_of(form: Any) -> None:
    """Where the form holds no positions: with large steps, and not with small ones."""
    said = []
    for dt in (0.02, 0.005):
        scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81))
        arm = fmbd.RigidBody("arm", 1.0, 0.1, position=(0.5, 0.0))
        scene.add(arm, fmbd.revolute("pin", fmbd.ground, arm, center=(0.0, 0.0)))
        run = fmbd.solve(scene, t_end=1.0, dt=dt, scheme=fmbd.BDF(2, form=form, rtol=None))
        said.append("joints are open" in run.report().replace("\n", " "))
        assert said[-1] == (run.drift[0] > 1e-3 * run.system.length)
    assert said == [True, False]


@pytest.mark.parametrize("form", [fmbd.Index1(), fmbd.Index2()], ids=lambda form: form.name)
@pytest.mark.parametrize("apart", [0.0, 1e-6])
def test_drives_that_contradict_each_other_around_a_loop_are_warned_of(form: Any, apart: float) -> None:
    """Both cranks of a parallelogram are driven, one further than the other: a form that holds no positions shares out the
    difference, far below what drifts.
    """
    scene = fmbd.Scene("parallelogram", gravity=(0.0, -9.81))
    first, rod, last = (
        fmbd.RigidBody(name, 1.0, 0.1, position) for name, position in (("a", (0, 0.5)), ("b", (1, 1)), ("c", (2, 0.5)))
    )
    pins = [fmbd.revolute(f"pin {k}", fmbd.ground, x, center=(2 * k, 0)) for k, x in enumerate((first, last))]
    scene.add(
        first,
        rod,
        last,
        *pins,
        fmbd.revolute("near", first, rod, center=(0, 1)),
        fmbd.revolute("far", rod, last, center=(2, 1)),
    )
    for k, pin in enumerate(pins):
        scene.add(fmbd.drive(f"drive {k}", fmbd.angle(pin), lambda t, k=k: 0.5 * np.sin(t) + k * apart * t**3))
    run = fmbd.solve(scene, t_end=1.0, dt=0.02, scheme=fmbd.BDF(2, form=form, rtol=None))
    assert 1e-5 < run.drift[0] < 1e-3
    assert any("contradict each other" in text for text in run.warnings) == (apart > 0.0)


def test_impacts_of_three_steps_are_counted() -> None:
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, 0.1), counts=(20, 1), origin=(0.01, 0.0))
    bar = fmbd.AbsoluteBody(
        "bar", mesh, degree=1, density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.0), velocity=(-0.1, 0.0)
    )
    scene = fmbd.Scene("impact")
    wall = fmbd.Obstacle("wall", fmbd.HalfSpace((0.0, 0.0), (1.0, 0.0)))
    scene.add(bar, fmbd.contact("hit", bar.surface("left"), wall))

    coarse = fmbd.solve(scene, t_end=5.0, dt=0.9)  # in contact for 2 s, the time of a wave there and back
    fine = fmbd.solve(scene, t_end=5.0, dt=0.05)
    assert any("impacts lasted three steps or less" in text for text in coarse.warnings)
    assert fine.counters["impacts"] >= 1 and not any("three steps" in text for text in fine.warnings)


@pytest.mark.parametrize("kind", [fmbd.FloatingBody, fmbd.AbsoluteBody])
def test_laws_of_sheets_are_refused_in_space(kind: Any) -> None:
    mesh = fmbd.read_gmsh("meshes/rod.py", dim=3, h=0.1)
    for law in (fmbd.materials.plane_stress, fmbd.materials.plane_strain):
        with pytest.raises(InputError, match=f"{law.__name__} is a law of sheets in the plane"):
            kind("rod", mesh, density=1e3, elastic=law(5e6, 0.45))
    with pytest.raises(InputError, match="law of sheets in the plane"):
        kind("rod", mesh, density=1e3, energy=fmbd.materials.sheet_saint_venant_kirchhoff(5e6, 0.45))

    # a law under the other one's name
    with pytest.raises(InputError, match="elastic is a stored energy; give it as energy="):
        kind("rod", mesh, density=1e3, elastic=fmbd.materials.neo_hookean(5e6, 0.45))
    with pytest.raises(InputError, match="energy is a bilinear form; give it as elastic="):
        kind("rod", mesh, density=1e3, energy=fmbd.materials.linear_elastic(5e6, 0.45))


def test_of_many_warnings_of_one_kind_three_are_kept() -> None:
    from fmbd_fenicsx.log import log

    with Gathered() as gathered:
        for t in range(10):
            log.warning("near-singular at t = %d s", t)
        log.warning("something else")
    lines = gathered.lines()
    assert len(lines) == 4 and "7 more of this kind" in lines[2] and lines[3] == "something else"


def test_warnings_told_as_whole_sentences_are_of_one_kind_where_only_names_and_numbers_differ() -> None:
    from fmbd_fenicsx.log import log

    with Gathered() as gathered:
        for i in range(5):
            log.warning("%s", f'joint "pin {i}" is open by {10.0**-i:g} m')
        log.warning("%s", "a step was halved")
    lines = gathered.lines()
    assert len(lines) == 4 and "2 more of this kind" in lines[2] and lines[3] == "a step was halved"


@pytest.mark.parametrize("place", [(0.0075, 0.0), (0.003, 0.002)])
def test_gaps_of_quadratic_surfaces_beside_a_sphere_are_distances(place: tuple[float, float]) -> None:
    """Of the nodes: between vertices they were off by h^2 / (12 R)."""
    size, cells, radius, above = (0.06, 0.03, 0.06), (4, 2, 4), 0.02, 1.6e-3
    mesh = fmbd.read_gmsh("meshes/block.py", size=size, origin=(-0.03, -0.03, -0.03), counts=cells)
    block = fmbd.AbsoluteBody("block", mesh, degree=2, density=1e3, elastic=fmbd.materials.linear_elastic(1e9, 0.3))
    ball = fmbd.RigidBody("ball", 0.1, (1e-5,) * 3, position=(place[0], radius + above, place[1]))
    pair = fmbd.contact("hit", block.surface("top"), fmbd.Obstacle("sphere", fmbd.Sphere(radius), on=ball))
    scene = fmbd.Scene("sphere")
    scene.add(block, ball, pair, fmbd.fixed("clamp", fmbd.ground, block.surface("bottom")))
    scene.sensor("gap", fmbd.contact_gap(pair))
    found = fmbd.solve(scene, t_end=1e-6, dt=1e-6)["gap"][0].min()

    x = np.linspace(-0.03, 0.03, 9)  # nodes on a line, vertices and middles
    aside = np.min((x[:, None] - place[0]) ** 2 + (x[None, :] - place[1]) ** 2)
    assert found == pytest.approx(np.sqrt((radius + above) ** 2 + aside) - radius, rel=1e-9)


def test_bodies_at_rest_do_not_gain_energy_by_roundoff() -> None:
    """A clamped body without any load, of micrometres to a thousand kilometres: what moves is the last digit alone."""
    for size in (1e-6, 1.0, 1e6):
        mesh = fmbd.read_gmsh("meshes/rod.py", dim=2, h=0.25 * size, length=size, height=0.5 * size)
        rod = fmbd.FloatingBody(
            "rod", mesh, degree=1, density=3.0, elastic=fmbd.materials.plane_stress(1e6 * size**2, 0.3)
        )
        scene = fmbd.Scene("rest")
        scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin"), center=(0.0, 0.3 * size)))
        assert fmbd.solve(scene, t_end=0.02, dt=0.01).warnings == []


def test_velocities_that_joints_do_not_allow_are_told_at_the_start() -> None:
    """An arm on a pin is told to turn but its centre is not: said by name; not where both fit, or where a drive moves it.

    An arm of micrometres as one of metres.
    """

    def told(
        velocity: tuple[float, float] | None, rate: float, *, driven: bool = False, size: float = 1.0
    ) -> list[str]:
        inertia, place = 0.1 * size * size, (0.5 * size, 0.0)
        arm = fmbd.RigidBody("arm", 1.0, inertia, position=place, velocity=velocity, angular_velocity=rate)
        pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0.0, 0.0))
        scene = fmbd.Scene("arm")
        scene.add(arm, pin)
        if driven:
            scene.add(fmbd.drive("motor", fmbd.angle(pin), lambda t: 2.0 * t))
        return [w for w in fmbd.solve(scene, t_end=0.01, dt=1e-3).warnings if "contradict" in w]

    (found,) = told(None, 2.0)
    # the rate that keeps the angular momentum about the pin: 2 I / (I + m l^2)
    assert 'body "arm" is changed by 0.714 m/s' in found
    assert 'body "arm" is changed by 7.14e-07 m/s' in "".join(told(None, 2.0, size=1e-6))
    assert not told((0.0, 1.0), 2.0)
    assert not told(None, 0.0, driven=True)


def test_tables_that_end_before_the_run_are_told_with_whose_they_are() -> None:
    """Of gravity, a force, a motor's target, a drive; the joint's own is long enough."""
    t = np.linspace(0.0, 0.1, 11)
    short, long = CubicSpline(t, 0.1 * np.sin(t)), CubicSpline(10 * t, 0.1 * np.sin(t))
    arm, other = (fmbd.RigidBody(name, 1.0, 0.1, (0.5, 0.0)) for name in ("arm", "other"))
    pins = [fmbd.revolute(f"pin {b.name}", fmbd.ground, b, center=(0, 0)) for b in (arm, other)]
    scene = fmbd.Scene("tables", gravity=CubicSpline(t, np.outer(np.ones(11), [0.0, -9.81])))
    scene.add(arm, other, *pins, fmbd.drive("quick", fmbd.angle(pins[0]), short))
    scene.add(fmbd.effort("push", fmbd.angle(pins[1]), short), fmbd.effort("pull", fmbd.angle(pins[1]), long))
    run = fmbd.solve(scene, t_end=0.2, dt=0.01)
    told = [x.split(" goes")[0] for x in run.warnings if "extrapolated" in x]
    assert told == ["the table of gravity", 'the table of joint spring or effort "push"', 'the table of joint "quick"']
