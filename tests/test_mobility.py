"""Mobility and redundancy, singular configurations, contradicting joints, locked and loose bodies, mass ratios."""

from __future__ import annotations

import logging
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from dae_problems import parallelograms

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConstraintError, LinearSolveError
from fmbd_fenicsx.linear import configuration_warnings
from fmbd_fenicsx.linear.configuration_warnings import CLOSE, NearSingular
from fmbd_fenicsx.matrices import singular_values
from fmbd_fenicsx.schemes.marching import MarchingStepper
from fmbd_fenicsx.system import dependence
from fmbd_fenicsx.system.dependence import rows_are_independent
from fmbd_fenicsx.system.mobility import Mobility, nearly_dependent

BAR = (0.01, 0.08, 0.08)


def four_bar(hinges: str = "rrrr", gap: float = 0.0) -> fmbd.Scene:
    """A parallelogram in space with revolute ("r") or spherical ("s") and universal-free hinges; ``gap`` opens the last."""
    scene = fmbd.Scene("four-bar", gravity=(3.0, -9.81, 0))
    left = fmbd.RigidBody("left", 1.0, (0.08, 0.01, 0.08), position=(0, 0.5, 0))
    top = fmbd.RigidBody("top", 1.0, BAR, position=(0.5, 1, 0))
    right = fmbd.RigidBody("right", 1.0, (0.08, 0.01, 0.08), position=(1, 0.5, 0))
    scene.add(left, top, right)
    ends = [
        ("A", fmbd.ground, left, (0, 0, 0)),
        ("B", left, top, (0, 1, 0)),
        ("C", top, right, (1, 1, 0)),
        ("D", fmbd.ground, right, (1, 0, 0)),
    ]
    for kind, (name, a, b, c) in zip(hinges, ends, strict=True):
        scene.add(fmbd.revolute(name, a, b, center=c) if kind == "r" else fmbd.spherical(name, a, b, center=c))
    if gap:
        scene.add(fmbd.distance("strut", left, right, point_a=(0, 0, 0), point_b=(1, 0, 0), length=1.0 + gap))
    scene.sensor("x", fmbd.position(top))
    return scene


def test_rank_of_the_four_bar() -> None:
    """20 rows, rank 17, 18 velocities: 3 redundant, 1 degree of freedom."""
    found = four_bar().check()
    assert (found.velocities, found.rows, found.rank, found.redundant, found.freedom) == (18, 20, 17, 3, 1)
    assert set(found.shares) == {"A", "B", "C", "D"}
    assert abs(sum(found.shares.values()) - 3) < 1e-9


def test_rank_does_not_depend_on_units() -> None:
    scene = four_bar()
    small = fmbd.Scene("small")
    k = 1e-5
    left = fmbd.RigidBody("left", 1e-9, tuple(1e-9 * k * k * x for x in (0.08, 0.01, 0.08)), position=(0, 0.5 * k, 0))
    right = fmbd.RigidBody("right", 1e-9, tuple(1e-9 * k * k * x for x in BAR), position=(0.5 * k, k, 0))
    small.add(left, right, fmbd.revolute("A", fmbd.ground, left, center=(0, 0, 0)))
    small.add(
        fmbd.revolute("B", left, right, center=(0, k, 0)),
        fmbd.revolute("B2", left, right, center=(0, k, 0.2 * k)),
    )
    found = small.check()
    assert (found.redundant, found.freedom) == (5, 2)
    assert scene.check().conditioning > 0.1
    assert any("m long" in note for note in found.notes)


def test_what_bodies_weigh_makes_no_rows_depend() -> None:
    """Links of 1e-8 and 1e8 kg: by their masses rows of the light ones differ by 1e-10 of the largest."""
    scene, last = fmbd.Scene("links", gravity=(0, 0, -9.81)), fmbd.ground
    for i, mass in enumerate((1e-8, 1e8, 1e-8, 1e8)):
        link = fmbd.RigidBody(f"link {i}", mass, tuple(mass * x for x in BAR), position=(i + 0.5, 0, 0))
        scene.add(link, fmbd.revolute(f"hinge {i}", last, link, center=(i, 0, 0), axis=(0, 1, 0)))
        last = link
    found = scene.check()
    assert (found.redundant, found.freedom) == (0, 4) and found.conditioning > 1e-2


def test_period_of_springs_has_one_unit() -> None:
    """A spring of k N/m, and one of k l^2 N m/rad on an angle, l the model's length, are as fast as each other."""
    said = []
    for turning in (False, True):
        bob = fmbd.RigidBody("bob", 1.0, 0.1, position=(4, 0))
        pin = fmbd.revolute("pin", fmbd.ground, bob, center=(0, 0))
        scene = fmbd.Scene("bob", gravity=(0, -9.81))
        scene.add(bob, pin)
        k = 100.0 * scene.build()[0].length ** 2 if turning else 100.0
        spring = fmbd.Spring("s", fmbd.ground, bob, (4, 1), (4, 0), stiffness=k)
        scene.add(fmbd.joint_spring("s", fmbd.angle(pin), stiffness=k) if turning else spring)
        said += [note for note in scene.check().notes if "shortest period" in note]
    assert len(said) == 2 and said[0] == said[1] and "about 0.63 s" in said[0]


