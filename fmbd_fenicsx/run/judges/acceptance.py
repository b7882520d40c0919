"""A step counts when its residuals are small: joints that are closed, and stay so.

    |g_i| u_i  <=  5e-7 L + 100 eps |x|        for schemes that hold the constraints on positions                    (1)
    |G v + g_t| u_i  <=  1e-4 |v|_max + 5e-9 L / h + 100 eps |x| / h    for those that hold them on velocities       (2)

with L the model's length, u_i = L for rows that are angles, |x| the distance from the origin. With error control L is multiplied
by 5e-7 or the relative tolerance, whichever is larger; in (2), where it says what velocities may move in one step, by a hundredth
of that, as error control measures the rates of deformations. Forces have their own judge, :mod:`.force_balance`.

Newton's iteration judges increments; where its matrix is close to singular they can be small while a joint is open, and a linear
solve can pass with the rows of a light body lost in those of a heavy one. A step that fails here is one that failed to converge:
it is made in parts, or in smaller ones under error control, and where these fail too the run ends with the name of the joint.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ...errors import BalanceError, ConvergenceError
from ...rotations import Array
from ...schemes.consistent import worst_block
from ...schemes.declared import Declared
from ...system.compiled.march import JointLimits
from ...system.compiled.tape import Openness
from ...system.element_memory import accept, overran
from ...system.evaluation import Evaluation
from ...system.evaluator import Seen
from ...system.layout import State
from ...system.lengths import SHUT, farthest
from ...system.serialisation import Remembering, plain
from ...system.system import System
from .force_balance import Balanced

OPEN = SHUT  # of the model's length
SLIP = 1e-4  # of the velocities
IN_A_STEP = 1e-2  # of the gap that is allowed: how far velocities may open a joint in one step
REPEATS = 4  # of a step with error control that has no balance, each a quarter of the one before
FOLLOWED = 10  # the same, that a memory could not follow
ROUNDOFF = 100 * float(np.finfo(float).eps)


def attempt(system: System, stepper: Any, h: float) -> State:
    """One step of a scheme of at most h (s), of which NumPy says nothing by itself; collective. Raises as :func:`finite_step`."""
    with np.errstate(over="ignore", invalid="ignore"):
        return finite_step(system, stepper, h)


def accept_step(system: System, stepper: Any) -> bool:
    """The newest step counts: the memory of elements moves on with it; whether forces have jumped. Collective."""
    return not stepper.note() and accept(system, stepper.state)


def finite_step(system: System, stepper: Any, h: float) -> State:
    """One step of a scheme of at most h (s); collective.

    Numbers beyond the range of the machine, forces that are not finite among them, or that NumPy gives up on are those of an
    iteration that diverged.

    Raises:
        ConvergenceError: so they are here, also where the scheme takes them for a state.
    """
    t = stepper.state.t
    try:
        made: State = stepper.advance(h)
    except (np.linalg.LinAlgError, BalanceError) as error:
        raise diverged(t, h, error) from error
    if not system.finite(made.v, made.a, made.lam):
        raise diverged(t, h, "the state is not finite")
    return made


def attempt_judged(
    system: System, stepper: Any, h: float, *, closed: Closed, balanced: Balanced | None
) -> Evaluation | None:
    """One step with error control of at most h (s), repeated in smaller ones where its joints are open or its forces not in
    balance, or a memory could not follow it; collective.

    Returns the system in the new state, where it is known. The balance of elements with a memory is not judged: that may be of
    the new state already.

    Raises:
        ConvergenceError: the step fails, or does not pass in 1/4^4 of its size either.
    """
    before = stepper.state
    for left in range(FOLLOWED if system.keepers else REPEATS, -1, -1):
        state = attempt(system, stepper, h)
        made = state.t - before.t
        try:
            seen = _judged(system, stepper, made, closed, balanced)
            if not (left and system.keepers and overran(system, state, made, closed.rtol)):
                return seen
        except ConvergenceError:
            if not left:
                raise

        # back to the state before: a quarter of the step that the scheme chose
        h = 0.25 * made
        stepper.state = before
        stepper.restart(before.t)
    return None


def _judged(system: System, stepper: Any, h: float, closed: Closed, balanced: Balanced | None) -> Evaluation | None:
    """The system in the newest state, after a step of h (s), where it is known; raises and counts where it does not pass."""
    state, known = stepper.state, stepper.evaluation
    weighed = None if system.keepers else balanced
    if not closed.judging and weighed is None:
        return known  # type: ignore[no-any-return]
    seen: Evaluation = known or system.at(state.t, state.q, state.v)

    judge: Closed | Balanced = closed
    try:
        closed.check(seen)
        if weighed is not None:
            judge = weighed
            weighed.check(seen, state, h)
    except ConvergenceError:
        judge.repeated += 1
        raise
    return known if system.keepers else seen


def diverged(t: float, h: float, why: object) -> ConvergenceError:
    """The error of a step of h (s) after t (s) that left the range of numbers."""
    return ConvergenceError(
        f"Newton's iteration diverged after t = {t:.6g} s (h = {h:.3g} s): {str(why).rstrip('.')}. Take a smaller dt or rtol."
    )


@dataclass
class Closed(Remembering):
    """Refuses states whose constraints are open. ``levels``: those that the scheme holds; ``share``: the factor of L in (1);
    ``even``: whether steps are of one size; ``rtol``: else what chooses them.
    """

    keeps: ClassVar = dict.fromkeys(("fastest", "last", "step"), plain())

    system: System
    levels: tuple[int, ...]
    share: float = OPEN
    even: bool = True
    rtol: float = 0.0
    fastest: float = field(default=0.0)  # m/s, of all states so far
    last: float | None = field(default=None)  # s, time of the newest state that has passed
    step: float = 1.0  # s, from the one before to that
    repeated: int = 0  # steps that were made again

    @staticmethod
    def under(system: System, said: Declared) -> Closed:
        """For the states of a scheme by what it has said; one that says nothing of its levels is not judged."""
        rtol = said.rtol or 0.0
        return Closed(system, said.levels, max(OPEN, rtol), not said.adaptive, rtol)

    @cached_property
    def units(self) -> Array:
        """u of (1), (n_lam,); 0 where there is no length to judge by."""
        s = self.system
        return s.row_units * s.in_lengths if s.port_constraints else s.row_units

    def check_tape(self, seen: Any, t: float) -> None:
        """The same for records of compiled steps up to time t (s), the first that is open by (1) as :meth:`check` does."""
        if not self.system.n_lam or 0 not in self.levels:
            return
        if (state := seen.doubt) is not None:
            self.check(self.system.at(state.t, state.q, state.v))
        self._reached(t)

    @property
    def openness(self) -> Openness:
        """By what the compiled loop tells states that are to be looked at."""
        nothing = 0 not in self.levels
        return Openness(self.units, np.inf if nothing else self.share * self.system.length, ROUNDOFF)

    def limits(self, h: float) -> JointLimits:
        """By what every state of compiled steps is judged: who passes needs no look. (2) without rates in time, of those that are
        all of size h (s).
        """
        if 1 not in self.levels or not self.even:
            return JointLimits(self.openness, np.inf, 0.0, 0.0)
        still = (IN_A_STEP * self.share + ROUNDOFF) * self.system.length / h
        return JointLimits(self.openness, still, SLIP + self.share, self.fastest)

    def passed(self, t: float, fastest: float) -> None:
        """Compiled steps up to time t (s) have passed, with this largest speed (m/s)."""
        if self.judging:
            self._reached(t)
            self.fastest = max(self.fastest, fastest) if 1 in self.levels else self.fastest

    def _reached(self, t: float) -> None:
        """A state at t (s) has passed."""
        if self.last is not None and t > self.last:
            self.step = t - self.last
        self.last = t

    @cached_property
    def judging(self) -> bool:
        """Whether there is anything to judge."""
        return bool(self.system.n_lam) and 0 in self.levels

    @cached_property
    def _wide(self) -> float:
        """What (1) allows beside roundoff, m."""
        return self.share * self.system.length

    def passes(self, seen: Seen, t: float) -> bool:
        """Whether a state at time t (s) of which this was seen passes; :meth:`check` has to look closely where it does not."""
        if not self.judging:
            return True
        known = ROUNDOFF * seen.far
        if not seen.gap <= self._wide + known:
            return False
        if 1 in self.levels and not seen.slip <= self._slip_allowed(t, known, seen.speed, seen.rate):
            return False
        self._reached(t)
        return True

    def check(self, ev: Evaluation) -> None:
        """Raise ConvergenceError when a joint is open in a state; collective."""
        s = self.system
        if not self.judging:
            return
        # (1), positions
        gap = self.units * np.abs(ev.constraint())
        known = ROUNDOFF * farthest(s, ev.q)
        allowed = self._wide + known
        if not np.maximum.reduce(gap) <= allowed:
            raise ConvergenceError(
                f"At t = {ev.t:.6g} s {worst_block(s, gap)} is open by {gap.max():.3g} m, {allowed:.2g} m is allowed. Joints "
                "and drives may ask for more than bodies can reach there; else look for bodies that are much lighter or stiffer "
                "than what they are attached to, or surfaces so small that they turn as on a hinge, or take a smaller dt."
            )
        # (2), velocities
        if 1 in self.levels and ev.v is not None:
            self._check_velocities(ev, ev.v, known)
        self._reached(ev.t)

    def _slip_allowed(self, t: float, known: float, speed: float, rate: float) -> float:
        """The right-hand side of (2) at t, m/s, of the largest velocity and the largest rate that is given in time."""
        length = self.system.length
        # over the step since the state before
        h = t - self.last if self.last is not None and t > self.last else self.step
        self.fastest = max(self.fastest, speed)
        allowed = (SLIP + self.share) * (self.fastest + rate)
        allowed += IN_A_STEP * self.share * length / h
        return allowed + (ROUNDOFF * length + known) / h  # of a body at rest

    def _check_velocities(self, ev: Evaluation, v: Array, known: float) -> None:
        """(2) for velocities; ``known``: roundoff of places, m."""
        s = self.system
        rate = float(np.maximum.reduce(self.units * np.abs(ev.constraint_rate())))
        slip = self.units * np.abs(ev.opening())
        allowed = self._slip_allowed(ev.t, known, s.max_abs(v), rate)
        if not np.maximum.reduce(slip) <= allowed:
            raise ConvergenceError(
                f"At t = {ev.t:.6g} s {worst_block(s, slip)} opens at {slip.max():.3g} m/s, {allowed:.2g} m/s is allowed. Take a "
                "smaller dt."
            )
