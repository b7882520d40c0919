"""The definitions: every elementary constraint, joint coordinate and load, each one expression of two frames A and B.

A *coordinate* s(A, B) is a length (m) or an angle (rad). A constraint demands that a sum of coordinates follows a motion of
time; a spring, a damper or a drive exerts an effort N along one. A *flow* is a speed that is no rate of a coordinate: the power
of a unit load, linear in the twists.

==================  =========================================================================================
``coincident``      n . d, n fixed in space
``along``           e . d, e fixed in A
``perpendicular``   e . f, f fixed in B
``turned``          the same with e turned in A by a prescribed angle
``distance``        (d . d / L - L) / 2
``separation``      |d|
``angle``           rotation of B against A about e, counted over revolutions
``tied``            n . (x_b - x_a) + c; ``tied_along``: n fixed in B
``dead``            f . x_B, the load f fixed in space; ``couple``: its torque, ``follower`` and ``follower_couple``: fixed in B
``wheel_height``    e . d - r |m| - c: a wheel of radius r about the axis f of B, tread c, over the plane of A with normal e
``wheel_slip``      velocity along the direction t of A of the wheel's lowest point against the plane
``ball_slip``       the same for a ball, in the plane a disc
``skate``           velocity of the point q of B against A along e, fixed in B
==================  =========================================================================================

with d = x_b + R_b q - x_a - R_a p and m = e - (e . f) f, which points from the lowest point of a wheel to its centre.
What follows from a definition is in :mod:`.derivation`.
"""

from __future__ import annotations

from collections.abc import Callable

from .expressions import Expression, atan2, cos, nearest_turn, sin, sqrt
from .frames import AskedConstants, SymbolicFrame, Vector, cross, spin

Definition = Callable[[SymbolicFrame, SymbolicFrame, AskedConstants], Expression]


def _between(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Vector:
    """From the point p of A to the point q of B."""
    return b.point(c.vector("q")) - a.point(c.vector("p"))


def coincident(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """Distance of the points along a direction fixed in space."""
    return c.vector("e") @ _between(a, b, c)


def along(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """Distance of the points along a direction fixed in A."""
    return a.axis(c.vector("e")) @ _between(a, b, c)


def perpendicular(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """Cosine of the angle between a direction of A and one of B."""
    return a.axis(c.vector("e")) @ b.axis(c.vector("f"))


def turned(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """The same; the direction of A turns from e towards g by the prescribed angle."""
    e, g, f = (c.vector(name) for name in "egf")
    s = c.scalar("drive")
    return (a.axis(e) * cos(s) + a.axis(g) * sin(s)) @ b.axis(f)


def distance(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """Zero where the points are the length apart; the multiplier is a force."""
    d, length = _between(a, b, c), c.scalar("length")
    return ((d @ d) / length - length) * 0.5


def separation(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """Distance of the points."""
    d = _between(a, b, c)
    return sqrt(d @ d)


def angle(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """Rotation of B against A; in space about e of A with e, f, g a basis of both, next to the angle counted so far."""
    if a.phi is not None and b.phi is not None:
        return b.phi - a.phi - c.scalar("zero")
    near = c.scalar("near")
    fa, ga, fb, gb = (frame.axis(c.vector(name)) for frame, name in ((a, "fa"), (a, "ga"), (b, "fb"), (b, "gb")))
    return nearest_turn(atan2(ga @ fb - fa @ gb, fa @ fb + ga @ gb), near)


def tied(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """Distance of the frames along a direction fixed in space, beside a constant one."""
    return c.vector("e") @ (b.x - a.x) + c.scalar("shift")


def tied_along(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """Distance of the frames along a direction fixed in B, beside a constant one."""
    return b.axis(c.vector("e")) @ (b.x - a.x) + c.scalar("shift")


def dead(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """Minus the potential of a force fixed in space at the point q of B."""
    return c.vector("load") @ b.point(c.vector("q"))


def couple(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """Power of a torque fixed in space."""
    return c.vector("load", len(b.w)) @ b.w


def follower(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """Power of a force fixed in B at its point q."""
    return b.axis(c.vector("load")) @ b.velocity(c.vector("q"))


def follower_couple(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """Power of a torque fixed in B."""
    load = c.vector("load", len(b.w))
    return load @ b.w if b.dim == 2 else b.axis(load) @ b.w


def wheel_height(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """Height of a wheel's lowest point over the plane through the point p of A."""
    normal = a.axis(c.vector("e"))
    axis = b.axis(c.vector("f"))
    along = cross(normal, axis)
    return normal @ _between(a, b, c) - c.scalar("radius") * sqrt(along @ along) - c.scalar("tread")


def wheel_slip(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """Speed at which a wheel's lowest point slips over A, along one direction of A."""
    normal = a.axis(c.vector("e"))
    axis = b.axis(c.vector("f"))
    along = cross(normal, axis)
    upward = cross(axis, along) / sqrt(along @ along)
    return _slip(a, b, c, upward * c.scalar("radius") + normal * c.scalar("tread"))


def ball_slip(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """Speed at which a ball's lowest point slips over A, along one direction of A."""
    return _slip(a, b, c, a.axis(c.vector("e")) * c.scalar("radius"))


def _slip(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants, up: Vector) -> Expression:
    """Velocity of the material point of B that lies ``up`` below q against that of A at the same place, along t of A."""
    from_b = b.axis(c.vector("q")) - up
    from_a = b.x - a.x + from_b
    return a.axis(c.vector("t")) @ (b.v + spin(b.w, from_b) - a.v - spin(a.w, from_a))


def skate(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
    """Speed of a blade across itself, against what it runs on."""
    arm = b.axis(c.vector("q"))
    return b.axis(c.vector("e")) @ (b.v + spin(b.w, arm) - a.v - spin(a.w, b.x - a.x + arm))


COORDINATES: dict[str, Definition] = {
    f.__name__: f
    for f in (coincident, along, perpendicular, turned, distance, separation, angle, tied, tied_along, dead)
}
FLOWS: dict[str, Definition] = {f.__name__: f for f in (couple, follower, follower_couple, ball_slip, skate)}
IN_SPACE: tuple[tuple[Definition, bool], ...] = ((wheel_height, False), (wheel_slip, True))  # and whether it is a flow