def test_friction_that_is_a_spring_is_told() -> None:
    """The stiffness before sliding is easily taken for the way."""
    for stick, told in ((1e-4, True), (200.0, False)):
        wheel = fmbd.RigidBody("wheel", 0.5, 2e-4)
        hinge = fmbd.revolute("hinge", fmbd.ground, wheel, center=(0, 0))
        scene = fmbd.Scene("wheel")
        scene.add(wheel, hinge, fmbd.dry_friction("brake", fmbd.angle(hinge), limit=0.02, stick=stick))
        assert told == any('"brake" is a spring for 200 rad' in note for note in scene.check().notes)


def test_joints_without_a_share_are_not_listed() -> None:
    shares = {"real": 0.5, "roundoff": 4e-3}
    text = str(Mobility(6, 3, 2, shares, 1.0, 0.0))
    assert '"real" takes part with 0.50 rows' in text and "roundoff" not in text


def test_duplicated_joint_is_redundant() -> None:
    """All rows of a copy are redundant, and the two joints share them."""
    rod = fmbd.RigidBody("rod", 1.0, BAR, position=(0.5, 0, 0))
    scene = fmbd.Scene("twice")
    scene.add(rod)
    for name in ("one", "two"):
        scene.add(fmbd.revolute(name, fmbd.ground, rod, center=(0, 0, 0)))
    found = scene.check()
    assert (found.redundant, found.freedom) == (5, 1)
    assert found.shares["one"] == pytest.approx(2.5) and found.shares["two"] == pytest.approx(2.5)
    assert 'joint "one"' in str(found)


def test_redundant_mechanism_moves_as_the_one_without() -> None:
    """Positions to 1e-9; forces of the redundant group add up to the same."""
    runs = []
    # rsrs: 5 + 3 + 5 + 3 rows of rank 16 leave 2: the top may not turn about itself
    for hinges in ("rrrr", "rsrs"):
        scene = four_bar(hinges)
        if hinges == "rsrs":
            scene = four_bar("rrrr")
            scene.joints.clear()
            left, top, right = scene.bodies.values()
            scene.add(
                fmbd.revolute("A", fmbd.ground, left, center=(0, 0, 0)),
                fmbd.revolute("B", left, top, center=(0, 1, 0)),
            )
            scene.add(fmbd.point_on_line("C", right, top, axis=(0, 0, 1), center=(1, 1, 0)))
            scene.add(fmbd.revolute("D", fmbd.ground, right, center=(1, 0, 0)))
            assert scene.check().redundant == 0
        scene.sensor("A", fmbd.reaction_force("A"))
        scene.sensor("D", fmbd.reaction_force("D"))
        runs.append(fmbd.solve(scene, t_end=1.0, dt=5e-3, newton=fmbd.Newton(1e-9)))
    a, b = runs
    assert np.abs(a["x"] - b["x"]).max() < 1e-9
    total = [r["A"] + r["D"] for r in runs]
    assert np.abs(total[0] - total[1]).max() < 1e-8 * np.abs(total[0]).max()
    assert np.ptp(a["x"][:, 0]) > 0.3


def test_contradicting_redundancy_is_refused() -> None:
    """A strut between points that the hinges hold 1 m apart, 1e-4 m too long."""
    with pytest.raises(ConstraintError, match="contradict each other.*stays open"):
        fmbd.solve(four_bar(gap=1e-4), t_end=0.1, dt=0.01)


@pytest.mark.parametrize("gap", [1e-4, 1e-2])
def test_open_joints_are_told_as_a_run_takes_them(gap: float) -> None:
    """The start closes small gaps and refuses others; the latter were told to be closed."""
    scene = fmbd.Scene("hung")
    bob = fmbd.RigidBody("bob", 1.0, 0.1, (1.0, 0.0))
    scene.add(bob, fmbd.distance("rod", fmbd.ground, bob, point_a=(0, 0), length=1.0 + gap))
    told = " ".join(scene.check().notes)
    assert ("the start of a run closes them" in told) == (gap < 1e-3)
    assert ("a run refuses them" in told) == (gap > 1e-3)
    if gap > 1e-3:
        with pytest.raises(ConstraintError, match="do not fit together"):
            fmbd.solve(scene, t_end=0.01, dt=0.01)


def test_contradicting_drives_are_refused() -> None:
    wheel = fmbd.RigidBody("wheel", 1.0, 1.0)
    scene = fmbd.Scene("two drives")
    hinge = fmbd.revolute("hinge", fmbd.ground, wheel, center=(0, 0))
    scene.add(wheel, hinge)
    scene.add(
        fmbd.drive("one", fmbd.angle(hinge), lambda t: 2 * t),
        fmbd.drive("two", fmbd.angle(hinge), lambda t: 3 * t),
    )
    with pytest.raises(ConstraintError, match="Velocities contradict.*drive"):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


