"""Bodies with equations of a user's own in compiled steps, which ask Python for these alone: the motion of the NumPy path."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from own_bodies import Carrier, SlidingMass, carrier, line_and_bob
from profiled import calls_of
from test_calls_a_step import OWN, SCHEMES, scene_of
from test_line_body import line

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import linear_elastic
from fmbd_fenicsx.mechanics.bodies.port_kind import formulas_of
from fmbd_fenicsx.schemes.implicit.whole_steps import WholeMatrixSteps
from fmbd_fenicsx.schemes.marching import MarchingStepper
from fmbd_fenicsx.system.compiled import choice
from fmbd_fenicsx.system.compiled.choice import use_driver
from fmbd_fenicsx.system.compiled.march import March
from fmbd_fenicsx.system.compiled.tables.bodies.told import can_be_told
from fmbd_fenicsx.system.compiled.tables.resting import RestingPart


def beside_a_field(mesh: Any) -> fmbd.Scene:
    """A line that carries an elastic body in absolute coordinates: two parts on the ground."""
    block = fmbd.AbsoluteBody("block", mesh, density=500.0, elastic=linear_elastic(1e6, 0.3))
    beam = line(cells=3, start=lambda s: [s - 2.0, 0 * s, 0 * s])
    scene = fmbd.Scene("line and block", gravity=(0.0, -9.81))
    scene.add(beam, block, fmbd.fixed("clamp", fmbd.ground, beam.surface("start"), center=(-2.0, 0.0)))
    scene.add(fmbd.revolute("knee", beam.surface("end"), block.surface("pin"), center=(0.0, 0.0)))
    scene.sensor("place", fmbd.position(block.surface("tip"))), scene.sensor("hang", fmbd.reaction("clamp"))
    return scene


def loaded(mesh: Any) -> fmbd.Scene:
    """A reduced body on a hinge under a load that keeps its direction and one that turns with it."""
    d = mesh.dim
    load = fmbd.traction("tip", (0.0, 2e3, 1e3)[:d], time=lambda t: np.sin(20 * t))
    follower = fmbd.traction("side", (1e2, -2e2, 3e2)[:d], follower=True)
    rod = fmbd.FloatingBody("rod", mesh, density=1000.0, elastic=linear_elastic(1e8, 0.3), loads=(load, follower))
    arm = rod.reduced(basis=fmbd.CraigBampton(("pin", "tip"), 4))
    scene = fmbd.Scene("loaded", gravity=(0.0, -9.81, 0.0)[:d])
    scene.add(arm, fmbd.spherical("pin", fmbd.ground, arm.surface("pin"), center=np.zeros(d)))
    scene.sensor("place", fmbd.position(arm.surface("tip"))), scene.sensor("hang", fmbd.reaction("pin"))
    return scene


SCENES = {
    "carrier in the plane": partial(carrier, 2),
    "carrier in space": partial(carrier, 3),
    "line": line_and_bob,
}


def compare(make: Callable[[], fmbd.Scene], form: Any) -> None:
    """Places, reactions and energies of both; no step outside of compiled code."""
    scheme = partial(fmbd.GeneralizedAlpha, 0.8, form=form)
    fast, slow = (fmbd.solve(make(), t_end=0.05, dt=1e-3, scheme=scheme(compiled=by)) for by in (True, False))
    assert fast.counters["compiled_steps"] == fast.counters["steps"]
    assert fast.counters["newton_iterations"] == slow.counters["newton_iterations"]
    known = {**slow.energy, "place": slow["place"], "hang": slow["hang"]}
    found = {**fast.energy, "place": fast["place"], "hang": fast["hang"]}
    for name, values in known.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-6, atol=1e-6 * np.abs(values).max(), err_msg=name)
    np.testing.assert_allclose(fast["place"], slow["place"], rtol=1e-8)


@pytest.mark.compiled
@pytest.mark.parametrize("form", [fmbd.Index3(), fmbd.GGL()], ids=lambda form: form.name)
@pytest.mark.parametrize("name", SCENES)
def test_runs_are_those_of_numpy(name: str, form: Any) -> None:
    """A part beside a rigid body, in the plane and in space; a part on the ground."""
    compare(SCENES[name], form)


def smooth_step(x: float) -> float:
    """From 0 to 1, two continuous derivatives."""
    return x**3 * (10 - 15 * x + 6 * x * x)


@pytest.mark.compiled
def test_a_line_that_large_steps_press_stays_in_compiled_steps() -> None:
    """The tangent of its own is indefinite there: each such step went to NumPy, at ten times the time."""
    runs = []
    for by in (True, False):
        beam = line(cells=2, mass_damping=2.0)
        scene = fmbd.Scene("pushed")
        scene.add(beam, fmbd.fixed("clamp", fmbd.ground, beam.surface("start")))
        scene.add(fmbd.force("load", beam.surface("end"), lambda t: (0.0, 20.0 * smooth_step(min(2.0 * t, 1.0)))))
        scene.sensor("tip", fmbd.position(beam.surface("end")))
        runs.append(fmbd.solve(scene, t_end=1.0, dt=1 / 12, scheme=fmbd.GeneralizedAlpha(compiled=by)))
    fast, slow = runs
    assert fast.counters["compiled_steps"] == fast.counters["steps"] == 12
    np.testing.assert_allclose(fast["tip"], slow["tip"], rtol=0, atol=1e-5 * np.ptp(slow["tip"]))


@pytest.mark.compiled
def test_forces_of_a_line_are_asked_for_by_few_calls() -> None:
    """By none where nothing has moved since."""
    system, _, _ = line_and_bob().build()
    use_driver(system)
    (line,) = system.evaluator.tables.told
    line.forces(0.0)
    assert calls_of(lambda: line.forces(0.0)) <= 1
    line.motion.state += 1.0
    assert calls_of(lambda: line.forces(0.0)) <= 9


@pytest.mark.compiled
def test_beside_a_field(rod_mesh: Any) -> None:
    """Two frames at rest."""
    compare(partial(beside_a_field, rod_mesh(h=0.1)), fmbd.Index3())


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("scheme", "dt"), [(fmbd.Rattle(), 5e-5), (fmbd.EnergyMomentum(), 1e-3)], ids=lambda x: getattr(x, "name", str(x))
)
def test_other_schemes_march_beside_lines(scheme: Any, dt: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """What they keep with a state is that of the tables, whose lines have a frame at rest; steps in turn are the same."""
    runs = []
    made: list[int] = []
    steps = March.steps
    monkeypatch.setattr(March, "steps", lambda *x, **y: (found := steps(*x, **y), made.append(found[0]))[0])
    for in_turn in (False, True):
        if in_turn:
            assert sum(made) == 30
            monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)
        runs.append(fmbd.solve(line_and_bob(), t_end=30 * dt, dt=dt, scheme=scheme))
    for name in ("q", "v", "a", "lam"):
        wanted = getattr(runs[1].state, name)
        np.testing.assert_allclose(getattr(runs[0].state, name), wanted, atol=1e-8 * np.abs(wanted).max(), err_msg=name)


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [fmbd.Radau(rtol=None), fmbd.BDF(2, rtol=None)], ids=lambda x: type(x).__name__)
@pytest.mark.parametrize(
    "make", [line_and_bob, partial(carrier, 2), partial(carrier, 3)], ids=["line", "own 2D", "own 3D"]
)
def test_implicit_schemes_march_beside_parts(make: Any, scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python tells forces, masses and slopes alone; steps in parts are the same."""

    def run(steps: int) -> Any:
        output = fmbd.Output(times=(0.0, steps * 1e-3), energy=False, progress=False)
        runs.append(fmbd.solve(make(), t_end=steps * 1e-3, dt=1e-3, scheme=scheme, output=output))

    runs: list[Any] = []
    run(10)
    calls = [calls_of(lambda steps=steps: run(steps), "/fmbd_fenicsx/") for steps in (10, 30)]
    assert calls[1] - calls[0] < 20 * 140

    monkeypatch.setattr(WholeMatrixSteps, "ready", property(lambda whole: whole.eq.make_ready()))
    run(30)
    for name in ("q", "v"):
        wanted = getattr(runs[3].state, name)
        np.testing.assert_allclose(getattr(runs[2].state, name), wanted, atol=1e-6 * np.abs(wanted).max(), err_msg=name)


