"""Whether the vibration modes of reduced bodies give way to the joints that hold them.

Modes of a free body, or of one clamped elsewhere, carry no force on its surfaces: what a clamp bends there is the sum of many
of them. By m modes the first frequency of a strip in a clamp is some 1.4 / m of it too high, by those of Craig and Bampton it is
right at once. What half of the modes tell shows how far all of them are off.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..matrices import dense
from ..mechanics.bodies.beams import Beam
from ..mechanics.reduction.craig_bampton import FrameModes, ReducedBody
from ..mechanics.reduction.reduced import ReducedPart
from ..rotations import Array
from .evaluation import Evaluation
from .layout import RowBlock
from .spins import mode_by_modes

SHARE = 0.02  # of a first frequency that half of the modes may change
HELD = 1e-6  # part of a rotation in the rows of a joint that is none
LOOK = 300  # constraint rows up to which bodies are looked at


def stiff_modes(ev: Evaluation) -> str:
    """Which bodies joints hold too stiffly by their modes, as a sentence; "" where none are."""
    s = ev.system
    free = [(k, part) for k, part in s.core_parts if isinstance(part, ReducedPart) and _by_frequency(part)]
    if not free or not 0 < s.n_lam <= LOOK:
        return ""

    rows = dense(ev.jacobian.core)
    for k, part in free:
        if not any(_turns_with(ev, k, part, rows, block) for block in s.blocks):
            continue
        all_modes, half = (mode_by_modes(ev, k, part, rows, n)[0] / (2 * np.pi) for n in (part.n, part.n // 2))
        if half > (1 + SHARE) * all_modes or np.isinf(all_modes):
            found = f"{_hertz(all_modes)} by all of them, {_hertz(half)} by half"
            return (
                f'body "{part.name}" is stiffer between its joints by its {part.n} modes than it is: its first frequency there '
                f"is {found}. {_remedy(part)}"
            )
    return ""


def _remedy(part: ReducedPart) -> str:
    if isinstance(part.body, Beam):
        return "Take modes=None, which keeps all of its elements"
    return "Take reduced(basis=fmbd.CraigBampton(...)) with the surfaces that joints hold"


def _hertz(frequency: float) -> str:
    return f"{frequency:.4g} Hz" if np.isfinite(frequency) else "none"


def _turns_with(ev: Evaluation, k: int, part: ReducedPart, rows: Array, block: RowBlock) -> bool:
    """Whether a joint holds a rotation of its point on the reduced body k: forces alone are carried by few modes."""
    s, n, d = ev.system, ev.system.motions.n_twist, ev.system.motions.dim
    of_joint = rows[block.rows.start : block.rows.stop]
    if block.a < 0 or not of_joint[:, s.slices[1][k]].any():
        return False

    # rotations of the frame about the point of the joint
    on_frame = of_joint[:, n * part.frame : n * (part.frame + 1)]
    place, axes = ev.q[s.motions.n_pose * part.frame :][:d], np.eye(n - d)
    lever = place - ev.kin.x[block.a]
    turned = axes @ ev.rotation[part.frame].T if d == 3 else axes
    about = np.cross(turned, lever) if d == 3 else np.array([[-lever[1], lever[0]]])
    moved = on_frame @ np.hstack((about, axes)).T
    return bool(np.abs(moved).max() > HELD * np.abs(on_frame[:, d:]).max(initial=0.0))


def _by_frequency(part: ReducedPart) -> bool:
    """Whether a body has vibration modes alone, the lowest first."""
    body = part.body
    alone = body.modes is not None if isinstance(body, Beam) else _has_frame_modes(body)
    return alone and part.n > 1


def _has_frame_modes(body: Any) -> bool:
    return isinstance(body, ReducedBody) and isinstance(body.basis, FrameModes)
