"""Laws, drives, gears and sensors on sums of joint coordinates."""

from __future__ import annotations

from typing import Any

import checkpoint_scenes
import numpy as np
import pytest
from profiled import calls_of
from test_couplings import J, wheels

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import kernel_cache
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.materials import plane_stress
from fmbd_fenicsx.post.drawing.draw import draw
from fmbd_fenicsx.system.compiled.choice import driver_states

K, START = 30.0, 0.2
ALPHA = fmbd.GeneralizedAlpha(0.95)
SCHEMES = [
    ALPHA,
    fmbd.GeneralizedAlpha(0.95, compiled=False),
    fmbd.EnergyMomentum(),
    fmbd.Rattle(),
    fmbd.HalfExplicit(),
    fmbd.Radau(),
    fmbd.BDF(),
]


def belt(**law: Any) -> tuple[fmbd.Scene, Any]:
    """Two wheels and a law on left - 2 right, which begins at 0.2: s'' = -k s (1 / J_left + 4 / J_right)."""
    scene, s = wheels()
    stretch = s["left"] - 2 * s["right"] + START
    law = law or {"stiffness": K}
    scene.add(fmbd.joint_spring("belt", stretch, **law))
    scene.sensor("stretch", stretch)
    scene.sensor("rate", fmbd.joint_rate(stretch))
    scene.sensor("effort", fmbd.element_effort(scene.forces["belt"]))
    return scene, s


FREQUENCY = float(np.sqrt(K * (1 / J["left"] + 4 / J["right"])))


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: f"{s.name} {getattr(s, 'compiled', '')}")
def test_a_spring_on_a_sum_swings_as_it_should(scheme: Any) -> None:
    def error(dt: float) -> float:
        run = fmbd.solve(belt()[0], t_end=0.3, dt=dt, scheme=scheme)
        assert run["effort"][-1] == pytest.approx(-K * run["stretch"][-1], rel=1e-9)
        assert run["left"][-1] * J["left"] == pytest.approx(-0.5 * J["right"] * run["right"][-1], rel=1e-5)
        exact = START * np.cos(FREQUENCY * 0.3), -START * FREQUENCY * np.sin(FREQUENCY * 0.3)
        return max(abs(run["stretch"][-1, 0] - exact[0]), abs(run["rate"][-1, 0] - exact[1]) / FREQUENCY)

    coarse, fine = error(6e-3), error(3e-3)
    own_steps = getattr(scheme, "rtol", None)
    assert fine < max(2 ** -(scheme.order - 0.1) * coarse, 1e-5 if own_steps else 1e-9) < 1e-2


@pytest.mark.compiled
def test_a_sum_costs_a_step_no_python() -> None:
    output = fmbd.Output(every=10**6, energy=False, progress=False)

    def run(scheme: Any, steps: int) -> int:
        return calls_of(lambda: fmbd.solve(belt()[0], t_end=1e-4 * steps, dt=1e-4, scheme=scheme, output=output))

    for scheme in (ALPHA, fmbd.EnergyMomentum(), fmbd.Rattle(), fmbd.HalfExplicit()):
        assert abs(run(scheme, 100) - run(scheme, 200)) < 20


def pulley(dim: int, law: str) -> fmbd.Scene:
    """Two links that swing, in space about skew axes, and a rope that runs from their tips over a drum."""
    z = (0.3,) * (dim - 2)
    scene, axes = fmbd.Scene("pulley", gravity=(0, -9.81, 0)[:dim]), ({} if dim == 2 else {"axis": (0, 0.6, 0.8)})
    inertia = 0.1 if dim == 2 else np.diag([0.1, 0.12, 0.09])
    link, arm = (fmbd.RigidBody(n, 1.0, inertia, position=(x, -0.4, *z)) for n, x in (("link", 0.1), ("arm", 0.4)))
    a = fmbd.revolute("a", fmbd.ground, link, center=(0, 0, *z), **axes)
    b = fmbd.revolute("b", link, arm, center=(0.2, -0.5, *z), **axes)
    rope = fmbd.segment("rope", fmbd.ground, arm, point_a=(1.0, 0.5, *z), point_b=(0.5, -0.5, *z))
    scene.add(link, arm, a, b, rope)
    phi, psi, x = fmbd.angle(a), fmbd.angle(b), fmbd.displacement(rope)
    sag = x - 0.2 * (phi - 2 * psi) - 1.0
    laws: dict[str, Any] = {
        "spring": lambda: fmbd.joint_spring("law", sag, stiffness=50.0, damping=1.0, free=0.1),
        "law": lambda: fmbd.joint_spring("law", sag, law=lambda s, rate, t: 50 * s + 20 * s**3 + rate),
        "effort": lambda: fmbd.effort("law", sag, lambda t: -5.0 * np.cos(3 * t)),
        "motor": lambda: fmbd.motor("law", sag, target=lambda t: 0.1 * t, kp=60.0, kd=2.0, limit=9.0),
        "dry": lambda: fmbd.dry_friction("law", sag, limit=2.0, stick=400.0),
        "pid": lambda: fmbd.pid("law", sag, target=0.1, gains=(40.0, 10.0, 2.0)),
        "controller": lambda: fmbd.controller(
            "law", reads={"s": sag, "phi": phi}, acts=[sag, psi], law=lambda t, y, z: (-50 * y["s"][0], y["phi"][0])
        ),
    }
    scene.add(laws[law]())
    scene.sensor("sag", sag)
    scene.sensor("power", fmbd.element_power(scene.forces["law"]))
    return scene


