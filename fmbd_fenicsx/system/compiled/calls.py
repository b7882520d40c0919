"""What the driver asks of Python: values that depend on time, once a step, and laws of the user's own, at every evaluation.

An exception is kept, the driver stops with the verdict FAILED, and the caller raises it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...errors import ConvergenceError, LinearSolveError
from ...kernel_cache import address_of
from ...mechanics.forces.formulas import TARGET
from ...mechanics.forces.laws_together import mean_effort
from ...mechanics.joints.couplings import SmoothMotion, Standing
from ...mechanics.kinds.python_kinds import PythonKind
from .declarations import PYTHON, enumeration
from .tables.items.item_batches import turned, turning
from .tables.items.items import GIVEN, Items
from .tables.items.tied import motions_of_ties
from .tables.tables import MOTIONS, Tables

ASKED = enumeration("SAMPLE")  # what C asks for
OUTSIDE = enumeration("OUTSIDE")["OUTSIDE"]  # an answer
WHOLE_SAMPLE, PLACES, RATES = enumeration("WHOLE_SAMPLE").values()
NUMPYS = tuple(
    ASKED[what]
    for what in (
        "FIELD",
        "FIELD_FORCES",
        "FIELD_MEANS",
        "FIELD_PORTS",
        "FIELD_TANGENTS",
        "PART_FORCES",
        "PART_POINTS",
        "PART_TANGENTS",
        "FREQUENCIES",
        "LOOK_AT_END",
    )
)  # where these fail NumPy makes the step


class Calls:
    """The one function that C calls, for the tables of one system."""

    def __init__(self, tables: Tables) -> None:
        self.tables, self.system = tables, tables.system
        self.error: Exception | None = None
        self.moving = _motions(self.system)
        self.of_rows = [np.zeros((len(motions), 3)) for _, motions, _ in self.moving]
        self.prescribed = self._prescribed()
        self._write_motions()

        # loads, gravity and targets of laws, as far as these depend on time
        self.loaded = [_load_of(tables, x) for x in tables.sources if x.load is not None]
        self.given = [x for x in tables.sources if x.role == GIVEN and x.given is not None]
        self.heavier = not self.system.gravity.steady
        formulas = ((x.arrays, x.formula) for x in tables.sources if x.formula is not None)
        self.targets = [
            (arrays["constants"], [_moving(x) for x in formula.targets])
            for arrays, formula in formulas
            if formula.moves
        ]

        # functions of the user's own, and how often C asks
        self.asked: list[Any] = [items.kind.function for items in tables.items if isinstance(items.kind, PythonKind)]
        self.loaded_rods = [rod for rod in tables.rods if rod.of_time]
        timed = (self.prescribed, self.loaded, self.given, self.loaded_rods, self.targets)
        slower = any(_differentiated(motion) for motion, _ in self.prescribed)
        tables.c.samples = int(self.heavier or any(timed)) + int(slower)

        self.written: int = self._list_timed()  # numbers
        self.answers = self._answers()
        self.function = PYTHON(self.answer)
        tables.c.python = self.function

    def _prescribed(self) -> list[tuple[Any, Any]]:
        """Motions of rows and of drives with the places (3,) of their s, s' and s''; those that stand still are told here."""
        found: list[tuple[Any, Any]] = []
        for values, (_, motions, _) in zip(self.of_rows, self.moving, strict=True):
            found += zip(motions, values, strict=True)
        for items in (x for x in self.tables.sources if x.drive):
            place = items.kind.place("drive").start
            found += zip(items.drive, items.table[:, place : place + 3], strict=True)

        for motion, value in found:
            if isinstance(motion, Standing):
                value[:] = motion(0.0)
        return [x for x in found if not isinstance(x[0], Standing)]

    def _list_timed(self) -> int:
        """Tell C which arrays a sample writes; numbers in all of them."""
        tables = self.tables
        written = [tables.arrays[name] for name in MOTIONS if self.moving]
        written += [x.table for x in tables.sources if x.drive or x.load is not None]
        written += [x.arrays["effort"] for x in self.given]
        written += [constants for constants, _ in self.targets]
        written += [rod.load for rod in self.loaded_rods]
        written += [tables.arrays["gravity"]] if self.heavier else []

        store = tables.store
        tables.c.timed = len(written)
        tables.c.timed_at = store.array([address_of(x) for x in written], np.uint64)[1]
        tables.c.timed_size = store.array([x.size for x in written], np.int64)[1]
        size = sum(x.size for x in written)
        kept = store.zeros({"first": size, "second": size, "recent": (len(tables.c.recent_at), size)})
        *ends, tables.c.recent = (place for _, place in kept.values())
        for end, place in enumerate(ends):
            tables.c.sampled[end] = place
        return size

    def answer(self, what: int, number: int, t: float) -> int:
        """0, 1 after an exception, OUTSIDE where a field's forces have no value, or its tangent no factor."""
        try:
            self.answers[what](number, t)
        except Exception as error:
            if what in NUMPYS and isinstance(error, ConvergenceError | LinearSolveError):
                return OUTSIDE
            self.error = error
            return 1
        return 0

    def _answers(self) -> dict[int, Callable[[int, float], None]]:
        """What is done for each of the numbers that C asks with: (number of a batch, body or rod; time)."""
        tables = self.tables
        said: dict[str, Callable[[int, float], None]] = {
            "SAMPLE": self.sample,
            "EFFORT": self._effort,
            "EFFORTS_AHEAD": self._efforts_ahead,
            "EFFORT_MEANS": self._mean_effort,
            "SLOPES": self._slopes,
            "KEEP": lambda number, t: tables.listening.keep(t),
            "EFFORTS": lambda number, t: tables.listening.efforts(t),
            "COLLOCATE": lambda number, t: tables.listening.collocate(),
            "MEMORY_ERROR": lambda number, t: tables.listening.tell_error(),
            "TRAPEZOID_ERROR": lambda number, t: tables.listening.tell_trapezoid_error(t),
            "LEAD_MEMORIES": lambda number, t: tables.listening.lead(),
            "EFFORT_SLOPES": lambda number, t: tables.listening.slopes(t),
            "WRENCHES_AHEAD": lambda number, count: tables.whole[number].wrenches_ahead(int(count)),
            "WRENCHES": lambda number, t: tables.whole[number].wrenches(t),
            "WHOLE_SLOPES": lambda number, t: tables.whole[number].slopes(t),
            "SECTIONS": lambda number, t: tables.rods[number].sections(),
            "SECTION_SLOPES": lambda number, t: tables.rods[number].section_slopes(),
            "FIELD": lambda number, t: tables.fields[number].solve(),
            "FIELD_FORCES": lambda number, t: tables.fields[number].forces(t),
            "FIELD_MEANS": lambda number, t: tables.fields[number].mean_forces(t),
            "FIELD_PORTS": lambda number, t: tables.fields[number].move(t),
            "FIELD_LOADS": lambda number, t: tables.fields[number].forces_in_c.load(t),
            "FIELD_ENERGIES": lambda number, t: tables.fields[number].energies(t),
            "FIELD_TANGENTS": lambda number, t: tables.renew_fields(t, predicted=bool(number)),
            "LOOK_AT_END": lambda number, t: tables.look_at_end(),
            "FREQUENCIES": lambda number, key: tables.frequencies(key),
            "PART_FORCES": lambda number, t: tables.told[number].forces(t),
            "PART_POINTS": lambda number, t: tables.told[number].points(),
            "PART_ENERGIES": lambda number, t: tables.told[number].energies(t),
            "PART_TANGENTS": lambda number, t: tables.told[number].tangents(t),
            "PART_SLOPES": lambda number, t: tables.told[number].slopes(t),
        }

        return {value: said[name] for name, value in ASKED.items()}

    def raise_error(self) -> None:
        """Raise what a call left behind."""
        for function in self.asked:
            self.error, function.error = self.error or function.error, None
        error, self.error = self.error, None
        if error is not None:
            raise error

    def forget_error(self) -> None:
        """Of a call that is made once more, by someone who says more about it."""
        self.error = None
        for function in self.asked:
            function.error = None

    def sample(self, part: int, t: float) -> None:
        """Everything that depends on time only, WHOLE_SAMPLE, or a part of it as ``driver/tables.h`` has them."""
        if part != RATES:
            self._ask_laws_of_time(t)
        if self.prescribed:
            self._move(t, part)

    def _move(self, t: float, part: int) -> None:
        """Motions at a time: (s, s', s''), or what a part of a sample has of these."""
        for motion, value in self.prescribed:
            if part == WHOLE_SAMPLE:
                value[:] = motion(t)
            elif not _differentiated(motion):
                if part == PLACES:  # its rates come with it
                    value[:] = motion(t)
            elif part == PLACES:
                value[0] = motion.place(t)
            else:
                value[1:] = motion.rates(t)
        self._write_motions()

    def _write_motions(self) -> None:
        """Those of rows, where C finds them."""
        arrays = self.tables.arrays
        for (rows, _, factor), values in zip(self.moving, self.of_rows, strict=True):
            for name, given in zip(MOTIONS, values.T, strict=True):
                arrays[name][rows] = factor * given

    def _ask_laws_of_time(self, t: float) -> None:
        """Loads, given efforts, targets and gravity at a time, into the tables."""
        tables = self.tables
        for write in self.loaded:
            write(t)

        for items in self.given:
            assert items.given is not None
            items.arrays["effort"][:] = items.given(t)
        for constants, targets in self.targets:
            constants[:, TARGET : TARGET + 2] = [target(t) for target in targets]
        for rod in self.loaded_rods:
            rod.sample(t)
        if self.heavier:
            tables.arrays["gravity"][:] = self.system.gravity(t)

    def _effort(self, number: int, t: float) -> None:
        items = self.tables.sources[number]
        x, law = items.arrays, items.law
        assert law is not None
        s = x["s"] - x["free"]
        law.asked.note(s)
        x["effort"][:] = law(s, x["rate"], t)

    def _efforts_ahead(self, number: int, count: float) -> None:
        """N at so many points of a step."""
        items = self.tables.sources[number]
        if items.law is None:
            self.tables.listening.efforts_ahead(int(count))
            return
        free, points, law = items.arrays["free"], items.ahead[: int(count)], items.law
        n = free.size
        assert law is not None
        s, rate = points[:, 1 : 1 + n] - free, points[:, 1 + n : 1 + 2 * n]
        law.asked.note(s)
        points[:, 1 + 2 * n :] = law(s, rate, points[:, :1])

    def _mean_effort(self, number: int, t: float) -> None:
        """Means of laws over a step, from the coordinates where it begins on at their mean rates."""
        items = self.tables.sources[number]
        x, law = items.arrays, items.law
        assert law is not None
        begun, rate = x["s"] - x["free"], x["rate"]
        x["effort"][:] = mean_effort(lambda s, rate: law(s, rate, t), begun, rate, self.tables.c.span)

    def _slopes(self, number: int, t: float) -> None:
        """Derivatives of laws by the coordinate and by its rate."""
        items = self.tables.sources[number]
        x, law = items.arrays, items.law
        assert law is not None
        x["stiffness"][:], x["damping"][:] = law.slopes(x["s"] - x["free"], x["rate"], t)


