"""Input that cannot be right: one clear error each, naming the body, joint or law."""

from __future__ import annotations

import copy
import math
import pickle
import re
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import CallbackError, ConstraintError, ConvergenceError, InputError, LawError

BALL = (0.4, 0.4, 0.4)


def rod(name: str = "rod", **options: Any) -> fmbd.RigidBody:
    return fmbd.RigidBody(name, 1.0, BALL, **({"position": (0.5, 0, 0)} | options))


def pendulum(*extra: Any) -> fmbd.Scene:
    """A hinged rod."""
    scene = fmbd.Scene("pendulum", gravity=(0, -9.81, 0))
    body = rod()
    scene.add(body, fmbd.revolute("hinge", fmbd.ground, body, center=(0, 0, 0)), *extra)
    return scene


def law_scene(make: Any) -> fmbd.Scene:
    scene = pendulum()
    scene.add(make(scene.bodies["rod"], scene.joints["hinge"]))
    return scene


nan = float("nan")
BODIES = {
    "zero mass": (lambda: fmbd.RigidBody("fly", 0.0, BALL), '"fly".*mass 0'),
    "negative mass": (lambda: fmbd.RigidBody("fly", -1.0, BALL), '"fly".*mass -1'),
    "mass is text": (lambda: fmbd.RigidBody("fly", "1", BALL), '"fly".*mass .1. must be a finite number'),  # type: ignore[arg-type]
    "negative mass of a body's own equations": (
        lambda: fmbd.CoordinateBody("fly", [[1, 2], [2, 1]], lambda q, v, t: 0 * q, [0, 0]),
        '"fly".*negative eigenvalue -1',
    ),
    "mass is nan": (lambda: fmbd.RigidBody("fly", nan, BALL), '"fly".*mass nan'),
    "negative inertia in the plane": (lambda: fmbd.RigidBody("fly", 1.0, -0.1), '"fly".*inertia -0.1'),
    "inertia not symmetric": (
        lambda: fmbd.RigidBody("fly", 1.0, [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]),
        '"fly".*not symmetric',
    ),
    "triangle inequality": (
        lambda: fmbd.RigidBody("fly", 1.0, (1.0, 1.0, 2.1)),
        '"fly".*violate J1 \\+ J2 >= J3',
    ),
    "triangle inequality, turned": (
        lambda: fmbd.RigidBody("fly", 1.0, [[1.55, 0.55, 0], [0.55, 1.55, 0], [0, 0, 1.0]]),
        '"fly".*violate',
    ),
    "negative principal inertia": (lambda: fmbd.RigidBody("fly", 1.0, (1.0, -1.0, 1.0)), '"fly".*positive'),
    "point mass": (lambda: fmbd.RigidBody("fly", 1.0, (0.0, 0.0, 0.0)), '"fly".*point mass'),
    "shape of the inertia": (lambda: fmbd.RigidBody("fly", 1.0, (1.0, 1.0)), '"fly".*shape'),
    "position with nan": (lambda: rod("fly", position=(0, nan, 0)).start_pose(), '"fly".*position'),
}
JOINTS = {
    "itself": (lambda a, b: fmbd.revolute("pin", a, a), '"pin" connects .*rod.* with itself'),
    "ground with ground": (lambda a, b: fmbd.revolute("pin", fmbd.ground, fmbd.ground), '"pin"'),
    "zero axis": (lambda a, b: fmbd.revolute("pin", a, b, axis=(0, 0, 0)), '"pin".*axis .*not all zero'),
    "axis with nan": (lambda a, b: fmbd.prismatic("pin", a, b, axis=(0, nan, 0)), '"pin".*axis'),
    "axis of two numbers": (lambda a, b: fmbd.revolute("pin", a, b, axis=(0, 1)), '"pin".*axis'),
    "center with nan": (lambda a, b: fmbd.spherical("pin", a, b, center=(0, nan, 0)), '"pin".*center'),
    "axes not perpendicular": (
        lambda a, b: fmbd.universal("pin", a, b, axis_a=(1, 0, 0), axis_b=(1, 1, 0)),
        '"pin".*perpendicular',
    ),
    "length": (lambda a, b: fmbd.distance("pin", a, b, length=-1.0), '"pin".*length -1'),
    "not a body": (lambda a, b: fmbd.revolute("pin", a, "rod"), "'rod'"),
    "plane and space": (lambda a, b: fmbd.revolute("pin", a, fmbd.RigidBody("flat", 1.0, 1.0)), "dimension"),
}
LAWS = {
    "force": (lambda body, hinge: fmbd.force("wind", body, lambda t: (0, nan, 0)), '"wind"'),
    "torque": (lambda body, hinge: fmbd.torque("wind", body, lambda t: (0, np.inf, 0)), '"wind"'),
    "spring": (lambda body, hinge: fmbd.Spring("wind", fmbd.ground, body, law=lambda s, v, t: nan), '"wind"'),
    "effort": (lambda body, hinge: fmbd.effort("wind", fmbd.angle(hinge), lambda t: nan), '"wind"'),
    "tyre": (
        lambda body, hinge: fmbd.Tyre("wind", body, road=lambda x, t: nan, stiffness=1.0, up=(0, 0, 1)),
        '"wind"',
    ),
    "own force": (
        lambda body, hinge: fmbd.own_force("wind", body, None, lambda t, a: ((nan, 0, 0), (0, 0, 0))),
        '"wind"',
    ),
    "own joint": (
        lambda body, hinge: fmbd.own_joint("wind", fmbd.ground, body, lambda xa, Ra, xb, Rb, t: np.array([nan])),
        '"wind"',
    ),
    "shape": (lambda body, hinge: fmbd.force("wind", body, lambda t: (0, 1)), '"wind".*shape'),
    "text": (
        lambda body, hinge: fmbd.force("wind", body, lambda t: "strong"),
        '"wind".*expected numbers|"wind".*strong',
    ),
}


