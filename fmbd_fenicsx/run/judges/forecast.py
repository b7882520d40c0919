"""How many steps a run will need: said once, with the fastest vibration of the scene, where it is far more than was asked for.

Every hundred steps the pace of the last hundred is carried on to the end. Steps of error control begin small, by a way that has
just begun: their pace is carried on as it has grown from a thousand of them to the next, before which nothing is said. The period
of a body on its springs is that of its own coordinates, all others held,

    T = 2 pi sqrt(M_ii / K_ii)                                                                                   (1)

with K the stiffness of springs, joint springs and other force elements. Elastic bodies have faster ones of their own. Where
a body in space turns by a tenth of what a step may turn it, its turning is what steps are for. Close to
a singular position, which the smallest singular value of G over the largest tells, no period is to blame: constraints almost
depend on each other there, and its inverse amplifies what they are open by. Error control that has fallen to a thousandth of its
pace there, and would need ten millions of steps, does not come away again: the run ends when that has gone on for some hundreds.
So does one whose forces are roundoff: where places known to eps |x| answer with accelerations above those of the motion,

    16 eps |x| K_ii / M_ii  >  0.1 (|g| + v^2 / L)                                                               (2)

and one that would need ten milliards of steps, as soon as a thousand of them are no longer than those before. Of parts that equal
steps are made in ten millions are enough.
"""

from __future__ import annotations

import numpy as np

from ...errors import ConvergenceError, PartsError
from ...linear.condensation import StepSolver
from ...linear.configuration_warnings import CLOSE
from ...log import log
from ...mechanics.forces.force_elements import ScalarLoads
from ...schemes.control import TURN
from ...schemes.newton import LEFT_OF_PLACES
from ...system.layout import State
from ...system.lengths import farthest
from ...system.mobility import nearly_dependent
from ...system.system import System
from ...system.tangents.force_tangent import force_tangent

EVERY = 100  # steps
MANY = 1e5  # steps that a user wants to be told of
TIMES = 10  # the planned ones, where steps are constant
HOPELESS = 1e7  # steps that a run at a singular position does not make, nor a run of equal steps in parts
FALLEN = 1e-3  # of the pace before
PATIENCE = 3  # looks, one after another
ENDLESS = 1e10  # steps that no run makes
STEADY = 1000  # steps whose pace is compared with that of as many before
GROWN = 1.001  # the least growth of a pace
DROWNED = 0.1  # of the accelerations of a motion
TURNING = 0.1 * TURN  # rad a step, from which on turning is to blame
RESOLVED = 1e7  # steps in a period, from which on it is not to blame for them
LOOKED_AT = 2000  # constraints up to which their singular values are found
NEARER = 0.1  # to a singular position than the start, times by which a step that fails is told of it


class Forecast:
    """Counts steps and parts of steps.

    ``planned``: how many a run has with constant steps, 0 with error control; ``largest``: what steps were to be at most (s).
    """

    def __init__(self, solver: StepSolver, t: float, t_end: float, planned: int, *, largest: float = np.inf) -> None:
        self.solver, self.t_end, self.planned = solver, t_end, planned
        self.asked = max(planned, (t_end - t) / largest)
        self.taken, self.said = 0, False
        self.begin(t)
        self.counted = 0  # steps at the time ``since``
        self.pace = 0.0  # s a step, the largest of all looks
        self.stuck = 0  # looks

    def begin(self, t: float) -> None:
        """Steps begin at t (s)."""
        self.since = t
        self.back = 0, t, 0.0  # steps, time and pace (s a step) of a look a thousand before

    def note(self, state: State, steps: int = 1) -> None:
        """So many more steps, or parts of steps, the last of which ended in ``state``; collective.

        Raises ConvergenceError where steps of error control, or parts of equal ones (PartsError), stay too small to end.
        """
        self.taken += steps
        recent = self.taken - self.counted
        if recent < EVERY:
            return

        advanced, self.since, self.counted = state.t - self.since, state.t, self.taken
        pace = advanced / recent
        self.pace = max(self.pace, pace)
        if advanced <= 0:
            return

        # as fast as of late up to the end
        growth, left = self._growth(state), (self.t_end - state.t) / pace
        needed = self.taken + left
        most = max(MANY, TIMES * self.asked)
        many = needed >= most
        if many and not self.said and (self.planned or growing(left, growth) >= most):
            self.said = True
            log.warning(
                "t = %g s: the last %d steps or parts of steps took %.2g s; at this pace the run needs about %.1e. %s",
                state.t, recent, advanced, needed, reason(self.solver, state, pace),
            )  # fmt: skip

        if self.planned:
            if many and needed >= HOPELESS and growth <= GROWN:
                raise endless(state.t, STEADY, pace, needed, reason(self.solver, state, pace), PartsError)
            return
        why = self._hopeless(state, pace, needed) if many else ""
        self.stuck = self.stuck + 1 if why else 0
        if self.stuck == PATIENCE:
            raise endless(state.t, PATIENCE * recent, pace, needed, why)
        if growth <= GROWN and needed >= max(ENDLESS, TIMES * self.asked):
            raise endless(state.t, STEADY, pace, needed, reason(self.solver, state, pace))

    def _hopeless(self, state: State, pace: float, needed: float) -> str:
        """Why steps of error control stay as small as they are, as sentences, or nothing; collective."""
        fallen = needed > HOPELESS and pace < FALLEN * self.pace
        if fallen and (near := singular(self.solver, state)):
            return near
        return drowned(self.solver, state)

    def _growth(self, state: State) -> float:
        """How many times as long as a thousand steps ago steps are, where so many were made since; infinite elsewhere."""
        taken, t, before = self.back
        steps = self.taken - taken
        if steps < STEADY:
            return np.inf
        pace = (state.t - t) / steps
        self.back = self.taken, state.t, pace
        return pace / before if before else np.inf


