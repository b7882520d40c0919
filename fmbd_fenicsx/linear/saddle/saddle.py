"""The transient saddle point of elastic bodies tied by trace multipliers, as PETSc blocks with names.

    [ E_1              B_1^T ] [ u_1 ]   [ f_1 ]
    [      ...          ...  ] [ ... ] = [ ... ]        E_k = cm M_k + ck K_k,    cm = 0: statics           (1)
    [ B_1  ...          0    ] [ lam ]   [ g   ]

Displacements are distributed over the ranks like the meshes. Multipliers are few: every rank holds all their values
in the arrays of this module; inside PETSc their rows are split evenly. Blocks carry names ("rod.u", "pin.force")
which are the names of the splits under ``-<prefix>fieldsplit_<name>_...``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp

from ...errors import InputError
from ...fem.fields import Field
from ...fem.traces.mortar import Mortar
from ...fem.traces.multipliers import Multipliers
from ...fem.traces.traces import Trace
from ...log import together
from ...rotations import Array
from ..core import TIE_LIMIT
from ..rigid_modes import elastic_matrix


@dataclass(frozen=True, eq=False)
class Elastic:
    """The block cm M + ck K of one body."""

    body: Field
    cm: float = 0.0
    ck: float = 1.0
    stand_in: float = 0.0  # set by SaddlePoint for bodies without inertia

    @property
    def name(self) -> str:
        """Name of the block."""
        return f"{self.body.name}.u"

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

        volume = b.mass_total / b.forms.density
        return tuple(float(x) for x in b.total(np.array([np.mean(shear), np.mean(axial)])) / volume)  # type: ignore[return-value]

    @property
    def modulus(self) -> float:
        """Mean shear modulus, Pa."""
        return self.moduli[0]

    @property
    def inertia(self) -> float:
        """cm, or in statics a stand-in for preconditioners."""
        return self.cm if self.cm > 0 else self.stand_in

    @property
    def static_inertia(self) -> float:
        """The cm for which waves cross the body in about one step."""
        return float(0.1 * self.ck * self.modulus / (self.body.forms.density * self.body.size**2))

    @property
    def depth(self) -> float:
        """Length sqrt(ck G / (cm rho)) over which a surface force reaches into the body within a step, m."""
        return float(np.sqrt(self.ck * self.modulus / (self.inertia * self.body.forms.density)))


@dataclass(frozen=True, eq=False)
class TraceTie:
    """Rows of (1): sum_k B_k u_k = g, with the multipliers' space where the rows come from one.

    ``columns``: (number of the body, B_k (rows, n_owned d) on this rank); ``multipliers`` and ``components`` say that
    the rows are the functions of a space times that many components (d for a full tie, 1 for a normal one); None for
    other rows. ``sides``: (number of the body, its surface, scalar coupling with all nodes of the surface), for
    preconditioners.
    """

    name: str
    columns: tuple[tuple[int, sp.csr_matrix], ...]
    multipliers: Multipliers | None = None
    components: int = 1
    sides: tuple[tuple[int, Trace, sp.csr_matrix], ...] = ()

    @property
    def rows(self) -> int:
        """Rows, the same on all ranks."""
        return int(self.columns[0][1].shape[0])


def hold(name: str, body: int, multipliers: Multipliers) -> TraceTie:
    """int mu . u = g on a surface: weak Dirichlet data; g = :func:`data`."""
    d = multipliers.trace.dim
    B = multipliers.coupling()
    sides = ((body, multipliers.trace, B),)
    return TraceTie(name, ((body, _vector(multipliers.trace.columns(B), d)),), multipliers, d, sides)


def data(multipliers: Multipliers, function: Callable[[Array], Array], degree: int = 6) -> Array:
    """g = int mu . f for a function of points (n, d) -> (n, d) or scalar (n,); (rows,)."""
    from ...fem.traces.traces import quadrature, scatter, shape_functions

    t = multipliers.trace
    m = t.dim - 1
    q, w = quadrature(m, degree + multipliers.degree)
    values = np.asarray(function(t.place(q).reshape(-1, t.dim))).reshape(len(t.nodes), len(q), -1)

    psi = shape_functions(m, multipliers.degree, q)
    blocks = np.einsum("f,q,qa,fqc->fac", t.sizes, w, psi, values, optimize=True)
    k, c = blocks.shape[1:]
    rows = np.arange(len(t.nodes) * k).reshape(len(t.nodes), k)
    one = scatter(blocks, rows, np.broadcast_to(np.arange(c), (len(rows), c)), (rows.size, c))
    return np.asarray((multipliers.basis @ one).toarray()).ravel()


def tie(name: str, slave: int, master: int, coupling: Mortar) -> TraceTie:
    """int mu . (u_slave - u_master o pi) = 0 over the overlap."""
    d = coupling.slave_trace.dim
    own = _vector(coupling.slave_trace.columns(coupling.slave), d)
    other = _vector(coupling.master_trace.columns(coupling.master), d)
    return TraceTie(name, _merged(slave, own, master, -other), coupling.multipliers, d, _sides(slave, master, coupling))


def slide(name: str, slave: int, master: int, coupling: Mortar) -> TraceTie:
    """int mu n . (u_slave - u_master o pi) = 0: normal only, n the mean normal of the slave (flat surfaces).

    Raises:
        InputError: the surface is curved, so that no single normal exists.
    """
    t = coupling.slave_trace
    n = (t.sizes[:, None] * t.normals).sum(0) / t.sizes.sum()
    if np.linalg.norm(n) < 1 - 1e-6:
        raise InputError(
            f'Tie "{name}": {t.label} is curved (mean normal of length {np.linalg.norm(n):.3f}); a sliding '
            "tie needs a flat surface."
        )
    N = sp.csr_matrix(n[None, :])
    own = sp.kron(t.columns(coupling.slave), N, format="csr")
    other = sp.kron(coupling.master_trace.columns(coupling.master), N, format="csr")
    return TraceTie(name, _merged(slave, own, master, -other), coupling.multipliers, 1, _sides(slave, master, coupling))


def _sides(slave: int, master: int, c: Mortar) -> tuple[tuple[int, Trace, sp.csr_matrix], ...]:
    return ((slave, c.slave_trace, c.slave), (master, c.master_trace, c.master))


def _merged(a: int, A: sp.csr_matrix, b: int, B: sp.csr_matrix) -> tuple[tuple[int, sp.csr_matrix], ...]:
    return ((a, (A + B).tocsr()),) if a == b else ((a, A), (b, B))


def _vector(B: sp.csr_matrix, d: int) -> sp.csr_matrix:
    return sp.kron(B, sp.identity(d), format="csr")


@dataclass
class Solution:
    """Displacements (this rank's share, one array per body), multipliers (replicated, one per tie), and how
    they came.
    """

    u: list[Array]
    multipliers: list[Array]
    iterations: int
    residual: float
    counters: dict[str, float] = field(default_factory=dict)


class SaddlePoint:
    """System (1) as a PETSc nest with named blocks; collective to build and to destroy."""

    def __init__(self, elastic: Sequence[Elastic], ties: Sequence[TraceTie]) -> None:
        from petsc4py import PETSc

        # softest body: a stiff one without inertia is held by its neighbours, which sets the scale of its rigid motion
        softest = min(e.ck * e.modulus for e in elastic)
        self.elastic = tuple(
            replace(e, stand_in=e.static_inertia * softest / (e.ck * e.modulus)) if e.cm == 0 else e for e in elastic
        )

        self.ties = tuple(ties)
        self.comm = elastic[0].body.comm
        together(self.comm, self._check())
        self.names = [e.name for e in elastic] + [t.name for t in ties]

        self.E = [elastic_matrix(e.body, e.cm, e.ck) for e in elastic]
        n, m = len(self.E), len(self.ties)
        table: list[list[Any]] = [[None] * (n + m) for _ in range(n + m)]
        self._own = []
        for k, E in enumerate(self.E):
            table[k][k] = E
        for i, t in enumerate(self.ties):
            # rows of a tie are split evenly among the ranks
            share = share_of(t.rows, self.comm)
            for k, B in t.columns:
                up = _transposed(B, share, t.rows, self.elastic[k], self.comm)
                down = up.copy()
                down.transpose()
                table[k][n + i], table[n + i][k] = up, down
                self._own += [up, down]

        self.table = table
        self.matrix = PETSc.Mat().createNest(table, comm=self.comm)
        self.matrix.assemble()
        self.sets = self.matrix.getNestISs()[0]
        # mean sizes of the columns of each block, for the residual
        self.norms = [
            [0.0 if M is None else M.norm(PETSc.NormType.FROBENIUS) / M.getSize()[0] ** 0.5 for M in row]
            for row in table
        ]
        self.rows = [e.rows for e in self.elastic] + [share_of(t.rows, self.comm) for t in self.ties]

    def _check(self) -> Exception | None:
        """What cannot be a well-posed system: statics of bodies with no tie, names that appear twice."""
        held = {k for t in self.ties for k, _ in t.columns}
        for k, e in enumerate(self.elastic):
            if e.cm == 0 and k not in held:
                return InputError(
                    f'Body "{e.body.name}" has no inertia (statics) and no tie holds it. Tie it, or give cm > 0.'
                )
        names = [e.name for e in self.elastic] + [t.name for t in self.ties]
        twice = sorted({n for n in names if names.count(n) > 1})
        return InputError(f"Blocks with the same name: {twice}.") if twice else None

    def diagonal(self, k: int) -> Array:
        """diag(E_k) on this rank; collective."""
        v = self.E[k].getDiagonal()
        out = np.array(v.array)
        v.destroy()
        return out

    @property
    def n_multipliers(self) -> int:
        """All multipliers."""
        return sum(t.rows for t in self.ties)

    def vector(self, u: Sequence[Array], lam: Sequence[Array]) -> Any:
        """A PETSc vector from displacement blocks (this rank's) and multiplier blocks (replicated)."""
        b = self.matrix.createVecLeft()
        b.array[:] = np.concatenate([*u, *(x[self._slice(x.size)] for x in lam)])
        return b

    def blocks(self, x: Any) -> tuple[list[Array], list[Array]]:
        """The reverse of :meth:`vector`; collective."""
        parts = np.split(x.array.copy(), np.cumsum(self.rows)[:-1])
        n = len(self.elastic)
        return parts[:n], [np.concatenate(self.comm.allgather(p)) for p in parts[n:]]

    def _slice(self, n: int) -> slice:
        low = sum(share_of(n, self.comm, r) for r in range(self.comm.rank))
        return slice(low, low + share_of(n, self.comm))

    def relative_residual(self, x: Any, b: Any) -> float:
        """|A x - b| / |b| over blocks, each block measured against its own terms: the largest; collective.

        A block's size is |b_i| + sum_j |A_ij x_j| so that units and small blocks do not hide an error.
        """
        xs = [x.getSubVector(s) for s in self.sets]
        bs = [b.getSubVector(s) for s in self.sets]

        values, sizes, floors = np.zeros((3, len(bs)))
        given = np.array([v.norm() for v in bs])

        # residuals b - A x and the sizes of their terms
        for i, bi in enumerate(bs):
            r, y, sizes[i] = bi.copy(), bi.duplicate(), bi.norm()
            r.scale(-1.0)
            for j, xj in enumerate(xs):
                if self.table[i][j] is not None:
                    self.table[i][j].mult(xj, y)
                    sizes[i] += y.norm()
                    floors[i] += 1e-6 * self.norms[i][j] * xj.norm()  # rigid motions leave nothing but roundoff
                    r.axpy(1.0, y)
            values[i] = r.norm()
            r.destroy(), y.destroy()

        for s, v, w in zip(self.sets, xs, bs, strict=True):
            x.restoreSubVector(s, v), b.restoreSubVector(s, w)
        if not np.isfinite(values).all():
            return np.inf

        worst = 0.0
        for kind in (slice(0, len(self.elastic)), slice(len(self.elastic), None)):  # forces, constraints
            largest = given[kind].max(initial=0.0) or np.inf
            least = max(1e-6 * sizes[kind].max(initial=0.0), min(floors[kind].max(initial=0.0), largest), 1e-300)
            worst = max(worst, float((values[kind] / np.maximum(sizes[kind], least)).max(initial=0.0)))
        return worst

    def destroy(self) -> None:
        """Free all blocks; collective."""
        for M in (self.matrix, *self._own, *self.E):
            M.destroy()


class SaddleSolver(Protocol):
    """Solves (1)."""

    def solve(self, f: Sequence[Array], g: Sequence[Array]) -> Solution:
        """Displacements and multipliers for loads f (this rank's, one per body) and data g (replicated, one per tie)."""

    def destroy(self) -> None:
        """Free PETSc objects; collective."""


class Preset:
    """A way to solve linear systems, of statics by :meth:`solver` and of the steps of a scene by the others.

    ``limit``: multipliers of surface ties in a scene that its dense core takes. ``multiplier``: the preconditioner with which
    more of them are iterated on to the relative residual ``rtol``; None refuses them.
    """

    limit: int = TIE_LIMIT
    multiplier: Any = None
    rtol: float = 0.0

    def solver(self, saddle: SaddlePoint, prefix: str = "fmbd_") -> SaddleSolver:
        """Set up for a saddle point; collective."""
        raise NotImplementedError

    def block(self, field: Field, weights: tuple[float, float, float], prefix: str) -> Any:
        """The solver of cm M + cd D + ck K, weights (cm, cd, ck), of one body in a scene; collective."""
        raise NotImplementedError

    def split(self, system: Any, prefix: str) -> Any:
        """The solver of the whole matrix of a scene's step; None where fields are eliminated one by one. Collective."""
        return None


def share_of(n: int, comm: Any, rank: int | None = None) -> int:
    """Rows of n that a rank holds inside PETSc."""
    r = comm.rank if rank is None else rank
    return n // comm.size + (r < n % comm.size)


def _transposed(B: sp.csr_matrix, share: int, total: int, e: Elastic, comm: Any) -> Any:
    """B^T as a PETSc matrix: this rank's displacements by all multipliers."""
    from petsc4py import PETSc

    T = B.T.tocsr()
    T.sort_indices()
    csr = (T.indptr.astype(PETSc.IntType), T.indices.astype(PETSc.IntType), T.data)
    size = ((e.rows, e.body.n_global), (share, total))
    A = PETSc.Mat().createAIJ(size, csr=csr, comm=comm)
    A.assemble()
    return A
