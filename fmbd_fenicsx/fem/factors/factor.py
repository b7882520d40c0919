"""Factors of the elastic matrices cm M + ck K: Cholesky for displacement forms, LDL^T for displacement and pressure.

CHOLMOD on one rank, through PETSc; on several ranks each factors its own substructure by it (:mod:`.substructures`), or MUMPS
factors all, where the interface is too large for that. Symmetric indefinite matrices always by MUMPS. The factor is kept, the
matrix is freed. A mixed field is factored with its pressure, which stays inside: right-hand sides and solutions are
displacements.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cache
from math import prod
from typing import Any

import numpy as np

from ...errors import LinearSolveError
from ...rotations import Array
from ..assembly import on_columns, product
from .partial_factor import IndefiniteError
from .substructures import substructured


@dataclass(frozen=True, eq=False)
class InC:
    """How C solves with a factor of ``mass`` M + ``stiffness`` K + ``damping`` C by itself: the address of its ``matrix``, (1,),
    zero once the factor is freed; for PETSc's MatSolve, or of a complex one the structure ``Symmetric`` of driver/tables.h. With
    ``by_component`` it is that of M for one component, which serves all of them.
    """

    matrix: np.ndarray
    mass: complex
    stiffness: complex
    damping: complex = 0.0
    by_component: bool = False


class Factor:
    """cm M + ck K of a field, factored; collective to build, solve and destroy. Unjudged, see :mod:`...linear.blocks.spd`.

    ``how``: by what, in words.
    """

    def __init__(self, field: Any, cm: float, ck: float, cd: float = 0.0) -> None:
        from petsc4py import PETSc

        self.field, self.cm, self.ck, self.cd = field, cm, ck, cd
        E = field.combination(cm, ck, cd)
        definite = not (field.mixed or field.indefinite)
        try:
            self.factor = direct(E, field.dim, definite)
        except IndefiniteError as error:
            if not (definite and field.extended):
                raise LinearSolveError(
                    f'Body "{field.name}": the elastic block cm M + ck K (cm = {cm:.3g}, ck = {ck:.3g}) could not be factored '
                    f"({error}). Check density and moduli for their signs and units."
                ) from error
            field.indefinite = True  # LDL^T from now on: Cholesky factorisations that fail leave memory behind
            self.factor = direct(E, field.dim, False)

        self.how: str = self.factor.how
        self._rows = E.getSizes()[0][0]
        self.norm = float(E.norm(PETSc.NormType.NORM_INFINITY))
        self._n = field.n * field.dim
        self._E: Any = E if field.mixed else None
        if field.mixed:
            self._x, self._b = E.createVecs()
        else:
            E.destroy()

    def _solve(self, b: Array) -> Array:
        """Solution with the pressure, where there is one."""
        x = self.factor.solve(self._with_pressure(b))
        if self._E is not None:  # one refinement: pivots of the pressure are small
            x -= self.factor.solve(self._residual(x, b))
        return x

    def _with_pressure(self, b: Array) -> Array:
        """Loads (n d,) or (n d, k) with zeros for the rows of the pressure."""
        if len(b) == self._rows:
            return b
        return np.concatenate((b, np.zeros((self._rows - len(b), *b.shape[1:]))))

    def solve(self, b: Array) -> Array:
        """E^-1 b on owned displacements."""
        return self._solve(b)[: self._n]

    def solve_all(self, B: Array) -> Array:
        """E^-1 B for columns B (n d, k), all at once."""
        if self._E is None and B.shape[1]:
            return self.factor.solve(B)  # type: ignore[no-any-return]
        return np.stack([self.solve(b) for b in B.T], axis=1) if B.shape[1] else B.copy()

    def solve_with_residual(self, b: Array) -> tuple[Array, Array]:
        """E^-1 b and the true residual E x - b, with the rows of the pressure where there are some."""
        x = self._solve(b)
        return x[: self._n], self._residual(x, b)

    def _residual(self, x: Array, b: Array) -> Array:
        """E x - b, of one solution or of columns."""
        f = self.field
        if self._E is None:
            r: Array = f.mass(x.reshape(-1, f.dim * prod(x.shape[1:]))).reshape(x.shape)
            r *= self.cm
            r += self.ck * f.tangent(x)
            if self.cd:
                r += self.cd * f.damping_in_tangent(x)
            r -= b
            return r

        r = product(self._E, x, (self._x, self._b))
        r[: self._n] -= b
        return r

    def solve_columns(self, B: Array) -> tuple[Array, Array]:
        """E^-1 B for dense columns (n d, k), all at once, and their residuals, with the rows of a pressure."""
        if not B.shape[1]:
            return B.copy(), B.copy()
        X = self.factor.solve(self._with_pressure(B))
        return X[: self._n], self._residual(X, B)

    def in_c(self) -> InC | None:
        """How C solves, on one rank; None where it cannot."""
        f = self.field
        if address_of_solve() is None or not isinstance(self.factor, PetscFactor) or f.comm.size > 1:
            return None
        return InC(self.factor.address, self.cm, self.ck, self.cd)

    def destroy(self) -> None:
        """Free the factor; collective."""
        for obj in (self.factor, *([] if self._E is None else [self._E, self._x, self._b])):
            obj.destroy()


def direct(E: Any, dim: int, definite: bool) -> Any:
    """What solves with E by a factor: by substructures on several ranks where E is definite, else by PETSc; collective.

    Its ``how`` says in words which it is.

    Raises:
        IndefiniteError: there is none.
    """
    if not definite:
        return PetscFactor(E, definite, "MUMPS, LDL^T of an indefinite matrix")
    if E.getComm().size == 1:
        return PetscFactor(E, definite, "CHOLMOD")
    made, why = substructured(E, dim)
    return PetscFactor(E, definite, f"MUMPS, as {why}") if made is None else made


@cache
def address_of_solve() -> int | None:
    """Of PETSc's MatSolve; None where it cannot be had."""
    from petsc4py import PETSc

    try:
        return ctypes.cast(ctypes.CDLL(PETSc.__file__).MatSolve, ctypes.c_void_p).value
    except (OSError, AttributeError):
        return None


class PetscFactor:
    """A factor of E by PETSc; collective to build, to solve and to destroy. ``how``: in words."""

    def __init__(self, E: Any, definite: bool, how: str) -> None:
        from petsc4py import PETSc

        self.how = how
        try:
            ksp = factored(E, definite)
        except PETSc.Error as error:
            raise IndefiniteError(f"PETSc error {error.ierr}") from error
        self.matrix = ksp.getPC().getFactorMatrix()
        self.address = np.array([self.matrix.handle], dtype=np.uint64)
        self._x, self._b = E.createVecs()
        ksp.destroy()

    def solve(self, B: Array) -> Array:
        """E^-1 B on this rank's rows, (n,) or (n, k)."""
        if B.ndim == 2:
            return on_columns(self.matrix.matSolve, self.matrix.getComm(), B)
        self._b.array[:] = B
        self.matrix.solve(self._b, self._x)
        return np.array(self._x.array)

    def destroy(self) -> None:
        """Free the factor; collective."""
        self.address[0] = 0
        for obj in (self.matrix, self._x, self._b):
            obj.destroy()


def by_mumps(ksp: Any, kind: str = "cholesky") -> None:
    """Let a solver of PETSc be a factor of MUMPS: "cholesky", or "lu" of what is not symmetric or not definite."""
    ksp.setType("preonly")
    ksp.getPC().setType(kind)
    ksp.getPC().setFactorSolverType("mumps")


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
