"""How fast linear bodies spin in moving frames, beside their first frequencies as joints hold them.

Inertia forces stress a body that spins with Omega, and their stress stiffens it by some Omega^2 times its mass. A linear form
without ``stiffening`` leaves that out, a share (Omega / omega_1)^2 of its stiffness in bending; where it reaches one, in the
plane of rotation, there is no stable solution. omega_1 is that of the body held by its joints, their other sides at rest,

    K phi = omega^2 M phi,     J phi = 0,                                                                   (1)

J the rows of the joints on its motion; zeros of (1), motions that the joints leave to the rigid body, are no vibrations.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg as sl

from ..log import log
from ..matrices import dense, orthonormalising
from ..mechanics.elastic.field_part import FieldPart
from ..mechanics.elastic.floating import FloatingField
from ..mechanics.elastic.modes import first_eigenvalue_bound, first_mode, rigid_fields
from ..mechanics.placements import FrameMotion
from ..mechanics.reduction.reduced import ReducedPart
from ..rotations import Array
from .evaluation import Evaluation
from .layout import Layout, State
from .system import System

SHARE = 0.25  # of the stiffness in bending that may be left out
LOW = 0.05  # of the first frequency of a free body, below which no support brings it
RIGID = 1e-9  # omega^2 below this share of the largest: a rigid motion
DEPENDENT = 1e-12
ALIKE = 1e-6  # square of the sine between spaces of conditions that are one


class Spins:
    """Who looks at the linear bodies of a system that may spin."""

    looks, between = 8, 1  # at a run of equal steps, at least; steps from one to the next where it is short

    def __init__(self, system: System) -> None:
        self.system = system
        self.bodies = [(k, part) for k, part, stiffened in in_linear_frames(system) if not stiffened]
        self.told: set[int] = set()  # bodies that were warned of
        self._slow: dict[int, float] = {}  # of bodies that were looked at, rad/s: below it nothing is to be said of one

    def look(self, state: State) -> None:
        """Warn once of each body whose stress of inertia forces is not small; collective."""
        for k, part in list(self.bodies):
            spin = self._spin(part, state)
            if k not in self._slow:
                self._slow[k] = _slowest(part)
            if spin <= self._slow[k]:
                continue

            ev = self.system.at(state.t, state.q, state.v)
            first = held_mode(ev, k, part)[0]
            share = (spin / first) ** 2
            if share <= SHARE:
                continue

            self.bodies.remove((k, part))
            self.told.add(k)
            log.warning(
                'body "%s" spins at %.3g rad/s, its first bending frequency between its joints is %.3g rad/s: without the '
                "stiffening by the stress of inertia forces its linear floating frame is off by some %.0f %% of its stiffness in "
                "bending, and has no stable solution from 100 %% on (stiffening=True with an attached frame, or an energy)",
                part.name, spin, first, 100.0 * share,
            )  # fmt: skip

    def _spin(self, part: Any, state: State) -> float:
        """Angular velocity of a body's frame, rad/s."""
        n, d = self.system.motions.n_twist, self.system.motions.dim
        return float(np.linalg.norm(state.v[part.frame * n + d : (part.frame + 1) * n]))


def in_linear_frames(system: Layout) -> list[tuple[int, Any, bool]]:
    """Bodies with a linear form in moving frames: their numbers, and whether they have stiffening."""
    found: list[tuple[int, Any, bool]] = []
    for k, part in enumerate(system.parts):
        if isinstance(part, ReducedPart):
            bends, stiffens = part.n > 0, part.constants.stiffening is not None
        elif isinstance(part, FloatingField):
            bends, stiffens = not part.field.nonlinear, part.stiffening is not None
        else:
            continue
        if bends and part.frame < system.n_frames:
            found.append((k, part, stiffens))
    return found


def _slowest(part: Any) -> float:
    """Angular velocity (rad/s) below which no support brings the first frequency of a body near."""
    if isinstance(part, ReducedPart):
        return LOW * part.first_frequency
    return LOW * float(np.sqrt(first_eigenvalue_bound(part.field)))


