"""What couples elastic fields to the core in one configuration: S of equation (1) of :mod:`.condensation`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..matrices import dense
from ..rotations import Array
from ..system.evaluation import Evaluation
from ..system.layout import Layout
from .blocks.field_blocks import FactoredField, Weights
from .border import Border


@dataclass(frozen=True, eq=False)
class FieldCoupling:
    """The rows of S of one field, (inertia columns + used ports, n_core + n_lam), by its few columns that are not zero.

    ``on``: their numbers (k,), each once; ``entries``: (.., k).
    """

    on: np.ndarray
    entries: Array

    def times(self, x: Array) -> Array:
        """S x of a vector or of columns."""
        return np.asarray(self.entries @ x[self.on])

    def pass_on(self, seen: Array, to: Array) -> None:
        """Take S^T seen off a vector or columns."""
        to[self.on] -= self.entries.T @ seen

    def numbered(self, number: np.ndarray) -> FieldCoupling:
        """With the columns that have other numbers (all,); -1: left out."""
        on = number[self.on]
        return FieldCoupling(on[on >= 0], self.entries[:, on >= 0])

    def part(self, first: int, end: int) -> Array:
        """The columns from ``first`` up to ``end``, zeros too."""
        here = (self.on >= first) & (self.on < end)
        out = np.zeros((len(self.entries), end - first))
        out[:, self.on[here] - first] = self.entries[:, here]
        return out


@dataclass(frozen=True, eq=False)
class FieldCouplings:
    """The fields of a state: their ``blocks``, the rotations T of the factors in these (None of those that do not turn), and S as
    ``couplings``; ``jacobian`` is G, ``border`` that of force elements on them.
    """

    system: Layout
    jacobian: Any
    weights: Weights
    blocks: list[FactoredField]
    corotations: list[Any]
    border: Border
    couplings: list[FieldCoupling]

    @classmethod
    def of(
        cls, ev: Evaluation, weights: Weights, blocks: list[FactoredField], corotations: list[Any], border: Border
    ) -> FieldCouplings:
        """Those of a state."""
        port = ev.jacobian.port
        port = port.tocsc() if sp.issparse(port) else port
        pairs = enumerate(zip(blocks, corotations, strict=True))
        couplings = [_coupling(ev, i, weights.cm, block, T, port) for i, (block, T) in pairs]
        return cls(ev.system, ev.jacobian, weights, blocks, corotations, border, couplings)

    def with_border(self, direct: Any) -> tuple[list[FieldCoupling], list[FieldCoupling]]:
        """S of all fields with the rows ``direct`` of constraints and those of the border: as their balance sees the core, and as
        the core sees it.
        """
        n, every = self.system.n_core, np.arange(self.system.n_core + self.system.n_lam)
        held = np.append(every[:n], every[n:][direct])
        own = self.couplings
        if len(held) < len(every):
            number = np.full(len(every), -1)
            number[held] = np.arange(len(held))
            own = [S.numbered(number) for S in own]
        if not self.border.count:
            return own, own
        pairs = [self._bordered(i, S, len(held)) for i, S in enumerate(own)]
        return [S for S, _ in pairs], [R for _, R in pairs]

    def _bordered(self, i: int, S: FieldCoupling, first: int) -> tuple[FieldCoupling, FieldCoupling]:
        """S of field i with the rows of the border, from number ``first`` on: as its balance sees them, and as others see it."""
        used = self.blocks[i].used
        sides = self.border.on_ports(self.system.fields[i][0], used)
        met = np.flatnonzero(np.any([x.any(axis=0) for x in sides], axis=0))
        inertia, on = np.zeros((len(S.entries) - len(used), len(met))), np.append(S.on, first + met)
        left, right = (np.concatenate((inertia, _turned_ports(self.corotations[i], x[:, met]))) for x in sides)
        return FieldCoupling(on, np.append(S.entries, left, axis=1)), FieldCoupling(
            on, np.append(S.entries, right, axis=1)
        )


def _coupling(ev: Evaluation, i: int, cm: float, block: FactoredField, T: Any, port: Any) -> FieldCoupling:
    """S of field i; ``port``: rows of constraints on the ports of all parts."""
    s = ev.system
    k, f = s.fields[i]
    c, d = f.inertia_columns.shape[1], s.motions.dim
    ports = s.port_slice(k).start + block.used
    joints = port[:, ports]
    own = np.unique(joints.indices) if sp.issparse(joints) else np.flatnonzero(joints.any(axis=1))
    rows = s.frame_rows[k] if f.shared_columns else range(0)
    held = np.union1d(own, np.arange(rows.start, rows.stop)).astype(int)

    on = np.append(f.frame * c + np.arange(c), s.n_core + held)
    S = np.zeros((c + len(block.used), len(on)))
    if c:  # the twist of its frame: translations in world axes, rotations in body axes
        S[:d, :d] = cm * ev.rotation[f.frame].T
        S[d:c, d:c] = cm * np.eye(c - d)
    if f.shared_columns:
        first = c + int(np.searchsorted(held, rows.start))
        S[:c, first : first + c] = np.eye(c)
    S[c:, c:] = dense(joints[held]).T
    S[c:] = _turned_ports(T, S[c:])
    return FieldCoupling(on, S)


def _turned_ports(T: Any, rows: Array) -> Array:
    """Rows (used ports, columns) of a field in the axes of its factor."""
    if T is None or not len(rows):
        return rows
    points = rows.reshape(len(rows) // len(T), len(T), rows.shape[1])  # there may be no columns
    return np.asarray((T.T @ points).reshape(rows.shape))
