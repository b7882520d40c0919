"""Steps of the Moreau scheme: flights, cuts where gaps close, impacts. Equations are those of :mod:`.moreau`."""

from __future__ import annotations

from bisect import bisect_right
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ...errors import ConvergenceError, FmbdError
from ...linear.condensation import StepSolver
from ...linear.redundancy import least
from ...mechanics.contact.obstacles import way_over
from ...mechanics.contact.rows import Rows
from ...rotations import Array
from ...system.compiled.declarations import constants, enumeration
from ...system.element_memory import drag, memories, restore
from ...system.layout import State
from ...system.sensors.contact import forces_of
from ...system.serialisation import Memory, plain
from ...system.system import System
from ..dense_output import Some, place_within, state_within
from ..newton import Newton
from .contact_detection import candidates, tell_rest
from .contact_ledger import StepForces
from .contact_stepper import ContactStepper
from .moreau_step import MoreauStep
from .slip_turns import won_behind_stops

if TYPE_CHECKING:
    from .moreau import Moreau

# length of an impact, as a share of the step; gap of a closed contact, as a share of the model's length
IMPACT, TOUCH = constants("impacts/flights.c", "INSTANT", "TOUCHING")
DRIFT = 1e-5  # the same of a contact that carries a force: positions of closed contacts drift by O(h^3) a step
# approach in a step from which on a touch is an impact also where a closed contact would only drift; that of a resting contact:
# this share of the model's length in a step
DEEP, SLOW, SLOWLY = constants("impacts/moreau.c", "DEEP", "APPROACH", "SLOWLY")
LOCATING = enumeration("LOCATING", "impacts/flights.c")["LOCATING"]  # attempts to end a step where a contact closes