def slider_crank(ratio: float, angle: float, speed: float) -> fmbd.Scene:
    """Planar slider crank with arms 1 and ``ratio``, crank at ``angle`` with the angular velocity ``speed``."""
    inner = np.arcsin(np.sin(angle) / ratio)
    rate = speed * np.cos(angle) / (ratio * np.cos(inner)) if abs(np.cos(inner)) > 1e-12 else speed
    end = np.array([np.cos(angle), np.sin(angle)])
    middle = end + 0.5 * ratio * np.array([np.cos(inner), -np.sin(inner)])
    slider = np.array([np.cos(angle) + ratio * np.cos(inner), 0.0])
    spin = lambda w, x: w * np.array([-x[1], x[0]])  # noqa: E731
    crank = fmbd.RigidBody("crank", 1.0, 1 / 12, end / 2, angle, spin(speed, end / 2), speed)
    rod = fmbd.RigidBody(
        "rod", ratio, ratio**3 / 12, middle, -inner, spin(speed, end) + spin(-rate, middle - end), -rate
    )
    block = fmbd.RigidBody("block", 1.0, 0.1, slider, 0.0, (-speed * np.sin(angle) - ratio * rate * np.sin(inner), 0.0))
    scene = fmbd.Scene("slider crank")
    scene.add(crank, rod, block)
    scene.add(
        fmbd.revolute("main", fmbd.ground, crank, center=(0, 0)),
        fmbd.revolute("pin", crank, rod, center=end),
        fmbd.revolute("wrist", rod, block, center=slider),
        fmbd.prismatic("slider", fmbd.ground, block, axis=(1, 0), center=slider),
    )
    scene.sensor("slider", fmbd.position(block))
    scene.sensor("pin", fmbd.position(crank, point=end))
    return scene


@pytest.mark.parametrize("distance, expected", [(1.0, 2.47e-2), (0.1, 2.47e-3), (0.01, 2.47e-4)])
def test_conditioning_at_the_dead_centre(distance: float, expected: float) -> None:
    """With equal arms sigma_min falls linearly with the distance (degrees) from the dead centre at 90 degrees."""
    found = slider_crank(1.0, np.radians(90.0 - distance), 1.0).check()
    near = slider_crank(1.0, np.radians(90.0 - distance / 2), 1.0).check()
    assert found.freedom == 1
    assert found.conditioning / near.conditioning == pytest.approx(2.0, rel=0.01)
    assert 0.2 * expected < found.conditioning < 5 * expected


@pytest.mark.parametrize("phase", np.arange(20) / 20)
def test_released_through_the_dead_centre(phase: float) -> None:
    """Equal arms, 20 phases of the time grid: no failure, no change of branch; the energy error over two dead centres is
    at most three times that of arms 1 : 1.2, which has none.
    """
    error = {}
    for arms in (1.0, 1.2):
        run = fmbd.solve(slider_crank(arms, 1.2 + phase * 0.03, 3.0), t_end=3.0, dt=1e-2)
        e = run.energy["kinetic"]
        error[arms] = float(np.abs(e - e[0]).max() / e[0])
        if arms == 1.0:
            assert np.abs(run["slider"][:, 0] - 2 * run["pin"][:, 0]).max() < 1e-7  # no fold onto the crank
            assert run["pin"][:, 0].min() < -0.99 and run["pin"][-1, 0] > 0.2
    assert 1e-3 < error[1.0] < 3 * error[1.2]


def energy_at(arms: float, angle: float) -> float:
    """Kinetic energy at a crank angle for the angular velocity 3; stretched branch."""
    if arms != 1.0:
        system, state, _ = slider_crank(arms, angle, 3.0).build()
        return float(system.at(0.0, state.q, state.v).energies()["kinetic"])
    s2, c2 = np.sin(angle) ** 2, np.cos(angle) ** 2
    return 4.5 * float(1 / 3 + (2.25 * s2 + 0.25 * c2) + 1 / 12 + 4 * s2)  # crank, rod, block


@pytest.mark.parametrize("phase", [0.0, 1e-6, *(np.arange(1, 20) / 20)])
def test_driven_through_the_dead_centre(phase: float, caplog: pytest.LogCaptureFixture) -> None:
    """With phase 0 a step ends in the singular configuration itself: one line names the joint and the time. The kinetic
    energy, known from the crank's angle, has at most three times the error of arms 1 : 1.2.
    """
    runs, errors = {}, {}
    start = np.pi / 2 - 0.15 - phase * 0.015
    with caplog.at_level(logging.WARNING, "fmbd_fenicsx"):
        for arms in (1.0, 1.2):
            scene = slider_crank(arms, start, 3.0)
            scene.add(fmbd.drive("motor", fmbd.angle(scene.joints["main"]), lambda t: 3 * t))
            runs[arms] = run = fmbd.solve(scene, t_end=0.1, dt=5e-3)
            exact = np.array([energy_at(arms, start + 3 * t) for t in run.times])
            errors[arms] = float(np.abs(run.energy["kinetic"] / exact - 1).max())
    run = runs[1.0]
    assert np.abs(run["slider"][:, 0] - 2 * run["pin"][:, 0]).max() < (1e-5 if phase < 1e-4 else 1e-7)
    assert errors[1.0] < 3 * errors[1.2] < 1e-3
    lines = [r.getMessage() for r in caplog.records if "near-singular" in r.getMessage()]
    assert len(lines) == (phase < 1e-4)
    if lines:
        assert 'joint "' in lines[0] and "t = 0.05 s" in lines[0]


