"""Domain decomposition: the elastic block of a distributed body as PETSc's MATIS: each rank keeps the matrix of its own cells.

BDDC (Dohrmann, doi:10.1137/S1064827502412887) then needs a bounded number of iterations.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc

from ...fem.fields import Field
from ..rigid_modes import attach_modes, rigid_modes


def unassembled(body: Field, cm: float, ck: float) -> Any:
    """cm M + ck K of a distributed body as MATIS over the nodes of each rank's own cells, with rigid-body modes; collective.

    The map from local to global rows has block size 1: with the block map that DOLFINx gives, BDDC of PETSc 3.22 finds no
    interface and returns at once, "converged" and wrong. Nodes that belong to ghost cells only are left out.
    """
    import dolfinx.fem.petsc as fp

    d, space = body.dim, body.space

    whole = fp.create_matrix(body.stiffness_form, "is")
    whole.zeroEntries()
    fp.assemble_matrix(whole, body.mass_form)
    whole.assemble()
    whole.scale(cm / ck)
    fp.assemble_matrix(whole, body.stiffness_form)
    whole.assemble()
    whole.scale(ck)

    # rows of the nodes of this rank's own cells
    topology = body.mesh.dolfinx.topology
    nodes = np.unique(space.dofmap.list[: topology.index_map(topology.dim).size_local]).astype(np.int32)
    local = (d * nodes[:, None] + np.arange(d)).ravel().astype(PETSc.IntType)
    rows = space.dofmap.index_map.local_to_global(nodes)
    rows = (d * rows[:, None] + np.arange(d)).ravel().astype(PETSc.IntType)

    sets = PETSc.IS().createGeneral(local, comm=PETSc.COMM_SELF)
    own = whole.getISLocalMat().createSubMatrix(sets, sets)
    lgmap = PETSc.LGMap().create(rows, comm=body.comm)
    size = (body.n * d, body.n_global)
    A = PETSc.Mat().createIS((size, size), lgmapr=lgmap, lgmapc=lgmap, comm=body.comm)
    A.setISLocalMat(own)
    A.assemble()
    A.setOption(PETSc.Mat.Option.SPD, True)
    A.setOption(PETSc.Mat.Option.SYMMETRIC, True)

    # rigid motions, which the coarse problem has to hold
    attach_modes(A, rigid_modes(body))
    for obj in (own, sets, lgmap, whole):
        obj.destroy()
    return A
