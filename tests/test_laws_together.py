"""Laws of the user's own on coordinates: asked with arrays where they take them, with the values that numbers give."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_compiled import stepper_of

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import CallbackError
from fmbd_fenicsx.mechanics.forces import laws_together, passed_over
from fmbd_fenicsx.mechanics.forces.laws_together import LawsTogether
from fmbd_fenicsx.mechanics.forces.user_laws import Repeatable
from fmbd_fenicsx.schemes.onestep.alpha.compiled_stepper import CompiledAlphaStepper
from fmbd_fenicsx.system.compiled.tables.items.items import LAW
from fmbd_fenicsx.system.compiled.tables.tables import Tables

N = 9
RNG = np.random.default_rng(3)
S, RATE, NUMBERS = RNG.standard_normal((3, N))
Law = Callable[..., Any]


def by_default() -> list[Law]:
    return [lambda s, rate, t, k=k: np.where(s > 0, k * s + 2.0 * rate, t) for k in NUMBERS.tolist()]


def by_closure() -> list[Law]:
    def make(k: float) -> Law:
        return lambda s, rate, t: k * np.maximum(s, 0.0) ** 2 + rate * t

    return [make(k) for k in NUMBERS.tolist()]


def by_name() -> list[Law]:
    return [lambda s, rate, t, *, k=k: np.tanh(k * s) + rate for k in NUMBERS.tolist()]


class Material:
    """A law that is a method."""

    k = 3.0

    def law(self, s: Any, rate: Any, t: float) -> Any:
        return self.k * s + rate


def one_for_all() -> list[Law]:
    table = np.linspace(-4, 4, 9), np.linspace(-4, 4, 9) ** 3
    law: Law = lambda s, rate, t: np.interp(s, *table) + 0.1 * rate  # noqa: E731
    return [law] * N


def method() -> list[Law]:
    one = Material()
    return [one.law for _ in range(N)]


def branches() -> list[Law]:
    return [lambda s, rate, t, k=k: k * s if s > 0 else 0.0 for k in NUMBERS.tolist()]


def of_math() -> list[Law]:
    return [lambda s, rate, t, k=k: math.sin(k * s) for k in NUMBERS.tolist()]


def mixes() -> list[Law]:
    """Takes arrays, with another meaning."""
    return [lambda s, rate, t: s - np.mean(s) + rate for _ in range(N)]


def mixes_in_one() -> list[Law]:
    return [lambda s, rate, t: s + (np.size(s) > 1) * (s == np.max(s)) for _ in range(N)]


def mixes_later() -> list[Law]:
    return [lambda s, rate, t: s + (np.mean(s) if t > 1.0 else s) for _ in range(N)]


def writes() -> list[Law]:
    def law(s: Any, rate: Any, t: float) -> Any:
        s *= 2.0
        return s + rate

    return [law] * N


def constant() -> list[Law]:
    return [lambda s, rate, t: 5.0 for _ in range(N)]


TAKEN = [by_default, by_closure, by_name, one_for_all, method]
REFUSED = [branches, of_math, mixes, mixes_in_one, mixes_later, writes, constant]


def alone(laws: list[Law], s: Any, rate: Any, t: float) -> Any:
    shape = s.shape
    s, rate = s.reshape(-1, N).tolist(), rate.reshape(-1, N).tolist()
    found = [[float(law(x, v, t)) for law, x, v in zip(laws, *row, strict=True)] for row in zip(s, rate, strict=True)]
    return np.array(found).reshape(shape)


@pytest.mark.parametrize("make", TAKEN + REFUSED)
def test_arrays_give_what_numbers_give(make: Callable[[], list[Law]]) -> None:
    laws = make()
    together = LawsTogether([Repeatable("The law of spring", f"{i}", law) for i, law in enumerate(laws)])
    for t in (0.5, 0.7, 2.0, 2.5):
        for s, rate in ((S + t, RATE), (np.array([S, S + 1, S - t]), np.array([RATE, RATE, -RATE]))):
            before = s.copy()
            assert np.allclose(together(s, rate, t), alone(laws, s, rate, t), rtol=1e-14, atol=1e-15)
            assert (s == before).all()
    assert len(together.kinds) == 1
    assert together.kinds[0].takes_arrays == (make in TAKEN)


def of_time() -> list[Law]:
    return [lambda s, rate, t, k=k: k * s * np.sin(t) for k in NUMBERS.tolist()]


def of_time_by_math() -> list[Law]:
    return [lambda s, rate, t, k=k: k * s * math.sin(t) for k in NUMBERS.tolist()]


@pytest.mark.parametrize("make", [*TAKEN, *REFUSED, of_time, of_time_by_math])
def test_points_of_a_step_are_asked_together(make: Callable[[], list[Law]]) -> None:
    """With an array of times where the law takes one, else with arrays of elements a time after the other, or with numbers."""
    laws = make()
    together = LawsTogether([Repeatable("The law of spring", f"{i}", law) for i, law in enumerate(laws)])
    for first in (0.5, 0.7, 2.0, 2.5):
        times = first + np.array([[0.0], [0.1], [0.3]])
        s, rate = S + times, RATE * times
        rows = [alone(laws, *row) for row in zip(s, rate, times.ravel().tolist(), strict=True)]
        assert np.allclose(together(s, rate, times), rows, rtol=1e-14, atol=1e-15)
    kind = together.kinds[0]
    assert kind.takes_times == (make in (*TAKEN, of_time))
    assert kind.takes_times or kind.takes_arrays == (make is of_time_by_math)


def test_variable_that_changes_later_is_seen() -> None:
    def make(k: float) -> tuple[Callable[[], None], Law]:
        def change() -> None:
            nonlocal k
            k = 7.0

        return change, lambda s, rate, t: k * s

    changes, laws = zip(*map(make, NUMBERS.tolist()), strict=True)
    together = LawsTogether([Repeatable("The law of spring", f"{i}", law) for i, law in enumerate(laws)])
    for _ in range(2):
        assert np.allclose(together(S, RATE, 0.0), NUMBERS * S, rtol=1e-14)
    changes[4]()
    assert together(S, RATE, 0.0)[4] == 7.0 * S[4]


def test_arrays_that_disagree_later_are_told_of_once(caplog: pytest.LogCaptureFixture) -> None:
    law = lambda s, rate, t: s if t < 1.0 or np.ndim(s) == 0 else 2.0 * s  # noqa: E731
    together = LawsTogether([Repeatable("The law of spring", f"s{i}", law) for i in range(N)])
    for t in (0.0, 0.5, 1.0, 1.5):
        assert together(S, RATE, t) == pytest.approx(S)
    said = [r.getMessage() for r in caplog.records if "asked with numbers from now on" in r.getMessage()]
    assert len(said) == 1 and "at t = 1 s" in said[0] and 'law of "s' in said[0]


def test_fault_in_an_array_names_its_element() -> None:
    def make(i: int) -> Law:
        return lambda s, rate, t: np.where((i == 6) & np.asarray(t > 1.0), np.nan, s + i)

    together = LawsTogether([Repeatable("The law of spring", f"spring {i}", make(i)) for i in range(N)])
    together(S, RATE, 0.0)
    assert together.kinds[0].takes_arrays
    with pytest.raises(CallbackError, match=r'"spring 6".*returned .*nan.* at t = 2 s'):
        together(S, RATE, 2.0)


@pytest.mark.parametrize("value", [(1.0, 2.0), [1, 2.0], np.array([1.0, 2.0]), (1.0, 2.0, 0.0)])
def test_a_law_of_time_is_asked_once_a_time_with_nothing_between(value: Any) -> None:
    """What a load returns is seen at a glance: of the time that a sample took more than half went into names for its errors."""
    asked: list[str] = []
    law = Repeatable("The law of force", "load", lambda t: value if t < 1.0 else value[0])
    law.numbers(2, 0.0)
    sys.setprofile(lambda frame, event, arg: asked.append(frame.f_code.co_name) if event == "call" else None)
    try:
        found = law.numbers(2, 0.5)
    finally:
        sys.setprofile(None)
    assert list(found) == [1.0, 2.0] and asked[:3] == ["numbers", "<lambda>", "few"] and len(asked) == 3
    with pytest.raises(CallbackError, match=r'"load": the law returned .* at t = 1 s, expected'):
        law.numbers(2, 1.0)


def cable(law: Callable[[list[int]], Law]) -> tuple[fmbd.Scene, list[int]]:
    """Ten masses on slack ropes with laws of their own lengths."""
    scene, asked = fmbd.Scene("cable", gravity=(0.0, -9.81)), [0]
    before: Any = fmbd.ground
    for i in range(10):
        mass = fmbd.RigidBody(f"{i}", 0.05, 1e-4, (0.05 * (i + 1), 0.0))
        rope = fmbd.Spring(f"rope {i}", before, mass, (0.05 * i, 0.0), (0.05 * (i + 1), 0.0), law=law(asked))
        scene.add(mass, rope)
        before = mass
    scene.sensor("end", fmbd.position(before))
    return scene, asked


@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "NumPy"])
def test_a_law_is_asked_a_few_times_a_step_for_all_elements(compiled: bool) -> None:
    def arrays(asked: list[int]) -> Law:
        def law(s: Any, rate: Any, t: float) -> Any:
            asked[0] += 1
            return 2e3 * np.maximum(s - 0.05, 0.0) * (1 + 5 * (s - 0.05)) + 0.5 * rate

        return law

    def numbers(asked: list[int]) -> Law:
        def law(s: Any, rate: Any, t: float) -> Any:
            asked[0] += 1
            return 2e3 * max(s - 0.05, 0.0) * (1 + 5 * (s - 0.05)) + 0.5 * rate

        return law

    ends, counts = [], []
    for law in (arrays, numbers):
        of_run = []
        for steps in (10, 30):
            scene, asked = cable(law)
            result = fmbd.solve(
                scene, t_end=1e-3 * steps, dt=1e-3, scheme=fmbd.GeneralizedAlpha(0.8, compiled=compiled)
            )
            of_run.append(asked[0])
        ends.append(result["end"][-1])
        counts.append((of_run[1] - of_run[0]) / 20)
    assert np.abs(ends[0] - ends[1]).max() < 1e-12
    # at each evaluation and each tangent twice: for all, and one alone
    assert counts[0] <= 24
    assert counts[1] >= 60


def steady(of_time: bool, dim: int) -> fmbd.Scene:
    """A pendulum under loads and an effort that stay the same, as constants or as functions of time."""
    scene = fmbd.Scene("steady", gravity=(0.0, -9.81, 0.0)[:dim])
    body = fmbd.RigidBody("body", 1.0, 0.1 if dim == 2 else (0.1, 0.2, 0.3), (0.5, 0.0, 0.0)[:dim])
    hinge = fmbd.revolute("hinge", fmbd.ground, body, center=(0, 0, 0)[:dim], axis=(0, 0, 1))
    scene.add(body, hinge)

    def given(value: Any) -> Any:
        return (lambda t: value) if of_time else value

    push, moment = (1.0, 2.0, 3.0)[:dim], 0.3 if dim == 2 else (0.3, 0.1, 0.2)
    tip = (1.0, 0.0, 0.0)[:dim]
    scene.add(
        fmbd.force("push", body, given(push), point=tip),
        fmbd.force("follower", body, given(push), point=tip, follower=True),
        fmbd.torque("torque", body, given(moment)),
        fmbd.torque("couple", body, given(moment), follower=True),
        fmbd.effort("effort", fmbd.angle(hinge), given(0.7)),
    )
    scene.sensor("tip", fmbd.position(body, point=tip))
    return scene


@pytest.mark.parametrize("dim", [2, 3])
def test_what_stays_the_same_is_not_asked_for(dim: int) -> None:
    """The same motion to the last bit, and no call of Python in compiled steps."""
    runs = [fmbd.solve(steady(of_time, dim), t_end=0.05, dt=1e-3) for of_time in (True, False)]
    assert (runs[0]["tip"] == runs[1]["tip"]).all()
    if runs[1].counters.get("compiled_steps"):
        steppers = [stepper_of(steady(of_time, dim)) for of_time in (True, False)]
        assert [s.driver.tables.c.samples for s in steppers if isinstance(s, CompiledAlphaStepper)] == [1, 0]


@pytest.mark.parametrize("count", [1, 3, N])
def test_slopes_of_few_laws_are_made_of_plain_numbers(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Arrays of a few numbers took three times as long as the laws; many elements are asked with arrays."""
    laws = [lambda s, rate, t, k=k: k * s * s + 3.0 * rate for k in NUMBERS[:count].tolist()]
    together = LawsTogether([Repeatable("The law of spring", f"{i}", law) for i, law in enumerate(laws)])
    if count <= 3:
        monkeypatch.setattr(laws_together, "np", SimpleNamespace(array=np.array))  # nothing but the answer
    k, c = together.slopes(S[:count], RATE[:count], 0.3)
    np.testing.assert_allclose(k, 2 * NUMBERS[:count] * S[:count], rtol=1e-6)
    np.testing.assert_allclose(c, 3.0, rtol=1e-6)


