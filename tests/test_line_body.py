"""Planar lines by a user's own weak form: the geometrically exact beam against exact solutions, joints on its ends."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from profiled import calls_of
from scipy.integrate import solve_bvp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.mechanics.bodies.line_body import LinePart
from fmbd_fenicsx.run.accuracy.jumps_in_time import HeldState
from fmbd_fenicsx.system.compiled.choice import use_driver

MOST_CALLS = 80  # of Python a step
L, EA, GA, EI, RHO_A, RHO_I = 2.0, 1e6, 4e5, 50.0, 1.0, 1e-3


def mass(z: Any, w: Any, ds: Any) -> Any:
    return (RHO_A * (z[0] * w[0] + z[1] * w[1]) + RHO_I * z[2] * w[2]) * ds


def energy(z: Any, ds: Any) -> Any:
    from ufl import cos, sin

    c, s, x, y = cos(z[2]), sin(z[2]), z[0].dx(0), z[1].dx(0)
    return 0.5 * (EA * (x * c + y * s - 1) ** 2 + GA * (y * c - x * s) ** 2 + EI * z[2].dx(0) ** 2) * ds


def straight(s: Any) -> Any:
    return [s, 0 * s, 0 * s]


def line(**changes: Any) -> fmbd.LineBody:
    return fmbd.LineBody("line", L, **{"mass": mass, "energy": energy, "start": straight, "cells": 8, **changes})


def ramp(t: float) -> float:
    return float(min(t, 1.0) ** 2 * (3 - 2 * min(t, 1.0)))


def cantilever(name: str, load: Any) -> Any:
    """At rest under a load: ramped up in 1 s, with much damping."""
    beam = line(mass_damping=12.0)
    scene = fmbd.Scene(name)
    scene.add(beam, fmbd.fixed("clamp", fmbd.ground, beam.surface("start")), load(beam.surface("end")))
    scene.sensor("tip", fmbd.position(beam.surface("end")))
    scene.sensor("turn", fmbd.rotation(beam.surface("end")))
    scene.sensor("clamp", fmbd.reaction("clamp"))
    return fmbd.solve(scene, t_end=5.0, dt=0.05, scheme=fmbd.GeneralizedAlpha(0.5))


def test_bent_to_a_circle() -> None:
    """A couple M bends the line to an arc of curvature M / EI: exact, up to the elements; the clamp carries -M."""
    turn = 1.5
    run = cantilever("roll", lambda end: fmbd.torque("couple", end, lambda t: ramp(t) * EI * turn / L))
    r = L / turn
    np.testing.assert_allclose(run["tip"][-1], [r * np.sin(turn), r * (1 - np.cos(turn))], rtol=1e-5)
    np.testing.assert_allclose(run["turn"][-1], turn, rtol=1e-7)
    np.testing.assert_allclose(np.abs(run["clamp"][-1]).max(), EI * turn / L, rtol=1e-7)


def test_elastica() -> None:
    """A dead force across the end: the extensible, shearable elastica, to 1e-5."""
    F = 60.0

    def right(s: Any, y: Any) -> Any:  # theta, theta', x, y
        c, si = np.cos(y[0]), np.sin(y[0])
        stretch, shear = 1 + F * si / EA, F * c / GA
        return np.array(
            [y[1], -F / EI * (stretch * c - shear * si), stretch * c - shear * si, stretch * si + shear * c]
        )

    def ends(a: Any, b: Any) -> Any:
        return np.array([a[0], b[1], a[2], a[3]])

    s = np.linspace(0, L, 101)
    exact = solve_bvp(right, ends, s, np.zeros((4, len(s))), tol=1e-10).y[2:, -1]
    run = cantilever("elastica", lambda end: fmbd.force("pull", end, lambda t: (0.0, ramp(t) * F)))
    np.testing.assert_allclose(run["tip"][-1], exact, rtol=1e-5)


def test_rigid_limit_on_a_pin() -> None:
    """A stiff line on a pin swings like the rigid rod of its mass and inertia; so does a rod hung from its end by a joint."""
    stiff = line(energy=lambda z, ds: 1e3 * energy(z, ds), cells=2)
    J = RHO_A * L**3 / 12 + RHO_I * L
    rod = fmbd.RigidBody("line", mass=RHO_A * L, inertia=J, position=(L / 2, 0.0))
    found = {}
    for name, body in (("line", stiff), ("rigid", rod)):
        bob = fmbd.RigidBody("bob", mass=0.5, inertia=0.01, position=(L, -0.3))
        scene = fmbd.Scene(name, gravity=(0.0, -9.81))
        first, last = (body.surface("start"), body.surface("end")) if name == "line" else (body, body)
        scene.add(body, bob, fmbd.revolute("pin", fmbd.ground, first, center=(0, 0)))
        scene.add(fmbd.revolute("hinge", last, bob, center=(L, 0)))
        scene.sensor("bob", fmbd.position(bob))
        scene.sensor("pin", fmbd.reaction("pin"))
        found[name] = fmbd.solve(scene, t_end=0.5, dt=2e-3, scheme=fmbd.GeneralizedAlpha(0.8))
    np.testing.assert_allclose(found["line"]["bob"], found["rigid"]["bob"], atol=2e-4)
    mean = [found[k]["pin"].mean(0) for k in ("line", "rigid")]  # the line's own vibrations left out
    np.testing.assert_allclose(*mean, atol=0.1)
    energy_ = sum(found["line"].energy.values())
    assert np.ptp(energy_) < 2e-3 * np.abs(found["line"].energy["kinetic"]).max()


def test_free_flight_and_rotated_joint() -> None:
    """A fixed joint with a lever on a turned end, and free motion: momenta kept, with tip motion equal from either frame."""
    angle = 0.7
    place = lambda s: [s * np.cos(angle), s * np.sin(angle), 0 * s + angle]  # noqa: E731
    spin = lambda s: [-2.0 * s * np.sin(angle), 2.0 * s * np.cos(angle), 0 * s + 2.0]  # noqa: E731
    beam = line(start=place, start_rate=spin)
    tip = np.array([L * np.cos(angle), L * np.sin(angle)])
    disk = fmbd.RigidBody(
        "disk",
        0.4,
        0.02,
        position=tip + [0.2, 0.0],
        velocity=2.0 * np.array([-tip[1], tip[0] + 0.2]),
        angular_velocity=2.0,
    )
    scene = fmbd.Scene("flight")
    scene.add(beam, disk, fmbd.fixed("weld", beam.surface("end"), disk, center=tip + [0.2, 0.0]))
    scene.sensor("disk", fmbd.rotation(disk))
    scene.sensor("end", fmbd.rotation(beam.surface("end")))
    run = fmbd.solve(scene, t_end=0.4, dt=2e-3)
    np.testing.assert_allclose(run["disk"], run["end"], atol=1e-9)
    p, spin_ = run.system.at(run.state.t, run.state.q, run.state.v).momenta()
    arm = tip + [0.2, 0.0]
    half = RHO_A * L**2 / 2 * 2.0 * np.array([-np.sin(angle), np.cos(angle)])
    np.testing.assert_allclose(p, half + 0.4 * 2.0 * np.array([-arm[1], arm[0]]), rtol=1e-8)
    total = 2.0 * (RHO_A * L**3 / 3 + RHO_I * L + 0.02 + 0.4 * (arm @ arm))
    np.testing.assert_allclose(spin_[0], total, rtol=1e-4)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"mass": lambda z, w, ds: z[0] * w[1] * ds}, "not symmetric"),
        ({"energy": lambda z, ds: z[0]}, "form of rank 0"),
        ({"start": lambda s: [s, s]}, "x, y and theta"),
        ({"start": lambda s: [s, s, np.nan * s]}, "finite"),
    ],
)
def test_bad_forms_are_named(changes: Any, words: str) -> None:
    scene = fmbd.Scene("bad")
    scene.add(line(**changes))
    with pytest.raises(fmbd.errors.FmbdError, match=words):
        scene.build()


def test_bad_data_are_named() -> None:
    with pytest.raises(fmbd.errors.InputError, match="length"):
        fmbd.LineBody("line", -1.0, mass, energy, straight)
    with pytest.raises(fmbd.errors.InputError, match='no surface "tip"'):
        line().surface("tip")
    with pytest.raises(fmbd.errors.InputError, match="attach to a surface"):
        fmbd.fixed("clamp", fmbd.ground, line())


def test_the_curve_of_a_line_passes_between_its_nodes() -> None:
    """Quadratic elements hold a parabola: the curve is on it everywhere, and its ends are those of the line."""
    start = lambda s: [s, 0.3 * s**2 - s, 0 * s]  # noqa: E731
    flat = lambda z, w, ds: (z[0] * w[0] + z[1] * w[1] + z[2] * w[2]) * ds  # noqa: E731
    for degree in (2, 3):
        line = fmbd.LineBody("line", 2.0, flat, lambda z, ds: z[0] ** 2 * ds, start=start, cells=3, degree=degree)
        nodes = np.array(start(line._nodes)).T.ravel()
        x, y, _ = line.curve(np.array([nodes, 2 * nodes]), 5)[0].T
        assert len(x) == 16 and (x[0], x[-1]) == pytest.approx((0.0, 2.0), abs=1e-14)
        assert y == pytest.approx(0.3 * x**2 - x, abs=1e-13)
        assert np.allclose(np.diff(x), 2.0 / 15)
    with pytest.raises(InputError, match="values of 10 nodes, found 5 numbers"):
        line.curve(np.zeros(5))


@pytest.mark.compiled
def test_a_line_whose_motion_is_held_is_assembled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its forces know no time: loads are looked at in hundreds of instants. With other rates they are others."""
    beam, asked = line(mass_damping=12.0), []
    scene = fmbd.Scene("held", gravity=(0.0, -9.81))
    scene.add(beam, fmbd.fixed("clamp", fmbd.ground, beam.surface("start")))
    scene.add(fmbd.force("push", beam.surface("end"), lambda t: (0.0, t)))
    system, state, _ = scene.build()
    plain = HeldState(system, state).rows(np.linspace(0.0, 1.0, 50))

    force = LinePart.force
    monkeypatch.setattr(LinePart, "force", lambda *given: (asked.append(1), force(*given))[1])
    use_driver(system)
    asked.clear()
    held = HeldState(system, state)
    np.testing.assert_allclose(held.rows(np.linspace(0.0, 1.0, 50)), plain, rtol=1e-12, atol=1e-9)
    assert len(asked) == 1
    moving = system.at(0.0, state.q, state.v + 1.0).balance(state.a, state.lam)
    assert len(asked) == 2
    assert np.abs(moving - system.at(0.0, state.q, state.v).balance(state.a, state.lam)).max() > 1e-3


def test_forces_of_a_line_take_few_calls_of_python() -> None:
    """Assembled by DOLFINx's own function, without its wrappers: each state of a step asks for them once."""
    beam = line()
    scene = fmbd.Scene("swing", gravity=(0, -9.81))
    scene.add(beam, fmbd.revolute("pin", fmbd.ground, beam.surface("start")))

    def swing(steps: int) -> None:
        end = 1e-3 * steps
        fmbd.solve(scene, t_end=end, dt=1e-3, output=fmbd.Output(energy=False, times=(0.0, end)))

    swing(20)
    calls = [calls_of(lambda n=n: swing(n)) for n in (20, 60)]
    assert calls[1] - calls[0] < 40 * MOST_CALLS
