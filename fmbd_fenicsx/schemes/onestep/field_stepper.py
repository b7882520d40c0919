"""Generalized-alpha with the compiled step of systems with floating elastic fields."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...linear.condensation import StepSolver
from ...rotations import Array
from ...system.configurations import count
from ...system.system import State, System
from ..newton import Newton
from . import kernel as slots
from .generalized_alpha import FAR, PATIENCE, Stepper
from .kernel import LOOK, Kernel, kernel_of

if TYPE_CHECKING:
    from .generalized_alpha import GeneralizedAlpha


class FieldStepper(Stepper):
    """The same steps by the kernel of :mod:`.kernel`; a step that it gives back is made in NumPy."""

    path = "compiled (bodies, joints and gravity in C; NumPy for the first step and for steps it gives back)"

    def __init__(self, data: tuple[GeneralizedAlpha, System, StepSolver, Newton, State], kernel: Kernel | None) -> None:
        self._kernel: Kernel | None = None
        self._blocks: list[tuple[Array, int]] = []  # newest first, with addresses: t, q, v, a, A, lambda
        self._tail: State | None = None  # the state of the newest block
        self._ahead = False  # blocks are newer than A and the past of the NumPy path
        super().__init__(*data)
        self.counters["compiled_steps"] = 0.0
        if kernel is not None:
            self._take(kernel)

    @property
    def kernel(self) -> Kernel:
        """The kernel in use."""
        assert self._kernel is not None
        return self._kernel

    def _take(self, kernel: Kernel) -> None:
        """Use a kernel from now on."""
        self._kernel, p = kernel, kernel.parameters
        scheme, system, newton = self.scheme, self.system, self.newton
        p[1:5] = scheme.parameters
        p[slots.TOL], p[slots.LENGTH] = newton.tolerance, system.length
        p[slots.FLOOR] = 64 * np.finfo(float).eps * system.length
        p[slots.FAR] = FAR * system.length
        p[slots.SLOW], p[slots.MAXIT], p[slots.PATIENCE] = newton.slow, newton.max_iterations, PATIENCE
        p[slots.NEW_TANGENT] = newton.patience

    @property
    def A(self) -> Array:  # type: ignore[override]
        """Algorithmic acceleration at the end of the last step."""
        self._settle()
        return self._A

    @A.setter
    def A(self, value: Array) -> None:
        self._A = value

    @property
    def _past(self) -> list[tuple[float, Array, Array]]:  # type: ignore[override]
        self._settle()
        return self._earlier

    @_past.setter
    def _past(self, value: list[tuple[float, Array, Array]]) -> None:
        self._earlier = value

    def _settle(self) -> None:
        """Give A and the past of the newest block to the NumPy path."""
        if self._ahead and self._tail is self.state:
            n, at = self.kernel.n, 1 + self.kernel.nq
            self._A = self._blocks[0][0][at + 2 * n : at + 3 * n]
            self._earlier = [(float(b[0]), b[at + n : at + 2 * n], b[at + 3 * n :]) for b, _ in self._blocks[1:]]
        self._ahead = False

    def _load(self) -> None:
        """Blocks from the state, A and the past of the NumPy path."""
        s = self.state
        zero, place_ = np.zeros(self.kernel.n), np.zeros(self.kernel.nq)
        parts = [(s.t, s.q, s.v, s.a, self.A, s.lam), *((t, place_, zero, a, zero, lam) for t, a, lam in self._past)]
        blocks = [np.concatenate(([t], *arrays)) for t, *arrays in parts]
        self._blocks = [(b, b.ctypes.data) for b in blocks]
        self._tail = s

    def _ready(self, h: float) -> bool:
        """Whether there is a kernel for this step: with fields, one that has the solver's factors for the step size."""
        if not self.system.fields:
            return True
        if self.solver.split is not None:
            return False
        _, af, _, beta = self.scheme.parameters
        scale = beta * h * h * (1 - af) / (1 - self.scheme.parameters[0])
        if self.solver.weights.ck != scale:
            return False
        if self._kernel is None or self._kernel.blocks is not self.solver.blocks:
            found = kernel_of(self.system, self.solver.blocks)
            if found is not None:
                self._settle()
                self._take(found)
        return self._kernel is not None

    def advance(self, h: float) -> State:
        """One step of size h (s), as :meth:`Stepper.advance`."""
        if self.fresh or not self._ready(h):
            return super().advance(h)
        if self._tail is not self.state:
            self._load()
        kernel, newton, core = self.kernel, self.newton, self.solver.core
        n, at, p = kernel.n, 1 + kernel.nq, kernel.parameters
        p[slots.H], p[slots.THETA] = h, newton.theta
        out = np.empty(kernel.block_size)
        address = out.ctypes.data
        if verdict := kernel.step(self._blocks, address, self.state.t + h):
            if kernel.error is not None:
                raise kernel.error
            made = super().advance(h)
            if verdict == LOOK:
                kernel.look()
            return made
        self._count(out, h)
        self._blocks = [(out, address), *self._blocks[:2]]
        self.counters["compiled_steps"] += 1
        newton.iterations += int(p[slots.ITERATIONS])
        newton.note(float(p[slots.LEFT]))
        newton.theta = float(p[slots.THETA])
        core.factorisations += 1
        core.judge.check(float(p[slots.RESIDUAL]), 1.0)
        self.local_error, self._ahead = float(p[slots.LOCAL]), True
        q, v, a = out[1:at], out[at : at + n], out[at + n : at + 2 * n]
        self.state = self._tail = State(float(out[0]), q, v, a, out[at + 3 * n :])
        return self.state

    def _count(self, block: Array, h: float) -> None:
        """Counted angles of the newest block, which the kernel leaves out, by (1) from those of the block before."""
        system, n, at = self.system, self.kernel.n, 1 + self.kernel.nq
        if system.counted is None or not system.counted.count:
            return
        beta, old = self.scheme.parameters[3], self._blocks[0][0]
        (v, A), new = (old[at : at + n], old[at + 2 * n : at + 3 * n]), block[at + 2 * n : at + 3 * n]
        q, here = block[1:at], system.counted_angles
        q[here] = old[1:at][here]
        count(system, q, h * v + h * h * ((0.5 - beta) * A + beta * new))
