"""The compliance of contact points: how gaps answer to contact forces in one step (the Delassus matrix).

    W = N A^-1 N^T,     A the step's matrix with its constraints                                            (1)

For elastic bodies the dual multipliers meet their own nodes only, so W needs the inverse of the elastic block on the
contact nodes alone, C_s = I_s^T E^-1 I_s. Its columns are solved once, when a node first comes near, and kept as long
as the factor of E; directions, active sets and rotations change small dense products only. With the columns Y of
:mod:`fmbd_fenicsx.linear.condensation` the coupling of the nodes to frames, joints and frame conditions is

    X = core^-1 (N_core^T - S^T Y_s^T N_s^T),   W = N_core X + N_s (C_s N_s^T - Y_s S X).                   (2)
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from scipy.spatial import cKDTree

from ...errors import require
from ...mechanics.contact.contact_set import ContactSet
from ...mechanics.contact.nodal_rows import NodalRows
from ...mechanics.contact.rows import LinearRows
from ...rotations import Array
from ...system.serialisation import Remembering, plain, worker
from ..condensation import StepSolver
from ..prepared import Condensed
from .delassus_matrix_free import MANY, Applied, SlaveBlocks

CHUNK = 64  # columns solved together
HELD = 2e7  # numbers of columns on all of a body that are held: 160 MB, of which known ones take memory
PRODUCTS = 3e3  # operations of a problem by products for each unknown: measured


class Compliance(Remembering):
    """W for rows of a contact set; columns of C_s are kept from step to step. Methods are collective.

    A checkpoint holds which columns are known (they are solved again when they are needed), and counts.
    """

    keeps: ClassVar = {"_together": plain(), "columns": plain(), "blocks": worker}

    def __init__(self, solver: StepSolver, contacts: ContactSet) -> None:
        self.solver, self.contacts = solver, contacts
        self._kept: dict[int, tuple[Any, Array, np.ndarray]] = {}  # trace -> factor, C_s, known columns
        self._held: dict[int, Array] = {}
        self._together: dict[int, list[np.ndarray]] = {}  # which of them were solved together: roundoff depends on it
        self._surface: dict[int, tuple[Any, Array]] = {}
        self.columns = 0
        self.blocks = SlaveBlocks(solver, contacts)

    def of(self, rows: LinearRows, trace: np.ndarray, scale: float) -> Any:
        """s W for the rows of points, d' after each other, whose multipliers the given traces (m,) carry: a matrix, or an
        :class:`Applied` for many candidates on elastic surfaces.
        """
        elastic = bool((trace >= 0).all())
        if self.solver.iterated is not None:
            require(
                elastic, "Contact of rigid points beside ties with many multipliers is not offered: use coarser spaces."
            )
        if self.solver.whole:
            return scale * self._by_solves(rows)
        if elastic and (len(trace) > self.most or self.solver.iterated is not None):
            return Applied(self.blocks, rows, np.repeat(trace, rows.core.shape[0] // len(trace)), scale)
        return scale * self.matrix(rows)

    @property
    def most(self) -> int:
        """Candidates of which W is stored; those of more are an :class:`Applied`."""
        return MANY

    def most_stored(self, components: int) -> int:
        """Candidates with so many components of which compiled code stores W: its factor of W costs (m d)^3 there, the products
        of a problem as much as some thousand times the unknowns.
        """
        unknowns = sum(part.field.n_global for _, part in self.solver.system.fields)
        return min(self.most, int(np.cbrt(PRODUCTS * unknowns) / components))

    def matrix(self, rows: LinearRows) -> Array:
        """W, (m, m), for the configuration the solver was last prepared for."""
        system = self.solver.system
        m = rows.core.shape[0]

        # fields first: their own compliance C, and how their frames and ports see forces on the nodes
        local: dict[int, tuple[NodalRows, Array, Array]] = {}
        seen: list[Array] = [np.zeros((m, block.Y.shape[1])) for block in self.solver.blocks]
        for i, tr in self.contacts.on_fields.items():
            position = system.field_number(tr.part)
            block, turn = self.solver.blocks[position], self.solver.corotations[position]
            # the factor knows the body in the axes of its mean rotation
            N = rows.field[i].turned(turn)
            C, Y = self.on_surface(i, block, N.node)
            local[position] = N, C, Y
            if Y.size:
                seen[position] = N.columns(Y)

        # then the core, with all that fields pass on to it
        W: Array = np.zeros((m, m))
        acting = seen
        if rows.core.size or any(x.size for x in seen):
            X, acting = self._answers(rows.core, seen)
            W = rows.core @ X.T

        for position, (N, C, Y) in local.items():
            W = W + N.columns(N.columns(C).T - Y @ acting[position].T)
        # symmetric but for roundoff
        return 0.5 * (W + W.T)

    def on_surface(self, i: int, block: Any, nodes: np.ndarray) -> tuple[Array, Array]:
        """C_s (n d, n d) of a trace with at least the columns of ``nodes``, and Y (n d, k) on it, of the block of its field."""
        return self._columns(i, block.factor, nodes), self._rows_of_Y(i, block)

    def held(self, i: int) -> Array:
        """Columns of E^-1, (n d, unknowns of the field): those whose C_s are known; none, (0, unknowns), of large bodies."""
        return self._held[i]

    def _answers(self, core: Array, seen: list[Array]) -> tuple[Array, list[Array]]:
        """What the core does (m, n_core), and what acts on the columns of each field, S X of (2), under rows of forces on the
        core and on nodes of the fields, which the columns see as ``seen``.
        """
        solver, n, m = self.solver, self.solver.system.n_core, len(core)
        driver = solver.driver
        if driver is not None and driver.ready:
            return driver.answers(core, seen)
        prepared = solver.prepared
        if not isinstance(prepared, Condensed):  # no fields
            return self._core(np.concatenate((core.T, np.zeros((solver.system.n_lam, m)))))[:n].T, []
        rhs = np.zeros((n + solver.system.n_lam + prepared.fields.border.count, m))
        rhs[:n] = core.T
        for R, x in zip(prepared.back_couplings, seen, strict=True):
            R.pass_on(x.T, rhs)
        X = self._core(rhs)
        return X[:n].T, [S.times(X).T for S in prepared.couplings]

    def _by_solves(self, rows: LinearRows) -> Array:
        """W of (1), (m, m), by one solve of the step for each row: where the matrix is not eliminated block by block."""
        system = self.solver.system
        m = rows.core.shape[0]
        none = np.zeros(system.n_lam)
        W = np.zeros((m, m))

        for i in range(m):
            unit: Array = np.zeros(m)
            unit[i] = 1.0
            answer, _ = self.solver.solve(self.contacts.transposed(system, rows, unit), none)
            W[:, i] = self.contacts.times(system, rows, answer)
        self.columns += m
        return 0.5 * (W + W.T)

    def _core(self, rhs: Array) -> Array:
        n = self.solver.system.n_core
        if len(rhs) == 0 or not np.abs(rhs).any():
            return np.zeros_like(rhs)
        return np.concatenate(self.solver.core.solve_columns(rhs[:n], rhs[n:]))

    def _columns(self, i: int, factor: Any, nodes: np.ndarray) -> Array:
        """C_s with at least the columns of ``nodes`` of the trace."""
        tr = self.contacts.on_fields[i]
        size = tr.n * tr.dim
        kept = self._kept.get(i)
        if kept is None or kept[0] is not factor:
            again = self._together.get(i, []) if kept is None else []
            kept = (factor, np.zeros((size, size)), np.zeros(size, dtype=bool))
            self._kept[i], self._together[i] = kept, []
            unknowns = tr.field.n * tr.dim
            self._held[i] = np.zeros((0 if tr.field.mixed or size * unknowns > HELD else size, unknowns))
            for earlier in again:
                self._solve(i, earlier)
                self.columns -= len(earlier)
        unknown = ~kept[2][nodes * tr.dim]
        if np.logical_or.reduce(unknown):
            asked = np.unique(nodes[unknown])
            found = np.concatenate((asked, self._beside(i, asked)))
            self._solve(i, (np.sort(found)[:, None] * tr.dim + np.arange(tr.dim)).ravel())
        return kept[1]

    def _beside(self, i: int, asked: np.ndarray) -> np.ndarray:
        """Nodes to be solved with those that are ``asked`` for: the nearest unknown ones, as many as are known. A contact
        that moves on asks seldom then, and columns together cost less; of those solved half at most are not needed.
        """
        tr, known = self.contacts.on_fields[i], self._kept[i][2][:: self.contacts.on_fields[i].dim]
        others = np.flatnonzero(~known)
        others = others[~np.isin(others, asked)]
        count = min(int(known.sum()), CHUNK // tr.dim - len(asked), len(others))
        if count <= 0:
            return others[:0]
        away = cKDTree(tr.X[asked]).query(tr.X[others])[0]
        return others[np.argsort(away, kind="stable")[:count]]

    def _solve(self, i: int, missing: np.ndarray) -> None:
        """Further columns of C_s."""
        (factor, C, known), tr = self._kept[i], self.contacts.on_fields[i]
        for k in range(0, len(missing), CHUNK):
            part = missing[k : k + CHUNK]
            Z = factor.solve_columns(tr.unit_columns(part))
            if self._held[i].size:
                self._held[i][part] = Z.T
            C[:, part] = np.stack([tr.gather(Z[:, j]).ravel() for j in range(len(part))], axis=1)
            self.columns += len(part)
        known[missing] = True
        self._together[i].append(missing)

    def _rows_of_Y(self, i: int, block: Any) -> Array:
        """Rows of the constant columns Y at the contact nodes, (n d, k)."""
        kept = self._surface.get(i)
        if kept is None or kept[0] is not block:
            tr = self.contacts.on_fields[i]
            Y = block.Y
            rows = np.zeros((tr.n * tr.dim, Y.shape[1]))
            for j in range(Y.shape[1]):
                rows[:, j] = tr.gather(np.ascontiguousarray(Y[:, j])).ravel()
            kept = (block, rows)
            self._surface[i] = kept
        return kept[1]
