"""A run that keeps a tolerance: steps, modes and meshes are refined until the run states errors below it.

Every attempt is a whole run with its estimates. From its certificate follows what is too large, and by how much: the step from
the order that was seen, modes and meshes one level at a time. Errors by modes and meshes change little with the step, so they
are estimated again only when bodies have changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..checks import typed
from ..errors import ConvergenceError, InputError, LinearSolveError, near, require
from ..log import log
from ..mechanics.bodies.beams import Beam
from ..mechanics.bodies.bodies import ElasticBody
from ..mechanics.reduction.craig_bampton import ReducedBody
from ..mechanics.rods.rods import Rod
from ..schemes.control import FINEST
from ..schemes.declared import Declared
from ..system.scene.refinement import meshed_bodies, more_modes, refined
from ..system.scene.scene import Scene
from .certificate import KINDS, Statement
from .deviation import Deviation
from .estimates import SEEN
from .output import Output
from .settings import checked_scheme
from .solve import Run, default_scheme, solve

ATTEMPTS = 12
AIM = 0.6  # share of the tolerance below which the error of space, or of modes, is brought: its estimate is the coarser one
WHOLE, SAFE = 0.8, 0.9  # shares that all kinds together are brought below, and must be
RATE = 4.0  # by which the error in space falls from one level to the next, until it was seen
LEAST = 0.65  # of smaller changes of the step the runs cost more than they save
NEAR, FAR = 1 / 16, 1 / 128  # most that a step is made smaller at once, without and with the order of the scheme seen
START = 100  # steps of the first attempt where no dt is given
FLOOR = 1e-12  # share of the range of a sensor that roundoff leaves


@dataclass(frozen=True)
class Relative:
    """A share of the range (largest less smallest value) of a sensor."""

    share: float


@typed
def relative(share: float) -> Relative:
    """A tolerance as a share of the range of the sensor: ``tol={"tip": relative(1e-3)}``."""
    require(bool(np.isfinite(share)) and share > 0, f"relative({share}): the share must be positive.")
    require(share >= FLOOR, f"relative({share:g}) is below what roundoff allows, about {FLOOR:g}.")
    return Relative(float(share))


@dataclass(frozen=True)
class Attempt:
    """One run on the way to a tolerance: its steps (s, or rtol), its level of refinement, stated errors, seconds with estimates.

    ``worst`` is the largest stated error over its tolerance; ``errors``: sensor -> sum of errors. ``then``: what was done next.
    """

    step: float
    meshes: int
    modes: int
    worst: float
    errors: dict[str, float]
    seconds: float
    then: str

    def __str__(self) -> str:
        """A line of a table."""
        errors = ", ".join(f"{n} {x:.1e}" for n, x in self.errors.items())
        return (
            f"step {self.step:<9.3g} mesh level {self.meshes}, modes level {self.modes}: error / tol {self.worst:8.2g} "
            f"({errors}), {self.seconds:.2f} s: {self.then}"
        )


@dataclass(frozen=True)
class _Known:
    """Errors of space and modes that were estimated with other steps, and what could not be stated."""

    errors: dict[str, dict[str, Deviation]]
    unstated: str


@dataclass(frozen=True)
class _Plan:
    """What the next attempt is made with; ``known``: errors of space and modes that still hold; ``before``: level of the meshes
    and error in space over the tolerance of the attempt before they were refined last.
    """

    scene: Scene
    scheme: Any
    dt: float | None
    meshes: int = 0
    modes: int = 0
    known: _Known | None = None
    before: tuple[int, float] | None = None

    @property
    def step(self) -> float:
        """dt (s), or rtol."""
        return self.scheme.rtol if self.dt is None else self.dt


def solve_within(
    scene: Scene,
    tol: Mapping[str, Any],
    *,
    t_end: float,
    start: tuple[Any, float | None],
    settings: tuple[Any, Any, Any],
) -> Run:
    """A run whose stated errors are below ``tol``, or the best that was found, see :func:`.solve`; collective."""
    _check(scene, tol)
    scheme, dt = start
    scheme = default_scheme(scene) if scheme is None else checked_scheme(scheme)
    if Declared.by(scheme).adaptive:
        plan = _Plan(scene, replace(scheme, rtol=max(scheme.rtol, 1e-4)), None)
    else:
        plan = _Plan(scene, scheme, t_end / START if dt is None else dt)

    history: list[Attempt] = []
    best: tuple[float, Run] | None = None
    why = f"{ATTEMPTS} attempts were not enough"
    for _ in range(ATTEMPTS):
        try:
            run = _attempt(plan, t_end, settings)
        except (ConvergenceError, LinearSolveError) as error:
            if best is not None or plan.step < 1e-3 * t_end / START:
                why = f"a run failed: {error}"
                break
            plan = _finer_steps(plan, 0.25)
            continue
        worst = _worst(run, tol)
        if best is None or worst < best[0]:
            best = worst, run
        plan_next, then = (None, "done") if _safe(run, tol) else _next(plan, run, tol, history)
        if plan_next is None and worst <= 1.0:  # nothing can be made better, and nothing has to
            then = "done"
        errors = {n: run.certificate[n].sum for n in tol}
        history.append(Attempt(plan.step, plan.meshes, plan.modes, worst, errors, _seconds(run), then))
        if plan_next is None:
            why = then
            break
        plan = plan_next
    if best is None:
        raise ConvergenceError(f'Scene "{scene.name}": no run with tol came to its end: {why}')
    if best[0] > 1.0:
        log.warning('scene "%s": the tolerance was not reached, %.2g times it is stated: %s.', scene.name, best[0], why)
    best[1].history = tuple(history)
    return best[1]


def _check(scene: Scene, tol: Mapping[str, Any]) -> None:
    """Tolerances of known sensors, positive."""
    require(bool(tol), "tol must name a sensor: tol={'tip': 1e-4}.")
    for name, value in tol.items():
        if name not in scene.sensors:
            raise InputError(f'tol: no sensor "{name}". {near(name, scene.sensors)}')
        if isinstance(value, Relative):
            continue
        number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        require(
            number and bool(np.isfinite(value)) and value > 0,
            f'tol of "{name}" is {value!r}: give a positive number in {scene.sensors[name].unit}, or relative(1e-3).',
        )


def _attempt(plan: _Plan, t_end: float, settings: tuple[Any, Any, Any]) -> Run:
    """A run with the estimates that are not known yet."""
    newton, output, linear = settings
    fresh = plan.known is None
    wanted = replace(output or Output(), estimate_error=True, estimate_space=fresh, estimate_reduction=fresh)
    run = solve(plan.scene, t_end=t_end, dt=plan.dt, scheme=plan.scheme, newton=newton, output=wanted, linear=linear)
    if plan.known is not None:
        run.space_unstated = plan.known.unstated
        for kind, found in plan.known.errors.items():
            run.state_error(kind, found)
    return run


def _limit(statement: Statement, value: Any) -> float:
    """The tolerance of a sensor in its unit, not below roundoff.

    Raises InputError where it is below.
    """
    limit = value.share * statement.span if isinstance(value, Relative) else float(value)
    floor = FLOOR * statement.span
    require(
        limit >= floor,
        f'tol of "{statement.sensor}", {limit:g} {statement.unit}, is below what roundoff allows: about {floor:.1e}.',
    )
    return limit if limit > 0 else np.inf  # a sensor that does not move has no error to speak of


def _worst(run: Run, tol: Mapping[str, Any]) -> float:
    """The largest stated error over its tolerance; infinite where a kind of error could not be stated."""
    made = run.certificate
    shares = [made[name].sum / _limit(made[name], value) for name, value in tol.items()]
    return np.inf if made.unstated else max(shares)


def _safe(run: Run, tol: Mapping[str, Any]) -> bool:
    """Whether the stated errors leave room for that of the estimates themselves."""
    fixed = max(_share(run.certificate[n], x, kind, run) for n, x in tol.items() for kind in ("space", "modes"))
    return _worst(run, tol) <= SAFE and fixed <= AIM


def _next(plan: _Plan, run: Run, tol: Mapping[str, Any], history: Sequence[Attempt]) -> tuple[_Plan | None, str]:
    """The next plan and what it changes, or None and why there is none.

    Spaces and modes of solids come first, with steps as they are: runs that are compared for them may be coarse in time. Steps
    are then made as small as what is left of the tolerance asks for; at once, where the next error in space can be foreseen.
    """
    over = {kind: max(_share(run.certificate[n], x, kind, run) for n, x in tol.items()) for kind in KINDS}
    if over["algebra"] > AIM:
        return None, "Newton's tolerance is too large: give newton=Newton(tolerance=...)"

    made, done = plan, []
    limits = _limits(over)
    try:
        if over["space"] > limits["space"]:
            made = _finer_meshes(made, over["space"], limits["space"])
            done.append("finer meshes")
        if over["modes"] > limits["modes"]:
            made = replace(made, scene=more_modes(made.scene, run.system), modes=made.modes + 1, known=None)
            done.append("more modes")
    except InputError as error:
        known = run.certificate.unstated.get("space")
        return None, f"{error}" + (f" Of its error in space: {known}." if known else "")

    unseen = not np.isfinite(over["time"])
    steps_too = unseen or (over["time"] > 1.0 and _order(run, tol) < 1.0)
    if made.meshes == plan.meshes or _foreseen(plan):  # one attempt for both
        steps_too = steps_too or over["time"] > limits["time"]
    if made is not plan and not steps_too:
        return made, " and ".join(done)
    if made is plan:
        made = replace(
            made, known=_Known({k: run.deviations.get(k, {}) for k in ("space", "modes")}, run.space_unstated)
        )
    factor = 0.25 if unseen else _factor(plan, run, tol, (over["time"], limits["time"]), history)
    made = _finer_steps(made, factor)
    if made.dt is None and made.scheme.rtol <= FINEST:
        return None, "the scheme's tolerance is at roundoff"
    return made, " and ".join([*done, "finer steps"])


def _share(statement: Statement, value: Any, kind: str, run: Run) -> float:
    """One kind of error over the tolerance; infinite where it could not be stated."""
    if kind in run.certificate.unstated:
        return np.inf
    error = getattr(statement, kind)
    return 0.0 if error is None else float(error / _limit(statement, value))


def _limits(over: Mapping[str, float]) -> dict[str, float]:
    """Shares of the tolerance below which spaces, modes and time are left alone: what is fixed first leaves the rest to time."""
    kinds = sum(over[k] > 0 for k in ("space", "modes"))
    fixed = AIM if kinds < 2 else 0.6 * AIM
    spent = sum(min(over[k], fixed) for k in ("space", "modes")) + over["algebra"]
    return {"space": fixed, "modes": fixed, "time": WHOLE - spent}


def _finer_meshes(plan: _Plan, over: float, limit: float) -> _Plan:
    """The plan with meshes refined as often as the rate seen so far asks for, rounded down."""
    rate = _expected(plan.scene)
    if plan.before is not None and np.isfinite(plan.before[1]):
        rate = float(np.clip((plan.before[1] / over) ** (1.0 / (plan.meshes - plan.before[0])), 2.0, 16.0))
    solid = any(isinstance(b, ElasticBody | ReducedBody) and b.dim == 3 for b in plan.scene.bodies.values())
    exact = np.log(over / limit) / np.log(rate) if np.isfinite(over) else 1.0
    wanted = int(np.ceil(exact - 0.1) if _foreseen(plan) and np.isfinite(over) else exact + 0.1)
    levels = min(max(wanted, 1), 1 if solid else 3)

    scene = plan.scene
    for _ in range(levels):
        scene = refined(scene)
    return replace(plan, scene=scene, meshes=plan.meshes + levels, known=None, before=(plan.meshes, over))


def _slender(scene: Scene) -> bool:
    """Whether all that has an error in space are beams, rods, lines or wires: no corners, and cheap to refine."""
    return not any(isinstance(scene.bodies[n], ElasticBody | ReducedBody) for n in meshed_bodies(scene))


def _expected(scene: Scene) -> float:
    """By what the error in space falls from one level to the next, as long as it was not seen."""
    if not _slender(scene):
        return RATE
    bodies = [scene.bodies[n] for n in meshed_bodies(scene)]
    return min(
        [16.0 if isinstance(b, Beam) else 4.0**b.degree if isinstance(b, Rod) else RATE for b in bodies], default=RATE
    )


def _foreseen(plan: _Plan) -> bool:
    """Whether the next error in space can be told in advance: from a rate that was seen, or of slender bodies."""
    return plan.before is not None or _slender(plan.scene)


def _factor(
    plan: _Plan, run: Run, tol: Mapping[str, Any], share: tuple[float, float], history: Sequence[Attempt]
) -> float:
    """By what steps, or the scheme's tolerance, are multiplied, so that the error of time falls from one share to another."""
    now, wanted = share
    if plan.dt is not None:
        order = _order(run, tol)
        most = FAR if order > SEEN * run.scheme.order else NEAR
        return float(np.clip((wanted / now) ** (1.0 / order), most, LEAST))

    # errors of controlled runs follow the tolerance with a slope of their own
    same = [a for a in history if (a.meshes, a.modes) == (plan.meshes, plan.modes)]
    slope = 0.9
    if same and same[-1].worst > now:
        slope = float(np.clip(np.log(same[-1].worst / now) / np.log(same[-1].step / plan.step), 0.5, 1.2))
    return float(np.clip(0.7 * (wanted / now) ** (1.0 / slope), 1e-6, 0.5))


def _order(run: Run, tol: Mapping[str, Any]) -> float:
    """The lowest order seen in the sensors that have a tolerance, between 1/2 and the scheme's."""
    seen = [run.observed_order.get(n, np.nan) for n in tol]
    known = [p for p in seen if np.isfinite(p)]
    return float(np.clip(min(known), 0.5, run.scheme.order)) if known else float(run.scheme.order)


def _finer_steps(plan: _Plan, factor: float) -> _Plan:
    """Smaller steps, or a smaller tolerance of the scheme."""
    if plan.dt is None:
        return replace(plan, scheme=replace(plan.scheme, rtol=max(plan.scheme.rtol * factor, FINEST)))
    return replace(plan, dt=plan.dt * factor)


def _seconds(run: Run) -> float:
    """Of the run and its estimates."""
    kinds = ("error estimate", "reduction estimate", "space estimate")
    return float(run.seconds["total"] + sum(run.seconds.get(k, 0.0) for k in kinds))
