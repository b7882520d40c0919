"""Records at given times by marches that keep the steps in which they lie: those of steps that are looked at one by one."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import test_compiled_contact as contacts
import tolerance_scenes as scenes
from test_driver import joint_springs
from test_marches import hanging, redundant, remembering, rod_and_mass
from test_steps_one_by_one import driven_rod, named

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.system.compiled import kept
from fmbd_fenicsx.system.compiled.march import March

EQUAL = [
    fmbd.GeneralizedAlpha(),
    fmbd.GeneralizedAlpha(form=fmbd.GGL()),
    fmbd.Rattle(),
    fmbd.EnergyMomentum(),
    fmbd.ExplicitRungeKutta(rtol=None),
    fmbd.HalfExplicit(rtol=None),
    fmbd.Radau(rtol=None),
    fmbd.Radau(form=fmbd.Index3(), rtol=None),
    fmbd.BDF(order=2, rtol=None),
]
OWN = [
    fmbd.GeneralizedAlpha(rtol=1e-4),
    fmbd.Radau(),
    fmbd.BDF(),
    fmbd.HalfExplicit(),
    fmbd.ExplicitRungeKutta(rtol=1e-6),
]
SEVERAL = {
    "plane": lambda: joint_springs(2),
    "space": lambda: joint_springs(3),
    "driven": lambda: driven_rod(2),
    "law": lambda: hanging(lambda s, rate, t: 3.0 * s**3 + 0.1 * rate + np.sin(t)),
    "redundant": redundant,
    "memory": lambda: remembering(lambda phi: fmbd.dry_friction("dry", phi, limit=1.0, stick=1e3, damping=1.0)),
    "rod": rod_and_mass,
    "reduced": lambda: scenes.elastic_pendulum(modes=3),
    "field": scenes.elastic_pendulum,
}
EXPLICIT = fmbd.Rattle, fmbd.ExplicitRungeKutta, fmbd.HalfExplicit
REFUSED = [(name, fmbd.EnergyMomentum) for name in ("field", "reduced")] + [("rod", kind) for kind in EXPLICIT]
T_END, DT = 0.06, 1e-3
TIMES = np.sort(np.concatenate((np.linspace(0.0, T_END, 21), np.random.default_rng(3).uniform(0.0, T_END, 60))))


def seen(make: Callable[[], fmbd.Scene]) -> fmbd.Scene:
    """A scene with sensors of places, rates, accelerations and reactions."""
    scene = make()
    body = list(scene.bodies.values())[-1]
    if isinstance(body, fmbd.RigidBody):
        for name in ("position", "velocity", "acceleration"):
            scene.sensor(name, getattr(fmbd.sensors, name)(body))
    for name in list(scene.joints)[:2]:
        scene.sensor(f"force {name}", fmbd.reaction(name))
    return scene


def run(name: str, scheme: Any, times: Any = TIMES, **more: Any) -> fmbd.Run:
    """A run with records at given times."""
    equal = getattr(scheme, "rtol", None) is None
    output = fmbd.Output(times=times, progress=False, **more)
    return fmbd.solve(seen(SEVERAL[name]), t_end=T_END, dt=DT if equal else None, scheme=scheme, output=output)


def assert_alike(found: fmbd.Run, wanted: fmbd.Run, share: float) -> None:
    """Two runs have the same records but for so much of their sizes."""
    assert found.times == pytest.approx(TIMES, abs=1e-15) and np.array_equal(found.times, wanted.times)
    for name, values in {**wanted.series, **wanted.energy}.items():
        other = {**found.series, **found.energy}[name]
        assert np.abs(other - values).max() <= share * max(np.abs(values).max(), 1e-6), name


PAIRS = [
    pytest.param(name, scheme, id=f"{name}-{named(scheme)}")
    for name in SEVERAL
    for scheme in EQUAL
    if (name, type(scheme)) not in REFUSED
]


@pytest.mark.compiled
@pytest.mark.parametrize(("name", "scheme"), PAIRS)
def test_instants_of_kept_steps_are_those_of_steps_looked_at_one_by_one(name: str, scheme: Any) -> None:
    """``on_step`` lets each step be a call of its own, from which Python takes its instants."""
    found = run(name, scheme)
    assert_alike(found, run(name, scheme, on_step=lambda now: None), 1e-9)
    free = fmbd.solve(seen(SEVERAL[name]), t_end=T_END, dt=DT, scheme=scheme)
    assert np.array_equal(found.state.q, free.state.q)  # and leave the march as it is


def marches(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many are made from now on."""
    steps, calls = March.steps, [0]

    def counted(*given: Any, **more: Any) -> Any:
        calls[0] += 1
        return steps(*given, **more)

    monkeypatch.setattr(March, "steps", counted)
    return calls


