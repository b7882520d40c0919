"""Whether the arguments of :func:`fmbd_fenicsx.solve` are what they are called."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..checks import instance, shown
from ..errors import require
from ..schemes.dae import Index3
from ..schemes.declared import Declared
from ..schemes.newton import Newton
from ..schemes.onestep.generalized_alpha import GeneralizedAlpha
from ..system.scene.contents import contents_of
from ..system.scene.scene import Scene
from .recording.output import Output


def check_settings(scene: Any, newton: Any, output: Any, restart: Any) -> None:
    """Refuse classes in the place of objects, names, dictionaries."""
    instance("solve: scene", scene, Scene)
    if newton is not None:
        instance("solve: newton", newton, Newton)
    if output is not None:
        instance("solve: output", output, Output)
    require(
        restart is None or isinstance(restart, str | Path),
        f"solve: restart {shown(restart)} must be a folder: a string, a path, or checkpoint.newest.",
    )


def check_ways(linear: Any, checkpoint: Any) -> None:
    """The same for what is loaded only where it is given: the linear solver, and checkpoints."""
    if linear is not None:
        from ..linear.saddle.saddle import Preset

        instance("solve: linear", linear, Preset)
    if checkpoint is not None:
        from .checkpoints.checkpoint import Checkpoint

        instance("solve: checkpoint", checkpoint, Checkpoint)


def check_tangent(scheme: Any, newton: Newton | None) -> None:
    """Refuse an exact tangent of schemes that have none."""
    require(
        newton is None
        or newton.tangent is None
        or (type(scheme) is GeneralizedAlpha and isinstance(scheme.form, Index3)),
        f"{scheme.name} has no exact tangent. Use scheme=fmbd.GeneralizedAlpha(), or leave out Newton's tangent.",
    )


def check_contents(scene: Scene, scheme: Any) -> None:
    """Refuse a scheme that does not take what a scene holds, before anything is computed."""
    reason = Declared.by(scheme).refuse(scheme.name, contents_of(scene))
    require(not reason, reason)
