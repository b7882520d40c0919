"""Natural frequencies of one elastic body alone, of its field or of its modes: free, or with some of its surfaces held."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.linalg as sl

from ...checks import whole
from ...errors import require
from ...fem.fields import Field
from ...fem.mixed import make_field
from ...matrices import left_free
from ...rotations import Array
from ..elastic.floating import attachment
from ..elastic.modes import ConditionedBody, rigid_fields
from ..placements import FrameMotion
from .craig_bampton import independent
from .reduced import reduced_part


def natural_frequencies(body: Any, count: int, held: Sequence[str]) -> Array:
    """The first ``count`` natural frequencies (Hz) of an elastic body at rest and without load, ascending; collective.

    A free body has its rigid motions left out; a ``held`` surface keeps its mean position and rotation, as by a fixed joint.

    Raises:
        InputError: an energy instead of a linear form, an unknown surface, more modes than unknowns.
    """
    whole("frequencies: n", count, least=1)
    require(
        body.elastic is not None,
        f'Body "{body.name}": frequencies of one body need the linear form elastic(u, v, dx). With an energy, put the body into '
        "a scene and take fmbd.modes(scene, n).",
    )
    for name in held:
        body.surface(name)

    field = make_field(body.name, body.mesh, body.forms())
    try:
        # mean axes: no rigid motion is left
        columns = [attachment(field, name) for name in held] or [field.Q]
        conditioned = ConditionedBody(field, independent(field, [_as_motions(field, x) for x in columns]))
        try:
            return np.asarray(conditioned.vibration_modes(count)[0] / (2.0 * np.pi))
        finally:
            conditioned.destroy()
    finally:
        field.destroy()


def _as_motions(field: Field, conditions: Array) -> Array:
    """Conditions on a surface in the units of rigid motions: one on each mean displacement (m) and each mean rotation (over the
    size of the body, m).

    The moments of a thin face are small by the square of its thickness; its rotation is not.
    """
    unit = np.ones(conditions.shape[1])
    unit[field.dim :] = field.size
    rigid = rigid_fields(field) / unit
    return np.asarray(conditions @ np.linalg.inv(field.total(conditions.T @ rigid)).T)


def modal_frequencies(body: Any, count: int, held: Sequence[str]) -> Array:
    """:func:`natural_frequencies` of a body of modes: of all motions of its frame and modes that the held surfaces leave.

    Raises:
        InputError: an unknown surface, more frequencies than such motions.
    """
    whole("frequencies: n", count, least=1)
    for name in held:
        body.surface(name)
    part = reduced_part(body, 0, held)
    m, d = part.motions, part.dim
    rest = FrameMotion(0.0, np.eye(d), np.zeros(m.n_twist), None, np.zeros(d))
    of_frame, across, of_modes = part.mass_blocks(rest, np.zeros(part.n))
    M = np.block([[of_frame, across.T], [across, of_modes]])
    K = sl.block_diag(np.zeros((m.n_twist, m.n_twist)), part.constants.K)

    # what rigid motions and modes do to the held surfaces: mean displacements, and rotations as joints see them
    reference = part.reference.reshape(len(held), 1 + d, d)
    rigid = np.concatenate((np.zeros((*reference.shape, d)), m.lever(reference)), axis=-1)
    rigid[:, 0, range(d), range(d)] = 1.0
    moved = np.concatenate((rigid, part.port_matrix.reshape(*reference.shape, part.n)), axis=-1)
    moved = np.moveaxis(moved, -1, 1)
    turned = m.moment(np.eye(d), moved[:, :, 1:]).sum(axis=2)
    rows = np.concatenate((moved[:, :, 0], turned), axis=2).swapaxes(1, 2).reshape(len(held) * m.n_twist, len(M))

    V = left_free(rows)
    freely = left_free(rows[:, : m.n_twist]).shape[0]
    require(
        count <= len(V) - freely,
        f'Body "{body.name}": {count} natural frequencies asked for; its {part.n} modes have {len(V) - freely}.',
    )
    squares = sl.eigvalsh(V @ K @ V.T, V @ M @ V.T)[freely : freely + count]
    return np.asarray(np.sqrt(squares) / (2.0 * np.pi))
