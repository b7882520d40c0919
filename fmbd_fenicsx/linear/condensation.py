"""The solver of a constrained step: elastic blocks by their own factors, the rest by a Schur complement on the core.

With E = cm M + ck K of a field, H = [Q, ports] its constant columns and S(q) the small matrix that couples them to the core
unknowns x = (frames, multipliers), the step's system and its solution are

    [ E      H S ] [ dU ]   [ b_u ]        z = E^-1 b_u,   (A - S^T W S) x = b_x - S^T H^T z,   dU = z - Y S x
    [ S^T H^T  A ] [ x  ] = [ b_x ]        Y = E^-1 H,     W = H^T Y                                            (1)

Springs and other force elements on surfaces of fields are further rows, see :mod:`.border`. E is factored, Y and W are
computed once for a ratio cm : ck. One step costs one back-solve per iteration. A nonlinear
absolute body turns: with its mean rotation T, E is T E_0 T^T to the order of the strain, ports turn alike, and the factor of
E_0 serves all attitudes; new tangents are taken only when Newton's rate asks for them (:meth:`StepSolver.refresh`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError, LinearSolveError, require
from ..matrices import dense
from ..mechanics.placements import Approach
from ..rotations import Array
from ..system.evaluation import Evaluation
from ..system.evaluator import Evaluator
from ..system.system import System
from ..system.tangents.force_tangent import force_tangent
from .blocks.field_blocks import FactoredField, FieldBlocks, Weights
from .blocks.incompressibility import move_pressures, volume_gaps, volume_push
from .border import Border
from .configuration_warnings import CLOSE, NearSingular, dependent_rows
from .core import ADVICE, TIE_LIMIT, CoreSolver
from .core_matrix import core_matrix
from .driver_solver import DriverSolver, driver_solver
from .field_couplings import FieldCouplings
from .prepared import Condensed, CoreAlone, Prepared, TiesIterated, Whole
from .residual import Judge


@dataclass(frozen=True, eq=False)
class MatrixConfiguration:
    """What the matrices depend on; velocities only where they weigh damping or stiffness. ``reactions``: those in it;
    ``versions``: of tangents, columns.
    """

    t: float
    q: Array
    v: Any
    weights: Weights
    reactions: int
    versions: list[tuple[int, int]]

    def equals(self, other: MatrixConfiguration) -> bool:
        """Whether the matrices are the same to the last bit."""
        plain = [(x.t, x.weights, x.reactions, x.versions) for x in (self, other)]
        return plain[0] == plain[1] and all(
            x is y or np.array_equal(x, y) for x, y in ((self.q, other.q), (self.v, other.v))
        )


class StepSolver:
    """Solves cm M + cd C + ck K with the constraints of a system; one object for a whole run; collective.

    After :meth:`prepare`, for each field of the configuration: ``blocks`` and ``corotations`` (the rotation T of its factor, or
    None).
    """

    prepared: Prepared  # for the matrix prepared last, where that is not the driver's

    def __init__(self, system: System, *, linear: Any = None, prefix: str = "fmbd_", place: int = 0) -> None:
        """``linear``: how elastic blocks are solved, an object of :mod:`fmbd_fenicsx.solvers` (None: Cholesky factors). PETSc's
        options of the block of a body are those under ``<prefix><body>.u_``. ``place``: where compiled code keeps complex
        matrices of fields; solvers at one place take turns.
        """
        self.system, self.linear, self.prefix, self.place = system, linear, prefix, place
        self._look = True
        self.near_singular, self._masses = NearSingular(), None
        self._held: MatrixConfiguration | None = None  # that of the matrices
        self._pushed = False  # forces have tangents in them
        self._driver: tuple[Evaluator | None, DriverSolver | None] = None, None
        self.core = CoreSolver(Judge("the core of the system"))
        self.elastic = FieldBlocks(system, linear, prefix)
        self.blocks: list[FactoredField] = []
        self.weights = Weights(1.0, 0.0, 0.0)  # of the matrix prepared last, of that of a start before any
        self.split: Any = None if linear is None else linear.split(system, prefix)
        self.iterated = self._iterated_ties()

    def _iterated_ties(self) -> Any:
        """What iterates on the multipliers of surface ties where they are many; None where the dense core takes them."""
        count = sum(span.stop - span.start for _, span in self.system.traces)
        limit = TIE_LIMIT if self.linear is None else self.linear.limit
        if count <= limit:
            return None

        multiplier = None if self.linear is None else self.linear.multiplier
        if multiplier is None:
            raise InputError(
                f"The surface ties have {count} multipliers; the direct solver takes up to {limit}. "
                "Use solve(..., linear=fmbd.Schur()), or coarser multiplier spaces."
            )
        from .iterated_multipliers import IteratedMultipliers

        return IteratedMultipliers(self.system, multiplier, self.linear.rtol)

    @property
    def driver(self) -> DriverSolver | None:
        """Who solves in compiled code, where that evaluates the system; None where NumPy has to."""
        evaluator, solver = self._driver
        if evaluator is not self.system.evaluator:
            solver = driver_solver(self.system, self.core, self.elastic if self.eliminates else None, self.place)
            self._driver = self.system.evaluator, solver
        return solver

    @property
    def eliminates(self) -> bool:
        """Whether fields are eliminated by factors of their own and the rest is solved directly: nothing is iterated on."""
        return self.split is None and self.iterated is None

    # -- counts -------------------------------------------------------------------------------------------------
    @property
    def counters(self) -> dict[str, float]:
        """Work so far: factors of elastic blocks and right-hand sides solved with these, iterations of conjugate gradients inside
        of them, on multipliers of surface ties and on whole matrices (:mod:`.fieldsplit.solver`), 0 where it is solved directly.
        """
        return {
            "factorisations": self.elastic.factorisations,
            "back_solves": self.elastic.back_solves,
            "elastic_iterations": self.elastic.iterations,
            "tie_iterations": 0 if self.iterated is None else int(self.iterated.iterations),
            "saddle_iterations": 0 if self.split is None else int(self.split.iterations),
            "core_factorisations": self.core.factorisations,
            "worst_linear_residual": self.worst_residual,
        }

    @property
    def worst_residual(self) -> float:
        """Largest relative residual of any accepted solve."""
        whole = 0.0 if self.split is None else self.split.judge.worst
        return max(self.core.judge.worst, whole, self.elastic.worst_residual)

    # -- set-up -------------------------------------------------------------------------------------------------
    def prepare(self, ev: Evaluation, weights: Weights, *, keep: bool = False, apart: bool = False) -> None:
        """Set up (1) for a configuration; elastic factors are kept from earlier calls with the same weights.

        ``keep``: the matrix stays until :meth:`refresh` takes a new one; the driver's, which it may refuse to make again, only
        with compliances of contacts. ``apart``: no contact takes part; else solutions correct no moments, as compliances do not.
        """
        if self._driver_prepares(ev, weights, keep=keep, apart=apart):
            return
        s = self.system
        masses_alone = not s.fields and not (weights.cd or weights.ck)
        if (keep and self._held is not None) or (masses_alone and self.holds(ev, weights)):
            return
        self.weights, self._held = weights, None

        self.look_for_dependent_rows(ev)
        # rows that turn out to depend are the driver's too
        if self.core.redundant and self._driver_prepares(ev, weights, keep=keep, apart=apart):
            return
        try:
            self.prepared = self._prepared(ev)
        except LinearSolveError as error:
            if error.motion is None:
                raise
            moving = s.body_of(int(np.argmax(np.abs(error.motion))))
            raise LinearSolveError(
                f'Body "{moving}" has a motion without mass that no joint holds (t = {ev.t:g} s). {ADVICE}'
            ) from error
        self._held = self._configuration(ev, weights)
        if s.n_lam and (self.core.ratio < 1e-5 or self.near_singular.now):
            self.near_singular.look(ev, self.core.rank, evens=False)

    def prepare_once(self, ev: Evaluation, weights: Weights) -> None:
        """As :meth:`prepare`, unless the matrix is there."""
        if not self.holds(ev, weights):
            self.prepare(ev, weights)

    def _driver_prepares(self, ev: Evaluation, weights: Weights, *, keep: bool, apart: bool) -> bool:
        """Whether the matrix is the driver's, which makes it where it is not there to be kept."""
        driver, contacts = self.driver, self.system.contacts is not None
        turned = contacts or any([part.field.carried for _, part in self.system.fields])  # for whom turns solutions
        if driver is None:
            return False
        if keep and contacts and driver.ready:
            return True
        if not driver.prepare(ev, weights, sways=apart or not contacts):
            return False
        self.weights = weights
        self._look, self._held, self.blocks = False, None, driver.blocks
        self.core.factorisations += driver.new_factors()
        self.corotations = self._turned(ev) if turned else []
        return True

    def look_for_dependent_rows(self, ev: Evaluation) -> None:
        """How many constraint rows depend on others, unless that is known; collective.

        A solver whose start was found by another one has prepared nothing when schemes ask it.
        """
        if self._look:
            dependent, self.core.redundant = dependent_rows(ev)
            self.core.rank = self.system.n_lam - dependent if dependent else None
        self._look = False

    def note_lost_gaps(self, ev: Evaluation) -> None:
        """Gaps of roundoff were all that an iteration could close: say so where the position is close to a singular one."""
        if not self.core.uncounted:
            self.near_singular.look(ev, self.core.rank, limit=CLOSE)

    def holds(self, ev: Evaluation, weights: Weights) -> bool:
        """Whether :meth:`prepare` would make the matrices again that are there; collective."""
        driver = self.driver
        if driver is not None and driver.ready:
            return driver.holds(ev, weights)
        same = self._held is not None and self._held.equals(self._configuration(ev, weights))

        # each rank sees its own nodes only
        fields = self.system.fields
        return not fields[0][1].field.total(np.array(float(not same))) if fields else same

    def _configuration(self, ev: Evaluation, weights: Weights) -> MatrixConfiguration:
        versions = self.elastic.versions(ev.t)
        moving = None if ev.v is None or not (weights.cd or weights.ck) else ev.v.copy()
        return MatrixConfiguration(ev.t, ev.q.copy(), moving, weights, ev.reactions, versions)

    def _prepared(self, ev: Evaluation) -> Prepared:
        """The matrices of (1), and the factor of the core."""
        s, w = self.system, self.weights
        A, border = self._core_with_forces(ev)
        if not s.fields:
            self.core.factor(A, ev.jacobian.core)
            return CoreAlone(s, self.core)

        self.corotations = self._turned(ev)
        ties_apart = self.iterated is not None or self.whole
        self.blocks = self.elastic.of(ev.jacobian, w, ties_apart=ties_apart, splits=self.split is not None)
        fields = FieldCouplings.of(ev, w, self.blocks, self.corotations, border)

        if self.whole:
            self._refuse_redundant()
            self.split.prepare(fields, dense(A).copy())
            return Whole(border, self.split.solve)
        if self.iterated is not None:
            A = dense(A).copy()
            self.iterated.prepare(ev, w, A)
            nothing = [None] * len(self.blocks)
            return TiesIterated(Condensed(fields, self.core, A, self.iterated.direct, nothing), self.iterated)
        corrected = w.ck and s.contacts is None
        momenta = [f.missing_momentum(s.local_q(ev.q, k)) if corrected else None for k, f in s.fields]
        return Condensed(fields, self.core, A, slice(None), momenta)

    def _turned(self, ev: Evaluation) -> list[Any]:
        """Rotations of the factors of fields at a configuration, None for those that do not turn."""
        return [f.corotation(self.system.local_q(ev.q, k)) for k, f in self.system.fields]

    def _core_with_forces(self, ev: Evaluation) -> tuple[Any, Border]:
        """A of (1) with the tangents of force elements, and the border of those on fields."""
        s, w = self.system, self.weights
        A = core_matrix(ev, w)
        has_tangent = (s.forces or s.elements or ev.reactions) and (w.cd or w.ck)
        applied = force_tangent(ev, w.cd, w.ck) if has_tangent else None
        # cheap tangents of rigid bodies are renewed by the schemes
        self._pushed = applied is not None and bool(s.fields)
        if applied is not None and applied.core is not None:
            A = A + applied.core
        return A, Border.of(s, applied, ev.t)

    @property
    def whole(self) -> bool:
        """Whether the matrix of the configuration is solved as a whole; without stiffness (starts) it is eliminated."""
        return self.split is not None and self.weights.ck != 0

    def _refuse_redundant(self) -> None:
        """Dependent rows leave multipliers of minimum norm to the dense core."""
        require(
            not self.core.redundant,
            "FieldSplit() needs constraints that do not depend on each other; scene.check() lists those of this scene that do. "
            "Take one of them away, or use linear=fmbd.Direct().",
        )

    def masses(self, ev: Evaluation) -> Any:
        """M of the core, not to be written into: of rigid bodies it is made once."""
        if self.system.parts:
            return core_matrix(ev, Weights(1.0, 0.0, 0.0))
        if self._masses is None:
            self._masses = core_matrix(ev, Weights(1.0, 0.0, 0.0))
        return self._masses

    # -- solution -----------------------------------------------------------------------------------------------
    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """Increment like v and multiplier increment (n_lam,) for right-hand sides b (like v) and c (n_lam,), complex ones too."""
        driver = self.driver
        if driver is not None and driver.ready:
            return driver.solve(b, c)
        if b.dtype.kind == "c" and self.weights.real:
            (x, y), (u, w) = self.solve(b.real, c.real), self.solve(b.imag, c.imag)
            return x + 1j * u, y + 1j * w
        return self.prepared.solve(b, c)

    def closing(self, C: Array) -> Array:
        """Motions (n_v, k) that open the constraints by the columns C (n_lam, k) and are least in the metric of the matrix."""
        driver = self.driver
        if driver is not None and driver.ready:
            return driver.closing(C)
        return self.prepared.closing(C)

    def step(self, ev: Evaluation, b: Array, c: Array) -> tuple[Array, Array]:
        """As :meth:`solve`, for an increment of Newton's iteration from a state: the pressures that bodies carry move along.

        Collective.
        """
        gaps = volume_gaps(ev)
        dq, dlam = self.solve(b - volume_push(self, gaps) if gaps else b, c)
        move_pressures(self, dq, gaps)
        return dq, dlam

    @property
    def pressures(self) -> list[Array]:
        """Pressures that bodies carry as unknowns, to be kept and put back."""
        return [f.field.pressure_values for _, f in self.system.fields if f.field.carried]  # type: ignore[attr-defined]

    @pressures.setter
    def pressures(self, values: list[Array]) -> None:
        fields = [f.field for _, f in self.system.fields if f.field.carried]
        for field, p in zip(fields, values, strict=True):
            field.pressure_values = p  # type: ignore[attr-defined]

    def refresh(
        self, ev: Evaluation, increment: Array | None = None, *, predicted: bool = False, apart: bool = False
    ) -> bool:
        """New tangents of nonlinear parts and forces, and rows, at a state; False when all are constant. Collective.

        ``increment``: Newton's, like v, that led there, where stresses are to be those that it foretold, or the motion that is
        ``predicted`` for a step. ``apart``: as for :meth:`prepare`.
        """
        s, known = self.system, {}
        if increment is not None:
            known = {k: Approach(s.local_v(increment, k), predicted) for k, _ in s.fields}
        changed = ev.take_tangents(increments=self._exact(known))
        if changed or self._pushed:
            self.prepare(ev, self.weights, apart=apart)
        return changed or self._pushed

    def renew_fields(self, ev: Evaluation, increments: Mapping[int, Approach]) -> list[FactoredField]:
        """Blocks with new tangents of all fields at a state, for a matrix that someone else makes; ``increments``: by part."""
        ev.take_tangents(increments=self._exact(increments))
        self._held = None
        self.blocks = self.elastic.of(ev.jacobian, self.weights, ties_apart=False, splits=False)
        return self.blocks

    def _exact(self, increments: Mapping[int, Approach]) -> dict[int, Approach]:
        """Increments of fields whose factors are exact enough for stresses to be foretold."""
        parts = zip(self.system.fields, self.blocks, strict=True)
        return {k: increments[k] for (k, _), b in parts if k in increments and not b.factor.noisy}

    def destroy(self) -> None:
        """Free all factors; collective."""
        if self.split is not None:
            self.split.destroy()
        self.elastic.destroy()
