"""A step counts when its residuals are small: an open joint is an error with its name; bodies at rest pass."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError, FmbdError, InputError
from fmbd_fenicsx.mechanics.elastic.modes import rigid_fields
from fmbd_fenicsx.run.judges.acceptance import Closed


def double_pendulum(upper: float, lower: float, size: float = 1.0) -> fmbd.Scene:
    a = fmbd.RigidBody("a", upper, upper * size**2 / 12, position=(0.5 * size, 0.0))
    b = fmbd.RigidBody("b", lower, lower * size**2 / 12, position=(1.5 * size, 0.0))
    scene = fmbd.Scene("double pendulum", gravity=(0.0, -9.81 * size))
    scene.add(a, b, fmbd.revolute("pin", fmbd.ground, a, center=(0.0, 0.0)))
    scene.add(fmbd.revolute("knee", a, b, center=(size, 0.0)))
    scene.sensor("tip", fmbd.position(b))
    return scene


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e4])
@pytest.mark.parametrize("masses", [(1e-8, 1e8), (1e-7, 1e9), (1e8, 1e-8), (1e-3, 1e3)])
@pytest.mark.parametrize("energy", [True, False])
def test_joints_stay_closed_or_the_run_ends(masses: tuple[float, float], size: float, energy: bool) -> None:
    """Masses that differ by 1e16: closed within 1e-6 of the length, or an error; compiled or not."""
    scene = double_pendulum(*masses, size=size)
    try:
        run = fmbd.solve(scene, t_end=0.1, dt=1e-3, output=fmbd.Output(every=7, energy=energy))
    except FmbdError:
        assert min(masses) / max(masses) < 1e-9
        return
    ev = run.system.at(run.state.t, run.state.q)
    assert np.abs(ev.constraint()).max() < 1e-6 * size


def test_an_open_joint_is_named() -> None:
    """In lengths for points, in lengths of the model for angles; silent for schemes that do not hold positions."""
    system, state, _ = double_pendulum(1.0, 1.0).build()
    q = state.q.copy()
    Closed(system, (0,)).check(system.at(0.0, q, state.v))
    q[3] += 2e-6
    with pytest.raises(ConvergenceError, match=r'joint "knee" \(revolute\) is open by 2e-06 m'):
        Closed(system, (0,)).check(system.at(0.0, q, state.v))
    Closed(system, (1,)).check(system.at(0.0, q, state.v))
    q[3] = np.nan
    with pytest.raises(ConvergenceError, match="open by nan"):
        Closed(system, (0,)).check(system.at(0.0, q, state.v))
    v = np.zeros(system.n_v)
    v[3] = 1.0
    with pytest.raises(ConvergenceError, match=r'joint "knee" \(revolute\) opens at 1 m/s'):
        Closed(system, (0, 1)).check(system.at(0.0, state.q, v))


@pytest.mark.parametrize(
    "scheme",
    [
        fmbd.Radau(3, rtol=1e-4),
        fmbd.Radau(2, rtol=1e-4),
        fmbd.BDF(rtol=1e-5),
        fmbd.GeneralizedAlpha(rtol=1e-4),
        fmbd.GeneralizedAlpha(rtol=1e-4, compiled=False),
    ],
    ids=["Radau 3", "Radau 2", "BDF", "alpha", "alpha in NumPy"],
)
@pytest.mark.parametrize("every", [1, 3])
def test_own_steps_that_open_joints_are_made_again(scheme: Any, every: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """In smaller ones, compiled or not, where a third of the largest gap is allowed."""
    settings: Any = {"t_end": 0.5, "scheme": scheme, "newton": fmbd.Newton(tolerance=1e-4)}
    free = fmbd.solve(double_pendulum(1.0, 1.0), **settings)
    under, share = Closed.under, free.drift[0] / free.system.length / 3
    monkeypatch.setattr(Closed, "under", lambda *given: replace(under(*given), share=share))

    run = fmbd.solve(double_pendulum(1.0, 1.0), **settings, output=fmbd.Output(every=every))
    assert run.counters["open_steps"] > 0 and run.status == "finished"
    assert run.drift[0] < free.drift[0] / 2 and "open_steps" not in free.counters


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("frame", [fmbd.MeanAxis(), fmbd.Attached("pin"), fmbd.Chord("pin", "tip")], ids=type)
def test_frames_are_judged_in_metres(rod_mesh: Any, frame: Any, unit: float) -> None:
    """A field that is displaced by 2e-6 m in its frame, or turned by so much over the model's length, in any unit of mass.

    A turn moves the ends of a chord by half of it.
    """
    elastic = fmbd.materials.plane_stress(1e8 * unit, 0.3)
    mesh = rod_mesh(dim=2, h=0.5)
    body = fmbd.FloatingBody("rod", mesh, density=1000.0 * unit, elastic=elastic, frame=frame)
    scene = fmbd.Scene("frame")
    scene.add(body)
    system, state, _ = scene.build()
    field, at = system.fields[0][1].field, system.slices[0][0]

    def moved(rigid: Any, by: float) -> Any:
        q = state.q.copy()
        q[at] += by * rigid
        return system.at(0.0, q, state.v)

    closed = Closed(system, (0,))
    for column, turns in zip(rigid_fields(field).T, (0, 0, 1), strict=True):
        rigid = column / system.length**turns
        closed.check(moved(rigid, 1e-7))
        gap = "9.95e-07" if turns and isinstance(frame, fmbd.Chord) else "2e-06"
        with pytest.raises(ConvergenceError, match=rf"frame of rod is open by {gap} m"):
            closed.check(moved(rigid, 2e-6))


@pytest.mark.parametrize("compiled", [True, False])
def test_drift_of_frames_is_one_in_metres(rod_mesh: Any, compiled: bool) -> None:
    """A rod of 1e11 kg whose frame conditions hold to roundoff: 1e-16 of a length, not of its mass."""
    elastic = fmbd.materials.plane_stress(1e17, 0.3)
    body = fmbd.FloatingBody("rod", rod_mesh(dim=2, h=0.5), density=1e12, elastic=elastic)
    scene = fmbd.Scene("frame", gravity=(0.0, -9.81))
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin")))
    run = fmbd.solve(scene, t_end=0.02, dt=2e-3, scheme=fmbd.GeneralizedAlpha(0.8, compiled=compiled))
    assert run.drift[0] < 1e-13


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_a_body_at_rest_rests(dim: int, size: float) -> None:
    """Without a load, attitude and place at random: roundoff is no energy from nothing."""
    mass, at = 0.1, size * np.array([0.41, 0.27, 0.13])[:dim]
    if dim == 2:
        body = fmbd.RigidBody("body", mass, mass * size**2 / 12, position=at, rotation=0.202)
        joint: Any = fmbd.prismatic("joint", fmbd.ground, body, axis=(0.98, 0.2))
    else:
        body = fmbd.RigidBody("body", mass, size**2 * np.array([0.01, 0.012, 0.015]), position=at)
        joint = fmbd.planar("joint", fmbd.ground, body, normal=(0.65, -0.446, -0.74))
    scene = fmbd.Scene("rest")
    scene.add(body, joint)
    scene.sensor("position", fmbd.position(body))
    run = fmbd.solve(scene, t_end=0.3, dt=0.003)
    assert np.abs(run["position"] - at).max() < 1e-12 * size


def test_drives_that_agree_up_to_roundoff_run() -> None:
    """sin^3 t = (3 sin t - sin 3 t) / 4: rates that differ by 1e-60 at the start are no contradiction."""
    body = fmbd.RigidBody("bar", 1.0, 1 / 12, position=(0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, body, center=(0.0, 0.0))
    scene = fmbd.Scene("drives", gravity=(0.0, -9.81))
    scene.add(body, pin)
    for k, motion in enumerate((lambda t: np.sin(t) ** 3, lambda t: (3 * np.sin(t) - np.sin(3 * t)) / 4)):
        scene.add(fmbd.drive(f"motor {k}", fmbd.angle(pin), motion))
    assert fmbd.solve(scene, t_end=0.5, dt=0.01).drift[0] < 1e-9


def test_a_body_too_stiff_for_absolute_coordinates(rod_mesh: Any) -> None:
    """Roundoff of elastic forces hides the inertia: refused by name, with what to take instead."""
    law = fmbd.materials.neo_hookean(1e16, 0.3)
    body = fmbd.AbsoluteBody("rod", rod_mesh(dim=2, h=0.5, height=0.2), density=1000.0, energy=law, quadrature=4)
    scene = fmbd.Scene("fall", gravity=(0.0, -9.81))
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin")))
    with pytest.raises(InputError, match=r'Body "rod" is too stiff.*FloatingBody.*dt smaller'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)
