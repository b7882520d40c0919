"""What a run that ended says against itself: energy that grew, steps that failed, impacts seen in a few steps, open velocities.

    E_max - E_0  >  0.02 (T + V + m g L) + R                      where nothing puts energy into the scene            (1)
                                                                  (an overshoot of the first steps is told from growth;
                                                                  R: energy of roundoff, as in the energy guard)
    |G v + g_t| u_i  >  0.02 max |v|,  > 100 eps L / h            largest velocity in an open joint                  (2)
    |g|  >  1e-3 L                                                under forms that hold no positions                 (3)
    min_dq |g + G dq|  >  1e-8 L + 10 |g|^2 / L                   the same, beside dependent rows, at the end        (4)
    halvings  >=  10, or one in twenty steps
    h |w|  >  1                                                  what a body turns by in one of equal steps, rad       (5)

Each is a warning: on standard error, and in the report under "look at this".
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..linear.condensation import StepSolver
from ..log import log
from ..rotations import Array
from ..schemes.consistent import MASS, worst_block
from ..system.impossible_shapes import inside_out
from ..system.layout import State
from ..system.mobility import tell_of_modes
from ..system.scene.scene import Scene
from ..system.system import System
from .judges.energy_check import isolated, lossless, roundoff_energy, strain_energy
from .recording.recorder import Recorder

GROWTH = 0.02
SLIP = 0.02
APART = 1e-3  # of the model's length
CONTRADICTS, CURVES = 1e-8, 10.0  # of the model's length; times the square of a gap over it
PLACES = 100 * float(np.finfo(float).eps)  # of the model's length, roundoff of places in one step
HALVINGS = 10
SHARE = 0.05  # of the steps
TURN = 1.0  # rad
LOST = 0.05  # share of the energy that one step takes from what nothing takes any
SETTLING = 10  # records, of the first steps
CHATTER = 0.1  # of the impacts may be short: a body that comes to rest


def warn_of_doubts(
    scene: Scene,
    solver: StepSolver,
    recorder: Recorder,
    counters: Mapping[str, float],
    ends: tuple[State, State],
    size: float,
    *,
    remembers: bool,
) -> None:
    """Say what is doubtful in a run between two states; ``size``: of its equal steps (s), 0 of others; collective.

    ``remembers``: whether what accelerations leave across rows on positions goes on from step to step, see
    :mod:`.judges.turning_rows`.
    """
    start, end = ends
    system = solver.system
    energy, times = recorder.energy, recorder.times
    if energy and isolated(scene, system):
        _growth(system, energy, times, start)
    if energy and lossless(scene, system):
        _loss(energy, times)

    # what tells of wrong places comes before what tells of their rates
    _open_joints(recorder)
    _contradictions(solver, recorder, end)
    _immovable(solver)
    _turns(system, recorder, size)
    _open_velocities(recorder, counters, remembers)
    if system.keepers:
        _chatter(system)
    _passed_over(system, end.t)
    _impacts(counters)
    if system.fields and (body := inside_out(system, end.q)):
        log.warning(
            'body "%s" has cells that are turned inside out at the end: its energy lets them, no material does. Take a smaller '
            "dt, another mesh there, or a law that grows with ln J, as materials.neo_hookean does", body,
        )  # fmt: skip
    tell_of_modes(system.at(start.t, start.q))


def _growth(system: System, energy: dict[str, Array], times: Array, start: State) -> None:
    """(1): steps that each gain little are not refused, many of them add up."""
    total: Array = sum(energy.values(), start=np.zeros(len(times)))
    turnover = max(float(np.max(energy["kinetic"] + energy["elastic"] + np.abs(energy["springs"]))), 0.0)

    weight = system.mass * system.gravity.size * system.length

    growth = float(np.max(total) - total[0])
    step = float(np.min(np.diff(times), initial=np.inf))  # between two records
    much = GROWTH * (turnover + weight)
    if growth <= much or growth <= much + roundoff_energy(system, start.q, step, strain_energy(system)):
        return

    # only at first: the start, not the step, is to blame
    if np.argmax(total) <= SETTLING < 0.2 * len(total) and total[-1] - total[0] <= much:
        log.warning(
            "the energy rises by %.3g J (from %.6g J to %.6g J) in the first steps and falls again: the start contains "
            "vibrations that the step does not resolve, which the scheme overshoots and then damps. Begin from a shape in "
            "equilibrium, or take a smaller dt or fmbd.EnergyMomentum()",
            growth, total[0], np.max(total),
        )  # fmt: skip
    else:
        log.warning(
            "the energy grows by %.3g J (from %.6g J to at most %.6g J) although nothing puts energy into the scene: the step "
            "does not follow the motion. Take a smaller dt%s",
            growth, total[0], np.max(total), ", fmbd.Radau() or fmbd.EnergyMomentum()" if system.contacts is None else "",
        )  # fmt: skip


def _loss(energy: dict[str, Array], times: Array) -> None:
    """Energy that is gone within a step: of what struck a stop and left it again, or stayed."""
    total: Array = sum(energy.values(), start=np.zeros(len(times)))
    turnover = float(np.max(energy["kinetic"] + energy["elastic"] + np.abs(energy["springs"])))
    lost = total[:-1] - total[1:]
    if np.max(lost, initial=0.0) > LOST * turnover:
        k = int(np.argmax(lost))
        log.warning(
            "t = %.6g s: %.0f %% of the energy is lost in a step of %.3g s, and nothing takes any: a stop, or another stiff "
            "part, is struck and left within it. Take a smaller dt or rtol, or fmbd.Radau() with its own steps",
            times[k + 1], 100 * min(lost[k] / turnover, 1.0), times[k + 1] - times[k],
        )  # fmt: skip


def warn_of_halvings(counters: Mapping[str, float]) -> None:
    """What steps found hard: said last, as it tells least of where the motion went wrong."""
    count = counters.get("halved_steps", 0.0)
    steps = max(counters["steps"], 1.0)
    back = counters.get("energy_rejections", 0.0)
    if count >= HALVINGS or count > SHARE * steps:
        log.warning(
            "%d steps or parts of steps failed and were made in halves, in %d steps: dt is too large for this motion, or a "
            "spring, damper or contact too stiff for the tangent. Take a smaller dt, or see docs/running.md", count, steps,
        )  # fmt: skip
    elif back > 0:
        log.warning(
            "%d of %d steps gained energy from nothing and were repeated in parts, without it: dt is too large for how fast "
            "a part turns there, or how stiff it is. Compare with half of it", back, steps,
        )  # fmt: skip


def _turns(system: System, recorder: Recorder, size: float) -> None:
    """(5): no polynomial over a step, and no tangent of it, follows what turns so far."""
    turn = size * recorder.drift.turning
    if turn > TURN:
        log.warning(
            "bodies turn by up to %.2g rad a step: what changes with their attitude is hardly seen, and the motion may be "
            "another. Take dt = %.2g s or less%s",
            turn, 0.5 * TURN * size / turn,
            ", or a scheme with its own steps, such as fmbd.Radau()" if system.contacts is None else "",
        )  # fmt: skip


def _chatter(system: System) -> None:
    """Dry friction that no step holds: its point goes to and fro over the limits."""
    if names := [name for loads in system.forces for name in loads.chattering]:
        log.warning(
            "%s: dry friction goes from limit to limit and back from step to step where it should hold, and may creep: steps do "
            "not resolve its stiffness before sliding, sqrt(stick / mass) dt > 2. Take a smaller dt or stick, or an implicit "
            "scheme, such as fmbd.GeneralizedAlpha() or fmbd.Radau()",
            ", ".join(f'"{name}"' for name in names),
        )  # fmt: skip


def _passed_over(system: System, t: float) -> None:
    """Laws of coordinates that do something between the places where steps have asked them."""
    for loads in system.forces:
        for x in loads.passed_over(t):
            log.warning(
                '"%s": its law, or road, goes to %.3g at s = %.6g, which steps pass over: they ask it at %.6g and %.6g. Runs '
                "that tell errors may pass over it, too. Take a dt in which s moves less, also with steps of a scheme's own "
                "choice",
                x.name, x.effort, x.at, *x.between,
            )  # fmt: skip


def _impacts(counters: Mapping[str, float]) -> None:
    """Impacts of elastic bodies that only a few steps have seen."""
    short = counters.get("short_impacts", 0.0)
    all_of_them = counters.get("impacts", 0.0)
    if short > CHATTER * all_of_them:
        log.warning(
            "%d of %d impacts lasted three steps or less: what they give back depends on the step. Take a dt of at most a tenth "
            "of the time in contact, and compare with half of it", short, all_of_them,
        )  # fmt: skip


def _open_velocities(recorder: Recorder, counters: Mapping[str, float], remembers: bool) -> None:
    """(2), above what roundoff of places is in one step: a scene at rest moves by nothing else."""
    drift = recorder.drift
    if drift.closed is None or drift.worst_slip <= SLIP * drift.fastest:
        return
    step = (recorder.t_end - recorder.scene.begins) / max(counters["steps"], 1.0)
    if drift.worst_slip * step <= PLACES * recorder.system.length:
        return
    log.warning(
        "joints open at up to %.2g m/s (or rad/s times the model's length), the largest velocity is %.3g m/s: velocities and "
        "accelerations are less accurate than positions%s a smaller dt, or a scheme that holds velocities too, such as "
        "fmbd.Radau()",
        drift.worst_slip, drift.fastest,
        ", and reactions may alternate from step to step and grow. Take form=fmbd.GGL(), a smaller rho_inf," if remembers
        else ". Take",
    )  # fmt: skip


def _open_joints(recorder: Recorder) -> None:
    """(3): forms of lower index let joints drift apart, and large steps let them fly apart."""
    drift, length = recorder.drift, recorder.system.length
    if drift.closed is None or 0 in drift.closed.levels or drift.gap <= APART * length:
        return
    log.warning(
        "joints are open by up to %.2g m, the model's length is %.3g m: this form of the constraints does not hold positions. "
        "Take a smaller dt, or a form that holds them, such as fmbd.GGL()",
        drift.gap, length,
    )  # fmt: skip


def _contradictions(solver: StepSolver, recorder: Recorder, end: State) -> None:
    """(4): what no motion closes is no drift. Drives around a loop may ask for what bodies cannot reach."""
    system, drift = solver.system, recorder.drift
    holds = drift.closed is None or 0 in drift.closed.levels
    if holds or not solver.core.redundant or not system.prescribes:
        return
    ev = system.at(end.t, end.q)
    solver.prepare(ev, MASS)
    gap = ev.constraint()
    dq, _ = solver.solve(np.zeros(system.n_v), -gap)
    left = system.row_units * (gap + ev.jacobian.times(dq))
    length, open_by = system.length, float(np.abs(left).max())
    if open_by <= CONTRADICTS * length + CURVES * drift.gap**2 / length:
        return

    log.warning(
        "joints and drives contradict each other: at the end %s is open by %.2g m wherever the bodies go, and this form of the "
        "constraints does not hold positions. Take a drive away, or let it ask for what the others allow",
        worst_block(system, left), open_by,
    )  # fmt: skip


def _immovable(solver: StepSolver) -> None:
    """A scene that nothing drives and that cannot move: its motion is none."""
    system, core = solver.system, solver.core
    if system.fields or not system.n_lam or not system.n_core:
        return
    rank = system.n_lam if core.rank is None else core.rank
    driven = any(batch.driven for batch, _ in system.batches)
    if rank >= system.n_v and not driven and not core.uncounted:
        log.warning(
            "the scene has 0 degrees of freedom (%d velocities, %d independent constraints) and no drive: nothing can move. A "
            "joint holds more than is meant; see scene.check()", system.n_v, rank,
        )  # fmt: skip
