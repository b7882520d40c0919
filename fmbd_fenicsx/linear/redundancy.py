"""Reactions of joints that depend on each other: of all multipliers with the same forces the smallest.

Where rows of G depend on each other, G^T lambda does not determine lambda: what lies in the null space of G^T is a state of
stress between the joints that no rigid body feels. Of all multipliers with the same forces the one of smallest norm is taken,

    lambda -> lambda - N N^T lambda,        G^T N = 0,  N^T N = 1                                                (1)

in every step, for the multiplier itself: increments of minimum norm do not keep it small, since the null space turns with the
bodies and predictors extrapolate what lies in it. The norm counts forces in N and moments in N m alike, so the share of each in
a stress that is not determined depends on the unit of length; forces on bodies do not.
"""

from __future__ import annotations

import numpy as np

from ..rotations import Array
from ..system.system import Evaluation, State
from .condensation import StepSolver

DEPENDENT = 1e-8  # singular values of G, scaled, below this share of the largest belong to the null space


def null_space(ev: Evaluation) -> Array:
    """N of (1) at a configuration, (n_lam, k); collective."""
    s, G = ev.system, ev.jacobian
    if not s.n_lam:
        return np.zeros((0, 0))

    # rows of the core, in lengths, and of the surfaces of elastic bodies
    ports = [_dense(G.port[:, s.port_slice(k)]) for k, _ in s.fields]
    rows = np.concatenate((_dense(G.core) / s.units[: s.n_core], *ports), axis=1)
    size = np.sqrt((rows * rows).sum(axis=1))
    scale = 1.0 / np.where(size > 0, size, 1.0)

    U, stretch, _ = np.linalg.svd(scale[:, None] * rows)
    rank = int((stretch > DEPENDENT * stretch[0]).sum())
    return np.asarray(np.linalg.qr(scale[:, None] * U[:, rank:])[0])


def least(solver: StepSolver, ev: Evaluation, lam: Array) -> Array:
    """The smallest multiplier with the forces of ``lam`` in a configuration; ``lam`` itself where it is unique. Collective."""
    if not solver.core.redundant or not len(lam):
        return lam
    N = null_space(ev)
    return lam - N @ (N.T @ lam)


def not_unique(solver: StepSolver, state: State) -> list[str]:
    """Names of the joints and frames whose reactions are not unique in a state; collective."""
    system = solver.system
    if not solver.core.redundant:
        return []
    N = null_space(system.at(state.t, state.q))
    open_rows = np.abs(N).max(axis=1, initial=0.0) > 1e-6
    return [block.name for block in system.blocks if open_rows[block.rows].any()]


def _dense(x: Array) -> Array:
    """A matrix of numbers, or of SciPy, as an array."""
    return x if isinstance(x, np.ndarray) else np.asarray(x.toarray())
