"""What the next attempt of a run with a tolerance is made with: fewer or more steps, modes, elements.

Spaces and modes of solids come first, with steps as they are: runs that are compared for them may be coarse in time. Steps
are then made as small as what is left of the tolerance asks for; at once, where the next error in space can be foreseen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ....errors import InputError, require
from ....schemes.error_norm import FINEST
from ....system.scene.refinement import cheap_levels, expected_rate, meshed_bodies, modal_bodies, refined, slender
from ....system.scene.scene import Scene
from ...loads_ahead import loads_ahead
from ...recording.output import Output
from ...result import Run
from ...schedule import StepSchedule, step_schedule
from ..certificate import FLOOR, KINDS, Certificate, moving
from ..deviation import Deviation
from ..equal_steps import NEAREST, Orders
from ..estimates import usual_power
from ..jumps_in_time import jumps_about_kinks, with_break_points
from ..larger_steps import MEAN_ORDER, SLOW
from ..orders import MOST_LEFT, expected_orders, highest_order, resolved
from .shared_spaces import SharedSpaces
from .shares import AIM, ITERATED, WHOLE, Tolerance, check_floor, largest_share, share
from .space_levels import UNENDED

if TYPE_CHECKING:
    from .attempts import Attempt

LEAST = 0.65  # of smaller changes of the step the runs cost more than they save
NEAR, FAR = 1 / 4, 1 / 128  # most that a step is made smaller at once, without and with the order of the scheme seen
BESIDE = 0.3  # share for time beside errors of space or modes that are brought below their limits in the same attempt
BOTH = 0.6  # part of it for each of space and modes, where there are both
SMALL = 0.5  # part of what it is allowed up to which an error is not estimated again when the other kind is refined
TIGHTER = 0.05  # share of the tolerance that Newton's iteration is brought to leave, where it left too much
LEAST_NEWTON = 1e-12  # tolerance of Newton's iteration: roundoff is above smaller ones
SURE = 0.7  # of a tolerance, or an error, that is thought to be small enough, where a run with it has to be made
# the same of steps of high orders that a scheme has chosen, whose error larger ones tell by less beside refused ones
SURER = 0.4
FALLS = 1.1  # ratio by which errors in space have to fall when meshes are refined
LAST = 10.0 * FINEST  # tolerance of a scheme of which a run with a tenth tells the error


@dataclass(frozen=True)
class Known:
    """Errors of space and modes, by kind, that still hold, and what could not be stated of the error in space."""

    errors: Mapping[str, dict[str, Deviation]] = field(default_factory=dict)
    unstated: str = ""


@dataclass(frozen=True)
class AttemptPlan:
    """What an attempt is made with.

    ``steps``: their number, a multiple of ``grain``; 0 for schemes with error control. ``known``: errors that need no new
    estimate. ``orders``: of time, seen with other spaces. ``before``: level of the meshes and error in space over the
    tolerance of the attempt before they were refined last. ``below``: the scene with the meshes of each level below. ``finest``:
    why there are none finer.
    """

    scene: Scene
    scheme: Any
    schedule: StepSchedule
    grain: int
    meshes: int = 0
    modes: int = 0
    known: Known = field(default_factory=Known)
    orders: Orders = field(default_factory=Orders)
    before: tuple[int, float] | None = None
    below: tuple[Scene, ...] = ()
    finest: str = ""

    @property
    def steps(self) -> int:
        """Number of equal steps; 0 with error control."""
        return self.schedule.steps

    @property
    def step(self) -> float:
        """Size of the steps (s), or rtol."""
        return self.schedule.t_end / self.steps if self.steps else self.scheme.rtol


@dataclass(frozen=True)
class Looked:
    """The plan with finer meshes after a look at the error in space: each sensor's, and the largest over its tolerance."""

    plan: AttemptPlan
    errors: dict[str, float]
    over: float