def rubbing() -> fmbd.Scene:
    """A body with friction, of which places and speeds are read."""
    scene = SEVERAL["memory"]()
    body = list(scene.bodies.values())[-1]
    scene.sensor("place", fmbd.position(body))
    scene.sensor("speed", fmbd.velocity(body))
    return scene


def of_sensors(scene: fmbd.Scene, scheme: Any, **more: Any) -> fmbd.Run:
    """What its sensors alone read at the instants, in steps of one size or of the scheme's own."""
    dt = DT if getattr(scheme, "rtol", None) is None else None
    output = fmbd.Output(times=TIMES, energy=False, progress=False, **more)
    return fmbd.solve(scene, t_end=T_END, dt=dt, scheme=scheme, output=output)


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [*EQUAL, *OWN], ids=lambda s: f"{named(s)} {getattr(s, 'rtol', None)}")
def test_a_memory_ends_marches_only_where_more_than_the_motion_is_read(scheme: Any, monkeypatch: Any) -> None:
    """Places and speeds tell nothing of it: 81 instants were as many marches. Accelerations follow from forces."""
    calls = marches(monkeypatch)
    found = of_sensors(rubbing(), scheme)
    assert calls[0] <= 8 or isinstance(scheme, EXPLICIT[1:])  # forces tell what these do within a step
    assert_alike(found, of_sensors(rubbing(), scheme, on_step=lambda now: None), 1e-9)

    felt, one_by_one = rubbing(), rubbing()
    for scene in (felt, one_by_one):
        scene.sensor("acceleration", fmbd.acceleration(list(scene.bodies.values())[-1]))
    assert_alike(of_sensors(felt, scheme), of_sensors(one_by_one, scheme, on_step=lambda now: None), 1e-9)


