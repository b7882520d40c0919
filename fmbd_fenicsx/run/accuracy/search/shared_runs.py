"""What the attempts of a run with a tolerance share: systems that are built once, runs with larger steps, runs in finer spaces.

An attempt is one run with the steps, spaces and modes that are thought to be enough. Its errors are told by runs that cost less:
those of earlier attempts, as far as their steps are near enough, and runs in finer spaces with the largest steps that still
follow the same motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ....errors import ConvergenceError
from ....log import log
from ....notices import Gathered
from ....schemes.newton import Newton
from ....system.scene.scene import Scene
from ...built import Built, build
from ...problem import Problem
from ...recording.accompanied import Accompanied
from ...recording.output import Output
from ...schedule import StepSchedule
from ...single_run import Solved, Task, run_once
from ..certificate import kinked, show_kinks
from ..companion_runs import UNFIT, Compared, again, companion, steps_beside, unbegun
from ..equal_steps import (
    FEWEST,
    NEAREST,
    Orders,
    TimeError,
    astray,
    between,
    by_half,
    compare_steps,
    doubtful,
    falling_slowly,
    known_orders,
    of_order,
    shows_order,
)
from ..estimates import looked_at, run_like
from ..larger_steps import two_in_one
from ..orders import REGULAR, expected_orders, highest_order, resolved, seen_by_ends
from .shares import Allowed

FARTHEST = 8.0  # ratio of steps up to which a run tells the error of one with smaller steps
BEYOND = 20.0  # the same where they show the order of the scheme
PARTED = 0.25  # halvings of steps, for each step, that a run may take: beyond, smaller steps cost less
LOOSER = 5.0, 30.0  # ratios of tolerances between which an earlier attempt tells the error of a later one
BY_CHANCE = 0.2  # what an order is beyond that of the scheme where kinks may have made it


class SharedRuns:
    """Systems and runs by the scene that they belong to; ``grain``: numbers of steps are multiples of it."""

    def __init__(self, newton: Newton | None, linear: Any, grain: int) -> None:
        self.newton, self.linear, self.grain = Newton() if newton is None else newton, linear, max(grain, 1)
        self.newton_is_given = newton is not None
        self._built: dict[int, Built] = {}
        self._unspent: dict[int, float] = {}  # seconds of systems that no run has counted yet
        self._runs: dict[int, dict[int, Compared]] = {}
        self._chosen: dict[int, Compared] = {}  # the last attempt of each scene with steps of its own choice
        # by break points the most steps with which a run failed, or only went on in parts: so it would in finer spaces
        self._parted: dict[tuple[float, ...], int] = {}
        # by scene and steps, or tolerance: whole runs that told an error, and may be the next attempt
        self._whole: dict[tuple[int, float], Solved] = {}
        self._in_one: tuple[Compared, Compared | None] | None = None  # the last run by :meth:`two_in_one`
        self._untold: set[int] = set()  # steps of attempts whose errors no run has told
        self._scenes: list[Scene] = []  # kept alive, so that their ids stay theirs

    def built(self, scene: Scene) -> Built:
        """The system of a scene, with the warnings of its own; collective."""
        if id(scene) in self._built:
            return replace(self._afresh(scene), seconds=self._unspent.pop(id(scene), 0.0))
        self.keep(scene, build(scene))
        return self._afresh(scene)

    def ahead(self, scene: Scene) -> Built:
        """The system of a scene before it is run, which is to count its seconds; collective."""
        made = self.built(scene)
        self._unspent[id(scene)] = made.seconds
        return made

    def hold(self, scene: Scene) -> None:
        """A scene stays, so that what is known of it does."""
        self._scenes.append(scene)

    def keep(self, scene: Scene, built: Built) -> None:
        """The system of a scene is there."""
        self.hold(scene)
        self._built[id(scene)] = built

    def _afresh(self, scene: Scene) -> Built:
        made, warned = self._built[id(scene)], Gathered()
        warned.found = list(made.warned.found)
        return replace(made, warned=warned)

    def solve(self, scene: Scene, scheme: Any, schedule: StepSchedule, output: Output) -> Solved:
        """One run, kept for later ones with smaller steps to be compared with; collective."""
        there = self._whole.pop((id(scene), schedule.steps or scheme.rtol), None)
        if there is not None:
            return there
        before, beside = self._before(scene, scheme, schedule), steps_beside(scene, output, schedule)
        if before is not None and output.times is None:
            beside = Output(
                energy=False, progress=False, times=tuple(before.recorder.times[looked_at(before.recorder)])
            )
        parts = PARTED * schedule.steps
        task = Task(scene, scheme, schedule, self.newton.afresh(), self.linear, output, parts, beside)
        solved = run_once(task, self.built(scene))
        if not solved.run.counters.get("halved_steps"):
            self._noted(scene, solved.compared)
        return solved

    def iterate_to(self, tolerance: float) -> None:
        """Newton's iteration to another tolerance from now on; runs with the old one are not compared with those to come."""
        self.newton = replace(self.newton.afresh(), tolerance=tolerance)
        self._runs.clear()
        self._whole.clear()

    def look(self, scene: Scene, scheme: Any, schedule: StepSchedule, output: Output) -> Compared:
        """A run with equal steps that tells an error only: one that is there, or a new one; collective.

        Raises ConvergenceError where its steps are made in parts.
        """
        kept = self.kept(scene, schedule.steps)
        if kept is not None:
            return kept
        self._refuse_parted(scene, schedule.steps)
        built = self.built(scene)
        problem = unbegun(scene, built, scheme, newton=self.newton, linear=self.linear, parts=0.0)
        try:
            marched = companion(problem, schedule, output, of=built)
        except UNFIT:
            self._parted[tuple(scene.breakpoints)] = schedule.steps
            raise
        return self._noted(scene, Compared(marched.recorder, schedule, scheme))

    def two_in_one(self, solved: Solved) -> Compared | None:
        """The last run with two of its steps in one, see :mod:`..larger_steps`, made once; None where these tell no error."""
        if self._in_one is None or self._in_one[0] is not solved.compared:
            self._in_one = solved.compared, two_in_one(solved)
        return self._in_one[1]

    def _refuse_parted(self, scene: Scene, steps: int) -> None:
        """Steps as large as some that failed before are not tried again."""
        if steps <= self._parted.get(tuple(scene.breakpoints), 0):
            raise ConvergenceError(f"{steps} steps had to be made in parts")

    def kept(self, scene: Scene, steps: int) -> Compared | None:
        """The run of a scene with so many equal steps, where there is one."""
        return self._runs.get(id(scene), {}).get(steps)

    def like(self, made: Compared, scene: Scene) -> Compared:
        """A run of a scene with other spaces and the steps of a run ``made``; raises one of UNFIT where it does not end."""
        kept = self.kept(scene, made.schedule.steps)
        if kept is not None:
            return kept
        built, parts = self.built(scene), PARTED * made.schedule.steps
        problem = unbegun(scene, built, made.scheme, newton=self.newton, linear=self.linear, parts=parts)
        marched = run_like(problem, made, scene, built)
        found = Compared(marched.recorder, made.schedule, made.scheme)
        return found if marched.counters.get("halved_steps") else self._noted(scene, found)

    def _noted(self, scene: Scene, made: Compared) -> Compared:
        """A run, kept where its steps have one size and it is recorded at all their ends or at given times."""
        output = made.recorder.output
        if made.schedule.steps and (output.every == 1 or output.times is not None):
            self._runs.setdefault(id(scene), {})[made.schedule.steps] = made
        return made

    # -- errors of time -----------------------------------------------------------------------------------------------
    def time_error(self, solved: Solved, known: Orders, allowed: Allowed) -> TimeError:
        """The error by the steps from runs with fewer of them, or with twice as many where these do not end; collective.

        Nobody has to see the order where half of it would be enough. Where records have kinks they tell it by chance, and a run
        that they find good enough, or nearly, is compared with one of twice as many steps; so is one whose order larger ones do
        not show, because they do not end.
        """
        found = self._compared(solved, known, allowed)
        told = found.halved or found.instead is not None
        if not told and allowed.nearly_lets(found.errors):
            seen_by_chance = found.unseen or not found.by_chance.isdisjoint(allowed.sensors)
            if seen_by_chance or self._meet_kinks(solved, found, allowed.sensors):
                found = self._by_half(solved, found, allowed.sensors)
        if not found.errors:
            self._untold.add(solved.compared.schedule.steps)
        return found

    def _meet_kinks(self, solved: Solved, found: TimeError, sensors: Sequence[str]) -> bool:
        """Whether records of a run have kinks, or those of runs with fewer steps down to the one that tells its error: what is
        short beside the steps of that one, as a stiff contact, may be smooth in smaller ones. Where the order is beyond that of
        the scheme, the run beside that one, with which it was seen, counts too.
        """
        if kinked(solved.run):
            return True
        scene, scheme = solved.problem.scene, solved.compared.scheme
        made, orders, fewest = self._runs[id(scene)], orders_of(solved.problem), found.told_by
        if any(found.orders.get(n, 0.0) > orders[n] + BY_CHANCE for n in sensors):
            fewest = max((n for n in made if n <= fewest / NEAREST), default=fewest)
        between = [made[n].recorder for n in made if fewest <= n < solved.compared.schedule.steps]
        ends = [(x.beside if isinstance(x, Accompanied) else x) for x in between]
        return any(show_kinks(scene, scheme, x.times, x.series) for x in ends)

    def _by_half(self, solved: Solved, larger: TimeError | None, sensors: Sequence[str]) -> TimeError:
        """The error by one with half the step, beside what ``larger`` ones tell, which counts alone where that does not end: by
        half of the order of the scheme where none was seen. Where both are whole runs, and smooth, and show the order of the
        scheme in the ``sensors``, that of the better one counts: it is there.
        """
        given = solved.compared
        steps, have = given.schedule.steps, self._runs[id(solved.problem.scene)]
        coarser = [have[n] for n in sorted(have) if n <= steps / NEAREST][-1:]
        try:
            finer = self._with_half(solved)
        except UNFIT:
            if larger is None or not larger.unseen:
                return larger or TimeError({}, {}, given)
            return replace(larger, errors=of_order(orders_of(solved.problem), given, have[larger.told_by], 0.5))

        orders, key = orders_of(solved.problem), (id(solved.problem.scene), 2 * steps)
        there = self._whole.get(key)
        if there is not None and coarser and not kinked(solved.run) and not kinked(there.run):
            found = compare_steps(orders, finer, [given, *coarser])
            if shows_order(found, (orders, highest_order(given.scheme, solved.problem.system)), sensors):
                return replace(found, instead=self._whole.pop(key))
        return by_half(orders, given, finer, coarser=coarser, larger=larger)

    def _compared(self, solved: Solved, known: Orders, allowed: Allowed) -> TimeError:
        """See :meth:`time_error`."""
        given = solved.compared
        steps, have = given.schedule.steps, self._runs.setdefault(id(solved.problem.scene), {})
        earlier = [n for n in have if n <= steps / NEAREST]
        near = [n for n in earlier if n >= steps / FARTHEST]
        if not near and (told := self._from_afar(solved, earlier, allowed)) is not None:
            return told

        coarser: list[Compared] = []
        unseen = False
        try:
            first = max(near) if near else self._wanted(steps, known, bool(earlier))
            told = self._gather(coarser, solved, first, known, allowed)
            if told is not None:
                return told
        except UNFIT as error:
            if not coarser:
                log.info("the run with larger steps did not end: %s", error)
                halved = bool(solved.run.counters.get("halved_steps"))
                return TimeError({}, {}, given) if halved else self._by_half(solved, None, allowed.sensors)
            unseen = not known.seen

        orders = orders_of(solved.problem)
        found = compare_steps(orders, given, coarser, known.seen or None)
        if doubtful(found, orders, (given, coarser[0]), allowed.sensors):
            found, coarser = self._by_others(solved, found, coarser, allowed)
            if found.unseen:
                return found

        if not astray(given, found.apart):
            found = falling_slowly(found, orders, (given, coarser[0]), allowed.sensors, allowed.lets)
        return replace(found, unseen=unseen and not known_orders(found))

    def _gather(
        self, coarser: list[Compared], solved: Solved, first: int, known: Orders, allowed: Allowed
    ) -> TimeError | None:
        """Add to ``coarser`` the runs that tell an error, of ``first`` steps and of fewer; the error at once where no order has
        to be seen. Raises one of UNFIT where one does not end.
        """
        have, half = self._runs[id(solved.problem.scene)], solved.compared.schedule.steps // 2
        coarser.append(self._coarser(solved, first))
        first = coarser[0].schedule.steps
        before = [n for n in have if n <= first / NEAREST]
        if before:
            coarser.append(have[max(before)])
        if before or known.seen:
            return None

        told = self._unseen(solved, coarser[0], allowed)
        if told is None and first <= half / NEAREST:  # of a look at spaces: larger ones would tell less of an order
            coarser.insert(0, self._with(solved, half))
        elif told is None:
            coarser.append(self._with(solved, max(first // 2, 1)))
        return told

    def _by_others(
        self, solved: Solved, found: TimeError, coarser: list[Compared], allowed: Allowed
    ) -> tuple[TimeError, list[Compared]]:
        """The error by half as many steps and by far fewer, and these runs, where what others tell is doubtful: irregular motion
        is not judged by steps of nearly the same size, nor by some that follow another one. ``unseen`` where half the step has to
        tell it.
        """
        given, half = solved.compared, solved.compared.schedule.steps // 2
        doubted = replace(found, unseen=True)
        if allowed.nearly_lets(found.errors) and kinked(solved.run):
            return doubted, coarser

        farther = max(
            (n for n in self._runs[id(solved.problem.scene)] if n <= half / NEAREST), default=max(half // 2, 1)
        )
        try:
            others = [self._with(solved, n) for n in (half, farther)]
        except UNFIT:
            return doubted, coarser
        return compare_steps(orders_of(solved.problem), given, others), others

    def _unseen(self, solved: Solved, coarser: Compared, allowed: Allowed) -> TimeError | None:
        """The error by the steps from one run with larger ones, where no order has to be seen: half of that of the scheme would
        be enough, or the whole is not, and the run will not be the last; None else, and where some sensor goes astray, or no run
        has told the error of the larger steps: others may agree by chance.

        What is stated goes with three quarters of the order, at least one: neither half nor all of it is far from that; beside
        elements that only ends of steps move with half of it, which these have.
        """
        given, orders = solved.compared, orders_of(solved.problem)
        whole = compare_steps(orders, given, [coarser])
        if not allowed.last:
            halves = {n: 0.5 * p for n, p in orders.items()}
            return replace(whole, errors=of_order(orders, given, coarser, 0.5), orders=halves, with_others=given)
        if allowed.rough and not allowed.lets(whole.errors):
            return replace(whole, with_others=coarser)
        if coarser.schedule.steps in self._untold or astray(given, whole.apart):
            return None
        if not allowed.lets(of_order(orders, given, coarser, 0.5)):
            return None
        # where bodies touch, when they do depends on the steps
        follows = coarser.schedule.steps >= FEWEST and not solved.problem.scene.contacts
        by_ends = seen_by_ends(solved.problem.system)
        slow = of_order(orders, given, coarser, 0.5 if by_ends else 0.75, 1.0)
        return replace(whole, errors=slow, with_others=coarser if follows else given)

    def _from_afar(self, solved: Solved, earlier: Sequence[int], allowed: Allowed) -> TimeError | None:
        """The error by the steps from two earlier runs with far larger ones, if all three show the order of the scheme."""
        given, scene = solved.compared, solved.problem.scene
        orders, have = orders_of(solved.problem), self._runs[id(scene)]
        known = sorted(n for n in earlier if n >= given.schedule.steps / BEYOND)[::-1]
        below = [n for n in earlier if known and n <= known[0] / NEAREST]
        if not below or astray(given, between(given.recorder, have[known[0]].recorder, allowed.sensors)):
            return None
        found = compare_steps(orders, given, [have[known[0]], have[max(below)]])
        seen = known_orders(found)
        regular = resolved(seen, orders, REGULAR) and found.by_chance.isdisjoint(allowed.sensors)
        return found if seen and regular else None

    def _wanted(self, steps: int, known: Orders, earlier: bool) -> int:
        """How many steps a run to compare with is made of: as few as tell the error, half as many where no order was seen."""
        if steps / FARTHEST <= known.follow <= steps / NEAREST:
            return known.follow
        if known.seen or earlier:
            return max(round(steps / 4 / self.grain), 1) * self.grain
        return max(steps // 2, 1)

    def _coarser(self, solved: Solved, steps: int) -> Compared:
        """The run with so many steps, or with half as many as the given one where it does not come to its end."""
        half = solved.compared.schedule.steps // 2
        try:
            return self._with(solved, steps)
        except UNFIT:
            if steps >= half:
                raise
            return self._with(solved, half)

    def _with(self, solved: Solved, steps: int) -> Compared:
        """The run with so many steps."""
        scene, schedule = solved.problem.scene, solved.compared.schedule
        have = self._runs.setdefault(id(scene), {})
        if steps not in have:
            self._refuse_parted(scene, steps)
            try:
                have[steps] = again(solved.problem, schedule, steps, solved.compared.recorder.output.times)
            except UNFIT:
                if steps < schedule.steps:
                    self._parted[tuple(scene.breakpoints)] = steps
                raise
        return have[steps]

    def _with_half(self, solved: Solved) -> Compared:
        """The run with half the step: a whole one, which may be the next attempt, where nothing is called or kept on the way."""
        scene, given = solved.problem.scene, solved.compared
        output, schedule = given.recorder.output, given.schedule.with_steps(2 * given.schedule.steps)
        if acts(output) or self.kept(scene, schedule.steps) is not None:
            return self._with(solved, schedule.steps)
        self._refuse_parted(scene, schedule.steps)
        found = self.solve(scene, given.scheme, schedule, output)
        if found.run.counters.get("halved_steps"):
            raise ConvergenceError("half of the steps had to be made in parts")
        self._whole[id(scene), schedule.steps] = found
        return found.compared

    def _before(self, scene: Scene, scheme: Any, schedule: StepSchedule) -> Compared | None:
        """The attempt before with steps of its own choice, where its tolerance is as much looser as tells an error."""
        found = None if schedule.steps else self._chosen.get(id(scene))
        if found is None or not LOOSER[0] <= found.scheme.rtol / scheme.rtol <= LOOSER[1]:
            return None
        return found


def acts(output: Output) -> bool:
    """Whether anything is called or kept on the way."""
    return bool(output.on_step is not None or output.events or output.snapshots)


def orders_of(problem: Problem) -> dict[str, int]:
    """The order of the scheme in each sensor."""
    return expected_orders(problem.scheme, problem.scene, problem.system)