def _load_of(tables: Tables, items: Items) -> Callable[[float], None]:
    """What writes the constants of items that depend on time."""
    load = items.load
    columns = {name: items.kind.place(name) for name in items.constants}
    plain = all(turning(tables, items, name) is None for name in columns)
    assert load is not None

    def write(t: float) -> None:
        for name, values in load(t).items():
            items.table[:, columns[name]] = values if plain else turned(tables, items, name, values)

    return write


def _differentiated(motion: Any) -> bool:
    """Whether the rates of a motion are found by differentiation, apart from its place."""
    return isinstance(motion, SmoothMotion) and not motion.complete


def _moving(target: Any) -> Callable[[float], tuple[float, float]]:
    """A target as t -> (s, s')."""
    if isinstance(target, SmoothMotion):
        return target.moving
    return lambda t: target(t)[:2]


def _motions(system: Any) -> list[tuple[np.ndarray, list[Any], Any]]:
    """Rows with a prescribed motion on their right-hand side, these motions (one each, or one for all), and factors of these."""
    from ...mechanics.joints.constraints import DrivenKinds

    out: list[tuple[np.ndarray, list[Any], Any]] = []
    for batch, rows in system.batches:
        if batch.driven and not isinstance(batch, DrivenKinds):
            out.append((rows[[i for i, _ in batch.driven]], [motion for _, motion in batch.driven], 1.0))
    return out + motions_of_ties(system)
