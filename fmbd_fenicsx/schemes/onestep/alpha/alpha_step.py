"""One step of generalized-alpha: the rule for its size, and Newton's iteration for its end.

The numbers of equations are those of :mod:`.generalized_alpha`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ....errors import LinearSolveError
from ....linear.blocks.field_blocks import Weights
from ....linear.condensation import StepSolver
from ....mechanics.forces.force_elements import ScalarLoads
from ....rotations import Array
from ....system.compiled.declarations import constants
from ....system.evaluation import Evaluation
from ....system.layout import State
from ....system.lengths import farthest
from ....system.speed_rows import gaps, speed_rows
from ....system.tangents.foretold_efforts import foretold_efforts
from ....system.tangents.reaction_tangent import EVERY_PUSH, HARD_PUSH, NO_PUSH
from ...exact_tangent import Pair, exact_increment
from ...newton import ExactTangent, Newton, above_roundoff, known_gaps
from .secants import Secants

# of the model's length: after a larger increment, rows and the core's matrix are taken where it led
FAR = 1e-4
# rate above which force elements get a new tangent: a stiff spring has its true tension, and with it its
# stiffness across, only after the first increment
SLOW_TURN, TANGENT_COST = constants("onestep/alpha.c", "SLOW_TURN", "TANGENT_COST")
SLOW = 0.1  # rate above which gaps of roundoff may be what keeps increments from falling
PATIENCE = 4  # iterations with the tangent of the first one, where a new tangent is cheap


@dataclass(frozen=True)
class StepStart:
    """What a step begins with: the state, v and A as (1) and (2) take them, a and lambda predicted for the end."""

    state: State
    v: Array
    A: Array
    a: Array
    lam: Array


@dataclass(frozen=True)
class StepEnd:
    """The end of a step: A, the increment xi of the configuration, a and lambda."""

    A: Array
    xi: Array
    a: Array
    lam: Array


@dataclass(frozen=True)
class Rule:
    """Equations (1) to (3) for steps of one size h (s)."""

    h: float
    alpha_m: float
    alpha_f: float
    gamma: float
    beta: float

    @property
    def weights(self) -> Weights:
        """Of mass, damping and stiffness in the matrix of a step."""
        share = (1 - self.alpha_f) / (1 - self.alpha_m)
        return Weights(1.0, self.h * self.gamma * share, self.beta * self.h * self.h * share)

    @property
    def place_per_speed(self) -> float:
        """dq / dv at the end of a step, s."""
        return self.h * self.beta / self.gamma

    @property
    def miss(self) -> float:
        """c: velocities differ from the derivatives of places by c h^2 v'' (but for turning)."""
        return 1 / 6 - self.beta - 0.5 * (self.alpha_m - self.alpha_f)

    def predicted(self, start: StepStart) -> StepEnd:
        """The end for the accelerations and multipliers predicted."""
        h, am, af = self.h, self.alpha_m, self.alpha_f
        # (3) with the predicted a; (1) with that A
        A = ((1 - af) * start.a + af * start.state.a - am * start.A) / (1 - am)
        xi = h * start.v + h * h * (0.5 - self.beta) * start.A + h * h * self.beta * A
        return StepEnd(A, xi, start.a, start.lam)

    def even(self, a: Array, A: Array) -> Array:
        """Accelerations at the end of a step, from a and A at its start, for which places go on with velocities."""
        am, af = self.alpha_m, self.alpha_f
        return ((am - (1 - am) * (0.5 - self.beta) / self.beta) * A - af * a) / (1 - af)

    def speed(self, start: StepStart, A: Array) -> Array:
        """The velocity at the end, (2)."""
        return start.v + self.h * (1 - self.gamma) * start.A + self.h * self.gamma * A


@dataclass(frozen=True)
class Increment:
    """Of the configuration, like v, of the scaled multipliers, and the correction of the stabilised form that closes g = 0."""

    q: Array
    lam: Array
    closing: Array | None = None


class AlphaStep:
    """The unknown end of one step, and the increments by which Newton's iteration finds it. Methods are collective.

    ``patience``: iterations that share the tangent of the first one. ``stabilised``: constraints hold on both levels.
    """

    def __init__(
        self, rule: Rule, start: StepStart, solver: StepSolver, newton: Newton, *, patience: int, stabilised: bool
    ) -> None:
        self.rule, self.start, self.solver, self.newton = rule, start, solver, newton
        self.system = system = solver.system
        self.t = start.state.t + rule.h
        self.weights = rule.weights
        self.scale = self.weights.ck  # dq = scale da
        self.end = self.begun = rule.predicted(start)

        # what the iteration takes into account
        self.patience = patience
        self.stabilised = stabilised and system.n_lam > 0
        self.tangent: ExactTangent | None = None if self.stabilised else newton.tangent
        self.stiff = any(loads.stiff for loads in system.forces)
        self.springs = foretold_efforts(system)
        far = farthest(system, start.state.q)
        self.tolerance = newton.small(system, self.scale * system.typical(start.a), far)
        self.foretells = any(part.foretells for _, part in system.fields)  # new tangents are exact ones
        self.begins_anew = any(part.begins_anew for _, part in system.fields)
        self.cost = TANGENT_COST * any(part.keeps_tangents for _, part in system.fields)

        # what it has found
        self.secants = Secants(system)
        self.renewed = False  # fields have a new tangent
        self.done = 0
        self.at: Evaluation | None = None  # where the last increment began
        self.far = True  # the last increment was long
        self.lost = False  # gaps were passed over as roundoff
        self.gaps: Array = np.zeros(0)
        self.newest: Array | None = None  # increment of q
        self.foretold: dict[ScalarLoads, Array] = {}  # efforts of springs where it led
        self.misfit = 0.0  # share of it that they may have bent
        self.tangent_iterations = 0

    def solve(self) -> tuple[bool, list[float]]:
        """Iterate; whether it converged, and the history of increments over the tolerance."""
        begun = self.begins_anew and self.newton.account.otherwise and self._begin_anew()
        return self.newton.solve(
            self._increment,
            self._renew,
            ahead=self.foretells,
            begun=begun,
            misfit=lambda: self.misfit,
            cost=self.cost,
        )

    @property
    def found(self) -> State:
        """The state at the end."""
        end = self.end
        q = self.system.compose(self.start.state.q, end.xi)
        return State(self.t, q, self.rule.speed(self.start, end.A), end.a, end.lam)

    # -- one iteration ----------------------------------------------------------------------------------------------
    def _increment(self) -> float:
        """One increment; its size over the tolerance."""
        before = self.end
        ev = self.at = self._evaluation(before)
        g = self._known(ev)
        r = ev.balance(before.a, before.lam)
        ev.foretold = self.foretold
        self._prepare(ev)
        self.done += 1

        increment = self._improved(self._solved(ev, r, g))
        self._apply(increment)
        self.gaps, self.newest = g, increment.q
        self._foretell(ev, increment)

        size = self._size(increment)
        self.far = size > FAR * self.system.length
        # where increments stop falling, what roundoff of the residuals explains does not count
        if self.done > 2 and size > self.tolerance and not self.stabilised:
            size = self.system.max_abs(increment.q * above_roundoff(ev, before.lam, r, g))
        return size / self.tolerance

    def _prepare(self, ev: Evaluation) -> None:
        """The matrix, anew where that is worth it; without what is pushed across where that makes it indefinite.

        Of reactions that counts where they push hard, or where the iteration is slow without it: as predicted it may be far off.
        """
        keep = not self._wants_tangent()
        slow = self.done > 1 and self.newton.theta > SLOW_TURN
        ev.reactions = EVERY_PUSH if slow or self._impatient else HARD_PUSH
        if not keep and not self.far:
            self.secants.forget()
        try:
            self.solver.prepare(ev, self.weights, keep=keep)
        except LinearSolveError:
            ev.foretold, ev.reactions = self.foretold or self.springs.none, NO_PUSH
            self.solver.prepare(ev, self.weights)

    def _evaluation(self, end: StepEnd) -> Evaluation:
        """The system at an end."""
        q = self.system.compose(self.start.state.q, end.xi)
        return self.system.at(self.t, q, self.rule.speed(self.start, end.A))

    def _known(self, ev: Evaluation) -> Array:
        """The gaps to be closed; roundoff is none, where it may be what keeps increments from falling."""
        g = gaps(ev, self.rule.place_per_speed)
        if self.done <= 2 or self.newton.theta <= SLOW:
            return g
        known = known_gaps(ev, g)
        self.lost = self.lost or bool((known != g).any())
        return known

    def _wants_tangent(self) -> bool:
        """Whether the next increment is worth a tangent of its own; by about the rule of the driver, ``onestep/alpha.c``."""
        slow = self.newton.theta > SLOW_TURN and not self.secants.poor
        cheap = self.done == 1 and bool(self.system.fields)  # beside a solution with the factor of a field
        turned = self.stiff and self.done > 0 and (cheap or slow or self.misfit > SLOW_TURN)
        return self.far or self.tangent is not None or turned or self._impatient

    @property
    def _impatient(self) -> bool:
        return self.done > self.patience and not self.system.fields and not self.secants.poor

    def _solved(self, ev: Evaluation, r: Array, g: Array) -> Increment:
        """The increment for the residuals of (4)."""
        if self.stabilised:
            return self._on_both_levels(ev, r, g)
        if self.tangent is not None:
            return self._by_exact_tangent(self.tangent, r, g)
        return Increment(*self.solver.step(ev, -self.scale * r, -g))

    def _on_both_levels(self, ev: Evaluation, r: Array, g: Array) -> Increment:
        """Multipliers keep velocities on their constraints; a correction along M^-1 G^T closes positions. Volumes are kept."""
        slip = ev.opening()
        dq, dlam = self.solver.step(ev, -self.scale * r, -self.scale / self.weights.cd * slip)
        # what the velocities leave open in the positions is closed across the rows
        still_open = -g - ev.jacobian.times(dq)
        still_open[speed_rows(self.system)] = 0.0  # these have no g: the correction rolls
        closing, _ = self.solver.solve(np.zeros_like(dq), still_open)
        return Increment(dq, dlam, closing)

    def _by_exact_tangent(self, tangent: ExactTangent, r: Array, g: Array) -> Increment:
        """GMRES on the derivative of the residual itself."""
        dq, dlam, count = exact_increment(
            tangent, self.system, self.solver.solve, self._residual_after, (-self.scale * r, -g)
        )
        self.tangent_iterations += count
        return Increment(dq, dlam)

    def _residual_after(self, dq: Array) -> Pair:
        """Scaled balance and gaps after an increment of the configuration."""
        end = self._moved(self.system.rate(self.end.xi, dq))
        ev = self._evaluation(end)
        return self.scale * ev.balance(end.a, end.lam), gaps(ev, self.rule.place_per_speed)

    def _apply(self, increment: Increment) -> None:
        """Move the end by an increment."""
        end, rate = self.end, self.system.rate
        if increment.closing is not None:
            self.end = replace(end, xi=end.xi + rate(end.xi, increment.closing))
        moved = self._moved(rate(self.end.xi, increment.q))
        self.end = replace(moved, lam=end.lam + increment.lam / self.scale)

    def _moved(self, d_xi: Array) -> StepEnd:
        """The end with its xi, and the accelerations that go with it, moved."""
        end, h = self.end, self.rule.h
        return replace(end, xi=end.xi + d_xi, A=end.A + d_xi / (h * h * self.rule.beta), a=end.a + d_xi / self.scale)

    def _foretell(self, ev: Evaluation, increment: Increment) -> None:
        """Efforts of springs where an increment leads, and whether its tangent had others."""
        dq = increment.q if increment.closing is None else increment.q + increment.closing
        self.foretold = self.springs.after(ev, dq, increment.q * (self.weights.cd / self.weights.ck))
        self.misfit = self.springs.misfit(ev, self.foretold, self.weights.ck)

    def _size(self, increment: Increment) -> float:
        """The largest entry of an increment, as a length."""
        size = self.system.max_abs(increment.q)
        return size if increment.closing is None else max(size, self.system.max_abs(increment.closing))

    def _improved(self, increment: Increment) -> Increment:
        """With what the tangent leaves out, where earlier increments tell it; the best tangent that there is comes first.

        A tangent with all terms has no use for it: its iteration is slow by itself.
        """
        best_is_due = self.foretells and not self.renewed
        if self.tangent is not None or best_is_due or not self.system.leaves_out:
            return increment
        blocks = [increment.q] if increment.closing is None else [increment.q, increment.closing]
        found = self.secants.improved(np.concatenate((*blocks, increment.lam)), len(blocks))
        n = self.system.n_v
        closing = None if increment.closing is None else found[n : 2 * n]
        return Increment(found[:n], found[len(blocks) * n :], closing)

    def _renew(self) -> bool:
        """A new tangent of fields, if earlier increments do not tell what the one in use leaves out; whether there is one."""
        if self.secants.learning and not self.foretells:
            return False
        taken = self._take_tangent_ahead() if self.foretells else self._take_tangent()
        if taken:
            self.secants.forget()
            self.renewed = True
        return taken

    def _begin_anew(self) -> bool:
        """A new tangent where the step is predicted; whether there is one."""
        ev = self._evaluation(self.end)
        ev.forces = self.end.a, self.end.lam
        self.renewed = self.solver.refresh(ev, self.end.xi, predicted=True)
        return self.renewed

    def _take_tangent(self) -> bool:
        """A new tangent where the last increment began; whether there is one."""
        assert self.at is not None
        return self.solver.refresh(self.at)

    def _take_tangent_ahead(self) -> bool:
        """The same where it led, with the stresses that it foretold."""
        ev = self._evaluation(self.end)
        ev.forces = self.end.a, self.end.lam
        return self.solver.refresh(ev, self.newest)