@pytest.mark.parametrize("scheme", [fmbd.GeneralizedAlpha, fmbd.Radau], ids=["alpha", "Radau"])
@pytest.mark.parametrize("space", [False, True], ids=["bodies", "masses"])
def test_springs_to_the_ground_are_asked_with_all_others(space: bool, scheme: Any) -> None:
    """One call of Python an evaluation, whatever a law acts between; the motion is that of formulas."""
    ends = []
    for law in ({"law": lambda s, rate, t: 200.0 * s + 0.5 * rate}, {"stiffness": 200.0, "damping": 0.5}):
        scene = fmbd.Scene("mixed", gravity=(0.0, -9.81, 0.0) if space else (0.0, -9.81))
        last: Any = fmbd.ground
        for i in range(3):
            place = (0.3 + 0.4 * i, 0.1 * i, 0.0)
            body = fmbd.PointMass(f"{i}", 0.2, place) if space else fmbd.RigidBody(f"{i}", 0.2, 1e-3, place[:2])
            own = place if space else (place[0] + 0.05, place[1])
            before = (0.0, 0.0, 0.0) if i == 0 else (place[0] - 0.4, place[1] - 0.1, 0.0)
            scene.add(body, fmbd.Spring(f"a{i}", last, body, before[: len(own)], own, length=0.4, **law))
            scene.add(fmbd.Spring(f"b{i}", fmbd.ground, body, (0.5 * i, 0.7, 0.1)[: len(own)], own, length=0.3, **law))
            last = body
        scene.sensor("end", fmbd.position(last))
        if "law" in law:
            made = [x for x in Tables(scene.build()[0], redundant=False).sources if x.role == LAW]
            assert [len(x) for x in made] == [6]
        ends.append(fmbd.solve(scene, t_end=0.1, dt=1e-3, scheme=scheme())["end"])
    assert np.abs(ends[0][-1] - ends[0][0]).max() > 1e-2
    assert np.allclose(*ends, atol=1e-8)


