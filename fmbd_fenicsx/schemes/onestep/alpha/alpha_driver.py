"""Generalized-alpha in the compiled driver: many steps in one call, for systems of rigid, reduced and floating bodies and rods.

Joints, drives, gears, springs, dampers, loads and laws of the user's own are all items of the driver's tables; Python is entered
once a step where something depends on time, and at evaluations where a law is given in Python.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any

import numpy as np

from ....errors import BalanceError
from ....kernel_cache import address_of
from ....rotations import Array
from ....system.compiled import march as slots
from ....system.compiled.calls import WHOLE_SAMPLE, Calls
from ....system.compiled.choice import STORAGE_LIMIT, driver_of, solves
from ....system.compiled.march import March
from ....system.compiled.tables.bodies.fields import Block
from ....system.compiled.tables.resting import twin_of
from ....system.compiled.tables.tables import Tables
from ....system.layout import States
from ....system.system import System
from ...marching import make_steps

if TYPE_CHECKING:
    from ....linear.blocks.field_blocks import Weights
    from ....system.compiled.states.evaluation import DriverStates
    from ...newton import Newton
    from ...stepping import Observers
    from .compiled_control import CompiledControl


class AlphaDriver(March):
    """The driver for one system: its tables, its calls into Python, and a ring of four states."""

    def __init__(self, library: Any, tables: Tables, calls: Calls) -> None:
        super().__init__(library, tables, calls, "ALPHA")
        self.evaluator: DriverStates | None = None  # whose the tables are

    def idle(self) -> AbstractContextManager[None]:
        """Between steps: who evaluates the system may have its tables back, where they are its own."""
        evaluator = self.evaluator
        return nullcontext() if evaluator is None or evaluator.tables is not self.tables else evaluator.back()

    @property
    def slopes(self) -> Array | None:
        """What the next step knows of forces that Python gives as a whole; None without any."""
        tables = self.tables
        if not tables.whole:
            return None
        return np.concatenate(([tables.c.ck], tables.arrays["diagonal"], *(x.memory for x in tables.whole)))

    @slopes.setter
    def slopes(self, kept: Array | None) -> None:
        tables = self.tables
        if kept is None:
            for x in tables.whole:
                x.astray[0] = 1
            return
        diagonal = tables.arrays["diagonal"]
        at = 1 + len(tables.arrays["diagonal"])
        tables.c.ck, diagonal[:] = kept[0], kept[1:at]
        for x in tables.whole:
            x.recall(kept[at : at + len(x.memory)])
            at += len(x.memory)

    def march(
        self, h: float, steps: int, newton: Newton, observers: Observers, control: CompiledControl | None
    ) -> tuple[int, int]:
        """As :func:`.make_steps`; raises what a call into Python has raised. Forces beyond the range of numbers are those of an
        iterate: the step counts as one that was not found.
        """
        address = None if control is None else control.address
        made, verdict = make_steps(self, h, steps, newton, observers, control=address)
        if isinstance(self.calls.error, BalanceError):
            self.calls.forget_error()  # who makes the step by itself meets it again
            return made, slots.NEWTON
        self.calls.raise_error()
        return made, verdict

    def error(
        self,
        sizes: tuple[float, float],
        arrays: Sequence[Array],
        t: float,
        missed: Array,
        weights: Weights | None = None,
    ) -> Array | None:
        """``driver_error`` of alpha.c for its scale and span, and for q, v, a and lambda, with a matrix of these weights, or with
        that at hand; None where NumPy has to do.
        """
        if self.tables.c.samples > (1 if weights is None else 0):
            self.calls.sample(WHOLE_SAMPLE, t)  # a step may have left out the rates of motions

        twin, (q, v, a, lam) = self.tables.twin, arrays
        v, a, missed = twin.velocities(np.stack((v, a, missed)))
        told = [np.ascontiguousarray(x) for x in (twin.configurations(q[None])[0], v, a, lam, missed)]
        *at, missing = map(address_of, told)
        shares = None if weights is None else np.array([weights.cd, weights.ck])
        weighing = None if shares is None else address_of(shares)
        error, room = np.zeros(self.system.n_v), np.zeros(self.system.n_lam)
        answer = address_of(error), address_of(room)
        verdict = self.library.driver_error(self.address, *sizes, weighing, *at, t, missing, *answer)
        self.calls.raise_error()
        return None if verdict else twin.forces(error[None])[0]

    def shut(self, states: States, weights: Sequence[Weights], allowed: float, most: int) -> Array | None:
        """``driver_shut`` of march.c: q of states with closed joints, (k, n_q), by at most so many iterations each; None where
        NumPy has to do.
        """
        system, twin, shut = self.system, self.tables.twin, self.library.driver_shut
        q, v = np.array(twin.configurations(states.q)), np.ascontiguousarray(twin.velocities(states.v))
        room = np.zeros(2 * system.n_v + 2 * system.n_lam + system.n_q)
        to, first, second = map(address_of, (room, q, v))

        slopes, refused = self.slopes, False  # the next step begins with these
        for i, (t, own) in enumerate(zip(states.times, weights, strict=True)):
            at = first + i * q.strides[0], second + i * v.strides[0]
            refused |= bool(shut(self.address, own.cd, own.ck, t, allowed, most, *at, to))
        if slopes is not None:
            self.slopes = slopes
        self.calls.raise_error()
        return None if refused else twin.places(q)


def drivable(system: System) -> Any:
    """The library of the driver where it knows all of a system, else None."""
    return driver_of(twin_of(system).system) if system.contacts is None else None


def alpha_driver(
    system: System, *, redundant: int, blocks: Sequence[Block] = (), alone: bool = True
) -> AlphaDriver | None:
    """The driver for a system, or None where the NumPy path has to do; ``blocks``: of its fields for the size of a step.

    ``alone``: where the driver evaluates the system its tables are taken.
    """
    evaluator = system.evaluator
    if alone and solves(evaluator):
        tables, calls = evaluator.give()
        tables.c.redundant = redundant
        made = AlphaDriver(evaluator.library, tables, calls)
        made.evaluator = evaluator
        return made

    library = drivable(system)
    if library is None:
        return None
    tables, calls = _field_tables(system, redundant, blocks)
    return AlphaDriver(library, tables, calls) if tables.fronts.storage <= STORAGE_LIMIT else None


def _field_tables(system: System, redundant: int, blocks: Sequence[Block]) -> tuple[Tables, Calls]:
    """Tables with factors of the fields: those that another size of step or an earlier run had, where these remember nothing of
    its steps and its tangents.
    """
    known: tuple[Tables, Calls] | None = system.cache.get("tables of steps")
    if known is not None and blocks:
        tables = known[0]
        remembers = (
            tables.c.remembers or tables.sampled or tables.whole or any(field.changes for field in tables.fields)
        )
        if not remembers and tables.c.redundant == redundant and tables.take(blocks):
            return known
    tables = Tables(system, redundant=redundant, blocks=blocks)
    made = system.cache["tables of steps"] = tables, Calls(tables)
    return made
