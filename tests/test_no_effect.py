"""Arguments that would have no effect are refused, and what is constant and what is a function of time follow one rule."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import CallbackError, InputError


def link(**options: Any) -> fmbd.RigidBody:
    return fmbd.RigidBody("link", 1.0, 0.1, position=(1.0, 0.0), **options)


def pendulum(*make: Any, **options: Any) -> fmbd.Scene:
    """A link on a hinge, with what is made of both."""
    scene, body = fmbd.Scene("pendulum", **options), link()
    scene.add(body, fmbd.revolute("hinge", fmbd.ground, body, center=(0, 0)))
    hinge = scene.joints["hinge"]
    scene.add(*(one(body, hinge) for one in make))
    scene.sensor("at", fmbd.position(body))
    return scene


def solved(scene: fmbd.Scene, **options: Any) -> fmbd.Run:
    return fmbd.solve(scene, t_end=0.2, dt=0.1, **options)


def equations(**options: Any) -> fmbd.CoordinateBody:
    return fmbd.CoordinateBody("mass", np.eye(1), lambda q, v, t: -q, (1.0,), **options)


ends = fmbd.ground, link(), (0, 0), (1, 0)
angle = fmbd.angle(fmbd.revolute("hinge", fmbd.ground, link(), center=(0, 0)))
own = {"law": lambda s, rate, t: 10.0 * s}
REFUSED = {
    "stiffness beside a law": (lambda: fmbd.Spring("k", *ends, stiffness=1.0, **own), "its law stands for stiffness"),
    "damping beside a law": (lambda: fmbd.joint_spring("k", angle, damping=1.0, **own), "its law stands for stiffness"),
    "second end of a tyre": (
        lambda: fmbd.Tyre("tyre", link(), fmbd.ground, road=lambda x, t: 0.0, stiffness=1.0),
        '"tyre": it has one end',
    ),
    "velocity of a locked body": (lambda: link(locked=True, velocity=(1.0, 0.0)), '"link" is locked'),
    "rate of no constraint": (lambda: equations(rate=lambda q, t: q), '"mass": rate belongs to a constraint'),
    "gamma of no constraint": (lambda: equations(gamma=lambda q, v, t: q), '"mass": gamma belongs to a constraint'),
    "atol without rtol": (lambda: fmbd.GeneralizedAlpha(atol=1e-6), "atol = 1e-06 belongs to error control"),
    "atol of equal steps": (lambda: fmbd.Radau(rtol=None, atol=1e-6), "atol = 1e-06 belongs to error control"),
    "ramp of no gravity": (lambda: solved(pendulum(gravity_ramp=1.0)), "gravity_ramp = 1 s switches on gravity"),
    "every beside times": (
        lambda: solved(pendulum(), output=fmbd.Output(every=2, times=(0.1, 0.2))),
        "every = 2 counts steps",
    ),
    "center of bodies that spin": (lambda: fmbd.Spin(1.0, center=(1, 0), bodies=("link",)), "has no effect"),
    "axis of a spin in the plane": (
        lambda: fmbd.equilibrium(pendulum(), spin=fmbd.Spin(1.0, axis=(0, 0, -1))),
        r"must be \(0, 0, 1\) in the plane",
    ),
    "normal of a plane blade": (
        lambda: fmbd.skate("ice", fmbd.ground, link(), along=(1, 0), normal=(0, 0, -1)),
        '"ice": normal .* is not',
    ),
}


@pytest.mark.parametrize(("make", "says"), REFUSED.values(), ids=REFUSED)
def test_what_has_no_effect_is_refused(make: Any, says: str) -> None:
    with pytest.raises(InputError, match=says):
        make()


@pytest.mark.parametrize("follower", [False, True])
def test_a_vector_of_the_plane_may_be_one_of_space(follower: bool) -> None:
    """A third number that is zero is allowed of a constant and of a function, another one of neither."""

    def push(law: Any) -> fmbd.Run:
        return solved(pendulum(lambda body, hinge: fmbd.force("push", body, law, follower=follower)))

    wanted = push((0.0, 2.0))["at"]
    for law in ((0.0, 2.0, 0.0), lambda t: (0.0, 2.0, 0.0), lambda t: [0, 2, 0]):
        assert (push(law)["at"] == wanted).all()
    with pytest.raises(InputError, match="z cannot be followed"):
        push((0.0, 2.0, 1.0))
    with pytest.raises(CallbackError, match='"push".*shape'):
        push(lambda t: (0.0, 2.0, 1.0))
    alike = solved(
        pendulum(lambda body, hinge: fmbd.own_force("push", body, None, lambda t, a: ((0.0, 2.0, 0.0), 0.0)))
    )
    assert alike["at"] == pytest.approx(push(lambda t: (0.0, 2.0))["at"], abs=1e-12) or follower


LAWS = {
    "effort": lambda body, hinge: fmbd.effort("own", fmbd.angle(hinge), lambda t: np.complex128(1.0 + 1.0j)),
    "force": lambda body, hinge: fmbd.force("own", body, lambda t: np.array([1.0j, 0.0])),
    "spring": lambda body, hinge: fmbd.joint_spring("own", fmbd.angle(hinge), law=lambda s, r, t: np.complex128(1.0j)),
    "motor": lambda body, hinge: fmbd.motor("own", fmbd.angle(hinge), target=lambda t: "1", kp=1.0),
    "controller": lambda body, hinge: fmbd.controller(
        "own", reads={"s": fmbd.angle(hinge)}, acts=fmbd.angle(hinge), law=lambda t, y, z: np.complex128(1.0j)
    ),
}


@pytest.mark.parametrize("make", LAWS.values(), ids=LAWS)
def test_laws_return_real_numbers(make: Any) -> None:
    """Neither complex ones, whose imaginary parts would be cut, nor texts."""
    with pytest.raises(CallbackError, match='"own"'):
        solved(pendulum(make))
