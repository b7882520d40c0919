"""Rolling without slip and skates: rows on velocities in every scheme, in statics, modes and linear models."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError

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