@pytest.mark.compiled
def test_energies_at_ends_of_steps_end_no_march_at_instants_beside_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of a search are recorded where the one before was, too: each of these instants ended a march."""
    calls = marches(monkeypatch)
    fmbd.solve(rubbing(), t_end=0.5, scheme=fmbd.BDF(), tol={"place": fmbd.relative(1e-3)})
    assert calls[0] <= 30


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["plane", "space", "driven", "reduced"])
@pytest.mark.parametrize("scheme", [*EQUAL, *OWN], ids=lambda s: f"{named(s)} {getattr(s, 'rtol', None)}")
def test_little_room_for_kept_steps_changes_nothing(name: str, scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A march ends where there is none, and the next begins with what that knew of the step before."""
    if (name, type(scheme)) in REFUSED:
        return
    found = run(name, scheme)
    monkeypatch.setattr(kept, "BYTES", 0)
    monkeypatch.setattr(kept, "FEW", 3)
    assert_alike(run(name, scheme), found, 1e-9)


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["plane", "memory"])
def test_ends_that_are_told_with_roundoff_are_those_of_kept_steps(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Instants in a step whose end was told 1e-16 s before what it had kept were told by the next step, backwards."""
    scheme, steps = fmbd.GeneralizedAlpha(rtol=1e-4), kept.Kept.steps
    wanted = run(name, scheme)
    monkeypatch.setattr(kept.Kept, "steps", lambda self, t: steps(self, np.nextafter(t, 0.0)))
    assert_alike(run(name, scheme), wanted, 0.0)


CONTACTS = ("bouncing 2", "cam", "stops and friction", "pid", "own shape")


@pytest.mark.compiled
@pytest.mark.parametrize("name", CONTACTS)
def test_instants_between_impacts_are_those_of_steps_looked_at_one_by_one(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Impacts cut steps: each instant is told by the part in which it lies, with what contacts carry in its step."""
    times = np.sort(np.concatenate((np.linspace(0.0, 0.4, 51), np.random.default_rng(5).uniform(0.0, 0.4, 400))))
    alone = contacts.run(name, times=times, on_step=lambda now: None)
    assert alone.counters["impacts"] > 0
    for room in (kept.BYTES, 0):
        monkeypatch.setattr(kept, "BYTES", room)
        found = contacts.run(name, times=times)
        assert found.counters["compiled_steps"] == found.counters["steps"]
        assert np.array_equal(found.times, alone.times) and len(found.times) == len(times)
        for sensor, values in {**alone.series, **alone.energy}.items():
            other = {**found.series, **found.energy}[sensor]
            assert np.abs(other - values).max() <= 1e-9 * max(np.abs(values).max(), 1e-6), sensor
        assert np.array_equal(found.state.q, alone.state.q)


@pytest.mark.compiled
def test_contacts_at_given_times_cost_few_calls() -> None:
    """250 to 400 calls of Python a record when steps that pass one were made by themselves, 27 where NumPy told their gaps."""
    few, many = (np.sort(np.random.default_rng(1).uniform(0.02, 0.4, n)) for n in (200, 1200))
    contacts.run("bouncing 3", times=few)
    counted = [calls(lambda times=times: contacts.run("bouncing 3", times=times)) for times in (few, many)]
    assert (counted[1] - counted[0]) / 1000 < 3


def calls(made: Callable[[], Any]) -> int:
    """Calls of Python functions, and from Python of C."""
    count = [0]

    def note(frame: Any, event: str, arg: Any) -> None:
        count[0] += event in ("call", "c_call")

    sys.setprofile(note)
    try:
        made()
    finally:
        sys.setprofile(None)
    return count[0]


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [*EQUAL, *OWN], ids=lambda s: f"{named(s)} {getattr(s, 'rtol', None)}")
def test_records_at_given_times_cost_few_calls(scheme: Any) -> None:
    """400 to 700 calls of Python a record when steps that pass one were made by themselves; the first steps of a run are."""
    few, many = (np.sort(np.random.default_rng(1).uniform(0.02, T_END, n)) for n in (200, 1200))
    run("plane", scheme, few)
    counted = [calls(lambda times=times: run("plane", scheme, times)) for times in (few, many)]
    assert (counted[1] - counted[0]) / 1000 < 30


@pytest.mark.compiled
def test_steps_with_instants_are_made_in_one_call(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many steps a call as without."""
    made: list[int] = []
    steps = March.steps
    monkeypatch.setattr(March, "steps", lambda self, *x, **y: (found := steps(self, *x, **y), made.append(found[0]))[0])
    run("plane", fmbd.EnergyMomentum())
    assert made == [60]


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [fmbd.Rattle(), fmbd.EnergyMomentum(), fmbd.GeneralizedAlpha()], ids=named)
def test_instants_in_the_step_of_an_event_end_with_it(scheme: Any) -> None:
    """The march ends with that step, whose instants are read before the event and no longer behind it."""
    whole = run("plane", scheme)
    level = float(whole["position"][50, 0])
    ended = run("plane", scheme, events=[fmbd.Event("position x", level)])
    count = int(np.searchsorted(TIMES, ended.times[-1]))
    assert ended.status == "ended by an event" and 40 < count < len(TIMES)
    assert ended.times[:-1] == pytest.approx(TIMES[:count], abs=1e-15)
    assert np.abs(ended["velocity"][:-1] - whole["velocity"][:count]).max() < 1e-9