def test_singular_values_where_a_factor_is_not_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps that lose gaps to roundoff far from singular positions ask for no singular values; near the dead centre they do."""
    asked = []

    def counted(ev: Any, rank: int, **how: bool) -> tuple[float, str]:
        asked.append(nearly_dependent(ev, rank, **how))
        return asked[-1]

    monkeypatch.setattr(configuration_warnings, "nearly_dependent", counted)
    near = NearSingular()
    for off in (0.8, 0.3, 1e-2, 1e-4, 1e-6):
        system, state, _ = slider_crank(1.0, np.pi / 2 - off, 3.0).build()
        ev = system.at(state.t, state.q, state.v)
        asked.clear()
        near.look(ev, None, limit=CLOSE)
        ratio = nearly_dependent(ev, system.n_lam)[0]
        assert near.now == (ratio < CLOSE)
        assert ratio < 10 * CLOSE if asked else ratio > CLOSE
        assert rows_are_independent(ev, CLOSE) != bool(asked) and not rows_are_independent(ev, 10 * ratio)


SCHEMES = [fmbd.ExplicitRungeKutta(), fmbd.Radau(), fmbd.BDF(), fmbd.GeneralizedAlpha(rtol=1e-4, compiled=False)]


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name.split("(")[0])
@pytest.mark.parametrize("accepted", [False, True])
def test_near_singular_is_said_of_accepted_steps(
    scheme: Any, accepted: bool, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A trial that meets the dead centre is given up, or counts."""
    dead, state, _ = slider_crank(1.0, np.pi / 2, 3.0).build()
    begin, first = NearSingular.begin_trial, [True]

    def trial(near: NearSingular) -> None:
        begin(near)
        if first:
            first.clear()
            near.look(dead.at(state.t, state.q, state.v), None)
            if not accepted:
                begin(near)

    monkeypatch.setattr(NearSingular, "begin_trial", trial)
    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)  # trials of Python
    fmbd.solve(slider_crank(1.0, 0.3, 3.0), t_end=0.01, scheme=scheme, output=fmbd.Output(progress=False))
    said = [r.getMessage() for r in caplog.records if "near-singular" in r.getMessage()]
    assert not first and len(said) == accepted


def test_locked_body_leaves_the_system() -> None:
    """The same pendulum on the ground and on a locked body; the locked body has no unknowns."""
    ends = []
    for locked in (False, True):
        rod = fmbd.RigidBody("rod", 1.0, 0.1, position=(0.5, 0.0))
        scene = fmbd.Scene("locked", gravity=(0, -9.81))
        base = fmbd.RigidBody("base", 5.0, 1.0, position=(-1.0, 0.3), rotation=0.4, locked=True)
        scene.add(rod)
        if locked:
            scene.add(base)
        scene.add(fmbd.revolute("pin", base if locked else fmbd.ground, rod, center=(0, 0)))
        scene.sensor("x", fmbd.position(rod))
        system, *_ = scene.build()
        assert system.n_core == 3
        ends.append(fmbd.solve(scene, t_end=0.5, dt=5e-3)["x"][-1])
    assert np.abs(ends[0] - ends[1]).max() < 1e-13


def test_loose_body_is_mentioned(caplog: pytest.LogCaptureFixture) -> None:
    scene = four_bar()
    scene.add(fmbd.RigidBody("forgotten", 1.0, BAR, position=(3, 0, 0)))
    assert any('"forgotten"' in note for note in scene.check().notes)
    with caplog.at_level(logging.WARNING, "fmbd_fenicsx"):
        scene.build()
    assert any('"forgotten"' in r.getMessage() for r in caplog.records)


