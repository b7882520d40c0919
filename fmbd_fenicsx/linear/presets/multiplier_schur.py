"""The exact Schur complement of the multipliers: dense where there are few, conjugate gradients where there are many.

    S lam = sum_k B_k E_k^-1 f_k - g,    S = sum_k B_k E_k^-1 B_k^T,    u_k = E_k^-1 (f_k - B_k^T lam)                  (1)

Conjugate gradients on S need about half the iterations of MINRES on the whole with the same S~ (:mod:`..saddle.precondition`):
the spectrum lies on one side of zero. One iteration is one solve with each E_k either way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from ...checks import check_fields, instance
from ...errors import ConvergenceError, InputError, LinearSolveError, require
from ...fem.fields import Field
from ...rotations import Array
from ..blocks.elastic_blocks import Bddc, Cholesky, Multigrid, block_solver
from ..options import check_options
from ..residual import Judge
from ..saddle.diagnosis import diagnose
from ..saddle.precondition import Fractional, MultiplierPreconditioner, inverse_of
from ..saddle.saddle import SaddlePoint, Solution
from .preset import Preset

MOST = 500  # iterations on the multipliers


def check_krylov(what: str, rtol: float, most: int) -> None:
    """Refuse tolerances of an iteration that are none, and limits below one."""
    require(0 < rtol < 1, f"{what}: rtol = {rtol} must lie between 0 and 1.")
    require(most >= 1, f"{what}: max_iterations = {most} must be 1 at least.")


@dataclass(frozen=True)
class Schur(Preset):
    """Equation (1), for systems with inertia: S dense up to ``limit`` multipliers, conjugate gradients above.

    ``elastic``: :class:`Cholesky`, or :class:`Multigrid` as preconditioner of conjugate gradients to the relative residual
    ``rtol``. ``multiplier``: the preconditioner S~ for many multipliers.
    """

    elastic: Cholesky | Multigrid | Bddc = Cholesky()
    rtol: float = 1e-11
    limit: int = 1500
    multiplier: MultiplierPreconditioner = Fractional()

    def __post_init__(self) -> None:
        check_fields(self)
        instance("Schur: multiplier", self.multiplier, MultiplierPreconditioner)
        check_krylov("Schur", self.rtol, max(self.limit, 1))

    def block(self, field: Field, weights: tuple[float, float, float], prefix: str) -> Any:
        """A Cholesky factor, or conjugate gradients; collective."""
        return block_solver(self.elastic, field, weights, self.rtol, prefix)

    def solver(self, saddle: SaddlePoint, prefix: str = "fmbd_") -> SchurSolver:
        """Factor the elastic blocks, and S or S~; collective."""
        static = [e.body.name for e in saddle.elastic if e.cm == 0]
        if static:
            raise InputError(
                f"Schur() needs inertia: the elastic block of {static} is singular in statics. Use Direct() or FieldSplit()."
            )
        return SchurSolver(saddle, self, prefix)


class SchurSolver:
    """Solves (1); ``iterations`` of the last solve are those on S, or inside the elastic blocks where S is dense."""

    def __init__(self, saddle: SaddlePoint, preset: Schur, prefix: str) -> None:
        self.saddle, self.rtol = saddle, preset.rtol
        self.judge = Judge("the saddle point by its Schur complement", max(1e-9, 1000 * preset.rtol))
        self.blocks = [
            block_solver(preset.elastic, e.body, (e.cm, 0.0, e.ck), preset.rtol, f"{prefix}{e.name}_")
            for e in saddle.elastic
        ]

        self._B = self._columns()
        self.complement: Array | None = None
        self._inverse: Callable[[Array], Array] | None = None
        # few multipliers: S itself; many: its preconditioner
        if saddle.n_multipliers <= preset.limit:
            self._factor_complement()
        else:
            self._inverse = factored(preset.multiplier.groups(saddle), saddle)
        check_options(prefix, saddle.comm)

    def _factor_complement(self) -> None:
        """S itself, and its Cholesky factor; collective."""
        n = self.saddle.n_multipliers
        S: Array = np.zeros((n, n))
        for block, B in zip(self.blocks, self._B, strict=True):
            S += block.field.total(B @ block.solve_columns(B.T.toarray()))
        # symmetric but for roundoff; rows of one size, so that ties of soft and stiff bodies do not hide each other
        self.complement = S = 0.5 * (S + S.T)
        self._scale = 1.0 / np.sqrt(np.maximum(np.diag(S), 1e-300))

        try:
            self._factor = sl.cho_factor(self._scale[:, None] * S * self._scale)
        except sl.LinAlgError as error:
            raise LinearSolveError(
                f"The Schur complement of the multipliers is singular. {diagnose(self.saddle)}"
            ) from error

    def _columns(self) -> list[Any]:
        """B_k of each body with the rows of all ties."""
        s = self.saddle
        stacks: list[list[Any]] = [[] for _ in s.elastic]
        for t in s.ties:
            # a body that a tie does not touch has zeros there
            found = dict(t.columns)
            for k, e in enumerate(s.elastic):
                stacks[k].append(found.get(k, sp.csr_matrix((t.rows, e.rows))))
        return [sp.vstack(x, format="csr") for x in stacks]

    def _total(self, x: Any) -> Array:
        return self.saddle.elastic[0].body.total(np.asarray(x))

    def _apply(self, lam: Array) -> Array:
        """S lam; collective."""
        return self._total(sum(B @ block.solve(B.T @ lam) for B, block in zip(self._B, self.blocks, strict=True)))

    def solve(self, f: Sequence[Array], g: Sequence[Array]) -> Solution:
        """Displacements and multipliers; collective."""
        s = self.saddle
        before = sum(block.iterations for block in self.blocks)

        # (1): right-hand side, multipliers, displacements
        z = [block.solve(fk) for block, fk in zip(self.blocks, f, strict=True)]
        r = self._total(sum(B @ zk for B, zk in zip(self._B, z, strict=True))) - np.concatenate([*g, np.zeros(0)])

        if self._inverse is None:
            lam = self._scale * sl.cho_solve(self._factor, self._scale * r)
            count = 0
        else:
            lam, count = conjugate_gradients(self._apply, self._inverse, r, rtol=self.rtol)

        u: list[Array] = [zk - block.solve(B.T @ lam) for block, B, zk in zip(self.blocks, self._B, z, strict=True)]
        parts: list[Array] = np.split(lam, np.cumsum([t.rows for t in s.ties])[:-1])

        # judged by the whole system, not by its Schur complement
        x, b = s.vector(u, parts), s.vector(f, g)
        residual = s.relative_residual(x, b)
        x.destroy(), b.destroy()
        self.judge.check(residual, 1.0, diagnose(s) if not residual <= self.judge.tolerance else "")

        inner = sum(block.iterations for block in self.blocks) - before
        return Solution(u, parts, count or inner, residual)

    def destroy(self) -> None:
        """Free the elastic blocks; collective."""
        for block in self.blocks:
            block.destroy()


def factored(groups: Sequence[tuple[str, list[int], sp.csr_matrix]], saddle: SaddlePoint) -> Callable[[Array], Array]:
    """r -> S~^-1 r on replicated multipliers, S~ given by groups of ties."""
    first = np.cumsum([0, *(t.rows for t in saddle.ties)])
    parts = [(np.concatenate([np.arange(first[i], first[i + 1]) for i in t]), inverse_of(S)) for _, t, S in groups]

    def inverse(r: Array) -> Array:
        out = np.empty_like(r)
        for rows, solve in parts:
            out[rows] = solve(r[rows])
        return out

    return inverse


def conjugate_gradients(
    operator: Callable[[Array], Array],
    precondition: Callable[[Array], Array],
    d: Array,
    *,
    rtol: float,
) -> tuple[Array, int]:
    """Preconditioned conjugate gradients on replicated vectors: the same numbers on all ranks; solution and iterations."""
    lam = np.zeros_like(d)
    r = d.copy()
    y = precondition(r)
    p = y.copy()
    size = float(r @ y)
    start = size

    for k in range(MOST):
        if size <= rtol**2 * start or start == 0:
            return lam, k

        q = operator(p)
        alpha = size / float(p @ q)
        lam = lam + alpha * p
        r = r - alpha * q
        y = precondition(r)

        size, old = float(r @ y), size
        p = y + (size / old) * p

    raise ConvergenceError(
        f"Conjugate gradients on the multipliers did not converge in {MOST} iterations (rtol {rtol:g}). "
        "Try a better preconditioner."
    )
