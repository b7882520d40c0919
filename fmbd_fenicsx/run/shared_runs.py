"""What the attempts of a run with a tolerance share: systems that are built once, runs with larger steps, runs in finer spaces.

An attempt is one run with the steps, spaces and modes that are thought to be enough. Its errors are told by runs that cost less:
those of earlier attempts, as far as their steps are near enough, and runs in finer spaces with the largest steps that still
follow the same motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from ..errors import ConvergenceError
from ..log import log
from ..notices import Gathered
from ..schemes.newton import Newton
from ..system.scene.refinement import expected_rate, one_kind, refined, refined_by_finer_space
from ..system.scene.scene import Scene
from .built import Built, build
from .deviation import Deviation
from .estimates import (
    UNENDED,
    Compared,
    TimeError,
    again,
    compare_steps,
    finer_scene,
    levels_compared,
    run_like,
    space_deviations,
)
from .output import Output
from .schedule import Pace
from .single_run import Solved, Task, run_once

NEAREST, FARTHEST = 1.5, 8.0  # ratios of steps between which a run tells the error of one with smaller steps


@dataclass(frozen=True)
class Orders:
    """Orders seen in runs of the same motion in other spaces: sensor -> order; ``follow``: the fewest steps that have them."""

    seen: Mapping[str, float] = field(default_factory=dict)
    follow: int = 0


class SharedRuns:
    """Systems and runs by the scene that they belong to; ``grain``: numbers of steps are multiples of it."""

    def __init__(self, newton: Newton | None, linear: Any, grain: int) -> None:
        self.newton, self.linear, self.grain = Newton() if newton is None else newton, linear, max(grain, 1)
        self._built: dict[int, Built] = {}
        self._finer: dict[int, tuple[Scene, str, Built | None]] = {}
        self._runs: dict[int, dict[int, Compared]] = {}
        self._scenes: list[Scene] = []  # kept alive, so that their ids stay theirs

    def built(self, scene: Scene) -> Built:
        """The system of a scene, with the warnings of its own; collective."""
        if id(scene) not in self._built:
            self._keep(scene, build(scene))
            return self._afresh(scene)
        return replace(self._afresh(scene), seconds=0.0)

    def _keep(self, scene: Scene, built: Built) -> None:
        self._scenes.append(scene)
        self._built[id(scene)] = built

    def _afresh(self, scene: Scene) -> Built:
        made, warned = self._built[id(scene)], Gathered()
        warned.found = list(made.warned.found)
        return replace(made, warned=warned)

    def solve(self, scene: Scene, scheme: Any, pace: Pace, output: Output) -> Solved:
        """One run, kept for later ones with smaller steps to be compared with; collective."""
        task = Task(scene, scheme, pace, self.newton.afresh(), self.linear, output)
        solved = run_once(task, self.built(scene))
        if not solved.run.counters.get("halved_steps"):
            self._note(scene, solved.compared)
        return solved

    def _note(self, scene: Scene, made: Compared) -> None:
        """Keep a run whose steps have one size, recorded at all their ends or at given times."""
        output = made.recorder.output
        if made.pace.steps and (output.every == 1 or output.times is not None):
            self._runs.setdefault(id(scene), {})[made.pace.steps] = made

    # -- errors of time -----------------------------------------------------------------------------------------------
    def time_error(self, solved: Solved, known: Orders, *, rough: bool) -> TimeError:
        """The error by the steps from runs with fewer of them, made where there are none; collective.

        With ``rough`` the order is taken for granted as long as it was not seen.
        """
        given, scene = solved.compared, solved.problem.scene
        steps = given.pace.steps
        have = self._runs.setdefault(id(scene), {})
        earlier = [n for n in have if n <= steps / NEAREST]
        near = [n for n in earlier if n >= steps / FARTHEST]

        coarser = []
        try:
            coarser.append(self._with(solved, max(near) if near else self._wanted(steps, known, bool(earlier))))
            first = coarser[0].pace.steps
            before = [n for n in have if n <= first / NEAREST]
            if before:
                coarser.append(have[max(before)])
            elif not known.seen and not rough:
                coarser.append(self._with(solved, max(first // 2, 1)))
        except ConvergenceError as error:
            if not coarser:
                log.warning("no error estimate: the run with larger steps did not end: %s", error)
                return TimeError({}, {}, given)
        return compare_steps(solved.problem.scheme.order, given, coarser, known.seen or None)

    def _wanted(self, steps: int, known: Orders, earlier: bool) -> int:
        """How many steps a run to compare with is made of: as few as tell the error, half as many where no order was seen."""
        if known.seen and steps / FARTHEST <= known.follow <= steps / NEAREST:
            return known.follow
        if known.seen or earlier:
            return max(round(steps / 4 / self.grain), 1) * self.grain
        return max(steps // 2, 1)

    def _with(self, solved: Solved, steps: int) -> Compared:
        """The run with so many steps."""
        scene, pace = solved.problem.scene, solved.compared.pace
        have = self._runs.setdefault(id(scene), {})
        if steps not in have:
            have[steps] = again(solved.problem, pace, steps, solved.compared.recorder.output.times)
        return have[steps]

    # -- errors in space ----------------------------------------------------------------------------------------------
    def space_error(self, solved: Solved, made: Compared, below: Sequence[Scene]) -> tuple[dict[str, Deviation], str]:
        """The error by the meshes, from runs on the levels ``below`` where there are two, else from one in finer spaces; with the
        steps of a run ``made``; collective.
        """
        scene = solved.problem.scene
        if len(below) > 1 and one_kind(below[-2]):
            others = [self._like(solved, made, x) for x in below[:-3:-1]]
            if others[0] is not None and others[1] is not None:
                found = levels_compared(expected_rate(scene), made.recorder, others[0].recorder, others[1].recorder)
                if found is not None:
                    return found, ""

        if id(scene) not in self._finer:
            self._finer[id(scene)] = finer_scene(scene)
        finer, why, built = self._finer[id(scene)]
        if built is None:
            return {}, why or "no body is on a mesh"
        if id(finer) not in self._built:
            self._keep(finer, built)
        fine = self._like(solved, made, finer)
        if fine is None:
            return {}, UNENDED
        return space_deviations(made.recorder, fine.recorder, why)

    def _like(self, solved: Solved, made: Compared, scene: Scene) -> Compared | None:
        """A run of the scene with other meshes and the steps of a run ``made``; None where it does not end."""
        kept = self._runs.get(id(scene), {}).get(made.pace.steps)
        if kept is not None:
            return kept
        marched = run_like(solved.problem, made, scene, self.built(scene))
        if marched is None:
            return None
        found = Compared(marched.recorder, made.pace)
        if not marched.counters.get("halved_steps"):
            self._note(scene, found)
        return found

    def refined(self, scene: Scene) -> Scene:
        """The next level: the spaces that the error was measured against, where these are it, so that their system and run
        serve again.
        """
        finer = self._finer.get(id(scene))
        if finer is not None and finer[2] is not None and not finer[1] and refined_by_finer_space(scene):
            return finer[0]
        return refined(scene)
