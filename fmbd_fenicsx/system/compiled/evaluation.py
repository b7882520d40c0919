"""A system evaluated and solved by the driver: one configuration, or many in a call.

What schemes in Python ask for at every stage, the balance and the constraints with their derivatives, comes from the driver's
tables, to roundoff the numbers of :class:`~..evaluation.Evaluation`. Markers, energies and momenta are NumPy's, made when someone
asks for them. Systems without elastic fields.
"""

from __future__ import annotations

import copy
import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeGuard

import numpy as np

from ...rotations import Array
from ..evaluation import Evaluation
from ..jacobian import Jacobian, dense_core
from ..many import Jacobians, Many
from ..mobility import certainly_regular
from ..system import System
from .calls import Calls
from .items import covers
from .library import driver_library
from .structures import address_of
from .tables import Tables, covers_bodies

STORAGE_LIMIT = 20_000_000  # numbers in the factor
LOOK = 3  # a verdict, as in driver/tables.h

Configurations = tuple[Array, Array, Array]  # t (k,), q (k, n_q), v (k, n_v)


class DriverStates:
    """The driver of a system, for states that Python asks for; arrays have the configurations in front, (k, ..)."""

    def __init__(self, system: System, library: Any) -> None:
        self.system, self.library, self.factors = system, library, 0
        self.renew()

    def renew(self) -> None:
        """Tables of its own, after steps have taken the former ones."""
        self.tables = Tables(self.system, redundant=False)
        self.calls = Calls(self.tables)
        self.address = ctypes.addressof(self.tables.c)
        self.taken = False
        n, m = self.system.n_v, self.system.n_lam
        self._given = _Exchange((self.system.n_q, n, m))  # what C reads
        self._found = _Exchange((n, m))  # and writes
        self._held: tuple[float, Array, Array, tuple[float, float]] | None = None  # t, q, v and weights of the factor

    @property
    def remembers(self) -> bool:
        """Whether forces depend on more than a state: elements have a memory."""
        return bool(self.tables.remembering)

    def give(self) -> tuple[Tables, Calls]:
        """The tables, for steps; they begin with new slopes of forces in Python."""
        if self.taken:
            self.renew()
        self.taken, self._held = True, None
        for loads in self.tables.whole:
            loads.astray[0] = 1
        return self.tables, self.calls

    def at(self, t: float, q: Array, v: Array | None = None) -> DriverEvaluation:
        """The system in one configuration (and velocity)."""
        return DriverEvaluation(self, t, q, v)

    def evaluated(self, ev: Evaluation) -> TypeGuard[DriverEvaluation]:
        """Whether a state is one of :meth:`at`."""
        return isinstance(ev, DriverEvaluation) and ev.states is self

    def many(self, t: Array, q: Array, v: Array) -> DriverMany:
        """Configurations at the times t (k,): q (k, n_q), v (k, n_v)."""
        return DriverMany(self, t, q, v)

    def balances(self, at: Configurations, a: Array, lam: Array | None) -> Array | None:
        """M a + h + G^T lambda, (k, n_v); None where NumPy has something to say."""
        out = np.empty((len(at[0]), self.system.n_v))
        return out if self._ask(self.library.driver_balances, (*at, a, lam), (out,)) else None

    def constraints(self, at: Configurations) -> tuple[Array, Array, Array, Array] | None:
        """g, G v + g_t, g_t and gamma, (k, n_lam) each; gamma without the bias of surfaces. None as above."""
        gap, opening, rate, gamma = np.empty((4, len(at[0]), self.system.n_lam))
        if not self._ask(self.library.driver_constraints, at, (gap, opening, rate, gamma)):
            return None
        for rows, motions in self.calls.moving:
            gamma[:, rows] -= [[motion(float(t))[2] for motion in motions] for t in at[0]]
        return gap, opening, rate, gamma

    def rows(self, at: Configurations) -> Array | None:
        """G, (k, n_lam, n_v); None as above."""
        out = np.empty((len(at[0]), self.system.n_lam, self.system.n_v))
        return out if self._ask(self.library.driver_rows, at, (out,)) else None

    def _ask(self, function: Any, given: tuple[Array | None, ...], wanted: tuple[Array, ...]) -> bool:
        """One call for all configurations; whether they have been evaluated."""
        self.tables.recall()
        arrays = [None if x is None else np.ascontiguousarray(x, dtype=float) for x in given]
        places = [None if x is None else address_of(x) for x in (*arrays, *wanted)]
        verdict = function(self.address, len(wanted[0]), *places)
        self.calls.raise_error()
        if verdict == LOOK:
            self.tables.look()
        return not verdict

    # -- solution ---------------------------------------------------------------------------------------------------------
    def prepare(self, ev: DriverEvaluation, cd: float, ck: float) -> bool:
        """Factor [M + cd C + ck K, G^T; G, 0] at a state; False where rows depend on each other, or nearly do."""
        if self._holds(ev, (cd, ck)):
            return True
        self._held = None
        a, lam = ev.forces
        if self.balances(ev.alone, a[None], lam[None]) is None:
            return False
        q, _, below = self._given.put(ev.q, None, lam)
        verdict = self.library.driver_prepare(self.address, q, cd, ck, below, 0, ev.t)
        self.calls.raise_error()
        if verdict:
            return False
        self._held, self.factors = (ev.t, ev.q, ev.alone[2][0], (cd, ck)), self.factors + 1
        return True

    def _holds(self, ev: DriverEvaluation, weights: tuple[float, float]) -> bool:
        """Whether the factor is that of a state; velocities count where weights are those of stiffness or damping."""
        if self._held is None or self._held[0] != ev.t or self._held[3] != weights:
            return False
        _, q, v, _ = self._held
        return np.array_equal(q, ev.q) and (not any(weights) or np.array_equal(v, ev.alone[2][0]))

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """x like v and y (n_lam,) for the right-hand sides b and c."""
        assert self._held is not None
        q, right, below = self._given.put(self._held[1], b, c)
        self.library.driver_solve(self.address, q, right, below, *self._found.at[:2])
        return self._found.arrays[0].copy(), self._found.arrays[1].copy()

    def independent(self) -> bool:
        """Whether the rows certainly do not depend on each other, by the factor with masses only: as
        :func:`~fmbd_fenicsx.system.mobility.independent`, with the true inertia.
        """
        size, nothing = np.sqrt(self.tables.arrays["weight"][: self.system.n_lam]), np.zeros(self.system.n_v)

        def solve(x: Array) -> Array:
            return np.asarray(size * self.solve(nothing, size * x)[1])

        return certainly_regular(solve, len(size), float(len(size)))


