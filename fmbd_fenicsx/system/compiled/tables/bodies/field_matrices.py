"""Matrices of a field by rows of nodes, for the driver: those that stay, and the newest of those that change with the tangent.

All tables of a system share them: C only reads them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from .....kernel_cache import address_of
from .....rotations import Array
from ..structures import Store, structure


class NodeBlocks:
    """A matrix of PETSc, n x n, by rows of nodes with d x d blocks."""

    def __init__(self, A: Any, d: int) -> None:
        start, columns, values = A.getValuesCSR()
        # numbers of the entries, those that the matrix lacks are the last: zero
        blocks = sp.csr_matrix((1 + np.arange(len(values)), columns, start)).tobsr((d, d))
        self.start, self.column = blocks.indptr.astype(np.int32), blocks.indices.astype(np.int32)
        self._places = blocks.data - 1
        self.block: Array = np.append(values, 0.0)[self._places]

    def follow(self, A: Any, factor: float = 1.0) -> None:
        """Take the values of another matrix with the same places."""
        self.block[:] = np.append(A.getValuesCSR()[2], 0.0)[self._places]
        if factor != 1.0:
            self.block *= factor


class FieldMatrices:
    """Those of the field of part k by nodes with d numbers; ``cache``: of the system."""

    def __init__(self, cache: dict[Any, Any], part: Any, k: int, d: int) -> None:
        self.part, self.field, self._cache, self._key, self._dim = part, part.field, cache, k, d
        self._slack: np.ndarray = np.zeros(0, np.int32)

    def of_nodes(self) -> dict[str, np.ndarray]:
        """M and K without stress by rows of nodes."""
        cache, key = self._cache, ("rows of nodes", self._key)
        if key not in cache:
            field = self.field
            K = NodeBlocks(field.stiffness_without_stress, self._dim)
            made = {"K_start": K.start, "K_column": K.column, "K": K.block}
            cache[key] = made if self.part.weights is not None else made | _by_rows("M", field.M.copy())
        found: dict[str, np.ndarray] = cache[key]
        return found

    def of_numbers(self, store: Store, factor: Any) -> dict[str, int]:
        """Mass and weight of numbers that are no places, and springs between them, as members of the structure Field."""
        part, field, d = self.part, self.field, self._dim
        if part.weights is None:
            return {}
        blocks = NodeBlocks(field.M, d)
        store.kept.append(blocks)
        self._slack, slack = store.array(np.zeros(len(field.stiff)), np.int32)
        self.take_slack(factor)
        droppers = structure("Droppers", d)(
            count=len(field.stiff), start=store.integers(field.B.indptr), on=store.integers(field.B.indices), slack=slack,
            one_sided=store.integers(field.one_sided), row=store.address(field.B.data), stiffness=store.address(field.stiff),
            offset=store.address(field.offset),
        )  # fmt: skip
        masses = store.structure(node_matrix(blocks, d))
        return {"masses": masses, "weight": store.address(part.weights), "droppers": store.structure(droppers)}

    def take_slack(self, factor: Any) -> None:
        """Springs that a factor leaves out."""
        if self.part.slack is not None and factor is not None:
            self._slack[:] = 0
            self._slack[factor.slack] = 1

    def tangent(self) -> Array:
        """The stiffness of the newest tangent like K of :meth:`of_nodes`."""
        field = self.field
        if not field.extended:
            return self.of_nodes()["K"]
        return self._newest("tangent", [(1.0, field.stiffness_matrix)])[0].block

    def dampings(self) -> list[NodeBlocks]:
        """What stands beside M and the tangent in the matrices of factors, times its factors."""
        return self._newest("dampings", self.field.dampings())

    def _newest(self, name: str, matrices: list[tuple[float, Any]]) -> list[NodeBlocks]:
        """Matrices times their factors, taken again after new tangents."""
        cache, key, field = self._cache, ("newest", name, self._key), self.field
        if key not in cache:
            cache[key] = [-1, [NodeBlocks(A, self._dim) for _, A in matrices]]
        known = cache[key]
        if known[0] != field.tangents:
            known[0] = field.tangents
            for made, (factor, A) in zip(known[1], matrices, strict=True):
                made.follow(A, factor)
        return known[1]  # type: ignore[no-any-return]

    def of_pressure(self) -> dict[str, np.ndarray]:
        """B of the newest tangent and C by rows."""
        field, cache, key = self.field, self._cache, ("rows of the pressure", self._key)
        if key not in cache:
            made = _by_rows("B", field.coupling_matrix()) | _by_rows("C", field.compliance_matrix())
            cache[key] = [field.tangents, made]
        known = cache[key]
        if known[0] != field.tangents:
            known[0], known[1]["B"][:] = field.tangents, _by_rows("B", field.coupling_matrix())["B"]
        return known[1]  # type: ignore[no-any-return]


def _by_rows(name: str, matrix: Any) -> dict[str, np.ndarray]:
    """A matrix of PETSc, which is destroyed, by its rows as C's structures name them."""
    start, columns, values = (x.copy() for x in matrix.getValuesCSR())
    matrix.destroy()
    return {f"{name}_start": start.astype(np.int32), f"{name}_column": columns.astype(np.int32), name: values}


def node_matrix(blocks: NodeBlocks, dim: int) -> Any:
    """The structure NodeMatrix of blocks that are kept."""
    arrays = {"start": blocks.start, "column": blocks.column, "block": blocks.block}
    return structure("NodeMatrix", dim)(**{name: address_of(x) for name, x in arrays.items()})
