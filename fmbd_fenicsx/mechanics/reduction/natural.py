"""Natural frequencies of one elastic body alone: free, or with some of its surfaces held."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...checks import whole
from ...errors import require
from ...fem.fields import Field
from ...fem.mixed import make_field
from ...rotations import Array
from ..elastic.floating import attachment
from ..elastic.modes import ConditionedBody, rigid_fields
from .craig_bampton import independent


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
