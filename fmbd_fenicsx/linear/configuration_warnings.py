"""What the solver of a step says of a configuration: ties that depend on each other, singular positions, motions not held."""

from __future__ import annotations

import numpy as np

from ..log import log
from ..matrices import dense
from ..rotations import Array
from ..system.dependence import CERTAIN, NEAR_SINGULAR, rows_are_independent, rows_differ
from ..system.evaluation import Evaluation
from ..system.lengths import Measured
from ..system.mobility import ALIKE, mobility, nearly_dependent, nearly_the_same

CLOSE = 1e-3  # sigma_min / sigma_max of a position close to a singular one
CORRECTIONS = 2  # of a solution where dependent rows are the same, see algebra/factor.c
MORE = 4  # where they nearly are
GEARED = 1e-3  # share of a gear in redundant rows above which they are its own
LOOK_LIMIT = 600  # constraint rows up to which dependent ones are counted


def dependent_rows(ev: Evaluation) -> tuple[int, int]:
    """How many constraint rows depend on others in a configuration, with a word on ties that do, and how many corrections
    solutions take then; of many rows only whether some do: their number is 0. Collective.

    The configuration looked at last is kept with the system: runs with other steps begin in the same one.
    """
    known = ev.system.cache.get("dependent rows")
    if known is not None and _same_everywhere(ev, *known[:2]):
        return known[2]  # type: ignore[no-any-return]
    found = _look(ev)
    note_dependent_rows(ev, found)
    return found


def note_dependent_rows(ev: Evaluation, found: tuple[int, int]) -> None:
    """What :func:`dependent_rows` has to say of a configuration: runs that begin in it need not look."""
    ev.system.cache["dependent rows"] = ev.t, ev.q.copy(), found


def _look(ev: Evaluation) -> tuple[int, int]:
    """See :func:`dependent_rows`."""
    if not ev.system.n_lam or rows_are_independent(ev):
        return 0, 0
    if ev.system.n_lam > LOOK_LIMIT:
        return 0, 0 if rows_differ(ev) else CORRECTIONS
    found = mobility(ev)
    warn_of_ties(ev.system, found.shares)
    warn_of_gears(ev, found.shares)
    if not found.redundant:
        return 0, 0
    if near := nearly_the_same(found):
        log.warning("%s", near)
    return found.redundant, MORE if near or found.misfit > ALIKE else CORRECTIONS


def _same_everywhere(ev: Evaluation, t: float, q: Array) -> bool:
    """Whether a configuration is one known before, on all ranks; collective."""
    other = ev.t != t or not np.array_equal(ev.q, q)
    fields = ev.system.fields
    return not (fields[0][1].field.total(np.array(float(other))) if fields else other)


def warn_of_ties(system: Measured, shares: dict[str, float]) -> None:
    """Say which surface ties depend on each other; their multipliers are then of minimum norm."""
    names = [b.name for b in system.blocks if b.kind == "surface tie" and b.name in shares]
    if names:
        log.warning(
            "ties %s depend on each other where their surfaces meet (%d redundant rows): tractions there are not unique. "
            "Use spaces with merged ends, say fmbd.Continuous(1).", names, round(sum(shares.values())),
        )  # fmt: skip


def warn_of_gears(ev: Evaluation, shares: dict[str, float]) -> None:
    """Say which gears count as depending on each other, where they may not: a train that reduces too far and comes back does not;
    two planets between the same wheels do.
    """
    names = [b.name for b in ev.system.blocks if b.kind == "gear" and shares.get(b.name, 0.0) > GEARED]
    if names and np.prod([reduction(ev, name) for name in names]) >= 1.0 / NEAR_SINGULAR:
        log.warning(
            "gears %s count as depending on others (%.0f redundant rows). Where they hold the same twice, all is well; those of "
            "a train that reduces by %.0e or more and comes back let its ends turn apart: take one gear of its total ratio.",
            ", ".join(f'"{name}"' for name in names), sum(shares.values()), 1.0 / NEAR_SINGULAR,
        )  # fmt: skip


def reduction(ev: Evaluation, gear: str) -> float:
    """By how much a gear reduces at most: its largest motion of a body over the smallest, turns by the model's length; infinite
    where not two bodies with frames tell it.
    """
    s = ev.system
    n = s.motions.n_twist
    core = ev.jacobian.core
    row = dense((core if isinstance(core, np.ndarray) else core.tocsr())[s.block(gear).rows])[0, : s.n_frames * n]
    sizes = np.linalg.norm((row / s.units[: len(row)]).reshape(-1, n), axis=1)
    sizes = sizes[sizes > 0.0]
    return float(sizes.max() / sizes.min()) if len(sizes) > 1 else np.inf


class NearSingular:
    """One line for each time that the configuration comes close to a singular one; ``now``: whether it is close.

    Of steps that may be rejected only what an accepted one has met is said: those that fail look far ahead.
    """

    def __init__(self) -> None:
        self.now = False
        self._began = False
        self._met: list[tuple[float, str, float]] | None = None  # in a trial

    def look(self, ev: Evaluation, rank: int | None, *, limit: float = NEAR_SINGULAR, evens: bool = True) -> None:
        """``limit``: sigma_min / sigma_max below which it is close. Once warned of, a position is left behind above ``CLOSE``.

        ``evens``: whether who solves bears motions of frames of any sizes, as behind gears.
        """
        if rows_are_independent(ev, max(CERTAIN, CLOSE if self.now else limit), evens=evens):
            self.now = False
            return
        ratio, joint = nearly_dependent(ev, rank or ev.system.n_lam, evens=evens)
        if ratio < limit and not self.now:
            met = (ratio, joint, ev.t)
            if self._met is None:
                self._say(met)
            else:
                self._met.append(met)
        self.now = bool(ratio < (CLOSE if self.now else limit))

    def begin_trial(self) -> None:
        """A step begins that may be rejected, and so was the one before, if that was not accepted."""
        if self._met is not None:
            self.now = self._began
        self._began, self._met = self.now, []

    def accept_trial(self) -> None:
        """The step counts: say what it met."""
        for met in self._met or ():
            self._say(met)
        self._met = None

    def _say(self, met: tuple[float, str, float]) -> None:
        log.warning('near-singular: sigma_min/sigma_max = %.1e, joint "%s", t = %g s', *met)
