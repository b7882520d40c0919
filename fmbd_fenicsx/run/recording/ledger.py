"""The ledger of a run: work and power of every element, and the change of energy of the bodies that they explain.

    E(t) - E(0) = sum over elements of the integral of their power + rest,      E = kinetic + elastic + weight         (1)

Powers are recorded with the sensors and integrated by the trapezoidal rule, so the rest is of second order in the distance of the
records: the errors of the scheme, of the rule, and the work of what the ledger does not list. Springs are elements: the energy
that they keep is work that they took.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import InputError, Told
from ...rotations import Array
from ...system.evaluation import Evaluation
from ...system.layout import State
from ...system.scene.scene import Scene
from ...system.serialisation import Memory


@dataclass(frozen=True)
class Books:
    """What a run recorded for its ledger: powers (W) and works (J) by element, each (n,), bodies that are not listed, and the
    ``elements`` that are entries even where they did no work.
    """

    power: Mapping[str, Array]
    work: Mapping[str, Array]
    unlisted: tuple[str, ...]
    elements: tuple[str, ...] = ()


class Bookkeeper:
    """Takes down powers and works of the elements of a scene, state by state."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.powers: list[dict[str, float]] = []
        self.works: list[dict[str, float]] = []
        self.unlisted: tuple[str, ...] = ()

    def enter(self, ev: Evaluation, state: State) -> None:
        """Power of every element in a state, and work of contacts up to it; collective."""
        from ...system.powers import contact_works, powers, unlisted

        if not self.powers:
            self.unlisted = tuple(unlisted(ev, state))
        self.powers.append(powers(ev, state))
        self.works.append(contact_works(state) if self.scene.unilateral else {})

    @property
    def books(self) -> Books:
        """What was recorded for the ledger."""
        return Books(_columns(self.powers), _columns(self.works), self.unlisted, tuple(self.scene.forces))

    def remember(self, m: Memory) -> None:
        """All that was taken down."""
        count, power, work, self.unlisted = m(
            "books", (len(self.powers), _columns(self.powers), _columns(self.works), self.unlisted)
        )
        self.powers, self.works = _entries(power, count), _entries(work, count)


def _columns(entries: Sequence[Mapping[str, float]]) -> dict[str, Array]:
    """A column for every name that occurs, in the order of its first record."""
    names = dict.fromkeys(name for entry in entries for name in entry)
    return {name: np.array([entry.get(name, 0.0) for entry in entries]) for name in names}


def _entries(columns: Mapping[str, Array], count: int) -> list[dict[str, float]]:
    """A dictionary for each record from a column for each name."""
    return [{name: float(x[k]) for name, x in columns.items()} for k in range(count)]


@dataclass(frozen=True, repr=False)
class Ledger:
    """Work and power of every element of a run; ``print(run.ledger)`` shows it as a table.

    Attributes:
        times: (n,) s.
        power: element -> power that it gives to the bodies, (n,) W: forces by name, drives by name, "rod, damping", "rod, loads".
        work: the same from the start on, (n,) J; with "contact" and "friction" where bodies touch.
        energy: of the bodies: kinetic, elastic and of weight, (n,) J.
        unlisted: bodies whose loads and damping the ledger does not contain.
    """

    times: Array
    power: dict[str, Array]
    work: dict[str, Array]
    energy: Array
    unlisted: tuple[str, ...] = ()

    @property
    def change(self) -> Array:
        """Change of the energy of the bodies since the start, (n,) J."""
        return self.energy - self.energy[0]

    @property
    def rest(self) -> Array:
        """What the works do not explain of it, (n,) J."""
        return self.change - np.sum([np.zeros_like(self.times), *self.work.values()], axis=0)

    def __getitem__(self, element: str) -> Array:
        """Work of an element since the start, (n,) J."""
        return self.work[element]

    def __repr__(self) -> str:
        return f"<ledger of {len(self.work)} elements over {self.times[-1]:g} s>"

    def __str__(self) -> str:
        width = max([24, *(len(name) for name in self.work)])
        lines = [f"{'element':<{width}}{'work (J)':>14}{'largest |power| (W)':>22}"]
        for name, work in self.work.items():
            most = f"{np.abs(self.power[name]).max():>22.5g}" if name in self.power else ""
            lines.append(f"{name:<{width}}{work[-1]:>14.6g}{most}")

        total = float(sum(w[-1] for w in self.work.values()))
        for name, value in (("sum", total), ("change of energy", self.change[-1]), ("rest", self.rest[-1])):
            lines.append(f"{name:<{width}}{value:>14.6g}")
        if self.unlisted:
            lines.append(f"not listed: loads and damping of {', '.join(self.unlisted)}")
        return "\n".join(lines)


def make_ledger(times: Array, energy: Mapping[str, Array], books: Books | None) -> Ledger:
    """The ledger of recorded powers and energies.

    Raises:
        InputError: the run kept no ledger.
    """
    if books is None:
        raise InputError("This run kept no ledger: solve(..., output=fmbd.Output(ledger=True)).")

    # joints at rest are left out, and damping that there is not; a stop that was not reached has an entry of zeros
    power = {name: p for name, p in books.power.items() if p.any() or name in books.elements}
    steps = np.diff(times)
    work = {name: np.concatenate(([0.0], np.cumsum(0.5 * steps * (p[1:] + p[:-1])))) for name, p in power.items()}
    bodies = np.sum([energy[kind] for kind in ("kinetic", "elastic", "weight")], axis=0)

    return Ledger(
        times,
        Told("Powers of the ledger", power),
        Told("Works of the ledger", {**work, **books.work}),
        bodies,
        books.unlisted,
    )
