"""A run that keeps a tolerance: steps, modes and meshes are refined until the run states errors below it.

Every attempt is a whole run with its estimates. From its certificate follows what is too large, and by how much: the step from
the order that was seen, modes and meshes one level at a time. Errors by modes and meshes change little with the step, so they
are estimated again only when bodies have changed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import ConvergenceError, InputError, LinearSolveError, near, require
from ..log import log
from ..schemes.control import FINEST
from ..system.scene.refinement import more_modes, refined
from ..system.scene.scene import Scene
from .certificate import KINDS, Statement
from .output import Output
from .solve import Run, default_scheme, solve

ATTEMPTS = 12
AIM = 0.4  # share of the tolerance that each kind of error is brought below
START = 100  # steps of the first attempt where no dt is given
FLOOR = 1e-12  # share of the range of a sensor that roundoff leaves


@dataclass(frozen=True)
class Relative:
    """A share of the range (largest less smallest value) of a sensor."""

    share: float


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
class _Plan:
    """What the next attempt is made with; ``known``: errors of space and modes that still hold."""

    scene: Scene
    scheme: Any
    dt: float | None
    meshes: int = 0
    modes: int = 0
    known: tuple[dict[str, float], dict[str, float], str] | None = None

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
    scheme = default_scheme(scene) if scheme is None else scheme
    if getattr(scheme, "rtol", None) is not None:
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
        if worst <= 1.0:
            why = ""
        else:
            plan_next, then = _next(plan, run, tol)
            why = then if plan_next is None else why
        errors = {n: run.certificate[n].total for n in tol}
        done = "done" if worst <= 1.0 else then
        history.append(Attempt(plan.step, plan.meshes, plan.modes, worst, errors, _seconds(run), done))
        if worst <= 1.0 or plan_next is None:
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
        run.space_error, run.reduction_error, run.space_unstated = plan.known
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
    shares = [made[name].total / _limit(made[name], value) for name, value in tol.items()]
    return np.inf if made.unstated else max(shares)


def _next(plan: _Plan, run: Run, tol: Mapping[str, Any]) -> tuple[_Plan | None, str]:
    """The next plan and what it changes, or None and why there is none."""
    over = {kind: np.inf if kind in run.certificate.unstated else 0.0 for kind in KINDS}
    for name, value in tol.items():
        s = run.certificate[name]
        for kind in over:
            error = getattr(s, kind)
            over[kind] = max(over[kind], 0.0 if error is None else error / (AIM * _limit(s, value)))

    if max(over.values()) == over["algebra"] and over["algebra"] > 1.0:
        return None, "Newton's tolerance is too large: give newton=Newton(tolerance=...)"
    made, done = plan, []
    try:
        if over["space"] > 1.0:
            made = replace(made, scene=refined(made.scene), meshes=made.meshes + 1, known=None)
            done.append("finer meshes")
        if over["modes"] > 1.0:
            made = replace(made, scene=more_modes(made.scene), modes=made.modes + 1, known=None)
            done.append("more modes")
    except InputError as error:
        known = run.certificate.unstated.get("space")
        return None, f"{error}" + (f" Of its error in space: {known}." if known else "")
    if made is plan:
        made = replace(made, known=(run.space_error, run.reduction_error, run.space_unstated))
    if over["time"] > 1.0:
        order = 1.0 if made.dt is None else _order(run, tol)
        factor = float(np.clip(over["time"] ** (-1.0 / order), 1 / 16, 0.8)) if np.isfinite(over["time"]) else 0.25
        made = _finer_steps(made, factor)
        done.append("finer steps")
        if made.dt is None and made.scheme.rtol <= FINEST:
            return None, "the scheme's tolerance is at roundoff"
    return made, " and ".join(done) or "nothing is left to refine"


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
