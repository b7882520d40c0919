"""Discrete inf-sup constants of multiplier spaces, and discrete norms of H^1/2 and H^-1/2 on a surface.

With A the H^1 inner product on the body (scaled by its length l: |grad u|^2 + u^2 / l^2) and N a discrete H^-1/2 inner
product on the multipliers,

    beta^2 = min_mu  mu^T B A^-1 B^T mu / mu^T N mu                                                        (1)

is the constant of Brezzi's condition; a stable space keeps it away from zero as the mesh is refined. N is the dual norm on a
finer P2 space: N = C H^-1 C^T, C_ji = int mu_j w_i, with H either

* the H^1/2 norm of the surface mesh itself, H = M X L^(1/2) X^T M from the pencil (K + M / l^2) X = M X L
(:func:`half_norm`), or
* the trace norm of the body, H^-1 = A_fine^-1 restricted to the surface (:func:`infsup` with ``reference``).

Sources: Brezzi and Fortin, Mixed and Hybrid Finite Element Methods (doi:10.1007/978-1-4612-3172-1); Chapelle and Bathe, the
inf-sup test (doi:10.1016/0045-7949(93)90340-J).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from ... import dolfinx_compat as compat
from ...checks import shown, typed
from ...errors import InputError
from ...rotations import Array
from ..factors.factor import by_mumps
from ..mesh.mesh import Mesh
from .mortar import diameters, overlap
from .multipliers import Multipliers, MultiplierSpace, default_space
from .traces import Trace, refined, scatter, trace_of

ZERO = 1e-10  # relative size of an eigenvalue that counts as zero
WEAK = 0.1  # inf-sup constants below this are reported


class Stability:
    """What ``beta``, the constant over the functions that are not zero modes, and the ``zero_modes`` say."""

    beta: float
    zero_modes: int

    @property
    def constant(self) -> float:
        """The inf-sup constant: zero when there is a zero mode."""
        return 0.0 if self.zero_modes else self.beta

    @property
    def stable(self) -> bool:
        """Above the level that is reported."""
        return self.constant >= WEAK


@dataclass(frozen=True)
class InfSup(Stability):
    """Result of (1): ``beta`` over the functions that are not zero modes, the number of ``zero_modes``, the space's name."""

    name: str
    beta: float
    zero_modes: int
    multipliers: int
    h: float

    def __str__(self) -> str:
        verdict = "stable" if self.stable else "UNSTABLE: choose another multiplier space"
        modes = f"{self.zero_modes} zero modes of {self.multipliers}"
        return f"{self.name}: inf-sup constant {self.constant:.3f}, {modes}, h = {self.h:.3g} m: {verdict}"


def pencil(trace: Trace, length: float) -> tuple[Array, Array, Array]:
    """Mass matrix M, eigenvalues L and eigenvectors X (X^T M X = 1) of (K + M / l^2) X = M X L on a surface."""
    M = trace.mass().toarray()
    L, X = sl.eigh(trace.stiffness().toarray() + M / length**2, M)
    return M, np.maximum(L, 0.0), X


def half_norm(trace: Trace, values: Array, *, length: float = 1.0, order: float = 0.5) -> float:
    """Norm of order s (1/2 or any in [-1, 1]) of nodal values (n,) or (n, c) on a surface: sqrt(u^T M X L^s X^T M u)."""
    M, L, X = pencil(trace, length)
    c = X.T @ (M @ values.reshape(trace.n, -1))
    return float(np.sqrt((L[:, None] ** order * c**2).sum()))


