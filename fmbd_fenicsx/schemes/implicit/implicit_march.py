"""Steps of implicit schemes by calls of compiled code (driver/implicit/implicit.c), for systems whose stage systems are sparse.

Constant ones, and those that error control chooses (driver/marches/own_steps.c). Tangent and factors are those of the room that
steps made in parts use too: whoever comes next goes on with them. A step that fails in another way than by its error is made by
Python from the same beginning, and so is the first of a run, whose size nobody proposes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...linear.implicit.sparse_pencil import SparsePencil
from ...linear.residual import Judge
from ...rotations import Array
from ...system.compiled import implicit as slots
from ...system.compiled.implicit import ImplicitRoom, work_of
from ...system.compiled.march import March
from ...system.compiled.states.convergence import Convergence
from ...system.compiled.states.evaluation import DriverStates
from ...system.compiled.states.stages import StageRule
from ..error_norm import EPS
from ..own_marching import OwnMarch


class ImplicitMarch(OwnMarch):
    """What :class:`.ImplicitStepper` is beside its steps in parts. A scheme says what it has of its own: coefficients, and
    what it keeps with a state.

    ``slow``: rate of Newton's iteration above which the next step takes a tangent.
    """

    leaves_masses = False
    slow: float
    scheme: Any
    eq: Any
    judge: Judge
    _tangent: Any
    _pencil: Any
    _fresh: bool
    _full: bool
    _spell: int
    _theta: float
    _lent: ImplicitRoom | None = None

    # -- what a scheme says -------------------------------------------------------------------------------------------------
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
    def _correctable(self) -> bool:
        """Whether accelerations and multipliers are read that may be corrected: not with pressures that belong to them."""
        return self.recorded > 1 and not any(part.field.carried for _, part in self.system.fields)

    @property
    def _corrects(self) -> bool:
        """Whether those of ends of steps are corrected: they are read, and no row on accelerations tells them, nor a test of
        errors.
        """
        told = 2 in self.scheme.form.levels or not self.system.n_lam
        return self._correctable and not told

    # -- steps --------------------------------------------------------------------------------------------------------------
    def _in_one_call(self, h: float) -> bool:
        if self.solver.driver is None or self._full:
            return False
        if self.adaptive:
            return self._chooses_alike
        return not self.system.fields or (self.eq.compiled and self.eq.solves_for(self._frequencies(h)))

    def _march_of(self) -> March | None:
        return super()._march_of() if self.eq.compiled else None

    def _tables_of_steps(self) -> DriverStates | None:
        found: DriverStates | None = self.eq.whole_steps(self.state)
        return found

    def _room(self, states: DriverStates) -> int:
        self._lent = self._lend()
        return 1

    def _own(self, *, factored: bool) -> Array:
        return np.concatenate((work_of(self._theta, known=self.eq.serves(self._tangent)), self._memory()))[None]

    def _prepare_room(self, room: Array, *, alone: bool) -> None:
        lent = self._lent
        assert lent is not None
        stages, pencil = lent.stages, self._pencil
        factored = isinstance(pencil, SparsePencil) and pencil.room is stages

        lent.c.projects, lent.c.corrects = self.scheme.form.projected, self._corrects
        lent.c.factored = self._factored_for() if factored else 0.0
        self.eq.lend(stages, self.state, self._tangent, self._lend_matrices)

        convergence, rule = self._settings()
        convergence.accurate = self.judge.tolerance
        stages.lend(rule, np.ones((3, 1)))
        floor = 64 * EPS * self.system.length
        lent.settle(convergence, {"rtol": self.norm.rtol, "floor": floor, "slow": self.slow})

        room.view(np.uintp)[0] = lent.address
        if lent.own is not None:
            self._lend_own(lent.own)

    def _take_march(self, march: March, made: int) -> None:
        own = march.ring.own().copy()
        work = own[: slots.WORK]
        self._count_increments(march.parameters, made)
        self._count_solves(int(work[slots.INCREMENTS]))
        self.stats.steps += made
        self.stats.factorisations += int(work[slots.FACTORED])
        self.eq.jacobians += int(work[slots.TANGENTS])
        # those of increments have been counted
        self.judge.check(float(work[slots.RESIDUAL]), float(work[slots.RESIDUAL_SCALE]), solves=0)

        self._fresh, self.control.fault, self._spell = False, "", max(self._spell - made, 0)
        self._take_kept(own)
        if self._lent is not None and self._lent.own is not None:
            self._take_own(self._lent.own, made)

    def _take_kept(self, own: Array) -> None:
        """What a state of a march keeps."""
        lent = self._lent
        assert lent is not None
        work, stages = own[: slots.WORK], lent.stages
        self._theta = float(work[slots.RATE])
        self._tangent, self._pencil = self.eq.kept(stages, self.judge, known=bool(work[slots.KNOWN]))
        self._recall(own[slots.WORK :], float(lent.c.factored))

    def _count_solves(self, increments: int) -> None:
        """Evaluations and solves of so many increments."""
        assert self._lent is not None
        stages = self._lent.stages
        self.stats.newton_iterations += increments
        self.eq.residuals += increments * stages.c.points
        self.judge.solves += increments * stages.shared

    def _refuse(self, h: float) -> None:
        super()._refuse(h)
        assert self._lent is not None
        failed, self._lent.c.failed = int(self._lent.c.failed), 0.0
        if self.adaptive:  # it fails there too
            if self._lent.c.fresh:  # compiled code took a tangent in its place
                self._tangent = self._pencil = None
            return
        self._count_solves(failed)
        self.newton.iterations += failed
        self.eq.refused(self._lent.stages)
        self._tangent = self._pencil = None  # parts of the step begin with their own
