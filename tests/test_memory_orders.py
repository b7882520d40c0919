"""Memories of continuous laws under Radau and BDF: of the order of the motion, and within its tolerance."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import CallbackError, ConvergenceError
from fmbd_fenicsx.rotations import Array
from fmbd_fenicsx.system.compiled import choice
from fmbd_fenicsx.system.control.control_laws import unfelt
from fmbd_fenicsx.system.control.control_memory import ControllerMemory
from fmbd_fenicsx.system.control.memory_points import PointMemories, PointRule, StepError

END = 2.0
TIMES = np.linspace(0.0, END, 11)
GAINS, LIMIT = (60.0, 80.0, 9.0), 40.0


def goal(t: float) -> float:
    return 0.8 * float(np.sin(2.0 * t))


class Case(NamedTuple):
    """A law (t, s, v, z) -> (u, z') on the angle of a wheel of 1 kg m^2, the memory at the start, and the speed there."""

    law: Callable[[float, float, float, Array], tuple[float, Any]]
    memory: tuple[float, ...]
    speed: float = 0.0


def filtered(t: float, s: float, v: float, z: Array) -> tuple[float, Any]:
    """PID with a filter of its derivative, against a weight."""
    e = goal(t) - s
    return 50 * e + 360 * (e - z[0]) + 30 * z[1] - 8 * np.sin(s), (60 * (e - z[0]), e)


def bouc_wen(t: float, s: float, v: float, z: Array) -> tuple[float, Any]:
    return 3 * np.cos(2 * t) - 12 * s - 28 * z[0], (v - 30 * abs(v) * z[0] * abs(z[0]) - 20 * v * z[0] ** 2,)


def maxwell(t: float, s: float, v: float, z: Array) -> tuple[float, Any]:
    return -25 * s - 60 * (s - z[0]) + 2 * np.sin(3 * t), ((s - z[0]) / 0.15,)


def stiff(t: float, s: float, v: float, z: Array) -> tuple[float, Any]:
    return -30 * z[0] - 2 * v + np.sin(3 * t), (1e4 * (s - z[0]),)


def three_gains(t: float, s: float, v: float, z: Array) -> tuple[float, Any]:
    """That of fmbd.pid, whose limit never binds."""
    e, (kp, ki, kd) = goal(t) - s, GAINS
    return kp * e + ki * z[0] + kd * (1.6 * np.cos(2 * t) - v), (e,)


CASES = {
    "filtered": Case(filtered, (0.0, 0.0)),
    "bouc_wen": Case(bouc_wen, (0.0,)),
    "maxwell": Case(maxwell, (0.3,), 1.0),
    "stiff": Case(stiff, (0.0,), 1.0),
    "pid": Case(three_gains, (0.0,), 1.0),
}


@cache
def exact(name: str) -> Array:
    """Angle and speed at the times, by SciPy, (n, 2)."""
    case = CASES[name]

    def rate(t: float, x: Array) -> Array:
        u, g = case.law(t, x[0], x[1], x[2:])
        return np.concatenate(([x[1], u], g))

    start = np.concatenate(([0.0, case.speed], case.memory))
    method = "Radau" if name == "stiff" else "DOP853"
    found = solve_ivp(rate, (0.0, END), start, method=method, rtol=1e-12, atol=1e-14, t_eval=TIMES)
    return np.asarray(found.y[:2].T)


def wheel(name: str, calls: list[float] | None = None) -> fmbd.Scene:
    """The same as a scene; ``calls``: the times at which the law is asked."""
    case, asked = CASES[name], [] if calls is None else calls
    body = fmbd.RigidBody("wheel", 1.0, 1.0, angular_velocity=case.speed)
    hinge = fmbd.revolute("hinge", fmbd.ground, body, center=(0, 0))
    phi = fmbd.angle(hinge)

    def law(t: float, y: Any, z: Array) -> tuple[float, Any]:
        asked.append(t)
        return case.law(t, y["s"][0], y["v"][0], z)

    scene = fmbd.Scene(name)
    reads = {"s": phi, "v": fmbd.joint_rate(phi)}
    own = fmbd.controller("motor", reads=reads, acts=phi, law=law, memory=case.memory)
    scene.add(body, hinge)
    scene.add(fmbd.pid("motor", phi, target=goal, gains=GAINS) if name == "pid" else own)
    scene.sensor("phi", phi)
    scene.sensor("rate", fmbd.joint_rate(phi))
    scene.sensor("effort", fmbd.element_effort(scene.forces["motor"]))
    return scene


def error(run: Any, name: str) -> float:
    """The largest of angles and speeds."""
    found = np.concatenate((run["phi"], run["rate"]), axis=1)
    return float(np.abs(found - exact(name)).max())


AT_TIMES = fmbd.Output(times=tuple(TIMES))


@pytest.mark.parametrize("name", ["filtered", "stiff", "pid"])
def test_memories_are_of_the_order_of_the_scheme(name: str) -> None:
    """Two memories of a law in Python, one of rate 1e4 1/s, and the integral of a formula."""
    schemes: dict[Any, float] = {
        fmbd.Radau(stages=2, rtol=None): 3,
        fmbd.Radau(rtol=None): 5,
        fmbd.BDF(order=2, rtol=None): 2,
        fmbd.BDF(order=4, rtol=None): 4,
        fmbd.BDF(order=5, rtol=None): 5,
    }
    for scheme, order in schemes.items():
        steps = (0.02, 0.01) if isinstance(scheme, fmbd.Radau) else (0.01, 0.005)
        errors = [
            error(fmbd.solve(wheel(name), t_end=END, dt=dt, scheme=scheme, output=AT_TIMES), name) for dt in steps
        ]
        assert np.log2(errors[0] / errors[1]) > order - 0.2, (scheme.name, errors)


@pytest.mark.parametrize("name", CASES)
def test_error_control_sees_memories(name: str) -> None:
    """The trapezoidal rule left up to 1000 tolerances; laws are asked as often as three stages take, or one point."""
    for scheme, most in ((fmbd.Radau(rtol=1e-6), 40), (fmbd.BDF(rtol=1e-6), 18)):
        calls: list[float] = []
        run = fmbd.solve(wheel(name, calls), t_end=END, scheme=scheme, output=AT_TIMES)
        assert error(run, name) < 5e-5, scheme.name
        assert len(calls) < most * run.counters["steps"], scheme.name


def limited(t: float, s: float, v: float, z: Array) -> tuple[float, Any]:
    """What a limit cuts off is fed back."""
    free = 40 * (1 - s) - 6 * v + 30 * z[0]
    u = min(max(free, -8.0), 8.0)
    return u, (1 - s - 0.5 * (free - u),)


@pytest.mark.compiled
@pytest.mark.parametrize("driven", [True, False])
@pytest.mark.parametrize("name", ["limited", "limited pid"])
def test_error_control_of_one_step_methods_sees_memories(
    name: str, driven: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Behind a limit the motion has no error, and steps grew over what the memory does: it was 1e-2 off for all tolerances."""
    if not driven:
        monkeypatch.setattr(choice, "driver_of", lambda *system: None)

    def run(scheme: Any) -> fmbd.Run:
        body = fmbd.RigidBody("wheel", 1.0, 1.0)
        hinge = fmbd.revolute("hinge", fmbd.ground, body, center=(0, 0))
        phi, scene = fmbd.angle(hinge), fmbd.Scene(name)
        reads = {"s": phi, "v": fmbd.joint_rate(phi)}
        law = lambda t, y, z: limited(t, y["s"][0], y["v"][0], z)  # noqa: E731
        own = fmbd.controller("motor", reads=reads, acts=phi, law=law, memory=(0.0,))
        pid = fmbd.pid("motor", phi, target=1.0, gains=(40.0, 30.0, 6.0), limit=8.0)
        scene.add(body, hinge, own if name == "limited" else pid)
        scene.sensor("phi", phi)
        return fmbd.solve(scene, t_end=1.0, scheme=scheme, output=fmbd.Output(times=tuple(np.linspace(0.0, 1.0, 21))))

    found, close = run(fmbd.GeneralizedAlpha(rtol=1e-5)), run(fmbd.Radau(rtol=1e-9))
    assert float(np.abs(found["phi"] - close["phi"]).max()) < 2e-4


LATE = {
    "grows": (lambda z: np.sin(z), lambda t: t**3, lambda t: t**4 / 4),
    "jumps": (lambda z: z * z, lambda t: 1.0 * (t > 0.3), lambda t: max(t - 0.3, 0.0)),
}


@pytest.mark.parametrize("name", LATE)
@pytest.mark.parametrize(
    "scheme",
    [fmbd.GeneralizedAlpha(rtol=1e-5), fmbd.Radau(rtol=1e-6), fmbd.BDF(rtol=1e-6)],
    ids=lambda x: type(x).__name__,
)
def test_a_memory_of_time_alone_leaves_zero(scheme: Any, name: str) -> None:
    """No error is small beside what begins at nothing: steps went below roundoff for that, and a jump was 1000 rtol off."""
    effort, rate, memory = LATE[name]
    body = fmbd.RigidBody("wheel", 1.0, 1.0, angular_velocity=1.0)
    hinge = fmbd.revolute("hinge", fmbd.ground, body, center=(0, 0))
    phi, scene = fmbd.angle(hinge), fmbd.Scene(name)
    law = lambda t, y, z: (float(effort(z[0])), rate(t))  # noqa: E731
    scene.add(body, hinge, fmbd.controller("own", reads={"s": phi}, acts=phi, law=law, memory=(0.0,)))
    scene.sensor("phi", phi)
    end = fmbd.solve(scene, t_end=1.0, scheme=scheme)["phi"][-1, 0]
    state = solve_ivp(lambda t, x: (x[1], effort(memory(t))), (0, 1), (0.0, 1.0), rtol=1e-10, atol=1e-12)
    assert end == pytest.approx(state.y[0, -1], abs=10 * scheme.rtol)


def test_a_tighter_tolerance_is_met() -> None:
    run = fmbd.solve(wheel("filtered"), t_end=END, scheme=fmbd.Radau(rtol=1e-8), output=AT_TIMES)
    assert error(run, "filtered") < 2e-8


def test_a_law_that_bends_has_slopes_where_its_memory_is_and_an_error_by_these() -> None:
    """An implicit Euler step of z' = -k z^3, so long that the slope at its beginning finds nothing in 30 sweeps: h k = 1000.
    Its error, 0.9 by itself, is filtered by a slope near its end.
    """
    points = PointMemories("bends")
    kept = ControllerMemory(0.0, np.ones(1), np.zeros(1), np.zeros(1), 0)
    rule = PointRule(np.ones(1), np.ones((1, 1)), -np.ones((1, 1)), np.zeros(1))
    points.find(kept, rule, np.zeros((1, 1)), lambda t, y, z: (z, -1e3 * z**3))
    (z,) = points.z[0]
    assert z + 1e3 * z**3 == pytest.approx(1.0, rel=1e-5)

    of = StepError(np.ones(1), -np.ones(1), np.zeros(1), 0.0, 1.0, 1.0, 0.0)
    filtered = abs(z - 1.0) / (1.0 + 3e3 * z**2)
    assert points.error(kept, of) * points.sizes(kept, 1.0, points.z[0])[0] == pytest.approx(filtered, rel=0.3)


def euler_step(law: Any, z: float, rate: float) -> float:
    """The memory behind an implicit Euler step of 1 s from z, which this rate foretells."""
    points, rule = PointMemories("far"), PointRule(np.ones(1), np.ones((1, 1)), -np.ones((1, 1)), np.zeros(1))
    kept = ControllerMemory(0.0, np.array([z]), np.array([rate]), np.zeros(1), 0)
    points.find(kept, rule, np.zeros((1, 1)), lambda t, y, z: (z, law(z)))
    return float(points.z[0, 0])


@pytest.mark.parametrize("law", [lambda z: -1e3 * z**3, lambda z: -1e3 * np.tanh(z)], ids=["steep", "level"])
@pytest.mark.parametrize("foretold", [True, False])
def test_what_is_foretold_far_off_is_no_memory(law: Any, foretold: bool) -> None:
    """z' = -1000 z^3 is foretold where rates, 1e15, hide what is left; where tanh is level, slopes lead astray."""
    z = euler_step(law, 5.0, float(law(5.0)) if foretold else 0.0)
    assert z - law(z) == pytest.approx(5.0, rel=1e-4)


def test_a_memory_without_a_value_is_an_error() -> None:
    """z = 1 + (1 + z^2) has no solution."""
    with pytest.raises(CallbackError, match="has no value up to t = 1 s"):
        euler_step(lambda z: 1.0 + z**2, 1.0, 2.0)


@pytest.mark.compiled
@pytest.mark.parametrize("driven", [True, False])
@pytest.mark.parametrize("scheme", [fmbd.Radau(rtol=1e-6), fmbd.BDF(rtol=1e-6)], ids=["radau", "bdf"])
def test_an_error_that_is_no_number_passes_no_step(scheme: Any, driven: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind an error of the motion max() and fmax() lose it."""
    if not driven:
        monkeypatch.setattr(choice, "driver_of", lambda *system: None)
    monkeypatch.setattr(PointMemories, "error", lambda *given: float("nan"))
    with pytest.raises(ConvergenceError, match="cannot be made smaller"):
        fmbd.solve(wheel("filtered"), t_end=0.1, scheme=scheme)


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [fmbd.Radau(rtol=1e-6), fmbd.BDF(rtol=None)], ids=["radau", "bdf"])
@pytest.mark.parametrize("name", ["filtered", "pid"])
def test_steps_in_numpy_find_the_same(name: str, scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = []
    for _ in range(2):
        runs.append(fmbd.solve(wheel(name), t_end=0.4, dt=0.02, scheme=scheme))
        monkeypatch.setattr(choice, "driver_of", lambda *system: None)
    ends = [np.array([r[x][-1, 0] for x in ("phi", "rate", "effort")]) for r in runs]
    assert ends[1] == pytest.approx(ends[0], rel=2e-6)


@pytest.mark.parametrize(
    "scheme", [fmbd.Radau(rtol=1e-6), fmbd.BDF(rtol=1e-6), fmbd.BDF(rtol=None)], ids=["radau", "bdf", "equal"]
)
@pytest.mark.parametrize("name", ["filtered", "pid"])
def test_memories_survive_checkpoints(name: str, scheme: Any, tmp_path: Any) -> None:
    whole = fmbd.solve(wheel(name), t_end=1.0, dt=0.02, scheme=scheme)
    fmbd.solve(wheel(name), t_end=1.0, dt=0.02, scheme=scheme, checkpoint=fmbd.Checkpoint(tmp_path, every=11, keep=9))
    middle = min(tmp_path.iterdir(), key=lambda p: int(p.name.rpartition("step")[2]))
    again = fmbd.solve(wheel(name), t_end=1.0, dt=0.02, scheme=scheme, restart=middle)
    for sensor in ("phi", "rate", "effort"):
        assert np.array_equal(again[sensor], whole[sensor])


def test_efforts_within_steps_have_the_memory_of_the_instant() -> None:
    """On the cubic through the ends of a step: errors fall by 16 where steps are halved."""
    output = fmbd.Output(times=tuple(np.linspace(0.0, 1.0, 101)))
    efforts = [
        fmbd.solve(wheel("maxwell"), t_end=1.0, dt=dt, scheme=fmbd.Radau(rtol=None), output=output)["effort"]
        for dt in (0.05, 0.025, 0.005)
    ]
    off = [float(np.abs(x - efforts[2]).max()) for x in efforts[:2]]
    assert np.log2(off[0] / off[1]) > 3.5


def test_an_integral_beside_a_sampled_controller() -> None:
    """Python takes up ends of steps that compiled code has found, where a sample may be due."""
    errors = []
    for dt in (0.02, 0.01):
        scene = wheel("pid")
        scene.add(
            fmbd.controller(
                "idle",
                reads={"s": fmbd.angle(scene.joints["hinge"])},
                acts=fmbd.angle(scene.joints["hinge"]),
                law=lambda t, y, z: 0.0,
                every=0.5,
            )
        )
        errors.append(error(fmbd.solve(scene, t_end=END, dt=dt, scheme=fmbd.Radau(rtol=None), output=AT_TIMES), "pid"))
    assert np.log2(errors[0] / errors[1]) > 4.5


def test_certificates_know_what_memories_leave() -> None:
    output = fmbd.Output(times=tuple(TIMES), estimate_error=True)
    for scheme in (fmbd.Radau(rtol=1e-5), fmbd.BDF(rtol=1e-6)):
        run = fmbd.solve(wheel("maxwell"), t_end=END, scheme=scheme, output=output)
        true = float(np.abs(run["phi"][:, 0] - exact("maxwell")[:, 0]).max())
        assert 0.5 * true <= run.certificate["phi"].time <= 20 * true, scheme.name


def test_a_tolerance_is_met_with_memories() -> None:
    run = fmbd.solve(wheel("filtered"), t_end=END, tol={"phi": 1e-5}, scheme=fmbd.Radau(), output=AT_TIMES)
    assert float(np.abs(run["phi"][:, 0] - exact("filtered")[:, 0]).max()) < 1e-5


def test_explicit_schemes_say_that_their_error_control_sees_no_memory(caplog: pytest.LogCaptureFixture) -> None:
    fmbd.solve(wheel("maxwell"), t_end=0.1, scheme=fmbd.schemes.ExplicitRungeKutta(rtol=1e-6))
    assert 'memory of controller "motor"' in caplog.text


@pytest.mark.parametrize("way", ["PID", "integral", "lag"])
def test_a_memory_that_begins_at_zero_holds_no_step_back(way: str) -> None:
    """A block that is caught from its own target on: what begins at zero is weighed by what the motion feels of it."""

    def run(law: Any, memory: tuple[float, ...] = ()) -> fmbd.Run:
        block = fmbd.RigidBody("block", 1.0, 0.1, velocity=(3.0, 0.0))
        slide = fmbd.prismatic("slide", fmbd.ground, block, axis=(1, 0), center=(0, 0))
        scene, x = fmbd.Scene("caught"), fmbd.displacement(slide)
        reads = {"s": x, "v": fmbd.joint_rate(x)}
        if law is None:
            acting = fmbd.pid("catch", x, target=0.0, gains=(2.0, 0.5, 1.0))
        else:
            acting = fmbd.controller("catch", reads=reads, acts=x, law=law, memory=memory)
        scene.add(block, slide, acting)
        scene.sensor("x", fmbd.position(block))
        return fmbd.solve(scene, t_end=2.0, scheme=fmbd.BDF(rtol=1e-6))

    laws: dict[str, Any] = {
        "PID": None,
        "integral": lambda t, y, z: (-2.0 * y["s"][0] + 0.5 * z[0] - y["v"][0], -y["s"][0]),
        "lag": lambda t, y, z: (z[0] - y["v"][0], (-2.0 * y["s"][0] - z[0]) / 0.2),
    }
    without = run(lambda t, y, z: -2.0 * y["s"][0] - y["v"][0])
    found = run(laws[way], (0.0,))
    assert found.counters["steps"] < 1.6 * without.counters["steps"] and found.times[1] == without.times[1]

    # x''' + x'' + 2 x' + x / 2 = 0; of the lag x''' / 5 + 6 / 5 x'' + x' + 2 x = 0
    (p, q, r), a = ((6.0, 5.0, 10.0), -3.0) if way == "lag" else ((1.0, 2.0, 0.5), -3.0)
    exact = solve_ivp(
        lambda t, x: (x[1], x[2], -p * x[2] - q * x[1] - r * x[0]), (0, 2), (0.0, 3.0, a), rtol=1e-11, atol=1e-12
    )
    assert np.abs(found["x"][-1, 0] - exact.y[0, -1]) < 1e-5


def test_what_is_far_from_linear_has_no_size() -> None:
    """By what memories are measured: a law that is linear, one with a square, and one that has no value for what is far."""

    def sizes(law: Any) -> Array:
        return unfelt(law, np.array([0.3, 2.0]), np.zeros(1), np.array([10.0, 0.0]))

    assert sizes(lambda y, z: (np.array([4.0 * y[0] + y[1] + 8.0 * z[0]]), -y[:1])) == pytest.approx(5.0)
    assert sizes(lambda y, z: (z, 3.0 * y[:1] - 2.0 * z)) == pytest.approx(15.0)
    assert sizes(lambda y, z: (y[:1] + z + z**2, -y[:1])) == 0.0

    def bounded(y: Array, z: Array) -> tuple[Array, Array]:
        if z[0] > 1.0:
            raise CallbackError("no value")
        return y[:1] + z, y[:1]

    assert sizes(bounded) == 0.0


def test_slopes_that_were_far_steeper_hide_nothing_that_is_left() -> None:
    """Kept from other readings, along which the memory has no way to go: it stayed where it was."""
    points, kept = PointMemories("steep"), ControllerMemory(0.0, np.ones(1), np.zeros(1), np.zeros(1), 0)
    rule = PointRule(np.ones(1), np.ones((1, 1)), -np.ones((1, 1)), np.zeros(1))
    for slope, rate in ((-1e12, 0.0), (0.0, 1e3)):
        points.find(kept, rule, np.array([[slope, rate]]), lambda t, y, z: (z, y[0] * z + y[1]))
    assert points.z[0, 0] == pytest.approx(1001.0, rel=1e-9)
