"""What a run asks of a time stepper, with what holds for one that says nothing.

A scheme is data; its ``stepper(system, solver, newton, state)`` makes one of these from a consistent state. A stepper of a
user's own derives from :class:`TimeStepper` and has to say how it advances; all else has a default.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Any, Protocol

from ..answers import answered_by
from ..errors import InputError, require
from ..system.compiled.choice import use_driver
from ..system.evaluation import Evaluation
from ..system.layout import State, States
from ..system.serialisation import Remembering
from .declared import Declared

if TYPE_CHECKING:
    from ..system.compiled.kept import KeptSteps
    from ..system.compiled.march import JointLimits
    from ..system.compiled.tape import Openness, Tape


class EnergyJudge(Protocol):
    """Who judges the energy of every state: ``limits``, which compiled steps compare with and move on."""

    limits: tuple[float, ...]


class JointJudge(Protocol):
    """Who judges the joints of every state."""

    def limits(self, h: float) -> JointLimits:
        """By what states of compiled steps of size h (s) are judged."""

    def passed(self, t: float, fastest: float) -> None:
        """Compiled steps up to time t (s) have passed, with this largest speed (m/s)."""


@dataclass(frozen=True)
class Observers:
    """Who sees every state of steps that are made in one call: judges, and the ``tape`` that records them.

    ``energy`` judges the energy, ``joints`` how open these are, where the scheme does not see to them; ``samples``: controllers
    may be due at the end of the last step.
    """

    energy: EnergyJudge | None = None
    joints: JointJudge | None = None
    tape: Tape | None = None
    samples: bool = False


UNOBSERVED = Observers()


class TimeStepper(Remembering):
    """Advances a state in time. Methods are collective.

    Attributes:
        state: the newest state; who sets it takes a step back.
        local_error: the scheme's own indicator of the error of its last step (m, rad).
        counters: work so far and statistics, name -> number, for the report.
        path: who makes the steps, for the report.
        compiled_whole: its steps are compiled from end to end, and ask for no evaluations.
        longest, ends, last: the most that a step of :meth:`march` may be, when steps have to end, and until when they may begin
            (s), see :meth:`bound`.
        passes_marks: steps of one :meth:`march` hit all ends up to the last one.
        forces_within: forces at the ends of steps tell the states between.
        keeps_memories: it moves the memory of elements on by itself, see :meth:`note`.
        recorded: the highest derivative of the motion that somebody reads, 2: accelerations and multipliers.
        struck: instants (s) of impacts that happened at their own times, the newest of many.
        gives_up: a step that compiled code does not find is found by nobody: it ends the run.
        keeps: what a checkpoint holds of it, see :class:`~fmbd_fenicsx.system.serialisation.Remembering`.
    """

    state: State
    local_error: float = 0.0
    path: str = "NumPy"
    compiled_whole: bool = False
    longest: float = inf
    ends: Sequence[float] = (-inf,)
    last: float = inf
    passes_marks: bool = False
    forces_within: bool = False
    keeps_memories: bool = False
    recorded: int = 0
    gives_up: bool = False
    struck: Sequence[float] = ()

    @property
    def counters(self) -> dict[str, float]:
        """Nothing is counted."""
        return {}

    @property
    def evaluation(self) -> Evaluation | None:
        """The system in the newest state, where it is known."""
        return None

    def told(self, state: State) -> State:
        """A state in the newest step as whoever keeps it is told of it: with accelerations and multipliers as accurate as
        those that sensors read, also where none does (:attr:`recorded`); collective.
        """
        return state

    def advance(self, h: float) -> State:
        """One step of size h (s), with error control of at most h; returns the new state, which is ``self.state`` then.

        Raises:
            ConvergenceError: the step fails. The stepper is made anew before a smaller one.
        """
        raise NotImplementedError(f"{_kind(self)} has no advance(h).")

    def restart(self, t: float) -> None:
        """Go on behind a jump of forces at t (s)."""
        raise InputError(f"{_kind(self)} cannot go on behind a jump of forces: give it a method restart(t).")

    def begin_anew(self, start: Callable[[], State]) -> bool:
        """Go on from the consistent state that ``start`` finds as a stepper does that was just made; whether it can. Tables, room
        and factors that it holds serve on.
        """
        return False

    def bound(self, longest: float, ends: Sequence[float], last: float = inf) -> None:
        """Of steps under error control: none of the next march is to be longer than that, and some have to end then, s, rising;
        the march ends with the last of these, and begins no step later than ``last``.
        """
        self.longest, self.ends, self.last = longest, ends, last

    @property
    def until(self) -> float:
        """When the next step has to have ended, s."""
        return self.ends[0]

    def to_come(self, limit: float) -> float:
        """How long steps under error control, the first of at most ``limit``, go on before something may break, s: velocities
        that are reached by then measure errors, whatever instants are hit on the way and however long a step may be.
        """
        return max(limit, self.ends[-1] - self.state.t)

    def march(self, h: float, steps: int, observers: Observers = UNOBSERVED) -> int:
        """Up to so many steps in one call; how many were made. None here: they are made one by one."""
        return 0

    def stride(self, h: float) -> float:
        """Size (s) of the steps that :meth:`march` would make next, with error control of at most h; 0: it makes none."""
        return h if type(self).march is not TimeStepper.march else 0.0

    def step_back(self) -> None:
        """Go back to the beginning of the newest of the steps that :meth:`march` has made under error control."""
        raise InputError(f"{_kind(self)} has no step_back().")

    def tape(self, judged: Openness) -> Tape | None:
        """Room for the records of :meth:`march`; None: it has none."""
        return None

    def note(self) -> bool:
        """Take the memory of elements to the newest state; whether that was done."""
        return False

    @property
    def origin(self) -> State:
        """The state that the last step of :meth:`march` began with, for those that have a tape."""
        raise NotImplementedError(f"{_kind(self)} has no origin.")

    @property
    def earlier(self) -> State | None:
        """The state that the newest of the steps that :meth:`march` has made began with; None where it is not known."""
        return None

    @property
    def kinks(self) -> tuple[float, ...]:
        """Times (s) within the last step at which velocities may jump."""
        return ()

    def between(self, t: float) -> State | None:
        """The state at a time t (s) within the last step; None: a cubic through its ends has to do."""
        return None

    def within(self, steps: KeptSteps) -> States:
        """The states at instants of steps that :meth:`march` has kept on its tape, of all at once."""
        raise NotImplementedError(f"{_kind(self)} keeps no steps.")


@answered_by(
    "stepper",
    "path struck passes_marks forces_within kinks origin earlier told between within bound restart note stride tape step_back",
)
class Around(TimeStepper):
    """A stepper around another one, ``stepper``, which answers what this one does not say itself."""

    stepper: TimeStepper

    @property
    def state(self) -> State:  # type: ignore[override]
        """The state of the stepper."""
        return self.stepper.state

    @state.setter
    def state(self, state: State) -> None:
        self.stepper.state = state


def made_stepper(scheme: Any, *given: Any, gives_up: bool = False) -> TimeStepper:
    """The stepper of a scheme from (system, solver, newton, consistent state); ``gives_up``: see :class:`TimeStepper`. From now
    on compiled code evaluates the system, where it knows all of it and the scheme does not say otherwise.

    Raises:
        InputError: a user's own scheme made something else.
    """
    made = scheme.stepper(*given)
    require(
        isinstance(made, TimeStepper),
        f"{_kind(scheme)}.stepper(...) must give a time stepper: let {_kind(made)} derive from fmbd.schemes.TimeStepper, see "
        "docs/contributing.md.",
    )
    if not made.compiled_whole and Declared.by(scheme).compiled:
        # schemes in Python ask for evaluations: compiled code gives them
        use_driver(given[0])
    made.gives_up = gives_up
    return made  # type: ignore[no-any-return]


def _kind(x: Any) -> str:
    return f"{type(x).__module__}.{type(x).__qualname__}"
