"""How the elastic block of one body is solved: small frozen objects that set up a KSP."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...checks import check_fields, number, whole
from ...fem.factors.factor import by_mumps
from ...fem.fields import Field
from .elastic import Elastic
from .iterative import ConjugateGradients
from .spd import CholeskyFactor


@dataclass(frozen=True)
class Cholesky:
    """Elastic blocks by a Cholesky factor (MUMPS)."""

    def set_up(self, ksp: Any, block: Elastic | None = None) -> None:
        """Options of one block's KSP."""
        by_mumps(ksp)


@dataclass(frozen=True)
class Multigrid:
    """Elastic blocks by multigrid, see :mod:`.multigrid`; ``cycles`` > 1 uses that many Richardson steps.

    ``smoothing``: Chebyshev steps before and after each coarse correction. For displacement forms that lock (Poisson's ratio
    near 1/2) no cycle of this kind converges well: use :class:`Cholesky`, or a mixed body.
    """

    cycles: int = 1
    smoothing: int = 3

    def __post_init__(self) -> None:
        whole("Multigrid: cycles", self.cycles, least=1)
        whole("Multigrid: smoothing", self.smoothing, least=1)

    def set_up(self, ksp: Any, block: Elastic | None = None) -> None:
        """Options of one block's KSP; collective."""
        from petsc4py import PETSc

        from .multigrid import set_multigrid

        assert block is not None
        ksp.setType("preonly" if self.cycles == 1 else "richardson")
        if self.cycles > 1:
            ksp.setTolerances(rtol=0.0, atol=0.0, max_it=self.cycles)
            ksp.setNormType(PETSc.KSP.NormType.NONE)
        set_multigrid(ksp.getPC(), block.body, self.smoothing)


@dataclass(frozen=True)
class Bddc:
    """Elastic blocks by balancing domain decomposition (PETSc's BDDC), one subdomain per rank; see
    :mod:`.domain_decomposition`.

    ``adaptive``: eigenvalues of interface pencils beyond this enter the coarse space (0: corners and averages only,
    whose counts grow towards statics).
    """

    adaptive: float = 2.0

    def __post_init__(self) -> None:
        check_fields(self)
        number("Bddc: adaptive", self.adaptive, least=0)

    def set_up(self, ksp: Any, block: Elastic | None = None) -> None:
        """Operators and options of one block's KSP."""
        from .domain_decomposition import unassembled

        assert block is not None
        A = unassembled(block.body, block.cm, block.ck)
        ksp.setType("preonly")
        ksp.setOperators(A)
        A.destroy()  # the KSP keeps it
        set_bddc(ksp, self.adaptive)


def set_bddc(ksp: Any, adaptive: float = 2.0) -> None:
    """BDDC with deluxe scaling (stiffness-weighted averages) and an adaptive coarse space; options override
    both.
    """
    from petsc4py import PETSc

    ksp.getPC().setType("bddc")
    options = PETSc.Options()
    prefix = ksp.getOptionsPrefix() or ""
    for name, value in (("use_deluxe_scaling", True), ("adaptive_threshold", adaptive)):
        if value and not options.hasName(f"{prefix}pc_bddc_{name}"):
            options[f"{prefix}pc_bddc_{name}"] = value


def block_solver(elastic: Any, field: Field, weights: tuple[float, float, float], rtol: float, prefix: str) -> Any:
    """cm M + cd D + ck K of a field, by a factor or by conjugate gradients; collective."""
    cm, cd, ck = weights
    if isinstance(elastic, Cholesky):
        return CholeskyFactor(field, cm, ck, cd)
    return ConjugateGradients(Elastic(field, cm, ck), elastic, rtol=rtol, prefix=prefix, cd=cd)
