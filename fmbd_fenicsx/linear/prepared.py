"""Ways to solve the system of a step, prepared for one configuration: by the core alone, by fields condensed onto it, with ties
iterated around these, or as a whole. Equation (1) is that of :mod:`.condensation`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ..matrices import dense
from ..rotations import Array, rotate_nodal
from ..system.layout import Layout
from ..system.system import System
from ..system.tangents.foreshortened_ports import tangent_ports
from .border import Border
from .core import CoreSolver
from .field_couplings import FieldCouplings

if TYPE_CHECKING:
    from .iterated_multipliers import IteratedMultipliers


MANY, FEW = 500, 0.1  # size of a core, and share of its entries, from which on and below which its factor is sparse


class Prepared:
    """A matrix that can be solved with; collective."""

    system: Layout

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """Increment like v and multipliers for right-hand sides b (like v) and c."""
        raise NotImplementedError

    def closing(self, C: Array) -> Array:
        """Motions (n_v, k) that open the constraints by the columns C (n_lam, k) and are least in the metric of the matrix."""
        nothing = np.zeros(self.system.n_v)
        return np.stack([self.solve(nothing, c)[0] for c in C.T], axis=1)


class CoreAlone(Prepared):
    """Of systems without fields."""

    def __init__(self, system: System, core: CoreSolver) -> None:
        self.system, self.core = system, core

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """As :meth:`Prepared.solve`."""
        return self.core.solve(b, c)


class Condensed(Prepared):
    """Fields are eliminated with their factors: for each the ``couplings`` S as its balance sees the core, and ``back_couplings``
    as the core sees it.
    """

    def __init__(self, fields: FieldCouplings, core: CoreSolver, A: Any, direct: Any, momenta: list[Any]) -> None:
        """``A``: of the core; ``direct``: the constraint rows that it holds; ``momenta``: of each field what its constant columns
        leave out of the moments of inertia, None where that is not corrected.
        """
        self.fields, self.core, self.momenta, self.system = fields, core, momenta, fields.system
        self.couplings, self.back_couplings = fields.with_border(direct)
        self._factor(A, fields.jacobian.core[direct])

    def _factor(self, A: Any, joints: Any) -> None:
        """Factor A - S^T W S of (1), with the constraint rows held by the core and the rows of the border."""
        n, border = self.system.n_core, self.fields.border
        # each field sees few rows of the core
        sides = zip(self.fields.blocks, self.couplings, self.back_couplings, strict=True)
        seen = [(S.on, -block.seen_by(R.entries, S.entries)) for block, S, R in sides]

        size = n + joints.shape[0] + border.count
        whole: Any = (_dense if size <= MANY else _sparse)(A, joints, border.on_core(), seen)
        if sp.issparse(whole) and whole.nnz >= FEW * size**2:
            whole = whole.toarray()
        self.core.factor(whole[:n, :n], whole[n:, :n], whole[n:, n:], whole[:n, n:])

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """As :meth:`Prepared.solve`; c of the rows that the core holds."""
        return self._solve(b, c)

    def closing(self, C: Array) -> Array:
        """As :meth:`Prepared.closing`, all columns together."""
        return self._solve(None, C)[0]

    def _solve(self, b: Array | None, c: Array) -> tuple[Array, Array]:
        """The same. No b: zero; c may be columns then."""
        s, blocks, turns = self.system, self.fields.blocks, self.fields.corotations
        n, columns = s.n_core, c.shape[1:]
        core = self.core.solve_columns if columns else self.core.solve

        # z = E^-1 b of each field, and what is left for the core
        first = np.zeros((n, *columns)) if b is None else b[:n]
        rhs = np.concatenate((first, c, np.zeros((self.fields.border.count, *columns))))
        zs: list[Any] = [0.0] * len(blocks)
        if b is not None:
            local = [rotate_nodal(s.local_v(b, k), T, back=True) for (k, _), T in zip(s.fields, turns, strict=True)]
            zs = [block.factor.solve(x) for block, x in zip(blocks, local, strict=True)]
            for S, seen in zip(self.back_couplings, self._projected(zs), strict=True):
                S.pass_on(seen, rhs)
        x = np.concatenate(core(rhs[:n], rhs[n:]))
        parts = [z - block.Y @ S.times(x) for S, block, z in zip(self.couplings, blocks, zs, strict=True)]

        # Moments that the constant columns of inertia leave out: a second solve with the core's factor, no back-solve.
        moments = self._moments_left_out(parts)
        if moments is not None:
            more = np.concatenate(core(moments, np.zeros((len(x) - n, *columns))))
            x += more
            for part, S, block in zip(parts, self.couplings, blocks, strict=True):
                part -= block.Y @ S.times(more)

        local = [rotate_nodal(part, T) for part, T in zip(parts, turns, strict=True)]
        return np.concatenate([x[:n], *local]), x[n : n + len(c)]

    def _projected(self, zs: list[Array]) -> list[Array]:
        """H^T z of each field."""
        s, fields = self.system, [f for _, f in self.system.fields]
        ports = tangent_ports(s, zs, self.fields.jacobian.t)
        apart = [None if f.shared_columns else f.inertia_columns.T @ z for f, z in zip(fields, zs, strict=True)]

        projected = []
        for f, block, p, moments in zip(fields, self.fields.blocks, ports, s.field_sums(apart), strict=True):
            rows = p[: f.n_frame_rows] if f.shared_columns else moments
            projected.append(np.concatenate((rows, p[block.used])))
        return projected

    def _moments_left_out(self, increments: list[Array]) -> Array | None:
        """Moments, (n_core, ..), that increments dU of fields have about their frames by M (e x U): -cm (M U) x dU.

        Without them a light axis of a slender body slows Newton's iteration. None where there are none.
        """
        if all(MU is None for MU in self.momenta):
            return None
        s, m = self.system, self.system.motions
        out: Array = np.zeros((s.n_core, *increments[0].shape[1:]), np.result_type(*increments))
        shares = [None if MU is None else MU @ dU for MU, dU in zip(self.momenta, increments, strict=True)]
        for (_, f), moment in zip(s.fields, s.field_sums(shares), strict=True):
            if moment is not None:
                at = f.frame * m.n_twist
                out[at + m.dim : at + m.n_twist] -= self.fields.weights.cm * moment
        return out


def _dense(A: Any, joints: Any, border: tuple[Array, Array], seen: list[tuple[np.ndarray, Array]]) -> Array:
    """[A, G^T, L; G, 0, 0; R^T, 0, -1] with a ``border`` L, R^T and what the core sees of fields added: entries on the same rows
    and columns.
    """
    joints, (left, right) = dense(joints), border
    lower, upper = np.concatenate((joints, right)), np.concatenate((joints.T, left), axis=1)
    C = np.diag(np.repeat((0.0, -1.0), (len(joints), len(right))))
    whole = np.block([[dense(A), upper], [lower, C]])
    whole = whole.astype(np.result_type(whole, *(x for _, x in seen)), copy=False)
    for on, entries in seen:
        whole[on[:, None], on] += entries
    return whole


def _sparse(A: Any, joints: Any, border: tuple[Array, Array], seen: list[tuple[np.ndarray, Array]]) -> Any:
    """The same of many rows."""
    A, joints, left, right = map(sp.csr_array, (A, joints, *border))
    none = sp.csr_array((joints.shape[0], right.shape[0]))
    held = sp.csr_array((joints.shape[0],) * 2), none, none.T, -sp.eye_array(right.shape[0])
    whole = sp.block_array([[A, joints.T, left], [joints, *held[:2]], [right, *held[2:]]], format="csr")

    rows = np.concatenate([np.repeat(on, len(on)) for on, _ in seen])
    columns = np.concatenate([np.tile(on, len(on)) for on, _ in seen])
    entries = np.concatenate([x.ravel() for _, x in seen])
    total = whole + sp.csr_array((entries, (rows, columns)), shape=whole.shape)
    total.eliminate_zeros()
    return total


class TiesIterated(Prepared):
    """Fields are condensed with few rows of constraints, and the many of surface ties iterated on."""

    def __init__(self, condensed: Condensed, ties: IteratedMultipliers) -> None:
        self.condensed, self.ties, self.system = condensed, ties, condensed.system

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """As :meth:`Prepared.solve`."""
        return self.ties.solve(self.condensed.solve, b, c)


class Whole(Prepared):
    """The matrix is solved as it stands, by its blocks (:mod:`.fieldsplit.solver`), and force elements on fields around it: (1)
    of :mod:`.border` by Woodbury's formula, r further solves a configuration.

    ``solve(b, c)`` knows nothing of these, and gives an increment like v and multipliers; collective.
    """

    def __init__(self, border: Border, solve: Callable[[Array, Array], tuple[Array, Array]]) -> None:
        self.system, self.border, self.inner = border.system, border, solve
        none = np.zeros(border.system.n_lam)
        self.answers = [solve(border.forces(j), none) for j in range(border.count)]
        # 1 + R^T K^-1 L of Woodbury's formula
        small = np.array([border.seen(x) for x, _ in self.answers]).reshape(border.count, border.count).T
        self.small = np.eye(border.count) + small

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """As :meth:`Prepared.solve`."""
        x, lam = self.inner(b, c)
        if not self.answers:
            return x, lam
        y = np.linalg.solve(self.small, self.border.seen(x))
        for yj, (column, reaction) in zip(y, self.answers, strict=True):
            x, lam = x - yj * column, lam - yj * reaction
        return x, lam
