"""What a run of many equal steps will take, said before the first of them: a time in a wrong unit asks for milliards."""

from __future__ import annotations

from ...errors import InputError
from ...log import log
from .output import SHARE, machine_memory
from .recorder import Recorder

MANY_STEPS = 10_000_000  # up to which there is nothing to say
STEP, LONG = 1e-5, 3600.0  # s of the clock that a step of a few bodies takes, and a run that is told of


def judge_plan(recorder: Recorder, steps: int) -> None:
    """Refuse records that would fill the memory, by the size of the first, and tell of steps that take hours.

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
