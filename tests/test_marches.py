"""Many steps in one call of C: those that are made in turn, to the last bit, with the same counts and the same words."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_driver import joint_springs, suspended
from test_steps_one_by_one import driven_rod, named
from tolerance_scenes import swinging_rod

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import FmbdError
from fmbd_fenicsx.run import compiled_calls, single_run
from fmbd_fenicsx.run.loads_ahead import LOOKED_AT
from fmbd_fenicsx.schemes.marching import MarchingStepper
from fmbd_fenicsx.schemes.onestep import explicit_limit
from fmbd_fenicsx.system.compiled.march import March

IMPLICIT = [
    fmbd.Radau(rtol=None),
    fmbd.Radau(stages=2, rtol=None),
    fmbd.BDF(order=2, rtol=None),
    fmbd.BDF(order=5, rtol=None),
]
SCHEMES = [
    fmbd.Rattle(),
    fmbd.EnergyMomentum(),
    fmbd.ExplicitRungeKutta(rtol=None),
    fmbd.HalfExplicit(rtol=None),
    *IMPLICIT,
]
OTHER_FORMS = [
    fmbd.Radau(form=fmbd.Index3(), rtol=None),
    fmbd.Radau(form=fmbd.Baumgarte(), rtol=None),
    fmbd.Radau(form=fmbd.Overdetermined(), rtol=None),
    fmbd.BDF(order=1, form=fmbd.Index2(), rtol=None),
    fmbd.BDF(order=2, form=fmbd.StateSpace(), rtol=None),
]
STATE = ("t", "q", "v", "a", "lam")


def in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """No steps are made by marches from now on; each by itself, as Python makes them."""
    monkeypatch.setattr(MarchingStepper, "stride", lambda self, h: 0.0)


def both(monkeypatch: pytest.MonkeyPatch, run: Any) -> list[Any]:
    """What a run gives by marches, and with steps made in turn."""
    found = [run()]
    with monkeypatch.context() as patch:
        in_turn(patch)
        found.append(run())
    return found


def hanging(law: Any, *, mass: float = 1.0) -> fmbd.Scene:
    """An arm on a hinge with a law of the angle."""
    scene = fmbd.Scene("arm", gravity=(0.0, -9.81))
    arm = fmbd.RigidBody("arm", mass, 0.1, (0.5, 0.0))
    hinge = fmbd.revolute("hinge", fmbd.ground, arm, center=(0, 0))
    scene.add(arm, hinge, fmbd.joint_spring("law", fmbd.angle(hinge), law=law))
    return scene


def remembering(element: Any) -> fmbd.Scene:
    """An arm on a hinge with an element on its angle that has a memory."""
    scene = hanging(lambda s, rate, t: 0.1 * rate)
    scene.add(element(fmbd.angle(scene.joints["hinge"])))
    return scene


def controlled(angle: Any, every: float | None = None) -> Any:
    """A controller that takes up what its angle misses; sampled or not."""

    def law(t: float, y: Any, z: Any) -> Any:
        miss = 0.3 - y["phi"]
        return 8.0 * miss + 20.0 * z[:1], miss if every is None else z + every * miss

    return fmbd.controller("control", reads={"phi": angle}, acts=angle, law=law, memory=(0.0,), every=every)


REMEMBERING = {
    "pid": lambda angle: fmbd.pid("pid", angle, target=lambda t: 0.3 * np.sin(4 * t), gains=(30.0, 50.0, 1.0)),
    "dry friction": lambda angle: fmbd.dry_friction("dry", angle, limit=1.0, stick=1e3, damping=1.0),
    "controller": controlled,
    "sampled": lambda angle: controlled(angle, 0.02),
}


def redundant() -> fmbd.Scene:
    """A door on two hinges."""
    scene = fmbd.Scene("door", gravity=(0, -9.81, 1.0))
    door = fmbd.RigidBody("door", 2.0, (0.1, 0.2, 0.3), (0.4, 0.0, 1.0))
    scene.add(door)
    for k in (0.0, 2.0):
        scene.add(fmbd.revolute(f"hinge {k:g}", fmbd.ground, door, center=(0, 0, k), axis=(0, 0, 1)))
    return scene


def wheeled() -> fmbd.Scene:
    """A wheel that stays on a road which Python gives."""
    scene = fmbd.Scene("wheel", gravity=(0.0, -9.81))
    wheel = fmbd.RigidBody("wheel", 2.0, 0.1, (0.0, 0.29), velocity=(1.0, 0.0))
    road = lambda x, t: 2e-3 * np.sin(5.0 * x[0])  # noqa: E731
    scene.add(wheel, fmbd.Tyre("tyre", wheel, road=road, radius=0.3, stiffness=2e3, damping=20.0, up=(0.0, 1.0)))
    return scene


@pytest.fixture
def marches(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many steps each march has made."""
    made: list[int] = []
    steps = March.steps
    noted = lambda self, *x, **y: (found := steps(self, *x, **y), made.append(found[0]))[0]  # noqa: E731
    monkeypatch.setattr(March, "steps", noted)
    return made


