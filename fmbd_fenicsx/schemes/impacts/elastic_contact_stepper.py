"""Steppers of elastic contact, whose steps are many in one call of compiled code.

A step that this does not find is made in Python. Who makes a step depends on the state alone, and no result on how many were
asked for at once.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, TypeVar

import numpy as np

from ...linear.blocks.field_blocks import Weights
from ...linear.driver_solver import FieldDriverSolver
from ...rotations import Array
from ...system.compiled import march as slots
from ...system.layout import State
from ...system.serialisation import plain
from ..marching import lend_newton, make_steps, take_newton
from ..stepping import UNOBSERVED, Observers
from .contact_stepper import ContactStepper
from .elastic_step import Confirmed, ElasticStep, is_smooth

if TYPE_CHECKING:
    from ...system.compiled.tape import Openness, Tape
    from .compiled.elastic_contact import ContactMarch


COMPILED = "compiled; NumPy for the start and for steps it gives back"
MADE_AGAIN = 4  # times that a step is made at most, with the points that it brings through a surface
THROUGH = 1e-9  # lengths of the model behind a surface
Step = TypeVar("Step", bound=ElasticStep)


class ElasticContactStepper(ContactStepper):
    """A scheme says how its steps are called (``maker``), and what they are made by."""

    maker: ClassVar[str]
    keeps_memories = True

    share: float  # of a step, at which its forces act
    keeps: ClassVar = {**ContactStepper.keeps, "marched": plain(), "confirmed": plain(Confirmed)}
    confirmed: Confirmed | None = None  # what the last step tells of later ones
    marched: int = 0  # steps
    _size: float  # s, of the steps that are asked for
    _march: ContactMarch | None = None
    _began: State | None = None  # where the newest step of a call began
    _refused: State | None = None  # from where on no step was found

    # -- what a scheme says -------------------------------------------------------------------------------------------------
    def _weights(self, h: float) -> Weights:
        """Of the matrix of a step of size h (s)."""
        raise NotImplementedError

    def _room(self) -> Array:
        """What its steps are made by, in front of the room to work in."""
        return np.zeros(0)

    def _lend(self, march: ContactMarch, h: float) -> None:
        """Write into the march what steps of size h (s) are made by."""

    def _algorithmic(self) -> Array:
        """Algorithmic accelerations of the state."""
        return np.zeros_like(self.state.v)

    def _take_own(self, march: ContactMarch, made: int, h: float) -> None:
        """Take from the newest states what it keeps, after so many steps of size h (s)."""

    @cached_property
    def smooth(self) -> bool:
        """As :func:`.is_smooth` of the system."""
        return is_smooth(self.system)

    # -- steps --------------------------------------------------------------------------------------------------------------
    def _solved(self, h: float, near: np.ndarray, make: Callable[[np.ndarray], Step]) -> tuple[Step, int]:
        """A step of size h (s) with the candidates that are ``near``, (m,) bool, and its iterations. Points that it would bring
        through a surface join in.
        """
        for _ in range(MADE_AGAIN):
            step = make(near)
            iterations = step.solve()
            gap = self.contacts.touch(self.system, self.state.t + h, step.q).gap
            missed = (gap < -THROUGH * self.system.length) & ~near
            if not missed.any():
                break
            near = near | missed
        return step, iterations

    @cached_property
    def marches(self) -> bool:
        """Whether compiled code makes steps."""
        driver = self.solver.driver
        if not isinstance(driver, FieldDriverSolver) or self.problem is None:
            return False
        looks = driver.told.tables.looks
        return looks.energies_known and not looks.stores and self._sees_surfaces

    @property
    def _sees_surfaces(self) -> bool:
        """Whether compiled code has room for the functions on facets that face others."""
        facing = [pair for pair in self.contacts.pairs if pair.searches]
        if not facing:
            return True
        from .compiled.facets import is_known

        return all(map(is_known, facing))

    def stride(self, h: float) -> float:
        """As :meth:`TimeStepper.stride`."""
        self._size = h
        return h if self._may_march else 0.0

    def _march_for(self, h: float) -> ContactMarch | None:
        """The march with the factors of steps of size h (s)."""
        driver = self.solver.driver
        assert isinstance(driver, FieldDriverSolver)
        self.solver.weights = self._weights(h)  # whose factor a run has that goes on from a checkpoint
        states = driver.of_steps(self.state, self.solver.weights)
        if states is None:
            return None
        if self._march is None or self._march.tables is not states.tables:
            from .compiled.elastic_contact import ContactMarch

            twin, head = states.tables.system, self._room()
            room = len(head) + 6 * twin.n_v + 2 * twin.n_q + 6 * twin.n_lam
            self._march = ContactMarch(self, states, room)
            self._march.room[: len(head)] = head
        return self._march

    @property
    def origin(self) -> State:
        """As :meth:`TimeStepper.origin`."""
        assert self._began is not None
        return self._began

    def tape(self, judged: Openness) -> Tape | None:
        """As :meth:`TimeStepper.tape`, where a march may begin."""
        march = self._march_for(self._size) if self._may_march else None
        return None if march is None else march.tape(judged)

    @property
    def _may_march(self) -> bool:
        """Whether compiled code may make the next step."""
        return self.marches and self._refused is not self.state

    def march(self, h: float, steps: int, observers: Observers = UNOBSERVED) -> int:
        """As :meth:`TimeStepper.march`, up to one that is Python's."""
        s = self.state
        march = self._march_for(h) if self._may_march else None
        if march is None:
            self._refused = s
            return 0

        lend_newton(march.parameters, self.system, self.newton)
        self._lend(march, h)
        driver = self.solver.driver
        assert driver is not None
        driver.begin_steps(s)
        march.load([(s.t, s.q, s.v, s.a, self._algorithmic(), s.lam)])
        march.around.begin(self, march.ring.own())
        made, verdict = make_steps(march, h, steps, self.newton, observers, contact=march.around.address)
        driver.end_steps(None)
        march.calls.forget_error()  # a step in Python meets it again

        if made:
            march.tables.remember()
            self._began = s if made == 1 else march.state(1)
            self._take(march, made, h)
        if verdict:
            self._refused = self.state
        return made

    def _take(self, march: ContactMarch, made: int, h: float) -> None:
        """The newest state, the books and what was counted."""
        p, s = march.parameters, march.state()
        self._take_own(march, made, h)
        take_newton(p, self.newton, made)
        self.local_error, self.marched = float(p[slots.LOCAL]), self.marched + made
        self.state = march.around.end(self, s, march.ring.own())

    @property
    def path(self) -> str:  # type: ignore[override]
        """As :attr:`TimeStepper.path`."""
        return COMPILED if self.marches else ContactStepper.path

    @property
    def counters(self) -> dict[str, float]:
        """With the number of compiled steps."""
        return {**super().counters, "compiled_steps": float(self.marched)}
