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

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..errors import InputError, LinearSolveError, require
from ..mechanics.placements import DistributedPart, FrameMotion
from ..rotations import Array, turned
from ..system.force_tangent import force_tangent
from ..system.foreshortened_ports import tangent_ports
from ..system.mobility import mobility
from ..system.system import Evaluation, System
from .blocks.frame_moments import frame_moments
from .blocks.incompressibility import VolumeMass
from .blocks.spd import CholeskyFactor, MassInverse
from .border import AroundSolver, Border, loaded_ports
from .configuration_warnings import mover, warn_near_singular, warn_of_ties
from .core import ADVICE, CoreSolver, dense
from .options import check_options
from .residual import Judge

TIE_LIMIT = 1500  # multipliers of surface ties that the dense core takes
LOOK_LIMIT = 600  # constraint rows up to which the solver itself looks for redundant ones


@dataclass(frozen=True)
class Weights:
    """The step's matrix is cm M + cd C + ck K."""

    cm: float
    cd: float
    ck: float


@dataclass
class Block:
    """Factor and constant columns of one field for one ratio cm : ck."""

    factor: Any
    used: np.ndarray  # port numbers that have a column
    Y: Array  # (n d, k + len(used)), k columns of inertia
    W: Array
    made_of: tuple[float, float, float, int]  # see _made_of


