"""Norms of local errors: what counts as a rigid motion, and what as a deformation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import linear_elastic
from fmbd_fenicsx.schemes.onestep.alpha.variable_alpha import VariableAlpha
from fmbd_fenicsx.schemes.own_marching import OwnMarch
from fmbd_fenicsx.schemes.rigid_motions import RigidMotions


def kicked_strip(mesh: Any, frame: Any, modes: int | None = None) -> fmbd.Scene:
    """A strip on a pin, its frame mean axes or on the pin's small surface, of which a sudden torque makes the rest vibrate."""
    scene = fmbd.Scene("strip", gravity=(0.0, -9.81, 0.0)[: mesh.dim])
    strip: Any = fmbd.FloatingBody("strip", mesh, density=1e3, elastic=linear_elastic(1e8, 0.3), frame=frame)
    strip = strip if modes is None else strip.reduced(modes=modes)
    space = mesh.dim == 3
    scene.add(
        strip, fmbd.revolute("pin", fmbd.ground, strip.surface("pin"), **({"axis": (0, 1, 1)} if space else {})),
        fmbd.torque("kick", strip.surface("tip"), lambda t: (0.0, 5.0, 5.0) if space else 50.0),
    )  # fmt: skip
    scene.sensor("tip", fmbd.position(strip.surface("tip")))
    return scene


SCHEMES = [fmbd.Radau(3, rtol=1e-5), fmbd.BDF(rtol=1e-5), fmbd.GeneralizedAlpha(rtol=1e-5)]


@pytest.mark.parametrize("scheme", SCHEMES, ids=["Radau", "BDF", "alpha"])
@pytest.mark.parametrize(("dim", "compiled"), [(2, True), (2, False), (3, True)])
def test_frames_that_vibrate_with_a_surface_do_not_hold_steps_down(
    rod_mesh: Any, monkeypatch: pytest.MonkeyPatch, dim: int, compiled: bool, scheme: Any
) -> None:
    """Rates of such a frame count by what the mass of its body does, those of deformations by the places that they lead to."""
    if not compiled:
        monkeypatch.setattr(OwnMarch, "_chooses_alike", property(lambda self: False))
        monkeypatch.setattr(VariableAlpha, "_marches", property(lambda self: False))
    mesh, frame = rod_mesh(dim=dim, h=0.25), fmbd.Attached("pin")
    cases = (frame, scheme), (fmbd.MeanAxis(), scheme), (frame, fmbd.Radau(3, rtol=1e-6))
    attached, mean, fine = (fmbd.solve(kicked_strip(mesh, x), t_end=0.004, scheme=chosen) for x, chosen in cases)
    # 2.4 to 5.7 times as many with rates, and places, that count like those of rigid bodies
    assert attached.counters["steps"] < 2 * mean.counters["steps"]
    assert np.abs(attached["tip"][-1] - fine["tip"][-1]).max() < 1e-6


@pytest.mark.parametrize("scheme", SCHEMES, ids=["Radau", "BDF", "alpha"])
@pytest.mark.parametrize("compiled", [True, False])
def test_frames_of_reduced_bodies_do_not_hold_steps_down(
    rod_mesh: Any, monkeypatch: pytest.MonkeyPatch, compiled: bool, scheme: Any
) -> None:
    """As those of fields: 1.8 to 5 times as many steps without."""
    if not compiled:
        monkeypatch.setattr(OwnMarch, "_chooses_alike", property(lambda self: False))
        monkeypatch.setattr(VariableAlpha, "_marches", property(lambda self: False))
    mesh = rod_mesh(h=0.25)
    attached, mean = (
        fmbd.solve(kicked_strip(mesh, frame, modes=6), t_end=0.004, scheme=scheme)
        for frame in (fmbd.Attached("pin"), fmbd.MeanAxis())
    )
    assert attached.counters["steps"] < 1.5 * mean.counters["steps"]


def test_frames_move_by_the_mass_of_their_body(rod_mesh: Any) -> None:
    """A turn and a translation of a body are no deformations; a turn of its frame in which its mass stays is one."""
    system, state, _ = kicked_strip(rod_mesh(dim=3, h=0.25), fmbd.Attached("pin")).build()
    rng = np.random.default_rng(2)
    state = replace(state, q=system.compose(state.q, rng.standard_normal(system.n_v)))
    motions, (_, part), R = RigidMotions.at(system, state), system.fields[0], system.at(state.t, state.q).rotation[0]
    v, V, W = np.zeros(system.n_v), rng.standard_normal(3), rng.standard_normal(3)
    v[:6] = *V, *W
    assert not motions.rest(v).any()

    v[6:] = -(R.T @ V + np.cross(W, part.field.X)).ravel()
    found = motions.rest(np.array([v, 2.0 * v]))
    assert np.abs(found[:, :6] - np.array([v[:6], 2.0 * v[:6]])).max() < 1e-12
    assert not found[:, 6:].any()


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("rtol", [1e-8, 1e-10])
def test_roundoff_of_places_refuses_no_steps_behind_a_start(rtol: float, compiled: bool) -> None:
    """A pendulum that dry friction holds at first: what velocities are in error by is roundoff of places over the step while
    the way gone is a millionth of a metre, in smaller steps more so: they shrank to 2e-20 s.
    """
    scene, bar = fmbd.Scene("bar", gravity=(0, -9.81)), fmbd.RigidBody("bar", 2.0, 0.1, (1.0, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, bar, center=(0, 0))
    scene.add(bar, pin, fmbd.dry_friction("bearing", fmbd.angle(pin), limit=1.5, stick=2e3, damping=1.0))
    scheme = fmbd.GeneralizedAlpha(rtol=rtol, compiled=compiled)
    run = fmbd.solve(scene, t_end=2e-3, dt=5e-4, scheme=scheme)
    assert run.counters["steps"] < 400  # those of short ways
    stiff, inertia = 2e3, 2.1  # (I + m r^2) phi'' + damping phi' + stick phi = -m g r
    s = np.roots([inertia, 1.0, stiff])
    rest = -2.0 * 9.81 / stiff
    turned = rest * (1 - (s[1] * np.exp(s[0] * 2e-3) - s[0] * np.exp(s[1] * 2e-3)) / (s[1] - s[0])).real
    assert run.state.q[2] == pytest.approx(turned, rel=1e-5)


@pytest.mark.parametrize("scheme", [fmbd.GeneralizedAlpha(rtol=1e-6), fmbd.BDF()], ids=["alpha", "BDF"])
@pytest.mark.parametrize("far", [1e3, 1e6])
def test_steps_far_from_the_origin_ask_for_no_less_than_places_are_known_to(scheme: Any, far: float) -> None:
    """A pendulum of 1 mm, 1 and 1 000 km away: places are known to 1e-13 and 1e-10 m, where rtol asked for 1e-15 and 1e-9."""
    ends = []
    for x in (0.0, far):
        scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81))
        bar = fmbd.RigidBody("bar", 1e-6, 1e-13, (x + 5e-4, x))
        scene.add(bar, fmbd.revolute("pin", fmbd.ground, bar, center=(x, x)))
        scene.sensor("turn", fmbd.rotation(bar))
        run = fmbd.solve(scene, t_end=0.02, scheme=scheme, output=fmbd.Output(estimate_error=False))
        ends.append(run["turn"][-1])
    assert ends[1] == pytest.approx(ends[0], abs=3e-4)
