"""What elements remember, in small motions: integrals of controllers, dashpots of viscoelastic rods as further unknowns.

    M y'' + C y' + K y + H w + G^T lambda = f,      w' = P y + Q y' + R w                                     (1)

w is the change of the memory, M, C, K are taken with the memory held. H, P, Q and R are differences of the balance and of the
elements' own rates. A viscoelastic rod is stiff in fast motions, relaxed in slow ones, and damps those between; under a PID
controller each joint has a third eigenvalue, that of the integral.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError
from ...mechanics.forces.force_elements import Loads
from ...rotations import Array
from ...system.element_memory import memories, restore
from ...system.system import System
from .perturbation import SHIFT, SIDES, Perturbation

STEP = 1e-6  # of a difference along a memory, over its size
STILL = 1e-6  # rate of a memory at rest, over its size and the slowest time


@dataclass(frozen=True, eq=False)
class SmallMemory:
    """H (k, m), P, Q (m, k) and R (m, m) of (1) on a basis of k motions; ``which`` (m,): of all numbers of the memory."""

    H: Array
    P: Array
    Q: Array
    R: Array
    which: np.ndarray

    def on(self, Y: Array) -> SmallMemory:
        """The memories on combinations Y (k, n) of the basis."""
        return SmallMemory(Y.T @ self.H, self.P @ Y, self.Q @ Y, self.R, self.which)


def hold_memories(system: System, t: float) -> None:
    """Take all memories at time t, s, so that forces at this time are those of the memory as it is."""
    for elements in system.keepers:
        elements.set_memory(elements.memory_values(), t)


def relaxes(system: System) -> bool:
    """Whether bodies of the system have dashpots."""
    return any(len(e.memory_values()) for e in system.elements)


@contextmanager
def changed(system: System, t: float, change: Array) -> Iterator[None]:
    """The memories changed by ``change``, all numbers in a row, as a context."""
    kept, at = memories(system), 0
    try:
        for elements in system.keepers:
            values = elements.memory_values()
            elements.set_memory(values + change[at : at + len(values)], t)
            at += len(values)
        yield
    finally:
        restore(system, kept)


def memory_size(system: System) -> int:
    """How many numbers are remembered that small motions change."""
    return sum(len(elements.memory_values()) for elements in system.keepers)


def small_memory(about: Perturbation, V: Array) -> SmallMemory | None:
    """The matrices of (1) for motions V (k, n_v), of memories that move forces; None without any. Collective."""
    system, s = about.system, about.state
    if not memory_size(system):
        return None
    steps = STEP * np.concatenate([_sizes(elements) for elements in system.keepers])
    forces = [_pushed(about, x) for x in np.diag(steps)]

    # numbers that move nothing are left out
    which = np.array([j for j, x in enumerate(forces) if system.max_abs(x) > 0.0], dtype=int)
    if not len(which):
        return None

    H = np.array([[system.dot(v, forces[j]) / steps[j] for j in which] for v in V]).reshape(len(V), len(which))

    ev = system.at(s.t, s.q, s.v)
    R: Array = np.zeros((len(which), len(which)))
    for k, j in enumerate(which):
        step = np.zeros(len(steps))
        step[j] = steps[j]
        R[:, k] = (_rates(system, ev, s.t, step) - _rates(system, ev, s.t, -step))[which] / (2.0 * steps[j])

    # by displacements at rest, and by velocities
    zero = np.zeros(system.n_v)
    P = [_along(about, v, about.velocity(v, zero), which) for v in V]
    Q = [_along(about, None, v, which) for v in V]
    return SmallMemory(H, np.array(P).reshape(-1, len(which)).T, np.array(Q).reshape(-1, len(which)).T, R, which)


def refuse_moving_memory(about: Perturbation, shift: float) -> None:
    """A memory that moves forces and changes at rest is no equilibrium."""
    system, s = about.system, about.state
    for elements in system.keepers:
        values = elements.memory_values()
        if not len(values):
            continue
        rates = elements.memory_rates(system.at(s.t, s.q, s.v), s.t)
        # what changes much within a period, and moves something
        fast = np.abs(rates) > STILL * _sizes(elements) * np.sqrt(shift)
        if fast.any() and any(system.max_abs(_pushed(about, x)) > 0.0 for x in _steps(system, elements)):
            raise InputError(
                f'The scene is not in equilibrium at this state: the memory of "{_name(elements)}" changes with '
                f"{np.abs(rates).max():.3g} 1/s at rest. Give at=fmbd.equilibrium(scene)."
            )


def pushed_by(about: Perturbation, change: Array) -> Array:
    """H of (1) times a change of the memory, all numbers in a row: like v."""
    size = float(np.abs(change).max(initial=0.0))
    return np.zeros(about.system.n_v) if size == 0.0 else _pushed(about, STEP * change / size) * (size / STEP)


def _name(elements: Any) -> str:
    """What messages call them."""
    return str(elements.forces[0].name if isinstance(elements, Loads) else elements.name)


def _steps(system: System, of: Any) -> Iterator[Array]:
    """A step along each number of the memory of some elements, all numbers in a row."""
    at, size = 0, memory_size(system)
    for elements in system.keepers:
        values = elements.memory_values()
        for k in range(len(values) if elements is of else 0):
            step = np.zeros(size)
            step[at + k] = STEP * _sizes(of)[k]
            yield step
        at += len(values)


def _sizes(elements: Any) -> Array:
    """What the numbers that some elements remember are measured by, (m,): the largest of them, 1 where all are zero."""
    values = elements.memory_values()
    return np.full(len(values), np.abs(values).max(initial=0.0) or 1.0)


def _pushed(about: Perturbation, step: Array) -> Array:
    """Half the difference of the balance, like v, between memories changed by a step and by the opposite one."""
    system, s = about.system, about.state
    ends: list[Array] = []
    for side in (1.0, -1.0):
        with changed(system, s.t, side * step):
            ends.append(system.at(s.t, s.q, s.v).balance(s.a, s.lam))
    return 0.5 * (ends[0] - ends[1])


def _rates(system: System, ev: Any, t: float, change: Array | None = None) -> Array:
    """Rates of all numbers in a configuration, with the memories changed."""
    with changed(system, t, np.zeros(memory_size(system)) if change is None else change):
        return np.concatenate([elements.memory_rates(ev, t) for elements in system.keepers])


def _along(about: Perturbation, y: Array | None, rate: Array, which: Sequence[int] | np.ndarray) -> Array:
    """Derivative of the rates along increments y of the configuration and ``rate`` of the velocities, (m,)."""
    system, s = about.system, about.state
    size = system.max_abs(rate if y is None else y)
    if size == 0.0:
        return np.zeros(len(which))
    h = SHIFT * system.length / (size if y is not None else size * about.time)
    total = np.zeros(len(which))
    for side, weight in SIDES:
        q = s.q if y is None else system.compose(s.q, side * h * y)
        total += weight * _rates(system, system.at(s.t, q, s.v + side * h * rate), s.t)[which]
    return total / (12.0 * h)
