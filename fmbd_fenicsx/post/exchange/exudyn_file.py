"""A reduced body as a file that Exudyn reads: the integrals of its floating frame formulation, without any mesh.

With the nodal fields Z_0 = X, Z_a = Phi_a and the sums S_a, T_ab of ``mechanics.reduction.reduced``, and a~ the matrix of a x,

    sum Z~_a^T M Z~_b = tr(T_ab) I - T_ab^T,     sum Z~_a^T M Z_b = -(e_kij T_ab,ij)_k,     sum M Z~_a = S~_a         (1)

are all that ``ObjectFFRFreducedOrder`` holds (A. Zwoelfer, J. Gerstmayr, doi:10.1007/s00707-020-02886-2). Nothing is lost: its
equations are those of the reduced body. Markers of Exudyn sit on nodes, so each interface becomes seven: its centre and
the ends of a cross about it, moved by the mean translation and mean rotation of the surface.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError, require
from ...log import log
from ...mechanics.reduction.reduced import ReducedConstants
from ...ranks import on_root
from ...rotations import Array, hat

if TYPE_CHECKING:
    from .interface_model import InterfaceModel

NODES = 7  # of an interface: the centre, then the ends of three axes
ARM = 0.05  # half a cross over the size of the body
ALTERNATING = np.zeros((3, 3, 3))
ALTERNATING[(0, 1, 2), (1, 2, 0), (2, 0, 1)], ALTERNATING[(0, 2, 1), (2, 1, 0), (1, 0, 2)] = 1.0, -1.0


def save_exudyn(model: InterfaceModel, file: str | Path) -> Path:
    """Write ``model`` for ``ObjectFFRFreducedOrderInterface().LoadFromFile``; see :meth:`InterfaceModel.save_exudyn`."""
    from mpi4py import MPI

    from .files import write_whole

    file = Path(file)
    constants = _checked(model, file)
    _tell_damping(constants, file)
    content = {**_integrals(constants), **_skeleton(model, constants)}
    on_root(MPI.COMM_WORLD, lambda: write_whole("The body", file, lambda place: np.savez(place, **content)))
    return file


def _checked(model: InterfaceModel, file: Path) -> ReducedConstants:
    """The constants of a body that Exudyn can hold."""
    require(file.suffix == ".npz", f'Exudyn file "{file}": the name must end in .npz, found "{file.suffix}".')
    if model.body is None or model.motion is None:
        raise InputError(
            "This interface model holds M, K and D at rest only; a body that turns needs its inertia tensors as well. "
            "Make it anew by fmbd.interface_model(body, ...)."
        )
    c = model.body
    require(len(c.S) == 3, "Exudyn's reduced bodies are spatial, this one is plane. Mesh it in space.")
    require(not c.loads, "Loads of the body cannot be kept in Exudyn's file. Save the body without loads.")
    require(
        c.stiffening is None,
        "Exudyn's reduced bodies have no geometric stiffening, this one has. Build it without stiffening=.",
    )
    return c


def _tell_damping(c: ReducedConstants, file: Path) -> None:
    """Damping is given to Exudyn by two factors, which its file does not hold: say them.

    Raises:
        InputError: the damping is no a M + b K.
    """
    if not c.D.any():
        return

    # a and b by least squares, mass and stiffness each of unit size
    parts = np.trace(c.T[1:, 1:], axis1=2, axis2=3), c.K
    columns = np.stack([A.ravel() for A in parts], axis=1)
    scale = np.linalg.norm(columns, axis=0)
    factors = np.linalg.lstsq(columns / scale, c.D.ravel(), rcond=None)[0] / scale

    miss = np.abs(columns @ factors - c.D.ravel()).max()
    require(
        bool(miss <= 1e-8 * np.abs(c.D).max()),
        "Exudyn's reduced bodies know damping a M + b K only, this one has another. Build it with mass_damping= and "
        "stiffness_damping= alone.",
    )

    # factors of roundoff are zero
    a, b = np.where(np.abs(factors) * scale > 1e-9 * np.linalg.norm(c.D), factors, 0.0)
    log.warning(
        "%s does not hold the damping: give massProportionalDamping=%.12g, stiffnessProportionalDamping=%.12g to "
        "AddObjectFFRFreducedOrder.",
        file,
        a,
        b,
    )


def _integrals(c: ReducedConstants) -> dict[str, Any]:
    """(1) by the names of Exudyn."""
    m = c.n_modes
    turning = np.trace(c.T, axis1=2, axis2=3)[:, :, None, None] * np.eye(3) - c.T.transpose(0, 1, 3, 2)
    moving = -np.einsum("kij,abij->akb", ALTERNATING, c.T)
    center = c.S[:, 0] / c.mass

    return {
        # the rigid body
        "totalMass": c.mass,
        "Mtt": c.mass * np.eye(3),
        "chiU": center,
        "chiUtilde": hat(center),
        "inertiaLocal": turning[0, 0],
        # the modes
        "massMatrixReduced": np.trace(c.T[1:, 1:], axis1=2, axis2=3),
        "stiffnessMatrixReduced": c.K,
        "mPsiTildePsi": moving[1:, :, 1:].reshape(3 * m, m),
        "mPsiTildePsiTilde": turning[1:, 1:].transpose(0, 2, 1, 3).reshape(3 * m, 3 * m),
        # between the two
        "mPhitTPsi": c.S[:, 1:],
        "mPhitTPsiTilde": _side_by_side([hat(s) for s in c.S[:, 1:].T]),
        "mXRefTildePsi": moving[0, :, 1:],
        "mXRefTildePsiTilde": _side_by_side(list(turning[0, 1:])),
    }


def _side_by_side(blocks: list[Array]) -> Array:
    """Blocks (3, 3) in one row; none for a body without modes."""
    return np.concatenate([np.zeros((3, 0)), *blocks], axis=1)


def _skeleton(model: InterfaceModel, c: ReducedConstants) -> dict[str, Any]:
    """Nodes, their displacements by modes, and triangles to look at, by the names of Exudyn."""
    assert model.motion is not None
    arms = ARM * c.size * np.concatenate((np.zeros((1, 3)), np.eye(3), -np.eye(3)))
    nodes = (model.origins - c.center)[:, None] + arms

    # u = mean translation + mean rotation x arm
    by_modes = model.motion.reshape(len(nodes), 2, 3, c.n_modes)
    shift, turn = by_modes[:, 0], by_modes[:, 1]
    lever = np.array([hat(arm) for arm in arms])
    moved = shift[:, None] - np.einsum("nij,kjm->knim", lever, turn)

    # an octahedron on each interface
    corners = [(1, 2, 3), (2, 4, 3), (4, 5, 3), (5, 1, 3), (2, 1, 6), (4, 2, 6), (5, 4, 6), (1, 5, 6)]
    triangles = [np.array(t) + NODES * k for k in range(len(nodes)) for t in corners]
    count = c.n_modes
    return {
        "fileVersion": 1,
        "type": "ObjectFFRFreducedOrderInterface",
        "rigidBodyNodeType": "NodeType.RotationEulerParameters",
        "infoList": np.array([count, nodes.size // 3, 3, 4, 7, 7 + count]),
        "xRef": nodes.ravel(),
        "modeBasis": moved.reshape(nodes.size, count),
        "trigList": np.array(triangles),
        "postProcessingModes": np.array({}, dtype=object),
    }