MAKERS = {
    "plane": lambda: joint_springs(2),
    "space": lambda: joint_springs(3),
    "no joints": lambda: suspended(3),
    "driven": lambda: driven_rod(2),
    "law": lambda: hanging(lambda s, rate, t: 3.0 * s**3 + 0.1 * rate + np.sin(t)),
    "damped": lambda: hanging(lambda s, rate, t: 40.0 * rate, mass=0.2),
    "redundant": redundant,
    "tyre": wheeled,
    **{name: lambda element=element: remembering(element) for name, element in REMEMBERING.items()},
}


@pytest.mark.compiled
@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize("scheme", SCHEMES, ids=named)
def test_marches_are_steps_made_in_turn(
    scheme: Any, name: str, marches: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """120 steps, between which explicit schemes look at stability twice."""
    monkeypatch.setattr(explicit_limit, "AT_MOST", 1.0)
    output = fmbd.Output(every=120, progress=False)
    once, turn = both(
        monkeypatch, lambda: fmbd.solve(MAKERS[name](), t_end=0.12, dt=1e-3, scheme=scheme, output=output)
    )

    assert max(marches) > (10 if name == "sampled" else 30)
    roundoff = 1e-12 if name in REMEMBERING else 0.0  # the memory of steps that are made in turn is NumPy's
    for x in STATE:
        found, wanted = getattr(once.state, x), getattr(turn.state, x)
        assert np.abs(found - wanted).max(initial=0.0) <= roundoff * np.abs(wanted).max(initial=0.0), x
    assert once.counters == turn.counters
    assert once.drift == pytest.approx(turn.drift, rel=0.0, abs=1e-15 if name in REMEMBERING else 0.0)
    assert once.newton_accuracy == pytest.approx(turn.newton_accuracy, rel=1e-9)


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["plane", "space", "law", "driven"])
def test_marches_of_energy_momentum_foretell_as_python_does(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where an iteration begins and ends: as many increments as steps that Python prepares, and the same states to roundoff."""
    run = lambda: fmbd.solve(MAKERS[name](), t_end=0.06, dt=1e-3, scheme=fmbd.EnergyMomentum())  # noqa: E731
    once = run()
    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)
    turn = run()
    assert once.counters["newton_iterations"] == turn.counters["newton_iterations"]
    for x in ("q", "v", "a", "lam"):
        wanted = getattr(turn.state, x)
        assert getattr(once.state, x) == pytest.approx(
            wanted, rel=1e-8, abs=1e-9 * max(1.0, np.abs(wanted).max(initial=0.0))
        ), x


@pytest.mark.compiled
@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize("scheme", [*IMPLICIT, *OTHER_FORMS], ids=named)
def test_marches_of_implicit_schemes_are_steps_in_parts(
    scheme: Any, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same increments, tangents, factors and solves; the same states to roundoff. Marches cross kinks by others."""
    run = lambda: fmbd.solve(MAKERS[name](), t_end=0.06, dt=1e-3, scheme=scheme)  # noqa: E731
    once = run()
    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)
    turn = run()
    kinked = name == "dry friction"
    assert kinked or once.counters == turn.counters
    for x in ("q", "v", "a", "lam"):
        wanted, size = getattr(turn.state, x), 1e-7 if kinked else 1e-8
        assert getattr(once.state, x) == pytest.approx(
            wanted, rel=size, abs=0.1 * size * max(1.0, np.abs(wanted).max(initial=0.0))
        ), x
    assert once.state.q == pytest.approx(turn.state.q, rel=1e-8 if kinked else 1e-11, abs=1e-9 if kinked else 1e-12)


