"""The energy guard: where nothing puts energy into a scene, a step that gains energy is taken back and repeated in halves.

    E_n+1 - max(E_0 .. E_n)  >  1e-3 (T + V + m g L)                                                       (1)

with T and V the largest kinetic and elastic energies so far, L the length of the model and m g its weight: the energy that can
turn into motion. Damping at high frequencies in the linear sense is no protection: a stiff spring that turns by half a radian
in a step makes generalized-alpha with rho_inf = 0.9 gain a factor of thirty. Scenes with anything that may do work (loads in
time, drives, laws of the user's own, contact) are not guarded, nor are runs that record no energies. Of a scene with elastic
bodies the first ten steps are not guarded: an initial shape that contains vibrations of h omega >> 1 overshoots there, and the
damping of the scheme then removes it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import ConvergenceError
from ..mechanics.bodies import CoordinateBody
from ..mechanics.couplings import OwnBatch
from ..mechanics.laws import ScalarLoads
from ..mechanics.wires import Wires
from ..system.memory import Memory, remember_stepper
from ..system.scene import Scene
from ..system.system import Evaluation, State, System

SHARE = 1e-3
HALVINGS = 10
SETTLING = 10


def closed(scene: Scene, system: System) -> bool:
    """Whether nothing can put energy into a scene."""
    own = any(isinstance(b, CoordinateBody | Wires) for b in scene.bodies.values())
    loaded = any(bool(getattr(b, "loads", False)) for b in scene.bodies.values())
    driven = any(batch.driven or isinstance(batch, OwnBatch) for batch, _ in system.batches)
    moved = any(tie.motion is not None for tie in scene.ties.values())
    forced = any(not isinstance(f, ScalarLoads) or f.own for f in system.forces)
    ramp = scene.gravity is not None and scene.gravity_ramp > 0
    return not (own or loaded or driven or moved or forced or ramp or scene.contacts or scene.sliders)


class Guarded:
    """A stepper under guard. ``renew`` makes a stepper from a state; ``rejections`` counts the steps that were taken back.

    A scheme with constant steps goes on with the smaller step; one with error control is told to start again from before.
    """

    def __init__(self, stepper: Any, system: System, renew: Callable[[State], Any]) -> None:
        self.stepper, self.system, self.renew = stepper, system, renew
        self.halvings, self.rejections, self.largest = 0, 0, float("inf")
        self.weight = system.mass * float(np.linalg.norm(system.gravity(0.0))) * system.length
        self.turnover, self.highest = 0.0, -float("inf")
        self.local_error, self.settling = 0.0, SETTLING + 1 if system.parts else 1
        self._gain()

    @property
    def state(self) -> State:
        """The state of the stepper."""
        return self.stepper.state

    @property
    def counters(self) -> dict[str, float]:
        """Those of the stepper, and the steps taken back."""
        return {**getattr(self.stepper, "counters", {}), "energy_rejections": self.rejections}

    def remember(self, m: Memory) -> None:
        """The stepper, and what was seen of energies."""
        remember_stepper(self.stepper, m.inside("stepper"))
        steps = self.halvings, self.rejections, self.largest, self.local_error, self.settling
        self.halvings, self.rejections, self.largest, self.local_error, self.settling = m("steps", steps)
        self.turnover, self.highest = m("energies", (self.turnover, self.highest))

    def restart(self, t: float) -> None:
        """Go on behind a kink at t."""
        self.stepper.restart(t)

    def advance(self, h: float) -> State:
        """One step, or several that make it up (constant steps); collective."""
        if hasattr(self.stepper, "restart"):
            return self._controlled(h)
        done, self.local_error = 0, 0.0
        while done < 2**self.halvings:
            before = self.stepper.state
            self.stepper.advance(h / 2**self.halvings)
            if (gain := self._gain()) is None:
                done += 1
                self.local_error = max(self.local_error, self.stepper.local_error)
                continue
            self.halvings, done = self.halvings + 1, 2 * done
            self._count(before, gain, self.halvings > HALVINGS)
            self.stepper = self.renew(before)
        return self.stepper.state

    def _controlled(self, h: float) -> State:
        """One step of a scheme with error control, of at most h."""
        before = self.stepper.state
        for left in range(HALVINGS, -1, -1):
            after = self.stepper.advance(min(h, self.largest))
            if (gain := self._gain()) is None:
                self.largest *= 2.0
                self.local_error = self.stepper.local_error
                return after
            self.largest = 0.5 * (after.t - before.t)
            self._count(before, gain, left == 0)
            self.stepper.state = before
            self.stepper.restart(before.t)
        return self.stepper.state

    def _gain(self) -> float | None:
        """Gain of energy (J) of the newest state when it is too large, else None; keeps what was seen."""
        s = self.stepper.state
        self.evaluation: Evaluation = self.system.at(s.t, s.q, s.v)
        parts = self.evaluation.energies()
        energy = sum(parts.values())
        turnover = max(self.turnover, parts["kinetic"] + parts["elastic"] + parts["springs"])
        gain = energy - self.highest
        if self.settling == 0 and gain > SHARE * (turnover + self.weight):
            return float(gain)
        self.settling = max(self.settling - 1, 0)
        self.turnover, self.highest = turnover, max(energy, self.highest)
        return None

    def _count(self, before: State, gain: float, stop: bool) -> None:
        self.rejections += 1
        if stop:
            raise ConvergenceError(
                f"The step at t = {before.t:.6g} s gains {gain:.3g} J from nothing, also in 1/{2**HALVINGS} of the step: the "
                "scheme does not follow a stiff part that turns. Take a much smaller dt, fmbd.EnergyMomentum() or fmbd.Radau()."
            )
