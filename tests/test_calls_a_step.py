"""No scene falls to steps that Python makes: calls of Python a step beside those of a user's own functions, in every scheme."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from chains import chain
from profiled import calls_of

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import plane_stress
from fmbd_fenicsx.mechanics.forces.user_laws import Repeatable
from fmbd_fenicsx.mechanics.joints.couplings import smooth_motion
from fmbd_fenicsx.mechanics.kinds.asked import AskedFunction, reads
from fmbd_fenicsx.rotations import motions
from fmbd_fenicsx.schemes.own_marching import OwnMarch

SCHEMES = [
    fmbd.GeneralizedAlpha(),
    fmbd.BDF(5, rtol=None),
    fmbd.Radau(3, rtol=None),
    fmbd.Rattle(),
    fmbd.HalfExplicit(rtol=None),
    fmbd.EnergyMomentum(),
]
OWN = [fmbd.Radau(3, rtol=1e-6), fmbd.BDF(rtol=1e-6), fmbd.HalfExplicit(rtol=1e-6)]
AROUND, EACH = 15.0, 18.0  # calls of a step that asks for nothing, and for each time that a function is asked
USABLE = 8.0  # for each time that a function is asked whose answers are usable at a glance
LOOKS = 60.0  # calls of a step where looks at a run, once in some hundred steps, fall into short ones
SAMPLE = 725.0  # calls of a sample of four controllers, with the new start behind it
ON_FIELDS = 1400.0  # calls of a sample of one controller with a field of finite elements behind it
RECORDED = 600.0  # calls of a sample of one controller, with the record there and those of equal steps up to it
BETWEEN = 150.0  # calls of one of ten steps and more of a scheme's own choice a sample, or under an event
DT = 2e-3  # s


def circle(q: Any, t: Any) -> Any:
    """A point on a circle, whose other coordinate turns with time."""
    return np.array([q[0] ** 2 + q[2] ** 2 - 1.0, q[1] - 0.2 - 0.1 * np.sin(q[0] - 0.6) - 0.05 * np.sin(t) ** 2])


def slopes(q: Any, t: Any) -> Any:
    """Its derivative by the coordinates."""
    return np.array([[2 * q[0], 0.0, 2 * q[2]], [-0.1 * np.cos(q[0] - 0.6), 1.0, 0.0]])


ROWS: dict[str, Any] = {
    "own coordinates": {},
    "own rows": {"constraint": circle},
    "own numbers": {"constraint": lambda q, t: circle([float(x) for x in q], t)},
    "own slopes": {"constraint": circle, "jacobian": slopes},
}


def scene_of(kind: str, asked: list[float]) -> fmbd.Scene:
    """Four links that fall, with elements that ask functions ``of time``, by ``plain numbers`` or ``arrays``, ``of motion`` or as
    an ``own force`` of it, of the ``road``, of a ``curve`` or of their ``own coordinates``, alone and with a constraint by
    formulas, by plain numbers, or whose derivative is given.
    """
    scene, last = chain(4)
    s = [fmbd.angle(scene.joints[f"pin {k}"]) for k in range(4)]

    def noted(value: Any) -> Any:
        asked.append(0.0)
        return value

    if kind == "of time":
        scene.add(
            fmbd.effort("effort", s[0], lambda t: noted(3 * np.cos(2 * t))),
            fmbd.force("force", last, lambda t: noted((np.cos(t), 1.0)), follower=True),
            fmbd.forces.motor("motor", s[1], target=lambda t: noted(np.sin(t)), kp=30.0, kd=3.0),
            fmbd.pid("pid", s[2], target=lambda t: noted(0.3 * np.sin(t)), gains=(40.0, 10.0, 4.0)),
            fmbd.drive("drive", s[3], lambda t: noted(0.5 * (1 - np.cos(2 * t)))),
        )
    elif kind == "plain numbers":
        scene.add(
            fmbd.forces.motor("motor", s[1], target=lambda t: noted(math.sin(2 * float(t))), kp=30.0, kd=3.0),
            fmbd.drive("drive", s[3], lambda t: noted(abs(0.5 * math.sin(float(t))))),
        )
    elif kind == "arrays of time":
        for k in range(3):
            motion = lambda t: noted(np.array([np.sin(t), np.cos(t), -np.sin(t)]))  # noqa: E731
            scene.add(fmbd.drive(f"drive {k}", s[k], motion))
    elif kind == "own force":
        pull = lambda t, a, b: noted((-3.0 * b.x - 0.1 * b.v, -0.1 * b.w[0]))  # noqa: E731
        scene.add(fmbd.own_force("pull", fmbd.ground, last, pull))
    elif kind == "of motion":
        reads = {"s": s[1], "tip": fmbd.position(last)}
        scene.add(
            fmbd.joint_spring("law", s[0], law=lambda x, rate, t: noted(20 * np.sin(x) + rate)),
            fmbd.controller("pd", reads=reads, acts=s[1], law=lambda t, y, z: noted(-20 * y["s"][0] - y["tip"][1])),
        )
    elif kind.startswith("own"):
        force = lambda q, v, t: noted(np.array([np.cos(t) - q[0] ** 3 - 0.1 * v[1], -4.0 * q[1] * q[0], q[0] - 9.81]))  # noqa: E731
        scene.add(fmbd.CoordinateBody("own", np.diag([2.0, 1.0, 0.5]), force, (0.6, 0.2, 0.8), **ROWS[kind]))
    elif kind == "curve":
        height = lambda x: 0.1 * (math.cos(float(x)) - math.cos(4.0))  # noqa: E731
        law = lambda xa, Ra, xb, Rb, t: noted([xb[1] - height(xb[0])])  # noqa: E731
        scene.add(fmbd.own_joint("curve", fmbd.ground, last, law, center=(4.0, 0.0)))
    else:
        road = lambda x, t: noted(-0.29 + 0.01 * np.sin(5 * x[0] + t))  # noqa: E731
        scene.add(
            fmbd.Tyre("tyre", last, road=road, radius=0.3, stiffness=2e3, damping=10.0, up=(0.0, 1.0)),
            fmbd.joint_spring("spring", s[0], stiffness=10.0, damping=0.1),
            fmbd.forces.joint_friction("friction", s[1], coulomb=1.0, speed=0.5, viscous=0.1),
            fmbd.forces.elastic_stop("stop", s[2], lower=-0.1, upper=0.1, stiffness=1e3, damping=1.0, width=0.05),
            fmbd.gear("gear", s[2], s[3], ratio=-1.5),
        )
    return scene


def calls_a_step(scene: Callable[[], fmbd.Scene], scheme: Any, asked: list[float]) -> tuple[float, float]:
    """Calls of Python a step, and of the functions that note in ``asked``: differences of runs of 20 and 60 steps."""

    def run(steps: int) -> None:
        output = fmbd.Output(times=(0.0, steps * DT), energy=False, progress=False)
        fmbd.solve(scene(), t_end=steps * DT, dt=DT, scheme=scheme, output=output)

    run(20)
    calls, functions = [], []
    for steps in (20, 60):
        asked.clear()
        calls.append(calls_of(lambda steps=steps: run(steps)))
        functions.append(len(asked))
    return (calls[1] - calls[0]) / 40, (functions[1] - functions[0]) / 40


@pytest.mark.compiled
@pytest.mark.parametrize("kind", ["of time", "of motion", "own force", "road", "curve", "own coordinates", "own rows"])
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_calls_a_step(scheme: Any, kind: str) -> None:
    """All evaluations beside the functions' own are compiled code's."""
    asked: list[float] = []
    found, each = calls_a_step(lambda: scene_of(kind, asked), scheme, asked)
    assert found < AROUND + EACH * each


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_calls_of_functions_of_plain_numbers(scheme: Any) -> None:
    """Their rates are those of polynomials: each function is asked for its place, and seldom for more."""
    asked: list[float] = []
    found, each = calls_a_step(lambda: scene_of("plain numbers", asked), scheme, asked)
    times = getattr(scheme, "stages", 4)  # of a step at most
    assert each < 2 * (2 * times + 3)
    assert found < AROUND + EACH * each


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [fmbd.Radau(2, rtol=None), fmbd.BDF(5, rtol=None)], ids=lambda s: s.name)
def test_tangents_take_slopes_of_forces(scheme: Any) -> None:
    """A force is asked at the iterates of the stages, and for its slopes: differences asked it three times a colour."""
    asked: list[float] = []
    _, each = calls_a_step(lambda: scene_of("own force", asked), scheme, asked)
    runs = [fmbd.solve(scene_of("own force", []), t_end=k * DT, dt=DT, scheme=scheme).counters for k in (20, 60)]
    increments, tangents = ((runs[1][x] - runs[0][x]) / 40 for x in ("newton_iterations", "jacobians"))
    assert each < getattr(scheme, "stages", 1) * (increments + 1.0) + 3.0 * tangents


@pytest.mark.compiled
@pytest.mark.parametrize("kind", ["own coordinates", "of motion", "curve", "arrays of time"])
def test_usable_answers_take_few_calls(kind: str) -> None:
    """Own equations and controllers are asked at all stages in one call, joints told once in a row, arrays looked at by NumPy."""
    asked: list[float] = []
    found, each = calls_a_step(lambda: scene_of(kind, asked), fmbd.Radau(3, rtol=None), asked)
    assert found < AROUND + USABLE * each


@pytest.mark.compiled
@pytest.mark.parametrize(("scheme", "most"), [(fmbd.Radau(3, rtol=None), 19.0), (fmbd.BDF(5, rtol=None), 30.0)])
def test_calls_of_a_law_with_a_memory(scheme: Any, most: float) -> None:
    """Its equations at the points of a step are solved with few calls beside those of the law: they were 24 and 46 an answer."""
    asked: list[float] = []

    def scene() -> fmbd.Scene:
        scene, _ = chain(4)
        law = lambda t, y, z: (asked.append(0.0), ((-20 * y["s"][0] - 5 * z[0],), (y["s"][0] - z[0],)))[1]  # noqa: E731
        s = fmbd.angle(scene.joints["pin 1"])
        scene.add(fmbd.controller("pi", reads={"s": s}, acts=s, law=law, memory=(0.0,)))
        return scene

    found, each = calls_a_step(scene, scheme, asked)
    assert found < AROUND + most * each


@pytest.mark.compiled
def test_laws_are_asked_once_for_all_stages() -> None:
    """Of an increment, with arrays of all elements and times, and one of them alone beside; the end of the step asks anew."""
    asked: list[float] = []

    def scene() -> fmbd.Scene:
        scene, _ = chain(8)
        law = lambda x, rate, t: (asked.append(0.0), 20 * np.sin(x) + rate * np.cos(t))[1]  # noqa: E731
        scene.add(*(fmbd.joint_spring(f"law {name}", fmbd.angle(pin), law=law) for name, pin in scene.joints.items()))
        return scene

    scheme = fmbd.Radau(5, rtol=None)
    found, each = calls_a_step(scene, scheme, asked)
    runs = [fmbd.solve(scene(), t_end=k * DT, dt=DT, scheme=scheme).counters for k in (20, 60)]
    increments, tangents = ((runs[1][x] - runs[0][x]) / 40 for x in ("newton_iterations", "jacobians"))
    assert each < 2 * (increments + 2.0) + 4.0 * tangents
    assert found < AROUND + 8.0 * each


@pytest.mark.compiled
def test_forces_are_asked_together_at_all_stages() -> None:
    """Each point costs the call of the law with what is checked of its answer, all else is one call for them."""
    asked: list[float] = []
    found, each = calls_a_step(lambda: scene_of("own force", asked), fmbd.Radau(7, rtol=None), asked)
    assert found < AROUND + 16.0 * each


@pytest.mark.compiled
def test_joints_that_do_not_read_the_time_are_not_asked_at_others() -> None:
    """Whether one depends on time cost two calls of it wherever its rows were asked for."""
    asked: list[float] = []

    def off(x: Any) -> float:
        asked.append(0.0)
        return float(x[1]) - 0.1 * (math.cos(float(x[0])) - math.cos(4.0))

    still, moving = (lambda xa, Ra, xb, Rb, t: off(xb), lambda xa, Ra, xb, Rb, t: off(xb) + 0.0 * t)
    assert [reads(law, 4) for law in (still, moving, max, lambda *given: given[4])] == [False, True, True, True]
    assert reads(lambda xa, Ra, xb, Rb, t: locals()["t"], 4)
    assert reads(lambda xa, Ra, xb, Rb, t: [t for _ in xa] and (lambda: t), 4)

    def scene(law: Any) -> fmbd.Scene:
        scene, last = chain(4)
        scene.add(fmbd.own_joint("curve", fmbd.ground, last, law, center=(4.0, 0.0)))
        return scene

    scheme = fmbd.Radau(7, rtol=None)
    each = [calls_a_step(lambda law=law: scene(law), scheme, asked)[1] for law in (still, moving)]
    assert each[0] < 0.85 * each[1]


def test_a_function_is_asked_by_one_call_more() -> None:
    """Usual answers pass at a glance: of a motion, a law, and a joint by a function of numbers, once they are known."""
    motion = smooth_motion("drive", lambda t: 0.5 * float(t))
    law = Repeatable("The law of spring", "spring", lambda s, rate, t: 2.0 * s)
    joint = AskedFunction("cam", lambda xa, Ra, xb, Rb, t: [xb[1] - float(xb[0])], motions(2), (1,), 1.0)
    poses = np.zeros((2, 2)), np.stack([np.eye(2)] * 2)
    asks = [lambda: motion.place(0.5), lambda: law.number(0.1, 0.0, 0.5), lambda: joint.at(poses, 0.5)]
    assert joint.count == 1
    for ask in asks:
        ask()
    assert [calls_of(ask) for ask in asks] == [3, 2, 2]  # with the function itself, and the motion's place


def links_of_hardly_any_mass() -> fmbd.Scene:
    """Heavy links behind light ones."""
    scene, last = fmbd.Scene("light", gravity=(0.0, -9.81)), fmbd.ground
    for k in range(6):
        mass = (1.0, 1e-9)[k % 2]
        link = fmbd.RigidBody(f"link {k}", mass, mass / 12, (k + 0.5, 0.0))
        scene.add(link, fmbd.revolute(f"pin {k}", last, link, center=(k, 0.0)))
        last = link
    return scene


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_calls_beside_bodies_of_hardly_any_mass(scheme: Any) -> None:
    """The rows of their joints look alike in the metric of masses, and do not depend on each other."""
    found, _ = calls_a_step(links_of_hardly_any_mass, scheme, [])
    assert found < LOOKS


def sampled(every: float, count: int = 4) -> fmbd.Scene:
    """Four links with controllers in the first hinges, of this period (s)."""
    scene, _ = chain(4)
    for name, pin in list(scene.joints.items())[:count]:
        scene.add(fmbd.pid(f"pid {name}", fmbd.angle(pin), target=0.3, gains=(40.0, 10.0, 4.0), every=every))
    return scene


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_calls_of_a_sample(scheme: Any) -> None:
    """A sample is taken between calls of compiled code; its efforts are read there without one, and the new start is one."""
    found, _ = calls_a_step(lambda: sampled(DT), scheme, [])
    assert found < SAMPLE


@pytest.mark.compiled
def test_calls_of_a_sample_on_an_elastic_body(rod_mesh: Callable[..., Any]) -> None:
    """Compiled code makes the new start behind a sample: NumPy evaluated ten states for it, by 3 800 calls."""

    def run(steps: int) -> None:
        body = fmbd.FloatingBody("rod", rod_mesh(dim=2, h=0.5), density=1000.0, elastic=plane_stress(1e8, 0.3))
        pin = fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0.0, 0.0))
        pid = fmbd.pid("pid", fmbd.angle(pin), target=0.3, gains=(40.0, 10.0, 4.0), every=DT)
        scene = fmbd.Scene("rod", gravity=(0.0, -9.81))
        scene.add(body, pin, pid)
        output = fmbd.Output(times=(0.0, steps * DT), energy=False, progress=False)
        fmbd.solve(scene, t_end=steps * DT, dt=DT, scheme=fmbd.GeneralizedAlpha(), output=output)

    run(5)
    few, many = (calls_of(lambda n=n: run(n)) for n in (5, 15))
    assert (many - few) / 10 < ON_FIELDS


@pytest.mark.compiled
@pytest.mark.parametrize("period", [1, 20])
@pytest.mark.parametrize("scheme", [x for x in SCHEMES if not isinstance(x, fmbd.BDF)], ids=lambda s: s.name)
def test_calls_of_a_sample_between_recorded_steps(scheme: Any, period: int) -> None:
    """Compiled code makes the step to a sample with those before, and records its end behind the sample."""

    def run(samples: int) -> None:
        output = fmbd.Output(progress=False)
        fmbd.solve(sampled(period * DT, 1), t_end=samples * period * DT, dt=DT, scheme=scheme, output=output)

    run(3)
    few, many = (calls_of(lambda n=n: run(n)) for n in (3, 13))
    assert (many - few) / 10 < RECORDED


@pytest.mark.compiled
@pytest.mark.parametrize(("scheme", "every"), [(SCHEMES[0], None), (SCHEMES[2], 20 * DT)])
def test_calls_of_recorded_efforts(scheme: Any, every: float | None) -> None:
    """Records have the efforts of controllers, of several coordinates too: no state is read on its own."""

    def run(steps: int, sensors: int, *, alone: bool = False) -> fmbd.Run:
        scene, _ = chain(4)
        s = [fmbd.angle(scene.joints[f"pin {k}"]) for k in range(4)]
        law = lambda t, y, z: ((-20 * y["s"][0] + z[0], np.sin(5 * t)), (1.0 - z[0],))  # noqa: E731
        two = fmbd.controller("two", reads={"s": s[0]}, acts=s[:2], law=law, memory=(0.0,), every=every)
        scene.add(two, fmbd.pid("pid", s[2], target=0.3, gains=(40.0, 10.0, 4.0), every=every))
        kinds = (fmbd.element_effort, fmbd.element_power, fmbd.elongation)[:sensors]
        for name, kind in itertools.product(("two", "pid"), kinds):
            scene.sensor(f"{kind.__name__} {name}", kind(name))
        output = fmbd.Output(progress=False, ledger=alone)
        return fmbd.solve(scene, t_end=steps * DT, dt=DT, scheme=scheme, output=output)

    run(20, 3)
    found = [calls_of(lambda n=n, k=k: run(n, k)) for n in (20, 40) for k in (0, 3)]
    assert found[3] - found[1] < found[2] - found[0] + 20 * AROUND
    told, read = run(40, 3), run(40, 3, alone=True)
    assert told["element_effort two"].shape == (41, 2)
    assert all(x == pytest.approx(read[name], rel=1e-12, abs=1e-12) for name, x in told.series.items())


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", OWN, ids=lambda s: s.name)
def test_calls_of_own_steps_between_samples(scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled code makes all but those that end with a sample, as Python makes them."""

    def run(t_end: float) -> fmbd.Run:
        output = fmbd.Output(times=(0.0, t_end), energy=False, progress=False)
        return fmbd.solve(sampled(0.2, 1), t_end=t_end, scheme=scheme, output=output)

    ends = run(0.2), run(1.0)
    short, long = (calls_of(lambda t=t: run(t)) for t in (0.2, 1.0))
    assert (long - short) / (ends[1].counters["steps"] - ends[0].counters["steps"]) < BETWEEN
    monkeypatch.setattr(OwnMarch, "_chooses_alike", False)
    alone = run(1.0)
    assert alone.counters["steps"] == ends[1].counters["steps"]
    assert ends[1].state.q == pytest.approx(alone.state.q, rel=1e-9, abs=1e-9)


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [*OWN, fmbd.GeneralizedAlpha(rtol=1e-5)], ids=lambda s: s.name)
def test_calls_of_own_steps_with_events(scheme: Any) -> None:
    """Steps are looked into for crossings many at a time."""

    def run(t_end: float) -> fmbd.Run:
        scene, last = chain(4)
        scene.sensor("tip", fmbd.position(last))
        event = fmbd.Event("tip y", 1e3)
        output = fmbd.Output(times=(0.0, t_end), energy=False, progress=False, events=[event])
        return fmbd.solve(scene, t_end=t_end, scheme=scheme, output=output)

    ends = run(0.2), run(1.5)
    short, long = (calls_of(lambda t=t: run(t)) for t in (0.2, 1.5))
    assert (long - short) / (ends[1].counters["steps"] - ends[0].counters["steps"]) < BETWEEN


