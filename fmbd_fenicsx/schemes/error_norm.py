"""Norms of errors of implicit schemes on constrained systems, by kind.

The solution has kinds of different smoothness. With w_q the tolerances of positions and w_v those of velocities, the error of
a step of size h is the largest of (root mean square over each kind)

    e_q / w_q;      index 3:   h e_v / w_q,     h^2 e_a / w_q
                    index 2:   e_v / w_v,       h e_a / w_v          with e_a = M^-1 e(G^T lambda)              (1)
                    index 1:   e_v / w_v

so multipliers are measured by the accelerations that they cause: units of forces and moments do not mix. Those of steps turn with
their joints, e(G^T lambda) = G^T e_lambda + (G^T lambda)_q e_q: by the first term alone a light link would tell huge errors.
Tolerances are relative to sizes that the model gives (length, one radian, the largest value of a coordinate or velocity so far),
so that a scene in other units takes the same steps.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ..checks import check_fields
from ..errors import require
from ..ranks import rank_sum
from ..rotations import Array
from ..system.control.memory_points import StepError
from ..system.element_memory import collocated
from ..system.layout import State
from ..system.lengths import farthest
from ..system.serialisation import Memory, Remembering, plain
from ..system.system import System
from ..system.tangents.linearise import Sizes
from .newton import LEFT_OF_PLACES
from .prescribed_ways import openings
from .rigid_motions import RigidMotions

EPS = float(np.finfo(float).eps)
FINEST = 100 * EPS
STRICT = 1e-5  # a tenth of what velocities may be off by over a step


def worst(*errors: float) -> float:
    """The largest of errors, zero of none; not a number where one is none, which max() loses behind others."""
    total = sum(errors)
    return max(errors, default=0.0) if total == total else total


def check_controlled(scheme: Any) -> None:
    """Check the fields of a scheme with error control, its tolerances among them."""
    check_fields(scheme)
    check_tolerance(scheme.rtol, scheme.atol, type(scheme).__name__)


def check_tolerance(rtol: float | None, atol: float | None, scheme: str) -> None:
    """Refuse tolerances that double precision cannot reach, or that are no tolerances."""
    if rtol is not None:
        require(
            FINEST <= rtol < 1.0,
            f"{scheme}: rtol = {rtol} is not usable; double precision allows {FINEST:.0e} <= rtol < 1.",
        )
    if atol is not None:
        require(bool(np.isfinite(atol)) and atol > 0, f"{scheme}: atol = {atol} must be positive.")
        require(
            rtol is not None, f"{scheme}: atol = {atol} belongs to error control, which begins with rtol; give both."
        )


class ErrorNorm(Remembering):
    """(1), with sizes that grow along the run. ``atol``: added to the tolerance of every coordinate (m, rad or its own unit).

    Deformations, of fields and of amplitudes of modes, count by their displacements against the largest one of their body that
    was seen, at least a hundredth of the model's length, their rates as h e_v / w_q in all forms: a stiff body with vibrations
    too small to matter does not hold the steps down. A field counts by its root mean square. The nodes of a rod are frames: what
    is no rigid motion of all of them is a deformation too, and so is what frames do with a small part of their body that vibrates
    (:class:`.RigidMotions`).
    """

    # of the tolerance of places, what velocities may be off by over a step: those that jump pass where it is short enough
    BRIEF: ClassVar = 1e-4
    keeps: ClassVar = {
        **dict.fromkeys(("q_size", "v_size", "deflections", "known"), plain()),
        **dict.fromkeys(("scale", "wq", "wv"), Memory.like_v),
    }

    def __init__(self, start: State, system: System, rtol: float, atol: float | None, index: int) -> None:
        self.system, self.rtol, self.atol, self.index = system, rtol, atol, index
        self.sizes = Sizes(system)
        self.v_size: Array = np.zeros(system.n_core)
        self.q_size: Array = np.zeros(system.n_core)
        # share of the model's length of which rtol is roundoff of places: no steps make errors smaller
        self.known = self.unknown(start) / (rtol * system.length)
        self.let_pass(self.BRIEF)
        self.deforming = [(k, p) for k, p in enumerate(system.parts) if p.distributed or p.rms is not None]
        self.deflections: Array = np.zeros(len(self.deforming))  # m, the largest so far
        self.scale: Array = np.ones(system.n_v)  # of positions, in the model
        self.wq: Array = np.ones(system.n_v)
        self.wv: Array = np.ones(system.n_v)
        self.rigid: RigidMotions | None = None

    def let_pass(self, brief: float) -> None:
        """A share as :attr:`BRIEF`, above that by which velocities are known from the roundoff of places."""
        self.brief = max(brief, min(self.known, 1.0))

    def update(self, state: State, h: float) -> None:
        """Take notice of a state; ``h`` is the step about to be taken. Collective where there are elastic fields."""
        s = self.system
        v = np.abs(state.v[: s.n_core])
        self.rigid = self._motions(state)
        self.q_size = np.maximum(self.q_size, self._reached(state.q))
        # the velocities that the accelerations reach within the step count too
        fast = np.maximum(v, h * np.abs(state.a[: s.n_core]))
        for block in self.sizes.blocks:
            fast[block] = np.maximum.reduce(fast[block], initial=0.0)
        self.v_size = np.maximum(self.v_size, fast)

        self.scale = self._sizes(state)
        self.wq = self.rtol * self.judged(state) + (0.0 if self.atol is None else self.atol)

        # by a step that is short enough velocities may jump; rates of deformations go with their positions over the step
        n = s.n_core
        rates = self.rtol * self.v_size + self.brief * self.wq[:n] / h
        self.wv = self.wq / h
        if self.deforming:
            rates = np.where(self.deformations[:n], self.wv[:n], rates)
        self.wv[:n] = rates

    def _reached(self, q: Array) -> Array:
        """Sizes of coordinates, those of frames at least what places are known to."""
        sizes = self.sizes.positions(q)
        if self.known > 1.0:
            sizes[: self.system.n_frames * self.system.motions.n_twist] *= self.known
        return sizes

    def _motions(self, state: State) -> RigidMotions | None:
        """What errors of rates are told apart by."""
        return RigidMotions.at(self.system, state) if self.index < 3 and RigidMotions.differ(self.system) else None

    @property
    def largest(self) -> tuple[Any, ...]:
        """The largest sizes so far."""
        return self.q_size, self.v_size, self.deflections

    def take_back(self, known: tuple[Any, ...], error: float) -> None:
        """The largest sizes before a step that was refused with this error."""
        self.q_size, self.v_size, self.deflections = known

    @contextmanager
    def looking(self) -> Iterator[None]:
        """What is looked at alone leaves nothing in the largest sizes."""
        known = self.largest
        try:
            yield
        finally:
            self.take_back(known, np.inf)

    def judged(self, state: State) -> Array:
        """Sizes like v that the tolerance of positions is relative to: those of the model."""
        # schemes that judge ways instead override this
        return self.scale

    @cached_property
    def deformations(self) -> Array:
        """Which velocities are those of deformations, (n_v,)."""
        out = np.zeros(self.system.n_v, dtype=bool)
        for k, _ in self.deforming:
            out[self.system.slices[1][k]] = True
        return out

    def _sizes(self, state: State) -> Array:
        """Sizes of positions, like v, those of deformations the largest of each body so far; collective with fields."""
        s = self.system
        if not self.deforming and s.n_v == s.n_core:
            return self.q_size
        out = np.concatenate((self.q_size, np.ones(s.n_v - s.n_core)))

        seen = np.array([_largest(s.local_q(state.q, k), part.rms) for k, part in self.deforming])
        if s.fields:
            seen = np.max(s.comm.allgather(seen), axis=0)
        # the largest so far, a hundredth of the model's length at least
        self.deflections = np.maximum(self.deflections, np.maximum(seen, 1e-2 * s.length))

        for (k, part), size in zip(self.deforming, self.deflections, strict=True):
            out[s.slices[1][k]] = size if part.rms is None else size / part.rms
        return out

    def __call__(self, h: float, e_q: Array, e_v: Array, e_a: Array | None = None) -> float:
        """The norm (1) of errors like v, (n,), or the largest over several, (s, n); collective."""
        wq = self.wq
        # velocities and accelerations of index 3 are of orders one and two less in h
        if self.index == 3:
            kinds = [e_q / wq, e_v * (h / wq)] + ([] if e_a is None else [e_a * (h * h / wq)])
        else:
            kinds = [e_q / wq]
            for error, power in ((e_v, 0), (None if self.index == 1 else e_a, 1)):
                if error is not None:
                    kinds += self._of_rates(h, error, power)
        return worst(*(self.mean(x) for x in kinds))

    def _of_rates(self, h: float, error: Array, power: int) -> list[Array]:
        """Errors of velocities (``power`` 0) or of accelerations (1) over their tolerances; those of deformations apart."""
        kinds = []
        if self.rigid is not None:
            bent = self.rigid.rest(error)
            kinds.append(bent * (h ** (power + 1) / self.wq))
            error = error - bent
        return [*kinds, error * (h**power / self.wv)]

    def of_memories(self, points: Array, past: Array, ends: Array, rate: float = 0.0, frequency: float = 0.0) -> float:
        """The largest error of a memory of elements, see :class:`.StepError`, in the step whose points were found last."""
        error = StepError(points, past, ends, rate, frequency, self.rtol, self.atol or 0.0)
        return worst(*(loads.memory_error(error) for loads in collocated(self.system)))

    def of_trapezoids(self, state: State) -> float:
        """The largest error of a memory of elements that goes by the trapezoidal rule to a state; collective."""
        found = collocated(self.system)
        kin = self.system.at(state.t, state.q, state.v).kin if found else None
        return worst(*(loads.trapezoid_error(kin, state.t, self.rtol, self.atol or 0.0) for loads in found))

    def pushed(self, h: float, a: Array) -> float:
        """The norm of accelerations, (n,), or the largest over several, that count in no error; collective."""
        return worst(*(self.mean(x) for x in self._of_rates(h, a, 1)))

    def mean(self, x: Array) -> float:
        """Root mean square of the core, or that of the worst field, of arrays like v, (..., n_v); collective."""
        s, n = self.system, self.system.n_core
        # every field by itself: its many nodes would hide the core, or the core them
        core = x[..., :n]
        every = np.add.reduce(core * core, axis=-1)  # ufuncs alone: einsum and max enter Python for each array
        means = [float(every if x.ndim == 1 else np.maximum.reduce(every, axis=None)) / n] if n else []
        if s.fields:
            parts = [x[..., s.slices[1][k]] for k, _ in s.fields]
            squares = np.array([np.einsum("...i,...i->...", y, y) for y in parts])
            counts = rank_sum(s.comm, np.array([float(p.n) for _, p in s.fields]))
            total = rank_sum(s.comm, squares).reshape(len(parts), -1).max(axis=1)
            means += list(total / np.maximum(counts, 1.0))
        return float(np.sqrt(worst(*means)))

    def constant(self, h: float, state: State) -> float:
        """What a Newton increment may move (m) in constant steps: rtol of the accelerations, above roundoff of places."""
        s = self.system
        typical = max(s.max_abs(state.a), 1e-3 * s.max_abs(state.v) / h)
        return max(self.rtol * h * h * typical, self.unknown(state))

    def unknown(self, state: State) -> float:
        """What increments of places may be roundoff of, m."""
        return max(64 * EPS * self.system.length, LEFT_OF_PLACES * farthest(self.system, state.q))


def _largest(u: Array, rms: Array | None) -> float:
    """Largest displacement of nodes, or that of amplitudes of shapes, m."""
    return float(np.abs(u if rms is None else u * rms).max(initial=0.0))


def _configuration(m: Memory, name: str, q: Array | None) -> Array | None:
    """An array like q, or None as long as there is none."""
    if not m(f"{name} known", q is not None):
        return None
    found: Array = m.like_q(name, np.zeros(m.system.n_q) if q is None else q)
    return found


class NormOfWays(ErrorNorm):
    """The norm of a scheme that judges positions alone: those of frames against the way that they have gone so far.

    A rod or a chain that moves by a thousandth of its length would else pass with errors as large as its motion. With w the
    largest way of a frame over the model's length, or its turn in radians,

        sizes = max(min(w, 1), least) (length, one radian),                                                              (1)
        least = 1e-6, or what leaves 1e-12 or the roundoff of places at the start beside rtol

    so that bodies at rest, which move by roundoff, take large steps. Beside a motion that begins, what has moved so far is no
    measure. What prescribed motions will move belongs to the way from the start. Where a step has led that was refused with an
    error below its way, error rtol w < w, foretells the motion under loads that have just come: it counts as a way that fades
    from step to step, as loads may have gone before they have moved anything so far. One that has gone astray leaves nothing.

    Where a frame hangs on a part of its body, what it does beside the mass of that is undone by displacements, which count.
    """

    LEAST, FINEST = 1e-6, 1e-12
    # shares of a stretch at which prescribed motions are looked at
    PLACES = (0.118, 0.236, 0.382, 0.5, 0.618, 0.764, 0.882, 1.0)
    keeps: ClassVar = {**ErrorNorm.keeps, "origin": _configuration, **dict.fromkeys(("way", "foretold"), plain())}

    def __init__(self, start: State, system: System, rtol: float, atol: float | None, index: int) -> None:
        super().__init__(start, system, rtol, atol, index)
        self.origin: Array | None = None
        self.way = self.foretold = 0.0

    def take_back(self, known: tuple[Any, ...], error: float) -> None:
        """With the way, which foretells that of steps to come unless it is known to less than itself."""
        if error * self.rtol < 1.0:
            self.foretold = max(self.foretold, self.way)
        *sizes, self.way = known
        super().take_back(tuple(sizes), error)

    @property
    def counted(self) -> float:
        """max(min(w, 1), least) of (1), with what is foretold."""
        return max(min(max(self.way, self.foretold), 1.0), self.least)

    @property
    def largest(self) -> tuple[Any, ...]:
        """With the way."""
        return *super().largest, self.way

    def _reached(self, q: Array) -> Array:
        return self.sizes.positions(q)  # ``least`` knows what places are known to

    def _motions(self, state: State) -> RigidMotions | None:
        return (
            RigidMotions.of_frames(self.system, state)
            if any(p.mean_rates is not None for p in self.system.parts)
            else None
        )

    def __call__(self, h: float, e_q: Array, e_v: Array, e_a: Array | None = None) -> float:
        """(1) of the base, without what frames do beside the mass of their bodies; collective."""
        return super().__call__(h, e_q if self.rigid is None else e_q - self.rigid.rest(e_q), e_v, e_a)

    def update(self, state: State, h: float) -> None:
        """As of the base; velocities of frames are known to the roundoff of places over the step: behind a start these have gone
        too short a way to allow for it.
        """
        super().update(state, h)
        unknown = self.unknown(state) / h
        for block, unit in zip(self.sizes.blocks, (self.system.length, 1.0), strict=True):
            self.wv[block] += unknown * unit / self.system.length

    def of_speeds(self, h: float, e_v: Array) -> float:
        """Errors of velocities over tolerances of their own; collective."""
        if self.rigid is not None:
            e_v = e_v - self.rigid.rest(e_v)
        return self.mean(e_v / self.wv)

    def look_ahead(self, state: State, span: float) -> None:
        """Take notice of what prescribed motions move within ``span`` (s): by how much they open constraints of a state that is
        held; collective.
        """
        s = self.system
        if not s.n_lam:
            return
        opened = openings(s, state, state.t + span * np.array(self.PLACES))
        self.way = max(self.way, float(opened.max(initial=0.0)) / s.length)

    def judged(self, state: State) -> Array:
        """(1), with the state among those that were reached."""
        s = self.system
        if self.origin is None:
            self.origin = state.q.copy()
        moved = s.difference(self.origin, state.q)
        translations, rotations = self.sizes.blocks
        for block, unit in ((translations, s.length), (rotations, 1.0)):
            self.way = max(self.way, float(np.abs(moved[block]).max(initial=0.0)) / unit)

        sizes = self.scale.copy()
        sizes[: s.n_frames * s.motions.n_twist] *= self.counted
        return sizes

    def of_lengths(self, x: Array) -> Array:
        """Lengths over what those of frames may be in error."""
        share = self.rtol * self.counted
        return x / (share * self.system.length + (0.0 if self.atol is None else self.atol))

    @property
    def least(self) -> float:
        """``least`` of (1)."""
        return max(self.LEAST, min(self.FINEST / self.rtol, 1.0), self.known)