OWN_EQUATIONS = [(kind, scheme) for kind in ("own coordinates", "own rows") for scheme in (*SCHEMES, *OWN)]


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("kind", "scheme"),
    [*OWN_EQUATIONS, *((kind, scheme) for kind in ("own numbers", "own slopes") for scheme in (SCHEMES[0], OWN[0]))],
    ids=lambda x: x if isinstance(x, str) else f"{x.name} {getattr(x, 'rtol', None) or ''}",
)
def test_equations_of_own_coordinates(kind: str, scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside links that NumPy would step with them."""
    runs = [fmbd.solve(scene_of(kind, []), t_end=0.02, dt=2e-3, scheme=scheme)]
    monkeypatch.setattr(choice, "covers_bodies", lambda system: False)
    runs.append(fmbd.solve(scene_of(kind, []), t_end=0.02, dt=2e-3, scheme=scheme))
    assert runs[1].counters["steps"] == runs[0].counters["steps"]
    off = 1e-8 if getattr(scheme, "rtol", None) is None else 0.1 * scheme.rtol  # of sizes that roundoff chooses
    for name in ("q", "v"):
        found, wanted = (getattr(run.state, name) for run in runs)
        np.testing.assert_allclose(found, wanted, rtol=0.0, atol=off * np.abs(wanted).max(), err_msg=name)


def test_rows_of_one_formula_are_of_one_kind() -> None:
    """Each rod of a hundred had a kernel between all masses: 13 s of CPU time in place of 0.3."""

    def rods(q: Any, t: Any) -> Any:
        x, y = [0.0, *q[::2]], [0.0, *q[1::2]]
        return np.array([(x[i + 1] - x[i]) ** 2 + (y[i + 1] - y[i]) ** 2 - 1.0 for i in range(8)])

    start = np.ravel([(i + 1.0, 0.0) for i in range(8)])
    scene = fmbd.Scene("chain")
    scene.add(fmbd.CoordinateBody("chain", np.eye(16), lambda q, v, t: -q, start, constraint=rods))
    law = scene.build()[0].port_constraints[0][0]
    found = formulas_of(law, start, 2)
    assert [points for _, points in found] == [[0], *([i, i + 1] for i in range(7))]
    assert len({term.kind for term, _ in found}) == 2


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", [fmbd.Radau(rtol=1e-5), fmbd.BDF(rtol=1e-5)], ids=lambda x: x.name)
def test_frames_at_rest_count_in_no_norm(scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Means over them too made errors of one coordinate half as large, and steps longer."""

    def steps() -> float:
        scene = fmbd.Scene("duffing")
        scene.add(fmbd.CoordinateBody("duffing", np.eye(1), lambda q, v, t: -q - q**3, (1.0,)))
        return fmbd.solve(scene, t_end=10.0, scheme=scheme).counters["steps"]

    found = steps()
    monkeypatch.setattr(choice, "covers_bodies", lambda system: False)
    assert found == pytest.approx(steps(), rel=0.02)


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
def test_a_reduced_body_under_loads(dim: int, rod_mesh: Any) -> None:
    """Of such bodies Python is asked for all forces."""
    compare(partial(loaded, rod_mesh(dim=dim, h=0.25, height=0.2)), fmbd.Index3())


@pytest.mark.compiled
def test_what_a_force_raises_names_its_place() -> None:
    """An error of a user's own ends the run as itself."""

    class Late(SlidingMass):
        def force(self, motion: Any, local: Any) -> Any:
            if motion.t > 0.02:
                raise ZeroDivisionError("of the user's own")
            return super().force(motion, local)

    class Carried(Carrier):
        def part(self, frame: int) -> Any:
            return Late(self, frame)

    scene = fmbd.Scene("late")
    scene.add(Carried("late", 1.0, 0.1, (0.0, 0.0)))
    with pytest.raises(ZeroDivisionError, match="of the user's own"):
        fmbd.solve(scene, t_end=0.1, dt=1e-2)


@pytest.mark.parametrize("name", ["ports_of", "port_force"])
def test_ports_of_a_users_own_are_numpys(name: str) -> None:
    """The driver knows ports that are constant rows; also of a part on the ground, in its frame at rest."""
    own = type("Own", (SlidingMass,), {name: lambda self, x, t: x})
    body = Carrier("body", 1.0, 0.1, (0.0, 0.0))
    assert can_be_told(SlidingMass(body, 0)) and can_be_told(RestingPart(SlidingMass(body, 1), 1))
    assert not can_be_told(own(body, 0)) and not can_be_told(RestingPart(own(body, 1), 1))
