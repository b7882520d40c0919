"""A constraint of a user's own, by one formula of two markers and of time, or by a function of numbers.

    def bowl(a, b, t):
        x, y, z = b.x - a.x
        return z - 0.5 * (x * x + y * y)

    scene.add(fmbd.constraint("bowl", fmbd.ground, bead, bowl))

The formula g(A, B, t) = 0 is written down once, when the constraint is made. Its rows, g', g'' and the stiffness of its reaction
are derived from it, and evaluated by compiled kernels as those of the package's own joints (:mod:`~..kinds.own`). A formula of
velocities, linear in them, is a nonholonomic constraint.

A function of numbers (:func:`own_joint`) that takes symbols as well is a formula, too; another one is called at every evaluation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...checks import function as checked_function
from ...checks import typed, unchanging, vector
from ...errors import InputError, require
from ...rotations import Array, Motions
from ..bodies.bodies import RigidBody
from ..kinds.own import OwnTerm, finite_at, own_term, traced
from . import constraints as ct
from .couplings import smooth_motion
from .joints import Joint, Vector, center_point, dimension, direction, ground


@unchanging
@dataclass(frozen=True, eq=False)
class ExpressedJoint(Joint):
    """Rows by formulas of a user's own; its two points are apart."""

    @property
    def joined(self) -> bool:
        """Each side has a point of its own."""
        return False

    @property
    def reaction_units(self) -> tuple[str, ...]:
        """Multipliers of formulas of rotations alone are moments; what functions of numbers return is not known."""
        if not self.rows:
            return ()
        dim = len(self.rows[0].direction)
        width = 3 * (dim - 1)
        turning = [all(i % width >= dim for i in row.own.entries) for row in self.rows if row.own]
        return tuple("N m" if alone else "N" for alone in turning)


@typed
def constraint(
    name: str,
    a: Any,
    b: Any,
    expression: Callable[..., Any],
    *,
    point_a: Vector | None = None,
    point_b: Vector | None = None,
) -> ExpressedJoint:
    """A constraint of your own: expression(a, b, t) -> a formula, or several, that vanish where the constraint holds.

    a and b are the two markers, their arrays in world axes: ``x`` (d,) position in m, ``R`` (d, d) rotation since the start (its
    columns are the axes that the body carries), ``v`` (d,) velocity in m/s, ``w`` (3,), in the plane (1,), angular velocity in
    rad/s; t is the time in s. Write the formula with +, -, *, /, ** and NumPy's ``sqrt``, ``sin``, ``cos``, ``exp``, ``log``,
    ``tanh``, ``arccos``, ``arctan2``, ``dot``, ``cross``:

        def rod(a, b, t):
            d = b.x - a.x
            return np.sqrt(d @ d) - 0.5

    The function is called once, here; g', g'', the tangent and a compiled kernel are derived from its formula, so that every
    scheme and analysis takes the constraint. Its multiplier times the row of the formula is the force on the markers.

    Args:
        name: of the constraint; :func:`fmbd_fenicsx.reaction_force` and others find it by it.
        a, b: rigid bodies, surfaces of elastic bodies, sections of rods, or the ground.
        expression: a length in m or, of rotations alone, an angle in rad: residuals are judged by the size of the model. Where it
            holds velocities it must be linear in them, and is a nonholonomic constraint.
        point_a, point_b: the markers, world, initial configuration (m); None: the position of a rigid body, the centroid of a
            surface, the origin of the world.

    Raises:
        InputError: the function fails for symbols, returns no formula, depends on no marker, or has no derivative at the start.
    """
    dim = dimension(a, b, name)
    what = f'Constraint "{name}"'
    given = {"point_a": point_a, "point_b": point_b}
    points = [None if x is None else vector(f"{what}: {end}", x, size=dim) for end, x in given.items()]
    places: list[Any] = [start_place(side, point, dim) for side, point in zip((a, b), points, strict=True)]
    terms = [own_term(what, y, dim) for y in traced(what, expression, dim)]

    # where both markers are known already, what cannot be evaluated is refused here
    if all(x is not None for x in places):
        finite_at(what, terms, places, dim)
    rows = tuple(_row(name, term, dim) for term in terms)
    return ExpressedJoint(name, a, b, rows, places[0], places[1], kind="own")


@dataclass(frozen=True, eq=False)
class OwnJoint(ExpressedJoint):
    """Rows g(x_a, R_a, x_b, R_b, t) = 0 given by the user; ``rows`` where they are formulas, else ``function`` tells them."""

    function: Callable[..., Any] = field(default=None)  # type: ignore[assignment]
    apart: bool = False  # the markers sit at points of their own

    @property
    def joined(self) -> bool:
        """Both sides meet at one point where none is given."""
        return not self.apart


