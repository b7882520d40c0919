"""The errors by the steps of a scheme's own choice, and the runs with other tolerances that tell them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ....system.scene.scene import Scene
from ...single_run import Solved
from ..companion_runs import UNFIT, Compared
from ..deviation import Deviation
from ..equal_steps import TimeError
from ..estimates import (
    TELLING,
    beyond,
    grown,
    left_at_single_ends,
    looser_run,
    of_tolerances,
    tolerance_error,
    usual_errors,
    usual_power,
)
from ..larger_steps import larger_steps_error
from .shared_runs import SharedRuns, acts, orders_of
from .shares import DOUBTED, ITERATED, Allowed

LOOSE = 1e-3  # tolerances up to which ten times as much tells something
PAYS = 1.5  # ratio of steps, as the order of the scheme has it, from which on a looser run is made


class SharedTolerances(SharedRuns):
    """Runs with steps of a scheme's own choice beside those with equal ones."""

    def tolerance_error(self, solved: Solved, allowed: Allowed) -> TimeError:
        """The error by the tolerance of a scheme with error control; collective.

        A run with a smaller one tells it, but where a looser run shows that it is far too large. What a run has beyond a looser
        one is mostly the error of that one: its own may be a tenth of what is thought, or six times as much where both begin with
        the same few steps.
        """
        problem, given = solved.problem, solved.compared
        left = allowed.share(left_at_single_ends(problem, given.recorder))
        two = self.two_in_one(solved) if left <= ITERATED else None
        if two is not None and (found := larger_steps_error(solved, two, allowed)) is not None:
            return found
        looser = self._looser(solved, allowed)
        first = id(problem.scene) not in self._chosen  # later ones are nearly always small enough
        self._chosen[id(problem.scene)] = given
        if looser is not None:
            apart, loose = looser
            falls = (loose.scheme.rtol / problem.scheme.rtol) ** usual_power(problem.scheme)
            seen = {n: grown(loose, given) ** p for n, p in orders_of(problem).items()}
            told = min(seen[n] for n in allowed.sensors) >= TELLING
            if told and allowed.share(likely := of_tolerances(apart, falls, seen)) > DOUBTED * allowed.room:
                return TimeError(likely, {}, given)

        whole = (lambda rtol: self._with_tolerance(solved, rtol)) if first else None
        return TimeError(tolerance_error(problem, given.recorder, given.schedule, whole=whole), {}, given)

    def _looser(self, solved: Solved, allowed: Allowed) -> tuple[dict[str, Deviation], Compared] | None:
        """What a run has beyond one with a larger tolerance, and that one: the attempt before, or one with ten times its own,
        where these are clearly fewer steps and a first attempt with errors of the usual size would not do; else None.
        """
        problem, given = solved.problem, solved.compared
        scene, scheme = problem.scene, problem.scheme
        before = self._before(scene, scheme, given.schedule)
        if before is not None:
            return beyond(given.recorder, before), before
        fewer = scheme.rtol <= LOOSE and 10.0 ** (usual_power(scheme) / scheme.order) >= PAYS
        if id(scene) in self._chosen or not fewer or allowed.lets(usual_errors(given)):
            return None
        try:
            return looser_run(problem, given)
        except UNFIT:
            return None

    def _with_tolerance(self, solved: Solved, rtol: float) -> tuple[dict[str, Deviation], Compared] | None:
        """What a whole run with a smaller tolerance, which may be the next attempt, has beyond a given one, and that run; None
        where something is called or kept on the way, or elements are moved by ends of steps alone; collective.
        """
        problem, given = solved.problem, solved.compared
        scene, scheme, output = problem.scene, replace(problem.scheme, rtol=rtol), given.recorder.output
        if acts(output) or self._before(scene, scheme, given.schedule) is not given:
            return None
        found = self.solve(scene, scheme, given.schedule, output)
        self._whole[id(scene), rtol] = found
        return beyond(found.compared.recorder, given), found.compared

    def tighter(self, scene: Scene, scheme: Any, sure: float) -> Any:
        """The scheme with the tolerance of a run that told an error, where so much of it is no larger than its own."""
        there = [rtol for made, rtol in self._whole if made == id(scene) and sure * rtol <= scheme.rtol]
        return replace(scheme, rtol=max(there)) if there else scheme
