"""Whether the arguments of :func:`fmbd_fenicsx.solve` are what they are called, and the scheme where none is given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..checks import instance, shown
from ..errors import InputError, require
from ..schemes.dae import Index3
from ..schemes.declared import Declared
from ..schemes.newton import Newton
from ..schemes.onestep.alpha.generalized_alpha import GeneralizedAlpha
from ..system.scene.contents import contents_of
from ..system.scene.scene import Scene
from .recording.output import ROUNDING, Output

USUAL = GeneralizedAlpha()  # frozen: all runs may share it


def check_settings(scene: Any, newton: Any, output: Any, restart: Any) -> None:
    """Refuse classes in the place of objects, names, dictionaries."""
    instance("solve: scene", scene, Scene)
    if newton is not None:
        instance("solve: newton", newton, Newton)
    if output is not None:
        instance("solve: output", output, Output)
        require(
            output.times is None or output.every == 1,
            f"Output: every = {output.every} counts steps, and records at given times know none; give one of them.",
        )
    require(
        restart is None or isinstance(restart, str | Path),
        f"solve: restart {shown(restart)} must be a folder: a string, a path, or checkpoint.newest.",
    )


def check_ways(linear: Any, checkpoint: Any) -> None:
    """Refuse classes and names for what is loaded only where it is given: the linear solver, and checkpoints."""
    if linear is not None:
        from ..linear.presets import Preset

        instance("solve: linear", linear, Preset)
    if checkpoint is not None:
        from .checkpoints.checkpoint import Checkpoint

        instance("solve: checkpoint", checkpoint, Checkpoint)


def check_origin(scene: Scene, tol: Any, output: Output | None) -> None:
    """Refuse what other modes or meshes would tell of a scene that goes on from the state of a run."""
    if scene.origin is None:
        return
    finer = output is not None and (output.estimate_space or output.estimate_reduction)
    require(
        tol is None and not finer,
        f'Scene "{scene.name}" goes on from a run, with its meshes and modes: neither tol nor errors of space and reduction. '
        "Ask the run before for them.",
    )


def check_is_of_sensors(scene: Scene, tol: Any) -> None:
    """Refuse a tolerance that names no sensor: what it allows depends on what is measured."""
    name = next(iter(scene.sensors), "tip")
    given = f"{tol:g}" if isinstance(tol, int | float) else "1e-3"
    require(
        isinstance(tol, Mapping),
        f"solve: tol {shown(tol)} names no sensor. Give each sensor that matters its tolerance, in its unit or as a share of its "
        f'range: tol={{"{name}": {given}}}, tol={{"{name}": fmbd.relative(1e-3)}}.',
    )


def check_times(times: Sequence[float], ends: tuple[float, float]) -> None:
    """Refuse times (s) to record at before a run begins or when it is over; ``ends``: when that is (s)."""
    begin, t_end = ends
    require(
        times[0] >= begin * (1 - ROUNDING),
        f"Output: times begin at {times[0]:g} s, and the run goes on from {begin:g} s. Leave out those before.",
    )
    after = sum(t > t_end * (1 + ROUNDING) for t in times)
    if after:
        raise InputError(
            f"Output: times go up to {times[-1]:g} s, and the run ends at t_end = {t_end:g} s: {after} of {len(times)} would "
            "never come. Leave them out, or take a larger t_end."
        )


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


def default_scheme(scene: Scene) -> Any:
    """Generalized-alpha; for contact of elastic bodies the contact-implicit midpoint rule; with stops of joints, or where rigid
    or reduced bodies or rods touch, the scheme with impacts.
    """
    if not scene.unilateral:
        return USUAL
    if scene.limits or any(pair.bounces for pair in scene.contacts.values()):
        from ..schemes.impacts.moreau import Moreau

        return Moreau()
    from ..schemes.impacts.contact_midpoint import ContactMidpoint

    return ContactMidpoint()