@pytest.mark.parametrize("light", [1e-9, 1e-6, 1e6, 1e9])
def test_mass_ratios(light: float) -> None:
    """A rod of mass ratio ``light`` between two bodies; the tip follows the model with that mass reduced.

    Two rods in line hanging from a pin, the second held straight by a weld: one compound pendulum.
    """
    m1, m2 = 1.0, light
    scene = fmbd.Scene("ratio", gravity=(0, -9.81))
    one = fmbd.RigidBody("one", m1, m1 / 12, position=(0.5, 0))
    two = fmbd.RigidBody("two", m2, m2 / 12, position=(1.5, 0))
    scene.add(
        one,
        two,
        fmbd.revolute("pin", fmbd.ground, one, center=(0, 0)),
        fmbd.fixed("weld", one, two, center=(1, 0)),
    )
    scene.sensor("tip", fmbd.position(two, point=(2.0, 0.0)))
    scene.sensor("pin", fmbd.reaction_force("pin"))
    run = fmbd.solve(scene, t_end=0.5, dt=5e-3, newton=fmbd.Newton(1e-10))
    m, s = m1 + m2, (0.5 * m1 + 1.5 * m2) / (m1 + m2)
    J = m1 / 3 + m2 * (1 / 12 + 2.25) - m * s * s
    whole = fmbd.Scene("whole", gravity=(0, -9.81))
    body = fmbd.RigidBody("body", m, J, position=(s, 0))
    whole.add(body, fmbd.revolute("pin", fmbd.ground, body, center=(0, 0)))
    whole.sensor("tip", fmbd.position(body, point=(2.0, 0.0)))
    whole.sensor("pin", fmbd.reaction_force("pin"))
    ref = fmbd.solve(whole, t_end=0.5, dt=5e-3, newton=fmbd.Newton(1e-10))
    assert np.abs(run["tip"] - ref["tip"]).max() < 1e-8 * 2.0
    assert np.abs(run["pin"] - ref["pin"]).max() < 1e-6 * np.abs(ref["pin"]).max()


@pytest.mark.parametrize("held", [False, True])
def test_massless_coordinate(held: bool) -> None:
    """A coordinate without mass is solved when a joint holds it, and refused by the name of its body when none does."""
    body = fmbd.CoordinateBody(
        "ghost",
        np.diag([2.0, 0.0]),
        lambda q, v, t: np.array([-9.81 * 2.0, 0.0]) + 0 * q,
        [0.0, 0.0],
        constraint=(lambda q, t: q[:1] + q[1:]) if held else None,
    )
    scene = fmbd.Scene("massless")
    scene.add(body)
    scene.sensor("q", fmbd.coordinates(body))
    if not held:
        with pytest.raises(LinearSolveError, match='Body "ghost".*without mass'):
            fmbd.solve(scene, t_end=0.1, dt=0.01)
        return
    run = fmbd.solve(scene, t_end=0.1, dt=0.01)
    assert np.abs(run["q"][-1] - [-0.5 * 9.81 * 0.01, 0.5 * 9.81 * 0.01]).max() < 1e-10


def rotor(light: float | None) -> fmbd.Run:
    """A spinning rotor at the end of a shaft of mass ratio ``light`` that hangs in a ball joint; None: without the shaft."""
    c, s = np.cos(0.6), np.sin(0.6)
    R, end, spin = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), 0.5 * np.array([s, 0, c]), np.array([0.3, 0.0, 30.0])
    scene = fmbd.Scene("rotor", gravity=(0, 0, -9.81))
    J, v = (0.01, 0.01, 0.02), np.cross(R @ spin, end)
    body = fmbd.RigidBody("rotor", 2.0, J, position=end, rotation=R, angular_velocity=spin, velocity=v)
    scene.add(body)
    if light is None:
        scene.add(fmbd.spherical("pin", fmbd.ground, body, center=(0, 0, 0)))
    else:
        m, slow = 2.0 * light, np.array([0.3, 0.0, 0.0])
        J, v = (m / 48, m / 48, 1e-4 * m), np.cross(R @ slow, end / 2)
        shaft = fmbd.RigidBody("shaft", m, J, position=end / 2, rotation=R, angular_velocity=slow, velocity=v)
        scene.add(shaft, fmbd.spherical("pin", fmbd.ground, shaft, center=(0, 0, 0)))
        scene.add(fmbd.revolute("bearing", shaft, body, center=end, axis=end / 0.5))
    scene.sensor("tip", fmbd.position(body))
    scene.sensor("pin", fmbd.reaction_force("pin"))
    return fmbd.solve(scene, t_end=0.2, dt=2e-3)


def test_heavy_rotor_on_a_light_shaft() -> None:
    """A shaft of a billionth of the rotor's mass; the rotor moves as a top without it."""
    top, run = rotor(None), rotor(1e-9)
    assert np.ptp(top["tip"][:, 0]) > 0.05
    assert np.abs(run["tip"] - top["tip"]).max() < 1e-8 * 0.5
    assert np.abs(run["pin"] - top["pin"]).max() < 1e-6 * np.abs(top["pin"]).max()


def bob_on_elastic_rod(mesh: Any, density: float) -> fmbd.Scene:
    """A bob of 2 kg at the end of a clamped elastic rod, pulled along the rod by a weight that sets in smoothly."""
    scene = fmbd.Scene("bob", gravity=(9.81, 0), gravity_ramp=0.1)
    bob = fmbd.RigidBody("bob", 2.0, 0.1, position=(1.0, 0.0))
    soft = fmbd.materials.linear_elastic(1e5, 0.3)
    rod = fmbd.AbsoluteBody("rod", mesh, degree=2, density=density, elastic=soft)
    scene.add(bob, rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))
    scene.add(fmbd.fixed("weld", rod.surface("tip"), bob))
    scene.sensor("clamp", fmbd.reaction_force("clamp"))
    scene.sensor("bob", fmbd.position(bob))
    return scene


