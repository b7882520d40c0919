"""A system with its reduced bodies by more modes: what the error of reduction of a run is measured against."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...mechanics.reduction.reduced import ReducedPart, reduced_part
from ...system.layout import State
from ...system.system import System


def finer_system(system: System, state: State) -> tuple[System, State] | None:
    """The same system and its state as given, with reduced bodies and beams by their finer bases; collective.

    Frames, ports, constraints and forces are the same. None where there is no reduced body. Computed once for each body.
    """
    m = system.motions
    parts: list[Any] = []
    q = [state.q[: system.counted_angles.stop]]
    v = [state.v[: system.n_frames * m.n_twist]]

    # frames stay; local coordinates begin anew in the finer basis
    for k, part in enumerate(system.parts):
        local = system.local_q(state.q, k), system.local_v(state.v, k)
        if isinstance(part, ReducedPart):
            body = part.body.with_refined_basis(part.surfaces)
            part = reduced_part(body, part.frame, part.surfaces)
            local = body.start_local()
        parts.append(part)
        q.append(local[0])
        v.append(local[1])

    if not any(isinstance(p, ReducedPart) for p in parts):
        return None
    finer = replace(system, parts=tuple(parts), cache={})
    zero = np.zeros(finer.n_v)
    return finer, State(state.t, np.concatenate(q), np.concatenate(v), zero, np.zeros(finer.n_lam))
