"""Modes of an elastic body under linear conditions C^T u = 0: the bases of reduced bodies.

    K phi + C mu = omega^2 M phi,   C^T phi = 0          vibration                                            (1)
    K psi + C mu = 0,               C^T psi = e_p        static, one for every condition p                    (2)

With the mean-axis conditions C = [M 1, M (e x X)] the modes (1) are the free-free modes without the rigid ones; with the
conditions of surfaces that stand still on average they are clamped modes. The Craig-Bampton basis holds the modes (1) with
all moments of the interfaces at rest and the static modes (2) of these moments. K is singular, so the shifted K + s M
is factored once and used for all of it: by SLEPc's Krylov-Schur method on the shift-inverted operator for (1), by
refinement for (2), which converges like (s / (s + omega_1^2))^k.

Source: Craig and Bampton, doi:10.2514/3.4741.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from ...errors import FmbdError, InputError, LinearSolveError
from ...fem.factors.factor import Factor
from ...fem.fields import Field
from ...log import log
from ...matrices import orthonormalising
from ...rotations import Array

SHIFT = 1e-3  # of an upper bound of the first eigenvalue
SOFTER = 0.1  # share of a bound below which another one shows that it was none of a first eigenvalue
INVERSE = 3  # inverse iterations with one factor
SLOW = 20  # refinements after which the shift is taken for too large
LOWER = 3  # times that it is made smaller
# squares of corrections over a displacement's: those of roundoff, and where parts a million times as stiff leave more
ROUNDED, ROUGH = 1e-12, 1e-8
VANISHED = 1e-12  # share of mass and strain below which a direction is none
SEEN = 0.1  # share of a square of a frequency that may be roundoff; most of it cancels
WEIGHTLESS = 1e-13  # share of mass in both that is roundoff
FAR_BELOW = 1e-6  # share of the largest square below which squares of frequencies are found anew
ALIKE = 1e-6  # relative difference below which squares of frequencies are one, and roundoff turns their modes among themselves


def rigid_fields(field: Field) -> Array:
    """Nodal displacements of the rigid motions, (n d, n_twist)."""
    return field.motions.rigid(field.X).reshape(-1, field.motions.n_twist)


def quadratic_fields(X: Array) -> Iterator[Array]:
    """Quadratic displacements (n, d) at points X (n, d): e_k X_i X_j, and bending without shear.

    Bending is u_k = X_i^2, u_i = -2 X_i X_k, whose section stays as it is, and beside it that whose section strains across by as
    much as keeps the volume: bodies that keep theirs resist all others by their modulus of compression.
    """
    d = X.shape[1]
    for k, i, j in itertools.product(range(d), repeat=3):
        if j < i:
            continue
        u = np.zeros(X.shape)
        u[:, k] = X[:, i] * X[:, j]
        if i != j or i == k:
            yield u
            continue

        u[:, i] = -2.0 * X[:, i] * X[:, k]
        yield u
        u = u.copy()
        u[:, k] += X[:, k] ** 2 / (d - 1)
        for across in set(range(d)) - {i, k}:
            u[:, k] -= X[:, across] ** 2 / (d - 1)
            u[:, across] = 2.0 * X[:, across] * X[:, k] / (d - 1)
        yield u


def principal_axes(field: Field) -> tuple[Array, Array]:
    """int rho x x^T about the centre of mass along its principal axes, (d,) ascending (kg m^2), and these axes, columns (d, d);
    collective.
    """
    sizes, axes = np.linalg.eigh(field.total(field.mass(field.X).T @ field.X))
    return sizes, axes


def _bent(field: Field) -> Iterator[Array]:
    """Quadratic displacements of a body along and across its principal axes, however it was meshed; collective."""
    axes = principal_axes(field)[1]
    return (u @ axes.T for u in quadratic_fields(field.X @ axes / field.size))


def waves(field: Any, draw: np.random.Generator) -> Array:
    """Displacements (n d,) by waves of random lengths and phases: the same on any number of ranks, and of any mesh."""
    d = field.dim
    turns = draw.standard_normal((d, d)) * 2.0 * np.pi / field.size
    return np.cos(field.X @ turns + draw.uniform(0.0, 2.0 * np.pi, d)).ravel()


def first_eigenvalue_bound(field: Field) -> float:
    """Rayleigh quotients of quadratic displacements without their rigid part: an upper bound in (rad/s)^2, close for slender
    bodies of one material. Collective. The field keeps that of its newest tangent.
    """
    known = field.kept_bound
    if known is None or known[0] != field.tangents:
        known = field.kept_bound = field.tangents, _bound(field)
    return known[1]


def _bound(field: Field) -> float:
    return float(_rayleigh(field, np.stack([shape.ravel() for shape in _bent(field)], axis=1))[0].min())


def bound_by_soft_parts(field: Field) -> float:
    """The same where parts may be far softer than others: of displacements by which forces of such accelerations move each node
    alone, and of inverse iteration from there. Collective.
    """
    f, best = field, first_eigenvalue_bound(field)
    alone = f.K.getDiagonal().array[: field.n * field.dim]
    moved = np.stack([f.mass(shape).ravel() / alone for shape in _bent(f)], axis=1)
    quotients, shapes = _rayleigh(f, moved)
    k = int(quotients.argmin())
    soft, u = float(quotients[k]), shapes[:, k]
    while 0.0 < soft < SOFTER * best:
        best = soft
        try:
            factor = Factor(f, SHIFT * soft, 1.0)
        except LinearSolveError:
            return best  # what is softer is lost in roundoff
        for _ in range(INVERSE):
            quotients, shapes = _rayleigh(f, factor.solve(f.mass(u.reshape(-1, f.dim)).ravel())[:, None])
            soft, u = float(quotients[0]), shapes[:, 0]
        factor.destroy()
    return min(best, soft) if soft > 0.0 else best


def _rayleigh(field: Field, U: Array) -> tuple[Array, Array]:
    """Rayleigh's quotients (k,) of displacements U (n d, k) without their rigid parts, and these; collective."""
    f, Z = field, rigid_fields(field)
    U = U - Z @ np.linalg.solve(f.total(Z.T @ f.Q), f.total(f.Q.T @ U))
    kk, mm = f.total(np.stack([np.einsum("ik,ik->k", U, AU) for AU in (f.stiffness(U), f.mass_columns(U))]))
    # contact nodes may carry no inertia
    return np.divide(kk, mm, out=np.full(len(kk), np.inf), where=mm > 0), U