# by a frequency that no stage shares, which Python solves for with every increment
FILTERED = fmbd.Radau(stages=2, rtol=1e-5)
OWN = [
    fmbd.Radau(),
    fmbd.Radau(stages=5, rtol=1e-8),
    fmbd.Radau(form=fmbd.Index3()),
    fmbd.Radau(rtol=1e-3),
    FILTERED,
    fmbd.BDF(),
    fmbd.BDF(order=2, rtol=1e-4),
    fmbd.BDF(form=fmbd.Index2(), rtol=1e-8),
    fmbd.BDF(form=fmbd.Index3(), rtol=1e-3),
    fmbd.Radau(form=fmbd.StateSpace()),
    fmbd.Radau(form=fmbd.Projected()),
    fmbd.BDF(form=fmbd.Overdetermined()),
    fmbd.BDF(form=fmbd.Index1()),
    fmbd.HalfExplicit(rtol=1e-4),
    fmbd.ExplicitRungeKutta(rtol=1e-5),
]


def told(scheme: Any) -> str:
    """A scheme with its tolerance, for the names of tests."""
    return f"{scheme.name} {scheme.rtol:g}"


def rod_and_mass() -> fmbd.Scene:
    """A bent rod on a hinge, with a mass at its end."""
    scene = fmbd.Scene("rod", gravity=(0.0, 1.0, -9.81))
    section = fmbd.RodSection.rectangle(youngs_modulus=1e7, poisson_ratio=0.3, density=2e3, width=0.02, height=0.03)
    rod = fmbd.Rod("rod", [(0, 0, 0), (0.5, 0.1, 0), (1, 0, 0)], section, elements=3, damping=1e-3)
    mass = fmbd.RigidBody("mass", 1.0, np.diag([0.01, 0.01, 0.02]), (1.0, 0.0, 0.0))
    scene.add(rod, mass, fmbd.fixed("clamp", rod.surface("end"), mass, center=(1, 0, 0)))
    scene.add(fmbd.revolute("hinge", fmbd.ground, rod.surface("start"), center=(0, 0, 0), axis=(0, 1, 0)))
    return scene


OWN_MAKERS = {**MAKERS, "rod": rod_and_mass}
del OWN_MAKERS["sampled"]  # samples are taken between steps


EXPLICIT = {told(scheme) for scheme in OWN[-2:]}
# NumPy solves rows that depend where Python frees errors of them, whose factors are no stages'; roundoff ends stages
OF_PARTS = {"core_factorisations", "worst_linear_residual", "solves"}


def counted(scheme: Any, run: fmbd.Run) -> dict[str, float]:
    """Work that steps of compiled code and of Python have in common."""
    left_out = OF_PARTS if told(scheme) in EXPLICIT else {"solves"} if scheme == FILTERED else set()
    return {name: count for name, count in run.counters.items() if name not in left_out}


# errors of 1e-8 of these two are roundoff of stiff forces: Python's own times differ by 3e-5 with a weight that differs by 8e-15
ROUGH = [
    (told(OWN[1]), "rod"),
    (told(OWN[1]), "dry friction"),
    # corrections of accelerations along rows that depend are roundoff, whose rates end iterations
    (told(fmbd.BDF(form=fmbd.Overdetermined())), "redundant"),
    # marches cross the kinks of friction by other increments, which are below these tolerances
    (told(OWN[6]), "dry friction"),
    # Python takes 100 or 102 steps across kinks as the tolerance is larger by 1e-15 of it
    (told(OWN[7]), "dry friction"),
    (told(OWN[8]), "dry friction"),
]
OWN_PAIRS = [
    pytest.param(scheme, name, id=f"{told(scheme)}-{name}")
    for scheme in OWN
    for name in OWN_MAKERS
    if (told(scheme), name) not in ROUGH and not (told(scheme) in EXPLICIT and name == "rod")  # too stiff for these
]


