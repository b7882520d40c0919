"""What follows from the constants of reduced bodies alone: of all bodies of a scene with as many modes at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...rotations import Array
from ..elastic.second_order import rigid_masses

if TYPE_CHECKING:
    from .reduced import ReducedConstants

STILL = 1e-9  # of what a mode moves, which is no motion of the whole


@dataclass(frozen=True, eq=False)
class Derived:
    """What follows from constants alone.

    Attributes: ``mass`` (m, m) of the modes, kg; ``rms`` (m,) of their displacements over the mass, m; ``rates`` (n_twist, m)
    mean twist of the mass in a frame that hangs on a part of it, None in mean axes, where it is roundoff;
    ``first_frequency`` of the free modes, rad/s; ``principal``: second moments of mass, ascending, and axes.
    """

    mass: Array
    rms: Array
    rates: Array | None
    first_frequency: float
    principal: tuple[Array, Array]


def derive(constants: Sequence[ReducedConstants]) -> None:
    """Keep with constants what follows from them: of all with as many modes at once."""
    alike: dict[tuple[int, ...], list[ReducedConstants]] = {}
    for c in constants:
        if "derived" not in vars(c):
            alike.setdefault(c.S.shape, []).append(c)
    for mine in alike.values():
        for c, made in zip(mine, derived(mine), strict=True):
            vars(c)["derived"] = made


def derived(constants: Sequence[ReducedConstants]) -> list[Derived]:
    """Of constants with as many modes."""
    d, m = constants[0].S.shape[0], constants[0].n_modes
    mass, size = (np.array([getattr(c, name) for c in constants], dtype=float) for name in ("mass", "size"))
    S, K = (np.stack([getattr(c, name) for c in constants]) for name in ("S", "K"))
    modal = np.stack([np.trace(c.T[1:, 1:], axis1=2, axis2=3) for c in constants])
    about = np.stack([c.T[0] for c in constants])  # int rho X Z_a^T, (b, m + 1, d, d)
    rms = np.sqrt(np.diagonal(modal, axis1=1, axis2=2) / mass[:, None])

    # moments of what modes do, about the axes of rotation
    turned = about[:, 1:]
    pairs = ((1, 2), (2, 0), (0, 1)) if d == 3 else ((0, 1),)
    moments = np.stack([turned[..., i, j] - turned[..., j, i] for i, j in pairs], axis=1)
    J = rigid_masses(mass, S[:, :, 0], about[:, 0])
    rates = np.linalg.solve(J, np.concatenate((S[:, :, 1:], moments), axis=1))
    moved = np.abs(rates) * np.where(np.arange(rates.shape[1])[:, None] < d, 1.0, size[:, None, None])
    hangs = (moved > STILL * rms[:, None]).any(axis=(1, 2))

    first = np.full(len(constants), np.inf)
    if m:
        L = np.linalg.cholesky(modal)
        scaled = np.linalg.solve(L, np.linalg.solve(L, K).swapaxes(1, 2))
        first = np.sqrt(np.linalg.eigvalsh(scaled)[:, 0])
    sizes, axes = np.linalg.eigh(about[:, 0])
    return [
        Derived(modal[i], rms[i], rates[i] if hangs[i] else None, float(first[i]), (sizes[i], axes[i]))
        for i in range(len(constants))
    ]
