"""What the judges of a run ask of every state that a step ends in, in one call of C."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....rotations import Array
from ...evaluator import Seen
from ..tables.structures import zeros_of

if TYPE_CHECKING:
    from ...layout import State
    from .evaluation import DriverStates


class DriverGlance:
    """A :class:`.Glance` of one system."""

    def __init__(self, states: DriverStates, units: Array, *, energies: bool, balance: bool) -> None:
        """``units``: what turns values of constraints into lengths, (n_lam,)."""
        self.states, self.length = states, states.tables.system.length
        s, looks = states.tables.system, states.tables.looks
        made = zeros_of({
            "q": s.n_q, "v": s.n_v, "a": s.n_v, "lam": s.n_lam, "units": s.n_lam,
            "found": len(Seen._fields), "energies": 4, "sums": s.n_v, "room": 2 * s.n_lam,
        })  # fmt: skip
        known = energies and looks.energies_known and not looks.stores
        self.q, self.v, self.a, self.lam = (made[name][0] for name in ("q", "v", "a", "lam"))
        self.found = made["found"][0]
        self._energies: Array | None = made["energies"][0] if known else None
        self.energies: list[float] | None = None
        self.sums: Array | None = made["sums"][0] if balance else None

        made["units"][0][:] = units
        told = {"energies": known, "sums": balance}
        names = "units", "q", "v", "a", "lam", "found", "energies", "sums", "room"
        self.at = [made[name][1] if told.get(name, True) else None for name in names]

    def of(self, state: State) -> Seen | None:
        """What a state shows; None where NumPy has to look."""
        states = self.states
        if states.taken:
            return None
        self.q[:], self.v[:], self.a[:], self.lam[:] = state.q, state.v, state.a, state.lam
        states.anew = True
        told = states.ask(states.library.driver_look, state.t, self.length, *self.at)
        if not told:
            return None
        if self._energies is not None:
            self.energies = list(map(float, self._energies))
        return Seen(*map(float, self.found))