class DualNorm:
    """The discrete H^-1/2 norm of multipliers: dual to H^1/2 on a P2 space of a ``times`` halved surface; collective to build."""

    def __init__(self, multipliers: Multipliers, *, times: int = 1, length: float = 1.0) -> None:
        self._fine = refined(multipliers.trace, times, 2)
        C = _coupling(multipliers, self._fine)
        # dual to the norm by L^1/2 on these modes
        _, L, self._modes = pencil(self._fine, length)
        self._c = C @ self._modes  # <mu_j, x_k>
        self._weight = L**-0.5

    @property
    def matrix(self) -> Array:
        """N, (n, n)."""
        return np.asarray((self._c * self._weight) @ self._c.T)

    def of(self, values: Array) -> float:
        """Norm of multiplier values (n,) or (n, c)."""
        return self._norm(self._c.T @ values.reshape(self._c.shape[0], -1))

    def error(self, values: Array, exact: Callable[[Array], Array]) -> float:
        """Norm of the multiplier minus a function of points (n, d) -> (n,) or (n, c)."""
        t = self._fine
        blocks = t.integrals(exact, t.degree, 8)
        moments = np.zeros((t.n, blocks.shape[2]))
        np.add.at(moments, t.nodes, blocks)
        return self._norm(self._c.T @ values.reshape(self._c.shape[0], -1) - self._modes.T @ moments)

    def _norm(self, c: Array) -> float:
        return float(np.sqrt((self._weight[:, None] * c**2).sum()))


class BodyNorm:
    """A of the scalar space of a body, or of its displacements (``vector``), and products B A^-1 B^T; collective."""

    def __init__(
        self, mesh: Any, degree: int, *, clamped: tuple[str, ...] = (), length: float = 1.0, vector: bool = False
    ) -> None:
        import dolfinx.fem.petsc as fp
        import ufl
        from dolfinx import fem
        from petsc4py import PETSc

        msh = mesh.dolfinx
        self.mesh, self.comm = mesh, msh.comm
        shape = (mesh.dim,) if vector else ()
        self.space = V = fem.functionspace(msh, ("Lagrange", degree, shape))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + ufl.inner(u, v) / fem.Constant(msh, float(length) ** 2)) * ufl.dx

        tags = [mesh.facets(s) for s in clamped]
        facets = np.concatenate(tags) if tags else np.zeros(0, dtype=np.int32)
        dofs = fem.locate_dofs_topological(V, mesh.dim - 1, np.sort(facets))
        self.fixed = np.zeros(V.dofmap.index_map.size_local, dtype=bool)
        self.fixed[dofs[dofs < len(self.fixed)]] = True

        self.held = [fem.dirichletbc(np.zeros(shape), dofs, V)]
        self.A = fp.assemble_matrix(compat.form(a), self.held)
        self.A.assemble()
        self.A.setOption(PETSc.Mat.Option.SPD, True)

        self.ksp = PETSc.KSP().create(self.comm)
        self.ksp.setOperators(self.A)
        by_mumps(self.ksp)

    def product(self, B: sp.csr_matrix) -> Array:
        """B A^-1 B^T for this rank's columns B (n, n_owned), dense (n, n); collective."""
        from petsc4py import PETSc

        B = B.tocsc(copy=True) if sp.issparse(B) else sp.csc_matrix(B)
        B = B @ sp.diags((~self.fixed).astype(float))
        n, (rows, total) = B.shape[0], (len(self.fixed), self.space.dofmap.index_map.size_global)

        rhs = PETSc.Mat().createDense(((rows, total), (None, n)), comm=self.comm)
        out = PETSc.Mat().createDense(((rows, total), (None, n)), comm=self.comm)
        rhs.setUp(), out.setUp()
        rhs.getDenseArray()[:] = B.T.toarray()
        rhs.assemble(), out.assemble()
        self.ksp.matSolve(rhs, out)

        S = np.sum(self.comm.allgather(B @ np.array(out.getDenseArray())), axis=0)
        rhs.destroy(), out.destroy()
        return np.asarray(0.5 * (S + S.T))

    def destroy(self) -> None:
        """Free the factor; collective."""
        self.ksp.destroy()
        self.A.destroy()


@dataclass(frozen=True)
class OnSurface:
    """Where multipliers act: a surface of a mesh, the degree of the displacements there, and the multiplier space, None: that
    which goes with the degree.
    """

    mesh: Mesh
    name: str
    degree: int = 2
    space: MultiplierSpace | None = None


