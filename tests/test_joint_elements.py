"""Friction, stops and motors in joints, and the sensors of force elements."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.mechanics.forces.effort_laws import ElasticStop, Feedback, Friction
from fmbd_fenicsx.rotations import Array
from fmbd_fenicsx.schemes.marching import MarchingStepper

INERTIA = 0.5


def wheel(rate: float = 0.0, dim: int = 2) -> tuple[fmbd.Scene, Any]:
    """A wheel on a hinge, and the angle of the hinge."""
    inertia = INERTIA if dim == 2 else (0.3, 0.4, INERTIA)
    body = fmbd.RigidBody("wheel", 1.0, inertia, angular_velocity=rate if dim == 2 else (0, 0, rate))
    scene = fmbd.Scene("wheel")
    hinge = fmbd.revolute("hinge", fmbd.ground, body, center=np.zeros(dim))
    scene.add(body, hinge)
    scene.sensor("phi", fmbd.angle(hinge))
    return scene, fmbd.angle(hinge)


LAWS = [
    Friction(0.5, 0.1, 0.7, 0.4, 0.02),
    ElasticStop(-0.3, 0.4, 50.0, 2.0, 0.1),
    Feedback(20.0, 3.0, lambda t: (0.5 * t, 0.5, 0.0), 5.0),
]


@pytest.mark.parametrize("law", LAWS, ids=lambda x: type(x).__name__)
def test_slopes_are_the_derivatives(law: Any) -> None:
    for s, rate, t in np.random.default_rng(1).uniform(-0.8, 0.8, (50, 3)):
        h = 1e-6
        by_s = (law(s + h, rate, t) - law(s - h, rate, t)) / (2 * h)
        by_rate = (law(s, rate + h, t) - law(s, rate - h, t)) / (2 * h)
        assert np.allclose(law.slopes(s, rate, t), (by_s, by_rate), rtol=1e-6, atol=1e-6)


def coulomb_oscillator(t: Array, start: float, shift: float, omega: float) -> Array:
    """Exact motion of J x'' + k x = -+F from rest at ``start``: half cycles about +-F/k = shift, until it sticks."""
    out = np.empty_like(t)
    halves = int(np.ceil((start - shift) / (2 * shift)))
    for i, now in enumerate(t):
        n = min(int(now * omega / np.pi), halves)
        top = start - 2 * n * shift  # amplitude with which half cycle n begins
        wave = top if n == halves else (top - shift) * np.cos(omega * now - n * np.pi) + shift
        out[i] = (-1) ** n * wave
    return out


@pytest.mark.parametrize("dim", [2, 3])
def test_dry_friction_against_the_analytic_decay(dim: int) -> None:
    """Amplitudes fall by 2 F / k each half cycle; then it sticks, away from zero, and creeps no more."""
    k, F, start = 20.0, 1.8, 1.0
    scene, phi = wheel(dim=dim)
    scene.add(fmbd.joint_spring("spring", phi, stiffness=k, free=start))
    friction = fmbd.dry_friction("friction", phi, limit=F, stick=1e6, damping=500.0)
    scene.add(friction)
    scene.sensor("effort", fmbd.element_effort(friction))
    run = fmbd.solve(scene, t_end=3.6, dt=2e-3)
    omega = np.sqrt(k / INERTIA)
    exact = start - coulomb_oscillator(run.times, start, F / k, omega)
    assert np.abs(run["phi"][:, 0] - exact).max() < 2e-3  # six kinks, each passed within a step
    rest = exact[-1] - start
    assert abs(rest) > 0.05
    assert abs(run["effort"][-1, 0] - k * rest) < 1e-2 * F, "held by friction below its limit"
    assert np.ptp(run["phi"][-100:, 0]) < 1e-9, "no creep"
    assert not run.warnings, "energy is lost, none is gained"

    # friction stores what its spring holds at the limit, F^2 / 2 k, however fast it slides
    bent = 0.5 * k * (run["phi"][:, 0] - start) ** 2
    assert np.abs(run.energy["springs"] - bent).max() <= 0.5 * F**2 / 1e6 + 1e-12
    again = run.system.at(run.state.t, run.state.q, run.state.v).energies()["springs"]
    assert again == pytest.approx(run.energy["springs"][-1], rel=1e-12), "compiled steps and NumPy tell the same"


@pytest.mark.parametrize("damping", [0.0, 5.0])
def test_a_joint_that_slides_at_the_start_has_all_of_its_friction(damping: float) -> None:
    """w = w0 - F t / J from t = 0 on."""
    F, rate = 0.7, -4.0
    scene, phi = wheel(rate)
    friction = scene.add(fmbd.dry_friction("friction", phi, limit=F, stick=1e5, damping=damping))
    scene.sensor("effort", fmbd.element_effort(friction))
    run = fmbd.solve(scene, t_end=1.0, dt=0.1)
    assert run["effort"][:, 0] == pytest.approx(np.full(11, F), rel=1e-12)
    assert run["phi"][-1, 0] == pytest.approx(rate + 0.5 * F / INERTIA, rel=1e-12)


@pytest.mark.parametrize(("given", "effort"), [((4.0, 4.0), -1.0), ((4.0, -4.0), 0.0), ((4.0, -1.0), -1.0)])
def test_friction_starts_with_the_velocities_that_joints_allow(given: tuple[float, float], effort: float) -> None:
    """Two wheels of one gear with speeds that contradict it: the second turns with the mean, or rests."""
    wheels = [fmbd.RigidBody(f"wheel {k}", 1.0, INERTIA, angular_velocity=w) for k, w in enumerate(given)]
    scene = fmbd.Scene("gear")
    scene.add(*wheels)
    turns = [scene.add(fmbd.revolute(w.name + " pin", fmbd.ground, w, center=(0, 0))) for w in wheels]
    first, second = (fmbd.angle(turn) for turn in turns)
    scene.add(fmbd.gear("gear", first, second, ratio=1.0))
    scene.add(fmbd.dry_friction("friction", second, limit=1.0, stick=1e5))
    scene.sensor("rim", fmbd.acceleration(wheels[1], point=(0.0, 1.0)))
    run = fmbd.solve(scene, t_end=1e-3, dt=1e-4)
    assert run["rim"][0, 0] == pytest.approx(-effort / (2 * INERTIA), abs=1e-9)


OWN_STEPS = [
    fmbd.Radau(3, rtol=1e-4),
    fmbd.Radau(3, rtol=1e-8),
    fmbd.BDF(rtol=1e-6),
    fmbd.ExplicitRungeKutta(1e-6),
    fmbd.HalfExplicit(1e-6),
]


@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "NumPy"])
@pytest.mark.parametrize(
    "scheme",
    [*OWN_STEPS, fmbd.GeneralizedAlpha(rtol=1e-3), fmbd.GeneralizedAlpha(rtol=1e-6)],
    ids=lambda x: f"{x.name}, {x.rtol:g}",
)
def test_own_steps_see_where_sliding_ends(scheme: Any, compiled: bool, monkeypatch: Any) -> None:
    """A clutch of 3 N m between flywheels of 0.2 and 0.3 kg m^2 slips for 0.8 s, and both turn at 8 rad/s. Within a step friction
    has no memory: large ones went on sliding backwards, and the wheels were off by 0.3 rad.
    """
    if not compiled:
        monkeypatch.setattr(MarchingStepper, "_made", lambda *x: 0)
    scene = fmbd.Scene("clutch")
    wheels = [fmbd.RigidBody(f"wheel {k}", 1.0, 0.2 + 0.1 * k, angular_velocity=20.0 * (1 - k)) for k in range(2)]
    scene.add(*wheels)
    for k, one in enumerate(wheels):
        scene.add(fmbd.revolute(f"bearing {k}", fmbd.ground, one, center=(0.0, 0.0)))
    slip = fmbd.angle(scene.add(fmbd.revolute("slip", *wheels, center=(0.0, 0.0))))
    scene.add(fmbd.dry_friction("clutch", slip, limit=3.0, stick=5e3, damping=5.0))
    scene.sensor("turn", fmbd.angle("bearing 1"))
    run = fmbd.solve(scene, t_end=1.5, scheme=scheme)
    # twice what the spring gives
    assert run["turn"][-1, 0] == pytest.approx(0.5 * 10.0 * 0.8**2 + 8.0 * 0.7, abs=2 * 3.0 / 5e3)


@pytest.mark.parametrize("stick", [1e4, 1e6, 1e8])
def test_own_steps_see_where_sliding_ends_after_many_turns(stick: float) -> None:
    """A clutch that slips for 118 turns: its angles' roundoff is above a share of the limit. Steps of 12 s ended stuck, going
    backwards at 25 rad/s, and the wheel was off by 6.8 rad.
    """
    scene = fmbd.Scene("clutch")
    wheels = [
        fmbd.RigidBody(f"wheel {k}", 1.0, J, angular_velocity=w) for k, (J, w) in enumerate([(0.5, 100.0), (2.0, -5.0)])
    ]
    scene.add(*wheels)
    turns = [scene.add(fmbd.revolute(f"bearing {k}", fmbd.ground, w, center=(0, 0))) for k, w in enumerate(wheels)]
    scene.add(fmbd.dry_friction("clutch", fmbd.angle(turns[0]) - fmbd.angle(turns[1]), limit=3.0, stick=stick))
    scene.sensor("turn", fmbd.angle(turns[0]))
    run = fmbd.solve(scene, t_end=25.0, scheme=fmbd.GeneralizedAlpha(rtol=1e-4))
    assert run["turn"][-1, 0] == pytest.approx(100.0 * 14.0 - 3.0 * 14.0**2 + 16.0 * 11.0, abs=2 * 3.0 / stick + 1e-4)


def test_dry_friction_holds_a_load_that_smooth_friction_lets_creep() -> None:
    load = 0.9
    found = {}
    for name in ("dry", "smooth"):
        scene, phi = wheel()
        scene.add(fmbd.effort("load", phi, lambda t: load))
        if name == "dry":
            scene.add(fmbd.dry_friction("friction", phi, limit=1.0, stick=1e4, damping=100.0))
        else:
            scene.add(fmbd.joint_friction("friction", phi, coulomb=1.0, speed=1e-2))
        run = fmbd.solve(scene, t_end=2.0, dt=5e-3)
        found[name] = run["phi"][-1, 0] - run["phi"][-201, 0]
    assert abs(found["dry"]) < 1e-9
    assert abs(found["smooth"] - 1e-2 * np.arctanh(load)) < 1e-4


def test_smooth_friction_stops_a_wheel_in_its_time() -> None:
    """J w' = -F: w falls linearly to rest at J w0 / F; work of friction = kinetic energy."""
    scene, phi = wheel(rate=4.0)
    friction = fmbd.joint_friction("friction", phi, coulomb=1.0, speed=1e-3)
    scene.add(friction)
    scene.sensor("power", fmbd.element_power(friction))
    run = fmbd.solve(scene, t_end=2.5, dt=2e-3)
    before = run.times <= 1.9
    assert np.abs(run["phi"][before, 0] - (4 * run.times - run.times**2)[before]).max() < 1e-5
    work = float(((run["power"][1:, 0] + run["power"][:-1, 0]) / 2 * np.diff(run.times)).sum())
    assert abs(work + 4.0) < 5e-3


