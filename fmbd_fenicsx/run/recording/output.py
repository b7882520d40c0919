"""What a user asks a run to record and to show."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...checks import check_fields, instance, vector, whole
from ...errors import InputError, require
from ...log import log
from ...system.system import System

if TYPE_CHECKING:
    from .recorder import Recorder


@dataclass(frozen=True)
class PerSecond:
    """So many snapshots in each second of simulated time: ``Output(snapshots=fmbd.PerSecond(25))``."""

    rate: float

    def __post_init__(self) -> None:
        check_fields(self)
        usable = bool(np.isfinite(self.rate)) and self.rate > 0
        require(usable, f"PerSecond: rate = {self.rate} 1/s must be positive.")


SHARE = 0.5  # of the machine's memory that snapshots may take
ROUNDING = 1e-12  # share by which a time may be after the end of a run
MANY_STEPS = 10_000_000  # up to which there is nothing to say
STEP, LONG = 1e-5, 3600.0  # s of the clock that a step of a few bodies takes, and a run that is told of
MOST = 10_000_000  # snapshots of which even the times are too many


@dataclass(frozen=True)
class Output:
    """What a run records.

    Args:
        every: sensors and energies every so many steps (the last step always).
        times: instants (s) at which sensors and energies are recorded, instead of at the ends of steps; the steps stay as they
            are, and values between their ends are those of the scheme's own polynomial.
        snapshots: states that are kept for pictures, animations and fields: how many, evenly spaced, first and last
            included; or how many per second (:class:`PerSecond`); or at which times (s). A snapshot is the state after the
            first step that reaches its time.
        energy: whether energies are recorded.
        progress: a progress bar; None shows it on rank 0 when standard error is a terminal.
        estimate_error: run again with 2 and 4 times the step and estimate the time-discretisation error of
            each sensor (about 3/4 of the time of the run itself, not counted in its seconds and counters; where these follow
            another motion, with half the step as well: twice the time; where Newton's iteration leaves as much as that, with a
            tighter one as well: three times).
        estimate_reduction: run again with more modes of each reduced body and estimate the error that the left-out modes cause
            in each sensor (one more run of about twice the modes, not counted either).
        estimate_space: run again with each body in a finer space (displacements of one degree more, or half the cell size) and
            estimate the error that the mesh causes in each sensor.
        ledger: whether the power of every force, drive and damping is recorded too, for ``run.ledger``.
        on_step: called after each step with a :class:`~fmbd_fenicsx.run.recording.moment.Moment`: ``now.t``, ``now.step``,
            ``now["tip"]`` for the present value of a sensor. On all ranks; what it returns is ignored. A search with ``tol``
            calls it in each of its runs, whose steps are counted from 1; so do events.
        events: crossings of a value by a sensor, each an :class:`~fmbd_fenicsx.run.recording.events.Event`: the run ends,
            or calls back.
    """

    every: int = 1
    snapshots: int | PerSecond | Sequence[float] = 0
    energy: bool = True
    progress: bool | None = None
    estimate_error: bool = False
    estimate_reduction: bool = False
    estimate_space: bool = False
    times: Sequence[float] | None = None
    on_step: Callable[[Any], Any] | None = None
    ledger: bool = False
    events: Sequence[Any] = ()

    def __post_init__(self) -> None:
        check_fields(self)
        require(
            self.energy or not self.ledger, "Output: a ledger needs the energies, so energy=False does not go with it."
        )
        whole("Output: every =", self.every, least=1)

        if self.times is not None:
            t = vector("Output: times", self.times)
            require(
                bool((np.diff(t) > 0).all() and t[0] >= 0),
                "Output: times must be an increasing list of times from 0 s on.",
            )
        require(
            isinstance(self.events, tuple | list), f"Output: events must be a list of events, found {self.events!r}."
        )

        if self.events:
            self._check_events()

        if isinstance(self.snapshots, int):
            require(self.snapshots >= 0, f"Output: snapshots = {self.snapshots} must not be negative.")
        elif not isinstance(self.snapshots, PerSecond):
            self._check_times()

    def _check_events(self) -> None:
        """Events are objects; runs that are compared with each other have to end at the same time."""
        from .events import Event

        for event in self.events:
            instance("Output: events", event, Event)
        require(
            not self.estimates or all(e.then is not None for e in self.events),
            "Output: a run that ends at an event states no errors: runs that are compared must end at the same time. Solve to "
            "the time of the event with estimates and without the event.",
        )

    def _check_times(self) -> None:
        """Times of snapshots are numbers that rise from 0 on."""
        try:
            times = np.asarray(self.snapshots, dtype=float)
        except (TypeError, ValueError, OverflowError):
            times = np.array(np.nan)
        require(
            times.ndim == 1 and bool(np.isfinite(times).all() and (times >= 0).all() and (np.diff(times) > 0).all()),
            f"Output: snapshots = {self.snapshots!r} must be a number, fmbd.PerSecond(rate), or rising times (s) from 0 on.",
        )

    @property
    def estimates(self) -> bool:
        """Whether an error is to be estimated."""
        return self.estimate_error or self.estimate_reduction or self.estimate_space

    @property
    def calls_back(self) -> bool:
        """Whether a function of the user's is called on the way."""
        return self.on_step is not None or any(event.then is not None for event in self.events)

    def count(self, t_end: float) -> float:
        """How many snapshots are wanted in a run that ends at ``t_end`` (s)."""
        if isinstance(self.snapshots, PerSecond):
            return t_end * self.snapshots.rate + 1
        return float(self.snapshots if isinstance(self.snapshots, int) else len(self.snapshots))

    def due(self, begin: float, t_end: float) -> list[float]:
        """When snapshots are wanted in a run from ``begin`` to ``t_end`` (s)."""
        if isinstance(self.snapshots, PerSecond):
            count = int(np.floor(t_end * self.snapshots.rate * (1 + 1e-12)))
            return [t for k in range(count + 1) if (t := k / self.snapshots.rate) >= begin]
        if isinstance(self.snapshots, int):
            return [float(t) for t in np.linspace(begin, t_end, self.snapshots)] if self.snapshots else []

        late = [t for t in self.snapshots if t > t_end * (1 + 1e-9)]
        require(not late, f"Output: snapshots at {late} s lie after the end of the run, {t_end:g} s.")
        return [float(t) for t in self.snapshots if t >= begin]