def nut(t_end: float, scheme: Any) -> fmbd.Run:
    """A nut that runs along its screw, a kilometre away from the origin."""
    spin, lead, place = 2000.0, 0.02, (0.0, 0.0, 1e3)
    speed = (0.0, 0.0, spin * lead / (2 * np.pi))
    body = fmbd.RigidBody("nut", 2.0, (2e-4, 2e-4, 1e-4), place, velocity=speed, angular_velocity=(0.0, 0.0, spin))
    thread = fmbd.cylindrical("thread", fmbd.ground, body, center=place, axis=(0, 0, 1))
    scene = fmbd.Scene("screw", gravity=(0, 0, -9.81))
    scene.add(body, thread, fmbd.screw("screw", thread, lead=lead))
    return fmbd.solve(scene, t_end=t_end, scheme=scheme, output=fmbd.Output(times=(0.0, t_end), progress=False))


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [*OWN, fmbd.ExplicitRungeKutta(1e-6)], ids=lambda s: s.name)
def test_calls_far_from_the_origin(scheme: Any) -> None:
    """Joints close there but for a roundoff above the share of the length that compiled code waited for: 400 to 550 calls."""
    ends = nut(0.1, scheme), nut(0.4, scheme)
    short, long = (calls_of(lambda t=t: nut(t, scheme)) for t in (0.1, 0.4))
    assert (long - short) / (ends[1].counters["steps"] - ends[0].counters["steps"]) < AROUND


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", OWN, ids=lambda s: s.name)
def test_the_function_of_a_joint_is_asked_once_for_a_state(scheme: Any) -> None:
    """Half of the calls had the arguments of one before; a record asks for rows alone while it closes places."""
    asked: list[tuple[bytes | float, ...]] = []

    def curve(xa: Any, Ra: Any, xb: Any, Rb: Any, t: float) -> list[float]:
        asked.append((xb.tobytes(), Rb.tobytes(), t))
        return [xb[1] - 0.1 * (math.cos(float(xb[0])) - math.cos(4.0))]

    counts = []
    for times in ((0.0, 0.1), np.linspace(0.0, 0.1, 51)):
        asked.clear()
        scene, last = chain(4)
        scene.add(fmbd.own_joint("curve", fmbd.ground, last, curve, center=(4.0, 0.0)))
        fmbd.solve(
            scene, t_end=0.1, scheme=scheme, output=fmbd.Output(times=tuple(times), energy=False, progress=False)
        )
        assert len(asked) < 1.2 * len(set(asked))
        counts.append(len(asked))
    assert counts[1] - counts[0] < 30 * 50  # some three corrections of seven values


def test_the_function_of_a_joint_is_asked_anew_behind_a_restored_state() -> None:
    """It may read what someone has changed meanwhile: the same arguments are no reason to take the answer of before."""
    height = 0.0
    scene, last = chain(2)
    law = lambda xa, Ra, xb, Rb, t: [xb[1] - height * float(t)]  # noqa: E731
    scene.add(fmbd.own_joint("lift", fmbd.ground, last, law, center=(2.0, 0.0)))
    scene.sensor("end", fmbd.position(last, point=(2.0, 0.0)))
    with fmbd.stepper(scene, dt=1e-3) as s:
        kept = s.save()
        for height in (0.0, 0.1, 0.2):  # noqa: B007
            s.restore(kept)
            s.step()
            assert s["end"][1] == pytest.approx(height * 1e-3, abs=1e-9)
