"""What loads and drives do within a step that is not made yet: a step that would miss it is not tried.

With the state held, forces f between the ends of a step leave a straight line from end to end by more than the ends differ. What
is less, the error of the step sees:

    (M + s K) e + G^T mu = h^2 / 6 (f(t + k h) - (1 - k) f(t) - k f(t + h)),     G e = 0                                  (1)

Constraints that depend on time open by g(q, t + h) - g(q, t) with the state held. A step follows a parabola, and its error is
about half of what it misses of this:

    e  =  1/2 (g(q, t + h) - g(q, t) - h g_t - h^2 / 2 g_tt)                                                              (2)

of order h^3, as the errors of steps are. It needs no factor, which a step that is tried and refused has made in vain.

What the ends of a step differ by is seen by its error. Where that alone moves bodies by more than the length of the model, or
turns them by a radian, the step is not tried: Newton's iteration for a weight that comes within it fails after many tangents.

    (M + s K) d + G^T mu = h^2 / 2 (f(t + h) - f(t)),     G d = 0                                                        (3)

Stiff parts follow loads at once, and what is left the error of the step takes for a vibration: it does not see that a load began
late within the step. What no cubic through the f(t_k) follows, some sixth of what a kink leaves the line by, counts six times in
(1) too, beside the way of (3), which foretells that of the step.

Laws are as stiff here as in the state that is held, and what sticks may give way under a load within the step and stick again at
its end. With the f(t_k) farthest from f(t), and the one farthest from that, this moves

    M (x - h v) + s (K x + D x') = s (f(t_k) - f(t)),    r = N + K x + D x' - N(q o x, v + x'),    (M + s K') e = h^2 / 6 r    (4)

beside constraints as in (1), with the efforts N of laws and their slopes K, D here, and K' where they have led.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ....errors import CallbackError
from ....linear.blocks.field_blocks import Weights
from ....linear.condensation import StepSolver
from ....mechanics.forces.force_elements import ScalarLoads
from ....rotations import Array
from ....system.evaluation import Evaluation
from ....system.layout import State
from ....system.system import System
from ...error_norm import NormOfWays, worst
from ...prescribed_ways import opened

LOOKS = (0.118, 0.236, 0.382, 0.5, 0.618, 0.764, 0.882)  # where in a step loads and drives are looked at
# where else drives are, whose steps may have to be much smaller: a few in a decade
FINER = 2.45 ** -np.arange(2.0, 14.0)
SAFETY = 0.9
CUBICS = np.vander((0.0, *LOOKS, 1.0), 4)  # values at the ends of a step and between, by coefficients
UNFOLLOWED = (np.eye(len(CUBICS)) - CUBICS @ np.linalg.pinv(CUBICS))[:, 1:-1]  # by these, of what leaves a line between


@dataclass(frozen=True)
class LookAhead:
    """Of one system. ``weights``: those of a step of a size (s)."""

    system: System
    solver: StepSolver
    norm: NormOfWays
    weights: Callable[[float], Weights]

    def farthest(self, s: State, h: float) -> float:
        """Largest step (s) of at most h that follows what drives prescribe, by (2); h where nothing depends on time."""
        system = self.system
        if not system.prescribes:
            return h
        ways = h * np.sort(np.concatenate((FINER, LOOKS, (1.0,))))
        moved = self._driven(s, ways)
        if not moved.any():
            return h

        at_rest = system.at(s.t, s.q, np.zeros_like(s.v))
        rates = at_rest.opening(), at_rest.gamma()
        parabola = ways[:, None] * rates[0] + 0.5 * ways[:, None] ** 2 * rates[1]
        missed = 0.5 * np.abs(system.row_units * (moved - parabola)).max(axis=1)
        errors = self.norm.of_lengths(missed)

        # steps that follow all up to their end, or what errors of third order tell
        followed = np.append(np.flatnonzero(errors > 1.0), len(ways))[0]
        if followed == len(ways):
            return h
        foretold = float((ways * np.maximum(errors, 1.0) ** (-1.0 / 3.0)).min())
        return max(SAFETY * foretold, float(ways[followed - 1]) if followed else 0.0)

    def still(self, s: State, h: float, steps: int) -> int:
        """In how many of so many steps of size h (s), from the first on, nothing that drives prescribe depends on time."""
        shares = _shares(steps)
        moved = self._driven(s, h * shares).any(axis=1) if self.system.prescribes else np.zeros(len(shares), dtype=bool)
        return int(np.ceil(shares[moved.argmax()])) - 1 if moved.any() else steps

    def _driven(self, s: State, ways: Array) -> Array:
        """By how much constraints open in times (s) from now, the places held, (n, n_lam)."""
        return opened(self.system, replace(s, v=np.zeros_like(s.v)), s.t + ways)

    def loads(self, s: State, h: float, steps: int = 1) -> float:
        """The norm of (1) and (4) for the worst of so many steps of size h (s), or the way of (3) over the length of the model
        where that is above one.
        """
        if not self.system.pushes_in_time:
            return 0.0
        # all at once, with the state held
        shares = _shares(steps)
        q, v, a, lam = (np.tile(x, (len(shares), 1)) for x in (s.q, s.v, s.a, s.lam))
        forces = np.array(self.system.batch(s.t + h * shares, q, v).balance(a, lam))
        looked = forces[:-1].reshape(steps, 1 + len(LOOKS), -1)
        ends = np.concatenate((looked[:, 0], forces[-1:]))
        jumps = np.diff(ends, axis=0)

        way = self._at_most(s, h, 0.5 * h * h * self._farthest(jumps), self._way)
        if way > 1.0:
            return way

        # none of forces that stay as they are: not even roundoff, which would be solved for
        between = looked[:, 1:] - ends[:-1, None] - np.array(LOOKS)[:, None] * jumps[:, None]
        # what the ends of the step differ by is seen by the error of the step
        unseen = np.sign(between) * np.maximum(np.abs(between) - np.abs(jumps[:, None]), 0.0)
        largest = h * h / 6.0 * self._farthest(unseen.reshape(-1, forces.shape[1]))
        self.norm.update(s, h)
        missed = self._at_most(s, h, largest, lambda e: self._error(h, e))
        found = worst(missed, self._giving_way(s, h, forces[0] - forces))
        if found > 1.0:
            return found

        # of the step in which it is the largest
        rough = (UNFOLLOWED @ between).reshape(-1, forces.shape[1])
        most = self._largest(rough)
        return self._unfollowed(s, h, rough[most], jumps[most // len(CUBICS)])

    def _unfollowed(self, s: State, h: float, rough: Array, jump: Array) -> float:
        """The norm of (1) of what no cubic follows, in a step of size h (s) whose ends differ by a ``jump``; where that is above
        one the way of (3) is foretold.
        """
        if self.system.max_abs(rough) == 0.0:
            return 0.0
        before, error = self.norm.foretold, 0.0
        for weights in self._matrices(h):
            way = self._way(self._moved(s, 0.5 * h * h * jump, weights))
            self.norm.foretold = max(before, way)
            self.norm.update(s, h)
            error = self._error(h, self._moved(s, h * h * rough, weights))
            if error <= 1.0:
                self.norm.foretold = before
                break
        return error

    def _error(self, h: float, e: Array) -> float:
        return self.norm(h, e, np.zeros_like(e))

    @cached_property
    def laws(self) -> list[ScalarLoads]:
        """Elements whose stiffness may not last."""
        return [x for x in self.system.forces if isinstance(x, ScalarLoads) and x.follows_laws]

    def _giving_way(self, s: State, h: float, pushes: Array) -> float:
        """The norm of (4) in a step of size h (s) from forces as they are here, (k, n_v)."""
        if not self.laws:
            return 0.0
        far = self._farthest(pushes)
        back = far + self._farthest(pushes - far)
        try:
            return worst(self._lost(s, h, far), self._lost(s, h, back))
        except CallbackError:
            return np.inf  # a law of the user's own that ends there

    def _farthest(self, pushes: Array) -> Array:
        """The largest of forces (k, n_v)."""
        return np.asarray(pushes[self._largest(pushes)])

    def _largest(self, pushes: Array) -> int:
        """Which of forces (k, n_v) is the largest, moments over the length of the model; the same one on all ranks."""
        forces = pushes / self.system.units**2  # units, once more, make lengths of increments
        return int(self.system.each_max_abs(forces).argmax())

    def _lost(self, s: State, h: float, push: Array) -> float:
        """The norm of (4) for one force."""
        if self.system.max_abs(push) == 0.0:
            return 0.0
        system, weights = self.system, self.weights(h)
        here, flown = Evaluation(system, s.t, s.q, s.v), Evaluation(system, s.t, system.compose(s.q, h * s.v), s.v)
        before = here.wrenches()

        # where the force leads laws that go on as they are here
        with ExitStack() as straight:
            for loads in self.laws:
                straight.enter_context(loads.straight(here.kin, s.t))
            held = flown.spread(flown.wrenches() - before)
            x = self._moved(s, weights.ck * (push + held), weights)
            end = replace(s, q=system.compose(s.q, h * s.v + x), v=s.v + weights.cd / weights.ck * x)
            led = Evaluation(system, s.t, end.q, end.v)
            foretold = led.wrenches()

        # what they do not deliver there
        lost = led.spread(led.wrenches() - foretold)
        if system.max_abs(lost) == 0.0:
            return 0.0
        return self._error(h, self._moved(end, h * h / 6.0 * lost, weights))

    def _way(self, d: Array) -> float:
        """The largest way of (3) over the length of the model."""
        return self.system.max_abs(d) / self.system.length

    def _at_most(self, s: State, h: float, force: Array, size: Callable[[Array], float]) -> float:
        """The size of what a force moves in a step of h (s), or more where that is below one."""
        if self.system.max_abs(force) == 0.0:
            return 0.0  # whatever the matrix, which may have no factor so far
        found = 0.0
        for weights in self._matrices(h):
            found = size(self._moved(s, force, weights))
            if found <= 1.0:
                break
        return found

    def _matrices(self, h: float) -> tuple[Weights, ...]:
        """Weights of a softer matrix that is at hand, which tells more than the error and costs no factor, and of a step of h."""
        softer, own = self.solver.weights, self.weights(h)
        at_hand = (softer.cm, softer.ck < own.ck) == (own.cm, True)
        return (softer, own) if at_hand else (own,)

    def _moved(self, s: State, force: Array, weights: Weights) -> Array:
        """What a force moves, by the matrix of given weights."""
        ev = self.system.at(s.t, s.q, s.v)
        ev.forces = s.a, s.lam
        self.solver.prepare(ev, weights)
        return self.solver.solve(force, np.zeros(self.system.n_lam))[0]


def _shares(steps: int) -> Array:
    """Where in so many steps loads and drives are looked at, in steps; the ends of all are among these."""
    each = np.array([0.0, *LOOKS])
    return np.append((np.arange(float(steps))[:, None] + each).ravel(), steps)
