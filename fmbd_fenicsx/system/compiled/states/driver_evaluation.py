"""A configuration, or many, whose balance, constraints and derivatives the driver tells; what it does not tell is NumPy's."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ....rotations import Array
from ...evaluation import Evaluation
from ...evaluation_batch import EvaluationBatch, Jacobians
from ...tangents.jacobian import Jacobian, dense_core
from ...tangents.reaction_tangent import NO_PUSH

if TYPE_CHECKING:
    from .evaluation import DriverStates


class _Constraints:
    """Constraints by the driver, of one configuration or of many; those of NumPy, the next base, where it did not tell.

    Answers are the caller's own.
    """

    _told: Array | None  # in the order of :meth:`DriverStates.constraints`

    def constraint(self) -> Array:
        """g(q, t), (n_lam,) or (k, n_lam)."""
        told = self._told
        return super().constraint() if told is None else told[0].copy()  # type: ignore[misc]

    def opening(self) -> Array:
        """G v + g_t, likewise."""
        told = self._told
        return super().opening() if told is None else told[1].copy()  # type: ignore[misc]

    def gamma(self) -> Array:
        """g'' - G a, likewise."""
        told = self._told
        return super().gamma() if told is None else told[3].copy()  # type: ignore[misc]


class DriverEvaluation(_Constraints, Evaluation):
    """An evaluation whose constraints and balance come from the driver."""

    def __init__(self, states: DriverStates, t: float, q: Array, v: Array | None) -> None:
        super().__init__(states.system, t, q, v)
        self.states = states
        rest = np.zeros(self.system.n_v) if v is None else v
        self.alone = np.array([t]), q[None], rest[None]  # the configuration as one of many
        self.balanced: tuple[Array, Array, Array] | None = None  # a and lambda that a balance is known for, with it

    def is_at(self, t: float, q: Array, v: Array | None) -> bool:
        """Whether this is the same state."""
        if self.t != t or (self.v is None) != (v is None):
            return False
        same = np.logical_and.reduce  # the method all() of arrays is a call of Python
        return bool(same(self.q == q)) and (v is None or bool(same(self.v == v)))

    def again(self) -> DriverEvaluation:
        """The same state for someone else, with all that is known of it but the forces."""
        other = DriverEvaluation.__new__(DriverEvaluation)
        other.__dict__.update(self.__dict__)
        other.forces, other.balanced = (np.zeros(self.system.n_v), np.zeros(self.system.n_lam)), None
        other.reactions = NO_PUSH
        return other

    @cached_property
    def _told(self) -> Array | None:  # type: ignore[override]
        found = self.states.constraints(self.alone)
        return None if found is None else found[:, 0]

    def constraint_rate(self) -> Array:
        """g_t, (n_lam,)."""
        return super().constraint_rate() if self._told is None else self._told[2].copy()

    @cached_property
    def jacobian(self) -> Jacobian:
        """G = dg/dv."""
        return DriverJacobian(self)

    def balance(self, a: Array, lam: Array | None = None) -> Array:
        """M a + h + G^T lambda (lambda left out when None), like v."""
        lam = np.zeros(self.system.n_lam) if lam is None else lam
        known, self.balanced = self.balanced, None
        found: Array | None
        if known is not None and known[0] is a and known[1] is lam:
            found = known[2]
        else:
            found = self.states.balances(self.alone, a[None], lam[None])
        if found is None or not np.logical_and.reduce(np.isfinite(found), axis=None):
            return super().balance(a, lam)  # which says what is wrong
        self.forces = a, lam
        return found[0]

    def work(self, xi: Array) -> float:
        """Work of the applied forces along an increment xi, like v."""
        found = self.states.work(self.alone, xi)
        return super().work(xi) if found is None else found

    def _found_energies(self) -> dict[str, float]:
        found = self.states.energies(self.alone)
        if found is None:
            return super()._found_energies()
        return dict(zip(("kinetic", "elastic", "weight", "springs"), found[0].tolist(), strict=True))


class DriverJacobian(Jacobian):
    """G of a state by the driver; its parts are made when someone looks at them."""

    def __init__(self, ev: DriverEvaluation) -> None:
        self.ev = ev
        self.system = ev.system
        self.t = ev.t
        self.bent = ev.bent

    @cached_property
    def numpy(self) -> Jacobian:
        """The rows as arrays with a pattern."""
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

    def times(self, v: Array) -> Array:
        """G v, (n_lam,)."""
        t, q, _ = self.ev.alone
        found = self.ev.states.along((t, q, v[None]))
        return super().times(v) if found is None else found[0]


class DriverJacobians(Jacobians):
    """G of many configurations by the driver, made when someone looks at it."""

    def __init__(self, batch: DriverBatch) -> None:
        self.batch = batch

    @cached_property
    def core(self) -> Array:  # type: ignore[override]
        """G, (k, n_lam, n_v)."""
        G = self.batch.states.rows(self.batch.all)
        return EvaluationBatch(self.batch.system, *self.batch.all).jacobian.core if G is None else G

    def times(self, v: Array) -> Array:
        """G v, (k, n_lam)."""
        t, q, _ = self.batch.all
        found = self.batch.states.along((t, q, v))
        return super().times(v) if found is None else found


class DriverBatch(_Constraints, EvaluationBatch):
    """Many configurations by the driver."""

    def __init__(self, states: DriverStates, t: Array, q: Array, v: Array) -> None:
        super().__init__(states.system, t, q, v)
        self.states, self.all = states, (t, q, v)

    @cached_property
    def _each(self) -> list[Evaluation]:
        return [self.states.at(float(t), self.q[i], self.v[i]) for i, t in enumerate(self.t)]

    @cached_property
    def _told(self) -> Array | None:  # type: ignore[override]
        return self.states.constraints(self.all)

    @cached_property
    def jacobian(self) -> Jacobians:
        """G of all configurations."""
        return DriverJacobians(self)

    def balance(self, a: Array, lam: Array | None = None) -> Array:
        """M a + h + G^T lambda, (k, n_v); the constraints are evaluated beside it."""
        found = self.states.together(self.all, a, lam)
        if found is None or not np.isfinite(found[0]).all():
            return super().balance(a, lam)
        self._told = found[1]
        return found[0]
