"""Pressures that are unknowns in the stages of implicit schemes: each stage has its own, which move with Newton's increments.

With B, C of the tangent and r = dPi/dp of a stage (:mod:`~fmbd_fenicsx.fem.mixed`) the rows of the pressures are eliminated,

    balance(p) + B^T C^-1 r,        dp = C^-1 (B dxi + r)                                                          (1)

in every stage by itself: B and C are real and the same for all stages, so that (1) goes with any sum of them, complex ones too.
B of another strain leaves a share of (1) to the next increment (:mod:`.field_renewals`).
Where an iteration with the matrix P of another frequency leaves P e of the balance (:mod:`.stage_krylov`), pressures take their
share of it at once, dp = C^-1 B e with the weights of both: no motion would tell it, as that of a multiplier. Where no solution
is iterated on, compiled code does the same (``driver/implicit/field_stages.c``), in whole steps too.
Volumes are held on the level of positions, as by index 3: stages end with r = 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ...linear.condensation import StepSolver
from ...rotations import Array, rotate_nodal
from ...system.evaluation import Evaluation

Values = list[Array]  # of each field (n_pressure,)


class StagePressures:
    """Those of the ``fields`` of a system that carry some. Methods are collective."""

    def __init__(self, solver: StepSolver) -> None:
        self.system, self.solver = solver.system, solver
        self.fields: list[tuple[int, Any]] = [(k, part) for k, part in self.system.fields if part.field.carried]
        self.start: Values = solver.pressures  # of the step
        self._of_stages: list[Values] = []
        self._gaps: list[Values] = []
        self._turns: list[Any] = []  # of the bodies since their newest tangents, where derivatives are taken

    def begin(self, *, known: bool) -> None:
        """Begin a step; ``known``: from the state that the last one began with."""
        if known:
            self.solver.pressures = self.start
        else:
            self.start = self.solver.pressures
        self._of_stages = []

    @contextmanager
    def held(self, values: Values) -> Iterator[None]:
        """Fields with other pressures for a while."""
        before, self.solver.pressures = self.solver.pressures, values
        try:
            yield
        finally:
            self.solver.pressures = before

    def turn(self, ev: Evaluation) -> None:
        """Take notice of how bodies are turned where derivatives are taken."""
        self._turns = [part.corotation(ev.local(k)[0]) for k, part in self.fields]

    def stiffness(self, dxi: Array) -> Array:
        """B^T C^-1 B times motions (k, n_v)."""
        return np.array([self._push([self._rate(i, x) for i in range(len(self.fields))]) for x in dxi]).reshape(
            dxi.shape
        )

    def balances(self, evs: list[Evaluation], a: Array, lam: Array) -> tuple[Array, Array]:
        """The balances of stages, (k, n_v), and B^T C^-1 r of (1) in them; r is kept for :meth:`move`."""
        if len(self._of_stages) != len(evs):
            self._of_stages = [self.start] * len(evs)
        found, self._gaps = [], []
        for i, ev in enumerate(evs):
            with self.held(self._of_stages[i]):
                found.append(ev.balance(a[i], lam[i]))
                self._gaps.append([part.field.volume_gap(ev.local(k)[0]) for k, part in self.fields])
        pushes = np.array([self._push(gaps) for gaps in self._gaps])
        return np.array(found) + pushes, pushes

    def move(self, dxi: Array, relax: float) -> None:
        """Pressures of all stages after increments (k, n_v) of :meth:`balances`, which close so much of the gaps; the last one's
        are those of the fields.
        """
        for stage, gaps in enumerate(self._gaps):
            self.solver.pressures = self._of_stages[stage]
            for i, (_, part) in enumerate(self.fields):
                part.field.move_pressure(self._turned_back(i, dxi[stage]), relax * gaps[i])
            self._of_stages[stage] = self.solver.pressures

    def _push(self, gaps: Values) -> Array:
        """B^T C^-1 times gaps of the volumes, like v."""
        out = np.zeros(self.system.n_v)
        for (k, part), turn, gap in zip(self.fields, self._turns, gaps, strict=True):
            self.system.local_v(out, k)[:] = rotate_nodal(part.field.volume_push(gap), turn)
        return out

    def _rate(self, i: int, x: Array) -> Array:
        """B x of a field."""
        return np.asarray(self.fields[i][1].field.volume_rate(self._turned_back(i, x)))

    def _turned_back(self, i: int, x: Array) -> Array:
        """A motion, like v, of a field in the axes of its tangent."""
        return rotate_nodal(self.system.local_v(x, self.fields[i][0]), self._turns[i], back=True)
