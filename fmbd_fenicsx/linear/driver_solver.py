"""Solutions by the driver: the matrix of a state that it evaluated is factored and solved there, and not in NumPy.

Only where the rows do not depend on each other, which the first factor tells or a closer look, or where that has found that
they do: multipliers are the smallest then.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import cached_property
from typing import Any, TypeGuard

from ..rotations import Array
from ..system.compiled.choice import solves
from ..system.compiled.states.driver_evaluation import DriverEvaluation
from ..system.compiled.states.evaluation import DriverStates
from ..system.compiled.states.explicit import ExplicitStates
from ..system.compiled.states.field_states import FactoredFieldStates, FieldStates
from ..system.compiled.states.means import MeanStates
from ..system.evaluation import Evaluation
from ..system.layout import State, States
from ..system.system import System
from .blocks.field_blocks import FactoredField, FieldBlocks, Weights
from .configuration_warnings import dependent_rows, note_dependent_rows
from .core import CoreSolver

MASSES = Weights(1.0, 0.0, 0.0)


class DriverSolver:
    """Of one :class:`~.condensation.StepSolver`; ``ready``: the matrix prepared last is the driver's."""

    blocks: list[FactoredField] = []  # factors of elastic fields in that matrix

    def __init__(self, states: DriverStates, core: CoreSolver) -> None:
        """``core``: NumPy's, which knows where rows depend on each other."""
        self.states, self.core = states, core
        self.explicit = ExplicitStates(states)
        self.ready = False
        self.usable: bool | None = None  # None: nothing was looked at so far
        self._counted = self._before = 0
        self._weights = MASSES  # of the matrix prepared last

    def prepare(self, ev: Evaluation, weights: Weights, *, sways: bool = True) -> bool:
        """Factor the matrix of a state; False where NumPy has to. ``sways``: whether solutions correct moments of fields that
        columns of inertia leave out.
        """
        self.ready = False
        hopeless = self.usable is False and not self.core.redundant
        if hopeless or weights.cm != 1.0 or not self._takes(weights) or not self._evaluated(ev):
            return False
        if not weights.real and self.usable is None:  # rows are looked at with the masses
            self._usable_at(ev.t, ev.q, ev.alone[2][0])
        self._choose(ev, weights)
        self.states.sway(sways)
        self._weights = weights
        self._look_at(ev)
        self.ready = self._solves() and self.states.factor.prepare(ev, weights.cd, weights.ck)
        return self.ready

    def holds(self, ev: Evaluation, weights: Weights) -> bool:
        """Whether the matrix prepared last is this one."""
        return self._evaluated(ev) and weights == self._weights and self.states.factor.holds(ev, weights.cd, weights.ck)

    def _takes(self, weights: Weights) -> bool:
        """Whether the driver makes matrices of these."""
        return weights.real

    def _evaluated(self, ev: Evaluation) -> TypeGuard[DriverEvaluation]:
        """Whether a state is the driver's."""
        return self.states.evaluated(ev)

    def _choose(self, ev: DriverEvaluation, weights: Weights) -> None:
        """Take the tables that make a matrix: of systems without fields all serve."""

    def _look_at(self, ev: DriverEvaluation) -> None:
        """Find whether rows do not depend on each other, which the first state tells."""
        if self.usable is None:
            factor = self.states.factor
            factored = not self.core.redundant and factor.prepare(ev, 0.0, 0.0)
            while not (factored or self.core.redundant) and self.states.unlock():
                factored = factor.prepare(ev, 0.0, 0.0)
            self.usable = factored and (factor.independent() or not dependent_rows(ev)[1])
            if self.usable:
                note_dependent_rows(ev, (0, 0))

    def _solves(self) -> bool:
        """Whether the driver solves: rows do not depend on each other, or are known to, for the smallest multipliers then."""
        if not self.usable and self.core.redundant:
            self.states.let_depend(self.core.redundant)
        return bool(self.usable or self.core.redundant)

    def _usable_at(self, t: float, q: Array, v: Array) -> bool:
        """Whether one call finds all; the state is evaluated where nothing is known so far."""
        if self.usable is None:
            self._look_at(self.states.at(t, q, v))
        return self._solves()

    def one_call(self, t: float, q: Array, v: Array) -> ExplicitStates | None:
        """Who finds all in one call, from a state on; None where it has to be found in parts. Nothing is prepared then."""
        usable, self.ready = self._usable_at(t, q, v), False
        return self.explicit if usable else None

    def accelerations(self, t: float, q: Array, v: Array) -> tuple[Array, Array] | None:
        """a and lambda of a consistent state in one call; None as above."""
        explicit = self.one_call(t, q, v)
        found = None if explicit is None else explicit.accelerations(t, q, v)
        self.ready, self._weights = found is not None, MASSES
        return found

    def idle(self) -> AbstractContextManager[None]:
        """Between steps: tables that they have taken are the solver's meanwhile."""
        return self.states.back() if self.states.taken else nullcontext()

    def least(self, t: float, q: Array, lam: Array) -> Array | None:
        """Of multipliers (k, n_lam) of rows that depend the smallest with the same forces, in one call; None as above.

        Nothing is prepared then.
        """
        self.ready = False
        if self.states.system.fields:
            return None
        self.states.let_depend(self.core.redundant)
        return self.explicit.least(t, q, lam)

    def closed(self, t: float, q: Array, v: Array, metric: Weights = MASSES) -> tuple[Array, Array] | None:
        """q and v on the constraints in one call, by the least motion in a metric; None as above. Nothing is prepared then."""
        if self.one_call(t, q, v) is None or metric.cm != 1.0 or not metric.real:
            return None
        if metric != MASSES:
            self._choose(self.states.at(t, q, v), metric)
        return self.explicit.closed(t, q, v, metric.cd, metric.ck)

    def all_closed(self, states: States, metrics: Sequence[Weights]) -> tuple[Array, Array] | None:
        """:meth:`closed` of many states, each in a metric of its own; with fields they share one."""
        weights = self._metrics(states, metrics)
        return None if weights is None else self.explicit.all_closed(states, weights)

    def all_corrected(self, states: States, metrics: Sequence[Weights]) -> tuple[Array, Array] | None:
        """a and lambda of many states nearer to their equations, likewise."""
        weights = self._metrics(states, metrics)
        return None if weights is None else self.explicit.all_corrected(states, weights)

    def _metrics(self, states: States, metrics: Sequence[Weights]) -> list[tuple[float, float]] | None:
        """Weights of C and K in the metrics of states, which are chosen then; None where they are not the driver's."""
        first, different = states.state(0), {id(metric): metric for metric in metrics}.values()  # many share a few
        if self.one_call(first.t, first.q, first.v) is None:
            return None
        if not all(metric.cm == 1.0 and metric.real for metric in different):
            return None
        if self.states.system.fields and any(metric != metrics[0] for metric in different):
            return None
        if metrics[0] != MASSES:
            self._choose(self.states.at(first.t, first.q, first.v), metrics[0])
        return [(metric.cd, metric.ck) for metric in metrics]

    def arrived(self, t: float, q: Array, v: Array, *, places: bool) -> State | None:
        """The state on the constraints next to q and v in one call, as ExplicitStates; None as above. Fields take new factors."""
        explicit = self.one_call(t, q, v)
        found = None if explicit is None or self.states.system.fields else explicit.arrived(t, q, v, places=places)
        self.ready, self._weights = found is not None, MASSES
        return found

    def whole_steps(self, state: State) -> DriverStates | None:
        """With whose tables whole steps are made from a state on, fields with the factors of their masses; None as above."""
        usable = not self.states.taken and self._usable_at(state.t, state.q, state.v)
        return self.states if usable else None

    def begin_steps(self, state: State) -> bool:
        """Steps from a state begin, which take the factor; whether it is that of the masses there."""
        states, self.ready = self.states, False
        known = states.factor.holds_masses(state.t, state.q)
        states.factor.hold(None)
        self._before = int(states.tables.c.factors)
        return known

    def end_steps(self, state: State | None) -> None:
        """They have ended in a state, with the factor of the masses there; None: of something else."""
        self.states.factor.count += int(self.states.tables.c.factors) - self._before
        self.ready, self._weights = state is not None, MASSES
        if state is not None:
            self.states.factor.hold(state.t, state.q, state.v, new=False)

    @cached_property
    def _means(self) -> MeanStates:
        """Made where a scheme asks for it."""
        return MeanStates(self.states)

    def means(self, state: State, h: float) -> MeanStates | None:
        """Who makes a step of size h (s) of the energy-momentum scheme from a state; None as above. Nothing is prepared then."""
        return None if self.one_call(state.t, state.q, state.v) is None else self._means

    def new_factors(self) -> int:
        """Factorisations since the last call."""
        new, self._counted = self.states.factor.count - self._counted, self.states.factor.count
        return new

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """Increment like v and multipliers (n_lam,) for right-hand sides b and c."""
        return self.states.factor.solve(b, c)

    def answers(self, core: Array, seen: list[Array]) -> tuple[Array, list[Array]]:
        """Of the core, and of the columns of fields, to forces on both: as DriverStates."""
        return self.states.factor.answers(core, seen)

    def closing(self, C: Array) -> Array:
        """Motions (n_v, k) that open the rows by the columns C (n_lam, k)."""
        return self.states.factor.closing(C)


