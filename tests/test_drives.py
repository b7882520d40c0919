"""Joint coordinates, drives, gears, screws and joints of the user's own."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from motion import Motion, elastic_scene, plane_scene, space_scene
from scipy.interpolate import CubicSpline, PPoly
from test_joints import AXIS, CENTER, check_derivatives

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import kernel_cache
from fmbd_fenicsx.errors import CallbackError, InputError
from fmbd_fenicsx.mechanics.joints.couplings import smooth_motion, with_its_derivatives


def joints(dim: int) -> tuple[fmbd.Scene, list[Any]]:
    """Two bodies on the ground, one joint with an angle and one with a displacement."""
    scene, one, two = plane_scene() if dim == 2 else space_scene()
    c, axis = CENTER[:dim], AXIS
    if dim == 2:
        hinge, slider = (
            fmbd.revolute("hinge", one, fmbd.ground, center=c),
            fmbd.prismatic("slider", fmbd.ground, two, axis=(1, 0.4), center=c),
        )
    else:
        hinge = fmbd.cylindrical("hinge", one, fmbd.ground, center=c, axis=axis)
        slider = fmbd.prismatic("slider", one, two, center=c, axis=axis)
    scene.add(hinge, slider)
    return scene, [hinge, slider]


def coordinate_scene(dim: int, what: str) -> fmbd.Scene:
    scene, (hinge, slider) = joints(dim)
    phi, s = fmbd.angle(hinge), fmbd.displacement(slider)
    if what == "drive angle":
        scene.add(fmbd.drive("d", phi, lambda t: 0.3 * np.sin(2 * t)))
    elif what == "drive displacement":
        scene.add(fmbd.drive("d", s, lambda t: (t**2, 2 * t, 2.0)))
    elif what == "rack and pinion":
        scene.add(fmbd.gear("d", phi, s, ratio=0.3))
    elif what == "screw":
        scene.add(fmbd.screw("d", hinge, lead=0.2))
    else:
        rod = fmbd.segment("rod", *list(scene.bodies.values()))
        scene.add(rod, fmbd.drive("d", fmbd.displacement(rod), lambda t: 0.8 + 0.1 * t))
    return scene


KINDS = ["drive angle", "drive displacement", "rack and pinion", "drive length"]


@pytest.mark.parametrize("dim, what", [(2, w) for w in KINDS] + [(3, w) for w in [*KINDS, "screw"]])
def test_derivatives(dim: int, what: str) -> None:
    check_derivatives(Motion(coordinate_scene(dim, what)))


def bevel(xa: Any, Ra: Any, xb: Any, Rb: Any, t: float) -> Any:
    """A point on a sphere about the other, and one axis held on a cone."""
    return np.array([(xb - xa) @ (xb - xa) - 0.3, (Ra[:, 0] @ Rb[:, 1]) - 0.2 * np.sin(t)])


@pytest.mark.parametrize("dim", [2, 3])
def test_derivatives_of_an_own_joint(dim: int) -> None:
    scene, one, two = plane_scene() if dim == 2 else space_scene()
    scene.add(fmbd.own_joint("own", one, two, bevel, center=CENTER[:dim]))
    check_derivatives(Motion(scene))


@pytest.mark.parametrize("dim", [2, 3])
def test_derivatives_of_an_own_joint_that_takes_numbers_only(dim: int) -> None:
    """A function that symbols cannot enter is differentiated by complex steps, its rows along the motion by differences."""
    scene, one, two = plane_scene() if dim == 2 else space_scene()

    def stretching(xa: Any, Ra: Any, xb: Any, Rb: Any, t: Any) -> Any:
        return np.array([np.sqrt((xb - xa) @ (xb - xa)) - 0.3 * np.cos(t), np.linalg.inv(Ra)[0] @ Rb[:, 1]])

    scene.add(fmbd.own_joint("own", one, two, stretching, center=CENTER[:dim]))
    check_derivatives(Motion(scene))


@pytest.mark.parametrize("first, later", [(0.5, (0.5, 0.0, 0.0)), ((0.5, 0.0, 0.0), 0.5)])
def test_a_motion_that_changes_what_it_returns_is_refused(first: Any, later: Any) -> None:
    motion = smooth_motion("turn", lambda t: first if t == 0.0 else later)
    for asked in (motion, motion.moving, motion.place):
        with pytest.raises(CallbackError, match='Joint "turn": the motion returned .* the same at all times'):
            asked(1.0)


def test_own_joint_without_complex_numbers() -> None:
    """A function that only takes real numbers is differentiated by central differences."""
    scene, one, two = plane_scene()
    scene.add(
        fmbd.own_joint("own", one, two, lambda xa, Ra, xb, Rb, t: [math.hypot(*(xb - xa)) - 0.3], center=(0.8, 0.2))
    )
    motion = Motion(scene)
    G = motion.at(0.0).jacobian
    scene2, one, two = plane_scene()
    scene2.add(
        fmbd.own_joint(
            "own",
            one,
            two,
            lambda xa, Ra, xb, Rb, t: [np.sqrt((xb - xa) @ (xb - xa)) - 0.3],
            center=(0.8, 0.2),
        )
    )
    assert np.abs(G.core - Motion(scene2).at(0.0).jacobian.core).max() < 1e-8


def test_own_revolute_moves_as_the_built_in_one() -> None:
    """The pendulum of docs/own_joint.md: same motion, same reactions."""
    found = []
    for own in (False, True):
        rod = fmbd.RigidBody("rod", 2.0, (0.1, 0.2, 0.25), position=(0.5, 0, 0))
        scene = fmbd.Scene("pendulum", gravity=(0, -9.81, 0))
        scene.add(rod)
        if own:
            hinge: Any = fmbd.own_joint("hinge", fmbd.ground, rod, own_hinge, center=(0, 0, 0))
        else:
            hinge = fmbd.revolute("hinge", fmbd.ground, rod, center=(0, 0, 0), axis=(0, 0, 1))
        scene.add(hinge)
        scene.sensor("x", fmbd.position(rod))
        scene.sensor("F", fmbd.reaction_force(hinge))
        scene.sensor("T", fmbd.reaction_torque(hinge))
        found.append(fmbd.solve(scene, t_end=0.5, dt=5e-3))
    for sensor, bar in (("x", 1e-9), ("F", 1e-6), ("T", 1e-6)):
        assert np.abs(found[0][sensor] - found[1][sensor]).max() < bar


def own_hinge(xa: Any, Ra: Any, xb: Any, Rb: Any, t: float) -> Any:
    """Revolute joint about z, written by hand."""
    return np.array([*(xb - xa), Ra[:, 2] @ Rb[:, 0], Ra[:, 2] @ Rb[:, 1]])


def test_drive_counts_revolutions_and_reads_its_motion() -> None:
    """A wheel driven through 3 turns: the angle does not jump, and the gear follows with its ratio."""
    wheel = fmbd.RigidBody("wheel", 1.0, (0.1, 0.1, 0.2))
    pinion = fmbd.RigidBody("pinion", 0.3, (0.01, 0.01, 0.02), position=(0.3, 0, 0))
    scene = fmbd.Scene("gear")
    scene.add(wheel, pinion)
    one = fmbd.revolute("one", fmbd.ground, wheel, center=(0, 0, 0))
    two = fmbd.revolute("two", fmbd.ground, pinion, center=(0.3, 0, 0))
    phi, psi = fmbd.angle(one), fmbd.angle(two)
    turn = 6 * math.pi
    scene.add(one, two, fmbd.drive("motor", phi, lambda t: turn * t**3), fmbd.gear("gear", phi, psi, ratio=-2.5))
    scene.sensor("phi", phi)
    scene.sensor("psi", psi)
    scene.sensor("rate", fmbd.joint_rate(psi))
    scene.sensor("motor", fmbd.reaction_torque("motor"))
    run = fmbd.solve(scene, t_end=1.0, dt=2e-3)
    t = run.times
    assert np.abs(run["phi"][:, 0] - turn * t**3).max() < 1e-10
    assert np.abs(run["psi"][:, 0] + 2.5 * turn * t**3).max() < 1e-10
    assert abs(run["rate"][-1, 0] + 2.5 * 3 * turn) < 1e-2
    torque = (0.2 + 2.5**2 * 0.02) * 6 * turn  # J_reduced phi'' at t = 1; on the ground with the opposite sign
    assert abs(run["motor"][-1, 2] + torque) < 1e-3 * torque


def test_screw_advances_its_lead() -> None:
    nut = fmbd.RigidBody("nut", 1.0, (0.1, 0.1, 0.2))
    scene = fmbd.Scene("screw", gravity=(0, 0, -9.81))
    scene.add(nut)
    joint = fmbd.cylindrical("guide", fmbd.ground, nut, axis=(0, 0, 1), center=(0, 0, 0))
    scene.add(joint, fmbd.screw("thread", joint, lead=0.5))
    scene.sensor("z", fmbd.displacement(joint))
    scene.sensor("phi", fmbd.angle(joint))
    run = fmbd.solve(scene, t_end=2.0, dt=5e-3)
    p = 0.5 / (2 * math.pi)
    assert np.abs(run["z"] - p * run["phi"]).max() < 1e-12
    a = 9.81 / (1 + 0.2 / p**2)
    assert abs(run["z"][-1, 0] + 0.5 * a * 4) < 1e-9


def test_reaction_of_a_cantilever() -> None:
    """A bar welded to the ground: its weight and the moment of it act on the ground, the first body."""
    bar = fmbd.RigidBody("bar", 2.0, (0.1, 0.2, 0.2), position=(0.7, 0, 0))
    scene = fmbd.Scene("bar", gravity=(0, 0, -10.0))
    scene.add(bar)
    scene.add(fmbd.fixed("weld", fmbd.ground, bar, center=(0, 0, 0)))
    scene.sensor("F", fmbd.reaction_force("weld"))
    scene.sensor("T", fmbd.reaction_torque("weld"))
    run = fmbd.solve(scene, t_end=0.1, dt=0.02)
    assert np.abs(run["F"] - [0, 0, -20.0]).max() < 1e-10
    assert np.abs(run["T"] - np.cross([0.7, 0, 0], [0, 0, -20.0])).max() < 1e-10


def test_an_interpolation_is_asked_for_its_own_derivatives() -> None:
    """Three evaluations of the tables a step, none of them for differences, up to their very end."""
    asked = []

    class Table(CubicSpline):
        def __call__(self, *args: Any, **options: Any) -> Any:
            asked.append(args)
            return super().__call__(*args, **options)

    t = np.linspace(0.0, 0.1, 21)
    arm = fmbd.RigidBody("arm", 1.0, 0.1, (0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
    found = []
    for motion in (Table(t, np.sin(9 * t), extrapolate=False), lambda t: np.sin(9 * t)):
        scene = fmbd.Scene("table", gravity=(0, -9.81))
        scene.add(arm, pin, fmbd.drive("motor", fmbd.angle(pin), motion))
        scene.sensor("torque", fmbd.reaction_torque("motor"))
        found.append(fmbd.solve(scene, t_end=0.1, dt=1e-3, output=fmbd.Output(every=100))["torque"][-1])
    assert len(asked) < 20 * 100  # of the table and of both derivatives; 85 a step by differences
    np.testing.assert_allclose(found[0], found[1], rtol=1e-2)


def test_piecewise_polynomials_and_their_derivatives_are_asked_at_once() -> None:
    """To the last bit as one by one; a class that answers otherwise is asked itself."""

    class Twice(CubicSpline):
        def __call__(self, *args: Any, **options: Any) -> Any:
            return 2.0 * super().__call__(*args, **options)

    t = np.linspace(0.0, 0.1, 21)
    spline, other = (kind(t, np.sin(9 * t), extrapolate=False) for kind in (CubicSpline, Twice))
    motion, twice = (smooth_motion("motor", function) for function in (spline, other))
    assert isinstance(with_its_derivatives(spline), PPoly) and not isinstance(with_its_derivatives(other), PPoly)
    for at in (0.0, 0.013, 0.1):
        assert motion(at) == tuple(spline(at, order) for order in range(3))
        assert twice(at) == tuple(other(at, order) for order in range(3))


def test_computed_derivatives_of_a_motion() -> None:
    for f, bar in ((lambda t: np.sin(3 * t), 1e-9), (lambda t: math.sin(3 * t), 1e-7)):
        s = np.array(smooth_motion("m", f)(0.7))
        assert np.abs(s - [math.sin(2.1), 3 * math.cos(2.1), -9 * math.sin(2.1)]).max() < bar


@pytest.mark.parametrize("form", [fmbd.Index3(), fmbd.GGL()], ids=lambda form: form.name)
@pytest.mark.parametrize("rtol", [None, 1e-6], ids=["equal steps", "own steps"])
def test_rates_of_a_motion_are_found_where_they_are_needed(form: Any, rtol: float | None) -> None:
    """Steps of index 3 hold places; records, errors and the stabilised form take the rates, some ninety values each."""
    asked = []

    def law(t: float) -> float:
        asked.append(t)
        return 0.4 * math.sin(2 * t)

    def run(compiled: bool) -> fmbd.Run:
        scene, (hinge, slider) = joints(2)
        scene.add(fmbd.drive("turn", fmbd.angle(hinge), law))
        scene.sensor("place", fmbd.position(scene.bodies["one"])), scene.sensor("force", fmbd.reaction("turn"))
        asked.clear()
        scheme = fmbd.GeneralizedAlpha(0.8, form=form, compiled=compiled, rtol=rtol)
        output = fmbd.Output(every=100 if rtol is None else 10**6)
        return fmbd.solve(scene, t_end=0.2, dt=1e-3, scheme=scheme, output=output)

    fast = run(True)
    if rtol is None and form == fmbd.Index3() and kernel_cache.compiler() is not None:
        assert len(asked) < 25 * 200  # with rates in every step 100 * 200
    slow = run(False)
    assert fast.counters["steps"] == slow.counters["steps"]
    assert fast.drift == pytest.approx(slow.drift, rel=1e-4, abs=1e-14)
    for name in ("place", "force"):
        np.testing.assert_allclose(fast[name], slow[name], rtol=1e-6, atol=1e-6 * np.abs(slow[name]).max())


def test_motion_that_is_not_finite_is_named() -> None:
    scene, (hinge, _) = joints(3)
    with pytest.raises(CallbackError, match='"motor".*nan'):
        fmbd.drive("motor", fmbd.angle(hinge), lambda t: float("nan"))


def test_wrong_input_is_named() -> None:
    scene, (hinge, slider) = joints(3)
    with pytest.raises(InputError, match='"slider".*no angle'):
        fmbd.angle(slider)
    with pytest.raises(InputError, match='"g".*ratio'):
        fmbd.gear("g", fmbd.angle(hinge), fmbd.displacement(slider), ratio=0.0)
    with pytest.raises(InputError, match='"g".*itself'):
        fmbd.gear("g", fmbd.angle(hinge), fmbd.angle(hinge), ratio=2.0)
    with pytest.raises(InputError, match='"own".*function of 5 arguments .*found one of'):
        bad = fmbd.Scene("bad")
        one = fmbd.RigidBody("one", 1.0, 1.0)
        bad.add(one, fmbd.own_joint("own", fmbd.ground, one, lambda x: x))
        bad.build()
    alone = fmbd.Scene("alone")
    alone.add(*scene.bodies.values(), fmbd.drive("d", fmbd.angle(hinge), lambda t: t))
    with pytest.raises(InputError, match='"d".*"hinge".*not in the scene'):
        alone.build()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("what", ["drive angle", "gear", "own"])
def test_derivatives_on_elastic_surfaces(dim: int, what: str, rod_mesh: Any) -> None:
    """Joint coordinates and own joints see the mean position and rotation of an elastic surface."""
    scene, rod, block = elastic_scene(rod_mesh(dim=dim, h=0.5, height=0.4), degree=1)
    pin = fmbd.revolute("pin", fmbd.ground, rod.surface("pin"))
    tip = fmbd.revolute("tip", rod.surface("tip"), block)
    scene.add(pin, tip)
    if what == "drive angle":
        scene.add(fmbd.drive("d", fmbd.angle(tip), lambda t: 0.3 * np.sin(2 * t)))
    elif what == "gear":
        scene.add(fmbd.gear("d", fmbd.angle(pin), fmbd.angle(tip), ratio=-1.5))
    else:
        scene.add(fmbd.own_joint("d", rod.surface("tip"), block, bevel))
    check_derivatives(Motion(scene))


def test_an_own_joint_between_two_points_is_a_rope() -> None:
    """Its length given as a function of numbers, of two points apart: the motion of the built-in distance."""

    def rope(xa: Any, Ra: Any, xb: Any, Rb: Any, t: float) -> Any:
        d = xb - xa
        return np.array([np.sqrt(d @ d) - math.sqrt(1.25)])  # math.sqrt of a number is no reason to leave formulas

    places = []
    for numbers in (None, rope, lambda *x: rope(*x) + 0.0 * math.cos(np.real(x[-1]))):
        scene = fmbd.Scene("crane", gravity=(0, -9.81))
        trolley = fmbd.RigidBody("trolley", 2.0, 0.1)
        load = fmbd.RigidBody("load", 1.0, 0.1, position=(0.5, -1.0))
        scene.add(trolley, load, fmbd.prismatic("rail", fmbd.ground, trolley, center=(0, 0), axis=(1, 0)))
        ends = {"point_a": (0.0, 0.0), "point_b": (0.5, -1.0)}
        scene.add(
            fmbd.distance("rope", trolley, load, **ends)
            if numbers is None
            else fmbd.own_joint("rope", trolley, load, numbers, **ends)
        )
        scene.sensor("load", fmbd.position(load))
        places.append(fmbd.solve(scene, t_end=0.5, dt=5e-3)["load"])
    assert max(np.abs(x - places[0]).max() for x in places) < 1e-9
    with pytest.raises(InputError, match="center, where both markers sit, or point_a"):
        fmbd.own_joint("rope", trolley, load, rope, center=(0, 0), point_a=(0, 0))


def cam(function: Any, size: float = 1.0) -> fmbd.Scene:
    """A cam that turns freely lifts a sprung follower as a function says."""
    scene = fmbd.Scene("cam")
    disc = fmbd.RigidBody("disc", 2.0, 0.5 * size**2, angular_velocity=10.0)
    follower = fmbd.RigidBody("follower", 0.5, size**2, position=(0, 5 * size))
    scene.add(disc, follower, fmbd.revolute("axle", fmbd.ground, disc, center=(0, 0)))
    scene.add(fmbd.prismatic("guide", fmbd.ground, follower, axis=(0, 1), center=(0, 5 * size)))
    scene.add(fmbd.own_joint("cam", disc, follower, function, point_a=(0.1 * size, 0), point_b=(0, 5 * size)))
    scene.add(fmbd.Spring("spring", fmbd.ground, follower, (0, 20 * size), (0, 5 * size), stiffness=20.0, length=size))
    scene.sensor("disc", fmbd.rotation(disc))
    scene.sensor("cam", fmbd.reaction("cam"))
    return scene


def lift(size: float, square: Any) -> Any:
    """The function of that cam with the square of a sine by ``square``."""
    return lambda xa, Ra, xb, Rb, t: [xb[1] - xa[1] - size * (5 + 2 * square(Ra[1, 0]))]


TABLE = CubicSpline(np.linspace(-1.5, 1.5, 9), np.linspace(-1.5, 1.5, 9) ** 2)
SQUARES = {
    "drops imaginary parts": lambda s: abs(s) ** 2,
    "a table": lambda s: TABLE(s),
    "no arrays": lambda s: math.pow(s, 2),
}


@pytest.mark.parametrize("size", [1.0, 1e-4])
@pytest.mark.parametrize("square", SQUARES.values(), ids=SQUARES)
def test_a_function_of_numbers_is_a_joint_of_compiled_steps_in_all_sizes(square: Any, size: float) -> None:
    """What the function reads of the disc matters at no first order where it starts: rows that leave it out are noticed later."""
    calls = 0

    def counted(*args: Any) -> Any:
        nonlocal calls
        calls += 1
        return lift(size, square)(*args)

    found, steps = [], 40
    for function in (lift(size, lambda s: s * s), counted):
        found.append(fmbd.solve(cam(function, size), t_end=0.1, dt=0.1 / steps))
    formula, numbers = found
    for name, close in (("disc", 1e-7), ("cam", 1e-6)):
        assert np.abs(numbers[name] - formula[name]).max() < close * np.abs(formula[name]).max()
    if kernel_cache.compiler() is not None:
        assert numbers.counters["compiled_steps"] == steps
    assert np.abs(formula["disc"][-1] - np.cos(1.0)).max() > 0.05  # the cam has braked it

    calls = 0
    fmbd.solve(cam(counted, size), t_end=0.1, dt=0.1 / steps)
    each = calls / numbers.counters["newton_iterations"]
    assert each < (15 if square is SQUARES["a table"] else 50)


def test_compiled_steps_and_numpy_agree_on_a_function_of_numbers() -> None:
    runs = [
        fmbd.solve(
            cam(lift(1.0, SQUARES["a table"])), t_end=0.05, dt=1e-3, scheme=fmbd.GeneralizedAlpha(compiled=compiled)
        )
        for compiled in (True, False)
    ]
    for name, close in (("disc", 1e-11), ("cam", 5e-8)):  # multipliers have the roundoff of differences over h^2
        assert np.abs(runs[0][name] - runs[1][name]).max() < close * np.abs(runs[0][name]).max()


def test_a_function_of_numbers_moves_in_time() -> None:
    """Terms that cancel at the start leave their roundoff to the differences of its rate in time."""

    def rope(xa: Any, Ra: Any, xb: Any, Rb: Any, t: Any, sine: Any = np.sin) -> Any:
        return np.sqrt((xb - xa) @ (xb - xa)) - 0.5 * (1 + 0.1 * sine(t))

    rates = []
    for function in (
        rope,
        lambda *x: [math.sqrt(float((x[2] - x[0]) @ (x[2] - x[0]))) - 0.5 * (1 + 0.1 * math.sin(float(x[4])))],
    ):
        ball = fmbd.RigidBody("ball", 1.0, (0.1, 0.1, 0.1), position=(0.3, 0.4, 0))
        scene = fmbd.Scene("rope", gravity=(0, 0, -9.81))
        scene.add(ball, fmbd.own_joint("rope", fmbd.ground, ball, function, point_a=(0, 0, 0), point_b=(0.3, 0.4, 0)))
        scene.sensor("pull", fmbd.reaction("rope"))
        rates.append(fmbd.solve(scene, t_end=0.02, dt=2e-3)["pull"])
    assert np.abs(rates[1] - rates[0]).max() < 1e-5 * np.abs(rates[0]).max()


@pytest.mark.parametrize("scheme", [fmbd.Radau(3, rtol=1e-8), fmbd.BDF(rtol=1e-8)], ids=lambda s: s.name)
def test_a_joint_by_a_table_in_steps_of_the_scheme_s_choice(scheme: Any) -> None:
    """The end of a double pendulum glides along a spline, as along the sine behind it; rates are asked for before all else."""

    def guided(height: Any) -> fmbd.Scene:
        bodies = [fmbd.RigidBody(f"{k}", 1.0, 0.1, position=(k + 0.5, 0.0)) for k in range(2)]
        scene = fmbd.Scene("guided", gravity=(0, -9.81))
        scene.add(*bodies, fmbd.revolute("near", fmbd.ground, bodies[0], center=(0, 0)))
        scene.add(fmbd.revolute("far", *bodies, center=(1, 0)))

        def held(xa: Any, Ra: Any, xb: Any, Rb: Any, t: Any) -> Any:
            return np.array([xb[1] - 0.1 * (height(xb[0]) - np.sin(1.5))])

        scene.add(fmbd.own_joint("guide", fmbd.ground, bodies[1], held, center=(1.5, 0.0)))
        scene.sensor("x", fmbd.position(bodies[1]))
        return scene

    places = np.linspace(0.0, 2.0, 201)
    run, exact = (
        fmbd.solve(guided(height), t_end=0.2, scheme=scheme) for height in (CubicSpline(places, np.sin(places)), np.sin)
    )
    assert run["x"][-1] == pytest.approx(exact["x"][-1], abs=1e-7)