def first_mode(field: Field, conditions: Array) -> tuple[float, Array]:
    """Lowest frequency omega (rad/s) under the conditions, by inverse iteration, to about a percent, and its shape (n d,) of
    modal mass 1; collective.
    """
    body = ConditionedBody(field, conditions)
    u = waves(field, np.random.default_rng(5))

    value = np.inf
    before = 0.0
    for _ in range(50):
        Mu = field.mass(u.reshape(-1, field.dim)).ravel()
        u = body.solve_shifted(Mu)
        # Rayleigh's quotient
        kk, mm = field.total(np.array([u @ field.stiffness(u), u @ field.mass(u.reshape(-1, field.dim)).ravel()]))
        value, before = float(kk / mm), value
        u = u / np.sqrt(mm)
        if abs(value - before) < 1e-3 * value:
            break

    body.destroy()
    return float(np.sqrt(value)), u


class ConditionedBody:
    """K + s M of a field, factored, with conditions C (n d, c); collective to build, to use and to destroy."""

    def __init__(self, field: Field, conditions: Array) -> None:
        self.field, self.C = field, conditions
        self._shifted(SHIFT * first_eigenvalue_bound(field))

    def _shifted(self, shift: float) -> None:
        """Factor K + s M, and the answers to the conditions."""
        field, conditions = self.field, self.C
        self.shift = shift
        kept = field.kept_factors
        known = None if kept is None else kept.get(self.shift)
        self.factor = Factor(field, self.shift, 1.0) if known is None else known
        if kept is not None:
            kept[self.shift] = self.factor
        self.Y = self.factor.solve_all(conditions)
        self.W = field.total(conditions.T @ self.Y)

    def _bordered(self, b: Array, c: Array) -> tuple[Array, Array]:
        """u and mu with (K + s M) u + C mu = b and C^T u = c; of several, columns of both."""
        z = self.factor.solve(b) if b.ndim == 1 else self.factor.solve_all(b)
        mu = np.linalg.solve(self.W, self.field.total(self.C.T @ z) - c)
        return z - self.Y @ mu, np.asarray(mu, dtype=float)

    def solve_shifted(self, b: Array) -> Array:
        """u with (K + s M) u + C mu = b and C^T u = 0."""
        return self._bordered(b, np.zeros(self.C.shape[1]))[0]

    def solve_static(self, B: Array, C: Array | None = None) -> Array:
        """U (n d, k) with K U + C_0 mu = B and C_0^T U = C, C_0 the conditions, by refinement of all columns together; the
        conditions must hold the body.
        """
        f = self.field
        C = np.zeros((self.C.shape[1], B.shape[1])) if C is None else C
        U, mu = self._bordered(B, C)
        # forces that the conditions balance move nothing but by roundoff of what they would move alone
        floor = np.finfo(float).eps ** 2 * f.total(((U + self.Y @ mu) ** 2).sum(axis=0))
        # the factor is that of K + s M: corrections of the residual of K
        before, left = np.full(B.shape[1], np.inf), np.arange(B.shape[1])
        for count in range(100):
            if not len(left):
                return U  # to roundoff: corrections do not fall any more
            # the bound is far above the first eigenvalue where a soft part stands beside a stiff one
            if count and count % SLOW == 0 and count <= LOWER * SLOW:
                self.destroy()
                self._shifted(SHIFT * self.shift)
            u = U[:, left]
            du, dmu = self._bordered(
                B[:, left] - f.stiffness(u) - self.C @ mu[:, left], C[:, left] - f.total(self.C.T @ u)
            )
            U[:, left] = u = u + du
            mu[:, left] += dmu

            size, change = f.total(np.stack(((u * u).sum(axis=0), (du * du).sum(axis=0))))
            small = ROUNDED if count <= LOWER * SLOW else ROUGH
            stays = (change >= 0.25 * before[left]) & (change <= small * size)
            before[left] = change
            left = left[~((change <= 1e-24 * size + floor[left]) | stays)]
        raise FmbdError(f'Body "{f.name}": static modes did not converge; the conditions do not hold the body.')

    def static_modes(self, forces: Array | None = None) -> Array:
        """The modes (2), (n d, c), and beside them the displacements under nodal ``forces`` (n d, k), conditions at rest."""
        B = np.zeros((len(self.C), 0)) if forces is None else forces
        at_rest = np.zeros((self.C.shape[1], B.shape[1]))
        given = np.concatenate((np.eye(self.C.shape[1]), at_rest), axis=1)
        return self.solve_static(np.concatenate((np.zeros_like(self.C), B), axis=1), given)

    def vibration_modes(self, count: int) -> tuple[Array, Array]:
        """The first ``count`` modes (1): omega (rad/s) ascending, and phi (n d, count)."""
        from petsc4py import PETSc

        f = self.field
        if count == 0:
            return np.zeros(0), np.zeros((len(self.C), 0))
        if count > f.n_global - self.C.shape[1]:
            raise InputError(
                f'Body "{f.name}": {count} modes asked for, but its field has only {f.n_global} unknowns and '
                f"{self.C.shape[1]} conditions."
            )

        M = f.mass_matrix()
        K = PETSc.Mat().createPython(M.getSizes(), _Stiffness(f), comm=f.comm)
        K.setUp()
        eps = self._eigensolver(K, M, count)

        # a start without the parts that the conditions exclude
        start = M.createVecRight()
        start.array[:] = self.solve_shifted(f.mass(waves(f, np.random.default_rng(3)).reshape(f.n, f.dim)).ravel())
        eps.setInitialSpace(start)
        eps.solve()

        found = eps.getConverged()
        values, modes = [], []
        for k in range(min(found, count)):
            values.append(eps.getEigenpair(k, start).real)
            modes.append(start.array.copy())
        for obj in (eps, start, K):
            obj.destroy()
        if found < count:
            raise FmbdError(f'Body "{f.name}": SLEPc found {found} of {count} modes.')

        order = np.argsort(values)
        return np.sqrt(np.maximum(np.array(values)[order], 0.0)), np.stack(modes, axis=1)[:, order]

    def _eigensolver(self, K: Any, M: Any, count: int) -> Any:
        """SLEPc's solver for the smallest eigenvalues of (K, M), by shift and invert with the factor that is there."""
        from slepc4py import SLEPc

        eps = SLEPc.EPS().create(self.field.comm)
        eps.setOperators(K, M)
        eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
        eps.setDimensions(count, min(max(2 * count, count + 15), self.field.n_global))
        # the shift is negative: K + s M is positive definite
        eps.setTarget(-self.shift)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_REAL)
        eps.setTolerances(1e-12, 500)

        st = eps.getST()
        st.setType("sinvert")
        st.setShift(-self.shift)
        st.setMatMode(SLEPc.ST.MatMode.SHELL)
        ksp = st.getKSP()
        ksp.setType("preonly")
        ksp.getPC().setType("python")
        ksp.getPC().setPythonContext(_Inverse(self))
        return eps

    def destroy(self) -> None:
        """Free the factor, where nobody else uses it; collective."""
        if self.field.kept_factors is None:
            self.factor.destroy()


