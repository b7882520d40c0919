"""Factors and constant columns of all elastic fields of a scene, kept from one configuration to the next.

With H = [Q, ports] the constant columns of a field and E = cm M + cd D + ck K its matrix, Y = E^-1 H and W = H^T Y are computed
once for a ratio cm : ck (equation (1) of :mod:`fmbd_fenicsx.linear.condensation`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...matrices import thin
from ...mechanics.placements import DistributedPart
from ...rotations import Array
from ...system.system import System
from ..border import loaded_ports
from ..options import check_options
from ..residual import LARGEST_GROWTH
from .incompressibility import VolumeMass
from .spd import CholeskyFactor, FieldFactor, MassInverse


@dataclass(frozen=True)
class Weights:
    """The step's matrix is cm M + cd C + ck K; cd and ck are complex for motions of complex frequencies."""

    cm: float
    cd: Any
    ck: Any

    @property
    def real(self) -> bool:
        """Whether all are real."""
        return not isinstance(self.ck, complex)


@dataclass(frozen=True)
class FieldMatrix:
    """What makes the matrix of a field: coefficients of M, of an own damping form and of K, the number of its tangent."""

    cm: float
    cd: float
    ck: float
    tangent: int

    @classmethod
    def of(cls, part: DistributedPart, w: Weights) -> FieldMatrix:
        """The matrix of a part in a step; Rayleigh damping is part of cm and ck."""
        field, forms = part.field, part.field.forms
        cm = w.cm + w.cd * forms.mass_damping
        ck = w.ck
        damped = field.D is not None

        if field.rest_damping is not None:  # by a matrix of its own, see combination
            damped |= forms.stiffness_damping > 0
        else:
            ck += w.cd * forms.stiffness_damping

        tangent = part.tangent_version if ck or field.keeps_volume or part.heavier is not None else 0
        return cls(cm, w.cd if damped else 0.0, ck, tangent)


@dataclass
class FactoredField:
    """Factor and constant columns of one field for one ratio cm : ck."""

    factor: Any
    used: np.ndarray  # port numbers that have a column
    Y: Array  # (n d, k + len(used)), k columns of inertia
    W: Array
    matrix: FieldMatrix
    in_use: Any = 0  # of the part, when they were made

    def seen_by(self, R: Array, S: Array) -> Array:
        """R^T W S. Rows of a tie take few ports each: W is symmetric, so that each factor meets it from the left."""
        left = thin(R.T)
        right = left if R is S else thin(S.T)
        return np.asarray(left @ np.asarray(right @ self.W).T)


