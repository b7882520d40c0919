"""The quadrature of elastic forms: of no higher degree than serves, and one rule for an energy, its forces and its tangent."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..dolfinx_compat import of_simplices


def elastic_measure(dx: Any, degree: int, chosen: int | None) -> Any:
    """The measure of elasticity: of the degree that the user has ``chosen``; on quadrilaterals and hexahedra with p + 1 points in
    each direction for displacements of ``degree`` p; else as UFL estimates.

    p + 1 points are exact for linear forms on parallelepipeds, and keep the order on all cells (Ciarlet and Raviart,
    doi:10.1016/B978-0-12-068650-6.50020-4). UFL's estimate has the map of cells beside, which has one point more.
    """
    if chosen is None and of_simplices(dx.ufl_domain()):
        return dx
    return dx(metadata={"quadrature_degree": 2 * degree + 1 if chosen is None else chosen})


def integrated(energy: Callable[[Any], Any], dx: Any, *, degree: int) -> tuple[Any, Any]:
    """The form of an energy, and the measure by which its derivatives are integrated as well.

    UFL sums up degrees with every derivative: of ln J in space it asks for degree 16, of its tangent for 44, which takes a minute
    a thousand cells and gives no digit more. What is not polynomial gets the degree of Saint Venant and Kirchhoff's energy,
    4 (p - 1) for displacements of ``degree`` p, at least 2: what that leaves of a neo-Hookean beam bent by a right angle is a
    thousandth of what its mesh leaves. Where ``dx`` has a degree, it is that.

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
    if "quadrature_degree" in dx.metadata():
        return form, dx

    enough = max(4 * (degree - 1), 2)
    if estimate_total_polynomial_degree(apply_derivatives(apply_algebra_lowering(form))) <= enough:
        return form, dx
    measure = dx(metadata={"quadrature_degree": enough})
    return energy(measure), measure
