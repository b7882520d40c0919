"""Factors of the elastic matrices cm M + ck K: Cholesky for displacement forms, LDL^T for displacement and pressure.

CHOLMOD on one rank, MUMPS on several, both through PETSc; symmetric indefinite matrices always by MUMPS. The factor is kept,
the matrix is freed. A mixed field is factored with its pressure, which stays inside: right-hand sides and solutions are
displacements.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import LinearSolveError
from ..rotations import Array


class Factor:
    """cm M + ck K of a field, factored; collective to build, solve and destroy. Unjudged, see :mod:`..linear.blocks.spd`."""

    def __init__(self, field: Any, cm: float, ck: float, cd: float = 0.0) -> None:
        from petsc4py import PETSc

        self.field, self.cm, self.ck, self.cd = field, cm, ck, cd
        E = field.combination(cm, ck, cd)
        definite = not (field.mixed or field.indefinite)
        try:
            ksp = factored(E, definite)
        except PETSc.Error as error:
            if not (definite and field.nonlinear):
                raise LinearSolveError(
                    f'Body "{field.name}": the elastic block cm M + ck K (cm = {cm:.3g}, ck = {ck:.3g}) could not be factored '
                    f"(PETSc error {error.ierr}). Check density and moduli for their signs and units."
                ) from error
            field.indefinite = True  # LDL^T from now on: Cholesky factorisations that fail leave memory behind
            ksp = factored(E, False)
        pc = ksp.getPC()
        self.factor = pc.getFactorMatrix()
        self.factor.incRef()
        self._x, self._b = E.createVecs()
        self._rows = E.getSizes()[0]
        self.norm = float(E.norm(PETSc.NormType.NORM_INFINITY))
        self._n = field.n * field.dim
        ksp.destroy()
        self._E = E if field.mixed else None
        if not field.mixed:
            E.destroy()

    def _solve(self, b: Array) -> Array:
        """Solution with the pressure, where there is one."""
        self._b.array[self._n :] = 0.0
        self._b.array[: self._n] = b
        self.factor.solve(self._b, self._x)
        x = np.array(self._x.array)
        if self._E is not None:  # one refinement: pivots of the pressure are small
            r = self._residual(x, b)
            self._b.array[:] = r
            self.factor.solve(self._b, self._x)
            x -= self._x.array
        return x

    def solve(self, b: Array) -> Array:
        """E^-1 b on owned displacements."""
        return self._solve(b)[: self._n]

    def solve_with_residual(self, b: Array) -> tuple[Array, Array]:
        """E^-1 b and the true residual E x - b, with the rows of the pressure where there are some."""
        x = self._solve(b)
        return x[: self._n], self._residual(x, b)

    def _residual(self, x: Array, b: Array) -> Array:
        f = self.field
        if self._E is None:
            r: Array = f.mass(x.reshape(-1, f.dim)).ravel()
            r *= self.cm
            r += self.ck * f.tangent(x)
            if self.cd:
                r += self.cd * f.damping_in_tangent(x)
            r -= b
            return r
        self._x.array[:] = x
        self._E.mult(self._x, self._b)
        r = np.array(self._b.array)
        r[: self._n] -= b
        return r

    def solve_columns(self, B: Array) -> tuple[Array, list[Array]]:
        """E^-1 B for dense columns (n d, k), all at once, and the residual of each column."""
        from petsc4py import PETSc

        k = B.shape[1]
        if k == 0:
            return B.copy(), []
        rhs = PETSc.Mat().createDense((self._rows, (None, k)), comm=self.field.comm)
        rhs.setUp()
        out = PETSc.Mat().createDense((self._rows, (None, k)), comm=self.field.comm)
        out.setUp()
        rhs.getDenseArray()[: self._n] = B
        rhs.getDenseArray()[self._n :] = 0.0
        rhs.assemble()
        out.assemble()
        self.factor.matSolve(rhs, out)
        X = np.array(out.getDenseArray())
        rhs.destroy()
        out.destroy()
        return X[: self._n], [self._residual(X[:, j], B[:, j]) for j in range(k)]

    def destroy(self) -> None:
        """Free the factor; collective."""
        for obj in (self.factor, self._x, self._b, *([] if self._E is None else [self._E])):
            obj.destroy()


def factored(E: Any, definite: bool) -> Any:
    """A PETSc solver with the factor of E: Cholesky where it is definite, LDL^T by MUMPS otherwise."""
    from petsc4py import PETSc

    E.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    E.setOption(PETSc.Mat.Option.SPD, definite)
    ksp = PETSc.KSP().create(E.getComm())
    ksp.setOperators(E)
    ksp.setType("preonly")
    pc = ksp.getPC()
    pc.setType("cholesky")
    cholmod = E.getComm().size == 1 and definite
    pc.setFactorSolverType("cholmod" if cholmod else "mumps")
    options, warnings = PETSc.Options(), "mat_cholmod_print"
    quiet = cholmod and not options.hasName(warnings)  # an indefinite tangent is no news to the user
    if cholmod:
        pc.setFactorOrdering("rcm")  # CHOLMOD takes this order, good for slender bodies, or its own: that of least fill
    if quiet:
        options[warnings] = 0
    try:
        ksp.setUp()
    except PETSc.Error:
        ksp.destroy()
        raise
    finally:
        if quiet:
            options.delValue(warnings)
    return ksp