FINDING_REST = [
    fmbd.GeneralizedAlpha(), fmbd.GeneralizedAlpha(form=fmbd.GGL()), fmbd.EnergyMomentum(), fmbd.Moreau(),
    fmbd.Radau(rtol=None), fmbd.BDF(rtol=None),
]  # fmt: skip
STEEP = {
    "dry": lambda phi, steep: fmbd.dry_friction("friction", phi, limit=1.0, stick=steep),
    "smooth": lambda phi, steep: fmbd.forces.joint_friction("friction", phi, coulomb=1.0, speed=1.0 / steep),
    "own": lambda phi, steep: fmbd.forces.joint_spring("friction", phi, law=lambda s, rate, t: np.tanh(steep * rate)),
}


@pytest.mark.parametrize("scheme", FINDING_REST, ids=lambda x: x.name)
@pytest.mark.parametrize(("law", "steep"), [("dry", 1e9), ("smooth", 1e5), ("smooth", 1e9), ("own", 1e9)])
def test_friction_of_any_steepness_costs_no_iterations(scheme: Any, law: str, steep: float) -> None:
    """A braked wheel stops after J w^2 / 2 F = 1 rad. Newton's iteration finds at once that it sticks, however steep the law is
    between sliding one way and the other, and in contact scenes too, whose matrix has the stiffness of what sticks.
    """
    scene, phi = wheel(rate=2.0)
    scene.add(STEEP[law](phi, steep))
    if isinstance(scheme, fmbd.Moreau):
        floor = fmbd.contacts.Obstacle("floor", fmbd.contacts.HalfSpace((0.0, -9.0), (0.0, 1.0)))
        scene.add(fmbd.contact("far", fmbd.ball(scene.bodies["wheel"], 0.1), floor))
    run = fmbd.solve(scene, t_end=1.5, dt=5e-3, scheme=scheme)
    assert run["phi"][-1, 0] == pytest.approx(1.0, abs=2e-2)
    assert run.counters["halved_steps"] == 0
    assert run.counters["newton_iterations"] < 3.5 * run.counters["steps"]


