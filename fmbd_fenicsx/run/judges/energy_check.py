"""The energy guard: where nothing puts energy into a scene, a step that gains energy is taken back and repeated in halves.

    E_n+1 - max(E_0 .. E_n)  >  1e-3 (T + V + m g L) + R                                                   (1)

with T and V the largest kinetic and elastic energies so far (of springs and potentials the size), L the length of the model and
m g its weight: the energy that can turn into motion. R is the energy of roundoff, which bodies at rest have too: of motion by
1e-12 (L + |x|) in a step, of strains of 1e-12, of springs in elongations by 16 eps (L + |x|).

Damping at high frequencies in the linear sense is no protection: a stiff spring that turns by half a radian in a step makes
generalized-alpha with rho_inf = 0.9 gain a factor of thirty. Scenes with anything that may do work (loads in time, drives, laws
of the user's own that are no potential, contact) are not guarded, nor are runs that record no energies. Of a scene with elastic
bodies the first ten steps are not guarded: an initial shape that contains vibrations of h omega >> 1 overshoots there, and the
damping of the scheme then removes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from ...errors import ConvergenceError
from ...mechanics.forces.effort_laws import EffortLaw
from ...mechanics.forces.force_elements import ScalarLoads
from ...rotations import Array
from ...schemes.newton import LEFT_OF_PLACES
from ...schemes.stepping import UNOBSERVED, Around, Observers, TimeStepper
from ...system.evaluation import Evaluation
from ...system.layout import State
from ...system.scene.scene import Scene
from ...system.serialisation import Remembering, plain, worker
from ...system.system import System
from .acceptance import attempt

SHARE = 1e-3
HALVINGS = 10
SETTLING = 10
ROUNDOFF = 1e-12


def closed(scene: Scene, system: System, *, ramped: bool = False) -> bool:
    """Whether nothing can put energy into a scene, no contact may take it away in impacts, and no law of an element bends;
    ``ramped``: see :func:`isolated`.
    """
    return (
        not scene.unilateral
        and isolated(scene, system, ramped=ramped)
        and all([law.conserves for law in _laws(system)])
    )


def isolated(scene: Scene, system: System, *, ramped: bool = False) -> bool:
    """Whether nothing can put energy into a scene: obstacles that move as prescribed do, others do not. ``ramped``: but for
    gravity that is switched on.
    """
    pushed = system.contacts is not None and any(p.moving for p in system.contacts.pairs)
    worked = any([b.may_do_work for b in scene.bodies.values()])
    driven = any([batch.driven for batch, _ in system.batches])
    moved = any(tie.motion is not None for tie in scene.ties.values())
    forced = any([not isinstance(f, ScalarLoads) for f in system.forces])
    forced = forced or any([not isinstance(law, EffortLaw) or law.gives for law in _laws(system)])
    heavier = callable(scene.gravity) if ramped else scene.gravity_changes
    return not (worked or driven or moved or forced or pushed or heavier or scene.sliders)


def lossless(scene: Scene, system: System) -> bool:
    """Whether nothing can take energy from a scene that nothing puts any into, which has stops of an energy."""
    laws = _laws(system)
    if not laws or scene.unilateral or not isolated(scene, system):
        return False
    kept = all(b.keeps_energy for b in scene.bodies.values()) and not any(law.takes for law in laws)
    damped = any(type(f) is not ScalarLoads or f.c.any() for f in system.forces)
    return kept and not damped and not all(law.conserves for law in laws)


def _laws(system: System) -> list[Any]:
    """The laws of elements on coordinates, a user's own ones too."""
    return [loads.forces[i].law for loads in system.forces if isinstance(loads, ScalarLoads) for i in loads.own]


