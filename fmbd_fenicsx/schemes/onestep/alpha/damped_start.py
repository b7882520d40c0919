"""Starts whose accelerations die out within a step: what of them a step resolves, and steps that damp the rest at once.

The recursion of generalized-alpha carries A_0 on for many steps. Where a_0 is that of a motion which damping ends within a step
(a speed that begins at the pin of a strongly damped body, a load that sets in on a damped panel), h^2 a_0 is a displacement that
is never there. The matrix S = M + cd C + ck K of a step tells what is left of a_0 at its end,

    S a + G^T mu = M a_0 - r,    G a = G a_0,                                                                         (1)

with r what forces change where v_0 leads in the step: of what begins at rest, a = a_0 / (1 + cd c + ck w^2) in each mode, while
a_0 stays where forces change as it goes on, as in the slow motion of a strong damper or of a stiff spring that turns. A start is
unresolved where |a| < 0.3 |a_0| in the norm of the largest entry, both with r and without, and damping alone leaves as little,

    a_0^T M a_0 < 0.3 (a_0^T M a_0 + cd a_0^T C a_0),                                                                 (2)

that is from c h = 4.6 on, rho_inf = 0.8. A vibration that h does not resolve stays what the scheme makes of it: it goes on in the
body, and runs with other steps have to tell it as an error. Units and sizes of loads have no part in this, and where h resolves
the motion |a_0 - a| is O(h). What moves places, ck |a_0|, by less than Newton's iteration may leave open counts as none: forces
at roundoff shake stiff bodies at rest. What is left of it may be less: where a damper alone holds a body, all of h^2 a_0 stays.
A start is damped for four steps, each of which leaves a fifth at most of what is far faster than the step, and until half of an
acceleration is left.

Until a start is resolved its steps are those of the diagonally implicit method of two stages, g = 1 - 1/sqrt(2),

    V_1 = v_0 + g h A_1,                          Q_1 = q_0 o exp(g h V_1)                                            (3)
    v_1 = v_0 + h ((1 - g) A_1 + g A_2),          q_1 = q_0 o exp(h v_0 + h^2 ((1/2 - g^2) A_1 + g^2 A_2))              (4)

in the stabilised form. It is of second order, L-stable and stiffly accurate: what is faster than the step is gone at its end, in
velocities and places, and a_0 takes no part. Both stages are steps of generalized-alpha's own kind with alpha_m = alpha_f = 0:
(3) with A_0 = 0, beta = gamma = 1 and the size g h, (4) with A_0 = A_1, gamma = g, beta = g^2. A stage's acceleration misses the
constraints on accelerations by O(h); the end gets one more increment with its matrix, by which it and lambda are of second order.

The stress that stiffens a body follows its accelerations, those of nodes under a sudden force, too, which a step far longer than
waves take from node to node does not resolve. Steps of such bodies begin with

    a = a_0 - T^2 e,    T e = e - x,    S x + G^T mu = M e,    G x = G e,                                             (5)

e: a_0 of their nodes, 0 elsewhere, where x^T M e < 0.3 e^T M e. That is a_0 (1 - (ck w^2 / (1 + ck w^2))^2) in each mode, all of
it but O(h^4 w^4) where h resolves w; joints and the momentum see no change.

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
SMALL = 1e-3  # of a step: how far velocities move to tell what damping they meet


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


def damped_acceleration(
    ev: Evaluation, start: State, solver: StepSolver, rule: Rule, nothing: float, left: float
) -> Array | None:
    """The a of (1), like v, for a start evaluated as ``ev``, where it is less than the share ``left`` of a_0; else None.

    ``nothing``: displacement (m) that counts as none. Collective.
    """
    system, w, h = solver.system, rule.weights, rule.h
    size = system.max_abs(start.a)
    if w.ck * size <= nothing:
        return None
    held = ev.balance(start.a, start.lam)
    push = held - ev.balance(np.zeros_like(start.a), start.lam)

    # (2), which costs no solution
    dt = SMALL * h
    drag = (system.at(start.t, start.q, start.v + dt * start.a).balance(start.a, start.lam) - held) / dt
    if w.cd * system.dot(start.a, drag) <= (1.0 / left - 1.0) * w.cm * system.dot(start.a, push):
        return None

    across = ev.jacobian.times(start.a)
    there = system.at(start.t + h, system.compose(start.q, h * start.v), start.v)
    change = there.balance(start.a, start.lam) - held
    solver.prepare(ev, w)
    for pushed in (push, push - change):
        a, _ = solver.solve(pushed, across)
        rest = system.max_abs(a)
        if not rest < left * size:
            return None
    return a


def eased(ev: Evaluation, start: State, solver: StepSolver, rule: Rule) -> State:
    """A start, evaluated as ``ev``, with the a of (5); itself where steps resolve those of bodies that stiffen. Collective."""
    system = solver.system
    nodes = [system.slices[1][k] for k, part in system.fields if part.stiffens]
    if not nodes:
        return start
    solver.prepare(ev, rule.weights)
    rest, e = ev.balance(np.zeros_like(start.a), start.lam), np.zeros_like(start.a)
    for own in nodes:
        e[own] = start.a[own]

    def resolved(a: Array) -> tuple[Array, Array]:
        push = ev.balance(a, start.lam) - rest
        return solver.solve(push, ev.jacobian.times(a))[0], push

    x, push = resolved(e)
    if system.dot(x, push) >= LEFT * system.dot(e, push):
        return start
    return replace(start, a=start.a - (e - x - resolved(e - x)[0]))


def on_constraints(end: State, solver: StepSolver, rule: Rule) -> State:
    """The end of (4) with accelerations on their constraints, moved with the matrix of its step; collective."""
    ev = solver.system.at(end.t, end.q, end.v)
    solver.prepare(ev, rule.weights)
    da, dlam = solver.solve(np.zeros_like(end.a), -(ev.jacobian.times(end.a) + ev.gamma()))
    return replace(end, a=end.a + da, lam=end.lam + dlam)
