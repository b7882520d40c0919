"""Starts whose accelerations a step does not resolve: what of them is left, and steps that damp the rest where damping ends it.

The recursion of generalized-alpha carries A_0 on for many steps. Where a_0 is that of a motion which damping ends within a step
(a speed that begins at the pin of a strongly damped body, a load that sets in on a damped panel), h^2 a_0 is a displacement that
is never there. The matrix S = M + cd C + ck K of a step tells what is left of a_0 at its end,

    S a + G^T mu = M a_0 - r,    G a = G a_0,                                                                         (1)

with r what forces change where v_0 leads in the step: of what begins at rest, a = a_0 / (1 + cd c + ck w^2) in each mode, while
a_0 stays where forces change as it goes on, as in the slow motion of a strong damper or of a stiff spring that turns. A start is
unresolved where |a| < 0.3 |a_0| in the norm of the largest entry, both with r and without, and damping alone leaves as little,

    a_0^T M a_0 < 0.3 (a_0^T M a_0 + cd a_0^T C a_0),                                                                 (2)

that is from c h = 4.6 on, rho_inf = 0.8. Units and sizes of loads have no part in this, and where h resolves
the motion |a_0 - a| is O(h). What moves places, ck |a|, by less than Newton's iteration may leave open counts as none: forces at
roundoff shake stiff bodies at rest. A start is damped for four steps, each of which leaves a fifth at most of what is far faster
than the step, and until half of an acceleration is left.

A vibration that h does not resolve goes on in the body: the scheme alone damps it, and runs with other steps have to tell it as
an error. But h^2 a_0 is never there either: velocities would be off by (1 - gamma / 2 beta) h a_0 and accelerations would change
their sign from step to step, in the stress of a stiffened body too. Where (1) leaves less than 0.3^2 of a_0, a step begins with

    a_1 + a_2,    S a_1 + G^T mu_1 = M a_0,    S a_2 + G^T mu_2 = M (a_0 - a_1),    G (a_1 + a_2) = G a_0                (5)

in its place, that is with a_0 (1 - (ck w^2 / (1 + ck w^2))^2) in each mode: all of it but O(h^4 w^4) where h resolves w.
It is not so, and no solution is asked for, where

    a_0^T M a_0 > 0.3^2 (a_0^T M a_0 + ck a_0^T K a_0),                                                               (6)

as a_0^T M a is the mean of 1 / (1 + ck w^2), at least 1 over the mean of 1 + ck w^2, times a_0^T M a_0. Nor is it so where the
forces that pull back let go half-way: a stop does not vibrate, it throws.

Until a start is resolved its steps are those of the diagonally implicit method of two stages, g = 1 - 1/sqrt(2),

    V_1 = v_0 + g h A_1,                          Q_1 = q_0 o exp(g h V_1)                                            (3)
    v_1 = v_0 + h ((1 - g) A_1 + g A_2),          q_1 = q_0 o exp(h v_0 + h^2 ((1/2 - g^2) A_1 + g^2 A_2))              (4)

in the stabilised form. It is of second order, L-stable and stiffly accurate: what is faster than the step is gone at its end, in
velocities and places, and a_0 takes no part. Both stages are steps of generalized-alpha's own kind with alpha_m = alpha_f = 0:
(3) with A_0 = 0, beta = gamma = 1 and the size g h, (4) with A_0 = A_1, gamma = g, beta = g^2. A stage's acceleration misses the
constraints on accelerations by O(h); the end gets one more increment with its matrix, by which it and lambda are of second order.

Source: Alexander, doi:10.1137/0714068.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from ....linear.blocks.field_blocks import Weights
from ....linear.condensation import StepSolver
from ....rotations import Array
from ....system.evaluation import Evaluation
from ....system.layout import State
from .alpha_step import Rule

LEFT = 0.3  # of an acceleration that a step has to leave
LEFT_BEHIND = 0.5  # the same behind steps that damp
LEAST, MOST = 4, 10  # steps that damp a start
G = 1.0 - sqrt(0.5)
SMALL = 1e-3  # of a step, or of a way: how far velocities and places move to tell what they meet
KEPT = 0.75  # of a stiffness, over the whole swing of a vibration: a stop that lets go half-way keeps half of it


@dataclass(frozen=True)
class LastStage(Rule):
    """The rule of (4), with the ``matrix`` of (3): they are the same but for roundoff, and one factor serves."""

    matrix: Weights

    @property
    def weights(self) -> Weights:
        """Those of the matrix."""
        return self.matrix


def stages(h: float) -> tuple[Rule, Rule]:
    """The rules of (3) and (4) for a step of size h (s)."""
    first = Rule(G * h, 0.0, 0.0, 1.0, 1.0)
    return first, LastStage(h, 0.0, 0.0, G, G * G, first.weights)


@dataclass(frozen=True, eq=False)
class Unresolved:
    """Accelerations, like v, to begin a step with that does not resolve those of its start; ``damps``: a step that damps."""

    a: Array
    damps: bool


def unresolved(
    ev: Evaluation, start: State, solver: StepSolver, rule: Rule, nothing: float, left: float
) -> Unresolved | None:
    """The a of (1) for a start evaluated as ``ev``, where it is less than the share ``left`` of a_0 and damping is what ends it;
    that of (5) where it is less than ``left`` squared; else None.

    ``nothing``: displacement (m) that counts as none. Collective.
    """
    system, w, h = solver.system, rule.weights, rule.h
    held = ev.balance(start.a, start.lam)
    push = held - ev.balance(np.zeros_like(start.a), start.lam)

    # (2), which costs no solution
    dt = SMALL * h
    drag = (system.at(start.t, start.q, start.v + dt * start.a).balance(start.a, start.lam) - held) / dt
    inertia = w.cm * system.dot(start.a, push)
    damps = w.cd * system.dot(start.a, drag) > (1.0 / left - 1.0) * inertia

    # (6), neither
    if not damps:
        way = dt * h
        held_back = (
            system.at(start.t, system.compose(start.q, way * start.a), start.v).balance(start.a, start.lam) - held
        ) / way
        if w.ck * system.dot(start.a, held_back) <= (1.0 / left**2 - 1.0) * inertia:
            return None

    size, across = system.max_abs(start.a), ev.jacobian.times(start.a)
    there = system.at(start.t + h, system.compose(start.q, h * start.v), start.v)
    change = there.balance(start.a, start.lam) - held
    solver.prepare(ev, w)
    found = []
    for pushed in (push, push - change):
        a, _ = solver.solve(pushed, across)
        rest = system.max_abs(a)
        if not rest < left * size or w.ck * rest <= nothing:
            return None
        found.append(a)
    if damps:
        return Unresolved(found[1], True)
    if not system.max_abs(found[0]) < left * left * size or _lets_go(ev, start, w.ck * found[0]):
        return None

    gone = start.a - found[0]
    a, _ = solver.solve(
        ev.balance(gone, start.lam) - ev.balance(np.zeros_like(gone), start.lam), ev.jacobian.times(gone)
    )
    return Unresolved(found[0] + a, False)


def _lets_go(ev: Evaluation, start: State, way: Array) -> bool:
    """Whether what pulls back on the ``way`` (m) to where nothing accelerates lets go behind it, as a stop does: that throws."""
    system, held = ev.system, ev.balance(start.a, start.lam)

    def stiffness(share: float) -> float:
        there = system.at(start.t, system.compose(start.q, share * way), start.v)
        return system.dot(way, there.balance(start.a, start.lam) - held) / share

    return stiffness(2.0) < KEPT * stiffness(SMALL)


def on_constraints(end: State, solver: StepSolver, rule: Rule) -> State:
    """The end of (4) with accelerations on their constraints, moved with the matrix of its step; collective."""
    ev = solver.system.at(end.t, end.q, end.v)
    solver.prepare(ev, rule.weights)
    da, dlam = solver.solve(np.zeros_like(end.a), -(ev.jacobian.times(end.a) + ev.gamma()))
    return replace(end, a=end.a + da, lam=end.lam + dlam)
