"""Newton's increment with the exact tangent: GMRES on its action, preconditioned by the frozen one.

With P the matrix of the :class:`.StepSolver` and J the derivative of the residual, velocity-dependent
inertia, turned reactions and the inertia of the deformed body included, an increment x = (dq, s dlambda) is

    J x = b      or      dq + T dq = dq_0,     x_0 = P^-1 b,     T d = P^-1 (J - P) (d, 0)                        (1)

as G is exact in P: J - P acts on dq alone. J d is a difference quotient of the residual along d, so nothing is assembled and the
elastic factors stay. An iteration of (1) costs one evaluation of the forces and one back-solve for each elastic field.

Sources: Knoll and Keyes, doi:10.1016/j.jcp.2003.08.010; Saad and Schultz, doi:10.1137/0907058.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..rotations import Array
from ..system.system import System
from .newton import ExactTangent

SHIFT = float(np.sqrt(np.finfo(float).eps))  # of a difference quotient, over the model's length

Pair = tuple[Array, Array]


def exact_increment(
    tangent: ExactTangent,
    system: System,
    solve: Callable[[Array, Array], Pair],
    moved: Callable[[Array], Pair],
    b: Pair,
    push: Array | float = 0.0,
) -> tuple[Array, Array, int]:
    """dq, s dlambda and the number of iterations of (1); collective.

    ``solve`` applies P^-1; ``moved(d)`` is the residual (like v, and (n_lam,)) after the increment d of q; ``b``: less that at
    d = 0; ``push``: forces beside b, so large that differences of residuals would lose their digits in them. Iterates to the
    relative residual of ``tangent``, or gives what its iterations reach: Newton's test judges that.
    """
    dq, dlam = solve(b[0] + push, b[1])
    units = system.units
    norm = float(np.sqrt(system.dot(units * dq, units * dq)))
    if not 0.0 < norm < np.inf:
        return dq, dlam, 0

    # GMRES: an orthonormal basis of increments, in lengths; each goes with its change of the multipliers
    basis, reactions = [dq / norm], []
    H = np.zeros((tangent.max_iterations + 1, tangent.max_iterations))
    y: Array = np.zeros(0)
    for j in range(tangent.max_iterations):
        # P^-1 J of the newest one by a difference of residuals
        eps = SHIFT * system.length / system.max_abs(basis[j])
        r, g = moved(eps * basis[j])
        w, reaction = solve((r + b[0]) / eps, (g + b[1]) / eps)
        reactions.append(reaction)

        for i, e in enumerate(basis):
            H[i, j] = system.dot(units * w, units * e)
            w = w - H[i, j] * e
        H[j + 1, j] = np.sqrt(system.dot(units * w, units * w))

        # the combination with the smallest residual (least squares)
        goal = np.zeros(j + 2)
        goal[0] = norm
        y = np.linalg.lstsq(H[: j + 2, : j + 1], goal, rcond=None)[0]
        if np.linalg.norm(goal - H[: j + 2, : j + 1] @ y) <= tangent.rtol * norm or H[j + 1, j] == 0.0:
            break
        basis.append(w / H[j + 1, j])

    dq = np.sum([c * e for c, e in zip(y, basis, strict=False)], axis=0)
    return dq, dlam - np.sum([c * x for c, x in zip(y, reactions, strict=True)], axis=0), len(y)
