"""Constant steps of implicit schemes by calls of compiled code (driver/implicit.c), for systems whose stage systems are sparse.

Tangent and factors are those of the room that steps made in parts use too: whoever comes next goes on with them.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from ...linear.residual import Judge
from ...linear.saddle.sparse_pencil import SparsePencil
from ...rotations import Array
from ...system.compiled import implicit as slots
from ...system.compiled.implicit import ImplicitRoom, work_of
from ...system.compiled.march import March
from ...system.compiled.states.convergence import Convergence
from ...system.compiled.states.evaluation import DriverStates
from ...system.compiled.states.stages import Rule
from ..control import EPS, ErrorNorm, Statistics, StepControl
from ..marching import MarchingStepper


class ImplicitMarch(MarchingStepper):
    """What :class:`.ImplicitStepper` is beside its steps in parts. A scheme says what it has of its own: coefficients, and
    what it keeps with a state.

    ``slow``: rate of Newton's iteration above which the next constant step takes a tangent.
    """

    leaves_masses = False
    slow: ClassVar[float]
    longer: ClassVar[float] = 1.0  # see implicit.c
    scheme: Any
    eq: Any
    adaptive: bool
    norm: ErrorNorm
    stats: Statistics
    judge: Judge
    control: StepControl
    proposed: float | None
    _tangent: Any
    _pencil: Any
    _fresh: bool
    _full: bool
    _theta: float
    _lent: ImplicitRoom | None = None

    # -- what a scheme says -------------------------------------------------------------------------------------------------
    def _lend(self) -> ImplicitRoom:
        """The room of its stages, with its coefficients."""
        raise NotImplementedError

    def _settings(self) -> tuple[Convergence, Rule]:
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

    # -- steps --------------------------------------------------------------------------------------------------------------
    def _in_one_call(self, h: float) -> bool:
        return self.solver.driver is not None and not (self._full or self.scheme.form.projected)

    def _march_of(self) -> March | None:
        return super()._march_of() if self.eq.compiled else None

    def _room(self, states: DriverStates) -> int:
        self._lent = self._lend()
        return 1

    def _own(self, *, factored: bool) -> Array:
        return np.concatenate((work_of(self._theta, known=self._tangent is not None), self._memory()))[None]

    def _prepare_room(self, room: Array, *, alone: bool) -> None:
        lent, tangents = self._lent, self.eq.tangents
        assert lent is not None
        stages, pencil = lent.stages, self._pencil
        factored = isinstance(pencil, SparsePencil) and pencil.room is stages
        lent.c.factored = self._factored_for() if factored else 0.0
        if self._tangent is not None and self._tangent is not stages.tangent:
            stages.structure.data(self._tangent, stages.data)

        tangents.weigh_once(self.solver, self.state)
        convergence, rule = self._settings()
        convergence.accurate = self.judge.tolerance
        stages.lend(rule, np.ones((3, self.system.n_v)), redundant=self.solver.core.redundant)
        floor = 64 * EPS * self.system.length
        lent.settle(convergence, {"rtol": self.norm.rtol, "floor": floor, "slow": self.slow, "longer": self.longer})
        room.view(np.uintp)[0] = lent.address

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

        self._fresh, self.control.fault = False, ""
        self._take_kept(own)

    def _take_kept(self, own: Array) -> None:
        """What a state of a march keeps."""
        lent = self._lent
        assert lent is not None
        work, stages = own[: slots.WORK], lent.stages
        self._theta = float(work[slots.RATE])
        self._tangent = self._pencil = None
        self.eq.tangents.U = stages.tangent.U
        if work[slots.KNOWN]:
            self._tangent = stages.tangent
            self._pencil = SparsePencil(stages.tangent, stages.frequencies, self.judge, stages)
        self._recall(own[slots.WORK :], float(lent.c.factored))

    def _count_solves(self, increments: int) -> None:
        """Evaluations and solves of so many increments."""
        assert self._lent is not None
        stages = self._lent.stages.c
        self.stats.newton_iterations += increments
        self.eq.residuals += increments * stages.points
        self.judge.solves += increments * stages.frequencies

    def _refuse(self, h: float) -> None:
        super()._refuse(h)
        assert self._lent is not None
        failed, self._lent.c.failed = int(self._lent.c.failed), 0.0
        if self.adaptive:  # it fails there too, or its error does
            return
        self._count_solves(failed)
        self.newton.iterations += failed
        self._tangent = self._pencil = None  # parts of the step begin with their own
