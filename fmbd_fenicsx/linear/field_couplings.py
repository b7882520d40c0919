"""What couples elastic fields to the core in one configuration: S of equation (1) of :mod:`.condensation`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..matrices import dense
from ..rotations import Array
from ..system.evaluation import Evaluation
from ..system.layout import Layout
from .blocks.field_blocks import FactoredField, Weights
from .border import Border


@dataclass(frozen=True, eq=False)
class FieldCouplings:
    """The fields of a state: their ``blocks``, the rotations T of the factors in these (None of those that do not turn), and S as
    ``couplings`` (inertia columns + used ports, n_core + n_lam); ``jacobian`` is G, ``border`` that of force elements on them.
    """

    system: Layout
    jacobian: Any
    weights: Weights
    blocks: list[FactoredField]
    corotations: list[Any]
    border: Border
    couplings: list[Array]

    @classmethod
    def of(
        cls, ev: Evaluation, weights: Weights, blocks: list[FactoredField], corotations: list[Any], border: Border
    ) -> FieldCouplings:
        """Those of a state."""
        couplings = [
            _coupling(ev, i, weights.cm, block, T) for i, (block, T) in enumerate(zip(blocks, corotations, strict=True))
        ]
        return cls(ev.system, ev.jacobian, weights, blocks, corotations, border, couplings)

    def with_border(self, direct: Any) -> tuple[list[Array], list[Array]]:
        """S of all fields with the rows ``direct`` of constraints and those of the border: as their balance sees the core, and as
        the core sees it.
        """
        n = self.system.n_core
        every = isinstance(direct, slice)  # copies for all of many bodies would take the square of their number
        own = self.couplings if every else [np.append(S[:, :n], S[:, n:][:, direct], axis=1) for S in self.couplings]
        if not self.border.count:
            return own, own
        pairs = [self._bordered(i, S) for i, S in enumerate(own)]
        return [S for S, _ in pairs], [R for _, R in pairs]

    def _bordered(self, i: int, S: Array) -> tuple[Array, Array]:
        """S of field i with the rows of the border, as its balance sees them and as the others see it."""
        used = self.blocks[i].used
        inertia = np.zeros((len(S) - len(used), self.border.count))
        sides = self.border.on_ports(self.system.fields[i][0], used)
        left, right = (np.concatenate((inertia, _turned_ports(self.corotations[i], x))) for x in sides)
        return np.concatenate((S, left), axis=1), np.concatenate((S, right), axis=1)


def _coupling(ev: Evaluation, i: int, cm: float, block: FactoredField, T: Any) -> Array:
    """S of field i."""
    s = ev.system
    k, f = s.fields[i]
    c, d = f.inertia_columns.shape[1], s.motions.dim
    S = np.zeros((c + len(block.used), s.n_core + s.n_lam))

    if c:  # the twist of its frame: translations in world axes, rotations in body axes
        at = f.frame * c
        S[:d, at : at + d] = cm * ev.rotation[f.frame].T
        S[d:c, at + d : at + c] = cm * np.eye(c - d)
    if f.shared_columns:
        rows = s.frame_rows[k]
        S[:c, s.n_core + rows.start : s.n_core + rows.stop] = np.eye(c)

    ports = s.port_slice(k).start + block.used
    S[c:, s.n_core :] = dense(ev.jacobian.port[:, ports]).T
    S[c:] = _turned_ports(T, S[c:])
    return S


def _turned_ports(T: Any, rows: Array) -> Array:
    """Rows (used ports, columns) of a field in the axes of its factor."""
    if T is None or not len(rows):
        return rows
    points = rows.reshape(len(rows) // len(T), len(T), rows.shape[1])  # there may be no columns
    return np.asarray((T.T @ points).reshape(rows.shape))