class FieldDriverSolver(DriverSolver):
    """The same with elastic fields: tables with the factors of a size of step, which the runs of a system share."""

    def __init__(self, states: FieldStates, core: CoreSolver, elastic: FieldBlocks, place: int) -> None:
        """``states``: those that are asked for; ``elastic``: the factors of fields; ``place``: of complex matrices."""
        super().__init__(states, core)
        self.told, self.elastic, self.place = states, elastic, place
        self._made: MeanStates | None = None
        self._of_means = 0  # factorisations of it that are counted
        self._chosen_for: Weights | None = None  # what the blocks are for, and
        self._versions: list[tuple[Any, Any]] = []  # of tangents and columns in the matrix prepared last

    def holds(self, ev: Evaluation, weights: Weights) -> bool:
        """Whether the matrix prepared last is this one, by the same tangents; another solver may have used the tables since."""
        same = self.told.factored_by(self.blocks) and super().holds(ev, weights)
        return same and self._versions == self.elastic.versions(ev.t)

    def _takes(self, weights: Weights) -> bool:
        return True

    def _evaluated(self, ev: Evaluation) -> TypeGuard[DriverEvaluation]:
        return self.told.evaluated(ev)

    def _choose(self, ev: DriverEvaluation, weights: Weights) -> None:
        """Give the tables the factors of a size of step."""
        versions = self.elastic.versions(ev.t)
        if (weights, versions) != (self._chosen_for, self._versions) or not self.elastic.used_last(self.blocks):
            self.blocks = self.elastic.of(ev.jacobian, weights, ties_apart=False, splits=False)
            self._chosen_for, self._versions = weights, versions
        found = self.told.factored(self.blocks, self.place)
        if found is not self.states:
            self._counted += found.factor.count - self.states.factor.count
            self.states, self.explicit = found, ExplicitStates(found)

    def _usable_at(self, t: float, q: Array, v: Array) -> bool:
        if self.usable is not False or self.core.redundant:
            self._choose(self.told.at(t, q, v), MASSES)
        return super()._usable_at(t, q, v)

    def means(self, state: State, h: float) -> MeanStates | None:
        """As above, with the factors of a step of size h (s), whose matrix is M + h D / 2 + h^2 K / 4."""
        self.ready = False
        if self.usable is None:
            self._usable_at(state.t, state.q, state.v)
        if not self.usable and not self.core.redundant:
            return None
        ev, weights = self.told.at(state.t, state.q, state.v), Weights(1.0, 0.5 * h, 0.25 * h * h)
        states = self.told.of_steps(self.elastic.beside(ev.jacobian, weights))
        if not self.usable:
            states.let_depend(self.core.redundant)
        states.tables.renewed = lambda *_: self._renewed(states, ev, weights)
        if self._made is None or self._made.states is not states:
            self._made = MeanStates(states)
        return self._made

    def of_steps(self, state: State, weights: Weights) -> DriverStates | None:
        """With whose tables steps with the matrix of these weights are made from a state on; None where NumPy has to make
        them. Nothing is prepared then.
        """
        self.ready = False
        if self.usable is False and not self.core.redundant:
            return None
        ev = self.told.at(state.t, state.q, state.v)
        self._choose(ev, weights)
        self._look_at(ev)
        solves = self._solves()
        self.states.sway(True)
        return self.states if solves else None

    def new_factors(self) -> int:
        """As above, those of steps of the energy-momentum scheme too."""
        now = 0 if self._made is None else self._made.states.factor.count
        new, self._of_means = now - self._of_means, now
        return new + super().new_factors()

    def _renewed(self, states: FactoredFieldStates, ev: DriverEvaluation, weights: Weights) -> list[FactoredField]:
        """Factors with new tangents of the fields where a step of the energy-momentum scheme begins.

        At the mean displacements of its middle a body that turns is pressed, and its end may be far off still.
        """
        for field in states.tables.fields:
            if field.part.renewable:
                motion, *_ = field.motion.at(ev.t + 0.5 * states.tables.c.span)
                field.part.part.relinearise(motion, ev.local(field.k))
        states.blocks = self.elastic.beside(ev.jacobian, weights)
        return states.blocks


def driver_solver(system: System, core: CoreSolver, elastic: FieldBlocks | None, place: int) -> DriverSolver | None:
    """Solutions by the driver, where it evaluates a system and knows how to solve for it.

    ``core``, ``elastic``, ``place``: of the same solver; None for fields that are not eliminated by factors of their own.
    """
    states = system.evaluator
    if isinstance(states, FieldStates):
        return None if elastic is None else FieldDriverSolver(states, core, elastic, place)
    return DriverSolver(states, core) if solves(states) else None