def growing(steps: float, growth: float) -> float:
    """How many steps it takes, of which ``steps`` would be left at this pace, where it grows so many times in a thousand."""
    if not 1.0 < growth < np.inf:
        return steps if growth <= 1.0 else 0.0
    rate = np.log(growth) / STEADY
    return float(np.log1p(rate * steps) / rate)


def endless(
    t: float, steps: int, pace: float, needed: float, why: str, kind: type[ConvergenceError] = ConvergenceError
) -> ConvergenceError:
    """The error of a run at t (s) whose last steps took ``pace`` (s) each."""
    return kind(
        f"Steps do not come away from t = {t:.9g} s: the last {steps} took {pace:.1e} s each, and the run would need about "
        f"{needed:.0e}. {why}"
    )


def reason(solver: StepSolver, state: State, pace: float = np.inf) -> str:
    """Why steps of ``pace`` (s) are small in a state, as far as it tells, as a sentence; collective."""
    named = singular(solver, state) or drowned(solver, state) or spinning(solver.system, state, pace)
    return named or fastest(solver, state, pace)


def singular(solver: StepSolver, state: State) -> str:
    """That a state is close to a singular position, as sentences, or nothing; collective."""
    s = solver.system
    if not 0 < s.n_lam <= LOOKED_AT or solver.core.uncounted:
        return ""
    ratio, joint = nearly_dependent(s.at(state.t, state.q, state.v), solver.core.rank or s.n_lam)
    if ratio >= CLOSE:
        return ""
    return (
        f"This is close to a singular position: constraints almost depend on each other (sigma_min/sigma_max = "
        f'{ratio:.1e}, joint "{joint}"), and small steps feel their roundoff. '
        "Take fmbd.Radau(form=fmbd.Projected(fmbd.Index1())) or fmbd.BDF with this form, a larger rtol, or larger constant steps "
        "of fmbd.GeneralizedAlpha(0.9)."
    )


def out_of_reach(solver: StepSolver, start: State, state: State) -> str:
    """That joints depend on each other far more in a state behind which a run does not come than at its start, as sentences, or
    nothing; collective.
    """
    s = solver.system
    if not 0 < s.n_lam <= LOOKED_AT or solver.core.uncounted:
        return ""
    ends = [s.at(x.t, x.q, x.v) for x in (start, state)]
    (before, _), (ratio, joint) = (nearly_dependent(ev, solver.core.rank or s.n_lam) for ev in ends)
    if not ratio < NEARER * before:
        return ""
    driven = bool(np.any(ends[1].constraint_rate()))
    return (
        f" The position before it is close to a singular one (sigma_min/sigma_max = {ratio:.1e}, {before:.1e} at the start, "
        f'joint "{joint}")'
        + (
            ": drives may lead where joints cannot follow, beyond a dead centre or the reach of a linkage."
            if driven
            else "."
        )
    )


