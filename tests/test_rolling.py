"""Rolling without slip and skates: rows on velocities in every scheme, in statics, modes and linear models."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError

BLOCK = Path(__file__).resolve().parents[1] / "meshes/block.py"
UP = (0.0, 0.0, 1.0)
SHAPES = {
    "knife edge": fmbd.Wheel(0.3, axis=(0, 1, 0)),
    "tyre": fmbd.Wheel(0.3, axis=(0, 1, 0), tread=0.05),
    "ball": fmbd.Ball(0.3),
}
SCHEMES = {
    "NumPy": fmbd.GeneralizedAlpha(compiled=False),
    "compiled": fmbd.GeneralizedAlpha(),
    "energy-momentum": fmbd.EnergyMomentum(),
    "Radau": fmbd.Radau(form=fmbd.Index2(), rtol=1e-8),
    "GGL": fmbd.GeneralizedAlpha(rho_inf=0.99, form=fmbd.GGL()),
    "BDF": fmbd.BDF(form=fmbd.Projected(fmbd.Index1()), rtol=1e-8),
    "half-explicit": fmbd.HalfExplicit(rtol=1e-8),
    "explicit": fmbd.ExplicitRungeKutta(rtol=1e-9),
}


def thrown(shape: Any) -> fmbd.Scene:
    """A wheel or ball that rolls, leans and turns."""
    scene = fmbd.Scene("thrown", gravity=(0, 0, -9.81))
    body = fmbd.RigidBody(
        "body", 2.0, (0.06, 0.12, 0.06), (0, 0, 0.3), velocity=(1.5, 0, 0), angular_velocity=(0.3, 5, 0.4)
    )
    scene.add(body, fmbd.rolling("road", fmbd.ground, body, shape=shape, normal=UP))
    scene.sensor("at", fmbd.position(body))
    scene.sensor("force", fmbd.reaction("road"))
    return scene


@pytest.fixture(scope="module")
def exact() -> dict[str, Any]:
    """Places of the bodies after 0.1 s, by steps that are far smaller than those of the tests."""
    fine = fmbd.Radau(form=fmbd.Index2(), rtol=1e-11)
    return {name: fmbd.solve(thrown(s), t_end=0.1, dt=0.1, scheme=fine)["at"][-1] for name, s in SHAPES.items()}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_all_schemes_roll(scheme: str, shape: str, exact: dict[str, Any]) -> None:
    """All end at one place, and none loses energy beyond its order."""
    run = fmbd.solve(thrown(SHAPES[shape]), t_end=0.1, dt=5e-3, scheme=SCHEMES[scheme])
    assert np.abs(run["at"][-1] - exact[shape]).max() < 1e-6
    energy = run.energy["kinetic"] + run.energy["weight"]
    assert np.ptp(energy) < (1e-10 if scheme == "energy-momentum" else 1e-5) * energy[0]
    if scheme == "compiled":
        assert run.counters["compiled_steps"] == run.counters["steps"]


def test_order_of_generalized_alpha(exact: dict[str, Any]) -> None:
    """Second order, with rows on positions and on velocities side by side."""
    missed = []
    for dt in (5e-3, 2.5e-3):
        run = fmbd.solve(thrown(SHAPES["knife edge"]), t_end=0.1, dt=dt)
        missed.append(np.abs(run["at"][-1] - exact["knife edge"]).max())
    assert missed[0] / missed[1] > 3.3


def test_ball_on_a_turntable() -> None:
    """A homogeneous ball on a table with Omega runs in circles with 2/7 Omega (Milne): a surface that moves."""
    table = fmbd.RigidBody("table", 1.0, (1.0, 1.0, 1.0), (0, 0, -0.1), angular_velocity=(0, 0, 3.5))
    table_rate, r, v = 3.5, 0.1, np.array([0.0, 1.0, 0.0])
    # no slip at the start: v + w x (-r e_z) = Omega x x
    slip = np.cross((0, 0, table_rate), (0.5, 0, 0)) - v
    ball = fmbd.RigidBody(
        "ball", 1.0, (0.004,) * 3, (0.5, 0, 0.1), velocity=tuple(v), angular_velocity=(slip[1] / r, -slip[0] / r, 0)
    )
    scene = fmbd.Scene("turntable", gravity=(0, 0, -9.81))
    axle = fmbd.revolute("axle", fmbd.ground, table, center=(0, 0, -0.1))
    scene.add(table, ball, axle, fmbd.drive("motor", fmbd.angle(axle), lambda t: table_rate * t))
    scene.add(fmbd.rolling("contact", table, ball, shape=fmbd.Ball(r), normal=UP))
    scene.sensor("at", fmbd.position(ball))
    run = fmbd.solve(scene, t_end=1.0, dt=0.1, scheme=fmbd.Radau(form=fmbd.Index2(), rtol=1e-9))
    w = 2.0 / 7.0 * table_rate
    circle = np.array([0.5 - v[1] / w + v[1] / w * np.cos(w), v[1] / w * np.sin(w), 0.1])
    assert np.abs(run["at"][-1] - circle).max() < 1e-9


def test_rolling_in_the_plane() -> None:
    """A disc on a slope: acceleration g sin(a) / (1 + J / m r^2)."""
    slope = 0.3
    n = (np.sin(slope), np.cos(slope))
    scene = fmbd.Scene("slope", gravity=(0.0, -9.81))
    disc = fmbd.RigidBody("disc", 2.0, 0.5 * 2.0 * 0.2**2, (0.0, 1.0))
    scene.add(disc, fmbd.rolling("slope", fmbd.ground, disc, shape=fmbd.Ball(0.2), normal=n))
    scene.sensor("at", fmbd.position(disc))
    run = fmbd.solve(scene, t_end=0.5, dt=0.01)
    way = 0.5 * 9.81 * np.sin(slope) / 1.5 * 0.25
    assert np.abs(run["at"][-1] - (way * np.cos(slope), 1.0 - way * np.sin(slope))).max() < 1e-9


def test_skate_on_a_slope() -> None:
    """The classical knife edge on a slope does not run down it: with turning rate w it drifts across (a cycloid)."""
    g, w = 2.0, 1.5  # share of gravity along the slope, m/s^2
    scene = fmbd.Scene("ice", gravity=(g, 0.0))
    blade = fmbd.RigidBody("blade", 1.0, 1.0, (0.0, 0.0), angular_velocity=w)
    scene.add(blade, fmbd.skate("edge", fmbd.ground, blade, along=(1.0, 0.0)))
    scene.sensor("at", fmbd.position(blade))
    run = fmbd.solve(scene, t_end=2.0, dt=2e-3)
    t = run.times
    x, y = g / (2 * w * w) * np.sin(w * t) ** 2, g / (2 * w * w) * (w * t - 0.5 * np.sin(2 * w * t))
    assert np.abs(run["at"] - np.column_stack((x, y))).max() < 1e-5


def test_ball_on_a_spring_in_statics_and_modes() -> None:
    """Rolling adds J / r^2 to the mass; the resting place is found by rolling."""
    scene = fmbd.Scene("spring", gravity=(0.0, -9.81))
    disc = fmbd.RigidBody("disc", 2.0, 0.04, (0.0, 0.2))
    scene.add(disc, fmbd.rolling("floor", fmbd.ground, disc, shape=fmbd.Ball(0.2), normal=(0.0, 1.0)))
    how = {"stiffness": 30.0, "length": 1.1}
    scene.add(fmbd.Spring("spring", fmbd.ground, disc, point_a=(-1.0, 0.2), point_b=(0.0, 0.2), **how))
    scene.add(fmbd.force("push", disc, lambda t: (1.0, 0.0)))
    scene.sensor("at", fmbd.position(disc))
    found = fmbd.equilibrium(scene)
    at = 0.1 + 1.0 / 30.0
    assert found["at"] == pytest.approx((at, 0.2), abs=1e-10)
    rolled = found.state.q[2]  # clockwise, without slip
    assert rolled == pytest.approx(-at / 0.2, abs=1e-9)

    omega = np.sqrt(30.0 / (2.0 + 0.04 / 0.2**2))
    oscillation = fmbd.modes(scene, 2, at=found).omega[-1]
    assert oscillation == pytest.approx(omega, rel=1e-8)
    H = fmbd.frequency_response(scene, ["push x"], ["at x"], [1.0], at=found)[0, 0, 0]
    assert H == pytest.approx(1.0 / (30.0 - 3.0), rel=1e-7)


def test_upright_spinning_top_has_its_exact_frequencies() -> None:
    """A w^2 - C s w + m g l = 0 about the pivot: axes of the modes do not turn with the top."""
    m, l, A, C, spin = 1.0, 0.3, 0.12, 0.02, 60.0
    top = fmbd.RigidBody("top", m, (A - m * l * l, A - m * l * l, C), (0, 0, l), angular_velocity=(0, 0, spin))
    scene = fmbd.Scene("top", gravity=(0, 0, -9.81))
    scene.add(top, fmbd.spherical("pivot", fmbd.ground, top, center=(0, 0, 0)))
    exact = np.sort(np.abs(np.roots([A, -C * spin, m * 9.81 * l]).real))
    assert fmbd.modes(scene, 4).omega[-2:] == pytest.approx(exact, rel=1e-6)


def test_a_rolling_disc_hits_a_wall() -> None:
    """With contact in the same scene: half of the speed comes back, and the disc rolls back without slip."""
    scene = fmbd.Scene("wall", gravity=(0.0, -9.81))
    disc = fmbd.RigidBody("disc", 2.0, 0.04, (0.0, 0.2), velocity=(1.0, 0.0), angular_velocity=-5.0)
    scene.add(disc, fmbd.rolling("road", fmbd.ground, disc, shape=fmbd.Ball(0.2), normal=(0.0, 1.0)))
    wall = fmbd.Obstacle("wall", fmbd.HalfSpace((0.5, 0.0, 0.0), normal=(-1.0, 0.0, 0.0)))
    scene.add(fmbd.contact("hit", fmbd.contacts.ball(disc, 0.2), wall, restitution=0.5))
    scene.sensor("at", fmbd.position(disc))
    run = fmbd.solve(scene, t_end=0.6, dt=2e-3, scheme=fmbd.Moreau())
    assert run["at"][-1] == pytest.approx((0.15, 0.2), abs=2e-3)
    assert run.state.v == pytest.approx((-0.5, 0.0, 2.5), abs=1e-9)


@pytest.mark.parametrize("scheme", [fmbd.GeneralizedAlpha(), fmbd.GeneralizedAlpha(form=fmbd.GGL())])
def test_an_elastic_cart_rolls(scheme: Any) -> None:
    """Two wheels under an elastic beam: a = F / (m + 2 (m_w + J / r^2)), less what the beam gives way."""
    mesh = fmbd.read_gmsh(BLOCK, size=(0.4, 0.1), origin=(-0.2, 0.15), counts=(4, 1))
    law = fmbd.materials.plane_stress(1e10, 0.3)
    beam = fmbd.FloatingBody("beam", mesh, degree=2, density=1000.0, elastic=law)
    scene = fmbd.Scene("cart", gravity=(0.0, -9.81))
    scene.add(beam)
    for side, x in (("left", -0.2), ("right", 0.2)):
        wheel = fmbd.RigidBody(f"wheel {side}", 1.0, 0.005, (x, 0.1))
        scene.add(wheel, fmbd.revolute(f"axle {side}", wheel, beam.surface(side), center=(x, 0.1)))
        scene.add(fmbd.rolling(f"road {side}", fmbd.ground, wheel, shape=fmbd.Ball(0.1), normal=(0.0, 1.0)))
    scene.add(fmbd.force("push", scene.bodies["wheel left"], lambda t: (10.0, 0.0)))
    scene.sensor("at", fmbd.position(scene.bodies["wheel right"]))
    run = fmbd.solve(scene, t_end=0.1, dt=4e-3, scheme=scheme)
    assert run["at"][-1, 0] - 0.2 == pytest.approx(0.5 * 10.0 / (40.0 + 3.0) * 0.01, rel=1e-3)


@pytest.mark.parametrize("scheme", [fmbd.Radau(), fmbd.Rattle(), fmbd.BDF(form=fmbd.GGL())])
def test_forms_that_ask_for_positions_are_refused(scheme: Any) -> None:
    with pytest.raises(InputError, match=r"road.*velocities only.*Index2"):
        fmbd.solve(thrown(fmbd.Ball(0.3)), t_end=0.1, dt=0.01, scheme=scheme)


def test_bad_input() -> None:
    body = fmbd.RigidBody("body", 1.0, (1.0, 1.0, 1.0))
    disc = fmbd.RigidBody("disc", 1.0, 1.0)
    with pytest.raises(InputError, match="lies flat"):
        fmbd.rolling("road", fmbd.ground, body, shape=fmbd.Wheel(0.3, axis=UP), normal=UP)
    with pytest.raises(InputError, match="rolls in space"):
        fmbd.rolling("road", fmbd.ground, disc, shape=fmbd.Wheel(0.3, axis=UP), normal=(0, 1))
    with pytest.raises(InputError, match="radius"):
        fmbd.Ball(-1.0)
    with pytest.raises(InputError, match="tread"):
        fmbd.Wheel(0.3, axis=UP, tread=0.4)
    with pytest.raises(InputError, match="parallel"):
        fmbd.skate("ice", fmbd.ground, body, along=UP, normal=UP)


def test_rows_on_a_body_do_not_know_the_origin() -> None:
    """A ball on a plate that moves: the rows of slip are the same wherever both are."""
    rows = []
    for place in ((0.0, 0.0, 0.0), (5.0, -3.0, 2.0)):
        plate = fmbd.RigidBody("plate", 1.0, (1.0, 1.0, 1.0), tuple(np.add(place, (0.3, 0.2, -0.1))))
        ball = fmbd.RigidBody("ball", 1.0, (0.004,) * 3, tuple(np.add(place, (0.5, 0.0, 0.1))))
        scene = fmbd.Scene("pair")
        scene.add(plate, ball, fmbd.rolling("contact", plate, ball, shape=fmbd.Ball(0.1), normal=UP))
        system, state, _ = scene.build()
        rows.append(system.at(state.t, state.q).jacobian.core)
    assert rows[0] == pytest.approx(rows[1], abs=1e-12)

    # a plate that turns about the z axis moves the point of contact, at (0.2, -0.2) from its centre, by (0.2, 0.2) rad/s
    turn = np.zeros(12)
    turn[5] = 1.0
    assert np.sort(np.abs(rows[0] @ turn)) == pytest.approx([0.0, 0.2, 0.2], abs=1e-12)