class FieldBlocks:
    """The blocks of all fields of a system; collective.

    ``linear``: how they are solved, an object of :mod:`fmbd_fenicsx.solvers` (None: Cholesky factors). PETSc's options of a
    body's block are those under ``<prefix><body>.u_``. ``kept``: sets of blocks that stay when a new one is made; schemes
    with variable steps keep more than one.
    """

    def __init__(self, system: System, linear: Any, prefix: str) -> None:
        self.system, self.linear, self.prefix = system, linear, prefix
        self.kept = 1
        self.stepping: Weights | None = None  # those of :meth:`beside`
        self.factorisations = 0
        self.other_solves = 0  # of factors that have been freed, or are held elsewhere
        self.methods: dict[str, str] = {}  # by what the block of a body was solved last, in words
        self._columns: dict[int, tuple[Any, Array]] = {}  # of each part, and what they are made for
        self._growths: dict[int, tuple[int, float]] = {}  # of each part with its tangent, of :meth:`hides_masses`
        self._sets: dict[tuple[Any, ...], list[FactoredField]] = {}

    # -- counts -------------------------------------------------------------------------------------------------
    @property
    def _live(self) -> list[FieldFactor]:
        """Each factor once; sets may share some."""
        return list({id(b.factor): b.factor for blocks in self._sets.values() for b in blocks}.values())

    @property
    def back_solves(self) -> int:
        """Right-hand sides solved so far."""
        return sum(f.judge.solves for f in self._live) + self.other_solves

    @property
    def iterations(self) -> int:
        """Iterations of conjugate gradients inside all live blocks; 0 for factors."""
        return sum(f.iterations for f in self._live)

    @property
    def worst_residual(self) -> float:
        """Largest relative residual of a solve with a live block."""
        return max((f.judge.worst for f in self._live), default=0.0)

    def versions(self, t: float) -> list[tuple[Any, Any]]:
        """Tangents and columns of all fields at a time (s): new ones where a matrix made of them is no longer that of a state."""
        return [(f.tangent_version, f.column_version(t)) for _, f in self.system.fields]

    def hides_masses(self, w: Weights) -> bool:
        """Whether stiffness in the matrix of a field in a moving frame hides the inertia of its rigid motions, so that a factor
        would be refused; it takes none. Collective.

        A rigid motion x has E x = M x with |E| |x| / |M x| = c_k |K| |x| / |M x|, which the judge of solutions limits.
        """
        if self.linear is not None:
            return False
        moved = [(k, part) for k, part in self.system.fields if part.inertia_columns.shape[1]]
        return any(abs(FieldMatrix.of(part, w).ck) * self._growth(k, part) > LARGEST_GROWTH for k, part in moved)

    def _growth(self, k: int, part: DistributedPart) -> float:
        """|K| |x| / |M x|, the largest of all rigid motions x of part k."""
        known = self._growths.get(k)
        if known is None or known[0] != part.tangent_version:
            from petsc4py import PETSc

            f, d = part.field, part.field.dim
            far, pushed = f.total((f.X * f.X).sum(axis=0)), f.total((f.Q * f.Q).sum(axis=0))
            turned = far.sum() - far if d == 3 else far.sum(keepdims=True)
            moved = np.concatenate((np.full(d, f.n_global / d), turned))
            norm = f.stiffness_matrix.norm(PETSc.NormType.NORM_INFINITY)
            self._growths[k] = known = part.tangent_version, float(norm * np.sqrt((moved / pushed).max()))
        return known[1]

    # -- set-up -------------------------------------------------------------------------------------------------
    def used_last(self, blocks: list[FactoredField]) -> bool:
        """Whether these are the blocks that were asked for last."""
        return next(reversed(self._sets.values()), None) is blocks

    def of(self, G: Any, w: Weights, *, ties_apart: bool, splits: bool) -> list[FactoredField]:
        """Blocks for the weights of a step, earlier ones where nothing of theirs has changed.

        ``G`` is the constraint Jacobian, whose ports need columns. ``ties_apart``: the rows of surface ties are not
        eliminated, so their ports need none. ``splits``: PETSc's options are checked elsewhere.
        """
        key = tuple((FieldMatrix.of(f, w), f.column_version(G.t)) for _, f in self.system.fields)
        if key in self._sets:
            blocks = self._sets.pop(key)
        else:
            blocks = [self._block(i, G, w, ties_apart) for i in range(len(self.system.fields))]
            # sets with the same factors and earlier columns are of no more use
            matrices = [matrix for matrix, _ in key]
            self._sets = {k: x for k, x in self._sets.items() if [matrix for matrix, _ in k] != matrices}
            self.drop(keep=self.kept, live=[b.factor for b in blocks])
            if self.linear is not None and w.ck and not splits:
                check_options(self.prefix, self.system.comm)

        self._sets[key] = blocks  # those used last are dropped last
        return blocks

    def beside(self, G: Any, w: Weights) -> list[FactoredField]:
        """:meth:`of` for a scheme whose steps have another matrix than what is solved between them: both are kept."""
        self.kept, self.stepping = max(self.kept, 2), w
        return self.of(G, w, ties_apart=False, splits=False)

    def _block(self, i: int, G: Any, w: Weights, ties_apart: bool) -> FactoredField:
        """Factor of field i, an earlier one where its matrix is the same, and its columns."""
        k, part = self.system.fields[i]
        matrix = FieldMatrix.of(part, w)
        earlier = [blocks[i] for blocks in self._sets.values() if blocks[i].matrix == matrix]
        factor = earlier[-1].factor if earlier else self._factor(part, matrix)
        if not earlier and part.heavier is not None:
            from .low_rank import LowRankFactor

            V, C = part.heavier
            factor = LowRankFactor(factor, V, matrix.cm * C, part.field.total)
        if not earlier and matrix.ck != 0:
            self.factorisations += factor.fresh
            self.methods[part.name] = factor.how

        used = self._used_ports(k, part, G, ties_apart)
        H = self._constant_columns(k, part, used, G.t)
        Y = factor.solve_columns(H)
        W = part.field.total(np.asarray(thin(H.T) @ Y))
        return FactoredField(factor, used, Y, 0.5 * (W + W.T), matrix, part.in_use)

    def _constant_columns(self, k: int, part: DistributedPart, used: np.ndarray, t: float) -> Array:
        """H of part k at a time (s), made again where other ports are used or columns have changed."""
        version = used.tolist(), part.column_version(t)
        known = self._columns.get(k)
        if known is None or known[0] != version:
            H = np.concatenate((part.inertia_columns, part.port_columns(used, t)), axis=1)
            self._columns[k] = known = version, H
        return known[1]

    def _used_ports(self, k: int, part: DistributedPart, G: Any, ties_apart: bool) -> np.ndarray:
        """Numbers of the ports of a part that constraints or force elements act on."""
        ports = self.system.port_slice(k)
        active = G.active(ports) | loaded_ports(self.system)[ports]
        if ties_apart:
            of_ties = sum(B.shape[0] for B in part.traces)
            active[part.n_port - of_ties :] = False

        first = part.n_frame_rows
        if part.shared_columns:
            active[:first] = False  # the same columns as those of inertia

        # Whole vectors b_k: a corotated factor sees them rotated, so it needs every component.
        if part.weights is None:
            points = active[first:].reshape(-1, self.system.motions.dim)
            points[:] = points.any(axis=1)[:, None]
        return np.flatnonzero(active)

    def _factor(self, part: DistributedPart, matrix: FieldMatrix) -> FieldFactor:
        """A new factor; without stiffness (starts) of the mass alone."""
        field, (cm, cd, ck) = part.field, (matrix.cm, matrix.cd, matrix.ck)
        if ck == 0:
            return VolumeMass(field, cm) if field.keeps_volume else MassInverse(field, cm)
        if isinstance(ck, complex):
            from .complex_factor import ComplexFactor

            return ComplexFactor(field, complex(cm), ck, complex(cd), part.slack)
        if part.slack is not None:
            from .low_rank import SlackFactor

            return SlackFactor(field, cm, ck, part.slack)
        if self.linear is not None:
            factor: FieldFactor = self.linear.block(field, (cm, cd, ck), f"{self.prefix}{part.name}.u_")
            return factor
        return CholeskyFactor(field, cm, ck, cd, turns=part.frame == self.system.n_frames)

    # -- end ----------------------------------------------------------------------------------------------------
    def keep(self, sets: int) -> None:
        """Let so many sets stay from now on."""
        self.kept = sets
        self.drop(keep=sets, live=[])

    def drop(self, keep: int, live: list[FieldFactor]) -> None:
        """Free all but the newest ``keep`` sets of factors, and those still ``live``."""
        while len(self._sets) > keep:
            old = self._sets.pop(next(iter(self._sets)))
            in_use = {id(f) for f in (*live, *self._live)}
            for factor in (b.factor for b in old if id(b.factor) not in in_use):
                self.other_solves += factor.judge.solves
                factor.destroy()

    def destroy(self) -> None:
        """Free all factors."""
        self.drop(keep=0, live=[])
        for _, part in self.system.fields:
            part.free_factors()