def test_elastic_body_almost_without_mass(rod_mesh: Any) -> None:
    """An elastic rod of 1e-7 of the bob's mass is the spring of its static compliance; with 1e-14 the run is refused."""
    mesh = rod_mesh(dim=2, h=0.25, height=0.2)
    still = bob_on_elastic_rod(mesh, 1e-6)
    still.gravity_ramp, still.settle = 0.0, True
    stretch = fmbd.solve(still, t_end=1e-3, dt=1e-3)["bob"][0, 0] - 1.0
    ideal = fmbd.Scene("spring", gravity=(9.81, 0), gravity_ramp=0.1)
    bob = fmbd.RigidBody("bob", 2.0, 0.1, position=(1.0, 0.0))
    guide = fmbd.prismatic("guide", fmbd.ground, bob, axis=(1, 0), center=(1, 0))
    k = 2.0 * 9.81 / stretch
    ideal.add(bob, guide, fmbd.joint_spring("rod", fmbd.displacement(guide), stiffness=k))
    ideal.sensor("bob", fmbd.position(bob))
    run, ref = (fmbd.solve(s, t_end=0.2, dt=2e-3) for s in (bob_on_elastic_rod(mesh, 1e-6), ideal))
    x = ref["bob"][:, 0] - 1.0
    assert np.ptp(x) > stretch
    assert np.abs(run["bob"] - ref["bob"]).max() < 1e-8
    assert np.abs(run["clamp"][:, 0] - k * x).max() < 1e-6 * k * x.max()
    with pytest.raises(LinearSolveError, match='body "rod"'):
        fmbd.solve(bob_on_elastic_rod(mesh, 1e-13), t_end=0.2, dt=2e-3)


def test_many_dependent_rows_move_as_few_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows that are too many to be counted, of four-bars in space with four hinges each: without singular values."""
    scene = fmbd.Scene("four-bars", gravity=(0, 0, -9.81))
    for i in range(8):
        corners = np.array([(i, 0, 0), (i + 0.1, 0, 0.2), (i + 0.4, 0, 0.25), (i + 0.3, 0, 0)], float)
        bars = [
            fmbd.RigidBody(f"{i} {k}", 1.0, (0.01, 0.01, 0.01), (corners[k] + corners[k + 1]) / 2) for k in range(3)
        ]
        scene.add(*bars)
        for k, (a, b) in enumerate(pairwise([fmbd.ground, *bars, fmbd.ground])):
            scene.add(fmbd.revolute(f"hinge {i} {k}", a, b, center=corners[k], axis=(0, 1, 0)))
    scene.sensor("coupler", fmbd.position(bars[1]))
    few = fmbd.solve(scene, t_end=0.02, dt=1e-3)["coupler"]
    monkeypatch.setattr(configuration_warnings, "LOOK_LIMIT", 100)
    many = fmbd.solve(scene, t_end=0.02, dt=1e-3)["coupler"]
    assert np.ptp(few[:, 0]) > 1e-4
    np.testing.assert_allclose(many, few, rtol=0.0, atol=1e-9)


def test_singular_values_that_do_not_converge_are_found_the_slow_way(monkeypatch: pytest.MonkeyPatch) -> None:
    given = four_bar().check()

    def fails(*_: Any, **__: Any) -> None:
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", fails)
    found = four_bar().check()
    assert (found.rank, found.rows) == (given.rank, given.rows)
    with pytest.raises(LinearSolveError, match="not finite"):
        singular_values(np.full((2, 2), np.nan))


@pytest.mark.parametrize("height", [0.0, 1e-9])
def test_many_rows_are_looked_at_by_a_sparse_factor(height: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tower of four-bar loops in space, one of them with a hinge out of place by that: three rows of each depend on others."""
    scene = fmbd.Scene("tower", gravity=(0.0, 0.0, -9.81))
    low: Any = fmbd.ground
    for k in range(8):
        top = fmbd.RigidBody(f"top {k}", 1.0, np.eye(3), (0.5, 0.0, k + 1.0))
        scene.add(top)
        for i, x in enumerate((0.0, 1.0)):
            leg = fmbd.RigidBody(f"leg {k} {i}", 1.0, np.eye(3), (x, 0.0, k + 0.5))
            scene.add(leg)
            for name, a, b, z in (("low", low, leg, k), ("high", leg, top, k + 1.0)):
                off = height if k + i == 0 else 0.0
                scene.add(fmbd.revolute(f"{name} {k} {i}", a, b, center=(x, off, z), axis=(off, 1.0, 0.0)))
        low = top

    dense = scene.check()
    monkeypatch.setattr(dependence, "FEW_ROWS", 16)
    sparse = scene.check()
    system, state, _ = scene.build()
    G = dependence.scaled_jacobian(system.at(state.t, state.q))
    assert dense.redundant == 24 == dependence._below(G, dependence.NEAR_SINGULAR) and dense.freedom == 8
    assert sum(dense.weakest.values()) == pytest.approx(1.0)
    assert sparse.rank == dense.rank
    assert sparse.shares == pytest.approx(dense.shares, rel=1e-6)
    assert sparse.conditioning == pytest.approx(dense.conditioning, rel=1e-3)
    assert sparse.misfit == pytest.approx(dense.misfit, rel=1e-3, abs=1e-14)