# laws that are refused where they are given
CALLS = {
    "spring, two arguments": (
        lambda body, hinge: fmbd.Spring("k", fmbd.ground, body, law=lambda s, v: 0.0),
        r'Spring "k": law must be a function of 3 arguments \(s, rate, t\), found one of \(s, v\)',
    ),
    "spring, joint": (
        lambda body, hinge: fmbd.joint_spring("k", fmbd.angle(hinge), law=lambda s: s),
        '"k".*3 arguments',
    ),
    "spring, one body": (
        lambda body, hinge: fmbd.Spring("k", body, body, (0, 0, 1), (1, 0, 0)),
        '"k" connects .* itself',
    ),
    "tyre": (lambda body, hinge: fmbd.Tyre("w", body, road=lambda x: 0.0), '"w".*road must be .*2 arguments'),
    "force": (lambda body, hinge: fmbd.force("f", body, lambda t, x: (0, 0, 1)), '"f".*1 argument .t.'),
    "force, two components": (lambda body, hinge: fmbd.force("f", body, (0, 1)), 'Force "f": law .* 3 finite numbers'),
    "force, on the ground": (
        lambda body, hinge: fmbd.force("f", fmbd.ground, (0, 1, 0)),
        'Force "f" must act on a body',
    ),
    "torque, one component": (lambda body, hinge: fmbd.torque("m", body, 1.0), 'Torque "m": law .* 3 finite numbers'),
    "effort": (lambda body, hinge: fmbd.effort("e", fmbd.angle(hinge), "5"), 'Effort "e": law must be .* found .5.'),
    "own force": (lambda body, hinge: fmbd.own_force("f", fmbd.ground, body, lambda t, a: 0), r'"f".*\(t, a, b\)'),
    "own joint": (
        lambda body, hinge: fmbd.own_joint("j", fmbd.ground, body, lambda xa, Ra, xb, Rb: xb - xa),
        'Joint "j": function must be .*5 arguments',
    ),
    "drive": (lambda body, hinge: fmbd.drive("d", fmbd.angle(hinge), lambda: 0.0), '"d": motion must be .*1 argument'),
    "motor": (lambda body, hinge: fmbd.motor("m", fmbd.angle(hinge), target="up", kp=1.0), '"m": target'),
    "pid": (lambda body, hinge: fmbd.pid("m", fmbd.angle(hinge), target=None, gains=(1, 1, 1)), '"m": target'),
    "pid, two gains": (lambda body, hinge: fmbd.pid("m", fmbd.angle(hinge), target=0.0, gains=(1, 1)), '"m": gains'),
    "pid, one gain": (lambda body, hinge: fmbd.pid("m", fmbd.angle(hinge), target=0.0, gains=5.0), '"m": gains'),
    "friction": (
        lambda body, hinge: fmbd.joint_friction("f", fmbd.angle(hinge), coulomb=1.0, speed=0.1, stribeck=0.2),
        '"f": stribeck .* static',
    ),
    "controller": (
        lambda body, hinge: fmbd.controller("c", reads={}, acts=fmbd.angle(hinge), law=lambda t, y: 0.0),
        r'"c": law must be .*\(t, y, z\)',
    ),
    "load along a rod": (
        lambda body, hinge: fmbd.RodLoad(lambda s: (0, 0, 1)),
        "law must be a function of 2 arguments",
    ),
    "elastic": (
        lambda body, hinge: fmbd.FloatingBody("r", None, density=1.0, elastic=lambda u, v: u),
        '"r": elastic must be a function of 3 arguments',
    ),
}


