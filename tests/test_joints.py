"""Every joint: Jacobian and second derivative against finite differences, free motions, action and
reaction.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from motion import Motion, elastic_scene, first, plane_scene, second, space_scene

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError


def swing(t: float) -> tuple[float, float, float]:
    """A prescribed motion and its derivatives."""
    return 0.4 * np.sin(2 * t), 0.8 * np.cos(2 * t), -1.6 * np.sin(2 * t)


def hoisted(t: float) -> float:
    """A length that changes (m)."""
    return float(1.3 + 0.2 * np.sin(2 * t))


AXIS = (0.3, -0.5, 0.8)
PLANE: dict[str, tuple[Callable[..., Any], int]] = {
    "fixed": (lambda a, b: fmbd.fixed("j", a, b, center=(0.8, 0.2)), 3),
    "revolute": (lambda a, b: fmbd.revolute("j", a, b, center=(0.8, 0.2)), 2),
    "prismatic": (lambda a, b: fmbd.prismatic("j", a, b, axis=(1, 0.4), center=(0.8, 0.2)), 2),
    "point_on_line": (lambda a, b: fmbd.point_on_line("j", a, b, axis=(1, 0.4), center=(0.8, 0.2)), 1),
    "distance": (
        lambda a, b: fmbd.distance("j", a, b, point_a=(0.1, 0.2), point_b=(1.3, 0.6), length=1.3),
        1,
    ),
    "distance in time": (
        lambda a, b: fmbd.distance("j", a, b, point_a=(0.1, 0.2), point_b=(1.3, 0.6), length=hoisted),
        1,
    ),
    "drive_rotation": (lambda a, b: fmbd.drive_rotation("j", a, b, swing), 1),
    "drive_translation": (
        lambda a, b: fmbd.drive_translation("j", a, b, swing, axis=(1, 2), center=(0.8, 0.2)),
        1,
    ),
}
CENTER = (0.8, 0.2, -0.1)
SPACE: dict[str, tuple[Callable[..., Any], int]] = {
    "fixed": (lambda a, b: fmbd.fixed("j", a, b, center=CENTER), 6),
    "revolute": (lambda a, b: fmbd.revolute("j", a, b, center=CENTER, axis=AXIS), 5),
    "spherical": (lambda a, b: fmbd.spherical("j", a, b, center=CENTER), 3),
    "universal": (
        lambda a, b: fmbd.universal("j", a, b, center=CENTER, axis_a=(1, 1, 0), axis_b=(1, -1, 0.5)), 4,
    ),
    "prismatic": (lambda a, b: fmbd.prismatic("j", a, b, axis=AXIS, center=CENTER), 5),
    "cylindrical": (lambda a, b: fmbd.cylindrical("j", a, b, axis=AXIS, center=CENTER), 4),
    "planar": (lambda a, b: fmbd.planar("j", a, b, normal=AXIS, center=CENTER), 3),
    "point_on_line": (lambda a, b: fmbd.point_on_line("j", a, b, axis=AXIS, center=CENTER), 2),
    "distance": (
        lambda a, b: fmbd.distance("j", a, b, point_a=(0.1, 0.2, 0), point_b=(1.3, 0.6, 0.3), length=1.302),
        1,
    ),
    "distance in time": (
        lambda a, b: fmbd.distance("j", a, b, point_a=(0.1, 0.2, 0), point_b=(1.3, 0.6, 0.3), length=hoisted),
        1,
    ),
    "drive_rotation": (lambda a, b: fmbd.drive_rotation("j", a, b, swing, axis=AXIS), 1),
    "drive_translation": (lambda a, b: fmbd.drive_translation("j", a, b, swing, axis=AXIS, center=CENTER), 1),
}  # fmt: skip
CASES = [(2, n) for n in PLANE] + [(3, n) for n in SPACE]
PAIRS = ["two bodies", "ground first", "ground second"]


def rigid_scene(dim: int, name: str, pair: str = "two bodies") -> tuple[fmbd.Scene, int]:
    """Two bodies and one joint; its number of rows."""
    scene, one, two = plane_scene() if dim == 2 else space_scene()
    make, rows = (PLANE if dim == 2 else SPACE)[name]
    a, b = {
        "two bodies": (one, two),
        "ground first": (fmbd.ground, two),
        "ground second": (one, fmbd.ground),
    }[pair]
    scene.add(make(a, b))
    return scene, rows


def elastic_joint_scene(dim: int, name: str, mesh: Any, frame: Any) -> fmbd.Scene:
    """The joint between an elastic surface and a rigid body."""
    scene, rod, block = elastic_scene(mesh, degree=1, frame=frame)
    scene.add((PLANE if dim == 2 else SPACE)[name][0](rod.surface("tip"), block))
    return scene


def check_derivatives(motion: Motion) -> None:
    """G v + g_t = g' and G a + gamma = g''."""
    ev = motion.at(0.0)
    rate = first(lambda s: motion.at(s).constraint())
    assert np.abs(ev.jacobian.times(motion.v) + ev.constraint_rate() - rate).max() < 1e-8 * np.abs(rate).max()
    curve = second(lambda s: motion.at(s).constraint())
    found = ev.jacobian.times(motion.a) + ev.gamma()
    assert np.abs(found - curve).max() < 1e-6 * max(1.0, np.abs(curve).max())


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("dim, name", CASES)
def test_derivatives_between_rigid_bodies(dim: int, name: str, pair: str) -> None:
    check_derivatives(Motion(rigid_scene(dim, name, pair)[0]))


