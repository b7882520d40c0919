"""Stiff springs as rows with a compliance: their efforts are unknowns of a step beside the multipliers.

A stiff spring holds two markers nearly like a rigid link. Its effort k s is known to roundoff of places times k only, and acts
along a direction that an iteration with a frozen tangent has of another configuration: across the spring both are errors of the
motion. With the effort N of each spring as an unknown, a system without these springs and with one more row for each,

    M a + h + G^T lambda + R^T N = 0,        k (s - free) + c s' - N = 0,        R = ds/dv                            (1)

has the equations of one with rigid links, and their iterations, for any k. Their rows and those of the joints are rows of one
system, which :func:`stiff_ties` makes: whoever evaluates a system evaluates these too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...mechanics.forces.force_elements import ScalarLoads
from ...mechanics.joints.constraints import Motion
from ...mechanics.joints.couplings import CouplingBatch
from ...mechanics.joints.relative import RelativeCoordinates, Separation, Slide
from ...rotations import Array
from ..evaluation import Evaluation
from ..system import System

STIFF = 1e6  # a spring is a tie where the lightest body's weight stretches it by a smaller share of the model's length
LIGHT = 9.81  # m/s^2: springs are measured by weights on earth at least, for a start at rest tells nothing of forces to come


@dataclass(frozen=True, eq=False)
class StiffTies:
    """The stiff springs of a system. ``system``: (1), with springs as rows; ``joints``, ``ties``: their places among its rows.

    ``stiffness`` (N/m) and ``damping`` (N s/m), (p,); ``springs``: where the springs stood, batches with the places in them.
    """

    system: System
    joints: np.ndarray
    ties: np.ndarray
    stiffness: Array
    damping: Array
    springs: tuple[tuple[ScalarLoads, np.ndarray], ...]

    def __len__(self) -> int:
        return len(self.ties)

    def efforts(self, ev: Evaluation) -> Array:
        """N of a state of the system with springs, (p,)."""
        found = [loads.scalar(ev.kin, ev.t)[2][which] for loads, which in self.springs]
        return np.concatenate([np.zeros(0), *found])

    def forces(self, lam: Array, efforts: Array) -> Array:
        """Multipliers of (1) from those of joints (..., n_lam) and from efforts (..., p)."""
        out = np.zeros((*efforts.shape[:-1], len(self.joints) + len(self.ties)))
        out[..., self.joints] = lam
        out[..., self.ties] = efforts
        return out

    def residual(self, gap: Array, rate: Array, efforts: Array) -> Array:
        """The second of (1), for s - free and s' in the rows of joints and ties, (k, ..)."""
        return np.asarray(self.stiffness * gap[:, self.ties] + self.damping * rate[:, self.ties] - efforts)


def stiff_ties(system: System, acceleration: float) -> StiffTies:
    """Those of a system, chosen once; the system itself where it has none. ``acceleration`` (m/s^2): of its start, for scenes
    without gravity; less than on earth counts as much.
    """
    if "stiff ties" not in system.cache:
        system.cache["stiff ties"] = _stiff_ties(system, acceleration)
    made: StiffTies = system.cache["stiff ties"]
    return made


def _stiff_ties(system: System, acceleration: float) -> StiffTies:
    weight = _lightest(system) * max(system.gravity.size or acceleration, LIGHT)
    linear = (loads for loads in system.forces if type(loads) is ScalarLoads)
    springs = tuple((loads, which) for loads in linear if len(which := _stiff(system, loads, weight)))
    if not springs:
        none = np.zeros(0)
        return StiffTies(system, np.arange(system.n_lam), np.zeros(0, dtype=int), none, none, ())

    taken = dict(springs)
    forces = [loads for loads in system.forces if loads not in taken]
    for loads, which in springs:
        rest = np.setdiff1d(np.arange(len(loads.forces)), which)
        if len(rest):
            forces.append(_part(loads, rest))

    # joints first, then ties, then the conditions of frames
    ties = [_part(loads, which) for loads, which in springs]
    counts = np.cumsum([0, *(len(tie.forces) for tie in ties)])
    numbers = [np.arange(i, j) for i, j in zip(counts[:-1], counts[1:], strict=True)]
    terms: list[tuple[RelativeCoordinates, np.ndarray, Array]]
    terms = [(tie.relative, at, np.ones(len(at))) for tie, at in zip(ties, numbers, strict=True)]
    free = np.concatenate([tie.free for tie in ties])
    places = system.n_rows + np.arange(len(free))
    batch = CouplingBatch(terms, [_standing(float(s)) for s in free])
    with_rows = replace(system, forces=tuple(forces), batches=(*system.batches, (batch, places)), cache={})

    return StiffTies(
        system=with_rows,
        joints=np.setdiff1d(np.arange(with_rows.n_lam), places),
        ties=places,
        stiffness=np.concatenate([tie.k for tie in ties]),
        damping=np.concatenate([tie.c for tie in ties]),
        springs=springs,
    )


def _standing(s: float) -> Motion:
    """The motion of a free length."""
    return lambda t: (s, 0.0, 0.0)


def _lightest(system: System) -> float:
    """The smallest mass of a rigid body, kg."""
    masses = [system.mass] if system.rigid is None else [*system.rigid.mass, system.mass]
    return float(np.min(masses))


def _stiff(system: System, loads: ScalarLoads, weight: float) -> np.ndarray:
    """Which of some loads are linear springs along lines that turn, much stiffer than what a weight (N) asks of them."""
    if not isinstance(loads.relative, Separation | Slide):
        return np.zeros(0, dtype=int)
    linear = np.array([force.law is None for force in loads.forces])
    return np.flatnonzero(linear & (loads.k * system.length > STIFF * weight))


def _part(loads: ScalarLoads, which: np.ndarray) -> ScalarLoads:
    """Some of the springs of a batch."""
    r = loads.relative
    markers = [(int(loads.a[i]), int(loads.b[i])) for i in which]
    part = type(r)(r.motions, r.a[which], r.b[which], r.e[which])
    made = ScalarLoads(loads.motions, [loads.forces[i] for i in which], markers, part)
    made.length = loads.length
    return made
