"""Studies: observed orders of convergence, and error against work; tables for the terminal, for Markdown and
for tests.

A study runs a callable ``parameter -> Run`` over values of the parameter: a step size, a mesh size, a
tolerance. Errors are taken against a reference run or exact functions of time, separately for each sensor
and, where the reference has the same unknowns, for the last state's positions "q", velocities "v" and
multipliers "lam". A user's test reads

    table = orders(lambda h: solve(scene, t_end=1.0, dt=h), [4e-3, 2e-3, 1e-3])
    table.assert_order("tip", 2.0)
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import shown, typed
from ..errors import FmbdError, InputError, near, require
from ..ranks import world_rank
from ..rotations import Array
from ..run.result import Run
from ..run.variants import Variant as Variant
from ..run.variants import Variants as Variants
from ..run.variants import run_variants as map  # noqa: F401
from ..schemes.declared import Declared
from .exchange.files import write_whole
from .text_tables import Table
from .text_tables import aligned as aligned
from .text_tables import markdown as markdown

__all__ = [
    "Configuration",
    "OrderTable",
    "WorkPrecision",
    "aligned",
    "compare",
    "map",
    "markdown",
    "orders",
    "work_precision",
]


def __dir__() -> list[str]:
    """What is public here."""
    return __all__


Exact = Mapping[str, Callable[[float], Any]]
"""Sensor name -> exact value as a function of time (s)."""

STATE = ("q", "v", "lam")


@dataclass(frozen=True)
class _Trace:
    """What is kept of a run: its recorded values, and its last state with the system that it belongs to."""

    times: Array
    series: dict[str, Array]
    run: Run
    known: Sequence[str]  # sensors and their components

    @classmethod
    def of(cls, run: Run) -> _Trace:
        require(hasattr(run, "series"), f"study: the function must return a run of fmbd.solve, found {shown(run)}.")
        known = dict.fromkeys((*run.series, *(part for name in run.series for part in run.components(name))))
        return cls(np.asarray(run.times), dict(run.series), run, tuple(known))

    def has(self, times: Array) -> Array:
        """Which instants are recorded, to 1e-9 of the end time."""
        return np.abs(self.times[self._rows(times)] - times) <= 1e-9 * self.times[-1]

    def values(self, name: str, times: Array) -> Array:
        """A sensor, or a component, at recorded instants, (instants, size)."""
        return self.run[name].reshape(len(self.times), -1)[self._rows(times)]

    def _rows(self, times: Array) -> np.ndarray:
        """The nearest to each."""
        return np.array([np.argmin(np.abs(self.times - t)) for t in times], dtype=int)


@dataclass(frozen=True)
class _Functions:
    """Exact functions of time in the place of a run."""

    series: Exact
    run: None = None

    @property
    def known(self) -> Sequence[str]:
        """What they are of."""
        return tuple(self.series)

    def has(self, times: Array) -> Array:
        """All of them."""
        return np.ones(len(times), dtype=bool)

    def values(self, name: str, times: Array) -> Array:
        """A sensor at any instants."""
        return np.array([np.atleast_1d(self.series[name](float(t))) for t in times])


def _common_times(traces: Sequence[_Trace], reference: _Trace | _Functions) -> Array:
    """Instants that all runs have recorded, and the reference knows, the start left out."""
    common = traces[0].times[1:]
    for other in (*traces[1:], reference):
        common = common[other.has(common)]
    require(len(common) > 0, "The runs of this study have no instant in common at which they could be compared.")
    return common


def _errors(trace: _Trace, reference: _Trace | _Functions, times: Array, names: Sequence[str]) -> dict[str, float]:
    """Largest absolute error of each named quantity over the given instants (of the state: at the end);
    collective.
    """
    found = {}
    for name in names:
        if name in trace.known:
            found[name] = float(np.abs(trace.values(name, times) - reference.values(name, times)).max())
        else:
            assert reference.run is not None
            found[name] = _state_error(trace.run, reference.run, name)
    return found


def _state_error(run: Run, reference: Run, name: str) -> float:
    s, x, y = run.system, run.state, reference.state
    if name == "lam":
        return float(np.abs(x.lam - y.lam).max(initial=0.0))
    return s.max_abs(s.difference(y.q, x.q) if name == "q" else x.v - y.v)


def _names(traces: Sequence[_Trace], reference: _Trace | _Functions, wanted: Sequence[str] | None) -> list[str]:
    """Quantities to compare: those asked for, else all that runs and reference share."""
    shared = [name for name in traces[0].known if name in reference.series]
    if reference.run is not None:
        systems = [run.system for run in (reference.run, *(trace.run for trace in traces))]
        if len({(system.n_q, system.n_lam) for system in systems}) == 1:
            shared += [name for name in STATE if name not in shared]
    if not traces[0].run.system.n_lam and "lam" in shared:
        shared.remove("lam")
    known = dict.fromkeys((*shared, *(name for name in traces[0].known if name in reference.known)))
    for name in wanted or ():
        if name not in known:
            raise InputError(f'Study: "{name}" cannot be compared with the reference. {near(name, known)}')
    require(bool(shared), "Study: the runs and the reference have no sensor in common.")
    return list(wanted) if wanted else shared


@dataclass(frozen=True, repr=False)
class OrderTable(Table):
    """Errors over a falling parameter, and the observed orders.

    Attributes: ``parameter`` its name, ``values`` (n,) falling, ``errors`` quantity -> (n,) in the quantity's
        unit.
    """

    parameter: str
    values: Array
    errors: dict[str, Array]

    def pairwise(self, name: str) -> Array:
        """Orders between neighbours, (n - 1,): log(e_k / e_k+1) / log(h_k / h_k+1)."""
        e = self._of(name)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.log(e[:-1] / e[1:]) / np.log(self.values[:-1] / self.values[1:])

    def order(self, name: str) -> float:
        """Slope of log(error) over log(parameter), least squares over the finest three."""
        e = self._of(name)[-3:]
        h = self.values[-3:]
        # an error of zero, or none, has no slope
        if not (np.isfinite(e).all() and (e > 0).all()):
            return float("nan")
        return float(np.polyfit(np.log(h), np.log(e), 1)[0])

    def assert_order(self, name: str, expected: float, tolerance: float = 0.1) -> None:
        """Fail, with the table, unless the order over the finest three is above ``expected - tolerance``."""
        measured = self.order(name)
        if not measured > expected - tolerance:
            raise AssertionError(f'Order of "{name}" is {measured:.3f}, expected {expected:g} - {tolerance:g}.\n{self}')

    def rows(self) -> list[list[str]]:
        """Cells of the table, the header first, the order over the finest three last."""
        table = [[self.parameter], *[[f"{h:.4g}"] for h in self.values], ["finest three"]]
        for name, errors in self.errors.items():
            cells = [name, *(f"{e:.2e}" for e in errors), ""]
            orders = ["order", "", *(f"{p:.2f}" for p in self.pairwise(name)), f"{self.order(name):.2f}"]
            for line, *pair in zip(table, cells, orders, strict=True):
                line += pair
        return table

    def __repr__(self) -> str:
        return f"<OrderTable over {self.parameter}: {', '.join(self.errors)}>"

    def _of(self, name: str) -> Array:
        if name not in self.errors:
            raise InputError(f'No "{name}" in this table. {near(name, self.errors)}')
        return self.errors[name]


@typed
def orders(
    run: Callable[[float], Run],
    values: Sequence[float],
    *,
    reference: Run | Exact | None = None,
    names: Sequence[str] | None = None,
    parameter: str = "h",
) -> OrderTable:
    """Run over falling values of a parameter and observe the orders of convergence; collective.

    Args:
        run: parameter -> run, say ``lambda h: solve(scene, t_end=1.0, dt=h)``.
        values: at least two, falling; steps that divide each other compare at all instants of the coarsest.
        reference: a finer run, or exact functions of time by sensor name; None runs values[-1] / 8, whose own
            error makes the observed order of a second-order scheme 0.02 too large.
        names: quantities to compare, sensors or components, "tip y"; by default all sensors, and "q", "v", "lam" of
            the last state where sizes agree.

    Raises:
        InputError: the values are steps, and the scheme chooses its own (rtol).
    """
    require(len(values) >= 2, "orders: at least two values are needed.")
    falling = all(a > b > 0 for a, b in pairwise(values))
    require(falling, f"orders: the values must be positive and fall, found {list(values)}.")
    traces = [_Trace.of(run(h)) for h in values]
    _refuse_chosen_steps([trace.run for trace in traces])

    against = _reference(run(values[-1] / 8) if reference is None else reference)
    times = _common_times(traces, against)
    kept = _names(traces, against, names)

    found = [_errors(trace, against, times, kept) for trace in traces]
    return OrderTable(parameter, np.asarray(values, dtype=float), {n: np.array([e[n] for e in found]) for n in kept})


def _refuse_chosen_steps(runs: Sequence[Run]) -> None:
    """Steps that a scheme chooses are not those that were asked for: errors go with its tolerance, and show no order in dt."""
    limits, tolerances = {r.step_limit for r in runs}, {Declared.by(r.scheme).rtol for r in runs}
    same = len({(r.system.n_q, r.system.n_lam) for r in runs}) == 1 == len(tolerances)
    if same and tolerances != {None} and len(limits) == len(runs):
        raise InputError(
            f"orders: {runs[0].scheme.name} chooses its steps by rtol = {tolerances.pop():g}; dt only bounds them, and errors do "
            "not go with it. Give the scheme rtol=None for equal steps, or study the tolerance: "
            'orders(lambda r: solve(..., scheme=replace(scheme, rtol=r)), [1e-4, 1e-6, 1e-8], parameter="rtol").'
        )


def _reference(given: Run | Exact) -> _Trace | _Functions:
    return _Functions(given) if isinstance(given, Mapping) else _Trace.of(given)


@dataclass(frozen=True)
class Configuration:
    """One line of a work-precision diagram: a label, a callable parameter -> run, and the parameter's
    values.
    """

    label: str
    run: Callable[[float], Run]
    values: Sequence[float]


@dataclass(frozen=True)
class Point:
    """One run of a work-precision study; ``seconds`` is the median over repeats of the time spent in
    steps, ``setup`` the seconds before the first step of the first of them: modes, forms, the consistent start.
    ``stated``: errors of reduction that the run states itself, where it does.
    """

    label: str
    value: float
    errors: dict[str, float] = field(default_factory=dict)
    stated: dict[str, float] = field(default_factory=dict)
    seconds: float = float("nan")
    setup: float = float("nan")
    counters: dict[str, float] = field(default_factory=dict)
    failure: str = ""


@dataclass(frozen=True, repr=False)
class WorkPrecision(Table):
    """Error (in ``units``) against work for several configurations; failures are listed, not left out."""

    points: tuple[Point, ...]
    units: Mapping[str, str] = field(default_factory=dict)
    heads: tuple[str, str] = ("configuration", "parameter")

    @property
    def failures(self) -> tuple[Point, ...]:
        """Runs that did not finish."""
        return tuple(p for p in self.points if p.failure)

    @property
    def quantities(self) -> list[str]:
        """Names of the compared quantities."""
        return list(dict.fromkeys(n for p in self.points for n in p.errors))

    def rows(self, counters: Sequence[str] = ("steps", "newton_iterations", "back_solves")) -> list[list[str]]:
        """Cells of the table, the header first: errors, with those that runs state themselves, and work."""
        names = self.quantities
        saying = {n for p in self.points for n in p.stated}
        shown = [c for n in names for c in ([n, f"{n}, stated"] if n in saying else [n])]

        table = [[*self.heads, *shown, "seconds", "ms/step", "set-up, s", *counters]]
        for p in self.points:
            known = {**p.errors, **{f"{n}, stated": x for n, x in p.stated.items()}}
            errors = [_cell(known.get(c), ".2e", "failed" if p.failure else "") for c in shown]

            steps = p.counters.get("steps")
            work = [_cell(x, ".3g") for x in (p.seconds, 1e3 * p.seconds / steps if steps else None, p.setup)]
            work += [_cell(p.counters.get(c), ".0f") for c in counters]
            table.append([p.label, _cell(p.value, ".4g"), *errors, *work])
        return table

    def __str__(self) -> str:
        where = ["" if np.isnan(p.value) else f" at {p.value:.4g}" for p in self.failures]
        why = [p.failure.splitlines()[0] for p in self.failures]
        failed = [f"failed: {p.label}{at}: {w}" for p, at, w in zip(self.failures, where, why, strict=True)]
        return "\n".join([aligned(self.rows()), *failed])

    def __repr__(self) -> str:
        return f"<WorkPrecision of {len(self.points)} runs, {len(self.failures)} failed: {', '.join(self.quantities)}>"

    def json(self, file: str | Path) -> None:
        """Write all points to a JSON file (rank 0)."""
        if world_rank() == 0:
            table = json.dumps([asdict(p) for p in self.points], indent=1) + "\n"
            write_whole("The study", file, lambda place: place.write_text(table))

    def figure(self, file: str | Path, *, work: str = "seconds", title: str = "") -> None:
        """Write a log-log figure: error of each quantity over seconds or a counter (``work``), under a title; rank 0."""
        from .plot import plot_work_precision

        plot_work_precision(self, file, work, title)


def _cell(x: float | None, form: str, missing: str = "") -> str:
    return missing if x is None or np.isnan(x) else f"{x:{form}}"


@typed
def work_precision(
    configurations: Sequence[Configuration],
    *,
    reference: Run | Exact,
    names: Sequence[str] | None = None,
    repeats: int = 3,
) -> WorkPrecision:
    """Errors against wall time and counters; collective.

    Each run is made ``repeats`` times after one that warms caches and compiled forms; the first
    configuration's first value serves for that. Errors are taken at the instants common to all runs and the
    reference, at least the end time.
    """
    require(
        repeats >= 1 and bool(configurations), "work_precision: at least one configuration and one repeat are needed."
    )

    against = _reference(reference)
    warm = _attempt(configurations[0].run, configurations[0].values[0])
    done = [(c, value, *_trials(c.run, value, repeats)) for c in configurations for value in c.values]
    traces = [trace for _, _, trace, _ in done if isinstance(trace, _Trace)]

    # errors are taken at instants, and of sensors, that all runs have
    times: Array = np.zeros(0)
    kept: list[str] = []
    if traces:
        times = _common_times(traces, against)
        kept = _names(traces, against, names)

    points = []
    for c, value, trace, seconds in done:
        if isinstance(trace, str):
            points.append(Point(c.label, value, failure=trace))
            continue
        # the first run warmed the caches: its set-up is that of a stranger's first call
        first = warm if not points and isinstance(warm, Run) else trace.run
        counters = {k: float(x) for k, x in trace.run.counters.items()}
        stated = {n: x for n, x in trace.run.reduction_error.items() if n in kept}
        errors = _errors(trace, against, times, kept)
        setup = first.seconds["set-up"] + first.seconds["start"]
        points.append(Point(c.label, value, errors, stated, seconds, setup, counters))

    sensors = traces[0].run.scene.sensors if traces else {}
    return WorkPrecision(tuple(points), {n: sensors[n].unit for n in kept if n in sensors})


@typed
def compare(
    run: Callable[[Any], Run],
    variants: Mapping[str, Any],
    *,
    reference: Run | Exact,
    names: Sequence[str] | None = None,
    repeats: int = 3,
) -> WorkPrecision:
    """One scene with several bodies, or several of anything else, in one table; collective.

        compare(swing, {"rigid": rod.reduced(modes=0), "16 modes": rod.reduced(modes=16), "floating": rod}, reference=...)

    ``run`` makes a run from a variant; a row has the number of its unknowns, the errors against the reference and, where its
    output asks for them, those of reduction that the run states itself, the time of a step and of the set-up.
    """
    sizes: dict[str, float] = {}

    def made(label: str) -> Run:
        found = run(variants[label])
        sizes[label] = sum(n for _, n in found.plan.unknowns)
        return found

    each = [Configuration(k, lambda _, k=k: made(k), [float("nan")]) for k in variants]  # type: ignore[misc]
    table = work_precision(each, reference=reference, names=names, repeats=repeats)
    points = tuple(replace(p, value=sizes.get(p.label, p.value)) for p in table.points)
    return replace(table, points=points, heads=("variant", "unknowns"))


def _trials(run: Callable[[float], Run], value: float, repeats: int) -> tuple[_Trace | str, float]:
    """The first of some equal runs, or the message of its failure; and the median of the seconds spent in
    steps.
    """
    first = _attempt(run, value)
    if isinstance(first, str):
        return first, float("nan")

    seconds = [first.seconds["steps"], *(run(value).seconds["steps"] for _ in range(repeats - 1))]
    return _Trace.of(first), statistics.median(seconds)


def _attempt(run: Callable[[float], Run], value: float) -> Run | str:
    """A run, or the message with which it failed (numerical failures only; input errors are raised)."""
    try:
        return run(value)
    except InputError as error:
        # wrong input is the caller's; what fails on the way is a result
        if isinstance(error.__cause__, ArithmeticError):  # in a function of the user's
            return f"{type(error).__name__}: {error}"
        raise
    except (FmbdError, ArithmeticError, np.linalg.LinAlgError) as error:
        return f"{type(error).__name__}: {error}"
