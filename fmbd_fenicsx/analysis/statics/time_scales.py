"""How long the time step is whose matrix preconditions equilibria: long against all periods of a scene, in any units."""

from __future__ import annotations

import numpy as np

from ...fem.fields import Field
from ...mechanics.elastic.modes import bound_by_soft_parts
from ...mechanics.reduction.reduced import ReducedPart
from ...system.layout import State
from ...system.mobility import stiffnesses
from ...system.system import System
from ..small_motions.steady import BodySpin, Residual, Spin

PENDULUM = 10.0  # of the step, over sqrt(L / g)
PERIODS = 300.0  # of the step, over a bound of elastic periods
ROUNDOFF = 1e-14  # of the forces of springs at the model's length
NOTHING = 10.0  # s, where nothing moves a scene


def long_step(system: System, start: State, spin: Spin | BodySpin | None, *, balanced: bool) -> float:
    """Such a step (s) near a state; ``balanced``: whether that is thought to be an equilibrium. Collective."""
    pull = float(np.abs(system.gravity(start.t)).max(initial=0.0))
    # long against a pendulum's period, and against the first vibrations of elastic bodies
    taus = [PENDULUM * float(np.sqrt(system.length / pull))] if pull else []
    taus += [
        # less than nothing where prestress makes the body buckle: so it does as fast
        PERIODS / float(np.sqrt(abs(bound_by_soft_parts(p.field))))
        for _, p in system.fields
        if isinstance(p.field, Field)
    ]
    # without either, what reduced bodies tell of the scene's unit of time, or what moves rigid ones
    reduced = [PERIODS / p.first_frequency for _, p in system.core_parts if isinstance(p, ReducedPart) and p.n]
    if taus or reduced:
        return min(taus or reduced)

    # that of a pendulum on which this force acts as weights do
    force = _force(system, start, spin, balanced=balanced)
    mass = system.mass / max(len(system.frame_names), 1)
    return PENDULUM * float(np.sqrt(mass * system.length / force)) if force > 0.0 and mass > 0.0 else NOTHING


def _force(system: System, start: State, spin: Spin | BodySpin | None, *, balanced: bool) -> float:
    """The largest force at the start, N, or that of the softest spring at the model's length; 0 where there is neither.

    On the way to an equilibrium what is out of balance comes first: a step after which it has moved bodies far sees all of it. In
    an equilibrium springs do, and then reactions: what is left is roundoff.
    """
    residual, springs = Residual(system, spin), system.length * stiffnesses(system)
    soft = float(springs.min()) if springs.size else 0.0
    if balanced and soft:
        return soft

    ev = residual.at(start.q, start.t)
    left = residual.values(ev, np.zeros(system.n_lam))[0]
    if balanced:
        left = left - residual.values(ev, start.lam)[0]
    force = system.max_abs(left / system.units**2)
    return force if force > ROUNDOFF * springs.max(initial=0.0) else soft