def held_mode(ev: Evaluation, k: int, part: Any) -> tuple[float, Array]:
    """omega_1 of (1) of body k, rad/s, infinite where joints hold all of its modes, and its shape on the local coordinates, in
    the frame; collective.
    """
    if isinstance(part, ReducedPart):
        return mode_by_modes(ev, k, part, part.n)
    s = ev.system
    return _of_field(ev, k, part, ev.jacobian.port[: s.n_rows, s.port_slice(k)])


def mode_by_modes(ev: Evaluation, k: int, part: ReducedPart, count: int) -> tuple[float, Array]:
    """(1) of the reduced body k by its first modes only, so many."""
    n, d = ev.system.motions.n_twist, ev.system.motions.dim
    rest = FrameMotion(ev.t, ev.rotation[part.frame], np.zeros(n), None, np.zeros(d))
    of_frame, across, of_modes = part.mass_blocks(rest, np.zeros(part.n))
    M = np.block([[of_frame, across.T], [across, of_modes]])[: n + count, : n + count]
    K = np.zeros_like(M)
    K[n:, n:] = part.constants.K[:count, :count]

    unit = np.sqrt(np.diag(M))
    first = ev.system.slices[1][k].start
    moved = np.concatenate((n * part.frame + np.arange(n), first + np.arange(count)))
    J = dense(ev.jacobian.columns[:, moved]) / unit
    V = sl.null_space(_of_length_one(J)) / unit[:, None]
    if not V.shape[1]:
        return np.inf, np.zeros(count)
    squares, shapes = sl.eigh(V.T @ K @ V, V.T @ M @ V)
    bends = np.flatnonzero(squares > RIGID * max(squares[-1], 0.0))
    if not len(bends):
        return np.inf, np.zeros(count)
    return float(np.sqrt(squares[bends[0]])), (V @ shapes[:, bends[0]])[n:]


def _of_field(ev: Evaluation, k: int, part: FieldPart, on_ports: Array) -> tuple[float, Array]:
    """(1) of the displacement field of body k, which holds rigid motions too: rows on its ports.

    What was found last is kept with the system: in its own axes a body is held alike as long as its joints turn with it.
    """
    f = part.field
    Z = rigid_fields(f)
    used = np.flatnonzero(np.abs(on_ports).max(axis=0, initial=0.0) > 0)
    held = part.port_columns(used, ev.t) @ _of_length_one(on_ports[:, used]).T

    # what the joints leave to the rigid body is held beside
    free = (
        sl.null_space(f.total(held.T @ Z) / np.sqrt(np.diag(f.total(Z.T @ f.Q))))
        if held.shape[1]
        else np.eye(Z.shape[1])
    )
    free = free / np.sqrt(np.diag(f.total(Z.T @ f.Q)))[:, None]
    conditions = np.concatenate((held, f.Q @ free), axis=1)

    size = np.sqrt(f.total(np.square(conditions).sum(axis=0)))
    conditions = conditions / size
    conditions = conditions @ orthonormalising(f.total(conditions.T @ conditions), DEPENDENT)

    known = ev.system.cache.get(("held", k))
    if known is None or not _span_one_space(f, known[0], conditions):
        omega, u = first_mode(f, conditions)
        if part.n_frame_rows:
            C = part.port_columns(np.arange(part.n_frame_rows), ev.t)
            u = u - Z @ np.linalg.solve(f.total(C.T @ Z), f.total(C.T @ u))
        known = ev.system.cache["held", k] = conditions, (omega, u)
    shape: tuple[float, Array] = known[1]
    return shape


def _span_one_space(field: Any, A: Array, B: Array) -> bool:
    """Whether orthonormal columns on the nodes of a field span the same; collective."""
    return A.shape == B.shape and A.shape[1] - float(np.square(field.total(A.T @ B)).sum()) < ALIKE


def _of_length_one(rows: Array) -> Array:
    """Rows that are not zero, of length one."""
    size = np.linalg.norm(rows, axis=1)
    used = size > DEPENDENT * size.max(initial=0.0)
    return np.asarray(rows[used] / size[used, None])