def on_a_belt(pull: float, w: float, v: float, t: Array) -> tuple[fmbd.Scene, Array]:
    """A mass of 1 kg between a spring and a belt with dry friction, and where it is: slides, sticks at v, breaks away again."""
    scene = fmbd.Scene("on a belt")
    mass, belt = (fmbd.RigidBody(name, 1.0, 1.0, (0.0, y)) for name, y in (("mass", 0.0), ("belt", -0.1)))
    along, turns = (fmbd.prismatic(f"{b.name} on rail", fmbd.ground, b, axis=(1, 0)) for b in (mass, belt))
    s = fmbd.displacement(along)
    scene.add(mass, belt, along, turns, fmbd.drive("drive", fmbd.displacement(turns), lambda t: v * t))
    scene.add(fmbd.joint_spring("spring", s, stiffness=w * w))
    scene.add(fmbd.dry_friction("rub", s - fmbd.displacement(turns), limit=pull, stick=1e7))
    scene.sensor("x", s)
    scene.sensor("rub", fmbd.element_effort("rub"))

    far = pull / w**2
    sticks = np.arcsin(v / (far * w)) / w
    held = far * (1.0 - np.cos(w * sticks))
    breaks = sticks + (far - held) / v
    slides = far + v / w * np.sin(w * (t - breaks))
    return scene, np.where(
        t < sticks, far * (1.0 - np.cos(w * t)), np.where(t < breaks, held + v * (t - sticks), slides)
    )