@typed
def own_joint(
    name: str,
    a: Any,
    b: Any,
    function: Callable[..., Any],
    *,
    center: Vector | None = None,
    axis: Vector | None = None,
    point_a: Vector | None = None,
    point_b: Vector | None = None,
) -> OwnJoint:
    """A joint of your own: function(x_a, R_a, x_b, R_b, t) -> (m,) numbers that are zero when the joint is closed.

    x are the world positions (m) of the two markers and R their rotations since the start, (d, d). Both markers sit at
    ``center`` or, as those of a rope, at ``point_a`` and ``point_b`` (world, initial configuration; one that is left out as
    in :func:`constraint`). Lengths in m, angles in rad, so that the checks can judge residuals. Written as one formula with
    NumPy operations (no ``abs``, no ``float``, no cases) it is compiled as that of :func:`constraint`; else called at every
    evaluation. See docs/own_joint.md.

    Raises:
        InputError: center and points together, or a number that no motion of the markers changes (when the scene is built).
    """
    dim = dimension(a, b, name)
    c = center_point(center, dim, name)
    places: tuple[Any, Any] = (c, c)
    apart = point_a is not None or point_b is not None
    if apart:
        require(center is None, f'Joint "{name}": give center, where both markers sit, or point_a and point_b.')
        given = {"point_a": point_a, "point_b": point_b}
        points = [None if x is None else vector(f'Joint "{name}": {end}', x, size=dim) for end, x in given.items()]
        places = start_place(a, points[0], dim), start_place(b, points[1], dim)

    way = None if axis is None else direction(axis, dim, name)
    checked_function(f'Joint "{name}": function', function, range(5), named="x_a, R_a, x_b, R_b, t")
    rows = _formula_rows(name, function, dim, places)
    return OwnJoint(name, a, b, rows, *places, kind="own", axis=way, function=function, apart=apart)


def _formula_rows(name: str, function: Callable[..., Any], dim: int, places: tuple[Any, Any]) -> tuple[ct.Row, ...]:
    """The rows of a function that symbols pass; none where they do not, or where its formulas have no numbers at the start."""
    what = f'Joint "{name}"'
    points = [np.zeros(dim) if x is None else x for x in places]
    try:
        terms = [own_term(what, y, dim) for y in traced(what, lambda a, b, t: function(a.x, a.R, b.x, b.R, t), dim)]
        finite_at(what, terms, points, dim)
    except InputError:
        return ()
    return tuple(_row(name, term, dim) for term in terms)


def is_asked(joint: Joint) -> bool:
    """Whether a joint's rows are told by a function of numbers."""
    return isinstance(joint, OwnJoint) and not joint.rows


def asked_rows(joint: Joint, motions: Motions, length: Callable[[], float]) -> list[ct.Row]:
    """The rows of a joint by a function of numbers, in a model of a length (m): as many as it returns."""
    from ..kinds.asked import AskedFunction, asked_kind

    assert isinstance(joint, OwnJoint)
    live = [side for side, body in enumerate((joint.a, joint.b)) if body is not ground]
    asked = AskedFunction(joint.name, joint.function, motions, live, length())
    kind, still = asked_kind(asked), np.zeros(motions.dim)
    numbers = ({"component": float(i)} for i in range(asked.count))
    return [ct.Row(ct.ExpressedInTime, still, motion=asked.clock, own=kind, constants=number) for number in numbers]


def _row(name: str, term: OwnTerm, dim: int) -> ct.Row:
    """The row of a formula; where time is in it, that is its motion."""
    batch = _BATCHES[term.kind.flow, term.in_time]
    motion = smooth_motion(name, lambda t: (t, 1.0, 0.0)) if term.in_time else ct.standstill
    return ct.Row(batch, np.zeros(dim), motion=motion, own=term.kind, constants=term.constants)


_BATCHES = {
    (False, False): ct.ExpressedConstraint,
    (False, True): ct.ExpressedInTime,
    (True, False): ct.ExpressedSpeed,
    (True, True): ct.ExpressedSpeedInTime,
}


def start_place(side: Any, point: Any, dim: int) -> Array | None:
    """Where a marker is at the start; None where a mesh has to tell."""
    if point is not None:
        return np.asarray(point, dtype=float)[:dim]
    if side is ground:
        return np.zeros(dim)
    return side.start_pose()[:dim] if isinstance(side, RigidBody) else None
