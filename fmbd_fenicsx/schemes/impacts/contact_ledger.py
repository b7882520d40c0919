"""Books of a run with contact: forces of each step, impulses and works since the start, statistics of the
active sets.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from ...linear.complementarity.coulomb import ContactCounts
from ...mechanics.contact.rows import Rows, Touch
from ...rotations import Array
from ...system.evaluation import Evaluation
from ...system.layout import State
from ...system.sensors.contact import WORKS, ContactForces, ContactState, forces_of
from ...system.serialisation import Memory, Remembering, plain
from ...system.system import System
from .contact_detection import in_world

SHORT = 3  # steps in contact that do not resolve an impact


@dataclass(frozen=True)
class StepForces:
    """Forces of one step: which candidates were in reach (m,) bool, their rows, components (k, 1 or d) in N,
    and the time.
    """

    near: np.ndarray
    rows: Rows | None
    force: Array
    time: float


@dataclass
class ContactLedger(Remembering):
    """Sums over the steps; ``write`` after each step makes the state that sensors read. Methods are
    collective.
    """

    keeps: ClassVar = {
        "force": Memory.candidates,
        **dict.fromkeys(("impulse", "work", "energy", "springs"), plain()),
        "counts": plain(ContactCounts),
        **dict.fromkeys(("in_contact", "newton_in_contact", "touching", "impacts", "short"), plain()),
    }

    system: System
    counts: ContactCounts = field(default_factory=ContactCounts)
    in_contact: int = 0
    newton_in_contact: int = 0
    touching: list[int] = field(default_factory=list)  # steps since each pair closed, 0 while it is open
    impacts: int = 0  # that have ended
    short: int = 0  # of these, lasting three steps or less

    def __post_init__(self) -> None:
        self.contacts = self.system.contacts
        d = self.system.motions.dim
        self.components = d if self.contacts.frictional else 1
        self.force: Array = np.zeros((len(self.contacts.pair), self.components))
        self.impulse: Array = np.zeros((len(self.contacts.pairs), d))
        self.work: Array = np.zeros(len(WORKS))
        self.energy = self.springs = 0.0
        self.touching = [0] * len(self.contacts.pairs)

    def open(self, state: State) -> ContactState:
        """The first state: no forces yet."""
        self.energy, self.springs = self._energy(state)
        nothing = StepForces(np.zeros(len(self.force), dtype=bool), None, np.zeros((0, self.components)), state.t)
        return self._carry(state, nothing, self.contacts.touch(self.system, state.t, state.q))

    def write(self, state: State, forces: StepForces, step: tuple[Evaluation, Array, Array], h: float) -> ContactState:
        """Close a step: ``step`` holds the evaluation, the increment xi and the multipliers that the balance
        was written with.
        """
        system, c = self.system, self.contacts
        ev, xi, lam = step

        works = np.zeros(len(WORKS))
        if forces.rows is not None:
            done = forces.force * c.times(system, forces.rows.L, xi).reshape(forces.force.shape)
            works[0], works[1] = done[:, 0].sum(), done[:, 1:].sum()

        # what is left of the change of energy is numerical
        energy, springs = self._energy(state)
        if system.forces:
            works[2] = ev.work(xi) + springs - self.springs
        if system.n_lam:
            works[3] = -float(lam @ ev.jacobian.times(xi))
        works[4] = energy - self.energy - works[:4].sum()
        self.energy, self.springs, self.work = energy, springs, self.work + works

        self.force = np.zeros_like(self.force)
        self.force[forces.near] = forces.force
        found = self._carry(state, forces, c.touch(system, state.t, state.q), h)
        return found

    @property
    def books(self) -> Array:
        """Works since the start, energy, that of springs; impacts, short ones, steps in contact, their increments: (11,)."""
        counts = self.impacts, self.short, self.in_contact, self.newton_in_contact
        return np.array((*self.work, self.energy, self.springs, *counts))

    def take(self, books: Array) -> None:
        """The same, of later steps."""
        n = len(WORKS)
        self.work, self.energy, self.springs = books[:n].copy(), float(books[n]), float(books[n + 1])
        self.impacts, self.short, self.in_contact, self.newton_in_contact = (int(x) for x in books[n + 2 :])

    def averaged(self, state: ContactState, time: float, mean: tuple[Array, Array]) -> ContactState:
        """The state at ``time`` with the mean contact forces of a step of several parts: (m, d) in world axes, normal (m,)."""
        found = forces_of(state)
        force, normal = mean
        self.force = np.zeros_like(self.force)
        self.force[:, 0] = normal
        found = replace(found, force=force, normal_force=normal, pressure=self.contacts.pressures(normal))
        return replace(state, t=time, contact=found)

    def count(self, iterations: int) -> None:
        """A step was done; Newton iterations count when a force acted, and impacts when their forces end."""
        for k, pair in enumerate(self.contacts.pairs):
            if pair.bounces:  # in no time, by the law of impacts
                continue
            if self.force[self.contacts.pair == k].any():
                self.touching[k] += 1
                continue
            self.impacts += self.touching[k] > 0
            self.short += 0 < self.touching[k] <= SHORT
            self.touching[k] = 0

        if self.force.any():
            self.in_contact += 1
            self.newton_in_contact += iterations

    def _energy(self, state: State) -> tuple[float, float]:
        """Total energy, and the share of springs."""
        found = self.system.at(state.t, state.q, state.v).energies()
        return float(sum(found.values())), float(found["springs"])

    def _carry(self, state: State, forces: StepForces, end: Touch, h: float = 0.0) -> ContactState:
        c = self.contacts
        force = np.zeros_like(end.x)
        if forces.rows is not None:
            force[forces.near] = in_world(forces.rows, forces.force)
            self.impulse = self.impulse.copy()
            np.add.at(self.impulse, c.pair, h * force)
        normal = self.force[:, 0].copy()
        found = ContactForces(
            c.names, forces.time, c.pair, end.x, end.normal, end.geometric, normal, force, c.pressures(normal),
            self.impulse, self.work.copy(),
        )  # fmt: skip
        return ContactState(state.t, state.q, state.v, state.a, state.lam, found)

    def counters(self, columns: int, products: int = 0) -> dict[str, float]:
        """Statistics for the run's counters; ``columns`` of the compliance solved, ``products`` with it."""
        n = self.counts
        return {
            "contact_steps": self.in_contact,
            "contact_newton_iterations": self.newton_in_contact,
            "impacts": self.impacts,
            "short_impacts": self.short,
            "active_set_iterations": n.iterations,
            "active_set_changes": n.changes,
            "cycles_broken": n.cycles,
            "complementarity_residual": n.residual,
            "compliance_columns": columns,
            "compliance_products": products + n.products,
        }
