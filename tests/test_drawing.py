"""The drawing of a run as data: every piece lies where the mechanics says that it is."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_line_body import line

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.fem.elastic_forms import ElasticForms
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.post.drawing.draw import draw
from fmbd_fenicsx.post.drawing.obstacles import region
from fmbd_fenicsx.post.drawing.render import strobe
from fmbd_fenicsx.post.drawing.scene_graph import Drawing, Piece, Role
from fmbd_fenicsx.post.drawing.skins import skin
from fmbd_fenicsx.post.drawing.solids import arrow, box, cylinder, hull, read_stl, sphere

ELASTIC = fmbd.materials.linear_elastic(5e6, 0.3)


def area(x: Any, triangles: Any) -> float:
    a, b, c = (np.pad(x[triangles[:, k]], ((0, 0), (0, 3 - x.shape[1]))) for k in range(3))
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def everywhere(field: Field) -> Any:
    """Nodes of all ranks in global order."""
    return np.concatenate(field.comm.allgather(field.X))


def piece(drawing: Drawing, name: str) -> Piece:
    return next(p for p in drawing.pieces if p.name == name)


def few(snapshots: Any = 3, **more: Any) -> fmbd.Output:
    return fmbd.Output(snapshots=snapshots, **more)


@pytest.mark.mpi
@pytest.mark.parametrize(("dim", "degree"), [(2, 1), (2, 2), (2, 3), (3, 1), (3, 2)])
def test_skin_has_the_area_and_the_edges_of_the_body(rod_mesh: Any, dim: int, degree: int) -> None:
    field = Field("rod", rod_mesh(dim, 0.2), ElasticForms(ELASTIC, 1000.0, degree))
    s, x = skin(field.space), everywhere(field)
    assert area(x, s.triangles) == pytest.approx(0.1 if dim == 2 else 4 * 0.1 + 2 * 0.01)
    sides = np.sort(s.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    found, times = np.unique(sides, axis=0, return_counts=True)
    single = {tuple(e) for e in found[times == 1]}
    assert times.max() == 2 and single == ({tuple(sorted(e)) for e in s.edges} if dim == 2 else set())
    if dim == 2:
        length = np.linalg.norm(x[s.edges[:, 0]] - x[s.edges[:, 1]], axis=1).sum()
        assert length == pytest.approx(2.2)


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
def test_paint_is_the_quantity_at_the_middle_of_each_triangle(rod_mesh: Any, dim: int) -> None:
    """A stretch u = (x^2, 0): its first strain is 2 x."""
    mesh = rod_mesh(dim, 0.25)

    def stretched(x: Any) -> Any:
        u = np.zeros((dim, x.shape[1]))
        u[0] = 1e-3 * x[0] ** 2
        return u

    rod = fmbd.AbsoluteBody("rod", mesh, degree=2, density=1e3, elastic=ELASTIC, displacement=stretched)
    scene = fmbd.Scene("stretched")
    scene.add(rod)
    run = fmbd.solve(scene, t_end=1e-9, dt=1e-9, output=few(2))
    drawing = draw(run, paint=fmbd.Paint(lambda u: u[0].dx(0), "strain (-)"))
    if mesh.dolfinx.comm.rank == 0:
        found = piece(drawing, "rod")
        x = found.at(0)[found.triangles].mean(1)[:, 0]
        assert found.paint is not None and len(x) == found.paint.shape[1]
        assert found.paint[0] == pytest.approx(2e-3 * x, abs=5e-6)


@pytest.mark.mpi
def test_full_and_reduced_bodies_are_drawn_alike(rod_mesh: Any) -> None:
    """A reduced body shows its mesh where the full one does: its ends are where the sensors are."""
    mesh = rod_mesh(2, 0.25)
    full = fmbd.FloatingBody("full", mesh, degree=2, density=1e3, elastic=ELASTIC)
    few_modes = full.with_(name="few", mesh=mesh.placed((0.0, -1.0))).reduced(modes=8)
    scene = fmbd.Scene("two", gravity=(0, -9.81))
    for body, y in ((full, 0.0), (few_modes, -1.0)):
        scene.add(body, fmbd.revolute(f"pin of {body.name}", fmbd.ground, body.surface("pin"), center=(0, y)))
        scene.sensor(body.name, fmbd.sensors.position(body.surface("tip")))
    run = fmbd.solve(scene, t_end=0.2, dt=5e-3, output=few())
    drawing = draw(run)
    if mesh.dolfinx.comm.rank == 0:
        one, two = (piece(drawing, name) for name in ("full", "few"))
        assert np.abs(one.at(2) - two.at(2) - [0, 1.0, 0]).max() < 2e-3
        assert area(two.at(2), two.triangles) == pytest.approx(0.1, rel=0.05)
        tip = np.isclose(one.at(0)[:, 0], 1.0)
        assert two.at(2)[tip].mean(0)[:2] == pytest.approx(run["few"][-1], abs=2e-3)


def pendulum(**more: Any) -> tuple[fmbd.Scene, fmbd.RigidBody]:
    bob = fmbd.RigidBody("bob", 1.0, 0.1, position=(1.0, 0.0), **more)
    scene = fmbd.Scene("pendulum", gravity=(0, -9.81))
    scene.add(bob, fmbd.revolute("pin", fmbd.ground, bob, center=(0, 0)))
    return scene, bob


def test_a_body_without_a_shape_has_a_bar_to_each_of_its_joints() -> None:
    scene, bob = pendulum()
    scene.sensor("bob", fmbd.sensors.position(bob))
    run = fmbd.solve(scene, t_end=0.3, dt=0.01, output=few())
    drawing = draw(run)
    for k, row in enumerate((0, 15, 30)):
        x = piece(drawing, "bob").at(k)[:, :2]
        bar = run["bob"][row] / 2
        assert np.linalg.norm(x - bar, axis=1).max() < 0.55  # reaches from the pin to the bob and not farther
        assert np.linalg.norm(x, axis=1).min() < 0.02 and np.linalg.norm(x - run["bob"][row], axis=1).min() < 0.02
        assert piece(drawing, "pin").at(k)[:, :2].mean(0) == pytest.approx((0, 0), abs=1e-9)
    assert {p.role for p in drawing.pieces} == {Role.BODY, Role.JOINT, Role.GROUND}


def test_a_drive_turns_about_its_joint_and_has_no_bar() -> None:
    scene, bob = pendulum()
    plain = draw(fmbd.solve(scene, t_end=0.1, dt=0.05, output=few()))
    scene.add(fmbd.drive("drive", fmbd.angle(scene.joints["pin"]), lambda t: t))
    driven = draw(fmbd.solve(scene, t_end=0.1, dt=0.05, output=few()))
    assert len(piece(driven, "bob").triangles) == len(piece(plain, "bob").triangles)
    assert piece(driven, "drive").role is Role.DRIVE
    assert np.abs(piece(driven, "drive").at(2)).max() < 0.1


def test_shape_of_a_rigid_body_moves_with_it() -> None:
    scene, bob = pendulum(shape=fmbd.contacts.Box((0.2, 0.1), center=(0.05, 0.0)))
    bare = fmbd.solve(scene, t_end=0.3, dt=0.01, output=few())
    scene.sensor("bob", fmbd.sensors.position(bob))
    scene.sensor("angle", fmbd.sensors.rotation(bob))
    run = fmbd.solve(scene, t_end=0.3, dt=0.01, output=few())
    assert np.array_equal(bare.state.q, run.state.q)
    corners = piece(draw(run), "bob").at(2)[:4, :2]
    a = float(run["angle"][-1, 0])
    R = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    own = np.array([(-0.05, -0.05), (0.15, -0.05), (0.15, 0.05), (-0.05, 0.05)])
    assert corners == pytest.approx(run["bob"][-1] + own @ R.T, abs=1e-12)


def write_stl(file: Path, triangles: np.ndarray, *, binary: bool) -> None:
    if binary:
        rows = b"".join(struct.pack("<12fH", *np.zeros(3), *t.ravel(), 0) for t in triangles)
        file.write_bytes(b"\0" * 80 + struct.pack("<I", len(triangles)) + rows)
        return
    facets = ["facet normal 0 0 1\nouter loop\n" + "".join(f"vertex {x} {y} {z}\n" for x, y, z in t) for t in triangles]
    file.write_text("solid part\n" + "endloop\nendfacet\n".join([*facets, ""]) + "endsolid part\n")


@pytest.mark.parametrize("binary", [True, False])
def test_stl_file_is_read_and_drawn(tmp_path: Path, binary: bool) -> None:
    cube = box((0.2, 0.4, 0.6))
    file = tmp_path / "part.stl"
    write_stl(file, cube.points[cube.triangles].astype(np.float32), binary=binary)
    found = read_stl(file)
    assert len(found.points) == 8 and len(found.triangles) == 12 and len(found.edges) == 12
    assert area(found.points, found.triangles) == pytest.approx(2 * (0.08 + 0.24 + 0.12), rel=1e-6)

    body = fmbd.RigidBody("part", 1.0, (1.0, 1.0, 1.0), (0.0, 1.0, 0.0), shape=file)
    scene = fmbd.Scene("falling", gravity=(0, 0, -9.81))
    scene.add(body)
    run = fmbd.solve(scene, t_end=0.1, dt=0.05, output=few(2))
    x = piece(draw(run), "part").at(1)
    assert x.mean(0) == pytest.approx((0.0, 1.0, -0.5 * 9.81 * 0.01), abs=1e-3)


def test_shapes_that_cannot_be_drawn_are_refused_where_they_are_given(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='"a": shape "none.stl": there is no such file'):
        fmbd.RigidBody("a", 1.0, 1.0, shape="none.stl")
    with pytest.raises(InputError, match="no STL file"):
        fmbd.RigidBody("a", 1.0, 1.0, shape="part.step")
    with pytest.raises(InputError, match=r"neither a shape such as fmbd.contacts.Box"):
        fmbd.RigidBody("a", 1.0, 1.0, shape=3.0)
    broken = tmp_path / "broken.stl"
    broken.write_text("solid x\nvertex 0 0 0\nendsolid\n")
    with pytest.raises(InputError, match="found 1 corners"):
        read_stl(broken)


@pytest.mark.parametrize(
    "solid", [box((1, 2, 3)), cylinder(0.5, 2.0, (1, 1, 0)), sphere(1.0), hull(np.eye(3)[[0, 1, 2, 0]] * 2)]
)
def test_edges_and_triangles_name_points(solid: Any) -> None:
    for numbers in (solid.triangles, solid.edges):
        assert numbers.size == 0 or (numbers.min() >= 0 and numbers.max() < len(solid.points))


def test_solids_have_their_areas() -> None:
    ball, tube = sphere(1.0, 40), cylinder(0.5, 2.0, (1, 1, 0))
    assert area(ball.points, ball.triangles) == pytest.approx(4 * np.pi, rel=0.01)
    assert area(tube.points, tube.triangles) == pytest.approx(2 * np.pi * 0.5 * 2.5, rel=0.02)


def test_level_sets_have_the_area_of_the_region() -> None:
    disk = region(lambda y: np.linalg.norm(y, axis=1) - 1.0, -1.2 * np.ones(2), 1.2 * np.ones(2))
    assert area(disk.points, disk.triangles) == pytest.approx(np.pi, rel=2e-3)
    ball = region(lambda y: np.linalg.norm(y, axis=1) - 1.0, -1.2 * np.ones(3), 1.2 * np.ones(3))
    assert area(ball.points, ball.triangles) == pytest.approx(4 * np.pi, rel=1e-2)


def test_contact_draws_balls_obstacles_and_forces() -> None:
    ball = fmbd.RigidBody("ball", 1.0, 0.1, (0.0, 0.5))
    floor = fmbd.contacts.Obstacle("floor", fmbd.contacts.HalfSpace((0, 0), (0, 1)))
    scene = fmbd.Scene("drop", gravity=(0, -9.81))
    touch = fmbd.contact("touch", fmbd.contacts.ball(ball, 0.2), floor)
    scene.add(ball, touch)
    scene.sensor("force", fmbd.sensors.contact_force(touch))
    run = fmbd.solve(scene, t_end=1.5, dt=2e-3, scheme=fmbd.Moreau(), output=few())
    drawing = draw(run, view=fmbd.View(contact=True))

    x = piece(drawing, "ball").at(2)
    assert np.ptp(x[:, 0]) == pytest.approx(0.4, rel=1e-2) and x[:, 1].min() == pytest.approx(0.0, abs=1e-3)
    ground = piece(drawing, "floor").at(0)
    assert ground[:, 1].max() == pytest.approx(0.0, abs=1e-12) and ground[:, 1].min() < 0

    # the arrow is as long as the force is large, against the largest
    arrow = piece(drawing, "contact force 1")
    assert run["force"][-1, 1] > 0
    assert np.ptp(arrow.at(2)[:, 1]) > 0.05 and np.ptp(arrow.at(0)[:, 1]) == 0.0

    # and the drawing says how large that is
    (scale,) = drawing.scales
    largest = max(float(run["force"][int(np.argmin(np.abs(run.times - t))), 1]) for t in drawing.times)
    assert scale.largest == pytest.approx(largest, rel=1e-12)
    assert scale.text == f"contact forces, longest arrow {largest:.3g} N"


def test_springs_reach_from_end_to_end_and_reactions_hold() -> None:
    bob = fmbd.RigidBody("bob", 2.0, 0.1, (0.0, -1.0))
    scene = fmbd.Scene("hanging", gravity=(0, -9.81))
    scene.add(bob, fmbd.Spring("spring", fmbd.ground, bob, (0, 0), (0, -1), stiffness=50.0, damping=1.0, length=1.0))
    scene.add(fmbd.forces.force("push", bob, lambda t: (3.0, 0.0)))
    scene.sensor("bob", fmbd.sensors.position(bob))
    run = fmbd.solve(scene, t_end=0.5, dt=0.01, output=few())
    drawing = draw(run, view=fmbd.View(forces=True))
    for k, row in enumerate((0, 25, 50)):
        coil = piece(drawing, "spring").at(k)
        assert coil[0] == pytest.approx((0, 0, 0), abs=1e-12)
        assert coil[-1, :2] == pytest.approx(run["bob"][row], abs=1e-9)
    assert [s.text for s in drawing.scales] == ["applied forces, longest arrow 3 N"]
    push = piece(drawing, "push").at(1)
    assert np.ptp(push[:, 0]) > 0.1 and push[:, 0].min() == pytest.approx(run["bob"][25, 0], abs=1e-9)


JOINTS: dict[str, Any] = {
    "revolute": lambda a, b, x: fmbd.revolute("revolute", a, b, center=x),
    "fixed": lambda a, b, x: fmbd.fixed("fixed", a, b, center=x),
    "slider": lambda a, b, x: fmbd.prismatic("slider", a, b, center=x, axis=np.eye(len(x))[0]),
    "line": lambda a, b, x: fmbd.point_on_line("line", a, b, center=x, axis=np.eye(len(x))[0]),
    "rod": lambda a, b, x: fmbd.distance("rod", a, b, point_a=x, point_b=np.add(x, np.eye(len(x))[0])),
    "cylindrical": lambda a, b, x: fmbd.cylindrical("cylindrical", a, b, center=x, axis=(0, 0, 1)),
    "planar": lambda a, b, x: fmbd.planar("planar", a, b, center=x, normal=(0, 0, 1)),
    "spherical": lambda a, b, x: fmbd.spherical("spherical", a, b, center=x),
}


@pytest.mark.parametrize("dim", [2, 3])
def test_joints_springs_and_wheels_are_drawn_where_they_are(dim: int) -> None:
    scene = fmbd.Scene("all sorts")
    names = list(JOINTS)[: 5 if dim == 2 else None]
    inertia = 1.0 if dim == 2 else (1.0, 1.0, 1.0)
    for k, name in enumerate(names):
        x = np.eye(dim)[0] * 3 * k
        body = fmbd.RigidBody(f"body {name}", 1.0, inertia, x + np.eye(dim)[0])
        scene.add(body, JOINTS[name](fmbd.ground, body, x))
    hinge, slider = fmbd.angle(scene.joints["revolute"]), fmbd.displacement(scene.joints["slider"])
    scene.add(fmbd.joint_spring("coil", hinge, stiffness=1.0), fmbd.joint_spring("push", slider, stiffness=1.0))
    scene.add(fmbd.joint_spring("motor", hinge, law=lambda s, rate, t: 0.1))
    wheel = fmbd.RigidBody("wheel", 1.0, inertia, np.eye(dim)[-1])
    scene.add(
        wheel, fmbd.Tyre("tyre", wheel, up=np.eye(dim)[1], radius=1.0, stiffness=100.0, road=lambda p, t: 0.0 * p[0])
    )
    drawing = draw(fmbd.solve(scene, t_end=0.02, dt=0.01, output=few(2)))
    for k, name in enumerate(names):
        x = piece(drawing, name).at(0)
        middle = 3 * k + (0.5 if name == "rod" else 0.0)
        assert 0.5 * (x.max(axis=0) + x.min(axis=0)) == pytest.approx((middle, 0, 0), abs=1e-6), name
    assert {piece(drawing, name).role for name in ("coil", "push")} == {Role.SPRING}
    assert piece(drawing, "motor").role is Role.DRIVE
    circle = piece(drawing, "tyre").at(0)
    assert np.linalg.norm(circle - np.eye(3)[dim - 1], axis=1) == pytest.approx(np.ones(len(circle)))


def test_beams_and_lines_of_own_equations_are_drawn() -> None:
    section = fmbd.Section.rectangle(youngs_modulus=1e8, poisson_ratio=0.3, density=1e3, width=0.05, height=0.05)
    beam = fmbd.Beam("beam", (0.0, 0.0), (1.0, 0.0), section, elements=4)
    swing = fmbd.CoordinateBody(
        "swing", np.eye(1), lambda q, v, t: -q, (0.1,), outline=lambda q: [np.array([(0, 0), (np.sin(q[0]), 1.0)])]
    )
    rope = line()
    scene = fmbd.Scene("lines", gravity=(0, -9.81))
    scene.add(beam, swing, rope, fmbd.revolute("pin", fmbd.ground, beam.surface("start"), center=(0, 0)))
    scene.sensor("end", fmbd.sensors.position(beam.surface("end")))
    run = fmbd.solve(scene, t_end=0.3, dt=5e-3, output=few())
    drawing = draw(run)
    x = piece(drawing, "beam").at(2)
    assert np.linalg.norm(x[-1, :2] - run["end"][-1]) < 1e-6  # the tube's last point is the middle of its end
    assert np.ptp(piece(drawing, "beam").at(0)[:, 1]) == pytest.approx(section.thickness, rel=0.1)
    assert section.thickness == pytest.approx(0.05)
    assert piece(drawing, "swing").at(0)[-1, 0] == pytest.approx(np.sin(0.1))
    assert np.ptp(piece(drawing, "line").at(0)[:, 0]) == pytest.approx(rope.length, rel=0.05)


def test_wires_and_droppers_are_drawn_where_they_hang() -> None:
    """One wire a twentieth of the span below the other; the dropper that is too long for its wires is flagged as slack."""
    span, wire = 30.0, fmbd.Wire(1.35, 20e3, 195.0)
    droppers = (fmbd.Dropper(1, 0, 10.0, 1e5, offset=0.01), fmbd.Dropper(1, 0, 20.0, 1e5, offset=-1.0))
    wires = fmbd.Wires("w", span, 60, (wire, wire), (), droppers)
    scene = fmbd.Scene("hung", gravity=(0, -9.81), settle=True)
    scene.add(wires)
    for number in (0, 1):
        scene.sensor(f"wire {number}", fmbd.wire_height(wires, number, (10.0,)))
    run = fmbd.solve(scene, t_end=0.02, dt=0.01, output=few(2))

    drawing = draw(run)
    for number in (0, 1):
        x = piece(drawing, f"w, wire {number}").at(1)
        middle = np.argmin(np.abs(x[:, 0] - 10.0))
        assert x[middle, 1] == pytest.approx(run[f"wire {number}"][-1, 0] - number * span / 20, abs=1e-9)
    taut, slack = (piece(drawing, f"w, dropper {k}") for k in (1, 2))
    assert np.ptp(taut.at(1)[:, 0]) == 0.0 and np.ptp(taut.at(1)[:, 1]) == pytest.approx(span / 20, rel=0.02)
    assert slack.flag.all() and not taut.flag.any()


def test_a_drawing_without_snapshots_is_that_of_the_last_state() -> None:
    scene, _ = pendulum()
    run = fmbd.solve(scene, t_end=0.1, dt=0.05)
    assert draw(run).times == pytest.approx([0.1])


def test_a_drawing_needs_something_to_paint() -> None:
    scene, _ = pendulum()
    with pytest.raises(InputError, match='painted with "stress"'):
        draw(fmbd.solve(scene, t_end=0.1, dt=0.05, output=few()), paint=fmbd.Paint(lambda u: u[0], "stress"))
    with pytest.raises(InputError, match="camera"):
        fmbd.View(camera=(0, 0, 0))


@pytest.mark.parametrize(
    ("given", "times"),
    [(3, (0.0, 0.5, 1.0)), (fmbd.PerSecond(4), (0.0, 0.25, 0.5, 0.75, 1.0)), ((0.1, 0.45), (0.1, 0.45)), (0, ())],
)
def test_snapshots_by_count_rate_or_times(given: Any, times: tuple[float, ...]) -> None:
    scene, _ = pendulum()
    run = fmbd.solve(scene, t_end=1.0, dt=0.05, output=few(given))
    assert [s.t for s in run.snapshots] == pytest.approx(times, abs=1e-9)


@pytest.mark.parametrize("wrong", [-1, (0.5, 0.2), (-0.1, 0.2), (float("nan"),), "often", ((0.1,),)])
def test_unusable_snapshots_are_refused(wrong: Any) -> None:
    with pytest.raises(InputError, match="snapshots"):
        fmbd.Output(snapshots=wrong)


def test_snapshots_after_the_end_are_refused() -> None:
    scene, _ = pendulum()
    with pytest.raises(InputError, match="after the end"):
        fmbd.solve(scene, t_end=1.0, dt=0.05, output=few((0.5, 1.5)))
    with pytest.raises(InputError, match="rate"):
        fmbd.PerSecond(0.0)


def test_a_cable_of_millimetres_is_seen_in_a_scene_of_metres() -> None:
    """Its centre line stays, its section is widened to what a picture can show; a thick one is drawn as it is."""
    for radius in (1e-4, 0.1):
        section = fmbd.RodSection.circle(youngs_modulus=1e9, poisson_ratio=0.3, density=1e3, radius=radius)
        cable = fmbd.Rod("cable", [(0, 0, 0), (4, 0, 0)], section, elements=2)
        scene = fmbd.Scene("cable")
        scene.add(cable, fmbd.fixed("clamp", fmbd.ground, cable.surface("start")))
        drawn = piece(draw(fmbd.solve(scene, t_end=0.01, dt=0.01, output=few(2))), "cable").motion.at(0)
        assert np.allclose(drawn.mean(0), (2.0, 0.0, 0.0), atol=1e-12)
        width = float(np.abs(drawn[:, 1:]).max())
        assert width == pytest.approx(radius, rel=1e-6) if radius == 0.1 else 4e-3 < width < 0.05


def test_rods_are_drawn_with_their_section() -> None:
    """A pulled and bent rod: the skin has the outline's perimeter times the length, and ends where the sensor says."""
    section = fmbd.RodSection.rectangle(youngs_modulus=1e7, poisson_ratio=0.3, density=1e3, width=0.02, height=0.05)
    rod = fmbd.Rod("blade", [(0, 0, 0), (1, 0, 0)], section, elements=4)
    scene = fmbd.Scene("blade", gravity=(0, 0, -9.81))
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("start")))
    scene.sensor("tip", fmbd.position(rod.surface("end")))
    run = fmbd.solve(scene, t_end=0.1, dt=0.01, output=few(2))

    drawn = piece(draw(run), "blade")
    first, last = drawn.at(0), drawn.at(1)
    assert area(first, drawn.triangles) == pytest.approx(2 * 0.07 * 1.0 + 2 * 0.02 * 0.05, rel=1e-9)
    assert np.ptp(last[:, 2]) > 0.025 and area(last, drawn.triangles) == pytest.approx(0.142, rel=1e-2)
    corners = len(drawn.edges) // 2
    assert np.allclose(last[-corners:].mean(0), run["tip"][-1], atol=1e-12)
    sides = np.sort(drawn.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(sides, axis=0, return_counts=True)[1] == 2).all(), "the skin is closed"


