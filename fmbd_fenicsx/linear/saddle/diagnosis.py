"""Why a saddle point is singular: its null vector, told in terms of bodies and ties."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...fem.factors.factor import by_mumps
from ...rotations import Array
from ..rigid_modes import rigid_modes
from .saddle import SaddlePoint

NULL = 1e-7  # |A x| / (|A| |x|) below which x counts as a null vector
SHIFT = 1e-9  # of the scaled matrix, which can be factored then


def diagnose(saddle: SaddlePoint) -> str:
    """A sentence on the null vector of the saddle point, found by inverse iteration with a small shift;
    collective.
    """
    x, size = _null_vector(saddle)
    if not size < NULL:
        return "No null vector was found: the system is badly scaled, or the iteration needs more steps."

    u, lam = x
    energy = [float(e.body.total(np.array(v @ v))) for e, v in zip(saddle.elastic, u, strict=True)]
    forces = [float(np.linalg.norm(v)) for v in lam]
    sentences = []

    # a motion of bodies, or multipliers that nothing determines
    if energy and np.sqrt(max(energy)) > 1e-3:
        moving = [k for k, v in enumerate(energy) if v > 1e-2 * max(energy)]
        sentences += [_motion(saddle.elastic[k], u[k]) for k in moving]
    elif forces:
        names = [f'"{t.name}"' for t, v in zip(saddle.ties, forces, strict=True) if v > 1e-2 * max(forces)]
        if len(names) == 1:
            sentences.append(
                f"Multipliers of {names[0]} are not determined: its multiplier space does not satisfy the inf-sup condition "
                "beside V_h, or rows repeat. See infsup(), or choose another space."
            )
        else:
            sentences.append(
                f"Multipliers of {' and '.join(names)} depend on each other: they hold the same nodes. Use "
                "merged ends, or remove one."
            )

    return " ".join(sentences)


def _null_vector(saddle: SaddlePoint) -> tuple[tuple[list[Array], list[Array]], float]:
    """Blocks of the null vector of unit size, and the relative residual of what it is in the scaled matrix."""
    matrix = saddle.matrix.copy()
    matrix.convert("aij")
    scale = _scaled(matrix, sum(saddle.rows[: len(saddle.elastic)]))

    x, size = _inverse_iteration(matrix, saddle.comm)
    x.array[:] *= scale
    x.normalize()

    blocks = saddle.blocks(x)
    for one in (matrix, x):
        one.destroy()
    return blocks, size


def _scaled(matrix: Any, forces: int) -> Array:
    """Scale a matrix from both sides in place; by what. Units of forces, the first rows, and of constraints go out of it."""
    top = matrix.getDiagonal().array[:forces]
    scale = np.ones(matrix.getLocalSize()[0])
    scale[:forces] = 1.0 / np.sqrt(np.maximum(np.abs(top), 1e-300))
    _scale(matrix, scale)

    # constraints have no diagonal, but rows
    of_rows = np.ones(len(scale))
    of_rows[forces:] = 1.0 / np.maximum(_row_norms(matrix)[forces:], 1e-300)
    _scale(matrix, of_rows)
    return scale * of_rows


def _scale(matrix: Any, by: Array) -> None:
    vector = matrix.createVecRight()
    vector.array[:] = by
    matrix.diagonalScale(vector, vector)
    vector.destroy()


def _inverse_iteration(matrix: Any, comm: Any) -> tuple[Any, float]:
    """A vector x of unit size after four solutions with A + shift from a random one, and |A x|."""
    from petsc4py import PETSc

    shifted = matrix.copy()
    shifted.shift(SHIFT)
    ksp = PETSc.KSP().create(comm)
    ksp.setOperators(shifted)
    by_mumps(ksp, "lu")

    x, y = matrix.createVecs()
    x.array[:] = np.random.default_rng(3 + comm.rank).standard_normal(x.getLocalSize())
    for _ in range(4):
        x.normalize()
        ksp.solve(x, y)
        y.copy(x)
    x.normalize()

    matrix.mult(x, y)
    size = y.norm() if np.isfinite(x.norm()) else np.inf
    for one in (shifted, ksp, y):
        one.destroy()
    return x, size


def _row_norms(A: Any) -> Array:
    low, high = A.getOwnershipRange()
    indptr, _, values = A.getValuesCSR()
    out = np.zeros(high - low)
    np.add.at(out, np.repeat(np.arange(high - low), np.diff(indptr)), values**2)
    return np.sqrt(out)


def _motion(e: Any, u: Array) -> str:
    """The rigid motion nearest to u, in words."""
    body = e.body
    modes = rigid_modes(body)
    gram = body.total(modes.T @ modes)
    right = body.total(modes.T @ u)
    norm = float(body.total(np.array(u @ u)))

    # its share of rigid motions
    c = np.linalg.solve(gram, right)
    rigid = float(c @ gram @ c) / norm
    d = body.dim
    if rigid < 0.99:
        return (
            f'Zero-energy motion of body "{body.name}" that is not rigid: its elastic form leaves a deformation free.'
        )

    # translation, or rotation about the point that stands still
    t = c[:d]
    w = c[d:] / body.size
    if np.linalg.norm(w) * body.size < 1e-3 * np.linalg.norm(t):
        return f'Zero-energy motion: body "{body.name}" translates along {np.round(t / np.linalg.norm(t), 3).tolist()}.'
    if d == 2:
        center = body.center + np.array([-t[1], t[0]]) / w[0]
        return f'Zero-energy motion: body "{body.name}" rotates about {np.round(center, 4).tolist()}.'
    axis = w / np.linalg.norm(w)
    center = body.center + np.cross(w, t) / (w @ w)
    where = f"{np.round(axis, 3).tolist()} through {np.round(center, 4).tolist()}"
    return f'Zero-energy motion: body "{body.name}" rotates about the axis {where}.'
