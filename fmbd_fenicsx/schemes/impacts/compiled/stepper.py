"""The Moreau scheme with compiled steps; those that compiled code gives back are made in NumPy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ....linear.condensation import StepSolver
from ....rotations import Array
from ....system.compiled import march as slots
from ....system.compiled.tape import on_the_way
from ....system.layout import State, States
from ....system.sensors.contact import ContactForces, ContactState
from ....system.serialisation import Memory
from ....system.system import System
from ...marching import CompiledSteps
from ...newton import Newton
from ...stepping import UNOBSERVED, Observers
from ..moreau_stepper import MoreauStepper
from .driver import ContactDriver
from .structures import Tally

if TYPE_CHECKING:
    from ....system.compiled.kept import KeptSteps
    from ....system.compiled.tape import Openness, Tape
    from ..moreau import Moreau


class CompiledMoreauStepper(CompiledSteps, MoreauStepper):
    """Steps by the driver, one or many in a call."""

    compiled_whole = True
    path = "compiled (bodies, joints, forces and contacts in C; NumPy for the start and for steps it gives back)"

    def __init__(self, data: tuple[System, StepSolver, Newton, State], rule: Moreau, driver: ContactDriver) -> None:
        self.driver, self.compiled = driver, 0
        self._tail: State | None = None  # the state that the driver's block holds
        super().__init__(*data, rule)

    @property
    def counters(self) -> dict[str, float]:
        """With the number of compiled steps."""
        return {**super().counters, "compiled_steps": float(self.compiled)}

    @property
    def stations(self) -> list[State]:
        """As :attr:`Stepper.stations`, wherever the last step was made."""
        return self.driver.stations() if self._tail is self.state and self.compiled else super().stations

    def remember(self, m: Memory) -> None:
        """With the number of compiled steps."""
        super().remember(m)
        self.compiled = m("compiled", self.compiled)

    def advance(self, h: float) -> State:
        """One step of size h (s), as :meth:`Stepper.advance`; NumPy would not find forces that compiled code has not found."""
        if self._march(h, 1):
            tables = self.driver.tables
            tables.remember_within(tables.memories(), "DRY")
            return self.state  # who called moves memories on
        if self.driver.unsolved is not None:
            raise self.driver.unsolved
        return super().advance(h)

    def march(self, h: float, steps: int, observers: Observers = UNOBSERVED) -> int:
        """Up to so many steps of size h (s) in one call; how many were made: fewer where one is given
        back. Elements with a memory have that of the last step.
        """
        made = 0 if observers.energy is not None else self._march(h, steps, observers.tape)
        if made:
            self.driver.tables.remember()
        return made

    def _march(self, h: float, steps: int, tape: Tape | None = None) -> int:
        """The same; the memory of elements is left as it was."""
        if self._is_refused(h):
            return 0
        self.driver.tables.recall()
        if self._tail is not self.state:
            self._load()
        made = self.driver.march(h, steps, self.newton, tape)
        if made:
            self._take_newest(made)
        self._refused = None
        if made < steps and not (tape is not None and tape.ended):
            self._refuse(h)
        return made

    def tape(self, judged: Openness) -> Tape | None:
        """Room for records of :meth:`march`."""
        return self.driver.tape(judged) if on_the_way(self.driver.tables) else None

    def within(self, steps: KeptSteps) -> States:
        """As :meth:`TimeStepper.within`, each on the parabola of its part."""
        return States(steps.t, *self._on_parabola(steps.before, steps.after, steps.t))

    def _load(self) -> None:
        """State, impulses and books into the driver."""
        s = self.state
        x = self.driver.arrays
        books = self.ledger
        self.driver.load(s.t, (s.q, s.v, s.a, s.lam))
        x["held"][:], x["carrying"][:] = self.carried.ravel(), self.carrying
        x["impulse"][:], x["works"][:] = books.impulse.ravel(), books.work
        self.driver.c.energy, self.driver.c.springs = books.energy, books.springs
        self._tail = s

    def _take_newest(self, made: int) -> None:
        """The newest state, impulses, books and counts from the driver."""
        driver, books = self.driver, self.ledger
        x, c, p = driver.arrays, driver.c, driver.parameters
        self.carried = x["held"].reshape(self.carried.shape).copy()
        self.carrying = x["carrying"].astype(bool)
        books.impulse, books.work = x["impulse"].reshape(books.impulse.shape).copy(), x["works"].copy()
        books.energy, books.springs = float(c.energy), float(c.springs)
        normal = x["normal"].copy()
        books.force = np.zeros_like(books.force)
        books.force[:, 0] = normal

        self.compiled += made
        self.solver.core.factorisations += made
        self._count_increments(p, c.tally.iterated)
        self.local_error = float(p[slots.LOCAL])
        self._count()

        s = driver.ring.state()
        self.state = self._tail = ContactState(s.t, s.q, s.v, s.a, s.lam, self._forces(normal))

    def _count(self) -> None:
        """Statistics of contact since the last call."""
        tally = self.driver.c.tally
        books = self.ledger
        counts = books.counts
        books.in_contact += tally.steps
        books.newton_in_contact += tally.newton
        counts.iterations += tally.iterations
        counts.changes += tally.changes
        counts.cycles += tally.cycles
        counts.solves += tally.solves
        self.located += tally.impacts
        self.struck.extend(self.driver.arrays["struck"][: tally.struck])
        self.accumulations += self.driver.accumulations
        counts.residual = max(counts.residual, float(tally.residual))
        self.driver.c.tally, self.driver.accumulations = Tally(), 0

    def _forces(self, normal: Array) -> ContactForces:
        """What sensors read of the contacts in the last step."""
        gap, x, n = self.driver.touching()
        force = self.driver.arrays["force"].reshape(x.shape).copy()
        contacts, books = self.contacts, self.ledger
        return ContactForces(
            contacts.names, float(self.driver.c.time), contacts.pair, x, n, gap, normal, force, contacts.pressures(normal),
            books.impulse, books.work,
        )  # fmt: skip
