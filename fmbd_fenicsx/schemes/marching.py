"""Steppers whose steps are calls of compiled code: one step in a call, or many between two records (driver/marches/march.c).

A step that compiled code does not find is made in parts, by the scheme in Python, from the same beginning, which says what is
wrong with it; one whose end does not pass is made once more by itself, for those who judge steps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ..errors import PartsError, StabilityError
from ..linear.condensation import StepSolver
from ..rotations import Array
from ..system.compiled import march as slots
from ..system.compiled.march import March
from ..system.compiled.states.evaluation import DriverStates
from ..system.compiled.tables.resting import Twin
from ..system.compiled.tape import on_the_way
from ..system.layout import State, States
from ..system.system import System
from .dense_output import within
from .newton import Newton
from .stepping import UNOBSERVED, Observers, TimeStepper

if TYPE_CHECKING:
    from ..system.compiled.kept import KeptSteps
    from ..system.compiled.tables.tables import Tables
    from ..system.compiled.tape import Openness, Tape
    from .onestep.explicit_limit import StepLimit

COMPILED = "compiled (all bodies, joints and forces in C; NumPy for the start and for steps it gives back)"
ACCOUNT = [slots.FEWEST, slots.WASTED, slots.BEGIN_ANEW, slots.WAIT]
AGAIN = (slots.GAIN, slots.DOUBT)  # after these the same step is found once more, by itself


def lend_newton(p: Array, system: System, newton: Newton) -> None:
    """Write Newton's settings, for a system, into the parameters of compiled steps."""
    p[slots.TOL], p[slots.LENGTH] = newton.tolerance, system.length
    p[slots.FLOOR], p[slots.CEILING] = newton.small(system, 0.0), newton.small(system, np.inf)
    p[slots.SLOW], p[slots.MAXIT], p[slots.NEW_TANGENT] = newton.slow, newton.max_iterations, newton.patience


def take_newton(p: Array, newton: Newton, steps: int) -> None:
    """Take note of the iterations that so many compiled steps have made, and of the rate of the last one."""
    newton.iterations += int(p[slots.ITERATIONS])
    newton.note(float(p[slots.LEFT]), steps)
    newton.theta = float(p[slots.THETA])
    newton.account.numbers = list(p[ACCOUNT])


def make_steps(
    march: March,
    h: float,
    count: int,
    newton: Newton,
    observers: Observers,
    *,
    most: float = np.inf,
    **lent: int | None,
) -> tuple[int, int]:
    """Up to so many steps of size h (s) from what the march has loaded, up to a state faster than ``most`` (m/s), under those who
    see them; the number made, and the verdict of the one that stopped them. ``lent``: addresses, as of :meth:`.March.steps`.
    """
    p, energy, joints = march.parameters, observers.energy, observers.joints
    energies = slice(slots.HIGHEST, slots.SETTLING + 1)
    p[slots.H], p[slots.THETA], p[slots.GUARDED] = h, newton.theta, energy is not None
    p[ACCOUNT] = newton.account.numbers
    if energy is not None:
        p[energies] = energy.limits
    if joints is not None:
        march.judge(joints.limits(h), most)

    march.tables.recall()
    made, verdict = march.steps(count, observers.tape, judged=joints is not None, **lent)

    if made and energy is not None:
        energy.limits = tuple(p[energies])
    if made and joints is not None:
        joints.passed(march.ring.state().t, float(march.closed.fastest))
    return made, verdict


class CompiledSteps(TimeStepper):
    """Of steppers with compiled steps: what these count, and where one was given back, which NumPy makes then."""

    keeps_memories = True
    newton: Newton
    _refused: tuple[State, float] | None = None  # from where on, and of which size (s)
    # where a step made alone has ended, with whose tables, and the memories there
    _alone: tuple[Array, Tables, list[Any]] | None = None

    def _refuse(self, h: float) -> None:
        """Take note that compiled code has found no step of this size from the state on; raises PartsError where it gives up."""
        if self.gives_up:
            raise PartsError(f"t = {self.state.t:g} s: no step of {h:g} s was found at once; smaller ones cost less.")
        self._refused = self.state, h

    def _is_refused(self, h: float) -> bool:
        """Whether it was, from this state."""
        return self._refused is not None and self._refused[0] is self.state and self._refused[1] == h

    def _step_ended(self, tables: Tables) -> None:
        """A step was made alone: until it is accepted, elements are asked with the memory of the one before."""
        self._alone = self.state.q, tables, tables.memories()

    def note(self) -> bool:
        """As :meth:`TimeStepper.note`: what compiled code has made of the memories, as it does in many steps."""
        if self._alone is None:
            return False
        q, tables, memories = self._alone
        if q is not self.state.q:
            return False
        if tables.sampled:  # a new sample is a jump, which who called has to know
            tables.remember_within(memories, "PID")
            return False
        tables.remember(memories)
        return True

    def _count_increments(self, p: Array, steps: int) -> None:
        """Take note of Newton's iterations in so many steps."""
        take_newton(p, self.newton, steps)


