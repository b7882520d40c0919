"""One state of a system evaluated and solved by the driver: what makes a start consistent before compiled steps begin.

:class:`DriverEvaluation` has the names of :class:`~fmbd_fenicsx.system.system.Evaluation` and gives the same numbers to
roundoff. What the driver does not tell, as markers for sensors and energies, is that of NumPy.
"""

from __future__ import annotations

import ctypes
from functools import cached_property
from typing import Any

import numpy as np

from ...rotations import Array
from ..jacobian import DENSE_LIMIT, Jacobian
from ..mobility import CERTAIN, INVERSE_ITERATIONS
from ..system import Evaluation, System
from .calls import Calls
from .tables import Tables

STORAGE_LIMIT = 20_000_000  # numbers in the factor


class DriverStates:
    """The driver of a system without elastic fields, for single states."""

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
        self._given = _Exchange((self.system.n_q, n, n, m))  # what C reads
        self._found = _Exchange((n, m, m, m))  # and writes
        self._remembering: list[Any] = [items for items in self.tables.sources if items.remembers]
        self._held: tuple[float, Array, Array, tuple[float, float]] | None = None  # t, q, v and weights of the factor

    def give(self) -> tuple[Tables, Calls]:
        """The tables, for steps; they begin with new slopes of forces in Python."""
        if self.taken:
            self.renew()
        self.taken, self._held = True, None
        for loads in self.tables.whole:
            loads.astray[0] = 1
        return self.tables, self.calls

    def at(self, t: float, q: Array, v: Array | None = None) -> Evaluation:
        """The system in one state; without a velocity that of NumPy."""
        return Evaluation(self.system, t, q, v) if v is None else DriverEvaluation(self, t, q, v)

    def evaluated(self, ev: Evaluation) -> bool:
        """Whether a state is one of :meth:`at`."""
        return isinstance(ev, DriverEvaluation) and ev.states is self

    def sample(self, t: float) -> None:
        """Everything that depends on time only, for the calls to come."""
        if self.tables.c.samples:
            self.calls.sample(t)

    def balance(self, ev: DriverEvaluation, a: Array, lam: Array) -> Array | None:
        """M a + h + G^T lambda, like v; None where NumPy has something to say about the state."""
        self.sample(ev.t)
        for items in self._remembering:
            items.arrays["kept"][:] = items.formula.kept()
        given = self._given.put(ev.q, ev.v, a, lam)
        verdict = self.library.driver_balance(self.address, *given, ev.t, self._found.at[0])
        self.calls.raise_error()
        return None if verdict else self._found.arrays[0].copy()

    def constraints(self, ev: DriverEvaluation) -> tuple[Array, Array, Array] | None:
        """g, g_t and gamma, (n_lam,) each; gamma without the bias of surfaces. None as above."""
        self.sample(ev.t)
        given = self._given.put(ev.q, ev.v)
        if self.library.driver_constraints(self.address, *given, *self._found.at[1:]):
            return None
        gap, rate, gamma = (x.copy() for x in self._found.arrays[1:])
        for rows, motions in self.calls.moving:
            gamma[rows] -= [motion(ev.t)[2] for motion in motions]
        return gap, rate, gamma

    def rows(self, ev: DriverEvaluation) -> Array | None:
        """G, (n_lam, n_v); None as above."""
        G = np.zeros((self.system.n_lam, self.system.n_v))
        verdict = self.library.driver_rows(self.address, *self._given.put(ev.q, ev.v), G.ctypes.data)
        return None if verdict else G

    def speeds(self, ev: DriverEvaluation, x: Array) -> Array | None:
        """G x, (n_lam,); None as above."""
        verdict = self.library.driver_speeds(self.address, *self._given.put(ev.q, x), self._found.at[1])
        return None if verdict else self._found.arrays[1].copy()

    # -- solution ---------------------------------------------------------------------------------------------------------
    def prepare(self, ev: DriverEvaluation, cd: float, ck: float) -> bool:
        """Factor [M + cd C + ck K, G^T; G, 0] at a state; False where rows depend on each other, or nearly do."""
        assert ev.v is not None
        if self._holds(ev, (cd, ck)):
            return True
        self._held = None
        a, lam = ev.forces
        if self.balance(ev, a, lam) is None:
            return False
        q, _, _, lam = self._given.at
        if self.library.driver_prepare(self.address, q, cd, ck, lam, 0, ev.t):
            return False
        self.calls.raise_error()
        self._held, self.factors = (ev.t, ev.q, ev.v, (cd, ck)), self.factors + 1
        return True

    def _holds(self, ev: DriverEvaluation, weights: tuple[float, float]) -> bool:
        """Whether the factor is that of a state; velocities count where weights are those of stiffness or damping."""
        if self._held is None or self._held[0] != ev.t or self._held[3] != weights:
            return False
        _, q, v, _ = self._held
        return np.array_equal(q, ev.q) and (not any(weights) or np.array_equal(v, ev.v))

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """x like v and y (n_lam,) for the right-hand sides b and c."""
        assert self._held is not None
        q, right, _, below = self._given.put(self._held[1], b, None, c)
        self.library.driver_solve(self.address, q, right, below, *self._found.at[:2])
        return self._found.arrays[0].copy(), self._found.arrays[1].copy()

    def independent(self) -> bool:
        """Whether the rows certainly do not depend on each other, by the factor with masses only: as
        :func:`~fmbd_fenicsx.system.mobility.independent`, with the true inertia.
        """
        count = self.system.n_lam
        size = np.sqrt(self.tables.arrays["weight"][:count])
        zero, inverse = np.zeros(self.system.n_v), 0.0
        x = 1.0 + 0.5 * np.cos(np.arange(count))
        for _ in range(INVERSE_ITERATIONS):
            x = size * self.solve(zero, size * (x / np.linalg.norm(x)))[1]
            inverse = float(np.linalg.norm(x))
            if not np.isfinite(inverse):
                return False
        return inverse * count < 1.0 / CERTAIN**2


