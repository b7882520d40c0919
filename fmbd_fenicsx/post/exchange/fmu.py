"""A scene as a functional mock-up unit for co-simulation, FMI 3.0 (needs pythonfmu3).

    fmbd.write_fmu("arm.py", "out", dt=1e-3)        # arm.py holds a function scene() -> fmbd.Scene

The unit holds the user's script and a few lines that call this package, which the machine that runs it must have. States can be
fetched and set, so masters may repeat and reject steps; steps may be of any size. A step that cannot be made is discarded, with
its reason in the log, and the unit stands where it stood; an input outside of its range makes the call fail and keeps its value.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from math import inf
from pathlib import Path
from typing import Any

from ...errors import FmbdError, InputError, require
from ...run.co_simulation import Unit
from ...scripts import module_of
from ...system.scene.scene import Scene

_TEXT = '''"""Written by fmbd_fenicsx: {script} as a unit of FMI 3.0."""

import sys
from pathlib import Path

sys.path[:0] = [p for p in {paths!r} if p not in sys.path]

from pythonfmu3 import Fmi3Slave
from fmbd_fenicsx.post.exchange.fmu import attach, load


class {name}(Fmi3Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        here = Path(__file__).resolve().parent
        attach(self, load(here / {script!r}), dt={dt!r})

    def do_step(self, current_time, step_size):
        return self.walk(current_time, step_size)

    def terminate(self):
        self.unit.close()

    def _get_fmu_state(self):
        return {{"saved": self.unit.save()}}

    def _set_fmu_state(self, state):
        self.unit.restore(state["saved"])
'''


def load(script: Path) -> Callable[[], Scene]:
    """The function ``scene`` of a script."""
    make = vars(module_of("Script", script)).get("scene")
    require(callable(make), f"{script} has no function scene() that returns a fmbd.Scene.")
    return make  # type: ignore[return-value]


def attach(slave: Any, make: Callable[[], Scene], *, dt: float) -> None:
    """Give an Fmi3Slave the inputs and outputs of a scene, and the unit that makes its steps."""
    from pythonfmu3 import Float64, Fmi3Causality, Fmi3Initial, Fmi3Status, Fmi3StepResult, Fmi3Variability
    from pythonfmu3 import Unit as Measure
    from pythonfmu3.variable_types import Float64Type

    slave.unit = unit = Unit(make, dt=dt)
    inputs = {name.replace(" ", "_"): name for name in unit.scene.inputs}
    _distinct(["time", *(name.replace(" ", "_") for name in unit.scene.inputs), *unit.outputs])
    slave.author, slave.description = "fmbd_fenicsx", f'Scene "{unit.scene.name}"'
    slave.register_units([Measure(name=u) for u in sorted({unit.unit_of(o) for o in unit.outputs})])
    varying = Fmi3Variability.continuous
    time = Float64("time", causality=Fmi3Causality.independent, variability=varying, getter=lambda: unit.t)
    slave.register_variable(time, nested=False)

    for label, name in inputs.items():
        source = unit.scene.inputs[name]
        variable = Float64(
            label, causality=Fmi3Causality.input, variability=varying, start=source.start,
            getter=lambda s=source: s.value, setter=lambda v, n=name: _set(slave, n, v),
        )  # fmt: skip
        ends = {key: f"{end:.17g}" for key, end in (("min", source.lower), ("max", source.upper)) if abs(end) < inf}
        slave.register_variable(variable, nested=False, var_type=Float64Type(f"range of {label}", **ends))

    for name in unit.outputs:
        variable = Float64(
            name, causality=Fmi3Causality.output, variability=varying, initial=Fmi3Initial.calculated,
            unit=unit.unit_of(name), getter=lambda n=name: unit.get(n),
        )  # fmt: skip
        slave.register_variable(variable, nested=False)

    def walk(t: float, h: float) -> Any:
        try:
            unit.do_step(t, h)
        except FmbdError as error:
            slave.log(str(error), Fmi3Status.discard)
            return Fmi3StepResult(status=Fmi3Status.discard)
        return Fmi3StepResult(status=Fmi3Status.ok)

    slave.walk = walk


def _distinct(names: list[str]) -> None:
    """Inputs and outputs of a unit need names of their own."""
    twice = sorted({name for name in names if names.count(name) > 1})
    listed = ", ".join(f'"{name}"' for name in twice)
    require(
        not twice,
        f"A unit needs different names for its inputs and outputs, where spaces count as _ and components have their own; "
        f"found twice: {listed}. Rename a sensor or an input.",
    )


def _set(slave: Any, name: str, value: float) -> None:
    """Set an input; one out of range makes the call fail, and the unit lives on."""
    try:
        slave.unit.set(name, value)
    except FmbdError:
        # pythonfmu3 gives up its references to the unit when a call fails: a master that goes on would use freed memory
        for kept in (slave, type(slave), slave.log_queue):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(kept))
        raise


def write_fmu(script: str | Path, folder: str | Path, *, dt: float, name: str | None = None) -> Path:
    """Write a co-simulation unit of FMI 3.0 from a script with a function ``scene()``; returns the ``.fmu`` file.

    Args:
        script: a Python file; ``scene()`` returns the scene. Its inputs and sensors become those of the unit.
        folder: where the file goes.
        dt: largest step (s) between two communication points.
        name: of the unit, a Python name; by default that of the script with a capital letter.

    Raises:
        InputError: no such script or function, a name that cannot be one, or pythonfmu3 is missing.
    """
    try:
        from pythonfmu3 import FmuBuilder
    except ImportError:
        raise InputError("write_fmu needs pythonfmu3: ./with-dolfinx pip install pythonfmu3.") from None

    require(isinstance(script, str | Path), f"write_fmu: script must be the path of a file, got {script!r}.")
    script = Path(script)
    require(script.is_file(), f"write_fmu: there is no script {script} (looked in {Path.cwd()}).")
    name = script.stem.capitalize() if name is None else name
    require(name.isidentifier() and name != script.stem, f'write_fmu: name "{name}" must be a Python name of its own.')
    load(script)

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    root = str(Path(__file__).resolve().parents[3])
    wrapper = folder / f"{name}.py"
    wrapper.write_text(_TEXT.format(script=script.name, paths=[root], name=name, dt=float(dt)))

    options = {"needsExecutionTool": "true", "canGetAndSetFMUState": "true"}
    try:
        return Path(FmuBuilder.build_FMU(wrapper, dest=folder, project_files=[script], **options))
    finally:
        wrapper.unlink()
