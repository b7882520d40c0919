"""Records made inside of the compiled loop are those that sensors read from the states one by one."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from profiled import calls_of
from test_compiled import chain as links

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import LawError
from fmbd_fenicsx.rotations import Array
from fmbd_fenicsx.system.evaluation import Evaluation
from fmbd_fenicsx.system.layout import State
from fmbd_fenicsx.system.sensors.sensor import Sensor
from fmbd_fenicsx.system.sensors.sensors import Position


class Momentum(Sensor):
    """A sensor that does not say what it looks at."""

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """Momentum of all bodies."""
        return ev.momenta()[0]


class Stored(Sensor):
    """What forces store, by a state."""

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """J."""
        return np.array([ev.energies()["springs"]])


def chain(dim: int, element: Callable[..., Any]) -> fmbd.Scene:
    """Three links with an element in each hinge, and every sensor that the loop can serve; one that it cannot."""
    scene, before = fmbd.Scene("links", gravity=(0, -9.81, 0)[:dim]), fmbd.ground
    for i in range(3):
        inertia = 1e-3 if dim == 2 else (1e-4, 1e-3, 1.1e-3)
        link = fmbd.RigidBody(f"link {i}", 0.1, inertia, (0.1 * i + 0.05, 0.0, 0.0)[:dim])
        axis = {} if dim == 2 else {"axis": (0.1, 0.2 * (-1) ** i, 1.0)}
        hinge = fmbd.revolute(f"hinge {i}", before, link, center=(0.1 * i, 0.0, 0.0)[:dim], **axis)
        scene.add(link, hinge, element(f"element {i}", fmbd.angle(hinge)))
        before = link

    point = (0.27, 0.02, 0.01)[:dim]
    scene.sensor("x", fmbd.position(link, point=point))
    scene.sensor("v", fmbd.velocity(link, point=point))
    scene.sensor("a", fmbd.acceleration(link, point=point))
    scene.sensor("w", fmbd.angular_velocity(link))
    scene.sensor("R", fmbd.rotation(link))
    scene.sensor("momentum", Momentum(None, "N s"))
    for name in ("hinge 0", "hinge 2"):
        joint = scene.joints[name]
        scene.sensor(f"{name} lambda", fmbd.reaction(name))
        scene.sensor(f"{name} force", fmbd.reaction_force(name))
        scene.sensor(f"{name} torque", fmbd.reaction_torque(name))
        scene.sensor(f"{name} angle", fmbd.angle(joint))
        scene.sensor(f"{name} rate", fmbd.joint_rate(fmbd.angle(joint)))
    s = fmbd.sensors
    for what in (s.element_effort, s.elongation, s.element_torque, s.element_power):
        scene.sensor(what.__name__, what(scene.forces["element 1"]))
    spring = fmbd.Spring("tied", fmbd.ground, link, (0.3, 0.2, 0.1)[:dim], point, stiffness=0.2, damping=0.1)
    scene.add(spring)
    for what in (s.tension, s.element_force, s.element_power):
        scene.sensor(f"tied {what.__name__}", what(spring))
    return scene


ELEMENTS = {
    "spring": lambda name, angle: fmbd.joint_spring(name, angle, stiffness=2.0, damping=0.01, free=0.1),
    "stop": lambda name, angle: fmbd.elastic_stop(name, angle, upper=0.02, lower=-0.02, stiffness=5.0, damping=0.01),
    "motor": lambda name, angle: fmbd.motor(name, angle, target=lambda t: 0.3 * np.sin(4 * t), kp=1.0, kd=0.02),
}


def recorded(dim: int, element: str, *, one_by_one: bool) -> Any:
    """A run of 60 steps with every second recorded."""
    output = fmbd.Output(every=2, snapshots=3, ledger=one_by_one, progress=False)  # powers are read from the states
    return fmbd.solve(chain(dim, ELEMENTS[element]), t_end=0.121, dt=2e-3, output=output)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("element", list(ELEMENTS))
def test_records_of_the_loop_are_those_of_single_states(dim: int, element: str) -> None:
    fast, slow = (recorded(dim, element, one_by_one=x) for x in (False, True))
    assert "compiled" in fast.plan.path
    assert np.array_equal(fast.times, slow.times)
    assert fast.times[-1] == pytest.approx(0.121)
    assert np.array_equal([s.t for s in fast.snapshots], [s.t for s in slow.snapshots])

    for name, values in slow.series.items():
        assert fast[name].shape == values.shape, name
        assert np.abs(values).max() > 0 or (dim == 2 and name.endswith("torque")), name
        assert fast[name] == pytest.approx(values, rel=1e-9, abs=1e-9 * np.abs(values).max() + 1e-14), name
    for kind, values in slow.energy.items():
        assert fast.energy[kind] == pytest.approx(values, rel=1e-9, abs=1e-12), kind
    assert fast.drift == pytest.approx(slow.drift, rel=1e-6, abs=1e-14)


def test_prescribed_motion_and_its_drift() -> None:
    """The rate of a driven joint is part of the drift of velocities."""
    runs = []
    for ledger in (False, True):
        body = fmbd.RigidBody("body", 1.0, 0.1, (0.5, 0.0))
        scene = fmbd.Scene("driven", gravity=(0, -9.81))
        pin = fmbd.revolute("pin", fmbd.ground, body, center=(0, 0))
        scene.add(body, pin, fmbd.drive("drive", fmbd.angle(pin), lambda t: 0.5 * np.sin(3 * t)))
        scene.sensor("effort", fmbd.reaction_torque("drive"))
        runs.append(fmbd.solve(scene, t_end=0.1, dt=1e-3, output=fmbd.Output(ledger=ledger, progress=False)))
    assert runs[0]["effort"] == pytest.approx(runs[1]["effort"], rel=1e-9)
    assert runs[0].drift == pytest.approx(runs[1].drift, rel=1e-6, abs=1e-14)
    assert 0 < runs[0].drift[1] < 1e-4


def test_an_open_joint_is_refused_where_it_is_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    from fmbd_fenicsx.run.judges import acceptance

    monkeypatch.setattr(acceptance, "OPEN", -1.0)
    monkeypatch.setattr(acceptance.Closed, "under", lambda system, scheme: acceptance.Closed(system, (0,), -1.0))
    with pytest.raises(fmbd.errors.ConvergenceError, match=r'"hinge .*is open by'):
        recorded(2, "spring", one_by_one=False)


def test_floating_fields_are_recorded_in_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the start and the first step, which is NumPy's, are read one by one; all records are those of NumPy."""
    from motion import elastic_rod

    from fmbd_fenicsx.run.recording.recorder import Recorder

    mesh, single, read = fmbd.read_gmsh("meshes/rod.py", dim=2, h=0.25), Recorder._record, []

    def counted(self: Any, n: int, *args: Any, **kwargs: Any) -> None:
        read.append(n)
        single(self, n, *args, **kwargs)

    monkeypatch.setattr(Recorder, "_one_by_one", lambda self, *args: pytest.fail("a state was read by itself"))

    def run(compiled: bool) -> fmbd.Run:
        rod = elastic_rod(mesh)
        scene = fmbd.Scene("rod", gravity=(0, -9.81))
        scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
        scene.sensor("tip", fmbd.position(rod.surface("tip")))
        scene.sensor("force", fmbd.reaction_force("pin"))
        scene.sensor("a", fmbd.acceleration(rod.surface("tip")))
        return fmbd.solve(scene, t_end=0.05, dt=2e-3, scheme=fmbd.GeneralizedAlpha(0.8, compiled=compiled))

    monkeypatch.setattr(Recorder, "_record", counted)
    fast = run(compiled=True)
    assert read == [0, 1]
    slow = run(compiled=False)
    for name in ("tip", "force", "a"):
        np.testing.assert_allclose(fast[name], slow[name], rtol=0, atol=1e-8 * np.abs(slow[name]).max())
    np.testing.assert_allclose(fast.total_energy, slow.total_energy, rtol=0, atol=1e-8 * slow.energy["kinetic"].max())
    assert fast.drift[0] < 1e-10