class _Stiffness:
    """K of a field as a PETSc matrix that only multiplies; the pressure of a mixed field stays inside."""

    def __init__(self, field: Field) -> None:
        self.field = field

    def mult(self, A: Any, x: Any, y: Any) -> None:
        """y = K x."""
        y.array[:] = self.field.stiffness(x.array_r)


class _Inverse:
    """The conditioned inverse of K + s M as a PETSc preconditioner, so that SLEPc uses it as its shift-inverted operator."""

    def __init__(self, body: ConditionedBody) -> None:
        self.body = body

    def apply(self, pc: Any, x: Any, y: Any) -> None:
        """y = (K + s M)^-1 x under the conditions."""
        y.array[:] = self.body.solve_shifted(x.array_r)


def orthonormal_modes(field: Field, V: Array, conditions: Array) -> tuple[Array, Array]:
    """A basis of span V in the frame given by ``conditions``, M-orthonormal: K (m, m) and phi (n d, m). K is diagonal, the
    squares of frequencies (rad/s) ascending, but for roundoff among equal ones: see :func:`_settled`.

    Rigid parts of V are taken out by the frame's conditions; directions that vanish with them, against the size that they had
    before, are dropped: static modes of one interface hold all rigid motions. What vanishes has neither mass nor strain; what a
    small surface moves by itself has strain, and hardly any mass.

    Raises:
        InputError: there are directions with strain whose mass is lost in roundoff.
    """
    Z = rigid_fields(field)
    # sizes before rigid parts are taken out, so that what vanishes with them is seen
    before = field.total((V * field.mass_columns(V)).sum(axis=0))
    V = V - Z @ np.linalg.solve(field.total(conditions.T @ Z), field.total(conditions.T @ V))

    def both(A: Array) -> tuple[Array, Array]:
        """A^T K A and A^T M A."""
        MA = field.mass_columns(A)
        K, M = field.total(np.stack((A.T @ field.stiffness(A), A.T @ MA)))
        return 0.5 * (K + K.T), 0.5 * (M + M.T)

    V = V / np.sqrt(np.maximum(before, 1e-300))
    K, M = both(V)
    # one square of a frequency, by which strain counts as mass does
    unit = np.trace(K) / max(np.trace(M), 1e-300)
    for _ in range(2):  # twice is enough: the second pass cleans the roundoff of the first
        V = V @ orthonormalising(M + K / unit if unit else M, VANISHED)
        K, M = both(V)

    light = float(np.linalg.eigvalsh(M)[0])
    if not light > WEIGHTLESS:
        raise InputError(
            f'Body "{field.name}": roundoff hides the mass of its static modes ({light:.1e} of the others): a surface is too '
            "small against the body, or its materials are too far apart. Take a larger surface, or the full body."
        )
    squares, U = squares_of_frequencies(K, M)
    order = np.argsort(squares)
    squares, modes = squares[order], V @ U[:, order]
    _tell_roundoff(field, float(squares[0]), modes[:, 0])
    turns = _settled(field, squares, modes)
    return turns.T @ (np.maximum(squares, 0.0)[:, None] * turns), modes @ turns