@pytest.mark.parametrize(
    "scheme, error",
    [(fmbd.BDF(2, rtol=1e-6), 3e-4), (fmbd.Radau(3, rtol=3e-5), 1e-4)],
    ids=lambda x: getattr(x, "name", ""),
)
def test_large_steps_see_that_friction_breaks_away(scheme: Any, error: float) -> None:
    """Where differences of a tangent led over the corner of the law, steps of 20 ms went on sticking: 1.2e-3 and 8.8e-4 m."""
    t = np.linspace(0.0, 2.0, 101)
    scene, x = on_a_belt(5.0, 10.0, 0.2, t)
    run = fmbd.solve(scene, t_end=2.0, scheme=scheme, output=fmbd.Output(times=t))
    assert np.abs(run["x"][:, 0] - x).max() < error


def add_rod(scene: fmbd.Scene) -> None:
    """An elastic rod that hangs beside all else."""
    elastic = fmbd.materials.linear_elastic(5e6, 0.3)
    rod = fmbd.FloatingBody("rod", fmbd.read_gmsh("meshes/rod.py", h=0.2), density=1e3, elastic=elastic)
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))


@pytest.mark.parametrize(
    "scheme, beside, compiled",
    [
        (fmbd.Radau(2, rtol=1e-5), True, True),
        (fmbd.Radau(2, rtol=1e-5), True, False),
        (fmbd.BDF(5, rtol=1e-5), False, False),
    ],
    ids=["rod", "rod, NumPy", "NumPy"],
)
def test_what_breaks_away_does_not_creep(scheme: Any, beside: bool, compiled: bool, monkeypatch: Any) -> None:
    """Beside an elastic body, and where Python makes the steps, it did: by 5e-4 m, and under BDF by 0.08 m."""
    if not compiled:
        monkeypatch.setattr(MarchingStepper, "_made", lambda *x: 0)
    t = np.linspace(0.0, 0.6, 31)
    scene, x = on_a_belt(5.0, 10.0, 0.2, t)
    if beside:
        add_rod(scene)
        scene.gravity = (0.0, 0.0)
    run = fmbd.solve(scene, t_end=0.6, scheme=scheme, output=fmbd.Output(times=t))
    assert np.abs(run["x"][:, 0] - x).max() < 1e-4


