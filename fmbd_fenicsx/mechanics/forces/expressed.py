"""A force element of a user's own, by one formula of two markers.

    V(A, B)              a potential: wrenches  -dV/d(displacements),  energy V                                   (1)
    s(A, B), N(s, s', t) a coordinate and a restoring effort: wrenches  -N ds/d(displacements)                    (2)

Rows, tangents and compiled kernels follow from the formula (:mod:`~..kinds.own`), as for the package's own springs; (1) is (2)
with s = V and N = 1, so that the stiffness of the potential is the geometric stiffness of a unit effort.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

from ...checks import function, typed
from ...errors import InputError
from ..joints.expressed import start_place
from ..joints.joints import dimension
from ..kinds.expressions import Expression, Program, gradient, symbol
from ..kinds.own import OwnTerm, finite_at, own_term, traced
from .effort_laws import EffortLaw
from .force_elements import Loads, ScalarLoads
from .forces import Force, Law, Point

ELONGATION = symbol("s")
RATE = symbol("rate")
TIME = symbol("t")


class OfPotential(EffortLaw):
    """The unit effort of (1): the coordinate itself is the energy."""

    conserves = True
    gives = False

    @property
    def formula(self) -> tuple[str, tuple[float, ...]]:
        """1 in compiled steps."""
        return "POTENTIAL", ()

    def __call__(self, s: float, rate: float, t: float) -> float:
        """1."""
        return 1.0

    def slopes(self, s: float, rate: float, t: float) -> tuple[float, float]:
        """None: all stiffness is that of the potential."""
        return 0.0, 0.0

    def stored(self, s: float) -> float:
        """V, J."""
        return s


@dataclass(frozen=True)
class FormulaLaw(EffortLaw):
    """An effort N(s, s', t) by one formula, with its exact slopes."""

    program: Program

    def _at(self, s: float, rate: float, t: float) -> list[Any]:
        return self.program({"s": s, "rate": rate, "t": t})

    def __call__(self, s: float, rate: float, t: float) -> float:
        """N."""
        return float(self._at(s, rate, t)[0])

    def slopes(self, s: float, rate: float, t: float) -> tuple[float, float]:
        """dN/ds and dN/ds'."""
        _, by_s, by_rate = self._at(s, rate, t)
        return float(by_s), float(by_rate)


@dataclass(frozen=True, eq=False)
class ExpressedForce(Force):
    """A force element by a formula, see :func:`force_element`."""

    term: OwnTerm = None  # type: ignore[assignment]
    law: Law | None = None
    of_time: bool = False
    stiffness: float = field(default=0.0, init=False)
    damping: float = field(default=0.0, init=False)
    length: float = field(default=0.0, init=False)

    batch: ClassVar[type[Loads]] = ScalarLoads
    kind: ClassVar[str] = "force element"


@typed
def force_element(
    name: str,
    a: Any,
    b: Any,
    expression: Callable[..., Any],
    *,
    law: Law | None = None,
    points: tuple[Point, Point] = (None, None),
) -> ExpressedForce:
    """A force element of your own: expression(a, b, t) -> a potential in J, or with ``law`` the coordinate that it acts along.

    a and b are the two markers, their arrays in world axes: ``x`` (d,) position in m, ``R`` (d, d) rotation since the start. The
    formula is written as that of :func:`fmbd_fenicsx.constraint`, of places and rotations; a potential alone gives the forces:

        def magnets(a, b, t):
            d = b.x - a.x
            return 0.02 / (d @ d) ** 1.5

    With a law, law(s, s', t) is the restoring effort N on the coordinate s of the formula: in N for s in m, in N m for s in rad,
    so that N s' is the power taken from the bodies.

    Forces, tangents and a compiled kernel are derived from the formula; a law that is a formula too gives its exact slopes.
    The energy of a potential is counted under "springs". Sensors: ``element_effort``, ``element_force``, ``element_torque``,
    ``element_power``, ``elongation`` (s, or V).

    Args:
        name: of the element.
        a, b: rigid bodies, surfaces of elastic bodies, sections of rods, or the ground.
        expression: called once, with symbols.
        law: None for a potential.
        points: the two markers, world, initial configuration (m); None: the position of a rigid body, the centroid of a surface,
            the origin of the world.

    Raises:
        InputError: the formula is none, depends on no marker, holds time or velocities, or has no derivative at the start.
    """
    what = f'Force element "{name}"'
    dim = dimension(a, b, name)
    found = traced(what, expression, dim)
    if len(found) != 1:
        raise InputError(
            f"{what}: its expression(a, b, t) returned {len(found)} formulas, expected one: a potential or a coordinate."
        )
    term = own_term(what, found[0], dim)
    if term.kind.flow or term.in_time:
        held = "velocities" if term.kind.flow else "the time"
        raise InputError(
            f"{what}: its formula holds {held}; expected one of places and rotations. Rates and time are for law(s, rate, t)."
        )

    effort = OfPotential() if law is None else _effort(what, law)
    made = ExpressedForce(name, a, b, points[0], points[1], term, effort, law is None)
    places = [start_place(side, point, dim) for side, point in zip((a, b), points, strict=True)]
    if all(x is not None for x in places):
        finite_at(what, [term], places, dim)
    return made


def _effort(what: str, law: Law) -> Law:
    """The law as a formula with exact slopes; as it is where it is none."""
    function(f"{what}: law", law)
    try:
        y = law(ELONGATION, RATE, TIME)
    except Exception:
        return law  # cases, tables: differences will do
    return FormulaLaw(Program([y, *gradient(y, [ELONGATION, RATE])])) if isinstance(y, Expression) else law
