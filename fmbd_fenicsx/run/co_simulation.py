"""A scene as a unit of a co-simulation: inputs, outputs, steps, states that can be taken back. FMI needs no more.

Inputs are those of the scene (:meth:`Scene.input`), held during a communication step; outputs are its sensors, each component
by itself: ``tip`` of two numbers gives ``tip_x`` and ``tip_y``, spaces in names become ``_``.
"""

from __future__ import annotations

from collections.abc import Callable

from ..errors import FmbdError, require
from ..system.scene.scene import Scene
from .stepper import SceneStepper


class Unit(SceneStepper):
    """The stepper of a scene between communication points; ``dt`` (s) is the largest step that it takes in between."""

    def __init__(self, make: Callable[[], Scene], *, dt: float) -> None:
        scene = make()
        require(isinstance(scene, Scene), f"A unit needs a function that returns a scene, found {scene!r}.")
        super().__init__(scene, dt)
        self.outputs: dict[str, tuple[str, int]] = {}
        for sensor, quantity in scene.sensors.items():
            size = len(self[sensor])
            labels = list(quantity.labels)
            for k in range(size):
                tail = "" if size == 1 else f"_{labels[k]}" if k < len(labels) else f"_{k + 1}"
                self.outputs[(sensor + tail).replace(" ", "_")] = sensor, k

    def get(self, output: str) -> float:
        """Present value of an output."""
        sensor, k = self.outputs[output]
        return float(self[sensor][k])

    def unit_of(self, output: str) -> str:
        """Its unit of measurement."""
        return str(self.scene.sensors[self.outputs[output][0]].unit)

    def do_step(self, t: float, h: float) -> None:
        """From the communication point t on by h (s), in equal steps of at most ``dt``.

        Raises:
            FmbdError: the unit stands elsewhere, or a step fails; the state is then that of the point t.
        """
        if abs(self.t - t) > 1e-9 * max(h, abs(t)):
            raise FmbdError(f"The unit stands at t = {self.t:g} s and was asked for a step from t = {t:g} s.")
        kept = self.save()
        parts = max(1, int(-(-h // (self.dt * (1 + 1e-9)))))
        try:
            for _ in range(parts):
                self.step(h / parts)
        except FmbdError:
            self.restore(kept)
            raise
