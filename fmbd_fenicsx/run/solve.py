"""A run of a scene: checked settings, a system, one run of it, error estimates; one answer on all ranks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import require
from ..schemes.declared import Declared, checked_scheme
from ..schemes.newton import Newton
from ..system.scene.alike import alike
from ..system.scene.scene import Scene
from .accuracy.companion_runs import steps_beside
from .built import build
from .recording.output import Output
from .result import Run
from .schedule import step_schedule
from .settings import (
    check_contents,
    check_is_of_sensors,
    check_origin,
    check_settings,
    check_tangent,
    check_ways,
    default_scheme,
)
from .single_run import Task, run_once

if TYPE_CHECKING:
    from .checkpoints.checkpoint import Checkpoint


@alike
def solve(
    scene: Scene,
    *,
    t_end: float,
    dt: float | None = None,
    scheme: Any = None,
    tol: Mapping[str, Any] | None = None,
    newton: Newton | None = None,
    output: Output | None = None,
    linear: Any = None,
    checkpoint: Checkpoint | None = None,
    restart: str | Path | None = None,
) -> Run:
    """Integrate a scene from t = 0, or from where it goes on, to ``t_end`` (s) with steps of at most ``dt`` (s); collective.

    Args:
        dt: needed for schemes with constant steps. A scheme with error control (``rtol``) chooses its steps,
            none above dt.
        scheme: a scheme object; :class:`GeneralizedAlpha` with rho_inf = 0.8 by default, ``ContactMidpoint``
            with contact.
        tol: sensor name -> largest error (in the sensor's unit, or :func:`relative` to its range) that the run may state of
            itself. Steps, modes and meshes are refined until the certificate is below; ``dt`` and the scene are where it
            starts. Every attempt is a line of ``run.history``; where the tolerance is not reached the best run is given, with
            a warning that says why.
        newton: tolerance and limits of Newton's iteration.
        output: what is recorded how often, and whether the time-discretisation error is estimated.
        linear: how elastic bodies and ties are solved: :class:`Direct` (the default), :class:`Schur`,
            :class:`FieldSplit`. PETSc's options of a block are those under ``-<scene>_<block>_``, of a split
            ``-<scene>_fieldsplit_<block>_``, spaces written as ``_``.
        checkpoint: where and how often the run is kept; signals and a file STOP then end it so that it can go on.
        restart: a checkpoint, or a folder of them whose newest is taken, from which the run goes on; None starts at t = 0.

    Raises:
        InputError: unusable arguments. ConstraintError: the bodies do not fit. ConvergenceError: a step
            failed.
        Stopped: Ctrl-C in a serial run, or a request to stop with a ``checkpoint``; ``run`` of the exception holds the run up
            to the step that was under way.
        CheckpointError: a checkpoint is damaged, belongs to another run, or cannot be written.
    """
    check_settings(scene, newton, output, restart)
    check_ways(linear, checkpoint)
    check_origin(scene, tol, output)
    if tol is not None:
        check_is_of_sensors(scene, tol)
        if scheme is not None:
            check_contents(scene, checked_scheme(scheme))
        from .accuracy.search.tolerance import solve_within

        require(
            checkpoint is None and restart is None, "A run with tol is made of several runs: no checkpoint, no restart."
        )
        return solve_within(scene, dict(tol), t_end=t_end, start=(scheme, dt), settings=(newton, output, linear))

    scheme = default_scheme(scene) if scheme is None else checked_scheme(scheme)
    output = Output() if output is None else output
    newton = Newton() if newton is None else newton.afresh()
    check_tangent(scheme, newton)
    check_contents(scene, scheme)
    halvings = output.estimate_error and not Declared.by(scheme).adaptive
    schedule = step_schedule(scene, scheme, t_end, dt, multiple=4 if halvings else 1)

    beside = (
        steps_beside(scene, output, schedule)
        if output.estimate_error and checkpoint is None and restart is None
        else None
    )
    task = Task(scene, scheme, schedule, newton, linear, output, beside=beside)
    solved = run_once(task, build(scene), checkpoint=checkpoint, restart=restart)
    if output.estimates:
        from .accuracy.estimates import state_errors

        state_errors(solved.run, solved.problem, solved.compared, output)
    return solved.run