@pytest.mark.compiled
@pytest.mark.parametrize(("scheme", "name"), OWN_PAIRS)
def test_own_steps_that_march_are_those_of_python(
    scheme: Any, name: str, marches: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sizes, errors, rejections, increments, tangents, factors; states to roundoff, at the end and where they are recorded."""

    end = 0.15 if name == "rod" else 0.25  # whose steps are short

    def run(times: Any) -> fmbd.Run:
        scene = OWN_MAKERS[name]()
        scene.sensor("speed", fmbd.sensors.velocity(list(scene.bodies.values())[-1]))
        return fmbd.solve(scene, t_end=end, scheme=scheme, output=fmbd.Output(times=times, progress=False))

    asked = None, np.linspace(0.0, end, 12)
    once = [run(times) for times in asked]
    assert sum(marches) > 0.4 * sum(x.counters["steps"] for x in once)
    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)
    roundoff = 1e-5 if name == "rod" else 1e-6
    for found, times in zip(once, asked, strict=True):
        turn = run(times)
        assert counted(scheme, found) == counted(scheme, turn)
        assert found.times == pytest.approx(turn.times, rel=roundoff)
        assert found.local_error == pytest.approx(turn.local_error, rel=1e-5)
        assert found.drift == pytest.approx(turn.drift, rel=1e-3, abs=1e-9)
        size = np.abs(turn["speed"]).max()
        assert found["speed"] == pytest.approx(turn["speed"], rel=1e-6, abs=1e-7 * size)
        for x in ("q", "v", "a", "lam"):
            wanted = getattr(turn.state, x)
            most = max(1.0, np.abs(wanted).max(initial=0.0))
            assert getattr(found.state, x) == pytest.approx(wanted, rel=1e-7, abs=1e-8 * most), x


@pytest.mark.compiled
def test_explicit_steps_weigh_what_bends_rods_apart(marches: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    """As implicit ones: the same sizes to the roundoff of stiff forces, which does not hide errors as long as these are large."""
    run = lambda: fmbd.solve(rod_and_mass(), t_end=3e-3, scheme=fmbd.HalfExplicit(rtol=1e-4))  # noqa: E731
    once = run()
    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)
    turn = run()
    assert sum(marches) > 20 and once.counters["steps"] == turn.counters["steps"]
    assert once.times == pytest.approx(turn.times, rel=1e-8)


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("scheme", "most"),
    [(fmbd.BDF(order=2, rtol=None), 2), (fmbd.Radau(rtol=None), 5), (fmbd.BDF(), 2), (fmbd.Radau(), 6)],
)
def test_laws_of_time_are_asked_once_a_point(scheme: Any, most: int) -> None:
    """Not at every increment; besides where a tangent is taken, where an error looks back, and once ahead of own steps."""
    asked: list[float] = []
    scene = hanging(lambda s, rate, t: 2.0 * s**3)
    motor = fmbd.effort(
        "motor", fmbd.angle(scene.joints["hinge"]), lambda t: (asked.append(t), 5.0 * np.sin(40.0 * t))[1]
    )
    scene.add(motor)
    dt = None if scheme.rtol else 5e-3
    run = fmbd.solve(scene, t_end=0.5, dt=dt, scheme=scheme, output=fmbd.Output(every=1000, progress=False))
    steps = run.counters["steps"] + run.counters["rejections"]
    assert run.counters["newton_iterations"] > 1.5 * steps
    ahead = LOOKED_AT + 1 if scheme.rtol else 0
    assert ahead < len(asked) < most * steps + ahead + 30


@pytest.mark.compiled
@pytest.mark.parametrize(
    "scheme",
    [fmbd.GeneralizedAlpha(0.9), *SCHEMES, fmbd.BDF(), fmbd.Radau(), fmbd.HalfExplicit()],
    ids=lambda s: f"{s.name} {getattr(s, 'rtol', None)}",
)
def test_functions_of_time_are_asked_once_for_each_time(scheme: Any) -> None:
    """A step begins where the last one ended, and comes back to times within it; of motions place and rates are one answer."""

    def asked(t_end: float) -> dict[str, list[float]]:
        every: dict[str, list[float]] = {"force": [], "motion": [], "gravity": []}

        def told(name: str, value: Any) -> Any:
            return lambda t: (every[name].append(t), value(t))[1]

        arm = fmbd.RigidBody("arm", 1.0, 0.1, (0.5, 0.0))
        end = fmbd.RigidBody("end", 1.0, 0.1, (1.5, 0.0))
        scene = fmbd.Scene("arms", gravity=told("gravity", lambda t: (0.0, -9.81 - np.sin(t))))
        hinge = fmbd.revolute("hinge", fmbd.ground, arm, center=(0, 0))
        scene.add(arm, end, hinge, fmbd.revolute("elbow", arm, end, center=(1, 0)))
        scene.add(fmbd.force("force", end, told("force", lambda t: (np.sin(3 * t), 0.0))))
        turning = told("motion", lambda t: (0.1 * np.sin(t), 0.1 * np.cos(t), -0.1 * np.sin(t)))
        scene.add(fmbd.drive("motion", fmbd.angle(hinge), turning))
        output = fmbd.Output(every=1000, progress=False)
        fmbd.solve(scene, t_end=t_end, dt=5e-3, scheme=scheme, output=output)
        return every

    few, many = asked(0.5), asked(1.0)
    for name in few:
        times = len(set(many[name])) - len(set(few[name]))
        assert times > 50
        assert len(many[name]) - len(few[name]) < 1.15 * times + 10, name


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [fmbd.GeneralizedAlpha(0.9), *SCHEMES], ids=lambda s: s.name)
def test_what_is_set_between_two_steps_acts_at_once(scheme: Any) -> None:
    """The second step begins at the time at which the first one ended, with another force."""
    scene = fmbd.Scene("mass")
    push, mass = scene.input("push", 1.0), fmbd.RigidBody("mass", 1.0, 0.1)
    scene.add(mass, fmbd.prismatic("way", fmbd.ground, mass, axis=(1, 0)))
    scene.add(fmbd.force("push", mass, lambda t: (push(t), 0.0)))
    scene.sensor("speed", fmbd.velocity(mass))
    stepper = fmbd.stepper(scene, dt=0.01, scheme=scheme)
    for force in (1.0, 1.0, 3.0, 3.0):
        stepper.set("push", force)
        stepper.step()
    assert stepper["speed"][0] == pytest.approx(0.08, rel=1e-9)


LOADS = {
    "kick": lambda s, rate, t: 0.1 * rate - 200.0 * np.exp(-(((t - 0.1) / 0.004) ** 2)),
    "stop": lambda s, rate, t: 0.1 * rate + 3e4 * min(s + 0.3, 0.0),
}


@pytest.mark.compiled
@pytest.mark.parametrize("name", LOADS)
@pytest.mark.parametrize("scheme", [fmbd.BDF(), fmbd.BDF(rtol=1e-3), fmbd.Radau()], ids=told)
def test_steps_that_their_error_refuses_stay_in_compiled_code(
    scheme: Any, name: str, marches: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As often refused as by Python, with the sizes and orders that follow, and no step by Python but the first, and one whose
    iteration fails. Beside a stop, whose kink marches cross by other increments, within the tolerance.
    """
    run = lambda: fmbd.solve(hanging(LOADS[name]), t_end=0.25, scheme=scheme)  # noqa: E731
    once = run()
    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)
    turn = run()
    assert turn.counters["rejected: error estimate"] > 4
    kinked = name == "stop"
    assert kinked or once.counters == turn.counters
    failed = once.counters["rejections"] - once.counters["rejected: error estimate"]
    assert sum(marches) == once.counters["steps"] - 1 - failed
    assert once.state.q == pytest.approx(turn.state.q, rel=1e-9, abs=scheme.rtol if kinked else 1e-10)


