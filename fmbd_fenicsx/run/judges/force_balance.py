"""A step counts when its forces are in balance: what is left of them moves no body by more than an error of the step would.

What is left of the balance of forces and moments of a state stands for velocities that the bodies should have got in the step,

    r = M a + h + G^T lambda,     d_i = h r_i / (M + h |C| + h^2 |K|)_ii                                          (1)

and the step passes when these are small against the change of velocities that the motion contains:

    |d| u  <=  h S a_max + 10 rtol v_max + 1e4 eps (L + |x|) / h,      S = 1e-2, or 100 times Newton's tolerance     (2)

with a_max the largest acceleration so far, g and v^2 / L among them, and u that makes lengths. With M alone the roundoff of a
stiff spring would be a failure: its force is K times the last digit of a place. Forces on a body are known to a share of 1e-8 of
those that joints and elements exert on it, the share by which linear solves pass; less than that is left out of r.

What joints take up of r moves no body: it is an error of their reactions. A state is in balance too where

    [ A  G^T ] [ d  ]   [ h r ]
    [ G      ] [ mu ] = [  0  ],     A = M + h C + h^2 K of bodies                                            (3)

leaves an h r - G^T mu that passes (2), and G^T mu is less than 100 times Newton's tolerance, or 1e-8, of the forces that joints
and elements exert on a body. The roll of a thin rod between two hinges has hardly any inertia: what large reactions do to its
balance as the rod turns by less than Newton's tolerance is many times S a_max, although its hinges let it go nowhere. A frame
whose elastic field is held goes nowhere either: d of (3) is that of the whole system, by the matrix of the step.

Rows are those of the core: rigid bodies, frames of elastic ones (all forces on the body as a whole), modes, coordinates of a
user's own. Nodes of fields are judged by the linear solves and by the first strides of Newton's iteration. Schemes that hold the
equations of motion at the end of a step are judged, in scenes without contact: contact forces are no part of lambda.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...errors import ConvergenceError
from ...linear.blocks.field_blocks import Weights
from ...linear.condensation import StepSolver
from ...linear.core_matrix import core_matrix
from ...matrices import dense
from ...rotations import Array
from ...schemes.declared import Declared
from ...system.evaluation import Evaluation
from ...system.evaluator import Seen
from ...system.layout import State
from ...system.lengths import Measured, farthest
from ...system.serialisation import Remembering, plain
from ...system.tangents.force_tangent import force_tangent

SHARE = 1e-2  # of accelerations
KNOWN = 1e-8  # of the forces that joints and elements exert on a body
CONTROLLED = 10.0  # times the relative tolerance of the error control
ROUNDOFF = 1e4 * float(np.finfo(float).eps)
DEPENDENT = 1e-12  # singular values of (3), scaled, below this share belong to rows that depend on each other
LARGEST = 600  # unknowns of (3) up to which it is solved: densely, beside the linear solver, which is judged too
FIRST_LOOK, APART = 64, 16_384  # compiled steps before the first look at them, and at most from one to the next


def next_look(done: int) -> int:
    """After how many compiled steps the balance is looked at, behind those that are done: 64, 256, 1024, 4096, 16384, and all
    16384 from there on.

    By their number: how a run is cut into calls depends on the clock and on records, and which states pass must not.
    """
    size = FIRST_LOOK
    while size <= done and size < APART:
        size *= 4
    return (done // size + 1) * size


@dataclass
class Balanced(Remembering):
    """Refuses states whose forces are not in balance by (2). ``rtol``: of the scheme's error control, 0 without; ``reactions``:
    share of the forces on a body that joints may be off by.
    """

    keeps: ClassVar = dict.fromkeys(("hardest", "fastest", "repeated"), plain())

    solver: StepSolver
    share: float = SHARE
    rtol: float = 0.0
    reactions: float = 1e-4
    hardest: float = 0.0  # m/s^2, of all states so far
    fastest: float = 0.0  # m/s
    repeated: int = 0  # steps that were made again
    # of rigid bodies, on the diagonal, once they were looked at
    _masses: Array | None = field(default=None, init=False)

    @staticmethod
    def under(solver: StepSolver, said: Declared, tolerance: float) -> Balanced | None:
        """For the states of a scheme by what it has said, with Newton's ``tolerance``; None where there is nothing to judge."""
        s = solver.system
        if said.form is None or said.start is not None or not s.n_core:
            return None
        return Balanced(solver, max(SHARE, 100 * tolerance), said.rtol or 0.0, max(KNOWN, 100 * tolerance))

    def passes(self, seen: Seen, sums: Array, t: float, h: float) -> bool:
        """Whether a state at t after a step of size h (s) passes, of which this and the ``sums`` of its balance were seen;
        :meth:`check` has to look closely where it does not.
        """
        if h <= 0:
            return True
        if self._masses is None:
            return False
        allowed = self._allowed(t, h, (seen.speed, seen.acceleration), seen.far)
        return bool(np.maximum.reduce(self.solver.system.units * (np.abs(h * sums) / self._masses)) <= allowed)

    def check(self, ev: Evaluation, state: State, h: float) -> None:
        """Raise ConvergenceError where the state at the end of a step of size h (s) is not in balance; collective."""
        s, n = self.solver.system, self.solver.system.n_core
        if h <= 0:
            return
        allowed = self._allowed(state.t, h, (s.typical(state.v), s.typical(state.a)), farthest(s, ev.q))

        left = h * ev.balance(state.a, state.lam)[:n]
        masses = _diagonal(self.solver.masses(ev))
        self._masses = masses if not s.parts and masses.all() else None  # those of rigid bodies stay
        if np.maximum.reduce(_lengths(s, left, masses)) <= allowed:
            return

        sizes = self._closely(ev, state, left, h, allowed)
        if not sizes.max() <= allowed:
            name = f'body "{s.body_of(int(np.argmax(sizes)))}"'
            raise ConvergenceError(
                f"At t = {state.t:.6g} s the forces on {name} are not in balance: what is left of them stands for "
                f"{sizes.max():.2g} m/s in this step, {allowed:.2g} m/s is allowed. Take a smaller dt or rtol, or a smaller "
                "Newton(tolerance=...)."
            )

    def _closely(self, ev: Evaluation, state: State, left: Array, h: float, allowed: float) -> Array:
        """The dearer look, d of (1) as lengths over time, (n_core,): without what is known to roundoff of large forces only, with
        the stiffness of elements, and where that is not enough without what joints take up.
        """
        s, forces = ev.system, h * self._forces(ev, state)
        left = np.where(np.abs(left) > KNOWN * forces, left, 0.0)
        A = core_matrix(ev, Weights(1.0, h, h * h))
        weight = self._weights(ev, h, _diagonal(A))
        sizes = _lengths(s, left, weight)
        if sizes.max() <= allowed:
            return sizes

        held = self._by_fields(left, weight) if s.fields else None
        held = _held(ev, A, left) if held is None else held
        small = np.abs(held) <= self.reactions * _largest(s, forces)
        return _lengths(s, left - held, weight) if small.all() else sizes

    def _by_fields(self, left: Array, weight: Array) -> Array | None:
        """What joints and elastic fields take up of ``left``, (n_core,): all but weight d, d of (3) by the matrix of the step;
        None where that is no such matrix.
        """
        n, s, w = len(left), self.solver.system, self.solver.weights
        if not w.real or not w.ck:
            return None
        d = self.solver.solve(np.concatenate((left, np.zeros(s.n_v - n))), np.zeros(s.n_lam))[0]
        return np.asarray(left - weight * (w.cm * d[:n]))

    def _allowed(self, t: float, h: float, largest: tuple[float, float], far: float) -> float:
        """The right-hand side of (2) after a step of h (s) to t, m/s; ``largest`` velocity and acceleration of the state are
        taken notice of, ``far``: |x|.
        """
        s, (v, a) = self.solver.system, largest
        gravity = hypot(*s.gravity(t))
        self.fastest = max(self.fastest, v)
        self.hardest = max(self.hardest, a, gravity, v**2 / s.length if s.length else 0.0)
        allowed = h * self.share * self.hardest + CONTROLLED * self.rtol * self.fastest
        return allowed + ROUNDOFF * (s.length + far) / h

    @staticmethod
    def _weights(ev: Evaluation, h: float, of_bodies: Array) -> Array:
        """M + h |C| + h^2 |K| of (1), (n_core,): that of bodies and what elements add."""
        s, weight = ev.system, of_bodies.copy()
        n = s.n_core
        applied = force_tangent(ev, h, h * h) if s.forces or s.elements else None
        if applied is not None:
            if applied.core is not None:
                weight += _diagonal(applied.core)
            weight += np.abs(np.einsum("ij,ij->i", applied.left[:n], applied.right[:n]))
        return weight

    def _forces(self, ev: Evaluation, state: State) -> Array:
        """Sizes of what joints and elements exert, (n_core,): of a frame one for its forces and one for its moments."""
        s, n, d = ev.system, ev.system.n_core, ev.system.motions.dim
        out = np.zeros(n)
        if s.n_lam:
            out += abs(ev.jacobian.core).T @ np.abs(state.lam)
        frames = out[: s.n_frames * s.motions.n_twist].reshape(s.n_frames, s.motions.n_twist)  # a view
        if s.n_lam and s.n_frames:
            frames[:, d:] += (_arms(ev) * frames[:, :d].max(axis=1, initial=0.0))[:, None]

        if s.forces:
            size = np.abs(ev.wrenches())
            push, turn = size[:, :d].sum(axis=1), size[:, d:].sum(axis=1)
            of = np.zeros((s.n_frames + 1, 2))
            np.add.at(of, s.markers.frame, np.stack([push, turn + s.length * push], axis=1))
            frames[:, :d] += of[:-1, :1]
            frames[:, d:] += of[:-1, 1:]
        # one size for all components: axes do not matter
        for part in (frames[:, :d], frames[:, d:]):
            part[:] = part.max(axis=1, keepdims=True)
        return out