class MoreauStepper(ContactStepper):
    """Advances a state through impacts."""

    keeps: ClassVar = {
        **ContactStepper.keeps,
        **dict.fromkeys(("carried", "carrying"), Memory.candidates),
        **dict.fromkeys(("located", "accumulations"), plain()),
    }

    def __init__(self, system: System, solver: StepSolver, newton: Newton, state: State, rule: Moreau) -> None:
        super().__init__(system, solver, newton, state)
        self._joints = any(b.kind != "frame" for b in system.blocks)
        self.carried = np.zeros_like(self.ledger.force)  # forces of contacts in the last flight
        self.carrying = np.zeros(len(self.carried), dtype=bool)  # contacts with a force that is no impact
        self.rule, self.located, self.accumulations = rule, 0, 0
        self.struck: list[float] = []
        self._stations: list[State] = []
        self._pressing: Array = state.a  # accelerations of the last flight

    @property
    def counters(self) -> dict[str, float]:
        """Statistics of contact, with the impacts found at their own times."""
        return {**super().counters, "impacts": self.located, "accumulations": self.accumulations}

    def advance(self, h: float) -> State:
        """One step of size h (s); collective. Raises ConvergenceError when Newton fails; the state is then
        unchanged.
        """
        before = self.state, self.carried, self.carrying, copy(self.ledger)
        struck = len(self.struck)
        remembered = memories(self.system)
        self._stations = [self.state]
        self._pressing = self.state.a
        end = self.state.t + h
        rested = np.zeros(len(self.carried), dtype=bool)
        parts = 0
        iterations = 0
        force: Array = np.zeros_like(forces_of(self.state).force)
        normal: Array = np.zeros(len(force))

        try:
            while end - self.state.t > 2 * IMPACT * h:
                part = self._part(end - self.state.t, h, rested, classical=parts >= 2 * self.rule.impacts)
                self._take(part)
                self._stations.append(self.state)
                if part.h > 2 * IMPACT * h and end - self.state.t > 2 * IMPACT * h:
                    drag(self.system, self.state)
                # forces of the parts, weighted by their shares of the step
                found = forces_of(self.state)
                share = part.h / h
                parts = parts + 1
                force = force + share * found.force
                normal = normal + share * found.normal_force
                iterations += part.iterations
        except FmbdError:
            self.state, self.carried, self.carrying, self.ledger = before
            del self.struck[struck:]
            restore(self.system, remembered)
            raise

        self.state = self.ledger.averaged(self.state, end, (force, normal))
        self.ledger.count(iterations)
        return self.state

    @property
    def stations(self) -> list[State]:
        """States at the start of the last step and at the ends of its parts; empty before the first."""
        return self._stations

    @property
    def kinks(self) -> tuple[float, ...]:
        """Times (s) within the last step at which it was cut: contacts close, and velocities jump."""
        return tuple(s.t for s in self.stations[1:-1])

    def between(self, t: float) -> State | None:
        """The state at a time t (s) within the last step, on the parabola of its part; contact forces are those of the step."""
        path = self.stations
        if not path or t < path[0].t:
            return None
        i = min(bisect_right([s.t for s in path], t), len(path) - 1)
        q, v, a, lam = self._on_parabola(path[i - 1], path[i], t)
        return replace(self.state, t=t, q=q, v=v, a=a, lam=lam)

    def _on_parabola(self, before: Some, after: Some, t: Any) -> tuple[Array, Array, Array, Array]:
        """q, v, a and lambda at a time t (s) in a part of a step, or of many with the part as the first axis."""
        q = place_within(self.system, before, after, t, (before.v, after.v))
        return q, state_within(before, after, t, q).v, after.a, after.lam

    def _part(self, left: float, h: float, rested: np.ndarray, *, classical: bool) -> MoreauStep:
        """The step to the next impact, through it, or to the end; solved. ``rested`` (m,): contacts whose impacts accumulate."""
        system, contacts, s = self.system, self.contacts, self.state
        candidates(system, contacts, s, left)  # pairs surfaces anew, and refuses to pass through
        # too many impacts in one step: those that come are taken together at its middle
        if classical:
            return self._classical(left, h)

        reach = np.where(self.carrying, DRIFT, TOUCH) * system.length
        gap = contacts.touch(system, s.t, s.q).gap
        touching = gap <= reach
        slow = SLOW * system.length / h
        rate = self._rates(touching & ~self.carrying, (s.t, s.q, s.v), h)

        hit = rate < -slow
        if hit.any():
            return self._impact((left, h), rested, hit, touching)
        closed = touching & (rate <= slow)
        above = (gap > TOUCH * system.length) & (gap <= DRIFT * system.length)
        bouncing = np.zeros_like(closed)

        # a flight up to the next touch, or to the end
        taking = closed
        while True:
            step = self._solved(left, taking, bouncing)
            more, rests = self._slow_touches(step, above & ~taking, h)
            if more.any():
                bouncing, taking = bouncing | (more & ~rests), taking | more
                continue

            share, which, held = self._next_touch(step, ~taking)
            if not held.any():
                break
            # an impact: of bodies in joints flights end at the touch, and closed at its speed a contact would end far below zero
            hit = self._rates(held, (s.t, s.q, s.v), h) < -(slow if self._joints else DEEP * system.length / h)
            if hit.any():
                return self._impact((left, h), rested, hit, closed | hit)
            closed, taking = closed | held, taking | held
        flight = step if share == 1.0 else self._located(step, share, which)
        if (won := won_behind_stops(flight, slow)) is None:
            return flight
        try:
            flight.end_with(won)
        except ConvergenceError:
            return self._solved(flight.h, taking, bouncing)
        return flight

    def _solved(self, h: float, closed: np.ndarray, bouncing: np.ndarray, *, span: float = 0.0) -> MoreauStep:
        """A step of length h (s) from the present state, its impulses first those of the last flight."""
        return MoreauStep(self, h, h * self.carried[closed], (closed, bouncing), span=span)

    def _slow_touches(self, step: MoreauStep, above: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
        """Contacts (m,) of those right ``above`` their obstacle that end a step in it, by less than closed ones drift; and those
        that come to rest.

        They take part in all of it, with their impact, and no time of their own: those that are slow for what a step
        changes in velocities, and where contacts do not rest ``early`` those that rest. In short steps fast ones are as near.
        """
        s, end = self.state, self._gap_along(step, 1.0) if above.any() else np.zeros(len(above))
        slow = above & (end < 0.0) & (end >= -DRIFT * self.system.length)
        if not slow.any():
            return slow, slow

        way = step.h * (s.v + 0.5 * (step.v - s.v))
        at = s.t + step.h, self.system.compose(s.q, way), step.v
        rows, rate = self._rows_and_rates(slow, at, h)
        pull: Array = self.contacts.times(self.system, rows.N, (step.v - s.v) / step.h)
        time: Array = np.full(len(rate), h)
        if not self.rule.early:  # touched on the way, since when some time has gone
            last, rate = rate, -np.sqrt(np.maximum(rate**2 - 2.0 * pull * end[slow], 0.0))
            time = np.divide(last - rate, pull, out=np.zeros_like(rate), where=pull < 0.0)
        rests = np.zeros_like(slow)
        rests[slow] = _over(rows.restitution, rate, pull, time)
        if self.rule.early:
            slow[slow] = -rate <= SLOWLY * h * self.system.max_abs((step.v - s.v) / step.h)
        return (slow if self.rule.early else rests), rests

    def _classical(self, left: float, h: float) -> MoreauStep:
        """The rest of a step h (s) by classical time stepping; an impact is somewhere about its middle.

        After many impacts a contact that is still open in the middle would pass into its obstacle by what a step moves, and stay
        there: it is closed too.
        """
        system, s = self.system, self.state
        middle = self.contacts.touch(system, s.t + left / 2, system.compose(s.q, 0.5 * left * s.v))
        closed = middle.gap <= 0.0
        if (self._rates(closed, (s.t, s.q, s.v), h) < -SLOW * system.length / h).any():
            self.struck.append(s.t + left / 2)
        while True:
            step = self._solved(left, closed, np.ones_like(closed))
            through = ~closed & (self._gap_along(step, 1.0) < -DRIFT * system.length)
            if not self.rule.impacts or not through.any():
                return step
            closed = closed | through

    def _impact(
        self, lengths: tuple[float, float], rested: np.ndarray, hit: np.ndarray, touching: np.ndarray
    ) -> MoreauStep:
        """A step of almost no length through the impacts of the contacts ``hit``; those that accumulate are told once a step.
        ``lengths``: what is left of the step, and all of it, s.
        """
        s, contacts, (left, h) = self.state, self.contacts, lengths
        self.located += int(hit.sum())
        self.struck.append(s.t)
        rows, rate = self._rows_and_rates(hit, (s.t, s.q, s.v), h)
        pull, rests = contacts.times(self.system, rows.N, self._pressing), np.zeros_like(hit)
        rests[hit] = _over(rows.restitution, rate, pull, h if self.rule.early else left)
        for i in np.flatnonzero(rests & ~rested):
            if contacts.pairs[contacts.pair[i]].restitution > 0.0:
                self.accumulations += 1
                tell_rest(contacts, i, self.state.t)
        rested |= rests
        return self._solved(IMPACT * h, touching, hit & ~rests, span=h)

    def _located(self, step: MoreauStep, share: float, which: int) -> MoreauStep:
        """The step that ends where contact ``which`` closes, first found at a share of ``step``.

        That was on the parabola of the whole step, without the projection on the joints: a step to there, with the forces of
        its own middle, ends a little off the touch, and Newton's method with the rate of the gap on the parabola finds its
        length. A contact that is left open would not be known as an impact; free bodies may end as deep as closed contacts
        drift, while joints would bend there.
        """
        whole = step.h
        s = self.state
        length = self.system.length
        deepest = (0.5 * TOUCH if self._joints else DRIFT) * length

        near = self._gap_along(step, (1 - 1e-3) * share)[which]
        slope = (self._gap_along(step, share)[which] - near) / (1e-3 * share)

        for _ in range(LOCATING):
            step = self._solved(share * whole, step.closed, step.bouncing)
            q = self._closed_joints(self.system.compose(s.q, 0.5 * step.h * (s.v + step.v)), s.t + step.h)
            gap = self.contacts.touch(self.system, s.t + step.h, q).gap[which]
            if -deepest <= gap <= 0.5 * TOUCH * length or not slope < 0.0:
                break
            share = float(np.clip(share - gap / slope, 0.5 * share, min(2 * share, 1.0)))
        return step

    def _rates(self, chosen: np.ndarray, at: tuple[float, Array, Array], h: float) -> Array:
        """Rates of the gaps of the chosen contacts (m,) bool at (t, q, v), zero elsewhere, m/s, (m,)."""
        rates = np.zeros(len(chosen))
        if chosen.any():
            rates[chosen] = self._rows_and_rates(chosen, at, h)[1]
        return rates

    def _rows_and_rates(self, chosen: np.ndarray, at: tuple[float, Array, Array], h: float) -> tuple[Rows, Array]:
        """Rows of the chosen contacts alone, and the rates of their gaps, m/s."""
        contacts, system = self.contacts, self.system
        t, q, v = at
        rows = contacts.rows(system, t, q, way=way_over(t, h), near=chosen)
        return rows, contacts.times(system, rows.N, v) + contacts.gap_rate(system, t, q, h)[chosen]

    def _gap_along(self, step: MoreauStep, share: float) -> Array:
        """Gaps (m,) at a share of a solved step, along its parabola."""
        system, s = self.system, self.state
        way = step.h * share * (s.v + 0.5 * share * (step.v - s.v))
        return self.contacts.touch(system, s.t + share * step.h, system.compose(s.q, way)).gap

    def _next_touch(self, step: MoreauStep, free: np.ndarray) -> tuple[float, int, np.ndarray]:
        """Share of the step at which the first free contact closes (1: none does), which one that is, and contacts (m,)
        that would leave for less than 1/4096 of it.
        """
        none = np.zeros_like(free)

        def gaps(share: float) -> Array:
            return self._gap_along(step, share)

        closing = free & (gaps(1.0) < 0.0) if free.any() else none
        if not closing.any():
            return 1.0, -1, none
        shares = 2.0 ** -np.arange(13)
        open_ = np.array([gaps(x)[closing] > 0.0 for x in shares])
        if not open_.any(axis=0).all():
            held = none.copy()
            held[closing] = ~open_.any(axis=0)
            return 1.0, -1, held

        last = open_.argmax(axis=0)  # the largest share at which each is still open
        among = np.flatnonzero(closing)[last == last.max()]
        lower, share = shares[last.max()], shares[last.max() - 1]
        from scipy.optimize import brentq

        # of those that are open at the same share the one that closes first: the others are above where it does
        which, left = int(among[0]), among
        while len(left):
            share = float(brentq(lambda x, i=which: gaps(x)[i], lower, share, xtol=1e-14))
            there = gaps(share)[left]
            if (deep := there < -0.5 * TOUCH * self.system.length).any():
                which = int(left[np.argmin(there)])
            left = left[deep]
        return share, which, none

    def _take(self, step: MoreauStep) -> None:
        """Make a solved step the present state."""
        system, s = self.system, self.state
        h, closed = step.h, step.closed
        xi = 0.5 * h * (s.v + step.v)
        q = self._closed_joints(system.compose(s.q, xi), s.t + h)
        v = self._closed_rates(q, step.v, s.t + h)
        a = (v - s.v) / h
        self.local_error = h * h / 12 * system.max_abs(a - s.a) if not closed.any() else 0.0
        force = step.contact.force
        # what contacts carry stays known behind an impact, whose impulses tell nothing of it
        if step.flies:
            self.carried = np.zeros_like(self.carried)
            self.carried[closed] = force / h
            self._pressing = a
        self.carrying = np.zeros_like(self.carrying)
        self.carrying[closed] = force[:, 0] > 0.0
        self.carrying &= ~step.bouncing
        forces = StepForces(closed, step.rows, step.contact.force / h, s.t + h / 2)
        lam = least(self.solver, s.t + h, q, step.lam)
        self.state = self.ledger.write(State(s.t + h, q, v, a, lam), forces, (step.ev, xi, step.lam), h)

    def _closed_joints(self, q: Array, t: float) -> Array:
        """Positions projected on the joints."""
        if not self._joints:
            return q
        system = self.system
        for _ in range(3):
            g = system.at(t, q).constraint()
            if np.abs(g).max(initial=0.0) <= 1e-13 * system.length:
                break
            dq, _ = self.solver.solve(np.zeros(system.n_v), -g)
            q = system.compose(q, dq)
        return q

    def _closed_rates(self, q: Array, v: Array, t: float) -> Array:
        """Velocities projected on those of the joints."""
        if not self._joints:
            return v
        end = self.system.at(t, q, v)
        dv, _ = self.solver.solve(np.zeros(self.system.n_v), -(end.jacobian.times(v) + end.constraint_rate()))
        return v + dv


def _over(restitution: Array, rate: Array, acceleration: Array, time: float | Array) -> np.ndarray:
    """Whether all later impacts of contacts that are hit at a ``rate`` (m/s, below zero) are over within a time (s): flights
    between them, each e times as long as the one before, take 2 e u / (1 - e) / a, here of their gaps (m/s^2).
    """
    return np.asarray(-2.0 * restitution * rate <= -(1.0 - restitution) * time * acceleration)