def test_an_arrow_is_as_long_and_as_thick_as_it_should_be() -> None:
    x = arrow(0.05).points
    across = np.hypot(x[:, 1], x[:, 2])
    assert (x[:, 0].min(), x[:, 0].max()) == (0.0, 1.0)
    assert across[x[:, 0] == 0.0].max() == pytest.approx(0.05) and across[x[:, 0] == 1.0].max() == 0.0
    assert across.max() == pytest.approx(2.6 * 0.05)


@pytest.mark.parametrize("size", [(0.3, 0.3, 3.0), (3.0, 0.3, 0.3), (1.0, 1.0, 1.0), (0.3, 3.0, 0.3)])
def test_all_of_a_scene_in_space_is_seen(size: tuple[float, ...]) -> None:
    """Nothing is cut off at the edges of the image, and the scene fills it from side to side or from top to bottom."""
    block = fmbd.RigidBody(
        "block", 1.0, (1.0, 1.0, 1.0), shape=fmbd.contacts.Box(size), angular_velocity=(0.0, 1.0, 0.5)
    )
    scene = fmbd.Scene("in flight")
    scene.add(block)
    drawing = draw(fmbd.solve(scene, t_end=1.0, dt=0.1, output=few()))
    picture = strobe(drawing, fmbd.View(), None, width=400)

    drawn = (picture.image < 255).any(axis=2)
    drawn[-100:, :80] = False  # the axes in the corner
    assert not (drawn[[0, -1]].any() or drawn[:, [0, -1]].any())
    share = [np.ptp(np.flatnonzero(drawn.any(axis=k))) / drawn.shape[1 - k] for k in (0, 1)]
    assert max(share) > 0.75