def beginning(plan: AttemptPlan) -> AttemptPlan:
    """The plan of a first attempt in spaces that cost hardly more than coarser ones: systems of few unknowns are made and solved
    in the time that it takes to make any.
    """
    scenes, levels = [plan.scene], cheap_levels(plan.scene)
    for _ in range(0 if plan.scene.contacts else levels):
        try:
            scenes.append(refined(scenes[-1]))
        except InputError:
            break
    return replace(plan, scene=scenes[-1], meshes=len(scenes) - 1, below=tuple(scenes[:-1]))


def on_coarser_meshes(plan: AttemptPlan, error: InputError) -> AttemptPlan:
    """The plan on the level below, where its own meshes are refused by an ``error``, as those that a form has no value on."""
    scene, why = plan.below[-1], f"meshes of level {plan.meshes} are refused: {error}"
    return replace(
        plan, scene=scene, below=plan.below[:-1], meshes=plan.meshes - 1, known=Known(), before=None, finest=why
    )


def looking(wanted: Output) -> Output:
    """What runs are asked for that only tell an error, where a whole one is asked for the wanted output."""
    output = replace(wanted, every=1, energy=False, ledger=False, estimate_error=False)
    return replace(output, snapshots=0, on_step=None, events=())


def space_first(plan: AttemptPlan, tol: Tolerance, shared: SharedSpaces, wanted: Output) -> Looked | None:
    """A look at meshes that are new, by runs with the fewest steps that follow the motion; None where they are fine enough.

    These runs serve the whole attempt too. Where errors fall more slowly than expected, at corners, it is spared; collective.

    Raises ConvergenceError or LinearSolveError where these steps are too few: a run does not end, or only with steps in parts.
    """
    few = plan.orders.follow
    if "space" in plan.known.errors or not 0 < few < plan.steps or not meshed_bodies(plan.scene):
        return None

    seen = shared.look(plan.scene, plan.scheme, plan.schedule.with_steps(few), looking(wanted))
    spans, limit = moving(seen.recorder.series, plan.scene.sensors, FLOOR), space_limit(plan.scene)
    check_floor(plan.scene, spans, tol)
    errors, unstated = shared.space_error(
        plan.scene, [seen], plan.below, lambda x: largest_share(x, spans, tol) <= limit
    )
    if unstated or not errors:
        return None

    over = shared.looked[id(plan.scene)] = largest_share(errors, spans, tol)
    if over <= limit or (plan.before is not None and over > plan.before[1] / FALLS):
        return None  # fine enough, or no better than coarser ones: the whole attempt tells what is the matter
    try:
        made = _finer_meshes(plan, over, limit, shared)
    except InputError:
        return None  # the whole attempt tells why
    return Looked(made, {n: errors[n].size for n in tol}, over)


def next_plan(
    plan: AttemptPlan,
    run: Run,
    tol: Tolerance,
    *,
    certificate: Certificate,
    shared: SharedSpaces,
    history: Sequence[Attempt],
) -> tuple[AttemptPlan | None, str]:
    """The next plan and what it changes, or None and why there is none; collective where meshes are refined."""
    if run.space_unstated.startswith(UNENDED):
        return _with_steps_that_end(plan, run, history)
    over = {kind: max(share(certificate, n, x, kind) for n, x in tol.items()) for kind in KINDS}

    # the iteration first, which is part of every run
    done = []
    if over["algebra"] > ITERATED:
        if why := _iterate_further(shared, over["algebra"]):
            return None, why
        over["algebra"], done = TIGHTER, ["a smaller tolerance of Newton's iteration"]

    # spaces
    limits = _limits(over)
    if _unresolved(plan, run, tol):
        limits |= {k: max(limits[k], over["time"]) for k in ("space", "modes")}
    if why := _do_not_fall(plan, over["space"], limits["space"], certificate.unstated.get("space", "")):
        return None, why
    try:
        made, changes = _finer_spaces(plan, run, (over, limits), shared)
    except InputError as error:
        known = certificate.unstated.get("space")
        return None, f"{error}" + (f" Of its error in space: {known}." if known else "")

    # steps
    done += changes
    unseen, wanted = not np.isfinite(over["time"]), max(limits["time"], BESIDE if changes else 0.0)
    if done and not (unseen or over["time"] > wanted):
        return made, " and ".join(done)

    factor = 0.25 if unseen else _factor(plan, run, tol, shares=(over["time"], wanted))
    finer = finer_steps(plan, factor)
    if not plan.steps:
        finer = replace(finer, scheme=shared.tighter(made.scene, finer.scheme, _sure(run)))
    if run.halved and not changes:
        finer = _as_half_tells(plan, run, tol, finer)
    made = replace(made, scheme=finer.scheme, schedule=max(made.schedule, finer.schedule, key=lambda x: x.steps))
    if not made.steps and made.scheme.rtol >= plan.scheme.rtol:
        return None, "the scheme's tolerance is at roundoff"
    return made, " and ".join([*done, "finer steps"])