@pytest.mark.parametrize("stages, compiled", [(2, True), (3, True), (3, False)], ids=["2", "3", "3, NumPy"])
def test_steps_over_a_reversal_are_seen(stages: int, compiled: bool, monkeypatch: Any) -> None:
    """Friction that turns within 1e-4 m/s: stages left and right of it, and one in between, left nothing of the one sum that was
    looked at. Errors were up to 217 and 143 tolerances, without a compiler 64.
    """
    if not compiled:
        monkeypatch.setattr(MarchingStepper, "_made", lambda *x: 0)
    t = np.linspace(0.0, 2.0, 21)

    def rates(t: float, y: Array) -> tuple[float, float]:
        return y[1], 10.0 * np.cos(5.0 * t) - 5.0 * np.tanh(y[1] / 1e-4)

    exact = solve_ivp(rates, (0.0, 2.0), (0.0, 0.0), method="Radau", rtol=1e-8, atol=1e-10, t_eval=t, max_step=1e-2).y[
        0
    ]

    def error(rtol: float) -> float:
        scene = fmbd.Scene("pushed to and fro")
        mass = fmbd.RigidBody("mass", 1.0, 1.0, (0.0, 0.0))
        rail = fmbd.prismatic("rail", fmbd.ground, mass, axis=(1, 0))
        x = fmbd.displacement(rail)
        scene.add(mass, rail, fmbd.forces.joint_friction("rub", x, coulomb=5.0, speed=1e-4))
        scene.add(fmbd.force("push", mass, lambda t: (10.0 * np.cos(5.0 * t), 0.0)))
        scene.sensor("x", x)
        run = fmbd.solve(scene, t_end=2.0, scheme=fmbd.Radau(stages, rtol=rtol), output=fmbd.Output(times=t))
        return float(np.abs(run["x"][:, 0] - exact).max() / np.abs(exact).max() / rtol)

    errors = [error(rtol) for rtol in (np.geomspace(1e-3, 2.5e-5, 9) if compiled else (1e-3, 3e-5))]
    assert max(errors) < 60.0


def pushing(t: float) -> float:
    """10 cos 5t N."""
    return float(10.0 * np.cos(5.0 * t))


def to_and_fro(stick: float, damping: float, push: Callable[[float], float] = pushing) -> fmbd.Scene:
    """1 kg that is pushed on a rail against dry friction of 5 N."""
    scene, mass = fmbd.Scene("to and fro"), fmbd.RigidBody("mass", 1.0, 1.0, (0.0, 0.0))
    rail = fmbd.prismatic("rail", fmbd.ground, mass, axis=(1, 0))
    along = fmbd.displacement(rail)
    scene.add(mass, rail, fmbd.dry_friction("rub", along, limit=5.0, stick=stick, damping=damping))
    scene.add(fmbd.force("push", mass, lambda t: (push(t), 0.0)))
    scene.sensor("x", along)
    return scene


def exactly_to_and_fro(stick: float, damping: float, times: Array, push: Callable[[float], float] = pushing) -> Array:
    """Its place at some times, piece by piece: it sticks in p, or (``side``) slides."""
    p, side = 0.0, 0

    def spring(z: Array) -> float:
        return float(stick * (z[0] - p) + damping * z[1])

    def rates(t: float, z: Array) -> tuple[float, float]:
        return z[1], push(t) - (side * 5.0 if side else spring(z))

    def ends(t: float, z: Array) -> float:  # p goes on no more, or begins to
        return side * (z[1] + damping / stick * rates(t, z)[1]) if side else 5.0 - abs(spring(z))

    ends.terminal, ends.direction = True, -1.0  # type: ignore[attr-defined]
    given: dict[str, Any] = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13, "max_step": 2e-3, "dense_output": True}
    x, y, now = np.zeros(len(times)), np.zeros(2), 0.0
    while now < times[-1]:
        made = solve_ivp(rates, (now, times[-1]), y, events=ends, **given)
        inside = (times >= now) & (times <= made.t[-1])
        x[inside] = made.sol(times[inside])[0] if inside.any() else 0.0
        now, y = made.t[-1], made.y[:, -1]
        p, side = (y[0] - (side * 5.0 - damping * y[1]) / stick, 0) if side else (p, int(np.sign(spring(y))))
    return x


