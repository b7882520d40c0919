"""Matrices of parallel tensioned wires by cubic Hermite elements: equation (1) of :mod:`.wires` on one rank."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ... import dolfinx_compat as compat
from ...errors import require
from ...fem.assembly import petsc_of, product
from ...rotations import Array


@dataclass(frozen=True)
class _Unloaded:
    loads: tuple[Any, ...] = ()


@dataclass(frozen=True)
class _Damping:
    mass_damping: float
    stiffness_damping: float
    energy: Any = None


class LineField:
    """Matrices of (1) on one rank; what the solver's factors need of a field.

    Unknowns are values and slopes (with respect to the cell's own coordinate) of all wires at the nodes.
    """

    dim = 1
    D = None  # no damping form
    loads = _Unloaded()
    numbering = None  # every rank holds all unknowns
    redistributed = False
    nonlinear = mixed = indefinite = carried = keeps_volume = extended = False
    rest_damping = None  # its stiffness is constant

    def __init__(self, body: Any) -> None:
        import basix
        import basix.ufl
        import dolfinx.fem.petsc as fp
        import ufl
        from dolfinx import fem, mesh
        from mpi4py import MPI

        compat.check_versions()
        self.name, self.body, self.comm = body.name, body, MPI.COMM_SELF
        self.factors: dict[tuple[float, float], Any] = {}  # of the solver, see linear/blocks/low_rank.py
        self.forms = _Damping(body.mass_damping, body.stiffness_damping)
        line = mesh.create_interval(self.comm, body.cells, [0.0, body.length])
        cell = basix.create_element(basix.ElementFamily.Hermite, basix.CellType.interval, 3)
        hermite = basix.ufl.wrap_element(cell)

        count = len(body.wires)
        self.space = fem.functionspace(line, basix.ufl.blocked_element(hermite, shape=(count,)))
        u = ufl.TrialFunction(self.space)
        v = ufl.TestFunction(self.space)
        dx = ufl.dx(domain=line)
        mu = fem.Constant(line, np.array([wire.mass for wire in body.wires], dtype=float))
        T = fem.Constant(line, np.array([wire.tension for wire in body.wires], dtype=float))
        EI = fem.Constant(line, np.array([wire.bending for wire in body.wires], dtype=float))

        def weighted(c: Any, order: int) -> Any:
            def d(w: Any, i: int) -> Any:
                out = w[i]
                for _ in range(order):
                    out = out.dx(0)
                return out

            return sum(c[i] * d(u, i) * d(v, i) for i in range(count)) * dx

        self.M = fp.assemble_matrix(compat.form(weighted(mu, 0)))
        self.M.assemble()
        self.K = fp.assemble_matrix(compat.form(weighted(T, 1) + weighted(EI, 2)))
        self.K.assemble()
        self.n = self.n_global = self.M.size[0]
        self._cells(cell, line, count)
        self._point_springs()
        self._work = [self.K.createVecRight(), self.K.createVecLeft()]
        ones = np.zeros(self.n)
        ones[self.dofs[:, 0::2].ravel()] = 1.0
        self.weight: Array = self.mass(ones[:, None])[:, 0]
        self.mass_total = float(self.weight.sum())
        self.size = body.length

    def _cells(self, cell: Any, line: Any, count: int) -> None:
        """Unknowns (value, slope, value, slope) of each wire on each cell from left to right, (cells, 4 count)."""
        self.element, self.h = cell, self.body.length / self.body.cells
        from ...dolfinx_compat import geometry_dofmap

        corners = line.geometry.x[geometry_dofmap(line), 0]
        middle = corners.mean(1)
        order = np.argsort(middle)
        local = self.space.dofmap.list[order]
        first = corners[order, 0]
        require(bool(np.allclose(first, self.h * np.arange(len(order)))), "DOLFINx turned cells of an interval around.")
        self.by_wire = local[:, :, None] * count + np.arange(count)  # (cells, 4, count)
        # where the unknowns are, (n, 1): one wire behind the other
        self.X: Array = np.zeros((self.n, 1))
        self.X[self.by_wire, 0] = (first[:, None] + self.h * np.array([0.0, 0.0, 1.0, 1.0]))[:, :, None] + (
            self.body.length * np.arange(count)
        )
        self.dofs = self.by_wire.transpose(0, 2, 1).reshape(len(order), -1)

    def shape(self, wire: int, x: float, derivatives: int = 0) -> tuple[np.ndarray, Array]:
        """Unknowns (4,) of a wire at x, and values and x-derivatives (1 + derivatives, 4) of their shape functions."""
        c = min(max(int(x / self.h), 0), self.body.cells - 1)
        table = self.element.tabulate(derivatives, np.array([[x / self.h - c]]))[:, 0, :, 0]
        return self.by_wire[c, :, wire], table / self.h ** np.arange(derivatives + 1)[:, None]

    def row(self, wire: int, x: float) -> Any:
        """w_wire(x) as a sparse row (1, n)."""
        import scipy.sparse as sp

        dofs, values = self.shape(wire, x)
        return sp.csr_matrix((values[0], (np.zeros(4, int), dofs)), shape=(1, self.n))

    def _point_springs(self) -> None:
        """Supports, anchors and (taut) droppers into K; B and offsets of the droppers."""
        import scipy.sparse as sp

        b = self.body
        springs = [(s.wire, s.x, s.stiffness) for s in b.supports]
        springs += [(i, x, b.anchor) for i in range(len(b.wires)) for x in (0.0, b.length)]

        rows = [self.row(wire, x) for wire, x, _ in springs]
        weights = [stiffness for _, _, stiffness in springs]

        # droppers join two wires, taut in K; what they must not push is taken back by the solver
        drop = [self.row(d.upper, d.x) - self.row(d.lower, d.x) for d in b.droppers]
        self.B = sp.vstack(drop).tocsr() if drop else sp.csr_matrix((0, self.n))
        self.offset = np.array([d.offset for d in b.droppers])
        self.stiff = np.array([d.stiffness for d in b.droppers])
        self.one_sided = np.array([d.one_sided for d in b.droppers], dtype=bool)

        self.K = self._with(self.K, sp.vstack([*rows, self.B]).tocsr(), np.concatenate((weights, self.stiff)))

    def _with(self, K: Any, rows: Any, weights: Array) -> Any:
        """K + sum_r weights_r row_r^T row_r as a PETSc matrix."""
        import scipy.sparse as sp

        start, cols, values = K.getValuesCSR()
        total = sp.csr_matrix((values, cols, start), shape=K.size) + rows.T @ sp.diags(weights) @ rows
        K.destroy()
        return petsc_of(total, total.shape, self.comm)

    @property
    def stiffness_without_stress(self) -> Any:
        """K, which is constant."""
        return self.K

    def dampings(self) -> list[tuple[float, Any]]:
        """Of damping forms: none."""
        return []

    def csr(self) -> Any:
        """K as a SciPy matrix."""
        import scipy.sparse as sp

        start, cols, values = self.K.getValuesCSR()
        return sp.csr_matrix((values, cols, start), shape=self.K.size)

    def mass(self, A: Array) -> Array:
        """M A, (n, 1) -> (n, 1), or for many vectors side by side."""
        return product(self.M, A[:, 0], self._work)[:, None] if A.shape[1] == 1 else product(self.M, A, self._work)

    def tangent(self, u: Array) -> Array:
        """K u with all droppers taut, (n,) or columns (n, k)."""
        return product(self.K, u, self._work)

    def damping(self, v: Array) -> Array:
        """Of a damping form: none."""
        return np.zeros_like(v)

    def tension(self, u: Array) -> tuple[Array, Array]:
        """Tensions (N) of the droppers and what they would be if all could push."""
        full = self.stiff * (self.B @ u + self.offset)
        return np.where(self.one_sided, np.maximum(full, 0.0), full), full

    def internal(self, u: Array) -> Array:
        """K u + B^T (N - k B u)."""
        N, _ = self.tension(u)
        return self.tangent(u) + self.B.T @ (N - self.stiff * (self.B @ u))

    def energy(self, u: Array) -> float:
        """Of wires, supports and droppers, J."""
        N, _ = self.tension(u)
        linear = 0.5 * float(u @ self.tangent(u)) - 0.5 * float((self.stiff * (self.B @ u) ** 2).sum())
        return linear + 0.5 * float((N**2 / np.maximum(self.stiff, 1e-300)).sum())

    def total(self, x: Array) -> Array:
        """The value itself: every rank holds all wires."""
        return x

    def combination(self, cm: float, ck: float, cd: float = 0.0) -> Any:
        """cm M + ck K (cd: a damping form of its own, which wires have not); the caller destroys it."""
        from petsc4py import PETSc

        E = self.K.copy()
        E.scale(ck)
        E.axpy(cm, self.M, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        return E

    def free_factors(self) -> None:
        """Free the factors."""
        for taut in self.factors.values():
            taut.factor.destroy()
        self.factors.clear()

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.free_factors()
        for x in (self.M, self.K, *self._work):
            x.destroy()
