"""Error control of implicit schemes on constrained systems: norms by kind, step sizes, statistics.

The solution has kinds of different smoothness. With w_q the tolerances of positions and w_v those of velocities, the error of
a step of size h is the largest of (root mean square over each kind)

    e_q / w_q;      index 3:   h e_v / w_q,     h^2 e_a / w_q
                    index 2:   e_v / w_v,       h e_a / w_v          with e_a = M^-1 G^T e_lambda               (1)
                    index 1:   e_v / w_v

so multipliers are measured by the accelerations that they cause: units of forces and moments do not mix. Tolerances are relative
to sizes that the model gives (length, one radian, the largest value of a coordinate or velocity so far), so that a scene
in other units takes the same steps.

Step sizes follow the predictive control of Gustafsson, doi:10.1145/198429.198437, with the limits of Hairer and Wanner,
Solving ODEs II, section IV.8, doi:10.1007/978-3-642-05221-7.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ..checks import check_fields
from ..errors import ConvergenceError, require
from ..fem.fields import rank_sum
from ..rotations import Array
from ..system.serialisation import Memory, Remembering, plain
from ..system.system import State, System
from ..system.tangents.linearise import Sizes
from .rigid_motions import RigidMotions

ROUNDOFF = 0.05  # Newton increments that stagnate below this share of the tolerance are accepted
STAGNATION = 100.0  # the same with constant steps, where the tolerance may lie below the roundoff of stiff forces
TURN = 2.5  # rad
LEAST_ERROR = 1e-2  # of errors that are remembered
REFUSED = 0.1, 0.9  # least and most that is left of the size of a step that its error has refused
PATIENCE = 40  # refusals of one step
FADING = 0.8  # of the largest error of late, from step to step
EPS = float(np.finfo(float).eps)
FINEST = 100 * EPS


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


class ErrorNorm(Remembering):
    """(1), with sizes that grow along the run. ``atol``: added to the tolerance of every coordinate (m, rad or its own unit).

    Deformations, of fields and of amplitudes of modes, count by their displacements against the largest one of their body that
    was seen, at least a hundredth of the model's length, their rates as h e_v / w_q in all forms: a stiff body with vibrations
    too small to matter does not hold the steps down. A field counts by its root mean square. The nodes of a rod are frames: what
    is no rigid motion of all of them is a deformation too (:class:`.RigidMotions`).
    """

    keeps: ClassVar = {
        **dict.fromkeys(("q_size", "v_size", "deflections"), plain()),
        **dict.fromkeys(("scale", "wq", "wv"), Memory.like_v),
    }

    def __init__(self, system: System, rtol: float, atol: float | None, index: int) -> None:
        self.system, self.rtol, self.atol, self.index = system, rtol, atol, index
        self.sizes = Sizes(system)
        self.v_size: Array = np.zeros(system.n_core)
        self.q_size: Array = np.zeros(system.n_core)
        self.deforming = [(k, p) for k, p in enumerate(system.parts) if p.distributed or p.rms is not None]
        self.deflections: Array = np.zeros(len(self.deforming))  # m, the largest so far
        self.scale: Array = np.ones(system.n_v)  # of positions, in the model
        self.wq: Array = np.ones(system.n_v)
        self.wv: Array = np.ones(system.n_v)
        self.rods: RigidMotions | None = None

    def update(self, state: State, h: float) -> None:
        """Take notice of a state; ``h`` is the step about to be taken. Collective where there are elastic fields."""
        s = self.system
        v = np.abs(state.v[: s.n_core])
        if s.elements and self.index < 3:
            self.rods = RigidMotions.at(s, state)
        self.q_size = np.maximum(self.q_size, self.sizes.positions(state.q))
        # the velocities that the accelerations reach within the step count too
        fast = np.maximum(v, h * np.abs(state.a[: s.n_core]))
        for block in self.sizes.blocks:
            fast[block] = np.maximum.reduce(fast[block], initial=0.0)
        self.v_size = np.maximum(self.v_size, fast)

        self.scale = self._sizes(state)
        self.wq = self.rtol * self.judged(state) + (0.0 if self.atol is None else self.atol)

        # rates of deformations go with their positions over the step
        n = s.n_core
        rates = self.rtol * self.v_size + 1e-4 * self.wq[:n] / h
        self.wv = self.wq / h
        if self.deforming:
            rates = np.where(self.deformations[:n], self.wv[:n], rates)
        self.wv[:n] = rates

    @property
    def largest(self) -> tuple[Any, ...]:
        """The largest sizes so far."""
        return self.q_size, self.v_size, self.deflections

    def take_back(self, known: tuple[Any, ...], error: float) -> None:
        """The largest sizes before a step that was refused with this error."""
        self.q_size, self.v_size, self.deflections = known

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
        wq, wv = self.wq, self.wv
        # velocities and accelerations of index 3 are of orders one and two less in h
        if self.index == 3:
            kinds = [e_q / wq, e_v * (h / wq)] + ([] if e_a is None else [e_a * (h * h / wq)])
        else:
            kinds = [e_q / wq]
            for error, power in ((e_v, 0), (None if self.index == 1 else e_a, 1)):
                if error is None:
                    continue
                if self.rods is not None:
                    bent = self.rods.rest(error)
                    kinds.append(bent * (h ** (power + 1) / wq))
                    error = error - bent
                kinds.append(error * (h**power / wv))
        return max([self.mean(x) for x in kinds], default=0.0)

    def weights(self, h: float) -> Array | None:
        """What errors of places, of velocities and of accelerations are multiplied by before their means are taken, (3, n_v);
        None where the norm asks for more.
        """
        if self.rods is not None:
            return None
        if self.index == 3:
            return np.array([1.0, h, h * h])[:, None] / self.wq
        return np.array([1.0 / self.wq, 1.0 / self.wv, h / self.wv])

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
        return float(np.sqrt(max(means, default=0.0)))

    def constant(self, h: float, state: State) -> float:
        """What a Newton increment may move (m) in runs with constant steps: rtol of the accelerations, above roundoff."""
        s = self.system
        typical = max(s.max_abs(state.a), 1e-3 * s.max_abs(state.v) / h)
        return max(self.rtol * h * h * typical, 64 * EPS * s.length)


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

        sizes = max(min(w, 1), least) (length, one radian),      least = 1e-6, or what leaves 1e-12 beside rtol           (1)

    so that bodies at rest, which move by roundoff, take large steps. Beside a motion that begins, what has moved so far is no
    measure. What prescribed motions will move belongs to the way from the start. So does where a step has led that was refused
    with an error below its way, error rtol w < w: it foretells the motion under loads that have just come. One that has gone
    astray leaves nothing.
    """

    LEAST, FINEST = 1e-6, 1e-12
    # shares of a stretch at which prescribed motions are looked at
    PLACES = (0.118, 0.236, 0.382, 0.5, 0.618, 0.764, 0.882, 1.0)
    keeps: ClassVar = {**ErrorNorm.keeps, "origin": _configuration, "way": plain()}

    def __init__(self, system: System, rtol: float, atol: float | None, index: int) -> None:
        super().__init__(system, rtol, atol, index)
        self.origin: Array | None = None
        self.way = 0.0

    def take_back(self, known: tuple[Any, ...], error: float) -> None:
        """With the way, but for one that is known to less than itself."""
        *sizes, way = known
        super().take_back(tuple(sizes), error)
        if not error * self.rtol < 1.0:
            self.way = way

    @property
    def largest(self) -> tuple[Any, ...]:
        """With the way."""
        return *super().largest, self.way

    def look_ahead(self, state: State, span: float) -> None:
        """Take notice of what prescribed motions move within ``span`` (s): by how much they open constraints of a state that is
        held; collective.
        """
        s = self.system
        if not s.n_lam:
            return
        times = state.t + span * np.array([0.0, *self.PLACES])
        held = [np.tile(x, (len(times), 1)) for x in (state.q, state.v)]
        now, *later = s.batch(times, *held).constraint()
        opened = np.abs(s.row_units * (np.array(later) - now)).max(initial=0.0)
        self.way = max(self.way, float(opened) / s.length)

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
        sizes[: s.n_frames * s.motions.n_twist] *= max(min(self.way, 1.0), self.least)
        return sizes

    def of_lengths(self, x: Array) -> Array:
        """Lengths over what those of frames may be in error."""
        share = self.rtol * max(min(self.way, 1.0), self.least)
        return x / (share * self.system.length + (0.0 if self.atol is None else self.atol))

    @property
    def least(self) -> float:
        """``least`` of (1)."""
        return min(max(self.LEAST, self.FINEST / self.rtol), 1.0)


