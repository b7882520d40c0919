"""The quadrature of elastic energies: one rule for an energy, its forces and its tangent, of no higher degree than serves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def integrated(energy: Callable[[Any], Any], dx: Any, *, degree: int, chosen: bool) -> tuple[Any, Any]:
    """The form of an energy, and the measure by which its derivatives are integrated as well.

    UFL sums up degrees with every derivative: of ln J in space it asks for degree 16, of its tangent for 44, which takes a minute
    a thousand cells and gives no digit more. What is not polynomial gets two degrees more than Saint Venant and Kirchhoff's
    energy has, 4 (p - 1) + 2 for displacements of ``degree`` p. Where the user has ``chosen`` one, it is in ``dx``.

    Raises:
        TypeError: it is no form of rank 0.
    """
    import ufl
    from ufl.algorithms import estimate_total_polynomial_degree
    from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
    from ufl.algorithms.apply_derivatives import apply_derivatives

    form = energy(dx)
    if not isinstance(form, ufl.Form) or len(form.arguments()) != 0:
        raise TypeError(f"found {form!r:.80}; integrate an energy density over dx")
    if chosen:
        return form, dx

    enough = 4 * (degree - 1) + 2
    if estimate_total_polynomial_degree(apply_derivatives(apply_algebra_lowering(form))) <= enough:
        return form, dx
    measure = dx(metadata={"quadrature_degree": enough})
    return energy(measure), measure
