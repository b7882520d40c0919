"""Bodies in absolute coordinates in compiled steps: the digits and the iterations of NumPy, Python asked for little."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from test_compiled import pair

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import (
    kelvin_voigt,
    linear_elastic,
    neo_hookean_incompressible,
    neo_hookean_mixed,
    saint_venant_kirchhoff,
)
from fmbd_fenicsx.schemes.onestep.alpha.field_stepper import FieldStepper
from fmbd_fenicsx.system.compiled.choice import driver_states

pytestmark = pytest.mark.compiled
LENGTH = 1.0  # m, of the rod
BODIES: dict[str, dict[str, Any]] = {
    "small strains": {"elastic": linear_elastic(1e8, 0.3), "stiffness_damping": 1e-4},
    "small strains, mass damping": {"elastic": linear_elastic(1e8, 0.3), "mass_damping": 0.2},
    "small strains, viscous": {"elastic": linear_elastic(1e8, 0.3), "viscous": linear_elastic(1e4, 0.3)},
    "large strains": {"energy": saint_venant_kirchhoff(1e8, 0.3)},
    "large strains, soft, viscous": {"energy": saint_venant_kirchhoff(2e7, 0.3), "viscous": kelvin_voigt(100.0)},
    "pressure, damped": {"energy": neo_hookean_mixed(1e8, 0.45), "stiffness_damping": 1e-4},
    "no change of volume, damped": {"energy": neo_hookean_incompressible(1e8), "stiffness_damping": 1e-4},
}


def arm(mesh: Any, body: dict[str, Any], *, gravity: bool = True) -> tuple[fmbd.Scene, Any, Any]:
    """A rod in the world on a hinge."""
    rod = fmbd.AbsoluteBody("rod", mesh, density=1000.0, **body)
    d = rod.dim
    scene = fmbd.Scene("arm", gravity=(0.0, -9.81, 0.0)[:d] if gravity else None)
    axis = {} if d == 2 else {"axis": (0, 0, 1)}
    pin = fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0, 0)[:d], **axis)
    scene.add(rod, pin)
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    scene.sensor("turn", fmbd.angle(pin))
    return scene, rod, pin


def machine(mesh: Any, body: dict[str, Any], element: str) -> fmbd.Scene:
    """The rod with a bob on a second joint, and an element."""
    scene, rod, pin = arm(mesh, body)
    d, tip = rod.dim, rod.surface("tip")
    bob = fmbd.RigidBody("bob", 2.0, 0.1 if d == 2 else (0.1, 0.2, 0.3), (1.0, 0.1, 0.0)[:d])
    scene.add(bob, fmbd.spherical("knee", tip, bob, center=(1.0, 0.05, 0.0)[:d]))
    anchor = {"point_a": (1, 0.5, 0)[:d], "point_b": (1, 0, 0)[:d]}
    angle = fmbd.angle(pin)
    adds: dict[str, Callable[[], Any]] = {
        "spring": lambda: fmbd.Spring("spring", fmbd.ground, tip, stiffness=1e4, damping=20.0, **anchor),
        "motor": lambda: fmbd.forces.motor("motor", angle, target=lambda t: t, kp=100.0, kd=5.0),
        "law": lambda: fmbd.joint_spring("law", angle, law=lambda s, rate, t: 200.0 * np.sin(s) + 5.0 * rate),
        "push": lambda: fmbd.force("push", tip, lambda t: (0.0, 2e4 * t, 0.0)[:d]),
        "drive": lambda: fmbd.drive("drive", angle, lambda t: 5.0 * t**3),
    }
    if element:
        scene.add(adds[element]())
    return scene


def agree(fast: fmbd.Run, slow: fmbd.Run, steps: int, places: float = 1e-12) -> None:
    """All steps but the first compiled; equal to roundoff, displacements to ``places`` of the length of the rod."""
    assert fast.counters["compiled_steps"] == steps
    assert fast.counters["newton_iterations"] == slow.counters["newton_iterations"]
    assert np.abs(fast.state.q - slow.state.q).max() < places * LENGTH
    for name, bar in (("v", 1e3 * places), ("a", 1e-6), ("lam", 1e-6)):
        x, y = getattr(fast.state, name), getattr(slow.state, name)
        assert np.abs(x - y).max() < bar * np.abs(y).max(initial=1e-6), name
    for name in ("tip", "turn"):
        assert np.allclose(fast[name], slow[name], rtol=0, atol=1e-11), name
    for name, series in fast.energy.items():
        assert np.allclose(series, slow.energy[name], rtol=1e-8, atol=1e-8), name


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("body", BODIES)
def test_same_digits_as_numpy(rod_mesh: Callable[..., Any], dim: int, body: str) -> None:
    """Every kind of forces; a body on its own, whose size of accelerations is that of its nodes."""
    mesh = rod_mesh(dim=dim, h=0.5, height=0.2)
    agree(*pair(lambda: arm(mesh, BODIES[body])[0], t_end=0.03, dt=1e-3), 30)


@pytest.mark.parametrize("element", ["", "spring", "motor", "law", "push", "drive"])
@pytest.mark.parametrize("body", ["small strains", "large strains"])
@pytest.mark.parametrize("form", [fmbd.Index3(), fmbd.GGL()], ids=str)
def test_elements_on_it(rod_mesh: Callable[..., Any], body: str, element: str, form: Any) -> None:
    mesh = rod_mesh(dim=2, h=0.5, height=0.2)
    places = 1e-12 if element != "spring" else 1e-10  # of what reactions push across only compiled steps know
    agree(*pair(lambda: machine(mesh, BODIES[body], element), form, t_end=0.03, dt=1e-3), 30, places)


def test_two_of_them_in_space(rod_mesh: Callable[..., Any]) -> None:
    """One of small, one of large strains, joined to each other; gravity that is switched on."""
    mesh = rod_mesh(dim=3, h=0.5, height=0.2)

    def make() -> fmbd.Scene:
        scene, rod, _ = arm(mesh, BODIES["small strains"])
        other = fmbd.AbsoluteBody("other", mesh, density=1000.0, **BODIES["large strains"])
        scene.add(other, fmbd.spherical("knee", rod.surface("tip"), other.surface("tip"), center=(1.0, 0.0, 0.0)))
        scene.gravity_ramp = 0.02
        return scene

    agree(*pair(make, t_end=0.02, dt=1e-3), 20)


@pytest.mark.parametrize("form", [fmbd.Index3(), fmbd.GGL()], ids=str)
def test_soft_bodies_take_new_tangents_in_compiled_steps(rod_mesh: Callable[..., Any], form: Any) -> None:
    """As many, in the same steps, as in NumPy: the consistent tangent where the rate is slow, before a step is halved."""
    mesh = rod_mesh(dim=2, h=0.25, height=0.1)

    def make() -> fmbd.Scene:
        scene, rod, _ = arm(mesh, {"energy": fmbd.materials.sheet_saint_venant_kirchhoff(1e8, 0.3)})
        anchor = {"point_a": (1, 0.5), "point_b": (1, 0)}
        scene.add(fmbd.Spring("spring", fmbd.ground, rod.surface("tip"), stiffness=1e4, damping=20.0, **anchor))
        return scene

    fast, slow = pair(make, form, t_end=0.08, dt=1e-3)
    made = [run.counters["factorisations"] for run in (fast, slow)]
    assert made[0] == made[1] > 5
    assert fast.counters["halved_steps"] == slow.counters["halved_steps"] == 0
    agree(fast, slow, 80)


@pytest.mark.parametrize(
    ("cls", "law", "most"),
    [
        (fmbd.FloatingBody, fmbd.materials.sheet_saint_venant_kirchhoff(5e7, 0.3), 5),
        (fmbd.AbsoluteBody, neo_hookean_mixed(5e7, 0.499), 50),
    ],
)
def test_tangents_are_kept_where_new_ones_do_not_help(
    rod_mesh: Callable[..., Any], cls: Any, law: Any, most: int
) -> None:
    """A spinning rod whose vibrations steps do not resolve: a tangent saves two increments of a step, and costs forty."""
    mesh = rod_mesh(dim=2, h=0.25, height=0.1)

    def make() -> fmbd.Scene:
        scene = fmbd.Scene("spin")
        scene.add(cls("rod", mesh, density=1000.0, energy=law, angular_velocity=8.0))
        return scene

    fast, slow = pair(make, t_end=0.32, dt=4e-3)
    assert fast.counters["factorisations"] == slow.counters["factorisations"] <= most
    assert not fast.counters["halved_steps"]


def test_tangents_at_once_after_steps_that_took_several(rod_mesh: Callable[..., Any]) -> None:
    """What the last step took is known to the next one, wherever each was made."""
    soft = {"energy": fmbd.materials.sheet_saint_venant_kirchhoff(1e6, 0.3)}
    mesh = rod_mesh(dim=2, h=0.25, height=0.1)
    fast, slow = pair(lambda: arm(mesh, soft)[0], t_end=0.4, dt=1e-2)
    assert fast.counters["factorisations"] == slow.counters["factorisations"] > 8
    agree(fast, slow, 40)


def test_sudden_loads_on_stiff_bodies_in_large_steps(rod_mesh: Callable[..., Any]) -> None:
    """Waves that steps do not resolve leave accelerations that ring, and their parabola leads far off: each step was made in
    a dozen parts. The pulled rod is longer by what its stress says, in compiled steps and by NumPy.
    """
    E, pull, runs = 2e9, 1e5, []
    for native in (True, False):
        rod = fmbd.AbsoluteBody(
            "rod",
            rod_mesh(dim=2, h=0.1, height=0.1),
            density=1000.0,
            energy=saint_venant_kirchhoff(E, 0.0),
            loads=[fmbd.traction("tip", (pull, 0.0))],
        )
        scene = fmbd.Scene("pulled")
        scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
        scene.sensor("tip", fmbd.position(rod.surface("tip")))
        runs.append(fmbd.solve(scene, t_end=0.04, dt=1e-3, scheme=fmbd.GeneralizedAlpha(0.8, compiled=native)))
    fast, slow = runs
    assert fast.counters["halved_steps"] == slow.counters["halved_steps"] == 0
    assert fast.counters["newton_iterations"] == slow.counters["newton_iterations"] <= 4.5 * 40
    assert np.allclose(fast["tip"], slow["tip"], rtol=0, atol=1e-10)
    stretch = fast["tip"][-20:, 0].mean() / fast["tip"][0, 0] - 1.0
    assert 0.7 < stretch * E / pull < 1.3, stretch


@pytest.mark.parametrize("body", ["small strains", "large strains"])
@pytest.mark.parametrize("bob", [False, True], ids=["alone", "beside a frame"])
def test_steps_of_its_own_choice(rod_mesh: Callable[..., Any], body: str, bob: bool) -> None:
    """Errors are judged alike: frames that rest are none of the system's."""
    mesh = rod_mesh(dim=2, h=0.5, height=0.2)
    runs = []
    for path in (True, False):
        scene = machine(mesh, BODIES[body], "") if bob else arm(mesh, BODIES[body])[0]
        scheme = fmbd.GeneralizedAlpha(0.8, rtol=1e-4, compiled=path)
        runs.append(
            fmbd.solve(scene, t_end=0.04, scheme=scheme)
        )  # Python tries again what C refuses: iterations count twice
    fast, slow = runs
    assert fast.counters["compiled_steps"] > 10
    assert len(fast.times) == len(slow.times)
    assert fast.counters["newton_iterations"] == slow.counters["newton_iterations"]
    assert np.abs(fast["tip"] - slow["tip"]).max() < 1e-9


