"""Ways to solve the linear systems of a scene's steps, as small frozen objects that a user chooses from.

* :class:`Direct`: Cholesky factors of elastic bodies, the exact Schur complement of all else (:mod:`.condensation`).
* :class:`Schur`: the same; large bodies by conjugate gradients, many multipliers of ties by GMRES (:mod:`.iterated_multipliers`).
* :class:`FieldSplit`: MINRES or FGMRES on the whole matrix with one split for each block (:mod:`.fieldsplit.solver`).

GMRES on the Schur complement needs about half the iterations of MINRES on the whole with the same preconditioner of the
multipliers: the spectrum lies on one side of zero. One iteration is one solve with each elastic block either way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..checks import check_fields, instance
from ..errors import near, require
from ..fem.fields import Field
from ..system.system import System
from .blocks.elastic_blocks import Bddc, Cholesky, Elastic, Multigrid, block_solver
from .core import TIE_LIMIT
from .fieldsplit.preconditioner import SplitBlock, split_prefix
from .fieldsplit.solver import SplitSolver
from .tie_preconditioner import Fractional, MultiplierPreconditioner

METHODS = ("minres", "fgmres", "gmres")  # PETSc's names


class Preset:
    """A way to solve the linear systems of a scene's steps.

    ``limit``: multipliers of surface ties in a scene that its dense core takes. ``multiplier``: the preconditioner with which
    more of them are iterated on to the relative residual ``rtol``; None refuses them.
    """

    limit: int = TIE_LIMIT
    multiplier: Any = None
    rtol: float = 0.0

    def block(self, field: Field, weights: tuple[float, float, float], prefix: str) -> Any:
        """The solver of cm M + cd D + ck K, weights (cm, cd, ck), of one body in a scene; collective."""
        raise NotImplementedError

    def split(self, system: System, prefix: str) -> Any:
        """The solver of the whole matrix of a scene's step; None where fields are eliminated one by one. Collective."""
        return None


@dataclass(frozen=True)
class Direct(Preset):
    """A Cholesky factor for each elastic body and the exact Schur complement of all else."""

    def block(self, field: Field, weights: tuple[float, float, float], prefix: str) -> Any:
        """A Cholesky factor; collective."""
        return block_solver(Cholesky(), field, weights, 1.0, prefix)


@dataclass(frozen=True)
class Schur(Preset):
    """The exact Schur complement of all but the elastic bodies: up to ``limit`` multipliers of ties dense, above by GMRES to the
    relative residual ``rtol``.

    ``elastic``: :class:`Cholesky`, or :class:`Multigrid` or :class:`Bddc` as preconditioner of conjugate gradients to the same
    ``rtol``. ``multiplier``: the preconditioner S~ for many multipliers, see :mod:`.tie_preconditioner`.
    """

    elastic: Cholesky | Multigrid | Bddc = Cholesky()
    rtol: float = 1e-11
    limit: int = TIE_LIMIT
    multiplier: MultiplierPreconditioner = Fractional()

    def __post_init__(self) -> None:
        check_fields(self)
        instance("Schur: multiplier", self.multiplier, MultiplierPreconditioner)
        _check_krylov("Schur", self.rtol, max(self.limit, 1))

    def block(self, field: Field, weights: tuple[float, float, float], prefix: str) -> Any:
        """A Cholesky factor, or conjugate gradients; collective."""
        return block_solver(self.elastic, field, weights, self.rtol, prefix)


@dataclass(frozen=True)
class FieldSplit(Preset):
    """MINRES (or FGMRES, GMRES) on the whole matrix of a step with a block-diagonal preconditioner.

    ``rtol``: of the preconditioned residual; ``elastic``: how the split of each body is solved; ``multiplier``: how S~ of ties is
    made, see :mod:`.tie_preconditioner`.
    """

    elastic: Cholesky | Multigrid | Bddc = Cholesky()
    multiplier: MultiplierPreconditioner = Fractional()
    method: str = "minres"
    rtol: float = 1e-8
    max_iterations: int = 400

    def __post_init__(self) -> None:
        check_fields(self)
        instance("FieldSplit: multiplier", self.multiplier, MultiplierPreconditioner)
        _check_krylov("FieldSplit", self.rtol, self.max_iterations)
        require(
            self.method in METHODS,
            f'FieldSplit: method "{self.method}" is none of {", ".join(METHODS)}. {near(self.method, METHODS)}',
        )

    def split(self, system: System, prefix: str) -> SplitSolver:
        """The solver of a scene's steps; collective."""
        return SplitSolver(system, self, prefix)

    def block(self, field: Field, weights: tuple[float, float, float], prefix: str) -> SplitBlock:
        """The split of one body, its options under ``<scene>_fieldsplit_<body>.u_``; collective."""
        cm, cd, ck = weights
        return SplitBlock(Elastic(field, cm, ck), self.elastic, split_prefix(prefix, field.name), cd)


def _check_krylov(what: str, rtol: float, most: int) -> None:
    """Refuse tolerances of an iteration that are none, and limits below one."""
    require(0 < rtol < 1, f"{what}: rtol = {rtol} must lie between 0 and 1.")
    require(most >= 1, f"{what}: max_iterations = {most} must be 1 at least.")