class _Exchange:
    """Arrays of the given lengths that C knows by their addresses ``at``."""

    def __init__(self, lengths: tuple[int, ...]) -> None:
        self.arrays = [np.zeros(length) for length in lengths]
        self.at = [address_of(x) for x in self.arrays]

    def put(self, *values: Array | None) -> list[int]:
        """Copy in the first arrays, as far as there are values; their addresses."""
        for x, value in zip(self.arrays, values, strict=False):
            if value is not None:
                x[:] = value
        return self.at[: len(values)]


@dataclass(frozen=True)
class Told:
    """What the driver told of constraints, in the order of :meth:`DriverStates.constraints`; None where it did not."""

    found: tuple[Array, ...] | None

    def get(self, which: int, numpy: Callable[[], Array]) -> Array:
        """One of the answers, the caller's own; that of ``numpy`` where there is none."""
        return numpy() if self.found is None else self.found[which].copy()


class DriverEvaluation(Evaluation):
    """An evaluation whose constraints and balance come from the driver."""

    def __init__(self, states: DriverStates, t: float, q: Array, v: Array | None) -> None:
        super().__init__(states.system, t, q, v)
        rest = np.zeros(states.system.n_v) if v is None else v
        self.states, self.alone = states, (np.array([t]), q[None], rest[None])
        nothing: tuple[Array, Array] = np.zeros(states.system.n_v), np.zeros(states.system.n_lam)
        self.forces = nothing  # a and lambda given last

    def again(self) -> DriverEvaluation:
        """The same state for someone else, with all that is known of it but the forces."""
        self.system.move(self.t)
        other = copy.copy(self)
        other.forces = np.zeros(self.system.n_v), np.zeros(self.system.n_lam)
        return other

    @cached_property
    def _told(self) -> Told:
        found = self.states.constraints(self.alone)
        return Told(None if found is None else tuple(x[0] for x in found))

    def constraint(self) -> Array:
        """g(q, t), (n_lam,)."""
        return self._told.get(0, super().constraint)

    def opening(self) -> Array:
        """G v + g_t, (n_lam,)."""
        return self._told.get(1, super().opening)

    def constraint_rate(self) -> Array:
        """g_t, (n_lam,)."""
        return self._told.get(2, super().constraint_rate)

    def gamma(self) -> Array:
        """g'' - G a, (n_lam,)."""
        return super().gamma() if self.system.markers.surface.size else self._told.get(3, super().gamma)

    @cached_property
    def jacobian(self) -> Jacobian:
        """G = dg/dv."""
        return DriverJacobian(self)

    def balance(self, a: Array, lam: Array | None = None) -> Array:
        """M a + h + G^T lambda (lambda left out when None), like v."""
        lam = np.zeros(self.system.n_lam) if lam is None else lam
        found, self.forces = self.states.balances(self.alone, a[None], lam[None]), (a, lam)
        if found is None or not np.isfinite(found).all():
            return super().balance(a, lam)  # which says what is wrong
        return found[0]


