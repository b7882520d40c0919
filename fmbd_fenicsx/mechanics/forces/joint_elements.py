"""Friction, stops and motors in joints: force elements on a joint coordinate s (an angle or a displacement).

=======================  ================================================================================
:func:`joint_friction`   friction, smooth through rest (Coulomb, Stribeck, viscous); any scheme
:func:`dry_friction`     friction with true rest: holds any load below its limit; memory of where it sticks
:func:`elastic_stop`     stops with a stiffness and damping; any scheme
:func:`motor`            a motor with feedback: proportional and derivative gains, torque limit
=======================  ================================================================================

Rigid stops with restitution are unilateral constraints, :func:`fmbd_fenicsx.joint_limit`; these here are elastic.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...checks import number, typed
from ...errors import require
from ..joints.couplings import smooth_motion
from ..joints.sums import Coordinate
from .dry_friction import DryFriction
from .effort_laws import ElasticStop, Feedback, Friction, Held, not_negative, positive
from .forces import CoordinateForce


def _on(name: str, coordinate: Coordinate, law: Any) -> CoordinateForce:
    """The force element of a law on a joint coordinate."""
    joint = coordinate.joint
    return CoordinateForce(name, joint.a, joint.b, None, None, coordinate, law=law)


@typed
def joint_friction(
    name: str,
    on: Coordinate,
    *,
    coulomb: float,
    speed: float,
    static: float | None = None,
    stribeck: float | None = None,
    viscous: float = 0.0,
) -> CoordinateForce:
    """Friction of a joint, smooth through rest: (F_c + (F_s - F_c) exp(-(s'/v_s)^2)) tanh(s'/v_0) + c s' against the rate s'.

    Args:
        on: ``fmbd.angle(joint)`` or ``fmbd.displacement(joint)``.
        coulomb: F_c, friction while sliding, N m or N. Constant: it does not follow the load of the bearing.
        speed: v_0, rate (rad/s, m/s) at which sliding friction is reached to 76 %; below it the joint creeps.
        static: F_s >= F_c, friction at the onset of sliding; F_c by default.
        stribeck: v_s, rate over which F_s falls to F_c; 10 v_0 by default.
        viscous: c, N m s or N s/m.

    For true rest under load use :func:`dry_friction`.
    """
    require(
        stribeck is None or static is not None,
        f'Friction "{name}": stribeck is the rate over which static falls to coulomb; give static as well.',
    )
    static = coulomb if static is None else static
    stribeck = 10 * speed if stribeck is None else stribeck
    not_negative("Friction", name, coulomb=coulomb, static=static, viscous=viscous)
    positive("Friction", name, speed=speed, stribeck=stribeck)
    require(static >= coulomb, f'Friction "{name}": static = {static} is less than coulomb = {coulomb}.')
    return _on(name, on, Friction(coulomb, speed, static, stribeck, viscous))


@typed
def dry_friction(name: str, on: Coordinate, *, limit: float, stick: float, damping: float = 0.0) -> DryFriction:
    """Dry friction with true rest: the set-valued law -N in [-F, F] at rest, N = F sign(s') while sliding.

        N = k (s - p) + c s',   |N| <= F,   p follows s while |N| = F                                              (1)

    The point p where the joint sticks is memory of the run: kept in checkpoints, moved by accepted steps only. A load below F
    is held without creep, at an elastic deflection of load / k. A joint that moves at the start slides from there on.

    Args:
        on: ``fmbd.angle(joint)`` or ``fmbd.displacement(joint)``.
        limit: F, N m or N.
        stick: k, stiffness before sliding, N m/rad or N/m. Sliding sets in after F / k; make that small against the motion.
        damping: c, of vibrations on that stiffness, N m s or N s/m.

    A step in which it begins or ends to slide has an error of first order, as steps over any kink; steps of a scheme's own choice
    keep its tolerance there.
    """
    positive("Dry friction", name, limit=limit, stick=stick)
    not_negative("Dry friction", name, damping=damping)
    return DryFriction(name, on.joint.a, on.joint.b, None, None, on, float(limit), float(stick), float(damping))


@typed
def elastic_stop(
    name: str,
    on: Coordinate,
    *,
    lower: float = -np.inf,
    upper: float = np.inf,
    stiffness: float,
    damping: float = 0.0,
    width: float = 1e-3,
) -> CoordinateForce:
    """Stops of a joint coordinate at ``lower`` and ``upper`` (rad or m), each a spring and damper that can only push.

    ``damping`` (N m s, N s/m) sets in over the depth ``width`` (rad, m), so that the force has no jump.
    """
    require(not lower >= upper, f'Stop "{name}": lower = {lower} must be less than upper = {upper}.')
    require(np.isfinite(lower) or np.isfinite(upper), f'Stop "{name}": give lower, upper, or both.')
    positive("Stop", name, stiffness=stiffness, width=width)
    not_negative("Stop", name, damping=damping)
    return _on(name, on, ElasticStop(float(lower), float(upper), stiffness, damping, width))


@typed
def motor(
    name: str,
    on: Coordinate,
    *,
    target: Callable[[float], Any] | float,
    kp: float,
    kd: float = 0.0,
    limit: float = np.inf,
) -> CoordinateForce:
    """A motor with feedback: effort kp (s_0 - s) + kd (s_0' - s') on a joint coordinate, cut at +- ``limit``.

    Args:
        target: s_0, a number or a smooth function of time (rad or m); it may return (s, s', s'').
        kp, kd: gains, N m/rad and N m s (N/m, N s/m).
        limit: largest effort, N m or N.

    Its effort is a sensor, ``fmbd.element_effort(motor)``. With an integral part or other sensors: :func:`~fmbd_fenicsx.pid`,
    :func:`~fmbd_fenicsx.controller`.
    """
    not_negative("Motor", name, kp=kp, kd=kd)
    require(limit > 0, f'Motor "{name}": limit = {limit} must be positive.')
    return _on(name, on, Feedback(kp, kd, motion_of(name, target), limit))


def motion_of(name: str, target: Callable[[float], Any] | float) -> Callable[[float], tuple[float, float, float]]:
    """A target as t -> (s, s', s'')."""
    if callable(target):
        return smooth_motion(name, target, of="target of motor")
    return Held(number(f'Motor "{name}": target, where it is no function of time,', target))
