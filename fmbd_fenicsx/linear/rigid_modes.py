"""Rigid motions of an elastic field: the near-nullspace of its matrix, the coarse space of multigrid and of the multipliers."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..fem.fields import Field
from ..rotations import Array


def elastic_matrix(body: Field, cm: float, ck: float, cd: float = 0.0) -> Any:
    """cm M + cd D + ck K as a PETSc aij matrix with rigid-body modes for multigrid; collective. The caller destroys it."""
    from petsc4py import PETSc

    E = body.combination(cm, ck, cd)
    E.setOption(PETSc.Mat.Option.SPD, cm > 0)
    E.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    attach_modes(E, rigid_modes(body))
    return E


def rigid_modes(body: Field) -> Array:
    """Translations and linear rotations at the owned nodes, (n d, n_twist)."""
    return modes_at(body, body.X)


def modes_at(body: Field, x: Array) -> Array:
    """The same at points x (n, d) about the centre of mass; all modes of one size."""
    out = body.motions.rigid(x)
    out[:, :, body.dim :] /= body.size
    return out.reshape(-1, body.motions.n_twist)


def rigid_mass(body: Field, modes: Array) -> Array:
    """R^T M R of the modes R; collective."""
    MR = np.stack([body.mass(r.reshape(-1, body.dim)).ravel() for r in modes.T], axis=1)
    return body.total(modes.T @ MR)


def attach_modes(A: Any, modes: Array) -> None:
    """Columns (rows of this rank, k) as the near-nullspace of A; collective."""
    from petsc4py import PETSc

    vectors: list[Any] = []
    for column in modes.T:
        v = A.createVecRight()
        v.array[:] = column
        # PETSc asks for orthonormal vectors (Gram-Schmidt)
        for w in vectors:
            v.axpy(-w.dot(v), w)
        v.normalize()
        vectors.append(v)

    near = PETSc.NullSpace().create(vectors=vectors, comm=A.getComm())
    A.setNearNullSpace(near)
    for obj in (near, *vectors):
        obj.destroy()