@pytest.mark.parametrize("frame", [fmbd.MeanAxis(), fmbd.Attached("pin")], ids=["mean axis", "attached"])
@pytest.mark.parametrize("dim, name", CASES)
def test_derivatives_on_elastic_surfaces(dim: int, name: str, frame: Any, rod_mesh: Callable[..., Any]) -> None:
    mesh = rod_mesh(dim=dim, h=0.5, height=0.4)
    check_derivatives(Motion(elastic_joint_scene(dim, name, mesh, frame)))


@pytest.mark.parametrize("dim, name", CASES)
def test_rows_are_independent_and_leave_the_right_mobility(dim: int, name: str) -> None:
    scene, rows = rigid_scene(dim, name)
    system, state, _ = scene.build()
    G = system.at(0.0, state.q).jacobian.core
    assert G.shape[0] == rows
    singular = np.linalg.svd(G, compute_uv=False)
    assert int((singular > 1e-8 * singular[0]).sum()) == rows


@pytest.mark.parametrize("dim, name", [c for c in CASES if not c[1].startswith("distance")])
def test_joint_is_closed_where_the_bodies_were_defined(dim: int, name: str) -> None:
    scene, _ = rigid_scene(dim, name)
    system, state, _ = scene.build()
    assert np.abs(system.at(0.0, state.q).constraint()).max() < 1e-14


def closed(motion: Motion) -> Any:
    """The system with the joints closed by moving the frames, deformation kept."""
    s, q = motion.system, motion.q
    for _ in range(30):
        ev = s.at(motion.t, q, motion.v)
        g, n = ev.constraint()[: s.n_rows], s.n_frames * s.motions.n_twist
        if np.abs(g).max() < 1e-14:
            return ev
        step = np.zeros(s.n_v)
        step[:n] = -np.linalg.pinv(ev.jacobian.core[: s.n_rows]) @ g
        q = s.compose(q, step)
    raise AssertionError("the joint does not close")


@pytest.mark.parametrize("elastic", [False, True], ids=["rigid", "elastic"])
@pytest.mark.parametrize("dim, name", CASES)
def test_action_equals_reaction(dim: int, name: str, elastic: bool, rod_mesh: Callable[..., Any]) -> None:
    """Forces of a joint on its two bodies, and their moments about any point, cancel."""
    if elastic:
        scene = elastic_joint_scene(dim, name, rod_mesh(dim=dim, h=0.5, height=0.4), fmbd.MeanAxis())
    else:
        scene, _ = rigid_scene(dim, name)
    motion = Motion(scene)
    s = motion.system
    ev = closed(motion)
    lam = np.zeros(s.n_lam)
    lam[: s.n_rows] = np.random.default_rng(2).standard_normal(s.n_rows)
    m, d = s.motions, dim
    wrench = s.twists(ev.jacobian.transposed(lam))[:-1]
    x = ev.pose[:-1, :d]
    moment = m.moment(x, wrench[:, :d]) + m.turn(ev.rotation[:-1], wrench[:, d:])
    assert np.abs(wrench[:, :d].sum(0)).max() < 1e-13
    assert np.abs(moment.sum(0)).max() < 1e-13


@pytest.mark.mpi
def test_transposed_is_the_transpose(rod_mesh: Callable[..., Any]) -> None:
    """lambda . (G v) = (G^T lambda) . v on every rank count."""
    motion = Motion(elastic_joint_scene(3, "revolute", rod_mesh(dim=3, h=0.5, height=0.4), fmbd.MeanAxis()))
    s, J = motion.system, motion.at(0.0).jacobian
    lam = np.random.default_rng(4).standard_normal(s.n_lam)
    left, right = float(lam @ J.times(motion.v)), s.dot(J.transposed(lam), motion.v)
    assert abs(left - right) < 1e-12 * abs(left)


