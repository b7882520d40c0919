"""Factorised symmetric positive definite blocks of elastic fields: E = cm M + ck K.

The factors themselves are those of :mod:`fmbd_fenicsx.fem.factors.factor`; here every solve is judged.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import require
from ...fem.factors.factor import Factor, InC, PetscFactor, address_of_solve
from ...fem.fields import Field
from ...ranks import rank_sum
from ...rotations import Array
from ..residual import Judge

EPS = float(np.finfo(float).eps)
HIDDEN = 1.5e-7  # measured: below, a rod that falls is right to 3e-4 of its length; at four times as much it is not


# measured: from 1e-8 on, stresses that an increment foretold led rods that fall to other solutions of a step, 1e-3 of their
# length away; soft frames and arches, which need them, have less than 4e-10
NOISY = 2e-9

SMALL = 50_000  # unknowns of a field on one rank whose masses are factored


class FieldFactor:
    """What solves with the matrix of one field; every solve is judged by its own true residual. Collective.

    ``how``: by what, in words. ``iterations``: of an inner Krylov method so far. ``fresh``: False where an earlier factorisation
    serves. ``hidden``: share of the inertia forces of a rigid motion that the roundoff of elastic forces may have, of nonlinear
    bodies that turn. ``slack``: numbers of one-sided springs that its matrix leaves out.
    """

    judge: Judge
    slack: np.ndarray = np.zeros(0, dtype=int)
    how = ""
    iterations = 0
    fresh = True
    hidden = 0.0

    @property
    def noisy(self) -> bool:
        """Whether elastic forces are too inexact for stresses to be foretold (:mod:`fmbd_fenicsx.fem.motion_tangent`)."""
        return self.hidden > NOISY

    @property
    def sparse(self) -> FieldFactor:
        """The factor of its sparse matrix: itself, unless the field's matrix has something of low rank beside it."""
        return self

    def product(self, u: Array) -> Array:
        """The matrix times u on owned entries, of blocks that are solved as a whole."""
        raise NotImplementedError

    def solve(self, b: Array) -> Array:
        """The solution (n,) for loads on this rank's entries."""
        raise NotImplementedError

    def in_c(self) -> InC | None:
        """How compiled code solves by itself; None where it has to ask."""
        return None

    def solve_columns(self, B: Array) -> Array:
        """E^-1 B for columns B (n, k)."""
        if not B.shape[1]:
            return B.copy()
        return np.stack([self.solve(column) for column in B.T], axis=1)

    def destroy(self) -> None:
        """Free what belongs to PETSc."""


class CholeskyFactor(FieldFactor):
    """E = cm M + ck K of a field, factored and judged; collective to build, to solve and to destroy.

    ``turns``: the coordinates of the field are those of a body that turns as a whole.

    Raises:
        InputError: such a body is so stiff that the roundoff of its stiffness hides its inertia.
    """

    def __init__(self, field: Field, cm: float, ck: float, cd: float = 0.0, *, turns: bool = False) -> None:
        self.field, self.cm, self.ck = field, cm, ck
        self.judge = Judge(f'the elastic block of body "{field.name}"')
        self.factor = Factor(field, cm, ck, cd)
        self.how = self.factor.how
        if not (turns and field.nonlinear):
            return
        # a rigid motion of one metre has the inertia force m, and the roundoff eps |E| sqrt(n) of elastic forces that cancel
        self.hidden = EPS * self.factor.norm * float(np.sqrt(field.n_global)) / (cm * field.mass_total)
        if not field.tangents:  # later ones may be of iterates far away
            self._refuse_hidden_inertia()

    def _refuse_hidden_inertia(self) -> None:
        f, hidden = self.field, self.hidden
        require(
            hidden <= HIDDEN,
            f'Body "{f.name}" is too stiff for steps of this size in absolute coordinates: the roundoff of its elastic forces '
            f"in a rigid motion is {hidden:.1e} of its inertia forces, {HIDDEN:.1e} is allowed. Use fmbd.FloatingBody or a rigid "
            f"body, or take dt smaller by a factor of {np.sqrt(hidden / HIDDEN):.2g}.",
        )

    def solve(self, b: Array) -> Array:
        """E^-1 b on owned entries, judged by its true residual."""
        x, r = self.factor.solve_with_residual(b)
        self._judge(r, b, x)
        return x

    def in_c(self) -> InC | None:
        """As above; it judges likewise."""
        return self.factor.in_c()

    def solve_columns(self, B: Array) -> Array:
        """E^-1 B for dense columns (n, k), all at once; every column is judged."""
        X, R = self.factor.solve_columns(B)
        self._judge(R, B, X)
        return X

    def _judge(self, r: Array, b: Array, x: Array) -> None:
        """Of one solution or of columns: |E| by its largest row sum, an upper bound of its 2-norm (E is symmetric)."""
        squares = np.array([np.einsum("i...,i...", z, z) for z in (r, b, x)]).reshape(3, -1)
        for rr, bb, xx in np.sqrt(rank_sum(self.field.comm, squares)).T.tolist():
            self.judge.check(rr, bb, grown=self.factor.norm * xx)

    def destroy(self) -> None:
        """Free the factor; collective."""
        self.factor.destroy()