def drowned(solver: StepSolver, state: State) -> str:
    """That roundoff of places moves a body on its springs more than forces do (2), as sentences, or nothing; collective."""
    s = solver.system
    ratio, body = stiffest(solver, state)
    if not ratio > 0:
        return ""
    known = LEFT_OF_PLACES * farthest(s, state.q)

    pushed = ratio * known
    moves = float(np.linalg.norm(s.gravity(state.t))) + s.max_abs(state.v) ** 2 / s.length
    if not pushed > DROWNED * moves:
        return ""
    return (
        f'Places are known to {known:.1e} m here, which the springs of body "{body}" answer with accelerations of {pushed:.1e} '
        f"m/s^2; those of the motion are {moves:.1e} m/s^2. Put the origin into the scene, replace stiff springs by joints, or "
        "give light bodies more mass."
    )


def spinning(system: System, state: State, pace: float) -> str:
    """The body in space that turns fastest, where that is what steps of ``pace`` (s) are for, as sentences, or nothing."""
    if system.motions.dim == 2 or not system.n_frames:
        return ""
    speeds = system.turning(state.v)
    k = int(speeds.argmax())
    speed = float(speeds[k])
    if not TURNING <= speed * pace < np.inf:
        return ""
    return (
        f'Body "{system.frame_names[k]}" turns at {speed:.3g} rad/s, by {speed * pace:.2g} rad a step, and steps turn bodies in '
        f"space by {TURN:g} rad at most, {TURN / speed:.2g} s here: larger ones do not follow it. Make the run shorter, or in "
        "the plane, where turns have no limit."
    )


def stiffest(solver: StepSolver, state: State, *, damping: bool = False) -> tuple[float, str]:
    """The largest K_ii / M_ii (1/s^2) of a coordinate of a frame and its body, or C_ii / M_ii (1/s) of ``damping``; 0 where no
    spring is there; collective.
    """
    s = solver.system
    ev = s.at(state.t, state.q, state.v)
    applied = force_tangent(ev, float(damping), float(not damping)) if s.forces else None
    if applied is None or applied.core is None or not s.n_frames:
        return 0.0, ""

    # diagonals: one coordinate of a frame at a time
    mass = np.asarray(solver.masses(ev).diagonal())
    ratio = np.asarray(applied.core.diagonal()) / np.where(mass > 0, mass, np.inf)
    ratio = ratio[: s.n_frames * s.motions.n_twist]
    k = int(np.argmax(ratio))
    return float(ratio[k]), s.frame_names[k // s.motions.n_twist]


def steepest(solver: StepSolver, state: State) -> str:
    """The law of an element that changes most with its rate, as sentences, or nothing where none does; collective."""
    s = solver.system
    ev = s.at(state.t, state.q, state.v)
    most, name = 0.0, ""
    for loads in s.forces:
        if isinstance(loads, ScalarLoads) and len(loads.own):
            elongations, rates, _ = loads.scalar(ev.kin, ev.t)
            slopes = np.abs(loads.slopes(loads.own, elongations[loads.own], rates[loads.own], ev.t)[1])
            k = int(np.argmax(slopes))
            if slopes[k] > most:
                most, name = float(slopes[k]), loads.forces[loads.own[k]].name

    if not most > 0:
        return ""
    return (
        f'No spring is to blame; the law of "{name}" changes by {most:.1e} N s/m (N m s of a turn) with its rate: make it '
        "less steep (smooth friction by a larger speed), or take fmbd.dry_friction."
    )


def fastest(solver: StepSolver, state: State, pace: float = np.inf) -> str:
    """The shortest period (1) and its body, or a law that answers sooner with its rate, as a sentence; collective."""
    (ratio, body), (drag, _) = stiffest(solver, state), stiffest(solver, state, damping=True)
    law = steepest(solver, state) if drag**2 > ratio else ""
    period = 2 * np.pi / np.sqrt(ratio) if ratio > 0 else np.inf
    if law or not period < RESOLVED * pace:
        return law or (
            "No spring is there to blame: look for a stiff law, an elastic body with a fine mesh, or a singular position."
        )
    return (
        f'The fastest period is {period:.2g} s, of body "{body}" on its springs: give it more mass or a '
        "softer spring, replace the spring by a joint, or take fmbd.EnergyMomentum()."
    )