def _arms(ev: Evaluation) -> Array:
    """The longest arm at which a joint pushes each frame, (n_frames,): a force along it has no moment, as axes lie by chance."""
    s, d = ev.system, ev.system.motions.dim
    twist, n = s.motions.n_twist, s.n_frames
    squares = sp.csr_array(ev.jacobian.core)[:, : n * twist].power(2)
    squares.eliminate_zeros()
    column = np.arange(n * twist)
    of_frame = sp.csr_array((np.ones(n * twist), (column, column // twist)), (n * twist, n))
    turns = (column % twist >= d).astype(float)
    push, turn = squares @ (of_frame * (1.0 - turns)[:, None]), squares @ (of_frame * turns[:, None])
    push.eliminate_zeros()
    push.data = 1.0 / push.data
    return np.sqrt(turn.multiply(push).max(axis=0).toarray()).ravel()


def _held(ev: Evaluation, A: Any, left: Array) -> Array:
    """G^T mu of (3), (n_core,): what joints take up of ``left``. Those on fields take up nothing, nor do any in large systems."""
    n, judged = len(left), ~_on_fields(ev)
    if n + np.count_nonzero(judged) > LARGEST:
        return np.zeros(n)
    G = dense(ev.jacobian.core)[judged]

    # units of rows and columns do not count
    unit = np.sqrt(_diagonal(A))
    unit[unit == 0] = 1.0
    J = G / unit
    size = np.linalg.norm(J, axis=1, keepdims=True)
    J = J / np.where(size > 0, size, 1.0)
    saddle = np.block([[dense(A) / np.outer(unit, unit), J.T], [J, np.zeros((len(J), len(J)))]])
    mu = np.linalg.lstsq(saddle, np.concatenate((left / unit, np.zeros(len(J)))), rcond=DEPENDENT)[0][n:]
    return np.asarray(unit * (J.T @ mu))


def _on_fields(ev: Evaluation) -> NDArray[np.bool_]:
    """Which rows of G act on distributed fields, whose nodes are not among the rows judged; (n_lam,)."""
    found = np.zeros(ev.system.n_lam, bool)
    for k, _ in ev.system.fields:
        found |= np.asarray(abs(ev.jacobian.port[:, ev.system.port_slice(k)]).sum(axis=1)).ravel() > 0
    return found


def _largest(system: Measured, forces: Array) -> Array:
    """Forces on the coordinates of each part by the largest of them: modes are no axes of one thing, (n_core,)."""
    out = forces.copy()
    for span in system.slices[1]:
        own = out[span]
        own[:] = own.max(initial=0.0)
    return out


def _lengths(system: Measured, left: Array, weight: Array) -> Array:
    """d of (1) as lengths over time, (n_core,)."""
    # no force would change the velocity of a coordinate without inertia and stiffness
    change = np.divide(np.abs(left), weight, out=np.zeros(len(weight)), where=weight > 0)
    return system.units[: len(weight)] * change


def _diagonal(A: Any) -> Array:
    """Sizes of the entries on the diagonal of a matrix, dense or sparse."""
    return np.abs(np.asarray(A.diagonal(), dtype=float))
