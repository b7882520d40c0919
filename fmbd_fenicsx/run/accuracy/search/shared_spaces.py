"""What the attempts of a run with a tolerance share of other spaces: finer and coarser meshes, more modes, and runs in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from ....log import log
from ....schemes.newton import Newton
from ....system.scene.refinement import expected_rates, more_modes, one_kind, refined, refined_by_finer_space, slender
from ....system.scene.scene import Scene
from ....system.system import System
from ...built import Built
from ...single_run import Solved
from ..companion_runs import UNFIT, Compared
from ..deviation import Deviation, scaled
from ..estimates import beyond_by_finer, mode_deviations
from .shared_tolerances import SharedTolerances
from .space_levels import (
    AHEAD,
    UNENDED,
    cheap,
    finer_scene,
    from_below,
    levels_compared,
    next_level,
    space_deviations,
    unended,
)

# share of its error that a space is sure to lose in the one that it was measured against, and room beside it
LEFT = 0.4
LEAVES = 2e-3  # of the range of a sensor: what spaces of few unknowns may leave, where nothing is known of them

Enough = Callable[[dict[str, Deviation]], bool] | None
Finer = tuple[Scene, str, Built | None]  # spaces, what has none there, and their system, if anything is finer


@dataclass(frozen=True)
class TimeAndSpace:
    """What a run with less error of time, a share ``left`` of it, and less in space is ``apart`` from another one."""

    apart: Mapping[str, Deviation]
    left: Mapping[str, float]

    @property
    def errors(self) -> dict[str, Deviation]:
        """Those of both kinds together: each is at most so many times what it adds to the difference."""
        return {n: scaled(x, max(AHEAD, 1.0 / (1.0 - self.left[n]))) for n, x in self.apart.items()}

    def of_time(self, in_space: Mapping[str, Deviation]) -> dict[str, Deviation]:
        """Those of time alone, as far as errors ``in_space`` were told by the same spaces."""
        found = {}
        for n, x in self.apart.items():
            more = in_space[n].at(x.times) / AHEAD
            found[n] = Deviation(x.times, (x.values - more) / (1.0 - self.left[n]))
        return found


class SharedSpaces(SharedTolerances):
    """Scenes with other meshes and more modes beside shared runs.

    ``looked``: share of the tolerance that the error in space of a scene takes, by a look at it.
    """

    def __init__(self, newton: Newton | None, linear: Any, grain: int) -> None:
        super().__init__(newton, linear, grain)
        self.looked: dict[int, float] = {}
        self._finer: dict[int, Finer] = {}
        self._next: set[int] = set()  # scenes whose errors are measured against the next level
        self._richer: dict[int, Scene] = {}

    # -- modes --------------------------------------------------------------------------------------------------------
    def with_more_modes(self, scene: Scene, system: System) -> Scene:
        """The scene by the finer bases that errors by modes are measured against, made once; see :func:`.more_modes`."""
        if id(scene) not in self._richer:
            self.hold(scene)
            self._richer[id(scene)] = more_modes(scene, system)
        return self._richer[id(scene)]

    def mode_error(self, scene: Scene, system: System, runs: Sequence[Compared]) -> dict[str, Deviation]:
        """The error by the modes of a scene and its system, from a run with more of them and the steps of the first of the
        ``runs`` for which it ends; collective.
        """
        richer = self.with_more_modes(scene, system)
        for made in runs:
            try:
                return mode_deviations(made.recorder, self.like(made, richer).recorder)
            except UNFIT as error:
                log.warning("no error of reduction: the run with more modes did not end: %s", error)
        return {}

    # -- meshes, and time with them -----------------------------------------------------------------------------------
    def all_at_once(self, solved: Solved, enough: Enough) -> TimeAndSpace | None:
        """What a run with smaller steps in finer spaces has beyond one with steps of its scheme's own choice; collective.

        It is clearly better in both, so that what it differs by is the error, and costs less than a run for each. None where
        there is no such run.
        """
        problem, given = solved.problem, solved.compared
        finer, why, built = self._finer_of(problem.scene, given, enough)
        if built is None or why:
            return None
        self._chosen[id(problem.scene)] = given
        try:
            apart, left = beyond_by_finer(replace(problem, scene=finer), given, of=self.built(finer))
        except UNFIT as error:
            log.info("the run with a smaller tolerance in finer spaces did not end: %s", error)
            return None
        return TimeAndSpace(apart, left) if apart.keys() == given.recorder.series.keys() else None

    def space_error(
        self, scene: Scene, runs: Sequence[Compared], below: Sequence[Scene], enough: Enough = None
    ) -> tuple[dict[str, Deviation], str]:
        """The error by the meshes of a scene, with the steps of one of its ``runs``: from runs on the levels ``below`` that are
        there, where these tell that it is small ``enough``; else from new ones, of the first of the ``runs`` for which they end;
        collective.
        """
        for made in runs:
            found = self._from_kept(scene, made, below, enough)
            if found is not None:
                return found, ""
        for made in runs:
            errors, why = self._from_new(scene, made, below, enough)
            if not why.startswith(UNENDED):
                break
        return errors, why

    def _from_kept(
        self, scene: Scene, made: Compared, below: Sequence[Scene], enough: Enough
    ) -> dict[str, Deviation] | None:
        """The error by the meshes from the nearest level below with a run that is there, where it is small ``enough``; of slender
        bodies, whose errors fall evenly, else from the two nearest ones. None where these do not tell it.
        """
        if enough is None or scene.contacts:
            return None
        steps, rates = made.schedule.steps, expected_rates(scene)
        known = [(n, x) for n, x in enumerate(reversed(below), start=1) if self.kept(x, steps) is not None]
        if not known:
            return None

        levels, coarser = known[0]
        lower = self.kept(coarser, steps)
        assert lower is not None
        raised = sum(not one_kind(*pair) for pair in pairwise((*below[-levels:], scene)))
        found = from_below(made.recorder, lower.recorder, rates, levels, enough, raised)
        if found is not None or len(known) == 1 or not slender(scene):
            return found

        lowest = self.kept(known[1][1], steps)
        assert lowest is not None
        gaps = levels, known[1][0] - levels
        seen = levels_compared(rates, made.recorder, lower.recorder, lowest.recorder, gaps)
        return seen if seen is not None and enough(seen) else None  # from afar it may be too large

    def _from_new(
        self, scene: Scene, made: Compared, below: Sequence[Scene], enough: Enough
    ) -> tuple[dict[str, Deviation], str]:
        """The error by the meshes from a run on the level below, where this tells that it is small ``enough``, else from the two
        levels below, where these tell how it falls, else from a run in finer spaces.
        """
        found = self._from_levels(scene, made, below, enough)
        if found is not None:
            return found, ""

        finer, why, built = self._finer_of(scene, made, enough)
        if built is None:
            return {}, why or "no body is on a mesh"
        try:
            fine = self.like(made, finer)
        except UNFIT as error:
            return {}, unended(error)
        return space_deviations(made.recorder, fine.recorder, why)

    def _finer_of(self, scene: Scene, made: Compared, enough: Enough) -> Finer:
        """The spaces that the error of a scene, of which a run was ``made``, is measured against; collective."""
        if id(scene) not in self._finer:
            found = self._finer[id(scene)] = self._ahead(scene, made, enough) or finer_scene(scene)
            if found[2] is not None and id(found[0]) not in self._built:
                self.keep(found[0], found[2])
        return self._finer[id(scene)]

    def _ahead(self, scene: Scene, made: Compared, enough: Enough) -> tuple[Scene, str, Built] | None:
        """The next level to measure an error against, where it is likely to be needed: its system and runs serve again."""
        series, times = made.recorder.series, made.recorder.times
        usual = {n: Deviation(times, np.full_like(x, LEAVES * np.ptp(x, axis=0))) for n, x in series.items()}
        if enough is None or enough(usual):
            return None
        found = next_level(scene)
        if found is not None:
            self._next.add(id(scene))
        return found

    def _from_levels(
        self, scene: Scene, made: Compared, below: Sequence[Scene], enough: Enough
    ) -> dict[str, Deviation] | None:
        """The error by the meshes from new runs on one or two levels below; None where these do not tell it. One alone, which
        often does not, is made where finer spaces are dear.
        """
        how_it_falls = len(below) > 1 and one_kind(below[-2], below[-1], scene)
        if not below or (not how_it_falls and (enough is None or scene.contacts or cheap(scene))):
            return None
        try:
            lower = self.like(made, below[-1])
            found = self._from_kept(scene, made, below, enough)
            if found is not None:
                return found
            if not how_it_falls:
                return None
            lowest = self.like(made, below[-2])
        except UNFIT:
            return None
        return levels_compared(expected_rates(scene), made.recorder, lower.recorder, lowest.recorder)

    def refined(self, scene: Scene, enough: float = np.inf) -> Scene:
        """The next level: the spaces that the error was measured against where these are it, or are the last level that is
        wanted, so that their system and run serve again. ``enough``: the share of the error that may be left there.
        """
        finer = self._finer.get(id(scene))
        if finer is not None and finer[2] is not None and not finer[1]:
            if refined_by_finer_space(scene) or id(scene) in self._next or enough >= LEFT:
                return finer[0]
        return refined(scene)