def over_a_bump(scalar: bool = False) -> fmbd.Scene:
    """1 kg at 1 m/s that gains 300 N sqrt(pi) 1 mm in a narrow place of its rail."""
    scene, mass = fmbd.Scene("bump"), fmbd.RigidBody("mass", 1.0, 1.0, (0.0, 0.0), velocity=(1.0, 0.0))
    rail = fmbd.prismatic("rail", fmbd.ground, mass, axis=(1, 0))
    e = math.exp if scalar else np.exp
    bump = fmbd.joint_spring(
        "bump", fmbd.displacement(rail), law=lambda s, rate, t: -300.0 * e(-(((s - 0.3137) / 1e-3) ** 2))
    )
    scene.add(mass, rail, bump)
    scene.sensor("x", fmbd.displacement(rail))
    return scene


@pytest.mark.parametrize(
    "scheme", [None, fmbd.Radau(3), fmbd.BDF(), fmbd.HalfExplicit(), fmbd.GeneralizedAlpha(rtol=1e-5), fmbd.Rattle()]
)
def test_a_bump_that_steps_pass_over_is_told(scheme: Any) -> None:
    """All schemes missed it, runs that tell errors too: 0.23 of the way, stated as nothing."""
    given = {} if scheme is not None and getattr(scheme, "rtol", None) else {"dt": 1e-2}
    run = fmbd.solve(over_a_bump(scheme is None), t_end=1.0, scheme=scheme, output=fmbd.Output(energy=False), **given)
    assert run["x"][-1, 0] < 1.01 and any("which steps pass over" in x for x in run.warnings)