@pytest.mark.parametrize("law", ["spring", "law", "effort", "motor", "dry", "pid", "controller"])
@pytest.mark.parametrize("dim", [2, 3])
def test_compiled_steps_are_those_of_numpy(dim: int, law: str) -> None:
    schemes = (fmbd.GeneralizedAlpha(0.9, compiled=c) for c in (True, False))
    fast, slow = (fmbd.solve(pulley(dim, law), t_end=0.3, dt=5e-3, scheme=scheme) for scheme in schemes)
    for name in ("sag", "power"):
        assert fast[name] == pytest.approx(slow[name], abs=1e-8)
    assert fast.energy["springs"] == pytest.approx(slow.energy["springs"], abs=1e-8)
    assert fast.counters["newton_iterations"] <= slow.counters["newton_iterations"] + 6
    if kernel_cache.compiler() is not None:
        assert fast.counters["compiled_steps"] == 60


@pytest.mark.parametrize("dim", [2, 3])
def test_energy_is_kept_by_difference_quotients_of_every_term(dim: int) -> None:
    """Angles and distances beside each other, each of which turns otherwise than the sum does."""
    scene = pulley(dim, "spring")
    sag = scene.forces["law"].coordinate
    del scene.forces["law"]
    scene.add(fmbd.joint_spring("law", sag, stiffness=400.0))
    run = fmbd.solve(scene, t_end=0.4, dt=0.02, scheme=fmbd.EnergyMomentum())
    total = sum(np.ravel(run.energy[kind]) for kind in ("kinetic", "weight", "springs"))
    assert np.ptp(run.energy["springs"]) > 0.1
    assert np.ptp(total) < 1e-11


def blade(kind: str, law: str) -> fmbd.Scene:
    """An elastic blade on a pin, a link at its tip, a wheel; the law pulls at all three angles at once."""
    mesh, link = checkpoint_scenes.rod(h=0.2, height=0.04), fmbd.RigidBody("link", 1.0, 0.1, position=(1.3, 0.0))
    body: Any = fmbd.FloatingBody("blade", mesh, density=1000.0, elastic=plane_stress(1e7, 0.3))
    body = body.reduced(modes=3) if kind == "reduced" else body
    wheel = fmbd.RigidBody("wheel", 1.0, 0.2, position=(0.0, 1.0))
    scene = fmbd.Scene("blade", gravity=(0, -9.81))
    pin = fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0, 0))
    tip = fmbd.revolute("tip", body.surface("tip"), link, center=(1, 0))
    axle = fmbd.revolute("axle", fmbd.ground, wheel, center=(0, 1))
    scene.add(body, link, wheel, pin, tip, axle)
    p, q, r = (fmbd.angle(joint) for joint in (pin, tip, axle))
    if law == "spring":
        scene.add(fmbd.joint_spring("law", p - 2 * q + 0.5 * r, stiffness=200.0))
    else:
        pull = lambda t, y, z: -200.0 * np.array([1, -2, 0.5]) * (y["p"] - 2 * y["q"] + 0.5 * y["r"])  # noqa: E731
        scene.add(fmbd.controller("law", reads={"p": p, "q": q, "r": r}, acts=[p, q, r], law=pull))
    scene.sensor("sum", p - 2 * q + 0.5 * r)
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return scene


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["reduced", "floating"])
def test_sums_on_elastic_surfaces_are_laws_on_each_of_them(kind: str) -> None:
    spring, control = (
        fmbd.solve(blade(kind, law), t_end=0.05, dt=5e-3, scheme=ALPHA) for law in ("spring", "controller")
    )
    for name in ("sum", "tip"):
        assert spring[name] == pytest.approx(control[name], abs=1e-10)
    assert spring.counters["newton_iterations"] <= control.counters["newton_iterations"]


def test_equilibria_modes_and_inputs_know_sums() -> None:
    scene, s = belt()
    scene.add(fmbd.joint_spring("home", s["left"] + s["right"], stiffness=5.0))
    scene.add(fmbd.effort("push", s["right"] - 0.5 * s["left"], 0.0))
    rest = fmbd.equilibrium(scene)
    # left + right = 0 and left - 2 right + 0.2 = 0
    assert rest["left"] == pytest.approx(-START / 3, rel=1e-8)
    r = np.array([[1.0, -2.0], [1.0, 1.0]])
    squares = np.linalg.eigvals(np.diag([1 / J["left"], 1 / J["right"]]) @ r.T @ np.diag([K, 5.0]) @ r)
    found = fmbd.modes(scene, 3, at=rest)
    assert sorted((2 * np.pi * found.frequencies) ** 2)[-2:] == pytest.approx(sorted(squares.real), rel=1e-7)
    # of a unit effort on right - left / 2, where it is fast: s'' = M^-1 c
    answer = fmbd.frequency_response(scene, ["push"], ["left", "right"], [1e3], at=rest)[0, :, 0]
    assert -1e6 * answer == pytest.approx([-0.5 / J["left"], 1 / J["right"]], rel=1e-2)


