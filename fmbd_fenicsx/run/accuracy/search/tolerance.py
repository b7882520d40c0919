"""A run that keeps a tolerance: steps, modes and meshes are refined until the run states errors below it.

Every attempt is a whole run with its estimates. From its certificate follows what is too large, and by how much: the step from
the order that was seen, modes and meshes one level at a time (:mod:`.next_attempt`). Errors by modes and meshes change little
with the step, so they are estimated again only when bodies have changed; runs with larger steps, and systems, serve all attempts
(:mod:`.shared_runs`).
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ....checks import number
from ....errors import ConvergenceError, InputError, LinearSolveError
from ....log import log
from ....mechanics.bodies.bodies import RigidBody
from ....notices import Withheld
from ....schemes.declared import Declared, checked_scheme
from ....schemes.onestep.alpha.generalized_alpha import GeneralizedAlpha
from ....system.scene.refinement import meshed_bodies, modal_bodies, slender
from ....system.scene.scene import Scene
from ...recording.output import Output
from ...result import Run
from ...schedule import step_schedule
from ...settings import check_tangent, default_scheme
from ...single_run import Solved
from ..certificate import FLOOR, Certificate, moving, stated_of, struck_or_sampled
from ..companion_runs import UNFIT, Compared
from ..deviation import Deviation
from ..equal_steps import Orders, TimeError, astray, between, known_orders
from ..estimates import take_time_error, usual_errors, warn_of_uncertain
from .attempts import Attempt, Failures, of_jumps, of_space, tell_of_dear_attempt
from .foreseen_steps import with_steps_foreseen
from .next_attempt import (
    NEAR,
    SMALL,
    AttemptPlan,
    Known,
    beginning,
    ending_at,
    finer_steps,
    jumps_before,
    jumps_within,
    next_plan,
    on_coarser_meshes,
    space_first,
    space_limit,
)
from .records import often, thin_out
from .shared_spaces import SharedSpaces
from .shares import (
    AIM,
    DOUBTED,
    SAFE,
    WHOLE,
    Allowed,
    Tolerance,
    alone,
    check_tolerances,
    largest_share,
    safe,
    warn_of_still,
    worst,
)

ATTEMPTS = 12
# steps of the first attempt where no dt is given; of rigid bodies alone, of which so many take as long as to begin a run does
START, START_RIGID = 100, 200
# the same where spaces or modes have to be found first, whose errors are seen with few steps, and nothing touches: of bodies on
# meshes, whose steps cost, and of slender ones, of which a run takes most of its time before its first step; a look at spaces
# takes a quarter of them
SCOUT, SCOUT_SLENDER = 48, 96
LOOSEST = 1e-4  # rtol of the first attempt of schemes with error control
STALLED, STALLED_IN_CONTACT = 256.0, 60.0  # ratios of steps over which errors have to fall
FAILURES = 1  # runs that may fail, each followed by one with a quarter of the step, beside one that came to its end
# times what a scheme's tolerance usually leaves that meshes do: by steps up to 170 were seen, up to 45 where ends are ahead
UNUSUAL, UNUSUAL_AHEAD = 500.0, 100.0
SHOWN = 4  # jumps of loads in the table of attempts


def solve_within(
    scene: Scene, tol: Tolerance, *, t_end: float, start: tuple[Any, float | None], settings: tuple[Any, Any, Any]
) -> Run:
    """A run whose stated errors are below ``tol``, or the best that was found, see :func:`.solve`; collective."""
    check_tolerances(scene, tol)
    newton, wanted, linear = settings
    plan = _first(scene, start[0], t_end, start[1])
    check_tangent(plan.scheme, newton)
    wanted = replace(Output() if wanted is None else wanted, estimate_error=True)
    shared = SharedSpaces(newton, linear, plan.grain)

    found = Search()
    with Withheld():
        _attempt(plan, tol, shared, wanted=wanted, found=found)
    return found.result(scene, tol)


def _attempt(plan: AttemptPlan, tol: Tolerance, shared: SharedSpaces, *, wanted: Output, found: Search) -> None:
    """One attempt after another, until nothing is left to be changed; collective."""
    begun, t_end = clock.perf_counter(), plan.schedule.t_end
    if jumps := jumps_before(plan, shared):
        found.history.append(of_jumps(plan, jumps, clock.perf_counter() - begun))
        plan = ending_at(plan, jumps, shared)

    for _ in range(ATTEMPTS):
        try:
            plan_next = _one_more(plan, tol, shared, wanted=wanted, found=found)
        except (ConvergenceError, LinearSolveError) as error:
            # finer meshes may need smaller steps than those on which the error was small enough
            failures = found.failures
            failures.note(error)
            many = found.best is not None and failures.count > FAILURES
            if many or failures.hopeless or plan.step < 1e-3 * t_end / START:
                found.why = f"a run failed: {error}"
                break
            plan_next = finer_steps(_anew(plan), 0.25)
        except InputError as error:
            # what was given is as wrong as it says; what was made of it may be too fine for a form
            if not plan.below:
                raise
            plan_next = on_coarser_meshes(plan, error)
            if plan_next.meshes in found.levels:
                found.why = plan_next.finest
                break

        if plan_next is None:
            break
        plan = plan_next


@dataclass
class Search:
    """What was tried so far, the best run with its largest error over the tolerance, and why there is no better one."""

    history: list[Attempt] = field(default_factory=list)
    best: tuple[float, Run] | None = None
    why: str = f"{ATTEMPTS} attempts were not enough"
    failures: Failures = field(default_factory=Failures)
    levels: set[int] = field(default_factory=set)  # of the meshes of those that did

    def take(self, run: Run, ratio: float, plan: AttemptPlan) -> None:
        """A run of an attempt: better than the best so far, or a finer one that shows how little that knew of its error."""
        self.levels.add(plan.meshes)
        refuted = False
        if self.best is not None and 1.0 < self.best[0] < ratio < np.inf:
            last = self.history[-1]
            refuted = last.step > plan.step and (last.meshes, last.modes) == (plan.meshes, plan.modes)
        if self.best is None or ratio < self.best[0] or refuted:
            self.best = ratio, run

    def stalled(self, plan: AttemptPlan, ratio: float) -> str:
        """Why smaller steps are of no use: errors have not fallen while steps of the same spaces became far smaller, or so little
        that at the best rate seen they would have to become as much smaller again, and more; "" else.
        """
        same = [a for a in self.history if (a.meshes, a.modes) == (plan.meshes, plan.modes) and a.step > plan.step]
        far = STALLED_IN_CONTACT if plan.scene.contacts else STALLED
        coarser = [a for a in same if a.step >= far * plan.step * (1 - 1e-9)]
        if not plan.steps or ratio <= 1.0 or not coarser:
            return ""
        best = max(np.log(a.worst / ratio) / np.log(a.step / plan.step) for a in same)
        if np.log(ratio) <= best * np.log(far):
            return ""
        last = coarser[-1]
        return (
            f"errors do not fall with the steps: {last.worst:.2g} times the tolerance with {last.step:.2g} s, {ratio:.2g} times "
            f"with {plan.step:.2g} s. The sensor jumps, follows vibrations that no step so far resolves (fmbd.Radau(3) may), or "
            "moves chaotically. Give a smaller dt to begin with, smooth the load, take means over time or space, or a shorter run"
        )

    def result(self, scene: Scene, tol: Tolerance) -> Run:
        """The best run, with a warning where it does not keep the tolerance.

        Raises ConvergenceError where no run came to its end.
        """
        if self.best is None:
            raise ConvergenceError(f'Scene "{scene.name}": no run with tol came to its end: {self.why}')

        over, run = self.best
        for said in run.warnings:
            log.warning(said)
        if over > 1.0:
            log.warning(
                'scene "%s": the tolerance was not reached, %.2g times it is stated: %s.',
                scene.name,
                over,
                self.why.rstrip("."),
            )

        warn_of_uncertain(run, tol)
        warn_of_still(run, tol)
        run.history = tuple(self.history)
        return run


def _one_more(
    plan: AttemptPlan, tol: Tolerance, shared: SharedSpaces, *, wanted: Output, found: Search
) -> AttemptPlan | None:
    """One attempt, noted among what was found; the plan of the next one, or None; collective."""
    begun = clock.perf_counter()
    try:
        looked = space_first(plan, tol, shared, wanted)
        plan = plan if looked else with_steps_foreseen(plan, tol, shared, wanted)
    except UNFIT:
        plan, looked = _anew(plan), None
    if looked is not None:
        found.history.append(of_space(plan, looked, clock.perf_counter() - begun))
        return looked.plan

    output = replace(wanted, every=often(wanted, plan.schedule), estimate_error=False)
    solved = shared.solve(plan.scene, plan.scheme, plan.schedule, output)
    run = solved.run
    jumps = jumps_within(plan, run, tol, first=found.best is None)
    if not jumps:  # errors that others tell say nothing of these
        plan, solved = _state_errors(plan, tol, shared, solved)
        run = solved.run
    if solved.compared.recorder.output.every != wanted.every and wanted.times is None:
        thin_out(run, solved.compared.recorder.indices, wanted.every)
    if jumps:
        found.best = np.inf, run
        found.history.append(of_jumps(plan, jumps, clock.perf_counter() - begun))
        return ending_at(plan, jumps, shared)

    certificate = stated_of(run, tol)
    ratio = worst(certificate, tol)
    found.take(run, ratio, plan)
    made, then = _after(plan, run, certificate, tol=tol, shared=shared, found=found)

    errors = {n: certificate[n].sum for n in tol}
    seconds = clock.perf_counter() - begun
    found.history.append(Attempt(plan.step, plan.meshes, plan.modes, ratio, errors, seconds, then))
    if made is None:
        found.why = then
    tell_of_dear_attempt(plan, made, run, found.history)
    return made


def _anew(plan: AttemptPlan) -> AttemptPlan:
    """The plan where the fewest steps that follow the motion on coarser meshes are too few."""
    return replace(plan, orders=replace(plan.orders, follow=0))


def _after(
    tried: AttemptPlan, run: Run, certificate: Certificate, *, tol: Tolerance, shared: SharedSpaces, found: Search
) -> tuple[AttemptPlan | None, str]:
    """The plan after an attempt and what it changes, or None and why there is none; collective."""
    ratio = worst(certificate, tol)
    if safe(certificate, tol):
        if not alone(run, certificate, tol) or any(ratio <= DOUBTED * a.worst <= DOUBTED * SAFE for a in found.history):
            return None, "done"
        found.best = np.inf, run
        return finer_steps(tried, NEAR), "finer steps: others show another motion"
    if why := found.stalled(tried, ratio):
        return None, why

    made, then = next_plan(tried, run, tol, certificate=certificate, shared=shared, history=found.history)
    nothing_has_to = made is None and ratio <= 1.0
    return made, "done" if nothing_has_to else then


def _first(scene: Scene, scheme: Any, t_end: float, dt: float | None) -> AttemptPlan:
    """The first attempt: the scene as it is, with the steps given or a hundred or two of them, or with a loose tolerance."""
    scheme = _default(scene, t_end) if scheme is None else checked_scheme(scheme)
    if Declared.by(scheme).adaptive:
        scheme = replace(scheme, rtol=max(scheme.rtol, LOOSEST))
        return beginning(AttemptPlan(scene, scheme, step_schedule(scene, scheme, t_end, dt), 1))
    number("End time t_end =", t_end, above=0.0, unit="s")
    spaces = bool(meshed_bodies(scene) or modal_bodies(scene)) and not scene.contacts
    scout = SCOUT_SLENDER if slender(scene) else SCOUT
    look = scout // 4 if spaces and dt is None and not modal_bodies(scene) else 0
    rigid = all(isinstance(body, RigidBody) for body in scene.bodies.values()) and not struck_or_sampled(scene)
    dt = t_end / (scout if spaces else START_RIGID if rigid else START) if dt is None else dt
    schedule = step_schedule(scene, scheme, t_end, dt, multiple=4, at_samples=True)
    return beginning(AttemptPlan(scene, scheme, schedule, schedule.steps // 4, orders=Orders(follow=look)))


def _default(scene: Scene, t_end: float) -> Any:
    """The usual scheme of a scene; where loads jump at break points on the way, it chooses its steps: a jump within a step leaves
    an error that depends on where it falls, and that other steps of equal size do not tell. So does early rest.
    """
    scheme = default_scheme(scene)
    scheme = replace(scheme, early=False) if Declared.by(scheme).early else scheme
    jumps = any(0.0 < t < t_end for t in scene.breakpoints)
    return replace(scheme, rtol=LOOSEST) if jumps and isinstance(scheme, GeneralizedAlpha) else scheme


def _state_errors(
    plan: AttemptPlan, tol: Tolerance, shared: SharedSpaces, solved: Solved
) -> tuple[AttemptPlan, Solved]:
    """State the errors of a run that are not known yet, or of one with half its step that is there; the plan of that run with the
    orders that were seen, and that run; collective.
    """
    if _all_at_once(plan, tol, shared, solved):
        return replace(plan, orders=Orders()), solved
    # where bodies touch what tells the others has the steps of the run anyway, and how much room they leave is known then
    if plan.scene.contacts:
        _other_errors(plan, tol, shared, solved, solved.compared)
        kinds = {k: x for k, x in solved.run.deviations.items() if k in ("space", "modes")}
        plan = replace(plan, known=Known(kinds, solved.run.space_unstated))
    ended = clock.perf_counter()
    found = _time_error(plan, tol, shared, solved)
    if found.instead is not None:
        solved = found.instead
        plan = replace(plan, schedule=solved.compared.schedule)
    run = solved.run
    run.seconds["error estimate"] = clock.perf_counter() - ended

    _other_errors(plan, tol, shared, solved, found.with_others)
    fewest = found.with_others.schedule.steps
    return replace(plan, orders=Orders(known_orders(found), fewest) if fewest < plan.steps else Orders()), solved


def _all_at_once(plan: AttemptPlan, tol: Tolerance, shared: SharedSpaces, solved: Solved) -> bool:
    """State the errors of steps of a scheme's own choice and of meshes together, by one run that has less of both, where they are
    small enough, or nearly all by meshes; each of them else, with another one in the same spaces. Whether this could be;
    collective.
    """
    run, scene, begun = solved.run, plan.scene, clock.perf_counter()
    if (
        plan.steps
        or scene.contacts
        or modal_bodies(scene)
        or not meshed_bodies(scene)
        or any(plan.known.errors.values())
    ):
        return False
    spans = moving(run.series, scene.sensors, FLOOR)
    usual = largest_share(usual_errors(solved.compared), spans, tol)
    if len(plan.below) > 1 or usual > SAFE:
        return False  # levels cost less, or a run with a larger tolerance, which tells that it is far too large
    if shared.two_in_one(solved) is not None:
        return False  # so do runs with larger steps
    found = shared.all_at_once(solved, lambda x: largest_share(x, spans, tol) <= AIM)
    if found is None:
        return False

    run.seconds["error estimate"] = clock.perf_counter() - begun
    share = largest_share(found.errors, spans, tol)
    unusual = UNUSUAL_AHEAD if solved.problem.said.ends_ahead else UNUSUAL
    if share <= SAFE or share > unusual * usual:
        run.joint = "time" if share <= SAFE else "space"
        run.deviations[run.joint] = found.errors
        return True
    _other_errors(plan, tol, shared, solved, solved.compared)
    in_space = run.deviations["space"]
    if in_space.keys() == found.apart.keys():
        run.deviations["time"] = found.of_time(in_space)
    return "time" in run.deviations


def _time_error(plan: AttemptPlan, tol: Tolerance, shared: SharedSpaces, solved: Solved) -> TimeError:
    """State the error by the steps, or by the scheme's tolerance; collective."""
    run, alone = solved.run, not meshed_bodies(plan.scene) and not modal_bodies(plan.scene)
    spans = moving(run.series, run.scene.sensors, FLOOR)
    # at spaces, with few steps: of slender bodies twice as many cost little, and tell the next ones
    looked = bool(plan.orders.follow) and not plan.orders.seen and not slender(plan.scene)

    def share_of(errors: dict[str, Deviation]) -> float:
        return largest_share(errors, spans, tol)

    room = WHOLE - _reserved(plan, shared, share_of) if plan.steps and not alone else SAFE if alone else WHOLE
    too_coarse = any(share_of(x) > AIM for x in plan.known.errors.values() if x)
    allowed = Allowed(tuple(tol), share_of, room, rough=alone or looked, last=not too_coarse)
    equal = bool(plan.steps)
    found = shared.time_error(solved, plan.orders, allowed) if equal else shared.tolerance_error(solved, allowed)
    made = found.instead or solved
    last = equal and allowed.nearly_lets(found.errors)
    take_time_error(made.run, found, made.problem, made.compared, last=last)
    return found


