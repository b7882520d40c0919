"""Tangents with the stress that the last increment foretold, in place of that where it led.

Newton's increment d of a thin body turns its parts along straight lines, which stretches them by grad(d)^T grad(d) / 2: a strain
of the second order that the linear solution does not know of, and that the next increment takes back. Its stress, times the
large stiffness along the body, is of no use in a tangent: where it presses, the tangent is indefinite, and the iteration is lost.
With the stress of the linear solution in the geometric part,

    K = int dE : W'' : DE + S(C - grad(d)^T grad(d)) : grad(du)^T grad(dv),    S = 2 dW/dC,    C = F^T F,             (1)

the iteration converges in about as many increments as one with stresses as unknowns of their own. The forces stay those of the
configuration.

An increment changes volumes by the second order too, which a large bulk modulus turns into a pressure. Where the pressure is
eliminated, C p = b(u), the tangent has that of the linear solution,

    C p = b(u - d) + B d,        B of the tangent that d was found with,                                               (2)

and the increments are those of an iteration for u and p: its rate does not depend on the bulk modulus.

Source: Magisano, Leonetti and Garcea, doi:10.1016/j.cma.2016.10.023 (mixed integration points).
"""

from __future__ import annotations

from typing import Any

from .. import dolfinx_compat as compat


def geometric_change(field: Any, increment: Any) -> Any:
    """Compiled form of what (1) adds to the tangent of a field with a stored energy W(C), for the ``increment`` d, a function."""
    import ufl

    dx, w = field.elastic_measure, field.argument
    density = field.strain_energy
    F = ufl.Identity(field.dim) + ufl.grad(w)
    D = ufl.grad(increment)

    def stress(C: Any) -> Any:
        C = ufl.variable(C)
        return 2.0 * ufl.diff(density(C), C)

    du = ufl.TrialFunction(field.space)
    dv = ufl.TestFunction(field.space)
    change = stress(F.T * F - D.T * D) - stress(F.T * F)
    return compat.form(ufl.inner(change, ufl.sym(ufl.grad(du).T * ufl.grad(dv))) * dx)