class DriverJacobian(Jacobian):
    """G of a state by the driver; its parts are made when someone looks at them."""

    def __init__(self, ev: DriverEvaluation) -> None:
        self.ev, self.system, self.t, self.bent = ev, ev.system, ev.t, ev.bent

    @cached_property
    def numpy(self) -> Jacobian:
        """The same as arrays with a pattern."""
        return Jacobian(self.ev)

    @cached_property
    def core(self) -> Any:  # type: ignore[override]
        """G, (n_lam, n_v), dense or sparse."""
        G = self.ev.states.rows(self.ev.alone) if dense_core(self.system) else None
        return self.numpy.core if G is None else G[0]

    @cached_property
    def port(self) -> Any:  # type: ignore[override]
        """The part on the ports of parts."""
        return self.numpy.port


class DriverMany(Many):
    """Many configurations by the driver."""

    def __init__(self, states: DriverStates, t: Array, q: Array, v: Array) -> None:
        super().__init__(states.system, t, q, v)
        self.states, self.all = states, (t, q, v)

    @cached_property
    def _told(self) -> Told:
        return Told(self.states.constraints(self.all))

    def constraint(self) -> Array:
        """g, (k, n_lam)."""
        return self._told.get(0, super().constraint)

    def opening(self) -> Array:
        """G v + g_t, (k, n_lam)."""
        return self._told.get(1, super().opening)

    def gamma(self) -> Array:
        """g'' - G a, (k, n_lam)."""
        return super().gamma() if self.system.markers.surface.size else self._told.get(3, super().gamma)

    @cached_property
    def jacobian(self) -> Jacobians:
        """G of all configurations."""
        G = self.states.rows(self.all)
        return super().jacobian if G is None else Jacobians(G)

    def balance(self, a: Array, lam: Array | None = None) -> Array:
        """M a + h + G^T lambda, (k, n_v)."""
        found = self.states.balances(self.all, a, lam)
        return super().balance(a, lam) if found is None or not np.isfinite(found).all() else found


def driver_states(system: System) -> DriverStates | None:
    """The driver for states of a system that it knows; None where it does not know all of it, or where it is too large."""
    if system.fields or not covers_bodies(system) or not covers(system):
        return None
    library = driver_library(system.motions.dim)
    states = None if library is None else DriverStates(system, library)
    return states if states is None or states.tables.fronts.storage <= STORAGE_LIMIT else None


def use_driver(system: System) -> None:
    """Let the driver evaluate a system from now on, where it knows all of it. It keeps no forces of stiffened bodies."""
    states = None if system.driver is not None or system.curved else driver_states(system)
    if states is not None:
        system.cache["driver"] = states
