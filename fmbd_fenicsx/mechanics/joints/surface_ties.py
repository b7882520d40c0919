"""Ties of whole surfaces by field multipliers, as a user gives them: weak Dirichlet data, rigid faces, non-matching interfaces,
sliding.

    int_Gamma mu . (x_b + s(t) d(X) - x_a) dS = 0    for all mu of a multiplier space on the surface of a     (1)

x_a is the placement of an elastic surface, x_b that of another elastic surface (over the intersections of their facets), of a
rigid body, or of the ground; s(t) d(X) is a displacement that is imposed on top. The multiplier is the traction on the surface
of a, world axes (of a sliding tie: along the normal). Their rows: :mod:`.trace_rows`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from ...checks import check_fields, shown, typed, word
from ...errors import InputError, require
from ...fem.traces.multipliers import MultiplierSpace
from ...fem.traces.traces import surface_trace
from ...rotations import Array
from ..bodies.bodies import AbsoluteBody, FloatingBody, RigidBody, Surface
from ..parts import ScenePart
from ..rods.rods import Rod
from .constraints import Motion
from .couplings import smooth_motion
from .joints import ground

if TYPE_CHECKING:
    from ...fem.traces.stability import OnSurface


@dataclass(frozen=True, eq=False)
class SurfaceTie(ScenePart):
    """What a user says of a tie (1); see :func:`tie_surface`."""

    what = "tie"

    name: str
    a: Surface
    b: Any
    space: MultiplierSpace | None = None
    sliding: bool = False
    motion: Motion | None = None
    shape: Callable[[Array], Array] | None = None

    def __post_init__(self) -> None:
        word("A tie's name", self.name)
        check_fields(self, f'Tie "{self.name}"')

        for side, first in ((self.a, True), (self.b, False)):
            elastic = isinstance(side, Surface) and isinstance(side.body, AbsoluteBody | FloatingBody)
            rigid = side is ground or isinstance(side, RigidBody) or is_section(side)
            if not elastic and (first or not rigid):
                raise InputError(
                    f'Tie "{self.name}": {shown(side)} cannot be tied. a must be a surface of an AbsoluteBody or '
                    "FloatingBody; b such a surface, a section of a rod, a rigid body, or fmbd.ground."
                )

        if isinstance(self.b, Surface) and self.b.body is self.a.body and self.b.name == self.a.name:
            raise InputError(f'Tie "{self.name}" ties {self.a!r} with itself.')

    def multipliers_on(self) -> OnSurface:
        """Where its multipliers act: on its first surface."""
        return replace(self.a.multipliers_on(), space=self.space)

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """Its sides that are surfaces of elastic bodies: one or both."""
        return tuple(side for side in (self.a, self.b) if isinstance(side, Surface) and side.body.nodal)


def is_section(side: Any) -> bool:
    """Whether a side is a section of a rod, which moves as a rigid body does."""
    return isinstance(side, Surface) and isinstance(side.body, Rod)


@typed
def tie_surface(
    name: str,
    a: Surface,
    b: Any,
    *,
    space: MultiplierSpace | None = None,
    sliding: bool = False,
    motion: Callable[[float], float] | Motion | None = None,
    shape: Callable[[Array], Array] | None = None,
) -> SurfaceTie:
    """Tie the surface ``a`` of an elastic body to ``b`` point by point, in the weak sense (1).

    Args:
        name: what messages call it.
        a: surface that carries the multipliers (of two elastic surfaces the finer one).
        b: another elastic surface, a section of a rod, a rigid body, or ``fmbd.ground``.
        space: multiplier space; by default P1 with merged ends beside P1 (on one or two facets with the linear functions that
            are missing, so that it holds the rotation), P1 beside P2. ``scene.check()`` lists what a tie leaves free.
        sliding: True ties only the component normal to ``a`` (flat surfaces).
        motion: s(t) of an imposed displacement, 1 by default where ``shape`` is given.
        shape: d(X), function of world coordinates (d, n) -> (d, n), m.
    """
    require(
        motion is None or shape is not None,
        f'Tie "{name}": motion(t) needs a shape(X), the displacement that it scales.',
    )
    law: Motion | None = None if motion is None else smooth_motion(name, motion, of="tie")
    if law is None and shape is not None:
        law = lambda t: (1.0, 0.0, 0.0)
    return SurfaceTie(name, a, b, space, sliding, law, shape)


def finer_first(a: Surface, b: Surface) -> tuple[Surface, Surface]:
    """Two elastic surfaces, the one with the smaller facets first: ``tie_surface("glue", *finer_first(a, b))``; collective.

    The finer side should carry the multipliers. Facets of one size stay in the order given, on any number of ranks. Sides are
    never exchanged unasked: the multiplier is the force on the first.
    """
    h = []
    for s in (a, b):
        require(
            isinstance(s, Surface) and isinstance(s.body, AbsoluteBody | FloatingBody),
            f"finer_first takes two surfaces of elastic bodies on meshes; found {shown(s)}.",
        )
        h.append(surface_trace(s.body.mesh, s.name).h)
    return (a, b) if h[0] <= h[1] * (1 + 1e-9) else (b, a)