def test_steps_that_somebody_looks_at_are_compiled_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same states to the last bit as without; their forces are looked at after 64 steps and at the end, whoever else looks.
    What is read of them is what C has told; only the start and crossings are evaluated.
    """
    from fmbd_fenicsx.run.recording.moment import Moment
    from fmbd_fenicsx.run.step_bisection import ConstantSteps
    from fmbd_fenicsx.run.time_loop import Loop

    evaluated: list[float] = []
    at = lambda now: (evaluated.append(now.t), now.system.at(now.state.t, now.state.q, now.state.v))[1]  # noqa: E731
    monkeypatch.setattr(Moment, "evaluation", property(at))
    looks, parts = [0], [0]
    look, in_turn = Loop._refuses, ConstantSteps.in_turn
    monkeypatch.setattr(Loop, "_refuses", lambda *args: (looks.append(1), look(*args))[1])
    monkeypatch.setattr(ConstantSteps, "in_turn", lambda *args, **given: (parts.append(1), in_turn(*args, **given))[1])

    seen: list[float] = []
    crossings: list[float] = []
    event = fmbd.Event("tip y", -0.005, then=lambda now: crossings.append(now.t))
    runs = []
    for watch in ({}, {"on_step": lambda now: seen.append(now["tip"][1])}, {"events": [event]}):
        scene = chain(2, ELEMENTS["spring"])
        scene.sensor("tip", fmbd.position(list(scene.bodies.values())[-1]))
        looks.clear()
        parts.clear()
        output = fmbd.Output(every=2, progress=False, **watch)
        runs.append(fmbd.solve(scene, t_end=0.15, dt=1e-3, output=output))
        assert len(looks) == 2 and len(parts) <= 2
        assert len(evaluated) < 30
    assert len(seen) == 150 and seen[1::2] == pytest.approx(runs[0]["tip"][1:, 1], rel=1e-12)
    assert crossings
    for other in runs[1:]:
        assert (other.state.q == runs[0].state.q).all() and (other.state.lam == runs[0].state.lam).all()
        assert other["tip"] == pytest.approx(runs[0]["tip"], rel=1e-12) and (other.times == runs[0].times).all()


@pytest.mark.parametrize("kind", ["reduced", "floating", "absolute", "rod"])
def test_what_follows_from_states_is_read_from_all_records_at_once(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Points, strains, largest values, coordinates, sections: those of single states, of which none is evaluated."""
    import ufl
    from combinations import BODIES, pinned

    from fmbd_fenicsx.run.recording.recorder import Recorder

    def run(one_by_one: bool) -> fmbd.Run:
        rod = BODIES[kind]()
        scene = fmbd.Scene(kind, gravity=rod.at(0, -9.81))
        scene.add(rod.body)
        pinned(scene, rod)
        s = fmbd.sensors
        if kind == "rod":
            scene.sensor("forces", s.section_forces(rod.left))
            scene.sensor("strains", s.section_strains(rod.left))
        else:
            point = {"point": (0.6, 0.02)}
            for what in (s.position, s.velocity, s.acceleration, s.elastic_displacement, s.strain):
                scene.sensor(what.__name__, what(rod.body, **point))
            scene.sensor("value", s.point_value(rod.body, ufl.grad, **point))
            scene.sensor("largest", s.largest(rod.body, lambda u: ufl.inner(ufl.grad(u), ufl.grad(u))))
            scene.sensor("coordinates", s.coordinates(rod.body, level=1))
        output = fmbd.Output(ledger=one_by_one, progress=False)
        return fmbd.solve(scene, t_end=0.02, dt=1e-3, output=output)

    slow = run(one_by_one=True)
    monkeypatch.setattr(Recorder, "_one_by_one", lambda self, *args: pytest.fail("a state was read by itself"))
    fast = run(one_by_one=False)
    for name, values in slow.series.items():
        assert np.array_equal(fast[name], values), name
        assert np.abs(values).max() > 0, name