def test_what_steps_have_seen_of_a_law_is_not_told() -> None:
    """Smaller steps meet the bump; beside a law that rises and falls between two places by what it is there nothing is passed."""
    run = fmbd.solve(over_a_bump(), t_end=1.0, scheme=fmbd.Radau(3), dt=2e-3, output=fmbd.Output(energy=False))
    speed = math.sqrt(1.0 + 2.0 * 0.3 * math.sqrt(math.pi))
    assert abs(run["x"][-1, 0] - 0.3137 - speed * (1.0 - 0.3137)) < 1e-3 and not run.warnings

    asked = passed_over.Asked(2)
    laws = [Repeatable("force", name, lambda s, rate, t: np.sin(s)) for name in "ab"]
    for s in np.linspace(0.0, 9.0, 5000):
        asked.note(np.array((s, s if s < 2.0 or s > 8.5 else 2.0)))
    assert len(asked.rows) < 2500  # places that are near to each other are one
    (found,) = asked.passed_over(laws, 0.0)
    assert found.name == "b" and np.allclose(found.between, (2.0, 8.5), atol=2e-3)
    assert found.at == pytest.approx(1.5 * np.pi, abs=0.05)

    # what rises by less than it is at both ends: a law that bends, and steps that follow it
    bent = Repeatable("force", "c", lambda s, rate, t: 1.0 + 0.4 * np.sin(s))
    assert not list(passed_over.Asked.of(np.array((0.0, np.pi, 2.0 * np.pi))).passed_over([bent], 0.0))


