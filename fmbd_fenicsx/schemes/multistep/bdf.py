"""Backward differentiation: variable steps and orders one to five, or constant ones; any form of the constraints.

With past values y_j = (xi_j, v_j) expressed in the local coordinates of the current step, xi_j = log(q_n^-1 o q_j), the
derivative at t_n+1 is that of the polynomial through the new and the last k values (variable coefficients):

    y'_n+1 = sum_j c_j y_n+1-j,        the equations of motion hold at (t_n+1, y_n+1, y'_n+1)                     (1)

One Newton iteration solves with the frequency s = c_0; tangent and factor are kept while it converges fast, and corrected by
2 / (1 + s / s_old) while s stays near. The error of a step of order k is h / (t_n+1 - t_n-k) (y_n+1 - y_predicted), the predictor
running through k + 1 past values; the same formula serves the neighbouring orders. Multipliers stay out of the error test:
they are no part of the memory of the formula.

The first steps of one size are those of Radau IIA. With error control orders climb from 1; but behind kinks and samples that
follow each other within a few climbs Radau IIA makes two steps, the polynomials of the second of which are the past of one of
order 3 and a third of its size, and all where fewer are left than orders to climb. (Runge-Kutta starters: Gear, ACM Trans. Math.
Softw. 6 (1980), p. 263.)

Index 3 keeps order k in all components with constant steps only; with error control GGL, or a form of lower index, is the choice.

Sources: Brenan, Campbell and Petzold, doi:10.1137/1.9781611971224 (variable coefficients, error test); Hairer and Wanner, Solving
ODEs II, sections III.5 and VII.3, doi:10.1007/978-3-642-05221-7; Gear, Gupta and Leimkuhler, doi:10.1016/0377-0427(85)90008-1.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ...checks import check_fields
from ...errors import require
from ...linear.condensation import StepSolver
from ...polynomials import lagrange_values
from ...rotations import Array
from ...system.compiled.implicit import WORK, ImplicitRoom, OrdersOfBDF
from ...system.compiled.own_steps import OwnRoom
from ...system.compiled.states.convergence import Convergence
from ...system.compiled.states.stages import StageRule
from ...system.element_memory import divide
from ...system.layout import State, States
from ...system.scene.contents import Contents
from ...system.serialisation import plain, worker
from ...system.system import System
from ..control import ESTIMATE, StepControl, moves, turn_limit, turns_too_far
from ..dae import GGL, Form, OfForm, Points
from ..error_norm import STRICT, check_tolerance, worst
from ..implicit.implicit_stepper import ImplicitStepper
from ..newton import Newton
from ..onestep.radau import Radau, RadauStepper
from ..stepping import Observers
from .amplification import STABLE
from .corrector import ALONE, NEAR, RATES, Corrector
from .order_choice import CALM, HIGHER, LEAST, LOWER, SAFETY, WITHIN, OrderChoice
from .past import LONGEST, Past, before, increments, keep_past, local, slopes, slopes_at_first, weights

if TYPE_CHECKING:
    from ...system.compiled.kept import KeptSteps

SLOW = 0.2  # rate of convergence above which the next step takes a tangent, with error control
OUTLASTS = 3  # climbs to the highest order, each of k + 1 steps an order k, that a stretch takes to need no help
SUDDEN = 0.4  # share of the longest step that foretells it, below which a step is behind a bend of forces, as in bdf.c


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

    takes_given: ClassVar[bool] = True

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


class BDFStepper(ImplicitStepper):
    """Advances a consistent state; holds the past values, newest first, and the choice of step and order."""

    maker = "BDF"
    slow = 0.05
    lost = 1e-5
    iteration: Corrector
    keeps: ClassVar = {
        **ImplicitStepper.keeps,
        "past": keep_past,
        "orders": worker,
        "_starter": worker,
        "_begins": plain(),
        "_divides": plain(),
        "_steps_before": plain(),
    }

    def __init__(self, scheme: BDF, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        super().__init__(scheme, system, solver, newton, state)
        self.control = StepControl(2.0)
        self.norm.let_pass(STRICT)  # nothing looks at forces within a step beside its estimate
        self.iteration = Corrector(self.eq, self.norm, newton, adaptive=self.adaptive)
        self.orders = OrderChoice(solver, min(scheme.order, STABLE) if system.fields else scheme.order)
        if self.adaptive:
            self.slow = SLOW
        else:  # with variable ones frequencies hardly come back
            self.eq.keep_sizes(equal=True)

        # a Radau method makes the first steps; under error control those behind stretches that hardly outlast a climb, where its
        # factors are cheap: up to one whose size is no guess, and all where fewer are left up to a new start than orders to climb
        self._starter: RadauStepper | None = None
        if scheme.order > 1 and not (self.adaptive and system.fields):
            starter = Radau(stages=3, form=scheme.form, rtol=scheme.rtol, atol=scheme.atol)
            self._starter = starter.stepper(system, solver, newton, state)
            self._starter.norm = self._starter.iteration.norm = self.norm
        self._begins = False  # Radau makes the next step, with error control
        self._divides = False  # its last step is to be the past of the next one
        self._steps_before = 0  # those made before the newest start
        self._begin_from(state)

    def _begin_from(self, state: State) -> None:
        super()._begin_from(state)
        made = self.stats.steps
        if self._starter is not None:
            made += self._starter.stats.steps
        climb = self.scheme.order * (self.scheme.order + 1) // 2
        short = 0 < made - self._steps_before < OUTLASTS * climb
        self._steps_before = made

        self.past = [Past(state.t, state.q, state.v, self.eq.multipliers(state))]
        self.orders.begin(1 if self.adaptive else self.scheme.order)
        self._divides = False
        self._begins = self._starter is not None and (short or not self.adaptive)
        if self._starter is not None and self._begins:
            self._starter.begin_anew(lambda: state)

    @property
    def _starting(self) -> bool:
        """Whether a Radau method makes the next step."""
        return self._begins if self.adaptive else self._starter is not None and len(self.past) < self.scheme.order

    def take_given(self, sizes: Array) -> None:
        """As :meth:`OwnMarch.take_given`."""
        super().take_given(sizes)
        if self._starter is not None:
            self._starter.take_given(sizes)

    def stride(self, h: float) -> float:
        """As :meth:`TimeStepper.stride`."""
        return self._starter.stride(h) if self._starter is not None and self._starting else super().stride(h)

    def note(self) -> bool:
        """As :meth:`TimeStepper.note`, also of the first steps, which another scheme makes."""
        starter = self._starter
        return starter.note() if starter is not None and starter.state is self.state else super().note()

    @property
    def counters(self) -> dict[str, float]:
        """As :meth:`ImplicitStepper.counters`, with the mean order of steps of its own choice."""
        own = super().counters
        begun = {} if self._starter is None else self._starter.counters
        both = {name: own.get(name, 0.0) + begun.get(name, 0.0) for name in {**own, **begun}}
        return {**both, "mean order": self.orders.taken / self.stats.steps} if self.orders.taken else both

    # -- steps --------------------------------------------------------------------------------------------------
    def _controlled(self, limit: float) -> State:
        """A step of at most ``limit`` (s) that passes the error test."""
        if self._starting:
            return self._started(limit)
        s, orders, iteration = self.state, self.orders, self.iteration
        orders.look(s)
        farthest = turn_limit(self.system, s, steps=orders.k + 1)
        self.control.span = max(self.control.span, limit)
        if self.proposed is None:
            self.proposed = self.control.proposal(0.1 * self._first_size(2.0, limit), limit)
            newest = self.past[0]
            self.past = [newest, before(self.system, s, min(self.proposed, limit), newest.mult)]

        while True:
            h = self._landing(min(self.control.proposal(self.proposed, limit), farthest), limit)
            moves(s.t, h, iteration.fault)
            self.solver.near_singular.begin_trial()
            self.norm.update(s, h)

            found = iteration.find(h, s, self.past, orders.k)
            if not isinstance(found, str) and turns_too_far(self.system, found.xi):
                found = "turns too far"

            if isinstance(found, str):
                cause, error = found, np.inf
                if iteration.renews():
                    continue  # once more with a new tangent
                if cause.startswith("Newton") and self.eq.dense and not iteration.full:
                    iteration.full = True
                    continue  # and with one for each iteration, before the step is made smaller
            else:
                error, cause = self._error(h, found, orders.k), ESTIMATE
                if self.control.passes(error):
                    break
            self._reject(h, error, cause)

        self.solver.near_singular.accept_trial()
        self.local_error = error
        new = self._next_size(h, found, error)
        self.control.rejections.clear()
        self.proposed = new if h >= min(self.proposed, limit) * (1 - 1e-9) or new < h else self.proposed
        return self._accept(h, found)

    def _reject(self, h: float, error: float, cause: str) -> None:
        """A smaller step next."""
        self.iteration.full = False
        self.stats.rejected[cause] += 1
        self.control.order, self.control.fault = self.orders.k + 1.0, self.iteration.fault
        self.proposed = self.control.rejected(self.state.t, h, error, cause)
        self.orders.refused(len(self.control.rejections))

    def _next_size(self, h: float, p: Points, error: float) -> float:
        """The size (s) that is proposed after a step of size h; sets the next order."""
        self.orders.taken += self.orders.k
        if self.control.rejections:
            return self.orders.size_after_refusals(h, error)
        return self.orders.next_size(h, error, lambda order: self._error(h, p, order), len(self.past))

    def _started(self, h: float) -> State:
        """A step of size h (s), or of at most that, by a Radau method."""
        starter = self._starter
        assert starter is not None
        starter.recorded = self.recorded
        starter.bound(self.longest, self.ends, self.last)

        guessed = len(self.past) == 1  # the size of the first step
        self.state, self.local_error = starter.advance(h), starter.local_error
        self._remember(self.state, starter.mult)
        self.eq.weigh(self.state)

        if self.adaptive:
            assert starter.proposed is not None
            self.proposed = starter.proposed
            few = 0.0 < self.ends[-1] - self.state.t < self.orders.highest * self.proposed
            self._begins = guessed or few
            self._divides = not self._begins
            self.past = self.past if self._begins else self.past[:1]
        return self.state

    def _made(self, h: float, count: int, most: float, observers: Observers) -> int:
        """As that of others; the first step behind those of a Radau method has its polynomials for its past."""
        starter = self._starter
        if starter is not None and self._divides:
            assert self.proposed is not None
            self._divides = False
            k = min(starter.scheme.stages, self.orders.highest)
            steps, mult = starter.divided(k)
            divide(self.system, steps.t[:, 0])
            self.past += [Past(s.t, s.q, s.v, mult[i]) for i, s in enumerate(steps.each())]
            self.proposed = min(self.proposed, WITHIN[1] * starter.last_size) / k
            self.orders.begin(k)
        return super()._made(h, count, most, observers)

    def _constant(self, h: float) -> State:
        """A step of size h; the first ones by a Radau method, until the past is long enough."""
        if self._starting:
            return self._started(h)

        s, order, iteration = self.state, self.scheme.order, self.iteration
        found = iteration.with_new_tangent(s, lambda: iteration.find(h, s, self.past, order))
        if isinstance(found, str):
            # Newton's own tangent in each iteration, from now on where that is cheap: one tangent moves next to nothing across a
            # stiff spring that turns, and two of its increments look like an end
            if self.eq.dense:
                iteration.full, iteration.tangent = True, None
            else:
                iteration.begin_spell()
            found = iteration.find(h, s, self.past, order)
        if isinstance(found, str):
            raise iteration.failure(s.t + h, h, found)
        return self._accept(h, found)

    def _accept(self, h: float, p: Points) -> State:
        s, t, iteration = self.state, self.state.t + h, self.iteration
        q = self.system.compose(s.q, p.xi[0])
        mult = self._smallest(t, q, p.mult[0])
        end = State(t, q, p.v[0], self.eq.end_acceleration(t, p), mult[: self.system.n_lam])
        self.state = self._ended(h, end, mult)
        self._remember(self.state, mult)
        if iteration.theta > self.slow or iteration.full or not self.eq.dense:
            iteration.tangent = None
        iteration.full = iteration.full and not self.adaptive
        return self.state

    def _remember(self, state: State, mult: Array) -> None:
        self.past = [Past(state.t, state.q, state.v, mult), *self.past][:LONGEST]

    # -- error --------------------------------------------------------------------------------------------------
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
        if h < SUDDEN * (times[:-1] - times[1:]).max():
            share = max(share, 1.0 / (k + 1))
        motion = self._error_size(h, self.iteration.pencil, share * (p.xi[0] - w @ xis), share * (p.v[0] - w @ vs))
        return worst(motion, self.norm.of_memories(np.array([share]), -share * w, times))

    # -- what a march begins with -----------------------------------------------------------------------------------
    def _in_one_call(self, h: float) -> bool:
        return not self._starting and (len(self.past) > 1 or self._divides) and super()._in_one_call(h)

    def _lend(self) -> ImplicitRoom:
        stages, order = self.eq.whole.room(1, 1), self.scheme.order
        if not self.adaptive:
            return ImplicitRoom(stages, {}, order)
        (shrink, grow), (keep, calm), (nearest, farthest) = WITHIN, CALM, NEAR
        orders = OrdersOfBDF(
            highest=self.orders.highest, safety=SAFETY, least=LEAST, shrink=shrink, grow=grow, keep=keep, calm=calm,
            lower=LOWER, higher=HIGHER, nearest=nearest, farthest=farthest, **self.eq.frequency_grid,
        )  # fmt: skip
        return ImplicitRoom(stages, {}, order, own=self._own_room(orders=orders))

    def _settings(self) -> tuple[Convergence, StageRule]:
        return self.iteration.convergence(0.0, RATES, 1.0), StageRule(ALONE, ALONE, ALONE)

    def _memory(self) -> Array:
        (newest, *older), twin = self.past[: self.scheme.order + 1], self._twin
        values = np.zeros((self.scheme.order, 1 + twin.system.n_q + twin.system.n_v + len(newest.mult)))
        for row, x in zip(values, older, strict=False):
            np.concatenate(([x.t], twin.configurations(x.q), twin.velocities(x.v), x.mult), out=row)
        head = self.orders.k, self.orders.held, self.proposed or 0.0
        return np.concatenate((head, newest.mult, [len(older)], values.ravel()))

    def _factored_for(self) -> float:
        return float(self.iteration.pencil.s[0])

    def _frequencies(self, h: float) -> Array:
        times = self.state.t + h, *(x.t for x in self.past[: self.scheme.order])
        return slopes_at_first(np.array(times))[:1]

    def _lend_matrices(self, frequency: float) -> None:
        assert self._lent is not None
        if not self.adaptive:
            self.eq.expect(np.array([frequency]))
        self.eq.whole.lend_matrices(self._lent.stages, self.state, np.array([frequency]))

    def _lend_own(self, own: OwnRoom) -> None:
        super()._lend_own(own)
        assert own.orders is not None
        self.orders.look(self.state)
        known = self.orders.amplification
        own.orders.lend(known.spans, known.uses, known.most)

    # -- what it leaves ---------------------------------------------------------------------------------------------
    def _take_own(self, own: OwnRoom, made: int) -> None:
        super()._take_own(own, made)
        assert own.orders is not None
        self.orders.amplification.uses = int(own.orders.uses)
        self.orders.taken += int(own.orders.taken)

    def _recall(self, kept: Array, factored: float) -> None:
        s = self.state
        (k, held, proposed), mult, count, (t, q, v, mults) = self._told(kept)
        if self.adaptive:
            self.orders.k, self.orders.held, self.proposed = int(k), int(held), float(proposed)
        older = [Past(float(t[i]), q[i], v[i], mults[i]) for i in range(int(count[0]))]
        self.past = [Past(s.t, s.q, s.v, mult), *older]

    def _told(self, kept: Array) -> tuple[Array, Array, Array, tuple[Array, Array, Array, Array]]:
        """Numbers, multipliers, how many older values there are, and their t, q, v and multipliers, of what a state keeps; of
        many with these as first axis.
        """
        twin, at = self._twin, 3 + self.eq.n_mult
        older = kept[..., at + 1 :].reshape(*kept.shape[:-1], self.scheme.order, -1)
        q, v = 1 + twin.system.n_q, 1 + twin.system.n_q + twin.system.n_v
        values = older[..., 0], twin.places(older[..., 1:q]), twin.forces(older[..., q:v]), older[..., v:]
        return kept[..., :3], kept[..., 3:at], kept[..., at : at + 1], values

    # -- states within steps ----------------------------------------------------------------------------------------
    def between(self, t: float) -> State | None:
        """The state at a time t (s) within the last step, on the polynomials through the newest k + 1 past values."""
        if self._starter is not None and self._starter.state is self.state:
            return self._starter.between(t)
        count = min(self.orders.k + 1, len(self.past))
        if count < 2 or not self.past[count - 1].t <= t <= self.state.t:
            return None

        known = self.past[:count]
        times, places, velocities = local(self.system, self.state.q, known)
        shares, rates = weights(times, t), slopes(times, np.array(t))
        q = self.system.compose(self.state.q, shares @ places)
        mult = shares @ np.array([past.mult for past in known])
        within = State(t, q, shares @ velocities, rates @ velocities, mult[: self.system.n_lam])
        return self._held(self.state.t - known[1].t, within)

    def within(self, steps: KeptSteps) -> States:
        """As :meth:`TimeStepper.within`: those of one order together."""
        h, (head, _, count, _) = steps.h[:, 0], self._told(steps.own[:, WORK:])  # whose ends are written over
        order = head[:, 0].astype(int) if self.adaptive else np.full(len(head), self.scheme.order)
        through, found = np.minimum(order, count[:, 0].astype(int)), steps.after
        for k in np.unique(through):
            which = through == k
            found.put(which, self._through(steps.chosen(which), int(k)))
        return self._all_held(h, found)

    def _through(self, steps: KeptSteps, k: int) -> States:
        """The same on the polynomials through the newest of k + 1 values."""
        end, (_, mult, _, older) = steps.after, self._told(steps.own[:, WORK:])
        newest = end.t[:, 0], end.q, end.v, mult
        t, q, v, mult = (np.concatenate((x[:, None], y[:, :k]), axis=1) for x, y in zip(newest, older, strict=True))
        xi = increments(self.system, np.broadcast_to(end.q[:, None], q.shape), (t, q, v))

        at = steps.t[:, 0]
        w, rates = lagrange_values(t, at)[:, None], slopes(t, at)[:, None]
        place = self.system.compose(end.q, (w @ xi)[:, 0])
        lam = (w @ mult)[:, 0, : self.system.n_lam]
        return States(steps.t, place, (w @ v)[:, 0], (rates @ v)[:, 0], lam)