class _Exchange:
    """Arrays of the given lengths that C knows by their addresses ``at``."""

    def __init__(self, lengths: tuple[int, ...]) -> None:
        self.arrays = [np.zeros(length) for length in lengths]
        self.at = [x.ctypes.data for x in self.arrays]

    def put(self, *values: Array | None) -> list[int]:
        """Copy in the first arrays, as far as there are values; their addresses."""
        for x, value in zip(self.arrays, values, strict=False):
            if value is not None:
                x[:] = value
        return self.at[: len(values)]


class DriverEvaluation(Evaluation):
    """An evaluation whose constraints and balance come from the driver."""

    def __init__(self, states: DriverStates, t: float, q: Array, v: Array) -> None:
        self.states = states
        self.forces = (
            np.zeros(states.system.n_v),
            np.zeros(states.system.n_lam),
        )  # accelerations and multipliers given last
        super().__init__(states.system, t, q, v)

    @cached_property
    def _constraints(self) -> tuple[Array, Array, Array] | None:
        return self.states.constraints(self)

    def constraint(self) -> Array:
        """g(q, t), (n_lam,)."""
        found = self._constraints
        return super().constraint() if found is None else found[0].copy()

    def constraint_rate(self) -> Array:
        """g_t, (n_lam,)."""
        found = self._constraints
        return super().constraint_rate() if found is None else found[1].copy()

    def gamma(self) -> Array:
        """g'' - G a, (n_lam,)."""
        found = self._constraints
        return super().gamma() if found is None or self.system.markers.surface.size else found[2].copy()

    @cached_property
    def jacobian(self) -> Any:
        """G = dg/dv."""
        return DriverJacobian(self)

    def balance(self, a: Array, lam: Array | None = None) -> Array:
        """M a + h + G^T lambda (lambda left out when None), like v."""
        lam = np.zeros(self.system.n_lam) if lam is None else lam
        out, self.forces = self.states.balance(self, a, lam), (a, lam)
        usable = out is not None and np.isfinite(out).all()
        return out if usable else super().balance(a, lam)  # which says what is wrong


class DriverJacobian:
    """G of a state, products by the driver."""

    def __init__(self, ev: DriverEvaluation) -> None:
        self.ev = ev

    @cached_property
    def numpy(self) -> Jacobian:
        """The same as arrays with a pattern."""
        return Jacobian(self.ev)

    @cached_property
    def core(self) -> Any:
        """G, (n_lam, n_v), dense or sparse."""
        s = self.ev.system
        G = None if s.n_lam * s.n_v > DENSE_LIMIT or s.elements else self.ev.states.rows(self.ev)
        return self.numpy.core if G is None else G

    @property
    def port(self) -> Any:
        """The part on the ports of parts."""
        return self.numpy.port

    def times(self, v: Array) -> Array:
        """G v, (n_lam,)."""
        out = self.ev.states.speeds(self.ev, v)
        return self.numpy.times(v) if out is None else out

    def transposed(self, lam: Array) -> Array:
        """G^T lambda, like v."""
        return np.asarray(self.core.T @ lam)


def driver_states(system: System, library: Any) -> DriverStates | None:
    """The driver ``library`` for single states of a system that it knows; None where this has elastic fields, or is too large."""
    if system.fields:
        return None
    states = DriverStates(system, library)
    return states if states.tables.fronts.storage <= STORAGE_LIMIT else None
