"""Many configurations of one small system: the stages of a step, the directions of a difference quotient.

The names are those of :class:`~.evaluation.Evaluation`, with the configurations in front of every array: t (k,), q (k, n_q),
v (k, n_v), lambda (k, n_lam), G (k, n_lam, n_v). Where the compiled driver knows the system it evaluates all of them in one call
(:mod:`~.compiled.states.evaluation`); equations in coordinates of the user's own take arrays of configurations; others are
evaluated one by one.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..mechanics.bodies.coordinates import CoordinatePart
from ..rotations import Array
from .evaluation import Evaluation
from .lengths import Measured

if TYPE_CHECKING:
    from .tangents.jacobian import Jacobian


class Jacobians:
    """G of all configurations: ``core`` (k, n_lam, n_v)."""

    def __init__(self, core: Array) -> None:
        self.core = core

    def times(self, v: Array) -> Array:
        """G v, (k, n_lam)."""
        return np.asarray((self.core @ v[..., None])[..., 0])

    def transposed(self, lam: Array) -> Array:
        """G^T lambda, (k, n_v)."""
        return np.asarray((lam[:, None, :] @ self.core)[:, 0])


class FieldJacobians(Jacobians):
    """The same of systems with elastic fields, by products only."""

    def __init__(self, each: list[Jacobian]) -> None:
        self.each = each

    def times(self, v: Array) -> Array:
        """G v, (k, n_lam); collective."""
        return np.array([G.times(v[i]) for i, G in enumerate(self.each)])

    def transposed(self, lam: Array) -> Array:
        """G^T lambda, (k, n_v)."""
        return np.array([G.transposed(lam[i]) for i, G in enumerate(self.each)])


class EvaluationBatch:
    """Configurations evaluated one by one."""

    def __init__(self, system: Measured, t: Array, q: Array, v: Array) -> None:
        self.system, self.t, self.q, self.v = system, t, q, v

    @cached_property
    def _each(self) -> list[Evaluation]:
        return [Evaluation(self.system, float(t), self.q[i], self.v[i]) for i, t in enumerate(self.t)]

    def constraint(self) -> Array:
        """g, (k, n_lam)."""
        return np.array([ev.constraint() for ev in self._each])

    def opening(self) -> Array:
        """G v + g_t, (k, n_lam)."""
        return np.array([ev.opening() for ev in self._each])

    def gamma(self) -> Array:
        """g'' - G a, (k, n_lam)."""
        return np.array([ev.gamma() for ev in self._each])

    @cached_property
    def jacobian(self) -> Jacobians:
        """G of all configurations."""
        if self.system.fields:
            return FieldJacobians([ev.jacobian for ev in self._each])
        cores = [ev.jacobian.core for ev in self._each]
        return Jacobians(np.array([G if isinstance(G, np.ndarray) else G.toarray() for G in cores]))

    def balance(self, a: Array, lam: Array | None = None) -> Array:
        """M a + h + G^T lambda, (k, n_v)."""
        return np.array([ev.balance(a[i], None if lam is None else lam[i]) for i, ev in enumerate(self._each)])


class CoordinateBatch(EvaluationBatch):
    """Configurations of bodies in coordinates of the user's own, whose functions take many of them in a call."""

    def _rows(self, what: str, *arrays: Array) -> Array:
        """``values``, ``rate`` or ``gamma`` of all laws, (k, n_lam); ``arrays``: q, and v where it is asked for."""
        s = self.system
        out = np.zeros((len(self.q), s.n_lam))
        for law, span in s.port_constraints:
            at = s.port_slice(law.part)
            out[:, span] += law.many(what, self.t, *(x[:, at] for x in arrays))
        return out

    def constraint(self) -> Array:
        """g, (k, n_lam)."""
        return self._rows("values", self.q)

    def opening(self) -> Array:
        """G v + g_t, (k, n_lam)."""
        return self.jacobian.times(self.v) + self._rows("rate", self.q)

    def gamma(self) -> Array:
        """g'' - G a, (k, n_lam)."""
        return self._rows("gamma", self.q, self.v)

    @cached_property
    def jacobian(self) -> Jacobians:
        """G of all configurations."""
        s = self.system
        core = np.zeros((len(self.q), s.n_lam, s.n_v))
        for law, span in s.port_constraints:
            at = s.port_slice(law.part)
            core[:, span, at] += law.many("jacobian", self.t, self.q[:, at])
        return Jacobians(core)

    def balance(self, a: Array, lam: Array | None = None) -> Array:
        """M a + h + G^T lambda, (k, n_v)."""
        parts: tuple[Any, ...] = self.system.parts
        rows = [
            part.force_many(self.t, tuple(x[:, at] for x in (self.q, self.v, a)))
            for part, at in zip(parts, self.system.slices[1], strict=True)
        ]

        out = np.concatenate(rows, axis=1)
        return out if lam is None or not lam.size else out + self.jacobian.transposed(lam)


def in_coordinates(system: Measured) -> bool:
    """Whether all is said in coordinates of the user's own: no frames, no forces between markers."""
    plain = not system.n_frames and not system.batches and not system.forces and not system.traces
    return plain and all(isinstance(p, CoordinatePart) for p in system.parts)