@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "NumPy"])
@pytest.mark.parametrize("stick, damping", [(1e4, 0.0), (1e5, 300.0), (1e7, 2e3)], ids=["soft", "damped", "stiff"])
def test_dry_friction_that_turns_within_a_step_keeps_the_tolerance(
    stick: float, damping: float, compiled: bool, monkeypatch: Any
) -> None:
    """Where the way goes back within a step p was that of its ends: 3 000 to 55 000 tolerances off, without a word."""
    if not compiled:
        monkeypatch.setattr(MarchingStepper, "_made", lambda *x: 0)
    t = np.linspace(0.0, 1.3, 27)
    x = exactly_to_and_fro(stick, damping, t)
    schemes = [fmbd.Radau(5, rtol=1e-7), fmbd.Radau(5, rtol=1e-5), fmbd.ExplicitRungeKutta(rtol=1e-6)]
    for scheme in [*schemes, fmbd.BDF(rtol=1e-4), fmbd.GeneralizedAlpha(rtol=1e-4)] if compiled else schemes[:2]:
        run = fmbd.solve(to_and_fro(stick, damping), t_end=1.3, scheme=scheme, output=fmbd.Output(times=t))
        assert np.abs(run["x"][:, 0] - x).max() < 300.0 * scheme.rtol * np.ptp(x), scheme.name


@pytest.mark.parametrize("rtol", [1e-3, 2e-4])
def test_what_sticks_at_both_ends_of_a_step_and_slides_within_is_seen(rtol: float) -> None:
    """The first step from rest was a sixth of the run, over a whole slide, and all that came was off by as much."""
    push = lambda t: 7.0 * np.sin(6.0 * t) * np.exp(-t)  # noqa: E731 below the limit after a sixth of the run
    t = np.linspace(0.0, 2.0, 41)
    run = fmbd.solve(
        to_and_fro(1e5, 100.0, push), t_end=2.0, scheme=fmbd.GeneralizedAlpha(rtol=rtol), output=fmbd.Output(times=t)
    )
    x = exactly_to_and_fro(1e5, 100.0, t, push)
    assert np.abs(run["x"][:, 0] - x).max() < 0.02 * np.ptp(x)


def test_an_iteration_that_fails_beside_an_elastic_body_ends() -> None:
    """BDF tried a step near the break-away again and again, with new tangents of the rod that nobody took."""
    t = np.linspace(0.0, 0.35, 18)
    scene, x = on_a_belt(5.0, 10.0, 0.2, t)
    add_rod(scene)
    asked = []

    def weightless(time: float) -> tuple[float, float]:
        asked.append(time)
        assert len(asked) < 20_000, "it is asked without end"
        return 0.0, 0.0

    scene.gravity = weightless
    run = fmbd.solve(scene, t_end=0.85, scheme=fmbd.BDF(2, rtol=1e-4), output=fmbd.Output(times=t))
    assert np.abs(run["x"][:, 0] - x).max() < 1e-3
    assert len(asked) < 5000


