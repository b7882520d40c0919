"""Times at which values are asked for, within the steps of a run, and the states there.

A scheme whose steps are polynomials gives their values (:meth:`.TimeStepper.between`). Otherwise positions follow the cubic
through the ends with their velocities, and all else parabolas (:mod:`...schemes.dense_output`), all of at least second
order in the step. Contact forces are those of the step: the mean over it; gaps are those of the places.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...rotations import Array
from ...schemes import dense_output
from ...schemes.stepping import TimeStepper
from ...system.compiled.kept import KeptSteps
from ...system.layout import State, States
from ...system.serialisation import Memory
from ...system.system import System


def state_between(
    system: System, ends: tuple[State, State], t: float, stepper: TimeStepper, *, earlier: State | None = None
) -> State:
    """The state at a time t (s) between two ends of a step, that the ``stepper`` made; ``earlier``: the one that the step
    before began with, where forces are smooth.
    """
    before, after = ends
    found = stepper.between(t) if stepper.state is after else None
    if found is None:
        found = dense_output.within(system, before, after, t, earlier)
    contact = getattr(found, "contact", None)
    if contact is None:
        return found
    from ...system.sensors.contact import ContactState, reads_gaps

    assert isinstance(found, ContactState)
    if not reads_gaps(system):
        return found
    return replace(found, contact=replace(contact, gap=system.contacts.gaps_in(system, [found])[0]))


def states_within(steps: KeptSteps, stepper: TimeStepper, roundoff: float) -> States:
    """The states at the instants of steps that a march of the ``stepper`` has kept; ends of steps, but for so much roundoff (s),
    as they are. Collective.
    """
    inside = steps.t[:, 0] < steps.after.t[:, 0] - roundoff
    if inside.all():
        return stepper.within(steps)
    found = steps.after
    if inside.any():
        found.put(inside, stepper.within(steps.chosen(inside)))
    return found


class Instants:
    """Those that are still to be recorded, ``left`` (s), and where the step began that they are looked for in.

    ``rounding``: by how much instants may differ that are the same, s.
    """

    def __init__(self, system: System, left: Array, rounding: float) -> None:
        self.system, self.left, self.rounding = system, left, rounding
        # the end of the last step, its number, and the state that this began with where forces are smooth since then
        self._before: State | None = None
        self.earlier: State | None = None
        self._number, self._smooth = -1, True

    def begin_step(self, n: int, before: State, earlier: State | None) -> None:
        """Step n began in a state, the step before in an ``earlier`` one."""
        self._number, self._before, self.earlier = n - 1, before, earlier

    def go_on(self, state: State) -> None:
        """The next step begins in another state than the last one ended in: behind a jump of forces."""
        self._before, self.earlier = state, None

    def sample(self) -> None:
        """Forces jump within the step under way."""
        self._smooth = False

    def end_step(self, n: int, state: State, stepper: Any) -> None:
        """Step n has ended in a state."""
        began = self._before if n == self._number + 1 else stepper.earlier
        self.earlier, self._before, self._number = began if self._smooth else None, state, n
        self._smooth = True

    def passed(self, last: float) -> list[float]:
        """Take those up to the ``last`` time (s)."""
        count = int(np.searchsorted(self.left, last, side="right"))
        taken, self.left = self.left[:count], self.left[count:]
        return [float(t) for t in taken]

    def state(self, t: float, end: State, stepper: TimeStepper) -> State:
        """The state at a time t (s) on the way to the ``end`` of the step; collective."""
        if abs(t - end.t) <= self.rounding or self._before is None:
            return end
        return state_between(self.system, (self._before, end), t, stepper, earlier=self.earlier)

    def remember(self, m: Memory, recorded: float) -> None:
        """What is left, and where the last step began; of those that are asked for now, as where a run goes on for longer,
        what is behind it and behind the newest time ``recorded`` (s).
        """
        asked, kept = self.left, np.array(m("left", self.left.tolist()), dtype=float)
        self._before, earlier = m.state("before", self._before), m.state("earlier", self.earlier)
        reached = recorded if self._before is None else max(recorded, self._before.t)
        self.left = np.union1d(kept, asked[asked > reached + self.rounding])
        self.earlier = None if earlier is None or earlier.t is None else earlier
        self._number, self._smooth = m("number", (self._number, self._smooth))
