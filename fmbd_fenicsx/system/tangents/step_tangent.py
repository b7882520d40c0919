"""The tangent of the equations of an implicit step: as dense or sparse matrices, or as data of sparse patterns."""

from __future__ import annotations

from dataclasses import dataclass

from ...rotations import Array


@dataclass(frozen=True)
class StepTangent:
    """Coefficients of (1) in :mod:`~fmbd_fenicsx.linear.implicit.pencil`, with m rows of joints, k levels, p ties: J, M (n, n);
    G (m, n); U (n, m); derivatives of the lower rows by xi, v, a, (n + k m + p, n) each; R (p, n). Of laws that compiled
    code has formulas of, dN/ds and dN/ds' where it was taken, (laws, 2). Or sparse ones, or data of patterns.
    """

    J: Array
    M: Array
    G: Array
    U: Array
    by_q: Array
    by_v: Array
    by_a: Array
    R: Array
    slopes: Array
