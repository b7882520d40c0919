"""Rows of joints that turn too far in one step of generalized-alpha for what it remembers of accelerations.

The scheme carries accelerations A_n from step to step: those of points along space, those of rotations along the body. With
constraints on positions (index 3) it closes g = 0 by the component of A_n+1 across the rows, against what A_n left there. While
the rows stand still in these axes a remainder alternates with the factor -rho_inf. Where they turn by an angle phi each step, as
those of a pin of a fast link or a fast rotor's do, the eigenvalue is about

    - (rho_inf + 1.3 phi),                                                                                     (1)

that of the step's linear map for a mass on a turning arm: with rho_inf = 0.8 above one in size from 0.15 rad on, with 0.95 from
0.035. Accelerations and reactions alternate and grow from roundoff, until steps fail. phi is the largest principal angle between
the row spaces of G at both ends of a step, in the metric of M^-1. Rows on velocities, of rolling and of form=GGL(), stay
stable at any angle.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import scipy.linalg as sl

from ..linear.condensation import StepSolver, Weights
from ..linear.core import dense
from ..log import log
from ..rotations import Array
from ..schemes.declared import Declared
from ..system.speed_rows import speed_rows
from ..system.system import State, System

LARGEST = 150  # replicated coordinates up to which the angle is looked at
RANK = 1e-9  # singular values of rows below this share of the largest are zero


def warn_of_turning_rows(solver: StepSolver, scheme: object, states: Iterable[State], h: float) -> None:
    """Warn where rows turn beyond the scheme's limit in one of the states; no fields, not collective."""
    limit, system = Declared.by(scheme).turn_limit, solver.system
    if limit is None or system.fields or not 0 < system.n_core <= LARGEST:
        return
    angle, state = max(((turned(solver, s, h), s) for s in states), key=lambda found: found[0])
    if angle <= limit:
        return
    log.warning(
        "joints turn by %.2g rad a step (fastest: %s), more than the %.2g rad that this scheme's memory of accelerations bears: "
        "reactions and accelerations may alternate from step to step and grow. Take form=fmbd.GGL(), dt below %.2g s, or a "
        "smaller rho_inf", angle, _fastest(system, state), limit, h * limit / angle,
    )  # fmt: skip


def turned(solver: StepSolver, state: State, h: float) -> float:
    """phi of the module for a step h (s) with the velocity of a state, rad."""
    system = solver.system
    if not np.isfinite(state.q).all() or not np.isfinite(state.v).all() or not state.v.any():
        return 0.0
    before = _row_space(solver, state, state.q)
    after = _row_space(solver, state, system.compose(state.q, h * state.v))
    if not before.shape[1] or not after.shape[1]:
        return 0.0

    # the sine of the largest angle: what the smaller space has outside of the larger
    small, large = sorted((before, after), key=lambda basis: basis.shape[1])
    outside = small - large @ (large.T @ small)
    sine = float(np.linalg.norm(outside, 2))
    return float(np.arcsin(min(sine, 1.0)))


def _row_space(solver: StepSolver, state: State, q: Array) -> Array:
    """Orthonormal basis of L^-1 G^T with M = L L^T, rows on positions only, (n_v, rank)."""
    system = solver.system
    held = np.setdiff1d(np.arange(system.n_lam), speed_rows(system))
    ev = system.at(state.t, q, state.v)
    M = dense(solver.core_matrix(ev, Weights(1.0, 0.0, 0.0)))
    G = dense(ev.jacobian.core)[held].T

    # bodies without inertia in some direction: a little of it, which rows that hold them hardly feel
    M = 0.5 * (M + M.T) + 1e-12 * np.diag(np.maximum(np.diag(M), np.diag(M).max() * 1e-12))
    rows = sl.solve_triangular(np.linalg.cholesky(M), G, lower=True)
    rows = rows / np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    Q, s, _ = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(Q[:, s > RANK * max(float(s.max(initial=0.0)), 1e-300)])


def _fastest(system: System, state: State) -> str:
    """The body that turns fastest, quoted; of bodies without a frame all."""
    m, n = system.motions, system.n_frames
    if not n:
        return ", ".join(f'"{part.name}"' for part in system.parts)
    rates = state.v[: n * m.n_twist].reshape(n, m.n_twist)[:, m.dim :]
    return f'"{system.frame_names[int(np.linalg.norm(rates, axis=1).argmax())]}"'