@pytest.mark.compiled
def test_steps_whose_iteration_fails_are_made_smaller_in_compiled_code(marches: list[int]) -> None:
    """Those of a rod that swings were made by NumPy, each in the time of fifty."""
    run = fmbd.solve(swinging_rod(2), t_end=0.6, scheme=fmbd.Radau(5, rtol=1e-4))
    assert run.counters["rejections"] - run.counters["rejected: error estimate"] > 2
    assert sum(marches) == run.counters["steps"] - 1  # the first
    fine = fmbd.solve(swinging_rod(2), t_end=0.6, scheme=fmbd.Radau(3, rtol=1e-6))
    assert run["tip"][-1] == pytest.approx(fine["tip"][-1], abs=1e-4)


@pytest.mark.compiled
@pytest.mark.parametrize("largest", [0.002, 0.02])
@pytest.mark.parametrize("scheme", [fmbd.BDF(), fmbd.Radau(), fmbd.HalfExplicit()], ids=told)
def test_a_largest_step_is_kept_within_a_call(
    scheme: Any, largest: float, marches: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that is below most steps, and one that a few reach: the steps of Python, many in each call."""
    run = lambda: fmbd.solve(joint_springs(3), t_end=0.5, dt=largest, scheme=scheme)  # noqa: E731
    once, calls = run(), len(marches)
    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)
    turn = run()
    assert np.diff(turn.times).max() <= largest * (1 + 1e-12)
    assert once.counters["steps"] == turn.counters["steps"]
    assert isinstance(scheme, fmbd.HalfExplicit) or once.counters == turn.counters
    assert once.times == pytest.approx(turn.times, rel=1e-6)
    assert once.state.q == pytest.approx(turn.state.q, rel=1e-8, abs=1e-9)
    assert calls < 0.1 * turn.counters["steps"]


@pytest.mark.compiled
@pytest.mark.parametrize("times", [None, np.linspace(0.0, 0.5, 101)], ids=["ends", "instants"])
def test_calls_go_on_where_steps_have_grown(times: Any, marches: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    """They ended where as many steps as were counted would have, had none grown: now by number alone, and by the clock."""
    monkeypatch.setattr(compiled_calls, "CHUNK", np.inf)
    made = fmbd.Output(times=times, progress=False)
    run = fmbd.solve(joint_springs(3), t_end=0.5, scheme=fmbd.Radau(3, rtol=1e-9), output=made)
    assert marches == [63, 192, run.counters["steps"] - 256]


@pytest.mark.parametrize("shown", [None, lambda now: None], ids=["many in a call", "one by one"])
@pytest.mark.parametrize(
    "scheme",
    [
        fmbd.Radau(3, rtol=1e-3),
        fmbd.Radau(2, rtol=1e-3),
        fmbd.BDF(rtol=1e-3),
        fmbd.HalfExplicit(1e-3),
        fmbd.ExplicitRungeKutta(1e-3),
    ],
    ids=told,
)
def test_neither_roundoff_nor_half_of_the_largest_step_is_a_step(scheme: Any, shown: Any) -> None:
    """What 400 steps of 5 ms left of 2 s was one more, of 2e-14 s: Radau told a reaction of 208 N in place of 2.8 N behind it.
    And BDF made twice as many: sizes just below the largest were halved, as on the last way to the end.
    """
    scene = fmbd.Scene("pendulum", gravity=(0, -9.81))
    arm = fmbd.RigidBody("arm", 1.0, 0.1, (0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
    scene.add(arm, pin)
    scene.sensor("force", fmbd.reaction(pin))

    run = fmbd.solve(scene, t_end=2.0, dt=5e-3, scheme=scheme, output=fmbd.Output(on_step=shown))
    sizes = np.diff(run.times)[20:]
    assert sizes.min() > 0.51 * 5e-3 and len(sizes) <= 390
    assert run["force"][-1, 1] == pytest.approx(run["force"][-2, 1], rel=1e-2)


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [fmbd.Radau(3, rtol=1e-6), fmbd.BDF(rtol=1e-6), fmbd.HalfExplicit(1e-6)], ids=told)
def test_a_call_behind_a_load_that_came_knows_where_the_next_step_has_to_end(scheme: Any) -> None:
    """It took each largest step for a way to the end: 345 steps of the half-explicit method, one by one 302."""
    scene = fmbd.Scene("knocked pendulum", gravity=(0, -9.81))
    arm = fmbd.RigidBody("arm", 1.0, 0.1, (0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
    scene.add(arm, pin, fmbd.effort("knock", fmbd.angle(pin), lambda t: 5.0 * np.exp(-(((t - 1.0) / 0.02) ** 2))))
    runs = [
        fmbd.solve(scene, t_end=1.5, dt=5e-3, scheme=scheme, output=fmbd.Output(on_step=shown))
        for shown in (None, lambda now: None)
    ]
    assert runs[0].counters["steps"] == runs[1].counters["steps"]
    assert runs[0].times == pytest.approx(runs[1].times, rel=1e-6)


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [fmbd.BDF(), fmbd.Radau(), fmbd.HalfExplicit(), fmbd.ExplicitRungeKutta()], ids=told)
def test_marks_are_hit_on_the_way_of_a_call(scheme: Any, marches: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps end at each, as those of Python do, and a call goes on past them."""
    marks = tuple(np.linspace(0.013, 0.487, 80))
    ending = lambda schedule, *given: replace(schedule, marks=marks)  # noqa: E731
    monkeypatch.setattr(single_run, "seeing_loads", ending)
    law = lambda s, rate, t: -5.0 * s  # noqa: E731
    run = lambda: fmbd.solve(hanging(law), t_end=0.5, scheme=scheme)  # noqa: E731
    once, calls = run(), len(marches)
    assert np.abs(once.times[:, None] - marks).min(axis=0).max() < 1e-14
    assert calls < 10
    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)
    turn = run()
    assert once.counters["steps"] == turn.counters["steps"]
    assert once.state.q == pytest.approx(turn.state.q, rel=1e-8, abs=1e-9)


