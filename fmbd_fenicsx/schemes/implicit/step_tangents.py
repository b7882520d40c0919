"""Tangents of the equations of an implicit step (:mod:`.step_equations`), with dense matrices or by sparse patterns.

Both keep what the step needs of the mass matrix W that was taken last: its inverse, and the normal directions U = W^-1 G^T.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import cache, partial
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ...errors import LinearSolveError
from ...linear.condensation import StepSolver
from ...linear.implicit.pencil import Pencil
from ...linear.implicit.sparse_pencil import SparsePencil
from ...linear.implicit.whole_pencil import WholeStructure
from ...linear.residual import Judge
from ...matrices import dense
from ...mechanics.forces.force_elements import ScalarLoads
from ...rotations import Array
from ...system.compiled.declarations import constants
from ...system.compiled.states.points import Metric
from ...system.compiled.states.stage_patterns import StageStructure
from ...system.compiled.states.stages import StageRoom
from ...system.compiled.tables.bodies.told import is_told
from ...system.evaluation_batch import EvaluationBatch
from ...system.layout import State
from ...system.serialisation import Memory, Remembering, plain
from ...system.sparsity import Pattern
from ...system.system import System
from ...system.tangents.linearise import at_once, differences
from ...system.tangents.step_tangent import StepTangent
from ...system.tangents.stiff_ties import StiffTies
from ..dae import Form

(TURNED,) = constants("implicit/tangent.c", "TURNED")  # rad and m, of differences of rates
Lower = Callable[[EvaluationBatch], Array]  # the lower rows of many states


class DenseTangents(Remembering):
    """With dense matrices: small systems, any form, stiff ties."""

    keeps: ClassVar = dict.fromkeys(("U", "U_ties", "inverse_mass"), plain())

    def __init__(self, system: System, form: Form, stiff: StiffTies) -> None:
        self.system, self.form, self.stiff = system, form, stiff
        self.U: Array = np.zeros((system.n_v, system.n_lam))
        self.U_ties: Array = np.zeros((system.n_v, len(stiff)))
        self.inverse_mass: Array = np.zeros((0, 0))
        self._full: Pattern | None = None

    def weigh(self, M: Any) -> None:
        """Take a mass matrix."""
        self.inverse_mass = np.linalg.inv(dense(M))

    def direct(self, G: Any) -> None:
        """Take directions of constraints."""
        self.U = self.inverse_mass @ dense(G).T

    def directions(self) -> Array:
        """U as a matrix."""
        return self.U

    def normally(self, mult: Array) -> Array:
        """U times multipliers (k, n_lam), (k, n_v)."""
        return mult @ self.U.T

    def metric(self) -> Metric:
        """The inverse of the mass matrix by its pattern and data."""
        n = self.system.n_v
        if self._full is None:
            self._full = Pattern.of((n, n), np.repeat(np.arange(n), n), np.tile(np.arange(n), n))
        return self._full, self.inverse_mass.ravel()

    def matrix(self) -> Array:
        """The inverse of the mass matrix as a matrix."""
        return self.inverse_mass

    def inverse(self) -> sp.csr_matrix:
        """The same, sparse."""
        return sp.csr_matrix(self.inverse_mass)

    def take(self, state: State, mult: Array, solver: StepSolver, lower: Lower) -> StepTangent:
        """The tangent at a state with multipliers (n_mult,), whose lower rows are a function; ``solver``: tells masses."""
        form, n, m, v = self.form, self.system.n_v, self.system.n_lam, state.v
        ev = self.system.at(state.t, state.q, v)
        M = solver.masses(ev)
        self.weigh(M)
        G = dense(ev.jacobian.core)
        if not form.frozen:
            self.direct(G)

        function = at_once(self.stiff.system, state.t, lower)
        with ExitStack() as laws:
            for loads in self.stiff.system.forces:
                if isinstance(loads, ScalarLoads):
                    laws.enter_context(loads.straight(ev.kin, state.t))
            by_q, by_v = differences(self.system, function, (state.q, v, state.a))
        # known exactly: M, and G on the level of each row
        by_a = np.zeros_like(by_v)
        by_a[:n] = dense(M)
        for i, level in enumerate(form.levels):
            rows = slice(n + i * m, n + (i + 1) * m)
            if level == 0:
                by_q[rows], by_v[rows] = G, 0.0
            elif level == 1:
                by_v[rows] = G
            else:
                by_a[rows] = G

        R = np.zeros((0, n))
        if ties := len(self.stiff):
            R = dense(self.stiff.system.at(ev.t, ev.q, v).jacobian.core)[self.stiff.ties]
            self.U_ties = self.inverse_mass @ R.T
            by_q[-ties:], by_v[-ties:] = self.stiff.stiffness[:, None] * R, self.stiff.damping[:, None] * R
        return StepTangent(self._turning(np.zeros(n), v)[0], dense(M), G, self.U, by_q, by_v, by_a, R, np.zeros((0, 2)))

    def _turning(self, xi: Array, v: Array) -> tuple[Array, Array]:
        """d rate(xi, v) / d xi by differences, and the matrix T with v = T rate(xi, v)."""
        s = self.system
        eye = np.eye(s.n_v)
        if s.motions.dim == 2 or not s.n_frames:
            return np.zeros_like(eye), eye
        # rotations in space: xi' depends on xi
        J = (s.rate(xi + TURNED * eye, v) - s.rate(xi - TURNED * eye, v)).T / (2 * TURNED)
        return J, np.asarray(np.linalg.inv(s.rate(xi, eye).T))

    def at_increments(self, made: StepTangent, xi: Array, v: Array) -> StepTangent:
        """The tangent that was taken at q_0 o exp(xi), in the coordinates about q_0."""
        J, T = self._turning(xi, v)
        return replace(made, J=J, by_q=made.by_q @ T)

    def together(self, tangents: list[StepTangent]) -> tuple[WholeStructure, list[StepTangent]]:
        """Where the matrix of stages with a tangent each has entries, and these tangents as data of patterns: of all that is not
        zero.
        """
        patterns = {}
        for name, first in vars(tangents[0]).items():
            seen = np.any([getattr(x, name) != 0.0 for x in tangents], axis=0)
            patterns[name] = Pattern(first.shape, *np.nonzero(seen))
        entries = [
            StepTangent(**{name: patterns[name].taken(matrix) for name, matrix in vars(x).items()}) for x in tangents
        ]
        return WholeStructure(patterns, len(tangents)), entries

    def pulls(self, efforts: Array) -> Array:
        """Accelerations that efforts of ties (k, p) cause, (k, n_v)."""
        return efforts @ self.U_ties.T

    def of_ties(self, tangent: StepTangent, v: Array) -> Array:
        """R v of velocities (k, n_v), (k, p)."""
        return v @ tangent.R.T

    def inertia(self, tangent: StepTangent, a: Array) -> Array:
        """M a."""
        return tangent.M @ a

    def pencil(self, tangent: StepTangent, s: Array, judge: Judge, *, redundant: int, points: int = 1) -> Pencil:
        """Solver of the stages for the frequencies s, (p,)."""
        return Pencil(tangent, s, judge, redundant)


class SparseTangents(Remembering):
    """By the patterns of a structure, solved in compiled code: derivatives and factors take work in proportion to its entries."""

    keeps: ClassVar = dict.fromkeys(("U", "R", "weighed", "masses", "inverse_mass"), plain())

    def __init__(self, system: System, structure: StageStructure, stiff: StiffTies) -> None:
        self.system, self.structure, self.stiff = system, structure, stiff
        self.U: Array = np.zeros(len(structure.normal.pattern))
        self.R: Array = np.zeros(len(structure.ties.rows))
        self.weighed = False
        self.told = any(map(is_told, system.parts))  # whether Python tells masses that change
        self.room = _rooms(structure)
        self._whole = dict[int, WholeStructure]()  # of so many stages

    def remember(self, m: Memory) -> None:
        """With the slopes of laws that the tangent has, by which iterates are judged."""
        super().remember(m)
        for i, items in enumerate(self.structure.states.tables.sources):
            for name in ("stiffness", "damping", "known"):
                if items.law is not None and name in items.arrays:
                    items.arrays[name][:] = m(f"{name} {i}", items.arrays[name])

    @property
    def masses(self) -> Array:
        """Data of M where derivatives were taken last."""
        return self.structure.masses

    @masses.setter
    def masses(self, data: Array) -> None:
        self.structure.masses[:] = data

    @property
    def inverse_mass(self) -> Array:
        """Data of its inverse."""
        return self.structure.inverse

    @inverse_mass.setter
    def inverse_mass(self, data: Array) -> None:
        self.structure.inverse[:] = data

    def weigh(self, M: Any) -> None:
        """Take a mass matrix."""
        self.structure.weigh(self.structure.couplings.masses.taken(M))
        self.weighed = True

    def direct(self, G: Any) -> None:
        """Take directions of constraints, which the step keeps."""
        structure = self.structure
        structure.frozen[:] = structure.directions(structure.couplings.rows.taken(G))
        self.U = structure.frozen

    def take_directions(self, tangent: StepTangent) -> None:
        """Those of a tangent, where a step does not keep its own."""
        self.R = tangent.R
        self.U = self.structure.frozen if self.structure.keeps_directions else tangent.U

    def directions(self) -> Array:
        """U as a matrix."""
        return np.asarray(dense(self.structure.normal.pattern.matrix(self.U)))

    def weigh_once(self, solver: StepSolver, state: State) -> None:
        """Take the masses of a state, unless compiled code has them: those of rigid bodies stay, and it finds those of modes."""
        if not self.weighed or self.told:
            self.weigh(solver.masses(self.system.at(state.t, state.q, state.v)))

    def normally(self, mult: Array) -> Array:
        """U times multipliers (k, n_lam), (k, n_v)."""
        return self.structure.normal.pattern.times(self.U, mult)

    def pulls(self, efforts: Array) -> Array:
        """Accelerations that efforts of ties (k, p) cause, (k, n_v)."""
        R = self.structure.ties.rows.matrix(self.R)
        return np.asarray((self.inverse() @ (R.T @ efforts.T)).T)

    def of_ties(self, tangent: StepTangent, v: Array) -> Array:
        """R v of velocities (k, n_v), (k, p)."""
        return self.structure.ties.rows.times(tangent.R, v)

    def metric(self) -> Metric:
        """The inverse of the mass matrix by its pattern and data."""
        return self.structure.couplings.masses, self.inverse_mass

    def matrix(self) -> Array:
        """The inverse of the mass matrix as a matrix."""
        return dense(self.inverse())

    def inverse(self) -> sp.csr_matrix:
        """The same, sparse."""
        pattern, data = self.metric()
        return pattern.matrix(data)

    def take(self, state: State, mult: Array, solver: StepSolver, lower: Lower) -> StepTangent:
        """The tangent at a state with multipliers (n_mult,), in one call; ``solver``: tells masses."""
        self.weigh_once(solver, state)
        made = self.structure.tangent(state, mult)
        if made is None:
            # which may say what is wrong
            lower(self.stiff.system.batch(*(np.array([x]) for x in (state.t, state.q, state.v))))
            raise LinearSolveError("the tangent of a step is not finite.")
        self.take_directions(made)
        return made

    def at_increments(self, made: StepTangent, xi: Array, v: Array) -> StepTangent:
        """The tangent that was taken at q_0 o exp(xi), in the coordinates about q_0."""
        structure = self.structure
        J, T = structure.turning(xi, v)
        return replace(made, J=J, by_q=structure.turned.data(made.by_q, T))

    def together(self, tangents: list[StepTangent]) -> tuple[WholeStructure, list[StepTangent]]:
        """As :meth:`DenseTangents.together`, with patterns found once."""
        stages = len(tangents)
        if stages not in self._whole:
            self._whole[stages] = WholeStructure(self.structure.patterns, stages)
        return self._whole[stages], tangents

    def inertia(self, tangent: StepTangent, a: Array) -> Array:
        """M a."""
        return self.structure.couplings.masses.times(tangent.M, a[None])[0]

    def pencil(self, tangent: StepTangent, s: Array, judge: Judge, *, redundant: int, points: int = 1) -> SparsePencil:
        """Solver of so many stages for the frequencies s, (p,)."""
        return SparsePencil.factored(tangent, s, judge, self.room(len(s), points), redundant=redundant)


def _rooms(structure: StageStructure) -> Callable[[int, int], StageRoom]:
    """Where points of implicit steps are solved for, one for each number of frequencies and of points."""
    return cache(partial(StageRoom, structure))


class RestingTangents:
    """Of whole steps in compiled code where parts rest on the ground, in frames that only the driver's tables have."""

    def __init__(self, system: System, structure: StageStructure) -> None:
        self.system, self.structure = system, structure
        self.room = _rooms(structure)
        self._moves = structure.states.twin.velocities(np.ones(system.n_v)) > 0.0

    def weigh_once(self, solver: StepSolver, state: State) -> None:
        """Take the masses of a state; those of frames at rest are one."""
        M = np.eye(len(self._moves))
        M[np.ix_(self._moves, self._moves)] = dense(solver.masses(self.system.at(state.t, state.q, state.v)))
        self.structure.weigh(self.structure.couplings.masses.taken(M))