def test_sensors_of_the_users_own_find_markers_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a sensor of the user's own reads of markers is what C told of them; Jacobians are there when it asks."""
    from fmbd_fenicsx.mechanics.frames import Markers

    found, evaluate = [0], Markers.evaluate

    class Own(Sensor):
        def read(self, ev: Evaluation, state: State, marker: int) -> Array:
            x = [*ev.kin.x[marker], *ev.kin.R[marker].ravel(), *ev.kin.twist[marker]]
            return np.array([*x, *ev.kin.jac_frame[marker].ravel()] if self.unit == "all" else x)

    def counted(self: Any, *args: Any, **kwargs: Any) -> Any:
        found[0] += 1
        return evaluate(self, *args, **kwargs)

    monkeypatch.setattr(Markers, "evaluate", counted)
    runs, counts = [], []
    for unit, ledger in (("", False), ("all", False), ("all", True)):
        scene = chain(3, ELEMENTS["spring"])
        link = scene.bodies["link 2"]
        scene.sensor("own", Own(link, unit, (0.27, 0.02, 0.01)))
        del scene.sensors["momentum"]
        found[0] = 0
        runs.append(fmbd.solve(scene, t_end=0.1, dt=2e-3, output=fmbd.Output(ledger=ledger, progress=False)))
        counts.append(found[0])
    assert counts[0] < 20 < 45 < counts[1]  # a start, and one of each of 50 records
    told, fast, slow = (run["own"] for run in runs)
    assert np.array_equal(told[1:, :3], runs[0]["x"][1:])  # the first is NumPy's
    assert np.array_equal(told, fast[:, :18])
    np.testing.assert_allclose(fast, slow, rtol=0, atol=1e-10 * np.abs(slow).max())


