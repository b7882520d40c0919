"""Newton's iteration with a frozen tangent and a guard on its rate of convergence.

The error left after an increment d_k is estimated from the rate theta = |d_k| / |d_k-1| as theta / (1 -
theta) |d_k| (Hairer and Wanner, Solving ODEs II, section IV.8, doi:10.1007/978-3-642-05221-7). The rate of
the last step serves when a step has one increment only.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np

from ..checks import check_fields
from ..errors import ConvergenceError, require
from ..rotations import Array
from ..system.compiled.declarations import constants, enumeration
from ..system.evaluation import Evaluation
from ..system.lengths import SHUT, farthest
from ..system.system import System
from .tangent_account import TangentAccount

FAR = 1e3  # of the tolerance: a first increment above it is worth a tangent of its own in bodies that change theirs every step
# share of places that increments may be roundoff of
(LEFT_OF_PLACES,) = constants("parts.h", "LEFT_OF_PLACES")
TELLING = enumeration("TELLING", "onestep/alpha.c")["TELLING"]
IN_RESERVE = enumeration("IN_RESERVE", "onestep/alpha.c")["IN_RESERVE"]
FINEST = 1e-13  # increments are known to about this share
# of SHUT: increments that leave joints closed, as rates of convergence foretell errors to a factor of ten
CLOSING = 0.1


@dataclass(frozen=True)
class ExactTangent:
    """The exact tangent of a step in place of the frozen one: ``Newton(tangent=ExactTangent())``, :class:`GeneralizedAlpha` only.

    GMRES to the relative residual ``rtol``, at most ``max_iterations``, each one back-solve; see :mod:`.exact_tangent`.
    """

    rtol: float = 1e-6
    max_iterations: int = 30

    def __post_init__(self) -> None:
        check_fields(self)
        require(
            1e-7 <= self.rtol < 1.0,
            f"ExactTangent: rtol = {self.rtol} is not usable; difference quotients allow 1e-7 <= rtol < 1.",
        )
        require(self.max_iterations >= 1, f"ExactTangent needs max_iterations >= 1, found {self.max_iterations}.")


@dataclass
class Newton:
    """Newton's iteration in a step: its settings, and counters of a run.

    Args:
        tolerance: relative, of accelerations and reactions as each scheme weighs them; the residuals of constraints are judged
            besides.
        max_iterations: increments after which a step has failed and is made in halves.
        slow: a rate of convergence above this over two increments counts as divergence.
        patience: a new tangent is taken when more than this many further increments are to be expected.
        tangent: None for a tangent kept over steps, or :class:`ExactTangent`.

    The rest is kept by a run: ``iterations`` all increments, ``renewals`` tangents of the last step, ``account`` of their cost.
    """

    tolerance: float = 1e-6
    max_iterations: int = 12
    slow: float = 0.9
    patience: float = 4.0
    tangent: ExactTangent | None = None
    renewals: int = field(default=0, init=False)
    account: TangentAccount = field(default_factory=TangentAccount, init=False)
    iterations: int = field(default=0, init=False)
    theta: float = field(default=0.5, init=False)
    left: float = field(default=0.0, init=False)  # errors that solved steps left, over the tolerance, summed
    solved: int = field(default=0, init=False)  # steps whose errors are known

    def __post_init__(self) -> None:
        check_fields(self, "Newton")
        require(
            FINEST <= self.tolerance < 1.0,
            f"Newton's tolerance {self.tolerance} is not usable; double precision allows {FINEST:.0e} <= tolerance < 1.",
        )
        require(0 < self.slow < 1, f"Newton: slow = {self.slow} is a rate, between 0 and 1.")
        require(self.patience >= 0, f"Newton: patience = {self.patience} must be a number of iterations, 0 or more.")
        require(self.max_iterations >= 1, f"Newton needs max_iterations of 1 at least, found {self.max_iterations}.")

    def solve(
        self,
        increment: Callable[[], float],
        renew: Callable[[], bool] = lambda: False,
        *,
        ahead: bool = False,
        begun: bool = False,
        cost: float = 0.0,
        misfit: Callable[[], float] = lambda: 0.0,
        foretold: Callable[[float], float] = lambda size: math.inf,
    ) -> tuple[bool, list[float]]:
        """Call ``increment`` (it applies one increment, returns its norm over the tolerance) until the error
        is below 1. ``renew`` takes a new tangent and tells whether there was one to take: where the last increment began, or
        ``ahead``, where it led; ``begun``: the step began with one. ``cost``: of one, over that of as many increments as there is
        patience for: where the step ends without, it waits until increments have paid for it (:mod:`.tangent_account`).
        ``misfit``: share of the last increment that its tangent may have got wrong.
        ``foretold``: the error that a first increment of this size leaves, where earlier steps tell.

        Returns whether it converged, and the history of norms.
        """
        history: list[float] = []
        at_once = ahead and self.renewals > 1 + begun
        refreshed = int(begun)
        for _ in range(self.max_iterations):
            size = increment()
            self.iterations += 1
            history.append(size)
            if not size < float("inf"):
                return False, history

            if len(history) > 1:
                left, further = self._by_rate(size, history[-2])
                # too slow to end within the patience: a new tangent
                if refreshed < 10 and further > self.patience and (begun or self._pays(len(history) + further, cost)):
                    refreshed += 1
                    if renew():
                        self.theta = 0.1
                        continue
                # one bad increment is no divergence
                stalled = len(history) > 3 and min(history[-2:]) > self.slow * history[-3]
                if size > 1.0 and stalled:
                    return False, history
            else:
                # the first: the rate of the step before, no better than 0.02
                rate = max(self.theta, 0.02)
                left = min(rate / (1 - min(rate, 0.9)) * size, foretold(size))
                if size <= FAR:
                    refreshed = 0  # it was not worth a tangent
                elif at_once and renew():
                    refreshed, self.theta = refreshed + 1, 0.1
                    continue

            # rates of several increments tell the error, whatever may have misled them
            if (left <= 1.0 or size <= 1e-3) and (len(history) >= TELLING or misfit() * size <= 1.0):
                self.note(left)
                self.renewals = refreshed
                self.account.settle(len(history), refreshed)
                return True, history
        return False, history

    def _by_rate(self, size: float, before: float) -> tuple[float, float]:
        """The error that is left after two increments, by the rate of convergence, and how many more would take it below 1."""
        theta = size / before if before > 0 else 0.0
        self.theta = max(min(theta, 0.999), 1e-4)
        left = self.theta / (1 - self.theta) * size
        return left, -math.log(left) / math.log(self.theta) if left > 1.0 else 0.0

    def _pays(self, made: float, cost: float) -> bool:
        """Whether a tangent of this cost is worth it where a step would end after so many increments without."""
        return made > self.max_iterations - IN_RESERVE or self.account.wasted_by(made) >= cost * self.patience

    def afresh(self) -> Newton:
        """The same settings, nothing counted yet."""
        return replace(self)

    @property
    def settings(self) -> dict[str, Any]:
        """What the user has chosen."""
        return {x.name: getattr(self, x.name) for x in fields(self) if x.init}

    def note(self, left: float, steps: int = 1) -> None:
        """Solved steps and the sum of their errors, over the tolerance."""
        self.left += left
        self.solved += steps

    def small(self, system: System, accelerated: float, far: float = 0.0) -> float:
        """Size (m) of an increment of places that counts as none in a step that accelerations move by ``accelerated`` (m).

        It changes accelerations by the relative tolerance, is above the roundoff of places ``far`` (m) from the origin, and
        leaves no joint open: that of stiff parts that vibrate within a step would.
        """
        length = system.length
        floor = max(64 * np.finfo(float).eps * length, LEFT_OF_PLACES * far)
        return max(min(self.tolerance * accelerated, CLOSING * SHUT * length), floor)

    @property
    def share(self) -> float:
        """What the iterations leave in the mean, over the tolerance: all of it, or less where that is known."""
        return min(1.0, self.left / self.solved if self.solved else 1.0)


def above_roundoff(ev: Evaluation, lam: Array, r: Array, g: Array) -> Array:
    """Which components of the balance ``r`` are larger than the roundoff of their own terms, like v: 1, else 0.

    A body of little inertia that heavy ones hold by large forces has a balance known to eps times these forces only. What
    is left of it moves the body's free coordinates by more than a tolerance that is relative to accelerations, for ever.
    Forces are compared frame by frame, since the lever of a force may cancel in one direction. All count while
    constraints ``g`` are open. Replicated coordinates.
    """
    system = ev.system
    few = 32 * np.finfo(float).eps
    if system.fields or np.abs(g).max(initial=0.0) > few * system.length:
        return np.ones(len(r))

    G = ev.jacobian.core
    reactions = abs(G).T @ np.abs(lam)
    terms = reactions + np.abs(r - G.T @ lam)

    # one size for the forces on a frame, one for the moments
    n = system.motions.n_twist
    frames = terms[: system.n_frames * n].reshape(-1, n)
    for components in (slice(None, system.motions.dim), slice(system.motions.dim, None)):
        frames[:, components] = frames[:, components].max(axis=1, keepdims=True)
    return np.where(np.abs(r) > few * terms, 1.0, 0.0)


def known_gaps(ev: Evaluation, g: Array) -> Array:
    """Gaps ``g`` that are larger than the roundoff of the places that they are differences of; 0 for the others.

    Close to a singular position a motion u has hardly any part in the rows, |G u| = sigma |u|: a gap of roundoff stands for an
    increment of roundoff over sigma, which no iteration makes smaller. Bodies keep the places that they are predicted in then.
    """
    system = ev.system
    known = system.row_units * np.abs(g) > LEFT_OF_PLACES * (system.length + farthest(system, ev.q))
    return np.where(known | ~system.in_lengths, g, 0.0)


def strayed(system: System, xi: Array, predicted: Array) -> bool:
    """Whether an iteration ended far from the increments of a step as predicted: on another solution. Collective."""
    near = max(2.0 * system.max_abs(predicted), 0.01 * system.length)
    return system.max_abs(xi - predicted) > near


def grew(history: list[float]) -> bool:
    """Whether increments that were far from the tolerance grew from one to the next: the iteration may have left its way, by the
    natural monotonicity test (Deuflhard, Newton Methods for Nonlinear Problems, doi:10.1007/978-3-642-23899-4).
    """
    return any(FAR < size and last < size for last, size in pairwise(history))


OTHER_SOLUTION = "Newton found another solution, far from the predicted one"
ADVICE = ". Try a smaller dt."


def not_converged(t: float, h: float, history: list[float], more: str) -> ConvergenceError:
    """The error of a step to ``t`` of size ``h`` (s) whose increments, over the tolerance, were ``history``; ``more`` ends it."""
    sizes = " -> ".join(f"{x:.1e}" for x in history)
    return ConvergenceError(f"Newton stopped at t = {t:.6g} s (h = {h:.3g} s): increments over tolerance {sizes}{more}")


def crushed(t: float, h: float, body: str) -> ConvergenceError:
    """The error of a step to ``t`` of size ``h`` (s) that ended where no force has taken a ``body``."""
    return ConvergenceError(
        f'Newton stopped at t = {t:.6g} s (h = {h:.3g} s): {OTHER_SOLUTION}: body "{body}" would store more energy than there is'
        + ADVICE
    )
