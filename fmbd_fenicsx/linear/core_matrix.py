"""The replicated block of a step's matrix: rigid bodies, frames of elastic ones, and parts whose coordinates every rank holds.

                 frames      parts
    frames   [ cm M_ff               cm M_fl                     ]
    parts    [ cm M_lf               cm M_ll + cd C_ll + ck K_ll ]                                              (1)

Units of mass times those of the increments: kg, kg m, kg m^2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..matrices import summed
from ..mechanics.placements import FrameMotion, Part
from ..rotations import Array
from ..system.evaluation import Evaluation
from ..system.tangents.jacobian import dense_core
from .blocks.field_blocks import Weights


@dataclass(frozen=True, eq=False)
class LocalBlock:
    """A replicated part of number ``k`` in (1): its rows on its frame (n, n_twist), and on itself (n, n)."""

    k: int
    part: Part
    coupling: Array
    local: Array


def core_matrix(ev: Evaluation, w: Weights) -> Any:
    """(1) in a configuration, (n_core, n_core): dense, or sparse for many bodies; elastic bodies at U = 0."""
    s, n = ev.system, ev.system.motions.n_twist
    on_frames = np.zeros((s.n_frames + 1, n, n))  # the ground last
    if s.rigid is not None:
        on_frames[s.rigid.frame] = s.rigid.matrices()

    blocks = []
    motions = ev.tangent_motions(strained=bool(w.ck))
    for k, (part, motion) in enumerate(zip(s.parts, motions, strict=True)):
        of_frame, coupling, mass = part.mass_blocks(motion, s.local_q(ev.q, k))
        on_frames[part.frame] += of_frame
        # fields are eliminated: their own blocks stay with their factors
        if not part.distributed:
            blocks.append(LocalBlock(k, part, w.cm * coupling, _local(ev, k, motion, mass, w)))

    return _assembled(ev, w.cm * on_frames[:-1], blocks)


def _local(ev: Evaluation, k: int, motion: FrameMotion, mass: Array, w: Weights) -> Array:
    """cm M + cd C + ck K of the coordinates of a replicated part, (n, n)."""
    if not (w.ck or w.cd):
        return w.cm * mass
    K, C = ev.system.parts[k].stiffness_blocks(motion, ev.strained(k))
    return w.cm * mass + w.cd * C + w.ck * K


def _assembled(ev: Evaluation, frames: Array, blocks: list[LocalBlock]) -> Any:
    """(1) of the blocks of the frames (n_frames, n_twist, n_twist) and of the parts."""
    s, n = ev.system, ev.system.motions.n_twist
    shape, kind = (s.n_core, s.n_core), np.result_type(frames, *[block.local for block in blocks])
    out: Any
    if dense_core(s):
        out = np.zeros(shape, kind)
        view = out[: s.n_frames * n, : s.n_frames * n].reshape(s.n_frames, n, s.n_frames, n)
        view[range(s.n_frames), :, range(s.n_frames)] = frames
    else:
        given = frames, np.arange(s.n_frames), np.arange(s.n_frames + 1)
        of_frames = sp.bsr_matrix(given, shape=(n * s.n_frames,) * 2)  # there may be no frames
        out = summed(sp.csr_matrix(shape, dtype=kind), [(of_frames, 0, 0)])

    placed: list[tuple[Any, int, int]] = []
    for block in blocks:
        own, frame = s.slices[1][block.k].start, block.part.frame * n
        placed.append((block.local, own, own))
        # parts on the ground have no frame that moves
        if block.part.frame < s.n_frames:
            placed += (block.coupling, own, frame), (block.coupling.T, frame, own)
    return summed(out, placed)