def machine_memory() -> float:
    """Of this machine, bytes."""
    return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")


def refuse_too_many(output: Output, system: System, t_end: float, steps: int) -> None:
    """Refuse snapshots that would fill the memory; ``steps`` of the run, 0 where they are not known."""
    wanted = output.count(t_end)
    if not wanted:
        return
    number = min(wanted, steps + 1) if steps else wanted
    # t, q, v, a, lambda of one state; this machine's memory
    size, memory = 8.0 * (system.n_q + 2 * system.n_v + system.n_lam), machine_memory()
    if wanted > MOST or number * size > SHARE * memory:
        raise InputError(
            f"Output: snapshots = {output.snapshots}: {number:.3g} states of {size / 2**20:.3g} MiB take "
            f"{number * size / 2**30:.3g} GiB, and this machine has {memory / 2**30:.3g} GiB. "
            f"Take at most {min(MOST, int(SHARE * memory / size))}."
        )


def judge_plan(recorder: Recorder, steps: int) -> None:
    """Refuse records that would fill the memory, by the size of the first, and tell of steps that take hours: a time in a wrong
    unit asks for milliards.

    An event that ends the run may come at any time: nothing is known then.
    """
    output = recorder.output
    if any(event.then is None for event in output.events):
        return
    span = recorder.t_end - recorder.scene.begins
    planned = f"{steps:.3g} steps of {span / steps:.3g} s up to t_end = {recorder.t_end:g} s (is one of them in another unit?)"

    rows = (recorder.moments, *recorder.energies.values(), *recorder.values.values())
    size = 8.0 + sum(piece.nbytes for kept in rows for piece in kept)
    records, memory = (recorder.expected, machine_memory()) if recorder.instants is None else (0, 1.0)
    if records * size > SHARE * memory:
        every = int(-(-steps * size // (SHARE * memory)))
        raise InputError(
            f"{planned} make {records:.3g} records of {size:.0f} bytes, {records * size / 2**30:.3g} GiB, and this machine has "
            f"{memory / 2**30:.3g} GiB. Take a larger dt or a shorter run, or record less: Output(every={every}) or more, or "
            "Output(times=...)."
        )
    if steps * STEP > LONG:
        log.warning(
            "%s take some %.2g hours, at the %g us that a step of a few bodies takes",
            planned,
            steps * STEP / 3600.0,
            1e6 * STEP,
        )
