"""How often the runs of a search are recorded, and what is left of that."""

from __future__ import annotations

import numpy as np

from ...recording.ledger import Books
from ...recording.output import Output
from ...result import Run
from ...schedule import StepSchedule

RECORDS = 200  # that runs make at least, so that they can be compared


def often(wanted: Output, schedule: StepSchedule) -> int:
    """Every how many steps an attempt is recorded: as wanted, or a divisor of it where that would leave few records."""
    if not schedule.steps:
        return wanted.every
    fits = [n for n in range(1, wanted.every + 1) if wanted.every % n == 0 and schedule.steps / n >= RECORDS]
    return max(fits, default=1)


def thin_out(run: Run, indices: np.ndarray, every: int) -> None:
    """Leave only the records that were wanted: of every so many steps, and the last."""
    keep = indices % every == 0
    keep[-1:] = True
    run.times = run.times[keep]
    run.series = {name: x[keep] for name, x in run.series.items()}
    run.energy = {kind: x[keep] for kind, x in run.energy.items()}
    if run.books is not None:
        power, work = ({n: x[keep] for n, x in kind.items()} for kind in (run.books.power, run.books.work))
        run.books = Books(power, work, run.books.unlisted)