@pytest.mark.parametrize("ends", [False, True])
def test_steps_without_events_are_made_in_one_call(ends: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Crossings, records and the end are, to the last bit, those of steps that are looked at one by one, in far fewer calls."""
    from fmbd_fenicsx.run.recording.events import EventWatch

    looks, look = [0], EventWatch.look
    monkeypatch.setattr(EventWatch, "look", lambda *args: (looks.append(1), look(*args))[1])
    runs, met, counts = [], [], []
    for one_by_one in (False, True):
        scene, found = chain(2, ELEMENTS["spring"]), []
        tell = lambda name: lambda now: found.append((name, now.t, *now["x"]))  # noqa: E731, B023
        events = [
            fmbd.Event("v x", 0.0, direction=-1, then=tell("v")),
            fmbd.Event("hinge 0 angle", -0.11, then=tell("angle")),
            fmbd.Event("element_effort", 0.2, direction=-1, then=None if ends else tell("tension")),
        ]
        on_step = (lambda now: None) if one_by_one else None
        output = fmbd.Output(every=3, snapshots=3, progress=False, events=events, on_step=on_step)
        looks.clear()
        runs.append(fmbd.solve(scene, t_end=0.4, dt=1e-3, output=output))
        met.append(found)
        counts.append(len(looks))
    assert met[0] == met[1] and len(met[0]) > (0 if ends else 3)
    fast, slow = runs
    assert (fast.status == "ended by an event") is ends
    assert counts[0] < 30 < 100 < counts[1]
    assert np.array_equal(fast.times, slow.times) and np.array_equal(fast.state.q, slow.state.q)
    assert [s.t for s in fast.snapshots] == [s.t for s in slow.snapshots]
    for name, values in slow.series.items():
        assert np.array_equal(fast[name], values), name


class Backwards(Position):
    """A place whose components stand the other way round."""

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        return np.asarray(super().read(ev, state, marker)[::-1])

    def series(self, seen: Any, marker: int) -> Array:
        return np.asarray(super().series(seen, marker)[:, ::-1])


def bouncing() -> fmbd.Scene:
    """A ball that falls on a floor."""
    scene = fmbd.Scene("bounce", gravity=(0.0, -9.81))
    ball = fmbd.RigidBody("ball", 1.0, 0.004, (0.0, 0.2))
    ground = fmbd.Obstacle("floor", fmbd.HalfSpace((0.0, 0.0), (0.0, 1.0)))
    floor = fmbd.contact("pair", fmbd.ball(ball, 0.1), ground, restitution=0.5)
    scene.add(ball, floor)
    scene.sensor("x", fmbd.position(ball))
    scene.sensor("gap", fmbd.contact_gap(floor))
    scene.sensor("force", fmbd.contact_force(floor))
    return scene


LONG: dict[str, Callable[[], tuple[fmbd.Scene, dict[str, Any]]]] = {
    "plane": lambda: (chain(2, ELEMENTS["stop"]), {"dt": 1e-3}),
    "space": lambda: (chain(3, ELEMENTS["spring"]), {"dt": 1e-3}),
    "error control": lambda: (chain(3, ELEMENTS["spring"]), {"scheme": fmbd.GeneralizedAlpha(rtol=1e-7)}),
    "contact": lambda: (bouncing(), {"dt": 1e-3, "scheme": fmbd.Moreau()}),
}


@pytest.mark.parametrize("kind", list(LONG))
def test_what_c_writes_into_series_is_what_python_takes_from_records(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last bit, of sensors that are numbers of records, of those that are computed from them, and of energies; also where
    nothing but the newest record is kept.
    """
    from fmbd_fenicsx.run.recording.straight import Straight

    lead, led = Straight.lead, []

    def noted(self: Straight, tape: Any, more: int) -> None:
        lead(self, tape, more)
        led.append(self.single)

    def run(*, alone: bool) -> fmbd.Run:
        scene, how = LONG[kind]()
        scene.sensors.pop("momentum", None)
        if "x" in scene.sensors and "v" in scene.sensors:
            scene.sensor("backwards", Backwards(scene.bodies["link 2"], "m"))
        for name in list(scene.sensors) if alone else ():
            if name in ("momentum", "gap", "force") or "power" in name:
                del scene.sensors[name]
        return fmbd.solve(scene, t_end=0.4, output=fmbd.Output(progress=False), **how)

    for alone in (False, True):
        led.clear()
        monkeypatch.setattr(Straight, "lead", noted)
        fast = run(alone=alone)
        assert led and set(led) == {alone}
        monkeypatch.setattr(Straight, "lead", lambda *args: None)
        slow = run(alone=alone)
        assert len(fast.times) > 300 and np.array_equal(fast.times, slow.times) and fast.drift == slow.drift
        assert fast.series.keys() == slow.series.keys() and fast.energy.keys() == slow.energy.keys()
        for name, values in (slow.series | slow.energy).items():
            assert np.array_equal((fast.series | fast.energy)[name], values), name


@pytest.mark.parametrize("scheme", [fmbd.GeneralizedAlpha(), fmbd.BDF()], ids=["equal steps", "own steps"])
def test_runs_take_room_for_steps_that_somebody_waits_for_alone(scheme: Any) -> None:
    """Megabytes, cleared, cost more than the steps of a short run."""

    def most(output: fmbd.Output) -> int:
        dt = None if isinstance(scheme, fmbd.BDF) else 1e-2
        tracemalloc.start()
        try:
            fmbd.solve(links(3), t_end=0.2, dt=dt, scheme=scheme, output=output)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    most(fmbd.Output(progress=False))  # loads modules
    assert most(fmbd.Output(progress=False)) < 1_000_000
    assert most(fmbd.Output(times=(0.05, 0.1), progress=False)) > 1_000_000


def test_markers_in_one_place_are_seen_once() -> None:
    """Points of a rigid body that are the same, and surfaces with the same ports; not what stands elsewhere."""
    from motion import elastic_rod

    from fmbd_fenicsx.system.compiled.recording import Looks

    rod = elastic_rod(fmbd.read_gmsh("meshes/rod.py", dim=2, h=0.25))
    disk = fmbd.RigidBody("disk", 1.0, 1.0, (0.0, 1.0))
    scene = fmbd.Scene("places")
    scene.add(rod, disk)
    places = ((disk, (0.2, 1.0)), (disk, (0.2, 1.1)), (rod.surface("tip"), None), (rod.surface("pin"), None))
    for k, (on, point) in enumerate(places):
        scene.sensor(f"x{k}", fmbd.position(on, point=point))
        scene.sensor(f"v{k}", fmbd.velocity(on, point=point))
    system, _, markers = scene.build()
    looks = Looks(system)
    alike = [(looks.alike[markers[f"x{k}"]], looks.alike[markers[f"v{k}"]]) for k in range(4)]
    assert [a for a, b in alike] == [b for a, b in alike] == sorted(looks.markers, key=[a for a, b in alike].index)


def test_on_step_reads_contacts_of_compiled_steps() -> None:
    """What it is told is what is recorded."""
    seen: list[Array] = []
    output = fmbd.Output(progress=False, on_step=lambda now: seen.append(now["force"]))
    run = fmbd.solve(bouncing(), t_end=0.2, dt=1e-3, scheme=fmbd.Moreau(), output=output)
    assert np.array_equal(seen, run["force"][1:]) and run["force"].max() > 100.0


def test_a_law_without_a_value_within_a_step_is_named() -> None:
    """Compiled code finds no record between two steps there; who reads states one by one, with their contacts, tells why."""

    def law(s: float, rate: float, t: float) -> float:
        if abs(t - 0.2025) < 1e-6:
            raise ValueError("no value here")
        return 2.0 * s

    arm = fmbd.RigidBody("arm", 1.0, 0.1, (0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0, -0.01), (0, 1)))
    scene = fmbd.Scene("swing", gravity=(0, -9.81))
    scene.add(arm, pin, fmbd.joint_spring("spring", fmbd.angle(pin), law=law))
    scene.add(fmbd.contact("touch", fmbd.ball(arm, 0.005), floor))
    scene.sensor("force", fmbd.sensors.contact_force("touch"))
    scene.sensor("effort", fmbd.sensors.element_effort("spring"))
    output = fmbd.Output(times=[0.2025, 0.3025], progress=False)
    with pytest.raises(LawError, match="no value here"):
        fmbd.solve(scene, t_end=0.4, dt=0.01, scheme=fmbd.Moreau(), output=output)