@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "NumPy"])
@pytest.mark.parametrize(
    "scheme", [*OWN_STEPS[2:], fmbd.Radau(3), fmbd.GeneralizedAlpha(), fmbd.EnergyMomentum()], ids=lambda x: x.name
)
def test_friction_within_steps_is_that_of_their_beginning(scheme: Any, compiled: bool, monkeypatch: Any) -> None:
    """The point where it sticks has gone ahead with the end of a step: friction pushed along, and led explicit schemes astray."""
    if not compiled:
        monkeypatch.setattr(MarchingStepper, "_made", lambda *x: 0)
    t = np.linspace(0.0, 0.8, 41)
    scene, x = on_a_belt(5.0, 10.0, 0.2, t)
    equal = {"dt": 0.013} if getattr(scheme, "rtol", None) is None else {}
    run = fmbd.solve(scene, t_end=0.8, scheme=scheme, output=fmbd.Output(times=t), **equal)
    assert np.abs(run["rub"][t > 0.35] - 5.0).max() < 1e-6
    assert np.abs(run["x"][:, 0] - x).max() < (2e-3 if equal else 3e-4)


@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "NumPy"])
@pytest.mark.parametrize(
    "scheme, told",
    [
        (fmbd.Rattle(), True), (fmbd.HalfExplicit(rtol=None), True), (fmbd.ExplicitRungeKutta(rtol=None), True),
        (fmbd.GeneralizedAlpha(), False), (fmbd.Radau(3, rtol=None), False), (fmbd.BDF(2, rtol=None), False),
    ],
    ids=lambda x: getattr(x, "name", ""),
)  # fmt: skip
def test_friction_that_does_not_hold_is_told(scheme: Any, told: bool, compiled: bool, monkeypatch: Any) -> None:
    """A brake that slid to rest crept under explicit steps of 4 ms: its stiff friction goes from limit to limit."""
    if not compiled:
        monkeypatch.setattr(MarchingStepper, "_made", lambda *x: 0)
    scene, phi = wheel(rate=2.5)
    scene.add(fmbd.dry_friction("brake", phi, limit=5.0, stick=1e7))
    scene.add(fmbd.effort("motor", phi, lambda t: 2.0 + 0.8 * t))
    run = fmbd.solve(scene, t_end=1.5, dt=4e-3, scheme=scheme)
    creep = abs(run["phi"][-1, 0] - run["phi"][len(run.times) * 3 // 4, 0])
    assert (creep > 1e-3) == told, creep
    assert any('"brake": dry friction goes from limit' in text for text in run.warnings) == told


def test_dry_friction_survives_a_checkpoint(tmp_path: Any) -> None:
    """The point where it sticks goes into the checkpoint: the restarted run is the same to the last bit."""

    def scene() -> fmbd.Scene:
        made, phi = wheel()
        made.add(fmbd.joint_spring("spring", phi, stiffness=20.0, free=1.0))
        made.add(fmbd.dry_friction("friction", phi, limit=1.8, stick=1e3))
        return made

    whole = fmbd.solve(scene(), t_end=1.0, dt=5e-3)
    plan = fmbd.Checkpoint(tmp_path, every=170, keep=9)
    fmbd.solve(scene(), t_end=1.0, dt=5e-3, checkpoint=plan)
    middle = next(p for p in sorted(tmp_path.iterdir()) if p.name.endswith("step170"))
    again = fmbd.solve(scene(), t_end=1.0, dt=5e-3, restart=middle)
    assert np.array_equal(again["phi"], whole["phi"])


def test_elastic_stop_holds_and_returns_the_energy() -> None:
    """A wheel flies between two stops without damping: speeds stay, turning points are those of the spring."""
    scene, phi = wheel(rate=2.0)
    stop = fmbd.elastic_stop("stop", phi, lower=-0.5, upper=0.5, stiffness=800.0)
    scene.add(stop)
    run = fmbd.solve(scene, t_end=1.2, dt=2e-3)
    depth = 2.0 / np.sqrt(800.0 / INERTIA)
    assert abs(run["phi"].max() - 0.5 - depth) < 3e-4
    assert abs(run["phi"].min() + 0.5 + depth) < 3e-4
    assert np.abs(run.total_energy - run.total_energy[0]).max() < 2e-2 * run.total_energy[0]


def test_motor_and_its_effort() -> None:
    """A motor on a free wheel is a damped oscillator; what it gives is J times the acceleration."""
    scene, phi = wheel()
    motor = fmbd.motor("motor", phi, target=0.8, kp=8.0, kd=1.0)
    scene.add(motor)
    for name, sensor in {
        "effort": fmbd.element_effort(motor),
        "torque": fmbd.element_torque(motor),
        "s": fmbd.elongation(motor),
        "power": fmbd.element_power(motor),
    }.items():
        scene.sensor(name, sensor)
    run = fmbd.solve(scene, t_end=2.0, dt=2e-3)
    root = np.roots((INERTIA, 1.0, 8.0))[0]
    wave = np.exp(root * run.times) * -0.8
    exact = 0.8 + wave.real - root.real / root.imag * wave.imag
    assert np.abs(run["phi"][:, 0] - exact).max() < 4e-5
    assert np.allclose(run["effort"], run["torque"], rtol=1e-12, atol=1e-12)  # the first is recorded by compiled code
    assert np.allclose(run["s"], run["phi"], rtol=0, atol=1e-14)
    gain = float(((run["power"][1:, 0] + run["power"][:-1, 0]) / 2 * np.diff(run.times)).sum())
    assert abs(gain - run.energy["kinetic"][-1]) < 3e-4  # trapezoids


def test_motor_gives_no_more_than_its_limit() -> None:
    scene, phi = wheel()
    motor = fmbd.motor("motor", phi, target=5.0, kp=80.0, limit=0.5)
    scene.add(motor)
    scene.sensor("effort", fmbd.element_effort(motor))
    run = fmbd.solve(scene, t_end=1.0, dt=1e-2)
    assert np.allclose(run["effort"], 0.5)
    assert np.abs(run["phi"][:, 0] - 0.5 * run.times**2).max() < 1e-4


def test_sensors_of_a_spring_and_a_force() -> None:
    body = fmbd.RigidBody("body", 2.0, 1.0, position=(1.5, 0.0))
    scene = fmbd.Scene("spring")
    spring = fmbd.Spring("spring", fmbd.ground, body, (0, 0), (1.5, 0), stiffness=10.0, length=1.0)
    push = fmbd.force("push", body, lambda t: (3.0, 1.0))
    scene.add(body, spring, push)
    for name, sensor in {
        "tension": fmbd.tension(spring),
        "elongation": fmbd.elongation(spring),
        "force": fmbd.element_force(spring),
        "push": fmbd.element_force(push),
    }.items():
        scene.sensor(name, sensor)
    run = fmbd.solve(scene, t_end=1e-3, dt=1e-3)
    assert abs(run["tension"][0, 0] - 5.0) < 1e-12
    assert abs(run["elongation"][0, 0] - 0.5) < 1e-12
    assert np.allclose(run["force"][0], (-5.0, 0.0))
    assert np.allclose(run["push"][0], (3.0, 1.0))


def test_bad_input_is_named() -> None:
    scene, phi = wheel()
    for make, what in (
        (lambda: fmbd.joint_friction("f", phi, coulomb=-1.0, speed=0.1), "coulomb"),
        (lambda: fmbd.joint_friction("f", phi, coulomb=1.0, speed=0.0), "speed"),
        (lambda: fmbd.joint_friction("f", phi, coulomb=1.0, speed=0.1, static=0.5), "static"),
        (lambda: fmbd.dry_friction("f", phi, limit=1.0, stick=0.0), "stick"),
        (lambda: fmbd.elastic_stop("f", phi, lower=1.0, upper=0.0, stiffness=1.0), "lower"),
        (lambda: fmbd.elastic_stop("f", phi, stiffness=1.0), "give lower"),
        (lambda: fmbd.motor("f", phi, target="far", kp=1.0), "target"),
        (lambda: fmbd.motor("f", "phi", target=1.0, kp=1.0), "fmbd.angle"),
        (lambda: fmbd.element_effort(fmbd.force("f", phi.joint.b, lambda t: (0, 0))), "no single coordinate"),
        (lambda: fmbd.element_power(phi), "force element"),
    ):
        with pytest.raises(InputError, match=what):
            make()
    forgotten = fmbd.motor("elbo", phi, target=1.0, kp=1.0)
    scene.sensor("effort", fmbd.element_effort(forgotten))
    scene.add(fmbd.motor("elbow", phi, target=1.0, kp=1.0))
    with pytest.raises(InputError, match='Did you mean "elbow"'):
        fmbd.solve(scene, t_end=0.1, dt=0.1)