@pytest.mark.parametrize("name", CALLS)
def test_laws_where_they_are_given(name: str) -> None:
    make, text = CALLS[name]
    body = rod()
    with pytest.raises(InputError, match=text):
        make(body, fmbd.revolute("hinge", fmbd.ground, body))


def test_readings_that_a_law_asks_for_in_vain() -> None:
    def motor(body: Any, hinge: Any) -> Any:
        reads = {"angle": fmbd.angle(hinge)}
        return fmbd.controller("motor", reads=reads, acts=fmbd.angle(hinge), law=lambda t, y, z: -y["angel"][0])

    with pytest.raises(LawError, match='"motor".*"angel".*Did you mean "angle"'):
        fmbd.solve(law_scene(motor), t_end=0.1, dt=0.01)


@pytest.mark.parametrize("returned", [None, [None], "no"])
def test_laws_that_return_no_numbers(returned: Any) -> None:
    """A function without a return statement gives None, which is no nan."""
    scene = law_scene(lambda body, hinge: fmbd.joint_spring("mine", fmbd.angle(hinge), law=lambda s, rate, t: returned))
    with pytest.raises(CallbackError, match=r'"mine": the law returned .*(None|no).* at t = 0 s, expected numbers'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


@pytest.mark.parametrize("returned", [None, "no"])
def test_own_joints_that_return_no_numbers(returned: Any) -> None:
    scene = law_scene(lambda body, hinge: fmbd.own_joint("mine", fmbd.ground, body, lambda xa, Ra, xb, Rb, t: returned))
    with pytest.raises(CallbackError, match='"mine".*expected finite numbers'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


@pytest.mark.parametrize("name", BODIES)
def test_bodies(name: str) -> None:
    make, text = BODIES[name]
    with pytest.raises(InputError, match=text):
        make()


@pytest.mark.parametrize("name", JOINTS)
def test_joints(name: str) -> None:
    make, text = JOINTS[name]
    with pytest.raises(InputError, match=text):
        make(rod(), rod("other"))


def test_a_drive_that_begins_elsewhere_says_where_its_coordinate_is_zero() -> None:
    pin = fmbd.revolute("pin", fmbd.ground, (body := rod()), center=(0, 0, 0))
    scene = fmbd.Scene("drive")
    scene.add(body, pin, fmbd.drive("motor", fmbd.angle(pin), lambda t: 0.5 + t))
    with pytest.raises(
        ConstraintError, match=r'joint "motor" \(drive\) begins 0.5 m or rad away.*let the motion begin there'
    ):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


def test_force_and_torque_of_wrong_sizes_do_not_pass_for_their_sum() -> None:
    """Two and four numbers are six, and were taken as a force and a torque of three."""
    scene = law_scene(
        lambda body, hinge: fmbd.own_force("f", body, None, lambda t, a: ((1.0, 0.0), (0.0, 0.0, 1.0, 2.0)))
    )
    with pytest.raises(CallbackError, match=r"returned shape \(2,\) at t = 0 s, expected \(3,\)"):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


def test_a_road_of_many_heights_says_what_it_is_asked() -> None:
    """``x`` are coordinates of the wheel's centre, not one number."""
    scene = law_scene(lambda body, hinge: fmbd.Tyre("w", body, road=lambda x, t: 0.1 * x, stiffness=1.0, up=(0, 0, 1)))
    with pytest.raises(
        CallbackError, match=r"one height at x, all coordinates of the wheel's centre, returned shape \(3,\)"
    ):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


@pytest.mark.parametrize("name", LAWS)
def test_laws_at_the_start(name: str) -> None:
    """The error names the law and the time."""
    make, text = LAWS[name]
    with pytest.raises(CallbackError, match=text + ".*t = 0"):
        fmbd.solve(law_scene(make), t_end=0.1, dt=0.01)


def test_law_that_fails_later_names_the_time() -> None:
    scene = law_scene(lambda body, hinge: fmbd.force("gust", body, lambda t: (0, 0, nan if t > 0.045 else 0)))
    with pytest.raises(CallbackError, match=r'"gust".*t = 0\.05'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


def test_inputs_begin_with_a_number() -> None:
    with pytest.raises(InputError, match="\"torque\" takes a number, found 'much'"):
        pendulum().input("torque", "much")  # type: ignore[arg-type]


@pytest.mark.parametrize("of", ["energy", "counters", "error_estimate", "ledger.work", "ledger.power"])
def test_names_that_a_run_does_not_know_are_told(of: str) -> None:
    run = fmbd.solve(pendulum(), t_end=0.02, dt=0.01, output=fmbd.Output(ledger=True))
    found = attrgetter(of)(run)
    known = "none" if not found else f'"{next(iter(found))}"'
    with pytest.raises(InputError, match=f'there is no "heat".*Known: {known}'):
        found["heat"]


def broken(t: Any) -> Any:
    """Zero, and a KeyError after 45 ms."""
    return 0.0 * t if np.real(t) < 0.045 else {}["gone"]


def crank_body(**functions: Any) -> Any:
    given = {"force": lambda q, v, t: 0 * q, "constraint": lambda q, t: np.array([q[0] - q[1]])} | functions
    return lambda body, hinge: fmbd.CoordinateBody("own", np.eye(2), start=[0.0, 0.0], **given)


BROKEN = {
    'The law of spring "wind"': lambda body, hinge: fmbd.Spring(
        "wind", fmbd.ground, body, law=lambda s, v, t: broken(t)
    ),
    'The law of joint spring or effort "wind"': lambda body, hinge: fmbd.effort("wind", fmbd.angle(hinge), broken),
    'The law of force "wind"': lambda body, hinge: fmbd.force("wind", body, lambda t: (0, 0, broken(t))),
    'The law of torque "wind"': lambda body, hinge: fmbd.torque("wind", body, lambda t: (0, 0, broken(t))),
    'The law of force "own wind"': lambda body, hinge: fmbd.own_force(
        "own wind", body, None, lambda t, a: (np.zeros(3), np.full(3, broken(t)))
    ),
    'The road of tyre "wheel"': lambda body, hinge: fmbd.Tyre(
        "wheel", body, road=lambda x, t: broken(t) - 9.0, stiffness=1.0, up=(0, 0, 1)
    ),
    'The motion of drive "motor"': lambda body, hinge: fmbd.drive("motor", fmbd.angle(hinge), broken),
    'The motion of drive "pusher"': lambda body, hinge: fmbd.drive(
        "pusher", fmbd.angle(hinge), lambda t: (broken(t), 0.0, 0.0)
    ),
    'The constraint of joint "mine"': lambda body, hinge: fmbd.own_joint(
        "mine", fmbd.ground, body, lambda xa, Ra, xb, Rb, t: np.array([xb[1] + broken(t)])
    ),
    'The force of body "own"': crank_body(force=lambda q, v, t: 0 * q + broken(t)),
    'The constraint of body "own"': crank_body(constraint=lambda q, t: np.array([q[0] - q[1] + broken(t)])),
    'The constraint\'s jacobian of body "own"': crank_body(jacobian=lambda q, t: np.array([[1.0, -1.0]]) + broken(t)),
}


@pytest.mark.mpi
@pytest.mark.parametrize("scheme", [None, fmbd.Radau(rtol=1e-3)], ids=str)
@pytest.mark.parametrize("words", BROKEN)
def test_exception_in_a_law_is_one_error_with_its_cause(words: str, scheme: Any) -> None:
    """Whose function, when, and what it raised; on every rank, and without trying smaller steps."""
    scene = law_scene(BROKEN[words])
    with pytest.raises(LawError, match=words + r" failed at t = 0\.0\d.* s: KeyError: 'gone'$") as found:
        fmbd.solve(scene, t_end=0.1, dt=0.01, scheme=scheme)
    assert isinstance(found.value.__cause__, KeyError)
    assert float(re.findall(r"t = (\S+)", str(found.value))[0]) < 0.09


def test_exception_at_the_start_and_of_a_vectorized_body() -> None:
    with pytest.raises(LawError, match='The motion of drive "motor" failed at t = 0 s: ZeroDivisionError'):
        law_scene(lambda body, hinge: fmbd.drive("motor", fmbd.angle(hinge), lambda t: 1 / 0))
    with pytest.raises(LawError, match='The constraint of joint "mine" failed at t = 0 s: ZeroDivisionError'):
        law_scene(lambda body, hinge: fmbd.own_joint("mine", fmbd.ground, body, lambda *args: 1 / 0)).build()
    # behind the middle of a step, where its tangent is taken
    many = crank_body(force=lambda q, v, t: 0 * q if np.max(np.real(t)) < 0.046 else {}["gone"])
    scene = fmbd.Scene("many")
    scene.add(replace(many(None, None), vectorized=True))
    with pytest.raises(LawError, match=r'The force of body "own" failed at t = 0.0\d+ to 0.0\d+ s: KeyError'):
        fmbd.solve(scene, t_end=0.1, dt=0.01, scheme=fmbd.Radau(rtol=None))


def test_functions_that_do_not_take_complex_numbers_are_no_error() -> None:
    """TypeError and ValueError at complex times: derivatives of a drive by differences."""
    for motion in (lambda t: 0.1 * math.sin(t), lambda t: 0.1 * np.sin(float(str(t)))):
        scene = law_scene(lambda body, hinge, motion=motion: fmbd.drive("motor", fmbd.angle(hinge), motion))
        run = fmbd.solve(scene, t_end=0.05, dt=0.01)
        assert run.status == "finished"


@pytest.mark.parametrize("scheme", [fmbd.Radau(rtol=1e-4), fmbd.BDF(rtol=1e-4), fmbd.HalfExplicit(rtol=1e-4)], ids=str)
def test_law_that_fails_under_error_control_is_named(scheme: Any) -> None:
    """Steps are tried down to the smallest; the error tells what the law returned, and when."""
    scene = law_scene(lambda body, hinge: fmbd.force("gust", body, lambda t: (0, 0, nan if t > 0.045 else 0)))
    with pytest.raises(ConvergenceError, match=r'"gust": the law returned \[ *0.*nan\] at t = 0\.045'):
        fmbd.solve(scene, t_end=0.1, scheme=scheme)


def test_motion_whose_derivatives_are_not_finite_is_named() -> None:
    scene = pendulum()
    scene.add(fmbd.drive("motor", fmbd.angle(scene.joints["hinge"]), lambda t: nan if t > 0.045 else 0.0))
    with pytest.raises(CallbackError, match=r'"motor".*nan.* at t = 0\.05'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


def test_constraint_that_is_not_finite_names_its_body() -> None:
    scene = fmbd.Scene("own")
    law = lambda q, t: np.array([q[0] * nan])  # noqa: E731
    scene.add(fmbd.CoordinateBody("arm", np.eye(2), lambda q, v, t: 0 * q, [0.0, 0.0], constraint=law))
    with pytest.raises(ConstraintError, match='constraints of "arm" are not finite'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


def test_unknown_body_in_a_joint_and_in_a_force() -> None:
    stranger = rod("stranger")
    with pytest.raises(InputError, match='"pin".*stranger.*not in the scene.*Known: "rod"'):
        pendulum(fmbd.revolute("pin", stranger, fmbd.ground)).build()
    with pytest.raises(InputError, match='"push".*stranger.*not in the scene'):
        pendulum(fmbd.force("push", stranger, lambda t: (0, 0, 0))).build()


def test_names_are_unique() -> None:
    for part, what in ((rod(), "bodies"), (fmbd.revolute("hinge", fmbd.ground, rod()), "joints")):
        with pytest.raises(InputError, match=re.escape(f'Two {what} are called "{part.name}"') + "|are called"):
            pendulum(part)


@pytest.mark.parametrize(
    "options, text",
    [
        ({"dt": 0.0}, "dt = 0"),
        ({"dt": -1.0}, "dt = -1"),
        ({"dt": nan}, "dt = nan"),
        ({"t_end": 0.0}, "t_end = 0"),
        ({"dt": 1e-17}, "t \\+ h == t"),
        ({"dt": 2.0}, "larger than the whole run"),
    ],
)
def test_times(options: dict[str, float], text: str) -> None:
    with pytest.raises(InputError, match=text):
        fmbd.solve(pendulum(), **({"t_end": 1.0, "dt": 0.01} | options))


def test_tolerances_below_roundoff() -> None:
    with pytest.raises(InputError, match="tolerance 1e-17.*double precision"):
        fmbd.Newton(1e-17)
    with pytest.raises(InputError, match="rtol = 1e-17.*double precision"):
        fmbd.solve(pendulum(), t_end=0.1, scheme=fmbd.Radau(rtol=1e-17))


def test_rho_of_one_is_refused() -> None:
    with pytest.raises(InputError, match="rho_inf = 1"):
        fmbd.GeneralizedAlpha(1.0)


@pytest.mark.parametrize(
    ("parts", "says"),
    [
        ({"bodies": [rod()]}, "must be a dict of parts by their names"),
        ({"joints": None}, "must be a dict of parts by their names"),
        ({"bodies": {"rod": 3}}, '"rod" is no body, found 3'),
        ({"bodies": {"other": rod()}}, 'body "rod" stands under the name "other"'),
        (
            {"bodies": {"pin": fmbd.revolute("pin", fmbd.ground, rod(), center=(0, 0, 0))}},
            '"pin" is no body, found Joint "pin"',
        ),
    ],
)
def test_parts_given_to_a_scene_are_what_they_stand_for(parts: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=re.escape(says)):
        fmbd.Scene("scene", **parts)


@pytest.mark.parametrize("through", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))], ids=["copy", "pickle"])
def test_scenes_may_be_copied_and_pickled(through: Any) -> None:
    """With joints, to the ground too; the copy moves as the scene does."""
    scene = pendulum()
    scene.sensor("turn", fmbd.angle(scene.joints["hinge"]))
    run = fmbd.solve(scene, t_end=0.01, dt=1e-3)
    again = fmbd.solve(through(scene), t_end=0.01, dt=1e-3)
    assert np.array_equal(again.state.q, run.state.q)
    assert np.array_equal(again["turn"], run["turn"])


def test_a_scene_and_its_copy_share_no_parts() -> None:
    """Also one that is made of a dict of the user's own."""
    mine = {"rod": rod()}
    scene = fmbd.Scene("scene", bodies=mine)
    copy = replace(scene, gravity=(0.0, -1.0))
    copy.add(rod("other"))
    assert list(mine) == list(scene.bodies) == ["rod"]
    assert list(copy.bodies) == ["rod", "other"]


NOTHING = {
    "spring": (
        lambda a, p: fmbd.Spring("k", fmbd.ground, a, (0, 1, 0), (1, 0, 0), length=1.0),
        'Spring "k" does nothing',
    ),
    "joint spring": (lambda a, p: fmbd.joint_spring("k", fmbd.angle(p), free=0.3), 'Joint spring "k" does nothing'),
    "tyre": (lambda a, p: fmbd.Tyre("k", a, road=lambda x, t: 0.0), 'Tyre "k" does nothing'),
}


@pytest.mark.parametrize(("make", "says"), NOTHING.values(), ids=NOTHING)
def test_elements_without_any_constant_are_refused(make: Any, says: str) -> None:
    """Where nothing is given; a zero that is given, say in a study, is a value like others."""
    with pytest.raises(InputError, match=says):
        law_scene(make)
    law_scene(lambda a, p: fmbd.joint_spring("k", fmbd.angle(p), stiffness=0.0))


ROWS = {
    "zero": lambda xa, Ra, xb, Rb, t: [xb[0] - xa[0], 0.0],
    "a number": lambda xa, Ra, xb, Rb, t: [xb[0] - xa[0], 1.0],
    "of time alone": lambda xa, Ra, xb, Rb, t: [xb[0] - xa[0], math.sin(np.real(t))],
    "zero times a place": lambda xa, Ra, xb, Rb, t: [xb[0] - xa[0], 0.0 * abs(xb[0])],
}


@pytest.mark.parametrize("function", ROWS.values(), ids=ROWS)
def test_rows_of_an_own_joint_that_hold_nothing_are_refused(function: Any) -> None:
    scene = fmbd.Scene("own")
    body = rod()
    scene.add(body, fmbd.own_joint("odd", fmbd.ground, body, function, center=(0.5, 0, 0)))
    with pytest.raises(InputError, match='"odd": number 1 of those .* holds nothing'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


def test_coordinates_of_a_rigid_body_are_refused_with_what_to_take() -> None:
    scene = pendulum()
    scene.sensor("x", fmbd.coordinates("rod"))
    with pytest.raises(InputError, match='"rod" has no coordinates beside .* fmbd.position'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)