def _reserved(plan: AttemptPlan, shared: SharedSpaces, share_of: Callable[[dict[str, Deviation]], float]) -> float:
    """Share of the tolerance that errors in space and by modes take: those that are known, and what the others may."""
    known = {kind: share_of(errors) for kind, errors in plan.known.errors.items() if errors}
    if id(plan.scene) in shared.looked:
        known.setdefault("space", shared.looked[id(plan.scene)])
    kinds = {"space": meshed_bodies(plan.scene), "modes": modal_bodies(plan.scene)}
    wanted = [kind for kind, bodies in kinds.items() if bodies]
    return sum(min(known.get(kind, AIM / len(wanted)), AIM) for kind in wanted)


def _other_errors(plan: AttemptPlan, tol: Tolerance, shared: SharedSpaces, solved: Solved, made: Compared) -> None:
    """State the errors of modes and space: those that are known, or from runs with the steps of a run ``made``; collective."""
    run, known = solved.run, plan.known.errors
    run.deviations.update(known)
    run.space_unstated = plan.known.unstated

    # steps that are enough for the run may be too few with more modes or finer meshes: those of the run itself then
    steps = [made] if made is solved.compared else [made, solved.compared]
    begun = clock.perf_counter()
    if modal_bodies(plan.scene) and "modes" not in known:
        run.deviations["modes"] = shared.mode_error(plan.scene, solved.problem.system, steps)
        run.seconds["reduction estimate"] = clock.perf_counter() - begun
    begun = clock.perf_counter()
    if meshed_bodies(plan.scene) and "space" not in known:
        spans, limit = moving(run.series, run.scene.sensors, FLOOR), space_limit(plan.scene)
        look = shared.kept(plan.scene, plan.orders.follow)
        if look is not None and shared.looked.get(id(plan.scene), np.inf) <= SMALL * limit:
            if not astray(solved.compared, between(solved.compared.recorder, look.recorder, spans)):
                steps = [look]  # small as it is, more steps need not tell it
        run.deviations["space"], run.space_unstated = shared.space_error(
            plan.scene, steps, plan.below, lambda found: largest_share(found, spans, tol) <= limit
        )
        run.seconds["space estimate"] = clock.perf_counter() - begun
