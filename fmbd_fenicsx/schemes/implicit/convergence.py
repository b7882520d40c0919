"""When Newton's iteration for the points of an implicit step has ended, and why; compiled code says the same (convergence.c).

With d_k the norm of increment k over the tolerance, the rate is theta = d_k / d_k-1, or its mean over the iteration, and what is
left of the error

    theta / (1 - theta) d_k                                                                                              (1)

or, after one increment only, a share that the step before tells. Increments that no longer fall are roundoff, harmless against
the tolerance, or divergence.

Source: Hairer and Wanner, Solving ODEs II, section IV.8, doi:10.1007/978-3-642-05221-7.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt

from ...system.compiled.states.convergence import CONVERGED, DIVERGED, GOES_ON, TOO_SLOW, Convergence

CAUSES = {DIVERGED: "Newton diverged", TOO_SLOW: "Newton too slow"}


@dataclass(frozen=True)
class Rates:
    """How a scheme takes the rates of its increments, see :class:`.Convergence`."""

    limit: float
    largest: float = inf
    before: float = 1.0
    averaged: bool = False
    least: float = 0.0
    foresees: bool = False


def share_left(o: Convergence, k: int) -> float:
    """What is left of the error, over the size of increment k: (1)."""
    return max(o.theta / (1.0 - min(o.theta, o.limit)), o.least) if k else float(o.first)


def is_roundoff(o: Convergence, ratio: float, size: float, *, still: bool) -> bool:
    """Whether increments that no longer fall, the newest of this ``size`` and ``ratio`` to the one before, are roundoff."""
    small = size <= max(o.stagnation, o.fallen * o.greatest)
    stagnates = o.done > 2 and ratio > 0.3 and (small or still)
    if not o.adaptive:
        return stagnates
    calm = ratio > 0.5 and size <= o.calm and o.size <= o.before * o.calm
    return calm or (stagnates and still)


def judge_increment(o: Convergence, size: float, *, still: bool) -> None:
    """Take notice of one more increment; ``still``: it moved nothing beyond roundoff."""
    k = o.done
    o.greatest = max(o.greatest, size)
    if not size < inf:
        o.done, o.size, o.outcome = k + 1, size, DIVERGED
        return
    if k:
        ratio = min(size / o.size, o.largest) if o.size > 0 else 0.0
        o.theta = sqrt(ratio * max(o.theta, 1e-10)) if k > 1 and o.averaged else ratio
        if is_roundoff(o, ratio, size, still=still):
            size = 0.0
        elif o.theta >= o.limit and size > o.tolerance and (o.adaptive or k > 3):
            o.outcome = DIVERGED

    o.done, o.size, o.share = k + 1, size, share_left(o, k)
    if o.outcome == GOES_ON:
        o.outcome = _outcome(o, k)


def _outcome(o: Convergence, k: int) -> int:
    """Whether the iteration has ended with increment k: with success, or because those to come would not be enough."""
    left = o.share * o.size
    if left <= o.tolerance or o.size <= 1e-2 * o.tolerance:
        return CONVERGED
    hopeless = o.foresees and k > 1 and left * o.theta ** (o.most - o.done) > o.tolerance
    return TOO_SLOW if hopeless or o.done == o.most else GOES_ON
