"""Contact of reduced bodies: their surfaces touch like those of fields, their amplitudes take the impacts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.materials import plane_stress

HEIGHT, DENSITY = 0.2, 1000.0
FLOOR = fmbd.contacts.Obstacle("floor", fmbd.contacts.HalfSpace((0, 0), (0, 1)))


def rod(mesh: Any, modes: int, young: float = 1e7, **start: Any) -> Any:
    """A rod of 1 m by some modes, its axis at y = 0."""
    elastic = plane_stress(young, 0.3)
    return fmbd.FloatingBody("rod", mesh, density=DENSITY, elastic=elastic, **start).reduced(modes=modes)


def falling(body: Any, touching: Any, restitution: float, friction: float, t_end: float = 0.6) -> fmbd.Run:
    """A body that falls on a floor just below it."""
    floor = fmbd.contacts.Obstacle("floor", fmbd.contacts.HalfSpace((0, -0.15), (0.1, 1)))
    pair = fmbd.contact("floor", touching, floor, restitution=restitution, friction=friction)
    scene = fmbd.Scene("falling", gravity=(0, -9.81))
    scene.add(body, pair)
    scene.sensor("place", fmbd.position(body if isinstance(body, fmbd.RigidBody) else body.surface("pin")))
    scene.sensor("gap", fmbd.sensors.contact_gap(pair))
    scene.sensor("force", fmbd.sensors.contact_force(pair))
    return fmbd.solve(scene, t_end=t_end, dt=2e-3, scheme=fmbd.schemes.Moreau())


@pytest.mark.parametrize(("restitution", "friction"), [(0.0, 0.0), (0.5, 0.0), (0.5, 0.3)])
def test_no_modes_fall_like_a_rigid_body(rod_mesh: Callable[..., Any], restitution: float, friction: float) -> None:
    mesh = rod_mesh(h=0.25, height=HEIGHT)
    body = rod(mesh, 0)
    mass, inertia = DENSITY * HEIGHT, DENSITY * HEIGHT * (1 + HEIGHT**2) / 12
    rigid = fmbd.RigidBody("plate", mass, inertia, position=(0.5, 0.0))
    ends = [(x, y) for x in (-0.5, 0.5) for y in (-HEIGHT / 2, HEIGHT / 2)]

    found = falling(body, body.surface("side"), restitution, friction)
    exact = falling(rigid, fmbd.contacts.corners(rigid, ends), restitution, friction)

    assert exact.counters["impacts"] >= 1
    assert np.linalg.norm(found.state.q[:3] - exact.state.q[:3]) < 5e-3  # both rest; more points touch on the way
    assert found["force"][-1] == pytest.approx(exact["force"][-1], rel=1e-6, abs=1e-6)


@pytest.mark.mpi
def test_impacts_on_modes_never_gain_energy(rod_mesh: Callable[..., Any]) -> None:
    body = rod(rod_mesh(h=0.25, height=HEIGHT), 6, angular_velocity=0.3)
    run = falling(body, body.surface("side"), 0.0, 0.2, t_end=0.16)
    total = sum(run.energy[k] for k in ("kinetic", "elastic", "weight"))
    assert run.counters["impacts"] >= 1
    assert np.diff(total).max() < 1e-3 * np.ptp(run.energy["kinetic"])
    assert run["gap"].min() > -2e-4  # of 1 m


def test_pressed_on_a_floor_the_modes_follow_the_field(rod_mesh: Callable[..., Any]) -> None:
    """A clamped rod bent down to a floor under its tip: the way of the tip and the force there."""
    mesh = rod_mesh(h=0.25, height=HEIGHT)

    def pressed(body: Any, scheme: Any) -> tuple[float, float]:
        floor = fmbd.contacts.Obstacle("floor", fmbd.contacts.HalfSpace((0, -HEIGHT / 2 - 1e-3), (0, 1)))
        pair = fmbd.contact("floor", body.surface("side"), floor)
        scene = fmbd.Scene("pressed", gravity=(0, -2.0), gravity_ramp=0.4)
        scene.add(body, pair, fmbd.fixed("clamp", fmbd.ground, body.surface("pin")))
        scene.sensor("force", fmbd.sensors.contact_force(pair))
        scene.sensor("tip", fmbd.position(body.surface("tip")))
        run = fmbd.solve(scene, t_end=0.6, dt=5e-3, scheme=scheme)
        return run["tip"][-1, 1], float(np.mean(run["force"][-30:, 1]))

    full = fmbd.FloatingBody("rod", mesh, density=DENSITY, elastic=plane_stress(1e7, 0.3), stiffness_damping=0.01)
    tip, force = pressed(full, fmbd.schemes.ContactMidpoint())
    there, push = pressed(
        full.reduced(basis=fmbd.CraigBampton(("pin", "tip"), count=4, inertia=True)), fmbd.schemes.Moreau()
    )
    assert there == pytest.approx(tip, rel=0.03)
    assert push == pytest.approx(force, rel=0.05)
    assert abs(force) > 50.0


def test_schemes_without_an_impact_law_refuse_inertia_on_contact_points(rod_mesh: Callable[..., Any]) -> None:
    body = rod(rod_mesh(h=0.25, height=HEIGHT), 2)
    scene = fmbd.Scene("falling", gravity=(0, -9.81))
    pair = fmbd.contact(
        "floor", body.surface("side"), fmbd.contacts.Obstacle("f", fmbd.contacts.HalfSpace((0, -1), (0, 1)))
    )
    scene.add(body, pair)
    with pytest.raises(InputError, match="Moreau"):
        fmbd.solve(scene, t_end=0.1, dt=0.01, scheme=fmbd.schemes.ContactMidpoint())


def test_corners_of_a_reduced_body_are_refused_by_its_name(rod_mesh: Callable[..., Any]) -> None:
    """Where a RigidBody is wanted, a body whose name is not a field of its own is shown by its name as all are."""
    with pytest.raises(InputError, match=r'body ReducedBody "rod" must be a RigidBody'):
        fmbd.contacts.corners(rod(rod_mesh(h=0.25, height=HEIGHT), 0), [(-0.5, -0.1)])