class MarchingStepper(CompiledSteps):
    """A scheme says how it is called (``maker``) and what it keeps with a state beside the state itself."""

    maker: ClassVar[str]

    system: System
    solver: StepSolver

    limit: StepLimit | None = None  # of explicit schemes
    staged: ClassVar[bool] = False  # whether its steps are a unit by itself, with the stages of implicit schemes
    leaves_masses: ClassVar[bool] = True  # whether the factor at the end of a step is that of the masses there
    _used: March | None = None
    _began: State | None = None  # where the newest step of a call began

    # -- what a scheme says -------------------------------------------------------------------------------------------------
    def _room(self, states: DriverStates) -> int:
        """How many numbers its steps need to work in."""
        raise NotImplementedError

    def _prepare_room(self, room: Array, *, alone: bool) -> None:
        """Write into it what its steps are made by; ``alone``: one step, of which the scheme says by itself what is doubtful."""

    def _own(self, *, factored: bool) -> Array:
        """What it keeps with the last states, (k, numbers), the newest first; ``factored``: whether the masses are, there."""
        raise NotImplementedError

    def _in_one_call(self, h: float) -> bool:
        """Whether steps of size h (s) may be calls now."""
        return True

    def _free(self, h: float) -> tuple[float, float]:
        """How many steps of size h (s), or of at most that, may be made from the state on, and up to which speed (m/s);
        collective. Raises StabilityError where it is too long.
        """
        return (np.inf, np.inf) if self.limit is None else self.limit.free(self.state, h)

    def _left(self, h: float, begun: float) -> float:
        """Size (s) of the next steps of a call for steps of h since ``begun`` (s), or the most that all may take."""
        return h

    def _take_march(self, march: March, made: int) -> None:
        """Take from the newest states what it keeps, after so many steps."""
        raise NotImplementedError

    # -- steps --------------------------------------------------------------------------------------------------------------
    def stride(self, h: float) -> float:
        """As :meth:`TimeStepper.stride`."""
        march = self._march_of() if self._in_one_call(h) else None
        looks = None if march is None else march.tables.looks
        # energies that laws in Python store are told to nobody who judges them
        return h if looks is not None and not looks.stores else 0.0

    def tape(self, judged: Openness) -> Tape | None:
        """As :meth:`TimeStepper.tape`."""
        march = self._march_of()
        return None if march is None or not on_the_way(march.tables) else march.tape(judged)

    @property
    def path(self) -> str:  # type: ignore[override]
        """As :attr:`TimeStepper.path`."""
        return TimeStepper.path if self._march_of() is None else COMPILED

    @property
    def _twin(self) -> Twin:
        """Between arrays of the system and those of its steps."""
        states = self.system.evaluator
        assert isinstance(states, DriverStates)
        return states.twin

    @property
    def origin(self) -> State:
        """As :meth:`TimeStepper.origin`."""
        assert self._began is not None
        return self._began

    @property
    def earlier(self) -> State | None:
        """As :meth:`TimeStepper.earlier`."""
        newest = self._used is not None and self._used.state().t == self.state.t  # else made in parts
        return self._began if newest else None

    def within(self, steps: KeptSteps) -> States:
        """As :meth:`TimeStepper.within`."""
        return within(self.system, steps.before, steps.after, steps.t, steps.earlier)

    def march(self, h: float, steps: int, observers: Observers = UNOBSERVED) -> int:
        """As :meth:`TimeStepper.march`; steps that fail are left to :meth:`advance`."""
        made, begun = 0, self.state.t
        while made < steps and (left := self._left(h, begun)) > 0.0:
            try:
                free, most = self._free(left)
            except StabilityError:  # whoever makes that step says so
                break

            now = self._made(left, int(min(steps - made, free)), most, observers)
            made += now
            if self.limit is not None:
                self.limit.count(now)
            if now and self._used is not None:
                self._used.tables.remember()

            if not now or self._stopped or (observers.tape is not None and observers.tape.ended):
                break
        return made

    def _step_in_one_call(self, h: float) -> bool:
        """A step of size h (s) by compiled code; whether it was found."""
        found = bool(self._made(h, 1, np.inf, UNOBSERVED))
        if found and self._used is not None:
            self._step_ended(self._used.tables)
        return found

    def _tables_of_steps(self) -> DriverStates | None:
        """With whose tables whole steps are made from the newest state on; None where steps are made in parts."""
        driver = self.solver.driver
        return None if driver is None else driver.whole_steps(self.state)

    def _march_of(self) -> March | None:
        """The march of the tables in use; None where steps are made in parts."""
        states = self._tables_of_steps()
        if states is None:
            return None
        if self._used is None or self._used.tables is not states.tables:
            size = self._own(factored=False).shape[1]
            room = self._room(states)
            library = states.implicit if self.staged else states.library
            self._used = March(library, states.tables, states.calls, self.maker, own=size, room=room)
            lend_newton(self._used.parameters, self.system, self.newton)
        return self._used

    def _made(self, h: float, count: int, most: float, observers: Observers) -> int:
        """Up to so many steps in one call, up to a state faster than ``most`` (m/s); how many were made."""
        s, self._stopped = self.state, True
        march = None if self._is_refused(h) or not self._in_one_call(h) else self._march_of()
        driver = self.solver.driver
        if march is None or driver is None:
            return 0

        self._prepare_room(march.room, alone=observers.joints is None)
        kept = self._own(factored=driver.begin_steps(s))
        march.load([(s.t, s.q, s.v, s.a, np.zeros_like(s.a), s.lam)] * len(kept))
        for i, one in enumerate(kept):
            march.ring.own(i)[:] = one

        made, verdict = make_steps(march, h, count, self.newton, observers, most=most)
        self._stopped = bool(verdict)
        driver.end_steps(march.state() if made and not verdict and self.leaves_masses else None)
        if made:
            self.state, self._began = march.state(), march.state(1)
            self._take_march(march, made)
        march.calls.forget_error()  # parts of the step meet it again
        if verdict and verdict not in (*AGAIN, slots.SIZE):
            self._refuse(h)
        return made