def _settled(field: Field, squares: Array, modes: Array) -> Array:
    """Turns (m, m) among modes of equal frequency, and signs, which an eigensolver leaves open: with them the modes do not depend
    on the number of ranks. Collective.

    Of c modes the first alone answers to a first wave w_1, and with a positive sign, the second to a second one beside it, ...:
    phi_j^T M w_i = 0 for j > i, > 0 for j = i.
    """
    starts = np.flatnonzero(np.diff(squares, prepend=-np.inf) > ALIKE * np.abs(squares))
    groups = np.split(np.arange(len(squares)), starts[1:])
    draw = np.random.default_rng(11)
    moved = [field.mass(waves(field, draw).reshape(-1, field.dim)).ravel() for _ in range(max(map(len, groups)))]
    answers = field.total(modes.T @ np.stack(moved, axis=1))

    turns = np.diag(np.where(answers[:, 0] < 0, -1.0, 1.0))
    for group in (g for g in groups if len(g) > 1):
        q, r = np.linalg.qr(answers[group, : len(group)])
        turns[np.ix_(group, group)] = q * np.where(np.diag(r) < 0, -1.0, 1.0)
    return turns


def _tell_roundoff(field: Field, square: float, mode: Array) -> None:
    """Warn where roundoff of the stiffness, eps sum_i K_ii phi_i^2, is seen beside omega^2 of the first mode; collective."""
    stiff = field.K.getDiagonal().array[: len(mode)]
    noise = np.finfo(float).eps * float(field.total(np.array(stiff @ mode**2)))
    if noise > SEEN * square:
        log.warning(
            'body "%s": roundoff of its stiffness is up to %.1g of what its first mode has: modes are uncertain. Its materials '
            "or cells are too far apart in stiffness; take a rigid body for a part that hardly bends",
            field.name,
            noise / max(square, 1e-300),
        )


def squares_of_frequencies(K: Array, M: Array) -> tuple[Array, Array]:
    """omega^2 (n,) of K y = omega^2 M y and the vectors (n, n), each with its own digits.

    Roundoff of the largest is in all of them: a light part on a heavy one, or a small cell, would hide the first. Those far below
    are found again among themselves: their vectors are off by the root of what that costs.
    """
    import scipy.linalg as sl

    squares, Y = sl.eigh(K, M)
    sizes = np.abs(squares)
    slow = sizes < FAR_BELOW * sizes.max(initial=0.0)
    if not slow.any():
        return squares, Y
    Z = Y[:, slow]
    squares[slow], combined = squares_of_frequencies(Z.T @ K @ Z, Z.T @ M @ Z)
    Y[:, slow] = Z @ combined
    return squares, Y