class Watch(Remembering):
    """What (1) needs of the states so far; ``rejections`` counts the steps that were taken back."""

    keeps: ClassVar = dict.fromkeys(("turnover", "highest", "time", "rejections", "settling"), plain())

    def __init__(self, system: System, state: State) -> None:
        self.system, self.rejections = system, 0
        self.weight = system.mass * system.gravity.size * system.length
        self.turnover, self.highest = 0.0, -float("inf")
        self.strained, self.time = strain_energy(system), state.t
        self.settling = SETTLING + 1 if system.parts else 1
        self.evaluation: Evaluation | None = None  # of the newest state, where it was made
        self.gain(state)

    def gain(self, s: State, seen: Evaluation | None = None, energies: Sequence[float] | None = None) -> float | None:
        """Gain of energy (J) of the newest state when it is too large, else None; keeps what was seen.

        ``seen``: the system in this state, ``energies``: kinetic, elastic, of the weight and of springs in it, where known.
        """
        self.evaluation = seen
        if energies is None:
            self.evaluation = self.system.at(s.t, s.q, s.v) if seen is None else seen
            parts = list(self.evaluation.energies().values())
        else:
            parts = list(energies)

        kinetic, elastic, weight, springs = parts
        energy = sum(parts)
        turnover = max(self.turnover, kinetic + elastic + abs(springs))
        gain, much = energy - self.highest, SHARE * (turnover + self.weight)

        if self.settling == 0 and gain > much and gain > much + self._roundoff(s):
            return float(gain)

        self.time = s.t
        self.settling = max(self.settling - 1, 0)
        self.turnover, self.highest = turnover, max(energy, self.highest)
        return None

    @property
    def limits(self) -> tuple[float, ...]:
        """Highest energy and turnover so far, energy of the weight (J), share, steps not yet guarded: what (1) compares with."""
        return self.highest, self.turnover, self.weight, SHARE, float(self.settling)

    @limits.setter
    def limits(self, seen: tuple[float, ...]) -> None:
        self.highest, self.turnover, self.settling = float(seen[0]), float(seen[1]), int(seen[4])

    def _roundoff(self, state: State) -> float:
        """R of (1) for a step that ends in a state, J."""
        return roundoff_energy(self.system, state.q, state.t - self.time, self.strained)

    def count(self, before: State, gain: float, stop: bool) -> None:
        """One more step from ``before`` taken back; raises ConvergenceError when it must ``stop``."""
        self.rejections += 1
        if stop:
            raise ConvergenceError(
                f"The step at t = {before.t:.6g} s gains {gain:.3g} J from nothing, also in 1/{2**HALVINGS} of the step: the "
                "scheme does not follow a part that is fast, or stiff and turns, or one so stiff, with millions of periods in a "
                "step, that the roundoff of its places moves it. Take a much smaller dt, fmbd.EnergyMomentum() or fmbd.Radau()."
            )


def strain_energy(system: System) -> float:
    """Elastic energy (J) of all bodies in strains of the size of roundoff; collective."""
    return sum(abs(float(part.field.energy(ROUNDOFF * part.field.X.ravel()))) for _, part in system.fields)


def roundoff_energy(system: System, q: Array, h: float, strained: float) -> float:
    """R of (1) for a step of h (s) that ends with q, beside ``strained`` of :func:`strain_energy`, J."""
    places = system.poses(q)[:, : system.motions.dim]
    far = system.length + float(np.abs(places).max(initial=0.0))
    speed = ROUNDOFF * far / h if h > 0 else 0.0
    springs = (loads for loads in system.forces if isinstance(loads, ScalarLoads))
    sprung = sum(float(x.k.sum()) * x.relative.size(system.length) ** 2 for x in springs)
    return system.mass * speed**2 + strained + sprung * (LEFT_OF_PLACES * far / system.length) ** 2


class Guarded(Around):
    """A stepper with error control under guard: told to start again from before. Constant steps: :mod:`..step_bisection`."""

    keeps: ClassVar = {"stepper": worker, "watch": worker, "largest": plain(), "local_error": plain()}

    def __init__(self, stepper: TimeStepper, watch: Watch) -> None:
        self.stepper, self.watch, self.largest = stepper, watch, float("inf")
        self.local_error = 0.0

    @property
    def evaluation(self) -> Evaluation | None:
        """At the newest state."""
        seen = self.watch.evaluation
        return seen if seen is not None and seen.q is self.state.q else self.stepper.evaluation

    @property
    def counters(self) -> dict[str, float]:
        """Those of the stepper, and the steps taken back."""
        return {**self.stepper.counters, "energy_rejections": self.watch.rejections}

    def stride(self, h: float) -> float:
        """That of the stepper; none while steps have to be smaller than it likes."""
        return self.stepper.stride(h) if h <= self.largest else 0.0

    def march(self, h: float, steps: int, observers: Observers = UNOBSERVED) -> int:
        """Steps of the stepper that gain no energy."""
        guarded = Observers(energy=self.watch, joints=observers.joints, tape=observers.tape)
        made = self.stepper.march(h, steps, guarded) if h <= self.largest else 0
        if made:
            self.local_error, self.watch.time = self.stepper.local_error, self.state.t
        return made

    def advance(self, h: float) -> State:
        """One step of at most h; collective."""
        before = self.stepper.state
        for left in range(HALVINGS, -1, -1):
            after = attempt(self.watch.system, self.stepper, min(h, self.largest))
            if (gain := self.watch.gain(after, self.stepper.evaluation)) is None:
                self.largest *= 2.0
                self.local_error = self.stepper.local_error
                return after
            self.largest = 0.5 * (after.t - before.t)
            self.watch.count(before, gain, left == 0)
            self.stepper.state = before
            self.stepper.restart(before.t)
        return self.stepper.state