@pytest.mark.parametrize("scheme", [fmbd.Radau(3, rtol=1e-8), fmbd.GeneralizedAlpha(rtol=1e-6)], ids=lambda s: s.name)
def test_snapshots_are_not_late_behind_longer_steps(scheme: Any) -> None:
    """Each is the first state at its instant or behind: calls count steps of the size that they begin with."""
    runs = [
        fmbd.solve(links(4), t_end=2.0, scheme=scheme, output=fmbd.Output(progress=False, **kept))
        for kept in ({"every": 1}, {"every": 3, "snapshots": 8})
    ]
    instants = np.linspace(0.0, 2.0, 8)
    first = runs[0].times[np.searchsorted(runs[0].times, instants - 1e-9)]
    assert [s.t for s in runs[1].snapshots] == pytest.approx(list(first))


def test_tyres_tell_their_energy_of_the_markers_in_records() -> None:
    """No state is evaluated as a whole for it; and their roads are asked where wheels are."""
    places: list[float] = []

    def road(x: Any, t: Any) -> Any:
        places.append(float(np.real(x[0])))
        return -0.01 * np.sin(4.0 * x[0])

    def run(every: int, end: float, look: bool = False) -> fmbd.Run:
        scene = fmbd.Scene("two wheels", gravity=(0.0, -9.81))
        for k in (1.0, 2.0):
            wheel = fmbd.RigidBody(f"wheel {k:g}", 20.0, 0.5, (k, 0.25), velocity=(3.0, 0.0))
            scene.add(wheel, fmbd.Tyre(f"tyre {k:g}", wheel, None, (k, 0.25), None, road, 0.26, 2e5, 300.0, (0.0, 1.0)))
        scene.sensor("wheel", fmbd.position(wheel))
        if look:
            scene.sensor("stored", Stored(wheel, "J"))
        return fmbd.solve(scene, t_end=end, dt=1e-3, output=fmbd.Output(every=every, progress=False))

    seen = run(1, 0.1, look=True)
    np.testing.assert_array_equal(run(1, 0.1).energy["springs"], seen["stored"][:, 0])
    assert seen["stored"].max() > 1.0 and min(places) > 0.99

    calls = [calls_of(lambda every=every, end=end: run(every, end)) for every in (1, 1000) for end in (0.1, 0.2)]
    assert calls[1] - calls[0] < calls[3] - calls[2] + 100 * 30  # 53 where states were evaluated
