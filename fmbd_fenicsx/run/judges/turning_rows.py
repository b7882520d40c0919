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

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs, dtrtrs

from ...linear.condensation import StepSolver
from ...log import log
from ...matrices import RANK, dense
from ...rotations import Array
from ...system.layout import State
from ...system.speed_rows import speed_rows
from ...system.system import System

LARGEST = 150  # replicated coordinates up to which the angle is looked at


def warn_of_turning_rows(solver: StepSolver, limit: float | None, states: Sequence[State], h: float) -> None:
    """Warn where rows turn beyond the scheme's limit (rad) in one of the states; no fields, not collective."""
    system = solver.system
    if limit is None or system.fields or not 0 < system.n_core <= LARGEST:
        return
    angle, state = max(zip(turned(solver, states, h, least=limit), states, strict=True), key=lambda found: found[0])
    if angle <= limit:
        return
    log.warning(
        "joints turn by %.2g rad a step (fastest: %s), more than the %.2g rad that this scheme's memory of accelerations bears: "
        "reactions and accelerations may alternate from step to step and grow. Take form=fmbd.GGL(), dt below %.2g s, or a "
        "smaller rho_inf", angle, _fastest(system, state), limit, 0.9 * h * limit / angle,
    )  # fmt: skip


def turned(solver: StepSolver, states: Sequence[State], h: float, *, least: float = 0.0) -> list[float]:
    """phi of the module for a step h (s) with the velocity of each state, rad; 0 where it is certainly below ``least``."""
    angles = [0.0] * len(states)
    moving = [i for i, s in enumerate(states) if np.isfinite(s.q).all() and np.isfinite(s.v).all() and s.v.any()]
    if not moving:
        return angles

    sine = float(np.sin(least))
    for i, (before, after) in zip(moving, _columns(solver, [states[i] for i in moving], h), strict=True):
        if before.shape[1] and not _certainly_below(sine, before, after):
            angles[i] = _angle(before, after)
    return angles


def _angle(before: Array, after: Array) -> float:
    """The largest principal angle between the spaces of two sets of columns: what the smaller has outside of the larger."""
    small, large = sorted((_space(before), _space(after)), key=lambda basis: basis.shape[1])
    if not small.shape[1]:  # no row holds anything
        return 0.0
    outside = small - large @ (large.T @ small)
    sine = float(np.linalg.norm(outside, 2))
    return float(np.arcsin(min(sine, 1.0)))


def _columns(solver: StepSolver, states: Sequence[State], h: float) -> Iterator[tuple[Array, Array]]:
    """L^-1 G^T of the rows that hold places, with M = L L^T, columns of size 1, (n_v, rows): of each state, and a step h (s)
    later.
    """
    system = solver.system
    t, q, v = np.array([s.t for s in states]), np.array([s.q for s in states]), np.array([s.v for s in states])
    later = system.compose(q, h * v)
    both = system.batch(np.concatenate((t, t)), np.concatenate((q, later)), np.concatenate((v, v)))
    holding = np.ones(system.n_lam, dtype=bool)
    holding[speed_rows(system)] = False
    rows = both.jacobian.core[:, holding]

    for k, s in enumerate(states):
        yield _scaled(_masses(solver, s, s.q), rows[k]), _scaled(_masses(solver, s, later[k]), rows[len(t) + k])


def _masses(solver: StepSolver, state: State, q: Array) -> Array:
    """L of the masses at a place with the velocity of a state; those of rigid bodies alone stay, and are factored once."""
    system, name = solver.system, "mass factor"
    if system.parts:
        return _factored(solver.masses(system.at(state.t, q, state.v)))
    if name not in system.cache:
        system.cache[name] = _factored(solver.masses(system.at(state.t, q, state.v)))
    return np.asarray(system.cache[name])


def _factored(matrix: Any) -> Array:
    """L of M = L L^T."""
    M = dense(matrix)

    # bodies without inertia in some direction: a little of it, which rows that hold them hardly feel
    diagonal = M.diagonal()
    M = 0.5 * (M + M.T) + 1e-12 * np.diag(np.maximum(diagonal, diagonal.max() * 1e-12))
    factor, fault = dpotrf(M, lower=1, clean=1, overwrite_a=1)
    if fault:
        raise np.linalg.LinAlgError("The masses of a state are not positive.")
    return np.asarray(factor)


def _scaled(factor: Array, rows: Array) -> Array:
    """L^-1 G^T, its columns of size 1."""
    columns = dtrtrs(factor, rows.T, lower=1)[0]
    return np.asarray(columns / np.maximum(np.sqrt((columns * columns).sum(axis=0)), 1e-300))


def _certainly_below(sine: float, before: Array, after: Array) -> bool:
    """Whether the largest angle between the spaces of two sets of columns B and C has certainly a smaller sine: it is at most
    |(1 - B (B^T B)^-1 B^T) C L^-T| with L L^T = C^T C. Not told of columns that nearly depend on each other.
    """
    first, fault = dpotrf(before.T @ before, lower=1)
    second, other = dpotrf(after.T @ after, lower=1)
    if fault or other or min(first.diagonal().min(), second.diagonal().min()) < 1e-5:
        return False
    outside = after - before @ dpotrs(first, before.T @ after, lower=1)[0]
    share = dtrtrs(second, outside.T, lower=1)[0]
    return bool((share * share).sum() < sine * sine)


def _space(rows: Array) -> Array:
    """Orthonormal basis of the space of columns, (n_v, rank)."""
    Q, s, _ = np.linalg.svd(rows, full_matrices=False)
    # left singular vectors, those of roundoff aside
    return np.asarray(Q[:, s > RANK * max(float(s.max(initial=0.0)), 1e-300)])


def _fastest(system: System, state: State) -> str:
    """The body that turns fastest, quoted; of bodies without a frame all."""
    if not system.n_frames:
        return ", ".join(f'"{part.name}"' for part in system.parts)
    return f'"{system.frame_names[int(system.turning(state.v).argmax())]}"'
