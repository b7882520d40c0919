"""A run step by step: take a step, keep the state, go back to it, change inputs.

    with fmbd.stepper(scene, dt=1e-3) as s:
        s.set("torque", 2.0)
        kept = s.save()
        s.step()
        s.restore(kept)
        tip = s["tip"]

Steps of equal size give what :func:`~fmbd_fenicsx.solve` gives, to the last bit: it is the same stepper from the same start.
After a change of size a scheme with constant steps begins anew from the consistent state, as after a failed step.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..agreement import OneAnswer, refuse_differing
from ..checks import instance, number, typed
from ..errors import InputError, near, require
from ..rotations import Array
from ..schemes.declared import Declared
from ..schemes.newton import Newton
from ..system.element_memory import memories
from ..system.layout import State
from ..system.scene.alike import alike, values_of_inputs
from ..system.scene.scene import Scene
from ..system.serialisation import Memory
from ..uncopied import Uncopied
from .checkpoints.progress import RunProgress
from .judges.acceptance import accept_step, attempt_judged
from .judges.energy_check import closed
from .judges.prescribed_motions import PrescribedMotions
from .problem import Problem, begin, judges_of, make_solver, make_stepper
from .recording.moment import Moment
from .recording.output import Output
from .recording.recorder import Recorder
from .schedule import StepSchedule, far_side, near_side
from .settings import check_contents, default_scheme

SAME = 1e-9  # of a step: times that are nearer are one


@dataclass(frozen=True)
class Saved:
    """A state of a run with all that its next step depends on; made by ``save``, valid for the stepper that made it."""

    owner: int
    values: dict[str, Any]
    inputs: dict[str, float]
    jumped: bool


class SceneStepper(Uncopied):
    """See :func:`stepper`. Methods are collective."""

    instead = "Its save() keeps a state and restore() goes back to it; a second stepper(scene, ...) is independent of the first."

    def __init__(
        self, scene: Scene, dt: float, *, scheme: Any = None, newton: Newton | None = None, linear: Any = None
    ) -> None:
        number("Step dt =", dt, above=0.0, unit="s")
        scheme = default_scheme(scene) if scheme is None else scheme
        newton = Newton() if newton is None else newton.afresh()
        check_contents(scene, scheme)

        self.scene, self.dt = scene, dt
        self._adaptive = Declared.by(scheme).adaptive
        self._pace = StepSchedule(dt, 0 if self._adaptive else 1)
        self._stops = sorted(scene.breakpoints)
        self._inputs = {name: source.value for name, source in scene.inputs.items()}

        system, given, markers = scene.build()
        self._solver = make_solver(scene, system, linear)

        try:
            start, _ = begin(scene, scheme, system, given, solver=self._solver, h=dt)
            self._problem = Problem(
                scene, system, markers, given, start, memories(system), scheme, newton, linear, self._solver.pressures
            )
            self._judges = judges = judges_of(self._problem, self._solver, self._pace)
            made = make_stepper(self._problem, self._solver, self._pace, judges, guarded=closed(scene, system))
        except BaseException:
            self._solver.destroy()
            raise

        recorder = Recorder(scene, system, markers, Output(progress=False), np.inf)
        self._progress = RunProgress(system, self._solver, newton, made, recorder, judges.balanced)
        self._motions = PrescribedMotions(scene, system, start.t)

        self._saved: Saved | None = None
        self._jumped = False  # an input has changed since the last step
        self._open = True
        self._look()

    # -- what is seen ---------------------------------------------------------------------------------------------
    @property
    def t(self) -> float:
        """Time, s."""
        return self.state.t

    @property
    def state(self) -> State:
        """The present state."""
        return self._progress.stepper.state  # type: ignore[no-any-return]

    def __getitem__(self, sensor: str) -> Array:
        """Present value of a sensor, (size,)."""
        if sensor not in self._values:
            raise InputError(f'No sensor "{sensor}". {near(sensor, self._values)}')
        return self._values[sensor].copy()

    def energies(self) -> dict[str, float]:
        """Present energies by kind, J."""
        return self._moment.energies()

    def _look(self) -> None:
        """Read all sensors: angles count their revolutions from step to step."""
        p = self._problem
        self._moment = Moment(self.scene, p.system, p.markers, self.state, self._progress.done)
        self._values = {name: np.asarray(self._moment[name]) for name in self.scene.sensors}

    # -- what is done ---------------------------------------------------------------------------------------------
    def step(self, dt: float | None = None) -> float:
        """Advance by dt (s; the ``dt`` of the stepper by default); returns the new time.

        A scheme with error control takes as many steps of its own as it needs.

        Raises:
            ConvergenceError: the step fails. ``restore`` an earlier state to go on from there.
        """
        self._ready()
        dt = self.dt if dt is None else dt
        number("Step dt =", dt, above=0.0, unit="s")
        require(self.t + dt > self.t, f"Step dt = {dt} s is below the roundoff of t = {self.t} s.")

        if (comm := self._problem.system.comm) is not None and comm.size > 1:
            refuse_differing(comm, "step", {"dt": dt, **values_of_inputs(self.scene)})
        self._motions.look(self.t + dt)
        self._problem.system.refuse_changed_forms()

        if self._jumped:  # the past of the stepper is that of other forces
            self._progress.stepper.restart(self.t)
            self._jumped = False

        with OneAnswer(self._problem.system.comm):
            self._advance(dt)

        self._progress.done += 1
        self._look()
        return self.t

    def _advance(self, dt: float) -> None:
        """To dt (s) from now, in parts that end at break points on the way; at one where the step ends but for roundoff, too."""
        end = self.t + dt
        same = SAME * dt
        for stop in self._stops:
            if self.t < near_side(stop) and far_side(stop) < end + same:
                self._advance_part(near_side(stop) - self.t)
                self._progress.stepper.restart(far_side(stop))
                dt = end - self.t
        if dt > same:
            self._advance_part(dt)

    def _advance_part(self, dt: float) -> None:
        """One step, or as many as the scheme likes."""
        progress, end = self._progress, self.t + dt
        if not self._adaptive:
            progress.stepper.advance(dt)
            return
        # times are summed: what is left may be a few roundings
        while end - self.t > 64 * np.spacing(end):
            judges = self._judges
            attempt_judged(
                progress.system, progress.stepper, end - self.t, closed=judges.closed, balanced=judges.balanced
            )
            accept_step(progress.system, progress.stepper)

    def set(self, name: str, value: float) -> None:
        """Give an input of the scene (:meth:`Scene.input`) a new value, held until the next change.

        Raises:
            InputError: no such input, or a value outside its range.
        """
        self._ready()
        if name not in self.scene.inputs:
            raise InputError(f'No input "{name}" in scene "{self.scene.name}". {near(name, self.scene.inputs)}')
        before = self.scene.inputs[name].value
        self.scene.inputs[name].set(value)
        self._jumped = self._jumped or self.scene.inputs[name].value != before

    def save(self) -> Saved:
        """All that the next step depends on, inputs included, to come back to with :meth:`restore` as often as needed."""
        self._ready()
        m = Memory(self._progress.system)
        self._progress.remember(m)
        inputs = {name: source.value for name, source in self.scene.inputs.items()}
        self._saved = Saved(id(self), deepcopy(m.values), inputs, self._jumped)
        return self._saved

    def restore(self, saved: Saved | None = None) -> None:
        """Go back to a saved state, the newest one by default."""
        self._ready()
        saved = self._saved if saved is None else saved
        if saved is None:
            raise InputError("Nothing to restore: call save() first.")
        instance("restore: saved", saved, Saved)
        require(
            saved.owner == id(self), "This state was saved by another stepper; save() and restore() belong together."
        )
        for name, value in saved.inputs.items():
            self.scene.inputs[name].set(value)
        self._progress.remember(Memory(self._progress.system, deepcopy(saved.values)), "saved state")
        self._jumped = saved.jumped
        self._look()

    # -- life -----------------------------------------------------------------------------------------------------
    def _ready(self) -> None:
        require(self._open, f'The stepper of scene "{self.scene.name}" is closed.')

    def close(self) -> None:
        """Free factors and give the inputs of the scene the values back that they had."""
        if self._open:
            self._open = False
            self._solver.destroy()
            for name, value in self._inputs.items():
                self.scene.inputs[name].set(value)

    def __enter__(self) -> SceneStepper:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


@alike
@typed
def stepper(
    scene: Scene, *, dt: float, scheme: Any = None, newton: Newton | None = None, linear: Any = None
) -> SceneStepper:
    """A scene at its consistent start, to be advanced step by step; collective. Use it in a ``with`` block.

    Args:
        dt: usual size of a step, s.
        scheme, newton, linear: as for :func:`~fmbd_fenicsx.solve`.
    """
    return SceneStepper(scene, dt, scheme=scheme, newton=newton, linear=linear)
