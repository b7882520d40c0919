"""Whether a state belongs to a system: as many unknowns, and joints that it closes."""

from __future__ import annotations

import numpy as np

from ..errors import InputError, require
from .layout import State
from .system import System

APART = 1e-3  # of the model's length (m, rad): joints that are open by more are those of another scene


def refuse_other_state(system: System, state: State, scene: str) -> None:
    """Refuse a state of another scene; collective. ``scene``: the name of this one, for the message.

    Scenes of as many bodies and joints have states of the same sizes: what tells them apart is whether the bodies fit together.
    """
    require(
        (len(state.q), len(state.v), len(state.lam)) == (system.n_q, system.n_v, system.n_lam),
        f'The state belongs to another scene or number of ranks: {len(state.q)} coordinates, "{scene}" has {system.n_q}.',
    )
    gaps = np.abs(system.row_units * system.at(state.t, state.q, state.v).constraint())
    if not gaps.size:
        return
    worst = int(np.argmax(gaps))
    if gaps[worst] > APART * system.length or not np.isfinite(gaps).all():
        joint = system.block_of(worst).name
        raise InputError(
            f'The state belongs to another scene: in "{scene}" it leaves "{joint}" open by {gaps[worst]:.3g} m. Give a '
            "state of a run, an equilibrium or a stepper of this scene."
        )