@runtime_checkable
class Tied(Protocol):
    """What multipliers hold: surfaces of elastic bodies, and ties."""

    def multipliers_on(self) -> OnSurface:
        """Where they act, and which."""


@typed
def infsup(
    joint: Any,
    space: MultiplierSpace | None = None,
    *,
    degree: int | None = None,
    clamped: tuple[str, ...] = (),
    reference: tuple[Any, int] | None = None,
    carrier: tuple[Any, str] | None = None,
) -> InfSup:
    """Inf-sup constant (1) of a joint; collective.

    Args:
        joint: a surface tie, or a surface of an elastic body, or a pair (mesh, surface name).
        space: multiplier space; by default that of the tie, else the default beside the degree.
        degree: degree of V_h; by default the body's, else 2.
        clamped: names of surfaces where displacements are held (with ``reference`` only: there the norm of
        the multipliers
            knows of it; otherwise constants are underestimated, never overestimated).
        reference: (another, finer mesh, degree) whose trace norm is dual to the multipliers' norm; None:
        :class:`DualNorm`.
        carrier: (mesh, surface name) of another mesh on the same place that carries the multipliers.
    """
    given = _on_surface(joint)
    mesh, name = given.mesh, given.name
    degree = degree or given.degree
    space = space or given.space or default_space(degree)
    from dolfinx import fem

    # the multipliers on the surface, or on another mesh of the same place
    length = mesh.extent
    body = BodyNorm(mesh, degree, clamped=clamped, length=length)
    trace = trace_of(body.space, mesh, name)
    if carrier is None:
        mu = space.on(trace)
        B = mu.coupling()
    else:
        mu = space.on(trace_of(fem.functionspace(carrier[0].dolfinx, ("Lagrange", degree)), *carrier))
        B = _coupling(mu, trace)

    # eigenvalues beta^2 of S = B A^-1 B^T against the norm of the multipliers
    S = body.product(trace.columns(B))
    body.destroy()

    if reference is None:
        N = DualNorm(mu, length=length).matrix
    else:
        fine_mesh, fine_degree = reference
        fine = BodyNorm(fine_mesh, fine_degree, clamped=clamped, length=length)
        finer = trace_of(fine.space, fine_mesh, name)
        N = fine.product(finer.columns(_coupling(mu, finer)))
        fine.destroy()

    beta, zero = smallest(sl.eigh(S, N, eigvals_only=True))
    return InfSup(f"P{degree} / {mu.name}", beta, zero, mu.n, trace.h)


def smallest(values: Array) -> tuple[float, int]:
    """beta of (1) from its eigenvalues, over those that are not zero, and the number of zeros."""
    zero = values < ZERO * max(float(values.max()), 1e-300)
    return (float(np.sqrt(values[~zero].min())) if (~zero).any() else 0.0), int(zero.sum())


def _coupling(mu: Multipliers, fine: Trace) -> sp.csr_matrix:
    """int mu_j w_i with another mesh of the same surface, (n, nodes)."""
    pair, _, blocks = overlap(mu.trace, fine, mu.degree, 0.1 * diameters(mu.trace), facing=False)
    k = blocks.shape[1]
    rows, columns = pair[:, :1] * k + np.arange(k), fine.nodes[pair[:, 1]]
    return (mu.basis @ scatter(blocks, rows, columns, (mu.basis.shape[1], fine.n))).tocsr()


def _on_surface(joint: Any) -> OnSurface:
    """What the user means."""
    if isinstance(joint, Tied):
        return joint.multipliers_on()
    if isinstance(joint, tuple) and len(joint) == 2:
        mesh, name = joint
        if isinstance(mesh, Mesh) and isinstance(name, str):
            return OnSurface(mesh, name)
    raise InputError(
        f"infsup takes a surface tie, a surface of an elastic body, or (mesh, surface name); found {shown(joint)}."
    )
