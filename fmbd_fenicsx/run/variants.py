"""Many variants of a scene on all cores: the same mechanism with other data.

Each variant is a run of its own, so its results are those of a single run to the last bit. The runs are shared out among
processes, copies of this one: kernels are compiled and kept by the first variant, before there are any copies. What a copy found
comes back as arrays.
"""

from __future__ import annotations

import gc
import os
import pickle
import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from inspect import signature
from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import fitted, function, refuse
from ..errors import FmbdError, InputError, LawError, near, require
from ..kernel_cache import cores
from ..ranks import world_size
from ..rotations import Array
from ..system.scene.alike import alike
from ..system.scene.scene import Scene
from .recording.output import Output
from .solve import solve

if TYPE_CHECKING:
    from .accuracy.certificate import Certificate

FEW = 50_000  # objects between two collections in a copy


@dataclass(frozen=True, repr=False)
class Variant:
    """What one variant left: times (n,) s, series (n, size) by sensor, energies (n,) J by kind, q and v at the end, counters.

    ``status``, ``warnings``: as of a run. ``certificate``: what it states of its errors, where it was asked.
    ``error``: why it failed, where failures are kept; it then left nothing else.
    """

    parameter: Any
    times: Array
    series: dict[str, Array]
    energy: dict[str, Array]
    end: tuple[Array, Array]
    counters: dict[str, float]
    status: str = "failed"
    warnings: tuple[str, ...] = ()
    certificate: Certificate | None = None
    error: FmbdError | None = None

    @classmethod
    def failed(cls, parameter: Any, error: FmbdError) -> Variant:
        """One that failed."""
        nothing = np.zeros(0)
        return cls(parameter, nothing, {}, {}, (nothing, nothing), {}, error=error)

    if not TYPE_CHECKING:  # type checkers know what there is

        def __getattr__(self, name: str) -> Any:
            """Only what is not there comes here."""
            raise AttributeError(
                f"A variant has no {name!r}: of its run only records are kept. "
                "fmbd.solve(make(parameter), ...) gives the whole run."
            )

    def __getitem__(self, sensor: str) -> Array:
        """Series of a sensor, (n, size)."""
        if self.error is not None:
            raise self.error
        if sensor not in self.series:
            raise InputError(f'No sensor "{sensor}". {near(sensor, self.series)}')
        return self.series[sensor]

    def __repr__(self) -> str:
        if self.error is not None:
            return f"<variant {self.parameter!r:.60}: {type(self.error).__name__}>"
        return (
            f"<variant {self.parameter!r:.60}: {len(self.times)} records, sensors {', '.join(self.series) or 'none'}>"
        )


@dataclass(frozen=True, repr=False)
class Variants:
    """The variants in the order of their parameters; ``variants["tip"]`` is the series of a sensor of all, (B, n, size), with
    nan for those that failed.
    """

    variants: tuple[Variant, ...]

    @property
    def failed(self) -> tuple[Variant, ...]:
        """Those that failed, each with its ``error``."""
        return tuple(variant for variant in self if variant.error is not None)

    def __len__(self) -> int:
        return len(self.variants)

    def __iter__(self) -> Iterator[Variant]:
        return iter(self.variants)

    def __getitem__(self, what: int | str) -> Any:
        """One variant by its number, or a sensor of all."""
        if not isinstance(what, str):
            return self.variants[what]
        ran = [variant for variant in self if variant.error is None] or self.variants
        shapes = {variant[what].shape for variant in ran}
        require(
            len(shapes) == 1,
            f'Sensor "{what}" has other numbers of records in some variants, {sorted(shapes)}: take them one by one, '
            'variants[i]["..."].',
        )
        missing = np.full(shapes.pop(), np.nan)
        return np.stack([missing if variant.error is not None else variant[what] for variant in self])

    def __repr__(self) -> str:
        return f"<{len(self)} variants>"