def _unresolved(plan: AttemptPlan, run: Run, tol: Tolerance) -> bool:
    """Whether other steps show another motion than these: what finer spaces change in it is chance, as far as it is less than
    that, and they would bring vibrations that need still smaller steps.
    """
    return bool(plan.steps) and not _order(run, tol)[1]


def _as_half_tells(plan: AttemptPlan, run: Run, tol: Tolerance, finer: AttemptPlan) -> AttemptPlan:
    """The plan for finer steps where half of the last ones told the error: at least these, whose run is there, or, where no
    larger ones tell anything, steps as small as both runs can tell.
    """
    least = round(2 * plan.steps * (NEAREST if _none_seen(run, tol) else 1.0))
    return finer if finer.steps >= least else replace(finer, schedule=finer.schedule.with_steps(least))


def _none_seen(run: Run, tol: Tolerance) -> bool:
    """Whether no order in the steps was seen in the sensors with a tolerance."""
    return not any(np.isfinite(run.observed_order.get(n, np.nan)) for n in tol)


def _with_steps_that_end(plan: AttemptPlan, run: Run, history: Sequence[Attempt]) -> tuple[AttemptPlan | None, str]:
    """The plan for finer spaces in which the last steps did not end: smaller ones, once."""
    tried = [a for a in history if (a.meshes, a.modes) == (plan.meshes, plan.modes) and a.errors and np.isinf(a.worst)]
    return (None, run.space_unstated) if tried else (finer_steps(plan, NEAR), "finer steps")


def _iterate_further(shared: SharedSpaces, over: float) -> str:
    """Let Newton's iteration leave less, where its errors are so many times the tolerance; why that cannot be, or nothing."""
    smaller = shared.newton.tolerance * TIGHTER / over
    if shared.newton_is_given:
        return f"Newton's tolerance is too large: give newton=fmbd.Newton(tolerance={smaller:.0e})"
    if smaller < LEAST_NEWTON:
        return "Newton's iteration leaves more than that, by the roundoff of its increments"
    shared.iterate_to(smaller)
    return ""


def _do_not_fall(plan: AttemptPlan, over: float, limit: float, unstated: str) -> str:
    """That finer meshes have not helped, where they have not; ``over``: errors in space over the tolerance, not finite where they
    are ``unstated`` for that reason.
    """
    before = np.inf if plan.before is None else plan.before[1]
    if over <= limit or over <= max(before / FALLS, 1.0):
        return ""
    if unstated and np.isinf(over):
        return f"errors in space are not known once the meshes were refined: {unstated}"
    return (
        f"errors in space do not fall with the cells: {before:.2g} times the tolerance, {over:.2g} times after the meshes were "
        "refined. The sensor sees a singular corner, or jumps: take one that is a mean over a surface or over time"
    )


