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
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..errors import InputError, LinearSolveError, require
from ..mechanics.placements import DistributedPart
from ..rotations import Array, rotate_nodal
from ..system.evaluation import Evaluation
from ..system.evaluator import Evaluator
from ..system.system import System
from ..system.tangents.force_tangent import force_tangent
from ..system.tangents.foreshortened_ports import tangent_ports
from .blocks.field_blocks import FactoredField, FieldBlocks, Weights
from .blocks.incompressibility import move_pressures, volume_gaps, volume_push
from .border import AroundSolver, Border
from .configuration import MatrixConfiguration
from .configuration_warnings import CLOSE, NearSingular, mover, rows_depend
from .core import ADVICE, TIE_LIMIT, CoreSolver, dense
from .core_matrix import core_matrix
from .driver_solver import DriverSolver, driver_solver
from .residual import Judge

__all__ = ["StepSolver", "Weights"]


class StepSolver:
    """Solves cm M + cd C + ck K with the constraints of a system; one object for a whole run; collective.

    After :meth:`prepare`, for each field of the configuration: ``blocks``, ``corotations`` (the rotation T of its factor, or
    None), ``couplings`` S as its balance sees the core and ``back_couplings`` S as the core sees it; ``jacobian`` is G.
    """

    def __init__(self, system: System, *, linear: Any = None, prefix: str = "fmbd_") -> None:
        """``linear``: how elastic blocks are solved, an object of :mod:`fmbd_fenicsx.solvers` (None: Cholesky factors). PETSc's
        options of the block of a body are those under ``<prefix><body>.u_``.
        """
        self.system, self.linear, self.prefix = system, linear, prefix
        self._look = True
        self.near_singular, self._masses = NearSingular(), None
        self._held: MatrixConfiguration | None = None  # that of the matrices
        self._pushed = False  # forces have tangents in them
        self._driver: tuple[Evaluator | None, DriverSolver | None] = None, None
        self._apart = False  # nobody asks for the compliance of contacts in the matrix prepared last
        self.core = CoreSolver(Judge("the core of the system"))
        self.elastic = FieldBlocks(system, linear, prefix)
        self.blocks: list[FactoredField] = []
        self.weights = Weights(1.0, 0.0, 0.0)  # of the matrix prepared last, of that of a start before any
        self.split: Any = None if linear is None else linear.split(system, prefix)
        self.iterated = self._iterated_ties()
        self.direct: Any = slice(None) if self.iterated is None else self.iterated.direct

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
            solver = driver_solver(self.system, self.core, self.elastic if self.eliminates else None)
            self._driver = self.system.evaluator, solver
        return solver

    @property
    def eliminates(self) -> bool:
        """Whether fields are eliminated by factors of their own and the rest is solved directly: nothing is iterated on."""
        return self.split is None and self.iterated is None

    # -- counts -------------------------------------------------------------------------------------------------
    @property
    def factorisations(self) -> int:
        """Factorisations of elastic blocks so far."""
        return self.elastic.factorisations

    @property
    def back_solves(self) -> int:
        """Right-hand sides solved with elastic factors so far."""
        return self.elastic.back_solves

    @property
    def elastic_iterations(self) -> int:
        """Iterations of conjugate gradients inside all of them; 0 for factors."""
        return self.elastic.iterations

    @property
    def tie_iterations(self) -> int:
        """Iterations on the multipliers of surface ties; 0 where these are solved directly."""
        return 0 if self.iterated is None else int(self.iterated.iterations)

    @property
    def saddle_iterations(self) -> int:
        """Iterations on the whole matrix of a step, see :mod:`.fieldsplit.solver`; 0 where it is eliminated instead."""
        return 0 if self.split is None else int(self.split.iterations)

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
        s = self.system
        driver, self._apart = self.driver, apart
        if keep and s.contacts is not None and driver is not None and driver.ready:
            return
        if driver is not None and driver.prepare(ev, weights, sways=apart or s.contacts is None):
            self.weights = weights
            self._look, self._held, self.blocks = False, None, driver.blocks
            self.core.factorisations += driver.new_factors()
            self.corotations = self._turned(ev) if s.contacts is not None else []
            return
        masses_alone = not s.fields and not (weights.cd or weights.ck)
        if (keep and self._held is not None) or (masses_alone and self.holds(ev, weights)):
            return
        self.weights, self._held = weights, None

        self.look_for_dependent_rows(ev)
        try:
            self._assemble(ev)
        except LinearSolveError as error:
            if error.motion is None:
                raise
            raise LinearSolveError(
                f"{mover(s, error.motion)} has a motion without mass that no joint holds (t = {ev.t:g} s). {ADVICE}"
            ) from error
        self._held = self._configuration(ev, weights)
        if s.n_lam and (self.core.ratio < 1e-5 or self.near_singular.now):
            self.near_singular.look(ev, self.core.rank)

    def look_for_dependent_rows(self, ev: Evaluation) -> None:
        """Whether constraint rows depend on each other, unless that is known; collective.

        A solver whose start was found by another one has prepared nothing when schemes ask it.
        """
        if self._look:
            self.core.redundant = rows_depend(ev)
        self._look = False

    def note_lost_gaps(self, ev: Evaluation) -> None:
        """Gaps of roundoff were all that an iteration could close: say so where the position is close to a singular one."""
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
        return MatrixConfiguration(ev.t, ev.q.copy(), moving, weights, versions)

    def _assemble(self, ev: Evaluation) -> None:
        """The matrices of (1), and the factor of the core."""
        s, w = self.system, self.weights
        self.jacobian = ev.jacobian
        A = self._core_with_forces(ev)
        if not s.fields:
            self.core.factor(A, self.jacobian.core)
            return

        corrected = w.ck and self.iterated is None and s.contacts is None
        self.corotations = self._turned(ev)
        self._missing_momenta = [f.missing_momentum(s.local_q(ev.q, k)) if corrected else None for k, f in s.fields]
        ties_apart = self.iterated is not None or self.whole
        self.blocks = self.elastic.of(self.jacobian, w, ties_apart=ties_apart, splits=self.split is not None)

        A = A.toarray() if sp.issparse(A) else A.copy()
        if self.whole:
            self._refuse_redundant()
            self.split.prepare(self, A, [self._coupling(ev, i) for i in range(len(self.blocks))])
            self._around = AroundSolver(self.border, self.split.solve)
            return
        if self.iterated is not None:
            self.iterated.prepare(ev, w, A)
        self._condense(ev, A)

    def _turned(self, ev: Evaluation) -> list[Any]:
        """Rotations of the factors of fields at a configuration, None for those that do not turn."""
        return [f.corotation(self.system.local_q(ev.q, k)) for k, f in self.system.fields]

    def _core_with_forces(self, ev: Evaluation) -> Any:
        """A of (1) with the tangents of force elements; those on fields become the border."""
        s, w = self.system, self.weights
        A = core_matrix(ev, w)
        has_tangent = (s.forces or s.elements) and (w.cd or w.ck)
        applied = force_tangent(ev, w.cd, w.ck) if has_tangent else None
        # cheap tangents of rigid bodies are renewed by the schemes
        self._pushed = applied is not None and bool(s.fields)
        self.border = Border.of(s, applied, ev.t)

        if applied is not None and applied.core is not None:
            A = A + applied.core
        return A

    def _condense(self, ev: Evaluation, A: Array) -> None:
        """Factor A - S^T W S of (1), with the constraint rows held by the core and the rows of the border."""
        n = self.system.n_core
        left, right = self.border.on_core()
        joints = dense(self.jacobian.core)[self.direct]
        lower, upper = np.concatenate((joints, right)), np.concatenate((joints.T, left), axis=1)
        C = np.diag(np.repeat((0.0, -1.0), (len(joints), self.border.count)))

        pairs = [self._couplings(ev, i) for i in range(len(self.blocks))]
        self.couplings = [S for S, _ in pairs]
        self.back_couplings = [R for _, R in pairs]
        for block, (S, R) in zip(self.blocks, pairs, strict=True):
            WS = block.seen_by(R, S)
            A, C = A - WS[:n, :n], C - WS[n:, n:]
            lower, upper = lower - WS[n:, :n], upper - WS[:n, n:]
        self.core.factor(A, lower, C, upper)

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

    def _coupling(self, ev: Evaluation, i: int) -> Array:
        """S of distributed part i: (inertia columns + used ports, n_core + n_lam)."""
        s, block, cm = self.system, self.blocks[i], self.weights.cm
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
        S[c:, s.n_core :] = dense(self.jacobian.port[:, ports]).T
        S[c:] = self._corotated_ports(i, S[c:])
        return S

    def _couplings(self, ev: Evaluation, i: int) -> tuple[Array, Array]:
        """S of part i with the rows of the core and those of the border: what its balance sees, what the others see of it."""
        n, k = self.system.n_core, self.system.fields[i][0]
        S = self._coupling(ev, i)
        if self.iterated is not None:
            S = np.concatenate((S[:, :n], S[:, n:][:, self.direct]), axis=1)
        if not self.border.count:
            return S, S

        used = self.blocks[i].used
        inertia = np.zeros((len(S) - len(used), self.border.count))
        left, right = (np.concatenate((inertia, self._corotated_ports(i, x))) for x in self.border.on_ports(k, used))
        return np.concatenate((S, left), axis=1), np.concatenate((S, right), axis=1)

    def _corotated_ports(self, i: int, rows: Array) -> Array:
        """Rows (used ports, columns) of part i in the axes of its factor."""
        T = self.corotations[i]
        if T is None or not len(rows):
            return rows
        points = rows.reshape(len(rows) // len(T), len(T), rows.shape[1])  # there may be no columns
        return np.asarray((T.T @ points).reshape(rows.shape))

    # -- solution -----------------------------------------------------------------------------------------------
    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """Increment like v and multiplier increment (n_lam,) for right-hand sides b (like v) and c (n_lam,), complex ones too."""
        s = self.system
        driver = self.driver
        if driver is not None and driver.ready:
            return driver.solve(b, c)
        if b.dtype.kind == "c" and self.weights.real:
            (x, y), (u, w) = self.solve(b.real, c.real), self.solve(b.imag, c.imag)
            return x + 1j * u, y + 1j * w
        if not s.fields:
            return self.core.solve(b, c)
        if self.whole:
            return self._around.solve(b, c)
        if self.iterated is not None:
            return self.iterated.solve(self._solve_direct, b, c)
        return self._solve_direct(b, c)

    def closing(self, C: Array) -> Array:
        """Motions (n_v, k) that open the constraints by the columns C (n_lam, k) and are least in the metric of the matrix."""
        driver = self.driver
        if driver is not None and driver.ready:
            return driver.closing(C)
        if self.whole or self.iterated is not None or not self.system.fields:
            nothing = np.zeros(self.system.n_v)
            return np.stack([self.solve(nothing, c)[0] for c in C.T], axis=1)
        return self._solve_direct(None, C)[0]

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

    def _solve_direct(self, b: Array | None, c: Array) -> tuple[Array, Array]:
        """The same with the rows that the core holds: all, or those of no surface tie where these are iterated. No b: zero.
        c may be columns where there is no b.
        """
        s = self.system
        n, columns = s.n_core, c.shape[1:]
        core = self.core.solve_columns if columns else self.core.solve

        # z = E^-1 b of each field, and what is left for the core
        rhs = np.concatenate(
            (np.zeros((n, *columns)) if b is None else b[:n], c, np.zeros((self.border.count, *columns)))
        )
        zs: list[Any] = [0.0] * len(self.blocks)
        for i, ((k, f), block) in enumerate(zip(s.fields, self.blocks, strict=True)):
            if b is not None:
                zs[i] = block.factor.solve(rotate_nodal(s.local_v(b, k), self.corotations[i], back=True))
                rhs -= self.back_couplings[i].T @ self._project(f, block, zs[i])
        x = np.concatenate(core(rhs[:n], rhs[n:]))
        parts = [z - block.Y @ (S @ x) for S, block, z in zip(self.couplings, self.blocks, zs, strict=True)]

        # Moments that the constant columns of inertia leave out: a second solve with the core's factor, no back-solve.
        moments = self._moments_left_out(parts)
        if moments is not None:
            more = np.concatenate(core(moments, np.zeros((len(x) - n, *columns))))
            x += more
            for part, S, block in zip(parts, self.couplings, self.blocks, strict=True):
                part -= block.Y @ (S @ more)

        local = [rotate_nodal(part, T) for part, T in zip(parts, self.corotations, strict=True)]
        return np.concatenate([x[:n], *local]), x[n : n + len(c)]

    def _project(self, f: DistributedPart, block: FactoredField, z: Array) -> Array:
        """H^T z of a field."""
        ports = tangent_ports(f, z, self.jacobian.t)
        q = ports[: f.n_frame_rows] if f.shared_columns else f.field.total(f.inertia_columns.T @ z)
        return np.concatenate((q, ports[block.used]))

    def _moments_left_out(self, increments: list[Array]) -> Array | None:
        """Moments, (n_core, ..), that increments dU of fields have about their frames by M (e x U): -cm (M U) x dU.

        Without them a light axis of a slender body slows Newton's iteration. None where there are none.
        """
        if all(MU is None for MU in self._missing_momenta):
            return None
        s, m = self.system, self.system.motions
        out: Array = np.zeros((s.n_core, *increments[0].shape[1:]), np.result_type(*increments))
        for (_, f), rows, dU in zip(s.fields, self._missing_momenta, increments, strict=True):
            if rows is not None:
                at = f.frame * m.n_twist
                out[at + m.dim : at + m.n_twist] -= self.weights.cm * f.field.total(rows @ dU)
        return out

    def refresh(self, ev: Evaluation, increment: Array | None = None) -> bool:
        """New tangents of nonlinear parts and forces, and rows, at a state; False when all are constant. Collective.

        ``increment``: Newton's, like v, that led there, where stresses are to be those that it foretold.
        """
        known = {} if increment is None else {k: self.system.local_v(increment, k) for k, _ in self.system.fields}
        changed = ev.take_tangents(increments=self._exact(known))
        if changed or self._pushed:
            self.prepare(ev, self.weights, apart=self._apart)
        return changed or self._pushed

    def renew_fields(self, ev: Evaluation, increments: Mapping[int, Array]) -> list[FactoredField]:
        """Blocks with new tangents of all fields at a state, for a matrix that someone else makes; ``increments``: Newton's, by
        part.
        """
        ev.take_tangents(increments=self._exact(increments))
        self._held = None
        self.blocks = self.elastic.of(ev.jacobian, self.weights, ties_apart=False, splits=False)
        return self.blocks

    def _exact(self, increments: Mapping[int, Array]) -> dict[int, Array]:
        """Increments of fields whose factors are exact enough for stresses to be foretold."""
        parts = zip(self.system.fields, self.blocks, strict=True)
        return {k: increments[k] for (k, _), b in parts if k in increments and not b.factor.noisy}

    def destroy(self) -> None:
        """Free all factors; collective."""
        if self.split is not None:
            self.split.destroy()
        self.elastic.destroy()
