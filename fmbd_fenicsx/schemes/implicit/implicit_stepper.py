"""What implicit schemes in local coordinates have in common: the equations of a step, Newton's iteration, the step control.

Steps are calls of compiled code (driver/implicit/implicit.c) where stage systems are sparse: constant ones, and those that error
control chooses (driver/marches/own_steps.c). Tangent and factors are those of the room that steps made in parts use too: whoever
comes next goes on with them. A step that fails in another way than by its error is made by Python from the same beginning, and so
is the first of a run, whose size nobody proposes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from ...linear.blocks.field_blocks import Weights
from ...linear.condensation import StepSolver
from ...linear.implicit.sparse_pencil import SparsePencil
from ...linear.redundancy import least
from ...log import log
from ...rotations import Array
from ...system.compiled import implicit as slots
from ...system.compiled.implicit import ImplicitRoom, work_of
from ...system.compiled.march import March
from ...system.compiled.states.convergence import Convergence
from ...system.compiled.states.evaluation import DriverStates
from ...system.compiled.states.stages import StageRule
from ...system.layout import State, States
from ...system.serialisation import Memory, plain, worker
from ...system.system import System
from ...system.tangents.foretold_efforts import foretold_efforts
from ..consistent import MASS, corrected, project
from ..consistent_states import all_corrected, metrics_of, projected
from ..control import Statistics, StepControl, first_step
from ..declared import Declared
from ..error_norm import EPS, worst
from ..newton import Newton
from ..own_marching import OwnMarch
from ..prescribed_ways import time_for_way
from .step_equations import step_equations
from .step_newton import StepNewton

FIRST_WAY = 0.5  # of what rtol lets a first step move, as first_step has it


class ImplicitStepper(OwnMarch):
    """Advances a consistent state by points that Newton's iteration finds; :class:`.Radau` and :class:`.BDF` derive from it.

    ``iteration``: Newton's, and ``control``, of the step size, are set by the scheme. ``slow``: rate of convergence above which
    the next step takes a tangent. ``lost``: measured, where motions begin to differ from those of rigid links.
    """

    lost: ClassVar[float] = 3e-4  # share of the forces that the roundoff of a spring's effort may have
    leaves_masses = False
    staged = True
    slow: float
    control: StepControl
    iteration: StepNewton
    keeps: ClassVar = {
        "state": Memory.state,
        **dict.fromkeys(("proposed", "local_error", "_newest_size"), plain()),
        "control": plain(StepControl),
        "stats": plain(Statistics),
        "iteration": worker,
        "norm": worker,
        "eq": worker,
    }
    _lent: ImplicitRoom | None = None
    _newest_size = 0.0  # s, of the newest step

    def __init__(self, scheme: Any, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        super().__init__(scheme, system, solver, newton, state, index=scheme.form.index)
        speed = system.max_abs(state.v)
        acceleration = max(speed * speed / system.length, system.max_abs(state.a))
        self.eq = step_equations(system, scheme.form, solver, acceleration)
        if not self.eq.dense:
            self._warn_of_roundoff(acceleration)

    def _warn_of_roundoff(self, acceleration: float) -> None:
        """Say that a spring is too stiff for Newton's iteration with one tangent for several configurations."""
        name, lost = foretold_efforts(self.system).lost(self.state.q)
        system = self.system
        weight = system.mass * max(system.gravity.size, acceleration)
        if lost > self.lost * weight > 0:  # at rest without loads nothing can be lost
            log.warning(
                'the effort of spring "%s" is known to %.1e N only, by roundoff of places times its stiffness, where forces are '
                "of %.1e N: %s may lose the motion. Take fmbd.GeneralizedAlpha(), or fmbd.distance(...) in place of the spring",
                name, lost, weight, self.scheme.name,
            )  # fmt: skip

    def _begin_from(self, state: State) -> None:
        """A consistent state, without a past; equations, room and counts stay."""
        super()._begin_from(state)
        self.iteration.forget()
        self.eq.weigh(state)

    @property
    def counters(self) -> dict[str, float]:
        """Work so far, for the counters of a run."""
        stats, eq, iteration = self.stats, self.eq, self.iteration
        stats.residuals, stats.jacobians, stats.solves = eq.residuals, eq.jacobians, iteration.judge.solves
        stats.newton_iterations, stats.factorisations = iteration.increments, iteration.factorisations
        return {**stats.as_dict(), **eq.counters}

    def _held(self, h: float, within: State) -> State:
        """A state within a step of h (s), see :meth:`_all_held`."""
        return self._all_held(np.array([h]), States.of([within])).state(0)

    def _all_held(self, h: Array, within: States) -> States:
        """States within steps of h (k,) s, on the constraints of the levels that the form holds at their ends; collective.

        What drives prescribe is no polynomial: places of a driven crank were off by a thousand times the error of the ends. Nor
        is the nearest state by the masses alone one of a stiff body, which has dents at its joints there.
        """
        levels = Declared.by(self.scheme).levels
        if 0 in levels and self.system.n_lam:
            closed = projected(self.system, within, self.solver, metrics_of(h, self._metric))
            within = closed if 1 in levels else replace(closed, v=within.v)
        if self._correctable:
            within = all_corrected(self.system, within, self.solver, metrics_of(h, self._step_metric))
        return within

    def _first_size(self, order: float, limit: float) -> float:
        """The size (s) that a run under error control begins with, of a method of this order; collective."""
        self.norm.update(self.state, self.to_come(limit))
        found = first_step(self.norm, self.state, order, limit)
        way = FIRST_WAY * self.norm.rtol ** (1.0 / order) * self.system.length
        return time_for_way(self.system, self.state, found, way)

    def _metric(self, h: float) -> Weights:
        """In which motions within a step of h (s) are least: that of a step, where bodies deform."""
        deforms = self.norm.deforming or self.system.elements
        return self._step_metric(h) if deforms else MASS

    def _step_metric(self, h: float) -> Weights:
        return self.eq.metric_of(h, self._solved_for(h))

    def _solved_for(self, h: float) -> Array:
        """The frequencies, (p,) in 1/s, that a step of h (s) was solved for; none where steps nearby have about the same."""
        return np.zeros(0)

    # -- steps --------------------------------------------------------------------------------------------------
    def advance(self, h: float) -> State:
        """One accepted step. Constant steps: of size h. Error control: of at most h (s), which is then hit exactly at the end.

        Raises ConvergenceError when steps would have to be too small.
        """
        begun = self.state.t
        if not self._step_in_one_call(h):
            self.state = self._controlled(h) if self.adaptive else self._constant(h)
        self._newest_size = self.state.t - begun
        return self.state

    def _constant(self, h: float) -> State:
        raise NotImplementedError

    def _controlled(self, limit: float) -> State:
        raise NotImplementedError

    def _ended(self, h: float, end: State, mult: Array) -> State:
        """The end of a step of size h (s) with multipliers (n_mult,), which is accepted; with ties and constraints closed."""
        self.stats.steps += 1
        self.iteration.step_ended()
        end = self.eq.close_ties(h, end, mult)
        end = project(self.system, end, self.solver) if self.scheme.form.projected else end
        return corrected(self.system, end, self.solver, self._step_metric(h)) if self._corrects else end

    def _smallest(self, t: float, q: Array, mult: Array) -> Array:
        """Of the multipliers (n_mult,) with the same forces the smallest, level by level, so that predictions stay small."""
        shape = self.eq.levels, self.system.n_lam
        every = shape[0] * shape[1]
        levels = least(self.solver, t, q, mult[:every].reshape(shape))
        return np.concatenate((levels.ravel(), mult[every:]))

    def _error_size(self, h: float, pencil: Any, e_q: Array, e_v: Array, e_a: Array | None = None) -> float:
        """Norm of errors like v; along ties velocities count by the places they lead to, as in index 3. ``pencil``: of a real
        frequency.
        """
        errors = np.array([e_v] if e_a is None else [e_v, e_a])
        held = self.eq.along_ties(pencil, errors)
        if not held.any():
            return self.norm(h, e_q, e_v, e_a)
        return worst(self.norm(h, e_q, *(errors - held)), self.norm.mean(held[0] * (h / self.norm.wq)))

    # -- what a scheme says of steps of compiled code ------------------------------------------------------------------
    def _lend(self) -> ImplicitRoom:
        """The room of its stages, with its coefficients."""
        raise NotImplementedError

    def _settings(self) -> tuple[Convergence, StageRule]:
        """What it says of Newton's iteration of a constant step, and of its points."""
        raise NotImplementedError

    def _memory(self) -> Array:
        """What it keeps with the state, behind the work."""
        raise NotImplementedError

    def _recall(self, kept: Array, factored: float) -> None:
        """The same from the newest state of a march, and what its factors are for."""
        raise NotImplementedError

    def _factored_for(self) -> float:
        """What its factors are for, as compiled code says it."""
        raise NotImplementedError

    def _frequencies(self, h: float) -> Array:
        """Those of steps of constant size h (s)."""
        raise NotImplementedError

    def _lend_matrices(self, key: float) -> None:
        """Those of what factors are for, as compiled code says it."""
        raise NotImplementedError

    @property
    def _independent(self) -> bool:
        """Whether accelerations and multipliers may be corrected: not with pressures that belong to them."""
        return not any(part.field.carried for _, part in self.system.fields)

    @property
    def _correctable(self) -> bool:
        """Whether accelerations and multipliers are read that may be corrected."""
        return self.recorded > 1 and self._independent

    @property
    def _rough(self) -> bool:
        """Whether those of ends of steps are less accurate than the motion: no row on accelerations tells them, but the rows of
        the system would, other than those of a form of a user's own.
        """
        form = self.scheme.form
        return self.system.n_lam > 0 and form.by_levels and 2 not in form.levels

    @property
    def _corrects(self) -> bool:
        """Whether those of ends of steps are corrected in each step, as somebody reads them."""
        return self._correctable and self._rough

    def told(self, state: State) -> State:
        """As :meth:`TimeStepper.told`."""
        h = self._newest_size
        if self._corrects or not h > 0.0 or not (self._rough and self._independent):
            return state
        return all_corrected(self.system, States.of([state]), self.solver, [self._step_metric(h)]).state(0)

    # -- steps of compiled code ---------------------------------------------------------------------------------------------
    def _in_one_call(self, h: float) -> bool:
        if self.solver.driver is None or self.iteration.full:
            return False
        if self.adaptive:
            return self._chooses_alike
        return not self.system.fields or (self.eq.whole.ready and self.eq.whole.solves_for(self._frequencies(h)))

    def _march_of(self) -> March | None:
        return super()._march_of() if self.eq.whole.ready else None

    def _tables_of_steps(self) -> DriverStates | None:
        found: DriverStates | None = self.eq.whole.tables(self.state)
        return found

    def _room(self, states: DriverStates) -> int:
        self._lent = self._lend()
        return 1

    def _own(self, *, factored: bool) -> Array:
        iteration = self.iteration
        work = work_of(iteration.theta, known=self.eq.whole.serves(iteration.tangent))
        return np.concatenate((work, self._memory()))[None]

    def _prepare_room(self, room: Array, *, alone: bool) -> None:
        lent, iteration = self._lent, self.iteration
        assert lent is not None
        stages, pencil = lent.stages, iteration.pencil
        factored = isinstance(pencil, SparsePencil) and pencil.room is stages

        lent.c.projects, lent.c.corrects = self.scheme.form.projected, self._corrects
        lent.c.factored = self._factored_for() if factored else 0.0
        self.eq.whole.lend(stages, self.state, iteration.tangent, self._lend_matrices)

        convergence, rule = self._settings()
        convergence.accurate = iteration.judge.tolerance
        stages.lend(rule, np.ones((3, 1)))
        floor = 64 * EPS * self.system.length
        lent.settle(convergence, {"rtol": self.norm.rtol, "floor": floor, "slow": self.slow})

        room.view(np.uintp)[0] = lent.address
        if lent.own is not None:
            self._lend_own(lent.own)

    def _take_march(self, march: March, made: int) -> None:
        own, iteration = march.ring.own().copy(), self.iteration
        work = own[: slots.WORK]
        self._count_increments(march.parameters, made)
        self._count_solves(int(work[slots.INCREMENTS]))
        self.stats.steps += made
        self._newest_size = self.state.t - self.origin.t
        iteration.factorisations += int(work[slots.FACTORED])
        self.eq.jacobians += int(work[slots.TANGENTS])
        # those of increments have been counted
        iteration.judge.check(float(work[slots.RESIDUAL]), float(work[slots.RESIDUAL_SCALE]), solves=0)

        iteration.steps_ended(made)
        self._take_kept(own)
        if self._lent is not None and self._lent.own is not None:
            self._take_own(self._lent.own, made)

    def _take_kept(self, own: Array) -> None:
        """What a state of a march keeps."""
        lent, iteration = self._lent, self.iteration
        assert lent is not None
        work = own[: slots.WORK]
        iteration.theta, known = float(work[slots.RATE]), bool(work[slots.KNOWN])
        iteration.tangent, iteration.pencil = self.eq.whole.kept(lent.stages, iteration.judge, known=known)
        self._recall(own[slots.WORK :], float(lent.c.factored))

    def _count_solves(self, increments: int) -> None:
        """Evaluations and solves of so many increments."""
        assert self._lent is not None
        stages = self._lent.stages
        self.iteration.increments += increments
        self.eq.residuals += increments * stages.c.points
        self.iteration.judge.solves += increments * stages.shared

    def _refuse(self, h: float) -> None:
        super()._refuse(h)
        lent, iteration = self._lent, self.iteration
        assert lent is not None
        failed, lent.c.failed = int(lent.c.failed), 0.0
        if self.adaptive:  # it fails there too
            if lent.c.fresh:  # compiled code took a tangent in its place
                iteration.tangent = iteration.pencil = None
            return
        self._count_solves(failed)
        self.newton.iterations += failed
        self.eq.whole.refused(lent.stages)
        iteration.tangent = iteration.pencil = None  # parts of the step begin with their own
