"""The matrix of a step in the driver: factored at a state, and solved with.

    [M + cd C + ck K, G^T; G, 0] [x; y] = [b; c]                                                                (1)

Steps that take the tables write over the factor.
"""

from __future__ import annotations

from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ....kernel_cache import address_of
from ....rotations import Array
from ...dependence import CERTAIN, inverse_bound
from ...tangents.reaction_tangent import NO_PUSH
from .exchange import Exchange

if TYPE_CHECKING:
    from .driver_evaluation import DriverEvaluation
    from .evaluation import DriverStates


class DriverFactor:
    """The factor of (1) in the tables of some ``states``.

    ``held``: its t, q, v, and (cd, ck, reactions in it), None where they are unknown. ``count``: how many factors were made.
    """

    def __init__(self, states: DriverStates) -> None:
        self.states, self.count = states, 0
        self.held: tuple[float, Array, Array, tuple[Any, Any, int]] | None = None

    def renew(self) -> None:
        """Room for new tables, of which no factor is known."""
        known, m = self.states.tables.system, self.states.system.n_lam
        n = known.n_v
        # what C reads and writes for a solution: two right-hand sides are those of a complex one
        self._given = Exchange({"q": known.n_q, "b": (2, n), "c": (2, m)})
        self._found = Exchange({"x": (2, n), "y": (2, m)})
        self._standing: Array | None = None  # the configuration that is in the first of them
        self._columns: tuple[int, Exchange] | None = None  # the same for several, with nothing but rows on the right
        self.held = None

    def prepare(self, ev: DriverEvaluation, cd: Any, ck: Any) -> bool:
        """Factor (1) at a state, with complex weights where factors of fields are complex.

        False where rows depend on each other, or nearly do.
        """
        states = self.states
        if self.held is not None and self.holds(ev, cd, ck):
            return True
        self.held = None

        a, lam = ev.forces
        found = states.balances(ev.alone, a[None], lam[None])
        if found is None:
            return False
        ev.balanced = a, lam, found

        q, _, below = self._given.put(self._placed(ev.q), None, lam)
        if isinstance(ck, complex):
            weights = np.array((cd, ck)).view(float)
            at = address_of(weights)
            ck_at = at + 2 * weights.itemsize
            verdict = states.library.driver_prepare_complex(states.address, q, at, ck_at, below, ev.t)
        else:
            verdict = states.library.driver_prepare(states.address, q, cd, ck, below, ev.reactions, ev.t)

        states.calls.raise_error()
        if verdict:
            return False
        self.held, self.count = (ev.t, ev.q, ev.alone[2][0], (cd, ck, ev.reactions)), self.count + 1
        return True

    def holds(self, ev: DriverEvaluation, cd: Any, ck: Any) -> bool:
        """Whether the factor is that of a state; velocities count where weights are those of stiffness or damping."""
        if not self._holds_in(ev.t, ev.q, (cd, ck, ev.reactions)):
            return False
        assert self.held is not None
        return not (cd or ck) or bool((self.held[2] == ev.alone[2][0]).all())

    def holds_masses(self, t: float, q: Array) -> bool:
        """Whether the factor is that of the masses in a configuration."""
        return self._holds_in(t, q, (0.0, 0.0, NO_PUSH))

    def _holds_in(self, t: float, q: Array, weights: tuple[Any, Any, int]) -> bool:
        """Whether the factor is that of a configuration; steps that took the tables write over it."""
        if self.states.taken or self.held is None:
            return False
        return self.held[::3] == (t, weights) and bool(np.logical_and.reduce(self.held[1] == q))

    def hold(self, t: float | None, q: Array | None = None, v: Array | None = None, *, new: bool = True) -> None:
        """Take note that the factor is that of the masses in a state, or, without one, of nothing that is known."""
        self.held = None if t is None or q is None or v is None else (t, q.copy(), v.copy(), (0.0, 0.0, NO_PUSH))
        self.count += self.held is not None and new

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """x like v and y (n_lam,) for the right-hand sides b and c, complex ones too: two of a real matrix, two parts of one
        of a complex one.
        """
        wide = self.states.tables.c.parts > 1
        if not wide and b.dtype.kind != "c":
            x, y = self._solve(b, c, columns=1)
            return x[0].copy(), y[0].copy()

        x, y = self._solve(np.array((b.real, b.imag)), np.array((c.real, c.imag)), columns=1 if wide else 2)
        return x[0] + 1j * x[1], y[0] + 1j * y[1]

    def _placed(self, q: Array) -> Array | None:
        """A configuration as C reads it; None where it stands there already."""
        if self._standing is q:
            return None
        self._standing = q
        return self.states.twin.configurations(q)

    def _solve(self, b: Array, c: Array, *, columns: int) -> tuple[Array, Array]:
        """x (2, n_v) and y (2, n_lam) of so many right-hand sides, as they stand in the room of this class."""
        assert self.held is not None
        states = self.states
        twin = states.twin
        q, right, below = self._given.put(self._placed(self.held[1]), twin.velocities(b), c)
        states.library.driver_solve(states.address, columns, q, right, below, *self._found.at)
        if states.calls.error is not None or states.calls.asked:
            states.calls.raise_error()
        x, y = self._found.arrays
        return twin.forces(x), y

    def closing(self, C: Array) -> Array:
        """x (n_v, k) that open the rows by the columns C (n_lam, k), in one call."""
        assert self.held is not None
        states = self.states
        n, (m, count) = states.tables.system.n_v, C.shape
        if self._columns is None or self._columns[0] != count:
            right, found = {"b": (count, n), "c": (count, m)}, {"x": (count, n), "y": (count, m)}
            self._columns = count, Exchange({"q": states.tables.system.n_q, **right, **found})
        room = self._columns[1]
        room.put(states.twin.configurations(self.held[1]), None, C.T)
        states.library.driver_solve(states.address, count, *room.at)
        return states.twin.forces(room.arrays[3]).T.copy()

    def answers(self, core: Array, seen: list[Array]) -> tuple[Array, list[Array]]:
        """What the core does (k, n_core), and what acts on the columns H of each field (k, ..), under forces on the core
        (k, n_core) and on nodes, of which the factor of a field has found H^T E^-1 b = ``seen`` (k, ..), in its axes.
        """
        assert self.held is not None
        states = self.states
        forces = np.ascontiguousarray(states.twin.velocities(core))
        seen_at, found = np.concatenate([np.zeros((len(core), 0)), *seen], axis=1), np.empty_like(forces)
        acting = np.empty_like(seen_at)
        at_rest = self._given.put(self._placed(self.held[1]), np.zeros(states.tables.system.n_v))
        states.library.driver_columns(
            states.address, *seen_at.shape, *at_rest, *map(address_of, (forces, seen_at, found, acting))
        )
        ends = list(accumulate((x.shape[1] for x in seen), initial=0))
        return states.twin.forces(found), [acting[:, a:b] for a, b in pairwise(ends)]

    def independent(self) -> bool:
        """Whether the rows certainly do not depend on each other, by the factor with masses only: as
        :func:`~fmbd_fenicsx.system.dependence.rows_are_independent`, with the true inertia.
        """
        assert self.held is not None
        states = self.states
        size = np.sqrt(states.tables.arrays["weight"])
        if not size.any():
            return True  # conditions of frames, which have no weight, and no other rows
        places = self._given.put(self._placed(self.held[1]), np.zeros(states.tables.system.n_v))
        below, found = self._given.arrays[2][0], self._found.arrays[1][0]

        def solve(x: Array) -> Array:
            np.multiply(size, x[:, 0], out=below)
            states.library.driver_solve(states.address, 1, *places, self._given.at[2], *self._found.at)
            return np.asarray(size * found)[:, None]

        return bool(inverse_bound(solve, len(size)) * states.tables.structure.shape.largest < 1.0 / CERTAIN**2)
