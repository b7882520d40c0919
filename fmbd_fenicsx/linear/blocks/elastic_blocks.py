"""How the elastic block of one body is solved: small frozen objects that set up a KSP, and conjugate gradients by them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...checks import check_fields, number, whole
from ...errors import InputError
from ...fem.factors.factor import by_mumps
from ...fem.fields import Field
from ...rotations import Array
from ..options import check_options
from ..residual import Judge
from ..rigid_modes import elastic_matrix
from .spd import CholeskyFactor, FieldFactor


@dataclass(frozen=True, eq=False)
class Elastic:
    """The block cm M + ck K of one body, with the sizes of it that preconditioners are scaled by."""

    body: Field
    cm: float
    ck: float = 1.0

    @property
    def rows(self) -> int:
        """Rows on this rank."""
        return self.body.n * self.body.dim

    @property
    def size(self) -> float:
        """Diameter of the body, m."""
        return self.body.size

    @cached_property
    def moduli(self) -> tuple[float, float]:
        """Mean moduli of shear and of uniaxial strain, Pa: the elastic energies of such deformations over
        the volume.
        """
        b, d = self.body, self.body.dim
        shear: list[float] = []
        axial: list[float] = []
        for i in range(d):
            for j in range(d):
                # unit strains e_i x_j; two stretches against each other are a shear, too
                u = np.zeros((b.n, d))
                u[:, i] = b.X[:, j]
                (axial if i == j else shear).append(float(u.ravel() @ b.stiffness(u.ravel())))
                if i == j:
                    k = (i + 1) % d
                    u[:, k] = -b.X[:, k]
                    shear.append(float(u.ravel() @ b.stiffness(u.ravel())) / 4.0)

        volume = b.mass_total / b.mean_density
        return tuple(float(x) for x in b.total(np.array([np.mean(shear), np.mean(axial)])) / volume)  # type: ignore[return-value]

    @property
    def depth(self) -> float:
        """Length sqrt(ck G / (cm rho)) over which a surface force reaches into the body within a step, m."""
        return float(np.sqrt(self.ck * self.moduli[0] / (self.cm * self.body.mean_density)))


class ConjugateGradients(FieldFactor):
    """(cm M + cd D + ck K)^-1 of a field to the relative residual ``rtol``, in place of a factor: large bodies, little memory.

    ``elastic`` is one of the small objects that set up a block's KSP.
    Options under ``prefix`` override it.
    Collective to build, to solve and to destroy; every solve is judged by its own true residual.
    """

    def __init__(self, block: Elastic, elastic: Any, *, rtol: float, prefix: str, cd: float = 0.0) -> None:
        from petsc4py import PETSc

        field: Field = block.body
        if field.mixed:
            raise InputError(
                f'Body "{field.name}": multigrid is for displacement forms; a body with pressure needs linear=Direct().'
            )

        self.field, self.cm, self.ck = field, block.cm, block.ck
        self.judge = Judge(f'the elastic block of body "{field.name}" by conjugate gradients', 10 * rtol)
        self.iterations = 0
        E = elastic_matrix(field, block.cm, block.ck, cd)
        self.ksp = ksp = PETSc.KSP().create(field.comm)
        ksp.setOptionsPrefix(prefix)
        ksp.setOperators(E)
        elastic.set_up(ksp, block)
        ksp.setType("cg")
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        ksp.setTolerances(rtol=rtol, atol=1e-300, max_it=500)
        ksp.setFromOptions()
        if ksp.getPC().getType() == "mg":
            E.convert("baij")  # products with blocks are twice as fast; the coarse level is made already

        ksp.setUp()
        self.how = f"conjugate gradients with {ksp.getPC().getType()}"
        check_options(prefix, field.comm)
        self.E = E
        self.x, self.b = E.createVecs()

    def solve(self, b: Array) -> Array:
        """E^-1 b on owned entries."""
        self.b.array[:] = b
        self.ksp.solve(self.b, self.x)
        self.iterations += self.ksp.getIterationNumber()
        x = self.x.array.copy()
        self.E.mult(self.x, self.b)
        r = self.b.array - b
        rr, bb = np.sqrt(self.field.total(np.array([r @ r, b @ b])))
        self.judge.check(float(rr), float(bb), self._advice())
        return x

    def _advice(self) -> str:
        return (
            f"Conjugate gradients stopped after {self.ksp.getIterationNumber()} iterations (PETSc reason "
            f"{self.ksp.getConvergedReason()}). Use Cholesky() for this block, or look at its moduli and Poisson's ratio."
        )

    def destroy(self) -> None:
        """Free the solver; collective."""
        for obj in (self.ksp, self.E, self.x, self.b):
            obj.destroy()


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