class StepSolver:
    """Solves cm M + cd C + ck K with the constraints of a system; one object for a whole run; collective."""

    def __init__(
        self, system: System, redundant: bool | None = None, *, linear: Any = None, prefix: str = "fmbd_"
    ) -> None:
        """``redundant``: whether constraint rows may depend on each other; None looks at the first configuration.

        ``linear``: how elastic blocks are solved, an object of :mod:`.presets` (None: Cholesky factors). PETSc's options of
        the block of a body are those under ``<prefix><body>.u_``.
        """
        self.system, self.linear, self.prefix = system, linear, prefix
        self._look = redundant is None
        self._near_singular = False
        self.core = CoreSolver(Judge("the core of the system"), bool(redundant))
        self.factorisations = 0
        self.kept = 1  # sets of elastic factors that stay when a new one is made: schemes with variable steps keep more
        self._blocks: dict[tuple[Any, ...], list[Block]] = {}
        self._retired: list[Any] = []
        self.split: Any = linear.split(system, prefix) if hasattr(linear, "split") else None
        self.many = self._many()
        self.few: Any = slice(None) if self.many is None else self.many.few

    def _many(self) -> Any:
        """What iterates on the multipliers of surface ties where they are many; None where the dense core takes them."""
        s = self.system
        count = sum(span.stop - span.start for _, span in s.traces)
        limit = getattr(self.linear, "limit", TIE_LIMIT)
        if count <= limit:
            return None
        if not hasattr(self.linear, "multiplier"):
            raise InputError(
                f"The surface ties have {count} multipliers; the direct solver takes up to {TIE_LIMIT}. "
                "Use solve(..., linear=fmbd.Schur()), or coarser multiplier spaces."
            )
        from .iterated_multipliers import ManyMultipliers

        return ManyMultipliers(s, self.linear.multiplier, self.linear.rtol)

    @property
    def back_solves(self) -> int:
        """Right-hand sides solved with elastic factors so far."""
        live = {id(b.factor): b.factor for blocks in self._blocks.values() for b in blocks}
        return sum(f.judge.solves for f in live.values()) + sum(self._retired)

    @property
    def elastic_iterations(self) -> int:
        """Iterations of conjugate gradients inside all of them; 0 for factors."""
        live = {id(b.factor): b.factor for blocks in self._blocks.values() for b in blocks}
        return sum(getattr(f, "iterations", 0) for f in live.values())

    @property
    def tie_iterations(self) -> int:
        """Iterations on the multipliers of surface ties; 0 where these are solved directly."""
        return 0 if self.many is None else int(self.many.iterations)

    @property
    def saddle_iterations(self) -> int:
        """Iterations on the whole matrix of a step, see :mod:`.split`; 0 where it is eliminated instead."""
        return 0 if self.split is None else int(self.split.iterations)

    @property
    def worst_residual(self) -> float:
        """Largest relative residual of any accepted solve."""
        worst = [b.factor.judge.worst for blocks in self._blocks.values() for b in blocks]
        return max([self.core.judge.worst, 0.0 if self.split is None else self.split.judge.worst, *worst])

    def prepare(self, ev: Evaluation, weights: Weights, stiffness: Any = None, *, keep: bool = False) -> None:
        """Set up (1) for a configuration; elastic factors are kept from earlier calls with the same weights.

        ``stiffness``: extra core matrix (n_core, n_core), already weighted (springs, geometric terms), or None. ``keep``: the
        matrix stays as it is, until :meth:`refresh` takes it at this configuration.
        """
        s = self.system
        if keep:
            self._ev = ev
            return
        s.move(ev.t)
        w = self.weights = weights
        self._ev, self._stiffness = ev, stiffness
        if self._look and s.n_lam <= LOOK_LIMIT:
            found = mobility(s, ev.t, ev.q)
            self.core.redundant = found.redundant > 0
            warn_of_ties(s, found.shares)
        self._look = False
        try:
            self._assemble(ev, w, stiffness)
        except LinearSolveError as error:
            if not hasattr(error, "motion"):
                raise
            raise LinearSolveError(
                f"{mover(s, error.motion)} has a motion without mass that no joint holds (t = {ev.t:g} s). {ADVICE}"
            ) from error
        if s.n_lam and (self.core.ratio < 1e-5 or self._near_singular):
            self._near_singular = warn_near_singular(ev, self.core.rank, self._near_singular)

    def _assemble(self, ev: Evaluation, w: Weights, stiffness: Any) -> None:
        """The matrices of (1), and the factor of the core."""
        s = self.system
        G = ev.jacobian
        A = self.core_matrix(ev, w)
        applied = force_tangent(ev, w.cd, w.ck) if (s.forces or s.elements) and (w.cd or w.ck) else None
        self.border = Border.of(s, applied)
        for extra in (None if applied is None else applied.core, stiffness):
            if extra is not None:
                A = A + extra
        if not s.fields:
            self._G = G
            self.core.factor(A, G.core)
            return
        self._G = G
        self._turns = [f.turn(s.local_q(ev.q, k)) for k, f in s.fields]
        moving = w.ck and self.many is None and s.contacts is None  # Delassus operators are those of (1)
        self._sways = [f.sway(s.local_q(ev.q, k)) if moving else None for k, f in s.fields]
        self.blocks = self._elastic(G, w)
        n = s.n_core
        A = A.toarray() if sp.issparse(A) else A.copy()
        if self._whole:
            self._refuse_redundant()
            self.split.prepare(self, A, [self._coupling(ev, i, w.cm) for i in range(len(self.blocks))])
            self._around = AroundSolver(self.border, self.split.solve)
            return
        if self.many is not None:
            self.many.prepare(ev, w, A)
        left, right = self.border.on_core()
        joints = dense(G.core)[self.few]
        lower, upper = np.concatenate((joints, right)), np.concatenate((joints.T, left), axis=1)
        C = np.diag(np.repeat((0.0, -1.0), (len(joints), self.border.count)))
        self._S, self._R = [], []
        for i, block in enumerate(self.blocks):
            S, R = self._couplings(ev, i, w.cm)
            self._S.append(S)
            self._R.append(R)
            WS = R.T @ block.W @ S
            A -= WS[:n, :n]
            lower -= WS[n:, :n]
            upper -= WS[:n, n:]
            C -= WS[n:, n:]
        self.core.factor(A, lower, C, upper)

    @property
    def _whole(self) -> bool:
        """Whether the matrix of the configuration is solved as a whole; without stiffness (starts) it is eliminated."""
        return self.split is not None and self.weights.ck != 0

    def _refuse_redundant(self) -> None:
        """Dependent rows leave multipliers of minimum norm to the dense core."""
        require(
            not self.core.redundant,
            "FieldSplit() needs constraints that do not depend on each other; scene.check() lists those of this scene that do. "
            "Take one of them away, or use linear=fmbd.Direct().",
        )

    def core_matrix(self, ev: Evaluation, w: Weights) -> Any:
        """cm M + cd C + ck K of the core: rigid bodies, frames of elastic ones (at U = 0), replicated parts."""
        s, n = self.system, self.system.motions.n_twist
        M = np.zeros((s.n_frames + 1, n, n))
        if s.rigid is not None:
            M[s.rigid.frame] = s.rigid.matrices()
        blocks = []
        for k, p in enumerate(s.parts):
            u, ud = s.local_q(ev.q, k), np.zeros(p.n) if ev.v is None else s.local_v(ev.v, k)
            motion = FrameMotion(ev.t, ev.rotation[p.frame], np.zeros(n), None, s.gravity(ev.t))
            Mff, Mlf, Mll = p.mass_blocks(motion, u)
            M[p.frame] += Mff
            if not p.distributed:
                K, C = p.stiffness_blocks(motion, (u, ud)) if w.ck or w.cd else (0.0, 0.0)
                blocks.append((k, p, w.cm * Mlf, w.cm * Mll + w.cd * C + w.ck * K))
        M *= w.cm
        if not isinstance(ev.jacobian.core, np.ndarray):
            frames = sp.bsr_matrix((M[:-1], np.arange(s.n_frames), np.arange(s.n_frames + 1)))
            if not blocks:
                return frames.tocsr()
            frames = frames.toarray()
        out = np.zeros((s.n_core, s.n_core))
        view = out[: s.n_frames * n, : s.n_frames * n].reshape(s.n_frames, n, s.n_frames, n)
        view[range(s.n_frames), :, range(s.n_frames)] = M[:-1]
        for k, p, lf, ll in blocks:
            at = s.slices[1][k]
            out[at, at] = ll
            if p.frame < s.n_frames:
                cols = slice(p.frame * n, (p.frame + 1) * n)
                out[at, cols], out[cols, at] = lf, lf.T
        return out

    def _elastic(self, G: Any, w: Weights) -> list[Block]:
        """Factors and constant columns of all fields, from the cache or new."""
        key = tuple((_made_of(f, w), f.column_version) for _, f in self.system.fields)
        if key not in self._blocks:
            blocks = [self._block(i, G, w) for i in range(len(self.system.fields))]
            self._drop(keep=self.kept, live=[b.factor for b in blocks])
            if self.linear is not None and w.ck and self.split is None:
                check_options(self.prefix, self.system.comm)
        else:
            blocks = self._blocks.pop(key)
        self._blocks[key] = blocks  # those used last are dropped last
        return blocks

    def _block(self, i: int, G: Any, w: Weights) -> Block:
        """Factor of field i, an earlier one where its matrix is the same, and its columns."""
        k, f = self.system.fields[i]
        cm, cd, ck, _ = same = _made_of(f, w)
        earlier = [blocks[i] for blocks in self._blocks.values() if blocks[i].made_of == same]
        if earlier:
            factor: Any = earlier[-1].factor
        else:
            factor = self._factor(f, cm, ck, cd)
            self.factorisations += ck != 0 and getattr(factor, "fresh", True)
        first = f.n_frame_rows
        active = G.active(self.system.port_slice(k)) | loaded_ports(self.system)[self.system.port_slice(k)]
        if self.many is not None or self._whole:
            active &= ~self._on_traces(f)
        if f.shared_columns:
            active[:first] = False  # the same columns as those of inertia
        points = active[first:].reshape(-1, self.system.motions.dim)
        points[:] = points.any(axis=1)[:, None]  # whole vectors b_k, so that they can be turned
        used = np.flatnonzero(active)
        H = np.concatenate((f.inertia_columns, f.port_columns(used)), axis=1)
        Y = factor.solve_columns(H)
        W = f.field.total(H.T @ Y)
        return Block(factor, used, Y, 0.5 * (W + W.T), same)

    def _on_traces(self, f: Any) -> np.ndarray:
        """Which ports of a field belong to surface ties, (n_port,)."""
        return np.arange(f.n_port) >= f.n_port - sum(B.shape[0] for B in f.traces)

    def _factor(self, f: Any, cm: float, ck: float, cd: float) -> Any:
        """A new factor of cm M + ck K, with the field's own damping where it has one."""
        if ck == 0:
            return VolumeMass(f.field, cm) if f.field.keeps_volume else MassInverse(f.field, cm)
        slack = getattr(f, "slack", None)
        if slack is None and self.linear is not None:
            return self.linear.block(f.field, (cm, cd, ck), f"{self.prefix}{f.name}.u_")
        if slack is None:
            return CholeskyFactor(f.field, cm, ck, cd, turns=f.frame == self.system.n_frames)
        from .blocks.low_rank import SlackFactor

        return SlackFactor(f.field, cm, ck, slack)

    def _drop(self, keep: int, live: list[Any]) -> None:
        """Free all but the newest ``keep`` sets of factors, and those still ``live``."""
        while len(self._blocks) > keep:
            old = self._blocks.pop(next(iter(self._blocks)))
            kept = [*live, *(b.factor for blocks in self._blocks.values() for b in blocks)]
            for b in old:
                if not any(b.factor is x for x in kept):
                    self._retired.append(b.factor.judge.solves)
                    b.factor.destroy()

    def _coupling(self, ev: Evaluation, i: int, cm: float) -> Array:
        """S of distributed part i: (inertia columns + used ports, n_core + n_lam)."""
        s, block = self.system, self.blocks[i]
        k, f = s.fields[i]
        c, d = f.inertia_columns.shape[1], s.motions.dim
        S = np.zeros((c + len(block.used), s.n_core + s.n_lam))
        if c:
            at = f.frame * c
            S[:d, at : at + d] = cm * ev.rotation[f.frame].T
            S[d:c, at + d : at + c] = cm * np.eye(c - d)
        if f.shared_columns:
            rows = s.frame_rows[k]
            S[:c, s.n_core + rows.start : s.n_core + rows.stop] = np.eye(c)
        S[c:, s.n_core :] = dense(self._G.port[:, s.port_slice(k).start + block.used]).T
        S[c:] = self._turned_ports(i, S[c:])
        return S

    def _couplings(self, ev: Evaluation, i: int, cm: float) -> tuple[Array, Array]:
        """S of part i with the few rows and those of the border: what its balance sees, and what the others see of it."""
        n, k = self.system.n_core, self.system.fields[i][0]
        S = self._coupling(ev, i, cm)
        if self.many is not None:
            S = np.concatenate((S[:, :n], S[:, n:][:, self.few]), axis=1)
        if not self.border.count:
            return S, S
        used = self.blocks[i].used
        inertia = np.zeros((len(S) - len(used), self.border.count))
        left, right = (np.concatenate((inertia, self._turned_ports(i, x))) for x in self.border.on_ports(k, used))
        return np.concatenate((S, left), axis=1), np.concatenate((S, right), axis=1)

    def _turned_ports(self, i: int, rows: Array) -> Array:
        """Rows (used ports, columns) of part i as the turned factor sees them."""
        turn = self._turns[i]
        if turn is None or not len(rows):
            return rows
        return np.asarray((turn.T @ rows.reshape(-1, len(turn), rows.shape[1])).reshape(rows.shape))

    def _project(self, f: DistributedPart, block: Block, z: Array) -> Array:
        """H^T z of a field."""
        ports = tangent_ports(f, z)
        q = ports[: f.n_frame_rows] if f.shared_columns else f.field.total(f.inertia_columns.T @ z)
        return np.concatenate((q, ports[block.used]))

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """Increment like v and multiplier increment (n_lam,) for right-hand sides b (like v) and c (n_lam,)."""
        s = self.system
        if not s.fields:
            return self.core.solve(b, c)
        s.move(self._ev.t)
        if self._whole:
            return self._around.solve(b, c)
        if self.many is not None:
            return self.many.solve(self._solve_few, b, c)
        return self._solve_few(b, c)

    def step(self, b: Array, c: Array) -> tuple[Array, Array]:
        """As :meth:`solve`, for an increment of Newton's iteration: the pressures that bodies carry move along; collective.

        The system's forces must have been evaluated last at the iterate.
        """
        s = self.system
        carried = [(i, k, f) for i, (k, f) in enumerate(s.fields) if f.field.carried]
        if not carried:
            return self.solve(b, c)
        b = b.copy()
        for i, k, f in carried:
            at = s.slices[1][k]
            b[at] -= self.weights.ck * turned(f.field.volume_load(), self._turns[i])  # type: ignore[attr-defined]
        dq, dlam = self.solve(b, c)
        for i, k, f in carried:
            f.field.move_pressure(turned(s.local_v(dq, k), self._turns[i], back=True))  # type: ignore[attr-defined]
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

    def _solve_few(self, b: Array, c: Array) -> tuple[Array, Array]:
        """The same with the rows that the core holds: all, or those of no surface tie where these are many."""
        s = self.system
        n = s.n_core
        rhs = np.concatenate((b[:n], c, np.zeros(self.border.count)))
        zs = []
        for i, ((k, f), block) in enumerate(zip(s.fields, self.blocks, strict=True)):
            z = block.factor.solve(turned(s.local_v(b, k), self._turns[i], back=True))
            rhs -= self._R[i].T @ self._project(f, block, z)
            zs.append(z)
        x = np.concatenate(self.core.solve(rhs[:n], rhs[n:]))
        parts = [z - block.Y @ (S @ x) for S, block, z in zip(self._S, self.blocks, zs, strict=True)]
        moments = frame_moments(s, self._sways, self.weights.cm, parts)
        if moments is not None:
            more = np.concatenate(self.core.solve(moments, np.zeros(len(x) - n)))
            x += more
            for part, S, block in zip(parts, self._S, self.blocks, strict=True):
                part -= block.Y @ (S @ more)
        return np.concatenate([x[:n], *(turned(x, turn) for x, turn in zip(parts, self._turns, strict=True))]), x[
            n : n + len(c)
        ]

    def refresh(self) -> bool:
        """New tangents of nonlinear parts at the configuration evaluated last, and rows at the one given last to
        :meth:`prepare`; False when all are constant. Collective.
        """
        changed = [f.relinearise() for _, f in self.system.fields]
        if any(changed):
            self.prepare(self._ev, self.weights, self._stiffness)
        return any(changed)

    def destroy(self) -> None:
        """Free all factors; collective."""
        if self.split is not None:
            self.split.destroy()
        self._drop(keep=0, live=[])
        for _, f in self.system.fields:
            forget = getattr(f.field, "forget", None)  # wires keep factors for several sets of slack droppers
            if forget is not None:
                forget()


def _made_of(f: DistributedPart, w: Weights) -> tuple[float, float, float, int]:
    """Coefficients of M, of an own damping form and of K in the matrix of a field, and the number of its tangent."""
    forms = f.field.forms
    cm, ck = w.cm + w.cd * forms.mass_damping, w.ck
    damped = f.field.D is not None
    if f.field.carried:  # its stiffness_damping leaves the volume alone, see MixedField.combination
        damped |= forms.stiffness_damping > 0
    else:
        ck += w.cd * forms.stiffness_damping
    return cm, w.cd if damped else 0.0, ck, f.tangent_version if ck or f.field.keeps_volume else 0
