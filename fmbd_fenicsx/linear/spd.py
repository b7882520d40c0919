"""Factorised symmetric positive definite blocks of elastic fields: E = cm M + ck K.

CHOLMOD on one rank, MUMPS Cholesky on several, both through PETSc. The factor is kept, the matrix is freed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import LinearSolveError
from ..fields import Field
from ..rotations import Array
from .residual import Judge


class CholeskyFactor:
    """E = cm M + ck K of a field, factored; collective to build, to solve and to destroy."""

    def __init__(self, field: Field, cm: float, ck: float) -> None:
        from petsc4py import PETSc

        self.field, self.cm, self.ck = field, cm, ck
        self.judge = Judge(f'the elastic block of body "{field.name}"')
        E = field.combination(cm, ck)
        E.setOption(PETSc.Mat.Option.SPD, True)
        ksp = PETSc.KSP().create(field.comm)
        ksp.setOperators(E)
        ksp.setType("preonly")
        pc = ksp.getPC()
        pc.setType("cholesky")
        pc.setFactorSolverType("cholmod" if field.comm.size == 1 else "mumps")
        try:
            ksp.setUp()
        except PETSc.Error as error:
            raise LinearSolveError(
                f'Body "{field.name}": the elastic block cm M + ck K (cm = {cm:.3g}, ck = {ck:.3g}) could not be factored '
                f"(PETSc error {error.ierr}). Check density and moduli for their signs and units."
            ) from error
        self.factor = pc.getFactorMatrix()
        self.factor.incRef()
        self._x, self._b = E.createVecs()
        ksp.destroy()
        E.destroy()

    def solve(self, b: Array) -> Array:
        """E^-1 b on owned entries, judged by its true residual."""
        self._b.array[:] = b
        self.factor.solve(self._b, self._x)
        x = self._x.array.copy()
        self._judge(x, b)
        return x

    def solve_columns(self, B: Array) -> Array:
        """E^-1 B for dense columns (n, k), all at once; every column is judged."""
        from petsc4py import PETSc

        k = B.shape[1]
        if k == 0:
            return B.copy()
        n = self.field.n * self.field.dim
        total = self.field.n_global
        rhs = PETSc.Mat().createDense(((n, total), (None, k)), comm=self.field.comm)
        rhs.setUp()
        out = PETSc.Mat().createDense(((n, total), (None, k)), comm=self.field.comm)
        out.setUp()
        rhs.getDenseArray()[:] = B
        rhs.assemble()
        out.assemble()
        self.factor.matSolve(rhs, out)
        X = np.array(out.getDenseArray())
        rhs.destroy()
        out.destroy()
        for j in range(k):
            self._judge(X[:, j], B[:, j])
        return X

    def _judge(self, x: Array, b: Array) -> None:
        f = self.field
        r = self.cm * f.mass(x.reshape(-1, f.dim)).ravel() + self.ck * f.tangent(x) - b
        rr, bb = f.total(np.array([r @ r, b @ b]))
        self.judge.check(float(np.sqrt(rr)), float(np.sqrt(bb)))

    def destroy(self) -> None:
        """Free the factor; collective."""
        for obj in (self.factor, self._x, self._b):
            obj.destroy()


def back_solves(factors: list[Any]) -> int:
    """Total number of right-hand sides solved."""
    return sum(f.judge.solves for f in factors)


class MassInverse:
    """M^-1 of a field by conjugate gradients with diagonal scaling; same interface as :class:`CholeskyFactor`.

    The Galerkin mass matrix has a condition number that does not depend on the mesh, so about 30 iterations reach 1e-13
    (Wathen, doi:10.1093/imanum/7.4.449) and the consistent start needs no second factorisation.
    """

    def __init__(self, field: Field, cm: float) -> None:
        from petsc4py import PETSc

        self.field, self.cm = field, cm
        self.judge = Judge(f'the mass matrix of body "{field.name}"')
        self.ksp = PETSc.KSP().create(field.comm)
        self.ksp.setOperators(field.M)
        self.ksp.setType("cg")
        self.ksp.getPC().setType("jacobi")
        self.ksp.setTolerances(rtol=1e-13, atol=1e-300, max_it=2000)
        self.x, self.b = field.M.createVecs()

    def solve(self, b: Array) -> Array:
        """(cm M)^-1 b on owned entries, judged by its true residual."""
        f = self.field
        B = b.reshape(-1, f.dim)
        X = np.empty_like(B)
        for k in range(f.dim):
            self.b.array[:] = B[:, k]
            self.ksp.solve(self.b, self.x)
            X[:, k] = self.x.array
        r = f.mass(X) - B
        rr, bb = f.total(np.array([(r * r).sum(), (B * B).sum()]))
        self.judge.check(float(np.sqrt(rr)), float(np.sqrt(bb)))
        return X.ravel() / self.cm

    def solve_columns(self, B: Array) -> Array:
        """The same for columns (n, k)."""
        return np.stack([self.solve(B[:, j]) for j in range(B.shape[1])], axis=1) if B.shape[1] else B.copy()

    def destroy(self) -> None:
        """Free the solver; collective."""
        for obj in (self.ksp, self.x, self.b):
            obj.destroy()