def given_in_time() -> fmbd.Scene:
    """A bead whose speed is given by time and place, and a slide whose place is given by time."""
    scene = fmbd.Scene("given in time")
    bead = fmbd.RigidBody("bead", 2.0, 0.3, (1.0, 0.0), velocity=(0.0, 1.0))
    slide = fmbd.RigidBody("slide", 1.0, 0.1, (0.5, 0.0))
    whirl = fmbd.constraint(
        "whirl", fmbd.ground, bead, lambda a, b, t: [b.v[0] + (1 + t) * b.x[1], b.v[1] - (1 + t) * b.x[0]]
    )
    track = fmbd.constraint("track", fmbd.ground, slide, lambda a, b, t: [b.x[0] - 0.5 - 0.1 * np.sin(7 * t), b.x[1]])
    scene.add(bead, slide, whirl, track)
    return scene


GIVEN = {
    "own steps of Radau": (fmbd.Radau(form=fmbd.Index2()), None),
    "own steps of BDF": (fmbd.BDF(form=fmbd.Index2()), None),
    "Radau": (fmbd.Radau(form=fmbd.Index2(), rtol=None), 2e-3),
    "BDF": (fmbd.BDF(order=2, form=fmbd.Index2(), rtol=None), 2e-3),
    "half-explicit": (fmbd.HalfExplicit(rtol=None), 2e-3),
    "energy-momentum": (fmbd.EnergyMomentum(), 2e-3),
}


