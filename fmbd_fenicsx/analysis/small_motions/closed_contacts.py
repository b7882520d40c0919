"""Contacts that carry forces, in small motions: points that touch hold.

    (M, C, K) y  with  K including  -d(N^T) Lambda / dq,       G y = 0,     N_c y = 0                         (1)

for the rows N_c of points with forces Lambda > 0 at an equilibrium: motions so small that no point opens or closes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...linear.condensation import StepSolver
from ...mechanics.contact.contact_set import ContactSet
from ...mechanics.contact.rows import Rows
from ...rotations import Array
from ...system.system import System


@dataclass(frozen=True, eq=False)
class ClosedContacts:
    """Points that hold: ``which`` of the candidates, their ``rows`` and forces (k,) N at the equilibrium."""

    system: System
    t: float
    which: np.ndarray
    rows: Rows
    force: Array

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.force)

    @property
    def contacts(self) -> ContactSet:
        """All contacts of the scene."""
        return self.system.contacts  # type: ignore[no-any-return]

    def times(self, y: Array) -> Array:
        """N_c y, (k,); collective."""
        return self.contacts.times(self.system, self.rows.N, y)

    def pushed(self, q: Array) -> Array:
        """N_c^T Lambda in a configuration nearby, like v; collective."""
        there = self.contacts.rows(self.system, self.t, q).take(self.which)
        return self.contacts.transposed(self.system, there.N, self.force)

    def held(self, solver: StepSolver) -> Callable[[Array, Array], tuple[Array, Array]]:
        """The prepared solver's inverse with the points held: (b, (g, gaps)) -> increment, (lambda, forces); collective."""
        system, n = self.system, self.system.n_lam
        none = np.zeros(n)
        units = np.eye(self.count)
        push = [self.contacts.transposed(system, self.rows.N, e) for e in units]
        answers = np.array([solver.solve(p, none)[0] for p in push]).reshape(self.count, system.n_v)
        W = np.array([self.times(x) for x in answers]).reshape(self.count, self.count)
        inverse = np.linalg.pinv(0.5 * (W + W.T), rcond=1e-12, hermitian=True)

        def solve(b: Array, c: Array) -> tuple[Array, Array]:
            z, lam = solver.solve(b, c[:n])
            force = inverse @ (c[n:] - self.times(z))
            if not force.any():
                return z, np.append(lam, force)
            dq, lam = solver.solve(b + self.contacts.transposed(system, self.rows.N, force), c[:n])
            return dq, np.append(lam, -force)

        return solve
