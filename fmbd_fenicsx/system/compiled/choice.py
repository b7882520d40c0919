"""Whether compiled code evaluates a system: where the driver knows all of it, and its factor is not too large."""

from __future__ import annotations

from typing import Any, TypeGuard

from ..evaluator import Evaluator
from ..system import System
from .library import driver_library, units_of
from .states.evaluation import DriverStates
from .states.field_states import FieldStates
from .tables.bodies.bodies import covers_bodies
from .tables.items.items import covers
from .tables.resting import twin_of

STORAGE_LIMIT = 20_000_000  # numbers in the factor


def use_driver(system: System) -> None:
    """Let the driver evaluate a system from now on, where it knows all of it; looked at once."""
    if "driver looked for" in system.cache:
        return
    system.cache["driver looked for"] = True
    states = driver_states(system)
    if states is not None:
        system.evaluate_by(states)


def driver_states(system: System) -> DriverStates | None:
    """The driver for states of a system, None where NumPy has to evaluate it."""
    library = driver_of(twin_of(system).system)
    if library is None:
        return None

    made = FieldStates if system.fields else DriverStates
    states = made(system, library)
    return states if states.tables.fronts.storage <= STORAGE_LIMIT else None


def driver_of(known: System, *more: str) -> Any:
    """The driver for a system as its tables are made of it, with ``more`` units than it needs; None where it does not know all of
    it, or cannot be had.
    """
    if not covers_bodies(known) or not covers(known):
        return None
    return driver_library(known.motions.dim, (*units_of(known), *more))


def solves(evaluator: Evaluator) -> TypeGuard[DriverStates]:
    """Whether who evaluates a system also factors its matrices."""
    return isinstance(evaluator, DriverStates) and evaluator.solves