def test_it_turns_many_times(rod_mesh: Callable[..., Any]) -> None:
    """The rotation of the factor, of its surfaces and the angle of its hinge go on beyond a turn, whoever evaluates them."""
    soft = {"energy": fmbd.materials.sheet_saint_venant_kirchhoff(1e8, 0.3)}
    for dim, body in ((2, soft), (3, BODIES["large strains"])):
        mesh = rod_mesh(dim=dim, h=0.5, height=0.2)

        def make(mesh: Any = mesh, body: Any = body) -> fmbd.Scene:
            scene, _, pin = arm(mesh, body, gravity=False)
            scene.add(fmbd.drive("drive", fmbd.angle(pin), lambda t: 8.0 * t**3))
            return scene

        fast, slow = pair(make, t_end=1.0, dt=5e-3)
        assert fast["turn"][-1, 0] == pytest.approx(8.0, abs=1e-6)
        assert fast.counters["compiled_steps"] == 200
        assert fast.counters["newton_iterations"] == slow.counters["newton_iterations"]
        assert np.abs(fast["tip"] - slow["tip"]).max() < 1e-9
        assert np.abs(fast.state.q - slow.state.q).max() < 1e-9

        # the same state by the driver and by NumPy
        states = driver_states(fast.system)
        assert states is not None
        s = fast.state
        at = np.array([s.t]), s.q[None], s.v[None]
        found = states.constraints(at)
        ev = slow.system.at(s.t, s.q, s.v)
        assert found is not None and states.balances(at, s.a[None], s.lam[None]) is not None
        assert np.abs(found[0, 0] - ev.constraint()).max() < 1e-9
        assert np.abs(found[1, 0] - ev.opening()).max() < 1e-9


