"""Steps of explicit methods in the driver (driver/onestep/runge_kutta.c): what Python lends of a method."""

from __future__ import annotations

import ctypes

import numpy as np

from ...kernel_cache import address_of
from .declarations import enumeration, structure_of
from .own_steps import BentBodies, OwnRoom
from .states.evaluation import DriverStates
from .states.explicit import Tableau

# numbers that error control keeps with a state
CONTROLLED = enumeration("CONTROLLED", "marches/own_steps.c")["CONTROLLED"]
Norm = structure_of("marches/error_norm.c", "Norm")
Explicit = structure_of("onestep/runge_kutta.c", "Explicit", Norm=Norm)


class ExplicitRoom:
    """Lends a method, with the way (m) that counts as none, and the control of its steps where these are not constant."""

    def __init__(self, states: DriverStates, tableau: Tableau, nothing: float, own: OwnRoom | None) -> None:
        system, (c, A), self.own = states.tables.system, tableau, own
        n, stages = system.n_v, A.shape[1]
        work = (2 * stages + 9) * n + 3 * system.n_q + 5 * system.n_lam + states.tables.nu
        self._bent, self._kinds = BentBodies(system), states.twin.kinds
        self._kept = [np.ascontiguousarray(c), np.ascontiguousarray(A), np.zeros(work), np.zeros((3, n))]
        nodes, rows, room, weights = map(address_of, self._kept)
        span, counted = map(address_of, self._kinds)
        norm = Norm(n=n, parts=len(self._kinds[0]), span=span, counted=counted, weigh=weights)
        self._bent.lend(norm, apart=True)
        self.c = Explicit(
            stages=stages, nothing=nothing, c=nodes, A=rows, own=None if own is None else own.address, norm=norm, work=room
        )  # fmt: skip
        self.address = ctypes.addressof(self.c)
