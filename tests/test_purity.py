"""State in, everything out: what was evaluated or tried in between changes no bit of what comes next."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_scenes import MESHES, SCHEMES, case

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import FmbdError
from fmbd_fenicsx.system.layout import State
from fmbd_fenicsx.system.system import System


def everything(system: System, s: State) -> list[np.ndarray]:
    """What an evaluation gives, as arrays."""
    ev = system.at(s.t, s.q, s.v)
    out = [ev.balance(s.a, s.lam), ev.constraint(), ev.constraint_rate(), ev.gamma(), ev.jacobian.times(s.v)]
    return [*out, np.array(list(ev.energies().values())), ev.jacobian.transposed(s.lam)]


@settings(max_examples=25, deadline=None, database=None, suppress_health_check=list(HealthCheck))
@given(st.integers(0, 2**32 - 1))
def test_evaluating_elsewhere_changes_nothing(number: int) -> None:
    """At A, at B, at A: the same bits at A."""
    system, start, _ = case(number).scene.build()
    rng = np.random.default_rng(number)

    def near() -> State:
        q = system.compose(start.q, 0.3 * rng.normal(size=system.n_v) / system.units)
        v, a = rng.normal(size=(2, system.n_v))
        return State(rng.uniform(), q, v, a, rng.normal(size=system.n_lam))

    A, B = near(), near()
    first = everything(system, A)
    everything(system, B)
    for x, y in zip(first, everything(system, A), strict=True):
        assert np.array_equal(x, y)


def links() -> fmbd.Scene:
    """Two links in space on a spring, one hinge counted and damped, the other driven."""
    scene = fmbd.Scene("links", gravity=(0, 0, -9.81))
    a = fmbd.RigidBody("a", 1.0, (0.01, 0.08, 0.08), position=(0.5, 0.0, 0.0))
    b = fmbd.RigidBody("b", 2.0, (0.02, 0.09, 0.09), position=(1.5, 0.0, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, a, center=(0, 0, 0), axis=(0, 1, 0.2))
    elbow = fmbd.revolute("elbow", a, b, center=(1, 0, 0), axis=(0, 1, 0))
    scene.add(a, b, pin, elbow, fmbd.joint_spring("coil", fmbd.angle(elbow), stiffness=30.0, damping=0.1))
    scene.add(fmbd.Spring("spring", fmbd.ground, b, (2, 0, 1), (2, 0, 0), stiffness=1e4, length=0.9))
    return scene


def rod() -> fmbd.Scene:
    """A floating rod on a pin."""
    mesh = fmbd.read_gmsh(MESHES / "rod.py", dim=2, h=0.25)
    body = fmbd.FloatingBody("rod", mesh, density=1000.0, elastic=fmbd.materials.plane_stress(5e6, 0.3))
    scene = fmbd.Scene("rod", gravity=(0.0, -9.81))
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0.0, 0.0)))
    return scene


def sheet() -> fmbd.Scene:
    """A rod of large strains on a pin: Newton takes new tangents in long steps."""
    mesh = fmbd.read_gmsh(MESHES / "rod.py", dim=2, h=0.25)
    law = fmbd.materials.sheet_saint_venant_kirchhoff(5e6, 0.3)
    body = fmbd.AbsoluteBody("rod", mesh, density=1000.0, energy=law)
    scene = fmbd.Scene("sheet", gravity=(0.0, -9.81))
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0.0, 0.0)))
    return scene


def ball() -> fmbd.Scene:
    """A ball on its way to a floor."""
    body = fmbd.RigidBody("ball", 1.0, 0.1, position=(0.0, 1.02), velocity=(0.3, -1.0))
    scene, floor = fmbd.Scene("ball", gravity=(0.0, -9.81)), fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0), (0, 1)))
    scene.add(body, fmbd.contact("floor", fmbd.ball(body, 1.0), floor, restitution=0.5, friction=0.3))
    return scene


CASES: list[Any] = [
    *((links, scheme) for scheme in SCHEMES),
    (links, fmbd.GeneralizedAlpha(0.8, compiled=False)),
    (links, fmbd.Radau(2, rtol=None)),
    (links, fmbd.BDF(2, rtol=None)),
    (rod, fmbd.GeneralizedAlpha(0.8)),
    (sheet, fmbd.GeneralizedAlpha(0.8)),
    (rod, fmbd.Radau(2, rtol=1e-4)),
    (ball, fmbd.Moreau()),
]


@pytest.mark.parametrize(("scene", "scheme"), CASES, ids=lambda x: getattr(x, "name", getattr(x, "__name__", None)))
def test_stepping_again_gives_the_same_bits(scene: Callable[[], fmbd.Scene], scheme: Any) -> None:
    """Three steps; back, and the same; back, a step that fails or goes elsewhere, back, and the same."""
    dt = 2e-3
    with fmbd.stepper(scene(), dt=dt, scheme=scheme) as s:
        for _ in range(3):
            s.step()
        kept = s.save()

        def walk() -> list[np.ndarray]:
            for _ in range(3):
                s.step()
            return [s.state.q, s.state.v, s.state.a, s.state.lam]

        first = walk()
        far = 3 * dt if getattr(scheme, "rtol", None) is not None else 1e5  # of a constant step: one that fails
        for elsewhere in (None, 3 * dt, far):
            s.restore(kept)
            if elsewhere is not None:
                with suppress(FmbdError):
                    s.step(elsewhere)
                s.restore(kept)
            for x, y in zip(first, walk(), strict=True):
                assert np.array_equal(x, y), elsewhere