@alike
def run_variants(
    make: Callable[[Any], Scene], parameters: Sequence[Any], *, keep_failures: bool = False, **settings: Any
) -> Variants:
    """Run ``make(parameter)`` for every parameter, on all cores of this machine.

        study.map(lambda k: suspension(stiffness=k), [1e4, 2e4, 4e4], t_end=2.0, dt=1e-3)["wheel"]    # (3, n, 3)

    Args:
        make: parameter -> scene.
        keep_failures: a variant that fails keeps its ``error``, and the others are run; else the first error is raised.
        settings: of :func:`~fmbd_fenicsx.solve`, the same for all, but for ``checkpoint`` and ``restart``. Functions that an
            output calls, ``on_step`` and ``then`` of events, see all variants: these are run one after the other.

    Raises:
        InputError: no parameters, a checkpoint, or several MPI ranks, which share out one scene.
        FmbdError: what a variant raises, with its parameter; exceptions of other kinds as :class:`~fmbd_fenicsx.errors.LawError`.
    """
    function("study.map: make", make, ["parameter"])
    try:
        given = list(parameters)
    except TypeError:
        refuse("study.map: parameters", "a list or tuple", parameters)
    require(bool(given), "study.map: no parameters.")
    require(
        world_size() == 1,
        f"study.map uses all cores by itself, found {world_size()} MPI ranks. Start it without mpirun, or loop over solve().",
    )
    require(
        settings.get("checkpoint") is None and settings.get("restart") is None,
        "study.map: checkpoints are of one run alone. Loop over solve() with a folder for each variant.",
    )
    of_run = signature(solve)
    fitted("study.map", of_run.replace(parameters=[*of_run.parameters.values()][1:]), (), settings)
    output = settings.setdefault("output", Output(progress=False))
    one = _kept if keep_failures else _one
    first = one(make, given[0], settings)

    rest = given[1:]
    # what a function of the user's own remembers in a copy of this process would be lost
    workers = 1 if isinstance(output, Output) and output.calls_back else min(cores(), len(rest))
    if workers < 2 or not hasattr(os, "fork"):
        return Variants((first, *(one(make, parameter, settings) for parameter in rest)))
    return Variants((first, *_on_cores(workers, one, make, rest, settings)))


def _on_cores(
    workers: int, one: Callable[..., Any], make: Callable[[Any], Scene], rest: list[Any], settings: Any
) -> list[Any]:
    """What ``one`` makes of each parameter, in so many processes at once; raises the first error of any."""
    pipes = [_start(one, make, rest[i::workers], settings) for i in range(workers)]
    found: list[Any] = [None] * len(rest)
    answers: list[Any] = []
    try:
        for pipe in pipes:
            answers.append(_answer(*pipe))
    except BaseException:  # an interrupt of this process alone, as a notebook sends it
        for child, _ in pipes[len(answers) :]:
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
        raise
    for i, answer in enumerate(answers):
        if isinstance(answer, BaseException):
            raise answer
        found[i::workers] = answer
    return found


def _one(make: Callable[[Any], Scene], parameter: Any, settings: dict[str, Any]) -> Variant:
    """The run of one parameter."""
    try:
        scene = make(parameter)
        require(isinstance(scene, Scene), f"study.map: make returned {scene!r:.60}, expected a Scene.")
        run = solve(scene, **settings)
    except FmbdError as error:
        raise type(error)(f"Variant {parameter!r:.80}: {error}") from error
    except Exception as error:
        # where it was raised stays behind in the copy of the process
        *_, place = traceback.extract_tb(error.__traceback__)
        raise LawError(
            f"Variant {parameter!r:.80}: {type(error).__name__}: {error} ({place.filename}, line {place.lineno}, in {place.name})"
        ) from error
    end = run.state.q.copy(), run.state.v.copy()
    stated = run.certificate if run.deviations else None
    said = run.status, tuple(run.warnings), stated
    return Variant(parameter, run.times, run.series, run.energy, end, run.counters, *said)


def _kept(make: Callable[[Any], Scene], parameter: Any, settings: dict[str, Any]) -> Variant:
    """The run of one parameter, or its error."""
    try:
        return _one(make, parameter, settings)
    except FmbdError as error:
        return Variant.failed(parameter, pickle.loads(_packed(error)))


def _start(
    one: Callable[..., Variant], make: Callable[[Any], Scene], parameters: list[Any], settings: dict[str, Any]
) -> tuple[int, int]:
    """A copy of this process that runs some variants: its number, and the pipe on which it answers."""
    reading, writing = os.pipe()
    child = os.fork()
    if child:
        os.close(writing)
        return child, reading

    # The copy must not come back from here: MPI, PETSc and open files belong to the process that it was made from.
    try:
        answer: Any
        try:
            gc.freeze()  # what there is will stay: collections need not look at it
            gc.set_threshold(FEW)
            answer = [one(make, parameter, settings) for parameter in parameters]
            text = pickle.dumps(answer, protocol=pickle.HIGHEST_PROTOCOL)
        except BaseException as error:
            text = _packed(error)
        with os.fdopen(writing, "wb") as pipe:
            pipe.write(text)
    finally:
        os._exit(0)


def _packed(error: BaseException) -> bytes:
    """An exception to be sent, as a package error with its text where it cannot be sent itself."""
    try:
        text = pickle.dumps(error)
        pickle.loads(text)
    except Exception:
        return pickle.dumps(FmbdError(f"{type(error).__name__}: {error}"))
    return text


def _answer(child: int, reading: int) -> Any:
    """What a copy sends: its variants, or what it raised."""
    with os.fdopen(reading, "rb") as pipe:
        text = pipe.read()
    os.waitpid(child, 0)
    return (
        pickle.loads(text) if text else FmbdError("study.map: a process ended without an answer; was it out of memory?")
    )