def test_what_python_is_asked_for(rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Solutions, forces and damping are compiled: new tangents are asked for, and motors once a step."""
    asked = {}
    march = FieldStepper.march

    def counted(self: Any, *given: Any, **more: Any) -> int:
        made = march(self, *given, **more)
        if made:
            asked[self.system.frame_names] = self.driver.tables.c.calls
        return made

    monkeypatch.setattr(FieldStepper, "march", counted)
    mesh = rod_mesh(dim=2, h=0.5, height=0.2)
    once = {"t_end": 0.041, "dt": 1e-3, "output": fmbd.Output(every=1000, energy=False, progress=False)}
    laws = BODIES | {"large strains, pressure": {"energy": neo_hookean_mixed(1e8, 0.4)}}
    for body, element, calls in (
        ("small strains", "", 0),
        ("small strains, viscous", "", 0),
        ("small strains", "motor", 41),
        ("large strains", "", 0),
        ("large strains, soft, viscous", "", 0),
        ("large strains, pressure", "", 0),
        ("no change of volume, damped", "", 0),
    ):
        asked.clear()
        fast = fmbd.solve(machine(mesh, laws[body], element), scheme=fmbd.GeneralizedAlpha(0.8), **once)
        assert fast.counters["compiled_steps"] == 41
        assert list(asked.values()) == [calls], (body, element)


def test_pressures_that_are_unknowns(rod_mesh: Callable[..., Any]) -> None:
    """They move as in NumPy, where steps fail too, which are made in parts from the pressures that they began with."""
    rubber = {"energy": neo_hookean_incompressible(1e6), "loads": [fmbd.traction("tip", (0.0, -200.0), time=np.sin)]}
    mesh = rod_mesh(dim=2, h=0.25, height=0.1)
    for newton, halved in ((fmbd.Newton(), 0), (fmbd.Newton(max_iterations=3), 4)):
        runs = pair(lambda: arm(mesh, rubber)[0], t_end=0.06, dt=2e-3, newton=newton)
        fast, slow = ([part.field.pressure_values for _, part in run.system.fields][0] for run in runs)
        assert [run.counters["halved_steps"] for run in runs] == [halved, halved]
        assert np.abs(fast - slow).max() < 1e-10 * np.abs(slow).max()
        if not halved:
            agree(*runs, 30)


def test_bodies_that_buckle(rod_mesh: Callable[..., Any]) -> None:
    """Their tangents are indefinite on the way: so is what joints see of them, and the factors of steps take it as NumPy does."""
    mesh = rod_mesh(dim=3, h=0.5, height=0.1)

    def make() -> fmbd.Scene:
        rod = fmbd.AbsoluteBody("rod", mesh, density=1000.0, energy=saint_venant_kirchhoff(1e6, 0.0))
        scene = fmbd.Scene("column")
        scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))
        scene.add(fmbd.force("press", rod.surface("tip"), lambda t: (-100.0 * t, 0.0, 100.0 * t)))
        scene.sensor("tip", fmbd.position(rod.surface("tip")))
        return scene

    fast, slow = pair(make, t_end=0.6, dt=5e-2)
    assert fast.counters["compiled_steps"] == 12
    for name in ("newton_iterations", "factorisations", "halved_steps"):
        assert fast.counters[name] == slow.counters[name], name
    assert np.abs(fast["tip"] - slow["tip"]).max() < 1e-9
