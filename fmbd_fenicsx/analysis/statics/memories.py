"""What elements remember in equilibria; of controllers z' = g(t, y, z) = 0 beside the balance of forces.

An equilibrium is a state in which nothing changes, the memory included: under a PID controller the angle stands at its target
and the integral carries the load. The memory is that of a step of length T that began with the memory z_k, by the same formula
as in a run,

    z_k+1 = z_k + T / 2 g(t, y(q_k+1), z_k+1),     balance(q_k+1, u(y, z_k+1)) = 0,     k = 0, 1, ...           (1)

with T long against all periods: for an integral a stiff spring to the target, whose centre moves until nothing pulls at it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...errors import ConvergenceError, require
from ...mechanics.forces.dry_friction import DryFrictionLoads
from ...mechanics.frames import Kinematics
from ...rotations import Array
from ...system.control.control_memory import ControllerMemory
from ...system.control.controllers import ControlLoads
from ...system.element_memory import memories, restore
from ...system.layout import State
from ...system.system import System
from ..small_motions.small_memory import hold_memories
from .static_newton import StaticNewton, StaticPoint, by_load_steps

LENGTHS = 100.0  # T over the preconditioner's time step
MOST = 60
STILL = 1e-10  # change of the efforts by that of the memory, over the largest
ROUNDOFF = 1e-15  # of readings, over a radian or the model's length
MOVED = 1e-3  # of the memory, by which its influence on the efforts is seen


def controllers(system: System) -> list[ControlLoads]:
    """The controllers of a system."""
    return [f for f in system.forces if isinstance(f, ControlLoads)]


def remember(system: System, state: State, at: Any, *, relaxed: bool) -> None:
    """What elements remember in small motions about a state of ``at``: an equilibrium, a run (its end), or a state; collective.

    ``relaxed``: ``at`` is an equilibrium, in which viscoelastic rods are relaxed whatever they are strained by. Refuses what has
    no linear model there: sampled controllers, friction at its limit.
    """
    begin_memories(system, state)
    for elements in system.elements:
        elements.kept = elements.first(system.at(state.t, state.q, state.v), state)
    if at is not None and not isinstance(at, State):
        own, theirs = memories(system), memories(at.system)
        require(len(own) == len(theirs), "The state belongs to another scene: other elements remember something there.")
        if relaxed:  # rods as set above
            few = sum(f.kept is not None for f in system.forces)
            theirs = [*theirs[:few], *own[few:]]
        restore(system, theirs)
    check_sampled(system)
    stick(system, state)
    hold_memories(system, state.t)


def begin_memories(system: System, state: State) -> None:
    """What force elements remember at a start; viscoelastic rods have been there since ever, relaxed. Collective."""
    ev, ever = system.at(state.t, state.q, state.v), replace(state, t=-np.inf)
    few = sum(f.kept is not None for f in system.forces)
    for k, keeper in enumerate(system.keepers):
        keeper.kept = keeper.first(ev, state if k < few else ever)


def stick(system: System, state: State) -> None:
    """Dry friction sticks in small motions; refused where it is at its limit: one way it slides, the other way it sticks."""
    kin = system.at(state.t, state.q, state.v).kin
    for loads in system.forces:
        if isinstance(loads, DryFrictionLoads):
            _, _, effort = loads.scalar(kin, state.t)
            full = np.flatnonzero(np.abs(effort) >= (1.0 - 1e-9) * loads.limit)
            require(
                not len(full),
                f'Dry friction "{loads.forces[full[0]].name if len(full) else ""}" is at its limit in this state: one way it '
                "slides, the other way it sticks, so that small motions are not linear.",
            )
            loads.limit = np.full_like(loads.limit, np.inf)  # differences go farther than small motions


def check_sampled(system: System) -> None:
    """Refuse controllers whose efforts are held from sample to sample."""
    for loads in controllers(system):
        require(
            loads.controller.every is None,
            f'Controller "{loads.controller.name}" is sampled: its efforts are held from sample to sample and are no '
            "function of the place; equilibria, modes and linear models do not know them. Take every=None, the continuous law.",
        )


def remembering(system: System, point: Array, t: float) -> list[ControlLoads]:
    """The controllers whose efforts depend on their memory in a configuration; collective."""
    found = []
    for loads in controllers(system):
        z = loads.kept.z
        if not len(z) or loads.controller.every is not None:
            continue
        readings = loads.read(system.at(t, point, np.zeros(system.n_v)).kin)
        # a memory that moves no effort need not come to rest
        steps = np.diag(MOVED * np.maximum(1.0, np.abs(z)))
        u = loads.law.asked(t, readings, z)[0]
        if any(np.abs(loads.law.asked(t, readings, z + step)[0] - u).max() > 0.0 for step in steps):
            found.append(loads)
    return found


def steady(newton: StaticNewton, start: StaticPoint, t: float, keeping: list[ControlLoads]) -> StaticPoint:
    """The equilibrium with memories at rest, from the one with the memories as given; collective.

    Raises ConvergenceError where a memory keeps changing: an integral whose target cannot be reached.
    """
    system, point = newton.residual.system, start
    span = LENGTHS * newton.tau
    for _ in range(MOST):
        for loads in keeping:
            loads.kept = ControllerMemory(t - span, loads.kept.z, np.zeros_like(loads.kept.z), loads.kept.u, 0)
        point = by_load_steps(newton, point, t)

        kin = system.at(t, point.q, np.zeros(system.n_v)).kin
        noise = max(_noise(loads, kin, t) for loads in keeping)
        efforts, changes = np.concatenate([_advanced(loads, kin, t) for loads in keeping], axis=1)
        change = float(np.abs(changes).max())
        if change <= max(STILL * float(np.abs(efforts).max()), noise):
            for loads in keeping:
                loads.kept = replace(loads.kept, t=t)
            return point
    names = ", ".join(f'"{loads.controller.name}"' for loads in keeping)
    raise ConvergenceError(
        f"No equilibrium: the memory of controller {names} goes on changing, the last efforts by {change:.3g}. "
        "Its target cannot be held."
    )


def _noise(loads: ControlLoads, kin: Kinematics, t: float) -> float:
    """How far roundoff of its readings moves the efforts of a controller over the long step, its memory going along.

    Rates have none: they are zero.
    """
    readings = loads.read(kin)
    of = {"rad": 1.0, "-": 1.0}
    spans = [
        np.full(r.size, 0.0 if "/s" in r.sensor.unit else of.get(r.sensor.unit, loads.length)) for r in loads.readings
    ]
    slopes = np.abs(loads.law.slopes(t, readings, loads.spans)) * np.concatenate([np.zeros(0), *spans])
    return ROUNDOFF * float(slopes.max(initial=0.0))


def _advanced(loads: ControlLoads, kin: Kinematics, t: float) -> Array:
    """Efforts at the end of the long step, and what of them its change of the memory has made, (2, acts); it is kept."""
    readings = loads.read(kin)
    u, z, _ = loads.law.with_memory(t, readings)
    before = loads.law.asked(t, readings, loads.kept.z)[0]
    loads.kept = ControllerMemory(t, z, np.zeros_like(z), u, 0)
    return np.array([u, u - before])
