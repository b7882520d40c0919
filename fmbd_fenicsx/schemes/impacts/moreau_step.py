"""One step of the Moreau scheme, a flight or an impact, by Newton's iteration. Equations are those of :mod:`.moreau`."""

from __future__ import annotations

import numpy as np

from ...linear.blocks.field_blocks import Weights
from ...mechanics.contact.obstacles import way_at_start, way_over
from ...mechanics.contact.rows import Rows
from ...rotations import Array, tangents_of
from ...system.compiled.declarations import constants
from .contact_newton import ContactStep, openings
from .contact_stepper import ContactStepper
from .restitution import Impact

# of the model's length in a flight: the rate of a contact that does not leave
(STILL,) = constants("impacts/flights.c", "STILL")


class MoreauStep(ContactStep):
    """One solved step of length h from the stepper's state: v_1 ``v``, lambda ``lam``, P in ``contact.force``.

    ``closed`` (m,) contacts take part, those in ``bouncing`` (m,) with restitution, or back at the speed they leave with; in
    flights the others stay closed by (4). ``span``: of an impact, over which obstacles' motion is measured.
    """

    def __init__(
        self, stepper: ContactStepper, h: float, impulse: Array, which: tuple[np.ndarray, np.ndarray], *, span: float
    ) -> None:
        """``impulse``: of the closed contacts, to begin with; ``which``: ``closed`` and ``bouncing``."""
        super().__init__(stepper, h, impulse)
        self.closed, self.bouncing = closed, bouncing = which
        self.span = span or h
        self.flies = not span
        s, contacts = stepper.state, stepper.contacts

        self.v = s.v.copy()
        self.impact: Impact | None = None
        self.rows: Rows | None = None
        self.turn: Array | float = 0.0  # of slips with the rows, in half a flight, m/s
        self.slips: Array = np.zeros((closed.sum(), 0))  # at the start of a flight, along the axes of its middle, m/s

        # rows at the middle; what comes in before an impact rebounds by its share, and what leaves may come back
        if closed.any():
            middle = stepper.system.compose(s.q, 0.5 * h * s.v)
            at = (stepper.system, s.t + h / 2, middle)
            self.rows = contacts.rows(*at, way=way_over(s.t, self.span), near=closed)
            self.rate = contacts.gap_rate(*at, self.span)[closed]
            before = self._openings(s.v)
            back = np.where(before[:, 0] < 0.0, self.rows.restitution, 1.0)
            bounces = bouncing[closed]
            rebound = np.where(bounces, back * before[:, 0], 0.0)
            if self.flies and not bounces.all():
                start = self._start_rates(self.rows.normal)
                start[start[:, 0] > STILL * stepper.system.length / h, 0] = 0.0
                rebound = np.where(bounces, rebound, (before - start)[:, 0])
                self.turn = np.where(bounces[:, None], 0.0, (before - start)[:, 1:])
                self.slips = start[:, 1:]

            self.impact = Impact(before, rebound)
            self.contact.impact = self.impact if (bounces & (rebound < 0.0)).any() else None
        self.iterations = self.solve()

    def _start_rates(self, normal: Array) -> Array:
        """Rates of the gaps of closed contacts, m/s, and slips across ``normal`` (m, d), at the start of a flight.

        Both of obstacles that move as prescribed by their places at its start, middle and end. (m, 1 or d).
        """
        contacts, system, s = self.p.contacts, self.p.system, self.p.state
        h, closed = self.h, self.closed
        way = way_at_start(s.t, h)
        rows = contacts.rows(system, s.t, s.q, way=way, near=closed)
        rates = openings(contacts, system, rows, h * contacts.times(system, rows.N, s.v), h * s.v) / h
        if rows.components > 1:
            slips = np.einsum("mk,kmd->md", rates[:, 1:], tangents_of(rows.normal))
            rates[:, 1:] = np.einsum("md,kmd->mk", slips, tangents_of(normal))
        rates[:, 0] += contacts.gap_ways(system, (s.t, s.q), way)[closed] / h
        return rates

    def _openings(self, v: Array) -> Array:
        """Rates of gaps, and slips (m/s), of the closed contacts at velocities v: (m, 1 or d)."""
        p = self.p
        assert self.rows is not None
        rate = p.contacts.times(p.system, self.rows.N, v) + self.rate
        u = openings(p.contacts, p.system, self.rows, rate, self.span * v)
        u[:, 1:] /= self.span  # slips over the step become velocities
        return u

    def end_with(self, slips: Array) -> None:
        """Solve it once more, such that contacts whose slips have come to rest end with others, m/s, (m, d - 1)."""
        self.turn = self.turn - slips
        self.v, self.lam = self.p.state.v.copy(), self.p.state.lam.copy()
        self.iterations += self.solve()

    @property
    def openings(self) -> Array:
        """What the law of contact is for at the present velocities, (3) or (4), m/s, (m, 1 or d)."""
        assert self.impact is not None
        u = self._openings(self.v)
        u[:, 0] += self.impact.rebound
        u[:, 1:] += self.turn
        return u

    def increment(self) -> float:
        """One Newton step; returns its size over the tolerance."""
        p = self.p
        h = self.h
        s = p.state
        system = p.system
        vm = 0.5 * (s.v + self.v)
        at = s.t + h / 2, system.compose(s.q, 0.5 * h * vm), vm
        r = h * self.balance(at, (self.v - s.v) / h, Weights(1.0, h / 2, h * h / 4))
        ev = self.ev

        slip = 2 * (ev.jacobian.times(vm) + ev.constraint_rate()) if system.n_lam else np.zeros(0)

        touching = None if self.rows is None else (self.rows, self.openings)
        dv, dlam = self.changes(touching, (r, slip), 1.0)

        self.lam = self.lam + dlam / h
        self.v = self.v + dv
        size = max(system.max_abs(self.v), system.max_abs(s.v), 1e-6 * system.length / self.span)
        return system.max_abs(dv) / (1e-4 * p.newton.tolerance * size)
