"""Reactions of joints that depend on each other: of all multipliers with the same forces the smallest.

Where rows of G depend on each other, G^T lambda does not determine lambda: what lies in the null space of G^T is a state of
stress between the joints that no rigid body feels. Of all multipliers with the same forces the one of smallest norm is taken,

    f -> f - N N^T f,        f = lambda / u,   G^T diag(u) N = 0,   N^T N = 1                                     (1)

in every step, for the multiplier itself: increments of minimum norm do not keep it small, since the null space turns with the
bodies and predictors extrapolate what lies in it. u makes moments comparable with forces
(:attr:`~fmbd_fenicsx.system.lengths.Measured.multiplier_units`): each counts as a pair of forces at the model's length, so the
result does not depend on the system of units.
"""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ..matrices import dense
from ..rotations import Array
from ..system.dependence import DEPENDENT
from ..system.evaluation import Evaluation
from ..system.layout import State
from ..system.mobility import SOFT
from .condensation import StepSolver
from .configuration_warnings import CORRECTIONS

PROBES = 3  # multipliers of no special direction that show which rows share
OPEN = 1e-6  # share of a multiplier of one above which its row shares
FAINT = 1e-12  # e of (2)
MOST = 100  # solutions of (2), of rows that nearly count as the same; of others three
SINGULAR = 1e-14  # singular values of a scaled matrix below this share belong to rows that depend on each other


def smallest(ev: Evaluation, lam: Array) -> Array:
    """Of multipliers, (k, n_lam), the smallest with the same forces, by a sparse factor: f = lambda / u of

        [ 1   A^T ] [f]   [0]
        [ A   -e  ] [z] = [b],        A = G^T diag(u), its rows scaled,  b = A f                                  (2)

    solved again for what is left. Of a singular value sigma of A a solution finds the share sigma^2 / (sigma^2 + e): of rows that
    count as the same, sigma below DEPENDENT, hardly any of what they differ by is followed; of others all that they bear.
    Collective.
    """
    s, G = ev.system, ev.jacobian
    ports = [sp.csr_matrix(dense(G.port[:, s.port_slice(k)])) for k, _ in s.fields]
    rows = sp.hstack((sp.csr_matrix(G.core), *ports)).T @ sp.diags(s.multiplier_units)
    size = abs(rows).max(axis=1).toarray().ravel()
    A = sp.diags(1.0 / np.where(size > 0, size, 1.0)) @ rows
    m, n = A.shape
    lu = splu(sp.block_array([[sp.identity(n), A.T], [A, -FAINT * sp.identity(m)]], format="csc"))

    given = (lam / s.multiplier_units).T
    f, z, left = np.zeros_like(given), np.zeros((m, len(lam))), A @ given
    enough, further = DEPENDENT * np.abs(left).max(initial=0.0), CORRECTIONS
    for _ in range(MOST):
        change = lu.solve(np.concatenate((-f - A.T @ z, left)))
        f, z = f + change[:n], z + change[n:]
        left = A @ (given - f)
        further -= np.abs(left).max(initial=0.0) <= enough
        if further < 0:
            break
    return np.asarray(s.multiplier_units * f.T)


def least(solver: StepSolver, t: float, q: Array, lam: Array) -> Array:
    """The smallest multipliers with the forces of ``lam``, (n_lam,) or (k, n_lam), in the configuration q at t (s); ``lam``
    itself where it is unique. Collective.
    """
    driver = solver.driver
    if not solver.core.redundant or not lam.size:
        return lam
    found = None if driver is None else driver.least(t, q, np.atleast_2d(lam))
    if found is not None:
        return found.reshape(lam.shape)

    return smallest(solver.system.at(t, q), np.atleast_2d(lam)).reshape(lam.shape)


def least_forces(S: Any, b: Array) -> Array:
    """Multipliers y, (m,) or (m, k), with S y = b for a sparse compliance S of rows that may depend on each other.

    Rows are softened, so that of all y one of small norm is found; what softness leaves open
    is closed twice, as in ``algebra/factor.c``.
    """
    size = np.sqrt(S.diagonal())
    scale = sp.diags(1.0 / np.where(size > 0, size, 1.0))
    lu = splu(sp.csc_matrix(scale @ S @ scale + SOFT * sp.identity(len(size))))
    y = lu.solve(scale @ b)
    for times in corrections(CORRECTIONS):
        y = y - lu.solve(times * SOFT * y)
    return np.asarray(scale @ y)


def corrections(count: int) -> list[float]:
    """How often further solutions ask for what softness leaves open, as ``correction`` of ``algebra/factor.c``."""
    return [1.0] * (count - 1) + [-float(count)] * (count > 0)


def not_unique(solver: StepSolver, state: State) -> list[str]:
    """Names of the joints and frames whose reactions are not unique in a state; collective."""
    system = solver.system
    if not solver.core.redundant:
        return []
    # what the smallest multipliers leave of any lies in the null space
    some = np.random.default_rng(0).normal(size=(PROBES, system.n_lam))
    u = system.multiplier_units
    with nullcontext() if solver.driver is None else solver.driver.idle():
        left = some - least(solver, state.t, state.q, u * some) / u
    open_rows = np.abs(left).max(axis=0) > OPEN

    return [block.name for block in system.blocks if open_rows[block.rows].any()]


def scaled_solution(J: Array, r: Array, *, redundant: int) -> Array:
    """J^-1 r with rows and columns scaled; where rows depend on each other the smallest solution.

    Raises LinAlgError where J is singular or not finite.
    """
    if not len(r):
        return r
    if not np.isfinite(J).all():
        raise np.linalg.LinAlgError("the tangent is not finite")

    largest = np.abs(J).max(axis=1)
    rows = 1.0 / np.where(largest > 0, largest, 1.0)
    largest = (rows[:, None] * np.abs(J)).max(axis=0)
    columns = 1.0 / np.where(largest > 0, largest, 1.0)
    scaled = rows[:, None] * J * columns
    if redundant:
        return np.asarray(columns * np.linalg.lstsq(scaled, rows * r, rcond=SINGULAR)[0])
    return np.asarray(columns * np.linalg.solve(scaled, rows * r))