def test_mobility_of_the_flat_double_four_bar() -> None:
    """One degree of freedom, three where it lies flat as far as a step could tell; beside it, it is near-singular but regular."""
    assert parallelograms(2, 0.0, np.pi / 2).check().freedom == 1
    assert parallelograms(2, 0.0, 0.0).check().freedom == 3
    hair = parallelograms(2, 0.0, 1e-7).check()
    assert hair.freedom == 3 and 1e-9 < hair.misfit < 1e-7
    assert any("count as the same" in note for note in hair.notes)
    close = parallelograms(2, 0.0, 1e-5).check()
    assert close.freedom == 1 and close.conditioning < 1e-6
    assert any("near-singular" in note for note in close.notes)


@pytest.mark.mpi
def test_doubled_joint_on_an_elastic_surface(rod_mesh: Any) -> None:
    """The copy on the same trace is redundant, both pins carry half; motion as with one pin."""
    from motion import elastic_rod

    runs = []
    for copies in (1, 2):
        rod = elastic_rod(rod_mesh(dim=2, h=0.3, height=0.2))
        scene = fmbd.Scene("rod", gravity=(0, -9.81))
        scene.add(rod)
        for i in range(copies):
            scene.add(fmbd.revolute(f"pin {i}", fmbd.ground, rod.surface("pin")))
            scene.sensor(f"F{i}", fmbd.reaction_force(f"pin {i}"))
        scene.sensor("tip", fmbd.position(rod.surface("tip")))
        assert scene.check().redundant == 2 * (copies - 1)
        runs.append(fmbd.solve(scene, t_end=0.02, dt=1e-3, newton=fmbd.Newton(1e-9)))
    one, two = runs
    assert np.abs(one["tip"] - two["tip"]).max() < 1e-9
    size = np.abs(one["F0"]).max()
    assert np.abs(two["F0"] + two["F1"] - one["F0"]).max() < 1e-7 * size
    assert np.abs(two["F0"] - two["F1"]).max() < 1e-7 * size


def chain_of(links: int, closed: bool) -> fmbd.Scene:
    """Links of the plane on a zigzag, hinged one to the next; ``closed``: the last has a second pin where it is held already."""
    scene = fmbd.Scene("zigzag")
    before: Any = fmbd.ground
    for i in range(links):
        link = fmbd.RigidBody(f"link {i}", 1.0, 0.1, (float(i), float(i % 2)))
        scene.add(link, fmbd.revolute(f"pin {i}", before, link, center=(i - 0.5, 0.5)))
        if closed and i == links - 1:
            scene.add(fmbd.revolute("twin", before, link, center=(i - 0.5, 0.5)))
        before = link
    return scene


@pytest.mark.parametrize("links", [3, 150])  # dense and sparse rows
@pytest.mark.parametrize("closed", [False, True])
def test_independent_rows_are_told_without_singular_values(links: int, closed: bool) -> None:
    from fmbd_fenicsx.system.mobility import mobility

    system, state, _ = chain_of(links, closed).build()
    ev = system.at(state.t, state.q)
    assert isinstance(ev.jacobian.core, np.ndarray) == (links == 3)
    assert rows_are_independent(ev) == (mobility(ev).redundant == 0) == (not closed)
    four, start, _ = four_bar().build()
    assert not rows_are_independent(four.at(start.t, start.q))


def test_conditioning_of_two_distances_at_a_small_angle() -> None:
    """A point on two links that make the angle a: the singular values of both directions have the ratio tan(a / 2)."""
    from fmbd_fenicsx.system.mobility import mobility

    a, scene = 0.1, fmbd.Scene("links")
    point = fmbd.RigidBody("point", 1.0, 1.0)
    scene.add(point)
    for k, angle in enumerate((0.5 * a, -0.5 * a)):
        place = (float(np.cos(angle)), float(np.sin(angle)))
        scene.add(fmbd.distance(f"link {k}", fmbd.ground, point, point_a=place, point_b=(0.0, 0.0), length=1.0))
    system, state, _ = scene.build()
    assert mobility(system.at(state.t, state.q)).conditioning == pytest.approx(np.tan(0.5 * a), rel=1e-9)


TILTED = (0.3, 0.5, 1.0)