def test_drives_and_couplings_take_sums() -> None:
    scene, s = wheels()
    scene.add(fmbd.couple("gears", s["left"] + s["right"] - 2 * s["cage"] + 0.3))
    scene.add(fmbd.drive("drive", s["left"] - 3 * s["right"] + 0.1, lambda t: 0.1 + t**2))
    scene.add(fmbd.effort("engine", s["cage"], 1.0))
    run = fmbd.solve(scene, t_end=0.1, dt=1e-2)
    left, right, cage = (float(run[name][-1, 0]) for name in ("left", "right", "cage"))
    assert left + right - 2 * cage == pytest.approx(0.0, abs=1e-13)
    assert left - 3 * right == pytest.approx(0.01, abs=1e-12)


def test_sums_are_written_as_one_would() -> None:
    _, s = wheels()
    a, b = s["left"], s["right"]
    x = fmbd.displacement(fmbd.segment("x", fmbd.ground, a.joint.b, point_a=(1, 1), point_b=(0, 0)))
    for made, factors, offset, unit in [
        (1 - (a - b) / 2 + a, {a: 0.5, b: 0.5}, 1.0, "rad"),
        (np.float64(2.0) * a - 3 * b - a, {a: 1.0, b: -3.0}, 0.0, "rad"),
        (x - 0.05 * a, {x: 1.0, a: -0.05}, 0.0, "m"),
        (a - x / 0.05, {a: 1.0, x: -20.0}, 0.0, "rad"),
        (2 * x + 0.1 * a, {x: 2.0, a: 0.1}, 0.0, "m"),
    ]:
        assert {t.joint.name: c for t, c in made.terms} == pytest.approx({t.joint.name: c for t, c in factors.items()})
        assert (made.offset, made.unit) == (offset, unit)


def test_sums_that_mean_nothing_are_refused() -> None:
    scene, s = belt()
    a, b = s["left"], s["right"]
    strand = fmbd.segment("strand", fmbd.ground, a.joint.b, point_a=(1, 1), point_b=(0, 0))
    with pytest.raises(InputError, match="an angle in rad.*a length in m.*radius \\* angle"):
        a + fmbd.displacement(strand)
    with pytest.raises(InputError, match="constant"):
        a - a
    with pytest.raises(InputError, match="divided by zero"):
        a / 0
    with pytest.raises(InputError, match="must be"):
        a + "b"  # type: ignore[operator]
    with pytest.raises(InputError, match='element_force: "belt" acts on the sum of 2 coordinates.*element_effort'):
        fmbd.element_force(scene.forces["belt"])
    with pytest.raises(InputError, match='"stop" stops one joint coordinate'):
        fmbd.joint_limit("stop", a - b, lower=-1.0)
    shifted = fmbd.joint_limit("stop", a + 0.5, lower=-1.0, upper=2.0)
    assert (shifted.lower, shifted.upper) == (-1.5, 1.5)
    other = fmbd.Scene("other")
    other.add(a.joint.b, a.joint)
    other.sensor("sum", a + b)
    with pytest.raises(InputError, match='"sum".*"axle right"'):
        fmbd.solve(other, t_end=0.1, dt=0.1)


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
def test_efforts_on_a_sum_are_stiff_across_as_those_on_its_terms(dim: int) -> None:
    """The driver's matrix with an effort on a sum, and with efforts on each of its terms."""

    def answers(*, apart: bool) -> Any:
        scene = pulley(dim, "spring")
        sag = scene.forces["law"].coordinate
        del scene.forces["law"]
        scene.sensors.clear()
        if apart:
            scene.add(*(fmbd.effort(f"law {k}", s, -200.0 * c) for k, (s, c) in enumerate(sag.terms)))
        else:
            scene.add(fmbd.effort("law", sag, -200.0))
        system, state, _ = scene.build()
        states = driver_states(system)
        assert states is not None and states.factor.prepare(states.at(0.0, state.q, state.v), 0.0, 0.01)
        return np.array([states.factor.solve(b, np.zeros(system.n_lam))[0] for b in np.eye(system.n_v)])

    together = answers(apart=False)
    assert together == pytest.approx(answers(apart=True), abs=1e-10 * np.abs(together).max())


@pytest.mark.parametrize("law", ["spring", "effort", "dry"])
def test_scenes_with_sums_are_checked_and_drawn(law: str) -> None:
    scene = pulley(2, law)
    scene.check()
    run = fmbd.solve(scene, t_end=0.02, dt=0.01, output=fmbd.Output(snapshots=2, progress=False))
    assert draw(run).pieces