@dataclass
class Statistics:
    """Work of an error-controlled run. ``rejected`` counts by cause."""

    steps: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    newton_iterations: int = 0
    residuals: int = 0
    jacobians: int = 0
    factorisations: int = 0
    solves: int = 0

    def as_dict(self) -> dict[str, float]:
        """For the counters of a run."""
        out: dict[str, Any] = {k: x for k, x in vars(self).items() if k != "rejected"}
        out["rejections"] = sum(self.rejected.values())
        for cause, n in self.rejected.items():
            out[f"rejected: {cause}"] = n
        return out


@dataclass
class StepControl:
    """Proposes step sizes from error estimates that fall like h^order; keeps the history of a predictive controller."""

    order: float
    safety: float = 0.9
    shrink: float = 0.2
    grow: float = 8.0
    h_old: float = 0.0
    error_old: float = 0.0
    span: float = 0.0  # s, what a step was at most allowed to be
    rejections: list[tuple[float, float, str]] = field(
        default_factory=list
    )  # (t, h, cause) since the last accepted step
    fault: str = (
        ""  # since the last accepted step: what a law returned that could not be used, or a joint that stayed open
    )

    def accepted(self, h: float, error: float, effort: float = 1.0) -> float:
        """Step after an accepted one; ``effort`` in (0, 1] lowers the safety when Newton worked hard."""
        k = 1.0 / self.order
        error = max(error, 1e-10)
        factor = self.safety * effort * error**-k
        # Gustafsson's predictive control: errors that grow from step to step go on growing
        if self.h_old > 0:
            predictive = self.safety * (h / self.h_old) * (self.error_old / error**2) ** k
            factor = min(factor, predictive)
        self.h_old, self.error_old = h, max(error, LEAST_ERROR)
        # after a rejection the step does not grow at once
        after_rejection = bool(self.rejections)
        self.rejections.clear()
        factor = min(max(factor, self.shrink), 1.0 if after_rejection else self.grow)
        return h * factor

    def largest(self, h: float, error: float) -> float:
        """Step of which an error is expected that may be, where one of size h (s) has this error."""
        return self.safety * h * max(error, 1e-10) ** (-1.0 / self.order)

    def pressure(self, factor: float) -> float:
        """The larger of error and error^2 / error_old after which a step of the same size as the one before is followed by one of
        ``factor`` times its size; more than this shrinks it.
        """
        return (self.safety / factor) ** self.order

    @property
    def tiny(self) -> float:
        """A step that is too small to matter, s."""
        return 1e-15 * self.span

    def rejected(self, t: float, h: float, error: float, cause: str) -> float:
        """Step after a rejected one. Raises ConvergenceError when steps have become too small to matter."""
        self.rejections.append((t, h, cause))
        if cause == "error estimate" and np.isfinite(error):
            least, most = REFUSED
            factor = min(max(self.safety * error ** (-1.0 / self.order), least), most)
        else:
            factor = 0.5 if len(self.rejections) < 3 else 0.1
        new = h * factor
        if t + 0.01 * new == t or new < self.tiny or len(self.rejections) > PATIENCE:
            tail = "; ".join(f"h = {x:.1e} s: {why}" for _, x, why in self.rejections[-5:])
            raise ConvergenceError(
                f"The step at t = {t:.9g} s cannot be made smaller: {len(self.rejections)} rejections, the last ones: {tail}. "
                + (f"{self.fault} " if self.fault else "")
                + "Look for a jump in a load or a singular configuration at this time, or ask for a larger rtol."
            )
        return new


