"""The matrix of an implicit step (:mod:`.pencil`) with sparse factors in compiled code: work grows with the length of a chain."""

from __future__ import annotations

import numpy as np

from ...errors import LinearSolveError
from ...rotations import Array
from ...system.compiled.states.stages import StageRoom
from ...system.tangents.step_tangent import StepTangent
from ..residual import Judge
from .pencil import OPEN_ROWS, SINGULAR_MATRIX


class SparsePencil:
    """As :class:`.Pencil` for frequencies s (p,); ``room``: of C, which the newest pencil has for itself."""

    def __init__(self, tangent: StepTangent, s: Array, judge: Judge, room: StageRoom) -> None:
        """``room``: with the factors."""
        self.t, self.s, self.judge, self.room = tangent, s, judge, room

    @classmethod
    def factored(cls, tangent: StepTangent, s: Array, judge: Judge, room: StageRoom, *, redundant: int) -> SparsePencil:
        """With factors of a tangent; ``redundant``: corrections of rows that depend on each other."""
        if not room.factor(tangent, s, redundant=redundant):
            raise LinearSolveError(f"{judge.what}: {SINGULAR_MATRIX}")
        return cls(tangent, s, judge, room)

    def solve(self, kin: Array, low: Array) -> tuple[Array, Array]:
        """Increments dxi, dv side by side (p, 2 n) and multipliers (p, levels m), for residuals r_kin (p, n) and r_low
        (p, n + levels m); of the first p frequencies.
        """
        change, mult, judged = self.room.solve(kin, low)
        shares = judged[:, 0] / np.where(judged[:, 1] > 0, judged[:, 1], 1.0)
        left, size = judged[int(shares.argmax())]
        self.judge.check(float(left), float(size), OPEN_ROWS, solves=len(kin))
        real = not self.s[: len(kin)].imag.any()
        return (change.real, mult.real) if real else (change, mult)
