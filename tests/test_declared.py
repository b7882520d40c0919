"""A scheme that does not take what a scene holds says so before anything is computed, with scheme, object and reason."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import contacts, materials
from fmbd_fenicsx.errors import InputError


def scene(*parts: Any) -> fmbd.Scene:
    made = fmbd.Scene("refused", gravity=(0, -9.81) if parts[0].dim == 2 else (0, 0, -9.81))
    made.add(*parts)
    return made


def floor(touching: Any, **more: Any) -> Any:
    ground = contacts.Obstacle("ground", contacts.HalfSpace((0, -1), (0, 1)))
    return fmbd.contact("floor", touching, ground, **more)


def ball() -> Any:
    return fmbd.RigidBody("ball", 1.0, 1.0)


def on_the_floor(mesh: Any) -> fmbd.Scene:
    body = ball()
    return scene(body, floor(contacts.ball(body, 0.1)))


def soft(mesh: Any, kind: Any = fmbd.AbsoluteBody, **law: Any) -> Any:
    law = law or {"elastic": materials.plane_stress(1e8, 0.3)}
    return kind("rod", mesh, density=1000.0, **law)


def soft_on_the_floor(mesh: Any) -> fmbd.Scene:
    body = soft(mesh)
    return scene(body, floor(body.surface("side")))


def incompressible(mesh: Any) -> fmbd.Scene:
    return scene(soft(mesh, energy=materials.neo_hookean_incompressible(1e8)))


def rolling(mesh: Any) -> fmbd.Scene:
    wheel = fmbd.RigidBody("wheel", 1.0, (1.0, 1.0, 1.0), position=(0, 0, 0.1))
    return scene(wheel, fmbd.rolling("road", fmbd.ground, wheel, shape=fmbd.Ball(0.1), normal=(0, 0, 1)))


def stopped(mesh: Any) -> fmbd.Scene:
    wheel = fmbd.RigidBody("wheel", 1.0, (1.0, 1.0, 1.0))
    hinge = fmbd.revolute("hinge", fmbd.ground, wheel, center=(0, 0, 0))
    return scene(wheel, hinge, fmbd.joint_limit("stop", fmbd.angle(hinge), lower=-0.5))


ALPHA, EM = fmbd.GeneralizedAlpha(), fmbd.EnergyMomentum()
MIDPOINT, CALPHA, MOREAU = fmbd.ContactMidpoint(), fmbd.schemes.ContactAlpha(), fmbd.Moreau()
GGL = fmbd.forms.GGL
CASES = [
    (
        ALPHA,
        on_the_floor,
        r'generalized-alpha\(rho_inf=0.8\) does not treat contact, and the scene has "floor". Use fmbd.Moreau\(\).$',
    ),
    (
        fmbd.BDF(),
        soft_on_the_floor,
        r"BDF\(5\), GGL does not treat contact, and .* fmbd.ContactMidpoint\(\) or fmbd.ContactAlpha\(\).$",
    ),
    (fmbd.Radau(), stopped, r'GGL has no impacts, and the scene has the joint limit "stop". Use fmbd.Moreau\(\), or'),
    (MIDPOINT, on_the_floor, 'Contact "floor" is between rigid .* midpoint has no impact law'),
    (CALPHA, on_the_floor, 'Contact "floor" is between rigid .* generalized-alpha.* has no impact law'),
    (CALPHA, lambda mesh: scene(soft(mesh)), "is a scheme for scenes with contact"),
    (MOREAU, lambda mesh: scene(ball()), "Moreau is a scheme for scenes with contact"),
    (MOREAU, soft_on_the_floor, 'Contact "floor" is of an elastic surface whose nodes carry no inertia'),
    (
        fmbd.Radau(form=fmbd.forms.Index1()),
        incompressible,
        'Body "rod" has a pressure that is an unknown; Radau IIA.*, Index1 does not solve for it',
    ),
    (fmbd.GeneralizedAlpha(form=GGL()), incompressible, 'Body "rod" has a pressure .* GGL.* does not solve for it'),
    (EM, lambda mesh: scene(soft(mesh, fmbd.FloatingBody)), '"rod" is not one. Use an AbsoluteBody'),
    (
        EM,
        lambda mesh: scene(soft(mesh, energy=lambda u, dx: 0 * dx)),
        'Body "rod": EnergyMomentum needs a StoredEnergy',
    ),
    (fmbd.BDF(order=3, rtol=None), lambda mesh: scene(soft(mesh)), 'Body "rod": BDF of order 3 amplifies'),
    (fmbd.Rattle(), rolling, r'Joint "road" \(rolling\) holds velocities only, and Rattle asks'),
    (fmbd.Radau(), rolling, r'Joint "road" \(rolling\) holds velocities only, and form=GGL'),
    (fmbd.BDF(), rolling, r'Joint "road" \(rolling\) holds velocities only, and form=GGL'),
]


@pytest.mark.parametrize(("scheme", "make", "reason"), CASES)
def test_refused_before_the_scene_is_built(
    scheme: Any, make: Any, reason: str, rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = make(rod_mesh(h=0.25))
    monkeypatch.setattr(fmbd.Scene, "build", lambda self: pytest.fail("built before it was refused"))
    with pytest.raises(InputError, match=reason):
        fmbd.solve(made, t_end=0.1, dt=0.01, scheme=scheme)
    with pytest.raises(InputError, match=reason), fmbd.stepper(made, dt=0.01, scheme=scheme):
        pass


def test_taken_where_nothing_stands_against_it(rod_mesh: Callable[..., Any]) -> None:
    """The same schemes with what they take: a locked body and redistributed inertia are no reasons."""
    body = soft(rod_mesh(h=0.25))
    heavy = scene(body, floor(body.surface("side"), redistribute_mass=False))
    still = fmbd.RigidBody("still", 1.0, 1.0, locked=True)
    for scheme, made in ((MOREAU, heavy), (MIDPOINT, soft_on_the_floor(rod_mesh(h=0.25))), (EM, scene(ball(), still))):
        assert fmbd.solve(made, t_end=2e-3, dt=1e-3, scheme=scheme).status == "finished"


def test_a_surface_without_a_mesh_is_refused_where_it_is_given() -> None:
    law = {"youngs_modulus": 1e9, "poisson_ratio": 0.3, "density": 1e3, "width": 0.1, "height": 0.1}
    beam = fmbd.Beam("beam", (0, 0), (1, 0), fmbd.Section.rectangle(**law))
    with pytest.raises(InputError, match='Contact "floor": body "beam" has no mesh whose surface could touch'):
        floor(beam.surface("end"))