def first_step(norm: ErrorNorm, state: State, order: float, h_max: float) -> float:
    """An initial step from the sizes of velocity and acceleration (Hairer, Norsett, Wanner, Solving ODEs I, II.4, adapted).

    Collective where there are elastic fields. Beside frames the accelerations of deformations do not count: those of stiff
    vibrations fall to the error test.
    """
    sizes, deformations = norm.scale, norm.deformations
    if deformations.all():
        deformations = np.logical_not(deformations)

    def mean(x: Array) -> float:
        return norm.mean(np.where(deformations, 0.0, x / sizes))

    speed, push = mean(state.v), mean(state.a)
    share = norm.rtol ** (1.0 / order)
    h = h_max
    if speed > 0:
        h = min(h, 0.5 * share / speed)
    if push > 0:
        h = min(h, 0.5 * share / np.sqrt(push))
    return max(h, 1e-12 * h_max)


def turn_limit(system: System, state: State, *, steps: int = 1) -> float:
    """Largest step (s) in which, as it moves now, no frame in space turns by more than :data:`TURN` in that many steps.

    Local coordinates of rotations in space are singular a full turn away from their origin. In the plane there is no limit.
    """
    spin, push = (_rotations(system, x) for x in (state.v, state.a))
    if not len(spin):
        return np.inf
    w, e = (np.sqrt((x * x).sum(axis=1)) for x in (spin, push))
    # w h + e h^2 / 2 = TURN / steps
    turning = w + np.sqrt(w * w + 2.0 * e * TURN / steps)
    fastest = float(turning.max())
    return 2.0 * TURN / (steps * fastest) if fastest > 0 else np.inf


def turns_too_far(system: System, xi: Array) -> bool:
    """Whether increments, (..., n_v), come close to a full turn of a frame in space."""
    rotation = _rotations(system, xi)
    return bool((rotation * rotation).sum(axis=-1).max(initial=0.0) > (2.0 * TURN) ** 2)


def _rotations(system: System, x: Array) -> Array:
    """Components of all frames' rotations in space, (..., 3) of arrays like v; none in the plane."""
    m, n = system.motions, system.n_frames
    if m.dim == 2:
        return np.zeros((0, 3))
    return x[..., : n * m.n_twist].reshape(-1, m.n_twist)[:, m.dim :]


def moves(t: float, h: float, fault: str = "") -> None:
    """Refuse a step that does not change the time: accepted steps too can shrink without end. ``fault``: what is known of why."""
    if t + h == t:
        raise ConvergenceError(
            f"The step at t = {t:.9g} s has shrunk to h = {h:.1e} s: t + h == t. "
            + (f"{fault} " if fault else "")
            + "Take another form or scheme, or another rtol."
        )


def lands(h: float, left: float) -> float:
    """The step to take when ``left`` remains to a point that must be hit: no tiny last step, no overshoot."""
    if h >= left * (1 - 1e-10):
        return left
    return 0.5 * left if h > 0.5 * left else h
