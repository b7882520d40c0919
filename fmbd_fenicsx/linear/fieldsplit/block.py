"""The split of one elastic body."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...rotations import Array
from ..blocks.elastic import Elastic
from ..blocks.spd import FieldFactor
from ..residual import Judge
from ..rigid_modes import elastic_matrix
from .layout import split_name


class SplitBlock(FieldFactor):
    """E~^-1 of one body for (2) of :mod:`.solver`: the PC of its split, also used for the constant columns of ports.

    Collective throughout.
    """

    def __init__(self, block: Elastic, elastic: Any, prefix: str, cd: float) -> None:
        from petsc4py import PETSc

        self.field = block.body
        # counts; the whole solve is what is judged
        self.judge = Judge(f'the elastic block of body "{block.body.name}"')
        self.E = elastic_matrix(block.body, block.cm, block.ck, cd)

        self.ksp = PETSc.KSP().create(block.body.comm)
        self.ksp.setOptionsPrefix(prefix)
        self.ksp.setOperators(self.E)
        elastic.set_up(self.ksp, block)
        self.ksp.setFromOptions()
        self.ksp.setUp()

    def product(self, u: Array) -> Array:
        """E u, in the axes of the factor."""
        x, y = self.E.createVecs()
        x.array[:] = u
        self.E.mult(x, y)
        found = y.array.copy()
        x.destroy(), y.destroy()
        return found

    def solve_columns(self, B: Array) -> Array:
        """E~^-1 B for dense columns (n, k)."""
        X = np.empty_like(B)
        x, b = self.E.createVecs()
        for j in range(B.shape[1]):
            b.array[:] = B[:, j]
            self.ksp.solve(b, x)
            X[:, j] = x.array
            self.judge.solves += 1
        x.destroy(), b.destroy()
        return X

    def destroy(self) -> None:
        """Free the solver; collective."""
        self.ksp.destroy(), self.E.destroy()


def split_prefix(prefix: str, body: str) -> str:
    """Prefix of a body's split from that of its block, ``<scene>_<body>.u_``."""
    return f"{prefix.removesuffix(f'{body}.u_')}fieldsplit_{split_name(body)}_"
