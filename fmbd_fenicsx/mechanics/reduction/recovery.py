"""Displacements and stresses of elastic bodies after a run, through the user's own form."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ... import dolfinx_compat as compat
from ...checks import instance, shown, typed
from ...errors import InputError
from ..placements import is_distributed
from .craig_bampton import ReducedBody


@typed
def displacement_field(run: Any, body: Any, state: Any = None) -> Any:
    """Displacements u of an elastic body as a dolfinx Function on its mesh, in its frame's axes; collective.

    Works for floating, reduced and absolute bodies. ``state``: an entry of ``run.snapshots``; the last state by default.
    """
    from dolfinx import fem

    try:
        system = run.system
        state = run.state if state is None else state
        name = body.name
    except AttributeError as error:
        raise InputError(
            f"displacement_field takes a run and an elastic body of it; found {shown(run)} and {shown(body)}."
        ) from error

    numbers = {part.name: k for k, part in enumerate(system.parts)}
    if name not in numbers:
        raise InputError(f'Body "{name}" is no elastic body of the run.')
    part, local = system.parts[numbers[name]], system.local_q(state.q, numbers[name])
    if isinstance(body, ReducedBody):
        space = body.reduction.space
        values = body.reduction.phi @ local
    elif is_distributed(part):
        space, values = part.field.space, local
    else:
        raise InputError(f'Body "{body.name}" has no displacement field on a mesh.')

    u = fem.Function(space, name="displacement")
    u.x.array[: len(values)] = values
    u.x.scatter_forward()
    return u


@typed
def stress(u: Any, sigma: Callable[[Any], Any], *, degree: int = 1) -> Any:
    """sigma(u), the user's UFL stress (or any tensor), as a Function, discontinuous between cells; collective.

    ``u`` from :func:`displacement_field`. The degree of the result is that of sigma(u): one less than u has where linear.
    """
    out, expression = within_cells(u, sigma, degree=degree, name="stress")
    out.interpolate(expression)
    return out


def within_cells(u: Any, quantity: Callable[[Any], Any], *, degree: int, name: str) -> tuple[Any, Any]:
    """A Function, discontinuous between cells, and the fem.Expression of quantity(u), in UFL, that it is to interpolate."""
    from dolfinx import fem

    instance(f"{name}: u", u, fem.Function)
    expression = quantity(u)
    shape = expression.ufl_shape
    space = fem.functionspace(u.function_space.mesh, ("DG", degree, shape) if shape else ("DG", degree))
    return fem.Function(space, name=name), fem.Expression(expression, compat.interpolation_points(space))
