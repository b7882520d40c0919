"""Elastic blocks solved by preconditioned conjugate gradients instead of a factor: large bodies, little memory."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import InputError
from ...fem.fields import Field
from ...rotations import Array
from ..options import check_options
from ..residual import Judge
from ..rigid_modes import elastic_matrix
from .elastic import Elastic
from .spd import FieldFactor


class ConjugateGradients(FieldFactor):
    """(cm M + cd D + ck K)^-1 of a field to the relative residual ``rtol``.

    ``elastic`` is one of the small objects of :mod:`.elastic_blocks` that set up a block's KSP.
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