@pytest.mark.parametrize("space", [False, True])
def test_a_bump_of_a_road_that_steps_pass_over_is_told(space: bool) -> None:
    """A quarter of a car at 20 m/s went over 0.08 m on 0.4 m of its way without a word."""
    up, load = (0.0, 0.0, 1.0) if space else (0.0, 1.0), 300.0 * 9.81

    def driven(**given: Any) -> Any:
        place, along = (
            ((0.0, 1.0, 0.3 - load / 2e5), (20.0, 0.0, 0.0)) if space else ((0.0, 0.3 - load / 2e5), (20.0, 0.0))
        )
        inertia = (50.0, 50.0, 50.0) if space else 50.0
        body = fmbd.RigidBody("body", 300.0, inertia, place, velocity=along)
        scene = fmbd.Scene("car", gravity=tuple(-9.81 * x for x in up))
        tyre = fmbd.forces.Tyre(
            "tyre", body, road=lambda x, t: 0.08 * np.exp(-(((x[0] - 50.0) / 0.2) ** 2)), radius=0.3, stiffness=2e5,
            damping=3e3, up=up,
        )  # fmt: skip
        scene.add(body, tyre)
        scene.sensor("place", fmbd.position(body))
        return fmbd.solve(scene, t_end=3.0, scheme=fmbd.Radau(3), **given)

    passed, seen = driven(), driven(dt=5e-3)
    assert np.ptp(passed["place"][:, -1]) < 1e-9 and any("which steps pass over" in x for x in passed.warnings)
    assert np.ptp(seen["place"][:, -1]) > 0.05 and not seen.warnings