def train(ratios: list[float], axis: Any = None) -> fmbd.Scene:
    """Wheels in a row, each turned by the one before with a ratio; in the plane, or in space about an axis."""
    plane, along = axis is None, {} if axis is None else {"axis": axis}
    scene = fmbd.Scene("train", gravity=(0.0, 0.0) if plane else (0.0, 0.0, 0.0))
    before: Any = None
    for i in range(len(ratios) + 1):
        place = (float(i), 0.0) if plane else (float(i), 0.0, 0.0)
        wheel = fmbd.RigidBody(f"wheel {i}", 1.0, 0.1 if plane else 0.1 * np.eye(3), place)
        pin = fmbd.revolute(f"pin {i}", fmbd.ground, wheel, center=place, **along)
        scene.add(wheel, pin)
        if before is not None:
            scene.add(fmbd.gear(f"gear {i}", fmbd.angle(before), fmbd.angle(pin), ratio=-ratios[i - 1]))
        before = pin
    for i in (0, len(ratios)):
        scene.sensor(f"turn {i}", fmbd.angle(scene.joints[f"pin {i}"]))
    return scene


@pytest.mark.parametrize(
    ("wheels", "total", "axis"),
    [(15, 1e-7, None), (110, 1e-7, None), (20, 1e-20, None), (1, 1e-12, None), (9, 1e-9, TILTED), (12, 1e-12, TILTED)],
)  # 110: no singular values
def test_a_train_that_reduces_and_comes_back_moves_as_one(wheels: int, total: float, axis: Any) -> None:
    """Gears r, .., r, 1/r, .., 1/r: all wheels count on the first shaft, J = J_0 sum r^(2 k), however slow the middle one is."""
    ratio = total ** (1.0 / wheels)
    slow = [min(i, 2 * wheels - i) for i in range(2 * wheels + 1)]
    scene = train([ratio] * wheels + [1.0 / ratio] * wheels, axis)
    push = 0.3 if axis is None else 0.3 * np.array(axis) / np.linalg.norm(axis)
    scene.add(fmbd.torque("push", scene.bodies["wheel 0"], lambda t: push))

    assert scene.check().redundant == 0
    run = fmbd.solve(scene, t_end=0.1, dt=0.01, output=fmbd.Output(progress=False))
    turn = 0.5 * 0.3 / (0.1 * sum(ratio ** (2 * k) for k in slow)) * 0.1**2
    assert run["turn 0"][-1] == pytest.approx(turn, rel=1e-12)
    assert run[f"turn {2 * wheels}"][-1] == pytest.approx(turn, rel=1e-12)
    assert run.counters["compiled_steps"] == run.counters["steps"]


@pytest.mark.parametrize("axis", [None, TILTED])
@pytest.mark.parametrize("wheels", [4, 8])
def test_a_drive_on_the_slow_wheel_of_a_train_moves_all(wheels: int, axis: Any) -> None:
    """The ends turn by 5 t^2, the moment of the drive is that on them over what the train reduces by."""
    total = 0.1**wheels
    scene = train([0.1] * wheels + [10.0] * wheels, axis)
    scene.add(fmbd.drive("motor", fmbd.angle(scene.joints[f"pin {wheels}"]), lambda t: 5.0 * total * t**2))
    scene.sensor("moment", fmbd.reaction("motor"))
    run = fmbd.solve(scene, t_end=0.1, dt=0.01, output=fmbd.Output(progress=False))
    inertia = 0.1 * sum(0.01 ** min(i, 2 * wheels - i) for i in range(2 * wheels + 1))
    for i in (0, 2 * wheels):
        assert run[f"turn {i}"][-1] == pytest.approx((-1) ** wheels * 0.05, rel=1e-12)
    assert abs(run["moment"][-1]) == pytest.approx(10.0 * inertia / total, rel=1e-8)
    assert run.counters["compiled_steps"] == run.counters["steps"]


def test_gears_that_count_as_dependent_are_told(caplog: pytest.LogCaptureFixture) -> None:
    """One gear that reduces by 1e-14, and one back: rows are the same but for that, and the first wheel turns twice as far."""
    scene = train([1e-14, 1e14])
    scene.add(fmbd.torque("push", scene.bodies["wheel 0"], lambda t: 0.3))
    fmbd.solve(scene, t_end=0.01, dt=0.01, output=fmbd.Output(progress=False))
    assert any('gears "gear 1", "gear 2" count as depending' in r.getMessage() for r in caplog.records)


@pytest.mark.parametrize("axis", [None, TILTED])
def test_planets_between_the_same_wheels_are_nothing_to_tell(axis: Any, caplog: pytest.LogCaptureFixture) -> None:
    """Each by a gear to both wheels: redundant, and what they hold fits together, as in every differential."""
    scene = train([0.4, -2.0], axis)
    first, last = (fmbd.angle(scene.joints[f"pin {i}"]) for i in (0, 2))
    scene.add(fmbd.gear("second planet", first, last, ratio=-0.8))
    run = fmbd.solve(scene, t_end=0.01, dt=0.01, output=fmbd.Output(progress=False))
    assert scene.check().redundant == 1
    assert not run.warnings and not caplog.records
