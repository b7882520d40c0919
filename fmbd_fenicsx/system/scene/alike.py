"""Scenes and settings that all ranks must be given alike.

Every rank builds the scene from its own copy of the script. A step, a mass or a load that differs there, by the rank or by the
clock, would make ranks part in the midst of a run: matrices would be of no step that anyone has asked for.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from ...agreement import refuse_differing
from ...checks import binder
from ...notices import Runs
from ...ranks import world_size
from .described import described
from .scene import Scene

P = ParamSpec("P")
T = TypeVar("T")

OF_RANK = {"at", "checkpoint", "restart"}  # states are spread over the ranks, files are those of the first one
SHOWN = {"output.progress"}


def alike(call: Callable[P, T]) -> Callable[P, T]:
    """A collective function of a scene that refuses arguments which differ between ranks, before anything is computed.

    Each call is a run or an analysis with warnings of its own.
    """
    bound = binder(call.__name__, inspect.signature(call))

    @wraps(call)
    def compared(*args: P.args, **kwargs: P.kwargs) -> T:
        given = bound(args, kwargs)
        if world_size() > 1:
            scene: Any = given.get("scene")
            comm = _common(scene) if isinstance(scene, Scene) else None
            if comm is not None:
                settings = {name: value for name, value in given.items() if name not in ("scene", *OF_RANK)}
                values = described(scene, **settings) | values_of_inputs(scene)
                refuse_differing(comm, call.__name__, {k: v for k, v in values.items() if k not in SHOWN})
        within, Runs.within = Runs.within, True
        Runs.begun += not within
        try:
            return call(*args, **kwargs)
        finally:
            Runs.within = within

    return compared


def values_of_inputs(scene: Scene) -> dict[str, float]:
    """Present values of the inputs, by names as messages call them."""
    return {f'input "{name}"': source.value for name, source in scene.inputs.items()}


def _common(scene: Scene) -> Any:
    """The ranks that work on a scene together, those of the mesh of a body whose nodes are unknowns; None where there is none."""
    return next((body.solid.mesh.dolfinx.comm for body in scene.bodies.values() if body.nodal and body.meshed), None)
