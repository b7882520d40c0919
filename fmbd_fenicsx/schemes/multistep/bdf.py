"""Backward differentiation: variable steps and orders one to five, or constant ones; any form of the constraints.

With past values y_j = (xi_j, v_j) expressed in the local coordinates of the current step, xi_j = log(q_n^-1 o q_j), the
derivative at t_n+1 is that of the polynomial through the new and the last k values (variable coefficients):

    y'_n+1 = sum_j c_j y_n+1-j,        the equations of motion hold at (t_n+1, y_n+1, y'_n+1)                     (1)

One Newton iteration solves with the frequency s = c_0; tangent and factor are kept while it converges fast, and corrected by
2 / (1 + s / s_old) while s stays near. The error of a step of order k is h / (t_n+1 - t_n-k) (y_n+1 - y_predicted), the predictor
running through k + 1 past values; the same formula serves the neighbouring orders. Multipliers stay out of the error test:
they are no part of the memory of the formula.

Index 3 keeps order k in all components with constant steps only; with error control GGL, or a form of lower index, is the choice.

Sources: Brenan, Campbell and Petzold, doi:10.1137/1.9781611971224 (variable coefficients, error test); Hairer and Wanner, Solving
ODEs II, sections III.5 and VII.3, doi:10.1007/978-3-642-05221-7; Gear, Gupta and Leimkuhler, doi:10.1016/0377-0427(85)90008-1.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from ...checks import check_fields
from ...errors import require
from ...linear.condensation import StepSolver
from ...linear.residual import Judge
from ...rotations import Array
from ...system.control.memory_points import StepError
from ...system.element_memory import memory_error
from ...system.layout import State
from ...system.scene.contents import Contents
from ...system.serialisation import Memory, plain, worker
from ...system.system import System
from ...system.tangents.step_tangent import StepTangent
from ..control import StepControl, moves, turn_limit, turns_too_far
from ..dae import GGL, Form, OfForm, Points
from ..error_norm import check_tolerance
from ..implicit.implicit_stepper import ImplicitStepper
from ..newton import Newton
from ..onestep.radau import Radau
from .amplification import STABLE, Amplification
from .corrector import Corrector
from .multistep_march import CALM, HIGHER, LOWER, SLOW, growth_of, within
from .past import LONGEST, Past, before, local, slopes, weights

SUDDEN = 0.05  # share of the last step below which a step is behind a bend of forces, as in bdf.c


@dataclass(frozen=True)
class BDF(OfForm):
    """Scheme data.

    Args:
        order: the largest order used (1 to 5); with constant steps the order. With elastic fields 2 at most: the higher ones
            amplify vibrations that the step does not resolve.
        form: of the constraints, :class:`~fmbd_fenicsx.GGL` by default.
        rtol: relative tolerance of the local error; None for constant steps dt and constant order, started by Radau IIA.
        atol: absolute tolerance of coordinates (m, rad or own units); None: from the sizes in the model.
    """

    order: int = 5
    form: Form = field(default_factory=GGL)
    rtol: float | None = 1e-6
    atol: float | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        require(
            self.order in (1, 2, 3, 4, 5),
            f"BDF: order = {self.order} must be 1 to 5; six and more are not stable enough.",
        )
        check_tolerance(self.rtol, self.atol, "BDF")

    @property
    def name(self) -> str:
        """Name in reports."""
        return f"BDF({self.order}), {self.form.name}"

    def refusal(self, held: Contents) -> str:
        """Why it does not take what a scene holds."""
        if self.rtol is None and self.order > STABLE and held.nodal:
            name, most = held.nodal[0].name, f"take order={STABLE}, or Radau"
            return f'Body "{name}": BDF of order {self.order} amplifies elastic vibrations: {most}.'
        return super().refusal(held)

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> BDFStepper:
        """The time stepper of a run, from a consistent state."""
        return BDFStepper(self, system, solver, newton, state)


def _keep_past(m: Memory, name: str, past: list[Past]) -> list[Past]:
    """Past values, in an order that does not depend on the ranks."""
    items = [] if m.reading else [(p.t, p.q, p.v, p.mult) for p in past]
    return [
        Past(i("t", t), i.like_q("q", q), i.like_v("v", v), i("mult", mult))
        for i, (t, q, v, mult) in m.each(name, items, 4)
    ]


class BDFStepper(Corrector):
    """Advances a consistent state; holds the past values, tangent, factor and the choice of step and order."""

    what = "a BDF step"
    lost = 1e-5
    keeps: ClassVar = {
        **ImplicitStepper.keeps,
        "past": _keep_past,
        **dict.fromkeys(("k", "held"), plain()),
        "amplification": worker,
        "_starter": worker,
    }

    def __init__(self, scheme: BDF, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        super().__init__(scheme, system, solver, newton, state)
        self.control = StepControl(2.0)
        if self.adaptive:
            self.slow = SLOW
        self.amplification = Amplification(solver)
        if not self.adaptive:  # with variable ones frequencies hardly come back
            self.eq.keep_sizes(equal=True)

        self.highest = min(scheme.order, STABLE) if system.fields else scheme.order
        self._starter: Any = None
        if not self.adaptive and scheme.order > 1:  # a Radau method makes the first steps
            self._starter = Radau(stages=3, form=scheme.form, rtol=None).stepper(system, solver, newton, state)
        self._begin_from(state)

    def _begin_from(self, state: State) -> None:
        super()._begin_from(state)
        self.past = [Past(state.t, state.q, state.v, self.eq.multipliers(state))]
        # the order, and for how many steps it was held with one size
        self.k, self.held = (1, 0) if self.adaptive else (self.scheme.order, 0)
        self.amplification.forget()
        if self._starter is not None:
            self._starter.begin_anew(lambda: state)

    def remember(self, m: Memory) -> None:
        """With the tangent, whose factor is made again; of elastic fields every step takes its own."""
        kept = self._pencil if self.eq.dense else None
        self._tangent, self.judge = m("tangent", (self._tangent, self.judge), StepTangent, Judge)
        factored = m("factored", None if kept is None else (kept.t, kept.s), StepTangent)
        if m.reading:
            self._pencil = None if factored is None else self.eq.pencil(factored[0], factored[1], self.judge)
        super().remember(m)

    def between(self, t: float) -> State | None:
        """The state at a time t (s) within the last step, on the polynomials through the newest k + 1 past values."""
        count = min(self.k + 1, len(self.past))
        if count < 2 or not self.past[count - 1].t <= t <= self.state.t:
            return None
        times, xis, vs = local(self.system, self.state.q, self.past[:count])
        w = weights(times, t)
        m, s = self.system.n_lam, self.state
        mult = w @ np.array([p.mult for p in self.past[:count]])
        within = State(t, self.system.compose(s.q, w @ xis), w @ vs, slopes(times, np.array(t)) @ vs, mult[:m])
        return self._held(s.t - self.past[1].t, within)

    def note(self) -> bool:
        """As :meth:`TimeStepper.note`, also of the first steps, which another scheme makes."""
        starter = self._starter
        return bool(starter.note()) if starter is not None and starter.state is self.state else super().note()

    # -- steps --------------------------------------------------------------------------------------------------
    def _controlled(self, limit: float) -> State:
        """A step of at most ``limit`` (s) that passes the error test."""
        s = self.state
        self.amplification.look(self._next_order, s)
        farthest = turn_limit(self.system, s, steps=self.k + 1)
        self.control.span = max(self.control.span, limit)
        if self.proposed is None:
            self.proposed = 0.1 * self._first_size(2.0, limit)
            newest = self.past[0]
            self.past = [newest, before(self.system, s, min(self.proposed, limit), newest.mult)]

        while True:
            h = self._landing(min(self.proposed, farthest), limit)
            moves(s.t, h, self.control.fault)
            self.solver.near_singular.begin_trial()
            self.norm.update(s, h)

            found = self._newton(h, self.k)
            if not isinstance(found, str) and turns_too_far(self.system, found.xi):
                found = "turns too far"

            if isinstance(found, str):
                cause, error = found, np.inf
                stale = self._tangent is not None and not self._fresh
                self._tangent = None
                if stale or self.eq.renew():
                    continue  # once more with a new tangent
                if cause.startswith("Newton") and self.eq.dense and not self._full:
                    self._full = True
                    continue  # and with one for each iteration, before the step is made smaller
            else:
                error, cause = self._error(h, found, self.k), "error estimate"
                if error <= 1.0:
                    break
            self._reject(h, error, cause)

        self.solver.near_singular.accept_trial()
        self.local_error = error
        new = self._choose(h, found, error)
        self.control.rejections.clear()
        self.proposed = new if h >= min(self.proposed, limit) * (1 - 1e-9) or new < h else self.proposed
        return self._accept(h, found)

    def _reject(self, h: float, error: float, cause: str) -> None:
        """A smaller step next; after several rejections a lower order, whose past is shorter."""
        self._full = False
        self.stats.rejected[cause] += 1
        self.control.order = self.k + 1.0
        self.proposed = self.control.rejected(self.state.t, h, error, cause)
        self.held = 0

        rejections = len(self.control.rejections)
        if rejections > 5:
            self.k = 1
        elif rejections > 2:
            self.k = max(1, self.k - 1)

    def _constant(self, h: float) -> State:
        """A step of size h; the first ones by a Radau method, until the past is long enough."""
        if self._starting:
            self._starter.recorded = self.recorded
            self.state = self._starter.advance(h)
            self._remember(self.state, self._starter.mult)
            self.eq.weigh(self.state)
            return self.state

        found = self._with_new_tangent(lambda: self._newton(h, self.scheme.order))
        if isinstance(found, str):
            # Newton's own tangent in each iteration, from now on where that is cheap: one tangent moves next to nothing across a
            # stiff spring that turns, and two of its increments look like an end
            if self.eq.dense:
                self._full, self._tangent = True, None
            else:
                self._begin_spell()
            found = self._newton(h, self.scheme.order)
        if isinstance(found, str):
            raise self._failure(h, found)
        return self._accept(h, found)

    def _accept(self, h: float, p: Points) -> State:
        s, t = self.state, self.state.t + h
        q = self.system.compose(s.q, p.xi[0])
        mult = self._smallest(t, q, p.mult[0])
        end = State(t, q, p.v[0], self.eq.end_acceleration(t, p), mult[: self.system.n_lam])
        self.state = self._ended(h, end, mult)
        self._remember(self.state, mult)
        if self._theta > self.slow or self._full or not self.eq.dense:
            self._tangent = None
        self._full = self._full and not self.adaptive
        return self.state

    def _remember(self, state: State, mult: Array) -> None:
        self.past = [Past(state.t, state.q, state.v, mult), *self.past][:LONGEST]

    # -- error and order ----------------------------------------------------------------------------------------
    def _error(self, h: float, p: Points, k: int) -> float:
        """Error of a step if it had been taken with order ``k``: of what the past foretold wrongly the share of smooth motion.

        Behind much longer steps that share is small, and would hide forces that bend within: it counts as behind equal ones.
        """
        times, xis, vs = local(self.system, self.state.q, self.past[: k + 1])
        t = self.state.t + h
        if len(times) < k + 1:
            return np.inf
        w = weights(times, t)
        share = h / (t - times[-1])
        if h < SUDDEN * (times[0] - times[1]):
            share = max(share, 1.0 / (k + 1))
        of_memories = StepError(np.array([share]), -share * w, times, 0.0, 0.0, *self.norm.tolerances)
        motion = self._error_size(h, self._pencil, share * (p.xi[0] - w @ xis), share * (p.v[0] - w @ vs))
        return max(motion, memory_error(self.system, of_memories))

    def _choose(self, h: float, p: Points, error: float) -> float:
        """The next step; sets the next order. Changes only after k + 1 steps of one size and order."""
        self.held += 1
        stay = growth_of(error, self.k)
        if self.control.rejections:
            return self._after_rejections(h * min(stay, 1.0))
        calm, pays = CALM
        if self.held <= self.k and stay > calm:
            return h

        order, best = self._best_order(h, p, stay)
        if order == self.k and calm <= best <= pays:
            return h
        self.k, self.held = order, 0
        return h * within(best)

    def _after_rejections(self, h: float) -> float:
        """The next step where this one was made at last, not longer; with an order that is stable with it."""
        self.held = 0
        if not self.amplification.permits(self.k, h):
            self.k = STABLE
        return h

    def _best_order(self, h: float, p: Points, stay: float) -> tuple[int, float]:
        """The order with the longest stable step, one more or less at most, and its growth; ``stay``: that of the same order."""
        k = self.k
        order, best = k, stay
        if k > 1:
            lower = growth_of(self._error(h, p, k - 1), k - 1)
            if lower > LOWER * best:
                order, best = k - 1, lower
        if k < self.highest and len(self.past) >= k + 2:
            higher = growth_of(self._error(h, p, k + 1), k + 1)
            if higher > HIGHER * best:
                order, best = k + 1, higher

        # orders above two amplify vibrations that the step does not resolve
        while not self.amplification.permits(order, h * within(best)):
            order -= 1
            best = growth_of(self._error(h, p, order), order)
        return order, best