@pytest.mark.compiled
@pytest.mark.parametrize("name", GIVEN)
def test_rows_given_in_time_are_judged_at_the_time_of_the_state(
    name: str, marches: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """How far they are open in records on the way is what Python's records tell, and nobody warns."""
    scheme, dt = GIVEN[name]
    run = lambda: fmbd.solve(given_in_time(), t_end=0.3, dt=dt, scheme=scheme)  # noqa: E731
    once = run()
    assert sum(marches) > 0.8 * once.counters["steps"]

    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)
    turn = run()
    assert once.drift == pytest.approx(turn.drift, rel=1e-3, abs=1e-9)
    assert once.warnings == turn.warnings == []


@pytest.mark.compiled
def test_large_turns_are_warned_of_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the step that turns a body so far, in the middle of a march."""

    def run() -> list[str]:
        scene = fmbd.Scene("wheel")
        wheel = fmbd.RigidBody("wheel", 1.0, 0.1, (0.0, 0.0))
        hinge = fmbd.revolute("hinge", fmbd.ground, wheel, center=(0, 0))
        scene.add(wheel, hinge, fmbd.effort("motor", fmbd.angle(hinge), lambda t: 800.0))
        done = fmbd.solve(scene, t_end=0.1, dt=1e-3, scheme=fmbd.EnergyMomentum(), output=fmbd.Output(every=100))
        return [str(x) for x in done.warnings]

    once, turn = both(monkeypatch, run)
    assert once == turn and sum("rad a step" in x for x in once) == 1


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", SCHEMES, ids=named)
def test_records_on_the_way_are_those_of_states(scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def run() -> fmbd.Run:
        scene = joint_springs(2)
        scene.sensor("place", fmbd.sensors.position(scene.bodies[next(iter(scene.bodies))]))
        return fmbd.solve(scene, t_end=0.1, dt=1e-3, scheme=scheme, output=fmbd.Output(progress=False))

    once, turn = both(monkeypatch, run)
    assert np.array_equal(once.times, turn.times) and len(once.times) == 101
    assert once["place"] == pytest.approx(turn["place"], rel=1e-13, abs=1e-14)
    for kind in turn.energy:
        assert once.energy[kind] == pytest.approx(turn.energy[kind], rel=1e-11, abs=1e-11)


def said(run: Any) -> str:
    """The words of the error that ends a run."""
    with pytest.raises(FmbdError) as error:
        run()
    return str(error.value)


def breaking(s: float, rate: float, t: float) -> float:
    """A law without a value from 0.0735 s on."""
    return float("nan") if t > 0.0735 else -1.0


def raising(s: float, rate: float, t: float) -> float:
    """One that raises there."""
    if t > 0.0735:
        raise RuntimeError("no value")
    return -1.0


@pytest.mark.compiled
@pytest.mark.parametrize("law", [breaking, raising], ids=lambda x: x.__name__)
@pytest.mark.parametrize("scheme", SCHEMES, ids=named)
def test_failures_are_told_in_the_same_words(scheme: Any, law: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the middle of a march, with the number of the step."""
    output = fmbd.Output(every=200, progress=False)
    once, turn = both(
        monkeypatch, lambda: said(lambda: fmbd.solve(hanging(law), t_end=0.2, dt=1e-3, scheme=scheme, output=output))
    )
    assert once == turn


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", SCHEMES, ids=named)
def test_a_state_that_is_refused_on_the_way_is_refused_in_turn(scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Joints that are allowed to be open by nothing at all, and no energy: the same words, or the same parts of steps."""
    from fmbd_fenicsx.run.judges import acceptance, energy_check

    output = fmbd.Output(every=100, progress=False)

    def run() -> Any:
        return fmbd.solve(joint_springs(2), t_end=0.1, dt=1e-3, scheme=scheme, output=output)

    with monkeypatch.context() as patch:
        patch.setattr(energy_check, "SHARE", 1e-12)
        patch.setattr(energy_check, "ROUNDOFF", 0.0)
        once, turn = both(patch, run)
    assert once.counters == turn.counters and np.array_equal(once.state.q, turn.state.q)

    with monkeypatch.context() as patch:
        patch.setattr(acceptance.Closed, "_wide", 1e-30)
        patch.setattr(acceptance, "ROUNDOFF", 0.0)
        patch.setattr(
            acceptance.Closed,
            "openness",
            property(lambda self: fmbd.system.compiled.tape.Openness(self.units, 1e-30, 0.0)),
        )
        words = both(patch, lambda: said(run))
    assert words[0] == words[1] and "is open by" in words[0]


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", SCHEMES, ids=named)
def test_an_event_ends_a_march(scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def run() -> fmbd.Run:
        scene = hanging(lambda s, rate, t: 0.1 * rate)
        scene.sensor("turn", fmbd.angle(scene.joints["hinge"]))
        stop = fmbd.Event("turn", -0.4, direction=-1)
        output = fmbd.Output(every=50, progress=False, events=[stop])
        return fmbd.solve(scene, t_end=1.0, dt=1e-3, scheme=scheme, output=output)

    once, turn = both(monkeypatch, run)
    assert once.status == turn.status == "ended by an event"
    assert once.state.t == pytest.approx(turn.state.t, rel=1e-12)
    assert once.state.q == pytest.approx(turn.state.q, rel=1e-11)


class Swaying:
    """A form of a user's own: joints are to be open by 1e-6 t^2."""

    def rows(self, ev: Any, a: Any) -> list[Any]:
        return [row - 1e-6 * np.atleast_1d(ev.t)[:, None] ** 2 for row in super().rows(ev, a)]  # type: ignore[misc]


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [fmbd.Radau, fmbd.BDF])
def test_a_form_of_ones_own_is_that_of_compiled_steps_too(scheme: Any) -> None:
    """Compiled code knew the levels of a form alone, and left its rows out in silence."""
    form = type("Swaying", (Swaying, fmbd.Index3), {})()
    scene = fmbd.Scene("bob", gravity=(0.0, -9.81))
    bob = fmbd.PointMass("bob", 1.0, (1.0, 0.0))
    scene.add(bob, fmbd.distance("string", fmbd.ground, bob, point_a=(0.0, 0.0), point_b=(1.0, 0.0)))
    end = fmbd.solve(scene, t_end=0.1, dt=0.01, scheme=scheme(form=form, rtol=None)).state
    gaps = scene.build()[0].at(end.t, end.q, end.v).constraint()
    assert np.abs(gaps).max() == pytest.approx(1e-8, rel=0.02)
