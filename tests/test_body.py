"""What bodies say of themselves: loads that may do work, damping, and what the guard and the report make of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import materials
from fmbd_fenicsx.mechanics.body import Body, Placed, Site
from fmbd_fenicsx.mechanics.placements import FrameMotion, Part
from fmbd_fenicsx.post.report import conservative


def elastic(mesh: Any, **more: Any) -> fmbd.FloatingBody:
    return fmbd.FloatingBody("rod", mesh, density=1000.0, elastic=materials.plane_stress(1e8, 0.3), **more)


PUSH = fmbd.traction("tip", (0.0, 1e6), time=lambda t: t)


@pytest.mark.parametrize("modes", [None, 4])
def test_loads_of_bodies_put_energy_in(rod_mesh: Callable[..., Any], modes: int | None) -> None:
    """No step is taken back for the work of a traction, and none of that work is called a loss; of reduced bodies too."""
    body: Any = elastic(rod_mesh(h=0.25), loads=(PUSH,))
    body = body if modes is None else body.reduced(modes=modes)
    scene = fmbd.Scene("pushed")
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0, 0)))
    run = fmbd.solve(scene, t_end=0.05, dt=1e-3)
    assert run.counters.get("energy_rejections", 0) == 0 and run.warnings == []
    assert run.total_energy[-1] > 100.0 and "numerical loss    not separable" in run.report()


def test_what_keeps_energy(rod_mesh: Callable[..., Any]) -> None:
    """Full and reduced bodies, rods and beams: with nothing that takes or gives, with damping, with loads."""
    mesh = rod_mesh(h=0.25)
    law = {"youngs_modulus": 1e8, "poisson_ratio": 0.3, "density": 1e3, "width": 0.1, "height": 0.1}
    line = [(0, 0, 0), (1, 0, 0)]

    def rod(relaxation: Any = (), **more: Any) -> fmbd.Rod:
        section = replace(fmbd.RodSection.rectangle(**law), relaxation=relaxation)
        return fmbd.Rod("rod", line, section, elements=2, **more)

    def beam(**more: Any) -> fmbd.Beam:
        return fmbd.Beam("rod", (0, 0), (1, 0), fmbd.Section.rectangle(**law), **more)

    keep = [elastic(mesh), elastic(mesh).reduced(modes=2), rod(), beam(), fmbd.RigidBody("rod", 1.0, 1.0)]
    damped = [elastic(mesh, mass_damping=1.0), elastic(mesh, stiffness_damping=1e-3), rod(damping=1e-3)]
    damped += [beam(mass_damping=1.0), beam(stiffness_damping=1e-3), elastic(mesh, mass_damping=1.0).reduced(modes=2)]
    damped += [rod(relaxation=[(0.5, 1e-2)])]
    loaded = [elastic(mesh, loads=(PUSH,)), elastic(mesh, loads=(PUSH,)).reduced(modes=2)]
    loaded += [rod(loads=[fmbd.RodLoad(lambda s, t: (0.0, 1.0, 0.0))])]

    for bodies, keeps, works in ((keep, True, False), (damped, False, False), (loaded, False, True)):
        for body in bodies:
            scene = fmbd.Scene("one")
            scene.add(body)
            assert (body.keeps_energy, body.may_do_work, conservative(scene)) == (keeps, works, keeps), body


def test_equations_of_a_users_own_may_do_anything() -> None:
    def own(**more: Any) -> fmbd.CoordinateBody:
        return fmbd.CoordinateBody("own", np.eye(1), lambda q, v, t: -q, [1.0], **more)

    assert own().may_do_work and not own().keeps_energy
    assert own(potential=lambda q: 0.5 * q @ q).keeps_energy


class Bouncer(Body):
    """A mass of 1 kg on a spring of 4 N/m, with one coordinate and no frame: 0.1 m from rest at the start."""

    name = "bouncer"
    dim = None
    framed = False
    by_surface = False
    alone = True

    def placed(self, site: Site) -> Placed:
        return Placed(Oscillator(self, site.ground), np.array([0.1]), np.zeros(1))


class Oscillator(Part):
    n, n_port = 1, 0
    reference, port_matrix = np.zeros(0), np.zeros((0, 1))

    def __init__(self, body: Bouncer, frame: int) -> None:
        self.name, self.body, self.frame = body.name, body, frame

    def force(self, motion: FrameMotion, local: Any) -> Any:
        u, _, second = local
        return np.zeros(len(motion.twist)), second + 4.0 * u

    def mass_blocks(self, motion: FrameMotion, u: Any) -> Any:
        n = len(motion.twist)
        return np.zeros((n, n)), np.zeros((1, n)), np.eye(1)

    def stiffness_blocks(self, motion: FrameMotion, local: Any) -> Any:
        return 4.0 * np.eye(1), np.zeros((1, 1))

    def energies(self, motion: FrameMotion, pose: Any, local: Any) -> Any:
        return 0.5 * float(local[1] @ local[1]), 2.0 * float(local[0] @ local[0]), 0.0

    def momenta(self, motion: FrameMotion, pose: Any, local: Any) -> Any:
        return np.zeros(2), np.zeros(1)

    def given(self, motion: FrameMotion, local: Any) -> Any:
        return {}


@pytest.mark.parametrize(
    "scheme", [fmbd.GeneralizedAlpha(0.9), fmbd.Radau(rtol=1e-8), fmbd.Rattle()], ids=lambda x: x.name
)
def test_a_body_of_the_users_own_that_is_no_rigid_one(scheme: Any) -> None:
    """A scene takes whatever derives from Body."""
    scene = fmbd.Scene("own", gravity=(0.0, -9.81))
    scene.add(Bouncer())
    scene.sensor("u", fmbd.sensors.coordinates("bouncer"))
    steps = {} if isinstance(scheme, fmbd.Radau) else {"dt": 2e-3}
    run = fmbd.solve(scene, t_end=1.0, scheme=scheme, **steps)
    assert run["u"][-1, 0] == pytest.approx(0.1 * np.cos(2.0), abs=1e-6)