class MassInverse(FieldFactor):
    """M^-1 of a field: one matrix for all components.

    A Cholesky factor where that is small; explicit schemes solve with it several times a step. Else conjugate gradients with
    diagonal scaling: the Galerkin mass matrix has a condition number that does not depend on the mesh, so about 30 iterations
    reach 1e-13 (Wathen, doi:10.1093/imanum/7.4.449), and the consistent start of a large body needs no second factorisation.
    """

    def __init__(self, field: Field, cm: float) -> None:
        self.field, self.cm = field, cm
        self.judge = Judge(f'the mass matrix of body "{field.name}"')
        small = field.comm.size == 1 and field.n * field.dim <= SMALL
        definite = small and not field.redistributed  # contact nodes may have no mass
        self.component: PetscFactor | MassConjugateGradients = (
            PetscFactor(field.M, True, "CHOLMOD") if definite else MassConjugateGradients(field.M)
        )

    def solve(self, b: Array) -> Array:
        """(cm M)^-1 b on owned entries, judged by its true residual."""
        f = self.field
        B = b.reshape(-1, f.dim)
        X = np.empty_like(B)
        for k in range(f.dim):
            X[:, k] = self.component.solve(B[:, k])
        r = f.mass(X) - B
        rr, bb = f.total(np.array([(r * r).sum(), (B * B).sum()]))
        self.judge.check(float(np.sqrt(rr)), float(np.sqrt(bb)))
        return X.ravel() / self.cm

    def solve_columns(self, B: Array) -> Array:
        """(cm M)^-1 B for columns (n d, k), all at once by a factor; every column is judged."""
        if not (B.shape[1] and isinstance(self.component, PetscFactor)):
            return super().solve_columns(B)
        k = B.shape[1]
        rows = B.reshape(-1, self.field.dim * k)
        X = self.component.solve(rows)
        R = (self.field.mass(X) - rows).reshape(B.shape)
        squares = np.stack(((R * R).sum(axis=0), (B * B).sum(axis=0)))
        for residual, size in np.sqrt(self.field.total(squares)).T:
            self.judge.check(float(residual), float(size))
        return X.reshape(B.shape) / self.cm

    def in_c(self) -> InC | None:
        """As above, with a factor; it judges likewise."""
        if address_of_solve() is None or not isinstance(self.component, PetscFactor):
            return None
        return InC(self.component.address, self.cm, 0.0, by_component=True)

    def destroy(self) -> None:
        """Free the solver; collective."""
        self.component.destroy()


class MassConjugateGradients:
    """M^-1 with diagonal scaling; collective."""

    def __init__(self, M: Any) -> None:
        from petsc4py import PETSc

        self.ksp = PETSc.KSP().create(M.getComm())
        self.ksp.setOperators(M)
        self.ksp.setType("cg")
        self.ksp.getPC().setType("jacobi")
        self.ksp.setTolerances(rtol=1e-13, atol=1e-300, max_it=2000)
        self.x, self.b = M.createVecs()

    def solve(self, b: Array) -> Array:
        """M^-1 b on owned entries, unjudged."""
        self.b.array[:] = b
        self.ksp.solve(self.b, self.x)
        return np.array(self.x.array)

    def destroy(self) -> None:
        """Free the solver."""
        for obj in (self.ksp, self.x, self.b):
            obj.destroy()