def _finer_spaces(
    plan: AttemptPlan, run: Run, errors: tuple[dict[str, float], dict[str, float]], shared: SharedSpaces
) -> tuple[AttemptPlan, list[str]]:
    """The plan with finer meshes and more modes where ``errors`` over the tolerance are above their limits, what it changes, and
    what is known of its errors; collective. Raises InputError where meshes cannot be refined.
    """
    (over, limits), made, done = errors, plan, []
    if over["space"] > limits["space"]:
        made = _finer_meshes(made, over["space"], limits["space"], shared)
        done.append("finer meshes")
    if over["modes"] > limits["modes"]:
        scene, *below = (shared.with_more_modes(x, run.system) for x in (made.scene, *made.below))
        made = replace(made, scene=scene, modes=made.modes + 1, below=tuple(below))
        done.append("more modes")

    return replace(made, known=_still_known(plan, made, run, over, limits)), done


def jumps_before(plan: AttemptPlan, shared: SharedSpaces) -> tuple[float, ...]:
    """Instants at which loads jump, or come and go, as a first plan shows before it is run; elastic bodies are asked by compiled
    code, once there is a run, which takes less; collective.
    """
    if meshed_bodies(plan.scene):
        return ()
    built = shared.ahead(plan.scene)
    return loads_ahead(plan.scene, plan.scheme, built.system, built.given, plan.schedule)


def jumps_within(plan: AttemptPlan, run: Run, tol: Tolerance, *, first: bool) -> tuple[float, ...]:
    """Instants at which loads jump, or come and go, all along the ``first`` run of bodies that deform, else jump about kinks;
    collective.
    """
    slow = first and bool(meshed_bodies(plan.scene))
    seen = loads_ahead(plan.scene, plan.scheme, run.system, run.state, plan.schedule) if slow else ()
    return seen or jumps_about_kinks(run, plan.schedule, tol)


def ending_at(plan: AttemptPlan, jumps: tuple[float, ...], shared: SharedSpaces) -> AttemptPlan:
    """The plan with steps of about the same size that end at ``jumps`` (s), too; what is known of spaces and modes holds."""
    scene, *below = (with_break_points(x, jumps) for x in (plan.scene, *plan.below))
    made = replace(plan, scene=scene, below=tuple(below), orders=Orders())
    t_end, largest = plan.schedule.t_end, plan.schedule.largest
    if not plan.steps:
        dt = largest if np.isfinite(largest) else None
        return replace(made, schedule=step_schedule(scene, plan.scheme, t_end, dt))
    schedule = step_schedule(scene, plan.scheme, t_end, plan.step, multiple=4, at_samples=True)
    shared.grain = max(round(plan.grain * schedule.steps / plan.steps), 1)
    return replace(made, schedule=schedule, grain=shared.grain)


def _still_known(
    plan: AttemptPlan, made: AttemptPlan, run: Run, over: Mapping[str, float], limits: Mapping[str, float]
) -> Known:
    """Errors of a run that hold for the next plan: what is small does not grow when only the other kind is refined."""
    changed = {"space": made.meshes != plan.meshes, "modes": made.modes != plan.modes}
    other = {"space": "modes", "modes": "space"}
    keeps = [k for k in changed if not changed[k] and (not changed[other[k]] or over[k] <= SMALL * limits[k])]
    return Known({k: run.deviations.get(k, {}) for k in keeps}, run.space_unstated if "space" in keeps else "")


def space_limit(scene: Scene) -> float:
    """Share of the tolerance that the error in space may take of itself."""
    return AIM * (BOTH if modal_bodies(scene) else 1.0)


def _limits(over: Mapping[str, float]) -> dict[str, float]:
    """Shares of the tolerance below which spaces, modes and time are left alone: what is fixed first leaves the rest to time."""
    kinds = sum(over[k] > 0 for k in ("space", "modes"))
    fixed = AIM if kinds < 2 else BOTH * AIM
    spent = sum(min(over[k], fixed) for k in ("space", "modes")) + over["algebra"]
    return {"space": fixed, "modes": fixed, "time": WHOLE - spent}