def test_multiplier_is_the_force_on_the_first_body() -> None:
    """A body that hangs on the ground: the pin pulls it up by its weight, whichever side it is on."""
    for first_is_body in (True, False):
        body = fmbd.RigidBody("weight", 2.0, 0.1, position=(0.0, -1.0))
        scene = fmbd.Scene("hanging", gravity=(0, -10.0))
        sides = (body, fmbd.ground) if first_is_body else (fmbd.ground, body)
        scene.add(body, fmbd.revolute("pin", *sides, center=(0, 0)))
        scene.sensor("force", fmbd.reaction("pin"))
        run = fmbd.solve(scene, t_end=0.01, dt=0.01)
        expected = 20.0 if first_is_body else -20.0
        assert np.abs(run["force"] - [0.0, expected]).max() < 1e-9


def test_multiplier_of_a_distance_is_its_force() -> None:
    """A weight on a bar, of any length: the multiplier is a force, in N."""
    body = fmbd.RigidBody("weight", 2.0, 0.1, position=(0.0, -3.0))
    scene = fmbd.Scene("hanging", gravity=(0, -10.0))
    scene.add(body, fmbd.distance("bar", fmbd.ground, body, point_a=(0.0, 0.0), point_b=(0.0, -3.0)))
    scene.sensor("force", fmbd.reaction("bar"))
    assert np.abs(np.abs(fmbd.solve(scene, t_end=0.01, dt=0.01)["force"]) - 20.0).max() < 1e-9


def test_a_rotor_in_elastic_bearings_has_an_angle() -> None:
    """A planar joint holds nothing in the plane: its angle is that of a torque of 0.5 N m on 0.1 kg m^2, over six turns."""
    rotor = fmbd.RigidBody("rotor", 2.0, 0.1, position=(0.001, 0.0))
    scene = fmbd.Scene("rotor", gravity=(0, -9.81))
    turn = fmbd.planar("turn", fmbd.ground, rotor)
    bearings = fmbd.bushing("bearings", fmbd.ground, rotor, stiffness=(1e4, 2e4, 0.0))
    scene.add(rotor, turn, bearings, fmbd.effort("motor", fmbd.angle(turn), 0.5))
    scene.sensor("angle", fmbd.angle(turn))
    assert scene.check().freedom == 3
    run = fmbd.solve(scene, t_end=4.0, dt=0.01)
    assert run["angle"][-1] == pytest.approx(0.5 * 5.0 * 4.0**2, rel=1e-9)
    with pytest.raises(InputError, match='"turn": planar takes no normal in the plane'):
        fmbd.planar("turn", fmbd.ground, rotor, normal=(0, 0, 1))


# -- input ---------------------------------------------------------------------------------------------------
def bodies() -> tuple[fmbd.RigidBody, fmbd.RigidBody]:
    """Two bodies of space."""
    return space_scene()[1:]


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda a, b: fmbd.revolute("", a, b), "name"),
        (lambda a, b: fmbd.revolute("pin", a, a), '"pin".*itself'),
        (lambda a, b: fmbd.revolute("pin", fmbd.ground, fmbd.ground), "ground"),
        (lambda a, b: fmbd.revolute("pin", a, b, axis=(0, 0, 0)), '"pin".*axis'),
        (lambda a, b: fmbd.revolute("pin", a, b, axis=(0, np.nan, 1)), '"pin".*axis'),
        (lambda a, b: fmbd.revolute("pin", a, b, center=(0, np.nan, 1)), '"pin".*center'),
        (lambda a, b: fmbd.revolute("pin", a, b, center=(0,)), '"pin".*center'),
        (lambda a, b: fmbd.distance("rod", a, b, length=0.0), '"rod".*length'),
        (lambda a, b: fmbd.distance("rod", a, b, length=np.nan), '"rod".*length'),
        (lambda a, b: fmbd.universal("cross", a, b, axis_a=(1, 0, 0), axis_b=(1, 1, 0)),
         '"cross".*perpendicular'),
        (lambda a, b: fmbd.drive_translation("push", a, b, swing, axis=(0, 0, 0)), '"push".*axis'),
        (lambda a, b: fmbd.revolute("pin", a, plane_scene()[1]), "dimension"),
    ],
)  # fmt: skip
def test_unusable_joints_are_refused(make: Callable[..., Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        make(*bodies())


def test_joint_to_a_body_outside_the_scene() -> None:
    scene, one, _ = plane_scene()
    other = fmbd.RigidBody("three", 1.0, 1.0)
    scene.add(fmbd.revolute("pin", one, other, center=(0, 0)))
    with pytest.raises(InputError, match='"pin".*"one"'):
        scene.build()


def test_joint_to_an_elastic_body_needs_a_surface(rod_mesh: Callable[..., Any]) -> None:
    scene, rod, block = elastic_scene(rod_mesh(dim=2, h=0.5, height=0.4))
    with pytest.raises(InputError, match='"pin".*surface'):
        fmbd.revolute("pin", rod, block, center=(0, 0))