def _finer_meshes(plan: AttemptPlan, over: float, limit: float, shared: SharedSpaces) -> AttemptPlan:
    """The plan with meshes refined as often as the rate seen so far asks for; raises InputError where that cannot be."""
    require(not plan.finest, plan.finest)
    rate = expected_rate(plan.scene)
    if plan.before is not None and np.isfinite(plan.before[1]):
        rate = float(np.clip((plan.before[1] / over) ** (1.0 / (plan.meshes - plan.before[0])), 2.0, 16.0))
    solid = any(b.meshed and b.dim == 3 for b in plan.scene.bodies.values())
    exact = np.log(over / limit) / np.log(rate) if np.isfinite(over) else 1.0
    wanted = int(np.ceil(exact - 0.1) if _foreseen(plan) and np.isfinite(over) else exact + 0.5)
    one_by_one = solid or bool(plan.scene.contacts)  # dear, or of a rate that nobody knows
    levels = min(max(wanted, 1), 1 if one_by_one else 5 if slender(plan.scene) else 3)

    scenes = [*plan.below, plan.scene]
    for level in range(levels):
        try:
            scenes.append(shared.refined(scenes[-1], limit / over if levels == 1 else 0.0))
        except InputError:
            if not level:
                raise
            break  # as fine as they get
    made = replace(plan, scene=scenes[-1], meshes=len(scenes) - 1, below=tuple(scenes[:-1]))
    modes = {k: x for k, x in plan.known.errors.items() if k == "modes"}
    return replace(made, known=Known(modes), before=(plan.meshes, over))


def _foreseen(plan: AttemptPlan) -> bool:
    """Whether the next error in space can be told in advance: from a rate that was seen, or of slender bodies."""
    return plan.before is not None or slender(plan.scene)


def _factor(plan: AttemptPlan, run: Run, tol: Tolerance, *, shares: tuple[float, float]) -> float:
    """By what steps, or the scheme's tolerance, are multiplied, so that the error of time falls from one share to another."""
    now, wanted = shares
    if plan.steps:
        order, regular = _order(run, tol)
        most = FAR if regular else NEAR
        sure = SURE if run.halved and _none_seen(run, tol) else 1.0  # larger ones do not even end, or have kinks
        return float(np.clip((sure * wanted / now) ** (1.0 / order), most, LEAST))

    return float(np.clip(_sure(run) * (wanted / now) ** (1.0 / usual_power(run.scheme)), 1e-6, 0.5))


def _sure(run: Run) -> float:
    """The share of a scheme's tolerance, thought to be small enough, with which a run is made."""
    return SURER if SLOW * run.counters.get(MEAN_ORDER, 0.0) > MOST_LEFT else SURE


def _order(run: Run, tol: Tolerance) -> tuple[float, bool]:
    """The lowest order seen in the sensors with a tolerance, from 1/2 to the scheme's; whether all are those expected."""
    orders = expected_orders(run.scheme, run.scene, run.system)
    seen = {n: run.observed_order.get(n, np.nan) for n in tol}
    known = {n: p for n, p in seen.items() if np.isfinite(p)}
    if not known:
        return float(min(orders[n] for n in tol)), True
    return float(np.clip(min(known.values()), 0.5, highest_order(run.scheme, run.system))), resolved(known, orders)


def finer_steps(plan: AttemptPlan, factor: float) -> AttemptPlan:
    """Smaller steps by a factor below one, rounded to whole grains; or a smaller tolerance of the scheme."""
    if not plan.steps:
        rtol = min(max(plan.scheme.rtol * factor, LAST), plan.scheme.rtol)
        return replace(plan, scheme=replace(plan.scheme, rtol=rtol))
    grains = int(np.ceil(plan.steps / factor / plan.grain - 1e-9))
    return replace(plan, schedule=plan.schedule.with_steps(grains * plan.grain))
